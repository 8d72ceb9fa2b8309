"""Image data of all encodings, and data that must be refused."""

import cv2
import numpy as np
import pytest

from hri_pipeline.core.images import ENCODINGS, ImageError, bgr_from_compressed, bgr_from_raw

BGR = np.random.default_rng(0).integers(0, 256, (6, 8, 3), dtype=np.uint8)
GREY = BGR[:, :, 0]
WIDE = GREY.astype(np.uint16) * 256 + 77


def padded(pixels, padding=5):
    rows = pixels.reshape(pixels.shape[0], -1)
    rows = rows.view(np.uint8).reshape(pixels.shape[0], -1)
    full = np.hstack([rows, np.full((rows.shape[0], padding), 200, np.uint8)])
    return full.tobytes(), full.shape[1]


@pytest.mark.parametrize("encoding, pixels, expected", [
    ("bgr8", BGR, BGR),
    ("8UC3", BGR, BGR),
    ("rgb8", BGR[:, :, ::-1], BGR),
    ("bgra8", np.dstack([BGR, GREY]), BGR),
    ("rgba8", np.dstack([BGR[:, :, ::-1], GREY]), BGR),
    ("mono8", GREY, np.dstack([GREY] * 3)),
    ("8UC1", GREY, np.dstack([GREY] * 3)),
    ("mono16", WIDE, np.dstack([GREY] * 3)),
    ("16UC1", WIDE, np.dstack([GREY] * 3)),
])
@pytest.mark.parametrize("padding", [0, 5])
def test_exact_encodings_with_and_without_padding(encoding, pixels, expected, padding):
    data, step = padded(np.ascontiguousarray(pixels), padding)
    result = bgr_from_raw(data, 8, 6, step, encoding)
    np.testing.assert_array_equal(result, expected)
    assert result.dtype == np.uint8
    result[:] = 0       # writable: nodes draw on it


def test_big_endian():
    data, step = padded(np.ascontiguousarray(WIDE.astype(">u2")))
    np.testing.assert_array_equal(bgr_from_raw(data, 8, 6, step, "mono16", True)[:, :, 0], GREY)


@pytest.mark.parametrize("encoding, order", [("yuv422", "uyvy"), ("yuv422_yuy2", "yuyv")])
def test_yuv_of_one_colour(encoding, order):
    y, u, v = 81, 90, 240        # red in BT.601
    values = {"y": y, "u": u, "v": v}
    data = bytes(values[letter] for letter in order) * 4 * 6
    result = bgr_from_raw(data, 8, 6, 16, encoding)
    np.testing.assert_allclose(result.reshape(-1, 3), [[0, 0, 255]] * 48, atol=3)


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_bayer_of_one_colour(pattern):
    values = dict(zip("bgr", (30, 120, 220)))
    tile = np.array([values[letter] for letter in pattern], np.uint8).reshape(2, 2)
    result = bgr_from_raw(np.tile(tile, (4, 4)).tobytes(), 8, 8, 8, "bayer_{}8".format(pattern))
    np.testing.assert_array_equal(result[2:-2, 2:-2].reshape(-1, 3), [[30, 120, 220]] * 16)


def test_every_encoding_is_read():
    for encoding in ENCODINGS:
        assert bgr_from_raw(bytes(8 * 6 * 4), 8, 6, 32, encoding).shape == (6, 8, 3)


@pytest.mark.parametrize("width, height, step, encoding, length, text", [
    (8, 6, 24, "32FC1", 999, "not supported; publish one of: bgr8"),
    (8, 6, 24, "", 999, "not supported"),
    (8, 6, 24, "x" * 5000, 999, "not supported"),
    (0, 6, 24, "bgr8", 999, "nothing in it"),
    (8, 0, 24, "bgr8", 999, "nothing in it"),
    (8193, 1, 24579, "bgr8", 99999, "limit of 8192"),
    (8, 6, 0, "bgr8", 999, "step is 0"),
    (8, 6, 23, "bgr8", 999, "takes 24"),
    (8, 6, 24, "bgr8", 143, "too short"),
    (8, 6, 24, "bgr8", 0, "too short"),
    (8, 6, 2 ** 32 - 1, "bgr8", 144, "too short"),
    (7, 6, 14, "yuv422", 999, "even width"),
    (1, 1, 1, "bayer_rggb8", 9, "2x2"),
])
def test_refused(width, height, step, encoding, length, text):
    with pytest.raises(ImageError, match=text) as caught:
        bgr_from_raw(bytes(length), width, height, step, encoding)
    assert len(str(caught.value)) < 400


def test_compressed():
    ok, png = cv2.imencode(".png", BGR)
    np.testing.assert_array_equal(bgr_from_compressed(png.tobytes()), BGR)
    ok, jpeg = cv2.imencode(".jpg", np.full((32, 32, 3), 99, np.uint8))
    np.testing.assert_allclose(bgr_from_compressed(jpeg.tobytes()), 99, atol=2)


def test_grey_and_deep_png_come_out_as_bgr8():
    for pixels in (GREY, WIDE):
        ok, png = cv2.imencode(".png", pixels)
        assert bgr_from_compressed(png.tobytes()).shape == (6, 8, 3)


def test_compressed_refused():
    ok, png = cv2.imencode(".png", BGR)
    with pytest.raises(ImageError, match="empty"):
        bgr_from_compressed(b"")
    with pytest.raises(ImageError, match="not JPEG or PNG"):
        bgr_from_compressed(b"hello" * 20)
    with pytest.raises(ImageError, match="damaged|nothing"):
        bgr_from_compressed(png.tobytes()[:40])


def test_a_png_that_claims_to_be_huge_is_refused_before_it_is_decoded():
    ok, png = cv2.imencode(".png", BGR)
    bomb = bytearray(png.tobytes())
    bomb[16:24] = (30000).to_bytes(4, "big") * 2
    with pytest.raises(ImageError, match="limit of 8192"):
        bgr_from_compressed(bytes(bomb))


def test_a_jpeg_that_claims_to_be_huge_is_refused_before_it_is_decoded():
    ok, jpeg = cv2.imencode(".jpg", BGR)
    bomb = bytearray(jpeg.tobytes())
    start = bomb.index(b"\xff\xc0") + 5
    bomb[start:start + 4] = (60000).to_bytes(2, "big") * 2
    with pytest.raises(ImageError, match="limit of 8192"):
        bgr_from_compressed(bytes(bomb))
