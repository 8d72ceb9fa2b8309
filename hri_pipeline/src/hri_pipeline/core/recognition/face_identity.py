"""The identity of one tracked face over time: its templates, who it is taken for, and who gets whom when several faces
may be the same person.

Whether a face lives, or is a picture of somebody: mouth, eyes and the turning of the head change the shape of a face
mesh all the time; that of a picture changes by the noise of the image only, however the camera pans.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import AbstractSet, Deque, Dict, List, Mapping, Optional, Sequence, Set, Tuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from hri_pipeline.core.faces.crops import MotionBlur
from hri_pipeline.core.image_rotation import ImageRotation
from hri_pipeline.core.recognition.likelihood import MatchResult, PersonCandidate

MAX_CROPS = 8
"""Templates that are kept of one face: the newest ones."""
SWAP_CROPS = 3
"""When this number of templates in a row contradicts the earlier ones, the tracker has moved to another face."""
ACCEPT, RELEASE = 0.75, 0.5
"""Likelihood from which a face is taken for a person, and below which it no longer is."""
LEARN_AT_ONCE = 0.9
"""Likelihood from which the views of a face with a name are learnt at once. Those of a less sure one are learnt when it
has left: compared with its own views, who is only like a person would be sure to be that person."""
NAMING_CROPS = 2
"""Templates without which no face is taken for a person: one may be of a moment's chance likeness."""
LEAST_PUBLISHED, MOST_UNSURE = 0.1, 0.45
"""Least likelihood of a candidate that is published, and the largest one of somebody that a face is not taken for."""
DOUBT_STEP, DOUBT_LIMIT = 3.0, 4.0
"""Largest part of one view in the doubt of a name (logarithm of odds), and the doubt at which the name is taken back.
So one view never does it, and two that are plainly of somebody else always do."""
CHANGE = 0.05
"""Least change of a likelihood that is published."""
HOLD = 1.0
"""A face takes a person over from another face only when the logarithm of its odds is larger by this much."""
CONTEST = 3.0
"""Largest part of the first template in the logarithm of odds where several faces may be one person: what was learnt
later may be of the wrong one of them. So it decides between likelihoods of .75 and .99, and not alone."""
FIRST_INTERVAL, NAMED_INTERVAL, LONGEST_INTERVAL = 0.25, 1.0, 5.0
"""Time (s) between two crops of a face at first or in doubt, and after many of one that has a name, or has none: a name
that is wrong must be noticed soon."""
CALM_RATE, CALM_INTERVAL = 5.0, 1.8
"""Most templates a second of all faces together whose name is sure, and the longest time (s) between two of one of
them: soon enough that the tracker, which checks each face once in 3 s, needs none of its own."""
TURN_S = 0.5
"""Time (s) added to the intervals where faces wait for their turn, so that who is new comes some three times as often
as who is known."""
DOUBT_LOOKS = 2
"""For how many looks a doubt has its turn first: so many take a wrong name back. Doubts of faces that are seen badly go
on, and would keep everybody else waiting."""
PATIENCE = 4
"""Crops of a recognised face after which the next ones come less and less often; of another one: twice as many."""
TOGETHER = 0.5
"""Faces seen within this time (s) are present at the same time: not every face is measured in every image."""
BESIDE = 1.0
"""Time (s) for which two faces are seen together before they are two people: a track may outlast its face."""
BETTER = 0.15
"""A crop whose quality exceeds the best one so far by this much gets a template early."""
LEARN_CROPS, LEARN_QUALITY = 4, 0.5
"""How many crops of which quality show a face well enough to make a person of it."""
NOT_LEARNT = 0.98 * LEARN_QUALITY
"""Most quality of a crop with dark glasses, or blurred by motion: enough to find somebody known. Of 25 people who were
learnt with drawn glasses 4 to 9 got a second id without them, of 25 who were learnt blurred 19 to 24 when sharp."""
SHAPE_WINDOW_S, SHAPE_PERIOD_S = 6.0, 0.2
"""Time (s) over which shapes are compared, and the least between two of them."""
LEAST_SHAPES = 20
STILL_SHAPE = 0.015
"""RMS change of a shape, as a share of its size, below which a face may be a picture. Measured: pictures in noise 0.003
to 0.010, seven films of people who speak or grimace 0.022 to 0.14."""
LIVING_RATIO = 3.0
"""By how much more a living face moves than the picture beside it."""
_MESH_STRIDE = 8


