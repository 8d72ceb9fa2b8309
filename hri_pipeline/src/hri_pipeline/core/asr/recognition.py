"""Recognition of speech beside everything else: in processes of its own, which may be slow, hang or die."""

from __future__ import annotations

import math
import os
import select
import threading
import time
import traceback
from dataclasses import dataclass
from typing import Dict, List, Optional, Tuple

import numpy as np

from hri_pipeline.core.asr.engines import AUTO, RATE, check_choice, engine_choice
from hri_pipeline.core.asr.pool import HANG_S, QueuedUtterance, SpeechPool
from hri_pipeline.core.audio.parameters import SpeechSettings
from hri_pipeline.core.audio.stream import encode_s16
from hri_pipeline.core.onnx import FETCH_HINT

OK, WARN, ERROR = 0, 1, 2
PAUSE_S = 0.16
"""So long (s) without speech may be the end of the turn: its text is made ready meanwhile."""
LONGEST_S = 30.0
"""A turn that goes on for longer is cut: recognisers keep a whole utterance in memory."""
_FALLBACK = ("speech is recognised by pocketsphinx, which errs in half of the words of free speech: "
             + FETCH_HINT.replace("get it", "get Moonshine") + ", or set speech_grammar")
_MOST_RESULTS = 1000
# How long a problem stays in diagnostics.
_TELL_S = 60.0
_CLOSE_S = 5.0


@dataclass(frozen=True)
class SpeechResult:
    """What a voice has said.

    Attributes
    ----------
    stamp : time (s) of the end of the sound that the text covers.
    incremental : text so far, which may change; empty in a final result.
    final : text of the whole utterance. Both texts are empty when the texts so far turn out to have been wrong.
    confidence : of `final`, 0 to 1.
    language : IETF tag.
    """

    voice_id: str
    stamp: float
    incremental: str
    final: str
    confidence: float
    language: str


