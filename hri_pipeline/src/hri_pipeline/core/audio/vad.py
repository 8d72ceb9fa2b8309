"""Voice activity detection: the probability of speech (`ActivityModel`), and whether somebody speaks
(`SpeechActivity`).

The network (silero-vad 6.2, MIT) takes frames of 512 samples at 16 kHz, each with the last 64 samples of the frame
before and a recurrent state. It takes several sources as one batch; the rows do not influence each other.

The network reacts slowly at the begin of words, and for about 0.1 s after them it still reports speech. The level of
the sound helps in both cases: well above the noise floor a lower probability is enough to begin, and at the level of
the noise floor, or far below the level of the last words, speech has ended.
"""

from __future__ import annotations

import math
from collections import deque
from pathlib import Path
from typing import Callable, Deque, Optional, Sequence, Tuple, Union

import numpy as np
import scipy.fft

from hri_pipeline.core.audio.level import SILENT_DBFS
from hri_pipeline.core.audio.parameters import VoiceActivitySettings
from hri_pipeline.core.audio.stream import RATE
from hri_pipeline.core.onnx import OnnxModel

FRAME = 512
"""Samples of a frame at RATE, for which the network was trained."""
FRAME_TIME = FRAME / RATE
"""Length of a frame in seconds, 0.032."""

_WINDOW = np.hanning(FRAME).astype(np.float32)
_CONTEXT = 64
_STATE = (2, 128)
_FLOOR_LEAST = -90.0        # dBFS
_FALL_TIME = 0.09           # s
_RISE_TIME = 0.6            # s
_NO_SPEECH = 0.2            # probability
_DOUBT = 0.5                # probability
_LEARN = 0.096              # s
_DRIFT = 0.3                # dB/s
_BABBLE_FRAMES, _EVERY = 250, 31    # 8 s, 1 s
_BABBLE_SPEECH = 0.3        # share of frames
_BABBLE_RANGE = 9.0         # dB
_ABOVE_BABBLE, _BELOW_BABBLE = 2.0, 2.0     # dB: to begin, to go on
_LEAST_BABBLE = 0.3         # share of frames
_IN_FRONT = 3.0             # dB
_IN_FRONT_OF_HUM = 2.0      # dB
_LEAST_PAUSE = 0.1          # share of frames
_LOW_BAND, _HIGH_BAND = slice(5, 20), slice(86, 208)    # 150 to 600 Hz, 2.7 to 6.5 kHz
_NOISY_SNR = 8.0            # dB
_PEAK_DECAY = 6.0           # dB/s
_TOLERANCE = 1e-6           # s


class ActivityState:
    """State of the network for one source: the recurrent state, and the last samples."""

    def __init__(self) -> None:
        self.recurrent = np.zeros(_STATE, np.float32)
        self.context = np.zeros(_CONTEXT, np.float32)

    def reset(self) -> None:
        """Forget the sound so far."""
        self.recurrent = np.zeros(_STATE, np.float32)
        self.context = np.zeros(_CONTEXT, np.float32)


class ActivityModel:
    """The network, loaded once per process; every source has its own ActivityState.

    Parameters
    ----------
    path : str or Path
        silero_vad.onnx.
    notify
        See OnnxModel.

    Raises
    ------
    ModelError
        When the file is missing, damaged, or another model. The text names the file and how to correct it.
    """

    def __init__(self, path: Union[str, Path], notify: Optional[Callable[[str], None]] = None) -> None:
        self._model = OnnxModel(path, inputs=("input", "state", "sr"), outputs=("output", "stateN"), notify=notify)
        self._rate = np.array(RATE, np.int64)
        # A network of another release fails here, instead of at the first sound.
        self.probabilities(np.zeros((1, FRAME), np.float32), [ActivityState()])

    def probabilities(self, frames: np.ndarray, states: Sequence[ActivityState]) -> np.ndarray:
        """Return the probability of speech (S,) in one frame of each source, and update the states.

        Parameters
        ----------
        frames : np.ndarray
            (S, FRAME) samples, -1 to 1, one row per source. NaN counts as 0.
        states : sequence of ActivityState
            S states, in the same order.

        Raises
        ------
        ValueError
            For other shapes.
        """
        frames = np.asarray(frames, np.float32)
        if frames.ndim != 2 or frames.shape != (len(states), FRAME):
            raise ValueError("frames have the shape {}, wanted are {} frames of {} samples".format(
                frames.shape, len(states), FRAME))
        if not len(states):
            return np.zeros(0)
        # The state is recurrent: after one NaN every probability of this source would be NaN.
        if not np.isfinite(frames).all():
            frames = np.nan_to_num(frames, nan=0.0, posinf=1.0, neginf=-1.0)
        context = np.stack([state.context for state in states])
        recurrent = np.stack([state.recurrent for state in states], axis=1)
        found = self._model.run({"input": np.concatenate((context, frames), axis=1), "state": recurrent,
                                 "sr": self._rate})
        for row, state in enumerate(states):
            state.recurrent = found["stateN"][:, row].copy()
            state.context = frames[row, -_CONTEXT:].copy()
        return found["output"][:, 0].astype(np.float64)


