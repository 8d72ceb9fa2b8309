"""Who has been in a store of people for too long, although the clock may be wrong.

A computer without a battery for its clock starts in 1970, or years ahead, until it hears the time from a network. So
nobody expires by a time that the store has not seen come: `StoreClock` remembers the span over which the clock went on
without a jump, and `judge_retention` compares the times of that span only, unless the system says that its clock is
synchronised.
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from typing import List, Mapping, Optional

DAY_S = 86400.0
LATEST_S = 1e11
"""Later times (s) are none."""
LARGEST_STEP_S = 30.0 * DAY_S
"""A clock that is ahead by more than this, or by half of the greatest age, since the store was used has jumped."""
BACK_S = DAY_S
"""A clock may be behind by this: local time instead of UTC is."""


@dataclass(frozen=True)
class Span:
    """Times (s) between which a clock has gone on without a jump."""

    start: float
    end: float

    def goes_on(self, now: float, largest_step: float) -> bool:
        """Tell whether `now` is no jump, forward by more than `largest_step` (s) or back."""
        return self.end - BACK_S <= now <= self.end + largest_step

    def until(self, now: float) -> Span:
        """Return the span when it is `now`."""
        return Span(self.start, max(self.end, now))

    def __contains__(self, when: float) -> bool:
        return self.start - BACK_S <= when <= self.end + BACK_S


@dataclass(frozen=True)
class StoreClock:
    """What a store knows of the clock. trusted: the times that count; doubted: those since a jump, None without one."""

    trusted: Span
    doubted: Optional[Span] = None

    def to_json(self) -> str:
        """Return it as text."""
        spans = [span for span in (self.trusted, self.doubted) if span is not None]
        return json.dumps([[span.start, span.end] for span in spans])

    @staticmethod
    def from_json(text: str) -> Optional[StoreClock]:
        """Return what `to_json` was given, None for anything else."""
        try:
            spans = [Span(float(start), float(end)) for start, end in json.loads(text)]
            if all(abs(span.start) < LATEST_S and abs(span.end) < LATEST_S for span in spans):
                return StoreClock(*spans)
        except (TypeError, ValueError):
            pass
        return None


@dataclass(frozen=True)
class RetentionVerdict:
    """What becomes of the people of a store.

    gone: ids of who is to be removed; redated: of who was seen by a clock that was wrong, and is taken for seen now;
    clock: what the store knows of the clock from now on; problem: what is wrong with the clock, empty when nothing is.
    """

    gone: List[str]
    redated: List[str]
    clock: StoreClock
    problem: str


def judge_retention(last_seen: Mapping[str, float], clock: Optional[StoreClock], now: float, max_age: float,
                    max_persons: int, is_synchronised: bool = False) -> RetentionVerdict:
    """Decide who stays.

    While the clock is doubted nobody expires by age. It is trusted again when it is synchronised, is back at the time
    of before, or has gone on for `max_age` since it jumped: who was not seen in all that time has expired by any clock.

    Parameters
    ----------
    last_seen : times (s) at which people were seen last, by id.
    clock : what the store knew, None for a store of an earlier version.
    now : time (s).
    max_age : greatest time (s) unseen; 0: no limit.
    max_persons : most people; 0: no limit.
    is_synchronised : whether the system says that its clock is right, as by NTP.
    """
    if clock is None:
        known = list(last_seen.values()) or [now]
        clock = StoreClock(Span(min(known), max(known)))
    before = clock
    clock = _at(clock, now, max_age, is_synchronised)
    ages = {person: _age(when, before, clock, now) for person, when in last_seen.items()}
    # Who was seen since the clock jumped has no age while it is doubted, and was seen last.
    order = sorted(last_seen, key=lambda person: (ages[person] is not None or clock.doubted is None,
                                                  ages[person] or 0.0, -last_seen[person]))
    is_old = {person: clock.doubted is None and 0.0 < max_age < (ages[person] or 0.0) for person in order}
    gone = [person for number, person in enumerate(order) if is_old[person] or 0 < max_persons <= number]
    redated = [person for person in order if clock.doubted is None and ages[person] is None and person not in set(gone)]
    return RetentionVerdict(gone, redated, clock, _problem(clock, max_age))


def _at(clock: StoreClock, now: float, max_age: float, is_synchronised: bool) -> StoreClock:
    step = min(LARGEST_STEP_S, max_age / 2.0) if max_age else LARGEST_STEP_S
    if clock.trusted.goes_on(now, step):
        return StoreClock(clock.trusted.until(now))
    if is_synchronised and now > clock.trusted.end:
        return StoreClock(clock.trusted.until(now))
    doubted = clock.doubted
    doubted = doubted.until(now) if doubted is not None and doubted.goes_on(now, step) else Span(now, now)
    if is_synchronised or doubted.end - doubted.start > (max_age or LARGEST_STEP_S):
        return StoreClock(doubted)
    return StoreClock(clock.trusted, doubted)


def _age(when: float, before: StoreClock, clock: StoreClock, now: float) -> Optional[float]:
    """Time (s) since somebody was seen; None where no clock that was trusted has told that."""
    wrong = before.doubted if clock.trusted.start == before.trusted.start else None
    if wrong is not None and wrong.end + LARGEST_STEP_S < now and when in wrong and when not in before.trusted:
        return None
    if when in clock.trusted:
        return max(0.0, now - when)
    if clock.doubted is None and clock.trusted.start != before.trusted.start and when in before.trusted:
        return max(0.0, now - clock.trusted.start) + before.trusted.end - when
    return None


def _problem(clock: StoreClock, max_age: float) -> str:
    if clock.doubted is None or not max_age:
        return ""
    now, last = (time.strftime("%Y-%m-%d", time.gmtime(span.end)) for span in (clock.doubted, clock.trusted))
    return ("the clock says {}, and the store was used last on {}: nobody expires before it is synchronised (NTP), "
            "goes on from there, or has gone on without a jump for {:g} days (store_max_age); set it if it is "
            "wrong".format(now, last, max_age / DAY_S))
