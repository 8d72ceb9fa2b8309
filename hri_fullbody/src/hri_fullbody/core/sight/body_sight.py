"""One look at one body, and how such looks compare."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import List, Optional, Sequence, Tuple

import numpy as np

from hri_fullbody.core.sight.pose_model import BODY_LANDMARKS, PoseEstimate
from hri_fullbody.core.skeleton import BLAZE_LEFT_HIP, BLAZE_RIGHT_HIP
from hri_pipeline.core.geometry import iou_matrix

SAME_BODY = 0.1
"""Distance, in sizes of the larger body, below which two estimates show one human."""
_KNOWN = 0.3
# In sizes of the larger body.
_FAR = 0.6
_SAME_TRUNK, _SAME_NOSE = 0.09, 0.12


@dataclass(frozen=True)
class Sight:
    """What a look into a window showed.

    points: (33, 3) m, the landmarks placed in the optical frame, None when they cannot be. looks: see
    body_appearance.describe. source: id of the body whose window it was, None for a new one.
    """

    estimate: PoseEstimate
    points: Optional[np.ndarray] = field(default=None, repr=False)
    looks: Optional[np.ndarray] = field(default=None, repr=False)
    source: Optional[str] = None

    @cached_property
    def root(self) -> Optional[np.ndarray]:
        """Middle of the hips (3,) m in the optical frame, None when it is not known."""
        return None if self.points is None else (self.points[BLAZE_LEFT_HIP] + self.points[BLAZE_RIGHT_HIP]) / 2.0


def body_size(estimate: PoseEstimate) -> float:
    """Longer side of the box of the landmarks that are seen, px."""
    box = estimate.box
    return float(max(box[2] - box[0], box[3] - box[1], 1.0))


def body_distance(a: PoseEstimate, b: PoseEstimate) -> float:
    """Median distance of the landmarks that both see, in units of the larger body."""
    both = (a.confidence[:BODY_LANDMARKS] > _KNOWN) & (b.confidence[:BODY_LANDMARKS] > _KNOWN)
    both = both if both.sum() > 4 else np.ones(BODY_LANDMARKS, bool)
    offset = (a.landmarks[:BODY_LANDMARKS, :2] - b.landmarks[:BODY_LANDMARKS, :2])[both]
    return float(np.median(np.hypot(*offset.T))) / max(body_size(a), body_size(b))


def same_body(a: PoseEstimate, b: PoseEstimate) -> bool:
    """Tell whether two estimates show one human: the same landmarks, or trunk and nose at the same place.

    Most pairs are told apart by the trunks alone. Of two people whose trunks and heads coincide one is hidden.
    """
    size = max(a.extent, b.extent)
    offset = math.hypot(*(a.centre - b.centre)) / size
    if offset > _FAR:
        return False
    if offset < _SAME_TRUNK and math.hypot(*(a.nose - b.nose)) < _SAME_NOSE * size:
        return True
    return body_distance(a, b) < SAME_BODY


def is_sound(estimate: PoseEstimate, min_score: float) -> bool:
    """Tell whether an estimate is sure enough, finite, and has a window to follow it."""
    finite = np.all(np.isfinite(estimate.landmarks)) and np.all(np.isfinite(estimate.world))
    if not (finite and estimate.score >= min_score):
        return False
    try:
        window = estimate.next_window()
    except ValueError:
        return False
    return window.size >= 16.0 and int((estimate.confidence[:BODY_LANDMARKS] > _KNOWN).sum()) >= 4


def covers(estimate: PoseEstimate, box: np.ndarray, min_iou: float = 0.35) -> bool:
    """Tell whether a person's box (4,) px is that of this body."""
    return bool(iou_matrix(estimate.box[None], np.asarray(box)[None])[0, 0] > min_iou)


def inside(box: np.ndarray, other: np.ndarray) -> float:
    """Part of the area of a box (4,) px that lies in another."""
    x0, y0, x1, y1 = box.tolist()
    a0, b0, a1, b1 = other.tolist()
    width, height = min(x1, a1) - max(x0, a0), min(y1, b1) - max(y0, b0)
    return max(width, 0.0) * max(height, 0.0) / (max(x1 - x0, 1e-6) * max(y1 - y0, 1e-6))


def distinct(sights: Sequence[Sight], faces: Sequence[Optional[str]]) -> List[Sight]:
    """Keep one of several sights of one human: the surest.

    faces: for each sight the id of the face in which its nose lies, or None; two faces are two humans.
    """
    kept: List[Tuple[Sight, Optional[str]]] = []
    for sight, face in sorted(zip(sights, faces), key=lambda pair: -pair[0].estimate.score):
        if not any(same_body(sight.estimate, other.estimate) for other, its in kept
                   if face is None or its is None or face == its):
            kept.append((sight, face))
    return [sight for sight, _ in kept]
