"""The people as the interactions see them at one time: places, and directions of eyes, heads and trunks.

`gather` makes one set of arrays of the frames of all tracked people, in the frame in which they are compared.
"""

from __future__ import annotations

import math
from collections import Counter, OrderedDict
from dataclasses import dataclass
from types import MappingProxyType
from typing import Callable, Dict, Iterable, List, Mapping, NamedTuple, Optional, Sequence, Tuple, Union
from typing import Counter as CounterOf

import numpy as np

from hri_pipeline.core.frames import HumanTf, RawTransform, Timed
from hri_pipeline.core.geometry import Pose, Vector, rotate, view_axis
from hri_pipeline.core.interactions.parameters import InteractionSettings

ROBOT = ""
"""The robot among the ids of persons, as in the messages."""


@dataclass(frozen=True)
class Observer:
    """One tracked person at one time. Places and directions are those of the reference frame (z up, m).

    What is not known is None. Directions are unit vectors, `_sd` is their standard deviation (rad) on each axis.
    """

    id: str
    head: Optional[np.ndarray] = None
    """(3,) m: where the person is, at the height of the eyes as far as it is known; None: place unknown."""
    head_sd: float = 0.1
    """Standard deviation (m) of `head` on each axis."""
    head_direction: Optional[np.ndarray] = None
    """(3,): where the face points."""
    head_direction_sd: float = 0.09
    gaze_direction: Optional[np.ndarray] = None
    """(3,): where the eyes look."""
    gaze_direction_sd: float = 0.14
    eyes_closed: Optional[float] = None
    """0 open to 1 closed."""
    body_direction: Optional[np.ndarray] = None
    """(3,), about horizontal: where the trunk points."""
    body_direction_sd: float = 0.35


@dataclass(frozen=True)
class GazeTarget:
    """One looks at another: ids of persons, `ROBOT` for the robot. confidence: probability, 0 to 1."""

    sender: str
    receiver: str
    confidence: float


UNKNOWN = np.full(3, np.nan)
_NO_DEVIATIONS = np.zeros((0, 4))


class PeopleSnapshot:
    """N people in the reference frame (z up, m); what is not known is NaN. The rows of all arrays are those of `ids`.

    heads: (N, 3) m; gazes, faces, trunks: (N, 3) unit vectors; deviations: (N, 4) of head's place (m), face, gaze and
    trunk (rad); closed: (N,) closedness of the eyes, 0 to 1; depths: (N, 3) direction in which the head's place is
    least certain times its standard deviation (m) there, zeros unknown; rays: (N, 3) m, from the sensor to the head,
    zeros unknown; faceless: (N,) bool, whose face is not seen; speaking: (N,) bool, who is heard, None when nobody
    listens; groups: (N,) number of the group in which somebody stands, -1 in none, None when groups are not known.
    """

    __slots__ = ("closed", "depths", "deviations", "faceless", "faces", "gazes", "groups", "heads", "ids",
                 "rays", "speaking", "trunks")

    def __init__(self, ids: List[str], heads: np.ndarray, gazes: np.ndarray, faces: np.ndarray, trunks: np.ndarray,
                 deviations: np.ndarray, closed: np.ndarray) -> None:
        self.ids, self.heads, self.gazes, self.faces, self.trunks = ids, heads, gazes, faces, trunks
        self.deviations, self.closed = deviations, closed
        self.depths, self.rays = np.zeros((len(ids), 3)), np.zeros((len(ids), 3))
        self.faceless = (faces[:, 0] != faces[:, 0]) & (gazes[:, 0] != gazes[:, 0])
        self.speaking: Optional[np.ndarray] = None
        self.groups: Optional[np.ndarray] = None

    def __len__(self) -> int:
        return len(self.ids)

    @classmethod
    def of(cls, people: Union["PeopleSnapshot", Sequence[Observer]]) -> "PeopleSnapshot":
        """Return the snapshot of these observers; a snapshot as it is."""
        if isinstance(people, PeopleSnapshot):
            return people
        if not people:
            return cls.empty()
        columns = np.array([value if value is not None else UNKNOWN for person in people for value in (
            person.head, person.gaze_direction, person.head_direction, person.body_direction)], dtype=np.float64)
        columns = columns.reshape(len(people), 4, 3)
        deviations = np.array([(person.head_sd, person.head_direction_sd, person.gaze_direction_sd,
                                person.body_direction_sd)
                               for person in people])
        closed = np.array([np.nan if person.eyes_closed is None else person.eyes_closed for person in people])
        return cls([person.id for person in people], columns[:, 0], columns[:, 1], columns[:, 2], columns[:, 3],
                   deviations, closed)

    @classmethod
    def empty(cls) -> "PeopleSnapshot":
        """Return a snapshot of nobody."""
        nothing = np.zeros((0, 3))
        return cls([], nothing, nothing, nothing, nothing, _NO_DEVIATIONS, np.zeros(0))

    def observers(self) -> List[Observer]:
        """Return everybody as an object each."""
        return [Observer(identity, _known(self.heads[row]), sds[0], _known(self.faces[row]), sds[1],
                         _known(self.gazes[row]), sds[2],
                         None if closed != closed else closed, _known(self.trunks[row]), sds[3])
                for row, (identity, sds, closed) in enumerate(zip(self.ids, self.deviations.tolist(),
                                                                  self.closed.tolist()))]


