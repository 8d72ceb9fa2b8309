"""Rigid transforms, quaternions, boxes and rotated crops."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import List, Sequence, Tuple, Union

import cv2
import numpy as np

Numbers = Union[Sequence[float], np.ndarray]
Vector = Tuple[float, float, float]
Quaternion = Tuple[float, float, float, float]


@dataclass(frozen=True)
class Pose:
    """Rigid transform that maps coordinates of a child frame to its parent frame.

    Attributes
    ----------
    rotation : numpy.ndarray, shape (3, 3)
        Its columns are the axes of the child frame in the parent frame.
    translation : numpy.ndarray, shape (3,)
        Origin of the child frame in the parent frame, m.

    Raises
    ------
    ValueError
        For other shapes.
    """

    rotation: np.ndarray
    translation: np.ndarray

    def __post_init__(self) -> None:
        rotation = np.asarray(self.rotation, dtype=np.float64)
        translation = np.asarray(self.translation, dtype=np.float64).reshape(-1)
        if rotation.shape != (3, 3) or translation.shape != (3,):
            raise ValueError(
                "a pose needs a (3, 3) rotation and a (3,) translation, not {} and {}".format(
                    rotation.shape, translation.shape))
        object.__setattr__(self, "rotation", rotation)
        object.__setattr__(self, "translation", translation)

    def compose(self, other: "Pose") -> "Pose":
        """Return self * other: first `other`, then `self`."""
        # For matrices of this size, @ takes more than twice as long as dot().
        return _trusted_pose(self.rotation.dot(other.rotation),
                             self.rotation.dot(other.translation) + self.translation)

    def inverse(self) -> "Pose":
        """Return the transform that maps parent coordinates to the child frame."""
        turned_back = self.rotation.T
        return _trusted_pose(turned_back, (-turned_back).dot(self.translation))

    def moved(self, way: np.ndarray) -> "Pose":
        """Return the pose moved by (3,) m in the parent frame."""
        return _trusted_pose(self.rotation, self.translation + way)

    def apply(self, points: np.ndarray) -> np.ndarray:
        """Map points (N, 3) in the child frame to (N, 3) in the parent frame, m."""
        return np.asarray(points, dtype=np.float64) @ self.rotation.T + self.translation

    def differs(self, other: "Pose") -> Tuple[float, float]:
        """Return how far another pose is away: the distance of their origins (m), and the angle between their axes
        (rad)."""
        sine = float(np.linalg.norm(np.array(self.inverse().compose(other).quaternion)[:3]))
        return float(np.linalg.norm(self.translation - other.translation)), 2.0 * math.asin(min(1.0, sine))

    @property
    def quaternion(self) -> Tuple[float, float, float, float]:
        """Unit quaternion (x, y, z, w)."""
        return _quaternion(self.rotation.tolist())

    @classmethod
    def from_quaternion(cls, quaternion: Numbers, translation: Numbers) -> "Pose":
        """Make a pose of a quaternion and a translation.

        Parameters
        ----------
        quaternion : sequence of 4 float
            x, y, z, w; it is normalised here.
        translation : sequence of 3 float
            m.

        Raises
        ------
        ValueError
            For a quaternion that is zero or not finite.
        """
        # Thousands a second pass here; scipy's Rotation takes ten times as long for a single one.
        values = tuple(map(float, quaternion))
        x, y, z, w = values if len(values) == 4 else (math.nan,) * 4
        square = x * x + y * y + z * z + w * w
        if not 1e-18 <= square < math.inf:
            raise ValueError("a quaternion needs 4 finite numbers, not all zero: {}".format(list(values)))
        s = 2.0 / square
        rotation = np.array((
            1.0 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w),
            s * (x * y + z * w), 1.0 - s * (x * x + z * z), s * (y * z - x * w),
            s * (x * z - y * w), s * (y * z + x * w), 1.0 - s * (x * x + y * y))).reshape(3, 3)
        position = np.asarray(translation, dtype=np.float64)
        return _trusted_pose(rotation, position) if position.shape == (3,) else cls(rotation, position)

    @classmethod
    def identity(cls) -> "Pose":
        """Return the transform that changes nothing."""
        return cls(np.eye(3), np.zeros(3))


def _trusted_pose(rotation: np.ndarray, translation: np.ndarray) -> Pose:
    """Return a pose of arrays that are known to be right: hundreds a second need not be looked at again."""
    pose = object.__new__(Pose)
    values = pose.__dict__
    values["rotation"], values["translation"] = rotation, translation
    return pose


def _quaternion(matrix: List[List[float]]) -> Tuple[float, float, float, float]:
    """Unit quaternion (x, y, z, w) of a rotation matrix, as rows: S. W. Shepperd, J. Guidance and Control 1 (1978)
    223."""
    (a, b, c), (d, e, f), (g, h, i) = matrix
    largest = max(a, e, i, a + e + i)
    if largest == a:
        x, y, z, w = 1.0 + a - e - i, b + d, c + g, h - f
    elif largest == e:
        x, y, z, w = b + d, 1.0 - a + e - i, f + h, c - g
    elif largest == i:
        x, y, z, w = c + g, f + h, 1.0 - a - e + i, d - b
    else:
        x, y, z, w = h - f, c - g, d - b, 1.0 + a + e + i
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    return x / norm, y / norm, z / norm, w / norm


def unit_quaternion(quaternion: Quaternion) -> Quaternion:
    """Return a quaternion x, y, z, w of length 1."""
    x, y, z, w = quaternion
    length = math.sqrt(x * x + y * y + z * z + w * w)
    return x / length, y / length, z / length, w / length


def quaternion_product(first: Quaternion, second: Quaternion) -> Quaternion:
    """Return the rotation by `second`, then by `first`; quaternions x, y, z, w of any length."""
    (ax, ay, az, aw), (bx, by, bz, bw) = first, second
    return (aw * bx + ax * bw + ay * bz - az * by, aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw, aw * bw - ax * bx - ay * by - az * bz)


def slerp(first: Quaternion, second: Quaternion, part: float) -> Quaternion:
    """Return the rotation between two quaternions, along the shorter arc; part: 0 the first, 1 the second (Shoemake
    1985)."""
    first, second = unit_quaternion(first), unit_quaternion(second)
    cosine = sum(a * b for a, b in zip(first, second))
    sign = 1.0 if cosine >= 0.0 else -1.0
    angle = math.acos(min(1.0, abs(cosine)))
    if angle < 1e-6:
        weights = 1.0 - part, sign * part
    else:
        weights = math.sin((1.0 - part) * angle) / math.sin(angle), sign * math.sin(part * angle) / math.sin(angle)
    x, y, z, w = (weights[0] * a + weights[1] * b for a, b in zip(first, second))
    return x, y, z, w


def view_axis(quaternion: Quaternion, along_z: bool) -> Vector:
    """Return the x axis, or the z axis, that a quaternion x, y, z, w turns to; it need not be of unit length."""
    x, y, z, w = quaternion
    scale = 2.0 / (x * x + y * y + z * z + w * w)
    if along_z:
        return scale * (x * z + y * w), scale * (y * z - x * w), 1.0 - scale * (x * x + y * y)
    return 1.0 - scale * (y * y + z * z), scale * (x * y + z * w), scale * (x * z - y * w)


def rotate(quaternion: Quaternion, vector: Vector) -> Vector:
    """Return a vector turned by a quaternion x, y, z, w, which need not be of unit length.

    v + w t + q x t with t = 2 / |q|^2 (q x v).
    """
    (x, y, z, w), (u, v, n) = quaternion, vector
    scale = 2.0 / (x * x + y * y + z * z + w * w)
    i, j, k = scale * (y * n - z * v), scale * (z * u - x * n), scale * (x * v - y * u)
    return u + w * i + y * k - z * j, v + w * j + z * i - x * k, n + w * k + x * j - y * i


def iou_matrix(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the intersection over union of each box of `a` with each box of `b`.

    Parameters
    ----------
    a : numpy.ndarray, shape (N, 4)
        Boxes x0, y0, x1, y1, px. A box without area overlaps with nothing.
    b : numpy.ndarray, shape (M, 4)
        The same.

    Returns
    -------
    numpy.ndarray, shape (N, M)
        0 to 1.
    """
    a = np.asarray(a, dtype=np.float64).reshape(-1, 4)
    b = np.asarray(b, dtype=np.float64).reshape(-1, 4)
    low = np.maximum(a[:, None, :2], b[None, :, :2])
    high = np.minimum(a[:, None, 2:], b[None, :, 2:])
    inner = np.prod(np.maximum(high - low, 0.0), axis=2)
    area_a = np.prod(np.maximum(a[:, 2:] - a[:, :2], 0.0), axis=1)
    area_b = np.prod(np.maximum(b[:, 2:] - b[:, :2], 0.0), axis=1)
    union = area_a[:, None] + area_b[None, :] - inner
    return np.where(union > 0.0, inner / np.where(union > 0.0, union, 1.0), 0.0)


