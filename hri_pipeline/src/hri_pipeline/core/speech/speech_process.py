"""One recogniser process, as its owner sees it: pipes that never block, and what it said last."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections import deque
from pathlib import Path
from typing import Deque, List, Optional, Tuple

from hri_pipeline.core.speech import speech_pipe
from hri_pipeline.core.speech.speech_engine import EngineChoice
from hri_pipeline.core.speech.speech_pipe import MessageReader, pack_fields, pack_number

_CHUNK = 1 << 16
_KEPT_WORDS = 2000
# Bytes that wait here for the pipe (which holds 64 KiB): about 2 s of sound. More waits in the utterance.
_ENOUGH = 1 << 16
_CLOSE_S = 3.0


class SpeechProcess:
    """A running recogniser. The thread that makes it must live as long as it: the process dies with that thread.

    now: s, monotonic. Raises OSError when the process cannot be started.
    """

    def __init__(self, choice: EngineChoice, partial_rate: float, nice: int, now: float) -> None:
        root = str(Path(__file__).resolve().parents[3])
        path = os.pathsep.join([root] + [place for place in sys.path if place])
        # A directory of its own and not that of the user, whose files Python would import.
        self._popen = subprocess.Popen(
            [sys.executable, "-m", "hri_pipeline.core.speech.speech_worker", str(os.getpid()), str(nice)], bufsize=0,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=root, start_new_session=True,
            env=dict(os.environ, PYTHONPATH=path))
        self.input, self.output, self.errors = self._popen.stdin, self._popen.stdout, self._popen.stderr
        for pipe in (self.input, self.output, self.errors):
            os.set_blocking(pipe.fileno(), False)
        self._reader = MessageReader()
        self._waiting: Deque[memoryview] = deque()
        self._bytes_waiting = 0
        self._said = ""
        self.started = now
        self.ready = False
        self.utterance: Optional[int] = None
        """Number of the utterance that it works on."""
        self.idle_since = now
        self.send(pack_fields(speech_pipe.CONFIGURE, dict(choice._asdict(), partial_rate=partial_rate)))

    @property
    def pid(self) -> int:
        """Process id."""
        return self._popen.pid

    @property
    def last_words(self) -> str:
        """The last line on its standard error, empty when it was silent."""
        lines = [line.strip() for line in self._said.splitlines() if line.strip()]
        return lines[-1] if lines else ""

    @property
    def has_room(self) -> bool:
        """Tell whether more sound may be sent."""
        return self._bytes_waiting < _ENOUGH

    @property
    def wants_to_write(self) -> bool:
        """Tell whether something waits for the pipe."""
        return bool(self._waiting)

    def begin(self, utterance: int) -> None:
        """Begin an utterance."""
        self.utterance = utterance
        self.send(pack_number(speech_pipe.START, utterance))

    def hear(self, utterance: int, samples: bytes) -> None:
        """Send 16-bit samples."""
        self.send(pack_number(speech_pipe.AUDIO, utterance, samples))

    def end(self, utterance: int) -> None:
        """Ask for the text of the whole utterance."""
        self.send(pack_number(speech_pipe.END, utterance))

    def send(self, message: bytes) -> None:
        """Let a message wait for the pipe; write() sends it."""
        self._waiting.append(memoryview(message))
        self._bytes_waiting += len(message)

    def write(self) -> None:
        """Send what the pipe takes now. A pipe that is closed takes nothing: the end is noticed elsewhere."""
        while self._waiting:
            try:
                sent = os.write(self.input.fileno(), self._waiting[0])
            except BlockingIOError:
                return
            except OSError:
                self._waiting.clear()
                self._bytes_waiting = 0
                return
            self._bytes_waiting -= sent
            rest = self._waiting.popleft()[sent:]
            if rest:
                self._waiting.appendleft(rest)

    def read(self) -> Tuple[List[Tuple[int, bytes]], bool]:
        """Return the messages that have come (kind, body), and whether the process has closed its side.

        Raises speech_pipe.PipeError for what is no message.
        """
        messages: List[Tuple[int, bytes]] = []
        while True:
            try:
                data = os.read(self.output.fileno(), _CHUNK)
            except BlockingIOError:
                return messages, False
            if not data:
                return messages, True
            messages += self._reader.feed(data)

    def listen(self) -> bool:
        """Read what it says on its standard error; tell whether that is closed."""
        while True:
            try:
                data = os.read(self.errors.fileno(), _CHUNK)
            except BlockingIOError:
                return False
            if not data:
                return True
            self._said = (self._said + data.decode("utf-8", "replace"))[-_KEPT_WORDS:]

    def poll(self) -> Optional[int]:
        """Return the exit code, negative for a signal, None while it runs."""
        return self._popen.poll()

    def close(self) -> int:
        """Kill it if it still runs, wait for it, close the pipes; return the exit code. Idempotent."""
        if self._popen.poll() is None:
            self._popen.kill()
        for pipe in (self.input, self.output, self.errors):
            pipe.close()
        try:
            return self._popen.wait(_CLOSE_S)
        except subprocess.TimeoutExpired:
            return -signal.SIGKILL  # it will be, when the machine comes to it

