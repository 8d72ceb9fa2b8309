#!/usr/bin/env python3
"""Names, unions, forgetting, distances, and the same people after the manager was killed."""

import itertools
import json
import os
import signal
import subprocess
import sys
import threading
import unittest
from pathlib import Path

import rosnode
import rospy
import rostest
from std_msgs.msg import String
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage
from trackers import Trackers

from hri_msgs.msg import AgeAndGender, IdsList, IdsMatch, SoftBiometrics
from hri_person_manager.srv import (
    Enrol,
    Export,
    Forget,
    ListKnown,
    ListKnownResponse,
    Merge,
    SetName,
    SetNameResponse,
    SetNativeLanguage,
    Split,
)
from hri_pipeline.srv import Gallery, GalleryResponse
from hri_pipeline.testing import Latest, transform, wait_for

NODE = "/hri_person_manager"
WAIT_S = 15.0
RECOGNISER = """
import json, sys, rospy
from hri_msgs.msg import IdsMatch
from hri_pipeline.srv import Gallery, GalleryResponse
face, person, *known = sys.argv[1:]
rospy.init_node("recogniser")
rospy.Service("~gallery", Gallery, lambda request: GalleryResponse(
    success=request.command == "list", data=json.dumps(known)))
matches = rospy.Publisher("/humans/candidate_matches", IdsMatch, queue_size=10)
while not rospy.is_shutdown():
    matches.publish(IdsMatch(id1=face, id1_type=IdsMatch.FACE, id2=person, id2_type=IdsMatch.PERSON, confidence=0.9))
    rospy.sleep(0.1)
"""


