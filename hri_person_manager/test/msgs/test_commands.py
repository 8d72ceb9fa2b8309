"""Commands that write what a user has: what they refuse, and what stays."""

import errno
import io
import os
import sys
import threading
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import pytest
import rosgraph
import roslaunch.config
import roslaunch.xmlloader
import rospkg
import rospy
import rosservice
from rospy.exceptions import TransportTerminated
from tf2_msgs.msg import TFMessage

from hri_msgs.msg import IdsList
from hri_person_manager.core.camera_poses import CameraPoses
from hri_person_manager.ros import cameras, cli, services
from hri_person_manager.ros.cameras import (
    CameraEntry,
    CameraFileError,
    launch_arguments,
    read_cameras,
    run_calibrate,
    write_cameras,
)
from hri_person_manager.ros.cli import known_table, run_people
from hri_person_manager.ros.services import Galleries
from hri_person_manager.srv import ListKnownResponse
from hri_pipeline.core import error_log
from hri_pipeline.core.frames import scan
from hri_pipeline.core.geometry import Pose
from hri_pipeline.ros.conversions import transform_to_msg
from hri_pipeline.ros.services import call_service
from hri_pipeline.srv import GalleryResponse
from hri_pipeline.testing import wait_for

LEFT = CameraEntry("left", "/left/image", "/left/camera_info", "left_optical")


@pytest.mark.parametrize("name", ["x" * 65, "An\nna", "  "])
def test_a_name_that_no_service_takes_is_not_enrolled_by_photographs_either(name, tmp_path, capsys):
    store = tmp_path / "private" / "people.sqlite"
    assert run_people(["enrol", "--name", name, str(tmp_path), "--store", str(store)]) in (1, 2)
    assert "photographs (" not in capsys.readouterr().err and not store.exists()


@pytest.mark.parametrize("words", [["watch"], ["watch", "--once"], ["list"], ["reset"]])
@pytest.mark.parametrize("where", ["init_node", "Subscriber"])
def test_where_no_thread_can_be_started_the_limit_is_named(words, where, monkeypatch, capsys):
    def no_thread(*given, **options):
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(rospy, "init_node", lambda *given, **options: None)
    monkeypatch.setattr(rospy, "signal_shutdown", lambda reason: None)
    monkeypatch.setattr(cli, "wait_for_master", lambda name, seconds: True)
    monkeypatch.setattr(cli, "find_manager", no_thread)
    monkeypatch.setattr(rospy, where, no_thread)
    monkeypatch.setattr(error_log, "fullest_group", lambda: (100, 100))
    monkeypatch.setattr(cli.signal, "signal", lambda *given: None)
    assert run_people(words) == 1
    said = capsys.readouterr().err.strip().split("\n")
    assert len(said) == 1 and said[0].startswith("people: the system gives no more threads: its container"), said


@pytest.mark.parametrize("words", [["watch", "--once"], ["list"]])
def test_a_command_that_cannot_be_connected_says_why_in_a_line(words, monkeypatch, capsys):
    def interrupted(*given, **options):
        raise rospy.ROSInitException("init_node interrupted before it could complete")

    monkeypatch.setattr(cli, "wait_for_master", lambda name, seconds: True)
    monkeypatch.setattr(rospy, "init_node", interrupted)
    monkeypatch.setattr(rospy, "signal_shutdown", lambda reason: None)
    monkeypatch.setattr(cli.signal, "signal", lambda *given: None)
    assert run_people(words) == 1
    assert capsys.readouterr().err == "people: init_node interrupted before it could complete\n"


def test_any_other_error_of_a_command_is_none_of_threads(monkeypatch):
    def broken(*given, **options):
        raise RuntimeError("broken")

    monkeypatch.setattr(cli, "wait_for_master", lambda name, seconds: True)
    monkeypatch.setattr(rospy, "init_node", broken)
    monkeypatch.setattr(rospy, "signal_shutdown", lambda reason: None)
    with pytest.raises(RuntimeError, match="broken"):
        run_people(["list"])


def test_a_file_of_cameras_stays_whole_where_the_disk_is_full(tmp_path, monkeypatch):
    path = tmp_path / "cameras.yaml"
    path.write_text("cameras: {}\n")

    def full(self, text, **options):
        with open(str(self), "w") as file:
            file.write(text[:5])
        raise OSError("No space left on device")

    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(OSError):
        write_cameras(path, "map", [LEFT])
    assert path.read_text() == "cameras: {}\n" and list(tmp_path.iterdir()) == [path]


