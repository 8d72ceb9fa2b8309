"""From blocks of sound to voices: who speaks, in turns, with the sound of each voice.

`VoicePipeline.update` is the main road: separation of the sources, voice activity detection, turns, voices. Without an
array of microphones the mean of all channels is the only source; with one, each direction of the separator is a source.
Every source has its own frames, speech activity and turns; the network processes all sources in one batch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Dict, Iterable, List, Optional, Tuple

import numpy as np

from hri_pipeline.core.audio.level import SILENT_DBFS
from hri_pipeline.core.audio.parameters import VoiceActivitySettings
from hri_pipeline.core.audio.speakers import SpeakerChange, SpeakerEmbedder
from hri_pipeline.core.audio.stream import RATE, SoundBlock
from hri_pipeline.core.audio.turns import TurnStep, VoiceSource, VoiceTrack, VoiceTracks, angle_between
from hri_pipeline.core.audio.vad import FRAME_TIME, ActivityModel, band_levels
from hri_pipeline.core.ids import IdGenerator

if TYPE_CHECKING:
    from hri_pipeline.core.audio.separation import SoundSeparator

_MONO = 0
# Differences (s) between the stamp of a block and the end of the last one: back in time, and a gap.
_BACK = 0.1
_GAP = 0.02
# A source of the array without sound for longer than this (s) is silent.
_ABSENT = 0.1
# A separated source lags behind (s), and begins with sound from before.
_LATE = 0.3
_NO_SOUND = np.zeros(0, np.float32)


@dataclass(frozen=True)
class VoiceObservation:
    """One tracked voice in one frame of 32 ms.

    Attributes
    ----------
    id : str
    stamp : float
        s, of the first of `samples`, or of the frame when there are none; of an end without samples: when it ended.
    samples : np.ndarray
        (n,) float32 at 16 kHz, -1 to 1, the sound of this voice: 512 samples in a turn, at its onset preceded by the
        look-back, or by what this speaker has said before another speaker was told; none between turns.
    speaking : bool
        It is heard speaking (short hangover).
    turn : bool
        It has a turn (long hangover).
    probability : float
        Of speech, 0 to 1.
    energy : float
        dBFS, 20 log10 of the root mean square, at least SILENT_DBFS.
    direction : np.ndarray or None
        (3,) unit vector towards the voice, in the microphone frame; None without an array.
    direction_sd : float or None
        rad.
    onset, end : bool
        First and last observation of a turn.
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


