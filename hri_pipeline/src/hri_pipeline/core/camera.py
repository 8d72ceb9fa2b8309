"""Pinhole and fisheye camera models with lens distortion."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from functools import lru_cache
from typing import Optional, Sequence, Tuple

import cv2
import numpy as np

from hri_pipeline.core.geometry import Numbers, lowest_highest, square_affine, turn_ahead

PLUMB_BOB = "plumb_bob"
RATIONAL = "rational_polynomial"
EQUIDISTANT = "equidistant"

# Legal numbers of coefficients; none means no distortion. Drivers send the longer rows as plumb_bob, too, which
# image_geometry gives to OpenCV as they are.
_COEFFICIENTS = {PLUMB_BOB: (0, 4, 5, 8, 12, 14), RATIONAL: (0, 4, 5, 8, 12, 14), EQUIDISTANT: (0, 4)}
_UNTILTED = 12      # of them at most, where the sensor is not tilted
_MANY = 250         # points; with fewer OpenCV is as fast or faster
# Limits of every real camera: focal length in image widths, aspect ratio of a pixel, distance of the optical axis from
# the middle of the sensor in sensor sizes, distortion coefficients, and size of the sensor, px.
_FOCAL_WIDTHS = (0.02, 500.0)
_MAX_ASPECT = 10.0
_MAX_OFF_CENTRE = 1.5
_MAX_COEFFICIENT = 1e4
# A middle so many times as far from the corner as that of the image, across and down, is that of another resolution: of
# hasty calibrations it is off by 1.2 in the one or the other. How much these factors may differ in one shape of image;
# longer sides of images of cameras, px, and how near it must be to one of them to be that.
_OTHER_SIZE, _SAME_SHAPE = 1.3, 1.15
_LONGER_SIDES = (160, 320, 424, 480, 640, 720, 800, 848, 960, 1024, 1280, 1440, 1600, 1920, 2048, 2560, 3840, 4096)
_NEAR_SIDE = 1.08
_MAX_SENSOR = 65536
_ALIASES = {"": PLUMB_BOB, "fisheye": EQUIDISTANT}
_HINT = "calibrate the camera, or publish an all-zero K to use the field of view parameter"
_WIDEST = math.tan(math.radians(88.0))
_GRID = np.array([(x, y) for x in (0.0, 0.5, 1.0) for y in (0.0, 0.5, 1.0)])
_BOX = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])
_FROM_CENTRES = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])
_TO_CENTRES = np.array([[1.0, 0.0, -0.5], [0.0, 1.0, -0.5], [0.0, 0.0, 1.0]])
_SEEN_AGAIN = 1.0   # px between a point and where its ray is seen, where the model of a lens holds
_REACH = 0.9        # of the size of a face: how far from its middle crops of it show the image
_RAY_AGAIN = 0.01   # the same for a ray and that of the pixel where it is seen, x/z
_AHEAD = math.tan(math.radians(6.0))    # up to here an image is stretched by half a hundredth
_NODES = 0.5 - 0.5 * np.cos(np.pi * (np.arange(5) + 0.5) / 5.0)     # Chebyshev's, of a polynomial of the fourth degree
_NODE_GRID = np.stack(np.meshgrid(_NODES, _NODES), axis=-1).reshape(-1, 2)
_TOLD_ANEW, _MOVED_CENTRE = math.log(1.1), 0.05  # logarithm of the focal length; parts of the width
_LEAST_AHEAD = 0.1      # cosine of the angle from the middle of some points to one that is still told
_UNDISTORT_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-10)


class CameraError(ValueError):
    """A calibration that no real camera has."""


class Calibration(Enum):
    """Where the numbers of a camera model come from."""

    CALIBRATED = "calibrated"
    UNCALIBRATED = "uncalibrated"   # camera_info came with an all-zero K: field of view parameter
    MISSING = "missing"             # no camera_info at all: field of view parameter


@dataclass(frozen=True)
class CameraModel:
    """Maps rays of the optical frame (x right, y down, z forward) to pixels and back.

    Attributes
    ----------
    width, height : int
        Size of the image, px.
    matrix : numpy.ndarray, shape (3, 3)
        Camera matrix K, px.
    distortion : numpy.ndarray, shape (n,)
        Coefficients in OpenCV's order; n = 0 without distortion.
    distortion_model : str
        PLUMB_BOB, RATIONAL or EQUIDISTANT.
    calibration : Calibration
        Where the numbers come from.

    Raises
    ------
    CameraError
        For numbers that no real camera has.
    """

    width: int
    height: int
    matrix: np.ndarray
    distortion: np.ndarray
    distortion_model: str
    calibration: Calibration

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1:
            raise CameraError("image size of the camera is {}x{}".format(self.width, self.height))
        matrix = np.asarray(self.matrix, dtype=np.float64).reshape(3, 3)
        distortion = np.asarray(self.distortion, dtype=np.float64).reshape(-1)
        model = _ALIASES.get(self.distortion_model, self.distortion_model)
        distortion = _without_zeros(model, distortion)
        _check_matrix(matrix)
        _check_distortion(model, distortion)
        _check_focal(matrix, self.width)
        object.__setattr__(self, "matrix", matrix)
        object.__setattr__(self, "distortion", distortion)
        object.__setattr__(self, "distortion_model", model)

    @property
    def is_calibrated(self) -> bool:
        """Whether the numbers were measured: those of a guess change what is seen aside by a guess."""
        return self.calibration is Calibration.CALIBRATED

    @classmethod
    def from_fov(
        cls,
        width: int,
        height: int,
        horizontal_fov_rad: float,
        calibration: Calibration = Calibration.MISSING,
    ) -> "CameraModel":
        """Make an ideal camera with square pixels.

        Parameters
        ----------
        width, height : int
            Size of the image, px.
        horizontal_fov_rad : float
            Horizontal field of view, rad, 0 to pi.
        calibration : Calibration
            Where this field of view comes from.

        Raises
        ------
        CameraError
            For a field of view out of this range.
        """
        if not 0.0 < horizontal_fov_rad < math.pi:
            raise CameraError("horizontal field of view is {} rad, legal range 0 to pi".format(horizontal_fov_rad))
        focal = width / (2.0 * math.tan(horizontal_fov_rad / 2.0))
        matrix = np.array([[focal, 0.0, width / 2.0], [0.0, focal, height / 2.0], [0.0, 0.0, 1.0]])
        return cls(int(width), int(height), matrix, np.zeros(0), PLUMB_BOB, calibration)

    @classmethod
    def from_calibration(
        cls,
        width: int,
        height: int,
        K9: Sequence[float],  # noqa: N803 - the name in sensor_msgs/CameraInfo
        D: Sequence[float],  # noqa: N803
        distortion_model: str,
        fallback_hfov_rad: float,
        binning_x: int = 0,
        binning_y: int = 0,
        roi_x: int = 0,
        roi_y: int = 0,
        roi_width: int = 0,
        roi_height: int = 0,
    ) -> "CameraModel":
        """Make the model of the image that belongs to a sensor_msgs/CameraInfo.

        Where K was measured at another resolution of the same shape than the message tells, which its principal point
        betrays, the model is of that size.

        Parameters
        ----------
        width, height : int
            Size of the full sensor, px.
        K9 : sequence of 9 float
            Camera matrix of the full sensor, row by row, px. All zero means uncalibrated.
        D : sequence of float
            Distortion coefficients in the order of OpenCV.
        distortion_model : str
            As in sensor_msgs/CameraInfo.
        fallback_hfov_rad : float
            Horizontal field of view, rad, of an uncalibrated camera.
        binning_x, binning_y : int
            Sensor pixels per image pixel; 0 and 1 mean no binning.
        roi_x, roi_y, roi_width, roi_height : int
            Region of interest on the full sensor, px, before binning; width and height 0 mean all of it.

        Raises
        ------
        CameraError
            For numbers that no real camera has.
        """
        bin_x, bin_y = max(1, int(binning_x)), max(1, int(binning_y))
        roi = (int(roi_x), int(roi_y), int(roi_width), int(roi_height))
        matrix = np.asarray(K9, dtype=np.float64).reshape(-1)
        if matrix.size != 9:
            raise CameraError("K has {} numbers instead of 9; {}".format(matrix.size, _HINT))
        is_known = bool(np.any(matrix))
        matrix = matrix.reshape(3, 3).copy()
        if is_known:
            _check_sensor(matrix, int(width), int(height), roi)
            if roi in ((0, 0, 0, 0), (0, 0, width, height)):
                width, height = _measured_size(matrix, int(width), int(height))
                roi = (0, 0, 0, 0)
        image_width = (roi[2] or int(width) - roi[0]) // bin_x
        image_height = (roi[3] or int(height) - roi[1]) // bin_y
        if not is_known:
            return cls.from_fov(image_width, image_height, fallback_hfov_rad, Calibration.UNCALIBRATED)
        matrix[0, 2] -= roi_x
        matrix[1, 2] -= roi_y
        matrix[0] /= bin_x
        matrix[1] /= bin_y
        distortion = np.asarray(D, dtype=np.float64).reshape(-1)
        return cls(image_width, image_height, matrix, distortion, distortion_model, Calibration.CALIBRATED)

    @property
    def _is_bent(self) -> bool:
        """Whether the lens draws straight lines as curves."""
        return bool(self.distortion.size) or self.distortion_model == EQUIDISTANT

    def normalise(self, pixels: np.ndarray) -> np.ndarray:
        """Map pixels to undistorted rays of the optical frame.

        Parameters
        ----------
        pixels : numpy.ndarray, shape (N, 2)
            x and y, px.

        Returns
        -------
        numpy.ndarray, shape (N, 2)
            x/z and y/z; of a fisheye camera at most tan(88 deg) from the axis.
        """
        pixels = self._sheared(np.asarray(pixels, dtype=np.float64).reshape(-1, 2), -1.0)
        if not self._is_bent:
            rays = np.empty_like(pixels)
            rays[:, 0] = (pixels[:, 0] - self.matrix[0, 2]) / self.matrix[0, 0]
            rays[:, 1] = (pixels[:, 1] - self.matrix[1, 2]) / self.matrix[1, 1]
            return rays
        if len(pixels) == 0:
            return np.zeros((0, 2))
        points = np.ascontiguousarray(pixels[:, None, :])
        if self.distortion_model == EQUIDISTANT:
            return self._ahead(pixels, cv2.fisheye.undistortPoints(points, self.matrix, self._fisheye()).reshape(-1, 2))
        rays = cv2.undistortPointsIter(points, self.matrix, self.distortion, np.eye(3), np.eye(3), _UNDISTORT_CRITERIA)
        return np.asarray(rays).reshape(-1, 2)

    def project(self, points: np.ndarray) -> np.ndarray:
        """Map points to pixels.

        Parameters
        ----------
        points : numpy.ndarray, shape (N, 3)
            Points in the optical frame, m.

        Returns
        -------
        numpy.ndarray, shape (N, 2)
            x and y, px; NaN for a point with z <= 0.
        """
        points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        result = np.full((len(points), 2), np.nan)
        ahead = np.isfinite(points).all(axis=1) & (points[:, 2] > 0.0)
        if not ahead.any():
            return result
        seen = np.ascontiguousarray(points[ahead][:, None, :])
        none = np.zeros(3)
        if not self._is_bent:
            # OpenCV takes 0.02 ms for a single point.
            pixels = seen[..., :2] / seen[..., 2:] * self.matrix[[0, 1], [0, 1]] + self.matrix[:2, 2]
        elif self.distortion_model == EQUIDISTANT:
            pixels, _ = cv2.fisheye.projectPoints(seen, none, none, self.matrix, self._fisheye())
        elif len(seen) >= _MANY and self.distortion.size <= _UNTILTED:
            pixels = self._distorted(seen[:, 0, 0] / seen[:, 0, 2], seen[:, 0, 1] / seen[:, 0, 2])
        else:
            pixels, _ = cv2.projectPoints(seen, none, none, self.matrix, self.distortion)
        result[ahead] = self._sheared(np.asarray(pixels, dtype=np.float64).reshape(-1, 2), 1.0)
        return result

    def _distorted(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the pixels (N, 2) of rays x/z and y/z (N,) through a lens whose sensor is not tilted.

        The formula of OpenCV's calib3d. cv2.projectPoints derives each point by all parameters, too: of 478 points it
        takes 1.3 to 1.8 times as long, of ten faces' 3 to 6 times.
        """
        known = self.distortion.tolist()
        k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 = known + [0.0] * (_UNTILTED - len(known))
        square, cross = x * x + y * y, 2.0 * x * y
        radial = 1.0 + square * (k1 + square * (k2 + square * k3))
        if k4 or k5 or k6:
            radial /= 1.0 + square * (k4 + square * (k5 + square * k6))
        across = x * radial + p1 * cross + p2 * (square + 2.0 * x * x)
        down = y * radial + p2 * cross + p1 * (square + 2.0 * y * y)
        if s1 or s2 or s3 or s4:
            across, down = across + square * (s1 + square * s2), down + square * (s3 + square * s4)
        return np.stack([across, down], axis=1) * self.matrix[[0, 1], [0, 1]] + self.matrix[:2, 2]

    def facing(self, pixels: np.ndarray) -> np.ndarray:
        """Return points as a camera at the same place sees them that looks at their middle, through no lens.

        Aside of the optical axis a flat image is stretched away from its middle, by 15 % at 30 degrees more than
        across; a fisheye squeezes it.

        Parameters
        ----------
        pixels : numpy.ndarray, shape (N, 2)
            px; one point at least.

        Returns
        -------
        numpy.ndarray, shape (N, 2)
            px from the middle, at the focal length of this camera; where one of them is beyond the edge of the model
            of the lens, as they are.
        """
        pixels = np.asarray(pixels, dtype=np.float64)
        rays = self.normalise(pixels)
        if not self._holds(pixels, rays):
            return np.asarray(pixels - pixels.mean(axis=0))
        focal = math.sqrt(self.matrix[0, 0] * self.matrix[1, 1])
        return np.asarray(focal * _seen_ahead(rays)[0])

    def facing_map(self, pixels: np.ndarray) -> np.ndarray:
        """Return the homography (3, 3) that takes pixels near some points (N, 2) px to what facing() says of them.

        That of points in one place changes nothing.
        """
        pixels = np.asarray(pixels, dtype=np.float64)
        low, high = lowest_highest(pixels)
        places = low + _GRID * (high - low)
        if not np.isfinite(places).all() or (high - low).min() < 1.0:
            return np.eye(3)
        found, _ = cv2.findHomography(places, self.facing(places))
        return np.eye(3) if found is None else np.asarray(found)

    def facing_view(self, pixels: np.ndarray) -> Optional[FacingView]:
        """Return the view of a camera at the same place that looks at some points (N, 2) px, through no lens.

        None where it is not known or makes no difference: of a camera that is not calibrated, of points that are not
        finite or in one place, near the edge of the model of the lens or a right angle, and near the optical axis.
        """
        if not self.is_calibrated:
            return None
        low, high = lowest_highest(pixels)
        (x0, y0), (x1, y1) = low.tolist(), high.tolist()
        width, height = x1 - x0, y1 - y0
        if not math.isfinite(width + height):
            return None
        box = low + _BOX * (width, height)
        rays = self.normalise(box)
        x, y = (rays.sum(axis=0) / len(rays)).tolist()
        if not (_AHEAD < math.hypot(x, y) < math.inf and min(width, height) >= 1.0 and self._holds(box, rays)):
            return None
        seen, turn = _seen_ahead(rays)
        across, down = zip(*seen.tolist())
        if not self._shows(turn, max(max(across) - min(across), max(down) - min(down))):
            return None
        # As large as in the image, in area: what is told in px there means the same.
        focal = math.sqrt(width * height / max(_area(seen), 1e-12))
        if self._is_bent:
            return FacingView(self, turn, focal, None)
        return FacingView(self, turn, focal, cv2.getPerspectiveTransform(
            (focal * seen).astype(np.float32), box.astype(np.float32)))

    def resized(self, width: int, height: int) -> "CameraModel":
        """Return the model of the same view in an image of another size, px; itself when it has that size."""
        if (self.width, self.height) == (width, height):
            return self
        scale = np.diag([width / self.width, height / self.height, 1.0])
        return CameraModel(int(width), int(height), scale @ self.matrix, self.distortion,
                           self.distortion_model, self.calibration)

    def is_told_anew(self, before: "CameraModel", zoom: float = 1.0) -> bool:
        """Tell whether another calibration than `before`, of the same size of image, puts what is seen to clearly other
        places; one that follows a slow zoom from image to image does not.

        zoom: how many times as large the picture has suddenly become, which a calibration may have followed.
        """
        if self.matrix is before.matrix and zoom == 1.0:
            return False
        larger = math.log(self.matrix[0, 0] / before.matrix[0, 0] / zoom)
        aside = math.hypot(*(self.matrix[:2, 2] - before.matrix[:2, 2]).tolist())
        return abs(larger) > _TOLD_ANEW or aside > _MOVED_CENTRE * self.width

    def _holds(self, pixels: np.ndarray, rays: np.ndarray) -> bool:
        """Return whether all rays (N, 2) are seen at their pixels (N, 2): beyond its edge a model gives anything."""
        if not self._is_bent:
            return True
        seen = self.project(np.concatenate([rays, np.ones((len(rays), 1))], axis=1))
        return bool((np.abs(seen - pixels) < _SEEN_AGAIN).all())

    def _shows(self, turn: np.ndarray, size: float) -> bool:
        """Return whether a crop about points of this size (x/z) in a view lies ahead of the camera, where the model of
        the lens holds: one that does not would be wrong as a whole."""
        away = -_REACH * size * turn[:2, 2] / max(math.hypot(*turn[:2, 2].tolist()), 1e-9)
        farthest = np.array([[away[0], away[1], 1.0]]) @ turn
        if farthest[0, 2] < _LEAST_AHEAD * math.sqrt(1.0 + float(away @ away)):
            return False
        if not self._is_bent:
            return True
        again = self.normalise(self.project(farthest))
        return bool((np.abs(again - farthest[:, :2] / farthest[:, 2:]) < _RAY_AGAIN).all())

    def _sheared(self, pixels: np.ndarray, way: float) -> np.ndarray:
        """Return pixels (N, 2) moved by the skew of K, which OpenCV leaves out; way: 1.0 to the image, -1.0 back."""
        if not self.matrix[0, 1]:
            return pixels
        return pixels + np.outer((pixels[:, 1] - self.matrix[1, 2]) / self.matrix[1, 1], [way * self.matrix[0, 1], 0.0])

    def _ahead(self, pixels: np.ndarray, rays: np.ndarray) -> np.ndarray:
        """Return rays (N, 2) of a fisheye camera; those of a right angle and more from the axis, which x/z and y/z
        cannot tell (they would be on the other side), at the widest angle there is."""
        aside = (pixels - self.matrix[:2, 2]) / (self.matrix[0, 0], self.matrix[1, 1])
        beyond = ~(((rays * aside).sum(axis=1) >= 0.0) & (np.hypot(rays[:, 0], rays[:, 1]) < _WIDEST))
        far = aside[beyond]
        rays[beyond] = _WIDEST * far / np.maximum(np.hypot(far[:, 0], far[:, 1]), 1e-9)[:, None]
        return rays

    def _fisheye(self) -> np.ndarray:
        return self.distortion if self.distortion.size else np.zeros(4)


