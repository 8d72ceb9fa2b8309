import numpy as np
import pytest

from hri_pipeline.core.faces.parameters import FACES
from hri_pipeline.core.ignored_regions import IgnoredRegions
from hri_pipeline.core.image_rotation import ImageRotation
from hri_pipeline.core.parameters import ParameterError

SIZE = (1280, 720)


def box_at(x, y):
    return np.array([x - 20.0, y - 30.0, x + 20.0, y + 30.0])


def test_what_has_its_middle_in_a_region_is_ignored():
    regions = IgnoredRegions(["0 0 0.25 0.5", "0.75 0.5 0.25 0.5"])
    assert regions.contain(box_at(100, 100), SIZE)
    assert regions.contain(box_at(1270, 700), SIZE)
    assert not regions.contain(box_at(330, 100), SIZE), "to the right of the first"
    assert not regions.contain(box_at(100, 370), SIZE), "below it"
    assert not regions.contain(box_at(640, 360), SIZE)


def test_regions_are_shares_of_the_image_whatever_its_size():
    regions = IgnoredRegions(["0.5 0 0.5 1"])
    assert regions.contain(box_at(400, 100), (640, 480))
    assert not regions.contain(box_at(400, 100), (1280, 720))


@pytest.mark.parametrize("quarters", [0, 1, 2, 3])
def test_regions_turn_with_the_images(quarters):
    regions, turn = IgnoredRegions(["0.6 0.1 0.3 0.2"]), ImageRotation(quarters, *SIZE)
    regions.turn(quarters)
    size = SIZE[::-1] if quarters % 2 else SIZE
    for place, inside in ((box_at(960, 144), True), (box_at(640, 144), False), (box_at(960, 400), False)):
        assert regions.contain(turn.box(place), size) == inside


def test_without_regions_nothing_is_ignored():
    assert not IgnoredRegions([]).contain(box_at(0, 0), SIZE)


@pytest.mark.parametrize("row", ["", "0 0 1", "0 0 1 1 1", "a b c d", "0 0 0 0.5", "0.5 0 0.6 1", "-0.1 0 0.5 0.5",
                                 "0 0 nan 1", "100 80 200 300"])
def test_a_region_that_is_none_is_refused_with_what_to_give(row):
    with pytest.raises(ParameterError, match="ignored_regions.*x y width height.*0 to 1"):
        IgnoredRegions([row])


def test_one_text_instead_of_a_list_is_refused():
    with pytest.raises(ParameterError):
        FACES.resolve({"ignored_regions": "0 0 0.5 1"})
