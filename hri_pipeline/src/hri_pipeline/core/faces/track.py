"""One face over time: what is measured of it in an image, its predicted motion, and its appearance."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Optional, Sequence, Tuple

import cv2
import numpy as np

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces.appearance import FaceLook, FaceMemory
from hri_pipeline.core.faces.mesh import FaceRoi, bounding_box, eye_share, roi_from_mesh
from hri_pipeline.core.image_rotation import ImageRotation
from hri_pipeline.core.picture_jumps import Jump
from hri_pipeline.core.tracks import TrackLife

SIZE_WEIGHT = 0.7
"""Cost of a change of size by a factor e, in face sizes of distance."""
VELOCITY_TIME = 0.15
"""Time constant (s) of the velocity estimate."""
JUMP = 0.5
"""Cost (face sizes) from which a face is no longer where it was expected."""
SURE_FACE = 0.9
"""Presence from which another face at the place of a track is a face without a detection."""
LEAST_VERIFICATION, VERIFIED, MOST_VERIFICATION = -2.0, 0.5, 2.0
"""Legal range of the sum of a track's verification scores, and the sum from which it is a face."""
_SCORE_MEMORY = 0.9
"""Fraction of the score of a track that is kept from one detection to the next."""
_FAST = 0.5
"""Face sizes per second from which a face counts as fast."""
_SPEECH, _SPEECH_TIME = 0.02, 0.5
"""Mean change of the opening of the mouth (face sizes) of somebody who speaks; its time constant (s)."""
_LIPS = [13, 14]
"""Vertices in the middle of the lips' inner rims."""
_FRESH = 3.0
"""Time (s) for which a detection holds the crop of a face."""
_TRUST = 0.4
"""Weight of a detection beside those before it."""
_STEADY, _LARGER = 0.97, 1.35
"""Least size of a crop over the one that the last detection asks for, and the most that it adds."""
_PROFILE, _MOST_TURN = 0.46, math.radians(8.0)
"""Share of the eyes (see `mesh.eye_share`) below which a head is turned far away, and the most by which its crop is
then turned against the detection."""
_COLOUR_GRID = (4, 5)
_COLOUR_MEMORY = 0.9
_SAME_COLOURS, _OTHER_COLOURS = 0.03, 0.12
"""Mean difference of the colours (of 1) of one face between two images, and of two people's."""
_TURNED_COLOURS = 0.2
"""Appearance distance below which the colours are those of the same face, which may have turned: two people of one
photograph are 0.6 and more apart, a head that turns within half a second up to 0.02."""


@dataclass(frozen=True)
class FaceMeasurement:
    """A face found in one image.

    mesh: (478, 3) px; presence: probability 0 to 1; may_start: it may start a track; colours: see `face_colours`, None
    when not measured; hit_weight: what its detection adds to the hit count, 0 to 1; score: of its detection, or of the
    track at which it was found, 0 to 1; verification: see `mesh.verification_score`, -1 (no face) to 1 (a face); look:
    what it looks like, None where that is not compared; crops: that of the detector, and that of the mesh found in it,
    None without a detection.
    """

    mesh: np.ndarray
    presence: float
    may_start: bool
    colours: Optional[np.ndarray] = None
    hit_weight: float = 1.0
    score: float = 0.0
    verification: float = 1.0
    look: Optional[FaceLook] = None
    crops: Optional[Tuple[FaceRoi, FaceRoi]] = None

    @cached_property
    def box(self) -> np.ndarray:
        """Bounding box (4,) px of the mesh."""
        return bounding_box(self.mesh)

    @cached_property
    def place(self) -> Tuple[np.ndarray, float]:
        """Centre (2,) px and size px of the box."""
        return _place(self.box)

    @cached_property
    def openness(self) -> float:
        """How far the lips are apart, face sizes."""
        if len(self.mesh) <= max(_LIPS):
            return 0.0
        return math.hypot(*(self.mesh[_LIPS[0], :2] - self.mesh[_LIPS[1], :2])) / self.place[1]


