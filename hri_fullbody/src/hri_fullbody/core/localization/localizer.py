"""Where a body stands in front of the camera and how large it is, in metres.

Perspective-n-Point from its metric landmarks (`solve_pnp`), which are those of a person of average height, times a
scale (`scale.py`). Of a body that a side or the top of the image cuts, a pose network squeezes the whole person into
what it still sees: it is placed only where that agrees with what was before (`CutRange`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Dict, NamedTuple, Optional, Tuple

import cv2
import numpy as np

from hri_fullbody.core.detection.pose_estimator import BODY_LANDMARKS, PoseDetection
from hri_fullbody.core.keypoints import (
    BLAZE_LEFT_HIP,
    BLAZE_LEFT_SHOULDER,
    BLAZE_RIGHT_HIP,
    BLAZE_RIGHT_SHOULDER,
    Jitter,
    confidence_18,
    thighs_leave_image,
    to_18_points,
    trunk_in_image,
    wrist_to_knuckles,
)
from hri_fullbody.core.localization.scale import (
    TRUNK,
    BodyScale,
    ScaleCue,
    depth_cue,
    face_cue,
    floor_ratio,
    trunk_ratio,
)
from hri_fullbody.core.tracking.track import BodyTrack
from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.geometry import Pose, median_of_few
from hri_pipeline.core.image_rotation import ImageRotation
from hri_pipeline.core.images import sample_depth
from hri_pipeline.core.observations import BodyObservation
from hri_pipeline.core.one_euro import OneEuro
from hri_pipeline.core.picture_jumps import Jump

LEAST_POINTS = 6
DEPTH_RANGE = (0.25, 25.0)
_LEAST_TRACE = 1.0 + 2.0 * math.cos(math.radians(35.0))     # of the largest turn that is plausible
_LEAST_OUTLIER = 0.04
_ROUNDS = 3
_NO_LENS = np.eye(3)
_NEXT, _LAST = [1, 2, 0], [2, 0, 1]
# Parts of the body's extent: what comes so near to the border may go on behind it; a face that is lost so near to it
# has left.
_REACH, _FACE_REACH = 0.1, 0.2
_FARTHER = 0.08         # logarithm of the range: as much as ranges of one who is seen whole are apart,
_FARTHER_RATE = 0.02    # and more per s since the last range that was right
_SPEED = 0.3            # m/s by which the range follows one who is cut; a squeezed one shrinks faster


def solve_pnp(rays: np.ndarray, world: np.ndarray, seen: np.ndarray) -> Optional[np.ndarray]:
    """Move root-relative landmarks to where they are seen: (N, 3) m in the optical frame, or None.

    rays: (N, 2) x/z and y/z, without lens distortion. world: (N, 3) m around the hips, axes of the camera.
    seen: (N,) bool, which points count. The network looks along the window's own ray, so the landmarks are also turned.
    Points that fit badly are left out once. None when fewer than 6 are seen or no plausible depth (0.25 to 25 m)
    comes out.
    """
    use = np.asarray(seen, dtype=bool) & np.isfinite(rays).all(axis=1) & np.isfinite(world).all(axis=1)
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
        moved = np.ravel(shift)
        # The trace of a rotation is 1 + 2 cos of its angle: here that of the one to the ray, and back.
        if np.vdot(rotation, to_ray) > _LEAST_TRACE and _plausible(world @ rotation.T + moved):
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
    x, y = ray.tolist()
    away = math.hypot(x, y)
    if away < 1e-9:
        return np.eye(3)
    angle = math.atan(away)     # about optical axis x direction
    return cv2.Rodrigues(np.array([-y / away * angle, x / away * angle, 0.0]))[0]


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
    if length < 1e-6:
        return None
    left = left / length
    forward = left[_NEXT] * up[_LAST] - left[_LAST] * up[_NEXT]     # numpy.cross takes 0.03 ms
    return np.array([forward, left, up]).T.copy()


def _plausible(points: np.ndarray) -> bool:
    depth = points[:, 2]
    return bool(np.isfinite(points).all() and depth.min() > 0.05
                and DEPTH_RANGE[0] < median_of_few(depth) < DEPTH_RANGE[1])


def _lateral_error(rays: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Distance (N,) m, across the view, of each point from its ray."""
    return np.hypot(*(points[:, :2] - rays * points[:, 2:]).T)


