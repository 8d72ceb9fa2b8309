"""The poses of cameras by a person who walks, and by a board."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hri_person_manager.core.camera_poses import (
    CalibrationError,
    at_common_times,
    board_scale,
    deviations,
    solve_poses,
    stature_scale,
)
from hri_pipeline.core.geometry import Pose

SKELETON = {"left_eye": (0.03, 0.05, 0.936), "right_eye": (-0.03, 0.05, 0.936), "neck": (0.0, 0.0, 0.818),
            "left_hip": (0.08, 0.0, 0.53), "right_hip": (-0.08, 0.0, 0.53), "left_ankle": (0.08, 0.0, 0.039),
            "right_ankle": (-0.08, 0.0, 0.039), "left_wrist": (0.2, 0.1, 0.485), "right_wrist": (-0.2, 0.1, 0.485)}


def looking(position, target):
    """Pose in the room of the optical frame of a camera that looks at a point."""
    z = np.array(target, float) - position
    z /= np.linalg.norm(z)
    x = np.cross(z, (0.0, 0.0, 1.0))
    x /= np.linalg.norm(x)
    return Pose(np.column_stack([x, np.cross(z, x), z]), np.array(position, float))


CAMERAS = [looking((0.0, 0.0, 1.6), (2.5, 2.5, 0.9)), looking((5.0, 0.0, 2.0), (2.5, 2.5, 0.9)),
           looking((4.5, 5.0, 1.2), (2.5, 2.5, 0.9))]


def walk(rng, cameras, noise=0.01, stature=1.75, wrong=0.0, radius=1.0, bias=0.0):
    """What each camera sees of somebody who walks a loop: every joint with noise of its own for each camera (m), and
    with a bias (m) that it has in all images."""
    seen = [{} for _ in cameras]
    biases = [{name: rng.normal(0.0, bias, 3) if bias else np.zeros(3) for name in SKELETON} for _ in cameras]
    for step in range(150):
        angle = 2.0 * math.pi * step / 75.0
        turn = np.array([[-math.sin(angle), -math.cos(angle)], [math.cos(angle), -math.sin(angle)]])
        for name, joint in SKELETON.items():
            point = stature * np.array(joint)
            point[:2] = turn @ point[:2] + 2.5 + radius * np.array(
                [math.cos(angle), 0.8 * math.sin(angle)])
            for camera, rays, its in zip(cameras, seen, biases):
                place = camera.inverse().apply((point + its[name] + rng.normal(0.0, noise, 3))[None])[0]
                if rng.uniform() < 0.1:
                    continue
                if rng.uniform() < wrong:
                    place = place + rng.normal(0.0, 0.5, 3)
                rays[step / 10.0, name] = place[:2] / place[2]
    return seen


def errors(found, cameras):
    """Largest error of place (m) and direction (rad) of the cameras in the frame of the first one."""
    true = [cameras[0].inverse().compose(camera) for camera in cameras]
    turns = [np.linalg.norm(np.array(pose.inverse().compose(other).quaternion)[:3]) for pose, other in zip(
        found.poses, true)]
    return (max(np.linalg.norm(pose.translation - other.translation) for pose, other in zip(found.poses, true)),
            2.0 * math.asin(min(1.0, max(turns))))


@pytest.mark.parametrize("count, seed", [(2, 0), (2, 1)] + [
    pytest.param(count, seed, marks=pytest.mark.slow("up to some seconds for each"))
    for count, seed in ((2, 2), (2, 3), (2, 4), (3, 0), (3, 1), (3, 2), (3, 3), (3, 4))])
def test_a_person_who_walks_tells_where_the_cameras_are(count, seed):
    found = solve_poses(walk(np.random.default_rng(seed), CAMERAS[:count], wrong=0.02))
    found = found.scaled(stature_scale(found.points, 1.75))
    far, turned = errors(found, CAMERAS[:count])
    assert far <= 0.05 and turned <= math.radians(1.0)
    assert 0.0005 < found.residual < 0.02


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow("up to some seconds for each"))])
def test_who_walks_about_is_certain_and_who_stays_on_the_spot_is_not(seed):
    """With key points that each camera sees some centimetres off, as networks do."""
    said, true = [], []
    for radius in (1.3, 0.1):
        seen = walk(np.random.default_rng(seed), CAMERAS[:2], radius=radius, bias=0.03)
        found = solve_poses(seen)
        found = found.scaled(stature_scale(found.points, 1.75))
        said.append(deviations(seen, found)[0])
        true.append(errors(found, CAMERAS[:2]))
    for (far, turned), (place, direction) in zip(true, said):
        assert far < 4.0 * place and turned < 4.0 * direction     # three parts of the body tell a deviation roughly
    assert said[1][0] > 2.0 * said[0][0]


def test_poses_that_hang_on_one_part_of_the_body_are_not_certain():
    seen = [{key: ray for key, ray in rays.items() if "ankle" in key[1]} for rays in walk(
        np.random.default_rng(3), CAMERAS[:2])]
    found = solve_poses(seen)
    assert deviations(seen, found) == [(math.inf, math.inf)]


def test_a_board_tells_the_scale():
    rng, seen = np.random.default_rng(1), [{}, {}]
    for step in range(30):
        turn = Pose(looking(rng.uniform(-1.0, 1.0, 3), rng.uniform(2.0, 3.0, 3)).rotation, rng.uniform(1.8, 3.2, 3))
        for number in range(12):
            corner = turn.apply(0.08 * np.array([[number % 4, number // 4, 0.0]]))[0]
            for camera, rays in zip(CAMERAS, seen):
                place = camera.inverse().apply(corner[None])[0]
                rays[step, str(number)] = place[:2] / place[2] + rng.normal(0.0, 0.0005, 2)
    found = solve_poses(seen)
    found = found.scaled(board_scale(found.points, [("0", "1"), ("5", "6"), ("10", "11")], 0.08))
    far, turned = errors(found, CAMERAS[:2])
    assert far <= 0.05 and turned <= math.radians(1.0)


def test_too_little_is_told():
    rng = np.random.default_rng(2)
    seen = walk(rng, CAMERAS)
    with pytest.raises(CalibrationError, match="two or more"):
        solve_poses(seen[:1])
    with pytest.raises(CalibrationError, match="walk where both see you"):
        solve_poses([seen[0], dict(list(seen[1].items())[:20])])
    with pytest.raises(CalibrationError, match="camera 3 shares"):
        solve_poses([*seen[:2], dict(list(seen[2].items())[:20])])
    with pytest.raises(CalibrationError, match="head to the ankles"):
        stature_scale({(0.0, "neck"): np.zeros(3)}, 1.7)


def test_cameras_that_do_not_look_at_the_same_time():
    tracks = [[(start + step / rate, {"neck": np.array([start + step / rate, 1.0])}) for step in range(30)]
              for start, rate in ((5.03, 15.0), (5.08, 9.0))]
    del tracks[0][10:16]        # somebody was hidden
    one, other = at_common_times(tracks)
    shared = one.keys() & other.keys()
    assert len(shared) == 15 and all(key[0] <= 70 for key in shared)
    for key in shared:
        assert np.allclose(one[key], [0.1 * key[0], 1.0]) and np.allclose(other[key], one[key])
