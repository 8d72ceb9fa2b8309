"""The web page: who may see it, what may be asked for, and what it is told."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from hri_person_manager.core.web import (
    Access,
    Action,
    PersonOnPage,
    RequestError,
    WebSettings,
    action_of,
    from_above,
    is_local,
    known_data,
    page_state,
)
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.parameters import ParameterError

TOKEN = "abcdefghijklmnop"


def at(x: float, y: float, degrees: float = 0.0) -> Pose:
    turn = math.radians(degrees)
    return Pose(np.array([[math.cos(turn), -math.sin(turn), 0.0], [math.sin(turn), math.cos(turn), 0.0],
                          [0.0, 0.0, 1.0]]), np.array([x, y, 1.6]))


@pytest.mark.parametrize("host", ["localhost:8080", "127.0.0.1:8080", "[::1]:8080", "127.0.0.1", "LOCALHOST:1",
                                  "robot.example.org:8080"])
def test_this_machine_is_known_by_these_names(host: str) -> None:
    Access("127.0.0.1", ["robot.example.org"], "").check_host(host)


@pytest.mark.parametrize("host", ["evil.example", "evil.example:8080", "localhost.evil.example", "192.168.1.7:8080", "",
                                  "[::1", "127.0.0.1.evil.example", "evil.example@localhost:x", "[::1]evil.example"])
def test_a_name_of_somebody_else_is_refused(host: str) -> None:
    with pytest.raises(RequestError) as refused:
        Access("127.0.0.1", [], "").check_host(host)
    assert refused.value.status == 403


def test_on_a_network_addresses_are_fine_and_names_of_others_are_not() -> None:
    access = Access("0.0.0.0", ["robot"], TOKEN)
    for host in ("192.168.1.7:8080", "robot:8080", "[fe80::1]:8080", "localhost:8080"):
        access.check_host(host)
    with pytest.raises(RequestError):
        access.check_host("evil.example:8080")


@pytest.mark.parametrize("given", ["", "abcdefghijklmnoq", "abcdefghijklmno", TOKEN + "x", "é" * 16, "\udc80"])
def test_a_wrong_token_is_refused(given: str) -> None:
    access = Access("0.0.0.0", [], TOKEN)
    assert access.needs_token
    access.check_token(TOKEN)
    with pytest.raises(RequestError, match="token"):
        access.check_token(given)


def test_without_a_token_none_is_needed() -> None:
    access = Access("127.0.0.1", [], "")
    assert not access.needs_token
    access.check_token("")


@pytest.mark.parametrize("header, origin, kind", [
    (None, "http://localhost:8080", "application/json"), ("1", "http://evil.example", "application/json"),
    ("1", "null", "application/json"), ("1", "http://[", "application/json"),
    ("1", "http://localhost:8081", "application/json"),
    ("1", None, "text/plain"), ("1", None, "application/x-www-form-urlencoded"), ("0", None, "application/json")],
    ids=["no header", "other page", "null", "no address", "other port", "text", "form", "other header"])
def test_an_action_of_another_page_is_refused(header: str, origin: str, kind: str) -> None:
    access = Access("127.0.0.1", [], "")
    with pytest.raises(RequestError):
        access.check_action(header, origin, "localhost:8080", kind)


def test_an_action_of_this_page_or_of_a_program_is_taken() -> None:
    access = Access("127.0.0.1", [], "")
    access.check_action("1", "http://localhost:8080", "localhost:8080", "application/json; charset=utf-8")
    access.check_action("1", None, "localhost:8080", "application/json")


@pytest.mark.parametrize("address, local", [("127.0.0.1", True), ("127.1.2.3", True), ("::1", True),
                                            ("localhost", True), ("0.0.0.0", False), ("::", False),
                                            ("192.168.1.7", False)])
def test_which_addresses_reach_this_machine_only(address: str, local: bool) -> None:
    assert is_local(address) is local


@pytest.mark.parametrize("address", ["", "robot", "127.0.0.1:80", "300.1.1.1"])
def test_what_is_no_address_is_refused(address: str) -> None:
    with pytest.raises(ParameterError, match="address"):
        is_local(address)


def test_by_default_nobody_else_is_served() -> None:
    assert is_local(WebSettings().address)


@pytest.mark.parametrize("body, words", [
    (b"", "JSON"), (b"\xff", "JSON"), (b"[" * 100000, "JSON"), (b"[]", "command"), (b"{}", "command"),
    (b'{"command": ["list"]}', "command"), (b'{"command": "reset"}', "command"), (b'{"command": "name"}', "id"),
    (b'{"command": "forget", "id": "../x"}', "id"), (b'{"command": "forget", "id": 5}', "id"),
    (b'{"command": "export", "id": ""}', "id"),
    (b'{"command": "name", "id": "ada", "name": 3}', "name"), (b'{"command": "enrol", "id": "ada"}', "agree"),
    (b'{"command": "enrol-new", "id": "ada", "consent": "true"}', "agree"),
    (b'{"command": "enrol", "id": "ada", "consent": 1}', "agree"),
    (b'{"command": "name", "id": "ada", "name": "\\ud800x"}', "UTF-8")], ids=range(16))
def test_bad_requests_are_refused_with_the_reason(body: bytes, words: str) -> None:
    with pytest.raises(RequestError, match=words) as refused:
        action_of(body)
    assert refused.value.status == 400


def test_requests_are_read() -> None:
    assert action_of(b'{"command": "list", "id": 7}') == Action("list")
    assert action_of('{"command": "name", "id": "ada", "name": " Ada Ø "}'.encode()) == Action("name", "ada", "Ada Ø")
    assert action_of(b'{"command": "enrol", "id": "ada", "consent": true}') == Action("enrol", "ada")


def test_the_page_is_told_of_a_person() -> None:
    covariance = np.diag([0.04, 0.01, 0.5])
    person = PersonOnPage("ada", "Ada", False, 12.34, "engaged", True, "standing", "", 1.0, "map", at(2.0, 0.5, 90.0),
                          covariance)
    state = json.loads(json.dumps(page_state([person], [["ada", ""], ["ada"]], ("map", at(0.0, 0.0), False), "")))
    told = state["people"][0]
    assert {key: told[key] for key in ("id", "name", "anonymous", "since", "engagement", "speaking", "posture",
                                       "looks_at")} == {
        "id": "ada", "name": "Ada", "anonymous": False, "since": 12.3, "engagement": "engaged", "speaking": True,
        "posture": "standing", "looks_at": ""}
    place = told["place"]
    assert (place["x"], place["y"]) == (2.0, 0.5)
    assert place["heading"] == pytest.approx(math.pi / 2.0, abs=1e-3)
    # 95 % of a plane Gaussian lie within 2.448 standard deviations; the larger one is along x.
    assert place["ellipse"][:2] == pytest.approx([2.448 * 0.2, 2.448 * 0.1], abs=1e-3)
    assert abs(math.sin(place["ellipse"][2])) == pytest.approx(0.0, abs=1e-3)
    assert state["groups"] == [["ada", ""]]
    assert (state["robot"]["x"], state["robot"]["heading"]) == (0.0, 0.0)
    assert state["frame"] == "map"


def test_what_is_not_known_is_null() -> None:
    told = page_state([PersonOnPage("ada")], [], None, "no images arrive")
    assert told["people"][0]["place"] is told["people"][0]["looks_at"] is told["people"][0]["speaking"] is None
    assert told["robot"] is None and told["frame"] == "" and told["camera"] == "no images arrive"


@pytest.mark.parametrize("face, body", [(True, True), (True, False), (False, True), (False, False)])
def test_the_page_is_told_what_is_seen_of_a_person(face: bool, body: bool) -> None:
    told = page_state([PersonOnPage("ada", face=face, body=body)], [], None, "")["people"][0]
    assert (told["face"], told["body"]) == (face, body)


def test_in_the_frame_of_a_camera_forward_is_its_z() -> None:
    ahead = Pose(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]).T, np.array([0.5, 0.0, 3.0]))
    assert from_above(True) @ ahead.translation == pytest.approx([3.0, -0.5])
    for frame, of_pictures in (("camera_color_optical_frame", ""), ("head_camera", "head_camera")):
        state = page_state([PersonOnPage("ada", frame=frame, pose=ahead)], [], None, "", of_pictures)
        assert (state["people"][0]["place"]["x"], state["people"][0]["place"]["y"]) == (3.0, -0.5)


def test_a_map_has_one_frame() -> None:
    people = [PersonOnPage(name, frame=frame, pose=at(1.0, 0.0))
              for name, frame in (("a", "map"), ("b", "camera"), ("c", "map"))]
    state = page_state(people, [], ("camera", at(0.0, 0.0), False), "")
    assert [person["place"] is not None for person in state["people"]] == [True, False, True]
    assert state["robot"] is None


def test_numbers_that_are_none_never_reach_the_page() -> None:
    person = PersonOnPage("ada", frame="map", pose=at(math.nan, 0.0), covariance=np.eye(3))
    other = PersonOnPage("eve", frame="map", pose=at(1.0, 0.0), covariance=np.full((3, 3), np.inf))
    state = page_state([person, other], [], None, "")
    json.dumps(state, allow_nan=False)
    assert state["people"][0]["place"] is None and state["people"][1]["place"]["ellipse"] is None


def test_anonymous_people_are_not_among_the_known() -> None:
    found = known_data(["ada", "eve"], ["Ada", ""], [False, True], [True, False], [True, True], [5.0, 6.0])
    assert found == [{"id": "ada", "name": "Ada", "enrolled": True, "here": True, "last_seen": 5.0}]
