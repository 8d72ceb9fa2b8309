"""How well everybody's direction fits everybody as its target, all at once.

With few people the number of numpy calls is what costs, so everything is computed for everybody and masked afterwards.
"""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Optional, Tuple

import numpy as np

from hri_pipeline.core.interactions.crowd import UNKNOWN, Crowd

_NEVER = -1e9
_SIZE_PART = 0.5
"""People look at some point of a head: its standard deviation, in radii of the head."""
_LEAST_DISTANCE = 0.2
_BEHIND = 0.25
"""What hides somebody is at least this much nearer (m)."""
_ROBOT_SD = 0.1
_HALF_WEIGHT = 4.0
"""Distance (m) from which somebody is looked at half as often as somebody near: the outer part of Hall's social space."""
_LEAST_VISIBLE = 0.02
_HEAD_BESIDE_EYES = 0.64
"""How much the head's direction counts beside that of the eyes: it is off by the same amount for as long as a look lasts."""
_TWO_PI = 2.0 * math.pi


class Sights:
    """Directions and distances from every onlooker to every target: the N people, then the robot; T = N + 1.

    heads, gazes, faces, trunks, deviations: those of the crowd. units: (N, T, 3) unit vectors; distances: (N, T) m;
    possible: (N, T), who may be looked at at all.
    """

    def __init__(self, people: Crowd, robot: Optional[np.ndarray], max_distance: float) -> None:
        count = len(people)
        self.heads, self.gazes, self.faces, self.trunks = people.heads, people.gazes, people.faces, people.trunks
        self.deviations = people.deviations
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

    def weights(self, head_radius: float) -> np.ndarray:
        """(N, T): how much each target comes into question before a direction is known, 0 to 1.

        Near ones more than far ones; one whom somebody else hides hardly.
        """
        near = self.possible / (1.0 + (self.distances / _HALF_WEIGHT) ** 2)
        # Of each onlooker, the square of the angle between each two targets, for small ones.
        angles = np.maximum(2.0 - 2.0 * (self.units @ self.units.transpose(0, 2, 1)), 0.0)
        hides = self.distances[:, :, None] < (self.distances - _BEHIND)[:, None, :]
        hides &= self.possible[:, :, None]
        hides &= self.possible[:, None, :]
        close = np.where(hides, angles * (self.distances / head_radius)[:, :, None] ** 2, np.inf).min(axis=1, initial=np.inf)
        return near * np.maximum(1.0 - np.exp(-0.5 * close), _LEAST_VISIBLE)


def evidence(sights: Sights, settings: SimpleNamespace) -> Tuple[np.ndarray, np.ndarray]:
    """Return log likelihood ratios (N, T) of each target against nobody, and the time (N,) s over which an error lasts.

    Eyes and head count together, the trunk where neither is known. A person without any direction has zeros and an
    infinite time.
    """
    placed = sights.heads[:, 0] == sights.heads[:, 0]       # not NaN
    by_eyes = placed & (sights.gazes[:, 0] == sights.gazes[:, 0])
    by_head = placed & (sights.faces[:, 0] == sights.faces[:, 0])
    by_trunk = placed & (sights.trunks[:, 0] == sights.trunks[:, 0]) & ~(by_eyes | by_head)
    squares = sights.deviations * sights.deviations
    places = np.empty(len(placed) + 1)
    places[:-1], places[-1] = squares[:, 0], _ROBOT_SD ** 2
    extent = ((_SIZE_PART * settings.head_radius) ** 2 + places + squares[:, :1]) / (sights.distances * sights.distances)
    eyes, heads, aside = _densities(sights, squares, extent, settings)
    even = -math.log(settings.nobody_field)
    # Who looks at nobody turns the head to where the eyes look, as anybody else.
    nobody, weight = np.where(by_eyes, aside, even), np.where(by_eyes, _HEAD_BESIDE_EYES, 1.0)
    ratios = np.where(by_eyes[:, None], eyes - even, 0.0)
    ratios += np.where(by_head[:, None], weight[:, None] * (heads - nobody[:, None]), 0.0)
    if by_trunk.any():
        facing = _facing(sights.trunks, sights.units, squares[:, 3:] + settings.trunk_target_sd ** 2 + extent)
        ratios = np.where(by_trunk[:, None], facing, ratios)
    # A trunk that points elsewhere than the eyes does so as long as the person looks there.
    times = np.where(by_eyes | by_head, settings.evidence_time, np.where(by_trunk, settings.dwell_time, np.inf))
    return np.where(sights.possible, ratios, _NEVER), times


