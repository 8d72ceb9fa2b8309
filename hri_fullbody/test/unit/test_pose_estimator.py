from types import SimpleNamespace

import numpy as np
import pytest

from hri_fullbody.core.detection import pose_estimator
from hri_fullbody.core.detection.pose_estimator import BlazePose, covers, decode
from hri_fullbody.core.detection.windows import Window
from hri_pipeline.core.geometry import crop_rotated
from hri_pipeline.core.process import ONE_THREAD, Threads


def raw_landmarks(points, visibility=4.0, presence=4.0):
    raw = np.zeros((39, 5))
    raw[:, :3] = points
    raw[:, 3], raw[:, 4] = visibility, presence
    return raw.reshape(-1)


@pytest.mark.parametrize("angle", [0.0, 0.4, -2.0])
def test_middle_of_the_input_is_the_middle_of_the_window(angle):
    _, affine = crop_rotated(np.zeros((100, 200, 3), np.uint8), (120.0, 30.0), 64.0, angle, 256)
    estimate = decode(raw_landmarks((128.0, 128.0, 16.0)), 0.9, np.zeros(117), affine, angle)
    assert estimate.landmarks[5] == pytest.approx([120.0, 30.0, 4.0])
    assert estimate.score == 0.9


def test_confidence_is_the_less_sure_of_visible_and_present():
    affine = np.eye(2, 3)
    sure = decode(raw_landmarks((0, 0, 0), 30.0, 0.0), 1.0, np.zeros(117), affine, 0.0).confidence
    assert sure == pytest.approx(np.full(39, 0.5))
    hidden = decode(raw_landmarks((0, 0, 0), -900.0, 9.0), 1.0, np.zeros(117), affine, 0.0).confidence
    assert np.all(hidden < 1e-6)


def test_world_landmarks_turn_back_with_the_window():
    world = np.tile([0.0, -1.0, 0.5], (39, 1)).reshape(-1)
    estimate = decode(raw_landmarks((0, 0, 0)), 1.0, world, np.eye(2, 3), np.pi / 2)
    # Up in a window turned a quarter clockwise is right in the image.
    assert estimate.world[0] == pytest.approx([1.0, 0.0, 0.5])
    assert estimate.world.shape == (33, 3)


def test_what_the_network_says_of_a_mirrored_input_is_turned_back():
    points = np.zeros((39, 3))
    points[15], points[16] = (55.0, 70.0, 8.0), (155.0, 60.0, -8.0)     # wrists: left, right
    points[33] = (100.0, 90.0, 0.0)
    world = np.zeros((39, 3))
    world[15], world[16] = (0.3, 0.1, 0.2), (-0.4, 0.2, 0.1)
    estimate = decode(raw_landmarks(points), 0.9, world.reshape(-1), np.eye(2, 3), 0.0, mirrored=True)
    assert estimate.landmarks[15] == pytest.approx([100.0, 60.0, -8.0])
    assert estimate.landmarks[16] == pytest.approx([200.0, 70.0, 8.0])
    assert estimate.landmarks[33] == pytest.approx([155.0, 90.0, 0.0])
    assert estimate.world[15] == pytest.approx([0.4, 0.2, 0.1])
    assert estimate.world[16] == pytest.approx([-0.3, 0.1, 0.2])


@pytest.mark.parametrize("seen, nose, extent, covered", [
    ((110, 120, 190, 260), (150, 140), 500.0, True),      # at a table: little of the body is sure, the head is in place
    ((110, 120, 190, 260), (150, 140), 200.0, False),     # a small figure in the picture of somebody
    ((110, 250, 190, 390), (150, 270), 500.0, False),     # who stands before that person, and is shorter
    ((110, 120, 330, 260), (150, 140), 500.0, False)])    # beside it for the most part
