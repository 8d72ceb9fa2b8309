"""The choice of a recogniser, its grammar, and what the processes say to each other."""

from __future__ import annotations

import importlib.util
import os

import numpy as np
import pytest

from hri_pipeline.core.asr import engines, worker
from hri_pipeline.core.asr.engines import (
    AUTO,
    DECODER,
    ENCODER,
    ENGINES,
    RATE,
    TOKENIZER,
    EngineChoice,
    LanguageError,
    check_choice,
    engine_choice,
    grammar_directory,
    make_engine,
    one_file,
    read_grammar,
)
from hri_pipeline.core.asr.pool import QueuedUtterance
from hri_pipeline.core.asr.recognition import SpeechRecognition
from hri_pipeline.core.asr.worker import MessageReader, PipeError, SpeechMessage, SpeechWorker
from hri_pipeline.core.audio.parameters import ENGINES as ENGINE_NAMES
from hri_pipeline.core.audio.parameters import SpeechSettings
from hri_pipeline.core.parameters import ParameterError

JSGF = "#JSGF V1.0; grammar g; public <g> = yes | no;"


@pytest.fixture
def all_packages(monkeypatch):
    """Every engine's package seems to be there."""
    monkeypatch.setattr(engines.importlib.util, "find_spec", lambda name: object())


def test_the_parameter_knows_the_engines():
    assert set(ENGINE_NAMES) == {"", AUTO} | set(ENGINES)


@pytest.mark.parametrize("choice, words", [
    (EngineChoice("sphinx"), ("speech_engine", "'sphinx'", "moonshine, pocketsphinx")),
    (EngineChoice("pocketsphinx", "/no/such/model"), ("speech_model", "'/no/such/model'", "pocketsphinx")),
    (EngineChoice("pocketsphinx", grammar="yes or no"), ("speech_grammar", "#JSGF")),
    (EngineChoice("moonshine", grammar=JSGF), ("speech_grammar", "moonshine", "auto")),
    (EngineChoice("moonshine", "/usr"), ("speech_model", "/usr", "encoder_model.onnx"))])
def test_a_choice_that_cannot_work_is_refused(all_packages, choice, words):
    with pytest.raises(ParameterError) as caught:
        check_choice(choice)
    assert all(word in str(caught.value) for word in words), str(caught.value)


@pytest.mark.parametrize("engine, package",
                         [("moonshine", "onnxruntime"), ("pocketsphinx", "pocketsphinx")])
def test_a_missing_package_is_named(monkeypatch, engine, package):
    monkeypatch.setattr(engines.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ParameterError, match="speech_engine.*`pip install {}`".format(package)):
        make_engine(EngineChoice(engine, "/"))


def test_a_directory_without_a_model_is_named(tmp_path):
    with pytest.raises(ParameterError, match="speech_model.*holds no .*mdef"):
        make_engine(EngineChoice("pocketsphinx", str(tmp_path)))
    for name in ("a.dict", "b.dict"):
        (tmp_path / name).write_text("x")
    with pytest.raises(ParameterError, match="2 files"):
        one_file(tmp_path, "*.dict")


@pytest.mark.skipif(importlib.util.find_spec("pocketsphinx") is None, reason="pocketsphinx is not there")
@pytest.mark.parametrize("grammar",
                         ["#JSGF V1.0; grammar g; public <g> = flubberwobbel;", "#JSGF V1.0; grammar g; <g> = yes;",
                          "#JSGF V1.0; grammar g; public <g> = ((;"])
def test_a_grammar_that_pocketsphinx_does_not_take_is_named(grammar):
    with pytest.raises(ParameterError, match="speech_grammar"):
        make_engine(EngineChoice("pocketsphinx", grammar=grammar))


