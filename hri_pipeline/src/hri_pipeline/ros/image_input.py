"""Inputs of a vision node: the newest image of a camera, and its camera model."""

from __future__ import annotations

import math
import threading
import time
from array import array
from collections import OrderedDict, deque
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Callable, Deque, Dict, Optional, Tuple, Union

import numpy as np
import rospy
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_msgs.msg import Header

from hri_pipeline.core.camera import Calibration, CameraError, CameraModel
from hri_pipeline.core.faces.parameters import DepthCameraSettings
from hri_pipeline.core.image_rotation import ImageRotation
from hri_pipeline.core.images import (
    ASPECT_TOLERANCE,
    GreyBits,
    ImageError,
    is_rectified,
    other_transport,
    picture_fault,
)
from hri_pipeline.core.timing import clock_fault
from hri_pipeline.ros.conversions import camera_from_info, compressed_to_bgr, image_to_bgr
from hri_pipeline.ros.depth_input import DepthInput
from hri_pipeline.ros.diagnostics import ERROR, OK, WARN, Status
from hri_pipeline.ros.master import IMAGE_TYPES, is_published
from hri_pipeline.ros.rospy_compat import release, sender_of
from hri_pipeline.ros.sensor_input import LOG_PERIOD_S, SensorInput
from hri_pipeline.ros.tcpros import ReceivedImage, receive_without_copies

# Larger than an image: with rospy's 64 kB, images pile up in the socket while the worker is busy.
BUFFER_BYTES = 2 ** 24
# Stamps that go back further than this are a new run of a bag; less is an image that came late.
JUMP_S = 1.0
# An image whose stamp differs by more from the time of its arrival comes from another clock, or over a slow network.
MOST_AGE_S = 2.0
_CLOCKS = "{}: images are {}, so that rviz and tf do not show people where they are now; {}"
# How long the master is waited for.
_MASTER_S = 1.0
# How long the first image waits for its camera_info.
INFO_GRACE_S = 1.0
# Images of other publishers are ignored until the one that is used has sent nothing for so long.
SENDER_S = 1.0
# Images that came first may have been on their way for long: of jumps forward they tell nothing.
_SETTLED_S = 2.0
# Longer than JUMP_S: images that only came late, and a stamp that went back a little, pass.
_STANDSTILL_S = 2.0
# How often it is looked whether images show anything, and how often they have shown too little before it is told.
_BLANK_PERIOD_S = 1.0
_MOST_BLANK = 2
_CAMERA_LOG_PERIOD_S = 30.0
_MOST_INFOS = 8
# A camera that zooms tells another camera_info with each image: so many of one sender are kept, and so long (s) one
# holds until the next.
_MOST_KEPT, _HOLDS_S = 30, 1.0

ImageMessage = Union[Image, CompressedImage]


@dataclass(frozen=True)
class Frame:
    """One image to work on.

    bgr: (H, W, 3) uint8. stamp: s, that of header. header: goes with every output that is made of this image.
    depth: (h, w) float32 m, registered to bgr, NaN where unknown; None without one. quarters: quarter turns clockwise
    that make it upright; by_gravity: whether gravity tells them.
    overtaken: tells whether the time has gone back since; what is found in the image is not to be published then, as
    frames of the future hide all later ones in the buffers of tf2.
    """

    bgr: np.ndarray
    camera: CameraModel
    stamp: float
    header: Header
    depth: Optional[np.ndarray] = None
    overtaken: Callable[[], bool] = lambda: False
    quarters: int = 0
    by_gravity: bool = False

    @cached_property
    def rotation(self) -> ImageRotation:
        """The turn that makes the image upright."""
        return ImageRotation(self.quarters, self.bgr.shape[1], self.bgr.shape[0])

    @cached_property
    def upright(self) -> Frame:
        """The frame with image, camera and depth image turned, made once; itself where nothing is turned."""
        if not self.quarters:
            return self
        turn = self.rotation
        return Frame(turn.image(self.bgr), turn.camera(self.camera), self.stamp, self.header,
                     None if self.depth is None else turn.image(self.depth))


