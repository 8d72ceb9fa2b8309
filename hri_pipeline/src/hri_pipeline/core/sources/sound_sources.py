"""Where sound can come from: files, directories, ALSA devices."""

from __future__ import annotations

import os
import select
import shutil
import subprocess
import time
from abc import ABC, abstractmethod
from pathlib import Path
from typing import IO, Callable, List, Optional, Sequence

import numpy as np
import soundfile
import soxr

from hri_pipeline.core.parameters import ParameterError
from hri_pipeline.core.process import ends_with_parent
from hri_pipeline.core.sources import in_reading_order
from hri_pipeline.core.sources.parameters import SoundSourceSettings

SOUND_SUFFIXES = (".wav", ".flac", ".ogg", ".oga", ".opus", ".mp3", ".aif", ".aiff", ".au", ".w64", ".caf", ".raw")
CHOICE_OF_SOURCES = ("a sound file, a directory of sound files, or a microphone (alsa, or alsa:DEVICE with a name that "
                     "`arecord -L` shows)")
ALSA = "alsa"
DEVICE_RATE = 16000
_READ = 65536
Notify = Callable[[str], None]


class SoundSourceError(ParameterError):
    """What the parameter `source` names cannot be opened or read; the text names it and says what to do."""


class SoundSource(ABC):
    """What every source offers. live: a device, worth trying again. rate: Hz. read() gives what is played next."""

    live = False
    rate = DEVICE_RATE
    channels = 1
    description = ""

    @abstractmethod
    def read(self, count: int) -> Optional[np.ndarray]:
        """Return (count, channels) float32 of -1 to 1; None at the end. Raises SoundSourceError."""

    def close(self) -> None:  # noqa: B027 - not every source holds something open
        """Let go of file or device. May be called again."""


class FileSource(SoundSource):
    """Sound files one after the other, with silence behind each.

    Files of other rates are resampled, one channel is copied to all, several are mixed to one. A file that cannot be
    read is left out and told once through `notify`. Raises SoundSourceError when none can be read.
    """

    def __init__(self, paths: Sequence[Path], settings: SoundSourceSettings, notify: Notify) -> None:
        self._paths, self._settings, self._notify = list(paths), settings, notify
        self._next = 0
        self._file: Optional[_OpenFile] = None
        self.rate, self.channels = settings.sample_rate, settings.channels
        self._open_next()
        self.description = "{} ({} Hz, {} channel{})".format(
            paths[0] if len(paths) == 1 else "{} files of {}".format(len(paths), paths[0].parent), self.rate,
            self.channels, "" if self.channels == 1 else "s")

    def read(self, count: int) -> Optional[np.ndarray]:
        """Return the next samples, silence at the end of the last file included; None when all have been played."""
        parts: List[np.ndarray] = []
        missing = count
        while missing:
            if self._file is None and not self._open_next():
                break
            assert self._file is not None      # the next one was opened
            try:
                part = self._file.read(missing)
            except SoundSourceError as error:
                self.close()
                self._next -= 1
                self._leave_out(error)
                continue
            missing -= len(part)
            parts.append(part)
            if missing:
                self._file.close()
                self._file = None
        if missing == count:
            return None
        parts.append(np.zeros((missing, self.channels), np.float32))
        return np.concatenate(parts)

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def _open_next(self) -> bool:
        """Open the next file that can be read; False at the end."""
        while self._paths:
            if self._next >= len(self._paths):
                if not self._settings.loop:
                    return False
                self._next = 0
            try:
                self._file = _OpenFile(self._paths[self._next], self.rate, self.channels, self._settings)
                self.rate, self.channels = self._file.rate, self._file.channels
                self._next += 1
                return True
            except SoundSourceError as error:
                self._leave_out(error)
        return False

    def _leave_out(self, error: SoundSourceError) -> None:
        """Go on without the next file, which cannot be read; the last one must be."""
        if len(self._paths) == 1:
            raise error
        del self._paths[self._next]
        self._notify("{}; it is left out".format(error))


