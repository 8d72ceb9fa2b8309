"""Posture of a whole body: standing, sitting, crouching, laying, other; from trunk, thighs and shanks against
gravity."""

from __future__ import annotations

import math
from collections import deque
from enum import IntEnum
from typing import Deque, Dict, Iterable, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from hri_fullbody.core.keypoints import (
    LEFT_ANKLE,
    LEFT_HIP,
    LEFT_KNEE,
    LEFT_SHOULDER,
    LEFT_WRIST,
    RIGHT_ANKLE,
    RIGHT_HIP,
    RIGHT_KNEE,
    RIGHT_SHOULDER,
    RIGHT_WRIST,
)

_TRUNK = [LEFT_SHOULDER, RIGHT_SHOULDER, LEFT_HIP, RIGHT_HIP]
_HIPS, _KNEES, _ANKLES = [LEFT_HIP, RIGHT_HIP], [LEFT_KNEE, RIGHT_KNEE], [LEFT_ANKLE, RIGHT_ANKLE]

# Angles in degrees from the vertical, lengths in statures.
_UPRIGHT, _LYING = 50.0, 60.0
_STRAIGHT_THIGH, _STRAIGHT_KNEE = 38.0, 50.0
# Beside a straight leg, degrees of the thigh and the height of the foot (statures, in degrees) of who sits: 45 and .10,
# or 35 and .15; of who walks: 23 and .15.
_STEP, _STEP_HEIGHT, _STEP_THIGH = 50.0, 150.0, 25.0
_HANGING_THIGH = 22.0
# A seat bears the hips at the height of the knees. Estimated hips lie up to a tenth of the leg too high on people who
# sit, so that their thighs seem to slope.
_SEAT_THIGH_LOW, _SEAT_THIGH_HIGH = 38.0, 135.0
_HIDDEN_SEAT_THIGH_LOW = 50.0
_SEAT_TRUNK = 30.0
_SEAT_SHANK = 60.0
_ON_GROUND = 0.18
_CROUCH_KNEE, _CROUCH_SHANK, _CROUCH_THIGHS, _CROUCH_HEIGHT = 42.0, 80.0, (14.0, 125.0), 0.36
_SAME_THIGHS = 35.0  # both legs bear the weight; on one knee or in a lunge they differ by more
_OVER_FEET = 0.085
# Height of the hips above the ankles (statures): .1 and more of who crouches with the hips on the heels; of who sits
# cross-legged on the ground, as near above the feet, about 0.
_SITS_ON_GROUND = 0.06
_SHORT_LEG = 0.74
_LEG = 0.481  # thigh and shank
_HOLD_S = 0.3
_UNKNOWN_S = 1.0
# Who sits keeps the knees where they are before the hips. Standard deviation (statures) over the last _STILL_S of one
# that may be guessed: on photographs mostly under .05 of who sits; of a hidden one, guessed anew each time, .08 to .11.
_STILL_S, _STILL_SD = 0.6, 0.05
# Standard deviation of the vertical below which it is exact; else the directions that are tried, in standard
# deviations, with their weights, the share of a posture among all that are told, and its least weight.
_EXACT = math.radians(2.0)
_PITCHES = ((-1.8, 0.07), (-1.2, 0.14), (-0.6, 0.20), (0.0, 0.18), (0.6, 0.20), (1.2, 0.14), (1.8, 0.07))
_AGREEING, _LEAST_VOTES = 0.9, 0.25
_STANDS = 0.8       # of all votes: of somebody on a stool with one leg seen .59 to .79 stand
# A half squat is a seated body that is turned forward by some 25 degrees. Direction from the feet to the middle of the
# trunk, degrees forward of the vertical, of both, with its standard deviation between people; and how often people
# crouch for each time that they sit, where the vertical is less certain than _BALANCE: then nobody has stood.
_SEATED_LEAN, _CROUCHED_LEAN, _LEAN_SD = -18.0, 5.0, 5.0
_BALANCE = math.radians(7.0)
_BENT_LEG, _BENT_THIGH = 0.40, 25.0     # hip to ankle, statures; thighs hang straight on who kneels
_VAGUE_KNEE = 35.0      # degrees of the straighter knee of who stands, while the vertical is that uncertain
_CROUCHING_PRIOR = 0.1
GUESSED = 0.5       # confidence of the pose network below which a joint is not seen
# Two knees that are seen in turn are evidence together: least low-passed confidence of either and of both.
_KNEE_S, _EITHER_KNEE, _BOTH_KNEES = 0.6, 0.35, 0.9
# A pose network that invents legs drags the hips down with them, and is less sure that there is a body. Length (m) of
# the trunk, see trunk_in_image, and score beyond which legs are guessed, low-passed: 1.9 % of 160 pictures of 22 people
# who sit are beyond, and 70 % of 118 of standing ones with hidden legs that look as if they sat (44 % of strangers).
_LONG_TRUNK, _LOW_SCORE, _TRUNK_S = 0.465, 0.9, 1.0
_STANDING_TRUNK = 0.45      # m: the trunk of who sits looks shorter
_STANDING_HIPS = 0.40       # statures above the floor, of who stands .5; of who kneels with straight thighs .3
_BESIDE_STRAIGHT = 35.0     # degrees of a thigh whose foot is hidden, beside a straight leg: a stool, or a high step


