"""Who looks at whom: one target at a time, at once nobody with closed eyes, nobody through others."""

import math

import numpy as np
import pytest

from hri_pipeline.core.interactions.gaze import ROBOT, ErrorRenewal, GazeTargets, Observer
from hri_pipeline.core.interactions.parameters import INTERACTION_PARAMETERS
from hri_pipeline.core.interactions.people import PeopleSnapshot

RATE = 15.0
ROBOT_AT = np.array([0.0, 0.0, 1.3])


def towards(here, there):
    way = np.asarray(there, dtype=float) - here
    return way / np.linalg.norm(way)


class Room:
    """Three people around the robot, and what each of them does with the eyes."""

    def __init__(self, **changes):
        self.targets = GazeTargets(INTERACTION_PARAMETERS.resolve(changes))
        self.places = {"ann": np.array([2.0, -1.0, 1.6]), "bob": np.array([2.0, 1.0, 1.7]),
                       "cho": np.array([3.5, 0.0, 1.6])}
        self.now = 0.0

    def person(self, name, at=None, **known):
        if at is not None:
            place = ROBOT_AT if at == ROBOT else self.places[at]
            known.setdefault("gaze_direction", towards(self.places[name], place))
            known.setdefault("eyes_closed", 0.0)
        return Observer(name, self.places[name], 0.05, **known)

    def look(self, seconds, people, robot=ROBOT_AT):
        """Return {sender: receiver} after so much time of the same."""
        found = []
        for _ in range(max(1, round(seconds * RATE))):
            self.now += 1.0 / RATE
            found = self.targets.update(people, robot, self.now)
            assert len({gaze.sender for gaze in found}) == len(found)
        return {gaze.sender: gaze.receiver for gaze in found}


def test_a_person_the_robot_and_each_other():
    room = Room()
    people = [room.person("ann", "bob"), room.person("bob", "ann"), room.person("cho", ROBOT)]
    assert room.look(0.4, people) == {"ann": "bob", "bob": "ann", "cho": ROBOT}


def test_who_looks_past_everybody_looks_at_nobody():
    room = Room()
    assert room.look(1.0, [room.person("ann", gaze_direction=np.array([0.0, -1.0, 0.0])),
                           room.person("bob", ROBOT)]) == {
        "bob": ROBOT}


@pytest.mark.parametrize("beside, told", [(6.0, {"ann": ROBOT}), (16.0, {})])
def test_who_looks_past_the_robot_does_not_look_at_it_even_where_there_is_nobody_else(beside, told):
    room, turn = Room(), np.radians(beside)
    x, y, z = towards(room.places["ann"], ROBOT_AT)
    past = np.array([np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y, z])
    assert room.look(2.0, [room.person("ann", gaze_direction=past, eyes_closed=0.0)]) == told


def test_where_eyes_looked_does_not_count_once_they_are_too_small():
    room = Room()
    facing, past = towards(room.places["ann"], ROBOT_AT), np.array([0.0, -1.0, 0.0])
    assert room.look(1.0, [room.person("ann", gaze_direction=past, eyes_closed=0.0)]) == {}
    assert room.look(3.0, [room.person("ann", head_direction=facing, eyes_closed=0.0)]) == {"ann": ROBOT}


@pytest.mark.parametrize("length", [0.1, 0.2, 0.26])
def test_a_blink_does_not_end_a_gaze(length):
    room = Room()
    room.look(1.0, [room.person("ann", ROBOT)])
    shut = room.person("ann", head_direction=towards(room.places["ann"], ROBOT_AT), eyes_closed=0.9)
    for _ in range(round(length * RATE)):
        assert room.look(0.0, [shut]) == {"ann": ROBOT}
    assert room.look(0.0, [room.person("ann", ROBOT)]) == {"ann": ROBOT}


def test_a_slow_blink_leads_back_to_the_same_target_at_once():
    room = Room()
    room.look(1.0, [room.person("ann", ROBOT)])
    shut = room.person("ann", head_direction=towards(room.places["ann"], ROBOT_AT), eyes_closed=0.9)
    assert room.look(0.4, [shut]) == {}
    assert room.look(0.0, [room.person("ann", ROBOT)]) == {"ann": ROBOT}


