"""Free speech by Moonshine: sound of 16 kHz in, text with a confidence out.

Moonshine (N. Jeffries et al., "Moonshine: Speech Recognition for Live Transcription and Voice Commands",
arXiv:2410.15608) is a transformer: its encoder takes the samples of a piece of any length, its decoder tells one token
after the other. `MoonshineModel` transcribes one piece by greedy decoding with a cache; `MoonshineEngine` makes an
utterance of it: it keeps the sound, cuts long speech at pauses, joins the texts, and leaves out what was not said.

Such networks may invent words where there are none. Against that: no more tokens than a person can say in the time;
the decoder's loops are cut; and a piece of little confidence, which falls with the mean logarithm of its tokens'
probabilities, is left out.
"""

from __future__ import annotations

import json
import math
import re
import time
from pathlib import Path
from typing import Dict, List, NamedTuple, Sequence, Tuple, Union

import numpy as np

from hri_pipeline.core.asr.engines import LONGEST_PAUSE_S, RATE, EngineChoice, Recognised, model_files
from hri_pipeline.core.onnx import ModelError, OnnxModel
from hri_pipeline.core.parameters import ParameterError

PARTIAL_SHARE = 0.08
"""Share of the time of the sound that texts so far may cost, beside those of pauses."""
CUT_FROM_S, CUT_AT_S = 6.0, 12.0
"""Length (s) from which sound is cut at a pause, and at which it is cut at the quietest place."""
SHORT_S = 1.0
CALIBRATION = (5.3, 2.8)
"""Slope and offset of the logistic function, fitted on 7 recordings in 20 rooms and noises each and on babble; on 7
others the mean error of the estimate is .06."""
LEAST_CONFIDENCE = 0.25
"""A piece below this is taken for no speech: in babble, where nobody says anything, half of the texts lie below .15."""

_START, _END = 1, 2
_BYTE = re.compile(r"^<0x([0-9A-Fa-f]{2})>$")
_SPACE = "\u2581"
# Nobody says more tokens a second; the authors give the same limit for English.
_TOKENS_PER_S = 6.5
_LEAST_TOKENS = 6
# A run of tokens that comes so often in succession is a loop of the decoder; words are said twice, sometimes thrice.
_LOOPS = 4
_LONGEST_LOOP = 8
# The decoder ends at once where nobody speaks, at .96 and more for noises; also at times where somebody does, but then
# it is less sure (below .9: of 7 recordings, 4 framings and 4 levels of noise 9 of 112 without a text, with this 1).
_SURE_OF_NOTHING = math.log(0.9)
_PARTIAL_FROM_S = 0.5
_LEAST_S = 0.1
_PADDING_S = 0.3
_PAUSE_S = 0.24
_STEP = 320
# 25 dB.
_QUIET = 10.0 ** -2.5
_DASH = re.compile(r"[-/\u2010-\u2015]")
_NO_WORD = re.compile(r"[^\w\s'.,:%$\u20ac\u00a3]")


class Tokenizer:
    """Turns tokens into text: byte-pair encoding with a fallback to bytes, from a file tokenizer.json.

    Raises
    ------
    ModelError
        The file cannot be read, or holds no vocabulary.
    """

    def __init__(self, path: Union[str, Path]) -> None:
        try:
            vocabulary = json.loads(Path(path).read_text(encoding="utf-8"))["model"]["vocab"]
            self._pieces = {int(number): str(piece) for piece, number in vocabulary.items()}
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise ModelError("the vocabulary {} cannot be read: {!r}".format(path, error)) from error

    def text(self, tokens: Sequence[int]) -> str:
        """Return the text of tokens; those that stand for no text (<s>, <<ST_1>>) are left out."""
        data = bytearray()
        for token in tokens:
            piece = self._pieces.get(token, "")
            byte = _BYTE.match(piece)
            if byte:
                data.append(int(byte.group(1), 16))
            elif token > _END:
                data += piece.replace(_SPACE, " ").encode("utf-8")
        return " ".join(data.decode("utf-8", "ignore").split())


class Transcript(NamedTuple):
    """Text of a piece of sound.

    Attributes
    ----------
    text : str
    log_probability : float
        Sum of the natural logarithms of the probabilities of its tokens, that of the end included.
    tokens : int
        Number of tokens, that of the end included.
    whole : bool
        The decoder came to an end; False when a limit or a loop has ended it.
    """

    text: str
    log_probability: float
    tokens: int
    whole: bool


_NOTHING = Transcript("", 0.0, 0, True)


