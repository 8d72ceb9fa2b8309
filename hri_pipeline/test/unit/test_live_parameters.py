"""Parameters that may change while a node runs: their marks, and that what holds them takes them up."""

import ast
import functools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from hri_pipeline.core import parameter_docs
from hri_pipeline.core.audio.parameters import VOICES
from hri_pipeline.core.audio.pipeline import VoicePipeline
from hri_pipeline.core.audio.separation import SoundSeparator
from hri_pipeline.core.audio.stream import SoundBlock
from hri_pipeline.core.audio.vad import check_thresholds
from hri_pipeline.core.faces.scheduler import DetectionScheduler
from hri_pipeline.core.faces.track import FaceMeasurement
from hri_pipeline.core.faces.tracker import FaceTracker
from hri_pipeline.core.interactions.engagement import EngagementEstimator, check_levels
from hri_pipeline.core.interactions.gaze import GazeTargets
from hri_pipeline.core.interactions.groups import GroupTracker
from hri_pipeline.core.interactions.parameters import INTERACTION_PARAMETERS
from hri_pipeline.core.matching.face_body import FaceBodyMatcher
from hri_pipeline.core.matching.parameters import MATCHER_PARAMETERS, VOICE_MATCHER_PARAMETERS
from hri_pipeline.core.matching.voice import VoiceMatcher
from hri_pipeline.core.parameters import Parameter, ParameterError, ParameterTable, Settings, parameter
from hri_pipeline.core.scheduler import InferenceScheduler, Request
from hri_pipeline.core.tracks import TrackLife

SQUARE = 0.04 * np.array([(1.0, 1.0, 0.0), (-1.0, 1.0, 0.0), (-1.0, -1.0, 0.0), (1.0, -1.0, 0.0)])
ROOT = Path(__file__).resolve().parents[3]
PACKAGES = ("hri_pipeline", "hri_fullbody", "hri_person_manager")


@dataclass(frozen=True)
class NodeSettings(Settings):
    """A node."""

    rate: float = parameter(15.0, "Rate.", unit="Hz", minimum=1, maximum=60, live=True)
    shown: bool = parameter(True, "Show.", live=True)
    file: str = parameter("", "File.")


TABLE = ParameterTable("node", NodeSettings)
_WHILE_BUILT = ("__init__", "from_parameters")
_OWNERS = ("settings", "_settings", "values", "wanted")


@functools.lru_cache()
def sources():
    """(name of the module, its syntax tree) of everything that reads settings."""
    texts = [(path.stem, path.read_text(encoding="utf-8"))
             for package in PACKAGES for path in (ROOT / package / "src").rglob("*.py")]
    return [(module, ast.parse(text)) for module, text in texts if any(owner + "." in text for owner in _OWNERS)]


def read_while_running():
    """Names of settings that some function reads which is no constructor."""
    found = set()
    for _, tree in sources():
        for function in ast.walk(tree):
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


def classes_that_keep_settings():
    """(class, names read of the settings it keeps, methods that take up other ones) of all sources."""
    for module, tree in sources():
        for kind in [node for node in ast.walk(tree) if isinstance(node, ast.ClassDef)]:
            takers = {method.name for method in kind.body if isinstance(method, ast.FunctionDef)
                      for node in ast.walk(method) if isinstance(node, ast.Attribute)
                      and isinstance(node.ctx, ast.Store) and node.attr == "_settings"}
            used = {node.attr for method in kind.body if getattr(method, "name", "") != "__init__"
                    for node in ast.walk(method) if isinstance(node, ast.Attribute)
                    and getattr(node.value, "attr", "") == "_settings"}
            if takers:
                yield "{}.{}".format(module, kind.name), used, takers - {"__init__"}


def test_who_keeps_settings_with_live_values_takes_up_other_ones():
    """Settings are frozen: new values are a new object, which every keeper must be given."""
    live = {parameter.name for _, table in parameter_docs.registered() for parameter in table.live}
    keepers = list(classes_that_keep_settings())
    assert len(keepers) > 15
    fixed = {"simulator.SceneSimulatorNode": {"rate"}, "sources.ImageSourceNode": {"rate"},
             "sources.SoundSourceNode": {"rate"}, "web.Pictures": {"max_rate"}}     # live in another node only
    assert [name for name, used, takers in keepers if (used & live) - fixed.get(name, set()) and not takers] == []


def keepers_of(owner, settings, path=""):
    """Where an object, or what it owns, keeps these very settings."""
    for name, value in vars(owner).items():
        parts = value.values() if isinstance(value, dict) else value if isinstance(value, (list, tuple)) else [value]
        for part in parts:
            if part is settings:
                yield "{}.{}".format(path, name)
            elif type(part).__module__.startswith("hri_") and hasattr(part, "__dict__"):
                yield from keepers_of(part, settings, "{}.{}".format(path, name))


class Silence:
    def probabilities(self, frames, states):
        return np.zeros(len(states))


def voice_pipeline(settings):
    pipeline = VoicePipeline(settings, Silence())
    pipeline.update(SoundBlock(np.zeros((1024, 1), np.float32), 0.0))
    return pipeline


@pytest.mark.parametrize("table, make, where", [
    (VOICES, voice_pipeline, "._sources.turns.activity._settings"),
    (VOICES, lambda settings: SoundSeparator(SQUARE, settings), "._settings"),
    (MATCHER_PARAMETERS, FaceBodyMatcher, "._settings"), (VOICE_MATCHER_PARAMETERS, VoiceMatcher, "._settings"),
    (INTERACTION_PARAMETERS, GazeTargets, "._filter._settings"), (INTERACTION_PARAMETERS, GroupTracker, "._settings"),
    (INTERACTION_PARAMETERS, EngagementEstimator, "._settings")])
def test_new_settings_reach_everything_that_keeps_the_old_ones(table, make, where):
    old, new = table.resolve({}), table.resolve({})
    owner = make(old)
    kept = sorted(keepers_of(owner, old))
    assert where in kept
    owner.reconfigure(new)
    assert sorted(keepers_of(owner, new)) == kept and list(keepers_of(owner, old)) == []


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
    assert lines[0] == r"\* can change [at run time](../tuning.md)."
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
