"""Can ros1_bridge carry the messages of hri_msgs to ROS 2? Each field here against the table of those there.

The bridge pairs fields of one name, and those of the rules; where one side has all fields of the other, those that the
other lacks are left out. What both sides lack of each other, a rule for a field that is not there, and another type,
are mistakes. Read from the files, without ROS.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Dict, List, Mapping, Optional

import yaml

ROOT = Path(__file__).resolve().parents[2] / "hri_msgs"
TABLE, RULES = ROOT / "ros2" / "fields.txt", ROOT / "ros2" / "mapping_rules.yaml"
OWN = {"AgeAndGender", "BodyAttitude", "GazeSenderReceiver", "GazesStamped", "GroupsStamped", "Pointing",
       "PointingStamped", "PrivacyNotice"}
"""Messages that ROS 2 does not have: copies of these definitions are needed there for their topics."""

Fields = Dict[str, str]


def definitions() -> Dict[str, Fields]:
    """Return {message: {field: type}} of the .msg files, without constants."""
    found: Dict[str, Fields] = {}
    for path in sorted((ROOT / "msg").glob("*.msg")):
        lines = [line.split("#")[0].split() for line in path.read_text(encoding="utf-8").splitlines()]
        found[path.stem] = {line[1]: line[0] for line in lines if len(line) == 2 and "=" not in line[1]}
    return found


def table(path: Path = TABLE) -> Dict[str, Fields]:
    """Return the same of the messages of ROS 2, from the table."""
    found: Dict[str, Fields] = {}
    for line in path.read_text(encoding="utf-8").splitlines():
        if line and not line.startswith("#"):
            name, _, fields = line.partition(": ")
            found[name] = {field.split()[1]: field.split()[0] for field in fields.split(", ")}
    return found


def rules() -> Dict[str, Fields]:
    """Return {message: {field here: field there}} of the mapping rules."""
    return {rule["ros1_message_name"]: rule["fields_1_to_2"] for rule in yaml.safe_load(RULES.read_text())}


def problems(ours: Mapping[str, Fields], theirs: Mapping[str, Fields],
             mapped: Optional[Mapping[str, Fields]] = None) -> List[str]:
    """Return what the bridge could not carry over, one line for each."""
    mapped = rules() if mapped is None else mapped
    found = ["{}: there is no such message in ROS 2".format(name) for name in sorted(set(ours) - OWN - set(theirs))]
    found += ["{}: there is no such message here".format(name) for name in sorted(set(theirs) - set(ours))]
    for name in sorted(set(ours) & set(theirs)):
        found += ["{}: {}".format(name, text) for text in _field_problems(ours[name], theirs[name], mapped.get(name))]
    return found + ["{}: a rule for a message that is not there".format(name)
                    for name in sorted(set(mapped) - set(ours))]


def _field_problems(ours: Fields, theirs: Fields, rule: Optional[Fields]) -> List[str]:
    pairs = {field: field for field in ours if field in theirs} if rule is None else rule
    found = ["the rule has no such field: " + field for field in pairs if field not in ours]
    found += ["ROS 2 has no field " + field for field in pairs.values() if field not in theirs]
    found += ["{} is {} here and {} in ROS 2".format(one, ours[one], theirs[other]) for one, other in pairs.items()
              if one in ours and other in theirs and _kind(ours[one]) != _kind(theirs[other])]
    left, lacking = sorted(set(ours) - set(pairs)), sorted(set(theirs) - set(pairs.values()))
    # A rule names each field that it carries; without one the bridge needs that one side has all of the other's.
    if left and (rule is not None or lacking):
        found.append("{} would be lost".format(", ".join(left)))
    return found


def _kind(name: str) -> str:
    """A type without the package and the length of an array: the bridge copies as many items as there are."""
    return re.sub(r"\[\d+\]", "[]", name.replace("hri_msgs/", "").replace("std_msgs/", ""))


def figures() -> Dict[str, object]:
    """Number of mistakes, and which."""
    found = problems(definitions(), table())
    return {"bridge_fields_failed": len(found), "bridge": found}