Bands = Tuple[float, float]


def band_levels(frame: np.ndarray) -> Bands:
    """Return the levels (dB) of a frame (FRAME,) at 150 to 600 Hz and at 2.7 to 6.5 kHz."""
    spectrum = scipy.fft.rfft(np.asarray(frame, np.float32) * _WINDOW)
    power = spectrum.real ** 2 + spectrum.imag ** 2
    low, high = 10.0 * np.log10(np.array([power[_LOW_BAND].sum(), power[_HIGH_BAND].sum()]) + 1e-9)
    return float(low), float(high)


class NoiseLevel:
    """Level of the background noise of one source, in dBFS.

    It follows quieter sound within 0.1 s, and louder sound without speech within 0.6 s. During speech it rises by at
    most 0.3 dB/s, so that it recovers when noise grows during speech. A source may begin in the middle of a word: the
    level is unknown (`known` is False) until 0.1 s without speech has been heard.

    People in the background are noise as well. The level of one speaker changes by more than 9 dB at low frequencies,
    even in noise, which is steady at high ones; that of several at once changes by less, and by more at high
    frequencies. While that is so in the last 8 s, without what is louder, the level is that of their loudest tenth.
    Sound that is louder where it is taken for speech is somebody in front of the others, or of a hum or a fan.

    Attributes
    ----------
    level : float
        dBFS, NaN before the first frame.
    is_babble : bool
        The noise is background talk.
    """

    def __init__(self) -> None:
        self.level = math.nan
        self.is_babble = False
        self._quiet = 0.0
        self._smooth: Optional[np.ndarray] = None
        self._recent: Deque[np.ndarray] = deque(maxlen=_BABBLE_FRAMES)
        self._frames = 0

    @property
    def known(self) -> bool:
        """Whether there was enough sound without speech."""
        return self._quiet >= _LEARN - _TOLERANCE

    @property
    def is_above_babble(self) -> bool:
        """Whether the last 0.1 s is louder than the background talk."""
        return self._smooth is not None and float(self._smooth[0]) >= self.level + _ABOVE_BABBLE

    def update(self, energy: float, probability: float, duration: float, bands: Optional[Bands] = None) -> float:
        """Add a frame with this energy (dBFS), probability of speech and duration (s); return the level (dBFS).

        bands: levels (dB) at low and at high frequencies; without them there is no background talk.
        """
        energy = max(energy, _FLOOR_LEAST)
        if bands is not None:
            self._follow_babble(np.array([energy, *bands, probability]))
        if self.is_babble:
            return self.level
        if probability < _NO_SPEECH and not self.known:
            self._quiet += duration
        if math.isnan(self.level):
            self.level = energy
        elif energy < self.level:
            self.level += (energy - self.level) * -math.expm1(-duration / _FALL_TIME)
        elif probability < _NO_SPEECH:
            self.level += (energy - self.level) * -math.expm1(-duration / _RISE_TIME)
        else:
            self.level += min(energy - self.level, _DRIFT * duration)
        return self.level

    def _follow_babble(self, frame: np.ndarray) -> None:
        """frame: energy, levels of the bands, probability of speech."""
        self._smooth = frame if self._smooth is None else self._smooth + (frame - self._smooth) / 3.0
        self._recent.append(np.append(self._smooth[:3], frame[3]))
        self._frames += 1
        if self._frames % _EVERY or len(self._recent) < _BABBLE_FRAMES:
            return
        recent = np.array(self._recent)
        is_talk = float((recent[:, 3] >= _NO_SPEECH).mean()) >= _BABBLE_SPEECH
        if not (is_talk and self._take_babble(recent)) and self.is_babble:
            rest = recent[recent[:, 0] < self.level + _ABOVE_BABBLE]
            self.is_babble = len(rest) >= _LEAST_BABBLE * len(recent) and self._take_babble(rest)

    def _take_babble(self, recent: np.ndarray) -> bool:
        """Tell whether these frames are several speakers at once, and take their level if so."""
        least, most = np.percentile(recent[:, :3], (10.0, 90.0), axis=0)
        low, high = (most - least)[1:]
        if not (low < _BABBLE_RANGE and low < high) or _is_somebody_in_front(recent):
            return False
        self.level, self.is_babble = float(most[0]), True
        return True


