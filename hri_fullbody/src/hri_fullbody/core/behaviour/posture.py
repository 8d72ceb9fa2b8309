"""Posture of a whole body: standing, sitting, crouching, laying, other; from trunk, thighs and shanks against
gravity."""

from __future__ import annotations

import math
from collections import deque
from enum import IntEnum
from typing import Deque, Dict, Iterable, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from hri_fullbody.core.behaviour.arms import Vector, dot, length, minus
from hri_fullbody.core.keypoints import (
    LEFT_ANKLE,
    LEFT_HIP,
    LEFT_KNEE,
    LEFT_SHOULDER,
    RIGHT_ANKLE,
    RIGHT_HIP,
    RIGHT_KNEE,
    RIGHT_SHOULDER,
)

_LEGS = ((LEFT_HIP, LEFT_KNEE, LEFT_ANKLE), (RIGHT_HIP, RIGHT_KNEE, RIGHT_ANKLE))

_LEAST_LENGTH_M = 1e-6

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
_GROUND_THIGH = 110.0       # degrees; with the knees higher than that above the hips, and over the feet, it is a squat
# Legs that no chair folds so far: hips to ankles (statures), mean and straighter knee (degrees). Of people drawn, or
# before a Kinect, on chairs .27 and more, 112 and less; who squats .25 and less, 119 to 158; on the heels more.
_FOLDED_REACH, _FOLDED_KNEES, _FOLDED_KNEE = 0.265, (117.0, 158.0), 100.0
# Their trunk beside the feet (statures): of who squats less than the first, of who sits on a kerb mostly more than the
# other; and as _SEATED_LEAN, with its standard deviation.
_SQUAT_FEET, _KERB_FEET = 0.12, 0.14
_KERB_LEAN, _SQUAT_LEAN, _FOLDED_LEAN_SD = -44.0, -3.0, 8.0
# Legs that are less folded: thighs (degrees) of who crouches, mostly more of who leans forward on a chair. With such
# thighs, below a trunk that leans forward by 15 degrees and is as far beside the feet, it may be either.
_CHAIR_THIGH = 78.0
_HALF_SQUAT_THIGH, _HALF_SQUAT_FEET, _LEANS = 73.0, 0.125, -0.26
_SHORT_LEG = 0.74
_LEG = 0.481  # thigh and shank
_HOLD_S = 0.3
_UNKNOWN_S = 1.0
# Who sits keeps the knees where they are before the hips. Standard deviation (statures) over the last _STILL_S of one
# that may be guessed: on photographs mostly under .05 of who sits; of a hidden one, guessed anew each time, .08 to .11.
# After a jump it is guessed for _WARY_S more: by chance two or three guesses are alike.
_STILL_S, _STILL_SD, _WARY_S = 0.6, 0.05, 1.0
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
_STANDING_HIPS = 0.40       # statures above the floor, of who stands .5; of who kneels with straight thighs .3
_BESIDE_STRAIGHT = 35.0     # degrees of a thigh whose foot is hidden, beside a straight leg: a stool, or a high step


class PostureClass(IntEnum):
    """Postures; the numbers are the constants of hri_msgs/BodyPosture."""

    OTHER = 0
    STANDING = 1
    SITTING = 2
    CROUCHING = 3
    LAYING = 4


_LOW = (PostureClass.SITTING, PostureClass.CROUCHING)


class Leg(NamedTuple):
    """Measures of one leg; NaN unknown.

    thigh: degrees of the thigh from straight down; more than 90 with the knee above the hip. shank: degrees of the
    shank from straight down. knee: degrees of flexion, 0 for a straight leg. height: hip above ankle, statures.
    """

    thigh: float
    shank: float
    knee: float
    height: float


class _Limb(NamedTuple):
    """Thigh and shank, m, their lengths, m, and the flexion of the knee, degrees; NaN unknown."""

    thigh: Vector
    shank: Vector
    thigh_length: float
    shank_length: float
    knee: float


