"""A small builder of ONNX graphs (opset 17, IR version 8), shared by the converters.

Images are N x H x W x C at the border of a converted model and N x C x H x W inside it.
"""

from __future__ import annotations

from typing import Any, Dict, List, Optional, Sequence, Tuple, Union

import numpy as np

from hri_pipeline.models.catalogue import ConversionError, FetchError

OPSET = 17
IR_VERSION = 8
Dimension = Union[int, str]


def import_onnx() -> Any:
    """The onnx package, needed only for converting.  FetchError when it is not installed."""
    try:
        import onnx
    except ImportError as error:
        raise FetchError(
            "converting models needs the Python package onnx (%s); "
            "install it: python3 -m pip install onnx tflite flatbuffers" % error
        ) from error
    return onnx


class GraphBuilder:
    """Collects nodes, constants, inputs and outputs, and makes a checked ONNX model of them."""

    def __init__(self, model_name: str) -> None:
        self.model_name = model_name
        self._onnx = import_onnx()
        self._nodes: List[Any] = []
        self._constants: Dict[Tuple[str, Tuple[int, ...], bytes], Any] = {}
        self._inputs: List[Any] = []
        self._outputs: List[Any] = []
        self._values = 0

    def input(self, name: str, shape: Sequence[Dimension]) -> str:
        """Declare a float input of the model; returns its name."""
        self._inputs.append(self._value_info(name, shape))
        return name

    def output(self, name: str, value: str, shape: Sequence[Dimension]) -> None:
        """Declare a float output of the model, fed by `value`."""
        self.node("Identity", [value], name)
        self._outputs.append(self._value_info(name, shape))

    def node(
        self, op_type: str, inputs: Sequence[str], output: Optional[str] = None, **attributes: Any
    ) -> str:
        """Add one operator with a single output; returns the name of the output."""
        if output is None:
            self._values += 1
            output = "value_%d" % self._values
        name = "node_%d_%s" % (len(self._nodes), op_type)
        self._nodes.append(
            self._onnx.helper.make_node(op_type, list(inputs), [output], name=name, **attributes)
        )
        return output

    def constant(self, array: Any, dtype: Any = None) -> str:
        """Add a constant (equal ones are stored once); returns its name."""
        array = np.asarray(array, dtype=dtype)
        array = np.ascontiguousarray(array).reshape(array.shape)  # ascontiguousarray alone lifts rank 0 to 1
        key = (array.dtype.str, array.shape, array.tobytes())
        if key not in self._constants:
            name = "constant_%d" % len(self._constants)
            self._constants[key] = self._onnx.numpy_helper.from_array(array, name)
        return self._constants[key].name

    def floats(self, values: Any) -> str:
        """A float32 constant."""
        return self.constant(values, np.float32)

    def integers(self, values: Any) -> str:
        """An int64 constant (shapes, axes, indices)."""
        return self.constant(values, np.int64)

    def to_channels_first(self, value: str) -> str:
        """N x H x W x C -> N x C x H x W."""
        return self.node("Transpose", [value], perm=[0, 3, 1, 2])

    def to_channels_last(self, value: str) -> str:
        """N x C x H x W -> N x H x W x C."""
        return self.node("Transpose", [value], perm=[0, 2, 3, 1])

    def reshape(self, value: str, shape: Sequence[int]) -> str:
        """Reshape; 0 keeps a dimension, -1 infers one."""
        return self.node("Reshape", [value, self.integers(list(shape))])

    def clip(self, value: str, low: float, high: float) -> str:
        """Limit to low..high."""
        return self.node("Clip", [value, self.floats(low), self.floats(high)])

    def prelu(self, value: str, slope: np.ndarray) -> str:
        """PReLU with one slope per channel: slope (C,), value N x C x H x W.

        Written as x + (1 - slope) * relu(-x) with two depthwise 1 x 1 convolutions, into which onnxruntime fuses the
        activation and the sum: its own PRelu leaves the blocked memory layout of convolutions, which costs two to three
        times the run time.
        """
        def depthwise(source: str, factors: np.ndarray) -> str:
            weights = self.floats(factors.reshape(-1, 1, 1, 1))
            return self.node("Conv", [source, weights], group=slope.size, kernel_shape=[1, 1])

        negative = self.node("Relu", [depthwise(value, np.full(slope.size, -1.0))])
        return self.node("Add", [value, depthwise(negative, 1.0 - slope.astype(np.float32))])

    def build(self) -> Any:
        """The finished model, checked by onnx.  ConversionError when the graph is not valid."""
        helper, checker = self._onnx.helper, self._onnx.checker
        graph = helper.make_graph(
            self._nodes, self.model_name, self._inputs, self._outputs, list(self._constants.values())
        )
        model = helper.make_model(
            graph, opset_imports=[helper.make_opsetid("", OPSET)], producer_name="ros4hri"
        )
        model.ir_version = IR_VERSION
        try:
            checker.check_model(model)
        except checker.ValidationError as error:
            reason = str(error).strip().splitlines()[0]
            raise ConversionError(
                "model %s: the converted graph is not valid: %s" % (self.model_name, reason)
            ) from error
        return model

    def _value_info(self, name: str, shape: Sequence[Dimension]) -> Any:
        return self._onnx.helper.make_tensor_value_info(name, self._onnx.TensorProto.FLOAT, list(shape))
