"""Candidate matches: which are accepted, which groups they make, and which changes are worth solving."""

from __future__ import annotations

import random
import time
from itertools import combinations

import pytest

from hri_person_manager.core.features import Kind, MatchNode
from hri_person_manager.core.match_graph import (
    MAX_PENDING_MATCHES,
    MAX_SAID,
    MAX_SAID_NAMES,
    Association,
    CandidateMatch,
    MatchGraph,
    MatchGuard,
    RateLimit,
    SaidNames,
    path_products,
)
from hri_person_manager.core.partition import Work, best_partition

F1, F2, B1, B2 = MatchNode(Kind.FACE, "f1"), MatchNode(Kind.FACE,
                                                       "f2"), MatchNode(Kind.BODY, "b1"), MatchNode(Kind.BODY, "b2")
ANN = MatchNode(Kind.PERSON, "ann")


def face(text):
    return MatchNode(Kind.FACE, text)


def body(text):
    return MatchNode(Kind.BODY, text)


def voice(text):
    return MatchNode(Kind.VOICE, text)


def person(text):
    return MatchNode(Kind.PERSON, text)


def solve(edges, nodes=(), threshold=0.5):
    graph = MatchGraph()
    for first, second, value in edges:
        graph.set(first, second, value)
    everyone = set(nodes) | {node for edge in edges for node in edge[:2]}
    groups = graph.solve(everyone, threshold).groups
    assert sorted(node for group in groups for node in group) == sorted(everyone)
    return set(groups)


def test_a_face_and_a_body_with_one_text_are_two_things():
    assert solve([], [face("abcde"), body("abcde")]) == {
        frozenset([face("abcde")]), frozenset([body("abcde")])}
    assert solve([(face("abcde"), body("abcde"), 0.9)]) == {frozenset([face("abcde"), body("abcde")])}


@pytest.mark.parametrize("likelihood, together", [(0.49, False), (0.5, True), (1.0, True)])
def test_threshold(likelihood, together):
    assert (len(solve([(face("f"), body("b"), likelihood)])) == 1) == together


@pytest.mark.parametrize("unlikely, mixed", [(0.45, False), (0.55, True)])
def test_what_is_below_the_threshold_counts_for_nothing_among_those_that_others_link(unlikely, mixed):
    groups = solve([(face("f1"), body("b1"), 0.6), (face("f1"), body("b2"), 0.9), (face("f2"), body("b2"), 0.6),
                    (face("f2"), body("b1"), unlikely)])
    assert (frozenset([face("f1"), body("b2")]) in groups) == mixed and len(groups) == 2


def test_at_most_one_of_each_kind():
    groups = solve([(face("f1"), body("b"), 0.8), (face("f2"), body("b"), 0.9)])
    assert groups == {frozenset([face("f1")]), frozenset([face("f2"), body("b")])}


def test_fewest_groups_before_highest_affinity():
    # f1-b1 is the best single pair, yet two pairs explain everybody.
    groups = solve([(face("f1"), body("b1"), 0.99), (face("f1"), body("b2"), 0.6),
                    (face("f2"), body("b1"), 0.6)])
    assert groups == {frozenset([face("f1"), body("b2")]), frozenset([face("f2"), body("b1")])}


def test_four_kinds_in_one_person():
    nodes = [face("f"), body("b"), voice("v"), person("p")]
    edges = [(nodes[0], nodes[1], 0.6), (nodes[1], nodes[2], 0.7), (nodes[2], nodes[3], 0.8)]
    assert solve(edges) == {frozenset(nodes)}


def test_two_persons_claim_one_face():
    groups = solve([(face("f"), person("p1"), 0.7), (face("f"), person("p2"), 0.8), (face("f"), body("b"), 0.9)])
    assert groups == {frozenset([person("p1")]), frozenset([person("p2"), face("f"), body("b")])}


