"""TensorFlow.js graph models (model.json and .bin shards) to ONNX.

The graph is walked backwards from the wanted outputs, which may be inner nodes: what lies behind them is
cut off.
"""

from __future__ import annotations

import base64
import json
from dataclasses import dataclass
from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Tuple

import numpy as np

from hri_pipeline.models.catalogue import ConversionError
from hri_pipeline.models.onnx_graph import Dimension, GraphBuilder


@dataclass(frozen=True)
class Value:
    """A computed value; shape without the batch: (H, W, C), held N x C x H x W, or (C,), held N x C."""

    name: str
    shape: Tuple[int, ...]


class Node:
    """One node of the topology with plain access to its attributes."""

    def __init__(self, entry: Mapping[str, Any]) -> None:
        self.name: str = entry["name"]
        self.kind: str = entry["op"].lstrip("_")
        self.inputs = [_node_name(text) for text in entry.get("input", []) if not text.startswith("^")]
        self._attributes: Mapping[str, Any] = entry.get("attr", {})

    def flag(self, key: str) -> bool:
        """A boolean attribute, False when absent."""
        return bool(self._attributes.get(key, {}).get("b", False))

    def text(self, key: str, default: str = "") -> str:
        """A string attribute (base64 in the file)."""
        return base64.b64decode(self._attributes[key]["s"]).decode() if key in self._attributes else default

    def texts(self, key: str) -> List[str]:
        """A list of strings, empty when absent."""
        stored = self._attributes.get(key, {}).get("list", {}).get("s", [])
        return [base64.b64decode(text).decode() for text in stored]

    def integers(self, key: str) -> List[int]:
        """A list of integers, empty when absent."""
        return [int(number) for number in self._attributes.get(key, {}).get("list", {}).get("i", [])]

    def dimensions(self) -> List[int]:
        """The shape of a placeholder, -1 where unknown."""
        return [int(dimension["size"]) for dimension in self._attributes["shape"]["shape"]["dim"]]


