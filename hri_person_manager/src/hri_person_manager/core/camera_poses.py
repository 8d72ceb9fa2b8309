"""The poses of fixed cameras by what several of them see at one time: key points of somebody who walks, or the corners
of a board.

The first two cameras come from the essential matrix, each other one from the points that are known by then, and all are
refined together so that the rays of each point meet (bundle adjustment; B. Triggs et al., Vision Algorithms 1999). The
points are eliminated: for given cameras each is where its rays pass nearest to each other. Images alone do not give
the scale: it comes from the stature of the person, the squares of the board, or the distance of two cameras.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import AbstractSet, Dict, Hashable, List, Mapping, Sequence, Tuple, cast

import cv2
import numpy as np
from scipy.optimize import least_squares

from hri_pipeline.core.geometry import Pose

STEP_S, GAP_S = 0.1, 0.3
STARTS = 8                  # essential matrices by different draws of points
FEWEST_POINTS = 30          # that two cameras have to share
OUTLIER = 0.02              # of a ray, x/z: 15 px of 750; a key point that is so far off is wrong
EYES_TO_ANKLES = 0.897      # of the stature: eyes at .936, ankles at .039 (D. Winter, Biomechanics, 2009)
NECK_TO_ANKLES = 0.779      # shoulders at .818
_PARTS = (("eye", "ear", "nose"), ("neck", "shoulder", "elbow", "wrist"), ("hip", "knee", "ankle"))
_TIMES = 100                # of all, that tell how certain poses are
UPRIGHT = 70.0              # percentile of the heights of somebody who walks: legs that are straight, and no noise
Rays = Mapping[Hashable, np.ndarray]


class CalibrationError(ValueError):
    """The poses cannot be told from what was seen."""


@dataclass(frozen=True)
class CameraPoses:
    """poses: of each camera, in the first one's optical frame; points: (3,) by key. Both in m after scaled(). residual:
    median angle (rad) by which the rays of a point miss it."""

    poses: Tuple[Pose, ...]
    points: Dict[Hashable, np.ndarray]
    residual: float

    def scaled(self, factor: float) -> "CameraPoses":
        """Return all lengths times `factor`."""
        return CameraPoses(tuple(Pose(pose.rotation, factor * pose.translation) for pose in self.poses),
                           {key: factor * point for key, point in self.points.items()}, self.residual)


def solve_poses(cameras: Sequence[Rays]) -> CameraPoses:
    """Return the poses of cameras of an unknown scale.

    Parameters
    ----------
    cameras : sequence of mappings
        For each camera the undistorted image points (2,), x/z and y/z, by a key that means the same point at the same
        time for all cameras.

    Raises
    ------
    CalibrationError
        Where a camera shares too little with the others.
    """
    if len(cameras) < 2:
        raise CalibrationError("one camera has no pose relative to others; name two or more")
    shared = [len(_shared(cameras[0], other)[0]) for other in cameras]
    begins = [number for number in range(1, len(cameras)) if shared[number] >= FEWEST_POINTS]
    if not begins:
        raise CalibrationError("the first camera shares {} points with another one, {} are needed: walk where both "
                               "see you".format(max(shared[1:]), FEWEST_POINTS))
    # Two cameras that look at each other are a bad beginning, whatever they share; and an essential matrix of some
    # points may lead to poses that fit all points worse than others.
    return min((_solved_from(cameras, number, start) for number in begins for start in range(STARTS)),
               key=lambda found: found.residual / len(found.points))


def deviations(cameras: Sequence[Rays], found: CameraPoses) -> List[Tuple[float, float]]:
    """Return how certain the poses are: standard deviations of place (unit of `found`) and direction (rad) of each
    camera but the first; infinite where they cannot be told without one part of the points.

    A jackknife over head, arms and legs (of a board: thirds of the corners; R. Miller, "The jackknife - a review",
    Biometrika, 1974). A network puts a key point that is seen from the front and from behind into two places, by
    centimetres, in all images: the noise of single images says too little. The error of the scale is not in it. Of
    seven poses of real cameras before which somebody stepped to and fro the errors in direction were .2 to 2.4 times
    what this says.

    cameras: as for `solve_poses`, keys (time, name).
    """
    seen = [cast(Mapping[Tuple[float, str], np.ndarray], rays) for rays in cameras]
    times = sorted({time for rays in seen for time, _ in rays})
    kept = set(times[::max(1, len(times) // _TIMES)])
    names = sorted({name for rays in seen for _, name in rays})
    part = {name: _part(name, number) for number, name in enumerate(names)}
    reach = sum(float(np.linalg.norm(pose.translation)) for pose in found.poses)
    sums = np.zeros((len(cameras), 2))
    for left_out in range(len(_PARTS)):
        try:
            other = solve_poses([{(time, name): ray for (time, name), ray in rays.items()
                                  if time in kept and part[name] != left_out} for rays in seen])
        except CalibrationError:
            return [(math.inf, math.inf)] * (len(cameras) - 1)
        other = other.scaled(reach / max(1e-9, sum(float(np.linalg.norm(pose.translation)) for pose in other.poses)))
        sums += np.square([one.differs(two) for one, two in zip(other.poses, found.poses)])
    share = (len(_PARTS) - 1.0) / len(_PARTS)
    return [(math.sqrt(share * place), math.sqrt(share * turn)) for place, turn in sums[1:].tolist()]


def _part(name: str, number: int) -> int:
    """The part of the body of a key point, a third of the others by their number."""
    for part, words in enumerate(_PARTS):
        if any(word in name for word in words):
            return part
    return number % len(_PARTS)


def _solved_from(cameras: Sequence[Rays], number: int, start: int) -> CameraPoses:
    """The poses, beginning with the first camera and one of the others, by the points that `start` draws."""
    placed = _first_two(cameras, number, start)
    while len(placed) < len(cameras):
        _place_next(cameras, placed)
    chosen = _Bundle(cameras, placed).refined()
    for _ in range(2):      # once more without the points that are wrong
        _, errors = chosen.triangulate(chosen.start)
        limit = min(OUTLIER, 4.0 * float(np.median(errors)))
        chosen = chosen.without({key for key, error in zip(chosen.keys, errors) if error > limit}).refined()
    points, errors = chosen.triangulate(chosen.start)
    good = errors < OUTLIER
    return CameraPoses(chosen.poses(chosen.start), {key: point for key, point, is_good in zip(
        chosen.keys, points, good) if is_good}, float(np.median(errors)))


def at_common_times(tracks: Sequence[Sequence[Tuple[float, Mapping[str, np.ndarray]]]]) -> List[Dict[Hashable,
                                                                                                     np.ndarray]]:
    """Return for each camera the image points (2,) by (time, name), at times that all cameras share, STEP_S apart:
    between two images that are at most GAP_S apart a point moves straight on.

    tracks: for each camera the stamps (s), rising, with the points (2,) by name.
    """
    result: List[Dict[Hashable, np.ndarray]] = []
    for track in tracks:
        found: Dict[Hashable, np.ndarray] = {}
        for (before, old), (after, new) in zip(track, track[1:]):
            if not 0.0 < after - before <= GAP_S:
                continue
            for number in range(math.ceil(before / STEP_S), math.ceil(after / STEP_S)):
                share = (number * STEP_S - before) / (after - before)
                found.update(((number, name), (1.0 - share) * old[name] + share * new[name]) for name in old
                             if name in new)
        result.append(found)
    return result


def stature_scale(points: Mapping[Hashable, np.ndarray], stature: float) -> float:
    """Return by what to multiply lengths so that the person is `stature` m tall.

    points: (3,) by (time, name): left_ankle, right_ankle, and left_eye, right_eye, or neck. Raises CalibrationError
    where nobody is seen from head to foot.
    """
    told = []
    by_time = _by_time(points)
    for names, share in ((("left_eye", "right_eye"), EYES_TO_ANKLES), (("neck", "neck"), NECK_TO_ANKLES)):
        heights = [float(np.linalg.norm(_middle(body, *names) - _middle(body, "left_ankle", "right_ankle")))
                   for body in by_time.values() if {*names, "left_ankle", "right_ankle"} <= body.keys()]
        if len(heights) >= 10:
            told.append(share * stature / float(np.percentile(heights, UPRIGHT)))
    if not told:
        raise CalibrationError("nobody is seen from the head to the ankles by two cameras at once: step back, or tell "
                               "the distance of the cameras")
    return told[0]


def board_scale(points: Mapping[Hashable, np.ndarray], neighbours: Sequence[Tuple[str, str]],
                square: float) -> float:
    """Return by what to multiply lengths so that neighbouring corners (pairs of names) of a board are `square` m
    apart; points: (3,) by (time, name of the corner). Raises CalibrationError where no two neighbours are seen."""
    sides = [float(np.linalg.norm(board[one] - board[other])) for board in _by_time(points).values()
             for one, other in neighbours if one in board and other in board]
    if not sides:
        raise CalibrationError("two cameras never saw neighbouring corners of the board at once")
    return square / float(np.median(sides))


def _by_time(points: Mapping[Hashable, np.ndarray]) -> Dict[float, Dict[str, np.ndarray]]:
    found: Dict[float, Dict[str, np.ndarray]] = {}
    for key, point in points.items():
        time, name = cast(Tuple[float, str], key)
        found.setdefault(time, {})[name] = point
    return found


def _middle(body: Mapping[str, np.ndarray], one: str, other: str) -> np.ndarray:
    return 0.5 * (body[one] + body[other])


def _shared(one: Rays, other: Rays) -> Tuple[List[Hashable], np.ndarray, np.ndarray]:
    keys = [key for key in one if key in other]
    return keys, np.array([one[key] for key in keys]).reshape(-1, 2), np.array(
        [other[key] for key in keys]).reshape(-1, 2)


def _first_two(cameras: Sequence[Rays], number: int, start: int) -> Dict[int, np.ndarray]:
    """Poses, 6 numbers each (rotation vector and translation that map the first camera's frame into this one's), of
    the first camera and another one."""
    _, one, other = _shared(cameras[0], cameras[number])
    drawn = np.random.default_rng(start).permutation(len(one))[:max(len(one) // 2, FEWEST_POINTS)]
    one, other = one[drawn], other[drawn]
    essential, inliers = cv2.findEssentialMat(one, other, np.eye(3), method=cv2.RANSAC, prob=0.9999,
                                              threshold=0.25 * OUTLIER)
    if essential is None or np.shape(essential) != (3, 3):
        raise CalibrationError("the rays of cameras 1 and {} fit no pose: walk farther about, not along one "
                               "line".format(number + 1))
    _, rotation, translation, _ = cv2.recoverPose(essential, one, other, np.eye(3), mask=inliers)
    return {0: np.zeros(6), number: np.concatenate([np.ravel(cv2.Rodrigues(rotation)[0]), np.ravel(translation)])}


def _place_next(cameras: Sequence[Rays], placed: Dict[int, np.ndarray]) -> None:
    """Place the camera that sees most of the points that are known by the others."""
    bundle = _Bundle(cameras, placed)
    points, errors = bundle.triangulate(bundle.start)
    known = {key: point for key, point, error in zip(bundle.keys, points, errors) if error < OUTLIER}
    rest = [index for index in range(len(cameras)) if index not in placed]
    number = max(rest, key=lambda index: sum(key in known for key in cameras[index]))
    keys = [key for key in cameras[number] if key in known]
    if len(keys) < FEWEST_POINTS:
        raise CalibrationError("camera {} shares {} points with two others, {} are needed".format(
            number + 1, len(keys), FEWEST_POINTS))
    found, rotation, translation, _ = cv2.solvePnPRansac(
        np.array([known[key] for key in keys]), np.array([cameras[number][key] for key in keys]), np.eye(3), None,
        reprojectionError=0.5 * OUTLIER, iterationsCount=500)
    if not found:
        raise CalibrationError("the rays of camera {} fit no pose".format(number + 1))
    placed[number] = np.concatenate([np.ravel(rotation), np.ravel(translation)])


class _Bundle:
    """The placed cameras and all points that two of them or more see. start: (C, 6) poses as in `_first_two`."""

    def __init__(self, cameras: Sequence[Rays], placed: Mapping[int, np.ndarray]) -> None:
        self._numbers = sorted(placed)
        self.start = np.array([placed[number] for number in self._numbers])
        self._cameras = cameras
        counts: Dict[Hashable, int] = {}
        for number in self._numbers:
            for key in cameras[number]:
                counts[key] = counts.get(key, 0) + 1
        self.keys = [key for key, count in counts.items() if count > 1]
        nowhere = np.full(2, np.nan)
        self._rays = np.array([[cameras[number].get(key, nowhere) for key in self.keys] for number in self._numbers])
        self._seen = np.isfinite(self._rays[..., 0])

    def triangulate(self, poses: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Points (N, 3) for poses (C, 6), and by how much (N,), x/z, the worst ray misses each."""
        points, errors = self._solve(poses)
        return points, np.where(self._seen, np.linalg.norm(errors, axis=-1), 0.0).max(axis=0)

    def _solve(self, poses: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        rotations = np.array([cv2.Rodrigues(pose[:3])[0] for pose in poses])
        centres = -np.einsum("cji,cj->ci", rotations, poses[:, 3:])
        rays = np.dstack([np.nan_to_num(self._rays), np.ones(self._seen.shape)]) @ rotations
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        across = (np.eye(3) - rays[..., :, None] * rays[..., None, :]) * self._seen[..., None, None]
        points = np.linalg.solve(across.sum(axis=0) + 1e-9 * np.eye(3),
                                 np.einsum("cnij,cj->ni", across, centres)[..., None])[..., 0]
        seen = np.einsum("cij,nj->cni", rotations, points) + poses[:, None, 3:]
        depth = np.maximum(seen[..., 2:], 1e-3)
        return points, np.where(self._seen[..., None], seen[..., :2] / depth - self._rays, 0.0)

    def refined(self) -> "_Bundle":
        """Return the bundle with the poses for which the rays meet best."""
        def misses(free: np.ndarray) -> np.ndarray:
            # The scale is free: the sum of the distances from the first camera stays what it was.
            return np.append(self._solve(self._all(free))[1].ravel(),
                             np.linalg.norm(free.reshape(-1, 6)[:, 3:]) - length)
        length = float(np.linalg.norm(self.start[1:, 3:]))
        found = least_squares(misses, self.start[1:].ravel(), loss="soft_l1", f_scale=0.25 * OUTLIER, max_nfev=60)
        return _Bundle(self._cameras, dict(zip(self._numbers, self._all(found.x))))

    def without(self, wrong: AbstractSet[Hashable]) -> "_Bundle":
        """Return the bundle without some points."""
        return _Bundle([{key: ray for key, ray in rays.items() if key not in wrong} for rays in self._cameras],
                       dict(zip(self._numbers, self.start)))

    @staticmethod
    def _all(free: np.ndarray) -> np.ndarray:
        return np.vstack([np.zeros((1, 6)), free.reshape(-1, 6)])

    def poses(self, poses: np.ndarray) -> Tuple[Pose, ...]:
        """Poses of the optical frames of all cameras in the first one's."""
        return tuple(Pose(cv2.Rodrigues(pose[:3])[0], pose[3:]).inverse() for pose in poses)
