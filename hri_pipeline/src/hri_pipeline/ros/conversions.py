"""Between ROS messages and the arrays and values of the core. Pixels in the core, 0 to 1 in messages.

The functions that take `interface` are the only place that knows the difference between the topics of the paper and
those of REP-155. LandmarkArray and SkeletonArray are message types to subscribe with, which read all points as one
array.
"""

from __future__ import annotations

import math
import struct
from functools import lru_cache
from typing import TYPE_CHECKING, BinaryIO, List, Optional, Sequence, Tuple, Type, Union

import genpy
import numpy as np
from geometry_msgs.msg import Quaternion, Transform, TransformStamped, Vector3
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, RegionOfInterest
from std_msgs.msg import Header, String

from hri_msgs.msg import (
    AudioFeatures,
    EngagementLevel,
    Expression,
    FacialActionUnits,
    FacialLandmarks,
    Gaze,
    GazeSenderReceiver,
    GazesStamped,
    Group,
    GroupsStamped,
    IdsList,
    IdsMatch,
    LiveSpeech,
    NormalizedPointOfInterest2D,
    NormalizedRegionOfInterest2D,
    Skeleton2D,
    SoftBiometrics,
)
from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.geometry import Numbers, Pose
from hri_pipeline.core.images import GreyBits, ImageError, bgr_from_compressed, bgr_from_raw, check_colour
from hri_pipeline.core.interactions.people import GazeTarget
from hri_pipeline.core.observations import SoftBiometrics as FaceBiometrics

if TYPE_CHECKING:  # a module that needs scipy, of which most nodes need nothing
    from hri_pipeline.core.asr.recognition import SpeechResult
    from hri_pipeline.core.audio.features import FeatureFrame
    from hri_pipeline.core.interactions.groups import Group as SocialGroup

PAPER, REP155 = "paper", "rep155"

Stamp = Union[genpy.Time, float]
RoiMessage = Union[RegionOfInterest, NormalizedRegionOfInterest2D]
SpeechMessage = Union[String, LiveSpeech]

LANDMARKS = 70
ACTION_UNITS = 99
KEYPOINTS = 18

# Parts of serialised messages: the header up to the frame_id, the length of a list, and height and width of an image.
_STAMP_AND_LENGTH = struct.Struct("<3II")
_COUNT = struct.Struct("<I")
_SIZE = struct.Struct("<II")
_BEFORE_PIXELS = struct.Struct("<BII")
_POINT_BYTES = 3 * 4
_NO_POINTS = np.zeros((0, 3))


def to_time(stamp: Stamp) -> genpy.Time:
    """Return a ROS time of a ROS time or of seconds."""
    return stamp if isinstance(stamp, genpy.Time) else genpy.Time.from_sec(stamp)


def _empty_header() -> Header:
    """Return a header that is to be filled: its own constructor takes three times as long."""
    header, header_stamp = Header.__new__(Header), genpy.Time.__new__(genpy.Time)
    header_stamp.secs = header_stamp.nsecs = 0
    header.seq, header.stamp, header.frame_id = 0, header_stamp, ""
    return header


def make_header(stamp: Stamp, frame_id: str) -> Header:
    """Return a header."""
    return Header(stamp=to_time(stamp), frame_id=frame_id)


def image_to_bgr(msg: Image, grey: Optional[GreyBits] = None) -> np.ndarray:
    """Return (H, W, 3) uint8 BGR of a raw image; raises ImageError. grey: of the earlier images of the camera."""
    return bgr_from_raw(msg.data, msg.width, msg.height, msg.step, msg.encoding, bool(msg.is_bigendian), grey)


def compressed_to_bgr(msg: CompressedImage, grey: Optional[GreyBits] = None) -> np.ndarray:
    """Return (H, W, 3) uint8 BGR of a JPEG or PNG image; raises ImageError. grey: as for image_to_bgr()."""
    if "compressedDepth" in msg.format:
        raise ImageError("format {!r} is a depth image; give the compressed topic of the colour image".format(
            msg.format))
    encoding = msg.format.partition(";")[0].strip()
    check_colour(encoding)
    return bgr_from_compressed(msg.data, grey, encoding)


