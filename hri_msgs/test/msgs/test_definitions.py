"""The message definitions are those that other packages expect.

Reads the definitions that rospack finds, hence of the sourced space, devel or install. A mistake
in one of them makes bags and nodes of others unusable: rosbag and rospy compare the md5 sums. These
leave out the lengths of arrays of messages, so the layouts of the bytes are compared too.
"""
from __future__ import annotations

from pathlib import Path
from typing import Dict, List, Optional

import genmsg
import genmsg.msg_loader
import pytest
import rospkg

# The messages of the paper that no other package defines.
OWN_FIELDS = {
    "hri_msgs/AgeAndGender": ["header", "age", "age_deviation", "age_confidence", "gender",
                              "gender_confidence"],
    "hri_msgs/BodyAttitude": ["header", "attitude", "confidence"],
    "hri_msgs/GazeSenderReceiver": ["sender", "receiver", "confidence"],
    "hri_msgs/GazesStamped": ["header", "gazes"],
    "hri_msgs/GroupsStamped": ["header", "groups", "confidences"],
    "hri_msgs/PrivacyNotice": ["node", "computes", "store", "stored", "max_age", "encrypted", "agreed"],
    "hri_msgs/Pointing": ["sender", "receiver", "origin", "direction", "has_place", "place", "confidence"],
    "hri_msgs/PointingStamped": ["header", "pointings"],
}


def table(name: str, separator: str) -> Dict[str, str]:
    """The lines of a data file beside this test: what stands after the separator by what stands before it."""
    lines = (Path(__file__).parent / name).read_text().splitlines()
    return dict(line.split(separator) for line in lines if line and not line.startswith("#"))


def released_sums() -> Dict[str, str]:
    """md5 sum by message type."""
    return table("md5sums.txt", " ")


def released_layouts() -> Dict[str, str]:
    """Layout of the bytes by message type; wire_layouts.txt says how it is written."""
    return {"hri_msgs/" + name: layout for name, layout in table("wire_layouts.txt", ": ").items()}


def layout_of(message_type: str) -> str:
    """Layout of the bytes of a message type as wire_layouts.txt has it."""
    context, definition = load(message_type)
    return " ".join(layout_of_field(context, *genmsg.msgs.parse_type(kind)) for kind in definition.types)


def layout_of_field(context: genmsg.MsgContext, kind: str, is_array: bool, length: Optional[int]) -> str:
    """The same of one field; a Header stands as it is."""
    if genmsg.msgs.is_header_type(kind):
        name = "Header"
    elif genmsg.msgs.is_builtin(kind):
        name = kind
    else:
        types = context.get_registered(kind).types
        name = "({})".format(" ".join(layout_of_field(context, *genmsg.msgs.parse_type(part)) for part in types))
    return name + ("[{}]".format("" if length is None else length) if is_array else "")


def message_directory(package: str) -> Path:
    """Where the definitions of a package lie; raises rospkg.ResourceNotFound without a sourced space."""
    return Path(rospkg.RosPack().get_path(package)) / "msg"


def load(message_type: str) -> tuple:
    """Context and parsed definition of a message type, with those that it contains."""
    packages = ("hri_msgs", "audio_common_msgs", "people_msgs", "geometry_msgs", "std_msgs")
    search_path = {package: [str(message_directory(package))] for package in packages}
    context = genmsg.MsgContext.create_default()
    definition = genmsg.msg_loader.load_msg_by_type(context, message_type, search_path)
    genmsg.msg_loader.load_depends(context, definition, search_path)
    return context, definition


def defined_types() -> List[str]:
    """Every message type of hri_msgs that has a definition file."""
    return ["hri_msgs/" + path.stem for path in message_directory("hri_msgs").glob("*.msg")]


def test_every_released_message_is_listed() -> None:
    assert len([name for name in released_sums() if name.startswith("hri_msgs/")]) == 17


@pytest.mark.parametrize("message_type", sorted(released_sums()))
def test_md5_equals_the_released_one(message_type: str) -> None:
    assert genmsg.compute_md5(*load(message_type)) == released_sums()[message_type]


def test_every_released_message_has_a_layout() -> None:
    assert sorted(released_layouts()) == sorted(name for name in released_sums() if name.startswith("hri_msgs/"))


@pytest.mark.parametrize("message_type", sorted(released_layouts()))
def test_bytes_have_the_layout_of_the_released_one(message_type: str) -> None:
    assert layout_of(message_type) == released_layouts()[message_type]


@pytest.mark.parametrize("message_type", sorted(OWN_FIELDS))
def test_own_message_keeps_its_fields(message_type: str) -> None:
    assert load(message_type)[1].names == OWN_FIELDS[message_type]


def test_no_definition_is_unlisted() -> None:
    listed = [name for name in released_sums() if name.startswith("hri_msgs/")]
    assert sorted(defined_types()) == sorted(listed + list(OWN_FIELDS))
