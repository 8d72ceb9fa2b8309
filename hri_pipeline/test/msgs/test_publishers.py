"""Publishers of ids, of which some cannot be opened; without a master."""

import contextlib
import logging
import threading
from types import SimpleNamespace
from unittest.mock import MagicMock
from xmlrpc.server import SimpleXMLRPCRequestHandler, SimpleXMLRPCServer

import pytest
from rospy.impl.registration import Registration
from std_msgs.msg import String

from hri_pipeline.ros import master as master_module
from hri_pipeline.ros import publishers as module
from hri_pipeline.ros import rospy_compat, subscriptions
from hri_pipeline.ros.publishers import IdPublishers, TopicSpec
from hri_pipeline.testing import wait_for

NAME = "/faces"
WAIT_S = 10.0


@pytest.fixture()
def publishers(monkeypatch):
    """Those of a namespace; `refused` has the ids whose topics cannot be opened."""
    made = IdPublishers("/humans/faces", {"roi": TopicSpec(String)})
    made.refused = set()

    def advertise(identity, name, spec, listener):
        if identity in made.refused:
            raise OSError("too few file descriptors")
        return object()

    monkeypatch.setattr(made, "_advertise", advertise)
    monkeypatch.setattr(made._releaser, "put", lambda topics: list(topics))
    return made


def test_who_has_gone_is_closed_although_a_new_one_cannot_be_opened(publishers, monkeypatch):
    """Otherwise the descriptors that the new one needs are never free."""
    publishers.keep(["gone"])

    def refuse():
        raise OSError("too few file descriptors")

    monkeypatch.setattr(module, "require_descriptors", refuse)
    with pytest.raises(OSError):
        publishers.keep(["new"])
    assert publishers.ids == []


def test_one_that_cannot_be_opened_costs_no_other(publishers):
    publishers.refused.add("second")
    with pytest.raises(OSError, match="descriptors"):
        publishers.keep(["first", "second", "third"])
    assert publishers.ids == ["first", "third"]
    publishers.refused.clear()
    publishers.keep(["second", "third"])
    assert publishers.ids == ["third", "second"]


class Requests(SimpleXMLRPCRequestHandler):
    """Counts what it is asked."""

    def do_POST(self):
        self.server.requests += 1
        super().do_POST()


@pytest.fixture()
def master():
    """A master that keeps the topics which are registered, and counts requests."""
    with SimpleXMLRPCServer(("127.0.0.1", 0), Requests, logRequests=False) as server:
        server.requests, server.topics = 0, []
        for call in ("registerPublisher", "registerSubscriber"):
            server.register_function(
                lambda node, topic, kind, uri: server.topics.append(topic) or [1, "", ["http://a/"]], call)
        for call in ("unregisterPublisher", "unregisterSubscriber"):
            server.register_function(
                lambda node, topic, uri: [1, "", topic in server.topics and server.topics.remove(topic) is None], call)
        server.register_multicall_functions()
        thread = threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True)
        thread.start()
        yield server
        server.shutdown()
        thread.join()


@pytest.fixture()
def topics(monkeypatch):
    """What rospy keeps of the topics of this process."""
    kept = SimpleNamespace(lock=threading.RLock(), pubs={}, subs={})
    monkeypatch.setattr(rospy_compat, "get_topic_manager", lambda: kept)
    return kept


def test_all_topics_of_those_who_are_new_are_told_to_the_master_in_one_call(master, topics, publishers, monkeypatch):
    """Else an image with many new people waits for a call for each of their topics."""
    register = registering(master, topics)

    def advertise(identity, name, spec, listener):
        if (identity, name) == ("second", "name"):
            raise OSError("too few file descriptors")
        return register(identity, name, spec, listener)

    publishers._topics["name"] = TopicSpec(String)
    monkeypatch.setattr(publishers, "_advertise", advertise)
    with pytest.raises(OSError, match="descriptors"):
        publishers.keep(["first", "second", "third"])
    # What could not be opened may be opened again before it is released, and rospy then tells the master nothing.
    assert master.topics == ["second/roi", "first/roi", "first/name", "third/roi", "third/name"]
    assert master.requests == 2
    publishers.close("first")
    publishers.keep(["first", "third"])
    assert master.topics[5:] == ["first/roi", "first/name"] and master.requests == 3
    assert not rospy_compat.not_registered.is_set()


