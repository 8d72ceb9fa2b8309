"""What a body has on the parameter server and in the master, and what a dead node has left there."""

from __future__ import annotations

import http.client
import socket
import time
from typing import Callable, Dict, List, Mapping, Optional, Set
from xmlrpc.client import Fault, ProtocolError, ServerProxy, Transport

import rosgraph
import rospy

from hri_fullbody.core.processes.process_identity import identity_of, is_alive
from hri_pipeline.core.ids import is_valid_id

NODE_PREFIX = "/rsp_"
DESCRIPTION_PREFIX = "/human_description_"
_OWNER = "/owner/pid"
_TIMEOUT_S = 2.0
_SHUTDOWN_S = 1.5

# All that a call to the master can raise: refused, reset, half an answer, an answer that says no.
MASTER_ERRORS = (OSError, socket.error, Fault, ProtocolError, http.client.HTTPException, rosgraph.MasterException)


class _HastyTransport(Transport):
    """Transport that does not wait for ever for a node that hangs."""

    def make_connection(self, host: object) -> http.client.HTTPConnection:
        connection = super().make_connection(host)
        connection.timeout = _TIMEOUT_S
        return connection


def description_name(body_id: str) -> str:
    """Name of the parameter that holds the URDF of a body."""
    return DESCRIPTION_PREFIX + body_id


def node_name(body_id: str) -> str:
    """Name of the robot_state_publisher of a body."""
    return NODE_PREFIX + body_id


class DescriptionServer:
    """Sets and deletes `/human_description_ID` and the private parameters of `/rsp_ID`.

    `/rsp_ID/owner` says which process they belong to, so that another one can clean up after it. All methods raise one of
    MASTER_ERRORS when the master does not answer. Not thread-safe: one thread owns it.
    """

    def __init__(self, publish_frequency: float) -> None:
        self._master = rosgraph.Master(rospy.get_name())
        self._private = {"publish_frequency": float(publish_frequency),
                         "owner": dict(identity_of(), node=rospy.get_name())}

    def put(self, body_id: str, urdf: str) -> None:
        """Set the parameters of a body; the owner first, so that nothing can be left without one."""
        self._master.setParam(node_name(body_id), self._private)
        self._master.setParam(description_name(body_id), urdf)

    def put_description(self, body_id: str, urdf: str) -> None:
        """Set the URDF alone."""
        self._master.setParam(description_name(body_id), urdf)

    def has(self, body_id: str, urdf: str) -> bool:
        """Tell whether the URDF is on the parameter server as it was set."""
        name = description_name(body_id)
        return bool(self._master.hasParam(name)) and self._master.getParam(name) == urdf

    def delete(self, body_id: str) -> None:
        """Delete the parameters of a body and the registrations of its node that it has not taken back itself."""
        unregister_node(node_name(body_id))
        for name in (description_name(body_id), node_name(body_id)):
            if self._master.hasParam(name):
                self._master.deleteParam(name)

    def names(self) -> Set[str]:
        """Names of all parameters."""
        return set(self._master.getParamNames())

    def sweep(self, tell: Callable[[str], None]) -> List[str]:
        """Clean up after processes that died; return the ids of the bodies they have left.

        Their robot_state_publishers are shut down where they still run, registrations that nobody answers for are taken
        back, parameters deleted. What belongs to a process that lives, or may live, is not touched.
        """
        cleaned: List[str] = []
        known: Dict[str, bool] = {}
        for name in sorted(self.names()):
            if not (name.startswith(NODE_PREFIX) and name.endswith(_OWNER)):
                continue
            body_id = name[len(NODE_PREFIX):-len(_OWNER)]
            if not is_valid_id(body_id):
                continue
            owner = self._master.getParam(node_name(body_id) + "/owner")
            if not isinstance(owner, Mapping):
                continue
            key = repr(sorted(owner.items()))
            if key not in known:
                known[key] = self._owner_lives(owner)
                if not known[key]:
                    tell("{} (process {} on {}) has died; cleaning up after it".format(
                        owner.get("node", "?"), owner.get("pid", "?"), owner.get("host", "?")))
            if not known[key]:
                end_node(node_name(body_id))
                self.delete(body_id)
                cleaned.append(body_id)
        return cleaned

    def _owner_lives(self, owner: Mapping[str, object]) -> bool:
        """Tell whether an owner lives; on another host its node is asked, and one that does not answer may live."""
        alive = is_alive(owner)
        if alive is not None:
            return alive
        uri = _uri_of(str(owner.get("node", "")))
        if uri is None:
            return False
        try:
            return str(_call(uri).getPid(rospy.get_name())[2]) == str(owner.get("pid"))
        except MASTER_ERRORS:
            return True


def end_node(name: str) -> None:
    """Shut a node down over its API; one that does not answer is taken off the master's lists."""
    uri = _uri_of(name)
    if uri is None:
        return
    try:
        _call(uri).shutdown(rospy.get_name(), "its body has gone")
    except MASTER_ERRORS:
        unregister_node(name)
        return
    deadline = time.monotonic() + _SHUTDOWN_S
    while _uri_of(name) == uri:
        if time.monotonic() > deadline:
            unregister_node(name)
            return
        time.sleep(0.02)


def unregister_node(name: str) -> None:
    """Take all registrations of a node back that did not do so itself."""
    master = rosgraph.Master(name)
    uri = _uri_of(name)
    if uri is None:
        return
    published, subscribed, services = master.getSystemState()
    for topic, nodes in published:
        if name in nodes:
            master.unregisterPublisher(topic, uri)
    for topic, nodes in subscribed:
        if name in nodes:
            master.unregisterSubscriber(topic, uri)
    for service, nodes in services:
        if name in nodes:
            master.unregisterService(service, master.lookupService(service))


def _uri_of(name: str) -> Optional[str]:
    """Address of a node's API, None when the master does not know the node."""
    if not name:
        return None
    try:
        return rosgraph.Master(rospy.get_name()).lookupNode(name) or None
    except rosgraph.MasterError:
        return None


def _call(uri: str) -> ServerProxy:
    return ServerProxy(uri, transport=_HastyTransport())
