"""Runs the whole fitting chain (gate, filter, stature, joints) on noisy motion and compares with the truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Sequence

import numpy as np

from hri_fullbody.core import skeleton as kp
from hri_fullbody.core.body_modeller import BodyInput, BodyModeller
from hri_fullbody.evaluation.mocap import Motion
from hri_fullbody.evaluation.noise import Level, add_noise

JOINTS = (kp.LEFT_SHOULDER, kp.RIGHT_SHOULDER, kp.LEFT_ELBOW, kp.RIGHT_ELBOW, kp.LEFT_WRIST, kp.RIGHT_WRIST,
          kp.LEFT_HIP, kp.RIGHT_HIP, kp.LEFT_KNEE, kp.RIGHT_KNEE, kp.LEFT_ANKLE, kp.RIGHT_ANKLE)
"""The twelve joints over which the mean error is taken, as in KINEMATICS.md; face points are a template."""


@dataclass(frozen=True)
class Tracked:
    """One motion after the chain: fitted key points (T, 18, 3) m, NaN while there was no model; revision (T,);
    stature (T,) m the estimate of each frame."""

    motion: Motion
    fitted: np.ndarray
    revision: np.ndarray
    stature: np.ndarray

    def errors(self) -> np.ndarray:
        """Distances (F, 12) m of the twelve joints from the truth, of frames with settled dimensions."""
        frames = self.revision > 0
        apart = self.fitted[frames] - self.motion.points[frames]
        return np.linalg.norm(apart[:, JOINTS], axis=-1)


def track(modeller: BodyModeller, motions: Sequence[Motion], level: Level, seed: int) -> List[Tracked]:
    """Run all motions at once, each as one body seen by its own camera, with noise of `level`."""
    count, length = len(motions), max(len(motion.points) for motion in motions)
    noisy = [add_noise(motion.points, level, seed + 1000 * n) for n, motion in enumerate(motions)]
    fitted = np.full((count, length, 18, 3), np.nan)
    revision, stature = np.zeros((count, length), dtype=int), np.full((count, length), np.nan)
    numbers = {str(n): n for n in range(count)}
    modeller.reset()
    for frame in range(length):
        bodies = [BodyInput(name, noisy[n][frame]) for name, n in numbers.items() if frame < len(noisy[n])]
        # Gravity differs from camera to camera here, so that it is not told: the harder case.
        for body in modeller.update(bodies, frame / motions[0].rate):
            n = numbers[body.id]
            fitted[n, frame], revision[n, frame], stature[n, frame] = body.fitted, body.revision, body.stature
    return [Tracked(motion, fitted[n, :len(motion.points)], revision[n, :len(motion.points)],
                    stature[n, :len(motion.points)]) for n, motion in enumerate(motions)]


def mpjpe_mm(tracked: Sequence[Tracked]) -> float:
    """Mean error over all joints and frames of all motions, mm."""
    return float(1e3 * np.concatenate([one.errors() for one in tracked]).mean())
