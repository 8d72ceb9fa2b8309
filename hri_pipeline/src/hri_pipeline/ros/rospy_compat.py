"""All uses of what rospy keeps for itself: its bugs are worked around here, and its inner state is read here.

Checked against rospy 1.15.15. Before another version is used, this file has to be read beside its
rospy/topics.py, rospy/msproxy.py, rospy/impl/registration.py, rospy/impl/rosout.py, rospy/impl/tcpros_base.py,
rospy/impl/tcpros_pubsub.py, rospy/impl/statistics.py and rosgraph/xmlrpc.py. Nine things (how messages
are sent and received stands in `tcpros.py`):

- File descriptors: few for each topic, and a reserve (`resources.py`), without which rospy answers no call.
- Release of publishers and subscribers with everything that rospy would leave open.
- Topics that open, and calls that end, while the master is away, and topics that open and close together.
- A node whose name another has taken over, and which does not end that one in turn.
- Subscribers that hear a publisher which had gone when they connected, and has come back.
- Throttled log lines whose time is not that of /clock, which may go back and forth.
- The log file, without three lines for each connection of each topic of each person.
- The parameter /enable_statistics, which is not asked for with each topic that is subscribed to.
- Who is connected to a topic, who has sent a message, and what this node has registered at the master.
"""

from __future__ import annotations

import errno
import gc
import logging
import math
import select
import socket
import threading
import time
import weakref
from collections import deque
from contextlib import contextmanager
from functools import partial
from http.client import HTTPConnection
from typing import (
    Any,
    Callable,
    Deque,
    Dict,
    Iterable,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Set,
    Tuple,
    Union,
)
from xmlrpc.client import MultiCall, ServerProxy, Transport

import genpy
import rospy
import rospy.core
import rospy.topics
from rosgraph import xmlrpc
from rospy.core import get_node_uri
from rospy.impl import rosout, tcpros_base, tcpros_pubsub
from rospy.impl.registration import (
    Registration,
    RegManager,
    get_registration_listeners,
    get_service_manager,
    get_topic_manager,
)
from rospy.impl.statistics import SubscriberStatisticsLogger

from hri_pipeline.core.resources import descriptors_are_short, descriptors_status, raise_limit
from hri_pipeline.ros.tcpros import send_at_once

_WAIT_S = 0.1
_LOG_PERIOD_S = 30.0
_BROKEN = select.POLLHUP | select.POLLERR | getattr(select, "POLLRDHUP", 0)
_KEPT_ALIVE = (((socket.SOL_SOCKET, socket.SO_KEEPALIVE), 1), ((socket.IPPROTO_TCP, socket.TCP_KEEPIDLE), 2),
               ((socket.IPPROTO_TCP, socket.TCP_KEEPINTVL), 1), ((socket.IPPROTO_TCP, socket.TCP_KEEPCNT), 3))
_MOST_KNOWN = 100
_STATISTICS_S = 10.0
_REGISTER_S, _ANSWER_S = 2.0, 5.0     # most time that the master is waited for, once, and each time

_Reference = weakref.ReferenceType      # to the implementation of a publisher
TopicsAndTypes = List[Tuple[str, str]]


def prepare_rospy() -> None:
    """Apply all workarounds that concern the whole process, and raise its limit of descriptors as far as it goes.

    To be called before rospy.init_node. Idempotent.
    """
    raise_limit()
    rospy.core._LockedServerProxy = _ProxyWithTimeout
    rospy.topics.Poller = DescriptorFreePoller
    rospy.core._logging_throttle = WallTimeThrottle()
    log_no_connections()
    if not isinstance(SubscriberStatisticsLogger.is_enabled, StatisticsSwitch):
        SubscriberStatisticsLogger.is_enabled = StatisticsSwitch(SubscriberStatisticsLogger.is_enabled)
    tcpros_base.TCPServer = _PatientServer
    xmlrpc.ThreadingXMLRPCServer.get_request = _get_request
    reconnect_to_returning_publishers()
    send_at_once()
    rospy.core.add_preshutdown_hook(_log_here_only)


