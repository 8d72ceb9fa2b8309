"""State of the recognition of one tracked face, and who gets whom when several faces claim one person."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import AbstractSet, Dict, List, Mapping, Optional, Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from hri_pipeline.core.recognition.alike_persons import Candidate, MatchResult
from hri_pipeline.core.recognition.face_evidence import FaceEvidence

ACCEPT, RELEASE = 0.6, 0.3
"""Likelihood from which a face is taken for a person, and below which it no longer is."""
PUBLISHED = 0.1
"""Least likelihood of a candidate that is told."""
CHANGE = 0.05
"""Least change of a likelihood that is told."""
HOLD = 0.2
"""By so much a claim must be likelier than that of the face which has the person already."""
FIRST_INTERVAL, LONGEST_INTERVAL = 0.25, 5.0
"""Time (s) between two crops of a face at first, and after many."""
PATIENCE = 4
"""Crops of a recognised face after which the next ones come less and less often; of another one: twice as many."""
TOGETHER = 0.5
"""Faces seen within so many seconds are there at the same time: not every face is looked at in every image."""
BETTER = 0.15
"""A crop that is better than the best one by so much is looked at early."""


@dataclass(frozen=True)
class Match:
    """A face may be of a person with this likelihood, 0..1; 0: it is not any longer."""

    face_id: str
    person_id: str
    likelihood: float


@dataclass(frozen=True)
class SamePersons:
    """Two known persons are one human with this likelihood, 0..1; 0: they are not any longer. `kept` is the older id."""

    kept: str
    other: str
    likelihood: float


@dataclass
class FaceIdentity:
    """One face. due: time (s) of the next crop; looks: crops so far; person: who it is taken for, or empty; barred: its
    person was forgotten, so it is not learnt again; result: of the last comparison, None before; told: likelihood by
    person that was told last.
    """

    id: str
    evidence: FaceEvidence
    last_seen: float
    due: float
    looks: int = 0
    person: str = ""
    barred: bool = False
    result: Optional[MatchResult] = None
    told: Dict[str, float] = field(default_factory=dict)

    @property
    def candidates(self) -> Sequence[Candidate]:
        """Whom it may be, likeliest first."""
        return self.result.candidates if self.result is not None else ()

    def is_there(self, now: float) -> bool:
        """Tell whether the face was seen just before `now` (s)."""
        return now - self.last_seen <= TOGETHER

    def interval(self) -> float:
        """Return the time (s) to the next crop: short while there is something to decide, ever longer later."""
        patience = PATIENCE if self.person else 2 * PATIENCE
        return float(min(FIRST_INTERVAL * 1.5 ** min(50, max(0, self.looks - patience)), LONGEST_INTERVAL))

    def is_due(self, quality: float, stamp: float) -> bool:
        """Tell whether a crop of this quality is worth a template at `stamp` (s)."""
        early = quality > self.evidence.best_quality + BETTER
        return stamp >= (self.due - self.interval() + FIRST_INTERVAL if early else self.due)

    def looked(self, stamp: float, again: bool) -> None:
        """Note a crop at `stamp` (s); again: it speaks of somebody else, so the next ones come soon."""
        self.looks = 1 if again else self.looks + 1
        self.due = stamp + self.interval()
        self.result = None

    def holds(self, taken: AbstractSet[str]) -> Dict[str, float]:
        """Return likelihood by person: the one it is taken for, or candidates that are not in `taken`."""
        likely = {one.person_id: round(one.likelihood, 3) for one in self.candidates}
        if self.person:
            return {self.person: likely[self.person]}
        return {person_id: likelihood for person_id, likelihood in likely.items()
                if likelihood >= PUBLISHED and person_id not in taken}

    def news(self, holds: Mapping[str, float]) -> List[Match]:
        """Return what differs from what was told last, withdrawals first, and take it as told."""
        gone = [person_id for person_id in self.told if person_id not in holds]
        changed = [person_id for person_id, likelihood in holds.items()
                   if person_id not in self.told or _differ(likelihood, self.told[person_id])]
        for person_id in gone:
            del self.told[person_id]
        self.told.update((person_id, holds[person_id]) for person_id in changed)
        return ([Match(self.id, person_id, 0.0) for person_id in gone]
                + [Match(self.id, person_id, holds[person_id]) for person_id in changed])


def claims(faces: Sequence[FaceIdentity], taken: AbstractSet[str]) -> List[Optional[Candidate]]:
    """Return whom each face may have, no person twice and none of `taken`, at the largest total likelihood."""
    options = [{one.person_id: one for one in face.candidates
                if one.likelihood >= PUBLISHED and one.person_id not in taken} for face in faces]
    columns = {name: column for column, name in enumerate(sorted(set().union(*options)))} if options else {}
    if not columns:
        return [None] * len(faces)
    worth = np.zeros((len(faces), len(columns)))
    for row, (face, option) in enumerate(zip(faces, options)):
        for name, one in option.items():
            worth[row, columns[name]] = one.likelihood + HOLD * (name == face.person)
    names = list(columns)
    chosen: List[Optional[Candidate]] = [None] * len(faces)
    for row, column in zip(*linear_sum_assignment(worth, maximize=True)):
        chosen[row] = options[row].get(names[column])
    return chosen


def settle(faces: Sequence[FaceIdentity], newest: float) -> None:
    """Decide who each face is: nobody is two faces, and those that are there at `newest` (s) choose before others."""
    taken: set = set()
    for group in ([face for face in faces if face.is_there(newest)],
                  [face for face in faces if not face.is_there(newest)]):
        chosen = claims(group, taken)
        for face, claim in zip(group, chosen):
            enough = RELEASE if claim is not None and claim.person_id == face.person else ACCEPT
            face.person = claim.person_id if claim is not None and claim.likelihood >= enough else ""
        taken.update(claim.person_id for claim in chosen if claim is not None)


def _differ(likelihood: float, before: float) -> bool:
    return abs(likelihood - before) >= CHANGE or (likelihood >= ACCEPT) != (before >= ACCEPT)