def bgr_to_image(bgr: np.ndarray, header: Header) -> Image:
    """Return a bgr8 message of (H, W, 3) uint8 BGR."""
    if bgr.ndim != 3 or bgr.shape[2] != 3 or bgr.dtype != np.uint8:
        raise ImageError("an image is (H, W, 3) uint8, not {} {}".format(bgr.shape, bgr.dtype))
    return _SentImage(header=header, height=bgr.shape[0], width=bgr.shape[1], encoding="bgr8", is_bigendian=0,
                      step=3 * bgr.shape[1], data=np.ascontiguousarray(bgr).tobytes())


def matrix_to_image(rows: np.ndarray, header: Header) -> Image:
    """Return a 32FC1 message of an array (N, M)."""
    return Image(header=header, height=rows.shape[0], width=rows.shape[1], encoding="32FC1", is_bigendian=0,
                 step=4 * rows.shape[1], data=np.ascontiguousarray(rows, "<f4").tobytes())


def matrix_from_image(msg: Image) -> np.ndarray:
    """Return the array (N, M) of a message of matrix_to_image(). Raises ImageError for anything else."""
    if msg.encoding != "32FC1" or msg.is_bigendian or msg.step != 4 * msg.width or (
            len(msg.data) != msg.step * msg.height):
        raise ImageError("wanted a 32FC1 matrix, got {} of {}x{}".format(msg.encoding[:20], msg.height, msg.width))
    rows = np.frombuffer(msg.data, "<f4").reshape(msg.height, msg.width).astype(np.float64)
    if not np.isfinite(rows).all():
        raise ImageError("a matrix holds numbers that are not finite")
    return rows


def camera_from_info(msg: CameraInfo, fallback_hfov: float, width: int = 0, height: int = 0,
                     rectified: bool = False) -> CameraModel:
    """Return the camera model of a CameraInfo; raises CameraError for numbers that cannot be true.

    fallback_hfov: horizontal field of view in rad for an all-zero K. width, height: size of the image in px,
    used when the message does not tell one. rectified: the images are; then P holds, where it is told, and there is no
    distortion.
    """
    roi, calibration = msg.roi, (msg.K, msg.D, msg.distortion_model)
    if rectified and any(msg.P):
        calibration = ((*msg.P[0:3], *msg.P[4:7], *msg.P[8:11]), (), "plumb_bob")
    return CameraModel.from_calibration(
        msg.width or width, msg.height or height, *calibration, fallback_hfov,
        binning_x=msg.binning_x, binning_y=msg.binning_y,
        roi_x=roi.x_offset, roi_y=roi.y_offset, roi_width=roi.width, roi_height=roi.height)


def camera_info(width: int, height: int, hfov: float, header: Header) -> CameraInfo:
    """Return the CameraInfo of an ideal camera with a horizontal field of view of `hfov` rad."""
    matrix = _ideal_matrix(width, height, hfov)
    info = CameraInfo(header=header, width=width, height=height, distortion_model="plumb_bob", D=[0.0] * 5)
    info.K = [*matrix]
    info.R = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    info.P = [*matrix[:3], 0.0, *matrix[3:6], 0.0, *matrix[6:], 0.0]
    return info


@lru_cache(maxsize=16)
def _ideal_matrix(width: int, height: int, hfov: float) -> Tuple[float, ...]:
    """The numbers of the camera matrix, row by row; the same for each image of a camera."""
    return tuple(CameraModel.from_fov(width, height, hfov).matrix.ravel().tolist())


