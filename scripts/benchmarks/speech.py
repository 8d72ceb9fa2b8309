"""Word errors of the recognisers of speech on Debian's recordings, and words that nobody has said.

A grammar: the sound goes to the engine in blocks of 32 ms, as in the node; what is compared is the final text. Free
speech: the sound goes through the voices as well, and what is compared are the texts of all turns that are sure enough
to be published, one after the other. Constants were chosen on TUNING_FILES and seeds below 1000; figures are of
HELD_OUT_FILES and seeds from 1000 on.
"""

from __future__ import annotations

import re
import time
from pathlib import Path
from typing import Dict, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from benchmarks.room import Room, images_at, with_noise
from benchmarks.speech_files import HELD_OUT_FILES, SPEECH_DIRECTORY, TUNING_FILES, read_announcements, read_speech
from benchmarks.voice_figures import activity_model, activity_settings, blocks, speaker_embedder
from hri_pipeline.core.asr.engines import (
    RATE,
    EngineChoice,
    Recognised,
    SpeechEngine,
    grammar_directory,
    make_engine,
    read_grammar,
)
from hri_pipeline.core.asr.moonshine import plain_words
from hri_pipeline.core.asr.recognition import PAUSE_S
from hri_pipeline.core.audio.parameters import SpeechSettings
from hri_pipeline.core.audio.pipeline import VoiceObservation, VoicePipeline
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


SPOKEN = {
    "goforward.raw": "go forward ten meters", "something.raw": "go somewhere and do something",
    "numbers.raw": "thirty three four six ninety two", "tidigits/dhd.2934z.raw": "two nine three four zero"}
"""What is said in the recordings that come without a transcription."""
FIRST_SEED = 1000
_FAR = Room((6.0, 5.0, 3.0), 0.5)
_FAR_FROM, _FAR_METRES, _FAR_SNR_DB = np.array([[3.1, 2.4, 1.2]]), 2.0, 15.0
_BEFORE_S, _BEHIND_S = 1.0, 1.2
_PARTIAL_BLOCKS = 10
_SAME_WORDS = {"mister": "mr", "metres": "meters"}
_CALM_S = 50.0


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


def dictation_task(names: Sequence[str]) -> Task:
    """Return recordings for free speech. Raises FileNotFoundError with the mend."""
    words = all_words()
    return Task("dictation", "", _read({name: words[name] for name in names}))


def all_words() -> Dict[str, str]:
    """Return {recording: what is said in it}. Raises FileNotFoundError."""
    words = dict(transcriptions("librivox", "transcription"), **transcriptions("cards", "cards.transcription"))
    return dict(words, **SPOKEN)


def measure(task: Task) -> Transcription:
    """Recognise all recordings of a task with a grammar, one after the other by one engine as in a conversation."""
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


class TurnReader:
    """Gives the sound of one voice at a time to an engine, as SpeechRecognition does."""

    def __init__(self, engine: SpeechEngine) -> None:
        self._engine = engine
        self._length = self._spoken = self._frames = 0
        self._begin = 0.0

    def add(self, seen: VoiceObservation) -> Optional[Recognised]:
        """Add what is seen of the voice; return the text at the end of a turn, if it is sure enough to be published."""
        if seen.onset:
            self._engine.start()
            self._length = self._frames = 0
            self._begin = seen.stamp
        if len(seen.samples):
            self._engine.feed(np.frombuffer(encode_s16(seen.samples), np.int16))
            self._length += len(seen.samples)
            self._spoken = self._length if seen.speaking else self._spoken
            if self._length - self._spoken - len(seen.samples) < PAUSE_S * RATE <= self._length - self._spoken:
                self._engine.pause()
        self._frames += seen.turn
        if seen.turn and self._frames % _PARTIAL_BLOCKS == 0:
            self._engine.partial()
        found = self._engine.finish(min(self._spoken, int((seen.stamp - self._begin) * RATE))) if seen.end else None
        return found if found and found.text and found.confidence >= least_confidence() else None


def turn_texts(engine: SpeechEngine, sound: np.ndarray) -> List[Recognised]:
    """Return the texts of the turns in a sound (n,) that are published."""
    pipeline = VoicePipeline(activity_settings(), activity_model(), speakers=speaker_embedder())
    reader = TurnReader(engine)
    texts = [reader.add(seen) for block in blocks(sound.astype(np.float32)) for seen in pipeline.update(block)]
    return [text for text in texts if text is not None]


