"""Scene files: what is legal, and what the errors say."""

import math
from pathlib import Path

import pytest
import yaml

from hri_pipeline.core.simulation.scene import CIRCLE, ROBOT, SEMICIRCLE, SIDE_BY_SIDE, Formation, slots
from hri_pipeline.core.simulation.scene_file import SceneError, load_scene, parse_scene

SCENES = Path(__file__).resolve().parents[2] / "config" / "scenes"


def scene(**changes):
    data = {"duration": 10.0, "people": [{"name": "ann", "at": [2.0, 0.0]}, {"name": "bob", "at": [3.0, 1.0]}]}
    data.update(changes)
    return data


def person(**changes):
    return scene(people=[dict({"name": "ann", "at": [2.0, 0.0]}, **changes)])


@pytest.mark.parametrize("name", sorted(path.stem for path in SCENES.glob("*.yaml")))
def test_the_packaged_scenes_are_legal(name):
    loaded = load_scene(SCENES / (name + ".yaml"))
    assert loaded.name == name
    assert loaded.text.startswith("#")


def test_there_are_four_scenes():
    assert {path.stem for path in SCENES.glob("*.yaml")} == {"three_talk", "six_gaze", "approach", "crowd"}


@pytest.mark.parametrize("data, words", [
    (None, ["the file", "mapping"]),
    ([1], ["the file", "mapping"]),
    ({"people": []}, ["duration", "missing"]),
    (scene(duration=0.0), ["duration", "1 to 86400"]),
    (scene(duration=float("nan")), ["duration", "86400"]),
    (scene(duration=True), ["duration", "number"]),
    (scene(durations=1), ["durations", "did you mean duration"]),
    (scene(people=[]), ["nobody"]),
    (scene(people=[{"name": "a b", "at": [0, 0]}]), ["people[0].name", "id"]),
    (scene(people=[{"name": "robot", "at": [0, 0]}]), ["people[0].name", "robot"]),
    (scene(people=[{"name": "ann", "at": [0, 0]}] * 2), ["people[1].name", "nobody else"]),
    (scene(people=[{"name": "ann"}]), ["people[0].at", "missing"]),
    (person(at=[1.0]), ["people[0].at", "two numbers|2 numbers"]),
    (person(at=[1.0, "x"]), ["people[0].at", "2 numbers"]),
    (person(stature=3.0), ["people[0].stature", "0.8 to 2.3 m"]),
    (person(leave=20.0), ["people[0].leave", "0 to 10 s"]),
    (person(path=[{"to": [1, 1], "speed": 9.0}]), ["people[0].path[0].speed", "2.5 m/s"]),
    (person(path=[{"to": [90, 1], "by": 2.0}]), ["people[0].path[0].by", "2.5 m/s"]),
    (person(path=[{"too": [90, 1]}]), ["people[0].path[0].too", "did you mean to"]),
    (person(orders=[{"at": 1.0}]), ["people[0].orders[0]", "look_at"]),
    (person(orders=[{"look_at": "eve"}]), ["people[0].orders[0].look_at", "ann, robot, away"]),
    (person(orders=[{"close_eyes": -1.0}]), ["people[0].orders[0].close_eyes", "0.01"]),
    (scene(formations=[{"shape": "star", "centre": [1, 1], "members": ["ann", "bob"]}]),
     ["formations[0].shape", "vis_a_vis"]),
    (scene(formations=[{"shape": "circle", "centre": [1, 1], "members": ["ann"]}]), ["formations[0].members", "2 to"]),
    (scene(formations=[{"shape": "circle", "centre": [1, 1], "members": ["ann", "eve"]}]),
     ["formations[0].members", "bob"]),
    (scene(formations=[{"shape": "L", "centre": [1, 1], "members": ["ann", "bob", "robot"]}]),
     ["formations[0].members", "two"]),
    (scene(habits={"look_robot": 0.8, "look_away": 0.5}), ["habits.look_away", "1 together"]),
    (scene(habits={"closed": 1.0}), ["habits.closed", "0.9"]),
    (scene(crowd={"people": 40}), ["crowd.area", "40 people"]),
])
def test_errors_name_file_key_and_range(data, words):
    with pytest.raises(SceneError) as error:
        parse_scene(data, "some.yaml")
    text = str(error.value)
    assert text.startswith("some.yaml: ")
    for word in words:
        assert any(option in text for option in word.split("|")), text