def roi_to_msg(box: Numbers, width: int, height: int) -> RegionOfInterest:
    """Return the whole pixels that hold the box x0, y0, x1, y1 (px), clipped to the image."""
    values = np.asarray(box, dtype=np.float64)
    _finite(values, "a box")
    limits = np.array([width, height, width, height])
    values = np.clip(np.concatenate([np.floor(values[:2]), np.ceil(values[2:])]), 0, limits).astype(int)
    x0, y0, x1, y1 = (int(value) for value in values)
    return RegionOfInterest(x_offset=x0, y_offset=y0, width=max(0, x1 - x0), height=max(0, y1 - y0))


def landmarks_to_msg(landmarks: np.ndarray, header: Header, width: int, height: int) -> FacialLandmarks:
    """Return the message of (70, 3) landmarks x px, y px, confidence in an image of width x height px."""
    message = _SentLandmarks(header, _scaled(landmarks, LANDMARKS, width, height))
    message.height, message.width = height, width
    return message


def landmarks_from_msg(msg: FacialLandmarks) -> np.ndarray:
    """Return (70, 3) x, y (0 to 1 of the image's width and height) and confidence, of a LandmarkArray too.

    Raises ValueError for another number of points, for what is not finite, and for what could not be read.
    """
    return _from_points(msg, msg.landmarks, LANDMARKS, "FacialLandmarks")


def action_units_to_msg(intensity: np.ndarray, confidence: np.ndarray, header: Header) -> FacialActionUnits:
    """Return the message of 99 intensities and confidences (0 to 1), clipped; what is not finite is not known."""
    values = [np.asarray(array, dtype=np.float64).reshape(-1) for array in (intensity, confidence)]
    if any(len(array) != ACTION_UNITS for array in values):
        raise ValueError("{} action units are needed, not {}".format(ACTION_UNITS, [len(array) for array in values]))
    both = np.array(values)
    both[:, ~np.isfinite(both).all(axis=0)] = 0.0
    intensity, confidence = np.minimum(np.maximum(both, 0.0), 1.0).tolist()
    return FacialActionUnits(header=header, intensity=intensity, confidence=confidence)


def action_units_from_msg(msg: FacialActionUnits) -> Tuple[np.ndarray, np.ndarray]:
    """Return the 99 intensities and confidences (0 to 1).

    Raises ValueError for another number of them or for what is not finite.
    """
    if not len(msg.intensity) == len(msg.confidence) == ACTION_UNITS:
        raise ValueError("FacialActionUnits needs {} intensities and confidences, not {} and {}".format(
            ACTION_UNITS, len(msg.intensity), len(msg.confidence)))
    # A hundred a second: numpy takes five times as long for two lists as for one, and for clip().
    values = np.array((*msg.intensity, *msg.confidence))
    _finite(values, "FacialActionUnits")
    values = np.minimum(np.maximum(values, 0.0), 1.0)
    return values[:ACTION_UNITS], values[ACTION_UNITS:]


def expression_to_msg(category: str, valence: float, arousal: float, confidence: float, header: Header) -> Expression:
    """Return the message of an expression; category is the word of one of the constants of hri_msgs/Expression.

    The constants themselves hold their quotation marks (genmsg keeps them): compare with the bare word.
    """
    _finite(np.array([valence, arousal, confidence]), "an expression")
    return Expression(header=header, expression=category, valence=float(np.clip(valence, -1.0, 1.0)),
                      arousal=float(np.clip(arousal, -1.0, 1.0)), confidence=float(np.clip(confidence, 0.0, 1.0)))


def soft_biometrics_to_msg(biometrics: FaceBiometrics, header: Header) -> SoftBiometrics:
    """Return the message of apparent age and gender; the gender is UNDEFINED where it is a coin's toss."""
    values = np.array([biometrics.age, biometrics.age_confidence, biometrics.p_male, biometrics.gender_confidence])
    _finite(values, "soft biometrics")
    gender = SoftBiometrics.MALE if biometrics.p_male > 0.5 else SoftBiometrics.FEMALE
    certain = float(np.clip(biometrics.gender_confidence, 0.0, 1.0))
    return SoftBiometrics(
        header=header, age=int(np.clip(round(float(biometrics.age)), 0, 255)),
        age_confidence=float(np.clip(biometrics.age_confidence, 0.0, 1.0)),
        gender=gender if certain > 0.0 else SoftBiometrics.UNDEFINED, gender_confidence=certain)


