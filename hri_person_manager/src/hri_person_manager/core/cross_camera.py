"""The same person in the views of several cameras, by rays, time and names.

Views (see `view_groups`) of different sensors are joined when their places agree, as exactly as the rays tell (see
`triangulation`), and when no other way to pair up what both sensors see is nearly as likely. As long as a new view can
be explained by somebody who is known, but not yet by whom, it is *held*: no person is made of it. A human who has left
all views, and a new view that goes on as he walked, are one, too (camera hand-off).
"""

from __future__ import annotations

import itertools
import math
from typing import (
    AbstractSet,
    Callable,
    Container,
    Dict,
    FrozenSet,
    Iterable,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Set,
    Tuple,
)

import numpy as np

from hri_person_manager.core.features import MatchNode
from hri_person_manager.core.sensors import LONGEST_LAG_S
from hri_person_manager.core.triangulation import (
    CHANGED,
    FIXED_VARIANCE,
    FRESH_S,
    LEAST_SQUARE,
    SETTLING_S,
    WALK_S,
    WINDOW_S,
    Estimate,
    Scale,
    crossing_distances,
    ray_covariance,
    squared_distances,
    walk_evidence,
)
from hri_person_manager.core.view_groups import (
    MAX_NAMES,
    OVERLAP_S,
    LastSighting,
    Pair,
    PairDistance,
    SensedGroup,
    View,
    ViewGroup,
    ViewGroups,
    clothes_evidence,
    evidence_of_pairs,
    fuse_views,
    is_doubted,
    place_by_all,
)
from hri_pipeline.core.tracks import best_pairs

LIKELIHOOD = 0.8
GATE = 1.7                 # Mahalanobis distance up to which two places are one,
LOOSE_GATE = 4.0           # and up to which a view may be somebody who is known
STAYS = 1.5                # a pair that was near stays so up to so many times the squared distance
CLEARER_BY = 10.0          # squared distance by which every other pairing has to be worse
LIKELIER_BY = 3.0          # the same, of a pair that is placed together, but not told
LIKELY = 8.0               # squared distance up to which two may be one
UNPAIRED = 20.0            # squared distance that stands for two views that are nobody's else
REFINED = (2.0, 100.0)     # squared distances that are reckoned again
SLOWER = 3.0               # beyond the gate, up to the loose one, so many times as long
PARTING = 2.0              # a human is parted beyond so many times the gate, after so many times the time, of joining
SOONER = 0.3               # of the time, for a human whom the same sensor has just lost, or of the same name or clothes
ALIKE_CLOTHES = 1.5        # logarithm of the likelihood ratio of these
RETURN_S = 3.0             # s after which a sensor has lost somebody for good
ALIKE_MPS = 0.8            # difference of two measured velocities of one human
HOLD_S = 15.0              # s for which a view is held at most
NAME_ALIKE = -6.0          # squared distance that a common name is worth
SAME_MOMENT_S = 0.1        # two places of one image, or of two that follow each other
NEW_S = 2.0                # so long a view counts as new
HANDOVER_EVIDENCE = 1.9    # logarithm of the likelihood ratio from which a new view is a lost human,
HANDOVER_COST = 4.0        # and from which the squared distance of the two, twice what lacks of it, is 0
LOOKING_S = 1.5            # a new view is looked at for so long before it is taken for a lost human
_NO_ORIGIN = np.full(3, np.nan)


class CrossCameraLink(NamedTuple):
    """Two persons that are one human as long as the likelihood is above 0."""

    first: str
    second: str
    likelihood: float


