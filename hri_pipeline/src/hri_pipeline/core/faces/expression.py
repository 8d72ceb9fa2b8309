"""Expression of a face: a network and the action units, fused and filtered over time.

Tables: which action units make which expression (FACS, EMFACS), and where expressions lie in the plane of valence and
arousal.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Callable, Dict, Optional, Sequence, Tuple, Union

import numpy as np

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces.action_units import SLOTS, ActionUnits
from hri_pipeline.core.faces.crops import aligned_crop
from hri_pipeline.core.onnx import FETCH_HINT, ModelError, OnnxModel

NEUTRAL, HAPPY, SAD, ANGRY = "neutral", "happy", "sad", "angry"
SCARED, DISGUSTED, SURPRISED = "scared", "disgusted", "surprised"

CATEGORIES: Tuple[str, ...] = (NEUTRAL, HAPPY, SAD, ANGRY, SCARED, DISGUSTED, SURPRISED)
"""Ekman's categories under the names of hri_msgs/Expression, in the order of the network's outputs."""

PROTOTYPES: Dict[str, Tuple[Tuple[int, float], ...]] = {
    NEUTRAL: (),
    HAPPY: ((12, 4.0), (6, 1.5), (15, -2.0), (4, -1.0)),
    SAD: ((15, 3.0), (1, 1.5), (4, 1.5), (17, 1.0), (12, -4.0), (25, -0.5)),
    ANGRY: ((4, 2.5), (7, 1.0), (23, 1.5), (24, 1.5), (5, 1.0), (17, 0.5), (1, -1.5), (12, -4.0)),
    SCARED: ((20, 2.0), (5, 1.5), (1, 1.0), (2, 0.5), (4, 1.0), (26, 0.5), (25, 0.5), (12, -4.0)),
    DISGUSTED: ((9, 3.0), (10, 2.0), (17, 0.5), (4, 0.5), (12, -4.0)),
    SURPRISED: ((5, 1.5), (26, 2.0), (1, 1.5), (2, 1.5), (27, 1.5), (4, -2.0), (12, -3.0)),
}
"""Action unit and weight in the category's log-probability, per full intensity.

The units with positive weights are those of the prototypes in the FACS Investigator's Guide and EMFACS (Ekman, Friesen
and Hager 2002; Ekman and Friesen 1983): happy 6+12; sad 1+4+15(+17); angry 4+5+7+23/24; scared 1+2+4+5+20+25/26;
disgusted 9/10+17; surprised 1+2+5B+26/27. The weights are ours: larger for units that few other categories share and
that the mesh measures well; negative ones stand for units that contradict the category.
"""

NEUTRAL_WEIGHT = 1.5
"""Log-probability that a face without action units is neutral, over that of any other category."""

PLANE: Dict[str, Tuple[float, float]] = {
    NEUTRAL: (0.0, 0.0),
    HAPPY: (0.76, 0.48),
    SAD: (-0.63, -0.27),
    ANGRY: (-0.51, 0.59),
    SCARED: (-0.64, 0.60),
    DISGUSTED: (-0.60, 0.35),
    SURPRISED: (0.40, 0.67),
}
"""Valence and arousal of each category: ratings of emotion words by Russell and Mehrabian (1977), "Evidence for a
three-factor theory of emotions", J. Research in Personality 11; neutral is the origin."""


INPUT_SIZE = 112
MARGINS = (1.05, 1.15)
"""Sides of the network's two crops over that of the mesh; the second one is mirrored, and both opinions are averaged.
On 25 pictures that nothing was tuned on, margins of 1.0, 1.15, 1.3 gave 21, 21, 16 right, on 36 others 27, 29, 30."""
TEMPERATURE = 2.5
"""Divisor of the network's log-probabilities, which are too sure of themselves: on the 43 faces of
scripts/benchmarks/expressions.txt it is right in 38 and gives 0.98 on average; 2.5 gives the least negative
log-likelihood."""
NETWORK_MEMORY = 1.0
"""Time (s) for which the network's last output is used: it need not run on every image."""
UNITS_WEIGHT = 0.5
"""Weight of the action units' log-probabilities beside those of the network, which is right more often (39 of the 43,
they 31), and sees tears and wrinkles: raised corners of a mouth that weeps are no smile."""
LEAST_CONFIDENCE = 0.6
"""Below it no expression is told: on the tuning half of expressions.txt all 16 of 19 that are told are right."""
_TURNED, _PROFILE = np.deg2rad(30.0), np.deg2rad(65.0)
"""Turn (rad) away from the camera with full confidence, and with none."""
_SMALL, _LARGE = 25.0, 50.0
"""Width (px) of a face with no confidence, and from which it is full."""
SMOOTHING_TIME = 0.3
"""Time constant (s) of the running mean of the probabilities."""
HOLD_TIME, HOLD_MARGIN = 0.25, 0.10
"""Another category must lead by this margin for this time (s) before it is published."""
LONGEST_GAP = 2.0
"""Time (s) without anything after which the past is forgotten."""

