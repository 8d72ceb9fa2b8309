"""Scheduling of the detector, and of the networks of the analysis."""

from collections import Counter
from unittest.mock import Mock

import numpy as np
import pytest

from hri_pipeline.core.faces.detector import tile_regions, wide_region
from hri_pipeline.core.faces.scheduler import STILL_FACTOR, CropQualities, DetectionScheduler, TimeBudget, next_turn

WHOLE = (0, 0, 640, 480)
PARTS = tile_regions(640, 480, 2) + [wide_region(640, 480)]
GREY = np.full((480, 640, 3), 90, np.uint8)


def test_work_of_ten_shares_leaves_nine_images_out():
    share = TimeBudget(0.005)
    allowed = []
    for _ in range(40):
        allowed.append(share.next_image())
        if allowed[-1]:
            share.spent(0.05)
    assert allowed == ([True] + [False] * 9) * 4


def test_work_within_the_share_is_done_in_every_image():
    share = TimeBudget(0.005)
    for _ in range(20):
        assert share.next_image()
        share.spent(0.004)


def test_a_larger_share_pays_sooner_and_nonsense_is_refused():
    share = TimeBudget(0.001)
    share.spent(0.01)
    assert not share.next_image()
    share.change(0.01)
    assert share.next_image()
    share.spent(float("nan"))
    share.spent(-1.0)
    assert share.next_image()
    for wrong in (0.0, -0.1, float("nan")):
        with pytest.raises(ValueError):
            share.change(wrong)


def test_what_is_saved_up_is_there_at_once_and_comes_again_in_quiet_images():
    share = TimeBudget(0.005, saved=0.1)

    def done(images):
        count = 0
        for _ in range(images):
            if share.next_image():
                share.spent(0.025)
                count += 1
        return count

    assert share.ample
    assert done(5) == 5                 # 0.125 of 0.1 and five shares
    assert not share.ample
    assert done(100) == 20              # as without savings
    for _ in range(10):
        share.next_image()
    assert done(3) == 3                 # 0.05 has been saved up
    for _ in range(1000):
        share.next_image()
    assert done(20) == 5 + 3            # no more than 0.1 is


def test_savings_that_are_none_are_refused():
    for wrong in (-0.1, float("nan")):
        with pytest.raises(ValueError):
            TimeBudget(0.005, wrong)


def test_a_slow_image_pays_for_more():
    share = TimeBudget(0.005)
    share.spent(0.02)
    assert share.next_image(1.0)


def noise(index):
    return np.random.RandomState(index).randint(0, 255, (480, 640, 3), np.uint8)


def test_starts_with_everything_then_alternates_while_the_picture_changes():
    schedule = DetectionScheduler(period=0.3, tiles=2)
    asked = [schedule.due(noise(index), 10.0 + 0.05 * index) for index in range(60)]
    assert len(asked[0]) == 6
    later = [regions[0] for regions in asked[1:] if regions]
    assert all(len(regions) <= 1 for regions in asked[1:])
    assert 0.35 < np.mean([region == WHOLE for region in later]) < 0.65
    assert set(later) == {WHOLE} | set(PARTS)
    schedule.reset()
    assert len(schedule.due(GREY, 0.0)) == 6


def tiles_asked(schedule, images, **about):
    asked = [schedule.due(image, 0.05 * index, **about) for index, image in enumerate(images)]
    return [region for regions in asked[1:] for region in regions if region != WHOLE]


def test_a_still_picture_is_searched_in_parts_now_and_then_only():
    still = len(tiles_asked(DetectionScheduler(0.3, 2), [GREY] * 100))
    lively = len(tiles_asked(DetectionScheduler(0.3, 2), [noise(index) for index in range(100)]))
    assert 5 <= still <= 10 and lively >= 14, "5 s: each of five parts once in {:g} s".format(0.3 * STILL_FACTOR)


