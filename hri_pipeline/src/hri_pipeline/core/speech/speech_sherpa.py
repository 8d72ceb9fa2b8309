"""Recognition of speech with sherpa-onnx, where that package and a streaming transducer model are there.

Written after the documented interface of sherpa-onnx 1.10 to 2.0: OnlineRecognizer.from_transducer, create_stream,
accept_waveform, decode_stream, get_result, input_finished.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Optional

import numpy as np

from hri_pipeline.core.parameters import ParameterError
from hri_pipeline.core.speech.speech_engine import RATE, EngineChoice, Recognised, one_file

# What a streaming model still wants to see behind the last word.
_TAIL_S = 0.6


class SherpaEngine:
    """One recogniser with one thread. Its confidence is the geometric mean of the tokens' probabilities.

    Raises ParameterError for a model that cannot be used.
    """

    def __init__(self, choice: EngineChoice) -> None:
        import sherpa_onnx
        directory = Path(choice.model).expanduser()
        files = {name: str(one_file(directory, *patterns)) for name, patterns in (
            ("tokens", ("tokens.txt",)), ("encoder", ("encoder*.int8.onnx", "encoder*.onnx")),
            ("decoder", ("decoder*.int8.onnx", "decoder*.onnx")), ("joiner", ("joiner*.int8.onnx", "joiner*.onnx")))}
        try:
            self._recogniser: Optional[Any] = sherpa_onnx.OnlineRecognizer.from_transducer(
                num_threads=1, sample_rate=RATE, feature_dim=80, decoding_method="greedy_search", **files)
        except Exception as error:  # whatever the library raises
            raise ParameterError("parameter speech_model is {}, which sherpa-onnx does not load: {}".format(
                directory, error)) from error
        self._stream: Optional[Any] = None

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
