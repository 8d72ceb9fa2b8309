"""Pictures of real people, seen by a camera whose motion is known exactly: what a robot that turns and drives makes of
people who stand still.

A picture stands upright `PLANE_M` before the robot. Whatever turns and drives the camera, image and transforms agree:
each image is the picture under the homography of the camera's pose, blurred by its exposure.
"""

from __future__ import annotations

import math
from collections import defaultdict
from typing import Callable, Dict, List, Mapping, NamedTuple, Sequence, Tuple

import cv2
import numpy as np

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.geometry import Pose

HFOV = math.radians(60.0)
CAMERA_M, PLANE_M = 1.4, 1.37
"""Height of the camera; way from it to the picture at the start (m)."""
REST_S, LEARN_S = 3.0, 1.0
"""Time (s) at the start in which the camera stands, and at its end that in which it is learnt who is where."""
RATE_HZ, EXPOSURE_S = 15.0, 0.01
ENTERED_S, EDGE = 0.4, math.radians(5.0)
"""Somebody is to be seen who has been inside the image, so far (rad) from its edge, for so long (s)."""
OPTICAL = Pose(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.zeros(3))
_BLUR_STEPS, _BLUR_PX = 7, 1.0
_BORDER = (40, 40, 40)


class State(NamedTuple):
    """Where the robot is at one time: way along x (m), turn of the base, pan, tilt and roll of its head (rad)."""

    forward: float = 0.0
    turn: float = 0.0
    pan: float = 0.0
    tilt: float = 0.0
    roll: float = 0.0


class Motion(NamedTuple):
    """State at a time (s) after the start, and how long it lasts (s)."""

    state: Callable[[float], State]
    seconds: float


def turned(yaw: float = 0.0, pitch: float = 0.0, roll: float = 0.0, place: Sequence[float] = (0.0, 0.0, 0.0)) -> Pose:
    """Return the pose of a link with these angles (rad, REP-103) at a place (m)."""
    cosine, sine = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cosine[0], -sine[0]], [0.0, sine[0], cosine[0]]])
    about_y = np.array([[cosine[1], 0.0, sine[1]], [0.0, 1.0, 0.0], [-sine[1], 0.0, cosine[1]]])
    about_z = np.array([[cosine[2], -sine[2], 0.0], [sine[2], cosine[2], 0.0], [0.0, 0.0, 1.0]])
    return Pose(about_z @ about_y @ about_x, np.array(place, dtype=np.float64))


def camera_in_odom(state: State) -> Pose:
    """Return the pose of the optical frame in the room."""
    base = turned(state.turn, place=(state.forward, 0.0, 0.0))
    return base.compose(turned(state.pan, state.tilt, state.roll, (0.0, 0.0, CAMERA_M))).compose(OPTICAL)


def stops(angles: Sequence[float], speed: float, pause: float) -> Tuple[Callable[[float], float], float]:
    """Return an angle (rad) over time, and for how long it moves (s): from 0 to each of `angles` (degrees) in turn,
    with pauses (s) and a highest speed (degrees/s)."""
    times, places = [0.0], [0.0]
    for angle in angles:
        moved = times[-1] + max(2.0 * abs(angle - places[-1]) / speed, 1e-3)
        times += [moved, moved + pause]
        places += [angle, angle]

    def at(now: float) -> float:
        number = int(np.clip(np.searchsorted(times, now, side="right") - 1, 0, len(times) - 2))
        part = float(np.clip((now - times[number]) / (times[number + 1] - times[number]), 0.0, 1.0))
        way = places[number + 1] - places[number]
        return math.radians(places[number] + way * (part - math.sin(2.0 * math.pi * part) / (2.0 * math.pi)))
    return at, times[-1]


def _panned(speed: float) -> Motion:
    at, seconds = stops((20.0, -20.0, 20.0, -20.0, 40.0, 0.0), speed, 1.5)
    return Motion(lambda now: State(pan=at(now - REST_S)), REST_S + seconds)


def _turned() -> Motion:
    at, seconds = stops((80.0, 0.0), 40.0, 3.0)
    return Motion(lambda now: State(turn=at(now - REST_S)), REST_S + seconds)


def _shaken(now: float) -> State:
    """The robot drives to the people and shakes its head."""
    moving = max(0.0, now - REST_S)
    swing = math.radians(2.0) * min(moving, 1.0)
    return State(forward=min(0.05 * moving, 0.4), tilt=swing * math.sin(4.0 * math.pi * moving),
                 roll=swing * math.sin(3.4 * math.pi * moving))