class PostureClass(IntEnum):
    """Postures; the numbers are the constants of hri_msgs/BodyPosture."""

    OTHER = 0
    STANDING = 1
    SITTING = 2
    CROUCHING = 3
    LAYING = 4


class Leg(NamedTuple):
    """Measures of one leg; NaN unknown.

    thigh: degrees of the thigh from straight down; more than 90 with the knee above the hip. shank: degrees of the
    shank from straight down. knee: degrees of flexion, 0 for a straight leg. height: hip above ankle, statures.
    """

    thigh: float
    shank: float
    knee: float
    height: float


class PostureEstimator:
    """The posture of one body over time: a new one counts after 0.3 s, an unknown one as long as it was seen, at most
    1 s."""

    def __init__(self) -> None:
        self.posture = PostureClass.OTHER
        self._next: Optional[PostureClass] = None
        self._held = self._unknown = 0.0
        self._shown = 0.0       # s for which the present posture was seen
        self._now = 0.0
        self._thighs: Deque[Tuple[float, np.ndarray]] = deque()

    def update(self, points: np.ndarray, axes: np.ndarray, stature: float, up: np.ndarray,
               elapsed: float, up_sd: float = 0.0, feet: bool = True,
               unsure: Sequence[bool] = (False, False), guessed: bool = False,
               leaving: bool = False, hips: float = math.nan) -> PostureClass:
        """Take the body `elapsed` s after the last call; see `posture_now`. up_sd: of the pitch of `up`, rad.

        feet: whether there is any sign of an ankle. Without one, behind a table or another person, the network bends
        the legs of those who stand, too: then only standing and lying are told.
        unsure: whether the left and the right knee may be guessed: one that jumps about is no sign of sitting, and
            two of them are none of crouching.
        guessed: whether the legs are, see GuessedLegs: nobody sits on them.
        leaving: whether thighs_leave_image: who is upright and has no other sign of legs stands.
        hips: their height above the floor, statures, NaN unknown: with shanks unseen, who kneels looks as if standing.
        """
        seen = (posture_now(points, axes, stature, up) if up_sd <= _EXACT
                else likely_posture(points, axes, stature, up, up_sd))
        if seen is None and leaving and _degrees(float(axes[2] @ up)) < _UPRIGHT:
            seen = PostureClass.STANDING
        if seen == PostureClass.STANDING and hips < _STANDING_HIPS and np.isnan(points[_ANKLES, 0]).all():
            seen = None
        jumps = self._jumps(np.where(np.reshape(unsure, (2, 1)), points[_KNEES] - points[_HIPS], np.nan) / stature,
                            elapsed)
        if not feet and seen in (PostureClass.SITTING, PostureClass.CROUCHING):
            seen = None
        if seen == PostureClass.CROUCHING and all(unsure):
            seen = None
        if seen == PostureClass.SITTING and (jumps or guessed):
            seen = None if seen == self.posture else PostureClass.OTHER
        if seen is None:
            self._unknown += elapsed
            if self._unknown > min(_UNKNOWN_S, self._shown):
                self.posture, self._next, self._shown = PostureClass.OTHER, None, 0.0
            return self.posture
        self._unknown = 0.0
        self._held = self._held + elapsed if seen == self._next else 0.0
        self._next = seen
        if self._held >= _HOLD_S - 1e-6:
            self.posture, self._shown = seen, self._held
        return self.posture

    def _jumps(self, thighs: np.ndarray, elapsed: float) -> bool:
        """Whether one of the thighs (2, 3), statures, NaN not to be judged, changed much in the last _STILL_S."""
        self._now += elapsed
        self._thighs.append((self._now, thighs))
        while self._thighs[0][0] < self._now - _STILL_S:
            self._thighs.popleft()
        for side in (0, 1):
            seen = np.array([both[side] for _, both in self._thighs if both[side, 0] == both[side, 0]])
            if len(seen) > 2 and float(seen.var(axis=0).sum()) > _STILL_SD ** 2:
                return True
        return False


