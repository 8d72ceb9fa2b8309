"""Pictures that jump: sudden zooms, bars, and images that are shifted; rooms made of rectangles."""

import math

import cv2
import numpy as np
import pytest

from hri_pipeline.core import images
from hri_pipeline.core.image_rotation import ImageRotation
from hri_pipeline.core.images import PictureCuts
from hri_pipeline.core.picture_jumps import find_jump, picture_of

WIDTH, HEIGHT = 1280, 720
POINTS = np.array([[200.0, 150.0], [900.0, 300.0], [640.0, 600.0]])


def room(seed, noise=2.0):
    """A picture of rectangles, as a camera with noise sees it."""
    random = np.random.default_rng(seed)
    image = np.full((HEIGHT, WIDTH, 3), 110, np.uint8)
    for _ in range(400):
        x, y = random.integers(0, (WIDTH, HEIGHT))
        w, h = random.integers(12, 120, 2)
        cv2.rectangle(image, (int(x), int(y)), (int(x + w), int(y + h)), random.integers(0, 255, 3).tolist(), -1)
    return np.clip(image + random.normal(0.0, noise, image.shape), 0, 255).astype(np.uint8)


def moved(image, scale, shift):
    """What a camera shows that has zoomed by `scale`, with everything `shift` px further on."""
    matrix = np.array([[scale, 0.0, shift[0]], [0.0, scale, shift[1]]])
    return cv2.warpAffine(image, matrix, (WIDTH, HEIGHT))


ZOOMS = [(1.3, (-192.0, -108.0)), (1.0 / 1.3, (148.0, 83.0)), (2.0, (-640.0, -360.0)), (0.5, (320.0, 180.0)),
         (0.75, (160.0, 90.0)), (1.6, (-300.0, -180.0)), (1.0, (426.0, 0.0)), (1.0, (-60.0, 20.0))]


@pytest.mark.parametrize("scale, shift", ZOOMS)
def test_a_zoom_or_a_shift_is_told_wherever_its_middle_is(scale, shift):
    jump = find_jump(picture_of(room(1)), moved(room(1), scale, shift))
    assert jump.scale == pytest.approx(scale, rel=0.01)
    np.testing.assert_allclose(jump.pixels(POINTS), scale * POINTS + shift, atol=8.0)


def logo(image):
    """An image with a channel's name in a corner."""
    return cv2.putText(image, "CHANNEL 7", (900, 80), cv2.FONT_HERSHEY_SIMPLEX, 1.8, (255, 255, 255), 5)


def turned(image, degrees):
    """What a camera of 90 degrees shows that has turned to the right, where it has shown `image`."""
    angle, focal = math.radians(degrees), 0.5 * WIDTH
    camera = np.array([[focal, 0.0, WIDTH / 2.0], [0.0, focal, HEIGHT / 2.0], [0.0, 0.0, 1.0]])
    cosine, sine = math.cos(angle), math.sin(angle)
    rotation = np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])
    return cv2.warpPerspective(image, camera @ rotation @ np.linalg.inv(camera), (WIDTH, HEIGHT))


def visitor(size):
    """Somebody in patterned clothes, `size` px wide, at the right before a wall with a few things on it."""
    random = np.random.default_rng(7)
    image = np.full((HEIGHT, WIDTH, 3), 110, np.uint8)
    for _ in range(10):
        x, y = random.integers(0, (480, 620)).tolist()
        w, h = random.integers(12, 80, 2).tolist()
        cv2.rectangle(image, (x, y), (x + w, y + h), random.integers(0, 255, 3).tolist(), -1)
    clothes = cv2.resize(room(1)[:360, :360], (size, size))
    image[HEIGHT - size:, WIDTH - size - 20:WIDTH - 20] = clothes
    return np.clip(image + np.random.default_rng(size).normal(0.0, 2.0, image.shape), 0, 255).astype(np.uint8)


