"""Places by rays: their covariances, distances and what several tell together."""

from __future__ import annotations

import numpy as np
import pytest

from hri_person_manager.core.triangulation import (
    ACROSS,
    FRESH_S,
    Estimate,
    SensorTrack,
    Walk,
    aged,
    aged_in,
    crossing_distances,
    ellipse,
    ray_covariance,
    shares,
    squared_distances,
    voice_covariance,
    walk_evidence,
    weighted,
)

LEFT, RIGHT = np.array([0.0, 0.0, 1.5]), np.array([4.0, 0.0, 1.5])


def fuse(positions, covariances):
    """Mean (3,) and covariance (3, 3) of independent places (N, 3) of one point, covariances (N, 3, 3)."""
    weights, covariance = shares(np.linalg.inv(covariances))
    return weighted(weights, positions[:, :, None])[:, 0], covariance


def test_a_place_is_long_along_its_ray():
    covariance = ray_covariance(np.array([0.0, 3.0, 1.5]), LEFT)
    assert np.sqrt(np.diag(covariance)) == pytest.approx([0.06, 0.36, 0.06])
    assert np.sqrt(np.diag(ray_covariance(np.array([0.0, 3.0, 1.5]), LEFT, along=0.03, exactness=0.08)))[:2] == (
        pytest.approx([0.1, np.hypot(np.hypot(0.09, 0.08), 0.0)], abs=1e-3))
    ray = np.array([0.4, -2.0, 0.7])
    expected = (0.1 ** 2 - ACROSS ** 2) * np.outer(ray, ray) + (ACROSS ** 2 * (ray @ ray) + 0.05 ** 2) * np.eye(3)
    np.testing.assert_allclose(ray_covariance(RIGHT + ray, RIGHT, along=0.1, exactness=0.05), expected, atol=1e-15)


def test_rays_that_cross_place_a_person_however_wrong_the_distances_are():
    person = np.array([2.0, 2.0, 1.2])
    places = np.array([LEFT + 1.12 * (person - LEFT), RIGHT + 0.88 * (person - RIGHT)])
    position, covariance = fuse(places, np.array([ray_covariance(places[0], LEFT), ray_covariance(places[1], RIGHT)]))
    assert np.linalg.norm(places - person, axis=1).min() > 0.3
    assert np.linalg.norm(position - person) < 0.03 and np.sqrt(np.trace(covariance)) < 0.12


def test_the_distance_counts_in_deviations():
    covariances = np.array([ray_covariance(np.array([0.0, 3.0, 1.5]), LEFT)] * 2)
    pairs = np.array([[0, 1], [0, 0]])
    along = squared_distances(np.array([[0.0, 3.0, 1.5], [0.0, 3.6, 1.5]]), covariances, pairs)
    across = squared_distances(np.array([[0.0, 3.0, 1.5], [0.6, 3.0, 1.5]]), covariances, pairs)
    assert np.sqrt(along[0]) == pytest.approx(0.6 / (0.36 * np.sqrt(2.0)))
    assert np.sqrt(across[0]) == pytest.approx(0.6 / (0.06 * np.sqrt(2.0))) and along[1] == 0.0


def crossing_distance(positions, covariances, origins, first, second):
    """The squared distance of one pair, step by step."""
    middle, _ = fuse(positions[[first, second]], covariances[[first, second]])
    both = covariances[first] + covariances[second]
    for number in (first, second):
        if np.isfinite(origins[number]).all():
            ray = positions[number] - origins[number]
            longer = np.sum((middle - origins[number]) ** 2) / (ray @ ray)
            along = ray @ covariances[number] @ ray / (ray @ ray)
            both = both + (min(max(longer, 0.3), 3.0) - 1.0) * along / (ray @ ray) * np.outer(ray, ray)
    offset = positions[first] - positions[second]
    return offset @ np.linalg.solve(both, offset)


