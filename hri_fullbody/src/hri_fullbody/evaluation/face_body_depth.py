"""How far away a face and its body are found, one against the other, on photographs."""

from __future__ import annotations

from pathlib import Path
from typing import List

import numpy as np

from hri_fullbody.core.body_parameters import VISION
from hri_fullbody.core.body_stage import BodyStage
from hri_fullbody.core.sight.body_windows import FaceBox
from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces.face_stage import FaceStage
from hri_pipeline.core.observations import FaceObservation
from hri_pipeline.evaluation.face_figures import GEOMETRY_ONLY, PHOTOGRAPH_HFOV, read_image


def face_body_depth_ratio_median(models: Path) -> float:
    """Return the median of the distance of a face over that of the nose of its body, found without the face's pose.

    models: the directory of the models. Raises RuntimeError when no face and body were found together.
    """
    settings = VISION.resolve(GEOMETRY_ONLY)
    stages = FaceStage(settings), BodyStage(settings)
    ratios: List[float] = []
    for number in range(1, 7):
        image = read_image(models / "demo" / "sample{}.jpg".format(number))
        camera = CameraModel.from_fov(image.shape[1], image.shape[0], PHOTOGRAPH_HFOV)
        faces, bodies = [], []
        for stage in stages:
            stage.reset()
        for index in range(14):
            stamp = 1000.0 + 0.1 * index
            faces = stages[0].update(image, camera, stamp)
            boxes = [FaceBox.from_landmarks(face.id, face.landmarks) for face in faces]
            bodies = stages[1].update(image, camera, stamp, boxes)
        ratios += _depth_ratios(faces, bodies)
    if not ratios:
        raise RuntimeError("no face and body were found together")
    return float(np.median(ratios))


def _depth_ratios(faces: List[FaceObservation], bodies: list) -> List[float]:
    """Distance of each face over that of the body whose nose is nearest to its own, within a face's size."""
    ratios = []
    for face in faces:
        if face.pose is None or not bodies:
            continue
        apart = [float(np.linalg.norm(body.keypoints[0, :2] - face.landmarks[30, :2])) for body in bodies]
        body = bodies[int(np.argmin(apart))]
        depth = float(body.keypoints_3d[0, 2])
        if min(apart) < 0.3 * float(face.box[3] - face.box[1]) and np.isfinite(depth) and depth > 0.0:
            ratios.append(float(face.pose.translation[2]) / depth)
    return ratios
