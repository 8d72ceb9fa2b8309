"""What is around Moonshine's networks: vocabulary, loops, cuts, texts so far. The networks are played by others."""

from __future__ import annotations

import json

import numpy as np
import pytest

from hri_pipeline.core.asr import moonshine
from hri_pipeline.core.asr.engines import RATE, EngineChoice
from hri_pipeline.core.asr.moonshine import (
    CUT_AT_S,
    CUT_FROM_S,
    MoonshineEngine,
    MoonshineModel,
    Tokenizer,
    Transcript,
    plain_words,
)
from hri_pipeline.core.onnx import ModelError

PIECES = {"<unk>": 0, "<s>": 1, "</s>": 2, "<0xC3>": 3, "<0xBC>": 4, "\u2581yes": 5, "\u2581gr": 6, "n": 7, ".": 8}


@pytest.fixture
def tokenizer(tmp_path):
    path = tmp_path / "tokenizer.json"
    path.write_text(json.dumps({"model": {"vocab": PIECES}}), encoding="utf-8")
    return Tokenizer(path)


def test_tokens_become_text(tokenizer):
    assert tokenizer.text([1, 5, 6, 3, 4, 7, 8, 2]) == "yes gr\u00fcn."
    assert tokenizer.text([]) == "" and tokenizer.text([3]) == "" and tokenizer.text([32000, 5]) == "yes"


@pytest.mark.parametrize("text", ["", "{}", '{"model": {"vocab": [1]}}', '{"model": []}'])
def test_a_file_without_a_vocabulary_is_named(tmp_path, text):
    path = tmp_path / "tokenizer.json"
    path.write_text(text)
    with pytest.raises(ModelError, match="tokenizer.json"):
        Tokenizer(path)


@pytest.mark.parametrize("written, plain", [
    ("Yes, I'm 3.5 km away!", "yes i'm 3.5 km away"), ('"Rear" right.', "rear right"), ("", ""), (" . ", ""),
    ("Cold-hearted \u2014 at 10:30, 5% of $2.", "cold hearted at 10:30 5% of $2"), ("Gr\u00fcn?", "gr\u00fcn")])
def test_plain_words(written, plain):
    assert plain_words(written) == plain


@pytest.mark.parametrize("tokens, length", [
    ([5] * 4, 1), ([5] * 3, 0), ([6, 5, 6, 5, 6, 5, 6, 5], 2), ([1, 2, 3] * 4, 3), ([1, 2, 3, 4], 0),
    (list(range(9)) * 4, 0)])
def test_a_loop_is_a_run_that_comes_four_times(tokens, length):
    assert moonshine._loop(tokens) == length


class Networks(MoonshineModel):
    """Its decoder tells the rows of a table, one after the other: {token: probability}."""

    def __init__(self, tokenizer, rows):
        self._tokenizer, self._rows, self._empty = tokenizer, rows, {}
        self._encoder = self

    def run(self, feed):
        self.step = 0
        return {"last_hidden_state": feed["input_values"]}

    def _step(self, token, hidden, past, cached):
        logits = np.full(16, -30.0)
        for number, probability in self._rows[min(self.step, len(self._rows) - 1)].items():
            logits[number] = np.log(probability)
        self.step += 1
        return logits, past


def test_the_words_and_how_sure_they_are(tokenizer):
    found = Networks(tokenizer, [{5: 0.5, 6: 0.5 - 1e-9}, {8: 0.8, 5: 0.2}, {2: 1.0}]).transcribe(np.zeros(RATE))
    assert found.text == "yes." and found.whole and found.tokens == 3
    assert found.log_probability == pytest.approx(np.log(0.5 * 0.8), abs=1e-3)


def test_nothing_is_told_only_when_the_decoder_is_sure_of_it(tokenizer):
    assert Networks(tokenizer, [{2: 0.95, 5: 0.05}]).transcribe(np.zeros(RATE)).text == ""
    found = Networks(tokenizer, [{2: 0.8, 5: 0.2}, {2: 1.0}]).transcribe(np.zeros(RATE))
    assert found.text == "yes" and found.log_probability == pytest.approx(np.log(0.2), abs=1e-3)


def test_a_decoder_that_finds_no_end_is_stopped(tokenizer):
    looping = Networks(tokenizer, [{5: 1.0}]).transcribe(np.zeros(10 * RATE))
    assert looping.text == "yes" and not looping.whole
    rows = [{5 + number % 3: 1.0} if number % 7 else {8: 1.0} for number in range(100)]
    endless = Networks(tokenizer, rows).transcribe(np.zeros(2 * RATE))
    assert not endless.whole and endless.tokens == int(6.5 * 2)


class Hearing:
    """Writes the length of each piece, in tenths of a second, and counts the calls."""

    def __init__(self):
        self.heard = []

    def transcribe(self, samples):
        self.heard.append(len(samples))
        return Transcript("W{}.".format(round(10 * len(samples) / RATE)), -0.1, 2, True)


