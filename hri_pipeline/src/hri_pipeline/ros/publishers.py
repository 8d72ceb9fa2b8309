"""Publishers of the topics of one id, which come and go with it, and of the list of ids."""

from __future__ import annotations

import threading
from typing import Dict, Iterable, List, Mapping, NamedTuple, Optional, Sequence, Type, Union

import genpy
import rospy

from hri_msgs.msg import IdsList
from hri_pipeline.core.ids import ID_PATTERN, is_valid_id
from hri_pipeline.core.resources import require_descriptors
from hri_pipeline.ros.conversions import ids_list_to_msg, to_time
from hri_pipeline.ros.rospy_compat import (
    NewSubscriberListener,
    Releaser,
    refuse_when_closed,
    registered_together,
    release,
)

MATCHES_TOPIC = "/humans/candidate_matches"
"""Where matchers and recognisers say who belongs together."""

# A latched topic holds a state: queue all changes that come from one image or sound, so that none is lost.
_CHANGES = 10
# What a subscriber needs to read the last list before its connection is closed.
_FAREWELL_S = 0.1
_REPEAT_S = 1.0


class TopicSpec(NamedTuple):
    """Type of a topic, whether it is latched, and how many messages wait for a slow subscriber (latched: ten at least).

    greet: a node that subscribes for the first time gets the last message at once, although the topic is not latched,
    so that it need not wait for the next message of a slow topic. A node that subscribes again may have had that
    message.
    """

    type: Type[genpy.Message]
    latch: bool = False
    queue_size: int = 1
    greet: bool = False


class IdPublishers:
    """Publishers of `<namespace>/<id>/<name>` for each open id, freed when the id is closed.

        publishers = IdPublishers("/humans/faces", {"roi": TopicSpec(RegionOfInterest)})
        publishers.open("abcde")
        publishers.publish("abcde", "roi", message)
        publishers.close("abcde")
    """

    def __init__(self, namespace: str, topics: Mapping[str, TopicSpec]) -> None:
        self._namespace = namespace.rstrip("/")
        self._topics = {name: TopicSpec(*spec) for name, spec in topics.items()}
        self._open: Dict[str, Dict[str, rospy.Publisher]] = {}
        self._listeners: Dict[str, Dict[str, Optional[NewSubscriberListener]]] = {}
        self._lock = threading.RLock()
        self._releaser = Releaser()

    @property
    def ids(self) -> List[str]:
        """Ids that are open now."""
        with self._lock:
            return list(self._open)

    def open(self, identity: str) -> None:
        """Advertise the topics of an id; nothing happens when it is open already.

        Raises
        ------
        ValueError
            For an id that may not stand in a topic name.
        OSError, rospy.ROSException
            Without file descriptors or without a master; then none of the topics is open.
        """
        if not is_valid_id(identity):
            raise ValueError("{!r} is not an id ({}): no topics for it under {}".format(
                identity, ID_PATTERN, self._namespace))
        with self._lock:
            if identity in self._open:
                return
            require_descriptors()
            publishers: Dict[str, rospy.Publisher] = {}
            listeners: Dict[str, Optional[NewSubscriberListener]] = {}
            try:
                with registered_together():
                    for name, spec in self._topics.items():
                        listeners[name] = NewSubscriberListener() if spec.greet else None
                        publishers[name] = self._advertise(identity, name, spec, listeners[name])
            except Exception:
                self._releaser.put(publishers.values())
                raise
            self._open[identity], self._listeners[identity] = publishers, listeners

    def _advertise(self, identity: str, name: str, spec: TopicSpec,
                   listener: Optional[NewSubscriberListener]) -> rospy.Publisher:
        publisher = rospy.Publisher(
            "{}/{}/{}".format(self._namespace, identity, name), spec.type, subscriber_listener=listener,
            latch=spec.latch, queue_size=max(spec.queue_size, _CHANGES) if spec.latch else spec.queue_size)
        refuse_when_closed(publisher)
        if listener is not None:
            listener.publisher = publisher
        return publisher

    def keep(self, identities: Iterable[str]) -> None:
        """Close what is not in `identities`, which frees file descriptors, and open what is new in it.

        Raises
        ------
        ValueError, OSError, rospy.ROSException
            The last error of open(), after all others were opened.
        """
        wanted = list(identities)
        for identity in set(self.ids) - set(wanted):
            self.close(identity)
        problem: Optional[Exception] = None
        with self._lock, registered_together():
            for identity in wanted:
                try:
                    self.open(identity)
                except Exception as error:
                    problem = error
        if problem is not None:
            raise problem

    def publish(self, identity: str, name: str, message: genpy.Message) -> bool:
        """Publish on a topic of an id; return False when the id is not open (it may just have gone).

        Raises
        ------
        KeyError
            For a name that is none of the topics.
        """
        if name not in self._topics:
            raise KeyError("{} is none of the topics of {}: {}".format(
                name, self._namespace, ", ".join(self._topics)))
        with self._lock:
            publisher = self._open.get(identity, {}).get(name)
            if publisher is None:
                return False
            listener = self._listeners[identity][name]
            if listener is not None:
                listener.message = message
            publisher.publish(message)
            return True

    def has_subscribers(self, identity: str, name: str) -> bool:
        """Return whether a topic has subscribers: without them a costly message need not be made."""
        with self._lock:
            publisher = self._open.get(identity, {}).get(name)
            return publisher is not None and publisher.get_num_connections() > 0

    def close(self, identity: str) -> None:
        """Unregister the topics of an id, in another thread; nothing happens when it is not open."""
        with self._lock:
            self._listeners.pop(identity, None)
            self._releaser.put(self._open.pop(identity, {}).values())

    def close_all(self) -> None:
        """Unregister all topics, and return when that is done."""
        for identity in self.ids:
            self.close(identity)
        self._releaser.wait()


