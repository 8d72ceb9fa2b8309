"""The 16 descriptors, on sounds whose values are known."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.voice_features import VOWELS, reference_cepstra, voice_errors, voiced, with_noise
from hri_pipeline.core.audio.features import (
    GAP_S,
    HNR_RANGE_DB,
    PITCH_UNIT_HZ,
    RATE,
    AudioFeatureExtractor,
    MelCepstrum,
    PitchEstimator,
    mel,
    mel_filters,
)

FIELDS = ("stamp", "zcr", "rms", "pitch", "hnr")


def a_voice(seconds=0.5, frequency=140.0, ratio=25.0):
    return with_noise(voiced(frequency, seconds, VOWELS["a"]), ratio, np.random.default_rng(1))


def as_array(frames):
    return np.array([[getattr(frame, field) for field in FIELDS] + frame.mfcc.tolist() for frame in frames])


@pytest.mark.parametrize("frequency", [90.0, 262.3, 440.0])
@pytest.mark.parametrize("ratio", [5.0, 20.0, 40.0])
@pytest.mark.parametrize("vowel", sorted(VOWELS))
def test_pitch_and_noise_of_known_voices(frequency, ratio, vowel):
    errors, differences = voice_errors(frequency, ratio, vowel, np.random.default_rng(2))
    assert np.median(errors) < 0.03
    assert np.mean(errors > 0.03) < 0.15
    assert abs(np.median(differences)) < 1.0


def test_what_is_not_voiced_has_no_pitch():
    noise = np.random.default_rng(3).normal(size=RATE) * 0.1
    frames = AudioFeatureExtractor().process(noise, 0.0)
    assert all(frame.pitch == 0.0 for frame in frames)
    assert max(frame.hnr for frame in frames) < 0.0


def test_silence_has_finite_descriptors():
    frames = AudioFeatureExtractor().process(np.zeros(RATE // 2, dtype=np.float32), 0.0)
    values = as_array(frames)
    assert len(frames) > 40 and np.isfinite(values).all()
    assert all(frame.zcr == frame.rms == frame.pitch == 0.0 and frame.hnr == HNR_RANGE_DB[0] for frame in frames)
    assert np.allclose([frame.mfcc for frame in frames], 0.0)


def test_clipped_sound_has_finite_descriptors():
    frames = AudioFeatureExtractor().process(np.clip(a_voice() * 50.0, -1.0, 1.0), 0.0)
    assert np.isfinite(as_array(frames)).all()
    assert np.median([frame.pitch for frame in frames]) * PITCH_UNIT_HZ == pytest.approx(140.0, rel=0.03)


def test_crossings_and_energy_of_a_sine():
    time = np.arange(RATE) / RATE
    frames = AudioFeatureExtractor().process(0.5 * np.sin(2.0 * np.pi * 410.0 * time + 0.1), 0.0)[3:-3]
    assert np.mean([frame.zcr for frame in frames]) == pytest.approx(2 * 410.0 / RATE, rel=0.03)
    assert np.mean([frame.rms for frame in frames]) == pytest.approx(0.5 / np.sqrt(2.0), rel=0.01)
    assert np.mean([frame.pitch for frame in frames]) == pytest.approx(0.82, rel=0.005)
    assert min(frame.hnr for frame in frames) > 40.0


@pytest.mark.parametrize("block", [1, 7, 160, 512, 1000])
def test_the_length_of_the_blocks_changes_nothing(block):
    sound = a_voice(0.2).astype(np.float32)
    whole = as_array(AudioFeatureExtractor().process(sound, 5.0))
    extractor = AudioFeatureExtractor()
    parts = [frame for place in range(0, len(sound), block)
             for frame in extractor.process(sound[place:place + block], 5.0 + place / RATE)]
    assert np.allclose(as_array(parts), whole, rtol=0.0, atol=1e-4)
    assert whole[:, 0] == pytest.approx(5.0 + 0.01 * np.arange(len(whole)), abs=1e-9)


@pytest.mark.parametrize("rate, step", [(100.0, 1), (50.0, 2), (33.0, 3), (10.0, 10), (1.0, 100)])
def test_a_lower_rate_leaves_frames_out(rate, step):
    sound = a_voice(1.2)
    whole = as_array(AudioFeatureExtractor().process(sound, 0.0))
    extractor = AudioFeatureExtractor(rate)
    some = as_array([frame for place in range(0, len(sound), 512)
                     for frame in extractor.process(sound[place:place + 512], place / RATE)])
    assert np.allclose(some, whole[::step][:len(some)], rtol=0.0, atol=1e-4)
    assert len(some) == len(whole[::step])


@pytest.mark.parametrize("rate", [0.0, -1.0, 101.0, float("nan")])
def test_other_rates_are_refused(rate):
    with pytest.raises(ValueError, match="1 to 100"):
        AudioFeatureExtractor(rate)


def test_after_a_gap_the_frames_start_anew():
    sound = a_voice(0.2)
    extractor = AudioFeatureExtractor()
    first = extractor.process(sound, 0.0)
    second = extractor.process(sound, 0.2 + 2.0 * GAP_S)
    assert len(second) == len(first) and second[0].stamp == pytest.approx(0.2 + 2.0 * GAP_S)
    again = extractor.process(sound, 0.1)
    assert again[0].stamp == pytest.approx(0.1)


def test_a_jitter_of_the_clock_is_no_gap():
    sound = a_voice(0.4)
    extractor, stamps = AudioFeatureExtractor(), []
    for number, place in enumerate(range(0, len(sound), 512)):
        jitter = 0.004 * (number % 2)
        stamps += [frame.stamp for frame in extractor.process(sound[place:place + 512], place / RATE + jitter)]
    assert len(stamps) == len(AudioFeatureExtractor().process(sound, 0.0))


@pytest.mark.parametrize("samples", [np.zeros((10, 2)), np.array([0.0, np.nan]), np.array([np.inf])])
def test_other_samples_are_refused(samples):
    with pytest.raises(ValueError, match="finite samples of one channel"):
        AudioFeatureExtractor().process(samples, 0.0)


def test_the_mel_filters_are_those_of_htk():
    filters = mel_filters(26, 257, 16000.0)
    assert filters.shape == (26, 257) and (filters.max(axis=1) > 0.5).all()
    # Between the first and the last centre the triangles add up to 1.
    edges = np.linspace(0.0, mel(8000.0), 28)
    places = mel(np.arange(257) * 31.25)
    inner = (places > edges[1]) & (places < edges[-2])
    assert filters.sum(axis=0)[inner] == pytest.approx(1.0)


def test_the_cepstra_are_those_of_another_library():
    pytest.importorskip("kaldi_native_fbank")
    sound = np.concatenate([a_voice(0.5, 120.0, 20.0), np.random.default_rng(4).normal(size=RATE // 2) * 0.05])
    reference = reference_cepstra(sound)
    frames = np.lib.stride_tricks.sliding_window_view(sound, 400)[::160][:len(reference)]
    own = MelCepstrum(400, RATE)(frames)
    assert np.abs(own - reference).max() < 0.01
    for number in range(12):
        assert np.corrcoef(own[:, number], reference[:, number])[0, 1] > 0.99999


def test_a_window_of_three_periods_is_enough():
    estimator = PitchEstimator(RATE)
    assert estimator.length == 640
    window = voiced(76.0, 0.2, VOWELS["u"])[800:800 + estimator.length]
    frequency, ratio = estimator(window[None, :] * 0.1)
    assert frequency[0] == pytest.approx(76.0, rel=0.01) and ratio[0] > 35.0
