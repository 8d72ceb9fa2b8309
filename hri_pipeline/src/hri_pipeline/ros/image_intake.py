"""The newest image of a camera, with its camera model."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Callable, Dict, Optional, Tuple, Union

import numpy as np
import rospy
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import Header

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.images import ImageError
from hri_pipeline.ros.camera_feed import CameraFeed
from hri_pipeline.ros.conversions import compressed_to_bgr, image_to_bgr
from hri_pipeline.ros.depth_intake import DepthIntake
from hri_pipeline.ros.diagnostics import ERROR, OK, WARN
from hri_pipeline.ros.topic_release import release

# Larger than an image: with rospy's 64 kB, images pile up in the socket while the worker is busy.
BUFFER_BYTES = 2 ** 24
# Stamps that go back further than this are a new run of a bag; less is an image that came late.
JUMP_S = 1.0
# How long the first image waits for its camera_info.
INFO_GRACE_S = 1.0
SILENCE_S = 3.0
# Whose images are used is heard alone, until nothing has come from there for so long.
SENDER_S = 1.0
_LOG_PERIOD_S = 10.0
_NEW_PROBLEM_S = 1.0

ImageMessage = Union[Image, CompressedImage]


@dataclass(frozen=True)
class Frame:
    """One image to work on.

    bgr: (H, W, 3) uint8. stamp: s, that of header. header: goes with every output that is made of this image.
    depth: (h, w) float32 m, registered to bgr, NaN where unknown; None without one.
    """

    bgr: np.ndarray
    camera: CameraModel
    stamp: float
    header: Header
    depth: Optional[np.ndarray] = None


class ImageIntake:
    """Keeps the newest message of `image` (or `image/compressed`) and the latest of `camera_info`.

    The callback only stores; `next` decodes in the thread of the worker. An image that is not newer than the
    last one is skipped; stamps that go back by more than JUMP_S call on_time_jump and go on from there. An
    image without stamp gets the time of its arrival, as equal stamps would stop every track. Images of one publisher
    are heard at a time: the first one whose images can be read, while it sends.
    fallback_hfov: rad, used without a calibration; fov_parameter: its name, for the messages. depth: where the depth
    images come from, None for none; it is closed with the intake.
    """

    def __init__(
        self,
        transport: str = "raw",
        fallback_hfov: float = 1.047,
        fov_parameter: str = "~fallback_fov",
        on_time_jump: Optional[Callable[[], None]] = None,
        depth: Optional[DepthIntake] = None,
    ) -> None:
        kinds = {"raw": ("image", Image), "compressed": ("image/compressed", CompressedImage)}
        if transport not in kinds:
            raise ValueError("image transport is {!r}, known: {}".format(transport, ", ".join(kinds)))
        self.on_time_jump = on_time_jump
        self._depth = depth
        self._decode = image_to_bgr if transport == "raw" else compressed_to_bgr
        self._condition = threading.Condition()
        self._message: Optional[ImageMessage] = None
        self._last_stamp: Optional[float] = None
        self._problem: Tuple[int, str] = (OK, "")
        self._told: Tuple[str, float] = ("", float("-inf"))
        self._heard = self._started = time.monotonic()
        self._sender, self._sender_at = "", float("-inf")
        self._others: Dict[str, float] = {}
        self._first = 0.0
        self._closed = False
        self.counts: Dict[str, int] = {"received": 0, "taken": 0, "unreadable": 0, "late": 0, "time_jumps": 0}
        self._camera = CameraFeed(fallback_hfov, fov_parameter)
        name, kind = kinds[transport]
        self.topic = rospy.resolve_name(name)
        self._subscriber = rospy.Subscriber(
            name, kind, self._store, queue_size=1, buff_size=BUFFER_BYTES)

    def next(self, timeout: float) -> Optional[Frame]:
        """Return the newest image that has not been taken yet; None when none comes for `timeout` s."""
        deadline = time.monotonic() + timeout
        while not self._closed:
            message = self._take(deadline - time.monotonic())
            if message is None:
                self._warn_of_silence()
                return None
            frame = self._frame(message)
            if frame is not None:
                return frame
        return None

    def status(self) -> Tuple[int, str, Dict[str, object]]:
        """Return level, message and values for diagnostics."""
        values: Dict[str, object] = {"topic": self.topic}
        values.update(self.counts)
        values.update(self._camera.values())
        silent = self._silence()
        if silent:
            return ERROR, silent, values
        level, text = self._problem
        if level == OK:
            other = self._other_sender()
            level, text = (WARN, other) if other else self._camera.problem
        if self._depth is not None:
            depth_level, depth_text, depth_values = self._depth.status()
            values.update(depth_values)
            level, text = (level, text) if level != OK else (depth_level, depth_text)
        return level, text or "images come in", values

    def close(self) -> None:
        """Stop listening; a `next` that waits returns None. Idempotent."""
        with self._condition:
            if self._closed:
                return
            self._closed = True
            self._message = None
            self._condition.notify_all()
        release(self._subscriber)
        self._camera.close()
        if self._depth is not None:
            self._depth.close()

    def _store(self, message: ImageMessage) -> None:
        with self._condition:
            if not self._is_heard(_sender_of(message), time.monotonic()):
                return
            self._heard = time.monotonic()
            self._first = self._first or self._heard
            self.counts["received"] += 1
            self._message = message
            self._condition.notify()

    def _is_heard(self, sender: str, now: float) -> bool:
        if sender == self._sender:
            self._sender_at = now
        elif self._sender and now - self._sender_at < SENDER_S:
            self._others[sender] = now
            return False
        return True

    def _use(self, sender: str, is_readable: bool) -> None:
        """Hear this sender alone from now on; one whose images cannot be read has no right to that."""
        with self._condition:
            if is_readable and sender != self._sender:
                self._sender, self._sender_at = sender, time.monotonic()
            elif not is_readable and sender == self._sender:
                self._sender = ""

    def _other_sender(self) -> str:
        """Who sends on the same topic and is not heard."""
        with self._condition:
            recent = sorted(name for name, at in self._others.items() if time.monotonic() - at < SILENCE_S)
            self._others = {name: self._others[name] for name in recent}
        if not recent:
            return ""
        return "{}: {} sends too, only {} is heard; give each camera its own topic".format(self.topic, ", ".join(recent), self._sender)

    def _take(self, timeout: float) -> Optional[ImageMessage]:
        with self._condition:
            self._condition.wait_for(lambda: self._closed or self._message is not None, max(0.0, timeout))
            message, self._message = self._message, None
            return message

    def _frame(self, message: ImageMessage) -> Optional[Frame]:
        header = self._stamped(message.header)
        if header is None:
            return None
        self._camera.wait(self._first + INFO_GRACE_S - time.monotonic())
        try:
            bgr = self._decode(message)
        except ImageError as error:
            self._use(_sender_of(message), False)
            self.counts["unreadable"] += 1
            self._problem = (ERROR, "{}: {}".format(self.topic, error))
            self._tell(self._problem[1])
            return None
        self._use(_sender_of(message), True)
        self._problem = (OK, "")
        camera = self._camera.model(bgr.shape[1], bgr.shape[0])
        self._last_stamp = header.stamp.to_sec()
        self.counts["taken"] += 1
        depth = None
        if self._depth is not None:
            depth = self._depth.match(self._last_stamp, bgr.shape[1], bgr.shape[0])
        return Frame(bgr, camera, self._last_stamp, header, depth)

    def _tell(self, problem: str) -> None:
        """Log a problem with an image: a new one soon, the same one now and then."""
        told, at = self._told
        if time.monotonic() - at > (_LOG_PERIOD_S if problem == told else _NEW_PROBLEM_S):
            rospy.logerr("%s; such images are skipped", problem)
            self._told = (problem, time.monotonic())

    def _stamped(self, header: Header) -> Optional[Header]:
        """Return the header with a stamp, or None for an image that is not newer than the last one."""
        if header.stamp.is_zero():
            rospy.logwarn_throttle(_LOG_PERIOD_S, "%s: images have no stamp; the time of arrival is used instead. "
                                   "Mend: let the camera driver set header.stamp", self.topic)
            now = rospy.Time.now()
            header.stamp = rospy.Time.from_sec(time.time()) if now.is_zero() else now
        if self._last_stamp is None:
            return header
        step = header.stamp.to_sec() - self._last_stamp
        if step < -JUMP_S:
            self.counts["time_jumps"] += 1
            rospy.logwarn("%s: time has gone back by %.1f s (a bag that loops?); tracks start anew", self.topic, -step)
            self._last_stamp = None
            if self._depth is not None:
                self._depth.reset()
            if self.on_time_jump is not None:
                self.on_time_jump()
            return header
        if step <= 0.0:
            self.counts["late"] += 1
            return None
        return header

    def _silence(self) -> str:
        """Why no image comes, empty while they do."""
        silent = time.monotonic() - self._heard
        if silent < SILENCE_S or self._closed:
            return ""
        if not self._subscriber.get_num_connections():
            return "no publisher on {} for {:.0f} s; start the camera or remap `image`".format(self.topic, silent)
        return "no image on {} for {:.0f} s, although it has a publisher; is the camera running?".format(
            self.topic, silent)

    def _warn_of_silence(self) -> None:
        text = self._silence()
        if text:
            rospy.logwarn_throttle(_LOG_PERIOD_S, "%s", text)


def intake_of(settings: SimpleNamespace) -> ImageIntake:
    """Return the intake of a node with CAMERA_PARAMETERS and DEPTH_PARAMETERS."""
    depth = DepthIntake(settings.depth_slop) if settings.use_depth else None
    return ImageIntake(settings.image_transport, settings.fallback_fov, "~fallback_fov", depth=depth)


def _sender_of(message: ImageMessage) -> str:
    return str(getattr(message, "_connection_header", {}).get("callerid", ""))