class Figure(NamedTuple):
    """A body in plain numbers, quicker than arrays for so few vectors, with what does not hang on the vertical.

    rows: 18 points (3) m, NaN unknown. axes: `arms.trunk_axes` of them, as rows. stature: m. hips: middle of both (3)
    m. limbs: left and right leg.
    """

    rows: List[Vector]
    axes: List[Vector]
    stature: float
    hips: Vector
    limbs: Tuple[_Limb, _Limb]

    @classmethod
    def of(cls, points: np.ndarray, axes: np.ndarray, stature: float) -> Figure:
        """Make it of points (18, 3) m, and their trunk_axes (3, 3)."""
        rows = points.tolist()
        left, right = (_limb(*(rows[index] for index in leg)) for leg in _LEGS)
        return cls(rows, axes.tolist(), stature, _between(rows[LEFT_HIP], rows[RIGHT_HIP]), (left, right))


class PostureEstimator:
    """The posture of one body over time: a new one counts after 0.3 s, an unknown one as long as it was seen, at most
    1 s."""

    def __init__(self) -> None:
        self.posture = PostureClass.OTHER
        self._next: Optional[PostureClass] = None
        self._held = self._unknown = 0.0
        self._shown = 0.0       # s for which the present posture was seen
        self._now, self._jumped = 0.0, -math.inf
        self._thighs: Deque[Tuple[float, Sequence[Optional[Vector]]]] = deque()

    def update(self, points: np.ndarray, axes: np.ndarray, stature: float, up: np.ndarray,
               elapsed: float, up_sd: float = 0.0, feet: bool = True,
               unsure: Sequence[bool] = (False, False), guessed: bool = False,
               leaving: bool = False, hips: float = math.nan) -> PostureClass:
        """Take the body `elapsed` s after the last call; see `posture_now`. up_sd: of the pitch of `up`, rad.

        feet: whether there is any sign of an ankle. Without one, behind a table or another person, the network bends
        the legs of those who stand, too: then only standing and lying are told.
        unsure: whether the left and the right knee may be guessed: one that jumps about is no sign of sitting, and
            two of them are none of crouching.
        guessed: whether the legs are, see `guessed_limbs`: nobody sits on them.
        leaving: whether thighs_leave_image: who is upright and has no other sign of legs stands.
        hips: their height above the floor, statures, NaN unknown: with shanks unseen, who kneels looks as if standing.
        """
        figure, vertical = Figure.of(points, axes, stature), up.tolist()
        seen = posture_now(figure, vertical) if up_sd <= _EXACT else likely_posture(figure, vertical, up_sd)
        if seen is None and leaving and _degrees(dot(figure.axes[2], vertical)) < _UPRIGHT:
            seen = PostureClass.STANDING
        if seen == PostureClass.STANDING and hips < _STANDING_HIPS and all(
                math.isnan(figure.rows[ankle][0]) for _, _, ankle in _LEGS):
            seen = None
        jumps = self._jumps([[value / stature for value in limb.thigh] if guess and not math.isnan(limb.thigh[0])
                             else None for limb, guess in zip(figure.limbs, unsure)], elapsed)
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

    def _jumps(self, thighs: Sequence[Optional[Vector]], elapsed: float) -> bool:
        """Whether the left or the right thigh, statures, None not to be judged, changed much in _STILL_S lately."""
        self._now += elapsed
        self._thighs.append((self._now, thighs))
        while self._thighs[0][0] < self._now - _STILL_S:
            self._thighs.popleft()
        for side in (0, 1):
            seen = [both[side] for _, both in self._thighs if both[side] is not None]
            if len(seen) > 2 and sum(map(_variance, zip(*seen))) > _STILL_SD ** 2:
                self._jumped = self._now
        return self._now - self._jumped <= _WARY_S