MOTIONS: Dict[str, Motion] = {
    "still": Motion(lambda now: State(), REST_S + 8.0), "pan30": _panned(30.0), "pan90": _panned(90.0),
    "turn": _turned(), "shake": Motion(_shaken, REST_S + 8.0)}


BASE, HEAD, ROOM = "base_link", "head", "odom"
STACK = ("ros4hri", "ros4hri.launch", "voices:=false", "overlay:=false", "reference_frame:=" + ROOM,
         "up_frame:=" + BASE, "robot_frame:=" + HEAD)
STACK_MOTIONS, STACK_LATE_S = ("pan30", "pan90", "turn", "shake"), 0.05
"""How the whole stack is started, in which motions it is judged, and how late (s) transforms come then."""


class View:
    """What the camera sees of a picture (H, W, 3) that fills its image while it stands at the start."""

    def __init__(self, picture: np.ndarray) -> None:
        self._picture = picture
        self.camera = CameraModel.from_fov(picture.shape[1], picture.shape[0], HFOV)
        self._start = camera_in_odom(State())

    def homography(self, state: State) -> np.ndarray:
        """Return the homography (3, 3) from the picture to the image."""
        moved = camera_in_odom(state).inverse().compose(self._start)
        plane = moved.rotation + np.outer(moved.translation, [0.0, 0.0, 1.0 / PLANE_M])
        return np.asarray(self.camera.matrix @ plane @ np.linalg.inv(self.camera.matrix))

    def image(self, motion: Motion, now: float) -> np.ndarray:
        """Return the image of a time (s) after the start."""
        size = self._picture.shape[1::-1]
        middle = np.array([[[size[0] / 2.0, size[1] / 2.0]]])
        ends = [cv2.perspectiveTransform(middle, self.homography(motion.state(now + part * EXPOSURE_S)))
                for part in (-0.5, 0.5)]
        count = _BLUR_STEPS if np.linalg.norm(ends[1] - ends[0]) > _BLUR_PX else 1
        parts = np.linspace(-0.5, 0.5, count) if count > 1 else [0.0]
        views = [cv2.warpPerspective(self._picture, self.homography(motion.state(now + part * EXPOSURE_S)), size,
                                     flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=_BORDER)
                 for part in parts]
        return views[0] if count == 1 else np.mean(views, axis=0).astype(np.uint8)


class Sight(NamedTuple):
    """A face in an image: time (s after the start), id, place (3,) m in the room, whether it nods or shakes."""

    at: float
    id: str
    place: np.ndarray
    nods: bool


def sights(picture: np.ndarray, motion: Motion) -> List[Sight]:
    """Return all faces that are found in the images of a motion."""
    from hri_pipeline.core.faces.action_units import HEAD_NOD, HEAD_SHAKE
    from hri_pipeline.core.faces.parameters import FACES
    from hri_pipeline.core.faces.pipeline import FacePipeline
    # As on a machine that is fast enough: with a limit of time, answers would hang on the load.
    faces, view = FacePipeline(FACES.resolve({"face_mesh_rate": 0.0, "face_budget": 1000.0, "recognition": False,
                                              "expression": False, "age_gender": False})), View(picture)
    found = []
    for now in np.arange(0.0, motion.seconds, 1.0 / RATE_HZ):
        camera = camera_in_odom(motion.state(now))
        for face in faces.update(view.image(motion, now), view.camera, 1000.0 + now):
            units = face.action_units
            if face.pose is not None:
                found.append(Sight(now, face.id, camera.apply(face.pose.translation[None])[0], units is not None
                                   and max(units.intensity[HEAD_NOD], units.intensity[HEAD_SHAKE]) > 0.0))
    return found


def judged(found: Sequence[Sight], motion: Motion) -> Dict[str, object]:
    """Return of people who stand still: share of the time for which they are found while in view, how far they are
    aside (m, 95 % within), and in how many images one nods."""
    by_id: Dict[str, List[np.ndarray]] = defaultdict(list)
    for sight in found:
        if REST_S - LEARN_S <= sight.at < REST_S:
            by_id[sight.id].append(sight.place)
    people = [np.median(places, axis=0) for places in by_id.values()]
    aside, nods = [], 0
    visible = [(now, number) for now in np.arange(REST_S, motion.seconds, 1.0 / RATE_HZ)
               for number, place in enumerate(people) if is_inside(place, motion, now)]
    there = set()
    for sight in found:
        if sight.at < REST_S or not people:
            continue
        camera = camera_in_odom(motion.state(sight.at)).translation
        across = [_across(sight.place - camera, place - camera) for place in people]
        aside.append(min(across))
        nods += sight.nods
        there.add((round(sight.at * RATE_HZ), int(np.argmin(across))))
    seen = sum((round(now * RATE_HZ), number) in there for now, number in visible)
    return {"people": len(people), "seen": round(seen / max(len(visible), 1), 3), "nods": nods,
            "aside_m": round(float(np.percentile(aside, 95)), 3) if aside else None}