def test_a_file_of_cameras_is_written_where_its_link_leads(tmp_path):
    path, link = tmp_path / "cameras.yaml", tmp_path / "link.yaml"
    path.write_text("cameras: {}\n")
    path.chmod(0o640)
    link.symlink_to(path)
    write_cameras(link, "map", [LEFT])
    assert link.is_symlink() and "left_optical" in path.read_text() and path.stat().st_mode & 0o777 == 0o640


@pytest.mark.parametrize("option", ["--stature", "--distance"])
@pytest.mark.parametrize("value", ["0", "-1.7", "nan", "inf"])
def test_lengths_are_above_zero(option, value, monkeypatch, capsys):
    monkeypatch.setattr(cameras, "read_cameras", lambda path: pytest.fail("it was taken"))
    with pytest.raises(SystemExit):
        run_calibrate(["calibrate_cameras", "cameras.yaml", "{}={}".format(option, value)])
    assert option in capsys.readouterr().err


@pytest.mark.parametrize("deviation, code", [((0.05, 0.02), 0), ((0.5, 0.02), 1), ((0.05, 0.2), 1)])
def test_uncertain_places_of_cameras_are_not_written(deviation, code, tmp_path, monkeypatch, capsys):
    path = tmp_path / "cameras.yaml"
    write_cameras(path, "map", [LEFT, replace(LEFT, name="right", frame="right_optical")])
    before = path.read_bytes()
    poses = CameraPoses((Pose(np.eye(3), np.zeros(3)), Pose(np.eye(3), np.array([1.0, 0.0, 0.0]))), {}, 0.001)
    monkeypatch.setattr(cameras, "_calibrate", lambda *_: (poses, [deviation], 500.0))
    assert run_calibrate(["calibrate_cameras", str(path), "--stature", "1.7"]) == code
    written = capsys.readouterr()
    assert (path.read_bytes() != before) == (code == 0)
    assert "right: " in written.out and "+- 0.05 m, 1.1 deg" in written.out if code == 0 else (
        "the pose of right is uncertain" in written.err and "Walk longer" in written.err)


def test_ignored_regions_of_each_camera_come_from_the_file_and_stay_in_it(tmp_path):
    path = tmp_path / "cameras.yaml"
    path.write_text("cameras:\n  a: {}\n  b: {ignored_regions: ['0.7 0 0.3  0.4']}\n"
                    "  c: {ignored_regions: ['0 0 0.5 1', '0.5 0 0.1 0.1']}\n")
    frame, found = read_cameras(path)
    given = dict(text.split(":=", 1) for text in launch_arguments(frame, found))
    assert given["left_ignored_regions"] == "" and given["right_ignored_regions"] == "['0.7 0 0.3 0.4']"
    assert given["more"].split(";")[-1] == "0,0,0.5,1|0.5,0,0.1,0.1"
    write_cameras(path, frame, found)
    assert read_cameras(path) == (frame, found)


@pytest.mark.parametrize("rows", ["['100 80 200 300']", "{x: 0}", "[[0, 0, 1, 1]]"])
def test_ignored_regions_that_are_none_are_refused_with_the_camera(rows, tmp_path):
    path = tmp_path / "cameras.yaml"
    path.write_text("cameras:\n  a: {}\n  b: {ignored_regions: %s}\n" % rows)
    with pytest.raises(CameraFileError, match="camera b.*"):
        read_cameras(path)


@pytest.mark.parametrize("more, wanted", [
    ("back", {"back": None}), ("back;;;;;;;0.7,0,0.3,0.4 side", {"back": ["0.7 0 0.3 0.4"], "side": None}),
    ("side back;;;;;;;0,0,0.5,1|0.5,0,0.1,0.1", {"back": ["0 0 0.5 1", "0.5 0 0.1 0.1"], "side": None})])
def test_the_launch_files_hand_ignored_regions_to_both_nodes_of_each_camera(more, wanted):
    found = launched_parameters("two_cameras.launch", "more:=" + more, "right_ignored_regions:=['0 0 1 0.1']")
    for camera, regions in dict(wanted, left=None, right=["0 0 1 0.1"]).items():
        for node in ("hri_faces", "hri_bodies"):
            assert found["/{}/{}/ignored_regions".format(camera, node)] == (regions or [])


@pytest.mark.parametrize("given, before", [(None, ""), ("robot1", "robot1/"), ("/robot1/", "robot1/")])
@pytest.mark.parametrize("file", ["ros4hri.launch", "scene.launch", "two_cameras.launch", "bag.launch", "demo.launch",
                                  "two_machines.launch"])
