"""The graph after something broke: who runs, who does not answer any more, and what is left of those who have gone."""

from __future__ import annotations

import http.client
import re
from typing import Dict, Iterable, List, NamedTuple, Optional, Set, Tuple
from xmlrpc.client import Error

import rosgraph
import rospy
from std_msgs.msg import String

from hri_pipeline.ros.master import node_at

MEMORY = "/hri_person_manager_memory"   # what the person manager keeps on purpose across its own end
KINDS = ("faces", "bodies", "voices", "persons")
_NAME = "/faults"
_TIMEOUT_S = 2.0
_ALIAS_S = 2.0
_OF_BODY = re.compile(r"^/(?:human_description_|rsp_)([A-Za-z][A-Za-z0-9_]*)(?:/|$)")
_OF_ID = re.compile(r"^/humans/({})/([^/]+)/[^/]+$".format("|".join(KINDS)))
_FAILURES = (OSError, Error, http.client.HTTPException, rosgraph.MasterError, rosgraph.MasterException)


def pid_of(node: str) -> Optional[int]:
    """Process id of a node by its own account, None for one that does not answer."""
    try:
        code, _, pid = node_at(rosgraph.Master(_NAME).lookupNode(node), _TIMEOUT_S).getPid(_NAME)
        return int(pid) if code == 1 else None
    except _FAILURES:
        return None


def silent_nodes() -> Set[str]:
    """Nodes that the master knows, and that do not answer."""
    return {node for node in nodes() if pid_of(node) is None}


def nodes() -> Set[str]:
    """Nodes that publish, subscribe or serve, as the master says."""
    return {node for rows in rosgraph.Master(_NAME).getSystemState() for _, names in rows for node in names}


def parameters() -> Set[str]:
    """Names of all parameters but those of roslaunch, and those that are kept on purpose."""
    return {name for name in rosgraph.Master(_NAME).getParamNames() if not name.startswith(("/roslaunch/", MEMORY))}


def topics_of_ids() -> Dict[Tuple[str, str], List[str]]:
    """Published topics under /humans/KIND/ID, by kind and id."""
    found: Dict[Tuple[str, str], List[str]] = {}
    for topic, _ in rosgraph.Master(_NAME).getSystemState()[0]:
        match = _OF_ID.match(topic)
        if match:
            found.setdefault((match.group(1), match.group(2)), []).append(topic)
    return found


class Left(NamedTuple):
    """What should not be there, or is there no more: parameters, topics, nodes that do not answer."""

    parameters: List[str]
    topics: List[str]
    nodes: List[str]

    def __bool__(self) -> bool:
        """Tell whether there is anything."""
        return bool(self.parameters or self.topics or self.nodes)


def left(before: Iterable[str], living: Dict[str, Set[str]]) -> Left:
    """Compare with the parameters of before, and with who lives: {one of KINDS: ids}."""
    orphans = {(kind, name): topics for (kind, name),
               topics in topics_of_ids().items() if name not in living.get(kind, set())
               and not (kind == "persons" and alias_of(name) in living.get(kind, set()))}
    return Left(odd_parameters(parameters(), before, living.get("bodies", set())),
                sorted(topic for topics in orphans.values() for topic in topics), sorted(silent_nodes()))


def alias_of(person: str) -> str:
    """Whom somebody was merged into: the topics of an alias stay as long as that person does."""
    try:
        return str(rospy.wait_for_message("/humans/persons/{}/alias".format(person), String, _ALIAS_S).data)
    except rospy.ROSException:
        return ""


def odd_parameters(now: Iterable[str], before: Iterable[str], bodies: Set[str]) -> List[str]:
    """Parameters that are there only now, or were there only before; those of a body are right while it is there."""
    def of_body(name: str) -> Optional[str]:
        match = _OF_BODY.match(name)
        return match.group(1) if match else None
    orphans = {name for name in now if of_body(name) is not None and of_body(name) not in bodies}
    return sorted(orphans | ({name for name in now if of_body(name) is None} ^ {name for name in before
                                                                                if of_body(name) is None}))
