"""Figures of faces: processor time, pose, portraits, eyes, identities, endurance.

Poses are measured on heads of known pose: the canonical face, projected with noise.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Callable, Dict, Iterator, List, Mapping, NamedTuple, Optional, Sequence, Tuple

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.labels import LabelledFace, confusion, images, labelled_eyes, nearest_face, read_labels
from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces.analysis import FaceDemand
from hri_pipeline.core.faces.gaze import EyeGeometry, GazeEstimator
from hri_pipeline.core.faces.head_pose import HeadPoseEstimator, yaw_pitch_roll
from hri_pipeline.core.faces.mesh import (
    VERTICES,
    Blendshapes,
    CanonicalFace,
    FaceMesh,
    load_canonical_face,
    roi_from_mesh,
)
from hri_pipeline.core.faces.parameters import FACES
from hri_pipeline.core.faces.pipeline import FacePipeline
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.observations import FaceObservation
from hri_pipeline.core.onnx import OnnxModel, models_directory

RATE_HZ = 20.0
"""Images per second of the films made of stills."""
WARM_UP_S = 10.0
"""By then every face has its person and its age: what is left is what a camera in use costs."""
WIDTH, HEIGHT = 1280, 720
EXPRESSIONS = Path(__file__).with_name("expressions.txt")
PHOTOGRAPH_HFOV = np.deg2rad(53.0)
GEOMETRY_ONLY = {"action_units": False, "expression": False, "age_gender": False, "recognition": False}
"""Settings of a face stage that only finds faces."""


def pan(still: np.ndarray, seconds: float) -> Iterator[Tuple[float, np.ndarray]]:
    """Yield (stamp s, image (720, 1280, 3)) of a slow pan over a still (720, 1280, 3), mirrored at its borders."""
    wide = cv2.copyMakeBorder(still, 40, 40, 40, 40, cv2.BORDER_REFLECT)
    for index in range(int(round(seconds * RATE_HZ))):
        stamp = index / RATE_HZ
        left, top = int(round(40 + 25 * np.sin(stamp))), int(round(40 + 20 * np.cos(1.3 * stamp)))
        yield 1000.0 + stamp, np.ascontiguousarray(wide[top:top + HEIGHT, left:left + WIDTH])


def cpu_ms(scene: np.ndarray, people: int, seconds: float = 10.0) -> float:
    """Return the mean processor time (ms) per image of the face stage with everything on.

    scene: (720, 1280, 3) picture with `people` faces, panned slowly. Raises RuntimeError when another number of faces
    is tracked.
    """
    cv2.setNumThreads(1)
    stage = FacePipeline(FACES.resolve({"threads": 1}))
    camera = CameraModel.from_fov(WIDTH, HEIGHT, 1.0)
    spent, faces = [], []
    for stamp, image in pan(scene, WARM_UP_S + seconds):
        began = time.thread_time()
        faces = stage.update(image, camera, stamp, None, FaceDemand.everything(stage.tracked_ids))
        if stamp >= 1000.0 + WARM_UP_S:
            spent.append(time.thread_time() - began)
    stage.close()
    if len(faces) != people:
        raise RuntimeError("{} faces are tracked in the scene with {}".format(len(faces), people))
    return 1e3 * float(np.mean(spent))


def pose_errors(count: int = 300, noise_px: float = 1.0) -> Tuple[float, float, float, float]:
    """Return the mean absolute errors of yaw, pitch and roll (degrees) and of the position (% of the distance).

    The canonical face at yaw within 60, pitch within 30, roll within 45 degrees and 0.5 to 2 m, projected into a
    1280x720 image with normal noise of noise_px on every coordinate.
    """
    face = load_canonical_face(models_directory() / "canonical_face.npz")
    camera = CameraModel.from_fov(WIDTH, HEIGHT, 1.0)
    random = np.random.RandomState(3)
    truths = head_poses(count, random)
    estimator = HeadPoseEstimator(face)
    angles, places = [], []
    for truth, mesh in zip(truths, meshes_of(face, truths, camera, noise_px, random)):
        found = estimator.estimate(mesh, camera)
        if found is None:
            raise RuntimeError("no pose was found of a head at {}".format(np.round(truth.translation, 2)))
        difference = yaw_pitch_roll(found) - yaw_pitch_roll(truth)
        angles.append(np.abs((difference + np.pi) % (2.0 * np.pi) - np.pi))
        places.append(np.linalg.norm(found.translation - truth.translation) / np.linalg.norm(truth.translation))
    yaw, pitch, roll = np.degrees(np.mean(angles, axis=0)).tolist()
    return yaw, pitch, roll, 100.0 * float(np.mean(places))


def eyes_closed(models: Path) -> Dict[str, int]:
    """Return the confusion table (tp: closed and found closed, fp, tn, fn, unknown) of real labelled eyes, all of
    eyes.txt, nothing known of the person."""
    found = [face for face in judged_eyes(models) if face.width is None]
    return confusion([face.label for face in found], [face.closed for face in found])


TUNING = ("demo/sample1", "demo/sample2", "demo/sample3", "evaluation/talking", "evaluation/grimaces_1",
          "evaluation/portrait_01", "evaluation/portrait_02", "evaluation/portrait_03", "evaluation/portrait_04",
          "evaluation/portrait_05", "evaluation/posed")
"""Pictures and films of eyes.txt on which the constants of `gaze` were set; the others, of other people, were only
looked at once they stood."""
WIDTHS = (60, 40)
"""Widths (px) of the faces to which the pictures are made smaller, beside as they are."""


class JudgedEyes(NamedTuple):
    """A labelled face; width (px) to which it was made smaller, None: as it is; whether its eyes were found closed,
    None: not found; its yaw (degrees) against the line of sight."""

    label: LabelledFace
    width: Optional[int]
    closed: Optional[bool]
    yaw: float = 0.0


def eye_errors(models: Path, widths: Sequence[int] = WIDTHS) -> Dict[str, Dict[str, object]]:
    """Return the errors on the half of eyes.txt that nothing was tuned on, by how the faces are seen.

    open_told_shut, shut_told_open: shares over all sizes; `counts`: wrong of how many, by size, yaw and half.
    """
    faces = [face for face in judged_eyes(models, widths) if face.closed is not None]
    kept = [face for face in faces if not face.label.file.startswith(TUNING)]
    counts = {"{} {}".format(half, name): _errors([face for face in group if accepts(face)])
              for half, group in (("kept apart", kept), ("tuned", [face for face in faces if face not in kept]))
              for name, accepts in _BINS}
    total = _errors(kept)
    return {"eyes": {name: wrong / max(1, of) for name, (wrong, of) in total.items()}, "counts": counts}


_BINS: Sequence[Tuple[str, Callable[[JudgedEyes], bool]]] = (
    ("as they are", lambda face: face.width is None), ("60 px", lambda face: face.width == 60),
    ("40 px", lambda face: face.width == 40), ("yaw up to 15", lambda face: abs(face.yaw) <= 15.0),
    ("yaw over 15", lambda face: abs(face.yaw) > 15.0))


def _errors(faces: Sequence[JudgedEyes]) -> Dict[str, Tuple[int, int]]:
    """Wrong answers, and of how many."""
    opened, shut = ([face for face in faces if face.label.closed is closed] for closed in (False, True))
    return {"open_told_shut": (sum(bool(face.closed) for face in opened), len(opened)),
            "shut_told_open": (sum(not face.closed for face in shut), len(shut))}


def judged_eyes(models: Path, widths: Sequence[int] = ()) -> List[JudgedEyes]:
    """Return what is found of all labelled eyes, in pictures as they are and with the faces of these widths (px)."""
    stage = FacePipeline(FACES.resolve(dict(GEOMETRY_ONLY, face_birth_delay=0.0, face_min_detections=1,
                                            face_person_lead=0.0)))      # in the first image
    mesh = FaceMesh(OnnxModel(models_directory() / "face_landmarks_attention.onnx"))
    judge = _EyeJudge()
    found = []
    for group, image in images(labelled_eyes(), models):
        stage.reset()
        faces = stage.update(image, _photograph_camera(image), 1000.0)
        # The crop after a detection is a coarse one: look once more.
        results = mesh.run(image, [roi_from_mesh(face.mesh) for face in faces])
        boxes = np.array([face.box for face in faces]).reshape(-1, 4)
        for label in group:
            index = nearest_face(label, boxes, image.shape)
            points = None if index is None else results[index].points
            found.append(judge(label, None, image, points))
            for width in widths if points is not None else ():
                small, guess = _smaller(image, points, width)
                for _ in range(2):
                    guess = mesh.run(small, [roi_from_mesh(guess)])[0].points
                found.append(judge(label, width, small, guess))
    stage.close()
    return found


class _EyeJudge:
    def __init__(self) -> None:
        canonical = load_canonical_face(models_directory() / "canonical_face.npz")
        self._heads, self._gazes = HeadPoseEstimator(canonical), GazeEstimator(EyeGeometry(canonical))
        self._shapes = Blendshapes(models_directory() / "face_blendshapes.onnx")

    def __call__(self, label: LabelledFace, width: Optional[int], image: np.ndarray, points: Optional[np.ndarray]
                 ) -> JudgedEyes:
        camera = _photograph_camera(image)
        pose = None if points is None else self._heads.estimate(points, camera)
        if points is None or pose is None:
            return JudgedEyes(label, width, None)
        gaze = self._gazes.estimate(points, pose, camera, 1.0, self._shapes.run([points])[0])
        x, _, z = pose.translation
        return JudgedEyes(label, width, gaze.eyes_closed > 0.5,
                          float(np.degrees(yaw_pitch_roll(pose)[0] + np.arctan2(x, z))))


def _photograph_camera(image: np.ndarray) -> CameraModel:
    return CameraModel.from_fov(image.shape[1], image.shape[0], PHOTOGRAPH_HFOV)


def _smaller(image: np.ndarray, points: np.ndarray, width: int) -> Tuple[np.ndarray, np.ndarray]:
    """A picture in which the face of these points is `width` px wide at most, and the points there."""
    scale = min(1.0, width / float(np.ptp(points[:, 0])))
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return small, points * (small.shape[1] / image.shape[1])


def expressions(models: Path) -> Dict[str, Dict[str, float]]:
    """Return what is told of the faces of expressions.txt, each picture looked at as a film of 1.5 s.

    `expression`: precision of what is told and the share of which something is told, on the half that nothing was
    tuned on; `tuned`: the same of the other half.
    """
    labels = read_labels(EXPRESSIONS)
    stage = FacePipeline(FACES.resolve({"age_gender": False, "recognition": False}))
    told: Dict[LabelledFace, Optional[str]] = {}
    for group, image in images(labels, models):
        camera = _photograph_camera(image)
        stage.reset()
        faces: List[FaceObservation] = []
        latest: Dict[str, Optional[str]] = {}
        for index in range(15):
            faces = stage.update(image, camera, 1000.0 + 0.1 * index, None, FaceDemand.everything(stage.tracked_ids))
            latest.update(expressions_told(faces))
        boxes = np.array([face.box for face in faces]).reshape(-1, 4)
        for label in group:
            row = nearest_face(label, boxes, image.shape)
            told[label] = None if row is None else latest.get(faces[row].id)
    stage.close()
    halves = {"expression": [label for label in labels if not label.file.startswith(TUNING)],
              "tuned": [label for label in labels if label.file.startswith(TUNING)]}
    return {name: _told(half, told) for name, half in halves.items()}


def expressions_told(faces: Sequence[FaceObservation]) -> Dict[str, Optional[str]]:
    """Return what an image says of the expression of each face, by id, None: nothing. Of a face that was not measured
    in it, which the next images do, it does not speak: what was told before stands."""
    return {face.id: None if face.expression is None else face.expression.category for face in faces if face.measured}


def _told(labels: Sequence[LabelledFace], told: Mapping[LabelledFace, Optional[str]]) -> Dict[str, float]:
    answers = [(told[label], label.label) for label in labels if told[label] is not None]
    right = sum(answer == label for answer, label in answers)
    return {"precision": right / max(1, len(answers)), "told": len(answers) / max(1, len(labels)),
            "right": right, "faces": len(labels)}


def read_image(path: Path) -> np.ndarray:
    """Return a picture (H, W, 3) of the models' directory. Raises FileNotFoundError, which tells how to get it."""
    image = cv2.imread(str(path))
    if image is None:
        raise FileNotFoundError("{} is absent; get it with `rosrun hri_pipeline fetch_models --models"
                                " demo,evaluation`".format(path))
    return image


