"""Simulated worlds to train on: habits, places and errors are drawn anew for each scene, from wide ranges.

Not to measure with: the figures are those of `gaze_independent`, whose laws and numbers are others, and of real
pictures. A judge trained on many worlds cannot rely on the numbers of one (domain randomisation: Tobin et al., IROS
2017). The ranges are about the spans of what is published: heads turn a third to all of the way (Fuller, J. Vestibular
Res. 2, 1992; Stiefelhagen and Zhu, CHI 2002), looks last 1 to 4 s by exponential, gamma or log-normal laws (Argyle and
Cook, 1976), listeners look at the speaker for 25 to 80 % of the time (Vertegaal et al., CHI 2001), eyes are wrong by 3
to 9 degrees and head poses by 3 to 8 near the front, partly for good, partly for a while, partly in each image anew.
"""

from __future__ import annotations

import math
from typing import Dict, Iterator, List, Mapping, NamedTuple, Optional, Tuple

import numpy as np

from benchmarks import gaze_independent as plumbing
from benchmarks.gaze_independent import Image
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.interactions.gaze import ROBOT
from hri_pipeline.core.interactions.parameters import INTERACTION_PARAMETERS
from hri_pipeline.core.interactions.people import PeopleTf, gather

_DOWN, _ASIDE = "down", "aside"
_EYE_AXES = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
_FOCAL, _FACE_WIDTH = 1100.0, 0.15
_HIDING = 0.13
_TRIES = 3000
RANGES: Dict[str, Tuple[float, float]] = {
    "camera_height": (1.0, 1.7), "listen": (0.25, 0.8), "speak": (0.25, 0.75), "robot": (0.02, 0.35),
    "down": (0.03, 0.3), "aside": (0.05, 0.4), "mates": (0.1, 0.5), "others": (0.0, 0.15), "returned": (0.0, 0.4),
    "dwell": (1.0, 4.0), "least_dwell": (0.2, 0.7), "turn": (1.5, 6.0), "silence": (0.0, 0.3), "heard": (0.6, 1.0),
    "eyes_sd": (3.0, 9.0), "eyes_turned": (0.0, 1.8), "eyes_far": (0.0, 1.2), "tremor": (0.3, 2.0),
    "yaw_sd": (2.5, 6.5), "pitch_sd": (3.0, 8.0), "head_turned": (0.0, 9.0), "trunk_sd": (0.08, 0.3),
    "trunk_bias": (0.0, 0.35), "depth_sd": (0.02, 0.065), "depth_noise": (0.005, 0.035),
    "eyes_lasting": (0.0, 0.35), "eyes_white": (0.0, 0.6), "eyes_time": (0.15, 1.2),
    "head_lasting": (0.2, 0.7), "head_white": (0.0, 0.4), "head_time": (0.3, 2.0),
    "gaps": (0.01, 0.12), "gap_time": (0.2, 0.8), "blinks": (8.0, 30.0), "shut_down": (0.0, 0.2), "shut": (0.0, 0.03),
    "least_width": (20.0, 34.0), "trunk_gap_time": (0.5, 6.0)}
"""Of each scene: parts of the time (0 to 1), times (s), angles (deg), parts of the distance, blinks per minute, px."""
RATES = (15.0, 15.0, 15.0, 30.0, 10.0, 7.5, 5.0)
"""Images per second, one of them for each scene."""
_DWELL_LAWS, _FREEDOMS = ("exponential", "gamma", "log-normal"), (3.5, 5.0, 8.0, 30.0)


