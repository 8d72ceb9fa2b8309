"""An independent simulator of who looks at whom: people who talk, sit, stand and walk, seen as one camera sees them.

Nothing of `core/simulation` and no constant of `core/interactions` is used, so that the estimator and its score do
not share their assumptions. What people do and how it is measured wrongly is drawn anew for each scene, person and
second:

- looks: listeners at the speaker 62 % of the time, speakers at listeners 40 % (Vertegaal et al., CHI 2001); a look
  lasts log-normally about 2 s, mean 2.4 (Argyle and Cook, "Gaze and mutual gaze", 1976: mutual gazes 1.2, gazes 3 s).
  Nobody looks at somebody whose head is hidden behind another.
- head: each person has an own share of the way, from 0.35 to 0.95 to the sides ("head movers" and others: Fuller, J.
  Vestibular Res. 2, 1992), and half of that up and down; it follows the eyes with a lag (Goossens and Van Opstal,
  Exp. Brain Res. 114, 1997). Eyes turn by 45 degrees at most.
- head pose: errors of 4 (yaw), 6 (pitch) degrees for faces seen from the front and growing towards the profile to 10
  and 12 (Yang et al., FSA-Net, CVPR 2019: 4.5 and 6.1 on AFLW2000; Zhu et al., 3DDFA, CVPR 2016, tables by yaw), of
  which half stays with the person.
- eyes: Student-t errors of 5 to 10 degrees by size of the face (Zhang et al., MPIIGaze, PAMI 2019; Kellnhofer et al.,
  Gaze360, ICCV 2019), which last 0.4 s; below 30 px the direction of the head.
- lids: 20 blinks a minute (Bentivoglio et al., Movement Disorders 12, 1997: 17 at rest, 26 talking) of 0.1 to 0.4 s;
  the eyes of those who look down at the table are taken for shut now and then; few close them for 1 to 3 s.
- depth: a factor of 4.5 % that stays with the person (heads differ by 5.5 %, ANSUR II, before irises tell more) and 2
  % that does not.
- gaps: faces beyond 55 to 90 degrees of yaw, hidden by others, and in bursts of 0.4 s, 6 % of the time.
"""

from __future__ import annotations

import math
from collections import Counter
from typing import Dict, Iterator, List, NamedTuple, Sequence, Tuple

import numpy as np
from scipy.spatial.transform import Rotation

from hri_pipeline.core.frames import RawTransform
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.interactions.gaze import ROBOT, GazeTargets
from hri_pipeline.core.interactions.groups import Group, GroupTracker, Individual, group_numbers, individuals_of
from hri_pipeline.core.interactions.parameters import INTERACTION_PARAMETERS
from hri_pipeline.core.interactions.people import GazeTarget, PeopleSnapshot, PeopleTf, gather

RATE = 15.0
SEEDS, TUNING_SEEDS = tuple(range(700, 706)), tuple(range(30, 38))
"""Of the figures told, and those that the estimator's constants were looked at with."""
_CAMERA = np.array([0.0, 0.0, 1.35])
_FOCAL, _HALF_VIEW = 1100.0, math.radians(42.0)
_HEAD = 0.11
_JUST_SEEN_S = 0.3
_DOWN, _ASIDE = "down", "aside"


class Person:
    """One person: what stays the same, and the state of this moment."""

    def __init__(self, name: str, group: int, place: np.ndarray, facing: float, velocity: np.ndarray,
                 rng: np.random.RandomState) -> None:
        self.name, self.group, self.place, self.facing, self.velocity = name, group, place, facing, velocity
        self.share = rng.uniform(0.35, 0.95)
        self.lag = rng.uniform(0.12, 0.25)
        self.target: str = _ASIDE
        self.until = 0.0
        self.aim = np.zeros(2)
        self.head = np.array([facing, 0.0])
        self.eyes = np.array([facing, 0.0])
        self.shut_until = 0.0
        self.closed_at = math.inf
        self.gap_until = -1.0
        self.bias = rng.normal(0.0, 1.0, 2)
        self.depth = rng.normal(0.0, 0.045)
        self.limit = math.radians(rng.uniform(55.0, 90.0))
        self.drift = {name: rng.normal(0.0, 1.0, 2) for name in ("head", "eyes")}


class Image(NamedTuple):
    """stamp (s); {sender: receiver} of those who look at somebody; ids whose face is seen; everybody as seen; the
    robot's place."""

    stamp: float
    gazes: Dict[str, str]
    faces: Sequence[str]
    people: PeopleSnapshot


