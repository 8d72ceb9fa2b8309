"""The images without people: which of them are for tuning, and how false ones are counted."""

import cv2
import numpy as np
import pytest

from benchmarks import identity_false


def test_patterns_are_the_same_each_time_of_every_kind_and_of_two_halves():
    tuning, others = ([name for name, _ in identity_false.patterns(half, 12)] for half in (True, False))
    assert len(tuning) == len(others) == 6 and not set(tuning) & set(others)
    assert {name.split()[0] for name in others} == {kind.__name__ for kind in identity_false.KINDS}
    for (_, one), (_, again) in zip(identity_false.patterns(False, 6), identity_false.patterns(False, 6)):
        assert one.shape == (480, 640, 3) and one.dtype == np.uint8 and (one == again).all()


def test_photographs_are_those_of_their_half_whole_and_in_parts(tmp_path, monkeypatch):
    monkeypatch.setenv("ROS4HRI_NO_PEOPLE", str(tmp_path))
    for half, value in (("tuning", 10), ("report", 200)):
        (tmp_path / half).mkdir()
        cv2.imwrite(str(tmp_path / half / "cat.jpg"), np.full((60, 80, 3), value, np.uint8))
    images = list(identity_false.photographs(tuning=False))
    assert len(images) == 1 + identity_false.PARTS and all(image.mean() > 190.0 for _, image in images)
    assert images[0][1].shape == (60, 80, 3) and all(image.shape[0] < 60 for _, image in images[1:])
    (tmp_path / "report" / "broken.jpg").write_bytes(b"nothing")
    with pytest.raises(ValueError, match="broken.jpg"):
        list(identity_false.photographs(tuning=False))


class Watcher:
    """Publishes a face of bright images, and a body of red ones."""

    @staticmethod
    def published(image):
        return {"faces": int(image[..., 1].mean() > 128), "bodies": int(image[..., 2].mean() > 128)}


def test_an_image_counts_once_whatever_is_published():
    images = [(name, np.full((4, 4, 3), colour, np.uint8)) for name, colour in (
        ("dark", (0, 0, 0)), ("bright", (255, 255, 255)), ("red", (0, 0, 255)), ("green", (0, 255, 0)))]
    result = identity_false.counted(iter(images), Watcher())
    assert result == {"images": 4, "wrong": 3, "faces": ["bright", "green"], "bodies": ["bright", "red"]}
    assert identity_false.per_1000({"photographs": result, "patterns": {"images": 6, "wrong": 0}}) == 300.0


def test_no_image_is_no_figure():
    with pytest.raises(ValueError, match="no image"):
        identity_false.per_1000({"photographs": {"images": 0, "wrong": 0}})
