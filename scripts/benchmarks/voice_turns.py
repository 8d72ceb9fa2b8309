"""Turns of two people who answer each other at one microphone: how many turns hold both, and what that costs.

Two persons speak 1.5 to 4 s in turn, with gaps of 0 to 0.4 s (half of the gaps between people are shorter than 0.2 s:
M. Heldner and J. Edlund, "Pauses, gaps and overlaps in conversations", Journal of Phonetics 38, 2010), in a room with
an RT60 of 0.3 s at 20 dB. There are two speakers; each speaks at one of three speeds, which moves
pitch and formants as another body does. Constants were chosen on the speakers of TUNING, and so that few turns of the
others are cut (seeds below 2000): what is kept apart of the figures are the dialogues, not the speakers.
"""

from __future__ import annotations

from typing import Dict, List, NamedTuple, Optional, Sequence

import numpy as np

from benchmarks.room import Room, images_at, with_noise
from benchmarks.speech_files import RATE, read_announcements, read_speech
from benchmarks.voice_figures import activity_model, blocks, energy_labels, speaker_embedder
from hri_pipeline.core.audio.parameters import VOICES
from hri_pipeline.core.audio.pipeline import VoicePipeline
from hri_pipeline.core.audio.speakers import SpeakerEmbedder

TUNING: Dict[str, Sequence[str]] = {"cards": ("cards/",), "announcements": ()}
HELD_OUT: Dict[str, Sequence[str]] = {"librivox": ("librivox/",), "commands": ("goforward", "something", "numbers")}
SPEEDS = (0.94, 1.0, 1.06)
FIRST_SEED = 2000
LEAST_S = 0.5
"""A person who speaks for less than this in the turn of another one is not counted."""
_ROOM = Room((6.0, 5.0, 3.0), 0.3)
_MICROPHONE = np.array([[3.0, 2.4, 1.2]])
_SNR_DB, _LEVEL = 20.0, 0.05
_SPEECH_S, _GAP_S, _PAUSE_S = (1.5, 4.0), (0.0, 0.4), (1.2, 2.0)
_EXCHANGES, _PARTS = 4, (2, 3)
_PERSON_S = 2.0     # voice_person_delay of the person manager


class Dialogue(NamedTuple):
    """sound: (n,) float32 at 16 kHz. spoken: (2, n) bool, when each of the two really speaks; one who is alone has all
    of it."""

    sound: np.ndarray
    spoken: np.ndarray


def _speech(tuning: bool) -> Dict[str, np.ndarray]:
    """Return all that each recorded speaker says, without the silence around it."""
    recordings = read_speech()
    found: Dict[str, np.ndarray] = {}
    for name, files in (TUNING if tuning else HELD_OUT).items():
        sounds = [sound for file, sound in recordings.items() if file.startswith(tuple(files))] if files else [
            sound for file, sound in read_announcements().items() if "Noise" not in file]
        if sounds:
            found[name] = np.concatenate([_trimmed(sound) for sound in sounds])
    return found


def _trimmed(sound: np.ndarray) -> np.ndarray:
    spoken = np.flatnonzero(energy_labels(sound))
    return sound[spoken[0]:spoken[-1] + 1] * (0.5 / np.abs(sound).max())


def make_dialogue(seed: int, tuning: bool = False, alone: bool = False) -> Dialogue:
    """Return some exchanges with pauses between them; alone: the same with one speaker, who goes on after each gap."""
    random = np.random.RandomState(seed)
    speech = _speech(tuning)
    names = [(name, speed) for name in sorted(speech) for speed in SPEEDS]
    first = names[random.randint(len(names))]
    others = [one for one in names if one[0] != first[0]]
    pair = [first, others[random.randint(len(others))]]
    voices = [np.interp(np.arange(0.0, len(speech[name]) - 1.0, speed), np.arange(len(speech[name])), speech[name])
              for name, speed in pair]
    tracks: List[List[np.ndarray]] = [[np.zeros(RATE)], [np.zeros(RATE)]]
    for _ in range(_EXCHANGES):
        begin = random.randint(2)
        for part in range(random.choice(_PARTS)):
            speaker = 0 if alone else (begin + part) % 2
            length = int(random.uniform(*_SPEECH_S) * RATE)
            said = np.take(voices[speaker], np.arange(length) + random.randint(len(voices[speaker])), mode="wrap")
            pause = np.zeros(int(random.uniform(*_GAP_S) * RATE))
            tracks[speaker] += [_trimmed(said), pause]
            tracks[1 - speaker].append(np.zeros(len(tracks[speaker][-2]) + len(pause)))
        pause = np.zeros(int(random.uniform(*_PAUSE_S) * RATE))
        tracks[0].append(pause)
        tracks[1].append(pause)
    clean = np.array([np.concatenate(track) for track in tracks])
    spoken = np.array([energy_labels(track) if track.any() else np.zeros(len(track), bool) for track in clean])
    images = []
    for track in clean:
        angle, distance = random.uniform(-np.pi, np.pi), random.uniform(0.8, 1.6)
        place = _MICROPHONE[0] + [distance * np.cos(angle), distance * np.sin(angle), random.uniform(0.0, 0.4)]
        image = images_at(_ROOM.responses(place, _MICROPHONE), track)
        level = np.sqrt(np.mean(image[np.abs(image) > 0.1 * np.abs(image).max()] ** 2)) if track.any() else 1.0
        images.append(image * (_LEVEL * random.uniform(0.7, 1.4) / level))
    return Dialogue(with_noise(images, _SNR_DB, random)[:, 0].astype(np.float32), spoken)


