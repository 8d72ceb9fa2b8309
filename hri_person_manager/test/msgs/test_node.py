"""The node of the person manager goes on, whatever the master and one bad number do; without a master."""

import json
import threading
import time
from functools import partial
from unittest.mock import MagicMock

import genpy
import numpy as np
import pytest

from hri_person_manager.core import persons
from hri_person_manager.core.features import FeaturePose, Kind, MatchNode, PlaceSource
from hri_person_manager.core.manager import PersonManager
from hri_person_manager.core.match_graph import CandidateMatch, MatchGuard
from hri_person_manager.core.parameters import PERSON_MANAGER_PARAMETERS
from hri_person_manager.core.persons import PersonState, Snapshot
from hri_person_manager.core.register import PersonRecord, PersonRegister, RegisterError
from hri_person_manager.ros import inputs, persistence, web
from hri_person_manager.ros import node as module
from hri_person_manager.ros.inputs import OtherManagers, double_persons
from hri_person_manager.ros.navigation import PeopleTopic
from hri_person_manager.ros.node import PersonManagerNode
from hri_person_manager.ros.persistence import RestartState
from hri_person_manager.ros.services import GalleryAnswer, PersonServices
from hri_person_manager.srv import (
    EnrolRequest,
    ExportRequest,
    ForgetRequest,
    MergeRequest,
    SetNameRequest,
    SetNativeLanguageRequest,
    SplitRequest,
)
from hri_pipeline.client.topics import Engagement, Location
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.timing import StaleStampFilter
from hri_pipeline.srv import GalleryResponse
from hri_pipeline.testing import wait_for

PRESENT = {"anonymous_person_abcde": [MatchNode(Kind.FACE, "fghij")]}


@pytest.fixture()
def written(monkeypatch):
    """What has been written; `may_go_on` is cleared while the master does not answer."""
    found = MagicMock(values=[], may_go_on=threading.Event(), problems=[])

    def write(name, value):
        found.may_go_on.wait(20.0)
        if found.problems:
            raise found.problems.pop()
        found.values.append(value)

    monkeypatch.setattr(persistence.rospy, "set_param", write)
    monkeypatch.setattr(persistence.rospy, "has_param", lambda name: False)
    monkeypatch.setattr(persistence, "_RESTART_PERIOD_S", 0.01)
    found.may_go_on.set()
    return found


def test_a_master_that_does_not_answer_holds_nobody_up(written):
    written.may_go_on.clear()
    state = RestartState()
    updating = threading.Thread(target=state.update, args=(lambda: PRESENT, True), daemon=True)
    updating.start()
    updating.join(5.0)
    assert not updating.is_alive()
    state.wait(0.01)
    assert written.values == []
    written.may_go_on.set()
    state.wait(5.0)
    assert written.values == [{"anonymous_person_abcde": ["FACE fghij"]}]
    state.close()


def test_what_the_master_has_not_taken_is_written_again_also_that_nobody_is_left(written):
    state = RestartState()
    state.update(lambda: PRESENT, at_once=True)
    state.wait(5.0)
    written.problems.append(OSError("away"))
    state.update(lambda: {}, at_once=True)
    state.wait(5.0)
    assert len(written.values) == 1
    wait_for(lambda: written.values[1:] == [{}], 5, "the second try", act=lambda: state.update(lambda: {}))
    state.close()


def test_one_bad_cycle_does_not_end_the_node():
    node = PersonManagerNode.__new__(PersonManagerNode)
    node._stop, node._lock, node._report = threading.Event(), threading.RLock(), MagicMock()
    node._tf_input = MagicMock()
    node._tf_input.pass_on.side_effect = [ValueError("a place that waited"), None]
    cycles = []

    def tick():
        cycles.append(1)
        if len(cycles) == 1:
            raise ZeroDivisionError("a place without a ray")
        node._stop.set()

    node._tick = tick
    node.spin()
    assert len(cycles) == 2
    assert [type(call.args[0]) for call in node._report.fail.call_args_list] == [ValueError, ZeroDivisionError]


def test_of_more_persons_than_are_known_at_a_time_the_merged_ones_do_not_hinder_the_start(monkeypatch):
    monkeypatch.setattr(persons, "MAX_KNOWN_IDS", 3)
    node = PersonManagerNode.__new__(PersonManagerNode)
    node._manager, node._last_now = PersonManager(PERSON_MANAGER_PARAMETERS.resolve({})), 0.0
    records = [PersonRecord("p0", alias="p1"), *(PersonRecord("p%d" % number) for number in range(1, 5)),
               PersonRecord("no id", alias="p4")]
    node._register, node._restart_state = PersonRegister(borrowed=records), MagicMock()
    node._restart_state.read.return_value = {}
    node._expire = node._forget_gone = lambda: None
    node._remember_earlier_runs()
    assert node._manager.snapshot(0.0).known == ("p2", "p3", "p4")