def likely_posture(figure: Figure, up: Vector, up_sd: float) -> Optional[PostureClass]:
    """Return the posture that most of the directions which `up` may have tell, None when they do not agree.

    up: unit vector (3) against gravity; up_sd: standard deviation of its pitch, rad. OTHER speaks against no posture as
    long as other directions have one.
    """
    votes: Dict[Optional[PostureClass], float] = {}
    for share, weight in _PITCHES:
        seen = posture_now(figure, _pitched(up, share * up_sd))
        votes[seen] = votes.get(seen, 0.0) + weight
    named = {posture: weight for posture, weight in votes.items() if posture}
    agreed = _agreed(named)
    lies = not _degrees(dot(figure.axes[2], up)) < _LYING       # with the knees up the legs are those of who sits
    vague = up_sd > _BALANCE and not lies and _has_bent_legs(figure, up)
    if agreed == PostureClass.STANDING and named[agreed] < _STANDS and not vague:
        return PostureClass.OTHER
    folded = _is_folded(figure)
    if up_sd <= _BALANCE and agreed is not None and not folded:
        return agreed
    if not named and not vague:
        return PostureClass.OTHER if votes.get(PostureClass.OTHER, 0.0) > 0.5 else None
    sitting = named.pop(PostureClass.SITTING, 0.0)
    low = sitting + named.pop(PostureClass.CROUCHING, 0.0)
    crouches = _crouching_share(figure, up, up_sd)
    if vague:
        named, low = {}, 1.0
    named.update({PostureClass.SITTING: low * (1.0 - crouches), PostureClass.CROUCHING: low * crouches})
    best = _agreed(named)
    if best == PostureClass.STANDING and up_sd > _BALANCE and not _knee(figure) < _VAGUE_KNEE:
        return None
    if folded and best in _LOW and not _are_alike(figure, up):
        return PostureClass.OTHER
    return None if best == PostureClass.SITTING and sitting == 0.0 and votes.get(PostureClass.CROUCHING) else best


def _agreed(votes: Dict[PostureClass, float]) -> Optional[PostureClass]:
    """The posture that nearly all votes are for, None when there is none or they are too few."""
    best = max(votes, key=lambda posture: votes[posture], default=None)
    if best is None or votes[best] < max(_AGREEING * sum(votes.values()), _LEAST_VOTES):
        return None
    return best


def _has_bent_legs(figure: Figure, up: Vector) -> bool:
    """Whether both legs are as bent and as short as those of who sits or crouches, whatever the vertical is."""
    for limb, (hip, _, ankle) in zip(figure.limbs, _LEGS):
        leg = _leg(limb, figure.stature, up)
        reach = length(minus(figure.rows[hip], figure.rows[ankle]))
        if not (leg.knee > _CROUCH_KNEE and reach < _BENT_LEG * figure.stature and leg.shank < _SEAT_SHANK
                and _BENT_THIGH < leg.thigh < _SEAT_THIGH_HIGH):
            return False
    return True


def _knee(figure: Figure) -> float:
    """Flexion (degrees) of the straighter knee, NaN when none is known."""
    return min((limb.knee for limb in figure.limbs if limb.knee == limb.knee), default=math.nan)


def _crouching_share(figure: Figure, up: Vector, up_sd: float) -> float:
    """Probability that a body with its hips low and its knees bent crouches instead of sitting, by its balance; 0 with
    the hips on the ground.

    up_sd: standard deviation of the pitch of `up`, rad.
    """
    rows = figure.rows
    trunk = _between(_between(rows[LEFT_SHOULDER], rows[RIGHT_SHOULDER]), figure.hips)
    feet = _between(rows[LEFT_ANKLE], rows[RIGHT_ANKLE])
    from_feet = minus(trunk, feet)
    if not math.isfinite(from_feet[0]):
        return 0.0
    thigh = _middle(_leg(limb, figure.stature, up).thigh for limb in figure.limbs)
    if _on_ground(dot(minus(figure.hips, feet), up) / figure.stature, thigh, _beside_feet(figure, up)):
        return 0.0
    folded = _is_folded(figure)
    ahead = _level(figure.axes[0], up)
    level = dot(ahead, from_feet) / max(length(ahead), 1e-6)
    lean = math.degrees(math.atan2(level, dot(from_feet, up)))
    low, high, spread = ((_KERB_LEAN, _SQUAT_LEAN, _FOLDED_LEAN_SD) if folded
                         else (_SEATED_LEAN, _CROUCHED_LEAN, _LEAN_SD))
    seated, crouched = lean - low, lean - high
    odds = (seated * seated - crouched * crouched) / (2.0 * (spread ** 2 + math.degrees(up_sd) ** 2))
    prior = math.log(_CROUCHING_PRIOR) if up_sd > _BALANCE and not folded else 0.0
    return 1.0 / (1.0 + math.exp(-max(-50.0, min(50.0, odds + prior))))


