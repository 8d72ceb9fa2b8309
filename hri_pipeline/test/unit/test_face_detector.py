"""Anchors, non-maximum suppression, tiles and the schedule of the face detector."""

import numpy as np
import pytest

from hri_pipeline.core.faces.detector import (
    ANCHOR_STRIDES,
    ANCHORS_PER_CELL,
    INPUT_SIZE,
    FaceDetector,
    ssd_anchors,
    tile_regions,
    weighted_nms,
    wide_region,
)
from hri_pipeline.core.process import ONE_THREAD


class OneFace:
    """Stands for the network: it puts one face over the given anchor of each input."""

    def __init__(self, anchor, logit):
        self.anchor, self.logit = anchor, logit
        self.inputs = []

    threads = ONE_THREAD

    def run_items(self, items, prepare, shape):
        batch = np.empty((len(items), *shape), np.float32)
        return [prepare(item, place) for item, place in zip(items, batch)], self.run(batch)

    def run(self, batch):
        self.inputs.append(batch.copy())
        regressors = np.zeros((len(batch), 2304, 16), np.float32)
        logits = np.full((len(batch), 2304, 1), -20.0, np.float32)
        regressors[:, self.anchor, 2:4] = 40.0
        logits[:, self.anchor] = self.logit
        return {"Identity": regressors, "Identity_1": logits}


def test_full_range_anchors_are_the_centres_of_48_by_48_cells():
    anchors = ssd_anchors(INPUT_SIZE, ANCHOR_STRIDES, ANCHORS_PER_CELL)
    assert anchors.shape == (2304, 2)
    assert anchors[0] == pytest.approx((0.5 / 48, 0.5 / 48))
    assert anchors[1] == pytest.approx((1.5 / 48, 0.5 / 48))
    assert anchors[-1] == pytest.approx((47.5 / 48, 47.5 / 48))


def test_equal_strides_share_a_grid():
    anchors = ssd_anchors(128, (8, 16, 16, 16), 2)
    assert anchors.shape == (896, 2)
    assert (anchors[512:518] == anchors[512]).all()


@pytest.mark.parametrize("arguments", [(0, (4,), 1), (192, (0,), 1), (192, (4,), 0)])
def test_anchors_refuse_nonsense(arguments):
    with pytest.raises(ValueError):
        ssd_anchors(*arguments)


def detections(*faces):
    boxes = np.array([(x, y, x + size, y + size) for x, y, size, _ in faces], float).reshape(-1, 4)
    keypoints = np.repeat(boxes[:, None, :2], 6, axis=1)
    return boxes, keypoints, np.array([face[3] for face in faces], float)


def test_nms_averages_by_score_and_keeps_the_best_score():
    merged = weighted_nms(*detections((300, 0, 50, 0.7), (0, 0, 100, 0.6), (10, 0, 100, 0.9)))
    assert [face.score for face in merged] == [0.9, 0.7]
    assert merged[0].box == pytest.approx((6, 0, 106, 100))
    assert merged[0].keypoints[3] == pytest.approx((6, 0))
    assert merged[1].box == pytest.approx((300, 0, 350, 50))


def test_nms_of_nothing_and_of_neighbours():
    assert weighted_nms(*detections()) == []
    assert len(weighted_nms(*detections((0, 0, 100, 0.9), (80, 0, 100, 0.8)))) == 2


@pytest.mark.parametrize("size", [(1280, 720), (639, 481), (193, 1000)])
def test_tiles_cover_the_image_and_stay_inside(size):
    width, height = size
    covered = np.zeros((height, width), int)
    for x0, y0, x1, y1 in tile_regions(width, height, 3):
        assert 0 <= x0 < x1 <= width and 0 <= y0 < y1 <= height
        covered[y0:y1, x0:x1] += 1
    assert covered.min() >= 1


def test_one_tile_is_no_tile():
    assert tile_regions(640, 480, 1) == []


@pytest.mark.parametrize("score", [0.0, 1.0, -1.0])
def test_detector_refuses_a_score_that_no_detection_can_have(score):
    with pytest.raises(ValueError, match="score"):
        FaceDetector(OneFace(0, 1.0), score)