@pytest.mark.parametrize("far, near", [(0.55, 0.95), (0.6, 0.99), (0.55, 0.99), (0.9, 0.95), (0.51, 0.99)])
@pytest.mark.parametrize("more", [
    [], [("f1", "b", 0.9)], [("f1", "b", 0.9), ("f1", "v", 0.9)], [("f1", "b", 0.9), ("b", "v", 0.9)],
    [("f1", "b", 0.99), ("f1", "v", 0.99), ("b", "v", 0.99)], [("f1", "b", 0.9), ("f2", "b2", 0.9)]])
def test_a_name_goes_to_the_likelier_face_whatever_else_hangs_on_the_other_one(far, near, more):
    of = {"f1": face("f1"), "f2": face("f2"), "b": body("b"), "b2": body("b2"), "v": voice("v")}
    groups = solve([(of["f1"], person("p1"), far), (of["f2"], person("p1"), near)]
                   + [(of[first], of[second], value) for first, second, value in more])
    assert next(group for group in groups if person("p1") in group) >= {of["f2"]}
    assert len(groups) == 2


def test_evidence_that_follows_from_other_evidence_counts_once():
    # All three pairs of the large group say the same; as two edges of a tree they are worth less than the other choice.
    groups = solve([(face("f1"), body("b"), 0.6), (face("f1"), person("p"), 0.55), (body("b"), person("p"), 0.6),
                    (face("f2"), body("b"), 0.7)])
    assert groups == {frozenset([face("f2"), body("b"), person("p")]), frozenset([face("f1")])}


def test_path_products():
    edges = {frozenset("ab"): 0.9, frozenset("bc"): 0.5, frozenset("ac"): 0.4}
    products = path_products(list("abcd"), edges)
    assert products[frozenset("ac")] == pytest.approx(0.45)
    assert frozenset("ad") not in products


def test_who_are_told_to_be_two_part_and_nobody_else_does():
    graph, apart = MatchGraph(), frozenset([F1, ANN])
    for first, second, likelihood in ((F1, B1, 0.9), (B1, ANN, 0.8), (F2, B1, 0.6), (F2, B2, 0.9)):
        graph.set(first, second, likelihood)
    for refuted, groups in (((), [[F1, B1, ANN], [F2, B2]]), ((apart,), [[F1, B1], [ANN], [F2, B2]])):
        found = graph.solve([F1, F2, B1, B2, ANN], 0.5, refuted)
        assert set(found.groups) == set(map(frozenset, groups)) and not found.approximate


def test_who_is_absent_links_nobody():
    graph = MatchGraph()
    for other in (face("f"), person("p")):
        graph.set(body("b"), other, 0.9)
    assert set(graph.solve([face("f"), person("p")], 0.5).groups) == {frozenset([face("f")]), frozenset([person("p")])}


def test_withdrawal():
    graph = MatchGraph()
    assert graph.set(face("f"), body("b"), 0.9)
    assert not graph.set(face("f"), body("b"), 0.9)
    assert graph.set(face("f"), body("b"), 0.0)
    assert not graph.set(face("f"), body("b"), 0.0)
    assert len(graph) == 0 and not graph.neighbours(face("f")) and not graph._neighbours


def test_the_link_through_a_leaving_node_is_carried():
    graph = MatchGraph()
    graph.set(face("f"), body("b"), 0.6)
    graph.set(body("b"), person("p"), 0.7)
    graph.keep_linked(body("b"), [face("f"), body("b"), person("p")], 0.5)
    graph.remove(body("b"))
    assert graph.edges() == [(person("p"), face("f"), 0.5)]


@pytest.mark.parametrize("known", [0.0, 0.4, 0.6])
def test_who_is_linked_only_by_who_leaves_is_linked_over_the_best_way_and_once(known):
    graph = MatchGraph()
    graph.set(face("f"), person("p"), known)
    for other, likelihood in ((face("f"), 0.9), (voice("v"), 0.8), (person("p"), 0.7)):
        graph.set(body("b"), other, likelihood)
    graph.keep_linked(body("b"), [face("f"), body("b"), voice("v"), person("p")], 0.5)
    graph.remove(body("b"))
    assert sorted(graph.edges()) == sorted([
        (person("p"), face("f"), max(known, 0.5)), (face("f"), voice("v"), 0.5)])