def test_in_a_group_with_a_namespace_the_tree_of_diagnostics_expects_its_nodes_when_it_is_told(file, given, before,
                                                                                               monkeypatch):
    monkeypatch.delenv("ROS_NAMESPACE", raising=False)
    found = launched_parameters(file, "diagnostics:=true", *(
        [] if given is None else ["diagnostics_namespace:=" + given]))
    expected = [name for key, names in found.items() if key.endswith("/expected") for name in names]
    assert before + "hri_person_manager: persons" in expected
    assert all(name.startswith(before + "hri_") for name in expected)


def launched_parameters(file, *arguments):
    """{name: value} of the parameters that a launch file sets."""
    config = roslaunch.config.ROSLaunchConfig()
    folder = Path(rospkg.RosPack().get_path("ros4hri")) / "launch"
    roslaunch.xmlloader.XmlLoader().load(str(folder / file), config, argv=list(arguments), verbose=False)
    return {name: parameter.value for name, parameter in config.params.items()}


def test_one_human_is_one_line_of_the_known():
    times = [rospy.Time(86400 * day) for day in (400, 500, 600, 700)]
    known = ListKnownResponse(
        ids=["ann", "bob", "old", "who"], aliases=["", "", "ann", "gone"], names=["", "Bob", "Ann", ""],
        native_languages=["", "", "fr", ""], anonymous=[False, False, False, True],
        enrolled=[False, False, True, False], tracked=[True, False, False, False], first_seen=times[::-1],
        last_seen=times)
    header, *lines = [line.split() for line in known_table(known).splitlines()]
    assert [line[0] for line in lines] == ["ann", "bob", "who"] and header[-1] == "ALIASES"
    assert [lines[0][1:5], lines[0][-1]] == [["Ann", "fr", "here", "enrolled"], "old"]
    assert lines[0][5].startswith("1971-05") and lines[0][7].startswith("1971-08"), "of all of its ids"
    assert [line[-1] for line in lines[1:]] == ["-", "-"] and lines[2][4] == "anonymous"
    header, *lines = [line.split() for line in known_table(known, every_id=True).splitlines()]
    assert [(line[0], line[-1]) for line in lines] == [("ann", "-"), ("bob", "-"), ("old", "ann"), ("who", "gone")]
    assert known_table(ListKnownResponse()) == "nobody is known"


@pytest.mark.parametrize("error", [rosgraph.network.ROSHandshakeException("ended"), TransportTerminated("ended")])
def test_a_recogniser_that_ends_while_it_is_asked_has_not_done_it(error, monkeypatch):
    def ends(name):
        raise error
    monkeypatch.setattr(Galleries, "names", staticmethod(lambda: ["/faces/gallery"]))
    monkeypatch.setattr(rospy, "wait_for_service", lambda *given: None)
    monkeypatch.setattr(rosservice, "get_service_type", ends)
    answer, = Galleries().call("forget", "ann")
    assert not answer.response.success and "/faces/gallery does not answer" in answer.response.message


def test_a_recogniser_that_never_answers_is_not_waited_for_when_it_is_asked_whom_it_knows(monkeypatch):
    end, asked = threading.Event(), []
    monkeypatch.setattr(Galleries, "names", staticmethod(lambda: ["/faces/gallery", "/odd/gallery", "/bad/gallery"]))
    monkeypatch.setattr(services, "GALLERY_ANSWER_S", 0.05)
    monkeypatch.setattr(rospy, "wait_for_service", lambda *given: None)
    monkeypatch.setattr(rosservice, "get_service_type", lambda name: "x/Y" if "odd" in name else "hri_pipeline/Gallery")
    answers = {"/bad/gallery": GalleryResponse(success=True, data="7")}
    monkeypatch.setattr(rospy, "ServiceProxy", lambda name, kind: lambda request: asked.append(name) or answers.get(
        name) or end.wait(20.0) and GalleryResponse(success=True, data='["ann"]'))
    galleries = Galleries()
    assert galleries.known_to("/faces") is None and galleries.known_to("/faces") is None
    assert asked == ["/faces/gallery"], "it is not asked again while it owes an answer"
    assert [galleries.known_to(name) for name in ("/odd", "/bad", "/none")] == [None, None, None]
    end.set()
    wait_for(lambda: galleries.known_to("/faces") == {"ann"}, 20, "it answers again")


