"""The depth image that belongs to a colour image."""

from __future__ import annotations

import threading
import time
from collections import deque
from typing import Deque, Dict, Optional, Tuple

import numpy as np
import rospy
from sensor_msgs.msg import Image

from hri_pipeline.core.depth import depth_from_raw
from hri_pipeline.core.images import ImageError
from hri_pipeline.ros.diagnostics import OK, WARN
from hri_pipeline.ros.topic_release import release

BUFFER_BYTES = 2 ** 24
SILENCE_S = 5.0
"""Time (s) without a depth image for any colour image after which it is told."""
# A depth image may come a little after its colour image; a camera that sends none is not waited for.
_PATIENCE_S = 0.08
_ALIVE_S = 1.0
_QUEUE = 8
_ASPECT_TOLERANCE = 0.02
_LOG_PERIOD_S = 30.0
_MEANWHILE = "bodies are placed by the colour image alone"


class DepthIntake:
    """Keeps the latest messages of `depth`, a depth image registered to the colour image (REP-118).

    The callback only stores, eight messages at most; `match` decodes the one that goes with an image, in the thread of
    the worker. slop: largest difference of the stamps, s. image_topic, slop_parameter: names for the messages.
    """

    def __init__(self, slop: float, image_topic: str = "image", slop_parameter: str = "~depth_slop") -> None:
        if not 0.0 <= slop < 10.0:
            raise ValueError("{} is {} s, legal range 0 to 10".format(slop_parameter, slop))
        self._slop = slop
        self._slop_parameter = rospy.resolve_name(slop_parameter)
        self._image_topic = rospy.resolve_name(image_topic)
        self.topic = rospy.resolve_name("depth")
        self._condition = threading.Condition()
        self._messages: Deque[Image] = deque(maxlen=_QUEUE)
        self._heard = float("-inf")
        self._matched = time.monotonic()
        self._nearest: Optional[float] = None
        self._unusable = ""
        self._closed = False
        self.counts: Dict[str, int] = {"depth_received": 0, "depth_used": 0, "depth_missing": 0, "depth_unreadable": 0}
        self._subscriber = rospy.Subscriber("depth", Image, self._store, queue_size=_QUEUE, buff_size=BUFFER_BYTES)

    def match(self, stamp: float, width: int, height: int) -> Optional[np.ndarray]:
        """Depth (h, w) m, NaN where unknown, of the image of `stamp` (s), which is width x height px; None without one.

        Waits up to 0.08 s for a depth image that may be on its way.
        """
        message = self._take(stamp)
        if message is None:
            self.counts["depth_missing"] += 1
        else:
            depth = self._decode(message, width, height)
            if depth is not None:
                self.counts["depth_used"] += 1
                self._matched = time.monotonic()
                return depth
        problem = self.problem()
        if problem:
            rospy.logwarn_throttle(_LOG_PERIOD_S, "%s; %s", problem, _MEANWHILE)
        return None

    def problem(self) -> str:
        """Why there is no depth, empty while there is."""
        if self._closed or self._unusable:
            return self._unusable
        now = time.monotonic()
        silent = now - self._matched
        if silent < SILENCE_S:
            return ""
        if now - self._heard > SILENCE_S:
            missing = "no message" if self._subscriber.get_num_connections() else "no publisher"
            return "{} on {} for {:.0f} s; start the depth camera, remap `depth`, or set use_depth to false".format(
                missing, self.topic, silent)
        nearest = "" if self._nearest is None else ", the nearest was {:.3f} s off".format(self._nearest)
        return "{} and {} do not synchronise: no pair within {} = {:g} s for {:.0f} s{}; raise that parameter or " \
            "let the driver synchronise them".format(
                self._image_topic, self.topic, self._slop_parameter, self._slop, silent, nearest)

    def status(self) -> Tuple[int, str, Dict[str, object]]:
        """Return level, message and values for diagnostics."""
        values: Dict[str, object] = {"depth_topic": self.topic}
        values.update(self.counts)
        problem = self.problem()
        return (WARN, "{}; {}".format(problem, _MEANWHILE), values) if problem else (OK, "", values)

    def reset(self) -> None:
        """Forget the messages: time has jumped back."""
        with self._condition:
            self._messages.clear()

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
            self._messages.append(message)
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
                if late or now >= deadline or now - self._heard > _ALIVE_S:
                    return None
                self._condition.wait(deadline - now)
        return None

    def _decode(self, message: Image, width: int, height: int) -> Optional[np.ndarray]:
        try:
            depth = depth_from_raw(message.data, message.width, message.height, message.step, message.encoding,
                                   bool(message.is_bigendian))
            ratio = (message.width / message.height) / (width / height)
            if abs(ratio - 1.0) > _ASPECT_TOLERANCE:
                raise ImageError("{}x{} px is another shape than that of the images, {}x{}: use the topic that is"
                                 " registered to colour".format(message.width, message.height, width, height))
        except ImageError as error:
            self.counts["depth_unreadable"] += 1
            self._unusable = "{}: {}".format(self.topic, error)
            return None
        self._unusable = ""
        return depth


def _offset(message: Image, stamp: float) -> float:
    return abs(message.header.stamp.to_sec() - stamp)
