"""Bodies that come back under a new id."""

from __future__ import annotations

import numpy as np
import pytest

from hri_fullbody.core.tracking.reidentification import (
    LEAST_LIKELIHOOD,
    WATCH_S,
    BodyReidentifier,
    TrackAppearance,
    difference,
    marginals,
)
from hri_pipeline.core.tracks import appearance_distances


def clothes(seed, noise=0.0):
    """Histograms (5, 21) of somebody's clothes, seen with some noise."""
    generator = np.random.default_rng(seed)
    looks = np.zeros((5, 21))
    for row in looks:
        row[generator.choice(21, 3, replace=False)] = (0.5, 0.3, 0.2)
    looks = looks + noise * np.random.default_rng(seed + 100).random((5, 21)) / 21.0
    return looks / looks.sum(axis=1, keepdims=True)


def body(name, seed, x=0.0, noise=0.3, **more):
    return TrackAppearance(name, clothes(seed, noise), np.array([x, 0.0, 3.0]), **more)


def show(known, begin, end, *bodies):
    """Show bodies ten times a second; returns what is told of them."""
    return [item for stamp in np.arange(begin, end - 1e-6, 0.1) for item in known.update(bodies, stamp)]


def told(known, begin, end, *bodies):
    return [(item.id, item.earlier) for item in show(known, begin, end, *bodies)]


def after(*earlier, watched=20.0):
    """Return a reidentifier that has seen these bodies leave after some quiet time."""
    known = BodyReidentifier(10.0)
    show(known, 0.0, watched, *earlier)
    known.update([], watched)
    return known


def test_who_comes_back_in_the_same_clothes_is_known_again_once():
    known = after(body("a", 1))
    assert told(known, 21.0, 21.0 + WATCH_S - 0.05, body("b", 1, 0.5, 0.5)) == []
    (found,) = show(known, 21.0 + WATCH_S, 22.5, body("b", 1, 0.5, 0.5))
    assert (found.id, found.earlier) == ("b", "a") and LEAST_LIKELIHOOD <= found.likelihood < 1.0
    assert told(known, 22.5, 25.0, body("b", 1, 0.5, 0.5)) == []


def test_other_clothes_too_far_or_too_late_are_somebody_else():
    for begin, new in ((21.0, body("b", 2)), (20.2, body("b", 1, 5.0)), (30.6, body("b", 1)), (31.0, body("b", 1))):
        assert told(after(body("a", 1)), begin, begin + 3.0, new) == []


@pytest.mark.parametrize("face, more, is_told", [
    ("old", dict(noise=1.2), True), ("old", dict(noise=1.5), False), (None, dict(noise=1.5), False),
    ("old", dict(noise=1.5, face="new"), False), ("old", dict(noise=1.5, face="old"), True),
    ("old", dict(face="new"), True),
    ("old", dict(stature=1.75, stature_sd=0.03), True), ("old", dict(stature=1.72, stature_sd=0.03), False)],
    ids=["clothes alike", "clothes", "clothes, no faces", "clothes, a face that nobody had", "clothes, the same face",
         "a face that nobody had", "stature alike", "stature"])
def test_what_differs_too_much_is_of_somebody_else_however_well_all_else_fits(face, more, is_told):
    known = after(body("a", 1, face=face, stature=1.80, stature_sd=0.03))
    assert told(known, 20.2, 23.0, body("b", 1, **more)) == [("b", "a")] * is_told


@pytest.mark.parametrize("x, is_told", [(1.0, True), (2.3, False)])
def test_nobody_is_somewhere_else_faster_than_people_run_whatever_the_face(x, is_told):
    assert told(after(body("a", 1, face="f")), 20.2, 23.0, body("b", 1, x, face="f")) == [("b", "a")] * is_told


def test_who_comes_out_while_the_body_is_still_waited_for_where_it_vanished_is_known_once_that_is_given_up():
    known, hidden = BodyReidentifier(10.0), body("a", 1, visible=False)
    show(known, 0.0, 20.0, body("a", 1))
    assert told(known, 20.0, 21.5, hidden) == told(known, 21.5, 22.0, hidden, body("b", 1)) == []
    assert told(known, 22.0, 24.0, body("b", 1)) == [("b", "a")]


@pytest.mark.parametrize("x, is_told", [(0.2, [("b", "a")]), (5.0, [])])
def test_the_first_place_counts_also_of_who_gets_it_later_than_the_clothes(x, is_told):
    known = after(body("a", 1))
    told(known, 20.2, 20.6, body("b", 1)._replace(place=None))
    assert told(known, 20.6, 23.0, body("b", 1, x)) == is_told


