"""The bridge to ROS 2: every field of every message, and that mistakes are found."""

from __future__ import annotations

import pytest

from benchmarks.ros2_bridge import definitions, problems, rules, table


def test_every_field_is_carried_over() -> None:
    assert len(table()) == 17
    assert problems(definitions(), table()) == []


def test_without_the_rules_fields_would_be_lost() -> None:
    lost = problems(definitions(), table(), {})
    assert lost == ["AudioFeatures: HNR, MFCC, RMS, ZCR would be lost", "LiveSpeech: language would be lost"]


@pytest.mark.parametrize("change, expected", [
    (lambda ours, theirs, rule: ours["Gaze"].update(sender="int8"), "sender is int8 here and string in ROS 2"),
    (lambda ours, theirs, rule: theirs["LiveSpeech"].pop("locale"), "ROS 2 has no field locale"),
    (lambda ours, theirs, rule: ours["LiveSpeech"].pop("language"), "the rule has no such field: language"),
    (lambda ours, theirs, rule: rule["LiveSpeech"].pop("language"), "language would be lost"),
    (lambda ours, theirs, rule: ours.update(Nod={"level": "int8"}), "Nod: there is no such message in ROS 2"),
    (lambda ours, theirs, rule: ours.pop("Gaze"), "Gaze: there is no such message here"),
])
def test_a_mistake_is_found(change, expected: str) -> None:
    ours, theirs, rule = definitions(), table(), rules()
    change(ours, theirs, rule)
    assert [text for text in problems(ours, theirs, rule) if expected in text]