def test_a_node_that_ends_while_topics_open_registers_none(master, topics, publishers, monkeypatch):
    """A new node of its name would be ended by the master, or the topics would stay there for ever."""
    monkeypatch.setattr(publishers, "_advertise", registering(master, topics))
    with rospy_compat.registered_together():
        publishers.open("first")
        monkeypatch.setattr(rospy_compat.rospy, "is_shutdown", lambda: True)
    assert master.requests == 0


def test_a_master_that_has_gone_while_topics_open_is_not_waited_for(master, topics, publishers, monkeypatch):
    monkeypatch.setattr(rospy_compat, "not_registered", threading.Event())
    monkeypatch.setattr(publishers, "_advertise", registering(master, topics))
    with rospy_compat.registered_together():
        publishers.open("first")
        rospy_compat.not_registered.set()
    assert master.requests == 0, "MasterWatch registers all that is open once it is back"


@pytest.mark.parametrize("answer", [[1, "no list"], "nothing", ValueError("the master has a bug")])
def test_answers_that_are_none_open_topics_all_the_same(master, topics, publishers, monkeypatch, answer):
    def answered(node, topic, kind, uri):
        if topic.startswith("second") and isinstance(answer, Exception):
            raise answer
        return answer if topic.startswith("second") else [1, "", []]

    master.register_function(answered, "registerPublisher")
    monkeypatch.setattr(rospy_compat, "not_registered", threading.Event())
    monkeypatch.setattr(publishers, "_advertise", registering(master, topics))
    publishers.keep(["first", "second", "third"])
    assert publishers.ids == ["first", "second", "third"] and rospy_compat.not_registered.is_set()


def test_topics_that_come_and_go_together_are_told_to_the_master_in_one_call(master, topics):
    """Each sentence of somebody unseen is a voice and a person: eleven topics, which six subscribers hear."""
    heard = []
    manager = manager_of(master)
    manager.publisher_update = lambda topic, found: heard.append((topic, found))
    opened(manager, topics.subs, "old")
    with rospy_compat.registered_together():
        closed(manager, topics.subs, "old")
        for name in ("first", "second"):
            opened(manager, topics.subs, name)
        closed(manager, topics.subs, "first")
        assert master.topics == ["old"]
    assert master.topics == ["second"] and master.requests == 2
    assert heard == [("old", ["http://a/"]), ("second", ["http://a/"])]


def test_topics_of_all_who_leave_are_taken_back_in_one_call(master, topics, monkeypatch):
    releaser, names = rospy_compat.Releaser(), ["first/roi", "first/name", "second/roi"]
    for name in names:
        opened(manager_of(master), topics.pubs, name, Registration.PUB)
    monkeypatch.setattr(rospy_compat, "release",
                        lambda name: closed(manager_of(master), topics.pubs, name, Registration.PUB))
    releaser.put(names)
    releaser.wait()
    assert master.topics == [] and master.requests == len(names) + 1


def test_topics_that_wait_for_a_thread_are_released_with_the_next_ones(monkeypatch):
    """Else those of everybody who leaves later would stay, too, and the end of the node would fail."""
    releaser, done = rospy_compat.Releaser(), []
    monkeypatch.setattr(rospy_compat, "release", done.append)
    with monkeypatch.context() as shortage:
        shortage.setattr(threading.Thread, "start", MagicMock(side_effect=RuntimeError("can't start new thread")))
        with pytest.raises(RuntimeError):
            releaser.put(["first"])
        releaser.wait()
    releaser.put(["second"])
    releaser.wait()
    assert done == ["first", "second"]


