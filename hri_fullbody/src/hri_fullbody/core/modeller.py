"""The kinematic models of the bodies of one camera: key points are filtered, lengths estimated, joints solved.

The dimensions of a person are estimated continuously, fixed early, and changed rarely.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np

from hri_fullbody.core.filtering import FilteredPoints, FilterSettings, KeypointFilter
from hri_fullbody.core.kinematics.solver import JointSolver
from hri_fullbody.core.kinematics.warm_start import WarmStart
from hri_fullbody.core.model.anthropometry import SEGMENTS, SegmentTable, StatureEstimate, StatureEstimator
from hri_fullbody.core.model.human import Dimensions, Layout, layout_for
from hri_fullbody.core.parameters import BodiesSettings
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.image_rotation import ImageRotation

_LEAST_POINTS = 4
_WORST_RESIDUAL_M = 0.5
_LEAST_DETERMINANT = 0.5    # of a rotation, which has 1: shoulder and hip at one place make a matrix of zeros
_SURELY_SEEN = 0.65  # confidence from which a guessed point counts for the lengths
# Between two estimates, s: before the dimensions are settled, and after.
_EAGER_S = 0.1
_CALM_S = 0.5
# Dimensions are settled with so many lengths seen, or after so long with what the table says.
_ENOUGH_LENGTHS = 4
_ENOUGH_SAMPLES = 3
_PATIENCE_S = 1.0
# They are changed when so many estimates in a row, each of so many images, want it by more than so many sd.
_AGREEING = 3
_SURE_SAMPLES = 15
_SURE_S = 0.5
_SIGNIFICANT = 2.0
# A limb may be wrong by as much as the tolerance makes of a thigh, which is so large a part of the stature.
_THIGH_RATIO = 0.24
# Least time between two changes: it doubles from one to the next.
_FIRST_WAIT_S = 1.0
_LAST_WAIT_S = 60.0


@dataclass(frozen=True)
class BodyInput:
    """Key points of one body in one image.

    points: (18, 3) m in the optical frame, NaN where unknown. confidence: (18,) 0 to 1. head: the face frame in
    the optical frame when this human's face is tracked. systematic: relative error of the lengths between the points
    that does not go away with time: 0 for points measured in space, stature.MONOCULAR for those that are guessed from
    a colour image; points of less than 0.65 confidence then say nothing about the stature. size: see
    StatureEstimator.estimate.
    """

    id: str
    points: np.ndarray
    confidence: Optional[np.ndarray] = None
    head: Optional[Pose] = None
    systematic: float = 0.0
    size: Optional[Tuple[float, float]] = None


@dataclass(frozen=True)
class ModelledBody:
    """A posed model of one body.

    pose: body frame in the optical frame. joints: (J,) rad in the order of the layout. head: head frame in the
    optical frame. points: (18, 3) filtered key points, NaN where unknown; fitted: (18, 3) those of the model, m.
    stature, stature_sd: the newest estimate, m; stature_known: False while it is the average.
    dimensions: those of the model; revision: 0 while they are not
    settled, then 1, 2, ...: the URDF is to be made anew when it grows. residual: mean distance of points and
    fitted, m.
    """

    id: str
    pose: Pose
    joints: np.ndarray
    head: Pose
    points: np.ndarray
    fitted: np.ndarray
    stature: float
    stature_sd: float
    dimensions: Dimensions
    revision: int
    residual: float
    stature_known: bool = False


def turned_model(model: ModelledBody, rotation: ImageRotation) -> ModelledBody:
    """Return a model in the turned optical frame."""
    if not rotation.quarters:
        return model
    return replace(model, pose=rotation.pose(model.pose), head=rotation.pose(model.head),
                   points=rotation.vectors(model.points), fitted=rotation.vectors(model.fitted))


@dataclass(frozen=True)
class DimensionSettings:
    """tolerance: relative change of the stature that is worth new dimensions; of a limb, what that makes of a thigh.
    limb_lengths: estimate every segment, else only the stature with the table's mean proportions.
    delay: s, least time of watching before dimensions are settled. window: s over which lengths are kept.
    scale_sd: relative spread of size. Raises ValueError naming the setting and its legal range."""

    tolerance: float = 0.03
    limb_lengths: bool = True
    delay: float = 0.2
    window: float = 5.0
    scale_sd: float = 0.10

    def __post_init__(self) -> None:
        for name, low, high in (("tolerance", 0.001, 1.0), ("delay", 0.0, 10.0), ("window", 0.5, 120.0),
                                ("scale_sd", 0.01, 1.0)):
            value = getattr(self, name)
            if not math.isfinite(value) or not low <= value <= high:
                raise ValueError("dimension setting {} is {}, legal: {:g} to {:g}".format(name, value, low, high))


class PersonDimensions:
    """Dimensions of one person and their revision: 0 while they are not settled, then 1, 2, ... ."""

    def __init__(self, table: SegmentTable, settings: DimensionSettings) -> None:
        self._table, self._settings = table, settings
        self._estimator = StatureEstimator(table, settings.window, settings.scale_sd)
        self.estimate: StatureEstimate = self._estimator.estimate()
        """The newest estimate; it may differ from the settled dimensions by less than the tolerance."""
        self.dimensions = self._made_of(self.estimate)
        """What the person is to be modelled with: the settled ones, before that the newest."""
        self.revision = 0
        self._settled: Optional[StatureEstimate] = None
        self._due, self._allowed, self._wait, self._agreeing = -math.inf, -math.inf, _FIRST_WAIT_S, 0

    def restart(self) -> None:
        """Forget the measurements, as when time goes back; settled dimensions stay."""
        self._estimator.reset()
        self._due, self._agreeing = -math.inf, 0
        self._allowed = -math.inf if self._settled is None else math.inf

    def update(self, points: np.ndarray, stamp: float, systematic: float = 0.0,
               size: Optional[Tuple[float, float]] = None) -> None:
        """Take the key points (18, 3) m, without outliers and unfiltered, NaN missing, at `stamp` (s).

        systematic: relative error of their source's lengths, see StatureEstimator.add. size: see its `estimate`."""
        self._estimator.add(points, stamp, systematic)
        if stamp < self._due:
            return
        if self._allowed == math.inf:
            self._allowed = stamp + self._wait
        self.estimate = self._estimator.estimate(size)
        duration = self._estimator.duration
        if self._settled is None:
            self._due = stamp + _EAGER_S
            self.dimensions = self._made_of(self.estimate)
            if self._is_enough(duration):
                self._settle(stamp)
            return
        self._due = stamp + _CALM_S
        sure = self.estimate.samples >= _SURE_SAMPLES and duration >= _SURE_S
        self._agreeing = self._agreeing + 1 if sure and self._differs() else 0
        if self._agreeing >= _AGREEING and stamp >= self._allowed:
            self.dimensions = self._made_of(self.estimate)
            self._wait = min(2.0 * self._wait, _LAST_WAIT_S)
            self._settle(stamp)

    def _is_enough(self, duration: float) -> bool:
        estimate = self.estimate
        if estimate.samples < _ENOUGH_SAMPLES or duration < self._settings.delay:
            return False
        return estimate.seen >= _ENOUGH_LENGTHS or duration >= _PATIENCE_S

    def _settle(self, stamp: float) -> None:
        self._settled, self._agreeing = self.estimate, 0
        self._allowed = stamp + self._wait
        self.revision += 1

    def _differs(self) -> bool:
        """Tell whether stature or a limb is away from the settled one by more than tolerance and uncertainty."""
        new, old, tolerance = self.estimate, self._settled, self._settings.tolerance
        assert old is not None
        allowed = tolerance * old.stature
        if _differ(new.stature, old.stature, new.stature_sd, allowed):
            return True
        return self._settings.limb_lengths and any(
            _differ(new.lengths[name], old.lengths[name], new.lengths_sd[name], _THIGH_RATIO * allowed)
            for name in SEGMENTS)

    def _made_of(self, estimate: StatureEstimate) -> Dimensions:
        lengths = estimate.lengths if self._settings.limb_lengths else {}
        return Dimensions.from_segments(estimate.stature, lengths, self._table)


