"""The people a recogniser knows, in memory: several face templates per person, and who a new template is like.

`stored_gallery.StoredGallery` keeps them in the store of people as well.
"""

from __future__ import annotations

import threading
from typing import Collection, Dict, FrozenSet, List, Optional, Sequence, Set

import numpy as np

from hri_pipeline.core.ids import is_valid_id
from hri_pipeline.core.recognition.likelihood import (
    UNIT_TOLERANCE,
    MatchResult,
    PersonCandidate,
    TemplateCalibration,
    merge_duplicates,
    template_distances,
)
from hri_pipeline.core.recognition.store import KnownPerson

MAX_TEMPLATES, MAX_PERSONS = 5, 10000
NEAREST_SHARE = 0.5
"""What the nearest template of a person counts in a comparison; the rest is the mean of those that are like it.
Somebody else may be near to one of five by chance, but hardly to all of them."""


class GalleryError(ValueError):
    """What was asked of a gallery cannot be done: unknown person, malformed template, no room."""


class UnknownPersonError(GalleryError):
    """Nobody in the gallery has this id."""


class MemoryGallery:
    """Persons with face templates (D,): unit vectors. All methods are safe from several threads.

    The templates are kept in one array of `max_templates` places per person, so that a match is one product. `revision`
    grows with every change. All methods raise GalleryError. Only flush() and close() may take as long as a disk does.

    Parameters
    ----------
    model : name of the network that the templates come from.
    dimension : D, how many numbers a template has.
    calibration : of the distances of that network's templates.
    max_templates : of more templates of a person the most different ones are kept, and always the first one.
    max_persons : how many persons there is room for. When it is full, of those who have not agreed to be recognised and
        are not in view, who was not seen for longest gives way.
    """

    def __init__(self, model: str, dimension: int, calibration: TemplateCalibration, max_templates: int = MAX_TEMPLATES,
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
        self._apart: Set[FrozenSet[str]] = set()
        self._borrowed: Dict[str, str] = {}
        self._unseen: Dict[str, None] = {}      # everybody, who was not seen for longest first
        self._in_view: Set[str] = set()

    def __len__(self) -> int:
        return len(self._ids)

    def __contains__(self, person_id: object) -> bool:
        return person_id in self._row

    @property
    def refusal(self) -> str:
        """Why nobody can be added, empty when somebody can."""
        if len(self._ids) < self._max_persons or self._dispensable():
            return ""
        return "the gallery is full ({} persons); forget somebody".format(self._max_persons)

    def add_person(self, person_id: str, templates: np.ndarray, enrolled: bool = False) -> None:
        """Add somebody new with templates (K, D), K at least 1."""
        templates = self._checked(templates)
        if not is_valid_id(person_id):
            raise GalleryError("{!r} is no identifier".format(person_id))
        with self._lock:
            if person_id in self._row:
                raise GalleryError("person {} is there already".format(person_id))
            if self.refusal:
                raise GalleryError(self.refusal)
            if len(self._ids) >= self._max_persons:
                self.remove(self._dispensable())
            row = self._row[person_id] = len(self._ids)
            self._make_room(row + 1)
            self._ids.append(person_id)
            self._unseen[person_id] = None
            self._fill(row, templates, enrolled)

    def note_seen(self, person_ids: Collection[str]) -> None:
        """Note who is in view now."""
        with self._lock:
            self._in_view = set(person_ids)
            for person_id in self._in_view & self._unseen.keys():
                del self._unseen[person_id]
                self._unseen[person_id] = None

    def _dispensable(self) -> str:
        """Who gives way to somebody new; empty where nobody does."""
        with self._lock:
            return next((name for name in self._unseen if not (
                self._enrolled[self._row[name]] or name in self._in_view or name in self._borrowed)), "")

    def borrow(self, people: Sequence[KnownPerson], source: str) -> None:
        """Know these people, too, of whom nothing is learnt, kept or changed here: those of the read-only store
        `source`. Who is here already stays as they are."""
        with self._lock:
            for person in people:
                if person.id not in self:
                    self.add_person(person.id, person.templates, person.enrolled)
                    self._borrowed[person.id] = source

    def _check_own(self, person_id: str) -> None:
        if person_id in self._borrowed:
            raise GalleryError("{} is in the read-only store {}; change it there".format(
                person_id, self._borrowed[person_id]))

    def add_template(self, person_id: str, template: np.ndarray) -> bool:
        """Keep a template (D,) of a known person if it differs from the others, and not too much; return whether."""
        if person_id in self._borrowed:
            return False
        template = self._checked(np.asarray(template)[None])[0]
        with self._lock:
            row = self._row_of(person_id)
            # Small changes must not add up and lead from this person to another one.
            far = 1.0 - self.calibration.fair_midpoint ** 2 / 2.0
            kept = float(self._templates[row, 0] @ template) >= far and self._place(row, template)
            if kept:
                self._changed()
            return kept

    def enrol(self, person_id: str, enrolled: bool = True) -> None:
        """Note that a person has agreed to be recognised, or no longer does."""
        self._check_own(person_id)
        with self._lock:
            self._enrolled[self._row_of(person_id)] = enrolled
            self._changed()

    def keep_apart(self, first: str, second: str) -> None:
        """Note that two known persons are two people for certain: they were seen beside each other."""
        with self._lock:
            self._row_of(first), self._row_of(second)
            if first != second and not self.are_apart(first, second):
                self._apart.add(frozenset((first, second)))
                self._changed()

    def are_apart(self, first: str, second: str) -> bool:
        """Return whether two persons are known to be two people."""
        with self._lock:
            return frozenset((first, second)) in self._apart

    def drop_views(self, person_id: str, template: np.ndarray, below: float) -> None:
        """Forget the templates of a person nearer than `below` to this one (D,), which is of somebody else. The first
        one stays, and all of somebody of a read-only store."""
        if person_id in self._borrowed:
            return
        template = self._checked(np.asarray(template)[None])[0]
        with self._lock:
            row = self._row_of(person_id)
            views = self._templates[row, :self._count[row]]
            kept = views[(np.arange(len(views)) == 0) | (np.linalg.norm(views - template, axis=1) >= below)].copy()
            if len(kept) < len(views):
                self._templates[row], self._count[row] = 0.0, len(kept)
                self._templates[row, :len(kept)] = kept
                self._changed()

    def nearest(self, person_id: str, template: np.ndarray) -> Optional[float]:
        """Return the distance of a template (D,) from the nearest one of a person, None for somebody unknown."""
        template = self._checked(np.asarray(template)[None])[0]
        with self._lock:
            row = self._row.get(person_id)
            if row is None:
                return None
            products = self._templates[row, :self._count[row]] @ template
            best = int(products.argmax())
            return self.calibration.compared(float(template_distances(products[best])), template,
                                             self._templates[row, best])

    def alike(self, template: np.ndarray, below: float, except_for: str = "") -> List[PersonCandidate]:
        """Return who has a template nearer than `below` to this one (D,), nearest first, but for those who are known
        to be another person than `except_for`. Their distances are those of the nearest template."""
        result, = self.match(np.asarray(template)[None], most=len(self) or 1, nearest_only=True)
        return [one for one in result.candidates if one.distance < below and one.person_id != except_for
                and not self.are_apart(one.person_id, except_for)]

    def match(self, templates: np.ndarray, most: int = 5, enrolled_only: bool = False,
              views: Optional[Sequence[float]] = None, nearest_only: bool = False) -> List[MatchResult]:
        """Compare templates (N, D) with everybody, or with those who are enrolled.

        views: how many independent views (1 or more) each template is the mean of; 1 by default. nearest_only: only
        the nearest template of a person counts, not those that are like it.
        """
        templates = self._checked(templates)
        with self._lock:
            count = len(self._ids)
            rows = np.flatnonzero(self._enrolled[:count]) if enrolled_only else np.arange(count)
            if not rows.size:
                return [MatchResult((), 0) for _ in templates]
            kept = self._templates[rows] if enrolled_only else self._templates[:count]
            # Not by BLAS: its threads would wait for each other, and spin, for less than 0.2 ms of work.
            products = np.einsum("nd,md->nm", templates, kept.reshape(-1, self.dimension))
            products = products.reshape(len(templates), len(rows), self._max_templates)
            distances = self._distances(templates, products, rows, nearest_only)
            names = [self._ids[row] for row in rows] if enrolled_only else list(self._ids)
        worth = [1.0] * len(templates) if views is None else views
        firsts = self.calibration.alike_log_odds(template_distances(products[:, :, 0]))
        return [self._result(line, first, names, most, one) for line, first, one in zip(distances, firsts, worth)]

    def distance(self, first: str, second: str) -> Optional[float]:
        """Return the distance of the nearest templates of two persons; None for two who are two people for certain, or
        were both enrolled, as two people."""
        with self._lock:
            if first not in self._row or second not in self._row:
                return None
            rows = self._row[first], self._row[second]
            if self._enrolled[rows[0]] and self._enrolled[rows[1]] or self.are_apart(first, second):
                return None
            views = [self._templates[row, :self._count[row]] for row in rows]
            products = views[0] @ views[1].T
            one, two = np.unravel_index(int(products.argmax()), products.shape)
            return self.calibration.compared(float(template_distances(products[one, two])), views[0][one],
                                             views[1][two])

    def remove(self, person_id: str) -> bool:
        """Forget a person; return whether the person was known."""
        self._check_own(person_id)
        with self._lock:
            found = person_id in self._row
            if found:
                self._drop(person_id)
                self._apart = {pair for pair in self._apart if person_id not in pair}
                self._changed()
            return found

    def clear(self) -> None:
        """Forget everybody."""
        with self._lock:
            self._row, self._ids, self._apart, self._borrowed, self._unseen = {}, [], set(), {}, {}
            self._templates[:] = 0.0
            self._count[:] = 0
            self._enrolled[:] = False
            self._changed()

    def merge(self, source: str, target: str) -> None:
        """`source` is the same person as `target`: its templates go there and its id is gone.

        It is a person's wish, and stronger than what was seen: two who were kept apart may be merged.
        """
        if source == target:
            raise GalleryError("person {} cannot be merged into itself".format(source))
        self._check_own(source)
        self._check_own(target)
        with self._lock:
            row, goal = self._row_of(source), self._row_of(target)
            for template in self._templates[row, :self._count[row]].copy():
                self._place(goal, template)
            self._enrolled[goal] |= self._enrolled[row]
            self._apart = {pair if source not in pair else pair - {source} | {target} for pair in self._apart
                           if pair != {source, target}}
            self._drop(source)
            self._changed()

    def ids(self) -> List[str]:
        """Ids of everybody, oldest first."""
        with self._lock:
            return list(self._ids)

    def export(self, person_id: str) -> KnownPerson:
        """Return a copy of all that is kept of a person."""
        with self._lock:
            row = self._row_of(person_id)
            return KnownPerson(person_id, self._templates[row, :self._count[row]].copy(), bool(self._enrolled[row]))

    def flush(self) -> None:
        """Bring the disk and the gallery in line, where there is a disk."""

    def close(self) -> None:
        """Write what has changed and give the file back, where there is one. May be called again."""

    def _drop(self, person_id: str) -> None:
        row, last = self._row[person_id], len(self._ids) - 1
        for values in (self._templates, self._count, self._enrolled):
            values[row:last] = values[row + 1:last + 1].copy()
            values[last] = 0
        del self._ids[row], self._unseen[person_id]
        self._row = {name: index for index, name in enumerate(self._ids)}

    def _fill(self, row: int, templates: np.ndarray, enrolled: bool) -> None:
        """Let the person in a row have these templates (K, D), and no others."""
        self._templates[row], self._count[row], self._enrolled[row] = 0.0, 0, enrolled
        for template in templates:
            self._place(row, template)
        self._changed()

    def _changed(self) -> None:
        self.revision += 1

    def _row_of(self, person_id: str) -> int:
        if person_id not in self._row:
            raise UnknownPersonError("there is no person {!r}".format(person_id))
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
            self._templates, self._count, self._enrolled = (
                np.concatenate([values, np.zeros_like(values)])
                for values in (self._templates, self._count, self._enrolled))

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
        candidates = np.vstack([self._templates[row], template])
        similarity = candidates @ candidates.T
        np.fill_diagonal(similarity, -1.0)
        nearest = similarity.max(axis=1)
        redundant = 1 + int(nearest[1:count].argmax())
        if nearest[count] >= nearest[redundant]:
            return False
        self._templates[row, redundant] = template
        return True

    def _distances(self, templates: np.ndarray, products: np.ndarray, rows: np.ndarray,
                   nearest_only: bool) -> np.ndarray:
        """Return the distances of templates (N, D) from the persons in `rows` (M,), of the products (N, M, T) with
        their templates. Where the nearest one cannot be of the person anyhow, it alone counts, and as measured; so it
        does, but for the mean of all, with `nearest_only`."""
        nearest = products.argmax(axis=2)
        plain = template_distances(products.max(axis=2))
        distances = plain.copy()
        limit = 1.0 - self.calibration.fair_midpoint ** 2 / 2.0
        for line, column in zip(*np.nonzero(distances < self.calibration.fair_midpoint)):
            own, best = products[line, column], nearest[line, column]
            kept = self._templates[rows[column], :self._count[rows[column]]]
            if not nearest_only:
                # Views of a person that are far from each other (a beard, years between them) are not averaged.
                alike = own[:len(kept)][kept @ kept[best] >= limit]
                distances[line, column] = template_distances(
                    NEAREST_SHARE * own[best] + (1.0 - NEAREST_SHARE) * alike.mean())
            distances[line, column] = self.calibration.compared(distances[line, column], templates[line], kept[best])
            if not nearest_only:
                distances[line, column] += self._crowding(plain[line], kept[best], rows, column)
        return distances

    def _crowding(self, distances: np.ndarray, template: np.ndarray, rows: np.ndarray, column: int) -> float:
        """Return by how much the distance from the person in `column` of `rows` counts more, since others are near: to
        the face, at the distances (M,) from the persons in `rows`, and to that person's template (D,)."""
        if not self.calibration.crowd:
            return 0.0
        kept = self._templates[:len(rows)] if len(rows) == len(self._ids) else self._templates[rows]
        mutual = template_distances(np.einsum("mtd,d->mt", kept, template).max(axis=1))
        # Who is as near as that is the same human under another id.
        others = mutual >= self.calibration.one_human
        others[column] = False
        return self.calibration.crowding(distances[others], mutual[others])

    def _result(self, distances: np.ndarray, firsts: np.ndarray, names: List[str], most: int,
                views: float) -> MatchResult:
        likelihoods = self.calibration.likelihoods(distances, len(names), views)
        order = np.argsort(distances)[:most]
        candidates = tuple(PersonCandidate(names[i], float(distances[i]), float(likelihoods[i]), float(firsts[i]))
                           for i in order)
        place = {name: number for number, name in enumerate(names)}
        return merge_duplicates(MatchResult(candidates, len(names)), self.distance, place.__getitem__, self.calibration)
