"""How simulated people move and behave: legs, trunk, head, eyes, eye closure, whom they look at, who speaks in a
group; and what their faces and bodies are in the image: landmarks, key points, boxes. No picture is made."""

from __future__ import annotations

import math
import random
from typing import Dict, Iterable, List, Optional, Sequence, Tuple

import numpy as np

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.simulation.scene import AWAY, ROBOT, Behaviour, Goal, PersonScript, Point


class Alternation:
    """On for `share` of the time, `length` s on average each time; both times are exponential, the first is off."""

    def __init__(self, share: float, length: float, rng: random.Random, least: float = 0.0) -> None:
        """share: 0 to below 1. least: shortest time (s) in one state."""
        if not 0.0 <= share < 1.0 or not length > 0.0:
            raise ValueError("share is {} and length {} s; legal: 0 to below 1, above 0 s".format(share, length))
        self._share, self._length, self._rng, self._least = share, length, rng, least
        self._on = False
        self._until = -1.0

    def update(self, now: float) -> bool:
        """Tell whether it is on at `now` (s); times do not go back."""
        if self._share <= 0.0:
            return False
        while now >= self._until:
            first = self._until < 0.0
            # The first time is off or on as it would be later, so that the share holds from the begin.
            self._on = self._rng.random() < self._share if first else not self._on
            mean = self._length if self._on else self._length * (1.0 - self._share) / self._share
            self._until = (now if first else self._until) + max(self._least, self._rng.expovariate(1.0 / mean))
        return self._on


class Noise:
    """Gaussian noise of standard deviation 1 on several axes: a part that is white and one that remembers.

    share: of the variance that is correlated over `time` s (Ornstein-Uhlenbeck process), 0 to 1.
    """

    def __init__(self, axes: int, share: float, time: float, rng: random.Random) -> None:
        self._share, self._time, self._rng = share, time, rng
        self._slow: List[float] = [rng.gauss(0.0, 1.0) for _ in range(axes)]
        self._last = 0.0

    def update(self, now: float) -> Sequence[float]:
        """Return the noise at `now` (s)."""
        keep = math.exp(-max(0.0, now - self._last) / self._time) if self._time > 0.0 else 0.0
        fresh, self._last = math.sqrt(1.0 - keep * keep), now
        self._slow = [keep * value + fresh * self._rng.gauss(0.0, 1.0) for value in self._slow]
        white, slow = math.sqrt(1.0 - self._share), math.sqrt(self._share)
        return [slow * value + white * self._rng.gauss(0.0, 1.0) for value in self._slow]


Walker = Tuple[float, float, float, float]

EYE_HEIGHT = 0.934
"""Height of the eyes in statures (ANSUR II, Gordon et al., NATICK/TR-15/007, 2014)."""
FACE_AHEAD = 0.09
"""Distance (m) of the sellion from the axis about which the head turns."""
ACCELERATION = 1.2
"""Largest change of the velocity, m/s^2: ordinary starts and stops of walking stay below."""
EVASION = 4.0
"""The same for who is about to run into somebody, m/s^2."""
TURN_RATE, TURN_TIME = 2.6, 0.25
"""Trunk: highest rate (rad/s) and time constant (s)."""
HEAD_RATE, HEAD_TIME = 4.0, 0.12
EYES_RATE, EYES_TIME = 9.0, 0.03
NECK, NECK_PITCH = math.radians(70.0), math.radians(40.0)
"""How far the head turns on the trunk, and up or down."""
EYES_AWAY = math.radians(40.0)
"""How far the eyes turn in the head (Stahl, Exp. Brain Res. 126, 1999: people turn the head before)."""
REACHED = 0.06
_PASSED = 0.4
_APART = 0.65
"""Distance (m) at which people pass each other."""
_CLOSE = 0.55
_FORESIGHT = 2.5
"""How far ahead (s) a walker sees that somebody will be in the way."""