@dataclass(frozen=True)
class FacingView:
    """What a camera at the same place sees that looks at a part of an image, through no lens.

    Aside of the optical axis a flat image is stretched away from its middle, by 15 % at 30 degrees more than across; a
    fisheye squeezes it. Here nothing is.

    Attributes
    ----------
    camera : CameraModel
        Of the image.
    turn : numpy.ndarray, shape (3, 3)
        Takes directions of the optical frame to those of the view.
    focal : float
        Focal length, px: what is looked at is as large as in the image.
    to_image : numpy.ndarray, shape (3, 3)
        Homography from the view to the image; None for a lens with distortion.
    """

    camera: CameraModel
    turn: np.ndarray
    focal: float
    to_image: Optional[np.ndarray]

    def see(self, pixels: np.ndarray) -> np.ndarray:
        """Map pixels (N, 2) of the image to the view: (N, 2) px from its middle."""
        ahead = _turned(self.camera.normalise(pixels), self.turn)
        return np.asarray(self.focal * ahead[:, :2] / np.maximum(ahead[:, 2:], _LEAST_AHEAD))

    def back(self, points: np.ndarray) -> np.ndarray:
        """Map points (N, 2) px of the view to pixels of the image (N, 2)."""
        points = np.asarray(points, dtype=np.float64)
        if self.to_image is not None:
            moved = points @ self.to_image[:, :2].T + self.to_image[:, 2]
            return np.asarray(moved[:, :2] / moved[:, 2:])
        rays = np.concatenate([points / self.focal, np.ones((len(points), 1))], axis=1)
        return self.camera.project(rays @ self.turn)

    def crop(self, image: np.ndarray, centre_xy: Numbers, size_px: float, angle_rad: float,
             output_size: int) -> Tuple[np.ndarray, np.ndarray]:
        """Cut a rotated square of the view out of the image; see `geometry.crop_rotated`.

        Returns the patch and the affine (2, 3) from it to the view.
        """
        affine = square_affine(centre_xy, size_px, angle_rad, output_size)
        if self.to_image is not None:
            between = _TO_CENTRES @ self.to_image @ np.vstack([affine, (0.0, 0.0, 1.0)]) @ _FROM_CENTRES
            return cv2.warpPerspective(image, between, (output_size, output_size),
                                       flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
                                       borderMode=cv2.BORDER_REPLICATE), affine
        nodes = self.back(output_size * _NODE_GRID @ affine[:, :2].T + affine[:, 2]) - 0.5
        basis = _polynomials(output_size)
        x, y = (basis @ one.reshape(len(_NODES), -1) @ basis.T for one in np.nan_to_num(nodes).astype(np.float32).T)
        return cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), affine