@pytest.fixture
def at_two(monkeypatch):
    monkeypatch.setattr(module.rospy, "get_time", lambda: 2.0)


def test_a_recogniser_that_answers_with_what_is_no_id_has_learnt_nobody(at_two):
    """It would be refused by the lists of persons, again and again."""
    services, person = services_with_somebody(GalleryResponse(success=True, id="a b"))
    with pytest.raises(RegisterError):
        services._enrol(EnrolRequest(id=person))
    assert services._register.records == []


def services_with_somebody(answer, register=None):
    """The services, where the only recogniser answers so, and an anonymous person who is there."""
    manager = PersonManager(PERSON_MANAGER_PARAMETERS.resolve({}))
    manager.on_tracked(Kind.FACE, ["fghij"], 0.0)
    manager.tick(2.0)
    person, = manager.snapshot(2.0).tracked
    services = PersonServices.__new__(PersonServices)
    services._manager, services._register, services._lock = manager, register or PersonRegister(), threading.RLock()
    services._guard, services._changed, services._written = MatchGuard(100.0), MagicMock(), MagicMock()
    services._galleries = MagicMock()
    services._galleries.call.return_value = [GalleryAnswer("/faces/gallery", answer)]
    return services, person


def test_nobody_is_learnt_under_a_name_that_is_refused(at_two):
    services, person = services_with_somebody(GalleryResponse(success=True, id="abcde"))
    with pytest.raises(RegisterError, match="64"):
        services._enrol(EnrolRequest(id=person, name="x" * 65))
    assert not services._galleries.call.called and services._register.records == []


def test_whom_only_a_recogniser_knew_is_forgotten_and_the_answer_says_so(at_two):
    services, _ = services_with_somebody(GalleryResponse(success=True, id="abcde"))
    assert services._forget(ForgetRequest(id="abcde")).success


def test_a_recogniser_that_could_not_forget_is_told_although_nobody_else_knows_the_person(at_two):
    services, _ = services_with_somebody(GalleryResponse(success=False, message="make room"))
    with pytest.raises(RegisterError, match="make room"):
        services._forget(ForgetRequest(id="abcde"))


def test_nobody_is_forgotten_whom_nobody_knows(at_two):
    services, _ = services_with_somebody(GalleryResponse(success=False, unknown=True))
    with pytest.raises(RegisterError, match="no known person"):
        services._forget(ForgetRequest(id="abcde"))


def test_who_is_in_a_read_only_store_is_not_forgotten_by_half(at_two):
    services, _ = services_with_somebody(GalleryResponse(success=True), PersonRegister(
        borrowed=[PersonRecord("ada", "Ada")]))
    services._manager.know(["ada"])
    with pytest.raises(RegisterError, match="read-only"):
        services._forget(ForgetRequest(id="ada"))
    assert "ada" in services._manager.snapshot(2.0).known and not services._galleries.call.called
    assert services._guard.check("ada", 1, "fghij", 2, 0.9, 2.0) is not None


def test_a_merge_that_cannot_be_kept_is_told_as_what_it_is(at_two):
    services, _ = services_with_somebody(GalleryResponse(), PersonRegister(borrowed=[PersonRecord("ada", "Ada")]))
    services._manager.know(["ada", "bob"])
    with pytest.raises(RegisterError, match="ada is an alias of bob until the end of this run, but .*read-only"):
        services._merge(MergeRequest(id="bob", other="ada"))
    assert services._manager.representative("ada") == "bob" and services._changed.called


def test_an_anonymous_person_who_is_parted_is_not_kept_as_somebody_known(at_two):
    """It had a record from then on: in the store, and as a known person of the next run."""
    services, person = services_with_somebody(GalleryResponse())
    services._manager.know(["ada"])
    assert services._merge(MergeRequest(id="ada", other=person)).success
    assert services._split(SplitRequest(id=person)).success
    assert [record.id for record in services._register.records] == ["ada"]
    with pytest.raises(RegisterError, match="anonymous"):
        services._set_name(SetNameRequest(id=person, name="Ada"))


def test_what_is_said_of_an_id_that_was_merged_is_said_of_the_person_in_use(at_two):
    """The answer was "bob has a name", and the person whom everybody sees had none; an anonymous id was refused."""
    services, person = services_with_somebody(GalleryResponse())
    services._manager.know(["ada", "bob"])
    for other in ("bob", person):
        assert services._merge(MergeRequest(id="ada", other=other)).success
    assert services._set_name(SetNameRequest(id="bob", name="Ada")).message == "ada has a name"
    assert services._set_native_language(SetNativeLanguageRequest(id=person, language="fr")).message.endswith("ada: fr")
    assert services._register.get("ada").name == "Ada" and not services._register.get("bob").name
    assert services._set_name(SetNameRequest(id="bob", name="   ")).message == "ada has no name"


