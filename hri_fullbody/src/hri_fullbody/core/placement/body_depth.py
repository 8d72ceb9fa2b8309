"""The place of a body by a depth image."""

from __future__ import annotations

from typing import Dict, Optional, Tuple

import numpy as np

from hri_fullbody.core.sight.pose_model import BODY_LANDMARKS
from hri_pipeline.core.depth import sample_depth

_TRUNK = np.array([11, 12, 23, 24])
# Each trunk joint is sampled a part of the way to the middle of the trunk: at the rim the background shows through.
_INSET = 0.2
_TRUNK_BEHIND = 0.10
_LEAST_TRUNK = 2
_LARGEST_SPREAD = 0.25
# How far a joint lies behind the surface that a camera sees, m: half the thickness of the limb.
_BEHIND: Dict[int, float] = {
    11: 0.07, 12: 0.07, 13: 0.045, 14: 0.045, 15: 0.03, 16: 0.03, 23: 0.10, 24: 0.10, 25: 0.055, 26: 0.055,
    27: 0.04, 28: 0.04}
_JOINTS = np.array(sorted(_BEHIND))
_BEHIND_JOINTS = np.array([_BEHIND[joint] for joint in _JOINTS])
_PARENT: Dict[int, int] = {13: 11, 14: 12, 15: 13, 16: 14, 25: 23, 26: 24, 27: 25, 28: 26}
# A surface further than this from where the body is expected is something before or behind it.
_LARGEST_JUMP = 0.25
_STRETCH, _SLACK = 1.15, 0.05


def trunk_ratio(depth: np.ndarray, pixels: np.ndarray, points: np.ndarray, confidence: np.ndarray,
                size: Tuple[int, int]) -> Optional[float]:
    """How many times farther away the trunk is than `points` (33, 3) m say; None when the depth does not tell.

    depth: (h, w) m. pixels: (33, 2) px in the image of `size` (width, height). confidence: (33,) 0 to 1.
    The median of those of shoulders and hips that are seen and lie at one depth.
    """
    middle = pixels[_TRUNK].mean(axis=0)
    seen = confidence[_TRUNK] > 0.3
    surface = sample_depth(depth, pixels[_TRUNK] + _INSET * (middle - pixels[_TRUNK]), *size)
    centre = points[_TRUNK].mean(axis=0)
    modelled = (points[_TRUNK] + _INSET * (centre - points[_TRUNK]))[:, 2]
    known = seen & np.isfinite(surface) & (modelled > 0.1)
    if known.sum() < _LEAST_TRUNK:
        return None
    behind = surface[known] + _TRUNK_BEHIND - (modelled[known] - centre[2])
    near = behind[np.abs(behind - np.median(behind)) < _LARGEST_SPREAD]
    return None if len(near) < _LEAST_TRUNK else float(np.median(near) / centre[2])


def measured_joints(depth: np.ndarray, pixels: np.ndarray, rays: np.ndarray, points: np.ndarray,
                    confidence: np.ndarray, size: Tuple[int, int]) -> np.ndarray:
    """Put the landmarks (33, 3) m of a body, which is at the right distance, on their rays (33, 2) at measured depths.

    A joint whose surface lies off by more than 0.25 m, or farther from the joint before it than the limb is long, is
    hidden behind something, or its pixel shows the background: it keeps its depth on its ray.
    """
    found = points.copy()
    depths = points[:, 2].copy()
    surface = sample_depth(depth, pixels[_JOINTS], *size) + _BEHIND_JOINTS
    usable = (confidence[_JOINTS] > 0.3) & (np.abs(surface - points[_JOINTS, 2]) < _LARGEST_JUMP)
    for joint, good, value in zip(_JOINTS, usable, surface):
        parent = _PARENT.get(int(joint))
        if good and parent is not None:
            limb = float(np.linalg.norm(points[joint] - points[parent]))
            good = abs(value - depths[parent]) <= _STRETCH * limb + _SLACK
        if good:
            depths[joint] = value
    sure = confidence[:BODY_LANDMARKS] > 0.3
    found[sure] = np.column_stack([rays[sure] * depths[sure, None], depths[sure]])
    return found
