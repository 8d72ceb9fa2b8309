"""Attitude, posture and gesture of one body over time, from its 18 key points."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Optional, Sequence, Tuple, Union

import numpy as np

from hri_fullbody.core.behaviour.arms import arm_features, trunk_axes
from hri_fullbody.core.behaviour.attitude import AttitudeEstimator
from hri_fullbody.core.behaviour.gesture import WaveDetector, gesture_of
from hri_fullbody.core.behaviour.guessed_limbs import GUESSED, GuessedLegs, KneeSigns
from hri_fullbody.core.behaviour.posture import PostureEstimator
from hri_fullbody.core.keypoints import (
    LEFT_ANKLE,
    LEFT_ELBOW,
    LEFT_HIP,
    LEFT_KNEE,
    LEFT_SHOULDER,
    LEFT_WRIST,
    NECK,
    RIGHT_ANKLE,
    RIGHT_ELBOW,
    RIGHT_HIP,
    RIGHT_KNEE,
    RIGHT_SHOULDER,
    RIGHT_WRIST,
)

# After a longer silence everything starts anew; after a still longer one, up to _LONGEST_GAP_S, where looks have lately
# been so rare that it is one of _RARE of their gaps.
MAX_GAP_S = 1.0
_RARE, _LONGEST_GAP_S = 2.0, 3.0
_GAP_FADES = 0.7    # from one look to the next: how fast a gap is no longer one of lately
_POINT_HOLD_S = 0.7
_LEG_HOLD_S = 0.2       # a leg that is not seen for longer is hidden
_MIN_STATURE_M, _MAX_STATURE_M = 0.4, 2.6
_SIGN = 0.3       # least confidence of an ankle of which there is any sign
_SURE = 0.9       # of a knee that is not guessed; a guessed one has up to .88


@dataclass(frozen=True)
class BodyBehaviour:
    """What a body expresses at one instant.

    attitude, posture, gesture: constants of hri_msgs/BodyAttitude, BodyPosture and Gesture (0: other or not known).
    attitude_confidence: 0 (nothing is seen) to 1 (certain): how often such an attitude is right among people of whom as
    many come near one as show it; of "other": how far the arms are from any.
    """

    attitude: int
    attitude_confidence: float
    posture: int
    gesture: int


class BehaviourRecognizer:
    """Attitude, posture and gesture of one body, for any frame rate from 5 to 60 Hz. Make one per body id."""

    def __init__(self) -> None:
        self._last: Optional[float] = None
        self._gap = 0.0
        self._result = BodyBehaviour(0, 0.0, 0, 0)
        self.reset()

    def reset(self) -> None:
        """Forget all that was seen."""
        self._last = None
        self._hold = KeypointHold()
        self._attitude, self._waves, self._posture = AttitudeEstimator(), WaveDetector(), PostureEstimator()
        self._knees, self._legs = KneeSigns(), GuessedLegs()
        self._result = BodyBehaviour(0, 0.0, 0, 0)

    def forget_places(self) -> None:
        """Forget where key points were, as when the sensor's frame turns."""
        self._hold = KeypointHold()

    def update(self, points: np.ndarray, stature: float, stamp: float,
               up: Union[Sequence[float], np.ndarray], up_sd: float = 0.0,
               confidence: Optional[np.ndarray] = None, hands: Optional[np.ndarray] = None,
               depth_counts: float = 1.0, trunk: float = math.nan, score: float = 1.0,
               leaving: bool = False, floor: Optional[float] = None) -> BodyBehaviour:
        """Take one frame and return what the body expresses.

        points: (18, 3) m in a sensor's frame, key points in the order of hri_msgs/Skeleton2D, NaN or infinite
        unknown. stature: m. stamp: s; the same stamp again changes nothing, and one that is before the last or more
        than 1 s after it (where frames are rare twice the time between them, 3 s at most) starts anew. up: (3,),
        against gravity in the sensor's frame, any length; up_sd: standard deviation of its pitch about the sensor's x
        axis, rad: a posture is told when it does not hang on it.
        confidence: (18,) 0 to 1 of the points, NaN for ankles outside the image, None: all are sure; a forearm of less
        than 0.5 does not wave and has no hand on the face; nobody is told to sit or crouch whose ankles are in the
        image with less than 0.3, nor to sit with a knee of less than 0.9 that jumps about, nor to crouch with two such
        knees; a knee that counts has 0.5, or both have 0.9 together for some time.
        hands: (2, 3) m from the wrist to the knuckles, left and right, NaN unknown; None: along the forearms.
        depth_counts: see arm_features. trunk: m, see trunk_in_image, score: 0 to 1; see GuessedLegs; NaN unknown.
        leaving: whether thighs_leave_image. floor: height (m) of the sensor above it, None unknown: who kneels with the
        shanks unseen is not told to stand.
        Raises ValueError for arrays of another shape, a stature outside 0.4 to 2.6 m, a stamp that is not finite and
        an `up` without a direction.
        """
        points, upwards = _checked(points, stature, stamp, up)
        elapsed = 0.0 if self._last is None else stamp - self._last
        if self._is_silence(elapsed):
            self.reset()
            elapsed = 0.0
        elif self._last is not None and elapsed == 0.0:
            return self._result
        self._last = stamp
        self._drop_guessed_knees(points, confidence, elapsed)
        seen = math.isfinite(points[LEFT_WRIST, 0]), math.isfinite(points[RIGHT_WRIST, 0])
        points = self._hold.fill(points, stamp)
        axes = trunk_axes(points, upwards)
        features = arm_features(points, stature, upwards, axes, hands, depth_counts)
        sure = _sure_forearms(confidence)
        attitude = self._attitude.update(features, elapsed, sure, seen)
        waving = self._waves.update(features, elapsed, sure)
        guessed = self._legs.update(trunk, score, elapsed)
        posture = self._posture.update(
            self._hold.without_old(points, stamp, _LEG_HOLD_S), axes, stature, upwards, elapsed, up_sd,
            *_signs_of_legs(confidence), guessed, leaving and self._legs.stand,
            _hips_height(points, stature, upwards, floor))
        self._result = BodyBehaviour(
            int(attitude), self._attitude.confidence, int(posture),
            int(gesture_of(attitude, self._attitude.raised, waving)))
        return self._result

    def _is_silence(self, elapsed: float) -> bool:
        """Tell whether `elapsed` (s) since the last frame is too long to go on, or negative."""
        most = min(max(MAX_GAP_S, _RARE * self._gap), _LONGEST_GAP_S)
        self._gap = max(elapsed, _GAP_FADES * self._gap)
        return not 0.0 <= elapsed <= most

    def _drop_guessed_knees(self, points: np.ndarray, confidence: Optional[np.ndarray], elapsed: float) -> None:
        """Make the knees NaN, in `points`, that do not count."""
        if confidence is not None:
            knees = (LEFT_KNEE, RIGHT_KNEE)
            for knee, counts in zip(knees, self._knees.update([float(confidence[knee]) for knee in knees], elapsed)):
                if not counts:
                    points[knee] = np.nan


