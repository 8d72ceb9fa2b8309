"""Word errors of the recogniser of speech on Debian's recordings, and the time it takes.

The sound goes to the engine in blocks of 32 ms, as in the node; what is compared is the final text.
"""

from __future__ import annotations

import re
import time
from pathlib import Path
from typing import Dict, List, NamedTuple, Sequence, Tuple

import numpy as np

from benchmarks.speech_files import SPEECH_DIRECTORY, read_announcements, read_speech
from hri_pipeline.core.asr.engines import (
    RATE,
    EngineChoice,
    Recognised,
    SpeechEngine,
    grammar_directory,
    make_engine,
    read_grammar,
)
from hri_pipeline.core.audio.stream import encode_s16
from hri_pipeline.score.metrics import word_errors

_BLOCK = 512
_MARKS = re.compile(r"<.*?>|\(.*?\)")
# What the recordings of alsa-utils say is their names.
_POSITIONS = """#JSGF V1.0; grammar positions;
public <position> = (front | rear | side) (left | right | center);"""
_NO_POSITION = "Noise"


class Recording(NamedTuple):
    """Sound (n,) at 16 kHz, from -1 to 1, and what is said in it."""

    name: str
    samples: np.ndarray
    words: str


class Task(NamedTuple):
    """Recordings that are recognised with one grammar, or by dictation where that is empty."""

    name: str
    grammar: str
    utterances: Sequence[Recording]


class Transcription(NamedTuple):
    """errors: substitutions, omissions and insertions; words: those that were said. texts: (said, recognised,
    confidence). busy, sound: s of processor time, and of sound."""

    errors: int
    words: int
    texts: List[Tuple[str, str, float]]
    busy: float
    sound: float


def transcriptions(directory: str, name: str) -> Dict[str, str]:
    """Return {recording: words} of a list of `words (recording)` as CMU Sphinx keeps them."""
    found: Dict[str, str] = {}
    for line in (SPEECH_DIRECTORY / directory / name).read_text(encoding="utf-8").splitlines():
        recording = re.search(r"\((\S+)\)\s*$", line)
        if recording:
            found["{}/{}.wav".format(directory, recording.group(1))] = _MARKS.sub(" ", line).lower()
    return found


def grammar_tasks() -> List[Task]:
    """Return digits and commands with a grammar.

    Raises FileNotFoundError with the mend where a recording is missing.
    """
    cards = transcriptions("cards", "cards.transcription")
    tasks = [
        Task("cards", read_grammar(str(SPEECH_DIRECTORY / "cards/cards.gram")), _read(cards)),
        Task("goforward", read_grammar(str(SPEECH_DIRECTORY / "goforward.gram")),
             _read({"goforward.raw": "go forward ten meters"})),
        Task("commands", _own("commands"), _read({"goforward.raw": "go forward ten meters"})),
        Task("digits", _own("digits"), _read({"tidigits/dhd.2934z.raw": "two nine three four zero"}))]
    positions = [Recording(name, samples, Path(name).stem.replace("_", " ").lower())
                 for name, samples in read_announcements().items() if _NO_POSITION not in name]
    return tasks + ([Task("positions", _POSITIONS, positions)] if positions else [])


def dictation_tasks() -> List[Task]:
    """Return LibriVox sentences, read from a novel, for dictation. Raises FileNotFoundError with the mend."""
    return [Task("librivox", "", _read(transcriptions("librivox", "transcription")))]


def measure(task: Task) -> Transcription:
    """Recognise all recordings of a task, one after the other by one engine as in a conversation."""
    engine = make_engine(EngineChoice("pocketsphinx", grammar=task.grammar))
    errors = words = 0
    texts: List[Tuple[str, str, float]] = []
    sound, start = 0.0, time.process_time()
    for utterance in task.utterances:
        result = _recognise(engine, utterance.samples)
        said = utterance.words.split()
        errors += word_errors(said, result.text.split())
        words += len(said)
        texts.append((" ".join(said), result.text, result.confidence))
        sound += len(utterance.samples) / RATE
    busy = time.process_time() - start
    engine.close()
    return Transcription(errors, words, texts, busy, sound)


def figures() -> Dict[str, object]:
    """Return the word error rates and times.

    Raises FileNotFoundError with the mend where the recordings are missing.
    """
    found: Dict[str, object] = {}
    for kind, tasks in (("grammar", grammar_tasks()), ("dictation", dictation_tasks())):
        outcomes = [measure(task) for task in tasks]
        words = sum(outcome.words for outcome in outcomes)
        found["wer_" + kind] = sum(outcome.errors for outcome in outcomes) / words
        found["wer_{}_words".format(kind)] = words
        found["wer_{}_tasks".format(kind)] = {task.name: "{} of {}".format(outcome.errors, outcome.words)
                                              for task, outcome in zip(tasks, outcomes)}
        found["real_time_factor_" + kind] = sum(outcome.busy for outcome in outcomes) / sum(
            outcome.sound for outcome in outcomes)
    found["false_commands"] = false_commands()
    return found


def false_commands() -> str:
    """Sentences that are no commands, and how many of them the sample grammar takes for one at the default
    confidence."""
    from hri_pipeline.core.asr.parameters import SPEECH_RECOGNITION_PARAMETERS
    least = next(parameter.default for parameter in SPEECH_RECOGNITION_PARAMETERS
                 if parameter.name == "speech_min_confidence")
    others = [utterance for task in dictation_tasks() + grammar_tasks()[:1] for utterance in task.utterances]
    outcome = measure(Task("others", _own("commands"), others))
    taken = sum(bool(text) and confidence >= least for _, text, confidence in outcome.texts)
    return "{} of {}".format(taken, len(others))


def _recognise(engine: SpeechEngine, samples: np.ndarray) -> Recognised:
    engine.start()
    data = np.frombuffer(encode_s16(samples), np.int16)
    for place in range(0, len(data), _BLOCK):
        engine.feed(data[place:place + _BLOCK])
    return engine.finish()


def _own(name: str) -> str:
    return read_grammar(name, grammar_directory())


def _read(words: Dict[str, str]) -> List[Recording]:
    return [Recording(name, samples, words[name]) for name, samples in read_speech(sorted(words)).items()]
