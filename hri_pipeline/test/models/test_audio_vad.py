"""The network of voice activity: batches, states, and files that are not it."""

import numpy as np
import pytest

from benchmarks import speech_files
from hri_pipeline.core.audio.vad import FRAME, ActivityModel, ActivityState
from hri_pipeline.core.onnx import ModelError, model_path, models_directory


@pytest.fixture(scope="module")
def model():
    return ActivityModel(model_path("", "silero_vad.onnx"))


def frames(count, seed=0):
    return (np.random.default_rng(seed).standard_normal((count, FRAME)) * 0.05).astype(np.float32)


def speech(name="goforward.raw"):
    if not speech_files.available():
        pytest.skip(speech_files.ABSENT)
    samples = speech_files.read_speech([name])[name]
    return samples[:len(samples) // FRAME * FRAME].reshape(-1, FRAME).astype(np.float32)


def probabilities(model, sounds, states=None):
    states = states or [ActivityState() for _ in sounds]
    return np.array([model.probabilities(np.stack(rows), states) for rows in zip(*sounds)]).T


def test_speech_and_what_is_none(model):
    sound = speech()
    (found,) = probabilities(model, [sound])
    assert (found > 0.9).mean() > 0.4 and found.max() <= 1.0 and found.min() >= 0.0
    assert probabilities(model, [frames(len(sound))]).max() < 0.2
    assert probabilities(model, [np.zeros((30, FRAME), np.float32)]).max() < 0.2


def test_sources_of_a_batch_do_not_influence_each_other(model):
    sound = speech()
    others = [frames(len(sound)), sound[::-1].copy(), np.zeros_like(sound)]
    together = probabilities(model, [sound] + others)
    for row, alone in enumerate([sound] + others):
        np.testing.assert_allclose(together[row], probabilities(model, [alone])[0], atol=1e-5)


def test_a_state_belongs_to_its_source(model):
    """Frames of two sources in turns give what each gives alone; sources may change their places in a batch."""
    first, second = speech(), speech("something.raw")
    count = min(len(first), len(second))
    one, two = ActivityState(), ActivityState()
    found = np.zeros((2, count))
    for index in range(count):
        pair = [(first[index], one, 0), (second[index], two, 1)][::1 if index % 2 else -1]
        values = model.probabilities(np.stack([row[0] for row in pair]), [row[1] for row in pair])
        for value, row in zip(values, pair):
            found[row[2], index] = value
    np.testing.assert_allclose(found[0], probabilities(model, [first[:count]])[0], atol=1e-5)
    np.testing.assert_allclose(found[1], probabilities(model, [second[:count]])[0], atol=1e-5)


def test_a_state_can_start_afresh(model):
    sound, state = speech(), ActivityState()
    before = probabilities(model, [sound], [state])
    state.reset()
    np.testing.assert_array_equal(probabilities(model, [sound], [state]), before)


def test_samples_that_are_no_numbers_do_not_deafen(model):
    sound = speech()
    broken = np.stack([np.full(FRAME, np.nan), np.full(FRAME, np.inf)]).astype(np.float32)
    state = ActivityState()
    assert np.isfinite(probabilities(model, [broken], [state])).all()
    after = probabilities(model, [np.concatenate((np.zeros((30, FRAME), np.float32), sound))], [state])[0, 30:]
    assert (after > 0.9).mean() > 0.4


@pytest.mark.parametrize("shape, states", [((1, 160), 1), ((512,), 1), ((2, 512), 1), ((1, 512), 2)])
def test_other_shapes_are_refused(model, shape, states):
    with pytest.raises(ValueError, match="wanted are {} frames of 512".format(states)):
        model.probabilities(np.zeros(shape, np.float32), [ActivityState() for _ in range(states)])


def test_no_source_is_no_work(model):
    assert model.probabilities(np.zeros((0, FRAME), np.float32), []).shape == (0,)


def test_files_that_are_not_the_network_say_the_mend(tmp_path):
    with pytest.raises(ModelError, match="silero_vad.onnx does not exist.*fetch_models"):
        ActivityModel(tmp_path / "silero_vad.onnx")
    (tmp_path / "damaged.onnx").write_bytes(b"not a network")
    with pytest.raises(ModelError, match="damaged.onnx cannot be loaded"):
        ActivityModel(tmp_path / "damaged.onnx")
    with pytest.raises(ModelError, match="it is another model.*fetch_models"):
        ActivityModel(models_directory() / "face_expression.onnx")
