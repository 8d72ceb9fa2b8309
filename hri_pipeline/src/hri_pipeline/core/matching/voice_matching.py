"""Whose voice it is: mouths, directions and places in, one match for each voice at most out."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Dict, Iterable, List, Mapping, NamedTuple, Optional, Sequence, Set, Tuple

import numpy as np

from hri_pipeline.core.matching.mouth_motion import WINDOW_S, MouthTrack
from hri_pipeline.core.matching.speaking_times import BRIDGE_S, MARGIN_S, SpeakingTimes
from hri_pipeline.core.matching.voice_evidence import (
    NEAR,
    SILENT,
    SPEAKING,
    STEP_S,
    UNKNOWN,
    direction_evidence,
    motion_evidence,
    mouth_evidence,
)

FACE, PERSON = "face", "person"
HOLD_LIKELIHOOD = 0.5
BEFORE_S = 2.0
"""Of what a mouth did before its voice began, so much is compared."""
LATE_S = 0.15
"""Motion is compared up to so long ago: the rest of its window is still to come."""
DISPLACED = 0.9
"""Likelihood of an earlier voice of a face, as part of that of the voice that speaks now: both are of one human, and
the one that speaks now is the person's voice."""
LOST_WEIGHT = 0.3
"""How likely somebody speaks who was seen at a place before, against a face in view: who was lost may have a new face by now."""
JUMP_BACK_S = 0.5
MAX_MOUTHS = 200

Candidate = Tuple[str, str]


class VoiceMatch(NamedTuple):
    """Likelihood (0..1) that a voice is that of a face or of a person (`kind`)."""

    voice: str
    kind: str
    id: str
    confidence: float


class _Voice:
    """What is known of one voice. angles: rad and distance (m) of the candidates, seen from its microphone."""

    def __init__(self, times: SpeakingTimes) -> None:
        self.times = times
        self.angles: Dict[Candidate, Tuple[float, float]] = {}
        self.match: Optional[Candidate] = None
        self.likelihood = 0.0


