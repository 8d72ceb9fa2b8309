"""Which likelihoods are said on the graph: new and changed ones, each once a second, and withdrawals.

Nothing is withdrawn of what has left: who it was it still was. A withdrawal of that would race the list that it is no longer in, and
whoever hears the withdrawal first takes the face and the body of somebody who turns away for those of two people.
"""

from __future__ import annotations

from typing import Callable, Dict, Generic, Hashable, List, Mapping, Tuple, TypeVar

RESEND_PERIOD_S = 1.0
Key = TypeVar("Key", bound=Hashable)


class Announcer(Generic[Key]):
    """Chooses what to publish of the likelihoods that hold now.

    step: change of a likelihood from which on it is said before its time.
    """

    def __init__(self, step: float) -> None:
        """ValueError for a step below 0."""
        if not step >= 0.0:
            raise ValueError("step is {}, must not be negative".format(step))
        self._step = step
        self._said: Dict[Key, Tuple[float, float]] = {}

    def to_say(self, current: Mapping[Key, float], now: float, has_left: Callable[[Key], bool] = lambda key: False) -> List[Tuple[Key, float]]:
        """Return what to publish at time `now` (s, of a clock that never jumps), withdrawals (0) first.

        has_left: tells whether one of those whom a likelihood is about is no longer tracked.
        """
        over = [key for key in self._said if key not in current]
        gone = [(key, 0.0) for key in over if not has_left(key)]
        due = [(key, value) for key, value in current.items() if self._is_due(key, value, now)]
        for key in over:
            del self._said[key]
        for key, value in due:
            self._said[key] = (value, now)
        return gone + due

    def withdraw_all(self) -> List[Tuple[Key, float]]:
        """Return the withdrawal of all that was said."""
        return self.to_say({}, 0.0)

    def _is_due(self, key: Key, value: float, now: float) -> bool:
        if key not in self._said:
            return True
        said, when = self._said[key]
        return abs(value - said) > self._step or now - when >= RESEND_PERIOD_S
