"""Topics of one identity that come and go with it."""

from __future__ import annotations

import threading
from typing import Dict, Iterable, List, Mapping, NamedTuple, Type

import genpy
import rospy

from hri_pipeline.core.ids import ID_PATTERN, is_valid_id
from hri_pipeline.ros.topic_release import release


class TopicSpec(NamedTuple):
    """Type of a topic, whether it is latched, and how many messages wait for a slow subscriber."""

    type: Type[genpy.Message]
    latch: bool = False
    queue_size: int = 1


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
        self._lock = threading.RLock()

    @property
    def ids(self) -> List[str]:
        """Ids that are open now."""
        with self._lock:
            return list(self._open)

    def open(self, identity: str) -> None:
        """Advertise the topics of an id; nothing happens when it is open already.

        Raises ValueError for an id that may not stand in a topic name.
        """
        if not is_valid_id(identity):
            raise ValueError("{!r} is not an id ({}): no topics for it under {}".format(
                identity, ID_PATTERN, self._namespace))
        with self._lock:
            if identity in self._open:
                return
            publishers = self._open[identity] = {}
            for name, spec in self._topics.items():
                publishers[name] = rospy.Publisher(
                    "{}/{}/{}".format(self._namespace, identity, name), spec.type,
                    latch=spec.latch, queue_size=spec.queue_size)

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
            publisher.publish(message)
            return True

    def has_subscribers(self, identity: str, name: str) -> bool:
        """Tell whether someone listens, so that costly messages need not be made for nobody."""
        with self._lock:
            publisher = self._open.get(identity, {}).get(name)
            return publisher is not None and publisher.get_num_connections() > 0

    def close(self, identity: str) -> None:
        """Take the topics of an id back; nothing happens when it is not open."""
        with self._lock:
            for publisher in self._open.pop(identity, {}).values():
                release(publisher)

    def close_all(self) -> None:
        """Take all topics back."""
        for identity in self.ids:
            self.close(identity)
