"""Reading a TFLite file into plain Python objects, with packed constants unpacked.

The format is the public flatbuffer schema of TensorFlow Lite.  Needs the packages tflite and flatbuffers.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple

import numpy as np

from hri_pipeline.models.catalogue import ConversionError, FetchError

_DTYPES = {0: np.float32, 1: np.float16, 2: np.int32, 3: np.uint8, 4: np.int64, 6: np.bool_, 9: np.int8}

# Operator -> (class of its options in the schema, the fields that are used).
_OPTIONS: Dict[str, Tuple[str, Tuple[str, ...]]] = {
    "CONV_2D": (
        "Conv2DOptions",
        ("Padding", "StrideH", "StrideW", "DilationHFactor", "DilationWFactor", "FusedActivationFunction"),
    ),
    "DEPTHWISE_CONV_2D": (
        "DepthwiseConv2DOptions",
        ("Padding", "StrideH", "StrideW", "DilationHFactor", "DilationWFactor", "FusedActivationFunction"),
    ),
    "MAX_POOL_2D": (
        "Pool2DOptions",
        ("Padding", "StrideH", "StrideW", "FilterHeight", "FilterWidth", "FusedActivationFunction"),
    ),
    "AVERAGE_POOL_2D": (
        "Pool2DOptions",
        ("Padding", "StrideH", "StrideW", "FilterHeight", "FilterWidth", "FusedActivationFunction"),
    ),
    "ADD": ("AddOptions", ("FusedActivationFunction",)),
    "MUL": ("MulOptions", ("FusedActivationFunction",)),
    "SUB": ("SubOptions", ("FusedActivationFunction",)),
    "DIV": ("DivOptions", ("FusedActivationFunction",)),
    "RESIZE_BILINEAR": ("ResizeBilinearOptions", ("AlignCorners", "HalfPixelCenters")),
    "DEPTH_TO_SPACE": ("DepthToSpaceOptions", ("BlockSize",)),
    "CONCATENATION": ("ConcatenationOptions", ("Axis", "FusedActivationFunction")),
    "MEAN": ("ReducerOptions", ("KeepDims",)),
    "SUM": ("ReducerOptions", ("KeepDims",)),
    "FULLY_CONNECTED": ("FullyConnectedOptions", ("FusedActivationFunction",)),
    "STRIDED_SLICE": (
        "StridedSliceOptions",
        ("BeginMask", "EndMask", "EllipsisMask", "NewAxisMask", "ShrinkAxisMask"),
    ),
}


@dataclass
class Tensor:
    """A tensor: its TFLite shape (N x H x W x C for images) and, for constants, its values."""

    name: str
    shape: List[int]
    data: Optional[np.ndarray] = None


@dataclass
class Operator:
    """One operator: `kind` as in the schema (or the name of a custom operator), tensors by index."""

    kind: str
    inputs: List[int]
    outputs: List[int]
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass
class TfliteGraph:
    """The only subgraph of a model, in order of execution."""

    tensors: List[Tensor]
    operators: List[Operator]
    inputs: List[int]
    outputs: List[int]

    def constant(self, index: int) -> Optional[np.ndarray]:
        """The values of a constant tensor, None for one that is computed."""
        return self.tensors[index].data


def read_tflite(content: bytes, model_name: str) -> TfliteGraph:
    """Read a TFLite model.

    ConversionError when it is no TFLite file or has a data type that is not known; FetchError when the
    package tflite is not installed.
    """
    schema = _import_tflite()
    if content[4:8] != b"TFL3":
        raise ConversionError("model %s: the source is not a TFLite file" % model_name)
    model = schema.Model.GetRootAsModel(content, 0)
    source = model.Subgraphs(0)
    tensors: List[Tensor] = []
    sparse: Dict[int, Any] = {}
    for index in range(source.TensorsLength()):
        tensors.append(_read_tensor(model, source.Tensors(index), model_name))
        if source.Tensors(index).Sparsity() is not None:
            sparse[index] = source.Tensors(index).Sparsity()
    operators = [
        _read_operator(schema, model, source.Operators(index)) for index in range(source.OperatorsLength())
    ]
    inputs = [int(i) for i in source.InputsAsNumpy()]
    outputs = [int(i) for i in source.OutputsAsNumpy()]
    remaining = _fold_constants(tensors, operators, sparse)
    return TfliteGraph(tensors, fold_prelus(tensors, remaining), inputs, outputs)


def _import_tflite() -> Any:
    try:
        import flatbuffers  # noqa: F401  (tflite cannot work without it)
        import tflite
    except ImportError as error:
        raise FetchError(
            "converting TFLite models needs the Python packages tflite and flatbuffers (%s); "
            "install them: python3 -m pip install onnx tflite flatbuffers" % error
        ) from error
    return tflite


def _read_tensor(model: Any, tensor: Any, model_name: str) -> Tensor:
    name = tensor.Name().decode()
    shape = [int(size) for size in tensor.ShapeAsNumpy()] if tensor.ShapeLength() else []
    buffer = model.Buffers(tensor.Buffer())
    if not buffer.DataLength():
        return Tensor(name, shape)
    if tensor.Type() not in _DTYPES:
        raise ConversionError(
            "model %s: constant %s has data type number %d, which the converter does not know"
            % (model_name, name, tensor.Type())
        )
    data = np.frombuffer(buffer.DataAsNumpy().tobytes(), _DTYPES[tensor.Type()])
    if tensor.Sparsity() is None:
        data = data.reshape(shape)
    return Tensor(name, shape, data)


def _read_operator(schema: Any, model: Any, operator: Any) -> Operator:
    code = model.OperatorCodes(operator.OpcodeIndex())
    number = max(code.BuiltinCode(), code.DeprecatedBuiltinCode())
    names = {value: name for name, value in vars(schema.BuiltinOperator).items() if isinstance(value, int)}
    kind = names.get(number, "number %d" % number)
    options: Mapping[str, Any] = {}
    if kind == "CUSTOM":
        kind = code.CustomCode().decode()
        options = _custom_options(operator)
    elif kind in _OPTIONS and operator.BuiltinOptions() is not None:
        class_name, fields = _OPTIONS[kind]
        reader = getattr(schema, class_name)()
        table = operator.BuiltinOptions()
        reader.Init(table.Bytes, table.Pos)
        options = {name: getattr(reader, name)() for name in fields}
    return Operator(
        kind, [int(i) for i in operator.InputsAsNumpy()], [int(i) for i in operator.OutputsAsNumpy()], options
    )


def _custom_options(operator: Any) -> Mapping[str, Any]:
    """Options of a custom operator: a flexbuffer map, or the raw bytes under the key "raw"."""
    from flatbuffers import flexbuffers

    if not operator.CustomOptionsLength():
        return {}
    raw = operator.CustomOptionsAsNumpy().tobytes()
    try:
        options = flexbuffers.Loads(raw)
    except Exception:  # noqa: BLE001  (a plain C struct leads flexbuffers to any kind of error)
        options = None
    return options if isinstance(options, dict) else {"raw": raw}


def _fold_constants(
    tensors: List[Tensor], operators: List[Operator], sparse: Mapping[int, Any]
) -> List[Operator]:
    """Carry out DENSIFY and DEQUANTIZE on constants; returns the operators that remain."""
    remaining = []
    for operator in operators:
        source = tensors[operator.inputs[0]] if operator.inputs and operator.inputs[0] >= 0 else None
        if source is None or source.data is None or operator.kind not in ("DENSIFY", "DEQUANTIZE"):
            remaining.append(operator)
            continue
        target = tensors[operator.outputs[0]]
        if operator.kind == "DENSIFY":
            target.data = _densify(source, sparse[operator.inputs[0]])
        elif source.data.dtype == np.float16:
            target.data = source.data.astype(np.float32)
        else:
            remaining.append(operator)  # an integer constant with scale: reported as an unknown operator
    return remaining


def fold_prelus(tensors: List[Tensor], operators: Sequence[Operator]) -> List[Operator]:
    """Replace relu(x) + a (x - |x|), as older exporters write a leaky activation, by PRELU with the slope 2 a.

    The constants of the new slopes are added to `tensors`; the operators whose results are then unused stay, and are
    dropped where only what the outputs need is converted.
    """
    made_by = {operator.outputs[0]: operator for operator in operators if operator.outputs}
    folded = []
    for operator in operators:
        found = _leaky_part(operator, made_by, tensors) if operator.kind == "ADD" else None
        if found is None:
            folded.append(operator)
            continue
        source, factor = found
        data = tensors[factor].data
        assert data is not None
        tensors.append(Tensor(tensors[factor].name + " doubled", tensors[factor].shape, 2.0 * data))
        folded.append(Operator("PRELU", [source, len(tensors) - 1], list(operator.outputs)))
    return folded


def _leaky_part(add: Operator, made_by: Mapping[int, Operator], tensors: Sequence[Tensor]) -> Optional[Tuple[int, int]]:
    """The indices of x and of the constant a where an addition is relu(x) + a (x - |x|), else None."""
    if add.options.get("FusedActivationFunction", 0):
        return None
    for first, second in (add.inputs, add.inputs[::-1]):
        relu, product = made_by.get(first), made_by.get(second)
        if relu is None or product is None or (relu.kind, product.kind) != ("RELU", "MUL"):
            continue
        constants = [index for index in product.inputs if tensors[index].data is not None]
        others = [made_by.get(index) for index in product.inputs if index not in constants]
        if len(constants) != 1 or len(others) != 1 or others[0] is None or others[0].kind != "SUB":
            continue
        source, negative = others[0].inputs
        magnitude = made_by.get(negative)
        is_plain = not any(one.options.get("FusedActivationFunction", 0) for one in (product, others[0]))
        if is_plain and magnitude is not None and magnitude.kind == "ABS":
            if magnitude.inputs == [source] == relu.inputs:
                return source, constants[0]
    return None


def _densify(tensor: Tensor, sparsity: Any) -> np.ndarray:
    order = [int(i) for i in sparsity.TraversalOrderAsNumpy()]
    blocks = [int(i) for i in sparsity.BlockMapAsNumpy()] if sparsity.BlockMapLength() else []
    dimensions = [_sparse_dimension(sparsity.DimMetadata(i)) for i in range(sparsity.DimMetadataLength())]
    assert tensor.data is not None
    return densify(tensor.data, tensor.shape, order, blocks, dimensions)


def _sparse_dimension(metadata: Any) -> SparseDimension:
    if metadata.Format() == 0:
        return SparseDimension(size=metadata.DenseSize())
    return SparseDimension(
        segments=_index_vector(metadata.ArraySegments(), metadata.ArraySegmentsType()),
        indices=_index_vector(metadata.ArrayIndices(), metadata.ArrayIndicesType()),
    )


def _index_vector(table: Any, kind: int) -> np.ndarray:
    from tflite.Int32Vector import Int32Vector
    from tflite.Uint8Vector import Uint8Vector
    from tflite.Uint16Vector import Uint16Vector

    vector = {1: Int32Vector, 2: Uint16Vector, 3: Uint8Vector}[kind]()
    vector.Init(table.Bytes, table.Pos)
    return np.asarray(vector.ValuesAsNumpy())


@dataclass
# -- sparse constants: a tree of dimensions in "traversal order", each dense or compressed (segments and indices), with
# optional inner blocks: the format of Kjolstad et al., "The Tensor Algebra Compiler" (2017), as in the TFLite schema
class SparseDimension:
    """One level of the tree: dense with `size` entries, or compressed with `segments` and `indices`."""

    size: int = 0
    segments: Optional[np.ndarray] = None
    indices: Optional[np.ndarray] = None


def densify(
    values: np.ndarray,
    shape: Sequence[int],
    order: Sequence[int],
    blocks: Sequence[int],
    dimensions: Sequence[SparseDimension],
) -> np.ndarray:
    """The dense array of `shape`.

    `values` are the stored entries (flat); `order` names, level by level, the dimension that a level walks
    through (numbers from len(shape) on are the inner dimensions of blocks); `blocks` gives for each inner
    dimension the outer one that it divides.
    """
    # Level by level: `parents` numbers the stored entries so far, `coordinates[k]` their position at level k.
    parents = np.zeros(1, np.int64)
    coordinates: List[np.ndarray] = []
    for dimension in dimensions:
        if dimension.segments is None or dimension.indices is None:
            repeats = np.full(len(parents), dimension.size)
            position = np.tile(np.arange(dimension.size), len(parents))
            children = np.repeat(parents * dimension.size, repeats) + position
        else:
            starts = dimension.segments.astype(np.int64)[parents]
            repeats = dimension.segments.astype(np.int64)[parents + 1] - starts
            offsets = np.arange(repeats.sum()) - np.repeat(np.cumsum(repeats) - repeats, repeats)
            children = np.repeat(starts, repeats) + offsets
            position = dimension.indices.astype(np.int64)[children]
        coordinates = [np.repeat(c, repeats) for c in coordinates] + [position]
        parents = children
    rank = len(shape)
    by_dimension = {dimension: coordinates[level] for level, dimension in enumerate(order)}
    index = [by_dimension[axis] for axis in range(rank)]
    for number, axis in enumerate(blocks):
        block_size = dimensions[list(order).index(rank + number)].size
        index[axis] = index[axis] * block_size + by_dimension[rank + number]
    dense = np.zeros(tuple(shape), values.dtype)
    dense[tuple(index)] = values[parents]
    return dense
