"""What is around a new face: a person, or a thing that only looks like a face.

The networks of faces see what a face is made of, and a lion, a drawn dog or a football has it as well. The person
detector, which was trained on people, animals and things, sees what it belongs to. It is asked only about new faces
of which the face detector is not sure.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Callable, List, Optional, Sequence, Set, Tuple

import numpy as np

from hri_pipeline.core.faces.parameters import FaceTrackingSettings
from hri_pipeline.core.faces.track import FaceTrack
from hri_pipeline.core.faces.tracker import same_face
from hri_pipeline.core.images import PlaceView
from hri_pipeline.core.onnx import ModelError, model_path
from hri_pipeline.core.person_detector import DEFAULT_FILE, CenterNetDetector, PersonDetector

SURE_SCORE, SURE_VERIFICATION = 0.9, 1.0
"""Score of the detections, and sum of the verification, from which a face is sure whatever is around it."""
AGAIN = 1.0
"""Time (s) after which a refused face is asked for again, if it has moved: people breathe and sway."""
PATIENCE, PATIENT = 3, 0.6
"""After so many refusals at one place this share of the lead is enough, and so on: nobody who breathes and sways is
refused for ever. Who walks, or stands before a camera that turns, shows another view each time, and is refused where
none is good enough. Of 652 true faces (small, dark, masked, blurred, cut) two need it, once; of 15 things 13 do, once
to four times."""
_MOST_ASKED = 2
"""Faces that are asked for in one image."""
_FORGOTTEN = 3.0
"""Time (s) after which the refusal of a face that is gone is forgotten."""


@dataclass
class _Refusal:
    """A face that was refused: the id of its track, where it is now (box (4,) px), what it looked like, when it was
    looked at (s), and how often it was refused."""

    face: str
    box: np.ndarray
    place: PlaceView
    stamp: float
    count: int


class PersonVerifier:
    """Asks the person detector about new faces, and remembers where they were refused.

    Parameters
    ----------
    load
        Returns the person detector; called by prepare(), or when it is first needed.
    least_lead
        How many times the score of all else that of a person must be; 0: no face is doubted.
    notify
        Called with one line of text when there is no person detector.
    """

    def __init__(self, load: Callable[[], PersonDetector], least_lead: float,
                 notify: Optional[Callable[[str], None]] = None) -> None:
        self._load, self._least_lead = load, least_lead
        self._notify = notify or (lambda text: None)
        self._detector: Optional[PersonDetector] = None
        self._has_failed = False
        self._refusals: List[_Refusal] = []

    def prepare(self) -> None:
        """Load the detector now, where faces are doubted at all: the images do not wait for it then."""
        if self._least_lead <= 0.0:
            return
        try:
            self._detector = self._detector or self._load()
        except ModelError as error:
            self._fail(error)

    def limit(self, least_lead: float) -> None:
        """Set the lead that is needed; another one counts for those who were refused, too, at once."""
        if least_lead != self._least_lead:
            self.reset()
        self._least_lead = least_lead

    def reset(self) -> None:
        """Forget where faces were refused."""
        self._refusals = []

    def doubts(self, track: FaceTrack) -> bool:
        """Whether it must be found out what is around a face before it is published."""
        return (self._least_lead > 0.0 and not track.vouched and not self._has_failed
                and (track.score < SURE_SCORE or track.verification < SURE_VERIFICATION))

    def verify(self, bgr: np.ndarray, tracks: Sequence[FaceTrack], stamp: float) -> None:
        """Find out about doubted faces, a few an image, first those that were never asked for; those that were refused
        a moment ago wait, and those that stand where they were refused and nothing has moved since.

        bgr: (H, W, 3) uint8, the image of `stamp` (s).
        """
        living = {track.id for track in tracks}
        self._refusals = [one for one in self._refusals if stamp >= one.stamp and (
            one.face in living or stamp - one.stamp < _FORGOTTEN)]
        due: List[Tuple[FaceTrack, Optional[_Refusal]]] = []
        for track in tracks:
            box = track.predicted_box(stamp)
            before = self._last_refusal(track.id, box, living)
            if before is not None and self._waits(bgr, before, stamp):
                track.refused = True
            else:
                due.append((track, before))
        due.sort(key=lambda one: -np.inf if one[1] is None else one[1].stamp)
        for track, before in due[:_MOST_ASKED]:
            if not self._has_failed:
                self._ask(bgr, track, track.predicted_box(stamp), stamp, before)

    def _last_refusal(self, face: str, box: np.ndarray, living: Set[str]) -> Optional[_Refusal]:
        """Return that of a face, wherever it is now, or of one at its box (4,) px whose track has ended; None without
        one."""
        own = [one for one in self._refusals if one.face == face]
        ended = [one for one in self._refusals if one.face not in living and same_face(one.box, box)]
        for one in (own + ended)[:1]:
            one.face, one.box = face, box
            return one
        return None

    @staticmethod
    def _waits(bgr: np.ndarray, before: _Refusal, stamp: float) -> bool:
        """Whether a refusal holds: it was a moment ago, or nothing has moved there, which is looked at as often."""
        if stamp - before.stamp < AGAIN:
            return True
        if not before.place.is_unchanged(bgr):
            return False
        before.stamp = stamp
        return True

    def _ask(self, bgr: np.ndarray, track: FaceTrack, box: np.ndarray, stamp: float,
             before: Optional[_Refusal]) -> None:
        """Find out about one face. before: its last refusal."""
        count = 0 if before is None else before.count
        stands = before is None or same_face(before.place.box, box)
        lead = self._lead(bgr, box)
        if lead is None:
            return
        track.vouched = lead >= self._least_lead * PATIENT ** (count // PATIENCE)
        track.refused = not track.vouched
        self._refusals = [one for one in self._refusals if one is not before]
        if track.refused:
            self._refusals.append(_Refusal(track.id, box, PlaceView(bgr, box), stamp, count + int(stands)))

    def _lead(self, bgr: np.ndarray, box: np.ndarray) -> Optional[float]:
        """Score of a person around a box (4,) px over that of all else; None without a detector."""
        try:
            if self._detector is None:
                self._detector = self._load()
            return self._detector.lead_around(bgr, box)
        except ModelError as error:
            self._fail(error)
            return None

    def _fail(self, error: ModelError) -> None:
        """Doubt nobody from now on."""
        self._has_failed = True
        self._notify("new faces are not compared with what is around them: {}".format(error))


def load_person_detector(settings: FaceTrackingSettings,
                         notify: Optional[Callable[[str], None]] = None) -> CenterNetDetector:
    """Load the person detector for faces alone: on the CPU, as it is seldom needed, and a card would take seconds to
    prepare for it. Raises ModelError naming the file."""
    return CenterNetDetector(model_path(settings.person_detector_model, DEFAULT_FILE), notify=notify)