class Agent:
    """Place, velocity and directions of one person; positions m, angles rad, in the frame `map`."""

    def __init__(self, script: PersonScript, goals: Sequence[Goal]) -> None:
        self.script = script
        self.x, self.y = script.origin
        self.vx = self.vy = 0.0
        self.yaw = self.head_yaw = self.gaze_yaw = script.yaw
        self.head_pitch = self.gaze_pitch = 0.0
        self.goals = goals
        self.goal: Optional[Goal] = None
        self.number = 0
        self.arrived = True
        self._evading = False

    @property
    def eyes(self) -> Tuple[float, float, float]:
        """Middle of the eyes, which is the sellion, m."""
        return (self.x + FACE_AHEAD * math.cos(self.head_yaw), self.y + FACE_AHEAD * math.sin(self.head_yaw),
                EYE_HEIGHT * self.script.stature)

    @property
    def is_walking(self) -> bool:
        """Tell whether the person goes somewhere."""
        return math.hypot(self.vx, self.vy) > 0.15

    def choose_goal(self, now: float) -> None:
        """Take the next goal when its time has come, or when the present one is reached and the next has no time."""
        while self.number < len(self.goals):
            following = self.goals[self.number]
            if following.start is None and not (self.arrived or self._passes()):
                return
            if following.start is not None and following.start > now:
                return
            self.goal, self.arrived = following, False
            self.number += 1

    def _passes(self) -> bool:
        goal = self.goal
        return goal is not None and goal.yaw is None and math.hypot(goal.position[0] - self.x,
                                                                    goal.position[1] - self.y) < _PASSED

    def walk(self, step: float, others: Sequence[Walker]) -> None:
        """Move for `step` s towards the goal, and keep away from others who stand or come in the way.

        others: (x, y, vx, vy) of each.
        """
        wanted_x = wanted_y = 0.0
        self._evading = False
        if self.goal is not None and not self.arrived:
            dx, dy = self.goal.position[0] - self.x, self.goal.position[1] - self.y
            distance = math.hypot(dx, dy)
            if distance < REACHED and math.hypot(self.vx, self.vy) < 0.3:
                self.arrived = True
            else:
                # Half the possible braking, so that the rest is left for whoever steps in the way.
                speed = min(self.goal.speed, math.sqrt(ACCELERATION * distance), 2.0 * distance)
                wanted_x, wanted_y = speed * dx / max(distance, 1e-6), speed * dy / max(distance, 1e-6)
                wanted_x, wanted_y = self._around(wanted_x, wanted_y, speed * min(1.0, distance), others)
        change_x, change_y = wanted_x - self.vx, wanted_y - self.vy
        share = min(1.0, (EVASION if self._evading
                          else ACCELERATION) * step / max(math.hypot(change_x, change_y), 1e-9))
        self.vx += share * change_x
        self.vy += share * change_y
        self.x += self.vx * step
        self.y += self.vy * step

    def _around(self, wanted_x: float, wanted_y: float, speed: float, others: Sequence[Walker]) -> Point:
        """Turn the wanted velocity aside from those whom it would meet within _FORESIGHT."""
        aside_x = aside_y = 0.0
        for x, y, vx, vy in others:
            dx, dy = x - self.x, y - self.y
            square = dx * dx + dy * dy
            if square > 16.0:
                continue
            if square < _CLOSE * _CLOSE and dx * wanted_x + dy * wanted_y > 0.0:
                # Too late to pass: past each other on the right, as far from each other as it goes.
                distance = math.sqrt(square) + 1e-9
                self._evading = True
                aside_x -= 1.5 * speed * (dx - 0.7 * dy) / distance
                aside_y -= 1.5 * speed * (dy + 0.7 * dx) / distance
                continue
            ux, uy = wanted_x - vx, wanted_y - vy
            square = ux * ux + uy * uy
            when = (dx * ux + dy * uy) / square if square > 1e-6 else -1.0
            if not 0.0 < when < _FORESIGHT:
                continue
            mx, my = dx - ux * when, dy - uy * when
            miss = math.hypot(mx, my)
            if miss < _APART:
                if miss < 0.1:      # head on: everybody to the right
                    mx, my, miss = -wanted_y, wanted_x, math.hypot(wanted_x, wanted_y) + 1e-9
                push = 1.5 * speed * (1.0 - min(miss, _APART) / _APART + 0.2) * (1.0 - when / _FORESIGHT) / miss
                aside_x -= push * mx
                aside_y -= push * my
        length = math.hypot(aside_x, aside_y)
        if length > 1.2 * speed:
            aside_x, aside_y = aside_x * 1.2 * speed / length, aside_y * 1.2 * speed / length
        return wanted_x + aside_x, wanted_y + aside_y

    def turn(self, step: float, heading: Optional[float], aim: Optional[Tuple[float, float]],
             head_share: float) -> None:
        """Turn trunk, head and eyes for `step` s.

        heading: of the trunk, None: as it is. aim: yaw and pitch of what the person wants to see, None: straight ahead.
        """
        if aim is not None and heading is not None and not self.is_walking:
            # What is further aside than the neck turns comfortably takes the trunk along.
            aside = wrapped(aim[0] - heading)
            heading += math.copysign(max(0.0, abs(aside) - 0.7 * NECK), aside)
        if heading is not None:
            self.yaw = _towards(self.yaw, heading, TURN_RATE, TURN_TIME, step)
        yaw, pitch = aim if aim is not None else (self.yaw, 0.0)
        turned = _limited(head_share * wrapped(yaw - self.yaw), NECK)
        self.head_yaw = _towards(self.head_yaw, self.yaw + turned, HEAD_RATE, HEAD_TIME, step)
        self.head_pitch = _towards(self.head_pitch, _limited(head_share * pitch, NECK_PITCH), HEAD_RATE, HEAD_TIME,
                                   step)
        yaw = self.head_yaw + _limited(wrapped(yaw - self.head_yaw), EYES_AWAY)
        self.gaze_yaw = _towards(self.gaze_yaw, yaw, EYES_RATE, EYES_TIME, step)
        pitch = self.head_pitch + _limited(pitch - self.head_pitch, EYES_AWAY)
        self.gaze_pitch = _towards(self.gaze_pitch, pitch, EYES_RATE, EYES_TIME, step)

    def state(self) -> np.ndarray:
        """(11,) x, y, vx, vy, trunk, head yaw and pitch, gaze yaw and pitch, walking, arrived: to interpolate between
        steps."""
        return np.array([self.x, self.y, self.vx, self.vy, self.yaw, self.head_yaw, self.head_pitch, self.gaze_yaw,
                         self.gaze_pitch, float(self.is_walking), float(self.arrived)])


