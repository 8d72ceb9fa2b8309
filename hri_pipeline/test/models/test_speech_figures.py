"""Figures of recognition and descriptors that must not get worse."""

from __future__ import annotations

import pytest

from benchmarks import speech as speech_figures
from benchmarks import voice_features as feature_figures
from benchmarks.speech_files import ABSENT, HELD_OUT_FILES, available


@pytest.fixture(scope="module")
def grammar():
    pytest.importorskip("pocketsphinx")
    if not available():
        pytest.skip(ABSENT)
    return {task.name: speech_figures.measure(task) for task in speech_figures.grammar_tasks()}


def test_digits_and_commands_with_a_grammar(grammar):
    errors, words = (sum(getattr(outcome, field) for outcome in grammar.values()) for field in ("errors", "words"))
    assert words >= 34 and errors / words <= 0.05


def test_every_sentence_of_a_grammar_is_sure_enough_to_be_published(grammar):
    confidences = [confidence for outcome in grammar.values() for _, _, confidence in outcome.texts]
    assert len(confidences) >= 5 and min(confidences) > 0.05


def test_other_sentences_are_not_taken_for_commands(grammar):
    assert speech_figures.false_commands().startswith("0 of ")


def test_free_speech_is_understood():
    if not available():
        pytest.skip(ABSENT)
    outcome = speech_figures.dictate(speech_figures.dictation_task(HELD_OUT_FILES), False, [speech_figures.FIRST_SEED])
    assert outcome.words >= 45 and outcome.errors / outcome.words <= 0.12


def test_descriptors_of_known_voices():
    found = feature_figures.voice_figures()
    assert found["f0_error_percent"] <= 3.0 and found["hnr_error_db"] <= 1.0
    assert found["f0_wrong_frames"] < 0.01 and found["noise_voiced"] == 0.0


def test_cepstra_of_real_speech_are_those_of_another_library():
    pytest.importorskip("kaldi_native_fbank")
    if not available():
        pytest.skip(ABSENT)
    found = feature_figures.cepstrum_figures()
    assert found["mfcc_max_difference"] < 0.01 and found["mfcc_least_correlation"] > 0.99999
