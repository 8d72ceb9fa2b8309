"""Whose voice a sound is: embeddings of speakers (`SpeakerEmbedder`), and where in a turn another one goes on
(`SpeakerChange`).

The network (Resemblyzer 0.1.4, Apache-2.0) was trained with the loss of L. Wan et al., "Generalized end-to-end loss for
speaker verification", ICASSP 2018: unit vectors of two sounds of one speaker have a larger product than those of two
speakers. It takes the power in 40 mel bands, of 25 ms every 10 ms, of 1.6 s of speech or any other length.
"""

from __future__ import annotations

from collections import deque
from functools import lru_cache
from pathlib import Path
from typing import Callable, Deque, List, NamedTuple, Optional, Sequence, Tuple, Union

import numpy as np
import scipy.fft

from hri_pipeline.core.audio.level import level_dbfs
from hri_pipeline.core.audio.stream import RATE
from hri_pipeline.core.onnx import OnnxModel

BANDS, DIMENSION = 40, 256
MODEL_FILE = "speaker_embedding.onnx"
WINDOW, HOP = RATE * 25 // 1000, RATE // 100
LEVEL_DBFS = -30.0
"""Level to which sound is brought: the network was trained on such."""
_BREAK_HZ, _HZ_PER_MEL = 1000.0, 200.0 / 3.0
_LOG_STEP = np.log(6.4) / 27.0
# Of SpeakerChange, in frames of 32 ms: what is compared (1.2 s), how often (0.26 s), with how much of the turn (4 s),
# and where the change is looked for before the end of what is compared. The least product of one speaker, and how often
# in a row it must be missed: chosen with scripts/benchmarks/voice_turns.py so that few turns of one speaker are cut.
# The mean of several windows, and pitch beside the embedding, found no more changes at that price (20 dialogues).
_COMPARED, _EVERY, _REFERENCE = 38, 8, 125
_LATEST, _EARLIEST = 18, 54
_LEAST_PRODUCT, _IN_A_ROW = 0.64, 2
_SHORT_PAUSE_S = 0.03


@lru_cache(maxsize=1)
def _filters() -> np.ndarray:
    """Return the weights (bins, BANDS) of triangular filters of equal area on the scale of M. Slaney's Auditory Toolbox
    (Interval Research, report 1998-010): linear up to 1 kHz, logarithmic above."""
    break_mel = _BREAK_HZ / _HZ_PER_MEL
    top = break_mel + np.log(RATE / 2.0 / _BREAK_HZ) / _LOG_STEP
    mels = np.linspace(0.0, top, BANDS + 2)
    edges = np.where(mels < break_mel, mels * _HZ_PER_MEL, _BREAK_HZ * np.exp(_LOG_STEP * (mels - break_mel)))
    places = np.linspace(0.0, RATE / 2.0, WINDOW // 2 + 1)[:, None]
    low, middle, high = edges[:-2], edges[1:-1], edges[2:]
    rising, falling = (places - low) / (middle - low), (high - places) / (high - middle)
    return (np.maximum(0.0, np.minimum(rising, falling)) * 2.0 / (high - low)).astype(np.float32)


def mel_power(samples: np.ndarray) -> np.ndarray:
    """Return the power (T, BANDS) of samples (n,), -1 to 1 at 16 kHz, in T frames; at least one WINDOW of samples."""
    frames = np.lib.stride_tricks.sliding_window_view(np.asarray(samples, np.float32), WINDOW)[::HOP]
    window = (0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(WINDOW) / WINDOW)).astype(np.float32)
    spectrum = scipy.fft.rfft(frames * window, axis=1)
    return np.asarray((spectrum.real ** 2 + spectrum.imag ** 2) @ _filters(), np.float32)


