"""Image messages to arrays, without cv_bridge: colour images to BGR, depth images to metres, and the depth at a point;
cuts between the pictures of a film, and whether a place has changed."""

from __future__ import annotations

import math
import warnings
from typing import Callable, Dict, NamedTuple, Optional, Tuple, Union

import cv2
import numpy as np

from hri_pipeline.core.image_rotation import ImageRotation
from hri_pipeline.core.picture_jumps import Jump, find_jump, picture_of

MAX_SIDE = 8192
DEPTH_ENCODINGS: Tuple[str, ...] = ("16UC1", "mono16", "32FC1")
DEPTH_RANGE = (0.15, 30.0)
"""Depths (m) out of this range are unknown: no depth camera measures them, and 65535 mm or 0 stand for unknown."""
ASPECT_TOLERANCE = 0.02
"""Images whose aspect ratios differ by a larger part do not show the same view."""
_LEAST_CELLS = 3


class ImageError(ValueError):
    """Image data that cannot be read."""


class _Layout(NamedTuple):
    channels: int           # numbers per pixel
    depth: type             # type of one number
    convert: Callable[[np.ndarray], np.ndarray]


def _colour(code: int) -> Callable[[np.ndarray], np.ndarray]:
    return lambda pixels: cv2.cvtColor(pixels, code)


_GREY_BITS = (10, 12, 14, 16)


_SAMPLE = 40000         # pixels that tell how bright an image is, and which numbers are in use
_LIT_SHARE = 0.001      # of the pixels in the upper half of the range: there is light
_COMB_STEP, _COMB_VALUES = 4, 8


