"""Simulated conversations: who speaks when, what the mouths do, and what the sensors make of it; parameters of the node
sample_conversation.

Speech: phrases of 0.8 to 2 s with pauses of 0.1 to 0.4 s; syllables 4 to 5 a second (Greenberg 2003, J. Phonetics 31),
lips 0.1 to 0.2 s before the sound; how far a person opens the mouth differs threefold. Others smile, chew and laugh.
Action units come at 15 Hz with noise, single ones get lost, and now and then a face turns away.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from hri_pipeline.core.parameters import ParameterTable, Settings, parameter


@dataclass(frozen=True)
class SampleConversationSettings(Settings):
    """Plays a simulated conversation: faces with moving mouths, voices, and where they are."""

    people: int = parameter(3, "Number of people in view.", minimum=1, maximum=10)
    directions: bool = parameter(
        True, "The voices have directions, with an error of 10 degrees, as of an array. Off: one microphone.")
    unseen_share: float = parameter(
        0.2, "Part of the turns that comes from somebody out of view.", minimum=0.0, maximum=1.0)
    seed: int = parameter(0, "Another number: another conversation.", minimum=0, maximum=1000000)


SAMPLE_CONVERSATION_PARAMETERS = ParameterTable("sample_conversation", SampleConversationSettings)


RATE_HZ = 15.0
UNSEEN = -1
"""Speaker who is not in view, such as a television set."""
_FINE_S = 0.02
_DELAY = (0.03, 0.11)
_TIMEOUT_S = 3.0
"""What the voices node waits before a voice ends."""


class Turn(NamedTuple):
    """Somebody speaks from start to end (s), in phrases."""

    speaker: int
    start: float
    end: float
    phrases: Tuple[Tuple[float, float], ...]


@dataclass(frozen=True)
class Mouths:
    """Action units 25 and 26 of one face as measured: stamps (N,) s, values and confidences (N,)."""

    stamps: np.ndarray
    lips_part: np.ndarray
    jaw_drop: np.ndarray
    confidence: np.ndarray


def make_turns(random: np.random.Generator, people: int, length: float, unseen_share: float) -> List[Turn]:
    """Turns of a conversation of `length` s: one speaks at a time, a share of the turns comes from somebody unseen."""
    turns: List[Turn] = []
    now, last = 1.5, None
    while now < length - 2.0:
        speaker = UNSEEN if random.random() < unseen_share else int(random.integers(people))
        if speaker == last and people > 1 and random.random() < 0.7:
            continue
        last = speaker
        end = min(length - 1.0, now + random.gamma(2.0, 1.7) + 0.6)
        phrases, start = [], now
        while start < end:
            stop = min(end, start + random.uniform(0.8, 2.0))
            phrases.append((start, stop))
            start = stop + random.uniform(0.1, 0.4)
        turns.append(Turn(speaker, now, phrases[-1][1], tuple(phrases)))
        now = phrases[-1][1] + random.uniform(0.1, 2.5)
    return turns


def make_mouth(random: np.random.Generator, person: int, turns: Sequence[Turn], length: float) -> Mouths:
    """What is measured of the mouth of a person."""
    times = np.arange(0.0, length, _FINE_S)
    lips, jaw = np.zeros(len(times)), np.zeros(len(times))
    reach, lead = random.uniform(0.25, 0.75), random.uniform(0.1, 0.2)
    for turn in turns:
        if turn.speaker == person:
            for start, end in turn.phrases:
                _speak(random, times, lips, jaw, start - lead, end - 0.5 * lead, reach)
    busy = np.interp(times, times, lips) > 0.02
    _others(random, times, lips, jaw, busy, length)
    stamps = np.arange(0.0, length, 1.0 / RATE_HZ) + random.normal(0.0, 0.004, int(np.ceil(length * RATE_HZ)))
    kept = (random.random(len(stamps)) > 0.1) & ~_turned_away(random, stamps, length)
    noise = random.uniform(0.01, 0.035)
    bias = max(0.0, random.normal(0.0, 0.05))
    values = [np.clip(np.interp(stamps, times, trace) + bias + random.normal(0.0, noise, len(stamps)), 0.0, 1.0)[kept]
              for trace in (lips, jaw)]
    return Mouths(stamps[kept], values[0], values[1], np.full(int(kept.sum()), random.uniform(0.6, 1.0)))


def _speak(random: np.random.Generator, times: np.ndarray, lips: np.ndarray, jaw: np.ndarray, start: float, end: float,
           reach: float) -> None:
    """Syllables of a phrase: each opens the mouth by another width."""
    now = start
    while now < end:
        width = 1.0 / random.uniform(3.5, 5.5)
        height = reach * random.beta(2.0, 2.0)
        shape = np.sin(np.pi * np.clip((times - now) / width, 0.0, 1.0)) ** 2
        lips += height * shape
        jaw += 0.6 * height * shape
        now += 0.9 * width


def _others(random: np.random.Generator, times: np.ndarray, lips: np.ndarray, jaw: np.ndarray, busy: np.ndarray,
            length: float) -> None:
    """Smiles, chewing and laughter of a person, outside its own speech."""
    for rate, kind in ((1.0 / 12.0, "smile"), (1.0 / 40.0, "chew"), (1.0 / 40.0, "laugh")):
        for start in random.uniform(0.0, length, random.poisson(rate * length)):
            span = {"smile": random.uniform(1.0, 4.0), "chew": random.uniform(2.0, 6.0),
                    "laugh": random.uniform(0.8, 2.0)}[kind]
            inside = np.clip(np.minimum(times - start, start + span - times) / 0.4, 0.0, 1.0) * ~busy
            if kind == "smile":
                lips += random.uniform(0.1, 0.4) * inside
            elif kind == "chew":
                wave = 0.5 - 0.5 * np.cos(2.0 * np.pi * random.uniform(1.0, 1.6) * (times - start))
                jaw += 0.4 * inside * wave
                lips += random.uniform(0.0, 0.15) * inside * wave
            else:
                wave = 0.5 - 0.5 * np.cos(2.0 * np.pi * 4.5 * (times - start))
                lips += inside * (0.3 + 0.15 * wave)
                jaw += inside * (0.2 + 0.1 * wave)


def _turned_away(random: np.random.Generator, stamps: np.ndarray, length: float) -> np.ndarray:
    """Times at which nothing is measured: every 20 s for 0.3 to 1.5 s."""
    away = np.zeros(len(stamps), dtype=bool)
    for start in random.uniform(0.0, length, random.poisson(length / 20.0)):
        away |= (stamps > start) & (stamps < start + random.uniform(0.3, 1.5))
    return away


class Heard(NamedTuple):
    """What is heard: (arrival s, voice, speaking), for each voice from when to when (s) it is tracked and who began it,
    and the voice of each turn.
    """

    messages: List[Tuple[float, str, bool]]
    tracked: List[Tuple[float, float, str, int]]
    voice_of_turn: List[str]


def hear(random: np.random.Generator, turns: Sequence[Turn], array: bool, resume_time: float = 0.0) -> Heard:
    """What the voices node says: without an array a voice goes on for whoever speaks within `resume_time` s of its end.

    is_speaking comes 0.03 to 0.11 s after the first sound, and ends as much after the last one, as measured of that
    node.
    """
    messages: List[Tuple[float, str, bool]] = []
    tracked: List[List] = []
    voices: List[str] = []
    for turn in turns:
        onset = turn.start + random.uniform(*_DELAY)
        if array:
            known = [entry for entry in tracked if entry[3] == turn.speaker and entry[1] > onset]
        else:
            known = [entry for entry in tracked[-1:] if entry[1] - _TIMEOUT_S + resume_time > onset]
        if known:
            entry = known[0]
        else:
            entry = [onset, 0.0, "v%d" % len(tracked), turn.speaker]
            tracked.append(entry)
        voices.append(entry[2])
        entry[1] = turn.end + 0.15 + _TIMEOUT_S
        for start, end in turn.phrases:
            messages += [(start + random.uniform(*_DELAY), entry[2], True),
                         (end + random.uniform(*_DELAY), entry[2], False)]
    return Heard(sorted(messages), [tuple(entry) for entry in tracked], voices)


def directions(random: np.random.Generator, times: np.ndarray, azimuth: float, sd: float) -> np.ndarray:
    """Measured azimuth (rad) of a voice at the times, with an error that holds for about a second."""
    error: Optional[float] = None
    found = []
    for last, now in zip(np.concatenate([[times[0]], times]), times):
        keep = np.exp(-(now - last) / 1.0)
        error = (
            random.normal(0.0, sd) if error is None else keep * error + np.sqrt(1.0 - keep**2) * random.normal(0.0, sd)
        )
        found.append(azimuth + error)
    return np.array(found)
