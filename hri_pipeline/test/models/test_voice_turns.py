"""Changes of the speaker at one microphone, with the real networks and recordings."""

import numpy as np
import pytest

from benchmarks import speech_files, voice_turns
from hri_pipeline.core.asr.engines import EngineChoice, make_engine
from hri_pipeline.core.audio.speakers import DIMENSION, MODEL_FILE, SpeakerEmbedder
from hri_pipeline.core.audio.stream import encode_s16
from hri_pipeline.core.onnx import model_path

pytestmark = [pytest.mark.slow,
              pytest.mark.skipif(not speech_files.available(), reason=speech_files.ABSENT)]
LIBRIVOX, COMMAND = "librivox/sense_and_sensibility_01_austen_64kb-0880.wav", "goforward.raw"


def int16(samples):
    return np.frombuffer(encode_s16(0.5 * samples / np.abs(samples).max()), np.int16)


def test_sounds_of_one_speaker_are_alike_and_of_two_are_not():
    embedder = SpeakerEmbedder(model_path("", MODEL_FILE))
    speech = speech_files.read_speech()
    pieces = [sound[begin:begin + 32000] for name, sound in speech.items() if "librivox" in name
              for begin in (0, 32000)] + [speech["numbers.raw"][8000:40000]]
    found = embedder.embed(np.stack([piece for piece in pieces if len(piece) == 32000]))
    assert found.shape == (len(found), DIMENSION)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, atol=1e-4)
    products = found @ found.T
    own = products[:-1, :-1][np.triu_indices(len(found) - 1, 1)]
    assert np.median(own) > 0.7 and products[-1, :-1].max() < np.percentile(own, 10)


def test_most_changes_of_the_speaker_end_a_turn():
    figures = voice_turns.figures(3)
    assert figures["turns_mixed"] <= 0.5 < 0.8 <= figures["turns_mixed_without"]
    assert figures["turns_cut"] <= 0.1


def test_the_text_ends_where_the_other_speaker_begins():
    """The recogniser has transcribed words of both before it is told that the second ones are somebody else's."""
    speech = speech_files.read_speech((LIBRIVOX, COMMAND))
    own, other = int16(speech[COMMAND]), int16(speech[LIBRIVOX])[:32000]
    engine = make_engine(EngineChoice("moonshine"))
    try:
        engine.feed(own)
        engine.feed(other)
        engine.pause()
        both = engine.finish(len(own) + len(other)).text
        engine.feed(own)
        engine.feed(other)
        engine.pause()
        assert engine.finish(len(own)).text == "go forward ten meters" != both
    finally:
        engine.close()


@pytest.mark.parametrize("name", ["moonshine", "pocketsphinx"])
def test_a_turn_that_was_all_another_voices_has_no_text(name):
    if name == "pocketsphinx":
        pytest.importorskip("pocketsphinx")
    own = int16(speech_files.read_speech((COMMAND,))[COMMAND])
    engine = make_engine(EngineChoice(name))
    try:
        engine.start()
        engine.feed(own[:22000])
        assert engine.partial() == "go forward"
        engine.pause()
        assert engine.finish(0).text == ""
        engine.start()
        engine.feed(own)
        engine.pause()
        assert "go forward" in engine.finish(len(own)).text
    finally:
        engine.close()