def direction(yaw: float, pitch: float) -> Tuple[float, float, float]:
    """Unit vector of a yaw and an elevation, rad."""
    return math.cos(pitch) * math.cos(yaw), math.cos(pitch) * math.sin(yaw), math.sin(pitch)


def angles_to(source: Sequence[float], target: Sequence[float]) -> Tuple[float, float]:
    """Yaw and elevation, rad, from one point (3,) to another, m."""
    dx, dy, dz = target[0] - source[0], target[1] - source[1], target[2] - source[2]
    return math.atan2(dy, dx), math.atan2(dz, math.hypot(dx, dy))


def between(a: Tuple[float, float], b: Tuple[float, float]) -> float:
    """Angle, rad, between two directions given by yaw and elevation."""
    u, v = direction(*a), direction(*b)
    return math.acos(max(-1.0, min(1.0, u[0] * v[0] + u[1] * v[1] + u[2] * v[2])))


def wrapped(angle: float) -> float:
    """The same angle from -pi to pi."""
    return math.atan2(math.sin(angle), math.cos(angle))


def head_rotation(yaw: float, pitch: float) -> np.ndarray:
    """(3, 3) axes of a head: x out of the face, y to its left, z to the scalp."""
    cy, sy, cp, sp = math.cos(yaw), math.sin(yaw), math.cos(pitch), math.sin(pitch)
    return np.array([[cy * cp, -sy, -cy * sp], [sy * cp, cy, -sy * sp], [sp, 0.0, cp]])


