"""Subscribers to the topics of all ids of one kind, and to the lists that say who is tracked."""

from __future__ import annotations

import itertools
import threading
import time
from functools import partial
from typing import Callable, Dict, List, Mapping, Optional, Sequence, Tuple, Type

import genpy
import rospy

from hri_msgs.msg import IdsList
from hri_pipeline.core.ids import is_valid_id
from hri_pipeline.core.resources import require_descriptors
from hri_pipeline.ros.diagnostics import OK, WARN, Status
from hri_pipeline.ros.master import IMAGE_TYPES, PublisherAnswer, does_publish, subscribe_again
from hri_pipeline.ros.rospy_compat import (
    address_of_sender,
    connected_publishers,
    registered_together,
    release,
    sender_of,
)

OnMessage = Callable[[str, str, genpy.Message], None]
OnTracked = Callable[[List[str]], None]

_CHECK_S = 0.5
_LOG_PERIOD_S = 10.0
# How long a problem keeps the status at WARN; the counts stay.
_REMEMBERED_S = 30.0
# A list comes once a second as a rule; a publisher that is silent for so long is asked whether it is there.
_QUIET_S = 5.0
# A node that is started again, under the same name, publishes its own list within this time.
_REFUSED_S = 2.0
# A network that fails may come back; a machine that was switched off does not answer any more.
UNANSWERED_S = 30.0
_ANSWER_S = 2.0


