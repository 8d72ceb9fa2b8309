"""Transforms: a subscriber that reads only the frames that matter, the history of the robot's frames, and a
publisher."""

from __future__ import annotations

import math
import threading
import time
from collections import OrderedDict
from typing import Callable, List, Optional, Sequence, Set, Tuple

import genpy
import rospy
from geometry_msgs.msg import TransformStamped
from tf2_msgs.msg import TFMessage

from hri_pipeline.core.frames import FrameHistory, RawTransform, check_stamp, is_of_human, is_stamp, read, scan
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.timing import ALL_STALE_S, JUMP_BACK_S
from hri_pipeline.ros.rospy_compat import release
from hri_pipeline.ros.tcpros import AnyMessage, bytes_of

_LOG_PERIOD_S = 10.0

Frames = List[Tuple[bytes, int]]


class TfSubscriber:
    """Calls on_frames(data, frames, fixed) in rospy's thread for each message of another node.

    frames: (child frame, offset) of each transform; core.frames.read(data, offset) gives the transform itself.
    fixed: it came on /tf_static. A message that is no TFMessage is logged and counted in `refused`. So is a transform
    for which on_frames raises ValueError; the others of its message are then given to it one by one. skip: messages of
    nodes whose name starts so are left out. own: take those of this node as well.
    """

    def __init__(self, on_frames: Callable[[bytes, Frames, bool], None], skip: Optional[str] = None,
                 own: bool = False) -> None:
        self._on_frames = on_frames
        self._skip = skip
        self._name = "" if own else rospy.get_name()
        self.refused = 0
        self._moving = rospy.Subscriber("/tf", AnyMessage, self._take, callback_args=False,
                                        queue_size=100, buff_size=2 ** 20, tcp_nodelay=True)
        self._static = rospy.Subscriber("/tf_static", AnyMessage, self._take, callback_args=True, queue_size=100)

    def close(self) -> None:
        """Unsubscribe. Idempotent."""
        release(self._moving)
        release(self._static)

    def _take(self, message: genpy.Message, fixed: bool) -> None:
        caller = message._connection_header.get("callerid", "")
        if caller == self._name or (self._skip is not None and caller.startswith(self._skip)):
            return
        data = bytes_of(message)
        frames: Frames = []
        try:
            frames = scan(data)
            self._on_frames(data, frames, fixed)
        except ValueError as error:
            if len(frames) < 2:
                self._refuse(caller, error)
            else:
                self._take_singly(caller, data, frames, fixed)

    def _take_singly(self, caller: str, data: bytes, frames: Frames, fixed: bool) -> None:
        """Take the transforms of a message of which one is bad; to take a good one twice does no harm."""
        for frame in frames:
            try:
                self._on_frames(data, [frame], fixed)
            except ValueError as error:
                self._refuse(caller, error)

    def _refuse(self, caller: str, error: ValueError) -> None:
        self.refused += 1
        rospy.logwarn_throttle(_LOG_PERIOD_S, "/tf: something of %s is not used: %s", caller, error)


HISTORY_S = 10.0
SKELETONS = "/rsp_"
"""Names of the robot_state_publishers of bodies start so."""


class RobotTf:
    """Takes transforms and looks frames up in `reference`. Safe to use from several threads.

    tf2's own listener keeps ten seconds of every frame that there is and never forgets one.
    """

    def __init__(self, reference: str) -> None:
        self._reference = reference
        self._lock = threading.Lock()
        self._history: Optional[FrameHistory] = FrameHistory(HISTORY_S)
        self._history.follow(reference)

    def put(self, transform: RawTransform, fixed: bool) -> None:
        """Take a transform.

        Raises ValueError for one that leads from a frame to itself or to nothing, or has no pose or no stamp.
        """
        if not transform.child or not transform.parent or transform.child == transform.parent:
            raise ValueError("a transform needs two different frames")
        if not transform.is_pose:
            raise ValueError("the transform to {!r} has numbers that are no pose".format(transform.child[:80]))
        check_stamp(transform.secs, transform.nsecs)
        with self._lock:
            if self._history is None:
                return
            known = None if fixed else self._history.newest_stamp(transform.child)
            if known == transform.stamp:
                return
            if known is not None and transform.stamp < known - HISTORY_S:
                # that stamp was of the future: no other one would count before that time comes again
                self._history.forget_moving()
            self._history.put(transform, fixed)

    def lookup(self, frame: str, stamp: genpy.Time) -> Optional[Pose]:
        """Return the pose of a frame in the reference frame at `stamp`.

        Where the stamp is later than what is known of some of the links, these stay, or go on as they moved. Where it
        is earlier, or none, the latest transform is taken. None if no chain of transforms connects the two.
        """
        return self.between(self._reference, frame, stamp)

    def lags(self, frame: str, stamp: genpy.Time) -> bool:
        """Tell whether the transforms of a frame that moves have not come yet for `stamp`, but soon will."""
        if frame == self._reference:
            return False
        with self._lock:
            return self._history is not None and self._history.lags(self._reference, frame, stamp.to_sec())

    def moves_until(self, frame: str) -> Optional[float]:
        """Return until when (s) the transforms of a frame that moves have come, None for one that stands."""
        with self._lock:
            return self._history.moves_until(self._reference, frame) if self._history is not None else None

    def between(self, target: str, frame: str, stamp: genpy.Time) -> Optional[Pose]:
        """Return the pose of a frame in another one than the reference, as lookup() does."""
        if frame == target:
            return Pose.identity()
        with self._lock:
            if self._history is None:
                return None
            self._history.follow(target)
            self._history.follow(frame)
            pose = None
            if is_stamp(stamp.secs, stamp.nsecs) and stamp:
                pose = self._history.between(target, frame, stamp.to_sec())
                pose = self._history.ahead(target, frame, stamp.to_sec()) if pose is None else pose
            return pose if pose is not None else self._history.between(target, frame, None)

    def reset(self) -> None:
        """Forget all moving transforms, as after a time jump."""
        with self._lock:
            if self._history is not None:
                self._history.forget_moving()

    def close(self) -> None:
        """Forget everything; nothing is known from now on. Idempotent."""
        with self._lock:
            self._history = None

    @property
    def known(self) -> int:
        """Number of frames whose latest transform is kept."""
        with self._lock:
            return len(self._history or ())

    @property
    def relevant(self) -> Set[str]:
        """Frames whose history is kept."""
        with self._lock:
            return self._history.followed if self._history is not None else set()