def scene(count: int, seed: int) -> Tuple[List[Person], np.random.RandomState]:
    """Return people in groups of 2 to 5 around tables and standing, some of whom walk."""
    rng = np.random.RandomState(1000 * count + seed)
    people: List[Person] = []
    group = 0
    while len(people) < count:
        size = min(rng.randint(2, 6), count - len(people))
        seated = rng.rand() < 0.5
        distance, bearing = rng.uniform(1.4, 4.2), rng.uniform(-0.5, 0.5)
        centre = distance * np.array([math.cos(bearing), math.sin(bearing)])
        radius = rng.uniform(0.45, 0.9) * (1.0 if size < 5 else 1.2)
        walks = not seated and rng.rand() < 0.25
        velocity = rng.normal(0.0, 0.12, 2) if walks else np.zeros(2)
        start = rng.uniform(0.0, 2.0 * math.pi)
        members = []
        for index in range(size):
            angle = start + 2.0 * math.pi * (index + rng.uniform(-0.2, 0.2)) / size
            at = centre + radius * np.array([math.cos(angle), math.sin(angle)])
            height = rng.normal(1.18, 0.06) if seated else rng.normal(1.60, 0.09)
            facing = math.atan2(*(centre - at)[::-1]) + rng.normal(0.0, 0.35)
            members.append(Person("p{}".format(len(people) + index), group, np.append(at, height), facing, velocity,
                                  rng))
        if all(_fits(one, people) for one in members):
            people += members
            group += 1
    return people, rng


def _fits(one: Person, others: Sequence[Person]) -> bool:
    x, y, _ = one.place
    return x > 0.8 and abs(math.atan2(y, x)) < _HALF_VIEW and all(
        np.linalg.norm(one.place[:2] - other.place[:2]) > 0.55 for other in others)


def images(count: int, seed: int, seconds: float) -> Iterator[Image]:
    """Yield the images of a scene."""
    people, rng = scene(count, seed)
    frames = PeopleTf()
    frames.set_people(person.name for person in people)
    settings = INTERACTION_PARAMETERS.resolve({})
    speakers: Dict[int, Tuple[str, float]] = {}
    for index in range(int(seconds * RATE)):
        now = index / RATE
        _talk(people, speakers, now, rng)
        for person in people:
            _live(person, people, speakers[person.group][0], now, rng)
        faces = [person.name for person in people if _sense(person, people, frames, now, rng)]
        pose = Pose(np.eye(3), _CAMERA.copy())
        seen = gather(frames, lambda sensors, pose=pose: {name: pose for name in sensors}, now, settings, {})
        yield Image(now, {person.name: person.target for person in people
                          if person.target not in (_DOWN, _ASIDE) and not _is_shut(person, now)}, faces,
                    _with_voices(seen, [speaker for speaker, _ in speakers.values()], rng))


def _with_voices(seen: PeopleSnapshot, speakers: Sequence[str], rng: np.random.RandomState) -> PeopleSnapshot:
    """Who is heard: nine of ten of the images of a turn."""
    seen.speaking = np.array([identity in speakers and rng.rand() < 0.9 for identity in seen.ids])
    return seen


def _is_shut(person: Person, now: float) -> bool:
    """Whether the eyes are closed for longer than a blink takes: then nobody is looked at."""
    return now - person.closed_at > 0.4


def _talk(people: Sequence[Person], speakers: Dict[int, Tuple[str, float]], now: float, rng: np.random.RandomState
          ) -> None:
    """Turns of speech in each group, of 1 to 6 s."""
    for group in {person.group for person in people}:
        if group not in speakers or now >= speakers[group][1]:
            members = [person.name for person in people if person.group == group]
            speakers[group] = (members[rng.randint(len(members))], now + rng.uniform(1.0, 6.0))


def _live(person: Person, people: Sequence[Person], speaker: str, now: float, rng: np.random.RandomState) -> None:
    person.place[:2] += person.velocity / RATE
    if now >= person.until:
        person.target = _next_target(person, people, speaker, rng)
        person.until = now + min(max(math.exp(rng.normal(math.log(2.0), 0.6)), 0.3), 8.0)
        person.aim = np.array([person.facing + rng.normal(0.0, 0.6), rng.normal(-0.05, 0.15)])
        if person.target == _DOWN:
            person.aim = np.array([person.facing + rng.normal(0.0, 0.2), rng.uniform(-0.8, -0.45)])
    places = {other.name: other.place for other in people}
    places[ROBOT] = _CAMERA
    aim = angles(places[person.target] - person.place) if person.target in places else person.aim
    turn = np.array([wrapped(aim[0] - person.facing), aim[1]])
    wanted = np.array([person.facing + person.share * turn[0], 0.5 * person.share * turn[1]])
    far = abs(wrapped(aim[0] - wanted[0])) - math.radians(45.0)
    if far > 0.0:
        wanted[0] += math.copysign(far, wrapped(aim[0] - wanted[0]))
    gain = 1.0 - math.exp(-1.0 / RATE / person.lag)
    person.head += gain * np.array([wrapped(wanted[0] - person.head[0]), wanted[1] - person.head[1]])
    person.eyes = aim + rng.normal(0.0, math.radians(1.5), 2)
    _blink(person, now, rng)


