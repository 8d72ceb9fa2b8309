"""Where the frames of the robot are: a transform buffer that keeps only those that lead to one reference frame."""

from __future__ import annotations

import threading
from typing import Optional, Set, Tuple

import genpy
import rospy
import tf2_py
from geometry_msgs.msg import TransformStamped

from hri_pipeline.core.frame_tree import FrameTree, is_of_human
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.tf_scan import RawTransform, check_stamp, is_stamp, read
from hri_pipeline.ros.conversions import pose_from_transform
from hri_pipeline.ros.tf_feed import Frames, TfFeed

HISTORY_S = 10.0
SKELETONS = "/rsp_"
"""Names of the robot_state_publishers of bodies start so."""


class RobotFrames:
    """Takes transforms and looks frames up in `reference`. Safe to use from several threads.

    tf2's own listener keeps ten seconds of every frame that there is and never forgets one.
    """

    def __init__(self, reference: str) -> None:
        self._reference = reference
        self._lock = threading.Lock()
        self._tree: FrameTree[Tuple[RawTransform, bool]] = FrameTree()
        self._tree.follow(reference)
        self._buffer = tf2_py.BufferCore(rospy.Duration(HISTORY_S))

    def put(self, transform: RawTransform, fixed: bool) -> None:
        """Take a transform.

        Raises ValueError for one that leads from a frame to itself or to nothing, or has no pose or no stamp.
        """
        if not transform.child or not transform.parent or transform.child == transform.parent:
            raise ValueError("a transform needs two different frames")
        if not transform.is_pose:
            raise ValueError("the transform to {!r} has numbers that are no pose".format(transform.child[:80]))
        check_stamp(transform.secs, transform.nsecs)    # tf2 would end this process
        with self._lock:
            known = self._tree.latest(transform.child)
            if not fixed and known is not None and known[0][2:4] == transform[2:4]:
                return      # tf2 would print a warning for each repeated stamp
            if not fixed and known is not None and transform.stamp < known[0].stamp - HISTORY_S:
                self._forget()      # tf2 would take no other one before that time comes again
            for needed in self._tree.put(transform.child, transform.parent, (transform, fixed), fixed):
                self._feed(*needed)

    def lookup(self, frame: str, stamp: genpy.Time) -> Optional[Pose]:
        """Return the pose of a frame in the reference frame at `stamp`.

        Where the history does not cover the stamp, or it is none, the latest transform is taken. None if no
        chain of transforms connects the two.
        """
        return self.between(self._reference, frame, stamp)

    def between(self, target: str, frame: str, stamp: genpy.Time) -> Optional[Pose]:
        """Return the pose of a frame in another one than the reference, as lookup() does."""
        if frame == target:
            return Pose.identity()
        with self._lock:
            for needed in self._tree.follow(target) + self._tree.follow(frame):
                self._feed(*needed)
            for time in (stamp, genpy.Time()) if is_stamp(stamp.secs, stamp.nsecs) else (genpy.Time(),):
                try:
                    return pose_from_transform(self._buffer.lookup_transform_core(target, frame, time))
                except tf2_py.ExtrapolationException:
                    continue
                except (tf2_py.TransformException, ValueError):
                    return None
        return None

    def reset(self) -> None:
        """Forget all moving transforms, as after a time jump."""
        with self._lock:
            self._forget()

    @property
    def known(self) -> int:
        """Number of frames whose latest transform is kept."""
        with self._lock:
            return len(self._tree)

    @property
    def relevant(self) -> Set[str]:
        """Frames whose history is kept."""
        with self._lock:
            return self._tree.relevant

    def _forget(self) -> None:
        self._buffer.clear()
        for needed in self._tree.forget_moving():
            self._feed(*needed)

    def _feed(self, transform: RawTransform, fixed: bool) -> None:
        message = TransformStamped(child_frame_id=transform.child)
        message.header.frame_id = transform.parent
        message.header.stamp = genpy.Time(transform.secs, transform.nsecs)
        position, turn = message.transform.translation, message.transform.rotation
        position.x, position.y, position.z = transform.translation
        turn.x, turn.y, turn.z, turn.w = transform.rotation
        if fixed:
            self._buffer.set_transform_static(message, "robot_frames")
        else:
            self._buffer.set_transform(message, "robot_frames")


class RobotFrameFeed(RobotFrames):
    """The same with its own ears: listens to /tf and /tf_static, and passes over the frames of humans.

    own: take the transforms that this node sends itself, too.
    """

    def __init__(self, reference: str, own: bool = False) -> None:
        super().__init__(reference)
        self._ears = TfFeed(self._take, skip=SKELETONS, own=own)

    def close(self) -> None:
        """Stop listening. Idempotent."""
        self._ears.close()

    def _take(self, data: bytes, frames: Frames, fixed: bool) -> None:
        for child, offset in frames:
            if not is_of_human(child, fixed):
                self.put(read(data, offset), fixed)