class CropAnchor:
    """Holds the crop of a face near the one that the detector asks for.

    Each crop is laid round the mesh of the one before. On a profile that runs away: the eyes lie one behind the other,
    so the crop turns a little further each time, and shrinks, until the mesh lies on a part of the face and its pose is
    half as far again. On 49 faces of photographs the size ended at 0.92 to 1.09 of the first one, on two profiles at
    0.76 and 0.81, turned by 30 degrees.

    Parameters
    ----------
    detected
        Crop of a detection.
    first
        Crop of the mesh that was found in it.
    """

    def __init__(self, detected: FaceRoi, first: FaceRoi) -> None:
        self._fill = first.size / detected.size
        self._turn = math.remainder(first.angle - detected.angle, math.tau)
        self._detected = detected

    def see(self, detected: FaceRoi) -> None:
        """Take a later detection of the same face: two of one face differ by some 10 % and 10 degrees."""
        before = self._detected
        self._detected = FaceRoi(detected.centre, before.size + _TRUST * (detected.size - before.size),
                                 before.angle + _TRUST * math.remainder(detected.angle - before.angle, math.tau))

    def turn(self, rotation: ImageRotation) -> None:
        """Turn with the images; the angle between both crops stays."""
        centre, angle = rotation.pixels(self._detected.centre[None])[0], 0.5 * math.pi * rotation.quarters
        self._detected = FaceRoi(centre, self._detected.size, math.remainder(self._detected.angle + angle, math.tau))

    def jump(self, jump: Jump) -> None:
        """Go with a picture that has jumped."""
        before = self._detected
        self._detected = FaceRoi(jump.pixels(before.centre[None])[0], jump.scale * before.size, before.angle)

    def hold(self, roi: FaceRoi, share: float) -> FaceRoi:
        """The crop `roi` of a face, held where it leaves the last detection; share: see `mesh.eye_share`."""
        least = _STEADY * self._fill * self._detected.size
        size, angle = min(max(roi.size, least), _LARGER * roi.size), roi.angle
        if share < _PROFILE:
            level = self._detected.angle + self._turn
            angle = level + min(max(math.remainder(angle - level, math.tau), -_MOST_TURN), _MOST_TURN)
        return replace(roi, size=size, angle=angle)


