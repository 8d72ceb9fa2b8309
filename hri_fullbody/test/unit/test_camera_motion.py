"""The camera's motion by what its images show, and what it moves."""

import cv2
import numpy as np
import pytest

from hri_fullbody.core.detection.windows import FaceBox
from hri_fullbody.core.tracking.camera_motion import CameraMotion
from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.geometry import Pose

CAMERA = CameraModel.from_fov(640, 360, 1.05)
STEP_S = 1.0 / 15.0
# Of a view that is wider than the image: blotches as large as furniture and as small as its edges.
WIDE = CameraModel.from_fov(1920, 1080, 2.1)


def room(seed=0):
    random, picture = np.random.default_rng(seed), np.zeros((1080, 1920), np.float32)
    for side in (12, 40, 160):
        small = random.uniform(0.0, 1.0, (1080 // side + 2, 1920 // side + 2)).astype(np.float32)
        picture += cv2.resize(small, (1920, 1080), interpolation=cv2.INTER_CUBIC)
    return cv2.cvtColor((80.0 * np.clip(picture, 0.0, 3.0)).astype(np.uint8), cv2.COLOR_GRAY2BGR)


ROOM = room()


def about(pan, tilt):
    """Rotation (3, 3) from the frame of a camera at rest to that of one that has turned."""
    return cv2.Rodrigues(np.array([tilt, 0.0, 0.0]))[0] @ cv2.Rodrigues(np.array([0.0, -pan, 0.0]))[0]


def seen(pan, tilt=0.0, picture=ROOM):
    turn = CAMERA.matrix @ about(pan, tilt) @ np.linalg.inv(WIDE.matrix)
    return cv2.warpPerspective(picture, turn, (640, 360), flags=cv2.INTER_LINEAR)


def watched(images, interval=STEP_S):
    motion = CameraMotion()
    for number, image in enumerate(images):
        motion.update(image, CAMERA, number * interval)
    return motion


@pytest.mark.parametrize("pan, tilt", [(0.1, 0.0), (-0.1, 0.0), (0.2, 0.0), (0.0, 0.06), (0.03, -0.03)])
def test_a_turn_of_the_camera_is_seen(pan, tilt):
    motion = watched([seen(0.0), seen(0.0), seen(pan, tilt)])
    assert motion.moves and motion.step() == pytest.approx([pan, tilt], abs=0.005)
    assert motion.since(0.0) == pytest.approx([pan, tilt], abs=0.005)


def test_the_turn_since_a_time_between_two_images_and_after_the_last_one_goes_on_evenly():
    motion = watched([seen(0.05 * number) for number in range(4)])
    assert motion.since(1.5 * STEP_S) == pytest.approx([0.075, 0.0], abs=0.005)
    assert motion.since(4.0 * STEP_S) == pytest.approx([-0.05, 0.0], abs=0.005)
    assert not motion.since(10.0).any()


def test_the_camera_stands_where_somebody_walks_through_its_image():
    clothes = room(1)[:320, :220]
    for x in range(0, 380, 40):
        images = [ROOM[300:660, 600:1240].copy() for _ in range(2)]
        for number, image in enumerate(images):
            image[40:, x + 40 * number:x + 40 * number + 220] = clothes
        motion = watched(images)
        assert not motion.moves and not motion.step().any(), x


def crossed(width, x, step, wall=ROOM[300:660, 600:1240]):
    """Two images of a wall before which somebody near, of a width (px), goes from x by a step (px)."""
    images = [wall.copy() for _ in range(2)]
    for number, image in enumerate(images):
        left, right = max(0, x + step * number), min(640, x + step * number + width)
        start = left - x - step * number
        image[30:, left:right] = room(1)[:330, start:start + right - left]
    return images


@pytest.mark.parametrize("width, step", [(320, 10), (320, 25), (320, 50), (400, 10), (400, 25)])
def test_the_camera_stands_where_somebody_near_takes_most_of_its_image(width, step):
    for x in range(-width // 2, 640 - width // 2, 80):
        motion = watched(crossed(width, x, step))
        assert not motion.moves and not motion.step().any(), x


def test_the_camera_stands_where_a_known_person_is_most_of_what_is_seen():
    images = crossed(300, 100, 40, np.full((360, 640, 3), 120, np.uint8))
    motion = CameraMotion()
    for number, image in enumerate(images):
        motion.update(image, CAMERA, STEP_S * number, lambda: [np.array([100.0, 60.0, 400.0, 360.0])])
    assert not motion.moves


def test_the_turn_is_seen_of_a_camera_that_follows_somebody():
    motion = CameraMotion()
    for number, pan in enumerate((0.0, 0.0, 0.05)):
        image = seen(pan).copy()
        image[40:, 220:420] = room(1)[:320, :200]
        motion.update(image, CAMERA, STEP_S * number, lambda: [np.array([220.0, 70.0, 420.0, 360.0])])
    assert motion.step() == pytest.approx([0.05, 0.0], abs=0.005)


@pytest.mark.parametrize("images, interval", [
    ([ROOM[300:660, 600:1240], room(1)[300:660, 600:1240]], STEP_S),
    ([np.full((360, 640, 3), 90, np.uint8), np.full((360, 640, 3), 130, np.uint8)], STEP_S),
    ([seen(0.0), seen(0.05)], 2.0), ([seen(0.0), np.zeros((180, 320, 3), np.uint8)], STEP_S), ([seen(0.0)], STEP_S)],
    ids=["cut", "nothing to see", "gap", "size", "first"])
def test_nothing_is_said_of_a_motion_that_is_not_seen(images, interval):
    motion = watched(images, interval)
    assert not motion.moves and not motion.step().any() and not motion.since(0.0).any()


def test_an_image_that_shows_nothing_tells_no_motion_and_the_next_one_neither():
    motion = CameraMotion()
    for number, image in enumerate((seen(0.0), seen(0.05), np.zeros((360, 640, 3), np.uint8), seen(0.1))):
        motion.update(image, CAMERA, STEP_S * number)
        assert motion.moves is (number == 1)


def test_a_face_of_the_image_before_is_where_it_is_in_this_one():
    place, pan = np.array([0.3, -0.2, 2.0]), 0.1
    later = about(pan, 0.0) @ place
    centres = [CAMERA.project(one[None])[0] for one in (place, later)]
    before, now = (np.concatenate([centre - 20.0, centre + 20.0]) for centre in centres)
    motion = watched([seen(0.0), seen(0.0), seen(pan)])
    face = motion.face_now(FaceBox("f", before, Pose(np.eye(3), place), STEP_S))
    assert face.box == pytest.approx(now, abs=3.0) and face.pose.translation == pytest.approx(later, abs=0.02)
    assert face.pose.rotation == pytest.approx(about(pan, 0.0), abs=0.01)
    for stamp in (None, 2.0 * STEP_S):      # of this image
        same = FaceBox("f", before, None, stamp)
        assert motion.face_now(same) is same


def test_after_a_reset_there_was_no_motion():
    motion = watched([seen(0.0), seen(0.1)])
    motion.reset()
    motion.update(seen(0.2), CAMERA, 1.0)
    assert not motion.moves and not motion.since(0.0).any()