@pytest.mark.parametrize("known, refuted, left", [
    ([(face("f"), person("p"), 0.9)], (), 0.9), ([], (), 0.5), ([], {frozenset([face("f"), person("p")])}, None)])
def test_a_link_is_carried_where_none_stays_and_nobody_denies_it(known, refuted, left):
    graph = MatchGraph()
    for edge in [(face("f"), body("b"), 0.9), (body("b"), person("p"), 0.9), *known]:
        graph.set(*edge)
    graph.keep_linked(body("b"), [face("f"), body("b"), person("p"), voice("v")], 0.5, refuted)
    assert graph.likelihood(face("f"), person("p")) == left and not graph.neighbours(voice("v"))


@pytest.mark.parametrize("before, after", [(0.5, None), (0.4, None), (0.8, 0.8)])
def test_a_body_that_keeps_the_name_of_a_face_that_leaves_keeps_none_of_an_earlier_face(before, after):
    graph, names = MatchGraph(), (person("earlier"), person("p"), voice("v"))
    for edge in zip((body("b"), face("f"), body("b"), face("f")), (*names, body("b")), (before, 0.9, 0.5, 0.9)):
        graph.set(*edge)
    graph.keep_linked(face("f"), [face("f"), body("b"), *names[1:]], 0.5)
    assert [graph.likelihood(body("b"), name) for name in names] == [after, 0.5, 0.5]


def test_the_number_of_edges_is_bounded():
    graph = MatchGraph(max_edges=10)
    for number in range(100):
        for name in ("f0", "f%d" % number):
            graph.set(face(name), body("b"), 0.9)
    assert len(graph) == 10
    assert {graph.likelihood(face(name), body("b")) for name in ("f0", "f99")} == {0.9}, "f0 is told again and again"


def affinity(group, edges):
    """Likelihood of the best tree over a group, by Kruskal's algorithm; None where it is not connected."""
    part, total = {node: {node} for node in group}, 0.0
    inside = [pair for pair in edges if pair <= set(group)]
    for first, second in sorted(map(sorted, inside), key=lambda pair: -edges[frozenset(pair)]):
        if part[first] is not part[second]:
            total += edges[frozenset((first, second))]
            part[first] |= part[second]
            part.update((node, part[first]) for node in part[second])
    return total if len(part[group[0]]) == len(group) else None


def score(groups, edges):
    """The fewest groups come first, then the highest affinity; None where a group is not connected."""
    parts = [affinity(sorted(group), edges) for group in groups]
    return None if None in parts else (-len(parts), sum(parts))


def exhaustive(nodes, edges):
    """Try all partitions."""
    best, known = None, {}

    def place(index, groups):
        nonlocal best
        if best is not None and -len(groups) < best[0]:
            return
        if index == len(nodes):
            keys = [frozenset(group) for group in groups]
            for key in keys:
                if key not in known:
                    known[key] = affinity(sorted(key), edges)
            parts = [known[key] for key in keys]
            if None not in parts:
                best = max(best or (-len(nodes), 0.0), (-len(groups), sum(parts)))
            return
        for group in groups:
            if all(member[0] != nodes[index][0] for member in group):
                group.append(nodes[index])
                place(index + 1, groups)
                group.pop()
        groups.append([nodes[index]])
        place(index + 1, groups)
        groups.pop()
    place(0, [])
    return best


def random_component(seed, most=8):
    """The largest connected part of a random graph of few nodes of four kinds."""
    chance = random.Random(seed)
    nodes = [MatchNode(kind, "%s%d" % (kind.name.lower(), number)) for kind in Kind
             for number in range(chance.randint(1, 4))]
    density, steps = chance.choice((0.25, 0.4, 0.6, 1.0)), chance.choice((5, 1000))
    graph = MatchGraph()
    for first, second in combinations(nodes, 2):
        if first.kind != second.kind and chance.random() < density:
            graph.set(first, second, 0.5 + 0.5 * chance.randint(0, steps) / steps)
    parts = [graph.component(node, 0.5, lambda node: True) for node in nodes]
    members = max([part for part in parts if len(part) <= most] or parts[:1], key=len)
    return members, {frozenset((first, second)): likelihood for first, second, likelihood in graph.edges()
                     if first in members and second in members}


