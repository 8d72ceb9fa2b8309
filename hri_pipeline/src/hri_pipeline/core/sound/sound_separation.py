"""Who sounds from where, each by itself: directions found, followed, and filtered out of the sound of a microphone array.

Frames of 32 ms every 16 ms: a sample comes out when the frame after its own is complete, 16 to 32 ms after it came in. The
filters have no delay of their own: sample i of the output is what was heard at sample i of the input.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Deque, Dict, List, NamedTuple, Optional

import numpy as np

from hri_pipeline.core.parameters import ParameterTable
from hri_pipeline.core.sound.beamformer import SourceBeamformers
from hri_pipeline.core.sound.direction_tracker import DirectionTracker, Source
from hri_pipeline.core.sound.microphone_array import MicrophoneArray
from hri_pipeline.core.sound.noise_floor import NoiseFloor
from hri_pipeline.core.sound.sound_array_parameters import SOUND_ARRAY_PARAMETERS
from hri_pipeline.core.sound.sound_direction import DirectionFinder
from hri_pipeline.core.sound.sound_spectra import BINS, FRAME, HOP, RATE, FrameSplitter, OverlapAdd, mean_power

TRACK_EVERY = 2
"""Sources are followed from every second frame (32 ms) to the next."""


@dataclass(frozen=True)
class SourceSignal:
    """What one direction sounded like in the sound handed in lately.

    key: stays with one direction, and is given to no other one. samples: (n,) float32, 16 kHz, n a multiple of 256.
    offset: where samples[0] lies relative to the first sample of the block that was handed in: its stamp is that of
    the block + offset / 16000. direction: (3,) unit, from the microphones to the source, in the microphone frame;
    None when it cannot be told (see `line_front`). direction_sd: rad. active: the direction was heard within the last
    0.1 s; whether that was speech is not asked here.
    """

    key: int
    samples: np.ndarray
    offset: int
    direction: Optional[np.ndarray]
    direction_sd: float
    active: bool


class _Frame(NamedTuple):
    index: int
    spectrum: np.ndarray
    noise: np.ndarray


class _Output:
    """The signal of one source since it was last listened to."""

    def __init__(self, begin: int) -> None:
        self.begin = self.next = begin
        self.parts: List[np.ndarray] = []
        self._overlap = OverlapAdd()

    def add(self, spectrum: np.ndarray) -> None:
        self.parts.append(self._overlap.add(spectrum))
        self.next += 1

    def take(self) -> np.ndarray:
        samples = np.concatenate(self.parts)
        self.parts = []
        self.begin = self.next
        return samples


class SoundSeparator:
    """Separates the sources in the sound of a microphone array. Its output does not depend on how sound is cut into blocks.

    A new source is confirmed after some tenths of a second; its first signal reaches back by `source_look_back`.
    A source that falls silent is dropped from the output after `source_hold_time` and comes back under the same key,
    again with what was said shortly before, until `source_memory` has passed. A key can be there twice in one result when
    the block was so long that its source fell silent and came back within.
    """

    latency = FRAME / RATE
    """Largest time (s) by which the output is behind the input."""

    def __init__(self, positions: np.ndarray, settings: Optional[SimpleNamespace] = None) -> None:
        """positions: (C, 3) m in the microphone frame. settings: holds SOUND_ARRAY_PARAMETERS, None for the defaults.

        Raises ParameterError for positions that are none of an array.
        """
        settings = settings or ParameterTable("array", "Defaults.", SOUND_ARRAY_PARAMETERS).resolve({})
        self.array = MicrophoneArray(positions)
        self._settings = settings
        self._splitter = FrameSplitter(self.array.channels)
        self._floor = NoiseFloor(BINS, self.array.channels)
        self._finder = DirectionFinder(self.array, settings.max_sources)
        self._tracker = DirectionTracker(settings.source_birth_time, settings.source_memory, settings.max_sources)
        self._beamformers = SourceBeamformers(self.array)
        self._recent: Deque[_Frame] = deque(maxlen=int(math.ceil(settings.source_look_back * RATE / HOP)))
        self._outputs: Dict[int, _Output] = {}
        self.reset()

    def reset(self) -> None:
        """Begin anew: after a gap in the sound, or when time jumps. Keys are not given again."""
        for part in (self._splitter, self._floor, self._finder, self._tracker, self._beamformers):
            part.reset()
        self._recent.clear()
        self._outputs.clear()
        self._ended: Dict[int, int] = {}
        self._finished: List[SourceSignal] = []
        self._sources: List[Source] = []
        self._frame = 0
        self._heard = 0

    @property
    def sources(self) -> List[Source]:
        """All directions that are remembered, oldest first, silent ones as well."""
        return list(self._sources)

    def process(self, samples: np.ndarray) -> List[SourceSignal]:
        """Take the next samples (N, C) in, of any N; returns what can be told of each source that is listened to.

        A sample that is not finite counts as 0. Raises ValueError for sound of another number of channels.
        """
        samples = np.asarray(samples, dtype=np.float32)
        if samples.ndim != 2 or samples.shape[1] != self.array.channels:
            raise ValueError("sound of shape {} does not suit an array of {} microphones; hand in (N, {})".format(
                samples.shape, self.array.channels, self.array.channels))
        if not np.isfinite(samples).all():
            samples = np.nan_to_num(samples, nan=0.0, posinf=0.0, neginf=0.0)
        first = self._heard
        self._heard += len(samples)
        for spectrum in self._splitter.split(samples):
            self._process_frame(spectrum, first)
        sources = {source.key: source for source in self._sources}
        signals = self._finished + [self._signal(sources[key], output, first)
                                    for key, output in self._outputs.items() if output.parts]
        self._finished = []
        return signals

    def _process_frame(self, spectrum: np.ndarray, first: int) -> None:
        sure = self._floor.update(mean_power(spectrum))
        self._finder.add(spectrum, sure)
        if self._frame % TRACK_EVERY == 0:
            self._follow(first)
        frame = _Frame(self._frame, spectrum, self._floor.power)
        if self._outputs:
            self._separate(frame)
        self._recent.append(frame)
        self._frame += 1

    def _separate(self, frame: _Frame) -> None:
        for key, found in self._beamformers.separate(frame.spectrum, frame.noise).items():
            if self._outputs[key].next == frame.index:
                self._outputs[key].add(found)

    def _follow(self, first: int) -> None:
        """Find out who is there, and begin or end to listen to them."""
        stamp = self._frame * HOP / RATE
        before = {source.key: source for source in self._sources}
        self._sources = self._tracker.update(self._finder.peaks(), stamp)
        heard = {source.key: source.direction for source in self._sources
                 if stamp - source.heard_at <= self._settings.source_hold_time}
        for key in [key for key in self._outputs if key not in heard]:
            output = self._outputs.pop(key)
            self._ended[key] = output.next
            if output.parts:
                self._finished.append(self._signal(before[key], output, first))
        remembered = {source.key for source in self._sources}
        self._ended = {key: end for key, end in self._ended.items() if key in remembered}
        self._beamformers.aim(heard)
        new = [key for key in heard if key not in self._outputs]
        if new:
            self._begin(new)

    def _begin(self, keys: List[int]) -> None:
        """Listen to sources from as far back as sound is kept; their filters learn from it as well."""
        oldest = self._recent[0].index if self._recent else self._frame
        for key in keys:
            self._outputs[key] = _Output(max(oldest, self._ended.get(key, 0)))
        for frame in self._recent:
            if frame.index >= min(self._outputs[key].begin for key in keys):
                self._separate(frame)

    def _signal(self, source: Source, output: _Output, first: int) -> SourceSignal:
        begin = output.begin * HOP
        told = self.array.shape != "line" or self._settings.line_front
        return SourceSignal(source.key, output.take(), begin - first, source.direction if told else None,
                            source.sd, source.active)