def test_closed_eyes_end_a_gaze_after_a_blink_and_a_lost_face_does_not_open_them():
    room = Room()
    assert room.look(0.5, [room.person("ann", ROBOT)]) == {"ann": ROBOT}
    shut = room.person("ann", head_direction=towards(room.places["ann"], ROBOT_AT), eyes_closed=0.9)
    assert room.look(0.35, [shut]) == {}
    assert room.look(1.0, [shut]) == {}
    assert room.look(0.5, [room.person("ann")]) == {}
    assert room.look(0.4, [room.person("ann", ROBOT)]) == {"ann": ROBOT}


def test_one_image_of_open_lids_does_not_open_closed_eyes():
    room = Room()
    shut = room.person("ann", head_direction=towards(room.places["ann"], ROBOT_AT), eyes_closed=0.9)
    room.look(0.5, [room.person("ann", ROBOT)])
    room.look(0.5, [shut])
    assert room.look(0.05, [room.person("ann", ROBOT)]) == {}


def test_without_eyes_the_head_decides():
    room = Room()
    head = room.person("ann", head_direction=towards(room.places["ann"], room.places["bob"]))
    assert room.look(1.0, [head, room.person("bob", ROBOT)]) == {"ann": "bob", "bob": ROBOT}


def test_the_head_turns_a_part_of_the_way_from_the_trunk():
    """The head of somebody who faces the robot and looks at bob points between the two."""
    room = Room(head_gain=0.6)
    front, side = towards(room.places["ann"], ROBOT_AT), towards(room.places["ann"], room.places["bob"])
    angle = math.acos(front @ side)
    between = (math.sin(0.4 * angle) * front + math.sin(0.6 * angle) * side) / math.sin(angle)
    people = [room.person("ann", head_direction=between, body_direction=front), room.person("bob", ROBOT)]
    assert room.look(1.0, people)["ann"] == "bob"


def test_who_stands_behind_somebody_is_not_looked_at():
    room = Room()
    room.places.update(bob=np.array([3.0, -1.0, 1.6]), cho=np.array([4.0, -1.02, 1.6]))
    assert room.look(1.0, [room.person("ann", "cho"), room.person("bob"), room.person("cho")]) == {"ann": "bob"}


def test_a_gaze_lasts_over_a_wild_image_and_ends_when_nothing_is_seen():
    room = Room()
    others = [room.person("bob"), room.person("cho")]
    room.look(1.0, [room.person("ann", "bob")] + others)
    # Halfway to somebody else for one image: hysteresis.
    aside = towards(room.places["ann"], room.places["bob"]) + 0.25 * towards(room.places["ann"], ROBOT_AT)
    wild = room.person("ann", gaze_direction=aside / np.linalg.norm(aside), eyes_closed=0.0)
    assert room.look(0.05, [wild] + others) == {"ann": "bob"}
    assert room.look(0.2, [room.person("ann")] + others) == {"ann": "bob"}
    assert room.look(0.4, [room.person("ann")] + others) == {}


def test_the_frame_rate_does_not_matter():
    delays = []
    for rate in (5.0, 15.0, 60.0):
        room = Room(evidence_time=0.2)
        people = [room.person("ann", "bob"), room.person("bob"), room.person("cho")]
        switched = [room.person("ann", ROBOT), room.person("bob"), room.person("cho")]
        now = 0.0
        while now < 1.0:
            now += 1.0 / rate
            room.targets.update(people, ROBOT_AT, now)
        begun = now
        while now < begun + 3.0:
            now += 1.0 / rate
            if [gaze.receiver for gaze in room.targets.update(switched, ROBOT_AT, now)] == [ROBOT]:
                break
        delays.append(now - begun)
    assert max(delays) - min(delays) <= 0.25
    assert max(delays) < 0.6


def test_people_come_and_go_and_others_keep_their_targets():
    room = Room()
    room.look(0.5, [room.person("ann", "cho"), room.person("bob", ROBOT), room.person("cho", ROBOT)])
    assert room.look(0.05, [room.person("cho", ROBOT), room.person("ann", "cho")]) == {"ann": "cho", "cho": ROBOT}
    assert room.look(0.05, [room.person("ann", "cho")]) == {}
    assert room.look(0.05, []) == {}


