"""The process that recognises speech, and the messages between it and the node.

`python -m hri_pipeline.core.asr.worker` is started by `SpeechProcess`. It reads messages on its standard input and
writes them to its standard output. It ends when its input ends, and when the process that started it dies.

A message is a header of fixed length, whose numbers are little-endian, and a body. Nothing in it is code, and whatever
does not look like a message is refused. Neither side waits for the rest of a message: the other one may hang in the
middle of it.
"""

from __future__ import annotations

import ctypes
import json
import math
import os
import signal
import struct
import subprocess
import sys
import time
from collections import deque
from pathlib import Path
from typing import Callable, Deque, List, NamedTuple, Optional, Tuple

import numpy as np

from hri_pipeline.core.asr.engines import RATE, EngineChoice, SpeechEngine, make_engine
from hri_pipeline.core.parameters import ParameterError

_MARK = b"HR"
_HEADER = struct.Struct("<2sBxIIffI")   # mark, kind, utterance, samples, confidence, busy, length of the body
LONGEST_BODY = 1 << 20

CONFIGURE, START, AUDIO, END, PAUSE = 1, 2, 3, 4, 5
"""Kinds of messages from the node: engine (JSON), begin of an utterance, 16-bit samples of it, its end, a pause."""
READY, FAILED, PROGRESS, PARTIAL, FINAL = 65, 66, 67, 68, 69
"""Kinds of messages from the process: the engine is loaded, or why not; sound was worked on, text so far, whole
text."""
_KINDS = {CONFIGURE, START, AUDIO, END, PAUSE, READY, FAILED, PROGRESS, PARTIAL, FINAL}

_PR_SET_PDEATHSIG = 1
_CHUNK = 1 << 16
REFUSED = 3
"""Exit code of a choice of engine that will not do any better next time."""
_KEPT_ERROR_TEXT = 2000
# Bytes that wait here for the pipe (which holds 64 KiB): about 2 s of sound. More waits in the utterance.
_ENOUGH = 1 << 16
_CLOSE_S = 3.0


class PipeError(ValueError):
    """The bytes that came through the pipe are not a message."""


class SpeechMessage(NamedTuple):
    """One message.

    Attributes
    ----------
    utterance : its number.
    samples : how many samples of it were worked on; of END: behind how many nothing was said.
    confidence : of its text, 0 to 1.
    busy : processor time (s) since the last message of PROGRESS, PARTIAL or FINAL.
    body : samples, text in UTF-8, or JSON.
    """

    kind: int
    utterance: int = 0
    samples: int = 0
    confidence: float = 0.0
    busy: float = 0.0
    body: bytes = b""

    @property
    def text(self) -> str:
        """The body as text."""
        return self.body.decode("utf-8", "replace")

    def packed(self) -> bytes:
        """Return the bytes for the pipe. Raises PipeError for a body that is too long."""
        if len(self.body) > LONGEST_BODY:
            raise PipeError("a message of {} bytes is too long, legal are {}".format(len(self.body), LONGEST_BODY))
        return _HEADER.pack(_MARK, *self[:5], len(self.body)) + self.body


class MessageReader:
    """Puts messages together from the bytes that a pipe gives."""

    def __init__(self) -> None:
        self._bytes = bytearray()

    def feed(self, data: bytes) -> List[SpeechMessage]:
        """Return the messages that `data` completes. Raises PipeError; after that nothing can follow."""
        self._bytes += data
        messages: List[SpeechMessage] = []
        while self._bytes:
            if not _MARK.startswith(self._bytes[:len(_MARK)]):
                raise self._error()
            if len(self._bytes) < _HEADER.size:
                break
            _, kind, utterance, samples, confidence, busy, length = _HEADER.unpack_from(self._bytes)
            if kind not in _KINDS or length > LONGEST_BODY or not (math.isfinite(confidence) and math.isfinite(busy)):
                raise self._error()
            end = _HEADER.size + length
            if len(self._bytes) < end:
                break
            messages.append(SpeechMessage(kind, utterance, samples, min(max(confidence, 0.0), 1.0), max(busy, 0.0),
                                          bytes(self._bytes[_HEADER.size:end])))
            del self._bytes[:end]
        return messages

    def _error(self) -> PipeError:
        return PipeError("what came through the pipe is no message: {!r}".format(bytes(self._bytes[:_HEADER.size])))


