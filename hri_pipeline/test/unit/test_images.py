"""Image data and depth of all encodings, and data that must be refused."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from hri_pipeline.core.images import (
    ENCODINGS,
    GreyBits,
    ImageError,
    bgr_from_compressed,
    bgr_from_raw,
    depth_from_raw,
    is_rectified,
    picture_fault,
    sample_depth,
)

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
    ("8UC4", np.dstack([BGR, GREY]), BGR),
    ("bgr16", BGR.astype(np.uint16) * 256 + 77, BGR),
    ("rgb16", BGR[:, :, ::-1].astype(np.uint16) * 256 + 77, BGR),
    ("bgra16", np.dstack([BGR, GREY]).astype(np.uint16) * 256 + 77, BGR),
    ("rgba16", np.dstack([BGR[:, :, ::-1], GREY]).astype(np.uint16) * 256 + 77, BGR),
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


def wide(largest, seed=3):
    """A picture of 16 bits a pixel, 0 to `largest`."""
    pixels = np.random.default_rng(seed).integers(0, largest + 1, (6, 8)).astype(np.uint16)
    pixels[0, :2] = 0, largest
    return pixels


def grey_of(pixels, **memory):
    return bgr_from_raw(pixels.tobytes(), 8, 6, 16, "mono16", **memory)[:, :, 0]


@pytest.mark.parametrize("bits", [10, 12, 14, 16])
def test_sixteen_bits_that_hold_fewer_are_as_bright_as_full_ones(bits):
    pixels = wide(2 ** bits - 1)
    np.testing.assert_array_equal(grey_of(pixels), pixels >> (bits - 8))
    assert grey_of(pixels).max() == 255
    png = cv2.imencode(".png", pixels)[1].tobytes()
    np.testing.assert_array_equal(bgr_from_compressed(png)[:, :, 0], pixels >> (bits - 8))


def test_a_darker_image_of_the_same_camera_is_darker():
    memory = GreyBits()
    assert grey_of(wide(900), grey=memory).max() == 225        # until it is known how bright they become
    for _ in range(3):
        assert grey_of(wide(4095), grey=memory).max() == 255
        assert grey_of(wide(900), grey=memory).max() == 56
    png = cv2.imencode(".png", wide(900))[1].tobytes()
    assert bgr_from_compressed(png, memory).max() == 56
    assert grey_of(wide(0)).max() == 0


def noise(mean, sd, step=1, bright=0):
    """A dark picture of sensor noise, with some bright pixels; numbers are multiples of `step`."""
    rng = np.random.default_rng(5)
    pixels = np.clip(rng.normal(mean, sd, (120, 160)), 0, 65535 // step).astype(np.uint16) * np.uint16(step)
    pixels.reshape(-1)[:bright] = 900
    return pixels


@pytest.mark.parametrize("bits", [10, 12, 14])
def test_noise_of_a_dark_room_is_not_stretched_where_a_camera_fills_16_bits_from_above(bits):
    """Its numbers are multiples of 64, 16 or 4: 64 times as bright they were a snowstorm."""
    memory = GreyBits()
    assert memory.upper(noise(*((10, 4) if bits < 14 else (60, 20)), step=2 ** (16 - bits))).max() <= 8
    bright = np.linspace(0, 65535, 120 * 160).astype(np.uint16).reshape(120, 160)
    np.testing.assert_array_equal(memory.upper(bright), bright >> 8)


def test_a_dark_image_that_could_be_of_any_number_of_bits_is_not_stretched_to_white():
    memory = GreyBits()
    assert memory.upper(noise(100, 30, bright=5)).max() <= 900 >> 4, "one hot pixel is no light"
    lit = noise(500, 100)
    np.testing.assert_array_equal(memory.upper(lit), lit >> 2)
    np.testing.assert_array_equal(memory.upper(noise(100, 30)), noise(100, 30) >> 2)      # it has 10 bits


@pytest.mark.parametrize("encoding, order", [("yuv422", "uyvy"), ("yuv422_yuy2", "yuyv")])
def test_yuv_of_one_colour(encoding, order):
    y, u, v = 81, 90, 240        # red in BT.601
    values = {"y": y, "u": u, "v": v}
    data = bytes(values[letter] for letter in order) * 4 * 6
    result = bgr_from_raw(data, 8, 6, 16, encoding)
    np.testing.assert_allclose(result.reshape(-1, 3), [[0, 0, 255]] * 48, atol=3)


@pytest.mark.parametrize("bits", [8, 12, 16])
@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_bayer_of_one_colour(pattern, bits):
    values = dict(zip("bgr", (30, 120, 220)))
    tile = np.array([values[letter] << (bits - 8) for letter in pattern], np.uint8 if bits == 8 else np.uint16)
    data = np.tile(tile.reshape(2, 2), (4, 4)) | ((1 << (bits - 8)) - 1)
    result = bgr_from_raw(data.tobytes(), 8, 8, 8 * data.itemsize, "bayer_{}{}".format(pattern, 8 * data.itemsize))
    np.testing.assert_array_equal(result[2:-2, 2:-2].reshape(-1, 3), [[30, 120, 220]] * 16)


def test_every_encoding_is_read():
    for encoding in ENCODINGS:
        assert bgr_from_raw(bytes(8 * 6 * 8), 8, 6, 64, encoding).shape == (6, 8, 3)


@pytest.mark.parametrize("width, height, step, encoding, length, text", [
    (8, 6, 24, "64FC1", 999, "not supported; publish one of: bgr8"),
    (8, 6, 32, "32FC1", 999, "depth image; give the topic of the colour image"),
    (8, 6, 16, "16UC1", 999, "depth image; give the topic of the colour image"),
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


@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_tag_of_orientation_turns_nothing(orientation):
    """The calibration is that of the camera, whichever way up somebody would show its picture."""
    ok, jpeg = cv2.imencode(".jpg", np.tile(np.arange(0, 240, 5, dtype=np.uint8), (24, 1)))
    tags = b"MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01" + orientation.to_bytes(2, "big") + b"\0\0\0\0\0\0"
    exif = b"Exif\0\0" + tags
    turned = jpeg.tobytes()[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif + jpeg.tobytes()[2:]
    np.testing.assert_array_equal(bgr_from_compressed(turned), bgr_from_compressed(jpeg.tobytes()))


def test_grey_and_deep_png_come_out_as_bgr8():
    for pixels in (GREY, WIDE):
        ok, png = cv2.imencode(".png", pixels)
        assert bgr_from_compressed(png.tobytes()).shape == (6, 8, 3)


@pytest.mark.parametrize("pattern, red", [("rggb", (0, 0)), ("bggr", (1, 1)), ("gbrg", (1, 0)), ("grbg", (0, 1))])
@pytest.mark.parametrize("bits", [8, 16])
def test_compressed_mosaics_have_their_colours(pattern, red, bits):
    """image_transport compresses the raw pixels of a Bayer camera, and says by the format which they are."""
    mosaic = np.full((12, 16), 120, np.uint8)
    mosaic[red[0]::2, red[1]::2] = 200
    mosaic[1 - red[0]::2, 1 - red[1]::2] = 40
    name = "bayer_{}{}".format(pattern, bits)
    png = cv2.imencode(".png", mosaic if bits == 8 else mosaic.astype(np.uint16) << 8)[1].tobytes()
    found = bgr_from_compressed(png, encoding=name)
    np.testing.assert_array_equal(found, bgr_from_raw(mosaic.tobytes(), 16, 12, 16, "bayer_" + pattern + "8"))
    assert found[5, 5].tolist() == [40, 120, 200]
    jpeg = cv2.imencode(".jpg", mosaic, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()
    np.testing.assert_allclose(bgr_from_compressed(jpeg, encoding=name)[3:-3, 3:-3].mean(axis=(0, 1)),
                               (40, 120, 200), atol=6)


def test_colours_that_were_made_before_the_compression_stay():
    png = cv2.imencode(".png", BGR)[1].tobytes()
    np.testing.assert_array_equal(bgr_from_compressed(png, encoding="bayer_rggb8"), BGR)
    grey = cv2.imencode(".png", BGR[:, :, 0])[1].tobytes()
    np.testing.assert_array_equal(bgr_from_compressed(grey, encoding="mono8")[:, :, 2], BGR[:, :, 0])


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


MILLIMETRES = np.array([[0, 500, 1500], [2345, 65535, 30001]], np.uint16)
METRES = np.array([[np.nan, 0.5, 1.5], [2.345, np.inf, -1.0]], np.float32)
WANTED = np.array([[np.nan, 0.5, 1.5], [2.345, np.nan, np.nan]])


def raw(values, big=False, padding=0):
    """Bytes and step of a depth image, as a driver sends it."""
    rows = values.astype(values.dtype.newbyteorder(">" if big else "<"))
    return b"".join(row.tobytes() + b"\x7f" * padding for row in rows), rows.shape[1] * rows.itemsize + padding


@pytest.mark.parametrize("big", [False, True], ids=["little", "big"])
@pytest.mark.parametrize("padding", [0, 5])
@pytest.mark.parametrize("values, encoding", [(MILLIMETRES, "16UC1"), (MILLIMETRES, "mono16"), (METRES, "32FC1")])
def test_every_way_to_write_it_gives_metres(values, encoding, padding, big):
    data, step = raw(values, big, padding)
    depth = depth_from_raw(data, 3, 2, step, encoding, big)
    assert depth.dtype == np.float32
    np.testing.assert_allclose(depth, WANTED, atol=1e-6)


def test_the_last_row_needs_no_padding():
    data, step = raw(MILLIMETRES, padding=4)
    np.testing.assert_allclose(depth_from_raw(data[:-4], 3, 2, step, "16UC1"), WANTED, atol=1e-6)


@pytest.mark.parametrize("change, text", [
    (dict(encoding="rgb8"), "encoding 'rgb8'"), (dict(width=0), "0x2"), (dict(height=9000), "9000"),
    (dict(step=5), "step is 5"), (dict(data=b"\0" * 11), "too short"), (dict(encoding="32FC1"), "step is 6")])
def test_what_cannot_be_read_is_told(change, text):
    data, step = raw(MILLIMETRES)
    fields = dict(data=data, width=3, height=2, step=step, encoding="16UC1")
    fields.update(change)
    with pytest.raises(ImageError, match=text):
        depth_from_raw(**fields)


def test_the_median_forgives_holes_and_flying_pixels():
    depth = np.full((20, 30), 2.0, np.float32)
    depth[10, 10], depth[10, 11], depth[9, 9] = np.nan, 0.0, 7.0
    assert sample_depth(depth, np.array([[10.5, 10.5]]), 30, 20) == pytest.approx([2.0])


def test_too_few_known_cells_and_points_outside_give_nan():
    depth = np.full((20, 30), np.nan, np.float32)
    depth[5, 5:7] = 2.0
    depth[12, 12:15] = 2.0
    points = np.array([[5.5, 5.5], [13.5, 12.5], [-0.5, 3.0], [30.0, 3.0], [3.0, 20.5], [np.nan, 3.0], [1e9, 1.0]])
    found = sample_depth(depth, points, 30, 20)
    assert found[1] == pytest.approx(2.0)
    assert np.all(np.isnan(found[[0, 2, 3, 4, 5, 6]]))


def test_a_smaller_depth_image_is_read_at_the_same_place():
    depth = np.full((10, 15), 1.0, np.float32)
    depth[:, 8:] = 3.0
    assert sample_depth(depth, np.array([[10.0, 5.0], [25.0, 15.0]]), 30, 20) == pytest.approx([1.0, 3.0])
    assert sample_depth(depth, np.zeros((0, 2)), 30, 20).shape == (0,)


@pytest.mark.parametrize("at, says", [(33, 2 ** 31 - 1), (33, 2 ** 20), (-12, 13)])
def test_a_png_whose_chunk_is_not_all_there_is_refused_before_room_is_made_for_it(at, says, monkeypatch):
    """Some dozens of bytes took seconds, and gigabytes."""
    good = cv2.imencode(".png", np.zeros((9, 8, 3), np.uint8))[1].tobytes()
    assert bgr_from_compressed(good + b"behind it").shape == (9, 8, 3)
    monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("it was decoded"))
    at %= len(good)
    with pytest.raises(ImageError, match="damaged"):
        bgr_from_compressed(good[:at] + says.to_bytes(4, "big") + good[at + 4:])


def test_rectified_images_are_known_by_their_topics():
    for topic in ("/camera/image_rect", "/zed/rgb/image_rect_color", "/image_rect/compressed"):
        assert is_rectified(topic)
    for topic in ("/camera/image_raw", "/image_rect/image_raw", "/rect/image", "/camera/image_raw/compressed", ""):
        assert not is_rectified(topic)


@pytest.mark.parametrize("mean, deviation, told", [
    (0, 0, "nothing"), (255, 0, "nothing"), (128, 0, "nothing"), (3, 1.5, "nothing"),
    (10, 4, "too dark"),        # faces of photographs are found in it: it does show something
    (24, 7, ""), (120, 4, ""),  # a smooth wall
    (120, 40, "")])
def test_a_picture_of_nothing_and_a_dark_one_are_told_apart(mean, deviation, told):
    bgr = np.full((96, 128, 3), mean, np.uint8)
    bgr[::16], bgr[8::16] = round(mean + deviation), max(0, round(mean - deviation))
    fault = picture_fault(bgr)
    assert told in fault and bool(fault) == bool(told)