class _OpenFile:
    """One file, in the rate and with the channels that are wanted (0: its own), and the pause after it."""

    def __init__(self, path: Path, rate: int, channels: int, settings: SoundSourceSettings) -> None:
        raw = dict(samplerate=settings.raw_rate, channels=settings.raw_channels, format="RAW", subtype="PCM_16",
                   endian="LITTLE") if path.suffix.lower() == ".raw" else {}
        self._path = path
        try:
            self._file = soundfile.SoundFile(str(path), **raw)
        except (soundfile.LibsndfileError, RuntimeError, TypeError) as error:
            raise SoundSourceError("cannot read {}: {}; it must be sound that libsndfile knows (wav, flac, ogg, mp3), "
                                   "try: ffmpeg -i {} sound.wav".format(path, error, path.name)) from error
        self.rate, self.channels = rate or self._file.samplerate, channels or self._file.channels
        if self._file.channels not in (self.channels, 1) and self.channels != 1:
            given = self._file.channels
            self._file.close()
            raise SoundSourceError("{} has {} channels, which do not fit into {}; set ~channels to 1 or {}".format(
                path, given, self.channels, given))
        self._resampler = None if self._file.samplerate == self.rate else soxr.ResampleStream(
            self._file.samplerate, self.rate, self.channels, dtype="float32")
        self._pause = int(settings.pause * self.rate)
        self._is_read = False
        self._waiting = self._more()
        while not (len(self._waiting) or self._is_read):    # of a far lower rate a part may be too short
            self._waiting = self._more()
        if not len(self._waiting):
            self._file.close()
            raise SoundSourceError("{} holds no sound; give another".format(path))

    def read(self, count: int) -> np.ndarray:
        """Return `count` samples, fewer at the end."""
        while len(self._waiting) < count and not self._is_read:
            self._waiting = np.concatenate([self._waiting, self._more()])
        if len(self._waiting) < count and self._pause:
            silence = min(self._pause, count - len(self._waiting))
            self._pause -= silence
            self._waiting = np.concatenate([self._waiting, np.zeros((silence, self.channels), np.float32)])
        given, self._waiting = self._waiting[:count], self._waiting[count:]
        return given

    def _more(self) -> np.ndarray:
        try:
            samples = self._file.read(_READ, dtype="float32", always_2d=True)
        except (soundfile.LibsndfileError, RuntimeError) as error:
            self._file.close()
            raise SoundSourceError("{} is damaged: {}; replace it".format(self._path, error)) from error
        self._is_read = len(samples) < _READ
        if self.channels == 1:
            samples = samples.mean(axis=1, keepdims=True, dtype=np.float32)
        elif samples.shape[1] == 1:
            samples = np.repeat(samples, self.channels, axis=1)
        samples = np.ascontiguousarray(samples)
        return samples if self._resampler is None else self._resampler.resample_chunk(samples, last=self._is_read)

    def close(self) -> None:
        self._file.close()


class DeviceSource(SoundSource):
    """A microphone, through `arecord`. Raises SoundSourceError when there is none, or it goes away."""

    live = True

    def __init__(self, name: str, settings: SoundSourceSettings) -> None:
        self.rate, self.channels = settings.sample_rate or DEVICE_RATE, settings.channels or 1
        self.description = "microphone {} ({} Hz, {} channel{})".format(
            name, self.rate, self.channels, "" if self.channels == 1 else "s")
        try:
            self._device = SoundDevice(name, self.rate, self.channels)
        except SoundDeviceError as error:
            raise SoundSourceError(str(error)) from error

    def read(self, count: int) -> Optional[np.ndarray]:
        """Wait for the next samples."""
        try:
            return self._device.read(count)
        except SoundDeviceError as error:
            raise SoundSourceError(str(error)) from error

    def close(self) -> None:
        """End the recording."""
        self._device.close()


def is_live(source: str) -> bool:
    """Tell whether `source` names a device."""
    name = source.strip()
    return name == ALSA or name.startswith(ALSA + ":")


def sounds_in(directory: Path) -> List[Path]:
    """Return the sound files of a directory in reading order (2 before 10).

    Raises SoundSourceError when there is none.
    """
    paths = sorted((path for path in directory.iterdir() if path.suffix.lower() in SOUND_SUFFIXES),
                   key=in_reading_order)
    if not paths:
        raise SoundSourceError("directory {} holds no sound file ({}); give another, or put some there".format(
            directory, " ".join(SOUND_SUFFIXES)))
    return paths


def open_sound_source(settings: SoundSourceSettings, notify: Notify) -> SoundSource:
    """Open what `settings.source` names; the settings are those of parameters.SOUND_SOURCE_PARAMETERS.

    Raises SoundSourceError, in one sentence that names the source and the mend.
    """
    name = settings.source.strip()
    if not name:
        raise SoundSourceError("the parameter ~source is empty; give {}".format(CHOICE_OF_SOURCES))
    if is_live(name):
        return DeviceSource(name.partition(":")[2] or "default", settings)
    path = Path(name).expanduser()
    try:
        if path.is_dir():
            return FileSource(sounds_in(path), settings, notify)
        if not path.is_file():
            raise SoundSourceError("{} does not exist; give {}".format(path, CHOICE_OF_SOURCES))
        with path.open("rb"):
            pass
    except OSError as error:
        raise SoundSourceError("cannot read {}: {}; correct its permissions".format(path, error.strerror)) from error
    return FileSource([path], settings, notify)


