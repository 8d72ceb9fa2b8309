"""Size of the head from several sources."""

import numpy as np
import pytest

from hri_pipeline.core.faces.head_scale import (
    PRIOR_SD,
    HeadScale,
    scale_from_depth,
    scale_from_stature,
)


def settled(scale, stamp=100.0):
    scale.estimate(stamp)
    for step in range(1, 40):
        found = scale.estimate(stamp + 0.5 * step)
    return found


def test_nothing_known_is_the_prior():
    assert settled(HeadScale()) == pytest.approx((1.0, PRIOR_SD))


def test_a_depth_image_decides_and_an_iris_helps():
    iris, depth = HeadScale(), HeadScale()
    for _ in range(50):
        iris.add("iris", 0.9)
        depth.add("depth", 0.9)
    by_iris, by_depth = settled(iris), settled(depth)
    assert 0.92 < by_iris[0] < 0.97 and 0.03 < by_iris[1] < PRIOR_SD
    assert by_depth[0] == pytest.approx(0.9, abs=0.01) and by_depth[1] < 0.02


def test_an_error_that_stays_with_the_person_does_not_average_out():
    scale = HeadScale()
    for _ in range(100000):
        scale.add("iris", 1.1)
    assert settled(scale)[1] > 0.03


def test_over_many_people_the_stated_error_is_the_true_one():
    random = np.random.RandomState(4)
    errors = []
    for _ in range(300):
        truth = np.exp(random.normal(0.0, PRIOR_SD))
        person = np.exp(random.normal(0.0, 0.05))
        scale = HeadScale()
        for _ in range(30):
            scale.add("iris", truth * person * np.exp(random.normal(0.0, 0.05)))
        found, sd = settled(scale)
        errors.append((found - truth) / sd)
    assert 0.85 < np.std(errors) < 1.15
    assert abs(np.mean(errors)) < 0.15


def test_a_size_does_not_jump():
    scale = HeadScale()
    scale.estimate(0.0)
    for _ in range(50):
        scale.add("depth", 0.85)
    assert scale.estimate(0.05)[0] > 0.98
    assert scale.estimate(5.0)[0] < 0.87


def test_a_person_that_was_taken_for_another_is_corrected_in_time():
    scale = HeadScale()
    for _ in range(500):
        scale.add("depth", 0.9)
    for _ in range(300):
        scale.add("depth", 1.1)
    assert settled(scale)[0] == pytest.approx(1.1, abs=0.02)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 0.0, -1.0, 0.3, 3.0])
def test_nonsense_is_ignored(value):
    scale = HeadScale()
    scale.add("depth", value)
    assert settled(scale) == pytest.approx((1.0, PRIOR_SD))


def test_an_unknown_source_is_an_error_of_the_program():
    with pytest.raises(KeyError):
        HeadScale().add("horoscope", 1.0)


def test_stature():
    assert scale_from_stature(1.70) == pytest.approx(1.0)
    assert 0.91 < scale_from_stature(1.10) < 0.95
    assert scale_from_stature(1.95) > 1.0


def depth_case(depth):
    mesh = np.zeros((478, 3))
    mesh[:20, 0], mesh[:20, 1] = np.arange(20) * 3 + 10, 40
    return scale_from_depth(mesh, np.full(20, 2.0), np.arange(20), depth)


def test_depth_image_is_read_robustly():
    depth = np.full((80, 100), 1.8, np.float32)
    assert depth_case(depth) == pytest.approx(0.9)
    depth[40, 10:30] = 6.0
    assert depth_case(depth) == pytest.approx(0.9), "a third of the points on the background"
    depth[40] = np.nan
    assert depth_case(depth) is None
    assert depth_case(np.zeros((80, 100), np.float32)) is None
    assert depth_case(np.full((20, 12), 1.8, np.float32)) is None, "the face lies outside the depth image"
