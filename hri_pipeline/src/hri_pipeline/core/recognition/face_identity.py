"""The identity of one tracked face over time: its templates, who it is taken for, and who gets whom when several faces
may be the same person.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import AbstractSet, Deque, Dict, List, Mapping, Optional, Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from hri_pipeline.core.recognition.likelihood import MatchResult, PersonCandidate

MAX_CROPS = 8
"""Templates that are kept of one face: the newest ones."""
SWAP_CROPS = 3
"""When this number of templates in a row contradicts the earlier ones, the tracker has moved to another face."""
ACCEPT, RELEASE = 0.6, 0.3
"""Likelihood from which a face is taken for a person, and below which it no longer is."""
LEAST_PUBLISHED = 0.1
"""Least likelihood of a candidate that is published."""
CHANGE = 0.05
"""Least change of a likelihood that is published."""
HOLD = 0.2
"""A face takes a person over from another face only when it is likelier by this much."""
FIRST_INTERVAL, LONGEST_INTERVAL = 0.25, 5.0
"""Time (s) between two crops of a face at first, and after many."""
PATIENCE = 4
"""Crops of a recognised face after which the next ones come less and less often; of another one: twice as many."""
TOGETHER = 0.5
"""Faces seen within this time (s) are present at the same time: not every face is measured in every image."""
BETTER = 0.15
"""A crop whose quality exceeds the best one so far by this much gets a template early."""


@dataclass(frozen=True)
class FaceTemplate:
    """One crop of a face: unit vector (D,), quality 0..1, time s."""

    template: np.ndarray
    quality: float
    stamp: float


class FaceEvidence:
    """The latest templates of one face, in order.

    Parameters
    ----------
    contradiction : distance from the mean of the templates above which a template is of somebody else.
    """

    def __init__(self, contradiction: float) -> None:
        self._contradiction = contradiction
        self._kept: Deque[FaceTemplate] = deque(maxlen=MAX_CROPS)
        self._contradicting: List[FaceTemplate] = []
        self._mean: Optional[np.ndarray] = None
        self.swaps = 0

    def __len__(self) -> int:
        return len(self._kept)

    @property
    def duration(self) -> float:
        """Time (s) between the first and the last crop that is kept."""
        return self._kept[-1].stamp - self._kept[0].stamp if self._kept else 0.0

    @property
    def best_quality(self) -> float:
        """Quality of the best crop, 0 without any."""
        return max((one.quality for one in self._kept), default=0.0)

    def good(self, quality: float) -> int:
        """How many crops are at least this good."""
        return sum(one.quality >= quality for one in self._kept)

    def add(self, template: FaceTemplate) -> bool:
        """Add a template. Returns False when it contradicts the others: it then waits until others agree with it."""
        if self._mean is not None and len(self._kept) > 1 and self._distance(template) > self._contradiction:
            self._contradicting.append(template)
            if len(self._contradicting) < SWAP_CROPS:
                return False
            # The tracker follows somebody else now: the earlier templates are of no use.
            self._kept = deque(self._contradicting, maxlen=MAX_CROPS)
            self.swaps += 1
        else:
            self._kept.append(template)
        self._contradicting = []
        weighted = np.sum([one.quality * one.template for one in self._kept], axis=0)
        length = float(np.linalg.norm(weighted))
        self._mean = (weighted / length).astype(np.float32) if length > 0.0 else self._kept[-1].template
        return True

    def mean(self) -> Optional[np.ndarray]:
        """Return the mean of the templates weighted by quality, a unit vector (D,); None without any."""
        return self._mean

    def spread(self) -> float:
        """Return the largest distance of a template from the mean."""
        return max((self._distance(one) for one in self._kept), default=0.0)

    def clear(self) -> None:
        """Forget every crop."""
        self._kept.clear()
        self._contradicting, self._mean = [], None

    def _distance(self, one: FaceTemplate) -> float:
        assert self._mean is not None
        return float(np.linalg.norm(one.template - self._mean))


@dataclass(frozen=True)
class PersonMatch:
    """A face may be of a person with this likelihood, 0..1; 0: it is not any longer."""

    face_id: str
    person_id: str
    likelihood: float


@dataclass(frozen=True)
class SamePersons:
    """Two known persons are one human with this likelihood, 0..1; 0: they are not any longer. `kept` is the older
    id."""

    kept: str
    other: str
    likelihood: float


@dataclass
class FaceIdentity:
    """One tracked face.

    Attributes
    ----------
    evidence : its templates.
    last_seen, due : times (s) of the last image with the face, and of the next crop.
    crops : number of crops so far.
    person : id of the person it is taken for, empty when that is not known.
    barred : its person was forgotten, so it is not learnt again.
    result : of the last comparison with the gallery, None before the first one.
    published : likelihood by person, as last published.
    """

    id: str
    evidence: FaceEvidence
    last_seen: float
    due: float
    crops: int = 0
    person: str = ""
    barred: bool = False
    result: Optional[MatchResult] = None
    published: Dict[str, float] = field(default_factory=dict)

    @property
    def candidates(self) -> Sequence[PersonCandidate]:
        """Whom it may be, likeliest first."""
        return self.result.candidates if self.result is not None else ()

    def is_there(self, now: float) -> bool:
        """Return whether the face was seen just before `now` (s)."""
        return now - self.last_seen <= TOGETHER

    def interval(self) -> float:
        """Return the time (s) to the next crop: short while there is something to decide, ever longer later."""
        patience = PATIENCE if self.person else 2 * PATIENCE
        return float(min(FIRST_INTERVAL * 1.5 ** min(50, max(0, self.crops - patience)), LONGEST_INTERVAL))

    def is_due(self, quality: float, stamp: float) -> bool:
        """Return whether a crop of this quality is worth a template at `stamp` (s)."""
        early = quality > self.evidence.best_quality + BETTER
        return stamp >= (self.due - self.interval() + FIRST_INTERVAL if early else self.due)

    def note_crop(self, stamp: float, again: bool) -> None:
        """Note a crop at `stamp` (s). again: it shows somebody else, so the next crops come soon."""
        self.crops = 1 if again else self.crops + 1
        self.due = stamp + self.interval()
        self.result = None

    def holds(self, taken: AbstractSet[str]) -> Dict[str, float]:
        """Return likelihood by person: the person it is taken for, else the candidates that are not in `taken`."""
        likely = {one.person_id: round(one.likelihood, 3) for one in self.candidates}
        if self.person:
            return {self.person: likely[self.person]}
        return {person_id: likelihood for person_id, likelihood in likely.items()
                if likelihood >= LEAST_PUBLISHED and person_id not in taken}

    def take_changes(self, holds: Mapping[str, float]) -> List[PersonMatch]:
        """Return how `holds` differs from what was published last, withdrawals first, and take it as published."""
        gone = [person_id for person_id in self.published if person_id not in holds]
        changed = [person_id for person_id, likelihood in holds.items()
                   if person_id not in self.published or _differ(likelihood, self.published[person_id])]
        for person_id in gone:
            del self.published[person_id]
        self.published.update((person_id, holds[person_id]) for person_id in changed)
        return ([PersonMatch(self.id, person_id, 0.0) for person_id in gone]
                + [PersonMatch(self.id, person_id, holds[person_id]) for person_id in changed])


def _assigned(faces: Sequence[FaceIdentity], taken: AbstractSet[str]) -> List[Optional[PersonCandidate]]:
    """Return a candidate or None for each face: no person twice, none of `taken`, with the largest total likelihood.

    It is the linear assignment problem (Kuhn 1955, "The Hungarian method for the assignment problem").
    """
    options = [{one.person_id: one for one in face.candidates
                if one.likelihood >= LEAST_PUBLISHED and one.person_id not in taken} for face in faces]
    columns = {name: column for column, name in enumerate(sorted(set().union(*options)))} if options else {}
    if not columns:
        return [None] * len(faces)
    worth = np.zeros((len(faces), len(columns)))
    for row, (face, option) in enumerate(zip(faces, options)):
        for name, one in option.items():
            worth[row, columns[name]] = one.likelihood + HOLD * (name == face.person)
    names = list(columns)
    chosen: List[Optional[PersonCandidate]] = [None] * len(faces)
    for row, column in zip(*linear_sum_assignment(worth, maximize=True)):
        chosen[row] = options[row].get(names[column])
    return chosen


def assign_persons(faces: Sequence[FaceIdentity], newest: float) -> None:
    """Decide who each face is: nobody is two faces; faces present at `newest` (s) are assigned before the others."""
    taken: set = set()
    for group in ([face for face in faces if face.is_there(newest)],
                  [face for face in faces if not face.is_there(newest)]):
        chosen = _assigned(group, taken)
        for face, one in zip(group, chosen):
            enough = RELEASE if one is not None and one.person_id == face.person else ACCEPT
            face.person = one.person_id if one is not None and one.likelihood >= enough else ""
        taken.update(one.person_id for one in chosen if one is not None)


def _differ(likelihood: float, before: float) -> bool:
    return abs(likelihood - before) >= CHANGE or (likelihood >= ACCEPT) != (before >= ACCEPT)
