"""Birth and death of a track, counted in seconds so that the frame rate does not matter."""

from __future__ import annotations

import math


class TrackLife:
    """Life of one track: a candidate until it is confirmed, and dead when it has not been detected for long.

    Parameters
    ----------
    stamp : float
        First detection, s, by the clock of the images.
    birth_delay : float
        The track is confirmed by a detection at least so long after the first one, s; at once for 0.
    death_time : float
        The track is dead after so long without a detection, s.

    Raises
    ------
    ValueError
        For a negative birth_delay, and a death_time that is not positive.
    """

    def __init__(self, stamp: float, birth_delay: float, death_time: float) -> None:
        self.first_seen = float(stamp)
        self.last_seen = float(stamp)
        self.confirmed = birth_delay == 0.0
        self.limit(birth_delay, death_time)

    def limit(self, birth_delay: float, death_time: float) -> None:
        """Set birth_delay and death_time (s) from now on. Raises ValueError for illegal ones."""
        if not (math.isfinite(birth_delay) and birth_delay >= 0.0):
            raise ValueError("birth_delay is {} s, legal range 0 and more".format(birth_delay))
        if not (math.isfinite(death_time) and death_time > 0.0):
            raise ValueError("death_time is {} s, legal range more than 0".format(death_time))
        self._birth_delay = float(birth_delay)
        self._death_time = float(death_time)

    def seen(self, stamp: float) -> None:
        """Note a detection at `stamp`; an older stamp than the last changes nothing."""
        self.last_seen = max(self.last_seen, float(stamp))
        # A stamp is a multiple of a nanosecond: allow that much, or 0.1 + 0.2 is not 0.3.
        if self.last_seen - self.first_seen >= self._birth_delay - 1e-9:
            self.confirmed = True

    def dead(self, stamp: float) -> bool:
        """Return whether there was no detection for longer than death_time at `stamp`."""
        return stamp - self.last_seen > self._death_time
