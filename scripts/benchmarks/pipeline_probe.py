"""A ROS node that watches the stack for some seconds and writes what it saw as one JSON object, with how far what is
published in every image is from where the people of `moving_people` are.

Usage: pipeline_probe.py PEOPLE SECONDS PATIENCE MOVING LOADED SCENE REFERENCE FILE
Waits until PEOPLE persons are seen (at most PATIENCE s), says "begin" on standard output, watches for
SECONDS, says "end"; measures the errors of what is published for MOVING s, and as long while people move; then, if
LOADED > 0, says "load", watches for LOADED s, says "loaded". Writes FILE.
"""

from __future__ import annotations

import json
import math
import sys
import threading
import time
from collections import defaultdict
from typing import Dict, List, Mapping, Optional, Sequence, Set, Tuple

import cv2
import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticArray
from seen_persons import SeenPersons
from std_msgs.msg import Bool
from tf2_msgs.msg import TFMessage

from benchmarks.moving_people import HFOV, PHASES, SEEN, TRUNK, MovingPeople
from hri_msgs.msg import IdsList
from hri_pipeline.core.geometry import Pose
from hri_pipeline.ros.conversions import LandmarkArray, SkeletonArray, pose_from_transform

KINDS = ("person", "face", "body")
SETTLE_S = 3.0
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
        """Angle (degrees) between a face's direction (3,) in the optical frame and the true one."""
        directions = self._reference["directions"][person]
        phase = self._people.phase(stamp, moving)
        still = directions[0] if phase < 0 else _between(directions[1:], phase / PHASES)
        true = self._people.turn(stamp) @ still
        return math.degrees(math.acos(float(np.clip(true @ direction, -1.0, 1.0))))


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


