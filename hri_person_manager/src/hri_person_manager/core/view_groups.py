"""What each sensor sees of each human, and which of these views are one human: the book-keeping of `cross_camera`.

A `View` is what one sensor sees of one human: a face, a body, or both. A `ViewGroup` is one or more views that are one
human. Views that one sensor has had at the same time are two humans; so are two to whom the recogniser of one sensor
gave different names, or of whom it says that one is not the other. (Recognisers that do not share a gallery give one
human several names.)
"""

from __future__ import annotations

import functools
import itertools
import math
from collections import OrderedDict
from dataclasses import dataclass
from types import MappingProxyType
from typing import AbstractSet, Dict, FrozenSet, Iterable, List, Mapping, NamedTuple, Optional, Sequence, Set, Tuple

import numpy as np

from hri_person_manager.core.features import Kind, MatchNode
from hri_person_manager.core.triangulation import (
    FRESH_S,
    Estimate,
    Scale,
    SensorTrack,
    fuse_tracks,
    place_by_track,
)
from hri_pipeline.core.tracks import COLOUR_BINS, mean_colours

OVERLAP_S = 0.2            # two views of one sensor that were there at once for so long are two humans
# Deviations of the mean colours (8-bit L*a*b*) of the parts of one human between two cameras: one that all parts share
# (exposure, white balance), and one of each part (the side that is seen). Of two people: that of clothes, of which
# the share SUIT is common to all parts of one. The errors of the parts are not independent, and a light changes dark
# clothes less: only the share CLOTHES_TRUST of the logarithm of the likelihood ratio counts. Without any shared light
# fewer are kept than by the distance of the histograms.
CAMERA_COLOUR, PART_COLOUR = np.array([28.0, 9.0, 9.0]), np.array([20.0, 5.0, 5.0])
CLOTHES_COLOUR, SUIT, CLOTHES_TRUST = np.array([60.0, 10.0, 10.0]), 0.4, 0.35
# Dark clothes of little colour are the commonest: up to this lightness and this far from grey, two people's differ by
# so little, and each part of them speaks for two people by this logarithm (sleeves are mostly like the chest).
COMMON_LIGHT, COMMON_TINT, COMMON_COLOUR, COMMON_COST = 110.0, 14.0, np.array([20.0, 5.0, 5.0]), -0.3
LEAST_CLOTHES, MOST_CLOTHES = -4.0, 2.5
MAX_SENSORS = 50
MAX_NAMES = 1000
_NOBODY: FrozenSet[str] = frozenset()
_UNKNOWN = np.empty((0, 0))
Pair = FrozenSet[int]


class SensedGroup(NamedTuple):
    """What the manager knows of features that belong together.

    person: whose they are, empty while that is nobody. names: who recognisers say that it is, doubted: and who not.
    """

    features: FrozenSet[MatchNode]
    person: str
    names: FrozenSet[str] = frozenset()
    doubted: FrozenSet[str] = frozenset()


class View:
    """What one sensor sees of one human.

    person: who it is in the table. names, doubted: of whom that is said, and denied, now; called: the last names, also
    while nobody says one, as when a face is lost and the body goes on.
    """

    def __init__(self, number: int, sensor: str) -> None:
        self.number, self.sensor = number, sensor
        self.tracks: Dict[MatchNode, SensorTrack] = {}
        self.person = ""
        self.names = self.doubted = self.called = _NOBODY
        self.began = math.inf

    @property
    def best(self) -> SensorTrack:
        """The track that places the human: of the best source that is fresh, else the newest."""
        best, *others = self.tracks.values()
        if others:
            oldest = self.ended - FRESH_S
            for track in others:
                fresh, known = track.ended >= oldest, best.ended >= oldest
                if (not fresh, track.source, -track.ended) < (not known, best.source, -best.ended):
                    best = track
        return best

    @property
    def heads(self) -> List[SensorTrack]:
        """The fresh tracks that place the head, or else the best one: a face and a body are not wrong by the same."""
        if len(self.tracks) < 2:
            return [self.best]
        oldest = self.ended - FRESH_S
        return [track for track in self.tracks.values() if track.source < 2 and track.ended >= oldest] or [self.best]

    @property
    def ended(self) -> float:
        """Stamp of the newest place, s."""
        newest = -math.inf
        for track in self.tracks.values():
            newest = max(newest, track.ended)
        return newest

    @property
    def slots(self) -> Set[Tuple[str, Kind]]:
        """Sensor and kinds of the features: a human has one of each."""
        return {(self.sensor, feature.kind) for feature in self.tracks}

    def at(self, stamp: float, scales: Mapping[Tuple[str, int], Scale] = MappingProxyType({})) -> Estimate:
        """Where the human is at a time (s) near the newest place, by this view; scales: what was learnt of this human
        by sensor and source."""
        return place_by_track(self.best, stamp, scales)