class FaceTrack:
    """State of one tracked face: last measurement, predicted motion, appearance."""

    def __init__(self, track_id: str, measurement: FaceMeasurement, life: TrackLife, stamp: float) -> None:
        self.id = track_id
        self.life = life
        self.measurement = measurement
        self.visible = True
        self.hit_count = measurement.hit_weight
        self.score, self.verification = measurement.score, measurement.verification
        self.published = False
        self.vouched = self.refused = False     # what its surroundings say of it
        self.replaced = False
        self.memory: Optional[FaceMemory] = None
        self.doubtful_since: Optional[float] = None
        self.detected_at = stamp
        self.unsupported = 0.0
        self._velocity = np.zeros(2)
        self.colours = measurement.colours
        self._anchor = None if measurement.crops is None else CropAnchor(*measurement.crops)
        self._stamp = self._moved_at = stamp
        self._moved = np.zeros(2)
        self._followed = False
        self._centre, self._size = measurement.place
        self._openness, self._speech = measurement.openness, 0.0
        self._predicted: Optional[Tuple[float, np.ndarray]] = None    # of the stamp that was asked for last

    @property
    def measured_at(self) -> float:
        """Stamp (s) of the last measurement."""
        return self._stamp

    @property
    def is_followed(self) -> bool:
        """Whether the optical flow has followed it in every image since the last measurement."""
        return self._followed

    @property
    def size(self) -> float:
        """Size of the face, px."""
        return self._size

    def urgency(self, largest: float) -> float:
        """Weight of its inferences: 1 for a face at rest, more for one that moves, speaks, is near or uncertain.

        largest: size of the largest face in the image, px.
        """
        speed = math.hypot(*self._velocity) / self._size
        return (1.0 + min(1.0, speed / _FAST) + min(1.0, self._speech / _SPEECH) + 0.5 * min(1.0, self._size / largest)
                + (0.5 if self.measurement.presence < SURE_FACE else 0.0))

    def roi(self, stamp: float, camera: Optional[CameraModel] = None) -> FaceRoi:
        """Crop for the mesh in the image of `stamp` (s): round the last mesh, and near the last detection; camera: see
        `roi_from_mesh`."""
        mesh = self.measurement.mesh
        roi = roi_from_mesh(mesh, self.shift(stamp), camera)
        if self._anchor is None or stamp - self.detected_at > _FRESH:
            return roi
        return self._anchor.hold(roi, eye_share(mesh))

    def shift(self, stamp: float) -> np.ndarray:
        """Motion (2,) px expected between the last measurement and `stamp`."""
        return self._moved + self._velocity * max(0.0, stamp - self._moved_at)

    def move(self, motion: Optional[np.ndarray], stamp: float) -> None:
        """Add the optical flow of this face, (2,) px, from the last image to the one of `stamp` (s).

        None when it is not known: then the face moves on with its velocity.
        """
        step = stamp - self._moved_at
        if step <= 0.0:
            return
        self._followed = motion is not None and (self._followed or self._moved_at == self._stamp)
        if motion is None:
            motion = self._velocity * step
        else:
            self._update_velocity(motion, step)
        self._moved, self._moved_at, self._predicted = self._moved + motion, stamp, None

    def _update_velocity(self, motion: np.ndarray, step: float) -> None:
        """Filter the velocity: motion (2,) px in `step` s."""
        weight = 1.0 - math.exp(-step / VELOCITY_TIME)
        self._velocity = self._velocity + weight * (motion / step - self._velocity)

    def centre(self, stamp: float) -> np.ndarray:
        """Centre (2,) px expected at `stamp`."""
        return self._centre + self.shift(stamp)

    def predicted_box(self, stamp: float) -> np.ndarray:
        """Box (4,) px expected at `stamp`."""
        if self._predicted is None or self._predicted[0] != stamp:
            dx, dy = self.shift(stamp).tolist()
            self._predicted = stamp, self.measurement.box + (dx, dy, dx, dy)
        return self._predicted[1]

    def is_unusual(self, measurement: FaceMeasurement, stamp: float) -> bool:
        """Whether a measurement looks unlike this face, is not where it is expected, or the face was not seen in the
        last image."""
        if self.memory is None or measurement.look is None:
            return False
        if not self.visible or self.doubtful_since is not None or self.memory.has_changed(measurement.look, stamp):
            return True
        centre, size = measurement.place
        away = math.hypot(*(centre - self._centre - self.shift(stamp)).tolist()) / self._size
        return (away + SIZE_WEIGHT * abs(math.log(size / self._size)) > JUMP
                or _appearance_distance(self.colours, measurement.colours) >= 1.0)

    def has_colours_of(self, measurement: FaceMeasurement) -> bool:
        """Whether the colours of a measurement are known, and are those of this face."""
        if self.colours is None or measurement.colours is None:
            return False
        return _appearance_distance(self.colours, measurement.colours) < _TURNED_COLOURS

    def continue_with(self, measurement: FaceMeasurement, stamp: float) -> None:
        """Update the track with a measurement of this face."""
        centre, size = measurement.place
        if stamp > self._stamp and not (self._followed and self._moved_at >= stamp):
            self._update_velocity(centre - self._centre, stamp - self._stamp)
        weight = 1.0 - math.exp(-max(0.0, stamp - self._stamp) / _SPEECH_TIME)
        self._speech += weight * (abs(measurement.openness - self._openness) - self._speech)
        self._openness = measurement.openness
        self._centre, self._size, self._stamp = centre, size, max(stamp, self._stamp)
        self._moved, self._moved_at, self._followed, self._predicted = np.zeros(2), self._stamp, False, None
        self._update_colours(measurement.colours)
        if measurement.crops is not None:
            self._anchor = CropAnchor(*measurement.crops)
        self.measurement = measurement
        self.score = max(self.score, measurement.score)
        self.visible, self.replaced = True, False
        self.life.seen(stamp)

    def _update_colours(self, colours: Optional[np.ndarray]) -> None:
        if colours is None or self.colours is None:
            self.colours = colours if self.colours is None else self.colours
        else:
            self.colours = _COLOUR_MEMORY * self.colours + (1.0 - _COLOUR_MEMORY) * colours

    def add_detection(self, stamp: float, weight: float = 1.0, score: float = 0.0,
                      crop: Optional[FaceRoi] = None) -> None:
        """Count a detection of this face.

        weight: what it adds to the hit count, 0 to 1; score: its own, 0 to 1; crop: what it asks for, None if unknown.
        """
        if self._anchor is not None and crop is not None:
            self._anchor.see(crop)
        self.hit_count += weight
        self.score = max(score, _SCORE_MEMORY * self.score)
        self.detected_at, self.unsupported = stamp, 0.0

    def add_conflict(self) -> None:
        """Note that the detector sees a face of another size here."""
        self.score *= _SCORE_MEMORY

    def add_verification(self, score: float) -> None:
        """Add a verification score, -1 (no face) to 1 (a face)."""
        self.verification = min(MOST_VERIFICATION, max(LEAST_VERIFICATION, self.verification + score))

    def turn(self, rotation: ImageRotation) -> None:
        """Turn with the images: the face is where it was in what they show."""
        self.measurement = replace(self.measurement, mesh=rotation.pixels(self.measurement.mesh), crops=None)
        directions = rotation.matrix[:2, :2]
        self._velocity, self._moved = directions @ self._velocity, directions @ self._moved
        self._centre, self._predicted = rotation.pixels(self._centre[None])[0], None
        if self._anchor is not None:
            self._anchor.turn(rotation)

    def jump(self, jump: Jump) -> None:
        """Go with a picture that has jumped: the face is where it was in what the picture shows."""
        self.measurement = replace(self.measurement, mesh=jump.pixels(self.measurement.mesh), crops=None)
        self._velocity, self._moved = np.zeros(2), jump.scale * self._moved
        self._centre, self._predicted = jump.pixels(self._centre[None])[0], None
        self._size *= jump.scale
        if self._anchor is not None:
            self._anchor.jump(jump)

    def miss(self) -> None:
        """Note that the face was not found in this frame."""
        self.visible = False