BLACK = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
OTHERS = {
    "the same": (room(1), room(1)), "about the same": (room(1), moved(room(1), 1.01, (4.0, -3.0))),
    "another room": (room(1), room(2)), "a logo": (logo(room(1)), moved(logo(room(2)), 1.0, (-60.0, 30.0))),
    "upside down": (room(1), np.ascontiguousarray(np.rot90(room(1), 2))),
    "a turn": (room(1), moved(room(1), 1.08, (-300.0, -20.0))), "another size": (room(1), room(1)[::2, ::2]),
    "a fast turn": (turned(room(1), 5.0), turned(room(1), 25.0)),
    "a fast turn back": (turned(room(2), 18.0), turned(room(2), 0.0)),
    "a fast turn that is no larger": (turned(room(3), 0.0), turned(room(3), 18.0)),
    "somebody comes near": (visitor(520), visitor(640)),
    "to black": (room(1), BLACK), "from black": (BLACK, room(1))}


@pytest.mark.parametrize("kind", sorted(OTHERS))
def test_what_has_not_jumped_or_is_another_room(kind):
    before, after = OTHERS[kind]
    assert find_jump(picture_of(before), after) is None


@pytest.mark.parametrize("size", [(1, 1), (3, 900), (63, 1280)])
def test_a_picture_without_room_for_corners_does_not_jump(size):
    image = np.zeros((*size, 3), np.uint8)
    assert find_jump(picture_of(image), image) is None


@pytest.mark.parametrize("jumps, told", [(True, [False, False, True]), (False, [True, False, True])])
def test_a_zoom_is_no_cut_where_jumps_are_looked_for(jumps, told):
    cuts = PictureCuts(jumps)
    cuts.update(room(1), 1.0)
    assert cuts.jump is None
    seen = moved(room(1), 2.0, (-640.0, -360.0)), moved(room(1), 2.0, (-636.0, -360.0)), room(2)
    scales = []
    assert [(cuts.update(image, 1.1 + 0.1 * step), scales.append(cuts.jump and round(cuts.jump.scale, 1)))[0]
            for step, image in enumerate(seen)] == told
    assert scales == [2.0 if jumps else None, None, None]


def test_a_zoom_is_told_after_a_moment_of_dark_and_where_the_images_have_turned():
    cuts = PictureCuts(jumps=True)
    cuts.update(room(1), 1.0)
    cuts.update(np.zeros_like(room(1)), 1.1)
    assert cuts.blank and cuts.jump is None
    rotation = ImageRotation(2, WIDTH, HEIGHT)
    cuts.turn(rotation)
    assert not cuts.update(rotation.image(moved(room(1), 1.6, (-400.0, -200.0))), 1.2)
    assert cuts.jump is not None and cuts.jump.scale == pytest.approx(1.6, rel=0.01)
    cuts.reset()
    assert cuts.jump is None and not cuts.update(room(1), 1.3)


def test_after_images_of_another_size_no_jump_is_looked_for():
    """Their pictures may be of one size, but what is known of them is in pixels of the images."""
    cuts, small = PictureCuts(jumps=True), cv2.resize(room(1), (480, 270), interpolation=cv2.INTER_AREA)
    cuts.update(small, 1.0)
    cuts.update(cv2.resize(moved(room(1), 2.0, (-640.0, -360.0)), (960, 540), interpolation=cv2.INTER_AREA), 1.1)
    assert cuts.jump is None


@pytest.mark.parametrize("shift, jumps", [(90.0, False), (340.0, False), (426.0, True)])
def test_what_is_as_large_as_before_jumps_where_it_would_be_a_cut_only(shift, jumps):
    """Where a camera turns, optical flow and the motion of before tell more."""
    cuts = PictureCuts(jumps=True)
    cuts.update(room(1), 1.0)
    assert not cuts.update(moved(room(1), 1.0, (shift, 0.0)), 1.1)
    assert (cuts.jump is not None) is jumps


def test_after_a_sudden_change_without_a_jump_none_is_looked_for_in_the_next_images(monkeypatch):
    """It takes 10 ms, and where the camera turns fast every image is a sudden change."""
    looks = []
    monkeypatch.setattr(images, "find_jump", lambda before, after: looks.append(stamp))
    cuts = PictureCuts(jumps=True)
    for number, stamp in enumerate(np.arange(1.0, 2.05, 0.1).round(1)):
        cuts.update(room(number), stamp)
    assert looks == [1.1, 1.6]
