"""How exact the 16 descriptors are: on voices whose pitch and harmonics-to-noise ratio are known (pulses, formants,
white noise), and against another library's cepstra."""

from __future__ import annotations

import time
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np
from scipy.signal import lfilter

from benchmarks.speech_files import SPEECH_FILES, available, read_speech
from hri_pipeline.core.audio.features import (
    BANDS,
    COEFFICIENTS,
    LIFTER,
    PITCH_UNIT_HZ,
    RATE,
    AudioFeatureExtractor,
    MelCepstrum,
)

_SECONDS = 0.6
_BLOCK = 512
# Frames at the ends, whose window is not full of the voice.
_EDGE = 4
_WRONG = 0.03


def voice_errors(frequency: float, ratio: float, vowel: str,
                 random: np.random.Generator) -> Tuple[np.ndarray, np.ndarray]:
    """Return the relative errors of F0 (N,), 1 where nothing voiced was found, and errors of HNR (N,) in dB."""
    sound = with_noise(voiced(frequency, _SECONDS, VOWELS[vowel]), ratio, random)
    frames = AudioFeatureExtractor().process(sound, 0.0)[_EDGE:-_EDGE]
    found = np.array([frame.pitch for frame in frames]) * PITCH_UNIT_HZ
    errors = np.where(found > 0.0, np.abs(found / frequency - 1.0), 1.0)
    return errors, np.array([frame.hnr for frame in frames]) - ratio


def voice_figures(seed: int = 0) -> Dict[str, object]:
    """Errors over 165 voices of 90 to 440 Hz and 5 to 40 dB.

    f0_error_percent, hnr_error_db: the worst voice, each by the median of its frames. f0_wrong_frames: share of all
    frames off by more than 3 % or not voiced. noise_voiced: share of the frames of white noise that are voiced.
    """
    random = np.random.default_rng(seed)
    pitch: List[float] = []
    ratios: List[float] = []
    wrong: List[float] = []
    for vowel in VOWELS:
        for frequency in FREQUENCIES:
            for ratio in RATIOS_DB:
                errors, differences = voice_errors(frequency, ratio, vowel, random)
                pitch.append(float(np.median(errors)))
                wrong.append(float(np.mean(errors > _WRONG)))
                ratios.append(abs(float(np.median(differences))))
    noise = AudioFeatureExtractor().process(random.normal(size=5 * RATE) * 0.1, 0.0)
    return {"f0_error_percent": 100.0 * max(pitch), "hnr_error_db": max(ratios),
            "f0_wrong_frames": float(np.mean(wrong)),
            "f0_wrong_frames_worst_voice": max(wrong),
            "noise_voiced": float(np.mean([frame.pitch > 0.0 for frame in noise])),
            "synthetic_voices": len(pitch)}


def reference_cepstra(samples: np.ndarray) -> np.ndarray:
    """Return (N, 12) coefficients of the same frames by kaldi-native-fbank, an independent library.

    Its bands of magnitudes with the settings of HTK, then the cosine transform and lifter of the HTK Book (its own
    cepstra are of the power spectrum). samples: (n,) from -1 to 1. Raises ImportError where the library is missing.
    """
    import kaldi_native_fbank
    options = kaldi_native_fbank.FbankOptions()
    options.frame_opts.dither = 0.0
    options.frame_opts.window_type = "hamming"
    options.frame_opts.remove_dc_offset = False
    options.mel_opts.num_bins, options.mel_opts.low_freq, options.mel_opts.high_freq = BANDS, 0.0, RATE / 2.0
    options.mel_opts.htk_mode = options.htk_compat = True
    options.use_power, options.use_log_fbank = False, True
    bands = kaldi_native_fbank.OnlineFbank(options)
    bands.accept_waveform(RATE, (samples * 32768.0).astype(np.float32).tolist())
    bands.input_finished()
    logarithms = np.array([bands.get_frame(number) for number in range(bands.num_frames_ready)], dtype=np.float64)
    order = np.arange(1, COEFFICIENTS + 1)
    places = (np.arange(BANDS) + 0.5) / BANDS
    cosines = np.sqrt(2.0 / BANDS) * np.cos(np.pi * order[:, None] * places[None, :])
    return logarithms @ cosines.T * (1.0 + LIFTER / 2.0 * np.sin(np.pi * order / LIFTER))


