"""The crowd of the interactions benchmark: its scene, and what counts as growth."""

import pytest
import yaml

from benchmarks import crowd


def samples(wall, rss):
    return [{"at": float(second), "rss_mb": rss(second), "fds": 50 + second % 3, "threads": 9, "cpu": 0.0}
            for second in range(wall)]


def test_growth_is_that_from_the_second_fifth_to_the_last():
    found = crowd._growth(samples(100, lambda second: min(100.0, 50.0 + 5.0 * second)), 100.0)
    assert (found["rss_mb"], found["rss_growth_mb"], found["threads_growth"]) == (100.0, 0.0, 0)
    leaking = crowd._growth(samples(100, lambda second: 50.0 + second), 100.0)
    assert leaking["rss_growth_mb"] == pytest.approx(60.0, abs=1.0)


def test_too_short_a_run_has_no_growth():
    assert crowd._growth(samples(1, lambda second: 50.0), 100.0)["rss_growth_mb"] is None


def test_the_scene_is_the_packaged_crowd_of_another_length():
    data = yaml.safe_load(crowd._scene(720.0))
    assert data["duration"] == 720.0
    assert data["crowd"]["people"] == 10
