"""What a node remembers of its parameters, and what it sets on a master that has lost them."""

from __future__ import annotations

import pytest

from hri_pipeline.ros import own_parameters
from hri_pipeline.ros.own_parameters import OwnParameters, ParametersLost, check_not_lost

NAME = "/robot/faces"
RUN, OTHER = "3f6e2d3e-8c1a-11ef-9d3c-0242ac110002", "4a7b1c22-8c1a-11ef-9d3c-0242ac110002"


class FakeMaster:
    """The parameter server: a tree, and the names that were set."""

    def __init__(self, tree):
        self.tree, self.were_set, self.refuses = tree, [], False

    def getParam(self, caller, name):
        assert caller == NAME
        value = self.tree
        for word in name.strip("/").split("/"):
            if not isinstance(value, dict) or word not in value:
                return [-1, "not set", 0]
            value = value[word]
        return [1, "", value]

    def setParam(self, caller, name, value):
        assert caller == NAME
        if self.refuses:
            return [0, "no", 0]
        self.were_set.append(name)
        words = name.strip("/").split("/")
        place = self.tree
        for word in words[:-1]:
            place = place.setdefault(word, {})
        place[words[-1]] = value
        return [1, "", 0]


@pytest.fixture(autouse=True)
def server(monkeypatch):
    """The master that rospy itself asks; None while it is away."""
    reached = {"master": None}

    def set_param(name, value):
        if reached["master"] is None:
            raise OSError("away")
        reached["master"].setParam(NAME, NAME + "/" + name[1:], value)

    def get_param(name, default):
        code, _, value = reached["master"].getParam(NAME, name)
        return value if code == 1 else default

    monkeypatch.setattr(own_parameters.rospy, "get_name", lambda: NAME)
    monkeypatch.setattr(own_parameters.rospy, "set_param", set_param)
    monkeypatch.setattr(own_parameters.rospy, "get_param", get_param)
    return reached


def tree():
    return {"robot": {"faces": {"expression": False, "size": 3, "more": {"a": 1, "b": 2}}},
            "humans": {"reference_frame": "odom"}, "other": {"x": 1}}


def kept():
    parameters = OwnParameters()
    parameters.keep(parameters.read(FakeMaster(tree())))
    return parameters


def test_all_of_its_own_and_of_the_stack_comes_back_and_nothing_else():
    new = FakeMaster({})
    assert kept().put_back(new) == [NAME, "/humans"]
    expected = tree()
    del expected["other"]
    assert new.tree == expected
    assert kept().put_back(new) == []


def test_what_somebody_has_set_stays():
    new = FakeMaster({"robot": {"faces": {"size": 7, "more": {"b": 9}}}, "humans": 5})
    assert sorted(kept().put_back(new)) == [NAME + "/expression", NAME + "/more/a"]
    assert new.tree == {"robot": {"faces": {"expression": False, "size": 7, "more": {"a": 1, "b": 9}}}, "humans": 5}


def test_a_node_without_parameters_sets_none():
    parameters, new = OwnParameters(), FakeMaster({})
    parameters.keep(parameters.read(FakeMaster({"robot": {"faces": {}}})))
    assert parameters.put_back(new) == [] and new.tree == {}


def test_a_refusal_is_told():
    new = FakeMaster({})
    new.refuses = True
    with pytest.raises(OSError, match="/robot/faces"):
        kept().put_back(new)


def test_live_changes_are_kept_also_while_the_master_is_away(server):
    parameters = kept()
    server["master"] = FakeMaster(tree())
    parameters.set("size", 4)
    assert server["master"].tree["robot"]["faces"]["size"] == 4
    server["master"] = None
    with pytest.raises(OSError):
        parameters.set("expression", True)
    new = FakeMaster({})
    parameters.put_back(new)
    assert new.tree["robot"]["faces"] == {"expression": True, "size": 4, "more": {"a": 1, "b": 2}}


def test_what_was_read_before_a_change_does_not_undo_it(server):
    parameters = kept()
    server["master"] = FakeMaster(tree())
    before = parameters.read(FakeMaster(tree()))
    parameters.set("size", 4)
    parameters.keep(before)
    new = FakeMaster({})
    parameters.put_back(new)
    assert new.tree["robot"]["faces"]["size"] == 4
    parameters.keep(parameters.read(FakeMaster({"robot": {"faces": {"size": 8}}})))
    new = FakeMaster({})
    parameters.put_back(new)
    assert new.tree == {"robot": {"faces": {"size": 8}}}


@pytest.mark.parametrize("folder, there, lost", [
    (RUN, {}, True),                                                        # a bare rosmaster
    (RUN, {"run_id": OTHER}, True),
    (RUN, {"run_id": RUN}, False),                                          # a launch that gives no parameters
    (RUN, {"run_id": OTHER, "robot": {"faces": {"size": 3}}}, False),       # put back
    ("logs", {"run_id": OTHER}, False),                                     # not by roslaunch
    (None, {"run_id": OTHER}, False),
])
def test_parameters_that_went_with_the_master_of_roslaunch_are_missed(server, folder, there, lost):
    server["master"] = FakeMaster(there)
    arguments = ["faces", "__name:=faces"] + (["__log:=/root/.ros/log/%s/faces-1.log" % folder] if folder else [])
    if not lost:
        check_not_lost(arguments)
        return
    with pytest.raises(ParametersLost, match="/robot/faces has no parameters"):
        check_not_lost(arguments)