def test_distances_of_many_pairs_are_those_of_each_one():
    rng = np.random.default_rng(3)
    positions, origins = rng.uniform((0.0, 2.0, 1.2), (4.0, 6.0, 1.8), (8, 3)), np.array([LEFT, RIGHT] * 4)
    covariances = np.array([ray_covariance(*both) for both in zip(positions, origins)])
    origins[5] = np.nan
    pairs = np.array([[one, other] for other in range(8) for one in range(other)])
    found = crossing_distances(positions, covariances, origins, pairs)
    assert found == pytest.approx([crossing_distance(positions, covariances, origins, *pair) for pair in pairs])
    plain = squared_distances(positions, covariances, pairs)
    assert np.isfinite(found).all() and (found < plain).any() and (found > plain).any()


def test_a_voice_tells_a_direction_and_hardly_a_distance():
    place = np.array([1.0, 0.0, 1.5])       # as voices are placed, 1 m away
    covariance = voice_covariance(place, LEFT)
    along, side = np.sqrt(covariance[0, 0]), np.sqrt(covariance[1, 1])
    assert 1.3 < along < 1.5 and 0.3 < side < 0.33 and covariance[0, 1] == 0.0
    assert voice_covariance(LEFT, LEFT)[0, 0] > 0.0, "a place at the microphones is no mistake"


def walk(stamp, x, speed=1.0, height=1.6, shared=0.0):
    return Walk(stamp, np.array([x, 3.0, height]), np.diag([0.04, 0.09, 0.0025]), np.array([speed, 0.0, 0.0]),
                np.diag([0.01, 0.02, 0.01]), np.array([0.0, shared, 0.0]))


def test_who_walks_on_as_before_is_more_likely_the_same_than_somebody_else():
    on = walk_evidence(walk(0.0, 0.0), walk(1.0, 1.0))
    assert on > 3.0 and walk_evidence(walk(0.0, 0.0), walk(1.0, 1.0, height=1.3)) < on - 2.0
    assert walk_evidence(walk(0.0, 0.0), walk(1.0, 1.0, speed=-1.0)) < -2.0
    assert walk_evidence(walk(0.0, 0.0), walk(1.0, 3.0)) < 0.0
    assert walk_evidence(walk(0.0, 0.0), walk(4.0, 4.0)) < on, "the longer away, the less it says"


def test_where_several_cameras_saw_the_end_of_a_walk_is_where_it_goes_on():
    """The last one to see it was .5 m wrong."""
    seen = Estimate(np.array([0.5, 3.0, 1.6]), np.zeros(3), 0.002 * np.eye(3))
    there, elsewhere = (walk_evidence(walk(0.0, 0.0), walk(1.0, x), seen) for x in (1.5, 1.0))
    assert there > walk_evidence(walk(0.0, 0.0), walk(1.0, 1.5)) + 0.5 and there > elsewhere + 0.5


def test_an_error_that_both_cameras_share_cancels():
    apart = Walk(1.0, np.array([1.0, 3.5, 1.6]), *walk(0.0, 0.0)[2:])
    shared = apart._replace(shared=np.array([0.0, 0.2, 0.0]))
    assert walk_evidence(walk(0.0, 0.0, shared=0.2), shared) < walk_evidence(walk(0.0, 0.0), apart)


def test_the_error_of_the_size_of_a_person_is_along_the_ray():
    track = SensorTrack("left")
    place = np.array([0.0, 3.0, 1.5])
    for number in range(20):
        track.add(0, place, ray_covariance(place, LEFT), LEFT, 0.1 * number)
    assert track.walk(begins=True).shared == pytest.approx([0.0, np.sqrt(0.44) * 0.36, 0.0], abs=1e-9)
    assert not SensorTrack("left").shared_error(place).any(), "whose camera is nowhere"


def test_a_place_that_is_not_renewed_grows():
    start = np.diag([0.04, 0.01, 0.01])
    spreads = [np.sqrt(aged(start, elapsed)[1, 1]) for elapsed in (-1.0, 0.0, 0.5, 2.0, 10.0)]
    assert spreads[:2] == [0.1, 0.1] and spreads == sorted(spreads)
    # 0.5 m/s at first; after some seconds as a random walk.
    assert spreads[2] == pytest.approx(np.hypot(0.1, 0.25), abs=0.03) and 1.5 < spreads[4] < 2.5


