"""TFLite (float graphs, fp16 or sparse constants) to ONNX.

Operators are converted only as far as the wanted outputs need them.  The batch dimension becomes dynamic,
images stay N x H x W x C at the border.
"""

from __future__ import annotations

from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple

import numpy as np

from hri_pipeline.models.catalogue import ConversionError
from hri_pipeline.models.onnx_graph import GraphBuilder
from hri_pipeline.models.tflite_graph import Operator, TfliteGraph, read_tflite


class TfliteConversion:
    """The state of one conversion: what operators read from and write to.

    Values of rank 4 are held N x C x H x W; `natural` gives them in TFLite's order. A graph of pointwise operators
    alone (a perceptron over points) is held in TFLite's order: its convolutions are then products of matrices,
    which is faster.
    """

    def __init__(self, graph: TfliteGraph, model_name: str) -> None:
        self.graph = graph
        self.model_name = model_name
        self.builder = GraphBuilder(model_name)
        self.pointwise = is_pointwise(graph)
        self._values: Dict[int, str] = {}

    def axis(self, axis: int, rank: int) -> int:
        """Axis of the held value for one in TFLite's order."""
        return CHANNELS_FIRST_AXIS[axis] if rank == 4 and not self.pointwise else axis

    def shape(self, index: int) -> List[int]:
        """Shape in TFLite's order."""
        return self.graph.tensors[index].shape

    def keep_batch(self, index: int, shape: Sequence[int]) -> None:
        """Give a tensor of which the graph drops the batch dimension the shape (in TFLite's order) that has it."""
        self.graph.tensors[index].shape = list(shape)

    def set_value(self, index: int, value: str) -> None:
        """Bind a tensor to the ONNX value that holds it."""
        self._values[index] = value

    def value(self, index: int) -> str:
        """The ONNX value of a computed tensor (N x C x H x W when of rank 4)."""
        if index not in self._values:
            raise ConversionError(
                "model %s: tensor %s is used before it is computed"
                % (self.model_name, self.graph.tensors[index].name)
            )
        return self._values[index]

    def weights(self, index: int) -> np.ndarray:
        """The values of a tensor that has to be constant."""
        data = self.graph.constant(index)
        if data is None:
            raise ConversionError(
                "model %s: tensor %s has to be constant for the converter"
                % (self.model_name, self.graph.tensors[index].name)
            )
        return data

    def operand(self, index: int, rank: int) -> str:
        """A computed tensor or a constant, laid out so that it broadcasts against a result of `rank`."""
        data = self.graph.constant(index)
        if data is None:
            return self.value(index)
        if rank == 4 and data.size > 1 and not self.pointwise:
            data = data.reshape((1,) * (4 - data.ndim) + data.shape).transpose(0, 3, 1, 2)
        elif data.size == 1:
            data = data.reshape(-1)
        return self.builder.constant(data)

    def natural(self, index: int) -> str:
        """A computed tensor in TFLite's order (N x H x W x C when of rank 4)."""
        shape = self.shape(index)
        if len(shape) != 4 or self.pointwise:
            return self.value(index)
        if shape[1] * shape[2] == 1:
            return self.builder.reshape(self.value(index), [0] + shape[1:])
        return self.builder.to_channels_last(self.value(index))

    def from_natural(self, value: str, index: int) -> str:
        """A value in TFLite's order, laid out as tensor `index` is held."""
        held_natural = len(self.shape(index)) != 4 or self.pointwise
        return value if held_natural else self.builder.to_channels_first(value)


def is_pointwise(graph: TfliteGraph) -> bool:
    """Whether a graph has convolutions, all of one pixel, and no operator that looks at neighbours."""
    kernels = [graph.constant(operator.inputs[1]) for operator in graph.operators if operator.kind == "CONV_2D"]
    return bool(kernels) and {operator.kind for operator in graph.operators} <= _POINTWISE and all(
        kernel is not None and kernel.shape[1:3] == (1, 1) for kernel in kernels)


