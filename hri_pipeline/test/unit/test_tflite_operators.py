"""TFLite operators: small graphs, converted, run and compared with numpy."""

from __future__ import annotations

from typing import Any, Dict, List, Sequence

import numpy as np
import onnxruntime
import pytest

from hri_pipeline.models.catalogue import ConversionError
from hri_pipeline.models.tflite_graph import (
    Operator,
    SparseDimension,
    Tensor,
    TfliteGraph,
    densify,
    fold_prelus,
    read_tflite,
)
from hri_pipeline.models.tflite_to_onnx import convert_graph, same_padding

PLAIN = {"FusedActivationFunction": 0}


def run(model: Any, feed: Dict[str, np.ndarray]) -> List[np.ndarray]:
    session = onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
    return session.run(None, {name: value.astype(np.float32) for name, value in feed.items()})


def single(kind: str, inputs: Sequence[Any], result_shape: Sequence[int], options: Any = None) -> TfliteGraph:
    """A graph of one operator; a list in `inputs` is the shape of a computed tensor, an array a constant."""
    tensors = [
        Tensor("in%d" % i, list(v)) if isinstance(v, list) else Tensor("constant", list(v.shape), v)
        for i, v in enumerate(inputs)
    ]
    computed = [i for i, tensor in enumerate(tensors) if tensor.data is None]
    tensors.append(Tensor("out", list(result_shape)))
    last = len(tensors) - 1
    return TfliteGraph(
        tensors, [Operator(kind, list(range(last)), [last], options or PLAIN)], computed, [last]
    )


def random(*shape: int) -> np.ndarray:
    return np.random.default_rng(sum(shape)).normal(size=shape).astype(np.float32)


