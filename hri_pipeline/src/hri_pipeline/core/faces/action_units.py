"""Action units of one tracked face: intensities and confidences in the 99 slots of hri_msgs/FacialActionUnits.

The slot of a unit is its number in the Facial Action Coding System (Ekman and Friesen 1978; Ekman, Friesen and Hager
2002): the number and the visible change that is its definition. The head's rotation is removed by laying the mesh onto
the canonical face (`FaceMeasures`), the person's own face by a running neutral (`RunningNeutral`). Most units are
weighted sums of the measures in the tables below; eyelids, head, eyes and hidden parts have rules of their own
(`ActionUnitEstimator`).

Tables: points, formula, scale and source of each measure. Points: vertices of MediaPipe's face mesh (Apache-2.0) on the
subject's right; `MIRROR` has those of the left. Lengths are fractions of the distance between the middles of the eyes
(63 mm in the canonical face), on the mesh turned and scaled onto the canonical face; axes: out = away from the
mid-line, up = to the scalp, left = to the subject's left.

`neutral` and `spread`: mean and standard deviation of a measure over 26 photographs of relaxed faces (about 20 people);
start values until the person's own are known. `quantile`: quantile of the values of a person's quiet moments at which
the neutral lies; below 0.5 for what expressions and speech only make larger.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Dict, Optional, Sequence, Tuple

import numpy as np

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces.head_gestures import HeadGestures, nod_confidence
from hri_pipeline.core.faces.mesh import MESH_POINTS, CanonicalFace
from hri_pipeline.core.geometry import Pose

Points = Tuple[int, ...]

MIRROR: Dict[int, int] = {
    33: 263, 133: 362, 158: 385, 159: 386, 160: 387, 144: 373, 145: 374, 153: 380, 107: 336, 55: 285, 70: 300, 46: 276,
    63: 293, 53: 283, 105: 334, 52: 282, 50: 280, 101: 330, 118: 347, 64: 294, 48: 278, 102: 331, 37: 267, 39: 269,
    61: 291, 76: 306, 82: 312, 87: 317, 84: 314, 148: 377, 468: 473, 40: 270, 81: 311, 178: 402, 91: 321, 181: 405,
    127: 356, 234: 454, 132: 361, 54: 284, 67: 297, 143: 372, 21: 251, 103: 332, 109: 338, 162: 389, 93: 323,
}
"""Vertex on the subject's right -> the same place on the left; a vertex that is not here lies on the mid-line."""

RIGID: Points = (10, 54, 67, 103, 109, 21, 162, 127, 234, 93, 132, 143, 33, 133, 168, 6, 197, 195, 151)
"""Vertices by which the mesh is laid onto the canonical face (their mirrors too): no muscle of the table moves them."""

EYE_MIDDLES: Tuple[Points, Points] = ((33, 133), (263, 362))


@dataclass(frozen=True)
class Measure:
    """The mean of the points `of` minus that of the points `over`, along an axis; `sided`: one value per side."""

    name: str
    of: Points
    over: Points
    axis: str
    sided: bool
    neutral: float
    spread: float
    quantile: float = 0.5


MEASURES: Tuple[Measure, ...] = (
    Measure("brow_inner", (107, 55), (133,), "up", True, 0.305, 0.040),
    Measure("brow_outer", (70, 46, 63, 53), (133,), "up", True, 0.280, 0.045),
    Measure("brow_gap", (107, 55), (168,), "out", True, 0.222, 0.018),
    Measure("lid_upper", (158, 159, 160), (33, 133), "up", True, 0.090, 0.025, 0.6),
    Measure("lid_lower", (144, 145, 153), (33, 133), "up", True, -0.043, 0.013, 0.4),
    Measure("lid_opening", (158, 159, 160), (144, 145, 153), "up", True, 0.132, 0.025, 0.6),
    Measure("cheek", (50, 101, 118), (133,), "up", True, -0.406, 0.025, 0.35),
    Measure("nose_wing", (64, 48, 102), (133,), "up", True, -0.600, 0.032, 0.35),
    Measure("upper_lip", (37, 39, 40), (133,), "up", True, -1.000, 0.055, 0.35),
    Measure("lip_nose", (0, 37, 267), (2,), "up", False, -0.231, 0.035, 0.5),
    Measure("corner_up", (61, 76), (133,), "up", True, -1.112, 0.060, 0.35),
    Measure("corner_out", (61, 76), (168, 6), "out", True, 0.410, 0.030, 0.4),
    Measure("corner_level", (61, 76), (13, 14), "up", True, 0.004, 0.024, 0.5),
    Measure("lip_gap", (13, 82, 312), (14, 87, 317), "up", False, 0.003, 0.010, 0.2),
    Measure("upper_thickness", (0, 37, 267), (13, 82, 312), "up", False, 0.112, 0.024),
    Measure("lower_thickness", (14, 87, 317), (17, 84, 314), "up", False, 0.163, 0.027),
    Measure("lower_lip", (17, 84, 314), (2,), "up", False, -0.542, 0.060, 0.5),
    Measure("chin", (152, 148, 377), (2,), "up", False, -1.173, 0.080, 0.65),
    Measure("iris_left", (468,), (33, 133), "left", True, -0.008, 0.030),
    Measure("iris_up", (468,), (33, 133), "up", True, 0.034, 0.012),
)


