"""Gives everything back that a rospy Publisher or Subscriber holds."""

from __future__ import annotations

import gc
import threading
import weakref
from collections import deque
from functools import partial
from typing import Any, Deque, Iterable, Optional, Union

import rospy

_Reference = weakref.ReferenceType      # to the implementation of a publisher


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


class Releaser:
    """Releases publishers in a thread, which ends when there are no more: each asks the master, and an image would wait for that."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._waiting: Deque[rospy.Publisher] = deque()
        self._thread: Optional[threading.Thread] = None

    def put(self, publishers: Iterable[rospy.Publisher]) -> None:
        """Release these soon."""
        with self._lock:
            self._waiting.extend(publishers)
            if self._waiting and self._thread is None:
                self._thread = threading.Thread(target=self._run, name="releaser", daemon=True)
                self._thread.start()

    def wait(self) -> None:
        """Return when all have been released."""
        while True:
            with self._lock:
                thread = self._thread
            if thread is None:
                return
            thread.join()

    def _run(self) -> None:
        while True:
            with self._lock:
                if not self._waiting:
                    self._thread = None
                    return
                publisher = self._waiting.popleft()
            try:
                release(publisher)
            except Exception as error:      # the others still have to be released
                rospy.logwarn("%s was not released: %s", publisher.name, error)


def refuse_when_closed(publisher: rospy.Publisher) -> None:
    """See to it that who connects while the publisher is being released leaves nothing behind.

    rospy starts a thread for each connection before it notices that the topic has been closed in the meantime, and the
    thread then waits for ever: some ten in an hour of people who come and go (measured).
    """
    implementation = publisher.impl
    reference = weakref.ref(implementation)
    implementation.add_connection = partial(_add_connection, reference)
    implementation.remove_connection = partial(_remove_connection, reference)


def _add_connection(reference: _Reference, connection: Any) -> bool:
    implementation = reference()
    if implementation is None or implementation.closed:
        connection.close()
        return False
    try:
        return type(implementation).add_connection(implementation, connection)
    except TypeError:
        if not implementation.closed:
            raise
        return False
    finally:
        if implementation.closed:
            connection.close()


def _remove_connection(reference: _Reference, connection: Any) -> None:
    # What rospy calls next tells the connection's thread to end; it does not get there after an error.
    implementation = reference()
    if implementation is None:
        return
    try:
        type(implementation).remove_connection(implementation, connection)
    except TypeError:
        if not implementation.closed:       # else its listeners have become None
            raise
