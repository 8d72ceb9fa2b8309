"""Sound of an ALSA device, recorded by a child process."""

from __future__ import annotations

import os
import select
import shutil
import subprocess
import time
from typing import IO, Optional

import numpy as np

from hri_pipeline.core.parent_death_signal import ends_with_parent

_WAIT_S = 2.0
_KEPT_CHARACTERS = 2000
_WIDTH = 2
# A device without a clock (ALSA's null) gives sound as fast as it is read.
_AHEAD_S = 0.5


class SoundDeviceError(OSError):
    """A device that cannot be opened, or has gone; the text names it and the mend."""


class SoundDevice:
    """`arecord` on one device, S16LE; the child ends with the thread that made this object (see ends_with_parent).

    name: as `arecord -L` shows it. rate: Hz. Raises SoundDeviceError when arecord is not installed. One thread uses it; it must live as
    long as the device is read.
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
            if not select.select([self._sound, self._errors], [], [], max(0.0, deadline - time.monotonic()))[0]:
                raise SoundDeviceError("microphone {} gives no sound for {:.0f} s; is it plugged in, and free? Its last "
                                       "words: {}".format(self._name, _WAIT_S, self._last_words()))
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
            pipe.close()

    def _keep_pace(self) -> None:
        """Wait where the device gives sound faster than it can have heard it."""
        now = time.monotonic()
        self._begun = now if self._begun is None else self._begun
        ahead = self._given / self._rate - (now - self._begun)
        if ahead > _AHEAD_S:
            # Nothing is lost: the pipe holds the child back.
            select.select([], [], [], ahead - _AHEAD_S)

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