def log_no_connections() -> None:
    """Leave out of the log file what rospy tells of each connection, but for warnings: in a busy room it was 15 MB an
    hour and all but 1 % of the lines, so that what matters was rotated out after some days. A configuration of logging
    (ROS_PYTHON_LOG_CONFIG_FILE) that names `rospy` or `rospy.internal` goes before this. Idempotent.
    """
    logging.getLogger("rospy.internal").setLevel(logging.WARNING)


class WallTimeThrottle:
    """Tells whether a throttled line of the log is due. rospy's takes the time of /clock, and forgets all lines when
    that goes back: with two senders of /clock each line of each node came with each of their messages."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """clock: s, never jumps."""
        self._clock = clock
        self._logged: Dict[str, float] = {}

    def __call__(self, caller_id: str, period: float) -> bool:
        """Tell it of the line that stands at `caller_id`, which is to come once in `period` s at most."""
        now = self._clock()
        if now - self._logged.get(caller_id, -math.inf) <= period:
            return False
        self._logged[caller_id] = now
        return True


class StatisticsSwitch:
    """Tells whether topics have statistics (/enable_statistics). rospy asks the master for each topic that is
    subscribed to, which are several a second as people come and go; here its answer counts for ten seconds."""

    def __init__(self, ask: Callable[[], bool], clock: Callable[[], float] = time.monotonic) -> None:
        """ask: rospy's own question. clock: s, never jumps."""
        self._ask, self._clock = ask, clock
        self._answer, self._until = False, -math.inf

    def __call__(self) -> bool:
        """Return the answer, which may wait for the master."""
        if self._clock() >= self._until:
            self._answer = self._ask()
            self._until = self._clock() + _STATISTICS_S
        return self._answer


def _log_here_only(reason: str) -> None:
    """Send nothing to /rosout any more: each line registers this node anew (a parameter that rospy looks up), so that
    the master would end the node that has taken over its name."""
    rosout._rosout_pub = None


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
    poll = getattr(implementation, "connection_poll", None)
    poller = getattr(poll, "poller", None)      # DescriptorFreePoller has none
    if poller is not None and hasattr(poller, "close"):
        poller.close()
    elif not isinstance(poll, DescriptorFreePoller):
        gc.collect()


class Releaser:
    """Releases publishers in a thread of its own, as a release waits for the master; those that wait together by one
    call of it.

    The thread ends when all are released.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._waiting: Deque[rospy.Publisher] = deque()
        self._thread: Optional[threading.Thread] = None

    def put(self, publishers: Iterable[rospy.Publisher]) -> None:
        """Release these soon. Raises RuntimeError where the system gives no more threads: the next call tries again."""
        with self._lock:
            self._waiting.extend(publishers)
            if self._waiting and self._thread is None:
                thread = threading.Thread(target=self._run, name="releaser", daemon=True)
                thread.start()
                self._thread = thread

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
                publishers, self._waiting = self._waiting, deque()
            with registered_together():
                for publisher in publishers:
                    try:
                        release(publisher)
                    except Exception as error:      # the others still have to be released
                        rospy.logwarn("%s was not released: %s", publisher.name, error)


def refuse_when_closed(publisher: rospy.Publisher) -> None:
    """Make a publisher refuse connections that come while it is being released.

    rospy starts a thread for each connection before it notices that the topic has been closed in the meantime, and the
    thread then waits for ever: some ten per hour while people come and go (measured).
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


class TransportWithTimeout(Transport):
    """HTTP that does not wait for ever for a machine that has been switched off; patience: s."""

    def __init__(self, patience: float) -> None:
        super().__init__()
        self._patience = patience

    def make_connection(self, host: str) -> HTTPConnection:
        """Return the connection to a host."""
        connection = super().make_connection(host)
        connection.timeout = self._patience
        return connection

    def is_open(self) -> bool:
        """Tell whether the last call has left its connection open, and the other side has not ended it since.

        The system asks the other machine after 2 s of silence, and takes it for gone 3 s later.
        """
        kept = getattr(self._connection[1], "sock", None)
        if kept is None:
            return False
        try:
            for option, value in _KEPT_ALIVE:
                kept.setsockopt(*option, value)
            waiting = select.poll()
            waiting.register(kept, select.POLLIN | _BROKEN)
            return not waiting.poll(0)          # nothing comes that was not asked for, but its end
        except OSError:
            return False


