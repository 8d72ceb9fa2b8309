"""The films of the identity benchmark: who is where in them, and when a face is taken for the one of before."""

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import identity_tracks as tracks

FIRST = np.full((tracks.HEIGHT, tracks.WIDTH, 3), 50, np.uint8)
SECOND = np.full((tracks.HEIGHT, tracks.WIDTH, 3), 200, np.uint8)


def middle(image):
    return int(image[int(tracks.CENTRE[1]), int(tracks.CENTRE[0]), 0])


@pytest.mark.parametrize("change", [name for name in tracks.CHANGES if name != "pass_by"])
def test_first_one_person_is_there_and_then_the_other(change):
    image, one, other = tracks.CHANGES[change](FIRST, SECOND, -2.0)
    assert middle(image) == 50 and one is not None and other is None
    image, one, other = tracks.CHANGES[change](FIRST, SECOND, 1.0)
    assert middle(image) == 200 and one is None and other is not None


def test_who_is_passed_by_is_there_again():
    for since, value, first_seen in ((-2.0, 50, True), (0.0, 200, False), (2.0, 50, True)):
        image, one, _ = tracks.CHANGES["pass_by"](FIRST, SECOND, since)
        assert middle(image) == value and (one is not None) == first_seen


def test_the_nearest_face_is_meant_and_none_that_is_far():
    faces = [SimpleNamespace(id=name, box=np.array([x - 50.0, 150.0, x + 50.0, 250.0])) for name, x in (
        ("far", 400.0), ("near", 210.0))]
    assert tracks.at(faces, np.array([200.0, 200.0])).id == "near"
    assert tracks.at(faces, np.array([600.0, 200.0])) is None


def test_pairs_are_of_two_people_on_two_photographs():
    people = [tracks.Portrait(label, file, FIRST) for label, file in (("a", "1"), ("b", "1"), ("c", "2"))]
    pairs = tracks._chosen(people, 10)
    assert len(pairs) == 4 and all(first.file != second.file for first, second in pairs)
