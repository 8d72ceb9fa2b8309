"""MediaPipe's custom operators of the attention face mesh, in standard ONNX operators.

Their meaning is that of the public sources of MediaPipe (Apache-2.0), `util/tflite/operations`: a first mesh
gives, for each region (lips, eyes), a crop of a feature map; a small network refines the landmarks in the
crop; the result is mapped back.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Dict, Tuple

import numpy as np

from hri_pipeline.models.errors import ConversionError
from hri_pipeline.models.onnx_graph import GraphBuilder
from hri_pipeline.models.tflite_graph import Operator

if TYPE_CHECKING:
    from hri_pipeline.models.tflite_operators import OperatorConverter
    from hri_pipeline.models.tflite_to_onnx import TfliteConversion


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
    _, source_height, source_width, _ = conversion.shape(operator.inputs[0])
    _, height, width, _ = conversion.shape(operator.outputs[0])
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    centres = np.stack([x.ravel(), y.ravel(), np.zeros(x.size), np.ones(x.size)])  # 4, h * w
    matrix = build.node(
        "Slice",
        [conversion.value(operator.inputs[1]), build.integers([0]), build.integers([2]), build.integers([1])],
    )  # N, 2, 4
    position = build.node("Sub", [build.node("MatMul", [matrix, build.floats(centres)]), build.floats(0.5)])
    to_unit = build.floats([[[2 / (source_width - 1)], [2 / (source_height - 1)]]])
    unit = build.node("Sub", [build.node("Mul", [position, to_unit]), build.floats(1)])  # inside: -1..1
    farthest = build.node("ReduceMax", [build.node("Abs", [unit])], axes=[1], keepdims=1)
    inside = build.node("Cast", [build.node("LessOrEqual", [farthest, build.floats(1)])], to=1)
    grid = build.reshape(build.node("Transpose", [unit], perm=[0, 2, 1]), [0, height, width, 2])
    sampled = build.node(
        "GridSample",
        [conversion.value(operator.inputs[0]), grid],
        align_corners=1,
        mode="bilinear",
        padding_mode="border",
    )
    return build.node("Mul", [sampled, build.reshape(inside, [0, 1, height, width])])


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
