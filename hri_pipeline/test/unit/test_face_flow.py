"""Boxes that move with their pictures, in pictures made of noise."""

import cv2
import numpy as np
import pytest

from hri_pipeline.core.faces import face_flow
from hri_pipeline.core.faces.face_flow import FaceFlow

BOXES = [np.array([100.0, 80.0, 180.0, 170.0]), np.array([300.0, 200.0, 340.0, 250.0])]
STILL = [np.zeros(2)] * 2


def texture(seed=1, width=480, height=360):
    """A picture (H, W, 3) of soft patches, as faces have them."""
    noise = np.random.RandomState(seed).randint(0, 256, (height // 8, width // 8, 3)).astype(np.uint8)
    return cv2.resize(noise, (width, height), interpolation=cv2.INTER_CUBIC)


def moved(picture, x, y):
    return cv2.warpAffine(picture, np.array([[1.0, 0.0, x], [0.0, 1.0, y]]), picture.shape[1::-1],
                          borderMode=cv2.BORDER_REFLECT)


def test_the_first_image_tells_nothing():
    assert FaceFlow().update(texture(), BOXES, STILL) == [None, None]


@pytest.mark.parametrize("way", [(0.0, 0.0), (3.5, -2.25), (-12.0, 7.0), (16.0, 10.0)])
def test_boxes_go_with_the_picture(way):
    flow, picture = FaceFlow(), texture()
    flow.update(picture, [], [])
    for motion in flow.update(moved(picture, *way), BOXES, STILL):
        assert motion == pytest.approx(np.array(way), abs=0.4)


def test_a_wrong_expectation_is_corrected_and_a_right_one_finds_what_is_far():
    picture = texture()
    for way, expected in (((5.0, 0.0), (-4.0, 6.0)), ((60.0, -30.0), (52.0, -26.0))):
        flow = FaceFlow()
        flow.update(picture, [], [])
        for motion in flow.update(moved(picture, *way), BOXES, [np.array(expected)] * 2):
            assert motion == pytest.approx(np.array(way), abs=0.4)


def test_one_that_moves_before_a_still_wall():
    flow, wall = FaceFlow(), texture()
    head = texture(seed=5)[:90, :80]
    images = [wall.copy(), wall.copy()]
    images[0][80:170, 100:180] = head
    images[1][86:176, 109:189] = head
    flow.update(images[0], [], [])
    first, second = flow.update(images[1], BOXES, STILL)
    assert first == pytest.approx([9.0, 6.0], abs=0.5)
    assert second == pytest.approx([0.0, 0.0], abs=0.2)


def test_another_picture_and_one_without_marks_tell_nothing():
    flow = FaceFlow()
    flow.update(texture(), [], [])
    assert flow.update(texture(seed=9), BOXES, STILL) == [None, None]
    flow.update(texture(), [], [])
    flat = np.full((360, 480, 3), 90, np.uint8)
    assert flow.update(flat, BOXES, STILL) == [None, None]


def test_images_without_a_box_are_not_shrunk_until_one_follows_and_nothing_else_changes(monkeypatch):
    shrunk = []
    shrink = face_flow.shrink
    monkeypatch.setattr(face_flow, "shrink", lambda image: shrunk.append(image) or shrink(image))
    images = [moved(texture(), 2.0 * number, -1.5 * number) for number in range(8)]
    counts, lazy, eager = [0, 0, 0, 2, 1, 2, 0, 0], FaceFlow(), FaceFlow()
    for image, count in zip(images, counts):
        told = lazy.update(image, BOXES[:count], STILL[:count])
        assert all(motion is not None for motion in told)
        wanted = eager.update(image, BOXES, STILL)[:count]      # always with boxes: each image as it comes
        np.testing.assert_array_equal(np.array(told), np.array(wanted))
    shrunk.clear()
    flow, needed = FaceFlow(), []
    for image, count in zip(images, counts):
        flow.update(image, BOXES[:count], STILL[:count])
        needed.append(len(shrunk))
    assert needed == [0, 0, 0, 2, 3, 4, 4, 4]
    flow.reset()
    assert flow.update(images[0], BOXES, STILL) == [None, None]


def test_another_size_starts_anew_and_so_does_a_reset():
    flow = FaceFlow()
    flow.update(texture(), [], [])
    assert flow.update(texture(width=320, height=240), BOXES, STILL) == [None, None]
    assert flow.update(texture(width=320, height=240), BOXES[:1], STILL[:1])[0] == pytest.approx([0.0, 0.0], abs=0.1)
    flow.reset()
    assert flow.update(texture(width=320, height=240), BOXES[:1], STILL[:1]) == [None]


@pytest.mark.parametrize("box", [(-500.0, -500.0, -400.0, -400.0), (470.0, 350.0, 700.0, 600.0), (10.0, 10.0, 14.0, 14.0)])
def test_boxes_outside_of_the_image_and_tiny_ones_do_no_harm(box):
    flow, picture = FaceFlow(), texture()
    flow.update(picture, [], [])
    motion, = flow.update(picture, [np.array(box)], STILL[:1])
    assert motion is None or np.abs(motion).max() < 1.0


def test_images_of_any_size():
    flow = FaceFlow()
    for shape in ((1, 1, 3), (1, 1, 3), (2, 500, 3), (2, 500, 3)):
        assert flow.update(np.zeros(shape, np.uint8), BOXES, STILL) == [None, None]
