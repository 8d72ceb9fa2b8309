"""A topic that is listened to from the first time that somebody asks for its value."""

from __future__ import annotations

import threading
import time
from typing import Any, Callable, Dict, Optional, Type

import genpy
import roslib.message
import rospy

from hri_pipeline.ros.topic_release import release

Convert = Callable[[Any], Any]

_LOG_PERIOD_S = 10.0


class LazyTopic:
    """The latest value of one topic. Nothing is subscribed to before the first `get`; close() lets go of it.

    The type is that of the publisher, so that both types of a topic that differs between the paper and REP-155 are read.
    convert turns a message into a value; a message that it refuses by a ValueError is passed over and told. latched: the
    first `get` waits up to `patience` s for the value that is there already. on_value is called with each value.
    """

    def __init__(self, name: str, convert: Convert, latched: bool = False, patience: float = 0.0,
                 on_value: Optional[Callable[[Any], None]] = None) -> None:
        self._name = name
        self._convert = convert
        self._patience = patience if latched else 0.0
        self._on_value = on_value
        self._types: Dict[str, Optional[Type[genpy.Message]]] = {}
        self._condition = threading.Condition()
        self._subscriber: Optional[rospy.Subscriber] = None
        self._closed = False
        self._came = False
        self._heard = float("-inf")
        self._value: Any = None

    def get(self, default: Any = None) -> Any:
        """Return the latest value, `default` while none has come."""
        with self._condition:
            if not self._closed and self._subscriber is None:
                self._subscriber = rospy.Subscriber(self._name, rospy.AnyMsg, self._take, queue_size=1)
                self._condition.wait_for(lambda: self._came or self._closed, self._patience)
            return self._value if self._came else default

    @property
    def age(self) -> float:
        """Seconds (of the wall clock) since the last message; infinite while none has come."""
        return time.monotonic() - self._heard

    def close(self) -> None:
        """Let go of the topic. Idempotent; a `get` afterwards returns what came last."""
        with self._condition:
            subscriber, self._subscriber, self._closed = self._subscriber, None, True
            self._condition.notify_all()
        if subscriber is not None:
            release(subscriber)

    def _take(self, message: rospy.AnyMsg) -> None:
        try:
            value = self._convert(self._read(message))
        except (ValueError, AttributeError, genpy.DeserializationError) as error:
            # An AttributeError is that of a message of a type which has no business on this topic.
            rospy.logwarn_throttle(_LOG_PERIOD_S, "%s: a message of type %s is not used: %s", self._name,
                                   message._connection_header.get("type", "")[:60], error)
            return
        with self._condition:
            if self._closed:
                return
            self._value, self._came, self._heard = value, True, time.monotonic()
            self._condition.notify_all()
        if self._on_value is not None:
            self._on_value(value)

    def _read(self, message: rospy.AnyMsg) -> genpy.Message:
        name = message._connection_header.get("type", "")
        if name not in self._types:
            self._types[name] = roslib.message.get_message_class(name)
        kind = self._types[name]
        if kind is None or message._connection_header.get("md5sum") not in (kind._md5sum, "*"):
            raise ValueError("its type {} is not known here, or is another version of it".format(name[:60]))
        return kind().deserialize(message._buff)
