"""Questions to nodes that do not answer."""

from __future__ import annotations

import socket
import threading
import time
from xmlrpc.server import SimpleXMLRPCServer

import pytest

from hri_pipeline.ros import master as module
from hri_pipeline.ros.master import ForeignNode, MasterWatch, PublisherAnswer, does_publish, is_alive

PATIENCE_S = 0.5


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
    monkeypatch.setattr(module, "register_without_waiting", lambda: None)
    monkeypatch.setattr(MasterWatch, "_ask", lambda watch: (1, "run"))
    threading.Thread(target=make, daemon=True).start()
    try:
        assert looks.wait(10.0) and made.wait(10.0)
        assert not answers.is_set(), "it is looked for all the same"
    finally:
        answers.set()
    watches[0].close()
