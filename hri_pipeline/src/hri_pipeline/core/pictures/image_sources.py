"""Where images come from: a video file, a directory of pictures, one picture, a camera or a network stream.

A source is used like cv2.VideoCapture: `advance` moves on and is cheap, `image` makes the picture, so that
nothing is drawn while nobody looks. Time is an argument: seconds since the source was opened.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from pathlib import Path
from types import SimpleNamespace
from typing import Callable, Optional, Sequence

import cv2
import numpy as np

from hri_pipeline.core.parameters import ParameterError
from hri_pipeline.core.pictures.image_fit import NATIVE, fit_image
from hri_pipeline.core.pictures.picture_motion import PictureMotion

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


class VideoSource(ImageSource):
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

    def image(self) -> Optional[np.ndarray]:
        """Return the present frame, None where it is damaged."""
        good, image = self._capture.retrieve()
        return fit_image(image, *self._fit) if good else None

    def close(self) -> None:
        """Close the file."""
        self._capture.release()


class LiveSource(ImageSource):
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
            self._capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter_fourcc(*fourcc))
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

    def image(self) -> Optional[np.ndarray]:
        """Return the present image, None where it is damaged."""
        good, image = self._capture.retrieve()
        return fit_image(image, *self._fit) if good else None

    def close(self) -> None:
        """Close the device."""
        self._capture.release()


class PictureSource(ImageSource):
    """Pictures one after the other, each for the same time, seen by a slowly moving camera.

    Between two pictures the image is black for a while, so that trackers let go: other people are seen next, and no
    camera cuts from one place to another.
    A picture that cannot be read is skipped and reported once through `notify`.
    Raises SourceError when none can be read.
    """

    def __init__(self, paths: Sequence[Path], settings: SimpleNamespace, notify: Notify) -> None:
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


def _in_reading_order(path: Path) -> list:
    """Sort key: picture2 comes before picture10."""
    return [(0, int(part), "") if part.isdigit() else (1, 0, part.lower())
            for part in re.split(r"(\d+)", path.name) if part]


def pictures_in(directory: Path) -> list:
    """Return the picture files of a directory in reading order. Raises SourceError when there is none."""
    paths = sorted((path for path in directory.iterdir() if path.suffix.lower() in PICTURE_SUFFIXES),
                   key=_in_reading_order)
    if not paths:
        raise SourceError("directory {} holds no picture ({}); give another, or put some there".format(
            directory, " ".join(PICTURE_SUFFIXES)))
    return paths


def is_live(source: str) -> bool:
    """Tell whether `source` names a camera or a stream."""
    return source.isdigit() or source.startswith("/dev/") or "://" in source


def open_source(settings: SimpleNamespace, notify: Notify) -> ImageSource:
    """Open what `settings.source` names; the settings are those of source_parameters.

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
