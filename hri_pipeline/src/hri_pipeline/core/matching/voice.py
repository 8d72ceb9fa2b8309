"""Whose voice it is: mouths, directions and places in, at most one match for each voice out.

The evidence consists of log-likelihood ratios that a voice comes from a face: the motion of the mouth while it speaks,
and its direction. The mouth is a chain of two states, still and moving, observed through the measured motion (hidden
Markov model; Rabiner 1989, Proc. IEEE 77). If the voice belongs to the face, speech drives the chain: the mouth begins
to move when the voice begins and rests when it ends. If it does not, the mouth moves when it likes: it smiles, chews,
or talks to somebody else. The ratio of both likelihoods therefore rewards what changes together, punishes a mouth that
rests while the voice speaks, and gains little from a mouth that moves all the time.
"""

from __future__ import annotations

import math
from typing import Dict, Iterable, List, Mapping, NamedTuple, Optional, Sequence, Set, Tuple

import numpy as np

from hri_pipeline.core.matching.parameters import VoiceMatcherSettings
from hri_pipeline.core.timing import JUMP_BACK_S

FACE, PERSON = "face", "person"
HOLD_LIKELIHOOD = 0.5
BEFORE_S = 2.0
"""Time (s) before a voice began from which the motion of mouths is compared."""
LATE_S = 0.15
"""Motion is compared up to so long ago: the rest of its window is still to come."""
DISPLACED = 0.9
"""Likelihood of an earlier voice of a face, as part of that of the voice that speaks now: both are of one human, and
the one that speaks now is the person's voice."""
LOST_WEIGHT = 0.3
"""How likely somebody speaks who was seen at a place before, against a face in view: who was lost may have a new face
by now."""
MAX_MOUTHS = 200

VoiceCandidate = Tuple[str, str]


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
        self.angles: Dict[VoiceCandidate, Tuple[float, float]] = {}
        self.match: Optional[VoiceCandidate] = None
        self.likelihood = 0.0