def test_the_box_of_a_body_is_known_by_its_head(seen, nose, extent, covered):
    estimate = SimpleNamespace(box=np.array(seen, float), nose=np.array(nose, float), extent=extent)
    assert covers(estimate, np.array([100.0, 110.0, 210.0, 410.0])) == covered


@pytest.mark.parametrize("first, together", [("N", True), (1, False)])
def test_a_network_of_one_s_own_that_takes_one_window_gets_one_whatever_the_threads(tmp_path, first, together):
    onnx = pytest.importorskip("onnx")
    tensor, kind = onnx.helper.make_tensor_value_info, onnx.TensorProto.FLOAT
    outputs = {"Identity": 195, "Identity_1": 1, "Identity_4": 117}
    nodes = [onnx.helper.make_node("Constant", [], [name], value=onnx.numpy_helper.from_array(
        np.ones((1, size), np.float32))) for name, size in outputs.items()]
    graph = onnx.helper.make_graph(nodes, "pose", [tensor("input_1", kind, [first, 256, 256, 3])],
                                   [tensor(name, kind, [1, size]) for name, size in outputs.items()])
    model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 13)])
    model.ir_version = 8
    onnx.save(model, str(tmp_path / "pose.onnx"))
    threads = Threads(3)
    pose = BlazePose(tmp_path / "pose.onnx", threads=threads)
    assert (pose.takes_batches, pose.threads.count) == (together, 3 if together else 1)
    pose._model.threads, pose._model.provider = ONE_THREAD, "cuda"
    assert (pose.takes_batches, pose.threads.count) == (together, 1)
    pose._model.threads, pose._model.provider = threads, "cpu"       # the card has failed
    assert (pose.takes_batches, pose.threads.count) == (together, 3 if together else 1)
    threads.close()


class _Watched:
    """A pose network that keeps what it is shown."""

    def __init__(self, *_, **__):
        self.input_shapes, self.threads, self.on_card = {"input_1": [1, 256, 256, 3]}, ONE_THREAD, False

    def run_items(self, items, prepare, shape):
        self.shown = np.empty((len(items), *shape), np.float32)
        affines = [prepare(one, place) for one, place in zip(items, self.shown)]
        return affines, {name: np.ones((1, size)) for name, size in (
            ("Identity", 195), ("Identity_1", 1), ("Identity_4", 117))}


@pytest.mark.parametrize("own, kept", [((110.0, 90.0, 150.0, 130.0), True), ((200.0, 200.0, 240.0, 240.0), True),
                                       ((300.0, 300.0, 340.0, 340.0), False), (None, False)])
def test_heads_of_neighbours_are_grey_but_not_where_the_own_face_is(monkeypatch, own, kept):
    monkeypatch.setattr(pose_estimator, "OnnxModel", _Watched)
    pose = BlazePose("pose.onnx")
    heads = [np.array([100.0, 100.0, 140.0, 140.0]), np.array([-40.0, 10.0, 20.0, 50.0]),
             np.array([400.0, 0.0, 450.0, 50.0])]
    pose.estimate(np.full((256, 256, 3), (10, 20, 255), np.uint8), Window((128.0, 128.0), 256.0), heads,
                  None if own is None else np.array(own))
    rows, columns = np.mgrid[0:256, 0:256]
    wanted = np.zeros((256, 256), bool)
    for x0, y0, x1, y1 in heads:
        wanted |= (columns >= x0) & (columns <= x1) & (rows >= y0) & (rows <= y1)
    if kept:
        wanted &= ~((columns >= own[0]) & (columns <= own[2]) & (rows >= own[1]) & (rows <= own[3]))
    grey = (np.abs(pose._model.shown[0] - 128.0 / 255.0) < 1e-6).all(axis=2)
    assert np.array_equal(grey, wanted) and wanted.any()
    assert pose._model.shown[0][~wanted] == pytest.approx(np.broadcast_to(
        np.array([255.0, 20.0, 10.0]) / 255.0, (int((~wanted).sum()), 3)), abs=1e-6)
