"""Follows the ids of one kind and listens to topics of each."""

from __future__ import annotations

import threading
import time
from typing import Callable, Dict, List, Mapping, Optional, Tuple, Type

import genpy
import rospy

from hri_msgs.msg import IdsList
from hri_pipeline.core.ids import is_valid_id
from hri_pipeline.ros.diagnostics import OK, WARN
from hri_pipeline.ros.topic_release import release

OnMessage = Callable[[str, str, genpy.Message], None]
OnTracked = Callable[[List[str]], None]

# A tracked list comes once a second at least; without one for so long its node has gone.
SILENCE_S = 5.0
_LOG_PERIOD_S = 10.0
# How long a problem keeps the status at WARN; the counts stay.
_REMEMBERED_S = 30.0


class FeatureFeed:
    """Subscribes to topics of every id in /humans/<kind>/tracked and lets go of those that have left.

    Several nodes may publish the list, one for each camera: everybody whom one of them lists is followed.
    on_message(id, name, message) and on_tracked(ids) run in rospy's threads; what they raise is logged and
    counted. Ids from the graph are checked: those that may not stand in a topic name, and those beyond
    max_ids, are refused and counted. The ids of a node whose list does not come for SILENCE_S are let go.
    """

    def __init__(
        self,
        kind: str,
        topics: Mapping[str, Type[genpy.Message]],
        on_message: OnMessage,
        on_tracked: Optional[OnTracked] = None,
        max_ids: int = 50,
        silence: float = SILENCE_S,
    ) -> None:
        if max_ids < 1:
            raise ValueError("max_ids is {}, legal range 1 and more".format(max_ids))
        self._kind = kind
        self._topics = dict(topics)
        self._on_message = on_message
        self._on_tracked = on_tracked
        self._max_ids = max_ids
        self._silence = silence
        self._lock = threading.RLock()
        self._subscribers: Dict[str, List[rospy.Subscriber]] = {}
        self._counts = {"refused": 0, "beyond_limit": 0, "errors": 0}
        self._problem = ""
        self._problem_at = float("-inf")
        self._lists: Dict[str, Tuple[float, List[str]]] = {}
        self.stamp = genpy.Time()       # of the list that came last
        self._closed = threading.Event()
        self.topic = "/humans/{}/tracked".format(kind)
        self._tracked = rospy.Subscriber(self.topic, IdsList, self._on_list, queue_size=10)
        self._thread = threading.Thread(target=self._watch, name="{} feed".format(kind), daemon=True)
        self._thread.start()

    @property
    def ids(self) -> List[str]:
        """Ids that are followed now."""
        with self._lock:
            return list(self._subscribers)

    def status(self) -> Tuple[int, str, Dict[str, object]]:
        """Return level, message and values for diagnostics."""
        with self._lock:
            values: Dict[str, object] = {"followed": len(self._subscribers)}
            values.update(self._counts)
            if time.monotonic() - self._problem_at < _REMEMBERED_S:
                return WARN, self._problem, values
        if not self._tracked.impl or not self._tracked.get_num_connections():
            return WARN, "no publisher on {}; is its node running?".format(self.topic), values
        return OK, "following {} {}".format(values["followed"], self._kind), values

    def close(self) -> None:
        """Let go of all topics. Idempotent."""
        if self._closed.is_set():
            return
        self._closed.set()
        release(self._tracked)
        if self._thread is not threading.current_thread():
            self._thread.join()
        self._follow([])

    def _on_list(self, message: IdsList) -> None:
        if self._closed.is_set():
            return
        publisher = message._connection_header.get("callerid", "")
        with self._lock:
            self._lists[publisher] = (time.monotonic(), self._checked(message.ids))
            self.stamp = message.header.stamp
            ids = self._listed()
        self._follow(ids)
        self._tell(ids)

    def _checked(self, listed: List[str]) -> List[str]:
        """Return the legal ids, each once, in their order. Counts what is refused."""
        ids: List[str] = []
        seen = set()
        for identity in listed:
            if not is_valid_id(identity):
                self._note("refused", 1, "{}: refused {}, which is not an id".format(
                    self.topic, repr(identity)[:60]))
            elif identity not in seen:
                seen.add(identity)
                ids.append(identity)
        if len(ids) > self._max_ids:
            self._note("beyond_limit", len(ids) - self._max_ids, "{}: {} ids, only the first {} are followed".format(
                self.topic, len(ids), self._max_ids))
        return ids[:self._max_ids]

    def _listed(self) -> List[str]:
        """Return the ids that any publisher lists, each once; no more than max_ids."""
        ids = dict.fromkeys(identity for _, listed in self._lists.values() for identity in listed)
        return list(ids)[:self._max_ids]

    def _follow(self, ids: List[str]) -> None:
        with self._lock:
            gone = [self._subscribers.pop(identity) for identity in list(self._subscribers) if identity not in ids]
            for identity in ids:
                if identity not in self._subscribers and not self._closed.is_set():
                    self._subscribe(identity)
        # Outside the lock: unregistering waits for rospy, whose callbacks may wait for the lock.
        for subscribers in gone:
            for subscriber in subscribers:
                release(subscriber)

    def _subscribe(self, identity: str) -> None:
        # The id counts as followed before its first topic is: a latched message comes at once.
        subscribers = self._subscribers[identity] = []
        for name, kind in self._topics.items():
            subscribers.append(rospy.Subscriber(
                "/humans/{}/{}/{}".format(self._kind, identity, name), kind,
                self._on_feature, callback_args=(identity, name), queue_size=1))

    def _on_feature(self, message: genpy.Message, source: Tuple[str, str]) -> None:
        identity, name = source
        # A message may still be on its way when its id has gone.
        if self._closed.is_set() or identity not in self._subscribers:
            return
        self._guard(lambda: self._on_message(identity, name, message), "{}/{}".format(identity, name))

    def _tell(self, ids: List[str]) -> None:
        if self._on_tracked is not None:
            self._guard(lambda: self._on_tracked(ids), "tracked")

    def _guard(self, call: Callable[[], None], what: str) -> None:
        try:
            call()
        except Exception as error:  # one message never ends the node
            self._note("errors", 1, "/humans/{}/{}: message not used: {}: {}".format(
                self._kind, what, type(error).__name__, error))

    def _note(self, kind: str, count: int, text: str) -> None:
        """Count a problem, keep it for the diagnostics and tell it in the log."""
        with self._lock:
            self._counts[kind] += count
            self._problem, self._problem_at = text, time.monotonic()
        rospy.logwarn_throttle(_LOG_PERIOD_S, "%s", text)

    def _watch(self) -> None:
        while not self._closed.wait(min(1.0, self._silence)):
            with self._lock:
                silent = [publisher for publisher, (heard, listed) in self._lists.items()
                          if listed and time.monotonic() - heard > self._silence]
                for publisher in silent:
                    del self._lists[publisher]
                ids = self._listed()
            if silent:
                rospy.logwarn("%s: nothing from %s for %.0f s; letting go of its ids", self.topic,
                              ", ".join(sorted(silent)), self._silence)
                self._follow(ids)
                self._tell(ids)
