"""Who or what every person looks at: another person, the robot, nobody.

`SightLines` holds the directions and distances from everybody to everybody, `evidence` says how well each direction
fits each target, `GazeTargetFilter` believes over time, by one hidden Markov model per person, and `GazeJudge` says how
likely that is by more of what was seen. With few people the number of numpy calls is what costs, so everything is
computed for all people at once and masked afterwards.
"""

from __future__ import annotations

import math
from typing import Dict, List, Optional, Sequence, Tuple, Union

import numpy as np

from hri_pipeline.core.interactions.depth_factors import DepthFactors
from hri_pipeline.core.interactions.gaze_cues import GazeJudge
from hri_pipeline.core.interactions.parameters import GazeSettings
from hri_pipeline.core.interactions.people import ROBOT, UNKNOWN, GazeTarget, Observer, PeopleSnapshot

__all__ = ["ROBOT", "GazeTarget", "GazeTargets", "Observer"]

_BACK_S = 1e-6
_REOPEN_S = 0.1
"""Closed eyes count as open again when they have been seen open for this time (s): one image in which the eyelids are
measured wrongly opens none."""
_STILL_S = 0.19
_CLOSED_MEMORY_S = 2.0
"""Eyes that were closed when they were last seen are taken for closed for this time (s)."""
_BLINK_S = 0.27
"""Eyes closed for less (s) do not end a gaze: blinks take 0.1 to 0.4 s, of which the lids cover the pupil for less than
0.3 s (Caffier, Erdmann, Ullsperger, Eur. J. Appl. Physiol. 89, 2003: 0.20 s in all, 0.33 s when drowsy)."""
_LONG_BLINK_S = 0.5
"""Eyes that open again within this time (s) go on looking where they looked, without having to be seen open twice."""


class GazeTargets:
    """Follows who looks at whom, one target for each person at a time.

    The angle between a person's direction and each target counts by the uncertainty of both and the target's apparent
    size; a hidden Markov model per person follows over time, and small trees judge what it believes. Eyes that are
    closed look at nobody, at once.
    """

    def __init__(self, settings: GazeSettings) -> None:
        self._settings = settings
        self._filter = GazeTargetFilter(settings)
        self._renewal = ErrorRenewal()
        self._depths = DepthFactors()
        self._judge = GazeJudge()
        self._stamp: Optional[float] = None
        self._closed_at: Dict[str, float] = {}
        self._open_at: Dict[str, float] = {}
        self._weighed: List[str] = []
        self._weighed_at = 0.0
        self._latest_weights = np.zeros((0, 1))

    def reconfigure(self, settings: GazeSettings) -> None:
        """Take up the values of the live parameters."""
        self._settings = settings
        self._filter.reconfigure(settings)

    def reset(self) -> None:
        """Forget everything, as after a time jump."""
        self._filter.reset()
        self._renewal.reset()
        self._depths.reset()
        self._judge.reset()
        self._closed_at.clear()
        self._open_at.clear()
        self._weighed = []
        self._stamp = None

    def update(self, people: Union[PeopleSnapshot, Sequence[Observer]], robot: Optional[np.ndarray],
               stamp: float) -> List[GazeTarget]:
        """Return who looks at whom now.

        Parameters
        ----------
        people: PeopleSnapshot or sequence of Observer
            Everybody who is tracked, each id once.
        robot: (3,) array or None
            Place of the robot's head in the reference frame (m); None where it is not known.
        stamp: float
            Time (s) of the image. A stamp before the last one resets everything.
        """
        if self._stamp is not None and stamp < self._stamp - _BACK_S:
            self.reset()
        # The first image counts in full.
        dt = self._settings.evidence_time if self._stamp is None else stamp - self._stamp
        self._stamp = stamp
        people = self._depths.corrected(PeopleSnapshot.of(people))
        if not people.ids:
            self._filter.reset()
            self._judge.reset()
            return []
        lines = SightLines(people, robot, self._settings.max_distance)
        ratios, times = evidence(lines, self._settings)
        ids = people.ids
        closed = self._closed(people, stamp)
        weights = self._weights(lines, ids, stamp) * self._filter.attention(ids, people.speaking, people.groups)
        shares, begun = self._renewal.update(people, times, dt)
        self._filter.update(ids, weights, ratios, shares, closed, dt, closed & self._blinking(people, closed, stamp),
                            begun & ~closed)
        beliefs = self._filter.beliefs()
        self._depths.learn(people, lines, beliefs[:, :len(ids)], np.where(closed, 0.0, shares), dt)
        judged = self._judge.update(people, lines, beliefs, self._settings.head_radius, stamp, dt)
        looked_at = self._filter.decide(judged)
        looked_at[(looked_at == len(ids)) & self._renewal.past(people, lines.units[:, -1])] = _NOBODY
        names = ids + [ROBOT]
        return [GazeTarget(ids[sender], names[target], float(judged[sender, target]))
                for sender, target in enumerate(looked_at.tolist()) if target >= 0]

    def _weights(self, lines: SightLines, ids: List[str], stamp: float) -> np.ndarray:
        """Return the weights (N, T) of the targets; used again for _STILL_S, as occlusion takes half of the computing
        time."""
        if ids != self._weighed or not 0.0 <= stamp - self._weighed_at < _STILL_S:
            self._weighed, self._weighed_at = ids, stamp
            self._latest_weights = lines.weights(self._settings.head_radius)
        return self._latest_weights

    def _closed(self, people: PeopleSnapshot, stamp: float) -> np.ndarray:
        """Return whose eyes are closed, (N,). Closed eyes that are not seen any more stay closed for a while."""
        closed = people.closed >= self._settings.closed_threshold      # False where it is not known
        since, self._closed_at = self._closed_at, {people.ids[row]: stamp for row in np.nonzero(closed)[0].tolist()}
        if since:
            hidden = np.isnan(people.closed) & np.isnan(people.gazes[:, 0])
            for row, identity in enumerate(people.ids):
                before = since.get(identity)
                if before is None or closed[row]:
                    continue
                blinked = stamp - self._open_at.get(identity, -math.inf) <= _LONG_BLINK_S
                if stamp - before < (_CLOSED_MEMORY_S if hidden[row] else 0.0 if blinked else _REOPEN_S):
                    self._closed_at[identity] = before
                    closed[row] = True
        return closed

    def _blinking(self, people: PeopleSnapshot, closed: np.ndarray, stamp: float) -> np.ndarray:
        """Return whose eyes were open a moment ago, (N,)."""
        seen_open = ~closed & ((people.closed == people.closed) | (people.gazes[:, 0] == people.gazes[:, 0]))
        self._open_at = {identity: stamp if opened else self._open_at[identity]
                         for identity, opened in zip(people.ids, seen_open.tolist())
                         if opened or identity in self._open_at}
        return np.array([stamp - self._open_at.get(identity, -math.inf) <= _BLINK_S for identity in people.ids])


