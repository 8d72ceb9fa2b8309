"""Upright crops of faces and what they are worth."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hri_pipeline.core.faces.crops import (
    MAX_SIZE,
    DarkGlasses,
    aligned_crop,
    behind_dark_glasses,
    box_crop,
    burnt_part,
    crop_quality,
    cut,
    judge_crop,
    relative_noise,
    turned_away,
    upright_roi,
)
from hri_pipeline.core.faces.mesh import FaceRoi
from hri_pipeline.core.geometry import Pose

UPRIGHT = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])


def points_at(centre, size, roll_deg=0.0, count=478):
    """Points of a face: the corners of a box and, at a third of its height, the outer corners of the eyes."""
    xy = np.zeros((count, 2))
    xy[0], xy[1], xy[2], xy[3] = (-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)
    right, left = (36, 45) if count == 70 else (33, 263)
    xy[right], xy[left] = (-0.3, -0.15), (0.3, -0.15)
    turn = np.radians(roll_deg)
    matrix = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    return np.concatenate([xy @ matrix.T * size + centre, np.ones((count, 1))], axis=1)


def picture(points, count=478):
    """A picture with a white right eye and a grey left eye at the points."""
    image = np.zeros((400, 600, 3), np.uint8)
    for index, colour in ((36 if count == 70 else 33, (255, 255, 255)), (45 if count == 70 else 263, (120, 120, 120))):
        cv2.circle(image, tuple(int(value) for value in points[index, :2]), 6, colour, -1)
    return image


@pytest.mark.parametrize("count", [478, 70])
@pytest.mark.parametrize("roll", [0, 30, -75, 170])
@pytest.mark.parametrize("size", [40, 112, 256])
def test_a_crop_is_upright_with_level_eyes(count, roll, size):
    points = points_at((300, 200), 120, roll, count)
    crop = aligned_crop(picture(points, count), points, size, margin=1.5)
    assert crop.shape == (size, size, 3) and crop.dtype == np.uint8
    grey = cv2.resize(crop, (150, 150))[..., 0].astype(int)
    white, dim = (np.argwhere(mask).mean(axis=0) for mask in (grey > 180, (grey > 60) & (grey < 140)))
    assert white == pytest.approx((75 - 0.1 * 150, 75 - 0.2 * 150), abs=6), "row, column of the subject's right eye"
    assert dim[1] > white[1]


def test_a_large_face_is_averaged_and_not_sampled():
    image = np.zeros((400, 600, 3), np.uint8)
    image[::2] = 255
    crop = cut(image, FaceRoi(np.array([300.0, 200.0]), 320.0, 0.0), 32)
    assert 100 < crop[4:-4].min() and crop[4:-4].max() < 155


def test_a_crop_at_the_border_repeats_the_border():
    image = np.full((100, 100, 3), 77, np.uint8)
    for size in (16, 200):
        crop = aligned_crop(image, points_at((2, 2), 60), size)
        assert (crop == 77).all()


@pytest.mark.parametrize("size", [0, -1, MAX_SIZE + 1])
def test_a_size_that_is_not_legal_is_refused(size):
    with pytest.raises(ValueError, match="size of a crop"):
        aligned_crop(np.zeros((50, 50, 3), np.uint8), points_at((20, 20), 20), size)


@pytest.mark.parametrize("points",
                         [np.zeros((478, 3)), np.full((478, 3), np.nan), np.ones((12, 3)) * np.arange(12)[:, None]])
def test_points_that_are_no_face_are_refused(points):
    with pytest.raises(ValueError):
        upright_roi(points)


def test_box_crop_keeps_the_proportions_and_is_black_outside():
    image = np.full((200, 300, 3), 200, np.uint8)
    cv2.circle(image, (150, 100), 20, (0, 0, 255), -1)
    crop = box_crop(image, (100, 50, 200, 150), 64, 128)
    assert crop.shape == (128, 64, 3)
    red = np.argwhere((crop[..., 2] > 200) & (crop[..., 0] < 60))
    assert np.ptp(red, axis=0) == pytest.approx((25, 25), abs=3), "a circle stays a circle"
    outside = box_crop(image, (-100, -50, 50, 100), 64, 64)
    assert (outside[:10, :10] == 0).all() and (outside[-5:, -5:] == 200).all()
    for box, width in (((0, 0, 0, 10), 64), ((0, 0, 10, np.nan), 64), ((0, 0, 10, 10), 0)):
        with pytest.raises(ValueError):
            box_crop(image, box, width, 64)


def texture(seed=0):
    noise = np.random.RandomState(seed).randint(0, 255, (128, 128), np.uint8)
    smooth = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 3.0), None, 0, 255, cv2.NORM_MINMAX)
    return cv2.cvtColor(smooth, cv2.COLOR_GRAY2BGR)


def facing(yaw_deg):
    turn = Rotation.from_euler("y", -yaw_deg, degrees=True).as_matrix()
    return Pose(turn @ UPRIGHT, np.array([0.0, 0.0, 1.0]))


def overexposed(crop, gain):
    return np.clip(gain * crop.astype(np.float32), 0, 255).astype(np.uint8)


def test_quality_falls_with_every_fault():
    points = points_at((300, 200), 150)
    crop = texture()
    good = crop_quality(points, facing(0), crop)
    assert 0.8 < good <= 1.0
    faults = {
        "blurred": crop_quality(points, facing(0), cv2.GaussianBlur(crop, (0, 0), 9)),
        "flat": crop_quality(points, facing(0), (120 + 0.02 * crop).astype(np.uint8)),
        "turned": crop_quality(points, facing(55), crop),
        "small": crop_quality(points_at((300, 200), 30), facing(0), crop),
        "doubtful": crop_quality(points, facing(0), crop, presence=0.3),
        "cut off": crop_quality(points_at((-5, 200), 150), facing(0), crop, image_size=(600, 400)),
        "without pose": crop_quality(points, None, crop)}
    for name, quality in faults.items():
        assert 0.0 <= quality < good - 0.1, name
    assert crop_quality(points, facing(80), crop) == 0.0
    assert crop_quality(np.full((478, 3), np.nan), facing(0), crop) == 0.0
    assert crop_quality(points, facing(0), np.zeros((64, 64, 3), np.uint8)) == 0.0


@pytest.mark.parametrize("flaw, size, angle, blur, contrast, presence", [
    ("small (18 px between the eyes)", 30, 0, 0, 1.0, 1.0), ("turned away (55 degrees)", 150, 55, 0, 1.0, 1.0),
    ("blurred", 150, 0, 9, 1.0, 1.0), ("dark or flat", 150, 0, 0, 0.02, 1.0), ("hardly a face", 150, 0, 0, 1.0, 0.3)])
def test_a_crop_says_what_spoils_it_most(flaw, size, angle, blur, contrast, presence):
    crop = cv2.GaussianBlur(texture(), (0, 0), blur) if blur else texture()
    crop = (120.0 * (contrast < 1.0) + contrast * crop).astype(np.uint8)
    judged = judge_crop(points_at((300, 200), size), facing(angle), crop, presence)
    assert judged.flaw == flaw
    assert judged.quality == crop_quality(points_at((300, 200), size), facing(angle), crop, presence)


def test_what_is_burnt_white_makes_no_template_and_a_few_highlights_are_no_harm():
    """The white parts have sharp edges and much contrast."""
    points, crop = points_at((300, 200), 150), texture()
    good = judge_crop(points, facing(0), crop)
    highlights, washed_out, white = (judge_crop(points, facing(0), overexposed(crop, gain)) for gain in (1.4, 1.9, 2.5))
    assert 0.1 < burnt_part(overexposed(crop, 1.4)) < 0.2 and burnt_part(overexposed(crop, 2.5)) > 0.85
    assert good.template_quality == good.quality and good.exposure == 1.0
    assert highlights.template_quality >= good.quality - 0.05 and highlights.flaw != "overexposed"
    assert 0.35 <= washed_out.template_quality < 0.5, "who is known may be seen by it, nobody new"
    assert white.template_quality < 0.1 and white.flaw == washed_out.flaw == "overexposed"
    assert white.quality >= good.quality - 0.05, "age and gender are still seen"
    assert judge_crop(points, facing(0), crop[:3, :3]).exposure == 1.0, "a crop that has no middle"


def test_turned_away():
    assert turned_away(facing(0)) == pytest.approx(0.0, abs=1e-6)
    assert np.degrees(turned_away(facing(-40))) == pytest.approx(40.0)


def test_noise_is_told_from_details():
    crop, random = texture().astype(np.float64), np.random.RandomState(3)
    assert relative_noise(texture()) < 0.06, "details alone"
    for sd in (20.0, 40.0):
        small = cv2.resize(texture(), (48, 48), interpolation=cv2.INTER_AREA)[..., :1]
        grainy = np.clip(small + random.normal(0.0, sd, (48, 48, 1)), 0, 255).astype(np.uint8).repeat(3, axis=2)
        assert relative_noise(grainy) == pytest.approx(sd / grainy.std(), rel=0.25)
    soft = cv2.GaussianBlur(crop + random.normal(0.0, 40.0, crop.shape), (0, 0), 4.0)
    assert relative_noise(np.clip(soft, 0, 255).astype(np.uint8)) < 0.06, "noise that was smoothed away"
    assert relative_noise(np.full((112, 112, 3), 90, np.uint8)) < 1e-3


def turned(yaw):
    return Pose(Rotation.from_euler("y", yaw, degrees=True).as_matrix() @ UPRIGHT, np.array([0.0, 0.0, 0.7]))


def bright_face(lenses):
    """A picture (200, 300, 3) of a bare face, with lenses of this grey value, and its mesh."""
    mesh, image = np.zeros((478, 3)), np.full((200, 300, 3), 180, np.uint8)
    mesh[:, :2] = (150.0, 100.0)
    mesh[[33, 133, 362, 263, 2], :2] = [(118, 80), (136, 82), (164, 82), (182, 80), (150, 118)]
    for x in (127, 173):
        cv2.ellipse(image, (x, 84), (18, 13), 0, 0, 360, (lenses, lenses, lenses), -1)
    return image, mesh


def test_dark_glasses_are_off_when_two_looks_from_the_front_show_none():
    glasses, dark, bare = DarkGlasses(), bright_face(15), bright_face(150)
    seen = [glasses.update(*picture, turned(yaw), stamp) for stamp, picture, yaw in (
        (0.0, bare, 0), (0.1, dark, 0), (0.6, dark, 0), (1.2, bare, 50), (1.8, bare, 50), (2.4, bare, 50),
        (3.0, bare, 0), (3.2, bare, 0), (3.6, bare, 0), (4.2, dark, 50))]
    #                a look: no dark lens; no look yet; on; from the side one may be missed; off; on
    assert seen == [False, False, True, True, True, True, True, True, False, True]


def test_one_missed_look_does_not_take_dark_glasses_off():
    glasses, dark, bare = DarkGlasses(), bright_face(15), bright_face(150)
    assert all(glasses.update(*picture, turned(0), 0.5 * number) for number, picture in enumerate((dark, bare) * 4))


def coloured_face(lenses, skin=(120, 150, 190), below=True):
    """A crop (150, 150, 3) of bare skin with lenses, or with make-up that ends above what is below the eyes."""
    crop = np.empty((150, 150, 3), np.uint8)
    crop[:] = skin
    for x in (46, 104):
        cv2.ellipse(crop, (x, 47), (22, 15 if below else 5), 0, 0, 360, lenses, -1)
    return crop


def test_lenses_that_mirror_in_a_colour_are_found_in_light_of_any_colour_and_make_up_is_none():
    assert behind_dark_glasses(coloured_face((235, 190, 140))) and behind_dark_glasses(coloured_face((60, 140, 240)))
    assert not behind_dark_glasses(coloured_face((235, 190, 140), below=False))
    assert not behind_dark_glasses(coloured_face((96, 120, 152))), "the shade of skin"
    for skin in ((190, 150, 120), (60, 70, 200), (0, 0, 0)):
        assert not behind_dark_glasses(coloured_face(skin, skin)), "in light of a colour, and without any"


@pytest.mark.parametrize("blotches", [False, True])
def test_noise_in_dim_light_is_no_colour_of_lenses(blotches):
    random = np.random.default_rng(4)

    def noisy(crop):
        small = cv2.resize(crop, (50, 50), interpolation=cv2.INTER_AREA)
        noise = random.normal(0.0, 4.0, small.shape)
        if blotches:
            noise = 4.0 * cv2.GaussianBlur(noise, (0, 0), 3.0) / cv2.GaussianBlur(noise, (0, 0), 3.0).std()
        return np.clip(small + noise, 0.0, 255.0).round().astype(np.uint8)

    skin = (10, 12, 16)
    assert not any(behind_dark_glasses(noisy(coloured_face(skin, skin))) for _ in range(40))
    mirrors = coloured_face((44, 28, 16), skin)
    assert sum(behind_dark_glasses(noisy(mirrors)) for _ in range(40)) >= 36, "bright blue ones"
