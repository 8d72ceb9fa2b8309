"""Tests of the heads of known turn."""

import numpy as np
import pytest

from benchmarks import turned_heads
from benchmarks.turned_heads import FACE_M, FOCAL, HEIGHT, WIDTH, Solid, direction_errors, draw
from hri_pipeline.core.faces.head_pose import yaw_pitch_roll
from hri_pipeline.core.geometry import Pose

AHEAD = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
"""Axes of a face frame that looks into the camera, in the optical frame."""
GREY, RED = (90, 90, 90), (0, 0, 255)


@pytest.mark.parametrize("angles", [(30.0, 0.0, 0.0), (0.0, 20.0, 0.0), (0.0, 0.0, -25.0)])
def test_a_turn_is_that_of_the_face_which_it_turns(angles):
    turned = Pose(turned_heads._turn(*angles) @ AHEAD, np.zeros(3))
    assert np.degrees(yaw_pitch_roll(turned)) == pytest.approx(angles, abs=1e-6)


def test_errors_are_to_the_right_up_and_of_the_roll():
    for axis in range(3):
        wrong = [0.0, 0.0, 0.0]
        wrong[axis] = 5.0
        assert direction_errors(turned_heads._turn(*wrong) @ AHEAD, AHEAD) == pytest.approx(wrong, abs=1e-6)


@pytest.mark.parametrize("yaw", [-35.0, 0.0, 35.0])
def test_a_mark_on_a_head_is_seen_where_the_turned_head_has_it(yaw):
    view = draw(plate(), turned_heads._turn(yaw, 0.0, 0.0), 120, np.zeros((HEIGHT, WIDTH, 3), np.uint8),
                np.random.RandomState(0)).astype(int)
    rows, columns = np.nonzero(view[..., 2] - view[..., 0] > 80)
    mark = turned_heads._turn(yaw, 0.0, 0.0) @ [0.25 * FACE_M, 0.0, -0.02] + [0.0, 0.0, FACE_M * FOCAL / 120]
    assert columns.mean() == pytest.approx(mark[0] / mark[2] * FOCAL + WIDTH / 2, abs=1.5)
    assert rows.mean() == pytest.approx(HEIGHT / 2, abs=1.5)


def test_what_is_nearer_hides_what_is_behind():
    front, back = plate(), plate(mark=False)
    behind = front._replace(points=np.concatenate([front.points, back.points - [0.0, 0.0, 0.05]]),
                            texture=np.concatenate([front.texture, np.tile(back.texture[:1], (4, 1))]),
                            triangles=np.concatenate([front.triangles, back.triangles + 4]))
    view = draw(behind, np.eye(3), 120, np.zeros((HEIGHT, WIDTH, 3), np.uint8), np.random.RandomState(0)).astype(int)
    middle = view[HEIGHT // 2 - 20:HEIGHT // 2 + 20, WIDTH // 2 - 20:WIDTH // 2 + 45]
    assert (middle[..., 2] - middle[..., 0] < 30).all()


def plate(mark: bool = True) -> Solid:
    """A grey plate 20 mm before the middle of the head, with a red mark a quarter of its width to the image's right."""
    image = np.full((200, 200, 3), GREY, np.uint8)
    if mark:
        image[95:106, 145:156] = RED
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    points = np.concatenate([corners * 0.5 * FACE_M, np.full((4, 1), -0.02)], axis=1)
    return Solid(image, points, 100.5 + 100.0 * corners, np.array([[0, 1, 2], [0, 2, 3]]), 200.0, np.full(2, 100.0))
