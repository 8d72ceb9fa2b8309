"""How much the present picture of each face is worth, looked at now and then: the measure is not free."""

from __future__ import annotations

from typing import Collection, Dict, Mapping, Sequence

import numpy as np

from hri_pipeline.core.faces.face_crops import aligned_crop, crop_quality
from hri_pipeline.core.observations import FaceObservation

CROP_SIZE = 64
_PERIOD = 0.5
_PER_IMAGE = 2


class FaceQualities:
    """Keeps the latest quality of every face's crop; at most two are measured per image, the oldest first."""

    def __init__(self) -> None:
        self._values: Dict[str, float] = {}
        self._stamps: Dict[str, float] = {}

    def update(self, bgr: np.ndarray, faces: Sequence[FaceObservation], stamp: float) -> Mapping[str, float]:
        """Return the qualities (0 to 1) of the faces among `faces` that have one, the stale ones measured anew."""
        stale = [face for face in faces if stamp - self._stamps.get(face.id, -np.inf) >= _PERIOD]
        stale.sort(key=lambda face: self._stamps.get(face.id, -np.inf))
        size = (bgr.shape[1], bgr.shape[0])
        for face in stale[:_PER_IMAGE]:
            crop = aligned_crop(bgr, face.mesh, CROP_SIZE)
            self._values[face.id] = crop_quality(face.mesh, face.pose, crop, face.score, size)
            self._stamps[face.id] = stamp
        return {face.id: self._values[face.id] for face in faces if face.id in self._values}

    def keep(self, ids: Collection[str]) -> None:
        """Forget all faces but these."""
        for face_id in [face_id for face_id in self._values if face_id not in ids]:
            del self._values[face_id], self._stamps[face_id]

    def reset(self) -> None:
        """Forget all faces."""
        self._values, self._stamps = {}, {}