class KneeSigns:
    """Which knees of a body count as seen: one that is, or both that are guessed often enough.

    On people who sit, the confidences of both knees go up and down by .2 from image to image; each alone is below
    GUESSED half of the time.
    """

    def __init__(self) -> None:
        self._mean: Optional[np.ndarray] = None

    def update(self, confidence: np.ndarray, elapsed: float) -> np.ndarray:
        """Take the confidences (2,) `elapsed` s after the last call; return whether each knee (2,) counts."""
        confidence = np.nan_to_num(confidence)
        before = confidence if self._mean is None else self._mean
        mean = self._mean = before + (1.0 - math.exp(-elapsed / _KNEE_S)) * (confidence - before)
        together = bool(mean.sum() >= _BOTH_KNEES and mean.min() > _EITHER_KNEE)
        return (confidence >= GUESSED) | together


class GuessedLegs:
    """Whether the pose network invents the legs of a body: then its trunk is too long, or its score is low."""

    def __init__(self) -> None:
        self._trunk = self._score = math.nan

    def update(self, trunk: float, score: float, elapsed: float) -> bool:
        """Take the length (m) of the trunk, see trunk_in_image, and the score, 0 to 1, `elapsed` s after the last call.

        NaN unknown.
        """
        share = 1.0 - math.exp(-elapsed / _TRUNK_S)
        self._trunk, self._score = _towards(self._trunk, trunk, share), _towards(self._score, score, share)
        return self._trunk > _LONG_TRUNK or self._score < _LOW_SCORE

    @property
    def stand(self) -> bool:
        """Whether trunk and score are those of somebody who stands; False while they are unknown."""
        return self._trunk > _STANDING_TRUNK and self._score >= _LOW_SCORE


def _towards(before: float, value: float, share: float) -> float:
    """What lies `share` of the way from `before` to `value`; the one that is known when the other is NaN."""
    if value != value:
        return before
    return value if before != before else before + share * (value - before)


def without_guessed_limbs(points: np.ndarray, keypoints: np.ndarray, width: float, height: float) -> np.ndarray:
    """Return key points (18, 3) m without wrists, knees and ankles that an image of width x height px does not show.

    keypoints: (18, 2) px, or (18, 3) with the confidence. A pose network places what lies below the image or behind a
    table, too, mostly hanging down: that is its habit and no detection of a leg; a guessed hand is often put before the
    face. Knees in the image stay, see KneeSigns.
    """
    limbs = np.array([LEFT_WRIST, RIGHT_WRIST, LEFT_KNEE, RIGHT_KNEE, LEFT_ANKLE, RIGHT_ANKLE])
    x, y = keypoints[limbs, 0], keypoints[limbs, 1]
    inside = (x >= 0.0) & (x < width) & (y >= 0.0) & (y < height)
    if keypoints.shape[1] > 2:
        inside &= (keypoints[limbs, 2] >= GUESSED) | np.isin(limbs, _KNEES)
    seen = np.array(points, dtype=np.float64)
    seen[limbs[~inside]] = np.nan
    return seen