class VoiceMatcher:
    """Follows voices and faces, and decides which voice belongs to whom.

    For each voice that speaks there are competing hypotheses: each face in view, each person in a known direction
    whose face nobody sees, and nobody of them. Evidence of mouth and direction is added up as log-likelihood
    ratios. Once a voice has ended its match stays as it is.
    """

    def __init__(self, settings: VoiceMatcherSettings) -> None:
        self._settings = settings
        self._faces: Set[str] = set()
        self._persons: Dict[str, Tuple[str, str]] = {}
        self._lost: Set[str] = set()
        self._voices: Dict[str, _Voice] = {}
        self._mouths: Dict[str, MouthTrack] = {}
        self._past: List[SpeakingTimes] = []
        self._now = -math.inf

    def reconfigure(self, settings: VoiceMatcherSettings) -> None:
        """Take up the values of the live parameters."""
        self._settings = settings

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
        for voice in set(self._voices) - ids:
            times = self._voices.pop(voice).times
            times.say(False, self._now)     # also of one whose node has ended while it spoke
            self._past.append(times)
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
        if face in self._mouths or (face in self._faces and len(self._mouths) < MAX_MOUTHS):
            self._mouths.setdefault(face, MouthTrack()).add(stamp, opening, weight)

    def set_direction(self, voice: str, direction: Optional[Sequence[float]],
                      positions: Mapping[VoiceCandidate, Sequence[float]]) -> None:
        """Take where a voice comes from, and where the candidates are: (3,) in the frame of the microphone, m.

        direction: of any length; None while it is not known.
        """
        if voice in self._voices:
            angles = {} if direction is None else {candidate: _angle(direction, position)
                                                   for candidate, position in positions.items()}
            # Of what is no place nothing is known; beside it the others would be as unlikely.
            self._voices[voice].angles = {candidate: angle for candidate, angle in angles.items()
                                          if all(map(math.isfinite, angle))}

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
        proposals: List[Tuple[float, str, VoiceCandidate]] = []
        for row, name in enumerate(names):
            voice = self._voices[name]
            scores = {(FACE, face): float(mouths[row, column]) for column, face in enumerate(faces)}
            scores.update(((PERSON, id), math.log(LOST_WEIGHT) if id in self._lost else 0.0)
                          for id in self._unseen_persons(name))
            likelihoods = self._likelihoods(voice, scores)
            for candidate, value in likelihoods.items():
                if value >= (HOLD_LIKELIHOOD if candidate == voice.match else self._settings.min_likelihood):
                    proposals.append((value, name, candidate))
            voice.match = None
        taken: Set[VoiceCandidate] = set()
        for value, name, candidate in sorted(proposals, reverse=True):
            if candidate not in taken:      # one of a voice at most: two are not likelier than not
                taken.add(candidate)
                self._voices[name].match, self._voices[name].likelihood = candidate, value

    def _likelihoods(self, voice: _Voice, scores: Dict[VoiceCandidate, float]) -> Dict[VoiceCandidate, float]:
        """Posterior of each candidate, against the others and nobody of them."""
        candidates = list(scores)
        values = np.array([scores[candidate] for candidate in candidates] + [math.log(self._settings.unseen_weight)])
        placed = [index for index, candidate in enumerate(candidates) if candidate in voice.angles]
        if placed:
            angles, distances = np.array([voice.angles[candidates[index]] for index in placed]).T
            values[placed] += direction_evidence(angles, distances, self._settings.direction_sd)
        if voice.match is not None and voice.match in scores:
            values[candidates.index(voice.match)] += self._settings.stay_bonus
        odds = np.exp(values - values.max())
        return dict(zip(candidates, (odds / odds.sum())[:-1].tolist()))

    def _unseen_persons(self, name: str) -> List[str]:
        """Persons without a face that are in a known direction from the microphone of a voice, but not this voice
        alone."""
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
        motions, weights = np.array([self._mouths[face].motion(times) for face in moving]).swapaxes(0, 1)
        ratios = motion_evidence(motions, weights, self._settings.still_motion)
        speech = np.array([self._speech(name, times) for name in names])
        others = self._settings.unseen_weight + len(faces) - len(moving)
        evidence[:, [faces.index(face) for face in moving]] = mouth_evidence(speech, ratios, others)
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
        best: Dict[VoiceCandidate, float] = {}
        for name in sorted(self._voices, key=lambda name: (name not in speaking, -self._voices[name].times.last)):
            voice = self._voices[name]
            if voice.match is None or not self._is_there(voice.match):
                voice.match = None
                continue
            value = min(voice.likelihood, best.get(voice.match, math.inf))
            best[voice.match] = DISPLACED * value
            found.append(VoiceMatch(name, *voice.match, value))
        return found

    def _is_there(self, candidate: VoiceCandidate) -> bool:
        kind, id = candidate
        return id in self._faces if kind == FACE else id in self._persons


def _angle(direction: Sequence[float], position: Sequence[float]) -> Tuple[float, float]:
    """Angle (rad) between a direction and a place, and the distance (m) of the place."""
    # Plain numbers: for each face and person in view, and numpy takes twenty times as long for three of them.
    (a, b, c), (x, y, z) = map(float, direction), map(float, position)
    across = math.hypot(math.hypot(b * z - c * y, c * x - a * z), a * y - b * x)
    return math.atan2(across, a * x + b * y + c * z), math.hypot(math.hypot(x, y), z)


SILENT, UNKNOWN, NEAR, SPEAKING = 0, 1, 2, 3
STEP_S = 0.1
"""Distance of the times at which motion is compared."""

# Rates (1/s) at which a mouth begins to move and comes to rest.
_IDLE = (0.1, 0.6)
"""Of whoever does not speak: moves for 1.7 s every 10 s, a seventh of the time."""
_SPEAKING = (3.0, 0.3)
"""While its voice speaks: moves after a third of a second, rests now and then."""
_SILENT = (0.1, 4.0)
"""While its voice is silent and nobody else speaks."""

_SLOPE, _MOST = 3.0, 3.0
"""Log-likelihood ratio of moving against still: slope over the logarithm of the motion, and its limit."""
_NEAR = (1.5, 2.0)
"""Just before and after its voice speaks: lips part before the first sound, and close after the last."""

