"""The voices node: sound in, voices out."""

from __future__ import annotations

import threading
import time
import traceback
from collections import deque
from types import SimpleNamespace
from typing import Callable, Deque, Dict, Set, Tuple

import rospy

from hri_pipeline.core.parameters import take_over
from hri_pipeline.core.sound.sound_clock import STALL_S
from hri_pipeline.core.sound.sound_stream import RATE, SoundBlock
from hri_pipeline.core.timing import StageTimes
from hri_pipeline.core.voices.voice_turns import check_thresholds
from hri_pipeline.ros.diagnostics import ERROR, OK, WARN, NodeDiagnostics
from hri_pipeline.ros.sound.sound_intake import SoundIntake
from hri_pipeline.ros.voices.voice_branch import VoiceBranch

_WAIT_S = 0.1
_REPORT_S = 1.0
_LOG_PERIOD_S = 10.0
_WINDOW = 300
# Work that takes more than this share of the sound's time does not keep up with it for long.
_TOO_SLOW = 0.9


class VoicesNode:
    """Takes sound from the intake and gives it to the branch, in the thread that calls spin().

    A block that makes the branch raise is lost, and nothing else. When no sound comes for STALL_S of ROS time, turns
    end; for `silence_time` s, all voices are let go. settings: the values of voice_parameters.VOICES.
    """

    def __init__(self, settings: SimpleNamespace) -> None:
        self._settings = settings
        self._lock = threading.RLock()
        self._closed = threading.Event()
        self._branch = VoiceBranch(settings)
        self._intake = SoundIntake(settings, self._restart)
        self._diagnostics = NodeDiagnostics(rospy.get_name())
        self._work: Deque[Tuple[float, float]] = deque(maxlen=_WINDOW)
        self._ages: Deque[float] = deque(maxlen=_WINDOW)
        self._times = StageTimes(_WINDOW)
        self._errors = 0
        self._last_error: Tuple[str, float] = ("", float("-inf"))
        self._traced: Set[str] = set()
        self._reported = float("-inf")
        rospy.on_shutdown(self._closed.set)

    def spin(self) -> None:
        """Work until ROS shuts down or close() is called."""
        heard, is_quiet = rospy.get_time(), True
        while not self._closed.is_set() and not rospy.is_shutdown():
            blocks = self._intake.next(_WAIT_S)
            for block in blocks:
                self._guard(lambda block=block: self._process(block))
            self._guard(self._branch.poll)
            if blocks:
                heard, is_quiet = rospy.get_time(), False
            elif not is_quiet:
                heard = min(heard, rospy.get_time())     # simulated time may go back
                is_quiet = self._wait(rospy.get_time() - heard)
            if time.monotonic() - self._reported >= _REPORT_S:
                self._reported = time.monotonic()
                self._guard(self._report)

    def reconfigure(self, settings: SimpleNamespace) -> None:
        """Take up the values of the live parameters between two blocks. ValueError for thresholds in the wrong order."""
        check_thresholds(settings)
        with self._lock:
            take_over(self._settings, settings)
            self._branch.reconfigure(settings)

    def close(self) -> None:
        """Stop spin() and give everything back. Idempotent."""
        self._closed.set()
        for owner in (self._intake, self._branch, self._diagnostics):
            try:
                owner.close()
            except Exception:
                rospy.logerr("%s did not close:\n%s", type(owner).__name__, traceback.format_exc())

    def _process(self, block: SoundBlock) -> None:
        started = time.perf_counter()
        with self._times("block"):
            self._branch.process(block)
        length = len(block.samples) / RATE
        self._work.append((time.perf_counter() - started, length))
        self._ages.append(rospy.get_time() - block.stamp - length)

    def _wait(self, seconds: float) -> bool:
        """No sound has come for `seconds`; tells whether all voices have been let go."""
        if seconds >= STALL_S or seconds >= self._settings.silence_time:
            self._guard(lambda: self._branch.idle(seconds))
        if seconds < self._settings.silence_time:
            return False
        self._guard(self._branch.let_go)
        return True

    def _restart(self) -> None:
        self._ages.clear()
        self._guard(self._branch.reset)

    def _guard(self, call: Callable[[], None]) -> None:
        """Run; count and tell an error, with the traceback once for each kind."""
        try:
            with self._lock:
                call()
        except Exception as error:  # one block never ends the node
            self._errors += 1
            text = "{}: {}".format(type(error).__name__, error)
            self._last_error = (text, time.monotonic())
            place = traceback.extract_tb(error.__traceback__)[-1]
            kind = "{}:{}:{}".format(type(error).__name__, place.filename, place.lineno)
            if kind not in self._traced:
                self._traced.add(kind)
                rospy.logerr("%s; this sound is skipped\n%s", text, traceback.format_exc())
            else:
                rospy.logerr_throttle(_LOG_PERIOD_S, "%s; this sound is skipped", text)

    def _report(self) -> None:
        self._diagnostics.set("input", *self._intake.status())
        self._diagnostics.set("pipeline", *self._pipeline())
        for task, status in self._branch.status().items():
            self._diagnostics.set(task, *status)

    def _pipeline(self) -> Tuple[int, str, Dict[str, object]]:
        work, length = sum(cost for cost, _ in self._work), sum(length for _, length in self._work)
        values: Dict[str, object] = {"errors": self._errors,
                                     "dropped_messages": self._intake.counts["dropped_messages"]}
        if self._ages:
            ages = sorted(self._ages)
            values["age_ms_median"] = 1e3 * ages[len(ages) // 2]
            values["age_ms_p95"] = 1e3 * ages[int(0.95 * (len(ages) - 1))]
        values.update(self._times.values())
        if length:
            values["real_time_factor"] = work / length
        if time.monotonic() - self._last_error[1] < _LOG_PERIOD_S:
            return ERROR, self._last_error[0], values
        if not length:
            return WARN, "no sound yet", values
        if work / length > _TOO_SLOW:
            return WARN, "the processor is too slow: {:.2f} s of work per second of sound; switch features or speech " \
                         "off".format(work / length), values
        return OK, "{:.3f} s of work per second of sound".format(work / length), values
