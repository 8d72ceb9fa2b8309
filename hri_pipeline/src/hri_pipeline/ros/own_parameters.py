"""The parameters of a node when the ROS master is started again, which loses them: roslaunch sets them only once."""

from __future__ import annotations

import copy
import os
import threading
import uuid
from typing import Any, Dict, Iterator, List, NamedTuple, Optional, Sequence, Tuple
from xmlrpc.client import ServerProxy

import rospy

from hri_pipeline.core.parameters import ParameterError

SHARED = "/humans"


class ParametersLost(ParameterError):
    """What roslaunch had set for this node went with an earlier master."""


class Snapshot(NamedTuple):
    """What the master said: values by namespace, and how many changes by this process it may know of."""

    values: Dict[str, object]
    changes: int


class OwnParameters:
    """Remembers the private parameters of this node, and those of the whole stack, for a new master. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._kept: Dict[str, object] = {}
        self._first: Optional[Dict[str, object]] = None     # the private ones with which the node began
        self._changes = 0

    def read(self, master: ServerProxy) -> Snapshot:
        """Ask the master for them. Raises OSError, or what xmlrpc raises, where it does not answer."""
        with self._lock:
            changes = self._changes
        found = {namespace: _asked(master, namespace) for namespace in (rospy.get_name(), SHARED)}
        return Snapshot({namespace: value for namespace, value in found.items() if value is not None}, changes)

    def keep(self, snapshot: Snapshot) -> None:
        """Remember these; only for those of the master that this node is registered at."""
        with self._lock:
            if snapshot.changes == self._changes:
                self._kept = snapshot.values
            own = snapshot.values.get(rospy.get_name(), {})
            if self._first is None and isinstance(own, dict):
                self._first = copy.deepcopy(own)

    def set(self, name: str, value: object) -> None:
        """Set a private parameter, and remember it also where the master is away; rospy then raises one of many."""
        try:
            rospy.set_param("~" + name, value)
        finally:
            with self._lock:
                self._changes += 1
                own = self._kept.setdefault(rospy.get_name(), {})
                if isinstance(own, dict):
                    own[name] = value
                if self._first is not None:
                    self._first[name] = value

    def take_back(self, master: ServerProxy) -> bool:
        """Set the private parameters as this node began with, in place of those of another node of its name that has
        ended; tell whether these were others. Raises as put_back() does.
        """
        name = rospy.get_name()
        with self._lock:
            first = copy.deepcopy(self._first)
        if first is None or (_asked(master, name) or {}) == first:
            return False
        code, text, _ = _answer(master.setParam(name, name, first))
        if code != 1:
            raise OSError("the master refuses the parameters {}: {}".format(name, text))
        return True

    def put_back(self, master: ServerProxy) -> List[str]:
        """Set on a new master what is missing there; return the namespaces, or names, that were set.

        Nothing that somebody has set there is touched. Raises as read() does, and OSError where the master refuses.
        """
        with self._lock:
            kept = copy.deepcopy(self._kept)
        done = []
        for namespace, value in kept.items():
            for name, missing in _missing(namespace, value, _asked(master, namespace)):
                code, text, _ = _answer(master.setParam(rospy.get_name(), name, missing))
                if code != 1:
                    raise OSError("the master refuses the parameter {}: {}".format(name, text))
                done.append(name)
        return done


def launched_for_earlier_master(arguments: Sequence[str]) -> bool:
    """Tell whether roslaunch has started this process, and its master was started again since it began.

    arguments: of this process, among which roslaunch gives the path of a log, in a folder with the run id of the
    master.
    """
    run_id = _launched_for(arguments)
    return bool(run_id) and rospy.get_param("/run_id", "") != run_id


def check_not_lost(arguments: Sequence[str]) -> None:
    """Raise ParametersLost where this process was launched for an earlier master, whose parameters are gone.

    The defaults may show of people what the parameters had forbidden. arguments: of this process.
    """
    name = rospy.get_name()
    if launched_for_earlier_master(arguments) and rospy.get_param(name, {}) == {}:
        raise ParametersLost("{} has no parameters: the ROS master was started again, and what roslaunch had set went "
                             "with it. The node waits: end this launch and start it again, or set its parameters with "
                             "rosparam".format(name))


def _launched_for(arguments: Sequence[str]) -> str:
    """Run id of the master that roslaunch had when it began; empty for a process that it has not started."""
    for argument in arguments:
        if argument.startswith("__log:="):
            folder = os.path.basename(os.path.dirname(argument))
            try:
                uuid.UUID(folder)
            except ValueError:      # a path that somebody else has given
                continue
            return folder
    return ""


def _missing(name: str, kept: object, there: Optional[object]) -> Iterator[Tuple[str, object]]:
    """Names and values of what is not there, whole namespaces as one."""
    if there is None:
        if kept != {}:
            yield name, kept
    elif isinstance(kept, dict) and isinstance(there, dict):
        for key, value in kept.items():
            yield from _missing("{}/{}".format(name, key), value, there.get(key))


def _asked(master: ServerProxy, name: str) -> Optional[object]:
    """Value of a parameter, or dictionary of a namespace; None where there is none."""
    code, _, value = _answer(master.getParam(rospy.get_name(), name))
    return value if code == 1 else None


def _answer(given: Any) -> Tuple[int, str, object]:
    code, text, value = given
    return int(code), str(text), value
