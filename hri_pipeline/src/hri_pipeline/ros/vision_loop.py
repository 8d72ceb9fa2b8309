"""Runs the branches of a vision node on image after image."""

from __future__ import annotations

import math
import threading
import time
import traceback
from collections import deque
from types import SimpleNamespace
from typing import Deque, Dict, List, Optional, Protocol, Sequence, Set

import rospy

from hri_pipeline.core.pacing import Pacer
from hri_pipeline.core.priority import stand_back
from hri_pipeline.core.setup.setup_facts import NO_IMAGE_YET
from hri_pipeline.core.timing import StageTimes
from hri_pipeline.ros.diagnostics import ERROR, OK, WARN, NodeDiagnostics
from hri_pipeline.ros.image_intake import Frame, ImageIntake

_WAIT_S = 0.5
_REPORT_S = 1.0
# Time without an image after which nobody can be said to be tracked any more.
_SILENCE_S = 2.0
_LOG_PERIOD_S = 10.0
# How long a node that stands back goes with the others after its first image.
_FORWARD_S = 5.0


class Branch(Protocol):
    """One line of work on an image. It may have `name` and `status()` -> (level, message, values) as well."""

    def process(self, frame: Frame, context: dict) -> None:
        """Work on one image; `context` carries results to the branches behind, and "times" (StageTimes)."""

    def reconfigure(self, settings: SimpleNamespace) -> None:
        """Take up the values of the live parameters."""

    def reset(self) -> None:
        """Forget all tracks: time has jumped back."""

    def close(self) -> None:
        """Give everything back."""


