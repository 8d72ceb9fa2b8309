"""The people a recogniser knows: several face templates per person, and who a new template is like.

`Gallery` is the interface; `MemoryGallery` keeps everything in memory and `gallery_file.FileGallery` on disk as well.
"""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Dict, List, Optional

import numpy as np

from hri_pipeline.core.ids import is_valid_id
from hri_pipeline.core.recognition.alike_persons import Candidate, MatchResult, join_alike
from hri_pipeline.core.recognition.likelihood import Calibration

MAX_TEMPLATES, MAX_PERSONS = 5, 10000
UNIT_TOLERANCE = 1e-3


class GalleryError(ValueError):
    """What was asked of a gallery cannot be done: unknown person, malformed template, no room."""


@dataclass(frozen=True)
class KnownPerson:
    """All that is kept of one person. templates: (K, D) float32 unit vectors; enrolled: agreed to be recognised."""

    id: str
    templates: np.ndarray
    enrolled: bool = False


class Gallery(ABC):
    """Persons with face templates (D,): unit vectors. All methods are safe from several threads.

    `revision` grows with every change. Errors are GalleryError.
    """

    revision: int

    @abstractmethod
    def add_person(self, person_id: str, templates: np.ndarray, enrolled: bool = False) -> None:
        """Add somebody new with templates (K, D), K at least 1."""

    @abstractmethod
    def add_template(self, person_id: str, template: np.ndarray) -> bool:
        """Keep a template (D,) of a known person if it tells something new, and is not too far; tells whether."""

    @abstractmethod
    def enrol(self, person_id: str, enrolled: bool = True) -> None:
        """Note that a person has agreed to be recognised, or no longer does."""

    @abstractmethod
    def match(self, templates: np.ndarray, most: int = 5, enrolled_only: bool = False) -> List[MatchResult]:
        """Compare templates (N, D) with everybody, or with those who are enrolled."""

    @abstractmethod
    def remove(self, person_id: str) -> bool:
        """Forget a person; tells whether there was one."""

    @abstractmethod
    def clear(self) -> None:
        """Forget everybody."""

    @abstractmethod
    def merge(self, source: str, target: str) -> None:
        """`source` is the same person as `target`: its templates go there and its id is gone."""

    @abstractmethod
    def rename(self, person_id: str, new_id: str) -> None:
        """Give a person another id."""

    @abstractmethod
    def ids(self) -> List[str]:
        """Ids of everybody, oldest first."""

    @abstractmethod
    def export(self, person_id: str) -> KnownPerson:
        """Return a copy of all that is kept of a person."""

    def flush(self) -> None:  # noqa: B027  (nothing to do is the rule for a gallery without a file)
        """Put what has changed on disk, where there is one."""

    def close(self) -> None:
        """Put what has changed on disk and give the file back. May be called again."""
        self.flush()