def test_nobody_looks_at_what_has_no_place_or_is_too_far():
    room = Room()
    assert room.look(1.0, [room.person("ann", ROBOT)], robot=None) == {}
    far = Room(max_distance=1.0)
    assert far.look(1.0, [far.person("ann", ROBOT)]) == {}
    nowhere = Observer("dan", gaze_direction=np.array([1.0, 0.0, 0.0]))
    assert room.look(1.0, [nowhere]) == {}


def test_time_that_goes_back_begins_anew():
    room = Room()
    room.look(1.0, [room.person("ann", "bob"), room.person("bob")])
    room.now = 0.0
    assert room.look(0.05, [room.person("ann"), room.person("bob")]) == {}


@pytest.mark.parametrize("count", [1, 2, 30])
def test_any_number_of_people(count):
    chance = np.random.default_rng(count)
    targets = GazeTargets(INTERACTION_PARAMETERS.resolve({}))
    people = [Observer("p{}".format(index), chance.uniform(-4.0, 4.0, 3), gaze_direction=np.array([0.0, 1.0, 0.0]))
              for index in range(count)]
    told = [gaze for step in range(5) for gaze in targets.update(people, ROBOT_AT, step / RATE)]
    assert all(gaze.sender != gaze.receiver and 0.0 < gaze.confidence <= 1.0 for gaze in told)
    assert len({gaze.sender for gaze in told}) >= count // 10


@pytest.mark.parametrize("wanted", [False, True])
def test_a_body_without_a_face_tells_no_gaze_unless_it_is_wanted(wanted):
    room = Room(gaze_without_face=wanted)
    facing = towards(room.places["ann"], ROBOT_AT)
    snapshot = PeopleSnapshot.of([room.person("ann", head_direction=facing, head_direction_sd=0.35,
                                              body_direction=facing)])
    snapshot.faceless[:] = True
    for _ in range(60):
        room.now += 1.0 / RATE
        found = {gaze.sender: gaze.receiver for gaze in room.targets.update(snapshot, ROBOT_AT, room.now)}
    assert found == ({"ann": ROBOT} if wanted else {})
    trunk = Room(gaze_without_face=wanted)
    assert trunk.look(3.0, [trunk.person("ann", body_direction=facing)]) == ({"ann": ROBOT} if wanted else {})


def test_people_look_rather_at_who_speaks_and_at_who_looks_at_them():
    room = Room()
    room.places.update(bob=np.array([3.5, -1.3, 1.6]), cho=np.array([3.5, -0.7, 1.6]))
    between = towards(room.places["ann"], 0.5 * (room.places["bob"] + room.places["cho"]))

    def told(speaker, looks):
        targets = GazeTargets(INTERACTION_PARAMETERS.resolve({"gaze_on": 0.5, "gaze_off": 0.4}))
        people = [room.person("ann", gaze_direction=between, eyes_closed=0.0),
                  *(room.person(name, "ann" if name == looks else None) for name in ("bob", "cho"))]
        for index in range(30):
            snapshot = PeopleSnapshot.of(people)
            snapshot.speaking = np.array([person.id == speaker for person in people])
            found = targets.update(snapshot, None, 1.0 + index / RATE)
        return {gaze.sender: gaze.receiver for gaze in found}["ann"]

    assert [told(name, None) for name in ("bob", "cho")] == ["bob", "cho"]
    assert [told(None, name) for name in ("bob", "cho")] == ["bob", "cho"]


def test_errors_that_last_do_not_add_up_to_certainty_and_those_that_tremble_do():
    room = Room()
    room.places.update(bob=np.array([3.5, -1.3, 1.6]), cho=np.array([3.5, -0.7, 1.6]))
    nearer = towards(room.places["ann"], 0.4 * room.places["bob"] + 0.6 * room.places["cho"])

    def confidence(sd, seconds=10.0):
        settings = INTERACTION_PARAMETERS.resolve({"nobody_prior": 0.4})
        targets, random = GazeTargets(settings), np.random.RandomState(1)
        for index in range(int(seconds * RATE)):
            gaze = nearer + np.append(random.normal(0.0, sd, 2), 0.0)
            people = [room.person("ann", gaze_direction=gaze / np.linalg.norm(gaze), eyes_closed=0.0),
                      room.person("bob"), room.person("cho")]
            found = {gaze.sender: gaze for gaze in targets.update(people, None, 1.0 + index / RATE)}
        return found["ann"].confidence if "ann" in found else 0.0

    assert confidence(0.0) < 0.75, "somebody else is nearly as likely, however long it lasts"
    assert confidence(0.14) > 0.9