class MoonshineModel:
    """The two networks and the vocabulary. Layers and heads are read from the files, so any size will do.

    Parameters
    ----------
    encoder, decoder, tokenizer : str or Path

    Raises
    ------
    ModelError
        A file is missing, damaged, or of another model.
    """

    def __init__(self, encoder: Union[str, Path], decoder: Union[str, Path], tokenizer: Union[str, Path]) -> None:
        self._tokenizer = Tokenizer(tokenizer)
        self._encoder = OnnxModel(encoder, inputs=("input_values",), outputs=("last_hidden_state",))
        self._decoder = OnnxModel(decoder, inputs=("input_ids", "encoder_hidden_states", "use_cache_branch"))
        if "logits" not in self._decoder.output_names:
            raise ModelError("model file {} has no output logits: it is no decoder of Moonshine".format(decoder))
        self._past = [name for name in self._decoder.input_names if name.startswith("past_key_values.")]
        self._empty = self._no_past()
        # The keys of what was said grow; those of the sound stay the same behind the first token.
        self._growing = [name for name in self._past if ".decoder." in name]

    def transcribe(self, samples: np.ndarray) -> Transcript:
        """Return the text of samples (n,) float32 at 16 kHz, -1 to 1; at least 0.1 s."""
        hidden = self._encoder.run({"input_values": samples[None].astype(np.float32)})["last_hidden_state"]
        limit = max(_LEAST_TOKENS, int(_TOKENS_PER_S * len(samples) / RATE))
        tokens: List[int] = []
        total, token = 0.0, _START
        past = dict(self._empty)
        for step in range(limit):
            logits, past = self._step(token, hidden, past, step > 0)
            token = int(logits.argmax())
            if not step and token == _END and _log_probability(logits, _END) < _SURE_OF_NOTHING:
                token = _second(logits)
            total += _log_probability(logits, token)
            if token == _END:
                return Transcript(self._tokenizer.text(tokens), total, len(tokens) + 1, True)
            tokens.append(token)
            loop = _loop(tokens)
            if loop:
                del tokens[-loop * (_LOOPS - 1):]
                break
        return Transcript(self._tokenizer.text(tokens), total, limit, False)

    def _step(self, token: int, hidden: np.ndarray, past: Dict[str, np.ndarray],
              cached: bool) -> Tuple[np.ndarray, Dict[str, np.ndarray]]:
        """Return the logits (V,) of the next token, and the cache behind `token`."""
        names = self._growing if cached else self._past
        outputs = ["logits"] + [name.replace("past_key_values", "present") for name in names]
        found = self._decoder.run(dict(past, input_ids=np.array([[token]], np.int64), encoder_hidden_states=hidden,
                                       use_cache_branch=np.array([cached])), outputs)
        past.update({name: found[output] for name, output in zip(names, outputs[1:])})
        return found["logits"][0, -1], past

    def _no_past(self) -> Dict[str, np.ndarray]:
        shapes = self._decoder.input_shapes
        return {name: np.zeros((0, int(shapes[name][1]), 1, int(shapes[name][3])), np.float32) for name in self._past}


def _log_probability(logits: np.ndarray, token: int) -> float:
    """Return the logarithm of the softmax of `token`."""
    highest = float(logits.max())
    return float(logits[token]) - highest - math.log(float(np.exp(logits - highest).sum()))


def _second(logits: np.ndarray) -> int:
    """Return the most probable token but the end."""
    logits = logits.copy()
    logits[_END] = -np.inf
    return int(logits.argmax())