class MemoryGallery(Gallery):
    """Keeps templates in one array of `max_templates` places per person, so that a match is one product.

    model: name of the network the templates come from; calibration: of its distances. Of more than max_templates
    templates of a person the most different ones are kept; the first one always.
    """

    def __init__(self, model: str, dimension: int, calibration: Calibration, max_templates: int = MAX_TEMPLATES,
                 max_persons: int = MAX_PERSONS) -> None:
        if not (1 <= max_templates <= 100 and 1 <= max_persons <= 10 ** 6 and 1 <= dimension <= 10 ** 5):
            raise ValueError("legal ranges: max_templates 1..100, max_persons 1..1e6, dimension 1..1e5; got {}".format(
                (max_templates, max_persons, dimension)))
        self.model, self.dimension, self.calibration = model, dimension, calibration
        self.revision = 0
        self._lock = threading.RLock()
        self._max_templates, self._max_persons = max_templates, max_persons
        self._row: Dict[str, int] = {}
        self._ids: List[str] = []
        # An empty place is a zero vector: sqrt(2) away from everything, which is nobody's.
        self._templates = np.zeros((16, max_templates, dimension), np.float32)
        self._count = np.zeros(16, np.int32)
        self._enrolled = np.zeros(16, bool)

    def __len__(self) -> int:
        return len(self._ids)

    def __contains__(self, person_id: object) -> bool:
        return person_id in self._row

    def add_person(self, person_id: str, templates: np.ndarray, enrolled: bool = False) -> None:
        """See Gallery."""
        templates = self._checked(templates)
        if not is_valid_id(person_id):
            raise GalleryError("{!r} is no identifier".format(person_id))
        with self._lock:
            if person_id in self._row:
                raise GalleryError("person {} is there already".format(person_id))
            if len(self._ids) >= self._max_persons:
                raise GalleryError("the gallery is full ({} persons); forget somebody".format(self._max_persons))
            row = self._row[person_id] = len(self._ids)
            self._make_room(row + 1)
            self._ids.append(person_id)
            self._templates[row], self._count[row], self._enrolled[row] = 0.0, 0, enrolled
            for template in templates:
                self._place(row, template)
            self._changed()

    def add_template(self, person_id: str, template: np.ndarray) -> bool:
        """See Gallery."""
        template = self._checked(np.asarray(template)[None])[0]
        with self._lock:
            row = self._row_of(person_id)
            # No chain of small changes shall lead from this person to another one.
            far = 1.0 - self.calibration.fair_midpoint ** 2 / 2.0
            kept = float(self._templates[row, 0] @ template) >= far and self._place(row, template)
            if kept:
                self._changed()
            return kept

    def enrol(self, person_id: str, enrolled: bool = True) -> None:
        """See Gallery."""
        with self._lock:
            self._enrolled[self._row_of(person_id)] = enrolled
            self._changed()

    def match(self, templates: np.ndarray, most: int = 5, enrolled_only: bool = False) -> List[MatchResult]:
        """See Gallery."""
        templates = self._checked(templates)
        with self._lock:
            count = len(self._ids)
            rows = np.flatnonzero(self._enrolled[:count]) if enrolled_only else np.arange(count)
            if not rows.size:
                return [MatchResult((), 0) for _ in templates]
            kept = self._templates[rows] if enrolled_only else self._templates[:count]
            # Not by BLAS: its threads would wait for each other, and spin, for less than 0.2 ms of work.
            products = np.einsum("nd,md->nm", templates, kept.reshape(-1, self.dimension))
            nearest = products.reshape(len(templates), len(rows), self._max_templates).max(axis=2)
            distances = np.sqrt(np.maximum(0.0, 2.0 - 2.0 * nearest.astype(np.float64)))
            names = [self._ids[row] for row in rows] if enrolled_only else list(self._ids)
        return [self._result(line, names, most) for line in distances]

    def remove(self, person_id: str) -> bool:
        """See Gallery."""
        with self._lock:
            found = person_id in self._row
            if found:
                self._drop(person_id)
                self._changed()
            return found

    def clear(self) -> None:
        """See Gallery."""
        with self._lock:
            self._row, self._ids = {}, []
            self._templates[:] = 0.0
            self._count[:] = 0
            self._enrolled[:] = False
            self._changed()

    def merge(self, source: str, target: str) -> None:
        """See Gallery."""
        if source == target:
            raise GalleryError("person {} cannot be merged into itself".format(source))
        with self._lock:
            row, goal = self._row_of(source), self._row_of(target)
            for template in self._templates[row, :self._count[row]].copy():
                self._place(goal, template)
            self._enrolled[goal] |= self._enrolled[row]
            self._drop(source)
            self._changed()

    def rename(self, person_id: str, new_id: str) -> None:
        """See Gallery."""
        if not is_valid_id(new_id):
            raise GalleryError("{!r} is no identifier".format(new_id))
        with self._lock:
            row = self._row_of(person_id)
            if new_id in self._row:
                raise GalleryError("person {} is there already".format(new_id))
            self._ids[row] = new_id
            self._row = {name: index for index, name in enumerate(self._ids)}
            self._changed()

    def ids(self) -> List[str]:
        """See Gallery."""
        with self._lock:
            return list(self._ids)

    def export(self, person_id: str) -> KnownPerson:
        """See Gallery."""
        with self._lock:
            row = self._row_of(person_id)
            return KnownPerson(person_id, self._templates[row, :self._count[row]].copy(), bool(self._enrolled[row]))

    def _drop(self, person_id: str) -> None:
        row, last = self._row[person_id], len(self._ids) - 1
        for values in (self._templates, self._count, self._enrolled):
            values[row:last] = values[row + 1:last + 1].copy()
            values[last] = 0
        del self._ids[row]
        self._row = {name: index for index, name in enumerate(self._ids)}

    def _changed(self) -> None:
        self.revision += 1

    def _row_of(self, person_id: str) -> int:
        if person_id not in self._row:
            raise GalleryError("there is no person {!r}".format(person_id))
        return self._row[person_id]

    def _checked(self, templates: np.ndarray) -> np.ndarray:
        templates = np.asarray(templates, dtype=np.float32)
        if templates.ndim != 2 or templates.shape[1] != self.dimension or not len(templates):
            raise GalleryError("templates are of shape {}, they must be (1 or more, {})".format(
                templates.shape, self.dimension))
        lengths = np.linalg.norm(templates, axis=1)
        if not (np.abs(lengths - 1.0) <= UNIT_TOLERANCE).all():
            raise GalleryError("a template is no unit vector: length {}".format(lengths))
        return templates

    def _make_room(self, count: int) -> None:
        if count > len(self._count):
            room = 2 * len(self._count)
            self._templates = np.concatenate([self._templates, np.zeros_like(self._templates)])
            self._count = np.resize(self._count, room)
            self._enrolled = np.resize(self._enrolled, room)

    def _place(self, row: int, template: np.ndarray) -> bool:
        """Keep a template if it differs; when there is no room, instead of the one that is nearest to the others."""
        count = int(self._count[row])
        near = 1.0 - self.calibration.near ** 2 / 2.0
        if count and float((self._templates[row, :count] @ template).max()) > near:
            return False
        if count < self._max_templates:
            self._templates[row, count] = template
            self._count[row] += 1
            return True
        if count == 1:
            return False
        everyone = np.vstack([self._templates[row], template])
        likeness = everyone @ everyone.T
        np.fill_diagonal(likeness, -1.0)
        closest = likeness.max(axis=1)
        dullest = 1 + int(closest[1:count].argmax())
        if closest[count] >= closest[dullest]:
            return False
        self._templates[row, dullest] = template
        return True

    def _result(self, distances: np.ndarray, names: List[str], most: int) -> MatchResult:
        likelihoods = self.calibration.likelihoods(distances, len(names))
        order = np.argsort(distances)[:most]
        candidates = tuple(Candidate(names[i], float(distances[i]), float(likelihoods[i])) for i in order)
        place = {name: number for number, name in enumerate(names)}
        return join_alike(MatchResult(candidates, len(names)), self.distance, place.__getitem__, self.calibration)

    def distance(self, first: str, second: str) -> Optional[float]:
        """Distance of the nearest templates of two persons; None for two who were both enrolled, as two people."""
        with self._lock:
            if first not in self._row or second not in self._row:
                return None
            rows = self._row[first], self._row[second]
            if self._enrolled[rows[0]] and self._enrolled[rows[1]]:
                return None
            views = [self._templates[row, :self._count[row]] for row in rows]
            return float(np.sqrt(max(0.0, 2.0 - 2.0 * float((views[0] @ views[1].T).max()))))
