"""From blocks of sound to voices: who speaks, in turns, with the sound of each.

Without an array all channels are one source; with one, each direction of the separator is a source. Every source has its own
frames, activity and turns; the network takes all sources at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import SimpleNamespace
from typing import TYPE_CHECKING, Dict, Iterable, List, Optional, Tuple

import numpy as np

from hri_pipeline.core.ids import IdGenerator
from hri_pipeline.core.voices.voice_activity import FRAME_TIME, RATE, ActivityModel
from hri_pipeline.core.voices.voice_lives import Voice, VoiceLives, angle_between
from hri_pipeline.core.voices.voice_source import VoiceSource
from hri_pipeline.core.voices.voice_turns import SILENCE_DBFS, TurnStep

if TYPE_CHECKING:
    from hri_pipeline.core.sound.sound_separation import SoundSeparator
    from hri_pipeline.core.sound.sound_stream import SoundBlock

_MONO = 0
_BACK = 0.1
_GAP = 0.02
_ABSENT = 0.1
_LATE = 0.3
_NO_SOUND = np.zeros(0, np.float32)


@dataclass(frozen=True)
class VoiceObservation:
    """One tracked voice in one frame of 32 ms.

    stamp: s, of the first of `samples`, or of the frame when there are none.
    samples: (n,) float32 at 16 kHz, -1..1, the sound of this voice: 512 in a turn, preceded by the look-back at its onset; none
        while the voice is silent between turns.
    speaking: it is heard speaking (short hangover); turn: it has the word (long hangover).
    probability: of speech, 0..1; energy: dBFS, 20 log10 of the root mean square, -120 at least.
    direction: (3,) unit vector in the microphone frame towards the voice, None without an array; direction_sd: rad.
    onset, end: first and last observation of a turn.
    """

    id: str
    stamp: float
    samples: np.ndarray
    speaking: bool
    turn: bool
    probability: float
    energy: float
    direction: Optional[np.ndarray] = None
    direction_sd: Optional[float] = None
    onset: bool = False
    end: bool = False


class VoiceStage:
    """Voices out of sound. Not safe for several threads.

    settings: the table `voices` (core/voices/voice_stage_parameters.py); model: the activity network, which stages may share;
    array: the separator of an array of microphones, None: the channels are mixed; ids: where the ids of voices come from.
    Raises ValueError when thresholds contradict each other.
    """

    def __init__(self, settings: SimpleNamespace, model: ActivityModel, array: Optional[SoundSeparator] = None,
                 ids: Optional[IdGenerator] = None) -> None:
        self._settings = settings
        self._model = model
        self._array = array
        self._lives = VoiceLives(settings, ids or IdGenerator())
        self._sources: Dict[int, VoiceSource] = {}
        self._end = math.nan
        self._heard = math.nan
        VoiceSource(_MONO, settings)

    @property
    def tracked(self) -> Tuple[str, ...]:
        """Ids of the voices that are tracked now, oldest first."""
        return self._lives.tracked

    def process(self, block: SoundBlock) -> List[VoiceObservation]:
        """Take a block of sound and return what became known, in order of time.

        A gap in the sound is a pause of its length; with an array it also ends the turns. Sound that is more than 0.1 s
        older than expected ends the turns and starts everything afresh. Raises ValueError for samples that are not (N, C).
        """
        samples = np.asarray(block.samples, np.float32)
        if samples.ndim != 2 or samples.shape[1] == 0:
            raise ValueError("a block of sound has the shape {}, wanted is (samples, channels)".format(samples.shape))
        found = self._catch_up(float(block.stamp))
        self._end = self._heard = float(block.stamp) + len(samples) / RATE
        if not np.isfinite(samples).all():
            samples = np.nan_to_num(samples, nan=0.0, posinf=1.0, neginf=-1.0)
        found += self._feed(samples, float(block.stamp))
        while True:
            ready = [source for source in self._sources.values() if source.ready]
            if not ready:
                break
            found += self._frames(ready)
        # A separated source lags behind, and begins with sound from before.
        self._forget(self._end - (_LATE if self._array is not None else 0.0))
        return found

    def idle(self, stamp: float) -> List[VoiceObservation]:
        """Note that no sound has come until `stamp`: turns end, voices are let go. Observations have no samples then."""
        if math.isnan(self._end) or not stamp > self._end:
            return []
        found = self._silence(self._sources.values(), stamp)
        if self._array is not None:
            # Its sources have other keys afterwards: their turns cannot go on.
            for source in self._sources.values():
                found += self._cut(source)
            self._sources.clear()
            self._array.reset()
        self._end = stamp
        self._forget(stamp)
        return found

    def reset(self) -> None:
        """Forget all sound and all voices: time has gone back, or another source is heard."""
        self._sources.clear()
        self._lives.clear()
        self._end = self._heard = math.nan
        if self._array is not None:
            self._array.reset()

    def _catch_up(self, stamp: float) -> List[VoiceObservation]:
        """Bridge the time between the last block and this one."""
        if math.isnan(self._end):
            return []
        # Not by the time that was idled away: sound may come late, with the stamps that it should have had.
        if stamp < self._heard - _BACK:
            found = [seen for source in self._sources.values() for seen in self._cut(source)]
            self.reset()
            return found
        return self.idle(stamp) if stamp > self._end + _GAP else []

    def _feed(self, samples: np.ndarray, stamp: float) -> List[VoiceObservation]:
        """Hand the samples (N, C) to their sources."""
        if self._array is None:
            self._source(_MONO).add(samples[:, 0] if samples.shape[1] == 1 else samples.mean(axis=1), stamp)
            return []
        heard = set()
        found: List[VoiceObservation] = []
        for signal in self._array.process(samples):
            source = self._source(signal.key)
            heard.add(signal.key)
            source.direction, source.direction_sd = signal.direction, signal.direction_sd
            missed = source.add(np.asarray(signal.samples, np.float32), stamp + signal.offset / RATE,
                                signal.active)
            found += self._pass(source, source.turns.skip(missed), source.clock)
        absent = [source for key, source in self._sources.items() if key not in heard]
        return found + self._silence(absent, self._end - _ABSENT)

    def _frames(self, sources: List[VoiceSource]) -> List[VoiceObservation]:
        """Judge the next frame of each of the sources."""
        probabilities = self._model.probabilities(np.stack([source.waiting for source in sources]),
                                                  [source.state for source in sources])
        found: List[VoiceObservation] = []
        for source, probability in zip(sources, probabilities):
            frame, stamp = source.take(float(probability))
            step = source.turns.update(source.probability, source.energy, FRAME_TIME)
            found += self._observe(source, step, frame, stamp)
        return found

    def _observe(self, source: VoiceSource, step: TurnStep, frame: np.ndarray, stamp: float) -> List[VoiceObservation]:
        """Say what a frame of sound means for the voices of its source."""
        if not step.turn:
            source.keep(frame)
            return self._silent_voices(source, stamp)
        end = stamp + FRAME_TIME
        found: List[VoiceObservation] = []
        if step.onset or source.voice is None:
            found = self._take_over(source)
            source.voice = self._lives.begin(source.key, end, source.direction, source.direction_sd)
            frame, stamp = source.with_look_back(frame, stamp)
        elif step.speaking:
            self._lives.heard(source.voice, end, source.direction, source.direction_sd)
        found.append(_observation(source, source.voice, step, frame, stamp))
        found += self._silent_voices(source, stamp)
        self._end_turn(source, step)
        return found

    def _take_over(self, source: VoiceSource) -> List[VoiceObservation]:
        """End the turns of sources that have ceased where this one begins: the separator has lost and found a speaker."""
        found: List[VoiceObservation] = []
        for other in self._sources.values():
            if other is source or other.voice is None or other.last_sound > self._end - _ABSENT:
                continue
            if source.direction is not None and other.direction is not None and angle_between(
                    source.direction, other.direction) <= self._settings.resume_angle:
                found += self._cut(other)
        return found

    def _cut(self, source: VoiceSource) -> List[VoiceObservation]:
        """End the turn of a source now."""
        return self._pass(source, source.turns.cut(), source.clock)

    def _pass(self, source: VoiceSource, step: TurnStep, stamp: float) -> List[VoiceObservation]:
        """Say what time without sound means."""
        if source.voice is None or not step.end:
            return []
        found = [_observation(source, source.voice, step, _NO_SOUND, stamp)]
        self._end_turn(source, step)
        return found

    def _silence(self, sources: Iterable[VoiceSource], stamp: float) -> List[VoiceObservation]:
        found: List[VoiceObservation] = []
        for source in sources:
            found += self._pass(source, source.turns.skip(source.fall_silent(stamp)), stamp)
        return found

    def _end_turn(self, source: VoiceSource, step: TurnStep) -> None:
        if step.end and source.voice is not None:
            self._lives.end(source.voice, step.short)
            source.voice = None

    def _silent_voices(self, source: VoiceSource, stamp: float) -> List[VoiceObservation]:
        return [VoiceObservation(voice.id, stamp, _NO_SOUND, False, False, source.probability if source.voice is None
                                 else 0.0, source.energy if source.voice is None else SILENCE_DBFS,
                                 voice.direction, voice.direction_sd)
                for voice in self._lives.silent if voice.key == source.key]

    def _source(self, key: int) -> VoiceSource:
        if key not in self._sources:
            self._sources[key] = VoiceSource(key, self._settings)
        return self._sources[key]

    def _forget(self, stamp: float) -> None:
        """Let go of voices whose time is over, and of sources whose sound has ceased for longer than a voice is tracked."""
        self._lives.expire(stamp)
        horizon = stamp - self._settings.voice_timeout
        for key in [key for key, source in self._sources.items() if source.voice is None and source.last_sound < horizon]:
            del self._sources[key]


def _observation(source: VoiceSource, voice: Voice, step: TurnStep, samples: np.ndarray,
                 stamp: float) -> VoiceObservation:
    return VoiceObservation(voice.id, stamp, samples, step.speaking, True, source.probability, source.energy,
                            voice.direction, voice.direction_sd, step.onset, step.end)