YAW, PITCH, ROLL = 60.0, 30.0, 45.0
"""Largest angles, degrees."""
NEAREST, FARTHEST = 0.5, 2.0
"""Distance, m."""
_UPRIGHT = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
"""Axes of a face frame that looks into the camera, in the optical frame."""


def head_poses(count: int, random: np.random.RandomState) -> List[Pose]:
    """Return face frames in the optical frame, evenly spread over the angles and distances above."""
    poses = []
    for _ in range(count):
        yaw, pitch, roll = (random.uniform(-limit, limit) for limit in (YAW, PITCH, ROLL))
        turn = Rotation.from_euler("zyx", [roll, -yaw, -pitch], degrees=True).as_matrix()
        distance = random.uniform(NEAREST, FARTHEST)
        place = distance * np.array([random.uniform(-0.35, 0.35), random.uniform(-0.15, 0.15), 1.0])
        poses.append(Pose(turn @ _UPRIGHT, place))
    return poses


def meshes_of(face: CanonicalFace, poses: Sequence[Pose], camera: CameraModel, noise_px: float,
              random: np.random.RandomState) -> List[np.ndarray]:
    """Return meshes (478, 3) px of heads of these poses with normal noise on x and y; irises and depths are 0."""
    to_model = face.face_frame().inverse()
    meshes = []
    for pose in poses:
        mesh = np.zeros((478, 3))
        mesh[:VERTICES, :2] = camera.project(pose.compose(to_model).apply(face.vertices))
        mesh[:VERTICES, :2] += random.normal(0.0, noise_px, (VERTICES, 2))
        meshes.append(mesh)
    return meshes