class VisionLoop:
    """Takes images from the intake and gives each to all branches in turn, in the thread that calls spin().

    A branch that raises loses that image and nothing else. max_rate: Hz, 0 for no limit. Rate, age of the
    images, dropped images and the time of each stage are told in diagnostics. close() closes intake,
    branches and diagnostics. When no image comes for `silence` s of ROS time (the camera is gone), the
    branches are reset, so that nobody stays tracked; a paused bag stops that time too. nice: see stand_back(); from
    some seconds after the first image on, so that a node that has just been started finds who is there.
    """

    def __init__(self, intake: ImageIntake, branches: Sequence[Branch], diagnostics: NodeDiagnostics,
                 max_rate: float = 0.0, silence: float = _SILENCE_S, nice: int = 0) -> None:
        self._intake = intake
        self._branches = list(branches)
        self._diagnostics = diagnostics
        self._pacer = _pacer(max_rate)
        self._silence = silence
        self._nice, self._stands_back_at = nice, math.inf
        self._lock = threading.RLock()
        self._closed = threading.Event()
        self._wake = threading.Event()
        self._ended: Deque[float] = deque(maxlen=300)
        self._ages: Deque[float] = deque(maxlen=100)
        self._errors: Dict[str, int] = {}
        self._last_error = ""
        self._error_at = float("-inf")
        self._traced: Set[str] = set()
        self._reported = float("-inf")
        self.times = StageTimes()
        intake.on_time_jump = self.reset

    def spin(self) -> None:
        """Work until ROS shuts down or close() is called."""
        heard, quiet = rospy.get_time(), True
        while not self._closed.is_set() and not rospy.is_shutdown():
            pacer = self._pacer
            if pacer is not None and self._wake.wait(pacer.wait(time.monotonic())):
                self._wake.clear()
                continue
            frame = self._next()
            if frame is not None:
                if pacer is not None:
                    pacer.done(time.monotonic())
                self.process(frame)
                self._stand_back(time.monotonic())
                heard, quiet = rospy.get_time(), False
            elif not quiet and rospy.get_time() - heard > self._silence:
                quiet = True
                self.reset()
            if time.monotonic() - self._reported >= _REPORT_S:
                self._reported = time.monotonic()
                self._report()

    def process(self, frame: Frame) -> dict:
        """Give one image to all branches; returns what they have put into the context."""
        context: dict = {"times": self.times}
        with self._lock, self.times("frame"):
            for branch in self._branches:
                name = _name(branch)
                try:
                    with self.times(name):
                        branch.process(frame, context)
                except Exception as error:  # one image never ends the node
                    self._failed(name, error)
        self._ended.append(time.monotonic())
        now = rospy.Time.now()
        if not now.is_zero():
            self._ages.append((now - frame.header.stamp).to_sec())
        return context

    def reset(self) -> None:
        """Let all branches forget their tracks."""
        with self._lock:
            self._ages.clear()
            for branch in self._branches:
                try:
                    branch.reset()
                except Exception as error:
                    self._failed(_name(branch), error)

    def reconfigure(self, settings: SimpleNamespace) -> None:
        """Take up the values of the live parameters between two images; from any thread."""
        with self._lock:
            self._pacer = _pacer(settings.max_rate)
            for branch in self._branches:
                branch.reconfigure(settings)
        self._wake.set()

    def close(self) -> None:
        """Stop spin() and close intake, branches (last one first) and diagnostics. Idempotent."""
        if self._closed.is_set():
            return
        self._closed.set()
        self._wake.set()
        for owner in [self._intake] + self._branches[::-1] + [self._diagnostics]:
            try:
                owner.close()
            except Exception:
                rospy.logerr("%s did not close:\n%s", type(owner).__name__, traceback.format_exc())

    def _stand_back(self, now: float) -> None:
        if self._stands_back_at == math.inf:
            self._stands_back_at = now + _FORWARD_S
        elif now >= self._stands_back_at and self._nice:
            stand_back(self._nice)
            self._nice = 0

    def _next(self) -> Optional[Frame]:
        try:
            return self._intake.next(_WAIT_S)
        except Exception as error:  # whatever came in, the next image may be good
            self._failed("input", error)
            return None

    def _failed(self, name: str, error: Exception) -> None:
        """Count and tell an error; the traceback once for each kind of error."""
        self._errors[name] = self._errors.get(name, 0) + 1
        self._last_error = "{}: {}: {}".format(name, type(error).__name__, error)
        self._error_at = time.monotonic()
        place = traceback.extract_tb(error.__traceback__)[-1]
        kind = "{}:{}:{}".format(type(error).__name__, place.filename, place.lineno)
        if kind not in self._traced:
            self._traced.add(kind)
            rospy.logerr("%s; this image is skipped\n%s", self._last_error, traceback.format_exc())
        else:
            rospy.logerr_throttle(_LOG_PERIOD_S, "%s; this image is skipped", self._last_error)

    def _report(self) -> None:
        self._diagnostics.set("input", *self._intake.status())
        self._diagnostics.set("pipeline", *self._pipeline())
        for branch in self._branches:
            if hasattr(branch, "status"):
                try:
                    self._diagnostics.set(_name(branch), *branch.status())
                except Exception as error:
                    self._failed(_name(branch), error)

    def _pipeline(self) -> tuple:
        values: Dict[str, object] = {"rate_hz": self._rate()}
        if self._ages:
            ages: List[float] = sorted(self._ages)
            values["age_ms_median"] = 1e3 * ages[len(ages) // 2]
            values["age_ms_p95"] = 1e3 * ages[int(0.95 * (len(ages) - 1))]
        counts = self._intake.counts
        values["dropped_images"] = counts["received"] - counts["taken"]
        values.update(self.times.values())
        for name, count in self._errors.items():
            values["errors_{}".format(name)] = count
        if time.monotonic() - self._error_at < _LOG_PERIOD_S:
            return ERROR, self._last_error, values
        if not self._ended:
            return WARN, NO_IMAGE_YET, values
        return OK, "{:.1f} images/s".format(values["rate_hz"]), values

    def _rate(self) -> float:
        """Images per second over the last 5 s."""
        now = time.monotonic()
        recent = [ended for ended in self._ended if now - ended <= 5.0]
        return len(recent) / max(now - recent[0], 0.2) if len(recent) > 1 else 0.0


def _pacer(max_rate: float) -> Optional[Pacer]:
    """Return what paces so many images per second, None for as many as come; ValueError below 0."""
    if max_rate < 0.0:
        raise ValueError("max_rate is {} Hz, legal range 0 and more".format(max_rate))
    return Pacer(max_rate) if max_rate > 0.0 else None


def _name(branch: Branch) -> str:
    return getattr(branch, "name", type(branch).__name__)
