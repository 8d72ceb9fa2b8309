"""The rules for identifiers (SPEC: they end up in topic names, TF frames and parameter names)."""

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
