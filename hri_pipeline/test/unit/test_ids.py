"""The rules for identifiers (SPEC: they end up in topic names, TF frames and parameter names)."""

import tracemalloc
from collections import Counter

import pytest

from hri_pipeline.core.ids import IdGenerator, is_valid_id


@pytest.mark.parametrize("text", [
    "a", "Z", "abcde", "f0042", "A_b_9", "x" * 32, "anonymous_person_k3x9q", "person_", "a__b"])
def test_legal(text):
    assert is_valid_id(text)


@pytest.mark.parametrize("text", [
    "", " ", "1abcd", "_abcd", "a-b", "a b", "a/b", "/abc", "a.b", "~a", "x" * 33, "abcde\n", "abc\0", "äbcde",
    "a\u0301", "１a", "../etc", "a;b", "<a>", "$(a)", None, 5, b"abcde", ["abcde"]])
def test_illegal(text):
    assert not is_valid_id(text)


def test_an_anonymous_persons_id_and_its_frame():
    identity = "anonymous_person_" + IdGenerator(seed=1).new()
    assert is_valid_id(identity) and len(identity) == 22


def test_generated_ids_have_5_characters_and_never_repeat():
    generator = IdGenerator(seed=3)
    ids = [generator.new() for _ in range(20000)]
    assert len(set(ids)) == len(ids)
    assert all(len(identity) == 5 and is_valid_id(identity) and identity == identity.lower() for identity in ids)


def test_what_was_given_is_not_kept():
    generator = IdGenerator(seed=4)
    for _ in range(100):
        generator.new()
    tracemalloc.start()
    try:
        before, _ = tracemalloc.get_traced_memory()
        for _ in range(4000):
            generator.new()
        after, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert after - before < 2000


def test_ids_look_like_drawn_at_random():
    generator = IdGenerator(seed=5)
    ids = [generator.new() for _ in range(5000)]
    for place in range(5):
        counts = Counter(identity[place] for identity in ids).values()
        kinds = 26 if place == 0 else 36
        assert len(counts) == kinds
        # Chi-square against the even distribution: its mean is the degrees of freedom, its deviation sqrt(2 of them).
        chi = sum((count - 5000 / kinds) ** 2 / (5000 / kinds) for count in counts)
        assert chi < kinds - 1 + 5 * (2 * (kinds - 1)) ** 0.5
    # Those that follow each other have no more letters in common than others.
    alike = sum(a == b for one, other in zip(ids, ids[1:]) for a, b in zip(one, other)) / len(ids)
    assert alike == pytest.approx(1 / 26 + 4 / 36, abs=0.03)


@pytest.mark.parametrize("length, count", [(2, 26 * 36), (3, 26 * 36 * 36)])
def test_every_id_of_a_length_is_given_once(length, count):
    generator = IdGenerator(seed=6, length=length)
    assert len({generator.new() for _ in range(count)}) == count
    with pytest.raises(RuntimeError, match="all ids"):
        generator.new()


def test_a_short_generator_gives_all_its_ids_and_then_says_so():
    generator = IdGenerator(seed=0, length=1)
    assert len({generator.new() for _ in range(26)}) == 26
    with pytest.raises(RuntimeError, match="1 characters"):
        generator.new()


def test_same_seed_same_ids_and_no_seed_different_ids():
    assert [IdGenerator(seed=7).new()] == [IdGenerator(seed=7).new()]
    first, second = IdGenerator(), IdGenerator()
    assert {first.new() for _ in range(20)}.isdisjoint({second.new() for _ in range(20)})


@pytest.mark.parametrize("length", [0, -1, 33])
def test_illegal_length(length):
    with pytest.raises(ValueError, match="1..32"):
        IdGenerator(length=length)