class TestPersonServices(unittest.TestCase):
    numbers = itertools.count(1)

    @classmethod
    def setUpClass(cls):
        cls.trackers = Trackers()
        cls.matches = rospy.Publisher("/humans/candidate_matches", IdsMatch, queue_size=100)
        cls.tf = rospy.Publisher("/tf", TFMessage, queue_size=100)
        cls.tracked = Latest("/humans/persons/tracked", IdsList)
        cls.spaces = {name: Latest("/humans/persons/in_%s_space" % name, IdsList)
                      for name in ("personal", "social", "public")}

    def setUp(self):
        # Faces are never seen again under the same id: what is said of one may overtake the list that ends it.
        self.face = "f%d" % next(self.numbers)
        self.wait_for(lambda: self.matches.get_num_connections() and self.tf.get_num_connections() > 0, "the manager")
        rospy.wait_for_service(NODE + "/list_known", WAIT_S)
        self.wait_for(lambda: self.tracked.value is not None, "the list of persons")

    def tearDown(self):
        self.trackers.show(faces=(), bodies=(), voices=())
        self.wait_for(lambda: self.tracked.value is not None and not self.tracked.value.ids, "everybody has left")

    def wait_for(self, condition, what, seconds=WAIT_S):
        wait_for(condition, seconds, what)

    @classmethod
    def show(cls, kind, *ids):
        cls.trackers.show(**{kind: ids})

    def recognise(self, face, person, likelihood=0.9, kind=IdsMatch.FACE):
        self.matches.publish(IdsMatch(id1=face, id1_type=kind, id2=person, id2_type=IdsMatch.PERSON,
                                      confidence=likelihood))

    def call(self, service, kind, *arguments):
        return rospy.ServiceProxy(NODE + "/" + service, kind)(*arguments)

    def known(self):
        return self.call("list_known", ListKnown)

    def someone(self, face, person):
        self.show("faces", face)
        self.recognise(face, person)
        self.wait_for(lambda: person in self.tracked.value.ids, person)

    def test_name_language_and_demographics_are_latched_on_the_person(self):
        self.someone(self.face, "ann")
        self.assertTrue(self.call("set_name", SetName, "ann", "Ann Ø").success)
        self.assertTrue(self.call("set_native_language", SetNativeLanguage, "ann", "pt-BR").success)
        softbiometrics = rospy.Publisher("/humans/faces/%s/softbiometrics" % self.face, SoftBiometrics, queue_size=10)
        self.wait_for(softbiometrics.get_num_connections, "the manager listens to softbiometrics")
        softbiometrics.publish(SoftBiometrics(age=33, age_confidence=0.8, gender=1, gender_confidence=0.9))
        topics = {name: Latest("/humans/persons/ann/" + name, kind)
                  for name, kind in (("name", String), ("native_language", String), ("demographics", AgeAndGender))}
        self.wait_for(lambda: all(topic.value is not None for topic in topics.values()), "the latched topics")
        self.assertEqual(topics["name"].data, "Ann Ø")
        self.assertEqual(topics["native_language"].data, "pt-BR")
        found = topics["demographics"].value
        self.assertEqual((found.age, found.gender), (33.0, AgeAndGender.FEMALE))
        self.assertTrue(self.call("set_name", SetName, "ann", "").success)
        self.wait_for(lambda: topics["name"].data == "", "the name is taken away")
        for topic in topics.values():
            topic.close()
        softbiometrics.unregister()

    def recogniser(self, face, person, *known):
        process = subprocess.Popen([sys.executable, "-c", RECOGNISER, face, person, *known])
        self.addCleanup(process.wait)
        self.addCleanup(process.terminate)      # its service would stay with the master if it was killed
        return process

    def test_whom_a_recogniser_lost_when_it_was_killed_is_known_no_more(self):
        other = "f%d" % next(self.numbers)
        self.show("faces", self.face, other)
        for face, person in ((self.face, "old1"), (other, "kept1")):
            first = self.recogniser(face, person, "old1", "kept1")
            self.wait_for(lambda person=person: person in self.tracked.value.ids, person)
            first.kill()
            first.wait()
        # Its template of the one is on disk, say, and the other one is learnt anew under another id.
        new = "f%d" % next(self.numbers)
        self.show("faces", new)
        self.wait_for(lambda: "old1" in self.known().ids and self.tracked.value.ids != ["old1"], "who left is known")
        self.recogniser(new, "new1", "kept1", "new1")
        self.wait_for(lambda: "old1" not in self.known().ids, "who is lost is known no more")
        self.assertTrue({"kept1", "new1"} <= set(self.known().ids))

    def test_only_what_is_known_of_a_person_has_a_topic(self):
        self.someone(self.face, "lea")
        self.assertTrue(self.call("set_native_language", SetNativeLanguage, "lea", "fr").success)
        language = Latest("/humans/persons/lea/native_language", String)
        self.wait_for(lambda: language.data == "fr", "the language")
        advertised = [name for name, _ in rospy.get_published_topics("/humans/persons/lea")]
        self.assertIn("/humans/persons/lea/native_language", advertised)
        self.assertNotIn("/humans/persons/lea/name", advertised)
        self.assertTrue(self.call("set_name", SetName, "lea", "Léa").success)
        name = Latest("/humans/persons/lea/name", String)
        self.wait_for(lambda: name.data == "Léa", "the name, which is set later")
        for topic in (language, name):
            topic.close()

    def test_what_cannot_be_done_is_answered_not_done(self):
        self.someone(self.face, "bea")
        for answer, words in (
                (self.call("set_name", SetName, "nobody", "x"), "nobody"),
                (self.call("set_name", SetName, "bea", "x" * 65), "64"),
                (self.call("set_native_language", SetNativeLanguage, "bea", "Klingon!"), "IETF"),
                (self.call("merge", Merge, "bea", "a b;c"), "no person"),
                (self.call("split", Split, "bea"), "joined with nobody"),
                (self.call("forget", Forget, "nobody"), "nobody"),
                (self.call("forget", Forget, ""), "no known person"),
                (self.call("export", Export, "nobody"), "nobody"),
                (self.call("enrol", Enrol, "bea", ""), "no recogniser"),
                (self.call("enrol", Enrol, "nobody", ""), "no face")):
            self.assertFalse(answer.success)
            self.assertIn(words, answer.message)
        self.assertIn("bea", self.known().ids)

    def test_merged_persons_are_one_until_they_are_split(self):
        self.show("faces", self.face)
        self.show("bodies", "b" + self.face)
        self.recognise(self.face, "cat")
        self.recognise("b" + self.face, "dan", kind=IdsMatch.BODY)
        self.wait_for(lambda: {"cat", "dan"} <= set(self.tracked.value.ids), "two persons")
        alias = Latest("/humans/persons/cat/alias", String)
        body = Latest("/humans/persons/dan/body_id", String)
        face = Latest("/humans/persons/dan/face_id", String)
        self.assertTrue(self.call("set_name", SetName, "cat", "Cat").success)
        name = Latest("/humans/persons/dan/name", String)
        self.assertTrue(self.call("merge", Merge, "dan", "cat").success)
        self.wait_for(lambda: self.tracked.value.ids == ["dan"] and name.data == "Cat", "one person, with the name")
        self.wait_for(lambda: alias.data == "dan" and face.data == self.face and body.data == "b" + self.face,
                      "everything is dan's")
        self.assertTrue(self.call("split", Split, "cat").success)
        self.wait_for(lambda: sorted(self.tracked.value.ids) == ["cat", "dan"] and alias.data == "", "two again")
        self.wait_for(lambda: name.data == "", "only cat has the name")
        for topic in (alias, body, face, name):
            topic.close()

    def test_with_a_person_go_the_other_ids_of_that_human(self):
        self.someone(self.face, "ina")
        self.matches.publish(IdsMatch(id1="inatwo", id1_type=IdsMatch.PERSON, id2="ina", id2_type=IdsMatch.PERSON,
                                      confidence=0.95))
        self.wait_for(lambda: "inatwo" in self.known().ids, "the second id")
        self.assertTrue(self.call("forget", Forget, "ina").success)
        self.assertFalse({"ina", "inatwo"} & set(self.known().ids))
        # What was under way when she was forgotten does not bring her back.
        self.recognise(self.face, "ina")
        self.recognise(self.face, "jon")
        self.wait_for(lambda: "jon" in self.tracked.value.ids, "jon")
        self.assertFalse({"ina", "inatwo"} & set(self.known().ids))

    def test_with_an_alias_goes_the_human_whose_it_is(self):
        self.someone(self.face, "uma")
        self.matches.publish(IdsMatch(id1="umatwo", id1_type=IdsMatch.PERSON, id2="uma", id2_type=IdsMatch.PERSON,
                                      confidence=0.95))
        alias = {}
        self.wait_for(lambda: alias.update(zip(self.known().ids, self.known().aliases)) or any(
            alias.get(name) for name in ("uma", "umatwo")), "one is the alias of the other")
        self.assertTrue(self.call("forget", Forget, "umatwo" if alias["umatwo"] else "uma").success)
        self.assertFalse({"uma", "umatwo"} & set(self.known().ids))

    def test_a_forgotten_person_is_nowhere(self):
        self.someone(self.face, "eve")
        self.call("set_name", SetName, "eve", "Eve Secret")
        exported = self.call("export", Export, "eve")
        self.assertEqual(json.loads(exported.data)["persons"][0]["name"], "Eve Secret")
        self.assertTrue(self.call("forget", Forget, "eve").success)
        self.wait_for(lambda: all(not identity.startswith("eve") for identity in self.tracked.value.ids),
                      "eve has gone")
        self.assertNotIn("eve", self.known().ids)
        self.assertNotIn("Secret", self.call("export", Export, "").data)
        self.wait_for(lambda: not [topic for topic, _ in rospy.get_published_topics() if "/eve/" in topic],
                      "her topics are closed")
        self.assertFalse([name for name in rospy.get_param_names() if "eve" in str(rospy.get_param(name, ""))])
        self.assertTrue(rospy.ServiceProxy(NODE + "/forget_all", Trigger)().success)
        self.assertEqual([identity for identity in self.known().ids if not identity.startswith("anonymous")], [])

    def test_forgetting_asks_all_galleries_and_nothing_else_of_that_name(self):
        asked = []
        answers = {"somebody_else": GalleryResponse(success=False, unknown=True, message="no such person here"),
                   "broken": GalleryResponse(success=False, message="the disk is not known to be writable")}

        def offer(name):
            def answer(request):
                asked.append((name, request.id))
                return answers[name]
            service = rospy.Service("/%s/gallery" % name, Gallery, answer)
            self.addCleanup(service.shutdown)
            return service
        pictures = rospy.Service("/pictures/gallery", Trigger, lambda request: asked.append("a shop of pictures"))
        self.addCleanup(pictures.shutdown)
        offer("somebody_else")
        self.someone(self.face, "liv")
        answer = self.call("forget", Forget, "liv")
        self.assertTrue(answer.success, answer.message)
        self.assertEqual(asked, [("somebody_else", "liv")])
        offer("broken")
        self.show("faces", self.face + "two")
        self.someone(self.face + "two", "max")
        answer = self.call("forget", Forget, "max")
        self.assertFalse(answer.success)
        self.assertIn("/broken/gallery: the disk", answer.message)
        self.assertNotIn("somebody_else", answer.message)

    def test_a_recogniser_that_hangs_is_told_and_holds_nobody_up_twice(self):
        released, asked = threading.Event(), []

        def answer(request):
            asked.append(request.id)
            released.wait()
            return GalleryResponse(success=True)
        service = rospy.Service("/hanging/gallery", Gallery, answer)
        self.addCleanup(service.shutdown)
        self.addCleanup(released.set)
        self.someone(self.face, "kai")
        answers = []

        def forget(person):
            before = len(answers)
            threading.Thread(target=lambda: answers.append(self.call("forget", Forget, person)), daemon=True).start()
            self.wait_for(lambda: len(answers) > before, "an answer", 40.0)
            self.assertFalse(answers[-1].success)
            self.assertIn("/hanging/gallery does not answer", answers[-1].message)
        forget("kai")
        self.assertNotIn("kai", self.known().ids)
        forget("kai")
        self.assertEqual(asked, ["kai"])
        released.set()
        self.wait_for(lambda: self.call("forget", Forget, "kai").success, "it answers again")

    def test_enrolling_somebody_alike_is_refused_and_done_as_somebody_new(self):
        asked = []

        def answer(request):
            asked.append((request.command, request.id, request.other))
            is_new = request.command == "enrol_new"
            return GalleryResponse(success=is_new, id="ned" if is_new else "", message="the face looks like kim")
        service = rospy.Service("/recogniser/gallery", Gallery, answer)
        self.addCleanup(service.shutdown)
        self.someone(self.face, "kim")
        refused = self.call("enrol", Enrol, "kim", "Ned")
        self.assertFalse(refused.success)
        self.assertIn("looks like kim", refused.message)
        made = self.call("enrol_new", Enrol, "kim", "Ned")
        self.assertTrue(made.success, made.message)
        self.assertEqual(made.id, "ned")
        self.assertEqual(asked, [("enrol", "kim", self.face), ("enrol_new", "", self.face)])

    def test_who_speaks_while_being_enrolled_is_enrolled_by_voice_as_well(self):
        asked = []

        def answer(request):
            asked.append((request.command, request.id, request.other))
            return GalleryResponse(success=request.other == self.face, id=request.id, message="no such face")
        service = rospy.Service("/recogniser/gallery", Gallery, answer)
        self.addCleanup(service.shutdown)
        self.someone(self.face, "tim")
        voice = "v" + self.face
        self.show("voices", voice)

        def enrolled():
            self.recognise(voice, "tim", kind=IdsMatch.VOICE)
            self.assertTrue(self.call("enrol", Enrol, "tim", "").success)
            return ("enrol", "tim", voice) in asked
        self.wait_for(enrolled, "the voice is enrolled")
        self.assertEqual(asked[-2:], [("enrol", "tim", self.face), ("enrol", "tim", voice)])

    def test_who_is_only_heard_is_enrolled_by_voice(self):
        asked = []

        def answer(request):
            asked.append((request.command, request.id, request.other))
            return GalleryResponse(success=True, id="eva", message="enrolled")
        service = rospy.Service("/recogniser/gallery", Gallery, answer)
        self.addCleanup(service.shutdown)
        voice = "v" + self.face
        self.show("faces")
        self.show("voices", voice)
        self.wait_for(lambda: len(self.tracked.value.ids) == 1, "the speaker")
        answered = self.call("enrol", Enrol, self.tracked.value.ids[0], "Eva")
        self.assertTrue(answered.success, answered.message)
        self.assertIn("by voice", answered.message)
        self.assertEqual((answered.id, asked), ("eva", [("enrol", "", voice)]))

    def test_merging_through_an_alias_is_answered_as_it_is_done(self):
        for number, person in enumerate(("pia", "quy", "ron")):
            self.recognise("z%d" % number, person)
        self.show("faces", "z0", "z1", "z2")
        self.wait_for(lambda: {"pia", "quy", "ron"} <= set(self.tracked.value.ids), "three persons")
        self.assertIn("quy is an alias of pia", self.call("merge", Merge, "pia", "quy").message)
        self.assertIn("pia is an alias of ron", self.call("merge", Merge, "ron", "quy").message)
        known = self.known()
        aliases = dict(zip(known.ids, known.aliases))
        self.assertEqual([aliases[name] for name in ("pia", "quy", "ron")], ["ron", "ron", ""])
        self.wait_for(lambda: self.tracked.value.ids == ["ron"], "one person")
        exported = json.loads(self.call("export", Export, "").data)["persons"]
        records = {record["id"]: record["alias"] for record in exported}
        self.assertEqual([records[person] for person in ("pia", "quy", "ron")], ["ron", "ron", ""])

    def test_persons_are_sorted_by_distance(self):
        self.show("faces", "n1", "m1", "p1")
        for face in ("n1", "m1", "p1"):
            self.recognise(face, "who" + face)

        def listed(name):
            self.place({"n1": 0.8, "m1": 2.5, "p1": 6.0})
            return self.spaces[name].value.ids if self.spaces[name].value else []
        self.wait_for(lambda: listed("personal") == ["whon1"] and listed("social") == ["whom1"]
                      and listed("public") == ["whop1"], "the three lists")

    def place(self, distances):
        self.tf.publish(TFMessage([transform("camera", "face_" + face, rospy.Time.now(), z=distance)
                                   for face, distance in distances.items()]))

    def test_the_graph_is_text_for_graphviz(self):
        self.someone(self.face, "gus")
        graph = rospy.wait_for_message("/humans/graph", String, WAIT_S).data
        self.assertTrue(graph.startswith("graph humans {"))
        self.assertIn("person_gus -- face_%s [style=bold];" % self.face, graph)

    def test_the_command_line_twin(self):
        self.someone(self.face, "hal")

        def people(*words):
            return subprocess.run(["rosrun", "hri_person_manager", "people"] + list(words), stdout=subprocess.PIPE,
                                  stderr=subprocess.STDOUT, timeout=30, check=False)
        self.assertEqual(people("name", "hal", "Hal O.").returncode, 0)
        listed = people("list").stdout.decode()
        self.assertRegex(listed, r"hal\s+Hal O\.\s+-\s+here\s+known")
        refused = people("name", "nobody", "x")
        self.assertEqual((refused.returncode, b"no known person nobody" in refused.stdout), (1, True))
        self.assertEqual(people("forget-all").returncode, 2)
        self.assertIn(b"Is the person manager running?", people("--node", "/none", "reset").stdout)
        unknown = people("export", "nobody").stdout
        self.assertIn(b"no known person nobody", unknown)
        self.assertNotIn(b"named", unknown)

    def test_a_person_manager_of_another_version_is_told_as_that(self):
        class Older(ListKnown):
            _md5sum = "0" * 32
        other = rospy.Service("/older/hri_person_manager/list_known", Older, lambda request: ListKnownResponse())
        self.addCleanup(other.shutdown)
        told = subprocess.run(["rosrun", "hri_person_manager", "people", "--node", "/older/hri_person_manager", "list"],
                              stdout=subprocess.PIPE, stderr=subprocess.PIPE, timeout=30, check=False)
        self.assertEqual(told.returncode, 1)
        self.assertIn(b"/older/hri_person_manager is of another version than this command", told.stderr)
        self.assertNotIn(b"md5", told.stderr)

    def test_the_person_manager_of_a_namespace_is_found(self):
        def people():
            done = subprocess.run(["rosrun", "hri_person_manager", "people", "list"], stdout=subprocess.PIPE,
                                  stderr=subprocess.STDOUT, timeout=30, check=False, universal_newlines=True,
                                  env=dict(os.environ, ROS_NAMESPACE="robot1"))
            return done.returncode, done.stdout
        self.someone(self.face, "ida")
        self.assertRegex(people()[1], "ida ")           # the only one on this master
        others = [rospy.Service("/robot%d/hri_person_manager/%s" % (number, name), kind, answer)
                  for number in (1, 2) for name, kind, answer in (
                      ("list_known", ListKnown, lambda request: ListKnownResponse()),
                      ("set_name", SetName, lambda request: SetNameResponse()))]
        self.assertEqual(people(), (0, "nobody is known\n"))
        for service in others[:2]:
            service.shutdown()
        code, text = people()
        self.assertEqual(code, 1)
        self.assertIn("/hri_person_manager, /robot2/hri_person_manager", text)
        for service in others[2:]:
            service.shutdown()

    def test_the_same_people_after_the_manager_was_killed(self):
        self.show("faces", "x1", "x2")
        self.show("bodies", "y1")
        match = IdsMatch(id1="x1", id1_type=IdsMatch.FACE, id2="y1", id2_type=IdsMatch.BODY, confidence=0.9)
        self.matches.publish(match)
        self.wait_for(lambda: len(self.tracked.value.ids) == 2, "two anonymous persons")
        self.show("faces", "x1", "x2", "x3")
        self.matches.publish(IdsMatch(id1="x3", id1_type=IdsMatch.FACE, id2="kim", id2_type=IdsMatch.PERSON,
                                      confidence=0.9))
        # A recogniser says it once; after the restart it may take long until the face is seen well again.
        self.wait_for(lambda: len(self.tracked.value.ids) == 3 and "kim" in self.tracked.value.ids, "a known one, too")
        before = set(self.tracked.value.ids)
        # what is remembered is written twice a second
        self.wait_for(lambda: set(rospy.get_param(NODE + "_memory", {})) >= before, "they are remembered")
        self.tracked.messages.append(IdsList())
        os.kill(self.process(), signal.SIGKILL)
        self.wait_for(lambda: set(self.tracked.value.ids) == before, "the same persons again")
        self.matches.publish(match)
        self.assertEqual(set(self.tracked.value.ids), before)

    def process(self):
        self.assertIn(NODE, rosnode.get_node_names())
        for directory in Path("/proc").glob("[0-9]*"):
            try:
                words = (directory / "cmdline").read_bytes().split(b"\0")
                environment = (directory / "environ").read_bytes().split(b"\0")
            except OSError:
                continue
            if b"__name:=hri_person_manager" in words and \
                    ("ROS_MASTER_URI=" + os.environ["ROS_MASTER_URI"]).encode() in environment:
                return int(directory.name)
        self.fail("no process of the manager")


if __name__ == "__main__":
    rospy.init_node("test_person_services")
    rostest.rosrun("hri_person_manager", "person_services", TestPersonServices, sys.argv)
