"""Pictures of people whose motion is known exactly: a camera turns before a photograph, and on demand heads turn and
arms swing (warped pictures); and a ROS node that publishes them.

Usage: moving_people.py SCENE REFERENCE RATE
Publishes `/camera/image_raw` and `/camera/camera_info`. Everything is a function of the stamp: whoever has REFERENCE
(`make_reference`) knows where each landmark is in an image (`MovingPeople.places`), and which way the camera has
turned (`MovingPeople.turn`).
"""

from __future__ import annotations

import math
import sys
from collections import defaultdict
from pathlib import Path
from typing import TYPE_CHECKING, Dict, List, Sequence, Tuple

import cv2
import numpy as np

from hri_pipeline.core.observations import FaceObservation
from hri_pipeline.core.sources.image_sources import BAR_GREY, paste_centred, scaled

if TYPE_CHECKING:       # the node that publishes needs no networks
    from hri_pipeline.core.camera import CameraModel
    from hri_pipeline.core.faces.pipeline import FacePipeline

HFOV = math.radians(60.0)
PAN, PAN_S = math.radians(1.5), 9.0
"""How far the camera turns to each side, and the period: the picture moves by 20 px per second at most."""
_SHRUNK = 0.94
"""Size of the photograph over that of the image: all of it stays in view while the camera turns."""
CYCLE_S, PHASES = 1.6, 48
"""Period of turns and swings, and pictures in it."""
TURN, SWING = math.radians(15.0), math.radians(25.0)
"""Amplitudes: heads reach 59, forearms 98 degrees per second."""
FOREARMS = ((3, 4), (6, 7))
"""Elbow and wrist of the right and left arm in hri_msgs/Skeleton2D."""
TRUNK = (2, 5, 8, 11)
"""Shoulders and hips."""
SEEN = 0.5
_SETTLE_S, _LOOK_S = 3.0, 0.2
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

    def box(self) -> np.ndarray:
        """Left, top, right, bottom (4,) px of what is warped."""
        return np.concatenate([self.centre - self.reach, self.centre + self.reach])


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

    def box(self) -> np.ndarray:
        """As of HeadTurn."""
        ends = self._elbow + np.array([along * _turned(self._arm, part * SWING)
                                       for along in (0.0, 1.4) for part in (-1.0, 0.0, 1.0)])
        return np.concatenate([ends.min(axis=0) - 0.7 * self._length, ends.max(axis=0) + 0.7 * self._length])

    def _weight(self, points: np.ndarray, part: float) -> np.ndarray:
        """How far (N,) each point takes part, 0 to 1."""
        arm, away = _turned(self._arm, part * SWING), points - self._elbow
        along = np.clip(away @ arm / max(self._length, 1e-6) ** 2, 0.0, 1.4)
        return _fade(np.linalg.norm(away - along[:, None] * arm, axis=1) / max(self._length, 1e-6), 0.2, 0.7)


