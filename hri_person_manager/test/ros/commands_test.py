#!/usr/bin/env python3
"""people and show_persons: no master, a master that goes and comes again, a narrow terminal, the end by a signal."""

import fcntl
import json
import os
import pty
import re
import signal
import socket
import struct
import subprocess
import tempfile
import termios
import unittest

import rosgraph
import roslib.packages
import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import TransformStamped
from std_msgs.msg import Float32
from tf2_msgs.msg import TFMessage

from hri_msgs.msg import IdsList
from hri_pipeline.testing import HeardProcess, wait_for

# rosrun seeks them anew each time.
PROGRAMS = {name: roslib.packages.find_node("hri_person_manager", name)[0] for name in ("people", "show_persons")}
NOBODY = 3
COLUMNS = 60


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def deaf_to_ctrl_c():
    """What a shell script does to what it starts in the background."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


class Command(HeardProcess):
    """A command of the package on a terminal of 60 columns, or at a pipe, and what it has said so far."""

    def __init__(self, *words, terminal=False, uri=None):
        self.text = ""
        self.mouth, out = pty.openpty() if terminal else os.pipe()
        if terminal:
            fcntl.ioctl(out, termios.TIOCSWINSZ, struct.pack("HHHH", 24, COLUMNS, 0, 0))
        process = subprocess.Popen([PROGRAMS[words[0]], *words[1:]], stdin=subprocess.DEVNULL, stdout=out,
                                   stderr=out, preexec_fn=deaf_to_ctrl_c if terminal else None,
                                   env=dict(os.environ, PYTHONUNBUFFERED="1",
                                            **({"ROS_MASTER_URI": uri} if uri else {})))
        os.close(out)
        super().__init__(process, self.read)

    def read(self):
        try:
            for data in iter(lambda: os.read(self.mouth, 65536), b""):
                self.text += data.decode()
        except OSError:       # how a terminal ends
            pass

    def says(self, words, since=0):
        wait_for(lambda: words in self.text[since:], 30, lambda: "{!r}; said: {}".format(words, self.text[-1500:]))

    def kill(self):
        super().kill()
        os.close(self.mouth)


class CommandsTest(unittest.TestCase):

    def command(self, *words, **options):
        command = Command(*words, **options)
        self.addCleanup(command.kill)
        return command

    def master(self, port):
        process = subprocess.Popen(["rosmaster", "--core", "-p", str(port)], stdout=subprocess.DEVNULL,
                                   stderr=subprocess.DEVNULL)
        self.addCleanup(process.wait)
        self.addCleanup(process.kill)
        wait_for(rosgraph.Master("/test", master_uri="http://127.0.0.1:{}".format(port)).is_online, 20,
                 "the master is online")
        return process

    def test_without_a_master_only_the_table_waits(self):
        uri = "http://127.0.0.1:{}".format(free_port())
        for words in (["people", "list"], ["people", "forget-all", "--yes"], ["people", "name", "ann", "Ann"],
                      ["people", "reset"],
                      ["show_persons", "--once", "--duration", "1"], ["show_persons", "--duration", "1"],
                      ["people", "watch", "--duration", "1"]):
            command = self.command(*words, uri=uri)
            self.assertEqual(command.code(), 1, words)
            lines = command.text.strip().split("\n")
            self.assertEqual(len(lines), 1, lines)
            self.assertIn("{}: no ROS master at {}".format(words[0], uri), lines[0])
            self.assertIn("start roscore or roslaunch", lines[0])

    def test_ctrl_c_while_the_table_waits_ends_it_quietly(self):
        for words in (["people"], ["show_persons"], ["show_persons", "--once"]):
            command = self.command(*words, uri="http://127.0.0.1:{}".format(free_port()))
            command.says("Waiting")
            command.process.send_signal(signal.SIGINT)
            self.assertEqual(command.code(), 130, words)
            self.assertNotIn("Traceback", command.text)

    def test_the_table_says_that_the_master_has_gone_and_goes_on_with_the_next(self):
        port = free_port()
        uri = "http://127.0.0.1:{}".format(port)
        master = self.master(port)
        table = self.command("people", terminal=True, uri=uri)
        table.says("nobody yet")
        master.kill()
        master.wait()
        gone = "the ROS master at {} does not answer".format(uri)
        table.says(gone)
        self.master(port)
        since = len(table.text)
        wait_for(lambda: "nobody yet" in table.text[since:]
                 and gone not in table.text[since:].rpartition("nobody yet")[2]
                 and "images/s" in table.text[since:].rpartition("nobody yet")[2], 30, "the note has gone")
        graph = rosgraph.Master("/test", master_uri=uri)
        wait_for(lambda: any(topic == "/humans/persons/tracked" for topic, _ in graph.getSystemState()[1]), 30,
                 "the table listens again")
        table.process.send_signal(signal.SIGINT)
        self.assertEqual(table.code(), NOBODY)
        self.assertNotIn("[WARN]", table.text)

    def test_a_signal_ends_the_table_at_once_though_the_master_has_gone(self):
        for number in (signal.SIGINT, signal.SIGTERM):
            port = free_port()
            master = self.master(port)
            table = self.command("show_persons", terminal=True, uri="http://127.0.0.1:{}".format(port))
            table.says("nobody yet")
            master.kill()
            master.wait()
            table.process.send_signal(number)
            self.assertEqual(table.code(), NOBODY, "by signal {}".format(number))
            self.assertNotIn("ROS Master", table.text)
            self.assertNotIn("Traceback", table.text)

    def test_no_images_and_nobody_yet_are_two_things(self):
        told = rospy.Publisher("/diagnostics", DiagnosticArray, queue_size=10)
        self.addCleanup(told.unregister)
        table = self.command("people", terminal=True)

        def tells(arrive, words):
            since = len(table.text)
            status = DiagnosticStatus(name="hri_faces: input", message="no publisher on /image",
                                      values=[KeyValue("images_arrive", arrive)])
            wait_for(lambda: told.publish(DiagnosticArray(status=[status])) or words in table.text[since:], 30,
                     lambda: "{!r}; said: {}".format(words, table.text[since:]))
        table.says("nobody yet")
        tells("False", "no images arrive: no publisher on /image")
        tells("True", "nobody yet")

    def test_no_line_is_longer_than_the_terminal(self):
        people = rospy.Publisher("/humans/persons/tracked", IdsList, queue_size=10, latch=True)
        self.addCleanup(people.unregister)
        ids = ["anonymous_person_abcde", "anonymous_person_bcdef"]
        table = self.command("people", terminal=True)
        wait_for(lambda: people.publish(IdsList(ids=ids)) or all(table.text.count(name) > 2 for name in ids), 30,
                 lambda: "both persons; said " + table.text[-1000:])
        table.process.send_signal(signal.SIGINT)
        self.assertEqual(table.code(), 0)
        lines = re.sub("\x1b\\[[0-9]*[A-Z]", "", table.text).replace("\r", "").split("\n")
        self.assertEqual([line for line in lines if len(line) > COLUMNS], [])

    def test_only_frames_of_tracked_faces_and_bodies_are_images(self):
        faces = rospy.Publisher("/humans/faces/tracked", IdsList, queue_size=10, latch=True)
        transforms = rospy.Publisher("/tf", TFMessage, queue_size=100)
        for publisher in (faces, transforms):
            self.addCleanup(publisher.unregister)
        faces.publish(IdsList(ids=["fabcd"]))
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "table.json")
            table = self.command("show_persons", "--period", "0.5", "--json", path)

            def move():
                message = TFMessage()
                for frame in ("face_fabcd", "body_link", "face_plate"):
                    item = TransformStamped(child_frame_id=frame)
                    item.header.frame_id, item.header.stamp = "base_link", rospy.Time.now()
                    item.transform.rotation.w = 1.0
                    message.transforms.append(item)
                transforms.publish(message)

            counted = re.compile(r"faces found in (?!0\.0 )[0-9.]+ images/s")
            wait_for(lambda: move() or counted.search(table.text), 30,
                     lambda: "images of faces; said " + table.text[-1000:])
            table.process.send_signal(signal.SIGINT)
            self.assertEqual(table.code(), NOBODY)
            with open(path) as file:
                data = json.load(file)
        self.assertGreater(data["faces_per_second"], 0.0)
        self.assertEqual(data["bodies_per_second"], 0.0)

    def test_who_is_out_of_view_stays_in_the_table_as_long_as_there_is_a_frame(self):
        lists = {name: rospy.Publisher("/humans/persons/" + name, IdsList, queue_size=10, latch=True)
                 for name in ("tracked", "known")}
        seen = rospy.Publisher("/humans/persons/ann/location_confidence", Float32, queue_size=1, latch=True)
        transforms = rospy.Publisher("/tf", TFMessage, queue_size=10)
        for publisher in (*lists.values(), seen, transforms):
            self.addCleanup(publisher.unregister)
        lists["known"].publish(IdsList(ids=["ann", "bob", "eve"]))
        lists["tracked"].publish(IdsList(ids=["ann", "bob"]))
        seen.publish(1.0)
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "table.json")
            table = self.command("people", "watch", "--period", "0.1", "--json", path)

            def move(*people):
                message = TFMessage()
                for person in (*people, "link"):
                    item = TransformStamped(child_frame_id="person_" + person)
                    item.header.frame_id, item.header.stamp = "map", rospy.Time.now()
                    item.transform.rotation.w = 1.0
                    message.transforms.append(item)
                transforms.publish(message)

            def says(words, *people):
                since = len(table.text)
                wait_for(lambda: move(*people) or words in table.text[since:], 30,
                         lambda: "{!r}; said {}".format(words, table.text[-1000:]))
            says("2 persons in view; ", "ann")
            lists["tracked"].publish(IdsList(ids=["ann"]))
            says("1 person in view, 1 out of view; ", "ann", "eve")
            says("1 person in view; ", "ann")
            says("1 person in view, 1 out of view; ", "ann", "eve")
            table.process.send_signal(signal.SIGINT)
            self.assertEqual(table.code(), 0)
            with open(path) as file:
                data = json.load(file)
        self.assertEqual([(person["id"], person["in_view"]) for person in data["persons"]],
                         [("ann", True), ("eve", False)])
        self.assertEqual(data["persons_left"], ["bob"])


if __name__ == "__main__":
    rospy.init_node("commands_test")
    rostest.rosrun("hri_person_manager", "commands", CommandsTest)