@dataclass(frozen=True)
class ActionUnit:
    """One unit: the sum of gain x (measure - neutral) over the terms; `start` gives intensity 0, `full` 1.

    While the person's own neutral is not known, `start` grows by the standard deviation that the sum has between
    people. without: units that make this one's change too; its intensity is multiplied by 1 - theirs. reliability:
    factor on the confidence, below 1 where the mesh shows only a part of what a human coder sees (wrinkles, bulges).
    """

    code: int
    name: str
    terms: Tuple[Tuple[str, float], ...]
    start: float
    full: float
    without: Points = ()
    reliability: float = 1.0
    visible: str = ""


ACTION_UNITS: Tuple[ActionUnit, ...] = (
    ActionUnit(1, "inner brow raiser", (("brow_inner", 1.0),), 0.03, 0.15, (), 0.9, "inner part of the brow up"),
    ActionUnit(2, "outer brow raiser", (("brow_outer", 1.0),), 0.03, 0.15, (), 0.9, "outer part of the brow up"),
    ActionUnit(4, "brow lowerer", (("brow_inner", -0.6), ("brow_outer", -0.4), ("brow_gap", -1.0)), 0.03, 0.14, (), 0.7,
               "brows down and together"),
    ActionUnit(5, "upper lid raiser", (("lid_upper", 1.0), ("lid_opening", 0.5)), 0.025, 0.09, (), 0.8,
               "upper lid up, more of the eyeball seen"),
    ActionUnit(6, "cheek raiser", (("cheek", 0.6), ("lid_lower", 1.0)), 0.02, 0.10, (), 0.6,
               "cheeks up, lower lid pushed up"),
    ActionUnit(7, "lid tightener", (("lid_lower", 1.0), ("lid_opening", -0.5)), 0.02, 0.08, (45,), 0.5,
               "lower lid up and tight, eye narrowed"),
    ActionUnit(9, "nose wrinkler", (("nose_wing", 1.0), ("brow_inner", -0.3)), 0.03, 0.12, (), 0.6,
               "wings of the nose up, inner brow down"),
    ActionUnit(10, "upper lip raiser", (("upper_lip", 1.0), ("corner_up", -0.5)), 0.03, 0.15, (), 0.6,
               "middle of the upper lip up, more than its corners"),
    ActionUnit(12, "lip corner puller", (("corner_up", 0.6), ("corner_out", 0.8)), 0.03, 0.18, (), 0.95,
               "corners of the mouth up and out"),
    ActionUnit(14, "dimpler", (("corner_out", 1.0), ("lip_gap", -0.5), ("corner_level", -0.3)), 0.03, 0.12, (12, 25),
               0.3, "corners tightened and drawn in"),
    ActionUnit(15, "lip corner depressor", (("corner_level", -1.0), ("corner_up", -0.4)), 0.03, 0.12, (26,), 0.7,
               "corners of the mouth down"),
    ActionUnit(17, "chin raiser", (("lower_lip", 1.0), ("lip_nose", -0.5)), 0.03, 0.12, (25,), 0.6,
               "chin and lower lip pushed up"),
    ActionUnit(20, "lip stretcher", (("corner_out", 1.0), ("corner_up", -0.6)), 0.05, 0.18, (12,), 0.5,
               "corners drawn to the side, mouth long and flat"),
    ActionUnit(23, "lip tightener", (("upper_thickness", -0.7), ("lower_thickness", -0.7), ("corner_out", -0.5)),
               0.04, 0.15, (25, 28), 0.4, "lips narrow and tight"),
    ActionUnit(24, "lip pressor", (("upper_thickness", -0.8), ("lower_thickness", -0.8), ("lip_gap", -1.0)),
               0.03, 0.12, (25, 28), 0.4, "lips pressed together"),
    ActionUnit(25, "lips part", (("lip_gap", 1.0),), 0.02, 0.20, (), 1.0, "lips apart"),
    ActionUnit(26, "jaw drop", (("chin", -1.0),), 0.04, 0.20, (), 0.8, "lower jaw down, relaxed"),
    ActionUnit(27, "mouth stretch", (("lip_gap", 1.0), ("chin", -0.5)), 0.38, 0.70, (), 0.8, "mouth pulled wide open"),
    ActionUnit(28, "lip suck", (("upper_thickness", -1.0), ("lower_thickness", -1.0)), 0.13, 0.22, (25,), 0.5,
               "red of the lips drawn into the mouth"),
)
"""Units that are such sums. 43 and 45, 51 to 58, 61 to 64, 70 to 73, 84 and 85 have rules of their own in
`action_units`."""