_WEIGHTS = np.zeros((len(CATEGORIES), SLOTS))
for _row, _category in enumerate(CATEGORIES):
    for _code, _weight in PROTOTYPES[_category]:
        _WEIGHTS[_row, _code] = _weight
_USED = np.abs(_WEIGHTS).sum(axis=0) > 0.0
_BIAS = np.array([NEUTRAL_WEIGHT if category == NEUTRAL else 0.0 for category in CATEGORIES])
_PLANE = np.array([PLANE[category] for category in CATEGORIES])
_FLOOR, _LEAST = 1e-4, 1e-9
_UNKNOWN_STILL = 0.6
"""Part of NEUTRAL_WEIGHT that counts while nothing of the person's own neutral is known."""


@dataclass(frozen=True)
class ExpressionEstimate:
    """category: one of CATEGORIES (names of hri_msgs/Expression); valence, arousal: -1 to 1; confidence: 0 to 1,
    probability that the category is right."""

    category: str
    valence: float
    arousal: float
    confidence: float


class ExpressionModel:
    """The seven-class network of face-api (face_expression.onnx, MIT) on several faces in one batch."""

    def __init__(self, path: Union[str, Path], providers: Sequence[str] = ("cpu",),
                 notify: Optional[Callable[[str], None]] = None) -> None:
        """Raises ModelError naming the file when it is missing or another model."""
        self._model = OnnxModel(path, providers, inputs=("image",), outputs=("expression",), notify=notify,
                                most_on_cpu=1)
        trial = self._model.run({"image": np.zeros((1, INPUT_SIZE, INPUT_SIZE, 3), np.float32)})["expression"]
        if trial.shape != (1, len(CATEGORIES)):
            raise ModelError("model file {} gives {} instead of {} expressions; it is another model: {}".format(
                path, trial.shape, len(CATEGORIES), FETCH_HINT))

    @staticmethod
    def crops(bgr: np.ndarray, points: np.ndarray, camera: Optional[CameraModel] = None) -> np.ndarray:
        """Cut the network's two views (2, 112, 112, 3) uint8 BGR of a face; points: mesh (478, 3) px; camera: see
        `aligned_crop`. Raises ValueError for points that are not finite."""
        near, wide = (aligned_crop(bgr, points, INPUT_SIZE, margin, camera) for margin in MARGINS)
        return np.stack([near, wide[:, ::-1]])

    def probabilities(self, views: Sequence[np.ndarray]) -> np.ndarray:
        """(N, 7) probabilities of CATEGORIES for N results of `crops`: the geometric mean of both views, tempered (see
        TEMPERATURE)."""
        if not len(views):
            return np.empty((0, len(CATEGORIES)))
        batch = np.concatenate(views)[..., ::-1].astype(np.float32)
        raw = self._model.run({"image": batch})["expression"].astype(np.float64)
        logs = np.log(np.maximum(raw, _LEAST)).reshape(len(views), len(MARGINS), -1).mean(axis=1)
        return _softmax(logs / TEMPERATURE)