# How far a joint lies behind the surface that a camera sees, m: half the thickness of the limb.
_BEHIND: Dict[int, float] = {
    11: 0.07, 12: 0.07, 13: 0.045, 14: 0.045, 15: 0.03, 16: 0.03, 23: 0.10, 24: 0.10, 25: 0.055, 26: 0.055,
    27: 0.04, 28: 0.04}
_JOINTS = np.array(sorted(_BEHIND))
_BEHIND_JOINTS = np.array([_BEHIND[joint] for joint in _JOINTS])
_PARENT: Dict[int, int] = {13: 11, 14: 12, 15: 13, 16: 14, 25: 23, 26: 24, 27: 25, 28: 26}
# A surface further than this from where the body is expected is something before or behind it.
_LARGEST_JUMP = 0.25
_STRETCH, _SLACK = 1.15, 0.05


def measured_joints(depth: np.ndarray, pixels: np.ndarray, rays: np.ndarray, points: np.ndarray,
                    confidence: np.ndarray, size: Tuple[int, int]) -> np.ndarray:
    """Put the landmarks (33, 3) m of a body, which is at the right distance, on their rays (33, 2) at measured depths.

    A joint whose surface lies off by more than 0.25 m, or farther from the joint before it than the limb is long, is
    hidden behind something, or its pixel shows the background: it keeps its depth on its ray.
    """
    found = points.copy()
    depths = points[:, 2].copy()
    surface = sample_depth(depth, pixels[_JOINTS], *size) + _BEHIND_JOINTS
    usable = (confidence[_JOINTS] > 0.3) & (np.abs(surface - points[_JOINTS, 2]) < _LARGEST_JUMP)
    for joint, good, value in zip(_JOINTS, usable, surface):
        parent = _PARENT.get(int(joint))
        if good and parent is not None:
            limb = float(np.linalg.norm(points[joint] - points[parent]))
            good = abs(value - depths[parent]) <= _STRETCH * limb + _SLACK
        if good:
            depths[joint] = value
    sure = confidence[:BODY_LANDMARKS] > 0.3
    found[sure] = np.column_stack([rays[sure] * depths[sure, None], depths[sure]])
    return found


def is_cut(box: np.ndarray, extent: float, width: int) -> bool:
    """Tell whether a body whose seen landmarks have this box (4,) px may go on beyond the left, right or upper border.

    extent: its size, px. width: of the image, px. Beyond the lower border are legs, of which nothing else depends.
    """
    x0, y0, x1, _ = box.tolist()
    return min(x0, width - x1, y0) < _REACH * extent


def is_leaving(face: np.ndarray, extent: float, size: Tuple[int, int]) -> bool:
    """Tell whether a face at (2,) px, of a body of this extent (px), is so near to the border that it may leave the
    image. size: width and height of the image, px."""
    (x, y), (width, height) = face.tolist(), size
    return min(x, y, width - x, height - y) < _FACE_REACH * extent


class CutRange:
    """Whether the range of a body that is cut agrees with what it was before: a squeezed one seems to be farther."""

    def __init__(self) -> None:
        self._range: Optional[float] = None
        self._stamp = 0.0

    def is_right(self, distance: float, stamp: float, cut: bool, sure: bool) -> bool:
        """Take the range (m) of a body's landmarks at `stamp` (s); tell whether they show where it is.

        cut: its face has left, and the border cuts it. sure: face or depth image tell the distance. The longer ago the
        last right range is, the more is allowed; a body that was never seen otherwise is right.
        """
        elapsed = max(0.0, stamp - self._stamp)
        if not cut:
            self._range, self._stamp = distance, stamp
        elif self._range is not None:
            if not sure and math.log(distance / self._range) > _FARTHER + _FARTHER_RATE * elapsed:
                return False
            way = _SPEED * elapsed
            self._range, self._stamp = self._range + min(max(distance - self._range, -way), way), stamp
        elif sure:
            self._range, self._stamp = distance, stamp
        return True


