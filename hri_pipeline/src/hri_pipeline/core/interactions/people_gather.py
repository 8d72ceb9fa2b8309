"""Makes onlookers of the frames of people: all of them at once, in the frame in which they are compared."""

from __future__ import annotations

from collections import Counter
from types import SimpleNamespace
from typing import Callable, Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple
from typing import Counter as CounterOf

import numpy as np

from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.interactions.gaze_people import Onlooker
from hri_pipeline.core.interactions.people_frames import PeopleFrames, Timed
from hri_pipeline.core.tf_scan import RawTransform

Places = Callable[[CounterOf[str]], Mapping[str, Pose]]
"""Poses, in the frame in which people are compared, of those of the sensors (with the number of their people) that have one."""

HEAD_ABOVE_HIPS = 0.65
"""Height (m) of the eyes above the middle of the hips of somebody who stands: about 0.38 of the stature (Winter 2009)."""
_AXIS_X, _AXIS_Z = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
_UP = np.array([0.0, 0.0, 1.0])
_LEAST_LEVEL = 0.3
_SOURCES = ("face", "head", "body", "person", "place")
"""What places a person, the best first."""
_PLACE_SD, _PLACE_SD_PER_M, _FALLBACK_SD = 0.03, 0.02, 0.15
"""Standard deviations (m) of heads: at the camera, more for each metre of distance, and from anything but a face."""


class Seen(NamedTuple):
    """Closedness of a face's eyes, 0 to 1, at `stamp` (s)."""

    stamp: float
    closed: float


class _Row(NamedTuple):
    """One direction (an axis turned by each rotation, the last one in the sensor's frame) and the origin of the last one."""

    sensor: str
    links: Sequence[RawTransform]
    axis: np.ndarray


class _Person(NamedTuple):
    """Rows of one person by meaning, what is known of the eyes, and how far from the sensor the face is (m)."""

    id: str
    rows: Dict[str, int]
    eyes_closed: Optional[float]
    range: float


def gather(frames: PeopleFrames, places: Places, newest: float, settings: SimpleNamespace,
           lids: Mapping[str, Seen]) -> List[Onlooker]:
    """Return everybody who is tracked and has a place, in the order of the tracked list.

    newest: stamp (s) of the newest frame; lids: what the action units say of faces, by id. settings: the values of
    INTERACTION_PARAMETERS.
    """
    rows: List[_Row] = []
    people = [_collect(identity, frames, newest - settings.frame_timeout, settings, lids, rows) for identity in frames.people]
    poses = places(Counter(row.sensor for row in rows))
    origins, directions, placed = _placed(rows, poses)
    found = [_onlooker(person, origins, directions, placed, settings) for person in people]
    return [onlooker for onlooker in found if onlooker is not None]


def _collect(identity: str, frames: PeopleFrames, oldest: float, settings: SimpleNamespace, lids: Mapping[str, Seen],
             rows: List[_Row]) -> _Person:
    """Add the rows of one person."""
    features, mine = frames.people[identity], {}

    def add(meaning: str, sensor: str, links: Sequence[RawTransform], axis: np.ndarray = _AXIS_X) -> None:
        mine[meaning] = len(rows)
        rows.append(_Row(sensor, links, axis))

    closed, far = None, 0.0
    face = frames.get("face_" + features.face, oldest) if features.face else None
    if face is not None:
        add("face", face.transform.parent, (face.transform,))
        x, y, z = face.transform.translation
        far = (x * x + y * y + z * z) ** 0.5
        gaze = frames.get("gaze_" + str(features.face))
        closed = _closed(face, gaze, lids.get(str(features.face)), settings)
        if gaze is not None and face.stamp - gaze.stamp <= settings.gaze_timeout and far < settings.gaze_range:
            links = (gaze.transform, face.transform) if gaze.transform.parent == face.transform.child else (gaze.transform,)
            add("gaze", links[-1].parent, links, _AXIS_Z)
    body = frames.get("body_" + features.body, oldest) if features.body else None
    if body is not None:
        add("body", body.transform.parent, (body.transform,))
        way = frames.way(str(features.body), oldest) if face is None else []
        if way:
            add("head", way[-1].parent, way)
    person = frames.get("person_" + identity) if face is None and body is None else None
    if person is not None:
        # Nobody has told what makes this person up: the frame is taken for that of the face.
        unknown = features.face is None and features.body is None and person.stamp >= oldest
        add("person" if unknown else "place", person.transform.parent, (person.transform,))
    return _Person(identity, mine, closed, far)


