"""The truth of a scene: motion, looks, groups; the same every time."""

import math

import numpy as np
import pytest

from hri_pipeline.core.simulation.scene import ROBOT
from hri_pipeline.core.simulation.scene_file import parse_scene
from hri_pipeline.core.simulation.world import World

STILL = {"look_robot": 0.0, "look_away": 0.0, "dwell": 0.0, "turn": 0.0}


def two(**changes):
    data = {"duration": 20.0, "habits": STILL, "people": [
        {"name": "ann", "at": [2.0, -0.5], "yaw": 90.0}, {"name": "bob", "at": [2.0, 0.5], "yaw": -90.0}]}
    data.update(changes)
    return parse_scene(data)


def crowded(duration=60.0):
    return parse_scene({"duration": duration, "seed": 3, "habits": {"closed": 0.1},
                        "crowd": {"people": 10, "meet": 15.0, "stay": 40.0}})


def by_name(truth):
    return {person.id: person for person in truth.people}


def text(truth):
    return repr([(p.id, p.position.tolist(), p.head.tolist(), p.gaze.tolist(), p.target, p.group, p.speaking,
                  p.eyes_closed)
                 for p in truth.people])


def test_times_that_are_none():
    world = World(two())
    for time in (-0.1, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="0 and more"):
            world.at(time)


def test_the_same_whenever_it_is_asked_for():
    scene = crowded(12.0)
    times = [0.0, 0.31, 7.0, 7.01, 11.333]
    once = [text(World(scene, 5).at(time)) for time in times]
    world = World(scene, 5)
    assert [text(world.at(time)) for time in times] == once
    assert [text(world.at(time)) for time in reversed(times)] == once[::-1]
    assert [text(World(scene, 6).at(time)) for time in times[3:]] != once[3:]


def test_nobody_jumps_or_starts_at_once():
    world = World(crowded(30.0))
    before = {}
    step = 1.0 / 30.0
    for number in range(int(30.0 / step)):
        now = by_name(world.at(number * step))
        for name, person in now.items():
            if name in before:
                last = before[name]
                assert np.linalg.norm(person.position - last.position) <= 2.6 * step
                assert np.linalg.norm(person.velocity - last.velocity) <= 4.1 * step + 1e-9
                turn = math.acos(min(1.0, float(person.head_rotation[:, 0] @ last.head_rotation[:, 0])))
                assert turn <= 1.5 * (4.0 + 2.6) * step + 1e-6
        before = now


def test_way_points_are_reached_in_time():
    scene = parse_scene({"duration": 20.0, "habits": STILL, "people": [
        {"name": "ann", "at": [2.0, 0.0],
         "path": [{"to": [2.0, 3.0], "speed": 1.0}, {"to": [4.0, 3.0], "speed": 1.0, "yaw": 180.0}]}]})
    world = World(scene)
    assert by_name(world.at(2.0))["ann"].velocity[1] == pytest.approx(1.0, abs=0.05)
    end = by_name(world.at(12.0))["ann"]
    assert end.position == pytest.approx([4.0, 3.0], abs=0.1)
    assert np.linalg.norm(end.velocity) < 0.05
    assert math.cos(end.yaw) < -0.99


def test_two_who_meet_head_on_pass_each_other():
    scene = parse_scene({"duration": 12.0, "habits": STILL, "people": [
        {"name": "ann", "at": [1.0, 0.0], "path": [{"to": [7.0, 0.0]}]},
        {"name": "bob", "at": [7.0, 0.0], "path": [{"to": [1.0, 0.0]}]}]})
    world = World(scene)
    apart = []
    for number in range(240):
        people = by_name(world.at(0.05 * number))
        apart.append(float(np.linalg.norm(people["ann"].position - people["bob"].position)))
    assert min(apart) > 0.35
    assert by_name(world.at(12.0))["ann"].position == pytest.approx([7.0, 0.0], abs=0.15)


def test_an_ordered_look_reaches_its_target_and_ends():
    scene = two(people=[
        {"name": "ann", "at": [2.0, -0.5], "yaw": 90.0,
         "orders": [{"at": 2.0, "look_at": "bob", "for": 3.0}, {"at": 6.0, "look_at": "robot", "for": 3.0}]},
        {"name": "bob", "at": [2.5, 0.9], "yaw": -90.0}])
    world = World(scene)
    assert by_name(world.at(1.5))["ann"].aim is None
    ann, bob = (by_name(world.at(3.5))[name] for name in ("ann", "bob"))
    assert ann.target == "bob"
    towards = (bob.head - ann.head) / np.linalg.norm(bob.head - ann.head)
    assert float(towards @ ann.gaze) > math.cos(math.radians(5.0))
    assert by_name(world.at(8.0))["ann"].target == ROBOT
    assert by_name(world.at(12.0))["ann"].target is None


