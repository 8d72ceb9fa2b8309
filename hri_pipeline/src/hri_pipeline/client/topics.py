"""Topics and frames of humans: subscribed to when somebody first asks for their value; messages as plain Python values,
poses in any frame of the robot."""

from __future__ import annotations

import enum
import threading
import time
from dataclasses import dataclass
from typing import Any, Callable, Dict, List, Optional, Tuple, Type, TypeVar

import genpy
import numpy as np
import rospy
from geometry_msgs.msg import PoseWithCovarianceStamped

from hri_msgs.msg import (
    AgeAndGender,
    AudioFeatures,
    BodyAttitude,
    BodyPosture,
    EngagementLevel,
    FacialActionUnits,
    FacialLandmarks,
    SoftBiometrics,
)
from hri_msgs.msg import Expression as ExpressionMessage
from hri_msgs.msg import Gesture as GestureMessage
from hri_pipeline.core.frames import HumanTf, composed, read
from hri_pipeline.core.geometry import Pose
from hri_pipeline.ros.conversions import image_to_bgr, landmarks_from_msg, skeleton_from_msg
from hri_pipeline.ros.rospy_compat import release
from hri_pipeline.ros.tcpros import AnyMessage, message_of
from hri_pipeline.ros.tf import Frames, RobotTfListener, TfSubscriber

Convert = Callable[[Any], Any]

_LOG_PERIOD_S = 10.0


class LazyTopic:
    """The latest value of one topic. Nothing is subscribed to before the first `get`; close() unsubscribes.

    The type is that of the publisher, so that both types of a topic that differs between the paper and REP-155 are
    read. convert turns a message into a value; a message that it refuses by a ValueError is left out, with a warning.
    latched: the first `get` waits up to `patience` s for the value that is there already. on_value is called with each
    value; queue_size: how many messages may come at once for that.
    """

    def __init__(self, name: str, convert: Convert, latched: bool = False, patience: float = 0.0,
                 on_value: Optional[Callable[[Any], None]] = None, queue_size: int = 1) -> None:
        self._name = name
        self._convert = convert
        self._patience = patience if latched else 0.0
        self._on_value, self._queue_size = on_value, queue_size
        self._condition = threading.Condition()
        self._subscriber: Optional[rospy.Subscriber] = None
        self._closed = False
        self._came = False
        self._heard = float("-inf")
        self._value: Any = None

    def get(self, default: Any = None) -> Any:
        """Return the latest value, `default` while none has come."""
        with self._condition:
            if not self._closed and self._subscriber is None:
                self._subscriber = rospy.Subscriber(self._name, AnyMessage, self._take, queue_size=self._queue_size)
                self._condition.wait_for(lambda: self._came or self._closed, self._patience)
            return self._value if self._came else default

    @property
    def age(self) -> float:
        """Seconds (of the wall clock) since the last message; infinite while none has come."""
        return time.monotonic() - self._heard

    def close(self) -> None:
        """Unsubscribe. Idempotent; a `get` afterwards returns what came last."""
        with self._condition:
            subscriber, self._subscriber, self._closed = self._subscriber, None, True
            self._condition.notify_all()
        if subscriber is not None:
            release(subscriber)

    def _take(self, message: genpy.Message) -> None:
        try:
            value = self._convert(message_of(message))
        except (ValueError, AttributeError, genpy.DeserializationError) as error:
            # An AttributeError is that of a message of a type which has no business on this topic.
            rospy.logwarn_throttle(_LOG_PERIOD_S, "%s: a message of type %s is not used: %s", self._name,
                                   message._connection_header.get("type", "")[:60], error)
            return
        with self._condition:
            if self._closed:
                return
            self._value, self._came, self._heard = value, True, time.monotonic()
            self._condition.notify_all()
        if self._on_value is not None:
            self._on_value(value)


ROBOT = ""
"""The id that stands for the robot, in gazes and groups."""


class Attitude(enum.IntEnum):
    """What the arms of a body do, by the paper's three classes."""

    OTHER = BodyAttitude.OTHER
    HANDS_ON_FACE = BodyAttitude.HANDS_ON_FACE
    ARMS_CROSSED = BodyAttitude.ARMS_CROSSED
    HANDS_RAISED = BodyAttitude.HANDS_RAISED


class Posture(enum.IntEnum):
    """How a body stands, sits or lies."""

    OTHER = BodyPosture.OTHER
    STANDING = BodyPosture.STANDING
    SITTING = BodyPosture.SITTING
    CROUCHING = BodyPosture.CROUCHING
    LAYING = BodyPosture.LAYING


class Gesture(enum.IntEnum):
    """What the hands of a body do, by REP-155. Left and right are the body's own."""

    OTHER = GestureMessage.OTHER
    HANDS_ON_FACE = GestureMessage.HANDS_ON_FACE
    ARMS_CROSSED = GestureMessage.ARMS_CROSSED
    LEFT_HAND_RAISED = GestureMessage.LEFT_HAND_RAISED
    RIGHT_HAND_RAISED = GestureMessage.RIGHT_HAND_RAISED
    BOTH_HANDS_RAISED = GestureMessage.BOTH_HANDS_RAISED
    WAVING = GestureMessage.WAVING