class LastSighting(NamedTuple):
    """The last sight of a human: its stamp (s), the best tracks by sensor, the tracks of the view that ended last, and
    what scales were learnt."""

    stamp: float
    best: Mapping[str, SensorTrack]
    tracks: Tuple[SensorTrack, ...]
    scales: Mapping[Tuple[str, int], Scale]

    @property
    def place(self) -> Optional[Estimate]:
        """Where it was by all sensors, where these are several."""
        if len(self.best) < 2 and not self.scales:
            return None
        return fuse_tracks(list(self.best.values()), self.stamp, self.scales)


class ViewGroup:
    """Views that are one human, and who that was so far.

    persons: ids of persons of the table that this human is or was. scales: by sensor and source of the
    place. seen: stamp of the newest place by sensor, s. lost: how it was when the last view ended. fused: where it was
    by all views, and when (s).
    """

    def __init__(self, number: int, view: View) -> None:
        self.number, self.views = number, [view]
        self.persons: "OrderedDict[str, None]" = OrderedDict()
        self.names = _NOBODY
        self.scales: Dict[Tuple[str, int], Scale] = {}
        self.seen: Dict[str, float] = {}
        self.lost: Optional[LastSighting] = None
        self.fused: Optional[Tuple[float, Estimate]] = None

    @property
    def slots(self) -> Set[Tuple[str, Kind]]:
        """Sensor and kinds of all features."""
        return {slot for view in self.views for slot in view.slots}

    @property
    def tracks(self) -> List[SensorTrack]:
        """What all views are made of."""
        return [track for view in self.views for track in view.tracks.values()]

    @property
    def sensors(self) -> Set[str]:
        """Sensors that see it."""
        return {view.sensor for view in self.views}


@dataclass
class PairDistance:
    """Smoothed squared distance of a pair, since when (s) it is near, likely or far, and when it was compared (s)."""

    square: float
    since: float
    stamp: float
    near: bool
    likely_since: float = math.inf


