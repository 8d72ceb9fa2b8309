"""The tables of topics in README.md and docs/rep155.md say what rosbag_tests/interface.yaml says."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Dict, Iterator, List, Set, Tuple

import pytest

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / "rosbag_tests"))

import interface_table  # noqa: E402

TABLE = interface_table.load()
PAPER = {topic.name: topic.type for topic in interface_table.topics(TABLE, interface_table.PAPER)}
REP155 = {topic.name: topic.type for topic in interface_table.topics(TABLE, interface_table.REP155)}
KINDS = {"faces": "{face}", "bodies": "{body}", "voices": "{voice}", "persons": "{person}"}


def expand(text: str) -> List[str]:
    """Return every name of a text with {a,b}."""
    found = re.search(r"\{([\w,]+)\}", text)
    if not found:
        return [text]
    return [name for choice in found.group(1).split(",")
            for name in expand(text[:found.start()] + choice + text[found.end():])]


def names_of(text: str, prefix: str) -> List[str]:
    """Return the names of topics of a code span as interface.yaml writes them."""
    names = [name if name.startswith("/") else prefix + name for name in expand(text)]
    return [re.sub(r"^(/humans/(\w+)/)ID/", lambda found: found.group(1) + KINDS[found.group(2)] + "/", name)
            for name in names]


def rows(page: str, heading: str = "") -> Iterator[List[str]]:
    """Cells of all rows of tables below a heading."""
    text = (ROOT / page).read_text(encoding="utf-8")
    if heading:
        text = text.split("\n## {}\n".format(heading))[1].split("\n## ")[0]
    for line in text.splitlines():
        if line.startswith("|") and not line.startswith("|---"):
            yield [cell.strip() for cell in line.strip("|").split("|")]


def topics_in(page: str, heading: str = "") -> Iterator[Tuple[List[str], List[str]]]:
    """Topics of each row of a page, and its other cells. A row in bold gives the prefix of those below it."""
    prefix = ""
    for first, *others in rows(page, heading):
        spans = re.findall(r"`([^`]+)`", first)
        if first.startswith("**"):
            prefix = spans[0].rstrip("…")
        elif spans and (prefix or spans[0].startswith("/humans")) and not re.search(r"_ID", first):
            yield [name for span in spans for name in names_of(span, prefix)], others


def types_in(cell: str) -> Set[str]:
    """Return the types that a cell names; the package of the last one holds for those behind it."""
    found, package = set(), ""
    for span in re.findall(r"`([\w/]+)`", cell):
        package = span.split("/")[0] if "/" in span else package
        found.add("{}/{}".format(package, span.split("/")[-1]))
    return found


def test_sums_of_released_messages_are_those_of_the_package_that_is_found(tmp_path: Path,
                                                                          monkeypatch: pytest.MonkeyPatch) -> None:
    """As in an install space, where no package stands beside another one as in the sources."""
    share = tmp_path / "share" / "hri_msgs"
    (share / "test" / "msgs").mkdir(parents=True)
    (share / "package.xml").write_text("<package><name>hri_msgs</name></package>")
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "share"))
    with pytest.raises(OSError):
        interface_table.released_sums()
    (share / "test" / "msgs" / "md5sums.txt").write_text("# md5\nhri_msgs/Gaze 1408\n")
    assert interface_table.released_sums() == {"hri_msgs/Gaze": "1408"}


def test_readme_has_every_topic_once_and_no_other() -> None:
    named = [name for names, _ in topics_in("README.md", "What you get") for name in names]
    assert sorted(named) == sorted(PAPER)


def test_readme_has_the_types() -> None:
    for names, (types, *_) in topics_in("README.md", "What you get"):
        assert types_in(types) == {PAPER[name] or REP155[name] for name in names}, names


def test_readme_says_what_is_latched() -> None:
    latched = {topic.name: topic.latched for topic in interface_table.topics(TABLE, interface_table.PAPER)}
    for names, (_, remark) in topics_in("README.md", "What you get"):
        assert {latched[name] for name in names} == {"latched" in remark}, names


def test_readme_has_every_frame() -> None:
    named: Dict[str, str] = {}
    for first, parent, _ in rows("README.md", "What you get"):
        if re.match(r"`\w+_ID`", first):
            named[re.findall(r"`(\w+)_ID`", first)[0]] = first + parent
    frames = {row["name"].rsplit("_", 1)[0]: row for row in TABLE["frames"]}
    links = [name for name, row in frames.items() if row["parent"] == "urdf"]
    assert set(named) == set(frames) - set(links) | {"head"}
    assert "the other {} links".format(len(links) - 1) in named["head"]


@pytest.mark.parametrize("name", sorted(name for name in PAPER if PAPER[name] != REP155[name]))
def test_rep155_page_tells_both_types(name: str) -> None:
    for names, (paper, rep155, *_) in topics_in("docs/rep155.md"):
        if name in names:
            assert types_in(paper) == ({PAPER[name]} if PAPER[name] else set())
            assert types_in(rep155) == {REP155[name]}
            return
    raise AssertionError("docs/rep155.md does not tell that the type of {} differs".format(name))


def test_rep155_page_tells_what_only_one_knows() -> None:
    told = {name: known for names, (*_, known) in topics_in("docs/rep155.md") for name in names
            if PAPER[name] == REP155[name]}
    whose = {"REP-155": "rep155", "neither": "own"}
    of = {row["name"]: row["of"] for row in TABLE["topics"]}
    for name, known in told.items():
        assert of[name] == whose.get(known, "paper"), name
    assert {name for name, who in of.items() if who != "paper" and PAPER[name] == REP155[name]} <= set(told)


def test_the_layout_for_foxglove_names_what_is_published() -> None:
    """Topics of the interface, and pictures for people, which nodes publish as visualization/...; each panel is shown
    once."""
    layout = json.loads((ROOT / "launch" / "foxglove_layout.json").read_text(encoding="utf-8"))
    panels = layout["configById"]
    named = {panel.get(key, "").split(".")[0] for panel in panels.values() for key in ("topicPath", "topicToRender")}
    named |= {topic for panel in panels.values() for topic in panel.get("topics", ())}
    named |= {panel["imageMode"]["imageTopic"] for panel in panels.values() if "imageMode" in panel}
    sources = "".join(path.read_text(encoding="utf-8") for path in ROOT.glob("hri_*/src/**/*.py"))
    drawn = {"/" + name for name in re.findall(r'Publisher\("(visualization/\w+)"', sources)}
    assert drawn <= named, "what is drawn for people is in the layout"
    assert named - {""} <= set(PAPER) | drawn | {"/diagnostics"}
    shown: List[str] = []
    places = [layout["layout"]]
    while places:
        place = places.pop()
        if isinstance(place, str):
            shown.append(place)
        else:
            places += [place["first"], place["second"]]
    assert sorted(shown) == sorted(panels)


def test_a_row_that_stands_twice_is_refused(tmp_path: Path) -> None:
    text = interface_table.FILE.read_text(encoding="utf-8")
    twice = tmp_path / "interface.yaml"
    twice.write_text(text.replace("/humans/graph", "/humans/persons/known"), encoding="utf-8")
    with pytest.raises(ValueError, match="/humans/persons/known stands twice"):
        interface_table.load(twice)


def test_patterns_match_ids_only() -> None:
    pattern = interface_table.pattern_of("/humans/faces/{face}/roi")
    assert pattern.match("/humans/faces/abcde/roi").group(1) == "abcde"
    assert not any(pattern.match(name)
                   for name in ("/humans/faces/a/b/roi", "/humans/faces/1bcde/roi", "/humans/faces/abcde/roi/x"))