class TfjsConversion:
    """The state of one conversion: what operators read from."""

    def __init__(
        self,
        nodes: Mapping[str, Node],
        weights: Mapping[str, np.ndarray],
        model_name: str,
        dynamic_size: bool,
    ) -> None:
        self.nodes = nodes
        self.weights = weights
        self.model_name = model_name
        self.dynamic_size = dynamic_size
        self.builder = GraphBuilder(model_name)
        self.values: Dict[str, Value] = {}
        self.input_names: Dict[str, str] = {}
        self.input_size: Optional[Tuple[int, int]] = None

    def constant(self, name: str) -> Optional[np.ndarray]:
        """The values of a constant node (through Identity nodes), None for a computed one."""
        node = self.nodes[name]
        while node.kind == "Identity":
            node = self.nodes[node.inputs[0]]
        return self.weights.get(node.name) if node.kind == "Const" else None

    def required_constant(self, node: Node, position: int) -> np.ndarray:
        """Input `position` of a node, which has to be constant."""
        array = self.constant(node.inputs[position])
        if array is None:
            raise ConversionError(
                "model %s: input %d of operator %s (node %s) has to be constant for the converter"
                % (self.model_name, position, node.kind, node.name)
            )
        return array

    def unknown(self, node: Node, why: str = "") -> ConversionError:
        """The error for an operator, or a use of it, that is not known."""
        return ConversionError(
            "model %s: operator %s%s (node %s) is not known to the TensorFlow.js converter"
            % (self.model_name, node.kind, " " + why if why else "", node.name)
        )

    def output_shape(self, value: Value) -> List[Dimension]:
        """The declared shape of an output, with the image size as names when it is dynamic."""
        if len(value.shape) == 3 and self.dynamic_size and self.input_size:
            ratios = (self.input_size[0] // value.shape[0], self.input_size[1] // value.shape[1])
            return ["N", "H%d" % ratios[0], "W%d" % ratios[1], value.shape[2]]
        return ["N"] + list(value.shape)


def convert_tfjs(
    model_json: bytes,
    read_shard: Callable[[str], bytes],
    model_name: str,
    outputs: Mapping[str, str],
    inputs: Optional[Mapping[str, str]] = None,
    dynamic_size: bool = False,
) -> Any:
    """Convert a graph model to an ONNX model.

    `outputs` maps nodes to the output names that they get, `inputs` placeholders to input names (their own
    when None).  With `dynamic_size` the image height and width are free (multiples of the network's total
    stride). ConversionError names the operator and the model when something is not known.
    """
    document = json.loads(model_json.decode("utf-8"))
    nodes = {entry["name"]: Node(entry) for entry in document["modelTopology"]["node"]}
    weights = read_weights(document["weightsManifest"], read_shard, model_name)
    conversion = TfjsConversion(nodes, weights, model_name, dynamic_size)
    conversion.input_names.update(inputs or {})
    for node_name, output_name in outputs.items():
        if node_name not in nodes:
            raise ConversionError("model %s: it has no node %s" % (model_name, node_name))
        for needed in _execution_order(conversion, node_name):
            conversion.values[needed] = _convert_node(conversion, nodes[needed])
        value = conversion.values[node_name]
        name = conversion.builder.to_channels_last(value.name) if len(value.shape) == 3 else value.name
        conversion.builder.output(output_name, name, conversion.output_shape(value))
    return conversion.builder.build()


def _node_name(text: str) -> str:
    return text.split(":")[0]


def _execution_order(conversion: TfjsConversion, target: str) -> List[str]:
    """The computed nodes that `target` needs and that are not yet converted, inputs before their users."""
    order: List[str] = []
    visited = set(conversion.values)
    stack = [(target, False)]
    while stack:
        name, inputs_done = stack.pop()
        if inputs_done:
            order.append(name)
            continue
        if name in visited or conversion.constant(name) is not None:
            continue
        visited.add(name)
        stack.append((name, True))
        stack.extend((source, False) for source in conversion.nodes[name].inputs)
    return order


def _convert_node(conversion: TfjsConversion, node: Node) -> Value:
    convert = OPERATORS.get(node.kind)
    if convert is None:
        raise conversion.unknown(node)
    try:
        return convert(conversion, node)
    except (KeyError, IndexError, ValueError) as error:
        raise ConversionError(
            "model %s: operator %s (node %s) has unexpected attributes or shapes (%s: %s)"
            % (conversion.model_name, node.kind, node.name, type(error).__name__, error)
        ) from error


# -- the TensorFlow operators of the supported graph models, each a function from a node to its value

OperatorConverter = Callable[["TfjsConversion", Node], Value]
_AUTO_PAD = {"SAME": "SAME_UPPER", "VALID": "VALID"}


def window_output(
    size: Sequence[int], kernel: Sequence[int], stride: Sequence[int], dilation: Sequence[int], padding: str
) -> Tuple[int, int]:
    """Height and width after a convolution or pooling with TensorFlow's "SAME" or "VALID" padding."""
    if padding == "SAME":
        return -(-size[0] // stride[0]), -(-size[1] // stride[1])
    height, width = ((n - (k - 1) * d - 1) // s + 1 for n, k, s, d in zip(size, kernel, stride, dilation))
    return height, width


def _placeholder(conversion: "TfjsConversion", node: Node) -> Value:
    height, width, channels = node.dimensions()[1:]
    name = conversion.input_names.get(node.name, node.name)
    conversion.input_size = (height, width)
    free = conversion.dynamic_size
    conversion.builder.input(name, ["N", "H" if free else height, "W" if free else width, channels])
    return Value(conversion.builder.to_channels_first(name), (height, width, channels))


def _same(conversion: "TfjsConversion", node: Node) -> Value:
    return conversion.values[node.inputs[0]]


def _batch_axis_only(conversion: "TfjsConversion", node: Node) -> Value:
    """Taking the batch axis off and putting it on again: with a free batch both do nothing."""
    if node.kind == "ExpandDims":
        axes = [int(v) for v in conversion.required_constant(node, 1).reshape(-1)]
    else:
        axes = node.integers("squeeze_dims") if node.kind == "Squeeze" else [0]
    source = conversion.values[node.inputs[0]]
    if axes != [0] or len(source.shape) != 3:
        raise conversion.unknown(node, "on axes %s" % axes)
    return source


def _convolution(conversion: "TfjsConversion", node: Node) -> Value:
    source = conversion.values[node.inputs[0]]
    weights = conversion.required_constant(node, 1)  # H W I O, depthwise H W C multiplier
    kernel, channels = list(weights.shape[:2]), weights.shape[2]
    depthwise = "Depthwise" in node.kind
    if depthwise:
        weights = weights.reshape(kernel + [1, channels * weights.shape[3]])
    weights = weights.transpose(3, 2, 0, 1)
    stride, dilation = node.integers("strides")[1:3], node.integers("dilations")[1:3] or [1, 1]
    padding, fused = node.text("padding"), node.texts("fused_ops")
    if padding not in _AUTO_PAD or node.text("data_format", "NHWC") != "NHWC":
        raise conversion.unknown(node, "with padding %s" % padding)
    inputs = [source.name, conversion.builder.floats(weights)]
    if "BiasAdd" in fused:
        inputs.append(conversion.builder.floats(conversion.required_constant(node, 2).reshape(-1)))
    value = conversion.builder.node(
        "Conv",
        inputs,
        kernel_shape=kernel,
        strides=stride,
        dilations=dilation,
        auto_pad=_AUTO_PAD[padding],
        group=channels if depthwise else 1,
    )
    shape = window_output(source.shape[:2], kernel, stride, dilation, padding) + (weights.shape[0],)
    return Value(_fused_activation(conversion, node, value, fused), shape)


def _fused_activation(conversion: "TfjsConversion", node: Node, value: str, fused: Sequence[str]) -> str:
    for name in fused:
        if name == "BiasAdd":
            continue
        if name == "Relu":
            value = conversion.builder.node("Relu", [value])
        elif name == "Relu6":
            value = conversion.builder.clip(value, 0.0, 6.0)
        elif name == "Prelu":
            value = conversion.builder.prelu(value, conversion.required_constant(node, 3).reshape(-1))
        else:
            raise conversion.unknown(node, "with the fused operator %s" % name)
    return value


def _elementwise(onnx_type: str) -> OperatorConverter:
    def convert(conversion: "TfjsConversion", node: Node) -> Value:
        constants = [conversion.constant(name) for name in node.inputs[:2]]
        shapes = [
            conversion.values[name].shape for name, array in zip(node.inputs, constants) if array is None
        ]
        largest = max(shapes, key=lambda shape: (len(shape), shape))
        operands = []
        for name, array in zip(node.inputs, constants):
            operands.append(
                conversion.values[name].name
                if array is None
                else conversion.builder.floats(_broadcastable(array, len(largest)))
            )
        return Value(conversion.builder.node(onnx_type, operands), largest)

    return convert


def _broadcastable(array: np.ndarray, rank: int) -> np.ndarray:
    """A constant laid out to broadcast against N x C x H x W (rank 3) or N x C (rank 1)."""
    if array.size == 1:
        return array.reshape(())
    if rank == 3:
        return array.reshape((1,) * (4 - array.ndim) + array.shape).transpose(0, 3, 1, 2)
    return array


def _unary(onnx_type: str, **attributes: int) -> OperatorConverter:
    def convert(conversion: "TfjsConversion", node: Node) -> Value:
        source = conversion.values[node.inputs[0]]
        return Value(conversion.builder.node(onnx_type, [source.name], **attributes), source.shape)

    return convert


def _relu6(conversion: "TfjsConversion", node: Node) -> Value:
    source = conversion.values[node.inputs[0]]
    return Value(conversion.builder.clip(source.name, 0.0, 6.0), source.shape)


def _prelu(conversion: "TfjsConversion", node: Node) -> Value:
    source = conversion.values[node.inputs[0]]
    slope = conversion.required_constant(node, 1).reshape(-1)
    if len(source.shape) != 3 or slope.size != source.shape[2]:
        raise conversion.unknown(node, "with slopes that are not per channel")
    return Value(conversion.builder.prelu(source.name, slope), source.shape)


def _max_pool(conversion: "TfjsConversion", node: Node) -> Value:
    source = conversion.values[node.inputs[0]]
    kernel, stride, padding = node.integers("ksize")[1:3], node.integers("strides")[1:3], node.text("padding")
    value = conversion.builder.node(
        "MaxPool", [source.name], kernel_shape=kernel, strides=stride, auto_pad=_AUTO_PAD[padding]
    )
    return Value(value, window_output(source.shape[:2], kernel, stride, (1, 1), padding) + source.shape[2:])


def _mean(conversion: "TfjsConversion", node: Node) -> Value:
    source = conversion.values[node.inputs[0]]
    axes = sorted(int(axis) for axis in conversion.required_constant(node, 1).reshape(-1))
    if axes != [1, 2] or len(source.shape) != 3:
        raise conversion.unknown(node, "over the axes %s" % axes)
    value = conversion.builder.node("GlobalAveragePool", [source.name])
    if node.flag("keep_dims"):
        return Value(value, (1, 1) + source.shape[2:])
    return Value(conversion.builder.node("Flatten", [value]), source.shape[2:])


def _reshape(conversion: "TfjsConversion", node: Node) -> Value:
    source = conversion.values[node.inputs[0]]
    target: List[int] = [int(size) for size in conversion.required_constant(node, 1)]
    size = int(np.prod(source.shape))
    if len(target) != 2 or target[1] not in (-1, size):
        raise conversion.unknown(node, "to the shape %s" % target)
    value = conversion.builder.to_channels_last(source.name) if len(source.shape) == 3 else source.name
    return Value(conversion.builder.reshape(value, [0, size]), (size,))


def _matrix_product(conversion: "TfjsConversion", node: Node) -> Value:
    weights = conversion.required_constant(node, 1)
    if node.flag("transpose_b"):
        weights = weights.T
    fused = node.texts("fused_ops")
    inputs = [conversion.values[node.inputs[0]].name, conversion.builder.floats(weights)]
    if "BiasAdd" in fused:
        inputs.append(conversion.builder.floats(conversion.required_constant(node, 2).reshape(-1)))
    value = conversion.builder.node("Gemm", inputs)
    fused = [name for name in fused if name != "BiasAdd"]
    if set(fused) - {"Relu", "Relu6"}:
        raise conversion.unknown(node, "with the fused operators %s" % fused)
    return Value(_fused_activation(conversion, node, value, fused), (weights.shape[1],))


def _pad(conversion: "TfjsConversion", node: Node) -> Value:
    source = conversion.values[node.inputs[0]]
    amounts = conversion.required_constant(node, 1).astype(np.int64)  # (N H W C) x (before, after)
    height, width, channels = (n + int(p.sum()) for n, p in zip(source.shape, amounts[1:]))
    pads = conversion.builder.integers(amounts[[0, 3, 1, 2]].T.reshape(-1))
    return Value(conversion.builder.node("Pad", [source.name, pads]), (height, width, channels))


def _concatenate(conversion: "TfjsConversion", node: Node) -> Value:
    axis = int(conversion.required_constant(node, len(node.inputs) - 1))
    sources = [conversion.values[name] for name in node.inputs[:-1]]
    if axis not in (3, -1) or any(len(source.shape) != 3 for source in sources):
        raise conversion.unknown(node, "on axis %d" % axis)
    value = conversion.builder.node("Concat", [source.name for source in sources], axis=1)
    return Value(value, sources[0].shape[:2] + (sum(source.shape[2] for source in sources),))


def _resize(conversion: "TfjsConversion", node: Node) -> Value:
    source = conversion.values[node.inputs[0]]
    height, width = (int(size) for size in conversion.required_constant(node, 1))
    mode = "asymmetric"
    if node.flag("align_corners"):
        mode = "align_corners"
    elif node.flag("half_pixel_centers"):
        mode = "half_pixel"
    scales = conversion.builder.floats([1, 1, height / source.shape[0], width / source.shape[1]])
    value = conversion.builder.node(
        "Resize", [source.name, "", scales], mode="linear", coordinate_transformation_mode=mode
    )
    return Value(value, (height, width, source.shape[2]))


OPERATORS: Dict[str, OperatorConverter] = {
    "Placeholder": _placeholder,
    "Identity": _same,
    "Cast": _same,  # integer images are fed as floats
    "ExpandDims": _batch_axis_only,
    "Squeeze": _batch_axis_only,
    "Unpack": _batch_axis_only,
    "Conv2D": _convolution,
    "FusedConv2D": _convolution,
    "DepthwiseConv2dNative": _convolution,
    "FusedDepthwiseConv2dNative": _convolution,
    "Add": _elementwise("Add"),
    "AddV2": _elementwise("Add"),
    "Mul": _elementwise("Mul"),
    "Sub": _elementwise("Sub"),
    "Minimum": _elementwise("Min"),
    "Maximum": _elementwise("Max"),
    "RealDiv": _elementwise("Div"),
    "Relu": _unary("Relu"),
    "Sigmoid": _unary("Sigmoid"),
    "Softmax": _unary("Softmax", axis=1),
    "Relu6": _relu6,
    "Prelu": _prelu,
    "MaxPool": _max_pool,
    "Mean": _mean,
    "Reshape": _reshape,
    "MatMul": _matrix_product,
    "FusedMatMul": _matrix_product,
    "Pad": _pad,
    "ConcatV2": _concatenate,
    "ResizeBilinear": _resize,
}


_STORED = {"float32": "<f4", "int32": "<i4", "bool": "u1", "float16": "<f2", "uint8": "u1", "uint16": "<u2"}


def read_weights(
    manifest: Sequence[Mapping[str, Any]], read_shard: Callable[[str], bytes], model_name: str
) -> Dict[str, np.ndarray]:
    """Weights by name: float32, or int64 for integers.

    `manifest` is the list of weight groups; `read_shard` gives the bytes of a shard by its path.
    ConversionError when a data type is unknown or the shards have the wrong length.
    """
    weights: Dict[str, np.ndarray] = {}
    for group in manifest:
        raw = b"".join(read_shard(path) for path in group["paths"])
        position = 0
        for entry in group["weights"]:
            stored, count = _stored_type(entry, model_name), int(np.prod(entry["shape"], dtype=np.int64))
            end = position + count * stored.itemsize
            if end > len(raw):
                raise ConversionError(
                    "model %s: the weight file is too short for %s" % (model_name, entry["name"])
                )
            values = np.frombuffer(raw, stored, count, position).reshape(entry["shape"])
            weights[entry["name"]] = _restore(values, entry)
            position = end
        if position != len(raw):
            raise ConversionError(
                "model %s: the weight file is %d bytes longer than its manifest says"
                % (model_name, len(raw) - position)
            )
    return weights


def _stored_type(entry: Mapping[str, Any], model_name: str) -> np.dtype:
    name = entry["quantization"]["dtype"] if entry.get("quantization") else entry["dtype"]
    if name not in _STORED:
        raise ConversionError(
            "model %s: weight %s has the data type %s, which is not known" % (model_name, entry["name"], name)
        )
    return np.dtype(_STORED[name])


def _restore(values: np.ndarray, entry: Mapping[str, Any]) -> np.ndarray:
    quantization = entry.get("quantization")
    if quantization and quantization["dtype"] != "float16":
        return values.astype(np.float32) * np.float32(quantization["scale"]) + np.float32(quantization["min"])
    return values.astype(np.float32 if entry["dtype"] == "float32" else np.int64)