def _next_target(person: Person, people: Sequence[Person], speaker: str, rng: np.random.RandomState) -> str:
    seen = [other for other in people if other is not person and _sees(person.place, other.place, people)]
    mates = [other.name for other in seen if other.group == person.group]
    others = [other.name for other in seen if other.group != person.group]
    chance = rng.rand()
    if speaker in mates and chance < 0.62:
        return speaker
    if mates and person.name == speaker and chance < 0.40:
        return mates[rng.randint(len(mates))]
    rest = [(ROBOT, 0.25 * _sees(person.place, _CAMERA, people)), (_DOWN, 0.2), (_ASIDE, 0.25)]
    rest += [(name, 0.2 / len(mates)) for name in mates] + [(name, 0.1 / len(others)) for name in others]
    weights = np.array([weight for _, weight in rest])
    return rest[rng.choice(len(rest), p=weights / weights.sum())][0]


def _sees(eyes: np.ndarray, target: np.ndarray, people: Sequence[Person]) -> bool:
    """Whether no nearer head hides the target."""
    line = target - eyes
    far = float(np.linalg.norm(line))
    for other in people:
        along = float((other.place - eyes) @ line) / far
        if 0.1 < along < far - 0.1 and np.linalg.norm(other.place - eyes - along * line / far) < 1.5 * _HEAD:
            return False
    return True


def _blink(person: Person, now: float, rng: np.random.RandomState) -> None:
    if now < person.shut_until:
        return
    person.closed_at = math.inf
    chance = rng.rand() * RATE
    if chance < 20.0 / 60.0:
        person.closed_at, person.shut_until = now, now + rng.uniform(0.1, 0.4)
    elif chance < 20.0 / 60.0 + 0.01:
        person.closed_at, person.shut_until = now, now + rng.uniform(1.0, 3.0)


def _sense(person: Person, people: Sequence[Person], frames: PeopleTf, now: float, rng: np.random.RandomState) -> bool:
    """Put the frames of what the camera measures of one person; whether the face is seen."""
    away = person.place - _CAMERA
    distance = float(np.linalg.norm(away))
    to_camera = angles(-away)
    yaw = abs(wrapped(person.head[0] - to_camera[0]))
    measured = away * math.exp(person.depth + rng.normal(0.0, 0.02))
    hidden = any(other is not person and np.linalg.norm(other.place - _CAMERA) < distance - 0.2
                 and np.linalg.norm(angles(other.place - _CAMERA) - angles(away)) < _HEAD / distance
                 for other in people)
    if now > person.gap_until and rng.rand() < 0.06 / 0.4 / RATE:
        person.gap_until = now + rng.exponential(0.4)
    for name, time in (("head", 1.0), ("eyes", 0.4)):
        keep = math.exp(-1.0 / RATE / time)
        fresh = rng.normal(0.0, 1.0, 2) if name == "head" else rng.standard_t(4, 2) / math.sqrt(2.0)
        person.drift[name] = keep * person.drift[name] + math.sqrt(1.0 - keep * keep) * fresh
    face = not hidden and yaw < person.limit and now >= person.gap_until
    _put_body(person, frames, now, measured, hidden, face, rng)
    frames.set_feature(person.name, "face", "f" + person.name if face else "")
    if face:
        _put_face(person, frames, now, measured, yaw, 0.15 * _FOCAL / distance, rng)
    return face


def _put_face(person: Person, frames: PeopleTf, now: float, place: np.ndarray, yaw: float, width: float,
              rng: np.random.RandomState) -> None:
    part = min(max((math.degrees(yaw) - 20.0) / 55.0, 0.0), 1.0)
    spread = np.radians(np.array([4.0, 6.0]) + part * 6.0)
    head = person.head + spread * (0.7 * person.bias + 0.7 * person.drift["head"])
    if width < 30.0:
        eyes = head
    else:
        error = math.radians(5.0 + 5.0 * min(max((80.0 - width) / 50.0, 0.0), 1.0)) * (1.0 + part)
        eyes = person.eyes + error * person.drift["eyes"]
    frames.put(transform("camera", "face_f" + person.name, now, place, head), fixed=False)
    shut = person.closed_at <= now or (person.target == _DOWN and rng.rand() < 0.1)
    if not shut:
        rotation = axes_of(head).T @ axes_of(eyes) @ np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
        frames.put(raw("face_f" + person.name, "gaze_f" + person.name, now, Pose(rotation, np.zeros(3))), fixed=False)


