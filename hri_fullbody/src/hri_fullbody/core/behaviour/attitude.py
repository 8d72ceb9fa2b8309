"""The attitude that a body shows with its arms: hands on face, arms crossed, hands raised, or none of these.

Each attitude has a score from 0 to 1, made of soft geometric rules in statures (arm_features), and a latch with two
thresholds and times in seconds, so that neither the frame rate nor a flicker of one frame changes the result.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Callable, Dict, List, Optional, Tuple

from hri_fullbody.core.behaviour.arms import ArmFeatures, Pair

_UNKNOWN = math.nan
_TIME_SLACK_S = 1e-6
_SMOOTHING_S = 0.1
_SPEED_S = 0.12
# Speeds of a wrist (statures/s). Folded arms are held; hands that clap are as near to the elbows, but move. Forearms as
# an X are shown for a moment only; what is faster swings past.
_CLAPPING, _HELD = 0.9, 0.6
_SWINGING, _SHOWN = 1.2, 0.8
# Log odds that arms are folded, against what else hands do near elbows: a constant, and by wrists ahead of the chest,
# forearms inward, angle between them (degrees), wrists to the other elbows, and speed (statures, statures/s). Logistic
# regression on simulated clips of mocap with depth noise; the constant is 1.5 less, since wrong claims cost more.
# Hands that meet (praying, at the other sleeve) have the wrists at the mid-plane, but so have some real folded arms.
_FOLDED_ODDS = (4.0, -27.0, 40.0, 0.02, -48.0, -1.5)


class AttitudeClass(IntEnum):
    """Attitudes; the numbers are the constants of hri_msgs/BodyAttitude."""

    OTHER = 0
    HANDS_ON_FACE = 1
    ARMS_CROSSED = 2
    HANDS_RAISED = 3


@dataclass(frozen=True)
class Rule:
    """When a latch closes and opens: scores 0 to 1, times in s.

    unknown_time: for how long a closed latch holds while the score is not known. looks: that many in turn, at least,
    must have a score beyond `on` before it closes.
    """

    on: float
    off: float
    on_time: float
    off_time: float
    unknown_time: float = 1.0
    looks: int = 0


RAISED_RULE = Rule(on=0.7, off=0.3, on_time=0.15, off_time=0.3)
# Of people close to each other one has the hand of who is behind before the face for a look or two. Crops of pictures
# at 5 Hz, images told rightly and wrongly: without that 334 and 19, with two looks in turn 320 and 16, three 244 and 5.
FACE_RULE = Rule(on=0.6, off=0.2, on_time=0.2, off_time=0.4, looks=3)
CROSSED_RULE = Rule(on=0.35, off=0.1, on_time=0.3, off_time=0.5)
_RULES = {AttitudeClass.HANDS_ON_FACE: FACE_RULE, AttitudeClass.ARMS_CROSSED: CROSSED_RULE,
          AttitudeClass.HANDS_RAISED: RAISED_RULE}
# An attitude is as sure as its score was lately: somebody who shows it comes near a score of 1, who does something like
# it seldom, and while its end is awaited the score tells nothing. Time constant (s) with which a peak is forgotten.
_PEAK_S = 2.0
# Peak of the score and how often the attitude is right, below and above, linear between. Fitted to drawn people of 42
# kinds, each as frequent, of which more come near an attitude than show it, to mocap and to clips of a depth camera.
_RIGHT: Dict[AttitudeClass, Tuple[Tuple[float, float], Tuple[float, float]]] = {
    AttitudeClass.HANDS_ON_FACE: ((0.78, 0.40), (1.0, 0.90)),
    AttitudeClass.ARMS_CROSSED: ((0.69, 0.20), (1.0, 1.0)),
    AttitudeClass.HANDS_RAISED: ((0.7, 0.95), (1.0, 1.0))}


class Latch:
    """A switch that closes after its score was high for a while, and opens after it was low for a while."""

    def __init__(self, rule: Rule) -> None:
        self._rule = rule
        self.active = False
        self._held = self._unknown = 0.0
        self._running = False
        self._in_turn = 0       # looks with a score beyond `on`

    def update(self, score: float, elapsed: float, seen: bool = True) -> bool:
        """Take a score (0 to 1, NaN unknown) `elapsed` s after the one before; return whether the latch is closed.

        Time counts from the first score beyond the threshold, so that one score alone never turns the latch, at
        whatever frame rate. seen: False for one of remembered key points: it holds a latch, and closes none.
        """
        self._in_turn = self._in_turn + 1 if score >= self._rule.on else 0
        if math.isnan(score):
            self._unknown += elapsed
            if self._unknown > self._rule.unknown_time:
                self.active, self._running, self._held = False, False, 0.0
            return self.active
        self._unknown = 0.0
        if not (seen or self.active):
            self._running, self._held = False, 0.0
            return False
        rule = self._rule
        towards = score < rule.off if self.active else score >= rule.on
        back = score >= rule.on if self.active else score < rule.off
        if towards:
            self._held += elapsed if self._running else 0.0
            self._running = True
            long_enough = self._held >= (rule.off_time if self.active else rule.on_time) - _TIME_SLACK_S
            if long_enough and (self.active or self._in_turn >= rule.looks):
                self.active, self._running, self._held = not self.active, False, 0.0
        elif back:
            self._running, self._held = False, 0.0
        return self.active


class _Smoothed:
    """A latch behind a first-order low pass of its score; `score` is NaN when it was not known for a second."""

    def __init__(self, rule: Rule) -> None:
        self.latch = Latch(rule)
        self.score = _UNKNOWN
        self._unknown = 0.0
        self._patience = rule.unknown_time

    def update(self, score: float, weight: float, elapsed: float, seen: bool = True) -> bool:
        if math.isnan(score):
            self._unknown += elapsed
            if self._unknown > self._patience:
                self.score = _UNKNOWN
            return self.latch.update(_UNKNOWN, elapsed)
        self._unknown = 0.0
        self.score = score if math.isnan(self.score) else self.score + weight * (score - self.score)
        return self.latch.update(self.score, elapsed, seen)


class _WristSpeed:
    """How fast the wrists move before the trunk: their low-passed velocity, in which noise averages out."""

    def __init__(self) -> None:
        self._last: Optional[List[float]] = None
        self._velocity = [0.0] * 6

    def update(self, features: ArmFeatures, elapsed: float) -> float:
        """Return the speed of the faster wrist (statures/s); NaN while a wrist is not known."""
        now = [value for pair in (features.outward, features.forward, features.level) for value in pair]
        if not all(map(math.isfinite, now)):
            self._last = None
            return _UNKNOWN
        if self._last is not None and elapsed > 0.0:
            weight = 1.0 - math.exp(-elapsed / _SPEED_S)
            self._velocity = [mean + weight * ((value - last) / elapsed - mean)
                              for mean, value, last in zip(self._velocity, now, self._last)]
        self._last = now
        return max(math.sqrt(sum(value * value for value in self._velocity[side::2])) for side in (0, 1))


class AttitudeEstimator:
    """The attitude of one body over time."""

    def __init__(self) -> None:
        self._raised = (_Smoothed(RAISED_RULE), _Smoothed(RAISED_RULE))
        self._face, self._crossed = _Smoothed(FACE_RULE), _Smoothed(CROSSED_RULE)
        self._speed = _WristSpeed()
        self.attitude, self.confidence = AttitudeClass.OTHER, 0.0
        self._peak = 0.0

    @property
    def raised(self) -> Tuple[bool, bool]:
        """Whether the left and the right hand are raised."""
        return self._raised[0].latch.active, self._raised[1].latch.active

    def update(self, features: ArmFeatures, elapsed: float, sure: Tuple[bool, bool] = (True, True),
               seen: Tuple[bool, bool] = (True, True)) -> AttitudeClass:
        """Take the arms `elapsed` s after the last call; return the attitude and keep it with its confidence.

        sure: whether elbow and wrist of the left and right arm are seen: a guessed hand is often put before the face.
        seen: whether the left and right wrist are of this look, not remembered: a raised hand begins with one that is
        seen in two looks in turn, since of people close to each other one often has a neighbour's hand for one look.
        Folded arms hide their own wrists.
        """
        weight = 1.0 - math.exp(-elapsed / _SMOOTHING_S)
        near = [face_score(features, side) if sure[side] else _UNKNOWN for side in (0, 1)]
        raised = [self._raised[side].update(_but_not(raised_score(features, side), near_face_score(features, side)),
                                            weight, elapsed, seen[side]) for side in (0, 1)]
        crossed = crossed_score(features, self._speed.update(features, elapsed))
        active = {
            AttitudeClass.HANDS_ON_FACE: self._face.update(_highest(*near), weight, elapsed),
            AttitudeClass.ARMS_CROSSED: self._crossed.update(crossed, weight, elapsed),
            AttitudeClass.HANDS_RAISED: any(raised)}
        self._choose([name for name, on in active.items() if on], elapsed)
        return self.attitude

    def _choose(self, candidates: List[AttitudeClass], elapsed: float) -> None:
        """Of several active attitudes the surest counts; the present one stays unless another is surer by 0.2, and one
        that is about to end does not begin."""
        sure = {
            AttitudeClass.HANDS_ON_FACE: self._face.score, AttitudeClass.ARMS_CROSSED: self._crossed.score,
            AttitudeClass.HANDS_RAISED: _highest(*(arm.score for arm in self._raised))}
        candidates = [name for name in candidates if name == self.attitude or not sure[name] < _RULES[name].on]
        if candidates:
            chosen = max(candidates, key=lambda name: _or(sure[name], 0.0) + 0.2 * (name == self.attitude))
            score = _or(sure[chosen], 0.0)
            before = self._peak if chosen == self.attitude else score
            self._peak = max(score, score + (before - score) * math.exp(-elapsed / _PEAK_S))
            self.attitude, self.confidence = chosen, _how_often_right(chosen, self._peak)
            return
        self.attitude = AttitudeClass.OTHER
        most = _highest(*sure.values())
        self.confidence = 0.0 if math.isnan(most) else 1.0 - most


def _how_often_right(attitude: AttitudeClass, peak: float) -> float:
    """Return how often an attitude whose score has this peak is right, 0 to 1."""
    (least, at_least), (most, at_most) = _RIGHT[attitude]
    return at_least + (at_most - at_least) * soft(peak, least, most)


def raised_score(features: ArmFeatures, side: int) -> float:
    """How much the hand of a side (0 left, 1 right) is above shoulder and elbow, by gravity and for the trunk too.

    The trunk counts so that arms that hang from somebody who is bent down or upside down are not raised.
    """
    return _lowest(
        soft(features.rise[side], 0.02, 0.10),
        soft(features.above_elbow[side], -0.02, 0.06),
        _or(soft(features.rise_trunk[side], -0.02, 0.06), 1.0))


def face_score(features: ArmFeatures, side: int) -> float:
    """How near the hand of a side (0 left, 1 right) is to the face; a straight arm stretches out before it."""
    return _lowest(soft(features.to_face[side], 0.128, 0.072), _bent(features, side))


def near_face_score(features: ArmFeatures, side: int) -> float:
    """The same in a wider zone, where a hand on its way to the face or just off it is not a raised hand."""
    return _lowest(soft(features.to_face[side], 0.135, 0.095), _bent(features, side))


def _bent(features: ArmFeatures, side: int) -> float:
    """How much the elbow is bent, 1 when that is not known."""
    return _or(soft(features.elbow[side], math.radians(145.0), math.radians(130.0)), 1.0)


def crossed_score(features: ArmFeatures, speed: float = 0.0) -> float:
    """How much the forearms cross in front of the chest, 0 to 1. speed: of the faster wrist, statures/s.

    Both forearms run inward before the trunk, each wrist is near the other elbow, and either the hands lie near the
    chest (folded arms), or the wrists are clearly on the other side of the mid-plane (forearms as an X). Hands that
    meet in the middle, as in clapping, are neither, nor are two hands at one handle, which are near each other and far
    from the elbows, with forearms side by side. One elbow may be hidden.
    """
    inward = _mean((-features.lateral[0], features.lateral[1]))
    ahead = 0.5 * sum(features.forward)
    across = inward - _mean(features.ahead)
    folded, beyond = _folded(features, inward, ahead, across, speed), _beyond(features, inward, ahead, across, speed)
    return _lowest(
        _highest(folded, beyond),
        soft(_mean(features.elbow), math.radians(145.0), math.radians(130.0)),
        soft(ahead, 0.0, 0.03),
        soft(_both(min, features.level), -0.30, -0.25),
        soft(_both(max, features.level), 0.12, 0.07))


def _folded(features: ArmFeatures, inward: float, ahead: float, across: float, speed: float) -> float:
    """How much the hands lie at the other arms: what lacks of one sign, others may make up for.

    inward, ahead, across: means of both arms, statures; see crossed_score. An elbow that is not known leaves the angle
    between the forearms to the direction of the other one. Wrists one above the other close a jacket.
    """
    constant, *weights = _FOLDED_ODDS
    signs = (ahead, inward, _or(_between_forearms(features), 90.0 + 450.0 * across), _mean(features.to_other_elbow),
             speed)
    odds = constant + sum(weight * sign for weight, sign in zip(weights, signs))
    return _lowest(
        _UNKNOWN if odds != odds else 1.0 / (1.0 + math.exp(-max(-50.0, min(50.0, odds)))),
        soft(0.5 * sum(features.outward), 0.06, 0.03), soft(speed, _CLAPPING, _HELD),
        soft(abs(features.level[0] - features.level[1]), 0.16, 0.10),
        soft(_highest(*features.to_other_elbow), 0.25, 0.21), soft(_both(max, features.outward), 0.15, 0.11))


def _beyond(features: ArmFeatures, inward: float, ahead: float, across: float, speed: float) -> float:
    """How much the wrists are on the other side of the mid-plane, as in an X; arguments as of _folded."""
    return _lowest(
        soft(ahead, 0.22, 0.185), soft(0.5 * sum(features.outward), -0.02, -0.045), soft(inward, 0.035, 0.055),
        soft(across, -0.08, -0.055), soft(_mean(features.to_other_elbow), 0.215, 0.18),
        soft(speed, _SWINGING, _SHOWN), soft(_highest(*features.to_other_elbow), 0.212, 0.177),
        soft(_both(max, features.outward), 0.13, 0.09))


def _between_forearms(features: ArmFeatures) -> float:
    """Angle between the forearms, degrees: 0 side by side, 180 against each other; NaN while one is not known."""
    left, right = zip(features.lateral, features.ahead, features.above_elbow)
    lengths = math.sqrt(sum(value * value for value in left) * sum(value * value for value in right))
    if not lengths > 0.0:
        return _UNKNOWN
    return math.degrees(math.acos(max(-1.0, min(1.0, sum(a * b for a, b in zip(left, right)) / lengths))))


def soft(value: float, zero: float, one: float) -> float:
    """0 at or before `zero`, 1 at or beyond `one`, linear between; NaN for NaN."""
    if value != value:
        return _UNKNOWN
    return min(1.0, max(0.0, (value - zero) / (one - zero)))


def _both(function: Callable[[Pair], float], pair: Pair) -> float:
    """The function of two values; NaN when one is not known."""
    return function(pair) if pair[0] == pair[0] and pair[1] == pair[1] else _UNKNOWN


def _mean(pair: Pair) -> float:
    """Mean of those of two values that are known."""
    first, second = pair
    return 0.5 * (_or(first, second) + _or(second, first))


def _lowest(*scores: float) -> float:
    """Least of the scores; NaN when one is not known and none is zero."""
    known = [score for score in scores if score == score]
    if known and min(known) <= 0.0:
        return 0.0
    return min(known) if len(known) == len(scores) else _UNKNOWN


def _highest(*scores: float) -> float:
    """Greatest of the scores that are known; NaN when none is."""
    return max((score for score in scores if score == score), default=_UNKNOWN)


def _but_not(score: float, other: float) -> float:
    """The score as far as the other one, 0 when that is not known, leaves it."""
    return score * (1.0 - _or(other, 0.0))


def _or(value: float, otherwise: float) -> float:
    return value if value == value else otherwise