SLOTS = 99
BLINK, EYES_CLOSED = 45, 43
LONGEST_BLINK = 0.5
"""Time (s) from which closed eyes are no blink (45) only but closed eyes (43) too."""
HEAD_SHAKE, HEAD_NOD = 84, 85
EYE_CODES = (61, 62, 63, 64)
HIDDEN_CODES = (70, 71, 72, 73)

_OPEN_PART, _CLOSED_PART = 0.8, 0.2
"""Lid opening over its neutral: intensity of a blink 0 and 1. Half way lies between the open and the closed eyes of
scripts/benchmarks/eyes.txt: openings of 0.082 to 0.190 and -0.006 to 0.069, neutral 0.132."""
_HEAD_START, _HEAD_FULL = np.deg2rad(5.0), np.deg2rad((45.0, 30.0, 30.0))
"""Turn (rad) of intensity 0, and of intensity 1 for yaw, pitch, roll."""
_LEAN_START, _LEAN_FULL, _LEAN_TIME = 0.03, 0.15, 5.0
"""Head nearer than its running mean (m) of intensity 0 and 1; time constant (s) of the mean."""
_LEAN_RELIABILITY = 0.3
"""Low: with one camera a step towards it cannot be told from a head that moves forward."""
_GAZE_START, _GAZE_FULL = np.array([0.03, 0.015]), np.array([0.10, 0.05])
"""Way of the iris to the side and up or down, in parts of the distance of the eyes, of intensity 0 and 1."""
_LEAST_EYES, _GOOD_EYES = 8.0, 30.0
"""Distance of the eyes (px) with confidence 0, and from which more adds none."""
_LEAST_IRIS_EYES, _GOOD_IRIS_EYES = 18.0, 50.0
_GOOD_TURN, _LAST_TURN = np.deg2rad(25.0), np.deg2rad(75.0)
"""Turn away from the camera (rad) with full confidence, and with none."""
_GOOD_RESIDUAL, _LAST_RESIDUAL = 0.10, 0.30
"""Misfit of the rigid points with full confidence, and with none: such a mesh is no face."""
_HIDDEN = 0.15
"""Part of the points seen below which a part of the face counts as not visible."""
_QUIET_TURN, _PATIENCE = np.deg2rad(25.0), 20.0
"""A moment is quiet below this turn (rad) and with the units below their limits; after this time (s) without one, the
strong expression must be the person's own face."""
_QUIET = {1: 0.5, 2: 0.5, 4: 0.5, 9: 0.5, 10: 0.5, 12: 0.2, 15: 0.5, 20: 0.5, 25: 0.2, 26: 0.2, 27: 0.2}
"""Unit and its limit. Smiles and speech last long: their limit is low, though people differ at rest as well."""
_UNKNOWN_NEUTRAL = 0.6
"""Confidence while nothing of the person's own neutral is known."""

_INDEX = {measure.name: index for index, measure in enumerate(MEASURES)}
_CODES = np.array([unit.code for unit in ACTION_UNITS])
_START = np.array([unit.start for unit in ACTION_UNITS])
_FULL = np.array([unit.full for unit in ACTION_UNITS])
_RELIABILITY = np.array([unit.reliability for unit in ACTION_UNITS])
_GAINS = np.zeros((len(ACTION_UNITS), len(MEASURES)))
_WITHOUT = np.zeros((len(ACTION_UNITS), SLOTS))
for _number, _unit in enumerate(ACTION_UNITS):
    for _name, _gain in _unit.terms:
        _GAINS[_number, _INDEX[_name]] = _gain
    _WITHOUT[_number, list(_unit.without)] = 1.0
