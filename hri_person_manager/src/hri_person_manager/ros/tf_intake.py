"""Narrow listener on /tf and /tf_static: frames of tracked humans, and what leads to the reference frame."""

from __future__ import annotations

import threading
from typing import Callable, Iterable, List, NamedTuple, Optional, Tuple

import genpy
import rospy
import tf2_py
from geometry_msgs.msg import TransformStamped
from tf2_msgs.msg import TFMessage

from hri_person_manager.core.association import Kind
from hri_person_manager.core.frame_tree import FrameTree
from hri_person_manager.core.human_frames import HumanFrames, Link, Sighting
from hri_pipeline.core.geometry import Pose
from hri_pipeline.ros.conversions import pose_from_transform
from hri_pipeline.ros.topic_release import release

HISTORY_S = 10.0
_LOG_PERIOD_S = 10.0


class StampedSighting(NamedTuple):
    """A sighting with the exact stamp of its transform (seconds in a float lose the nanoseconds)."""

    sighting: Sighting
    stamp: genpy.Time


class TfIntake:
    """Reports where tracked features are, in their sensor's frame, and looks sensors up in the reference frame.

    `on_sightings` is called in rospy's thread, once per message that places a feature. A transform that
    cannot be used is counted and left out. Nothing is kept of a human who is gone.
    """

    def __init__(self, reference_frame: str, source_timeout: float,
                 on_sightings: Callable[[List[StampedSighting]], None]) -> None:
        self._reference = reference_frame
        self._on_sightings = on_sightings
        self._lock = threading.Lock()
        self._humans = HumanFrames(source_timeout)
        self._tree: FrameTree[Tuple[TransformStamped, bool]] = FrameTree()
        self._tree.follow(reference_frame)
        self._buffer = tf2_py.BufferCore(rospy.Duration(HISTORY_S))
        self.refused = 0
        self._moving = rospy.Subscriber("/tf", TFMessage, self._on_tf, callback_args=False,
                                        queue_size=100, buff_size=2 ** 20, tcp_nodelay=True)
        self._static = rospy.Subscriber("/tf_static", TFMessage, self._on_tf, callback_args=True, queue_size=100)

    def set_tracked(self, kind: Kind, ids: Iterable[str]) -> None:
        """Follow the frames of these features; those of others of the kind are freed."""
        with self._lock:
            self._humans.set_tracked(kind, ids)

    def lookup(self, sensor: str, stamp: genpy.Time) -> Optional[Pose]:
        """Return the pose of a sensor frame in the reference frame at `stamp`.

        Where the history does not cover the stamp, the latest transform is taken. None if no chain of
        transforms connects the two.
        """
        if sensor == self._reference:
            return Pose.identity()
        with self._lock:
            for needed in self._tree.follow(sensor):
                self._feed(*needed)
            for time in (stamp, genpy.Time()):
                try:
                    return pose_from_transform(self._buffer.lookup_transform_core(self._reference, sensor, time))
                except tf2_py.ExtrapolationException:
                    continue
                except (tf2_py.TransformException, ValueError):
                    return None
        return None

    def reset(self) -> None:
        """Forget all moving transforms, as after a time jump."""
        with self._lock:
            self._humans.clear()
            self._buffer.clear()
            for needed in self._tree.forget_moving():
                self._feed(*needed)

    def status(self) -> dict:
        """Return how much is kept, for diagnostics."""
        with self._lock:
            return {"human frames": len(self._humans), "robot frames": len(self._tree),
                    "frames with history": len(self._tree.relevant), "transforms refused": self.refused}

    def close(self) -> None:
        """Let go of both topics. Idempotent."""
        release(self._moving)
        release(self._static)

    def _on_tf(self, message: TFMessage, fixed: bool) -> None:
        if message._connection_header.get("callerid") == rospy.get_name():
            return
        found: List[StampedSighting] = []
        with self._lock:
            for transform in message.transforms:
                try:
                    sighting = self._take(transform, fixed)
                except ValueError as error:
                    self.refused += 1
                    rospy.logwarn_throttle(_LOG_PERIOD_S, "/tf: frame %r not used: %s",
                                           transform.child_frame_id[:80], error)
                    continue
                if sighting is not None:
                    found.append(StampedSighting(sighting, transform.header.stamp))
        if found:
            self._on_sightings(found)

    def _take(self, transform: TransformStamped, fixed: bool) -> Optional[Sighting]:
        child, parent = transform.child_frame_id.lstrip("/"), transform.header.frame_id.lstrip("/")
        if not child or not parent or child == parent:
            raise ValueError("a transform needs two different frames")
        owner = self._humans.owner(child)
        if owner is not None:
            link = Link(parent, pose_from_transform(transform), transform.header.stamp.to_sec())
            return self._humans.put(owner, child, link)
        if fixed:
            self._humans.keep_static(child, Link(parent, pose_from_transform(transform), float("inf")))
        else:
            known = self._tree.latest(child)
            if known is not None and known[0].header.stamp == transform.header.stamp:
                return None     # tf2 would print a warning for each repeated stamp
        for needed in self._tree.put(child, parent, (transform, fixed), fixed):
            self._feed(*needed)
        return None

    def _feed(self, transform: TransformStamped, fixed: bool) -> None:
        if fixed:
            self._buffer.set_transform_static(transform, "tf_intake")
        else:
            self._buffer.set_transform(transform, "tf_intake")
