"""Check of candidate matches that come from outside: form of ids, range of likelihoods, rate."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from typing import Counter as CounterType
from typing import Dict, Optional

from hri_person_manager.core.association import Kind, Node
from hri_pipeline.core.ids import is_valid_id

UNDER_WAY_S = 2.0     # what was said of a person just before it was forgotten has arrived after so long


@dataclass(frozen=True)
class Match:
    """Likelihood (0..1, 0 withdraws) that two identifiers belong to the same human."""

    first: Node
    second: Node
    likelihood: float


class RateLimit:
    """Token bucket: at most `per_second` events on average, a burst of one second's worth at once."""

    def __init__(self, per_second: float) -> None:
        """ValueError unless the rate is above zero."""
        self.set_rate(per_second)
        self._tokens = per_second
        self._last: Optional[float] = None

    def set_rate(self, per_second: float) -> None:
        """Set the rate from now on; ValueError unless it is above zero."""
        if not per_second > 0.0:
            raise ValueError("rate is %s per second, must be above 0" % per_second)
        self._rate = per_second

    def allow(self, now: float) -> bool:
        """Tell whether one more event at time `now` (s) is within the limit; time may jump back."""
        elapsed = 0.0 if self._last is None else max(0.0, now - self._last)
        self._last = now
        self._tokens = min(self._rate, self._tokens + elapsed * self._rate)
        if self._tokens < 1.0:
            return False
        self._tokens -= 1.0
        return True


class MatchGuard:
    """Turns raw fields into a `Match`, or refuses them and counts why."""

    def __init__(self, max_per_second: float) -> None:
        """Accept at most `max_per_second` matches on average."""
        self.limit = RateLimit(max_per_second)
        self.refused: CounterType[str] = Counter()
        self.accepted = self.late = 0
        self._forgotten: Dict[str, float] = {}

    def forget(self, person_id: str, now: float) -> None:
        """Take no match that names a person for 2 s from `now` (s): it would bring back who has just been forgotten."""
        self._forgotten = {name: since for name, since in self._forgotten.items() if now - since <= UNDER_WAY_S}
        self._forgotten[person_id] = now

    def check(self, id1: object, type1: object, id2: object, type2: object,
              likelihood: object, now: float) -> Optional[Match]:
        """Return the match, None if it was refused; `now` (s) drives the rate limit."""
        if not self.limit.allow(now):
            return self._refuse("too many per second")
        try:
            kinds = Kind(type1), Kind(type2)
        except ValueError:
            return self._refuse("unknown type")
        if not (is_valid_id(id1) and is_valid_id(id2)):
            return self._refuse("malformed id")
        if kinds[0] == kinds[1] != Kind.PERSON:
            return self._refuse("two ids of one kind")
        if (id1, type1) == (id2, type2):
            return self._refuse("an id and itself")
        value = float(likelihood)
        if not (math.isfinite(value) and 0.0 <= value <= 1.0):
            return self._refuse("likelihood outside 0..1")
        if self._forgotten and self._is_late(id1, id2, now):
            self.late += 1
            return None
        self.accepted += 1
        return Match(Node(kinds[0], id1), Node(kinds[1], id2), value)

    def _is_late(self, id1: str, id2: str, now: float) -> bool:
        return any(now - self._forgotten[name] <= UNDER_WAY_S for name in (id1, id2) if name in self._forgotten)

    def _refuse(self, reason: str) -> None:
        self.refused[reason] += 1
