import numpy as np
import pytest

from hri_pipeline.core import person_detector
from hri_pipeline.core.person_detector import (
    CenterNetDetector,
    decode_centres,
    near_view,
    network_size,
    views_around,
)


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


def test_the_view_from_near_by_shows_the_box_and_some_of_its_surroundings_and_grey_outside_the_image():
    image = np.zeros((200, 300, 3), np.uint8)
    image[50:150, 0:40] = 255
    view, box = near_view(image, np.array([0.0, 50.0, 40.0, 150.0]))
    assert view.shape == (256, 256, 3) and box[3] - box[1] == pytest.approx(256.0 / 1.3)
    assert box[:2] + box[2:] == pytest.approx([256.0, 256.0])
    inner, beside = view[128, int(box[0]) + 10:int(box[2]) - 10], view[128, int(box[2]) + 10:]
    assert np.all(inner == 255) and np.all(beside == 0) and np.all(view[128, :int(box[0]) - 10] == 128)


DOG = 16


@pytest.mark.parametrize("first, near, human", [
    ((0.4, 0.1), (0.4, 0.1), True), ((0.4, 0.2), (0.4, 0.2), False), ((0.7, 0.02), (0.3, 0.2), True),
    ((0.4, 0.1), (0.0, 0.0), False), ((0.25, 0.0), (0.3, 0.1), True)],
    ids=["twice", "hardly", "far apart at first", "vanishes", "faint without an animal"])
@pytest.mark.parametrize("animal", [DOG, BEAR])
def test_a_human_leads_over_animals_and_toys_in_two_looks(monkeypatch, first, near, human, animal):
    looks = []

    class Network:
        def __init__(self, *args, **kwargs):
            pass

        def run(self, inputs):
            images = inputs["images"]
            looks.append(images)
            cells = images.shape[1] // 4
            heat = np.zeros((len(images), cells, cells, 80), np.float32)
            extents = np.full((len(images), cells, cells, 4), 50.0 if len(looks) == 1 else 98.0, np.float32)
            person, rival = first if len(looks) == 1 else near
            heat[:, cells // 2, cells // 2, 0], heat[:, cells // 2, cells // 2 + 1, animal] = person, rival
            heat[:, 2, 2, animal] = 0.9     # elsewhere
            return {"heat": heat, "ltrb": extents}

    monkeypatch.setattr(person_detector, "OnnxModel", Network)
    detector = CenterNetDetector("network.onnx", threshold=0.15, long_side=128)
    image = np.random.RandomState(1).randint(0, 255, (128, 128, 3), np.uint8)
    boxes, scores = detector.detect(image)
    assert scores == pytest.approx([first[0]])
    assert detector.is_human(image, boxes[0]) is human
    assert looks[1].shape == (2, 256, 256, 3) and np.array_equal(looks[1][1], looks[1][0][:, ::-1])


def test_the_views_around_a_face_show_shoulders_and_trunk_and_grey_outside_the_image():
    image = np.zeros((200, 300, 3), np.uint8)
    image[100:140, 0:30] = 255
    (near, far), places = views_around(image, np.array([0.0, 100.0, 30.0, 140.0]))
    assert near.shape == far.shape == (256, 256, 3)
    for view, (x, y), size in ((near, places[0], 256.0 / 2.8), (far, places[1], 256.0 / 4.8)):
        left, right, below = (int(round(value)) for value in (x - 0.25 * size, x + 0.25 * size, y + 0.7 * size))
        assert np.all(view[int(y), left:right] == 255) and np.all(view[below, left:right] == 0)
        assert np.all(view[int(y), :int(x - 0.5 * size)] == 128)
    assert places[:, 0] == pytest.approx([128.0, 128.0])
    assert places[0, 1] == pytest.approx(128.0 - 0.3 * 256.0 / 2.8)
    assert places[1, 1] == pytest.approx(128.0 - 1.2 * 256.0 / 4.8)


CHAIR = 56


@pytest.mark.parametrize("person, rival, beside, lead", [
    (0.49, 0.09, 0.0, 5.0), (0.09, 0.49, 0.0, 0.2), (0.0, 0.0, 0.0, 1.0), (0.49, 0.09, 0.9, 5.0)],
    ids=["a person", "a thing", "nothing", "a thing elsewhere"])
@pytest.mark.parametrize("kind", [DOG, CHAIR])
def test_a_person_around_a_face_is_compared_with_what_else_is_there(monkeypatch, person, rival, beside, lead, kind):
    face, image = np.array([100.0, 100.0, 150.0, 150.0]), np.zeros((400, 400, 3), np.uint8)
    cells = np.rint(views_around(image, face)[1] / 4.0).astype(int)

    class Network:
        def __init__(self, *args, **kwargs):
            pass

        def run(self, inputs):
            assert inputs["images"].shape == (2, 256, 256, 3)
            heat, extents = np.zeros((2, 64, 64, 80), np.float32), np.full((2, 64, 64, 4), 12.0, np.float32)
            for index, (x, y) in enumerate(cells):
                heat[index, y, x + 1, 0], heat[index, y, x - 1, kind] = person, rival
                heat[index, 50, 5, kind] = beside
            return {"heat": heat, "ltrb": extents}

    monkeypatch.setattr(person_detector, "OnnxModel", Network)
    assert CenterNetDetector("network.onnx").lead_around(image, face) == pytest.approx(lead)