_BETWEEN_PEOPLE = np.sqrt(_GAINS ** 2 @ np.array([measure.spread for measure in MEASURES]) ** 2)
"""Standard deviation of each unit's sum over people at rest."""
_SHARE = np.abs(_GAINS) / np.abs(_GAINS).sum(axis=1, keepdims=True)
_PARTS = np.zeros((3, len(MEASURES)))
"""Measures on the points of the parts of the face of codes 70, 71 and 72."""
for _part, _names in zip(_PARTS, (("brow_inner", "brow_outer"), ("lid_upper", "lid_lower"),
                                  ("corner_up", "lip_gap", "chin"))):
    _part[[_INDEX[_name] for _name in _names]] = 1.0 / len(_names)
_OF_EYES = np.array([measure.name.startswith(("lid_", "iris_")) for measure in MEASURES])
"""(M,) measures that glasses hide."""
_MEANS = np.repeat([measure.neutral for measure in MEASURES], 2)
_SPREADS = np.repeat([measure.spread for measure in MEASURES], 2)
_QUANTILES = np.repeat([measure.quantile for measure in MEASURES], 2)
_QUIET_CODES, _QUIET_LIMITS = np.array(list(_QUIET)), np.array(list(_QUIET.values()))


@dataclass(frozen=True)
class ActionUnits:
    """intensity, confidence: (99,) float32, 0 to 1, by the number of the unit. neutral_known: how much of the
    person's own neutral face is known, 0 to 1."""

    intensity: np.ndarray
    confidence: np.ndarray
    neutral_known: float = 0.0


