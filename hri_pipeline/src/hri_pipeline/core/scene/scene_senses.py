"""What sensors would say of a scene: faces, bodies and voices with noise, gaps, hidden people and changing ids."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Dict, FrozenSet, List, Optional, Sequence, Set, Tuple

import numpy as np

from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.ids import IdGenerator
from hri_pipeline.core.scene.scene_noise import Alternation, Noise
from hri_pipeline.core.scene.scene_projection import HIP_HEIGHT
from hri_pipeline.core.scene.scene_sight import CameraSight
from hri_pipeline.core.scene.scene_tracks import Tracks
from hri_pipeline.core.scene.scene_world import PersonTruth, SceneTruth

FACES, BODIES, VOICES = "faces", "bodies", "voices"
_GHOST_TIME = 0.3


@dataclass(frozen=True)
class SensedFace:
    """A face as a detector tells it. person: whose it is, empty for a ghost; never published.

    pose: face frame in the optical frame, m. gaze: (3,) unit in the optical frame, None while the eyes look closed.
    eyes_closed: 0 to 1. measured: False while it is listed but was not found in this image.
    """

    id: str
    person: str
    pose: Pose
    gaze: Optional[np.ndarray]
    eyes_closed: float
    speaking: bool
    measured: bool


@dataclass(frozen=True)
class SensedBody:
    """A body as a detector tells it; pose: body frame (between the hips), head: face frame, both in the optical frame, m."""

    id: str
    person: str
    pose: Pose
    head: Pose
    stature: float
    measured: bool


@dataclass(frozen=True)
class SensedVoice:
    """A voice; direction: (3,) unit in the optical frame, None while it is silent."""

    id: str
    person: str
    direction: Optional[np.ndarray]
    speaking: bool
    measured: bool


@dataclass(frozen=True)
class Sensed:
    """One cycle. camera: optical frame in `map`. fresh: which kinds were measured in this cycle; the others are as they were.

    visible: people whose face or body the sensors could find now, were it not for gaps.
    """

    stamp: float
    camera: Pose
    faces: Tuple[SensedFace, ...]
    bodies: Tuple[SensedBody, ...]
    voices: Tuple[SensedVoice, ...]
    fresh: FrozenSet[str]
    visible: FrozenSet[str]


class _Faults:
    """The chance of one person in one kind of feature."""

    def __init__(self, settings: SimpleNamespace, seed: str) -> None:
        chance = random.Random(seed)
        self.gap = Alternation(settings.sense_dropout, settings.sense_dropout_time, chance)
        self.place = Noise(3, settings.sense_noise_share, settings.sense_noise_time, chance)
        self.turns = Noise(4, settings.sense_noise_share, settings.sense_noise_time, chance)
        self.lids = Alternation(settings.sense_lid_errors, 0.1, chance)


class Senses:
    """Sees and hears one scene over time; `sense` takes truths whose stamps do not go back, else it begins anew.

    settings: the rows `sense_...` of scene_parameters.SCENE_PARAMETERS, width and height (see sense_defaults). camera_height: m.
    """

    def __init__(self, settings: SimpleNamespace, seed: int = 0, camera_height: float = 1.3) -> None:
        self._settings, self._seed, self._height = settings, seed, camera_height
        self._runs = 0
        self._ids = IdGenerator(seed)
        self.reset()

    def reset(self) -> None:
        """Forget everybody, as at the start of a scene; ids are never given again."""
        chance = random.Random("{} {} ids".format(self._seed, self._runs))
        self._runs += 1
        settings = self._settings
        self._tracks = {FACES: Tracks(settings, self._ids, chance, settings.sense_hold),
                        BODIES: Tracks(settings, self._ids, chance, settings.sense_hold),
                        VOICES: Tracks(settings, self._ids, chance, settings.sense_voice_hold)}
        self._faults: Dict[Tuple[str, str], _Faults] = {}
        self._due = dict.fromkeys((FACES, BODIES, VOICES), 0.0)
        self._ghost: Optional[Tuple[str, float, np.ndarray]] = None
        self._chance = random.Random("{} {} ghosts".format(self._seed, self._runs))
        self._last = -math.inf
        self._faces: Tuple[SensedFace, ...] = ()
        self._bodies: Tuple[SensedBody, ...] = ()
        self._voices: Tuple[SensedVoice, ...] = ()

    def sense(self, truth: SceneTruth) -> Sensed:
        """Return what is seen and heard of a truth."""
        now = truth.stamp
        if now < self._last - 1e-9:
            self.reset()
        passed, self._last = (now - self._last if math.isfinite(self._last) else 0.0), now
        sight = CameraSight(truth, self._settings, self._height)
        self._drop_gone(truth)
        fresh = frozenset(kind for kind in self._due if self._is_due(kind, now))
        faces, bodies = sight.faces(), sight.bodies()
        if FACES in fresh:
            self._faces = tuple(self._see_faces(truth, sight, faces, passed))
        if BODIES in fresh:
            self._bodies = tuple(self._see_bodies(truth, sight, bodies))
        if VOICES in fresh and self._settings.sense_voices:
            self._voices = tuple(self._hear(truth, sight))
        return Sensed(now, sight.camera, self._faces, self._bodies, self._voices, fresh, frozenset(faces | bodies))

    def _is_due(self, kind: str, now: float) -> bool:
        rate = getattr(self._settings, {FACES: "sense_face_rate", BODIES: "sense_body_rate", VOICES: "sense_voice_rate"}[kind])
        if rate <= 0.0:
            return True
        if now < self._due[kind] - 1e-6:
            return False
        # Counted from the last due time, so that cycles which do not divide evenly keep the rate on average.
        self._due[kind] = max(self._due[kind] + 1.0 / rate, now - 1.0 / rate)
        return True

    def _drop_gone(self, truth: SceneTruth) -> None:
        present = {person.id for person in truth.people}
        self._faults = {key: faults for key, faults in self._faults.items() if key[1] in present}

    def _of(self, kind: str, person: str) -> _Faults:
        key = (kind, person)
        if key not in self._faults:
            self._faults[key] = _Faults(self._settings, "{} {} {} {}".format(self._seed, self._runs, kind, person))
        return self._faults[key]

    def _found(self, kind: str, seen: Set[str], now: float) -> Set[str]:
        return {person for person in seen if not self._of(kind, person).gap.update(now)}

    def _see_faces(self, truth: SceneTruth, sight: CameraSight, seen: Set[str], passed: float) -> List[SensedFace]:
        found = self._found(FACES, seen, truth.stamp)
        before = {face.id: face for face in self._faces}
        people = {person.id: person for person in truth.people}
        faces = []
        for person, identity in self._tracks[FACES].update(found, truth.stamp):
            if person in found:
                faces.append(self._face(identity, people[person], sight, truth.stamp))
            elif identity in before:
                faces.append(_stale(before[identity], measured=False))
        return faces + self._ghosts(sight, truth.stamp, passed)

    def _face(self, identity: str, person: PersonTruth, sight: CameraSight, now: float) -> SensedFace:
        faults, settings = self._of(FACES, person.id), self._settings
        turns = faults.turns.update(now)
        pose = self._placed(sight.optical(person.head, person.head_rotation), faults.place.update(now))
        head = math.radians(settings.sense_head_noise)
        pose = Pose(pose.rotation @ _turn(head * turns[0], head * turns[1]), pose.translation)
        looks_closed = person.eyes_closed != faults.lids.update(now)
        gaze = None
        if not looks_closed:
            noise = math.radians(settings.sense_gaze_noise)
            gaze = _swayed(sight.camera.rotation.T @ person.gaze, noise * turns[2], noise * turns[3])
        return SensedFace(identity, person.id, pose, gaze, 0.95 if looks_closed else 0.05, person.speaking, True)

    def _see_bodies(self, truth: SceneTruth, sight: CameraSight, seen: Set[str]) -> List[SensedBody]:
        found = self._found(BODIES, seen, truth.stamp)
        before = {body.id: body for body in self._bodies}
        people = {person.id: person for person in truth.people}
        bodies = []
        for person, identity in self._tracks[BODIES].update(found, truth.stamp):
            if person in found:
                bodies.append(self._body(identity, people[person], sight, truth.stamp))
            elif identity in before:
                bodies.append(_stale(before[identity], measured=False))
        return bodies

    def _body(self, identity: str, person: PersonTruth, sight: CameraSight, now: float) -> SensedBody:
        faults, settings = self._of(BODIES, person.id), self._settings
        turns, place = faults.turns.update(now), faults.place.update(now)
        yaw = person.yaw + math.radians(settings.sense_body_noise) * turns[0]
        hips = np.array([person.position[0], person.position[1], HIP_HEIGHT * person.stature])
        upright = np.array([[math.cos(yaw), -math.sin(yaw), 0.0], [math.sin(yaw), math.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
        pose = self._placed(sight.optical(hips, upright), place)
        # A skeleton is one piece: its head is displaced as the hips are.
        head = sight.optical(person.head, person.head_rotation)
        noise = math.radians(settings.sense_head_noise)
        moved = pose.translation - sight.optical(hips, upright).translation
        head = Pose(head.rotation @ _turn(noise * turns[1], noise * turns[2]), head.translation + moved)
        return SensedBody(identity, person.id, pose, head, person.stature, True)

    def _hear(self, truth: SceneTruth, sight: CameraSight) -> List[SensedVoice]:
        people = {person.id: person for person in truth.people}
        speaking = {person.id for person in truth.people if person.speaking}
        voices = []
        for person, identity in self._tracks[VOICES].update(speaking, truth.stamp):
            direction = None
            if person in speaking:
                turns = self._of(VOICES, person).turns.update(truth.stamp)
                noise = math.radians(self._settings.sense_voice_noise)
                place = sight.optical(people[person].head, np.eye(3)).translation
                direction = _swayed(place / np.linalg.norm(place), noise * turns[0], noise * turns[1])
            voices.append(SensedVoice(identity, person, direction, person in speaking, person in speaking))
        return voices

    def _placed(self, pose: Pose, noise: Sequence[float]) -> Pose:
        """Displace a pose along the line of sight and across."""
        distance = float(np.linalg.norm(pose.translation))
        along = pose.translation / distance
        across = self._settings.sense_position_noise * np.array(noise)
        across -= (across @ along) * along
        return Pose(pose.rotation, pose.translation + across + self._settings.sense_depth_noise * distance * noise[2] * along)

    def _ghosts(self, sight: CameraSight, now: float, passed: float) -> List[SensedFace]:
        """A face where nobody is, one at a time."""
        if self._ghost is not None and now > self._ghost[1]:
            self._ghost = None
        if self._ghost is None and self._chance.random() < self._settings.sense_ghosts / 60.0 * passed:
            depth = self._chance.uniform(1.0, self._settings.sense_face_range)
            side = math.tan(0.45 * math.radians(self._settings.sense_hfov)) * depth * self._chance.uniform(-1.0, 1.0)
            until = now + 0.5 + self._chance.expovariate(1.0 / _GHOST_TIME)
            self._ghost = (self._ids.new(), until, np.array([side, self._chance.uniform(-0.3, 0.3), depth]))
        if self._ghost is None:
            return []
        towards = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
        return [SensedFace(self._ghost[0], "", Pose(towards, self._ghost[2]), None, 0.5, False, True)]


def _stale(feature, measured: bool):
    values = dict(feature.__dict__, measured=measured)
    return type(feature)(**values)


def _turn(yaw: float, pitch: float) -> np.ndarray:
    """(3, 3) small turn about z and y of the own frame."""
    cy, sy, cp, sp = math.cos(yaw), math.sin(yaw), math.cos(pitch), math.sin(pitch)
    return np.array([[cy * cp, -sy, cy * sp], [sy * cp, cy, sy * sp], [-sp, 0.0, cp]])


def _swayed(direction: np.ndarray, first: float, second: float) -> np.ndarray:
    """Unit vector turned by two angles (rad) across its direction."""
    aside = np.cross(direction, (0.0, 1.0, 0.0) if abs(direction[1]) < 0.9 else (1.0, 0.0, 0.0))
    aside /= np.linalg.norm(aside)
    angle = math.hypot(first, second)
    if angle < 1e-12:
        return direction.copy()
    across = (first * aside + second * np.cross(direction, aside)) / angle
    return math.cos(angle) * direction + math.sin(angle) * across
