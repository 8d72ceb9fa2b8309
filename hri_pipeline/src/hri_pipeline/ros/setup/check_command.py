"""The command `check`: says in words why nobody appears."""

from __future__ import annotations

import os
import sys
import threading
from concurrent.futures import Future, wait
from types import SimpleNamespace

import rosgraph
import rospy

from hri_pipeline.core.parameters import ParameterError
from hri_pipeline.core.setup.check_parameters import CHECK_PARAMETERS
from hri_pipeline.core.setup.setup_check import as_text, check, is_well
from hri_pipeline.core.setup.setup_facts import Facts
from hri_pipeline.ros.master_watch import MasterAway, ask_master
from hri_pipeline.ros.parameters_ros import read_parameters
from hri_pipeline.ros.setup.graph_probe import GraphProbe

_MASTER = "FAULT  no ROS master answers at {}\n       -> start roscore or roslaunch, or set ROS_MASTER_URI"

_MASTER_S = 1.0
_HELP = """Usage: rosrun hri_pipeline check [image:=TOPIC] [camera_info:=TOPIC] [_PARAMETER:=VALUE ...]

{} The exit code is 0 when people can appear.

Parameters:
{}"""


def main() -> int:
    """Look, print, and return the exit code: 0 when people can appear, 1 with a fault, 2 for wrong parameters."""
    if {"-h", "--help"} & set(sys.argv[1:]):
        print(_HELP.format(CHECK_PARAMETERS.summary, "\n".join(
            "  _{}:={}  {}".format(one.name, one.default, one.doc) for one in CHECK_PARAMETERS.parameters)))
        return 0
    if not _master_answers():
        return 1
    rospy.init_node("hri_check", anonymous=True, disable_signals=True)
    try:
        settings = read_parameters(CHECK_PARAMETERS)
    except ParameterError as error:
        print(error, file=sys.stderr)
        return 2
    print("looking at the graph for some {:.0f} s ...".format(1.3 * settings.watch_time), flush=True)
    try:
        findings = check(_look(settings), settings)
    except KeyboardInterrupt:
        return 130
    finally:
        rospy.signal_shutdown("done")
    print(as_text(findings), flush=True)
    return 0 if is_well(findings) else 1


def _look(settings: SimpleNamespace) -> Facts:
    """Look in another thread, and end this process when the master goes: rospy would wait for it for ever."""
    looking: "Future[Facts]" = Future()

    def look() -> None:
        try:
            probe = GraphProbe(settings)
            try:
                facts = probe.look()
            finally:
                probe.close()
            looking.set_result(facts)
        except Exception as error:
            looking.set_exception(error)
    threading.Thread(target=look, name="look", daemon=True).start()
    while not looking.done():
        wait([looking], timeout=_MASTER_S)
        if not _master_answers():
            os._exit(1)
    return looking.result()


def _master_answers() -> bool:
    """Tell whether the master answers within some seconds, and print it if not."""
    try:
        ask_master("/hri_check")
    except MasterAway:
        print(_MASTER.format(rosgraph.get_master_uri()), flush=True)
        return False
    return True
