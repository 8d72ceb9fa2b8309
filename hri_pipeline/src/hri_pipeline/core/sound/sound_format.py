"""Bytes of a sound stream into samples, and what else the bytes may be."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, Tuple

import numpy as np

SAMPLE_WIDTHS: Dict[str, int] = {"U8": 1, "S16LE": 2, "S16BE": 2, "S24LE": 3, "S32LE": 4, "F32LE": 4}
"""Bytes of one sample of the formats that are read, by the names of GStreamer and ALSA."""
SAMPLE_FORMATS = tuple(SAMPLE_WIDTHS)
RAW_CODINGS = ("", "wave", "wav", "raw", "pcm")
MAX_CHANNELS = 32
RATES = (4000, 384000)
"""Lowest and highest sample rate that is believed, Hz."""

_OTHER_NAMES = {"S24_3LE": "S24LE", "FLOAT_LE": "F32LE", "FLOAT32LE": "F32LE", "S8": "", "": "S16LE"}
_CONTAINERS = {b"RIFF": "the head of a WAV file", b"OggS": "Ogg", b"fLaC": "FLAC", b"ID3": "mp3", b"\x1aE\xdf\xa3": "Matroska"}
# MPEG audio, ISO/IEC 11172-3 table: kbit/s of layer III, MPEG 1 and MPEG 2; sample rates of MPEG 1, 2, 2.5.
_MP3_BITRATES = ((32, 40, 48, 56, 64, 80, 96, 112, 128, 160, 192, 224, 256, 320),
                 (8, 16, 24, 32, 40, 48, 56, 64, 80, 96, 112, 128, 144, 160))
_MP3_RATES = {3: (44100, 48000, 32000), 2: (22050, 24000, 16000), 0: (11025, 12000, 8000)}


class SoundError(ValueError):
    """Bytes that are not the sound that they are said to be; the text names what and the mend."""


@dataclass(frozen=True)
class SoundFormat:
    """How to read a stream. channels: interleaved; sample_rate: Hz. Raises SoundError for what cannot be true."""

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
            raise SoundError("the sound has {} channels, legal: 1 to {}; mend the AudioInfo of its sender, or set "
                             "~use_audio_info to false and ~channels".format(self.channels, MAX_CHANNELS))
        if not RATES[0] <= self.sample_rate <= RATES[1]:
            raise SoundError("the sound has {} samples a second, legal: {} to {}; mend the AudioInfo of its sender, or set "
                             "~use_audio_info to false and ~sample_rate".format(self.sample_rate, *RATES))
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


def decode(data: bytes, form: SoundFormat) -> np.ndarray:
    """Return (N, C) float32 of -1 to 1. Raises SoundError for bytes that are no samples of this format."""
    other = _recognised(data)
    if other:
        raise SoundError("the bytes are {}, not raw samples; let the sender give raw samples "
                         "(audio_capture: _format:=wave)".format(other))
    if len(data) % form.frame_bytes:
        raise SoundError("{} bytes are no whole number of samples of {} channel(s) {} ({} bytes each); is ~channels or "
                         "~sample_format, or the AudioInfo, right?".format(
                             len(data), form.channels, form.sample_format, form.frame_bytes))
    samples = _samples(data, form.sample_format)
    if form.sample_format == "F32LE" and not (np.abs(samples) <= 16.0).all():
        # Sound of other programs may pass 1 a little; wild numbers are no floating point samples.
        raise SoundError("samples are not finite or far beyond -1 to 1; are they really F32LE? Mend ~sample_format or "
                         "the AudioInfo")
    return samples.reshape(-1, form.channels)


def encode_s16(samples: np.ndarray) -> bytes:
    """Return S16LE bytes of float samples of -1 to 1 (N,) or (N, C), interleaved; what is beyond is clipped."""
    scaled = np.clip(np.nan_to_num(samples) * 32768.0, -32768.0, 32767.0)
    return np.rint(scaled).astype("<i2").tobytes()


def _samples(data: bytes, name: str) -> np.ndarray:
    """All samples in a row, float32."""
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


def _recognised(data: bytes) -> str:
    """What the bytes are if they are no samples: the name of a file format, else empty."""
    for mark, name in _CONTAINERS.items():
        if data.startswith(mark):
            return name
    return "mp3" if _is_mp3(data) else ""


def _is_mp3(data: bytes) -> bool:
    """Tell whether the bytes are frames of MPEG layer III: a head, and at the frame's end another head or nothing."""
    size = _mp3_frame(data[:4])
    if not size or len(data) < size:
        return False
    # Four bytes of samples look like a head one time in ten thousand: two heads, or a length that fits, are proof.
    return len(data) == size or _mp3_frame(data[size:size + 4]) > 0


def _mp3_frame(head: bytes) -> int:
    """Bytes of the frame that this head begins, 0 when it is none."""
    if len(head) < 4 or head[0] != 0xFF or head[1] & 0xE0 != 0xE0 or (head[1] >> 1) & 3 != 1:
        return 0
    version, rate, bitrate = (head[1] >> 3) & 3, (head[2] >> 2) & 3, head[2] >> 4
    if version == 1 or rate == 3 or not 1 <= bitrate <= 14:
        return 0
    speed, factor = _MP3_BITRATES[version != 3][bitrate - 1], 144 if version == 3 else 72
    return factor * 1000 * speed // _MP3_RATES[version][rate] + ((head[2] >> 1) & 1)


def nearest_rate(rate: float, within: float = 0.02) -> Tuple[int, bool]:
    """Return the usual sample rate nearest to `rate` Hz and whether it is within that share of it."""
    usual = (8000, 11025, 16000, 22050, 24000, 32000, 44100, 48000, 88200, 96000, 176400, 192000)
    best = min(usual, key=lambda value: abs(value - rate))
    return best, abs(best - rate) <= within * best
