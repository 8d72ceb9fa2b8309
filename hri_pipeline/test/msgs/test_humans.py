"""The client for people: what a user's callbacks do to it."""

import logging
import threading
from types import SimpleNamespace

import pytest

from hri_pipeline.client import humans
from hri_pipeline.core.frames import RawTransform
from hri_pipeline.ros.rospy_compat import WallTimeThrottle


def failing(*errors):
    """A callback that fails with these errors by turns, and how often it was called."""
    called = []

    def fail(value):
        called.append(value)
        raise errors[(len(called) - 1) % len(errors)]
    return fail, called


@pytest.fixture
def now(monkeypatch):
    """Seconds that the throttle of each callback sees, to be set."""
    clock = [0.0]
    monkeypatch.setattr(humans, "WallTimeThrottle", lambda: WallTimeThrottle(lambda: clock[0]))
    return clock


def test_a_callback_that_fails_for_each_message_ends_nothing_and_is_told_now_and_then(now, caplog):
    fail, called = failing(KeyError("ann"))
    guarded = humans._guarded(fail)
    with caplog.at_level(logging.ERROR, "rosout"):
        for number in range(300):
            now[0] = number / 15.0
            guarded(number)
    assert len(called) == 300
    assert [record.getMessage() for record in caplog.records] == 2 * ["a callback of Humans failed: KeyError: 'ann'"]


def test_a_callback_that_fails_for_each_message_hides_no_other_error(now, caplog):
    often, seldom = (humans._guarded(failing(*errors)[0]) for errors in (
        (KeyError("ann"), ValueError("no place")), (TypeError("no number"), )))
    with caplog.at_level(logging.ERROR, "rosout"):
        for number in range(90):
            now[0] = number / 15.0
            often(number)
            if number == 45:
                seldom(number)
    assert [record.getMessage().split(": ")[1] for record in caplog.records] == ["KeyError", "ValueError", "TypeError"]


@pytest.fixture
def persons(monkeypatch):
    """The persons of a client whose tracked lists are given by _on_tracked()."""
    monkeypatch.setattr(humans, "IdSubscribers", lambda *args, **options: SimpleNamespace(close=lambda: None))
    monkeypatch.setattr(humans, "LazyTopic", lambda *args: SimpleNamespace(close=lambda: None))
    tracked = humans._Tracked(humans.Person, SimpleNamespace(
        patience=0.0, frames=SimpleNamespace(forget=lambda identity: None)))
    yield tracked
    tracked.close()


@pytest.fixture
def client():
    """A client without a master."""
    with humans.Humans(patience=0.0) as made:
        made.frames._subscriber = SimpleNamespace(close=lambda: None)
        yield made


def test_eyes_that_are_closed_have_no_gaze(client):
    face = humans.Face("f1", client)
    assert face.gaze() is None
    for what, tenths, parents, is_known in (
            ("open", 50, {"gaze_f1": "face_f1", "face_f1": "camera"}, True),
            ("not measured in one image", 51, {"face_f1": "camera"}, True),
            ("closed", 60, {"face_f1": "camera"}, False),
            ("open again", 61, {"gaze_f1": "face_f1", "face_f1": "camera"}, True),
            ("closed, and time has jumped back", 10, {"face_f1": "camera"}, False)):
        for child, parent in parents.items():
            client.frames._tf.put(RawTransform(parent, child, tenths // 10, tenths % 10 * 10 ** 8, (0.0, 0.0, 1.0),
                                               (0.0, 0.0, 0.0, 1.0)), False)
        assert (face.gaze() is not None) is is_known, what
        assert face.pose() is not None


def test_whose_pose_is_asked_for_while_they_leave_are_not_followed_for_ever(client):
    ask = client.frames.pose
    for number in range(20):
        person = humans.Person("person%d" % number, client)

        def pose(*given, person=person):
            person.close()              # in the thread that takes the list
            return ask(*given)
        client.frames.pose = pose
        person.pose()
    assert client.frames._tf.followed == {"person": []}


def test_whose_pose_is_asked_for_after_they_left_does_not_disturb_the_same_person_who_is_back(client):
    before = humans.Person("anna", client)
    before.close()
    back = humans.Person("anna", client)
    back.pose()
    assert before.pose() is None
    assert client.frames._tf.followed == {"person": ["anna"]}


def test_nobody_leaves_before_they_have_come(persons):
    told, has_left = [], threading.Event()

    def came(person):
        told.append(("came", person.id))
        if person.id == "ann":          # as one that asks for a name, and waits for it
            persons._on_tracked([])
            has_left.wait(0.3)

    def left(person):
        told.append(("left", person.id))
        has_left.set()
    persons._on_tracked(["ann", "bob"])
    persons.listen(came, left)
    assert has_left.wait(10.0)
    end = threading.Event()
    persons._calls.add(end.set)
    assert end.wait(10.0)
    assert told == [("came", "ann"), ("came", "bob"), ("left", "ann"), ("left", "bob")]
    assert persons.present() == {}


def test_who_listens_in_a_callback_is_told_of_those_who_are_there(persons):
    told, end = [], threading.Event()

    def came(person):
        persons.listen(lambda other: told.append(other.id), None)
        end.set()
    persons.listen(came, None)
    persons._on_tracked(["ann"])
    assert end.wait(10.0) and told == ["ann"]