class RobotTfListener(RobotTf):
    """RobotTf with its own subscribers to /tf and /tf_static; it leaves the frames of humans out.

    own: take the transforms that this node sends itself, too.
    """

    def __init__(self, reference: str, own: bool = False) -> None:
        super().__init__(reference)
        self._subscriber = TfSubscriber(self._take, skip=SKELETONS, own=own)

    def close(self) -> None:
        """Stop listening. Idempotent."""
        self._subscriber.close()
        super().close()

    def _take(self, data: bytes, frames: Frames, fixed: bool) -> None:
        for child, offset in frames:
            if not is_of_human(child, fixed):
                self.put(read(data, offset), fixed)


_REMEMBERED = 1000


class TfPublisher:
    """Publishes transforms on /tf, one message per call, never a frame twice with the same stamp or after a newer one.

    tf2 drops a repeated stamp and prints a warning for each, in every process that listens. Older stamps are sent again
    when the clock has gone back, after reset(), and when nothing newer has come for ALL_STALE_S.
    """

    def __init__(self) -> None:
        self._publisher = rospy.Publisher("/tf", TFMessage, queue_size=100)
        self._last: "OrderedDict[str, Tuple[genpy.Time, float]]" = OrderedDict()    # stamp, and when it was sent
        self._now = 0.0
        self.dropped = 0
        self._closed = False

    def send(self, transforms: Sequence[TransformStamped]) -> None:
        """Publish the transforms; those that are not newer than the last one and numbers that are not finite are left
        out."""
        now = rospy.get_time()
        if now < self._now - JUMP_BACK_S:
            self.reset()
        self._now = now
        arrived = time.monotonic()
        fresh = [transform for transform in transforms if self._is_fresh(transform, arrived)]
        self.dropped += len(transforms) - len(fresh)
        if fresh and not self._closed:
            self._publisher.publish(TFMessage(transforms=fresh))

    def is_behind(self, child: str, stamp: genpy.Time, by: float) -> bool:
        """Tell whether a stamp is by more than `by` s older than the last one that was sent of this frame."""
        return child in self._last and (self._last[child][0] - stamp).to_sec() > by

    def reset(self) -> None:
        """Take older stamps from now on: time has jumped back."""
        self._last.clear()

    def close(self) -> None:
        """Close the topic. Idempotent."""
        if not self._closed:
            self._closed = True
            release(self._publisher)

    def _is_fresh(self, transform: TransformStamped, now: float) -> bool:
        child, stamp = transform.child_frame_id, transform.header.stamp
        last, sent_at = self._last.get(child, (None, 0.0))
        if last is not None and (stamp.secs, stamp.nsecs) <= (last.secs, last.nsecs) and (
                stamp == last or now - sent_at <= ALL_STALE_S):
            return False
        if not _is_finite(transform):
            return False
        self._last[child] = stamp, now
        self._last.move_to_end(child)
        # Frames of people who have gone are forgotten, oldest first.
        while len(self._last) > _REMEMBERED:
            self._last.popitem(last=False)
        return True


def _is_finite(transform: TransformStamped) -> bool:
    position, turn = transform.transform.translation, transform.transform.rotation
    return math.isfinite(position.x + position.y + position.z + turn.x + turn.y + turn.z + turn.w)
