"""Questions to nodes that do not answer; and what a node remembers of its parameters, and sets on a master that has
lost them."""

from __future__ import annotations

import contextlib
import functools
import socket
import threading
import time
from xmlrpc.server import SimpleXMLRPCServer

import pytest
from rosgraph import xmlrpc

from hri_pipeline.ros import master
from hri_pipeline.ros.master import (
    ForeignNode,
    MasterAway,
    MasterWatch,
    OwnParameters,
    ParametersLost,
    PublisherAnswer,
    address_of_node,
    check_not_lost,
    does_publish,
    is_alive,
    node_at,
    patient_master,
    unregister_node,
)
from hri_pipeline.testing import wait_for

PATIENCE_S = 0.5
NAME = "/robot/faces"
RUN, OTHER = "3f6e2d3e-8c1a-11ef-9d3c-0242ac110002", "4a7b1c22-8c1a-11ef-9d3c-0242ac110002"


@pytest.fixture
def silent():
    """A node whose machine takes connections and never answers, as one that has been stopped."""
    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        listening.listen(5)
        yield "http://127.0.0.1:{}/".format(listening.getsockname()[1])


@pytest.fixture
def node():
    with SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False) as server:
        server.register_function(lambda caller: [1, "", 42], "getPid")
        server.register_function(lambda caller: [1, "", [["/mine", "std_msgs/String"]]], "getPublications")
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield "http://127.0.0.1:{}/".format(server.server_address[1])
        server.shutdown()
        thread.join()


@pytest.fixture
def nobody():
    with socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))
        yield "http://127.0.0.1:{}/".format(closed.getsockname()[1])


def test_who_does_not_answer_is_not_waited_for_and_other_sockets_keep_their_time_out(silent):
    before, seen, done = socket.getdefaulttimeout(), set(), threading.Event()

    def watch():
        while not done.wait(0.001):
            seen.add(socket.getdefaulttimeout())

    watching = threading.Thread(target=watch)
    watching.start()
    began = time.monotonic()
    try:
        assert not is_alive(silent, PATIENCE_S)
        assert does_publish(silent, "/mine", PATIENCE_S) is PublisherAnswer.NONE
    finally:
        done.set()
        watching.join()
    assert time.monotonic() - began < 10.0
    assert seen == {before}


def test_what_nodes_say(node, nobody):
    assert is_alive(node)
    assert not is_alive(nobody)
    assert does_publish(node, "/mine") is PublisherAnswer.YES
    assert does_publish(node, "/other") is PublisherAnswer.NO
    assert does_publish(nobody, "/mine") is PublisherAnswer.REFUSED


def test_the_api_of_a_master_that_hangs_is_not_waited_for(silent, monkeypatch):
    monkeypatch.setattr(master, "ANSWER_S", 0.05)
    monkeypatch.setattr(master, "node_at", functools.partial(node_at, patience=0.05))
    monkeypatch.setenv("ROS_MASTER_URI", silent)
    for question in (lambda: patient_master().getSystemState(), lambda: address_of_node("/rsp_abcde"),
                     lambda: unregister_node("/rsp_abcde")):
        with pytest.raises(OSError):
            question()


def test_the_start_of_a_node_does_not_wait_for_an_aggregator_that_hangs(monkeypatch):
    looks, answers, made = threading.Event(), threading.Event(), threading.Event()

    def look(aggregator):
        looks.set()
        assert answers.wait(10.0)

    def make():
        watches.append(MasterWatch())
        made.set()

    watches = []
    monkeypatch.setattr(ForeignNode, "look", look)
    monkeypatch.setattr(master, "register_without_waiting", lambda: None)
    monkeypatch.setattr(MasterWatch, "_ask", lambda watch: (1, "run"))
    threading.Thread(target=make, daemon=True).start()
    try:
        assert looks.wait(10.0) and made.wait(10.0)
        assert not answers.is_set(), "it is looked for all the same"
    finally:
        answers.set()
    watches[0].close()


