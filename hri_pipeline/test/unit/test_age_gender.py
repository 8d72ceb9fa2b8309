"""Age and gender: networks of both signatures are known by it, wrong ones told; the looks at one face are fused."""

from types import SimpleNamespace

import cv2
import numpy as np
import onnx
import pytest

from hri_pipeline.core.faces.age_gender import (
    AgeGender,
    AgeGenderFusion,
    FaceApiAgeGender,
    RetailAgeGender,
    load_age_gender,
)
from hri_pipeline.core.faces.analysis import AGE_FIRST_PERIOD, AgeGenderProcessor
from hri_pipeline.core.observations import FaceObservation
from hri_pipeline.core.onnx import ModelError

HELPER, FLOAT = onnx.helper, onnx.TensorProto.FLOAT


def write(path, image, outputs):
    """An ONNX file with an input (name, shape) whose outputs {name: numbers} are constants plus 0 x the first pixel."""
    name, shape = image
    nodes, constants = [], [onnx.numpy_helper.from_array(np.zeros(1, np.float32), "zero")]
    nodes.append(HELPER.make_node("ReduceMean", [name], ["mean"], keepdims=0))
    nodes.append(HELPER.make_node("Mul", ["mean", "zero"], ["nothing"]))
    for output, (values, size) in outputs.items():
        constants.append(onnx.numpy_helper.from_array(np.array(values, np.float32).reshape(size), output + "_value"))
        nodes.append(HELPER.make_node("Add", [output + "_value", "nothing"], [output]))
    graph = HELPER.make_graph(
        nodes, "fixed", [HELPER.make_tensor_value_info(name, FLOAT, shape)],
        [HELPER.make_tensor_value_info(output, FLOAT, None) for output in outputs], constants)
    model = HELPER.make_model(graph, opset_imports=[HELPER.make_opsetid("", 13)])
    model.ir_version = 8
    onnx.save(model, str(path))
    return path


def retail(path, age="age_conv3", values=(0.314,), prob=(0.8, 0.2), shape=("N", 3, 62, 62)):
    return write(path, ("data", list(shape)),
                 {age: (values, (1, len(values), 1, 1)), "prob": (prob, (1, len(prob), 1, 1))})


def face_api(path, age=(31.4,), gender=(0.2, 0.8)):
    return write(path, ("image", ["N", 112, 112, 3]),
                 {"age": (age, (1, len(age))), "gender": (gender, (1, len(gender)))})


def picture_and_mesh():
    random = np.random.RandomState(1)
    return random.randint(0, 255, (240, 320, 3), np.uint8), random.uniform(60, 180, (478, 3))


@pytest.mark.parametrize("age", ["age_conv3", "fc3_a"])
def test_a_file_with_the_signature_of_retail_0013(tmp_path, age):
    model = load_age_gender(retail(tmp_path / "retail.onnx", age))
    assert isinstance(model, RetailAgeGender)
    image, mesh = picture_and_mesh()
    crop = model.crop(image, mesh)
    assert crop.shape == (62, 62, 3) and crop.dtype == np.uint8
    first, second = model.estimate([crop, crop])
    assert first.age == pytest.approx(31.4, abs=1e-3) and first.p_female == pytest.approx(0.8)
    assert first == second and first.age_sd > 0.0


def test_retail_0013_is_fed_planes_of_blue_green_red(tmp_path):
    """A network that says how blue its input is: 0.01 x mean of the first plane."""
    name = tmp_path / "blue.onnx"
    nodes = [
        HELPER.make_node("Gather", ["data", "first"], ["plane"], axis=1),
        HELPER.make_node("ReduceMean", ["plane"], ["age"], axes=[1, 2], keepdims=0),
        HELPER.make_node("Mul", ["age", "scale"], ["age_conv3"]),
        HELPER.make_node("Identity", ["both"], ["prob"]),
    ]
    constants = [onnx.numpy_helper.from_array(np.array(value), key) for key, value in (
        ("first", np.int64(0)), ("scale", np.float32(0.01)), ("both", np.array([[0.5, 0.5]], np.float32)))]
    graph = HELPER.make_graph(nodes, "blue", [HELPER.make_tensor_value_info("data", FLOAT, ["N", 3, 62, 62])],
                              [HELPER.make_tensor_value_info(key, FLOAT, None) for key in ("age_conv3", "prob")],
                              constants)
    model = HELPER.make_model(graph, opset_imports=[HELPER.make_opsetid("", 13)])
    model.ir_version = 8
    onnx.save(model, str(name))
    image = np.zeros((62, 62, 3), np.uint8)
    image[..., 0], image[..., 2] = 40, 200
    assert load_age_gender(name).estimate([image])[0].age == pytest.approx(40.0)