class GreyBits:
    """How many of their 16 bits the images of a camera use: 10, 12, 14 or 16, by the largest number so far.

    Never fewer than before: images would flicker. In the dark the largest number is noise: a camera whose numbers are
    multiples (12 bits in the upper part of 16, for example) uses all 16 bits, and an image that seems to have 10 counts
    as one of 12 until one has been in the light.
    """

    def __init__(self) -> None:
        self._bits = _GREY_BITS[0]
        self._was_lit = False

    def upper(self, pixels: np.ndarray) -> np.ndarray:
        """Return the upper 8 of the bits that are used, uint8, of an image of uint16."""
        needed = int(pixels.max(initial=0)).bit_length()
        self._bits = next(bits for bits in _GREY_BITS if bits >= max(needed, self._bits))
        bits = self._bits
        if bits < _GREY_BITS[-1] and needed > 0:
            sample = pixels.reshape(-1)[::max(1, pixels.size // _SAMPLE)]
            if _is_comb(sample):
                bits = self._bits = _GREY_BITS[-1]
            elif not self._was_lit:
                self._was_lit = bits > _GREY_BITS[0] or float((sample >> (bits - 1) > 0).mean()) >= _LIT_SHARE
                bits = bits if self._was_lit else _GREY_BITS[1]
        return (pixels >> (bits - 8)).astype(np.uint8)


def _is_comb(sample: np.ndarray) -> bool:
    """Tell whether many numbers are in use, all of them multiples: what is measured with fewer bits stands in the upper
    ones."""
    values = np.flatnonzero(np.bincount(sample))
    return len(values) >= _COMB_VALUES and int(np.gcd.reduce(values)) >= _COMB_STEP


# Channels, and how they become BGR, of the encodings that exist with 8 and with 16 bits. OpenCV names a Bayer pattern
# by the second row and column, ROS by the first.
_COLOURS: Dict[str, Tuple[int, Callable[[np.ndarray], np.ndarray]]] = {
    "bgr": (3, np.array),
    "rgb": (3, _colour(cv2.COLOR_RGB2BGR)),
    "bgra": (4, _colour(cv2.COLOR_BGRA2BGR)),
    "rgba": (4, _colour(cv2.COLOR_RGBA2BGR)),
    "mono": (1, _colour(cv2.COLOR_GRAY2BGR)),
    "bayer_rggb": (1, _colour(cv2.COLOR_BayerBG2BGR)),
    "bayer_bggr": (1, _colour(cv2.COLOR_BayerRG2BGR)),
    "bayer_gbrg": (1, _colour(cv2.COLOR_BayerGR2BGR)),
    "bayer_grbg": (1, _colour(cv2.COLOR_BayerGB2BGR)),
}
_LAYOUTS: Dict[str, _Layout] = {
    **{name + bits: _Layout(channels, depth, convert) for bits, depth in (("8", np.uint8), ("16", np.uint16))
       for name, (channels, convert) in _COLOURS.items()},
    "8UC1": _Layout(1, np.uint8, _COLOURS["mono"][1]),
    "8UC3": _Layout(3, np.uint8, np.array),
    "8UC4": _Layout(4, np.uint8, _COLOURS["bgra"][1]),
    "yuv422": _Layout(2, np.uint8, _colour(cv2.COLOR_YUV2BGR_UYVY)),
    "yuv422_yuy2": _Layout(2, np.uint8, _colour(cv2.COLOR_YUV2BGR_YUY2)),
}

ENCODINGS: Tuple[str, ...] = tuple(_LAYOUTS)
_DEPTH = ("16UC1", "32FC1")


def bgr_from_raw(
    data: Union[bytes, bytearray, memoryview, np.ndarray],
    width: int,
    height: int,
    step: int,
    encoding: str,
    is_bigendian: bool = False,
    grey: Optional[GreyBits] = None,
) -> np.ndarray:
    """Return a BGR image of the fields of a sensor_msgs/Image.

    Parameters
    ----------
    data : bytes or numpy.ndarray
        Rows of `step` bytes.
    width, height : int
        px, 1 to MAX_SIDE.
    step : int
        Length of a row in bytes, padding included.
    encoding : str
        One of ENCODINGS.
    is_bigendian : bool
        Order of the bytes of 16-bit numbers.
    grey : GreyBits, optional
        Which of 16 bits the earlier images of the camera use; without it this image alone tells.

    Returns
    -------
    numpy.ndarray, shape (height, width, 3), uint8
        A copy.

    Raises
    ------
    ImageError
        For an unknown encoding, a size out of range, and a step or data that are too short.
    """
    layout = _LAYOUTS.get(encoding)
    check_colour(encoding)
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
        pixels = (grey or GreyBits()).upper(pixels.view(">u2" if is_bigendian else "<u2").astype(np.uint16))
    shape = (height, width) if layout.channels == 1 else (height, width, layout.channels)
    return layout.convert(pixels.reshape(shape))


def check_colour(encoding: str) -> None:
    """Raise ImageError for an encoding that only depth images have."""
    if encoding in _DEPTH:
        raise ImageError("encoding {!r} is that of a depth image; give the topic of the colour image".format(encoding))


def raw_rows(data: Union[bytes, bytearray, memoryview, np.ndarray], width: int, height: int, step: int, pixel: int,
             encoding: str) -> np.ndarray:
    """Return the bytes of an image without the padding of its rows, a copy if there is padding.

    Parameters
    ----------
    data : bytes or numpy.ndarray
        Rows of `step` bytes.
    width, height : int
        px.
    step : int
        Length of a row in bytes, padding included.
    pixel : int
        Length of a pixel in bytes.
    encoding : str
        For the text of the error.

    Returns
    -------
    numpy.ndarray, shape (height, width * pixel), uint8

    Raises
    ------
    ImageError
        For a step or data that are too short.
    """
    row = width * pixel
    if step < row:
        raise ImageError("step is {} bytes, but a row of {} px in {} takes {}".format(step, width, encoding, row))
    values = np.frombuffer(data, dtype=np.uint8)
    if values.size < step * (height - 1) + row:
        raise ImageError("{} bytes of data are too short for {}x{} {} with step {}".format(
            values.size, width, height, encoding, step))
    return np.ascontiguousarray(np.lib.stride_tricks.as_strided(values, (height, row), (step, 1), writeable=False))


def bgr_from_compressed(data: Union[bytes, bytearray, memoryview], grey: Optional[GreyBits] = None,
                        encoding: str = "") -> np.ndarray:
    """Return a BGR image of JPEG or PNG data. Orientation tags are ignored, as camera_info knows none.

    Parameters
    ----------
    data : bytes
        A whole file.
    grey : GreyBits, optional
        As for bgr_from_raw().
    encoding : str
        Of the image before it was compressed: a grey picture may be the raw pixels of a Bayer camera.

    Returns
    -------
    numpy.ndarray, shape (H, W, 3), uint8

    Raises
    ------
    ImageError
        For other or damaged data, and, before it is decoded, for an image of more than MAX_SIDE px a side.
    """
    values = np.frombuffer(data, dtype=np.uint8)
    if values.size == 0:
        raise ImageError("the compressed image is empty")
    size = _png_size(bytes(values[:24])) or _jpeg_size(values)
    if size is None:
        raise ImageError("the compressed image ({} bytes) is not JPEG or PNG, or is damaged".format(values.size))
    _check_size(*size)
    if not _has_whole_chunks(values):
        raise ImageError("the compressed image ({} bytes) is damaged".format(values.size))
    try:
        image = cv2.imdecode(values, cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error as error:
        raise ImageError("the compressed image cannot be decoded: {}".format(error)) from error
    if image is None:
        raise ImageError("the compressed image ({} bytes) is damaged".format(values.size))
    bgr = (grey or GreyBits()).upper(image) if image.dtype == np.uint16 else np.asarray(image)
    return _demosaiced(bgr, encoding) if encoding.startswith("bayer") else bgr


def _demosaiced(image: np.ndarray, encoding: str) -> np.ndarray:
    """Return a decoded image (H, W, 3) in its colours, where it is grey: the raw pixels of a Bayer pattern."""
    layout, pixels = _LAYOUTS.get(encoding), image[:, :, 0]
    if layout is None or min(pixels.shape) < 2 or not (image == pixels[:, :, None]).all():
        return image
    return layout.convert(np.ascontiguousarray(pixels))


def depth_from_raw(
    data: Union[bytes, bytearray, memoryview, np.ndarray],
    width: int,
    height: int,
    step: int,
    encoding: str,
    is_bigendian: bool = False,
) -> np.ndarray:
    """Return a depth image in metres of the fields of a sensor_msgs/Image.

    16UC1 (also called mono16) is in mm and 32FC1 in m (REP-118).

    Parameters
    ----------
    data, width, height, step, is_bigendian
        As of bgr_from_raw.
    encoding : str
        One of DEPTH_ENCODINGS.

    Returns
    -------
    numpy.ndarray, shape (height, width), float32
        m, NaN where the depth is unknown.

    Raises
    ------
    ImageError
        For another encoding, a size out of range, and a step or data that are too short.
    """
    if encoding not in DEPTH_ENCODINGS:
        raise ImageError("encoding {!r} is not one of a depth image; publish one of: {}".format(
            encoding[:40], ", ".join(DEPTH_ENCODINGS)))
    if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE):
        raise ImageError("size of the depth image is {}x{}, legal range 1 to {} px a side".format(
            width, height, MAX_SIDE))
    kind = np.dtype(np.float32 if encoding == "32FC1" else np.uint16).newbyteorder(">" if is_bigendian else "<")
    metres = raw_rows(data, width, height, step, kind.itemsize, "depth in " + encoding).view(kind).astype(np.float32)
    if encoding != "32FC1":
        metres *= np.float32(1e-3)
    with np.errstate(invalid="ignore"):
        metres[~((metres >= DEPTH_RANGE[0]) & (metres <= DEPTH_RANGE[1]))] = np.nan
    return metres


def sample_depth(depth: np.ndarray, pixels: np.ndarray, width: int, height: int) -> np.ndarray:
    """Return the depth at points of the colour image: the median of 3 x 3 pixels of the depth image.

    Parameters
    ----------
    depth : numpy.ndarray, shape (h, w)
        m, NaN or 0 where unknown; registered to the colour image, but perhaps of another size.
    pixels : numpy.ndarray, shape (N, 2)
        Points in the colour image, px.
    width, height : int
        Size of the colour image, px.

    Returns
    -------
    numpy.ndarray, shape (N,)
        m; NaN outside of the image, and where fewer than three of the nine pixels are known.
    """
    rows, columns = depth.shape
    pixels = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
    inside = np.all(np.isfinite(pixels), axis=1)
    scaled = np.where(inside[:, None], pixels, -1.0) * np.array([columns / width, rows / height])
    inside &= np.all((scaled >= 0.0) & (scaled < np.array([columns, rows])), axis=1)
    cells = np.floor(np.where(inside[:, None], scaled, 0.0)).astype(np.int64)
    around = np.arange(-1, 2)
    y = np.clip(cells[:, 1, None, None] + around[None, :, None], 0, rows - 1)
    x = np.clip(cells[:, 0, None, None] + around[None, None, :], 0, columns - 1)
    values = np.asarray(depth[y, x], dtype=np.float64).reshape(len(pixels), 9)
    with np.errstate(invalid="ignore"):
        values[~((values >= DEPTH_RANGE[0]) & (values <= DEPTH_RANGE[1]))] = np.nan
    known = np.isfinite(values).sum(axis=1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", category=RuntimeWarning)    # rows that are all NaN give NaN
        median = np.nanmedian(values, axis=1)
    return np.where(inside & (known >= _LEAST_CELLS), median, np.nan)


def _png_size(start: bytes) -> Optional[Tuple[int, int]]:
    """Width and height that the first 24 bytes of a PNG file tell (its IHDR chunk), else None."""
    if len(start) < 24 or not start.startswith(b"\x89PNG\r\n\x1a\n"):
        return None
    return int.from_bytes(start[16:20], "big"), int.from_bytes(start[20:24], "big")


def _has_whole_chunks(values: np.ndarray) -> bool:
    """Tell whether all chunks of a PNG file end within it, and True for other files: OpenCV makes room for what a chunk
    says to hold, 2 GB at most, before it looks whether that is there."""
    data = np.ascontiguousarray(values).data
    position, kind = 8 if bytes(data[1:4]) == b"PNG" else len(data), b""
    while position + 8 <= len(data) and kind != b"IEND":
        kind = bytes(data[position + 4:position + 8])
        position += 12 + int.from_bytes(bytes(data[position:position + 4]), "big")
    return position <= len(data)


def _jpeg_size(values: np.ndarray) -> Optional[Tuple[int, int]]:
    """Width and height in the frame header (SOF marker) of a JPEG file, else None."""
    data = np.ascontiguousarray(values).data
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


_SIDE = 48
_MOST_MOTION = 0.25
"""Part of the picture by which it may move from one image to the next."""
_CUT = 0.5
"""Correlation of two pictures, moved against each other at best, below which they show something else."""
_CALM = 0.9
"""Correlation from which the picture may have moved, but has not jumped: a zoom of 1.15 leaves .61 to .86 of it, a pan
.92 and more, of ten photographs."""
_NEXT_TRY = 0.5
"""Time (s) for which no jump is looked for after there was none: a camera that turns fast changes each image."""
_CUT_IN_BLANK = 0.8
"""The same for a picture after one of nothing: one scene has .79 and more when the light comes back, overexposed too;
photographs of two scenes up to .62, of two people alike in place and size .76."""
_EMPTY, _FADED = 4.0, 0.25
"""Standard deviation (grey values) below which a smoothed picture shows nothing, and part of that of the picture before
below which it does so all at once: a wall with somebody far away before it is as smooth."""
_LONGEST_BLANK = 3.0
"""Time (s) after which pictures of nothing are a scene of their own."""
LONGEST_FLAW = 0.3
"""Time (s) for which damaged images are passed over: after that they are the scene."""
_FLAT_BY, _FLAT_PART, _EXPOSED = 1.0, 0.15, (5.0, 250.0)
"""Grey values by which the pixels of a row differ where nothing was received, part of the rows of which this is so all
at once, and grey values out of which light may do the same: between them a sensor has noise."""
_STAYED, _STAYED_BY = 0.62, 6.0
"""Part of the picture that stays as it was, within so many grey values, from which there was no cut: people who cross
before a wall leave .67 and more of it, even at 2 Hz; cuts between photographs and between films .20, one pair .57."""


DARK_MEAN, FAINT_DEVIATION = 25.0, 6.0
"""Mean and standard deviation of the pixels (0 to 255) below which a picture is too dark, or shows too little."""
_BLANK_DEVIATION = 2.0
"""The same deviation where there is nothing to be seen: a covered lens, no light. In photographs made dark faces are
found from 2.7 on, fewer than in the light below 6."""


def picture_fault(bgr: np.ndarray) -> str:
    """Return why hardly anybody can be found in a picture (H, W, 3) uint8: there is nothing in it (black, white, one
    colour), or it is too dark; empty where it is neither."""
    grey = np.ascontiguousarray(bgr[::8, ::8].mean(axis=2, dtype=np.float32))
    deviation = _deviation(grey)
    if deviation < _BLANK_DEVIATION:
        return "the picture shows nothing (all pixels are alike)"
    mean = float(grey.mean())
    if mean < DARK_MEAN and deviation < FAINT_DEVIATION:
        return "the picture is too dark (mean {:.0f} of 255)".format(mean)
    return ""


class PictureCuts:
    """Tells when most of the picture changes from one image to the next, and not by a motion of the camera, by light,
    or by people who walk before the same background.

    An image that suddenly shows nothing (no light, a covered lens, a broken image) is no cut: what comes after it is
    compared with what was there before. So is one of which a part was not received. One that shows something else is a
    cut at once, although cameras and networks send such images now and then: so does a camera that turns fast.

    Nor is it a cut where the camera has zoomed, or the picture has jumped: `jump` tells where things are.
    """

    def __init__(self, jumps: bool = False) -> None:
        """jumps: whether they are looked for, which takes some 10 ms after each sudden change; else they are cuts."""
        self._jumps = jumps
        self.jump: Optional[Jump] = None
        """Where what the image before has shown is in the last one, None where it is about where it was."""
        self._picture: Optional[np.ndarray] = None
        self._size: Tuple[int, ...] = ()        # of the image of which it is
        self._no_jump_at = -math.inf    # when one was looked for in vain
        self._last: Optional[np.ndarray] = None
        self._contrast = 0.0        # of the last image that showed something
        self._flat = 0              # rows of it that are of one colour
        self._was_empty = False     # an image that was passed over since
        self.shown_at = 0.0
        """Stamp (s) of that image."""
        self.changed = False
        """Whether most of the last image shows something else than the one before did there."""
        self.blank = False
        """Whether the last image is to be passed over: it shows nothing, or a part of it is missing."""

    def update(self, bgr: np.ndarray, stamp: float = 0.0) -> bool:
        """Return whether `bgr` (H, W, 3) uint8 of `stamp` (s) shows something else than the last image that showed
        something."""
        small = self._small(bgr)
        contrast = _deviation(cv2.blur(small, (3, 3)))
        flat = _flat_rows(small)
        passed = stamp - self.shown_at if self._last is not None else math.inf
        is_empty = 0.0 <= passed <= _LONGEST_BLANK and contrast < min(_EMPTY, _FADED * self._contrast)
        self._was_empty |= is_empty
        self.jump = None
        self.blank = is_empty or (0.0 < passed <= LONGEST_FLAW and flat - self._flat > _FLAT_PART * _SIDE)
        if self.blank:
            self.changed = False
            return False
        likeness = self._likeness(small, contrast)
        is_cut = likeness < (_CUT_IN_BLANK if self._was_empty else _CUT)
        if self._jumps:
            if likeness < _CALM and not 0.0 <= stamp - self._no_jump_at < _NEXT_TRY:
                self.jump = self._find_jump(bgr, is_cut)
                self._no_jump_at = stamp if self.jump is None else -math.inf
            self._picture, self._size = picture_of(bgr), bgr.shape
        is_cut = is_cut and self.jump is None
        self._was_empty = False
        self._last, self._contrast, self._flat, self.shown_at = small, contrast, flat, stamp
        return is_cut

    def _likeness(self, small: np.ndarray, contrast: float) -> float:
        """Correlation of a small picture with the last one, 1 where most stays as it was, which is noted."""
        last = self._last
        self.changed = last is not None and bool(
            np.count_nonzero(cv2.absdiff(small, last) < _STAYED_BY) < _STAYED * small.size)
        if last is None or not self.changed or max(self._contrast, contrast) < _EMPTY:
            return 1.0
        if min(self._contrast, contrast) < _FADED * _EMPTY:
            return -1.0
        margin = int(_SIDE * _MOST_MOTION)
        inner = small[margin:-margin, margin:-margin]
        if _deviation(inner) < _EMPTY:
            return float(np.corrcoef(small.ravel(), last.ravel())[0, 1])
        return float(cv2.matchTemplate(last, inner, cv2.TM_CCOEFF_NORMED).max())

    def _find_jump(self, bgr: np.ndarray, is_cut: bool) -> Optional[Jump]:
        """Return the jump to an image (H, W, 3). What is as large as before, and not so far away that it would be a
        cut, is found by its motion, which goes on."""
        jump = None if self._picture is None or self._size != bgr.shape else find_jump(self._picture, bgr)
        return jump if jump is not None and (is_cut or jump.has_grown) else None

    def turn(self, rotation: ImageRotation) -> None:
        """Turn the last image."""
        if self._last is not None:
            self._last = rotation.image(self._last)
            self._flat = _flat_rows(self._last)
        if self._picture is not None:
            self._picture = rotation.image(self._picture)
            self._size = self._size[1::-1] + self._size[2:] if rotation.quarters % 2 else self._size

    def reset(self) -> None:
        """Forget the last image."""
        self._last, self._picture, self.jump, self.blank, self._was_empty = None, None, None, False, False

    @staticmethod
    def _small(bgr: np.ndarray) -> np.ndarray:
        step = max(1, min(bgr.shape[:2]) // (2 * _SIDE))
        green = np.ascontiguousarray(bgr[::step, ::step, 1])
        return cv2.resize(green, (_SIDE, _SIDE), interpolation=cv2.INTER_AREA).astype(np.float32)


def _flat_rows(small: np.ndarray) -> int:
    """Return how many rows of a small picture (H, W) are of one colour that is neither black nor white."""
    low, high = small.min(axis=1), small.max(axis=1)
    return int(np.count_nonzero((high - low <= _FLAT_BY) & (low > _EXPOSED[0]) & (high < _EXPOSED[1])))


# What is kept of a place: its longer side (px), and how much around it, in its longer sides; grey values by which
# 5 x 5 px of what has not moved differ less. Of 12 things before a camera with noise 95 % stayed below 2.7; people who
# breathe and sway differ by 2 to 19 within 1 s.
_VIEW, _AROUND = 64, 0.1
_SMOOTH, _CHANGED = 5, 1.5


class PlaceView:
    """What a box (4,) px of an image (H, W, 3) BGR shows, to tell of a later image whether it shows the same."""

    def __init__(self, image: np.ndarray, box: np.ndarray) -> None:
        self.box = box
        self._view = _grey_view(image, box)

    def is_unchanged(self, image: np.ndarray) -> bool:
        """Tell whether nothing has moved there, whatever noise, brightness and contrast do."""
        return _change(self._view, _grey_view(image, self.box)) < _CHANGED


def _grey_view(image: np.ndarray, box: np.ndarray) -> np.ndarray:
    """What a box (4,) px and a rim around it show, float32 in grey values, the longer side 64 px."""
    rim = _AROUND * float(max(box[2:] - box[:2]))
    height, width = image.shape[:2]
    left, top, right, bottom = np.rint(np.clip(
        box + np.array([-rim, -rim, rim, rim]), 0, [width, height, width, height])).astype(int)
    left, top = min(left, width - 1), min(top, height - 1)
    part = image[top:max(bottom, top + 1), left:max(right, left + 1)]
    scale = _VIEW / float(max(part.shape[:2]))
    small = cv2.resize(part, (max(1, round(scale * part.shape[1])), max(1, round(scale * part.shape[0]))),
                       interpolation=cv2.INTER_AREA)
    return cv2.cvtColor(small, cv2.COLOR_BGR2GRAY).astype(np.float32)


def _change(before: np.ndarray, now: np.ndarray) -> float:
    """Grey values by which 5 x 5 px of two views (h, w) differ at most, beyond noise, brightness and contrast."""
    if before.shape != now.shape:
        return float("inf")
    now = (now - now.mean()) * float(before.std() / max(1e-3, now.std())) + before.mean()
    apart = np.abs(before - now)
    return float(cv2.blur(apart, (_SMOOTH, _SMOOTH)).max() - np.median(apart))


def _deviation(picture: np.ndarray) -> float:
    """Standard deviation of the grey values of a small picture."""
    return float(cv2.meanStdDev(picture)[1][0, 0])


def other_transport(topic: str) -> Tuple[str, str]:
    """Return the topic of the same images in the other transport, and the name of that: `raw` or `compressed`."""
    if topic.endswith("/compressed"):
        return topic[:-len("/compressed")], "raw"
    return topic + "/compressed", "compressed"


def is_rectified(topic: str) -> bool:
    """Tell whether a topic is of rectified images, by the names that image_proc and drivers give those."""
    raw = topic[:-len("/compressed")] if topic.endswith("/compressed") else topic
    return raw.rpartition("/")[2].startswith("image_rect")
