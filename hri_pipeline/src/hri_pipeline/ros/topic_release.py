"""Gives everything back that a rospy Publisher or Subscriber holds."""

from __future__ import annotations

import gc
from typing import Union

import rospy


def release(topic: Union[rospy.Publisher, rospy.Subscriber]) -> None:
    """Unregister `topic` and close the descriptor that rospy leaves open. Idempotent.

    After unregister() one epoll descriptor per topic stays until the cycle collector happens to run, on both
    sides of a connection; a thousand short-lived topics then exhaust `ulimit -n`. rospy polls it under the
    lock that unregister() has held, so nobody uses it any more once the implementation is closed.
    """
    implementation = topic.impl
    topic.unregister()
    if implementation is None or not implementation.closed:
        return      # already released, or this process has another publisher on the same topic
    poller = getattr(getattr(implementation, "connection_poll", None), "poller", None)
    if hasattr(poller, "close"):
        poller.close()
    else:
        gc.collect()