def _loop(tokens: Sequence[int]) -> int:
    """Return the length of the run of tokens that stands _LOOPS times at the end, 0 for none."""
    for length in range(1, min(_LONGEST_LOOP, len(tokens) // _LOOPS) + 1):
        last = tokens[-length:]
        if all(tokens[len(tokens) - (turn + 1) * length:len(tokens) - turn * length] == last
               for turn in range(1, _LOOPS)):
            return length
    return 0


class _Piece(NamedTuple):
    """A transcript, and how many samples of the open sound it covers."""

    transcript: Transcript
    samples: int


class MoonshineEngine:
    """Utterances by MoonshineModel, in English with the model of this package.

    What was said so far is found by transcribing the open sound once more, which costs more the longer it is: pause()
    does so, and finish() has its text where nothing was said since; partial() only as often as keeps it at
    PARTIAL_SHARE of the time, so a machine that is busy gets fewer texts. Speech of more than `CUT_FROM_S` is cut at
    the next pause, and at the quietest place when there is none for long; the text of the pieces before the cut is
    final. A piece of less than SHORT_S, where Moonshine errs, gets silence behind it.

    The confidence estimates the share of right words: a logistic function of the mean logarithm of the tokens'
    probabilities (see CALIBRATION).

    Raises
    ------
    ParameterError
        The model cannot be used.
    """

    def __init__(self, choice: EngineChoice) -> None:
        try:
            self._model = MoonshineModel(*model_files(choice.model))
        except ModelError as error:
            raise ParameterError("moonshine: {}".format(error)) from error
        self._written = choice.written
        self.start()

    def start(self) -> None:
        """Begin an utterance; one that was not finished is forgotten."""
        self._parts: List[np.ndarray] = []
        self._length = 0
        self._done: List[Transcript] = []
        self._last = _Piece(_NOTHING, 0)
        self._cost = 0.0
        self._cut = 0

    def feed(self, samples: np.ndarray) -> None:
        """Take (n,) int16 samples at 16 kHz."""
        self._parts.append(np.asarray(samples, np.int16))
        self._length += len(samples)
        if self._length >= CUT_FROM_S * RATE:
            sound = self._sound()
            cut = _place_of_cut(sound)
            if cut:
                self._done.append(self._text_before(cut, sound))
                self._parts, self._length, self._last = [sound[cut:]], len(sound) - cut, _Piece(_NOTHING, 0)
                self._cut += cut

    def partial(self) -> str:
        """Return the text so far."""
        fresh = self._length - self._last.samples
        if self._length >= _PARTIAL_FROM_S * RATE and fresh:
            if fresh >= self._cost * self._length / PARTIAL_SHARE:
                self.pause()
        return self._text([self._last.transcript])

    def pause(self) -> None:
        """Transcribe the open sound."""
        sound = self._sound()
        if len(sound) > self._last.samples:
            self._last = _Piece(self._transcribe(sound), len(sound))

    def finish(self, spoken: int) -> Recognised:
        """End the utterance; its text is empty where no word was heard."""
        sound = self._sound()
        covered = self._last.samples
        if spoken > self._cut + covered and (not covered or _is_loud(sound[covered:], sound)):
            self.pause()
        own = max(0, spoken - self._cut)
        if covered - own > LONGEST_PAUSE_S * RATE and _is_loud(sound[own:covered], sound):
            self._last = _Piece(self._transcribe(sound[:own]), own)    # behind it somebody else has spoken
        last = self._last.transcript
        text = self._text([last])
        confidence = _confidence(self._done + [last]) if text else 0.0
        self.start()
        return Recognised(text, confidence)

    def close(self) -> None:
        """Forget the sound. Idempotent."""
        self.start()

    def _sound(self) -> np.ndarray:
        """Return the open sound (n,) int16, in one array from now on."""
        if len(self._parts) != 1:
            self._parts = [np.concatenate(self._parts)] if self._parts else [np.zeros(0, np.int16)]
        return self._parts[0]

    def _text_before(self, cut: int, sound: np.ndarray) -> Transcript:
        """Return the text of sound[:cut]: that of the last pause, where nothing is said between both."""
        first, last = sorted((cut, self._last.samples))
        if self._last.samples and not _is_loud(sound[first:last], sound):
            return self._last.transcript
        return self._transcribe(sound[:cut])

    def _transcribe(self, sound: np.ndarray) -> Transcript:
        if len(sound) < _LEAST_S * RATE:
            return _NOTHING
        started = time.monotonic()
        samples = sound.astype(np.float32) / 32768.0
        if len(samples) < SHORT_S * RATE:
            samples = np.concatenate((samples, np.zeros(int(_PADDING_S * RATE), np.float32)))
        transcript = self._model.transcribe(samples)
        self._cost = (time.monotonic() - started) / (len(samples) / RATE)
        return transcript if _confidence([transcript]) >= LEAST_CONFIDENCE else _NOTHING

    def _text(self, open_pieces: Sequence[Transcript]) -> str:
        text = " ".join(piece.text for piece in [*self._done, *open_pieces] if piece.text)
        return text if self._written else plain_words(text)


def plain_words(text: str) -> str:
    """Return a text in lower case without punctuation; apostrophes and what stands within numbers stay."""
    words = _NO_WORD.sub("", _DASH.sub(" ", text.lower())).split()
    return " ".join(word for word in (word.strip(".,:'") for word in words) if word)


def _confidence(pieces: Sequence[Transcript]) -> float:
    """Return the estimated share of right words of all pieces together."""
    tokens = sum(piece.tokens for piece in pieces if piece.text)
    mean = sum(piece.log_probability for piece in pieces if piece.text) / max(tokens, 1)
    slope, offset = CALIBRATION
    estimate = 1.0 / (1.0 + math.exp(-min(max(slope * mean + offset, -50.0), 50.0)))
    return estimate if all(piece.whole for piece in pieces) else 0.5 * estimate


def _levels(sound: np.ndarray) -> np.ndarray:
    """Return the energy of each 20 ms of sound, (n,)."""
    count = len(sound) // _STEP
    return np.square(sound[:count * _STEP].astype(np.float32)).reshape(count, _STEP).mean(axis=1)


def _is_loud(part: np.ndarray, whole: np.ndarray) -> bool:
    """Return whether a part of a sound comes within 25 dB of the loudest 20 ms of the whole."""
    energy = _levels(part)
    return bool(len(energy)) and float(energy.max()) > _QUIET * float(_levels(whole).max())


def _place_of_cut(sound: np.ndarray) -> int:
    """Return the sample at which to cut: in the last pause, or for long sound where it is quietest; 0 for nowhere."""
    energy, width = _levels(sound), int(_PAUSE_S * RATE) // _STEP
    smooth = np.convolve(energy, np.full(width, 1.0 / width), "valid")
    first = int(0.5 * CUT_FROM_S * RATE) // _STEP
    place = first + int(np.argmin(smooth[first:]))
    if smooth[place] <= _QUIET * energy.max() or len(sound) >= CUT_AT_S * RATE:
        return (place + width // 2) * _STEP
    return 0