def _differ(new: float, old: float, spread: float, allowed: float) -> bool:
    return abs(new - old) > max(allowed, _SIGNIFICANT * spread)


class BodyModeller:
    """Models of all bodies of one camera. Time is an argument; a stamp that goes back starts the filters anew."""

    def __init__(self, interface: str = "paper", ik_solver: str = "gauss_newton",
                 table: Optional[SegmentTable] = None, stature_tolerance: float = 0.03, limb_lengths: bool = True,
                 min_confidence: float = 0.3, model_delay: float = 0.2, stature_window: float = 5.0,
                 filter_settings: Optional[FilterSettings] = None) -> None:
        """interface, ik_solver: see Layout and JointSolver. table: None: the package's own. min_confidence: points
        below it are missing. The others: see DimensionSettings and FilterSettings. Raises ValueError."""
        if not 0.0 <= min_confidence <= 1.0:
            raise ValueError("min_confidence is {}, legal: 0 to 1".format(min_confidence))
        self._table = SegmentTable.load() if table is None else table
        self.layout: Layout = layout_for(interface)
        self._solver = JointSolver(self.layout, ik_solver)
        self._filter = KeypointFilter(filter_settings or FilterSettings())
        self._settings = DimensionSettings(stature_tolerance, limb_lengths, model_delay, stature_window)
        self._min_confidence = min_confidence
        self._people: Dict[str, PersonDimensions] = {}
        self._states: Dict[str, np.ndarray] = {}
        self._stamp = -math.inf
        self.failures: Dict[str, str] = {}
        """Bodies of the last update that have no model, and why."""

    @classmethod
    def from_parameters(cls, values: BodiesSettings) -> "BodyModeller":
        """Return the one with these settings. Raises ValueError."""
        return cls(values.interface, values.ik_solver, SegmentTable.load(values.segments or None),
                   values.stature_tolerance, values.limb_lengths, values.min_keypoint_confidence,
                   values.model_delay, values.stature_window,
                   FilterSettings(process_noise_scale=values.keypoint_agility, gate=values.keypoint_gate))

    def reconfigure(self, values: BodiesSettings) -> None:
        """Take up the values of the live parameters; the bodies stay."""
        self._min_confidence = values.min_keypoint_confidence
        self._filter.settings = FilterSettings(process_noise_scale=values.keypoint_agility, gate=values.keypoint_gate)

    def reset(self) -> None:
        """Forget all bodies."""
        self._filter.reset()
        self._people.clear()
        self._states.clear()
        self.failures, self._stamp = {}, -math.inf

    def turn(self, rotation: ImageRotation) -> None:
        """Turn all bodies with the optical frame."""
        self._filter.turn(rotation)
        if self._states:
            states = WarmStart.of(list(self._states.values())).turned(rotation).split()
            self._states = dict(zip(self._states, states))

    def forget_places(self) -> None:
        """Let all bodies be where they are seen next; their dimensions and joints stay."""
        self._filter.forget_places()

    def retain(self, ids: Sequence[str]) -> None:
        """Forget all bodies but these."""
        wanted = set(ids)
        self._filter.retain(ids)
        for known in (self._people, self._states):
            for name in [name for name in known if name not in wanted]:
                del known[name]

    def update(self, bodies: Sequence[BodyInput], stamp: float,
               up: Optional[np.ndarray] = None) -> List[ModelledBody]:
        """Model the bodies seen at `stamp` (s). up: (3,) unit vector against gravity in the optical frame.

        Bodies that are not among them stay known till `retain`. One without enough points, or whose solution
        fails, is left out and named in `failures`. Raises ValueError for one id twice or a bad stamp.
        """
        if len({body.id for body in bodies}) != len(bodies) or not math.isfinite(stamp):
            raise ValueError("bodies need different ids and a finite time, not {} and {}".format(
                [body.id for body in bodies], stamp))
        if stamp < self._stamp:
            self._start_anew()
            self._stamp = stamp
        step = stamp - self._stamp if math.isfinite(self._stamp) else 0.0
        self._stamp, self.failures = stamp, {}
        known = [(body, points) for body, points in ((body, self._checked(body)) for body in bodies)
                 if points is not None]
        if not known:
            return []
        ids = [body.id for body, _ in known]
        filtered = self._filter.update(ids, np.stack([points for _, points in known]), stamp)
        good = [number for number, ((body, _), gated) in enumerate(zip(known, filtered.gated))
                if self._learn_dimensions(body, gated, stamp)]
        if len(good) < len(known):
            filtered = filtered.of(good)
        return self._solve([known[number][0] for number in good], filtered, step, up) if good else []

    def _learn_dimensions(self, body: BodyInput, points: np.ndarray, stamp: float) -> bool:
        """Take the key points (18, 3) m of a body without outliers; False, with the reason noted, for no human's."""
        if body.id not in self._people:
            self._people[body.id] = PersonDimensions(self._table, self._settings)
        if body.systematic > 0.0 and body.confidence is not None:
            points = np.where((np.asarray(body.confidence) >= _SURELY_SEEN)[:, None], points, np.nan)
        try:
            self._people[body.id].update(points, stamp, body.systematic, body.size)
        except (ValueError, ArithmeticError, np.linalg.LinAlgError) as error:
            self._fail(body.id, "its lengths are no human's: {}".format(error))
            return False
        return True

    def _start_anew(self) -> None:
        self._filter.reset()
        self._states.clear()
        for person in self._people.values():
            person.restart()

    def _checked(self, body: BodyInput) -> Optional[np.ndarray]:
        """Points (18, 3) with NaN for all that is not to be used; None, with the reason noted, without any."""
        points = np.asarray(body.points, dtype=np.float64)
        if not 0.0 <= body.systematic <= 1.0:
            self.failures[body.id] = "its systematic error is {}, not 0 to 1".format(body.systematic)
            return None
        if points.shape != (18, 3):
            self.failures[body.id] = "its key points have the shape {}, not (18, 3)".format(points.shape)
            return None
        if body.confidence is not None:
            confidence = np.asarray(body.confidence, dtype=np.float64)
            if confidence.shape != (18,):
                self.failures[body.id] = "its confidences have the shape {}, not (18,)".format(confidence.shape)
                return None
            points = np.where((confidence >= self._min_confidence)[:, None], points, np.nan)
        if np.isfinite(points).all(axis=1).sum() < _LEAST_POINTS:
            self.failures[body.id] = "fewer than {} of its key points are known".format(_LEAST_POINTS)
            return None
        return points

    def _solve(self, bodies: Sequence[BodyInput], filtered: FilteredPoints, step: float,
               up: Optional[np.ndarray]) -> List[ModelledBody]:
        """Solve all bodies, one by one where that fails together, so that one cannot take the others with it."""
        try:
            return self._solve_batch(bodies, filtered, step, up)
        except (ValueError, ArithmeticError, np.linalg.LinAlgError) as error:
            if len(bodies) == 1:
                self._fail(bodies[0].id, "no solution: {}".format(error))
                return []
        return [model for number, body in enumerate(bodies)
                for model in self._solve([body], filtered.of([number]), step, up)]

    def _solve_batch(self, bodies: Sequence[BodyInput], filtered: FilteredPoints, step: float,
                     up: Optional[np.ndarray]) -> List[ModelledBody]:
        points = filtered.smooth
        people = [self._people[body.id] for body in bodies]
        dimensions = [person.dimensions for person in people]
        solution = self._solver.solve(points, dimensions, [self._states.get(body.id) for body in bodies], step, up,
                                      [body.head for body in bodies], filtered.noise)
        residual = _mean_distance(points, solution.keypoints)
        models = []
        for n, (body, person) in enumerate(zip(bodies, people)):
            if not solution.solved[n]:
                self.failures[body.id] = "its trunk cannot be told: neither shoulders nor hips are known"
                self._states[body.id] = solution.states[n]
                continue
            if not np.linalg.det(solution.rotation[n]) > _LEAST_DETERMINANT:
                self._fail(body.id, "its trunk is a point")
                continue
            if not residual[n] <= _WORST_RESIDUAL_M or not np.isfinite(solution.q[n]).all():
                self._fail(body.id, "the model misses its key points by {:.2f} m".format(residual[n]))
                continue
            self._states[body.id] = solution.states[n]
            models.append(ModelledBody(
                body.id, Pose(solution.rotation[n], solution.position[n]), solution.q[n],
                Pose(solution.head_rotation[n], solution.head_position[n]), points[n], solution.keypoints[n],
                person.estimate.stature, person.estimate.stature_sd, person.dimensions, person.revision,
                float(residual[n]), person.estimate.known))
        return models

    def _fail(self, name: str, reason: str) -> None:
        self.failures[name] = reason
        self._states.pop(name, None)


def _mean_distance(points: np.ndarray, fitted: np.ndarray) -> np.ndarray:
    """Mean distance (N,) m over the known points (N, 18, 3); NaN when the fit is not finite, 0 without points."""
    apart = points - fitted
    distance = np.sqrt(np.einsum("nki,nki->nk", apart, apart))
    seen = ~np.isnan(points[..., 0])
    return np.where(seen, distance, 0.0).sum(axis=1) / np.maximum(seen.sum(axis=1), 1)