def without_feet_outside(keypoints: np.ndarray, width: float, height: float) -> np.ndarray:
    """Return the confidences (18,) of key points (18, 3) px, NaN for ankles outside an image of width x height px: that
    they are not seen is no sign that something hides them."""
    ankles = np.isin(np.arange(len(keypoints)), (LEFT_ANKLE, RIGHT_ANKLE))
    inside = ((keypoints[:, :2] >= 0.0) & (keypoints[:, :2] < (width, height))).all(axis=1)
    return np.where(ankles & ~inside, np.nan, keypoints[:, 2])


def likely_posture(points: np.ndarray, axes: np.ndarray, stature: float, up: np.ndarray,
                   up_sd: float) -> Optional[PostureClass]:
    """Return the posture that most of the directions which `up` may have tell, None when they do not agree.

    up_sd: standard deviation of its pitch, rad. OTHER speaks against no posture as long as other directions have one.
    """
    votes: Dict[Optional[PostureClass], float] = {}
    for share, weight in _PITCHES:
        seen = posture_now(points, axes, stature, _pitched(up, share * up_sd))
        votes[seen] = votes.get(seen, 0.0) + weight
    named = {posture: weight for posture, weight in votes.items() if posture}
    agreed = _agreed(named)
    vague = up_sd > _BALANCE and _has_bent_legs(points, stature, up)
    if agreed == PostureClass.STANDING and named[agreed] < _STANDS and not vague:
        return PostureClass.OTHER
    if up_sd <= _BALANCE and agreed is not None:
        return agreed
    if not named and not vague:
        return PostureClass.OTHER if votes.get(PostureClass.OTHER, 0.0) > 0.5 else None
    sitting = named.pop(PostureClass.SITTING, 0.0)
    low = sitting + named.pop(PostureClass.CROUCHING, 0.0)
    crouches = _crouching_share(points, axes, stature, up, up_sd)
    if vague:
        named, low = {}, 1.0
    named.update({PostureClass.SITTING: low * (1.0 - crouches), PostureClass.CROUCHING: low * crouches})
    best = _agreed(named)
    if best == PostureClass.STANDING and up_sd > _BALANCE and not _knee(points) < _VAGUE_KNEE:
        return None
    return None if best == PostureClass.SITTING and sitting == 0.0 and votes.get(PostureClass.CROUCHING) else best


def _agreed(votes: Dict[PostureClass, float]) -> Optional[PostureClass]:
    """The posture that nearly all votes are for, None when there is none or they are too few."""
    best = max(votes, key=lambda posture: votes[posture], default=None)
    if best is None or votes[best] < max(_AGREEING * sum(votes.values()), _LEAST_VOTES):
        return None
    return best


def _has_bent_legs(points: np.ndarray, stature: float, up: np.ndarray) -> bool:
    """Whether both legs are as bent and as short as those of who sits or crouches, whatever the vertical is."""
    for hip, knee, ankle in ((LEFT_HIP, LEFT_KNEE, LEFT_ANKLE), (RIGHT_HIP, RIGHT_KNEE, RIGHT_ANKLE)):
        leg = _leg(points, hip, knee, ankle, stature, up)
        reach = float(np.linalg.norm(points[hip] - points[ankle]))
        if not (leg.knee > _CROUCH_KNEE and reach < _BENT_LEG * stature and leg.shank < _SEAT_SHANK
                and _BENT_THIGH < leg.thigh < _SEAT_THIGH_HIGH):
            return False
    return True


def _knee(points: np.ndarray) -> float:
    """Flexion (degrees) of the straighter knee, NaN when none is known."""
    flexions = []
    for hip in (LEFT_HIP, RIGHT_HIP):
        thigh, shank = points[hip + 1] - points[hip], points[hip + 2] - points[hip + 1]
        lengths = float(np.linalg.norm(thigh) * np.linalg.norm(shank))
        if lengths > 1e-6:
            flexions.append(_degrees(float(thigh @ shank) / lengths))
    return min(flexions, default=math.nan)


