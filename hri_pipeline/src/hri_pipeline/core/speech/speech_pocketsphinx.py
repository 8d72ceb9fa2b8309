"""Recognition of speech with pocketsphinx: dictation or a JSGF grammar."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any, Dict, List, Optional, Sequence

import numpy as np
import pocketsphinx

from hri_pipeline.core.parameters import ParameterError
from hri_pipeline.core.speech.speech_engine import RATE, EngineChoice, Recognised, one_file

_SEARCH = "grammar"
# Words that are no words: <s>, </s>, <sil>, [NOISE], ++breath++; and the number of a pronunciation, as in "to(2)".
_FILLER = re.compile(r"^(<.*>|\[.*\]|\+\+.*\+\+)$")
_PRONUNCIATION = re.compile(r"\(\d+\)$")
_FRAMES_PER_SECOND = 100.0
# Loss of log likelihood per second of words, against the best sound of each frame, at which a grammar fits half, and the
# width of the transition. On Debian's test recordings sentences of four grammars lose 110 to 202, others 300 to 620.
_FIT_LOSS = 250.0
_FIT_WIDTH = 15.0
# The least likelihood that the decoder's numbers can tell from 0.
_LEAST = 1e-300
# Utterances up to this length are decoded once more when they are over.
_AGAIN_S = 10.0
# Silence around the words: 25 dB below the loudest 20 ms, of which 0.16 s stay (chosen on recordings of cards with silence around).
_STEP = 320
_QUIET = 10.0 ** -2.5
_MARGIN = 8


class PocketsphinxEngine:
    """One decoder.

    While somebody speaks the mean of the cepstra, which is subtracted from them, is that of what was said before: the
    first words of a new voice suffer. When the utterance is over its own mean is known, so it is decoded again.

    The confidence of dictation is the mean posterior probability of the words in the lattice. In a grammar those
    compare with the other sentences of the grammar only, and are near 1 for a cough; there it is multiplied by how well
    the sounds fit the words at all (0 to 1). Both are estimates of what may be wrong, no probabilities.
    Raises ParameterError for a model or a grammar that cannot be used.
    """

    def __init__(self, choice: EngineChoice) -> None:
        self._grammar = bool(choice.grammar)
        options: Dict[str, Any] = {"loglevel": "ERROR", **_model_options(choice)}
        try:
            decoder = pocketsphinx.Decoder(**options)
        except (RuntimeError, ValueError) as error:
            raise ParameterError("pocketsphinx does not load its model {}: {}".format(choice.model or "(default)", error)) from error
        if self._grammar:
            try:
                decoder.add_jsgf_string(_SEARCH, choice.grammar.encode("utf-8"))
                decoder.activate_search(_SEARCH)
            except (RuntimeError, ValueError, KeyError) as error:
                raise ParameterError("parameter speech_grammar: pocketsphinx does not take the grammar ({}); it must be"
                                     " JSGF with a public rule, and all its words must be in the dictionary".format(error)) from error
        self._decoder: Optional[Any] = decoder
        self._open = False
        self._heard: List[bytes] = []

    def start(self) -> None:
        """Begin an utterance; one that was not finished is forgotten."""
        if self._open:
            self._decoder.end_utt()
        self._decoder.start_utt()
        self._heard = []
        self._open = True

    def feed(self, samples: np.ndarray) -> None:
        """Take (n,) int16 samples at 16 kHz."""
        if len(samples):
            data = np.ascontiguousarray(samples, dtype="<i2").tobytes()
            self._heard.append(data)
            self._decoder.process_raw(data)

    def partial(self) -> str:
        """Return the text so far."""
        hypothesis = self._decoder.hyp()
        return "" if hypothesis is None else _clean(hypothesis.hypstr)

    def finish(self) -> Recognised:
        """End the utterance; its text is empty where nothing, or no sentence of the grammar, was heard."""
        self._decoder.end_utt()
        self._open = False
        self._decode_again()
        hypothesis = self._decoder.hyp()
        text = "" if hypothesis is None else _clean(hypothesis.hypstr)
        if not text:
            return Recognised("", 0.0)
        words = [segment for segment in self._decoder.seg() if not _FILLER.match(segment.word)]
        confidence = sum(word.prob for word in words) / max(len(words), 1)
        if self._grammar:
            confidence *= _fit(words)
        return Recognised(text, min(max(confidence, 0.0), 1.0))

    def _decode_again(self) -> None:
        """Decode the whole utterance with the mean of its own cepstra."""
        sound, self._heard = _trim(b"".join(self._heard)), []
        if not 0 < len(sound) <= _AGAIN_S * RATE * 2:
            return
        self._decoder.reinit_feat()
        self._decoder.start_utt()
        self._decoder.process_raw(sound, full_utt=True)
        self._decoder.end_utt()

    def close(self) -> None:
        """Free the decoder. Idempotent."""
        self._decoder = None


def _trim(data: bytes) -> bytes:
    """Leave most of the silence before and behind the words out: it would count for the mean of the cepstra."""
    samples = np.frombuffer(data, dtype="<i2")
    count = len(samples) // _STEP
    if count == 0:
        return data
    energy = np.square(samples[:count * _STEP].astype(np.float32)).reshape(count, _STEP).mean(axis=1)
    loud = np.flatnonzero(energy > energy.max() * _QUIET)
    if len(loud) == 0:
        return data
    first, last = max(0, loud[0] - _MARGIN), min(count, loud[-1] + 1 + _MARGIN)
    return samples[first * _STEP:last * _STEP].tobytes()


def _fit(words: Sequence[Any]) -> float:
    """How well the sounds fit the words of a path, 0 to 1; pauses and noises between them do not count."""
    loss = -sum(math.log(max(word.ascore, _LEAST)) for word in words)
    seconds = sum(word.end_frame - word.start_frame + 1 for word in words) / _FRAMES_PER_SECOND
    return 1.0 / (1.0 + math.exp(min((loss / max(seconds, 0.01) - _FIT_LOSS) / _FIT_WIDTH, 50.0)))


def _clean(text: str) -> str:
    words = (_PRONUNCIATION.sub("", word) for word in text.split() if not _FILLER.match(word))
    return " ".join(words)


def _model_options(choice: EngineChoice) -> Dict[str, Any]:
    """Options of the decoder: the model inside the package, or that of a directory."""
    options: Dict[str, Any] = {"lm": None} if choice.grammar else {}
    if not choice.model:
        return options
    directory = Path(choice.model).expanduser()
    acoustic = directory if (directory / "mdef").is_file() else one_file(directory, "*/mdef").parent
    options["hmm"], options["dict"] = str(acoustic), str(one_file(directory, "*.dict", "*.dic"))
    if not choice.grammar:
        options["lm"] = str(one_file(directory, "*.lm.bin", "*.lm", "*.lm.dmp"))
    return options
