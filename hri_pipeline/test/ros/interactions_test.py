#!/usr/bin/env python3
"""Gazes, groups and engagement from outside, with REP-155's types and two cameras."""

import unittest

import numpy as np
import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray
from interaction_stage import Latest, Stage
from visualization_msgs.msg import MarkerArray

from hri_msgs.msg import EngagementLevel, Gaze, GazesStamped, Group
from hri_pipeline.core.geometry import Pose
from hri_pipeline.testing import wait_for

WAIT_S = 20.0
LEFT, RIGHT = "left_optical_frame", "right_optical_frame"
UPRIGHT = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


class InteractionsTest(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        cls.stage = Stage()
        # Two cameras 2 m apart look along x; the robot's head is between them, and looks there too (x forward).
        cls.stage.fix([("map", LEFT, Pose(UPRIGHT, np.array([0.0, 1.0, 1.4]))),
                       ("map", RIGHT, Pose(UPRIGHT, np.array([0.0, -1.0, 1.4]))),
                       ("map", "robot_head", Pose(np.eye(3), np.array([0.0, 0.0, 1.4])))])
        cls.gazes, cls.gazing, cls.groups, cls.markers, cls.states = [], [], [], [], {}
        rospy.Subscriber("/humans/interactions/gaze", GazesStamped, cls.gazes.append, queue_size=100)
        rospy.Subscriber("/humans/interactions/gazing", Gaze, cls.gazing.append, queue_size=100)
        rospy.Subscriber("/humans/interactions/groups", Group, cls.groups.append, queue_size=100)
        rospy.Subscriber("visualization/interactions", MarkerArray, cls.markers.append, queue_size=10)
        rospy.Subscriber("/diagnostics", DiagnosticArray, lambda message: cls.states.update(
            {status.name: status for status in message.status}), queue_size=10)

    @classmethod
    def tearDownClass(cls):
        cls.stage.close()

    def wait_for_gazes(self, wanted, what):
        del self.gazes[:]
        return wait_for(lambda: self.gazes and self.pairs(self.gazes[-1]) == wanted and self.gazes[-1], WAIT_S,
                        Latest(what, self.gazes))

    @staticmethod
    def pairs(message):
        return {(gaze.sender, gaze.receiver) for gaze in message.gazes}

    def test_1_two_cameras_closed_eyes_and_groups(self):
        # In map: ann at (1.5, 0.5), seen by the left camera, bob at (1.5, -0.5), by the right one; both look at each
        # other.
        ann, bob = np.array([0.5, 0.0, 1.5]), np.array([-0.5, 0.0, 1.5])
        self.stage.people = {"ann": (LEFT, ann, np.array([1.5, 0.0, 1.5])),
                             "bob": (RIGHT, bob, np.array([-1.5, 0.0, 1.5]))}
        message = self.wait_for_gazes({("ann", "bob"), ("bob", "ann")}, "mutual gaze across two cameras")
        self.assertEqual(message.header.frame_id, "map")
        self.assertIn(message.header.stamp, self.stage.stamps)
        self.assertTrue(all(0.3 < gaze.confidence <= 1.0 for gaze in message.gazes))
        self.assertEqual(len({item.header.stamp for item in self.gazes}), len(self.gazes))
        wait_for(lambda: {("ann", "bob"), ("bob", "ann")} <= {(gaze.sender, gaze.receiver) for gaze in self.gazing},
                 WAIT_S, "gazing")
        group = wait_for(lambda: self.groups and self.groups[-1], WAIT_S, "a group")
        self.assertTrue({"ann", "bob"} <= set(group.members), group)
        wait_for(lambda: any(item.markers for item in self.markers), WAIT_S, "markers")

        self.stage.people["ann"] = (LEFT, ann, None)
        self.wait_for_gazes({("bob", "ann")}, "closed eyes")
        # The head of the robot is 1 m to the right of the left camera.
        self.stage.people["ann"] = (LEFT, ann, np.array([1.0, 0.0, 0.0]))
        self.wait_for_gazes({("ann", ""), ("bob", "ann")}, "ann at the robot")
        # With REP-155 the frame of the gaze goes on while the eyes are closed: the action units tell it.
        self.stage.lids["ann"] = 0.9
        self.wait_for_gazes({("bob", "ann")}, "closed eyes with a frame of the gaze")
        self.stage.lids["ann"] = 0.1
        self.wait_for_gazes({("ann", ""), ("bob", "ann")}, "open eyes")

    def test_1b_who_is_not_tracked_any_more_leaves_the_group_at_once_and_its_id_stays(self):
        ann, bob, cho = np.array([0.5, 0.0, 1.5]), np.array([-0.5, 0.0, 1.5]), np.array([1.0, 0.0, 2.1])
        pair = {"ann": (LEFT, ann, np.array([1.5, 0.0, 1.5])), "bob": (RIGHT, bob, np.array([-1.5, 0.0, 1.5]))}
        self.stage.people = dict(pair, cho=(LEFT, cho, np.array([1.0, 0.0, 0.0])))
        three = wait_for(lambda: {"ann", "bob", "cho"} <= set(self.groups[-1].members) and self.groups[-1], WAIT_S,
                         "three")
        self.stage.people, left = pair, rospy.Time.now()
        two = wait_for(lambda: "cho" not in self.groups[-1].members and self.groups[-1], WAIT_S, "two")
        self.assertTrue({"ann", "bob"} <= set(two.members), two)
        self.assertEqual(two.group_id, three.group_id)
        self.assertLess((two.header.stamp - left).to_sec(), 0.8, "before who is not seen for a moment leaves")
        text = "{} (2 + robot)".format(two.group_id)
        wait_for(lambda: [marker.text for marker in self.markers[-1].markers if marker.text] == [text], WAIT_S, text)

    def test_2_engagement_is_latched_and_ends_unknown(self):
        heard = []
        here, robot = np.array([1.0, 0.0, 1.2]), np.array([1.0, 0.0, 0.0])
        self.stage.people = {"cho": (LEFT, here, np.array([9.0, 0.0, 1.2]))}
        subscriber = rospy.Subscriber("/humans/persons/cho/engagement_status", EngagementLevel, heard.append,
                                      queue_size=100)

        def course():
            return [item.level for item in heard]

        wait_for(lambda: EngagementLevel.DISENGAGED in course(), WAIT_S, "disengaged")
        self.stage.people = {"cho": (LEFT, here, robot)}
        wait_for(lambda: EngagementLevel.ENGAGED in course(), WAIT_S, "engaged")
        late = []
        latecomer = rospy.Subscriber("/humans/persons/cho/engagement_status", EngagementLevel, late.append,
                                     queue_size=10)
        wait_for(lambda: late, WAIT_S, "the latched level")
        self.assertEqual(late[0].level, heard[-1].level)
        self.stage.people = {"cho": (LEFT, here, np.array([9.0, 0.0, 1.2]))}
        wait_for(lambda: course()[-1] == EngagementLevel.DISENGAGED, WAIT_S, "disengaged again")
        order = course()
        self.assertEqual(order[order.index(EngagementLevel.DISENGAGED):], [
            EngagementLevel.DISENGAGED, EngagementLevel.ENGAGING, EngagementLevel.ENGAGED, EngagementLevel.DISENGAGING,
            EngagementLevel.DISENGAGED])
        # Still tracked, but no frame comes any more.
        self.stage.people = {"cho": (None, here, robot)}
        wait_for(lambda: course()[-1] == EngagementLevel.UNKNOWN, WAIT_S, "unknown")
        subscriber.unregister()
        latecomer.unregister()

    def test_2b_who_is_tracked_without_a_place_stays_in_the_engagement(self):
        heard = []
        there = np.array([9.0, 0.0, 1.2])
        ivy, hal = (LEFT, np.array([-1.0, 0.0, 1.2]), there), np.array([1.0, 0.0, 1.2])
        self.stage.people = {"hal": (LEFT, hal, there), "ivy": ivy}
        subscriber = rospy.Subscriber("/humans/persons/hal/engagement_status", EngagementLevel,
                                      lambda message: heard.append(message.level))
        wait_for(lambda: heard[-1:] == [EngagementLevel.DISENGAGED], WAIT_S, "disengaged")
        # Beside somebody who is seen: nobody rests, and hal is neither forgotten nor left as he was.
        self.stage.people = {"hal": (None, hal, there), "ivy": ivy}
        wait_for(lambda: heard[-1] == EngagementLevel.UNKNOWN, WAIT_S, "unknown, as hal is not seen")
        self.stage.people = {"hal": (LEFT, hal, there), "ivy": ivy}
        wait_for(lambda: heard[-1] == EngagementLevel.DISENGAGED, WAIT_S, "seen again")
        subscriber.unregister()

    def test_3_who_has_gone_leaves_an_empty_list(self):
        self.stage.people = {"dan": (LEFT, np.array([1.0, 0.0, 2.0]), np.array([1.0, 0.0, 0.0]))}
        self.wait_for_gazes({("dan", "")}, "dan at the robot")
        self.stage.people = {}
        self.wait_for_gazes(set(), "the empty list")
        wait_for(lambda: not [name for name,
                              _ in rospy.get_published_topics("/humans/persons/dan") if "engagement" in name], WAIT_S,
                 "the end of dan's topic")

    def test_4_time_that_goes_back_begins_anew(self):
        self.stage.people = {"eve": (LEFT, np.array([1.0, 0.0, 2.0]), np.array([1.0, 0.0, 0.0]))}
        self.wait_for_gazes({("eve", "")}, "eve at the robot")
        self.stage.shift = -30.0
        begun = rospy.Time.now()
        message = wait_for(lambda: self.gazes[-1].header.stamp < begun - rospy.Duration(20.0) and self.gazes[-1].gazes
                           and self.gazes[-1],
                           WAIT_S, "a gaze with the earlier stamps")
        self.assertEqual(self.pairs(message), {("eve", "")})
        self.stage.shift = 0.0
        wait_for(lambda: self.gazes[-1].header.stamp > begun, WAIT_S, "the present again")

    def test_4b_bodies_that_lag_behind_the_faces_are_no_jump_of_time(self):
        place, robot = np.array([1.0, 0.0, 2.0]), np.array([1.0, 0.0, 0.0])
        self.stage.people = {"ian": (LEFT, place, robot)}
        self.wait_for_gazes({("ian", "")}, "ian at the robot")
        self.stage.name_body("ian", "bian")
        before = self.time_jumps()
        for _ in range(3):
            # The next face comes late, on a busy machine, and meanwhile a body of an image of two seconds ago.
            self.stage.people = {"ian": (None, place, robot)}
            rospy.sleep(0.8)
            self.stage.send([(LEFT, "body_bian", Pose(np.eye(3), place))], rospy.Time.now() - rospy.Duration(2.0))
            self.stage.people = {"ian": (LEFT, place, robot)}
            self.wait_for_gazes({("ian", "")}, "ian at the robot again")
        self.assertEqual(self.time_jumps(), before)

    def test_4c_a_camera_whose_clock_is_ahead_hides_nobody(self):
        self.stage.ahead = {LEFT: 12.0}
        ann = (LEFT, np.array([0.5, 0.0, 1.5]), np.array([1.5, 0.0, 1.5]))
        bob = (RIGHT, np.array([-0.5, 0.0, 1.5]), np.array([-1.5, 0.0, 1.5]))
        self.stage.people = {"ann": ann, "bob": bob}
        self.wait_for_gazes({("ann", "bob"), ("bob", "ann")}, "mutual gaze across cameras of different clocks")
        before = self.time_jumps()
        # Who is seen by that camera leaves, and the others go on at once.
        robot = np.array([-1.0, 0.0, 0.0])
        self.stage.people = {"bob": (RIGHT, bob[1], robot)}
        self.wait_for_gazes({("bob", "")}, "bob at the robot")
        begun = rospy.get_time()
        self.stage.people = {"bob": bob, "ann": ann}
        self.wait_for_gazes({("ann", "bob"), ("bob", "ann")}, "mutual gaze again")
        self.assertLess(rospy.get_time() - begun, 5.0)
        self.assertEqual(self.time_jumps(), before)
        self.stage.ahead, self.stage.people = {}, {}

    def time_jumps(self):
        # The first ones may tell of an earlier moment.
        for _ in range(3):
            self.states.pop("hri_interactions: location", None)
            state = wait_for(lambda: self.states.get("hri_interactions: location"), WAIT_S, "diagnostics")
        return {item.key: item.value for item in state.values}["time jumps"]

    def test_5_garbage_ends_nothing(self):
        self.stage.people = {"fay": (LEFT, np.array([np.nan, 0.0, 2.0]), np.array([1.0, 0.0, 0.0])),
                             "gil": (LEFT, np.array([1.0, 0.0, 2.0]), np.array([1.0, 0.0, 0.0]))}
        self.wait_for_gazes({("gil", "")}, "gil beside a face without a place")
        state = wait_for(lambda: self.states.get("hri_interactions: location"), WAIT_S, "diagnostics")
        values = wait_for(lambda: {item.key: item.value for item in self.states["hri_interactions: location"].values
                                   if item.key == "transforms refused" and int(item.value)}, WAIT_S,
                          "refused transforms")
        self.assertGreater(int(values["transforms refused"]), 0)
        self.assertEqual(state.hardware_id, "/hri_interactions")
        # A stack without a microphone is a legal one.
        voices = wait_for(lambda: self.states.get("hri_interactions: voices"), WAIT_S, "diagnostics of voices")
        self.assertIn("no publisher on /humans/voices/tracked", voices.message)
        self.assertEqual(voices.level, 0)
        self.assertEqual({item.key: item.value
                          for item in self.states["hri_interactions: interactions"].values}["errors"], "0")


if __name__ == "__main__":
    rospy.init_node("interactions_test")
    rostest.rosrun("hri_pipeline", "interactions", InteractionsTest)
