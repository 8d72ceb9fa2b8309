"""Ids of the features of a scene, as trackers give them: late, kept over short gaps, new after long ones."""

from __future__ import annotations

import random
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Dict, List, Set, Tuple

from hri_pipeline.core.ids import IdGenerator


@dataclass
class _Track:
    id: str
    first: float
    last: float


class Tracks:
    """The tracks of one kind of feature. hold: time (s) for which one that is not found stays listed."""

    def __init__(self, settings: SimpleNamespace, ids: IdGenerator, chance: random.Random, hold: float) -> None:
        self._delay, self._hold = settings.sense_birth_delay, hold
        self._changes = settings.sense_id_changes / 60.0
        self._ids, self._chance = ids, chance
        self._tracks: Dict[str, _Track] = {}
        self._last = 0.0

    def update(self, found: Set[str], now: float) -> List[Tuple[str, str]]:
        """Take the people whose feature is found at `now` (s); returns (person, id) of all that are listed."""
        passed, self._last = max(0.0, now - self._last), now
        for person in sorted(found):
            track = self._tracks.get(person)
            if track is None or now - track.last > self._hold:
                self._tracks[person] = _Track(self._ids.new(), now, now)
                continue
            track.last = now
            if self._changes > 0.0 and self._chance.random() < self._changes * passed:
                track.id = self._ids.new()
        for person in [person for person, track in self._tracks.items() if now - track.last > self._hold]:
            del self._tracks[person]
        return [(person, track.id) for person, track in sorted(self._tracks.items()) if now - track.first >= self._delay - 1e-9]
