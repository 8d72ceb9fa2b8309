"""Gaze and engagement in simulated scenes whose truth is known: how often what is found is right.

Scenes of people who look at each other, at a robot and at nobody, seen by noisy senses. No ROS. For comparison: the
direction of the head alone.
"""

from __future__ import annotations

import cmath
import math
import random
from dataclasses import dataclass
from typing import Callable, Dict, Iterator, List, Optional, Sequence, Tuple

import numpy as np

from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.interactions.engagement import LEGAL, EngagementEstimator, Level
from hri_pipeline.core.interactions.gaze import ROBOT, GazeTarget, GazeTargets, Observer
from hri_pipeline.core.interactions.parameters import INTERACTION_PARAMETERS, InteractionSettings
from hri_pipeline.core.simulation.parameters import sense_defaults
from hri_pipeline.core.simulation.scene import AWAY, LOOK_AT, Behaviour, Order, PersonScript, Robot, Scene
from hri_pipeline.core.simulation.scene_file import parse_scene
from hri_pipeline.core.simulation.sensors import Sensed, SensedBody, SensedFace, Senses
from hri_pipeline.core.simulation.world import SceneTruth, World

RATE = 15.0
STANDS = Robot()
ROBOT_AT = np.array([*STANDS.position, STANDS.height])
_APART = 0.7
_TRIES = 2000
_SECTOR = 0.9
"""People stand within this bearing (rad) on both sides of straight ahead of the robot."""
SHOULDERS, HEAD = 0.23, 0.12
"""Half of the breadth (m) of the shoulders (ANSUR II: 0.51 and 0.45 m, men and women, clothed less) and the radius of a
head: how far from the line of sight between two others somebody stands at least."""
_SHORTEST, _DWELL = 0.5, 3.0
"""Least and mean length (s) of one look."""
_AWAY, _AT_ROBOT = 0.2, 0.25
Place = Tuple[float, float]
_PLACE_SD = 0.05


@dataclass(frozen=True)
class GazeImage:
    """One image: stamp (s); {sender: receiver} of those who look at somebody; for how long eyes have been closed (s);
    what is seen."""

    stamp: float
    gazes: Dict[str, str]
    closed_for: Dict[str, float]
    seen: List[Observer]


def make_scene(people: int, seconds: float, seed: int, clear: float = SHOULDERS) -> Scene:
    """Return a scene of people who stand 1 to 4 m from the robot, turn towards the middle of all, more or less, and see
    each other and the robot: nobody is nearer than `clear` (m) to the line of sight of two others.
    """
    chance = random.Random("gaze scene {} {}".format(people, seed))
    places = _places(people, clear, chance)
    middle = [sum(place[axis] for place in places) / (people + 1) for axis in (0, 1)]
    scripts = tuple(
        PersonScript("p{}".format(index), chance.uniform(1.55, 1.9), 0.0, seconds + 1.0, (place[0], place[1]),
                     math.atan2(middle[1] - place[1], middle[0] - place[0]) + chance.gauss(0.0, 0.3),
                     orders=tuple(_looks(index, places, seconds + 1.0, chance)))
        for index, place in enumerate(places))
    habits = Behaviour(dwell=0.0, closed=0.1, closed_length=1.0, head_share=chance.uniform(0.6, 1.0))
    return Scene("gaze", seconds + 1.0, scripts, habits=habits, robot=STANDS, seed=seed)


def _places(people: int, clear: float, chance: random.Random) -> List[Place]:
    """Places (m) of which none is hidden by another one from the rest or from the robot."""
    while True:
        places: List[Place] = [(0.0, 0.0)]
        for _ in range(_TRIES):
            bearing, distance = chance.uniform(-_SECTOR, _SECTOR), chance.uniform(1.0, 4.0)
            place = (distance * math.cos(bearing), distance * math.sin(bearing))
            if all(math.dist(place, other) > _APART for other in places) and not _is_hiding(places + [place], clear):
                places.append(place)
            if len(places) == people + 1:
                return places[1:]


def _is_hiding(places: Sequence[Place], clear: float) -> bool:
    count = range(len(places))
    return any(_is_hidden(index, other, places, clear) for index in count for other in count if index != other)


def _looks(index: int, places: Sequence[Place], seconds: float, chance: random.Random) -> Iterator[Order]:
    """Yield what one person looks at, one after the other: the others, the robot, nobody."""
    others = [other for other in range(len(places)) if other != index]
    now = 0.0
    while now < seconds:
        until = now + _SHORTEST + chance.expovariate(1.0 / (_DWELL - _SHORTEST))
        kind = chance.random()
        target = AWAY if kind < _AWAY else ROBOT if kind < _AWAY + _AT_ROBOT else "p{}".format(chance.choice(others))
        yield Order(LOOK_AT, now, until, target)
        now = until