class VoiceMatcher:
    """Follows voices and faces, and tells which voice belongs to whom.

    For each voice that speaks there are competing hypotheses: each face in view, each person in a known direction
    whose face nobody sees, and nobody of them. Evidence of mouth and direction is added up as log-likelihood
    ratios. Once a voice has ended its match stays as it is.
    """

    def __init__(self, settings: SimpleNamespace) -> None:
        """Take the settings of `voice_matcher_parameters.VOICE_MATCHER_PARAMETERS`."""
        self._settings = settings
        self._faces: Set[str] = set()
        self._persons: Dict[str, Tuple[str, str]] = {}
        self._lost: Set[str] = set()
        self._voices: Dict[str, _Voice] = {}
        self._mouths: Dict[str, MouthTrack] = {}
        self._past: List[SpeakingTimes] = []
        self._now = -math.inf

    @property
    def is_busy(self) -> bool:
        """Tell whether a voice speaks, or has just ended, so that there is something to compare."""
        return any(self._is_open(voice, self._now) for voice in self._voices.values())

    @property
    def voices(self) -> List[str]:
        """Ids of the voices that are tracked."""
        return list(self._voices)

    def set_tracked(self, kind: str, ids: Iterable[str]) -> None:
        """Take the ids of "faces" or "voices" that are tracked; what is known of the others is dropped."""
        ids = set(ids)
        if kind == "faces":
            self._faces = ids
            self._mouths = {face: track for face, track in self._mouths.items() if face in ids}
            return
        self._past = [times for times in self._past if times.last > self._now - self._settings.memory]
        self._past += [self._voices.pop(voice).times for voice in set(self._voices) - ids]
        for voice in ids - set(self._voices):
            self._voices[voice] = _Voice(SpeakingTimes(self._settings.onset_delay, self._settings.hangover))

    def has_left(self, match: Tuple[str, str, str]) -> bool:
        """Tell whether the voice, or the face, of (voice, kind, id) is no longer tracked."""
        voice, kind, id = match
        return voice not in self._voices or (kind == FACE and id not in self._faces)

    def set_persons(self, persons: Mapping[str, Tuple[str, str]], lost: Iterable[str] = ()) -> None:
        """Take the persons that are there, with the ids of their face and their voice, empty where there is none.

        lost: others, who were there and may still be where they were last.
        """
        self._lost = set(lost) - set(persons)
        self._persons = {**dict.fromkeys(self._lost, ("", "")), **persons}

    def on_speaking(self, voice: str, speaking: bool, arrival: float) -> None:
        """Take the message, arrived at `arrival` (s), that a tracked voice begins or ends to speak."""
        self._pass(arrival)
        if voice in self._voices:
            self._voices[voice].times.say(speaking, arrival)

    def add_mouth(self, face: str, stamp: float, opening: float, weight: float) -> None:
        """Take the opening (0..1) of a tracked face's mouth in the image of time `stamp` (s); weight: 0..1."""
        if face in self._faces and len(self._mouths) < MAX_MOUTHS:
            self._mouths.setdefault(face, MouthTrack()).add(stamp, opening, weight)

    def set_direction(self, voice: str, direction: Optional[Sequence[float]],
                      positions: Mapping[Candidate, Sequence[float]]) -> None:
        """Take where a voice comes from, and where the candidates are: (3,) in the frame of the microphone, m.

        direction: of any length; None while it is not known.
        """
        if voice in self._voices:
            self._voices[voice].angles = {} if direction is None else {
                candidate: _angle(np.asarray(direction, dtype=float), np.asarray(position, dtype=float))
                for candidate, position in positions.items()}

    def matches(self, now: float) -> List[VoiceMatch]:
        """Compare at time `now` (s); return the matches that hold, at most one for each voice."""
        self._pass(now)
        speaking = [name for name, voice in self._voices.items() if self._is_open(voice, now)]
        if speaking:
            self._compare(speaking, now)
        return self._holding(set(speaking))

    def _pass(self, now: float) -> None:
        """Let time pass; when it jumps back, everything but who is tracked is forgotten."""
        if now < self._now - JUMP_BACK_S:
            voices, self._voices = list(self._voices), {}
            self.set_tracked("voices", voices)
            self._past.clear()
            self._mouths.clear()
        self._now = now

    @staticmethod
    def _is_open(voice: _Voice, now: float) -> bool:
        return now - voice.times.last <= BRIDGE_S + MARGIN_S

    def _compare(self, names: List[str], now: float) -> None:
        """Choose anew whose voices those are that speak."""
        faces = sorted(self._faces)
        mouths = self._mouth_evidence(names, faces, now)
        claims: List[Tuple[float, str, Candidate]] = []
        for row, name in enumerate(names):
            voice = self._voices[name]
            scores = {(FACE, face): float(mouths[row, column]) for column, face in enumerate(faces)}
            scores.update(((PERSON, id), math.log(LOST_WEIGHT) if id in self._lost else 0.0)
                          for id in self._unseen_persons(name))
            likelihoods = self._likelihoods(voice, scores)
            for candidate, value in likelihoods.items():
                if value >= (HOLD_LIKELIHOOD if candidate == voice.match else self._settings.min_likelihood):
                    claims.append((value, name, candidate))
            voice.match = None
        taken: Set[Candidate] = set()
        for value, name, candidate in sorted(claims, reverse=True):
            if candidate not in taken and self._voices[name].match is None:
                taken.add(candidate)
                self._voices[name].match, self._voices[name].likelihood = candidate, value

    def _likelihoods(self, voice: _Voice, scores: Dict[Candidate, float]) -> Dict[Candidate, float]:
        """Posterior of each candidate, against the others and nobody of them."""
        candidates = list(scores)
        values = np.array([scores[candidate] for candidate in candidates] + [math.log(self._settings.unseen_weight)])
        for index, candidate in enumerate(candidates):
            if candidate in voice.angles:
                values[index] += direction_evidence(*map(np.asarray, voice.angles[candidate]), self._settings.direction_sd)
            if candidate == voice.match:
                values[index] += self._settings.stay_bonus
        odds = np.exp(values - values.max())
        return dict(zip(candidates, (odds / odds.sum())[:-1].tolist()))

    def _unseen_persons(self, name: str) -> List[str]:
        """Persons without a face that are in a known direction from the microphone of a voice, but not this voice alone."""
        voice = self._voices[name]
        return [id for kind, id in voice.angles if kind == PERSON and id in self._persons
                and not self._persons[id][0] and (self._persons[id][1] != name or voice.match == (PERSON, id))]

    def _mouth_evidence(self, names: List[str], faces: List[str], now: float) -> np.ndarray:
        """Log-likelihood ratios (V, F) of the mouths of all faces for these voices."""
        first = min(self._voices[name].times.first for name in names) - BEFORE_S
        end = now - LATE_S
        count = int((end - max(first, now - self._settings.memory)) / STEP_S)
        evidence = np.zeros((len(names), len(faces)))
        moving = [face for face in faces if face in self._mouths]
        if count < 1 or not moving:
            return evidence
        times = end - STEP_S * np.arange(count)[::-1]
        tracks = [self._mouths[face].motion(times) for face in moving]
        ratios = np.array([motion_evidence(motion, weight, self._settings.still_motion) for motion, weight in tracks])
        speech = np.array([self._speech(name, times) for name in names])
        evidence[:, [faces.index(face) for face in moving]] = mouth_evidence(speech, ratios)
        return evidence

    def _speech(self, name: str, times: np.ndarray) -> np.ndarray:
        """State (T,) of a voice at the times: SPEAKING, NEAR its speech, UNKNOWN while others speak, else SILENT."""
        own = self._voices[name].times
        others = [voice.times for other, voice in self._voices.items() if other != name]
        busy = np.zeros(len(times), dtype=bool)
        for spoken in others + self._past:
            busy |= spoken.at(times, 0.5 * WINDOW_S)
        quiet = np.where(busy, UNKNOWN, np.where(own.at(times, MARGIN_S), NEAR, SILENT))
        return np.where(own.at(times), SPEAKING, quiet)

    def _holding(self, speaking: Set[str]) -> List[VoiceMatch]:
        """The matches that hold: those of voices that speak, and those of earlier voices whose match is still there."""
        found: List[VoiceMatch] = []
        best: Dict[Candidate, float] = {}
        for name in sorted(self._voices, key=lambda name: (name not in speaking, -self._voices[name].times.last)):
            voice = self._voices[name]
            if voice.match is None or not self._is_there(voice.match):
                voice.match = None
                continue
            value = min(voice.likelihood, best.get(voice.match, math.inf))
            best[voice.match] = DISPLACED * value
            found.append(VoiceMatch(name, *voice.match, value))
        return found

    def _is_there(self, candidate: Candidate) -> bool:
        kind, id = candidate
        return id in self._faces if kind == FACE else id in self._persons


def _angle(direction: np.ndarray, position: np.ndarray) -> Tuple[float, float]:
    """Angle (rad) between a direction and a place, and the distance (m) of the place."""
    distance = float(np.linalg.norm(position))
    across = float(np.linalg.norm(np.cross(direction, position)))
    return math.atan2(across, float(direction @ position)), distance
