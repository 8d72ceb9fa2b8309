#!/usr/bin/env python3
"""The clock of a recording stands still: people stay, and the diagnostics say why; when it goes on, all is well."""

import unittest

import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rosgraph_msgs.msg import Clock, Log

from hri_msgs.msg import IdsList
from hri_pipeline.testing import Latest, wait_for

WAIT_S = 40.0


class StillClockTest(unittest.TestCase):

    def setUp(self):
        self.time = 1000.0
        self.clock = rospy.Publisher("/clock", Clock, queue_size=1)
        self.faces = rospy.Publisher("/humans/faces/tracked", IdsList, latch=True, queue_size=1)
        self.persons = Latest("/humans/persons/tracked", IdsList)
        self.reports = Latest("/diagnostics", DiagnosticArray)
        self.log = Latest("/rosout", Log)

    def play(self):
        self.time += 0.1
        self.clock.publish(Clock(clock=rospy.Time.from_sec(self.time)))
        return True

    def level(self):
        found = [status for report in list(self.reports.messages) for status in report.status
                 if status.name == "hri_person_manager: clock"]
        return found[-1].level if found else None

    def told(self):
        return [line.msg for line in self.log.messages if "has stood still" in line.msg and line.level == Log.WARN]

    def test_who_is_listed_stays_and_the_reason_is_told_once(self):
        self.faces.publish(IdsList(ids=["f1"]))
        wait_for(lambda: self.play() and self.persons.value is not None and self.persons.value.ids, WAIT_S, "a person")
        wait_for(lambda: self.play() and self.level() == DiagnosticStatus.OK, WAIT_S, "the clock goes on")
        wait_for(lambda: self.level() == DiagnosticStatus.WARN, WAIT_S, "the clock stands still")
        wait_for(self.told, WAIT_S, "the log")
        self.assertEqual(len(self.persons.value.ids), 1)
        self.assertIn("rosparam delete /use_sim_time", self.told()[0])
        wait_for(lambda: self.play() and self.level() == DiagnosticStatus.OK, WAIT_S, "the clock goes on again")
        self.assertEqual((len(self.persons.value.ids), len(self.told())), (1, 1))


if __name__ == "__main__":
    rospy.init_node("still_clock_test")
    rostest.rosrun("hri_person_manager", "still_clock", StillClockTest)