def _towards(value: float, wanted: float, rate: float, time: float, step: float) -> float:
    """First-order approach with a highest rate; angles are not wrapped, so that they stay continuous."""
    error = wrapped(wanted - value)
    return value + _limited(error * (1.0 - math.exp(-step / time)), rate * step)


def _limited(value: float, most: float) -> float:
    return max(-most, min(most, value))


SPEAKER_SHARE = 0.6
"""Part of the looks at the group that go to who speaks: listeners look at the speaker for 62 % of the time in groups
(Vertegaal et al., CHI 2001)."""
_LEAST_LOOK = 0.8
CLEAR_ANGLE = 0.35
"""Angle (rad) from all heads at which somebody looks away."""
_AWAY_YAWS = (-1.2, -0.9, -0.6, 0.6, 0.9, 1.2)
_AWAY_PITCHES = (-0.25, -0.5)


class Looks:
    """Whom one person looks at unasked; one choice lasts for a while."""

    def __init__(self, habits: Behaviour, rng: random.Random) -> None:
        self._habits, self._rng = habits, rng
        self._until = 0.0
        self._company: Tuple[str, ...] = ()
        self.choice: Optional[str] = None

    def update(self, now: float, company: Sequence[str], speaker: Optional[str], sees_robot: bool) -> Optional[str]:
        """Return an id, AWAY, or None for straight ahead.

        company: the others in the group; speaker: who of all speaks; sees_robot: whether the robot may be looked at.
        """
        habits = self._habits
        if habits.dwell <= 0.0:
            self.choice = None
            return None
        if now < self._until and tuple(company) == self._company:
            return self.choice
        self._company = tuple(company)
        self._until = now + max(_LEAST_LOOK, self._rng.expovariate(1.0 / habits.dwell))
        draw = self._rng.random()
        if draw < habits.look_away:
            self.choice = AWAY
        elif draw < habits.look_away + habits.look_robot:
            self.choice = ROBOT if sees_robot else AWAY
        elif not company:
            self.choice = AWAY
        elif speaker in company and self._rng.random() < SPEAKER_SHARE:
            self.choice = speaker
        else:
            self.choice = self._rng.choice(list(company))
        return self.choice


def eye_closure(habits: Behaviour, rng: random.Random) -> Alternation:
    """When one person's eyes are closed unasked."""
    return Alternation(habits.closed, habits.closed_length, rng, least=0.2)


class Conversation:
    """Who speaks in one group: turns of one speaker each, and silence in between."""

    def __init__(self, habits: Behaviour, rng: random.Random) -> None:
        self._habits, self._rng = habits, rng
        self._speaker: Optional[str] = None
        self._until = 0.0

    def update(self, now: float, members: Iterable[str]) -> Optional[str]:
        """Return the id of the member who speaks, None while nobody does."""
        present = sorted(member for member in members if member != ROBOT)
        if self._habits.turn <= 0.0 or len(present) < 2:
            self._speaker = None
            return None
        if now >= self._until:
            silent = self._speaker is None
            others = [member for member in present if member != self._last]
            self._speaker = self._rng.choice(others) if silent and others else None
            self._last = self._speaker if self._speaker is not None else self._last
            mean = self._habits.turn if self._speaker is not None else self._habits.pause
            self._until = now + self._rng.expovariate(1.0 / mean) if mean > 0.0 else now
        return self._speaker if self._speaker in present else None

    _last: Optional[str] = None


