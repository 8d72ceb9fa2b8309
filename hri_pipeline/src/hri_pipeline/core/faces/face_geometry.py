"""Where the head of every tracked face is, how large it is, and where its eyes look, over time.

All faces of an image are solved together: head pose (`head_pose`), gaze (`gaze`), and the size of the head from irises
and depth image.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Collection, Dict, List, Optional, Sequence, Tuple

import numpy as np

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces.crops import DarkGlasses
from hri_pipeline.core.faces.gaze import EyeGeometry, GazeEstimator, GazeSmoother
from hri_pipeline.core.faces.head_pose import (
    HeadPoseEstimator,
    HeadScale,
    PoseSmoother,
    scale_from_depth,
    scale_from_iris,
)
from hri_pipeline.core.faces.mesh import Blendshapes, CanonicalFace, landmarks_from_meshes
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.image_rotation import ImageRotation
from hri_pipeline.core.observations import FaceObservation, GazeEstimate

_SHAPES_AGE = 0.4
"""Time (s) for which blendshapes of open eyes are used again: half a millisecond for each face."""
_SKIN = np.array([1, 4, 5, 6, 9, 151, 195, 197, 50, 280, 101, 330, 36, 266, 117, 346, 107, 336, 8, 168])
"""Vertices of nose, cheeks and forehead, where a depth image sees skin and neither hair nor background."""


@dataclass(frozen=True)
class TrackedFace:
    """A tracked face in one image.

    mesh: (478, 3) px; box: (4,) px; presence: probability 0 to 1; measured: False when the mesh network did not run on
    it in this image and its last mesh was moved by the predicted motion; confirmed: it may be published.
    """

    id: str
    mesh: np.ndarray
    box: np.ndarray
    presence: float
    measured: bool
    confirmed: bool


class FaceGeometry:
    """Head pose, gaze and head size of every tracked face, over time; all faces of an image are solved together."""

    def __init__(self, canonical: CanonicalFace, blendshapes: Blendshapes) -> None:
        self._canonical = canonical
        self._blendshapes = blendshapes
        self._to_face = canonical.face_frame().inverse()
        self._heads = HeadPoseEstimator(canonical)
        self._eyes = EyeGeometry(canonical)
        self._gazes = GazeEstimator(self._eyes)
        self._faces: Dict[str, _Face] = {}

    def keep(self, ids: Collection[str]) -> None:
        """Forget all faces but these."""
        self._faces = {face_id: face for face_id, face in self._faces.items() if face_id in ids}

    def turn(self, rotation: ImageRotation) -> None:
        """Turn all faces with the images."""
        for face in self._faces.values():
            face.turn(rotation)

    def reset(self) -> None:
        """Forget all faces."""
        self._faces = {}

    def observe(self, tracked: Sequence[TrackedFace], camera: CameraModel, stamp: float,
                depth: Optional[np.ndarray] = None, bgr: Optional[np.ndarray] = None) -> List[FaceObservation]:
        """Return one observation per tracked face, in order.

        camera: of the image's size; stamp: s; depth: (h, w) m registered with the image, 0 or NaN unknown; bgr: the
        image (H, W, 3) uint8, by which dark glasses are noticed.
        """
        for found in tracked:
            if found.id not in self._faces:
                self._faces[found.id] = _Face()
        self._measure([found for found in tracked if found.measured], camera, stamp, depth, bgr)
        landmarks = landmarks_from_meshes(
            [found.mesh for found in tracked], [found.presence for found in tracked], camera.width, camera.height,
            [self._visibility(self._faces[found.id]) for found in tracked])
        return [self._observation(found, points, motion, stamp)
                for found, points, motion in zip(tracked, landmarks, self._motions(tracked, camera))]

    def _visibility(self, face: _Face) -> np.ndarray:
        """How well each landmark (70,) is seen; computed once for each pose."""
        if face.visibility is None:
            face.visibility = self._heads.visibility(face.pose)
        return face.visibility

    def _motions(self, tracked: Sequence[TrackedFace], camera: CameraModel) -> List[Optional[np.ndarray]]:
        """How far (2,), in x/z and y/z, the mesh of each face has been moved since its measurement; None where it was
        measured, or has no pose."""
        result: List[Optional[np.ndarray]] = [None] * len(tracked)
        moved, places = [], []
        for index, found in enumerate(tracked):
            face = self._faces[found.id]
            if not found.measured and face.pose is not None and face.mesh is not None:
                moved.append(index)
                places += [face.mesh[0, :2], found.mesh[0, :2]]
        if moved:
            rays = camera.normalise(np.array(places))
            for index, motion in zip(moved, rays[1::2] - rays[::2]):
                result[index] = motion
        return result

    def _measure(self, tracked: Sequence[TrackedFace], camera: CameraModel, stamp: float,
                 depth: Optional[np.ndarray], bgr: Optional[np.ndarray]) -> None:
        faces = [self._faces[found.id] for found in tracked]
        starts = [face.raw for face in faces]
        # A new face has no start value; alone it would make the others iterate longer, too.
        fresh = [index for index, start in enumerate(starts) if start is None]
        known = [index for index, start in enumerate(starts) if start is not None]
        for group in (known, fresh):
            poses = self._heads.estimate_all([tracked[index].mesh for index in group], camera,
                                             [starts[index] for index in group])
            for index, pose in zip(group, poses):
                if pose is None and starts[index] is not None:
                    pose = self._heads.estimate(tracked[index].mesh, camera)
                faces[index].set_pose(pose, tracked[index].mesh, stamp)
                if bgr is not None and pose is not None:
                    faces[index].glasses.update(bgr, tracked[index].mesh, pose, stamp, camera)
        posed = [(face, found, face.raw) for face, found in zip(faces, tracked) if face.raw is not None]
        self._measure_eyes(posed, camera, stamp, depth)

    def _measure_eyes(self, posed: Sequence[Tuple[_Face, TrackedFace, Pose]], camera: CameraModel, stamp: float,
                      depth: Optional[np.ndarray]) -> None:
        """Measure gaze and head size of the faces that have a pose."""
        gazes, eyes = self._gazes.estimate_all(
            [found.mesh for _, found, _ in posed], [pose for _, _, pose in posed], camera,
            [found.presence for _, found, _ in posed], lambda needed: self._shapes(posed, needed, camera, stamp),
            [face.glasses.are_worn for face, _, _ in posed])
        for (face, found, pose), gaze, diameters, angles in zip(posed, gazes, eyes.irises, eyes.iris_angles):
            face.gaze = face.gaze_smoother(gaze, stamp)
            from_eyes = 0.0 if face.gaze_smoother.is_closed else gaze.from_eyes
            for source, scale in (("iris", scale_from_iris(diameters, angles, pose, self._eyes, from_eyes)),
                                  ("depth", self._depth_scale(found.mesh, pose, camera, depth))):
                if scale is not None:
                    face.scale.add(source, scale)

    def _shapes(self, posed: Sequence[Tuple[_Face, TrackedFace, Pose]], needed: np.ndarray,
                camera: CameraModel, stamp: float) -> np.ndarray:
        """Blendshapes (F, 52): fresh ones where they are needed, else those of a moment ago."""
        due = [(face, found.mesh) for (face, found, _), need in zip(posed, needed.tolist())
               if need or face.blendshapes is None or not 0.0 <= stamp - face.shaped_at < _SHAPES_AGE]
        for (face, _), face_shapes in zip(due, self._blendshapes.run([mesh for _, mesh in due], camera)):
            face.blendshapes, face.shaped_at = face_shapes, stamp
        return np.stack([face.blendshapes for face, _, _ in posed if face.blendshapes is not None])

    def _depth_scale(self, mesh: np.ndarray, pose: Pose, camera: CameraModel,
                     depth: Optional[np.ndarray]) -> Optional[float]:
        if depth is None:
            return None
        model = pose.compose(self._to_face)
        return scale_from_depth(mesh, model.apply(self._canonical.vertices[_SKIN])[:, 2], _SKIN, depth,
                                (camera.width, camera.height))

    def _observation(self, found: TrackedFace, landmarks: np.ndarray, motion: Optional[np.ndarray],
                     stamp: float) -> FaceObservation:
        face = self._faces[found.id]
        pose, scale, scale_sd = self._placed(face, motion, stamp)
        gaze = face.gaze
        if gaze is not None and not found.measured:
            gaze = replace(gaze, confidence=gaze.confidence * found.presence)
        if gaze is not None and gaze.direction is not None and gaze.from_eyes == 0.0 and pose is not None:
            # Exactly the head's, so that nobody takes it for that of the eyes.
            gaze = replace(gaze, direction=pose.rotation[:, 0])
        return FaceObservation(found.id, found.box, found.presence, landmarks, found.mesh, pose, gaze,
                               head_scale=scale, head_scale_sd=scale_sd, dark_glasses=face.glasses.are_worn,
                               measured=found.measured)

    @staticmethod
    def _placed(face: _Face, motion: Optional[np.ndarray], stamp: float
                ) -> Tuple[Optional[Pose], Optional[float], Optional[float]]:
        """Pose, head scale and its standard deviation; the pose is moved with the mesh of a face that was not
        measured."""
        if face.pose is None or face.mesh is None:
            return None, None, None
        scale, scale_sd = face.scale.estimate(stamp)
        translation = face.pose.translation.copy()
        if motion is not None:
            translation[:2] += motion * translation[2]
        return Pose(face.pose.rotation, scale * translation), scale, scale_sd


class _Face:
    """State of one face: filters and last measurements."""

    def __init__(self) -> None:
        self.smoother = PoseSmoother()
        self.gaze_smoother = GazeSmoother()
        self.scale = HeadScale()
        self.glasses = DarkGlasses()
        self.raw: Optional[Pose] = None
        self.pose: Optional[Pose] = None
        self.visibility: Optional[np.ndarray] = None        # of the landmarks, by the pose
        self.gaze: Optional[GazeEstimate] = None
        self.mesh: Optional[np.ndarray] = None
        self.blendshapes: Optional[np.ndarray] = None
        self.shaped_at = -math.inf

    def turn(self, rotation: ImageRotation) -> None:
        """Turn with the images; the filters begin with the next measurement."""
        self.smoother.reset()
        self.visibility = None
        self.gaze_smoother.forget_direction()
        self.raw, self.pose = (None if pose is None else rotation.pose(pose) for pose in (self.raw, self.pose))
        self.mesh = None if self.mesh is None else rotation.pixels(self.mesh)
        if self.gaze is not None and self.gaze.direction is not None:
            self.gaze = replace(self.gaze, direction=rotation.vectors(self.gaze.direction))

    def set_pose(self, pose: Optional[Pose], mesh: np.ndarray, stamp: float) -> None:
        """Set the pose measured in the image of `stamp` (s), None for no plausible one."""
        self.raw, self.mesh, self.visibility = pose, mesh, None
        if pose is None:
            self.smoother.reset()
            self.pose = self.gaze = None
        else:
            self.pose = self.smoother(pose, stamp)
