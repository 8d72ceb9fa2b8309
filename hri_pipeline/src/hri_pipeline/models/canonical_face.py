"""The canonical 468-point face model out of the assets of @mediapipe/face_mesh.

The package packs several files into one; the index of that pack stands as JSON in the loader script beside
it. The model itself is a protobuf message (FaceGeometry "pipeline metadata"): field 1 a mesh whose vertices
are x, y, z, u, v in centimetres, field 2 the landmarks of the Procrustes basis with their weights.
"""

from __future__ import annotations

import io
import json
import re
import struct
from typing import Iterator, List, Tuple, Union

import numpy as np

from hri_pipeline.models.catalogue import ConversionError

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
