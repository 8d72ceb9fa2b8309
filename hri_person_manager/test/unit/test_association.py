"""Association graph: parting into groups, thresholds, withdrawal, carried links, bounded search."""

from __future__ import annotations

import time
from itertools import combinations

import pytest

from hri_person_manager.core.association import Kind, MatchGraph, Node
from hri_person_manager.core.partition import best_partition, path_products


def face(text):
    return Node(Kind.FACE, text)


def body(text):
    return Node(Kind.BODY, text)


def voice(text):
    return Node(Kind.VOICE, text)


def person(text):
    return Node(Kind.PERSON, text)


def solve(edges, nodes=(), threshold=0.5):
    graph = MatchGraph()
    for first, second, value in edges:
        graph.set(first, second, value)
    everyone = set(nodes) | {node for edge in edges for node in edge[:2]}
    return set(graph.solve(everyone, threshold).groups)


def test_a_face_and_a_body_with_one_text_are_two_things():
    assert solve([], [face("abcde"), body("abcde")]) == {
        frozenset([face("abcde")]), frozenset([body("abcde")])}
    assert solve([(face("abcde"), body("abcde"), 0.9)]) == {frozenset([face("abcde"), body("abcde")])}


@pytest.mark.parametrize("likelihood, together", [(0.49, False), (0.5, True), (1.0, True)])
def test_threshold(likelihood, together):
    assert (len(solve([(face("f"), body("b"), likelihood)])) == 1) == together


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


def test_path_products():
    edges = {frozenset("ab"): 0.9, frozenset("bc"): 0.5, frozenset("ac"): 0.4}
    products = path_products(list("abcd"), edges)
    assert products[frozenset("ac")] == pytest.approx(0.45)
    assert frozenset("ad") not in products


def test_withdrawal():
    graph = MatchGraph()
    assert graph.set(face("f"), body("b"), 0.9)
    assert not graph.set(face("f"), body("b"), 0.9)
    assert graph.set(face("f"), body("b"), 0.0)
    assert not graph.set(face("f"), body("b"), 0.0)
    assert len(graph) == 0 and not graph.neighbours(face("f"))


def test_the_link_through_a_leaving_node_is_carried():
    graph = MatchGraph()
    graph.set(face("f"), body("b"), 0.6)
    graph.set(body("b"), person("p"), 0.7)
    graph.carry(body("b"), [face("f"), body("b"), person("p")], 0.5)
    graph.remove(body("b"))
    assert graph.likelihood(face("f"), person("p")) == 0.5


def test_nothing_is_carried_where_another_link_stays():
    graph = MatchGraph()
    for first, second in combinations([face("f"), body("b"), person("p")], 2):
        graph.set(first, second, 0.9)
    graph.carry(body("b"), [face("f"), body("b"), person("p")], 0.5)
    assert graph.likelihood(face("f"), person("p")) == 0.9


def test_the_number_of_edges_is_bounded():
    graph = MatchGraph(max_edges=10)
    for number in range(100):
        graph.set(face("f%d" % number), body("b"), 0.9)
    assert len(graph) == 10
    assert graph.likelihood(face("f99"), body("b")) == 0.9


def exhaustive(nodes, edges):
    """Try all partitions, the slow and obvious way."""
    best = None
    def place(index, groups):
        nonlocal best
        if index == len(nodes):
            total = 0.0
            for group in groups:
                products = path_products(group, edges)
                if len(products) < len(group) * (len(group) - 1) // 2:
                    return
                total += sum(products.values())
            if best is None or (-len(groups), total) > best:
                best = (-len(groups), total)
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


@pytest.mark.parametrize("seed", range(12))
def test_small_components_are_solved_exactly(seed):
    import random
    chance = random.Random(seed)
    nodes = [face("f1"), face("f2"), body("b1"), body("b2"), voice("v1"), person("p1"), person("p2")]
    edges = {frozenset(pair): 0.5 + 0.5 * chance.random() for pair in combinations(nodes, 2)
             if pair[0].kind != pair[1].kind and chance.random() < 0.5}
    groups, exact = best_partition(nodes, edges)
    total = sum(sum(path_products(sorted(group), edges).values()) for group in groups)
    assert exact
    assert sorted(node for group in groups for node in group) == sorted(nodes)
    count, affinity = exhaustive(nodes, edges)
    assert -len(groups) == count
    assert total == pytest.approx(affinity)


def test_seven_faces_by_seven_bodies_all_linked():
    edges = [(face("f%d" % i), body("b%d" % j), 0.95 if i == j else 0.6) for i in range(7) for j in range(7)]
    assert solve(edges) == {frozenset([face("f%d" % i), body("b%d" % i)]) for i in range(7)}


def test_a_large_component_of_four_kinds_is_bounded_in_time():
    kinds = (face, body, voice, person)
    nodes = [make("%s%d" % (make.__name__, i)) for make in kinds for i in range(12)]
    edges = {frozenset((a, b)): 0.9 if a.id[-1] == b.id[-1] else 0.55 for a in nodes for b in nodes
             if a.kind < b.kind}
    begin = time.perf_counter()
    groups, exact = best_partition(nodes, edges)
    assert time.perf_counter() - begin < 2.0
    assert len(groups) == 12 and not exact
    assert all(len({node.kind for node in group}) == len(group) for group in groups)
