"""Makes a crowd of the frames of people: all of them at once, in the frame in which they are compared."""

from __future__ import annotations

import math
from collections import Counter
from types import SimpleNamespace
from typing import Callable, List, Mapping, NamedTuple, Optional, Sequence, Tuple
from typing import Counter as CounterOf

import numpy as np

from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.interactions.crowd import Crowd
from hri_pipeline.core.interactions.people_frames import PeopleFrames, Timed
from hri_pipeline.core.tf_scan import RawTransform

Places = Callable[[CounterOf[str]], Mapping[str, Pose]]
"""Poses, in the frame in which people are compared, of those of the sensors (with the number of their people) that have one."""

HEAD_ABOVE_HIPS = 0.65
"""Height (m) of the eyes above the middle of the hips of somebody who stands: about 0.38 of the stature (Winter 2009)."""
_AXIS_X, _AXIS_Z = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
_LEAST_LEVEL = 0.3
_PLACE_SD, _PLACE_SD_PER_M, _FALLBACK_SD = 0.03, 0.02, 0.15
"""Standard deviations (m) of heads: at the camera, more for each metre of distance, and from anything but a face."""


class Seen(NamedTuple):
    """Closedness of a face's eyes, 0 to 1, at `stamp` (s)."""

    stamp: float
    closed: float


class _Person(NamedTuple):
    """Rows of one person's frames, -1 for none.

    place: what places the person, of `source`; head, gaze, trunk: directions. range: how far from the sensor the face is (m).
    """

    id: str
    source: str
    place: int
    head: int
    gaze: int
    trunk: int
    eyes_closed: float
    range: float


class _Rows:
    """Frames whose places and directions are wanted: sensor, links from the frame up to the sensor's, and axis of each."""

    def __init__(self) -> None:
        self.sensors: List[str] = []
        self.links: List[Sequence[RawTransform]] = []
        self.along_z: List[int] = []

    def add(self, links: Sequence[RawTransform]) -> int:
        """Return the row of a new frame, whose x axis is its direction."""
        self.sensors.append(links[-1].parent)
        self.links.append(links)
        return len(self.links) - 1


class _Frames(NamedTuple):
    """What one person has at the moment: rows by meaning, -1 for none, the best place first."""

    face: int = -1
    head: int = -1
    body: int = -1
    person: int = -1
    place: int = -1
    gaze: int = -1


def gather(frames: PeopleFrames, places: Places, newest: float, settings: SimpleNamespace,
           lids: Mapping[str, Seen]) -> Crowd:
    """Return everybody who is tracked and has a place, in the order of the tracked list.

    newest: stamp (s) of the newest frame; lids: what the action units say of faces, by id. settings: the values of
    INTERACTION_PARAMETERS.
    """
    rows = _Rows()
    oldest = newest - settings.frame_timeout
    found = [(identity, *_collect(identity, frames, oldest, settings, lids, rows)) for identity in frames.people]
    poses = places(Counter(rows.sensors))
    people = [person for person in (_person(*one, poses, rows.sensors) for one in found) if person is not None]
    if not people:
        return Crowd.empty()
    origins, directions = _placed(rows, poses)
    return _crowd(people, origins, directions, settings)


def _collect(identity: str, frames: PeopleFrames, oldest: float, settings: SimpleNamespace, lids: Mapping[str, Seen],
             rows: _Rows) -> Tuple[_Frames, float, float]:
    """Add the rows of one person; return them, the closedness of the eyes (NaN unknown), and the distance of the face (m)."""
    (face_id, body_id), mine = frames.people[identity], {}
    closed, far = math.nan, 0.0
    face = frames.get("face_" + face_id, oldest) if face_id else None
    if face is not None:
        mine["face"] = rows.add((face.transform,))
        x, y, z = face.transform.translation
        far = math.sqrt(x * x + y * y + z * z)
        gaze = frames.get("gaze_" + face_id)
        closed = _closed(frames, face, gaze, lids.get(face_id), settings)
        if gaze is not None and face.stamp - gaze.stamp <= settings.gaze_timeout and far < settings.gaze_range:
            links = (gaze.transform, face.transform) if gaze.transform.parent == face.transform.child else (gaze.transform,)
            mine["gaze"] = rows.add(links)
            rows.along_z.append(mine["gaze"])
    body = frames.get("body_" + body_id, oldest) if body_id else None
    if body is not None:
        mine["body"] = rows.add((body.transform,))
        way = frames.way(body_id, oldest) if face is None else None
        if way:
            mine["head"] = rows.add(way)
    person = frames.get("person_" + identity) if face is None and body is None else None
    if person is not None:
        # Nobody has told what makes this person up: the frame is taken for that of the face.
        unknown = face_id is None and body_id is None and person.stamp >= oldest
        mine["person" if unknown else "place"] = rows.add((person.transform,))
    return _Frames(**mine), closed, far