@pytest.mark.parametrize("content", [b"\xff\xfe", b"a: [", b"{", b"duration: 5\n" + b"#" * 1000001],
                         ids=["encoding", "list", "mapping", "length"])
def test_damaged_files(tmp_path, content):
    path = tmp_path / "bad.yaml"
    path.write_bytes(content)
    with pytest.raises(SceneError, match="bad.yaml"):
        load_scene(path)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(SceneError, match="none.yaml.*cannot be read"):
        load_scene(tmp_path / "none.yaml")


def test_yaml_cannot_make_objects(tmp_path):
    path = tmp_path / "evil.yaml"
    path.write_text("duration: !!python/object/apply:os.getcwd []\n")
    with pytest.raises(SceneError, match="no YAML"):
        load_scene(path)


def test_way_points_by_a_time_give_the_speed():
    goals = parse_scene(person(path=[{"to": [5.0, 4.0], "by": 5.0}])).people[0].goals
    assert goals[0].speed == pytest.approx(1.0)
    assert goals[0].start == 0.0


def test_places_of_a_formation_come_in_the_order_of_time():
    data = scene(formations=[
        {"shape": "vis_a_vis", "centre": [3, 0], "members": ["ann", "bob"], "from": 6.0},
        {"shape": "circle", "centre": [5, 0], "members": ["ann", "bob"], "from": 1.0, "until": 5.0}])
    starts = [goal.start for goal in parse_scene(data).people[0].goals]
    assert starts == [1.0, 6.0]


@pytest.mark.parametrize("shape, count", [(CIRCLE, 5), (SEMICIRCLE, 4), ("vis_a_vis", 2), ("L", 2)])
def test_people_in_a_formation_face_its_centre(shape, count):
    formation = Formation("f", shape, (2.0, 1.0), 1.2, 0.3, tuple("p%d" % number for number in range(count)), 0.0, 1.0)
    places = slots(formation, (0.0, 0.0))
    assert len(places) == count
    for (x, y), heading in places.values():
        assert math.cos(heading - math.atan2(1.0 - y, 2.0 - x)) > 0.999
    spots = [place for place, _ in places.values()]
    apart = min(math.hypot(a[0] - b[0], a[1] - b[1]) for a in spots for b in spots if a != b)
    assert apart >= 0.69


def test_people_side_by_side_look_the_same_way():
    places = slots(Formation("f", SIDE_BY_SIDE, (2.0, 0.0), 0.8, 0.0, ("a", "b", "c"), 0.0, 1.0), (0.0, 0.0))
    assert {heading for _, heading in places.values()} == {0.0}
    assert sorted(y for (_, y), _ in places.values()) == pytest.approx([-0.8, 0.0, 0.8])


def test_the_robot_takes_the_nearest_place():
    places = slots(Formation("f", CIRCLE, (0.7, 0.0), 1.4, 0.0, ("a", ROBOT, "b"), 0.0, 1.0), (0.0, 0.0))
    assert set(places) == {"a", "b"}
    assert all(math.hypot(*place) > 0.5 for place, _ in places.values())


def test_a_crowd_is_the_same_for_the_same_seed_and_keeps_its_number():
    data = yaml.safe_load((SCENES / "crowd.yaml").read_text())
    data["duration"] = 300.0
    first, second, other = parse_scene(data), parse_scene(data), parse_scene(dict(data, seed=2))
    assert first == second and first != other
    for when in (1.0, 100.0, 250.0):
        there = sum(script.enter <= when < script.leave for script in first.people)
        assert 6 <= there <= 12
    assert len(first.people) > 12
    assert all(2 <= len(formation.members) <= 4 for formation in first.formations)


def test_in_a_crowd_only_members_of_a_group_share_a_place():
    crowd = parse_scene({"duration": 400.0, "crowd": {"people": 10, "meet": 15.0}})
    strangers = 0
    for when in range(50, 400, 7):
        stand = {}
        for script in crowd.people:
            begun = [goal for goal in script.goals if goal.start <= when]
            if script.enter <= when < script.leave and begun and begun[-1].position[0] < 9.9:
                stand[script.name] = begun[-1]
        for one in stand.values():
            for other in stand.values():
                if one is not other and one.formation != other.formation:
                    strangers += 1
                    assert math.hypot(one.position[0] - other.position[0], one.position[1] - other.position[1]) > 0.65
    assert strangers > 100