class ActionUnitEstimator:
    """Action units of one face over time. Not thread-safe."""

    def __init__(self, measures: FaceMeasures) -> None:
        """measures: shared by all faces."""
        self._measures = measures
        self._neutral = RunningNeutral(_MEANS, _SPREADS, _QUANTILES)
        self._last = -np.inf
        self._closed_since: Optional[float] = None
        self._loud_since: Optional[float] = None
        self._mean_distance: Optional[float] = None
        self._gestures = HeadGestures()

    def update(self, mesh: np.ndarray, pose: Optional[Pose], stamp: float, presence: float = 1.0,
               camera: Optional[CameraModel] = None, eyes_closed: Optional[float] = None,
               eyes_hidden: bool = False) -> ActionUnits:
        """Return the units at a time (s); one that goes back is a new start.

        Parameters
        ----------
        mesh
            (478, 3) px. A mesh that is not finite is a face that cannot be seen.
        pose
            Face frame in the optical frame. None: the rotation of the mesh is used for the head's codes, and 57, 58,
            84 and 85 are not known.
        stamp
            Time of the image, s.
        presence
            Probability 0 to 1 that the mesh lies on a face.
        camera
            Of the image; see FaceMeasures.measure.
        eyes_closed
            Closedness of the eyes, 0 to 1, by `gaze`; None: by the opening of the lids over its neutral.
        eyes_hidden
            Nothing is seen of eyes and lids, as with dark glasses: what the mesh says of them is a guess.

        Raises
        ------
        ValueError
            For another shape of the mesh or a stamp that is not finite.
        """
        if not np.isfinite(stamp):
            raise ValueError("stamp of action units is {}".format(stamp))
        if stamp < self._last:
            self.reset()
        elapsed = 0.0 if np.isinf(self._last) else stamp - self._last
        self._last = stamp
        face = self._measures.measure(mesh, camera)
        intensity, confidence = np.zeros(SLOTS), np.zeros(SLOTS)
        if face is None or not presence > 0.0:
            intensity[list(HIDDEN_CODES)] = confidence[list(HIDDEN_CODES)] = 1.0
            return _frozen(intensity, confidence, self._neutral.known)
        if eyes_hidden:
            face = replace(face, visible=np.where(_OF_EYES[:, None], 0.0, face.visible))
        overall = self._confidence(face, min(float(presence), 1.0))
        offset, seen = self._offsets(face)
        self._eyelids(face, intensity, confidence, overall, stamp, eyes_closed)
        self._muscles(offset, seen, intensity, confidence, overall)
        self._irises(offset, seen, face, intensity, confidence, overall)
        self._head(pose, face, stamp, elapsed, intensity, confidence, min(float(presence), 1.0))
        _hidden(seen, intensity, confidence, overall > 0.0)
        if overall > 0.5 and self._is_quiet(face, intensity, stamp):
            self._neutral.add(face.values.ravel(), stamp)
        return _frozen(intensity, confidence, self._neutral.known)

    def reset(self) -> None:
        """Forget the person's neutral and the past."""
        self._neutral.reset()
        self._gestures.reset()
        self._last = -np.inf
        self._closed_since = self._loud_since = self._mean_distance = None

    def _confidence(self, face: MeasuredFace, presence: float) -> float:
        """Factor on every confidence: size, turn, misfit of the mesh, presence."""
        size = _ramp(face.eye_distance, _LEAST_EYES, _GOOD_EYES)
        turn = 1.0 - _ramp(_turned(face), _GOOD_TURN, _LAST_TURN)
        sound = 1.0 - _ramp(face.residual, _GOOD_RESIDUAL, _LAST_RESIDUAL)
        return float(size * turn * sound * presence)

    def _offsets(self, face: MeasuredFace) -> Tuple[np.ndarray, np.ndarray]:
        """Measure minus neutral (M,), the better seen side counting more, and how well it is seen (M,)."""
        offset = face.values - self._neutral.value.reshape(-1, 2)
        weight = face.visible + 1e-6
        return (offset * weight).sum(axis=1) / weight.sum(axis=1), face.visible.max(axis=1)

    def _muscles(self, offset: np.ndarray, seen: np.ndarray, intensity: np.ndarray, confidence: np.ndarray,
                 overall: float) -> None:
        start = np.minimum(_START + (1.0 - self._neutral.known) * _BETWEEN_PEOPLE, 0.8 * _FULL)
        values = _limited((_GAINS @ offset - start) / (_FULL - start))
        intensity[_CODES] = values
        # The product of 1 - intensity over the units that make the same change too.
        intensity[_CODES] = values * np.exp(_WITHOUT @ np.log(np.maximum(1.0 - intensity, 1e-6)))
        visible = _SHARE @ seen
        known = _UNKNOWN_NEUTRAL + (1.0 - _UNKNOWN_NEUTRAL) * self._neutral.known
        confidence[_CODES] = np.where(visible < _HIDDEN, 0.0, overall * known * _RELIABILITY * visible)

    def _eyelids(self, face: MeasuredFace, intensity: np.ndarray, confidence: np.ndarray, overall: float,
                 stamp: float, eyes_closed: Optional[float]) -> None:
        """45 (closed now) and 43 (closed for longer than a blink)."""
        row = _INDEX["lid_opening"]
        closed = self._lids_closed(face, row) if eyes_closed is None else min(max(eyes_closed, 0.0), 1.0)
        intensity[BLINK] = closed
        if closed < 0.5:
            self._closed_since = None
        elif self._closed_since is None:
            self._closed_since = stamp
        if self._closed_since is not None and stamp - self._closed_since > LONGEST_BLINK:
            intensity[EYES_CLOSED] = closed
        visible = float(face.visible[row].max())
        confidence[[BLINK, EYES_CLOSED]] = overall * visible if visible >= _HIDDEN else 0.0

    def _lids_closed(self, face: MeasuredFace, row: int) -> float:
        """Closedness by the opening of the lids, measure `row`, over its neutral."""
        opening, usual = face.values[row], self._neutral.value.reshape(-1, 2)[row]
        weight = face.visible[row] + 1e-6
        part = float((opening / usual * weight).sum() / weight.sum())
        return 1.0 - _ramp(part, _CLOSED_PART, _OPEN_PART)

    def _irises(self, offset: np.ndarray, seen: np.ndarray, face: MeasuredFace, intensity: np.ndarray,
                confidence: np.ndarray, overall: float) -> None:
        rows = [_INDEX["iris_left"], _INDEX["iris_up"]]
        way = (np.abs(offset[rows]) - _GAZE_START) / (_GAZE_FULL - _GAZE_START)
        for value, amount, (positive, negative) in zip(offset[rows], _limited(way), ((61, 62), (63, 64))):
            intensity[positive if value > 0.0 else negative] = amount
        visible = float(seen[rows].min())
        size = _ramp(face.eye_distance, _LEAST_IRIS_EYES, _GOOD_IRIS_EYES)
        opened = 1.0 - intensity[BLINK]
        confidence[list(EYE_CODES)] = overall * size * opened * visible if visible >= _HIDDEN else 0.0

    def _head(self, pose: Optional[Pose], face: MeasuredFace, stamp: float, elapsed: float, intensity: np.ndarray,
              confidence: np.ndarray, presence: float) -> None:
        """51 to 56 from the turn against the line of sight, 57 and 58 from the distance against its running mean, 84
        and 85 from the turn over time."""
        rotation, place = face.rotation @ self._measures.frame_rotation, np.array([0.0, 0.0, 1.0])
        if pose is not None and np.isfinite(pose.rotation).all() and np.linalg.norm(pose.translation) > 1e-6:
            rotation, place = pose.rotation, pose.translation
        else:
            pose = None
        angles = angles_to_sight(rotation, place)
        amounts = _limited((np.abs(angles) - _HEAD_START) / (_HEAD_FULL - _HEAD_START))
        for angle, amount, first in zip(angles, amounts, (51, 53, 55)):
            intensity[first if angle > 0.0 else first + 1] = amount
        size = _ramp(face.eye_distance, _LEAST_EYES, _GOOD_EYES)
        confidence[51:57] = presence * size
        if pose is None:
            return
        distance = float(np.linalg.norm(place))
        gesture = self._gestures.update(float(angles[0]), float(angles[1]), distance, stamp)
        intensity[HEAD_SHAKE], intensity[HEAD_NOD] = gesture.shake, gesture.nod
        confidence[HEAD_SHAKE] = presence * size
        confidence[HEAD_NOD] = presence * size * nod_confidence(gesture.nod)
        if self._mean_distance is None:
            self._mean_distance = distance
        nearer = self._mean_distance - distance
        self._mean_distance -= nearer * (1.0 - np.exp(-elapsed / _LEAN_TIME))
        intensity[57 if nearer > 0.0 else 58] = _ramp(abs(nearer), _LEAN_START, _LEAN_FULL)
        confidence[57:59] = _LEAN_RELIABILITY * presence * size

    def _is_quiet(self, face: MeasuredFace, intensity: np.ndarray, stamp: float) -> bool:
        """True when the face is near its neutral, or has never been for so long that the neutral must be wrong."""
        if _turned(face) > _QUIET_TURN or intensity[BLINK] > 0.5:
            return False
        if (intensity[_QUIET_CODES] < _QUIET_LIMITS).all():
            self._loud_since = None
            return True
        if self._loud_since is None:
            self._loud_since = stamp
        return stamp - self._loud_since > _PATIENCE


