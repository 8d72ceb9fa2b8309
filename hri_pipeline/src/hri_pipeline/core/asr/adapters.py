"""For users who bring a model: adapters for vosk and sherpa-onnx, which know more languages than English.

Written after the documented interfaces of vosk 0.3.45 and sherpa-onnx 1.10 to 2.0, tested without their models, and not
installed with this package.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, List

import numpy as np

from hri_pipeline.core.asr.engines import RATE, EngineChoice, Recognised, one_file
from hri_pipeline.core.parameters import ParameterError

_UNKNOWN = "[unk]"


class VoskEngine:
    """One recogniser of vosk (Kaldi); experimental. Its confidence is the mean of those of the words.

    Raises ParameterError for a model or a list of phrases that cannot be used.
    """

    def __init__(self, choice: EngineChoice) -> None:
        import vosk
        vosk.SetLogLevel(-1)
        phrases = _phrase_list(choice.grammar)
        # Always a path: with a name or a language the package would download a model.
        path = str(Path(choice.model).expanduser())
        try:
            self._model: Any = vosk.Model(model_path=path)
            arguments = (self._model, float(RATE)) + ((phrases,) if phrases else ())
            self._recogniser: Any = vosk.KaldiRecognizer(*arguments)
        except Exception as error:  # the package raises bare Exception
            raise ParameterError(
                "parameter speech_model is {}, which vosk does not load: {}".format(path, error)
            ) from error
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
        return _joined_text(self._done + [{"text": json.loads(self._recogniser.PartialResult()).get("partial", "")}])

    def finish(self) -> Recognised:
        """End the utterance."""
        parts = self._done + [json.loads(self._recogniser.FinalResult())]
        words = [float(word.get("conf", 0.0)) for part in parts for word in part.get("result", ())
                 if word.get("word") != _UNKNOWN]
        confidence = sum(words) / len(words) if words else 0.0
        return Recognised(_joined_text(parts), min(max(confidence, 0.0), 1.0))

    def close(self) -> None:
        """Free the model. Idempotent."""
        self._recogniser = self._model = None


def _joined_text(parts: List[dict]) -> str:
    words = " ".join(str(part.get("text", "")) for part in parts).split()
    return " ".join(word for word in words if word != _UNKNOWN)


def _phrase_list(grammar: str) -> str:
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


# What a streaming model still wants to see behind the last word.
_TAIL_S = 0.6


class SherpaEngine:
    """One recogniser of sherpa-onnx with a streaming transducer, in one thread; experimental. Its confidence is the
    geometric mean of the tokens' probabilities.

    Raises ParameterError for a model that cannot be used.
    """

    def __init__(self, choice: EngineChoice) -> None:
        import sherpa_onnx
        directory = Path(choice.model).expanduser()
        files = {name: str(one_file(directory, *patterns)) for name, patterns in (
            ("tokens", ("tokens.txt",)), ("encoder", ("encoder*.int8.onnx", "encoder*.onnx")),
            ("decoder", ("decoder*.int8.onnx", "decoder*.onnx")), ("joiner", ("joiner*.int8.onnx", "joiner*.onnx")))}
        try:
            self._recogniser: Any = sherpa_onnx.OnlineRecognizer.from_transducer(
                num_threads=1, sample_rate=RATE, feature_dim=80, decoding_method="greedy_search", **files)
        except Exception as error:  # whatever the library raises
            raise ParameterError("parameter speech_model is {}, which sherpa-onnx does not load: {}".format(
                directory, error)) from error
        self._stream: Any = None

    def start(self) -> None:
        """Begin an utterance; one that was not finished is forgotten."""
        self._stream = self._recogniser.create_stream()

    def feed(self, samples: np.ndarray) -> None:
        """Take (n,) int16 samples at 16 kHz."""
        self._stream.accept_waveform(RATE, np.asarray(samples, dtype=np.float32) / 32768.0)
        self._decode()

    def partial(self) -> str:
        """Return the text so far."""
        return self._recogniser.get_result(self._stream).strip().lower()

    def finish(self) -> Recognised:
        """End the utterance."""
        self._stream.accept_waveform(RATE, np.zeros(int(_TAIL_S * RATE), dtype=np.float32))
        self._stream.input_finished()
        self._decode()
        text = self.partial()
        # Packages before 1.10 do not tell the logarithms of the probabilities.
        tell = getattr(self._recogniser, "ys_probs", None)
        logarithms = list(tell(self._stream)) if tell is not None else []
        self._stream = None
        confidence = math.exp(min(sum(logarithms) / len(logarithms), 0.0)) if logarithms and text else 0.0
        return Recognised(text, confidence)

    def close(self) -> None:
        """Free the model. Idempotent."""
        self._stream = self._recogniser = None

    def _decode(self) -> None:
        while self._recogniser.is_ready(self._stream):
            self._recogniser.decode_stream(self._stream)
