#!/usr/bin/env python3
"""One tree of diagnostics: every status of every node in one branch, nothing beside them; a node that ends is seen
there."""

from __future__ import annotations

import unittest
from pathlib import Path
from typing import Dict, List, Set

import rosnode
import rospy
import rostest
import yaml
from bag_stage import wait_for
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from sensors import Sensors

GROUPS = Path(__file__).resolve().parents[1] / "launch" / "diagnostics.yaml"
BRANCHES = {"Sensors": {"image_source", "sound_source"}, "Vision/Faces": {"hri_faces"}, "Vision/Bodies": {"hri_bodies"},
            "Vision/Faces and bodies": set(), "Sound/Voices": {"hri_voices"}, "Sound/Speakers": {"hri_voice_matcher"},
            "Persons/Faces with bodies": {"hri_face_body_matcher"}, "Persons/Person manager": {"hri_person_manager"},
            "Interactions": {"hri_interactions"}, "Overlay": {"hri_overlay"}}
NODES = set().union(*BRANCHES.values())
START_S = 90.0
STALE = 3


def patterns(analyzers: dict, path: str = "") -> Dict[str, List[str]]:
    """Return what the names of each branch of the file contain."""
    found: Dict[str, List[str]] = {}
    for analyzer in analyzers.values():
        here = path + analyzer["path"]
        found.update(patterns(analyzer["analyzers"], here + "/") if "analyzers" in analyzer
                     else {here: analyzer["contains"]})
    return found


class Tree:
    """The newest message of an aggregator."""

    def __init__(self, topic: str, root: str) -> None:
        self._root = root + "/"
        self._newest: List[DiagnosticStatus] = []
        rospy.Subscriber(topic, DiagnosticArray, self._take)

    def _take(self, message: DiagnosticArray) -> None:
        self._newest = message.status

    def levels(self) -> Dict[str, int]:
        """Level of each path below the root."""
        return {status.name[len(self._root):]: status.level for status in self._newest
                if status.name.startswith(self._root)}

    def leaves(self) -> Dict[str, str]:
        """{name of a status as its node gives it: path of its branch}."""
        found = {}
        for status in self._newest:
            branch, _, name = status.name.rpartition("/")
            if ": " in name:
                found[name] = branch[len(self._root):]
        return found


class DiagnosticsTest(unittest.TestCase):

    @classmethod
    def setUpClass(cls) -> None:
        rospy.init_node("test_diagnostics")
        cls.said: Set[str] = set()
        rospy.Subscriber("/diagnostics", DiagnosticArray,
                         lambda message: cls.said.update(status.name for status in message.status), queue_size=100)
        cls.tree = Tree("/diagnostics_agg", "/humans")
        cls.robots = Tree("/robot/diagnostics_agg", "/Robot")
        cls.sensors = Sensors(rate=4.0)

    @classmethod
    def tearDownClass(cls) -> None:
        cls.sensors.close()

    def test_1_every_status_is_in_the_branch_of_its_node(self) -> None:
        wait_for(lambda: {name.split(":")[0] for name in self.tree.leaves()} >= NODES,
                 lambda: "nodes in the tree: {}".format(sorted(self.tree.leaves())), START_S)
        wait_for(lambda: "Missing" not in str(self.tree._newest), "nothing expected is missing")
        wait_for(lambda: set(self.tree.leaves()) >= self.said,
                 lambda: "not in the tree: {}".format(self.said - set(self.tree.leaves())))
        leaves = self.tree.leaves()
        self.assertGreater(len(leaves), 20)
        self.assertEqual({name: branch for name, branch in leaves.items()
                          if name.split(":")[0] not in BRANCHES.get(branch, set())}, {})
        self.assertNotIn("Other", self.tree.levels())

    def test_2_the_branches_are_those_of_the_file_and_each_name_fits_one(self) -> None:
        found = patterns(yaml.safe_load(GROUPS.read_text(encoding="utf-8"))["analyzers"])
        self.assertEqual(set(found), set(BRANCHES))
        others = {"hri_vision: {}".format(task) for task in ("input", "pipeline", "faces", "bodies")}
        for name in self.said | others | {"scene_simulator: scene", "left/hri_faces: input"}:
            branches = [branch for branch, texts in found.items() if any(text in name for text in texts)]
            self.assertEqual(len(branches), 1, "{} is in {}".format(name, branches))

    def test_3_a_branch_without_a_node_is_well(self) -> None:
        self.assertEqual(self.tree.levels()["Vision/Faces and bodies"], DiagnosticStatus.OK)

    def test_4_the_aggregator_of_a_robot_takes_the_groups_as_a_branch(self) -> None:
        wait_for(lambda: set(self.robots.leaves()) >= self.said, lambda: str(sorted(self.robots.leaves())))
        branches = set(self.robots.leaves().values())
        self.assertEqual({branch.split("/")[0] for branch in branches}, {"Humans"})
        self.assertEqual(self.robots.levels()["Motors"], DiagnosticStatus.OK)

    def test_5_a_node_that_ends_is_stale_in_its_branch(self) -> None:
        rosnode.kill_nodes(["/hri_overlay"])
        wait_for(lambda: self.tree.levels().get("Overlay") == STALE, lambda: str(self.tree.levels()))
        wait_for(lambda: self.tree.levels().get("Overlay/hri_overlay: overlay") == STALE,
                 lambda: str(self.tree.levels()))
        self.assertNotEqual(self.tree.levels()["Vision/Faces"], STALE)


if __name__ == "__main__":
    rostest.rosrun("ros4hri", "diagnostics", DiagnosticsTest)