@pytest.mark.parametrize("seed", range(80))
def test_small_components_are_solved_exactly(seed):
    nodes, edges = random_component(seed)
    groups, exact = best_partition(nodes, edges)
    assert exact
    assert sorted(node for group in groups for node in group) == sorted(nodes)
    assert score(groups, edges) == pytest.approx(exhaustive(nodes, edges))


@pytest.mark.parametrize("units", [0, 300, 3000])
@pytest.mark.parametrize("seed", range(0, 80, 8))
def test_with_little_work_the_groups_are_sound_and_are_not_called_the_best_unless_they_are(seed, units):
    nodes, edges = random_component(seed)
    groups, exact = best_partition(nodes, edges, Work(units))
    assert sorted(node for group in groups for node in group) == sorted(nodes)
    assert all(len({node.kind for node in group}) == len(group) for group in groups)
    found, best = score(groups, edges), exhaustive(nodes, edges)
    assert found is not None and found <= (best[0], best[1] + 1e-9)
    assert not exact or found == pytest.approx(best)


def test_seven_faces_by_seven_bodies_all_linked():
    edges = [(face("f%d" % i), body("b%d" % j), 0.95 if i == j else 0.6) for i in range(7) for j in range(7)]
    assert solve(edges) == {frozenset([face("f%d" % i), body("b%d" % i)]) for i in range(7)}


def everyone(count):
    return [make("%s%02d" % (make.__name__, number)) for make in (face, body, voice, person) for number in range(count)]


def dense(count, likelihood):
    return {frozenset((a, b)): likelihood(a, b) for a, b in combinations(everyone(count), 2) if a.kind != b.kind}


def same_human(first, second):
    return 0.9 if first.id[-2:] == second.id[-2:] else 0.55


def test_a_large_component_where_everybody_has_one_best_match_is_exact():
    groups, exact = best_partition(everyone(15), dense(15, same_human))
    assert exact and len(groups) == 15 and all(len({node.id[-2:] for node in group}) == 1 for group in groups)


def chain(count):
    kinds = (face, body, face, voice, person)
    nodes = [kinds[number % 5]("x%03d" % number) for number in range(count)]
    return {frozenset(pair): 0.5 + 0.5 * random.Random(number).random()
            for number, pair in enumerate(zip(nodes, nodes[1:]))}


def anything(seed):
    chance = random.Random(seed)
    return lambda first, second: 0.5 + 0.5 * chance.random()


@pytest.mark.parametrize("edges, most", [
    (dense(15, anything(1)), 15), (dense(28, anything(2)), 28), (dense(50, anything(3)), 50),
    (dense(7, anything(4)), 7), (chain(800), 340), (dense(28, lambda first, second: 0.9), 28)],
    ids=["15^4", "28^4", "50^4", "7^4", "chain", "alike"])
def test_the_work_on_a_component_is_bounded(edges, most):
    nodes = sorted({node for pair in edges for node in pair})
    times = []
    for _ in range(3):
        work = Work()
        begin = time.thread_time()
        groups, _ = best_partition(nodes, edges, work)
        times.append(time.thread_time() - begin)
    assert len(groups) <= most and sorted(node for group in groups for node in group) == nodes
    assert all(len({node.kind for node in group}) == len(group) for group in groups)
    assert min(times) < 0.2, "far more than the units of work should take, also on a slow machine"


def test_the_components_of_one_change_share_the_work():
    times = []
    for _ in range(3):
        graph = MatchGraph()
        for part in range(6):
            for pair, likelihood in dense(8, anything(part)).items():
                graph.set(*(MatchNode(node.kind, "%s_%d" % (node.id, part)) for node in sorted(pair)), likelihood)
        begin = time.thread_time()
        solution = graph.solve({node for edge in graph.edges() for node in edge[:2]}, 0.5)
        times.append(time.thread_time() - begin)
        assert len(solution.groups) <= 50 and len(solution.approximate) >= 32
    assert min(times) < 0.2, "far more than the units of work should take, also on a slow machine"


@pytest.fixture
def present():
    return {F1, B1, B2, ANN}