def test_the_part_that_changes_is_searched():
    images = []
    for index in range(60):
        image = GREY.copy()
        image[300:400, 450:600] = 4 * index
        images.append(image)
    asked = tiles_asked(DetectionScheduler(0.3, 2), images[:50])
    assert asked and set(asked) == {PARTS[3], PARTS[4]}, "the last tile, and the whole with a border"


def test_the_part_where_a_face_waits_is_searched():
    asked = tiles_asked(DetectionScheduler(0.3, 2), [GREY] * 40, waiting=[np.array([100.0, 50.0])])
    assert set(asked) == {PARTS[0], PARTS[4]} and len(asked) >= 5


def test_quiet_halves_the_looks_and_hurry_ends_it():
    counts = [sum(bool(schedule.due(GREY, 0.05 * index, quiet=quiet)) for index in range(120))
              for schedule, quiet in ((DetectionScheduler(0.3, 1), False), (DetectionScheduler(0.3, 1), True))]
    assert counts[0] == pytest.approx(2 * counts[1], abs=1)
    schedule = DetectionScheduler(0.4, 1)
    schedule.due(GREY, 0.0, quiet=True)
    schedule.hurry(0.1)
    assert not schedule.due(GREY, 0.45) and schedule.due(GREY, 0.5) == [WHOLE]


def test_does_not_depend_on_the_frame_rate():
    counts = []
    for rate in (10.0, 30.0):
        schedule = DetectionScheduler(period=0.4, tiles=1)
        counts.append(sum(bool(schedule.due(GREY, index / rate)) for index in range(int(4 * rate))))
    assert counts == [10, pytest.approx(10, abs=1)]


def test_another_size_of_image_starts_anew():
    schedule = DetectionScheduler(0.3, 2)
    schedule.due(GREY, 0.0)
    assert len(schedule.due(GREY[:240, :320], 1.0)) == 6
    assert schedule.due(np.zeros((1, 1, 3), np.uint8), 2.0)


@pytest.mark.parametrize("arguments", [(-0.1, 2), (0.3, 0)])
def test_refuses_nonsense(arguments):
    with pytest.raises(ValueError):
        DetectionScheduler(*arguments)


def test_the_most_overdue_comes_first():
    assert next_turn({"expression": 1.5, "age_gender": 2.0, "recognition": 0.0}, "") == "age_gender"
    assert next_turn({"expression": 1.5, "age_gender": 0.5, "recognition": 4.0}, "expression") == "recognition"


def test_none_is_shut_out_by_one_that_is_always_due():
    counts, last = Counter(), ""
    for _ in range(100):
        last = next_turn({"expression": 2.0, "age_gender": 2.0, "recognition": 4.0}, last)
        counts[last] += 1
    assert counts["recognition"] == 50 and counts["expression"] + counts["age_gender"] == 50


def test_the_last_one_goes_on_when_no_other_is_due():
    assert next_turn({"expression": 0.9, "age_gender": 0.0, "recognition": 4.0}, "recognition") == "recognition"
    assert next_turn({"expression": 0.9, "age_gender": 0.0, "recognition": 0.0}, "recognition") == "expression"


def test_crops_that_are_poor_say_what_spoils_them():
    qualities, mesh = CropQualities(), np.zeros((478, 3))
    mesh[:, :2] = (107.0, 105.0)
    mesh[[33, 263, 152], :2] = (100.0, 100.0), (114.0, 100.0), (107.0, 114.0)
    face = Mock(id="f1", mesh=mesh, pose=None, score=1.0)
    image = np.random.default_rng(1).integers(0, 256, (240, 320, 3), dtype=np.uint8)
    quality = qualities.update(image, [face], 1.0)["f1"]
    assert qualities.flaws(quality + 0.01) == {"f1": "small (14 px between the eyes)"}
    assert qualities.flaws(quality) == {}
    assert qualities.of_templates({"f1": quality, "f2": 0.0}) == {"f1": quality, "f2": 0.0}
    assert qualities.update(np.full_like(image, 255), [face], 9.0) == {"f1": 0.0}
    assert qualities.of_templates({"f1": 0.9}) == {"f1": 0.0}, "burnt white"
