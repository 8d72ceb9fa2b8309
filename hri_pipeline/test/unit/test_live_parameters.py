"""Parameters that may change while a node runs: their marks, and that what holds them takes them up."""

import ast
from pathlib import Path

import numpy as np
import pytest

from hri_pipeline.core import parameter_docs
from hri_pipeline.core.audio.parameters import VOICES
from hri_pipeline.core.audio.vad import check_thresholds
from hri_pipeline.core.faces.scheduler import DetectionScheduler
from hri_pipeline.core.faces.tracker import FaceMeasurement, FaceTracker
from hri_pipeline.core.interactions.engagement import check_levels
from hri_pipeline.core.interactions.parameters import INTERACTION_PARAMETERS
from hri_pipeline.core.parameters import Parameter, ParameterError, ParameterTable, apply_settings
from hri_pipeline.core.scheduler import InferenceScheduler, Request
from hri_pipeline.core.tracks import TrackLife

ROOT = Path(__file__).resolve().parents[3]
PACKAGES = ("hri_pipeline", "hri_fullbody", "hri_person_manager")
TABLE = ParameterTable("node", "A node.", (
    Parameter("rate", 15.0, "Rate.", unit="Hz", minimum=1, maximum=60, live=True),
    Parameter("shown", True, "Show.", live=True),
    Parameter("file", "", "File.")))
_WHILE_BUILT = ("__init__", "from_parameters")
_OWNERS = ("settings", "_settings", "values", "wanted")


def read_while_running():
    """Names of settings that some function reads which is no constructor."""
    found = set()
    for package in PACKAGES:
        for path in (ROOT / package / "src").rglob("*.py"):
            for function in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(function, ast.FunctionDef) and function.name not in _WHILE_BUILT:
                    found |= {node.attr for node in ast.walk(function) if isinstance(node, ast.Attribute)
                              and getattr(node.value, "id", getattr(node.value, "attr", "")) in _OWNERS}
    return found


def test_no_parameter_is_called_live_that_is_only_read_while_the_node_is_built():
    used = read_while_running()
    live = {parameter.name for _, table in parameter_docs.registered() for parameter in table.live}
    assert len(live) > 50
    assert sorted(live - used) == []
    assert "face_mesh_model" not in used and "vad_model" not in used


@pytest.mark.parametrize("arguments", [
    dict(default=["x"]), dict(default=1.0), dict(default=1.0, minimum=0.0), dict(default=1, maximum=2)])
def test_what_cannot_be_live(arguments):
    with pytest.raises(ValueError, match="cannot change while the node runs"):
        Parameter("a", doc="x", live=True, **arguments)


def test_changed_leaves_the_given_settings_alone():
    settings = TABLE.resolve({"file": "x"})
    changed = TABLE.changed(settings, {"rate": 2})
    assert (changed.rate, changed.shown, changed.file) == (2.0, True, "x")
    assert settings.rate == 15.0
    apply_settings(settings, changed)
    assert settings.rate == 2.0


@pytest.mark.parametrize("changes, words", [
    ({"rate": 0.5}, "parameter rate is 0.5 .*1 to 60 Hz"),
    ({"rate": float("nan")}, "parameter rate is nan"),
    ({"rate": True}, "parameter rate is True"),
    ({"file": "y"}, "file of node cannot change while the node runs; these can: rate, shown"),
    ({"rat": 3.0}, r"no parameter rat \(did you mean rate\?\)")])
def test_what_is_refused(changes, words):
    with pytest.raises(ParameterError, match=words):
        TABLE.changed(TABLE.resolve({}), changes)


def test_the_mark_is_in_yaml_and_markdown():
    assert "# float; 1 to 60; unit Hz; default 15.0; may change while the node runs\nrate: 15.0" in TABLE.to_yaml()
    assert "# string; default \"\"\nfile:" in TABLE.to_yaml()
    lines = TABLE.to_markdown().splitlines()
    assert lines[0] == r"\* may change [while the node runs](../tuning.md)."
    assert lines[2] == r"- `~rate`\* (`15.0` Hz, 1–60): Rate." and lines[4] == '- `~file` (`""`): File.'


def test_life_of_a_track_with_other_limits():
    life = TrackLife(0.0, 1.0, 5.0)
    life.seen(0.5)
    assert not life.confirmed and not life.dead(3.0)
    life.limit(0.1, 1.0)
    life.seen(0.6)
    assert life.confirmed and life.dead(3.0)
    with pytest.raises(ValueError):
        life.limit(-1.0, 1.0)


def face(x):
    mesh = np.random.default_rng(1).uniform(0.0, 100.0, (478, 3)) + (x, 0.0, 0.0)
    return FaceMeasurement(mesh, 0.99, True)


def test_limits_hold_for_the_faces_that_are_tracked():
    tracker = FaceTracker(0.0, 10.0, 10)
    tracker.update([face(0.0), face(300.0)], 0.0)
    for stamp in np.arange(0.1, 2.05, 0.1):
        tracker.update([face(0.0)], stamp)
    assert len(tracker.ids) == 2
    tracker.limit(0.0, 1.0, 1, 1, np.inf)
    tracker.update([face(0.0), face(600.0)], 2.1)
    assert len(tracker.ids) == 1
    tracker.limit(0.0, 1.0, 5, 2, np.inf)
    assert tracker.ids == []        # seen by the detector once only


def test_other_share_of_looks():
    budget = InferenceScheduler(0.0, 0.010, cost=0.005)
    everybody = [Request(name) for name in "abcd"]
    assert len(budget.choose(everybody, 0.0)) == 2
    budget.limit(0.0, 0.020)
    assert len(budget.choose(everybody, 0.1)) == 4
    with pytest.raises(ValueError):
        budget.limit(-1.0, 0.010)


def test_other_period_of_the_detector():
    image = np.zeros((480, 640, 3), np.uint8)
    schedule = DetectionScheduler(10.0, 1)
    assert schedule.due(image, 0.0) and not schedule.due(image, 1.0)
    schedule.set_period(0.5)
    schedule.hurry(1.0)
    assert schedule.due(image, 1.6) and schedule.due(image, 2.2)
    with pytest.raises(ValueError):
        schedule.set_period(-1.0)


def test_levels_and_thresholds_that_contradict_each_other():
    check_levels(INTERACTION_PARAMETERS.resolve({}))
    with pytest.raises(ValueError, match="engaging_level 0.9"):
        check_levels(INTERACTION_PARAMETERS.resolve({"engaging_level": 0.9}))
    check_thresholds(VOICES.resolve({}))
    with pytest.raises(ValueError, match="keep_threshold 0.9"):
        check_thresholds(VOICES.resolve({"keep_threshold": 0.9}))