class SpeakerEmbedder:
    """The network, loaded once per process.

    Parameters
    ----------
    path : str or Path
        speaker_embedding.onnx.
    threads, providers, notify
        See OnnxModel.

    Raises
    ------
    ModelError
        When the file is missing, damaged, or another model.
    """

    def __init__(self, path: Union[str, Path], threads: int = 1, providers: Sequence[str] = ("cpu",),
                 notify: Optional[Callable[[str], None]] = None) -> None:
        self._model = OnnxModel(path, providers, threads, ("mel",), ("embedding",), notify)

    def embed(self, sounds: np.ndarray) -> np.ndarray:
        """Return the embeddings (N, DIMENSION), unit vectors with no negative part, of sounds (N, n) of speech: samples
        from -1 to 1 at 16 kHz without pauses, best 1.6 s or more.

        Raises ValueError for sounds that are shorter than a WINDOW.
        """
        sounds = np.asarray(sounds, np.float32)
        if sounds.ndim != 2 or sounds.shape[1] < WINDOW:
            raise ValueError("sounds of the shape {}, wanted is (N, {} or more)".format(sounds.shape, WINDOW))
        level = np.sqrt(np.mean(np.square(sounds), axis=1, keepdims=True) + 1e-12)
        scaled = sounds * (np.float32(10.0 ** (LEVEL_DBFS / 20.0)) / level)
        return self._model.run({"mel": np.stack([mel_power(sound) for sound in scaled])})["embedding"]


class _Frame(NamedTuple):
    """samples: (n,), stamp: s of the first; is_speech: nobody pauses; pause: s without speech right before it."""

    samples: np.ndarray
    stamp: float
    is_speech: bool
    pause: float


class SpeakerChange:
    """Finds in one turn where another speaker goes on: the last 1.2 s of speech are compared with what was said before.

    Parameters
    ----------
    embedder : SpeakerEmbedder
    """

    def __init__(self, embedder: SpeakerEmbedder) -> None:
        self._embedder = embedder
        self.reset()

    def reset(self) -> None:
        """Forget the sound: a turn begins."""
        self._frames: Deque[_Frame] = deque()
        self._spoken = 0      # frames of speech, in the turn and in _frames
        self._kept = 0
        self._pause = 0.0
        self._views: List[Tuple[int, np.ndarray]] = []    # frames of speech up to the end of it, embedding
        self._missed = 0      # times in a row that the product was too small

    def add(self, samples: np.ndarray, stamp: float, is_speech: bool) -> Optional[Tuple[np.ndarray, float]]:
        """Add a frame of the turn (n,); stamp: s. Return the sound (m,) of another speaker with whom it ends, and when
        (s) that begins; None while nothing has changed. After a change the other speaker's turn has begun."""
        self._frames.append(_Frame(samples, stamp, is_speech, self._pause))
        self._pause = 0.0 if is_speech else self._pause + len(samples) / RATE
        if not is_speech:
            return None
        self._spoken += 1
        self._kept += 1
        while self._kept > _EARLIEST:
            self._kept -= self._frames.popleft().is_speech
        if self._spoken < _COMPARED or (self._spoken - _COMPARED) % _EVERY:
            return None
        newest = self._embed()
        self._missed = self._missed + 1 if self._is_other(newest) else 0
        self._views.append((self._spoken, newest))
        return self._divide() if self._missed >= _IN_A_ROW else None

    def _embed(self) -> np.ndarray:
        """Return the embedding of the newest speech."""
        speech = [frame.samples for frame in self._frames if frame.is_speech]
        return self._embedder.embed(np.concatenate(speech[-_COMPARED:])[None])[0]

    def _is_other(self, newest: np.ndarray) -> bool:
        last = self._spoken - _COMPARED
        self._views = [view for view in self._views if view[0] > last - _REFERENCE]
        before = [embedding for end, embedding in self._views if end <= last]
        if not before:
            return False
        mean = np.mean(before, axis=0)
        return float(mean @ newest) < _LEAST_PRODUCT * float(np.linalg.norm(mean))

    def _divide(self) -> Tuple[np.ndarray, float]:
        """Begin the other speaker's turn at the longest pause there, else where it is softest."""
        frames = list(self._frames)
        speech = [index for index, frame in enumerate(frames) if frame.is_speech]
        places = speech[:len(speech) - _LATEST]
        place = max(places, key=lambda index: frames[index].pause)
        if frames[place].pause < _SHORT_PAUSE_S:
            place = min(places[-(_EARLIEST - _LATEST):-_EVERY], key=lambda index: level_dbfs(frames[index].samples))
        rest = frames[place:]
        self.reset()
        for frame in rest:
            self._frames.append(frame)
            self._spoken += frame.is_speech
        self._kept = self._spoken
        return np.concatenate([frame.samples for frame in rest]), rest[0].stamp
