"""TensorFlow.js and face-api converters: small graphs, converted, run and compared with numpy."""

from __future__ import annotations

import base64
import json
from typing import Any, Dict, List, Optional, Sequence, Tuple

import numpy as np
import onnxruntime
import pytest

from hri_pipeline.models.catalogue import ConversionError
from hri_pipeline.models.faceapi_to_onnx import convert_faceapi
from hri_pipeline.models.tfjs_to_onnx import convert_tfjs, read_weights


def random(*shape: int) -> np.ndarray:
    return np.random.default_rng(sum(shape)).normal(size=shape).astype(np.float32)


def text(value: str) -> Dict[str, str]:
    return {"s": base64.b64encode(value.encode()).decode()}


def texts(*values: str) -> Dict[str, Any]:
    return {"list": {"s": [text(value)["s"] for value in values]}}


def integers(*values: int) -> Dict[str, Any]:
    return {"list": {"i": [str(value) for value in values]}}


class GraphModel:
    """A graph model written in memory."""

    def __init__(self, height: int, width: int, channels: int) -> None:
        dimensions = [{"size": str(size)} for size in (1, height, width, channels)]
        self.nodes: List[Dict[str, Any]] = [
            {"name": "image", "op": "Placeholder", "attr": {"shape": {"shape": {"dim": dimensions}}}}
        ]
        self.entries: List[Dict[str, Any]] = []
        self.shard = b""

    def constant(self, name: str, values: np.ndarray) -> str:
        dtype = "float32" if values.dtype.kind == "f" else "int32"
        self.shard += values.astype("<f4" if dtype == "float32" else "<i4").tobytes()
        self.entries.append({"name": name, "shape": list(values.shape), "dtype": dtype})
        self.nodes.append({"name": name, "op": "Const", "attr": {}})
        return name

    def node(self, name: str, kind: str, inputs: Sequence[str], **attributes: Any) -> str:
        self.nodes.append({"name": name, "op": kind, "input": list(inputs), "attr": attributes})
        return name

    def convert(self, outputs: Dict[str, str], dynamic_size: bool = False) -> Any:
        document = {
            "modelTopology": {"node": self.nodes},
            "weightsManifest": [{"paths": ["shard.bin"], "weights": self.entries}],
        }
        return convert_tfjs(
            json.dumps(document).encode(),
            lambda path: self.shard,
            "m",
            outputs,
            {"image": "images"},
            dynamic_size,
        )


def run(model: Any, image: np.ndarray, name: str = "images") -> List[np.ndarray]:
    session = onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
    return session.run(None, {name: image.astype(np.float32)})


