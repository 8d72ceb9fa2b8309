"""Action units of one tracked face: intensities and confidences in the 99 slots of hri_msgs/FacialActionUnits.

The slot of a unit is its number in the Facial Action Coding System (Ekman and Friesen 1978). Turns of the head are
taken out by laying the mesh onto the canonical face, the person's own face by a running neutral. The sums are in
`action_units_table`; the rules for eyelids, head, eyes and hidden parts stand here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Optional, Tuple

import numpy as np

from hri_pipeline.core.faces.action_units_table import ACTION_UNITS, MEASURES
from hri_pipeline.core.faces.face_measures import FaceMeasures, MeasuredFace
from hri_pipeline.core.faces.running_neutral import RunningNeutral
from hri_pipeline.core.geometry import Pose

SLOTS = 99
BLINK, EYES_CLOSED = 45, 43
LONGEST_BLINK = 0.5
"""Time (s) from which closed eyes are no blink (45) only but closed eyes (43) too."""
HEAD_CODES = (51, 52, 53, 54, 55, 56, 57, 58)
EYE_CODES = (61, 62, 63, 64)
HIDDEN_CODES = (70, 71, 72, 73)

_OPEN_PART, _CLOSED_PART = 0.8, 0.2
"""Lid opening over its neutral: intensity of a blink 0 and 1. Half way lies between the open and the closed eyes of
evaluation/eyes.txt: openings of 0.082 to 0.190 and -0.006 to 0.069, neutral 0.132."""
_HEAD_START, _HEAD_FULL = np.deg2rad(5.0), np.deg2rad((45.0, 30.0, 30.0))
"""Turn (rad) of intensity 0, and of intensity 1 for yaw, pitch, roll."""
_LEAN_START, _LEAN_FULL, _LEAN_TIME = 0.03, 0.15, 5.0
"""Head nearer than its running mean (m) of intensity 0 and 1; time constant (s) of the mean."""
_LEAN_RELIABILITY = 0.3
"""To one camera a step of the body looks like a head that moves forward."""
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
    """Action units of one face over time. Not safe for use from several threads at once."""

    def __init__(self, measures: FaceMeasures) -> None:
        """measures: shared by all faces."""
        self._measures = measures
        self._neutral = RunningNeutral(_MEANS, _SPREADS, _QUANTILES)
        self.reset()

    def update(self, mesh: np.ndarray, pose: Optional[Pose], stamp: float, presence: float = 1.0,
               image_size: Optional[Tuple[int, int]] = None) -> ActionUnits:
        """Return the units at a time (s); one that goes back is a new start.

        mesh: (478, 3) px; pose: face frame in the optical frame, None: the turn of the mesh serves for the head's
        codes, and 57 and 58 are not known; presence: probability 0 to 1 that the mesh lies on a face; image_size:
        width, height px. A mesh that is not finite is a face that cannot be seen. Raises ValueError for another
        shape of the mesh or a stamp that is not finite.
        """
        if not np.isfinite(stamp):
            raise ValueError("stamp of action units is {}".format(stamp))
        if stamp < self._last:
            self.reset()
        elapsed = 0.0 if np.isinf(self._last) else stamp - self._last
        self._last = stamp
        face = self._measures.measure(mesh, image_size)
        intensity, confidence = np.zeros(SLOTS), np.zeros(SLOTS)
        if face is None or not presence > 0.0:
            intensity[list(HIDDEN_CODES)] = confidence[list(HIDDEN_CODES)] = 1.0
            return _frozen(intensity, confidence, self._neutral.known)
        trust = self._trust(face, min(float(presence), 1.0))
        offset, seen = self._offsets(face)
        self._eyelids(face, intensity, confidence, trust, stamp)
        self._muscles(offset, seen, intensity, confidence, trust)
        self._irises(offset, seen, face, intensity, confidence, trust)
        self._head(pose, face, elapsed, intensity, confidence, min(float(presence), 1.0))
        _hidden(seen, intensity, confidence, trust > 0.0)
        if trust > 0.5 and self._is_quiet(face, intensity, stamp):
            self._neutral.add(face.values.ravel(), stamp)
        return _frozen(intensity, confidence, self._neutral.known)

    def reset(self) -> None:
        """Forget the person's neutral and the past."""
        self._neutral.reset()
        self._last = -np.inf
        self._closed_since: Optional[float] = None
        self._loud_since: Optional[float] = None
        self._mean_distance: Optional[float] = None

    def _trust(self, face: MeasuredFace, presence: float) -> float:
        """Factor on every confidence: size, turn, sound mesh, presence."""
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
                 trust: float) -> None:
        start = np.minimum(_START + (1.0 - self._neutral.known) * _BETWEEN_PEOPLE, 0.8 * _FULL)
        values = _limited((_GAINS @ offset - start) / (_FULL - start))
        intensity[_CODES] = values
        # The product of 1 - intensity over the units that make the same change too.
        intensity[_CODES] = values * np.exp(_WITHOUT @ np.log(np.maximum(1.0 - intensity, 1e-6)))
        visible = _SHARE @ seen
        known = _UNKNOWN_NEUTRAL + (1.0 - _UNKNOWN_NEUTRAL) * self._neutral.known
        confidence[_CODES] = np.where(visible < _HIDDEN, 0.0, trust * known * _RELIABILITY * visible)

    def _eyelids(self, face: MeasuredFace, intensity: np.ndarray, confidence: np.ndarray, trust: float,
                 stamp: float) -> None:
        """45 (closed now) and 43 (closed for longer than a blink): the opening of the lids over its neutral."""
        row = _INDEX["lid_opening"]
        opening, usual = face.values[row], self._neutral.value.reshape(-1, 2)[row]
        weight = face.visible[row] + 1e-6
        part = float((opening / usual * weight).sum() / weight.sum())
        closed = 1.0 - _ramp(part, _CLOSED_PART, _OPEN_PART)
        intensity[BLINK] = closed
        if closed < 0.5:
            self._closed_since = None
        elif self._closed_since is None:
            self._closed_since = stamp
        if self._closed_since is not None and stamp - self._closed_since > LONGEST_BLINK:
            intensity[EYES_CLOSED] = closed
        visible = float(face.visible[row].max())
        confidence[[BLINK, EYES_CLOSED]] = trust * visible if visible >= _HIDDEN else 0.0

    def _irises(self, offset: np.ndarray, seen: np.ndarray, face: MeasuredFace, intensity: np.ndarray,
                confidence: np.ndarray, trust: float) -> None:
        rows = [_INDEX["iris_left"], _INDEX["iris_up"]]
        way = (np.abs(offset[rows]) - _GAZE_START) / (_GAZE_FULL - _GAZE_START)
        for value, amount, (positive, negative) in zip(offset[rows], _limited(way), ((61, 62), (63, 64))):
            intensity[positive if value > 0.0 else negative] = amount
        visible = float(seen[rows].min())
        size = _ramp(face.eye_distance, _LEAST_IRIS_EYES, _GOOD_IRIS_EYES)
        opened = 1.0 - intensity[BLINK]
        confidence[list(EYE_CODES)] = trust * size * opened * visible if visible >= _HIDDEN else 0.0

    def _head(self, pose: Optional[Pose], face: MeasuredFace, elapsed: float, intensity: np.ndarray,
              confidence: np.ndarray, presence: float) -> None:
        """51 to 56 from the turn against the line of sight, 57 and 58 from the distance against its running mean."""
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
    """70 to 73: what is turned away or outside the image. A hand in front of the face is not noticed."""
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
