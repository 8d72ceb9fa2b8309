"""Who is who: from templates of tracked faces over time to permanent person ids.

A face is compared with the gallery by the mean of its crops. Close to one person and to no other: known, and a view of
that person that is new is learnt. Far from everybody, seen well and for long enough: a new person, where learning is
allowed. Between the two: candidates, with lower likelihoods. A name that later views contradict is taken back. Two
faces in one image are never the same person, and stay two people for ever.
"""

from __future__ import annotations

import threading
from typing import Dict, Iterable, List, Mapping, Optional, Sequence, Set, Tuple

import numpy as np

from hri_pipeline.core.ids import IdGenerator
from hri_pipeline.core.image_rotation import ImageRotation
from hri_pipeline.core.recognition.face_identity import (
    ACCEPT,
    LEARN_AT_ONCE,
    LEARN_CROPS,
    LEARN_QUALITY,
    LEAST_PUBLISHED,
    NAMING_CROPS,
    FaceEvidence,
    FaceIdentity,
    FaceTemplate,
    PersonMatch,
    SamePersons,
    are_different,
    assign_persons,
    note_beside,
    note_pictures,
    share_templates,
)
from hri_pipeline.core.recognition.gallery import GalleryError, MemoryGallery
from hri_pipeline.core.recognition.likelihood import MatchResult
from hri_pipeline.core.recognition.store import KnownPerson

POLICIES = ("learn", "enrolled")
"""learn: an unknown person who is seen well gets an id; enrolled: only people who were enrolled are recognised."""
NEW_BELOW = 0.4
"""Likelihood, without caution, of being anybody known, below which a face is somebody new."""
NOT_SEEN_WELL = "not seen well yet"
"""Why a face is nobody's, where its crops are the reason."""
COVERED = "nose and mouth are covered"
"""The same, of somebody with a mask or scarf."""
DARK_GLASSES = "dark glasses"
"""The same, where they hide the eyes."""
SMEARED = "blurred by motion"
"""The same, since it came into view."""
OPEN_S = 1.0
"""Time (s) for which a face that showed nose and mouth is not asked again."""
SAME = 0.95
"""Likelihood that is published of two known persons who are the same by their templates."""
SHOWN_S = 60.0
"""For how long (s) after somebody was named last, a face that is plainly somebody else, or seen well and nobody's, is
told not to be that person: the body that it has now may have been that person's, as after a cut of the picture."""


