"""Activity and turns on real speech and on noises, with the real network, and the labels they are judged by."""

import numpy as np
import pytest

from benchmarks import speech_files, voice_figures
from hri_pipeline.core.audio.pipeline import VoicePipeline
from hri_pipeline.core.ids import IdGenerator

RATE = voice_figures.RATE
NEEDS_SPEECH = pytest.mark.skipif(not speech_files.available(), reason=speech_files.ABSENT)


def stage(**changes):
    return VoicePipeline(voice_figures.activity_settings(**changes), voice_figures.activity_model(), None,
                         IdGenerator(seed=5))


def observe(samples, **changes):
    return [seen for _, _, found in voice_figures.run_stage(stage(**changes), samples) for seen in found]


def test_labels_are_where_the_sound_is():
    samples = np.concatenate([np.zeros(8000), 0.5 * np.sin(np.arange(8000) * 0.2), np.zeros(8000)])
    labels = voice_figures.energy_labels(samples)
    edges = np.flatnonzero(np.diff(labels.astype(int)))
    assert len(edges) == 2 and abs(edges[0] - 8000) <= 200 and abs(edges[1] - 16000) <= 200


def test_noise_of_a_scene_is_as_loud_as_asked_for():
    recordings = {"tone": 0.3 * np.sin(np.arange(32000) * 0.3)}
    scene = voice_figures.make_scene(recordings, 10.0, seed=1)
    ratio = np.mean(scene.samples[scene.labels] ** 2) / np.mean(scene.samples[~scene.labels] ** 2)
    assert 10.0 * np.log10(ratio - 1.0) == pytest.approx(10.0, abs=0.3)
    assert len(scene.onsets) == 1


def test_figures_measure_something():
    """A stage that never speaks has neither hits nor false alarms, and misses every onset."""
    recordings = {"tone": 0.3 * np.sin(np.arange(32000) * 0.3)}
    scenes, model = [voice_figures.make_scene(recordings, None, seed=1)], voice_figures.activity_model()
    deaf = voice_figures.activity_settings(birth_threshold=0.99, clear_birth_threshold=0.99, onset_time=1.0)
    assert voice_figures.frame_rates(scenes, model, deaf) == {"tpr": 0.0, "fpr": 0.0}
    assert list(voice_figures.onset_delays_ms(scenes, model, deaf)) == [1000.0]


@NEEDS_SPEECH
@pytest.mark.parametrize("names", [speech_files.TUNING_FILES, speech_files.HELD_OUT_FILES], ids=["tuning", "held out"])
def test_activity_on_real_speech(names):
    figures = voice_figures.vad(names, seeds=(4,))
    for snr, least in (("clean", 0.95), ("10", 0.93), ("0", 0.80)):
        assert figures[snr]["tpr"] >= least, "{} dB: {}".format(snr, figures)
        assert figures[snr]["fpr"] <= 0.10, "{} dB: {}".format(snr, figures)


@NEEDS_SPEECH
def test_the_sound_of_a_turn_begins_before_the_word():
    """The first sound of each recording, as labelled, lies in the sound of the turn in nine of ten."""
    scene = voice_figures.make_scene(speech_files.read_speech(), None, seed=2)
    begins = np.array([(seen.stamp, seen.stamp + 0.232) for seen in observe(scene.samples) if seen.onset])
    inside = [np.any((begins[:, 0] <= onset / RATE) & (onset / RATE < begins[:, 1])) for onset in scene.onsets]
    assert len(inside) >= 10 and np.mean(inside) >= 0.9


@NEEDS_SPEECH
def test_every_recording_is_a_voice_and_pauses_are_none():
    recordings = speech_files.read_speech()
    scene = voice_figures.make_scene(recordings, 10.0, seed=3)
    found = observe(scene.samples, resume_time=0.9)
    assert len({seen.id for seen in found}) == len(recordings), "pauses of 1 s and more are between them"


@NEEDS_SPEECH
def test_the_level_of_the_microphone_does_not_matter():
    scene = voice_figures.make_scene(speech_files.read_speech(speech_files.HELD_OUT_FILES), 20.0, seed=6)
    counts = [sum(seen.speaking for seen in observe(scene.samples * gain)) for gain in (1.0, 0.1, 0.01)]
    assert max(counts) < 1.1 * min(counts)


def noises(random):
    """{name: sound of 0.5 s} that a robot hears and that are no speech."""
    time = np.arange(RATE // 2) / RATE
    white = random.standard_normal(len(time))
    return {"hiss": 0.1 * white, "clap": 0.5 * white * np.exp(-time / 0.02), "slam": 0.5 * white * np.exp(-time / 0.1),
            "knock": np.convolve(white, np.exp(-np.arange(200) / 20.0), "same") * np.exp(-time / 0.05) * 0.05,
            "motor": 0.1 * np.sign(np.sin(2 * np.pi * 100.0 * time)), "ticks": 0.3 * (np.arange(len(time)) % 1600 < 20),
            "fan": 0.1 * white * (1.0 + np.sin(2 * np.pi * 4.0 * time))}


@pytest.mark.parametrize("name", sorted(noises(np.random.default_rng(0))))
def test_noises_are_no_voices(name):
    random = np.random.default_rng(7)
    pieces = [random.standard_normal(RATE) * 1e-3]
    for _ in range(10):
        pieces += [noises(random)[name], random.standard_normal(int(random.integers(8000, 16000))) * 1e-3]
    found = observe(np.clip(np.concatenate(pieces), -1.0, 1.0).astype(np.float32))
    assert not [seen.id for seen in found if seen.onset]