class CrossCamera:
    """Follows what each sensor sees and tells who is one human. Times are stamps of the measurements, s."""

    def __init__(self, distance: float, time: float, handover: float) -> None:
        """Take the limits, see limit()."""
        self.limit(distance, time, handover)
        self._groups = ViewGroups()
        self._told: Set[FrozenSet[str]] = set()
        self._newest = -math.inf
        self._newest_of: Dict[str, float] = {}      # by sensor
        self._before: Dict[FrozenSet[str], None] = {}
        """Links from before a jump of time, until both persons are placed anew, or for FRESH_S."""
        self._jumped = math.inf
        self._returned: Set[Pair] = set()
        self.held: FrozenSet[MatchNode] = frozenset()
        self.due: List[FrozenSet[MatchNode]] = []

    def limit(self, distance: float, time: float, handover: float) -> None:
        """Join persons nearer than `distance` m for `time` s, and the lost with the new for `handover` s; 0: never.

        The distance holds for places whose exactness is not known; a tenth of it is how exact the poses of the cameras
        are.
        """
        self._distance, self._time, self._handover = distance, time, handover

    @property
    def is_idle(self) -> bool:
        """Tell whether fewer than two sensors have placed anybody so far, so that there is nothing to join."""
        return len(self._groups.sensors) < 2

    def covariance(self, position: np.ndarray, origin: Optional[np.ndarray], along: float) -> np.ndarray:
        """Covariance (3, 3) m^2 of a place; origin: of the sensor, None where it is not known."""
        if origin is None:
            return (self._distance / GATE) ** 2 / 2.0 * np.diag([1.0, 1.0, 25.0])
        return ray_covariance(position, origin, along, exactness=0.1 * self._distance)

    def add_place(self, feature: MatchNode, source: int, sensor: str, position: np.ndarray, covariance: np.ndarray,
                  origin: Optional[np.ndarray], stamp: float) -> None:
        """Take a place (3,) m of a tracked feature with its covariance (3, 3) m^2; a lower `source` is a better one."""
        track = self._groups.track(feature, sensor)
        if track is None:
            return
        track.add(source, position, covariance, origin, stamp)
        newest = self._newest_of.get(sensor, stamp)
        # What is older by more than any lag tells that the newest stamp was wrong, or that its clock was set.
        self._newest_of[sensor] = stamp if stamp < newest - LONGEST_LAG_S else max(newest, stamp)
        if stamp > self._newest or stamp < newest - LONGEST_LAG_S:
            self._newest = max(self._newest_of.values())

    def add_appearance(self, body: MatchNode, appearance: np.ndarray) -> None:
        """Take the colours (5, B) of the clothes of a body that has been placed."""
        track = self._groups.tracks.get(body)
        if track is not None:
            track.appearance = appearance

    def fused(self, feature: MatchNode, stamp: float) -> Optional[Estimate]:
        """Where the human of a feature is at `stamp` (s) by all who see it; None where one sensor does, or none."""
        view = self._groups.view_of.get(feature)
        if view is None or not view.tracks:
            return None
        human = self._groups.group_of[view.number]
        last = human.fused
        if last is not None and abs(stamp - last[0]) <= SAME_MOMENT_S and (
                view.best is not self._groups.tracks.get(feature)):
            # Nothing new: a body of which the face is there, a frame of the hips of which the head is there.
            return last[1]._replace(position=last[1].position + (stamp - last[0]) * last[1].velocity)
        views = [other for other in [*human.views, *self._groups.likely.get(human.number, ())]
                 if abs(stamp - other.ended) <= FRESH_S]
        if not human.scales and len({other.sensor for other in views}) < 2:
            human.fused = None
            return None
        fused = place_by_all(views or [view], stamp, human.scales)
        human.fused = (stamp, fused)
        return fused

    def update(self, groups: Iterable[SensedGroup], parted: AbstractSet[FrozenSet[str]]) -> None:
        """Take who belongs together; decides who is one human, which views are held, and which are due to be told.

        parted: pairs of persons whom a user has parted.
        """
        self._groups.regroup(groups)
        self._groups.parted = parted
        for pair in self._told & parted:
            self._groups.part(*sorted(pair))
        live = [view for view in self._groups.views() if self._newest - view.ended <= FRESH_S]
        self._groups.note_names(live)
        self._groups.note_two(live)
        self._come_back_by_name()
        self._come_back_after_jump(live)
        if live and not self.is_idle:
            self._separate(live)
            self._join(live)
            self._learn_scales(live)
        self._hold(live)
        self._forget_lost()

    def note_name(self, name: str, recogniser: str) -> None:
        """Take that a recogniser knows somebody by this name: what cameras see never joins two whom one knows."""
        self._groups.note_namer(name, recogniser)

    def continue_from(self, before: CrossCamera) -> None:
        """Go on after a jump of time with what was known of persons; where they are is not known any more."""
        self._told = set(before._told)
        self._before = dict.fromkeys(before._told)
        self._groups.take_names(before._groups)

    def links(self, owner: Callable[[MatchNode], str], exists: Container[str]) -> List[CrossCameraLink]:
        """Return the links between persons that are new or over.

        owner(feature): the id of its person, empty for none. exists: all persons of the table.
        """
        wanted: Dict[FrozenSet[str], None] = {}
        current = {owner(feature) for feature in self._groups.view_of} - {""}
        for human in self._groups.all.values():
            own = [owner(feature) for view in human.views for feature in sorted(view.tracks)]
            human.persons.update(dict.fromkeys(person for person in own if person))
            for person in [person for person in human.persons
                           if person not in exists or person not in own and (
                           person in current or any(person in view.doubted for view in human.views))]:
                del human.persons[person]
            first, *others = human.persons or [""]
            wanted.update((frozenset((first, other)), None) for other in others)
        wanted.update(dict.fromkeys(self._still_kept(current, exists)))
        wanted.update((pair, None) for pair in self._before if all(person in exists for person in pair))
        if self._groups.strangers or self._groups.namers:
            wanted = self._groups.without_strangers(sorted(wanted, key=lambda pair: pair not in self._told))
        changed = [CrossCameraLink(min(pair), max(pair), 0.0) for pair in self._told - wanted.keys()]
        changed += [CrossCameraLink(min(pair), max(pair), LIKELIHOOD) for pair in wanted if pair not in self._told]
        self._told = set(wanted)
        return changed

    def _still_kept(self, current: Container[str], exists: Container[str]) -> List[FrozenSet[str]]:
        """Links of humans that all sensors have lost: they hold while their persons are there, and not seen apart."""
        for pair in list(self._groups.kept):
            first, second = pair
            if first not in exists or second not in exists or pair in self._groups.parted or (
                    first in current and second in current and self._are_apart(pair)):
                del self._groups.kept[pair]
        while len(self._groups.kept) > MAX_NAMES:
            self._groups.kept.popitem(last=False)
        return list(self._groups.kept)

    def _are_apart(self, persons: FrozenSet[str]) -> bool:
        """Tell whether two persons who are seen now cannot be one human, or are not near each other."""
        humans = {human.number: human for human in self._groups.group_of.values()
                  if any(view.person in persons for view in human.views)}
        for one, other in itertools.combinations(humans.values(), 2):
            state = self._groups.near.get(frozenset((one.number, other.number)))
            if not self._groups.may_be_one(one, other) or (state is not None and not state.near):
                return True
        return False

    def _separate(self, live: List[View]) -> None:
        """Take views out of humans that they are apart from, or that are somebody else."""
        for human in list(self._groups.all.values()):
            views = [view for view in human.views if view in live]
            for view in sorted(views, key=lambda item: -item.began):
                others = [other for other in views if other is not view and other in human.views]
                if not others:
                    continue
                names = frozenset().union(*(other.names for other in others))
                if (self._groups.have_other_names(view.names, names) or is_doubted([view], others)
                        or self._is_apart(view, others)):
                    self._groups.take_out(view)
                    self._groups.note_pair(human.number, self._groups.group_of[view.number].number)

    def _is_apart(self, view: View, others: List[View]) -> bool:
        if others[0].began > view.began and len(others) == 1:
            return False        # of two, the younger one is asked
        stamp = min([view.ended] + [other.ended for other in others])
        own, place = view.at(stamp), fuse_views(others, stamp)
        both = own.covariance + _lengthened(view, own) + place.covariance
        for other in others:
            both += _lengthened(other, place) / len(others) ** 2
        offset = own.position - place.position
        square = float(offset @ np.linalg.solve(both, offset))
        alike = any(view.names & other.names for other in others)
        limit = (PARTING * GATE * (SLOWER if alike else 1.0)) ** 2
        state = self._smooth(self._groups.apart, view.number, square, stamp, limit)
        return not state.near and stamp - state.since >= PARTING * self._time

    # ----- who are one

    def _come_back_after_jump(self, live: List[View]) -> None:
        """Unite who was one before a jump of time; those who are not seen by then stay one until they are."""
        if not self._before or not live:
            return
        self._jumped = min(self._jumped, self._newest)
        seen = {view.person: view for view in live if view.person}
        for pair in list(self._before):
            views = [seen[person] for person in sorted(pair) if person in seen]
            if len(views) == 2:
                one, other = (self._groups.group_of[view.number] for view in views)
                if one is not other and self._groups.may_be_one(one, other):
                    self._groups.unite(one, other)
                del self._before[pair]
        if self._newest - self._jumped > FRESH_S:
            self._groups.kept.update(self._before)
            self._before.clear()

    def _smooth(self, known: Dict, key: object, square: float, stamp: float, limit: float) -> PairDistance:
        """Follow the squared distance of a pair; it is near below `limit`."""
        state = known.get(key)
        if state is None or stamp < state.stamp or stamp - state.stamp > 2.0:
            state = known[key] = PairDistance(square, stamp, stamp, square <= limit)
        elif stamp > state.stamp:
            gain = 1.0 - math.exp(-2.0 * (stamp - state.stamp) / max(self._time, 1e-3))
            state.square += gain * (square - state.square)
            near = state.square <= limit * (STAYS if state.near else 1.0)
            state.since = state.since if near == state.near else stamp
            state.near, state.stamp = near, stamp
        likely = state.square <= LOOSE_GATE ** 2
        state.likely_since = min(state.likely_since, stamp) if likely else math.inf
        return state

    def _join(self, live: List[View]) -> None:
        """Unite the humans of views that are clearly one."""
        seen = [human for human in self._groups.all.values() if any(view in live for view in human.views)]
        costs = self._costs(seen, live)
        self._groups.explained.clear()
        self._groups.likely.clear()
        margins = self._pair_up(seen, live, costs)
        rivals = _rivals(seen, costs)
        for pair in sorted(margins, key=costs.__getitem__):
            if margins[pair] < LIKELIER_BY or not pair <= self._groups.all.keys():
                continue
            one, other = (self._groups.all[number] for number in sorted(pair))
            clear = margins[pair] >= CLEARER_BY and not self._has_rival(pair, costs, rivals)
            if clear and self._groups.may_be_one(one, other) and self._is_ripe(pair, one, other, live):
                self._groups.unite(one, other)
            elif costs[pair] <= LIKELY and one.views and other.views:
                # Not sure enough, or not for long enough, to be told, but a better place than that of one of them.
                for human, more in ((one, other), (other, one)):
                    self._groups.likely.setdefault(human.number, []).extend(more.views)

    def _come_back_by_name(self) -> None:
        """Let a lost human go on whose person somebody is again."""
        lost = {person: human for human in self._groups.all.values() if not human.views for person in human.persons}
        for view in self._groups.views() if lost else ():
            before = lost.get(view.person)
            human = self._groups.group_of[view.number]
            if before is not None and before.number in self._groups.all and self._groups.may_be_one(before, human):
                self._groups.unite(before, human)

    def _is_ripe(self, pair: Pair, one: ViewGroup, other: ViewGroup, live: List[View]) -> bool:
        if not one.views or not other.views:
            return pair in self._returned
        state = self._groups.near.get(pair)
        if state is None or self._velocity_apart(one, other, live) > ALIKE_MPS:
            return False
        returns = any(view.began - RETURN_S <= b.seen.get(view.sensor, -math.inf) < view.began + OVERLAP_S
                      for a, b in ((one, other), (other, one)) for view in a.views)
        sooner = SOONER if returns or one.names & other.names or (
            clothes_evidence(one.tracks, other.tracks) >= ALIKE_CLOTHES) else 1.0
        return (state.near and state.stamp - state.since >= sooner * self._time
                or state.stamp - state.likely_since >= SLOWER * self._time)

    def _velocity_apart(self, one: ViewGroup, other: ViewGroup, live: List[View]) -> float:
        found = [np.mean([view.best.at(view.ended).velocity[:2] for view in human.views if view in live], axis=0)
                 for human in (one, other)]
        return float(np.linalg.norm(found[0] - found[1]))

    def _costs(self, seen: List[ViewGroup], live: List[View]) -> Dict[Pair, float]:
        """Smoothed squared distances of all pairs that may be one, and of lost humans and new views."""
        stamp = max(self._newest - 0.8 * FRESH_S, min(view.ended for view in live))
        pairs = self._groups.possible_pairs(seen)
        squares = self._squares(seen, live, pairs, stamp) - 2.0 * np.minimum(
            0.0, evidence_of_pairs([human.tracks for human in seen], pairs))
        costs: Dict[Pair, float] = {}
        for (row, column), square in zip(pairs.tolist(), squares.tolist()):
            pair = frozenset((seen[row].number, seen[column].number))
            square += _name_bonus(seen[row], seen[column])
            costs[pair] = self._smooth(self._groups.near, pair, square, stamp, GATE ** 2).square
        costs.update(self._costs_of_lost(seen))
        return costs

    def _squares(self, seen: List[ViewGroup], live: List[View], pairs: np.ndarray, stamp: float) -> np.ndarray:
        """Squared distances (M,) at `stamp` (s) of pairs (M, 2) of humans."""
        views = [[view for view in human.views if view in live] for human in seen]
        places = [fuse_views(of, stamp, human.scales) for of, human in zip(views, seen)]
        positions, covariances = (np.array([getattr(place, name) for place in places])
                                  for name in ("position", "covariance"))
        squares = squared_distances(positions, covariances, pairs)
        origins = [of[0].best.origin if len(of) == 1 else None for of in views]
        again = np.flatnonzero((REFINED[0] < squares) & (squares < REFINED[1]))
        squares[again] = crossing_distances(
            positions, covariances, np.array([_NO_ORIGIN if origin is None else origin for origin in origins]),
            pairs[again])
        alike = [bool(seen[row].names & seen[column].names) for row, column in pairs.tolist()]
        squares[alike] /= PARTING ** 2
        return squares

    def _costs_of_lost(self, seen: List[ViewGroup]) -> Dict[Pair, float]:
        """Squared distances of lost humans and new views. Of those lost by one sensor one after the other, who may be
        one human whom it lost twice, the last one counts."""
        costs: Dict[Pair, float] = {}
        self._returned.clear()
        lost = [human for human in self._groups.all.values() if not human.views and human.lost is not None]
        lost.sort(key=lambda human: -human.lost.stamp if human.lost is not None else 0.0)
        for human in seen:
            near: List[ViewGroup] = []
            for before in lost:
                found = self._jump(before, human) if self._groups.may_be_one(before, human) else None
                if found is None or any(self._groups.may_be_one(before, other) for other in near):
                    continue
                pair = frozenset((before.number, human.number))
                costs[pair] = found[0] + _name_bonus(before, human)
                if found[0] <= 2.0 * (HANDOVER_COST - HANDOVER_EVIDENCE):
                    near.append(before)
                if found[1]:
                    self._returned.add(pair)
        return costs

    def _pair_up(self, seen: List[ViewGroup], live: List[View], costs: Mapping[Pair, float]) -> Dict[Pair, float]:
        """Pair up whom one sensor sees with whom another one sees, or who is lost; returns for each pair by how much
        every other way to do so is worse, as a squared distance."""
        margins: Dict[Pair, float] = {}
        lost = [human for human in self._groups.all.values() if not human.views]
        places = {human.number: place for place, human in enumerate([*seen, *lost])}
        table = np.full((len(places), len(places)), math.inf)
        for (first, second), cost in costs.items():
            table[places[first], places[second]] = table[places[second], places[first]] = cost
        sensors = sorted({view.sensor for view in live})
        for sensor, other in itertools.permutations([*sensors, ""], 2):
            rows = [human for human in seen if other in human.sensors and sensor not in human.sensors] + lost
            columns = [human for human in seen if sensor in human.sensors and other not in human.sensors]
            if rows and columns:
                self._assign(rows, columns, table[np.ix_(*([places[human.number] for human in of]
                                                           for of in (rows, columns)))], margins)
        return margins

    def _has_rival(self, pair: Pair, costs: Mapping[Pair, float], rivals: Mapping[int, List[ViewGroup]]) -> bool:
        """Tell whether one of a pair might as well be somebody else whom yet another sensor sees; rivals: see
        _rivals."""
        for one, other in itertools.permutations(pair):
            human = self._groups.all[other]
            for rival in rivals.get(one, ()):
                if rival.number in pair or costs[frozenset((one, rival.number))] >= costs[pair] + CLEARER_BY:
                    continue
                if not human.sensors & rival.sensors and (
                        costs.get(frozenset((other, rival.number)), math.inf) > LIKELY):
                    return True
        return False

    def _assign(self, rows: List[ViewGroup], columns: List[ViewGroup], table: np.ndarray,
                margins: Dict[Pair, float]) -> None:
        pairs = best_pairs(table, UNPAIRED)
        for row, column in zip(*np.nonzero(table < UNPAIRED)):
            if (row, column) not in pairs:
                margins[frozenset((rows[row].number, columns[column].number))] = 0.0
        for (row, column), margin in pairs.items():
            pair = frozenset((rows[row].number, columns[column].number))
            self._groups.explained.setdefault(rows[row].number, set()).add(columns[column].number)
            self._groups.explained.setdefault(columns[column].number, set()).add(rows[row].number)
            margins[pair] = min(margins.get(pair, math.inf), margin)

    def _jump(self, lost: ViewGroup, human: ViewGroup) -> Optional[Tuple[float, bool]]:
        """Cost of a new human as a lost one, and whether it is known well enough that they are one; None if out of
        the question."""
        if lost.lost is None:
            return None
        view = min(human.views, key=lambda item: item.began)
        away = view.began - lost.lost.stamp
        if not -FRESH_S <= away <= max(self._handover, FRESH_S) or view.ended - view.began > NEW_S:
            return None
        evidence = _hand_off_evidence(lost.lost, view)
        known = (evidence >= HANDOVER_EVIDENCE and view.ended - view.began >= LOOKING_S
                 and 0.0 < self._handover and -SETTLING_S <= away <= self._handover
                 and view.sensor not in lost.lost.best and len(human.persons) <= 1)
        return 2.0 * (HANDOVER_COST - evidence), known

    def _learn_scales(self, live: List[View]) -> None:
        """Learn by how much the distance of each view is wrong, where the rays of several cross."""
        for human in self._groups.all.values():
            views = [view for view in human.views if view in live]
            if len({view.sensor for view in views}) < 2:
                continue
            stamp = min(view.ended for view in views)
            place = fuse_views(views, stamp)
            for view in views:
                if view.best.origin is not None:
                    scale = human.scales.setdefault((view.sensor, view.best.source), Scale())
                    scale.learn(*_measured_scale(view, place, stamp))

    # ----- who is told

    def _hold(self, live: List[View]) -> None:
        """Choose the views of which no person is made yet, and those whose person is known by now."""
        held: Set[MatchNode] = set()
        self.due = []
        known = {human.number for human in self._groups.all.values() if human.persons or not human.views}
        for view in sorted(live, key=lambda item: (item.began, item.number)):
            human = self._groups.group_of[view.number]
            if not view.person and human.persons:
                self.due.append(frozenset(view.tracks))
            elif not view.person and self._groups.explained.get(human.number, set()) & known and (
                    view.ended - view.began <= HOLD_S):
                held.update(view.tracks)
            known.add(human.number)
        self.held = frozenset(held)

    def _forget_lost(self) -> None:
        """Note where humans are, as long as somebody sees them, and forget who is away for too long."""
        for human in list(self._groups.all.values()):
            views = [view for view in human.views if self._newest - view.ended <= FRESH_S]
            if views:
                human.seen.update((view.sensor, view.ended) for view in views)
                last = max(views, key=lambda view: view.ended)
                human.lost = LastSighting(last.ended, {view.sensor: view.best for view in views},
                                       tuple(last.tracks.values()), human.scales)
            elif not human.views and (human.lost is None or not (
                    self._newest - human.lost.stamp <= max(self._handover, 1.0) + NEW_S)):
                self._groups.drop(human)