def audio_features_to_msg(frame: FeatureFrame) -> AudioFeatures:
    """Return the message of the descriptors of one frame of a voice; it has no header. What is not finite is 0."""
    msg = AudioFeatures()
    # A hundred a second for each voice: numpy takes longer for so few numbers, and genpy when it is given the fields.
    msg.ZCR, msg.RMS, msg.pitch, msg.HNR, *msg.MFCC = (
        value if math.isfinite(value) else 0.0
        for value in (float(frame.zcr), float(frame.rms), float(frame.pitch), float(frame.hnr), *frame.mfcc.tolist()))
    return msg


def skeleton_to_msg(keypoints: np.ndarray, header: Header, width: int, height: int) -> Skeleton2D:
    """Return the message of (18, 3) key points x px, y px, confidence, in the order of Skeleton2D."""
    return _SentSkeleton(header, _scaled(keypoints, KEYPOINTS, width, height))


def skeleton_from_msg(msg: Skeleton2D) -> np.ndarray:
    """Return (18, 3) x, y (0 to 1 of the image's width and height) and confidence, of a SkeletonArray too.

    Raises ValueError for another number of points, for what is not finite, and for what could not be read.
    """
    return _from_points(msg, msg.skeleton, KEYPOINTS, "Skeleton2D")


def transform_to_msg(pose: Pose, stamp: Stamp, parent: str, child: str) -> TransformStamped:
    """Return the transform of frame `child` in frame `parent`."""
    # Hundreds a second: the messages' own constructors take three times as long.
    msg, header, transform, translation, rotation = (kind.__new__(kind) for kind in (
        TransformStamped, Header, Transform, Vector3, Quaternion))
    header.seq, header.stamp, header.frame_id = 0, to_time(stamp), parent
    translation.x, translation.y, translation.z = pose.translation.tolist()
    rotation.x, rotation.y, rotation.z, rotation.w = pose.quaternion
    transform.translation, transform.rotation = translation, rotation
    msg.header, msg.child_frame_id, msg.transform = header, child, transform
    return msg


def pose_from_transform(msg: TransformStamped) -> Pose:
    """Return the pose of the child frame in the parent frame.

    Raises ValueError for numbers that are not finite or a quaternion of zeros.
    """
    translation, rotation = msg.transform.translation, msg.transform.rotation
    position = np.array([translation.x, translation.y, translation.z])
    _finite(position, "a translation")
    return Pose.from_quaternion((rotation.x, rotation.y, rotation.z, rotation.w), position)


def ids_list_to_msg(ids: Sequence[str], stamp: Stamp) -> IdsList:
    """Return a list of ids."""
    return IdsList(header=make_header(stamp, ""), ids=list(ids))


def match_to_msg(id1: str, type1: int, id2: str, type2: int, confidence: float) -> IdsMatch:
    """Return a candidate match of two ids; types are IdsMatch.PERSON, FACE, BODY, VOICE; confidence 0 to 1."""
    return IdsMatch(id1=id1, id1_type=type1, id2=id2, id2_type=type2,
                    confidence=float(np.clip(confidence, 0.0, 1.0)))


def gazes_to_msg(gazes: Sequence[GazeTarget], header: Header) -> GazesStamped:
    """Return everybody who looks at somebody at one time."""
    return GazesStamped(header=header, gazes=[
        GazeSenderReceiver(sender=gaze.sender, receiver=gaze.receiver, confidence=gaze.confidence) for gaze in gazes])


def gaze_to_msg(gaze: GazeTarget, header: Header) -> Gaze:
    """Return one gaze, as REP-155 has it."""
    return Gaze(header=header, sender=gaze.sender, receiver=gaze.receiver)