def test_names_that_the_terminal_cannot_write_end_no_command(monkeypatch):
    """A name in Arabic letters where the terminal knows Western European ones."""
    written = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(written, "latin-1", write_through=True))
    monkeypatch.setattr(cli, "wait_for_master", lambda *given: True)
    monkeypatch.setattr(cli, "find_manager", lambda: "/manager")
    monkeypatch.setattr(rospy, "init_node", lambda *given, **options: None)
    monkeypatch.setattr(rospy, "signal_shutdown", lambda reason: None)
    monkeypatch.setattr(cli, "service", lambda *given: lambda: ListKnownResponse(
        ids=["ali", "bor"], aliases=["", ""], names=["\u0639\u0644\u06cc", "Bj\u00f6rn"], native_languages=["", ""],
        anonymous=[False, False], enrolled=[False, False], tracked=[True, True], first_seen=2 * [rospy.Time(1)],
        last_seen=2 * [rospy.Time(1)]))
    assert run_people(["list"]) == 0
    assert "\\u0639" in written.getvalue().decode("latin-1") and "Bj\u00f6rn" in written.getvalue().decode("latin-1")


def test_a_person_manager_that_hangs_is_named_and_not_waited_for(monkeypatch, capsys):
    end = threading.Event()
    monkeypatch.setattr(services, "wait_for_service", lambda *given: None)
    monkeypatch.setattr(services, "call_service", lambda name, kind, values, seconds: call_service(name, kind, values,
                                                                                                 seconds * 1e-3))
    monkeypatch.setattr(cli, "wait_for_master", lambda *given: True)
    monkeypatch.setattr(rospy, "init_node", lambda *given, **options: None)
    monkeypatch.setattr(rospy, "signal_shutdown", lambda reason: None)
    monkeypatch.setattr(rospy, "ServiceProxy", lambda name, kind: lambda *values: end.wait(60.0))
    try:
        for arguments, seconds in ((["list"], "0.01"), (["forget", "ann"], "0.04"), (["forget-all", "--yes"], "0.04"),
                                   (["reset"], "0.04"), (["export"], "0.04")):
            assert run_people(["--node", "/manager"] + arguments) == 1
            said = capsys.readouterr().err
            assert said.startswith("people: /manager/") and "has not answered within %s s" % seconds in said
            assert "start it again" in said and "Is the person manager running?" not in said
    finally:
        end.set()


def test_a_table_that_the_disk_does_not_take_is_named(monkeypatch, capsys):
    class Watch:
        seen = frozenset(["ann"])

        def rows(self):
            return []

        def rates(self):
            return 0.0, 0.0

        def nobody(self):
            return ""

        def close(self):
            pass

    def full(path, data):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))      # of the stream: it does not know its file

    monkeypatch.setattr(cli, "PersonsWatch", Watch)
    monkeypatch.setattr(cli, "MasterWatch", lambda: SimpleNamespace(away=False, close=lambda: None))
    monkeypatch.setattr(cli, "_end_quietly", lambda: None)
    monkeypatch.setattr(cli, "write_json", full)
    options = cli.parse_arguments(["--duration", "0.01", "--json", "/full/table.json"])
    assert cli._show_until(options, 0.0, "people") == 1
    assert capsys.readouterr().err == (
        "people: the table cannot be written to /full/table.json: No space left on device\n")


@pytest.mark.parametrize("simulated, after, left", [
    (False, 100.0, []),
    (True, 100.05, ["eve"]),        # /clock stands still: a paused bag
    (True, 102.0, []),
    (True, 90.0, []),               # the bag has begun anew
])
def test_who_is_out_of_view_stays_in_the_table_while_the_clock_stands_still(monkeypatch, simulated, after, left):
    for name in ("IdSubscribers", "TfSubscriber"):
        monkeypatch.setattr(cli, name, MagicMock())
    monkeypatch.setattr(cli.rospy, "Subscriber", MagicMock())
    monkeypatch.setattr(rospy.rostime, "is_wallclock", lambda: not simulated)
    times = {"wall": 5.0, "ros": 100.0}
    monkeypatch.setattr(cli, "time", SimpleNamespace(monotonic=lambda: times["wall"]))
    monkeypatch.setattr(cli.rospy, "get_time", lambda: times["ros"])
    watch = cli.PersonsWatch()
    watch._on_known(IdsList(ids=["eve"]))
    data = io.BytesIO()
    TFMessage([transform_to_msg(Pose.identity(), rospy.Time(100), "map", "person_eve")]).serialize(data)
    watch._on_frames(data.getvalue(), scan(data.getvalue()), False)
    assert [row.id for row in watch.rows()] == ["eve"]
    times.update(wall=65.0, ros=after)
    assert [row.id for row in watch.rows()] == left
