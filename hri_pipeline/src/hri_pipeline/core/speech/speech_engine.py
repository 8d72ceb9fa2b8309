"""What a recogniser of speech can do, whatever package it is made of, and how one is chosen."""

from __future__ import annotations

import importlib
import importlib.util
from pathlib import Path
from typing import Any, Dict, NamedTuple, Protocol

import numpy as np

from hri_pipeline.core.parameters import ParameterError

RATE = 16000
OFF = ""


class EngineChoice(NamedTuple):
    """Which recogniser, with which model; the fields are the parameters speech_engine, speech_model, ...

    model: directory, empty for the one that comes with the engine. grammar: text of a grammar, empty for dictation.
    language: IETF tag.
    """

    engine: str
    model: str = ""
    grammar: str = ""
    language: str = "en-US"


class Recognised(NamedTuple):
    """What was said; confidence from 0 to 1, as the engine understands it."""

    text: str
    confidence: float


class SpeechEngine(Protocol):
    """Recognises one utterance after the other; not safe to use from several threads."""

    def start(self) -> None:
        """Begin an utterance."""

    def feed(self, samples: np.ndarray) -> None:
        """Take (n,) int16 samples at 16 kHz of the utterance."""

    def partial(self) -> str:
        """Return the text so far, lower case where the model has no case."""

    def finish(self) -> Recognised:
        """End the utterance and return its text."""

    def close(self) -> None:
        """Give memory and files back. Idempotent."""


class EngineKind(NamedTuple):
    """Where an engine comes from. factory: `module:function` that takes an EngineChoice."""

    package: str
    module: str
    factory: str
    needs_model: bool


ENGINES: Dict[str, EngineKind] = {
    "pocketsphinx": EngineKind("pocketsphinx", "pocketsphinx", "speech_pocketsphinx:PocketsphinxEngine", False),
    "vosk": EngineKind("vosk", "vosk", "speech_vosk:VoskEngine", True),
    "sherpa_onnx": EngineKind("sherpa-onnx", "sherpa_onnx", "speech_sherpa:SherpaEngine", True),
}
"""Known engines by the value of speech_engine."""


def check_choice(choice: EngineChoice) -> None:
    """Check what can be checked without loading anything.

    Raises ParameterError for an unknown engine, an engine whose package or model is not there, or a grammar or language
    that it cannot take.
    """
    if choice.engine not in ENGINES:
        raise ParameterError("parameter speech_engine is {!r}; legal: {}, or empty for none".format(
            choice.engine, ", ".join(ENGINES)))
    kind = ENGINES[choice.engine]
    if importlib.util.find_spec(kind.module) is None:
        raise ParameterError("parameter speech_engine is {!r}, whose package is not there: `pip install {}`, or choose"
                             " another engine".format(choice.engine, kind.package))
    if kind.needs_model and not choice.model:
        raise ParameterError("parameter speech_model is empty, and {} has no model of its own: set it to the directory of a"
                         " model, or speech_engine to pocketsphinx".format(choice.engine))
    if choice.model and not Path(choice.model).expanduser().is_dir():
        raise ParameterError("parameter speech_model is {!r}, which is no directory: set it to that of a model for {}".format(
            choice.model, choice.engine))
    _check_grammar(choice)
    if choice.engine == "pocketsphinx" and not choice.model and choice.language.split("-")[0].lower() != "en":
        raise ParameterError("parameter speech_language is {!r}, but the model inside pocketsphinx knows English only: set"
                             " speech_model to the directory of a model for that language".format(choice.language))


def _check_grammar(choice: EngineChoice) -> None:
    if not choice.grammar:
        return
    begins = {"pocketsphinx": "#JSGF", "vosk": "["}.get(choice.engine)
    if begins is None:
        raise ParameterError("parameter speech_grammar is set, but {} knows dictation only: leave it empty".format(
            choice.engine))
    if not choice.grammar.lstrip("\ufeff \t\r\n").startswith(begins):
        raise ParameterError("parameter speech_grammar gives {} a text that begins with {!r}; it needs {}".format(
            choice.engine, choice.grammar[:20],
            "a JSGF grammar, which begins with #JSGF" if begins == "#JSGF" else "a JSON list of phrases"))


def make_engine(choice: EngineChoice) -> SpeechEngine:
    """Load an engine with its model, which may take seconds. Raises ParameterError."""
    check_choice(choice)
    module, name = ENGINES[choice.engine].factory.split(":")
    factory: Any = getattr(importlib.import_module("hri_pipeline.core.speech." + module), name)
    return factory(choice)


def one_file(directory: Path, *patterns: str) -> Path:
    """Return the only file of a model's directory that matches a pattern, the first pattern with any first.

    Raises ParameterError that names the directory and the patterns when there is none, or more than one.
    """
    for pattern in patterns:
        found = sorted(path for path in directory.glob(pattern) if path.is_file())
        if len(found) > 1:
            raise ParameterError("the model in {} has {} files {}: leave one".format(directory, len(found), pattern))
        if found:
            return found[0]
    raise ParameterError("parameter speech_model is {}, which holds no {}: it is not a model for this engine".format(
        directory, " or ".join(patterns)))