class ExpressionTracker:
    """Expression of one face over time. Not thread-safe."""

    def __init__(self) -> None:
        self._last = self._network_stamp = self._rival_since = -np.inf
        self._network: Optional[np.ndarray] = None
        self._agreement = np.ones(len(CATEGORIES))
        self._mean: Optional[np.ndarray] = None
        self._shown = self._rival = -1

    def update(self, probabilities: Optional[np.ndarray], action_units: Optional[ActionUnits], stamp: float,
               quality: float = 1.0) -> Optional[ExpressionEstimate]:
        """Return the expression at a time (s); one that goes back is a new start.

        probabilities: (7,) of the network, None when it was not run on this image; action_units: None when they are
        not estimated. Each suffices alone. quality: 0 to 1, how well the face is seen (`view_quality`): lowers the
        confidence. None while nothing is known. Raises ValueError for probabilities of another shape; such that are
        not finite are left out.
        """
        if stamp < self._last or stamp - self._last > LONGEST_GAP:
            self.reset()
        self._remember(probabilities, stamp)
        now = self._fuse(action_units, stamp)
        if now is None:
            return None
        gain = 1.0 if self._mean is None else 1.0 - np.exp((self._last - stamp) / SMOOTHING_TIME)
        mean = now[0] if self._mean is None else self._mean + (now[0] - self._mean) * gain
        self._agreement += gain * (now[1] - self._agreement)
        self._mean, self._last = mean, stamp
        self._decide(stamp)
        valence, arousal = mean @ _PLANE
        confidence = float(mean[self._shown] * np.sqrt(self._agreement[self._shown]) * min(max(quality, 0.0), 1.0))
        return ExpressionEstimate(CATEGORIES[self._shown], float(valence), float(arousal), confidence)

    def reset(self) -> None:
        """Forget the past."""
        self._last = self._network_stamp = self._rival_since = -np.inf
        self._network = self._mean = None
        self._agreement = np.ones(len(CATEGORIES))
        self._shown = self._rival = -1

    def _remember(self, probabilities: Optional[np.ndarray], stamp: float) -> None:
        if probabilities is None:
            return
        probabilities = np.asarray(probabilities, dtype=np.float64)
        if probabilities.shape != (len(CATEGORIES),):
            raise ValueError("expected {} probabilities, got {}".format(len(CATEGORIES), probabilities.shape))
        if np.isfinite(probabilities).all() and probabilities.min() >= 0.0 and probabilities.sum() > 0.0:
            self._network, self._network_stamp = probabilities / probabilities.sum(), stamp

    def _fuse(self, action_units: Optional[ActionUnits], stamp: float) -> Optional[Tuple[np.ndarray, np.ndarray]]:
        """Product of both probabilities (7,), and how far both agree on each category (7,); None when there is neither.

        Agreement: the probability of the category over that of the best one, of both opinions multiplied.
        """
        network = units = None
        if self._network is not None and stamp - self._network_stamp <= NETWORK_MEMORY:
            network = np.log(np.maximum(self._network, _FLOOR))
        if action_units is not None:
            units = unit_scores(action_units)
        if network is None or units is None:
            alone = network if units is None else units
            return None if alone is None else (_softmax(alone), np.ones(len(CATEGORIES)))
        agreement = np.exp(network - network.max() + units - units.max())
        return _softmax(network + UNITS_WEIGHT * units), agreement

    def _decide(self, stamp: float) -> None:
        """Hysteresis: the published category changes only for one that leads clearly, for some time."""
        assert self._mean is not None
        best = int(np.argmax(self._mean))
        if self._shown < 0 or best == self._shown:
            self._shown, self._rival = best, -1
            return
        if self._mean[best] - self._mean[self._shown] < HOLD_MARGIN:
            self._rival = -1
        elif best != self._rival:
            self._rival, self._rival_since = best, stamp
        elif stamp - self._rival_since >= HOLD_TIME:
            self._shown, self._rival = best, -1


def view_quality(mesh: np.ndarray, turn: Optional[float]) -> float:
    """Return how well a face is seen for its expression, 0 to 1.

    mesh: (478, 2 or more) px; turn: angle (rad) between face and camera, None unknown.
    """
    width = float(np.ptp(mesh[:, 0]))
    size = (width - _SMALL) / (_LARGE - _SMALL)
    facing = 1.0 if turn is None else (_PROFILE - turn) / (_PROFILE - _TURNED)
    return min(max(size, 0.0), 1.0) * min(max(facing, 0.0), 1.0)


def unit_scores(units: ActionUnits) -> Optional[np.ndarray]:
    """Log-probabilities (7,), up to a constant, that the action units give; None when none of them can be seen.

    Intensities are scaled with their confidence. A face without movement counts as neutral only as far as the person's
    own neutral is known.
    """
    confidence = units.confidence.astype(np.float64)
    seen = float(confidence[_USED].mean())
    if not seen > 0.01:
        return None
    still = min(1.0, 2.0 * seen) * (_UNKNOWN_STILL + (1.0 - _UNKNOWN_STILL) * units.neutral_known)
    return _WEIGHTS @ (units.intensity.astype(np.float64) * confidence) + _BIAS * still


def _softmax(logs: np.ndarray) -> np.ndarray:
    values = np.exp(logs - logs.max(axis=-1, keepdims=True))
    return values / values.sum(axis=-1, keepdims=True)
