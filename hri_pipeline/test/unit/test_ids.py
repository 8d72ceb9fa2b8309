"""The rules for identifiers (SPEC: they end up in topic names, TF frames and parameter names)."""

import string
import tracemalloc
from collections import Counter

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from hri_pipeline.core.ids import IdGenerator, is_valid_id

FIRST, REST = string.ascii_letters, string.ascii_letters + string.digits + "_"
OTHER = " -/.~;<>$()'\n\r\t\0\x7f\u00e4\u0301\u0660\u212a\uff11\uff21\U0001d7d8"
LEGAL = st.builds(str.__add__, st.sampled_from(FIRST), st.text(REST, max_size=31))


@given(LEGAL)
@example("x" * 32)
@example("anonymous_person_k3x9q")
def test_legal(text):
    assert is_valid_id(text)


@given(st.text(REST + OTHER) | st.builds(lambda text, place, other: text[:place] + other + text[place:],
                                         LEGAL, st.integers(0, 32), st.sampled_from(OTHER)))
@example("")
@example("x" * 33)
@example("abcde\n")
@example("\uff11a")
@example("$(a)")
def test_nothing_else_is_legal(text):
    assert is_valid_id(text) == (0 < len(text) <= 32 and text[0] in FIRST and all(letter in REST for letter in text))


@pytest.mark.parametrize("value", [None, 5, b"abcde", ["abcde"]])
def test_only_text_is_legal(value):
    assert not is_valid_id(value)


def test_an_anonymous_persons_id_and_its_frame():
    identity = "anonymous_person_" + IdGenerator(seed=1).new()
    assert is_valid_id(identity) and len(identity) == 22


@given(st.integers(), st.integers(2, 32))
def test_generated_ids_are_legal_have_their_length_and_never_repeat(seed, length):
    generator, same = IdGenerator(seed, length), IdGenerator(seed, length)
    ids = [generator.new() for _ in range(100)]
    assert len(set(ids)) == len(ids) and ids[:3] == [same.new() for _ in range(3)]
    assert all(len(identity) == length and is_valid_id(identity) and identity == identity.lower() for identity in ids)


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


@pytest.mark.parametrize("length, count", [(1, 26), (2, 26 * 36), (3, 26 * 36 * 36)])
def test_every_id_of_a_length_is_given_once(length, count):
    generator = IdGenerator(seed=6, length=length)
    assert len({generator.new() for _ in range(count)}) == count
    with pytest.raises(RuntimeError, match="all ids of {} characters".format(length)):
        generator.new()


def test_without_a_seed_ids_differ():
    first, second = IdGenerator(), IdGenerator()
    assert {first.new() for _ in range(20)}.isdisjoint({second.new() for _ in range(20)})


@pytest.mark.parametrize("length", [0, -1, 33])
def test_illegal_length(length):
    with pytest.raises(ValueError, match="1..32"):
        IdGenerator(length=length)