@pytest.mark.parametrize("reached", [True, False])
def test_a_node_that_gives_a_wrong_address_to_others_says_so(reached, node, nobody, monkeypatch):
    said, looked = [], threading.Event()
    monkeypatch.setenv("ROS_HOSTNAME", "nowhere.invalid")
    monkeypatch.setattr(master, "own_address", lambda: node if reached else nobody)
    monkeypatch.setattr(master, "register_without_waiting", lambda: None)
    monkeypatch.setattr(master.rospy, "logwarn", lambda text, *values: said.append(text % values))
    monkeypatch.setattr(ForeignNode, "look", lambda aggregator: looked.set())
    monkeypatch.setattr(MasterWatch, "_ask", lambda watch: (1, "run"))
    with contextlib.closing(MasterWatch()):
        assert looked.wait(20.0)
    assert len(said) == (0 if reached else 1)
    assert all(nobody in text and "ROS_HOSTNAME is 'nowhere.invalid'" in text for text in said)


class Graph:
    """A master and a node (process 7), at `uri`, of which it knows or not; `told` is what either was told."""

    uri = "http://127.0.0.1:1/"

    def __init__(self, monkeypatch):
        self.knows, self.pid, self.code, self.told = True, 7, 1, []
        monkeypatch.setattr(master, "node_at", lambda uri: contextlib.nullcontext(self))
        monkeypatch.setattr(master, "own_address", lambda: self.uri)

    def lookupNode(self, caller, name):
        return [1, "", self.uri] if self.knows else [-1, "unknown", ""]

    def getPid(self, caller):
        return [1, "", self.pid]

    def getPublications(self, caller):
        return [1, "", [["/out", "std_msgs/String"]]]

    def getSubscriptions(self, caller):
        return [1, "", [["/in", "std_msgs/Bool"]]]

    def registerPublisher(self, *given):
        self.told.append(given)
        return [self.code, "", []]

    def registerSubscriber(self, *given):
        self.told.append(given)
        return [self.code, "no", ["http://publisher/"]]

    def publisherUpdate(self, *given):
        self.told.append(given)


@pytest.mark.parametrize("was_known, is_known, pid, registers", [
    (True, False, 7, True), (False, False, 7, False), (True, True, 7, False), (True, False, 8, False)])
def test_topics_of_the_aggregator_are_told_a_new_master_that_does_not_know_it_while_it_runs(
        monkeypatch, was_known, is_known, pid, registers):
    graph, aggregator = Graph(monkeypatch), ForeignNode("/hri_diagnostics")
    graph.knows = was_known
    aggregator.look()
    graph.knows, graph.pid = is_known, pid
    aggregator.register()
    assert graph.told == [("/hri_diagnostics", "/out", "std_msgs/String", graph.uri),
                          ("/hri_diagnostics", "/in", "std_msgs/Bool", graph.uri),
                          ("/master", "/in", ["http://publisher/"])] * registers


def test_a_subscription_that_is_registered_again_hears_who_publishes_unless_the_node_ends(monkeypatch):
    graph = Graph(monkeypatch)
    master.subscribe_again("/in", "std_msgs/Bool")
    assert graph.told == [(NAME, "/in", "std_msgs/Bool", graph.uri), ("/master", "/in", ["http://publisher/"])]
    graph.code = 0
    with pytest.raises(OSError, match="/in: no"):
        master.subscribe_again("/in", "std_msgs/Bool")
    graph.told.clear()
    monkeypatch.setattr(master.rospy, "is_shutdown", lambda: True)
    master.subscribe_again("/in", "std_msgs/Bool")
    assert graph.told == []


class FakeMaster:
    """The parameter server: a tree, and the names that were set."""

    def __init__(self, tree):
        self.tree, self.were_set, self.refuses = tree, [], False

    def getParam(self, caller, name):
        assert caller == NAME
        value = self.tree
        for word in name.strip("/").split("/"):
            if not isinstance(value, dict) or word not in value:
                return [-1, "not set", 0]
            value = value[word]
        return [1, "", value]

    def setParam(self, caller, name, value):
        assert caller == NAME
        if self.refuses:
            return [0, "no", 0]
        self.were_set.append(name)
        words = name.strip("/").split("/")
        place = self.tree
        for word in words[:-1]:
            place = place.setdefault(word, {})
        place[words[-1]] = value
        return [1, "", 0]


