"""Where a body stands in front of the camera, in metres: Perspective-n-Point from its metric landmarks."""

from __future__ import annotations

import math
from typing import Optional, Tuple

import cv2
import numpy as np

from hri_fullbody.core.keypoints import (
    BLAZE_LEFT_HIP,
    BLAZE_LEFT_SHOULDER,
    BLAZE_RIGHT_HIP,
    BLAZE_RIGHT_SHOULDER,
)
from hri_pipeline.core.geometry import Pose, median_of_few

LEAST_POINTS = 6
DEPTH_RANGE = (0.25, 25.0)
_LARGEST_TURN = np.radians(35.0)
_LEAST_OUTLIER = 0.04
_ROUNDS = 3
_NO_LENS = np.eye(3)
_NEXT, _LAST = [1, 2, 0], [2, 0, 1]


def place(rays: np.ndarray, world: np.ndarray, seen: np.ndarray) -> Optional[np.ndarray]:
    """Move root-relative landmarks to where they are seen: (N, 3) m in the optical frame, or None.

    rays: (N, 2) x/z and y/z, without lens distortion. world: (N, 3) m around the hips, axes of the camera.
    seen: (N,) bool, which points count. The network looks along the window's own ray, so the landmarks are also turned.
    Points that fit badly are left out once. None when fewer than 6 are seen or no plausible depth (0.25 to 25 m)
    comes out.
    """
    use = np.asarray(seen, dtype=bool) & np.all(np.isfinite(rays), axis=1) & np.all(np.isfinite(world), axis=1)
    if use.sum() < LEAST_POINTS:
        return None
    first = _solve(rays[use], world[use])
    if first is None:
        return None
    error = _lateral_error(rays[use], world[use] @ first[0].T + first[1])
    bad = error > max(_LEAST_OUTLIER, 3.5 * 1.4826 * median_of_few(error))
    if bad.any() and (~bad).sum() >= LEAST_POINTS:
        good = np.flatnonzero(use)[~bad]
        first = _solve(rays[good], world[good]) or first
    return world @ first[0].T + first[1]


def _solve(rays: np.ndarray, world: np.ndarray) -> Optional[Tuple[np.ndarray, np.ndarray]]:
    """Rotation (3, 3) and translation (3,) m. SQPNP; where it turns the body implausibly far, translation only.

    G. Terzakis, M. Lourakis, "A Consistently Fast and Globally Optimal Solution to the Perspective-n-Point
    Problem", ECCV 2020.
    """
    to_ray = rotation_to_ray(rays.mean(axis=0))
    try:
        found, turn, shift = cv2.solvePnP(np.ascontiguousarray(world), np.ascontiguousarray(rays), _NO_LENS, None,
                                          flags=cv2.SOLVEPNP_SQPNP)
    except cv2.error:
        found = False
    if found:
        rotation = cv2.Rodrigues(turn)[0]
        extra = np.linalg.norm(cv2.Rodrigues(rotation @ to_ray.T)[0])
        moved = np.ravel(shift)
        if extra < _LARGEST_TURN and _plausible(world @ rotation.T + moved):
            return rotation, moved
    moved = translation_only(rays, world @ to_ray.T)
    return (to_ray, moved) if _plausible(world @ to_ray.T + moved) else None


def translation_only(rays: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Translation (3,) m that brings points (N, 3) m onto their rays (N, 2): linear least squares.

    Every point gives x_ray (Z + tz) = X + tx, likewise for y; weights 1/depth make it an error in the image, and
    points far off count less (Huber).
    """
    count = len(points)
    left = np.zeros((2 * count, 3))
    left[0::2, 0] = left[1::2, 1] = 1.0
    left[0::2, 2], left[1::2, 2] = -rays[:, 0], -rays[:, 1]
    right = (rays * points[:, 2:] - points[:, :2]).reshape(-1)
    weights = np.ones(count)
    shift = np.zeros(3)
    for _ in range(_ROUNDS):
        both = np.repeat(weights, 2)
        shift = np.linalg.lstsq(left * both[:, None], right * both, rcond=None)[0]
        error = _lateral_error(rays, points + shift)
        limit = max(_LEAST_OUTLIER, 1.5 * median_of_few(error))
        depth = np.maximum(points[:, 2] + shift[2], 0.3)
        weights = np.sqrt(np.minimum(1.0, limit / np.maximum(error, 1e-9))) / depth
    return shift


def rotation_to_ray(ray: np.ndarray) -> np.ndarray:
    """Smallest rotation (3, 3) that takes the optical axis to the direction (x/z, y/z)."""
    direction = np.array([ray[0], ray[1], 1.0]) / np.sqrt(ray[0] ** 2 + ray[1] ** 2 + 1.0)
    axis = np.array([-direction[1], direction[0], 0.0])     # optical axis x direction
    sine = math.hypot(axis[0], axis[1])
    return np.eye(3) if sine < 1e-9 else cv2.Rodrigues(axis / sine * np.arctan2(sine, direction[2]))[0]


def body_pose(points: np.ndarray) -> Optional[Pose]:
    """Body frame in the frame of `points` (33, 3) m: origin mid-hips, z to the head, y to the left, x forward.

    None when hips and shoulders span no frame.
    """
    hips = (points[BLAZE_LEFT_HIP] + points[BLAZE_RIGHT_HIP]) / 2.0
    shoulders = (points[BLAZE_LEFT_SHOULDER] + points[BLAZE_RIGHT_SHOULDER]) / 2.0
    left = points[BLAZE_LEFT_HIP] - points[BLAZE_RIGHT_HIP]
    left = left + points[BLAZE_LEFT_SHOULDER] - points[BLAZE_RIGHT_SHOULDER]
    rotation = _axes(up=shoulders - hips, left=left)
    return None if rotation is None else Pose(rotation, hips)


def _axes(up: np.ndarray, left: np.ndarray) -> Optional[np.ndarray]:
    """Columns x = left x up, y = left, z = up; `up` is kept exactly. None when they are parallel."""
    length = float(np.linalg.norm(up))
    if not np.isfinite(length) or length < 1e-3:
        return None
    up = up / length
    left = left - up * float(up @ left)
    length = float(np.linalg.norm(left))
    if not np.isfinite(length) or length < 1e-6:
        return None
    left = left / length
    forward = left[_NEXT] * up[_LAST] - left[_LAST] * up[_NEXT]     # numpy.cross takes 0.03 ms
    return np.array([forward, left, up]).T.copy()


def _plausible(points: np.ndarray) -> bool:
    depth = points[:, 2]
    return bool(np.all(np.isfinite(points)) and depth.min() > 0.05
                and DEPTH_RANGE[0] < median_of_few(depth) < DEPTH_RANGE[1])


def _lateral_error(rays: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Distance (N,) m, across the view, of each point from its ray."""
    return np.hypot(*(points[:, :2] - rays * points[:, 2:]).T)