class ViewGroups:
    """All views and groups of views, and what is known of who cannot be one human.

    tracks: of each feature. view_of: by feature. group_of: by number of the view. all: by number of the group; one
    without a view is somebody whom all have lost. near, apart: how near pairs of groups are, and views to the rest of
    their group. two: by group, which others are not the same human. parted: pairs of persons that a user has parted.
    kept: links of groups that are gone. strangers: pairs of persons whom a recogniser has told apart in one view.
    namers: which recognisers know somebody by a name. explained: groups that each group may be. likely: views that are
    most likely of a group, too.
    """

    def __init__(self) -> None:
        self.tracks: Dict[MatchNode, SensorTrack] = {}
        self.view_of: Dict[MatchNode, View] = {}
        self.group_of: Dict[int, ViewGroup] = {}
        self.all: Dict[int, ViewGroup] = {}
        self.near: Dict[Pair, PairDistance] = {}
        self.apart: Dict[int, PairDistance] = {}
        self.two: Dict[int, Set[int]] = {}
        self.sensors: Set[str] = set()
        self.named_by: "OrderedDict[str, Set[str]]" = OrderedDict()
        self.kept: "OrderedDict[FrozenSet[str], None]" = OrderedDict()
        self.parted: AbstractSet[FrozenSet[str]] = frozenset()
        self.strangers: "OrderedDict[FrozenSet[str], None]" = OrderedDict()
        self.namers: "OrderedDict[str, Set[str]]" = OrderedDict()
        self.explained: Dict[int, Set[int]] = {}
        self.likely: Dict[int, List[View]] = {}
        self._numbers = itertools.count()

    def track(self, feature: MatchNode, sensor: str) -> Optional[SensorTrack]:
        """The track of a feature, a new one where another sensor sees it now; None when there are too many sensors."""
        if sensor not in self.sensors:
            if len(self.sensors) >= MAX_SENSORS:
                return None
            self.sensors.add(sensor)
        track = self.tracks.get(feature)
        if track is None or track.sensor != sensor:
            track = self.tracks[feature] = SensorTrack(sensor)
            view = self.view_of.pop(feature, None)
            if view is not None:
                view.tracks.pop(feature, None)
        return track

    def views(self) -> List[View]:
        """All views."""
        return [view for human in self.all.values() for view in human.views]

    # ----- who belongs together at one sensor

    def regroup(self, groups: Iterable[SensedGroup]) -> None:
        """Make the views anew; a view goes on as long as one of its features does, and with its face."""
        groups = tuple(groups)
        taken: Set[int] = set()
        seen: Set[MatchNode] = set()
        faces = {feature for group in groups for feature in group.features if feature.kind == Kind.FACE}
        for group in groups:
            by_sensor: Dict[str, List[MatchNode]] = {}
            for feature in sorted(group.features):
                if feature in self.tracks:
                    by_sensor.setdefault(self.tracks[feature].sensor, []).append(feature)
            for sensor, features in by_sensor.items():
                going_on = {view.number: view for view in map(self.view_of.get, features) if view is not None
                            and view.number not in taken and faces.intersection(view.tracks) <= group.features}
                view = self._view_for(sensor, features, going_on, group)
                taken.add(view.number)
                seen.update(features)
                view.person, view.names, view.doubted = group.person, group.names, group.doubted
                view.called = group.names or view.called
        for feature in [feature for feature in self.tracks if feature not in seen]:
            del self.tracks[feature]
            before = self.view_of.pop(feature, None)
            if before is not None:
                before.tracks.pop(feature, None)
        for view in self.views():
            if not view.tracks:
                self._remove(view)

    def _view_for(self, sensor: str, features: List[MatchNode], known: Mapping[int, View], group: SensedGroup) -> View:
        """Return the view of these features of a group: of those known, by number, all as one, else a new one."""
        view = known[min(known)] if known else View(next(self._numbers), sensor)
        if not known:
            self.all[view.number] = self.group_of[view.number] = ViewGroup(view.number, view)
        for one in known.values():
            if one.called and (not one.called & group.names if group.names else one.called <= group.doubted):
                self._begin_anew(one, group.names)      # it is somebody else after all
        for number in sorted(known)[1:]:
            self.unite(self.group_of[view.number], self.group_of[number])
        for feature in features:
            before = self.view_of.get(feature)
            if before is not None and before is not view:
                before.tracks.pop(feature, None)
            self.view_of[feature] = view
            view.tracks[feature] = self.tracks[feature]
        for feature in [feature for feature in view.tracks if feature not in features]:
            del view.tracks[feature]
            if self.view_of.get(feature) is view:
                del self.view_of[feature]
        view.began = min([view.began] + ([] if known else [track.began for track in view.tracks.values()]))
        return view

    def _remove(self, view: View) -> None:
        human = self.group_of.pop(view.number)
        human.views.remove(view)
        self.apart.pop(view.number, None)
        told = [number for number in self.explained.get(human.number, ()) if number in self.all
                and self.all[number].persons]
        if not human.views and (human.lost is None or not human.persons or told):
            self.drop(human)       # nobody was told of it, or it was somebody who is still there

    def drop(self, human: ViewGroup) -> None:
        """Forget a group; the links of its persons are kept."""
        first, *others = human.persons or [""]
        self.kept.update(dict.fromkeys(frozenset((first, other)) for other in others))
        self.all.pop(human.number, None)
        for number in self.two.pop(human.number, ()):
            self.two[number].discard(human.number)
        self.near = {pair: near for pair, near in self.near.items() if human.number not in pair}

    def unite(self, human: ViewGroup, other: ViewGroup) -> None:
        """Make one human of two, whatever is known of them."""
        if human is other:
            return
        if other.persons and other.number < human.number:
            human, other = other, human
        for view in other.views:
            self.group_of[view.number] = human
        human.views += other.views
        human.persons.update(other.persons)
        human.scales = {**other.scales, **human.scales}
        human.seen = {**other.seen, **human.seen}
        human.names |= other.names
        for number in self.two.get(other.number, set()) - {human.number}:
            self.note_pair(human.number, number)
        if human.views:
            human.lost = None
        other.persons.clear()
        self.drop(other)

    def take_out(self, view: View) -> None:
        """Make a human of its own of a view."""
        human = self.group_of[view.number]
        if len(human.views) < 2:
            return
        human.views.remove(view)
        new = ViewGroup(next(self._numbers), view)
        self.all[new.number] = self.group_of[view.number] = new
        human.scales = {key: scale for key, scale in human.scales.items() if key[0] != view.sensor}
        human.seen.pop(view.sensor, None)
        new.names = view.names
        human.names = frozenset().union(*(one.names for one in human.views))
        if view.person:
            human.persons.pop(view.person, None)
        self.apart.pop(view.number, None)

    def _begin_anew(self, view: View, names: FrozenSet[str]) -> None:
        """Let a view be somebody of whom nothing is known but these names."""
        for pair in itertools.product(view.called, names):
            self.strangers[frozenset(pair)] = None
        while len(self.strangers) > MAX_NAMES:
            self.strangers.popitem(last=False)
        view.called = _NOBODY
        human = self.group_of[view.number]
        if len(human.views) > 1:
            self.take_out(view)
            return
        self.drop(human)
        view.began = view.ended
        new = ViewGroup(next(self._numbers), view)
        self.all[new.number] = self.group_of[view.number] = new

    def note_namer(self, name: str, recogniser: str) -> None:
        """Note who calls somebody so."""
        self.namers.setdefault(name, set()).add(recogniser)
        self.namers.move_to_end(name)
        while len(self.namers) > MAX_NAMES:
            self.namers.popitem(last=False)

    def take_names(self, before: ViewGroups) -> None:
        """Take over what is known of persons, whoever sees them."""
        self.named_by, self.namers, self.strangers = before.named_by, before.namers, before.strangers
        self.kept = before.kept

    def _are_strangers(self, first: str, second: str) -> bool:
        """Tell whether a recogniser has told two persons apart, or knows both."""
        return frozenset((first, second)) in self.strangers or bool(
            self.namers.get(first, _NOBODY) & self.namers.get(second, _NOBODY))

    def without_strangers(self, pairs: Iterable[FrozenSet[str]]) -> Dict[FrozenSet[str], None]:
        """Return the pairs of persons that join no two whom a recogniser has told apart, over others neither; the first
        pairs go before the others."""
        kept: Dict[FrozenSet[str], None] = {}
        joined: Dict[str, Set[str]] = {}
        for pair in pairs:
            one, other = (joined.setdefault(person, {person}) for person in sorted(pair))
            if one is not other:
                if any(self._are_strangers(*both) for both in itertools.product(one, other)):
                    continue
                one |= other
                joined.update(dict.fromkeys(other, one))
            kept[pair] = None
        return kept

    def part(self, first: str, second: str) -> None:
        """Make two humans of two persons, as a user has: who is parted from more of the others goes."""
        for human in list(self.all.values()):
            if first in human.persons and second in human.persons:
                parted = {one: sum(frozenset((one, other)) in self.parted for other in human.persons)
                          for one in (second, first)}
                gone = max(parted, key=parted.__getitem__)
                for view in [view for view in human.views if view.person == gone]:
                    self.take_out(view)
                human.persons.pop(gone, None)

    # ----- who are two

    def note_names(self, live: Iterable[View]) -> None:
        """Remember at which sensors each name is given."""
        for view in live:
            for name in view.names:
                self.named_by.setdefault(name, set()).add(view.sensor)
        while len(self.named_by) > MAX_NAMES:
            self.named_by.popitem(last=False)
        for human in self.all.values():
            if human.views:
                human.names = frozenset().union(*(view.names for view in human.views))

    def note_two(self, live: List[View]) -> None:
        """Remember the humans that one sensor sees at the same time."""
        views: Dict[str, Dict[int, List[View]]] = {}
        for view in live:
            views.setdefault(view.sensor, {}).setdefault(self.group_of[view.number].number, []).append(view)
        for there in views.values():
            for one, own in there.items():
                for other in there.keys() - self.two.get(one, set()) - {one}:
                    if one < other and any(_overlap(*both) for both in itertools.product(own, there[other])):
                        self.note_pair(one, other)

    def note_pair(self, one: int, other: int) -> None:
        """Remember of two groups, by number, that they are two humans."""
        self.two.setdefault(one, set()).add(other)
        self.two.setdefault(other, set()).add(one)

    def have_other_names(self, first: FrozenSet[str], second: FrozenSet[str]) -> bool:
        """Tell whether one sensor's recogniser gives two humans different names."""
        return not first & second and any(
            self.named_by.get(a, _NOBODY) & self.named_by.get(b, _NOBODY) for a in first for b in second)

    def may_be_one(self, one: ViewGroup, other: ViewGroup) -> bool:
        """Tell whether nothing is known that makes two humans of them."""
        if other.number in self.two.get(one.number, ()) or one.slots & other.slots:
            return False
        return not self._are_told_apart(one, other)

    def _are_told_apart(self, one: ViewGroup, other: ViewGroup) -> bool:
        if is_doubted(one.views, other.views) or self.have_other_names(one.names, other.names):
            return True
        return any(frozenset((a, b)) in self.parted for a in one.persons for b in other.persons)

    def possible_pairs(self, humans: Sequence[ViewGroup]) -> np.ndarray:
        """Return which pairs (M, 2), as rows, of many humans may be one."""
        slots = [human.slots for human in humans]
        doubts = [any(view.doubted for view in human.views) for human in humans]
        pairs: List[Tuple[int, int]] = []
        for row, one in enumerate(humans):
            two = self.two.get(one.number, ())
            pairs += [(row, column) for column, other in enumerate(humans[row + 1:], row + 1)
                      if other.number not in two and slots[row].isdisjoint(slots[column])
                      and not ((doubts[row] or doubts[column] or self.parted or one.names and other.names)
                               and self._are_told_apart(one, other))]
        return np.array(pairs, int).reshape(-1, 2)


