"""One utterance on its way through the recogniser: sound that waits, and which sound a text belongs to."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Deque, List, Optional, Tuple

import numpy as np

from hri_pipeline.core.speech.speech_engine import RATE

_FULL_SCALE = 32767.0


@dataclass(frozen=True)
class SpeechResult:
    """What a voice has said.

    stamp: s, end of the sound that the text covers. incremental: text so far, which may change; final: text of the whole
    utterance; one of them is empty, and both are when what was told so far turns out to have been nothing. confidence: of
    final, 0 to 1. language: IETF tag.
    """

    voice_id: str
    stamp: float
    incremental: str
    final: str
    confidence: float
    language: str


def to_bytes(samples: np.ndarray) -> bytes:
    """Return 16-bit samples of (n,) samples from -1 to 1, clipped; what is not finite is silence.

    Raises ValueError for another shape.
    """
    samples = np.asarray(samples, dtype=np.float32)
    if samples.ndim != 1:
        raise ValueError("recognition of speech needs one channel, not samples of shape {}".format(samples.shape))
    samples = np.nan_to_num(samples, nan=0.0, posinf=0.0, neginf=0.0)
    return np.rint(np.clip(samples, -1.0, 1.0) * _FULL_SCALE).astype("<i2").tobytes()


class Utterance:
    """What one voice says in one turn. limit: s of sound that may wait.

    All its sound is kept until it is over: when a process dies another one hears it from the beginning.
    """

    def __init__(self, number: int, voice_id: str, stamp: float, limit: float) -> None:
        self.number = number
        self.voice_id = voice_id
        self.text = ""
        """What was published last."""
        self.accepted = 0
        """Samples taken so far, those dropped not counted."""
        self.sent = self.done = 0
        """Samples sent to the present process, and samples that it has worked on."""
        self.heard = 0
        """The most samples that any process has worked on."""
        self.deaths = 0
        self.ended = self.asked = self.unwanted = False
        self._limit = int(limit * RATE)
        self._sound: List[bytes] = []
        self._next = 0
        self._ends: Deque[Tuple[int, float]] = deque()
        self._stamp = stamp

    @property
    def waiting(self) -> float:
        """Sound that waits or is being worked on, s."""
        return (self.accepted - self.heard) / RATE

    def add(self, data: bytes, stamp: float) -> int:
        """Let 16-bit samples wait; stamp: s, of the first. Returns the number of samples that found no room."""
        count = len(data) // 2
        if self.accepted - self.heard + count > self._limit:
            return count
        self._ends.append((self.accepted + count, stamp + count / RATE))
        self._sound.append(data)
        self.accepted += count
        return 0

    def take(self) -> Optional[bytes]:
        """Return the next sound to send, None when there is none."""
        if self._next >= len(self._sound):
            return None
        data = self._sound[self._next]
        self._next += 1
        self.sent += len(data) // 2
        return data

    def rewind(self) -> None:
        """Begin from the first sample, with another process."""
        self._next = self.sent = self.done = 0
        self.asked = False

    def progress(self, samples: int) -> int:
        """Note that the present process has worked on `samples` samples; return how many are new to all processes."""
        self.done = min(samples, self.sent)
        new = max(0, self.done - self.heard)
        self.heard += new
        return new

    def stamp_of(self, samples: int) -> float:
        """Return the stamp, s, of the end of the first `samples` samples; what lies before is forgotten."""
        while len(self._ends) > 1 and self._ends[0][0] < samples:
            self._ends.popleft()
        if self._ends:
            end, stamp = self._ends[0]
            self._stamp = stamp - max(0, end - samples) / RATE
        return self._stamp