class Error:
    """Errors of two axes with variance 1: a part that stays, one that lasts for a while, and one of each image."""

    def __init__(self, lasting: float, white: float, steps: float, freedom: float, rng: np.random.RandomState) -> None:
        """lasting: part of the variance; white: part of the rest; steps: images that it lasts; freedom: of the
        t-distributed changes."""
        self._rng, self._freedom, self._keep = rng, freedom, math.exp(-1.0 / steps)
        self._parts = [math.sqrt(part) for part in (lasting, (1.0 - white) * (1.0 - lasting), white * (1.0 - lasting))]
        self._bias, self._slow = rng.normal(0.0, 1.0, 2), rng.normal(0.0, 1.0, 2)

    def draw(self) -> np.ndarray:
        """Return the error of the next image (2,)."""
        fresh = self._rng.standard_t(self._freedom, 2) / math.sqrt(self._freedom / (self._freedom - 2.0))
        self._slow = self._keep * self._slow + math.sqrt(1.0 - self._keep ** 2) * fresh
        now = self._rng.normal(0.0, 1.0, 2)
        return sum(part * value for part, value in zip(self._parts, (self._bias, self._slow, now)))


class Someone:
    """One person: where, how, and what goes on."""

    def __init__(self, name: str, group: int, place: np.ndarray, facing: float, velocity: np.ndarray) -> None:
        self.name, self.group, self.place, self.facing, self.velocity = name, group, place, facing, velocity
        self.target, self.until, self.aim, self.spot = _ASIDE, 0.0, np.zeros(2), np.zeros(3)
        self.head, self.eyes = np.array([facing, 0.0]), np.array([facing, 0.0])
        self.shut_until, self.closed_at, self.gap_until, self.nearer = 0.0, math.inf, -1.0, 0.0
        self.trunk_gap_until = -1.0

    def settle(self, scene: Dict[str, float], rng: np.random.RandomState) -> None:
        """Draw what stays the same."""
        self.share = rng.uniform(0.3, 1.0)
        self.share_up = self.share * rng.uniform(0.3, 1.0)
        self.lag, self.rate = rng.uniform(0.08, 0.3), rng.uniform(2.5, 7.0)
        self.eyes_limit, self.face_limit = np.radians([rng.uniform(35.0, 50.0), rng.uniform(50.0, 90.0)])
        self.depth, self.trunk = rng.normal(0.0, scene["depth_sd"]), rng.normal(0.0, scene["trunk_bias"])
        self.eyes_error = Error(scene["eyes_lasting"], scene["eyes_white"], scene["eyes_time"] * scene["rate"],
                                _FREEDOMS[rng.randint(len(_FREEDOMS))], rng)
        self.head_error = Error(scene["head_lasting"], scene["head_white"], scene["head_time"] * scene["rate"],
                                _FREEDOMS[-1], rng)
        self.no_trunk = rng.rand() < scene["no_trunks"]


class Moment(NamedTuple):
    """image: see gaze_independent; camera: (3,) its place (m), which is the robot's."""

    image: Image
    camera: np.ndarray


def people_of(count: int, rng: np.random.RandomState) -> List[Someone]:
    """Return people alone, in circles and in rows, who stand, sit and walk; at most `count`."""
    people: List[Someone] = []
    for group in range(_TRIES):
        if len(people) >= count:
            break
        size = min(int(rng.choice([1, 2, 2, 3, 3, 4, 5, 6])), count - len(people))
        members = _members(size, group, len(people), rng)
        everybody = people + members
        if all(one.place[0] > 0.7 and abs(math.atan2(one.place[1], one.place[0])) < 0.75 and all(
                np.linalg.norm(one.place[:2] - other.place[:2]) > 0.5 for other in everybody if other is not one)
               for one in members):
            people = everybody
    return people