def test_grammars_come_from_a_text_a_file_or_the_package(tmp_path):
    path = tmp_path / "mine.gram"
    path.write_text("\ufeff" + JSGF, encoding="utf-8")
    assert read_grammar("") == "" and read_grammar("  " + JSGF) == JSGF
    assert read_grammar(str(path)) == JSGF and read_grammar("mine", tmp_path) == JSGF
    for name in ("commands", "digits"):
        assert read_grammar(name, grammar_directory()).startswith("#JSGF")


def test_a_grammar_that_is_not_there_is_named(tmp_path):
    with pytest.raises(ParameterError, match="speech_grammar is 'orders'.*commands, digits"):
        read_grammar("orders", grammar_directory())
    (tmp_path / "binary.gram").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ParameterError, match="cannot be read"):
        read_grammar(str(tmp_path / "binary.gram"))
    (tmp_path / "long.gram").write_bytes(b"#" * 300000)
    with pytest.raises(ParameterError, match="300000 bytes"):
        read_grammar(str(tmp_path / "long.gram"))


def test_the_settings_make_a_choice():
    settings = SpeechSettings(speech_model="models/x", speech_grammar=JSGF, speech_language="en-GB",
                              speech_text="written")
    assert engine_choice(settings) == EngineChoice("pocketsphinx", os.path.abspath("models/x"), JSGF, "en-GB", True)


@pytest.mark.parametrize("given, tag", [
    ("en_GB.UTF-8", "en-GB"), ("pt_BR", "pt-BR"), ("de-DE", "de-DE"), (" es ", "es")])
def test_a_locale_is_taken_for_its_language_tag(given, tag):
    assert engine_choice(SpeechSettings(language=given)).language == tag


def test_free_speech_goes_to_moonshine_where_its_model_is_there(monkeypatch, tmp_path):
    def chosen(**changes):
        return engine_choice(SpeechSettings(**changes)).engine

    monkeypatch.setenv("ROS4HRI_MODELS", str(tmp_path))
    assert chosen() == "pocketsphinx"
    for name in (ENCODER, DECODER, TOKENIZER):
        assert chosen(speech_engine="moonshine") == "moonshine" and chosen() == "pocketsphinx"
        (tmp_path / name).write_bytes(b"x")
    assert chosen() == "moonshine" and chosen(speech_grammar=JSGF) == "pocketsphinx"
    assert chosen(speech_engine="pocketsphinx") == "pocketsphinx"
    mine = tmp_path / "mine"
    mine.mkdir()
    assert chosen(speech_model=str(mine)) == "pocketsphinx"
    for name in ("encoder_model.onnx", "decoder_model_merged.onnx", "tokenizer.json"):
        (mine / name).write_bytes(b"x")
    assert chosen(speech_model=str(mine)) == "moonshine"
    check_choice(EngineChoice("moonshine", str(mine), language="es"))


@pytest.mark.parametrize("engine", ["moonshine", "pocketsphinx", AUTO])
def test_the_language_picks_the_model_and_without_one_the_mend_is_named(monkeypatch, tmp_path, engine):
    monkeypatch.setenv("ROS4HRI_MODELS", str(tmp_path))

    def choice(**changes):
        return engine_choice(SpeechSettings(speech_engine=engine, **changes))

    with pytest.raises(LanguageError) as caught:
        check_choice(choice(language="es-MX"))
    words = ("'es-MX'", str(tmp_path / "moonshine_es"), str(tmp_path / "pocketsphinx_es"), "speech_model")
    assert all(word in str(caught.value) for word in words), str(caught.value)
    with pytest.raises(LanguageError):
        check_choice(choice(speech_language="de"))
    kind = "pocketsphinx" if engine == "pocketsphinx" else "moonshine"
    (tmp_path / (kind + "_es")).mkdir()
    for name in ("encoder_model.onnx", "decoder_model_merged.onnx", "tokenizer.json"):
        (tmp_path / (kind + "_es") / name).write_bytes(b"x")
    found = choice(language="es-MX", speech_language="de")
    assert (found.engine, found.model, found.language) == (kind, str(tmp_path / (kind + "_es")), "es-MX")
    check_choice(found)
    assert choice(language="EN_gb").model == ""