def convert_tflite(content: bytes, model_name: str, outputs: Optional[Sequence[str]] = None) -> Any:
    """Convert the bytes of a TFLite file to an ONNX model.

    `outputs` names the outputs to keep (all when None).  ConversionError names the operator and the model
    when something is not known.
    """
    return convert_graph(read_tflite(content, model_name), model_name, outputs)


def convert_graph(graph: TfliteGraph, model_name: str, outputs: Optional[Sequence[str]] = None) -> Any:
    """Convert a graph that was read (or built) before; see `convert_tflite`."""
    conversion = TfliteConversion(graph, model_name)
    kept = _kept_outputs(graph, model_name, outputs)
    for index in graph.inputs:
        shape = graph.tensors[index].shape
        name = conversion.builder.input(graph.tensors[index].name, ["N"] + shape[1:])
        conversion.set_value(index, conversion.from_natural(name, index))
    for operator in _needed_operators(graph, kept):
        _convert_operator(conversion, operator)
    for index in kept:
        shape = graph.tensors[index].shape
        conversion.builder.output(graph.tensors[index].name, conversion.natural(index), ["N"] + shape[1:])
    return conversion.builder.build()


def _kept_outputs(graph: TfliteGraph, model_name: str, wanted: Optional[Sequence[str]]) -> List[int]:
    by_name = {graph.tensors[index].name: index for index in graph.outputs}
    if wanted is None:
        return list(graph.outputs)
    missing = [name for name in wanted if name not in by_name]
    if missing:
        raise ConversionError(
            "model %s: it has no output %s (it has %s)" % (model_name, ", ".join(missing), ", ".join(by_name))
        )
    return [by_name[name] for name in wanted]


def _needed_operators(graph: TfliteGraph, outputs: Sequence[int]) -> List[Operator]:
    needed = set(outputs)
    chosen = []
    for operator in reversed(graph.operators):
        if needed.intersection(operator.outputs):
            needed.update(operator.inputs)
            chosen.append(operator)
    return chosen[::-1]


def _convert_operator(conversion: TfliteConversion, operator: Operator) -> None:
    convert = OPERATORS.get(operator.kind) or CUSTOM_OPERATORS.get(operator.kind)
    if convert is None:
        raise ConversionError(
            "model %s: operator %s is not known to the TFLite converter"
            % (conversion.model_name, operator.kind)
        )
    try:
        conversion.set_value(operator.outputs[0], convert(conversion, operator))
    except (KeyError, IndexError, ValueError) as error:
        raise ConversionError(
            "model %s: operator %s has unexpected options or shapes (%s: %s)"
            % (conversion.model_name, operator.kind, type(error).__name__, error)
        ) from error


# -- the standard TFLite operators, each a function that returns the ONNX value of its output

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
    if conversion.pointwise:
        return _pointwise_convolution(conversion, operator)
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


def _pointwise_convolution(conversion: "TfliteConversion", operator: Operator) -> str:
    """A convolution of one pixel in TFLite's order: rows of channels times a matrix."""
    if (operator.options["StrideH"], operator.options["StrideW"]) != (1, 1):
        raise ConversionError("model %s: a pointwise CONV_2D with a stride is not known to the TFLite converter"
                              % conversion.model_name)
    weights = conversion.weights(operator.inputs[1])  # O 1 1 I
    product = conversion.builder.node("MatMul", [conversion.value(operator.inputs[0]), conversion.builder.floats(
        weights.reshape(weights.shape[0], -1).T)])
    if len(operator.inputs) > 2 and operator.inputs[2] >= 0:
        bias = conversion.builder.floats(conversion.weights(operator.inputs[2]))
        product = conversion.builder.node("Add", [product, bias])
    return _activate(conversion, operator, product)


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
    source = conversion.value(operator.inputs[0])
    if len(amounts) == 4:
        more, channels = int(amounts[3, 1]), conversion.shape(operator.inputs[0])[3]
        if int(amounts.sum()) == more and not conversion.pointwise:
            # As a convolution it stays in the blocked memory layout, and the sum that follows is fused into it.
            return conversion.builder.node("Conv", [source, conversion.builder.floats(
                np.eye(channels + more, channels)[:, :, None, None])], kernel_shape=[1, 1])
        amounts = amounts[[0, 3, 1, 2]]
    pads = conversion.builder.integers(amounts.T.reshape(-1))
    return conversion.builder.node("Pad", [source, pads])