@pytest.fixture
def engine(monkeypatch):
    monkeypatch.setattr(moonshine, "MoonshineModel", lambda *paths: Hearing())
    monkeypatch.setattr(moonshine, "model_files", lambda directory: ())
    return MoonshineEngine(EngineChoice("moonshine"))


def speech(seconds, level=3000.0):
    return (np.random.default_rng(0).normal(size=int(seconds * RATE)) * level).astype(np.int16)


def feed(engine, sound):
    for place in range(0, len(sound), 512):
        engine.feed(sound[place:place + 512])


def test_short_sound_gets_silence_and_nothing_gives_nothing(engine):
    assert engine.partial() == "" and engine.finish(10 ** 9) == ("", 0.0)
    feed(engine, speech(0.4))
    assert engine.partial() == ""
    assert engine.finish(10 ** 9).text == "w7"


def test_text_so_far_comes_when_it_is_worth_it_and_is_used_at_the_end(engine):
    feed(engine, speech(1.5))
    assert engine.partial() == "w15"
    engine._cost = 0.02       # s for a second of sound: 0.48 s must be new of 1.9 s, 0.63 s of 2.5 s
    feed(engine, speech(0.4))
    assert engine.partial() == "w15"
    feed(engine, speech(0.6))
    assert engine.partial() == "w25"
    feed(engine, speech(0.5, 1.0))
    assert engine.finish(10 ** 9).text == "w25" and len(engine._model.heard) == 2


def test_the_text_of_a_pause_is_that_of_the_end_unless_somebody_went_on(engine):
    feed(engine, speech(2.0))
    engine._cost = 100.0
    assert engine.partial() == ""
    engine.pause()
    assert engine.partial() == "w20"
    feed(engine, speech(0.4))      # loud, but it was no speech
    assert engine.finish(2 * RATE).text == "w20" and len(engine._model.heard) == 1
    feed(engine, speech(2.0))
    engine.pause()
    feed(engine, speech(0.4))
    assert engine.finish(int(2.2 * RATE)).text == "w24" and len(engine._model.heard) == 3


def test_the_end_of_speech_counts_from_the_begin_of_the_utterance(engine):
    long = np.concatenate([speech(CUT_FROM_S - 1.0), speech(0.4, 1.0), speech(3.0)])
    for said_more in (False, True):
        del engine._model.heard[:]
        feed(engine, long)
        engine.pause()
        feed(engine, speech(0.4))
        engine.finish(len(long) + said_more * RATE // 4)
        assert len(engine._model.heard) == 2 + said_more


def test_long_speech_is_cut_at_a_pause_and_joined(engine):
    feed(engine, np.concatenate([speech(CUT_FROM_S - 1.0), speech(0.4, 1.0), speech(3.0)]))
    text, confidence = engine.finish(10 ** 9)
    first, second = (int(word[1:]) for word in text.split())
    assert first == pytest.approx(10 * (CUT_FROM_S - 0.8), abs=2) and first + second == pytest.approx(84, abs=1)
    assert 0.0 < confidence < 1.0


def test_a_cut_in_the_pause_that_was_transcribed_costs_nothing(engine):
    feed(engine, speech(CUT_FROM_S - 0.3))
    feed(engine, speech(0.2, 1.0))
    engine.pause()
    feed(engine, speech(0.4, 1.0))
    assert engine.partial() == engine.finish(int((CUT_FROM_S - 0.3) * RATE)).text == "w59"
    assert len(engine._model.heard) == 1


def test_speech_without_a_pause_is_cut_before_it_is_too_long(engine):
    feed(engine, speech(3 * CUT_AT_S))
    engine.finish(10 ** 9)
    assert max(engine._model.heard) <= CUT_AT_S * RATE and len(engine._model.heard) >= 3
    assert sum(engine._model.heard) == pytest.approx(3 * CUT_AT_S * RATE, abs=RATE)


def test_the_next_utterance_begins_anew(engine):
    feed(engine, speech(2.0))
    engine.start()
    feed(engine, speech(1.0))
    assert engine.finish(10 ** 9).text == "w10" and engine.finish(10 ** 9).text == ""
    engine.close()
    engine.close()


def test_a_piece_of_little_confidence_is_left_out(engine):
    engine._model.transcribe = lambda samples: Transcript("you", -3.0, 3, True)
    feed(engine, speech(2.0))
    assert engine.partial() == "" and engine.finish(10 ** 9) == ("", 0.0)


def test_less_sure_tokens_make_less_confidence():
    sure, unsure = (moonshine._confidence([Transcript("a", total, 5, True)]) for total in (-0.1, -5.0))
    looped = moonshine._confidence([Transcript("a", -0.1, 5, False)])
    assert 0.0 < unsure < sure < 1.0 and looped < sure
