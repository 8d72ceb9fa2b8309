#!/usr/bin/env python3
"""Memory of people: enrolled, known in the next run, exported, forgotten without a trace; a store that is damaged."""

import json
import os
import shutil
import signal
import sqlite3
import stat
import subprocess
import tempfile
import threading
import unittest
from pathlib import Path

import cv2
import numpy as np
import rosgraph
import rospy
import rostest
from bag_stage import PATIENCE_S, wait_for
from std_msgs.msg import Bool, String
from tf2_msgs.msg import TFMessage

from hri_msgs.msg import AgeAndGender, IdsList
from hri_person_manager.srv import Enrol, Export, Forget, ListKnown, SetNativeLanguage
from hri_pipeline.core.onnx import models_directory
from hri_pipeline.core.privacy import make_key_file
from hri_pipeline.srv import Gallery, GalleryRequest
from hri_pipeline.testing import Camera

PHOTOGRAPH, PEOPLE = "sample1.jpg", 3
SIZE = (960, 640)
RATE_HZ = 8.0
NAME = "Ada Forgetmenot"
MANAGER, GALLERY = "/hri_person_manager", "/hri_faces/gallery"


class Stack:
    """ros4hri.launch without bodies, in a process of its own; everything it says is in `said`."""

    def __init__(self, directory, **arguments):
        self._log = Path(tempfile.mkstemp(suffix=".log", dir=str(directory))[1])
        given = dict(bodies="false", overlay="false", fallback_fov="0.93", **arguments)
        with open(str(self._log), "wb") as log:
            self._process = subprocess.Popen(
                ["roslaunch", "ros4hri", "ros4hri.launch"] + ["{}:={}".format(*item) for item in given.items()],
                stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT)

    @property
    def said(self):
        return self._log.read_text(encoding="utf-8", errors="replace")

    def wait(self):
        """Wait until recogniser and manager answer."""
        for service in (GALLERY, MANAGER + "/list_known"):
            wait_for(lambda name=service: self._answers(name),
                     lambda name=service: name + "; said:\n" + self.said[-3000:])

    def close(self):
        """End it, and wait for that. May be called again."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
            self._process.wait(30)

    @staticmethod
    def _answers(service):
        try:
            rospy.wait_for_service(service, 0.5)
            return True
        except rospy.ROSException:
            return False


class MemoryTest(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        picture = cv2.imread(str(models_directory() / "demo" / PHOTOGRAPH))
        assert picture is not None, "no {} in {}/demo".format(PHOTOGRAPH, models_directory())
        cls.photograph = cv2.resize(picture, SIZE, interpolation=cv2.INTER_AREA)
        cls.darkness = np.zeros_like(cls.photograph)
        cls.camera = Camera(image="/camera/image_raw", info="", rate=RATE_HZ)

    def setUp(self):
        self.camera.show(None)
        self.directory = Path(tempfile.mkdtemp(prefix="ros4hri-memory-"))
        self.addCleanup(shutil.rmtree, str(self.directory), True)
        self.store = self.directory / "people" / "store.sqlite"
        self.lists, self.frames, self.lock = {}, [], threading.Lock()
        for name in ("tracked", "known"):
            self.listen("/humans/persons/" + name, IdsList, lambda message, name=name: self.lists.update(
                {name: list(message.ids)}))
        self.listen("/humans/faces/tracked", IdsList, lambda message: self.lists.update(faces=list(message.ids)))
        self.listen("/tf", TFMessage, self.on_tf)

    def listen(self, topic, kind, callback):
        self.addCleanup(rospy.Subscriber(topic, kind, callback, queue_size=100).unregister)

    def on_tf(self, message):
        with self.lock:
            self.frames += [item.child_frame_id for item in message.transforms]

    def start(self, **arguments):
        self.lists.clear()
        stack = Stack(self.directory, **arguments)
        self.addCleanup(stack.close)
        return stack

    def tracked(self):
        return self.lists.get("tracked", [])

    def latched(self, person, topic, kind):
        return rospy.wait_for_message("/humans/persons/{}/{}".format(person, topic), kind, PATIENCE_S)

    @staticmethod
    def call(service, kind, *arguments):
        return rospy.ServiceProxy(MANAGER + "/" + service, kind)(*arguments)

    def bytes_on_disk(self):
        """Everything in the files of the store: the database, its journals, what was set aside."""
        return b"".join(path.read_bytes() for path in sorted(self.store.parent.iterdir()))

    def test_enrolled_known_in_the_next_run_and_forgotten(self):
        person = self.first_run()
        self.check_files(person)
        self.second_run(person)

    def first_run(self):
        """Nobody is recognised without consent; who gives it has an id, also under another face id."""
        self.key = make_key_file(self.directory / "key")
        stack = self.start(store=self.store, store_key=self.key, recognition="enrolled")
        stack.wait()
        self.assertIn("persons are kept across runs in {}".format(self.store), stack.said)
        self.assertIn("templates of faces are kept across runs in {}".format(self.store), stack.said)
        self.camera.show(self.photograph)
        wait_for(lambda: len(self.tracked()) == PEOPLE, lambda: "three persons, {}; said:\n{}".format(
            self.lists, stack.said[-2000:]))
        stranger = sorted(self.tracked())[0]
        answer = wait_for(lambda: self.enrolled(stranger), "the face is seen well enough to be enrolled")
        self.assertFalse(answer.id.startswith("anonymous"))
        person = answer.id
        wait_for(lambda: person in self.tracked(), lambda: "{} is tracked: {}".format(person, self.lists))
        self.assertEqual((self.latched(person, "anonymous", Bool).data, self.latched(person, "name", String).data),
                         (False, NAME))
        others = wait_for(lambda: [other for other in self.tracked() if other != person], "the other persons")
        self.assertTrue(all(other.startswith("anonymous_person_") for other in others), others)
        self.assertTrue(self.call("set_native_language", SetNativeLanguage, person, "pt-BR").success)
        self.latched(person, "demographics", AgeAndGender)
        self.leave_and_come_back(person)
        self.camera.show(None)
        stack.close()
        self.assertNotIn(NAME, stack.said)
        return person

    def enrolled(self, stranger):
        self.assertEqual([name for name in self.lists["known"] if not name.startswith("anonymous_person_")], [])
        answer = self.call("enrol", Enrol, stranger, NAME)
        return answer if answer.success else None

    def leave_and_come_back(self, person):
        face = self.latched(person, "face_id", String).data
        self.assertTrue(face)
        self.camera.show(self.darkness)
        wait_for(lambda: not self.lists["faces"] and person not in self.tracked(), "everybody has left")
        self.camera.show(self.photograph)
        wait_for(lambda: person in self.tracked(), lambda: "the same person again: {}".format(self.lists))
        self.assertNotIn(self.latched(person, "face_id", String).data, ("", face), "another face id")

    def check_files(self, person):
        mode = {path.name: stat.S_IMODE(path.stat().st_mode) for path in self.store.parent.iterdir()}
        self.assertEqual(set(mode.values()), {0o600}, mode)
        self.assertEqual(stat.S_IMODE(self.store.parent.stat().st_mode), 0o700)
        content = self.bytes_on_disk()
        self.assertIn(person.encode(), content, "what is searched for later is there now")
        self.assertNotIn(NAME.encode(), content, "the name is encrypted, too")

    def second_run(self, person):
        """Known at the start, the same id when seen; then forgotten."""
        stack = self.start(store=self.store, store_key=self.key, recognition="learn")
        stack.wait()
        wait_for(lambda: person in self.lists.get("known", []), "known before anybody is seen")
        self.assertEqual(self.tracked(), [])
        self.camera.show(self.photograph)
        wait_for(lambda: person in self.tracked() and sum(
            not other.startswith("anonymous_person_") for other in self.tracked()) == PEOPLE,
            lambda: "{} and two new permanent persons: {}".format(person, self.lists))
        self.assertEqual((self.latched(person, "name", String).data,
                          self.latched(person, "native_language", String).data),
                         (NAME, "pt-BR"))
        self.check_export(person)
        templates = self.templates(person)
        self.assertTrue(templates and all(template in self.bytes_on_disk() for template in templates))
        self.assertTrue(all(template.startswith(b"gAAAA") for template in templates), "encrypted")
        self.assertTrue(self.call("forget", Forget, person).success)
        self.check_forgotten(person, templates)
        stack.close()
        self.check_erased(person, templates)
        self.assertNotIn(NAME, stack.said)
        self.check_damaged()

    def templates(self, person):
        database = sqlite3.connect(str(self.store))
        found = [bytes(row[0]) for row in database.execute("SELECT template FROM templates WHERE person = ?",
                                                           (person,))]
        database.close()
        return found

    def check_export(self, person):
        exported = json.loads(self.call("export", Export, person).data)
        record, = exported["persons"]
        self.assertEqual((record["name"], record["native_language"], record["enrolled"]), (NAME, "pt-BR", True))
        self.assertTrue(record["demographics"]["age"] > 0.0)
        self.assertEqual(sorted(exported["galleries"][GALLERY]), ["enrolled", "id", "templates"])
        self.assertIsInstance(exported["galleries"][GALLERY]["templates"], int)

    def check_forgotten(self, person, templates):
        wait_for(lambda: person not in self.tracked() and person not in self.lists["known"], "on no list")
        self.check_erased(person, templates)
        wait_for(lambda: not [topic for topic, _ in rospy.get_published_topics() if person in topic], "no topic")
        self.assertFalse([name for name in rospy.get_param_names() if person in name + str(rospy.get_param(name, ""))])
        self.assertNotIn(person, self.call("list_known", ListKnown).ids)
        gallery = rospy.ServiceProxy(GALLERY, Gallery)
        self.assertNotIn(person, json.loads(gallery(GalleryRequest(command=GalleryRequest.LIST)).data))
        with self.lock:
            self.frames.clear()
        wait_for(lambda: sum(name.startswith("person_") for name in list(self.frames)) > 20, "frames of the others")
        self.assertNotIn("person_" + person, self.frames)
        wait_for(lambda: len(self.tracked()) == PEOPLE, "the forgotten human is a stranger")
        self.assertEqual(sum(other.startswith("anonymous_person_") for other in self.tracked()), 1, self.tracked())

    def check_erased(self, person, templates):
        content = self.bytes_on_disk()
        self.assertFalse([trace for trace in [person.encode(), NAME.encode()] + templates if trace in content])

    def check_damaged(self):
        """A damaged store is set aside and said, and the nodes go on without it."""
        damaged = bytearray(self.store.read_bytes())
        damaged[100:5000] = os.urandom(4900)
        self.store.write_bytes(bytes(damaged))
        self.camera.show(None)
        stack = self.start(store=self.store)
        stack.wait()
        aside, = self.store.parent.glob("store.sqlite.damaged-*")
        self.assertEqual(aside.read_bytes(), bytes(damaged), "kept as it was")
        self.assertIn("is damaged", stack.said)
        self.assertIn(aside.name, stack.said)
        self.assertEqual(self.call("list_known", ListKnown).ids, [])
        stack.close()

    def test_a_directory_that_others_can_read_is_refused_with_the_mend(self):
        os.mkdir(str(self.store.parent), 0o755)
        os.chmod(str(self.store.parent), 0o755)
        stack = self.start(store=self.store, respawn="false")
        for parameter in ("~store: ", "~gallery, ~gallery_key: "):
            wait_for(lambda start=parameter: "{}directory {} can be read by others; run `chmod 700".format(
                start, self.store.parent) in stack.said, lambda: "said:\n" + stack.said)
        wait_for(lambda: not {MANAGER, "/hri_faces"} & self.nodes(), "both have ended")
        self.assertFalse(self.store.exists())
        stack.close()

    @staticmethod
    def nodes():
        return {node for _, nodes in rosgraph.Master("/test_memory").getSystemState()[0] for node in nodes}


if __name__ == "__main__":
    rospy.init_node("test_memory")
    rostest.rosrun("ros4hri", "memory", MemoryTest)
