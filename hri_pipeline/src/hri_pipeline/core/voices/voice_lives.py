"""Ids of voices: when a turn is a new voice, when one that is known, and until when a voice is tracked."""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Dict, List, Optional, Tuple

import numpy as np

from hri_pipeline.core.ids import IdGenerator


@dataclass
class Voice:
    """A tracked voice: the source it comes from, the time of its last word, its direction (unit, and rad).

    in_turn: it has the word; known: it has had a turn that was no mere noise.
    """

    id: str
    key: int
    last_word: float
    direction: Optional[np.ndarray] = None
    direction_sd: Optional[float] = None
    in_turn: bool = True
    known: bool = False


class VoiceLives:
    """All tracked voices.

    A voice is tracked until `voice_timeout` after its last word. Who begins to speak in that time is the same voice: from the same
    direction (within `resume_angle`, or the same source) with an array; without directions, within `resume_time`.
    settings: the parameters of these names. ids: where new ids come from.
    """

    def __init__(self, settings: SimpleNamespace, ids: IdGenerator) -> None:
        self._settings = settings
        self._ids = ids
        self._voices: Dict[str, Voice] = {}

    @property
    def tracked(self) -> Tuple[str, ...]:
        """Ids, oldest first."""
        return tuple(self._voices)

    @property
    def silent(self) -> List[Voice]:
        """Tracked voices that are not in a turn."""
        return [voice for voice in self._voices.values() if not voice.in_turn]

    def begin(self, key: int, stamp: float, direction: Optional[np.ndarray] = None,
              direction_sd: Optional[float] = None) -> Voice:
        """Return the voice of a turn that begins now: one that is tracked and silent, or a new one."""
        voice = self._known(key, stamp, direction)
        if voice is None:
            voice = Voice(self._ids.new(), key, stamp)
            self._voices[voice.id] = voice
        voice.key, voice.in_turn = key, True
        self.heard(voice, stamp, direction, direction_sd)
        return voice

    def heard(self, voice: Voice, stamp: float, direction: Optional[np.ndarray],
              direction_sd: Optional[float]) -> None:
        """Note that a voice has said something until `stamp`, and from where."""
        voice.last_word = max(voice.last_word, stamp)
        if direction is not None:
            voice.direction, voice.direction_sd = direction, direction_sd

    def end(self, voice: Voice, short: bool) -> None:
        """End the turn of a voice. short: it was a noise; a voice that has said nothing else is forgotten."""
        voice.in_turn = False
        voice.known = voice.known or not short
        if not voice.known:
            self._voices.pop(voice.id, None)

    def expire(self, stamp: float) -> None:
        """Let go of the voices whose time is over."""
        for voice in self.silent:
            if stamp - voice.last_word > self._settings.voice_timeout:
                del self._voices[voice.id]

    def clear(self) -> None:
        """Let go of all."""
        self._voices.clear()

    def _known(self, key: int, stamp: float, direction: Optional[np.ndarray]) -> Optional[Voice]:
        silent = [voice for voice in self.silent if stamp - voice.last_word <= self._settings.voice_timeout]
        if direction is None:
            recent = [voice for voice in silent if voice.key == key
                      and stamp - voice.last_word <= self._settings.resume_time]
            return max(recent, key=lambda voice: voice.last_word) if recent else None
        same = [voice for voice in silent if voice.key == key and voice.direction is not None]
        if same:
            return max(same, key=lambda voice: voice.last_word)
        near = [(angle_between(voice.direction, direction), voice) for voice in silent if voice.direction is not None]
        near = [pair for pair in near if pair[0] <= self._settings.resume_angle]
        return min(near, key=lambda pair: pair[0])[1] if near else None


def angle_between(first: np.ndarray, second: np.ndarray) -> float:
    """Return the angle between two unit vectors, (3,), in rad."""
    return math.atan2(float(np.linalg.norm(np.cross(first, second))), float(np.dot(first, second)))
