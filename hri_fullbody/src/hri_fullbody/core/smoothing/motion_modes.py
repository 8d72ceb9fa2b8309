"""A low pass for points in motion: several models of how points move, and for each point the mixture that fits it.

Interacting multiple models (Blom, Bar-Shalom, IEEE Transactions on Automatic Control 33(8), 1988): a point that drifts
without a velocity of its own, and points whose velocity changes slowly, quickly, and very quickly. Each model is a
Kalman filter with the gains it settles to, which depend on one number, the tracking index (Kalata, IEEE Transactions
on Aerospace and Electronic Systems 20(2), 1984): acceleration times the square of the time step over the noise.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Tuple

import numpy as np

from hri_fullbody.core import skeleton as kp

# Acceleration (m/s^2) that a model expects, and the time (s) in which its velocity fades to 1/e.
_ACCELERATIONS = np.array([1.0, 1.0, 4.0, 14.0])
_FADING = np.array([1e-3, 1.1, 1.1, 0.65])
MODES = len(_FADING)
_STAY_S = 0.45  # mean time for which a point keeps to one model
_USUAL_STEP = 1.0 / 30.0  # s: the table's; at other steps velocities fade by a little more or less than it supposes
_LOWEST, _HIGHEST, _PER_E = -7.0, 9.0, 10.0  # logarithm of the tracking index, entries for each e
_RUNS = 400
_LEAST_SHARE = 1e-9
# Evidence for a model counts less than that of independent errors would; the points of a limb move alike: what a
# neighbour shows counts too.
_OWN, _NEIGHBOUR = 0.6, 0.24
_LIMBS = ((2, 3, 4), (5, 6, 7), (8, 9, 10), (11, 12, 13), (1, 2, 5, 8, 11),
          (kp.NOSE, kp.NECK, kp.LEFT_EYE, kp.RIGHT_EYE, kp.LEFT_EAR, kp.RIGHT_EAR))


def _neighbours() -> np.ndarray:
    """Weights (18, 18) of the points' evidence for each other's model."""
    weights = np.zeros((18, 18))
    for limb in _LIMBS:
        for point in limb:
            weights[point, list(limb)] = _NEIGHBOUR
    np.fill_diagonal(weights, _OWN)
    return weights


_EVIDENCE = _neighbours()


@lru_cache(maxsize=1)
def _table() -> np.ndarray:
    """What each model's filter settles to (modes, entries, 4), step and noise being 1: gain of the place, gain of the
    velocity, half the inverse of the innovation's variance, half its logarithm."""
    entries = int((_HIGHEST - _LOWEST) * _PER_E) + 1
    force = np.exp(2.0 * (_LOWEST + np.arange(entries) / _PER_E))[None]
    keep = np.exp(-_USUAL_STEP / _FADING)[:, None]
    place, both, speed = np.ones((3, MODES, entries))
    for _ in range(_RUNS):
        place, both, speed = (place + 2.0 * both + speed + 0.25 * force, keep * (both + speed) + 0.5 * force,
                              keep * keep * speed + force)
        total = place + 1.0
        gain, turn = place / total, both / total
        place, both, speed = gain, both - turn * place, speed - turn * both
    return np.stack([gain, turn, 0.5 / total, 0.5 * np.log(total)], axis=-1)


def begin(places: np.ndarray) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places (N, M, 18, 3), velocities (N, M, 18, 3) and shares (N, M, 18) of points (N, 18, 3) m at rest."""
    shape = (len(places), MODES) + places.shape[1:]
    return np.broadcast_to(places[:, None], shape).copy(), np.zeros(shape), np.full(shape[:3], 1.0 / MODES)


def advance(places: np.ndarray, speeds: np.ndarray, shares: np.ndarray, points: np.ndarray, since: np.ndarray,
            noise: np.ndarray, agility: float) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Take in measured points (N, 18, 3) m, NaN where missing; places, speeds and shares as `begin` gives them.

    since: (N, 18) s since the point was last measured. noise: (N, 3) m, standard deviation along the axes, above 0.
    agility: factor of the accelerations that are expected. Returns the new places, speeds and shares; those of a
    missing point are as they were.
    """
    stay = np.exp(-since / _STAY_S)[:, None]
    move = (1.0 - stay) / MODES
    mixed = move + stay * shares
    # the models begin with what the others found, as far as a point may have changed from one model to another
    own, common = (stay * shares / mixed)[..., None], (move / mixed)[..., None]
    weights = shares[..., None]
    before = own * places + common * np.add.reduce(weights * places, axis=1, keepdims=True)
    pace = own * speeds + common * np.add.reduce(weights * speeds, axis=1, keepdims=True)
    step = since[:, None, :, None]
    expected = before + pace * step
    pace *= np.exp(-step / _FADING[:, None, None])
    index = np.log((agility * _ACCELERATIONS)[:, None, None] * (step * step / noise[:, None, None]))
    entry = np.minimum(np.maximum((index - _LOWEST) * _PER_E + 0.5, 0.0), (_HIGHEST - _LOWEST) * _PER_E)
    settled = _table()[np.arange(MODES)[:, None, None], entry.astype(np.intp)]
    news = points[:, None] - expected
    missed = settled[..., 2] * (news / noise[:, None, None]) ** 2 + settled[..., 3]
    missed = np.add.reduce(missed, axis=-1)
    known = ~np.isnan(missed[:, :1])
    missed = np.where(known, missed, 0.0) @ _EVIDENCE
    likely = mixed * np.exp(np.minimum.reduce(missed, axis=1, keepdims=True) - missed) + _LEAST_SHARE
    likely /= np.add.reduce(likely, axis=1, keepdims=True)
    seen = known[..., None]
    return (np.where(seen, expected + settled[..., 0] * news, places),
            np.where(seen, pace + settled[..., 1] / step * news, speeds), np.where(known, likely, shares))
