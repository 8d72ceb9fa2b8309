"""Which face belongs to which body: by eyes, nose and ears of both in the image, and by where both heads are."""

from __future__ import annotations

import math
from bisect import bisect_left
from dataclasses import dataclass
from functools import partial
from typing import Dict, Iterable, List, NamedTuple, Optional, Sequence, Set, Tuple

import numpy as np

from hri_pipeline.core.frames import HumanTf, Timed, read
from hri_pipeline.core.geometry import Vector, rotate
from hri_pipeline.core.matching.parameters import FaceBodyMatcherSettings
from hri_pipeline.core.observations import Feature, FeatureHistory
from hri_pipeline.core.timing import JUMP_BACK_S
from hri_pipeline.core.tracks import assign

_HISTORY_S = 12.0       # bodies of an image have come 3 to 5 s after its faces, on two busy cores with ten people
_GAP_S = 0.7            # between two images of a face that tell where it was meanwhile
_LONGEST_LAG_S = 10.0
_AWAIT_S = 0.3          # longer than they lag, a body waits for the faces of its image where they come later
_UNSEEN_S = 0.5         # after its last image a body was not seen where another one was,
_UNSEEN_MALUS = 0.3     # which may be so much less likely
MOST_ASPECT = 10.0
"""No image is so many times wider than high, or higher than wide: its size is not known."""
MAX_APART_S = 0.15
"""Most time between the stamps of the links from a head to its camera."""
_NOWHERE = np.full(3, np.nan)
_FRAMES = {"faces": "face", "bodies": "head"}
_BARE_S = 2.0           # without points since the first place: the package sends none, and places alone are compared

Pair = Tuple[str, str]


class PairMatch(NamedTuple):
    """Likelihood (0..1, 0 withdraws) that a face and a body belong to the same human."""

    face: str
    body: str
    confidence: float


class HeadPlace(NamedTuple):
    """Position (m) of a face or of a skeleton's head in the frame of its camera, at `stamp` (s)."""

    frame: str
    position: Vector
    stamp: float


@dataclass
class _PairState:
    likelihood: float
    stamp: float


class _Compared(NamedTuple):
    """The newest skeleton of a body that was compared, and with whom; faces may come after it."""

    stamp: float
    faces: Set[str]


