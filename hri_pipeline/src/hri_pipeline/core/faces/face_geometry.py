"""Pose, size and gaze of every tracked face, from its mesh and over time."""

from __future__ import annotations

from typing import Collection, Dict, List, Optional, Sequence, Tuple

import numpy as np

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces.canonical_face import CanonicalFace
from hri_pipeline.core.faces.eyes import EyeGeometry
from hri_pipeline.core.faces.face_finder import FaceSighting
from hri_pipeline.core.faces.face_landmarks import landmarks_from_mesh
from hri_pipeline.core.faces.gaze import GazeEstimator, GazeFilter
from hri_pipeline.core.faces.head_pose import HeadPoseEstimator, PoseSmoother
from hri_pipeline.core.faces.head_scale import HeadScale, scale_from_depth, scale_from_iris, scale_from_stature
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.observations import FaceObservation, GazeEstimate

_SKIN = np.array([1, 4, 5, 6, 9, 151, 195, 197, 50, 280, 101, 330, 36, 266, 117, 346, 107, 336, 8, 168])
"""Vertices of nose, cheeks and forehead, where a depth image sees skin and neither hair nor background."""


class _Face:
    """What is remembered of one face."""

    def __init__(self) -> None:
        self.smoother = PoseSmoother()
        self.gaze_filter = GazeFilter()
        self.scale = HeadScale()
        self.raw: Optional[Pose] = None
        self.pose: Optional[Pose] = None
        self.gaze: Optional[GazeEstimate] = None
        self.mesh: Optional[np.ndarray] = None

    def take_pose(self, pose: Optional[Pose], mesh: np.ndarray, stamp: float) -> None:
        """Take what was found in the image of `stamp` (s)."""
        self.raw, self.mesh = pose, mesh
        if pose is None:
            self.smoother.reset()
            self.pose = self.gaze = None
        else:
            self.pose = self.smoother(pose, stamp)


class FaceGeometry:
    """Turns sightings into observations with pose, gaze and size of the head; all poses of an image in one go."""

    def __init__(self, canonical: CanonicalFace) -> None:
        self._canonical = canonical
        self._to_face = canonical.face_frame().inverse()
        self._heads = HeadPoseEstimator(canonical)
        self._eyes = EyeGeometry(canonical)
        self._gazes = GazeEstimator(self._eyes)
        self._faces: Dict[str, _Face] = {}

    def keep(self, ids: Collection[str]) -> None:
        """Forget all faces but these."""
        self._faces = {face_id: face for face_id, face in self._faces.items() if face_id in ids}

    def reset(self) -> None:
        """Forget all faces."""
        self._faces = {}

    def set_stature(self, face_id: str, stature: float) -> None:
        """Take the stature (m) of a face's person, known from elsewhere; an unknown face or nonsense is ignored."""
        if face_id in self._faces and np.isfinite(stature) and 0.4 < stature < 2.6:
            self._faces[face_id].scale.add("stature", scale_from_stature(stature))

    def observe(self, sightings: Sequence[FaceSighting], camera: CameraModel, stamp: float,
                depth: Optional[np.ndarray] = None) -> List[FaceObservation]:
        """Return one observation per sighting, in order.

        camera: of the image's size; stamp: s; depth: (H, W) m registered with the image, 0 or NaN unknown.
        """
        for sighting in sightings:
            self._faces.setdefault(sighting.id, _Face())
        self._measure([sighting for sighting in sightings if sighting.measured], camera, stamp, depth)
        return [self._observation(sighting, camera, stamp) for sighting in sightings]

    def _measure(self, sightings: Sequence[FaceSighting], camera: CameraModel, stamp: float,
                 depth: Optional[np.ndarray]) -> None:
        faces = [self._faces[sighting.id] for sighting in sightings]
        starts = [face.raw for face in faces]
        # A new face has no start; it must not slow the others down.
        fresh = [index for index, start in enumerate(starts) if start is None]
        known = [index for index, start in enumerate(starts) if start is not None]
        for group in (known, fresh):
            poses = self._heads.estimate_all([sightings[index].mesh for index in group], camera,
                                             [starts[index] for index in group])
            for index, pose in zip(group, poses):
                if pose is None and starts[index] is not None:
                    pose = self._heads.estimate(sightings[index].mesh, camera)
                faces[index].take_pose(pose, sightings[index].mesh, stamp)
        self._look([(face, sighting) for face, sighting in zip(faces, sightings) if face.raw is not None], camera,
                   stamp, depth)

    def _look(self, posed: Sequence[Tuple[_Face, FaceSighting]], camera: CameraModel, stamp: float,
              depth: Optional[np.ndarray]) -> None:
        """Gaze and size of the faces that have a pose."""
        gazes, irises = self._gazes.estimate_all(
            [sighting.mesh for _, sighting in posed], [face.raw for face, _ in posed], camera,
            [sighting.presence for _, sighting in posed])
        focal = float(camera.matrix[0, 0])
        for (face, sighting), gaze, diameters in zip(posed, gazes, irises):
            face.gaze = face.gaze_filter(gaze, stamp)
            from_eyes = 0.0 if face.gaze_filter.is_closed else gaze.from_eyes
            for source, scale in (("iris", scale_from_iris(diameters, face.raw, self._eyes, focal, from_eyes)),
                                  ("depth", self._depth_scale(sighting.mesh, face.raw, depth))):
                if scale is not None:
                    face.scale.add(source, scale)

    def _depth_scale(self, mesh: np.ndarray, pose: Pose, depth: Optional[np.ndarray]) -> Optional[float]:
        if depth is None:
            return None
        model = pose.compose(self._to_face)
        return scale_from_depth(mesh, model.apply(self._canonical.vertices[_SKIN])[:, 2], _SKIN, depth)

    def _observation(self, sighting: FaceSighting, camera: CameraModel, stamp: float) -> FaceObservation:
        face = self._faces[sighting.id]
        landmarks = landmarks_from_mesh(sighting.mesh, sighting.presence, camera.width, camera.height,
                                        self._heads.visibility(face.pose))
        pose, scale, scale_sd = self._placed(face, sighting, camera, stamp)
        gaze = face.gaze
        if gaze is not None and not sighting.measured:
            gaze = GazeEstimate(gaze.direction, gaze.confidence * sighting.presence, gaze.eyes_closed, gaze.from_eyes)
        return FaceObservation(sighting.id, sighting.box, sighting.presence, landmarks, sighting.mesh, pose, gaze,
                               head_scale=scale, head_scale_sd=scale_sd, measured=sighting.measured)

    @staticmethod
    def _placed(face: _Face, sighting: FaceSighting, camera: CameraModel, stamp: float
                ) -> Tuple[Optional[Pose], Optional[float], Optional[float]]:
        """The pose at the size of this head, moved along for a face that was not looked at."""
        if face.pose is None or face.mesh is None:
            return None, None, None
        scale, scale_sd = face.scale.estimate(stamp)
        translation = face.pose.translation.copy()
        if not sighting.measured:
            shift = (sighting.mesh - face.mesh)[0, :2]
            translation[:2] += shift * translation[2] / np.array([camera.matrix[0, 0], camera.matrix[1, 1]])
        return Pose(face.pose.rotation, scale * translation), scale, scale_sd
