"""Voices of one to three speakers in rooms that another library simulates: how much of their speech has a voice of its
own, how many voices there are, and which of them nobody has.

The rooms are pyroomacoustics' (image sources at randomised places: E. De Sena et al., "On the modeling of rectangular
geometries in room acoustic simulations", IEEE/ACM TASLP 23, 2015); it has no wheel for Python 3.8, there the part is
left out. Constants were chosen on TUNING_FILES and seeds below 1000; figures are of HELD_OUT_FILES and seeds from 2000
on.
"""

from __future__ import annotations

from typing import Dict, List, NamedTuple, Optional, Sequence

import numpy as np
from scipy.signal import fftconvolve

from benchmarks.microphone_array import LEVEL, azimuth_errors, circle, loudness, speaking_samples, talk
from benchmarks.room import with_noise
from benchmarks.speech_files import HELD_OUT_FILES, TUNING_FILES, read_speech
from benchmarks.voice_figures import activity_model, blocks
from hri_pipeline.core.audio.parameters import VOICES
from hri_pipeline.core.audio.pipeline import VoicePipeline
from hri_pipeline.core.audio.separation import SoundSeparator
from hri_pipeline.core.audio.vad import FRAME, RATE

FIRST_SEED = 2000
RT60 = 0.5
RIGHT = np.radians(20.0)
"""A voice within this angle of a speaker may be this speaker's."""
_SNR_DB = 15.0
_LEAD, _SECONDS, _TAIL = 1.0, 8.0, 0.5
_TURN_S = 1.5
_ECHO_FRAMES = 6
_LEAST_ANGLE = np.radians(45.0)
_MOST_REFLECTIONS = 36
_STEP_S = 0.1
_WALK_SPEED = 0.8


class RoomScene(NamedTuple):
    """What an array hears, 16 kHz.

    positions: (4, 3) m. directions: (S, F, 3) unit, to each speaker in each frame of 32 ms. images: (S, n, 4) each
    speaker alone. sound: (n, 4). labels: (S, F) bool, who speaks in a frame.
    """

    positions: np.ndarray
    directions: np.ndarray
    images: np.ndarray
    sound: np.ndarray
    labels: np.ndarray


