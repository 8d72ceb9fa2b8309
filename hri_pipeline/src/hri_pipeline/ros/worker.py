"""Runs the processors of a vision node on image after image."""

from __future__ import annotations

import math
import sys
import threading
import time
import traceback
from collections import deque
from typing import Deque, Dict, List, Optional, Protocol, Sequence

import rospy

from hri_pipeline.core.error_log import NewErrors
from hri_pipeline.core.faces.parameters import CameraSettings
from hri_pipeline.core.privacy import joined
from hri_pipeline.core.process import set_niceness
from hri_pipeline.core.setup_check import NO_IMAGE_YET
from hri_pipeline.core.timing import Pacer, StageTimes
from hri_pipeline.ros.diagnostics import ERROR, OK, WARN, NodeDiagnostics
from hri_pipeline.ros.inputs import Frame, ImageInput
from hri_pipeline.ros.privacy import PrivacyTopic

_WAIT_S = 0.5
_REPORT_S = 1.0
# Without an image for so long, nothing is tracked any more.
_SILENCE_S = 2.0
_LOG_PERIOD_S = 10.0
# What is published waits no longer than so (s) for the thread that computes; the default of Python is 5 ms.
_SWITCH_S = 0.001
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
        """Forget all tracks: time has jumped back."""

    def close(self) -> None:
        """Give everything back."""