class IdSubscribers:
    """Subscribers of `/humans/<kind>/<id>/<name>` for each id in /humans/<kind>/tracked, released when the id has left.

    Several nodes may publish the list, one for each camera: every id that one of them lists is followed. A list is
    valid until its publisher sends another one, unregisters the topic, or ends; a broken connection does not end it.
    Ids that may not stand in a topic name, and ids beyond max_ids, are refused and counted.

    The callbacks run in threads of rospy, or in the thread of this object, without a lock; errors that they raise are
    logged and counted.

    Parameters
    ----------
    kind : str
        faces, bodies, voices or persons.
    topics : mapping of str to message type
        Topics of each id, by name.
    on_message : callable
        Called with id, name of the topic, and message.
    on_tracked : callable, optional
        Called with the list of ids when it has come or changed, by one thread at a time, always with the newest ids.
    max_ids : int
        Most ids that are followed at a time.
    list_timeout : float
        s after which a list that is not repeated ends; 0 for never.
    unanswered : float
        s after which the list of a node that does not answer is ignored until it answers.
    queue_size : int
        Most messages of a topic that wait for on_message, the oldest are dropped: 1 for who wants the newest value
        only. Of images one waits, whatever this is.

    Raises
    ------
    ValueError
        For a max_ids or a queue_size below 1.
    """

    def __init__(
        self,
        kind: str,
        topics: Mapping[str, Type[genpy.Message]],
        on_message: OnMessage,
        on_tracked: Optional[OnTracked] = None,
        max_ids: int = 50,
        list_timeout: float = 0.0,
        unanswered: float = UNANSWERED_S,
        queue_size: int = 1,
    ) -> None:
        if max_ids < 1:
            raise ValueError("max_ids is {}, legal range 1 and more".format(max_ids))
        if queue_size < 1:
            raise ValueError("queue_size is {}, legal range 1 and more".format(queue_size))
        self._kind = kind
        self._queue_size = queue_size
        self._topics = dict(topics)
        self._on_message = on_message
        self._on_tracked = on_tracked
        self._max_ids = max_ids
        self._list_timeout = list_timeout
        self._lock = threading.RLock()
        self._subscribers: Dict[str, Sequence[rospy.Subscriber]] = {}
        self._counts = {"refused": 0, "beyond_limit": 0, "errors": 0}
        self._problem = ""
        self._problem_at = float("-inf")
        self._lists: Dict[str, PublishedList] = {}
        self._has_changed = self._is_updating = False
        self.stamp = genpy.Time()       # of the list that came last
        self._closed = threading.Event()
        self.topic = "/humans/{}/tracked".format(kind)
        self._watcher = PublisherWatch(self.topic, IdsList, unanswered)
        self._tracked = rospy.Subscriber(self.topic, IdsList, self._on_list, queue_size=10)
        self._thread = threading.Thread(target=self._watch, name="{} feed".format(kind), daemon=True)
        self._thread.start()

    @property
    def ids(self) -> List[str]:
        """Ids that are followed now."""
        with self._lock:
            return list(self._subscribers)

    @property
    def is_published(self) -> bool:
        """Whether anybody publishes the list, an empty one too."""
        with self._lock:
            return any(not heard.is_away for heard in self._lists.values())

    def status(self, optional: bool = False) -> Status:
        """Return level, message and values for diagnostics; optional: it is no fault that nobody publishes the list."""
        with self._lock:
            values: Dict[str, object] = {"followed": len(self._subscribers)}
            values.update(self._counts)
            if time.monotonic() - self._problem_at < _REMEMBERED_S:
                return WARN, self._problem, values
        if not self._tracked.impl or not self._tracked.get_num_connections():
            text = "no publisher on {}; is its node running?".format(self.topic)
            return OK if optional else WARN, text, values
        return OK, "following {} {}".format(values["followed"], self._kind), values

    def close(self) -> None:
        """Release all topics. Idempotent."""
        if self._closed.is_set():
            return
        self._closed.set()
        if self._thread is not threading.current_thread():
            self._thread.join()
        release(self._tracked)
        self._follow([])

    def _on_list(self, message: IdsList) -> None:
        if self._closed.is_set():
            return
        publisher = sender_of(message)
        heard = PublishedList(address_of_sender(self.topic, message), self._checked(message.ids, publisher))
        with self._lock:
            self._lists[publisher] = heard
            self.stamp = message.header.stamp
        self._update()

    def _update(self) -> None:
        """Follow the ids that are listed now, and call on_tracked.

        One thread does so at a time, without the lock: on_tracked may wait for another lock, and unregistering waits
        for rospy. Other threads only set a flag for this one, so that an older list never comes after a newer one.
        """
        with self._lock:
            self._has_changed = True
            if self._is_updating:
                return
            self._is_updating = True
        while True:
            with self._lock:
                if not self._has_changed or self._closed.is_set():
                    self._is_updating = False
                    return
                self._has_changed = False
                ids = self._listed()
            self._guard(partial(self._follow, ids), "tracked")
            if self._on_tracked is not None:
                self._guard(partial(self._on_tracked, ids), "tracked")

    def _checked(self, listed: List[str], publisher: str) -> List[str]:
        """Return the legal ids, each once, in their order. Counts what is refused."""
        ids: List[str] = []
        seen = set()
        for identity in listed:
            if not is_valid_id(identity):
                self._note("refused", 1, "{}: {} lists {}, which is refused: an id is a letter and up to 31 letters, "
                           "digits and _".format(self.topic, publisher, repr(identity)[:60]))
            elif identity not in seen:
                seen.add(identity)
                ids.append(identity)
        if len(ids) > self._max_ids:
            self._note("beyond_limit", len(ids) - self._max_ids, "{}: {} ids, only the first {} are followed".format(
                self.topic, len(ids), self._max_ids))
        return ids[:self._max_ids]

    def _listed(self) -> List[str]:
        """Return the ids that any publisher lists, each once; no more than max_ids."""
        ids = dict.fromkeys(identity for heard in self._lists.values() if not heard.is_away for identity in heard.ids)
        return list(ids)[:self._max_ids]

    def _follow(self, ids: Sequence[str]) -> None:
        """Unsubscribe from ids that are not in `ids`, and subscribe to those that are new."""
        wanted = set(ids)
        with self._lock:
            gone = [self._subscribers.pop(identity) for identity in list(self._subscribers) if identity not in wanted]
            new = [identity for identity in ids if identity not in self._subscribers and not self._closed.is_set()]
            # An id counts as followed before its first topic is: a latched message comes at once.
            self._subscribers.update((identity, ()) for identity in new)
        with registered_together():
            for subscriber in itertools.chain.from_iterable(gone):
                release(subscriber)
            for identity in new:
                try:
                    self._subscribe(identity)
                except Exception as error:      # _check tries again
                    self._note("errors", 1, "/humans/{}/{} is not listened to: {}: {}".format(
                        self._kind, identity, type(error).__name__, error))

    def _subscribe(self, identity: str) -> None:
        """Subscribe to all topics of an id, or to none of them and raise why."""
        subscribers: List[rospy.Subscriber] = []
        done = False
        try:
            require_descriptors()
            for name, kind in self._topics.items():
                subscribers.append(rospy.Subscriber(
                    "/humans/{}/{}/{}".format(self._kind, identity, name), kind,
                    self._on_feature, callback_args=(identity, name),
                    queue_size=1 if kind._type in IMAGE_TYPES.values() else self._queue_size))
            done = True
        finally:
            with self._lock:
                wanted = done and identity in self._subscribers     # it may have gone, or this may have been closed
                if wanted:
                    self._subscribers[identity] = subscribers
                elif not done:
                    self._subscribers.pop(identity, None)
            for subscriber in () if wanted else subscribers:
                release(subscriber)

    def _on_feature(self, message: genpy.Message, source: Tuple[str, str]) -> None:
        identity, name = source
        # A message may still be on its way when its id has gone.
        if self._closed.is_set() or identity not in self._subscribers:
            return
        self._guard(lambda: self._on_message(identity, name, message), "{}/{}".format(identity, name))

    def _guard(self, call: Callable[[], None], what: str) -> None:
        try:
            call()
        except Exception as error:  # one message never ends the node
            self._note("errors", 1, "/humans/{}/{}: message not used: {}: {}".format(
                self._kind, what, type(error).__name__, error))

    def _note(self, kind: str, count: int, text: str) -> None:
        """Count a problem, keep it for the diagnostics and log it."""
        with self._lock:
            self._counts[kind] += count
            self._problem, self._problem_at = text, time.monotonic()
        rospy.logwarn_throttle(_LOG_PERIOD_S, "%s", text)

    def _watch(self) -> None:
        while not self._closed.wait(_CHECK_S):
            self._guard(self._check, "tracked")

    def _check(self) -> None:
        """Check the publishers, and try again what could not be opened."""
        with self._lock:
            lists = list(self._lists.items())
        changed = False
        for publisher, heard in lists:
            was_away = heard.is_away
            ended = self._watcher.check(heard)
            silent = time.monotonic() - heard.heard
            if not ended and 0.0 < self._list_timeout < silent and heard.ids:
                ended = "nothing came for {:.1f} s (list_timeout)".format(silent)
            with self._lock:
                if ended and self._lists.get(publisher) is heard:
                    del self._lists[publisher]
            if ended or heard.is_away != was_away:
                changed = True
                rospy.logwarn("%s: %s %s", self.topic, publisher, "has ended: " + ended if ended else
                              "does not answer; its ids do not count until it does" if heard.is_away else
                              "answers again")
        with self._lock:
            missing = any(identity not in self._subscribers for identity in self._listed())
        if changed or missing:
            self._update()