# A body is about as large as this: makes pixels comparable with metres, for which the filters are tuned.
_BODY_METRES = 1.76
_KNOWN = 0.3
# Beta of the filter of the distance where a depth image gives it.
_AGILITY_BY_DEPTH = 10.0
# m/s, of a face that is still the body's own, and the time within which it may have jumped.
_FASTEST, _SHORTEST_S = 4.0, 0.05
_BOX_MARGIN = 0.04


@dataclass(frozen=True)
class SceneContext:
    """What else is known of an image.

    depth: (h, w) m, registered to it. up: (3,) unit, in the optical frame. camera_height: m above the floor;
    height_sd: standard deviation of its logarithm. faces: faces are looked for, so that whoever turns to the camera
    will have one.
    """

    depth: Optional[np.ndarray] = None
    up: Optional[np.ndarray] = None
    camera_height: Optional[float] = None
    height_sd: float = 0.0
    faces: bool = False


class _Still(NamedTuple):
    """What the images after a measurement have in common: between two of them a body is only moved on.

    keypoints: (18, 2) px. box: see visible_box. in_space: (18, 3) m, NaN unknown; None, like pose and hands (see
    `keypoints.wrist_to_knuckles`), where the body has no place.
    """

    detection: PoseDetection
    keypoints: np.ndarray
    box: np.ndarray
    in_space: Optional[np.ndarray]
    pose: Optional[Pose]
    hands: Optional[np.ndarray]