def _is_hidden(index: int, other: int, places: Sequence[Place], clear: float) -> bool:
    x, y = places[index]
    far = complex(places[other][0] - x, places[other][1] - y)
    nearer = [complex(places[third][0] - x, places[third][1] - y) for third in range(len(places))
              if third not in (index, other)]
    return any(abs(near) < abs(far) and abs(cmath.phase(near / far)) < math.atan(clear / abs(near)) for near in nearer)


def run(people: int, seconds: float, seed: int, held: float = 0.0, lid_errors: float = 0.0,
        clear: float = SHOULDERS) -> Iterator[GazeImage]:
    """Yield the images of a scene: gaze noise 8 degrees, head noise 5, 10 % of the time without a face, 10 % closed
    eyes.

    held: correlation time (s) of all noise, 0: another error in each image, and each image misses another face; with
    `held` a face is missing for 0.3 s on average. lid_errors: share of the images in which open eyes are read as
    closed, or closed ones as open.
    """
    world = World(make_scene(people, seconds, seed, clear), seed)
    # Everybody is seen from wherever they look, as by several cameras: only the faults that are asked for.
    senses = Senses(sense_defaults(sense_hfov=160.0, sense_face_angle=180.0, sense_occlusion=False,
                                   sense_lid_errors=lid_errors,
                                   sense_noise_share=1.0 if held else 0.0, sense_noise_time=held or 0.5,
                                   sense_dropout_time=0.3 if held else 0.01), seed, STANDS.height)
    closed_since: Dict[str, float] = {}
    for index in range(int(seconds * RATE)):
        truth = world.at(index / RATE)
        for person in truth.people:
            if not person.eyes_closed:
                closed_since.pop(person.id, None)
            else:
                closed_since.setdefault(person.id, truth.stamp)
        yield GazeImage(truth.stamp, {person.id: person.target for person in truth.people if person.target is not None},
                        {person: truth.stamp - since for person, since in closed_since.items()},
                        observers(truth, senses.sense(truth)))


def observers(truth: SceneTruth, sensed: Sensed) -> List[Observer]:
    """Return everybody of a scene as the senses see them."""
    faces = {face.person: face for face in sensed.faces if face.measured}
    bodies = {body.person: body for body in sensed.bodies if body.measured}
    found = [_onlooker(person.id, faces.get(person.id), bodies.get(person.id), sensed.camera)
             for person in truth.people]
    return [person for person in found if person is not None]


def _onlooker(identity: str, face: Optional[SensedFace], body: Optional[SensedBody],
              camera: Pose) -> Optional[Observer]:
    if face is None and body is None:
        return Observer(identity)
    trunk = camera.rotation @ body.pose.rotation[:, 0] if body is not None else None
    if face is None:
        head = camera.compose(body.head)
        return Observer(identity, head.translation, _PLACE_SD, body_direction=trunk)
    head = camera.compose(face.pose)
    gaze = camera.rotation @ face.gaze if face.gaze is not None else None
    return Observer(identity, head.translation, _PLACE_SD, head_direction=head.rotation[:, 0], gaze_direction=gaze,
                    eyes_closed=face.eyes_closed, body_direction=trunk)


SEEDS = tuple(range(100, 106))
"""Of the figures told. The parameters were chosen on TUNING_SEEDS."""
TUNING_SEEDS = tuple(range(6))
CLOSED_AFTER_S = 0.3
_CONE = math.radians(20.0)

Method = Callable[[Sequence[Observer], Optional[np.ndarray], float], List[GazeTarget]]


class PairCounts:
    """True and false pairs (sender, receiver) over all images."""

    def __init__(self) -> None:
        self.right = self.found = self.true = self.closed_gazes = 0

    def add(self, moment: GazeImage, gazes: Sequence[GazeTarget]) -> None:
        """Compare what was found in one image with the truth."""
        found = {(gaze.sender, gaze.receiver) for gaze in gazes}
        true = set(moment.gazes.items())
        self.right += len(found & true)
        self.found += len(found)
        self.true += len(true)
        self.closed_gazes += sum(moment.closed_for.get(gaze.sender, 0.0) > CLOSED_AFTER_S for gaze in gazes)

    def summary(self) -> Dict[str, float]:
        """Return precision, recall and the number of gazes out of eyes closed for more than 0.3 s."""
        return {"precision": self.right / max(self.found, 1), "recall": self.right / max(self.true, 1),
                "closed_gazes": self.closed_gazes}