_NEVER = -1e9
_SIZE_PART = 0.5
"""People look at some point of a head: its standard deviation, in radii of the head."""
_LEAST_DISTANCE = 0.2
_BEHIND = 0.25
"""What hides somebody is at least this much nearer (m)."""
_ROBOT_SD = 0.1
_MOST_EXTENT = 0.1 ** 2
"""Largest variance (rad^2) of where a target is seen: what fills the view is not looked at less for that."""
_HALF_WEIGHT = 4.0
"""Distance (m) from which somebody is looked at half as often as somebody near: the outer part of Hall's social
space."""
_LEAST_VISIBLE = 0.02
_HEAD_BESIDE_EYES = 0.4
"""How much the head's direction counts beside that of the eyes: its error stays the same as long as somebody looks at
one target. Chosen of 0.3 to 0.9 on the tuning seeds of benchmarks/gaze_independent.py."""
_FADE_S = 0.7
"""Time constant (s) with which what an error that lasts has said is forgotten: looks last 1 to 3 s (Argyle and Cook,
Gaze and mutual gaze, 1976)."""
_UNSEEN_TRUNK_SD = 0.7
"""Standard deviation (rad) of a trunk that is not seen from the direction to the robot: of whom a camera sees a face
and no body, the body is mostly towards it."""
_HEAD_GAIN_SD = 0.2
"""Standard deviation of the part of the way that heads turn: some people move their heads and others their eyes (Fuller
1992: nearly none to nearly all of the way)."""
_UP_PART = 0.6
"""Standard deviation of eyes in the head up and down over that to the sides: people stand about equally high, and their
targets are beside each other."""