def test_a_file_with_the_signature_of_face_api(tmp_path):
    model = load_age_gender(face_api(tmp_path / "age_gender.onnx"))
    assert isinstance(model, FaceApiAgeGender)
    answer = model.estimate([np.zeros((112, 112, 3), np.uint8)])[0]
    assert answer.age == pytest.approx(31.4) and answer.p_female == pytest.approx(0.8)


@pytest.mark.parametrize("make, kind, told", [
    (lambda path: write(path, ("image", ["N", 8, 8, 3]), {"embedding": ((1.0,), (1, 1))}), "auto", "embedding"),
    (lambda path: write(path, ("data", ["N", 3, 62, 62]), {"prob": ((0.5, 0.5), (1, 2))}), "auto", "age_conv3"),
    (lambda path: retail(path, values=(0.1, 0.2)), "auto", "2 numbers in age_conv3"),
    (lambda path: retail(path, prob=(0.1, 0.2, 0.7)), "auto", "3 numbers in prob"),
    (lambda path: retail(path, shape=("N", 3, 48, 48)), "auto", "refused"),
    (lambda path: face_api(path, gender=(1.0,)), "auto", "1 numbers in gender"),
    (face_api, "retail_0013", "age-gender-recognition-retail-0013"),
    (retail, "face_api", "age"),
    (face_api, "magic", "magic"),
])
def test_another_network_is_told_by_name(tmp_path, make, kind, told):
    path = make(tmp_path / "other.onnx")
    with pytest.raises(ModelError, match=told) as error:
        load_age_gender(path, kind)
    assert kind == "magic" or "other.onnx" in str(error.value)


def test_a_missing_file_is_told(tmp_path):
    with pytest.raises(ModelError, match="absent.onnx"):
        load_age_gender(tmp_path / "absent.onnx")


@pytest.mark.parametrize("age", [float("nan"), -3.0, 4000.0])
def test_an_age_that_cannot_be_is_left_out(tmp_path, age):
    answer = load_age_gender(face_api(tmp_path / "a.onnx", (age,))).estimate([np.zeros((112, 112, 3), np.uint8)])[0]
    fusion = AgeGenderFusion()
    fusion.add(answer, 1.0, 0.0)
    assert fusion.estimate() is None


def fused(looks, qualities=None):
    fusion = AgeGenderFusion()
    for index, look in enumerate(looks):
        fusion.add(look, 1.0 if qualities is None else qualities[index], float(index))
    return fusion.estimate()


def test_nothing_is_told_until_enough_was_seen():
    assert AgeGenderFusion().estimate() is None
    assert fused([AgeGender(30.0, 8.0, 0.9)], [0.3]) is None
    assert fused([AgeGender(30.0, 8.0, 0.9)], [0.95]).age == pytest.approx(30.0)
    assert fused([AgeGender(30.0, 8.0, 0.9)] * 9, [0.3] * 9).samples == 9


def test_one_wild_look_hardly_counts():
    ages = [30.0, 32.0, 31.0, 90.0, 29.0, 30.5]
    result = fused([AgeGender(age, 8.0, 0.9) for age in ages])
    assert abs(result.age - 30.5) < 4.0


def test_good_looks_weigh_more():
    result = fused([AgeGender(20.0, 8.0, 0.9)] + [AgeGender(40.0, 8.0, 0.9)], [1.0, 0.3])
    assert result.age < 23.0


def test_looks_make_surer_but_never_surer_than_the_network_is():
    few, many = (fused([AgeGender(30.0, 8.0, 0.9)] * count) for count in (1, 25))
    assert few.age_sd > many.age_sd >= 5.0
    assert few.age_confidence < many.age_confidence < 0.97
    assert many.p_female == pytest.approx(0.9, abs=0.01), "looks at one face err together"


def test_ages_are_told_as_surely_as_they_are_right(tmp_path):
    """48 of 50 people on photographs, and 7 of 7 with small faces, looked within 10 years of what was told."""
    path = tmp_path / "age_gender.onnx"
    face_api(path)
    crop = np.full((FaceApiAgeGender.SIZE, FaceApiAgeGender.SIZE, 3), 128, np.uint8)
    answer = load_age_gender(path).estimate([crop])[0]
    one, many, poor = (fused([answer] * count, [quality] * count) for count, quality in ((1, 1.0), (9, 1.0), (4, 0.4)))
    assert 0.86 < one.age_confidence < many.age_confidence < 0.96
    assert 0.8 < poor.age_confidence < one.age_confidence, "small and turned faces"