def _across(seen: np.ndarray, truth: np.ndarray) -> float:
    """How far (m) a place is from the ray to another one."""
    return float(np.linalg.norm(np.cross(seen, truth)) / np.linalg.norm(truth))


def is_inside(place: np.ndarray, motion: Motion, now: float) -> bool:
    """Tell whether a place has been well inside the image for a while."""
    for at in (now - ENTERED_S, now):
        x, _, z = camera_in_odom(motion.state(at)).inverse().apply(place[None])[0]
        if z <= 0.0 or abs(math.atan2(x, z)) > HFOV / 2.0 - EDGE:
            return False
    return True


def moving_figures() -> Mapping[str, object]:
    """The figures of `scripts/benchmark robot --only moving`: the worst of all motions."""
    from benchmarks.scenes import make_scene
    from hri_pipeline.core.onnx import models_directory
    picture = make_scene(3, models_directory() / "demo")
    each = {name: judged(sights(picture, motion), motion) for name, motion in MOTIONS.items()}
    return {"moving_seen": min(float(one["seen"]) for one in each.values()),  # type: ignore[arg-type]
            "moving_aside_m": max(float(one["aside_m"]) for one in each.values()),  # type: ignore[arg-type]
            "moving_nods": sum(int(one["nods"]) for one in each.values()),  # type: ignore[call-overload]
            "moving": each}


def judged_stack(story: Mapping[str, Sequence], motion_name: str) -> Dict[str, object]:
    """Return how people who stand still fare in a motion: how many were there before it, the share of these who are
    tracked under the same id while in view, ids that came besides, and the error of places (m, 95 % within)."""
    motion = MOTIONS[motion_name]
    by_id: Dict[str, List[np.ndarray]] = defaultdict(list)
    told = [(at, person, np.array(place)) for at, person, place in story["places"]]
    for at, person, place in told:
        if 0.0 <= at < REST_S:
            by_id[person].append(place)
    people = {person: np.median(places, axis=0) for person, places in by_id.items() if len(places) >= RATE_HZ}
    errors = [float(np.linalg.norm(place - people[person])) for at, person, place in told
              if at >= REST_S and person in people and is_inside(people[person], motion, at)]
    seen = [person in ids for at, ids in _sampled(story["tracked"], motion.seconds)
            for person, place in people.items() if is_inside(place, motion, at)]
    others = {person for at, ids in story["tracked"] if at >= REST_S for person in ids} - set(people)
    return {"people": len(people), "kept": round(float(np.mean(seen)), 3) if seen else 0.0, "others": len(others),
            "error_m": round(float(np.percentile(errors, 95)), 3) if errors else None}


def _sampled(tracked: Sequence[Tuple[float, Sequence[str]]], seconds: float) -> List[Tuple[float, Sequence[str]]]:
    """Return who was tracked at each time at which an image was taken, from the end of the rest on."""
    times, sampled = [at for at, _ in tracked], []
    for at in np.arange(REST_S, seconds, 1.0 / RATE_HZ):
        latest = int(np.searchsorted(times, at, side="right")) - 1
        sampled.append((float(at), tracked[latest][1] if latest >= 0 else ()))
    return sampled


def stack_figures() -> Dict[str, object]:
    """The figures of `scripts/benchmark robot --only moving_stack`: the worst of its motions."""
    from benchmarks.stack_run import measure_alone
    stories = {name: measure_alone("moving_stack", "moving_stack", name, STACK_LATE_S, patience=240.0, launch=STACK)
               for name in STACK_MOTIONS}
    each = {name: judged_stack(story, name) for name, story in stories.items()}
    errors = [one["error_m"] for one in each.values() if isinstance(one["error_m"], float)]
    return {"moving_stack_kept": min(float(one["kept"]) for one in each.values()),  # type: ignore[arg-type]
            "moving_stack_others": max(int(one["others"]) for one in each.values()),  # type: ignore[call-overload]
            "moving_stack_error_m": max(errors) if len(errors) == len(each) else None,
            "moving_stack": each}
