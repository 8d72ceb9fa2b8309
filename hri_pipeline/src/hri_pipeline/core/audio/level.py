"""Level of a sound in dBFS, and what is wrong with it: clipping, an offset, channels that are dead, silent, inverted or
copies. What can be put right is: an offset, and channels that would cancel each other."""

from __future__ import annotations

import math
from collections import deque
from typing import Deque, Dict, List, Optional, Sequence, Tuple

import numpy as np

SILENT_DBFS = -120.0
"""Level of digital silence, and the lowest level that is returned."""
WINDOW_S = 10.0
_PIECE_S = 0.1
_LEVEL_PIECES = 10
_LIMIT = 0.999
"""Samples of this size or more are at the limit of their format."""
_CLIPPED_SHARE = 1e-3
# Sound that was clipped and then made softer has many samples in a row at its own peak: in the last 0.2 % of it, _FLAT
# times as many as in the 0.8 % below (a low sine wave has 0.8 times as many, speech fewer).
_TOP, _BELOW_TOP, _FLAT, _FLAT_PIECES, _LEAST_FLAT = 0.998, 0.99, 4.0, 3, 0.02
_OFFSET = 0.05
_CONSTANT_S = 2.0
# Microphones of one array differ by some dB; one that is covered or broken lies below the median by more than this.
_SILENT_DB = 25.0
# Two channels are one and the same where this share of their power differs. Microphones 2 cm apart differ by more above
# 10 Hz, rounding to 16 bits by less above -80 dBFS.
_SAME_SHARE = 1e-5
_LEAST_POWER = 1e-8
# An offset is taken from the sound from here on: half a step of 8 bits. The median of 2 s leaves bangs alone.
_LEAST_OFFSET, _OFFSET_PIECES, _FIRST_PIECES = 0.002, 20, 5
# Correlations of the last second at which a channel is turned over, and turned back: one plug of a balanced microphone
# in a stereo socket gives -1, microphones in different places hardly less than 0 but for a tone. In sound so many times
# as strong as the pauses, a channel that was turned over by a tone is turned back sooner.
_OPPOSED, _AGREED, _OPPOSED_PIECES, _NOT_OPPOSED, _LOUD = -0.7, 0.3, 10, -0.5, 10.0
# A microphone of an array hears nothing but its own noise where it is less like all others than this, louder than most,
# and each of those is more alike than that to another.
_UNLIKE, _ALIKE = 0.2, 0.5
# The quietest pieces are pauses of speech, as in minimum statistics (R. Martin, IEEE Trans. SAP 9(5), 2001).
_FLOOR_PERCENTILE = 10.0


def dbfs(rms: float) -> float:
    """Return a root mean square (1: full scale) in dBFS, at least SILENT_DBFS."""
    return max(SILENT_DBFS, 20.0 * float(np.log10(max(float(rms), 1e-9))))


def level_dbfs(samples: np.ndarray) -> float:
    """Return the level (dBFS) of samples (n,), -1 to 1: 20 log10 of their root mean square, at least SILENT_DBFS."""
    exact = samples.astype(np.float64)
    power = float(exact @ exact) / len(samples) if len(samples) else 0.0
    return max(10.0 * math.log10(power), SILENT_DBFS) if power > 0.0 else SILENT_DBFS


