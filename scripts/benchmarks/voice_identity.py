"""Whose voice it is: how many of the persons that are told are right, and how many of the enrolled are told.

Enrolled are the reader, from one half of the recordings, and the speakers of the cards and of the announcements, in one
room; what is judged are pieces of 4 s of the reader's other recordings and of a stranger in other rooms, all at one of
three speeds. The threshold was chosen on the cards and the announcements, but a table of all speakers had been seen
before: none of them is unseen. These are few people, of different microphones: where many are alike it errs more.
"""

from __future__ import annotations

from typing import Dict, List, Sequence, Tuple

import numpy as np

from benchmarks.room import Room, images_at, with_noise
from benchmarks.speech_files import RATE, read_announcements, read_speech
from benchmarks.voice_figures import energy_labels, speaker_embedder
from hri_pipeline.core.audio.speakers import (
    CALIBRATION,
    DIMENSION,
    LEAST_PRODUCT,
    MODEL,
    SpeakerEmbedder,
    VoiceIdentity,
)
from hri_pipeline.core.recognition.gallery import MemoryGallery

FIRST_SEED = 1000
SPEEDS = (0.94, 1.0, 1.06)
PIECE_S = 4.0
_RT60, _SNR_DB = (0.2, 0.5), (15.0, 25.0)
_MICROPHONE = np.array([[3.0, 2.4, 1.2]])
_STRANGERS = {"commands": ("goforward", "something", "numbers")}


def _recordings() -> Tuple[Dict[str, List[np.ndarray]], Dict[str, List[np.ndarray]]]:
    """Return the recordings of the enrolled and of the strangers by name."""
    speech = read_speech()
    announced = [sound for name, sound in read_announcements().items() if "Noise" not in name]
    enrolled = {name: [sound for file, sound in speech.items() if file.startswith(name)] for name in
                ("librivox", "cards")}
    strangers = {name: [sound for file, sound in speech.items() if file.startswith(tuple(files))]
                 for name, files in _STRANGERS.items()}
    return dict(enrolled, **({"announcements": announced} if announced else {})), strangers


def _heard(sounds: Sequence[np.ndarray], speed: float, random: np.random.RandomState) -> np.ndarray:
    """Return the speech (n,) in sounds, one after the other, without pauses, somewhere in a room."""
    spoken = []
    for sound in sounds:
        other = np.interp(np.arange(0.0, len(sound) - 1.0, speed), np.arange(len(sound)), sound)
        other *= 0.5 / np.abs(other).max()
        spoken.append(other[energy_labels(other)])
    room = Room((6.0, 5.0, 3.0), random.uniform(*_RT60))
    angle, distance = random.uniform(-np.pi, np.pi), random.uniform(0.8, 1.8)
    place = _MICROPHONE[0] + [distance * np.cos(angle), distance * np.sin(angle), 0.2]
    image = images_at(room.responses(place, _MICROPHONE), np.concatenate(spoken))
    return np.asarray(with_noise([image], random.uniform(*_SNR_DB), random)[:, 0], np.float32)


def _told(identity: VoiceIdentity, name: str, speech: np.ndarray) -> List[str]:
    """Return who is told of each piece of PIECE_S, empty for nobody."""
    found = []
    length = int(PIECE_S * RATE)
    for begin in range(0, len(speech) - length + 1, length):
        voice = "{}_{}".format(name, begin)
        identity.add(voice, speech[begin:begin + length])
        found.append(next((one.person_id for one in identity.current() if one.voice_id == voice), ""))
    identity.retain(())
    return found


def outcomes(seed: int, embedder: SpeakerEmbedder) -> List[Tuple[str, str]]:
    """Return (who speaks, who is told) of all pieces of one draw of rooms and speed; strangers are ""."""
    random = np.random.RandomState(seed)
    enrolled, strangers = _recordings()
    speed = SPEEDS[seed % len(SPEEDS)]
    identity = VoiceIdentity(embedder, MemoryGallery(MODEL, DIMENSION, CALIBRATION))
    for name, sounds in enrolled.items():
        identity.add("of_" + name, _heard(sounds[::2] if name == "librivox" else sounds, speed, random))
        identity.enrol("of_" + name, name)
    identity.retain(())
    found = [("librivox", told) for told in _told(identity, "librivox", _heard(enrolled["librivox"][1::2], speed,
                                                                               random))]
    for name, sounds in strangers.items():
        found += [("", told) for told in _told(identity, name, _heard(sounds, speed, random))]
    return found


def figures(draws: int = 60) -> Dict[str, object]:
    """Return speaker {precision, recall}, and counts. Raises FileNotFoundError, ModelError."""
    embedder = speaker_embedder()
    found = [pair for seed in range(FIRST_SEED, FIRST_SEED + draws) for pair in outcomes(seed, embedder)]
    told = [(who, person) for who, person in found if person]
    right = sum(who == person for who, person in told)
    known = sum(bool(who) for who, _ in found)
    return {"speaker": {"precision": round(right / len(told), 3) if told else None, "recall": round(right / known, 3)},
            "speaker_pieces": {"of_known": known, "of_strangers": len(found) - known, "told": len(told),
                               "threshold": LEAST_PRODUCT}}