def _put_body(person: Person, frames: PeopleTf, now: float, place: np.ndarray, hidden: bool, face: bool,
              rng: np.random.RandomState) -> None:
    """The skeleton: trunk, and a rough head where there is no face."""
    body = "b" + person.name
    frames.set_feature(person.name, "body", body)
    if hidden:
        return
    trunk = np.array([person.facing + 0.3 * person.bias[0] + rng.normal(0.0, 0.15), 0.0])
    frames.put(transform("camera", "body_" + body, now, place - np.array([0.0, 0.0, 0.65]), trunk), fixed=False)
    if not face:
        head = person.head + 0.3 * person.drift["head"]
        rotation = axes_of(trunk).T @ axes_of(head)
        frames.put(raw("body_" + body, "head_" + body, now, Pose(rotation, np.array([0.0, 0.0, 0.65]))), fixed=False)


def transform(parent: str, child: str, now: float, place: np.ndarray, angles: np.ndarray) -> RawTransform:
    return raw(parent, child, now, Pose(axes_of(angles), place))


def raw(parent: str, child: str, now: float, pose: Pose) -> RawTransform:
    nanoseconds = int(round(now * 1e9))
    x, y, z = pose.translation.tolist()
    return RawTransform(parent, child, nanoseconds // 10 ** 9, nanoseconds % 10 ** 9, (x, y, z), pose.quaternion)


def axes_of(angles: np.ndarray) -> np.ndarray:
    """Frame with x ahead (yaw, pitch up, rad), z up."""
    return Rotation.from_euler("ZY", [angles[0], -angles[1]]).as_matrix()


def angles(vector: np.ndarray) -> np.ndarray:
    return np.array([math.atan2(vector[1], vector[0]), math.atan2(vector[2], math.hypot(vector[0], vector[1]))])


def wrapped(angle: float) -> float:
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


def figures(counts: Sequence[int] = (4, 8, 12), seconds: float = 30.0, seeds: Sequence[int] = SEEDS
            ) -> Dict[str, Dict[str, Dict[str, float]]]:
    """Return precision and recall of who looks at whom: `faces` of senders whose face is seen, or was 0.3 s ago, by
    number of people; `no_face` of all others together; and `robot`, by number of people: groups with the robot, which
    only stands there and looks ahead, `wrong_per_true` group of people.

    Every image counts, also those just after a change; a pair is right when its receiver is.
    """
    faces = {str(count): np.zeros(3) for count in counts}
    hidden, robot = np.zeros(3), {str(count): np.zeros(2) for count in counts}
    for count in counts:
        for seed in seeds:
            true_groups = sum(size > 1 for size in Counter(person.group for person in scene(count, seed)[0]).values())
            settings = INTERACTION_PARAMETERS.resolve({})
            targets, groups = GazeTargets(settings), GroupTracker(settings, seed=0)
            face_at: Dict[str, float] = {}
            gazes: Sequence[GazeTarget] = ()
            at = Individual(ROBOT, _CAMERA[:2], 0.0, 0.05, 0.1)
            for image in images(count, seed, seconds):
                # As the node does it: who stands together, then who looks at whom.
                seen_now = individuals_of(image.people, settings.group_head_sd, gazes) + [at]
                together: Sequence[Group] = groups.update(seen_now, image.stamp)
                robot[str(count)] += sum(ROBOT in group.members for group in together), true_groups
                image.people.groups = group_numbers(image.people.ids, together)
                gazes = targets.update(image.people, _CAMERA, image.stamp)
                found = {gaze.sender: gaze.receiver for gaze in gazes}
                face_at.update((sender, image.stamp) for sender in image.faces)
                for sender in set(found) | set(image.gazes):
                    told, true = found.get(sender), image.gazes.get(sender)
                    seen = image.stamp - face_at.get(sender, -1.0) <= _JUST_SEEN_S
                    sums = faces[str(count)] if seen else hidden
                    sums += (told is not None and told == true, told is not None, true is not None)
    return {"faces": {count: _ratios(sums) for count, sums in faces.items()}, "no_face": {"all": _ratios(hidden)},
            "robot": {count: {"wrong_per_true": float(wrong / max(true, 1.0))}
                      for count, (wrong, true) in robot.items()}}


def _ratios(sums: np.ndarray) -> Dict[str, float]:
    right, told, true = sums.tolist()
    found: Dict[str, float] = {"precision": right / max(told, 1.0), "recall": right / max(true, 1.0), "told": told}
    return found


__all__ = ["RATE", "SEEDS", "TUNING_SEEDS", "Image", "angles", "axes_of", "figures", "images", "raw", "scene",
           "transform", "wrapped"]