def _known(vector: np.ndarray) -> Optional[np.ndarray]:
    return vector if vector[0] == vector[0] else None       # not NaN


_MAX_EARLY = 500
_MAX_SENSORS = 100


class Features(NamedTuple):
    """Face and body of a person: empty when there is none, None while it is not known."""

    face: Optional[str] = None
    body: Optional[str] = None


class PeopleTf(HumanTf):
    """Which face and body the tracked persons have, with the frames of all of these, and of the heads of their
    skeletons.

    It also knows which sensors measure gazes: a missing gaze means closed eyes there.
    """

    def __init__(self) -> None:
        super().__init__()
        self._features: Dict[str, Features] = {}
        self._early: "OrderedDict[str, Features]" = OrderedDict()
        self._faces_since: Dict[str, float] = {}
        self._gaze_sensors: "OrderedDict[str, None]" = OrderedDict()

    @property
    def people(self) -> Dict[str, Features]:
        """Who is tracked, in order, with their features."""
        return self._features

    def set_people(self, ids: Iterable[str]) -> None:
        """Follow these persons; the frames of the others are freed."""
        self._features = {identity: self._features.get(identity) or self._early.pop(identity, Features())
                          for identity in ids}
        self._follow_features()

    def set_feature(self, person: str, kind: str, value: str) -> None:
        """Set which "face" or "body" (an id, or empty) a person has; it may come before the person is tracked."""
        features = self._features.get(person)
        if features is None:
            self._early[person] = self._early.get(person, Features())._replace(**{kind: value})
            while len(self._early) > _MAX_EARLY:
                self._early.popitem(last=False)
        elif getattr(features, kind) != value:
            self._features[person] = features._replace(**{kind: value})
            self._follow_features()

    def gaze_missing_for(self, face: Timed, gaze: Optional[Timed], gaze_timeout: float) -> float:
        """Return for how long (s) a face has had no gaze frame; minus infinity where its sensor measures no gazes.

        A sensor measures gazes when any of its faces has had one at most `gaze_timeout` s old.
        """
        sensor = face.transform.parent
        since = self._faces_since.setdefault(face.transform.child, face.stamp)
        if gaze is not None:
            missing = face.stamp - gaze.stamp
            if missing <= gaze_timeout and sensor not in self._gaze_sensors:
                self._gaze_sensors[sensor] = None
                while len(self._gaze_sensors) > _MAX_SENSORS:
                    self._gaze_sensors.popitem(last=False)
            return missing
        return face.stamp - since if sensor in self._gaze_sensors else -math.inf

    def clear_moving(self) -> None:
        """Forget what moves, as after a time jump."""
        super().clear_moving()
        self._faces_since.clear()

    def _follow_features(self) -> None:
        faces = [features.face for features in self._features.values() if features.face]
        bodies = [features.body for features in self._features.values() if features.body]
        self.follow(person=self._features, face=faces, gaze=faces, body=bodies, head=bodies)
        self._faces_since = {name: since for name, since in self._faces_since.items() if name.encode() in self._wanted}


