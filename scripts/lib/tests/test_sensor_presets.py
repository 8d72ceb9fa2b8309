"""The presets of the launch files are what the drivers document; what is none is refused with the legal ones."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Dict, Sequence
from xml.etree import ElementTree

import pytest

from benchmarks.sensor_presets import DRIVERS

ROOT = Path(__file__).resolve().parents[3]


def preset(path: Path, argument: str, sensor: str) -> str:
    """The default of an argument with a sensor chosen, as roslaunch finds it."""
    names: Dict[str, str] = {"sensor": sensor}
    tags = ElementTree.parse(str(path)).getroot().findall("arg")
    defaults = {tag.get("name"): tag.get("default", "") for tag in tags}
    for name in ("sensor_namespace", argument):
        names[name] = str(eval(defaults[name][len("$(eval "):-1], {"__builtins__": {}}, dict(names)))
    return names[argument]


@pytest.mark.parametrize("launch_file", ["ros4hri", "bag", "two_machines"])
@pytest.mark.parametrize("sensor", sorted(DRIVERS))
def test_topics_are_those_of_the_driver(launch_file: str, sensor: str) -> None:
    path, driver = ROOT / "launch" / (launch_file + ".launch"), DRIVERS[sensor]
    assert preset(path, "image", sensor) == driver.colour[0]
    assert preset(path, "camera_info", sensor) == driver.camera_info
    assert preset(path, "depth", sensor) == driver.depth[0]


def test_without_a_sensor_the_topics_are_as_ever() -> None:
    path = ROOT / "launch" / "ros4hri.launch"
    assert [preset(path, name, "") for name in ("image", "camera_info", "depth")] == [
        "/camera/image_raw", "/camera/camera_info", ""]


def test_the_page_names_every_sensor() -> None:
    page = (ROOT / "docs" / "sensors.md").read_text(encoding="utf-8")
    assert set(re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE)) == {"sensor", *DRIVERS}


class Refused(Exception):
    """roslaunch ends with the text of an argument that does not exist."""


def refuse(text: str) -> None:
    raise Refused(text)


@pytest.mark.parametrize("launch_file, name, legal", [
    *(("launch/{}.launch".format(file), "sensor", sorted(DRIVERS)) for file in ("ros4hri", "bag", "two_machines")),
    ("hri_pipeline/launch/voices.launch", "microphones",
     sorted(path.stem for path in (ROOT / "hri_pipeline" / "config" / "microphones").glob("*.yaml"))),
    *((file, "quality", ["balanced", "best", "fast"]) for file in (
        "hri_pipeline/launch/faces.launch", "hri_fullbody/launch/bodies.launch", "hri_fullbody/launch/vision.launch")),
], ids=lambda value: Path(value).stem if isinstance(value, str) else "values")
def test_a_value_that_is_not_legal_is_refused_with_those_that_are(launch_file: str, name: str,
                                                                  legal: Sequence[str]) -> None:
    tags = ElementTree.parse(str(ROOT / launch_file)).getroot().findall("arg")
    checks = [tag.get("value", "") for tag in tags if "{}:=".format(name) in tag.get("value", "")]
    assert len(checks) == 1
    names = {"arg": refuse, "__builtins__": {}}
    for value in ("", *legal):
        assert eval(checks[0][len("$(eval "):-1], names, {name: value}) is True
    with pytest.raises(Refused) as refused:
        eval(checks[0][len("$(eval "):-1], names, {name: "kinect"})
    given, _, told = str(refused.value).partition("; legal: ")
    assert given == name + ":=kinect" and sorted(told.split(", ")) == sorted([*legal, "or nothing"])


def check_of(launch_file: str, argument: str, **names: object) -> object:
    """The value of an argument that checks others, as roslaunch finds it; `Refused` tells what it would end with."""
    path, = (path for folder in ("launch", "hri_*/launch") for path in ROOT.glob(folder + "/*.launch")
             if path.stem == launch_file)
    tags = ElementTree.parse(str(path)).getroot().findall("arg")
    values = {tag.get("name"): tag.get("value", "") for tag in tags}
    return eval(values[argument][len("$(eval "):-1], {}, {"arg": refuse, **names})


@pytest.mark.parametrize("launch_file", ["ros4hri", "two_cameras"])
@pytest.mark.parametrize("argument, name, legal", [("is_count", "max_people", ["", 1, 10]),
                                                   ("is_rate", "vision_rate", ["", 0.0, 15, 7.5])])
def test_numbers_that_are_none_are_refused_by_name(launch_file: str, argument: str, name: str,
                                                   legal: Sequence[object]) -> None:
    assert all(check_of(launch_file, argument, **{name: value}) is True for value in legal)
    for value in ("abc", -3, "5 people"):
        with pytest.raises(Refused, match="^{}:={}; legal: ".format(name, value)):
            check_of(launch_file, argument, **{name: value})


@pytest.mark.parametrize("launch_file, argument, name, legal, illegal", [
    *((file, "is_fov", "fallback_fov", ["", 1, 1.05, "0.6"], ["wide", 60, -1.0, 0.0, "1e0", True])
      for file in ("faces", "bodies", "vision")),
    *((file, "is_topic", "depth", ["", "/camera/depth", "depth", "~depth"], [True, False, "true", 1, "/"])
      for file in ("faces", "bodies", "vision")),
    ("person_manager", "is_age", "store_max_age", ["", 0.0, 30, 0.5], ["month", -1.0]),
    ("person_manager", "is_count", "store_max_persons", ["", 0, 1000], ["many", 2.5, -1])])
def test_arguments_of_nodes_that_make_no_sense_are_refused_by_name(launch_file: str, argument: str, name: str,
                                                                   legal: Sequence[object],
                                                                   illegal: Sequence[object]) -> None:
    assert all(check_of(launch_file, argument, **{name: value}) is True for value in legal)
    for value in illegal:
        with pytest.raises(Refused, match="^{}:={}; legal: ".format(name, value)):
            check_of(launch_file, argument, **{name: value})


@pytest.mark.parametrize("names, cameras", [
    (("left", "right", ""), "left right"), (("a", "b", "c d;/d/image"), "a b c d")])
def test_cameras_of_different_names_are_taken(names: Sequence[str], cameras: str) -> None:
    left, right, more = names
    assert check_of("two_cameras", "cameras", left=left, right=right, more=more) == cameras
    assert check_of("two_cameras", "is_each_once", cameras=cameras) is True


def test_cameras_of_one_name_are_refused() -> None:
    with pytest.raises(Refused, match="^cameras a b a; legal: another name for each, by left, right and more$"):
        check_of("two_cameras", "is_each_once", cameras="a b a")
