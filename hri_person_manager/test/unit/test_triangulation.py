"""Places by rays: their covariances, distances and what several tell together."""

from __future__ import annotations

import numpy as np
import pytest

from hri_person_manager.core.triangulation import fuse, ray_covariance, squared_distances

LEFT, RIGHT = np.array([0.0, 0.0, 1.5]), np.array([4.0, 0.0, 1.5])


def test_a_place_is_long_along_its_ray():
    covariance = ray_covariance(np.array([0.0, 3.0, 1.5]), LEFT)
    assert np.sqrt(np.diag(covariance)) == pytest.approx([0.06, 0.36, 0.06])
    assert np.sqrt(np.diag(ray_covariance(np.array([0.0, 3.0, 1.5]), LEFT, along=0.03, exactness=0.08)))[:2] == (
        pytest.approx([0.1, np.hypot(np.hypot(0.09, 0.08), 0.0)], abs=1e-3))


def test_rays_that_cross_place_a_person_however_wrong_the_distances_are():
    person = np.array([2.0, 2.0, 1.2])
    places = np.array([LEFT + 1.12 * (person - LEFT), RIGHT + 0.88 * (person - RIGHT)])
    position, covariance = fuse(places, np.array([ray_covariance(places[0], LEFT), ray_covariance(places[1], RIGHT)]))
    assert np.linalg.norm(places - person, axis=1).min() > 0.3
    assert np.linalg.norm(position - person) < 0.03 and np.sqrt(np.trace(covariance)) < 0.12


def test_the_distance_counts_in_deviations():
    covariances = np.array([ray_covariance(np.array([0.0, 3.0, 1.5]), LEFT)] * 2)
    along = squared_distances(np.array([[0.0, 3.0, 1.5], [0.0, 3.6, 1.5]]), covariances)
    across = squared_distances(np.array([[0.0, 3.0, 1.5], [0.6, 3.0, 1.5]]), covariances)
    assert np.sqrt(along[0, 1]) == pytest.approx(0.6 / (0.36 * np.sqrt(2.0)))
    assert np.sqrt(across[0, 1]) == pytest.approx(0.6 / (0.06 * np.sqrt(2.0))) and along[0, 0] == 0.0
