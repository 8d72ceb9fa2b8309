"""The network of speakers out of a checkpoint in the layout of PyTorch's first format, made here; no file is needed."""

from __future__ import annotations

import io
import pickle
import struct
import sys
import types
from typing import Any, Dict, Iterator, List, Tuple

import numpy as np
import pytest

pytest.importorskip("onnx")

import onnxruntime  # noqa: E402

from hri_pipeline.models import torch_to_onnx  # noqa: E402
from hri_pipeline.models.catalogue import ConversionError  # noqa: E402

INPUTS, HIDDEN, OUTPUTS = 5, 6, 4


class Storage:
    """What the pickle names by a persistent id."""

    def __init__(self, values: np.ndarray) -> None:
        self.values = values


class Tensor:
    def __init__(self, storage: Storage, offset: int, array: np.ndarray) -> None:
        self.parts = (storage, offset, array.shape, tuple(stride // 4 for stride in array.strides), False, {})

    def __reduce__(self) -> Tuple[Any, Tuple[Any, ...]]:
        return sys.modules["torch._utils"]._rebuild_tensor_v2, self.parts  # type: ignore[attr-defined]


@pytest.fixture(autouse=True)
def torch(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Modules that carry the names which a checkpoint has."""
    package, utilities = types.ModuleType("torch"), types.ModuleType("torch._utils")

    def rebuild(*_: object) -> None:
        raise AssertionError("the converter calls no function of the checkpoint")

    rebuild.__name__ = rebuild.__qualname__ = "_rebuild_tensor_v2"
    rebuild.__module__ = "torch._utils"
    utilities._rebuild_tensor_v2 = rebuild  # type: ignore[attr-defined]
    package.FloatStorage = type("FloatStorage", (), {"__module__": "torch"})  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "torch", package)
    monkeypatch.setitem(sys.modules, "torch._utils", utilities)
    yield


def checkpoint(weights: Dict[str, np.ndarray], **more: object) -> bytes:
    """All tensors lie in one storage, as those of an LSTM do."""
    storage = Storage(np.concatenate([np.zeros(3, "<f4")] + [array.ravel() for array in weights.values()]))
    offset, tensors = 3, {}
    for name, array in weights.items():
        tensors[name] = Tensor(storage, offset, array)
        offset += array.size

    class Pickler(pickle.Pickler):
        def persistent_id(self, value: object) -> Any:
            if isinstance(value, Storage):
                kind = sys.modules["torch"].FloatStorage  # type: ignore[attr-defined]
                return ("storage", kind, "12", "cpu", len(value.values), None)
            return None

    file = io.BytesIO()
    for value in (torch_to_onnx.MAGIC_NUMBER, torch_to_onnx.PROTOCOL, {"little_endian": True}):
        pickle.dump(value, file, 2)
    Pickler(file, 2).dump(dict({"model_state": tensors}, **more))
    pickle.dump(["12"], file, 2)
    return file.getvalue() + struct.pack("<q", len(storage.values)) + storage.values.astype("<f4").tobytes()


def weights_of(seed: int, layers: int = 2) -> Dict[str, np.ndarray]:
    random = np.random.default_rng(seed)
    found: Dict[str, np.ndarray] = {}
    for layer in range(layers):
        for name, shape in (("weight_ih", (4 * HIDDEN, HIDDEN if layer else INPUTS)),
                            ("weight_hh", (4 * HIDDEN, HIDDEN)), ("bias_ih", (4 * HIDDEN,)),
                            ("bias_hh", (4 * HIDDEN,))):
            found["lstm.{}_l{}".format(name, layer)] = random.normal(0.0, 0.6, shape).astype(np.float32)
    found["linear.weight"] = random.normal(0.0, 0.6, (OUTPUTS, HIDDEN)).astype(np.float32)
    found["linear.bias"] = np.full(OUTPUTS, 0.5, np.float32)
    return found


def reference(weights: Dict[str, np.ndarray], sound: np.ndarray) -> np.ndarray:
    """The definition of torch.nn.LSTM (gates i, f, g, o), a linear layer, ReLU and the length 1. sound: (T, I)."""
    def sigmoid(value: np.ndarray) -> np.ndarray:
        return 1.0 / (1.0 + np.exp(-value))

    steps: List[np.ndarray] = list(sound.astype(np.float64))
    for layer in range(2):
        state, cell = np.zeros(HIDDEN), np.zeros(HIDDEN)
        for index, value in enumerate(steps):
            total = (weights["lstm.weight_ih_l%d" % layer] @ value + weights["lstm.bias_ih_l%d" % layer]
                     + weights["lstm.weight_hh_l%d" % layer] @ state + weights["lstm.bias_hh_l%d" % layer])
            inlet, forget, new, outlet = np.split(total, 4)
            cell = sigmoid(forget) * cell + sigmoid(inlet) * np.tanh(new)
            state = sigmoid(outlet) * np.tanh(cell)
            steps[index] = state
    raw = np.maximum(0.0, weights["linear.weight"] @ steps[-1] + weights["linear.bias"])
    return np.asarray(raw / np.linalg.norm(raw))


def run(content: bytes, sounds: np.ndarray) -> np.ndarray:
    model = torch_to_onnx.convert_speaker_network(content, "speaker_embedding")
    session = onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
    return np.asarray(session.run(["embedding"], {"mel": sounds})[0])


def test_the_network_is_what_the_definition_says() -> None:
    weights = weights_of(1)
    sounds = np.random.default_rng(2).normal(0.0, 1.0, (3, 17, INPUTS)).astype(np.float32)
    found = run(checkpoint(weights), sounds)
    assert found.shape == (3, OUTPUTS)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, atol=1e-5)
    np.testing.assert_allclose(found, [reference(weights, sound) for sound in sounds], atol=2e-6)


def test_the_tensors_are_views_of_their_storage() -> None:
    weights = weights_of(3)
    found = torch_to_onnx.read_checkpoint(checkpoint(weights), "model_state")
    assert list(found) == list(weights)
    for name, array in weights.items():
        np.testing.assert_array_equal(found[name], array)


CALLED: List[str] = []


def note(text: str) -> None:
    CALLED.append(text)


class Evil:
    def __reduce__(self) -> Tuple[Any, Tuple[str]]:
        return note, ("called",)


def test_a_function_in_a_checkpoint_is_not_called() -> None:
    with pytest.raises(ConversionError, match="not allowed"):
        torch_to_onnx.read_checkpoint(checkpoint(weights_of(1), step=Evil()), "model_state")
    assert not CALLED
    assert pickle.loads(pickle.dumps(Evil())) is None and CALLED == ["called"]     # else it is


@pytest.mark.parametrize("cut", (10, 400, 100000), ids=("head", "pickle", "storage"))
def test_a_damaged_checkpoint_is_refused(cut: int) -> None:
    content = checkpoint(weights_of(1))
    with pytest.raises(ConversionError):
        torch_to_onnx.read_checkpoint(content[:min(cut, len(content) - 100)], "model_state")


def test_a_checkpoint_without_a_layer_is_refused() -> None:
    weights = weights_of(1)
    del weights["linear.bias"]
    with pytest.raises(ConversionError, match="linear.bias"):
        torch_to_onnx.convert_speaker_network(checkpoint(weights), "speaker_embedding")