class VoicePipeline:
    """Finds the voices in a stream of sound. Not thread-safe.

    Parameters
    ----------
    settings : VoiceActivitySettings
    model : ActivityModel
        May be shared between pipelines.
    array : SoundSeparator, optional
        Of the array of microphones; without one the channels are mixed.
    ids : IdGenerator, optional
        Source of the ids of voices.
    speakers : SpeakerEmbedder, optional
        Without an array, a turn ends where another speaker goes on, too.

    Raises
    ------
    ValueError
        When thresholds in the settings contradict each other.
    """

    def __init__(self, settings: VoiceActivitySettings, model: ActivityModel, array: Optional[SoundSeparator] = None,
                 ids: Optional[IdGenerator] = None, speakers: Optional[SpeakerEmbedder] = None) -> None:
        self._settings = settings
        self._speakers = speakers if array is None else None
        self._model = model
        self._array = array
        self._tracks = VoiceTracks(settings, ids or IdGenerator())
        self._sources: Dict[int, VoiceSource] = {}
        self._end = math.nan
        self._heard = math.nan
        VoiceSource(_MONO, settings)    # checks the settings

    def reconfigure(self, settings: VoiceActivitySettings) -> None:
        """Take up the values of the live parameters."""
        self._settings = settings
        self._tracks.reconfigure(settings)
        for source in self._sources.values():
            source.turns.reconfigure(settings)

    @property
    def tracked(self) -> Tuple[str, ...]:
        """Ids of the voices that are tracked now, oldest first."""
        return self._tracks.tracked

    def update(self, block: SoundBlock) -> List[VoiceObservation]:
        """Add a block of sound and return the new observations, in order of time.

        A gap in the sound is a pause of its length; with an array it also ends the turns. Sound that is more than 0.1 s
        older than expected ends the turns and resets everything.

        Raises
        ------
        ValueError
            When the samples are not (N, C) with at least one channel.
        """
        samples, stamp = _checked(block.samples), float(block.stamp)
        found = self._bridge_gap(stamp)
        self._end = self._heard = stamp + len(samples) / RATE
        found += self._mix(samples, stamp) if self._array is None else self._separate(self._array, samples, stamp)
        ready = self._ready_sources()
        while ready:
            for source, probability in zip(ready, self._speech_probabilities(ready)):
                frame, frame_stamp = source.take(probability)
                step = source.turns.skip(FRAME_TIME) if source.muted else source.turns.update(
                    source.probability, source.energy, FRAME_TIME, band_levels(frame))
                found += self._observe(source, step, frame, frame_stamp)
            ready = self._ready_sources()
        self._expire(self._end - (_LATE if self._array is not None else 0.0))
        return found

    def idle(self, stamp: float) -> List[VoiceObservation]:
        """Note that there has been no sound until `stamp` (s): turns end, voices expire.

        The observations have no samples.
        """
        if math.isnan(self._end) or not stamp > self._end:
            return []
        found = self._silence(self._sources.values(), stamp)
        if self._array is not None:
            # After the reset the separator uses other keys, so the turns cannot continue.
            for source in self._sources.values():
                found += self._cut(source)
            self._sources.clear()
            self._array.reset()
        self._end = stamp
        self._expire(stamp)
        return found

    def reset(self) -> None:
        """Forget all sound and all voices, when time has gone back or the input has changed."""
        self._sources.clear()
        self._tracks.clear()
        self._end = self._heard = math.nan
        if self._array is not None:
            self._array.reset()

    # Steps of update()

    def _bridge_gap(self, stamp: float) -> List[VoiceObservation]:
        """Handle the time between the end of the last block and `stamp` (s)."""
        if math.isnan(self._end):
            return []
        # Compared with the end of the sound, not with idle(): late sound has the stamps that it would have had in time.
        if stamp < self._heard - _BACK:
            found = [seen for source in self._sources.values() for seen in self._cut(source)]
            self.reset()
            return found
        return self.idle(stamp) if stamp > self._end + _GAP else []

    def _mix(self, samples: np.ndarray, stamp: float) -> List[VoiceObservation]:
        """Add the mean of all channels of samples (N, C) to the only source."""
        self._source(_MONO).add(samples[:, 0] if samples.shape[1] == 1 else samples.mean(axis=1), stamp)
        return []

    def _separate(self, array: SoundSeparator, samples: np.ndarray, stamp: float) -> List[VoiceObservation]:
        """Separate samples (N, C) and add them to their sources; end the turns of sources without sound."""
        active = set()
        found: List[VoiceObservation] = []
        for signal in array.process(samples):
            source = self._source(signal.key)
            active.add(signal.key)
            source.direction, source.direction_sd = signal.direction, signal.direction_sd
            missed = source.add(np.asarray(signal.samples, np.float32), stamp + signal.offset / RATE,
                                signal.active, signal.before)
            found += self._pause(source, source.turns.skip(missed), source.clock)
        absent = [source for key, source in self._sources.items() if key not in active]
        return found + self._silence(absent, self._end - _ABSENT)

    def _ready_sources(self) -> List[VoiceSource]:
        """Return the sources with a complete frame."""
        return [source for source in self._sources.values() if source.ready]

    def _speech_probabilities(self, sources: List[VoiceSource]) -> List[float]:
        """Return the probability of speech in the next frame of each source."""
        frames = np.stack([source.waiting for source in sources])
        return self._model.probabilities(frames, [source.state for source in sources]).tolist()

    def _observe(self, source: VoiceSource, step: TurnStep, frame: np.ndarray, stamp: float) -> List[VoiceObservation]:
        """Assign a frame to the voice of its source; return the observations of all voices of this source."""
        if not step.turn:
            source.keep(frame, stamp)
            return self._silent_voices(source, stamp)
        end = stamp + FRAME_TIME
        found: List[VoiceObservation] = []
        if step.onset or source.voice is None:
            found = self._end_lost_turns(source)
            source.voice = self._tracks.begin(source.key, end, source.direction, source.direction_sd,
                                              by_sound=source.speakers is not None)
            frame, stamp = self._begin_turn(source, source.voice, frame, stamp)
        else:
            divided = self._divide_turn(source, step, frame, stamp)
            if divided:
                return divided + self._silent_voices(source, stamp)
            if step.speaking:
                self._tracks.heard(source.voice, end, source.direction, source.direction_sd)
        found.append(_observation(source, source.voice, step, frame, stamp))
        found += self._silent_voices(source, stamp)
        self._end_turn(source, step)
        return found

    def _begin_turn(self, source: VoiceSource, voice: VoiceTrack, frame: np.ndarray, stamp: float
                    ) -> Tuple[np.ndarray, float]:
        """Return the first sound of a turn, with the look-back, and its stamp (s)."""
        sound, first = source.with_look_back(frame, stamp)
        if source.speakers is not None:
            earlier = [other.embeddings for other in self._tracks.earlier(source.key, stamp)]
            source.speakers.begin(voice.embeddings, earlier)
            # Where the turn is an earlier voice's, all of its sound is.
            if earlier and len(sound) > len(frame):
                source.speakers.add(sound[:-len(frame)], first, is_speech=False)
            source.speakers.add(frame, stamp, source.turns.activity.heard)
        return sound, first

    def _divide_turn(self, source: VoiceSource, step: TurnStep, frame: np.ndarray, stamp: float
                     ) -> List[VoiceObservation]:
        """Where another speaker goes on: end the turn there, and begin that of another voice with all its sound."""
        other = None
        if source.speakers is not None and not step.end:
            other = source.speakers.add(frame, stamp, source.turns.activity.heard)
        if other is None or source.voice is None or source.speakers is None:
            return []
        samples, since, embedding = other
        ended = _observation(source, source.voice, source.turns.divide(len(samples) / RATE), _NO_SOUND, since)
        source.voice = self._tracks.begin_other(source.key, stamp + FRAME_TIME, embedding, source.voice, since)
        source.speakers.take_for(source.voice.embeddings)
        return [ended, _observation(source, source.voice, replace(step, onset=True), samples, since)]

    def _expire(self, stamp: float) -> None:
        """Remove voices whose time is over, and sources without sound for longer than a voice is tracked."""
        self._tracks.expire(stamp)
        horizon = stamp - self._settings.voice_timeout
        for key in [key for key, source in self._sources.items() if source.voice is None
                    and source.last_sound < horizon]:
            del self._sources[key]

    # Ends of turns

    def _end_lost_turns(self, source: VoiceSource) -> List[VoiceObservation]:
        """End turns of silent sources in the direction of this one: the separator has lost a speaker and found it
        again."""
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
        return self._pause(source, source.turns.cut(), source.clock)

    def _pause(self, source: VoiceSource, step: TurnStep, stamp: float) -> List[VoiceObservation]:
        """Return the end of a turn, without sound, if this step has ended it."""
        if source.voice is None or not step.end:
            return []
        found = [_observation(source, source.voice, step, _NO_SOUND, stamp)]
        self._end_turn(source, step)
        return found

    def _silence(self, sources: Iterable[VoiceSource], stamp: float) -> List[VoiceObservation]:
        """Note that these sources have had no sound until `stamp` (s)."""
        found: List[VoiceObservation] = []
        for source in sources:
            found += self._pause(source, source.turns.skip(source.skip_to(stamp)), stamp)
        return found

    def _end_turn(self, source: VoiceSource, step: TurnStep) -> None:
        if step.end and source.voice is not None:
            self._tracks.end(source.voice, step.short)
            source.voice = None
            if source.speakers is not None:
                source.speakers.end()

    def _silent_voices(self, source: VoiceSource, stamp: float) -> List[VoiceObservation]:
        """Return an observation of each tracked voice of this source that has no turn."""
        return [VoiceObservation(voice.id, stamp, _NO_SOUND, False, False, source.probability if source.voice is None
                                 else 0.0, source.energy if source.voice is None else SILENT_DBFS,
                                 voice.direction, voice.direction_sd)
                for voice in self._tracks.silent if voice.key == source.key]

    def _source(self, key: int) -> VoiceSource:
        if key not in self._sources:
            self._sources[key] = VoiceSource(key, self._settings,
                                             SpeakerChange(self._speakers) if self._speakers is not None else None)
        return self._sources[key]


def _checked(samples: np.ndarray) -> np.ndarray:
    """Return samples (N, C) as finite float32; raises ValueError for other shapes."""
    samples = np.asarray(samples, np.float32)
    if samples.ndim != 2 or samples.shape[1] == 0:
        raise ValueError("a block of sound has the shape {}, wanted is (samples, channels)".format(samples.shape))
    if np.isfinite(samples).all():
        return samples
    return np.nan_to_num(samples, nan=0.0, posinf=1.0, neginf=-1.0)


def _observation(source: VoiceSource, voice: VoiceTrack, step: TurnStep, samples: np.ndarray,
                 stamp: float) -> VoiceObservation:
    return VoiceObservation(voice.id, stamp, samples, step.speaking, True, source.probability, source.energy,
                            voice.direction, voice.direction_sd, step.onset, step.end)
