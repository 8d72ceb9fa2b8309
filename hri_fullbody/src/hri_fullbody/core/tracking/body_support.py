"""Second bodies on one human, told by the person detector."""

from __future__ import annotations

from typing import List, Sequence

import numpy as np

from hri_fullbody.core.sight.body_sight import inside
from hri_fullbody.core.tracking.body_track import BodyTrack
from hri_pipeline.core.assignment import assign
from hri_pipeline.core.geometry import iou_matrix

SUPPORT_TIME = 2.0
"""Time (s) for which a body that lies within another one is believed without a person's box of its own."""
_LEAST_IOU = 0.25
_WITHIN = 0.6


def drop_unsupported(tracks: Sequence[BodyTrack], boxes: Sequence[np.ndarray], stamp: float) -> List[BodyTrack]:
    """Return the tracks without those that are second bodies of somebody.

    boxes: (4,) px of the persons that the detector sees at `stamp`. A body has support by a face, or by a box of its
    own; one that has none for two seconds and lies mostly within a body that has is a part of that.
    """
    boxes = np.asarray(boxes, dtype=np.float64).reshape(-1, 4)
    outlines = np.array([track.expected(stamp).box for track in tracks]).reshape(-1, 4)
    supported = {row for row, track in enumerate(tracks) if track.face_id is not None}
    supported |= {row for row, _ in assign(1.0 - iou_matrix(outlines, boxes), 1.0 - _LEAST_IOU)}
    kept = []
    for row, track in enumerate(tracks):
        if row in supported or not track.visible:
            track.supported_at = stamp if row in supported else track.supported_at
            kept.append(track)
        elif stamp - track.supported_at <= SUPPORT_TIME or not any(
                inside(outlines[row], outlines[other]) > _WITHIN for other in supported if tracks[other].visible):
            kept.append(track)
    return kept