class SpeechProcess:
    """A running recogniser, with pipes that never block. The process dies with the thread that makes this object.

    Parameters
    ----------
    choice : the engine.
    partial_rate : texts so far per second of speech; 0: none.
    nice : added to the nice value of this process.
    now : monotonic time (s).

    Raises
    ------
    OSError
        The process cannot be started.
    """

    def __init__(self, choice: EngineChoice, partial_rate: float, nice: int, now: float) -> None:
        root = str(Path(__file__).resolve().parents[3])
        path = os.pathsep.join([root] + [place for place in sys.path if place])
        # A directory of its own and not that of the user, whose files Python would import.
        self._popen = subprocess.Popen(
            [sys.executable, "-m", __name__, str(os.getpid()), str(nice)], bufsize=0,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=root, start_new_session=True,
            env=dict(os.environ, PYTHONPATH=path))
        assert self._popen.stdin is not None and self._popen.stdout is not None and self._popen.stderr is not None
        self.input, self.output, self.errors = self._popen.stdin, self._popen.stdout, self._popen.stderr
        for pipe in (self.input, self.output, self.errors):
            os.set_blocking(pipe.fileno(), False)
        self._reader = MessageReader()
        self._waiting: Deque[memoryview] = deque()
        self._bytes_waiting = 0
        self._error_text = ""
        self.started = now
        self.ready = False
        self.utterance: Optional[int] = None
        """Number of the utterance that it works on."""
        self.idle_since = now
        fields = dict(choice._asdict(), partial_rate=partial_rate)
        self.send(SpeechMessage(CONFIGURE, body=json.dumps(fields).encode("utf-8")))

    @property
    def pid(self) -> int:
        """Process id."""
        return self._popen.pid

    @property
    def last_error(self) -> str:
        """The last line on its standard error, empty without any."""
        lines = [line.strip() for line in self._error_text.splitlines() if line.strip()]
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
        self.send(SpeechMessage(START, utterance))

    def add_sound(self, utterance: int, samples: bytes) -> None:
        """Send 16-bit samples."""
        self.send(SpeechMessage(AUDIO, utterance, body=samples))

    def pause(self, utterance: int) -> None:
        """Tell that the speaker pauses."""
        self.send(SpeechMessage(PAUSE, utterance))

    def end(self, utterance: int, spoken: int) -> None:
        """Ask for the text of the whole utterance, behind whose first `spoken` samples nothing was said."""
        self.send(SpeechMessage(END, utterance, spoken))

    def send(self, message: SpeechMessage) -> None:
        """Let a message wait for the pipe; write() sends it."""
        data = message.packed()
        self._waiting.append(memoryview(data))
        self._bytes_waiting += len(data)

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

    def read(self) -> Tuple[List[SpeechMessage], bool]:
        """Return the messages that have come, and whether the process has closed its side.

        Raises PipeError for what is no message.
        """
        messages: List[SpeechMessage] = []
        while True:
            try:
                data = os.read(self.output.fileno(), _CHUNK)
            except BlockingIOError:
                return messages, False
            if not data:
                return messages, True
            messages += self._reader.feed(data)

    def read_errors(self) -> bool:
        """Read its standard error; return whether that is closed."""
        while True:
            try:
                data = os.read(self.errors.fileno(), _CHUNK)
            except BlockingIOError:
                return False
            if not data:
                return True
            self._error_text = (self._error_text + data.decode("utf-8", "replace"))[-_KEPT_ERROR_TEXT:]

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
            return -signal.SIGKILL  # it will end as soon as the kernel gets to it


