"""start_bag beside a busy machine, where one question without an answer is not the end of the recording, and which
program ends with it. Needs the message packages, no master."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from xmlrpc.server import SimpleXMLRPCServer

import pytest
import rospy

from hri_pipeline.nodes import start_bag
from hri_pipeline.nodes.start_bag import PausedPlayer, fault_of_file
from hri_pipeline.ros.services import NoAnswer


def test_a_recording_that_was_cut_off_is_told_before_anything_starts(tmp_path):
    path = tmp_path / "cut.bag"
    path.write_bytes(b"#ROSBAG V2.0\n" + (21).to_bytes(4, "little") + b"\x11\x00\x00\x00index_pos=" + bytes(7))
    assert "was not closed" in fault_of_file(str(path)) and "rosbag reindex " + str(path) in fault_of_file(str(path))


class Failing:
    """Answers as a master and as a player do, but for the first questions."""

    def __init__(self, failures):
        self.failures = failures
        self.asked = 0

    def _answer(self, value):
        self.asked += 1
        if self.asked <= self.failures:
            raise OSError("busy")
        return value

    def getPid(self, caller):
        return self._answer([1, "", 1])

    def getSystemState(self):
        return self._answer([[["/camera/image_raw", ["/bag"]], ["/clock", ["/bag"]]], [], []])


@pytest.fixture
def player(monkeypatch):
    monkeypatch.setattr(start_bag, "AGAIN_S", 0.01)
    servers = []

    def make(failures):
        given, server = PausedPlayer("bag"), SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False)
        behind = Failing(failures)
        server.register_instance(behind)
        threading.Thread(target=server.serve_forever, daemon=True).start()
        servers.append(server)
        behind.lookupNode = lambda name: "http://127.0.0.1:{}/".format(server.server_address[1])
        given._master = behind
        return given

    yield make
    for server in servers:
        server.shutdown()
        server.server_close()


@pytest.mark.parametrize("failures, there", [(0, True), (1, True), (2, True), (99, False)])
def test_a_player_has_ended_when_it_does_not_answer_several_times_in_a_row(player, failures, there):
    assert player(failures).is_there() == there


def test_a_player_whose_address_nobody_serves_has_ended(player):
    gone = player(0)
    gone._master.lookupNode = lambda name: "http://127.0.0.1:9/"
    assert not gone.is_there()


def test_what_is_played_is_asked_for_again(player):
    assert player(2).played() == {"/camera/image_raw"}


def test_a_master_that_never_answers_is_an_error_that_says_so(player):
    with pytest.raises(rospy.ROSException, match="ROS master.*busy"):
        player(99).played()


@pytest.mark.parametrize("failures", [0, 2])
def test_the_player_is_told_again_to_go(player, failures, monkeypatch):
    told = []

    def call(value):
        told.append(value)
        if len(told) <= failures:
            raise rospy.ServiceException("transport error")

    monkeypatch.setattr(rospy, "ServiceProxy", lambda name, kind: call)
    player(0).go()
    assert told == [False] * (failures + 1)


def test_a_player_that_never_takes_it_is_an_error(player, monkeypatch):
    def call(value):
        raise rospy.ServiceException("transport error")

    monkeypatch.setattr(rospy, "ServiceProxy", lambda name, kind: call)
    with pytest.raises(rospy.ServiceException):
        player(0).go()


@pytest.mark.parametrize("name, ended", [("roslaunch", True), ("rostest", False)])
def test_a_launch_ends_with_the_recording_but_a_test_goes_on_as_it_would_report_success(tmp_path, monkeypatch, name,
                                                                                        ended):
    program = tmp_path / name
    program.write_text("print(flush=True)\ninput()\n")
    with subprocess.Popen([sys.executable, str(program), "greeter", "greet.test"], stdin=subprocess.PIPE,
                          stdout=subprocess.PIPE) as launch:
        launch.stdout.readline()
        monkeypatch.setattr(start_bag.rospy, "get_param", lambda *_: {"here": "http://localhost:1/"})
        monkeypatch.setattr(start_bag, "node_at", lambda _: type("Launch", (), {
            "get_pid": lambda self: (1, "", launch.pid)})())
        monkeypatch.setattr(os, "getppid", lambda: launch.pid)
        assert start_bag._launch() == (launch.pid if ended else None)
        launch.communicate(b"\n")


def test_a_player_that_hangs_is_named_and_not_waited_for(player, monkeypatch):
    end = threading.Event()
    monkeypatch.setattr(start_bag, "ANSWER_S", 0.05)
    monkeypatch.setattr(rospy, "ServiceProxy", lambda name, kind: lambda value: end.wait(60.0))
    try:
        with pytest.raises(NoAnswer, match="^/bag/pause_playback has not answered"):
            player(0).go()
    finally:
        end.set()