def _pitched(up: Vector, angle: float) -> Vector:
    """Turn a direction (3) in the optical frame about the x axis, as a camera that looks down by `angle` rad more."""
    cosine, sine = math.cos(angle), math.sin(angle)
    return up[0], cosine * up[1] - sine * up[2], sine * up[1] + cosine * up[2]


def posture_now(figure: Figure, up: Vector) -> Optional[PostureClass]:
    """Return the posture of one frame, None when too little is seen to say anything.

    up: unit vector (3) against gravity. With the legs hidden only somebody on the back or on a side is sure to lie; all
    else is None.
    """
    if not (math.isfinite(figure.hips[0]) and math.isfinite(figure.axes[2][0])):
        return None
    tilt = _degrees(dot(figure.axes[2], up))
    if tilt > 180.0 - _UPRIGHT:
        return PostureClass.OTHER
    legs = [_leg(limb, figure.stature, up) for limb in figure.limbs if limb.thigh_length > _LEAST_LENGTH_M]
    if tilt > _UPRIGHT:
        return _bent_or_lying(tilt, figure.axes, up, legs)
    return _upright(figure, tilt, legs, up) if legs else None


def _bent_or_lying(tilt: float, axes: Sequence[Vector], up: Vector, legs: List[Leg]) -> Optional[PostureClass]:
    if tilt <= _LYING:
        return PostureClass.OTHER
    if not legs:
        # Nobody bends backward or sideways this far; forward they may, so that is not known.
        on_back, on_side = dot(axes[0], up) > 0.5, abs(dot(axes[1], up)) > 0.7
        return PostureClass.LAYING if on_back or on_side else None
    flat = max(leg.thigh for leg in legs) > 50.0
    low = all(not leg.height > 0.15 for leg in legs)
    return PostureClass.LAYING if flat and low else PostureClass.OTHER


def _upright(figure: Figure, tilt: float, legs: List[Leg], up: Vector) -> PostureClass:
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
    return _low_posture(figure, legs, low, up)


def _low_posture(figure: Figure, legs: List[Leg], low: bool, up: Vector) -> PostureClass:
    """The posture of an upright trunk on bent legs, one of them known at least. low: whether the hips are."""
    whole = [leg for leg in legs if leg.height == leg.height]
    thighs = [leg.thigh for leg in whole]
    thigh, alike, folded = _middle(thighs), max(thighs) - min(thighs) < _SAME_THIGHS, _is_folded(figure)
    beside = _beside_feet(figure, up) if len(whole) == 2 else math.nan
    if not _on_ground(_middle(leg.height for leg in whole), thigh, beside):
        if beside < (_SQUAT_FEET if folded else _OVER_FEET):
            deep = (low and alike and _middle(leg.knee for leg in whole) > _CROUCH_KNEE
                    and _middle(leg.shank for leg in whole) < _CROUCH_SHANK
                    and _CROUCH_THIGHS[0] < thigh < (_CROUCH_THIGHS[1] if folded else _CHAIR_THIGH))
            return PostureClass.CROUCHING if deep else PostureClass.OTHER
        half_squat = beside < _HALF_SQUAT_FEET and thigh < _HALF_SQUAT_THIGH and dot(figure.axes[0], up) < _LEANS
        if half_squat or (folded and not (alike and beside > _KERB_FEET)):
            return PostureClass.OTHER
    # A thigh whose foot is hidden counts, too: a foot on a step.
    seated = all(leg.thigh > _SEAT_THIGH_LOW for leg in legs) and all(leg.thigh < _SEAT_THIGH_HIGH and (
        leg.shank < _SEAT_SHANK or leg.height < _ON_GROUND) for leg in whole)
    return PostureClass.SITTING if seated else PostureClass.OTHER


