"""TFLite (float graphs, fp16 or sparse constants) to ONNX.

Operators are converted only as far as the wanted outputs need them.  The batch dimension becomes dynamic,
images stay N x H x W x C at the border.
"""

from __future__ import annotations

from typing import Any, Dict, List, Optional, Sequence

import numpy as np

from hri_pipeline.models.errors import ConversionError
from hri_pipeline.models.onnx_graph import GraphBuilder
from hri_pipeline.models.tflite_graph import Operator, TfliteGraph, read_tflite


class TfliteConversion:
    """The state of one conversion: what operators read from and write to.

    Values of rank 4 are held N x C x H x W; `natural` gives them in TFLite's order.
    """

    def __init__(self, graph: TfliteGraph, model_name: str) -> None:
        self.graph = graph
        self.model_name = model_name
        self.builder = GraphBuilder(model_name)
        self._values: Dict[int, str] = {}

    def shape(self, index: int) -> List[int]:
        """Shape in TFLite's order."""
        return self.graph.tensors[index].shape

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
        if rank == 4 and data.size > 1:
            data = data.reshape((1,) * (4 - data.ndim) + data.shape).transpose(0, 3, 1, 2)
        elif data.size == 1:
            data = data.reshape(-1)
        return self.builder.constant(data)

    def natural(self, index: int) -> str:
        """A computed tensor in TFLite's order (N x H x W x C when of rank 4)."""
        shape = self.shape(index)
        if len(shape) != 4:
            return self.value(index)
        if shape[1] * shape[2] == 1:
            return self.builder.reshape(self.value(index), [0] + shape[1:])
        return self.builder.to_channels_last(self.value(index))

    def from_natural(self, value: str, index: int) -> str:
        """A value in TFLite's order, laid out as tensor `index` is held."""
        return self.builder.to_channels_first(value) if len(self.shape(index)) == 4 else value


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
    from hri_pipeline.models.tflite_custom_operators import CUSTOM_OPERATORS
    from hri_pipeline.models.tflite_operators import OPERATORS

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