_WAIT_S = 2.0
_KEPT_CHARACTERS = 2000
_WIDTH = 2
# A device without a clock (ALSA's null) gives sound as fast as it is read.
_AHEAD_S = 0.5


class SoundDeviceError(OSError):
    """A device that cannot be opened, or has gone; the text names it and the mend."""


class SoundDevice:
    """`arecord` on one device, S16LE; the child ends with the thread that made this object (see ends_with_parent).

    name: as `arecord -L` shows it. rate: Hz. Raises SoundDeviceError when arecord is not installed. One thread uses it;
    it must live as long as the device is read.
    """

    def __init__(self, name: str, rate: int, channels: int) -> None:
        command = shutil.which("arecord")
        if command is None:
            raise SoundDeviceError("there is no arecord to record microphone {}; install alsa-utils".format(name))
        arguments = [command, "-q", "-D", name, "-f", "S16_LE", "-r", str(rate), "-c", str(channels), "-t", "raw"]
        self._name, self._rate, self._channels = name, rate, channels
        self._process = subprocess.Popen(ends_with_parent(arguments), stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                                         stderr=subprocess.PIPE, start_new_session=True)
        self._sound, self._errors = self._pipe(self._process.stdout), self._pipe(self._process.stderr)
        self._waiting = b""
        self._said = ""
        self._begun: Optional[float] = None
        self._given = 0

    @property
    def pid(self) -> int:
        """Process id of the child."""
        return self._process.pid

    def read(self, count: int) -> np.ndarray:
        """Wait for (count, channels) float32. Raises SoundDeviceError when the device gives nothing any more."""
        wanted = count * self._channels * _WIDTH
        self._keep_pace()
        deadline = time.monotonic() + _WAIT_S + count / self._rate
        while len(self._waiting) < wanted:
            if not self._anything_comes(deadline - time.monotonic()):
                raise SoundDeviceError("microphone {} gives no sound for {:.0f} s; is it plugged in, and free? Its "
                                       "last words: {}".format(self._name, _WAIT_S, self._last_words()))
            self._listen_to_errors()
            chunk = self._take(wanted - len(self._waiting))
            if chunk == b"":
                self._ended()
            self._waiting += chunk or b""
        data, self._waiting = self._waiting[:wanted], self._waiting[wanted:]
        self._given += count
        return np.frombuffer(data, "<i2").reshape(-1, self._channels).astype(np.float32) / 32768.0

    def close(self) -> None:
        """End the child and close the pipes. Idempotent."""
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()
        for pipe in (self._process.stdout, self._process.stderr):
            if pipe is not None:
                pipe.close()

    def _keep_pace(self) -> None:
        """Wait where the device gives sound faster than it can have heard it."""
        now = time.monotonic()
        self._begun = now if self._begun is None else self._begun
        ahead = self._given / self._rate - (now - self._begun)
        if ahead > _AHEAD_S:
            # Nothing is lost: the pipe holds the child back.
            time.sleep(ahead - _AHEAD_S)

    def _anything_comes(self, seconds: float) -> bool:
        """Wait for sound or last words. Not by select(), which takes no descriptor above 1023."""
        poll = select.poll()
        for pipe in (self._sound, self._errors):
            poll.register(pipe, select.POLLIN)
        return bool(poll.poll(max(0.0, 1000.0 * seconds)))

    def _take(self, size: int) -> Optional[bytes]:
        """Up to `size` bytes, empty at the end, None when there are none yet."""
        try:
            return os.read(self._sound, size)
        except BlockingIOError:
            return None

    def _listen_to_errors(self) -> None:
        try:
            self._said = (self._said + os.read(self._errors, 4096).decode("utf-8", "replace"))[-_KEPT_CHARACTERS:]
        except BlockingIOError:
            pass

    def _ended(self) -> None:
        try:
            code = self._process.wait(_WAIT_S)
        except subprocess.TimeoutExpired:
            code = None
        self._listen_to_errors()
        raise SoundDeviceError("microphone {} has ended (arecord: {}, exit code {}); connect it, or choose one of "
                               "`arecord -L`".format(self._name, self._last_words(), code))

    def _last_words(self) -> str:
        lines = [line.strip() for line in self._said.splitlines() if line.strip()]
        return lines[-1] if lines else "nothing said"

    @staticmethod
    def _pipe(stream: Optional[IO[bytes]]) -> int:
        assert stream is not None
        os.set_blocking(stream.fileno(), False)
        return stream.fileno()