@pytest.fixture(autouse=True)
def server(monkeypatch):
    """The master that rospy itself asks; None while it is away."""
    reached = {"master": None}

    def set_param(name, value):
        if reached["master"] is None:
            raise OSError("away")
        reached["master"].setParam(NAME, NAME + "/" + name[1:], value)

    def get_param(name, default):
        code, _, value = reached["master"].getParam(NAME, name)
        return value if code == 1 else default

    monkeypatch.setattr(master.rospy, "get_name", lambda: NAME)
    monkeypatch.setattr(master.rospy, "set_param", set_param)
    monkeypatch.setattr(master.rospy, "get_param", get_param)
    for level in ("loginfo", "logwarn", "logerr"):
        monkeypatch.setattr(master.rospy, level, lambda text, *values: None)
    return reached


def tree():
    return {"robot": {"faces": {"expression": False, "size": 3, "more": {"a": 1, "b": 2}}},
            "humans": {"reference_frame": "odom"}, "other": {"x": 1}}


def kept():
    parameters = OwnParameters()
    parameters.keep(parameters.read(FakeMaster(tree())))
    return parameters


def test_all_of_its_own_and_of_the_stack_comes_back_and_nothing_else():
    new = FakeMaster({})
    assert kept().put_back(new) == [NAME, "/humans"]
    expected = tree()
    del expected["other"]
    assert new.tree == expected
    assert kept().put_back(new) == []


def test_what_somebody_has_set_stays():
    new = FakeMaster({"robot": {"faces": {"size": 7, "more": {"b": 9}}}, "humans": 5})
    assert sorted(kept().put_back(new)) == [NAME + "/expression", NAME + "/more/a"]
    assert new.tree == {"robot": {"faces": {"expression": False, "size": 7, "more": {"a": 1, "b": 9}}}, "humans": 5}


def test_a_node_without_parameters_sets_none():
    parameters, new = OwnParameters(), FakeMaster({})
    parameters.keep(parameters.read(FakeMaster({"robot": {"faces": {}}})))
    assert parameters.put_back(new) == [] and new.tree == {}


def test_a_refusal_is_told():
    new = FakeMaster({})
    new.refuses = True
    with pytest.raises(OSError, match="/robot/faces"):
        kept().put_back(new)


def test_live_changes_are_kept_also_while_the_master_is_away(server):
    parameters = kept()
    server["master"] = FakeMaster(tree())
    parameters.set("size", 4)
    assert server["master"].tree["robot"]["faces"]["size"] == 4
    server["master"] = None
    with pytest.raises(OSError):
        parameters.set("expression", True)
    new = FakeMaster({})
    parameters.put_back(new)
    assert new.tree["robot"]["faces"] == {"expression": True, "size": 4, "more": {"a": 1, "b": 2}}


def test_what_was_read_before_a_change_does_not_undo_it(server):
    parameters = kept()
    server["master"] = FakeMaster(tree())
    before = parameters.read(FakeMaster(tree()))
    parameters.set("size", 4)
    parameters.keep(before)
    new = FakeMaster({})
    parameters.put_back(new)
    assert new.tree["robot"]["faces"]["size"] == 4
    parameters.keep(parameters.read(FakeMaster({"robot": {"faces": {"size": 8}}})))
    new = FakeMaster({})
    parameters.put_back(new)
    assert new.tree == {"robot": {"faces": {"size": 8}}}


