#!/usr/bin/env python3
"""The client library: people who come and go, lazy topics, both types of topics, frames, nothing left behind."""

import math
import os
import threading
import unittest

import rospy
import rostest
from geometry_msgs.msg import TransformStamped
from sensor_msgs.msg import JointState, RegionOfInterest
from std_msgs.msg import Bool, String
from tf2_msgs.msg import TFMessage

from hri_msgs.msg import (
    EngagementLevel,
    GazeSenderReceiver,
    GazesStamped,
    Group,
    GroupsStamped,
    IdsList,
    LiveSpeech,
    NormalizedRegionOfInterest2D,
)
from hri_pipeline.client import Engagement, Humans
from hri_pipeline.ros.rospy_compat import release
from hri_pipeline.testing import held_by, wait_for

WAIT = 10


class World:
    """Publishers of a test; lists are repeated once a second, as the stack does."""

    def __init__(self):
        self.publishers = {}
        self.lists = {}
        self.timer = rospy.Timer(rospy.Duration(1.0), self.repeat)

    def publish(self, topic, message, latch=True):
        if topic not in self.publishers:
            self.publishers[topic] = rospy.Publisher(topic, type(message), queue_size=10, latch=latch)
        self.publishers[topic].publish(message)
        return self.publishers[topic]

    def track(self, kind, *ids):
        self.lists[kind] = list(ids)
        self.publish("/humans/{}/tracked".format(kind), IdsList(ids=list(ids)))

    def place(self, parent, child, x, stamp, topic="/tf", turn=0.0):
        transform = TransformStamped(child_frame_id=child)
        transform.header.frame_id, transform.header.stamp = parent, rospy.Time.from_sec(stamp)
        transform.transform.translation.x = x
        transform.transform.rotation.z, transform.transform.rotation.w = math.sin(turn / 2), math.cos(turn / 2)
        self.publish(topic, TFMessage([transform]), latch=topic != "/tf")

    def repeat(self, _):
        for kind, ids in list(self.lists.items()):
            self.track(kind, *ids)

    def close(self):
        self.timer.shutdown()
        self.timer.join()
        for publisher in self.publishers.values():
            release(publisher)


