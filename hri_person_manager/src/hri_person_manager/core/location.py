"""Where a person is, and how sure that is: the four rules of the person frame.

1. Not identified: no frame. 2. Tracked, and a feature has given a place within the last second: confidence 1, at the
face, else at the skeleton frame closest to the head, else at the best guess. 3. No such place, but located before: the
last place, with a confidence below 1 that decays, until it reaches 0. 4. Never located: confidence 0 and no frame.

When the face of a person disappears, the body takes over, without a pause and without a jump (`FaceBodyTransition`).

Stamps are times of measurements; they tell how old a place is. `now` is the time at which a place arrives; it tells
whether a source is still active, so that the age of its messages neither favours nor harms a source. A source that lags
behind others of its sensor, or behind itself, is not as sure for that (`SensorTimes`).
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field, replace
from typing import (
    Callable,
    Container,
    Deque,
    Dict,
    Hashable,
    Iterable,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Set,
    Tuple,
)

import numpy as np

from hri_person_manager.core.features import MatchNode, PlaceSource
from hri_person_manager.core.sensors import LONGEST_PERIOD_S, CameraMotion, SensorTimes
from hri_person_manager.core.triangulation import aged, aged_in
from hri_pipeline.core.frames import is_optical
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.timing import JUMP_BACK_S

# s without a face after which the body goes on; bodies may be ahead of faces by the age of an image
SHORTEST = 0.25
PERIODS = 3.0              # the same, in periods of the face, where these are longer
SAME_TIME = 0.1            # s between a face and a body that are compared
LARGEST_STEP = 1.0         # m; farther apart a face and a body are of two people, or one of them is wrong
# s in which half of the step is given up: the longer the face is away, the more the body is right
HALF_LIFE = 1.0
_LEAST_KEPT = 0.7          # of the step from one look at the body to the next, however far apart they are
_GAIN = 0.3                # of a new step
_HISTORY_S = 12.0          # s of faces: bodies of an image have come 3 to 5 s after its faces
_GAP_S = 0.7               # s between two images of a face that tell where it was meanwhile
DECAY_KINDS = ("exponential", "linear", "step")
UNSEEN_CEILING = 0.99      # a person who is not seen is never at 1, not even in the first instant
STEP_CONFIDENCE = 0.5
SMOOTHING = 0.5            # s, of the velocity
LONGEST_STEP = 1.0         # s between two places that tell a velocity
VOICE_PATIENCE = 3.0       # s for which a place that was seen is better than the direction of a voice
FRESH_TIME = 1.0           # s for which a place counts as that of now,
FRESH_PERIODS = 3.0        # and so many image periods, where these are longer;
SLOW_TIME = 2.0            # s at most for a source that is slower than the images of its sensor
LATE_TIME = 1.0            # s by which a place may lag to be one of now
UNSEEN_S = 0.5             # s after the last place of a body from which it was not seen where another one was
TOGETHER_S = 1.0           # s for which a face and a body are seen until their match has come, were it to come
LATE_IMAGES = 3.0          # lags: work on an image that lasts, the next one, and one in which nothing was found
HIGHEST_SPEED = 3.0        # m/s, a person who runs; more is a jump of the measurement
ASIDE_M = 0.3              # by which people step aside while nobody looks (standard deviation)
HEAD_M, TRUNK_M = 0.15, 0.5    # of a face from the head of its body, and from its root (standard deviations)


class FaceBodyTransition:
    """Follows how far the place of a face is from that of its body, while both are seen.

    Times are stamps, s; places m in a named frame. On a busy machine bodies come seconds after the faces of their
    image: what is compared is of one time, not what comes at once.
    """

    def __init__(self) -> None:
        self._faces: Deque[Tuple[float, str, np.ndarray]] = deque()
        self._period: Optional[float] = None
        self._step: Optional[np.ndarray] = None
        self._of: Tuple[str, Hashable] = ("", None)
        self._share, self._shared_at = 1.0, -math.inf       # what is left of the step, of a body of which stamp

    def face(self, frame: str, position: np.ndarray, stamp: float) -> None:
        """Take the place of the face."""
        since = stamp - self._faces[-1][0] if self._faces else 0.0
        if since < -JUMP_BACK_S or (self._faces and self._faces[-1][1] != frame):
            self.clear()
        elif since < 0.0:
            return
        elif 0.0 < since < 1.0:
            self._period = since if self._period is None else self._period + _GAIN * (since - self._period)
        self._faces.append((stamp, frame, position))
        self._share, self._shared_at = 1.0, -math.inf
        while stamp - self._faces[0][0] > _HISTORY_S:
            self._faces.popleft()

    def body(self, frame: str, position: np.ndarray, stamp: float, feature: Hashable) -> None:
        """Take the place of the body; feature: which frame of which body."""
        face = self._face_at(frame, stamp)
        if face is None:
            return
        step = face - position
        known = self._step is not None and self._of == (frame, feature)
        self._step = self._step + _GAIN * (step - self._step) if known else step
        self._of = (frame, feature)

    def patience(self, longest: float) -> float:
        """Return how long (s) the body waits for the face, `longest` s at most and where the two were never seen
        together."""
        if self._step is None or self._period is None:
            return longest
        return min(longest, max(SHORTEST, PERIODS * self._period))

    def shifted(self, place: Place, feature: Hashable) -> Place:
        """Return where the person is by the body alone: its place and what is left of the step to the face.

        A place from before the last one of the face tells nothing new. Its covariance holds the step: one of the two is
        wrong by it.
        """
        step = self._step
        if step is None or self._of != (place.frame, feature) or np.linalg.norm(step) > LARGEST_STEP:
            return place
        stamp, _, last = self._faces[-1]
        since = place.stamp - max(stamp, self._shared_at)
        self._share *= max(_LEAST_KEPT, 0.5 ** (max(0.0, since) / HALF_LIFE))
        self._shared_at = max(place.stamp, self._shared_at)
        is_older = -_HISTORY_S < place.stamp - stamp <= 0.0
        position = last if is_older else place.pose.translation + self._share * step
        covariance = None if place.covariance is None else place.covariance + np.outer(step, step)
        return replace(place, pose=Pose(place.pose.rotation, position), covariance=covariance)

    def _face_at(self, frame: str, stamp: float) -> Optional[np.ndarray]:
        """Where (3,) m the face was at a time, between two images or in one nearly of that time; None: not known."""
        if not self._faces or self._faces[-1][1] != frame:
            return None
        place = next((number for number in range(len(self._faces) - 1, -1, -1) if self._faces[number][0] < stamp), -1)
        near = [self._faces[number] for number in (place, place + 1) if 0 <= number < len(self._faces)]
        if len(near) == 2 and near[1][0] - near[0][0] <= _GAP_S:
            share = (stamp - near[0][0]) / (near[1][0] - near[0][0])
            return (1.0 - share) * near[0][2] + share * near[1][2]
        near = [face for face in near if abs(face[0] - stamp) <= SAME_TIME]
        return min(near, key=lambda face: abs(face[0] - stamp))[2] if near else None

    def clear(self) -> None:
        """Forget everything."""
        self._faces.clear()
        self._period = self._step = None
        self._share, self._shared_at = 1.0, -math.inf


_OF_BODY = (PlaceSource.HEAD, PlaceSource.BODY)


@dataclass(frozen=True)
class Place:
    """A pose in a named frame at a time: `pose` maps person coordinates to `frame` (m), `stamp` in s.

    exact_stamp: the same time as the caller knows it, for the caller; a float of seconds loses nanoseconds. origin:
    where the sensor was, (3,) m in `frame`; None where that is not known. covariance: (3, 3) m^2 of the position in
    `frame`, None where it is not known. camera: maps the sensor's coordinates to `frame`, None where it is not known.
    of_camera: `frame` is that of a camera, whatever its name says.
    """

    frame: str
    pose: Pose
    stamp: float
    exact_stamp: object = None
    origin: Optional[np.ndarray] = None
    covariance: Optional[np.ndarray] = None
    camera: Optional[Pose] = None
    of_camera: bool = False

    @property
    def is_optical(self) -> bool:
        """Whether z of `frame` points ahead of a camera and y down; else z points up."""
        return self.of_camera or is_optical(self.frame)

    @property
    def horizontal(self) -> Tuple[float, float]:
        """The two horizontal coordinates, m."""
        x, y, z = self.pose.translation.tolist()
        return (x, z) if self.is_optical else (x, y)

    @property
    def horizontal_covariance(self) -> Optional[np.ndarray]:
        """The covariance (2, 2) m^2 of the two horizontal coordinates."""
        kept = [0, 2] if self.is_optical else [0, 1]
        return None if self.covariance is None else self.covariance[np.ix_(kept, kept)]


def aged_place(place: Place, elapsed: float) -> Place:
    """Return the place with the covariance of `elapsed` s later."""
    if place.covariance is None:
        return place
    return replace(place, covariance=aged_in(place.covariance, elapsed, place.is_optical))


def is_at(one: Place, other: Place, gate: float) -> bool:
    """Tell whether two places may be one, by their squared Mahalanobis distance with a step aside in between; False
    where that is not known."""
    if one.frame != other.frame or one.covariance is None or other.covariance is None:
        return False
    offset = one.pose.translation - other.pose.translation
    both = one.covariance + other.covariance + ASIDE_M ** 2 * np.eye(3)
    return bool(offset @ np.linalg.solve(both, offset) <= gate)


@dataclass(frozen=True)
class Decay:
    """How the confidence of a location falls once the person is out of sight.

    `exponential` halves every `half_life` seconds and ends at 0 below `floor`; `linear` is at one half after
    `half_life` and at 0 after twice that; `step` is 0.5 at once and 0 after twice the `half_life`.
    """

    kind: str = "exponential"
    half_life: float = 5.0
    floor: float = 0.05

    def __post_init__(self) -> None:
        """Refuse a decay that never ends, with ValueError."""
        if self.kind not in DECAY_KINDS:
            raise ValueError("decay is %r, must be one of %s" % (self.kind, ", ".join(DECAY_KINDS)))
        if not self.half_life > 0.0:
            raise ValueError("half_life is %s s, must be above 0" % self.half_life)
        if not 0.0 < self.floor < 1.0:
            raise ValueError("floor is %s, must be between 0 and 1" % self.floor)

    def confidence(self, elapsed: float) -> float:
        """Return the confidence `elapsed` seconds after the person was last seen or heard."""
        elapsed = max(elapsed, 0.0)
        if self.kind == "exponential":
            value = 0.5 ** (elapsed / self.half_life)
            value = value if value >= self.floor else 0.0
        elif self.kind == "linear":
            value = max(0.0, 1.0 - 0.5 * elapsed / self.half_life)
        else:
            value = STEP_CONFIDENCE if elapsed < 2.0 * self.half_life else 0.0
        return min(value, UNSEEN_CEILING)


class CoastingMotion:
    """Velocity of one person, for going on a little after it was lost (constant velocity, coming to rest)."""

    def __init__(self, coast_time: float) -> None:
        """Coast for `coast_time` seconds at most; ValueError if that is negative."""
        if not coast_time >= 0.0:
            raise ValueError("coast_time is %s s, must not be negative" % coast_time)
        self._coast_time = coast_time
        self._camera = CameraMotion()
        self._last: Optional[Place] = None
        self._velocity = np.zeros(3)

    def see(self, place: Place) -> None:
        """Take a measured place: the velocity is smoothed over about half a second."""
        if self._coast_time <= 0.0:
            return
        last, self._last = self._last, place
        step = math.inf if last is None or last.frame != place.frame else place.stamp - last.stamp
        if last is None or not 0.0 < step <= LONGEST_STEP:
            if step:
                self._velocity = np.zeros(3)
                self._camera.see(place.camera, 0.0)
            return
        measured = (place.pose.translation - last.pose.translation) / step
        jump = self._camera.see(place.camera, step)
        if jump is not None:
            # Who jumps with all that the camera sees stands before it, or walks as before.
            beside = (place.pose.translation - jump.apply(last.pose.translation)) / step
            measured = min(measured, beside, key=np.linalg.norm)
        speed = float(np.linalg.norm(measured))
        measured = measured * min(1.0, HIGHEST_SPEED / speed) if speed > 0.0 else measured
        self._velocity = self._velocity + (1.0 - math.exp(-step / SMOOTHING)) * (measured - self._velocity)

    def coast(self, place: Place, elapsed: float) -> Place:
        """Return the place `elapsed` seconds later: at first with the last velocity, at the end of the time at rest."""
        if self._coast_time <= 0.0 or elapsed <= 0.0:
            return place
        time = min(elapsed, self._coast_time)
        way = self._velocity * (time - 0.5 * time * time / self._coast_time)
        return replace(place, pose=place.pose.moved(way))

    @property
    def velocity(self) -> np.ndarray:
        """(3,) m/s, at the last measured place."""
        return self._velocity

    def clear(self) -> None:
        """Forget the velocity."""
        self._last = None
        self._velocity = np.zeros(3)
        self._camera.see(None, 0.0)


@dataclass
class FeaturePlace:
    """The last place of a tracked feature: by which of its frames, received at the time `now` (s), seen by `sensor`.

    lag: s by which it came later than the least delayed places of that sensor. image_period: s, of the sensor, None
    where it is not known. first: stamp of its first place, s.
    """

    source: PlaceSource
    place: Place
    now: float
    sensor: str = ""
    lag: float = 0.0
    image_period: Optional[float] = None
    first: float = math.inf
    periods: Deque[float] = field(default_factory=lambda: deque(maxlen=5))

    @property
    def period(self) -> float:
        """Time (s) between two images of the feature; 0 while there was one only."""
        # The median: neither an image without the feature nor two that come at once tell the period.
        return sorted(self.periods)[(len(self.periods) - 1) // 2] if self.periods else 0.0

    @property
    def fresh(self) -> float:
        """For how long (s) the place counts as that of now."""
        image_period = self.period if self.image_period is None else min(self.image_period, self.period)
        return max(FRESH_TIME, min(FRESH_PERIODS * self.period, max(FRESH_PERIODS * image_period, SLOW_TIME)))

    @property
    def is_single(self) -> bool:
        """Whether it is the only one of its feature so far, and of an old image: newer ones may show nobody."""
        return self.lag > LATE_TIME and not self.periods


class FeaturePlaces:
    """The last place of each feature that is tracked, whether it belongs to somebody or not yet."""

    def __init__(self) -> None:
        self._known: Dict[MatchNode, FeaturePlace] = {}
        self._times = SensorTimes()

    def add(self, feature: MatchNode, source: PlaceSource, place: Place, now: float, sensor: str = "") -> FeaturePlace:
        """Take a place of a tracked feature that arrives at `now` (s)."""
        known = self._known.get(feature)
        lag = self._times.note(sensor, source, place.stamp, now)
        latest = FeaturePlace(source, place, now, sensor, lag, self._times.period(sensor), place.stamp)
        if known is not None:
            period = place.stamp - known.place.stamp
            if period >= 0.0:
                latest.periods, latest.first = known.periods, known.first
            if 0.0 < period <= LONGEST_PERIOD_S:
                latest.periods.append(period)
        self._known[feature] = latest
        return latest

    def single(self, features: Iterable[MatchNode]) -> Set[MatchNode]:
        """Return those of the features that one old image alone has placed."""
        return {feature for feature in features if feature in self._known and self._known[feature].is_single}

    def of(self, features: Iterable[MatchNode]) -> List[Tuple[MatchNode, FeaturePlace]]:
        """Return those of the features that have a place, with it, the one that was received first comes first."""
        found = [(feature, self._known[feature]) for feature in features if feature in self._known]
        return sorted(found, key=lambda entry: (entry[1].now, entry[1].source))

    def squared_distances(self, faces: Sequence[MatchNode], bodies: Sequence[MatchNode]) -> np.ndarray:
        """Return the squared Mahalanobis distances (F, B) of faces and bodies that one sensor sees, as one human's;
        infinite where they cannot be told."""
        found = np.full((len(faces), len(bodies)), math.inf)
        views: Dict[Tuple[str, str], Tuple[List[int], List[int]]] = {}
        for side, nodes in enumerate((faces, bodies)):
            for number, node in enumerate(nodes):
                latest = self._known.get(node)
                if latest is not None and latest.place.covariance is not None:
                    views.setdefault((latest.sensor, latest.place.frame), ([], []))[side].append(number)
        for rows, columns in views.values():
            if rows and columns:
                found[np.ix_(rows, columns)] = _squared_distances(
                    [self._known[faces[row]] for row in rows], [self._known[bodies[column]] for column in columns])
        return found

    def outdated(self, bodies: Sequence[MatchNode], gate: float) -> Set[MatchNode]:
        """Return those of the bodies that were not seen any more when another one of their sensor was at their place;
        gate: see squared_distances."""
        stamps = np.array([self._known[body].place.stamp if body in self._known else math.nan for body in bodies])
        is_newer = stamps > stamps[:, None] + UNSEEN_S
        if not is_newer.any():
            return set()
        replaced = (is_newer & (self.squared_distances(bodies, bodies) <= gate)).any(axis=1)
        return {body for body, is_outdated in zip(bodies, replaced.tolist()) if is_outdated}

    def match_delay(self, face: MatchNode, body: MatchNode) -> float:
        """Return how much later (s) than without a lag the match of two may come; 0 once both have been seen for
        TOGETHER_S, and an image more, of one time."""
        one, other = self._known.get(face), self._known.get(body)
        if one is None or other is None:
            return 0.0
        together = min(one.place.stamp, other.place.stamp) - max(one.first, other.first)
        return LATE_IMAGES * max(one.lag, other.lag) if together <= TOGETHER_S + max(one.period, other.period) else 0.0

    def retain(self, is_tracked: Callable[[MatchNode], bool]) -> None:
        """Forget the features that are not tracked any more."""
        self._known = {feature: latest for feature, latest in self._known.items() if is_tracked(feature)}


def _squared_distances(faces: Sequence[FeaturePlace], bodies: Sequence[FeaturePlace]) -> np.ndarray:
    """Squared distances (F, B) of faces and bodies in one frame."""
    face, body = (np.array([latest.place.pose.translation for latest in of]) for of in (faces, bodies))
    one, other = (np.array([latest.place.covariance for latest in of]) for of in (faces, bodies))
    seen, since = (np.array([latest.place.stamp for latest in of]) for of in (faces, bodies))
    apart = np.array([TRUNK_M if latest.source == PlaceSource.BODY else HEAD_M for latest in bodies]) ** 2
    both = aged(one[:, None] + other + apart[:, None, None] * np.eye(3), np.abs(seen[:, None] - since))
    offsets = face[:, None] - body
    return np.asarray((offsets * np.linalg.solve(both, offsets[..., None])[..., 0]).sum(axis=2))


class _LastReport(NamedTuple):
    """The last place of a source: its stamp, when it arrived, for how long it counts, and how late it was; all s."""

    stamp: float
    arrived: float
    fresh: float
    lag: float = 0.0

    @property
    def until(self) -> float:
        """Until when (s) it counts as that of now: from when it was seen, not from when it came."""
        return self.arrived - self.lag + self.fresh


class PersonLocation:
    """Last known place of one person, fed by transforms of its face, head, body and voice frames."""

    def __init__(self, source_timeout: float, coast_time: float = 0.0) -> None:
        """Use a worse source once the better ones are silent for `source_timeout` seconds.

        coast_time: s, for which a person that is not seen any more goes on as it went; 0 lets it stand.
        """
        self._source_timeout = source_timeout
        self._motion = CoastingMotion(coast_time)
        self._transition = FaceBodyTransition()
        self._reports: Dict[Tuple[PlaceSource, Hashable], _LastReport] = {}
        self.clear()

    def clear(self) -> None:
        """Forget the place."""
        self.place: Optional[Place] = None
        self._active: Tuple[PlaceSource, Hashable] = (PlaceSource.VOICE, None)
        self._motion.clear()
        self._transition.clear()
        self._reports.clear()
        self.updated = self._seen = self._fresh_until = float("-inf")

    def offer(self, source: PlaceSource, place: Place, now: float, feature: Hashable = None,
              fresh: float = FRESH_TIME, lag: float = 0.0) -> bool:
        """Take a new place, received at `now` (s), unless a better source is active; return whether it was taken.

        Of two features that are equally good, such as the faces that two cameras see of one person, the one that was
        used first goes on. A voice tells the direction only: where somebody was seen shortly before is closer to the
        truth. A body goes on from where the face was: see `FaceBodyTransition`. fresh: s for which the place counts as
        that of now, from `lag` s before it came.
        """
        better = self._better(source, place.stamp, now, feature)
        self._reports[source, feature] = _LastReport(place.stamp, now, fresh, lag)
        if source in _OF_BODY and better in (None, PlaceSource.FACE):
            self._transition.body(place.frame, place.pose.translation, place.stamp, (source, feature))
        if better is not None:
            return False
        if source != PlaceSource.VOICE:
            self._seen = now
        elif -JUMP_BACK_S <= now - self._seen <= VOICE_PATIENCE:
            return False
        if source == PlaceSource.FACE:
            self._transition.face(place.frame, place.pose.translation, place.stamp)
        elif source in _OF_BODY:
            place = self._transition.shifted(place, (source, feature))
        self._active = (source, feature)
        self._motion.see(place)
        self.place = place
        self.updated = now
        return True

    def confidence(self, now: float, decay: Decay) -> float:
        """Return how far the place is to be trusted at `now` (s): 1 while it is fresh, then less, 0 without one."""
        if self.place is None:
            return 0.0
        until = max([report.until for report in self._reports.values()], default=-math.inf)
        return 1.0 if now <= until else decay.confidence(now - max(until, self._fresh_until))

    def expected(self, now: float) -> Optional[Place]:
        """Return where the person is now when nobody has seen it since its last place; None without one.

        The longer the sources are silent, the larger is the covariance; that of the height only up to that of who sits
        down or gets up, where z points up.
        """
        if self.place is None:
            return None
        away = now - self.updated
        place = self._motion.coast(self.place, away)
        return aged_place(place, away) if self.is_silent(now) else place

    def retain(self, features: Container[Hashable], now: float) -> None:
        """Let go of all sources but those of these features; at `now` (s) the others have left."""
        for key in [key for key in self._reports if key[1] not in features]:
            report = self._reports.pop(key)
            self._fresh_until = max(self._fresh_until, min(now, report.until))

    def inherit(self, other: "PersonLocation") -> None:
        """Take over the sources of a person that turned out to be the same, and its place, if that is the better."""
        for key, report in other._reports.items():
            known = self._reports.get(key)
            self._reports[key] = report if known is None or report.arrived > known.arrived else known
        self._fresh_until = max(self._fresh_until, other._fresh_until)
        newer_by = other.updated - self.updated
        worth, own = other._active[0], self._active[0]
        if worth < own if worth != own and abs(newer_by) <= self._source_timeout else newer_by > 0.0:
            self.place, self._active = other.place, other._active
            self.updated = max(self.updated, other.updated)
        self._seen = max(self._seen, other._seen)

    def is_silent(self, now: float) -> bool:
        """Tell whether no source has placed the person for longer than the time limit."""
        return now - self.updated > self._source_timeout

    def _better(self, source: PlaceSource, stamp: float, now: float, feature: Hashable) -> Optional[PlaceSource]:
        """Return the best of the active sources with priority over this one; None where it is the best itself."""
        return min((key[0] for key, report in self._reports.items()
                    if (key[0] < source or (key == self._active and key[0] == source and key[1] != feature))
                    and _is_active(report, stamp, now, self._patience(key[0], source))), default=None)

    def _patience(self, better: PlaceSource, source: PlaceSource) -> float:
        """How long (s) a source waits for a better one that is silent."""
        if better == PlaceSource.FACE and source in _OF_BODY:
            return self._transition.patience(self._source_timeout)
        return self._source_timeout


def _is_active(report: _LastReport, stamp: float, now: float, patience: float) -> bool:
    """Tell whether a source is still there for one that has a place of `stamp` at `now`.

    It is while it has not been silent for `patience` s, and while the other one has nothing newer to tell, which a
    source that lags has not at once. Stamps that jump back end the wait when the first one is not fresh any more.
    """
    silence = now - report.arrived
    if not -JUMP_BACK_S <= silence <= max(report.fresh, patience):
        return False
    return silence <= patience or stamp - report.stamp <= patience
