"""Topics of one identity that come and go with it."""

from __future__ import annotations

import threading
from typing import Callable, Dict, Iterable, List, Mapping, NamedTuple, Optional, Set, Type

import genpy
import rospy

from hri_pipeline.core.ids import ID_PATTERN, is_valid_id
from hri_pipeline.ros.topic_release import Releaser, refuse_when_closed

_MOST_MET = 100
# What is latched tells a state; none of the changes of one image or sound may replace another before it is sent.
_CHANGES = 10


class TopicSpec(NamedTuple):
    """Type of a topic, whether it is latched, and how many messages wait for a slow subscriber (latched: ten at least).

    greet: a node that subscribes for the first time gets the last message at once, without the topic being a latched
    one: it need not wait for the next of a slow topic. One that comes again may have had that message.
    """

    type: Type[genpy.Message]
    latch: bool = False
    queue_size: int = 1
    greet: bool = False


class _Greeter(rospy.SubscribeListener):
    """Gives each node that subscribes for the first time the last message."""

    def __init__(self) -> None:
        super().__init__()
        self._met: Set[str] = set()
        self.message: Optional[genpy.Message] = None
        self.publisher: Optional[rospy.Publisher] = None

    def peer_subscribe(self, topic_name: str, topic_publish: Callable, peer_publish: Callable) -> None:
        """Called by rospy, in the thread of the new connection."""
        implementation = self.publisher.impl if self.publisher is not None else None
        if implementation is None or not implementation.connections or len(self._met) >= _MOST_MET:
            return
        # rospy does not say who it is: the connection that it has added last.
        node = str(implementation.connections[-1].endpoint_id)
        known = node in self._met
        self._met.add(node)
        if known or self.message is None:
            return
        # rospy calls this without the lock that guards the buffer of the topic.
        implementation.acquire()
        try:
            peer_publish(self.message)
        finally:
            implementation.release()


class TopicLeases:
    """Publishers of `<namespace>/<id>/<name>` for each open id, freed when the id is closed.

        leases = TopicLeases("/humans/faces", {"roi": TopicSpec(RegionOfInterest)})
        leases.open("abcde")
        leases.publish("abcde", "roi", message)
        leases.close("abcde")
    """

    def __init__(self, namespace: str, topics: Mapping[str, TopicSpec]) -> None:
        self._namespace = namespace.rstrip("/")
        self._topics = {name: TopicSpec(*spec) for name, spec in topics.items()}
        self._open: Dict[str, Dict[str, rospy.Publisher]] = {}
        self._greeters: Dict[str, Dict[str, Optional[_Greeter]]] = {}
        self._lock = threading.RLock()
        self._releaser = Releaser()

    @property
    def ids(self) -> List[str]:
        """Ids that are open now."""
        with self._lock:
            return list(self._open)

    def open(self, identity: str) -> None:
        """Advertise the topics of an id; nothing happens when it is open already.

        Raises ValueError for an id that may not stand in a topic name, and what rospy raises where it has no descriptors or no
        master; then none of the topics is open.
        """
        if not is_valid_id(identity):
            raise ValueError("{!r} is not an id ({}): no topics for it under {}".format(
                identity, ID_PATTERN, self._namespace))
        with self._lock:
            if identity in self._open:
                return
            publishers: Dict[str, rospy.Publisher] = {}
            greeters: Dict[str, Optional[_Greeter]] = {}
            try:
                for name, spec in self._topics.items():
                    greeters[name] = _Greeter() if spec.greet else None
                    publishers[name] = self._advertise(identity, name, spec, greeters[name])
            except Exception:
                self._releaser.put(publishers.values())
                raise
            self._open[identity], self._greeters[identity] = publishers, greeters

    def _advertise(self, identity: str, name: str, spec: TopicSpec, greeter: Optional[_Greeter]) -> rospy.Publisher:
        publisher = rospy.Publisher(
            "{}/{}/{}".format(self._namespace, identity, name), spec.type, subscriber_listener=greeter,
            latch=spec.latch, queue_size=max(spec.queue_size, _CHANGES) if spec.latch else spec.queue_size)
        refuse_when_closed(publisher)
        if greeter is not None:
            greeter.publisher = publisher
        return publisher

    def keep(self, identities: Iterable[str]) -> None:
        """Open what is new in `identities` and close what is not in it."""
        wanted = list(identities)
        for identity in wanted:
            self.open(identity)
        for identity in set(self.ids) - set(wanted):
            self.close(identity)

    def publish(self, identity: str, name: str, message: genpy.Message) -> bool:
        """Publish on a topic of an open id; False when the id is not open (it may just have gone).

        Raises KeyError for a name that is none of the topics.
        """
        if name not in self._topics:
            raise KeyError("{} is none of the topics of {}: {}".format(
                name, self._namespace, ", ".join(self._topics)))
        with self._lock:
            publisher = self._open.get(identity, {}).get(name)
            if publisher is None:
                return False
            greeter = self._greeters[identity][name]
            if greeter is not None:
                greeter.message = message
            publisher.publish(message)
            return True

    def has_subscribers(self, identity: str, name: str) -> bool:
        """Tell whether someone listens, so that costly messages need not be made for nobody."""
        with self._lock:
            publisher = self._open.get(identity, {}).get(name)
            return publisher is not None and publisher.get_num_connections() > 0

    def close(self, identity: str) -> None:
        """Take the topics of an id back, which the master is told soon; nothing happens when it is not open."""
        with self._lock:
            self._greeters.pop(identity, None)
            self._releaser.put(self._open.pop(identity, {}).values())

    def close_all(self) -> None:
        """Take all topics back, and return when the master knows."""
        for identity in self.ids:
            self.close(identity)
        self._releaser.wait()