def same_convolution(
    image: np.ndarray, weights: np.ndarray, stride: int, depthwise: bool = False
) -> np.ndarray:
    """TensorFlow's "SAME" convolution in plain loops; weights H x W x in x out."""
    pads: List[Tuple[int, int]] = [(0, 0)]
    for size, kernel in zip(image.shape[1:3], weights.shape[:2]):
        total = max((-(-size // stride) - 1) * stride + kernel - size, 0)
        pads.append((total // 2, total - total // 2))
    padded = np.pad(image, pads + [(0, 0)])
    rows, columns = (-(-size // stride) for size in image.shape[1:3])
    result = []
    for y, x in np.ndindex(rows, columns):
        patch = padded[:, y * stride :, x * stride :][:, : weights.shape[0], : weights.shape[1]]
        result.append(
            np.einsum("nhwc,hwc->nc", patch, weights[..., 0])
            if depthwise
            else np.einsum("nhwi,hwio->no", patch, weights)
        )
    return np.stack(result, 1).reshape(len(image), rows, columns, -1)


def convolution_attributes(stride: int, *fused: str) -> Dict[str, Any]:
    return {
        "strides": integers(1, stride, stride, 1),
        "dilations": integers(1, 1, 1, 1),
        "padding": text("SAME"),
        "data_format": text("NHWC"),
        "fused_ops": texts(*fused),
    }


@pytest.mark.parametrize("stride", [1, 2])
@pytest.mark.parametrize("fused", [(), ("BiasAdd", "Relu"), ("BiasAdd", "Relu6"), ("BiasAdd", "Prelu")])
def test_fused_convolution(stride: int, fused: Tuple[str, ...]) -> None:
    weights, bias, slope, image = random(3, 3, 2, 4), random(4), random(1, 1, 4), random(2, 7, 6, 2)
    graph = GraphModel(7, 6, 2)
    inputs = ["image", graph.constant("w", weights)]
    if fused:
        inputs += [graph.constant("b", bias), graph.constant("a", slope)]
    graph.node("conv", "_FusedConv2D", inputs, **convolution_attributes(stride, *fused))
    expected = same_convolution(image, weights, stride) + (bias if fused else 0)
    if "Prelu" in fused:
        expected = np.where(expected > 0, expected, expected * slope)
    elif fused:
        expected = np.clip(expected, 0, 6 if "Relu6" in fused else None)
    np.testing.assert_allclose(run(graph.convert({"conv": "out"}), image)[0], expected, atol=1e-5)


def test_depthwise_convolution() -> None:
    weights, image = random(3, 3, 4, 1), random(2, 5, 6, 4)
    graph = GraphModel(5, 6, 4)
    inputs = ["image", graph.constant("w", weights)]
    graph.node("conv", "DepthwiseConv2dNative", inputs, **convolution_attributes(2))
    result = run(graph.convert({"conv": "out"}), image)[0]
    np.testing.assert_allclose(result, same_convolution(image, weights, 2, True), atol=1e-5)


def test_head_of_a_classifier() -> None:
    weights, bias, image = random(3, 5), random(5), random(2, 4, 4, 3)
    graph = GraphModel(4, 4, 3)
    graph.node("mean", "Mean", ["image", graph.constant("axes", np.array([1, 2]))])
    inputs = ["mean", graph.constant("w", weights), graph.constant("b", bias)]
    graph.node("dense", "_FusedMatMul", inputs, fused_ops=texts("BiasAdd"))
    graph.node("softmax", "Softmax", ["dense"])
    scores = np.exp(image.mean((1, 2)) @ weights + bias)
    expected = scores / scores.sum(1, keepdims=True)
    np.testing.assert_allclose(run(graph.convert({"softmax": "out"}), image)[0], expected, atol=1e-6)


def test_elementwise_concatenation_reshape_and_pad() -> None:
    image, factor = random(2, 4, 6, 3), random(3)
    graph = GraphModel(4, 6, 3)
    graph.node("scaled", "Mul", [graph.constant("f", factor), "image"])
    graph.node("difference", "Sub", ["image", "scaled"])
    graph.node("joined", "ConcatV2", ["scaled", "difference", graph.constant("axis", np.array(3))])
    graph.node("flat", "Reshape", ["joined", graph.constant("shape", np.array([-1, 144]))])
    graph.node("padded", "Pad", ["image", graph.constant("pads", np.array([[0, 0], [1, 0], [0, 2], [0, 0]]))])
    flat, padded = run(graph.convert({"flat": "flat", "padded": "padded"}), image)
    joined = np.concatenate([image * factor, image - image * factor], 3)
    np.testing.assert_allclose(flat, joined.reshape(2, -1), atol=1e-6)
    np.testing.assert_allclose(padded, np.pad(image, ((0, 0), (1, 0), (0, 2), (0, 0))))


def test_free_image_size() -> None:
    graph = GraphModel(8, 8, 2)
    graph.node(
        "pool",
        "MaxPool",
        ["image"],
        ksize=integers(1, 2, 2, 1),
        strides=integers(1, 2, 2, 1),
        padding=text("VALID"),
    )
    graph.node("up", "ResizeBilinear", ["pool", graph.constant("size", np.array([8, 8]))])
    model = graph.convert({"pool": "pool", "up": "up"}, dynamic_size=True)
    image = random(1, 4, 10, 2)
    pool, up = run(model, image)
    expected = image.reshape(1, 2, 2, 5, 2, 2).max((2, 4))
    np.testing.assert_allclose(pool, expected)
    np.testing.assert_allclose(up[:, ::2, ::2], expected, atol=1e-6)  # asymmetric: every second pixel kept
    np.testing.assert_allclose(up[:, 0, 1], (expected[:, 0, 0] + expected[:, 0, 1]) / 2, atol=1e-6)
    dimensions = [d.dim_param or d.dim_value for d in model.graph.output[0].type.tensor_type.shape.dim]
    assert dimensions == ["N", "H2", "W2", 2]


def test_nodes_behind_the_outputs_are_cut_off_and_unknown_ones_named() -> None:
    graph = GraphModel(4, 4, 1)
    graph.node("kept", "Relu", ["image"])
    graph.node("strange", "TopKV2", ["kept"])
    assert len(graph.convert({"kept": "out"}).graph.output) == 1
    with pytest.raises(ConversionError, match=r"model m: operator TopKV2 \(node strange\)"):
        graph.convert({"strange": "out"})
    with pytest.raises(ConversionError, match="model m: it has no node absent"):
        graph.convert({"absent": "out"})


@pytest.mark.parametrize(
    "quantization, stored",
    [
        ({"dtype": "uint8", "scale": 0.5, "min": -3.0}, np.array([0, 7, 255], "u1")),
        ({"dtype": "uint16", "scale": 0.25, "min": 1.0}, np.array([0, 7, 60000], "<u2")),
        ({"dtype": "float16"}, np.array([0.5, -2.0, 8.0], "<f2")),
        (None, np.array([0.5, -2.0, 8.0], "<f4")),
    ],
)
def test_weights_are_restored(quantization: Optional[Dict[str, Any]], stored: np.ndarray) -> None:
    entry: Dict[str, Any] = {"name": "w", "shape": [3], "dtype": "float32"}
    if quantization:
        entry["quantization"] = quantization
    manifest = [{"paths": ["a"], "weights": [entry]}]
    expected = stored.astype(np.float32)
    if quantization and "scale" in quantization:
        expected = expected * np.float32(quantization["scale"]) + np.float32(quantization["min"])
    restored = read_weights(manifest, lambda path: stored.tobytes(), "m")["w"]
    assert restored.dtype == np.float32
    np.testing.assert_array_equal(restored, expected)
    with pytest.raises(ConversionError, match="too short for w"):
        read_weights(manifest, lambda path: stored.tobytes()[:-1], "m")
    with pytest.raises(ConversionError, match="1 bytes longer"):
        read_weights(manifest, lambda path: stored.tobytes() + b"x", "m")


def test_faceapi_names_what_is_missing() -> None:
    with pytest.raises(ConversionError, match="no network of this name"):
        convert_faceapi(b"[]", lambda path: b"", "other")
    with pytest.raises(ConversionError, match="weight dense0/conv0/filters is missing"):
        convert_faceapi(b"[]", lambda path: b"", "face_expression")


def test_faceapi_expression_against_numpy() -> None:
    weights = expression_weights()
    manifest = [
        {
            "paths": ["w"],
            "weights": [
                {"name": name, "shape": list(values.shape), "dtype": "float32"}
                for name, values in weights.items()
            ],
        }
    ]
    shard = b"".join(values.astype("<f4").tobytes() for values in weights.values())
    model = convert_faceapi(json.dumps(manifest).encode(), lambda path: shard, "face_expression")
    image = np.random.default_rng(5).uniform(0, 255, (1, 112, 112, 3))
    expected = expression_numpy(image, weights)
    np.testing.assert_allclose(run(model, image, "image")[0], expected, atol=1e-5)


def expression_weights() -> Dict[str, np.ndarray]:
    """Random weights of the expression network with few channels."""
    weights: Dict[str, np.ndarray] = {}
    before = 3
    for block, channels in enumerate((2, 3, 4, 5)):
        for layer in range(4):
            prefix, inner = "dense%d/conv%d" % (block, layer), before if layer == 0 else channels
            if block == 0 and layer == 0:
                weights[prefix + "/filters"] = random(3, 3, inner, channels) / 3
            else:
                weights[prefix + "/depthwise_filter"] = random(3, 3, inner, 1) / 3
                weights[prefix + "/pointwise_filter"] = random(1, 1, inner, channels)
            weights[prefix + "/bias"] = random(channels)
        before = channels
    weights.update({"fc/weights": random(5, 7), "fc/bias": random(7)})
    return weights


def expression_numpy(image: np.ndarray, weights: Dict[str, np.ndarray]) -> np.ndarray:
    def layer(value: np.ndarray, prefix: str, stride: int = 1) -> np.ndarray:
        if prefix + "/filters" in weights:
            return same_convolution(value, weights[prefix + "/filters"], stride) + weights[prefix + "/bias"]
        value = same_convolution(value, weights[prefix + "/depthwise_filter"], stride, True)
        return same_convolution(value, weights[prefix + "/pointwise_filter"], 1) + weights[prefix + "/bias"]

    value = (image - [122.782, 117.001, 104.298]) / 255
    for block in range(4):
        prefix = "dense%d/conv" % block
        first = np.maximum(layer(value, prefix + "0", 2), 0)
        second = layer(first, prefix + "1")
        third = layer(np.maximum(first + second, 0), prefix + "2")
        fourth = layer(np.maximum(first + second + third, 0), prefix + "3")
        value = np.maximum(first + second + third + fourth, 0)
    scores = value.mean((1, 2)) @ weights["fc/weights"] + weights["fc/bias"]
    scores = np.exp(scores - scores.max())
    return scores / scores.sum(1, keepdims=True)
