"""From the probability of speech, frame by frame, to `speaking` and to turns. All times are seconds.

Two kinds of activity come out. `speaking` follows the sound: two thresholds (hysteresis) and a short hangover, so that it
says what is heard now. A turn bridges the pauses between words with a long hangover: it holds what somebody says in one
piece, and keeps the voice.

The network reacts softly at the begin of words and goes on for about 0.1 s behind them. The level of the sound helps on
both sides: well above the noise floor a lower probability is enough to begin, and at the level of the noise floor, or far
below what was just said, speech has ended.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import SimpleNamespace

SILENCE_DBFS = -120.0
"""Level of digital silence."""

_FLOOR_LEAST = -90.0
_FALL_TIME = 0.09
_RISE_TIME = 0.6
_NO_SPEECH = 0.2
_LEARN = 0.096
_DRIFT = 0.3
_NOISY_SNR = 8.0
_PEAK_DECAY = 6.0
_TOLERANCE = 1e-6


@dataclass(frozen=True)
class TurnStep:
    """What one frame has changed.

    speaking: somebody is heard speaking; turn: the frame belongs to a turn; onset, end: it is the first, the last one of the turn
    (turn is still True at the end); short: at the end, the turn had less speech than `min_speech`.
    """

    speaking: bool = False
    turn: bool = False
    onset: bool = False
    end: bool = False
    short: bool = False


class NoiseFloor:
    """Level of what is no speech, in dBFS: follows quieter sound within 0.1 s, louder sound that is no speech within 0.6 s.

    While speech is heard it rises by at most 0.3 dB/s: noise that grows under speech is not lost for good. Until 0.1 s without
    speech has been heard it is unknown, and `known` is False: a source may begin in the middle of a word.
    """

    def __init__(self) -> None:
        self.level = math.nan
        self._quiet = 0.0

    @property
    def known(self) -> bool:
        """Tell whether there was enough sound without speech."""
        return self._quiet >= _LEARN - _TOLERANCE

    def update(self, energy: float, probability: float, duration: float) -> float:
        """Add a frame (dBFS, 0..1, s) and return the level."""
        energy = max(energy, _FLOOR_LEAST)
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


def check_thresholds(settings: SimpleNamespace) -> None:
    """Raise ValueError when the thresholds are not in order. settings: the parameters of activity."""
    if not settings.keep_threshold <= settings.clear_birth_threshold <= settings.birth_threshold:
        raise ValueError("keep_threshold {:g}, clear_birth_threshold {:g} and birth_threshold {:g} must be in this"
                         " order".format(settings.keep_threshold, settings.clear_birth_threshold,
                                         settings.birth_threshold))


class SpeechActivity:
    """`speaking`, frame by frame; settings: the parameters of activity (core/voices/voice_stage_parameters.py).

    Raises ValueError when the thresholds are not in order.
    """

    def __init__(self, settings: SimpleNamespace) -> None:
        check_thresholds(settings)
        self._settings = settings
        self.floor = NoiseFloor()
        self.speaking = False
        self.heard = False
        self._above = 0.0
        self._below = 0.0
        self._peak = SILENCE_DBFS

    def update(self, probability: float, energy: float, duration: float) -> bool:
        """Add a frame: probability 0..1, energy in dBFS, length in s. Returns whether somebody is speaking.

        `heard` then tells whether this frame itself was speech, without the hangover.
        """
        floor = self.floor.update(energy, probability, duration)
        if not self.speaking:
            self._try_to_begin(probability, energy, duration, self.birth_threshold(energy - floor if self.floor.known else 0.0))
        self.heard = self.speaking and self._goes_on(probability, energy, floor, duration)
        if self.speaking:
            self._below = 0.0 if self.heard else self._below + duration
            if self._below > self._settings.speaking_hangover + _TOLERANCE:
                self.stop()
        return self.speaking

    def skip(self, duration: float) -> bool:
        """Let time without sound pass; the noise floor stays."""
        self.heard = False
        self._above = 0.0
        self._below += duration
        if self._below > self._settings.speaking_hangover + _TOLERANCE:
            self.stop()
        return self.speaking

    def birth_threshold(self, snr: float) -> float:
        """Return the probability from which speech begins, in a frame so many dB above the noise floor."""
        noisy, clear = self._settings.birth_threshold, self._settings.clear_birth_threshold
        share = min(max((snr - _NOISY_SNR) / (self._settings.clear_snr - _NOISY_SNR), 0.0), 1.0)
        return noisy + share * (clear - noisy)

    def _try_to_begin(self, probability: float, energy: float, duration: float, threshold: float) -> None:
        self._above = self._above + duration if probability >= threshold else 0.0
        if self._above > 0.0 and self._above >= self._settings.onset_time - _TOLERANCE:
            self.speaking = True
            self._below = 0.0
            self._peak = energy

    def _goes_on(self, probability: float, energy: float, floor: float, duration: float) -> bool:
        self._peak = max(self._peak - _PEAK_DECAY * duration, energy)
        least = self._peak - self._settings.level_drop
        if self.floor.known:
            least = max(least, floor + self._settings.noise_margin)
        return probability >= self._settings.keep_threshold and energy >= least

    def stop(self) -> None:
        """Nobody speaks any more; the noise floor stays."""
        self.speaking = False
        self._above = 0.0
        self._below = 0.0


class TurnDetector:
    """Turns of one source. settings: see SpeechActivity."""

    def __init__(self, settings: SimpleNamespace) -> None:
        self._settings = settings
        self.reset()

    def reset(self) -> None:
        """Start afresh, without an end of the running turn and without a noise floor."""
        self.activity = SpeechActivity(self._settings)
        self._turn = False
        self._pause = 0.0
        self._speech = 0.0

    def update(self, probability: float, energy: float, duration: float) -> TurnStep:
        """Add a frame: probability 0..1, energy in dBFS, length in s.

        Raises ValueError when one of them is not a number or the length is not above 0.
        """
        if not (math.isfinite(probability) and math.isfinite(energy) and duration > 0.0):
            raise ValueError("frame of probability {}, energy {} dBFS and length {} s".format(
                probability, energy, duration))
        return self._step(self.activity.update(probability, energy, duration), duration)

    def skip(self, duration: float) -> TurnStep:
        """Let time without sound pass: it is a pause. A duration of 0 or less changes nothing."""
        if not duration > 0.0:
            return TurnStep(speaking=self.activity.speaking, turn=self._turn)
        return self._step(self.activity.skip(duration), duration)

    def cut(self) -> TurnStep:
        """End the running turn, whatever the hangover; the noise floor stays."""
        was_turn, self._turn = self._turn, False
        self.activity.stop()
        return TurnStep(turn=was_turn, end=was_turn, short=was_turn and self._is_short())

    def _is_short(self) -> bool:
        return self._speech < self._settings.min_speech - _TOLERANCE

    def _step(self, speaking: bool, duration: float) -> TurnStep:
        if not self._turn:
            if not speaking:
                return TurnStep()
            # The time until the onset was noticed is speech as well.
            self._speech = max(self._settings.onset_time - duration, 0.0)
        onset, self._turn = not self._turn, True
        heard = self.activity.heard or onset
        self._pause = 0.0 if heard else self._pause + duration
        self._speech += duration if heard else 0.0
        if speaking or self._pause <= self._settings.hangover_time + _TOLERANCE:
            return TurnStep(speaking, turn=True, onset=onset)
        self._turn = False
        return TurnStep(turn=True, end=True, short=self._is_short())
