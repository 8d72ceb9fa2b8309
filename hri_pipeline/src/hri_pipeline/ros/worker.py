"""The loop of a node: takes what comes from its input, image after image or sound after sound, and works on it."""

from __future__ import annotations

import math
import threading
import time
import traceback
from collections import deque
from typing import Any, Callable, Deque, Dict, Iterable, List, Optional, Protocol, Sequence, Tuple

import numpy as np
import rospy

from hri_pipeline.core.error_log import NewErrors
from hri_pipeline.core.faces.parameters import CameraSettings
from hri_pipeline.core.privacy import joined
from hri_pipeline.core.process import set_niceness
from hri_pipeline.core.resources import Cores
from hri_pipeline.core.setup_check import NO_IMAGE_YET
from hri_pipeline.core.timing import EARLY, StageTimes, StampPacer
from hri_pipeline.ros.diagnostics import ERROR, OK, WARN, NodeDiagnostics, Status
from hri_pipeline.ros.image_input import Frame, ImageInput
from hri_pipeline.ros.mounting import CameraMounting
from hri_pipeline.ros.privacy import PrivacyTopic

_WAIT_S = 0.5
_REPORT_S = 1.0
# Without an image for so long, nothing is tracked any more.
_SILENCE_S = 2.0
_LOG_PERIOD_S = 10.0
# The niceness of a node is set so long after its first image, so that it soon finds the people who are there.
_NICE_AFTER_S = 5.0


class Processor(Protocol):
    """Works on each image. It may have `name`, `data_use` (DataUse) and `status()` -> (level, message, values) as
    well."""

    def process(self, frame: Frame, context: dict) -> None:
        """Work on one image; `context` carries results to the next processors, "times" (StageTimes), and in s the
        "age" of the image, and what the last one "took"."""

    def reconfigure(self, settings: CameraSettings) -> None:
        """Apply new values of the live parameters."""

    def reset(self) -> None:
        """Forget all tracks: time has jumped back, or the images have changed."""

    def close(self) -> None:
        """Give everything back."""


class Worker:
    """Works on what its input gives, in the thread that calls spin(), until close() is called or ROS shuts down.

    An error costs what it was raised by, and nothing else; it is logged with its traceback once for each kind. Once a
    second diagnostics tell of the input, of the loop (`pipeline`) and of each task. A subclass says how to take, to
    work and to rest.

    Parameters
    ----------
    what
        A word for one item, for the log.
    source
        Has status() and close().
    diagnostics
        Closed by close(), as the source is.
    window
        Items over which times and ages are told.
    """

    def __init__(self, what: str, source: Any, diagnostics: NodeDiagnostics, window: int = 100) -> None:
        self._what, self._input, self._diagnostics = what, source, diagnostics
        self._lock = threading.RLock()
        self._closed = threading.Event()
        self._ages: Deque[float] = deque(maxlen=window)
        self._errors: Dict[str, int] = {}
        self._last_error = ""
        self._error_at = self._reported = float("-inf")
        self._kinds = NewErrors()
        self.times = StageTimes(window)

    def spin(self) -> None:
        """Work until ROS shuts down or close() is called."""
        heard, quiet = rospy.get_time(), True
        while not self._closed.is_set() and not rospy.is_shutdown():
            items: List[Any] = []
            self._attempt("input", lambda items=items: items.extend(self._take()), locked=False)
            for item in items:
                self.process(item)
            self._after()
            if items:
                heard, quiet = rospy.get_time(), False
            elif not quiet:
                heard = min(heard, rospy.get_time())     # simulated time may go back
                quiet = self._rest(rospy.get_time() - heard)
            if time.monotonic() - self._reported >= _REPORT_S:
                self._reported = time.monotonic()
                self._attempt("report", self._report)

    def close(self) -> None:
        """Stop spin() and close what belongs to it. Idempotent."""
        if self._closed.is_set():
            return
        self._closed.set()
        for owner in [self._input, *self._owned(), self._diagnostics]:
            try:
                owner.close()
            except Exception:
                rospy.logerr("%s did not close:\n%s", type(owner).__name__, traceback.format_exc())

    def process(self, item: Any) -> Any:
        """Work on one item."""
        raise NotImplementedError

    def _take(self) -> Sequence[Any]:
        """Return what has come; waits a little for it."""
        raise NotImplementedError

    def _after(self) -> None:
        """Do what is to be done whether something has come or not."""

    def _rest(self, seconds: float) -> bool:
        """Nothing has come for `seconds` of ROS time; return whether that has had all its consequences."""
        raise NotImplementedError

    def _owned(self) -> Iterable[Any]:
        """Return what is to be closed between input and diagnostics."""
        raise NotImplementedError

    def _load(self) -> Status:
        """Return level, message and values of the loop; ages, times and errors are told besides."""
        raise NotImplementedError

    def _statuses(self) -> Iterable[Tuple[str, Callable[[], Status]]]:
        """Yield the tasks, and who tells of each."""
        raise NotImplementedError

    def _attempt(self, name: str, call: Callable[[], Any], locked: bool = True) -> None:
        """Run `call`, by default under the lock; count and log an error of the part `name`."""
        try:
            if not locked:
                call()
                return
            with self._lock:
                call()
        except Exception as error:  # one item never ends the node
            self._errors[name] = self._errors.get(name, 0) + 1
            self._last_error = "{}: {}: {}".format(name, type(error).__name__, error)
            self._error_at = time.monotonic()
            text = "{}; this {} is skipped".format(self._last_error, self._what)
            if self._kinds.is_new(error):
                rospy.logerr("%s\n%s", text, traceback.format_exc())
            else:
                rospy.logerr_throttle(_LOG_PERIOD_S, "%s", text)

    def _report(self) -> None:
        self._diagnostics.set("input", *self._input.status())
        self._diagnostics.set("pipeline", *self._pipeline())
        for name, status in self._statuses():
            self._attempt(name, lambda name=name, status=status: self._diagnostics.set(name, *status()))

    def _pipeline(self) -> Status:
        level, text, values = self._load()
        if self._ages:
            median, high = 1e3 * np.percentile(list(self._ages), (50, 95))
            values.update(age_ms_median=float(median), age_ms_p95=float(high))
        values.update(self.times.values())
        values.update(("errors_" + name, count) for name, count in self._errors.items())
        if time.monotonic() - self._error_at < _LOG_PERIOD_S:
            level, text = ERROR, self._last_error
        return level, text, values