class Engagement(enum.IntEnum):
    """How far a person is engaged with the robot."""

    UNKNOWN = EngagementLevel.UNKNOWN
    DISENGAGED = EngagementLevel.DISENGAGED
    ENGAGING = EngagementLevel.ENGAGING
    ENGAGED = EngagementLevel.ENGAGED
    DISENGAGING = EngagementLevel.DISENGAGING


@dataclass(frozen=True)
class Region:
    """A box in the image: pixels, or, with REP-155's type of the topic, parts of its width and height (0 to 1)."""

    x: float
    y: float
    width: float
    height: float
    normalised: bool


@dataclass(frozen=True)
class Expression:
    """An expression of a face.

    category: Ekman's word, for instance happy; valence, arousal: -1 to 1; confidence: 0 to 1.
    """

    category: str
    valence: float
    arousal: float
    confidence: float


@dataclass(frozen=True)
class Demographics:
    """Apparent age (years) and gender ("female", "male", "other", "" where not known); confidences 0 to 1."""

    age: float
    age_confidence: float
    gender: str
    gender_confidence: float


@dataclass(frozen=True)
class Location:
    """Where somebody is.

    frame: that of pose and covariance; pose: of the person's frame; covariance: (3, 3) m^2, of its position; stamp: s.
    """

    frame: str
    pose: Pose
    covariance: np.ndarray
    stamp: float


@dataclass(frozen=True)
class GazeOfPerson:
    """Somebody looks at somebody. sender, receiver: person ids, empty for the robot. confidence: 0 to 1."""

    sender: str
    receiver: str
    confidence: float = 1.0


@dataclass(frozen=True)
class GroupOfPersons:
    """People who stand together. members: person ids, empty for the robot. confidence: 0 to 1."""

    id: str
    members: Tuple[str, ...]
    confidence: float = 1.0


_GENDERS = {SoftBiometrics.FEMALE: "female", SoftBiometrics.MALE: "male", SoftBiometrics.OTHER: "other"}

Choice = TypeVar("Choice", bound=enum.IntEnum)


def choice(kind: Type[Choice], value: int) -> Choice:
    """Return the constant; the first one, which stands for not known or other, for a number that is none."""
    try:
        return kind(value)
    except ValueError:
        return kind(0)


def region(message: genpy.Message) -> Region:
    """Return the box of a sensor_msgs/RegionOfInterest or a NormalizedRegionOfInterest2D."""
    if hasattr(message, "xmin"):
        return Region(message.xmin, message.ymin, message.xmax - message.xmin, message.ymax - message.ymin, True)
    return Region(float(message.x_offset), float(message.y_offset), float(message.width), float(message.height), False)


def landmarks(message: FacialLandmarks) -> np.ndarray:
    """Return (70, 3): x, y (0 to 1 of the image) and confidence."""
    return landmarks_from_msg(message)


def action_units(message: FacialActionUnits) -> Dict[int, float]:
    """Return the intensity (0 to 1) of each action unit that is known, by its number in the Facial Action Coding
    System."""
    return {number: value for number,
            (value, sure) in enumerate(zip(message.intensity, message.confidence)) if sure > 0.0}


def expression(message: ExpressionMessage) -> Expression:
    """Return the expression; some publishers send the constants with their quotation marks."""
    return Expression(message.expression.strip('"'), message.valence, message.arousal, message.confidence)


def soft_biometrics(message: SoftBiometrics) -> Optional[Demographics]:
    """Return apparent age and gender of a face; None while nothing is known."""
    return _demographics(float(message.age), message.age_confidence, message.gender, message.gender_confidence)


def demographics(message: AgeAndGender) -> Optional[Demographics]:
    """Return apparent age and gender of a person; None while nothing is known."""
    return _demographics(message.age, message.age_confidence, message.gender, message.gender_confidence)


def _demographics(age: float, age_confidence: float, gender: int, confidence: float) -> Optional[Demographics]:
    if age_confidence <= 0.0 and confidence <= 0.0:
        return None
    return Demographics(age, age_confidence, _GENDERS.get(gender, ""), confidence)


def location(message: PoseWithCovarianceStamped) -> Location:
    """Return the place of a person. Raises ValueError for numbers that are no pose."""
    pose, covariance = message.pose.pose, np.asarray(message.pose.covariance).reshape(6, 6)[:3, :3]
    turn, place = pose.orientation, pose.position
    found = Pose.from_quaternion((turn.x, turn.y, turn.z, turn.w), (place.x, place.y, place.z))
    if not (np.isfinite(found.translation).all() and np.isfinite(covariance).all()):
        raise ValueError("numbers that are not finite")
    return Location(message.header.frame_id, found, covariance, message.header.stamp.to_sec())