def appearance_distances(known: Sequence[Optional[np.ndarray]], seen: Sequence[Optional[np.ndarray]]) -> np.ndarray:
    """Appearance distances (T, N) between colours (5, 4, 3) or None: 0 for those of one face in two images, and where
    they are not known; 1 for those of two people."""
    blank = np.zeros(_COLOUR_GRID[::-1] + (3,))
    before, now = (np.stack([blank if one is None else one for one in some]).reshape(len(some), -1)
                   for some in (known, seen))
    difference = np.abs(before[:, None] - now).mean(axis=2)
    compared = np.outer([one is not None for one in known], [one is not None for one in seen])
    distance = (difference - _SAME_COLOURS) / (_OTHER_COLOURS - _SAME_COLOURS)
    return np.where(compared, np.minimum(np.maximum(distance, 0.0), 1.0), 0.0)


def _appearance_distance(known: Optional[np.ndarray], seen: Optional[np.ndarray]) -> float:
    """The appearance distance of one pair."""
    if known is None or seen is None:
        return 0.0
    difference = float(np.abs(known - seen).sum()) / known.size
    return min(max((difference - _SAME_COLOURS) / (_OTHER_COLOURS - _SAME_COLOURS), 0.0), 1.0)


def face_colours(bgr: np.ndarray, box: np.ndarray) -> Optional[np.ndarray]:
    """Return the colours of a face, (5, 4, 3) 0 to 1, coarse; None when the box (4,) px lies outside the image."""
    height, width = bgr.shape[:2]
    x0, y0, x1, y1 = (int(min(max(value, 0.0), limit)) for value, limit in zip(
        box.tolist(), (width, height, width, height)))
    if x1 - x0 < 2 or y1 - y0 < 2:
        return None
    # Every fourth pixel of a large face is enough.
    step = max(1, min(x1 - x0, y1 - y0) // 24)
    patch = np.ascontiguousarray(bgr[y0:y1:step, x0:x1:step])
    return cv2.resize(patch, _COLOUR_GRID, interpolation=cv2.INTER_AREA).astype(np.float64) / 255.0


def _place(box: np.ndarray) -> Tuple[np.ndarray, float]:
    """Centre (2,) px and size (mean side, px, at least 1) of a box."""
    x0, y0, x1, y1 = box.tolist()
    return np.array([(x0 + x1) / 2.0, (y0 + y1) / 2.0]), max(1.0, (x1 - x0 + y1 - y0) / 2.0)
