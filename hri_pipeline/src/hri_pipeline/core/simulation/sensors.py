"""What sensors, trackers, matchers and a recogniser would report of a scene.

Field of view and occlusion, noise, gaps, ids that come late and change, false features, candidate matches.
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass
from typing import Callable, Dict, FrozenSet, List, NamedTuple, Optional, Sequence, Set, Tuple, TypeVar

import numpy as np

from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.ids import IdGenerator
from hri_pipeline.core.simulation.agents import HIP_HEIGHT, Alternation, Noise
from hri_pipeline.core.simulation.parameters import SceneSettings
from hri_pipeline.core.simulation.world import PersonTruth, SceneTruth

NEAREST = 0.3
"""Distance (m) below which nothing is found."""
_HEAD_COVER, _BODY_COVER = 0.14, 0.16
"""Half widths (m) of somebody in front: the line of sight to a head that passes closer to the axis of the body is
hidden; half of a trunk is hidden when the line to its middle is."""
_TOP = 1.06     # top of the head in heights of the eyes


class CameraSight:
    """The view at one moment. height: of the camera, m."""

    def __init__(self, truth: SceneTruth, settings: SceneSettings, height: float) -> None:
        x, y, yaw = truth.robot
        self.camera = camera_pose(x, y, yaw, height)
        self._people, self._settings = truth.people, settings
        self._wide = math.tan(math.radians(settings.sense_hfov) / 2.0)
        self._tall = self._wide * settings.height / settings.width
        count = len(truth.people)
        self._floor = np.array([person.position for person in truth.people]).reshape(count, 2)
        self._heads = np.array([person.head for person in truth.people]).reshape(count, 3)

    def optical(self, position: np.ndarray, rotation: np.ndarray) -> Pose:
        """A pose in `map` seen in the optical frame."""
        turn = self.camera.rotation.T
        return Pose(turn @ rotation, turn @ (position - self.camera.translation))

    def faces(self) -> Set[str]:
        """People whose faces can be found."""
        seen = self._in_view(self._heads, self._settings.sense_face_range, self._tall)
        angle = math.cos(math.radians(self._settings.sense_face_angle))
        for index in np.flatnonzero(seen):
            towards = self.camera.translation - self._heads[index]
            facing = float(self._people[index].head_rotation[:, 0] @ towards) / float(np.linalg.norm(towards))
            seen[index] = facing > angle and not self._hidden(index, self._heads[index], _HEAD_COVER)
        return {self._people[index].id for index in np.flatnonzero(seen)}

    def bodies(self) -> Set[str]:
        """People whose bodies can be found; one that is cut by the upper or lower border of the image can."""
        if not len(self._people):
            return set()
        hips = np.column_stack([self._floor, [HIP_HEIGHT * person.stature for person in self._people]])
        chests = np.column_stack([self._floor, 0.8 * self._heads[:, 2]])
        seen = self._in_view(hips, self._settings.sense_range, math.inf)
        for index in np.flatnonzero(seen):
            seen[index] = not self._hidden(index, chests[index], _BODY_COVER)
        return {self._people[index].id for index in np.flatnonzero(seen)}

    def _in_view(self, points: np.ndarray, most: float, tall: float) -> np.ndarray:
        """(N,) which points (N, 3) in `map` are in the image and near enough."""
        seen = (points - self.camera.translation) @ self.camera.rotation
        depth = np.maximum(seen[:, 2], 1e-6)
        return ((seen[:, 2] > NEAREST) & (np.abs(seen[:, 0]) < self._wide * depth) & (np.abs(seen[:, 1]) < tall * depth)
                & (np.linalg.norm(seen, axis=1) < most))

    def _hidden(self, index: int, point: np.ndarray, cover: float) -> bool:
        """Tell whether somebody stands between the camera and a point (3,) of person `index`."""
        if not self._settings.sense_occlusion:
            return False
        eye = self.camera.translation
        line = point - eye
        length = math.hypot(line[0], line[1])
        if length < 1e-6:
            return False
        offsets = self._floor - eye[:2]
        along = (offsets @ line[:2]) / length
        aside = np.abs(offsets[:, 0] * line[1] - offsets[:, 1] * line[0]) / length
        height = eye[2] + line[2] * along / length
        covered = (along > 0.1) & (along < length - 0.25) & (aside < cover) & (height < _TOP * self._heads[:, 2])
        covered[index] = False
        return bool(covered.any())


def camera_pose(x: float, y: float, yaw: float, height: float, tilt: float = 0.0) -> Pose:
    """Optical frame (x right, y down, z forward) in `map` of a camera at this height (m), tilted down by `tilt`
    (rad)."""
    cosine, sine = math.cos(yaw), math.sin(yaw)
    level = np.array([[sine, 0.0, cosine], [-cosine, 0.0, sine], [0.0, -1.0, 0.0]])
    down = np.array([[1.0, 0.0, 0.0], [0.0, math.cos(tilt), math.sin(tilt)], [0.0, -math.sin(tilt), math.cos(tilt)]])
    return Pose(level @ down, np.array([x, y, height]))


@dataclass
class _Track:
    id: str
    first: float
    last: float


class Tracks:
    """The tracks of one kind of feature. hold: time (s) for which one that is not found stays listed."""

    def __init__(self, settings: SceneSettings, ids: IdGenerator, rng: random.Random, hold: float) -> None:
        self._delay, self._hold = settings.sense_birth_delay, hold
        self._changes = settings.sense_id_changes / 60.0
        self._ids, self._rng = ids, rng
        self._tracks: Dict[str, _Track] = {}
        self._last = 0.0

    def update(self, found: Set[str], now: float) -> List[Tuple[str, str]]:
        """Take the people whose feature is found at `now` (s); returns (person, id) of all that are listed."""
        passed, self._last = max(0.0, now - self._last), now
        for person in sorted(found):
            track = self._tracks.get(person)
            if track is None or now - track.last > self._hold:
                self._tracks[person] = _Track(self._ids.new(), now, now)
                continue
            track.last = now
            if self._changes > 0.0 and self._rng.random() < self._changes * passed:
                track.id = self._ids.new()
        for person in [person for person, track in self._tracks.items() if now - track.last > self._hold]:
            del self._tracks[person]
        return [(person, track.id) for person,
                track in sorted(self._tracks.items()) if now - track.first >= self._delay - 1e-9]


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
    """A body as a detector tells it; pose: body frame (between the hips), head: face frame, both in the optical frame,
    m."""

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
    """One cycle. camera: optical frame in `map`. fresh: which kinds were measured in this cycle; the others are as they
    were.

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
    """The random errors of one person in one kind of feature."""

    def __init__(self, settings: SceneSettings, seed: str) -> None:
        rng = random.Random(seed)
        self.gap = Alternation(settings.sense_dropout, settings.sense_dropout_time, rng)
        self.place = Noise(3, settings.sense_noise_share, settings.sense_noise_time, rng)
        self.turns = Noise(4, settings.sense_noise_share, settings.sense_noise_time, rng)
        self.lids = Alternation(settings.sense_lid_errors, 0.1, rng)