class VisionWorker(Worker):
    """Gives the newest image to all processors in turn.

    Diagnostics hold the rate, the age of the images, the dropped images, the time of each stage, and the cores that may
    be used. When no image comes for `silence` s of ROS time, the processors are reset, so that nobody stays tracked;
    while a bag is paused, ROS time stands still, too. max_rate: Hz, 0 for no limit. nice: see set_niceness(); it is set
    some seconds after the first image. mounting: decides by how much images are turned; None: not at all.
    """

    def __init__(self, image_input: ImageInput, processors: Sequence[Processor], diagnostics: NodeDiagnostics,
                 max_rate: float = 0.0, silence: float = _SILENCE_S, nice: int = 0,
                 mounting: Optional[CameraMounting] = None) -> None:
        super().__init__("image", image_input, diagnostics)
        self._processors, self._mounting = list(processors), mounting
        self._pacer = StampPacer(max_rate, EARLY)
        self._silence = silence
        self._nice, self._nice_at = nice, math.inf
        self._took = 0.0
        self._cores = Cores()
        self._ended: Deque[float] = deque(maxlen=300)
        image_input.on_restart = self.reset
        uses = [processor.data_use for processor in self._processors if hasattr(processor, "data_use")]
        self._privacy = PrivacyTopic(joined(uses)) if uses else None

    def process(self, frame: Frame) -> dict:
        """Give one image to all processors; return the context with their results."""
        began = time.monotonic()
        context: dict = {"times": self.times, "took": self._took}
        if not rospy.Time.now().is_zero():
            context["age"] = (rospy.Time.now() - frame.header.stamp).to_sec()
        with self._lock, self.times("frame"):
            self._attempt("frame", lambda: self._work(frame, context))
        self._ended.append(time.monotonic())
        self._took = time.monotonic() - began
        now = rospy.Time.now()
        if not now.is_zero():
            self._ages.append((now - frame.header.stamp).to_sec())
        self._set_niceness(time.monotonic())
        return context

    def reset(self) -> None:
        """Reset all processors: they forget their tracks."""
        with self._lock:
            self._ages.clear()
            for processor in self._processors:
                self._attempt(_name(processor), processor.reset)

    def reconfigure(self, settings: CameraSettings) -> None:
        """Apply new values of the live parameters between two images; from any thread."""
        with self._lock:
            self._pacer.set_rate(settings.max_rate)
            for processor in self._processors:
                processor.reconfigure(settings)

    def _work(self, frame: Frame, context: dict) -> None:
        """Turn the image upright, and give it to all processors."""
        if self._mounting is not None:
            frame = self._mounting.orient(frame, context)
        for processor in self._processors:
            self._attempt(_name(processor), lambda processor=processor: self._run(processor, frame, context))

    def _run(self, processor: Processor, frame: Frame, context: dict) -> None:
        with self.times(_name(processor)):
            processor.process(frame, context)

    def _set_niceness(self, now: float) -> None:
        if self._nice_at == math.inf:
            self._nice_at = now + _NICE_AFTER_S
        elif now >= self._nice_at and self._nice:
            set_niceness(self._nice)
            self._nice = 0

    def _take(self) -> Sequence[Frame]:
        frame = self._input.next(_WAIT_S, self._pacer.is_due)
        return () if frame is None else (frame,)

    def _rest(self, seconds: float) -> bool:
        if seconds <= self._silence + self._pacer.period:
            return False
        self.reset()
        return True

    def _owned(self) -> Iterable[Any]:
        return [one for one in (*self._processors[::-1], self._mounting, self._privacy) if one is not None]

    def _statuses(self) -> Iterable[Tuple[str, Callable[[], Status]]]:
        return [(_name(processor), processor.status) for processor in self._processors if hasattr(processor, "status")]

    def _load(self) -> Status:
        rate, counts = self._rate(), self._input.counts
        values: Dict[str, object] = {"rate_hz": rate, "dropped_images": counts["received"] - counts["taken"]}
        values.update(self._cores.values())
        level, text = OK, ""
        if self._mounting is not None:
            values.update(self._mounting.values())
            level, text = self._mounting.status()
        if not self._ended:
            return WARN, NO_IMAGE_YET, values
        return level, text or "{:.1f} images/s".format(rate), values

    def _rate(self) -> float:
        """Images per second over the last 5 s."""
        now = time.monotonic()
        recent = [ended for ended in self._ended if now - ended <= 5.0]
        return len(recent) / max(now - recent[0], 0.2) if len(recent) > 1 else 0.0


def _name(processor: Processor) -> str:
    return getattr(processor, "name", type(processor).__name__)
