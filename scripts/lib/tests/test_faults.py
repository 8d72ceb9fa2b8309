"""What `scripts/benchmark faults` prints, and when it fails."""

import argparse
import json
import sys
from pathlib import Path

import pytest

pytest.importorskip("rospy")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import benchmark_faults  # noqa: E402
import faults  # noqa: E402

GOOD = {"recovery_s": {"kill /a": faults.Recovery(2.0, 3.0), "flood /b": faults.Recovery(7.5, None)}, "nodes_ended_by_garbage": [],
        "parameters_left": [], "processes_left": [], "topics_left": [], "lost_from_store": [], "stored": ["ann"]}


def test_the_table_says_what_was_soon_enough():
    lines = faults.as_table(GOOD).splitlines()
    assert lines[1].split() == ["kill", "/a", "2.00", "3.00", "yes"]
    assert lines[2].split() == ["flood", "/b", "7.50", "never", "NO"]
    assert "lost from store" in lines[-2] and lines[-2].endswith("none")


@pytest.mark.parametrize("change", [{"recovery_s": {"kill /a": faults.NEVER}}, {"topics_left": ["/humans/persons/x/alias"]},
                                    {"lost_from_store": ["ann"]}, {"nodes_ended_by_garbage": ["/a"]}])
def test_what_goes_wrong(change):
    assert not faults.went_wrong(GOOD)
    assert faults.went_wrong(dict(GOOD, **change))


def test_json():
    assert json.loads(faults.as_json(GOOD))["recovery_s"]["flood /b"] == {"there": 7.5, "alone": None}


def test_the_command_line():
    parser = argparse.ArgumentParser()
    benchmark_faults.register(parser.add_subparsers(dest="command"))
    assert parser.parse_args(["faults", "--json"]).json
