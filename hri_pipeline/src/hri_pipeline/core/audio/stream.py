"""A stream of sound messages as blocks of 16 kHz with the time at which they were heard.

`SoundStream` is the entry. It decodes the bytes of each message (`SoundFormat`, `decode`), measures them
(`SoundLevel`), resamples them to 16 kHz and stamps them with a clock that counts samples (`SampleClock`).
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Deque, Dict, List, Optional, Sequence, Tuple

import numpy as np
import soxr

from hri_pipeline.core.audio.level import SoundLevel

RATE = 16000
"""Sample rate (Hz) of everything behind `SoundStream`."""
BLOCK = 512
"""Largest number of samples in a block: 32 ms."""
SAMPLE_WIDTHS: Dict[str, int] = {"U8": 1, "S16LE": 2, "S16BE": 2, "S24LE": 3, "S32LE": 4, "F32LE": 4}
"""Bytes per sample of the supported formats, by the names of GStreamer and ALSA."""
SAMPLE_FORMATS = tuple(SAMPLE_WIDTHS)
RAW_CODINGS = ("", "wave", "wav", "raw", "pcm")
MAX_CHANNELS = 32
RATES = (4000, 384000)
"""Lowest and highest sample rate (Hz) that is accepted."""

_OTHER_NAMES = {"S24_3LE": "S24LE", "FLOAT_LE": "F32LE", "FLOAT32LE": "F32LE", "": "S16LE"}
_CONTAINERS = {b"RIFF": "the head of a WAV file", b"OggS": "Ogg", b"fLaC": "FLAC", b"ID3": "mp3",
               b"\x1aE\xdf\xa3": "Matroska"}
# MPEG audio, ISO/IEC 11172-3 table: kbit/s of layer III, MPEG 1 and MPEG 2; sample rates of MPEG 1, 2, 2.5.
_MP3_BITRATES = ((32, 40, 48, 56, 64, 80, 96, 112, 128, 160, 192, 224, 256, 320),
                 (8, 16, 24, 32, 40, 48, 56, 64, 80, 96, 112, 128, 144, 160))
_MP3_RATES = {3: (44100, 48000, 32000), 2: (22050, 24000, 16000), 0: (11025, 12000, 8000)}


class SoundError(ValueError):
    """The bytes are not sound of the announced format; the text says what they are and how to correct it."""


@dataclass(frozen=True)
class SoundFormat:
    """How to read a stream.

    Parameters
    ----------
    channels : int
        Number of interleaved channels, 1 to MAX_CHANNELS.
    sample_rate : int
        Hz, within RATES.
    sample_format : str
        One of SAMPLE_FORMATS, or another usual name of one of them.
    coding_format : str
        One of RAW_CODINGS.

    Raises
    ------
    SoundError
        For a value out of range, or a format that is not supported.
    """

    channels: int = 1
    sample_rate: int = 16000
    sample_format: str = "S16LE"
    coding_format: str = "wave"

    def __post_init__(self) -> None:
        coding = self.coding_format.strip().lower()
        if coding not in RAW_CODINGS:
            raise SoundError("the sound is coded as {!r}, only raw samples are read; let its sender give raw samples "
                             "(audio_capture: _format:=wave)".format(self.coding_format[:20]))
        if not 1 <= self.channels <= MAX_CHANNELS:
            raise SoundError("the sound has {} channels, legal: 1 to {}; correct the AudioInfo of its sender, or set "
                             "~use_audio_info to false and ~channels".format(self.channels, MAX_CHANNELS))
        if not RATES[0] <= self.sample_rate <= RATES[1]:
            raise SoundError("the sound has {} samples a second, legal: {} to {}; correct the AudioInfo of its sender, "
                             "or set ~use_audio_info to false and ~sample_rate".format(self.sample_rate, *RATES))
        name = self.sample_format.strip().upper()
        name = _OTHER_NAMES.get(name, name)
        if name not in SAMPLE_WIDTHS:
            raise SoundError("samples of format {!r} are not read, only {}; let its sender give one of them".format(
                self.sample_format[:20], ", ".join(SAMPLE_FORMATS)))
        object.__setattr__(self, "sample_format", name)
        object.__setattr__(self, "coding_format", "wave")

    @property
    def frame_bytes(self) -> int:
        """Bytes of one sample of all channels."""
        return self.channels * SAMPLE_WIDTHS[self.sample_format]

    @property
    def text(self) -> str:
        """The format in words."""
        return "{} Hz, {} channel{}, {}".format(
            self.sample_rate, self.channels, "" if self.channels == 1 else "s", self.sample_format)


def nearest_rate(rate: float) -> Tuple[int, bool]:
    """Return the standard sample rate nearest to `rate` (Hz), and whether they differ by at most 2 %."""
    usual = (8000, 11025, 16000, 22050, 24000, 32000, 44100, 48000, 88200, 96000, 176400, 192000)
    best = min(usual, key=lambda value: abs(value - rate))
    return best, abs(best - rate) <= 0.02 * best


def decode(data: bytes, form: SoundFormat) -> np.ndarray:
    """Return the samples (N, C), float32, -1 to 1, of interleaved bytes.

    Raises
    ------
    SoundError
        When the bytes are not samples of this format.
    """
    other = _container(data)
    if other:
        raise SoundError("the bytes are {}, not raw samples; let the sender give raw samples "
                         "(audio_capture: _format:=wave)".format(other))
    if len(data) % form.frame_bytes:
        raise SoundError("{} bytes are no whole number of samples of {} channel(s) {} ({} bytes each); is ~channels or "
                         "~sample_format, or the AudioInfo, right?".format(
                             len(data), form.channels, form.sample_format, form.frame_bytes))
    samples = _samples(data, form.sample_format)
    if form.sample_format == "F32LE" and not (np.abs(samples) <= 16.0).all():
        # Other programs may exceed 1 slightly; very large numbers are not floating-point samples.
        raise SoundError("samples are not finite or far beyond -1 to 1; are they really F32LE? Correct "
                         "~sample_format or the AudioInfo")
    return samples.reshape(-1, form.channels)


def encode_s16(samples: np.ndarray) -> bytes:
    """Return the interleaved S16LE bytes of float samples (N,) or (N, C), -1 to 1.

    Larger samples are clipped; samples that are not finite become 0.
    """
    # Fifty short pieces a second: np.clip and nan_to_num take longer than all the rest.
    if not np.isfinite(samples).all():
        samples = np.nan_to_num(samples, nan=0.0, posinf=0.0, neginf=0.0)
    scaled = samples * 32768.0
    np.minimum(np.maximum(scaled, -32768.0, out=scaled), 32767.0, out=scaled)
    return np.rint(scaled, out=scaled).astype("<i2").tobytes()


def _samples(data: bytes, name: str) -> np.ndarray:
    """Return all samples in one row (N * C,), float32."""
    if name == "U8":
        return (np.frombuffer(data, np.uint8).astype(np.float32) - 128.0) / 128.0
    if name in ("S16LE", "S16BE"):
        return np.frombuffer(data, "<i2" if name == "S16LE" else ">i2").astype(np.float32) / 32768.0
    if name == "S24LE":
        parts = np.frombuffer(data, np.uint8).reshape(-1, 3)
        wide = np.zeros((len(parts), 4), np.uint8)
        wide[:, 1:] = parts
        return wide.view("<i4")[:, 0].astype(np.float32) / 2147483648.0
    if name == "S32LE":
        return np.frombuffer(data, "<i4").astype(np.float32) / 2147483648.0
    return np.frombuffer(data, "<f4").astype(np.float32)


def _container(data: bytes) -> str:
    """Return the name of the file format that the bytes begin with, empty for raw samples."""
    for mark, name in _CONTAINERS.items():
        if data.startswith(mark):
            return name
    return "mp3" if _is_mp3(data) else ""


def _is_mp3(data: bytes) -> bool:
    """Return whether the bytes are MPEG layer III: a frame header, and behind the frame another header or the end."""
    size = _mp3_frame(data[:4])
    if not size or len(data) < size:
        return False
    # Four bytes of samples look like a header one time in ten thousand: ask for two headers, or a matching length.
    return len(data) == size or _mp3_frame(data[size:size + 4]) > 0


def _mp3_frame(head: bytes) -> int:
    """Return the length (bytes) of the frame with this header, 0 when it is not a header."""
    if len(head) < 4 or head[0] != 0xFF or head[1] & 0xE0 != 0xE0 or (head[1] >> 1) & 3 != 1:
        return 0
    version, rate, bitrate = (head[1] >> 3) & 3, (head[2] >> 2) & 3, head[2] >> 4
    if version == 1 or rate == 3 or not 1 <= bitrate <= 14:
        return 0
    speed, factor = _MP3_BITRATES[version != 3][bitrate - 1], 144 if version == 3 else 72
    return factor * 1000 * speed // _MP3_RATES[version][rate] + ((head[2] >> 1) & 1)


WINDOW_S = 10.0
"""Window of the smallest delay: a drift of 100 ppm between two clocks changes it by 1 ms."""
CONFIRM_S = 0.25
"""Time for which messages must stay late before their lateness counts as missing sound."""
STALL_S = 1.0
"""A message that is later than this restarts the clock at once."""
_SLEW = 0.02
_FIRST_SLEW = 0.1
_FIRST_S = 2.0
# Later stages take more than 20 ms between two blocks for a gap.
_MOST_STEP_S = 0.005
_RATE_STEP_S = 0.25
_RATE_LEAST_S = 2.0
_LEAST_STEP_S = 1e-4
"""Time between the stamps of two blocks whose sound came too late to be placed behind what was heard before."""


class SampleClock:
    """Converts stream time to the time at which sound was heard, on the clock of the arrivals: stream time + offset.

    Stream time is the number of samples so far divided by the rate, plus what was skipped (s). A message never arrives
    early: its delay varies and is never negative. The offset between arrival time and stream time is therefore the
    minimum of arrival - stream time over WINDOW_S: jitter does not change it, a drift of the sound card's clock does.
    It changes by at most 2 % of the elapsed time (10 % in the first 2 s), so that stamps stay even. Messages that stay
    late by more than the tolerance for CONFIRM_S are a gap.

    Parameters
    ----------
    tolerance : float
        s, above 0.

    Attributes
    ----------
    offset : float
        s, time of arrivals minus stream time.
    set_back : int
        How often more sound than time came, so that the clock was set back.

    Raises
    ------
    ValueError
        For a tolerance that is not above 0.
    """

    def __init__(self, tolerance: float = 0.08) -> None:
        if not tolerance > 0.0:
            raise ValueError("gap tolerance is {} s, legal range above 0".format(tolerance))
        self._tolerance = tolerance
        self._least: Deque[Tuple[float, float]] = deque()
        self._marks: Deque[Tuple[float, float]] = deque()
        self._late: Tuple[float, float] = (0.0, 0.0)
        self._is_late = False
        self._begun = 0.0
        self._arrival = 0.0
        self.offset = 0.0
        self.set_back = 0
        self.is_running = False

    def add(self, end: float, arrival: float) -> float:
        """Note that the sound up to a stream time has arrived.

        Parameters
        ----------
        end : float
            Stream time (s) of the end of the message.
        arrival : float
            s, when it arrived.

        Returns
        -------
        float
            Duration (s) of a gap that this message reveals, 0 for none.
        """
        offset = arrival - end
        if not self.is_running:
            self._anchor(offset, end, arrival)
            return 0.0
        passed, self._arrival = max(0.0, arrival - self._arrival), arrival
        self._count(end, arrival)
        lateness = offset - self.offset
        if lateness > STALL_S or self._stays_late(lateness, arrival):
            gap = lateness if lateness > STALL_S else min(lateness, self._late[1])
            self._reanchor(self.offset + gap, end, arrival, forget=lateness > STALL_S)
            return gap
        if lateness < -self._tolerance:
            # More sound than time: a late message was taken for a gap, or the announced rate is wrong.
            self.set_back += 1
            self._reanchor(offset, end, arrival, forget=False)
            return 0.0
        self._follow(offset, arrival, passed)
        return 0.0

    def speed(self) -> float:
        """Return the seconds of sound per second: 1 when the announced rate is true, 0 while it is unknown."""
        if len(self._marks) < 2:
            return 0.0
        (first, begun), (last, ended) = self._marks[0], self._marks[-1]
        span = ended - begun
        return (last - first) / span if span >= _RATE_LEAST_S else 0.0

    def _anchor(self, offset: float, end: float, arrival: float) -> None:
        self.is_running = True
        self._begun = self._arrival = arrival
        self._reanchor(offset, end, arrival, forget=True)

    def _reanchor(self, offset: float, end: float, arrival: float, forget: bool) -> None:
        self.offset = offset
        self._is_late = False
        self._least.clear()
        self._least.append((arrival, offset))
        if forget:
            self._marks.clear()
            self._marks.append((end, arrival))

    def _stays_late(self, lateness: float, arrival: float) -> bool:
        """Return whether messages have been late for CONFIRM_S; keeps the least lateness."""
        if lateness <= self._tolerance:
            self._is_late = False
            return False
        since, least = self._late if self._is_late else (arrival, lateness)
        self._is_late, self._late = True, (since, min(least, lateness))
        return arrival - since >= CONFIRM_S

    def _follow(self, offset: float, arrival: float, passed: float) -> None:
        """Move the offset towards the minimum of the window."""
        while self._least and self._least[-1][1] >= offset:
            self._least.pop()
        self._least.append((arrival, offset))
        while self._least[0][0] < arrival - WINDOW_S:
            self._least.popleft()
        most = min(_MOST_STEP_S, (_FIRST_SLEW if arrival - self._begun < _FIRST_S else _SLEW) * passed)
        self.offset += min(most, max(-most, self._least[0][1] - self.offset))

    def _count(self, end: float, arrival: float) -> None:
        """Record how much sound had come at which time, for the rate."""
        if not self._marks or arrival - self._marks[-1][1] >= _RATE_STEP_S:
            self._marks.append((end, arrival))
        while self._marks[0][1] < arrival - WINDOW_S:
            self._marks.popleft()


_WRONG_SPEED = 0.1
# What microphones have, where the number of channels may be wrong and not the rate.
_USUAL_CHANNELS = (1, 2, 4, 6, 8)
_MICROPHONE_RATES = (16000, 44100, 48000)


@dataclass(frozen=True)
class SoundBlock:
    """A piece of sound.

    Attributes
    ----------
    samples : np.ndarray
        (N, C) float32, -1 to 1, at 16 kHz, N from 1 to BLOCK.
    stamp : float
        s, of the first sample.
    gap : float
        s of sound that is missing before it.
    broken : tuple of int
        Indices of the channels that are microphones of an array and hear nothing of what the others do.
    """

    samples: np.ndarray
    stamp: float
    gap: float = 0.0
    broken: Tuple[int, ...] = ()


class SoundStream:
    """Decodes, selects channels, measures, corrects, resamples and stamps a stream of one format.

    Stamps never go back. Where sound comes after all whose place was taken for a gap, it stands close together behind
    what was heard last, until the clock has caught up.

    Parameters
    ----------
    form : SoundFormat
    tolerance : float
        s, see SampleClock.
    latency : float
        s, smallest time from a sound to its arrival; it is subtracted from every stamp.
    quality : str
        Of the resampler (soxr). HQ keeps sound up to 7.3 kHz and delays it by 37 ms at 48 kHz, LQ 5.8 kHz and 20 ms.
        The stamps account for the delay. A stream of 16 kHz is not resampled.
    channels : sequence of int
        Numbers of the channels to use, from 0, in the order of the samples that come out; -1: all. All are used where
        the stream lacks one of them, and problem() says so.
    is_array : bool
        The channels are microphones of an array: problem() names those that are copies.

    Attributes
    ----------
    gaps : int
        Number of gaps so far.
    lost : float
        s, their total duration.
    """

    def __init__(self, form: SoundFormat, tolerance: float = 0.08, latency: float = 0.0, quality: str = "HQ",
                 channels: Sequence[int] = (-1,), is_array: bool = False) -> None:
        self.form = form
        self._latency = latency
        self._quality = quality
        self._clock = SampleClock(tolerance)
        self._missing = [number for number in channels if number >= form.channels]
        self._used = list(range(form.channels)) if self._missing or min(channels, default=-1) < 0 else list(channels)
        self._level = SoundLevel(form.sample_rate, len(self._used), self._used, form.channels, is_array)
        self._taken = 0
        self._skipped = 0.0
        self._overrun = 0.0
        self._unreported = 0.0
        self._begin = 0.0
        self._given = 0
        self._least_stamp = -math.inf
        self._resampler = self._new_resampler()
        self.gaps = 0
        self.lost = 0.0

    def add(self, data: bytes, arrival: float) -> List[SoundBlock]:
        """Add the bytes of a message and return the blocks that are complete.

        Parameters
        ----------
        data : bytes
        arrival : float
            s, when the message arrived.

        Raises
        ------
        SoundError
            When the bytes are not sound of this format. They are ignored, and the stream goes on.
        """
        samples = decode(data, self.form)
        if not len(samples):
            return []
        if len(self._used) != self.form.channels or self._used != sorted(self._used):
            samples = samples[:, self._used]
        self._level.add(samples)
        samples = self._level.corrected(samples)
        start = self._stream_time()
        self._taken += len(samples)
        before = self._clock.offset
        gap = self._clock.add(self._stream_time(), arrival) + self._overrun
        self._overrun = 0.0
        blocks: List[SoundBlock] = []
        if gap > 0.0:
            self.gaps += 1
            self.lost += gap
            self._unreported += gap
            blocks = self._end_piece(before)
            self._begin, self._given = start, 0
        fresh = self._blocks(self._resample(samples), self._clock.offset, self._unreported)
        if fresh:
            self._unreported = 0.0
        return blocks + fresh

    def skip(self, seconds: float) -> None:
        """Note that `seconds` of sound came and were dropped (an overrun): the next block has a gap."""
        self._skipped += max(0.0, seconds)
        self._overrun += max(0.0, seconds)

    def problem(self) -> str:
        """Return what is wrong with the sound and how to correct it, empty when nothing is."""
        speed = self._clock.speed()
        if speed and abs(speed - 1.0) > _WRONG_SPEED:
            came = speed * self.form.sample_rate
            return "{:.0f} samples a second come instead of {}: {}".format(came, self.form.sample_rate,
                                                                           self._rate_hint(came))
        if self._missing:
            return "~microphone_channels names channel {}, and the sound has {} channel{} (from 0 on): all are used; " \
                   "is it the right device, and its firmware?".format(
                       self._missing[0], self.form.channels, "" if self.form.channels == 1 else "s")
        return self._level.problem()

    def _rate_hint(self, came: float) -> str:
        """Return how to correct the format where `came` samples a second come of each channel that is told."""
        usual, is_near = nearest_rate(came)
        if not is_near:
            return "is ~sample_rate (or the AudioInfo), ~channels or ~sample_format right, or is sound lost on its way?"
        hint = "set ~sample_rate (or the AudioInfo) to {}".format(usual)
        rates = {count: nearest_rate(came * self.form.channels / count) for count in _USUAL_CHANNELS
                 if count != self.form.channels}
        others = ["{} channel{} of {}".format(count, "" if count == 1 else "s", rate)
                  for count, (rate, near) in rates.items() if near and rate in _MICROPHONE_RATES]
        return hint + "; or are these {}? Then correct ~channels".format(", or ".join(others)) if others else hint

    def values(self) -> Dict[str, object]:
        """Return the values for diagnostics."""
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
        return soxr.ResampleStream(self.form.sample_rate, RATE, len(self._used), dtype="float32",
                                   quality=self._quality)

    def _resample(self, samples: np.ndarray, last: bool = False) -> np.ndarray:
        if self._resampler is None:
            return samples
        return self._resampler.resample_chunk(np.ascontiguousarray(samples), last=last)

    def _end_piece(self, offset: float) -> List[SoundBlock]:
        """Return the sound before a gap that the resampler still holds, and restart the resampler."""
        if self._resampler is None:
            return []
        tail = self._resample(np.zeros((0, len(self._used)), np.float32), last=True)
        blocks = self._blocks(tail, offset, 0.0)
        self._resampler = self._new_resampler()
        return blocks

    def _blocks(self, samples: np.ndarray, offset: float, gap: float) -> List[SoundBlock]:
        """Cut samples (N, C) into stamped blocks; the first one carries the gap (s)."""
        blocks: List[SoundBlock] = []
        for start in range(0, len(samples), BLOCK):
            stamp = max(self._begin + self._given / RATE + offset - self._latency, self._least_stamp)
            self._least_stamp = stamp + _LEAST_STEP_S
            blocks.append(SoundBlock(samples[start:start + BLOCK], stamp, 0.0 if blocks else gap, self._level.broken))
            self._given += len(blocks[-1].samples)
        return blocks
