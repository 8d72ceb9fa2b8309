"""The recognisers of speech: how one is chosen, the grammar it is given, and pocketsphinx.

Moonshine (moonshine.py) is the default for free speech, pocketsphinx for a grammar. Both know English here, and other
languages with a model that the user brings. An engine is imported when it is made, in a process of its own (worker.py).
"""

from __future__ import annotations

import importlib.util
import math
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, Callable, Dict, List, NamedTuple, Optional, Protocol, Sequence, Tuple

import numpy as np

from hri_pipeline.core.onnx import ModelError, model_path, models_directory
from hri_pipeline.core.parameters import ParameterError

if TYPE_CHECKING:
    from hri_pipeline.core.audio.parameters import SpeechSettings  # the recogniser needs none of its libraries

RATE = 16000
"""Sample rate (Hz) of all sound that is recognised."""
LONGEST_PAUSE_S = 0.7
"""Sound for longer than this (s) behind the last word of a turn is no pause: somebody else has gone on."""


class EngineChoice(NamedTuple):
    """Which recogniser, with which model; the fields are the parameters speech_engine, speech_model, ...

    Attributes
    ----------
    engine : a key of ENGINES.
    model : directory, empty for the model that comes with the engine.
    grammar : text of a grammar, empty for dictation.
    language : IETF tag.
    written : with capitals and punctuation, where the engine knows them; False: plain words in lower case.
    """

    engine: str
    model: str = ""
    grammar: str = ""
    language: str = "en-US"
    written: bool = False


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

    def pause(self) -> None:
        """Note that the speaker pauses: the utterance may be over, and its text may be asked for soon."""

    def finish(self, spoken: int) -> Recognised:
        """End the utterance and return its text; nothing was said behind its first `spoken` samples."""

    def close(self) -> None:
        """Give memory and files back. Idempotent."""


_GRAMMAR_SEARCH = "grammar"
# Markers that are not words: <s>, </s>, <sil>, [NOISE], ++breath++; and the number of a pronunciation, as in "to(2)".
_FILLER = re.compile(r"^(<.*>|\[.*\]|\+\+.*\+\+)$")
_PRONUNCIATION = re.compile(r"\(\d+\)$")
_FRAMES_PER_SECOND = 100.0
# Loss of log likelihood per second of words, against the best sound of each frame, at which a grammar fits half, and
# the width of the transition. On Debian's test recordings sentences of four grammars lose 110 to 202, others 300 to
# 620.
_FIT_LOSS = 250.0
_FIT_WIDTH = 15.0
# The least likelihood that the decoder's numbers can tell from 0.
_LEAST = 1e-300
# Utterances up to this length are decoded once more when they are over.
_AGAIN_S = 10.0
# Silence around the words: 25 dB below the loudest 20 ms, of which 0.16 s stay (chosen on recordings of cards with
# silence around).
_STEP = 320
_QUIET = 10.0 ** -2.5
_MARGIN = 8


