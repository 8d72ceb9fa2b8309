"""Listens to /tf and /tf_static without making message objects of what nobody here needs."""

from __future__ import annotations

from typing import Callable, List, Optional, Tuple

import rospy

from hri_pipeline.core.tf_scan import scan
from hri_pipeline.ros.topic_release import release

_LOG_PERIOD_S = 10.0

Frames = List[Tuple[bytes, int]]


class TfFeed:
    """Calls on_frames(data, frames, fixed) in rospy's thread for each message of another node.

    frames: (child frame, offset) of each transform; tf_scan.read(data, offset) gives the transform itself.
    fixed: it came on /tf_static. A message that is no TFMessage is told and counted in `refused`. So is a transform that
    on_frames refuses by a ValueError; the others of its message are then given to it one by one. skip: messages of nodes
    whose name starts so are not even looked at. own: take those of this node as well.
    """

    def __init__(self, on_frames: Callable[[bytes, Frames, bool], None], skip: Optional[str] = None,
                 own: bool = False) -> None:
        self._on_frames = on_frames
        self._skip = skip
        self._name = "" if own else rospy.get_name()
        self.refused = 0
        self._moving = rospy.Subscriber("/tf", rospy.AnyMsg, self._take, callback_args=False,
                                        queue_size=100, buff_size=2 ** 20, tcp_nodelay=True)
        self._static = rospy.Subscriber("/tf_static", rospy.AnyMsg, self._take, callback_args=True, queue_size=100)

    def close(self) -> None:
        """Let go of both topics. Idempotent."""
        release(self._moving)
        release(self._static)

    def _take(self, message: rospy.AnyMsg, fixed: bool) -> None:
        caller = message._connection_header.get("callerid", "")
        if caller == self._name or (self._skip is not None and caller.startswith(self._skip)):
            return
        frames: Frames = []
        try:
            frames = scan(message._buff)
            self._on_frames(message._buff, frames, fixed)
        except ValueError as error:
            if len(frames) < 2:
                self._refuse(caller, error)
            else:
                self._take_singly(caller, message._buff, frames, fixed)

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
