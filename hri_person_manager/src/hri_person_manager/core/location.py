"""Where a person is, and how sure that is: the four rules of the person frame.

1. Not identified: no frame. 2. Tracked: confidence 1, at the face, else at the skeleton frame closest to
the head, else at the best guess. 3. Not seen, but located before: the last place, with a confidence below
1 that decays, until it reaches 0. 4. Never located: confidence 0 and no frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Dict, Optional

from hri_pipeline.core.geometry import Pose

DECAY_KINDS = ("exponential", "linear", "step")
UNSEEN_CEILING = 0.99      # a person who is not seen is never at 1, not even in the first instant
STEP_CONFIDENCE = 0.5


class Source(IntEnum):
    """Frames that can place a person, the best one first."""

    FACE = 0
    HEAD = 1
    BODY = 2
    VOICE = 3


@dataclass(frozen=True)
class Place:
    """A pose in a named frame at a time: `pose` maps person coordinates to `frame` (m), `stamp` in s."""

    frame: str
    pose: Pose
    stamp: float


@dataclass(frozen=True)
class Decay:
    """How the confidence of a location falls once the person is out of sight.

    `exponential` halves every `half_life` seconds and ends at 0 below `floor`; `linear` is at one half after
    `half_life` and at 0 after twice that; `step` is 0.5 at once and 0 after twice the `half_life`.
    """

    kind: str = "exponential"
    half_life: float = 5.0
    floor: float = 0.05

    def __post_init__(self) -> None:
        """Refuse a decay that never ends, with ValueError."""
        if self.kind not in DECAY_KINDS:
            raise ValueError("decay is %r, must be one of %s" % (self.kind, ", ".join(DECAY_KINDS)))
        if not self.half_life > 0.0:
            raise ValueError("half_life is %s s, must be above 0" % self.half_life)
        if not 0.0 < self.floor < 1.0:
            raise ValueError("floor is %s, must be between 0 and 1" % self.floor)

    def confidence(self, elapsed: float) -> float:
        """Return the confidence `elapsed` seconds after the person was last seen or heard."""
        elapsed = max(elapsed, 0.0)
        if self.kind == "exponential":
            value = 0.5 ** (elapsed / self.half_life)
            value = value if value >= self.floor else 0.0
        elif self.kind == "linear":
            value = max(0.0, 1.0 - 0.5 * elapsed / self.half_life)
        else:
            value = STEP_CONFIDENCE if elapsed < 2.0 * self.half_life else 0.0
        return min(value, UNSEEN_CEILING)


class Location:
    """Last known place of one person, fed by transforms of its face, head, body and voice frames."""

    def __init__(self, source_timeout: float) -> None:
        """Let a worse source speak once the better ones are silent for `source_timeout` seconds."""
        self._source_timeout = source_timeout
        self._heard: Dict[Source, float] = {}
        self._updated = float("-inf")
        self.place: Optional[Place] = None

    def offer(self, source: Source, place: Place, now: float) -> bool:
        """Take a new place unless a better source spoke recently; return whether it was taken.

        The stamps of the sources are compared with each other, `now` only dates the arrival.
        """
        self._heard[source] = place.stamp
        for better, stamp in self._heard.items():
            if better < source and abs(place.stamp - stamp) <= self._source_timeout:
                return False
        self.place = place
        self._updated = now
        return True

    def forget_source(self, source: Source) -> None:
        """Stop waiting for a source whose feature is gone."""
        self._heard.pop(source, None)

    def inherit(self, other: "Location") -> None:
        """Take over the place of a person that turned out to be the same, if it is the newer one."""
        if other.place is not None and other._updated > self._updated:
            self.place = other.place
            self._updated = other._updated

    def is_silent(self, now: float) -> bool:
        """Tell whether no source has placed the person for longer than the time limit."""
        return now - self._updated > self._source_timeout

    def clear(self) -> None:
        """Forget the place."""
        self.place = None
        self._heard.clear()
        self._updated = float("-inf")
