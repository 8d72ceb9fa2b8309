"""Whose distance is wrong by how much, by where everybody looks."""

import numpy as np
import pytest

from hri_pipeline.core.interactions.depth_factors import DepthFactors
from hri_pipeline.core.interactions.gaze import ROBOT, GazeTargets, SightLines
from hri_pipeline.core.interactions.parameters import INTERACTION_PARAMETERS
from hri_pipeline.core.interactions.people import UNKNOWN, PeopleSnapshot

RATE = 15.0
CAMERA = np.array([0.0, 0.0, 1.3])
PLACES = np.array([[2.4, -0.5, 1.6], [2.6, 0.6, 1.6], [3.6, 0.5, 1.5], [3.4, -0.6, 1.5]])
LOGS = np.array([0.08, -0.06, 0.07, -0.05])
NAMES = ["ann", "bob", "cho", "dan"]


def seen(aims, logs=LOGS, noise=None):
    """Four people as one camera sees them who look at these places, with the factors of their distances."""
    gazes = np.asarray(aims, dtype=float) - PLACES
    gazes /= np.linalg.norm(gazes, axis=1)[:, None]
    if noise is not None:
        gazes += noise.normal(0.0, 0.05, gazes.shape)
        gazes /= np.linalg.norm(gazes, axis=1)[:, None]
    rays = (PLACES - CAMERA) * np.exp(logs)[:, None]
    unknown = np.tile(UNKNOWN, (4, 1))
    people = PeopleSnapshot(list(NAMES), CAMERA + rays, gazes, gazes.copy(), unknown,
                            np.tile([0.03, 0.09, 0.1, 0.35], (4, 1)), np.zeros(4))
    people.rays, people.depths = rays, 0.045 * rays
    return people


def learnt(turns, factors=None):
    """What is known after these looks: (targets of the four, 4 the camera) for a second each."""
    factors, noise = factors or DepthFactors(), np.random.RandomState(1)
    places = np.append(PLACES, [CAMERA], axis=0)
    for targets in turns:
        beliefs = np.zeros((4, 4))
        for person, target in enumerate(targets):
            if target < 4:
                beliefs[person, target] = 0.9
        for _ in range(int(RATE)):
            people = factors.corrected(seen(places[list(targets)], noise=noise))
            factors.learn(people, SightLines(people, CAMERA, 8.0), beliefs, np.full(4, 0.3), 1.0 / RATE)
    return factors


EVERYBODY = [(1, 2, 3, 0), (2, 3, 0, 1), (3, 0, 1, 2)] * 5


def off(people):
    """Root mean square (m) of how far everybody is from where they are."""
    return float(np.sqrt(((people.heads - PLACES) ** 2).sum(axis=1).mean()))


def test_lines_of_sight_that_cross_tell_how_far_people_are():
    measured = seen(PLACES[[1, 2, 3, 0]])
    corrected = learnt(EVERYBODY).corrected(measured)
    assert off(measured) > 0.15
    assert off(corrected) < 0.5 * off(measured)
    sds = np.linalg.norm(corrected.depths, axis=1) / np.linalg.norm(measured.depths, axis=1)
    assert sds.max() < 0.9
    assert np.cross(corrected.rays, measured.rays) == pytest.approx(0.0)       # along the camera's rays only


def test_looks_at_the_camera_tell_nothing():
    measured = seen(PLACES[[1, 2, 3, 0]])
    assert off(learnt([(4, 4, 4, 4)] * 5).corrected(measured)) == off(measured)


def test_who_leaves_is_forgotten_and_the_others_keep_what_is_known():
    factors, measured = learnt(EVERYBODY), seen(PLACES[[1, 2, 3, 0]])
    before = factors.corrected(measured)
    alone = PeopleSnapshot(NAMES[1:], *(array[1:] for array in (
        measured.heads, measured.gazes, measured.faces, measured.trunks, measured.deviations, measured.closed)))
    alone.rays, alone.depths = measured.rays[1:], measured.depths[1:]
    assert factors.corrected(alone).heads == pytest.approx(before.heads[1:])
    assert factors.corrected(alone).depths == pytest.approx(before.depths[1:])
    back = factors.corrected(measured)
    assert back.heads[0] == pytest.approx(measured.heads[0])
    assert back.heads[1:] == pytest.approx(before.heads[1:])


def found_right(with_rays):
    """Share of the time in which who looks at whom is right, of the last 15 of 30 s."""
    targets, now, right = GazeTargets(INTERACTION_PARAMETERS.resolve({})), 0.0, 0
    noise = np.random.RandomState(2)
    for turn in range(30):
        aims = EVERYBODY[turn % 3]
        for _ in range(int(RATE)):
            now += 1.0 / RATE
            people = seen(PLACES[list(aims)], noise=noise)
            if not with_rays:
                people.rays = np.zeros((4, 3))
            found = targets.update(people, CAMERA, now)
            right += turn >= 15 and sum(
                gaze.receiver != ROBOT and NAMES.index(gaze.receiver) == aims[NAMES.index(gaze.sender)]
                for gaze in found)
    return right / (15 * int(RATE) * 4)


def test_who_is_seen_beside_a_line_of_sight_is_found_on_it_once_the_distances_are_learnt():
    assert found_right(with_rays=True) > 0.9
    assert found_right(with_rays=False) < 0.75