def _on_ground(height: float, thigh: float, beside: float) -> bool:
    """Whether hips so high above the ankles (statures) are on the ground, by the thighs (degrees); see _beside_feet."""
    return height < _SITS_ON_GROUND and not (thigh > _GROUND_THIGH and beside < _OVER_FEET)


def _is_folded(figure: Figure) -> bool:
    """Whether both legs are folded further than on a chair, and less than on the heels.

    One alone says nothing: seen from the front the pose network folds a leg of who sits as far.
    """
    knees = [limb.knee for limb in figure.limbs]
    return (min(knees) > _FOLDED_KNEE and _FOLDED_KNEES[0] < _middle(knees) < _FOLDED_KNEES[1]
            and all(length(minus(figure.rows[hip], figure.rows[ankle])) < _FOLDED_REACH * figure.stature
                    for hip, _, ankle in _LEGS))


def _are_alike(figure: Figure, up: Vector) -> bool:
    """Whether both thighs slope so alike that both feet can bear the weight."""
    left, right = (_leg(limb, figure.stature, up).thigh for limb in figure.limbs)
    return not abs(left - right) > _SAME_THIGHS


def _beside_feet(figure: Figure, up: Vector) -> float:
    """How far (statures) the trunk's middle is from above the ankles, which can carry it where it is near."""
    rows, hips = figure.rows, figure.hips
    ankles = _between(rows[LEFT_ANKLE], rows[RIGHT_ANKLE])
    offset = minus(_between(hips, _between(rows[LEFT_SHOULDER], rows[RIGHT_SHOULDER])), ankles)
    if not math.isfinite(offset[0]):
        offset = minus(hips, ankles)
    return length(_level(offset, up)) / figure.stature


def _limb(hip: Vector, knee: Vector, ankle: Vector) -> _Limb:
    thigh, shank = minus(knee, hip), minus(ankle, knee)
    thigh_length, shank_length = length(thigh), length(shank)
    known = thigh_length > _LEAST_LENGTH_M and shank_length > _LEAST_LENGTH_M
    return _Limb(thigh, shank, thigh_length, shank_length,
                 _degrees(dot(thigh, shank) / (thigh_length * shank_length)) if known else math.nan)


def _leg(limb: _Limb, stature: float, up: Vector) -> Leg:
    if not limb.thigh_length > _LEAST_LENGTH_M:
        return Leg(math.nan, math.nan, math.nan, math.nan)
    thigh_down, shank_down = -dot(limb.thigh, up), -dot(limb.shank, up)
    thigh = _degrees(thigh_down / limb.thigh_length)
    if not limb.shank_length > _LEAST_LENGTH_M:
        return Leg(thigh, math.nan, math.nan, math.nan)
    return Leg(thigh, _degrees(shank_down / limb.shank_length), limb.knee, (thigh_down + shank_down) / stature)


def _between(a: Vector, b: Vector) -> Vector:
    return 0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]), 0.5 * (a[2] + b[2])


def _level(vector: Vector, up: Vector) -> Vector:
    """What of a vector is at right angles to the vertical."""
    height = dot(vector, up)
    return [value - height * axis for value, axis in zip(vector, up)]


def _variance(values: Sequence[float]) -> float:
    mean = sum(values) / len(values)
    return sum((value - mean) ** 2 for value in values) / len(values)


def _middle(values: Iterable[float]) -> float:
    known = list(values)
    return sum(known) / len(known)


def _degrees(cosine: float) -> float:
    return math.degrees(math.acos(min(1.0, max(-1.0, cosine))))