def group_to_msg(group: SocialGroup, header: Header) -> Group:
    """Return one group."""
    return Group(header=header, group_id=group.id, members=list(group.members))


def groups_to_msg(groups: Sequence[SocialGroup], header: Header) -> GroupsStamped:
    """Return all groups of one time."""
    return GroupsStamped(header=header, groups=[group_to_msg(group, header) for group in groups],
                         confidences=[group.confidence for group in groups])


def engagement_to_msg(level: int, header: Header) -> EngagementLevel:
    """Return how far a person is engaged; level: one of the constants of the message."""
    return EngagementLevel(header=header, level=int(level))


def roi_type(interface: str) -> Type[genpy.Message]:
    """Message type of the topics `roi`. Raises ValueError for an unknown interface."""
    types = {PAPER: RegionOfInterest, REP155: NormalizedRegionOfInterest2D}
    if interface not in types:
        raise ValueError("interface is {!r}; legal: {}".format(interface, ", ".join(types)))
    return types[interface]


def roi_message(box: np.ndarray, width: int, height: int, interface: str,
                header: Optional[Header] = None, confidence: float = 1.0) -> RoiMessage:
    """Message of a box (4,) x0, y0, x1, y1 px in an image of width x height px, clipped to the image.

    header and confidence (0 to 1) go into the type that has fields for them only.
    """
    if roi_type(interface) is RegionOfInterest:
        return roi_to_msg(box, width, height)
    values = np.asarray(box, dtype=np.float64)
    if not np.isfinite(values).all():
        raise ValueError("a box holds numbers that are not finite")
    x0, y0, x1, y1 = np.clip(values / (width, height, width, height), 0.0, 1.0).tolist()
    return NormalizedRegionOfInterest2D(
        header=header or Header(), xmin=x0, ymin=y0, xmax=x1, ymax=y1, c=float(np.clip(confidence, 0.0, 1.0)))


def groups_type(interface: str) -> Type[genpy.Message]:
    """Message type of the topic `groups`: all at once, or one by one. Raises ValueError for an unknown interface."""
    roi_type(interface)
    return Group if interface == REP155 else GroupsStamped


def groups_messages(groups: Sequence[SocialGroup], header: Header, interface: str) -> List[genpy.Message]:
    """Return the messages of the groups of one time."""
    if groups_type(interface) is GroupsStamped:
        return [groups_to_msg(groups, header)]
    return [group_to_msg(group, header) for group in groups]


def has_gazing(interface: str) -> bool:
    """Tell whether each gaze is sent on `gazing`, too. Raises ValueError for an unknown interface."""
    return groups_type(interface) is Group


def has_gaze_of_closed_eyes(interface: str) -> bool:
    """Tell whether gaze_ID goes on while the eyes tell nothing. Raises ValueError for an unknown interface."""
    roi_type(interface)
    return interface == REP155


def published_gaze(face: Pose, direction: Optional[np.ndarray], interface: str) -> Optional[np.ndarray]:
    """Return the direction (3,) of gaze_ID in the sensor's frame, None where there is no such frame.

    face: in the sensor's frame; direction: None while the eyes are closed, or where nothing is known. Clients of
    REP-155 take a face without gaze_ID for a fault: for them the direction of the head stands in.
    """
    return face.rotation[:, 0] if direction is None and has_gaze_of_closed_eyes(interface) else direction


def speech_type(interface: str) -> Type[genpy.Message]:
    """Message type of the topics `speech`. Raises ValueError for an unknown interface."""
    roi_type(interface)
    return LiveSpeech if interface == REP155 else String


def speech_message(result: SpeechResult, interface: str, header: Header) -> SpeechMessage:
    """Message of what a voice has said, up to now or in all; header goes into the type that has one."""
    if speech_type(interface) is String:
        return String(result.final or result.incremental)
    return LiveSpeech(header=header, incremental=result.incremental, final=result.final,
                      confidence=float(np.clip(result.confidence, 0.0, 1.0)), language=result.language)


