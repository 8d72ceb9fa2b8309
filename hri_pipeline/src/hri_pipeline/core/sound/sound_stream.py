"""A stream of sound messages as blocks of 16 kHz with the time at which they were heard."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, List, Optional

import numpy as np
import soxr

from hri_pipeline.core.sound.sound_clock import SampleClock
from hri_pipeline.core.sound.sound_format import SoundFormat, decode, nearest_rate
from hri_pipeline.core.sound.sound_level import SoundLevel

RATE = 16000
"""Samples per second of everything behind the intake."""
BLOCK = 512
"""Most samples of a block: 32 ms."""
_WRONG_SPEED = 0.1


@dataclass(frozen=True)
class SoundBlock:
    """A piece of sound.

    samples: (N, C) float32 of -1 to 1 at 16 kHz, N of 1 to BLOCK. stamp: s, of the first sample. gap: s of sound that
    is missing before it.
    """

    samples: np.ndarray
    stamp: float
    gap: float = 0.0


class SoundStream:
    """Decodes, resamples once, stamps and measures a stream of one format.

    tolerance: s, see SampleClock. latency: s, least time from a sound to its arrival, taken from every stamp. quality:
    of the resampler (soxr): HQ keeps sound up to 7.3 kHz and holds 37 ms back at 48 kHz, LQ 5.8 kHz and 20 ms; a stream of 16 kHz
    passes as it is. The stamps count what is held back.
    """

    def __init__(self, form: SoundFormat, tolerance: float = 0.08, latency: float = 0.0, quality: str = "HQ") -> None:
        self.form = form
        self._latency = latency
        self._quality = quality
        self._clock = SampleClock(tolerance)
        self._level = SoundLevel(form.sample_rate, form.channels)
        self._taken = 0
        self._skipped = 0.0
        self._overrun = 0.0
        self._untold = 0.0
        self._begin = 0.0
        self._given = 0
        self._resampler = self._new_resampler()
        self.gaps = 0
        self.lost = 0.0

    def add(self, data: bytes, arrival: float) -> List[SoundBlock]:
        """Take the bytes of a message that arrived at `arrival` (s); return blocks, as soon as they can be had.

        Raises SoundError for bytes that are no sound of this format; they are left out, and the stream goes on.
        """
        samples = decode(data, self.form)
        if not len(samples):
            return []
        self._level.add(samples)
        start = self._stream_time()
        self._taken += len(samples)
        before = self._clock.offset
        gap = self._clock.add(self._stream_time(), arrival) + self._overrun
        self._overrun = 0.0
        blocks: List[SoundBlock] = []
        if gap > 0.0:
            self.gaps += 1
            self.lost += gap
            self._untold += gap
            blocks = self._end_piece(before)
            self._begin, self._given = start, 0
        fresh = self._blocks(self._resample(samples), self._clock.offset, self._untold)
        if fresh:
            self._untold = 0.0
        return blocks + fresh

    def skip(self, seconds: float) -> None:
        """Take note that `seconds` of sound came and could not be taken (an overrun): the next block has a gap."""
        self._skipped += max(0.0, seconds)
        self._overrun += max(0.0, seconds)

    def problem(self) -> str:
        """Say what is wrong with the sound and the mend; empty when nothing is."""
        speed = self._clock.speed()
        if speed and abs(speed - 1.0) > _WRONG_SPEED:
            came = speed * self.form.sample_rate
            usual, is_near = nearest_rate(came)
            mend = "set ~sample_rate (or the AudioInfo) to {}".format(usual) if is_near else \
                "is ~sample_rate (or the AudioInfo), ~channels or ~sample_format right, or is sound lost on its way?"
            return "{:.0f} samples a second come instead of {}: {}".format(came, self.form.sample_rate, mend)
        return self._level.problem()

    def values(self) -> Dict[str, object]:
        """Return what diagnostics show."""
        values: Dict[str, object] = {"format": self.form.text, "gaps": self.gaps, "lost_s": self.lost,
                                     "clock_set_back": self._clock.set_back, "seconds": self._stream_time()}
        speed = self._clock.speed()
        if speed:
            values["measured_rate_hz"] = speed * self.form.sample_rate
        values.update(self._level.values())
        return values

    def _stream_time(self) -> float:
        return self._taken / self.form.sample_rate + self._skipped

    def _new_resampler(self) -> Optional[soxr.ResampleStream]:
        if self.form.sample_rate == RATE:
            return None
        return soxr.ResampleStream(self.form.sample_rate, RATE, self.form.channels, dtype="float32", quality=self._quality)

    def _resample(self, samples: np.ndarray, last: bool = False) -> np.ndarray:
        if self._resampler is None:
            return samples
        return self._resampler.resample_chunk(np.ascontiguousarray(samples), last=last)

    def _end_piece(self, offset: float) -> List[SoundBlock]:
        """Return what the resampler holds of the sound before a gap, and begin it anew."""
        if self._resampler is None:
            return []
        tail = self._resample(np.zeros((0, self.form.channels), np.float32), last=True)
        blocks = self._blocks(tail, offset, 0.0)
        self._resampler = self._new_resampler()
        return blocks

    def _blocks(self, samples: np.ndarray, offset: float, gap: float) -> List[SoundBlock]:
        """Cut into blocks; what is resampled keeps its place in time."""
        blocks = []
        for start in range(0, len(samples), BLOCK):
            stamp = self._begin + self._given / RATE + offset - self._latency
            blocks.append(SoundBlock(samples[start:start + BLOCK], stamp, 0.0 if blocks else gap))
            self._given += len(blocks[-1].samples)
        return blocks
