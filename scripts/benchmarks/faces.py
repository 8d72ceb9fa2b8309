"""`scripts/benchmark faces`: processor time, poses, eyes, expressions and recognition of faces."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Callable, Dict, Sequence

from benchmarks.report import Keys, Subject, models_directory, most, told


def _all_most(limit: float) -> Callable[[object], bool]:
    return lambda value: isinstance(value, dict) and all(number <= limit for number in value.values())


def _no_error(*wrong: str) -> Callable[[object], bool]:
    return lambda value: isinstance(value, dict) and not any(value[name] for name in wrong)


# Figure, what is asked, and whether a value is that.
KEYS: Keys = (
    ("cpu_ms_1", "<= 10 ms", most(10.0)), ("cpu_ms_3", "<= 16 ms", most(16.0)),
    ("cpu_ms_10", "<= 35 ms", most(35.0)),
    ("pose_mae_deg", "<= 2 deg each", _all_most(2.0)), ("pose_position_percent", "<= 3 %", most(3.0)),
    ("turned_heads", "(told)", told),
    ("face_body_depth_ratio_median", "0.85 .. 1.15",
     lambda value: isinstance(value, float) and 0.85 <= value <= 1.15),
    ("eyes_closed", "(told)", told),
    ("expression", "precision >= 0.8", lambda value: isinstance(value, dict) and value["precision"] >= 0.8),
    ("recognition", "wrong 0, unknown 0", _no_error("wrong", "unknown")))

PARTS: Dict[str, Sequence[str]] = {
    "cpu": ("cpu_ms_1", "cpu_ms_3", "cpu_ms_10"), "pose": ("pose_mae_deg", "pose_position_percent"),
    "turned": ("turned_heads",), "depth": ("face_body_depth_ratio_median",),
    "eyes": ("eyes_closed",), "expression": ("expression",),
    "recognition": ("recognition",)}
SUBJECT = Subject("faces", "processor time, poses, eyes, expressions and recognition of faces", KEYS, PARTS, {
    "images": "1280x720", "pictures": "groups demo and evaluation of fetch_models", "threads": "1 per network",
    "recognition": "each picture as a film of 8 s at 5 Hz, in two runs", "models": models_directory().name})


def register(commands: argparse._SubParsersAction) -> None:
    """Add the command line of this benchmark."""
    SUBJECT.register(commands)


def run(options: argparse.Namespace) -> int:
    """Measure and print; 1 when something could not be measured."""
    return SUBJECT.run(options, _measure)


def _measure(part: str) -> Dict[str, object]:
    """Figures of one part."""
    models = models_directory()
    if part == "recognition":
        return {"recognition": _recognition(models)}
    from benchmarks import face_figures
    if part == "cpu":
        from benchmarks.scenes import make_scene
        return {"cpu_ms_{}".format(people): round(face_figures.cpu_ms(make_scene(people, models / "demo"), people), 2)
                for people in (1, 3, 10)}
    if part == "pose":
        yaw, pitch, roll, position = face_figures.pose_errors()
        return {"pose_mae_deg": {"yaw": round(yaw, 3), "pitch": round(pitch, 3), "roll": round(roll, 3)},
                "pose_position_percent": round(position, 3)}
    if part == "turned":
        from benchmarks import turned_heads
        return {"turned_heads": turned_heads.figures(models)}
    if part == "depth":
        from benchmarks.body_fit import face_body_depth_ratio_median
        return {"face_body_depth_ratio_median": face_body_depth_ratio_median(models)}
    if part == "expression":
        figures = face_figures.expressions(models)
        return {"expression": dict(figures["expression"], tuned=figures["tuned"])}
    return {"eyes_closed": face_figures.eyes_closed(models)}


def _recognition(models: Path) -> Dict[str, int]:
    from benchmarks.recognition import identities, recognise_twice

    def say(text: str) -> None:
        print("  " + text, file=sys.stderr, flush=True)

    encounters = recognise_twice(identities(asked_only=True), models, say)
    for mistake in encounters.mistakes:
        say(mistake)
    return dict(encounters.counts)
