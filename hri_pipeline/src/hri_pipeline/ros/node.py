"""Start and end of a node, and its parameters."""

from __future__ import annotations

import logging
import math
import os
import signal
import sys
import threading
import time
import traceback
from types import FrameType
from typing import Any, Callable, Dict, NoReturn, Optional, Protocol, Sequence, Tuple

import rosgraph
import rospy
from rospy.exceptions import ROSInitException

from hri_pipeline.core.error_log import LogFilter, thread_shortage
from hri_pipeline.core.onnx import ModelError
from hri_pipeline.core.parameters import ParameterError, ParameterTable, S
from hri_pipeline.core.privacy import StoreError
from hri_pipeline.core.process import GarbageCollector, one_thread_each, raise_mmap_threshold
from hri_pipeline.ros.diagnostics import ERROR, NodeDiagnostics
from hri_pipeline.ros.master import (
    MasterAway,
    MasterWatch,
    OwnParameters,
    ParametersLost,
    ask_master,
    check_not_lost,
    is_alive,
    launched_for_earlier_master,
    node_at,
)
from hri_pipeline.ros.rospy_compat import prepare_rospy

_RETRY_S = 1.0
_SAY_EVERY = 10
_LONGEST_PAUSE_S = 60.0

# Errors of whoever set the node up: one line says it, a traceback would hide it.
SETUP_ERRORS = (ParameterError, ModelError, StoreError)


class _Closable(Protocol):
    def close(self) -> None:
        """Give everything back. Idempotent."""


class RunnableNode(_Closable, Protocol):
    """What run_node runs."""

    def spin(self) -> None:
        """Work until ROS shuts down."""


class _Stop(BaseException):
    """SIGINT or SIGTERM came. No `except Exception` on the way holds it up."""


_stopped = threading.Event()
"""Set once SIGINT or SIGTERM came."""


def run_node(name: str, build: Callable[[], RunnableNode], parameters: Optional[OwnParameters] = None) -> NoReturn:
    """Run a node and end the process.

    Waits for the master, initialises rospy as `name`, calls build() and spin() of what it returns. On SIGINT,
    SIGTERM or any exception its close() is called while ROS still works, then ROS is shut down.
    Exit code 0, or 1 after an error; SETUP_ERRORS are told in one line. Where roslaunch would start the node again,
    it then waits until its parameters change, or until a node of the same name has ended: see `_wait_for_change` and
    `_wait_while_replaced`. parameters: those that the node changes itself are set there.
    """
    _install_handlers()
    _look_at_arguments(name, rospy.myargv(sys.argv)[1:])
    # Without room for its log, Python would print a traceback for each line that it cannot write.
    logging.raiseExceptions = False
    logging.getLogger("rosout").addFilter(LogFilter())
    raise_mmap_threshold()
    one_thread_each()
    prepare_rospy()
    code, parameters = 0, parameters or OwnParameters()
    try:
        wait_for_master(name)
        rospy.init_node(name, disable_signals=True)
        code = _run(build, parameters)
    except _Stop:
        pass
    except (ROSInitException, RuntimeError) as error:
        if not isinstance(error, ROSInitException) and not thread_shortage(error):
            raise
        sys.stderr.write("{}: {}\n".format(name, thread_shortage(error) or error))
        code = 1
    rospy.signal_shutdown("{} has ended".format(name))
    if not _stopped.is_set():
        _wait_while_replaced(parameters)
    sys.exit(code)


def _look_at_arguments(name: str, others: Sequence[str]) -> None:
    """Tell of the arguments that are none of ROS's; with --help among them the process ends."""
    usage = ("usage: rosrun PACKAGE {} [TOPIC:=OTHER_TOPIC ...] [_PARAMETER:=VALUE ...] [__name:=NAME] [__ns:=SPACE]\n"
             "topics and parameters: docs/nodes, and the YAML files in config of the package\n").format(
                 os.path.basename(sys.argv[0]))
    if {"-h", "--help"} & set(others):
        sys.stdout.write(usage)
        sys.exit(0)
    if others:
        sys.stderr.write("{}: {} is ignored\n{}".format(name, " ".join(others), usage))
        sys.stderr.flush()