class TrackedList:
    """Publishes an IdsList on every change and every second; the empty list at the end.

    A second is wall time: the list stays alive while the simulated clock stands still.
    """

    def __init__(self, topic: str) -> None:
        self._publisher = rospy.Publisher(topic, IdsList, latch=True, queue_size=10)
        self._topic = topic
        self._ids: List[str] = []
        self._stamp = genpy.Time()
        self._lock = threading.Lock()
        self._closed = threading.Event()
        self._publish()
        self._thread = threading.Thread(target=self._repeat, name="tracked list", daemon=True)
        self._thread.start()

    def set(self, ids: Sequence[str], stamp: Union[genpy.Time, float]) -> None:
        """Set the ids that are tracked, in this order; publish them when they have changed.

        Parameters
        ----------
        ids : sequence of str
        stamp : genpy.Time or float
            Of the image or sound in which they were detected; s as a float.

        Raises
        ------
        ValueError
            For what is not an id; then nothing is published.
        """
        refused = [identity for identity in ids if not is_valid_id(identity)]
        if refused:
            raise ValueError("{} refuses {!r}: not an id ({})".format(self._topic, refused[0], ID_PATTERN))
        with self._lock:
            changed = list(ids) != self._ids
            self._ids = list(ids)
            self._stamp = to_time(stamp)
            if changed and not self._closed.is_set():
                self._publish()

    def clear(self) -> None:
        """Set no ids, with the stamp of the last image: nobody is tracked after it."""
        self.set([], self._stamp)

    def close(self) -> None:
        """Publish the empty list and unregister the topic. Idempotent."""
        with self._lock:
            if self._closed.is_set():
                return
            self._closed.set()
            self._ids = []
            self._publish()
        self._thread.join()
        if self._publisher.get_num_connections():
            threading.Event().wait(_FAREWELL_S)
        release(self._publisher)

    def _repeat(self) -> None:
        while not self._closed.wait(_REPEAT_S):
            with self._lock:
                if not self._closed.is_set():
                    self._publish()

    def _publish(self) -> None:
        try:
            self._publisher.publish(ids_list_to_msg(self._ids, self._stamp))
        except rospy.ROSException:
            # rospy has shut down before this object was closed.
            self._closed.set()