def _crouching_share(points: np.ndarray, axes: np.ndarray, stature: float, up: np.ndarray, up_sd: float) -> float:
    """Probability that a body with its hips low and its knees bent crouches instead of sitting, by its balance; 0 with
    the hips on the ground.

    axes: trunk_axes of the points (18, 3) m. up_sd: standard deviation of the pitch of `up`, rad.
    """
    from_feet = 0.25 * points[_TRUNK].sum(axis=0) - 0.5 * (points[LEFT_ANKLE] + points[RIGHT_ANKLE])
    if not np.isfinite(from_feet[0]):
        return 0.0
    legs = points[_HIPS].sum(axis=0) - points[_ANKLES].sum(axis=0)
    if 0.5 * float(legs @ up) < _SITS_ON_GROUND * stature:
        return 0.0
    ahead = axes[0] - float(axes[0] @ up) * up
    level = float(ahead @ from_feet) / max(float(ahead @ ahead) ** 0.5, 1e-6)
    lean = math.degrees(math.atan2(level, float(from_feet @ up)))
    seated, crouched = lean - _SEATED_LEAN, lean - _CROUCHED_LEAN
    odds = (seated * seated - crouched * crouched) / (2.0 * (_LEAN_SD ** 2 + math.degrees(up_sd) ** 2))
    prior = math.log(_CROUCHING_PRIOR) if up_sd > _BALANCE else 0.0
    return 1.0 / (1.0 + math.exp(-max(-50.0, min(50.0, odds + prior))))


def _pitched(up: np.ndarray, angle: float) -> np.ndarray:
    """Turn a direction (3,) in the optical frame about the x axis, as a camera that looks down by `angle` rad more."""
    cosine, sine = math.cos(angle), math.sin(angle)
    return np.array([up[0], cosine * up[1] - sine * up[2], sine * up[1] + cosine * up[2]])


def posture_now(points: np.ndarray, axes: np.ndarray, stature: float, up: np.ndarray) -> Optional[PostureClass]:
    """Return the posture of one frame, None when too little is seen to say anything.

    points: (18, 3) m, NaN unknown. axes: trunk_axes of them. stature: m. up: (3,) unit vector against gravity.
    With the legs hidden only somebody on the back or on a side is sure to lie; all else is None.
    """
    hips = 0.5 * (points[LEFT_HIP] + points[RIGHT_HIP])
    if not (np.isfinite(hips[0]) and np.isfinite(axes[2, 0])):
        return None
    tilt = _degrees(float(axes[2] @ up))
    legs = [leg for leg in (_leg(points, LEFT_HIP, LEFT_KNEE, LEFT_ANKLE, stature, up),
                            _leg(points, RIGHT_HIP, RIGHT_KNEE, RIGHT_ANKLE, stature, up)) if leg.thigh == leg.thigh]
    if tilt > 180.0 - _UPRIGHT:
        return PostureClass.OTHER
    if tilt > _UPRIGHT:
        return _bent_or_lying(tilt, axes, up, legs)
    if not legs:
        return None
    return _upright(points, hips, tilt, legs, stature, up)


def _bent_or_lying(tilt: float, axes: np.ndarray, up: np.ndarray, legs: list) -> Optional[PostureClass]:
    if tilt <= _LYING:
        return PostureClass.OTHER
    if not legs:
        # Nobody bends backward or sideways this far; forward they may, so that is not known.
        on_back, on_side = float(axes[0] @ up) > 0.5, abs(float(axes[1] @ up)) > 0.7
        return PostureClass.LAYING if on_back or on_side else None
    flat = max(leg.thigh for leg in legs) > 50.0
    low = all(not leg.height > 0.15 for leg in legs)
    return PostureClass.LAYING if flat and low else PostureClass.OTHER