def _densities(sights: Sights, squares: np.ndarray, extent: np.ndarray, settings: SimpleNamespace
               ) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Log densities (1/sr) of the eyes (N, T) and of the heads (N, T) for each target, and of the heads for the eyes (N,).

    NaN where a direction is not known.
    """
    units, spread = _head_for(sights.units, sights.trunks, settings)
    own = squares[:, 1] + spread
    # Eyes and heads; the heads for the eyes behind the targets.
    cosines, variances = (np.ones((2, len(own), extent.shape[1] + 1)) for _ in range(2))
    cosines[0, :, :-1] = (sights.units @ sights.gazes[:, :, None])[..., 0]
    cosines[1, :, :-1] = (units @ sights.faces[:, :, None])[..., 0]
    cosines[1, :, -1] = (sights.faces * sights.gazes).sum(axis=1)
    np.add(squares[:, 2:3], extent, out=variances[0, :, :-1])
    np.add(own[:, None], extent, out=variances[1, :, :-1])
    variances[1, :, -1] = own + squares[:, 2]
    eyes, heads = _density(cosines, variances)
    return eyes[:, :-1], heads[:, :-1], heads[:, -1]


def _density(cosines: np.ndarray, variances: np.ndarray) -> np.ndarray:
    """Log of the Gaussian density (1/sr) at angles of these cosines; variances in rad^2 on each axis."""
    angles = np.arccos(np.minimum(np.maximum(cosines, -1.0), 1.0))
    return -0.5 * angles * angles / variances - np.log(_TWO_PI * variances)


def _facing(trunks: np.ndarray, units: np.ndarray, variances: np.ndarray) -> np.ndarray:
    """Log likelihood ratios of the bearings of trunks in the horizontal plane, where nobody's are even over the circle."""
    bearings = np.arctan2(units[..., 1], units[..., 0]) - np.arctan2(trunks[:, 1], trunks[:, 0])[:, None]
    turns = np.abs((bearings + np.pi) % _TWO_PI - np.pi)
    return -0.5 * turns ** 2 / variances - 0.5 * np.log(_TWO_PI * variances) + np.log(_TWO_PI)


def _head_for(units: np.ndarray, trunks: np.ndarray, settings: SimpleNamespace) -> Tuple[np.ndarray, np.ndarray]:
    """Where the head points (N, T, 3) when somebody looks at each target, and its variance (N,) rad^2.

    The head turns `head_gain` of the way from the trunk, in the horizontal plane; without a trunk it points at the target.
    """
    known = trunks[:, 0] == trunks[:, 0]
    if not known.any():
        return units, np.full(len(trunks), settings.eyes_in_head_sd ** 2)
    x, y = units[..., 0], units[..., 1]
    turns = np.arctan2(y, x) - np.arctan2(trunks[:, 1], trunks[:, 0])[:, None]
    turns -= _TWO_PI * np.rint(turns / _TWO_PI)
    # Towards the back the head turns as far as it can, and the trunk says little: the whole way. So it does without a trunk.
    back = np.where(np.abs(turns) < 0.75 * math.pi, (settings.head_gain - 1.0) * turns, 0.0)
    cosine, sine = np.cos(back), np.sin(back)
    turned = units.copy()
    turned[..., 0] = cosine * x - sine * y
    turned[..., 1] = sine * x + cosine * y
    return turned, np.where(known, 0.5, 1.0) * settings.eyes_in_head_sd ** 2
