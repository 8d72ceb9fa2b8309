"""The process that recognises speech: `python -m hri_pipeline.core.speech.speech_worker`, started by SpeechProcess.

It reads messages of speech_pipe on its standard input and writes them to its standard output. It ends when its input
ends, and when the process that started it dies.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import time
from typing import Callable, Optional, Tuple

import numpy as np

from hri_pipeline.core.parameters import ParameterError
from hri_pipeline.core.speech import speech_pipe
from hri_pipeline.core.speech.speech_engine import RATE, EngineChoice, SpeechEngine, make_engine
from hri_pipeline.core.speech.speech_pipe import MessageReader, Report, pack_fields, pack_report

_PR_SET_PDEATHSIG = 1
_CHUNK = 1 << 16
# Exit code of a choice of engine that will not do any better next time.
REFUSED = 3


class SpeechWorker:
    """Answers messages. send: called with each answer, ready for the pipe."""

    def __init__(self, send: Callable[[bytes], None]) -> None:
        self._send = send
        self._engine: Optional[SpeechEngine] = None
        self._partial_samples = 0
        self._utterance: Optional[int] = None
        self._samples = self._next_partial = 0
        self._text = ""
        self._busy = time.process_time()

    def answer(self, kind: int, body: bytes) -> None:
        """Do what a message asks. Raises ParameterError for an engine that does not load, PipeError for nonsense."""
        if kind == speech_pipe.CONFIGURE:
            self._configure(body)
            return
        if self._engine is None:
            raise speech_pipe.PipeError("a message of kind {} came before the choice of an engine".format(kind))
        number, rest = speech_pipe.unpack_number(body)
        if kind == speech_pipe.START:
            self._engine.start()
            self._utterance, self._samples, self._text = number, 0, ""
            self._next_partial = self._partial_samples
        elif number != self._utterance:
            return
        elif kind == speech_pipe.AUDIO:
            self._hear(rest)
        elif kind == speech_pipe.END:
            self._report(speech_pipe.FINAL, *self._engine.finish())
            self._utterance = None

    def close(self) -> None:
        """Free the engine. Idempotent."""
        if self._engine is not None:
            self._engine.close()
            self._engine = None

    def _configure(self, body: bytes) -> None:
        fields = speech_pipe.unpack_fields(body)
        rate = float(fields.pop("partial_rate"))
        self._partial_samples = int(RATE / rate) if rate > 0.0 else 0
        self.close()
        self._engine = make_engine(EngineChoice(**{name: str(value) for name, value in fields.items()}))
        self._send(speech_pipe.pack(speech_pipe.READY))

    def _hear(self, data: bytes) -> None:
        samples = np.frombuffer(data[:len(data) // 2 * 2], dtype="<i2")
        self._engine.feed(samples)
        self._samples += len(samples)
        if self._partial_samples and self._samples >= self._next_partial:
            self._next_partial = self._samples + self._partial_samples
            text = self._engine.partial()
            if text != self._text:
                self._text = text
                self._report(speech_pipe.PARTIAL, text, 0.0)
                return
        self._report(speech_pipe.PROGRESS, "", 0.0)

    def _report(self, kind: int, text: str, confidence: float) -> None:
        now = time.process_time()
        busy, self._busy = now - self._busy, now
        self._send(pack_report(kind, Report(self._utterance or 0, self._samples, confidence, busy, text)))


def end_with_parent(parent: int) -> None:
    """Let the kernel kill this process when the thread that started it ends (prctl(2), PR_SET_PDEATHSIG)."""
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent:
        os._exit(0)


def _take_pipes() -> Tuple[int, int]:
    """Input and output for messages; what a library prints goes to standard error."""
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
            for kind, body in reader.feed(data):
                worker.answer(kind, body)
    except ParameterError as error:
        send(pack_fields(speech_pipe.FAILED, {"message": str(error)}))
        return REFUSED
    except speech_pipe.PipeError as error:
        print(error, file=sys.stderr)
        return 1
    except BrokenPipeError:
        return 0
    finally:
        worker.close()


if __name__ == "__main__":
    sys.exit(main())