def _elementwise(conversion: "TfliteConversion", operator: Operator) -> str:
    rank = len(conversion.shape(operator.outputs[0]))
    operands = [conversion.operand(index, rank) for index in operator.inputs]
    if operator.kind == "SQUARED_DIFFERENCE":
        difference = conversion.builder.node("Sub", operands)
        return conversion.builder.node("Mul", [difference, difference])
    onnx_type = {"ADD": "Add", "MUL": "Mul", "SUB": "Sub", "DIV": "Div"}[operator.kind]
    return _activate(conversion, operator, conversion.builder.node(onnx_type, operands))


def _unary(onnx_type: str) -> OperatorConverter:
    def convert(conversion: "TfliteConversion", operator: Operator) -> str:
        return conversion.builder.node(onnx_type, [conversion.value(operator.inputs[0])])

    return convert


def _reciprocal_root(conversion: "TfliteConversion", operator: Operator) -> str:
    return conversion.builder.node("Reciprocal", [_unary("Sqrt")(conversion, operator)])


def _transpose(conversion: "TfliteConversion", operator: Operator) -> str:
    axes = [int(axis) for axis in conversion.weights(operator.inputs[1]).reshape(-1)]
    if axes[0] != 0:
        raise ConversionError(
            "model %s: operator TRANSPOSE of the batch dimension is not known to the TFLite converter"
            % conversion.model_name
        )
    if len(axes) == 4 and not conversion.pointwise:  # the same on N x C x H x W
        axes = [CHANNELS_FIRST_AXIS[axes[axis]] for axis in (0, 3, 1, 2)]
    return conversion.builder.node("Transpose", [conversion.value(operator.inputs[0])], perm=axes)


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
    computed = [name for index, name in zip(operator.inputs, operands) if conversion.graph.constant(index) is None]
    if axis != 0 and len(computed) < len(operands):
        # A constant stands once for each row of the batch.
        shape = conversion.builder.node("Shape", [computed[0]], start=0, end=1)
        ones = conversion.builder.integers([1] * (rank - 1))
        rows = conversion.builder.node("Concat", [shape, ones], axis=0)
        operands = [name if name in computed else conversion.builder.node("Expand", [name, rows]) for name in operands]
    value = conversion.builder.node("Concat", operands, axis=conversion.axis(axis, rank))
    return _activate(conversion, operator, value)


def _reduce(conversion: "TfliteConversion", operator: Operator) -> str:
    """MEAN and SUM over any axes but the batch."""
    rank = len(conversion.shape(operator.inputs[0]))
    axes = sorted(int(axis) % rank for axis in conversion.weights(operator.inputs[1]).reshape(-1))
    keep = bool(operator.options["KeepDims"])
    if 0 in axes:
        raise ConversionError(
            "model %s: operator %s over the axes %s is not known to the TFLite converter"
            % (conversion.model_name, operator.kind, axes)
        )
    if rank != 4 or (not keep and axes != [1, 2]):
        source = conversion.natural(operator.inputs[0])
    else:
        source, axes = conversion.value(operator.inputs[0]), sorted(conversion.axis(axis, rank) for axis in axes)
    if operator.kind == "SUM":
        return conversion.builder.node("ReduceSum", [source, conversion.builder.integers(axes)], keepdims=int(keep))
    return conversion.builder.node("ReduceMean", [source], axes=axes, keepdims=int(keep))


