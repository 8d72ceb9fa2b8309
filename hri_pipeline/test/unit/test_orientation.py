"""Cameras that are mounted upside down or on their side."""

import numpy as np
import pytest

from hri_pipeline.core.orientation import FaceOrientation, ImageOrientation, quarter_turns

IMAGE = np.zeros((48, 64, 3), np.uint8)
IMAGE[0] = 255      # the way up of what it shows


class Clear:
    """A detector that sees people clearly where the white row is at the top, and a little elsewhere."""

    def __init__(self, score=0.7):
        self.score, self.calls = score, 0

    def __call__(self, image):
        self.calls += 1
        return np.zeros((1, 4)), np.array([self.score if image[0].all() else 0.2])


def shown(image, seconds, detect, orientation=None):
    orientation = orientation or ImageOrientation()
    for stamp in np.arange(0.0, seconds, 1.0):
        orientation.update(image, detect(image)[1], float(stamp), detect)
    return orientation.turn


@pytest.mark.parametrize("turn", [1, 2, 3])
def test_a_turned_camera_is_told_within_a_minute(turn):
    assert shown(np.rot90(IMAGE, -turn), 60.0, Clear()) == turn


def test_an_upright_camera_costs_nothing_and_stays_upright():
    detect, orientation = Clear(), ImageOrientation()
    assert shown(IMAGE, 60.0, detect, orientation) == 0 and detect.calls == 60
    orientation.update(np.rot90(IMAGE, 2), np.array([0.2]), 100.0, detect)     # somebody stands on their head
    assert orientation.turn == 0 and detect.calls == 60


def test_who_is_unclear_either_way_tells_nothing_and_costs_little():
    detect = Clear(0.4)
    assert shown(np.rot90(IMAGE, 2), 60.0, detect) is None and detect.calls <= 66


def test_who_was_clear_once_in_a_turned_image_is_no_sign():
    detect, orientation = Clear(), ImageOrientation()
    for stamp in range(15):     # asked about once
        orientation.update(np.rot90(IMAGE, 2), np.array([0.2]), float(stamp), detect)
    for stamp in range(15, 90):
        orientation.update(np.zeros_like(IMAGE), np.zeros(0), float(stamp), detect)
    assert orientation.turn is None


class Faces:
    """A detector of faces that sees them a little less clearly in turned images: best with the white row at the top."""

    def __init__(self, *scores):
        self.scores, self.calls = scores, 0

    def __call__(self, image):
        self.calls += 1
        turn = next(turn for turn in range(4) if np.rot90(image, turn)[0].all())
        return np.zeros((1, 4)), np.array([self.scores[turn]])


@pytest.mark.parametrize("turn", [0, 1, 2, 3])
def test_by_faces_the_best_of_four_orientations_is_told_within_a_minute(turn):
    orientation, detect = FaceOrientation(), Faces(0.9, 0.7, 0.6, 0.85)
    for stamp in range(60):
        orientation.update(np.rot90(IMAGE, -turn), float(stamp), detect)
    assert orientation.turn == turn and (turn or detect.calls == 8)


def test_faces_that_are_unclear_or_as_clear_in_two_orientations_tell_nothing():
    for scores in ((0.8, 0.5, 0.3, 0.3), (0.9, 0.5, 0.3, 0.89), (0.3, 0.5, 0.81, 0.3)):
        orientation, detect = FaceOrientation(), Faces(*scores)
        for stamp in range(60):
            orientation.update(IMAGE, float(stamp), detect)
        assert orientation.turn is None and detect.calls == 4 * 6


@pytest.mark.parametrize("make, detect", [(ImageOrientation, Clear()), (FaceOrientation, Faces(0.9, 0.7, 0.6, 0.85))])
def test_what_was_seen_of_turned_images_does_not_hold_for_those_that_are_turned_upright(make, detect):
    """As where the transform to ~up_frame comes late: what is to be set was told for the images as they came."""
    orientation = make()
    for stamp in range(60):
        of = np.rot90(IMAGE, 2)
        given = (of, detect(of)[1]) if make is ImageOrientation else (of,)
        orientation.update(*given, float(stamp), detect)
    assert orientation.turn == 2
    orientation.images_turn()
    assert orientation.turn is None
    orientation.turn = 0
    orientation.images_turn()
    assert orientation.turn == 0, "a camera that rolls shows upright people all the time"


@pytest.mark.parametrize("up, turn", [
    ((0.0, -1.0, 0.0), 0), ((0.3, -0.8, -0.5), 0), ((0.0, 1.0, 0.0), 2), ((1.0, 0.0, 0.0), 1), ((-0.9, 0.1, -0.3), 3),
    ((0.1, 0.2, -0.97), None)])
def test_turns_by_the_vertical(up, turn):
    assert quarter_turns(np.array(up)) == turn
