"""Gaze direction and eye closure of a face, from irises, eyelids, blendshapes and the head pose together.

The irises are more accurate than the head while they are large enough to be measured; below that the direction is the
head's, with a lower confidence. While the eyes are closed there is no direction. Eyes are closed for their own person:
the opening of the lids and the blink coefficients of the blendshapes are compared with what they usually are
(`OpenEyeBaseline`). As long as that is not known, they are those of most people, so that narrow eyes, eyes that look
down and small faces are open unless they are clearly shut.

Eyeball constants: fitted on 36 open-eyed faces of portraits, most of which look at the camera. The two eyes then
disagree by 7.0 degrees and the mean of both is 4.5 degrees off the camera (medians); with an eyeball of 12 mm radius
7.5 mm behind the corners it is 6.7 and 9.1. They belong to the points of `head_pose`: others need other constants.
Eyelid aspect ratio: Soukupova and Cech, "Real-time eye blink detection using facial landmarks" (2016). Visible iris:
11.7 mm across in adults, standard deviation 0.5 mm (Ruefer, Schroeder, Erb, Cornea 24, 2005).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Callable, List, NamedTuple, Optional, Sequence, Tuple, Union

import numpy as np

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces.action_units import RunningNeutral
from hri_pipeline.core.faces.mesh import EYE_BLINK, LOOK_DOWN, LOOK_IN, LOOK_OUT, LOOK_UP, CanonicalFace
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.observations import GazeEstimate
from hri_pipeline.core.one_euro import OneEuro

USUAL_OPENNESS, USUAL_BLINK = (0.27, 0.05), (0.22, 0.10)
"""Aspect ratio of open lids and their blink coefficient: mean and standard deviation over people and pictures, of the
tuning half of scripts/benchmarks/eyes.txt (see `face_figures.TUNING`)."""
_SHUT_PART, _SHUT_OPENNESS = 0.45, (0.07, 0.15)
"""Lids are shut below this part of their usual opening, within these limits of the ratio."""
_SHUT_BLINK, _BLINK_LIMITS = 0.76, (0.47, 0.60)
"""Blink coefficient of shut eyes; the limit lies half way from the usual one to it, within these limits."""
_DOWN_OPENNESS, _DOWN_BLINK = 0.2, 0.04
"""Lids that follow a gaze straight down: narrower by this part, blink coefficient higher by this."""
_OPENNESS_WIDTH, _BLINK_WIDTH, _SHARED = 0.02, 0.04, 1.5
"""Change of ratio and of coefficient that makes the odds of closed e times as large: their noise; and by how much both
together are surer than they should be, as they come from the same points."""
_MORE_CLOSED = 0.75
"""Weight of the eye that looks more closed: hair over one eye makes it look open, and little makes an open one look
shut; a wink is as short as a blink."""
_WIDE_OPEN = 0.2
"""Aspect ratio of both lids from which no eye is shut, whoever's it is: blendshapes of a moment ago will do."""
_LEVEL, _CLEARLY_OPEN = 0.4, 0.25
"""What is usual for somebody's eyes is learnt from images in which the eyes look less down than this (coefficient), and
whose closedness, by what is usual for most people, is below this."""
_UNKNOWN = 0.3
"""Closedness of eyes of which nothing is known, as of a face too small for them: open, below OPEN."""
CLOSED, OPEN = 0.65, 0.35
"""Smoothed closedness from which the eyes are closed, and below which they are open again."""
_CLOSED_TIME = 0.06
"""Time constant (s) of the closedness: shorter than a blink (0.1 to 0.3 s), longer than one image's noise."""
LEAST_IRIS, GOOD_IRIS = np.array([2.4, 3.0]), np.array([4.5, 7.0])
"""Diameter (px) of the iris up to which it is not used, and from which the head pose is not used, to the sides, and up
or down. Pictures made smaller, blurred, noisy and compressed: at 2.6 px (a face of 30 px) the turn to the sides is
still the full picture's (slope 0.9), up and down it is not (0.1); at 3.5 px 1.0 and 0.4, at 5.2 px 0.95 and 0.7."""
_IRIS_PART = 0.08
"""Diameter of an iris over the width of its face, 11.7 of 145 mm: that of the mesh of a tiny face is a guess."""
_SHAPE_TURN, _SHAPE_UP = np.deg2rad(25.0), np.deg2rad((30.0, 6.0))
"""Turn (rad) of eyes in the head by the blendshapes: to the side per unit; up per unit, and of eyes straight ahead."""
_SECOND_OPINION, _BESIDE_IRISES, _BESIDE_ONE_IRIS = 0.5, 0.2, 0.5
"""Weight of that where the irises have none, beside the head: its error is twice that of the irises; beside both
irises, and more of it the less of the far eye is seen: one iris alone, from the side, errs by 10 degrees."""
MAX_AWAY = np.deg2rad((40.0, 30.0))
"""Largest turn (rad) of eyes in the head, to the sides and up or down (Stahl 1999: people turn the head before)."""
_AGREE, _DISAGREE = np.deg2rad(8.0), np.deg2rad(25.0)
"""Angle (rad) between the two eyes' directions up to which they agree, and from which they are not used; beside the
angle by which they converge on something as near as the camera."""
_BETWEEN_EYES = 0.063
"""m; mean distance of the pupils of adults (Dodgson, Proc. SPIE 5291, 2004)."""
HEAD_CONFIDENCE, EYES_CONFIDENCE = 0.4, 0.9
_LEAST_FACE, _GOOD_FACE = 20.0, 50.0
"""Width (px) of a face below which its eyelids are not used, and from which they have full weight."""
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