class AgeOfDetails(FaceApiAgeGender):
    """A network that takes fine details for wrinkles."""

    def _run(self, batch):
        grain = np.abs(batch[:, 1:, :, 1] - batch[:, :-1, :, 1]).mean()
        return {"age": np.array([30.0 + grain]), "gender": np.array([0.1, 0.9])}


def test_an_age_that_hangs_on_fine_details_is_less_sure(tmp_path):
    """Noise, smoothed or not, and the blocks of JPEG made people 10 and more years older, as surely as ever."""
    path = tmp_path / "age_gender.onnx"
    face_api(path)
    network, random = AgeOfDetails(path), np.random.RandomState(3)
    face = cv2.GaussianBlur(random.randint(0, 255, (112, 112, 3), np.uint8), (0, 0), 8.0)
    grainy = np.clip(face + random.normal(0.0, 20.0, face.shape), 0, 255).astype(np.uint8)
    clear, doubtful = (fused(network.estimate([crop] * 4)) for crop in (face, grainy))
    assert clear.age_confidence > 0.9 > 0.8 > doubtful.age_confidence
    alone = float(network._run(grainy[None].astype(np.float32))["age"][0])
    assert clear.age < doubtful.age < alone - 2.0, "without the details nearer to the truth"


def test_pictures_that_tell_little_of_an_age_count_little_once_there_are_good_ones():
    poor, good = AgeGender(60.0, 4.0, 0.9, picture_sd=12.0), AgeGender(30.0, 4.0, 0.9)
    noisy, later = fused([poor] * 4), fused([poor] * 4 + [good] * 4)
    assert noisy.age_confidence < 0.6, "more of them make it no surer"
    assert later.age < 40.0 and later.age_confidence > noisy.age_confidence + 0.1
    assert fused([good] * 4).age_confidence == fused([AgeGender(30.0, 4.0, 0.9, 0.0)] * 4).age_confidence


def test_a_gender_is_told_only_when_it_is_sure():
    torn = fused([AgeGender(30.0, 8.0, 0.9), AgeGender(30.0, 8.0, 0.1)])
    assert not torn.gender_known and torn.p_female == pytest.approx(0.5, abs=0.01)
    clear = fused([AgeGender(30.0, 8.0, 0.02)] * 3)
    assert clear.gender_known and clear.p_female < 0.1


def test_memory_is_bounded_and_follows_a_change():
    fusion = AgeGenderFusion()
    for index in range(5000):
        fusion.add(AgeGender(30.0, 8.0, 0.9), 0.5 + 0.4 * np.sin(index), 0.1 * index)
    assert fusion.estimate().samples <= 30


def test_time_that_goes_back_and_bad_looks():
    fusion = AgeGenderFusion()
    fusion.add(AgeGender(30.0, 8.0, 0.9), 1.0, 100.0)
    fusion.add(AgeGender(60.0, 8.0, 0.1), 1.0, 3.0)
    assert fusion.estimate().age == pytest.approx(60.0)
    for look, quality in ((AgeGender(float("nan"), 8.0, 0.5), 1.0), (AgeGender(30.0, 0.0, 0.5), 1.0),
                          (AgeGender(30.0, 8.0, 0.5), 0.0), (AgeGender(30.0, 8.0, 0.5), float("nan"))):
        fusion.add(look, quality, 4.0)
    assert fusion.estimate().samples == 1


def test_faces_full_of_noise_have_no_age_until_the_light_is_back(tmp_path):
    """Noise of a dark room looks like wrinkles to the network: 27 years were 50, with a confidence of .91."""
    path = tmp_path / "age_gender.onnx"
    face_api(path)
    image, mesh = picture_and_mesh()
    smooth = cv2.normalize(cv2.GaussianBlur(image, (0, 0), 4.0), None, 0, 255, cv2.NORM_MINMAX)
    face = FaceObservation("a", np.array([60.0, 60.0, 180.0, 180.0]), 1.0, mesh[:70], mesh)
    processor = AgeGenderProcessor(SimpleNamespace(age_gender_model=str(path), providers=("cpu",)))
    for index in range(20):
        processor.infer(image, [face], {"a": 0.95}, float(index), {"a"})
        assert processor.estimate("a") is None, "noise"
    light = 19.0 + 1.01 * AGE_FIRST_PERIOD
    assert processor.overdue([face], {"a": 0.95}, light, {"a"}) >= 1.0, "what was not looked at is soon due again"
    processor.infer(smooth, [face], {"a": 0.95}, light, {"a"})
    known = processor.estimate("a")
    assert known is not None and known.age == pytest.approx(31.4, abs=0.01)
    processor.infer(image, [face], {"a": 0.95}, light + 1.0, {"a"})
    assert processor.estimate("a") == known
