"""Direction and separation of real speech in simulated rooms, on a small part of what the benchmark does."""

import numpy as np
import pytest

from benchmarks import microphone_array as array_figures
from benchmarks.microphone_array import azimuth_errors, make_scene
from benchmarks.speech_files import ABSENT, available

pytestmark = pytest.mark.skipif(not available(), reason=ABSENT)


def test_scenes_are_as_told():
    scene = make_scene(2000, 2, seconds=2.0)
    assert scene.sound.shape == (3 * 16000, 4) and len(scene.images) == 2
    assert not scene.speaking[:, :int(0.95 * 16000)].any() and scene.speaking[:, 16000:].mean() > 0.5
    assert azimuth_errors(scene.directions[0], scene.directions[1]) >= np.radians(45.0)
    levels = [np.mean(image.mean(axis=1)[speaking] ** 2) for image, speaking in zip(scene.images, scene.speaking)]
    assert 0.5 < levels[0] / levels[1] < 2.0
    in_turns = make_scene(2000, 2, seconds=4.0, taking_turns=True)
    assert in_turns.speaking.all(axis=0).mean() < 0.05
    np.testing.assert_array_equal(make_scene(2000, 2, seconds=2.0).sound, scene.sound)


def test_one_speaker_is_found_and_cleaned():
    found = array_figures.figures_of(1, range(2000, 2002))
    assert found["error_median"] <= 5.0 and found["kept"] > 0.9 and found["gain_mean"] > 5.0


def test_two_speakers_are_found_kept_apart_and_separated():
    found = array_figures.figures_of(2, range(2000, 2002))
    assert found["error_median"] <= 10.0 and found["kept"] >= 0.9 and found["gain_mean"] > 3.5


def test_the_signal_to_distortion_ratio_ignores_the_scale():
    random = np.random.RandomState(0)
    reference, other = random.standard_normal((2, 16000))
    other -= (other @ reference) / (reference @ reference) * reference
    estimate = reference + other * 0.1 * np.linalg.norm(reference) / np.linalg.norm(other)
    assert array_figures.si_sdr(estimate, reference) == pytest.approx(20.0, abs=1e-6)
    assert array_figures.si_sdr(-3.0 * estimate, reference) == pytest.approx(20.0, abs=1e-6)
