"""The topic /humans/privacy: each node latches there what it computes and keeps of people."""

from __future__ import annotations

import threading
from typing import Dict, List, Optional, Tuple

import rospy

from hri_msgs.msg import PrivacyNotice
from hri_pipeline.core.privacy import DataUse
from hri_pipeline.ros.rospy_compat import release

TOPIC = "/humans/privacy"


class PrivacyTopic:
    """Publishes what this node does, at once and when it has changed. One per process: a topic latches one message."""

    def __init__(self, use: Optional[DataUse] = None) -> None:
        self._publisher = rospy.Publisher(TOPIC, PrivacyNotice, latch=True, queue_size=10)
        self._use: Optional[DataUse] = None
        if use is not None:
            self.set(use)

    def set(self, use: DataUse) -> None:
        """Publish what the node does, if that is new."""
        if use == self._use:
            return
        self._use = use
        self._publisher.publish(PrivacyNotice(
            node=rospy.get_name(), computes=list(use.computes), store=use.store, stored=list(use.stored),
            max_age=use.max_age, encrypted=use.encrypted, agreed=list(use.agreed)))

    def close(self) -> None:
        """Take the topic back. Idempotent."""
        release(self._publisher)


def collect(seconds: float) -> List[Tuple[str, DataUse]]:
    """Return what all nodes say within `seconds` (wall time), by name of the node."""
    found: Dict[str, DataUse] = {}

    def take(message: PrivacyNotice) -> None:
        found[message.node] = DataUse(tuple(message.computes), message.store, tuple(message.stored), message.max_age,
                                      message.encrypted, tuple(message.agreed))

    subscriber = rospy.Subscriber(TOPIC, PrivacyNotice, take, queue_size=50)
    threading.Event().wait(seconds)
    release(subscriber)
    return sorted(found.items())