def skeleton(message: genpy.Message) -> np.ndarray:
    """Return (18, 3): x, y (0 to 1 of the image) and confidence, in the order of hri_msgs/Skeleton2D."""
    return skeleton_from_msg(message)


def joints(message: genpy.Message) -> Dict[str, float]:
    """Return the angles (rad) of a sensor_msgs/JointState by the name of the joint."""
    return dict(zip(message.name, message.position))


def picture(message: genpy.Message) -> np.ndarray:
    """Return (H, W, 3) uint8 BGR."""
    return image_to_bgr(message)


def audio_features(message: AudioFeatures) -> Dict[str, float]:
    """Return the 16 descriptors of a voice: zcr, rms, pitch (Hz, 0 where not voiced), hnr (dB), mfcc1 to mfcc12."""
    values = {"zcr": message.ZCR, "rms": message.RMS, "pitch": 500.0 * message.pitch, "hnr": message.HNR}
    values.update({"mfcc{}".format(number + 1): value for number, value in enumerate(message.MFCC)})
    return values


def speech(message: genpy.Message) -> str:
    """Return what was said last: std_msgs/String or hri_msgs/LiveSpeech."""
    return message.data if hasattr(message, "data") else message.final or message.incremental


def gazes(message: genpy.Message) -> List[GazeOfPerson]:
    """Return the gazes of a hri_msgs/GazesStamped."""
    return [GazeOfPerson(gaze.sender, gaze.receiver, gaze.confidence) for gaze in message.gazes]


def groups(message: genpy.Message) -> List[GroupOfPersons]:
    """Return the groups of a hri_msgs/GroupsStamped, or the one of a hri_msgs/Group."""
    if not hasattr(message, "groups"):
        return [GroupOfPersons(message.group_id, tuple(message.members))]
    sure = list(message.confidences) + [1.0] * len(message.groups)
    return [GroupOfPersons(group.group_id, tuple(group.members), value) for group, value in zip(message.groups, sure)]


_MAX_TARGETS = 20
_GAZE_S = 0.15
"""A gaze whose stamp is so far (s) from that of its face is not known: the eyes have closed since, or time has jumped
back."""


class HumanPoses:
    """Poses of the frames that were asked for. Nothing is subscribed to before the first question."""

    def __init__(self) -> None:
        # rospy calls back while this subscribes, where another subscriber of the process has a latched message.
        self._lock = threading.RLock()
        self._tf = HumanTf()
        self._robots: Dict[str, RobotTfListener] = {}
        self._subscriber: Optional[TfSubscriber] = None
        self._closed = False

    def pose(self, kind: str, identity: str, target: str = "") -> Optional[Tuple[Pose, str, float]]:
        """Return the pose of the frame kind_identity in `target`, the name of that frame, and its stamp (s).

        An empty target is the frame in which the stack publishes it: that of the sensor, or the reference frame. None
        while it is not known, as in the first moments after the first question, or when nothing leads to `target`.
        Raises ValueError when poses in more than 20 different frames are asked for.
        """
        with self._lock:
            if self._closed:
                return None
            self._follow(kind, identity)
            chain = self._tf.chain("{}_{}".format(kind, identity))
            robot = self._robot(target) if target else None
        if not chain or (kind == "gaze" and abs(chain[-1].stamp - chain[0].stamp) > _GAZE_S):
            return None
        pose, link = composed(chain), chain[-1].transform
        if robot is None or link.parent == target:
            return pose, link.parent, link.stamp
        outer = robot.lookup(link.parent, genpy.Time(link.secs, link.nsecs))
        return None if outer is None else (outer.compose(pose), target, link.stamp)

    def forget(self, identity: str) -> None:
        """Free what is kept of the frames of one face, body, voice or person."""
        with self._lock:
            self._tf.follow(**{kind: [other for other in ids if other != identity]
                               for kind, ids in self._tf.followed.items() if identity in ids})

    def close(self) -> None:
        """Unsubscribe. Idempotent."""
        with self._lock:
            self._closed = True
            owners = list(self._robots.values()) + ([self._subscriber] if self._subscriber else [])
            self._robots, self._subscriber = {}, None
        for owner in owners:
            owner.close()

    def _follow(self, kind: str, identity: str) -> None:
        ids = self._tf.followed.get(kind, [])
        if identity not in ids:
            self._tf.follow(**{kind: ids + [identity]})
        if self._subscriber is None:
            self._subscriber = TfSubscriber(self._take, own=True)

    def _robot(self, target: str) -> RobotTfListener:
        if target not in self._robots:
            if len(self._robots) >= _MAX_TARGETS:
                raise ValueError("poses in more than {} different frames; ask for fewer".format(_MAX_TARGETS))
            self._robots[target] = RobotTfListener(target, own=True)
        return self._robots[target]

    def _take(self, data: bytes, frames: Frames, fixed: bool) -> None:
        with self._lock:
            self._tf.put_message(data, frames, fixed)
            if fixed:
                for child, offset in frames:
                    if not self._tf.wants(child.lstrip(b"/")):
                        self._tf.keep_fixed(read(data, offset))