def _overlap(first: View, second: View) -> bool:
    """Tell whether a sensor has had two of its views, of one kind, at the same time."""
    return bool(first.slots & second.slots) and (
        min(first.ended, second.ended) - max(first.began, second.began) > OVERLAP_S)


def clothes_evidence(tracks: Iterable[SensorTrack], others: Iterable[SensorTrack]) -> float:
    """Return the logarithm of the likelihood ratio of the clothes of these tracks as one human's, against two people's;
    0 where they are not known.

    What two cameras show differently of all parts is more likely their light than what is different of one part.
    """
    return float(evidence_of_pairs([tracks, others], np.array([[0, 1]]))[0])


def evidence_of_pairs(people: Sequence[Iterable[SensorTrack]], pairs: np.ndarray) -> np.ndarray:
    """Return the same (M,) of many pairs (M, 2) of people by their tracks."""
    worn = [next((track.appearance for track in tracks if track.appearance is not None), _UNKNOWN) for tracks in people]
    parts = np.array([len(of) if of.shape[1] == COLOUR_BINS.size else 0 for of in worn])
    evidence = np.zeros(len(pairs))
    for count in set(parts[parts > 0].tolist()):
        known = np.flatnonzero(parts == count)
        colours = np.full((len(worn), count, 3), np.nan)
        colours[known] = mean_colours(np.concatenate([worn[number] for number in known])).reshape(-1, count, 3)
        chosen = np.flatnonzero((parts[pairs] == count).all(axis=1))
        evidence[chosen] = _colour_evidence(colours[pairs[chosen, 0]], colours[pairs[chosen, 1]])
    return evidence


