"""What the inputs of images and of sound have in common: one sender at a time, silence, and problems told in time."""

from __future__ import annotations

import threading
import time
from typing import Dict, List, Optional, Tuple

import genpy
import rospy

from hri_pipeline.core.error_log import Outage
from hri_pipeline.core.images import other_transport
from hri_pipeline.ros.master import IMAGE_TYPES, type_of
from hri_pipeline.ros.rospy_compat import sender_of

SILENCE_S = 3.0
# A silence is logged again only if there was something for so long without a gap.
CALM_S = 10.0
LOG_PERIOD_S = 10.0
_NEW_PROBLEM_S = 1.0
_WARN_PERIOD_S = 30.0
_MOST_OTHERS = 20
# How long the master is waited for.
_MASTER_S = 1.0


class OneSender:
    """Uses the messages of one publisher of a topic at a time: the first whose messages can be read, while it sends.

    timeout: s without a message after which another publisher is used. Times are in s, of a clock that never jumps. The
    caller holds a lock.
    """

    def __init__(self, timeout: float) -> None:
        self.timeout = timeout
        self._used_at = float("-inf")
        self._others: Dict[str, float] = {}
        self.used = ""
        """Name of the publisher that is used, empty without one."""

    def accepts(self, sender: str, now: float) -> bool:
        """Return whether a message of this publisher, which has come at `now`, is to be read."""
        if sender == self.used:
            self._used_at = now
        elif self.used and now - self._used_at < self.timeout:
            self._others.pop(sender, None)
            self._others[sender] = now
            if len(self._others) > _MOST_OTHERS:
                del self._others[next(iter(self._others))]
            return False
        return True

    def was_read(self, sender: str, is_readable: bool, now: float) -> None:
        """Use this publisher from now on, unless its message could not be read."""
        if is_readable and sender != self.used:
            self.used, self._used_at = sender, now
        elif not is_readable and sender == self.used:
            self.used = ""

    def others(self, now: float) -> List[str]:
        """Return the names of the publishers whose messages were not accepted in the last SILENCE_S."""
        self._others = {name: at for name, at in self._others.items() if now - at < SILENCE_S}
        return sorted(self._others)


class CarriedType:
    """Knows whether a topic carries another type than a subscriber reads; the master is asked every LOG_PERIOD_S."""

    def __init__(self, subscriber: rospy.Subscriber) -> None:
        self._topic, self._read = subscriber.resolved_name, subscriber.type
        self._carried, self._asked = "", float("-inf")

    def problem(self) -> str:
        """Return what is carried and what to give instead, empty where the type is right or nobody publishes."""
        if time.monotonic() > self._asked + LOG_PERIOD_S:
            self._carried = type_of(self._topic, _MASTER_S)
            self._asked = time.monotonic()
        if self._carried in ("", "*", self._read):
            return ""
        mend = "give a topic of that type"
        if self._carried == IMAGE_TYPES["compressed"]:
            mend = "give {} with image_transport:=compressed".format(other_transport(self._topic)[0]) \
                if self._topic.endswith("/compressed") else "republish it as raw"
        return "it carries {}, not {}: {}".format(self._carried, self._read, mend)


class SensorInput:
    """An input whose callbacks only store; what comes is read in the thread of the worker.

    Parameters
    ----------
    name, what, device
        Of the topic, a word for one message, and where it comes from: `image`, `image`, `camera`.
    hints
        What to do without a publisher, and what to ask where there is one that is silent.
    timeout
        See OneSender.
    """

    def __init__(self, name: str, what: str, device: str, hints: Tuple[str, str], timeout: float) -> None:
        self.topic = rospy.resolve_name(name)
        self._what, self._device, self._hints = what, device, hints
        self._condition = threading.Condition()
        self._heard = time.monotonic()
        self._first = 0.0
        self._outage = Outage(CALM_S)
        self._senders = OneSender(timeout)
        self._told: Tuple[str, float] = ("", float("-inf"))
        self._elsewhere = self._told_elsewhere = ""
        self._silence_told = False
        self._warned: Dict[str, float] = {}
        self._subscribers: List[rospy.Subscriber] = []
        self._carried: Optional[CarriedType] = None
        self._closed = False

    def _accepts(self, message: genpy.Message) -> bool:
        """Note that a message has come; return whether it is of the publisher that is used. The caller holds the
        lock."""
        now = time.monotonic()
        if not self._senders.accepts(sender_of(message), now):
            return False
        if self._silence_told:
            rospy.loginfo("%s: %s comes in, after %.0f s without", self.topic, self._what, now - self._heard)
        self._silence_told = False
        self._heard = now
        self._outage.there(now)
        self._first = self._first or now
        return True

    def _other_sender(self) -> str:
        """Return which other publishers of the topic are ignored, in words; empty without one."""
        with self._condition:
            others, used = self._senders.others(time.monotonic()), self._senders.used
        return "{}: {} sends too, only {} is heard; give each {} its own topic".format(
            self.topic, ", ".join(others), used, self._device) if others else ""

    def _warn(self, kind: str, text: str) -> None:
        """Log a warning, if there is a text: one of each kind every _WARN_PERIOD_S."""
        now = time.monotonic()
        if text and now - self._warned.get(kind, float("-inf")) > _WARN_PERIOD_S:
            self._warned[kind] = now
            rospy.logwarn("%s", text)

    def _silence(self) -> str:
        """Return why nothing comes, empty while something does."""
        silent = time.monotonic() - self._heard
        if silent < SILENCE_S or self._closed:
            return ""
        wrong = self._wrong_type()
        if wrong:
            self._elsewhere = wrong
            return "no {} on {} for {:.0f} s: {}".format(self._what, self.topic, silent, wrong)
        if not any(subscriber.get_num_connections() for subscriber in self._subscribers if subscriber.impl):
            return "no publisher on {} for {:.0f} s{}; {}".format(self.topic, silent, *self._mend())
        return "no {} on {} for {:.0f} s, although it has a publisher; {}".format(self._what, self.topic, silent,
                                                                                  self._hints[1])

    def _wrong_type(self) -> str:
        """Return what the topic carries that cannot be read, empty where that is not the cause."""
        if self._carried is None and self._subscribers:
            self._carried = CarriedType(self._subscribers[0])
        return self._carried.problem() if self._carried is not None else ""

    def _mend(self) -> Tuple[str, str]:
        """Return what else there is where nobody publishes the topic, and what to do."""
        return "", self._hints[0]

    def _warn_of_silence(self) -> None:
        text = self._silence()
        if not text:
            return
        with self._condition:
            is_to_tell = self._outage.is_to_tell()
        if is_to_tell or (self._elsewhere and self._elsewhere != self._told_elsewhere):
            self._told_elsewhere, self._silence_told = self._elsewhere, True
            rospy.logwarn("%s", text)

    def _tell(self, problem: str) -> None:
        """Log a problem with a message: a new problem soon, the same one every LOG_PERIOD_S."""
        told, at = self._told
        if time.monotonic() - at > (LOG_PERIOD_S if problem == told else _NEW_PROBLEM_S):
            rospy.logerr("%s", problem)
            self._told = (problem, time.monotonic())
