"""How much of the time in which somebody speaks the voice is given to the right face."""

from __future__ import annotations

from typing import Dict, Mapping, Optional, Sequence, Tuple

import numpy as np

from hri_pipeline.core.matching.parameters import VOICE_MATCHER_PARAMETERS, VoiceMatcherSettings
from hri_pipeline.core.matching.voice import FACE, VoiceMatch, VoiceMatcher, opening_of_units
from hri_pipeline.core.simulation.conversation import UNSEEN, directions, hear, make_mouth, make_turns

LENGTH_S = 120.0
UNSEEN_SHARE = 0.2
FACE_LATENCY_S = 0.12
DIRECTION_SD = np.deg2rad(10.0)
_APART = np.deg2rad((25.0, 40.0))
_COUNTED = ("right", "wrong", "none", "unseen_none", "unseen_wrong", "said")


def run_conversation(random: np.random.Generator, people: int, with_direction: bool, settings: VoiceMatcherSettings,
                     resume_time: float = 0.0) -> Dict[str, float]:
    """Seconds of speech that were given to the right face, to a wrong one and to none; of those unseen apart; `said`:
    seconds given, each times its likelihood."""
    turns = make_turns(random, people, LENGTH_S, UNSEEN_SHARE)
    mouths = [make_mouth(random, person, turns, LENGTH_S) for person in range(people)]
    heard = hear(random, turns, with_direction, resume_time)
    azimuths = np.cumsum(random.uniform(*_APART, people)) - np.deg2rad(60.0)
    steps = np.arange(0.0, LENGTH_S, settings.period)
    sources = {voice: speaker for _, _, voice, speaker in heard.tracked}
    measured = {voice: directions(random, steps, azimuths[speaker] if speaker != UNSEEN else random.uniform(-3.1, 3.1),
                                  DIRECTION_SD) for voice, speaker in sources.items()} if with_direction else {}
    matcher = VoiceMatcher(settings)
    matcher.set_tracked("faces", ["f%d" % person for person in range(people)])
    places = {(FACE, "f%d" % person): 2.0 * _unit(azimuth) for person, azimuth in enumerate(azimuths)}
    found = dict.fromkeys(_COUNTED, 0.0)
    events = _events(mouths, heard)
    at = 0
    for index, now in enumerate(steps):
        tracked = [voice for start, end, voice, _ in heard.tracked if start <= now <= end]
        matcher.set_tracked("voices", tracked)
        while at < len(events) and events[at][0] <= now:
            events[at][2](matcher)
            at += 1
        for voice in tracked:
            if voice in measured:
                matcher.set_direction(voice, _unit(measured[voice][index]), places)
        matches = {match.voice: match for match in matcher.matches(now)}
        _judge(turns, heard, matches, now, settings.period, found)
    return found


CASES: Sequence[Tuple[str, bool, float]] = (("", False, 0.0), ("_resumed", False, 2.0), ("_direction", True, 0.0))
"""Suffix of the figures; with directions (standard deviation 10 degrees) or with one microphone; time (s) within which,
without an array, the voice of one turn goes on with the next, whoever speaks."""


def whose_voice(seed: int = 1000, conversations: int = 12,
                given: Optional[Mapping[str, object]] = None) -> Dict[str, float]:
    """Parts of the voiced time of people in view that go to the right face, to a wrong one, to none; of the voiced time
    of those unseen, that which goes to a face; mean likelihood of all that is given to a face, less the part of it that
    is right (`too_sure`). 2 to 4 faces, two minutes each.

    given: parameters of the matcher other than the defaults. The defaults were chosen with seed 0.
    """
    settings = VOICE_MATCHER_PARAMETERS.resolve(dict(given or {}))
    figures: Dict[str, float] = {}
    for suffix, with_direction, resume_time in CASES:
        random = np.random.default_rng(seed)
        total = dict.fromkeys(_COUNTED, 0.0)
        for number in range(conversations):
            for key, value in run_conversation(random, 2 + number % 3, with_direction, settings, resume_time).items():
                total[key] += value
        seen = total["right"] + total["wrong"] + total["none"]
        for key in ("right", "wrong", "none"):
            figures["whose_voice_" + key + suffix] = total[key] / seen
        figures["whose_voice_unseen_wrong" + suffix] = total["unseen_wrong"] / (
            total["unseen_wrong"] + total["unseen_none"])
        figures["whose_voice_too_sure" + suffix] = (total["said"] - total["right"]) / (
            total["right"] + total["wrong"] + total["unseen_wrong"])
    return figures


def _unit(azimuth: float) -> np.ndarray:
    return np.array([np.cos(azimuth), np.sin(azimuth), 0.0])


def _events(mouths, heard) -> list:
    """Everything that arrives, in the order of arrival: (time s, number, what to tell the matcher)."""
    events = []
    for person, mouth in enumerate(mouths):
        for stamp, lips, jaw, confidence in zip(mouth.stamps, mouth.lips_part, mouth.jaw_drop, mouth.confidence):
            units, certain = np.zeros(99), np.zeros(99)
            units[[25, 26]], certain[[25, 26]] = (lips, jaw), confidence
            sample = opening_of_units(units, certain)
            events.append((stamp + FACE_LATENCY_S, len(events),
                           lambda matcher, face="f%d" % person, stamp=stamp, sample=sample:
                           matcher.add_mouth(face, stamp, *sample)))
    for arrival, voice, speaking in heard.messages:
        events.append((arrival, len(events), lambda matcher, voice=voice, speaking=speaking, arrival=arrival:
                       matcher.on_speaking(voice, speaking, arrival)))
    return sorted(events, key=lambda event: event[:2])


def _judge(turns, heard, matches: Mapping[str, VoiceMatch], now: float, period: float, found: Dict[str, float]
           ) -> None:
    """Count the time of one comparison for who speaks now."""
    number = next((number for number, turn in enumerate(turns)
                   if any(start <= now <= end for start, end in turn.phrases)), None)
    if number is None:
        return
    turn, match = turns[number], matches.get(heard.voice_of_turn[number])
    owner = "" if match is None else match.id
    found["said"] += 0.0 if match is None else period * match.confidence
    if turn.speaker == UNSEEN:
        found["unseen_wrong" if owner else "unseen_none"] += period
    else:
        found["none" if not owner else "right" if owner == "f%d" % turn.speaker else "wrong"] += period