def test_who_is_out_of_sight_walks_away_to_the_sides_and_not_up_unless_a_camera_may_be_tilted():
    start = np.diag([0.01, 0.01, 0.01])
    level, tilted = (np.sqrt(np.diag(aged_in(start, 20.0, optical))) for optical in (False, True))
    assert level[0] == level[1] == tilted[0] == tilted[2] > 2.0 and level[2] < 0.3
    assert aged_in(start, 0.0, False) == pytest.approx(start)


BEST, WORSE = 0, 2


def track_of(*places):
    """What one camera tells: its track by (source, x in m, from s, to s), ten places a second, in turn."""
    track = SensorTrack("left")
    for source, x, begin, end in places:
        for stamp in np.arange(begin, end - 1e-6, 0.1):
            track.add(source, np.array([x, 3.0, 1.5]), ray_covariance(np.array([x, 3.0, 1.5]), LEFT), LEFT, stamp)
    return track


def test_the_better_source_tells_where_somebody_is_until_it_is_silent():
    """What a body tells is .5 m beside what the face tells: going over to it is no step of the person."""
    track = SensorTrack("left")
    for step in range(40):
        for source, x, ends in ((BEST, 1.0, 20), (WORSE, 1.5, 40)):
            if step < ends:
                track.add(source, np.array([x, 3.0, 1.5]), np.eye(3), LEFT, 0.11 * step)
        place = track.at(0.11 * step)
        expected = 1.0 if 0.11 * (step - 19) <= FRESH_S else 1.5
        assert place.position[0] == pytest.approx(expected) and place.velocity == pytest.approx(np.zeros(3))
    assert track.ended == pytest.approx(0.11 * 39)
    track.add(BEST, np.array([1.0, 3.0, 1.5]), np.eye(3), LEFT, 4.4)
    assert track.at(4.4).position[0] == pytest.approx(1.0), "which is used again at once"


def test_what_is_told_late_or_twice_changes_nothing():
    track = track_of((BEST, 1.0, 0.0, 2.0))
    for stamp in (1.9, 1.5):
        track.add(BEST, np.array([9.0, 3.0, 1.5]), np.eye(3), LEFT, stamp)
    assert track.at(1.9).position[0] == pytest.approx(1.0) and (track.began, track.ended) == pytest.approx((0.0, 1.9))


def test_after_a_gap_a_stretch_begins_of_which_the_places_before_tell_nothing():
    track = track_of((BEST, 1.0, 0.0, 2.0), (BEST, 4.0, 3.0, 3.5))
    assert (track.began, track.ended) == pytest.approx((3.0, 3.4))
    assert track.resting_place[0] == pytest.approx(4.0) and track.walk(begins=True).position[0] == pytest.approx(4.0)


def test_after_a_jump_of_time_a_track_begins_anew_by_whatever_source():
    for before, after in ((BEST, BEST), (WORSE, WORSE), (BEST, WORSE)):
        track = track_of((WORSE, 0.0, 99.0, 99.1), (before, 1.0, 100.0, 102.0), (after, 4.0, 5.0, 6.0))
        assert (track.began, track.ended) == pytest.approx((5.0, 5.9)), (before, after)
        assert track.at(5.9).position[0] == track.resting_place[0] == pytest.approx(4.0)
        assert track.at(5.9).velocity == pytest.approx(np.zeros(3))


def test_an_ellipse_is_as_large_and_turned_as_its_covariance():
    turn = np.deg2rad(30.0)
    axes = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    major, minor, found = ellipse(axes @ np.diag([0.09, 0.01]) @ axes.T)
    assert (major, minor) == pytest.approx((0.3 * np.sqrt(5.991), 0.1 * np.sqrt(5.991)))
    assert np.sin(found - turn) == pytest.approx(0.0, abs=1e-9)
    drawn = np.random.default_rng(1).normal(size=(20000, 2))
    assert np.mean((drawn ** 2).sum(axis=1) <= 5.991) == pytest.approx(0.95, abs=0.005)


@pytest.mark.parametrize("far", [1e3, 1e6, 1e9])
def test_a_voice_told_far_away_has_a_covariance_to_reckon_with(far):
    covariance = voice_covariance(np.full(3, far), np.zeros(3))
    assert np.linalg.eigvalsh(covariance).min() > 0.0 and np.isfinite(np.linalg.solve(covariance, np.ones(3))).all()
