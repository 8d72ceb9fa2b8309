"""Notices that the master has gone or has been replaced, and tells a new one what this node has."""

from __future__ import annotations

import threading
from http.client import HTTPConnection
from typing import Optional, Tuple
from xmlrpc.client import ServerProxy, Transport

import rosgraph
import rospy
from rospy.core import get_node_uri
from rospy.impl.registration import get_service_manager, get_topic_manager

_PERIOD_S = 2.0
_ANSWER_S = 5.0


class MasterAway(Exception):
    """The master does not answer; the text says why."""


class _Impatient(Transport):
    """HTTP that does not wait for ever for a machine that has been switched off."""

    def make_connection(self, host: str) -> HTTPConnection:
        connection = super().make_connection(host)
        connection.timeout = _ANSWER_S
        return connection


def ask_master(name: str) -> Tuple[int, str]:
    """Return process id and run id of the master, asked in the name of a node; MasterAway without an answer in 5 s."""
    try:
        with ServerProxy(rosgraph.get_master_uri(), transport=_Impatient()) as master:
            pid = int(master.getPid(name)[2])
            found, _, run_id = master.getParam(name, "/run_id")
    except Exception as error:      # refused, reset, half an answer, no address: it is away
        raise MasterAway(str(error)) from error
    return pid, str(run_id) if found == 1 else ""     # a bare rosmaster has no run id


class MasterWatch:
    """Asks the master every two seconds who it is.

    rospy registers a topic once. A master that is started again knows nothing of the node, which then is
    deaf although it runs: its publishers, subscribers and services are registered again here. Parameters
    are not: a new master has those of whoever started it.
    """

    def __init__(self, period: float = _PERIOD_S) -> None:
        self._master = rosgraph.Master(rospy.get_name())
        self._identity = self._ask()
        self._away = False
        self.restarts = 0
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._watch, args=(period,), name="master watch", daemon=True)
        self._thread.start()

    @property
    def away(self) -> bool:
        """Whether the master did not answer when it was asked last."""
        return self._away

    def close(self) -> None:
        """Stop watching. Idempotent."""
        self._closed.set()
        self._thread.join(timeout=5.0)

    def _watch(self, period: float) -> None:
        while not self._closed.wait(period):
            identity = self._ask()
            if identity is None:
                if not self._away:
                    rospy.logwarn("the ROS master at %s does not answer; running on without it",
                                  rosgraph.get_master_uri())
                self._away = True
                continue
            if self._identity is not None and identity != self._identity:
                self._register_again()
            elif self._away:
                rospy.loginfo("the ROS master answers again")
            self._identity, self._away = identity, False

    def _ask(self) -> Optional[Tuple[int, str]]:
        try:
            return ask_master(rospy.get_name())
        except MasterAway:
            return None

    def _register_again(self) -> None:
        rospy.logwarn("the ROS master has been started again; registering all topics and services anew")
        uri = get_node_uri()
        try:
            published = get_topic_manager().get_publications()
            for topic, kind in published:
                self._master.registerPublisher(topic, kind, uri)
            # Whoever has gone meanwhile has taken these back before the new master knew them.
            for topic in {topic for topic, _ in published} - {topic for topic, _ in get_topic_manager().get_publications()}:
                self._master.unregisterPublisher(topic, uri)
            own = ServerProxy(uri)
            for topic, kind in get_topic_manager().get_subscriptions():
                publishers = self._master.registerSubscriber(topic, kind, uri)
                own.publisherUpdate("/master", topic, publishers)
            for service, service_uri in get_service_manager().get_services():
                self._master.registerService(service, service_uri, uri)
            self.restarts += 1
        except Exception as error:
            rospy.logerr("registration with the new ROS master failed: %s", error)