class PublishedList:
    """The list of ids of one publisher; `is_away`: it does not answer, so that its list is ignored."""

    def __init__(self, uri: str, ids: List[str]) -> None:
        self.uri, self.ids = uri, ids
        self.heard = self.asked = time.monotonic()
        self.failing_since: Optional[float] = None
        self.is_away = False


class PublisherWatch:
    """Asks publishers that are silent, or whose connection has ended, whether they still publish the topic.

    A publisher has ended when it no longer publishes the topic, or when nothing listens at the address of its node. A
    connection that broke while the node lives is made again. check() waits for answers: call it in a thread of its own.
    unanswered: s without an answer after which a publisher is away.
    """

    def __init__(self, topic: str, kind: Type[genpy.Message], unanswered: float = UNANSWERED_S) -> None:
        """topic: resolved name; this node subscribes to it."""
        self._topic, self._type = topic, kind._type
        self._unanswered = unanswered

    def check(self, heard: PublishedList) -> str:
        """Return why the publisher of a list has ended, empty while it has not. Sets heard.is_away.

        Takes 2 s at most, and as long as the master takes where a connection has to be made again.
        """
        now = time.monotonic()
        connected = heard.uri in connected_publishers(self._topic)
        is_due = now - max(heard.heard, heard.asked) > _QUIET_S
        if connected and heard.failing_since is None and not is_due:
            return ""
        answer = does_publish(heard.uri, self._topic, _ANSWER_S) if heard.uri else PublisherAnswer.REFUSED
        heard.asked = time.monotonic()
        if answer is PublisherAnswer.YES:
            heard.failing_since = None
            heard.is_away = heard.is_away and not connected
            if not connected:
                self._connect()
            return ""
        if answer is PublisherAnswer.NO:
            return "it no longer publishes the topic"
        heard.failing_since = now if heard.failing_since is None else heard.failing_since
        failing = time.monotonic() - heard.failing_since
        if answer is PublisherAnswer.REFUSED:
            return "its process has ended" if failing > _REFUSED_S else ""
        heard.is_away = failing > self._unanswered
        return "its machine does not answer" if heard.is_away and not connected else ""

    def _connect(self) -> None:
        try:
            subscribe_again(self._topic, self._type)
        except Exception as error:  # the master is away: the next check tries again
            rospy.logdebug("%s: not connected again: %s", self._topic, error)