class GazeEstimator:
    """Gaze of one image; holds no state between calls."""

    def __init__(self, eyes: EyeGeometry) -> None:
        self._eyes = eyes

    def estimate(self, mesh: np.ndarray, pose: Pose, camera: CameraModel, presence: float = 1.0,
                 shapes: Optional[np.ndarray] = None) -> GazeEstimate:
        """Return the gaze of one face, see `estimate_all`; shapes: (52,)."""
        return self.estimate_all([mesh], [pose], camera, [presence], None if shapes is None else shapes[None])[0][0]

    def estimate_all(self, meshes: Sequence[np.ndarray], poses: Sequence[Pose], camera: CameraModel,
                     presences: Sequence[float],
                     shapes: Union[np.ndarray, Callable[[np.ndarray], np.ndarray], None] = None,
                     hidden: Optional[Sequence[bool]] = None) -> Tuple[List[GazeEstimate], EyeMeasures]:
        """Return direction and eye closure of each face, and what they were measured by.

        There is a direction for closed eyes too (`GazeSmoother` withholds it).

        Parameters
        ----------
        meshes
            (478, 2 or more) px each.
        poses
            Face frames in the optical frame at the canonical size.
        camera
            Camera model of the image's size.
        presences
            Probability 0 to 1 of each face.
        shapes
            (F, 52) blendshapes, or what gives them, called with (F,) bool: whose eyes may be shut, so that fresh ones
            are needed. None: the lids are judged by their opening alone.
        hidden
            Of each face, whether nothing is seen of its eyes though they are in the image (dark glasses): what the
            mesh says of them is a guess then, and they count as those of a face too small for them. None: of none.
        """
        if not len(meshes):
            nothing = np.zeros((0, 2))
            return [], EyeMeasures(nothing, nothing, np.zeros((0, 2, 3)), nothing, nothing)
        stack = np.stack([np.asarray(mesh, dtype=np.float64)[:, :2] for mesh in meshes])
        rotations = np.stack([pose.rotation for pose in poses])
        places = np.stack([pose.translation for pose in poses])
        measures = self._eyes.measure(stack, rotations, places, camera)
        widths = stack[..., 0].max(axis=1) - stack[..., 0].min(axis=1)
        covered = np.zeros(len(stack), dtype=bool) if hidden is None else np.asarray(hidden, dtype=bool)
        if callable(shapes):
            openness = np.where(measures.visibility > 0.3, measures.openness, np.inf).min(axis=1)
            shapes = shapes(~(covered | ((openness > _WIDE_OPEN) & np.isfinite(openness))))
        widths = np.where(covered, 0.0, widths)
        lids = _lids(measures, widths, shapes)
        directions, iris_weights = _directions(measures, rotations, _length(places), widths, shapes)
        gazes = []
        for index, presence in enumerate(presences):
            confidence = HEAD_CONFIDENCE + iris_weights[index] * (EYES_CONFIDENCE - HEAD_CONFIDENCE)
            gazes.append(GazeEstimate(directions[index], float(confidence * presence), closedness(lids[index]),
                                      float(iris_weights[index]), lids[index]))
        return gazes, measures