class _Piece:
    """Sums per channel over 0.1 s of sound (N, C). `power` is the mean over time and channels; of the slopes where the
    channels are `mixed`."""

    def __init__(self, samples: np.ndarray, mixed: bool) -> None:
        self.count = len(samples)
        self.products = (samples.T @ samples).astype(np.float64)
        self.squares = self.products.diagonal()
        self.sums = samples.sum(axis=0, dtype=np.float64)
        self.lowest = samples.min(axis=0)
        self.highest = samples.max(axis=0)
        self.power = float(self.squares.mean()) / self.count
        self.peak = max(-float(self.lowest.min()), float(self.highest.max()))
        at_limit = np.abs(samples) >= _LIMIT if self.peak >= _LIMIT else np.zeros((0, len(self.sums)), bool)
        self.clipped_of = at_limit.sum(axis=0)
        self.clipped = int(at_limit.any(axis=1).sum())
        size = np.abs(samples)
        self.largest = size.max(axis=0)
        top = size >= _TOP * self.largest
        self.below_peak = (size >= _BELOW_TOP * self.largest).sum(axis=0) - top.sum(axis=0)
        self.at_peak = (top[1:-1] & top[:-2] & top[2:]).sum(axis=0)
        # Of the slope, in which neither an offset nor a hum counts.
        slope = np.diff(samples, axis=0) if mixed else samples[:0]
        self.slopes = (slope.T @ slope).astype(np.float64)
        self.slope_power = float(self.slopes.trace())