class Probe:
    """Collects arrivals of frames and the stage times of the diagnostics."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.watching = False
        self.stamps: Dict[str, Dict[str, Set[float]]] = {kind: defaultdict(set) for kind in KINDS}
        self.ages: List[Tuple[float, float]] = []
        self.tracked: Dict[str, int] = {}
        self.ids: Dict[str, List[str]] = {}
        self.keeps_faces = False
        self.faces: Dict[str, Dict[float, Pose]] = defaultdict(dict)
        """Poses of the frames of faces by their names and stamps (s), while `keeps_faces`."""
        self.stages: Dict[str, Dict[str, Dict[str, float]]] = {}
        self.inferences: Dict[str, List[Tuple[float, int]]] = defaultdict(list)
        """Stamp (s) of the diagnostics and how often each network has run until then."""
        self.networks: Dict[str, str] = {}
        """On which provider the networks of each node run, as its diagnostics tell."""
        self.began: Dict[str, float] = {}
        """Time (s since the epoch) at which the first face, and the first body, came."""
        self.stalls: Dict[str, Tuple[float, float]] = {}
        """Arrival (s) of the last face, and body, and the longest time (s) between two."""
        self.subscribers = [
            rospy.Subscriber("/tf", TFMessage, self.on_tf, queue_size=1000, buff_size=2**22, tcp_nodelay=True),
            rospy.Subscriber("/diagnostics", DiagnosticArray, self.on_diagnostics, queue_size=100)]
        self.persons = SeenPersons()
        for kind in ("persons", "faces", "bodies"):
            self.subscribers.append(rospy.Subscriber(
                "/humans/{}/tracked".format(kind), IdsList, self.on_tracked, callback_args=kind))

    def on_tf(self, message: TFMessage) -> None:
        """Note stamp and age of each frame of a person, face or body."""
        now = time.time()
        with self.lock:
            for kind in {transform.child_frame_id.split("_")[0] for transform in message.transforms} - {"person"}:
                if kind in KINDS:
                    self.began.setdefault(kind, now)
                    last, longest = self.stalls.get(kind, (now, 0.0))
                    self.stalls[kind] = now, max(longest, now - last)
            if not (self.watching or self.keeps_faces):
                return
            for transform in message.transforms:
                kind = transform.child_frame_id.split("_")[0]
                if kind == "face" and self.keeps_faces:
                    self.faces[transform.child_frame_id][transform.header.stamp.to_sec()] = pose_from_transform(
                        transform)
                if kind in self.stamps and self.watching:
                    stamp = transform.header.stamp.to_sec()
                    seen = self.stamps[kind][transform.child_frame_id]
                    if stamp not in seen:
                        seen.add(stamp)
                        if kind == "person":
                            self.ages.append((stamp, now - stamp))

    def on_tracked(self, message: IdsList, kind: str) -> None:
        """Note how many there are."""
        with self.lock:
            self.tracked[kind], self.ids[kind] = len(message.ids), list(message.ids)

    def found(self) -> Dict[str, int]:
        """Return how many there are of each kind; persons who are only a voice are apart."""
        seen, heard = self.persons.split()
        with self.lock:
            return {**self.tracked, "persons": len(seen), "voices alone": len(heard)}

    def on_diagnostics(self, message: DiagnosticArray) -> None:
        """Keep the latest times of stages, STAGE_ms_median and STAGE_ms_p95, and times of inferences_NETWORK."""
        with self.lock:
            for status in message.status:
                for value in status.values:
                    if value.key == "networks":
                        self.networks[status.name.split(":")[0]] = value.value
                    if value.key.startswith("inferences_") and self.watching:
                        self.inferences[value.key[len("inferences_"):]].append(
                            (message.header.stamp.to_sec(), int(float(value.value))))
                    for ending, name in (("_ms_median", "median"), ("_ms_p95", "p95")):
                        # The age of the images is told in the same way, and is no stage.
                        if value.key.endswith(ending) and value.key != "age" + ending:
                            stages = self.stages.setdefault(status.name.split(":")[0], {})
                            stages.setdefault(value.key[:-len(ending)], {})[name] = float(value.value)

    def result(self, seconds: float) -> dict:
        """Return all that was seen; of persons only what has the stamp of a face or a body: who is remembered has that
        of now."""
        tracked = self.found()
        with self.lock:
            images = {stamp for kind in KINDS if kind != "person" for stamps in self.stamps[kind].values()
                      for stamp in stamps}
            return {
                "seconds": seconds, "tracked": tracked,
                "ages": [age for stamp, age in self.ages if stamp in images],
                "rates": {kind: sorted((len(stamps & images) / seconds for stamps in frames.values()), reverse=True)
                          for kind, frames in self.stamps.items()},
                "stages_ms": self.stages, "networks": self.networks, "began": self.began,
                "stall_s": {kind: longest for kind, (_, longest) in self.stalls.items()},
                "inferences_hz": {network: rate(counts) for network, counts in self.inferences.items()}}

    def measure_errors(self, truth: Truth, seconds: float, size: Tuple[int, int], moving: bool) -> Errors:
        """Errors of all that is published within some seconds."""
        recorder = Recorder()
        self.faces.clear()
        self.keeps_faces, end = True, time.monotonic() + seconds
        while time.monotonic() < end and not rospy.is_shutdown():
            with self.lock:
                ids = dict(self.ids)
            recorder.follow(ids)
            time.sleep(0.2)
        self.keeps_faces = False
        data = recorder.take()
        recorder.close()
        with self.lock:
            return errors(truth, data, self.faces, moving, size)

    def ages_for(self, seconds: float) -> dict:
        """Ages of persons, and how many there are of each kind, within some seconds."""
        with self.lock:
            self.ages, self.watching = [], True
            for frames in self.stamps.values():
                frames.clear()
        time.sleep(seconds)
        self.watching = False
        return {"ages": self.result(seconds)["ages"], "found": self.found()}


def rate(counts: List[Tuple[float, int]]) -> float:
    """Return how fast (1/s) a count has risen from the first to the last of (stamp s, count); 0 for less than two."""
    passed = counts[-1][0] - counts[0][0] if counts else 0.0
    return (counts[-1][1] - counts[0][1]) / passed if passed > 0.0 else 0.0


def main(arguments: List[str]) -> int:
    """Watch and write."""
    people, path = int(arguments[0]), arguments[7]
    seconds, patience, moving_s, loaded_s = (float(argument) for argument in arguments[1:5])
    scene = cv2.imread(arguments[5])
    height, width = scene.shape[:2]
    truth = Truth(scene, np.load(arguments[6]), 0.5 * width / np.tan(HFOV / 2.0))
    rospy.init_node("benchmark_probe", disable_rostime=True)
    probe, deadline = Probe(), time.monotonic() + patience
    while probe.found()["persons"] < people and time.monotonic() < deadline and not rospy.is_shutdown():
        time.sleep(0.1)
    # Stage times are over the last 100 images: those of the start shall be out of it.
    time.sleep(SETTLE_S)
    print("begin", flush=True)
    probe.watching, began = True, time.monotonic()
    time.sleep(seconds)
    probe.watching, seconds = False, time.monotonic() - began
    print("end", flush=True)
    result = probe.result(seconds)
    moves = rospy.Publisher("/benchmark_moves", Bool, queue_size=1, latch=True)
    result["errors"] = {"": probe.measure_errors(truth, moving_s, (width, height), False)}
    moves.publish(True)
    time.sleep(1.0)
    result["errors"]["moving_"] = probe.measure_errors(truth, moving_s, (width, height), True)
    moves.publish(False)
    if loaded_s > 0.0:
        time.sleep(1.0)
        print("load", flush=True)
        result["loaded"] = probe.ages_for(loaded_s)
        print("loaded", flush=True)
    with open(path, "w", encoding="utf-8") as file:
        json.dump(result, file)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