class Turn(NamedTuple):
    """begin, end: samples. told: the sample at which the voice was new; divided: it ended by a change of speaker."""

    begin: int
    end: int
    told: int
    divided: bool


def turns(sound: np.ndarray, speakers: Optional[SpeakerEmbedder]) -> List[Turn]:
    """Return the turns in a sound (n,) at 16 kHz of one microphone."""
    pipeline = VoicePipeline(VOICES.resolve({}), activity_model(), speakers=speakers)
    begins: Dict[str, Sequence[int]] = {}
    found: List[Turn] = []
    for block in blocks(sound):
        now = int(round(block.stamp * RATE))
        for seen in pipeline.update(block):
            if seen.onset:
                begins[seen.id] = (int(round(seen.stamp * RATE)), now)
            if seen.end:
                begin, told = begins.pop(seen.id)
                found.append(Turn(begin, int(round(seen.stamp * RATE)), told, not len(seen.samples)))
    return found


RESUME_S = 15.0
"""Time within which an earlier voice may go on, in resumed()."""


def resumed(dialogues: int, first_seed: int = FIRST_SEED) -> Dict[str, object]:
    """Return the voices of these dialogues that last for 2 s (a person each, where nobody has a face), and the share of
    speech in another person's voice: each turn a new voice, with `resume_time`, and with it without the network."""
    found: Dict[str, object] = {"resumed_people": 2 * dialogues}
    embedder = speaker_embedder()
    for name, resume_time, speakers in (("new", 0.0, embedder), ("resumed", RESUME_S, embedder),
                                        ("unheard", RESUME_S, None)):
        counts = np.zeros(3)
        for seed in range(first_seed, first_seed + dialogues):
            counts += _voices_of(make_dialogue(seed), resume_time, speakers)
        found[name + "_voices"], found[name + "_wrong"] = int(counts[0]), round(float(counts[1] / counts[2]), 3)
    return found


def _voices_of(dialogue: Dialogue, resume_time: float, speakers: Optional[SpeakerEmbedder]) -> np.ndarray:
    """Return the number of voices that last, and the samples of speech that are not of their voice's person, and all
    (3,)."""
    settings = VOICES.resolve({"resume_time": resume_time, "voice_timeout": 3.0 if speakers else RESUME_S})
    pipeline = VoicePipeline(settings, activity_model(), speakers=speakers)
    tracked: Dict[str, List[float]] = {}
    spoken: Dict[str, np.ndarray] = {}
    for block in blocks(dialogue.sound):
        for seen in pipeline.update(block):
            if seen.turn and (len(seen.samples) or seen.speaking):
                begin = int(round(seen.stamp * RATE))
                spoken[seen.id] = spoken.get(seen.id, np.zeros(2)) + dialogue.spoken[
                    :, begin:begin + len(seen.samples)].sum(axis=1)
        for voice in pipeline.tracked:
            tracked.setdefault(voice, [block.stamp, block.stamp])[1] = block.stamp
    lasting = sum(last - first >= _PERSON_S for first, last in tracked.values())
    return np.array([lasting, sum(each.min() for each in spoken.values()), sum(each.sum() for each in spoken.values())])


def figures(dialogues: int = 16, first_seed: int = FIRST_SEED, tuning: bool = False) -> Dict[str, object]:
    """Return turns_mixed, the same without the network, the turns of one who speaks alone that were cut, and by how
    much (median, s) a new voice is late.

    Raises FileNotFoundError without the recordings, ModelError without the network.
    """
    speakers = speaker_embedder()
    mixed, alone, late = {True: [0, 0], False: [0, 0]}, [0, 0], []
    for seed in range(first_seed, first_seed + dialogues):
        dialogue = make_dialogue(seed, tuning)
        for is_used, counts in mixed.items():
            found = turns(dialogue.sound, speakers if is_used else None)
            spoken = [dialogue.spoken[:, turn.begin:turn.end].sum(axis=1) / RATE for turn in found]
            counts[0] += sum(bool(times.min() >= LEAST_S) for times in spoken)
            counts[1] += sum(bool(times.max() >= LEAST_S) for times in spoken)
            if is_used:
                ends = {turn.end for turn in found if turn.divided}
                late += [(turn.told - turn.begin) / RATE for turn in found if turn.begin in ends]
        found = turns(make_dialogue(seed, tuning, alone=True).sound, speakers)
        alone[0] += sum(turn.divided for turn in found)
        alone[1] += len(found) - sum(turn.divided for turn in found)
    return {"turns_mixed": round(mixed[True][0] / mixed[True][1], 3),
            "turns_mixed_without": round(mixed[False][0] / mixed[False][1], 3),
            "turns_mixed_turns": [mixed[False][1], mixed[True][1]], "turns_cut": round(alone[0] / alone[1], 3),
            "turns_alone": alone[1], "new_speaker_late_s": round(float(np.median(late)), 2) if late else None,
            **({} if tuning else resumed(dialogues, first_seed))}
