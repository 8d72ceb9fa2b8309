"""Launch files: those that start the stack have its arguments, hand them on, and set parameters of their own nodes
only."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Dict, Iterator, Set, Tuple
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).resolve().parents[3]
STACK = "ros4hri.launch"
FILES = sorted(path for folder in ("launch", "hri_*/launch") for path in ROOT.glob(folder + "/*.launch"))

_CAMERA = "there is no camera, and nothing is seen"
_SOUND = "there is no microphone, and nothing is heard"
_TOPICS = "the file itself publishes it"
_OF_EACH = "each camera has its own"
LEFT_OUT: Dict[str, Dict[str, str]] = {
    "bag.launch": {},
    "two_machines.launch": {},
    "demo.launch": {
        "sensor": _TOPICS, "sensor_namespace": _TOPICS,
        "image": _TOPICS, "camera_info": _TOPICS, "audio": _TOPICS, "audio_info": _TOPICS, "microphone_frame": _TOPICS,
        "voices": "the argument sound decides", "reference_frame": "the place of the camera is given in map"},
    "scene.launch": {
        **{name: _CAMERA for name in (
            "sensor", "sensor_namespace",
            "image", "camera_info", "depth", "image_transport", "fallback_fov", "faces", "bodies", "overlay",
            "one_process", "up_frame", "image_rotation",
            "providers", "quality", "vision_rate", "max_people", "ignored_regions", "privacy", "recognition",
            "recognition_model", "faces_config", "bodies_config",
            "vision_config", "overlay_config")},
        **{name: _SOUND for name in (
            "audio", "audio_info", "microphone_frame", "microphones", "microphone_positions", "speech",
            "speech_grammar", "language", "robot_speaking", "voice_identity", "voices_config")},
        "matcher_config": "the simulator tells the matches", "voice_matcher_config": "the simulator tells the matches"},
    "two_cameras.launch": {
        "sensor": _OF_EACH, "sensor_namespace": _OF_EACH, "image": _OF_EACH, "camera_info": _OF_EACH, "depth": _OF_EACH,
        "ignored_regions": _OF_EACH, "image_rotation": _OF_EACH,
        "faces": "without faces nobody is the same for both cameras",
        "persons": "without persons nobody is the same for both cameras", "overlay": "it draws for one camera",
        "overlay_config": "it draws for one camera", "one_process": "one_camera.launch has two processes",
        "vision_config": "one_camera.launch has two processes"},
}
"""Arguments of ros4hri.launch that a file does not take, and why."""

OTHER_DEFAULTS = {
    ("bag.launch", "up_frame"): "a camera_tilt that is given says where up is",
    ("demo.launch", "depth"): "no sensor is chosen",
    ("scene.launch", "robot_frame"): "the robot of the simulator looks where its camera looks",
    ("two_cameras.launch", "reference_frame"): "the places of the cameras are given in it",
    ("two_cameras.launch", "up_frame"): "the places of the cameras in the reference frame are known, so the floor is",
    ("two_machines.launch", "image_transport"): "the images go over a network",
}

GLOBAL = {
    ("bag.launch", "/use_sim_time"): "start_bag takes it back",
    ("scene_simulator.launch", "/use_sim_time"): "the simulator takes it back",
    ("show_human.launch", "human_description_$(arg id)"): "the interface wants it there, and each body has its own",
}
"""Parameters that are set outside of the namespaces of nodes, and why that does no harm to the next launch."""


def read(path: Path) -> ElementTree.Element:
    return ElementTree.parse(str(path)).getroot()


def arguments(path: Path) -> Dict[str, str]:
    """{name: default} of the arguments that a file takes."""
    return {tag.get("name", ""): tag.get("default", "") for tag in read(path).findall("arg")
            if "value" not in tag.attrib}


def parameters(tag: ElementTree.Element, place: str = "") -> Iterator[Tuple[ElementTree.Element, str]]:
    """Each <param> and <rosparam> that is not within a node, with the namespace of its groups."""
    for child in tag:
        if child.tag in ("param", "rosparam") and child.get("command") != "delete":
            yield child, place + child.get("ns", "")
        elif child.tag == "group":
            yield from parameters(child, place + child.get("ns", ""))


def handed_on(root: ElementTree.Element) -> Set[str]:
    """Names of the arguments that a file uses, or hands to a file that it includes."""
    names: Set[str] = set()
    for tag in root.iter():
        for value in tag.attrib.values():
            for text in re.findall(r"\$\((?:arg|eval)([^$]*)", value):
                names.update(re.findall(r"\w+", text))
        if tag.tag == "include" and tag.get("pass_all_args") == "true":
            found = [path for path in FILES if path.name == Path(tag.get("file", "")).name]
            names.update(arguments(found[0]))
    return names


def file(name: str) -> Path:
    return next(path for path in FILES if path.name == name)


@pytest.mark.parametrize("name", sorted(LEFT_OUT))
def test_every_argument_of_the_stack_is_taken_or_left_out_for_a_reason(name: str) -> None:
    missing = set(arguments(file(STACK))) - set(arguments(file(name)))
    assert missing == set(LEFT_OUT[name])


@pytest.mark.parametrize("name", sorted(LEFT_OUT))
def test_defaults_are_those_of_the_stack(name: str) -> None:
    stack, own = arguments(file(STACK)), arguments(file(name))
    other = {argument for argument in stack if argument in own and stack[argument] != own[argument]}
    assert other == {argument for where,
                     argument in OTHER_DEFAULTS if where == name and stack[argument] != own[argument]}


@pytest.mark.parametrize("path", FILES, ids=[path.name for path in FILES])
def test_every_argument_does_something(path: Path) -> None:
    root = read(path)
    unused = set(arguments(path)) - handed_on(root)
    assert not unused


@pytest.mark.parametrize("path", FILES, ids=[path.name for path in FILES])
def test_parameters_are_those_of_nodes(path: Path) -> None:
    """What is set elsewhere is there for the next launch on the same master, too."""
    root = read(path)
    cleared = {tag.get("ns", "") for tag in root.iter("group") if tag.get("clear_params") == "true"}
    found = {tag.get("name") or tag.get("param") or place for tag, place in parameters(root)
             if not any(place.startswith(space) or (tag.get("name") or "").startswith(space) for space in cleared)}
    assert {(path.name, name) for name in found} == {key for key in GLOBAL if key[0] == path.name}


@pytest.mark.parametrize("path", FILES, ids=[path.name for path in FILES])
def test_nodes_with_parameters_forget_those_of_an_earlier_launch(path: Path) -> None:
    for node in read(path).iter("node"):
        if node.findall("param") or node.findall("rosparam"):
            assert node.get("clear_params") == "true", node.get("name")


@pytest.mark.parametrize("faces, bodies, one_process, persons, is_started", [
    (True, True, False, True, True), (True, False, False, True, False), (False, True, False, True, False),
    (False, False, False, True, True), (True, False, True, True, True), (True, True, False, False, False)])
def test_faces_are_matched_with_bodies_where_there_may_be_both(
        faces: bool, bodies: bool, one_process: bool, persons: bool, is_started: bool) -> None:
    """Without both switches they come from another machine, or another package."""
    given = {"faces": faces, "bodies": bodies, "one_process": one_process, "persons": persons}

    def value(text: str) -> object:
        return eval(text[len("$(eval "):-1] if text.startswith("$(eval ") else text[len("$(arg "):-1], dict(given))

    tags = list(read(ROOT / "launch" / STACK).iter())
    matcher = next(tag for tag in tags if tag.get("file", "").endswith("face_body_matcher.launch"))
    group = next((tag for tag in tags if tag.tag == "group" and matcher in list(tag)), matcher)
    conditions = [tag.get("if") for tag in (group, matcher)]
    assert all(value(text) for text in conditions if text) is is_started
    expected = next(tag for tag in tags if tag.tag == "arg" and tag.get("name") == "matches")
    assert bool(value(expected.get("value", ""))) is is_started