def _closed(face: Timed, gaze: Optional[Timed], lids: Optional[Seen], settings: SimpleNamespace) -> Optional[float]:
    """Closedness of the eyes: by the action units, else a gaze that is no longer told has closed eyes."""
    if lids is not None and abs(face.stamp - lids.stamp) <= settings.frame_timeout:
        return lids.closed
    if gaze is None:
        return None
    missing = face.stamp - gaze.stamp
    if missing <= 1e-6:
        return 0.0
    return 1.0 if missing > settings.gaze_timeout else None


def _placed(rows: Sequence[_Row], poses: Mapping[str, Pose]) -> Tuple[np.ndarray, np.ndarray, List[bool]]:
    """Origins (K, 3) m, unit directions (K, 3), and which rows have a pose."""
    placed = [row.sensor in poses for row in rows]
    if not any(placed):
        return np.zeros((len(rows), 3)), np.zeros((len(rows), 3)), placed
    longest = max(len(row.links) for row in rows)
    origins, directions = np.zeros((len(rows), 3)), np.array([row.axis for row in rows])
    for level in range(longest):
        which = [index for index, row in enumerate(rows) if len(row.links) > level]
        turns = np.array([rows[index].links[level].rotation for index in which])
        shifts = np.array([rows[index].links[level].translation for index in which])
        directions[which] = rotate(turns, directions[which])
        origins[which] = (rotate(turns, origins[which]) if level else 0.0) + shifts
    for sensor, pose in poses.items():
        which = [index for index, row in enumerate(rows) if row.sensor == sensor]
        origins[which] = origins[which] @ pose.rotation.T + pose.translation
        directions[which] = directions[which] @ pose.rotation.T
    return origins, directions, placed


def _onlooker(person: _Person, origins: np.ndarray, directions: np.ndarray, placed: Sequence[bool],
              settings: SimpleNamespace) -> Optional[Onlooker]:
    rows = {meaning: row for meaning, row in person.rows.items() if placed[row]}
    source = next((source for source in _SOURCES if source in rows), None)
    if source is None:
        return None
    sd = _PLACE_SD + _PLACE_SD_PER_M * person.range if source == "face" else _FALLBACK_SD
    head = origins[rows[source]] + (HEAD_ABOVE_HIPS * _UP if source == "body" else 0.0)
    facing = None if source in ("body", "place") else directions[rows[source]]
    trunk = directions[rows["body"]] if "body" in rows else None
    if trunk is not None and float(np.hypot(trunk[0], trunk[1])) < _LEAST_LEVEL:
        trunk = None
    return Onlooker(
        person.id, head, sd, facing, settings.skeleton_head_sd if source == "head" else settings.head_sd,
        directions[rows["gaze"]] if "gaze" in rows and source == "face" else None, _gaze_sd(person.range, settings),
        person.eyes_closed if source == "face" else None, trunk, settings.trunk_sd)


def _gaze_sd(distance: float, settings: SimpleNamespace) -> float:
    """Standard deviation (rad) of the eyes' direction; from half of gaze_range on the head's takes over."""
    part = min(max(2.0 * distance / settings.gaze_range - 1.0, 0.0), 1.0)
    return float(np.hypot(settings.gaze_sd, part * settings.eyes_in_head_sd))


def rotate(quaternions: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Return vectors (N, 3) turned by quaternions (N, 4) x, y, z, w, which need not be of unit length.

    v + s (w (q x v) + q x (q x v)) with s = 2 / |q|^2.
    """
    turn, real = quaternions[:, :3], quaternions[:, 3:]
    scale = 2.0 / (quaternions * quaternions).sum(axis=1, keepdims=True)
    across = _cross(turn, vectors)
    return vectors + scale * (real * across + _cross(turn, across))


def _cross(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Cross product along the last axis; numpy's own takes several times as long for few vectors."""
    after, next_after = (1, 2, 0), (2, 0, 1)
    return first[:, after] * second[:, next_after] - first[:, next_after] * second[:, after]
