"""Between ROS messages and the arrays and values of the core. Pixels in the core, 0 to 1 in messages."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Sequence, Tuple, Union

import genpy
import numpy as np
from geometry_msgs.msg import TransformStamped
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, RegionOfInterest
from std_msgs.msg import Header

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
    NormalizedPointOfInterest2D,
    Skeleton2D,
    SoftBiometrics,
)
from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.images import ImageError, bgr_from_compressed, bgr_from_raw
from hri_pipeline.core.interactions.gaze_people import GazeTarget
from hri_pipeline.core.observations import SoftBiometrics as FaceBiometrics

if TYPE_CHECKING:  # a module that needs scipy, of which most nodes need nothing
    from hri_pipeline.core.interactions.group_tracker import Group as SocialGroup
    from hri_pipeline.core.voices.audio_features import FeatureFrame

Stamp = Union[genpy.Time, float]

LANDMARKS = 70
ACTION_UNITS = 99
KEYPOINTS = 18


def to_time(stamp: Stamp) -> genpy.Time:
    """Return a ROS time of a ROS time or of seconds."""
    return stamp if isinstance(stamp, genpy.Time) else genpy.Time.from_sec(stamp)


def make_header(stamp: Stamp, frame_id: str) -> Header:
    """Return a header."""
    return Header(stamp=to_time(stamp), frame_id=frame_id)


def image_to_bgr(msg: Image) -> np.ndarray:
    """Return (H, W, 3) uint8 BGR of a raw image; raises ImageError."""
    return bgr_from_raw(msg.data, msg.width, msg.height, msg.step, msg.encoding, bool(msg.is_bigendian))


def compressed_to_bgr(msg: CompressedImage) -> np.ndarray:
    """Return (H, W, 3) uint8 BGR of a JPEG or PNG image; raises ImageError."""
    if "compressedDepth" in msg.format:
        raise ImageError("format {!r} is a depth image; give the compressed topic of the colour image".format(
            msg.format))
    return bgr_from_compressed(msg.data)


def bgr_to_image(bgr: np.ndarray, header: Header) -> Image:
    """Return a bgr8 message of (H, W, 3) uint8 BGR."""
    if bgr.ndim != 3 or bgr.shape[2] != 3 or bgr.dtype != np.uint8:
        raise ImageError("an image is (H, W, 3) uint8, not {} {}".format(bgr.shape, bgr.dtype))
    return Image(header=header, height=bgr.shape[0], width=bgr.shape[1], encoding="bgr8", is_bigendian=0,
                 step=3 * bgr.shape[1], data=np.ascontiguousarray(bgr).tobytes())


def camera_from_info(msg: CameraInfo, fallback_hfov: float, width: int = 0, height: int = 0) -> CameraModel:
    """Return the camera model of a CameraInfo; raises CameraError for numbers that cannot be true.

    fallback_hfov: horizontal field of view in rad for an all-zero K. width, height: size of the image in px,
    used when the message does not tell one.
    """
    roi = msg.roi
    return CameraModel.from_calibration(
        msg.width or width, msg.height or height, msg.K, msg.D, msg.distortion_model, fallback_hfov,
        binning_x=msg.binning_x, binning_y=msg.binning_y,
        roi_x=roi.x_offset, roi_y=roi.y_offset, roi_width=roi.width, roi_height=roi.height)


def roi_to_msg(box: Sequence[float], width: int, height: int) -> RegionOfInterest:
    """Return the whole pixels that hold the box x0, y0, x1, y1 (px), clipped to the image."""
    values = np.asarray(box, dtype=np.float64)
    _finite(values, "a box")
    limits = np.array([width, height, width, height])
    values = np.clip(np.concatenate([np.floor(values[:2]), np.ceil(values[2:])]), 0, limits).astype(int)
    x0, y0, x1, y1 = (int(value) for value in values)
    return RegionOfInterest(x_offset=x0, y_offset=y0, width=max(0, x1 - x0), height=max(0, y1 - y0))


def landmarks_to_msg(landmarks: np.ndarray, header: Header, width: int, height: int) -> FacialLandmarks:
    """Return the message of (70, 3) landmarks x px, y px, confidence in an image of width x height px."""
    return FacialLandmarks(header=header, landmarks=_points(landmarks, LANDMARKS, width, height),
                           height=height, width=width)


def landmarks_from_msg(msg: FacialLandmarks) -> np.ndarray:
    """Return (70, 3) x, y (0 to 1 of the image's width and height) and confidence, of a LandmarkArray too.

    Raises ValueError for another number of points or for what is not finite.
    """
    return _from_points(msg.landmarks, LANDMARKS, "FacialLandmarks")


def action_units_to_msg(intensity: np.ndarray, confidence: np.ndarray, header: Header) -> FacialActionUnits:
    """Return the message of 99 intensities and confidences (0 to 1), clipped; what is not finite is not known."""
    values = [np.asarray(array, dtype=np.float64).reshape(-1) for array in (intensity, confidence)]
    if any(len(array) != ACTION_UNITS for array in values):
        raise ValueError("{} action units are needed, not {}".format(ACTION_UNITS, [len(array) for array in values]))
    known = np.isfinite(values[0]) & np.isfinite(values[1])
    intensity, confidence = (np.where(known, np.clip(array, 0.0, 1.0), 0.0).tolist() for array in values)
    return FacialActionUnits(header=header, intensity=intensity, confidence=confidence)


def action_units_from_msg(msg: FacialActionUnits) -> Tuple[np.ndarray, np.ndarray]:
    """Return the 99 intensities and confidences (0 to 1).

    Raises ValueError for another number of them or for what is not finite.
    """
    values = np.array([msg.intensity, msg.confidence] if len(msg.intensity) == len(msg.confidence) else [[]])
    if values.shape != (2, ACTION_UNITS):
        raise ValueError("FacialActionUnits needs {} intensities and confidences, not {} and {}".format(
            ACTION_UNITS, len(msg.intensity), len(msg.confidence)))
    _finite(values, "FacialActionUnits")
    return np.clip(values[0], 0.0, 1.0), np.clip(values[1], 0.0, 1.0)


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
    return Skeleton2D(header=header, skeleton=_points(keypoints, KEYPOINTS, width, height))


def skeleton_from_msg(msg: Skeleton2D) -> np.ndarray:
    """Return (18, 3) x, y (0 to 1 of the image's width and height) and confidence.

    Raises ValueError for another number of points or for what is not finite.
    """
    return _from_points(msg.skeleton, KEYPOINTS, "Skeleton2D")


def transform_to_msg(pose: Pose, stamp: Stamp, parent: str, child: str) -> TransformStamped:
    """Return the transform of frame `child` in frame `parent`."""
    # Hundreds a second: genpy takes twice as long when it is given the fields.
    msg = TransformStamped()
    msg.header.stamp, msg.header.frame_id, msg.child_frame_id = to_time(stamp), parent, child
    translation, rotation = msg.transform.translation, msg.transform.rotation
    translation.x, translation.y, translation.z = pose.translation.tolist()
    rotation.x, rotation.y, rotation.z, rotation.w = pose.quaternion
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


def _points(values: np.ndarray, count: int, width: int, height: int) -> list:
    """Points in 0 to 1; one that is not finite has confidence 0, all are clipped to the image."""
    values = np.asarray(values, dtype=np.float64)
    if values.shape != (count, 3):
        raise ValueError("({}, 3) points are needed, not {}".format(count, values.shape))
    if width < 1 or height < 1:
        raise ValueError("points need the size of their image, not {}x{}".format(width, height))
    scaled = values * (1.0 / width, 1.0 / height, 1.0)
    known = np.isfinite(scaled)
    if not known.all():
        scaled = np.where(known.all(axis=1, keepdims=True), scaled, 0.0)
    scaled = np.minimum(np.maximum(scaled, 0.0), 1.0)
    return [_point(x, y, c) for x, y, c in scaled.tolist()]


def _point(x: float, y: float, c: float) -> NormalizedPointOfInterest2D:
    """One point; thousands a second, and genpy's constructor takes four times as long."""
    point = NormalizedPointOfInterest2D.__new__(NormalizedPointOfInterest2D)
    point.x, point.y, point.c = x, y, c
    return point


def _from_points(points: Union[np.ndarray, Sequence[NormalizedPointOfInterest2D]], count: int, kind: str) -> np.ndarray:
    if len(points) != count:
        raise ValueError("{} needs {} points, not {}".format(kind, count, len(points)))
    values = points if isinstance(points, np.ndarray) else np.array([(point.x, point.y, point.c) for point in points],
                                                                   dtype=np.float64)
    _finite(values, kind)
    return values


def _finite(values: np.ndarray, what: str) -> None:
    if not np.all(np.isfinite(values)):
        raise ValueError("{} holds numbers that are not finite".format(what))