class FaceBodyMatcher:
    """Follows the likelihood of every pair over time and gives the one-to-one matches to publish.

    A pair's likelihood is a first-order low-pass filter over time, not over frames. The present partner has
    a small bonus in the assignment, so that two nearly equal bodies do not take turns.
    """

    def __init__(self, settings: FaceBodyMatcherSettings) -> None:
        self._settings = settings
        self._tracked: Dict[str, Set[str]] = {"faces": set(), "bodies": set()}
        self._frames: Dict[Tuple[str, str], str] = {}
        self._aspects: Dict[str, float] = {}        # of each face's images: one wrong message does not spoil the others
        self._history = FeatureHistory(_HISTORY_S)
        self._states: Dict[Pair, _PairState] = {}
        self._matched: Dict[Pair, float] = {}
        self._newest: Dict[Tuple[str, str], float] = {}     # by kind and frame: each camera and node has its own delay
        self._lags: Dict[Tuple[str, str], float] = {}       # behind the other kind, when the newest one came
        self._compared: Dict[str, _Compared] = {}
        self._bare: Set[Tuple[str, str]] = set()            # kind and name of those of whom there are places only
        self._tf = HumanTf()

    def reconfigure(self, settings: FaceBodyMatcherSettings) -> None:
        """Take up the values of the live parameters."""
        self._settings = settings

    def set_tracked(self, kind: str, ids: Iterable[str]) -> None:
        """Take the ids of "faces" or "bodies" that are tracked; what is known of the others is dropped."""
        self._tracked[kind] = set(ids)
        self._tf.follow(**{_FRAMES[kind]: self._tracked[kind]})
        self._history.keep_only(kind, self._tracked[kind])
        self._history.keep_only("places of " + kind, self._tracked[kind])
        self._frames = {key: frame for key,
                        frame in self._frames.items() if key[0] != kind or key[1] in self._tracked[kind]}
        self._bare = {key for key in self._bare if key in self._frames}
        cameras = {(key[0], frame) for key, frame in self._frames.items()}
        self._newest = {camera: stamp for camera, stamp in self._newest.items() if camera in cameras}
        self._lags = {camera: lag for camera, lag in self._lags.items() if camera in cameras}
        side = 0 if kind == "faces" else 1
        for pair in [pair for pair in self._states if pair[side] not in self._tracked[kind]]:
            del self._states[pair]
        if kind == "faces":
            self._aspects = {face: aspect for face, aspect in self._aspects.items() if face in self._tracked[kind]}
        else:
            self._compared = {body: done for body, done in self._compared.items() if body in self._tracked[kind]}

    def has_left(self, pair: Pair) -> bool:
        """Tell whether the face or the body of a pair is no longer tracked."""
        face, body = pair
        return face not in self._tracked["faces"] or body not in self._tracked["bodies"]

    @property
    def awaits_faces(self) -> bool:
        """Tell whether a body waits for faces: its newest skeleton was not compared with all that are tracked."""
        faces = self._tracked["faces"]
        return any(self._awaits(body, faces) for body in self._tracked["bodies"])

    def add_face(self, face: str, stamp: float, landmarks: np.ndarray, aspect: float, frame: str = "") -> None:
        """Take the landmarks (70, 3) of a face in the image of time `stamp` (s).

        aspect: width over height of the image, 0 where it is not known. frame: the camera's, empty when not known.
        """
        if 1.0 / MOST_ASPECT <= aspect <= MOST_ASPECT and face in self._tracked["faces"]:
            self._aspects[face] = aspect
        self._end_bare("faces", face)
        # Of ten faces two hundred a second come; those near the image of a body are looked at.
        self._add("faces", face, stamp, partial(face_points, landmarks, self._aspects.get(face, 1.0)), frame)

    def add_body(self, body: str, stamp: float, skeleton: np.ndarray, frame: str = "") -> None:
        """Take the skeleton (18, 3) of a body in the image of time `stamp` (s); frame: as in add_face."""
        self._end_bare("bodies", body)
        self._add("bodies", body, stamp, body_points(skeleton), frame)

    def add_transforms(self, data: bytes, frames: Sequence[Tuple[bytes, int]], fixed: bool) -> None:
        """Take the places of faces and heads out of a message of /tf, or /tf_static (`fixed`); see frames.scan.

        They are compared with the images that they belong to. Raises ValueError for a stamp that is none.
        """
        put = self._tf.put_message(data, frames, fixed)
        for child, offset in frames if fixed else ():
            if not self._tf.wants(child.lstrip(b"/")):
                self._tf.keep_fixed(read(data, offset))
        for kind, identity in dict.fromkeys(("faces" if frame.startswith("face_") else "bodies", identity) for frame,
                                            identity in put):
            place = head_place(self._tf.chain("{}_{}".format(_FRAMES[kind], identity)))
            if place is not None:
                self.add_place(kind, identity, place.stamp, place.position, place.frame)

    def add_place(self, kind: str, name: str, stamp: float, position: Sequence[float], frame: str = "") -> None:
        """Take the position (3,) m of one of the "faces", or of the head of one of the "bodies", in its camera's
        frame.

        It stands for the image of those who have no landmarks, or no skeleton, for _BARE_S.
        """
        if name in self._tracked[kind] and self._frames.setdefault((kind, name), frame) in ("", frame):
            self._history.add("places of " + kind, name, stamp, np.array(position))
            if self._is_bare(kind, name, stamp):
                self._add(kind, name, stamp, _NO_POINTS[kind], frame)

    def _is_bare(self, kind: str, name: str, stamp: float) -> bool:
        if (kind, name) not in self._bare and not self._history.stamps_of(kind, name) and (
                stamp - self._history.stamps_of("places of " + kind, name)[0] >= _BARE_S):
            self._bare.add((kind, name))
        return (kind, name) in self._bare

    def _end_bare(self, kind: str, name: str) -> None:
        """Points have come: those between them and the images without any would be nowhere."""
        if (kind, name) in self._bare:
            self._bare.discard((kind, name))
            self._history.keep_only(kind, self._tracked[kind] - {name})

    def matches(self) -> List[PairMatch]:
        """Compare what has come in; return all pairs that match now, best first."""
        for stamp, bodies in sorted(self._bodies_by_stamp().items()):
            self._compare(stamp, bodies)
        self._drop_stale()
        self._assign()
        return [PairMatch(face, body, value) for (face, body), value in
                sorted(self._matched.items(), key=lambda item: -item[1])]

    def _add(self, kind: str, name: str, stamp: float, points: Feature, frame: str) -> None:
        if name not in self._tracked[kind]:
            return
        newest = self._newest.get((kind, frame), -math.inf)
        self._frames[kind, name] = frame
        if stamp < newest - JUMP_BACK_S:
            self._forget(kind, frame)
            newest = stamp
        if stamp > newest:
            other = self._newest.get(("bodies" if kind == "faces" else "faces", frame), stamp)
            self._lags[kind, frame] = min(max(0.0, other - stamp), _LONGEST_LAG_S)
        self._newest[kind, frame] = max(newest, stamp)
        self._history.add(kind, name, stamp, points)

    def _forget(self, kind: str, frame: str) -> None:
        """Forget those of one kind whom one camera sees: its time has jumped back."""
        names = {name for (one, name), of in self._frames.items() if one == kind and of == frame}
        for one in (kind, "places of " + kind):
            self._history.keep_only(one, self._tracked[kind] - names)
        side = 0 if kind == "faces" else 1
        self._states = {pair: state for pair, state in self._states.items() if pair[side] not in names}
        self._compared.clear()

    def _bodies_by_stamp(self) -> Dict[float, List[str]]:
        """Bodies by the stamp of their newest skeleton of which faces of their camera are known.

        Those of its own image may be still to come, and tell more, while the camera turns, than those of the one
        before.
        """
        new = {body: self._not_compared(body) for body in sorted(self._tracked["bodies"])}
        oldest = min((stamps[0] for stamps in new.values() if stamps), default=math.inf) - _GAP_S
        images: Dict[str, Set[float]] = {}
        for face in self._tracked["faces"]:
            stamps = self._history.stamps_of("faces", face)
            images.setdefault(self._frames.get(("faces", face), ""), set()).update(stamps[bisect_left(stamps, oldest):])
        ordered = {camera: sorted(stamps) for camera, stamps in images.items()}
        found: Dict[float, List[str]] = {}
        for body, stamps in new.items():
            camera = self._frames.get(("bodies", body), "")
            newest = self._newest.get(("bodies", camera), -math.inf) - _AWAIT_S
            own = [(others, newest - self._lags.get(("faces", other), 0.0)) for other, others in ordered.items()
                   if others and (not (camera and other) or other == camera)]
            stamp = next((stamp for stamp in reversed(stamps) if any(
                stamp <= max(others[-1], overdue) and self._near(stamp, others) for others, overdue in own)), None)
            if stamp is not None:
                found.setdefault(stamp, []).append(body)
        return found

    def _not_compared(self, body: str) -> Sequence[float]:
        """Stamps of the skeletons of a body from the last one on that was compared, in rising order."""
        stamps = self._history.stamps_of("bodies", body)
        return stamps[bisect_left(stamps, self._compared[body].stamp):] if body in self._compared else stamps

    def _awaits(self, body: str, faces: Set[str]) -> bool:
        done = self._compared.get(body)
        newest = self._history.newest_of("bodies", body)
        return newest > -math.inf and (done is None or newest > done.stamp or not faces <= done.faces)

    def _near(self, stamp: float, others: Sequence[float]) -> bool:
        """Tell whether `others`, in rising order, tell where somebody is at `stamp`."""
        place = bisect_left(others, stamp)
        return (0 < place < len(others) and others[place] - others[place - 1] <= _GAP_S) or any(
            abs(other - stamp) <= self._settings.max_stamp_difference for other in others[max(0, place - 1):place + 1])

    def _compare(self, stamp: float, names: Sequence[str]) -> None:
        """Compare bodies with the faces of their image with which they were not compared yet."""
        settings = self._settings
        seen = self._history.at("faces", stamp, settings.max_stamp_difference, _GAP_S)
        done = {body: self._done(body, stamp) for body in names}
        new = {(face, body) for body in names for face in seen if face not in done[body]
               and self._may_be_one(face, body)}
        if not new:
            return
        faces = {face: seen[face] for face in sorted({face for face, _ in new})}
        skeletons = self._history.at("bodies", stamp, 0.0)
        bodies = {body: skeletons[body] for body in sorted({body for _, body in new})}
        values = combined(
            likelihoods(np.array(list(faces.values())), np.array(list(bodies.values())),
                        settings.distance_scale, settings.min_point_confidence),
            place_likelihoods(self._places("faces", faces, stamp), self._places("bodies", bodies, stamp)))
        for row, face in enumerate(faces):
            for column, body in enumerate(bodies):
                # Without common points only their places can be compared, which come later.
                if (face, body) in new and not math.isnan(values[row, column]):
                    self._follow((face, body), float(values[row, column]), stamp)
                    done[body].add(face)

    def _done(self, body: str, stamp: float) -> Set[str]:
        """Faces with which a body of this image has been compared; to be added to."""
        if body not in self._compared or self._compared[body].stamp != stamp:
            self._compared[body] = _Compared(stamp, set())
        return self._compared[body].faces

    def _places(self, kind: str, names: Iterable[str], stamp: float) -> np.ndarray:
        """Positions (N, 3) m at a time, NaN where they are not known."""
        known = self._history.at("places of " + kind, stamp, self._settings.max_stamp_difference, _GAP_S)
        return np.array([known.get(name, _NOWHERE) for name in names])

    def _may_be_one(self, face: str, body: str) -> bool:
        """Tell whether one camera sees both: two images cannot be compared."""
        frames = {self._frames.get(("faces", face), ""), self._frames.get(("bodies", body), "")} - {""}
        return len(frames) < 2

    def _follow(self, pair: Pair, value: float, stamp: float) -> None:
        state = self._states.get(pair)
        if state is None:
            self._states[pair] = _PairState(value, stamp)
            return
        elapsed = max(0.0, stamp - state.stamp)
        time_constant = self._settings.smoothing_time
        gain = 1.0 - math.exp(-elapsed / time_constant) if time_constant > 0.0 else 1.0
        state.likelihood += gain * (value - state.likelihood)
        state.stamp = stamp

    def _drop_stale(self) -> None:
        """End the pairs of which one side was not seen for long.

        Both may be seen without being compared, such as a body of which no image shows the head: nothing says that they
        are two, and another face that fits the body takes it.
        """
        faces, bodies = ({name for name in {pair[side] for pair in self._states} if self._unseen(kind, name)}
                         for side, kind in enumerate(("faces", "bodies")))
        if faces or bodies:
            self._states = {pair: state for pair, state in self._states.items()
                            if pair[0] not in faces and pair[1] not in bodies}

    def _unseen(self, kind: str, name: str) -> bool:
        """Tell whether a face or body was not seen for long, by images of its own kind, or those are missing for long;
        a kind that lags has so much longer."""
        camera, other = self._frames.get((kind, name), ""), "bodies" if kind == "faces" else "faces"
        newest = self._newest.get((kind, camera), -math.inf)
        unseen = newest - self._history.newest_of(kind, name)
        return max(unseen, self._newest.get((other, camera), newest) - newest) > (
            self._settings.hold_time + self._lags.get((kind, camera), 0.0))

    def _assign(self) -> None:
        likely = {pair: state.likelihood for pair, state in self._states.items()
                  if state.likelihood >= self._settings.min_likelihood}
        faces = sorted({face for face, _ in likely})
        bodies = sorted({body for _, body in likely})
        last = {body: self._history.newest_of("bodies", body) for body in bodies}
        newest = {face: max(last[body] for one, body in likely if one == face) for face in faces}
        cost = np.full((len(faces), len(bodies)), np.inf)
        for (face, body), likelihood in likely.items():
            bonus = self._advantage((face, body), newest[face] - last[body])
            cost[faces.index(face), bodies.index(body)] = 1.0 - likelihood - bonus
        pairs = [(faces[row], bodies[column]) for row, column in assign(cost, 1.0)]
        self._matched = {pair: self._states[pair].likelihood for pair in pairs}

    def _advantage(self, pair: Pair, unseen: float) -> float:
        """Advantage of a pair that is matched; a disadvantage where its body was not seen any more when another likely
        one of this face was, by `unseen` s: a body that begins anew is listed beside its old id for some images."""
        if unseen > _UNSEEN_S:
            return -_UNSEEN_MALUS
        return self._settings.stay_bonus if pair in self._matched else 0.0


