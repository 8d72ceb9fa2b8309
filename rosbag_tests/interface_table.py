"""Reads interface.yaml: the topics, parameters and frames that the stack publishes. Needs no ROS."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, Dict, List, NamedTuple, Optional, Pattern

import yaml

PAPER, REP155 = "paper", "rep155"
FILE = Path(__file__).resolve().with_name("interface.yaml")
_ID = "(?P<{}>[A-Za-z][A-Za-z0-9_]{{0,31}})"
_SOURCES = ("image", "sound", "input", "none")


class Topic(NamedTuple):
    """One row of topics; type is None where the mode has no such topic. frame: camera, microphone, reference or ""."""

    name: str
    type: Optional[str]
    latched: bool
    source: str
    frame: str
    when: str

    @property
    def pattern(self) -> Pattern[str]:
        """Matches the names of the topics of this row; the id is the group 1, where there is one."""
        return pattern_of(self.name)


def pattern_of(name: str) -> Pattern[str]:
    """Return what matches a name in which {face}, {body}, {voice} or {person} stands for an id."""
    literal = [re.escape(part) for part in re.split(r"\{\w+\}", name)]
    kinds = [_ID.format(kind) for kind in re.findall(r"\{(\w+)\}", name)]
    return re.compile("".join(part + kind for part, kind in zip(literal, kinds + [""])) + "$")


def load(path: Path = FILE) -> Dict[str, Any]:
    """Return the table as it stands in the file. Raises ValueError for a row that says something twice or unknown."""
    table = yaml.safe_load(path.read_text(encoding="utf-8"))
    for kind in ("topics", "parameters", "frames"):
        names = [row["name"] for row in table[kind]]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError("{}: {} stands twice in {}".format(path.name, twice[0], kind))
    for row in table["topics"]:
        if row["from"] not in _SOURCES or not isinstance(row["latched"], bool):
            raise ValueError(
                "{}: {}: from is one of {}, latched true or false".format(path.name, row["name"], ", ".join(_SOURCES))
            )
    return table


def released_sums() -> Dict[str, str]:
    """Return the md5 sums of the released messages by type, which stand in the hri_msgs that rospack finds.

    Raises OSError without them.
    """
    import rospkg
    file = Path(rospkg.RosPack().get_path("hri_msgs")) / "test" / "msgs" / "md5sums.txt"
    lines = file.read_text(encoding="utf-8").splitlines()
    return dict(line.split() for line in lines if line.strip() and not line.startswith("#"))


def topics(table: Dict[str, Any], interface: str) -> List[Topic]:
    """Return the rows of topics of a mode."""
    frames = {"image": "camera", "sound": "microphone", "input": "", "none": ""}
    found = []
    for row in table["topics"]:
        kind = row.get(REP155, row["type"]) if interface == REP155 else row["type"]
        found.append(Topic(row["name"], None if kind == "none" else kind, row["latched"], row["from"],
                           row.get("frame", frames[row["from"]]) or "", row.get("when", "")))
    return found
