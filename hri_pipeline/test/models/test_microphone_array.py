"""Direction and separation of real speech in simulated rooms, on a small part of what the benchmark does."""

import numpy as np
import pytest

from benchmarks import microphone_array as array_figures
from benchmarks.microphone_array import azimuth_errors, make_scene
from benchmarks.room import Room, images_at, with_noise
from benchmarks.speech import TurnReader
from benchmarks.speech_files import ABSENT, RATE, available, read_speech
from benchmarks.voice_figures import SQUARE, activity_model, blocks
from hri_pipeline.core.asr.engines import EngineChoice, make_engine
from hri_pipeline.core.audio.parameters import VOICES
from hri_pipeline.core.audio.pipeline import VoicePipeline
from hri_pipeline.core.audio.separation import SoundSeparator

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


@pytest.mark.slow
def test_texts_of_two_who_answer_each_other_belong_to_their_voices():
    """From the left somebody speaks of ten meters, from the right somebody of numbers, with pauses of 0.2 s."""
    speech, centre = read_speech(("goforward.raw", "numbers.raw")), np.array([3.0, 2.4, 1.2])
    words = [{"forward", "ten", "meters"}, {"thirty", "33", "ninety", "92"}]
    voices = [[], []]
    for turn in range(4):
        said = list(speech.values())[turn % 2]
        said = np.concatenate([said * (0.3 / np.abs(said).max()), np.zeros(RATE // 5)])
        voices[turn % 2].append(said)
        voices[1 - turn % 2].append(np.zeros(len(said)))
    room = Room((6.0, 5.0, 3.0), 0.4)
    tracks = [np.concatenate([np.zeros(RATE)] + voice + [np.zeros(RATE)]) for voice in voices]
    images = [images_at(room.responses(centre + place, SQUARE + centre), track)
              for place, track in zip(([0.4, 1.4, 0.2], [0.3, -1.3, 0.3]), tracks)]
    settings = VOICES.resolve({})
    pipeline = VoicePipeline(settings, activity_model(), SoundSeparator(SQUARE, settings))
    engines, texts, sides = {}, {}, {}
    for block in blocks(with_noise(images, 20.0, np.random.RandomState(1)).astype(np.float32)):
        for seen in pipeline.update(block):
            if seen.id not in engines:
                engines[seen.id] = TurnReader(make_engine(EngineChoice("moonshine")))
            text = engines[seen.id].add(seen)
            sides.setdefault(seen.id, []).append(seen.direction[1] < 0.0)
            texts.setdefault(seen.id, []).extend(text.text.lower().replace("-", " ").split() if text else [])
    found = [set(), set()]
    for name, told in texts.items():
        found[int(np.mean(sides[name]) > 0.5)].update(word.strip(".,!") for word in told)
    for side in (0, 1):
        assert found[side] & words[side] and not found[side] & words[1 - side], found