def angles_to_sight(rotation: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Yaw, pitch, roll (3,) rad of a face against the line from it to the camera.

    rotation: (3, 3) face frame in the optical frame (x out of the face, y left, z up); place: (3,) m of the face.
    All 0 for a face that looks into the camera, upright; positive: turned to its own left, up, tilted to its left.
    """
    x, y, z = (place / np.linalg.norm(place)).tolist()
    length = math.hypot(x, z)
    right = (z / length, 0.0, -x / length) if length > 1e-6 else (1.0, 0.0, 0.0)
    down = (y * right[2], z * right[0] - x * right[2], -y * right[0])
    forward, left = (np.array([right, down, (x, y, z)]) @ rotation[:, :2]).T.tolist()
    yaw = math.atan2(forward[0], -forward[2])
    pitch = math.atan2(-forward[1], math.hypot(forward[0], forward[2]))
    return np.array([yaw, pitch, math.atan2(left[1], left[0])])


def _hidden(seen: np.ndarray, intensity: np.ndarray, confidence: np.ndarray, usable: bool) -> None:
    """70 to 73: what is turned away, outside the image or, of the eyes, behind dark glasses. A hand in front of the
    face is not noticed."""
    parts = [not usable or float(seen @ part) < _HIDDEN for part in _PARTS]
    intensity[70:73] = parts
    intensity[73] = float(all(parts))
    confidence[70:74] = 1.0


def _turned(face: MeasuredFace) -> float:
    """Angle (rad) between the direction of the canonical face and that to the camera."""
    return math.acos(min(1.0, max(-1.0, float(face.rotation[2, 2]))))


def _limited(values: np.ndarray) -> np.ndarray:
    return np.minimum(np.maximum(values, 0.0), 1.0)


def _ramp(value: float, low: float, high: float) -> float:
    return min(1.0, max(0.0, (float(value) - low) / (high - low)))


def _frozen(intensity: np.ndarray, confidence: np.ndarray, known: float) -> ActionUnits:
    values = intensity.astype(np.float32), confidence.astype(np.float32)
    for array in values:
        array.setflags(write=False)
    return ActionUnits(values[0], values[1], known)


_AXES = {"up": np.array([0.0, -1.0, 0.0]), "left": np.array([1.0, 0.0, 0.0])}
"""In the axes of the canonical face: x to the subject's left, y down, z into the head."""
_GRAZING, _FACING = 0.0, 0.35
"""Cosine between a point's normal and the direction to the camera: not seen, and well seen."""


@dataclass(frozen=True)
class MeasuredFace:
    """values: (M, 2) measures on the subject's right and left (equal where there is one only), in parts of the
    distance of the eyes; visible: (M, 2) 0 to 1; rotation: (3, 3), turns canonical axes into those of the image;
    eye_distance: px, as of a face seen from the front; residual: root-mean-square misfit of the rigid points.
    """

    values: np.ndarray
    visible: np.ndarray
    rotation: np.ndarray
    eye_distance: float
    residual: float


class FaceMeasures:
    """Lays meshes onto the canonical face and takes the measures. Holds no state: one serves all faces."""

    names = tuple(measure.name for measure in MEASURES)

    def __init__(self, face: CanonicalFace) -> None:
        self.frame_rotation = face.face_frame().rotation
        eyes = [face.vertices[list(middle)].mean(axis=0) for middle in EYE_MIDDLES]
        model = face.vertices / float(np.linalg.norm(eyes[1] - eyes[0]))
        self._rigid = np.array(sorted(set(RIGID) | {MIRROR[i] for i in RIGID if i in MIRROR}))
        self._model = model[self._rigid] - model[self._rigid].mean(axis=0)
        rows = [_row(measure, side) for measure in MEASURES for side in (False, True)]
        self._used = np.array(sorted({point for row in rows for point, _, _ in row}))
        self._needed = np.union1d(self._used, self._rigid)
        self._rigid_here, self._used_here = (np.searchsorted(self._needed, some) for some in (self._rigid, self._used))
        place = {point: index for index, point in enumerate(self._used)}
        self._weights = np.zeros((len(rows), len(self._used), 3))
        share = np.zeros((2, len(rows), len(self._used)))
        for number, row in enumerate(rows):
            for point, end, weight in row:
                self._weights[number, place[point]] += weight
                share[end, number, place[point]] += 1.0
        self._weights = self._weights.reshape(len(rows), -1)
        self._share = share / share.sum(axis=2, keepdims=True)
        self._normals = _normals(face)[self._used]

    def measure(self, mesh: np.ndarray, camera: Optional[CameraModel] = None) -> Optional[MeasuredFace]:
        """Measure a mesh (478, 3) px; camera: of the image's size.

        Points outside of the image count as not seen, and what a calibrated camera does to a face aside of its optical
        axis is taken back. Without a camera the face is taken to be in the middle of a large image.

        None when the mesh is not finite or has no extent. Raises ValueError for another shape.
        """
        mesh = np.asarray(mesh, dtype=np.float64)
        if mesh.shape != (MESH_POINTS, 3):
            raise ValueError("expected a mesh of ({}, 3), got {}".format(MESH_POINTS, mesh.shape))
        if not np.isfinite(mesh).all():
            return None
        inside, ahead = np.ones(len(self._used), bool), mesh[self._needed]
        if camera is not None:
            places = ahead[self._used_here, :2]
            inside = ((places >= 0.0) & (places < (camera.width, camera.height))).all(axis=1)
            ahead = self._facing(ahead, camera) if camera.is_calibrated else ahead
        rigid, points = ahead[self._rigid_here], ahead[self._used_here]
        if (rigid.max(axis=0) - rigid.min(axis=0)).max() < 1.0:
            return None
        centre = rigid.sum(axis=0) / len(rigid)
        turn, scale, residual = _procrustes(rigid - centre, self._model)
        values = self._weights @ (scale * (points - centre) @ turn).ravel()
        # Towards the camera is -z of the image, seen in canonical axes.
        seen = _limited((self._normals @ -turn[2] - _GRAZING) / (_FACING - _GRAZING)) * inside
        # Both ends of a measure must be seen.
        visible = np.minimum(self._share[0] @ seen, self._share[1] @ seen)
        return MeasuredFace(values.reshape(-1, 2), visible.reshape(-1, 2), turn, 1.0 / scale, residual)

    @staticmethod
    def _facing(points: np.ndarray, camera: CameraModel) -> np.ndarray:
        """Points (N, 3) px of a mesh as a camera sees them that looks at the face."""
        places = points[:, :2]
        found = camera.facing(places)
        before, after = (some - some.sum(axis=0) / len(some) for some in (places, found))
        depths = points[:, 2:] * math.sqrt(np.vdot(after, after) / max(np.vdot(before, before), 1e-6))
        return np.concatenate([found, depths], axis=1)


def _procrustes(points: np.ndarray, model: np.ndarray) -> Tuple[np.ndarray, float, float]:
    """Rotation R (3, 3), scale s and residual of the least-squares fit s points R = model, both centred (Schönemann
    1966, scale after Umeyama 1991)."""
    u, singular, vt = np.linalg.svd(points.T @ model)
    turn = u @ vt
    (a, b, c), (d, e, f), (g, h, i) = turn.tolist()
    if a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) < 0.0:      # a mirror is no rotation
        singular, turn = singular * (1.0, 1.0, -1.0), (u * (1.0, 1.0, -1.0)) @ vt
    scale = float(singular.sum() / np.vdot(points, points))
    misfit = scale * points @ turn - model
    residual = math.sqrt(np.vdot(misfit, misfit) / len(points))
    return turn, max(scale, 1e-9), residual


