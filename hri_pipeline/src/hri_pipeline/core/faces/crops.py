"""Upright crops of faces for networks and topics, their picture quality, whether motion has blurred them, and
whether dark glasses hide the eyes."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple, Optional, Sequence, Tuple

import cv2
import numpy as np

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces.mesh import (
    LANDMARKS,
    LEFT_EYE_CORNER,
    RIGHT_EYE_CORNER,
    FaceRoi,
    cut_square,
    level_roi,
)
from hri_pipeline.core.geometry import Pose, crop_rotated
from hri_pipeline.core.recognition.embedding import face_chip

MAX_SIZE = 1024
"""Largest side (px) of a crop."""
_LANDMARK_EYES = (36, 45)
"""Outer eye corners among the 70 landmarks, the subject's right first."""
_USELESS_EYES, _GOOD_EYES = 12.0, 60.0
"""Distance (px) of the outer eye corners of picture quality 0, and of quality 1."""
_FRONTAL, _PROFILE = np.deg2rad(15.0), np.deg2rad(65.0)
"""Angle (rad) between the face and the line of sight up to which a crop is frontal, and from which it is useless."""
_BLURRED, _SHARP = 0.02, 0.12
"""Standard deviation of the Laplacian over that of the grey values, of a crop of 64 px: useless, and sharp."""
_FLAT, _CONTRAST = 6.0, 25.0
"""Standard deviation of the grey values: useless, and enough."""
_WASHED_OUT, _BURNT = 0.2, 0.9
"""Part of a face that is burnt white up to which it is no harm, and from which the face shows nobody. Templates of 25
people are .25 from those in better light by .15, .34 by .55, .52 by .95 (medians), and burnt white they are alike: .15
to .37 apart. Of 1,000 crops that no light had spoilt none had more than .01."""
_JUDGED_SIZE = 64
EVEN = 0.65
"""Evenness of a crop, as a share of the best one of its face, below which it is blurred by motion. Three people in a
pan of 90 degrees a second: templates of crops below it are .27 to .39 from those at rest, others .06 to .23."""
BLUR_PATIENCE_S = 1.0
"""Time (s) after which a face whose crops stay uneven looks so."""
_BLUR_STEP_S = 0.5 * BLUR_PATIENCE_S
"""Most of that time that lies between two crops: in a longer pause nobody has seen whether they stay uneven."""
_DETAIL = 1.5
_DETAILS, _SHAPES = (0.7, 1.5), (2.0, 4.0)
"""Deviations (px) of the two blurs between which are details, and what is some three times as large."""
SMEARED_DETAILS, SMEARED_ACROSS = 0.40, 0.65
"""Contrast of the details in the direction with least of them, over that of what is larger, and over that of details
across it, below which a crop is blurred by motion. By 7 px of a face of 50, or 15 of 90, in two levels of noise: 85 to
97 % of the crops of 25 people, and 35 % by 9 of 90. Out of focus by 4 px 12 %, 30 px wide 4, others 0 to 5 (clear,
hats, hair, shade, hands, JPEG, smoothed). A lens or an analogue camera that is soft in one direction looks so, too."""
SMEARED_PATIENCE_S, _SMEARED_STEP_S = 30.0, 2.0
"""Time (s) after which a face all whose crops look blurred by motion is seen so by its camera; most of it that lies
between two crops."""
_FEATURES, _FEATURES_EDGE = (1.0, 2.5), 6
"""Deviations (px) of the two blurs between which the features of a face are, and what is left away at each side."""
_GRAIN = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]], np.float32) / 6.0
_GRAIN_SIZE, _GRAIN_EDGE = 48, 6
"""Size (px) at which a crop is looked at for noise, since cameras smooth theirs, but for so much at each side: less of
it is face."""
_NORMAL_MEDIAN = 0.6745
"""Median of the absolute values of normal noise, in standard deviations."""
_FINEST = 4
"""Most times the size of a crop at which it is drawn before it is averaged, in a view that is not the image."""
_EYE_PARTS = ((0.245, 0.385, 0.22, 0.39), (0.245, 0.385, 0.61, 0.78))
"""Where `face_chip` shows either eye with its lids, most of a lens, without the brow: top, bottom, left and right, in
sides of the crop."""
_BELOW_EYES = ((0.345, 0.385, 0.245, 0.365), (0.345, 0.385, 0.635, 0.755))
"""The same of what is below the eyes, still in a lens."""
_BARE_PARTS = ((0.48, 0.56, 0.22, 0.32), (0.48, 0.56, 0.68, 0.78), (0.42, 0.52, 0.455, 0.535))
_FOREHEAD_PART = (0.08, 0.16, 0.40, 0.60)
"""The same of both cheeks and the nose, and of the forehead."""
DARK_LENS, _DARK_FOREHEAD = 0.33, 0.5
"""Light of the lighter parts of an eye and its lids, over that of the second lightest of forehead, nose and cheeks,
below which it is behind dark glasses (else .5 and more); and the same bound against the forehead."""
LENS_COLOUR = 0.14
"""Difference of a lens's colour (parts of blue, green and red of their sum, the differences added) from that of the
skin, from which it mirrors. Of 148 bare faces .11 at most."""
_LENS_PART, _LENS_CROP = 0.75, 50
"""Which part of an eye and its lids is darker than what is taken of it; and the size (px) of the crop."""
_LENS_GRAIN, _LENS_LIGHT = 5, 90.0
"""Side (px) of the squares over which colours of lenses are averaged, and the least light (sum of the colours) by which
their difference is judged: in dim light the colours of pixels, and of blotches, are noise."""
_GLASSES_PERIOD, _GLASSES_OFF = 0.5, 2
"""Time (s) between two looks for dark glasses, and how many of a face that is not turned away show none until they are
off."""
_SIDEWAYS = np.deg2rad(25.0)
"""Turn (rad) from which a look may miss them: of drawn ones .74 are found from about there on, else .97."""