@lru_cache(maxsize=8)
def _polynomials(size: int) -> np.ndarray:
    """Return the polynomials (size, 5) float32 at the pixels of a side (px) that are 1 at one of its nodes."""
    places = (np.arange(size) + 0.5) / size
    found = np.ones((size, len(_NODES)))
    for column, node in enumerate(_NODES):
        for other in np.delete(_NODES, column):
            found[:, column] *= (places - other) / (node - other)
    return found.astype(np.float32)


def _seen_ahead(rays: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """Return rays (N, 2) as a camera sees them that looks at their middle, and the turn (3, 3) to its frame."""
    across, down = rays.T
    lengths = np.sqrt(across * across + down * down + 1.0)
    shares = 1.0 / lengths
    x, y, z = float(across @ shares), float(down @ shares), float(shares.sum())     # sum of the unit vectors
    length = math.sqrt(x * x + y * y + z * z)
    turn = turn_ahead(x / length, y / length, z / length)
    ahead = _turned(rays, turn)
    return ahead[:, :2] / np.maximum(ahead[:, 2:], _LEAST_AHEAD * lengths[:, None]), turn


def _turned(rays: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Return directions (N, 3) of rays (N, 2), at z = 1, turned by a matrix (3, 3)."""
    return np.asarray(rays @ turn[:, :2].T + turn[:, 2])


def _area(corners: np.ndarray) -> float:
    """Return the area of a quadrangle (4, 2)."""
    (a, b), (c, d) = (corners[2] - corners[0]).tolist(), (corners[3] - corners[1]).tolist()
    return 0.5 * abs(a * d - b * c)


def _check_matrix(matrix: np.ndarray) -> None:
    if not np.all(np.isfinite(matrix)):
        raise CameraError("K holds numbers that are not finite; {}".format(_HINT))
    if matrix[0, 0] <= 0.0 or matrix[1, 1] <= 0.0:
        raise CameraError("focal lengths in K are {:g} and {:g} px and must be positive; {}".format(
            matrix[0, 0], matrix[1, 1], _HINT))
    below = (matrix[1, 0], matrix[2, 0], matrix[2, 1], matrix[2, 2])
    if not np.allclose(below, (0.0, 0.0, 0.0, 1.0), atol=1e-6):
        raise CameraError("K is not [fx s cx; 0 fy cy; 0 0 1]; {}".format(_HINT))


def _check_focal(matrix: np.ndarray, width: int) -> None:
    """Raise CameraError for focal lengths, px, that no camera has whose image is so wide, px."""
    across, down = matrix[0, 0], matrix[1, 1]
    least, most = (limit * width for limit in _FOCAL_WIDTHS)
    if not least <= across <= most:
        raise CameraError(
            "the focal length in K is {:g} px for an image {} px wide, legal range {:g} to {:g}; {}".format(
                across, width, least, most, _HINT
            )
        )
    if not 1.0 / _MAX_ASPECT <= down / across <= _MAX_ASPECT or abs(matrix[0, 1]) > across:
        raise CameraError("focal lengths {:g} and {:g} px with a skew of {:g} in K fit no camera; {}".format(
            across, down, matrix[0, 1], _HINT))


def _check_sensor(matrix: np.ndarray, width: int, height: int, roi: Tuple[int, int, int, int]) -> None:
    """Raise CameraError where K, size (px) and region of interest (x, y, width, height px) do not fit each other."""
    if not (1 <= width <= _MAX_SENSOR and 1 <= height <= _MAX_SENSOR):
        raise CameraError("image size in camera_info is {}x{}, legal range 1 to {} px; {}".format(
            width, height, _MAX_SENSOR, _HINT))
    if roi[0] + roi[2] > width or roi[1] + roi[3] > height:
        raise CameraError("the region of interest {}x{} at {}, {} lies outside of {}x{} px; {}".format(
            roi[2], roi[3], roi[0], roi[1], width, height, _HINT))
    _check_matrix(matrix)
    if not matrix[0, 2] and not matrix[1, 2]:
        raise CameraError("the principal point in K, 0, 0, is a corner of the sensor; {}".format(_HINT))
    off = abs(matrix[0, 2] - width / 2.0) / max(width, 1), abs(matrix[1, 2] - height / 2.0) / max(height, 1)
    if max(off) > _MAX_OFF_CENTRE:
        raise CameraError("the principal point in K, {:g}, {:g}, lies far outside of {}x{} px; {}".format(
            matrix[0, 2], matrix[1, 2], width, height, _HINT))


def _measured_size(matrix: np.ndarray, width: int, height: int) -> Tuple[int, int]:
    """Return the size of the images, px, in which K was measured: `width` and `height`, unless its principal point is
    the middle of other ones of that shape. Raises CameraError where it is that of another shape.

    One in a corner or beside the image, as of a cut part of the sensor, is the middle of none.
    """
    across, down = 2.0 * matrix[0, 2] / width, 2.0 * matrix[1, 2] / height
    if min(across, down) <= 0.0 or not (max(across, down) < 1.0 / _OTHER_SIZE or min(across, down) > _OTHER_SIZE):
        return width, height
    if not 1.0 / _SAME_SHAPE < across / down < _SAME_SHAPE:
        raise CameraError("the principal point in K, {:g}, {:g}, is far from the middle of {}x{} px, as of another "
                          "resolution; calibrate this one, or tell a part of the sensor by roi; {}".format(
                              matrix[0, 2], matrix[1, 2], width, height, _HINT))
    longer = max(width, height)
    found = math.sqrt(across * down) * longer
    known = min(_LONGER_SIDES, key=lambda side: abs(math.log(side / found)))
    scale = (known if abs(math.log(known / found)) < math.log(_NEAR_SIDE) else found) / longer
    return round(scale * width), round(scale * height)


def _without_zeros(model: str, distortion: np.ndarray) -> np.ndarray:
    """Return so many of the coefficients as the model may have, if those behind are zeros; else all of them.

    Five zeros, as simulators and drivers of rectified images tell, are no distortion: without it all takes less time.
    """
    used = len(np.trim_zeros(distortion, "b"))
    legal = _COEFFICIENTS.get(model, ())
    if distortion.size in legal and (used or model == EQUIDISTANT):
        return distortion
    return distortion[:min((count for count in legal if used <= count <= distortion.size), default=distortion.size)]


def _check_distortion(model: str, distortion: np.ndarray) -> None:
    if model not in _COEFFICIENTS:
        raise CameraError("unknown distortion model {!r}, known: {}; {}".format(
            model, ", ".join(_COEFFICIENTS), _HINT))
    if distortion.size not in _COEFFICIENTS[model]:
        raise CameraError("{} takes {} coefficients in D, not {}; {}".format(
            model, " or ".join(str(n) for n in _COEFFICIENTS[model]), distortion.size, _HINT))
    if not np.all(np.isfinite(distortion)):
        raise CameraError("D holds numbers that are not finite; {}".format(_HINT))
    if np.any(np.abs(distortion) > _MAX_COEFFICIENT):
        raise CameraError("D holds numbers beyond {:g}; {}".format(_MAX_COEFFICIENT, _HINT))