@pytest.mark.parametrize("folder, there, lost", [
    (RUN, {}, True),                                                        # a bare rosmaster
    (RUN, {"run_id": OTHER}, True),
    (RUN, {"run_id": RUN}, False),                                          # a launch that gives no parameters
    (RUN, {"run_id": OTHER, "robot": {"faces": {"size": 3}}}, False),       # put back
    ("logs", {"run_id": OTHER}, False),                                     # not by roslaunch
    (None, {"run_id": OTHER}, False),
])
def test_parameters_that_went_with_the_master_of_roslaunch_are_missed(server, folder, there, lost):
    server["master"] = FakeMaster(there)
    arguments = ["faces", "__name:=faces"] + (["__log:=/var/log/ros/%s/faces-1.log" % folder] if folder else [])
    if not lost:
        check_not_lost(arguments)
        return
    with pytest.raises(ParametersLost, match="/robot/faces has no parameters"):
        check_not_lost(arguments)


class Servers:
    """The master that answers now, its process id, and how often it was asked for parameters."""

    def __init__(self, monkeypatch):
        self.now, self.reads = (1, FakeMaster(tree())), 0
        monkeypatch.setattr(master.MasterConnection, "ask", lambda connection, name: (self.now[0], ""))
        monkeypatch.setattr(master, "node_at", self.node_at)
        monkeypatch.setattr(master.rosgraph, "get_master_uri", lambda: "")
        monkeypatch.setattr(master, "own_address", lambda: "")
        for name in ("own_publications", "own_services", "own_subscriptions"):
            monkeypatch.setattr(master, name, lambda: [])

    @contextlib.contextmanager
    def node_at(self, uri):
        self.reads += 1
        yield self.now[1]

    def restart(self):
        self.now = (self.now[0] + 1, FakeMaster({}))

    def faces(self):
        return self.now[1].tree.get("robot", {}).get("faces", {})


@pytest.fixture
def servers(monkeypatch):
    return Servers(monkeypatch)


def watching(parameters):
    return contextlib.closing(master.MasterWatch(0.005, parameters))


def test_a_watch_puts_back_what_was_there_last_also_by_the_hand_of_others(servers):
    with watching(OwnParameters()):
        servers.now[1].tree["robot"]["faces"]["size"] = 9
        known = servers.reads + 2
        wait_for(lambda: servers.reads >= known, 10, "asked again")
        servers.restart()
        wait_for(lambda: servers.faces() == dict(tree()["robot"]["faces"], size=9), 10, servers.faces)
        assert servers.now[1].tree["humans"] == tree()["humans"]


def test_what_a_master_that_has_just_begun_does_not_know_is_not_forgotten(servers):
    class RestartsBeforeItIsAsked(OwnParameters):
        asked = 0

        def read(self, there):
            self.asked += 1
            if self.asked == 2:
                servers.restart()
                there = servers.now[1]
            return super().read(there)

    with watching(RestartsBeforeItIsAsked()):
        wait_for(lambda: servers.now[0] == 2 and servers.faces() == tree()["robot"]["faces"], 10, servers.faces)


class AskedMaster(xmlrpc.ThreadingXMLRPCServer):
    """A master that counts the questions who it is; `end` ends it as the end of its process would."""

    def __init__(self, address=("127.0.0.1", 0), pid=42):
        self.connections, self.asked = [], 0
        super().__init__(address)
        self.register_function(lambda caller: self.count(pid), "getPid")
        self.register_function(lambda caller, name: [-1, "not set", 0], "getParam")
        self.register_function(lambda caller, name: [-1, "unknown", ""], "lookupNode")
        self.thread = threading.Thread(target=self.serve_forever, args=(0.01,), daemon=True)
        self.thread.start()

    def count(self, pid):
        self.asked += 1
        return [1, "", pid]

    def process_request(self, request, address):
        self.connections.append(request)
        super().process_request(request, address)

    def end(self):
        self.shutdown()
        self.thread.join()
        for connection in self.connections:
            with contextlib.suppress(OSError):      # who asked has ended it
                connection.shutdown(socket.SHUT_RDWR)
        self.server_close()


@pytest.fixture
def asked_master(monkeypatch):
    there = AskedMaster()
    monkeypatch.setattr(master.rosgraph, "get_master_uri", lambda: "http://127.0.0.1:%d/" % there.server_address[1])
    yield there
    there.end()


