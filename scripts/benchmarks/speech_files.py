"""Real speech for tests and figures: the recordings of the Debian package pocketsphinx-testdata, and those of
alsa-utils.

Nothing of it is part of this project.
"""

from __future__ import annotations

from pathlib import Path
from typing import Dict, List, Sequence

import numpy as np
import soundfile
import soxr

RATE = 16000

SPEECH_DIRECTORY = Path("/usr/share/pocketsphinx/test/data")
ABSENT = "there is no speech in {}; install the Debian package pocketsphinx-testdata".format(SPEECH_DIRECTORY)

SPEECH_FILES = (
    "cards/001.wav", "cards/002.wav", "cards/003.wav", "cards/004.wav", "cards/005.wav", "goforward.raw",
    "librivox/sense_and_sensibility_01_austen_64kb-0870.wav", "librivox/sense_and_sensibility_01_austen_64kb-0880.wav",
    "librivox/sense_and_sensibility_01_austen_64kb-0890.wav", "librivox/sense_and_sensibility_01_austen_64kb-0920.wav",
    "librivox/sense_and_sensibility_01_austen_64kb-0930.wav", "numbers.raw", "something.raw", "tidigits/dhd.2934z.raw")
"""All recordings of the package: 16 kHz, one channel, 47 s. The .raw files are 16 bit little endian without a
header."""

TUNING_FILES = tuple(SPEECH_FILES[index] for index in (0, 2, 4, 5, 6, 8, 11))
"""The half on which the thresholds of activity were chosen."""

HELD_OUT_FILES = tuple(name for name in SPEECH_FILES if name not in TUNING_FILES)
"""The other half."""

SPOKEN_POSITIONS = Path("/usr/share/sounds/alsa")
"""Directory of alsa-utils: eight short announcements such as "front left", 48 kHz."""


def available() -> bool:
    """Tell whether the recordings of pocketsphinx-testdata are there."""
    return all((SPEECH_DIRECTORY / name).is_file() for name in SPEECH_FILES)


def read_speech(names: Sequence[str] = SPEECH_FILES) -> Dict[str, np.ndarray]:
    """Return {name: (n,) float64 samples at 16 kHz, -1..1}. Raises FileNotFoundError with the mend."""
    missing = [name for name in names if not (SPEECH_DIRECTORY / name).is_file()]
    if missing:
        raise FileNotFoundError("{} (missing: {})".format(ABSENT, ", ".join(missing)))
    return {name: _read(SPEECH_DIRECTORY / name) for name in names}


def read_announcements() -> Dict[str, np.ndarray]:
    """Return the announcements of alsa-utils in the same form; empty where it is not installed."""
    files: List[Path] = sorted(path for path in SPOKEN_POSITIONS.glob("*_*.wav"))
    return {path.name: _read(path) for path in files}


def _read(path: Path) -> np.ndarray:
    if path.suffix == ".raw":
        return np.fromfile(str(path), "<i2").astype(np.float64) / 32768.0
    samples, rate = soundfile.read(str(path), dtype="float64", always_2d=True)
    mono = samples.mean(axis=1)
    return mono if rate == RATE else soxr.resample(mono, rate, RATE)