class Recogniser:
    """Recognises tracked faces. Safe from several threads.

    Parameters
    ----------
    gallery : the known people.
    policy : one of POLICIES.
    learn_delay : time (s) for which an unknown face must have been seen before it becomes a person.
    min_quality : least quality (0 to 1) of a crop that is used.
    ids : makes the ids of new persons.

    Raises
    ------
    ValueError
        A parameter is outside of its range.
    """

    def __init__(self, gallery: MemoryGallery, policy: str = "learn", learn_delay: float = 1.5,
                 min_quality: float = 0.35, ids: Optional[IdGenerator] = None) -> None:
        if policy not in POLICIES:
            raise ValueError("policy is {!r}, legal: {}".format(policy, ", ".join(POLICIES)))
        if not (0.0 <= learn_delay < np.inf and 0.0 <= min_quality <= 1.0):
            raise ValueError("learn_delay must be 0 s or more, min_quality 0 to 1; got {!r}, {!r}".format(
                learn_delay, min_quality))
        self.gallery = gallery
        self._learns = policy == "learn"
        self.learn_delay, self._min_quality = learn_delay, min_quality
        self._ids = ids if ids is not None else IdGenerator()
        self._lock = threading.RLock()
        self._faces: Dict[str, FaceIdentity] = {}
        self._newest = -np.inf
        self._revision = -1
        self._same: Set[Tuple[str, str]] = set()
        self._same_published: Set[Tuple[str, str]] = set()
        self._same_revision = -1
        self._refused = 0
        self._learnt = 0
        self._shown: Dict[str, float] = {}      # stamp (s) at which somebody was named last

    def seen(self, qualities: Mapping[str, float], stamp: float, limit: int = 1) -> List[str]:
        """Note all faces in an image; return at most `limit` of them that are worth a template now, most urgent first.

        qualities: by face id, 0 to 1, of the crops; stamp: s; one earlier than the last one is a new start (reset).
        """
        with self._lock:
            if stamp < self._newest:
                self.reset()
            self._newest = stamp
            for face_id in qualities:
                if face_id not in self._faces:
                    calibration = self.gallery.calibration
                    self._faces[face_id] = FaceIdentity(
                        face_id, FaceEvidence(calibration.contradiction, calibration.spread), stamp)
                self._faces[face_id].last_seen = stamp
            share_templates(list(self._faces.values()), stamp)
            waiting = [face_id for face_id, quality in qualities.items()
                       if quality >= self._min_quality and self._faces[face_id].is_due(quality, stamp)]
            return sorted(waiting, key=lambda face_id: -self._faces[face_id].lateness(
                qualities[face_id], stamp))[:limit]

    def watch(self, meshes: Mapping[str, np.ndarray], stamp: float) -> None:
        """Take the meshes (N, 2 or 3), px, of faces in the image at `stamp` (s): living ones move."""
        with self._lock:
            for face_id, mesh in meshes.items():
                if face_id in self._faces:
                    self._faces[face_id].motion.add(mesh, stamp)

    def is_blurred(self, face_id: str, crop: np.ndarray, stamp: float) -> bool:
        """Tell whether a crop (S, S, 3) uint8 BGR of a face is blurred by motion, so that a template of it would speak
        against the right name; the face stays due, after the others. Of one that was never seen sharp templates are
        made, but nothing is learnt."""
        with self._lock:
            face = self._faces.get(face_id)
            if face is None:
                return False
            if face.blur.is_blurred(crop, stamp):
                face.passed_over = stamp
                return True
            face.is_smeared = face.blur.is_smeared(crop, stamp)
            return False

    def asks_for_cover(self, face_id: str, template: np.ndarray, stamp: float) -> bool:
        """Tell whether it is to be asked if a crop at `stamp` (s) shows nose and mouth: not while the face has a sure
        name for which its template (D,) alone speaks, nor in the second after a crop that showed them."""
        with self._lock:
            face = self._faces.get(face_id)
            if face is None:
                return True
            log_odds = self._log_odds(face.person, template) if face.is_sure else None
            return (log_odds is None or log_odds <= 0.0) and not 0.0 <= stamp - face.open < OPEN_S

    def note_cover(self, covered: Mapping[str, bool], stamp: float) -> None:
        """Take note by face whether its crop at `stamp` (s) does not show nose and mouth: then it makes no template."""
        with self._lock:
            for face_id, is_covered in covered.items():
                face = self._faces.get(face_id)
                if face is not None and is_covered:
                    face.note_covered(stamp)
                elif face is not None:
                    face.open = stamp

    def note_dark_glasses(self, worn: Mapping[str, bool]) -> None:
        """Take note by face whether its eyes were behind dark glasses in the last crop: it may be somebody known, but
        nothing is learnt of it, as people are alike so and unlike themselves."""
        with self._lock:
            for face_id, is_worn in worn.items():
                if face_id in self._faces:
                    self._faces[face_id].has_dark_glasses = is_worn

    def turn(self, rotation: ImageRotation) -> None:
        """Take note that the images are turned by `rotation` from now on, against those before."""
        with self._lock:
            for face in self._faces.values():
                face.motion.turn(rotation)

    def update(self, face_ids: Sequence[str], templates: Sequence[np.ndarray], qualities: Sequence[float],
               stamp: float) -> List[PersonMatch]:
        """Add templates (N, D) of faces in the image at `stamp` (s), and return what `changes` returns.

        A template that is no unit vector is refused and counted. Raises ValueError when the lengths differ.
        """
        if not len(face_ids) == len(templates) == len(qualities):
            raise ValueError("{} faces, {} templates and {} qualities".format(
                len(face_ids), len(templates), len(qualities)))
        with self._lock:
            for face_id, template, quality in zip(face_ids, templates, qualities):
                face = self._faces.get(face_id)
                usable = float(quality) if face is None else face.usable(float(quality))
                self._take(face_id, np.asarray(template, dtype=np.float32), usable, stamp)
            return self.changes()

    def changes(self) -> List[PersonMatch]:
        """Decide, and return the matches that have changed since the last time; cheap when nothing has."""
        with self._lock:
            self._compare()
            self._assign()
            self._note_beside()
            self._learn()
            taken = {face.person for face in self._faces.values() if face.person}
            changed = [match for face in self._faces.values() for match in face.take_changes(face.holds(taken))]
            changed += self._denials(taken)
            # Withdrawals first: nobody is two faces, not even between two messages.
            return sorted(changed, key=lambda match: match.likelihood > 0.0)

    def _denials(self, taken: Set[str]) -> List[PersonMatch]:
        """Matches of 0 with those who were named a while ago, once each: of faces that were seen well and are nobody's,
        and sooner of those whose views are plainly of somebody else."""
        there = [face for face in self._faces.values() if face.is_there(self._newest)]
        visible = {face.person for face in there if face.person}
        self._shown.update(dict.fromkeys(visible, self._newest))
        self._shown = {person: stamp for person, stamp in self._shown.items()
                       if 0.0 <= self._newest - stamp <= SHOWN_S and person in self.gallery}
        denied = []
        for face in there:
            others = self._shown.keys() - face.denied - visible - face.published.keys()
            if not others or face.person or face.evidence.mean() is None:
                continue
            told = {person for person in others if face.is_unlike(person)}
            if others - taken - told and self._is_new(face):
                told |= others - taken
            face.denied |= told
            denied += [PersonMatch(face.id, person, 0.0) for person in sorted(told)]
        return denied

    def current(self) -> List[PersonMatch]:
        """Return all matches that hold."""
        with self._lock:
            return [PersonMatch(face_id, person_id, likelihood) for face_id, face in self._faces.items()
                    for person_id, likelihood in face.published.items()]

    def same_persons(self) -> List[Tuple[str, str]]:
        """Return pairs (id that is published, other id) of known persons who turned out to be one human."""
        with self._lock:
            if self._same and self._same_revision != self.gallery.revision:
                self._same_revision = self.gallery.revision
                self._same = {pair for pair in self._same if self._are_alike(*pair)}
            return sorted(self._same)

    def _are_alike(self, first: str, second: str) -> bool:
        distance = self.gallery.distance(first, second)
        return distance is not None and distance < self.gallery.calibration.midpoint

    def same_changes(self) -> List[SamePersons]:
        """Return what has changed in `same_persons` since the last time, withdrawals first; cheap when nothing has."""
        with self._lock:
            now, before = set(self.same_persons()), self._same_published
            self._same_published = now
            return ([SamePersons(*pair, 0.0) for pair in sorted(before - now)]
                    + [SamePersons(*pair, SAME) for pair in sorted(now - before)])

    def keep(self, face_ids: Iterable[str]) -> None:
        """Drop all other faces. Their matches are not withdrawn: they were right when the face left."""
        living = set(face_ids)
        with self._lock:
            self._learn_later_views(face for face_id, face in self._faces.items() if face_id not in living)
            self._faces = {face_id: face for face_id, face in self._faces.items() if face_id in living}

    def reset(self) -> None:
        """Drop all faces, as after a jump in time; the gallery stays."""
        with self._lock:
            self._learn_later_views(self._faces.values())
            self._faces, self._newest = {}, -np.inf
            self._shown.clear()

    def person_of(self, face_id: str) -> str:
        """Return the person that a face is taken for, empty when that is not known."""
        with self._lock:
            face = self._faces.get(face_id)
            return face.person if face is not None else ""

    def enrol(self, face_id: str, person_id: str = "", confirm: bool = False) -> str:
        """Make a face an enrolled person: `person_id`, or who it is taken for, or somebody new. Returns the id.

        Parameters
        ----------
        confirm : it is so although the face looks like somebody else who is known, or not like `person_id`. Without an
            id it is somebody new then, and kept apart from those it looks like.

        Raises
        ------
        GalleryError
            The face is not there, has not been seen well, or looks like somebody else and that is not confirmed.
        """
        with self._lock:
            face = self._faces.get(face_id)
            template = face.evidence.mean() if face is not None else None
            if face is None or template is None or len(face.evidence) < NAMING_CROPS:
                raise GalleryError("face {!r} is not tracked, or has not been seen well enough yet".format(face_id))
            if face.is_unlike_itself and not face.evidence.good(LEARN_QUALITY) and not confirm:
                raise GalleryError("face {!r} has been seen {}, or confirm".format(
                    face_id, "with dark glasses only: take them off" if face.has_dark_glasses else
                    "blurred by motion only: wait until it holds still, or is nearer"))
            person_id = person_id or ("" if confirm else face.person) or self._new_id()
            alike = [one.person_id for one in self.gallery.alike(
                template, self.gallery.calibration.fair_midpoint, person_id) if one.person_id not in face.apart]
            if not confirm:
                self._refuse_to_enrol(template, person_id, alike)
            self._store_enrolled(person_id, template)
            for other in alike:
                # What was learnt while this face was taken for somebody else.
                self.gallery.drop_views(other, template, self.gallery.calibration.one_human)
            for other in alike + [other for other in face.apart if other in self.gallery]:
                self.gallery.keep_apart(person_id, other)
            face.barred = False
            if person_id != face.person:
                face.later_view = None
            return person_id

    def _refuse_to_enrol(self, template: np.ndarray, person_id: str, alike: Sequence[str]) -> None:
        """Raise GalleryError where a face looks more like somebody else, or not at all like the person it shall be."""
        calibration, distance = self.gallery.calibration, self.gallery.nearest(person_id, template)
        if distance is not None and distance > calibration.kin_midpoint:
            raise GalleryError("the face does not look like {} (distance {:.2f}); if it is, confirm it".format(
                person_id, distance))
        nearer = [other for other in alike
                  if distance is None or (self.gallery.nearest(other, template) or 0.0) < distance]
        if nearer:
            raise GalleryError("the face looks like {}, who is known already; if it is somebody else, confirm"
                               " it".format(", ".join(nearer)))

    def _store_enrolled(self, person_id: str, template: np.ndarray) -> None:
        if person_id in self.gallery:
            self.gallery.add_template(person_id, template)
            self.gallery.enrol(person_id)
        else:
            self.gallery.add_person(person_id, template[None], enrolled=True)

    def forget(self, person_id: str) -> bool:
        """Forget a person; a face in view is not learnt again. Returns whether the person was known.

        On the disk the person is forgotten with the next flush() of the gallery. Raises GalleryError, and forgets
        nothing, for somebody of a read-only store.
        """
        if not person_id:  # a face of nobody yet has this person
            return False
        with self._lock:
            # Who has just been merged or enrolled is the person by now.
            self._compare()
            self._assign()
            is_known = self.gallery.remove(person_id)
            taken = {face.person for face in self._faces.values() if face.person}
            for face in self._faces.values():
                if person_id in face.published or person_id in face.holds(taken):
                    face.forget()
            return is_known

    def forget_all(self) -> None:
        """Forget everybody; faces in view are not learnt again."""
        with self._lock:
            for face in self._faces.values():
                face.forget()
            self.gallery.clear()

    def merge(self, source: str, target: str) -> None:
        """Two ids are of one person, `target`. Raises GalleryError when one is not known."""
        self.gallery.merge(source, target)

    def export(self, person_id: str) -> KnownPerson:
        """Return all that is kept of a person. Raises GalleryError when there is none."""
        return self.gallery.export(person_id)

    def list_known(self) -> List[str]:
        """Return the ids of everybody known."""
        return self.gallery.ids()

    def status(self) -> Dict[str, int]:
        """Return figures for diagnostics."""
        with self._lock:
            return {"known_persons": len(self.gallery), "recognised_faces": sum(
                bool(face.person) for face in self._faces.values()), "learnt_persons": self._learnt,
                "refused_templates": self._refused}

    def unknown(self) -> Dict[str, str]:
        """Return why faces in view are nobody's, in words, by their ids."""
        with self._lock:
            self._compare()     # who was forgotten is not told, even when no image comes any more
            return {face.id: self._hindrance(face) or ("about to be learnt" if self._learns else
                                                       "like nobody who is enrolled")
                    for face in self._faces.values() if not face.person and face.is_there(self._newest)}

    def _take(self, face_id: str, template: np.ndarray, quality: float, stamp: float) -> None:
        face = self._faces.get(face_id)
        if face is None or not quality >= self._min_quality:
            return
        if template.shape != (self.gallery.dimension,) or not abs(float(np.linalg.norm(template)) - 1.0) < 1e-3:
            self._refused += 1
            return
        before = face.person
        face.take(FaceTemplate(template, quality, stamp), self._log_odds(before, template) if before else None)
        if not face.person:
            face.note_unlike(self._log_odds_of_shown(template, face.denied))
        if before and not face.person:
            # Who was beside a face with a wrong name may be that person.
            for other in self._faces.values():
                other.apart = {person_id: beside for person_id, beside in other.apart.items() if beside != face_id}

    def _log_odds_of_shown(self, template: np.ndarray, but: Set[str]) -> Dict[str, float]:
        """Return by who was named in the last minute, `but` for these, what _log_odds tells of a template (D,)."""
        near = {person: self.gallery.nearest(person, template) for person in self._shown.keys() - but}
        known = {person: distance for person, distance in near.items() if distance is not None}
        if not known:
            return {}
        odds = self.gallery.calibration.log_odds(np.array(list(known.values())), len(self.gallery))
        return dict(zip(known, odds.tolist()))

    def _log_odds(self, person_id: str, template: np.ndarray) -> Optional[float]:
        """Return the logarithm of the odds that one template (D,) is of a person, None for somebody unknown."""
        distance = self.gallery.nearest(person_id, template)
        return None if distance is None else float(self.gallery.calibration.log_odds(
            np.array(distance), len(self.gallery)))

    def _compare(self) -> None:
        """Compare the faces that have changed; all of them when the gallery has."""
        every, self._revision = self._revision != self.gallery.revision, self.gallery.revision
        stale = [face for face in self._faces.values() if every or face.result is None]
        known = [(face, mean) for face, mean in ((face, face.evidence.mean()) for face in stale) if mean is not None]
        for face in stale:
            face.result = MatchResult((), 0)
        if known:
            results = self.gallery.match(np.stack([mean for _, mean in known]), enrolled_only=not self._learns,
                                         views=[face.evidence.views for face, _ in known])
            for (face, _), result in zip(known, results):
                face.result = result
                self._same.update(result.same)
                is_like_nobody = all(one.likelihood < LEAST_PUBLISHED for one in result.candidates)
                if is_like_nobody and face.person and face.person not in self.gallery:
                    face.forget()       # by another process: who was merged is like somebody

    def _assign(self) -> None:
        """Decide who each face is. What was learnt of a face that had to give its name to one beside it is dropped."""
        before = {face.id: face.person for face in self._faces.values()}
        note_pictures(list(self._faces.values()), self._newest, self.gallery.calibration.one_human)
        assign_persons(list(self._faces.values()), self._newest)
        self.gallery.note_seen({face.person for face in self._faces.values() if face.person})
        limit = self.gallery.calibration.one_human
        there = [face for face in self._faces.values() if face.is_there(self._newest)]
        for face in there:
            if not face.person or face.person == before[face.id] or face.person not in self.gallery:
                continue
            for other in there:
                mean = other.evidence.mean()
                if mean is not None and face.person in other.refuted and are_different(face, other, limit):
                    self.gallery.drop_views(face.person, mean, limit)

    def _note_beside(self) -> None:
        pairs = note_beside(list(self._faces.values()), self._newest, self.gallery.calibration.one_human)
        for first, second in pairs:
            try:
                self.gallery.keep_apart(first, second)
            except GalleryError:
                pass    # forgotten or merged in this moment, by another thread

    def _learn(self) -> None:
        """Keep new views of sure persons; make persons of faces seen well that are nobody's."""
        for face in self._faces.values():
            mean = face.evidence.mean()
            if mean is None or face.evidence.good(LEARN_QUALITY) < LEARN_CROPS - 1:
                continue
            if face.person:
                self._learn_view(face, mean)
            elif self._learns and face.is_there(self._newest) and self._is_new(face):
                self._make_person(face, mean)

    def _learn_view(self, face: FaceIdentity, mean: np.ndarray) -> None:
        if face.learnt_after is face.result:
            return      # neither its templates nor the gallery have changed: it would refuse them again
        face.learnt_after = face.result
        first = face.candidates[0]
        near = self.gallery.calibration.midpoint - 4.0 * self.gallery.calibration.scale
        if first.person_id != face.person or first.likelihood < ACCEPT or first.distance > near:
            return
        if first.likelihood >= LEARN_AT_ONCE:
            self._add_view(face.person, mean)
        else:
            face.later_view = mean

    def _learn_later_views(self, faces: Iterable[FaceIdentity]) -> None:
        """Learn what waited until these faces have left."""
        for face in faces:
            if face.is_certain and face.later_view is not None:
                self._add_view(face.person, face.later_view)

    def _add_view(self, person_id: str, template: np.ndarray) -> None:
        try:
            self.gallery.add_template(person_id, template)
        except GalleryError:
            pass    # forgotten or merged in this moment, by another thread: the next comparison knows

    def _is_new(self, face: FaceIdentity) -> bool:
        """Whether a face was seen well, for long enough, and is like nobody, those in view included."""
        return not self._hindrance(face)

    def _hindrance(self, face: FaceIdentity) -> str:
        """Why a face is not somebody new, empty when it is."""
        evidence, calibration = face.evidence, self.gallery.calibration
        if face.barred:
            return "forgotten while in view"
        if evidence.good(LEARN_QUALITY) < LEARN_CROPS:
            return (COVERED if face.is_covered else DARK_GLASSES if face.has_dark_glasses else
                    SMEARED if face.is_smeared else NOT_SEEN_WELL)
        if evidence.duration < self.learn_delay:
            return "seen for {:.1f} of {:g} s".format(evidence.duration, self.learn_delay)
        if face.is_picture:
            return "a picture of somebody who is beside it"
        if evidence.spread() > calibration.midpoint:
            return "its views differ as those of two people do"
        # A picture of somebody in view, or a mirror, is like him although it cannot be him.
        others = {other.person for other in self._faces.values()
                  if other is not face and other.person and other.is_there(self._newest)}
        alike = calibration.midpoint - 2.0 * calibration.scale
        for one in face.candidates:
            if one.person_id in others and one.distance < alike:
                return "like {}, who is in view".format(one.person_id)
        free = [one for one in face.candidates if one.person_id not in others and one.person_id not in face.apart]
        distances = np.array([one.distance for one in free])
        # Somebody alike who is known already: it may be him after all, or kin. Neither is learnt unasked.
        if free and not (distances.min() >= calibration.contradiction and
                         calibration.known(distances, len(self.gallery)) < NEW_BELOW):
            return "like {}, but not surely that person".format(free[int(distances.argmin())].person_id)
        return self.gallery.refusal if self._learns else ""

    def _make_person(self, face: FaceIdentity, mean: np.ndarray) -> None:
        person_id = self._new_id()
        try:
            self.gallery.add_person(person_id, mean[None])
            for other in face.apart:
                if other in self.gallery:
                    self.gallery.keep_apart(person_id, other)
        except GalleryError:    # full, or one of them was forgotten, by another thread in this moment
            return
        self._learnt += 1
        self._compare()
        self._assign()

    def _new_id(self) -> str:
        while True:
            person_id = self._ids.new()
            if person_id not in self.gallery:
                return person_id