def convolve(image: np.ndarray, weights: np.ndarray, stride: int, depthwise: bool) -> np.ndarray:
    """TensorFlow's "same" convolution in loops; weights H x W x in x out (depthwise: H x W x channels)."""
    size, kernel = image.shape[1:3], weights.shape[:2]
    top, left, bottom, right = same_padding(size, kernel, (stride, stride), (1, 1))
    padded = np.pad(image, ((0, 0), (top, bottom), (left, right), (0, 0)))
    rows, columns = -(-size[0] // stride), -(-size[1] // stride)
    result = np.zeros((len(image), rows, columns, weights.shape[-1]))
    for y in range(rows):
        for x in range(columns):
            patch = padded[:, y * stride : y * stride + kernel[0], x * stride : x * stride + kernel[1]]
            result[:, y, x] = (
                np.einsum("nhwc,hwc->nc", patch, weights)
                if depthwise
                else np.einsum("nhwi,hwio->no", patch, weights)
            )
    return result


@pytest.mark.parametrize("stride", [1, 2])
@pytest.mark.parametrize("activation", [0, 1, 3])
def test_convolution(stride: int, activation: int) -> None:
    weights, bias, image = random(4, 3, 3, 2), random(4), random(2, 5, 8, 2)
    options = {
        "Padding": 0,
        "StrideH": stride,
        "StrideW": stride,
        "DilationHFactor": 1,
        "DilationWFactor": 1,
        "FusedActivationFunction": activation,
    }
    expected = convolve(image, weights.transpose(1, 2, 3, 0), stride, False) + bias
    expected = {0: expected, 1: np.maximum(expected, 0), 3: np.clip(expected, 0, 6)}[activation]
    graph = single("CONV_2D", [[1, 5, 8, 2], weights, bias], [1] + list(expected.shape[1:]), options)
    np.testing.assert_allclose(run(convert_graph(graph, "m"), {"in0": image})[0], expected, atol=1e-5)


def test_depthwise_convolution() -> None:
    weights, bias, image = random(1, 3, 3, 4), random(4), random(2, 6, 7, 4)
    options = {
        "Padding": 0,
        "StrideH": 2,
        "StrideW": 2,
        "DilationHFactor": 1,
        "DilationWFactor": 1,
        "FusedActivationFunction": 0,
    }
    expected = convolve(image, weights[0], 2, True) + bias
    graph = single(
        "DEPTHWISE_CONV_2D", [[1, 6, 7, 4], weights, bias], [1] + list(expected.shape[1:]), options
    )
    np.testing.assert_allclose(run(convert_graph(graph, "m"), {"in0": image})[0], expected, atol=1e-5)


def test_prelu_is_written_as_two_depthwise_convolutions() -> None:
    """Into the first the rectifier is fused, into the second the sum: two passes over the image, whatever the slope."""
    slope, image = np.float32([[[-0.5, 0.25, 1.75]]]), random(2, 4, 5, 3)
    model = convert_graph(single("PRELU", [[1, 4, 5, 3], slope], [1, 4, 5, 3]), "m")
    kinds = [node.op_type for node in model.graph.node if node.op_type not in ("Transpose", "Identity")]
    assert kinds == ["Conv", "Relu", "Conv", "Add"]
    np.testing.assert_allclose(
        run(model, {"in0": image})[0], np.where(image > 0, image, image * slope), atol=1e-6
    )


@pytest.mark.parametrize("is_leaky", [True, False])
def test_a_leaky_activation_of_five_operators_becomes_one(is_leaky: bool) -> None:
    """relu(x) + a (x - |x|); of the other graph, a (y - |x|), nothing is folded, and it is converted all the same."""
    shape, slope = [1, 4, 5, 3], random(3)
    tensors = [Tensor("in0", shape), Tensor("in1", shape), Tensor("a", [3], slope)]
    tensors += [Tensor(name, shape) for name in ("relu", "abs", "sub", "mul", "out")]
    operators = [Operator("RELU", [0], [3]), Operator("ABS", [0], [4]),
                 Operator("SUB", [0 if is_leaky else 1, 4], [5], PLAIN), Operator("MUL", [2, 5], [6], PLAIN),
                 Operator("ADD", [3, 6], [7], PLAIN)]
    graph = TfliteGraph(tensors, fold_prelus(tensors, operators), [0, 1], [7])
    assert ("PRELU" in [operator.kind for operator in graph.operators]) == is_leaky
    model, first, other = convert_graph(graph, "m"), random(2, 4, 5, 3), random(2, 4, 5, 3)
    assert any(node.op_type == "Abs" for node in model.graph.node) != is_leaky, "what is not needed is not converted"
    expected = np.maximum(first, 0) + slope * ((first if is_leaky else other) - np.abs(first))
    feed = {"in0": first, "in1": other}
    np.testing.assert_allclose(run(model, feed)[0], expected, atol=1e-6)


@pytest.mark.parametrize(
    "kind, numpy_function",
    [
        ("RELU", lambda x: np.maximum(x, 0)),
        ("ABS", np.abs),
        ("LOGISTIC", lambda x: 1 / (1 + np.exp(-x))),
        ("HARD_SWISH", lambda x: x * np.clip(x + 3, 0, 6) / 6),
    ],
)
def test_unary(kind: str, numpy_function: Any) -> None:
    image = random(2, 3, 4, 5)
    result = run(convert_graph(single(kind, [[1, 3, 4, 5]], [1, 3, 4, 5]), "m"), {"in0": image})[0]
    np.testing.assert_allclose(result, numpy_function(image), atol=1e-6)


def test_add_of_a_constant_and_mul() -> None:
    image, other = random(2, 3, 4, 5), random(5)
    added = run(convert_graph(single("ADD", [[1, 3, 4, 5], other], [1, 3, 4, 5]), "m"), {"in0": image})[0]
    np.testing.assert_allclose(added, image + other, atol=1e-6)
    graph = single("MUL", [[1, 3, 4, 5], [1, 3, 4, 5]], [1, 3, 4, 5])
    np.testing.assert_allclose(
        run(convert_graph(graph, "m"), {"in0": image, "in1": image})[0], image**2, atol=1e-6
    )


def test_shapes() -> None:
    image = random(2, 4, 6, 8)
    cases = [
        (single("RESHAPE", [[1, 4, 6, 8]], [1, 48, 4]), image.reshape(2, 48, 4)),
        (
            single("PAD", [[1, 4, 6, 8], np.array([[0, 0], [1, 2], [0, 1], [0, 3]])], [1, 7, 7, 11]),
            np.pad(image, ((0, 0), (1, 2), (0, 1), (0, 3))),
        ),
        (
            single("DEPTH_TO_SPACE", [[1, 4, 6, 8]], [1, 8, 12, 2], {"BlockSize": 2}),
            image.reshape(2, 4, 6, 2, 2, 2).transpose(0, 1, 3, 2, 4, 5).reshape(2, 8, 12, 2),
        ),
        (
            single("MEAN", [[1, 4, 6, 8], np.array([1, 2])], [1, 1, 1, 8], {"KeepDims": True}),
            image.mean((1, 2), keepdims=True),
        ),
        (
            single(
                "STRIDED_SLICE",
                [[1, 4, 6, 8], np.array([0, 1, 0, 2]), np.array([1, 4, 6, 8]), np.array([1, 2, 1, 3])],
                [1, 2, 6, 2],
                {"BeginMask": 0, "EndMask": 0, "EllipsisMask": 0, "NewAxisMask": 0, "ShrinkAxisMask": 0},
            ),
            image[:, 1:4:2, :, 2:8:3],
        ),
        (
            single(
                "MAX_POOL_2D",
                [[1, 4, 6, 8]],
                [1, 2, 3, 8],
                {
                    "Padding": 0,
                    "StrideH": 2,
                    "StrideW": 2,
                    "FilterHeight": 2,
                    "FilterWidth": 2,
                    "FusedActivationFunction": 0,
                },
            ),
            image.reshape(2, 2, 2, 3, 2, 8).max((2, 4)),
        ),
    ]
    for graph, expected in cases:
        result = run(convert_graph(graph, "m"), {"in0": image})[0]
        np.testing.assert_allclose(result, expected, atol=1e-6, err_msg=graph.operators[0].kind)


def test_concatenate_along_channels_and_fully_connected() -> None:
    first, second, weights, bias = random(2, 3, 3, 2), random(2, 3, 3, 4), random(5, 54), random(5)
    options = {"Axis": -1, "FusedActivationFunction": 0}
    graph = single("CONCATENATION", [[1, 3, 3, 2], [1, 3, 3, 4]], [1, 3, 3, 6], options)
    graph.tensors += [Tensor("w", [5, 54], weights), Tensor("b", [5], bias), Tensor("dense", [1, 5])]
    graph.operators.append(Operator("FULLY_CONNECTED", [2, 3, 4], [5], PLAIN))
    graph.outputs = [5]
    both = np.concatenate([first, second], axis=3)
    result = run(convert_graph(graph, "m"), {"in0": first, "in1": second})[0]
    np.testing.assert_allclose(result, both.reshape(2, -1) @ weights.T + bias, atol=1e-5)


@pytest.mark.parametrize("shape", [(3, 5, 2), (3, 4, 5, 2)])
@pytest.mark.parametrize("kind,expected", [
    ("SUB", lambda a, b: a - b), ("DIV", lambda a, b: a / b), ("SQUARED_DIFFERENCE", lambda a, b: (a - b) ** 2)])
def test_differences_and_quotients(kind: str, expected: Any, shape: Sequence[int]) -> None:
    first, second = random(*shape), random(*shape, 1)[..., 0] + 3.0
    one = [1] + list(shape[1:])
    result = run(convert_graph(single(kind, [one, one], one), "m"), {"in0": first, "in1": second})[0]
    np.testing.assert_allclose(result, expected(first, second), rtol=1e-5)


@pytest.mark.parametrize("kind,numpy_function", [
    ("NEG", np.negative), ("SQRT", np.sqrt), ("RSQRT", lambda x: 1.0 / np.sqrt(x))])
def test_roots_and_signs(kind: str, numpy_function: Any) -> None:
    values = np.abs(random(2, 3, 4, 5)) + 0.1
    result = run(convert_graph(single(kind, [[1, 3, 4, 5]], [1, 3, 4, 5]), "m"), {"in0": values})[0]
    np.testing.assert_allclose(result, numpy_function(values), rtol=1e-5)


@pytest.mark.parametrize("kind,reduce", [("MEAN", np.mean), ("SUM", np.sum)])
@pytest.mark.parametrize("shape,axis,keep", [((2, 7, 3), -2, True), ((2, 4, 6, 8), 3, True), ((2, 4, 6, 8), -1, False),
                                             ((2, 4, 6, 8), 2, True)])
def test_sums_and_means_over_any_axis(kind: str, reduce: Any, shape: Sequence[int], axis: int, keep: bool) -> None:
    values = random(*shape)
    expected = reduce(values, axis=axis, keepdims=keep)
    graph = single(kind, [[1] + list(shape[1:]), np.array([axis])], [1] + list(expected.shape[1:]), {"KeepDims": keep})
    np.testing.assert_allclose(run(convert_graph(graph, "m"), {"in0": values})[0], expected, atol=1e-5)


def test_a_sum_over_the_batch_is_refused() -> None:
    with pytest.raises(ConversionError, match="SUM"):
        convert_graph(single("SUM", [[1, 7, 3], np.array([0])], [1, 7, 3], {"KeepDims": True}), "m")


@pytest.mark.parametrize("axes", [(0, 1, 3, 2), (0, 3, 1, 2), (0, 2, 3, 1)])
def test_transpose(axes: Sequence[int]) -> None:
    values = random(2, 3, 4, 5)
    expected = values.transpose(axes)
    graph = single("TRANSPOSE", [[1, 3, 4, 5], np.array(axes)], [1] + list(expected.shape[1:]))
    np.testing.assert_array_equal(run(convert_graph(graph, "m"), {"in0": values})[0], expected)


def test_a_constant_is_joined_to_every_row_of_the_batch() -> None:
    constant, values = random(1, 1, 1, 4), random(3, 1, 5, 4)
    options = {"Axis": 2, "FusedActivationFunction": 0}
    graph = single("CONCATENATION", [constant, [1, 1, 5, 4]], [1, 1, 6, 4], options)
    result = run(convert_graph(graph, "m"), {"in1": values})[0]
    np.testing.assert_array_equal(result, np.concatenate([constant.repeat(3, axis=0), values], axis=2))


def test_a_slice_that_drops_the_batch_keeps_it() -> None:
    values = random(3, 6)
    masks = {"BeginMask": 2, "EndMask": 2, "EllipsisMask": 0, "NewAxisMask": 0, "ShrinkAxisMask": 1}
    graph = single("STRIDED_SLICE", [[1, 6], np.zeros(2), np.array([1, 6]), np.ones(2)], [6], masks)
    np.testing.assert_array_equal(run(convert_graph(graph, "m"), {"in0": values})[0], values)
    with pytest.raises(ConversionError, match="STRIDED_SLICE"):
        convert_graph(single("STRIDED_SLICE", [[1, 6], np.zeros(2), np.array([1, 1]), np.ones(2)], [1],
                             dict(masks, ShrinkAxisMask=2)), "m")


@pytest.mark.parametrize("activation", [0, 1])
def test_a_pointwise_graph_has_products_of_matrices(activation: int) -> None:
    weights, bias, image = random(4, 1, 1, 3), random(4), random(2, 5, 6, 3)
    options = {"Padding": 0, "StrideH": 1, "StrideW": 1, "DilationHFactor": 1, "DilationWFactor": 1,
               "FusedActivationFunction": activation}
    model = convert_graph(single("CONV_2D", [[1, 5, 6, 3], weights, bias], [1, 5, 6, 4], options), "m")
    assert "Conv" not in {node.op_type for node in model.graph.node}
    expected = image @ weights[:, 0, 0].T + bias
    result = run(model, {"in0": image})[0]
    np.testing.assert_allclose(result, np.maximum(expected, 0.0) if activation else expected, atol=1e-5)


def test_only_wanted_outputs_are_converted() -> None:
    graph = single("RELU", [[1, 2, 2, 1]], [1, 2, 2, 1])
    graph.tensors.append(Tensor("strange", [1, 2, 2, 1]))
    graph.operators.append(Operator("NOT_KNOWN", [0], [2]))
    graph.outputs = [1, 2]
    model = convert_graph(graph, "m", ["out"])
    assert [value.name for value in model.graph.output] == ["out"]
    assert model.ir_version == 8 and model.opset_import[0].version == 17
    assert model.graph.input[0].type.tensor_type.shape.dim[0].dim_param == "N"


def test_unknown_operator_names_operator_and_model() -> None:
    with pytest.raises(ConversionError, match="model face_x: operator NOT_KNOWN"):
        convert_graph(single("NOT_KNOWN", [[1, 2, 2, 1]], [1, 2, 2, 1]), "face_x")
    with pytest.raises(ConversionError, match="model face_x: it has no output other"):
        convert_graph(single("RELU", [[1, 2, 2, 1]], [1, 2, 2, 1]), "face_x", ["other"])
    with pytest.raises(ConversionError, match="model face_x: the source is not a TFLite file"):
        read_tflite(b"no such thing", "face_x")


def crop_matrix(points: np.ndarray, options: Dict[str, Any]) -> np.ndarray:
    """Crop pixels -> source pixels, written with angles, independently of the converter."""
    left, right = points[options["left_rotation_idx"], :2], points[options["right_rotation_idx"], :2]
    angle = np.arctan2(right[1] - left[1], right[0] - left[0])
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    levelled = points[options["subset_idxs"], :2] @ turn
    low, high = levelled.min(0), levelled.max(0)
    output = np.array([options["output_width"], options["output_height"]])
    size = (high - low) * [options["scale_x"], options["scale_y"]]
    matrix = np.eye(4)
    matrix[:2, :2] = turn @ np.diag(size / output)
    matrix[:2, 3] = turn @ ((low + high) / 2) - matrix[:2, :2] @ (output / 2)
    return matrix


def test_landmarks_to_transform_matrix() -> None:
    options = {
        "left_rotation_idx": 1,
        "right_rotation_idx": 4,
        "target_rotation_radians": 0,
        "output_width": 16,
        "output_height": 12,
        "scale_x": 1.5,
        "scale_y": 1.25,
        "subset_idxs": [0, 2, 3, 5],
    }
    points = random(3, 6, 3) * 20 + 24
    graph = single("Landmarks2TransformMatrix", [[1, 6, 3]], [1, 4, 4], options)
    result = run(convert_graph(graph, "m"), {"in0": points})[0]
    np.testing.assert_allclose(result, [crop_matrix(p, options) for p in points], atol=1e-4)


def test_transform_tensor_bilinear_is_zero_outside() -> None:
    source = random(2, 9, 11, 3)
    matrix = np.tile(np.eye(4), (2, 1, 1))
    matrix[0, :2, :] = [[1.5, 0.4, 0, 1.2], [-0.3, 1.1, 0, 2.1]]
    matrix[1, :2, :] = [[3.0, 0.0, 0, -4.0], [0.0, 3.0, 0, -3.0]]  # reaches far outside
    graph = single("TransformTensorBilinear", [[1, 9, 11, 3], [1, 4, 4]], [1, 5, 6, 3], {})
    result = run(convert_graph(graph, "m"), {"in0": source, "in1": matrix})[0]
    expected = np.zeros((2, 5, 6, 3))
    outside = 0
    for n, y, x in np.ndindex(2, 5, 6):
        sx, sy = (matrix[n] @ [x + 0.5, y + 0.5, 0, 1])[:2] - 0.5
        if not (0 <= sx <= 10 and 0 <= sy <= 8):
            outside += 1
            continue
        x0, y0 = min(int(sx), 9), min(int(sy), 7)
        fx, fy = sx - x0, sy - y0
        expected[n, y, x] = (1 - fy) * ((1 - fx) * source[n, y0, x0] + fx * source[n, y0, x0 + 1]) + fy * (
            (1 - fx) * source[n, y0 + 1, x0] + fx * source[n, y0 + 1, x0 + 1]
        )
    assert 0 < outside < 60
    np.testing.assert_allclose(result, expected, atol=1e-4)


def test_transform_tensor_bilinear_is_zero_where_the_matrix_is_no_number() -> None:
    matrix = np.tile(np.eye(4), (3, 1, 1))
    matrix[0, 0], matrix[1, 1] = np.nan, np.inf
    graph = single("TransformTensorBilinear", [[1, 9, 11, 3], [1, 4, 4]], [1, 5, 6, 3], {})
    result = run(convert_graph(graph, "m"), {"in0": 1.0 + random(3, 9, 11, 3) ** 2, "in1": matrix})[0]
    assert not result[:2].any() and result[2].all()


def test_more_channels_are_added_by_a_convolution() -> None:
    """As it stands before a sum in the face mesh: so it stays in the blocked memory layout."""
    image = random(2, 4, 6, 8)
    graph = single("PAD", [[1, 4, 6, 8], np.array([[0, 0], [0, 0], [0, 0], [0, 3]])], [1, 4, 6, 11])
    model = convert_graph(graph, "m")
    assert "Pad" not in [node.op_type for node in model.graph.node]
    np.testing.assert_array_equal(run(model, {"in0": image})[0], np.pad(image, ((0, 0), (0, 0), (0, 0), (0, 3))))


def test_transform_landmarks() -> None:
    points, matrix = random(2, 7, 2), random(2, 4, 4)
    graph = single("TransformLandmarks", [[1, 7, 2], [1, 4, 4]], [1, 7, 2], {})
    expected = np.einsum("nij,nkj->nki", matrix[:, :2, :2], points) + matrix[:, None, :2, 3]
    np.testing.assert_allclose(
        run(convert_graph(graph, "m"), {"in0": points, "in1": matrix})[0], expected, atol=1e-5
    )


def test_densify_rows_and_blocks() -> None:
    dense = np.array([[0, 0, 3], [0, 0, 0], [7, 0, 9]], np.float32)
    rows = [
        SparseDimension(size=3),
        SparseDimension(segments=np.array([0, 1, 1, 3]), indices=np.array([2, 0, 2])),
    ]
    np.testing.assert_array_equal(densify(np.float32([3, 7, 9]), [3, 3], [0, 1], [], rows), dense)
    blocks = [
        SparseDimension(size=2),
        SparseDimension(segments=np.array([0, 1, 1]), indices=np.array([1])),
        SparseDimension(size=2),
    ]
    expected = np.zeros((2, 4))
    expected[0, 2:] = [5, 6]
    np.testing.assert_array_equal(densify(np.array([5.0, 6.0]), [2, 4], [0, 1, 2], [1], blocks), expected)
