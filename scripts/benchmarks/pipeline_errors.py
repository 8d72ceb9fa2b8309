"""How far what the stack publishes in every image is from where the people of `moving_people` are."""

from __future__ import annotations

import math
import threading
from typing import Dict, List, Mapping, Optional, Sequence, Tuple

import numpy as np
import rospy

from benchmarks.moving_people import PHASES, SEEN, TRUNK, MovingPeople
from hri_pipeline.core.geometry import Pose
from hri_pipeline.ros.conversions import LandmarkArray, SkeletonArray

TOPICS = {"faces": "landmarks", "bodies": "skeleton2d"}
_NEAR = 0.5
"""Mean distance (sizes) up to which what is published is of a person; beyond it is of nobody, and is left out."""
Errors = Dict[str, List[float]]


class Recorder:
    """Keeps the serialised landmarks and skeletons of all faces and bodies; they are read later."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._subscribers: Dict[Tuple[str, str], rospy.Subscriber] = {}
        self._data: List[Tuple[str, bytes]] = []

    def follow(self, ids: Mapping[str, Sequence[str]]) -> None:
        """Listen to these faces and bodies, too."""
        for kind, topic in TOPICS.items():
            for name in ids.get(kind, ()):
                if (kind, name) not in self._subscribers:
                    self._subscribers[kind, name] = rospy.Subscriber(
                        "/humans/{}/{}/{}".format(kind, name, topic), rospy.AnyMsg, self._keep, kind,
                        tcp_nodelay=True, buff_size=2 ** 20)

    def take(self) -> List[Tuple[str, bytes]]:
        """What came since the last call: kind and message."""
        with self._lock:
            data, self._data = self._data, []
            return data

    def close(self) -> None:
        """End listening."""
        for subscriber in self._subscribers.values():
            subscriber.unregister()
        self._subscribers = {}

    def _keep(self, message: rospy.AnyMsg, kind: str) -> None:
        with self._lock:
            self._data.append((kind, message._buff))


class Truth:
    """Where everybody is at a stamp (s), and the errors of what was published of it."""

    def __init__(self, scene: np.ndarray, reference: Mapping[str, np.ndarray], focal: float) -> None:
        """reference: see make_reference; focal: px."""
        self._people = MovingPeople(scene, reference["landmarks"], reference["skeletons"])
        self._reference, self._focal = reference, focal
        self._centre = np.array(scene.shape[1::-1]) / 2.0
        landmarks, skeletons = reference["landmarks"][:, :, :2], reference["skeletons"][:, :, :2]
        self.sizes = {"faces": np.sqrt(np.prod(np.ptp(landmarks, axis=1), axis=1)),
                      "bodies": np.linalg.norm(skeletons[:, TRUNK[:2]].mean(axis=1)
                                               - skeletons[:, TRUNK[2:]].mean(axis=1), axis=1)}
        self._points = {"faces": reference["landmarks"], "bodies": reference["skeletons"]}
        self._cache: Dict[Tuple[str, float, bool], np.ndarray] = {}

    def error(self, kind: str, points: np.ndarray, stamp: float, moving: bool) -> Tuple[Optional[int], float]:
        """Person and mean distance of points (N, 2) px over the size of face or torso; None for nobody."""
        known = self._points[kind]
        key = (kind, stamp, moving)
        if key not in self._cache:
            self._cache[key] = self._people.places(
                known[:, :, :2].reshape(-1, 2), stamp, moving).reshape(known.shape[:2] + (2,))
        seen = known[:, :, 2] > (SEEN if kind == "bodies" else -1.0)
        apart = np.linalg.norm(self._cache[key] - points, axis=2)
        mean = (apart * seen).sum(axis=1) / np.maximum(seen.sum(axis=1), 1) / self.sizes[kind]
        best = int(np.argmin(mean))
        return (best, float(mean[best])) if mean[best] < _NEAR else (None, math.nan)

    def angle(self, person: int, direction: np.ndarray, stamp: float, moving: bool) -> float:
        """Angle (degrees) between a face's direction (3,) in the optical frame and the true one.

        A face that only moves in the image keeps its angle to the line of sight.
        """
        directions = self._reference["directions"][person]
        phase = self._people.phase(stamp, moving)
        still = directions[0] if phase < 0 else _between(directions[1:], phase / PHASES)
        middle = self._reference["landmarks"][person, :, :2].mean(axis=0)
        there = self._people.places(middle[None], stamp, False)[0]
        turn = _rotation(self._ray(middle), self._ray(there))
        return math.degrees(math.acos(float(np.clip(turn @ still @ direction, -1.0, 1.0))))

    def _ray(self, pixel: np.ndarray) -> np.ndarray:
        ray = np.append((pixel - self._centre) / self._focal, 1.0)
        return ray / np.linalg.norm(ray)


def errors(truth: Truth, data: Sequence[Tuple[str, bytes]], faces: Mapping[str, Mapping[float, Pose]], moving: bool,
           size: Tuple[int, int]) -> Errors:
    """Errors `landmark`, `skeleton` (shares), `landmark_px` and `face_direction` (degrees) of all that was published.

    data: see Recorder.take; faces: poses of the frames by name and stamp (s); size: of the images, px.
    """
    found: Errors = {"landmark": [], "landmark_px": [], "skeleton": [], "face_direction": []}
    owners: Dict[Tuple[float, int], Tuple[int, np.ndarray]] = {}
    for kind, buffer in data:
        message = (LandmarkArray() if kind == "faces" else SkeletonArray()).deserialize(buffer)
        points = np.asarray(message.landmarks if kind == "faces" else message.skeleton)
        if not len(points):
            continue
        stamp, places = message.header.stamp.to_sec(), points[:, :2] * size
        person, error = truth.error(kind, places, stamp, moving)
        if person is not None:
            found["landmark" if kind == "faces" else "skeleton"].append(error)
            if kind == "faces":
                found["landmark_px"].append(error * float(truth.sizes["faces"][person]))
                owners[stamp, person] = (person, places.mean(axis=0))
    focal, centre = truth._focal, np.array(size) / 2.0
    for frames in faces.values():
        for stamp, pose in frames.items():
            place = centre + focal * pose.translation[:2] / max(pose.translation[2], 1e-3)
            near = [(float(np.linalg.norm(middle - place)), person) for (when, _), (person, middle) in owners.items()
                    if abs(when - stamp) < 1e-6]
            if near and np.isfinite(min(near)[0]):
                angle = truth.angle(min(near)[1], pose.rotation[:, 0], stamp, moving)
                found["face_direction"] += [angle] if math.isfinite(angle) else []
    return found


def _between(directions: np.ndarray, part: float) -> np.ndarray:
    """Direction at a part (0 to 1) of a cycle that is sampled evenly."""
    place = part * len(directions)
    first = int(place) % len(directions)
    mixed = directions[first] + (place - int(place)) * (directions[(first + 1) % len(directions)] - directions[first])
    return mixed / np.linalg.norm(mixed)


def _rotation(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """The smallest rotation (3, 3) that takes a unit vector to another (Rodrigues)."""
    axis = np.cross(source, target)
    cross = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    return np.eye(3) + cross + cross @ cross / (1.0 + float(source @ target))
