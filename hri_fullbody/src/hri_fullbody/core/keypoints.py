"""The 18 key points of hri_msgs/Skeleton2D, and how they come from the 33 landmarks of BlazePose."""

from __future__ import annotations

import math
from typing import Optional, Tuple

import numpy as np

from hri_pipeline.core.geometry import median_of_few

(NOSE, NECK, RIGHT_SHOULDER, RIGHT_ELBOW, RIGHT_WRIST, LEFT_SHOULDER, LEFT_ELBOW, LEFT_WRIST,
 RIGHT_HIP, RIGHT_KNEE, RIGHT_ANKLE, LEFT_HIP, LEFT_KNEE, LEFT_ANKLE,
 LEFT_EYE, RIGHT_EYE, LEFT_EAR, RIGHT_EAR) = range(18)

# BlazePose's own numbers (left and right are the subject's).
BLAZE_LEFT_SHOULDER, BLAZE_RIGHT_SHOULDER = 11, 12
BLAZE_LEFT_ELBOW, BLAZE_RIGHT_ELBOW = 13, 14
BLAZE_LEFT_WRIST, BLAZE_RIGHT_WRIST = 15, 16
BLAZE_LEFT_HIP, BLAZE_RIGHT_HIP = 23, 24
BLAZE_LEFT_KNEE, BLAZE_RIGHT_KNEE = 25, 26
BLAZE_LEFT_ANKLE, BLAZE_RIGHT_ANKLE = 27, 28
BLAZE_INNER_EYES = (1, 4)
BLAZE_EARS = (7, 8)
BLAZE_NOSE = 0

_UPPER = BLAZE_RIGHT_SHOULDER + 1      # head and shoulders
# Thighs that hang out of the image: degrees between thigh and trunk, and between thigh and the image's y axis; in
# trunks in the image what is seen below the hips, and how far above the rim a knee may be; least share that is seen.
_LEAVING_HIP, _LEAVING_THIGH, _LEAVING_SEEN, _LEAVING_RIM, _LEAVING_SHARE = 35.0, 40.0, 0.35, 0.1, 0.5
_TO_SHOULDERS = np.array([1.0, 1.0, -1.0, -1.0])
# Wrist, knuckles of the little and of the index finger; left, right.
_HANDS = ((BLAZE_LEFT_WRIST, 17, 19), (BLAZE_RIGHT_WRIST, 18, 20))
# Pairs of BlazePose landmarks whose mean is the key point; equal numbers where it is one landmark.
_SOURCES = np.array([
    (0, 0), (BLAZE_LEFT_SHOULDER, BLAZE_RIGHT_SHOULDER),
    (12, 12), (14, 14), (16, 16),
    (11, 11), (13, 13), (15, 15),
    (24, 24), (26, 26), (28, 28),
    (23, 23), (25, 25), (27, 27),
    (2, 2), (5, 5), (7, 7), (8, 8),
])

# How often a key point that the network sees is within a quarter of the trunk of where it is, by how much the body
# trembles: jitter (trunks) at which it is in half of the cases, and the exponent. Fitted to 20 people of photographs,
# drawn small, out of focus, noisy and dark. Hips are often hidden by clothes, arms or a table, and are placed worst.
_HALF_RIGHT = np.full(18, 0.31)
_HALF_RIGHT[[RIGHT_WRIST, LEFT_WRIST]] = 0.21
_HALF_RIGHT[[RIGHT_HIP, LEFT_HIP]] = 0.15
_HALF_RIGHT[[RIGHT_KNEE, RIGHT_ANKLE, LEFT_KNEE, LEFT_ANKLE]] = 0.27
_DECLINE, _LEAST_JITTER = 2.34, 0.01
_JITTER_LOOKS = 8.0
# Most time (s) between two looks that are compared. People move: acceleration (trunks/s^2) of the middle of a body that
# three quarters of the moments of recorded people stay below.
_JITTER_STEP_S, _PEOPLE_ACCELERATE = 0.5, 4.0
_LEAST_TRUNK = 0.19     # of the body's extent: a body that bends towards the camera has hardly any trunk in the image