def cepstrum_figures() -> Dict[str, Optional[float]]:
    """Largest difference and least correlation of a coefficient on real speech; None where something is missing."""
    missing: Dict[str, Optional[float]] = {"mfcc_max_difference": None, "mfcc_least_correlation": None}
    if not available():
        return missing
    samples = np.concatenate(list(read_speech(SPEECH_FILES[:6]).values()))
    try:
        reference = reference_cepstra(samples)
    except ImportError:
        return missing
    frames = np.lib.stride_tricks.sliding_window_view(samples, 400)[::160]
    own = MelCepstrum(400, RATE)(frames[:len(reference)])
    correlations = [np.corrcoef(own[:, number], reference[:, number])[0, 1] for number in range(COEFFICIENTS)]
    return {"mfcc_max_difference": float(np.abs(own - reference).max()),
            "mfcc_least_correlation": float(min(correlations))}


def load_figures(seconds: float = 10.0) -> Dict[str, float]:
    """Processor time per frame in blocks of 32 ms, the least of three runs; one core's share is 100 times that per
    s."""
    samples = np.random.default_rng(0).normal(size=int(seconds * RATE)) * 0.1
    times = []
    for _ in range(3):
        extractor, count, start = AudioFeatureExtractor(), 0, time.process_time()
        for place in range(0, len(samples), _BLOCK):
            count += len(extractor.process(samples[place:place + _BLOCK], place / RATE))
        times.append((time.process_time() - start) / max(count, 1) * 1e3)
    return {"feature_ms_per_frame": min(times)}


def figures() -> Dict[str, object]:
    """Return all figures of the descriptors."""
    return {**voice_figures(), **cepstrum_figures(), **load_figures()}


# Formants (Hz) and bandwidths (Hz) of American vowels: Peterson and Barney (1952), men; bandwidths: Dunn (1961).
VOWELS = {
    "a": ((730.0, 60.0), (1090.0, 70.0), (2440.0, 110.0)),
    "i": ((270.0, 60.0), (2290.0, 100.0), (3010.0, 120.0)),
    "u": ((300.0, 60.0), (870.0, 80.0), (2240.0, 110.0)),
}
FREQUENCIES = (90.0, 103.7, 120.0, 150.0, 180.0, 220.0, 262.3, 300.0, 350.0, 400.0, 440.0)
RATIOS_DB = (5.0, 10.0, 20.0, 30.0, 40.0)
# The spectrum of the glottal pulse falls by 12 dB per octave (Fant 1960), and radiation from the lips gives 6 back.
_TILT = -1.0
_HIGHEST_HZ = 7600.0


def voiced(frequency: float, seconds: float, formants: Sequence[Tuple[float, float]]) -> np.ndarray:
    """Return (n,) samples at 16 kHz of a periodic voice without aliases, of root mean square 1.

    frequency: Hz, need not divide the sample rate. formants: (Hz, bandwidth Hz).
    """
    time = np.arange(int(seconds * RATE)) / RATE
    harmonics = np.arange(1, int(_HIGHEST_HZ / frequency) + 1)
    sound = np.zeros(len(time))
    for harmonic in harmonics:
        sound += harmonic ** _TILT * np.cos(2.0 * np.pi * harmonic * frequency * time)
    for centre, bandwidth in formants:
        radius = np.exp(-np.pi * bandwidth / RATE)
        sound = lfilter([1.0 - radius], [1.0, -2.0 * radius * np.cos(2.0 * np.pi * centre / RATE), radius ** 2], sound)
    return sound / np.sqrt(np.mean(sound ** 2))


def with_noise(sound: np.ndarray, ratio: float, random: np.random.Generator, level: float = 0.1) -> np.ndarray:
    """Return `sound` with white noise `ratio` dB below it, the voice at root mean square `level`."""
    noise = random.normal(size=len(sound)) * np.sqrt(np.mean(sound ** 2)) * 10.0 ** (-ratio / 20.0)
    return level * (sound + noise)
