"""Pictures of people whose motion is known exactly: the picture is panned, and on demand heads turn and arms swing
(warped pictures); and a ROS node that publishes them.

Usage: moving_people.py SCENE REFERENCE RATE
Publishes `/camera/image_raw` and `/camera/camera_info`. Everything is a function of the stamp: whoever has REFERENCE
(`make_reference`) knows where each landmark is in an image (`MovingPeople.places`).
"""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Dict, List, Sequence

import cv2
import numpy as np

from hri_pipeline.core.sources.image_sources import PictureMotion

HFOV = math.radians(60.0)
CYCLE_S, PHASES = 1.6, 48
"""Period of turns and swings, and pictures in it."""
TURN, SWING = math.radians(15.0), math.radians(25.0)
"""Amplitudes: heads reach 59, forearms 98 degrees per second."""
FOREARMS = ((3, 4), (6, 7))
"""Elbow and wrist of the right and left arm in hri_msgs/Skeleton2D."""
TRUNK = (2, 5, 8, 11)
"""Shoulders and hips."""
SEEN = 0.5
_SETTLE_S = 3.0
_STEP = 4
"""Pixels between two nodes of the grid on which the warp is computed."""


class HeadTurn:
    """Turns a head as a cylinder about its upright axis; at its border the picture stays as it is."""

    def __init__(self, landmarks: np.ndarray) -> None:
        """landmarks: (70, 2) px."""
        low, high = landmarks.min(axis=0), landmarks.max(axis=0)
        self.centre = (low + high) / 2.0
        self.reach = (high - low) * np.array([0.65, 0.85])

    def offset(self, points: np.ndarray, part: float) -> np.ndarray:
        """How far (N, 2) px from the points (N, 2) of the warped picture their origin is; part: -1 to 1 of TURN."""
        u, v = ((points - self.centre) / self.reach).T
        inside = (np.abs(u) < 1.0) & (np.abs(v) < 1.0)
        weight = np.where(inside, _fade(np.abs(u), 0.7, 1.0) * _fade(np.abs(v), 0.7, 1.0), 0.0)
        angle = np.arcsin(np.clip(u, -1.0, 1.0))
        moved = np.sin(np.clip(angle - weight * part * TURN, -math.pi / 2.0, math.pi / 2.0))
        result = np.zeros_like(points)
        result[:, 0] = np.where(inside, (moved - np.clip(u, -1.0, 1.0)) * self.reach[0], 0.0)
        return result


class ArmSwing:
    """Turns a forearm about its elbow, and what is near it less and less."""

    def __init__(self, elbow: np.ndarray, wrist: np.ndarray) -> None:
        self._elbow, self._arm = elbow, wrist - elbow
        self._length = float(np.linalg.norm(self._arm))

    def is_free(self, faces: Sequence[np.ndarray]) -> bool:
        """Whether it is large enough to be turned, and no face (N, 2) px is warped with it."""
        points = np.concatenate([np.zeros((0, 2)), *faces])
        return self._length > 20.0 and not any((self._weight(points, part) > 0.0).any() for part in (-1.0, 0.0, 1.0))

    def offset(self, points: np.ndarray, part: float) -> np.ndarray:
        """As of HeadTurn; part: -1 to 1 of SWING."""
        away = points - self._elbow
        return self._weight(points, part)[:, None] * (_turned(away, -part * SWING) - away)

    def _weight(self, points: np.ndarray, part: float) -> np.ndarray:
        """How far (N,) each point takes part, 0 to 1."""
        arm, away = _turned(self._arm, part * SWING), points - self._elbow
        along = np.clip(away @ arm / max(self._length, 1e-6) ** 2, 0.0, 1.4)
        return _fade(np.linalg.norm(away - along[:, None] * arm, axis=1) / max(self._length, 1e-6), 0.2, 0.7)