def _rivals(seen: List[ViewGroup], costs: Mapping[Pair, float]) -> Dict[int, List[ViewGroup]]:
    """Who of those that are seen costs little enough with each, by number, to be a rival of whom it may be paired
    with."""
    humans = {human.number: human for human in seen}
    rivals: Dict[int, List[ViewGroup]] = {}
    for pair, cost in costs.items():
        if cost < UNPAIRED + CLEARER_BY:
            for one, other in itertools.permutations(pair):
                if other in humans:
                    rivals.setdefault(one, []).append(humans[other])
    return rivals


def _name_bonus(one: ViewGroup, other: ViewGroup) -> float:
    """What names are worth, as a squared distance."""
    return NAME_ALIKE if one.names & other.names else 0.0


def _hand_off_evidence(lost: LastSighting, view: View) -> float:
    """Logarithm of the likelihood ratio of a lost human and somebody new, against somebody else: place and velocity, by
    what is of one kind, a body rather than a face, as these are not wrong by the same; and clothes. He walks on as he
    did for the last seconds."""
    before, after = max(((old, new) for old in lost.tracks for new in view.tracks.values()),
                        key=lambda pair: (pair[0].source == pair[1].source, pair[1].source, pair[1].length))
    new = after.walk(begins=True)
    walked = max(walk_evidence(before.walk(begins=False, seconds=seconds), new, lost.place) - penalty
                 for seconds, penalty in ((WALK_S, 0.0), (WINDOW_S, CHANGED)))
    return walked + clothes_evidence(lost.tracks, view.tracks.values())


def _lengthened(view: View, place: Estimate) -> np.ndarray:
    """What to add to the covariance (3, 3) of a place so that a ray counts for its direction: who is joined may be a
    child, twice as wrong along the ray as others."""
    if view.best.origin is None:
        return np.zeros((3, 3))
    ray = place.position - view.best.origin
    square = max(float(ray @ ray), LEAST_SQUARE)
    return (PARTING ** 2 - 1.0) * float(ray @ view.best.covariance @ ray) / square ** 2 * np.outer(ray, ray)


def _measured_scale(view: View, place: Estimate, stamp: float) -> Tuple[float, float]:
    """How much farther away a human is than a view tells, by its place where rays cross; and the variance of that."""
    origin = view.best.origin
    assert origin is not None
    ray = view.best.at(stamp).position - origin
    length = max(float(np.linalg.norm(ray)), 1e-6)
    unit = ray / length
    return (float((place.position - origin) @ unit) / length,
            float(unit @ place.covariance @ unit) / length ** 2 + FIXED_VARIANCE)