def _members(size: int, group: int, first: int, rng: np.random.RandomState) -> List[Someone]:
    sits, in_row = rng.rand() < 0.4, rng.rand() < 0.2
    distance, bearing, start = rng.uniform(1.2, 4.5), rng.uniform(-0.6, 0.6), rng.uniform(0.0, 2.0 * math.pi)
    centre = distance * np.array([math.cos(bearing), math.sin(bearing)])
    radius, apart, spread = rng.uniform(0.4, 1.2) * (1.3 if size > 4 else 1.0), rng.uniform(0.65, 0.9), rng.uniform(
        0.1, 0.4)
    velocity = rng.normal(0.0, 0.2, 2) if not sits and rng.rand() < 0.2 else np.zeros(2)
    members = []
    for index in range(size):
        if in_row:
            place = centre + (index - 0.5 * (size - 1)) * apart * np.array([math.cos(start), math.sin(start)])
            facing = start + 0.5 * math.pi
        else:
            angle = start + 2.0 * math.pi * index / size + rng.normal(0.0, 0.15)
            place = centre + radius * np.array([math.cos(angle), math.sin(angle)])
            facing = math.atan2(*(centre - place)[::-1])
        height = rng.normal(1.15, 0.07) if sits else rng.normal(1.58, 0.1)
        members.append(Someone("p{}".format(first + index), group, np.append(place, height),
                               facing + rng.normal(0.0, spread), velocity))
    return members


def _left_out(rng: np.random.RandomState) -> Dict[str, float]:
    """Return the rate (Hz) and what is left out of a scene."""
    found = {"rate": float(rng.choice(RATES)), "no_trunks": rng.uniform(0.1, 1.0) * (rng.rand() < 0.4),
             "trunk_gaps": rng.uniform(0.05, 0.4) * (rng.rand() < 0.4), "deaf": float(rng.rand() < 0.3)}
    return found