class VisionWorker:
    """Takes images from the input and gives each to all processors in turn, in the thread that calls spin().

    A processor that raises an error loses that image and nothing else. Diagnostics hold the rate, the age of the
    images, the dropped images and the time of each stage. close() closes input, processors and diagnostics. When no
    image comes for `silence` s of ROS time, the processors are reset, so that nobody stays tracked; while a bag is
    paused, ROS time stands still, too. max_rate: Hz, 0 for no limit. nice: see set_niceness(); it is set some seconds
    after the first image.
    """

    def __init__(self, image_input: ImageInput, processors: Sequence[Processor], diagnostics: NodeDiagnostics,
                 max_rate: float = 0.0, silence: float = _SILENCE_S, nice: int = 0) -> None:
        sys.setswitchinterval(_SWITCH_S)
        self._input = image_input
        self._processors = list(processors)
        self._diagnostics = diagnostics
        self._pacer = _pacer(max_rate)
        self._silence = silence
        self._nice, self._nice_at = nice, math.inf
        self._took = 0.0
        self._lock = threading.RLock()
        self._closed = threading.Event()
        self._wake = threading.Event()
        self._ended: Deque[float] = deque(maxlen=300)
        self._ages: Deque[float] = deque(maxlen=100)
        self._errors: Dict[str, int] = {}
        self._last_error = ""
        self._error_at = float("-inf")
        self._kinds = NewErrors()
        self._reported = float("-inf")
        self.times = StageTimes()
        image_input.on_time_jump = self.reset
        uses = [processor.data_use for processor in self._processors if hasattr(processor, "data_use")]
        self._privacy = PrivacyTopic(joined(uses)) if uses else None

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
                self._set_niceness(time.monotonic())
                heard, quiet = rospy.get_time(), False
            elif not quiet and rospy.get_time() - heard > self._silence:
                quiet = True
                self.reset()
            if time.monotonic() - self._reported >= _REPORT_S:
                self._reported = time.monotonic()
                self._report()

    def process(self, frame: Frame) -> dict:
        """Give one image to all processors; return the context with their results."""
        began = time.monotonic()
        context: dict = {"times": self.times, "took": self._took}
        if not rospy.Time.now().is_zero():
            context["age"] = (rospy.Time.now() - frame.header.stamp).to_sec()
        with self._lock, self.times("frame"):
            for processor in self._processors:
                name = _name(processor)
                try:
                    with self.times(name):
                        processor.process(frame, context)
                except Exception as error:  # one image never ends the node
                    self._failed(name, error)
        self._ended.append(time.monotonic())
        self._took = time.monotonic() - began
        now = rospy.Time.now()
        if not now.is_zero():
            self._ages.append((now - frame.header.stamp).to_sec())
        return context

    def reset(self) -> None:
        """Reset all processors: they forget their tracks."""
        with self._lock:
            self._ages.clear()
            for processor in self._processors:
                try:
                    processor.reset()
                except Exception as error:
                    self._failed(_name(processor), error)

    def reconfigure(self, settings: CameraSettings) -> None:
        """Apply new values of the live parameters between two images; from any thread."""
        with self._lock:
            self._pacer = _pacer(settings.max_rate)
            for processor in self._processors:
                processor.reconfigure(settings)
        self._wake.set()

    def close(self) -> None:
        """Stop spin() and close input, processors (last one first) and diagnostics. Idempotent."""
        if self._closed.is_set():
            return
        self._closed.set()
        self._wake.set()
        for owner in [self._input, *self._processors[::-1], self._diagnostics, self._privacy]:
            if owner is None:
                continue
            try:
                owner.close()
            except Exception:
                rospy.logerr("%s did not close:\n%s", type(owner).__name__, traceback.format_exc())

    def _set_niceness(self, now: float) -> None:
        if self._nice_at == math.inf:
            self._nice_at = now + _NICE_AFTER_S
        elif now >= self._nice_at and self._nice:
            set_niceness(self._nice)
            self._nice = 0

    def _next(self) -> Optional[Frame]:
        try:
            return self._input.next(_WAIT_S)
        except Exception as error:  # whatever came in, the next image may be good
            self._failed("input", error)
            return None

    def _failed(self, name: str, error: Exception) -> None:
        """Count and log an error; with its traceback once for each kind of error."""
        self._errors[name] = self._errors.get(name, 0) + 1
        self._last_error = "{}: {}: {}".format(name, type(error).__name__, error)
        self._error_at = time.monotonic()
        if self._kinds.is_new(error):
            rospy.logerr("%s; this image is skipped\n%s", self._last_error, traceback.format_exc())
        else:
            rospy.logerr_throttle(_LOG_PERIOD_S, "%s; this image is skipped", self._last_error)

    def _report(self) -> None:
        self._diagnostics.set("input", *self._input.status())
        self._diagnostics.set("pipeline", *self._pipeline())
        for processor in self._processors:
            if hasattr(processor, "status"):
                try:
                    self._diagnostics.set(_name(processor), *processor.status())
                except Exception as error:
                    self._failed(_name(processor), error)

    def _pipeline(self) -> tuple:
        rate = self._rate()
        values: Dict[str, object] = {"rate_hz": rate}
        if self._ages:
            ages: List[float] = sorted(self._ages)
            values["age_ms_median"] = 1e3 * ages[len(ages) // 2]
            values["age_ms_p95"] = 1e3 * ages[int(0.95 * (len(ages) - 1))]
        counts = self._input.counts
        values["dropped_images"] = counts["received"] - counts["taken"]
        values.update(self.times.values())
        for name, count in self._errors.items():
            values["errors_{}".format(name)] = count
        if time.monotonic() - self._error_at < _LOG_PERIOD_S:
            return ERROR, self._last_error, values
        if not self._ended:
            return WARN, NO_IMAGE_YET, values
        return OK, "{:.1f} images/s".format(rate), values

    def _rate(self) -> float:
        """Images per second over the last 5 s."""
        now = time.monotonic()
        recent = [ended for ended in self._ended if now - ended <= 5.0]
        return len(recent) / max(now - recent[0], 0.2) if len(recent) > 1 else 0.0


def _pacer(max_rate: float) -> Optional[Pacer]:
    """Return the pacer of so many images per second, None for no limit. Raises ValueError below 0."""
    if max_rate < 0.0:
        raise ValueError("max_rate is {} Hz, legal range 0 and more".format(max_rate))
    return Pacer(max_rate) if max_rate > 0.0 else None


def _name(processor: Processor) -> str:
    return getattr(processor, "name", type(processor).__name__)
