"""A scene of the simulator as a bag: what faces, bodies and voices would publish, and the truth; no ROS, no picture, no
sound."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Dict, Iterable, List, Sequence, Tuple, Union

import numpy as np

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces.gaze import gaze_frame
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.simulation.agents import box, keypoints, landmarks
from hri_pipeline.core.simulation.parameters import SceneSettings, sense_defaults
from hri_pipeline.core.simulation.scene_file import Scene
from hri_pipeline.core.simulation.sensors import (
    BODIES,
    BODY,
    FACE,
    FACES,
    PERSON,
    VOICE,
    VOICES,
    SceneMatches,
    Sensed,
    SensedBody,
    SensedFace,
    Senses,
    camera_pose,
)
from hri_pipeline.core.simulation.world import SceneTruth, World
from hri_pipeline.score.bag import BagWriter

BASE = 1_600_000_000.0
"""Time (s) at which a bag begins."""
_KINDS = {PERSON: 1, FACE: 2, BODY: 3, VOICE: 4}   # constants of hri_msgs/IdsMatch
_EYES, _LIPS, _JAW = 45, 25, 26                     # of hri_msgs/FacialActionUnits
_MICROPHONE = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
_VOICE_DISTANCE, _REPEAT_S, _SYLLABLES = 1.0, 1.0, 4.0

Frame = Tuple[str, str, Pose]


def write_scene(path: Union[str, Path], scene: Scene, begin: float = 0.0, end: float = math.inf, seed: int = 0,
                matches: bool = False, rate: float = 15.0) -> None:
    """Write the bag of a scene from `begin` to `end` (s of the scene); the bag itself starts at BASE.

    matches: also say which face, body and voice belong together; False: a matcher has to find out. Which person a face
    is of is always said, 2 s after it was found, as a recogniser does. rate: Hz. Raises ValueError when nothing is left
    of the scene.
    """
    last = min(end, scene.duration)
    if not 0.0 <= begin < last:
        raise ValueError("{:g} to {:g} s is nothing of a scene of {:g} s".format(begin, end, scene.duration))
    settings = sense_defaults(matches=matches, rate=rate)
    world, senses = World(scene, seed), Senses(settings, seed, scene.robot.height)
    pairs = SceneMatches(settings, seed)
    with BagWriter(path) as bag:
        bag.transforms("/tf_static", _robot(scene, settings), BASE)
        bag.text("/scene/truth/script", scene.text, BASE, latched=True)
        recording = _Recording(bag, settings)
        for number in range(int(begin * rate), int(last * rate)):
            truth = world.at(number / rate)
            sensed = senses.sense(truth)
            offset = BASE - begin
            write_truth(bag, truth, offset, sensed.visible)
            recording.write(sensed, offset + truth.stamp)
            for said in pairs.update(sensed):
                name = "hri_msgs/msg/IdsMatch"
                bag.write("/humans/candidate_matches", name, bag.make(
                    name, said.first, _KINDS[said.first_kind], said.second, _KINDS[said.second_kind], said.likelihood),
                    offset + truth.stamp)


def write_truth(bag: BagWriter, truth: SceneTruth, base: float, visible: Iterable[str],
                namespace: str = "/scene/truth") -> None:
    """Write a cycle of the truth, as the simulator publishes it.

    base: s, added to its stamp; visible: who could be seen.
    """
    stamp, people = base + truth.stamp, truth.people
    bag.ids(namespace + "/persons", [person.id for person in people], stamp)
    bag.ids(namespace + "/visible", sorted(visible), stamp)
    bag.ids(namespace + "/speaking", [person.id for person in people if person.speaking], stamp)
    bag.ids(namespace + "/eyes_closed", [person.id for person in people if person.eyes_closed], stamp)
    bag.poses(namespace + "/heads", [Pose(person.head_rotation, person.head) for person in people], stamp)
    bag.poses(namespace + "/bodies", [_upright(person.yaw, person.position) for person in people], stamp)
    bag.gaze(namespace + "/gaze", [(person.id, person.target) for person in people if person.target is not None], stamp)
    bag.groups(namespace + "/groups", [group.members for group in truth.groups], stamp)


class _Recording:
    """Writes what is sensed, cycle by cycle."""

    def __init__(self, bag: BagWriter, settings: SceneSettings) -> None:
        self._bag, self._settings = bag, settings
        self._camera = CameraModel.from_fov(settings.width, settings.height, math.radians(settings.sense_hfov))
        self._lists: Dict[str, Tuple[float, List[str]]] = {}
        self._speaking: Dict[str, bool] = {}

    def write(self, sensed: Sensed, stamp: float) -> None:
        """Write one cycle."""
        for kind, features in ((FACES, sensed.faces), (BODIES, sensed.bodies), (VOICES, sensed.voices)):
            self._list(kind, [feature.id for feature in features], stamp)
        frames: List[Frame] = []
        for face in sensed.faces if FACES in sensed.fresh else ():
            if face.measured:
                frames += self._face(face, stamp, sensed.stamp)
        for body in sensed.bodies if BODIES in sensed.fresh else ():
            if body.measured:
                frames += self._body(body, stamp)
        for voice in sensed.voices:
            if self._speaking.get(voice.id) != voice.speaking:
                self._speaking[voice.id] = voice.speaking
                self._bag.flag("/humans/voices/{}/is_speaking".format(voice.id), voice.speaking, stamp)
            if VOICES in sensed.fresh and voice.speaking and voice.direction is not None:
                place = Pose(np.eye(3), _VOICE_DISTANCE * (_MICROPHONE @ voice.direction))
                frames.append((self._settings.microphone_frame, "voice_" + voice.id, place))
        if frames:
            self._bag.transforms("/tf", frames, stamp)

    def _list(self, kind: str, ids: List[str], stamp: float) -> None:
        """On every change and once a second."""
        when, listed = self._lists.get(kind, (-math.inf, []))
        if ids != listed or stamp - when >= _REPEAT_S:
            self._lists[kind] = stamp, ids
            self._bag.ids("/humans/{}/tracked".format(kind), ids, stamp, self._settings.camera_frame)

    def _face(self, face: SensedFace, stamp: float, now: float) -> List[Frame]:
        mouth = 0.5 - 0.5 * math.cos(2.0 * math.pi * _SYLLABLES * now) if face.speaking else 0.0
        topic, frame = "/humans/faces/{}/".format(face.id), self._settings.camera_frame
        points = landmarks(face.pose, self._camera, face.eyes_closed, mouth)
        self._points(topic + "landmarks", "FacialLandmarks", points, stamp)
        self._roi(topic + "roi", box(points, 0.1), stamp)
        intensity, confidence = np.zeros(99, np.float32), np.zeros(99, np.float32)
        confidence[[_EYES, _LIPS, _JAW]] = 0.8
        intensity[_EYES], intensity[_LIPS], intensity[_JAW] = face.eyes_closed, min(1.0, 1.5 * mouth), 0.6 * mouth
        name = "hri_msgs/msg/FacialActionUnits"
        self._bag.write(topic + "facs", name,
                        self._bag.make(name, self._bag.header(stamp, frame), intensity, confidence), stamp)
        frames = [(frame, "face_" + face.id, face.pose)]
        if face.gaze is not None:
            frames.append(("face_" + face.id, "gaze_" + face.id, gaze_frame(face.pose, face.gaze)))
        return frames

    def _body(self, body: SensedBody, stamp: float) -> List[Frame]:
        topic, name = "/humans/bodies/{}/".format(body.id), "body_" + body.id
        points = keypoints(body.pose, body.head, body.stature, self._camera)
        self._points(topic + "skeleton2d", "Skeleton2D", points, stamp)
        self._roi(topic + "roi", box(points, 0.08), stamp)
        return [(self._settings.camera_frame, name, body.pose),
                (name, "head_" + body.id, body.pose.inverse().compose(body.head))]

    def _points(self, topic: str, kind: str, points: np.ndarray, stamp: float) -> None:
        """points: (N, 3) x px, y px, confidence; what is not finite or not known becomes zeros."""
        width, height, name = self._camera.width, self._camera.height, "hri_msgs/msg/" + kind
        known = np.isfinite(points).all(axis=1) & (points[:, 2] > 0.0)
        values = np.where(known[:, None], points / (width, height, 1.0), 0.0)
        made = [self._bag.make("hri_msgs/msg/NormalizedPointOfInterest2D", *map(float, row)) for row in values]
        size = (height, width) if kind == "FacialLandmarks" else ()
        self._bag.write(topic, name, self._bag.make(name, self._bag.header(stamp, self._settings.camera_frame), made,
                                                    *size), stamp)

    def _roi(self, topic: str, corners: np.ndarray, stamp: float) -> None:
        """corners: x0, y0, x1, y1 px; the interface is `paper`."""
        x0, y0, x1, y1 = np.clip(np.round(corners), 0,
                                 (self._camera.width, self._camera.height) * 2).astype(int).tolist()
        name = "sensor_msgs/msg/RegionOfInterest"
        self._bag.write(topic, name, self._bag.make(name, x0, y0, y1 - y0, x1 - x0, False), stamp)


def _upright(yaw: float, position: Sequence[float]) -> Pose:
    """Somebody who stands at `position` (2,) m on the floor, turned to `yaw` (rad)."""
    cosine, sine = math.cos(yaw), math.sin(yaw)
    return Pose(np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]]), np.array([*position, 0.0]))


def _robot(scene: Scene, settings: SceneSettings) -> List[Frame]:
    """The fixed frames: reference, robot, camera, microphone."""
    robot = scene.robot
    base = _upright(robot.yaw, robot.position)
    camera = base.inverse().compose(camera_pose(*robot.position, robot.yaw, robot.height))
    return [(settings.reference_frame, settings.robot_frame, base),
            (settings.robot_frame, settings.camera_frame, camera),
            (settings.robot_frame, settings.microphone_frame, Pose(np.eye(3), np.array([0.0, 0.0, robot.height])))]


class SceneBag(BagWriter):
    """A bag that is being written; times in s."""

    def confidence(self, person, value, stamp):
        self.number("/humans/persons/{}/location_confidence".format(person), value, stamp)

    def truth(self, truth, base, visible=None, namespace="/scene/truth"):
        """A cycle of the truth, as the simulator publishes it; visible: who could be seen, everybody if None."""
        write_truth(self, truth, base, [person.id for person in truth.people] if visible is None else visible,
                    namespace)


def upright(place):
    """A pose without a turn."""
    return Pose(np.eye(3), np.asarray(place, dtype=float))