@pytest.fixture
def association(present):
    found = Association(0.5, present.__contains__, lambda person: None)
    found.solve(present)
    return found


def add(association, first, second, likelihood):
    """Whether a match was worth solving, and whether that changed a group."""
    worth = association.add(CandidateMatch(first, second, likelihood))
    return worth, association.solve((first, second))


def test_only_what_may_change_a_group_is_worth_solving(association):
    assert add(association, F1, B1, 0.4) == (False, False)
    assert add(association, F1, B1, 0.8) == (True, True)
    assert add(association, F1, B1, 0.8) == (False, False)
    assert add(association, F1, B1, 0.9) == (False, False), "the pair has no other choice"
    assert add(association, F1, B2, 0.7) == (True, False)
    assert add(association, F1, B1, 0.85) == (True, False), "now it has one"
    assert add(association, F1, B1, 0.6) == (True, True)
    assert frozenset((F1, B2)) in association.groups
    assert add(association, F1, B2, 0.3) == (True, True)
    assert add(association, F1, B1, 0.0) == (True, True)


def test_a_pending_match_counts_when_its_feature_comes(association, present):
    add(association, F1, B1, 0.6)
    association.add(CandidateMatch(F2, B1, 0.9))
    assert add(association, F1, B1, 0.7) == (False, False)
    present.add(F2)
    association.add_pending([F2])
    assert association.solve([F2]) and frozenset((F2, B1)) in association.groups
    assert association.remove(F2) == [B1]
    present.discard(F2)
    assert association.solve([B1]) and frozenset((F1, B1)) in association.groups


def test_recognised_persons_are_known_also_where_another_face_gets_the_name(association, present):
    present.add(F2)
    association.solve([F2])
    add(association, F1, ANN, 0.9)
    add(association, F2, ANN, 0.8)
    assert association.recognised_as(F1) == association.recognised_as(F2) == {"ann"}
    add(association, F2, ANN, 0.4)
    assert association.recognised_as(F2) == set()


def test_pending_matches_are_bounded(association):
    for number in range(MAX_PENDING_MATCHES + 10):
        association.add(CandidateMatch(MatchNode(Kind.FACE, "x%d" % number), B1, 0.9))
    assert len(association._pending) == MAX_PENDING_MATCHES


def test_a_sound_match_passes():
    guard = MatchGuard(10.0)
    assert guard.check("f1", 2, "b1", 3, 0.5, 0.0) == CandidateMatch(MatchNode(Kind.FACE, "f1"),
                                                                     MatchNode(Kind.BODY, "b1"), 0.5)


def test_two_persons_may_match_each_other():
    guard = MatchGuard(10.0)
    assert guard.check("ann", 1, "bob", 1, 0.5, 0.0) == CandidateMatch(MatchNode(Kind.PERSON, "ann"),
                                                                       MatchNode(Kind.PERSON, "bob"), 0.5)


@pytest.mark.parametrize("fields", [
    ("ann", 1, "ann", 1, 0.5),
    ("f1", 2, "b1", 3, float("nan")), ("f1", 2, "b1", 3, float("inf")), ("f1", 2, "b1", 3, -0.1),
    ("f1", 2, "b1", 3, 1.2), ("", 2, "b1", 3, 0.5), ("f 1", 2, "b1", 3, 0.5), ("f1", 2, "b/1", 3, 0.5),
    ("f1", 2, "b'1", 3, 0.5), ("f1", 0, "b1", 3, 0.5), ("f1", 9, "b1", 3, 0.5), ("f1", 2, "f1", 2, 0.5),
    ("f1", 2, "f2", 2, 0.5), ("f1", 2, "b1", 9, 0.5)])
def test_unsound_matches_are_refused_and_counted(fields):
    guard = MatchGuard(10.0)
    assert guard.check(*fields, 0.0) is None
    reason, = guard.refused
    assert guard.refused[reason] == 1
    assert guard.problem.endswith("likelihood {}: {}".format(fields[4], reason))
    assert repr(fields[0]) in guard.problem and repr(fields[2]) in guard.problem


