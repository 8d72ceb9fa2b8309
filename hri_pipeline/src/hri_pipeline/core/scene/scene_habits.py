"""What the people of a scene do unasked: whom they look at, when their eyes are closed, and who speaks in a group."""

from __future__ import annotations

import random
from typing import Dict, Iterable, Optional, Sequence, Tuple

from hri_pipeline.core.scene.scene_agent import between, wrapped
from hri_pipeline.core.scene.scene_model import AWAY, ROBOT, Habits
from hri_pipeline.core.scene.scene_noise import Alternation

SPEAKER_SHARE = 0.6
"""Part of the looks at the group that go to who speaks: listeners look at the speaker for 62 % of the time in groups
(Vertegaal et al., CHI 2001)."""
_LEAST_LOOK = 0.8
CLEAR_ANGLE = 0.35
"""Angle (rad) from all heads at which somebody looks away."""
_AWAY_YAWS = (-1.2, -0.9, -0.6, 0.6, 0.9, 1.2)
_AWAY_PITCHES = (-0.25, -0.5)


class Looks:
    """Whom one person looks at unasked; one choice lasts for a while."""

    def __init__(self, habits: Habits, chance: random.Random) -> None:
        self._habits, self._chance = habits, chance
        self._until = 0.0
        self._company: Tuple[str, ...] = ()
        self.choice: Optional[str] = None

    def update(self, now: float, company: Sequence[str], speaker: Optional[str], sees_robot: bool) -> Optional[str]:
        """Return an id, AWAY, or None for straight ahead.

        company: the others in the group; speaker: who of all speaks; sees_robot: whether the robot may be looked at.
        """
        habits = self._habits
        if habits.dwell <= 0.0:
            self.choice = None
            return None
        if now < self._until and tuple(company) == self._company:
            return self.choice
        self._company = tuple(company)
        self._until = now + max(_LEAST_LOOK, self._chance.expovariate(1.0 / habits.dwell))
        draw = self._chance.random()
        if draw < habits.look_away:
            self.choice = AWAY
        elif draw < habits.look_away + habits.look_robot:
            self.choice = ROBOT if sees_robot else AWAY
        elif not company:
            self.choice = AWAY
        elif speaker in company and self._chance.random() < SPEAKER_SHARE:
            self.choice = speaker
        else:
            self.choice = self._chance.choice(list(company))
        return self.choice


def lids(habits: Habits, chance: random.Random) -> Alternation:
    """When one person's eyes are closed unasked."""
    return Alternation(habits.closed, habits.closed_length, chance, least=0.2)


class Conversation:
    """Who speaks in one group: turns of one speaker each, and silence in between."""

    def __init__(self, habits: Habits, chance: random.Random) -> None:
        self._habits, self._chance = habits, chance
        self._speaker: Optional[str] = None
        self._until = 0.0

    def update(self, now: float, members: Iterable[str]) -> Optional[str]:
        """Return the id of the member who speaks, None while nobody does."""
        present = sorted(member for member in members if member != ROBOT)
        if self._habits.turn <= 0.0 or len(present) < 2:
            self._speaker = None
            return None
        if now >= self._until:
            silent = self._speaker is None
            others = [member for member in present if member != self._last]
            self._speaker = self._chance.choice(others) if silent and others else None
            self._last = self._speaker if self._speaker is not None else self._last
            mean = self._habits.turn if self._speaker is not None else self._habits.pause
            self._until = now + self._chance.expovariate(1.0 / mean) if mean > 0.0 else now
        return self._speaker if self._speaker in present else None

    _last: Optional[str] = None


class Away:
    """A direction in which nobody's head is, kept until a head comes near to it."""

    def __init__(self, chance: random.Random) -> None:
        self._chance = chance
        self._direction: Optional[Tuple[float, float]] = None

    def update(self, yaw: float, heads: Dict[str, Tuple[float, float]]) -> Tuple[float, float]:
        """Return yaw and elevation, rad. yaw: of the trunk; heads: directions of all heads and of the robot's."""
        kept = self._direction
        if kept is None or abs(wrapped(kept[0] - yaw)) > 1.4 or self._clearance(kept, heads) < CLEAR_ANGLE:
            options = [(yaw + turn, pitch) for turn in _AWAY_YAWS for pitch in _AWAY_PITCHES]
            self._chance.shuffle(options)
            clear = [option for option in options if self._clearance(option, heads) > 1.5 * CLEAR_ANGLE]
            self._direction = kept = (clear or [max(options, key=lambda option: self._clearance(option, heads))])[0]
        return kept

    def drop(self) -> None:
        """Look elsewhere next time."""
        self._direction = None

    @staticmethod
    def _clearance(option: Tuple[float, float], heads: Dict[str, Tuple[float, float]]) -> float:
        return min((between(option, head) for head in heads.values()), default=3.0)