def _is_somebody_in_front(recent: np.ndarray) -> bool:
    """Tell whether the frames (N, 4) of energy, bands and probability are louder where they are taken for speech:
    frames of talk that only sometimes sounds like a voice are about equally loud, within 1 dB at all frequencies. A hum
    or a fan may be as loud as one speaker; then the bands tell more than the energy."""
    is_speech = recent[:, 3] >= _NO_SPEECH
    if not _LEAST_PAUSE <= 1.0 - float(is_speech.mean()) < 1.0:
        return False
    louder = recent[is_speech, :3].mean(axis=0) - recent[~is_speech, :3].mean(axis=0)
    return bool(louder[0] >= _IN_FRONT or louder.mean() >= _IN_FRONT_OF_HUM)


def check_thresholds(settings: VoiceActivitySettings) -> None:
    """Raise ValueError when the thresholds in `settings` are not in ascending order."""
    if not settings.keep_threshold <= settings.clear_birth_threshold <= settings.birth_threshold:
        raise ValueError("keep_threshold {:g}, clear_birth_threshold {:g} and birth_threshold {:g} must be in this"
                         " order".format(settings.keep_threshold, settings.clear_birth_threshold,
                                         settings.birth_threshold))


class SpeechActivity:
    """Decides frame by frame whether somebody speaks: two thresholds (hysteresis) and a short hangover.

    Parameters
    ----------
    settings : VoiceActivitySettings

    Attributes
    ----------
    noise : NoiseLevel
    speaking : bool
    heard : bool
        Whether the last frame itself was speech, without the hangover.

    Raises
    ------
    ValueError
        When the thresholds are not in ascending order.
    """

    def __init__(self, settings: VoiceActivitySettings) -> None:
        check_thresholds(settings)
        self._settings = settings
        self.noise = NoiseLevel()
        self.speaking = False
        self.heard = False
        self._above = 0.0
        self._below = 0.0
        self._peak = SILENT_DBFS

    def reconfigure(self, settings: VoiceActivitySettings) -> None:
        """Take up the values of the live parameters."""
        self._settings = settings

    def update(self, probability: float, energy: float, duration: float, bands: Optional[Bands] = None) -> bool:
        """Add a frame with this probability, energy (dBFS) and duration (s), and the levels (dB) of band_levels();
        return whether somebody speaks."""
        floor = self.noise.update(energy, probability, duration, bands)
        if not self.speaking:
            self._try_to_begin(probability, energy, duration,
                               self.birth_threshold(energy - floor if self.noise.known else 0.0))
        self.heard = self.speaking and self._goes_on(probability, energy, floor, duration)
        if self.speaking:
            self._below = 0.0 if self.heard else self._below + duration
            # Sudden silence that the network doubts as well needs no hangover.
            is_clear = not self.heard and probability < _DOUBT and energy < self._peak - self._settings.level_drop
            if is_clear or self._below > self._settings.speaking_hangover + _TOLERANCE:
                self.stop()
        return self.speaking

    def skip(self, duration: float) -> bool:
        """Count time (s) without sound as a pause; the noise level stays. Return whether somebody speaks."""
        self.heard = False
        self._above = 0.0
        self._below += duration
        if self._below > self._settings.speaking_hangover + _TOLERANCE:
            self.stop()
        return self.speaking

    def birth_threshold(self, snr: float) -> float:
        """Return the probability from which speech begins in a frame that is `snr` dB above the noise."""
        noisy, clear = self._settings.birth_threshold, self._settings.clear_birth_threshold
        share = min(max((snr - _NOISY_SNR) / (self._settings.clear_snr - _NOISY_SNR), 0.0), 1.0)
        return noisy + share * (clear - noisy)

    def _try_to_begin(self, probability: float, energy: float, duration: float, threshold: float) -> None:
        if self.noise.is_babble and not self.noise.is_above_babble:
            probability = 0.0
        self._above = self._above + duration if probability >= threshold else 0.0
        if self._above > 0.0 and self._above >= self._settings.onset_time - _TOLERANCE:
            self.speaking = True
            self._below = 0.0
            self._peak = energy

    def _goes_on(self, probability: float, energy: float, floor: float, duration: float) -> bool:
        self._peak = max(self._peak - _PEAK_DECAY * duration, energy)
        least = self._peak - self._settings.level_drop
        if self.noise.known or self.noise.is_babble:
            below = _BELOW_BABBLE if self.noise.is_babble else 0.0
            least = max(least, floor - below + self._settings.noise_margin)
        return probability >= self._settings.keep_threshold and energy >= least

    def mute(self, probability: float, energy: float) -> None:
        """End the speech now, at a frame of somebody else's sound: the noise is what is no speech (probability) in
        it."""
        self.noise.update(energy, probability, FRAME_TIME)
        self.stop()

    def stop(self) -> None:
        """End the speech now; the noise level stays."""
        self.speaking = False
        self._above = 0.0
        self._below = 0.0
