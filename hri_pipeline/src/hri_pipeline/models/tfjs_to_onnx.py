"""TensorFlow.js graph models (model.json and .bin shards) to ONNX.

The graph is walked backwards from the wanted outputs, which may be inner nodes: what lies behind them is
cut off.
"""

from __future__ import annotations

import base64
import json
from dataclasses import dataclass
from typing import Any, Callable, Dict, List, Mapping, Optional, Tuple

import numpy as np

from hri_pipeline.models.errors import ConversionError
from hri_pipeline.models.onnx_graph import Dimension, GraphBuilder
from hri_pipeline.models.tfjs_weights import read_weights


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
    from hri_pipeline.models.tfjs_operators import OPERATORS

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