Feature = TypeVar("Feature", SensedFace, SensedBody)


class Senses:
    """Sees and hears one scene over time; `sense` takes truths whose stamps do not go back, else it begins anew.

    settings: the rows `sense_...` of SCENE_PARAMETERS, width and height (see sense_defaults). camera_height: m.
    """

    def __init__(self, settings: SceneSettings, seed: int = 0, camera_height: float = 1.3) -> None:
        self._settings, self._seed, self._height = settings, seed, camera_height
        self._runs = 0
        self._ids = IdGenerator(seed)
        self.reset()

    def reset(self) -> None:
        """Forget everybody, as at the start of a scene; ids are never given again."""
        rng = random.Random("{} {} ids".format(self._seed, self._runs))
        self._runs += 1
        settings = self._settings
        self._tracks = {FACES: Tracks(settings, self._ids, rng, settings.sense_hold),
                        BODIES: Tracks(settings, self._ids, rng, settings.sense_hold),
                        VOICES: Tracks(settings, self._ids, rng, settings.sense_voice_hold)}
        self._faults: Dict[Tuple[str, str], _Faults] = {}
        self._due = dict.fromkeys((FACES, BODIES, VOICES), 0.0)
        self._ghost: Optional[Tuple[str, float, np.ndarray]] = None
        self._rng = random.Random("{} {} ghosts".format(self._seed, self._runs))
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
            seen = self._see(FACES, self._faces, self._face, truth, sight, faces)
            self._faces = tuple(seen + self._ghosts(sight, truth.stamp, passed))
        if BODIES in fresh:
            self._bodies = tuple(self._see(BODIES, self._bodies, self._body, truth, sight, bodies))
        if VOICES in fresh and self._settings.sense_voices:
            self._voices = tuple(self._hear(truth, sight))
        return Sensed(now, sight.camera, self._faces, self._bodies, self._voices, fresh, frozenset(faces | bodies))

    def _is_due(self, kind: str, now: float) -> bool:
        rate = getattr(self._settings, {FACES: "sense_face_rate", BODIES: "sense_body_rate",
                                        VOICES: "sense_voice_rate"}[kind])
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

    def _see(self, kind: str, before: Sequence[Feature], sense: Callable[..., Feature], truth: SceneTruth,
             sight: CameraSight, seen: Set[str]) -> List[Feature]:
        """Faces or bodies: `sense` makes those that are found; the other tracks stay as they were `before`."""
        found = self._found(kind, seen, truth.stamp)
        last = {feature.id: feature for feature in before}
        people = {person.id: person for person in truth.people}
        features = []
        for person, identity in self._tracks[kind].update(found, truth.stamp):
            if person in found:
                features.append(sense(identity, people[person], sight, truth.stamp))
            elif identity in last:
                features.append(_stale(last[identity], measured=False))
        return features

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
        return Pose(
            pose.rotation, pose.translation + across + self._settings.sense_depth_noise * distance * noise[2] * along
        )

    def _ghosts(self, sight: CameraSight, now: float, passed: float) -> List[SensedFace]:
        """A face where nobody is, one at a time."""
        if self._ghost is not None and now > self._ghost[1]:
            self._ghost = None
        if self._ghost is None and self._rng.random() < self._settings.sense_ghosts / 60.0 * passed:
            depth = self._rng.uniform(1.0, self._settings.sense_face_range)
            side = math.tan(0.45 * math.radians(self._settings.sense_hfov)) * depth * self._rng.uniform(-1.0, 1.0)
            until = now + 0.5 + self._rng.expovariate(1.0 / _GHOST_TIME)
            self._ghost = (self._ids.new(), until, np.array([side, self._rng.uniform(-0.3, 0.3), depth]))
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


