#!/usr/bin/env python3
"""Bodies that come back under new ids are told to be the persons of the earlier ones, by their clothes and places."""

import unittest

import numpy as np
import rospy
import rostest
from std_msgs.msg import String

from hri_msgs.msg import IdsList, IdsMatch, Skeleton2D
from hri_pipeline.testing import Camera, Latest, photograph, wait_for

START_S, WAIT_S, MATCH_S, TRIES = 60.0, 30.0, 10.0, 3
SEEN_S = 1.5
"""Who was seen for less than a second is not remembered."""
NOSE = 0


class BodyReturnsTest(unittest.TestCase):

    def setUp(self):
        self.picture = photograph(3)
        self.camera = Camera(self.picture)
        self.addCleanup(self.camera.close)
        self.tracked = Latest("/humans/bodies/tracked", IdsList)
        self.addCleanup(self.tracked.close)
        self.known = rospy.Publisher("/humans/persons/tracked", IdsList, latch=True, queue_size=1)
        self.matches = []
        self.listener = rospy.Subscriber("/humans/candidate_matches", IdsMatch, self.matches.append, queue_size=50)
        self.addCleanup(self.listener.unregister)

    def see_three(self):
        """{id: x of the nose} of the three bodies; on a loaded machine one may begin anew before it is seen long."""
        skeletons = {}

        def seen_for_long(body):
            if body not in skeletons:
                skeletons[body] = Latest("/humans/bodies/%s/skeleton2d" % body, Skeleton2D)
            heard = skeletons[body]
            return heard.value and (heard.value.header.stamp - heard.messages[0].header.stamp).to_sec() > SEEN_S

        ids = wait_for(lambda: self.tracked.value and len(self.tracked.value.ids) == 3 and all(
            [seen_for_long(body) for body in self.tracked.value.ids]) and self.tracked.value.ids, START_S,
            "three bodies in tracked that are seen for {:g} s".format(SEEN_S))
        places = {body: skeletons[body].value.skeleton[NOSE].x for body in ids}
        for skeleton in skeletons.values():
            skeleton.close()
        return places

    def matches_of(self, bodies):
        """The matches of these bodies, none before two of them have one."""
        found = [match for match in list(self.matches) if match.id1 in bodies]
        return found if len({match.id1 for match in found}) >= 2 else []

    def go_and_come_back(self):
        """Tell of persons with the three bodies; darkness, and the three again.

        Returns the persons' bodies, the places of the bodies before and after, and the matches of the new ones: none
        where a slow machine saw them too late, or for too short a time.
        """
        before = self.see_three()
        persons = {"p" + body: body for body in before}
        publishers = [rospy.Publisher("/humans/persons/%s/body_id" % person, String, latch=True, queue_size=1)
                      for person in persons]
        for publisher, body in zip(publishers, persons.values()):
            publisher.publish(String(body))
        self.known.publish(IdsList(ids=list(persons)))
        wait_for(lambda: all(publisher.get_num_connections() for publisher in publishers), WAIT_S,
                 "the node's interest")
        self.camera.show(np.zeros_like(self.picture))
        wait_for(lambda: not self.tracked.value.ids, WAIT_S, "an empty list")
        self.camera.show(self.picture)
        after = self.see_three()
        self.assertTrue(set(after).isdisjoint(before), "an id came back")
        try:
            return persons, before, after, wait_for(lambda: self.matches_of(after), MATCH_S, "matches")
        except AssertionError:
            return persons, before, after, []

    def test_new_bodies_are_matched_with_the_persons_of_the_earlier_ones(self):
        for _ in range(TRIES):
            persons, before, after, found = self.go_and_come_back()
            if found:
                break
        self.assertTrue(found, "no matches of two bodies of %s with persons: %s" % (sorted(after), self.matches))
        for match in found:
            self.assertEqual((match.id1_type, match.id2_type), (IdsMatch.BODY, IdsMatch.PERSON))
            self.assertGreaterEqual(match.confidence, 0.9)
            nearest = min(before, key=lambda body: abs(before[body] - after[match.id1]))    # noses, of guessed heads
            self.assertEqual(nearest, persons[match.id2], "somebody else's body")


if __name__ == "__main__":
    rospy.init_node("body_returns_test")
    rostest.rosrun("hri_fullbody", "body_returns", BodyReturnsTest)