def lowest_highest(points: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """Return the least and the largest value (D,) of each axis of points (N, D); numpy takes six times as long to find
    them across 478 rows as along the axes."""
    axes = points.T.copy()
    return axes.min(axis=1), axes.max(axis=1)


def median_of_few(values: np.ndarray) -> float:
    """Return the median of finite numbers (N,), 1 and more; numpy.median takes five times as long for so few."""
    ordered = np.sort(values)
    return float(ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2]) / 2.0


def crop_rotated(
    image: np.ndarray,
    centre_xy: Numbers,
    size_px: float,
    angle_rad: float,
    output_size: int,
) -> Tuple[np.ndarray, np.ndarray]:
    """Cut a rotated square out of an image and scale it. Outside of the image its border is repeated.

    Parameters
    ----------
    image : numpy.ndarray, shape (H, W, C)
    centre_xy : sequence of 2 float
        Centre of the square in the image, px.
    size_px : float
        Side of the square in the image, px.
    angle_rad : float
        Turns the x axis of the square from the image's x towards the image's y (clockwise on the screen).
    output_size : int
        Side of the patch, px.

    Returns
    -------
    patch : numpy.ndarray, shape (output_size, output_size, C)
    affine : numpy.ndarray, shape (2, 3)
        Maps pixels of the patch to pixels of the image.

    Raises
    ------
    ValueError
        For a size that is not positive, or a number that is not finite.
    """
    affine = square_affine(centre_xy, size_px, angle_rad, output_size)
    # Continuous coordinates have (0, 0) at the corner of the first pixel, OpenCV at its centre.
    between_centres = affine.copy()
    (cosine, minus_sine), (sine, _) = affine[:, :2].tolist()
    between_centres[:, 2] += (0.5 * (cosine + minus_sine) - 0.5, 0.5 * (sine + cosine) - 0.5)
    patch = cv2.warpAffine(
        image, between_centres, (output_size, output_size),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_REPLICATE)
    return patch, affine


