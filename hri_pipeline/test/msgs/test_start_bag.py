"""Which program ends with a recording. Needs the message packages, no master."""

import os
import subprocess
import sys

import pytest

from hri_pipeline.nodes import start_bag


@pytest.mark.parametrize("name, ended", [("roslaunch", True), ("rostest", False)])
def test_a_launch_ends_with_the_recording_but_a_test_goes_on_as_it_would_report_success(tmp_path, monkeypatch, name,
                                                                                        ended):
    program = tmp_path / name
    program.write_text("print(flush=True)\ninput()\n")
    with subprocess.Popen([sys.executable, str(program), "greeter", "greet.test"], stdin=subprocess.PIPE,
                          stdout=subprocess.PIPE) as launch:
        launch.stdout.readline()
        monkeypatch.setattr(start_bag.rospy, "get_param", lambda *_: {"here": "http://localhost:1/"})
        monkeypatch.setattr(start_bag, "ServerProxy", lambda _: type("Launch", (), {
            "get_pid": lambda self: (1, "", launch.pid)})())
        monkeypatch.setattr(os, "getppid", lambda: launch.pid)
        assert start_bag._launch() == (launch.pid if ended else None)
        launch.communicate(b"\n")