class ClientTest(unittest.TestCase):

    def setUp(self):
        self.world = World()
        self.addCleanup(self.world.close)
        self.humans = Humans(patience=2.0)
        self.addCleanup(self.humans.close)

    def subscribers(self, topic):
        return self.world.publishers[topic].get_num_connections()

    def test_people_come_and_go(self):
        came, left, raised = [], [], threading.Event()

        def fail(person):
            raised.set()
            raise RuntimeError("on purpose")
        self.world.track("persons", "ann1")
        self.assertEqual(list(self.humans.persons), ["ann1"])   # the list is latched: the first question has its answer
        self.humans.on_person(fail)
        self.humans.on_person(came.append, left.append)
        self.world.track("persons", "ann1", "bob1")
        wait_for(lambda: [person.id for person in came] == ["ann1", "bob1"], WAIT,
                 "both are told, the one who was there too")
        self.assertTrue(raised.is_set())
        ann = self.humans.persons["ann1"]
        self.world.track("persons", "bob1")
        wait_for(lambda: [person.id for person in left] == ["ann1"], WAIT, "the leaving is told")
        self.assertFalse(ann.present)
        self.assertIs(self.humans.persons["bob1"], came[1])

    def test_a_callback_that_takes_its_time_holds_nobody_up(self):
        go_on, left = threading.Event(), []
        self.addCleanup(go_on.set)
        self.humans.on_person(lambda person: go_on.wait(60.0), left.append)
        for identity in ("aaaaa", "bbbbb"):
            self.world.track("persons", identity)
            wait_for(lambda wanted=identity: list(self.humans.persons) == [wanted], WAIT, identity)
        self.assertEqual(left, [])
        go_on.set()
        wait_for(lambda: [person.id for person in left] == ["aaaaa"], WAIT, "told afterwards")

    def test_values_of_a_person(self):
        for topic, message in (("face_id", String("fann2")), ("name", String("Ann")), ("anonymous", Bool(False)),
                               ("engagement_status", EngagementLevel(level=EngagementLevel.ENGAGED))):
            self.world.publish("/humans/persons/ann2/" + topic, message)
        self.world.track("persons", "ann2")
        self.world.track("faces", "fann2")
        ann = self.humans.persons["ann2"]
        self.assertEqual((ann.name, ann.anonymous, ann.engagement, ann.native_language),
                         ("Ann", False, Engagement.ENGAGED, ""))
        self.assertIs(ann.face, self.humans.faces["fann2"])
        self.assertIsNone(ann.body)
        self.world.publish("/humans/persons/ann2/face_id", String(""))
        wait_for(lambda: ann.face is None, WAIT, "the face is gone")

    def test_nothing_is_listened_to_before_it_is_asked_for(self):
        self.world.publish("/humans/persons/ann3/name", String("Ann"))
        self.world.publish("/humans/persons/ann3/anonymous", Bool(False))
        self.world.track("persons", "ann3")
        ann = self.humans.persons["ann3"]
        self.assertEqual(ann.name, "Ann")
        self.assertEqual((self.subscribers("/humans/persons/ann3/name"),
                          self.subscribers("/humans/persons/ann3/anonymous")),
                         (1, 0))
        self.world.track("persons")
        wait_for(lambda: not self.subscribers("/humans/persons/ann3/name"), WAIT, "the topic of who left is let go")
        self.assertEqual(ann.name, "Ann")

    def test_both_types_of_a_topic(self):
        self.world.track("faces", "fpa4", "fre4")
        self.world.track("voices", "vpa4", "vre4")
        self.world.publish("/humans/faces/fpa4/roi", RegionOfInterest(x_offset=10, y_offset=20, width=30, height=40))
        self.world.publish("/humans/faces/fre4/roi",
                           NormalizedRegionOfInterest2D(xmin=0.25, ymin=0.0, xmax=0.5, ymax=1.0))
        self.world.publish("/humans/voices/vpa4/speech", String("hello"))
        self.world.publish("/humans/voices/vre4/speech", LiveSpeech(final="good bye"))
        faces, voices = self.humans.faces, self.humans.voices
        self.assertEqual(wait_for(lambda: faces["fpa4"].roi, WAIT, "pixels").width, 30)
        self.assertEqual(wait_for(lambda: faces["fre4"].roi, WAIT, "parts of the image").width, 0.25)
        wait_for(lambda: (voices["vpa4"].speech, voices["vre4"].speech) == ("hello", "good bye"), WAIT, "both are read")

    def test_a_message_of_another_type_is_passed_over(self):
        self.world.track("faces", "fodd5")
        self.world.publish("/humans/faces/fodd5/landmarks", String("no landmarks"))
        face = self.humans.faces["fodd5"]
        self.assertIsNone(face.landmarks)
        wait_for(lambda: self.subscribers("/humans/faces/fodd5/landmarks"), WAIT, "it is listened to")
        self.assertIsNone(face.landmarks)

    def test_groups_that_come_one_by_one_are_all_there(self):
        """REP-155 has a message for each group; all of a moment are sent at once."""
        names = ["g{}".format(number) for number in range(8)]
        topic = rospy.Publisher("/humans/interactions/groups", Group, queue_size=50)
        self.addCleanup(release, topic)
        self.assertEqual(self.humans.groups, [])
        wait_for(topic.get_num_connections, WAIT, "the client")
        for _ in range(5):
            for name in names:
                topic.publish(Group(group_id=name, members=["ann" + name, "bob" + name]))
            rospy.sleep(0.2)
            self.assertEqual(sorted(group.id for group in self.humans.groups), names)
            with self.humans._lock:
                self.humans._groups.clear()

    def test_subscribers_of_the_program_itself_come_before(self):
        own = self.own_subscribers("ann10")
        person, pose = self.placed_person("ann10")
        self.both_hear(person, pose, own)

    def test_subscribers_of_the_program_itself_come_after(self):
        person, pose = self.placed_person("ann11")
        self.assertEqual(person.name, "Ann")
        wait_for(pose, WAIT, "the client knows the place")
        self.both_hear(person, pose, self.own_subscribers("ann11"))

    def test_a_latched_transform_that_the_program_has_already_does_not_stop_the_client(self):
        """rospy calls back at once, in the thread that subscribes."""
        self.world.place("base12", "odom12", 1.0, 5.0, "/tf_static")
        heard = []
        self.addCleanup(rospy.Subscriber("/tf_static", TFMessage, heard.append).unregister)
        wait_for(lambda: heard, WAIT, "the program hears it")
        self.world.track("persons", "ann12")
        humans = Humans(patience=2.0)
        asked = threading.Thread(target=humans.persons["ann12"].pose, daemon=True)
        asked.start()
        asked.join(WAIT)
        self.assertFalse(asked.is_alive(), "it waits for itself")
        humans.close()

    def own_subscribers(self, identity):
        """rospy gives all subscribers of a topic in one process the messages of the first one's type."""
        own = {"name": [], "tf": []}
        for kind, name, of in (("name", "/humans/persons/{}/name".format(identity), String), ("tf", "/tf", TFMessage)):
            self.addCleanup(rospy.Subscriber(name, of, own[kind].append).unregister)
        return own

    def placed_person(self, identity):
        self.world.publish("/humans/persons/{}/name".format(identity), String("Ann"))
        self.world.track("persons", identity)
        person, stamps = self.humans.persons[identity], iter(range(5, 10000))

        def pose():
            self.world.place("odom10", "person_" + identity, 2.0, float(next(stamps)))
            return person.pose()
        return person, pose

    def both_hear(self, person, pose, own):
        wait_for(lambda: person.name == "Ann", WAIT, "the client reads the name")
        wait_for(pose, WAIT, "the client knows the place")
        wait_for(lambda: pose() and own["name"] and own["tf"], WAIT, "the program hears the same")
        self.assertEqual(own["name"][-1].data, "Ann")
        self.assertEqual(own["tf"][-1].transforms[0].child_frame_id, "person_" + person.id)

    def test_gazes_and_groups(self):
        self.world.publish("/humans/interactions/gaze", GazesStamped(gazes=[GazeSenderReceiver("ann6", "", 0.9),
                                                                            GazeSenderReceiver("bob6", "ann6", 0.8)]))
        self.world.publish("/humans/interactions/groups", GroupsStamped(
            groups=[Group(group_id="g1", members=["ann6", "bob6"])], confidences=[0.7]))
        self.world.track("persons", "ann6", "bob6")
        ann, bob = (self.humans.persons[name] for name in ("ann6", "bob6"))
        wait_for(lambda: ann.looks_at_robot and bob.looks_at == "ann6", WAIT, "who looks at whom")
        wait_for(lambda: [group.members for group in self.humans.groups] == [("ann6", "bob6")], WAIT, "the group")
        self.world.publish("/humans/interactions/gaze", GazesStamped())
        wait_for(lambda: ann.looks_at is None, WAIT, "an empty list ends the gazes")

    def test_all_who_ask_for_gazes_are_told(self):
        told = {"first": [], "second": []}
        self.humans.on_gazes(told["first"].append)
        self.humans.on_gazes(told["second"].append)
        self.world.publish("/humans/interactions/gaze", GazesStamped(gazes=[GazeSenderReceiver("ann7", "", 0.9)]))
        wait_for(lambda: all(calls and calls[-1] and calls[-1][0].sender == "ann7" for calls in told.values()), WAIT,
                 lambda: "both are told, not {}".format(told))
        wait_for(lambda: [gaze.sender for gaze in self.humans.gazes] == ["ann7"], WAIT, "who asks hears it, too")

    def test_places(self):
        body = self.body_in_front()
        self.world.place("base7", "camera7", 1.0, 5.0, "/tf_static")
        stamps = iter(range(5, 10000))

        def pose(of):
            stamp = float(next(stamps))
            self.world.place("camera7", "body_bann7", 2.0, stamp)
            self.world.place("body_bann7", "torso_bann7", 0.5, stamp, turn=math.pi / 2)
            self.world.place("torso_bann7", "head_bann7", 0.25, stamp)
            return of()
        self.assertAlmostEqual(wait_for(lambda: pose(body.pose), WAIT, "in the camera's frame").translation[0], 2.0)
        self.assertAlmostEqual(wait_for(lambda: pose(lambda: body.pose("base7")), WAIT, "in base7").translation[0], 3.0)
        head = wait_for(lambda: pose(lambda: body.link("head", "base7")), WAIT, "a link of the skeleton")
        self.assertAlmostEqual(head.translation[0], 3.5)
        self.assertAlmostEqual(head.translation[1], 0.25)
        self.assertIsNone(pose(lambda: body.pose("nowhere7")))

    def body_in_front(self):
        self.world.track("bodies", "bann7")
        return self.humans.bodies["bann7"]

    def test_joints_carry_no_id(self):
        self.world.track("bodies", "b_8")
        self.world.publish("/humans/bodies/b_8/joint_states", JointState(name=["l_elbow_b_8"], position=[1.5]))
        body = self.humans.bodies["b_8"]
        self.assertEqual(wait_for(lambda: body.joints, WAIT, "joints"), {"l_elbow": 1.5})

    def test_nothing_is_left_behind(self):
        self.world.publish("/humans/persons/ann9/name", String("Ann"))
        self.world.track("persons", "ann9")

        def use():
            with Humans(patience=2.0) as humans:
                self.assertEqual(humans.persons["ann9"].name, "Ann")
                humans.gazes, humans.groups, humans.persons["ann9"].pose("base9")
        use()
        before = held_by(os.getpid())
        for _ in range(20):
            use()
        wait_for(lambda: held_by(os.getpid()).threads <= before.threads, WAIT, "threads end")
        wait_for(lambda: held_by(os.getpid()).descriptors <= before.descriptors + 2, WAIT, "descriptors are closed")

    def test_closed_says_so(self):
        self.humans.close()
        with self.assertRaisesRegex(ValueError, "closed"):
            self.humans.on_person()


if __name__ == "__main__":
    rospy.init_node("client_test")
    rostest.rosrun("hri_pipeline", "client", ClientTest)
