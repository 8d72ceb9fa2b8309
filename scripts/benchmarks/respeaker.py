"""A ReSpeaker v2 with its six channels in a simulated room: directions, and the robot that speaks beside it.

The robot is the reader of LibriVox, from a loudspeaker 0.25 m away; people say other recordings at 1 to 1.5 m.
Constants of the own voice were chosen on TUNING_FILES and seeds below 1000; figures are of HELD_OUT_FILES and seeds
from 1000 on.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Dict, Iterator, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np
import yaml

from benchmarks.microphone_array import azimuth_errors
from benchmarks.room import Room, images_at, with_noise
from benchmarks.speech import TurnReader, all_words, compared
from benchmarks.speech_files import HELD_OUT_FILES, RATE, read_speech
from benchmarks.voice_figures import activity_model, energy_labels
from hri_pipeline.core.asr.engines import EngineChoice, SpeechEngine, make_engine
from hri_pipeline.core.audio.array import parse_positions
from hri_pipeline.core.audio.own_voice import BargeInFilter, RobotSpeech, hear_humans
from hri_pipeline.core.audio.parameters import VOICES, VoicesSettings
from hri_pipeline.core.audio.pipeline import VoicePipeline
from hri_pipeline.core.audio.separation import SoundSeparator
from hri_pipeline.core.audio.stream import SoundBlock, SoundFormat, SoundStream, encode_s16

PRESET = Path(__file__).resolve().parents[2] / "hri_pipeline" / "config" / "microphones" / "respeaker_v2.yaml"
FIRST_SEED = 1000
LOUDER_DB = (12.0, 6.0, 0.0)
"""How much louder than the robot people are at the array."""
RIGHT = np.radians(20.0)
_READER = "librivox"
_ROOM, _SNR_DB = Room((6.0, 5.0, 3.0), 0.5), 20.0
_CENTRE = np.array([2.8, 2.3, 1.1])
_LOUDSPEAKER_M = 0.25
_LEVEL = 0.05
_LEAD_S, _BEFORE_S, _BEHIND_S = 1.0, 2.5, 1.5
_MESSAGE = 800


class RobotScene(NamedTuple):
    """What the device sends.

    Attributes
    ----------
    sound : (n, 6) samples at 16 kHz.
    speaks : begin and end (s) of what the robot says; None when it is silent.
    robot, human : the words of both.
    direction : (3,) unit vector to the person; None when nobody is there.
    talks : begin and end (s) of what the person says.
    """

    sound: np.ndarray
    speaks: Optional[Tuple[float, float]]
    robot: Sequence[str]
    human: Sequence[str]
    direction: Optional[np.ndarray]
    talks: Tuple[float, float]


class Answer(NamedTuple):
    """What was told. words: of all texts; heard: (times (s), direction) of each observation of somebody who speaks."""

    words: List[str]
    heard: List[Tuple[float, Optional[np.ndarray]]]


def preset() -> VoicesSettings:
    """Return the parameters of voices for this device."""
    return VOICES.resolve(yaml.safe_load(PRESET.read_text(encoding="utf-8")))


def make_scene(seed: int, robot: bool, louder_db: Optional[float], names: Sequence[str] = HELD_OUT_FILES) -> RobotScene:
    """Return a scene. robot: it reads for some ten seconds; louder_db: a person says one recording in between, so much
    louder than the robot at the array; None: nobody does."""
    random = np.random.RandomState(seed)
    settings = preset()
    speech, words = read_speech(names), all_words()
    lines = sorted(name for name in speech if _READER in name)
    lines = [lines[index] for index in random.permutation(len(lines))]
    people = sorted(name for name in speech if _READER not in name)
    said = people[random.randint(len(people))]
    turn = random.uniform(-np.pi, np.pi)
    ahead = np.array([np.cos(turn), np.sin(turn), -0.5])
    away = turn + random.choice((-1.0, 1.0)) * random.uniform(np.radians(50.0), np.pi)
    person = random.uniform(1.0, 1.5) * np.array([np.cos(away), np.sin(away), random.uniform(0.0, 0.3)])
    talk = np.concatenate([_scaled(speech[name]) for name in lines]) if robot else np.zeros(RATE)
    count = int((_LEAD_S + _BEHIND_S) * RATE) + max(len(talk), len(speech[said]) + int(_BEFORE_S * RATE))
    places = parse_positions(settings.microphone_positions) + _CENTRE
    images = []
    if robot:
        images.append(_image(_CENTRE + _LOUDSPEAKER_M * ahead / np.linalg.norm(ahead), places, talk, _LEAD_S, count,
                             _LEVEL))
    begin = _LEAD_S + _BEFORE_S
    if louder_db is not None:
        images.append(_image(_CENTRE + person, places, _scaled(speech[said]), begin, count,
                             _LEVEL * 10.0 ** (louder_db / 20.0)))
    mixed = with_noise(images, _SNR_DB, random)
    played = images[0].mean(axis=1, keepdims=True) if robot else np.zeros((count, 1))
    return RobotScene(
        np.hstack([mixed.mean(axis=1, keepdims=True), mixed, played]),
        (_LEAD_S - 0.05, _LEAD_S + len(talk) / RATE) if robot else None,
        compared(" ".join(words[name] for name in lines)) if robot else (),
        compared(words[said]) if louder_db is not None else (),
        None if louder_db is None else person / np.linalg.norm(person), (begin, begin + len(speech[said]) / RATE))


def _scaled(sound: np.ndarray) -> np.ndarray:
    """Return a sound (n,) with a level of 1 where somebody speaks."""
    return sound / np.sqrt(np.mean(sound[energy_labels(sound)] ** 2))


def _image(place: np.ndarray, microphones: np.ndarray, talk: np.ndarray, begin: float, count: int,
           level: float) -> np.ndarray:
    """Return what the microphones hear, (count, 4), of a talk that begins at `begin` s, with this level at them."""
    sound = np.zeros(count)
    sound[int(begin * RATE):int(begin * RATE) + len(talk)] = talk[:count - int(begin * RATE)]
    image = images_at(_ROOM.responses(place, microphones), sound)
    spoken = energy_labels(sound)
    return image * level / np.sqrt(np.mean(image[spoken] ** 2))


def _blocks(scene: RobotScene, channels: Sequence[int], is_array: bool) -> Iterator[SoundBlock]:
    stream = SoundStream(SoundFormat(6), channels=channels, is_array=is_array)
    data = np.clip(scene.sound, -1.0, 1.0)
    for first in range(0, len(data), _MESSAGE):
        part = data[first:first + _MESSAGE]
        yield from stream.add(encode_s16(part), 100.0 + (first + len(part)) / RATE)


def listen(scene: RobotScene, engine: SpeechEngine, array: bool, tells: bool = True) -> Answer:
    """Return what the voices of a scene say. array: directions; else the processed channel alone. tells: the robot says
    when it speaks."""
    settings = preset()
    robot = RobotSpeech(settings)
    places = parse_positions(settings.microphone_positions)
    barge_in = BargeInFilter(SoundSeparator(places, settings), robot, settings) if array else None
    pipeline = VoicePipeline(settings, activity_model(), barge_in)  # type: ignore[arg-type]
    reader, speaker = TurnReader(engine), ""
    words: List[str] = []
    heard: List[Tuple[float, Optional[np.ndarray]]] = []
    for block in _blocks(scene, settings.microphone_channels if array else [0], array):
        if scene.speaks is not None and tells:
            robot.tell(scene.speaks[0] <= block.stamp - 100.0 < scene.speaks[1], block.stamp)
        for seen in hear_humans(pipeline, robot, barge_in, block):
            if seen.speaking:
                heard.append((seen.stamp - 100.0, seen.direction))
            # One engine: of voices at the same time the first is understood.
            if not speaker or seen.id == speaker:
                text = reader.add(seen)
                words += compared(text.text) if text is not None else []
                speaker = "" if seen.end or not seen.turn else seen.id
    return Answer(words, heard)


def robot_words(scene: RobotScene, answer: Answer) -> int:
    """Return how many words were told that the robot has said, and the person has not."""
    return sum((Counter(answer.words) - Counter(scene.human) & Counter(scene.robot)).values())


def share_heard(scene: RobotScene, answer: Answer) -> float:
    """Return the part of the person's time in which somebody is said to speak in the person's direction."""
    assert scene.direction is not None
    times = {round(stamp / 0.032) for stamp, direction in answer.heard
             if scene.talks[0] <= stamp <= scene.talks[1] and direction is not None
             and azimuth_errors(direction, scene.direction) <= RIGHT}
    return len(times) * 0.032 / (scene.talks[1] - scene.talks[0])


def own_voice(seeds: Sequence[int], names: Sequence[str] = HELD_OUT_FILES) -> Dict[str, object]:
    """Return `robot_words` of a robot alone, heard with and without directions, and of one who is interrupted; and what
    is heard of those who interrupt it."""
    engine = make_engine(EngineChoice("moonshine"))
    alone = [make_scene(seed, True, None, names) for seed in seeds]
    told = {"array": sum(len(listen(scene, engine, True).words) for scene in alone),
            "one_microphone": sum(len(listen(scene, engine, False).words) for scene in alone),
            "untold": sum(len(listen(scene, engine, False, tells=False).words) for scene in alone[:2])}
    found: Dict[str, object] = {}
    for louder in LOUDER_DB:
        scenes = [make_scene(seed, True, louder, names) for seed in seeds]
        answers = [listen(scene, engine, True) for scene in scenes]
        shares = [share_heard(scene, answer) for scene, answer in zip(scenes, answers)]
        told["interrupted_{:g}_db".format(louder)] = sum(map(robot_words, scenes, answers))
        found["barge_in_{:g}_db".format(louder)] = {
            "heard": float(np.mean([share > 0.3 for share in shares])), "share_of_time": float(np.mean(shares)),
            "words_right": sum(sum((Counter(scene.human) & Counter(answer.words)).values())
                               for scene, answer in zip(scenes, answers)) / sum(len(scene.human) for scene in scenes)}
    engine.close()
    untold = told.pop("untold")
    return dict(found, robot_words=sum(told.values()), robot_words_in=told, robot_words_without_robot_speaking=untold,
                robot_seconds=sum(len(scene.sound) for scene in alone) / RATE)


def six_channels(seeds: Sequence[int], names: Sequence[str] = HELD_OUT_FILES) -> float:
    """Return the median error (degrees) of the direction of one person, from all six channels of the stream."""
    settings = preset()
    errors: List[float] = []
    for seed in seeds:
        scene = make_scene(seed, False, 0.0, names)
        separator = SoundSeparator(parse_positions(settings.microphone_positions), settings)
        for block in _blocks(scene, settings.microphone_channels, True):
            signals = separator.process(block.samples)
            if scene.talks[0] <= block.stamp - 100.0 < scene.talks[1]:
                errors += [azimuth_errors(signal.direction, scene.direction) for signal in signals if signal.active]
    return float(np.degrees(np.median(errors)))


def figures() -> Dict[str, object]:
    """Return the figures of `scripts/benchmark voices`. Raises FileNotFoundError with the mend."""
    seeds = range(FIRST_SEED, FIRST_SEED + 8)
    return dict(own_voice(seeds), doa_error_deg_six_channels=six_channels(seeds))
