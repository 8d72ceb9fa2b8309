"""Free speech by Moonshine on Debian's recordings: words, silence where nobody speaks, and the process."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.speech_files import ABSENT, available, read_speech
from hri_pipeline.core.asr.engines import RATE, EngineChoice, make_engine, model_files
from hri_pipeline.core.audio.stream import encode_s16
from hri_pipeline.core.onnx import ModelError

try:
    model_files("")
except ModelError as missing:
    pytest.skip(str(missing), allow_module_level=True)

SENTENCE = "librivox/sense_and_sensibility_01_austen_64kb-0930.wav"


@pytest.fixture(scope="module")
def engines():
    made = {written: make_engine(EngineChoice("moonshine", written=written)) for written in (False, True)}
    yield made
    for engine in made.values():
        engine.close()


def recognise(engine, samples):
    engine.start()
    data = np.frombuffer(encode_s16(samples), "<i2")
    partial = []
    for place in range(0, len(data), RATE // 3):
        engine.feed(data[place:place + RATE // 3])
        partial.append(engine.partial())
    return engine.finish(len(data)), [text for text in partial if text]


@pytest.mark.skipif(not available(), reason=ABSENT)
def test_a_sentence_grows_and_is_right(engines):
    found, partial = recognise(engines[False], read_speech([SENTENCE])[SENTENCE])
    assert found.text == "he might even have been made amiable himself" and found.confidence > 0.5
    assert len(partial) >= 2 and partial[0].startswith("he")
    written, _ = recognise(engines[True], read_speech([SENTENCE])[SENTENCE])
    assert written.text == "He might even have been made amiable himself."


@pytest.mark.parametrize("seconds", [0.05, 0.5, 2.0, 7.0])
def test_noise_says_nothing(engines, seconds):
    noise = 0.05 * np.random.default_rng(3).standard_normal(int(seconds * RATE))
    found, partial = recognise(engines[False], noise)
    assert found == ("", 0.0) and not partial
    assert recognise(engines[False], np.zeros(int(seconds * RATE)))[0] == ("", 0.0)