def _fully_connected(conversion: "TfliteConversion", operator: Operator) -> str:
    source = conversion.builder.reshape(conversion.natural(operator.inputs[0]), [0, -1])
    inputs = [source, conversion.builder.floats(conversion.weights(operator.inputs[1]))]
    if len(operator.inputs) > 2 and operator.inputs[2] >= 0:
        inputs.append(conversion.builder.floats(conversion.weights(operator.inputs[2])))
    return _activate(conversion, operator, conversion.builder.node("Gemm", inputs, transB=1))


def _strided_slice(conversion: "TfliteConversion", operator: Operator) -> str:
    options, shape = operator.options, conversion.shape(operator.inputs[0])
    if options["ShrinkAxisMask"] not in (0, 1) or options["NewAxisMask"] or options["EllipsisMask"]:
        raise ConversionError(
            "model %s: operator STRIDED_SLICE with new-axis or ellipsis mask, or shrinking another axis than the batch,"
            " is not known to the TFLite converter" % conversion.model_name
        )
    if options["ShrinkAxisMask"]:
        conversion.keep_batch(operator.outputs[0], shape[:1] + conversion.shape(operator.outputs[0]))
    begin, end, stride = (conversion.weights(index).astype(np.int64) for index in operator.inputs[1:4])
    axes = list(range(1, len(shape)))  # the batch is never sliced
    starts = [0 if options["BeginMask"] >> axis & 1 else begin[axis] for axis in axes]
    ends = [shape[axis] if options["EndMask"] >> axis & 1 else end[axis] for axis in axes]
    limits = [conversion.builder.integers(v) for v in (starts, ends, axes, stride[1:])]
    value = conversion.builder.node("Slice", [conversion.natural(operator.inputs[0])] + limits)
    return conversion.from_natural(value, operator.outputs[0])


_POINTWISE = {"CONV_2D", "ADD", "MUL", "SUB", "DIV", "SQUARED_DIFFERENCE", "RELU", "LOGISTIC", "HARD_SWISH", "RESHAPE",
              "CONCATENATION", "MEAN", "SUM", "NEG", "SQRT", "RSQRT", "TRANSPOSE", "STRIDED_SLICE"}

OPERATORS: Dict[str, OperatorConverter] = {
    "CONV_2D": _convolution,
    "DEPTHWISE_CONV_2D": _convolution,
    "MAX_POOL_2D": _pool,
    "AVERAGE_POOL_2D": _pool,
    "PAD": _pad,
    "ADD": _elementwise,
    "MUL": _elementwise,
    "SUB": _elementwise,
    "ABS": _unary("Abs"),
    "DIV": _elementwise,
    "SQUARED_DIFFERENCE": _elementwise,
    "RELU": _unary("Relu"),
    "LOGISTIC": _unary("Sigmoid"),
    "HARD_SWISH": _unary("HardSwish"),
    "PRELU": _prelu,
    "RESIZE_BILINEAR": _resize,
    "DEPTH_TO_SPACE": _depth_to_space,
    "RESHAPE": _reshape,
    "CONCATENATION": _concatenate,
    "MEAN": _reduce,
    "SUM": _reduce,
    "NEG": _unary("Neg"),
    "SQRT": _unary("Sqrt"),
    "RSQRT": _reciprocal_root,
    "TRANSPOSE": _transpose,
    "FULLY_CONNECTED": _fully_connected,
    "STRIDED_SLICE": _strided_slice,
}


# -- MediaPipe's custom operators of the attention face mesh, in standard ONNX operators. Their meaning is that of the
# public sources of MediaPipe (Apache-2.0), `util/tflite/operations`: a first mesh gives, for each region (lips, eyes),
# a crop of a feature map; a small network refines the landmarks in the crop; the result is mapped back.