def make_scene(seed: int, speakers: int, rt60: float, walking: bool = False, tuning: bool = False,
               taking_turns: bool = False) -> RoomScene:
    """Return a scene: speakers who talk at the same time, or in turns of 1.5 s, 1 to 2.2 m from an array in a room; one
    of them may walk around it at 0.8 m/s."""
    random = np.random.RandomState(seed)
    size = np.array([random.uniform(4.5, 7.0), random.uniform(4.0, 6.0), random.uniform(2.5, 3.2)])
    centre = np.array([size[0] / 2 + random.uniform(-0.5, 0.5), size[1] / 2 + random.uniform(-0.4, 0.4),
                       random.uniform(0.9, 1.5)])
    positions = circle(4, 0.065 if seed % 2 else 0.09, random.uniform(0.0, np.pi))
    count = int((_LEAD + _SECONDS + _TAIL) * RATE) // FRAME * FRAME
    images, labels, ways = [], [], []
    for index, place in enumerate(_places(random, size, centre, speakers)):
        voice = np.zeros(count)
        speech = talk(_banks(tuning)[(index + seed) % 3], int(_SECONDS * RATE), random)
        voice[int(_LEAD * RATE):][:len(speech)] = speech
        if taking_turns:
            voice *= (np.arange(count) - int(_LEAD * RATE)) // int(_TURN_S * RATE) % speakers == index
        way = _way(place - centre, count, walking and index == 0, random)
        image = _image(size, rt60, way + centre, positions + centre, voice, seed)
        images.append(image * (LEVEL / loudness(image.mean(axis=1))))
        labels.append(speaking_samples(voice).reshape(-1, FRAME).mean(axis=1) > 0.5)
        ways.append(way / np.linalg.norm(way, axis=1, keepdims=True))
    times = np.minimum(np.arange(count // FRAME) * FRAME / RATE / _STEP_S, len(ways[0]) - 1).astype(int)
    return RoomScene(positions, np.array([way[times % len(way)] if len(way) > 1 else np.repeat(way, len(times), axis=0)
                                          for way in ways]),
                     np.array(images), with_noise(images, _SNR_DB, random), np.array(labels))


def _places(random: np.random.RandomState, size: np.ndarray, centre: np.ndarray, count: int) -> List[np.ndarray]:
    places: List[np.ndarray] = []
    while len(places) < count:
        angle, distance = random.uniform(-np.pi, np.pi), random.uniform(1.0, 2.2)
        place = centre + [distance * np.cos(angle), distance * np.sin(angle), random.uniform(-0.1, 0.4)]
        if np.all((place > 0.3) & (place < size - 0.3)) and all(
                azimuth_errors(place - centre, other - centre) >= _LEAST_ANGLE for other in places):
            places.append(place)
    return places


def _way(place: np.ndarray, count: int, walking: bool, random: np.random.RandomState) -> np.ndarray:
    """Return the places of a speaker, (T, 3) m from the array, each 0.1 s; one that stands has one."""
    if not walking:
        return place[None]
    radius = 1.3
    start, side = np.arctan2(place[1], place[0]), random.choice((-1.0, 1.0))
    angles = start + side * _WALK_SPEED / radius * np.arange(0.0, count / RATE, _STEP_S)
    return np.stack([radius * np.cos(angles), radius * np.sin(angles), np.full(len(angles), place[2])], axis=1)


def _image(size: np.ndarray, rt60: float, way: np.ndarray, microphones: np.ndarray, voice: np.ndarray,
           seed: int) -> np.ndarray:
    """Return what the microphones (C, 3) hear of a voice (n,), (n, C)."""
    import pyroomacoustics
    pyroomacoustics.random.seed(seed)
    absorption, order = pyroomacoustics.inverse_sabine(rt60, size)
    room = pyroomacoustics.ShoeBox(size, fs=RATE, materials=pyroomacoustics.Material(absorption),
                                   max_order=min(order, _MOST_REFLECTIONS if len(way) == 1 else 17), use_rand_ism=True)
    for place in way:
        room.add_source(place)
    room.add_microphone_array(microphones.T)
    room.compute_rir()
    image = np.zeros((len(voice), len(microphones)))
    fade = int(_STEP_S * RATE)
    for index in range(len(way)):
        # Each place is heard in a triangle around its time: the parts add up to the whole.
        part = voice if len(way) == 1 else voice * np.clip(
            1.0 - np.abs(np.arange(len(voice)) / fade - index), 0.0, 1.0)
        for channel in range(len(microphones)):
            image[:, channel] += fftconvolve(part, room.rir[channel][index])[:len(voice)]
    return image


def _banks(tuning: bool) -> List[List[np.ndarray]]:
    """Return recordings of three groups of speakers."""
    speech = read_speech(TUNING_FILES if tuning else HELD_OUT_FILES)
    groups: List[List[np.ndarray]] = [[], [], []]
    for name, sound in speech.items():
        groups[0 if "librivox" in name else 1 if "cards" in name else 2].append(sound)
    return groups


class HeardVoice(NamedTuple):
    """One voice in one frame. speaking: the sound counts as its speech; told: and this was said at the time (not the
    look-back of an onset)."""

    id: str
    speaking: bool
    told: bool
    direction: Optional[np.ndarray]


def listen(scene: RoomScene, **changes: object) -> List[List[HeardVoice]]:
    """Return the voices that have a turn in each frame of 32 ms of a scene, by the time of the sound."""
    settings = VOICES.resolve(dict({"microphone_positions": []}, **changes))
    pipeline = VoicePipeline(settings, activity_model(), SoundSeparator(scene.positions, settings))
    frames: List[List[HeardVoice]] = [[] for _ in range(scene.labels.shape[1])]
    for block in blocks(scene.sound.astype(np.float32)):
        for seen in pipeline.update(block):
            if not seen.turn:
                continue
            begin, end = seen.stamp * RATE / FRAME, (seen.stamp * RATE + max(len(seen.samples), 1)) / FRAME
            for frame in range(int(round(begin)), int(round(end + 0.49))):
                if 0 <= frame < len(frames):
                    told = seen.speaking and frame >= int(round(end - 1.0))
                    frames[frame].append(HeardVoice(seen.id, seen.speaking, told, seen.direction))
    return frames


class RoomFigures(NamedTuple):
    """Sums over scenes.

    own: frames of speech with a voice of its own that is said to be speaking, and all frames of speech. right: frames
    in which all speak and as many voices are said to be speaking, the same with voices in a turn, and all such frames.
    stray: frames of voices that are said to be speaking where their speaker has been silent for 0.2 s, and all of them.
    ghosts: voices that are mostly not where anybody is. errors: deg, of azimuth.
    """

    own: np.ndarray
    right: np.ndarray
    stray: np.ndarray
    ghosts: int
    seconds: float
    errors: List[float]


def measure(scene: RoomScene, frames: Sequence[Sequence[HeardVoice]]) -> RoomFigures:
    """Compare the voices in the frames of a scene with who really speaks."""
    own, right, stray = np.zeros(2), np.zeros(3), np.zeros(2)
    errors: List[float] = []
    near: Dict[str, List[float]] = {}
    for frame, voices in enumerate(frames):
        talkers = np.flatnonzero(scene.labels[:, frame])
        for voice in voices:
            angles = azimuth_errors(scene.directions[:, frame], voice.direction)
            near.setdefault(voice.id, []).append(float(angles.min()))
            if voice.speaking and len(talkers) == len(scene.labels):
                errors.append(float(np.degrees(angles.min())))
        free = [voice for voice in voices if voice.speaking]
        for talker in talkers:
            angles = [float(azimuth_errors(scene.directions[talker, frame], voice.direction)) for voice in free]
            if angles and min(angles) <= RIGHT:
                own[0] += 1
                free.pop(int(np.argmin(angles)))
        own[1] += len(talkers)
        late = scene.labels[:, max(0, frame - _ECHO_FRAMES):frame + 1].any(axis=1)
        for voice in voices:
            if voice.told:
                angles = azimuth_errors(scene.directions[:, frame], voice.direction)
                stray += (not (late & (angles <= RIGHT)).any(), 1)
        if len(talkers) == len(scene.labels):
            right += (len({v.id for v in voices if v.speaking}) == len(talkers),
                      len({v.id for v in voices}) == len(talkers), 1)
    ghosts = sum(np.median(angles) > RIGHT for angles in near.values())
    return RoomFigures(own, right, stray, int(ghosts), len(frames) * FRAME / RATE, errors)


def summary(found: Sequence[RoomFigures]) -> Dict[str, float]:
    """Return the figures of several scenes together."""
    own, right, stray = (sum(getattr(one, name) for one in found) for name in ("own", "right", "stray"))
    errors = np.concatenate([one.errors for one in found]) if any(one.errors for one in found) else np.zeros(1)
    return {"own_voice": round(own[0] / own[1], 3), "right_number": round(right[0] / max(right[2], 1), 3),
            "right_number_of_turns": round(right[1] / max(right[2], 1), 3),
            "stray": round(stray[0] / max(stray[1], 1), 3),
            "ghosts_per_minute": round(60.0 * sum(one.ghosts for one in found) / sum(one.seconds for one in found), 2),
            "error_median_deg": round(float(np.median(errors)), 2)}


def figures(scenes: int = 6) -> Dict[str, object]:
    """Return own_voice {speakers: share} and right_number_3 at an RT60 of 0.5 s; others, with ghosts, as details.

    Raises ImportError without pyroomacoustics, FileNotFoundError without the recordings.
    """
    cases = {"1": (1, RT60), "2": (2, RT60), "3": (3, RT60), "3_rt60_0.2": (3, 0.2), "3_rt60_0.8": (3, 0.8),
             "2_one_walks": (2, RT60), "2_in_turns": (2, RT60)}
    found = {}
    for name, (speakers, rt60) in cases.items():
        heard = []
        for seed in range(FIRST_SEED, FIRST_SEED + scenes):
            scene = make_scene(seed, speakers, rt60, walking="walks" in name, taking_turns="turns" in name)
            heard.append(measure(scene, listen(scene)))
        found[name] = summary(heard)
    return {"own_voice": {name: found[name]["own_voice"] for name in "123"},
            "right_number_3": found["3"]["right_number"], "room_details": found}