_INDEPENDENT_S = 0.35
"""Motions so far apart in time are independent: their window is half a second long."""
NEW_PER_S, NEW_AFTER_PAUSE = 0.05, 0.5
"""Probability, per second of speech and over a pause, that the same voice goes on as anybody's, whoever it was (without
an array a voice is whoever speaks)."""
_MOST_ODDS = 150.0

_STRAY = 0.05
"""Share of the directions that are wrong: echoes, and peaks between two speakers."""
_LEVEL_PART = 0.34
"""Part of all directions from which people speak: some 20 degrees about the level of the microphone. Who is out of view
stands on the same floor as who is in view."""
POSITION_SD = 0.15
"""Standard deviation (m) of the place of a head against the microphone: of its distance and of the calibration."""


def motion_evidence(motion: np.ndarray, weight: np.ndarray, still_motion: float) -> np.ndarray:
    """Return the log-likelihood ratios (..., T) of mouths that move against ones that are still, 0 where the motion is
    not known.

    Parameters
    ----------
    motion: (..., T) array
        Standard deviation of the opening (0 to 1), NaN where unknown.
    weight: (..., T) array
        Confidence of the motion, 0 to 1.
    still_motion: float
        Motion at which both are as likely.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = _SLOPE * np.log(np.maximum(motion, 1e-4) / still_motion)
    return np.where(np.isnan(motion), 0.0, weight * np.clip(ratio, -_MOST, _MOST))


def mouth_evidence(speech: np.ndarray, moving: np.ndarray, others: float = 1.0) -> np.ndarray:
    """Return the log-likelihood ratios (V, F) that voices belong to faces, from motion against speech.

    Parameters
    ----------
    speech: (V, T) array
        SILENT, UNKNOWN, NEAR or SPEAKING for each voice, at times STEP_S apart. UNKNOWN: nothing follows from the
        motion, because somebody else speaks, who may be this face.
    moving: (F, T) array
        Of motion_evidence() at the same times.
    others: float
        Prior odds of all who may speak beside these faces, against one face.
    """
    # The first row is the chain of a mouth that goes its own way, the same for all voices.
    rows = np.concatenate([np.full((1, moving.shape[1]), UNKNOWN), speech])
    stay, come = np.array([_step(rates) for rates in (_SILENT, _IDLE, _NEAR, _SPEAKING)])[rows].T[..., None]
    odds = np.exp(moving.T * (STEP_S / _INDEPENDENT_S)) - 1.0
    held = stay - come
    moves = np.full((len(rows), len(moving)), _IDLE[0] / sum(_IDLE))
    totals = np.empty((moving.shape[1],) + moves.shape)
    for time, total in enumerate(totals):
        # Forward algorithm: probability that it moves now, then the likelihood of what was measured.
        moves = come[time] + held[time] * moves
        np.multiply(moves, odds[time], out=total)
        moves += total
        total += 1.0
        moves /= total
    gains = totals[:, 1:] / totals[:, :1]
    ends = np.diff(speech == SPEAKING, axis=1, prepend=False) & (speech != SPEAKING)
    fresh = np.where(ends, NEW_AFTER_PAUSE, NEW_PER_S * STEP_S).T[..., None]
    evidence = np.ones(gains.shape[1:])
    for gain, part in zip(gains, fresh):
        evidence = np.minimum(evidence * gain, _MOST_ODDS)
        # Who may be somebody else is anybody with his prior probability, in units of what is now the others'.
        anybody = part * (evidence.sum(axis=1, keepdims=True) + others) / (evidence.shape[1] + others)
        evidence = ((1.0 - part) * evidence + anybody) / (1.0 - part + anybody)
    return np.log(evidence)


def direction_evidence(angle: np.ndarray, distance: np.ndarray, direction_sd: float) -> np.ndarray:
    """Log-likelihood ratio that a voice comes from a place against from anywhere.

    angle: rad between the voice and the place, seen from the microphone; distance: m of the place. Fisher's
    distribution on the sphere for small angles: density exp(-angle^2 / 2 s^2) / (2 pi s^2), against 1 / (4 pi) over the
    part of the sphere from which people speak.
    """
    variance = direction_sd ** 2 + (POSITION_SD / np.maximum(distance, POSITION_SD)) ** 2
    at_place = 2.0 * _LEVEL_PART / variance * np.exp(-0.5 * angle ** 2 / variance)
    return np.log((1.0 - _STRAY) * at_place + _STRAY)


def _step(rates: Tuple[float, float]) -> Tuple[float, float]:
    """Probabilities of moving after STEP_S for a mouth that moved, and for one that was still."""
    part, left = rates[0] / sum(rates), math.exp(-sum(rates) * STEP_S)
    return part + (1.0 - part) * left, part * (1.0 - left)


LIPS_PART, JAW_DROP = 25, 26
JAW_SHARE = 0.25
"""Share of the jaw (AU26) in the opening: lips that stay closed over a moving jaw chew, they do not speak."""
WINDOW_S = 0.5
"""Span in which the motion is measured: two syllables (speech has 4 to 5 a second; Greenberg 2003, J. Phonetics 31)."""
MIN_SAMPLES = 3
MIN_SPAN_S = 0.15
_WIDEST = 3.0
"""Who speaks with a broad smile moves the lips beyond where AU25 is at its fullest; action units cannot express
that."""
_CAPACITY = 1024
"""Samples kept: half of them are 17 s at 30 images a second."""

# Landmarks of dlib's scheme: the inner lips, upper and lower one of each pair; both eyes; the base of the nose.
_UPPER, _LOWER = (61, 62, 63), (67, 66, 65)
_EYES, _NOSE_BASE = tuple(range(36, 48)), 33
_EYES_TO_NOSE = 0.77
"""Height from the middle of the eyes to the base of the nose in distances of the eyes, in the canonical face."""
_GAP_START, _GAP_FULL = 0.02, 0.20
"""Gap of the lips in distances of the eyes at which AU25 begins and is at its fullest, as in the table of the action
units."""


def opening_of_units(intensity: np.ndarray, confidence: np.ndarray) -> Tuple[float, float]:
    """Return opening (0..1) and weight (0..1; 0: not known) out of the 99 action units of a face."""
    weight = float(confidence[LIPS_PART])
    if not weight > 0.0:
        return 0.0, 0.0
    jaw = float(intensity[JAW_DROP]) if confidence[JAW_DROP] > 0.0 else float(intensity[LIPS_PART])
    return (1.0 - JAW_SHARE) * float(intensity[LIPS_PART]) + JAW_SHARE * jaw, min(1.0, weight)


def opening_of_landmarks(landmarks: np.ndarray, aspect: float) -> Tuple[float, float]:
    """Return opening (on the scale of AU25, and beyond it up to 3) and weight out of landmarks (70, 3): x, y in 0..1,
    confidence.

    aspect: width over height of the image. The gap of the inner lips is measured against the height from the eyes to
    the base of the nose, which neither a turn of the head nor the jaw changes much.
    """
    points = landmarks[:, :2] * np.array([aspect, 1.0])
    height = float(np.linalg.norm(points[list(_EYES)].mean(axis=0) - points[_NOSE_BASE]))
    used = list(_UPPER + _LOWER + _EYES) + [_NOSE_BASE]
    weight = float(landmarks[used, 2].min())
    if not height > 1e-6 or not weight > 0.0:
        return 0.0, 0.0
    gap = float(np.linalg.norm(points[list(_UPPER)] - points[list(_LOWER)], axis=1).mean())
    part = (gap / height * _EYES_TO_NOSE - _GAP_START) / (_GAP_FULL - _GAP_START)
    return float(np.clip(part, 0.0, _WIDEST)), min(1.0, weight)


class MouthTrack:
    """Opening of one mouth over the last seconds."""

    def __init__(self) -> None:
        self._samples = np.empty((_CAPACITY, 3))
        self._count = self._older = 0

    @property
    def newest(self) -> float:
        """Stamp (s) of the last sample, minus infinity without one."""
        return float(self._samples[self._count - 1, 0]) if self._count else float("-inf")

    def add(self, stamp: float, opening: float, weight: float) -> None:
        """Take the opening (0..1) in the image of time `stamp` (s); one that is not newer, or without weight, is left
        out. Several that are much older tell that the newest one was wrong: the mouth begins anew."""
        self._older = self._older + 1 if stamp < self.newest - KEEP_S else 0
        if self._older >= MIN_SAMPLES:
            self._count = self._older = 0
        if weight <= 0.0 or stamp <= self.newest:
            return
        if self._count == _CAPACITY:
            self._samples[:_CAPACITY // 2] = self._samples[_CAPACITY // 2:]
            self._count = _CAPACITY // 2
        self._samples[self._count] = stamp, opening, weight
        self._count += 1

    def motion(self, times: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Return the motion (T,), standard deviation of the opening around each of the times (s), and its weight (T,).

        times: in ascending order. NaN and 0 where less than MIN_SAMPLES samples lie in the window.
        """
        begin = int(np.searchsorted(self._samples[:self._count, 0], times[0] - 0.5 * WINDOW_S))
        stamps, openings, weights = self._samples[begin:self._count].T
        if not len(stamps):
            return np.full(len(times), np.nan), np.zeros(len(times))
        first = np.searchsorted(stamps, times - 0.5 * WINDOW_S, side="left")
        last = np.searchsorted(stamps, times + 0.5 * WINDOW_S, side="right")
        count = last - first
        sums = np.zeros((3, len(stamps) + 1))
        np.cumsum(np.stack([openings, openings ** 2, weights]), axis=1, out=sums[:, 1:])
        total, squares, weight = sums[:, last] - sums[:, first]
        known = count >= MIN_SAMPLES
        known[known] &= stamps[last[known] - 1] - stamps[first[known]] >= MIN_SPAN_S
        safe = np.maximum(count, 2)
        variance = np.maximum(0.0, squares - total ** 2 / safe) / (safe - 1)
        return np.where(known, np.sqrt(variance), np.nan), np.where(known, weight / safe, 0.0)


