"""What is true in a scene at a time: who is where, looks where, speaks, and stands with whom."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass
from typing import Dict, List, Optional, Sequence, Set, Tuple

import numpy as np

from hri_pipeline.core.simulation.agents import (
    EYE_HEIGHT,
    FACE_AHEAD,
    Agent,
    Away,
    Conversation,
    Looks,
    angles_to,
    between,
    direction,
    eye_closure,
    head_rotation,
)
from hri_pipeline.core.simulation.scene import AWAY, CLOSE_EYES, FACE, LOOK_AT, ROBOT, TALK, Order, PersonScript, Scene

STEP = 0.05
"""The scene is computed every so many seconds and interpolated in between."""
ON_TARGET = math.radians(5.0)
"""A gaze this close to the middle of the eyes of its target has reached it; while it still turns there, it is on
nobody."""
AT_PLACE = 0.4
"""Distance (m) from the own place in a formation from which on somebody belongs to the group."""
_AHEAD_PITCH = -0.4     # who walks looks at the floor 4 m ahead


@dataclass(frozen=True)
class PersonTruth:
    """One person, in the frame `map`: m, m/s, rad.

    position: (2,) on the floor. yaw: of the trunk. head: (3,) sellion. head_rotation: (3, 3), its columns are x out of
    the face, y to its left, z to the scalp. gaze: (3,) unit, also while the eyes are closed. target: id of who is
    looked at, ROBOT (empty) or None: nobody, the eyes are closed, or they still turn there. aim: whom the person means
    to look at.
    """

    id: str
    position: np.ndarray
    velocity: np.ndarray
    yaw: float
    stature: float
    head: np.ndarray
    head_rotation: np.ndarray
    gaze: np.ndarray
    eyes_closed: bool
    speaking: bool
    target: Optional[str]
    aim: Optional[str]
    group: Optional[str]


@dataclass(frozen=True)
class GroupTruth:
    """People who stand together; members are sorted, the robot is the empty id."""

    id: str
    members: Tuple[str, ...]


@dataclass(frozen=True)
class SceneTruth:
    """Everything at one time. stamp: s from the begin of the scene. robot: x, y (m), yaw (rad)."""

    stamp: float
    people: Tuple[PersonTruth, ...]
    groups: Tuple[GroupTruth, ...]
    robot: Tuple[float, float, float]


class _Actor:
    """An agent with its habits and what it does at this step."""

    def __init__(self, script: PersonScript, scene: Scene, seed: str) -> None:
        self.agent = Agent(script, script.goals)
        self.looks = Looks(scene.habits, random.Random(seed + " looks"))
        self.lids = eye_closure(scene.habits, random.Random(seed + " lids"))
        self.away = Away(random.Random(seed + " away"))
        self.aim: Optional[str] = None
        self.closed = self.speaking = False
        self.before = self.now = self.agent.state()

    def orders(self, kind: str, now: float) -> Optional[Order]:
        """The order of this kind that holds now; the last one in the file goes before."""
        for order in reversed(self.agent.script.orders):
            if order.kind == kind and order.start <= now < order.end:
                return order
        return None


class World:
    """A scene that goes on. The same scene and seed give the same truth, whenever it is asked for."""

    def __init__(self, scene: Scene, seed: int = 0) -> None:
        self._scene, self._seed = scene, "{} {}".format(scene.seed, seed)
        self._robot = (*scene.robot.position, scene.robot.yaw)
        self._robot_head = (*scene.robot.position, scene.robot.height)
        self._restart()

    def at(self, t: float) -> SceneTruth:
        """Return the truth at `t` s after the begin, held at its last moment after the end. A time before the last one
        starts anew.

        Raises ValueError for a time that is negative or not finite.
        """
        if not (math.isfinite(t) and t >= 0.0):
            raise ValueError("the time in a scene is {} s, legal range 0 and more".format(t))
        t = min(t, self._scene.duration)
        steps = math.ceil(t / STEP - 1e-9)
        if steps < self._count - 1:
            self._restart()
        while self._count <= steps:
            self._advance()
        return self._truth(t, 1.0 - (steps - t / STEP))

    def _restart(self) -> None:
        self._waiting = sorted(self._scene.people, key=lambda person: person.enter, reverse=True)
        self._actors: Dict[str, _Actor] = {}
        self._talks: Dict[int, Conversation] = {}
        self._groups: Tuple[GroupTruth, ...] = ()
        self._count = 0
        self._advance()

    def _advance(self) -> None:
        """Compute one step more; `now` of every actor is then its state at (count - 1) * STEP."""
        now = self._count * STEP
        self._come_and_go(now)
        agents = [actor.agent for actor in self._actors.values()]
        for agent in agents:
            agent.choose_goal(now)
        places = [(agent.x, agent.y, agent.vx, agent.vy) for agent in agents]
        for index, actor in enumerate(self._actors.values()):
            if self._count:
                actor.agent.walk(STEP, places[:index] + places[index + 1:])
        members = self._gather(now)
        self._speak(now, members)
        company = {member: group for group in members.values() for member in group}
        speakers = [name for name, actor in self._actors.items() if actor.speaking]
        for name, actor in self._actors.items():
            self._look(now, name, actor, [other for other in company.get(name, ()) if other not in (name, ROBOT)],
                       speakers)
            actor.before, actor.now = actor.now, actor.agent.state()
        self._count += 1

    def _come_and_go(self, now: float) -> None:
        # Who stays to the end is there at its last moment too.
        ended = [name for name, actor in self._actors.items()
                 if actor.agent.script.leave <= min(now, self._scene.duration - STEP)]
        for name in ended:
            del self._actors[name]
        while self._waiting and self._waiting[-1].enter <= now:
            script = self._waiting.pop()
            if script.leave > now:
                self._actors[script.name] = _Actor(script, self._scene, "{} {}".format(self._seed, script.name))

    def _gather(self, now: float) -> Dict[int, Tuple[str, ...]]:
        """Members of each formation who are at their places; they are groups when there are two."""
        found: Dict[int, List[str]] = {}
        for name, actor in self._actors.items():
            goal = actor.agent.goal
            if goal is None or goal.formation is None:
                continue
            formation = self._scene.formations[goal.formation]
            near = math.hypot(goal.position[0] - actor.agent.x, goal.position[1] - actor.agent.y) < AT_PLACE
            if near and formation.start <= now < formation.end:
                found.setdefault(goal.formation, [ROBOT] if ROBOT in formation.members else []).append(name)
        members = {number: tuple(sorted(names)) for number, names in found.items() if len(names) > 1}
        self._groups = tuple(_one_with_robot([
            GroupTruth("group{}".format(number), names) for number, names in sorted(members.items())
            if self._scene.formations[number].is_group]))
        return members

    def _speak(self, now: float, members: Dict[int, Tuple[str, ...]]) -> None:
        self._talks = {number: talk for number, talk in self._talks.items() if number in members}
        speakers: Set[str] = set()
        for number, names in sorted(members.items()):
            talk = self._talks.get(number)
            if talk is None:
                talk = self._talks[number] = Conversation(
                    self._scene.habits, random.Random("{} talk {}".format(self._seed, number)))
            speaker = talk.update(now, names)
            if speaker is not None:
                speakers.add(speaker)
        for name, actor in self._actors.items():
            actor.speaking = actor.orders(TALK, now) is not None or name in speakers
            actor.closed = actor.orders(CLOSE_EYES, now) is not None or actor.lids.update(now)

    def _look(self, now: float, name: str, actor: _Actor, company: Sequence[str], speakers: Sequence[str]) -> None:
        agent = actor.agent
        order = actor.orders(LOOK_AT, now)
        if order is not None:
            aim: Optional[str] = order.target
        elif agent.is_walking:
            aim = None
        else:
            speaker = next((other for other in speakers if other in company), None)
            aim = actor.looks.update(now, company, speaker, self._is_before(agent, self._robot_head))
        if aim is not None and aim not in (AWAY, ROBOT) and aim not in self._actors:
            aim = None
        if aim != AWAY:
            actor.away.drop()
        actor.aim = aim
        agent.turn(STEP, self._heading(actor, now), self._aimed(name, actor, aim), self._scene.habits.head_share)

    def _heading(self, actor: _Actor, now: float) -> Optional[float]:
        agent = actor.agent
        if agent.is_walking:
            return math.atan2(agent.vy, agent.vx)
        order = actor.orders(FACE, now)
        head = self._head_of(order.target) if order is not None else None
        if head is not None:
            return math.atan2(head[1] - agent.y, head[0] - agent.x)
        if agent.goal is not None and agent.goal.yaw is not None:
            return agent.goal.yaw
        return agent.script.yaw if agent.goal is None else agent.yaw

    def _aimed(self, name: str, actor: _Actor, aim: Optional[str]) -> Optional[Tuple[float, float]]:
        """Yaw and elevation of what somebody looks at."""
        agent = actor.agent
        if aim is None:
            return (agent.yaw, _AHEAD_PITCH) if agent.is_walking else None
        if aim == AWAY:
            heads = {other: angles_to(agent.eyes, one.agent.eyes) for other,
                     one in self._actors.items() if other != name}
            heads[ROBOT] = angles_to(agent.eyes, self._robot_head)
            return actor.away.update(agent.yaw, heads)
        head = self._head_of(aim)
        return angles_to(agent.eyes, head) if head is not None else None

    def _head_of(self, name: str) -> Optional[Tuple[float, float, float]]:
        if name == ROBOT:
            return self._robot_head
        actor = self._actors.get(name)
        return actor.agent.eyes if actor is not None else None

    def _is_before(self, agent: Agent, point: Sequence[float]) -> bool:
        return between(angles_to(agent.eyes, point), (agent.yaw, 0.0)) < math.radians(100.0)

    def _truth(self, t: float, share: float) -> SceneTruth:
        states = {name: actor.before + share * (actor.now - actor.before) for name, actor in self._actors.items()}
        heads = {name: _eyes(state, self._actors[name].agent.script.stature) for name, state in states.items()}
        groups = {member: group.id for group in self._groups for member in group.members}
        people = tuple(self._person(name, states[name], heads, groups.get(name)) for name in sorted(states))
        return SceneTruth(t, people, self._groups, self._robot)

    def _person(self, name: str, state: np.ndarray, heads: Dict[str, Tuple[float, float, float]],
                group: Optional[str]) -> PersonTruth:
        actor, head = self._actors[name], heads[name]
        gaze = (float(state[7]), float(state[8]))
        aim, target = actor.aim if actor.aim != AWAY else None, None
        if aim is not None and not actor.closed:
            there = self._robot_head if aim == ROBOT else heads[aim]
            if between(gaze, angles_to(head, there)) < ON_TARGET:
                target = aim
        return PersonTruth(name, state[:2].copy(), state[2:4].copy(), float(state[4]), actor.agent.script.stature,
                           np.array(head), head_rotation(float(state[5]), float(state[6])), np.array(direction(*gaze)),
                           actor.closed, actor.speaking, target, aim, group)


def _one_with_robot(groups: Sequence[GroupTruth]) -> List[GroupTruth]:
    """The robot is in one group at most: all who stand with it stand together."""
    with_robot = [group for group in groups if ROBOT in group.members]
    if len(with_robot) < 2:
        return list(groups)
    members = tuple(sorted({member for group in with_robot for member in group.members}))
    return [GroupTruth(with_robot[0].id, members)] + [group for group in groups if ROBOT not in group.members]


def _eyes(state: np.ndarray, stature: float) -> Tuple[float, float, float]:
    yaw = float(state[5])
    return (float(state[0]) + FACE_AHEAD * math.cos(yaw), float(state[1]) + FACE_AHEAD * math.sin(yaw),
            EYE_HEIGHT * stature)