def read_parameters(table: ParameterTable[S]) -> S:
    """Return the parameters of `table` out of the private namespace.

    Where one is not set there, its parameter of the whole stack counts (Parameter.shared), and then its default.
    Raises ParameterError that names the parameter, its value and what is legal.
    """
    namespace = rospy.get_name()
    given = rospy.get_param(namespace, {})
    if not isinstance(given, dict):
        raise ParameterError("{} is a value on the parameter server, not a set of parameters".format(namespace))
    shared = {parameter.name: parameter for parameter in table.parameters if parameter.shared}
    # No name, as of an argument that was left empty, is no frame: it counts as not set, unless it is the default.
    given = {name: value for level in (_shared(table), given) for name, value in level.items()
             if value != "" or name not in shared or shared[name].default == ""}
    try:
        return table.resolve(given)
    except ParameterError as error:
        raise ParameterError("{}: {}".format(namespace, error)) from error


def wait_for_master(name: str, patience: float = math.inf) -> bool:
    """Return True as soon as the master answers, False without one after `patience` s; one line says what is missing.

    With the default patience, the line is repeated every few seconds. Ctrl-C ends the process with code 130, unless the
    caller has a handler of its own.
    """
    end = time.monotonic() + patience
    tries = 0
    try:
        while True:
            try:
                ask_master("/" + name)
                break
            except MasterAway as error:
                left = end - time.monotonic()
                if tries == 0 or (tries % _SAY_EVERY == 0 and left == math.inf):
                    _say_away(name, error, left)
            if left <= 0.0:
                return False
            tries += 1
            threading.Event().wait(min(_RETRY_S, left))
    except KeyboardInterrupt:
        raise SystemExit(130) from None
    if tries:
        sys.stderr.write("{}: the ROS master is there\n".format(name))
    return True


def end_simulated_time() -> None:
    """Delete /use_sim_time: the publisher of /clock ends, and a node that is started later would wait for ever."""
    try:
        if rospy.get_param("/use_sim_time", False):
            rospy.delete_param("/use_sim_time")
    except Exception as error:      # the master has gone, and its parameters with it; rospy raises many kinds
        rospy.logdebug("/use_sim_time is left: %s", error)


def _shared(table: ParameterTable) -> Dict[str, object]:
    """Return the parameters of the whole stack that are set, by the names that they have in this table."""
    return {parameter.name: rospy.get_param(parameter.shared) for parameter in table.parameters
            if parameter.shared and rospy.has_param(parameter.shared)}


def _say_away(name: str, error: MasterAway, left: float) -> None:
    waiting = "." if left <= 0.0 else ". Waiting." if left == math.inf else ". Waiting for {:.0f} s.".format(left)
    sys.stderr.write("{}: no ROS master at {} ({}); start roscore or roslaunch{}\n".format(
        name, rosgraph.get_master_uri(), error, waiting))
    sys.stderr.flush()


def _run(build: Callable[[], RunnableNode], parameters: OwnParameters) -> int:
    """Build, spin and close; return the exit code."""
    node: Optional[RunnableNode] = None
    watch: Optional[MasterWatch] = None
    collector: Optional[GarbageCollector] = None
    code = 0
    try:
        watch = MasterWatch(parameters=parameters)
        check_not_lost(sys.argv)
        node = build()
        one_thread_each()     # for libraries that came with the node
        collector = GarbageCollector()
        node.spin()
    except _Stop:
        pass
    except SETUP_ERRORS as error:
        rospy.logfatal("%s", error)
        code = 1
        _wait_for_change(error)
    except Exception as error:
        shortage = thread_shortage(error)
        rospy.logfatal("%s ends because of an error:%s", rospy.get_name(),
                       " " + shortage if shortage else "\n" + traceback.format_exc())
        code = 1
    finally:
        _ignore_signals()
        for owner in (node, watch, collector):
            code = max(code, _close(owner))
    return code


