"""Raw and compressed image data to BGR arrays, without cv_bridge."""

from __future__ import annotations

from typing import Callable, Dict, NamedTuple, Optional, Tuple, Union

import cv2
import numpy as np

MAX_SIDE = 8192


class ImageError(ValueError):
    """Image data that cannot be read."""


class _Layout(NamedTuple):
    channels: int           # numbers per pixel
    depth: type             # type of one number
    convert: Callable[[np.ndarray], np.ndarray]


def _colour(code: int) -> Callable[[np.ndarray], np.ndarray]:
    return lambda pixels: cv2.cvtColor(pixels, code)


def _high_byte(pixels: np.ndarray) -> np.ndarray:
    return cv2.cvtColor((pixels >> 8).astype(np.uint8), cv2.COLOR_GRAY2BGR)


_MONO = _Layout(1, np.uint8, _colour(cv2.COLOR_GRAY2BGR))
_BGR = _Layout(3, np.uint8, np.array)
_MONO16 = _Layout(1, np.uint16, _high_byte)

# OpenCV names a Bayer pattern by the second row and column, ROS by the first.
_LAYOUTS: Dict[str, _Layout] = {
    "bgr8": _BGR,
    "rgb8": _Layout(3, np.uint8, _colour(cv2.COLOR_RGB2BGR)),
    "bgra8": _Layout(4, np.uint8, _colour(cv2.COLOR_BGRA2BGR)),
    "rgba8": _Layout(4, np.uint8, _colour(cv2.COLOR_RGBA2BGR)),
    "mono8": _MONO,
    "8UC1": _MONO,
    "8UC3": _BGR,
    "mono16": _MONO16,
    "16UC1": _MONO16,
    "yuv422": _Layout(2, np.uint8, _colour(cv2.COLOR_YUV2BGR_UYVY)),
    "yuv422_yuy2": _Layout(2, np.uint8, _colour(cv2.COLOR_YUV2BGR_YUY2)),
    "bayer_rggb8": _Layout(1, np.uint8, _colour(cv2.COLOR_BayerBG2BGR)),
    "bayer_bggr8": _Layout(1, np.uint8, _colour(cv2.COLOR_BayerRG2BGR)),
    "bayer_gbrg8": _Layout(1, np.uint8, _colour(cv2.COLOR_BayerGR2BGR)),
    "bayer_grbg8": _Layout(1, np.uint8, _colour(cv2.COLOR_BayerGB2BGR)),
}

ENCODINGS: Tuple[str, ...] = tuple(_LAYOUTS)


def bgr_from_raw(
    data: Union[bytes, bytearray, memoryview, np.ndarray],
    width: int,
    height: int,
    step: int,
    encoding: str,
    is_bigendian: bool = False,
) -> np.ndarray:
    """Return (height, width, 3) uint8 BGR, a copy, of the fields of a sensor_msgs/Image.

    step is the length of a row in bytes, padding included. Of 16 bits the upper 8 are used.
    Raises ImageError for an unknown encoding, a size of zero or more than MAX_SIDE px, a step or data too short.
    """
    layout = _LAYOUTS.get(encoding)
    if layout is None:
        raise ImageError("encoding {!r} is not supported; publish one of: {}".format(
            encoding[:40], ", ".join(ENCODINGS)))
    _check_size(width, height)
    if layout.channels == 2 and width % 2:
        raise ImageError("an image in {} needs an even width, not {}".format(encoding, width))
    if encoding.startswith("bayer") and (width < 2 or height < 2):
        raise ImageError("an image in {} needs 2x2 px at least, not {}x{}".format(encoding, width, height))
    pixels = raw_rows(data, width, height, step, layout.channels * np.dtype(layout.depth).itemsize, encoding)
    if layout.depth is np.uint16:
        pixels = pixels.view(">u2" if is_bigendian else "<u2").astype(np.uint16)
    shape = (height, width) if layout.channels == 1 else (height, width, layout.channels)
    return layout.convert(pixels.reshape(shape))


def raw_rows(data: Union[bytes, bytearray, memoryview, np.ndarray], width: int, height: int, step: int, pixel: int,
             encoding: str) -> np.ndarray:
    """Return the bytes (height, width * pixel) of an image without the padding of its rows, a copy if there is any.

    step: length of a row in `data`, bytes; pixel: length of a pixel, bytes; encoding: for the text of the error.
    Raises ImageError for a step or data too short.
    """
    row = width * pixel
    if step < row:
        raise ImageError("step is {} bytes, but a row of {} px in {} takes {}".format(step, width, encoding, row))
    values = np.frombuffer(data, dtype=np.uint8)
    if values.size < step * (height - 1) + row:
        raise ImageError("{} bytes of data are too short for {}x{} {} with step {}".format(
            values.size, width, height, encoding, step))
    return np.ascontiguousarray(np.lib.stride_tricks.as_strided(values, (height, row), (step, 1), writeable=False))


def bgr_from_compressed(data: Union[bytes, bytearray, memoryview]) -> np.ndarray:
    """Return (H, W, 3) uint8 BGR of JPEG or PNG data.

    Raises ImageError for other or damaged data, or an image beyond MAX_SIDE px (before it is decoded).
    """
    values = np.frombuffer(data, dtype=np.uint8)
    if values.size == 0:
        raise ImageError("the compressed image is empty")
    size = _png_size(bytes(values[:24])) or _jpeg_size(values)
    if size is None:
        raise ImageError("the compressed image ({} bytes) is not JPEG or PNG, or is damaged".format(values.size))
    _check_size(*size)
    try:
        image = cv2.imdecode(values, cv2.IMREAD_COLOR)
    except cv2.error as error:
        raise ImageError("the compressed image cannot be decoded: {}".format(error)) from error
    if image is None:
        raise ImageError("the compressed image ({} bytes) is damaged".format(values.size))
    return image


def _png_size(start: bytes) -> Optional[Tuple[int, int]]:
    """Width and height that the first 24 bytes of a PNG file tell (its IHDR chunk), else None."""
    if len(start) < 24 or not start.startswith(b"\x89PNG\r\n\x1a\n"):
        return None
    return int.from_bytes(start[16:20], "big"), int.from_bytes(start[20:24], "big")


def _jpeg_size(values: np.ndarray) -> Optional[Tuple[int, int]]:
    """Width and height in the frame header (SOF marker) of a JPEG file, else None."""
    data = memoryview(np.ascontiguousarray(values))
    if bytes(data[:2]) != b"\xff\xd8":
        return None
    position = 2
    while position + 9 <= len(data) and data[position] == 0xFF:
        marker = data[position + 1]
        # C0 to CF start a frame, but for three that hold tables.
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height, width = bytes(data[position + 5:position + 7]), bytes(data[position + 7:position + 9])
            return int.from_bytes(width, "big"), int.from_bytes(height, "big")
        if marker == 0xFF:      # fill byte
            position += 1
        elif marker == 0x01 or 0xD0 <= marker <= 0xD8:      # no contents
            position += 2
        else:
            position += 2 + int.from_bytes(bytes(data[position + 2:position + 4]), "big")
    return None


def _check_size(width: int, height: int) -> None:
    if width < 1 or height < 1:
        raise ImageError("image size is {}x{}: there is nothing in it".format(width, height))
    if width > MAX_SIDE or height > MAX_SIDE:
        raise ImageError("image size {}x{} is beyond the limit of {} px a side".format(width, height, MAX_SIDE))
