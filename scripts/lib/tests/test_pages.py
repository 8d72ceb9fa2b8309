"""Pages: links lead somewhere, commands name launch files, arguments and programs that are there."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Iterator, List, Set, Tuple
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).resolve().parents[3]
PAGES = [ROOT / "README.md", ROOT / "rosbag_tests" / "README.md"] + sorted((ROOT / "docs").rglob("*.md"))
PROGRAMS_OF_ROS4HRI = {"calibrate_cameras", "cameras", "report", "score"}


def headings(page: Path) -> Set[str]:
    """Return the anchors of the headings of a page, as GitHub makes them."""
    titles = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.strip().lower()).replace(" ", "-") for title in titles}


def arguments_of(package: str, launch_file: str) -> Set[str]:
    """Return the arguments of a launch file; an AssertionError when there is no such file."""
    folder = ROOT if package == "ros4hri" else ROOT / package
    path = folder / "launch" / launch_file
    assert path.is_file(), "{} has no {}".format(package, launch_file)
    return {argument.get("name", "") for argument in ElementTree.parse(str(path)).getroot().iter("arg")
            if "value" not in argument.attrib}


def launches(page: Path) -> Iterator[Tuple[str, str, List[str]]]:
    """Yield package, file and arguments of each roslaunch of this stack."""
    for package, launch_file, rest in re.findall(r"roslaunch (?:--\S+ )*(ros4hri|hri_\w+) (\w+\.launch)([^#`\n]*)",
                                                 page.read_text(encoding="utf-8")):
        yield package, launch_file, re.findall(r"(\w+):=", rest)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links(page: Path) -> None:
    for link in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        if not link.startswith("http"):
            name, _, anchor = link.partition("#")
            target = (page.parent / name) if name else page
            assert target.exists(), link
            assert not anchor or anchor in headings(target), link


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_commands(page: Path) -> None:
    for package, launch_file, given in launches(page):
        assert set(given) <= arguments_of(package, launch_file), "{} {}".format(launch_file, given)
    for package, program in re.findall(r"rosrun (ros4hri|hri_\w+) (\w+)", page.read_text(encoding="utf-8")):
        nodes = ROOT / package / "nodes"
        known = PROGRAMS_OF_ROS4HRI if package == "ros4hri" else {path.name for path in nodes.iterdir()}
        assert program in known, "{} {}".format(package, program)


@pytest.mark.parametrize("page", [page for page in PAGES if "parameters:begin" in page.read_text(encoding="utf-8")],
                         ids=lambda page: page.stem)
def test_what_a_page_calls_its_own_is_listed_there(page: Path) -> None:
    """`~name` in a sentence is a parameter of the list, or a topic or service of a table; those of others have no ~."""
    text = page.read_text(encoding="utf-8")
    parameters = re.compile(r"^- `~(\w+)`", re.MULTILINE)
    tables = " ".join(re.findall(r"^\| (.*?) \|", text, re.MULTILINE))
    listed = set(parameters.findall(text)) | set(re.findall(r"`~(\w+)`", tables))
    assert set(re.findall(r"`~(\w+)", parameters.sub("", text))) <= listed
