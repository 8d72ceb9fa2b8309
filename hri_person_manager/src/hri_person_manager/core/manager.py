"""The person manager without ROS: tracked features, matches and places go in, persons come out.

All times are seconds of one clock and are given by the caller. Not thread-safe: the owner holds a lock.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Callable, Container, Dict, FrozenSet, Iterable, List, Mapping, Optional, Set, Tuple

import numpy as np

from hri_person_manager.core.cross_camera import CrossCamera
from hri_person_manager.core.features import Kind, MatchNode, PlaceSource, TrackedFeatures
from hri_person_manager.core.location import Decay, FeaturePlaces, PersonLocation, Place
from hri_person_manager.core.match_graph import Association, CandidateMatch, SaidNames
from hri_person_manager.core.merges import ChangeLimit, Merges
from hri_person_manager.core.parameters import PersonManagerSettings, sensor_errors
from hri_person_manager.core.persons import (
    ANONYMOUS_PREFIX,
    KnownIds,
    PersonTable,
    PublishedPersons,
    Snapshot,
)
from hri_person_manager.core.triangulation import voice_covariance
from hri_person_manager.core.view_groups import SensedGroup
from hri_person_manager.core.waiting import SINGLE_WAIT_S, waiting_for_matches, waiting_for_names
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.ids import IdGenerator, is_valid_id

_ORIGIN = np.zeros(3)
MAX_UNSEEN_PERSONS = 32       # permanent persons kept with their topics although nobody sees them
_KIND_OF_SOURCE = {PlaceSource.FACE: Kind.FACE, PlaceSource.HEAD: Kind.BODY, PlaceSource.BODY: Kind.BODY,
                   PlaceSource.VOICE: Kind.VOICE}
# Likelihood of a match that an earlier run has left; the recogniser's own takes its place.
_AS_SURE_AS_BEFORE = 0.9


class PersonManager:
    """Fuses faces, bodies and voices into persons and knows where they are."""

    def __init__(self, settings: PersonManagerSettings, new_id: Optional[Callable[[], str]] = None) -> None:
        """Take the settings of `parameters.PERSON_MANAGER_PARAMETERS`; `new_id` makes ids of 5 characters."""
        self._settings = settings
        self._threshold = settings.match_threshold
        self._decay = Decay(settings.decay, settings.half_life, settings.confidence_floor)
        self._new_id = new_id or IdGenerator().new
        self._tracked = TrackedFeatures()
        self._errors = sensor_errors(settings.distance_errors)
        self._start_afresh(KnownIds(), Merges(self._threshold))

    def _start_afresh(self, known: KnownIds, merges: Merges) -> None:
        self._known, self._merges = known, merges
        self._places = FeaturePlaces()
        self._framed: Set[str] = set()      # persons whose frame was published
        self._table = PersonTable(self._new_id,
                                  lambda: PersonLocation(self._settings.source_timeout, self._settings.coast_time),
                                  self._settings.new_person_delay, self._settings.anonymous_persons,
                                  self._settings.voice_person_delay)
        self._published = PublishedPersons(self._table, self._merges, self._decay)
        self._association = Association(self._threshold, self._is_present, self._make_permanent)
        self._cameras = CrossCamera(*_camera_limits(self._settings))
        self._said, self._limit = SaidNames(), ChangeLimit()
        self._recalled: Dict[MatchNode, str] = {}       # names from before a restart that nobody has said since

    def reconfigure(self, settings: PersonManagerSettings, now: float) -> None:
        """Take up the values of the live parameters at `now` (s): persons and matches stay, who belongs together is
        solved anew."""
        self._settings = settings
        self._threshold = self._association.threshold = self._merges.threshold = settings.match_threshold
        self._decay = self._published.decay = Decay(settings.decay, settings.half_life, settings.confidence_floor)
        self._table.set_delays(settings.new_person_delay, settings.voice_person_delay)
        self._cameras.limit(*_camera_limits(settings))
        # The persons, too: who lost all features by a higher threshold would keep its group.
        self._association.solve({*self._tracked.features(), *(node for group in self.groups for node in group)})
        self._associate(now)

    @property
    def refused_ids(self) -> int:
        """How many ids of tracked lists were refused so far."""
        return self._tracked.refused

    @property
    def groups(self) -> Tuple[FrozenSet[MatchNode], ...]:
        """Return the current association: every tracked feature and known person in exactly one group."""
        return self._association.groups

    @property
    def exact(self) -> bool:
        """Tell whether the last association was proved to be the best."""
        return self._association.exact

    def reset(self, now: float) -> None:
        """Start afresh with the features that are tracked; persons and matches are forgotten."""
        self._start_afresh(KnownIds(), Merges(self._threshold))
        self._association.solve(self._tracked.features())
        self._associate(now)

    def rewind(self, now: float) -> None:
        """Go on after time has jumped back to `now` (s): the same persons and matches; places and delays start anew."""
        anonymous, matches = self.anonymous(), self.matches
        permanent = [person for person in self._table.persons.values() if not person.anonymous]
        cameras, said, recalled = self._cameras, self._said, self._recalled
        self._start_afresh(self._known, self._merges)
        self._cameras.continue_from(cameras)
        self._said, self._recalled = said, recalled
        for person in sorted(permanent, key=lambda item: item.lost_at or 0.0):
            self._table.permanent(person.id).lost_at = now       # unless it has features
        self._tracked.rewind(now)
        self.expect(anonymous)
        for edge in matches:
            self._association.add(CandidateMatch(*edge))
        self._association.solve(self._tracked.features())
        self._associate(now)

    def on_tracked(self, kind: Kind, ids: Iterable[str], now: float) -> None:
        """Take the list of features of one kind that are tracked; malformed ids are left out and counted."""
        gone, new, inferred = self._tracked.update(kind, ids)
        if not gone and not new:
            return
        kept = self._association.matches_of(inferred)
        for node in gone:
            self._recalled.pop(node, None)
        touched = [node for gone_node in gone for node in self._association.remove(gone_node)]
        for match in kept:
            self._association.add(match)
        self._association.add_pending(new)
        self._association.solve(touched + new)
        self._associate(now)

    def on_match(self, match: CandidateMatch, now: float, sender: str = "") -> bool:
        """Take a candidate match; return whether it changed who belongs together.

        sender: the node that says it; of those of whom one node says two names, no two are one. Empty: unknown.
        """
        nodes = (match.first, match.second)
        if match.likelihood >= self._threshold:
            for node in nodes:
                if node.kind == Kind.PERSON and not node.id.startswith(ANONYMOUS_PREFIX):
                    self._remember(node.id)
        self._association.refute(match, now)
        renamed = self._note_name(match, sender)
        if nodes[0].kind == nodes[1].kind == Kind.PERSON:
            changed = self._merges.report(nodes[0].id, nodes[1].id, match.likelihood, now)
            return self._update_merges(now) and changed
        for feature, person in (nodes, nodes[::-1]):
            if person.kind == Kind.PERSON and person.id.startswith(ANONYMOUS_PREFIX):
                return self._match_anonymous(feature, person.id, match.likelihood, now)
        keys = tuple((node, other.kind) for node, other in (nodes, nodes[::-1]) if node.kind != Kind.PERSON)
        held = self._limit.holds(keys, now)
        present = [node for node in nodes if not held or self._is_present(node)]
        arrived = self._begin_inferred(present, now) if match.likelihood > 0.0 else []
        worth = self._association.add(match)
        changed = False
        if held:        # a name that is withdrawn does not wait: a wrong one is worse than none
            self._limit.hear(keys, self._association.undisputed(keys), now)
            worth = worth and match.likelihood < self._threshold and len(keys) == 1
            changed = worth and self._association.part(nodes)
        elif worth or arrived:
            changed = self._association.solve(nodes)
        if changed:
            self._limit.note(keys, now)
        if self._end_inferred(nodes) or renamed or arrived or changed or (
                worth and Kind.VOICE in {node.kind for node in nodes}):
            self._associate(now)
            return True
        return False

    @property
    def matches(self) -> List[Tuple[MatchNode, MatchNode, float]]:
        """All candidate matches that are kept between features and persons."""
        return self._association.matches

    @property
    def merges(self) -> Tuple[Tuple[str, str, float], ...]:
        """All candidate matches that are kept between persons, and those whom several cameras see at one place."""
        return self._merges.pairs + self._merges.observed

    def merge(self, person_id: str, other: str, now: float) -> Tuple[str, str]:
        """Join two persons for good, until they are split; returns who stands for both, and who does so no longer.

        The representative of `person_id` stays, unless it is anonymous and the other is not. ValueError when one of
        them does not exist.
        """
        person_id, other = self._continued(person_id), self._continued(other)
        for name in (person_id, other):
            if name not in self._table.persons and name not in self._known:
                raise ValueError("there is no person {!r}".format(name))
        kept, alias = self.representative(person_id), self.representative(other)
        if kept == alias:       # they are joined already
            kept, alias = person_id, other
        if not self.is_permanent(kept) and self.is_permanent(alias):
            kept, alias = alias, kept
        self._merges.set(kept, alias, 1.0)
        if self.is_permanent(person_id) and self.is_permanent(other):
            self._merges.set(person_id, other, 1.0)     # also when the others are parted from them
        self._merges.prefer(kept)
        self._update_merges(now)
        return kept, alias

    def representative(self, person_id: str) -> str:
        """Return the person that stands for this one when all are there with whom it is joined."""
        return self._merges.representative_of_all(self._continued(person_id), self._rank)

    def joined(self, person_id: str) -> Set[str]:
        """Return all permanent persons with whom this one is joined, there or not, itself where it is one."""
        return set(filter(self.is_permanent, self._merges.joined(self._continued(person_id))))

    def _continued(self, person_id: str) -> str:
        """Return the person that goes on as this one, itself where it is no former anonymous one."""
        alias = self._table.aliases.get(person_id)
        return person_id if alias is None else alias.target

    def is_permanent(self, person_id: str) -> bool:
        """Tell whether a person is known by more than its present features."""
        return person_id in self._known

    def person_of(self, feature: MatchNode) -> Optional[str]:
        """Return the id of the person that a feature is published for, None if it is assigned to nobody."""
        owner = self._table.owner(feature)
        return self._published.representative(owner).id if owner is not None else None

    def split(self, person_id: str, now: float) -> None:
        """Undo the merges of a person. ValueError when it is merged with nobody."""
        if not self._merges.split(person_id):
            raise ValueError("person {!r} is joined with nobody".format(person_id))
        self._update_merges(now)

    def forget(self, person_id: str, now: float) -> bool:
        """Forget a person with all its matches; its features, while they are tracked, are assigned to nobody.

        Returns False for somebody who does not exist.
        """
        members = {person_id} | {id for id, alias in self._table.aliases.items() if alias.target == person_id}
        if not members & (set(self._table.persons) | set(self._known) | set(self._table.aliases)):
            return False
        touched = self._association.forget(MatchNode(Kind.PERSON, person_id))
        self._said.forget(person_id)
        self._known.remove(person_id)
        self._merges.remove(person_id)
        self._table.remove(person_id)
        self._association.solve(touched)
        self._associate(now)
        return True

    def renew(self, sender: str, kept: Container[str], now: float) -> None:
        """Take note that a recogniser was started anew: those whom only it named are forgotten as soon as none of their
        features is tracked, unless they are named again.

        kept: persons whom it knows still, and those who stay known without it.
        """
        self._known.renew(sender, kept)
        self._forget_outdated(now)

    def know(self, person_ids: Iterable[str]) -> None:
        """Take over the permanent persons that a store remembers, those known first first; what is no id is left
        out."""
        for person_id in filter(is_valid_id, person_ids):
            self._remember(person_id)

    def expect(self, anonymous: Mapping[str, Iterable[MatchNode]]) -> None:
        """Give anonymous persons of an earlier run their ids again when their features are tracked still."""
        self._table.expect(anonymous)

    def anonymous(self) -> Dict[str, List[MatchNode]]:
        """The anonymous persons with their features, for `expect` after a restart."""
        return self._published.anonymous()

    def identified(self) -> Dict[str, List[MatchNode]]:
        """The permanent persons with their faces, or other features, for `recall` after a restart."""
        return self._published.identified()

    def recall(self, identified: Mapping[str, Iterable[MatchNode]], now: float) -> None:
        """Assume that features seen before the restart still belong to the same permanent persons, until a recogniser
        says otherwise."""
        for person_id, nodes in identified.items():
            for node in nodes:
                self.on_match(CandidateMatch(node, MatchNode(Kind.PERSON, person_id),
                                             max(self._threshold, _AS_SURE_AS_BEFORE)), now)
                self._recalled[node] = person_id

    def on_place(self, source: PlaceSource, feature_id: str, place: Place, now: float,
                 sensor: str = "") -> Optional[str]:
        """Take the pose of a feature's frame in the reference frame; sensor: the frame of the camera that sees it.

        Returns the id of the person whose frame moves by it, to its place(), None if no person's does.
        """
        feature = MatchNode(_KIND_OF_SOURCE[source], feature_id)
        if feature not in self._tracked:
            return None
        place = self._with_covariance(source, place, sensor)
        latest = self._places.add(feature, source, place, now, sensor)
        if (
            self._settings.cross_camera
            and source != PlaceSource.VOICE
            and place.frame == self._settings.reference_frame
        ):
            # Only places in the reference frame can be compared.
            place = self._compare_across_cameras(feature, source, place, sensor)
        owner = self._table.owner(feature)
        if owner is None:
            return None
        person = self._published.representative(owner)
        if person is not owner:
            owner.location.offer(source, place, now, feature, latest.fresh, latest.lag)
        if not person.location.offer(source, place, now, feature, latest.fresh, latest.lag):
            return None
        self._framed.add(person.id)
        return person.id

    def on_appearance(self, body_id: str, appearance: np.ndarray) -> None:
        """Take the histograms (P, B) of the clothes of a body, to compare it across cameras. ValueError for numbers
        that are none."""
        if appearance.ndim != 2 or not (np.isfinite(appearance).all() and appearance.min(initial=0.0) >= 0.0):
            raise ValueError("the appearance of {} is no table of histograms".format(body_id))
        if self._settings.cross_camera:
            self._cameras.add_appearance(MatchNode(Kind.BODY, body_id), appearance)

    def place(self, person_id: str) -> Optional[Place]:
        """Return where a person was seen last, in the reference frame; None where nobody has."""
        return self._table.persons[person_id].location.place

    def newly_placed(self, now: float) -> List[Tuple[str, Place]]:
        """Return id and place of the persons that got a frame since the last call, but no new place since then.

        Persons without a recent place are in silent(). now: s.
        """
        placed = self._published.placed(now)
        framed, self._framed = self._framed, {person.id for person in placed}
        new = [(person.id, person.location.place) for person in placed
               if person.id not in framed and not person.location.is_silent(now)]
        return [(person_id, place) for person_id, place in new if place is not None]

    def tick(self, now: float) -> None:
        """Let time pass: unassigned features become persons, places fade, forgotten persons go."""
        expired = self._expire_inferred(now) | self._association.solve_refuted(now) | self._solve_held(now)
        self._hold(now)
        waiting = self._table.waiting_until()
        if expired or (waiting is not None and now >= waiting):
            self._associate(now)
        self._forget_outdated(now)
        gone = self._published.fade(now) + self._published.long_unseen()[:-MAX_UNSEEN_PERSONS]
        for person_id in gone:
            if self._table.persons[person_id].anonymous:
                self._merges.remove(person_id)
            self._table.remove(person_id)
        if self._merges.report_held(now) | self._join_across_cameras(now) or gone:
            self._update_merges(now)

    def _solve_held(self, now: float) -> bool:
        """Decide anew where matches contradict each other too often; returns whether a group has changed. now: s."""
        due = self._limit.due(now, self._association.undisputed)
        changed = self._association.solve([feature for feature, _ in due]) if due else False
        if changed:
            self._limit.note(due, now)
        return changed

    def _forget_outdated(self, now: float) -> None:
        """Forget whom no recogniser will name any more, once nothing of them is tracked."""
        if not self._known.outdated:
            return
        joined = set(self._table.aliases).union(*({alias.target} for alias in self._table.aliases.values()),
                                                *(pair[:2] for pair in self._merges.pairs))
        for person_id in sorted(self._known.outdated - joined):
            person = self._table.persons.get(person_id)
            if person is None or not person.features:
                self.forget(person_id, now)

    def silent(self, now: float) -> List[Tuple[str, Place]]:
        """Return id and place of the persons that have a frame although no source is active now."""
        return self._published.silent(now)

    def active(self, now: float) -> List[Tuple[str, Place]]:
        """Return id and place of the persons that a source places now."""
        return self._published.active(now)

    def snapshot(self, now: float) -> Snapshot:
        """Return the state of all persons at time `now`."""
        return self._published.snapshot(self._known, now)

    def _is_present(self, node: MatchNode) -> bool:
        return node.id in self._known if node.kind == Kind.PERSON else node in self._tracked

    def _begin_inferred(self, nodes: Iterable[MatchNode], now: float) -> List[MatchNode]:
        """Count features that a match names as present before their list does; returns those that were not. now: s."""
        if not self._settings.features_from_matches:
            return []
        arrived = [node for node in nodes if node.kind != Kind.PERSON and self._tracked.infer(node, now)]
        if arrived:
            self._association.add_pending(arrived)
        return arrived

    def _end_inferred(self, nodes: Iterable[MatchNode]) -> bool:
        """Drop inferred features of which all matches are withdrawn; returns whether there was one."""
        over = [node for node in nodes if node.kind != Kind.PERSON and self._tracked.is_inferred(node)
                and not self._association.neighbours(node)]
        for node in over:
            self._tracked.drop(node)
            self._association.solve(self._association.remove(node))
        return bool(over)

    def _expire_inferred(self, now: float) -> bool:
        """Drop inferred features that no match has named for long; returns whether there was one. now: s."""
        expired = self._tracked.expired(now)
        for node in expired:
            self._tracked.drop(node)
        self._association.solve([other for node in expired for other in self._association.remove(node)])
        return bool(expired)

    def _with_covariance(self, source: PlaceSource, place: Place, sensor: str) -> Place:
        """The place with how exact it is, where one knows where the sensor is."""
        origin = _ORIGIN if place.origin is None and place.frame == sensor else place.origin
        if origin is None or place.covariance is not None:
            return place
        if source == PlaceSource.VOICE:
            covariance = voice_covariance(place.pose.translation, origin)
        else:
            covariance = self._cameras.covariance(place.pose.translation, origin, self._errors.get(
                sensor, self._settings.distance_error))
        # Not replace(), which takes three times as long.
        return Place(place.frame, place.pose, place.stamp, place.exact_stamp, origin, covariance, place.camera,
                     place.of_camera)

    def _compare_across_cameras(self, feature: MatchNode, source: PlaceSource, place: Place, sensor: str) -> Place:
        """Take the place of a feature that a camera sees; returns where its human is by all cameras that see it."""
        covariance = place.covariance
        if covariance is None:
            covariance = self._cameras.covariance(place.pose.translation, None, self._settings.distance_error)
        self._cameras.add_place(feature, int(source), sensor, place.pose.translation, covariance, place.origin,
                                place.stamp)
        fused = self._cameras.fused(feature, place.stamp) if not self._cameras.is_idle else None
        if fused is None:
            return place
        return replace(place, pose=Pose(place.pose.rotation, fused.position), covariance=fused.covariance)

    def _join_across_cameras(self, now: float) -> bool:
        """Join and part persons by what several cameras see; returns whether any merge may have changed."""
        if not self._settings.cross_camera:
            return False
        self._cameras.update(self._sensed_groups(now), self._merges.parted)
        due = frozenset().union(*self._cameras.due)
        if due:
            self._hold(now, due)
            self._associate(now)
        changed = False
        for link in self._cameras.links(self._owner_id, self._table.persons):
            changed |= self._merges.set_observed(link.first, link.second, link.likelihood)
        return changed

    def _hold(self, now: float, due: FrozenSet[MatchNode] = frozenset()) -> None:
        """Let features wait that may well be of somebody who is a person already; those `due` no longer."""
        new = self._table.unassigned
        held = waiting_for_matches(new, self._association.groups, self._places, self._association.is_refuted, now)
        held |= waiting_for_names(new, self._table.persons.values(), self._places, self._decay, now)
        held |= self._places.single(node for node, since in new.items() if now - since <= SINGLE_WAIT_S)
        self._table.hold(self._cameras.held | held, due)

    def _owner_id(self, feature: MatchNode) -> str:
        owner = self._table.owner(feature)
        return owner.id if owner is not None else ""

    def _sensed_groups(self, now: float) -> List[SensedGroup]:
        groups = []
        for group in self._association.groups:
            features = frozenset(node for node in group if node.kind in (Kind.FACE, Kind.BODY))
            if not features:
                continue
            owner = self._table.owner(min(features))
            # What a face is recognised as goes before what its body has been called by an earlier face.
            said = {feature: self._association.recognised_as(feature) for feature in features}
            of_faces = [names for feature, names in said.items() if feature.kind == Kind.FACE and names]
            names = set().union(*(of_faces or said.values()))
            if owner is not None and not owner.anonymous:
                names.add(owner.id)
            weaker = {name for feature in features for name in self._said.doubted(feature)}
            doubted = {name for feature in features for name in self._association.refuted_as(feature, now)} | (
                weaker - {owner.id if owner is not None else ""})
            groups.append(SensedGroup(features, owner.id if owner is not None else "", frozenset(names - doubted),
                                      frozenset(doubted)))
        return groups

    def _note_name(self, match: CandidateMatch, sender: str) -> bool:
        """Note who says which name of a feature. A name from before a restart ends with the first one that is said;
        returns whether a group has changed by that."""
        changed = False
        for feature, person in ((match.first, match.second), (match.second, match.first)):
            if person.kind == Kind.PERSON != feature.kind and not person.id.startswith(ANONYMOUS_PREFIX):
                likelihood = match.likelihood if match.likelihood >= self._threshold else 0.0
                recalled = self._recalled.pop(feature, person.id) if likelihood > 0.0 else person.id
                if recalled != person.id:
                    before = MatchNode(Kind.PERSON, recalled)
                    self._association.add(CandidateMatch(feature, before, 0.0))
                    changed |= self._association.solve((feature, before))
                if sender:
                    self._said.note(sender, feature, person.id, likelihood)
                if sender and likelihood > 0.0:
                    self._cameras.note_name(person.id, sender)
                    self._known.note_name(person.id, sender)
        return changed

    def _match_anonymous(self, feature: MatchNode, person_id: str, likelihood: float, now: float) -> bool:
        """Take a match with an anonymous person: one without features gets this feature, else the owner of the feature
        is merged with it."""
        if person_id not in self._table.persons:
            return False
        seen = sorted(node for node in self._table.persons[person_id].features if node.kind != Kind.VOICE)
        if seen and feature.kind == Kind.VOICE:
            # To what is seen of the person: the voice needs no person of its own in between. Where it is linked
            # already, the new likelihood takes the place of the old one.
            linked = [node for node in seen if node in self._association.neighbours(feature)]
            return any([self.on_match(CandidateMatch(feature, node, likelihood), now) for node in linked or seen[:1]])
        if self._table.owner(feature) is None and likelihood >= self._threshold:
            self._begin_inferred((feature,), now)
            if not self._is_present(feature):
                return False
            self._association.solve((feature,))
            self._table.expect_feature(feature, person_id)
            self._associate(now)
        owner = self._table.owner(feature)
        if owner is None:
            return False
        other = self.representative(person_id)
        if likelihood >= self._threshold and not owner.anonymous and self.is_permanent(other) and (
                self.representative(owner.id) != other):
            return False        # two whom a recogniser tells apart are not one because of a body
        if owner.id != person_id:
            self._merges.report(owner.id, person_id, likelihood, now)
        else:
            self._table.doubt(feature, likelihood < self._threshold)
        self._update_merges(now)
        return True

    def _associate(self, now: float) -> None:
        moved = self._table.associate(self._association.assignable, now)
        self._update_merges(now)
        self._places.retain(self._tracked.__contains__)
        self._said.retain(self._tracked.__contains__)
        self._place_moved(moved)

    def _place_moved(self, features: Iterable[MatchNode]) -> None:
        """Give the last places of features to the persons that they belong to now, where nothing newer is known."""
        for feature, latest in self._places.of(features):
            owner = self._table.owner(feature)
            if owner is None:
                continue
            person = self._published.representative(owner)
            for location in [owner.location] if person is owner else [owner.location, person.location]:
                if latest.now > location.updated:
                    location.offer(latest.source, latest.place, latest.now, feature, latest.fresh, latest.lag)

    def _update_merges(self, now: float) -> bool:
        """Choose the representatives anew; returns whether one has changed."""
        persons = self._table.persons
        for first, second, likelihood in self._merges.pairs:
            for present, other in ((first, second), (second, first)):
                if likelihood >= self._threshold and present in persons and other in self._known:
                    self._table.permanent(other)
        changed = self._merges.update(persons, self._rank)
        self._published.invalidate()
        if changed:
            self._published.inherit_places()
        self._published.retain_sources(now)
        return changed

    def _rank(self, person_id: str) -> Tuple[bool, bool, int, str]:
        """Sort key of the representative of merged persons: the least one."""
        person = self._table.persons.get(person_id)
        return (not self.is_permanent(person_id) if person is None else person.anonymous,
                not self._merges.is_preferred(person_id),
                self._known.number(person_id, person.number if person is not None else 0), person_id)

    def _make_permanent(self, person_id: str) -> None:
        self._table.permanent(person_id)
        self._published.invalidate()

    def _remember(self, person_id: str) -> None:
        if self._known.add(person_id):
            self._published.invalidate()


def _camera_limits(settings: PersonManagerSettings) -> Tuple[float, float, float]:
    return settings.cross_camera_distance, settings.cross_camera_time, settings.cross_camera_handover
