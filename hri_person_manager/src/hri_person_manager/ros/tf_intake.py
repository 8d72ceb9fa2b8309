"""Narrow listener on /tf and /tf_static: frames of tracked humans, and what leads to the reference frame."""

from __future__ import annotations

import threading
from typing import Callable, Iterable, List, NamedTuple, Optional, Set, Tuple

import genpy
import rospy

from hri_person_manager.core.association import Kind
from hri_person_manager.core.human_frames import HumanFrames, Link, Sighting
from hri_pipeline.core.frame_tree import is_of_human
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.tf_scan import RawTransform, read
from hri_pipeline.ros.robot_frames import RobotFrames
from hri_pipeline.ros.tf_feed import Frames, TfFeed

_LOG_PERIOD_S = 10.0
_MAX_LIMBS = 5000


class StampedSighting(NamedTuple):
    """A sighting with the exact stamp of its transform (seconds in a float lose the nanoseconds)."""

    sighting: Sighting
    stamp: genpy.Time


class TfIntake:
    """Reports where tracked features are, in their sensor's frame, and looks sensors up in the reference frame.

    `on_sightings` is called in rospy's thread, once per message that places a feature. A transform that
    cannot be used is counted and left out. Nothing is kept of a human who is gone. Of the links of a skeleton only
    those that lead to the head are read; of the others the name is looked at.
    """

    def __init__(self, reference_frame: str, source_timeout: float,
                 on_sightings: Callable[[List[StampedSighting]], None]) -> None:
        self._on_sightings = on_sightings
        self._lock = threading.Lock()
        self._humans = HumanFrames(source_timeout)
        self._robot = RobotFrames(reference_frame)
        self._limbs: Set[str] = set()
        self._stamp = genpy.Time()
        self.refused = 0
        self._ears = TfFeed(self._on_frames)

    def set_tracked(self, kind: Kind, ids: Iterable[str]) -> None:
        """Follow the frames of these features; those of others of the kind are freed."""
        with self._lock:
            self._humans.set_tracked(kind, ids)
            self._limbs.clear()

    def lookup(self, sensor: str, stamp: genpy.Time) -> Optional[Pose]:
        """Return the pose of a sensor frame in the reference frame at `stamp`, else the latest; None without any."""
        return self._robot.lookup(sensor, stamp)

    def reset(self) -> None:
        """Forget all moving transforms, as after a time jump."""
        with self._lock:
            self._humans.clear()
        self._robot.reset()

    def status(self) -> dict:
        """Return how much is kept, for diagnostics."""
        with self._lock:
            return {"human frames": len(self._humans), "robot frames": self._robot.known,
                    "frames with history": len(self._robot.relevant), "transforms refused": self.refused,
                    "messages refused": self._ears.refused}

    def close(self) -> None:
        """Let go of both topics. Idempotent."""
        self._ears.close()

    def _on_frames(self, data: bytes, frames: Frames, fixed: bool) -> None:
        found: List[StampedSighting] = []
        with self._lock:
            # A link of a head tells which link above it is wanted too; that may stand earlier in the same message.
            wanted = -1
            while frames and wanted != self._humans.wanted_frames:
                wanted = self._humans.wanted_frames
                frames = [entry for entry in frames if not self._take(data, entry, fixed, found)]
        if found:
            self._on_sightings(found)

    def _take(self, data: bytes, entry: Tuple[bytes, int], fixed: bool, found: List[StampedSighting]) -> bool:
        """Take one transform of a message; False for one of a human that places nobody: only its name has been read."""
        child, offset = entry
        name = child.decode("utf-8", "replace").lstrip("/")
        owner = self._humans.wanted(name)
        if owner is None and (is_of_human(child, fixed) or not fixed and self._is_limb(name)):
            return False        # a limb, or of somebody who is not tracked (any more)
        try:
            transform = read(data, offset)
            sighting = self._use(name, owner, transform, fixed)
        except ValueError as error:
            self.refused += 1
            rospy.logwarn_throttle(_LOG_PERIOD_S, "/tf: frame %r not used: %s", name[:80], error)
            return True
        if sighting is not None:
            found.append(StampedSighting(sighting, self._time(transform)))
        return True

    def _time(self, transform: RawTransform) -> genpy.Time:
        """Return the stamp; all frames of one image have the same, and to make one takes genpy long."""
        if (transform.secs, transform.nsecs) != (self._stamp.secs, self._stamp.nsecs):
            self._stamp = genpy.Time(transform.secs, transform.nsecs)
        return self._stamp

    def _is_limb(self, name: str) -> bool:
        if name in self._limbs:
            return True
        if self._humans.owner(name) is None:
            return False
        if len(self._limbs) < _MAX_LIMBS:
            self._limbs.add(name)
        return True

    def _use(self, name: str, owner: Optional[Tuple[Kind, str]], transform: RawTransform,
             fixed: bool) -> Optional[Sighting]:
        if not name or not transform.parent or name == transform.parent:
            raise ValueError("a transform needs two different frames")
        link = Link(transform.parent, transform.translation, transform.rotation,
                    float("inf") if fixed else transform.stamp)
        # A fixed link comes only once, so that all of them are kept.
        owner = self._humans.owner(name) if owner is None and fixed else owner
        if owner is not None:
            return self._humans.put(owner, name, link)
        if fixed:
            self._humans.keep_static(name, link)
        self._robot.put(transform, fixed)
        return None