def test_the_end_of_a_master_is_seen_without_asking_it(asked_master):
    with contextlib.closing(master.MasterConnection()) as connection:
        assert not connection.is_open()
        assert connection.ask(NAME) == (42, "")
        assert all(connection.is_open() for _ in range(100)) and asked_master.asked == 1
        asked_master.end()
        wait_for(lambda: not connection.is_open(), 10, "its end")
        with pytest.raises(MasterAway):
            connection.ask(NAME)
        assert not connection.is_open()
        other = AskedMaster(asked_master.server_address, 43)
        try:
            assert connection.ask(NAME) == (43, "") and connection.is_open()
        finally:
            other.end()


def test_a_master_in_a_container_is_told_from_the_one_before_by_the_id_of_its_run(asked_master):
    """Each has the process id 1."""
    with contextlib.closing(master.MasterConnection()) as connection:
        for run in (RUN, OTHER):
            asked_master.register_function(lambda caller, name, run=run: [1, "", run], "getParam")
            assert connection.ask(NAME) == (42, run)


def test_a_master_that_stays_is_seldom_asked_who_it_is(asked_master, monkeypatch):
    looks = []
    is_open = master.MasterConnection.is_open
    monkeypatch.setattr(master.MasterConnection, "is_open", lambda self: looks.append(0) or is_open(self))
    with watching(None):
        wait_for(lambda: len(looks) >= 40, 20, "looks")
        assert 40 // 4 <= asked_master.asked <= len(looks) // 4 + 2


def test_a_master_to_which_its_name_leads_from_now_on_is_found_while_the_other_one_still_runs(monkeypatch):
    one = AskedMaster()
    other, found = AskedMaster(("127.0.0.2", one.server_address[1]), 43), [one]
    monkeypatch.setattr(master.rosgraph, "get_master_uri", lambda: "http://robot.invalid:%d/" % one.server_address[1])
    resolve = socket.getaddrinfo
    monkeypatch.setattr(socket, "getaddrinfo", lambda host, *values, **names: resolve(
        found[0].server_address[0] if host == "robot.invalid" else host, *values, **names))
    try:
        with watching(None):
            wait_for(lambda: one.asked > 2, 20, "questions")
            found[0] = other
            wait_for(lambda: other.asked, 20, "the other master")
    finally:
        one.end()
        other.end()


def test_a_watch_registers_at_a_new_master_at_the_first_look_after_it(asked_master, monkeypatch):
    looks, other, told = [], [], []
    is_open = master.MasterConnection.is_open

    def look(connection):
        looks.append(0)
        if len(looks) == 3:
            asked_master.end()
            other.append(AskedMaster(asked_master.server_address, 43))
        return is_open(connection)

    monkeypatch.setattr(master.MasterConnection, "is_open", look)
    monkeypatch.setattr(MasterWatch, "_register_again",
                        lambda watch, is_new: told.append((is_new, len(looks))) or True)
    try:
        with watching(None):
            wait_for(lambda: len(looks) > 5, 20, "the watch looks")
        assert told == [(True, 3)]
    finally:
        other[0].end()


def test_a_watch_without_parameters_touches_none(servers):
    with watching(None):
        reads = servers.reads
        servers.restart()
        wait_for(lambda: servers.reads > reads, 10, "registered again")
    assert servers.now[1].were_set == []


def test_after_another_launch_the_parameters_are_those_with_which_the_node_began(server):
    """Another launch, without privacy:=strict, has set those of the nodes of the same names."""
    master = server["master"] = FakeMaster({"robot": {"faces": {"expression": False, "rate": 10.0}}})
    parameters = OwnParameters()
    parameters.keep(parameters.read(master))
    assert not parameters.take_back(master)
    parameters.set("rate", 5.0)
    master.tree["robot"]["faces"] = {"expression": True, "max_faces": 3}
    parameters.keep(parameters.read(master))        # before the other node has taken over the name
    assert parameters.take_back(master)
    assert master.tree["robot"]["faces"] == {"expression": False, "rate": 5.0}
    master.tree["robot"]["faces"], master.refuses = {}, True
    with pytest.raises(OSError, match="refuses"):
        parameters.take_back(master)
