"""The 16 low-level descriptors of the INTERSPEECH 2009 emotion challenge, frame by frame.

B. Schuller, S. Steidl, A. Batliner: The INTERSPEECH 2009 Emotion Challenge. Proc. INTERSPEECH 2009, 312-315, table 1:
zero-crossing rate, root mean square of the frame's energy, pitch normalised to 500 Hz, harmonics-to-noise ratio from
the autocorrelation function, and the mel-frequency cepstral coefficients 1 to 12, of 25 ms every 10 ms.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import List, Tuple

import numpy as np

from hri_pipeline.core.voices.mel_cepstrum import MelCepstrum
from hri_pipeline.core.voices.pitch import PitchEstimator

RATE = 16000
FRAME_S = 0.025
HOP_S = 0.010
PITCH_UNIT_HZ = 500.0
# A block whose stamp is this far from the end of the last one does not continue it.
GAP_S = 0.020
# What is computed at once: bounds the memory that a long block takes.
_BATCH = 256


@dataclass(frozen=True)
class FeatureFrame:
    """Descriptors of one frame.

    stamp: s, of the frame's first sample. zcr: zero crossings per sample, 0 to 1. rms: 0 to 1. pitch: F0 / 500 Hz, 0
    where the frame is not voiced. hnr: dB, -20 to 60. mfcc: (12,), coefficients 1 to 12.
    """

    stamp: float
    zcr: float
    rms: float
    pitch: float
    hnr: float
    mfcc: np.ndarray


def zero_crossings(frames: np.ndarray) -> np.ndarray:
    """Return (N,) sign changes per pair of neighbours of (N, length) samples; 0 counts as positive."""
    negative = np.signbit(frames)
    return np.mean(negative[:, 1:] != negative[:, :-1], axis=1)


@lru_cache(maxsize=None)
def _analysers(length: int) -> Tuple[PitchEstimator, MelCepstrum]:
    """Tables that all voices share; nothing in them changes."""
    return PitchEstimator(RATE), MelCepstrum(length, RATE)


class AudioFeatureExtractor:
    """Descriptors of one voice at 16 kHz.

        extractor = AudioFeatureExtractor()
        for frame in extractor.process(samples, stamp): ...

    rate: Hz of the frames that are computed; 100 is every frame of 10 ms, less leaves frames out (to the nearest whole
    number of them). The same sound gives the same frames whatever the lengths of the blocks. Pitch and HNR are of the
    40 ms around the frame, so a frame comes 7.5 ms of sound after its end. Raises ValueError for a rate that is not in
    1 to 100.
    """

    def __init__(self, rate: float = 1.0 / HOP_S) -> None:
        if not 1.0 <= rate <= 1.0 / HOP_S:
            raise ValueError("the rate of the features is {} Hz, legal range 1 to {:g}".format(rate, 1.0 / HOP_S))
        self._length = int(round(FRAME_S * RATE))
        self._hop = int(round(HOP_S * RATE)) * max(1, int(round(1.0 / (HOP_S * rate))))
        self._pitch, self._cepstrum = _analysers(self._length)
        self._margin = (self._pitch.length - self._length) // 2
        self.reset()

    def reset(self) -> None:
        """Forget the sound so far; the next block starts anew."""
        # Before the first frame the pitch window sees silence.
        self._kept = np.zeros(self._margin)
        self._skip = 0
        self._end = float("nan")

    def process(self, samples: np.ndarray, stamp: float) -> List[FeatureFrame]:
        """Return the frames that (n,) samples from -1 to 1 complete; stamp: s, of the first of them.

        Sound that does not continue the last block starts anew. Raises ValueError for samples that are not (n,) finite
        numbers.
        """
        samples = np.asarray(samples, dtype=np.float64)
        if samples.ndim != 1 or not np.isfinite(samples).all():
            raise ValueError("features need finite samples of one channel, not an array of shape {}".format(samples.shape))
        if abs(stamp - self._end) > GAP_S:
            self.reset()
        self._end = stamp + len(samples) / RATE
        skipped = min(self._skip, len(samples))
        self._skip -= skipped
        self._kept = np.concatenate([self._kept, samples[skipped:]])
        frames: List[FeatureFrame] = []
        while len(self._kept) >= self._pitch.length:
            frames += self._batch()
        return frames

    def _batch(self) -> List[FeatureFrame]:
        count = min(_BATCH, 1 + (len(self._kept) - self._pitch.length) // self._hop)
        step = self._kept.strides[0]
        windows = np.lib.stride_tricks.as_strided(
            self._kept, (count, self._pitch.length), (self._hop * step, step), writeable=False)
        inner = windows[:, self._margin:self._margin + self._length]
        first = self._end - (len(self._kept) - self._margin) / RATE
        zcr = zero_crossings(inner).tolist()
        rms = np.sqrt(np.einsum("ij,ij->i", inner, inner) / self._length).tolist()
        frequency, hnr = self._pitch(windows)
        pitch, hnr, mfcc = (frequency / PITCH_UNIT_HZ).tolist(), hnr.tolist(), self._cepstrum(inner)
        used = count * self._hop
        self._skip = max(0, used - len(self._kept))
        self._kept = self._kept[used:].copy()
        return [FeatureFrame(first + number * self._hop / RATE, zcr[number], rms[number], pitch[number], hnr[number],
                             mfcc[number]) for number in range(count)]