class _PointArray:
    """What both have in common: a header, points, and what stands behind them.

    Ten faces send hundreds of these a second to each of several nodes, and 70 objects for each take ten times as long
    to read. They are only received: they cannot be published. `fault` says why the bytes cannot be read; rospy would
    close the connection and open it again for each such message, without a word. The conversions raise it as a
    ValueError.
    """

    fault = ""

    def _read(self, data: bytes, count: int, rest: int) -> np.ndarray:
        """Read the header; return the points, none where there is a fault.

        count: usual number of points; rest: bytes behind them.
        """
        try:
            seq, secs, nsecs, length = _STAMP_AND_LENGTH.unpack_from(data)
            begin = _STAMP_AND_LENGTH.size + length
            told, = _COUNT.unpack_from(data, begin)
        except struct.error as error:
            return self._refuse("the message is cut off: {}".format(error))
        header = self.header
        header.seq, header.frame_id = seq, data[_STAMP_AND_LENGTH.size:begin].decode("utf-8", "replace")
        header.stamp.secs, header.stamp.nsecs = secs, nsecs
        there = len(data) - begin - rest
        if there == count * _POINT_BYTES:
            return self._refuse("the message does not tell the number of its points: its sender, or the program that "
                                "recorded it, has a definition of {} points instead of any number".format(count))
        if there != _COUNT.size + told * _POINT_BYTES:
            return self._refuse("the message tells of {} points and has bytes for {:.1f}".format(
                told, max(0, there - _COUNT.size) / _POINT_BYTES))
        points = np.frombuffer(data, "<f4", 3 * told, begin + _COUNT.size)
        return points.reshape(told, 3).astype(np.float64)

    def _refuse(self, fault: str) -> np.ndarray:
        self.fault = fault
        return _NO_POINTS


class LandmarkArray(_PointArray, FacialLandmarks):
    """A FacialLandmarks, the type to subscribe with, whose `landmarks` is an array (N, 3) of x, y, c."""

    def __init__(self) -> None:
        # Not the generated one, which looks at its arguments first.
        self.header, self.landmarks = _empty_header(), _NO_POINTS
        self.height = self.width = 0

    def deserialize(self, data: bytes) -> LandmarkArray:
        """Read a serialised message; `fault` says what is wrong with it."""
        self.landmarks = self._read(data, 70, _SIZE.size)
        if not self.fault:
            self.height, self.width = _SIZE.unpack_from(data, len(data) - _SIZE.size)
        return self


class SkeletonArray(_PointArray, Skeleton2D):
    """A Skeleton2D, the type to subscribe with, whose `skeleton` is an array (N, 3) of x, y, c."""

    def __init__(self) -> None:
        self.header, self.skeleton = _empty_header(), _NO_POINTS

    def deserialize(self, data: bytes) -> SkeletonArray:
        """Read a serialised message; `fault` says what is wrong with it."""
        self.skeleton = self._read(data, 18, 0)
        return self


class _SentImage(Image):
    """An image to send, whose pixels are written as they are.

    genpy copies them once more on the way, into memory that the system gives anew for each image: where glibc is left
    as it is, that takes 20 times as long as all the rest.
    """

    def serialize(self, buffer: BinaryIO) -> None:
        """Write the message."""
        data, stamp = self.data, self.header.stamp
        if not isinstance(data, bytes):     # somebody has set others
            super().serialize(buffer)
            return
        frame, encoding = self.header.frame_id.encode(), self.encoding.encode()
        buffer.write(_STAMP_AND_LENGTH.pack(self.header.seq, stamp.secs, stamp.nsecs, len(frame)) + frame
                     + _SIZE.pack(self.height, self.width) + _COUNT.pack(len(encoding)) + encoding
                     + _BEFORE_PIXELS.pack(self.is_bigendian, self.step, len(data)))
        buffer.write(data)

    def __eq__(self, other: object) -> bool:
        # genpy's asks whether the other is of this very class.
        return isinstance(other, Image) and all(getattr(self, name) == getattr(other, name) for name in Image.__slots__)