def test_eyes_that_go_elsewhere_are_followed_at_the_second_image():
    room = Room()
    room.places["bob"] = np.array([1.0, 1.6, 1.7])
    company = [room.person("bob"), room.person("cho")]
    assert room.look(3.0, [room.person("ann", at="bob", gaze_direction_sd=0.1), *company]) == {"ann": "bob"}
    assert room.look(2.0 / RATE, [room.person("ann", at=ROBOT, gaze_direction_sd=0.1), *company]) == {"ann": ROBOT}


@pytest.mark.parametrize("sd", [0.1, 0.2])
def test_eyes_that_tremble_about_one_place_do_not_go_elsewhere(sd):
    random, renewal, error, begun = np.random.RandomState(3), ErrorRenewal(), np.zeros(3), 0
    for _ in range(int(60.0 * RATE)):
        error = 0.85 * error + math.sqrt(1.0 - 0.85 ** 2) * random.normal(0.0, sd, 3)
        direction = np.array([1.0, 0.0, 0.0]) + error * (0.0, 1.0, 1.0)
        person = Observer("ann", np.zeros(3), gaze_direction=direction / np.linalg.norm(direction),
                          gaze_direction_sd=sd)
        begun += int(renewal.update(PeopleSnapshot.of([person]), np.array([0.3]), 1.0 / RATE)[1].sum())
    assert begun <= 2, "in a minute"


def test_people_look_rather_at_those_of_their_group():
    room = Room()
    room.places.update(bob=np.array([3.5, -1.3, 1.6]), cho=np.array([3.5, -0.7, 1.6]))
    between = towards(room.places["ann"], 0.5 * (room.places["bob"] + room.places["cho"]))
    people = [room.person("ann", gaze_direction=between, eyes_closed=0.0), room.person("bob"), room.person("cho")]
    for groups, wanted in (([0, 0, -1], {"ann": "bob"}), ([1, 0, 1], {"ann": "cho"}), ([-1, 0, 0], {})):
        targets = GazeTargets(INTERACTION_PARAMETERS.resolve({}))
        for index in range(30):
            snapshot = PeopleSnapshot.of(people)
            snapshot.groups = np.array(groups)
            found = targets.update(snapshot, None, 1.0 + index / RATE)
        assert {gaze.sender: gaze.receiver for gaze in found} == wanted


def test_a_head_that_is_turned_half_the_way_looks_at_the_only_one_there():
    """A head at 43 to 60 degrees, somebody at 75, nobody else on that side; the trunk is not seen."""
    for head in (43.0, 50.0, 60.0):
        room = Room()
        room.places = {"ann": np.array([2.0, 0.0, 1.6]), "bob": np.array([2.0 - 1.2 * math.cos(math.radians(75.0)),
                                                                         1.2 * math.sin(math.radians(75.0)), 1.6])}
        turned = np.array([-math.cos(math.radians(head)), math.sin(math.radians(head)), 0.0])
        sd = math.hypot(0.09, 0.35 * (math.radians(head) - math.radians(30.0)))
        ann = room.person("ann", head_direction=turned, head_direction_sd=sd)
        assert room.look(1.5, [ann, room.person("bob")]) == {"ann": "bob"}, head


@pytest.mark.parametrize("distance", [0.15, 0.25, 0.3, 0.5])
def test_a_face_close_to_the_camera_that_looks_beside_it_by_two_degrees_looks_at_it(distance):
    room = Room()
    room.places["ann"] = np.array([distance, 0.0, 1.3])
    beside = np.array([-math.cos(math.radians(2.0)), math.sin(math.radians(2.0)), 0.0])
    away = np.array([-math.cos(math.radians(60.0)), math.sin(math.radians(60.0)), 0.0])
    near = room.person("ann", head_direction=beside, gaze_direction=beside, eyes_closed=0.0)
    assert room.look(0.2, [near]) == room.look(3.0, [near]) == {"ann": ROBOT}
    assert room.look(3.0, [room.person("ann", head_direction=away, gaze_direction=away, eyes_closed=0.0)]) == {}