class PocketsphinxEngine:
    """One decoder of pocketsphinx, for dictation or a JSGF grammar.

    While somebody speaks the mean of the cepstra, which is subtracted from them, is that of what was said before: the
    first words of a new voice suffer. When the utterance is over its own mean is known, so it is decoded again.

    The confidence of dictation is the mean posterior probability of the words in the lattice. In a grammar those
    compare with the other sentences of the grammar only, and are near 1 for a cough; there it is multiplied by how well
    the sounds fit the words at all (0 to 1). Both are estimates of what may be wrong, no probabilities.
    Raises ParameterError for a model or a grammar that cannot be used.
    """

    def __init__(self, choice: EngineChoice) -> None:
        import pocketsphinx
        self._grammar = bool(choice.grammar)
        options: Dict[str, Any] = {"loglevel": "ERROR", **_pocketsphinx_options(choice)}
        try:
            decoder = pocketsphinx.Decoder(**options)
        except (RuntimeError, ValueError) as error:
            raise ParameterError(
                "pocketsphinx does not load its model {}: {}".format(choice.model or "(default)", error)
            ) from error
        if self._grammar:
            try:
                decoder.add_jsgf_string(_GRAMMAR_SEARCH, choice.grammar.encode("utf-8"))
                decoder.activate_search(_GRAMMAR_SEARCH)
            except (RuntimeError, ValueError, KeyError) as error:
                raise ParameterError(
                    "parameter speech_grammar: pocketsphinx does not take the grammar ({}); it must be"
                    " JSGF with a public rule, and all its words must be in the dictionary".format(error)
                ) from error
        self._decoder: Any = decoder
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
        return "" if hypothesis is None else _words_of(hypothesis.hypstr)

    def pause(self) -> None:
        """Do nothing: the decoder keeps up with the sound."""

    def finish(self, spoken: int) -> Recognised:
        """End the utterance; its text is empty where nothing, or no sentence of the grammar, was heard."""
        self._decoder.end_utt()
        self._open = False
        if not spoken:
            self._heard = []
            return Recognised("", 0.0)      # all of it was said by somebody else
        self._decode_again(spoken)
        hypothesis = self._decoder.hyp()
        text = "" if hypothesis is None else _words_of(hypothesis.hypstr)
        if not text:
            return Recognised("", 0.0)
        words = [segment for segment in self._decoder.seg() if not _FILLER.match(segment.word)]
        confidence = sum(word.prob for word in words) / max(len(words), 1)
        if self._grammar:
            confidence *= _grammar_fit(words)
        return Recognised(text, min(max(confidence, 0.0), 1.0))

    def _decode_again(self, spoken: int) -> None:
        """Decode the utterance, without what somebody else has said behind it, with the mean of its own cepstra."""
        sound, self._heard = b"".join(self._heard), []
        sound = _trim_silence(sound[:2 * spoken] if len(sound) // 2 - spoken > LONGEST_PAUSE_S * RATE else sound)
        if not 0 < len(sound) <= _AGAIN_S * RATE * 2:
            return
        self._decoder.reinit_feat()
        self._decoder.start_utt()
        self._decoder.process_raw(sound, full_utt=True)
        self._decoder.end_utt()

    def close(self) -> None:
        """Free the decoder. Idempotent."""
        self._decoder = None


def _trim_silence(data: bytes) -> bytes:
    """Remove most of the silence before and after the words: it would count for the mean of the cepstra."""
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


def _grammar_fit(words: Sequence[Any]) -> float:
    """How well the sounds fit the words of a path, 0 to 1; pauses and noises between them do not count."""
    loss = -sum(math.log(max(word.ascore, _LEAST)) for word in words)
    seconds = sum(word.end_frame - word.start_frame + 1 for word in words) / _FRAMES_PER_SECOND
    return 1.0 / (1.0 + math.exp(min((loss / max(seconds, 0.01) - _FIT_LOSS) / _FIT_WIDTH, 50.0)))


def _words_of(text: str) -> str:
    words = (_PRONUNCIATION.sub("", word) for word in text.split() if not _FILLER.match(word))
    return " ".join(words)


def _pocketsphinx_options(choice: EngineChoice) -> Dict[str, Any]:
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


class EngineKind(NamedTuple):
    """Where an engine comes from. package: as pip knows it; module: as Python imports it."""

    package: str
    module: str
    make: Callable[[EngineChoice], SpeechEngine]


def _make_moonshine(choice: EngineChoice) -> SpeechEngine:
    from hri_pipeline.core.asr.moonshine import MoonshineEngine
    return MoonshineEngine(choice)


ENGINES: Dict[str, EngineKind] = {
    "moonshine": EngineKind("onnxruntime", "onnxruntime", _make_moonshine),
    "pocketsphinx": EngineKind("pocketsphinx", "pocketsphinx", PocketsphinxEngine),
}
"""Known engines by the value of speech_engine."""
AUTO = "auto"
"""Value of speech_engine with which engine_choice() chooses."""


class LanguageError(ParameterError):
    """There is no model for the language."""


def check_choice(choice: EngineChoice) -> None:
    """Check what can be checked without loading anything.

    Raises ParameterError for an unknown engine, an engine whose package or model is not there, or a grammar that it
    cannot take; LanguageError when there is no model for the language.
    """
    if choice.engine not in ENGINES:
        raise ParameterError("parameter speech_engine is {!r}; legal: {}, or empty for none".format(
            choice.engine, ", ".join(ENGINES)))
    kind = ENGINES[choice.engine]
    if importlib.util.find_spec(kind.module) is None:
        raise ParameterError("parameter speech_engine is {!r}, whose package is not there: `pip install {}`, or choose"
                             " another engine".format(choice.engine, kind.package))
    if choice.model and not Path(choice.model).expanduser().is_dir():
        raise ParameterError(
            "parameter speech_model is {!r}, which is no directory: set it to that of a model for {}".format(
                choice.model, choice.engine
            )
        )
    _check_grammar(choice)
    if not (choice.model or is_english(choice.language)):
        raise LanguageError(
            "nobody is understood: parameter language is {!r}, and there is no model for it. Put Moonshine's {} into "
            "{}, or acoustic model, dictionary and language model of pocketsphinx into {}, or set speech_model".format(
                choice.language, ", ".join(_AUTHORS_NAMES), language_directory("moonshine", choice.language),
                language_directory("pocketsphinx", choice.language)))
    if choice.engine == "moonshine":
        _check_moonshine(choice.model)


def primary_language(tag: str) -> str:
    """Return the language of an IETF tag in lower case, without script and region: "pt" for "pt-BR"."""
    return tag.replace("_", "-").split("-")[0].lower()


def language_tag(text: str) -> str:
    """Return the IETF tag that is meant by a text, which may be a locale: "pt-BR" for "pt_BR.UTF-8"."""
    return text.split(".")[0].strip().replace("_", "-")


def is_english(tag: str) -> bool:
    """Tell whether an IETF tag is one of English."""
    return primary_language(tag) == "en"


def language_directory(engine: str, tag: str) -> Path:
    """Return where the models directory keeps a user's model of an engine for a language: `moonshine_es`."""
    return models_directory() / "{}_{}".format(engine, primary_language(tag))


def _check_moonshine(directory: str) -> None:
    try:
        model_files(directory)
    except ModelError as error:
        raise ParameterError("parameter speech_engine is 'moonshine': {}".format(error)) from error


def _check_grammar(choice: EngineChoice) -> None:
    if not choice.grammar:
        return
    if choice.engine != "pocketsphinx":
        raise ParameterError("parameter speech_grammar is set, but {} knows dictation only: leave it empty, or set "
                             "speech_engine to auto".format(choice.engine))
    if not choice.grammar.lstrip("\ufeff \t\r\n").startswith("#JSGF"):
        raise ParameterError("parameter speech_grammar gives a text that begins with {!r}; it needs a JSGF grammar, "
                             "which begins with #JSGF".format(choice.grammar[:20]))


def make_engine(choice: EngineChoice) -> SpeechEngine:
    """Load an engine with its model, which may take seconds. Raises ParameterError."""
    check_choice(choice)
    return ENGINES[choice.engine].make(choice)


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


_LONGEST_GRAMMAR = 256 * 1024
_GRAMMAR_SUFFIX = ".gram"


def read_grammar(value: str, directory: Optional[Path] = None) -> str:
    """Return the text of a grammar: `value` itself, the file that it names, or value.gram of `directory`.

    A text begins with `#`. directory: where the grammars of the package lie, None: not known.
    Raises ParameterError that names what was looked for.
    """
    text = value.strip().lstrip("\ufeff")
    if not text or text.startswith("#"):
        return text
    path = Path(text).expanduser()
    if directory is not None and path.name == text and not path.is_file():
        path = directory / (text if text.endswith(_GRAMMAR_SUFFIX) else text + _GRAMMAR_SUFFIX)
    if not path.is_file():
        raise ParameterError("parameter speech_grammar is {!r}, and there is no file {}: give the path of a grammar, "
                             "its text, or one of {}".format(value, path,
                                                             ", ".join(_grammar_names(directory)) or "none here"))
    if path.stat().st_size > _LONGEST_GRAMMAR:
        raise ParameterError("parameter speech_grammar: {} has {} bytes, legal are {}".format(
            path, path.stat().st_size, _LONGEST_GRAMMAR))
    try:
        return path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise ParameterError("parameter speech_grammar: {} cannot be read: {}".format(path, error)) from error


def engine_choice(settings: SpeechSettings) -> EngineChoice:
    """Return the choice that the parameters speech_* and language make.

    Without speech_model, that of English is the one that comes with the engine, and that of another language lies in
    its `language_directory`. Raises ParameterError for a grammar that is not there.
    """
    language = language_tag(settings.language or settings.speech_language)
    given = settings.speech_model and str(Path(settings.speech_model).expanduser().absolute())
    grammar = read_grammar(settings.speech_grammar, grammar_directory())
    engine = settings.speech_engine
    if engine == AUTO:
        model = given or _language_model("moonshine", language)
        free = not grammar and (model or is_english(language))
        engine = "moonshine" if free and _has_moonshine(model) else "pocketsphinx"
    return EngineChoice(engine, given or _language_model(engine, language), grammar, language,
                        settings.speech_text == "written")


def _language_model(engine: str, language: str) -> str:
    directory = language_directory(engine, language)
    return "" if is_english(language) or not directory.is_dir() else str(directory)


def _has_moonshine(directory: str) -> bool:
    try:
        model_files(directory)
    except ModelError:
        return False
    return True


ENCODER, DECODER, TOKENIZER = "moonshine_encoder.onnx", "moonshine_decoder.onnx", "moonshine_tokenizer.json"
"""Files of Moonshine in the models directory."""
_AUTHORS_NAMES = ("encoder_model.onnx", "decoder_model_merged.onnx", "tokenizer.json")


def model_files(directory: str) -> Tuple[Path, Path, Path]:
    """Return Moonshine's encoder, decoder and vocabulary: of the models directory, or of a directory of the user, where
    they have the names that Moonshine's authors give.

    Raises
    ------
    ModelError
        One of them is not there.
    """
    if not directory:
        return model_path("", ENCODER), model_path("", DECODER), model_path("", TOKENIZER)
    paths = [Path(directory) / name for name in _AUTHORS_NAMES]
    missing = [path.name for path in paths if not path.is_file()]
    if missing:
        raise ModelError("{} (parameter speech_model) lacks {}".format(directory, ", ".join(missing)))
    return paths[0], paths[1], paths[2]


def grammar_directory() -> Optional[Path]:
    """Return config/grammars of this package in a source tree or install space, None where there is none."""
    here = Path(__file__).resolve()
    # <source>/hri_pipeline/src/hri_pipeline/core/asr, <install>/lib/python3/dist-packages/hri_pipeline/core/asr
    places = [here.parents[4] / "config" / "grammars"]
    places += [parent / "share" / "hri_pipeline" / "config" / "grammars" for parent in list(here.parents)[5:8]]
    return next((place for place in places if place.is_dir()), None)


def _grammar_names(directory: Optional[Path]) -> list:
    return sorted(path.stem for path in directory.glob("*" + _GRAMMAR_SUFFIX)) if directory is not None else []