def _rotations(build: GraphBuilder, ends: str) -> Tuple[str, str]:
    """Left and right landmark (N, 2, 2) -> rotation that levels their line, and its inverse (N, 2, 2)."""
    line = build.node("MatMul", [build.floats([[[-1, 1]]]), ends])  # N, 1, 2
    along = build.node("Div", [line, build.node("ReduceL2", [line], axes=[2], keepdims=1)])  # (cos, sin)
    across = build.node("MatMul", [along, build.floats([[[0, 1], [-1, 0]]])])  # (-sin, cos)
    to_level = build.node("Concat", [along, across], axis=1)
    return to_level, build.node("Transpose", [to_level], perm=[0, 2, 1])


def _homogeneous(build: GraphBuilder, linear: str, shift: str) -> str:
    """Linear part (N, 2, 2) and shift (N, 2, 1) in the image plane -> matrix (N, 4, 4)."""
    shift = build.node("Pad", [shift, build.integers([0, 0, 1, 0, 0, 0])])  # a zero column for z before it
    top = build.node("Concat", [linear, shift], axis=2)  # N, 2, 4
    bottom = build.node("Expand", [build.floats([[[0, 0, 1, 0], [0, 0, 0, 1]]]), build.node("Shape", [top])])
    return build.node("Concat", [top, bottom], axis=1)


def _landmarks_to_transform_matrix(conversion: "TfliteConversion", operator: Operator) -> str:
    """Landmarks (N, L, 3) -> matrix (N, 4, 4) from crop pixels to source pixels.

    The crop is the bounding box of a subset of the landmarks in axes turned by the angle between a left and a
    right landmark, grown by a scale and mapped to output_width x output_height.
    """
    build, options = conversion.builder, operator.options
    if options["target_rotation_radians"] != 0:
        raise ConversionError(
            "model %s: operator Landmarks2TransformMatrix with a target rotation is not known to "
            "the TFLite converter" % conversion.model_name
        )
    width, height = float(options["output_width"]), float(options["output_height"])
    points = build.node(
        "Slice",
        [conversion.value(operator.inputs[0]), build.integers([0]), build.integers([2]), build.integers([2])],
    )  # N, L, 2
    ends = build.node(
        "Gather",
        [points, build.integers([options["left_rotation_idx"], options["right_rotation_idx"]])],
        axis=1,
    )
    to_level, from_level = _rotations(build, ends)
    subset = build.node("Gather", [points, build.integers(options["subset_idxs"])], axis=1)
    levelled = build.node("MatMul", [subset, from_level])  # rows times transpose: turned by -angle
    upper = build.node("ReduceMax", [levelled], axes=[1], keepdims=1)
    lower = build.node("ReduceMin", [levelled], axes=[1], keepdims=1)
    pixel = build.node(
        "Mul",
        [
            build.node("Sub", [upper, lower]),  # size of a crop pixel, N, 1, 2
            build.floats([[[options["scale_x"] / width, options["scale_y"] / height]]]),
        ],
    )
    middle = build.node("Mul", [build.node("Add", [upper, lower]), build.floats(0.5)])
    centre = build.node("Transpose", [build.node("MatMul", [middle, to_level])], perm=[0, 2, 1])  # N, 2, 1

    linear = build.node("Mul", [from_level, pixel])  # columns scaled, N, 2, 2
    half = build.node("MatMul", [linear, build.floats([[[width / 2], [height / 2]]])])
    shift = build.node("Sub", [centre, half])  # N, 2, 1
    return _homogeneous(build, linear, shift)