class MovingPeople(PictureMotion):
    """The pan of PictureMotion over a picture in which, on demand, heads turn and arms swing.

    landmarks: (F, 70, 2), skeletons: (B, 18, 3) px (and confidence) in the first view.
    """

    def __init__(self, picture: np.ndarray, landmarks: Sequence[np.ndarray] = (),
                 skeletons: Sequence[np.ndarray] = ()) -> None:
        super().__init__(picture, picture.shape[1], picture.shape[0])
        self._still = self._canvas
        self._origin = np.array(self.window(0.0)[:2])
        self._warps: List = [HeadTurn(face[:, :2] + self._origin) for face in landmarks]
        for body in skeletons:
            for elbow, wrist in FOREARMS:
                ends = body[[elbow, wrist], :2] + self._origin
                swing = ArmSwing(*ends)
                if body[[elbow, wrist], 2].min() > SEEN and swing.is_free(
                        [face[:, :2] + self._origin for face in landmarks]):
                    self._warps.append(swing)
        self._pictures: Dict[int, np.ndarray] = {}

    @staticmethod
    def phase(stamp: float, moving: bool) -> int:
        """Number of the picture in the cycle at `stamp` (s), -1 for the still one."""
        return int(stamp / CYCLE_S % 1.0 * PHASES) % PHASES if moving else -1

    def at(self, stamp: float, moving: bool) -> np.ndarray:
        """The image of `stamp`."""
        self._canvas = self.picture(self.phase(stamp, moving))
        return self.view(stamp)

    def picture(self, phase: int) -> np.ndarray:
        """The canvas of a phase, warped once."""
        if phase < 0 or not self._warps:
            return self._still
        if phase not in self._pictures:
            height, width = self._still.shape[:2]
            columns, rows = np.meshgrid(np.arange(0.0, width + _STEP, _STEP), np.arange(0.0, height + _STEP, _STEP))
            grid = np.stack([columns.ravel(), rows.ravel()], axis=1)
            origins = (grid + self._offset(grid, phase)).reshape(columns.shape + (2,)).astype(np.float32)
            # Node i of the grid lies at pixel i * _STEP: resize would put it elsewhere.
            place = np.indices((height, width), dtype=np.float32) / _STEP
            dense = cv2.remap(origins, place[1], place[0], cv2.INTER_LINEAR)
            self._pictures[phase] = cv2.remap(self._still, dense, None, cv2.INTER_LINEAR,
                                              borderMode=cv2.BORDER_REPLICATE)
        return self._pictures[phase]

    def places(self, points: np.ndarray, stamp: float, moving: bool) -> np.ndarray:
        """Where points (N, 2) px of the first view are in the image of `stamp`."""
        origin = points + self._origin
        phase = self.phase(stamp, moving)
        place = origin.copy()
        if phase >= 0:
            for _ in range(30):     # the inverse of the warp, as its fixed point
                place = origin - self._offset(place, phase)
        return place - np.array(self.window(stamp)[:2])

    def _offset(self, points: np.ndarray, phase: int) -> np.ndarray:
        part = math.sin(2.0 * math.pi * phase / PHASES)
        return sum((warp.offset(points, part) for warp in self._warps), np.zeros_like(points))