def test_who_comes_and_who_leaves_is_followed_and_left_in_one_call(master, topics, monkeypatch):
    manager = manager_of(master)
    manager.publisher_update = lambda topic, found: None
    monkeypatch.setattr(subscriptions, "rospy", MagicMock(
        Subscriber=lambda name, *given, **more: opened(manager, topics.subs, name) or name))
    monkeypatch.setattr(subscriptions, "release", lambda name: closed(manager, topics.subs, name))
    faces = subscriptions.IdSubscribers("faces", {"roi": String, "name": String}, on_message=print)
    with contextlib.closing(faces):
        for ids in (["first", "second"], ["second", "third"]):
            before = master.requests
            faces._follow(ids)
            assert master.requests == before + 1 and faces.ids == ids
            assert sorted(master.topics) == ["/humans/faces/{}/{}".format(face, name) for face in ids
                                             for name in ("name", "roi")] + ["/humans/faces/tracked"]
    assert master.topics == []


def test_what_another_thread_opens_or_closes_meanwhile_is_told_as_it_is_then(master, topics):
    manager = manager_of(master)
    manager.publisher_update = lambda topic, found: None
    opened(manager, topics.subs, "again")
    with rospy_compat.registered_together():
        closed(manager, topics.subs, "again")
        opened(manager, topics.subs, "gone")
        other = threading.Thread(target=lambda: (opened(manager, topics.subs, "again"), topics.subs.pop("gone")))
        other.start()
        other.join()
    assert master.topics == ["again", "again"], "registered by both threads, and taken back by none"


def test_topics_of_a_node_that_ends_are_taken_back(master, topics, monkeypatch):
    """rospy takes back at its end what it still has; the master would keep the others for ever."""
    manager = manager_of(master)
    manager.publisher_update = lambda topic, found: None
    for name in ("first", "second"):
        opened(manager, topics.subs, name)
    with rospy_compat.registered_together():
        for name in ("first", "second"):
            closed(manager, topics.subs, name)
        monkeypatch.setattr(rospy_compat.rospy, "is_shutdown", lambda: True)
    assert master.topics == []


def test_who_comes_does_not_wait_for_a_master_that_did_not_take_back_who_left(master, topics, monkeypatch):
    """It is waited for twice else, and what it does later may end topics that are open again: all are told anew."""
    def silent(node, topic, uri):
        raise TimeoutError

    master.register_function(silent, "unregisterPublisher")
    monkeypatch.setattr(rospy_compat, "not_registered", threading.Event())
    topics.pubs["left"] = object()
    with rospy_compat.registered_together():
        closed(manager_of(master), topics.pubs, "left", Registration.PUB)
    opened(manager_of(master), topics.pubs, "new", Registration.PUB)
    closed(manager_of(master), topics.pubs, "new", Registration.PUB)
    assert rospy_compat.not_registered.is_set() and master.requests == 1


@pytest.fixture()
def watch(master, topics, monkeypatch):
    """Returns the MasterWatch of a node that publishes `topics`, which looks after so many s at this master."""
    manager, missing = manager_of(master), threading.Event()
    for user in (rospy_compat, master_module):
        monkeypatch.setattr(user, "not_registered", missing)
    monkeypatch.setattr(rospy_compat, "_managers", lambda: [manager])
    monkeypatch.setattr(rospy_compat.rospy, "get_name", lambda: NAME)
    monkeypatch.setattr(master_module, "register_without_waiting", lambda: None)
    monkeypatch.setattr(master_module, "own_address", lambda: manager.uri)
    monkeypatch.setattr(master_module, "own_publications", lambda: [(name, "std_msgs/String") for name in topics.pubs])
    for name in ("own_subscriptions", "own_services"):
        monkeypatch.setattr(master_module, name, lambda: [])
    monkeypatch.setattr(master_module.rosgraph, "get_master_uri", lambda: manager.master_uri)
    monkeypatch.setattr(master_module.MasterWatch, "_ask", lambda watch: (1, "run"))
    monkeypatch.setattr(master_module.MasterWatch, "_warn_if_unreachable", lambda watch: None)
    monkeypatch.setattr(master_module.ForeignNode, "look", lambda aggregator: None)
    return lambda period: contextlib.closing(master_module.MasterWatch(period))