class _SentPoints:
    """What both have in common that are sent: a header and points, which are made one by one only where they are asked
    for.

    Ten faces send thousands of points a second, and genpy takes four times as long for them.
    """

    def __init__(self, header: Optional[Header] = None, points: np.ndarray = _NO_POINTS) -> None:
        """points: (N, 3), see _scaled()."""
        self.header = header or Header()
        self._sent: Union[np.ndarray, list] = points

    def _objects(self) -> list:
        if isinstance(self._sent, np.ndarray):
            self._sent = [NormalizedPointOfInterest2D(x, y, c) for x, y, c in self._sent.tolist()]
        return self._sent

    def _write(self, buffer: BinaryIO, rest: bytes) -> bool:
        """Write the message; return False where somebody has asked for the points, and may have changed them."""
        if not isinstance(self._sent, np.ndarray):
            return False
        stamp, frame = self.header.stamp, self.header.frame_id.encode()
        buffer.write(_STAMP_AND_LENGTH.pack(self.header.seq, stamp.secs, stamp.nsecs, len(frame)) + frame
                     + _COUNT.pack(len(self._sent)) + self._sent.astype("<f4").tobytes() + rest)
        return True


class _SentLandmarks(_SentPoints, FacialLandmarks):
    """A FacialLandmarks to send."""

    height = width = 0

    @property
    def landmarks(self) -> list:
        """The points."""
        return self._objects()

    @landmarks.setter
    def landmarks(self, points: list) -> None:
        self._sent = points

    def serialize(self, buffer: BinaryIO) -> None:
        """Write the message."""
        if not self._write(buffer, _SIZE.pack(self.height, self.width)):
            super().serialize(buffer)


class _SentSkeleton(_SentPoints, Skeleton2D):
    """A Skeleton2D to send."""

    @property
    def skeleton(self) -> list:
        """The points."""
        return self._objects()

    @skeleton.setter
    def skeleton(self, points: list) -> None:
        self._sent = points

    def serialize(self, buffer: BinaryIO) -> None:
        """Write the message."""
        if not self._write(buffer, b""):
            super().serialize(buffer)


def _scaled(values: np.ndarray, count: int, width: int, height: int) -> np.ndarray:
    """Points (N, 3) in 0 to 1; one that is not finite has confidence 0, all are clipped to the image."""
    values = np.asarray(values, dtype=np.float64)
    if values.shape != (count, 3):
        raise ValueError("({}, 3) points are needed, not {}".format(count, values.shape))
    if width < 1 or height < 1:
        raise ValueError("points need the size of their image, not {}x{}".format(width, height))
    scaled = values * (1.0 / width, 1.0 / height, 1.0)
    known = np.isfinite(scaled)
    if not known.all():
        scaled = np.where(known.all(axis=1, keepdims=True), scaled, 0.0)
    return np.minimum(np.maximum(scaled, 0.0), 1.0)


def _from_points(msg: genpy.Message, points: Union[np.ndarray, Sequence[NormalizedPointOfInterest2D]], count: int,
                 kind: str) -> np.ndarray:
    fault = getattr(msg, "fault", "")
    if fault:
        raise ValueError("{}: {}".format(kind, fault))
    if len(points) != count:
        raise ValueError("{} needs {} points, not {}".format(kind, count, len(points)))
    values = points if isinstance(points, np.ndarray) else np.array([(point.x, point.y, point.c) for point in points],
                                                                    dtype=np.float64)
    _finite(values, kind)
    return values


def _finite(values: np.ndarray, what: str) -> None:
    if not np.isfinite(values).all():
        raise ValueError("{} holds numbers that are not finite".format(what))