class ImageInput(SensorInput):
    """Keeps the newest message of `image` (or `image/compressed`) and the latest of `camera_info`.

    The callback only stores; `next` decodes in the thread of the worker. An image that is not newer than the last one
    is skipped. When stamps go back by more than JUMP_S, on_restart is called, and the new stamps are accepted; it is
    called, too, before an image of another size, or in another frame, than the last one. An image without stamp gets
    the time of its arrival, as equal stamps would stop every track. A leading slash of the frame is left out, as tf2
    refuses such names. One publisher is used at a time (OneSender).

    Parameters
    ----------
    transport : str
        raw or compressed.
    fallback_hfov : float
        Horizontal field of view, rad, of a camera without calibration.
    fov_parameter : str
        Name of the parameter that holds it, for texts.
    on_restart : callable, optional
        Called when what was seen before says nothing of the images that come now.
    depth : DepthInput, optional
        Input of the depth images; it is closed with this input.

    Raises
    ------
    ValueError
        For another transport, or a field of view out of 0 to pi.
    """

    def __init__(
        self,
        transport: str = "raw",
        fallback_hfov: float = 1.047,
        fov_parameter: str = "~fallback_fov",
        on_restart: Optional[Callable[[], None]] = None,
        depth: Optional[DepthInput] = None,
    ) -> None:
        kinds = {"raw": ("image", ReceivedImage, ReceivedImage.BUFFER_BYTES),
                 "compressed": ("image/compressed", CompressedImage, BUFFER_BYTES)}
        if transport not in kinds:
            raise ValueError("image transport is {!r}, known: {}".format(transport, ", ".join(kinds)))
        name, kind, buffer_bytes = kinds[transport]
        super().__init__(name, "image", "camera", ("start the camera or remap `image`", "is the camera running?"),
                         SENDER_S)
        self.on_restart = on_restart
        self._depth = depth
        self._grey = GreyBits()
        self._decode = image_to_bgr if transport == "raw" else compressed_to_bgr
        self._message: Optional[ImageMessage] = None
        self._owed = False      # an image was wanted and could not be used
        self._last_stamp: Optional[float] = None
        # When the newest image and the last one that was taken came: s, of the monotonic clock and of ROS.
        self._arrival = self._came = self._taken_at = (0.0, 0.0)
        # The least lags so far of arrivals behind the stamps, s, by those clocks.
        self._lags = (math.inf, math.inf)
        self._frame_id: Optional[str] = None
        self._size: Optional[Tuple[int, int]] = None
        self._changed: Tuple[str, float] = ("", -math.inf)
        self._problem: Tuple[int, str] = (OK, "")
        self._clock_problem = ""
        self._age = 0.0
        self.counts: Dict[str, int] = {"received": 0, "taken": 0, "unreadable": 0, "late": 0, "time_jumps": 0,
                                       "forward_jumps": 0, "size_changes": 0}
        self._asked = self._compared = float("-inf")
        self._blank: Tuple[int, str] = (0, "")      # looks on end at which an image showed too little, and why
        self._camera = CameraInfoInput(fallback_hfov, fov_parameter, is_rectified(self.topic))
        receive_without_copies()
        self._subscribers = [rospy.Subscriber(name, kind, self._store, queue_size=1, buff_size=buffer_bytes)]

    def next(self, timeout: float, is_due: Optional[Callable[[float], bool]] = None) -> Optional[Frame]:
        """Return the newest image that has not been taken yet; None when none comes for `timeout` s.

        is_due: whether the image that came at a time (s, monotonic clock) is wanted; one that is not is left out at
        once, so that one that is wanted is never kept waiting. After one that cannot be used the next one is wanted.
        """
        deadline = time.monotonic() + timeout
        while not self._closed:
            message = self._take(deadline - time.monotonic())
            if message is None:
                self._warn_of_silence()
                return None
            if is_due is not None and not self._owed and not is_due(self._came[0]):
                continue
            self._owed = True
            frame = self._frame(message)
            self._owed = frame is None
            if frame is not None:
                return frame
        return None

    def status(self) -> Status:
        """Return level, message and values for diagnostics."""
        values: Dict[str, object] = {"topic": self.topic}
        values.update(self.counts)
        values.update(self._camera.values())
        silent = self._silence()
        values["images_arrive"] = not silent and self._first > 0.0
        if silent:
            return ERROR, silent, values
        level, text = self._problem
        if level == OK:
            text = (self._other_sender() or self._change_problem() or self._blank_problem() or self._camera.problem[1]
                    or self._clock_problem)
            level = WARN if text else OK
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
        release(self._subscribers[0])
        self._camera.close()
        if self._depth is not None:
            self._depth.close()

    def _mend(self) -> Tuple[str, str]:
        """Tell of images of the other transport; the master is asked every LOG_PERIOD_S, as long as none come."""
        topic, transport = other_transport(self.topic)
        if time.monotonic() > self._asked + LOG_PERIOD_S:
            self._elsewhere = topic if is_published(topic, IMAGE_TYPES[transport], _MASTER_S) else ""
            self._asked = time.monotonic()
        if not self._elsewhere:
            return super()._mend()
        return ", but {} is published".format(topic), "start with image_transport:={}".format(transport)

    def _store(self, message: ImageMessage) -> None:
        with self._condition:
            if not self._accepts(message):
                return
            self.counts["received"] += 1
            self._message = message
            now = rospy.get_time()
            self._arrival = (time.monotonic(), now)
            self._age = now - message.header.stamp.to_sec() if now > 0.0 else 0.0
            self._condition.notify()

    def _take(self, timeout: float) -> Optional[ImageMessage]:
        with self._condition:
            self._condition.wait_for(lambda: self._closed or self._message is not None, max(0.0, timeout))
            message, self._message = self._message, None
            self._came = self._arrival
            return message

    def _frame(self, message: ImageMessage) -> Optional[Frame]:
        header = self._stamped(message.header)
        if header is None:
            return None
        self._name_frame(header)
        self._warn("others", self._other_sender())
        self._camera.wait(self._first + INFO_GRACE_S - time.monotonic())
        try:
            bgr = self._decode(message, self._grey)
        except ImageError as error:
            with self._condition:
                self._senders.was_read(sender_of(message), False, time.monotonic())
            self.counts["unreadable"] += 1
            self._problem = (ERROR, "{}: {}".format(self.topic, error))
            self._tell(self._problem[1] + "; such images are skipped")
            return None
        with self._condition:
            self._senders.was_read(sender_of(message), True, time.monotonic())
        self._problem = (OK, "")
        self._compare_size((bgr.shape[1], bgr.shape[0]))
        if self._came[0] >= self._compared + _BLANK_PERIOD_S:
            self._compared = self._came[0]
            fault = picture_fault(bgr)
            self._blank = (self._blank[0] + 1 if fault else 0, fault)
        camera = self._camera.model(bgr.shape[1], bgr.shape[0], sender_of(message), header.frame_id,
                                    header.stamp.to_sec())
        self._last_stamp = stamp = header.stamp.to_sec()
        self._taken_at = self._came
        self.counts["taken"] += 1
        depth = None
        if self._depth is not None:
            depth = self._depth.match(stamp, bgr.shape[1], bgr.shape[0], header.frame_id)
        return Frame(bgr, camera, stamp, header, depth, partial(self._has_gone_back, stamp, self._came[1]))

    def _blank_problem(self) -> str:
        looks, fault = self._blank
        if looks < _MOST_BLANK:
            return ""
        return ("{}: {}: take the cap or what covers the lens away, switch the light on, let the camera expose longer; "
                "see it with: rqt_image_view {}".format(self.topic, fault, self.topic))

    def _has_gone_back(self, stamp: float, came: float) -> bool:
        """Tell whether the time has gone back since an image of `stamp` (s) came at `came` (s, ROS time)."""
        with self._condition:
            waiting = self._message.header.stamp.to_sec() if self._message is not None else 0.0
        return rospy.get_time() < came - JUMP_S or 0.0 < waiting < stamp - JUMP_S

    def _stamped(self, header: Header) -> Optional[Header]:
        """Return the header with a stamp, or None for an image that is not newer than the last one."""
        self._clock_problem = ""
        if header.stamp.is_zero():
            self._clock_problem = ("{}: images have no stamp; the time of arrival is used instead. Let the camera "
                                   "driver set header.stamp".format(self.topic))
            header.stamp = rospy.Time.from_sec(self._came[1] or time.time())
        elif abs(self._age) > MOST_AGE_S and not self._jumps_back(header):     # the clock may follow in a moment
            self._clock_problem = _CLOCKS.format(self.topic, *clock_fault(
                self._age, header.stamp.to_sec() + self._age, time.time(), not rospy.rostime.is_wallclock()))
        if self._clock_problem:
            rospy.logwarn_throttle(LOG_PERIOD_S, "%s", self._clock_problem)
        lags = (self._came[0] - header.stamp.to_sec(), self._came[1] - header.stamp.to_sec())
        if self._last_stamp is None:
            self._lags = lags
            return header
        step = header.stamp.to_sec() - self._last_stamp
        if self._jumps_back(header):
            self.counts["time_jumps"] += 1
            self._lags = lags
            rospy.logwarn_throttle(LOG_PERIOD_S, "%s: stamps have gone back by %.1f s (a bag that loops, or a clock "
                                   "that was set?); tracks start anew. Where this goes on, let one program only stamp "
                                   "these images", self.topic, -step)
            self._last_stamp = None
            if self._depth is not None:
                self._depth.reset()
            self._restart()
            return header
        if step <= 0.0:
            self.counts["late"] += 1
            if time.monotonic() - self._taken_at[0] > _STANDSTILL_S:
                self._problem = (ERROR, "{}: no image has a newer stamp than the last one; let the camera driver set "
                                 "header.stamp".format(self.topic))
                self._tell(self._problem[1])
            return None
        self._tell_of_jumps_forward(lags)
        return header

    def _jumps_back(self, header: Header) -> bool:
        return self._last_stamp is not None and header.stamp.to_sec() < self._last_stamp - JUMP_S

    def _tell_of_jumps_forward(self, lags: Tuple[float, float]) -> None:
        """Warn where an image's stamp is nearer to its arrival than that of any before it; lags: as self._lags."""
        # A stamp that is only nearer to its arrival than the one before comes after one that was late.
        ahead = min(least - lag for least, lag in zip(self._lags, lags))
        self._lags = (min(self._lags[0], lags[0]), min(self._lags[1], lags[1]))
        if ahead > JUMP_S and self._came[0] > self._first + _SETTLED_S:
            self.counts["forward_jumps"] += 1
            self._warn("forward", "{}: stamps have gone forward by {:.1f} s more than the time (a cut recording, or a "
                       "camera whose clock was set?); who was seen before may get a new id".format(self.topic, ahead))

    def _compare_size(self, size: Tuple[int, int]) -> None:
        """Start anew where an image has another size (width, height) px than the last one: what was at a pixel is
        elsewhere, and a body would take the place of who stands there now, with its own id."""
        before, self._size = self._size, size
        if before in (None, size):
            return
        self.counts["size_changes"] += 1
        text = "{}: images are {}x{} px now, before {}x{}: tracks start anew, and who is not recognised gets a new " \
            "id; one topic is to carry images of one size".format(self.topic, *size, *before)
        self._tell_change("size", text)

    def _tell_change(self, kind: str, text: str) -> None:
        """Start anew, and say why."""
        self._changed = text, time.monotonic()
        self._warn(kind, text)
        self._restart()

    def _change_problem(self) -> str:
        """Return what was said of a change of size or frame a moment ago, empty without one."""
        return self._changed[0] if time.monotonic() - self._changed[1] < LOG_PERIOD_S else ""

    def _name_frame(self, header: Header) -> None:
        """Leave out a leading slash of the frame, and tell when the frame is another one than before."""
        given = header.frame_id
        header.frame_id = given.lstrip("/")
        if given == self._frame_id:
            return
        if header.frame_id != given:
            self._warn("slash", "{}: the frame_id {!r} begins with a slash, which tf2 refuses; {!r} is used. Set the "
                       "camera driver's frame_id".format(self.topic, given, header.frame_id))
        if self._frame_id is not None and header.frame_id != self._frame_id.lstrip("/"):
            self._tell_change("frame", "{}: images are in the frame {!r} now, before in {!r}: tracks start anew; one "
                              "topic is to carry the images of one camera".format(self.topic, given, self._frame_id))
        self._frame_id = given

    def _restart(self) -> None:
        if self.on_restart is not None:
            self.on_restart()