EDGES: Tuple[Tuple[int, int], ...] = (
    (NECK, RIGHT_SHOULDER), (NECK, LEFT_SHOULDER),
    (RIGHT_SHOULDER, RIGHT_ELBOW), (RIGHT_ELBOW, RIGHT_WRIST),
    (LEFT_SHOULDER, LEFT_ELBOW), (LEFT_ELBOW, LEFT_WRIST),
    (NECK, RIGHT_HIP), (RIGHT_HIP, RIGHT_KNEE), (RIGHT_KNEE, RIGHT_ANKLE),
    (NECK, LEFT_HIP), (LEFT_HIP, LEFT_KNEE), (LEFT_KNEE, LEFT_ANKLE),
    (RIGHT_HIP, LEFT_HIP), (NECK, NOSE),
    (NOSE, RIGHT_EYE), (RIGHT_EYE, RIGHT_EAR), (NOSE, LEFT_EYE), (LEFT_EYE, LEFT_EAR),
)


def to_18_points(points: np.ndarray) -> np.ndarray:
    """Pick the 18 key points out of BlazePose landmarks (33 or more, D), any unit: (18, D).

    The neck is the middle between the shoulders. Raises ValueError for fewer than 33 landmarks.
    """
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or len(points) < 33:
        raise ValueError("BlazePose gives 33 landmarks, not an array of shape {}".format(points.shape))
    return (points[_SOURCES[:, 0]] + points[_SOURCES[:, 1]]) / 2.0


def wrist_to_knuckles(points: np.ndarray, confidence: np.ndarray, least: float) -> np.ndarray:
    """Way (2, 3) from wrist to the middle of the knuckles of index and little finger, left and right, of BlazePose
    landmarks (33, 3); NaN where one of these is less sure than `least`. confidence: (33,)."""
    ways = np.full((2, 3), np.nan)
    for side, (wrist, little, index) in enumerate(_HANDS):
        if min(confidence[wrist], confidence[little], confidence[index]) >= least:
            ways[side] = 0.5 * (points[little] + points[index]) - points[wrist]
    return ways


def trunk_in_image(landmarks: np.ndarray, world: np.ndarray) -> float:
    """Length (m) of the trunk, from the middle of the shoulders to that of the hips: across the image at the scale of
    head and shoulders in it, along it as in `world`; NaN where these have no scale.

    landmarks: BlazePose's (33 or more, 2 or more) px. world: the same body (33, 3) m, x and y as in the image.
    """
    trunk = [BLAZE_LEFT_SHOULDER, BLAZE_RIGHT_SHOULDER, BLAZE_LEFT_HIP, BLAZE_RIGHT_HIP]
    pixels, metres = landmarks[:_UPPER, :2], world[:_UPPER, :2]
    metres = metres - metres.sum(axis=0) / _UPPER
    scale = float(np.vdot(pixels, metres)) / max(float(np.vdot(metres, metres)), 1e-9)
    (x, y), z = 0.5 * (_TO_SHOULDERS @ landmarks[trunk, :2]), 0.5 * float(_TO_SHOULDERS @ world[trunk, 2])
    return math.hypot(x / scale, y / scale, z) if scale > 1e-6 else math.nan


def thighs_leave_image(landmarks: np.ndarray, world: np.ndarray, height: float) -> bool:
    """Tell whether both thighs hang down out of an image `height` px high and are seen for half of their length.

    landmarks, world: see trunk_in_image. Knees that the image does not show are placed rightly as long as so much of
    the thighs is seen; of who sits at a table the hips are hidden, too, or the thighs are not seen to hang.
    """
    hips, knees = [BLAZE_LEFT_HIP, BLAZE_RIGHT_HIP], [BLAZE_LEFT_KNEE, BLAZE_RIGHT_KNEE]
    shoulders = [BLAZE_LEFT_SHOULDER, BLAZE_RIGHT_SHOULDER]
    x, y = (0.5 * (_TO_SHOULDERS @ landmarks[shoulders + hips, :2])).tolist()
    trunk, below, rim = math.hypot(x, y), height - landmarks[hips, 1], height - landmarks[knees, 1]
    if not (min(below) > _LEAVING_SEEN * trunk and max(rim) <= _LEAVING_RIM * trunk):
        return False
    thighs, down = world[knees] - world[hips], (world[hips] - world[shoulders]).mean(axis=0)
    lengths = np.maximum(np.linalg.norm(thighs, axis=1), 1e-6)
    straight = thighs @ down > math.cos(math.radians(_LEAVING_HIP)) * np.linalg.norm(down) * lengths
    hanging = thighs[:, 1] > math.cos(math.radians(_LEAVING_THIGH)) * lengths
    share = below / np.maximum(landmarks[knees, 1] - landmarks[hips, 1], 1e-6)
    return bool((straight & hanging).all() and share.mean() > _LEAVING_SHARE)