def make_reference(scene: np.ndarray, people: int) -> Dict[str, np.ndarray]:
    """What the networks say of the picture when they look at each image of it at rest.

    landmarks: (F, 70, 3), skeletons: (B, 18, 3) px and confidence; directions: (F, PHASES / 4 + 1, 3) of the faces in
    the optical frame: at rest, and in every fourth phase of the turn. Raises ValueError when somebody is not found.
    """
    from hri_fullbody.core.detection.windows import face_boxes
    from hri_fullbody.core.parameters import BODIES
    from hri_fullbody.core.pipeline import BodyPipeline
    from hri_pipeline.core.camera import CameraModel
    from hri_pipeline.core.faces.parameters import FACES
    from hri_pipeline.core.faces.pipeline import FacePipeline

    camera = CameraModel.from_fov(scene.shape[1], scene.shape[0], HFOV)
    every = {"face_mesh_rate": 0.0, "face_budget": 1000.0, "recognition": False, "expression": False,
             "age_gender": False, "action_units": False}

    tracker = FacePipeline(FACES.resolve(every))
    bodies = BodyPipeline(BODIES.resolve({"pose_rate": 0.0, "pose_budget": 0}))
    still = MovingPeople(scene)
    for stamp in np.arange(-_SETTLE_S, 0.05, 0.1).round(1):     # panned till it is at rest
        image = still.at(stamp, False)
        faces = tracker.update(image, camera, stamp)
        standing = bodies.update(image, camera, stamp, face_boxes((one.id, one.landmarks, one.pose) for one in faces))
    if len(faces) != people or len(standing) != people:
        raise ValueError("{} people, but {} faces and {} bodies are found at rest".format(
            people, len(faces), len(standing)))
    landmarks, skeletons = (np.stack([getattr(one, name) for one in found])
                            for name, found in (("landmarks", faces), ("keypoints", standing)))
    moving = MovingPeople(scene, landmarks, skeletons)
    directions = np.full((people, PHASES // 4 + 1, 3), np.nan)
    owner = {face.id: number for number, face in enumerate(faces)}
    for index in range(-4, 4 * PHASES):     # slowly: a turn of 1.6 s in 19
        phase = max(index, 0) // 4
        moving._canvas = moving.picture(phase if index >= 0 else -1)
        if phase % 4 == 0 or index % 4 == 0:
            faces = tracker.update(moving.view(0.0), camera, 0.5 + 0.1 * index)
        for face in faces:
            if face.pose is not None and face.id in owner and phase % 4 == 0:
                directions[owner[face.id], 1 + phase // 4 if index >= 0 else 0] = face.pose.rotation[:, 0]
    return {"landmarks": landmarks, "skeletons": skeletons, "directions": directions}


def _turned(points: np.ndarray, angle: float) -> np.ndarray:
    cosine, sine = math.cos(angle), math.sin(angle)
    return points @ np.array([[cosine, sine], [-sine, cosine]])


def _fade(values: np.ndarray, full: float, none: float) -> np.ndarray:
    """1 up to `full`, 0 from `none`, smooth between."""
    part = np.clip((none - values) / (none - full), 0.0, 1.0)
    return part * part * (3.0 - 2.0 * part)


def main(arguments: List[str]) -> int:
    """Publish until ROS shuts down; `benchmark_moves` (Bool) says whether heads and arms move."""
    import rospy
    from sensor_msgs.msg import CameraInfo, Image
    from std_msgs.msg import Bool, Header

    from hri_pipeline.core.timing import Pacer
    from hri_pipeline.ros.conversions import bgr_to_image, camera_info

    reference = np.load(arguments[1])
    people = MovingPeople(cv2.imread(arguments[0]), reference["landmarks"], reference["skeletons"])
    rospy.init_node("moving_people")
    moves = {"now": False}
    images = rospy.Publisher("/camera/image_raw", Image, queue_size=1)
    infos = rospy.Publisher("/camera/camera_info", CameraInfo, queue_size=10)
    listener = rospy.Subscriber("/benchmark_moves", Bool, lambda message: moves.update(now=message.data))
    for phase in range(PHASES):
        people.picture(phase)
    pacer = Pacer(float(arguments[2]))
    while not rospy.is_shutdown():
        rospy.rostime.wallsleep(pacer.wait(rospy.get_time()))
        stamp = rospy.Time.now()
        pacer.done(rospy.get_time())
        image = people.at(stamp.to_sec(), moves["now"])
        header = Header(stamp=stamp, frame_id="camera_color_optical_frame")
        images.publish(bgr_to_image(image, header))
        infos.publish(camera_info(image.shape[1], image.shape[0], HFOV, header))
    listener.unregister()
    return 0


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
    sys.exit(main(sys.argv[1:]))
