"""What `scripts/benchmark faults` prints, and when it fails."""

import argparse
import json
from collections import Counter

import pytest

pytest.importorskip("rospy")

from benchmarks import faults  # noqa: E402
from benchmarks.fault_stack import fault_graph, odd_processes  # noqa: E402

WRITTEN = {"people": ["ann"], "recovery_s": {"kill /a": [2.0, 3.0], "flood /b": [7.5, None]},
           "nodes_ended_by_garbage": [], "left_after": {},
           "lost_from_store": [], "stored": ["ann"]}
GOOD = dict(faults.told(dict(WRITTEN)), load_before=1.0)


def test_the_table_says_what_was_soon_enough():
    lines = faults.as_table(GOOD).splitlines()
    assert lines[1].split() == ["kill", "/a", "2.00", "3.00", "yes"]
    assert lines[2].split() == ["flood", "/b", "7.50", "never", "NO"]
    assert any(line.startswith("lost from store") and line.endswith("none") for line in lines)


def test_each_world_has_its_table():
    text = faults.as_table(dict(GOOD, real_people=faults.told(dict(WRITTEN)),
                                full_disk={"how": "tmpfs", "the same processes run": False}))
    assert text.count("kill /a") == 2 and faults.WORLDS["real"] in text
    assert "the same processes run" in text.splitlines()[-1] and text.endswith("False")


@pytest.mark.parametrize("change", [{"recovery_s": {"kill /a": [None, None]}},
                                    {"left_after": {"kill /a": ["topic /humans/persons/x/alias"]}},
                                    {"left_after": {"kill /a": ["process __name:=rsp_x"]}},
                                    {"left_after": {"kill /a": ["node /rsp_x"]}},
                                    {"lost_from_store": ["ann"]}, {"nodes_ended_by_garbage": ["/a"]},
                                    {"error": "nobody came"}])
@pytest.mark.parametrize("world", ["", "real_people", "real_people_one_process"])
def test_what_goes_wrong(change, world):
    assert not faults.went_wrong(GOOD)
    wrong = faults.told(dict(WRITTEN, **change))
    assert faults.went_wrong(dict(GOOD, **{world: wrong}) if world else wrong)


@pytest.mark.parametrize("value,wrong", [(True, False), (3.2, False), (0.0, False), (False, True), (None, True)])
def test_a_full_disk_goes_wrong_where_a_check_fails(value, wrong):
    assert faults.went_wrong({"full_disk": {"how": "tmpfs", "diagnostics tell the mend, after s": value}}) is wrong


def test_json():
    found = json.loads(faults.as_json(dict(GOOD, real_people=faults.told(dict(WRITTEN)))))
    assert (
        found["recovery_s"]["flood /b"]
        == found["real_people"]["recovery_s"]["flood /b"]
        == {"there": 7.5, "alone": None}
    )
    assert found["topics_left"] == found["parameters_left"] == found["processes_left"] == []


def test_what_is_left_by_its_kind():
    left = {"kill /a": ["topic /x", "node /rsp_x"],
            "kill /b": ["topic /x", "process y", "parameter /human_description_x"]}
    found = faults.told(dict(WRITTEN, left_after=left))
    assert (found["topics_left"], found["nodes_left"], found["processes_left"]) == (["/x"], ["/rsp_x"], ["y"])
    assert found["parameters_left"] == ["/human_description_x"]


def test_parameters_of_bodies_are_right_while_they_are_there():
    before = {"/a", "/human_description_old", "/rsp_old/owner/pid"}
    now = {"/a", "/human_description_new", "/rsp_new/owner/pid", "/rsp_new/publish_frequency"}
    assert fault_graph.odd_parameters(now, before, {"new"}) == []
    assert fault_graph.odd_parameters(now | {"/human_description_old"}, before, {"new"}) == ["/human_description_old"]
    assert fault_graph.odd_parameters({"/b"}, before, set()) == ["/a", "/b"]


def test_processes_of_bodies_are_right_while_they_are_there():
    before = Counter({"__name:=hri_bodies": 1, "__name:=rsp_old": 1})
    assert odd_processes(Counter({"__name:=hri_bodies": 1, "__name:=rsp_new": 1}), before, {"new"}) == []
    assert odd_processes(Counter({"__name:=hri_bodies": 2, "__name:=rsp_old": 1}), before,
                         {"new"}) == ["__name:=hri_bodies", "__name:=rsp_old"]


def test_the_command_line():
    parser = argparse.ArgumentParser()
    faults.register(parser.add_subparsers(dest="command"))
    options = parser.parse_args(["faults", "--json"])
    assert options.json and options.worlds == ",".join(faults.WORLDS) and options.only == ""
    assert faults.run(parser.parse_args(["faults", "--worlds", "nowhere"])) == 2