class BodyLocalizer:
    """Filters of one body. The key points in the image go through a one euro filter, 1.5 Hz and 6 per m/s, which lags
    21 ms behind a waving wrist. In space only the distance is filtered, less where a depth image gives it: it trembles
    most, and jumps where depth has gaps. What becomes of the rest is left to whoever fits a model to it."""

    def __init__(self) -> None:
        self._image = OneEuro(1.5, 6.0)
        self._distance = OneEuro(0.8, 4.0)
        self._jitter = Jitter()
        self._scale = BodyScale()
        self._cut_range, self._face_leaves, self._had_face = CutRange(), False, False
        self._pixels_per_metre: Optional[float] = None
        self._pixels: Optional[np.ndarray] = None
        self._points: Optional[np.ndarray] = None
        self._face: Optional[np.ndarray] = None
        self._still: Optional[_Still] = None
        self.by_depth = False
        """Whether a depth image gave the distance of the last detection."""

    @property
    def size(self) -> Optional[Tuple[float, float]]:
        """See BodyScale.measured; None while a depth image measures the body."""
        return None if self.by_depth else self._scale.measured

    def turn(self, rotation: ImageRotation) -> None:
        """Turn with the images; the filter of the key points begins with the next ones."""
        self._image.reset()
        self._jitter.reset()
        self._pixels = None if self._pixels is None else rotation.pixels(self._pixels)
        self._points = None if self._points is None else rotation.vectors(self._points)
        self._face = None if self._face is None else rotation.vectors(self._face)
        self._still = None

    def forget_places(self, farther: float, jump: Optional[Jump] = None) -> None:
        """Let the body be where it is seen next, without a way from where it was: the picture has made this `jump`, or
        the camera's calibration is told anew. Until then it is so many times `farther` away. Its size stays."""
        self._image.reset()
        self._jitter.reset()
        self._distance.reset()
        self._cut_range, self._face, self._still = CutRange(), None, None
        if jump is not None and self._pixels is not None:
            self._pixels = jump.pixels(self._pixels)
        if self._points is not None:
            self._points = self._points + (0.0, 0.0, (farther - 1.0) * float(self._points[TRUNK, 2].mean()))

    def measures(self, track: BodyTrack, stamp: float) -> bool:
        """Tell whether `observe` takes up a detection at `stamp` (s): else it needs no scene."""
        return track.stamp == stamp or self._pixels is None

    def observe(self, track: BodyTrack, camera: CameraModel, stamp: float, face: Optional[Pose],
                context: SceneContext) -> BodyObservation:
        """Make the observation of a body at `stamp` (s). face: the pose of its own tracked face."""
        measured = self.measures(track, stamp)
        if measured:
            self._measure(track, camera, face, context)
            self._face, self._still = None if face is None else face.translation, None
        still = self._standing_still(track)
        estimate = track.expected(stamp)
        age = max(0.0, stamp - track.stamp)
        velocity = track.motion.velocity
        velocity = None if velocity is None else velocity * self._scale.value
        moved = np.zeros(2) if measured else track.moved_with_face(stamp)
        in_space, pose = still.in_space, still.pose
        if in_space is None:
            in_space = np.full((18, 3), np.nan)
        elif not measured:
            way = self._shift(velocity, age, face)
            in_space = np.add(in_space, way)
            pose = None if pose is None else pose.moved(way)
        keypoints = np.empty((18, 3))
        np.add(still.keypoints, moved, out=keypoints[:, :2])
        keypoints[:, 2] = confidence_18(estimate.confidence[:BODY_LANDMARKS])
        # What a body expresses is told of measured ones only.
        last = track.estimate
        trunk = trunk_in_image(last.landmarks, last.world) if measured else math.nan
        leaving = measured and thighs_leave_image(last.landmarks, last.world, camera.height)
        return BodyObservation(track.id, _in_image(still.box, moved, camera.width, camera.height),
                               estimate.score, keypoints, in_space, pose, face, velocity, measured, self.by_depth,
                               still.hands, trunk, leaving, self._jitter.reliability)

    def _standing_still(self, track: BodyTrack) -> _Still:
        """The body as it was measured last, made once for all images until the next measurement."""
        if self._still is None or self._still.detection is not track.detection:
            assert self._pixels is not None
            confidence = track.estimate.confidence[:BODY_LANDMARKS]
            in_space, pose, hands = None, None, None
            if self._points is not None:
                in_space = np.where((confidence_18(confidence) >= _KNOWN)[:, None], to_18_points(self._points), np.nan)
                pose, hands = body_pose(self._points), wrist_to_knuckles(self._points, confidence, _KNOWN)
            self._still = _Still(track.detection, to_18_points(self._pixels),
                                 visible_box(self._pixels, confidence), in_space, pose, hands)
        return self._still

    def _shift(self, velocity: Optional[np.ndarray], age: float, face: Optional[Pose]) -> np.ndarray:
        """Way (3,) m since the body was measured: that of its face, else by its velocity (m/s) in `age` s."""
        if face is not None and self._face is not None:
            way = face.translation - self._face
            if math.hypot(*way.tolist()) < _FASTEST * max(age, _SHORTEST_S):
                return way
        return np.zeros(3) if velocity is None else velocity * age

    def _measure(self, track: BodyTrack, camera: CameraModel, face: Optional[Pose], context: SceneContext) -> None:
        estimate = track.estimate
        if self._pixels_per_metre is None:
            self._pixels_per_metre = estimate.extent / _BODY_METRES
        pixels = estimate.landmarks[:BODY_LANDMARKS, :2]
        self._pixels = self._image(pixels / self._pixels_per_metre, track.stamp) * self._pixels_per_metre
        self._jitter.update(to_18_points(pixels), estimate.extent, track.stamp, track.carried)
        points = track.detection.points
        measured = None if points is None else _depth_cue_of(points, track, camera, context)
        self._had_face = self._had_face or face is not None
        awaited = context.faces and not self._had_face and measured is None and track.face_comes(camera.height)
        if points is None or awaited or not self._is_there(points, track, camera, face, measured is not None):
            self._points, self.by_depth = None, False
            self._distance.reset()
        else:
            self._points = self._rescale(points, track, camera, face, context, measured)

    def _is_there(self, points: np.ndarray, track: BodyTrack, camera: CameraModel, face: Optional[Pose],
                  by_depth: bool) -> bool:
        """Whether a body, which the border may cut, is where its landmarks (33, 3) m are. by_depth: a depth image tells
        its distance.

        Who turned round, and whose face ended in the image, is there: people walk away.
        """
        distance = self._scale.value * math.hypot(*(0.25 * points[TRUNK].sum(axis=0)).tolist())
        estimate = track.estimate
        if face is not None:
            self._face_leaves = is_leaving(camera.project(face.translation[None])[0], estimate.extent,
                                           (camera.width, camera.height))
        cut = self._face_leaves and is_cut(estimate.box, estimate.extent, camera.width)
        return self._cut_range.is_right(distance, track.stamp, cut, face is not None or by_depth)

    def _rescale(self, points: np.ndarray, track: BodyTrack, camera: CameraModel, face: Optional[Pose],
                 context: SceneContext, measured: Optional[ScaleCue]) -> np.ndarray:
        """Landmarks (33, 3) m at the size and the distance that depth image, face, or floor tell, the first that
        does. measured: the cue of the depth image."""
        pixels = track.estimate.landmarks[:BODY_LANDMARKS, :2]
        confidence = track.estimate.confidence[:BODY_LANDMARKS]
        size = (camera.width, camera.height)
        rays = camera.normalise(pixels)
        self.by_depth = measured is not None
        cue = measured or face_cue(points, face)
        self._scale.update(cue)
        if not self.by_depth and context.up is not None and context.camera_height is not None:
            self._scale.update(self._scale.floor_cue(
                floor_ratio(points, rays, confidence, context.up, context.camera_height), context.height_sd))
        scale = self._scale.value
        anchor, placed = 0.5 * (points[BLAZE_LEFT_HIP] + points[BLAZE_RIGHT_HIP]), points * scale
        if cue is not None:
            anchor = cue.reference
            placed = placed + anchor * (cue.ratio - scale)
        if self.by_depth and context.depth is not None:
            placed = measured_joints(context.depth, pixels, rays, placed, confidence, size)
            anchor = 0.5 * (placed[BLAZE_LEFT_HIP] + placed[BLAZE_RIGHT_HIP])
        depth = np.array([0.5 * (placed[BLAZE_LEFT_HIP, 2] + placed[BLAZE_RIGHT_HIP, 2])])
        filtered = self._distance(depth, track.stamp, _AGILITY_BY_DEPTH if self.by_depth else None)
        return placed + anchor / anchor[2] * (filtered - depth)