def _closed(frames: PeopleFrames, face: Timed, gaze: Optional[Timed], lids: Optional[Seen], settings: SimpleNamespace) -> float:
    """Closedness of the eyes, NaN unknown: by the action units, else a gaze that is not told has closed eyes.

    It is not told, or not any more; a sensor that has not told any face's gaze does not measure it.
    """
    if lids is not None and abs(face.stamp - lids.stamp) <= settings.frame_timeout:
        return lids.closed
    since = gaze.stamp if gaze is not None else frames.unseen_since(face.transform)
    missing = face.stamp - since
    if gaze is not None and missing <= 1e-6:
        return 0.0
    return 1.0 if missing > settings.gaze_timeout else math.nan


def _person(identity: str, mine: _Frames, closed: float, far: float, poses: Mapping[str, Pose], sensors: Sequence[str]
            ) -> Optional[_Person]:
    """Choose among the frames whose sensors have a pose; None where there is none."""
    face, head, body, person, place, gaze = (row if row >= 0 and sensors[row] in poses else -1 for row in mine)
    if face >= 0:
        return _Person(identity, "face", face, face, gaze, body, closed, far)
    for source, row, facing in (("head", head, head), ("body", body, -1), ("person", person, person), ("place", place, -1)):
        if row >= 0:
            return _Person(identity, source, row, facing, -1, body, math.nan, far)
    return None


def _placed(rows: _Rows, poses: Mapping[str, Pose]) -> Tuple[np.ndarray, np.ndarray]:
    """Origins (K + 1, 3) m and unit directions (K + 1, 3); the last row is NaN, and so are those without a pose."""
    count = len(rows.links)
    origins, directions = np.full((count + 1, 3), np.nan), np.full((count + 1, 3), np.nan)
    directions[:-1] = _AXIS_X
    directions[rows.along_z] = _AXIS_Z
    turns = np.array([links[0].rotation for links in rows.links])
    origins[:-1] = [links[0].translation for links in rows.links]
    directions[:-1] = rotate(turns, directions[:-1])
    longest = max(map(len, rows.links))
    for level in range(1, longest):
        which = [index for index, links in enumerate(rows.links) if len(links) > level]
        turns = np.array([rows.links[index][level].rotation for index in which])
        both = rotate(np.concatenate([turns, turns]), np.concatenate([directions[which], origins[which]]))
        directions[which] = both[:len(which)]
        origins[which] = both[len(which):] + [rows.links[index][level].translation for index in which]
    for sensor in set(rows.sensors):
        pose = poses.get(sensor)
        which = [index for index, name in enumerate(rows.sensors) if name == sensor]
        origins[which] = origins[which] @ pose.rotation.T + pose.translation if pose is not None else np.nan
        directions[which] = directions[which] @ pose.rotation.T if pose is not None else np.nan
    return origins, directions


def _crowd(people: Sequence[_Person], origins: np.ndarray, directions: np.ndarray, settings: SimpleNamespace) -> Crowd:
    ids, sources, place, head, gaze, trunk, closed, ranges = zip(*people)
    heads = origins[list(place)]
    if "body" in sources:
        heads[[row for row, source in enumerate(sources) if source == "body"], 2] += HEAD_ABOVE_HIPS
    trunks = directions[list(trunk)]
    lying = trunks[:, 0] ** 2 + trunks[:, 1] ** 2 < _LEAST_LEVEL ** 2
    if lying.any():
        trunks[lying] = np.nan
    deviations = np.array([(
        _PLACE_SD + _PLACE_SD_PER_M * person.range if person.source == "face" else _FALLBACK_SD,
        settings.skeleton_head_sd if person.source == "head" else settings.head_sd, _gaze_sd(person.range, settings), settings.trunk_sd)
        for person in people])
    return Crowd(list(ids), heads, directions[list(gaze)], directions[list(head)], trunks, deviations, np.array(closed))


def _gaze_sd(distance: float, settings: SimpleNamespace) -> float:
    """Standard deviation (rad) of the eyes' direction; from half of gaze_range on the head's takes over."""
    part = min(max(2.0 * distance / settings.gaze_range - 1.0, 0.0), 1.0)
    return math.hypot(settings.gaze_sd, part * settings.eyes_in_head_sd)


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
