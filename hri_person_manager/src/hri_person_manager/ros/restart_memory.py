"""Ids of the persons and of their features on the parameter server, so that they survive a crash of the node."""

from __future__ import annotations

import time
import xmlrpc.client
from typing import Callable, Dict, List, Mapping

import rospy

from hri_person_manager.core.association import FEATURES, Kind, Node
from hri_pipeline.core.ids import is_valid_id

PERIOD_S, AGAIN_S = 0.5, 10.0
_MOST = 500


class RestartMemory:
    """Writes who is made of which features whenever that changes; ids only, nothing about the human.

    The parameter stands beside the node's own ones, NODE_memory: those are checked, and cleared by roslaunch.
    """

    def __init__(self) -> None:
        self._name = rospy.get_name() + "_memory"
        self._written: Dict[str, List[str]] = {}
        self._next = self._again = 0.0

    def read(self) -> Dict[str, List[Node]]:
        """What an earlier run has left: {person id: features}. What is not of that form is left out."""
        given = rospy.get_param(self._name, {})
        if not isinstance(given, dict):
            return {}
        found: Dict[str, List[Node]] = {}
        for person_id, names in list(given.items())[:_MOST]:
            if is_valid_id(person_id) and isinstance(names, list):
                found[person_id] = [node for name in names for node in _nodes(name)]
        return found

    def update(self, persons: Callable[[], Mapping[str, List[Node]]], at_once: bool = False) -> None:
        """Write the persons with their features, which are asked for, twice a second at most, or at once."""
        now = time.monotonic()
        if now < self._next and not at_once:
            return
        self._next = now + PERIOD_S
        wanted = {person_id: ["%s %s" % (node.kind.name, node.id) for node in nodes]
                  for person_id, nodes in persons().items()}
        # Again and again: a master that was started anew has no parameters.
        if wanted != self._written or (wanted and now >= self._again):
            try:
                rospy.set_param(self._name, wanted)
            except (OSError, rospy.ROSException, xmlrpc.client.Error):
                return      # the master is away; the next time may be better
            self._written, self._again = wanted, now + AGAIN_S

    def close(self) -> None:
        """Take the parameter back: an orderly end is no crash. Idempotent."""
        try:
            if rospy.has_param(self._name):
                rospy.delete_param(self._name)
        except (OSError, rospy.ROSException, xmlrpc.client.Error):
            pass            # it went with the master


def _nodes(name: object) -> List[Node]:
    """The node that a text such as `FACE abcde` names, as a list; empty when it names none."""
    kind, _, identity = str(name).partition(" ")
    known = {feature.name: feature for feature in FEATURES}
    return [Node(Kind(known[kind]), identity)] if kind in known and is_valid_id(identity) else []