@pytest.mark.parametrize("size", [(1280, 720), (100, 300), (64, 48), (1, 1)])
def test_a_detection_comes_back_to_the_place_in_the_image(size):
    width, height = size
    centre = 24 * 48 + 24
    detector = FaceDetector(OneFace(centre, 2.0))
    face, = detector.detect(np.zeros((height, width, 3), np.uint8), [(0, 0, width, height)])
    scale = max(width, height) / 192.0
    middle = (face.box[:2] + face.box[2:]) / 2.0
    assert middle == pytest.approx((width / 2, height / 2), abs=3.0 * scale)
    assert face.box[2] - face.box[0] == pytest.approx(40.0 * scale)
    assert face.score == pytest.approx(1 / (1 + np.exp(-2.0)))


def test_regions_are_found_at_their_offset_and_below_the_score_nothing_is():
    image = np.zeros((400, 400, 3), np.uint8)
    centre = 24 * 48 + 24
    face, = FaceDetector(OneFace(centre, 2.0)).detect(image, [(200, 100, 392, 292)])
    assert face.box == pytest.approx((278, 178, 318, 218))
    assert FaceDetector(OneFace(centre, 0.0)).detect(image, [(0, 0, 400, 400)]) == []
    assert FaceDetector(OneFace(centre, 2.0)).detect(image, []) == []


def test_a_region_that_is_larger_than_the_image_has_a_black_border():
    network = OneFace(24 * 48 + 24, 2.0)
    image = np.full((100, 200, 3), 255, np.uint8)
    region = wide_region(200, 100)
    assert region == (-50, -50, 250, 150)
    face, = FaceDetector(network).detect(image, [region])
    assert (face.box[:2] + face.box[2:]) / 2.0 == pytest.approx((100, 50), abs=5.0)
    batch = network.inputs[0][0]
    assert (batch[70:120, 40:150] == 1.0).all()
    assert (batch[:60] == -1.0).all() and (batch[135:] == -1.0).all() and (batch[:, :28] == -1.0).all()


def test_the_input_is_rgb_from_minus_one_to_one_with_black_borders():
    network = OneFace(0, -20.0)
    image = np.zeros((96, 192, 3), np.uint8)
    image[...] = (255, 0, 51)
    FaceDetector(network).detect(image, [(0, 0, 192, 96)])
    batch = network.inputs[0][0]
    assert batch[96, 96] == pytest.approx((51 / 127.5 - 1, -1.0, 1.0))
    assert (batch[:48] == -1.0).all() and (batch[144:] == -1.0).all()


def test_a_face_is_looked_for_again_in_a_square_of_its_own():
    image = np.zeros((400, 400, 3), np.uint8)
    network = OneFace(24 * 48 + 24, 2.0)
    # The face of the network is 40 of 192 px: that of a square of 4 sizes of 50 px is 41.7 px wide.
    places = [np.array([150.0, 150.0, 200.0, 200.0]), np.array([-60.0, -60.0, -10.0, -10.0])]
    near, outside = FaceDetector(network).look_again(image, places)
    assert len(network.inputs) == 1 and network.inputs[0].shape[0] == 2, "in one batch"
    assert (near.box[:2] + near.box[2:]) / 2.0 == pytest.approx((177, 177), abs=3.0)
    assert near.box[2] - near.box[0] == pytest.approx(41.7, abs=1.0)
    assert outside is None, "its square was moved into the image"
    assert FaceDetector(network).look_again(image, []) == []


@pytest.mark.parametrize("anchor, logit", [(24 * 48 + 24, -1.0), (8 * 48 + 24, 2.0)])
def test_a_face_that_is_faint_or_beside_is_not_found_again(anchor, logit):
    box = np.array([150.0, 150.0, 200.0, 200.0])
    assert FaceDetector(OneFace(anchor, logit)).look_again(np.zeros((400, 400, 3), np.uint8), [box]) == [None]