def _transform_tensor_bilinear(conversion: "TfliteConversion", operator: Operator) -> str:
    """Feature map (N, H, W, C) and matrix (N, 4, 4) -> crop (N, h, w, C), bilinear, zero outside of the map.

    Pixel centres lie at +0.5 on both sides; a sample counts as inside from the first to the last pixel
    centre.
    """
    build = conversion.builder
    _, source_height, source_width, channels = conversion.shape(operator.inputs[0])
    _, height, width, _ = conversion.shape(operator.outputs[0])
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    centres = np.stack([x.ravel(), y.ravel(), np.zeros(x.size), np.ones(x.size)])  # 4, P = h * w
    matrix = build.node(
        "Slice",
        [conversion.value(operator.inputs[1]), build.integers([0]), build.integers([2]), build.integers([1])],
    )  # N, 2, 4
    position = build.node("Sub", [build.node("MatMul", [matrix, build.floats(centres)]), build.floats(0.5)])
    half = build.floats([[[(source_width - 1) / 2], [(source_height - 1) / 2]]])
    offset = build.node("Abs", [build.node("Sub", [position, half])])
    legal = build.node("Cast", [build.node("LessOrEqual", [offset, half])], to=1)  # 0 also for what is no number
    inside = build.node("ReduceMin", [legal], axes=[1], keepdims=1)  # N, 1, P
    position = build.node("Where", [build.node("Cast", [inside], to=9), position, build.floats(0)])
    samples = _bilinear_samples(conversion, operator.inputs[0], position, inside)
    return conversion.from_natural(build.reshape(samples, [0, height, width, channels]), operator.outputs[0])


def _bilinear_samples(conversion: "TfliteConversion", source: int, position: str, inside: str) -> str:
    """Values (N, P * C) of a feature map at positions (N, 2, P) px in it, times `inside` (N, 1, P), 0 or 1.

    The four neighbours are gathered with all channels at once: onnxruntime's GridSample takes several times as long.
    """
    build = conversion.builder
    _, height, width, channels = conversion.shape(source)
    corner = build.node("Min", [build.node("Floor", [position]), build.floats([[[width - 2], [height - 2]]])])
    part = build.node("Sub", [position, corner])
    weights = inside
    for axis, factors in ((0, [-1, 1, -1, 1]), (1, [-1, -1, 1, 1])):
        along = build.node("Gather", [part, build.integers([axis])], axis=1)  # N, 1, P
        factor = build.floats(np.reshape(factors, (1, 4, 1)))
        rest = build.floats(np.reshape(factors, (1, 4, 1)) < 0)
        weights = build.node("Mul", [weights, build.node("Add", [build.node("Mul", [along, factor]), rest])])
    first = build.node("MatMul", [build.floats([[[1, width]]]), corner])
    index = build.node("Add", [first, build.floats([[[0], [1], [width], [width + 1]]])])  # N, 4, P
    index = build.reshape(build.node("Cast", [index], to=7), [0, -1, 1])
    pixels = build.reshape(conversion.natural(source), [0, height * width, channels])
    neighbours = build.node("GatherND", [pixels, index], batch_dims=1)  # N, 4 * P, C
    weighted = build.node("Mul", [neighbours, build.reshape(weights, [0, -1, 1])])
    return build.node("ReduceSum", [build.reshape(weighted, [0, 4, -1]), build.integers([1])], keepdims=0)


def _transform_landmarks(conversion: "TfliteConversion", operator: Operator) -> str:
    """Points (N, L, 2) and matrix (N, 4, 4) -> points mapped by the matrix."""
    build = conversion.builder
    if conversion.shape(operator.outputs[0])[-1] != 2:
        raise ConversionError(
            "model %s: operator TransformLandmarks on points that are not 2D is not known to the "
            "TFLite converter" % conversion.model_name
        )
    matrix = conversion.value(operator.inputs[1])
    axes = build.integers([1, 2])
    linear = build.node("Slice", [matrix, build.integers([0, 0]), build.integers([2, 2]), axes])
    shift = build.node("Slice", [matrix, build.integers([0, 3]), build.integers([2, 4]), axes])
    turned = build.node(
        "MatMul", [conversion.value(operator.inputs[0]), build.node("Transpose", [linear], perm=[0, 2, 1])]
    )
    return build.node("Add", [turned, build.node("Transpose", [shift], perm=[0, 2, 1])])


CUSTOM_OPERATORS: Dict[str, "OperatorConverter"] = {
    "Landmarks2TransformMatrix": _landmarks_to_transform_matrix,
    "TransformTensorBilinear": _transform_tensor_bilinear,
    "TransformLandmarks": _transform_landmarks,
}
