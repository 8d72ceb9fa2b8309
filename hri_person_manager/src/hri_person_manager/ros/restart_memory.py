"""Ids of the anonymous persons on the parameter server, so that they survive a crash of the node."""

from __future__ import annotations

import time
from typing import Dict, List, Mapping

import rospy

from hri_person_manager.core.association import FEATURES, Kind, Node
from hri_person_manager.core.person_book import ANONYMOUS_PREFIX
from hri_pipeline.core.ids import is_valid_id

PARAMETER = "~memory/anonymous"
PERIOD_S = 0.5
_MOST = 500


class RestartMemory:
    """Writes who is made of which features whenever that changes; ids only, nothing about the human."""

    def __init__(self) -> None:
        self._written: Dict[str, List[str]] = {}
        self._next = 0.0

    @staticmethod
    def read() -> Dict[str, List[Node]]:
        """What an earlier run has left: {person id: features}. What is not of that form is left out."""
        given = rospy.get_param(PARAMETER, {})
        if not isinstance(given, dict):
            return {}
        found: Dict[str, List[Node]] = {}
        for person_id, names in list(given.items())[:_MOST]:
            if is_valid_id(person_id) and person_id.startswith(ANONYMOUS_PREFIX) and isinstance(names, list):
                found[person_id] = [node for name in names for node in _nodes(name)]
        return found

    def update(self, anonymous: Mapping[str, List[Node]]) -> None:
        """Write the anonymous persons with their features, twice a second at most."""
        now = time.monotonic()
        if now < self._next:
            return
        self._next = now + PERIOD_S
        wanted = {person_id: ["%s %s" % (node.kind.name, node.id) for node in nodes]
                  for person_id, nodes in anonymous.items()}
        if wanted != self._written:
            self._written = wanted
            rospy.set_param(PARAMETER, wanted)

    def close(self) -> None:
        """Take the parameter back: an orderly end is no crash. Idempotent."""
        if rospy.has_param(PARAMETER):
            rospy.delete_param(PARAMETER)


def _nodes(name: object) -> List[Node]:
    """The node that a text such as `FACE abcde` names, as a list; empty when it names none."""
    kind, _, identity = str(name).partition(" ")
    known = {feature.name: feature for feature in FEATURES}
    return [Node(Kind(known[kind]), identity)] if kind in known and is_valid_id(identity) else []