Places = Callable[[CounterOf[str]], Mapping[str, Pose]]
"""Poses, in the frame in which people are compared, of those of the sensors (with the number of their people) that have
one."""
PoseAt = Callable[[str, float], Optional[Pose]]
"""Pose of a sensor in that frame at a stamp (s); None where it is not known."""

HEAD_ABOVE_HIPS = 0.65
"""Height (m) of the eyes above the middle of the hips of somebody who stands: about 0.38 of the stature (Winter
2009)."""
_LEAST_LEVEL = 0.3
_HEADS_OWN = 1e-3
"""Angle (rad) from the head's direction up to which that of a gaze was made of it: of faces too small for their eyes,
and of detectors that measure none."""
_PLACE_SD, DEPTH_PART, _FALLBACK_SD = 0.03, 0.045, 0.15
"""Standard deviations (m) of heads: across the ray of the camera, along it for each metre of distance (heads differ by
5.5 %, irises tell a part of it), and from anything but a face."""
_GOOD_TURN, _TURN_SLOPE, _TURN_MOST = math.radians(30.0), 0.35, math.radians(20.0)
"""Yaw (rad) up to which a head's direction is as good as from the front; more standard deviation per rad beyond, and at
most: published trackers err by 4 to 6 degrees on faces from the front, by 10 and more near the profile (Zhu et al.,
3DDFA, CVPR 2016). Irises of a turned head are measured by one eye, and seen from the side. Measured so on rendered
heads up to 50 degrees, of 24 to 200 px (`benchmark faces --only turned`): errors are within 1.6 times what is said;
beyond there is no truth."""


class Seen(NamedTuple):
    """Closedness of a face's eyes, 0 to 1, at `stamp` (s)."""

    stamp: float
    closed: float


class _Person(NamedTuple):
    """Rows of one person's frames, -1 for none.

    place: what places the person, of `source`; head, gaze, trunk: directions. range: how far from the sensor the face
    is (m); turn: angle (rad) between the face and the way to the sensor.
    """

    id: str
    source: str
    place: int
    head: int
    gaze: int
    trunk: int
    eyes_closed: float
    range: float
    turn: float


class _Rows:
    """Frames whose places and directions are wanted: sensor, stamp (s), and in its frame the origin (m) and direction
    of each.

    In plain numbers: for so few, numpy takes longer.
    """

    def __init__(self) -> None:
        self.sensors: List[str] = []
        self.stamps: List[float] = []
        self.vectors: List[Vector] = []

    def add(self, links: Sequence[RawTransform], along_z: bool = False) -> int:
        """Return the row of a new frame, `links` above each other up to the sensor.

        Its direction is its x axis, or its z axis.
        """
        first = links[0]
        origin, direction = first.translation, view_axis(first.rotation, along_z)
        for link in links[1:]:
            (x, y, z), (i, j, k) = link.translation, rotate(link.rotation, origin)
            origin, direction = (x + i, y + j, z + k), rotate(link.rotation, direction)
        self.sensors.append(links[-1].parent)
        self.stamps.append(links[-1].stamp)
        self.vectors += (origin, direction)
        return len(self.sensors) - 1


class _Frames(NamedTuple):
    """The frames of one person: rows by meaning, -1 for none, the best place first."""

    face: int = -1
    head: int = -1
    body: int = -1
    person: int = -1
    place: int = -1
    gaze: int = -1


