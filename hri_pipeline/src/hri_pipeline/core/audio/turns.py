"""Turns of speakers: where a turn begins and ends (`TurnDetector`), the sound of each source (`VoiceSource`), and which
voice speaks (`VoiceTracks`).

`speaking` follows the sound with a short hangover (core/audio/vad.py): it is true while speech is heard. A turn bridges
the pauses between words with a long hangover: it contains one sentence or more, and belongs to one voice. All times are
seconds.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Deque, Dict, List, Optional, Tuple

import numpy as np

from hri_pipeline.core.audio.level import SILENT_DBFS, level_dbfs
from hri_pipeline.core.audio.parameters import VoiceActivitySettings
from hri_pipeline.core.audio.speakers import KEPT_EMBEDDINGS, SpeakerChange, most_alike
from hri_pipeline.core.audio.stream import RATE
from hri_pipeline.core.audio.vad import FRAME, FRAME_TIME, ActivityState, Bands, SpeechActivity
from hri_pipeline.core.ids import IdGenerator

_TOLERANCE = 1e-6
# A difference between stamps above this is missing sound; a longer one restarts the network.
_JUMP = 0.02
_FORGET = 0.5


@dataclass(frozen=True)
class TurnStep:
    """Result of one frame.

    Attributes
    ----------
    speaking : bool
        Somebody is heard speaking.
    turn : bool
        The frame belongs to a turn.
    onset, end : bool
        It is the first or the last frame of the turn (`turn` is still True at the end).
    short : bool
        At the end: the turn had less speech than `min_speech`.
    """

    speaking: bool = False
    turn: bool = False
    onset: bool = False
    end: bool = False
    short: bool = False


class TurnDetector:
    """Finds the turns of one source.

    Parameters
    ----------
    settings : VoiceActivitySettings

    Attributes
    ----------
    activity : SpeechActivity

    Raises
    ------
    ValueError
        When the thresholds are not in ascending order.
    """

    def __init__(self, settings: VoiceActivitySettings) -> None:
        self._settings = settings
        self.reset()

    def reconfigure(self, settings: VoiceActivitySettings) -> None:
        """Take up the values of the live parameters."""
        self._settings = settings
        self.activity.reconfigure(settings)

    def reset(self) -> None:
        """Forget the running turn, without an end, and the noise level."""
        self.activity = SpeechActivity(self._settings)
        self._turn = False
        self._pause = 0.0
        self._speech = 0.0

    def update(self, probability: float, energy: float, duration: float, bands: Optional[Bands] = None) -> TurnStep:
        """Add a frame.

        Parameters
        ----------
        probability : float
            Of speech, 0 to 1.
        energy : float
            dBFS.
        duration : float
            s.
        bands : (float, float), optional
            Of band_levels(), to tell background talk.

        Raises
        ------
        ValueError
            When a value is not finite, or the duration not above 0.
        """
        if not (math.isfinite(probability) and math.isfinite(energy) and duration > 0.0):
            raise ValueError("frame of probability {}, energy {} dBFS and length {} s".format(
                probability, energy, duration))
        return self._step(self.activity.update(probability, energy, duration, bands), duration)

    def skip(self, duration: float) -> TurnStep:
        """Count time (s) without sound as a pause. A duration of 0 or less changes nothing."""
        if not duration > 0.0:
            return TurnStep(speaking=self.activity.speaking, turn=self._turn)
        return self._step(self.activity.skip(duration), duration)

    def cut(self) -> TurnStep:
        """End the running turn now; the noise level stays."""
        was_turn, self._turn = self._turn, False
        self.activity.stop()
        return TurnStep(turn=was_turn, end=was_turn, short=was_turn and self._is_short())

    def divide(self, speech: float) -> TurnStep:
        """End the running turn and begin another one, which has had `speech` (s) already."""
        self._speech = speech
        return TurnStep(turn=True, end=True)

    def _is_short(self) -> bool:
        return self._speech < self._settings.min_speech - _TOLERANCE

    def _step(self, speaking: bool, duration: float) -> TurnStep:
        if not self._turn:
            if not speaking:
                return TurnStep()
            # The time before the onset was detected is speech as well.
            self._speech = max(self._settings.onset_time - duration, 0.0)
        onset, self._turn = not self._turn, True
        heard = self.activity.heard or onset
        self._pause = 0.0 if heard else self._pause + duration
        self._speech += duration if heard else 0.0
        if speaking or self._pause <= self._settings.hangover_time + _TOLERANCE:
            return TurnStep(speaking, turn=True, onset=onset)
        self._turn = False
        return TurnStep(turn=True, end=True, short=self._is_short())


@dataclass
class VoiceTrack:
    """A tracked voice.

    Attributes
    ----------
    id : str
    key : int
        Of the source that it comes from.
    last_word : float
        s, when it was last heard speaking.
    direction : np.ndarray or None
        (3,) unit vector, in the microphone frame.
    direction_sd : float or None
        rad.
    in_turn : bool
        It has a turn now.
    confirmed : bool
        It has had a turn that was not too short.
    first_word : float
        s, when it was heard first.
    embeddings : deque of np.ndarray
        Of its speech, where changes of the speaker are looked for.
    """

    id: str
    key: int
    last_word: float
    direction: Optional[np.ndarray] = None
    direction_sd: Optional[float] = None
    in_turn: bool = True
    confirmed: bool = False
    first_word: float = math.inf
    embeddings: Deque[np.ndarray] = field(default_factory=lambda: deque(maxlen=KEPT_EMBEDDINGS))


class VoiceTracks:
    """The tracked voices and their ids.

    A voice is tracked until `voice_timeout` after its last word. A turn that begins in that time belongs to the same
    voice if it comes from the same source or direction (within `resume_angle`), with an array; without directions, if
    it begins within `resume_time`; where speakers are compared it has to sound like it, and a voice of known sound is
    tracked so long.

    Parameters
    ----------
    settings : VoiceActivitySettings
        With the parameters of these names.
    ids : IdGenerator
        Source of new ids.
    """

    def __init__(self, settings: VoiceActivitySettings, ids: IdGenerator) -> None:
        self._settings = settings
        self._ids = ids
        self._voices: Dict[str, VoiceTrack] = {}

    def reconfigure(self, settings: VoiceActivitySettings) -> None:
        """Take up the values of the live parameters."""
        self._settings = settings

    @property
    def tracked(self) -> Tuple[str, ...]:
        """Ids of the tracked voices, oldest first."""
        return tuple(self._voices)

    @property
    def silent(self) -> List[VoiceTrack]:
        """Tracked voices that are not in a turn."""
        return [voice for voice in self._voices.values() if not voice.in_turn]

    def begin(self, key: int, stamp: float, direction: Optional[np.ndarray] = None,
              direction_sd: Optional[float] = None, by_sound: bool = False) -> VoiceTrack:
        """Return the voice of a turn that begins at `stamp` (s) in source `key`: a tracked one that is silent, or a new
        one. by_sound: a new one, until its sound is compared (earlier, begin_other)."""
        voice = None if by_sound else self._resumed(key, stamp, direction)
        return self._begin(voice, key, stamp, direction, direction_sd)

    def earlier(self, key: int, stamp: float) -> List[VoiceTrack]:
        """Return the silent voices of known sound that may go on in source `key` at `stamp` (s)."""
        return [voice for voice in self._recent(key, stamp) if voice.embeddings]

    def begin_other(self, key: int, stamp: float, embedding: np.ndarray, before: VoiceTrack, since: float
                    ) -> VoiceTrack:
        """Return the voice of a turn, at `stamp` (s), whose speaker is not that of `before`, which has spoken until
        `since` (s): a tracked one that sounds like this embedding, or a new one."""
        before.last_word = min(before.last_word, since)
        others = [voice for voice in self.earlier(key, since) if voice is not before]
        like = most_alike(embedding, [voice.embeddings for voice in others])
        # Nothing is left of a voice whose whole turn was an earlier one's.
        self.end(before, short=like is not None and since <= before.first_word)
        return self._begin(None if like is None else others[like], key, stamp)

    def _begin(self, voice: Optional[VoiceTrack], key: int, stamp: float, direction: Optional[np.ndarray] = None,
               direction_sd: Optional[float] = None) -> VoiceTrack:
        if voice is None:
            voice = VoiceTrack(self._ids.new(), key, stamp, first_word=stamp)
            self._voices[voice.id] = voice
        voice.key, voice.in_turn = key, True
        self.heard(voice, stamp, direction, direction_sd)
        return voice

    def heard(self, voice: VoiceTrack, stamp: float, direction: Optional[np.ndarray],
              direction_sd: Optional[float]) -> None:
        """Note that a voice has spoken until `stamp` (s), and from which direction ((3,) unit; rad)."""
        voice.last_word = max(voice.last_word, stamp)
        if direction is not None:
            voice.direction, voice.direction_sd = direction, direction_sd

    def end(self, voice: VoiceTrack, short: bool) -> None:
        """End the turn of a voice. A voice that has had only short turns (noise) is removed."""
        voice.in_turn = False
        voice.confirmed = voice.confirmed or not short
        if not self._settings.resume_time > 0.0:
            voice.embeddings.clear()
        if not voice.confirmed:
            self._voices.pop(voice.id, None)

    def expire(self, stamp: float) -> None:
        """Remove the voices that are silent at `stamp` (s) for more than their time."""
        for voice in self.silent:
            if stamp - voice.last_word > self._longest_pause(voice):
                del self._voices[voice.id]
                voice.embeddings.clear()        # a turn that may be this voice's holds them, too

    def clear(self) -> None:
        """Remove all voices."""
        self._voices.clear()

    def _recent(self, key: int, stamp: float) -> List[VoiceTrack]:
        """Return the silent voices of source `key` that may go on at `stamp` (s) without a direction."""
        return [voice for voice in self.silent if voice.key == key and stamp - voice.last_word <= min(
            self._settings.resume_time, self._longest_pause(voice))]

    def _longest_pause(self, voice: VoiceTrack) -> float:
        """How long (s) a silent voice is tracked: one of known sound until it cannot go on any more."""
        timeout = self._settings.voice_timeout
        return max(timeout, self._settings.resume_time) if voice.embeddings else timeout

    def _resumed(self, key: int, stamp: float, direction: Optional[np.ndarray]) -> Optional[VoiceTrack]:
        if direction is None:
            recent = self._recent(key, stamp)
            return max(recent, key=lambda voice: voice.last_word) if recent else None
        silent = [voice for voice in self.silent if stamp - voice.last_word <= self._settings.voice_timeout]
        same = [voice for voice in silent if voice.key == key and voice.direction is not None]
        if same:
            return max(same, key=lambda voice: voice.last_word)
        near = [(angle_between(voice.direction, direction), voice) for voice in silent if voice.direction is not None]
        near = [pair for pair in near if pair[0] <= self._settings.resume_angle]
        return min(near, key=lambda pair: pair[0])[1] if near else None


def angle_between(first: np.ndarray, second: np.ndarray) -> float:
    """Return the angle (rad) between two unit vectors (3,)."""
    return math.atan2(float(np.linalg.norm(np.cross(first, second))), float(np.dot(first, second)))


class VoiceSource:
    """The sound of one source in frames of 512 samples, with what its voice activity detection needs.

    Parameters
    ----------
    key : int
        Of the source.
    settings : VoiceActivitySettings
    speakers : SpeakerChange, optional
        Of this source; without it a turn ends by a pause only.

    Attributes
    ----------
    state : ActivityState
    turns : TurnDetector
    voice : VoiceTrack or None
        Whose turn it is, None between turns.
    direction, direction_sd : np.ndarray or None, float or None
        (3,) unit vector and rad, in the microphone frame.
    probability, energy : float
        Of the last frame: probability of speech, and dBFS.
    clock : float
        s, up to which frames were taken or silence was noted.
    last_sound : float
        s, end of its last sound.
    muted : bool
        The last frame is somebody else's sound, hence a pause of this source.
    """

    def __init__(self, key: int, settings: VoiceActivitySettings, speakers: Optional[SpeakerChange] = None) -> None:
        self.key = key
        self.speakers = speakers
        self.state = ActivityState()
        self.turns = TurnDetector(settings)
        self.voice: Optional[VoiceTrack] = None
        self.direction: Optional[np.ndarray] = None
        self.direction_sd: Optional[float] = None
        self.probability = 0.0
        self.energy = SILENT_DBFS
        self.clock = math.nan
        self.last_sound = -math.inf
        self.muted = False
        self._taken = -math.inf
        # How far (s) the stamps of late sound are behind a clock of which each sample takes its time; by that clock,
        # from when on and until when it was heard from its direction.
        self._behind = 0.0
        self._heard_from = self._heard_until = -math.inf
        self._rest = np.zeros(0, np.float32)
        self._look_back = int(round(settings.look_back * RATE))
        self._grace = settings.direction_grace
        self._kept: Deque[Tuple[np.ndarray, float]] = deque(maxlen=-(-self._look_back // FRAME))

    def add(self, samples: np.ndarray, stamp: float, heard: bool = True, before: int = 0) -> float:
        """Add samples.

        An incomplete frame before missing sound is dropped. After a long gap the network is reset. Sound whose stamp is
        before the end of the last one goes on with it: it came late, and its frames stand close together.

        Parameters
        ----------
        samples : np.ndarray
            (n,) at 16 kHz, -1 to 1.
        stamp : float
            s, of the first sample.
        heard : bool
            Whether they came from the direction of the source.
        before : int
            Number of the first samples that are from before the source was heard.

        Returns
        -------
        float
            s of sound that are missing before them.
        """
        expected = self._end() if not math.isnan(self.clock) else stamp
        missing = stamp - expected
        missed = 0.0
        if missing > _JUMP:
            missed = max(stamp - self.clock, 0.0)
            self._rest = self._rest[:0]
            self._kept.clear()
        if abs(missing) > _FORGET:
            self.state.reset()
        clock = max(stamp - len(self._rest) / RATE, self._taken)
        self._behind += self.clock - clock if missing < 0.0 else 0.0
        self.clock = clock
        if before:
            self._heard_from = self._end() + self._behind + before / RATE
        self._rest = np.concatenate((self._rest, samples))
        self.last_sound = self._end()
        if heard:
            self._heard_until = self.last_sound + self._behind
        return missed

    @property
    def ready(self) -> bool:
        """Whether a complete frame is waiting."""
        return len(self._rest) >= FRAME

    @property
    def waiting(self) -> np.ndarray:
        """The next frame, (512,); only when `ready`."""
        return self._rest[:FRAME]

    def take(self, probability: float) -> Tuple[np.ndarray, float]:
        """Remove the next frame, whose probability of speech is given; return its samples (512,) and stamp (s)."""
        frame, stamp = self._rest[:FRAME].copy(), self.clock
        self._rest, self._taken = self._rest[FRAME:], stamp
        self.clock = stamp + FRAME_TIME
        self.probability, self.energy, self.muted = probability, level_dbfs(frame), False
        heard = stamp + self._behind
        if heard > self._heard_until + self._grace or heard + 0.5 * FRAME_TIME < self._heard_from:
            # Speech from another direction, which the beamformer did not suppress completely: no hangover, no sound.
            self.turns.activity.mute(probability, self.energy)
            self.probability, self.energy, self.muted = 0.0, SILENT_DBFS, True
            frame[:] = 0.0
        return frame, stamp

    def keep(self, frame: np.ndarray, stamp: float) -> None:
        """Store a frame without a turn, of time `stamp` (s), for the look-back."""
        self._kept.append((frame, stamp))

    def with_look_back(self, frame: np.ndarray, stamp: float) -> Tuple[np.ndarray, float]:
        """Return the frame preceded by at most `look_back` of stored sound, and the stamp (s) of the first sample."""
        before = np.concatenate([kept for kept, _ in self._kept] + [frame[:0]])
        left_out = max(len(before) - self._look_back, 0)
        first = min(self._kept[0][1] + left_out / RATE, stamp) if self._kept else stamp
        self._kept.clear()
        return np.concatenate((before[left_out:], frame)), first

    def skip_to(self, stamp: float) -> float:
        """Note that there is no sound until `stamp` (s); return the s since the last sound."""
        silence = stamp - self.clock
        if not silence > 0.0:
            return 0.0
        self.clock = stamp
        self._rest = self._rest[:0]
        self._kept.clear()
        if silence > _FORGET:
            self.state.reset()
        self.probability, self.energy = 0.0, SILENT_DBFS
        return silence

    def _end(self) -> float:
        return self.clock + len(self._rest) / RATE