def test_a_model_of_moonshine_that_is_no_model_is_named(monkeypatch, tmp_path):
    monkeypatch.setenv("ROS4HRI_MODELS", str(tmp_path))
    with pytest.raises(ParameterError, match="moonshine.*fetch_models"):
        check_choice(EngineChoice("moonshine"))
    for name in (ENCODER, DECODER, TOKENIZER):
        (tmp_path / name).write_bytes(b"{}")
    with pytest.raises(ParameterError, match="moonshine.*vocabulary"):
        make_engine(EngineChoice("moonshine"))


def test_messages_come_out_as_they_went_in_however_they_are_cut():
    sent = [SpeechMessage(worker.CONFIGURE, body=b'{"engine": "moonshine"}'),
            SpeechMessage(worker.AUDIO, 4000000000, body=b"\x01\x02"),
            SpeechMessage(worker.FINAL, 7, 1600, 0.5, 0.25, "grüße".encode("utf-8")), SpeechMessage(worker.FINAL)]
    stream = b"".join(message.packed() for message in sent)
    for size in (1, 3, 64, 4096):
        reader, messages = MessageReader(), []
        for place in range(0, len(stream), size):
            messages += reader.feed(stream[place:place + size])
        assert messages == sent
    assert sent[2].text == "grüße"


def changed(place, value):
    data = bytearray(SpeechMessage(worker.FINAL, 1, 2, 0.5, 0.25, b"yes").packed())
    data[place:place + len(value)] = value
    return bytes(data)


@pytest.mark.parametrize("data", [
    b"I", b"INFO: loading model\n", b"\x00" * 16, b"HAL", changed(2, b"\x63"), changed(20, b"\xff\xff\xff\xff"),
    changed(12, np.array([np.nan], "<f4").tobytes()), changed(16, np.array([np.inf], "<f4").tobytes())])
def test_what_is_no_message_is_refused(data):
    with pytest.raises(PipeError):
        MessageReader().feed(data)


def test_numbers_outside_of_their_range_are_cut():
    message, = MessageReader().feed(SpeechMessage(worker.FINAL, 1, 2, 7.0, -1.0).packed())
    assert (message.confidence, message.busy) == (1.0, 0.0)


def test_a_body_that_is_too_long_is_refused():
    with pytest.raises(PipeError, match="too long"):
        SpeechMessage(worker.AUDIO, body=b"x" * (worker.LONGEST_BODY + 1)).packed()


@pytest.mark.parametrize("message", [
    SpeechMessage(worker.START, 1), SpeechMessage(worker.CONFIGURE, body=b"[1]"),
    SpeechMessage(worker.CONFIGURE, body=b"\xff"),
    SpeechMessage(worker.CONFIGURE, body=b'{"partial_rate": 3.0, "model": "x"}'),
    SpeechMessage(worker.CONFIGURE, body=b'{"partial_rate": 3.0, "engine": "moonshine", "colour": "red"}')])
def test_a_message_that_names_no_engine_is_refused(message):
    with pytest.raises(PipeError):
        SpeechWorker(lambda answer: None).answer(message)