def head_place(chain: Sequence[Timed]) -> Optional[HeadPlace]:
    """Return the place that follows from the transforms from a head up to its camera, at the time of the highest one
    that moves: a body moves more, between two images, than its head moves on it.

    None without any that moves, and where their stamps are more than MAX_APART_S apart.
    """
    stamps = [timed.stamp for timed in chain if math.isfinite(timed.stamp)]
    if not stamps or max(stamps) - min(stamps) > MAX_APART_S:
        return None
    position: Vector = (0.0, 0.0, 0.0)
    for timed in chain:
        (x, y, z), (i, j, k) = timed.transform.translation, rotate(timed.transform.rotation, position)
        position = (x + i, y + j, z + k)
    return HeadPlace(chain[-1].transform.parent, position, stamps[-1]) if math.isfinite(sum(position)) else None


# Point of the skeleton (hri_msgs/Skeleton2D), landmarks of which the mean is the same point (dlib's 68
# points), weight. The ears count less: the jaw line ends in front of them.
_SAME_POINTS: Tuple[Tuple[int, Tuple[int, ...], float], ...] = (
    (0, (30,), 1.0),
    (14, (42, 43, 44, 45, 46, 47), 1.0),
    (15, (36, 37, 38, 39, 40, 41), 1.0),
    (16, (16,), 0.3),
    (17, (0,), 0.3),
)
_NO_POINTS = {"faces": np.zeros((len(_SAME_POINTS) + 1, 3)), "bodies": np.zeros((len(_SAME_POINTS), 3))}
_LANDMARKS = np.concatenate([indices for _, indices, _ in _SAME_POINTS])
_COUNTS = np.array([[len(indices)] for _, indices, _ in _SAME_POINTS])
_BEGINS = _COUNTS[:, 0].cumsum() - _COUNTS[:, 0]
_MIN_WEIGHT = 1.3       # at least two points, one of them an eye or the nose
# Two estimates of one head: across the line of sight (m), and along it, where both are inexact and more so far away.
ACROSS_M, ALONG_M, ALONG_SHARE = 0.2, 0.3, 0.15
PLACES_ALONE = 0.9      # likelihood of two heads at one place that have no points in common in the image