def test_the_eyes_are_there_before_the_head():
    scene = two(people=[{"name": "ann", "at": [2.0, -0.5], "yaw": 90.0,
                         "orders": [{"at": 1.0, "look_at": "robot", "for": 9.0}]}])
    world = World(scene)
    looked = [time for time in np.arange(1.0, 3.0, 0.05) if by_name(world.at(float(time)))["ann"].target == ROBOT]
    assert 1.1 < looked[0] < 2.0
    first = by_name(world.at(looked[0]))["ann"]
    assert float(first.gaze @ first.head_rotation[:, 0]) < 1.0 - 1e-4


def test_closed_eyes_look_at_nobody():
    scene = two(people=[{"name": "ann", "at": [2.0, 0.0], "yaw": 180.0, "orders": [
        {"look_at": "robot"}, {"at": 5.0, "close_eyes": 2.0}]}])
    world = World(scene)
    assert by_name(world.at(4.9))["ann"].target == ROBOT
    closed = by_name(world.at(6.0))["ann"]
    assert closed.eyes_closed and closed.target is None and closed.aim == ROBOT
    assert by_name(world.at(7.5))["ann"].target == ROBOT


def test_who_looks_away_looks_at_nobody():
    scene = two(habits=dict(STILL, dwell=2.0, look_away=1.0))
    world = World(scene)
    for time in np.arange(2.0, 20.0, 0.5):
        for person in world.at(float(time)).people:
            others = [other.head for other in world.at(float(time)).people
                      if other.id != person.id] + [np.array([0.0, 0.0, 1.3])]
            for head in others:
                towards = (head - person.head) / np.linalg.norm(head - person.head)
                assert float(towards @ person.gaze) < math.cos(math.radians(9.0))


def test_habits_have_their_shares():
    scene = parse_scene({"duration": 300.0, "habits": {"look_robot": 0.3, "look_away": 0.2, "dwell": 1.5, "closed": 0.2,
                                                       "closed_length": 0.6}, "people": [
        {"name": "ann"}, {"name": "bob"}], "formations": [
        {"shape": "vis_a_vis", "centre": [2.5, 0.0], "yaw": 90.0, "members": ["ann", "bob"]}]})
    world = World(scene)
    people = [person for number in range(1500) for person in world.at(5.0 + 0.19 * number).people]
    closed = np.mean([person.eyes_closed for person in people])
    robot = np.mean([person.aim == ROBOT for person in people])
    other = np.mean([person.aim in ("ann", "bob") for person in people])
    assert closed == pytest.approx(0.2, abs=0.06)
    assert robot == pytest.approx(0.3, abs=0.08)
    assert other == pytest.approx(0.5, abs=0.1)


def test_a_group_is_there_while_its_members_stand_in_it():
    scene = two(formations=[{"shape": "circle", "centre": [4.0, 0.0], "members": ["ann", "bob"], "from": 2.0,
                             "until": 10.0}])
    world = World(scene)
    assert world.at(1.0).groups == ()
    assert by_name(world.at(3.0))["ann"].group is None
    there = world.at(8.0)
    assert [group.members for group in there.groups] == [("ann", "bob")]
    assert {person.group for person in there.people} == {there.groups[0].id}
    assert world.at(10.1).groups == ()


def test_the_robot_in_a_group():
    scene = two(formations=[{"shape": "circle", "centre": [0.7, 0.0], "size": 1.4, "members": ["ann", "robot", "bob"]}])
    assert World(scene).at(8.0).groups[0].members == (ROBOT, "ann", "bob")


def test_all_who_stand_with_the_robot_are_one_group():
    scene = two(formations=[{"shape": "vis_a_vis", "centre": [0.7, -0.5], "members": ["ann", "robot"]},
                            {"shape": "vis_a_vis", "centre": [0.7, 0.5], "members": ["bob", "robot"]}])
    truth = World(scene).at(8.0)
    assert [group.members for group in truth.groups] == [(ROBOT, "ann", "bob")]
    assert {person.group for person in truth.people} == {truth.groups[0].id}


def test_one_speaks_at_a_time_in_a_group():
    scene = two(habits=dict(STILL, turn=1.0, pause=0.2), formations=[
        {"shape": "vis_a_vis", "centre": [2.0, 0.0], "members": ["ann", "bob"]}])
    world = World(scene)
    speakers = [tuple(person.id for person in world.at(float(time)).people if person.speaking)
                for time in np.arange(1.0, 20.0, 0.1)]
    assert all(len(said) <= 1 for said in speakers)
    assert {("ann",), ("bob",)} <= set(speakers)


def test_people_come_and_go():
    scene = two(people=[{"name": "ann", "at": [2.0, 0.0], "enter": 2.0, "leave": 5.0},
                        {"name": "bob", "at": [3.0, 0.0]}])
    world = World(scene)
    assert [sorted(by_name(world.at(time))) for time in (1.0, 3.0, 6.0)] == [["bob"], ["ann", "bob"], ["bob"]]