class _ProxyWithTimeout(rospy.core._LockedServerProxy):
    """The master, as all of rospy calls it, for parameters too, and for each line of the log."""

    def __init__(self, uri: str) -> None:
        super().__init__(uri, transport=TransportWithTimeout(_ANSWER_S))


not_registered = threading.Event()
"""Set while the master may not know which topics and services this process has, as it has not answered."""


def register_without_waiting() -> None:
    """Let topics and services of this process open while the master is away. Idempotent.

    rospy waits until it is back, and every other topic of the process with it: as soon as somebody new came, nothing
    went on. Who calls this tells all that is open and closed when `not_registered` is set (MasterWatch).
    """
    RegManager.reg_added = _reg_added
    RegManager.reg_removed = _reg_removed


class _Change(NamedTuple):
    """A topic or service that was opened, or a topic that was closed (kind: None); kind: type, or a service's
    address."""

    of: str
    name: str
    kind: Optional[str]


class _Batch(threading.local):
    """What this thread tells the master together; None where it tells each change at once."""

    changes: Optional[List[Tuple[RegManager, _Change]]] = None


_batch = _Batch()
_unregister = RegManager.reg_removed
_OPENED = {Registration.PUB: "registerPublisher", Registration.SUB: "registerSubscriber",
           Registration.SRV: "registerService"}
_CLOSED = {Registration.PUB: "unregisterPublisher", Registration.SUB: "unregisterSubscriber"}


def _reg_added(manager: RegManager, name: str, kind: str, of: str) -> None:
    """Register a topic or service with the master; kind: type, or address of a service."""
    if of not in _CLOSED:
        # Without the lock of topics: who opens a topic holds it, and waits for that of the listeners, which rospy has
        # taken here.
        _call_master(manager, [_Change(of, name, kind)])
    elif _batch.changes is not None:
        _batch.changes.append((manager, _Change(of, name, kind)))
    else:
        _tell_master(manager, [_Change(of, name, kind)])


def _reg_removed(manager: RegManager, name: str, kind: str, of: str) -> None:
    """Take a topic or service back from the master; kind: type, or address of a service."""
    if of not in _CLOSED:
        _unregister(manager, name, kind, of)
    elif _batch.changes is not None:
        _batch.changes.append((manager, _Change(of, name, None)))
    else:
        _tell_master(manager, [_Change(of, name, None)])


def unregister_closed(published: Iterable[str], subscribed: Iterable[str]) -> None:
    """Take back from the master those of these topics that are not open here; who opens one meanwhile waits."""
    changes = [_Change(of, name, None) for of, names in ((Registration.PUB, published), (Registration.SUB, subscribed))
               for name in names]
    for manager in _managers():
        _tell_master(manager, changes)


@contextmanager
def registered_together() -> Iterator[None]:
    """Tell the master of the topics that are opened and released in the body of a `with` statement by one call at its
    end, or that of the outermost one; where the body raises, at once: who opens one again before it is released must
    find it registered, and the release has to come after that.

    rospy calls the master for each: an image with five new bodies, of ten topics each, waited for 50 calls.
    """
    changes: List[Tuple[RegManager, _Change]] = []
    outer, _batch.changes = _batch.changes, changes
    has_ended = False
    try:
        yield
        has_ended = True
    finally:
        _batch.changes = outer
        if has_ended and outer is not None:
            outer.extend(changes)
        elif changes:
            _tell_master(changes[0][0], [change for _, change in changes])