def gather(frames: PeopleTf, places: Places, newest: float, settings: InteractionSettings,
           closures: Mapping[str, Seen], shifts: Mapping[str, float] = MappingProxyType({}),
           pose_at: Optional[PoseAt] = None) -> PeopleSnapshot:
    """Return everybody who is tracked and has a place, in the order of the tracked list.

    Parameters
    ----------
    frames: PeopleTf
        Who is tracked, with the latest transforms.
    places: callable
        Gives the poses of sensors in the frame in which people are compared.
    newest: float
        Stamp (s) of the newest frame.
    settings: InteractionSettings
    closures: mapping of str to Seen
        Closedness of the eyes by the action units, by id of the face.
    shifts: mapping of str to float
        What is added to the stamps of a sensor whose clock differs from that of `newest` (s).
    pose_at: callable
        Gives the pose of a sensor at the stamp of a frame: while the robot turns, a body of some images ago was seen
        from elsewhere. None: sensors are where `places` says.
    """
    rows = _Rows()
    oldest = _Oldest(newest - settings.frame_timeout, shifts)
    found = [(identity, *_collect(identity, frames, oldest, settings, closures, rows)) for identity in frames.people]
    poses = places(Counter(rows.sensors))
    people = [person for person in (_person(*one, poses, rows.sensors) for one in found) if person is not None]
    if not people:
        return PeopleSnapshot.empty()
    snapshot = _snapshot(people, _placed(rows, poses, pose_at), settings)
    for row, person in enumerate(people):
        snapshot.faceless[row] = person.source not in ("face", "person")
        snapshot.rays[row] = snapshot.heads[row] - poses[rows.sensors[person.place]].translation
        if person.source == "face":
            snapshot.depths[row] = DEPTH_PART * snapshot.rays[row]
    return snapshot


class _Oldest(NamedTuple):
    """Stamp (s) of the oldest frames that are used, and what is added to the stamps of each sensor before (s)."""

    stamp: float
    shifts: Mapping[str, float]

    def recent(self, timed: Optional[Timed], sensor: Optional[str] = None) -> bool:
        """Tell whether there is a frame that is not too old; sensor: where it is not the parent of the frame."""
        if timed is None:
            return False
        return timed.stamp + self.shifts.get(sensor or timed.transform.parent, 0.0) >= self.stamp


def _collect(identity: str, frames: PeopleTf, oldest: _Oldest, settings: InteractionSettings,
             closures: Mapping[str, Seen], rows: _Rows) -> Tuple[_Frames, float, float, float]:
    """Add the rows of one person; return them, the closedness of the eyes (NaN unknown), the distance of the face (m)
    and its turn away from the sensor (rad)."""
    features, mine = frames.people[identity], {}
    face_id, body_id = features.face or "", features.body or ""
    closed, far, turn = math.nan, 0.0, 0.0
    face = frames.get("face_" + face_id) if face_id else None
    if not oldest.recent(face):
        face = None
    if face is not None:
        mine["face"] = rows.add((face.transform,))
        x, y, z = face.transform.translation
        far = math.sqrt(x * x + y * y + z * z)
        i, j, k = rows.vectors[-1]
        turn = math.acos(min(max(-(x * i + y * j + z * k) / max(far, 1e-9), -1.0), 1.0))
        gaze = frames.get("gaze_" + face_id)
        closed = _closed(frames, face, gaze, closures.get(face_id), settings)
        if gaze is not None and face.stamp - gaze.stamp <= settings.gaze_timeout and far < settings.gaze_range:
            above = (face.transform,) if gaze.transform.parent == face.transform.child else ()
            row = rows.add((gaze.transform, *above), along_z=True)
            # Where it is the head's very own, the eyes were not measured, and it says nothing more.
            if _apart(rows.vectors[2 * row + 1], (i, j, k)) > _HEADS_OWN:
                mine["gaze"] = row
    body = frames.get("body_" + body_id) if body_id else None
    if not oldest.recent(body):
        body = None
    if body is not None:
        mine["body"] = rows.add((body.transform,))
        links = frames.chain("head_" + body_id) if face is None else ()
        if links and all(oldest.recent(timed, links[-1].transform.parent) for timed in links):
            mine["head"] = rows.add([timed.transform for timed in links])
    person = frames.get("person_" + identity) if face is None and body is None else None
    if person is not None:
        # Neither face nor body is known: the frame of the person is taken for that of the face.
        unknown = features == Features() and oldest.recent(person)
        mine["person" if unknown else "place"] = rows.add((person.transform,))
    return _Frames(**mine), closed, far, turn


def _apart(first: Vector, second: Vector) -> float:
    """Distance of two unit vectors: the angle (rad) between them where it is small."""
    return math.sqrt(sum((one - other) ** 2 for one, other in zip(first, second)))