def test_a_merged_person_has_the_name_that_one_of_both_has_and_export_shows_both(at_two):
    """Ada, when she was found to be somebody older without a name, had none; nor did an export hold it."""
    services, person = services_with_somebody(GalleryResponse(success=False, unknown=True))
    services._manager.know(["ada", "bob"])
    services._set_name(SetNameRequest(id="bob", name="Bob"))
    services._merge(MergeRequest(id="ada", other="bob"))
    services._merge(MergeRequest(id="ada", other=person))
    listed = services._list_known(None)
    assert dict(zip(listed.ids, listed.names))["ada"] == "Bob"
    for known_as in ("ada", "bob", person):
        exported = json.loads(services._export(ExportRequest(id=known_as)).data)["persons"]
        assert {record["id"]: record["name"] for record in exported} == {"ada": "", "bob": "Bob"}
    services._split(SplitRequest(id="bob"))
    listed = services._list_known(None)
    assert [dict(zip(listed.ids, listed.names))[name] for name in ("ada", "bob")] == ["", "Bob"]


def test_who_is_forgotten_by_an_anonymous_id_is_forgotten_as_the_known_person_too(at_two):
    services, person = services_with_somebody(GalleryResponse(success=True))
    services._manager.know(["ada"])
    services._merge(MergeRequest(id="ada", other=person))
    assert services._forget(ForgetRequest(id=person)).success
    assert services._register.records == [] and "ada" not in services._manager.snapshot(2.0).known
    assert {call.args for call in services._galleries.call.call_args_list} == {("forget", "ada"), ("forget", person)}


@pytest.mark.parametrize("said", ["ada", "bob", "cat"])
def test_whom_recognisers_have_joined_are_forgotten_together_also_when_none_is_there(at_two, said):
    """Of ids that are joined by way of another one, those who were not there stayed known, and in the galleries."""
    services, _ = services_with_somebody(GalleryResponse(success=True))
    services._manager.know(["ada", "bob", "cat"])
    for other in ("ada", "cat"):
        services._manager.on_match(CandidateMatch(MatchNode(Kind.PERSON, "bob"), MatchNode(Kind.PERSON, other), 0.9),
                                   2.0)
    assert services._forget(ForgetRequest(id=said)).success
    assert not {"ada", "bob", "cat"} & set(services._manager.snapshot(2.0).known)
    assert {call.args for call in services._galleries.call.call_args_list} == {
        ("forget", person) for person in ("ada", "bob", "cat")}


def test_an_export_holds_what_recognisers_keep_under_all_ids_of_a_human(at_two):
    services, _ = services_with_somebody(GalleryResponse())
    services._manager.know(["ada", "bob"])
    services._merge(MergeRequest(id="ada", other="bob"))
    services._galleries.call = lambda command, person: [GalleryAnswer("/faces/gallery", GalleryResponse(
        success=True, data=json.dumps({"id": person, "templates": 5})))]
    exported = json.loads(services._export(ExportRequest(id="ada")).data)["galleries"]
    assert exported == {"/faces/gallery": {"id": "ada", "templates": 5, "merged": [{"id": "bob", "templates": 5}]}}


def test_the_stamps_of_people_are_those_of_the_images_and_do_not_go_back(monkeypatch):
    """A cycle of the clock comes between two images, which are some tenths of a second old when they come."""
    topic = PeopleTopic.__new__(PeopleTopic)
    topic._lock, topic._latest = threading.Lock(), ((), genpy.Time())
    seen, lost = (Snapshot((PersonState("ann", "", "", "", False, sure, place=MagicMock()),), (), ())
                  for sure in (1.0, 0.8))

    def stamp_after(snapshot, sensed, now):
        topic.update(snapshot, genpy.Time.from_sec(sensed), genpy.Time.from_sec(now))
        return round(topic._latest[1].to_sec(), 6)

    assert stamp_after(seen, 10.0, 10.2) == stamp_after(seen, 10.0, 10.25) == 10.0
    assert stamp_after(lost, 10.0, 11.5) == 11.5, "nobody is seen"
    assert stamp_after(seen, 11.4, 11.6) == 11.5 and stamp_after(seen, 11.6, 11.8) == 11.6
    assert stamp_after(seen, 3.0, 3.2) == 3.0, "the time has jumped back"