class Eyelids(NamedTuple):
    """What one image says of the lids of a face, the subject's right eye first.

    openness: aspect ratios; blink: coefficients of the blendshapes, None without them; weights: how well each eye is
    seen; down: how far the eyes look down, 0 to 1; known: 0 (a face too small for its lids) to 1.
    """

    openness: Tuple[float, float]
    blink: Optional[Tuple[float, float]]
    weights: Tuple[float, float]
    down: float
    known: float


_ANYBODY = (USUAL_OPENNESS[0], USUAL_OPENNESS[0], USUAL_BLINK[0], USUAL_BLINK[0])


def closedness(lids: Eyelids, usual: Sequence[float] = _ANYBODY) -> float:
    """Return how likely the eyes are closed, 0 to 1, _UNKNOWN when nothing is known.

    usual: aspect ratio of the right and of the left eye while they are open, and their blink coefficients.
    """
    odds = [min(max(_odds(lids, side, usual[side], usual[2 + side]), -30.0), 30.0) for side in (0, 1)]
    more = 0 if odds[0] > odds[1] else 1
    weights = [lids.weights[side] * (_MORE_CLOSED if side == more else 1.0 - _MORE_CLOSED) for side in (0, 1)]
    mean = (weights[0] * odds[0] + weights[1] * odds[1]) / (weights[0] + weights[1])
    if not math.isfinite(mean):
        return _UNKNOWN
    return _UNKNOWN + lids.known * (1.0 / (1.0 + math.exp(-mean)) - _UNKNOWN)


def _odds(lids: Eyelids, side: int, openness: float, blink: float) -> float:
    """Logarithm of the odds that one eye is shut."""
    limit = min(max(_SHUT_PART * openness, _SHUT_OPENNESS[0]), _SHUT_OPENNESS[1]) * (1.0 - _DOWN_OPENNESS * lids.down)
    odds = (limit - lids.openness[side]) / _OPENNESS_WIDTH
    if lids.blink is None:
        return odds
    limit = min(max(0.5 * (blink + _SHUT_BLINK), _BLINK_LIMITS[0]), _BLINK_LIMITS[1]) + _DOWN_BLINK * lids.down
    return (odds + (lids.blink[side] - limit) / _BLINK_WIDTH) / _SHARED


class OpenEyeBaseline:
    """What is usual for the open eyes of one person: learnt while they look ahead or up and are clearly open."""

    def __init__(self) -> None:
        mean, deviation = (np.repeat([USUAL_OPENNESS[column], USUAL_BLINK[column]], 2) for column in (0, 1))
        # Lids are lowered more often than they are wide.
        self._neutral = RunningNeutral(mean, deviation, np.array([0.6, 0.6, 0.4, 0.4]))

    def closedness(self, lids: Eyelids, stamp: float) -> float:
        """Return how likely the eyes are closed at `stamp` (s), 0 to 1, and learn from them when they are open."""
        usual: Sequence[float] = self._neutral.value.tolist()
        if lids.blink is not None and lids.known >= 0.5 and min(lids.weights) > 0.3 and lids.down < _LEVEL:
            if closedness(lids) < _CLEARLY_OPEN:
                self._neutral.add(np.array(lids.openness + lids.blink), stamp)
        return closedness(lids, usual)


