"""An even rhythm by the stamps of images."""

from __future__ import annotations


class StampPacer:
    """Picks images so that `rate` of them per second are taken on average, whatever their own rate.

    rate: Hz; 0 takes all. Counting goes on from where an image was due, not from where it came: images at 20 Hz
    give 15 Hz and not 10. Raises ValueError for a rate below 0.
    """

    def __init__(self, rate: float) -> None:
        self._last = float("-inf")
        self.set_rate(rate)

    def set_rate(self, rate: float) -> None:
        """Set the rate, Hz; the row starts anew. ValueError below 0."""
        if not rate >= 0.0:
            raise ValueError("rate is {} Hz, legal range 0 and more".format(rate))
        self._period = 1.0 / rate if rate > 0.0 else 0.0
        self._due = float("-inf")

    def is_due(self, stamp: float) -> bool:
        """Tell whether the image of `stamp` (s) is taken. One that is not newer than the last taken one never is."""
        if stamp <= self._last or stamp < self._due - 1e-6:
            return False
        self._last = stamp
        # After a pause of more than one period the row starts anew: there are no bursts.
        self._due = (self._due if stamp - self._due < self._period else stamp) + self._period
        return True

    def reset(self) -> None:
        """Start anew: time has jumped back."""
        self._due = self._last = float("-inf")
