"""Where people are: the frames of those who are asked for, in any frame of the robot."""

from __future__ import annotations

import threading
from typing import Dict, List, Optional, Tuple

import genpy

from hri_pipeline.core.frames import HumanTf, Timed, read
from hri_pipeline.core.geometry import Pose
from hri_pipeline.ros.tf import Frames, RobotTfListener, TfSubscriber

_MAX_TARGETS = 20


class HumanPoses:
    """Poses of the frames that were asked for. Nothing is subscribed to before the first question."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._tf = HumanTf()
        self._robots: Dict[str, RobotTfListener] = {}
        self._subscriber: Optional[TfSubscriber] = None
        self._closed = False

    def pose(self, kind: str, identity: str, target: str = "") -> Optional[Tuple[Pose, str, float]]:
        """Return the pose of the frame kind_identity in `target`, the name of that frame, and its stamp (s).

        An empty target is the frame in which the stack publishes it: that of the sensor, or the reference frame. None
        while it is not known, as in the first moments after the first question, or when nothing leads to `target`.
        Raises ValueError when poses in more than 20 different frames are asked for.
        """
        with self._lock:
            if self._closed:
                return None
            self._follow(kind, identity)
            chain = self._tf.chain("{}_{}".format(kind, identity))
            robot = self._robot(target) if target else None
        if not chain:
            return None
        pose, link = _composed(chain), chain[-1].transform
        if robot is None or link.parent == target:
            return pose, link.parent, link.stamp
        outer = robot.lookup(link.parent, genpy.Time(link.secs, link.nsecs))
        return None if outer is None else (outer.compose(pose), target, link.stamp)

    def forget(self, identity: str) -> None:
        """Free what is kept of the frames of one face, body, voice or person."""
        with self._lock:
            self._tf.follow(**{kind: [other for other in ids if other != identity]
                               for kind, ids in self._tf.followed.items() if identity in ids})

    def close(self) -> None:
        """Unsubscribe. Idempotent."""
        with self._lock:
            self._closed = True
            owners = list(self._robots.values()) + ([self._subscriber] if self._subscriber else [])
            self._robots, self._subscriber = {}, None
        for owner in owners:
            owner.close()

    def _follow(self, kind: str, identity: str) -> None:
        ids = self._tf.followed.get(kind, [])
        if identity not in ids:
            self._tf.follow(**{kind: ids + [identity]})
        if self._subscriber is None:
            self._subscriber = TfSubscriber(self._take, own=True)

    def _robot(self, target: str) -> RobotTfListener:
        if target not in self._robots:
            if len(self._robots) >= _MAX_TARGETS:
                raise ValueError("poses in more than {} different frames; ask for fewer".format(_MAX_TARGETS))
            self._robots[target] = RobotTfListener(target, own=True)
        return self._robots[target]

    def _take(self, data: bytes, frames: Frames, fixed: bool) -> None:
        with self._lock:
            self._tf.put_message(data, frames, fixed)
            if fixed:
                for child, offset in frames:
                    if not self._tf.wants(child.lstrip(b"/")):
                        self._tf.keep_fixed(read(data, offset))


def _composed(chain: List[Timed]) -> Pose:
    """Return the pose of the lowest frame of a chain of transforms in the one above all of them."""
    pose = Pose.identity()
    for transform, _ in chain:
        pose = Pose.from_quaternion(transform.rotation, transform.translation).compose(pose)
    return pose