def _lids(measures: EyeMeasures, widths: np.ndarray, shapes: Optional[np.ndarray]) -> List[Eyelids]:
    """Lids of each face; in profile only the near eye counts."""
    best = np.maximum(measures.visibility.max(axis=1, keepdims=True), 1e-3)
    # From 30 degrees of yaw on the far eye is seen less than 0.6 as well as the near one.
    weights = np.minimum(np.maximum((measures.visibility / best - 0.6) / 0.3, 1e-3), 1.0).tolist()
    known = np.minimum(np.maximum((widths - _LEAST_FACE) / (_GOOD_FACE - _LEAST_FACE), 0.0), 1.0).tolist()
    blinks: Sequence[Optional[Tuple[float, float]]] = [None] * len(widths)
    if shapes is not None:
        blinks = [(right, left) for right, left in shapes[:, EYE_BLINK].tolist()]
    downs = [0.0] * len(widths) if shapes is None else shapes[:, LOOK_DOWN].mean(axis=1).tolist()
    return [Eyelids(tuple(openness), blink, tuple(weight), down, one) for openness, blink, weight, down, one
            in zip(measures.openness.tolist(), blinks, weights, downs, known)]


def _convergence(lines: np.ndarray, rotations: np.ndarray, distances: np.ndarray) -> np.ndarray:
    """(F,) part of the angle (rad) between the eyes' lines (F, 2, 3) that is due to convergence: at most that on
    something at `distances` (F,) m, and none where they diverge."""
    # Towards the subject's left, in the head.
    sideways = (lines @ rotations)[..., 1]
    inwards = np.nan_to_num(np.arcsin(_limited(sideways[:, RIGHT] - sideways[:, LEFT])))
    return np.minimum(inwards, 2.0 * np.arctan2(0.5 * _BETWEEN_EYES, distances))


def _directions(measures: EyeMeasures, rotations: np.ndarray, distances: np.ndarray, widths: np.ndarray,
                shapes: Optional[np.ndarray]) -> Tuple[np.ndarray, np.ndarray]:
    """(F, 3) directions of the gaze, and (F,) weight of the irises, 0 to 1: 0 is the head alone.

    distances: (F,) m from the camera; widths: (F,) px of the faces.
    """
    # Beyond 40 degrees of yaw the near eye alone.
    seen = _limited((measures.visibility - 0.25) / 0.5)
    lines = measures.lines
    finite = np.isfinite(lines).all(axis=(1, 2))
    mean = (np.nan_to_num(lines) * (seen + 1e-9)[..., None]).sum(axis=1)
    apart = np.maximum(np.arccos(np.minimum(np.maximum((lines[:, 0] * lines[:, 1]).sum(axis=1), -1.0), 1.0))
                       - _convergence(lines, rotations, distances), 0.0)
    agree = np.minimum(np.maximum((_DISAGREE - apart) / (_DISAGREE - _AGREE), 0.0), 1.0)
    agree = np.where(finite, np.where(measures.visibility.min(axis=1) > 0.3, agree, 1.0), 0.0)
    irises = np.minimum(measures.irises, _IRIS_PART * widths[:, None])
    sizes = _limited((irises[..., None] - LEAST_IRIS) / (GOOD_IRIS - LEAST_IRIS))
    large = (seen[..., None] * sizes).max(axis=1)
    weights = large * agree[:, None]
    # In the head: x out of the face, y to the subject's left, z up.
    inside = (mean[:, None] @ rotations)[:, 0]
    angles = np.stack([np.arctan2(inside[:, 1], inside[:, 0]),
                       np.arctan2(inside[:, 2], np.sqrt(inside[:, 0] ** 2 + inside[:, 1] ** 2))], axis=1)
    # A larger turn than eyes can make is an error; where the irises have no weight, the head is used.
    angles = np.minimum(np.maximum(angles, -MAX_AWAY), MAX_AWAY)
    second = None if shapes is None else _eyes_in_head(shapes)
    if second is not None:
        angles += (_BESIDE_IRISES + _BESIDE_ONE_IRIS * (1.0 - measures.visibility.min(axis=1, keepdims=True))) * (
            second - angles)
    angles *= weights
    if second is not None:
        angles += _SECOND_OPINION * (large - weights) * second
    cosine = np.cos(angles[:, 1])
    turned = np.stack([cosine * np.cos(angles[:, 0]), cosine * np.sin(angles[:, 0]), np.sin(angles[:, 1])], axis=1)
    return (rotations @ turned[..., None])[..., 0], weights[:, 0]