class GazePriors:
    """Weights of the targets before a direction is known, over that of somebody who is silent and looks elsewhere."""

    SPEAKING = 3.0
    """Somebody who is heard. Among four, people looked seven times as much at the one to whom they listened as at
    others (Vertegaal, Slagter, van der Veer, Nijholt, CHI 2001); less here, as a voice may be another one's."""
    APART = 1.0 / 7.0
    """Somebody who is not of the observer's own group, for those who stand in one: as much as those to whom nobody
    listens, in the same study."""
    MUTUAL = 1.5
    """Somebody who looks at the observer. In the same study who speaks looks three times as much at whom he speaks to
    as at others, and is looked at seven times as much: looks are returned, also where no voice is heard. Only a part of
    it, so that an error does not breed another one."""


_TWO_PI = 2.0 * math.pi


class SightLines:
    """Directions and distances from every observer to every target: the N people, then the robot; T = N + 1.

    heads, gazes, faces, trunks, deviations, depths, faceless: those of the people. units: (N, T, 3) unit vectors;
    distances: (N, T) m; possible: (N, T), which targets can be looked at.
    """

    def __init__(self, people: PeopleSnapshot, robot: Optional[np.ndarray], max_distance: float) -> None:
        count = len(people)
        self.heads, self.gazes, self.faces, self.trunks = people.heads, people.gazes, people.faces, people.trunks
        self.deviations = people.deviations
        self.depths, self.faceless = people.depths, people.faceless
        targets = np.empty((count + 1, 3))
        targets[:-1] = self.heads
        targets[-1] = UNKNOWN if robot is None else robot
        between = targets - self.heads[:, None]
        distances = np.sqrt((between * between).sum(axis=2))
        with np.errstate(invalid="ignore"):
            possible = (distances > 1e-6) & (distances < max_distance)
        possible.reshape(-1)[::count + 2] = False       # nobody looks at himself
        between[~possible] = 0.0
        lengths = np.where(possible, distances, 1.0)
        self.possible = possible
        self.distances = np.maximum(lengths, _LEAST_DISTANCE)
        self.units = between / lengths[..., None]
        self._extents: Optional[Tuple[np.ndarray, np.ndarray]] = None

    def extents(self, head_radius: float) -> Tuple[np.ndarray, np.ndarray]:
        """Return the variances (N, T), rad^2, of where a target is seen from an observer, to the sides and up or down:
        somebody looks at any point of a head, and both places are uncertain, most of all along the camera's ray. They
        are computed once."""
        if self._extents is None:
            self._extents = self._find_extents(head_radius)
        return self._extents

    def _find_extents(self, head_radius: float) -> Tuple[np.ndarray, np.ndarray]:
        lateral = self.deviations[:, :1] ** 2
        place = (_SIZE_PART * head_radius) ** 2 + lateral + np.append(lateral[:, 0], _ROBOT_SD ** 2)
        depths = np.concatenate([self.depths, np.zeros((1, 3))])
        sideways = np.stack([-self.units[..., 1], self.units[..., 0]], axis=2)
        sideways /= np.maximum(np.sqrt((sideways * sideways).sum(axis=2)), 1e-6)[..., None]
        own = (sideways @ self.depths[:, :2, None])[..., 0]
        others = (sideways * depths[:, :2]).sum(axis=2)
        square = self.distances * self.distances
        return (np.minimum((place + own * own + others * others) / square, _MOST_EXTENT),
                np.minimum((place + self.depths[:, 2:] ** 2 + depths[:, 2] ** 2) / square, _MOST_EXTENT))

    def weights(self, head_radius: float) -> np.ndarray:
        """Return the prior weights (N, T) of the targets, 0 to 1, before a direction is known.

        Near targets weigh more than far ones, and those hidden by somebody else very little.
        """
        near = self.possible / (1.0 + (self.distances / _HALF_WEIGHT) ** 2)
        # Of each observer, the square of the angle between each two targets, for small ones.
        angles = np.maximum(2.0 - 2.0 * (self.units @ self.units.transpose(0, 2, 1)), 0.0)
        hides = self.distances[:, :, None] < (self.distances - _BEHIND)[:, None, :]
        hides &= self.possible[:, :, None]
        hides &= self.possible[:, None, :]
        close = np.where(hides, angles * (self.distances / head_radius)[:, :, None] ** 2,
                         np.inf).min(axis=1, initial=np.inf)
        return near * np.maximum(1.0 - np.exp(-0.5 * close), _LEAST_VISIBLE)


