"""Where images come from: a video file, a directory of pictures, one picture, a camera or a network stream.

A source is used like cv2.VideoCapture: `advance` moves on and is cheap, `image` makes the picture, so that
nothing is drawn while nobody looks. Time is an argument: seconds since the source was opened.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from pathlib import Path
from typing import Callable, Optional, Sequence, Tuple

import cv2
import numpy as np

from hri_pipeline.core.parameters import ParameterError
from hri_pipeline.core.sources import in_reading_order
from hri_pipeline.core.sources.parameters import CROP, FIT_CHOICES, LETTERBOX, NATIVE, ImageSourceSettings

PICTURE_SUFFIXES = (".jpg", ".jpeg", ".png", ".bmp", ".webp", ".tif", ".tiff")
PICTURE_RATE = 30.0
CHOICE_OF_SOURCES = ("a video file, a picture, a directory of pictures, a camera (/dev/videoN or its number) "
                     "or a stream (rtsp://, http://)")
Notify = Callable[[str], None]


class SourceError(ParameterError):
    """What the parameter `source` names cannot be opened or read; the text names it and says what to do."""


class ImageSource(ABC):
    """What every source offers. `live`: a camera or stream, worth trying again after an error."""

    live = False
    rate = PICTURE_RATE
    description = ""

    @abstractmethod
    def advance(self, elapsed: float) -> bool:
        """Go to the image due `elapsed` s after opening; False at the end. Raises SourceError."""

    @abstractmethod
    def image(self) -> Optional[np.ndarray]:
        """Return the present image, (height, width, 3) BGR uint8, or None where it cannot be decoded."""

    def close(self) -> None:  # noqa: B027 - pictures hold nothing open
        """Let go of file or device. May be called again."""


class _CapturedSource(ImageSource):
    """Images that OpenCV captures. _fit: width, height and fit of the published ones."""

    _capture: cv2.VideoCapture
    _fit: Tuple[int, int, str]

    def image(self) -> Optional[np.ndarray]:
        """Return the present image, None where it is damaged."""
        good, image = self._capture.retrieve()
        return fit_image(image, *self._fit) if good else None

    def close(self) -> None:
        """Close the file or device."""
        self._capture.release()


class VideoSource(_CapturedSource):
    """The frames of a video file one by one, each exactly once per pass."""

    def __init__(self, path: Path, width: int, height: int, fit: str, loop: bool) -> None:
        self._path, self._fit, self._loop = path, (width, height, fit), loop
        self._capture = self._open()
        rate = self._capture.get(cv2.CAP_PROP_FPS)
        self.rate = rate if 0.5 <= rate <= 240.0 else PICTURE_RATE
        self.description = "video {} ({:.4g} Hz)".format(path, self.rate)
        self._frames = 0

    def _open(self) -> cv2.VideoCapture:
        capture = cv2.VideoCapture(str(self._path))
        if not capture.isOpened():
            raise SourceError("cannot read video {}: not a format that OpenCV knows, or a damaged file; try to "
                              "convert it: ffmpeg -i {} video.mp4".format(self._path, self._path.name))
        return capture

    def advance(self, elapsed: float) -> bool:
        """Go to the next frame; at the end start again where `loop` is set."""
        if self._capture.grab():
            self._frames += 1
            return True
        if self._frames == 0:
            raise SourceError("video {} has no readable frame; convert it or give another".format(self._path))
        if not self._loop:
            return False
        # Opened anew: seeking to the start fails for some containers.
        self._capture.release()
        self._capture = self._open()
        self._frames = 1 if self._capture.grab() else 0
        return self._frames == 1


class LiveSource(_CapturedSource):
    """A V4L2 camera or a network stream; `advance` waits for the next image of the device."""

    live = True

    def __init__(self, target: str, width: int, height: int, fit: str, rate: float, fourcc: str) -> None:
        self._target, self._fit = target, (width, height, fit)
        device = target.startswith("/dev/")
        if device and not Path(target).exists():
            raise SourceError(_no_camera(target))
        self._capture = cv2.VideoCapture(target, cv2.CAP_V4L2) if device else cv2.VideoCapture(target)
        if not self._capture.isOpened():
            mend = "is it used by another program, and may this user read it (group video)?" if device else \
                "check the address and that the sender runs"
            raise SourceError("cannot open {} {}: {}".format("camera" if device else "stream", target, mend))
        if device:
            self._set_up(width, height, fit, rate, fourcc)
        reported = self._capture.get(cv2.CAP_PROP_FPS)
        self.rate = reported if 0.5 <= reported <= 240.0 else PICTURE_RATE
        self.description = "{} {}".format("camera" if device else "stream", target)

    def _set_up(self, width: int, height: int, fit: str, rate: float, fourcc: str) -> None:
        """Ask the driver; what it refuses is made good by `fit_image`."""
        if len(fourcc) == 4:
            self._capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*fourcc))
        if fit != NATIVE:
            self._capture.set(cv2.CAP_PROP_FRAME_WIDTH, width)
            self._capture.set(cv2.CAP_PROP_FRAME_HEIGHT, height)
        if rate > 0.0:
            self._capture.set(cv2.CAP_PROP_FPS, rate)
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)

    def advance(self, elapsed: float) -> bool:
        """Wait for the next image. Raises SourceError when the device has gone."""
        if not self._capture.grab():
            raise SourceError("{} gives no images any more; check its cable or its sender".format(self.description))
        return True


class PictureSource(ImageSource):
    """Pictures one after the other, each for the same time, seen by a slowly moving camera.

    Between two pictures the image is black for a while, so that trackers let go: other people are seen next, and no
    camera cuts from one place to another.
    A picture that cannot be read is skipped and reported once through `notify`.
    Raises SourceError when none can be read.
    """

    def __init__(self, paths: Sequence[Path], settings: ImageSourceSettings, notify: Notify) -> None:
        self._paths, self._settings, self._notify = list(paths), settings, notify
        self._elapsed = 0.0
        self._shown = -1
        self._motion: Optional[PictureMotion] = None
        self.description = str(paths[0]) if len(paths) == 1 else "{} pictures of {}".format(
            len(paths), paths[0].parent)
        self._show(0)

    def _show(self, turn: int) -> None:
        """Load picture number `turn`, leaving out those that cannot be read."""
        while self._paths:
            path = self._paths[turn % len(self._paths)]
            picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
            if picture is not None:
                options = self._settings
                self._motion = PictureMotion(picture, options.width, options.height, options.fit, options.pan,
                                             options.zoom, options.pan_period)
                self._shown = turn
                return
            self._paths.remove(path)
            self._notify("picture {} cannot be read and is skipped; replace or remove it".format(path))
        raise SourceError("none of the pictures of {} can be read; give {}".format(
            self._settings.source, CHOICE_OF_SOURCES))

    def advance(self, elapsed: float) -> bool:
        """Go to the view after `elapsed` s; False when all have been shown and `loop` is not set."""
        turn = int(elapsed / self._settings.seconds_per_picture)
        if turn >= len(self._paths) and not self._settings.loop:
            return False
        self._elapsed = elapsed
        if turn != self._shown and (len(self._paths) > 1 or self._motion is None):
            self._show(turn)
        return True

    def image(self) -> Optional[np.ndarray]:
        """Return the present view, black at the end of the time of a picture that others follow."""
        if self._motion is None:
            return None
        view = self._motion.view(self._elapsed)
        left = self._settings.seconds_per_picture - self._elapsed % self._settings.seconds_per_picture
        return np.zeros_like(view) if len(self._paths) > 1 and left <= self._settings.dark_between_pictures else view


def _no_camera(device: str) -> str:
    """The sentence for a missing camera."""
    found = sorted(str(path) for path in Path("/dev").glob("video*"))
    there = "cameras here: " + ", ".join(found) if found else "no camera is connected"
    return "no camera {}: {}; connect it, or give {}".format(device, there, CHOICE_OF_SOURCES)


def pictures_in(directory: Path) -> list:
    """Return the picture files of a directory in reading order. Raises SourceError when there is none."""
    paths = sorted((path for path in directory.iterdir() if path.suffix.lower() in PICTURE_SUFFIXES),
                   key=in_reading_order)
    if not paths:
        raise SourceError("directory {} holds no picture ({}); give another, or put some there".format(
            directory, " ".join(PICTURE_SUFFIXES)))
    return paths


def is_live(source: str) -> bool:
    """Tell whether `source` names a camera or a stream."""
    return source.isdigit() or source.startswith("/dev/") or "://" in source


def open_source(settings: ImageSourceSettings, notify: Notify) -> ImageSource:
    """Open what `settings.source` names; the settings are those of parameters.SOURCE_PARAMETERS.

    Raises SourceError, in one sentence that names the source and the mend.
    """
    name = settings.source.strip()
    if not name:
        raise SourceError("the parameter ~source is empty; give {}".format(CHOICE_OF_SOURCES))
    if is_live(name):
        target = "/dev/video" + name if name.isdigit() else name
        return LiveSource(target, settings.width, settings.height, settings.fit, settings.rate,
                          settings.camera_fourcc)
    path = Path(name).expanduser()
    try:
        if path.is_dir():
            return PictureSource(pictures_in(path), settings, notify)
        if not path.is_file():
            raise SourceError("{} does not exist; give {}".format(path, CHOICE_OF_SOURCES))
        with path.open("rb"):
            pass
    except OSError as error:
        raise SourceError("cannot read {}: {}; correct its permissions".format(path, error.strerror)) from error
    if path.suffix.lower() in PICTURE_SUFFIXES:
        return PictureSource([path], settings, notify)
    return VideoSource(path, settings.width, settings.height, settings.fit, settings.loop)


# Bars of a letterbox: dark and flat, so that no detector finds anything in them.
BAR_GREY = 40


def scaled(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """Return `image` resized to width x height px, with the filter that suits the direction."""
    if image.shape[1] == width and image.shape[0] == height:
        return image
    shrinking = width * height < image.shape[0] * image.shape[1]
    return cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA if shrinking else cv2.INTER_LINEAR)


def paste_centred(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """Return a (height, width, 3) canvas with `image` in its middle.

    What is larger than the canvas is cut off equally on both sides; what is smaller gets bars.
    """
    canvas = np.full((height, width, 3), BAR_GREY, np.uint8)
    rows, columns = min(height, image.shape[0]), min(width, image.shape[1])
    top, left = (height - rows) // 2, (width - columns) // 2
    from_top, from_left = (image.shape[0] - rows) // 2, (image.shape[1] - columns) // 2
    canvas[top:top + rows, left:left + columns] = image[from_top:from_top + rows, from_left:from_left + columns]
    return canvas


def fit_image(image: np.ndarray, width: int, height: int, fit: str) -> np.ndarray:
    """Return `image` (BGR, uint8) brought to width x height px; its proportions are always kept.

    letterbox: all of it is shown, with dark bars on two sides where the proportions differ.
    crop: the output is filled, and what does not fit is cut off equally on two sides.
    native: unchanged; width and height are ignored.
    Raises ValueError for another `fit`.
    """
    if fit not in FIT_CHOICES:
        raise ValueError("fit is {!r}, legal values: {}".format(fit, ", ".join(FIT_CHOICES)))
    if fit == NATIVE or image.shape[:2] == (height, width):
        return image
    choose = min if fit == LETTERBOX else max
    scale = choose(width / image.shape[1], height / image.shape[0])
    size = [max(1, int(round(side * scale))) for side in (image.shape[1], image.shape[0])]
    return paste_centred(scaled(image, size[0], size[1]), width, height)


# The vertical swing is slower than the horizontal one, by a ratio that is not a simple fraction: the path
# is a Lissajous figure, smooth everywhere, which takes long to repeat.
VERTICAL_PERIOD_RATIO = 1.37
ZOOM_PERIOD_RATIO = 1.91


class PictureMotion:
    """Pan and zoom over one picture.

    picture: (H, W, 3) BGR uint8. width, height: size of the images, px (ignored for fit `native`).
    fit: as in fit_image; with `letterbox` the whole picture stays in view during the pan, with `crop` and
    `native` the images are always filled.
    pan: swing to each side as a fraction of the image's width and height, 0 to 0.25.
    zoom: largest enlargement minus one, 0 to 1. period: of the horizontal swing, s.
    Raises ValueError for values outside these ranges.
    """

    def __init__(self, picture: np.ndarray, width: int, height: int, fit: str = LETTERBOX,
                 pan: float = 0.03, zoom: float = 0.0, period: float = 12.0) -> None:
        if not 0.0 <= pan <= 0.25:
            raise ValueError("pan is {}, legal range 0..0.25".format(pan))
        if not 0.0 <= zoom <= 1.0:
            raise ValueError("zoom is {}, legal range 0..1".format(zoom))
        if not period > 0.0:
            raise ValueError("period is {} s, it must be above 0".format(period))
        if fit == NATIVE:
            width, height, fit = picture.shape[1], picture.shape[0], CROP
        self._size = (width, height)
        self._swing = (pan * width, pan * height)
        self._zoom = zoom
        self._period = period
        self._canvas = self._scale_once(picture, fit)

    def _scale_once(self, picture: np.ndarray, fit: str) -> np.ndarray:
        """Return the canvas: the images' size, plus the swing and one pixel on each side."""
        width, height = self._size
        canvas_width, canvas_height = (side + 2 * (int(math.ceil(swing)) + 1)
                                       for side, swing in zip(self._size, self._swing))
        if fit != LETTERBOX:
            return fit_image(picture, canvas_width, canvas_height, fit)
        room = (width - 2 * self._swing[0], height - 2 * self._swing[1])
        scale = min(room[0] / picture.shape[1], room[1] / picture.shape[0])
        size = [max(1, int(side * scale)) for side in (picture.shape[1], picture.shape[0])]
        return paste_centred(scaled(picture, size[0], size[1]), canvas_width, canvas_height)

    def window(self, elapsed: float) -> Tuple[float, float, float]:
        """Return left and top edge (px of the canvas) and the enlargement (1 or more) after `elapsed` s."""
        phase = 2.0 * math.pi * elapsed / self._period
        enlargement = 1.0 + self._zoom * 0.5 * (1.0 - math.cos(phase / ZOOM_PERIOD_RATIO))
        swing = (math.sin(phase), math.sin(phase / VERTICAL_PERIOD_RATIO))
        centre = [side / 2.0 + reach * part
                  for side, reach, part in zip(self._canvas.shape[1::-1], self._swing, swing)]
        return (centre[0] - self._size[0] / enlargement / 2.0,
                centre[1] - self._size[1] / enlargement / 2.0, enlargement)

    def view(self, elapsed: float) -> np.ndarray:
        """Return the (height, width, 3) BGR image after `elapsed` s of showing this picture."""
        left, top, enlargement = self.window(elapsed)
        if enlargement == 1.0:
            return self._shifted(left, top)
        matrix = np.array([[1.0 / enlargement, 0.0, left], [0.0, 1.0 / enlargement, top]])
        return cv2.warpAffine(self._canvas, matrix, self._size,
                              flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_REPLICATE)

    def _shifted(self, left: float, top: float) -> np.ndarray:
        """Bilinear interpolation of a window of the canvas whose corner is between four pixels."""
        width, height = self._size
        column, row = int(math.floor(left)), int(math.floor(top))
        right_weight, lower_weight = left - column, top - row
        rows = self._canvas[row:row + height + 1]
        across = cv2.addWeighted(rows[:, column:column + width], 1.0 - right_weight,
                                 rows[:, column + 1:column + 1 + width], right_weight, 0.0)
        return cv2.addWeighted(across[:height], 1.0 - lower_weight, across[1:], lower_weight, 0.0)
