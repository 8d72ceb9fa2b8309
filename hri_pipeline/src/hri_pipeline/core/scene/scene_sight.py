"""Who can be seen from the robot's camera: field of view, distance, and who hides whom."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Set

import numpy as np

from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.scene.scene_projection import HIP_HEIGHT
from hri_pipeline.core.scene.scene_world import SceneTruth

NEAREST = 0.3
"""Distance (m) below which nothing is found."""
_HEAD_COVER, _BODY_COVER = 0.14, 0.16
"""Half widths (m) of somebody in front: the line of sight to a head that passes closer to the axis of the body is hidden;
half of a trunk is hidden when the line to its middle is."""
_TOP = 1.06     # top of the head in heights of the eyes


class CameraSight:
    """The view at one moment. height: of the camera, m."""

    def __init__(self, truth: SceneTruth, settings: SimpleNamespace, height: float) -> None:
        x, y, yaw = truth.robot
        self.camera = camera_pose(x, y, yaw, height)
        self._people, self._settings = truth.people, settings
        self._wide = math.tan(math.radians(settings.sense_hfov) / 2.0)
        self._tall = self._wide * settings.height / settings.width
        count = len(truth.people)
        self._floor = np.array([person.position for person in truth.people]).reshape(count, 2)
        self._heads = np.array([person.head for person in truth.people]).reshape(count, 3)

    def optical(self, position: np.ndarray, rotation: np.ndarray) -> Pose:
        """A pose in `map` seen in the optical frame."""
        turn = self.camera.rotation.T
        return Pose(turn @ rotation, turn @ (position - self.camera.translation))

    def faces(self) -> Set[str]:
        """People whose faces can be found."""
        seen = self._in_view(self._heads, self._settings.sense_face_range, self._tall)
        angle = math.cos(math.radians(self._settings.sense_face_angle))
        for index in np.flatnonzero(seen):
            towards = self.camera.translation - self._heads[index]
            facing = float(self._people[index].head_rotation[:, 0] @ towards) / float(np.linalg.norm(towards))
            seen[index] = facing > angle and not self._hidden(index, self._heads[index], _HEAD_COVER)
        return {self._people[index].id for index in np.flatnonzero(seen)}

    def bodies(self) -> Set[str]:
        """People whose bodies can be found; one that is cut by the upper or lower border of the image can."""
        if not len(self._people):
            return set()
        hips = np.column_stack([self._floor, [HIP_HEIGHT * person.stature for person in self._people]])
        chests = np.column_stack([self._floor, 0.8 * self._heads[:, 2]])
        seen = self._in_view(hips, self._settings.sense_range, math.inf)
        for index in np.flatnonzero(seen):
            seen[index] = not self._hidden(index, chests[index], _BODY_COVER)
        return {self._people[index].id for index in np.flatnonzero(seen)}

    def _in_view(self, points: np.ndarray, most: float, tall: float) -> np.ndarray:
        """(N,) which points (N, 3) in `map` are in the image and near enough."""
        seen = (points - self.camera.translation) @ self.camera.rotation
        depth = np.maximum(seen[:, 2], 1e-6)
        return ((seen[:, 2] > NEAREST) & (np.abs(seen[:, 0]) < self._wide * depth) & (np.abs(seen[:, 1]) < tall * depth)
                & (np.linalg.norm(seen, axis=1) < most))

    def _hidden(self, index: int, point: np.ndarray, cover: float) -> bool:
        """Tell whether somebody stands between the camera and a point (3,) of person `index`."""
        if not self._settings.sense_occlusion:
            return False
        eye = self.camera.translation
        line = point - eye
        length = math.hypot(line[0], line[1])
        if length < 1e-6:
            return False
        offsets = self._floor - eye[:2]
        along = (offsets @ line[:2]) / length
        aside = np.abs(offsets[:, 0] * line[1] - offsets[:, 1] * line[0]) / length
        height = eye[2] + line[2] * along / length
        covered = (along > 0.1) & (along < length - 0.25) & (aside < cover) & (height < _TOP * self._heads[:, 2])
        covered[index] = False
        return bool(covered.any())


def camera_pose(x: float, y: float, yaw: float, height: float) -> Pose:
    """Optical frame (x right, y down, z forward) in `map` of a level camera above the robot."""
    cosine, sine = math.cos(yaw), math.sin(yaw)
    return Pose(np.array([[sine, 0.0, cosine], [-cosine, 0.0, sine], [0.0, -1.0, 0.0]]), np.array([x, y, height]))
