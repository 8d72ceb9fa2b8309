"""The depth image of a vision node: of all that come, the one that belongs to an image."""

from __future__ import annotations

import threading
import time
from collections import deque
from typing import Deque, Dict, Optional

import numpy as np
import rospy
from sensor_msgs.msg import Image

from hri_pipeline.core.error_log import Outage
from hri_pipeline.core.images import ASPECT_TOLERANCE, DEPTH_RANGE, ImageError, depth_from_raw
from hri_pipeline.ros.diagnostics import OK, WARN, Status
from hri_pipeline.ros.rospy_compat import release
from hri_pipeline.ros.sensor_input import CALM_S, CarriedType
from hri_pipeline.ros.tcpros import ReceivedImage, receive_without_copies

DEPTH_SILENCE_S = 5.0
"""Time (s) without a depth image for any colour image after which the status says so."""
# A depth image may come a little after its colour image; a camera that sends none is not waited for.
_PATIENCE_S = 0.08
_ALIVE_S = 1.0
_QUEUE = 8
# So many depth images tell how soon the next one comes.
_ENOUGH = 4
_MEANWHILE = "bodies are placed by the colour image alone"


class DepthInput:
    """Keeps the latest messages of `depth`, a depth image registered to the colour image (REP-118).

    The callback only stores, eight messages at most; `match` decodes the one that belongs to an image, in the thread of
    the worker.

    Parameters
    ----------
    slop : float
        Largest difference of the stamps, s.

    Raises
    ------
    ValueError
        For a slop out of 0 to 10 s.
    """

    def __init__(self, slop: float) -> None:
        if not 0.0 <= slop < 10.0:
            raise ValueError("~depth_slop is {} s, legal range 0 to 10".format(slop))
        self._slop = slop
        self._slop_parameter = rospy.resolve_name("~depth_slop")
        self._image_topic = rospy.resolve_name("image")
        self.topic = rospy.resolve_name("depth")
        self._condition = threading.Condition()
        self._messages: Deque[Image] = deque(maxlen=_QUEUE)
        self._stamps: Deque[float] = deque(maxlen=_QUEUE)
        self._heard = float("-inf")
        self._matched = time.monotonic()
        self._nearest: Optional[float] = None
        self._unusable = self._elsewhere = ""
        self._outage = Outage(CALM_S)
        self._closed = False
        self.counts: Dict[str, int] = {"depth_received": 0, "depth_used": 0, "depth_missing": 0, "depth_unreadable": 0}
        receive_without_copies()
        self._subscriber = rospy.Subscriber("depth", ReceivedImage, self._store, queue_size=_QUEUE,
                                            buff_size=ReceivedImage.BUFFER_BYTES)
        self._carried = CarriedType(self._subscriber)

    def match(self, stamp: float, width: int, height: int, frame_id: str) -> Optional[np.ndarray]:
        """Return the depth image that belongs to a colour image; waits up to 0.08 s for one that may be on its way.

        One in another frame is used, too, as names may differ by mistake, but told.

        Parameters
        ----------
        stamp : float
            Of the colour image, s.
        width, height : int
            Size of the colour image, px.
        frame_id : str
            Frame of the colour image.

        Returns
        -------
        numpy.ndarray, shape (h, w), float32, or None
            m, NaN where unknown; None without a depth image.
        """
        message = self._take(stamp)
        if message is None:
            self.counts["depth_missing"] += 1
        else:
            depth = self._decode(message, width, height)
            if depth is not None:
                self._compare(message.header.frame_id.lstrip("/"), frame_id)
                self.counts["depth_used"] += 1
                self._matched = time.monotonic()
                self._outage.there(self._matched)
                return depth
        problem = self.problem()
        if problem and self._outage.is_to_tell():
            rospy.logwarn("%s; %s", problem, _MEANWHILE)
        return None

    def problem(self) -> str:
        """Return why there is no depth, empty while there is."""
        if self._closed or self._unusable:
            return self._unusable
        now = time.monotonic()
        silent = now - self._matched
        if silent < DEPTH_SILENCE_S:
            return ""
        if now - self._heard > DEPTH_SILENCE_S:
            wrong = self._carried.problem()
            if wrong:
                return "no depth on {} for {:.0f} s: {}".format(self.topic, silent, wrong)
            missing = "no message" if self._subscriber.get_num_connections() else "no publisher"
            return "{} on {} for {:.0f} s; start the depth camera, remap `depth`, or set use_depth to false".format(
                missing, self.topic, silent)
        nearest = "" if self._nearest is None else ", the nearest was {:.3f} s off".format(self._nearest)
        return "{} and {} do not synchronise: no pair within {} = {:g} s for {:.0f} s{}; raise that parameter or " \
            "let the driver synchronise them".format(
                self._image_topic, self.topic, self._slop_parameter, self._slop, silent, nearest)

    def status(self) -> Status:
        """Return level, message and values for diagnostics."""
        values: Dict[str, object] = {"depth_topic": self.topic}
        values.update(self.counts)
        problem = self.problem()
        if problem:
            return WARN, "{}; {}".format(problem, _MEANWHILE), values
        return WARN if self._elsewhere else OK, self._elsewhere, values

    def reset(self) -> None:
        """Forget the messages: time has jumped back."""
        with self._condition:
            self._messages.clear()
            self._stamps.clear()

    def close(self) -> None:
        """Stop listening; a `match` that waits returns None. Idempotent."""
        with self._condition:
            if self._closed:
                return
            self._closed = True
            self._messages.clear()
            self._condition.notify_all()
        release(self._subscriber)

    def _store(self, message: Image) -> None:
        with self._condition:
            if self._closed:
                return
            self._heard = time.monotonic()
            self.counts["depth_received"] += 1
            if message.header.stamp.is_zero():
                # As images without stamp: by the time of their arrival.
                message.header.stamp = rospy.Time.now()
            self._messages.append(message)
            self._stamps.append(message.header.stamp.to_sec())
            self._condition.notify_all()

    def _take(self, stamp: float) -> Optional[Image]:
        """Return the message nearest to `stamp` within the slop and forget those before it."""
        deadline = time.monotonic() + _PATIENCE_S
        with self._condition:
            while not self._closed:
                best = min(self._messages, key=lambda message: _offset(message, stamp), default=None)
                self._nearest = self._nearest if best is None else _offset(best, stamp)
                if best is not None and _offset(best, stamp) <= self._slop + 1e-9:
                    while self._messages and self._messages[0] is not best:
                        self._messages.popleft()
                    return best
                now = time.monotonic()
                late = any(message.header.stamp.to_sec() > stamp for message in self._messages)
                if late or now >= deadline or now - self._heard > _ALIVE_S or self._next_stamp() > stamp + self._slop:
                    return None
                self._condition.wait(deadline - now)
        return None

    def _next_stamp(self) -> float:
        """Return the earliest stamp (s) that the next depth image will have by the last ones, -inf while they tell
        nothing: a camera that measures depth more seldom than colour is not waited for in between."""
        stamps = list(self._stamps)
        least = min((after - before for before, after in zip(stamps, stamps[1:])), default=0.0)
        return stamps[-1] + least if len(stamps) >= _ENOUGH and least > 0.0 else float("-inf")

    def _compare(self, depth_frame: str, frame_id: str) -> None:
        """Tell when the depth image is in another frame than the image."""
        told = self._elsewhere
        self._elsewhere = "" if depth_frame == frame_id else (
            "{}: depth is in the frame {!r}, images are in {!r}: is it registered to colour? If not, people are placed "
            "by what is beside them; use the registered topic of the driver".format(self.topic, depth_frame, frame_id))
        if self._elsewhere and self._elsewhere != told:
            rospy.logwarn("%s", self._elsewhere)

    def _decode(self, message: Image, width: int, height: int) -> Optional[np.ndarray]:
        try:
            depth = depth_from_raw(message.data, message.width, message.height, message.step, message.encoding,
                                   bool(message.is_bigendian))
            ratio = (message.width / message.height) / (width / height)
            if abs(ratio - 1.0) > ASPECT_TOLERANCE:
                raise ImageError("{}x{} px is another shape than that of the images, {}x{}: use the topic that is"
                                 " registered to colour".format(message.width, message.height, width, height))
            if not np.isfinite(depth).any():
                raise ImageError("no pixel of {} is a distance of {:g} to {:g} m; 16UC1 is in mm, 32FC1 in m".format(
                    message.encoding, *DEPTH_RANGE))
        except ImageError as error:
            self.counts["depth_unreadable"] += 1
            self._unusable = "{}: {}".format(self.topic, error)
            return None
        self._unusable = ""
        return depth


def _offset(message: Image, stamp: float) -> float:
    return abs(message.header.stamp.to_sec() - stamp)