KEEP_S = 20.0
BRIDGE_S = 0.5
"""Pauses up to this long are no silence: between two words a mouth moves on."""
MARGIN_S = 0.4
"""So long before and after speech a mouth may move or not: lips part before the first sound."""


class SpeakingTimes:
    """Intervals (s) in which one voice spoke.

    onset_delay: s from the first sound to the arrival of the message that says so; hangover: s from the last sound to
    the arrival of the message that says that it is over.
    """

    def __init__(self, onset_delay: float, hangover: float) -> None:
        self._onset_delay, self._hangover = onset_delay, hangover
        self._intervals: List[List[float]] = []
        self.speaking = False

    @property
    def first(self) -> float:
        """Start (s) of the first interval that is kept, infinity when the voice has not spoken."""
        return self._intervals[0][0] if self._intervals else float("inf")

    @property
    def last(self) -> float:
        """End (s) of the last interval, infinity while the voice speaks, minus infinity when it never did."""
        return self._intervals[-1][1] if self._intervals else float("-inf")

    def say(self, speaking: bool, arrival: float) -> bool:
        """Take a message that arrived at `arrival` (s); returns whether it changes anything."""
        if speaking == self.speaking:
            return False
        self.speaking = speaking
        if not speaking:
            self._intervals[-1][1] = max(self._intervals[-1][0], arrival - self._hangover)
        elif arrival - self._onset_delay <= self.last + BRIDGE_S:
            self._intervals[-1][1] = float("inf")
        else:
            self._intervals.append([arrival - self._onset_delay, float("inf")])
        self._intervals = [interval for interval in self._intervals if interval[1] >= arrival - KEEP_S]
        return True

    def at(self, times: np.ndarray, margin: float = 0.0) -> np.ndarray:
        """Tell for each of the times (T,) s whether the voice spoke, up to `margin` s before or after."""
        spoke = np.zeros(len(times), dtype=bool)
        for start, end in self._intervals:
            spoke |= (times >= start - margin) & (times <= end + margin)
        return spoke