def upright_roi(points: np.ndarray, margin: float = 1.3) -> FaceRoi:
    """Return the square around a face with level eyes; points: (478, 2 or more) mesh or (70, 2 or more) landmarks, px.

    margin: side of the square over the larger side of the points' box. Raises ValueError for another number of
    points, for points that are not finite or all in one place, and for a margin that is not positive.
    """
    xy = np.asarray(points, dtype=np.float64)[:, :2]
    if len(xy) not in (LANDMARKS, 468, 478):
        raise ValueError("a face has 468 or 478 mesh points or 70 landmarks, not {}".format(len(xy)))
    if not np.isfinite(xy).all() or not margin > 0.0:
        raise ValueError("a crop needs finite points and a positive margin, got margin {!r}".format(margin))
    right, left = _LANDMARK_EYES if len(xy) == LANDMARKS else (RIGHT_EYE_CORNER, LEFT_EYE_CORNER)
    roi = level_roi(xy, right, left, margin)
    if roi.size < 1.0:
        raise ValueError("the points of the face all lie in one place")
    return roi


def aligned_crop(bgr: np.ndarray, points: np.ndarray, size: int, margin: float = 1.3,
                 camera: Optional[CameraModel] = None) -> np.ndarray:
    """Return (size, size, 3) uint8 BGR of a face, upright with level eyes; the image's border is repeated outside.

    bgr: (H, W, 3) uint8. points, margin: see `upright_roi`. camera: of the image; where it is calibrated, the face is
    shown as a camera sees it that looks at it. Raises ValueError as `upright_roi` does, and for a bad size.
    """
    places = np.asarray(points, dtype=np.float64)[:, :2]
    view = None if camera is None else camera.facing_view(places)
    if view is None:
        return cut(bgr, upright_roi(places, margin), size)
    return cut(bgr, replace(upright_roi(view.see(places), margin), view=view), size)


