"""Which new features wait before they are told as somebody new: for their matches, names and places.

A face without a body, or a body without a face, that stands where the other half lacks it is the same human, as a rule,
and its match comes a moment later; on a loaded machine, seconds later. Who appears where somebody was lost is that
person, as a rule, and who knows people by face or clothes says so a moment later.
"""

from __future__ import annotations

import math
from typing import Callable, Dict, FrozenSet, Iterable, List, Mapping, Set

import numpy as np

from hri_person_manager.core.features import Kind, MatchNode
from hri_person_manager.core.location import Decay, FeaturePlaces, is_at
from hri_person_manager.core.persons import PersonEntry
from hri_pipeline.core.tracks import assign

MATCH_WAIT_S = 5.0            # for which a body at the place of a face that has none, or a face, waits for their match,
#                               and longer where one of them lags
PLACE_WAIT_S = 1.5            # for which one without a place yet waits beside a face, or body, that has one
PARTED_WAIT_S = 2.5           # for which a body waits whose face has got another one: mostly there is nobody
RETURN_WAIT_S = 1.5           # for which one where somebody was lost waits to be recognised
SINGLE_WAIT_S = 15.0          # for which one that a single old image has placed waits for a newer one
MATCH_GATE = 9.0              # squared Mahalanobis distance up to which they are at one place


def waiting_for_matches(new: Mapping[MatchNode, float], groups: Iterable[FrozenSet[MatchNode]], places: FeaturePlaces,
                        is_refuted: Callable[[MatchNode, MatchNode], bool], now: float) -> Set[MatchNode]:
    """Return the new features at the place of a face, or body, of one camera that lacks them, or that may be there.

    A body that has begun anew is listed beside its old id for some images: the old one is nobody else either.

    Parameters
    ----------
    new : features without a person, with the time (s) since when.
    groups : who belongs together, of all features.
    places : where features are.
    is_refuted : tells of a face and a body that they are two people's.
    now : time (s).
    """
    if not new:
        return set()
    halves: Dict[Kind, List[MatchNode]] = {Kind.FACE: [], Kind.BODY: []}
    groups = tuple(groups)
    outdated = places.outdated([node for group in groups for node in group if node.kind == Kind.BODY], MATCH_GATE)
    for group in groups:
        seen = [node for node in group if node.kind in halves and node not in outdated]
        if len(seen) == 1:
            halves[seen[0].kind].append(seen[0])
    faces, bodies = halves[Kind.FACE], halves[Kind.BODY]
    costs = places.squared_distances(faces, bodies)
    for row, column in np.argwhere(costs <= MATCH_GATE).tolist():
        face, body = faces[row], bodies[column]
        if not (face in new or body in new) or is_refuted(face, body):
            costs[row, column] = math.inf
    pairs = [(faces[row], bodies[column]) for row, column in assign(costs, MATCH_GATE)]
    matched = {node for face, body in pairs for node in [body if body in new else face]
               if now - new[node] <= MATCH_WAIT_S + places.match_delay(face, body)}
    parted = parted_from_faces({node for node, since in new.items() if node.kind == Kind.BODY
                                and now - since <= PARTED_WAIT_S}, groups, is_refuted)
    return matched | parted | outdated.intersection(new) | waiting_for_places(
        {node for node, since in new.items() if now - since <= PLACE_WAIT_S}, faces, bodies, places)


def parted_from_faces(bodies: Set[MatchNode], groups: Iterable[FrozenSet[MatchNode]],
                      is_refuted: Callable[[MatchNode, MatchNode], bool]) -> Set[MatchNode]:
    """Return those of the new bodies that are said not to be a face's which has another body.

    A body that the network makes out of two who stand side by side is first taken for one of them, and goes on for a
    moment when the right one has come.
    """
    if not bodies:
        return set()
    faces = [node for group in groups if any(node.kind == Kind.BODY for node in group)
             for node in group if node.kind == Kind.FACE]
    return {body for body in bodies if any(is_refuted(face, body) for face in faces)}


def waiting_for_places(new: Set[MatchNode], faces: List[MatchNode], bodies: List[MatchNode],
                       places: FeaturePlaces) -> Set[MatchNode]:
    """Return those of the new features that have no place yet, while a half of the other kind, without them, has one.

    faces, bodies : those without the other half.
    """
    placed = {node for node, _ in places.of([*faces, *bodies])}
    return {node for ones, others in ((faces, bodies), (bodies, faces)) if placed.intersection(others)
            for node in ones if node in new and node not in placed}


def waiting_for_names(new: Mapping[MatchNode, float], persons: Iterable[PersonEntry], places: FeaturePlaces,
                      decay: Decay, now: float) -> Set[MatchNode]:
    """Return the new features where somebody was lost: when a camera turns back, it is the same people, as a rule, and
    who knows them by face or clothes says so a moment later.

    new, places, now : as in waiting_for_matches. decay: of places of people who are not seen.
    """
    latest = [node for node, since in new.items() if now - since <= RETURN_WAIT_S]
    waiting: Set[MatchNode] = set()
    for person in persons if latest else ():
        if any(node.kind != Kind.VOICE for node in person.features) or not person.location.confidence(now, decay) > 0.0:
            continue
        place = person.location.place
        waiting.update(node for node, seen in places.of(latest) if place is not None and (
            node.kind == Kind.BODY or not person.anonymous) and is_at(seen.place, place, MATCH_GATE))
    return waiting