class FaceMotion:
    """The shapes of one face over the last seconds."""

    def __init__(self) -> None:
        self._shapes: Deque[Tuple[float, np.ndarray]] = deque()

    def add(self, mesh: np.ndarray, stamp: float) -> None:
        """Take the mesh (N, 2 or 3), px, of the image at `stamp` (s)."""
        if self._shapes and 0.0 <= stamp - self._shapes[-1][0] < SHAPE_PERIOD_S:
            return
        points = np.asarray(mesh[::_MESH_STRIDE, :2], dtype=np.float64)
        points = points - points.mean(axis=0)
        size = float(np.sqrt((points ** 2).sum(axis=1).mean()))
        if not 0.0 < size < np.inf:
            return
        self._shapes.append((stamp, points / size))
        while not 0.0 <= stamp - self._shapes[0][0] <= SHAPE_WINDOW_S:
            self._shapes.popleft()

    def turn(self, rotation: ImageRotation) -> None:
        """Turn with the images: the face has not moved."""
        self._shapes = deque((stamp, shape @ rotation.matrix[:2, :2].T) for stamp, shape in self._shapes)

    def change(self) -> Optional[float]:
        """Return the RMS change of the shape, as a share of its size; None before it was seen for long enough."""
        if len(self._shapes) < LEAST_SHAPES:
            return None
        shapes = np.array([shape for _, shape in self._shapes])
        return float(np.sqrt(((shapes - shapes.mean(axis=0)) ** 2).sum(axis=2).mean()))

    def is_picture_beside(self, other: FaceMotion) -> bool:
        """Tell whether this is the picture and `other` lives, where one is known to be a picture of the other."""
        own, living = self.change(), other.change()
        return own is not None and living is not None and own < STILL_SHAPE and living > LIVING_RATIO * own


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
    spread : typical distance of two templates of one face that are independent of each other.
    """

    def __init__(self, contradiction: float, spread: float) -> None:
        self._contradiction, self._spread = contradiction, spread
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

    @property
    def views(self) -> float:
        """How many independent views the templates are worth: n^2 over the sum of their correlations.

        Two templates whose distance is `spread` are independent, two that are the same count as one: a face that does
        not move shows the same view again and again. It is the effective sample size of a mean (Kish 1965, "Survey
        Sampling").
        """
        if not self._kept:
            return 0.0
        templates = np.stack([one.template for one in self._kept])
        squares = 2.0 - 2.0 * np.einsum("nd,md->nm", templates, templates)
        correlations = np.clip(1.0 - squares / self._spread ** 2, 0.0, 1.0)
        return float(len(templates) ** 2 / correlations.sum())

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
        self._average()
        return True

    def restart(self, templates: Sequence[FaceTemplate]) -> None:
        """Go on with these templates only: those before were of somebody else."""
        self._kept = deque(templates, maxlen=MAX_CROPS)
        self._contradicting = []
        self.swaps += 1
        self._average()

    def _average(self) -> None:
        weighted = np.sum([one.quality * one.template for one in self._kept], axis=0)
        length = float(np.linalg.norm(weighted))
        self._mean = (weighted / length).astype(np.float32) if length > 0.0 else self._kept[-1].template

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


class NameDoubt:
    """Whether the views of a face speak against the name that it has: a cumulative sum of the logarithms of their odds
    (Page 1954, "Continuous inspection schemes"). Views that fit make up for earlier doubts, and for no later ones.
    """

    def __init__(self) -> None:
        self.level = 0.0
        self.views: List[FaceTemplate] = []
        """The templates since the doubt began."""

    @property
    def is_enough(self) -> bool:
        """Whether the name has to be taken back."""
        return self.level >= DOUBT_LIMIT

    def add(self, one: FaceTemplate, log_odds: float) -> None:
        """Add a view; log_odds: of the view alone, that it is of the person named."""
        self.level = _doubted(self.level, log_odds)
        self.views = (self.views + [one])[-MAX_CROPS:] if self.level > 0.0 else []

    def clear(self) -> None:
        """Doubt nothing."""
        self.level, self.views = 0.0, []


def _doubted(level: float, log_odds: float) -> float:
    """Return the doubt after a view; level: before it, log_odds: see NameDoubt.add."""
    return max(0.0, level - min(max(log_odds, -DOUBT_STEP), DOUBT_STEP))


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
    last_seen, cropped : times (s) of the last image with the face, and of the last crop.
    passed_over : time (s) of the last crop that was too blurred for a template.
    is_covered : the last crop did not show nose and mouth, so it made no template.
    has_dark_glasses : its eyes were behind dark glasses in the last crop.
    is_smeared : the last crop was blurred by motion, as far as it tells that by itself.
    open : time (s) of the last crop of which it was asked, and that showed them.
    crops : number of crops so far.
    person : id of the person it is taken for, empty when that is not known.
    barred : its person was forgotten, so it is not learnt again.
    doubt : of the person it is taken for.
    refuted : ids of persons it was taken for and is no longer: no candidates until it is taken for them again.
    apart : by id of a person that it is not, as that person was seen beside it: the face that was that person then.
    beside : by id of another face, the time (s) since when both are seen.
    result : of the last comparison with the gallery, None before the first one.
    published : likelihood by person, as last published.
    denied : ids of persons that it was told not to be, though nothing was published of them.
    unlike : by id of a person that it might be, the doubt (see NameDoubt) of its views while it had no name.
    motion : how its shape changes.
    blur : whether a crop is blurred by motion.
    is_picture : it is a picture of the person beside it, so it is nobody.
    later_view : template (D,) that is learnt of the person once the face has left, None without one.
    learnt_after : the comparison after which its mean was offered to the gallery.
    named_interval : time (s) between two crops after many of them while it has a name.
    """

    id: str
    evidence: FaceEvidence
    last_seen: float
    cropped: float = -math.inf
    passed_over: float = -math.inf
    is_covered: bool = False
    has_dark_glasses: bool = False
    is_smeared: bool = False
    open: float = -math.inf
    crops: int = 0
    person: str = ""
    barred: bool = False
    doubt: NameDoubt = field(default_factory=NameDoubt)
    refuted: Set[str] = field(default_factory=set)
    apart: Dict[str, str] = field(default_factory=dict)
    beside: Dict[str, float] = field(default_factory=dict)
    result: Optional[MatchResult] = None
    published: Dict[str, float] = field(default_factory=dict)
    denied: Set[str] = field(default_factory=set)
    unlike: Dict[str, float] = field(default_factory=dict)
    motion: FaceMotion = field(default_factory=FaceMotion)
    blur: MotionBlur = field(default_factory=MotionBlur)
    is_picture: bool = False
    later_view: Optional[np.ndarray] = None
    learnt_after: Optional[MatchResult] = None
    named_interval: float = NAMED_INTERVAL

    @property
    def is_certain(self) -> bool:
        """Whether it has a name that nothing speaks against."""
        return bool(self.person) and self.doubt.level == 0.0

    @property
    def is_sure(self) -> bool:
        """Whether that name is likely enough to learn of it at once."""
        return self.is_certain and any(one.person_id == self.person and one.likelihood >= LEARN_AT_ONCE
                                       for one in self.candidates)

    @property
    def candidates(self) -> Sequence[PersonCandidate]:
        """Whom it may be, likeliest first."""
        return self.result.candidates if self.result is not None else ()

    def is_there(self, now: float) -> bool:
        """Return whether the face was seen just before `now` (s)."""
        return now - self.last_seen <= TOGETHER

    @property
    def is_unlike_itself(self) -> bool:
        """Whether nothing is learnt of the last crop."""
        return self.has_dark_glasses or self.is_smeared

    def usable(self, quality: float) -> float:
        """Return the quality of a crop as it counts: too little to learn of it with dark glasses, or where it is
        blurred."""
        return min(quality, NOT_LEARNT) if self.is_unlike_itself else quality

    def interval(self, quality: float) -> float:
        """Return the time (s) to the next crop, of this quality: short while there is something to decide, and for one
        that shows better who it is than those before; ever longer later."""
        quality = self.usable(quality)
        lacks_good = not self.person and self.evidence.good(LEARN_QUALITY) < LEARN_CROPS
        is_better = quality > self.evidence.best_quality + BETTER or (lacks_good and quality >= LEARN_QUALITY)
        if (self.doubt.level > 0.0 or is_better) and not self.is_covered:
            return FIRST_INTERVAL
        patience = PATIENCE if self.person or self.is_covered else 2 * PATIENCE
        is_to_change = self.is_covered or self.is_unlike_itself
        longest = self.named_interval if self.person or is_to_change else LONGEST_INTERVAL
        return float(min(FIRST_INTERVAL * 1.5 ** min(50, max(0, self.crops - patience)), longest))

    def is_due(self, quality: float, stamp: float) -> bool:
        """Return whether a crop of this quality is worth a template at `stamp` (s)."""
        return stamp >= self.cropped + self.interval(quality)

    def lateness(self, quality: float, stamp: float) -> float:
        """Return how long it has waited at `stamp` (s), in its own intervals: who is new comes before those who are
        known, a name that has come into doubt before both, and who is blurred lets the others have their turn."""
        turn = 0.0 if 0 < len(self.doubt.views) <= DOUBT_LOOKS else TURN_S
        return (stamp - max(self.cropped, self.passed_over)) / (turn + self.interval(quality))

    def note_crop(self, stamp: float, again: bool) -> None:
        """Note a crop at `stamp` (s). again: it shows somebody else, so the next crops come soon."""
        self.crops = 1 if again or self.is_covered else self.crops + 1
        self.cropped, self.is_covered = stamp, False
        self.result = None

    def note_covered(self, stamp: float) -> None:
        """Note a crop at `stamp` (s) without nose and mouth: the next ones come less and less often."""
        self.crops = self.crops + 1 if self.is_covered else 1
        self.cropped, self.is_covered = stamp, True

    def take(self, template: FaceTemplate, log_odds: Optional[float]) -> None:
        """Add a template; log_odds: of this view alone, that it is of the person named, None without a name.

        Where the views speak against the name, it is taken back, and only the views since then count.
        """
        swaps = self.evidence.swaps
        agrees = self.evidence.add(template)
        if log_odds is not None:
            self.doubt.add(template, log_odds)
            if self.doubt.is_enough:
                self.evidence.restart(self.doubt.views)
                self.refuted.add(self.person)
                self.person = ""
                self.later_view = None
                self.denied.clear()
        swapped = self.evidence.swaps != swaps
        if swapped:
            self.barred = False
            self.denied.clear()
            self.unlike.clear()
            self.apart.clear()
            self.beside.clear()
            self.doubt.clear()
        self.note_crop(template.stamp, again=swapped or not agrees)

    def note_unlike(self, log_odds: Mapping[str, float]) -> None:
        """Note by id of persons the logarithm of the odds of the last view alone, that it is of that person."""
        self.unlike = {person: _doubted(self.unlike.get(person, 0.0), value) for person, value in log_odds.items()}

    def is_unlike(self, person_id: str) -> bool:
        """Whether the views speak against a person as clearly as against a name that is taken back."""
        return self.unlike.get(person_id, 0.0) >= DOUBT_LIMIT

    def forget(self) -> None:
        """Drop all templates; it is nobody new from now on."""
        self.evidence.clear()
        self.doubt.clear()
        self.later_view = None
        self.barred = True

    def holds(self, taken: AbstractSet[str]) -> Dict[str, float]:
        """Return likelihood by person: the person it is taken for, else the candidates that are not in `taken`."""
        likely = {one.person_id: round(one.likelihood, 3) for one in self.candidates}
        if self.person:
            return {self.person: likely[self.person]}
        if self.is_picture:
            return {}
        no_more = taken | self.refuted | self.apart.keys()
        return {person_id: min(likelihood, MOST_UNSURE) for person_id, likelihood in likely.items()
                if likelihood >= LEAST_PUBLISHED and person_id not in no_more}

    def decide(self, best: Optional[PersonCandidate]) -> None:
        """Take the face for `best`, the candidate it was given, if that is sure enough."""
        before = self.person
        enough = RELEASE if best is not None and best.person_id == before else ACCEPT
        is_sure = best is not None and best.likelihood >= enough and len(self.evidence) >= NAMING_CROPS
        self.person = best.person_id if is_sure and best is not None else ""
        if self.person != before:
            self.later_view = self.learnt_after = None
            self.doubt.clear()
            self.unlike.clear()
            self.refuted.discard(self.person)
            if before:
                self.refuted.add(before)

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


def share_templates(faces: Sequence[FaceIdentity], newest: float) -> None:
    """Let the faces seen at `newest` (s) whose name is sure share CALM_RATE; a few of them lose nothing."""
    sure = {face.id for face in faces if face.is_there(newest) and face.is_sure}
    shared = min(max(NAMED_INTERVAL, len(sure) / CALM_RATE), CALM_INTERVAL)
    for face in faces:
        face.named_interval = shared if face.id in sure else NAMED_INTERVAL


def _assigned(faces: Sequence[FaceIdentity], taken: AbstractSet[str]) -> List[Optional[PersonCandidate]]:
    """Return a candidate or None for each face: no person twice, none of `taken`, with the largest total of log odds.

    It is the linear assignment problem (Kuhn 1955, "The Hungarian method for the assignment problem").
    """
    options = [{one.person_id: one for one in (() if face.is_picture else face.candidates)
                if one.likelihood >= LEAST_PUBLISHED and one.person_id not in taken
                and one.person_id not in face.apart} for face in faces]
    columns = {name: column for column, name in enumerate(sorted(set().union(*options)))} if options else {}
    if not columns:
        return [None] * len(faces)
    worth, least = np.zeros((len(faces), len(columns))), _log_odds(LEAST_PUBLISHED)
    firsts = _best_firsts(options)
    for row, (face, option) in enumerate(zip(faces, options)):
        for name, one in option.items():
            # The sum of logarithms of odds: the assignment that is likeliest as a whole.
            worth[row, columns[name]] = (_log_odds(one.likelihood) - least + HOLD * (name == face.person)
                                         - min(CONTEST, max(0.0, firsts.get(name, one.first) - one.first)))
    names = list(columns)
    chosen: List[Optional[PersonCandidate]] = [None] * len(faces)
    for row, column in zip(*linear_sum_assignment(worth, maximize=True)):
        chosen[row] = options[row].get(names[column])
    return chosen


def _best_firsts(options: Sequence[Mapping[str, PersonCandidate]]) -> Dict[str, float]:
    """Return by person the largest odds by the first template of those faces that are rather that person than not."""
    result: Dict[str, float] = {}
    for option in options:
        for name, one in option.items():
            if one.likelihood >= RELEASE:
                result[name] = max(one.first, result.get(name, -math.inf))
    return result


def _log_odds(likelihood: float) -> float:
    return math.log(likelihood / (1.0 - likelihood))


def assign_persons(faces: Sequence[FaceIdentity], newest: float) -> None:
    """Decide who each face is: nobody is two faces; faces present at `newest` (s) are assigned before the others."""
    taken: set = set()
    for group in ([face for face in faces if face.is_there(newest)],
                  [face for face in faces if not face.is_there(newest)]):
        chosen = _assigned(group, taken)
        for face, one in zip(group, chosen):
            face.decide(one)
        taken.update(one.person_id for one in chosen if one is not None)


def note_pictures(faces: Sequence[FaceIdentity], newest: float, different: float) -> None:
    """Note which faces are pictures: those with the name of a living one beside them, at `newest` (s), that is as like
    that person; until they move.

    different : distance from which on two faces are not one human's.
    """
    there = [face for face in faces if face.is_there(newest)]
    for face in there:
        face.is_picture = face.is_picture and not (face.motion.change() or 0.0) > STILL_SHAPE
        if not face.person:
            continue
        for other in there:
            is_alike = face.person not in other.apart and any(
                one.person_id == face.person and one.likelihood >= ACCEPT for one in other.candidates)
            if is_alike and not other.person and not are_different(face, other, different) and (
                    face.motion.is_picture_beside(other.motion)):
                face.is_picture = True


def note_beside(faces: Sequence[FaceIdentity], newest: float, different: float) -> List[Tuple[str, str]]:
    """Note which faces are seen beside each other at `newest` (s); returns pairs of ids of persons who are two people.

    A face that was beside a named one for BESIDE is not that person, now and after the other has left. Two views of one
    face (a mirror, a second detection) are no two people: faces nearer to each other than `different` do not count.
    """
    there = [(face, mean) for face, mean in ((face, face.evidence.mean()) for face in faces if face.is_there(newest))
             if mean is not None]
    ids = {face.id for face, _ in there}
    pairs: List[Tuple[str, str]] = []
    for face in faces:
        face.beside = {other: since for other, since in face.beside.items() if face.id in ids and other in ids}
    if len(there) < 2:
        return pairs
    means = np.stack([mean for _, mean in there])
    different_people = (np.linalg.norm(means[:, None] - means, axis=2) >= different).tolist()
    for index, (face, _) in enumerate(there):
        for (other, _), are_two in zip(there[:index], different_people[index]):
            since = face.beside.setdefault(other.id, newest)
            other.beside[face.id] = since
            if newest - since < BESIDE or not are_two:
                continue
            for one, two in ((face, other), (other, face)):
                if one.is_certain and one.person != two.person:
                    two.apart.setdefault(one.person, one.id)
            if face.is_certain and other.is_certain:
                pairs.append((face.person, other.person))
    return pairs


def are_different(face: FaceIdentity, other: FaceIdentity, limit: float) -> bool:
    """Return whether the templates of two faces are at least `limit` apart."""
    first, second = face.evidence.mean(), other.evidence.mean()
    return first is not None and second is not None and float(np.linalg.norm(first - second)) >= limit


def _differ(likelihood: float, before: float) -> bool:
    return abs(likelihood - before) >= CHANGE or (likelihood >= ACCEPT) != (before >= ACCEPT)