def dictate(task: Task, far: bool, seeds: Sequence[int]) -> Transcription:
    """Recognise the free speech of a task; far: 2 m away in a room with an RT60 of 0.5 s, at 15 dB (the image-source
    method of room.py: pyroomacoustics has no wheel for Python 3.8)."""
    engine = make_engine(EngineChoice("moonshine"))
    errors = words = 0
    texts: List[Tuple[str, str, float]] = []
    sound_s, start = 0.0, time.process_time()
    for seed in seeds:
        random = np.random.RandomState(seed)
        for utterance in task.utterances:
            sound = _placed(utterance.samples, far, random)
            found = turn_texts(engine, sound)
            said, heard = (compared(text) for text in (utterance.words, " ".join(part.text for part in found)))
            errors += word_errors(said, heard)
            words += len(said)
            texts.append((" ".join(said), " ".join(heard), min([part.confidence for part in found], default=0.0)))
            sound_s += len(sound) / RATE
    busy = time.process_time() - start
    engine.close()
    return Transcription(errors, words, texts, busy, sound_s)


def _placed(samples: np.ndarray, far: bool, random: np.random.RandomState) -> np.ndarray:
    """Return a recording with a second of background around it, close or far, with a peak of 0.5."""
    sound = np.concatenate([np.zeros(int(_BEFORE_S * RATE)), samples, np.zeros(int(_BEHIND_S * RATE))])
    if far:
        angle = random.uniform(-np.pi, np.pi)
        place = _FAR_FROM[0] + _FAR_METRES * np.array([np.cos(angle), np.sin(angle), 0.15])
        sound = with_noise([images_at(_FAR.responses(place, _FAR_FROM), sound)], _FAR_SNR_DB, random)[:, 0]
    else:
        sound = sound + 1e-4 * random.standard_normal(len(sound))
    return sound * (0.5 / np.abs(sound).max())


def compared(text: str) -> List[str]:
    """Return the words of a text, spelt in one way."""
    return [_SAME_WORDS.get(word, word) for word in plain_words(text).split()]