def _eyes_in_head(shapes: np.ndarray) -> np.ndarray:
    """(F, 2) turn of the eyes to the subject's left, and up, rad, by the blendshapes (F, 52)."""
    left = shapes[:, LOOK_IN[RIGHT]] - shapes[:, LOOK_OUT[RIGHT]] + shapes[:, LOOK_OUT[LEFT]] - shapes[:, LOOK_IN[LEFT]]
    up = (shapes[:, LOOK_UP] - shapes[:, LOOK_DOWN]).mean(axis=1)
    return np.stack([0.5 * _SHAPE_TURN * left, _SHAPE_UP[0] * up + _SHAPE_UP[1]], axis=1)


class GazeSmoother:
    """Smooths the gaze of one face and withholds it while the eyes are closed."""

    def __init__(self) -> None:
        self._direction = OneEuro(2.0, 6.0)     # Hz at rest, Hz per (rad/s)
        self._eyes = OpenEyeBaseline()
        self._closed: Optional[float] = None
        self._stamp = 0.0
        self.is_closed = False

    def __call__(self, gaze: GazeEstimate, stamp: float) -> GazeEstimate:
        """Return the filtered gaze at `stamp` (s); its direction is None while the eyes are closed."""
        closed = gaze.eyes_closed if gaze.lids is None else self._eyes.closedness(gaze.lids, stamp)
        if self._closed is not None and stamp >= self._stamp:
            gain = 1.0 - np.exp(-(stamp - self._stamp) / _CLOSED_TIME)
            closed = self._closed + gain * (closed - self._closed)
        self._closed, self._stamp = closed, stamp
        self.is_closed = bool(closed > (OPEN if self.is_closed else CLOSED))
        closed = float(closed)
        if self.is_closed or gaze.direction is None:
            self._direction.reset()
            return GazeEstimate(None, 0.0, closed)
        direction = self._direction(gaze.direction, stamp)
        return GazeEstimate(direction / np.linalg.norm(direction), gaze.confidence * min(1.0, 2.0 * (1.0 - closed)),
                            closed, gaze.from_eyes)

    def forget_direction(self) -> None:
        """Forget where the face looked, but not whether its eyes are closed."""
        self._direction.reset()


def gaze_frame(face: Pose, direction: np.ndarray) -> Pose:
    """Return the gaze frame in the face frame: z along the gaze, y down, at the same place.

    face: face frame in the optical frame; direction: (3,) unit vector in the optical frame.
    """
    # Plain numbers: for every face of every image, and arrays of three are slow.
    x, y, z = (direction @ face.rotation).tolist()
    down = (z * x, z * y, z * z - 1.0)
    length = math.sqrt(down[0] ** 2 + down[1] ** 2 + down[2] ** 2)
    if length < 1e-6:
        # Straight up or down: any upright will do, the subject's left makes the frame complete.
        down, length = (z, 0.0, -x), 1.0
    u, v, w = down[0] / length, down[1] / length, down[2] / length
    return Pose(np.array([[v * z - w * y, u, x], [w * x - u * z, v, y], [u * y - v * x, w, z]]), np.zeros(3))