def evidence(lines: SightLines, settings: GazeSettings) -> Tuple[np.ndarray, np.ndarray]:
    """Compare the directions of everybody with the lines to all targets.

    Eyes and head count together. Somebody without a face tells nothing, or, where the settings say so, by the head of
    the skeleton, or by the trunk where neither is known.

    Returns
    -------
    ratios: (N, T) array
        Logarithm of the likelihood ratio of each target against nobody; 0 for a person without any direction.
    times: (N,) array
        Time (s) over which the error of a direction lasts; infinite for a person without any direction.
    """
    placed = lines.heads[:, 0] == lines.heads[:, 0]       # not NaN
    by_eyes = placed & (lines.gazes[:, 0] == lines.gazes[:, 0])
    by_head = placed & (lines.faces[:, 0] == lines.faces[:, 0])
    by_trunk = placed & (lines.trunks[:, 0] == lines.trunks[:, 0]) & ~(by_eyes | by_head)
    if not settings.gaze_without_face:
        by_head &= ~lines.faceless
        by_trunk[:] = False
    squares = lines.deviations * lines.deviations
    extents = lines.extents(settings.head_radius)
    eyes, heads, aside = _densities(lines, squares, extents, settings)
    even = -math.log(settings.nobody_field)
    # Those who look at nobody turn their heads to where their eyes look, too.
    nobody, weight = np.where(by_eyes, aside, even), np.where(by_eyes, _HEAD_BESIDE_EYES, 1.0)
    ratios = np.where(by_eyes[:, None], eyes - even, 0.0)
    ratios += np.where(by_head[:, None], weight[:, None] * (heads - nobody[:, None]), 0.0)
    if by_trunk.any():
        facing = _facing(lines.trunks, lines.units, squares[:, 3:] + settings.trunk_target_sd ** 2 + extents[0])
        ratios = np.where(by_trunk[:, None], facing, ratios)
    # A trunk that points elsewhere than the eyes does so as long as the person looks there.
    times = np.where(by_eyes | by_head, settings.evidence_time, np.where(by_trunk, _FADE_S, np.inf))
    return np.where(lines.possible, ratios, _NEVER), times


def _densities(lines: SightLines, squares: np.ndarray, extents: Sequence[np.ndarray], settings: GazeSettings
               ) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Log densities (1/sr) of the eyes (N, T) and of the heads (N, T) for each target, and of the heads for the eyes
    (N,).

    NaN where a direction is not known.
    """
    # What the eyes look at is a target like all others for the head; without eyes it is of no use.
    aims = np.concatenate([lines.units, lines.gazes[:, None]], axis=1)
    turned, sides, up = _head_for(aims, lines.trunks, settings)
    own = [squares[:, 1:2] + np.concatenate([extent, squares[:, 2:3]], axis=1) for extent in extents]
    heads = _density(turned, lines.faces, own[0] + sides, own[1] + up)
    eyes = [squares[:, 2:3] + extent for extent in extents]
    return _density(lines.units, lines.gazes, *eyes), heads[:, :-1], heads[:, -1]


def _density(units: np.ndarray, directions: np.ndarray, sides: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Log of the Gaussian density (1/sr) of directions (N, 3) about units (N, T, 3); variances (N, T) in rad^2 to the
    sides, and up and down."""
    bearing = np.arctan2(units[..., 1], units[..., 0]) - np.arctan2(directions[:, 1], directions[:, 0])[:, None]
    bearing -= _TWO_PI * np.rint(bearing / _TWO_PI)
    level = np.hypot(units[..., 0], units[..., 1]) * np.hypot(directions[:, 0], directions[:, 1])[:, None]
    heights = np.arcsin(_sine(units[..., 2])) - np.arcsin(_sine(directions[:, 2]))[:, None]
    return -0.5 * (bearing * bearing * level / sides + heights * heights / up) - np.log(_TWO_PI * np.sqrt(sides * up))


def _sine(values: np.ndarray) -> np.ndarray:
    return np.minimum(np.maximum(values, -1.0), 1.0)


def _facing(trunks: np.ndarray, units: np.ndarray, variances: np.ndarray) -> np.ndarray:
    """Log likelihood ratios of the bearings of trunks in the horizontal plane, where nobody's are even over the
    circle."""
    bearings = np.arctan2(units[..., 1], units[..., 0]) - np.arctan2(trunks[:, 1], trunks[:, 0])[:, None]
    turns = np.abs((bearings + np.pi) % _TWO_PI - np.pi)
    return -0.5 * turns ** 2 / variances - 0.5 * np.log(_TWO_PI * variances) + np.log(_TWO_PI)


