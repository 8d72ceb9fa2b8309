"""The truth of a scene under /scene/truth, cycle by cycle, so that a bag of it can be scored."""

from __future__ import annotations

import math
from typing import Iterable, Tuple

import rospy
from geometry_msgs.msg import Pose as PoseMessage
from geometry_msgs.msg import PoseArray
from std_msgs.msg import Header, String

from hri_msgs.msg import GazeSenderReceiver, GazesStamped, Group, GroupsStamped, IdsList
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.scene.scene_world import PersonTruth, SceneTruth
from hri_pipeline.ros.topic_release import release

NAMESPACE = "/scene/truth"
_LISTS = ("persons", "visible", "speaking", "eyes_closed")
_TYPES = {"heads": PoseArray, "bodies": PoseArray, "gaze": GazesStamped, "groups": GroupsStamped}


class SceneTruthTopics:
    """Publishes the truth. heads and bodies have the order of `persons`; all messages of a cycle have one stamp."""

    def __init__(self, frame: str, script: str) -> None:
        """frame: of the positions. script: text of the scene, latched."""
        self._frame = frame
        types = {**{name: IdsList for name in _LISTS}, **_TYPES}
        self._publishers = {name: rospy.Publisher("{}/{}".format(NAMESPACE, name), kind, queue_size=50)
                            for name, kind in types.items()}
        self._script = rospy.Publisher(NAMESPACE + "/script", String, queue_size=1, latch=True)
        self._script.publish(String(script))

    def publish(self, truth: SceneTruth, visible: Iterable[str], stamp: rospy.Time) -> None:
        """Publish one cycle. visible: people whom the sensors could see."""
        if not any(publisher.get_num_connections() for publisher in self._publishers.values()):
            return
        header = Header(stamp=stamp, frame_id=self._frame)
        people = truth.people
        self._send("persons", IdsList(header, [person.id for person in people]))
        self._send("visible", IdsList(header, sorted(visible)))
        self._send("speaking", IdsList(header, [person.id for person in people if person.speaking]))
        self._send("eyes_closed", IdsList(header, [person.id for person in people if person.eyes_closed]))
        self._send("heads", PoseArray(header, [_pose(Pose(person.head_rotation, person.head)) for person in people]))
        self._send("bodies", PoseArray(header, [_standing(person) for person in people]))
        self._send("gaze", GazesStamped(header, [GazeSenderReceiver(person.id, person.target, 1.0) for person in people
                                                 if person.target is not None]))
        self._send("groups", GroupsStamped(header, [Group(header, group.id, list(group.members)) for group in truth.groups],
                                           [1.0] * len(truth.groups)))

    def close(self) -> None:
        """Take the topics back. Idempotent."""
        for publisher in (*self._publishers.values(), self._script):
            release(publisher)

    def _send(self, name: str, message: object) -> None:
        self._publishers[name].publish(message)


def _pose(pose: Pose) -> PoseMessage:
    message = PoseMessage()
    message.position.x, message.position.y, message.position.z = pose.translation.tolist()
    turn = message.orientation
    turn.x, turn.y, turn.z, turn.w = pose.quaternion
    return message


def _standing(person: PersonTruth) -> PoseMessage:
    message = PoseMessage()
    message.position.x, message.position.y = (float(value) for value in person.position)
    message.orientation.z, message.orientation.w = _half(person.yaw)
    return message


def _half(yaw: float) -> Tuple[float, float]:
    return math.sin(yaw / 2.0), math.cos(yaw / 2.0)