def test_what_is_undisputed_is_the_best_of_both_sides():
    graph = Association(0.5, lambda node: True, lambda name: None)
    face, other = MatchNode(Kind.FACE, "f1"), MatchNode(Kind.FACE, "f2")
    ann, bob = MatchNode(Kind.PERSON, "ann"), MatchNode(Kind.PERSON, "bob")
    wanted = [(face, Kind.PERSON)]
    assert graph.undisputed(wanted) == (None, ), "nobody is said"
    graph.add(CandidateMatch(face, ann, 0.4))
    assert graph.undisputed(wanted) == (None, ), "below the threshold"
    graph.add(CandidateMatch(face, ann, 0.8))
    assert graph.undisputed(wanted) == (ann, )
    graph.add(CandidateMatch(face, bob, 0.8))
    assert graph.undisputed(wanted) is None, "two are as likely"
    graph.add(CandidateMatch(face, bob, 0.9))
    assert graph.undisputed(wanted) == (bob, )
    graph.add(CandidateMatch(other, bob, 0.9))
    assert graph.undisputed(wanted) is None, "he is somebody else as well"
    graph.add(CandidateMatch(other, bob, 0.0))
    assert graph.undisputed(wanted + [(bob, Kind.FACE)]) == (bob, face)


def test_the_rate_is_limited_and_recovers():
    guard = MatchGuard(10.0)
    taken = [guard.check("f1", 2, "b1", 3, 0.5, 0.0) is not None for _ in range(100)]
    assert sum(taken) == 10
    assert guard.check("f1", 2, "b1", 3, 0.5, 1.0) is not None
    assert guard.check("f1", 2, "b1", 3, 0.5, -100.0) is not None   # time jumped back
    assert sum(guard.check("f1", 2, "b1", 3, 0.5, 1000.0) is not None for _ in range(100)) == 10, "after a pause, too"
    assert guard.accepted == 22


def test_what_was_said_before_somebody_was_forgotten_and_comes_later_is_dropped():
    guard = MatchGuard(10.0)
    guard.forget("ann", 100.0)
    assert guard.check("f1", 2, "ann", 1, 0.9, 101.0) is None and guard.late == 1
    assert guard.check("f1", 2, "bob", 1, 0.9, 101.0) is not None
    assert guard.check("f1", 2, "ann", 1, 0.9, 103.0) is not None, "a recogniser that knows her still"
    assert not sum(guard.refused.values())
    guard.forget("bob", 104.0)
    assert list(guard._forgotten) == ["bob"], "of those forgotten before no name is kept"


def test_of_the_names_that_one_recogniser_has_for_a_face_all_but_the_best_and_newest_are_doubted():
    said = SaidNames()

    def doubted(name, likelihood, sender="eyes", of=F1):
        said.note(sender, of, name, likelihood)
        return said.doubted(F1)

    assert doubted("ann", 0.8) == set()
    assert doubted("bob", 0.8) == {"ann"}, "of two as good the newer one is right"
    assert doubted("cho", 0.7) == {"ann", "cho"}
    assert doubted("eve", 0.9, of=F2) == doubted("cho", 0.9, of=F2) == {"ann", "cho"}, "of another face"
    assert doubted("ann", 0.6, "others") == {"cho"}, "another recogniser prefers it"
    assert doubted("bob", 0.0) == {"cho"}, "withdrawn"
    said.forget("ann")
    assert said.doubted(F1) == set() and doubted("dan", 0.5) == {"dan"}
    said.retain({F2}.__contains__)
    assert said.doubted(F1) == set() and doubted("dan", 0.5) == set(), "the face had gone"
    assert said.doubted(F2) == {"eve"}


def test_names_of_faces_are_bounded():
    said = SaidNames()
    for number in range(3 * MAX_SAID_NAMES):
        said.note("eyes", F1, "p%d" % number, 0.8)
    assert len(said.doubted(F1)) == MAX_SAID_NAMES - 1
    for number in range(MAX_SAID):
        said.note("eyes", face("x%d" % number), "ann", 0.8)
    assert said.doubted(F1) == set()


def test_illegal_rate():
    with pytest.raises(ValueError):
        RateLimit(0.0)
