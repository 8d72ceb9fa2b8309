"""Recognition as a stage of the faces: embedder, gallery and recogniser put together."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Callable, Collection, Dict, List, Mapping, Optional, Sequence

import numpy as np

from hri_pipeline.core.encryption import KeyFileTransform
from hri_pipeline.core.observations import FaceObservation
from hri_pipeline.core.recognition.face_embedding import load_face_embedder
from hri_pipeline.core.recognition.face_identity import Match
from hri_pipeline.core.recognition.recogniser import Recogniser
from hri_pipeline.core.recognition.stored_gallery import open_gallery

ASK_PERIOD = 0.2
"""Time (s) between two questions for what has changed without a new template."""

Notify = Callable[[str], None]


class RecognitionStage:
    """Says which faces are of which persons. `recogniser` may be used from other threads, the rest may not.

    settings: those of face_parameters.ANALYSIS_PARAMETERS and `providers`. Raises ModelError, or StoreError for a
    gallery file that cannot be used.
    """

    def __init__(self, settings: SimpleNamespace, notify: Optional[Notify] = None) -> None:
        self._embedder = load_face_embedder(settings.recognition_model, settings.providers, notify)
        embedder = self._embedder
        transform = KeyFileTransform(settings.gallery_key) if settings.gallery_key else None
        self._gallery = open_gallery(settings.gallery, embedder.kind, embedder.dimension, embedder.calibration,
                                     transform, notify)
        self.recogniser = Recogniser(self._gallery, settings.recognition_policy, settings.recognition_learn_delay)
        self._due: List[str] = []
        self._asked = -np.inf
        self._qualities: Mapping[str, float] = {}

    def due(self, qualities: Mapping[str, float], stamp: float, limit: int = 1) -> bool:
        """Take note of the faces measured in this image; tell whether one of them is worth a template now.

        limit: of how many faces look() may make one.
        """
        self._qualities = qualities
        self._due = self.recogniser.seen(qualities, stamp, limit)
        return bool(self._due)

    def look(self, bgr: np.ndarray, faces: Sequence[FaceObservation], stamp: float) -> List[Match]:
        """Make the templates that are due; returns what has changed, withdrawals (likelihood 0) first."""
        chosen = [face for face in faces if face.id in self._due]
        self._due = []
        if not chosen:
            return self.recogniser.changes()
        templates = self._embedder.embed([self._embedder.crop(bgr, face.mesh) for face in chosen])
        return self.recogniser.update([face.id for face in chosen], templates,
                                      [self._qualities[face.id] for face in chosen], stamp)

    def changes(self, stamp: float) -> List[Match]:
        """Return what has changed without a look at `stamp` (s): a person was forgotten, merged or enrolled, or an unknown
        face has been seen long enough. Asked a few times per second only: the comparison is not free."""
        if 0.0 <= stamp - self._asked < ASK_PERIOD:
            return []
        self._asked = stamp
        return self.recogniser.changes()

    def keep(self, ids: Collection[str]) -> None:
        """Forget all faces but these; the persons stay."""
        self.recogniser.keep(ids)

    def reset(self) -> None:
        """Forget all faces; the persons stay."""
        self.recogniser.reset()
        self._due = []
        self._asked = -np.inf

    def flush(self) -> None:
        """Write what has changed to the gallery file; may be called from another thread."""
        self._gallery.flush()

    def status(self) -> Dict[str, object]:
        """Return values for diagnostics."""
        return {"recognition_" + name: value for name, value in self.recogniser.status().items()}

    def close(self) -> None:
        """Write and close the gallery. Idempotent."""
        self._gallery.close()