class RandomWorld:
    """One scene that goes on. In some, trunks are not seen, of somebody or for a while, or nobody is heard."""

    def __init__(self, count: int, seed: int, fixed: Optional[Mapping[str, float]] = None) -> None:
        """fixed: values of RANGES that are not to be drawn, of `rate` (Hz), `no_trunks` (part of the people),
        `trunk_gaps` (part of the time), and `deaf` (1 or 0)."""
        self._rng = np.random.RandomState(7919 * count + seed)
        self._scene = {name: self._rng.uniform(*span) for name, span in RANGES.items()}
        self._scene.update(_left_out(self._rng), **(fixed or {}))
        self._law = _DWELL_LAWS[self._rng.randint(len(_DWELL_LAWS))]
        self._camera = np.array([0.0, 0.0, self._scene["camera_height"]])
        self._people = people_of(count, self._rng)
        for person in self._people:
            person.settle(self._scene, self._rng)
        self._speakers: Dict[int, Tuple[Optional[str], float]] = {}
        self._frames = PeopleTf()
        self._frames.set_people(person.name for person in self._people)

    def moments(self, seconds: float) -> Iterator[Moment]:
        """Yield the images of so many seconds."""
        settings, pose = INTERACTION_PARAMETERS.resolve({}), Pose(np.eye(3), self._camera.copy())
        for index in range(int(seconds * self._scene["rate"])):
            now = index / self._scene["rate"]
            self._talk(now)
            for person in self._people:
                self._live(person, now)
            faces = [person.name for person in self._people if self._sense(person, now)]
            seen = gather(self._frames, lambda sensors: {name: pose for name in sensors}, now, settings, {})
            speakers = {speaker for speaker, _ in self._speakers.values()}
            heard = np.array([identity in speakers and self._rng.rand() < self._scene["heard"]
                              for identity in seen.ids], dtype=bool)
            seen.speaking = None if self._scene["deaf"] else heard
            looks = {person.name: person.target for person in self._people
                     if person.target not in (_DOWN, _ASIDE) and now - person.closed_at <= 0.4}
            yield Moment(Image(now, looks, faces, seen), self._camera)

    def _talk(self, now: float) -> None:
        for group in {person.group for person in self._people}:
            if group not in self._speakers or now >= self._speakers[group][1]:
                members = [person.name for person in self._people if person.group == group]
                silent = len(members) < 2 or self._rng.rand() < self._scene["silence"]
                self._speakers[group] = (None if silent else members[self._rng.randint(len(members))],
                                         now + max(0.5, self._rng.exponential(self._scene["turn"])))

    def _live(self, person: Someone, now: float) -> None:
        rng, rate = self._rng, self._scene["rate"]
        person.place[:2] += person.velocity / rate
        if now >= person.until:
            person.target, person.until = self._next_target(person), now + self._dwell()
            person.spot = rng.normal(0.0, 0.04, 3)
            person.aim = np.array([person.facing, 0.0]) + (
                [rng.normal(0.0, 0.25), rng.uniform(-0.9, -0.4)] if person.target == _DOWN
                else [rng.normal(0.0, 0.8), rng.normal(-0.05, 0.2)])
        places = {other.name: other.place for other in self._people}
        places[ROBOT] = self._camera
        aim = plumbing.angles(places[person.target] + person.spot - person.place) if person.target in places \
            else person.aim
        turn = plumbing.wrapped(aim[0] - person.facing)
        yaw, pitch = person.facing + person.share * turn, person.share_up * aim[1]
        beyond = abs(plumbing.wrapped(aim[0] - yaw)) - person.eyes_limit
        yaw += math.copysign(max(beyond, 0.0), plumbing.wrapped(aim[0] - yaw))
        step = np.array([plumbing.wrapped(yaw - person.head[0]), pitch - person.head[1]])
        step *= 1.0 - math.exp(-1.0 / rate / person.lag)
        person.head = person.head + np.clip(step, -person.rate / rate, person.rate / rate)
        person.eyes = aim + rng.normal(0.0, math.radians(self._scene["tremor"]), 2)
        self._blink(person, now)

    def _dwell(self) -> float:
        mean, least = self._scene["dwell"], self._scene["least_dwell"]
        lasts = (least + self._rng.exponential(max(mean - least, 0.2)) if self._law == "exponential"
                 else self._rng.gamma(2.0, 0.5 * mean) if self._law == "gamma"
                 else math.exp(self._rng.normal(math.log(mean) - 0.25, 0.7)))
        return min(max(lasts, 0.25), 12.0)

    def _next_target(self, person: Someone) -> str:
        rng, scene = self._rng, self._scene
        seen = [other for other in self._people if other is not person and self._is_clear(person, other.place, other)]
        mates = [other.name for other in seen if other.group == person.group]
        others = [other.name for other in seen if other.group != person.group]
        lookers = [other.name for other in seen if other.target == person.name]
        speaker = self._speakers[person.group][0]
        if lookers and rng.rand() < scene["returned"]:
            return lookers[rng.randint(len(lookers))]
        if speaker in mates and rng.rand() < scene["listen"]:
            return str(speaker)
        if speaker == person.name and mates and rng.rand() < scene["speak"]:
            return mates[rng.randint(len(mates))]
        chances = {_DOWN: scene["down"], _ASIDE: scene["aside"],
                   ROBOT: scene["robot"] * self._is_clear(person, self._camera, None)}
        chances.update((name, scene["mates"] / len(mates)) for name in mates)
        chances.update((name, scene["others"] / len(others)) for name in others)
        weights = np.array(list(chances.values()))
        return list(chances)[rng.choice(len(weights), p=weights / weights.sum())]

    def _is_clear(self, person: Someone, place: np.ndarray, target: Optional[Someone]) -> bool:
        line = place - person.place
        far = float(np.linalg.norm(line)) + 1e-9
        for other in self._people:
            if other is person or other is target:
                continue
            along = float((other.place - person.place) @ line) / far
            if 0.1 < along < far - 0.1 and np.linalg.norm(other.place - person.place - along * line / far) < _HIDING:
                return False
        return True

    def _blink(self, person: Someone, now: float) -> None:
        if now < person.shut_until:
            return
        person.closed_at = math.inf
        chance, blinks = self._rng.rand() * self._scene["rate"], self._scene["blinks"] / 60.0
        if chance < blinks + self._scene["shut"]:
            person.closed_at = now
            person.shut_until = now + (self._rng.uniform(0.1, 0.4) if chance < blinks else self._rng.uniform(0.8, 3.0))

    def _sense(self, person: Someone, now: float) -> bool:
        """Put the frames of what the camera measures of one person; whether the face is seen."""
        rng, away = self._rng, person.place - self._camera
        distance = float(np.linalg.norm(away))
        yaw = abs(plumbing.wrapped(person.head[0] - plumbing.angles(-away)[0]))
        person.nearer = 0.7 * person.nearer + 0.71 * rng.normal(0.0, self._scene["depth_noise"])
        place = away * math.exp(person.depth + person.nearer)
        hidden = any(other is not person and np.linalg.norm(other.place - self._camera) < distance - 0.2
                     and np.linalg.norm(plumbing.angles(other.place - self._camera) - plumbing.angles(away))
                     < _HIDING / distance for other in self._people)
        if now > person.gap_until and rng.rand() < self._scene["gaps"] / self._scene["gap_time"] / self._scene["rate"]:
            person.gap_until = now + rng.exponential(self._scene["gap_time"])
        face = not hidden and yaw < person.face_limit and now >= person.gap_until
        eyes, head = person.eyes_error.draw(), person.head_error.draw()
        self._put_body(person, now, place, hidden, None if face else person.head + 0.3 * head)
        self._frames.set_feature(person.name, "face", "f" + person.name if face else "")
        if face:
            self._put_face(person, now, place, yaw, eyes, head)
        return face

    def _put_body(self, person: Someone, now: float, place: np.ndarray, hidden: bool, head: Optional[np.ndarray]
                  ) -> None:
        body = "b" + person.name
        self._frames.set_feature(person.name, "body", body)
        gaps, rate = self._scene["trunk_gaps"] / self._scene["trunk_gap_time"], self._scene["rate"]
        if now > person.trunk_gap_until and self._rng.rand() < gaps / rate:
            person.trunk_gap_until = now + self._rng.exponential(self._scene["trunk_gap_time"])
        if hidden or person.no_trunk or now < person.trunk_gap_until:
            return
        hips = np.array([0.0, 0.0, 0.65])
        trunk = np.array([person.facing + person.trunk + self._rng.normal(0.0, self._scene["trunk_sd"]), 0.0])
        self._frames.put(plumbing.transform("camera", "body_" + body, now, place - hips, trunk), fixed=False)
        if head is not None:
            rotation = plumbing.axes_of(trunk).T @ plumbing.axes_of(head)
            self._frames.put(plumbing.raw("body_" + body, "head_" + body, now, Pose(rotation, hips)), fixed=False)

    def _put_face(self, person: Someone, now: float, place: np.ndarray, yaw: float, eyes: np.ndarray, head: np.ndarray
                  ) -> None:
        scene, name = self._scene, person.name
        part = min(max((math.degrees(yaw) - 15.0) / 60.0, 0.0), 1.0)
        face = person.head + np.radians(np.array([scene["yaw_sd"], scene["pitch_sd"]]) + part * scene["head_turned"]
                                        ) * head
        width = _FACE_WIDTH * _FOCAL / float(np.linalg.norm(place))
        far = 1.0 + scene["eyes_far"] * min(max((80.0 - width) / 50.0, 0.0), 1.0)
        error = math.radians(scene["eyes_sd"]) * far * (1.0 + scene["eyes_turned"] * part)
        gaze = face if width < scene["least_width"] else person.eyes + error * eyes
        self._frames.put(plumbing.transform("camera", "face_f" + name, now, place, face), fixed=False)
        if not (person.closed_at <= now or (person.target == _DOWN and self._rng.rand() < scene["shut_down"])):
            rotation = plumbing.axes_of(face).T @ plumbing.axes_of(gaze) @ _EYE_AXES
            self._frames.put(plumbing.raw("face_f" + name, "gaze_f" + name, now, Pose(rotation, np.zeros(3))),
                             fixed=False)