def _colour_evidence(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Logarithms (M,) of the likelihood ratios of mean colours (M, P, 3); NaN where a part is not shown."""
    offsets, middle = other - one, 0.5 * (one + other)
    shown = np.isfinite(middle).all(axis=2)
    with np.errstate(invalid="ignore"):
        common = shown & (middle[..., 0] < COMMON_LIGHT) & (np.abs(middle[..., 1:]) < COMMON_TINT).all(axis=2)
    codes = (shown.astype(int) + common) @ 3 ** np.arange(shown.shape[1])
    evidence = np.zeros(len(one))
    for code in np.unique(codes[codes > 0]):
        alike = np.flatnonzero(codes == code)
        visible = shown[alike[0]]
        weights, constant = _clothes_weights(tuple(common[alike[0], visible].tolist()))
        of = offsets[alike][:, visible].T
        ratio = constant + (of * (weights @ of)).sum(axis=(0, 1))
        evidence[alike] = np.clip(CLOTHES_TRUST * ratio, LEAST_CLOTHES, MOST_CLOTHES)
    return evidence


@functools.lru_cache(maxsize=None)
def _clothes_weights(common: Tuple[bool, ...]) -> Tuple[np.ndarray, float]:
    """Weights (3, N, N) of the products of the offsets of N parts, and the constant, in the logarithm of the likelihood
    ratio of one human against two; common: which parts are dark and of little colour, as those of most people are.

    Under both, the offsets (N, 3) are normal: each has a variance of its own, and all have one in common.
    """
    worn = math.sqrt(2.0) * np.where(np.array(common)[:, None], COMMON_COLOUR, CLOTHES_COLOUR)
    weights, constant = [], COMMON_COST * sum(common)
    for part, camera, clothes in zip(PART_COLOUR, CAMERA_COLOUR, worn.T):
        one = part ** 2 * np.eye(len(common)) + camera ** 2
        two = one + (1.0 - SUIT) * np.diag(clothes ** 2) + SUIT * np.outer(clothes, clothes)
        weights.append(0.5 * (np.linalg.inv(two) - np.linalg.inv(one)))
        constant += 0.5 * float(np.linalg.slogdet(two)[1] - np.linalg.slogdet(one)[1])
    return np.array(weights), constant


def is_doubted(views: List[View], others: List[View]) -> bool:
    """Tell whether a recogniser says of one of these views that it is not who one of the others is."""
    return any(a.doubted & (b.names | {b.person}) for one, two in ((views, others), (others, views))
               for a in one for b in two)


def fuse_views(views: List[View], stamp: float, scales: Mapping[Tuple[str, int], Scale] = MappingProxyType({})
                ) -> Estimate:
    """Where a human is at `stamp` (s) by the best track of each of these views, of heads only, where there are some.
    scales: what was learnt of this human where several crossed."""
    return fuse_tracks([view.best for view in views], stamp, scales)


def place_by_all(views: List[View], stamp: float, scales: Mapping[Tuple[str, int], Scale]) -> Estimate:
    """The same by the face and the head of the body of each view: one's size errs otherwise than the other's, and so do
    their directions."""
    return fuse_tracks([track for view in views for track in view.heads], stamp, scales)
