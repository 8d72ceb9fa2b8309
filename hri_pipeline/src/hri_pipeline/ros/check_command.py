"""The command `check`: says in words why nobody appears."""

from __future__ import annotations

import sys

import rosgraph
import rospy

from hri_pipeline.core.parameters import ParameterError
from hri_pipeline.core.setup.check_parameters import CHECK_PARAMETERS
from hri_pipeline.core.setup.setup_check import as_text, check, is_well
from hri_pipeline.ros.graph_probe import GraphProbe
from hri_pipeline.ros.parameters_ros import read_parameters

_MASTER = "FAULT  no ROS master answers at {}\n       -> start roscore or roslaunch, or set ROS_MASTER_URI"


def main() -> int:
    """Look, print, and return the exit code: 0 when people can appear, 1 with a fault, 2 for wrong parameters."""
    if not rosgraph.is_master_online():
        print(_MASTER.format(rosgraph.get_master_uri()))
        return 1
    rospy.init_node("hri_check", anonymous=True, disable_signals=True)
    try:
        settings = read_parameters(CHECK_PARAMETERS)
    except ParameterError as error:
        print(error, file=sys.stderr)
        return 2
    print("looking at the graph for some {:.0f} s ...".format(1.3 * settings.watch_time), flush=True)
    probe = GraphProbe(settings)
    try:
        findings = check(probe.look(), settings)
    except KeyboardInterrupt:
        return 130
    finally:
        probe.close()
        rospy.signal_shutdown("done")
    print(as_text(findings), flush=True)
    return 0 if is_well(findings) else 1
