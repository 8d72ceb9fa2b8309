"""The processes that recognise speech, seen from the node: which one works on which utterance, and what happens when
one hangs or dies. The process itself is worker.py.
"""

from __future__ import annotations

import select
import threading
from collections import deque
from typing import Callable, Deque, Dict, List, Optional, Tuple

from hri_pipeline.core.asr import worker
from hri_pipeline.core.asr.engines import RATE, EngineChoice
from hri_pipeline.core.asr.worker import PipeError, SpeechMessage, SpeechProcess
from hri_pipeline.core.audio.parameters import SpeechSettings
from hri_pipeline.core.process import RestartPolicy

HANG_S = 30.0
"""Longest time (s) without a message; long, because a sentence is decoded as a whole and the machine may be busy."""
# Loading a large model from a slow disk.
_LOAD_S = 120.0
# A process beyond the first is ended when it was idle for this time, because it holds memory.
_SPARE_S = 60.0
_IDLE_S = 5.0
# Utterances that wait, beyond those that are worked on. What is said now matters more than what was said before.
_MOST_UTTERANCES = 16
# An utterance is given up when this many processes have died of its sound.
_MOST_DEATHS = 2


class QueuedUtterance:
    """What one voice says in one turn: sound that waits for a process, and the time of each part of it.

    All its sound is kept until it is over: when a process dies, another one gets it from the beginning.

    Parameters
    ----------
    number : of the utterance, in the messages.
    voice_id : of the voice that speaks.
    stamp : time (s) of its beginning.
    limit : sound (s) that may wait.
    """

    def __init__(self, number: int, voice_id: str, stamp: float, limit: float) -> None:
        self.number = number
        self.voice_id = voice_id
        self.text = ""
        """What was published last."""
        self.accepted = 0
        """Samples taken so far, those dropped not counted."""
        self.spoken = 0
        """Samples up to the last word."""
        self.sent = self.done = 0
        """Samples sent to the present process, and samples that it has worked on."""
        self.heard = 0
        """The most samples that any process has worked on."""
        self.deaths = 0
        self.ended = self.asked = self.unwanted = False
        self._limit = int(limit * RATE)
        self._sound: List[bytes] = []
        self._next = 0
        self._pieces: Deque[Tuple[int, int, float]] = deque()   # first sample, the one behind the last, stamp (s)
        self._stamp = stamp

    @property
    def waiting(self) -> float:
        """Sound that waits or is being worked on, s."""
        return (self.accepted - self.heard) / RATE

    def add(self, data: bytes, stamp: float) -> int:
        """Let 16-bit samples wait; stamp: s, of the first. Returns the number of samples that found no room."""
        count = len(data) // 2
        if self.accepted - self.heard + count > self._limit:
            return count
        self._pieces.append((self.accepted, self.accepted + count, stamp))
        self._sound.append(data)
        self.accepted += count
        return 0

    def add_pause(self) -> None:
        """Note that the speaker pauses behind the sound so far."""
        self._sound.append(b"")

    def take(self) -> Optional[bytes]:
        """Return the next sound to send, empty for a pause, None when there is none."""
        if self._next >= len(self._sound):
            return None
        data = self._sound[self._next]
        self._next += 1
        self.sent += len(data) // 2
        return data

    def end_at(self, stamp: float) -> None:
        """Note that nothing was said behind `stamp` (s): in the last piece that began by then, as sound that came late
        stands close together."""
        if self._pieces:
            begin, end, start = next((piece for piece in reversed(self._pieces) if piece[2] <= stamp), self._pieces[0])
            self.spoken = max(0, min(self.spoken, int(round(min(end, begin + (stamp - start) * RATE)))))

    def rewind(self) -> None:
        """Begin from the first sample, with another process."""
        self._next = self.sent = self.done = 0
        self.asked = False

    def progress(self, samples: int) -> int:
        """Note that the present process has worked on `samples` samples; return how many are new to all processes."""
        self.done = min(samples, self.sent)
        new = max(0, self.done - self.heard)
        self.heard += new
        return new

    def stamp_of(self, samples: int) -> float:
        """Return the stamp, s, of the end of the first `samples` samples; what lies before is forgotten."""
        while len(self._pieces) > 1 and self._pieces[0][1] < samples:
            self._pieces.popleft()
        if self._pieces:
            begin, end, start = self._pieces[0]
            self._stamp = start + (min(end, samples) - begin) / RATE
        return self._stamp


Publish = Callable[[QueuedUtterance, int, str, Optional[float]], None]