FACE, BODY, VOICE, PERSON = "face", "body", "voice", "person"
REPEAT_S = 1.0
"""A statement that still holds is said again after so long."""
_SPREAD = 0.04
_RECOGNISED = 0.9


class Statement(NamedTuple):
    """Two ids, what they are of, and the likelihood that they belong to one human."""

    first_kind: str
    first: str
    second_kind: str
    second: str
    likelihood: float


Pair = Tuple[str, str, str, str]


class SceneMatches:
    """Says which features belong together, as the matchers of a graph do. settings: of SCENE_PARAMETERS."""

    def __init__(self, settings: SceneSettings, seed: int = 0) -> None:
        self._settings = settings
        self._rng = random.Random("{} matches".format(seed))
        self._said: Dict[Pair, float] = {}
        self._since: Dict[str, float] = {}

    def reset(self) -> None:
        """Forget everything, as when the scene begins again."""
        self._said.clear()
        self._since.clear()

    def update(self, sensed: Sensed) -> List[Statement]:
        """Return what is to be said at this cycle. Nothing is withdrawn: who has left was still that person."""
        wanted = self._pairs(sensed) if self._settings.matches else {}
        if self._settings.recognition:
            wanted.update(self._recognised(sensed))
        listed = {feature.id for features in (sensed.faces, sensed.bodies, sensed.voices) for feature in features}
        self._said = {pair: when for pair, when in self._said.items()
                      if pair[1] in listed and (pair[2] == PERSON or pair[3] in listed)}
        said: List[Statement] = []
        for pair, likelihood in wanted.items():
            if sensed.stamp - self._said.get(pair, -REPEAT_S) >= REPEAT_S:
                self._said[pair] = sensed.stamp
                said.append(Statement(*pair, likelihood))
        return said

    def _pairs(self, sensed: Sensed) -> Dict[Pair, float]:
        faces = {face.person: face for face in sensed.faces if face.measured and face.person}
        bodies = {body.person: body for body in sensed.bodies if body.measured}
        pairs: Dict[Pair, float] = {}
        for person, face in faces.items():
            if person in bodies:
                pairs[(FACE, face.id, BODY, bodies[person].id)] = self._likelihood()
            if self._rng.random() < self._settings.wrong_matches:
                other = self._nearest(face, sensed)
                if other is not None:
                    pairs[(FACE, face.id, BODY, other)] = self._rng.uniform(0.1, 0.4)
        for voice in sensed.voices:
            if not voice.speaking:
                continue
            if voice.person in faces:
                pairs[(VOICE, voice.id, FACE, faces[voice.person].id)] = self._likelihood()
            elif voice.person in bodies:
                pairs[(VOICE, voice.id, BODY, bodies[voice.person].id)] = self._likelihood()
        return pairs

    def _recognised(self, sensed: Sensed) -> Dict[Pair, float]:
        found: Dict[Pair, float] = {}
        self._since = {face.id: self._since.get(face.id, sensed.stamp) for face in sensed.faces}
        for face in sensed.faces:
            old = sensed.stamp - self._since[face.id] >= self._settings.recognition_delay
            if face.person and face.measured and old:
                found[(FACE, face.id, PERSON, face.person)] = _RECOGNISED
        return found

    def _nearest(self, face: SensedFace, sensed: Sensed) -> Optional[str]:
        """The body of another person whose head is nearest to a face."""
        others = [body for body in sensed.bodies if body.measured and body.person != face.person]
        if not others:
            return None
        return min(others, key=lambda body: float(np.linalg.norm(body.head.translation - face.pose.translation))).id

    def _likelihood(self) -> float:
        return min(1.0, max(0.0, self._rng.gauss(self._settings.match_likelihood, _SPREAD)))