def _tell_master(manager: RegManager, changes: Sequence[_Change]) -> None:
    """Tell the master of topics that were opened and closed, at once; subscribers then hear who publishes.

    Another thread may have closed what was opened here, and told that, or opened again what was closed: what is not
    so any more is not told.
    """
    topics = get_topic_manager()
    with topics.lock:
        exist = {Registration.PUB: topics.pubs, Registration.SUB: topics.subs}
        _call_master(manager, [change for change in changes
                               if (change.kind is None) != (change.name in exist[change.of])])


def _call_master(manager: RegManager, changes: Sequence[_Change]) -> None:
    # A node that ends has perhaps been replaced by one of its name, which the master would end when this one registers.
    told = [change for change in changes if change.kind is None or not rospy.is_shutdown()]
    # A master that has not answered a moment ago is not waited for again: MasterWatch tells it all.
    if not told or not_registered.is_set():
        return
    try:
        with ServerProxy(manager.master_uri, transport=TransportWithTimeout(_REGISTER_S)) as master:
            answers = [(code, text, found) for code, text, found in _answers(master, manager.uri, told)]
    except Exception as error:      # refused, timed out, half an answer
        # Also where topics were only closed: it may do that later, when they are open again.
        not_registered.set()
        manager.logger.error("%s is not told to the master, with %d more: %s", told[0].name, len(told) - 1, error)
        return
    for change, (code, text, found) in zip(told, answers):
        if code != 1:
            rospy.logfatal("the master refuses to %s %s: %s", "register" if change.kind else "unregister", change.name,
                           text)
        elif change.of == Registration.SUB and change.kind is not None:
            manager.publisher_update(change.name, found)


def _answers(master: ServerProxy, uri: str, told: Sequence[_Change]) -> Iterable[Any]:
    """Return the answers to calls of the master, made in one; a single one is made as any master knows it."""
    calls = MultiCall(master) if len(told) > 1 else master
    answers = []
    for of, name, kind in told:
        if kind is None:
            answers.append(getattr(calls, _CLOSED[of])(rospy.get_name(), name, uri))
        else:
            answers.append(getattr(calls, _OPENED[of])(rospy.get_name(), name, kind, uri))
    return calls() if len(told) > 1 else answers


_robust_connect = tcpros_pubsub.robust_connect_subscriber


def reconnect_to_returning_publishers() -> None:
    """Let subscribers of this process hear a node that publishes a topic again. Idempotent.

    Where the topic goes while a subscriber connects, rospy counts it as connected for a second and more, or for ever,
    and takes no notice of the node that comes back meanwhile: a client never heard of somebody who had left at once.
    """
    tcpros_pubsub.robust_connect_subscriber = _connect


def _connect(connection: Any, address: str, port: int, publisher: str, receive: Callable, topic: str) -> None:
    """Connect to a publisher (its API's address), and receive until the connection ends."""
    _robust_connect(connection, address, port, publisher, receive, topic)
    subscriber = get_topic_manager().get_subscriber_impl(topic)
    if subscriber is None or connection.md5sum is not None:
        return          # it was connected
    if connection in subscriber.connections:
        subscriber.remove_connection(connection)
    if tcpros_pubsub.check_if_still_publisher(topic, publisher):
        for manager in _managers():
            manager._connect_topic_thread(topic, publisher)


def _managers() -> List[RegManager]:
    """Return what of rospy talks to the master: one, none before it has registered this node, and none at its end."""
    return [listener for listener in get_registration_listeners().listeners if isinstance(listener, RegManager)]


class NewSubscriberListener(rospy.SubscribeListener):
    """Sends the last message to each node that subscribes for the first time, without the topic being a latched one.

    message: set at each publish. publisher: set once it is there.
    """

    def __init__(self) -> None:
        super().__init__()
        self._known: Set[str] = set()
        self.message: Optional[genpy.Message] = None
        self.publisher: Optional[rospy.Publisher] = None

    def peer_subscribe(self, topic_name: str, topic_publish: Callable, peer_publish: Callable) -> None:
        """Called by rospy, in the thread of the new connection."""
        implementation = self.publisher.impl if self.publisher is not None else None
        if implementation is None or not implementation.connections or len(self._known) >= _MOST_KNOWN:
            return
        # rospy does not say who it is: the connection that it has added last.
        node = str(implementation.connections[-1].endpoint_id)
        is_known = node in self._known
        self._known.add(node)
        if is_known or self.message is None:
            return
        # rospy calls this without the lock that guards the buffer of the topic.
        implementation.acquire()
        try:
            peer_publish(self.message)
        finally:
            implementation.release()