class SpeechRecognition:
    """Turns what voices say into text.

        speech = SpeechRecognition(settings)
        speech.start(voice, stamp); speech.feed(voice, samples, stamp); speech.end(voice)
        for result in speech.poll(): ...

    All calls return at once, from any thread; a thread of this object starts the processes and talks to them.

    Parameters
    ----------
    settings : SpeechSettings
    hang_time : time (s) without a message after which a process that has work is killed.

    Raises
    ------
    ParameterError
        The settings cannot work.
    """

    def __init__(self, settings: SpeechSettings, hang_time: float = HANG_S) -> None:
        choice = engine_choice(settings)
        check_choice(choice)
        self._language = choice.language
        is_fallback = settings.speech_engine == AUTO and choice.engine == "pocketsphinx" and not choice.grammar
        self._hint = _FALLBACK if is_fallback and not choice.model else ""
        self._limit = settings.speech_queue
        self.least_confidence = settings.speech_min_confidence
        self._lock = threading.Lock()
        self._open: Dict[str, QueuedUtterance] = {}
        self._number = 0
        self._results: List[SpeechResult] = []
        self._dropped = self._refused = 0
        self._dropped_at = float("-inf")
        self._pool = SpeechPool(choice, settings, self._lock, self._publish, hang_time)
        self._closing = False
        self._wake_read, self._wake_write = os.pipe()
        os.set_blocking(self._wake_read, False)
        os.set_blocking(self._wake_write, False)
        self._thread = threading.Thread(target=self._run, name="speech recognition", daemon=True)
        self._thread.start()

    @staticmethod
    def enabled(settings: SpeechSettings) -> bool:
        """Tell whether the settings ask for recognition at all."""
        return bool(settings.speech_engine)

    def start(self, voice_id: str, stamp: float) -> None:
        """Begin an utterance of a voice at `stamp` (s); one that is open is ended."""
        with self._lock:
            self._finish(voice_id)
            self._begin(voice_id, stamp)
            self._wake()

    def feed(self, voice_id: str, samples: np.ndarray, stamp: float, speaking: bool = True) -> None:
        """Add (n,) samples from -1 to 1 at 16 kHz of a voice; stamp: time (s) of the first; speaking: no pause.

        A voice that was not started is ignored. Sound beyond speech_queue is dropped and counted.
        Raises ValueError for samples of another shape.
        """
        if np.ndim(samples) != 1:
            raise ValueError("recognition of speech needs one channel, not samples of shape {}".format(
                np.shape(samples)))
        data = encode_s16(samples)
        with self._lock:
            utterance = self._open.get(voice_id)
            if utterance is None or not data:
                return
            if utterance.accepted > LONGEST_S * RATE:
                self._finish(voice_id)
                utterance = self._begin(voice_id, stamp)
            # In pieces: a process must not be silent for long because of a long block.
            for place in range(0, len(data), RATE):
                dropped = utterance.add(data[place:place + RATE], stamp + place / 2.0 / RATE)
                if dropped:
                    self._dropped += dropped
                    self._dropped_at = time.monotonic()
            self._note_pause(utterance, speaking, len(data) // 2)
            self._wake()

    def end(self, voice_id: str, stamp: float = math.inf) -> None:
        """End the utterance of a voice; its final text comes from poll() later.

        stamp: s, behind which the sound is of somebody else.
        """
        with self._lock:
            if voice_id in self._open:
                self._open[voice_id].end_at(stamp)
            self._finish(voice_id)
            self._wake()

    def drop(self, voice_id: str) -> None:
        """Forget a voice: no results of it come any more."""
        with self._lock:
            self._finish(voice_id)
            self._pool.forget(voice_id)
            self._results = [result for result in self._results if result.voice_id != voice_id]
            self._wake()

    def poll(self) -> List[SpeechResult]:
        """Return what was recognised since the last call, in order."""
        with self._lock:
            results, self._results = self._results, []
        return results

    def status(self) -> Tuple[int, str, Dict[str, object]]:
        """Return level (0 ok, 1 warning, 2 error), message and values for diagnostics."""
        now = time.monotonic()
        values = self._pool.values()
        with self._lock:
            dropped = round(self._dropped / RATE, 2)
            values.update(speech_dropped_s=dropped, speech_unsure=self._refused)
            late = now - self._dropped_at < _TELL_S
        if self._pool.failed:
            return ERROR, "speech is not recognised: {}".format(self._pool.failed), values
        if now - self._pool.problem_at < _TELL_S:
            return WARN, self._pool.problem, values
        if late:
            return WARN, ("recognition of speech is too slow, {:.1f} s of sound were dropped: use a grammar, or allow "
                          "more voices (speech_max_speakers) where there are processors").format(dropped), values
        if self._hint:
            return WARN, self._hint, values
        return OK, "speech is recognised by {}".format(self._pool.engine), values

    def close(self) -> None:
        """End all processes. Idempotent."""
        with self._lock:
            if self._closing:
                return
            self._closing = True
            self._open.clear()
            # After the flag: the thread may read the byte and check the flag at once.
            self._signal()
        self._thread.join(_CLOSE_S)
        if not self._thread.is_alive():
            os.close(self._wake_read)
            os.close(self._wake_write)

    # -- the caller holds the lock

    def _begin(self, voice_id: str, stamp: float) -> QueuedUtterance:
        self._number = (self._number + 1) % (1 << 32)
        utterance = QueuedUtterance(self._number, voice_id, stamp, self._limit)
        if not self._closing and self._pool.add(utterance):
            self._open[voice_id] = utterance
        return utterance

    @staticmethod
    def _note_pause(utterance: QueuedUtterance, speaking: bool, fresh: int) -> None:
        """Tell the recogniser once that the speaker pauses; `fresh`: samples that were just added."""
        if speaking:
            utterance.spoken = utterance.accepted
            return
        silence = utterance.accepted - utterance.spoken
        if silence - fresh < PAUSE_S * RATE <= silence:
            utterance.add_pause()

    def _finish(self, voice_id: str) -> None:
        utterance = self._open.pop(voice_id, None)
        if utterance is not None:
            utterance.ended = True

    # -- the thread

    def _publish(self, utterance: QueuedUtterance, samples: int, text: str, confidence: Optional[float]) -> None:
        """Note a result, from the thread; confidence None: text so far."""
        final = confidence is not None
        with self._lock:
            if confidence is not None and text and confidence < self.least_confidence:
                self._refused += 1
                text = ""
            # An empty final text is published when it withdraws an earlier text.
            if utterance.unwanted or (not text and not utterance.text) or (not final and text == utterance.text):
                return
            utterance.text = text
            self._results.append(SpeechResult(
                utterance.voice_id, utterance.stamp_of(samples), "" if final else text, text if final else "",
                float(confidence or 0.0) if text else 0.0, self._language))
            del self._results[:-_MOST_RESULTS]

    def _wake(self) -> None:
        if not self._closing:  # after that the descriptor may be in use for another file
            self._signal()

    def _signal(self) -> None:
        try:
            os.write(self._wake_write, b"x")
        except BlockingIOError:
            pass  # it has been woken often enough

    def _run(self) -> None:
        try:
            while not self._closing:
                try:
                    self._turn()
                except Exception:  # whatever happens, the node and the other voices go on
                    self._pool.note_problem(traceback.format_exc(limit=-1).strip().splitlines()[-1], time.monotonic())
                    time.sleep(0.1)
        finally:
            self._pool.close()

    def _turn(self) -> None:
        """Do what is to be done, and wait until there is more."""
        wait = self._pool.step(time.monotonic())
        # Made anew each time: descriptors of dead processes come back as those of new ones.
        poll = select.poll()
        poll.register(self._wake_read, select.POLLIN)
        for descriptor, events in self._pool.descriptors().items():
            poll.register(descriptor, events)
        if self._wake_read in dict(poll.poll(max(0.0, wait) * 1000.0)):
            os.read(self._wake_read, 4096)