def lists(master, meanwhile=lambda: None):
    """Let a master tell what it lists, after which something else comes."""
    def state(caller):
        published = [[topic, ["/other", NAME]] for topic in master.topics] + [["/of_others", ["/other"]]]
        meanwhile()
        return [1, "", [published, [], []]]

    master.register_function(state, "getSystemState")


def fails_once(master, call):
    """Let the network fail in the next call of a master that answers later ones."""
    works = master.funcs[call]

    def failing(*given):
        master.register_function(works, call)
        raise TimeoutError

    master.register_function(failing, call)


@pytest.mark.parametrize("period, looks", [(0.005, True), (100.0, False)])
def test_a_topic_whose_end_the_master_has_not_heard_of_is_taken_back_later(master, topics, watch, period, looks):
    """It would list it for ever. That is done at the next look, or as the node ends."""
    lists(master)
    for name in ("stays", "left"):
        opened(manager_of(master), topics.pubs, name, Registration.PUB)
    fails_once(master, "unregisterPublisher")
    with watch(period):
        closed(manager_of(master), topics.pubs, "left", Registration.PUB)
        if looks:
            wait_for(lambda: set(master.topics) == {"stays"}, WAIT_S, lambda: master.topics)
    assert set(master.topics) == {"stays"} and not rospy_compat.not_registered.is_set()


def test_a_topic_that_opens_again_while_what_was_closed_is_taken_back_stays(master, topics, watch):
    told = threading.Event()

    def open_again():
        opened(manager_of(master), topics.pubs, "again", Registration.PUB)
        told.set()

    for name in ("stays", "again"):
        opened(manager_of(master), topics.pubs, name, Registration.PUB)
    fails_once(master, "unregisterPublisher")
    closed(manager_of(master), topics.pubs, "again", Registration.PUB)
    # The master of this test answers one at a time: that it is registered comes after the answer.
    lists(master, lambda: told.is_set() or threading.Thread(target=open_again, daemon=True).start() or wait_for(
        lambda: "again" in topics.pubs, WAIT_S, "it opens"))
    with watch(0.005):
        assert told.wait(WAIT_S)
        wait_for(lambda: not rospy_compat.not_registered.is_set(), WAIT_S, "all is told")
    assert set(master.topics) == {"stays", "again"}


def test_a_service_that_opens_does_not_wait_for_who_opens_a_topic(master, topics):
    """rospy tells of a service under the lock of its listeners, for which who opens a topic waits with that of topics:
    each would wait for the other for ever."""
    told = []
    master.register_function(lambda node, name, address, uri: told.append(name) or [1, "", 1], "registerService")
    opening = threading.Thread(target=rospy_compat._reg_added, daemon=True, args=(
        manager_of(master), "/node/service", "rosrpc://127.0.0.1:1", Registration.SRV))
    with topics.lock:
        opening.start()
        opening.join(WAIT_S)
        assert told == ["/node/service"]


def manager_of(master):
    """What of rospy talks to this master."""
    return SimpleNamespace(master_uri="http://127.0.0.1:{}/".format(master.server_address[1]),
                           uri="http://127.0.0.1:1/", logger=logging.getLogger("registration"))


def opened(manager, kept, name, of=Registration.SUB):
    """Open a topic as rospy does."""
    kept[name] = object()
    rospy_compat._reg_added(manager, name, "std_msgs/String", of)


def closed(manager, kept, name, of=Registration.SUB):
    """Close a topic as rospy does."""
    del kept[name]
    rospy_compat._reg_removed(manager, name, "std_msgs/String", of)


def registering(master, topics):
    """What opens a topic that is registered with this master."""
    def advertise(identity, name, spec, listener):
        opened(manager_of(master), topics.pubs, identity + "/" + name, Registration.PUB)
        return object()

    return advertise
