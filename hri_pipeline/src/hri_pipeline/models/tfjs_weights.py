"""Reading weight files of TensorFlow.js: a JSON manifest and binary shards, optionally quantised."""

from __future__ import annotations

from typing import Any, Callable, Dict, Mapping, Sequence

import numpy as np

from hri_pipeline.models.errors import ConversionError

_STORED = {"float32": "<f4", "int32": "<i4", "bool": "u1", "float16": "<f2", "uint8": "u1", "uint16": "<u2"}


def read_weights(
    manifest: Sequence[Mapping[str, Any]], read_shard: Callable[[str], bytes], model_name: str
) -> Dict[str, np.ndarray]:
    """Weights by name: float32, or int64 for integers.

    `manifest` is the list of weight groups; `read_shard` gives the bytes of a shard by its path.
    ConversionError when a data type is unknown or the shards have the wrong length.
    """
    weights: Dict[str, np.ndarray] = {}
    for group in manifest:
        raw = b"".join(read_shard(path) for path in group["paths"])
        position = 0
        for entry in group["weights"]:
            stored, count = _stored_type(entry, model_name), int(np.prod(entry["shape"], dtype=np.int64))
            end = position + count * stored.itemsize
            if end > len(raw):
                raise ConversionError(
                    "model %s: the weight file is too short for %s" % (model_name, entry["name"])
                )
            values = np.frombuffer(raw, stored, count, position).reshape(entry["shape"])
            weights[entry["name"]] = _restore(values, entry)
            position = end
        if position != len(raw):
            raise ConversionError(
                "model %s: the weight file is %d bytes longer than its manifest says"
                % (model_name, len(raw) - position)
            )
    return weights


def _stored_type(entry: Mapping[str, Any], model_name: str) -> np.dtype:
    name = entry["quantization"]["dtype"] if entry.get("quantization") else entry["dtype"]
    if name not in _STORED:
        raise ConversionError(
            "model %s: weight %s has the data type %s, which is not known" % (model_name, entry["name"], name)
        )
    return np.dtype(_STORED[name])


def _restore(values: np.ndarray, entry: Mapping[str, Any]) -> np.ndarray:
    quantization = entry.get("quantization")
    if quantization and quantization["dtype"] != "float16":
        return values.astype(np.float32) * np.float32(quantization["scale"]) + np.float32(quantization["min"])
    return values.astype(np.float32 if entry["dtype"] == "float32" else np.int64)
