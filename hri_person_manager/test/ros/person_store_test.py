#!/usr/bin/env python3
"""A store of earlier runs: who is known at the start, what is latched when somebody comes again, who has expired."""

import shutil
import signal
import subprocess
import sys
import tempfile
import time
import unittest
from pathlib import Path

import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from std_msgs.msg import String
from std_srvs.srv import Empty

from hri_msgs.msg import AgeAndGender, IdsList, IdsMatch
from hri_person_manager.srv import ListKnown, SetName
from hri_pipeline.core.recognition.store import PersonStore, StoredPerson
from hri_pipeline.testing import wait_for

sys.path.append(str(Path(__file__).resolve().parents[3] / "scripts"))

from benchmarks.store import write_locked  # noqa: E402

WAIT_S = 20.0
DAY_S = 86400.0
ESTIMATE = {"age": 41.0, "age_deviation": 4.0, "age_confidence": 0.8, "gender": 1, "gender_confidence": 0.9,
            "stamp": 5.0}


class PersonStoreTest(unittest.TestCase):

    def setUp(self):
        directory = Path(tempfile.mkdtemp(prefix="ros4hri-store-"))
        self.addCleanup(shutil.rmtree, str(directory), True)
        self.path = directory / "people" / "store.sqlite"
        self.lists = {}
        for name in ("tracked", "known"):
            subscriber = rospy.Subscriber("/humans/persons/" + name, IdsList,
                                          lambda message, name=name: self.lists.update({name: list(message.ids)}))
            self.addCleanup(subscriber.unregister)

    def start(self, *parameters):
        node = subprocess.Popen(["rosrun", "hri_person_manager", "person_manager", "__name:=hri_person_manager"]
                                + list(parameters), stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        self.addCleanup(self.end, node)
        return node

    @staticmethod
    def end(node):
        if node.poll() is None:
            node.send_signal(signal.SIGINT)
        output = node.communicate(timeout=20)[0]
        return output.decode("utf-8", "replace") if output is not None else ""

    def test_who_is_known_at_the_start_and_who_has_expired(self):
        now = time.time()
        store = PersonStore(self.path)
        for person in (StoredPerson("annold", name="Ann Longago", last_seen=now - 40 * DAY_S),
                       StoredPerson("bobmany", name="Bob Toomany", last_seen=now - 3 * DAY_S),
                       StoredPerson("caty", name="Caty", native_language="fr", first_seen=now - 50 * DAY_S,
                                    last_seen=now - 2 * DAY_S, demographics=ESTIMATE),
                       StoredPerson("catytwin", alias="caty", last_seen=now - DAY_S),
                       StoredPerson("dora", name="Dora", last_seen=now - DAY_S)):
            store.put_record(person)
        store.close()
        node = self.start("_store:={}".format(self.path), "_store_max_age:=30.0", "_store_max_persons:=3")
        wait_for(lambda: {"caty", "dora"} <= set(self.lists.get("known", [])), WAIT_S, "the known of the store")
        self.assertFalse({"annold", "bobmany"} & set(self.lists["known"]))
        content = b"".join(path.read_bytes() for path in self.path.parent.iterdir())
        self.assertFalse([trace for trace in (b"annold", b"bobmany", b"Longago", b"Toomany") if trace in content])
        self.check_seen_again()
        known = rospy.ServiceProxy("/hri_person_manager/list_known", ListKnown)
        # The node notes ten times a second who is seen; the lists come before that.
        wait_for(lambda: abs(self.entry(known(), "last_seen").to_sec() - time.time()) < 60.0, WAIT_S,
                 "caty is seen now")
        listed = known()
        self.assertEqual([self.entry(listed, field) for field in ("names", "native_languages", "tracked")],
                         ["Caty", "fr", True])
        self.assertNotIn("Caty", self.end(node), "names do not get into the log")

    def test_reset_forgets_who_is_who_and_nobody_of_the_store(self):
        store = PersonStore(self.path)
        for person in (StoredPerson("caty", name="Caty", last_seen=time.time()),
                       StoredPerson("catytwin", alias="caty", last_seen=time.time())):
            store.put_record(person)
        store.close()
        self.start("_store:={}".format(self.path), "_new_person_delay:=0.2")
        self.show_alias()
        reset = rospy.ServiceProxy("/hri_person_manager/reset", Empty)
        reset.wait_for_service(WAIT_S)
        reset()
        wait_for(lambda: [name[:9] for name in self.lists["tracked"]] == ["anonymous"], WAIT_S, "nobody says who it is")
        wait_for(lambda: len(self.lists["known"]) == 3, WAIT_S, "the anonymous one and the two of the store")
        self.assertTrue({"caty", "catytwin"} <= set(self.lists["known"]))
        listed = rospy.ServiceProxy("/hri_person_manager/list_known", ListKnown)()
        self.assertEqual((sorted(listed.ids), self.entry(listed, "names")), (sorted(self.lists["known"]), "Caty"))
        self.assertEqual(listed.aliases[listed.ids.index("catytwin")], "caty")

    def show_alias(self):
        """Let the face of the alias come; return who publishes matches."""
        self.faces = rospy.Publisher("/humans/faces/tracked", IdsList, latch=True, queue_size=1)
        matches = rospy.Publisher("/humans/candidate_matches", IdsMatch, queue_size=10)
        self.faces.publish(IdsList(ids=["f1"]))
        wait_for(lambda: matches.get_num_connections() > 0, WAIT_S, "the manager listens")
        matches.publish(IdsMatch(id1="f1", id1_type=IdsMatch.FACE, id2="catytwin", id2_type=IdsMatch.PERSON,
                                 confidence=0.9))
        wait_for(lambda: self.lists.get("tracked") == ["caty"], WAIT_S, "caty is tracked")
        return matches

    @staticmethod
    def entry(listed, field):
        return getattr(listed, field)[listed.ids.index("caty")]

    def check_seen_again(self):
        """The face of the alias comes: it is the person that the alias was merged into, with all that is known."""
        matches = self.show_alias()
        said = {name: rospy.wait_for_message("/humans/persons/caty/" + name, kind, WAIT_S)
                for name, kind in (("name", String), ("native_language", String), ("demographics", AgeAndGender))}
        self.assertEqual((said["name"].data, said["native_language"].data), ("Caty", "fr"))
        self.assertEqual((said["demographics"].age, said["demographics"].gender), (41.0, AgeAndGender.FEMALE))
        self.assertEqual(rospy.wait_for_message("/humans/persons/catytwin/alias", String, WAIT_S).data, "caty")
        # Two ids of one human that a recogniser finds are joined as long as it says so.
        self.say_same("dora", 0.95, matches)
        wait_for(lambda: self.latest_alias("dora") == "caty" or self.latest_alias("caty") == "dora", WAIT_S,
                 "one person")
        self.say_same("dora", 0.0, matches)
        wait_for(lambda: self.lists.get("tracked") == ["caty"], WAIT_S, "caty alone again")

    @staticmethod
    def say_same(other, likelihood, matches):
        matches.publish(IdsMatch(id1=other, id1_type=IdsMatch.PERSON, id2="caty", id2_type=IdsMatch.PERSON,
                                 confidence=likelihood))

    @staticmethod
    def latest_alias(person):
        try:
            return rospy.wait_for_message("/humans/persons/{}/alias".format(person), String, 0.5).data
        except rospy.ROSException:
            return None

    def test_persons_come_while_another_process_holds_the_store(self):
        self.start("_store:={}".format(self.path))
        faces = rospy.Publisher("/humans/faces/tracked", IdsList, latch=True, queue_size=1)
        matches = rospy.Publisher("/humans/candidate_matches", IdsMatch, queue_size=10)
        wait_for(lambda: matches.get_num_connections() > 0, WAIT_S, "the manager listens")
        name = rospy.ServiceProxy("/hri_person_manager/set_name", SetName)
        name.wait_for_service(WAIT_S)
        with write_locked(self.path):
            for number, person in enumerate(("known1", "known2", "known3"), 1):
                faces.publish(IdsList(ids=["f{}".format(index) for index in range(1, number + 1)]))
                matches.publish(IdsMatch(id1="f{}".format(number), id1_type=IdsMatch.FACE, id2=person,
                                         id2_type=IdsMatch.PERSON, confidence=0.9))
                began = time.monotonic()
                wait_for(lambda person=person: person in self.lists.get("tracked", []), WAIT_S, "is tracked")
                self.assertLess(time.monotonic() - began, 2.0)
        self.assertTrue(name("known1", "Ann").success)
        store = PersonStore(self.path)
        self.addCleanup(store.close)
        self.assertEqual([record.name for record in store.load_records() if record.id == "known1"], ["Ann"])
        wait_for(lambda: {record.id for record in store.load_records()} == {"known1", "known2", "known3"}, WAIT_S,
                 "all are in the store")

    def test_a_store_that_is_moved_away_is_told_and_takes_no_name(self):
        store = PersonStore(self.path)
        store.put_record(StoredPerson("caty", name="Caty", last_seen=time.time()))
        store.close()
        self.start("_store:={}".format(self.path))
        name, away = rospy.ServiceProxy("/hri_person_manager/set_name", SetName), self.path.parent.with_name("away")
        name.wait_for_service(WAIT_S)
        said = {}
        diagnostics = rospy.Subscriber("/diagnostics", DiagnosticArray, lambda message: said.update(
            (status.message, status.level) for status in message.status))
        self.addCleanup(diagnostics.unregister)
        self.path.parent.rename(away)
        answer = name("caty", "Kate")
        self.assertFalse(answer.success)
        self.assertIn("put it back", answer.message)
        wait_for(lambda: any("put it back" in text and level == DiagnosticStatus.ERROR
                             for text, level in list(said.items())), WAIT_S, "diagnostics tell it")
        away.rename(self.path.parent)
        self.assertTrue(name("caty", "Kate").success)
        store = PersonStore(self.path)
        self.assertEqual([record.name for record in store.load_records()], ["Kate"])
        store.close()

    def test_a_name_by_which_recognisers_do_not_know_it_is_refused_with_the_mend(self):
        node = self.start("_store:={}".format(self.path.parent / "people.db3"))
        self.assertEqual(node.wait(WAIT_S), 1)
        self.assertIn("~store: {} does not end in .sqlite".format(self.path.parent / "people.db3"), self.end(node))

    def test_a_directory_that_cannot_be_made_is_told_with_the_mend(self):
        node = self.start("_store:=/proc/people/store.sqlite")
        self.assertEqual(node.wait(WAIT_S), 1)
        said = self.end(node)
        self.assertIn("~store: directory /proc/people cannot be made", said)
        self.assertIn("name one that can be written", said)


if __name__ == "__main__":
    rospy.init_node("person_store_test")
    rostest.rosrun("hri_person_manager", "person_store", PersonStoreTest)
