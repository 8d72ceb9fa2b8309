"""Recognition of speech with vosk (Kaldi), where that package and a model are there.

Written after the documented interface of vosk 0.3.45: Model(path), KaldiRecognizer(model, rate[, phrases]),
AcceptWaveform, PartialResult, FinalResult.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, List, Optional

import numpy as np

from hri_pipeline.core.parameters import ParameterError
from hri_pipeline.core.speech.speech_engine import RATE, EngineChoice, Recognised

_UNKNOWN = "[unk]"


class VoskEngine:
    """One recogniser. Its confidence is the mean of those of the words.

    Raises ParameterError for a model or a list of phrases that cannot be used.
    """

    def __init__(self, choice: EngineChoice) -> None:
        import vosk
        vosk.SetLogLevel(-1)
        phrases = _phrases(choice.grammar)
        # Always a path: with a name or a language the package would download a model.
        path = str(Path(choice.model).expanduser())
        try:
            self._model: Optional[Any] = vosk.Model(model_path=path)
            arguments = (self._model, float(RATE)) + ((phrases,) if phrases else ())
            self._recogniser: Optional[Any] = vosk.KaldiRecognizer(*arguments)
        except Exception as error:  # the package raises bare Exception
            raise ParameterError("parameter speech_model is {}, which vosk does not load: {}".format(path, error)) from error
        self._recogniser.SetWords(True)
        self._done: List[dict] = []

    def start(self) -> None:
        """Begin an utterance; one that was not finished is forgotten."""
        self._recogniser.Reset()
        self._done = []

    def feed(self, samples: np.ndarray) -> None:
        """Take (n,) int16 samples at 16 kHz."""
        # True: vosk has heard a pause and begins a new sentence; for us the utterance goes on.
        if len(samples) and self._recogniser.AcceptWaveform(np.ascontiguousarray(samples, dtype="<i2").tobytes()):
            self._done.append(json.loads(self._recogniser.Result()))

    def partial(self) -> str:
        """Return the text so far."""
        return _text(self._done + [{"text": json.loads(self._recogniser.PartialResult()).get("partial", "")}])

    def finish(self) -> Recognised:
        """End the utterance."""
        parts = self._done + [json.loads(self._recogniser.FinalResult())]
        words = [float(word.get("conf", 0.0)) for part in parts for word in part.get("result", ())
                 if word.get("word") != _UNKNOWN]
        confidence = sum(words) / len(words) if words else 0.0
        return Recognised(_text(parts), min(max(confidence, 0.0), 1.0))

    def close(self) -> None:
        """Free the model. Idempotent."""
        self._recogniser = self._model = None


def _text(parts: List[dict]) -> str:
    words = " ".join(str(part.get("text", "")) for part in parts).split()
    return " ".join(word for word in words if word != _UNKNOWN)


def _phrases(grammar: str) -> str:
    """The JSON list of phrases, with a word for all others."""
    if not grammar:
        return ""
    try:
        phrases = json.loads(grammar)
    except ValueError as error:
        raise ParameterError("parameter speech_grammar is no JSON list of phrases: {}".format(error)) from error
    if not isinstance(phrases, list) or not phrases or not all(isinstance(phrase, str) for phrase in phrases):
        raise ParameterError("parameter speech_grammar must be a JSON list of phrases, as in [\"go home\", \"stop\"]")
    return json.dumps(phrases if _UNKNOWN in phrases else phrases + [_UNKNOWN])