@pytest.mark.parametrize("placed", ["a", "b", ""])
def test_without_a_place_of_both_the_clothes_tell(placed):
    old, new = (body(name, 1, 5.0 * (name == "b")) for name in "ab")
    old, new = (one if one.id == placed else one._replace(place=None) for one in (old, new))
    assert told(after(old), 20.2, 23.0, new) == [("b", "a")]


@pytest.mark.parametrize("shown, hides, new, is_told", [
    (dict(face="f"), dict(face=None), dict(noise=1.5, face="f"), True),
    (dict(stature=1.80, stature_sd=0.03), {}, dict(stature=1.62, stature_sd=0.03), False),
    ({}, dict(appearance=None), {}, True),
    ({}, dict(place=None), dict(x=5.0), False),
    (dict(x=5.0), {}, dict(x=5.0), True)], ids=["face", "stature", "clothes", "place", "another place"])
def test_what_a_body_has_shown_last_is_known_of_it_when_it_is_lost(shown, hides, new, is_told):
    known = BodyReidentifier(10.0)
    show(known, 0.0, 10.0, body("a", 1))
    show(known, 10.0, 19.0, body("a", 1, **shown))
    show(known, 19.0, 20.0, body("a", 1, shown.get("x", 0.0))._replace(**hides))
    assert told(known, 20.0, 23.0, body("b", 1, **new)) == [("b", "a")] * is_told


def test_who_was_there_for_a_moment_only_is_not_remembered():
    known, other = BodyReidentifier(10.0), body("x", 9)
    show(known, 0.0, 20.0, other)
    show(known, 20.0, 20.5, other, body("a", 1))
    assert told(known, 20.5, 23.0, other, body("b", 1)) == []


def test_two_who_were_seen_at_once_are_two():
    known = after(body("c", 3))
    show(known, 20.0, 25.0, body("a", 1))
    show(known, 25.0, 25.5, body("a", 1), body("b", 1))
    assert told(known, 25.5, 28.0, body("b", 1)) == []


def test_who_was_found_again_is_nobody_else_who_comes():
    known = after(body("a", 1))
    assert told(known, 21.0, 23.0, body("b", 1)) == [("b", "a")]
    assert told(known, 23.0, 26.0, body("b", 1), body("c", 1)) == []


def test_who_comes_and_goes_is_known_each_time():
    known = after(body("a0", 1))
    for number in range(1, 12):
        begin = 18.0 + 4.0 * number
        assert told(known, begin - 1.0, begin + 1.0, body("a%d" % number, 1)) == [
            ("a%d" % number, "a%d" % (number - 1))]
        known.update([], begin + 1.0)


def test_who_is_still_there_or_only_hidden_is_not_lost():
    known = BodyReidentifier(10.0)
    show(known, 0.0, 20.0, body("a", 1))
    assert told(known, 20.0, 23.0, body("a", 1), body("b", 1)) == []
    assert told(known, 23.0, 25.0, body("a", 1, visible=False), body("b", 1), body("c", 1)) == []


def test_two_in_uniform_are_not_guessed_at_and_two_in_their_own_clothes_are_told_apart():
    assert told(after(body("a", 1), body("b", 1)), 21.0, 24.0, body("c", 1)) == []
    known = after(body("a", 1), body("b", 2))
    assert sorted(told(known, 21.0, 24.0, body("d", 2), body("c", 1))) == [("c", "a"), ("d", "b")]


def test_of_two_who_come_in_the_same_clothes_neither_is_told():
    assert told(after(body("a", 1)), 21.0, 24.0, body("b", 1), body("c", 1)) == []


def test_clothes_that_many_wear_say_little():
    known = BodyReidentifier(10.0)
    show(known, 0.0, 20.0, *[body("w%d" % number, 1) for number in range(6)], body("a", 1))
    known.update([body("w%d" % number, 1) for number in range(6)], 20.0)
    assert told(known, 21.0, 24.0, *[body("w%d" % number, 1) for number in range(6)], body("b", 1)) == []


def test_where_strangers_come_all_the_time_a_return_is_less_likely():
    likelihoods = []
    for strangers in (0, 12):
        known = BodyReidentifier(10.0)
        for number in range(24):
            passing = [body("s%d" % number, 100 + number)] if number < strangers else []
            show(known, 2.0 * number, 2.0 * number + 2.0, *passing)
        show(known, 48.0, 52.0, body("a", 1))
        known.update([], 52.0)
        (found,) = show(known, 53.0, 55.0, body("b", 1)) or [None]
        likelihoods.append(0.0 if found is None else found.likelihood)
    assert likelihoods[1] < likelihoods[0] - 0.005


