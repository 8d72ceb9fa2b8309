"""Measures of the eyes in a face mesh: how far open, how large the irises, where the lines of sight go.

Eyeball constants: fitted on 36 open-eyed faces of portraits, most of which look at the camera. The eyes then disagree by
7.0 degrees and the mean of both is 4.5 degrees off the camera (medians); with an eyeball of 12 mm radius 7.5 mm behind
the corners it is 6.7 and 9.1. They belong to the points of `head_pose`: others need other constants. Eyelid aspect ratio: Soukupova and Cech, "Real-time eye blink
detection using facial landmarks" (2016). Visible iris: 11.7 mm across in adults, standard deviation 0.5 mm
(Ruefer, Schroeder, Erb, Cornea 24, 2005).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces.canonical_face import CanonicalFace
from hri_pipeline.core.geometry import Pose

RIGHT, LEFT = 0, 1
"""The subject's right and left eye; place in the arrays below."""
CORNERS = np.array([[33, 133], [263, 362]])
"""(2, 2) outer and inner corner."""
_USED = np.array([33, 263, 133, 362, 160, 158, 387, 385, 144, 153, 373, 380, 468, 473,
                  469, 470, 471, 472, 474, 475, 476, 477])
"""Vertices that the measures need: corners outer and inner, upper and lower lids, centres and rims of the irises."""
_OUTER, _INNER, _UPPER, _LOWER = slice(0, 2), slice(2, 4), slice(4, 8), slice(8, 12)
_CENTRES, _RIMS = slice(12, 14), slice(14, 22)
IRIS_DIAMETER = 0.0117
"""m."""
EYE_OUT, EYE_UP, EYE_BACK, EYE_RADIUS = 0.0, 0.002, 0.005, 0.017
"""Centre of the eyeball from the middle of its corners, and its radius, m at the canonical size."""
_PROFILE_COSINE = 0.3


@dataclass(frozen=True)
class EyeMeasures:
    """Measures of the eyes of F faces, the subject's right eye first.

    openness: (F, 2) aspect ratio of the lids, about 0.3 open and under 0.175 closed, without foreshortening;
    visibility: (F, 2) 0 (hidden by the nose) to 1; lines: (F, 2, 3) unit directions in the optical frame; irises: (F, 2)
    diameters, px.
    """

    openness: np.ndarray
    visibility: np.ndarray
    lines: np.ndarray
    irises: np.ndarray


class EyeGeometry:
    """What of the canonical face the measures of the eyes need; all faces of an image are measured in one go."""

    def __init__(self, face: CanonicalFace) -> None:
        inverse = face.face_frame().inverse()
        corners = face.vertices[CORNERS.ravel()].reshape(2, 2, 3)
        in_face = inverse.apply(corners.reshape(-1, 3)).reshape(2, 2, 3)
        self._middles = in_face.mean(axis=1)
        axes = in_face[:, 0] - in_face[:, 1]
        self._axes = axes / _length(axes)[:, None]
        self._frontal = np.sqrt(1.0 - self._axes[:, 0] ** 2)
        shift = np.array([[-EYE_OUT, -EYE_UP, EYE_BACK], [EYE_OUT, -EYE_UP, EYE_BACK]])
        self._centres = inverse.apply(corners.mean(axis=1) + shift)
        normals = np.array([[1.0, -0.5, 0.0], [1.0, 0.5, 0.0]])
        self._normals = normals / _length(normals)[:, None]

    def measure(self, meshes: np.ndarray, rotations: np.ndarray, translations: np.ndarray,
                camera: CameraModel) -> EyeMeasures:
        """Return the measures of F faces.

        meshes: (F, 478, 2 or more) px; rotations: (F, 3, 3), translations: (F, 3) m: face frames in the optical frame at
        the canonical size.
        """
        points = meshes[:, _USED, :2]
        rays = camera.normalise(points.reshape(-1, 2)).reshape(points.shape)
        turned = rotations.transpose(0, 2, 1)
        to_camera = -translations / _length(translations)[:, None]
        facing = ((self._normals @ turned) @ to_camera[..., None])[..., 0]
        visibility = _limited((facing - _PROFILE_COSINE) / 0.4)
        openness = _aspect_ratios(rays) * self._foreshortening(turned, translations, rotations[:, :, 2])
        return EyeMeasures(openness, visibility, self._sight_lines(rays[:, _CENTRES], turned, translations),
                           iris_diameters(points[:, _RIMS]))

    def depth(self, pose: Pose) -> float:
        """Return the mean depth (m) of the middles of both eyes' corners along the optical axis."""
        return float((self._middles @ pose.rotation[2] + pose.translation[2]).mean())

    def _foreshortening(self, turned: np.ndarray, translations: np.ndarray, ups: np.ndarray) -> np.ndarray:
        """(F, 2) how much narrower than high the view of each eye has become, 1 for a head seen from the front."""
        sights = self._middles @ turned + translations[:, None]
        sights /= _length(sights)[..., None]
        along = ((self._axes @ turned) * sights).sum(axis=2)
        up = (sights @ ups[..., None])[..., 0]
        width = np.sqrt(np.maximum(1.0 - along ** 2, 0.0))
        height = np.sqrt(np.maximum(1.0 - up ** 2, 0.09))
        return np.minimum(np.maximum(width / height / self._frontal, 0.2), 2.0)

    def _sight_lines(self, rays: np.ndarray, turned: np.ndarray, translations: np.ndarray) -> np.ndarray:
        """(F, 2, 3) from the centres of the eyeballs to where the rays through the irises meet them."""
        directions = np.concatenate([rays, np.ones(rays.shape[:2] + (1,))], axis=2)
        directions /= _length(directions)[..., None]
        centres = self._centres @ turned + translations[:, None]
        along = (directions * centres).sum(axis=2)
        beneath = along ** 2 - ((centres ** 2).sum(axis=2) - EYE_RADIUS ** 2)
        # A ray that misses the eyeball is taken to touch it: the iris is at its edge.
        iris = directions * (along - np.sqrt(np.maximum(beneath, 0.0)))[..., None]
        lines = iris - centres
        return lines / _length(lines)[..., None]


def _aspect_ratios(rays: np.ndarray) -> np.ndarray:
    """(F, 2) height over width of the lids, of rays (F, U, 2) of the points _USED."""
    width = _length(rays[:, _OUTER] - rays[:, _INNER])
    heights = _length(rays[:, _UPPER] - rays[:, _LOWER]).reshape(len(rays), 2, 2).sum(axis=2) / 2.0
    return heights / np.maximum(width, 1e-9)


def _length(vectors: np.ndarray) -> np.ndarray:
    return np.sqrt((vectors * vectors).sum(axis=-1))


def _limited(values: np.ndarray) -> np.ndarray:
    return np.minimum(np.maximum(values, 0.0), 1.0)


def iris_diameters(rims: np.ndarray) -> np.ndarray:
    """Return the larger diameter of each iris, (F, 2) px, of points on their rims (F, 8, 2): a turned head narrows the
    other one."""
    points = rims.reshape(len(rims), 2, 4, 2)
    return np.maximum(_length(points[:, :, 0] - points[:, :, 2]), _length(points[:, :, 1] - points[:, :, 3]))