def backgrounds(seed: int, names: Sequence[str] = HELD_OUT_FILES) -> Dict[str, np.ndarray]:
    """Return sounds of 50 s in which nobody says anything that could be understood, {name: (n,)} with a peak of 0.5:
    noises, steps, a hum, music of chords and a melody with vibrato, and babble of 16 voices in a room."""
    random = np.random.RandomState(seed)
    count = int(_CALM_S * RATE)
    time_s = np.arange(count) / RATE
    white = random.standard_normal(count)
    pink = np.fft.irfft(np.fft.rfft(white) / np.sqrt(np.maximum(np.arange(count // 2 + 1), 20.0)), count)
    knocks = np.zeros(count)
    knocks[np.cumsum(random.randint(RATE // 6, RATE, size=60))[:40]] = random.uniform(0.2, 1.0, 40)
    knock = random.standard_normal(800) * np.exp(-np.arange(800) / random.uniform(60.0, 200.0))
    hum = sum(np.sin(2.0 * np.pi * 50.0 * order * time_s) / order for order in (1, 2, 3, 5)) + 0.1 * white
    found = {"white": white * (1.0 + 0.8 * np.sin(2.0 * np.pi * 0.3 * time_s)), "pink": pink,
             "knocks": np.convolve(knocks, knock)[:count] + 1e-3 * white, "hum": hum,
             "music": _music(time_s, random), "babble": _babble(count, random, names)}
    return {name: sound * (0.5 / np.abs(sound).max()) for name, sound in found.items()}


def _music(time_s: np.ndarray, random: np.random.RandomState) -> np.ndarray:
    """Chords that change every second, and a melody of twice that speed with vibrato and overtones."""
    sound = np.zeros(len(time_s))
    for second in range(int(time_s[-1])):
        part = (time_s >= second) & (time_s < second + 1)
        root = 130.8 * 2.0 ** (random.choice((0, 2, 5, 7, 9)) / 12.0)
        local = time_s[part] - second
        for interval in (0, 4, 7, 12):
            sound[part] += 0.3 * np.sin(2.0 * np.pi * root * 2.0 ** (interval / 12.0) * local) * np.exp(-2.0 * local)
        note = 2.0 * root * 2.0 ** (random.choice((0, 4, 7, 9, 12)) / 12.0)
        phase = 2.0 * np.pi * note * local + 0.8 * np.sin(2.0 * np.pi * 5.5 * local)
        sound[part] += sum(np.sin(order * phase) / order ** 1.5 for order in range(1, 8)) * np.exp(-3.0 * (local % 0.5))
    return sound


def _babble(count: int, random: np.random.RandomState, names: Sequence[str]) -> np.ndarray:
    """Sixteen voices at once in a room, made of recordings at other speeds."""
    speech = list(read_speech(names).values())
    sound = np.zeros(count)
    for _ in range(16):
        speed = random.uniform(0.8, 1.25)
        order = random.permutation(len(speech))
        voice = np.concatenate([speech[index] / np.abs(speech[index]).max() for index in order])
        voice = np.interp(np.arange(0.0, len(voice) - 1, speed), np.arange(len(voice)), voice)
        sound += np.roll(np.resize(voice, count), random.randint(count))
    return images_at(_FAR.responses([4.6, 3.4, 1.4], _FAR_FROM), sound)[:, 0]


def hallucinated(seed: int, names: Sequence[str] = HELD_OUT_FILES) -> Dict[str, int]:
    """Return how many words are told in each of the backgrounds, 5 min together."""
    engine = make_engine(EngineChoice("moonshine"))
    words = {name: sum(len(found.text.split()) for found in turn_texts(engine, sound))
             for name, sound in backgrounds(seed, names).items()}
    engine.close()
    return words


def figures() -> Dict[str, object]:
    """Return the word error rates and times.

    Raises FileNotFoundError with the mend where the recordings are missing.
    """
    outcomes = [measure(task) for task in grammar_tasks()]
    found: Dict[str, object] = dict(_rates("grammar", outcomes), wer_grammar_tasks={
        task.name: "{} of {}".format(outcome.errors, outcome.words)
        for task, outcome in zip(grammar_tasks(), outcomes)}, false_commands=false_commands())
    seeds = range(FIRST_SEED, FIRST_SEED + 3)
    held_out, tuned = dictation_task(HELD_OUT_FILES), dictation_task(TUNING_FILES)
    found.update(_rates("dictation", [dictate(held_out, False, seeds[:1])]))
    found.update(_rates("far", [dictate(held_out, True, seeds)]))
    found["wer_dictation_tuning_half"] = _rates("half", [dictate(tuned, False, seeds[:1])])["wer_half"]
    told = hallucinated(FIRST_SEED)
    found.update(hallucinated_words=sum(told.values()), hallucinated_words_in=told)
    return found


def _rates(kind: str, outcomes: Sequence[Transcription]) -> Dict[str, object]:
    words = sum(outcome.words for outcome in outcomes)
    return {"wer_" + kind: sum(outcome.errors for outcome in outcomes) / words, "wer_{}_words".format(kind): words,
            "real_time_factor_" + kind: sum(outcome.busy for outcome in outcomes) / sum(
                outcome.sound for outcome in outcomes)}


def false_commands() -> str:
    """Sentences that are no commands, and how many of them the sample grammar takes for one at the default
    confidence."""
    librivox = _read(transcriptions("librivox", "transcription"))
    others = librivox + list(grammar_tasks()[0].utterances)
    outcome = measure(Task("others", _own("commands"), others))
    taken = sum(bool(text) and confidence >= least_confidence() for _, text, confidence in outcome.texts)
    return "{} of {}".format(taken, len(others))


def least_confidence() -> float:
    """Return the default of speech_min_confidence."""
    return SpeechSettings().speech_min_confidence


def _recognise(engine: SpeechEngine, samples: np.ndarray) -> Recognised:
    engine.start()
    data = np.frombuffer(encode_s16(samples), np.int16)
    for place in range(0, len(data), _BLOCK):
        engine.feed(data[place:place + _BLOCK])
    return engine.finish(len(data))


def _own(name: str) -> str:
    return read_grammar(name, grammar_directory())


def _read(words: Dict[str, str]) -> List[Recording]:
    return [Recording(name, samples, words[name]) for name, samples in read_speech(sorted(words)).items()]