def test_a_recording_that_holds_people_is_told_apart_from_another_robot():
    assert "bag.launch" in double_persons(["/play_1795697340426374058"])
    for others in (["/robot2/hri_person_manager"], ["/play_1795697340426374058", "/robot2/hri_person_manager"]):
        assert "bag.launch" not in double_persons(others)
        assert "persons:=false" in double_persons(others)
        assert all(name in double_persons(others) for name in others)


def test_of_programs_that_sent_persons_once_nothing_is_kept(monkeypatch):
    """As `rostopic pub` in a loop, whose name is another one each time."""
    clock = MagicMock(**{"monotonic.return_value": 0.0})
    monkeypatch.setattr(inputs, "rospy", MagicMock())
    monkeypatch.setattr(inputs, "time", clock)
    others = OtherManagers()
    for number in range(20):
        clock.monotonic.return_value += 10.0
        others._on_list(MagicMock(_connection_header={"callerid": "/rostopic_%d" % number}))
    assert len(others._heard) == 1 and "/rostopic_19 " in others.problem()


def test_a_place_from_before_the_clock_went_back_places_nobody(monkeypatch):
    """The last image of a bag that loops: its frame would hide all later ones of the person in the buffers of tf2."""
    monkeypatch.setattr(module.rospy, "get_time", lambda: 100.2)
    node = MagicMock(_stale_stamps=StaleStampFilter(), _people=None)
    node._stop.is_set.return_value = False
    node._manager.on_place.return_value = None
    node._stale_stamps.went_back(20.0, time.monotonic())
    old, new = (FeaturePose(PlaceSource.FACE, "abcde", "camera", Pose.identity(), secs, 0) for secs in (119, 100))
    PersonManagerNode._on_poses(node, [old, new])
    assert [call.args for call in node._reference.place.call_args_list] == [(new,)]


def test_each_image_is_noted_once_and_people_have_the_newest_stamp_that_can_be(monkeypatch):
    monkeypatch.setattr(module.rospy, "get_time", lambda: 100.2)
    node = MagicMock(_stale_stamps=StaleStampFilter(), _people=None, _sensed=genpy.Time())
    node._stop.is_set.return_value = False
    node._manager.on_place.return_value = None
    node._note_image = partial(PersonManagerNode._note_image, node)
    node._note_stamp = partial(PersonManagerNode._note_stamp, node)
    images = [(PlaceSource.FACE, "left", 99), (PlaceSource.FACE, "left", 100), (PlaceSource.BODY, "left", 98),
              (PlaceSource.FACE, "right", 100), (PlaceSource.FACE, "right", 900)]
    PersonManagerNode._on_poses(node, [FeaturePose(source, name, sensor, Pose.identity(), secs, 0)
                                       for source, sensor, secs in images for name in ("first", "second")])
    assert [call.args[:2] for call in node._stamps.note.call_args_list] == [
        ((source, sensor), (secs, 0)) for source, sensor, secs in images]
    assert node._sensed == genpy.Time(100) and node._reference.place.call_count == 2 * len(images)


def test_a_clock_that_has_jumped_is_told_once_and_looked_at_again_soon(monkeypatch):
    told = MagicMock()
    monkeypatch.setattr(module.rospy, "logwarn", told)
    node = PersonManagerNode.__new__(PersonManagerNode)
    node._register, node._store, node._is_clock_doubted = MagicMock(), MagicMock(clock_problem="1970"), False
    for _ in range(2):
        node._expire()
        assert node._next_expiry - time.monotonic() <= module.DOUBT_S
    assert told.call_count == 1
    node._store.clock_problem = ""
    node._expire()
    assert node._next_expiry - time.monotonic() > 2 * module.DOUBT_S


@pytest.mark.parametrize("age, across", [(0.0, (0.039, 0.041)), (0.4, (0.15, 0.25)), (60.0, (0.3, 0.5))])
def test_the_ellipse_on_the_page_grows_while_no_place_comes(age, across):
    """Until a second after the last one: places come all the time, unless time stands still."""
    location = Location("map", Pose(np.eye(3), np.array([2.0, 0.0, 1.6])), np.diag([0.04, 0.0016, 0.0016]), 10.0)
    person = MagicMock(id="ann", location=location, location_age=age, location_confidence=1.0,
                       engagement=Engagement.UNKNOWN)
    view = web.PeopleView.__new__(web.PeopleView)
    view._came, view._pictures = {}, MagicMock(frame="camera")
    shown = view._person(person)
    assert across[0] < np.sqrt(shown.covariance[1, 1]) < across[1] and shown.pose is location.pose
    person.location_confidence = 0.0
    assert view._person(person).pose is None
