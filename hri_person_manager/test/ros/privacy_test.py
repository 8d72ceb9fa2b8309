#!/usr/bin/env python3
"""The privacy notice: of each node by its own settings, and as text; the person manager refuses a store without its
key."""

import os
import shutil
import subprocess
import sys
import tempfile
import time
import unittest
from pathlib import Path

import rospy
import rostest

from hri_msgs.msg import PrivacyNotice
from hri_pipeline.core.privacy import TemplateCipher, make_key_file
from hri_pipeline.core.recognition.store import PersonStore, StoredPerson
from hri_pipeline.testing import Latest, wait_for

WAIT_S = 30.0


class TestPrivacy(unittest.TestCase):

    def setUp(self):
        self.folder = Path(tempfile.mkdtemp(prefix="ros4hri-privacy-"))
        self.addCleanup(shutil.rmtree, str(self.folder), True)
        self.key = make_key_file(self.folder / "key")
        self.path = self.folder / "private" / "people.sqlite"
        store = PersonStore(self.path, TemplateCipher(self.key))
        store.put_record(StoredPerson("ada12", "Ada", enrolled=True, last_seen=time.time()))
        store.close()

    def start(self, *parameters):
        """Start the person manager on the store."""
        process = subprocess.Popen(["rosrun", "hri_person_manager", "person_manager",
                                    "_store:={}".format(self.path), *parameters],
                                   stdout=subprocess.PIPE, stderr=subprocess.STDOUT, universal_newlines=True,
                                   env=dict(os.environ))

        def end():
            if process.poll() is None:
                process.terminate()
            process.communicate()

        self.addCleanup(end)
        return process

    def test_nodes_say_what_they_do(self):
        notices = Latest("/humans/privacy", PrivacyNotice)
        self.start("_store_key:={}".format(self.key), "_store_max_age:=30.0")

        def told(node):
            return next((message for message in reversed(notices.messages) if message.node == node), None)

        manager = wait_for(lambda: told("/hri_person_manager"), WAIT_S, "the notice of the person manager")
        self.assertEqual(manager.agreed, ["ada12"])
        self.assertEqual((manager.store, manager.max_age, manager.encrypted), (str(self.path), 30.0, True))
        self.assertIn("names", manager.stored)
        interactions = wait_for(lambda: told("/hri_interactions"), WAIT_S, "the notice of the interactions")
        self.assertEqual(list(interactions.computes), ["who looks at whom", "groups"])
        self.assertEqual(interactions.store, "")
        text = subprocess.run(["rosrun", "hri_person_manager", "people", "privacy"], stdout=subprocess.PIPE,
                              check=True, universal_newlines=True).stdout
        self.assertIn("keeps in {}, encrypted".format(self.path), text)
        self.assertIn("agreed to be recognised: ada12", text)
        self.assertIn("/hri_interactions computes: who looks at whom, groups", text)
        notices.close()

    def test_a_store_without_its_key_is_refused(self):
        process = self.start()
        output, _ = process.communicate(timeout=WAIT_S)
        self.assertNotEqual(process.returncode, 0)
        self.assertIn("store_key", output)


if __name__ == "__main__":
    rospy.init_node("privacy_test")
    rostest.rosrun("hri_person_manager", "privacy", TestPrivacy, sys.argv)
