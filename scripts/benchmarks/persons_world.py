"""Faces and bodies that do not exist: what the person manager hears, published by one node.

Imported after ROS_MASTER_URI is set. As a program it loads the manager with candidate matches:
`python3 -m benchmarks.persons_world MATCHES_PER_SECOND`.
"""

from __future__ import annotations

import random
import sys
import threading
import time
from typing import Dict, Iterable, List, Optional, Sequence, Tuple

import rospy
from geometry_msgs.msg import TransformStamped
from processes import wait_until
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from hri_msgs.msg import IdsList, IdsMatch

PERSON, FACE, BODY = IdsMatch.PERSON, IdsMatch.FACE, IdsMatch.BODY
CAMERA = "benchmark_camera"


def match(first: str, first_type: int, second: str, second_type: int, likelihood: float) -> IdsMatch:
    """A candidate match."""
    return IdsMatch(id1=first, id1_type=first_type, id2=second, id2_type=second_type, confidence=likelihood)


def transform(child: str, stamp: rospy.Time, x: float, z: float) -> TransformStamped:
    """A frame in the camera's."""
    message = TransformStamped(child_frame_id=child)
    message.header.frame_id, message.header.stamp = CAMERA, stamp
    message.transform.translation.x, message.transform.translation.z = x, z
    message.transform.rotation.w = 1.0
    return message


class FeatureSource:
    """Publishes lists, matches and frames, and hears what the manager says of the persons."""

    def __init__(self) -> None:
        self._lists = {kind: rospy.Publisher("/humans/%s/tracked" % kind, IdsList, latch=True, queue_size=10)
                       for kind in ("faces", "bodies")}
        self.matches = rospy.Publisher("/humans/candidate_matches", IdsMatch, queue_size=1000, tcp_nodelay=True)
        self._tf = rospy.Publisher("/tf", TFMessage, queue_size=100, tcp_nodelay=True)
        self._listed: Dict[str, List[str]] = {"faces": [], "bodies": []}
        self.tracked: Tuple[str, ...] = ()
        self.frames: List[Tuple[float, float, str]] = []
        self._subscribers = [
            rospy.Subscriber("/humans/persons/tracked", IdsList, self._on_tracked, queue_size=10),
            rospy.Subscriber("/tf", TFMessage, self._on_tf, queue_size=1000, buff_size=2 ** 20, tcp_nodelay=True)]
        self._stop = threading.Event()
        self._heartbeat = threading.Thread(target=self._repeat, daemon=True)
        self._heartbeat.start()

    def wait_for_manager(self, seconds: float = 30.0) -> bool:
        """Wait until the manager listens to the matches."""
        return wait_until(lambda: self.matches.get_num_connections() > 0, seconds)

    def show(self, faces: Sequence[str] = (), bodies: Sequence[str] = ()) -> None:
        """Publish who is tracked now."""
        for kind, ids in (("faces", faces), ("bodies", bodies)):
            if list(ids) != self._listed[kind]:
                self._listed[kind] = list(ids)
                self._lists[kind].publish(IdsList(ids=list(ids)))

    def say(self, *messages: IdsMatch) -> None:
        """Publish candidate matches."""
        for message in messages:
            self.matches.publish(message)

    def place(self, faces: Iterable[str], bodies: Iterable[str] = (), stamp: Optional[rospy.Time] = None) -> rospy.Time:
        """Publish the frames of features side by side, two metres away; stamp: of the frames, the present time if
        None."""
        stamp = rospy.Time.now() if stamp is None else stamp
        sent = [transform("face_" + id, stamp, 0.8 * number, 2.0) for number, id in enumerate(faces)]
        sent += [transform("body_" + id, stamp, 0.8 * number, 2.0) for number, id in enumerate(bodies)]
        self._tf.publish(TFMessage(transforms=sent))
        return stamp

    def close(self) -> None:
        """Nobody is tracked any more; give the topics back."""
        self._stop.set()
        self._heartbeat.join()
        self.show()
        for topic in (*self._subscribers, *self._lists.values(), self.matches, self._tf):
            topic.unregister()

    def _repeat(self) -> None:
        while not self._stop.wait(1.0):
            for kind, publisher in self._lists.items():
                publisher.publish(IdsList(ids=list(self._listed[kind])))

    def _on_tracked(self, message: IdsList) -> None:
        self.tracked = tuple(message.ids)

    def _on_tf(self, message: TFMessage) -> None:
        now = time.monotonic()
        self.frames += [(now, item.header.stamp.to_sec(), item.child_frame_id) for item in message.transforms
                        if item.child_frame_id.startswith("person_")]


class FaceIdEar:
    """Hears the face_id of one person and tells when a value came."""

    def __init__(self, person: str) -> None:
        self._condition = threading.Condition()
        self._heard: Optional[Tuple[str, float]] = None
        self._subscriber = rospy.Subscriber("/humans/persons/%s/face_id" % person, String, self._on_text,
                                            queue_size=10, tcp_nodelay=True)

    def forget(self) -> None:
        """Wait for a new value from now on."""
        with self._condition:
            self._heard = None

    def wait(self, value: str, seconds: float) -> Optional[float]:
        """Time (s, monotonic) at which `value` came, None when it does not."""
        with self._condition:
            found = self._condition.wait_for(lambda: self._heard is not None and self._heard[0] == value, seconds)
            return self._heard[1] if found and self._heard is not None else None

    def close(self) -> None:
        """Stop listening."""
        self._subscriber.unregister()

    def _on_text(self, message: String) -> None:
        now = time.monotonic()
        with self._condition:
            self._heard = (message.data, now)
            self._condition.notify_all()


def load(rate: float) -> None:
    """Publish `rate` matches per second between ten faces and ten bodies, until killed."""
    rospy.init_node("persons_load", anonymous=True)
    publisher = rospy.Publisher("/humans/candidate_matches", IdsMatch, queue_size=1000, tcp_nodelay=True)
    wait_until(lambda: publisher.get_num_connections() > 0, 30.0)
    chance, began, sent = random.Random(1), time.monotonic(), 0
    while not rospy.is_shutdown():
        due = int((time.monotonic() - began) * rate)
        for _ in range(due - sent):
            face, body = chance.randrange(10), chance.randrange(10)
            likelihood = chance.uniform(0.7, 0.95) if face == body else chance.uniform(0.05, 0.4)
            publisher.publish(match("lf%d" % face, FACE, "lb%d" % body, BODY, likelihood))
        sent = due
        time.sleep(0.002)


if __name__ == "__main__":
    load(float(sys.argv[1]))