@dataclass(frozen=True)
class EyeMeasures:
    """Measures of the eyes of F faces, the subject's right eye first.

    openness: (F, 2) aspect ratio of the lids, about 0.27 open and under 0.12 closed, without foreshortening;
    visibility: (F, 2) 0 (hidden by the nose) to 1; lines: (F, 2, 3) unit directions in the optical frame; irises: (F,
    2) diameters, px; iris_angles: (F, 2) the same, rad: in pixels an iris is the larger the farther it lies from the
    middle of the image.
    """

    openness: np.ndarray
    visibility: np.ndarray
    lines: np.ndarray
    irises: np.ndarray
    iris_angles: np.ndarray


class EyeGeometry:
    """Measures of the eyes with the geometry of the canonical face; all faces of an image are measured together."""

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

        meshes: (F, 478, 2 or more) px; rotations: (F, 3, 3), translations: (F, 3) m: face frames in the optical frame
        at the canonical size.
        """
        points = meshes[:, _USED, :2]
        rays = camera.normalise(points.reshape(-1, 2)).reshape(points.shape)
        turned = rotations.transpose(0, 2, 1)
        to_camera = -translations / _length(translations)[:, None]
        facing = ((self._normals @ turned) @ to_camera[..., None])[..., 0]
        visibility = _limited((facing - _PROFILE_COSINE) / 0.4)
        # As angles: aside of the optical axis rays lie the farther apart in the direction away from it.
        lids = _directions_of(rays) if camera.is_calibrated else rays
        openness = _aspect_ratios(lids) * self._foreshortening(turned, translations, rotations[:, :, 2])
        return EyeMeasures(openness, visibility, self._sight_lines(rays[:, _CENTRES], turned, translations),
                           iris_diameters(points[:, _RIMS]), iris_diameters(_directions_of(rays[:, _RIMS])))

    def distance(self, pose: Pose) -> float:
        """Return the mean distance (m) of the middles of both eyes' corners from the camera."""
        return float(_length(self._middles @ pose.rotation.T + pose.translation).mean())

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
        directions = _directions_of(rays)
        centres = self._centres @ turned + translations[:, None]
        along = (directions * centres).sum(axis=2)
        beneath = along ** 2 - ((centres ** 2).sum(axis=2) - EYE_RADIUS ** 2)
        # A ray that misses the eyeball is taken to touch it: the iris is at its edge.
        iris = directions * (along - np.sqrt(np.maximum(beneath, 0.0)))[..., None]
        lines = iris - centres
        return lines / _length(lines)[..., None]


def _aspect_ratios(rays: np.ndarray) -> np.ndarray:
    """(F, 2) height over width of the lids, of rays (F, U, 2) or directions (F, U, 3) of the points _USED."""
    width = _length(rays[:, _OUTER] - rays[:, _INNER])
    heights = _length(rays[:, _UPPER] - rays[:, _LOWER]).reshape(len(rays), 2, 2).sum(axis=2) / 2.0
    return heights / np.maximum(width, 1e-9)


def _length(vectors: np.ndarray) -> np.ndarray:
    return np.sqrt((vectors * vectors).sum(axis=-1))


def _limited(values: np.ndarray) -> np.ndarray:
    return np.minimum(np.maximum(values, 0.0), 1.0)


def _directions_of(rays: np.ndarray) -> np.ndarray:
    """Unit directions (F, N, 3) of rays (F, N, 2) x/z and y/z."""
    directions = np.concatenate([rays, np.ones(rays.shape[:2] + (1,))], axis=2)
    return directions / _length(directions)[..., None]


def iris_diameters(rims: np.ndarray) -> np.ndarray:
    """Return the larger diameter of each iris, (F, 2), of points on their rims (F, 8, D), in their unit: a turned head
    narrows the other one."""
    points = rims.reshape(len(rims), 2, 4, -1)
    return np.maximum(_length(points[:, :, 0] - points[:, :, 2]), _length(points[:, :, 1] - points[:, :, 3]))