def _depth_cue_of(points: np.ndarray, track: BodyTrack, camera: CameraModel, context: SceneContext
                  ) -> Optional[ScaleCue]:
    """Cue of the depth image for the landmarks (33, 3) m of a body, None where it does not tell their distance."""
    if context.depth is None:
        return None
    estimate = track.estimate
    ratio = trunk_ratio(context.depth, estimate.landmarks[:BODY_LANDMARKS, :2], points,
                        estimate.confidence[:BODY_LANDMARKS], (camera.width, camera.height))
    return depth_cue(ratio, points[TRUNK].mean(axis=0))


def visible_box(points: np.ndarray, confidence: np.ndarray) -> np.ndarray:
    """Box (4,) px of the points (N, 2) px that are seen, with a margin of 4 % of its longer side."""
    seen = confidence > _KNOWN
    points = points[seen] if seen.sum() >= 4 else points
    low, high = points.min(axis=0), points.max(axis=0)
    margin = _BOX_MARGIN * float((high - low).max())
    return np.concatenate([low - margin, high + margin])


def _in_image(box: np.ndarray, moved: np.ndarray, width: int, height: int) -> np.ndarray:
    """The part of a moved box (4,) px that is in an image of this size."""
    (x, y), (x0, y0, x1, y1) = moved.tolist(), box.tolist()
    left, top, right, bottom = (min(max(value, 0.0), most) for value, most in (
        (x0 + x, width), (y0 + y, height), (x1 + x, width), (y1 + y, height)))
    return np.array([left, top, right, bottom], dtype=np.float64)