class SoundLevel:
    """Level, peak, noise floor, clipping and offset of the last WINDOW_S of a stream.

    Sound is measured in pieces of 0.1 s, because each measurement has a fixed cost and messages may be short.

    Parameters
    ----------
    rate : int
        Hz.
    channels : int
    numbers : sequence of int, optional
        Numbers of the channels in the stream, for texts; by default they count from 0.
    total : int, optional
        Number of channels in the stream, with `numbers`.
    is_array : bool
        Channels are microphones of an array, which must differ: copies are a problem.
    """

    def __init__(self, rate: int, channels: int, numbers: Optional[Sequence[int]] = None, total: int = 0,
                 is_array: bool = False) -> None:
        self._size = max(1, int(rate * _PIECE_S))
        self._channels = channels
        self._numbers = list(range(channels) if numbers is None else numbers)
        self._total = total or channels
        self._is_array = is_array
        self._pieces: Deque[_Piece] = deque(maxlen=int(WINDOW_S / _PIECE_S))
        self._waiting: List[np.ndarray] = []
        self._held = 0
        self._signs = np.ones(channels, np.float32)
        self._offset = np.zeros(channels, np.float32)
        self._subtracted = self._offset
        # Of broken microphones: the pieces for which they still count as that.
        self._faults: Dict[int, int] = {}
        self._fresh = 0
        self.clipped = 0

    @property
    def broken(self) -> Tuple[int, ...]:
        """Indices of the microphones of an array that are dead, silent or hear noise alone, now or within WINDOW_S."""
        return tuple(sorted(self._faults))

    def add(self, samples: np.ndarray) -> None:
        """Add samples (N, C), -1 to 1."""
        self._waiting.append(samples)
        self._held += len(samples)
        if self._held < self._size:
            return
        sound = np.concatenate(self._waiting)
        whole, mixed = len(sound) // self._size * self._size, self._channels > 1 and not self._is_array
        for start in range(0, whole, self._size):
            self._pieces.append(_Piece(sound[start:start + self._size], mixed))
            self.clipped += self._pieces[-1].clipped
        # A copy, because a view would keep all of the sound in memory.
        self._waiting, self._held = [sound[whole:].copy()], len(sound) - whole
        self._find_offset()
        if self._is_array:
            self._find_broken(whole // self._size)
        elif mixed:
            self._find_signs()

    def corrected(self, samples: np.ndarray) -> np.ndarray:
        """Return samples (N, C), which were added, without their offset, and in phase if the channels are mixed."""
        before, self._subtracted = self._subtracted, self._offset
        if before is not self._offset:
            # In a ramp, which does not click.
            steps = np.linspace(0.0, 1.0, len(samples), dtype=np.float32)[:, None]
            samples = samples - (before + steps * (self._offset - before))
        elif self._offset.any():
            samples = samples - self._offset
        return samples * self._signs if self._signs.min() < 0.0 else samples

    def _find_offset(self) -> None:
        last = list(self._pieces)[-_OFFSET_PIECES:]
        newest = last[-1].sums / last[-1].count if last else self._offset
        if len(last) < _FIRST_PIECES or (np.abs(newest - self._offset) < _LEAST_OFFSET).all():
            return
        found = np.median([piece.sums / piece.count for piece in last], axis=0)
        found[np.abs(found) < _LEAST_OFFSET] = 0.0
        if (np.abs(found - self._offset) >= _LEAST_OFFSET).any():
            self._offset = found.astype(np.float32)

    def _find_broken(self, fresh: int) -> None:
        """Note once a second which microphones are broken, after `fresh` new pieces; one is that until it has worked
        for WINDOW_S."""
        self._fresh += fresh
        if self._fresh < _LEVEL_PIECES:
            return
        fresh, self._fresh = self._fresh, 0
        pieces = list(self._pieces)
        found, constant = set(self._silent(pieces) + self._noisy(pieces)), self._constant(pieces)
        if len(constant) < self._channels:
            # In silence of less than a step of 16 bits some microphones change and some do not.
            is_heard = max(piece.power for piece in pieces[-_LEVEL_PIECES:]) >= _LEAST_POWER
            found.update(index for index in constant if is_heard or index in self._faults)
        left = {index: left - fresh for index, left in self._faults.items() if left > fresh}
        self._faults = {**left, **{index: self._pieces.maxlen or 0 for index in found}}

    def _find_signs(self) -> None:
        """Turn channels over that would cancel the loudest one."""
        products = np.sum([piece.slopes for piece in list(self._pieces)[-_OPPOSED_PIECES:]], axis=0)
        power = np.maximum(products.diagonal(), 1e-30)
        loudest = int(np.argmax(power))
        alike = products[loudest] / np.sqrt(power * power[loudest])
        sign = self._signs[loudest]
        agreed = _NOT_OPPOSED if self._signs.min() < 0.0 and self._is_loud() else _AGREED
        self._signs = np.where(alike < _OPPOSED, -sign, np.where(alike > agreed, sign, self._signs)).astype(np.float32)

    def _is_loud(self) -> bool:
        """Tell whether the last second is louder than the pauses, but for a hum."""
        power = [piece.slope_power for piece in self._pieces]
        pauses = sorted(power)[int(0.01 * _FLOOR_PERCENTILE * len(power))]      # np.percentile takes .1 % of a core
        return sum(power[-_OPPOSED_PIECES:]) > _LOUD * _OPPOSED_PIECES * pauses

    def values(self) -> Dict[str, object]:
        """Return the values for diagnostics: levels in dBFS, shares in percent."""
        pieces = list(self._pieces)
        if not pieces:
            return {}
        count = sum(piece.count for piece in pieces)
        recent = pieces[-_LEVEL_PIECES:]
        level = np.sqrt(sum(piece.squares for piece in recent) / sum(piece.count for piece in recent))
        floors = np.sqrt([piece.power for piece in pieces])
        peak = max(piece.peak for piece in recent)
        offset = np.sum([piece.sums for piece in pieces], axis=0) / count
        return {
            "level_dbfs": dbfs(np.sqrt(np.mean(np.square(level)))), "peak_dbfs": dbfs(peak),
            "noise_floor_dbfs": dbfs(np.percentile(floors, _FLOOR_PERCENTILE)),
            "clipped_percent": 100.0 * self._clipped_share(pieces),
            "dc_percent": 100.0 * float(offset[np.argmax(np.abs(offset))]),
            "clipped_samples": self.clipped,
        }

    def problem(self) -> str:
        """Return what is wrong with the sound and how to correct it, empty when nothing is."""
        pieces = list(self._pieces)
        constant = self._constant(pieces)
        if len(constant) == self._channels:
            return "the sound is dead silence, {:.0f} s of one and the same value; is the microphone muted, or the " \
                   "wrong device chosen?".format(_CONSTANT_S)
        share = self._clipped_share(pieces)
        if share > _CLIPPED_SHARE:
            return "the sound is clipped: {:.1f} % of its samples are at the limit{}; turn the microphone's gain " \
                   "down".format(100.0 * share, self._clipped_channels(pieces))
        flat = [index for index in self._flattened(pieces) if index not in constant]
        if flat:
            return "{} clipped at {:.0f} % of full scale, before the sound comes here; turn the gain down at the " \
                   "microphone".format(self._named(flat), 100.0 * max(float(piece.largest[flat].max())
                                                                      for piece in pieces))
        if constant:
            return "{} dead: one and the same value; check the microphone".format(self._named(constant))
        channels = self._wrong_channels(pieces)
        if channels:
            return channels
        count = sum(piece.count for piece in pieces)
        offset = np.abs(np.sum([piece.sums for piece in pieces], axis=0)) if pieces else np.zeros(1)
        if count and float(offset.max()) / count > _OFFSET:
            return (
                "the sound has an offset of {:.0f} % of full scale; are ~sample_format and the AudioInfo right?".format(
                    100.0 * float(offset.max()) / count
                )
            )
        return ""

    def _wrong_channels(self, pieces: List[_Piece]) -> str:
        """Return which channels do not go with the others, empty where all do."""
        inverted = self._inverted(pieces)
        if inverted:
            return "{} inverted: {}; correct the wiring, or the plug of a balanced microphone".format(
                self._named(inverted), "directions are wrong" if self._is_array else "turned over here, because the "
                "channels would cancel each other")
        silent, copies = self._silent(pieces), self._copies(pieces)
        if silent:
            return "{} silent: more than {:.0f} dB below the others; check the microphone, or " \
                   "~microphone_channels".format(self._named(silent), _SILENT_DB)
        noisy = self._noisy(pieces) if self._is_array else ()
        if noisy:
            return "{} noisy: nothing of what the others hear; check the microphone, or ~microphone_channels".format(
                self._named(noisy))
        if copies and self._is_array:
            return "{} copies of each other: no directions from them; correct ~microphone_channels".format(
                self._named(copies))
        return ""

    def _named(self, channels: Sequence[int]) -> str:
        """Return "channel 1 of 4 is" or "channels 1, 2 of 4 are" for indices of channels."""
        return "channel{} {} of {} {}".format(
            "s" if len(channels) > 1 else "", ", ".join(str(self._numbers[index]) for index in channels), self._total,
            "are" if len(channels) > 1 else "is")

    def _clipped_channels(self, pieces: List[_Piece]) -> str:
        """Return where sound is clipped, empty when it is in all channels."""
        counts = np.sum([piece.clipped_of for piece in pieces], axis=0)
        clipped = [int(index) for index in np.flatnonzero(counts > 0.1 * counts.max())]
        if len(clipped) == self._channels:
            return ""
        return " (channel {} of {})".format(", ".join(str(self._numbers[index]) for index in clipped), self._total)

    def _flattened(self, pieces: List[_Piece]) -> Tuple[int, ...]:
        """Return the indices of the channels whose peaks are cut off below the limit of the format."""
        if not pieces:
            return ()
        largest = np.array([piece.largest for piece in pieces])
        reach = (largest >= _TOP * largest.max(axis=0)) & (largest >= _LEAST_FLAT)
        tops = np.sum(reach * np.array([piece.at_peak for piece in pieces]), axis=0)
        below = np.sum(reach * np.array([piece.below_peak for piece in pieces]), axis=0)
        count = sum(piece.count for piece in pieces)
        flat = (tops > _CLIPPED_SHARE * count) & (tops > _FLAT * below) & (reach.sum(axis=0) >= _FLAT_PIECES)
        return tuple(int(index) for index in np.flatnonzero(flat))

    def _constant(self, pieces: List[_Piece]) -> Tuple[int, ...]:
        """Return the indices of the channels whose samples have not changed for _CONSTANT_S."""
        last = pieces[-int(_CONSTANT_S / _PIECE_S):]
        if len(last) < int(_CONSTANT_S / _PIECE_S):
            return ()
        low = np.min([piece.lowest for piece in last], axis=0)
        high = np.max([piece.highest for piece in last], axis=0)
        return tuple(int(channel) for channel in np.flatnonzero(high - low <= 0.0))

    def _covariance(self, pieces: List[_Piece]) -> Optional[np.ndarray]:
        """Return the covariance (C, C) of the channels, None before _CONSTANT_S or for one channel."""
        if self._channels < 2 or len(pieces) < int(_CONSTANT_S / _PIECE_S):
            return None
        count = sum(piece.count for piece in pieces)
        mean = np.sum([piece.sums for piece in pieces], axis=0) / count
        return np.sum([piece.products for piece in pieces], axis=0) / count - np.outer(mean, mean)

    def _inverted(self, pieces: List[_Piece]) -> Tuple[int, ...]:
        """Return the indices of the channels whose sign is not that of the others."""
        if not self._is_array:
            signs = self._signs
        else:
            covariance = self._covariance(pieces)
            if covariance is None:
                return ()
            alike = _correlation(covariance)
            usual = int(np.argmax(np.abs(alike).sum(axis=0)))
            signs = np.where(alike[usual] < _OPPOSED, -1.0, 1.0)
        fewer = signs < 0.0 if (signs < 0.0).sum() <= 0.5 * len(signs) else signs > 0.0
        return tuple(int(index) for index in np.flatnonzero(fewer))

    def _noisy(self, pieces: List[_Piece]) -> Tuple[int, ...]:
        """Return the index of the channel that hears noise of its own only, louder than most."""
        covariance = self._covariance(pieces) if self._channels > 2 else None
        if covariance is None:
            return ()
        power = covariance.diagonal()
        alike = np.abs(_correlation(covariance)) - np.eye(self._channels)
        index = int(np.argmin(alike.max(axis=0)))
        others = np.delete(np.delete(alike, index, 0), index, 1)
        is_noise = alike[index].max() < _UNLIKE and power[index] > np.median(power) > _LEAST_POWER
        return (index,) if is_noise and others.max(axis=0).min() > _ALIKE else ()

    def _silent(self, pieces: List[_Piece]) -> Tuple[int, ...]:
        """Return the indices of the channels that are much softer than most."""
        if self._channels == 2:     # a knock on one makes the other one soft; of more the median tells
            pieces = sorted(pieces, key=lambda piece: piece.power)[:max(len(pieces) - _LEVEL_PIECES, 0)]
        covariance = self._covariance(pieces)
        if covariance is None:
            return ()
        power = covariance.diagonal()
        usual = float(power.max() if self._channels == 2 else np.median(power))
        if usual < _LEAST_POWER:
            return ()
        return tuple(int(index) for index in np.flatnonzero(power < usual * 10.0 ** (-0.1 * _SILENT_DB)))

    def _copies(self, pieces: List[_Piece]) -> Tuple[int, ...]:
        """Return the indices of the channels that are copies of another but for a factor."""
        covariance = self._covariance(pieces)
        if covariance is None:
            return ()
        power = np.maximum(covariance.diagonal(), 1e-30)
        alike = covariance ** 2 > (1.0 - _SAME_SHARE) * np.outer(power, power)
        heard = power > _LEAST_POWER
        alike &= np.outer(heard, heard) & ~np.eye(self._channels, dtype=bool)
        return tuple(int(index) for index in np.flatnonzero(alike.any(axis=0)))

    @staticmethod
    def _clipped_share(pieces: List[_Piece]) -> float:
        count = sum(piece.count for piece in pieces)
        return sum(piece.clipped for piece in pieces) / count if count else 0.0


def _correlation(covariance: np.ndarray) -> np.ndarray:
    """Return the correlation (C, C) of channels of this covariance."""
    size = np.sqrt(np.maximum(covariance.diagonal(), 1e-30))
    return covariance / np.outer(size, size)