class MovingPeople:
    """What a camera sees that turns about its upright axis before a photograph in which, on demand, heads turn and arms
    swing.

    At 0 s the photograph lies in the middle of the image, on a grey wall. To make an image anew takes 12 ms; so the
    camera turned by steps of 1 px in the middle of the image is drawn once (61 pictures, 170 MB), and an image is the
    mean of the two next to it, by their distances: within .001 px of where it should be, in 1.1 ms.
    landmarks: (F, 70, 2), skeletons: (B, 18, 3) px (and confidence) in the first view.
    """

    def __init__(self, picture: np.ndarray, landmarks: Sequence[np.ndarray] = (),
                 skeletons: Sequence[np.ndarray] = ()) -> None:
        height, width = picture.shape[:2]
        self._still = paste_centred(scaled(picture, int(_SHRUNK * width), int(_SHRUNK * height)), width, height)
        focal = 0.5 * width / math.tan(HFOV / 2.0)
        self._matrix = np.array([[focal, 0.0, width / 2.0], [0.0, focal, height / 2.0], [0.0, 0.0, 1.0]])
        self._warps: List = [HeadTurn(face[:, :2]) for face in landmarks]
        for body in skeletons:
            for elbow, wrist in FOREARMS:
                swing = ArmSwing(*body[[elbow, wrist], :2])
                if body[[elbow, wrist], 2].min() > SEEN and swing.is_free([face[:, :2] for face in landmarks]):
                    self._warps.append(swing)
        self._pictures: Dict[int, np.ndarray] = {}
        self._views: Dict[int, np.ndarray] = {}

    @staticmethod
    def phase(stamp: float, moving: bool) -> int:
        """Number of the picture in the cycle at `stamp` (s), -1 for the still one."""
        return int(stamp / CYCLE_S % 1.0 * PHASES) % PHASES if moving else -1

    @staticmethod
    def turn(stamp: float) -> np.ndarray:
        """Rotation (3, 3) that takes directions in the optical frame at 0 s to those at `stamp` (s)."""
        return _about_upright(PAN * math.sin(2.0 * math.pi * stamp / PAN_S))

    def at(self, stamp: float, moving: bool) -> np.ndarray:
        """The image of `stamp`."""
        image, phase = self._still_at(stamp), self.phase(stamp, moving)
        if phase >= 0:
            for warp in self._warps:
                left, top, right, bottom = self._seen_box(warp.box(), stamp)
                if left < right and top < bottom:
                    image[top:bottom, left:right] = self._drawn(
                        self.picture(phase), self.turn(stamp), (left, top, right, bottom), cv2.INTER_LINEAR)
        return image

    def draw_all(self) -> None:
        """Draw all that is drawn once."""
        steps = math.ceil(self._matrix[0, 0] * math.tan(PAN))
        for step in range(-steps, steps + 1):
            self._view(step)
        for phase in range(PHASES):
            self.picture(phase)

    def picture(self, phase: int) -> np.ndarray:
        """The first view in a phase, warped once."""
        if phase < 0 or not self._warps:
            return self._still
        phase = min(phase, (PHASES // 2 - phase) % PHASES)      # there and back are the same pictures
        if phase not in self._pictures:
            height, width = self._still.shape[:2]
            columns, rows = np.meshgrid(np.arange(0.0, width + _STEP, _STEP), np.arange(0.0, height + _STEP, _STEP))
            grid = np.stack([columns.ravel(), rows.ravel()], axis=1)
            origins = (grid + self._offset(grid + 0.5, phase)).reshape(columns.shape + (2,)).astype(np.float32)
            # Node i of the grid lies at pixel i * _STEP: resize would put it elsewhere.
            place = np.indices((height, width), dtype=np.float32) / _STEP
            dense = cv2.remap(origins, place[1], place[0], cv2.INTER_LINEAR)
            self._pictures[phase] = cv2.remap(self._still, dense, None, cv2.INTER_LINEAR,
                                              borderMode=cv2.BORDER_REPLICATE)
        return self._pictures[phase]

    def places(self, points: np.ndarray, stamp: float, moving: bool) -> np.ndarray:
        """Where points (N, 2) px of the first view are in the image of `stamp`; the middle of the first pixel is .5."""
        phase = self.phase(stamp, moving)
        place = points.copy()
        if phase >= 0:
            for _ in range(30):     # the inverse of the warp, as its fixed point
                place = points - self._offset(place, phase)
        return _mapped(self._to_image(self.turn(stamp)), place)

    def at_first(self, points: np.ndarray, stamp: float) -> np.ndarray:
        """Where points (N, 2) px of the image of `stamp`, in which nobody moves, are in the first view."""
        return _mapped(self._to_image(self.turn(stamp).T), points)

    def _offset(self, points: np.ndarray, phase: int) -> np.ndarray:
        part = math.sin(2.0 * math.pi * phase / PHASES)
        return sum((warp.offset(points, part) for warp in self._warps), np.zeros_like(points))

    def _to_image(self, turn: np.ndarray) -> np.ndarray:
        """Homography (3, 3) from the first view to that of a camera that has turned."""
        return self._matrix @ turn @ np.linalg.inv(self._matrix)

    def _still_at(self, stamp: float) -> np.ndarray:
        turn = self.turn(stamp)
        place = float(self._matrix[0, 0] * turn[0, 2] / turn[2, 2])
        step = math.floor(place)
        return cv2.addWeighted(self._view(step), 1.0 - place + step, self._view(step + 1), place - step, 0.0)

    def _view(self, step: int) -> np.ndarray:
        """The still picture when its middle has moved by `step` px, drawn once."""
        if step not in self._views:
            height, width = self._still.shape[:2]
            turn = _about_upright(math.atan(step / self._matrix[0, 0]))
            self._views[step] = self._drawn(self._still, turn, (0, 0, width, height), cv2.INTER_CUBIC)
        return self._views[step]

    def _drawn(self, view: np.ndarray, turn: np.ndarray, box: Tuple[int, int, int, int], how: int) -> np.ndarray:
        """The part (left, top, right, bottom px) of the image of a camera that has turned from the first view."""
        left, top, right, bottom = box
        back = _moved(-0.5, -0.5) @ self._to_image(turn.T) @ _moved(left + 0.5, top + 0.5)
        return cv2.warpPerspective(view, back, (right - left, bottom - top), flags=how | cv2.WARP_INVERSE_MAP,
                                   borderMode=cv2.BORDER_CONSTANT, borderValue=(BAR_GREY, BAR_GREY, BAR_GREY))

    def _seen_box(self, box: np.ndarray, stamp: float) -> Tuple[int, int, int, int]:
        """Whole pixels of the image of `stamp` in which a box (4,) px of the first view is seen."""
        height, width = self._still.shape[:2]
        corners = self.places(box[[0, 1, 2, 1, 0, 3, 2, 3]].reshape(4, 2), stamp, False)
        low, high = np.floor(corners.min(axis=0)) - 1.0, np.ceil(corners.max(axis=0)) + 1.0
        left, top, right, bottom = np.clip(np.concatenate([low, high]), 0, (width, height, width, height)).astype(int)
        return int(left), int(top), int(right), int(bottom)


def make_reference(scene: np.ndarray, people: int) -> Dict[str, np.ndarray]:
    """What the networks say of the picture on average when they look at each image of a pan.

    landmarks: (F, 70, 3), skeletons: (B, 18, 3) px and confidence in the first view; directions: (F, PHASES / 4 + 1, 3)
    of the faces in its optical frame: on average, and in every fourth phase of the turn, as it is seen once. Raises
    ValueError when somebody is not found.
    """
    from hri_fullbody.core.detection.windows import face_boxes
    from hri_fullbody.core.parameters import BODIES
    from hri_fullbody.core.pipeline import BodyPipeline
    from hri_pipeline.core.camera import Calibration, CameraModel
    from hri_pipeline.core.faces.parameters import FACES
    from hri_pipeline.core.faces.pipeline import FacePipeline

    # As the stack has it from camera_info: faces aside of the optical axis are seen as ahead.
    camera = CameraModel.from_fov(scene.shape[1], scene.shape[0], HFOV, Calibration.CALIBRATED)
    every = {"face_mesh_rate": 0.0, "face_budget": 1000.0, "recognition": False, "expression": False,
             "age_gender": False, "action_units": False}

    tracker = FacePipeline(FACES.resolve(every))
    bodies = BodyPipeline(BODIES.resolve({"pose_rate": 0.0, "pose_budget": 0}))
    still = MovingPeople(scene)
    looks: Dict[Tuple[str, str], List[np.ndarray]] = defaultdict(list)
    for stamp in np.arange(-_SETTLE_S, PAN_S, _LOOK_S).round(1):
        image = still.at(stamp, False)
        faces = tracker.update(image, camera, stamp)
        standing = bodies.update(image, camera, stamp, face_boxes((one.id, one.landmarks, one.pose) for one in faces))
        for face in faces if stamp >= 0.0 else ():
            looks["landmarks", face.id].append(_at_first(still, face.landmarks, stamp))
            looks["directions", face.id].append(_direction(face) @ still.turn(stamp))
        for body in standing if stamp >= 0.0 else ():
            looks["skeletons", body.id].append(_at_first(still, body.keypoints, stamp))
    if len(faces) != people or len(standing) != people:
        raise ValueError("{} people, but {} faces and {} bodies are found after a pan".format(
            people, len(faces), len(standing)))
    seen = {name: np.stack([np.nanmean(looks[name, one.id], axis=0) for one in found])
            for name, found in (("landmarks", faces), ("directions", faces), ("skeletons", standing))}
    still_directions = seen["directions"] / np.linalg.norm(seen["directions"], axis=1, keepdims=True)
    moving = MovingPeople(scene, seen["landmarks"], seen["skeletons"])
    turned = _directions_in_turns(tracker, camera, moving, [face.id for face in faces])
    return {"landmarks": seen["landmarks"], "skeletons": seen["skeletons"],
            "directions": np.concatenate([still_directions[:, None], turned], axis=1)}


def _directions_in_turns(tracker: FacePipeline, camera: CameraModel, moving: MovingPeople,
                         ids: Sequence[str]) -> np.ndarray:
    """Where faces look, (F, PHASES / 4, 3) in the optical frame, in every fourth phase of their turns; not a number
    where one is not seen. tracker: has seen the pan."""
    directions = np.full((len(ids), PHASES // 4, 3), np.nan)
    for index in range(-4, 4 * PHASES):     # slowly: a turn of 1.6 s in 19
        phase = max(index, 0) // 4
        if phase % 4 == 0 or index % 4 == 0:
            faces = tracker.update(moving.picture(phase), camera, PAN_S + 0.5 + 0.1 * index)
        for face in faces:
            if index >= 0 and face.id in ids and phase % 4 == 0:
                directions[ids.index(face.id), phase // 4] = _direction(face)
    return directions


def _at_first(people: MovingPeople, points: np.ndarray, stamp: float) -> np.ndarray:
    """Points (N, 3) px and confidence of the image of `stamp` (s), in the first view."""
    return np.column_stack([people.at_first(points[:, :2], stamp), points[:, 2]])


def _direction(face: FaceObservation) -> np.ndarray:
    """Where a face looks, (3,) in the optical frame, not a number where it is not known."""
    return np.full(3, np.nan) if face.pose is None else face.pose.rotation[:, 0]


def _about_upright(angle: float) -> np.ndarray:
    """Rotation (3, 3) of directions in the optical frame by an angle (rad) to the right."""
    cosine, sine = math.cos(angle), math.sin(angle)
    return np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])


def _mapped(homography: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (N, 2) by a homography (3, 3)."""
    rays = np.column_stack([points, np.ones(len(points))]) @ homography.T
    return rays[:, :2] / rays[:, 2:]


def _moved(across: float, down: float) -> np.ndarray:
    return np.array([[1.0, 0.0, across], [0.0, 1.0, down], [0.0, 0.0, 1.0]])


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
    people.draw_all()
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