def test_an_utterance_knows_when_its_sound_was_and_how_much_waits():
    utterance = QueuedUtterance(1, "abcde", 100.0, limit=1.0)
    block = np.zeros(RATE // 4, dtype="<i2").tobytes()
    assert [utterance.add(block, 100.0 + 0.25 * number) for number in range(5)] == [0, 0, 0, 0, RATE // 4]
    assert utterance.waiting == pytest.approx(1.0)
    utterance.take()
    assert utterance.progress(10 ** 6) == RATE // 4 and utterance.progress(100) == 0
    assert utterance.waiting == pytest.approx(0.75)
    assert utterance.stamp_of(RATE // 8) == pytest.approx(100.125)
    assert utterance.stamp_of(RATE // 2) == pytest.approx(100.5)
    assert utterance.add(block, 107.0) == 0
    assert utterance.stamp_of(utterance.accepted) == pytest.approx(107.25)
    utterance.rewind()
    assert utterance.waiting == pytest.approx(1.0) and len([data for data in iter(utterance.take, None)]) == 5


@pytest.mark.parametrize("step, end, spoken", [
    (0.032, 100.064, 2 * 512), (0.032, 100.08, 2 * 512 + 256), (0.032, 107.0, 5 * 512), (0.032, 99.0, 0),
    (1e-4, 100.0004, 4 * 512), (1e-4, 200.0, 5 * 512)])
def test_behind_its_end_nothing_was_said(step, end, spoken):
    """Late sound stands close together: most of it seemed to be behind the end of the turn, and its words were lost."""
    utterance = QueuedUtterance(1, "abcde", 100.0, limit=10.0)
    block = np.zeros(512, dtype="<i2").tobytes()
    for number in range(5):
        utterance.add(block, 100.0 + step * number)
    utterance.spoken = utterance.accepted
    utterance.end_at(end)
    assert utterance.spoken == spoken


def test_silence_around_the_words_is_left_out():
    random = np.random.default_rng(0)
    speech, margin = 16000, 8 * 320
    samples = random.normal(size=RATE * 4) * 3.0
    samples[RATE:RATE + speech] += random.normal(size=speech) * 3000.0
    samples = samples.astype("<i2")
    left = np.frombuffer(engines._trim_silence(samples.tobytes()), "<i2")
    assert len(left) == speech + 2 * margin and np.array_equal(left, samples[RATE - margin:RATE + speech + margin])
    for data in (b"", b"\x00\x00" * 100, b"\x00\x00" * 16000):
        assert engines._trim_silence(data) == data


def test_a_pause_is_told_once_and_in_its_place():
    utterance = QueuedUtterance(1, "abcde", 100.0, limit=10.0)
    block = np.zeros(512, dtype="<i2").tobytes()
    for speaking in [True] * 3 + [False] * 8 + [True] * 2 + [False] * 6:
        utterance.add(block, 100.0)
        SpeechRecognition._note_pause(utterance, speaking, 512)
    taken = list(iter(utterance.take, None))
    assert [number for number, data in enumerate(taken) if not data] == [8, 19]
    assert utterance.spoken == 13 * 512 and utterance.sent == utterance.accepted == 19 * 512


def test_the_worker_makes_the_text_ready_in_a_pause(monkeypatch):
    class Engine:
        def __init__(self):
            self.calls = []

        def __getattr__(self, name):
            return lambda *arguments: (self.calls.append((name, *arguments[name == "feed":])),
                                       ("so far" if name == "partial" else ("all", 0.5)))[1]

    engine, sent = Engine(), []
    monkeypatch.setattr(worker, "make_engine", lambda choice: engine)
    speech = SpeechWorker(sent.append)
    for message in (SpeechMessage(worker.CONFIGURE, body=b'{"partial_rate": 3.0, "engine": "moonshine"}'),
                    SpeechMessage(worker.START, 7), SpeechMessage(worker.AUDIO, 7, body=b"\x00" * 1000),
                    SpeechMessage(worker.PAUSE, 7), SpeechMessage(worker.END, 7, 400)):
        speech.answer(message)
    assert engine.calls == [("start",), ("feed",), ("pause",), ("partial",), ("finish", 400)]
    del engine.calls[:]
    speech.answer(SpeechMessage(worker.START, 8))
    for more in (True, True, False):
        speech.answer(SpeechMessage(worker.AUDIO, 8, body=b"\x00" * 40000), more)
    assert engine.calls == [("start",), ("feed",), ("feed",), ("feed",), ("partial",)], "no text while sound waits"
    del sent[4:]
    kinds = [(message.kind, message.text) for message in MessageReader().feed(b"".join(sent))]
    assert kinds == [(worker.READY, ""), (worker.PROGRESS, ""), (worker.PARTIAL, "so far"), (worker.FINAL, "all")]