def _head_for(units: np.ndarray, trunks: np.ndarray, settings: GazeSettings
              ) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where the head points (N, T, 3) when somebody looks at each target, and its variances (N, T) rad^2 to the sides
    and up or down.

    The head turns `head_gain` of the way from the trunk, in the horizontal plane, more or less. A trunk that is not
    seen is taken to face the robot, the last target but one; without a robot the head points at the target.
    """
    seen = trunks[:, 0] == trunks[:, 0]
    trunks = np.where(seen[:, None], trunks, units[:, -2])
    known = (trunks[:, 0] != 0.0) | (trunks[:, 1] != 0.0)
    unsure = np.where(seen, 0.0, ((1.0 - settings.head_gain) * _UNSEEN_TRUNK_SD) ** 2)
    spread = np.where(seen, 0.5, 1.0) * settings.eyes_in_head_sd ** 2
    sides = np.broadcast_to((spread + np.where(known, unsure, 0.0))[:, None], units.shape[:2])
    up = np.broadcast_to(_UP_PART ** 2 * spread[:, None], units.shape[:2])
    if not known.any():
        return units, sides, up
    x, y = units[..., 0], units[..., 1]
    turns = np.arctan2(y, x) - np.arctan2(trunks[:, 1], trunks[:, 0])[:, None]
    turns -= _TWO_PI * np.rint(turns / _TWO_PI)
    # Towards the back the head turns as far as it can, and the trunk says little: the whole way. So it does without a
    # trunk.
    turns = np.where((np.abs(turns) < 0.75 * math.pi) & known[:, None], turns, 0.0)
    back = (settings.head_gain - 1.0) * turns
    cosine, sine = np.cos(back), np.sin(back)
    turned = units.copy()
    turned[..., 0] = cosine * x - sine * y
    turned[..., 1] = sine * x + cosine * y
    return turned, sides + (_HEAD_GAIN_SD * turns) ** 2, up


_CALM, _RENEWAL_S = 0.7, 3.0
"""Squared steps of a direction count up to this part of their variance, so that looks which go elsewhere do not pass
for trembling; time constant (s) of their mean."""
_SACCADE, _AGREEING, _FIXATION_S = 2.5, 1.5, 0.2
"""Eyes look elsewhere when two images in a row have them so many standard deviations from where they were, and so many
at most from each other; time constant (s) of where they were. (As the velocity threshold of D. D. Salvucci and J. H.
Goldberg, ETRA 2000, on the noise of cameras: smaller turns are left to the filter.)"""

_PAST = 1.5
"""Eyes so many standard deviations beside the robot do not look at it, however unlikely anything else is: who looks
past a camera does so by some 10 degrees, and nothing else to look at is known there."""


class ErrorRenewal:
    """Which share of the error of everybody's direction is a new one in each image, 0 to 1.

    Networks err by the face, the pose and the light, and so in one image as in the next. How long an error lasts shows
    in how much a direction trembles: of an error that goes on by the factor r from image to image (a first-order
    autoregressive one), half of the mean squared step is the share 1 - r of its variance. Images whose errors are alike
    say no more than one of them.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget everybody."""
        self._ids: List[str] = []
        self._directions, self._steps, self._fixations = np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3))

    def update(self, people: PeopleSnapshot, times: np.ndarray, dt: float) -> Tuple[np.ndarray, np.ndarray]:
        """Return the shares (N,), 0 of who tells nothing, and whose eyes have just gone elsewhere (N,): of what they
        look at now nothing has been told yet.

        times (N,): see evidence; dt: s since the last image.
        """
        self._follow(people.ids)
        begun = self._look_elsewhere(people, dt)
        unseen = np.isnan(people.gazes[:, 0])
        directions = np.where(unseen[:, None], people.faces, people.gazes)
        sds = np.where(unseen, people.deviations[:, 1], people.deviations[:, 2])
        squares = ((directions - self._directions) ** 2).sum(axis=1) / (4.0 * sds * sds)     # two axes, two images
        gain = 1.0 - math.exp(-dt / _RENEWAL_S)
        self._steps += np.where(np.isnan(squares), 0.0, gain * (np.minimum(squares, _CALM) - self._steps))
        self._directions = np.where(np.isnan(directions), self._directions, directions)
        # What the limit takes away from the mean of exponentially distributed squares, about.
        trembling = self._steps / np.maximum(1.0 - (self._steps / _CALM) ** 2, 0.05)
        shares = np.minimum(np.maximum(np.where(begun, 1.0, trembling), dt / np.maximum(times, 1e-6)), 1.0)
        return np.where(np.isfinite(times), shares, 0.0), begun

    def _look_elsewhere(self, people: PeopleSnapshot, dt: float) -> np.ndarray:
        """Return whose eyes have gone elsewhere (N,), and follow where they are."""
        gazes, sds = people.gazes, people.deviations[:, 2]

        def apart(others: np.ndarray) -> np.ndarray:
            return np.sqrt(((gazes - others) ** 2).sum(axis=1)) / sds

        middle = 0.5 * (gazes + self._directions)
        away = np.sqrt(((middle - self._fixations) ** 2).sum(axis=1)) > _SACCADE * sds
        begun = away & (apart(self._fixations) > _SACCADE) & (apart(self._directions) < _AGREEING)     # False for NaN
        gain = 1.0 - math.exp(-dt / _FIXATION_S)
        moved = np.where(np.isnan(self._fixations), gazes, self._fixations + gain * (gazes - self._fixations))
        self._fixations = np.where(np.isnan(gazes), self._fixations, np.where(begun[:, None], middle, moved))
        return begun

    def past(self, people: PeopleSnapshot, units: np.ndarray) -> np.ndarray:
        """Return whose eyes go past what lies in these directions (N, 3), (N,); in a blink as before it."""
        squares = np.minimum(*(((eyes - units) ** 2).sum(axis=1) for eyes in (self._fixations, self._directions)))
        small = np.isnan(people.gazes[:, 0]) & (people.closed < 0.5)        # open eyes that cannot be measured
        return ~small & (np.sqrt(squares) > _PAST * people.deviations[:, 2])       # False for NaN

    def _follow(self, ids: List[str]) -> None:
        if ids == self._ids:
            return
        rows = {identity: row for row, identity in enumerate(self._ids)}
        before = np.array([rows.get(identity, len(rows)) for identity in ids], dtype=np.int64)
        self._directions = np.append(self._directions, [UNKNOWN], axis=0)[before]
        self._fixations = np.append(self._fixations, [UNKNOWN], axis=0)[before]
        self._steps = np.append(self._steps, 0.0)[before]
        self._ids = list(ids)


_MOST_DT = 1.0
"""Longest step (s) between two updates; after a longer gap nothing more is known than after this."""
_NOBODY = -1
_LEAST = 1e-300


class GazeTargetFilter:
    """Probabilities of the targets of each person: the people, the robot, nobody.

    Targets change at a rate of 1 / dwell_time, to any other one by its prior (L. R. Rabiner, Proc. IEEE 77 (1989) 257,
    for the recursion; the rates are those of a process in continuous time, so that the frame rate does not matter).
    Errors that last would add up to certainty: as far as they do, older evidence fades (J. Q. Smith, J. R. Statist.
    Soc. B 41 (1979) 375: a power of the belief).
    """

    def __init__(self, settings: GazeSettings) -> None:
        self._settings = settings
        self.reset()

    def reconfigure(self, settings: GazeSettings) -> None:
        """Take up the values of the live parameters."""
        self._settings = settings

    def reset(self) -> None:
        """Forget everything."""
        self._ids: List[str] = []
        self._probabilities = np.zeros((0, 2))
        self._current = np.zeros(0, dtype=np.int64)
        self._unseen, self._none = np.zeros(0), np.zeros(0, dtype=bool)

    def update(self, ids: Sequence[str], weights: np.ndarray, ratios: np.ndarray, shares: np.ndarray,
               closed: np.ndarray, dt: float, blinking: Optional[np.ndarray] = None,
               begun: Optional[np.ndarray] = None) -> None:
        """Take the evidence of `dt` s.

        weights (N, T), ratios (N, T): see evidence; T = N + 1 with the robot last. shares (N,): see ErrorRenewal.
        closed (N,): the eyes are closed, whatever else is known. blinking (N,): of those, who closed them a moment ago:
        what they look at stays. begun (N,): whose eyes have just gone elsewhere: nothing is known of where.
        """
        prior = self._prior(weights)
        self._follow(list(ids), prior)
        dt = min(max(dt, 0.0), _MOST_DT)
        stay = math.exp(-dt / self._settings.dwell_time)
        belief = stay * self._probabilities + (1.0 - stay) * prior
        if begun is not None:
            belief[begun] = prior[begun]
        seen = (shares > 0.0) & ~closed
        kept = np.exp(-dt / _FADE_S * (1.0 - shares) * seen)[:, None]
        scores = kept * np.log(np.maximum(belief, _LEAST)) + (1.0 - kept) * np.log(np.maximum(prior, _LEAST))
        scores[:, :-1] += ratios * (shares * seen)[:, None]
        belief = np.exp(scores - scores.max(axis=1, keepdims=True))
        self._probabilities = belief / np.maximum(belief.sum(axis=1, keepdims=True), 1e-300)
        held = np.zeros(len(closed), dtype=bool) if blinking is None else blinking
        self._unseen = np.where(seen, 0.0, np.where(held, self._unseen, self._unseen + dt))
        self._none = (closed & ~held) | (self._unseen > self._settings.gaze_hold)

    def attention(self, ids: Sequence[str], speaking: Optional[np.ndarray],
                  groups: Optional[np.ndarray] = None) -> np.ndarray:
        """Return the factors (N, T) of GazePriors on the weights of the targets; speaking: (N,), groups: (N,), see
        PeopleSnapshot."""
        factors = np.ones((len(ids), len(ids) + 1))
        if speaking is not None:
            factors[:, :-1][:, speaking] *= GazePriors.SPEAKING
        if groups is not None:
            factors[:, :-1][(groups[:, None] != groups) & (groups >= 0)[:, None]] *= GazePriors.APART
        if list(ids) == self._ids:
            # How likely each one looks at the observer.
            factors[:, :-1] *= 1.0 + (GazePriors.MUTUAL - 1.0) * self._probabilities[:, :len(ids)].T
        return factors

    def beliefs(self) -> np.ndarray:
        """Return how likely everybody looks at each target (N, T + 1), nobody last."""
        return self._probabilities

    def _prior(self, weights: np.ndarray) -> np.ndarray:
        """(N, T + 1) how often each target is looked at, nobody last."""
        total = weights.sum(axis=1, keepdims=True)
        targets = (1.0 - self._settings.nobody_prior) * weights / np.maximum(total, 1.0)
        return np.concatenate([targets, 1.0 - targets.sum(axis=1, keepdims=True)], axis=1)

    def decide(self, targets: np.ndarray) -> np.ndarray:
        """Return what each person looks at (N,), index of a target or -1 for nobody, by how likely everybody looks at
        each target (N, T). Once after each update."""
        rows = np.arange(len(self._current))
        best = targets.argmax(axis=1)
        sure = targets[rows, best] >= self._settings.gaze_on
        kept = (self._current != _NOBODY) & (targets[rows, np.maximum(self._current, 0)] >= self._settings.gaze_off)
        self._current = np.where(sure, best, np.where(kept, self._current, _NOBODY))
        self._current[self._none] = _NOBODY
        return self._current.copy()

    def _follow(self, ids: List[str], prior: np.ndarray) -> None:
        """Add the rows of new people, and remove those of people who have left."""
        if ids == self._ids:
            return
        places: Dict[str, int] = {identity: index for index, identity in enumerate(self._ids)}
        before = np.array([places.get(identity, _NOBODY) for identity in ids] + [len(self._ids), len(self._ids) + 1],
                          dtype=np.int64)
        rows = before[:-2]
        stayed = rows != _NOBODY
        known = np.where(before != _NOBODY)[0]
        belief, current, unseen = prior.copy(), np.full(len(ids), _NOBODY, dtype=np.int64), np.zeros(len(ids))
        if stayed.any():
            old = self._probabilities[rows[stayed]]
            kept = np.zeros((len(old), len(ids) + 2))
            kept[:, known] = old[:, before[known]]
            # What was looked at has gone: the rest as by the prior.
            kept += np.maximum(1.0 - kept.sum(axis=1, keepdims=True), 0.0) * prior[stayed]
            belief[stayed] = kept
            unseen[stayed] = self._unseen[rows[stayed]]
            index = {old_place: place for place, old_place in enumerate(before.tolist()) if old_place != _NOBODY}
            current[stayed] = [index.get(target, _NOBODY) for target in self._current[rows[stayed]].tolist()]
        self._ids, self._probabilities, self._current, self._unseen = ids, belief, current, unseen