def face_points(landmarks: np.ndarray, aspect: float) -> np.ndarray:
    """Return what the comparison needs of a face: (6, 3), five points x, y, confidence, then size, aspect, 0.

    landmarks: (70, 3) x, y in 0..1 of the image and confidence; aspect: width over height of the image. The
    points are in heights of the image, and so is the size: the square root of the area of the landmarks' bounding
    box, 0 where it has none.
    """
    # All sums at once: ten faces send more than a hundred of these a second.
    points = np.empty((len(_SAME_POINTS) + 1, 3))
    chosen = landmarks[_LANDMARKS]
    points[:-1, :2] = np.add.reduceat(chosen[:, :2], _BEGINS) / _COUNTS
    points[:-1, 2] = np.minimum.reduceat(chosen[:, 2], _BEGINS)
    seen = landmarks if landmarks[:, 2].min() > 0.0 else landmarks[landmarks[:, 2] > 0.0]
    width, height, _ = (seen.max(axis=0) - seen.min(axis=0)).tolist() if len(seen) else (0.0, 0.0, 0.0)
    points[:-1, 0] *= aspect
    points[-1] = math.sqrt(aspect * width * height), aspect, 0.0
    return points


def body_points(skeleton: np.ndarray) -> np.ndarray:
    """Return what the comparison needs of a skeleton (18, 3): (5, 3) x, y in 0..1 of the image, confidence."""
    return skeleton[[joint for joint, _, _ in _SAME_POINTS]]


