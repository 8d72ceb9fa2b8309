import itertools

import numpy as np
import pytest

from benchmarks import identity_filmed
from benchmarks.identity_filmed import BodyView, FilmCamera, humans_of, lines_apart, meeting_point, score, to_and_fro
from benchmarks.identity_returns import FilmError
from hri_fullbody.core import keypoints as kp
from hri_pipeline.core.camera import Calibration, CameraModel
from hri_pipeline.core.geometry import Pose

CALIBRATION = """<calibration><cameras><camera serial="cam01">
<fov_video bottom="1919" left="0" right="1087" top="0"/>
<transform r11="1" r12="0" r13="0" r21="0" r22="0" r23="1" r31="0" r32="-1" r33="0" x="0" y="-3000" z="1500"/>
<intrinsic centerPointU="34816" centerPointV="61440" focalLengthU="107520" focalLengthV="107520"
 radialDistortion1="0" radialDistortion2="0" tangentalDistortion1="0" tangentalDistortion2="0"/>
</camera></cameras></calibration>"""


def test_a_calibrated_camera_looks_where_it_stands_and_is_turned():
    (camera,) = identity_filmed.read_calibration(CALIBRATION)
    assert (camera.model.width, camera.model.height) == (1088, 1920)
    assert camera.position == pytest.approx([0.0, -3.0, 1.5])
    assert camera.sight_line(np.array([544.0, 960.0])) == pytest.approx([0.0, 1.0, 0.0], abs=1e-9)
    right, up = camera.sight_line(np.array([1000.0, 960.0])), camera.sight_line(np.array([544.0, 100.0]))
    assert right[0] > 0.0 and up[2] > 0.0
    with pytest.raises(ValueError, match="cam01"):
        identity_filmed.read_calibration(CALIBRATION.replace("<fov_video", "<fov_other"))


def test_a_film_runs_to_and_fro():
    assert list(itertools.islice(to_and_fro(4), 9)) == [0, 1, 2, 3, 2, 1, 0, 1, 2]


def test_lines_meet_where_they_are_nearest():
    origins = [np.zeros(3), np.array([2.0, 0.0, 0.2])]
    directions = [np.array([0.0, 1.0, 0.0]), np.array([-1.0, 1.0, 0.0]) / np.sqrt(2.0)]
    assert lines_apart(directions[0], directions[1], origins[1] - origins[0]) == pytest.approx(0.2)
    assert meeting_point(origins, directions) == pytest.approx([0.0, 2.0, 0.1])


def test_the_films_must_be_there(monkeypatch):
    monkeypatch.setenv("ROS4HRI_POSE2SIM", "/nowhere.whl")
    with pytest.raises(FilmError, match="pip download"):
        identity_filmed.find_package()


def camera(name, position):
    """A camera at a height of 1.5 m that looks at the origin."""
    forward = np.array([0.0, 0.0, 1.5]) - position
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    model = CameraModel(1280, 720, np.array([[900.0, 0.0, 640.0], [0.0, 900.0, 360.0], [0.0, 0.0, 1.0]]), np.zeros(5),
                        "plumb_bob", Calibration.CALIBRATED)
    return FilmCamera(name, model, np.array([right, np.cross(forward, right), forward]), position)


def view(camera, human, place):
    """What a camera sees of somebody who stands at `place` (2,) m, without errors."""
    points = np.zeros((18, 3))
    offsets = {kp.NECK: (0.0, 1.4), kp.RIGHT_SHOULDER: (0.2, 1.4), kp.LEFT_SHOULDER: (-0.2, 1.4),
               kp.RIGHT_HIP: (0.15, 0.9), kp.LEFT_HIP: (-0.15, 0.9),
               kp.RIGHT_EAR: (0.07, 1.6), kp.LEFT_EAR: (-0.07, 1.6)}
    for point, (aside, up) in offsets.items():
        there = camera.rotation @ (np.array([place[0] + aside, place[1], up]) - camera.position)
        points[point] = (*camera.model.project(there[None])[0], 1.0)
    return BodyView(camera.name + human, Pose(np.eye(3), np.array([*place, 1.6])), points, None)


def test_exact_views_are_one_person_each_at_the_true_place():
    cameras = [camera("a", np.array([0.0, -4.0, 1.5])), camera("b", np.array([4.0, 0.0, 1.5])),
               camera("c", np.array([-3.0, -3.0, 1.5]))]
    film = {one.name: [[view(one, "x", (0.3, 0.1)), view(one, "y", (-1.0, 0.6))] for _ in range(60)] for one in cameras}
    humans = humans_of(film, cameras)
    assert [len({humans[one.name + name] for one in cameras}) for name in "xy"] == [1, 1]
    assert len(set(humans.values())) == 2
    found = score(film, cameras, cameras[:2], humans)
    assert found.counts["images"] == 30 and found.counts["extra"] == 0 and not found.wrong
    assert len(found.errors) == 60 and max(found.errors) < 0.01


def test_a_person_made_of_two_humans_is_wrong():
    cameras = [camera("a", np.array([0.0, -4.0, 1.5])), camera("b", np.array([4.0, 0.0, 1.5]))]
    film = {one.name: [[view(one, "x", (0.3, 0.1))] for _ in range(60)] for one in cameras}
    found = score(film, cameras, cameras, {"ax": 0, "bx": 1})
    assert found.wrong == {(0, 1)}