def turn_ahead(x: Union[float, np.ndarray], y: Union[float, np.ndarray], z: Union[float, np.ndarray]) -> np.ndarray:
    """Return the smallest turn (3, 3) that takes a unit direction to the z axis; of many, (F,) each, turns (3, 3, F).

    A direction straight back has none.
    """
    return np.array(((1.0 - x * x / (1.0 + z), -x * y / (1.0 + z), -x),
                     (-x * y / (1.0 + z), 1.0 - y * y / (1.0 + z), -y), (x, y, z)))


def square_affine(centre_xy: Numbers, size_px: float, angle_rad: float, output_size: int) -> np.ndarray:
    """Return the affine (2, 3) from pixels of a patch to the plane of the square of which it is a picture.

    See `crop_rotated`, also for what it raises.
    """
    # Plain numbers: this runs several times in each image, and arrays of two are slow.
    x, y = float(centre_xy[0]), float(centre_xy[1])
    if not all(map(math.isfinite, (x, y, size_px, angle_rad))) or size_px <= 0.0 or output_size < 1:
        raise ValueError("cannot crop centre {}, size {} px, angle {} rad to {} px".format(
            tuple(centre_xy), size_px, angle_rad, output_size))
    scale = float(size_px) / output_size
    cosine, sine = scale * math.cos(angle_rad), scale * math.sin(angle_rad)
    half = output_size / 2.0
    left, top = x - half * (cosine - sine), y - half * (sine + cosine)
    return np.array(((cosine, -sine, left), (sine, cosine, top)))