def _row(measure: Measure, left: bool) -> Sequence[Tuple[int, int, np.ndarray]]:
    """(vertex, end 0 or 1, weight (3,)) of the points of a measure on one side; end: 0 `of`, 1 `over`."""
    axis = _AXES["up"] if measure.axis == "up" else _AXES["left"]
    if measure.axis == "out" and not left:
        axis = -axis
    row = []
    for end, (points, sign) in enumerate(((measure.of, 1.0), (measure.over, -1.0))):
        # What has no sides takes the points of both, so that a turned head does not bias it.
        chosen = _mirrored(points) if left and measure.sided else points
        if not measure.sided:
            chosen = tuple(sorted(set(points) | set(_mirrored(points))))
        row += [(point, end, sign * axis / len(chosen)) for point in chosen]
    return row


def _mirrored(points: Points) -> Points:
    return tuple(MIRROR.get(point, point) for point in points)


def _normals(face: CanonicalFace) -> np.ndarray:
    """(478, 3) outward unit directions, as of a cylinder about the neck's axis; irises as their eyes."""
    points = np.concatenate([face.vertices, np.zeros((MESH_POINTS - len(face.vertices), 3))])
    for first, middle in zip((468, 473), EYE_MIDDLES):
        points[first:first + 5] = face.vertices[list(middle)].mean(axis=0)
    normals = points - np.array([0.0, 0.0, 0.02])
    normals[:, 1] = 0.0
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)


