"""Where a person is, and how sure that is: the four rules of the person frame.

1. Not identified: no frame. 2. Tracked: confidence 1, at the face, else at the skeleton frame closest to
the head, else at the best guess. 3. Not seen, but located before: the last place, with a confidence below
1 that decays, until it reaches 0. 4. Never located: confidence 0 and no frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Dict, Hashable, Optional, Tuple

import numpy as np

from hri_person_manager.core.handover import Handover
from hri_pipeline.core.geometry import Pose

_OPTICAL = "_optical_frame"
DECAY_KINDS = ("exponential", "linear", "step")
UNSEEN_CEILING = 0.99      # a person who is not seen is never at 1, not even in the first instant
STEP_CONFIDENCE = 0.5
SMOOTHING = 0.5            # s, of the velocity
LONGEST_STEP = 1.0         # s between two places that tell a velocity
VOICE_PATIENCE = 3.0       # s for which a place that was seen is better than the direction of a voice
HIGHEST_SPEED = 3.0        # m/s, a person who runs; more is a jump of the measurement


class Source(IntEnum):
    """Frames that can place a person, the best one first."""

    FACE = 0
    HEAD = 1
    BODY = 2
    VOICE = 3


_OF_BODY = (Source.HEAD, Source.BODY)


@dataclass(frozen=True)
class Place:
    """A pose in a named frame at a time: `pose` maps person coordinates to `frame` (m), `stamp` in s."""

    frame: str
    pose: Pose
    stamp: float

    @property
    def horizontal(self) -> Tuple[float, float]:
        """The two horizontal coordinates, m; in a frame of a camera y points down, REP-103."""
        x, y, z = self.pose.translation.tolist()
        return (x, z) if self.frame.endswith(_OPTICAL) else (x, y)


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


class Motion:
    """Velocity of one person, for going on a little after it was lost (constant velocity, coming to rest)."""

    def __init__(self, coast_time: float) -> None:
        """Coast for `coast_time` seconds at most; ValueError if that is negative."""
        if not coast_time >= 0.0:
            raise ValueError("coast_time is %s s, must not be negative" % coast_time)
        self._coast_time = coast_time
        self._last: Optional[Place] = None
        self._velocity = np.zeros(3)

    def see(self, place: Place) -> None:
        """Take a measured place: the velocity is smoothed over about half a second."""
        if self._coast_time <= 0.0:
            return
        last, self._last = self._last, place
        if last is None or last.frame != place.frame:
            self._velocity = np.zeros(3)
            return
        step = place.stamp - last.stamp
        if not 0.0 < step <= LONGEST_STEP:
            self._velocity = np.zeros(3) if step else self._velocity
            return
        measured = (place.pose.translation - last.pose.translation) / step
        speed = float(np.linalg.norm(measured))
        measured = measured * min(1.0, HIGHEST_SPEED / speed) if speed > 0.0 else measured
        self._velocity = self._velocity + (1.0 - math.exp(-step / SMOOTHING)) * (measured - self._velocity)

    def coast(self, place: Place, elapsed: float) -> Place:
        """Return the place `elapsed` seconds later: at first with the last velocity, at the end of the time at rest."""
        if self._coast_time <= 0.0 or elapsed <= 0.0:
            return place
        time = min(elapsed, self._coast_time)
        way = self._velocity * (time - 0.5 * time * time / self._coast_time)
        return Place(place.frame, Pose(place.pose.rotation, place.pose.translation + way), place.stamp)

    def clear(self) -> None:
        """Forget the velocity."""
        self._last = None
        self._velocity = np.zeros(3)


class Location:
    """Last known place of one person, fed by transforms of its face, head, body and voice frames."""

    def __init__(self, source_timeout: float, coast_time: float = 0.0) -> None:
        """Let a worse source speak once the better ones are silent for `source_timeout` seconds.

        coast_time: s, for which a person that is not seen any more goes on as it went; 0 lets it stand.
        """
        self._source_timeout = source_timeout
        self._motion = Motion(coast_time)
        self._handover = Handover()
        self._heard: Dict[Source, Tuple[float, Hashable]] = {}
        self._updated = self._seen = float("-inf")
        self.place: Optional[Place] = None

    def offer(self, source: Source, place: Place, now: float, feature: Hashable = None) -> bool:
        """Take a new place unless a better source spoke recently; return whether it was taken.

        The stamps of the sources are compared with each other, `now` only dates the arrival. Of two features that
        are equally good, such as the faces that two cameras see of one person, the one that spoke first goes on. A voice
        tells the direction only: where somebody was seen shortly before is closer to the truth. A body goes on from where
        the face was: see `handover`.
        """
        for better, (stamp, speaker) in self._heard.items():
            preferred = better < source or (better == source and speaker != feature)
            if preferred and -self._source_timeout <= place.stamp - stamp <= self._patience(better, source):
                if better < source:
                    self._heard.setdefault(source, (place.stamp, feature))
                    if better == Source.FACE and source in _OF_BODY:
                        self._handover.body(place.frame, place.pose.translation, place.stamp, (source, feature))
                return False
        if source != Source.VOICE:
            self._seen = place.stamp
        elif 0.0 <= place.stamp - self._seen <= VOICE_PATIENCE:
            return False
        if source == Source.FACE:
            self._handover.face(place.frame, place.pose.translation, place.stamp)
        elif source in _OF_BODY:
            place = replace(place, pose=self._handover.carried(place.frame, place.pose, place.stamp, (source, feature)))
        self._heard[source] = (place.stamp, feature)
        self._motion.see(place)
        self.place = place
        self._updated = now
        return True

    def expected(self, now: float) -> Optional[Place]:
        """Return where the person is now when nobody has seen it since its last place; None without one."""
        return None if self.place is None else self._motion.coast(self.place, now - self._updated)

    def forget_source(self, source: Source) -> None:
        """Stop waiting for a source whose feature is gone."""
        self._heard.pop(source, None)

    def inherit(self, other: "Location") -> None:
        """Take over the place of a person that turned out to be the same, if it is the newer one."""
        if other.place is not None and other._updated > self._updated:
            self.place = other.place
            self._updated, self._seen = other._updated, other._seen

    def _patience(self, better: Source, source: Source) -> float:
        """How long (s) a source waits for a better one that is silent."""
        if better == Source.FACE and source in _OF_BODY:
            return self._handover.patience(self._source_timeout)
        return self._source_timeout

    def is_silent(self, now: float) -> bool:
        """Tell whether no source has placed the person for longer than the time limit."""
        return now - self._updated > self._source_timeout

    def clear(self) -> None:
        """Forget the place."""
        self.place = None
        self._motion.clear()
        self._handover.clear()
        self._heard.clear()
        self._updated = self._seen = float("-inf")