class SpeechPool:
    """Up to speech_max_speakers processes. add(), forget() and values() from any thread, all else from one.

    Parameters
    ----------
    choice : the engine of all processes.
    settings : SpeechSettings
    lock : held by the caller of add() and forget().
    publish : called with utterance, samples, text and confidence (None: text so far) of each result, without the lock.
    hang_time : time (s) without a message after which a process that has work is killed.
    """

    def __init__(self, choice: EngineChoice, settings: SpeechSettings, lock: threading.Lock, publish: Publish,
                 hang_time: float) -> None:
        self.engine = choice.engine
        self.failed = ""
        """Why there is no recognition, and will be none; empty while there may be."""
        self.problem, self.problem_at = "", float("-inf")
        self._choice = choice
        self._partial_rate, self._nice = settings.speech_partial_rate, settings.speech_nice
        self._limit = settings.speech_max_speakers
        self._lock, self._publish, self._hang_time = lock, publish, hang_time
        self._utterances: Dict[int, QueuedUtterance] = {}
        self._processes: List[SpeechProcess] = []
        self._policy = RestartPolicy()
        self._next_start = 0.0
        self._counts = dict.fromkeys(("speech_utterances", "speech_restarts", "speech_hangs", "speech_lost"), 0)
        self._busy = self._heard = 0.0

    def add(self, utterance: QueuedUtterance) -> bool:
        """Take an utterance, whose sound comes later; False where there is no recognition or too many wait."""
        if self.failed or len(self._utterances) >= self._limit + _MOST_UTTERANCES:
            self._counts["speech_lost"] += 1
            return False
        self._utterances[utterance.number] = utterance
        self._counts["speech_utterances"] += 1
        return True

    def forget(self, voice_id: str) -> None:
        """Drop all utterances of a voice."""
        for utterance in self._utterances.values():
            if utterance.voice_id == voice_id:
                utterance.unwanted = True

    def values(self) -> Dict[str, object]:
        """Return values for diagnostics."""
        processes, utterances = list(self._processes), list(self._utterances.values())
        values: Dict[str, object] = {
            "speech_engine": self.engine, "speech_processes": len(processes),
            "speech_ready": sum(process.ready for process in processes),
            "speech_waiting_s": round(max([utterance.waiting for utterance in utterances], default=0.0), 2)}
        values.update(self._counts)
        if self._heard:
            values["speech_real_time_factor"] = round(self._busy / self._heard, 3)
        return values

    def note_problem(self, problem: str, now: float) -> None:
        """Note what went wrong, for diagnostics."""
        self.problem, self.problem_at = problem, now

    def descriptors(self) -> Dict[int, int]:
        """Return what to wait for, {descriptor: events of select.poll}."""
        wanted: Dict[int, int] = {}
        for process in self._processes:
            wanted[process.output.fileno()] = wanted[process.errors.fileno()] = select.POLLIN
            if process.wants_to_write:
                wanted[process.input.fileno()] = select.POLLOUT
        return wanted

    def step(self, now: float) -> float:
        """Do all that can be done at `now` (s, monotonic); return for how long nothing need be done unless woken."""
        for process in list(self._processes):
            self._receive(process, now)
        self._watch(now)
        with self._lock:
            waiting = [utterance for utterance in self._utterances.values() if not self._process_of(utterance)]
        for utterance in waiting:
            self._place(utterance, now)
        self._start(now)
        for process in self._processes:
            self._supply(process, now)
            process.write()
        due = self._next_start - now if not self._processes and not self.failed else _IDLE_S
        return min(max(due, 0.0), 1.0 if self._busy_processes() else _IDLE_S)

    def close(self) -> None:
        """End all processes. Idempotent."""
        while self._processes:
            self._processes.pop().close()
        with self._lock:
            self._utterances.clear()

    # -- work

    def _busy_processes(self) -> List[SpeechProcess]:
        return [process for process in self._processes if process.utterance is not None or not process.ready]

    def _process_of(self, utterance: QueuedUtterance) -> Optional[SpeechProcess]:
        return next((process for process in self._processes if process.utterance == utterance.number), None)

    def _place(self, utterance: QueuedUtterance, now: float) -> None:
        """Give a process that is free to an utterance that waits."""
        if utterance.unwanted or self.failed:
            self._remove(utterance)
            return
        free = next((process for process in self._processes if process.ready and process.utterance is None), None)
        if free is not None:
            utterance.rewind()
            free.begin(utterance.number)
            free.idle_since = now

    def _supply(self, process: SpeechProcess, now: float) -> None:
        """Send a process what it has room for of its utterance."""
        utterance = self._utterances.get(process.utterance) if process.utterance is not None else None
        if utterance is None or utterance.asked:
            return
        if utterance.sent == utterance.done:
            process.idle_since = now
        if utterance.unwanted:
            process.end(utterance.number, 0)
            utterance.asked = True
            return
        ended = utterance.ended
        while process.has_room:
            data = utterance.take()
            if data is None:
                break
            if data:
                process.add_sound(utterance.number, data)
            else:
                process.pause(utterance.number)
        if ended and utterance.sent == utterance.accepted:
            process.end(utterance.number, utterance.spoken)
            utterance.asked = True

    def _start(self, now: float) -> None:
        """Start a process where one is needed: the first always, others for utterances that wait."""
        if self.failed or now < self._next_start or len(self._processes) >= self._limit:
            return
        with self._lock:
            waiting = sum(not self._process_of(utterance) for utterance in self._utterances.values())
        coming = sum(process.utterance is None for process in self._processes)
        if self._processes and waiting <= coming:
            return
        try:
            self._processes.append(SpeechProcess(self._choice, self._partial_rate, self._nice, now))
        except OSError as error:
            self._next_start = now + self._policy.ended(0.0) + 1.0
            self.note_problem("the recogniser's process does not start: {}".format(error), now)

    # -- answers

    def _receive(self, process: SpeechProcess, now: float) -> None:
        process.read_errors()
        try:
            messages, closed = process.read()
            for message in messages:
                self._handle(process, message, now)
        except PipeError as error:
            self._end(process, now, str(error))
            return
        if closed and process in self._processes:
            self._end(process, now, "")

    def _handle(self, process: SpeechProcess, message: SpeechMessage, now: float) -> None:
        process.idle_since = now
        if message.kind == worker.READY:
            process.ready = True
        elif message.kind == worker.FAILED:
            self.failed = message.text or "the recogniser does not say why"
        elif message.kind in (worker.PROGRESS, worker.PARTIAL, worker.FINAL):
            self._report(process, message)
        else:
            raise PipeError("the recogniser sent a message of kind {}".format(message.kind))

    def _report(self, process: SpeechProcess, message: SpeechMessage) -> None:
        utterance = self._utterances.get(message.utterance)
        if utterance is None or process.utterance != message.utterance:
            raise PipeError(
                "the recogniser speaks of utterance {}, which it does not work on".format(message.utterance)
            )
        self._busy += message.busy
        self._heard += utterance.progress(message.samples) / RATE
        final = message.kind == worker.FINAL
        # A process that gets the sound once more must not publish the same text again.
        if final or (message.kind == worker.PARTIAL and utterance.done == utterance.heard):
            self._publish(utterance, utterance.heard, message.text, message.confidence if final else None)
        if final:
            process.utterance = None
            self._remove(utterance)

    def _remove(self, utterance: QueuedUtterance) -> None:
        with self._lock:
            self._utterances.pop(utterance.number, None)

    # -- problems

    def _watch(self, now: float) -> None:
        """End those that hang, and those that have been spare for long."""
        for process in list(self._processes):
            silent = now - process.idle_since
            utterance = self._utterances.get(process.utterance) if process.utterance is not None else None
            if not process.ready and now - process.started > _LOAD_S:
                self._end(process, now, "it has not loaded its model within {:.0f} s".format(_LOAD_S))
            elif utterance is not None and (utterance.asked
                                            or utterance.sent > utterance.done) and silent > self._hang_time:
                self._counts["speech_hangs"] += 1
                self._end(process, now, "it hung for {:.0f} s".format(silent))
            elif process.ready and utterance is None and len(self._processes) > 1 and silent > _SPARE_S:
                self._processes.remove(process)
                process.close()

    def _end(self, process: SpeechProcess, now: float, reason: str) -> None:
        """A process has died, or must: another one hears its utterance from the beginning."""
        self._processes.remove(process)
        process.read_errors()
        code = process.close()
        utterance = self._utterances.get(process.utterance) if process.utterance is not None else None
        if utterance is not None:
            self._orphan(utterance)
        if self.failed:
            return
        self._counts["speech_restarts"] += 1
        wait = self._policy.ended(now - process.started)
        self._next_start = now + wait
        what = reason or "it ended ({}){}".format(
            "signal {}".format(-code) if code < 0 else "code {}".format(code),
            ": " + process.last_error if process.last_error else "")
        self.note_problem("the recogniser of speech was lost, {}; starting it again{}".format(
            what, " in {:.1f} s".format(wait) if wait else ""), now)

    def _orphan(self, utterance: QueuedUtterance) -> None:
        utterance.deaths += 1
        if utterance.deaths >= _MOST_DEATHS:
            self._counts["speech_lost"] += 1
            self._publish(utterance, utterance.heard, "", 0.0)
            self._remove(utterance)