def _hips_height(points: np.ndarray, stature: float, up: np.ndarray, floor: Optional[float]) -> float:
    """Height of the hips above the floor, statures, NaN unknown. floor: see BehaviourRecognizer.update."""
    if floor is None:
        return math.nan
    return (floor + float((points[LEFT_HIP] + points[RIGHT_HIP]) @ up) / 2.0) / stature


def _sure_forearms(confidence: Optional[np.ndarray]) -> Tuple[bool, bool]:
    """Whether elbow and wrist of the left and of the right side are seen.

    On three photographs of a hand on a face its elbow has .8 and more, one that is guessed there .1 to .5.
    """
    if confidence is None:
        return True, True
    sure = (confidence >= GUESSED).tolist()
    return sure[LEFT_ELBOW] and sure[LEFT_WRIST], sure[RIGHT_ELBOW] and sure[RIGHT_WRIST]


def _signs_of_legs(confidence: Optional[np.ndarray]) -> Tuple[bool, Sequence[bool]]:
    """Whether there may be an ankle, in the image or below it, and whether left and right knee may be guessed."""
    if confidence is None:
        return True, (False, False)
    return (not (confidence[LEFT_ANKLE] < _SIGN and confidence[RIGHT_ANKLE] < _SIGN),
            (bool(confidence[LEFT_KNEE] < _SURE), bool(confidence[RIGHT_KNEE] < _SURE)))


def _checked(points: np.ndarray, stature: float, stamp: float,
             up: Union[Sequence[float], np.ndarray]) -> Tuple[np.ndarray, np.ndarray]:
    """Return points with every point that is not finite made NaN, and `up` at length 1."""
    points = np.array(points, dtype=np.float64)
    if points.shape != (18, 3):
        raise ValueError("a body has key points of shape (18, 3), not {}".format(points.shape))
    points[~np.isfinite(points).all(axis=1)] = np.nan
    if not _MIN_STATURE_M <= stature <= _MAX_STATURE_M:
        raise ValueError("a stature of {} m is outside {} to {} m".format(stature, _MIN_STATURE_M, _MAX_STATURE_M))
    if not math.isfinite(stamp):
        raise ValueError("the stamp {} is not finite".format(stamp))
    upwards = np.asarray(up, dtype=np.float64)
    length = math.sqrt(float(np.vdot(upwards, upwards)))
    if upwards.shape != (3,) or not 1e-6 < length < math.inf:
        raise ValueError("`up` must be a direction of three numbers, not {}".format(upwards.tolist()))
    return points, upwards / length


class KeypointHold:
    """Fills missing key points of one body for 0.7 s with their last place relative to the neck."""

    def __init__(self) -> None:
        self._origin = np.full(3, np.nan)
        self._origin_seen = -math.inf
        self._offsets = np.full((18, 3), np.nan)
        self._seen = np.full(18, -np.inf)

    def fill(self, points: np.ndarray, stamp: float) -> np.ndarray:
        """Return the points (18, 3) m, NaN unknown, of time `stamp` (s), with remembered ones filled in.

        Without a neck it is the middle of the shoulders, and for 0.7 s where it was. Stamps must not go back.
        """
        known = np.isfinite(points[:, 0])
        origin = points[NECK] if known[NECK] else 0.5 * (points[LEFT_SHOULDER] + points[RIGHT_SHOULDER])
        if math.isfinite(origin[0]):
            self._origin, self._origin_seen = origin.copy(), stamp
        elif stamp - self._origin_seen <= _POINT_HOLD_S:
            origin = self._origin
        else:
            return points
        self._offsets[known] = points[known] - origin
        self._seen[known] = stamp
        missing = ~known & (self._seen >= stamp - _POINT_HOLD_S)
        missing[NECK] = not known[NECK]
        self._offsets[NECK] = 0.0
        return np.where(missing[:, None], origin + self._offsets, points)

    def without_old(self, points: np.ndarray, stamp: float, most: float) -> np.ndarray:
        """Return filled points (18, 3) m without those that were last seen more than `most` s before `stamp`."""
        return np.where((stamp - self._seen <= most)[:, None], points, np.nan)