def _wait_for_change(error: Exception) -> None:
    """Wait, with the error on /diagnostics, while it would be of no use to be started again by roslaunch.

    That is until the parameters change. What may pass by itself, such as a port or a file in use, a missing model, is
    tried again after a second, then after two, four, and so on.
    """
    restarts = 0 if launched_for_earlier_master(sys.argv) else _restarts()  # this one does not know of roslaunch
    if restarts is None:
        return
    may_pass = isinstance(error, (ModelError, StoreError)) or isinstance(error.__cause__, (OSError, StoreError))
    end = time.monotonic() + (min(2.0 ** restarts, _LONGEST_PAUSE_S) if may_pass else math.inf)
    name = rospy.get_name()
    if not may_pass and not isinstance(error, ParametersLost):
        rospy.logwarn("%s waits for its parameters to change: set them with rosparam (it then ends, and roslaunch "
                      "starts it again), or end this launch, mend its file and start it again", name)
    diagnostics = NodeDiagnostics(name)
    diagnostics.set("settings", ERROR, str(error))
    try:
        before = _given(name)
        while not rospy.is_shutdown() and time.monotonic() < end and _given(name) == before:
            time.sleep(_RETRY_S)
    except (OSError, rosgraph.MasterError):
        pass                        # the master has gone, and its parameters with it
    finally:
        diagnostics.close()


def _wait_while_replaced(parameters: OwnParameters) -> None:
    """Wait while another node of this name runs, where roslaunch would start this one again.

    Of two nodes of one name the master ends the older. Two launches would start theirs again and again, and each would
    end that of the other. The other launch has set the parameters, as of privacy, for both: at the end those of this
    one are set again.
    """
    _install_handlers()
    try:
        other = _other_node()
        if not other or _restarts() is None:
            return
        sys.stderr.write("{}: another node of this name was started, at {} (the stack is launched twice?). This one "
                         "waits until that has ended: end one of the two launches\n".format(rospy.get_name(), other))
        sys.stderr.flush()
        while _other_node():
            time.sleep(_RETRY_S)
        with node_at(rosgraph.get_master_uri()) as master:
            if parameters.take_back(master):
                sys.stderr.write("{}: the other node has ended; the parameters of this launch are set again\n".format(
                    rospy.get_name()))
    except _Stop:
        pass
    except Exception as error:      # the master has gone, and the parameters with it
        sys.stderr.write("{}: the parameters of this launch are not set again: {}\n".format(rospy.get_name(), error))


def _other_node() -> str:
    """Return the address of another node of this name, empty without one that answers."""
    try:
        with node_at(rosgraph.get_master_uri()) as master:
            code, _, uri = master.lookupNode(rospy.get_name(), rospy.get_name())
    except Exception:               # the master has gone, and the other node's registration with it
        return ""
    return uri if code == 1 and uri != rospy.get_node_uri() and is_alive(uri) else ""


def _given(name: str) -> Tuple[object, object]:
    """Return the parameters of a node, and those of the whole stack."""
    return rospy.get_param(name, {}), rospy.get_param("/humans", {})


def _restarts() -> Optional[int]:
    """Return how often roslaunch has started this process again; None where it does not do so."""
    for uri in rospy.get_param("/roslaunch/uris", {}).values():
        for process in _ask_launch(uri, lambda launch: [name for name, _ in launch.list_processes()[2][0]]) or ():
            # One at a time: of the master that it has started itself, roslaunch cannot tell.
            known = _ask_launch(uri, lambda launch, process=process: launch.process_info(process)[2]) or {}
            if known.get("pid") == os.getpid():
                return int(known["spawn_count"]) - 1 if known["respawn"] else None
    return None


def _ask_launch(uri: str, question: Callable[[Any], Any]) -> Any:
    try:
        with node_at(uri) as launch:
            return question(launch)
    except Exception as error:      # a launch that has ended leaves its address; anything may answer there
        rospy.logdebug("%s does not say what it has started: %s", uri, error)
        return None


def _close(owner: Optional[_Closable]) -> int:
    if owner is None:
        return 0
    try:
        owner.close()
        return 0
    except Exception:
        rospy.logerr("%s did not close:\n%s", rospy.get_name(), traceback.format_exc())
        return 1


def _install_handlers() -> None:
    def stop(number: int, frame: Optional[FrameType]) -> None:
        _stopped.set()
        raise _Stop()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)


def _ignore_signals() -> None:
    """Closing takes a moment and must not be interrupted by the next Ctrl-C."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
