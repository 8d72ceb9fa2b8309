"""The TensorFlow operators of the supported graph models, each as a function from a node to its value."""

from __future__ import annotations

from typing import TYPE_CHECKING, Callable, Dict, List, Sequence, Tuple

import numpy as np

from hri_pipeline.models.tfjs_to_onnx import Node, Value

if TYPE_CHECKING:
    from hri_pipeline.models.tfjs_to_onnx import TfjsConversion

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
