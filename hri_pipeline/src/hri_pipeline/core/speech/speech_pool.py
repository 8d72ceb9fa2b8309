"""The processes that recognise speech: who works on which utterance, and what happens when one hangs or dies."""

from __future__ import annotations

import select
import threading
from typing import Any, Callable, Dict, List, Optional

from hri_pipeline.core.restart_policy import RestartPolicy
from hri_pipeline.core.speech import speech_pipe
from hri_pipeline.core.speech.speech_engine import RATE, EngineChoice
from hri_pipeline.core.speech.speech_pipe import PipeError, Report, unpack_fields, unpack_report
from hri_pipeline.core.speech.speech_process import SpeechProcess
from hri_pipeline.core.speech.speech_utterance import Utterance

# A busy machine, and a sentence that is decoded as a whole, take their time.
HANG_S = 30.0
# Loading a large model from a slow disk.
_LOAD_S = 120.0
# A process beyond the first that has had nothing to do for so long is ended: it holds memory.
_SPARE_S = 60.0
_IDLE_S = 5.0
# Utterances that wait, beyond those that are worked on. Who speaks now is worth more than who has spoken.
_MOST_UTTERANCES = 16
# An utterance whose sound has killed so many processes is given up.
_MOST_DEATHS = 2

Publish = Callable[[Utterance, int, str, Optional[float]], None]


class SpeechPool:
    """Up to speech_max_speakers processes. add(), forget(), values() from any thread, all else from one.

    lock: held by who calls add() and forget(). publish: called with utterance, samples, text and confidence (None: text
    so far) of each result, without the lock.
    """

    def __init__(self, choice: EngineChoice, settings: Any, lock: threading.Lock, publish: Publish,
                 hang_time: float) -> None:
        self.engine = choice.engine
        self.failed = ""
        """Why there is no recognition, and will be none; empty while there may be."""
        self.problem, self.problem_at = "", float("-inf")
        self._choice = choice
        self._partial_rate, self._nice = settings.speech_partial_rate, settings.speech_nice
        self._limit = settings.speech_max_speakers
        self._lock, self._publish, self._hang_time = lock, publish, hang_time
        self._utterances: Dict[int, Utterance] = {}
        self._processes: List[SpeechProcess] = []
        self._policy = RestartPolicy()
        self._next_start = 0.0
        self._counts = dict.fromkeys(("speech_utterances", "speech_restarts", "speech_hangs", "speech_lost"), 0)
        self._busy = self._heard = 0.0

    def add(self, utterance: Utterance) -> bool:
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

    def tell(self, problem: str, now: float) -> None:
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
            self._listen(process, now)
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

    def _process_of(self, utterance: Utterance) -> Optional[SpeechProcess]:
        return next((process for process in self._processes if process.utterance == utterance.number), None)

    def _place(self, utterance: Utterance, now: float) -> None:
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
            process.end(utterance.number)
            utterance.asked = True
            return
        ended = utterance.ended
        while process.has_room:
            data = utterance.take()
            if data is None:
                break
            process.hear(utterance.number, data)
        if ended and utterance.sent == utterance.accepted:
            process.end(utterance.number)
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
            self.tell("the recogniser's process does not start: {}".format(error), now)

    # -- what they say

    def _listen(self, process: SpeechProcess, now: float) -> None:
        process.listen()
        try:
            messages, closed = process.read()
            for kind, body in messages:
                self._hear(process, kind, body, now)
        except PipeError as error:
            self._end(process, now, str(error))
            return
        if closed and process in self._processes:
            self._end(process, now, "")

    def _hear(self, process: SpeechProcess, kind: int, body: bytes, now: float) -> None:
        process.idle_since = now
        if kind == speech_pipe.READY:
            process.ready = True
        elif kind == speech_pipe.FAILED:
            self.failed = str(unpack_fields(body).get("message", "the recogniser does not say why"))
        elif kind in (speech_pipe.PROGRESS, speech_pipe.PARTIAL, speech_pipe.FINAL):
            self._report(process, kind, unpack_report(body))
        else:
            raise PipeError("the recogniser sent a message of kind {}".format(kind))

    def _report(self, process: SpeechProcess, kind: int, report: Report) -> None:
        utterance = self._utterances.get(report.utterance)
        if utterance is None or process.utterance != report.utterance:
            raise PipeError("the recogniser speaks of utterance {}, which it does not work on".format(report.utterance))
        self._busy += report.busy
        self._heard += utterance.progress(report.samples) / RATE
        final = kind == speech_pipe.FINAL
        # A process that hears the sound once more tells nothing that was told before.
        if final or (kind == speech_pipe.PARTIAL and utterance.done == utterance.heard):
            self._publish(utterance, utterance.heard, report.text, report.confidence if final else None)
        if final:
            process.utterance = None
            self._remove(utterance)

    def _remove(self, utterance: Utterance) -> None:
        with self._lock:
            self._utterances.pop(utterance.number, None)

    # -- what goes wrong

    def _watch(self, now: float) -> None:
        """End those that hang, and those that have been spare for long."""
        for process in list(self._processes):
            silent = now - process.idle_since
            utterance = self._utterances.get(process.utterance) if process.utterance is not None else None
            if not process.ready and now - process.started > _LOAD_S:
                self._end(process, now, "it has not loaded its model within {:.0f} s".format(_LOAD_S))
            elif utterance is not None and (utterance.asked or utterance.sent > utterance.done) and silent > self._hang_time:
                self._counts["speech_hangs"] += 1
                self._end(process, now, "it hung for {:.0f} s".format(silent))
            elif process.ready and utterance is None and len(self._processes) > 1 and silent > _SPARE_S:
                self._processes.remove(process)
                process.close()

    def _end(self, process: SpeechProcess, now: float, reason: str) -> None:
        """A process has died, or must: another one hears its utterance from the beginning."""
        self._processes.remove(process)
        process.listen()
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
            ": " + process.last_words if process.last_words else "")
        self.tell("the recogniser of speech was lost, {}; starting it again{}".format(
            what, " in {:.1f} s".format(wait) if wait else ""), now)

    def _orphan(self, utterance: Utterance) -> None:
        utterance.deaths += 1
        if utterance.deaths >= _MOST_DEATHS:
            self._counts["speech_lost"] += 1
            self._publish(utterance, utterance.heard, "", 0.0)
            self._remove(utterance)
