"""The reader of window dumps, on dumps made here."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
import screenshot


def _dump(picture: np.ndarray, least_first: bool, padding: int = 8) -> bytes:
    height, width = picture.shape[:2]
    blue, green, red = (picture[:, :, i].astype(np.uint32) for i in range(3))
    packed = (red << 16 | green << 8 | blue).astype("<u4" if least_first else ">u4")
    rows = b"".join(row.tobytes() + bytes(padding) for row in packed)
    header = [0] * 25
    header[0], header[1], header[4], header[5] = 104, 7, width, height
    header[7], header[11], header[12] = (0 if least_first else 1), 32, 4 * width + padding
    header[14], header[15], header[16], header[19] = 0xFF0000, 0xFF00, 0xFF, 3
    return struct.pack(">25I", *header) + b"Xv\0\0" + bytes(3 * 12) + rows


@pytest.mark.parametrize("least_first", [True, False])
def test_picture_comes_back(least_first: bool, tmp_path: Path) -> None:
    picture = np.random.default_rng(1).integers(0, 256, (5, 7, 3)).astype(np.uint8)
    (tmp_path / "fb").write_bytes(_dump(picture, least_first))
    assert np.array_equal(screenshot.read_framebuffer((tmp_path / "fb").read_bytes()), picture)
    assert screenshot.main([str(tmp_path / "fb"), str(tmp_path / "out.png")]) == 0
    assert np.array_equal(cv2.imread(str(tmp_path / "out.png")), picture)


def test_blank_screen_gives_no_picture(tmp_path: Path) -> None:
    (tmp_path / "fb").write_bytes(_dump(np.zeros((4, 4, 3), np.uint8), True))
    assert screenshot.main([str(tmp_path / "fb"), str(tmp_path / "out.png")]) == 1
    assert not (tmp_path / "out.png").exists()


@pytest.mark.parametrize("data", [b"", b"x" * 200, _dump(np.zeros((4, 4, 3), np.uint8), True)[:-1]])
def test_other_data_is_refused(data: bytes) -> None:
    with pytest.raises(ValueError):
        screenshot.read_framebuffer(data)