def _closed(frames: PeopleTf, face: Timed, gaze: Optional[Timed], closure: Optional[Seen],
            settings: InteractionSettings) -> float:
    """Closedness of the eyes, NaN unknown: by the action units, else a face without a recent gaze has closed eyes.

    Unless its sensor has never given the gaze of any face: such a sensor does not measure gazes.
    """
    missing = frames.gaze_missing_for(face, gaze, settings.gaze_timeout)
    if closure is not None and abs(face.stamp - closure.stamp) <= settings.frame_timeout:
        return closure.closed
    if gaze is not None and missing <= 1e-6:
        return 0.0
    return 1.0 if missing > settings.gaze_timeout else math.nan


def _person(identity: str, mine: _Frames, closed: float, far: float, turn: float, poses: Mapping[str, Pose],
            sensors: Sequence[str]) -> Optional[_Person]:
    """Choose among the frames whose sensors have a pose; None where there is none."""
    face, head, body, person, place, gaze = (row if row >= 0 and sensors[row] in poses else -1 for row in mine)
    if face >= 0:
        return _Person(identity, "face", face, face, gaze, body, closed, far, turn)
    for source, row, facing in (("head", head, head), ("body", body, -1), ("person", person, person),
                                ("place", place, -1)):
        if row >= 0:
            return _Person(identity, source, row, facing, -1, body, math.nan, far, 0.0)
    return None


def _placed(rows: _Rows, poses: Mapping[str, Pose], pose_at: Optional[PoseAt]) -> np.ndarray:
    """Origins (m) and unit directions (K + 1, 2, 3); the last row is NaN, and so are those without a pose."""
    count = len(rows.sensors)
    placed = np.full((count + 1, 2, 3), np.nan)
    seen = np.array(rows.vectors)
    views = [(sensor, stamp if pose_at else 0.0) for sensor, stamp in zip(rows.sensors, rows.stamps)]
    different = set(views)
    for view in different:
        pose = poses.get(view[0])
        if pose is None:
            continue
        pose = (pose_at(*view) if pose_at else None) or pose
        moved = (seen @ pose.rotation.T).reshape(count, 2, 3)
        moved[:, 0] += pose.translation
        if len(different) == 1:
            placed[:-1] = moved
        else:
            which = [index for index, one in enumerate(views) if one == view]
            placed[which] = moved[which]
    return placed


def _snapshot(people: Sequence[_Person], placed: np.ndarray, settings: InteractionSettings) -> PeopleSnapshot:
    ids, sources, place, head, gaze, trunk, closed, ranges, turns = zip(*people)
    chosen = placed[np.array((place, head, gaze, trunk))]
    heads, faces, gazes, trunks = chosen[0, :, 0], chosen[1, :, 1], chosen[2, :, 1], chosen[3, :, 1]
    if "body" in sources:
        heads[[row for row, source in enumerate(sources) if source == "body"], 2] += HEAD_ABOVE_HIPS
    lying = trunks[:, 0] ** 2 + trunks[:, 1] ** 2 < _LEAST_LEVEL ** 2
    if lying.any():
        trunks[lying] = np.nan
    deviations = np.array([(
        _PLACE_SD if source == "face" else _FALLBACK_SD,
        settings.skeleton_head_sd if source == "head" else head_direction_sd(settings, turn),
        math.hypot(_gaze_sd(far, settings), _turn_sd(turn)), settings.trunk_sd)
        for source, far, turn in zip(sources, ranges, turns)])
    return PeopleSnapshot(list(ids), heads, gazes, faces, trunks, deviations, np.array(closed))


def head_direction_sd(settings: InteractionSettings, turn: float) -> float:
    """Return the standard deviation (rad), each axis, of the direction of a face that is turned away from its sensor by
    `turn` (rad)."""
    return math.hypot(settings.head_sd, _turn_sd(turn))


def _turn_sd(turn: float) -> float:
    """Standard deviation (rad) that a turn (rad) away from the sensor adds to a direction."""
    return min(_TURN_SLOPE * max(turn - _GOOD_TURN, 0.0), _TURN_MOST)


def _gaze_sd(distance: float, settings: InteractionSettings) -> float:
    """Standard deviation (rad) of the eyes' direction; from half of gaze_range on the head's takes over."""
    part = min(max(2.0 * distance / settings.gaze_range - 1.0, 0.0), 1.0)
    return math.hypot(settings.gaze_sd, part * settings.eyes_in_head_sd)
