"""The standard TFLite operators, each written as a function that returns the ONNX value of its output."""

from __future__ import annotations

from typing import TYPE_CHECKING, Callable, Dict, Sequence, Tuple

import numpy as np

from hri_pipeline.models.errors import ConversionError
from hri_pipeline.models.tflite_graph import Operator

if TYPE_CHECKING:
    from hri_pipeline.models.tflite_to_onnx import TfliteConversion

OperatorConverter = Callable[["TfliteConversion", Operator], str]
CHANNELS_FIRST_AXIS = {0: 0, 1: 2, 2: 3, 3: 1}  # axis of N x H x W x C -> axis of N x C x H x W
_PADDING_SAME = 0


def same_padding(
    size: Sequence[int], kernel: Sequence[int], stride: Sequence[int], dilation: Sequence[int]
) -> Tuple[int, int, int, int]:
    """TensorFlow's "same" padding (top, left, bottom, right); the odd pixel goes to the bottom and right."""
    before, after = [], []
    for n, k, s, d in zip(size, kernel, stride, dilation):
        outputs = -(-n // s)
        total = max((outputs - 1) * s + (k - 1) * d + 1 - n, 0)
        before.append(total // 2)
        after.append(total - total // 2)
    return before[0], before[1], after[0], after[1]


def _activate(conversion: "TfliteConversion", operator: Operator, value: str) -> str:
    kind = operator.options["FusedActivationFunction"]
    if kind == 0:
        return value
    if kind == 1:
        return conversion.builder.node("Relu", [value])
    if kind == 2:
        return conversion.builder.clip(value, -1.0, 1.0)
    if kind == 3:
        return conversion.builder.clip(value, 0.0, 6.0)
    if kind == 4:
        return conversion.builder.node("Tanh", [value])
    raise ConversionError(
        "model %s: operator %s has the fused activation number %d, which is not known"
        % (conversion.model_name, operator.kind, kind)
    )


def _convolution(conversion: "TfliteConversion", operator: Operator) -> str:
    options, depthwise = operator.options, operator.kind == "DEPTHWISE_CONV_2D"
    source_shape = conversion.shape(operator.inputs[0])
    weights = conversion.weights(operator.inputs[1])  # O H W I, depthwise 1 H W (I * multiplier)
    weights = weights.transpose(3, 0, 1, 2) if depthwise else weights.transpose(0, 3, 1, 2)
    kernel = list(weights.shape[2:])
    stride = [options["StrideH"], options["StrideW"]]
    dilation = [options["DilationHFactor"], options["DilationWFactor"]]
    pads = (0, 0, 0, 0)
    if options["Padding"] == _PADDING_SAME:
        pads = same_padding(source_shape[1:3], kernel, stride, dilation)
    inputs = [conversion.value(operator.inputs[0]), conversion.builder.floats(weights)]
    if len(operator.inputs) > 2 and operator.inputs[2] >= 0:
        inputs.append(conversion.builder.floats(conversion.weights(operator.inputs[2])))
    value = conversion.builder.node(
        "Conv",
        inputs,
        kernel_shape=kernel,
        strides=stride,
        dilations=dilation,
        pads=list(pads),
        group=source_shape[3] if depthwise else 1,
    )
    return _activate(conversion, operator, value)


def _pool(conversion: "TfliteConversion", operator: Operator) -> str:
    options = operator.options
    kernel, stride = (
        [options["FilterHeight"], options["FilterWidth"]],
        [options["StrideH"], options["StrideW"]],
    )
    pads = (0, 0, 0, 0)
    if options["Padding"] == _PADDING_SAME:
        pads = same_padding(conversion.shape(operator.inputs[0])[1:3], kernel, stride, (1, 1))
    kind = "MaxPool" if operator.kind == "MAX_POOL_2D" else "AveragePool"
    value = conversion.builder.node(
        kind, [conversion.value(operator.inputs[0])], kernel_shape=kernel, strides=stride, pads=list(pads)
    )
    return _activate(conversion, operator, value)


def _pad(conversion: "TfliteConversion", operator: Operator) -> str:
    amounts = conversion.weights(operator.inputs[1])  # rank x (before, after)
    if len(amounts) == 4:
        amounts = amounts[[0, 3, 1, 2]]
    pads = conversion.builder.integers(amounts.T.reshape(-1))
    return conversion.builder.node("Pad", [conversion.value(operator.inputs[0]), pads])


def _elementwise(conversion: "TfliteConversion", operator: Operator) -> str:
    rank = len(conversion.shape(operator.outputs[0]))
    operands = [conversion.operand(index, rank) for index in operator.inputs]
    value = conversion.builder.node({"ADD": "Add", "MUL": "Mul"}[operator.kind], operands)
    return _activate(conversion, operator, value)


def _unary(onnx_type: str) -> OperatorConverter:
    def convert(conversion: "TfliteConversion", operator: Operator) -> str:
        return conversion.builder.node(onnx_type, [conversion.value(operator.inputs[0])])

    return convert


def _prelu(conversion: "TfliteConversion", operator: Operator) -> str:
    slope = conversion.weights(operator.inputs[1])
    source = conversion.value(operator.inputs[0])
    per_channel = slope.size == slope.shape[-1] and len(conversion.shape(operator.inputs[0])) == 4
    if per_channel:
        return conversion.builder.prelu(source, slope.reshape(-1))
    if slope.ndim >= 3:
        slope = slope.reshape(slope.shape[-3:]).transpose(2, 0, 1)
    return conversion.builder.node("PRelu", [source, conversion.builder.floats(slope)])


def _resize(conversion: "TfliteConversion", operator: Operator) -> str:
    source, target = conversion.shape(operator.inputs[0]), conversion.shape(operator.outputs[0])
    mode = "asymmetric"
    if operator.options["AlignCorners"]:
        mode = "align_corners"
    elif operator.options["HalfPixelCenters"]:
        mode = "half_pixel"
    scales = conversion.builder.floats([1, 1, target[1] / source[1], target[2] / source[2]])
    return conversion.builder.node(
        "Resize",
        [conversion.value(operator.inputs[0]), "", scales],
        mode="linear",
        coordinate_transformation_mode=mode,
    )


def _depth_to_space(conversion: "TfliteConversion", operator: Operator) -> str:
    return conversion.builder.node(
        "DepthToSpace",
        [conversion.value(operator.inputs[0])],
        mode="DCR",
        blocksize=operator.options["BlockSize"],
    )


def _reshape(conversion: "TfliteConversion", operator: Operator) -> str:
    target = conversion.shape(operator.outputs[0])
    value = conversion.builder.reshape(conversion.natural(operator.inputs[0]), [0] + target[1:])
    return conversion.from_natural(value, operator.outputs[0])


def _concatenate(conversion: "TfliteConversion", operator: Operator) -> str:
    rank = len(conversion.shape(operator.outputs[0]))
    axis = operator.options["Axis"] % rank
    operands = [conversion.operand(index, rank) for index in operator.inputs]
    value = conversion.builder.node("Concat", operands, axis=CHANNELS_FIRST_AXIS[axis] if rank == 4 else axis)
    return _activate(conversion, operator, value)


def _mean(conversion: "TfliteConversion", operator: Operator) -> str:
    axes = sorted(int(axis) % 4 for axis in conversion.weights(operator.inputs[1]).reshape(-1))
    if axes != [1, 2] or len(conversion.shape(operator.inputs[0])) != 4:
        raise ConversionError(
            "model %s: operator MEAN over the axes %s is not known to the TFLite converter"
            % (conversion.model_name, axes)
        )
    return conversion.builder.node(
        "ReduceMean",
        [conversion.value(operator.inputs[0])],
        axes=[2, 3],
        keepdims=int(bool(operator.options["KeepDims"])),
    )


def _fully_connected(conversion: "TfliteConversion", operator: Operator) -> str:
    source = conversion.builder.reshape(conversion.natural(operator.inputs[0]), [0, -1])
    inputs = [source, conversion.builder.floats(conversion.weights(operator.inputs[1]))]
    if len(operator.inputs) > 2 and operator.inputs[2] >= 0:
        inputs.append(conversion.builder.floats(conversion.weights(operator.inputs[2])))
    return _activate(conversion, operator, conversion.builder.node("Gemm", inputs, transB=1))


def _strided_slice(conversion: "TfliteConversion", operator: Operator) -> str:
    options, shape = operator.options, conversion.shape(operator.inputs[0])
    if options["ShrinkAxisMask"] or options["NewAxisMask"] or options["EllipsisMask"]:
        raise ConversionError(
            "model %s: operator STRIDED_SLICE with shrink, new-axis or ellipsis mask is not known"
            " to the TFLite converter" % conversion.model_name
        )
    begin, end, stride = (conversion.weights(index).astype(np.int64) for index in operator.inputs[1:4])
    axes = list(range(1, len(shape)))  # the batch is never sliced
    starts = [0 if options["BeginMask"] >> axis & 1 else begin[axis] for axis in axes]
    ends = [shape[axis] if options["EndMask"] >> axis & 1 else end[axis] for axis in axes]
    limits = [conversion.builder.integers(v) for v in (starts, ends, axes, stride[1:])]
    value = conversion.builder.node("Slice", [conversion.natural(operator.inputs[0])] + limits)
    return conversion.from_natural(value, operator.outputs[0])


OPERATORS: Dict[str, OperatorConverter] = {
    "CONV_2D": _convolution,
    "DEPTHWISE_CONV_2D": _convolution,
    "MAX_POOL_2D": _pool,
    "AVERAGE_POOL_2D": _pool,
    "PAD": _pad,
    "ADD": _elementwise,
    "MUL": _elementwise,
    "RELU": _unary("Relu"),
    "LOGISTIC": _unary("Sigmoid"),
    "HARD_SWISH": _unary("HardSwish"),
    "PRELU": _prelu,
    "RESIZE_BILINEAR": _resize,
    "DEPTH_TO_SPACE": _depth_to_space,
    "RESHAPE": _reshape,
    "CONCATENATION": _concatenate,
    "MEAN": _mean,
    "FULLY_CONNECTED": _fully_connected,
    "STRIDED_SLICE": _strided_slice,
}
