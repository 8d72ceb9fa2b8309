"""Where people are: the frames of those who are asked for, in any frame of the robot."""

from __future__ import annotations

import threading
from collections import OrderedDict
from typing import Dict, Optional, Tuple

import genpy

from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.tf_scan import RawTransform, read
from hri_pipeline.ros.robot_frames import RobotFrameFeed
from hri_pipeline.ros.tf_feed import Frames, TfFeed

_LONGEST_CHAIN = 64
_MAX_TARGETS = 20
_MAX_FIXED = 2000


class PeopleFrames:
    """Keeps the latest transform of the frames that were asked for, and of those between them and the sensor.

    tf2's own listener keeps ten seconds of each frame and never forgets one: half a megabyte for each body that ever was.
    Nothing is listened to before the first question.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._wanted: Dict[str, str] = {}
        self._links: Dict[str, RawTransform] = {}
        self._fixed: "OrderedDict[str, RawTransform]" = OrderedDict()
        self._robots: Dict[str, RobotFrameFeed] = {}
        self._ears: Optional[TfFeed] = None
        self._closed = False

    def pose(self, kind: str, identity: str, target: str = "") -> Optional[Tuple[Pose, str, float]]:
        """Return the pose of the frame kind_identity in `target`, the name of that frame, and its stamp (s).

        An empty target is the frame in which the stack publishes it: that of the sensor, or the reference frame. None
        while it is not known, as in the first moments after the first question, or when nothing leads to `target`.
        Raises ValueError when poses in more than 20 different frames are asked for.
        """
        frame = "{}_{}".format(kind, identity)
        with self._lock:
            if self._closed:
                return None
            self._want(frame, identity)
            chain = self._chain(frame, identity)
            robot = self._robot(target) if target else None
        if chain is None:
            return None
        pose, sensor, link = chain
        if robot is None or sensor == target:
            return pose, sensor, link.stamp
        outer = robot.lookup(sensor, genpy.Time(link.secs, link.nsecs))
        return None if outer is None else (outer.compose(pose), target, link.stamp)

    def forget(self, identity: str) -> None:
        """Free what is kept of the frames of one face, body, voice or person."""
        with self._lock:
            for frame in [frame for frame, owner in self._wanted.items() if owner == identity]:
                del self._wanted[frame]
                self._links.pop(frame, None)

    def close(self) -> None:
        """Stop listening. Idempotent."""
        with self._lock:
            self._closed = True
            owners = list(self._robots.values()) + ([self._ears] if self._ears else [])
            self._robots, self._ears = {}, None
        for owner in owners:
            owner.close()

    def _want(self, frame: str, identity: str) -> None:
        if frame not in self._wanted:
            self._wanted[frame] = identity
            if frame in self._fixed:
                self._keep(frame, self._fixed[frame])
        if self._ears is None:
            self._ears = TfFeed(self._take, own=True)

    def _robot(self, target: str) -> RobotFrameFeed:
        if target not in self._robots:
            if len(self._robots) >= _MAX_TARGETS:
                raise ValueError("poses in more than {} different frames; ask for fewer".format(_MAX_TARGETS))
            self._robots[target] = RobotFrameFeed(target, own=True)
        return self._robots[target]

    def _chain(self, frame: str, identity: str) -> Optional[Tuple[Pose, str, RawTransform]]:
        """Pose of a frame in the first frame above it that is not of the same human, that frame, the link to it."""
        pose, ending = Pose.identity(), "_" + identity
        for _ in range(_LONGEST_CHAIN):
            link = self._links.get(frame)
            if link is None:
                return None
            frame = link.parent
            pose = Pose.from_quaternion(link.rotation, link.translation).compose(pose)
            if not frame.endswith(ending):
                return pose, frame, link
        return None

    def _take(self, data: bytes, frames: Frames, fixed: bool) -> None:
        with self._lock:
            known = -1
            while known != len(self._wanted):
                # A link tells which one above it is wanted too; that may stand earlier in the same message.
                known = len(self._wanted)
                for child, offset in frames:
                    name = child.decode("utf-8", "replace").lstrip("/")
                    if fixed:
                        self._fixed[name] = read(data, offset)
                    if name in self._wanted:
                        self._keep(name, read(data, offset))
            while len(self._fixed) > _MAX_FIXED:
                self._fixed.popitem(last=False)

    def _keep(self, frame: str, link: RawTransform) -> None:
        self._links[frame] = link
        identity = self._wanted[frame]
        if link.parent.endswith("_" + identity) and link.parent not in self._wanted:
            self._want(link.parent, identity)
