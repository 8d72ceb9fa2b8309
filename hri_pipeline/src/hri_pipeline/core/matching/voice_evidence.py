"""Log-likelihood ratios that a voice comes from a face: the motion of the mouth while it speaks, and its direction.

The mouth is a chain of two states, still and moving, of which the measured motion tells (hidden Markov model; Rabiner
1989, Proc. IEEE 77). If the voice belongs to the face, speech drives the chain: the mouth begins to move when the
voice begins and rests when it ends. If it does not, the mouth moves when it likes: it smiles, chews, or talks to
somebody else. The ratio of both likelihoods therefore rewards what changes together, punishes a mouth that rests while
the voice speaks, and gains little from a mouth that moves all the time.
"""

from __future__ import annotations

import math
from typing import Tuple

import numpy as np

SILENT, UNKNOWN, NEAR, SPEAKING = 0, 1, 2, 3
STEP_S = 0.1
"""Distance of the times at which motion is compared."""

# Rates (1/s) at which a mouth begins to move and comes to rest.
_IDLE = (0.1, 0.6)
"""Of whoever does not speak: moves for 1.7 s every 10 s, a seventh of the time."""
_SPEAKING = (3.0, 0.3)
"""While its voice speaks: moves after a third of a second, rests now and then."""
_SILENT = (0.1, 4.0)
"""While its voice is silent and nobody else speaks."""

_SLOPE, _MOST = 3.0, 3.0
"""Log-likelihood ratio of moving against still: slope over the logarithm of the motion, and its limit."""
_NEAR = (1.5, 2.0)
"""Just before and after its voice speaks: lips part before the first sound, and close after the last."""

_INDEPENDENT_S = 0.35
"""Motions so far apart in time are independent: their window is half a second long."""
NEW_PER_S, NEW_AFTER_PAUSE = 0.1, 0.5
"""Probability, per second of speech and over a pause, that somebody else goes on under the same voice (without an array a
voice is whoever speaks): evidence fades by it, that against a face the faster."""
_MOST_ODDS = 150.0

_STRAY = 0.05
"""Part of the directions that tell nothing: echoes, and peaks between two speakers."""
POSITION_SD = 0.15
"""Standard deviation (m) of the place of a head against the microphone: of its distance and of the calibration."""


def motion_evidence(motion: np.ndarray, weight: np.ndarray, still_motion: float) -> np.ndarray:
    """Log-likelihood ratio of a mouth that moves against one that is still, 0 where the motion is not known.

    motion: standard deviation of the opening, NaN where unknown; weight: 0..1; still_motion: motion at which both are as
    likely.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = _SLOPE * np.log(np.maximum(motion, 1e-4) / still_motion)
    return np.where(np.isnan(motion), 0.0, weight * np.clip(ratio, -_MOST, _MOST))


def mouth_evidence(speech: np.ndarray, moving: np.ndarray) -> np.ndarray:
    """Return (V, F) log-likelihood ratios that voices belong to faces, of motion against speech.

    speech: (V, T) of SILENT, UNKNOWN, NEAR and SPEAKING for each voice, at times STEP_S apart; moving: (F, T) of
    motion_evidence. UNKNOWN says that nothing follows from the motion: somebody else speaks, who may be this face.
    """
    # The first row is the chain of a mouth that goes its own way, the same for all voices.
    rows = np.concatenate([np.full((1, moving.shape[1]), UNKNOWN), speech])
    stay, come = np.array([_step(rates) for rates in (_SILENT, _IDLE, _NEAR, _SPEAKING)])[rows].T[..., None]
    odds = np.exp(moving.T * (STEP_S / _INDEPENDENT_S)) - 1.0
    held = stay - come
    moves = np.full((len(rows), len(moving)), _IDLE[0] / sum(_IDLE))
    totals = np.empty((moving.shape[1],) + moves.shape)
    for time, total in enumerate(totals):
        # Forward algorithm: probability that it moves now, then the likelihood of what was measured.
        moves = come[time] + held[time] * moves
        np.multiply(moves, odds[time], out=total)
        moves += total
        total += 1.0
        moves /= total
    gains = totals[:, 1:] / totals[:, :1]
    ends = np.diff(speech == SPEAKING, axis=1, prepend=False) & (speech != SPEAKING)
    fresh = np.where(ends, NEW_AFTER_PAUSE, NEW_PER_S * STEP_S).T[..., None]
    evidence = np.ones(gains.shape[1:])
    for gain, part in zip(gains, fresh):
        evidence = np.minimum(evidence * gain, _MOST_ODDS)
        evidence += part * (1.0 - evidence)
    return np.log(evidence)


def direction_evidence(angle: np.ndarray, distance: np.ndarray, direction_sd: float) -> np.ndarray:
    """Log-likelihood ratio that a voice comes from a place against from anywhere.

    angle: rad between the voice and the place, seen from the microphone; distance: m of the place. Fisher's
    distribution on the sphere for small angles: density exp(-angle^2 / 2 s^2) / (2 pi s^2), against 1 / (4 pi).
    """
    variance = direction_sd ** 2 + (POSITION_SD / np.maximum(distance, POSITION_SD)) ** 2
    at_place = 2.0 / variance * np.exp(-0.5 * angle ** 2 / variance)
    return np.log((1.0 - _STRAY) * at_place + _STRAY)


def _step(rates: Tuple[float, float]) -> Tuple[float, float]:
    """Probabilities of moving after STEP_S for a mouth that moved, and for one that was still."""
    part, left = rates[0] / sum(rates), math.exp(-sum(rates) * STEP_S)
    return part + (1.0 - part) * left, part * (1.0 - left)
