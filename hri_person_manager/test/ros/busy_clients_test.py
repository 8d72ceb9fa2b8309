#!/usr/bin/env python3
"""Clients that call all services at once, while people come and go: each call is answered, nothing is left."""

import itertools
import random
import threading
import unittest

import rospy
import rostest
from std_srvs.srv import Empty, Trigger
from tf2_msgs.msg import TFMessage
from trackers import Trackers

from hri_msgs.msg import IdsList, IdsMatch
from hri_person_manager.srv import Enrol, Export, Forget, ListKnown, Merge, SetName, SetNativeLanguage, Split
from hri_pipeline.testing import Latest, held_by, pid_of, transform, wait_for

NODE = "/hri_person_manager"
WAIT_S = 30.0
CLIENTS, CALLS = 8, 60
SERVICES = {"set_name": (SetName, 2), "set_native_language": (SetNativeLanguage, 2), "merge": (Merge, 2),
            "split": (Split, 1), "forget": (Forget, 1), "export": (Export, 1), "enrol": (Enrol, 2),
            "enrol_new": (Enrol, 2), "list_known": (ListKnown, 0), "forget_all": (Trigger, 0), "reset": (Empty, 0)}
WORDS = ("", "x" * 10000, "a b", "1a", "\u00e9", "Ann", "en", "de-DE", "anonymous_person_zzzzz")
NUMBERS = range(10)


class BusyClientsTest(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        cls.trackers = Trackers()
        cls.matches = rospy.Publisher("/humans/candidate_matches", IdsMatch, queue_size=100)
        cls.tf = rospy.Publisher("/tf", TFMessage, queue_size=100)
        cls.known = Latest("/humans/persons/known", IdsList)
        cls.tracked = Latest("/humans/persons/tracked", IdsList)
        rospy.wait_for_service(NODE + "/reset", WAIT_S)

    def come_and_go(self, round_number):
        """Show most of the people: every third is another one the next time, every second has a name."""
        here = [number for number in NUMBERS if (number + round_number // 4) % 3]
        self.trackers.show(faces=["f%d" % number for number in here], bodies=["b%d" % number for number in here],
                           voices=["v%d" % number for number in here[:2]])
        stamp = rospy.Time.now()
        self.tf.publish(TFMessage([transform("map", "face_f%d" % number, stamp, float(number)) for number in here]))
        for number in here:
            self.matches.publish(IdsMatch("f%d" % number, IdsMatch.FACE, "b%d" % number, IdsMatch.BODY, 0.9))
            if number % 2:
                self.matches.publish(IdsMatch("f%d" % number, IdsMatch.FACE, "p%d" % number, IdsMatch.PERSON, 0.9))

    def leave(self):
        self.trackers.show(faces=(), bodies=(), voices=())
        wait_for(lambda: not self.tracked.value.ids, WAIT_S, "everybody has left")

        def forget():
            rospy.ServiceProxy(NODE + "/forget_all", Trigger)()
        wait_for(lambda: not self.known.value.ids, WAIT_S, "nobody is known", forget, 0.5)

    def client(self, seed, answered):
        chance = random.Random(seed)
        for _ in range(CALLS):
            name = chance.choice(list(SERVICES)[:-2] * 5 + list(SERVICES))
            kind, count = SERVICES[name]
            words = [chance.choice(WORDS + tuple("p%d" % number for number in NUMBERS)) for _ in range(count)]
            answered.append((name, rospy.ServiceProxy("%s/%s" % (NODE, name), kind)(*words)))

    def test_every_call_is_answered_and_nothing_is_left(self):
        rounds = itertools.count()
        wait_for(lambda: self.known.value is not None and any(one.startswith("p") for one in self.known.value.ids),
                 WAIT_S, "people", lambda: self.come_and_go(next(rounds)), 0.05)
        self.leave()
        pid = pid_of(NODE)
        before = held_by(pid)

        answered = []
        clients = [threading.Thread(target=self.client, args=(seed, answered), daemon=True) for seed in range(CLIENTS)]
        for client in clients:
            client.start()
        wait_for(lambda: not any(client.is_alive() for client in clients), 90.0,
                 lambda: "the end of all calls, %d are answered" % len(answered),
                 lambda: self.come_and_go(next(rounds)), 0.05)
        self.assertEqual(len(answered), CLIENTS * CALLS)
        self.assertEqual({name for name, _ in answered}, set(SERVICES))

        self.leave()
        wait_for(lambda: held_by(pid).descriptors <= before.descriptors + 3
                 and held_by(pid).threads <= before.threads + 3, WAIT_S,
                 lambda: "what was held before: %s, now %s" % (before, held_by(pid)))
        self.trackers.show(faces=["f_last"])
        wait_for(lambda: len(self.tracked.value.ids) == 1, WAIT_S, "it goes on")


if __name__ == "__main__":
    rospy.init_node("busy_clients_test")
    rostest.rosrun("hri_person_manager", "busy_clients", BusyClientsTest)