def gaze(people: int, seconds: float = 60.0, closed_eyes_rule: bool = True, held: float = 0.0,
         seeds: Sequence[int] = SEEDS, settings: Optional[InteractionSettings] = None,
         clear: float = SHOULDERS) -> Dict[str, float]:
    """Return the figures of so many people over `seconds` for each seed.

    closed_eyes_rule: False withholds what is known of the lids. held: correlation time (s) of all noise, 0: white.
    clear: see make_scene.
    """
    settings = settings or INTERACTION_PARAMETERS.resolve({})
    return _score(people, seconds, held, seeds, lambda: GazeTargets(settings).update, closed_eyes_rule, clear)


def head_rule(people: int, seconds: float = 60.0, held: float = 0.0, seeds: Sequence[int] = SEEDS) -> Dict[str, float]:
    """Return the same of the head's direction alone: the nearest within 20 degrees, image by image."""
    return _score(people, seconds, held, seeds, lambda: nearest_in_cone, True)


def nearest_in_cone(people: Sequence[Observer], robot: Optional[np.ndarray], stamp: float) -> List[GazeTarget]:
    """Return of everybody the target nearest to the head's direction, if it is within 20 degrees."""
    found = []
    for person in people:
        if person.head_direction is None or person.head is None:
            continue
        best, least = None, _CONE
        targets = [(other.id, other.head) for other in people if other is not person and other.head is not None]
        targets += [] if robot is None else [(ROBOT, robot)]
        for identity, place in targets:
            way = place - person.head
            angle = math.acos(min(1.0, max(-1.0, float(way @ person.head_direction) / float(np.linalg.norm(way)))))
            if angle < least:
                best, least = identity, angle
        if best is not None:
            found.append(GazeTarget(person.id, best, 1.0))
    return found


def _score(people: int, seconds: float, held: float, seeds: Sequence[int], make: Callable[[], Method],
           closed_eyes_rule: bool, clear: float = SHOULDERS) -> Dict[str, float]:
    counts = PairCounts()
    for seed in seeds:
        method = make()
        for moment in run(people, seconds, seed, held, clear=clear):
            seen = moment.seen if closed_eyes_rule else [_without_lids(person) for person in moment.seen]
            counts.add(moment, method(seen, ROBOT_AT, moment.stamp))
    return counts.summary()


def _without_lids(person: Observer) -> Observer:
    return Observer(**dict(vars(person), eyes_closed=None))


APPROACH = {
    "name": "approach", "duration": 45.0, "habits": {"dwell": 0.0, "closed": 0.0},
    "people": [{"name": "ann", "at": [5.5, 1.5], "yaw": 90.0,
                "path": [{"to": [1.3, 0.0], "start": 5.0, "speed": 1.0, "yaw": 180.0},
                         {"to": [6.0, 2.0], "start": 30.0, "speed": 1.0}],
                "orders": [{"at": 0.0, "for": 5.0, "look_at": "away"}, {"at": 5.0, "for": 18.0, "look_at": "robot"},
                           {"at": 23.0, "for": 2.2, "look_at": "away"}, {"at": 25.2, "for": 3.0, "look_at": "robot"},
                           {"at": 28.2, "for": 16.0, "look_at": "away"}]}]}
"""Somebody comes to the robot, looks at it, looks away for a moment, looks again, and leaves."""


def engagement(seed: int = 0) -> Dict[str, object]:
    """Return {"illegal": number of illegal transitions, "levels": names in order, "missing": levels never reached}.

    The script APPROACH seen by noisy senses, and nobody at the end.
    """
    course = [level for _, level in levels(seed)]
    illegal = sum(after not in LEGAL[before] for before, after in zip(course, course[1:]) if after != before)
    steps: List[str] = [level.name for index, level in enumerate(course) if index == 0 or level != course[index - 1]]
    return {"illegal": illegal, "levels": steps, "missing": [level.name for level in Level if level.name not in steps]}


def levels(seed: int = 0) -> List[tuple]:
    """Return (stamp in s, level) of every image of APPROACH."""
    settings = INTERACTION_PARAMETERS.resolve({})
    scene = parse_scene(APPROACH)
    world, senses = World(scene, seed), Senses(sense_defaults(), seed, scene.robot.height)
    gazes, estimator = GazeTargets(settings), EngagementEstimator(settings)
    course = []
    for index in range(int(scene.duration * RATE)):
        truth = world.at(index / RATE)
        people = observers(truth, senses.sense(truth))
        found = estimator.update(people, gazes.update(people, ROBOT_AT, truth.stamp), ROBOT_AT, truth.stamp)
        course.append((truth.stamp, found.get("ann", Level.UNKNOWN)))
    return course