class Away:
    """A direction in which nobody's head is, kept until a head comes near to it."""

    def __init__(self, rng: random.Random) -> None:
        self._rng = rng
        self._direction: Optional[Tuple[float, float]] = None

    def update(self, yaw: float, heads: Dict[str, Tuple[float, float]]) -> Tuple[float, float]:
        """Return yaw and elevation, rad. yaw: of the trunk; heads: directions of all heads and of the robot's."""
        kept = self._direction
        if kept is None or abs(wrapped(kept[0] - yaw)) > 1.4 or self._clearance(kept, heads) < CLEAR_ANGLE:
            options = [(yaw + turn, pitch) for turn in _AWAY_YAWS for pitch in _AWAY_PITCHES]
            self._rng.shuffle(options)
            clear = [option for option in options if self._clearance(option, heads) > 1.5 * CLEAR_ANGLE]
            self._direction = kept = (clear or [max(options, key=lambda option: self._clearance(option, heads))])[0]
        return kept

    def drop(self) -> None:
        """Look elsewhere next time."""
        self._direction = None

    @staticmethod
    def _clearance(option: Tuple[float, float], heads: Dict[str, Tuple[float, float]]) -> float:
        return min((between(option, head) for head in heads.values()), default=3.0)


HIP_HEIGHT = 0.521
"""Height of the hip joints in statures, and the lengths below: joint centres of the mean of ANSUR II (Gordon et al.,
NATICK/TR-15/007, 2014) and of de Leva (J. Biomechanics 29, 1996)."""
_TRUNK, _HALF_SHOULDERS, _HALF_HIPS, _UPPER_ARM, _FOREARM, _THIGH, _SHANK = (
    0.278,
    0.105,
    0.052,
    0.163,
    0.154,
    0.240,
    0.241,
)
_EYES_CENTRE = -0.013   # x of the eyes in the face frame, m
_HEAD_AXIS = -0.08      # x of the axis about which a head is roughly a cylinder, m


def _template() -> np.ndarray:
    """(70, 3) m in the face frame (x out, y to the subject's left, z up, origin at the sellion), a relaxed adult
    face."""
    points: List[Tuple[float, float, float]] = []
    for index in range(17):
        turn = math.pi * index / 16.0
        points.append((-0.09 + 0.075 * math.sin(turn), -0.072 * math.cos(turn), -0.01 - 0.105 * math.sin(turn)))
    brow = [(-0.022, 0.058, 0.014), (-0.012, 0.048, 0.021), (-0.007, 0.037, 0.024), (-0.004, 0.026, 0.022),
            (-0.002, 0.015, 0.018)]
    points += [(x, -y, z) for x, y, z in brow] + brow[::-1]
    points += [(0.0, 0.0, 0.0), (0.006, 0.0, -0.015), (0.013, 0.0, -0.030), (0.020, 0.0, -0.045)]
    points += (
        [(0.005, y, -0.052) for y in (-0.016, -0.008)]
        + [(0.010, 0.0, -0.055)]
        + [(0.005, y, -0.052) for y in (0.008, 0.016)]
    )
    eye = [(0.047, 0.0), (0.038, 1.0), (0.027, 1.0), (0.018, 0.0), (0.027, -1.0), (0.038, -1.0)]
    points += [(_EYES_CENTRE, -y, 0.0055 * z) for y, z in eye]
    points += [(_EYES_CENTRE, eye[index][0], 0.0055 * eye[index][1]) for index in (3, 2, 1, 0, 5, 4)]
    for half, tall, count in ((0.026, 0.009, 6), (0.021, 0.003, 4)):
        for index in range(2 * count):
            turn = math.pi * index / count
            points.append((0.004, -half * math.cos(turn), -0.075 + tall * math.sin(turn)))
    return np.array(points + [(_EYES_CENTRE, -0.0325, 0.0), (_EYES_CENTRE, 0.0325, 0.0)])