def confidence_18(landmark_confidence: np.ndarray) -> np.ndarray:
    """Confidence of the 18 key points (18,) of that of the landmarks (33 or more,), 0 to 1.

    The neck is as sure as the less sure shoulder.
    """
    values = np.asarray(landmark_confidence, dtype=np.float64)
    return np.minimum(values[_SOURCES[:, 0]], values[_SOURCES[:, 1]])


class Jitter:
    """How much a body trembles in the image from look to look, and how often its key points are right because of that.

    The network is as sure of small, blurred and noisy bodies as of clear ones, but what it says of them changes: the
    second difference of the key points over time tells, to which people's own motion adds little from 10 looks a second
    on; below, what is usual of it is taken off. What all points do together tells as much as the rest, but is left out
    while the camera turns or shakes.

    Attributes
    ----------
    reliability : (18,) array
        Share of the key points that are right within a quarter of the trunk where they are seen; 1 while nothing is
        known.
    """

    def __init__(self) -> None:
        self.reliability = np.ones(18)
        self._looks = 0
        self._mean_log = 0.0
        self.reset()

    def reset(self) -> None:
        """Compare no later look with those before; what is known of the jitter stays."""
        self._last: Optional[np.ndarray] = None
        self._way: Optional[np.ndarray] = None
        self._stamp = self._step = 0.0
        self._carried = False

    def update(self, points: np.ndarray, extent: float, stamp: float, carried: bool = False) -> None:
        """Take the unfiltered key points (18, 2) px of a look at `stamp` (s).

        extent: size of the body, px. carried: whether the camera has turned since the look before.
        """
        step = stamp - self._stamp
        if self._last is None or not 0.0 < step <= _JITTER_STEP_S:
            self._last, self._way, self._stamp = points, None, stamp
            return
        way = points - self._last
        if self._way is not None:
            change = way - step / self._step * self._way
            if carried or self._carried:
                change = change - [median_of_few(change[:, 0]), median_of_few(change[:, 1])]
            self._compare(change, step, max(_trunk(points), _LEAST_TRUNK * extent, 1.0))
        self._last, self._way, self._stamp, self._step, self._carried = points, way, stamp, step, carried

    def _compare(self, change: np.ndarray, step: float, trunk: float) -> None:
        """change: (18, 2) px, of the way of `step` s against that of the step before."""
        ratio = step / self._step
        # A change of three independent errors has this many times their deviation.
        errors = math.sqrt(1.0 + (1.0 + ratio) ** 2 + ratio * ratio)
        moved = 0.5 * _PEOPLE_ACCELERATE * step * (step + self._step)
        x, y = change.T
        seen = median_of_few(np.hypot(x, y)) / trunk
        jitter = math.sqrt(max(seen * seen - moved * moved, 0.0)) / errors
        self._looks += 1
        self._mean_log += (math.log(jitter + _LEAST_JITTER) - self._mean_log) / min(self._looks, _JITTER_LOOKS)
        self.reliability = 1.0 / (1.0 + (math.exp(self._mean_log) / _HALF_RIGHT) ** _DECLINE)


def _trunk(points: np.ndarray) -> float:
    """Length (px) of the trunk in the image, of key points (18, 2)."""
    x, y = (points[NECK] - 0.5 * (points[LEFT_HIP] + points[RIGHT_HIP])).tolist()
    return math.hypot(x, y)
