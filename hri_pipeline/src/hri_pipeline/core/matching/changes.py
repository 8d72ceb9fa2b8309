"""Which likelihoods are published: new and changed ones, each once a second, and withdrawals."""

from __future__ import annotations

from typing import Callable, Dict, Generic, Hashable, List, Mapping, Tuple, TypeVar

RESEND_PERIOD_S = 1.0
Key = TypeVar("Key", bound=Hashable)


class MatchChanges(Generic[Key]):
    """Chooses what to publish of the likelihoods that hold now.

    A match is not withdrawn when a face, body or voice of it is no longer tracked: it was true as long as both were
    there. A withdrawal would race the list that the id is no longer in, and a receiver that gets the withdrawal first
    would take the face and the body of somebody who turns away for those of two people.

    Parameters
    ----------
    step: float
        Change of a likelihood (0 to 1) from which on it is published before the second is over.
    """

    def __init__(self, step: float) -> None:
        self._step = step
        self._published: Dict[Key, Tuple[float, float]] = {}

    def update(self, current: Mapping[Key, float], now: float,
               has_left: Callable[[Key], bool] = lambda key: False) -> List[Tuple[Key, float]]:
        """Return what to publish at time `now` (s, of a clock that never jumps), withdrawals (likelihood 0) first.

        has_left: tells whether one of those whom a likelihood is about is no longer tracked.
        """
        over = [key for key in self._published if key not in current]
        gone = [(key, 0.0) for key in over if not has_left(key)]
        due = [(key, value) for key, value in current.items() if self._is_due(key, value, now)]
        for key in over:
            del self._published[key]
        for key, value in due:
            self._published[key] = (value, now)
        return gone + due

    def withdraw_all(self) -> List[Tuple[Key, float]]:
        """Return the withdrawal of all that was published."""
        return self.update({}, 0.0)

    def _is_due(self, key: Key, value: float, now: float) -> bool:
        if key not in self._published:
            return True
        published, when = self._published[key]
        return abs(value - published) > self._step or now - when >= RESEND_PERIOD_S