def test_who_is_there_from_the_start_is_no_stranger_that_comes():
    likelihoods = []
    for number in (0, 12):
        known, there = BodyReidentifier(10.0), [body("s%d" % one, 100 + one) for one in range(number)]
        show(known, 0.0, 2.0, *there)
        show(known, 48.0, 52.0, body("a", 1))
        known.update([], 52.0)
        (found,) = show(known, 53.0, 55.0, body("b", 1))
        likelihoods.append(found.likelihood)
    assert likelihoods[1] >= likelihoods[0]


def test_a_stature_that_differs_is_somebody_else_and_one_that_is_measured_badly_says_nothing():
    def tall(name, stature, sd):
        return body(name, 1, stature=stature, stature_sd=sd)
    assert told(after(tall("a", 1.80, 0.03)), 21.0, 24.0, tall("b", 1.62, 0.03)) == []
    assert told(after(tall("a", 1.80, 0.15)), 21.0, 24.0, tall("b", 1.62, 0.15)) == [("b", "a")]
    assert told(after(tall("a", 1.80, 0.03)), 21.0, 24.0, body("b", 1)) == [("b", "a")]
    assert told(after(body("a", 1)), 21.0, 24.0, tall("b", 1.62, 0.03)) == [("b", "a")]


def test_a_face_that_goes_on_is_the_same_human_and_that_of_another_is_not():
    known = after(body("a", 1, face="f"), watched=3.0)
    assert told(known, 12.0, 14.0, body("b", 1, 2.0, noise=0.8, face="f")) == [("b", "a")]
    known = BodyReidentifier(10.0)
    show(known, 0.0, 20.0, body("a", 1), body("x", 2, face="f"))
    known.update([body("x", 2, face="f")], 20.0)
    assert told(known, 21.0, 24.0, body("b", 1, face="f"), body("x", 2)) == []


def test_a_body_that_does_not_show_itself_yet_is_told_of_when_it_does():
    known = after(body("a", 1))
    assert told(known, 21.0, 23.0, TrackAppearance("b", None, None)) == []
    assert told(known, 23.0, 23.5, body("b", 1)) == [("b", "a")]


def test_nothing_is_remembered_without_memory_after_a_reset_or_beyond_the_bound():
    for known in (BodyReidentifier(0.0), BodyReidentifier(10.0)):
        show(known, 0.0, 5.0, body("a", 1))
        if known._memory:
            known.reset()
        assert told(known, 6.0, 9.0, body("b", 1)) == []
    known = BodyReidentifier(1e9)
    for number in range(200):
        known.update([body("a%d" % number, number)], 2.0 * number)
        known.update([body("a%d" % number, number)], 2.0 * number + 1.5)
    assert len(known._lost) <= 51
    with pytest.raises(ValueError, match="memory"):
        BodyReidentifier(-1.0)


def test_differences_from_many_are_those_from_each():
    many = np.stack([clothes(seed, 0.3) for seed in range(8)])
    many[2, 1:] = many[3, :2] = many[4] = 0.0
    one = many[0].copy()
    one[0] = 0.0
    wanted = [np.nan if apart is None else apart for apart in (difference(one, other) for other in many)]
    assert np.isnan(wanted).sum() == 2
    assert appearance_distances(one, many) == pytest.approx(np.array(wanted), abs=1e-9, nan_ok=True)


def test_probabilities_of_an_assignment_exclude_that_somebody_is_two():
    """One new and one lost: o / (1 + o). Two new who claim one: neither. Two clear pairs: both, in spite of a rival."""
    assert marginals(np.array([[9.0]])) == pytest.approx(np.array([[0.9]]))
    assert marginals(np.array([[20.0], [20.0]])) == pytest.approx(np.full((2, 1), 20.0 / 41.0), abs=1e-3)
    clear = marginals(np.array([[30.0, 10.0], [0.1, 100.0]]))
    assert clear[0, 0] > 0.95 and clear[1, 1] > 0.95 and (clear.sum(axis=1) <= 1.0).all()


def test_places_of_a_camera_that_stands_are_not_compared_with_those_in_the_room():
    """The transforms of the camera came while somebody was away."""
    assert told(after(body("a", 1)), 20.5, 23.0, body("b", 1, 9.0, still=True, distance=3.0)) == [("b", "a")]
    assert told(after(body("a", 1)), 20.5, 23.0, body("b", 1, 9.0)) == []


def test_how_exact_a_place_is_depends_on_the_way_to_the_camera_not_on_the_origin_of_the_room():
    def of(name, x, **more):
        return body(name, 1, x, still=True, distance=3.0, **more)

    assert told(after(of("a", 60.0)), 20.2, 23.0, of("b", 60.3)) == [("b", "a")]
    assert told(after(of("a", 60.0)), 20.2, 23.0, of("b", 66.0)) == []