SAMPLE_PERIOD = 0.2
"""Time (s) between two values that are kept."""
CAPACITY = 150
"""Values kept: half a minute of quiet time."""
TRUST_TIME = 2.0
"""Quiet time (s) after which the person's own values count as much as those of the population."""
MAX_DEVIATION = 2.0
"""Largest distance of a neutral from the population's mean, in standard deviations of the population."""


class RunningNeutral:
    """Quantiles of K measures over the quiet moments of the last half minute or more of quiet time.

    It starts with the population's mean and moves to the person's own quantile q as
    mean + w (q - mean), w = t / (t + TRUST_TIME) for t seconds of quiet time, never further than
    MAX_DEVIATION standard deviations: who is smiling from the first image on does not become "neutral" by it.
    """

    def __init__(self, mean: np.ndarray, deviation: np.ndarray, quantile: np.ndarray) -> None:
        """mean, deviation, quantile: (K,); quantile 0 to 1."""
        self._mean = np.asarray(mean, dtype=np.float64)
        self._limit = MAX_DEVIATION * np.asarray(deviation, dtype=np.float64)
        self._quantile = np.asarray(quantile, dtype=np.float64)
        self._values = np.empty((CAPACITY, len(self._mean)))
        self._count = 0
        self._last: Optional[float] = None
        self._neutral = self._mean.copy()

    @property
    def value(self) -> np.ndarray:
        """(K,) the neutral as known now."""
        return self._neutral

    @property
    def known(self) -> float:
        """How much of the neutral is the person's own: 0 (nothing seen yet) to nearly 1."""
        quiet = self._count * SAMPLE_PERIOD
        return quiet / (quiet + TRUST_TIME)

    def add(self, values: np.ndarray, stamp: float) -> None:
        """Take note of the measures (K,) of a quiet moment at a time (s). Values that are not finite are left out."""
        if self._last is not None and stamp - self._last < 0.99 * SAMPLE_PERIOD:
            return
        if not np.isfinite(values).all():
            return
        self._last = stamp
        self._values[self._count % CAPACITY] = values
        self._count += 1
        if self._count <= 10 or self._count % 5 == 0:
            self._estimate()

    def reset(self) -> None:
        """Forget the person."""
        self._count, self._last = 0, None
        self._neutral = self._mean.copy()

    def _estimate(self) -> None:
        kept = np.sort(self._values[:min(self._count, CAPACITY)], axis=0)
        place = np.rint(self._quantile * (len(kept) - 1)).astype(int)
        own = kept[place, np.arange(kept.shape[1])]
        self._neutral = self._mean + np.clip(self.known * (own - self._mean), -self._limit, self._limit)
