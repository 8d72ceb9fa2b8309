"""Turn the memory-mapped framebuffer of Xvfb (option -fbdir) into a PNG file.

The file has the X Window Dump format, version 7: a header of 25 big-endian 32-bit words, the window
name, the colour table (12 bytes an entry), then the rows. No X client tools are needed.
"""

from __future__ import annotations

import struct
import sys
from pathlib import Path
from typing import List

import cv2
import numpy as np

_WORDS = 25
_COLOUR_ENTRY_BYTES = 12


def _channel(pixels: np.ndarray, mask: int) -> np.ndarray:
    """One 8-bit colour channel out of packed 32-bit pixels."""
    if mask == 0:
        raise ValueError("the framebuffer has no colour mask (not a true-colour screen)")
    shift = (mask & -mask).bit_length() - 1
    return ((pixels & np.uint32(mask)) >> np.uint32(shift)).astype(np.uint8)


def read_framebuffer(data: bytes) -> np.ndarray:
    """Decode an X Window Dump of a true-colour screen with 32 bits per pixel.

    Returns the (height, width, 3) uint8 picture in BGR order. Raises ValueError for anything else.
    """
    if len(data) < 4 * _WORDS:
        raise ValueError("too short for an X window dump: %d bytes" % len(data))
    header = struct.unpack(">%dI" % _WORDS, data[: 4 * _WORDS])
    header_size, version, width, height = header[0], header[1], header[4], header[5]
    least_first, bits, row_bytes, colours = header[7] == 0, header[11], header[12], header[19]
    if version != 7 or bits != 32 or row_bytes < 4 * width:
        raise ValueError("not a version 7 window dump with 32 bits per pixel")
    start = header_size + colours * _COLOUR_ENTRY_BYTES
    if len(data) < start + height * row_bytes:
        raise ValueError("the window dump is cut off")
    rows = np.frombuffer(data, np.uint8, height * row_bytes, start).reshape(height, row_bytes)
    packed = np.ascontiguousarray(rows[:, : 4 * width]).view("<u4" if least_first else ">u4").astype(np.uint32)
    red, green, blue = (_channel(packed, header[i]) for i in (14, 15, 16))
    return np.dstack([blue, green, red])


def is_blank(picture: np.ndarray) -> bool:
    """True when (nearly) everything has one colour, as before a window is drawn."""
    return float(picture.reshape(-1, 3).std(axis=0).max()) < 5.0


def take(framebuffer: Path) -> bytes:
    """The screen as PNG. Raises OSError and ValueError where there is nothing to show."""
    picture = read_framebuffer(framebuffer.read_bytes())
    if is_blank(picture):
        raise ValueError("the screen is blank: rviz has not drawn anything")
    encoded, png = cv2.imencode(".png", picture)
    if not encoded:
        raise ValueError("the picture could not be encoded")
    return bytes(png.tobytes())


def main(arguments: List[str]) -> int:
    """Command line: FRAMEBUFFER PNG. Exit code 1 with one line when there is nothing to show."""
    if len(arguments) != 2:
        print(main.__doc__, file=sys.stderr)
        return 2
    try:
        Path(arguments[1]).write_bytes(take(Path(arguments[0])))
    except (OSError, ValueError) as error:
        print("no screenshot: %s" % error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
