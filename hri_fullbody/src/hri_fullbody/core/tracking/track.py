"""One tracked body: its state, its motion (constant velocity, in the image and in metres), and its next window."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import List, Optional, Set, Tuple, Union

import numpy as np

from hri_fullbody.core.detection.pose_estimator import PoseDetection, PoseEstimate
from hri_fullbody.core.detection.windows import FACE_WINDOW_SIZES, FaceBox, Window, window_from_face
from hri_fullbody.core.keypoints import BLAZE_EARS, BLAZE_NOSE
from hri_fullbody.core.tracking.reidentification import blend
from hri_pipeline.core.image_rotation import ImageRotation
from hri_pipeline.core.picture_jumps import Jump
from hri_pipeline.core.tracks import TrackLife

# Standard deviations of the model, measured in body sizes (px) where the image is meant.
_IMAGE_ACCELERATION = 1.5      # 1/s2
_IMAGE_SPEED = 0.8             # 1/s, of a body seen for the first time
_IMAGE_NOISE = 0.02
_SPACE_ACCELERATION = 2.0      # m/s2: a person who starts to walk
_SPACE_SPEED = 1.0             # m/s
_SPACE_NOISE = 0.03            # m, across the view
_DEPTH_NOISE = 0.06            # of the depth: statures and the network's error,
_DEPTH_NOISE_PX = 4.0          # and that of so many pixels of the body's size
_LARGEST_GAP = 2.0             # s: after a longer one the velocity says nothing any more
_VELOCITY_LASTS = 1.5          # s: time constant with which a walk is forgotten; people turn and stop

_Variances = Tuple[float, float, float]


class ConstantVelocity:
    """Kalman filter of points that move with a velocity that changes by random accelerations, each axis alone.

    Without measurements the velocity fades with a time constant of 1.5 s, as in R. A. Singer's model of 1970.

    value: (D,). sd: (D,) or a number, its standard deviation. speed_sd: that of the unknown velocity at the start.
    R. E. Kalman, "A New Approach to Linear Filtering and Prediction Problems", 1960. The arithmetic is that of plain
    floats: for two or three axes it takes a fraction of the time that numpy takes.
    """

    def __init__(self, value: np.ndarray, sd: Union[float, np.ndarray], speed_sd: float, stamp: float) -> None:
        self.value = np.array(value, dtype=np.float64)
        self.velocity = np.zeros_like(self.value)
        self.stamp = float(stamp)
        # Of each axis: variance of the value, covariance with the velocity, variance of the velocity.
        self._variances: List[_Variances] = [(one * one, 0.0, speed_sd ** 2) for one in self._of_axes(sd)]

    def expected(self, stamp: float) -> np.ndarray:
        """Return the value (D,) at `stamp` (s); nothing changes."""
        return self.value + self.velocity * _travelled(min(max(0.0, stamp - self.stamp), _LARGEST_GAP))

    def predict(self, stamp: float, acceleration: float) -> Tuple[np.ndarray, np.ndarray]:
        """Return value (D,) and standard deviation (D,) at `stamp` (s); nothing changes.

        acceleration: standard deviation of the random acceleration, unit/s2.
        """
        step = min(max(0.0, stamp - self.stamp), _LARGEST_GAP)
        return self.expected(stamp), np.array([math.sqrt(pp) for pp, _, _ in self._grown(step, acceleration)])

    def update(self, value: np.ndarray, sd: Union[float, np.ndarray], stamp: float, acceleration: float) -> None:
        """Take a measurement of `stamp` (s); one that is not newer than the last changes nothing."""
        step = min(stamp - self.stamp, _LARGEST_GAP)
        if step <= 0.0:
            return
        grown = self._grown(step, acceleration)
        gains = [(pp / (pp + one * one), pv / (pp + one * one)) for (pp, pv, _), one in zip(grown, self._of_axes(sd))]
        self._variances = [((1.0 - gain_p) * pp, (1.0 - gain_p) * pv, vv - gain_v * pv)
                           for (pp, pv, vv), (gain_p, gain_v) in zip(grown, gains)]
        gain = np.array(gains)
        predicted = self.expected(stamp)
        error = np.asarray(value, dtype=np.float64) - predicted
        self.value = predicted + gain[:, 0] * error
        self.velocity = self.velocity + gain[:, 1] * error
        self.stamp = float(stamp)

    def scale(self, factor: float) -> None:
        """Measure everything in a unit that is `factor` times smaller."""
        self.value, self.velocity = factor * self.value, factor * self.velocity
        self._variances = [(factor ** 2 * pp, factor ** 2 * pv, factor ** 2 * vv) for pp, pv, vv in self._variances]

    def _grown(self, step: float, acceleration: float) -> List[_Variances]:
        """What `_variances` are after `step` s."""
        noise = acceleration ** 2
        more = noise * step ** 4 / 4.0, noise * step ** 3 / 2.0, noise * step ** 2
        return [(pp + 2.0 * step * pv + step ** 2 * vv + more[0], pv + step * vv + more[1], vv + more[2])
                for pp, pv, vv in self._variances]

    def _of_axes(self, sd: Union[float, np.ndarray]) -> List[float]:
        return sd.tolist() if isinstance(sd, np.ndarray) else [float(sd)] * len(self.value)


def _travelled(step: float) -> float:
    """Time (s) at full velocity that goes as far as `step` s at a fading one."""
    return _VELOCITY_LASTS * (1.0 - math.exp(-step / _VELOCITY_LASTS))


class BodyMotion:
    """Where one body is and will be: the middle of its trunk (px) and its root (m, optical frame) where it is known."""

    def __init__(self, centre: np.ndarray, size: float, root: Optional[np.ndarray], stamp: float) -> None:
        """centre: (2,) px. size: px, that of the body in the image. root: (3,) m or None. stamp: s."""
        self.size = float(size)
        self._image = ConstantVelocity(centre, _IMAGE_NOISE * size, _IMAGE_SPEED * size, stamp)
        self._space: Optional[ConstantVelocity] = None
        self._locate(root, stamp)

    def update(self, centre: np.ndarray, size: float, root: Optional[np.ndarray], stamp: float,
               noise: float = 1.0) -> None:
        """Take over a detection of the body at `stamp` (s). noise: factor of its standard deviation."""
        self.size = float(size)
        self._image.update(centre, noise * _IMAGE_NOISE * size, stamp, _IMAGE_ACCELERATION * size)
        self._locate(root, stamp)

    def carry(self, way: np.ndarray) -> None:
        """Move by (2,) px with all that the image shows: the camera has turned."""
        self._image.value = self._image.value + way

    def turn(self, rotation: ImageRotation) -> None:
        """Turn with the images; the axes across the view are alike uncertain."""
        self._image.value = rotation.pixels(self._image.value[None])[0]
        self._image.velocity = rotation.matrix[:2, :2] @ self._image.velocity
        if self._space is not None:
            self._space.value = rotation.vectors(self._space.value)
            self._space.velocity = rotation.vectors(self._space.velocity)

    def jump(self, jump: Jump) -> None:
        """Go with a picture that has jumped. How far away the body is begins anew: whether the camera's calibration
        tells of its zoom is not known."""
        self.size *= jump.scale
        self._image.scale(jump.scale)
        self._image.value = self._image.value + jump.shift
        self.forget_distance()

    def forget_distance(self) -> None:
        """Let the place in metres begin anew."""
        self._space = None

    def predicted_centre(self, stamp: float) -> np.ndarray:
        """Middle of the trunk (2,) px at `stamp`."""
        return self._image.expected(stamp)

    @property
    def velocity(self) -> Optional[np.ndarray]:
        """Velocity (3,) m/s in the optical frame, None when the root was never known."""
        return None if self._space is None else self._space.velocity.copy()

    def speed(self) -> float:
        """Speed in the image, body sizes per second."""
        return math.hypot(*self._image.velocity.tolist()) / max(self.size, 1.0)

    def image_distance(self, centre: np.ndarray, stamp: float, noise: float) -> float:
        """How far `centre` (2,) px is from the prediction, in standard deviations.

        noise: standard deviation of the measurement in body sizes.
        """
        value, sd = self._image.predict(stamp, _IMAGE_ACCELERATION * self.size)
        own = noise * self.size
        return math.hypot(*((here - there) / math.hypot(one, own)
                            for here, there, one in zip(centre.tolist(), value.tolist(), sd.tolist())))

    def depth_distance(self, root: Optional[np.ndarray], stamp: float) -> float:
        """How far the depth of `root` (3,) m is from the prediction, in standard deviations; 0 when one is not
        known."""
        if root is None or self._space is None:
            return 0.0
        value, sd = self._space.predict(stamp, _SPACE_ACCELERATION)
        return float(abs(root[2] - value[2]) / math.hypot(sd[2], 2.0 * self._depth_noise(float(value[2]))))

    def _depth_noise(self, depth: float) -> float:
        """Standard deviation (m) of one measurement of a depth (m)."""
        return math.hypot(_DEPTH_NOISE, _DEPTH_NOISE_PX / max(self.size, 1.0)) * max(abs(depth), 0.5)

    def _locate(self, root: Optional[np.ndarray], stamp: float) -> None:
        if root is None:
            return
        sd = np.array([_SPACE_NOISE, _SPACE_NOISE, self._depth_noise(float(root[2]))])
        if self._space is None or stamp - self._space.stamp > _LARGEST_GAP:
            self._space = ConstantVelocity(root, sd, _SPACE_SPEED, stamp)
        else:
            self._space.update(root, sd, stamp, _SPACE_ACCELERATION)


_FACE_HOLD = 0.5
_SAME_FACE = 0.5            # face sizes between where a face was and where it is under a new id
_ANCHOR_HOLD = 2.0
_FADE_S = 0.4
_OCCLUDED_NOISE = 4.0     # times as much, while somebody else is in the same place
_APPEARANCE_LEARN_S = 1.5
_LEAST_MISSES = 2
# How many times as long a body is waited for that vanished inside the image: somebody or something stands before it.
_HIDDEN_PATIENCE = 3.0
_SHORT_GAP_S = 0.3          # after a longer one a single detection may be somebody else
_SURE_S = 1.0               # of which it was seen before
_RIVAL_S = 0.5              # for which a body that began where another one is hidden must be seen to be told
# Faces come within this time after the body. Until then bodies above 0.83 of the image's height, which cuts them
# somewhere, were 0.25 m off in 81 of 151 places, smaller ones in 1 of 18. Whoever is below the second is there at once.
_FACE_COMES_S, _NEAR = 0.6, 0.6
_FACING = 0.4               # cosine between the head's forward direction and the way to the camera
_EDGE = 0.15                # body sizes from the side of the image, within which it may have left
# A body slower than this (sizes per second) stays where it was: what seems to move a little is the network's noise, and
# a window that follows it would drift away.
_STILL = 0.25
_FAST = 1.0                 # body sizes per second from which a body counts as fast
_NEWBORN_WEIGHT, _HIDDEN_WEIGHT = 3.0, 0.4
_UNCERTAIN = 0.9            # score below which a body is uncertain


class BodyTrack:
    """One body over time. All stamps are seconds of the images' clock.

    visible: its last inference found it. inferred_at: stamp of that. misses: inferences in a row that did not find it.
    left: it moved when it was missed at a side of the image. hidden: it was missed, and not at a side. cut: the picture
    has changed since it was seen. darkened: it stood there when the images began to show nothing. returning: it was
    seen once after a gap. kept: it was missed once, in images that come so slowly that this says little.
    mistaken: it was last seen in the clothes of a hidden neighbour, on whom it may lie. met: ids of the bodies that
    overlapped with this one since it is hidden.
    box_confirmed: None until the person detector was asked for the body, then whether it has ever seen a person there.
    rival: id of the body that was hidden where this one began: once that is seen there again, they are one human.
    wait: time (s) between two turns lately. appearance: see `appearance.describe`, learnt while unoccluded.
    carried: whether the camera turned between the last two times that it was seen.
    """

    def __init__(self, body_id: str, detection: PoseDetection, stamp: float, life: TrackLife,
                 face: Optional[FaceBox] = None, anchor: Optional[float] = None,
                 box_confirmed: Optional[bool] = None) -> None:
        """anchor: side (in face sizes) of the face's window that found the body; None when its own landmarks did."""
        self.id = body_id
        self.life = life
        self.detection = detection
        self.stamp = stamp
        self.visible = True
        self.hidden = self.left = False
        self.cut = self.darkened = False
        self.returning = self.kept = self.mistaken = False
        self.met: Set[str] = set()
        self.inferred_at = stamp
        self.misses = 0
        self.rival: Optional[str] = None
        self.wait = 0.0
        self.box_confirmed_at = self.born_at = self._seen_since = stamp
        self.box_confirmed = box_confirmed
        self.appearance: Optional[np.ndarray] = detection.appearance
        self.described_at = stamp
        self.motion = BodyMotion(detection.estimate.centre, detection.estimate.extent, detection.root, stamp)
        self.face_id: Optional[str] = None
        self._expected: Optional[Tuple[float, PoseEstimate]] = None
        self._face_stamp = stamp
        self._face_centre: Optional[np.ndarray] = None
        self._face_when_seen: Optional[np.ndarray] = None
        self._carried, self.carried = np.zeros(2), False
        self._anchor_side = FACE_WINDOW_SIZES[0] if anchor is None else anchor
        self._anchored_until = -np.inf if anchor is None else stamp + _ANCHOR_HOLD
        if face is not None:
            self.link(face, stamp)
            self._face_when_seen = self._face_centre

    @property
    def confirmed(self) -> bool:
        """Whether the body has been seen for long enough, and not only by the pose network; if it began where another
        one is hidden, for half a second, in which that one may come back."""
        doubtful = self.rival is not None and self.stamp - self.life.first_seen < _RIVAL_S - 1e-9
        return self.life.confirmed and self.box_confirmed is not False and not doubtful

    @property
    def estimate(self) -> PoseEstimate:
        """The body as it was last seen."""
        return self.detection.estimate

    def face_comes(self, height: float) -> bool:
        """Tell whether the body has just begun, is near, and turns its head to the camera: its face will tell how far
        away it is. height: of the image, px."""
        if self.stamp - self.born_at >= _FACE_COMES_S or self.estimate.extent < _NEAR * height:
            return False
        head = self.estimate.world
        left, right = BLAZE_EARS
        forward = (head[BLAZE_NOSE] - 0.5 * (head[left] + head[right])).tolist()
        return -forward[2] > _FACING * math.hypot(*forward)

    def link(self, face: FaceBox, stamp: float) -> None:
        """Note that `face` is this body's own."""
        if face.id != self.face_id:
            self._face_when_seen = None
        self.face_id = face.id
        self._face_stamp, self._face_centre = stamp, face.centre

    def had_face_at(self, face: FaceBox, stamp: float) -> bool:
        """Tell whether this body's own face was last seen where `face` is, so lately that it is still held; whose face
        is there after a dark is not known."""
        return (self.face_id is not None and self._face_centre is not None and not self.darkened
                and stamp - self._face_stamp <= _FACE_HOLD and face.distance(self._face_centre) <= _SAME_FACE)

    def forget_lost_face(self, stamp: float) -> None:
        """Let go of a face that has not been reported for half a second."""
        if self.face_id is not None and stamp - self._face_stamp > _FACE_HOLD:
            self.face_id = None

    def window(self, face: Optional[FaceBox], stamp: float) -> Window:
        """Window of the inference at `stamp`: where the landmarks will be, or below the face while it is the anchor."""
        if face is not None and stamp < self._anchored_until:
            return window_from_face(face, self._anchor_side)
        window = self.estimate.next_window()
        # A hidden body is looked for where its motion takes it, and where it vanished, by turns.
        x, y = np.asarray(window.centre) + (self.moved(stamp) if self.misses % 2 == 0 else self._carried)
        return Window((float(x), float(y)), window.size, window.angle)

    def next_anchor(self, attempt: int) -> float:
        """Side, in face sizes, of the face's window to try in attempt 0, 1, ...: first the one that last worked."""
        start = FACE_WINDOW_SIZES.index(self._anchor_side) if self._anchor_side in FACE_WINDOW_SIZES else 0
        return FACE_WINDOW_SIZES[(start + attempt) % len(FACE_WINDOW_SIZES)]

    def hold_anchor(self, side: float, stamp: float) -> None:
        """Use the window below the face, of `side` face sizes, for the next two seconds."""
        self._anchor_side = side
        self._anchored_until = stamp + _ANCHOR_HOLD

    def weakness(self, now: bool, stamp: float) -> Tuple[bool, bool, float]:
        """What decides, in this order, which of two bodies on one human waits: it came, or came back after a gap, less
        than a second ago; it was not seen at `stamp` (s); it came later. now: it is, or seems to be, seen at `stamp`.
        """
        since = stamp if now and self.has_gap(stamp) else self._seen_since
        return stamp - since < _SURE_S, not now, since

    def has_gap(self, stamp: float) -> bool:
        """Tell whether a sight at `stamp` (s) would be the first one after a gap."""
        return not self.visible and not self.kept and stamp - self.stamp > _SHORT_GAP_S

    @property
    def place(self) -> np.ndarray:
        """Where the middle of its trunk (2,) px is in the last image if it has stayed where it was last seen."""
        return self.estimate.centre + self._carried

    def carry(self, way: np.ndarray) -> None:
        """Move by (2,) px with all that the image shows: the camera has turned since the image before."""
        self._carried = self._carried + way
        self._expected = None
        self.motion.carry(way)
        if self._face_centre is not None:
            self._face_centre = self._face_centre + way

    def moved(self, stamp: float) -> np.ndarray:
        """Way (2,) px in the image since the body was last seen, as its motion and the camera's tell."""
        if self.motion.speed() < _STILL:
            return self._carried.copy()
        return self.motion.predicted_centre(stamp) - self.detection.estimate.centre

    def moved_with_face(self, stamp: float) -> np.ndarray:
        """The same by the body's own face, where that is seen at `stamp`: for what is shown, not for the search."""
        if self._face_stamp == stamp and self._face_centre is not None and self._face_when_seen is not None:
            return self._face_centre - self._face_when_seen
        return self.moved(stamp)

    def expected(self, stamp: float) -> PoseEstimate:
        """The body at `stamp` where its motion takes it; the longer it was not seen the lower the confidence."""
        age = max(0.0, stamp - self.stamp)
        if age == 0.0:
            return self.estimate
        if self._expected is None or self._expected[0] != stamp:
            self._expected = (stamp, self._moved_on(age, stamp))
        return self._expected[1]

    def _moved_on(self, age: float, stamp: float) -> PoseEstimate:
        landmarks = self.estimate.landmarks.copy()
        landmarks[:, :2] += self.moved(stamp)
        fade = math.exp(-age / max(_FADE_S, self.wait))
        return replace(self.estimate, score=self.estimate.score * fade, landmarks=landmarks,
                       confidence=self.estimate.confidence * fade)

    def update(self, detection: PoseDetection, stamp: float, unhidden: bool) -> None:
        """Take over a detection of this body.

        unhidden: nobody stands before it, so that its appearance may be learnt.
        """
        step = max(0.0, stamp - self.stamp)
        self.returning = self.has_gap(stamp)
        self._seen_since = stamp if self.returning else self._seen_since
        self.detection, self.stamp, self._expected = detection, stamp, None
        self.carried, self._carried = bool(self._carried.any()), np.zeros(2)
        self._face_when_seen = self._face_centre if self._face_stamp == stamp else None
        self.described_at = self.described_at if detection.appearance is None else stamp
        if self.cut:
            self.box_confirmed, self.born_at = None, stamp
        self.visible, self.inferred_at, self.misses = True, stamp, 0
        self.hidden = self.cut = self.darkened = False
        self.kept = self.mistaken = False
        self.met.clear()
        self.motion.update(detection.estimate.centre, detection.estimate.extent, detection.root, stamp,
                           1.0 if unhidden else _OCCLUDED_NOISE)
        if unhidden:
            self.appearance = blend(self.appearance, detection.appearance,
                                    1.0 - math.exp(-step / _APPEARANCE_LEARN_S))
        self.life.seen(stamp)

    def dead(self, stamp: float) -> bool:
        """Tell whether the body was missed twice, and is unseen for longer than the death time.

        Without an inference a body is not gone: with many people, or few images, turns are rarer than that; the id
        stays. One that is hidden is waited for three times as long.
        """
        age = stamp - self.life.last_seen
        return self.misses >= _LEAST_MISSES and self.life.dead(
            self.life.last_seen + (age / _HIDDEN_PATIENCE if self.hidden else age))

    def waits(self, stamp: float) -> bool:
        """Tell whether the body is not seen, and expected where it was hidden."""
        return self.hidden and not self.visible and not self.dead(stamp)

    def urgency(self, largest: float) -> float:
        """Weight of the body's inferences: 1 at rest, more for one that is new, moves, is near or uncertain; less for a
        hidden one. largest: size of the largest body in the image, px."""
        if not self.life.confirmed:
            return _NEWBORN_WEIGHT
        if not self.visible:
            return _HIDDEN_WEIGHT
        return (1.0 + min(self.motion.speed() / _FAST, 1.0) + 0.5 * min(1.0, self.motion.size / largest)
                + (0.5 if self.estimate.score < _UNCERTAIN else 0.0))

    def judge_hidden(self, stamp: float, width: float, blank: bool = False) -> None:
        """Note whether a body that was missed has left at a side of an image of `width` px, where who stands half in is
        missed, too, but does not move; elsewhere, and where the image is blank, if it was well known, it is hidden."""
        reach = _EDGE * self.motion.size
        x = float(self.estimate.centre[0] + self.moved(stamp)[0])
        left, right = (self.estimate.box[[0, 2]] + self._carried[0]).tolist()
        # A stamp is a multiple of a nanosecond: allow that much, or 1.4 - 0.4 is not 1.
        long_seen = self.life.last_seen - self.born_at >= _SURE_S - 1e-9
        known = long_seen and bool(self.box_confirmed or self.face_id is not None)
        is_aside = not blank and not (left > reach and right < width - reach and reach < x < width - reach)
        self.left = is_aside and self.motion.speed() >= _STILL
        self.hidden = known and not self.cut and not is_aside

    def turn(self, rotation: ImageRotation) -> None:
        """Turn with the images: the body is where it was in what they show."""
        points = self.detection.points
        self.detection = replace(
            self.detection, estimate=self.estimate.turned(rotation),
            points=None if points is None else rotation.vectors(points))
        self.motion.turn(rotation)
        self._carried = rotation.matrix[:2, :2] @ self._carried
        self._expected = None
        self._face_centre, self._face_when_seen = (
            None if centre is None else rotation.pixels(centre[None])[0]
            for centre in (self._face_centre, self._face_when_seen))

    def jump(self, jump: Jump) -> None:
        """Go with a picture that has jumped: the body is where it was in what the picture shows."""
        self.detection = replace(self.detection, estimate=self.estimate.jumped(jump))
        self.motion.jump(jump)
        self._carried, self._expected = jump.scale * self._carried, None
        self._face_centre, self._face_when_seen = (
            None if centre is None else jump.pixels(centre[None])[0]
            for centre in (self._face_centre, self._face_when_seen))

    def cut_off(self, stamp: float) -> None:
        """Note that the image shows something else than the one before: the body is neither there nor hidden, until
        somebody with its clothes is; its face was that of the picture before."""
        if self.darkened:       # who was waited for in the dark is not waited for in another picture
            self.life.last_seen = self.stamp
        self.cut, self.darkened = True, False
        self.face_id = None
        self.missed(stamp)

    def darken(self, stamp: float) -> None:
        """Note that images have shown nothing for long: who stood is waited for where he was, while that is so, and
        with his face; of the others it is not known where they are."""
        face, stood = self.face_id, self.darkened or (self.visible and self.motion.speed() < _STILL)
        self.cut_off(stamp)
        if stood:
            self.darkened, self.face_id, self._face_stamp = True, face, stamp
            self.life.last_seen = stamp

    def missed(self, stamp: float) -> None:
        """Note that an inference did not find the body."""
        self.visible, self.kept, self.inferred_at = False, False, stamp
        self.misses += 1