def _upright(points: np.ndarray, hips: np.ndarray, tilt: float, legs: list, stature: float,
             up: np.ndarray) -> PostureClass:
    whole = [leg for leg in legs if leg.height == leg.height]
    if not whole:
        if all(leg.thigh < _HANGING_THIGH for leg in legs):
            return PostureClass.STANDING
        seated = tilt < _SEAT_TRUNK and len(legs) == 2 and all(
            _HIDDEN_SEAT_THIGH_LOW < leg.thigh < _SEAT_THIGH_HIGH for leg in legs)
        return PostureClass.SITTING if seated else PostureClass.OTHER
    # A leg that seems straight while the hips are low is a wrong one: straight legs are long.
    low = max(leg.height for leg in whole) < _CROUCH_HEIGHT
    if not low and any(leg.thigh < _STRAIGHT_THIGH and leg.knee < _STRAIGHT_KNEE and leg.shank < _CROUCH_SHANK
                       for leg in whole):
        longest = max(leg.height for leg in whole)
        stepping = any(leg.thigh > max(_STEP_THIGH, _STEP - _STEP_HEIGHT * (longest - leg.height)) for leg in whole)
        stepping |= any(leg.thigh > _BESIDE_STRAIGHT for leg in legs if not leg.height == leg.height)
        return PostureClass.OTHER if stepping else PostureClass.STANDING
    if max(leg.height for leg in whole) > _SHORT_LEG * _LEG or min(leg.height for leg in whole) < -0.1:
        return PostureClass.OTHER
    thighs = [leg.thigh for leg in whole]
    on_ground = _middle(leg.height for leg in whole) < _SITS_ON_GROUND
    if len(whole) == 2 and not on_ground and _over_feet(points, hips, stature, up):
        deep = (low and _middle(leg.knee for leg in whole) > _CROUCH_KNEE
                and _middle(leg.shank for leg in whole) < _CROUCH_SHANK
                and _CROUCH_THIGHS[0] < _middle(thighs) < _CROUCH_THIGHS[1]
                and max(thighs) - min(thighs) < _SAME_THIGHS)
        return PostureClass.CROUCHING if deep else PostureClass.OTHER
    # A thigh whose foot is hidden counts, too: a foot on a step.
    seated = all(leg.thigh > _SEAT_THIGH_LOW for leg in legs) and all(leg.thigh < _SEAT_THIGH_HIGH and (
        leg.shank < _SEAT_SHANK or leg.height < _ON_GROUND) for leg in whole)
    return PostureClass.SITTING if seated else PostureClass.OTHER


def _over_feet(points: np.ndarray, hips: np.ndarray, stature: float, up: np.ndarray) -> bool:
    """Whether the trunk's middle is so near above the ankles that the feet can carry it."""
    ankles = points[[LEFT_ANKLE, RIGHT_ANKLE]]
    offset = 0.5 * (hips + 0.5 * (points[LEFT_SHOULDER] + points[RIGHT_SHOULDER])) - ankles.mean(axis=0)
    if not np.isfinite(offset[0]):
        offset = hips - ankles.mean(axis=0)
    level = offset - float(offset @ up) * up
    return float(level @ level) ** 0.5 < _OVER_FEET * stature


def _leg(points: np.ndarray, hip: int, knee: int, ankle: int, stature: float, up: np.ndarray) -> Leg:
    thigh, shank = points[knee] - points[hip], points[ankle] - points[knee]
    thigh_length, shank_length = float(thigh @ thigh) ** 0.5, float(shank @ shank) ** 0.5
    if not thigh_length > 1e-6:
        return Leg(math.nan, math.nan, math.nan, math.nan)
    thigh_down = -float(thigh @ up)
    if not shank_length > 1e-6:
        return Leg(_degrees(thigh_down / thigh_length), math.nan, math.nan, math.nan)
    shank_down = -float(shank @ up)
    return Leg(
        _degrees(thigh_down / thigh_length), _degrees(shank_down / shank_length),
        _degrees(float(thigh @ shank) / (thigh_length * shank_length)), (thigh_down + shank_down) / stature)


def _middle(values: Iterable[float]) -> float:
    known = list(values)
    return sum(known) / len(known)


def _degrees(cosine: float) -> float:
    return math.degrees(math.acos(min(1.0, max(-1.0, cosine))))
