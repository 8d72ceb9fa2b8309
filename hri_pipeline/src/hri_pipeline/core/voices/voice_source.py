"""One source of sound on its way to turns: its samples in frames, its look-back, what the networks remember of it."""

from __future__ import annotations

import math
from collections import deque
from types import SimpleNamespace
from typing import Deque, Optional, Tuple

import numpy as np

from hri_pipeline.core.voices.voice_activity import FRAME, FRAME_TIME, RATE, ActivityState
from hri_pipeline.core.voices.voice_lives import Voice
from hri_pipeline.core.voices.voice_turns import SILENCE_DBFS, TurnDetector

_JUMP = 0.02
_FORGET = 0.5


class VoiceSource:
    """The sound of one source, cut into frames of 512 samples.

    key: of the source; settings: the parameters of activity. voice: whose turn it is now, None between turns. clock: the time up to
    which frames were taken or silence was noted; last_sound: the end of its last sound; last_heard: the end of the last that came
    from its direction.
    """

    def __init__(self, key: int, settings: SimpleNamespace) -> None:
        self.key = key
        self.state = ActivityState()
        self.turns = TurnDetector(settings)
        self.voice: Optional[Voice] = None
        self.direction: Optional[np.ndarray] = None
        self.direction_sd: Optional[float] = None
        self.probability = 0.0
        self.energy = SILENCE_DBFS
        self.clock = math.nan
        self.last_sound = -math.inf
        self.last_heard = -math.inf
        self._rest = np.zeros(0, np.float32)
        self._look_back = int(round(settings.look_back * RATE))
        self._grace = settings.direction_grace
        self._kept: Deque[np.ndarray] = deque(maxlen=-(-self._look_back // FRAME))

    def add(self, samples: np.ndarray, stamp: float, heard: bool = True) -> float:
        """Add samples (n,) whose first has this stamp; returns the seconds of sound that are missing before them.

        heard: whether they came from the direction of the source, as far as the array can tell.

        What is left of a frame before a jump is dropped; behind a long one the network starts afresh.
        """
        expected = self._end() if not math.isnan(self.clock) else stamp
        missing = stamp - expected
        if abs(missing) > _JUMP:
            self._rest = self._rest[:0]
            self._kept.clear()
            if abs(missing) > _FORGET:
                self.state.reset()
        else:
            missing = 0.0
        missed = max(stamp - self.clock, 0.0) if missing > 0.0 else 0.0
        self.clock = stamp - len(self._rest) / RATE
        self._rest = np.concatenate((self._rest, samples))
        self.last_sound = self._end()
        if heard:
            self.last_heard = self.last_sound
        return missed

    @property
    def ready(self) -> bool:
        """Tell whether a whole frame waits."""
        return len(self._rest) >= FRAME

    @property
    def waiting(self) -> np.ndarray:
        """The next frame, (512,); only when `ready`."""
        return self._rest[:FRAME]

    def take(self, probability: float) -> Tuple[np.ndarray, float]:
        """Take the next frame, with its probability; returns its samples (512,) and stamp."""
        frame, stamp = self._rest[:FRAME].copy(), self.clock
        self._rest = self._rest[FRAME:]
        self.clock = stamp + FRAME_TIME
        self.probability, self.energy = probability, level(frame)
        if stamp > self.last_heard + self._grace:
            # Speech that comes from elsewhere, and that the filter lets through.
            self.probability = 0.0
        return frame, stamp

    def keep(self, frame: np.ndarray) -> None:
        """Keep a frame that belongs to no turn, for a look-back."""
        self._kept.append(frame)

    def with_look_back(self, frame: np.ndarray, stamp: float) -> Tuple[np.ndarray, float]:
        """Return the frame with the sound kept from before it, at most `look_back`, and the stamp of the first sample."""
        before = np.concatenate(list(self._kept) + [frame[:0]])
        before = before[max(len(before) - self._look_back, 0):]
        self._kept.clear()
        return np.concatenate((before, frame)), stamp - len(before) / RATE

    def fall_silent(self, stamp: float) -> float:
        """Note that no sound comes until `stamp`; returns the seconds since the last."""
        silence = stamp - self.clock
        if not silence > 0.0:
            return 0.0
        self.clock = stamp
        self._rest = self._rest[:0]
        self._kept.clear()
        if silence > _FORGET:
            self.state.reset()
        self.probability, self.energy = 0.0, SILENCE_DBFS
        return silence

    def _end(self) -> float:
        return self.clock + len(self._rest) / RATE


def level(samples: np.ndarray) -> float:
    """Return the level of samples in dB below the full scale, 20 log10 of their root mean square; -120 at least."""
    exact = samples.astype(np.float64)
    power = float(exact @ exact) / len(samples) if len(samples) else 0.0
    return max(10.0 * math.log10(power), SILENCE_DBFS) if power > 0.0 else SILENCE_DBFS