def sender_of(message: genpy.Message) -> str:
    """Return the name of the node that has sent a message, empty for a message that did not come over a topic."""
    return str(getattr(message, "_connection_header", {}).get("callerid", ""))


def address_of_sender(topic: str, message: genpy.Message) -> str:
    """Return the address of the node that has sent a message on a topic, empty when its connection has ended."""
    return next((connection.endpoint_id for connection in _connections(topic)
                 if connection.header is message._connection_header), "")


def connected_publishers(topic: str) -> Set[str]:
    """Return the addresses of the nodes whose publications of `topic` (resolved) this node receives."""
    return {connection.endpoint_id for connection in _connections(topic)}


def own_address() -> str:
    """Return the address of this node."""
    return str(get_node_uri())


def own_publications() -> TopicsAndTypes:
    """Return (topic, type) of all that this node publishes."""
    return list(get_topic_manager().get_publications())


def own_subscriptions() -> TopicsAndTypes:
    """Return (topic, type) of all that this node subscribes to."""
    return list(get_topic_manager().get_subscriptions())


def own_services() -> List[Tuple[str, str]]:
    """Return (service, address) of all that this node offers."""
    return list(get_service_manager().get_services())


def _connections(topic: str) -> list:
    implementation = get_topic_manager().get_subscriber_impl(topic)
    return list(implementation.connections) if implementation is not None else []


class DescriptorFreePoller:
    """Finds broken connections of a topic as rospy's own does, which takes a descriptor for each topic."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._descriptors: Set[int] = set()

    def add_fd(self, descriptor: int) -> None:
        """Add a connection."""
        with self._lock:
            self._descriptors.add(descriptor)

    def remove_fd(self, descriptor: int) -> None:
        """Remove a connection."""
        with self._lock:
            self._descriptors.discard(descriptor)

    def error_iter(self) -> Iterator[int]:
        """Yield the descriptors of connections whose other end has gone."""
        if not self._descriptors:
            return
        poll = select.poll()
        with self._lock:
            for descriptor in self._descriptors:
                poll.register(descriptor, getattr(select, "POLLRDHUP", 0))
        for descriptor, event in poll.poll(0):
            if event & _BROKEN:
                yield descriptor


class _PatientSocket:
    """A listening socket whose accept() waits while descriptors are short; the clients wait, too."""

    def __init__(self, listening: socket.socket) -> None:
        self._socket = listening

    def __getattr__(self, name: str) -> Any:
        return getattr(self._socket, name)

    def accept(self) -> Tuple[socket.socket, Any]:
        """Accept a connection when there are descriptors for it. Raises OSError when the socket has been closed."""
        while True:
            while descriptors_are_short(0.5) and self._socket.fileno() >= 0:
                rospy.logwarn_throttle(_LOG_PERIOD_S, "%s", descriptors_status()[1])
                time.sleep(_WAIT_S)
            try:
                return self._socket.accept()
            except OSError as error:
                if error.errno not in (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM):
                    raise
                time.sleep(_WAIT_S)


class _PatientServer(tcpros_base.TCPServer):
    """rospy's server of connections, whose thread does not end for good when accept() finds no free descriptor."""

    def _create_server_sock(self) -> _PatientSocket:
        return _PatientSocket(super()._create_server_sock())


def _get_request(server: xmlrpc.ThreadingXMLRPCServer) -> Tuple[socket.socket, Any]:
    """Accept a call of this node.

    Without a free descriptor it waits: the server would try again at once, in a busy loop.
    """
    try:
        return server.socket.accept()
    except OSError as error:
        if error.errno in (errno.EMFILE, errno.ENFILE):
            time.sleep(_WAIT_S)
        raise
