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

Vector = Tuple[float, float, float]
Quaternion = Tuple[float, float, float, float]

HEAD_ABOVE_HIPS = 0.65
"""Height (m) of the eyes above the middle of the hips of somebody who stands: about 0.38 of the stature (Winter 2009)."""
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
    """Frames whose places and directions are wanted: sensor, and in its frame the origin (m) and direction of each.

    In plain numbers: for so few, numpy takes longer.
    """

    def __init__(self) -> None:
        self.sensors: List[str] = []
        self.vectors: List[Vector] = []

    def add(self, links: Sequence[RawTransform], along_z: bool = False) -> int:
        """Return the row of a new frame, `links` above each other up to the sensor. Its direction is its x axis, or its z axis."""
        first = links[0]
        origin, direction = first.translation, axis(first.rotation, along_z)
        for link in links[1:]:
            (x, y, z), (i, j, k) = link.translation, turned(link.rotation, origin)
            origin, direction = (x + i, y + j, z + k), turned(link.rotation, direction)
        self.sensors.append(links[-1].parent)
        self.vectors += (origin, direction)
        return len(self.sensors) - 1


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
    return _crowd(people, _placed(rows, poses), settings)


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
            mine["gaze"] = rows.add(links, along_z=True)
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


def _placed(rows: _Rows, poses: Mapping[str, Pose]) -> np.ndarray:
    """Origins (m) and unit directions (K + 1, 2, 3); the last row is NaN, and so are those without a pose."""
    count = len(rows.sensors)
    placed = np.full((count + 1, 2, 3), np.nan)
    seen, sensors = np.array(rows.vectors), set(rows.sensors)
    for sensor in sensors & poses.keys():
        pose = poses[sensor]
        moved = (seen @ pose.rotation.T).reshape(count, 2, 3)
        moved[:, 0] += pose.translation
        if len(sensors) == 1:
            placed[:-1] = moved
        else:
            which = [index for index, name in enumerate(rows.sensors) if name == sensor]
            placed[which] = moved[which]
    return placed


def _crowd(people: Sequence[_Person], placed: np.ndarray, settings: SimpleNamespace) -> Crowd:
    ids, sources, place, head, gaze, trunk, closed, ranges = zip(*people)
    chosen = placed[np.array((place, head, gaze, trunk))]
    heads, faces, gazes, trunks = chosen[0, :, 0], chosen[1, :, 1], chosen[2, :, 1], chosen[3, :, 1]
    if "body" in sources:
        heads[[row for row, source in enumerate(sources) if source == "body"], 2] += HEAD_ABOVE_HIPS
    lying = trunks[:, 0] ** 2 + trunks[:, 1] ** 2 < _LEAST_LEVEL ** 2
    if lying.any():
        trunks[lying] = np.nan
    deviations = np.array([(
        _PLACE_SD + _PLACE_SD_PER_M * far if source == "face" else _FALLBACK_SD,
        settings.skeleton_head_sd if source == "head" else settings.head_sd, _gaze_sd(far, settings), settings.trunk_sd)
        for source, far in zip(sources, ranges)])
    return Crowd(list(ids), heads, gazes, faces, trunks, deviations, np.array(closed))


def _gaze_sd(distance: float, settings: SimpleNamespace) -> float:
    """Standard deviation (rad) of the eyes' direction; from half of gaze_range on the head's takes over."""
    part = min(max(2.0 * distance / settings.gaze_range - 1.0, 0.0), 1.0)
    return math.hypot(settings.gaze_sd, part * settings.eyes_in_head_sd)


def axis(quaternion: Quaternion, along_z: bool) -> Vector:
    """Return the x axis, or the z axis, that a quaternion x, y, z, w turns to; it need not be of unit length."""
    x, y, z, w = quaternion
    scale = 2.0 / (x * x + y * y + z * z + w * w)
    if along_z:
        return scale * (x * z + y * w), scale * (y * z - x * w), 1.0 - scale * (x * x + y * y)
    return 1.0 - scale * (y * y + z * z), scale * (x * y + z * w), scale * (x * z - y * w)


def turned(quaternion: Quaternion, vector: Vector) -> Vector:
    """Return a vector turned by a quaternion x, y, z, w, which need not be of unit length.

    v + w t + q x t with t = 2 / |q|^2 (q x v).
    """
    (x, y, z, w), (u, v, n) = quaternion, vector
    scale = 2.0 / (x * x + y * y + z * z + w * w)
    i, j, k = scale * (y * n - z * v), scale * (z * u - x * n), scale * (x * v - y * u)
    return u + w * i + y * k - z * j, v + w * j + z * i - x * k, n + w * k + x * j - y * i
