#!/usr/bin/env python3
"""The sample conversation: the voice of each turn goes to the face whose turn it is."""

import sys
import time
import unittest

import rospy
import rostest

from hri_msgs.msg import IdsList, IdsMatch

WAIT_S = 60.0
TURNS = 4


class TestSampleVoiceMatcher(unittest.TestCase):
    def test_turns_go_to_who_speaks(self):
        turns, matched = [], {}

        def on_speaker(message):
            """Keep whom the voice of the turn that has ended was matched with."""
            if turns:
                turns[-1]["found"] = matched.get(turns[-1]["voice"])
            turns.append({"voice": message.id1, "face": message.id2, "found": None})

        def on_match(message):
            if message.confidence > 0.0:
                matched[message.id1] = message.id2
            elif matched.get(message.id1) == message.id2:
                del matched[message.id1]

        seen = []
        rospy.Subscriber("/humans/faces/tracked", IdsList, lambda message: seen.append(message.header.stamp))
        rospy.Subscriber("/humans/candidate_matches", IdsMatch, on_match)
        rospy.Subscriber("/sample_conversation/speaker", IdsMatch, on_speaker)
        end = time.monotonic() + WAIT_S
        while len(turns) < TURNS + 1:
            self.assertLess(time.monotonic(), end, turns)
            time.sleep(0.05)
        right = sum(turn["found"] == turn["face"] for turn in turns[:TURNS])
        wrong = sum(turn["found"] not in (None, turn["face"]) for turn in turns[:TURNS])
        self.assertGreaterEqual(right, TURNS - 1, turns)
        self.assertLessEqual(wrong, 1, turns)
        self.assertLess(abs((rospy.Time.now() - seen[-1]).to_sec()), 3.0, "the list of faces is as old as the node")


if __name__ == "__main__":
    rospy.init_node("test_sample_voice_matcher")
    rostest.rosrun("hri_pipeline", "test_sample_voice_matcher", TestSampleVoiceMatcher, sys.argv)
