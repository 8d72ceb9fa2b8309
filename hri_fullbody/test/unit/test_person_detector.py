import numpy as np
import pytest

from hri_fullbody.core.detection import person_detector
from hri_fullbody.core.detection.person_detector import CenterNetDetector, decode_centres, network_size


@pytest.mark.parametrize("image, wanted", [
    ((1280, 720), (512, 288)), ((640, 480), (512, 384)), ((480, 640), (384, 512)), ((2000, 20), (512, 32))])
def test_network_size_keeps_the_aspect_in_steps_of_32(image, wanted):
    assert network_size(image[0], image[1], 512) == wanted


def heat_with(peaks):
    heat, extents = np.zeros((40, 60), np.float32), np.full((40, 60, 4), 20.0, np.float32)
    for row, column, score in peaks:
        heat[row, column] = score
    return heat, extents


def test_a_peak_becomes_a_box_around_its_cell():
    heat, extents = heat_with([(10, 20, 0.8)])
    heat[10, 21] = 0.7
    extents[10, 20] = (8.0, 16.0, 12.0, 24.0)
    boxes, scores = decode_centres(heat, extents, 0.3)
    assert boxes == pytest.approx(np.array([[72.0, 24.0, 92.0, 64.0]]))
    assert scores == pytest.approx([0.8])


def test_boxes_come_best_first_without_overlap_and_without_faint_ones():
    heat, extents = heat_with([(10, 10, 0.5), (10, 12, 0.6), (10, 40, 0.9), (30, 30, 0.29)])
    boxes, scores = decode_centres(heat, extents, 0.3)
    assert scores == pytest.approx([0.9, 0.6])
    assert boxes.shape == (2, 4)


def test_nobody_gives_empty_arrays():
    boxes, scores = decode_centres(*heat_with([]), threshold=0.3)
    assert boxes.shape == (0, 4)
    assert scores.shape == (0,)


BEAR, SOFA = 77, 57


@pytest.mark.parametrize("rival, score, reach, people", [
    (BEAR, 0.7, 20.0, 0), (BEAR, 0.5, 20.0, 1), (SOFA, 0.9, 26.0, 1)],
    ids=["a likelier bear", "a less likely bear", "a sofa around somebody"])
def test_a_box_that_another_class_claims_with_more_right_is_no_person(monkeypatch, rival, score, reach, people):
    heat, extents = np.zeros((1, 32, 32, 80), np.float32), np.full((1, 32, 32, 4), 20.0, np.float32)
    heat[0, 16, 16, 0] = 0.6
    heat[0, 16, 17, rival] = score
    extents[0, 16, 17] = reach

    class Network:
        def __init__(self, *args, **kwargs):
            pass

        def run(self, inputs):
            return {"heat": heat, "ltrb": extents}

    monkeypatch.setattr(person_detector, "OnnxModel", Network)
    boxes, scores = CenterNetDetector("network.onnx", long_side=128).detect(np.zeros((128, 128, 3), np.uint8))
    assert len(boxes) == len(scores) == people