FACE = _template()
FACE.setflags(write=False)
_EYE_LIDS = [37, 38, 40, 41, 43, 44, 46, 47]
_LOWER_LIP = [55, 56, 57, 58, 59, 65, 66, 67, 7, 8, 9]
_NORMALS = (FACE - np.array([_HEAD_AXIS, 0.0, 0.0])) * np.array([1.0, 1.0, 0.0])
_NORMALS = _NORMALS / np.linalg.norm(_NORMALS, axis=1, keepdims=True)


def landmarks(face: Pose, camera: CameraModel, eyes_closed: float = 0.0, mouth: float = 0.0) -> np.ndarray:
    """Return (70, 3) x px, y px, confidence of a face; a point that is behind the head or outside the image has little
    or none.

    face: face frame in the optical frame. eyes_closed, mouth: how far lids are closed and the jaw has dropped, 0 to 1.
    """
    points = FACE.copy()
    points[_EYE_LIDS, 2] *= 1.0 - 0.9 * eyes_closed
    points[_LOWER_LIP, 2] -= 0.012 * mouth
    placed = face.apply(points)
    towards = -placed / np.maximum(np.linalg.norm(placed, axis=1, keepdims=True), 1e-9)
    facing = ((_NORMALS @ face.rotation.T) * towards).sum(axis=1)
    return _seen(camera.project(placed), np.clip((facing + 0.2) / 0.4, 0.05, 1.0), camera)


def keypoints(body: Pose, head: Pose, stature: float, camera: CameraModel) -> np.ndarray:
    """Return (18, 3) x px, y px, confidence of somebody who stands upright, in the order of hri_msgs/Skeleton2D.

    body, head: body and face frame in the optical frame. stature: m.
    """
    placed = body.apply(stature * _standing())
    face = head.apply(np.array([(0.020, 0.0, -0.045), (-0.013, 0.0325, 0.0), (-0.013, -0.0325, 0.0),
                                (-0.10, 0.072, -0.01),
                                (-0.10, -0.072, -0.01)]))
    points = np.vstack([face[:1], placed, face[1:]])
    confidence = np.full(len(points), 0.9)
    away = float(head.rotation[:, 0] @ head.translation) > 0.0
    confidence[[0, 14, 15]] = 0.1 if away else 0.9
    return _seen(camera.project(points), confidence, camera)


def box(points: np.ndarray, margin: float) -> np.ndarray:
    """Return x0, y0, x1, y1 px around the points (N, 3) that are known, wider by `margin` of its size on each side;
    zeros without any."""
    known = points[np.isfinite(points[:, :2]).all(axis=1), :2]
    if not len(known):
        return np.zeros(4)
    low, high = known.min(axis=0), known.max(axis=0)
    return np.concatenate([low - margin * (high - low), high + margin * (high - low)])


def _standing() -> np.ndarray:
    """(13, 3) neck, right arm, left arm, right leg, left leg in statures, in the body frame (origin between the
    hips)."""
    def arm(side: float) -> List[Tuple[float, float, float]]:
        shoulder = side * _HALF_SHOULDERS
        return [(0.0, shoulder, _TRUNK), (0.01, 1.15 * shoulder, _TRUNK - _UPPER_ARM),
                (0.04, 1.15 * shoulder, _TRUNK - _UPPER_ARM - _FOREARM)]

    def leg(side: float) -> List[Tuple[float, float, float]]:
        hip = side * _HALF_HIPS
        return [(0.0, hip, 0.0), (0.0, hip, -_THIGH), (-0.01, hip, -_THIGH - _SHANK)]
    return np.array([(0.0, 0.0, _TRUNK), *arm(-1.0), *arm(1.0), *leg(-1.0), *leg(1.0)])


def _seen(pixels: np.ndarray, confidence: np.ndarray, camera: CameraModel) -> np.ndarray:
    inside = (
        (pixels[:, 0] >= 0.0) & (pixels[:, 1] >= 0.0) & (pixels[:, 0] < camera.width) & (pixels[:, 1] < camera.height)
    )
    return np.column_stack([pixels, np.where(inside, confidence, 0.0)])
