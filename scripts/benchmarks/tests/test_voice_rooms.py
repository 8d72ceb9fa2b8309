"""Figures of voices in rooms: what counts as a voice of one's own, a stray one and a ghost."""

from __future__ import annotations

from typing import Sequence

import numpy as np
import pytest

from benchmarks import voice_rooms
from benchmarks.voice_rooms import HeardVoice, RoomScene


def towards(degrees: float) -> np.ndarray:
    return np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees)), 0.0])


def scene(labels: Sequence[Sequence[bool]], degrees: Sequence[float]) -> RoomScene:
    flags = np.array(labels, bool)
    directions = np.repeat(np.array([towards(angle) for angle in degrees])[:, None], flags.shape[1], axis=1)
    return RoomScene(np.zeros((4, 3)), directions, np.zeros((len(flags), 1, 4)), np.zeros((1, 4)), flags)


def found(world: RoomScene, voices: Sequence[HeardVoice]) -> dict:
    return voice_rooms.summary([voice_rooms.measure(world, [voices] * world.labels.shape[1])])


def test_one_voice_serves_one_speaker() -> None:
    world = scene([[True] * 10, [True] * 10], [0.0, 15.0])
    assert found(world, [HeardVoice("a", True, True, towards(5.0))])["own_voice"] == 0.5
    both = found(world, [HeardVoice("a", True, True, towards(1.0)), HeardVoice("b", True, True, towards(14.0))])
    assert both["own_voice"] == both["right_number"] == 1.0 and both["error_median_deg"] == 1.0


def test_a_voice_that_is_said_to_be_silent_is_nobodys() -> None:
    result = found(scene([[True] * 10], [0.0]), [HeardVoice("a", False, False, towards(0.0))])
    assert result["own_voice"] == result["right_number"] == 0.0 and result["right_number_of_turns"] == 1.0


def test_who_speaks_without_a_speaker_is_stray_and_who_is_nowhere_a_ghost() -> None:
    world = scene([[True] * 20, [False] * 20], [0.0, 90.0])
    result = found(world, [HeardVoice("a", True, True, towards(0.0)), HeardVoice("b", True, True, towards(90.0))])
    assert result["stray"] == 0.5 and result["ghosts_per_minute"] == 0.0
    assert found(world, [HeardVoice("g", True, True, towards(180.0))])["ghosts_per_minute"] == pytest.approx(93.75)