def likelihoods(faces: np.ndarray, bodies: np.ndarray, distance_scale: float,
                min_point_confidence: float) -> np.ndarray:
    """Return the likelihoods (F, B) that a face and a body are of one human, NaN where too little is seen.

    The likelihood is exp(-d^2 / 2 s^2) with d the weighted mean distance of the points in sizes of the face and
    s = distance_scale.

    Parameters
    ----------
    faces: (F, 6, 3) array
        Of face_points().
    bodies: (B, 5, 3) array
        Of body_points().
    distance_scale: float
        In sizes of the face.
    min_point_confidence: float
        Points of less confidence (0 to 1) are not used.
    """
    size, aspect = faces[:, None, 5, 0], faces[:, None, 5, 1, None]
    face, body = faces[:, None, :5], bodies[None]
    usable = (face[..., 2] >= min_point_confidence) & (body[..., 2] >= min_point_confidence)
    weights = np.where(usable, [weight for _, _, weight in _SAME_POINTS], 0.0)
    total = weights.sum(axis=2)
    apart = np.hypot(face[..., 0] - aspect * body[..., 0], face[..., 1] - body[..., 1])
    known = (total >= _MIN_WEIGHT - 1e-9) & (size > 0.0)
    distance = (weights * apart).sum(axis=2) / np.where(known, total * size, 1.0)
    return np.where(known, np.exp(-0.5 * (distance / distance_scale) ** 2), np.nan)


def place_likelihoods(faces: np.ndarray, bodies: np.ndarray) -> np.ndarray:
    """Return (F, B) likelihoods that faces (F, 3) and heads of skeletons (B, 3) are at one place; NaN where one is NaN.

    Positions in m in the optical frame of one camera, which sees directions exactly and distances less so.
    """
    faces, bodies = faces[:, None], bodies[None]
    apart = faces - bodies
    distance = np.linalg.norm(faces, axis=2)
    line = faces / np.maximum(distance, 1e-6)[..., None]
    along = np.abs((apart * line).sum(axis=2))
    across = np.linalg.norm(apart - (apart * line).sum(axis=2)[..., None] * line, axis=2)
    return np.exp(-0.5 * ((across / ACROSS_M) ** 2 + (along / (ALONG_M + ALONG_SHARE * distance)) ** 2))


def combined(image: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Fuse the likelihoods (F, B) of image and places, either of which may be NaN; the image is the more exact one."""
    both = image * np.sqrt(places)
    return np.where(np.isnan(places), image, np.where(np.isnan(image), PLACES_ALONE * places, both))
