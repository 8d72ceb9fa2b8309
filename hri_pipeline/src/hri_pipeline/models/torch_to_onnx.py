"""A checkpoint of PyTorch to ONNX, without PyTorch: the recurrent network of speakers' voices.

Layout of a checkpoint before PyTorch 1.6 (`torch.save`, legacy): three pickles (a magic number, the protocol, sizes of
types), the pickle of the object, whose tensors name storages, the pickle of the storages' names, then each storage as
its number of elements (int64) and these elements. A pickle can name any function: here all but the three that such a
file needs are refused, and those three are replaced.
"""

from __future__ import annotations

import io
import pickle
from collections import OrderedDict
from typing import Any, Dict, List, NamedTuple, Sequence, Tuple

import numpy as np

from hri_pipeline.models.catalogue import ConversionError
from hri_pipeline.models.onnx_graph import GraphBuilder

MAGIC_NUMBER = 0x1950A86A20F9469CFC6C
PROTOCOL = 1001
INPUT, OUTPUT = "mel", "embedding"
# The gates of an LSTM stand in the order i, f, g, o in PyTorch and i, o, f, g in ONNX.
_GATES = (0, 3, 1, 2)


class _Tensor(NamedTuple):
    """A view of a storage; offset and strides in elements."""

    storage: str
    offset: int
    shape: Tuple[int, ...]
    strides: Tuple[int, ...]


class _Unpickler(pickle.Unpickler):
    """Loads plain data and tensors of 32-bit floats; refuses everything else."""

    def find_class(self, module: str, name: str) -> Any:
        known = {("collections", "OrderedDict"): OrderedDict, ("torch._utils", "_rebuild_tensor_v2"): self._tensor,
                 ("torch", "FloatStorage"): "float"}
        if (module, name) not in known:
            raise pickle.UnpicklingError("{}.{} is not allowed".format(module, name))
        return known[module, name]

    def persistent_load(self, pid: Any) -> str:
        kind, element, key = pid[0], pid[1], pid[2]
        if kind != "storage" or element != "float" or (len(pid) > 5 and pid[5] is not None):
            raise pickle.UnpicklingError("a storage of {} is not known".format(element))
        return str(key)

    @staticmethod
    def _tensor(storage: str, offset: int, shape: Sequence[int], strides: Sequence[int], *_: object) -> _Tensor:
        return _Tensor(storage, int(offset), tuple(shape), tuple(strides))


def read_checkpoint(content: bytes, part: str) -> Dict[str, np.ndarray]:
    """Return the tensors (float32) of one part of a checkpoint, by name. ConversionError for other files."""
    file = io.BytesIO(content)
    try:
        if (_Unpickler(file).load(), _Unpickler(file).load()) != (MAGIC_NUMBER, PROTOCOL):
            raise ConversionError("it is no checkpoint of PyTorch's first format")
        sizes, found, keys = (_Unpickler(file).load() for _ in range(3))
        if not sizes["little_endian"]:
            raise ConversionError("its numbers are big-endian")
        storages = {str(key): _read_storage(file) for key in keys}
        return {name: _view(storages[tensor.storage], tensor) for name, tensor in found[part].items()
                if isinstance(tensor, _Tensor)}
    except ConversionError:
        raise
    except Exception as error:  # a damaged pickle may raise anything
        raise ConversionError("the checkpoint of PyTorch cannot be read: {!r}".format(error)) from error


def _read_storage(file: io.BytesIO) -> np.ndarray:
    count = int(np.frombuffer(file.read(8), "<i8")[0])
    return np.frombuffer(file.read(4 * count), "<f4", count)


def _view(storage: np.ndarray, tensor: _Tensor) -> np.ndarray:
    last = tensor.offset + sum((size - 1) * stride for size, stride in zip(tensor.shape, tensor.strides))
    if tensor.offset < 0 or min(tensor.shape + tensor.strides, default=0) < 0 or last >= len(storage):
        raise ConversionError("a tensor lies outside of its storage")
    view = np.lib.stride_tricks.as_strided(storage[tensor.offset:], tensor.shape,
                                           [4 * stride for stride in tensor.strides])
    return np.array(view, np.float32)


def convert_speaker_network(content: bytes, name: str) -> Any:
    """Return the ONNX model of a checkpoint with a part "model_state": stacked LSTMs, a linear layer on the last state
    of the last one, ReLU, and the length 1.

    Input: mel (N, T, I), any N and T. Output: embedding (N, E). ConversionError when the checkpoint has other layers.
    """
    tensors = read_checkpoint(content, "model_state")
    graph = GraphBuilder(name)
    try:
        layers = [[tensors["lstm.{}_l{}".format(kind, layer)] for kind in ("weight_ih", "weight_hh", "bias_ih",
                                                                           "bias_hh")]
                  for layer in range(sum(key.startswith("lstm.weight_ih_l") for key in tensors))]
        linear, bias = tensors["linear.weight"], tensors["linear.bias"]
    except KeyError as error:
        raise ConversionError("model {}: the checkpoint lacks {}".format(name, error)) from error
    if not layers:
        raise ConversionError("model {}: the checkpoint has no LSTM".format(name))
    value = graph.node("Transpose", [graph.input(INPUT, ["N", "T", int(layers[0][0].shape[1])])], perm=[1, 0, 2])
    for layer in layers:
        value = _lstm(graph, value, layer)
    last = graph.node("Gather", [value, graph.integers(-1)], axis=0)
    product = graph.node("Gemm", [last, graph.floats(linear), graph.floats(bias)], transB=1)
    positive = graph.node("Relu", [product])
    length = graph.node("ReduceL2", [positive], axes=[1], keepdims=1)
    unit = graph.node("Div", [positive, graph.node("Max", [length, graph.floats(1e-9)])])    # silence may give zeros
    graph.output(OUTPUT, unit, ["N", int(len(linear))])
    return graph.build()


def _lstm(graph: GraphBuilder, value: str, layer: List[np.ndarray]) -> str:
    """Add one LSTM; value: (T, N, I). Returns the name of its outputs (T, N, H)."""
    weight_ih, weight_hh, bias_ih, bias_hh = (_reordered(part) for part in layer)
    every = graph.node("LSTM", [value, graph.floats(weight_ih[None]), graph.floats(weight_hh[None]),
                                graph.floats(np.concatenate([bias_ih, bias_hh])[None])],
                       hidden_size=int(weight_hh.shape[1]))
    return graph.node("Squeeze", [every, graph.integers([1])])


def _reordered(part: np.ndarray) -> np.ndarray:
    gates = np.split(part, 4)
    return np.concatenate([gates[index] for index in _GATES])