def image_input_of(settings: DepthCameraSettings) -> ImageInput:
    """Return the image input of a node."""
    depth = DepthInput(settings.depth_slop) if settings.use_depth else None
    return ImageInput(settings.image_transport, settings.fallback_fov, "~fallback_fov", depth=depth)


class CameraInfoInput:
    """Subscribes to `camera_info`; there is always a model, and `problem` says what is wrong with it.

    Parameters
    ----------
    fallback_hfov : float
        Horizontal field of view, rad, used when camera_info is missing, all zero or impossible.
    fov_parameter : str
        Name of the parameter that holds it, for texts.
    rectified : bool
        The images are.

    Raises
    ------
    ValueError
        For a field of view out of 0 to pi.
    """

    def __init__(self, fallback_hfov: float, fov_parameter: str, rectified: bool = False) -> None:
        if not 0.0 < fallback_hfov < math.pi:
            raise ValueError("{} is {} rad, legal range 0 to pi".format(fov_parameter, fallback_hfov))
        self._hfov, self._rectified = fallback_hfov, rectified
        self._hint = "using the field of view {} = {:.3f} rad; distances are only as good as that".format(
            rospy.resolve_name(fov_parameter), fallback_hfov)
        self._lock = threading.Lock()
        self._infos: "OrderedDict[str, Deque[CameraInfo]]" = OrderedDict()
        self._key: Optional[tuple] = None
        self._model: Optional[CameraModel] = None
        self._say_at = self._zoom_said_at = 0.0
        self._heard = threading.Event()
        self._closed = False
        self.problem: Tuple[int, str] = (OK, "")
        self.topic = rospy.resolve_name("camera_info")
        self._subscriber = rospy.Subscriber("camera_info", CameraInfo, self._store, queue_size=1)

    def wait(self, timeout: float) -> bool:
        """Wait until the first camera_info has come, timeout s at most; tell whether it has."""
        return self._heard.wait(max(0.0, timeout))

    @property
    def newest(self) -> Optional[CameraInfo]:
        """The camera_info that came last, None before the first one."""
        return self._held()

    def _held(self, sender: str = "", stamp: float = math.inf) -> Optional[CameraInfo]:
        """The camera_info of a sender, else of that which sent last, that held at `stamp` (s): the last one until then,
        the newest where none is of so lately, as by another clock; None before the first one."""
        with self._lock:
            infos = self._infos.get(sender) or next(reversed(list(self._infos.values())), None)
            if infos is None:
                return None
            stamps = ((info, info.header.stamp.to_sec()) for info in reversed(infos))
            return next((info for info, its in stamps if stamp - _HOLDS_S < its <= stamp), infos[-1])

    def model(self, width: int, height: int, sender: str = "", frame: str = "",
              stamp: float = math.inf) -> CameraModel:
        """Return the model for an image of width x height px.

        It is made of the camera_info of the node that sends the images, `sender`, else of the one that came last, as it
        was at the image's `stamp` (s). frame: that of the images.
        """
        info = self._held(sender, stamp)
        key = (width, height, frame) + (_key(info) if info is not None else ())
        if key != self._key or self._model is None:
            before = self._model
            self._model, text = self._build(info, width, height)
            text = text or self._other_frame(info, frame)
            self._tell_change(before, self._model)
            if text != self.problem[1]:
                self._say_at = 0.0
            self.problem = (WARN, text) if text else (OK, "")
            self._key = key
        if self.problem[1] and time.monotonic() >= self._say_at:
            self._say_at = time.monotonic() + _CAMERA_LOG_PERIOD_S
            rospy.logwarn("%s", self.problem[1])
        return self._model

    def _tell_change(self, before: Optional[CameraModel], now: CameraModel) -> None:
        """Log that a camera is calibrated, or has another focal length, from now on; of one that zooms not each."""
        if before is None or not now.is_calibrated:
            return
        focal, was = float(now.matrix[0, 0]), float(before.matrix[0, 0])
        if not before.is_calibrated:
            rospy.loginfo("%s: the camera is calibrated from now on, focal length %.0f px; people are at other places "
                          "than before", self.topic, focal)
        elif (before.width, before.height) == (now.width, now.height) and now.is_told_anew(before) and (
                time.monotonic() >= self._zoom_said_at):
            self._zoom_said_at = time.monotonic() + LOG_PERIOD_S
            rospy.loginfo("%s: the focal length is %.0f px from now on, before %.0f px: unless the camera has zoomed "
                          "as much, people are at other distances than before", self.topic, focal, was)

    def values(self) -> Dict[str, object]:
        """Return what diagnostics tell about the camera."""
        if self._model is None:
            return {"camera_info": self.topic, "calibration": "unknown"}
        return {"camera_info": self.topic, "calibration": self._model.calibration.value,
                "size": "{}x{}".format(self._model.width, self._model.height),
                "focal_px": float(self._model.matrix[0, 0])}

    def close(self) -> None:
        """Stop listening. Idempotent."""
        if not self._closed:
            self._closed = True
            self._heard.set()
            release(self._subscriber)

    def _store(self, info: CameraInfo) -> None:
        with self._lock:
            sender = sender_of(info)
            self._infos.setdefault(sender, deque(maxlen=_MOST_KEPT)).append(info)
            self._infos.move_to_end(sender)
            while len(self._infos) > _MOST_INFOS:
                self._infos.popitem(last=False)
        self._heard.set()

    def _other_frame(self, info: Optional[CameraInfo], frame: str) -> str:
        """Tell where camera_info is of another frame than the images; it is used, as names may differ by mistake."""
        given = "" if info is None else info.header.frame_id.lstrip("/")
        if not given or not frame or given == frame:
            return ""
        return "{}: it is of the frame {!r}, images are in {!r}: is it that of another camera? Then distances are " \
            "wrong; remap `camera_info`, or correct the driver's frame_id".format(self.topic, given, frame)

    def _build(self, info: Optional[CameraInfo], width: int, height: int) -> Tuple[CameraModel, str]:
        """Return a model of this image size and what is wrong with camera_info, empty when nothing is."""
        if info is None:
            return (CameraModel.from_fov(width, height, self._hfov, Calibration.MISSING),
                    "no camera_info on {}: remap `camera_info` to the camera's; {}".format(self.topic, self._hint))
        fallback = CameraModel.from_fov(width, height, self._hfov, Calibration.UNCALIBRATED)
        try:
            camera = camera_from_info(info, self._hfov, width, height, self._rectified)
        except CameraError as error:
            return fallback, "{}: {}; {}".format(self.topic, error, self._hint)
        if camera.calibration is not Calibration.CALIBRATED:
            return fallback, "{}: K is all zero, the camera is not calibrated; {}".format(self.topic, self._hint)
        if (camera.width, camera.height) == (width, height):
            return camera, ""
        ratio = (camera.width / camera.height) / (width / height)
        sizes = "{}: it is for {}x{} px{}, but images are {}x{}".format(
            self.topic, camera.width, camera.height,
            " by the principal point in K" if (info.width or width, info.height or height) == (width, height)
            and max(info.binning_x, info.binning_y) < 2 else "", width, height)
        if abs(ratio - 1.0) > ASPECT_TOLERANCE:
            return fallback, "{}, another shape; calibrate this resolution; {}".format(sizes, self._hint)
        return camera.resized(width, height), sizes + "; the calibration is scaled"


def _key(info: CameraInfo) -> tuple:
    """Everything in the message that the model depends on. NaN is unlike itself, hence the bytes."""
    roi = info.roi
    return (info.header.frame_id, info.width, info.height, array("d", (*info.K, *info.P, *info.D)).tobytes(),
            info.distortion_model, info.binning_x, info.binning_y, roi.x_offset, roi.y_offset, roi.width, roi.height)