def cut(bgr: np.ndarray, roi: FaceRoi, size: int) -> np.ndarray:
    """Return the (size, size, 3) picture of a rotated square; a large one is averaged first, against aliasing."""
    if not 1 <= size <= MAX_SIZE:
        raise ValueError("size of a crop is {} px, legal range 1 to {}".format(size, MAX_SIZE))
    shrink = int(roi.size / size)
    if shrink < 2:
        return cut_square(bgr, roi, size)[0]
    if roi.view is not None:
        drawn = cut_square(bgr, roi, size * min(shrink, _FINEST))[0]
        return cv2.resize(drawn, (size, size), interpolation=cv2.INTER_AREA)
    height, width = bgr.shape[:2]
    reach = roi.size * 0.7072 + 2.0 * shrink
    x0, y0 = (int(np.clip(value, 0, limit - 1)) for value, limit in zip(roi.centre - reach, (width, height)))
    x1, y1 = (int(np.clip(value, low + 1, limit))
              for value, low, limit in zip(roi.centre + reach, (x0, y0), (width, height)))
    small = (max(1, (x1 - x0) // shrink), max(1, (y1 - y0) // shrink))
    patch = cv2.resize(bgr[y0:y1, x0:x1], small, interpolation=cv2.INTER_AREA)
    scale = np.array([small[0] / (x1 - x0), small[1] / (y1 - y0)])
    centre = (roi.centre - (x0, y0)) * scale
    return crop_rotated(patch, centre.tolist(), roi.size * float(scale.mean()), roi.angle, size)[0]


def box_crop(bgr: np.ndarray, box: Sequence[float], width: int, height: int, margin: float = 1.0) -> np.ndarray:
    """Return (height, width, 3) uint8 BGR of a box x0, y0, x1, y1 (px), not turned; parts outside are black.

    The proportions of the face are kept: the box grows to those of the crop. margin: factor on the box.
    Raises ValueError for a box without area or a size out of 1 to MAX_SIZE.
    """
    if not (1 <= width <= MAX_SIZE and 1 <= height <= MAX_SIZE):
        raise ValueError("size of a crop is {}x{} px, legal range 1 to {}".format(width, height, MAX_SIZE))
    corners = np.asarray(box, dtype=np.float64)
    sides = corners[2:] - corners[:2]
    if not np.isfinite(corners).all() or sides.min() < 1.0:
        raise ValueError("{} is no box of a face".format(corners))
    scale = float((margin * sides / (width, height)).max())
    corner = (corners[:2] + corners[2:] - scale * np.array([width, height])) / 2.0
    affine = np.array([[scale, 0.0, corner[0] + 0.5 * (scale - 1.0)], [0.0, scale, corner[1] + 0.5 * (scale - 1.0)]])
    return cv2.warpAffine(bgr, affine, (width, height), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
                          borderMode=cv2.BORDER_CONSTANT)


class CropJudgement(NamedTuple):
    """Picture quality of a crop, 0 (useless) to 1, and what spoils it most, in words.

    exposure: part (0 to 1) of the quality that a template has, as some of the face is burnt white: age and gender are
    still seen then, but hardly who it is.
    """

    quality: float
    flaw: str
    exposure: float = 1.0

    @property
    def template_quality(self) -> float:
        """Quality (0 to 1) of a template of such a crop."""
        return self.quality * self.exposure


def crop_quality(points: np.ndarray, pose: Optional[Pose], crop: np.ndarray, presence: float = 1.0,
                 image_size: Optional[Tuple[int, int]] = None) -> float:
    """Return the picture quality of an upright crop of a face, 0 (useless) to 1; parameters: see `judge_crop`."""
    return judge_crop(points, pose, crop, presence, image_size).quality


def judge_crop(points: np.ndarray, pose: Optional[Pose], crop: np.ndarray, presence: float = 1.0,
               image_size: Optional[Tuple[int, int]] = None) -> CropJudgement:
    """Judge an upright crop of a face.

    The geometric mean of size, frontality, sharpness and contrast, times presence and the fraction of the face in the
    image: one bad property spoils a crop.

    Parameters
    ----------
    points
        (478, 2 or more) or (70, 2 or more) px of the image from which the crop was cut.
    pose
        Face frame in the optical frame, None when not known (then the frontality is a half).
    crop
        (S, S, 3) uint8 BGR.
    presence
        Probability 0 to 1 of the face.
    image_size
        Width and height, px: points outside reduce the quality.
    """
    xy = np.asarray(points, dtype=np.float64)[:, :2]
    if not np.isfinite(xy).all():
        return CropJudgement(0.0, "no points")
    right, left = _LANDMARK_EYES if len(xy) == LANDMARKS else (RIGHT_EYE_CORNER, LEFT_EYE_CORNER)
    eyes = float(np.linalg.norm(xy[left] - xy[right]))
    turned = None if pose is None else turned_away(pose)
    facing = 0.5 if turned is None else _ramp(_PROFILE - turned, 0.0, _PROFILE - _FRONTAL)
    # A turned head has its eye corners closer together, without being smaller.
    size = eyes if turned is None else eyes / max(0.4, float(np.cos(turned)))
    grey = _judged(crop)
    contrast = float(grey.std())
    sharpness = float(cv2.Laplacian(grey, cv2.CV_32F).std()) / max(contrast, 1.0) / 4.0
    parts = (_ramp(size, _USELESS_EYES, _GOOD_EYES), facing, _ramp(sharpness, _BLURRED, _SHARP),
             _ramp(contrast, _FLAT, _CONTRAST))
    inside = 1.0
    if image_size is not None:
        inside = float(((xy >= 0.0) & (xy < image_size)).all(axis=1).mean())
    sure, exposure = float(np.clip(presence, 0.0, 1.0)), _ramp(_BURNT - burnt_part(crop), 0.0, _BURNT - _WASHED_OUT)
    quality = float(np.prod(parts) ** (1.0 / len(parts)) * sure * inside ** 2)
    flaws = ("small ({:.0f} px between the eyes)".format(size), "pose not known" if turned is None else
             "turned away ({:.0f} degrees)".format(np.degrees(turned)), "blurred", "dark or flat", "hardly a face",
             "cut off by the border", "overexposed")
    worst = int(np.argmin([part ** (1.0 / len(parts)) for part in parts] + [sure, inside ** 2, exposure]))
    return CropJudgement(quality, flaws[worst], exposure)


def burnt_part(crop: np.ndarray, white: int = 250) -> float:
    """Return the part (0 to 1) of the middle of a crop (S, S, 3) uint8 BGR that is white, as it was exposed for too
    long: at least `white` (0 to 255) in all channels, which noise and compression may have changed."""
    middle = slice(len(crop) // 5, len(crop) - len(crop) // 5)
    return float((crop[middle, middle].min(axis=2) >= white).mean())


def turned_away(pose: Pose) -> float:
    """Return the angle (rad) between the direction of a face and the line from it to the camera."""
    to_camera = -pose.translation / max(1e-9, float(np.linalg.norm(pose.translation)))
    return float(np.arccos(np.clip(pose.rotation[:, 0] @ to_camera, -1.0, 1.0)))


def _ramp(value: float, low: float, high: float) -> float:
    return min(max((value - low) / (high - low), 0.0), 1.0)


class MotionBlur:
    """Whether crops of one face are blurred by a motion of the head or the camera: their details lie along it."""

    def __init__(self) -> None:
        self._best = 0.0
        self._last: Optional[float] = None
        self._uneven_for = self._smeared_for = 0.0
        self._smeared_at: Optional[float] = None

    def is_blurred(self, crop: np.ndarray, stamp: float) -> bool:
        """Take a crop (S, S, 3) uint8 BGR of the image at `stamp` (s); tell if it is blurred against the others."""
        value = evenness(crop)
        is_uneven = value < EVEN * self._best
        if is_uneven:
            passed = stamp - self._last if self._last is not None and stamp >= self._last else 0.0
            self._uneven_for += min(passed, _BLUR_STEP_S)
            self._last = stamp
            if self._uneven_for < BLUR_PATIENCE_S:
                return True
        self._best = value if is_uneven else max(value, self._best)
        self._last, self._uneven_for = None, 0.0
        return False

    def is_smeared(self, crop: np.ndarray, stamp: float) -> bool:
        """Take a crop (S, S, 3) uint8 BGR of the image at `stamp` (s); tell if it looks blurred by itself, and not all
        have done so for longer than a motion lasts."""
        if not looks_smeared(crop):
            self._smeared_at, self._smeared_for = None, 0.0
            return False
        if self._smeared_at is not None and stamp >= self._smeared_at:
            self._smeared_for += min(stamp - self._smeared_at, _SMEARED_STEP_S)
        self._smeared_at = stamp
        return self._smeared_for < SMEARED_PATIENCE_S


def evenness(crop: np.ndarray) -> float:
    """Return the contrast of the details of a crop (S, S, 3) uint8 BGR in the direction with least of it, over that
    across it, 0 to 1: from the structure tensor (Foerstner and Guelch 1987)."""
    grey = _judged(crop)
    least, most = _extremes(_structure(grey - cv2.GaussianBlur(grey, (0, 0), _DETAIL)))
    return least / max(1e-3, most)


def looks_smeared(crop: np.ndarray) -> bool:
    """Tell whether a crop (S, S, 3) uint8 BGR is blurred by motion, by itself; see MotionBlur for a face whose sharp
    crops are known."""
    grey = _judged(crop)
    least, most = _extremes(_structure(_between(grey, *_DETAILS)))
    shapes = float(np.hypot(*_extremes(_structure(_between(grey, *_SHAPES)))))
    return least < SMEARED_DETAILS * shapes and least < SMEARED_ACROSS * most


def _between(grey: np.ndarray, fine: float, coarse: float) -> np.ndarray:
    """Return what of a picture (H, W) float32 lies between two blurs of these deviations (px), without its border."""
    band = cv2.GaussianBlur(grey, (0, 0), fine) - cv2.GaussianBlur(grey, (0, 0), coarse)
    return band[_FEATURES_EDGE:-_FEATURES_EDGE, _FEATURES_EDGE:-_FEATURES_EDGE]


def _extremes(tensor: Tuple[float, float, float]) -> Tuple[float, float]:
    """Return the contrast in the direction with least of it, and across it, of a structure tensor (xx, xy, yy)."""
    xx, xy, yy = tensor
    mean, apart = 0.5 * (xx + yy), float(np.hypot(0.5 * (xx - yy), xy))
    return float(np.sqrt(max(0.0, mean - apart))), float(np.sqrt(mean + apart))


def _judged(crop: np.ndarray) -> np.ndarray:
    """Return a crop (S, S, 3) uint8 BGR in grey, in the size in which crops are compared, float32."""
    return cv2.cvtColor(cv2.resize(crop, (_JUDGED_SIZE, _JUDGED_SIZE), interpolation=cv2.INTER_AREA),
                        cv2.COLOR_BGR2GRAY).astype(np.float32)


def _structure(picture: np.ndarray) -> Tuple[float, float, float]:
    """Return the structure tensor (xx, xy, yy) of a picture (H, W) float32, summed over all of it."""
    along_x = (picture[1:-1, 2:] - picture[1:-1, :-2]).ravel()
    along_y = (picture[2:, 1:-1] - picture[:-2, 1:-1]).ravel()
    return float(along_x @ along_x), float(along_x @ along_y), float(along_y @ along_y)


def features(crop: np.ndarray) -> Tuple[float, float, float]:
    """Return how much there is of eyes, nose and mouth in each direction of a crop (S, S, 3) uint8 BGR, for `smeared`:
    a structure tensor (xx, xy, yy). What is finer may be noise."""
    return _structure(_between(_judged(crop), *_FEATURES))


def smeared(one: Tuple[float, float, float], other: Tuple[float, float, float]) -> float:
    """Return what is left of the features of one crop in the direction with least of them, against those of another
    one, over the same in the direction with most: 1 alike, 0 blurred along a line. Light, distance and focus are the
    same in all directions. The root of the ratio of the generalised eigenvalues; one, other: see `features`."""
    (axx, axy, ayy), (bxx, bxy, byy) = one, other
    determinant = max(1e-6, bxx * byy - bxy * bxy)
    half = 0.5 * (axx * byy + ayy * bxx - 2.0 * axy * bxy) / determinant
    apart = float(np.sqrt(max(0.0, half * half - max(0.0, axx * ayy - axy * axy) / determinant)))
    return float(np.sqrt(max(0.0, half - apart) / max(1e-9, half + apart)))


def relative_noise(crop: np.ndarray) -> float:
    """Return the standard deviation of the noise in a crop (S, S, 3) uint8 BGR over the contrast of the face.

    Of the grey values at 48 px, by second differences in both directions (J. Immerkaer, "Fast noise variance
    estimation", Computer Vision and Image Understanding 64, 1996), with their median: edges are few. Sharpness of
    `judge_crop` cannot tell noise from details.
    """
    grey = cv2.cvtColor(cv2.resize(crop, (_GRAIN_SIZE, _GRAIN_SIZE), interpolation=cv2.INTER_AREA),
                        cv2.COLOR_BGR2GRAY).astype(np.float32)
    grain = cv2.filter2D(grey, cv2.CV_32F, _GRAIN)[_GRAIN_EDGE:-_GRAIN_EDGE, _GRAIN_EDGE:-_GRAIN_EDGE]
    return float(np.median(np.abs(grain))) / _NORMAL_MEDIAN / max(float(grey.std()), 1.0)


class DarkGlasses:
    """Whether one face wears dark glasses, over time."""

    def __init__(self) -> None:
        self.are_worn = False
        self._looked = -np.inf
        self._bare = 0

    def update(self, bgr: np.ndarray, mesh: np.ndarray, pose: Pose, stamp: float,
               camera: Optional[CameraModel] = None) -> bool:
        """Return whether they are worn in an image, which is looked at twice a second.

        bgr: (H, W, 3) uint8; mesh: (478, 2 or more) px; pose: of the face in the optical frame; stamp: s; camera: see
        face_chip. Raises ValueError for points that are not finite or in one place.
        """
        if 0.0 <= stamp - self._looked < _GLASSES_PERIOD:
            return self.are_worn
        self._looked = stamp
        if behind_dark_glasses(face_chip(bgr, mesh, _LENS_CROP, camera=camera)):
            self.are_worn, self._bare = True, 0
        elif turned_away(pose) < _SIDEWAYS:
            self._bare += 1
            self.are_worn = self.are_worn and self._bare < _GLASSES_OFF
        return self.are_worn


def behind_dark_glasses(crop: np.ndarray) -> bool:
    """Return whether a crop of dlib's alignment (S, S, 3) uint8 BGR shows both eyes behind dark glasses, or lenses that
    mirror in another colour than skin has."""
    return _has_dark_lenses(crop) or _has_coloured_lenses(crop)


def _has_dark_lenses(crop: np.ndarray) -> bool:
    """Whether eyes and lids are far darker than the rest of the face. Under a dark forehead they may be in a cap's
    shade, or behind hair."""
    grey = cv2.cvtColor(crop, cv2.COLOR_BGR2GRAY)
    lenses = max(_light(grey, part, _LENS_PART) for part in _EYE_PARTS)
    forehead = _light(grey, _FOREHEAD_PART, 0.5)
    if lenses >= _DARK_FOREHEAD * forehead:
        return False
    return lenses < DARK_LENS * sorted([forehead] + [_light(grey, part, 0.5) for part in _BARE_PARTS])[-2]


def _has_coloured_lenses(crop: np.ndarray) -> bool:
    """Whether lids, and what is below the eyes, have another colour than nose and cheeks on both sides: make-up ends
    above."""
    crop = cv2.blur(crop, (_LENS_GRAIN, _LENS_GRAIN))
    skin = np.sum([_cut_part(crop, part).sum(axis=(0, 1)) for part in _BARE_PARTS], axis=0, dtype=np.float32)
    skin /= max(float(skin.sum()), 1.0)
    for part in _BELOW_EYES + _EYE_PARTS:
        pixels = _cut_part(crop, part).reshape(-1, 3).astype(np.float32)
        apart = np.abs(pixels - pixels.sum(axis=1, keepdims=True) * skin).sum(axis=1)
        # The median, without sorting.
        if 2 * np.count_nonzero(apart > LENS_COLOUR * np.maximum(pixels.sum(axis=1), _LENS_LIGHT)) <= len(apart):
            return False
    return True


def _light(grey: np.ndarray, part: Sequence[float], share: float) -> float:
    """Return the grey value below which this share of a part of a square picture (S, S) uint8 lies; part: top, bottom,
    left, right, in sides of it."""
    values = np.sort(_cut_part(grey, part), axis=None)
    return float(values[int(share * len(values))])


def _cut_part(picture: np.ndarray, part: Sequence[float]) -> np.ndarray:
    """Return a part of a square picture (S, S, ...): top, bottom, left, right, in sides of it."""
    top, bottom, left, right = (int(round(side * len(picture))) for side in part)
    return picture[top:bottom, left:right]