class SpeechWorker:
    """Runs an engine as messages ask. send: called with each answer, ready for the pipe."""

    def __init__(self, send: Callable[[bytes], None]) -> None:
        self._send = send
        self._engine: Optional[SpeechEngine] = None
        self._partial_samples = 0
        self._utterance: Optional[int] = None
        self._samples = self._next_partial = 0
        self._text = ""
        self._busy = time.process_time()

    def answer(self, message: SpeechMessage, more: bool = False) -> None:
        """Do what a message asks. more: others wait already, so that a text so far would come late and delay them.

        Raises ParameterError for an engine that does not load, PipeError for a malformed message.
        """
        if message.kind == CONFIGURE:
            self._configure(message)
            return
        if self._engine is None:
            raise PipeError("a message of kind {} came before the choice of an engine".format(message.kind))
        if message.kind == START:
            self._engine.start()
            self._utterance, self._samples, self._text = message.utterance, 0, ""
            self._next_partial = self._partial_samples
        elif message.utterance != self._utterance:
            return
        elif message.kind == AUDIO:
            self._feed(self._engine, message.body, more)
        elif message.kind == PAUSE:
            self._engine.pause()
            self._report_progress(self._engine)
        elif message.kind == END:
            self._report(FINAL, *self._engine.finish(message.samples))
            self._utterance = None

    def close(self) -> None:
        """Free the engine. Idempotent."""
        if self._engine is not None:
            self._engine.close()
            self._engine = None

    def _configure(self, message: SpeechMessage) -> None:
        try:
            fields = json.loads(message.text)
            rate = float(fields.pop("partial_rate"))
            choice = EngineChoice(**fields)
        except (ValueError, TypeError, AttributeError, KeyError) as error:
            raise PipeError("a message names no engine: {!r}".format(message.text[:200])) from error
        self._partial_samples = int(RATE / rate) if rate > 0.0 else 0
        self.close()
        self._engine = make_engine(choice)
        self._send(SpeechMessage(READY).packed())

    def _feed(self, engine: SpeechEngine, data: bytes, more: bool) -> None:
        samples = np.frombuffer(data[:len(data) // 2 * 2], dtype="<i2")
        engine.feed(samples)
        self._samples += len(samples)
        if self._partial_samples and self._samples >= self._next_partial and not more:
            self._report_progress(engine)
        else:
            self._report(PROGRESS, "", 0.0)

    def _report_progress(self, engine: SpeechEngine) -> None:
        """Send the text so far if it is new and wanted, else only how far the work has come."""
        self._next_partial = self._samples + self._partial_samples
        text = engine.partial() if self._partial_samples else self._text
        if text == self._text:
            self._report(PROGRESS, "", 0.0)
            return
        self._text = text
        self._report(PARTIAL, text, 0.0)

    def _report(self, kind: int, text: str, confidence: float) -> None:
        now = time.process_time()
        busy, self._busy = now - self._busy, now
        body = text.encode("utf-8")[:LONGEST_BODY]
        self._send(SpeechMessage(kind, self._utterance or 0, self._samples, confidence, busy, body).packed())


def end_with_parent(parent: int) -> None:
    """Let the kernel kill this process when the thread that started it ends (prctl(2), PR_SET_PDEATHSIG)."""
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent:
        os._exit(0)


def _take_pipes() -> Tuple[int, int]:
    """Return descriptors of input and output for messages; what a library prints goes to standard error from now on."""
    source, sink = os.dup(0), os.dup(1)
    empty = os.open(os.devnull, os.O_RDONLY)
    os.dup2(empty, 0)
    os.close(empty)
    os.dup2(2, 1)
    return source, sink


def main() -> int:
    """Run until the input ends. Arguments: process id of the parent, nice value."""
    end_with_parent(int(sys.argv[1]))
    os.nice(int(sys.argv[2]))
    source, sink = _take_pipes()
    reader = MessageReader()

    def send(message: bytes) -> None:
        view = memoryview(message)
        while view:
            view = view[os.write(sink, view):]

    worker = SpeechWorker(send)
    try:
        while True:
            data = os.read(source, _CHUNK)
            if not data:
                return 0
            messages = reader.feed(data)
            for number, message in enumerate(messages, start=1):
                worker.answer(message, more=number < len(messages))
    except ParameterError as error:
        send(SpeechMessage(FAILED, body=str(error).encode("utf-8")[:LONGEST_BODY]).packed())
        return REFUSED
    except PipeError as error:
        print(error, file=sys.stderr)
        return 1
    except BrokenPipeError:
        return 0
    finally:
        worker.close()


if __name__ == "__main__":
    sys.exit(main())
