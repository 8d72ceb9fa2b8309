"""Who the faces of an image are: which crops are worth a template, and what the network and the gallery say of them."""

from __future__ import annotations

from typing import Callable, Collection, Dict, List, Mapping, Optional, Sequence

import numpy as np

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces.parameters import FacePipelineSettings
from hri_pipeline.core.observations import FaceObservation
from hri_pipeline.core.privacy import TemplateCipher
from hri_pipeline.core.process import ONE_THREAD, Threads
from hri_pipeline.core.recognition.embedding import FaceEmbedder, load_face_embedder
from hri_pipeline.core.recognition.face_identity import PersonMatch
from hri_pipeline.core.recognition.recogniser import NOT_SEEN_WELL, Recogniser
from hri_pipeline.core.recognition.stored_gallery import open_gallery

ASK_PERIOD = 0.2
"""Time (s) between two comparisons without a new template."""

Notify = Callable[[str], None]


class FaceRecognition:
    """Says which faces are of which persons: network, gallery and Recogniser together.

    `recogniser` and flush() may be used from other threads, the rest may not.

    Parameters
    ----------
    settings : those of faces.parameters.ANALYSIS_PARAMETERS and `providers`.
    notify : called with one line about the gallery's file and about the network's execution provider.
    threads : share the faces of an image.

    Raises
    ------
    ModelError
        The network cannot be loaded.
    StoreError
        The gallery's file cannot be used.
    """

    def __init__(self, settings: FacePipelineSettings, notify: Optional[Notify] = None,
                 threads: Threads = ONE_THREAD) -> None:
        self._embedder = load_face_embedder(settings.recognition_model, settings.providers, notify, threads)
        embedder = self._embedder
        cipher = TemplateCipher(settings.gallery_key) if settings.gallery_key else None
        self._gallery = open_gallery(settings.gallery, embedder.kind, embedder.dimension, embedder.calibration,
                                     cipher, notify, settings.gallery_read_only)
        self.recogniser = Recogniser(self._gallery, settings.recognition_policy, settings.recognition_learn_delay)
        self._due: List[str] = []
        self._asked = -np.inf
        self._qualities: Mapping[str, float] = {}
        self.made: Dict[str, np.ndarray] = {}
        """Templates (D,) of the last image by id of their face."""

    @property
    def embedder(self) -> FaceEmbedder:
        """The network that makes the templates."""
        return self._embedder

    def due(self, qualities: Mapping[str, float], stamp: float, limit: int = 1,
            faces: Sequence[FaceObservation] = ()) -> bool:
        """Note the faces measured in this image; return whether one of them is worth a template now.

        limit: how many templates look() may make. faces: those measured, with their meshes.
        """
        self._qualities, self.made = qualities, {}
        self._due = self.recogniser.seen(qualities, stamp, limit)
        self.recogniser.watch({face.id: face.mesh for face in faces if face.mesh is not None}, stamp)
        return bool(self._due)

    def look(self, bgr: np.ndarray, faces: Sequence[FaceObservation], stamp: float,
             camera: Optional[CameraModel] = None) -> List[PersonMatch]:
        """Make the templates that are due; returns what has changed, withdrawals (likelihood 0) first.

        camera: of the image; None: not known.
        """
        crops = {face.id: self._embedder.crop(bgr, face.mesh, camera) for face in faces if face.id in self._due}
        self._due = []
        chosen = [face_id for face_id, crop in crops.items() if not self.recogniser.is_blurred(face_id, crop, stamp)]
        if not chosen:
            return self.recogniser.changes()
        templates = self._embedder.embed([crops[face_id] for face_id in chosen])
        self.made = dict(zip(chosen, templates))
        covered = self._covered(crops, stamp)
        self.recogniser.note_cover(covered, stamp)
        shown = [face_id for face_id in chosen if not covered.get(face_id)]
        self.recogniser.note_dark_glasses({face.id: face.dark_glasses for face in faces if face.id in shown})
        return self.recogniser.update(shown, [self.made[face_id] for face_id in shown],
                                      [self._qualities[face_id] for face_id in shown], stamp)

    def _covered(self, crops: Mapping[str, np.ndarray], stamp: float) -> Dict[str, bool]:
        """Return by face of `made` whether it does not show nose and mouth; to ask costs a template, so that few are
        asked about."""
        asked = [face_id for face_id, template in self.made.items()
                 if self.recogniser.asks_for_cover(face_id, template, stamp)]
        return dict(zip(asked, self._embedder.covered([crops[face_id] for face_id in asked],
                                                      np.array([self.made[face_id] for face_id in asked])).tolist()))

    def changes(self, stamp: float) -> List[PersonMatch]:
        """Return what has changed without a new template at `stamp` (s): a person was forgotten, merged or enrolled, or
        an unknown face has been seen long enough. Computed a few times per second only, because the comparison costs
        time.
        """
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
        self._due, self.made = [], {}
        self._asked = -np.inf

    def flush(self) -> None:
        """Write what has changed to the gallery file; may be called from another thread."""
        self._gallery.flush()

    def status(self, flaws: Mapping[str, str]) -> Dict[str, object]:
        """Return values for diagnostics; flaws: what spoils the crops of faces, by their ids."""
        unknown = self.recogniser.unknown()
        values: Dict[str, object] = {"recognition_" + name: value for name, value in self.recogniser.status().items()}
        values["recognition_unknown_faces"] = len(unknown)
        values["recognition_unknown_why"] = "; ".join("{}: {}{}".format(
            face_id, why, ", {}".format(flaws[face_id]) if why == NOT_SEEN_WELL and face_id in flaws else "")
            for face_id, why in unknown.items())
        return values

    def close(self) -> None:
        """Write and close the gallery: all faces have left. Idempotent."""
        self.recogniser.keep(())
        self._gallery.close()
