"""The service of the people a node knows: each command reaches the gallery, and what is said of the disk is true;
without a master."""

import json
from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest

from hri_pipeline.core.recognition.gallery import GalleryError, UnknownPersonError
from hri_pipeline.ros import gallery_service
from hri_pipeline.ros.gallery_service import GalleryService
from hri_pipeline.srv import GalleryRequest


class People:
    """Known people by id; `calls` has what was changed, `written` what of it is on the disk."""

    def __init__(self):
        self.known, self.calls, self.written = {"ann", "bob"}, [], []
        self.fault = ""

    def flush(self):
        if self.fault:
            raise OSError(self.fault)
        self.written = list(self.calls)

    def forget(self, person):
        self.calls.append(("forget", person))
        was_known = person in self.known
        self.known.discard(person)
        return was_known

    def forget_all(self):
        self.calls.append(("forget_all",))
        self.known.clear()

    def merge(self, source, target):
        self.export(source)
        self.calls.append(("merge", source, target))
        self.known.discard(source)

    def enrol(self, feature, person, confirm=False):
        if not confirm and person not in ("", "ann"):
            raise GalleryError("the face looks like ann")
        self.calls.append(("enrol", feature, person))
        return person or "new"

    def export(self, person):
        if person not in self.known:
            raise UnknownPersonError("there is no person {!r}".format(person))
        return SimpleNamespace(id=person, templates=[1, 2], enrolled=1)

    def list_known(self):
        return sorted(self.known)


@pytest.fixture()
def people():
    return People()


@pytest.fixture()
def service(people, monkeypatch):
    monkeypatch.setattr(gallery_service, "rospy", MagicMock())
    made = GalleryService(people, people.flush)
    yield made
    made.close()


def ask(service, command, identity="", other=""):
    return service._answer(GalleryRequest(command=command, id=identity, other=other))


def test_each_command_reaches_who_knows_people(service, people):
    assert json.loads(ask(service, "list").data) == ["ann", "bob"]
    assert json.loads(ask(service, "export", "ann").data) == {"id": "ann", "templates": 2, "enrolled": True}
    assert ask(service, "enrol", "", "face1").id == "new" and ask(service, "enrol", "ann", "face1").id == "ann"
    refused = ask(service, "enrol", "carl", "face1")
    assert not refused.success and not refused.unknown and "looks like ann" in refused.message
    assert ask(service, "enrol_new", "carl", "face1").id == "carl"
    assert ask(service, "merge", "ann", "bob").success and people.known == {"ann"}
    assert people.calls[-1] == ("merge", "bob", "ann")
    assert ask(service, "forget_all").success and not people.known


def test_what_is_forgotten_or_merged_is_on_the_disk_when_the_answer_comes(service, people):
    for command in (("merge", "ann", "bob"), ("forget", "ann"), ("forget_all",)):
        assert ask(service, *command).success and people.written == people.calls


@pytest.mark.parametrize("command", [("forget", "ann"), ("forget_all",), ("merge", "ann", "bob")])
def test_nobody_is_told_that_somebody_is_forgotten_who_is_still_on_the_disk(service, people, command):
    people.fault = "the disk is full"
    answer = ask(service, *command)
    assert not answer.success and not answer.unknown and "the disk is full" in answer.message
    assert "the disk is full" in service.problem
    again = ask(service, *command)
    assert not again.success and not again.unknown and "the disk is full" in again.message
    people.fault = ""
    ask(service, *command)
    assert people.written == people.calls and service.problem == ""


def test_who_is_not_known_is_told_as_such_and_nonsense_is_refused(service, people):
    for command in (("forget", "carl"), ("export", "carl"), ("merge", "ann", "carl")):
        answer = ask(service, *command)
        assert not answer.success and answer.unknown and "carl" in answer.message
    before = list(people.calls)
    for command in (("forget", "../ann"), ("merge", "ann", "b b"), ("forgive", "ann"), ("",)):
        answer = ask(service, *command)
        assert not answer.success and not answer.unknown and answer.message
    assert people.calls == before and "forget, " in ask(service, "forgive").message


def test_what_is_left_is_written_at_the_end(service, people):
    ask(service, "enrol_new", "carl", "face1")
    service.close()
    service.close()
    assert people.written == [("enrol", "face1", "carl")]
    service._service.shutdown.assert_called_once()
    gallery_service.rospy.logerr.assert_not_called()


def test_what_cannot_be_written_at_the_end_is_said(service, people):
    people.fault = "the disk is full"
    ask(service, "enrol_new", "carl", "face1")
    service.close()
    assert "the disk is full" in str(gallery_service.rospy.logerr.call_args)
