#!/usr/bin/env python3
"""The scene simulator, the real person manager and the interactions node: who looks, stands together, is engaged, by
their ids."""

import threading
import unittest

import rospy
import rostest

from hri_msgs.msg import EngagementLevel, GazesStamped, GroupsStamped, IdsList
from hri_pipeline.testing import wait_for

PEOPLE = ["ann", "bob", "cho"]
LOOKS = {("ann", "bob"), ("bob", "ann"), ("cho", "")}
WAIT_S = 30.0


class TestInteractions(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        rospy.init_node("interactions_test")
        cls.lock = threading.Lock()
        cls.persons, cls.gazes, cls.groups, cls.levels = [], [], [], {}
        rospy.Subscriber("/humans/persons/tracked", IdsList, lambda message: cls.keep(cls.persons, sorted(message.ids)))
        rospy.Subscriber("/humans/interactions/gaze", GazesStamped, lambda message: cls.keep(
            cls.gazes, {(gaze.sender, gaze.receiver) for gaze in message.gazes}), queue_size=100)
        rospy.Subscriber("/humans/interactions/groups", GroupsStamped, lambda message: cls.keep(
            cls.groups, {group.group_id: set(group.members) for group in message.groups}), queue_size=100)
        for person in PEOPLE:
            rospy.Subscriber("/humans/persons/{}/engagement_status".format(person), EngagementLevel, cls.hear,
                             callback_args=person)

    @classmethod
    def keep(cls, heard, value):
        with cls.lock:
            heard.append(value)

    @classmethod
    def hear(cls, message, person):
        with cls.lock:
            cls.levels.setdefault(person, []).append(message.level)

    def latest(self, heard):
        with self.lock:
            return heard[-1] if heard else None

    def share(self, wanted, last=60):
        """Share of the last messages in which somebody looks."""
        with self.lock:
            recent = self.gazes[-last:]
        return sum(wanted in pairs for pairs in recent) / len(recent) if len(recent) == last else 0.0

    def told(self, last=60):
        """Ids in the last messages."""
        with self.lock:
            return {identity for pairs in self.gazes[-last:] for pair in pairs for identity in pair}

    def test_1_people_of_the_scene_are_tracked_by_their_names(self):
        wait_for(lambda: self.latest(self.persons) == PEOPLE, WAIT_S, "three persons, by their names")

    def test_2_gazes(self):
        for wanted in sorted(LOOKS):
            wait_for(lambda wanted=wanted: self.share(wanted) > 0.8, WAIT_S,
                     lambda wanted=wanted: "{} in {:.0f} % of the results".format(
                wanted, 100.0 * self.share(wanted)))
        # At first, until they are recognised, people have ids of their own.
        wait_for(lambda: self.told() <= set(PEOPLE) | {""}, WAIT_S,
                 lambda: "ids of persons only, not of faces: {}".format(self.told()))

    def test_3_the_two_who_talk_are_a_group_that_keeps_its_id(self):
        def pair():
            groups = self.latest(self.groups) or {}
            return next((identity for identity, members in groups.items() if members == {"ann", "bob"}), None)

        first = wait_for(pair, WAIT_S, lambda: "ann and bob in a group; {}".format(self.latest(self.groups)))
        count = len(self.groups)
        wait_for(lambda: len(self.groups) >= count + 10, WAIT_S, "groups go on")
        self.assertEqual(pair(), first)
        self.assertNotIn("cho", set().union(*self.latest(self.groups).values()))

    def test_4_engagement(self):
        def level(person):
            return self.latest(self.levels.get(person, []))

        wait_for(lambda: level("cho") == EngagementLevel.ENGAGED, WAIT_S, lambda: "cho engaged; {}".format(self.levels))
        for person in ("ann", "bob"):
            wait_for(lambda person=person: level(person) == EngagementLevel.DISENGAGED, WAIT_S,
                     lambda: "disengaged; {}".format(self.levels))


if __name__ == "__main__":
    rostest.rosrun("hri_person_manager", "interactions", TestInteractions)
