"""What there is to say about all persons at one time."""

from __future__ import annotations

from typing import NamedTuple, Optional, Tuple

from hri_person_manager.core.location import Place


class PersonState(NamedTuple):
    """What is published about one person; `alias` names the person that this one was merged into."""

    id: str
    face: str
    body: str
    voice: str
    anonymous: bool
    confidence: float
    alias: str = ""
    place: Optional[Place] = None

    @property
    def tracked(self) -> bool:
        """Tell whether a feature of this person is tracked now."""
        return bool(self.face or self.body or self.voice)


class Snapshot(NamedTuple):
    """All persons at one time: those with topics, and the ids of the tracked and the known ones."""

    persons: Tuple[PersonState, ...]
    tracked: Tuple[str, ...]
    known: Tuple[str, ...]
