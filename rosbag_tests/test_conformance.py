#!/usr/bin/env python3
"""Every row of interface.yaml against the running nodes: topics, types, md5, latching, stamps, frames, parameters; and
nothing else."""

import re
import subprocess
import unittest
import xml.etree.ElementTree as ElementTree

import numpy as np
import roslib.message
import rospy
import rostest
from graph_watch import URDF, GraphWatch, wait_for
from interface_table import load, pattern_of, released_sums, topics
from sensors import Sensors

from hri_person_manager.srv import SetName, SetNativeLanguage

LIMIT_S = 130.0         # for all rows; a machine with two free cores needs 40 s
SAME_S = 1e-5           # stamps that went through a number in double precision
UNSEEN_S = 0.45         # the person manager waits for 0.5 s for the next image of somebody
SETTLE_S = 3.0          # sound before its first message reached this process
FRAMES = {"camera": "camera_color_optical_frame", "microphone": "microphone_link", "reference": "map"}
ALIGNED = 0.3           # least cosine between an axis and where it has to point; people in photographs turn their heads
SIZE = (96, 128)        # /humans/faces/width is set by the launch file, the height is the default
KINDS = {"face": "faces", "body": "bodies", "voice": "voices", "person": "persons"}


class ConformanceTest(unittest.TestCase):
    """One table, one run: the rows are looked at together, and judged in groups."""

    @classmethod
    def setUpClass(cls):
        cls.interface = rospy.get_param("~interface")
        cls.table = load()
        cls.rows = topics(cls.table, cls.interface)
        cls.released = released_sums()
        cls.watch = GraphWatch(cls.rows, [row["name"] for row in cls.table["parameters"]])
        cls.told = set()
        cls.sensors = Sensors()
        wait_for(cls.look, rospy.get_param("~limit", LIMIT_S), 0.5)

    @classmethod
    def tearDownClass(cls):
        cls.sensors.close()
        cls.watch.close()

    @classmethod
    def look(cls):
        """Look once more; True when nothing is missing."""
        cls.watch.look()
        cls.tell()
        return not any(cls.fault_of_topic(row)
                       for row in cls.rows) and not any(map(cls.fault_of_frame, cls.table["frames"])) \
            and not any(map(cls.fault_of_parameter, cls.table["parameters"]))

    @classmethod
    def tell(cls):
        """Give everybody a name and a language, once."""
        for name in list(cls.watch.connections):
            found = re.match(r"/humans/persons/(\w+)/face_id$", name)
            if found and found.group(1) not in cls.told:
                try:
                    rospy.ServiceProxy("/hri_person_manager/set_name", SetName)(found.group(1), "Ada")
                    rospy.ServiceProxy("/hri_person_manager/set_native_language",
                                       SetNativeLanguage)(found.group(1), "en-GB")
                except rospy.ServiceException:
                    continue
                cls.told.add(found.group(1))

    @classmethod
    def fault_of_topic(cls, row):
        """What is wrong with a row, in words; empty when nothing is."""
        names = cls.watch.topics_of(row)
        if row.type is None:
            return "; ".join("{} is there".format(name) for name in cls.watch.unknown if row.pattern.match(name))
        if not names:
            return "no such topic"
        expected = roslib.message.get_message_class(row.type)
        for name in names:
            for said in cls.watch.connections[name]:
                if (said.type, said.md5) != (row.type, cls.released.get(row.type, expected._md5sum)):
                    return "{} is {} {}".format(name, said.type, said.md5)
                if said.latched != row.latched:
                    return "{} is {}latched".format(name, "" if said.latched else "not ")
        if not any(cls.watch.messages[name] for name in names):
            return "no message"
        return "; ".join(filter(None, (cls.fault_of_message(row, heard) for name in names
                                       for heard in list(cls.watch.messages[name]))))[:300]

    @classmethod
    def fault_of_message(cls, row, heard):
        """What is wrong with a stamp or frame."""
        if row.source == "none" or heard.stamp is None:
            return "" if heard.frame is None else "a header that the table does not know"
        wanted = FRAMES.get(row.frame, "")
        if heard.frame != wanted and not (heard.frame == "" and not heard.stamp):
            return "frame_id is {!r}, not {!r}".format(heard.frame, wanted)
        if not heard.stamp:     # nobody was there yet
            return "" if getattr(heard.message, "ids", None) == [] else "no stamp"
        return "" if cls.is_input(row.source, heard.stamp,
                                  heard.arrival) else "stamp {:.6f}, at {:.6f}, is none of {}".format(
            heard.stamp, heard.arrival, row.source)

    @classmethod
    def is_input(cls, source, stamp, arrival):
        """Whether an image or sound has this stamp."""
        if source in ("image", "input") and any(abs(stamp - image) < SAME_S for image in list(cls.watch.images)):
            return True
        first = cls.watch.first_sound
        if source == "sound":
            return first is not None and first - SETTLE_S < stamp < arrival
        return source == "input" and (any(abs(stamp - sound) < SAME_S for sound in list(cls.watch.sounds))
                                      or any(abs(stamp - heard) < SAME_S for heard in list(cls.watch.persons)))

    @classmethod
    def fault_of_frame(cls, row):
        """What is wrong with a frame, in words; empty when nothing is."""
        pattern = pattern_of(row["name"])
        names = [name for name in list(cls.watch.parents) if pattern.match(name) and cls.is_known_id(name, pattern)]
        if not names:
            return "no such frame"
        return "; ".join(filter(None, (cls.fault_of_transforms(row, name, pattern.match(name)) for name in names)))

    @classmethod
    def is_known_id(cls, name, pattern):
        """Whether a topic of this kind has the id of this frame: head_camera of a robot looks like head_ID, too."""
        kind, identity = next(iter(pattern.match(name).groupdict().items()))
        return any(topic.startswith("/humans/{}/{}/".format(KINDS[kind], identity))
                   for topic in list(cls.watch.connections))

    @classmethod
    def fault_of_transforms(cls, row, name, match):
        kept = list(cls.watch.transforms[name])
        parent = FRAMES.get(row["parent"]) or row["parent"].format(**match.groupdict())
        if parent == "urdf":
            parent = parents_of(cls.watch.urdfs.get(URDF + match.group(1), "<robot/>")).get(name)
        if cls.watch.parents[name] != {parent}:
            return "the parent of {} is {}, not {}".format(name, sorted(cls.watch.parents[name]), parent)
        source = {"voice": "sound", "person": ""}.get(name.split("_")[0], "image")
        for stamp, fixed, _, place in kept:
            if source and not fixed and not cls.is_input(source, stamp, rospy.get_time()):
                return "{} has the stamp {:.6f}, which no {} has".format(name, stamp, source)
            if row.get("at_parent") and np.abs(place).max() > 1e-9:
                return "{} is not where {} is".format(name, parent)
        if not source:
            fault = cls.fault_of_person(name, kept)
            since = cls.face_since(match.group(1))
            kept = [item for item in kept if item[0] > since]
            if fault or not kept:
                return fault
        for axis, wanted in row.get("axes", {}).items():
            mean = np.median([turn[:, "xyz".index(axis)] for _, _, turn, _ in kept], axis=0)
            if mean.dot(wanted) < ALIGNED:
                return "axis {} of {} points to {}, not {}".format(axis, name, np.round(mean, 2), wanted)
        return ""

    @classmethod
    def face_since(cls, person):
        """Time (s) from which a face of this person is known, infinite without one; a voice does not say where somebody
        looks."""
        heard = list(cls.watch.messages.get("/humans/persons/{}/face_id".format(person), ()))
        return min((message.arrival for message in heard if message.message.data), default=np.inf)

    @classmethod
    def fault_of_person(cls, name, kept):
        """A person's frame has the stamp of an image or sound; of who is not seen any more, it stays, and is said to be
        there now."""
        inputs, last = list(cls.watch.images) + list(cls.watch.sounds), 0.0
        for stamp, _, _, _ in kept:
            if np.min(np.abs(np.subtract(inputs, stamp)), initial=1.0) < SAME_S:
                last = stamp
            elif stamp - last < UNSEEN_S:
                return "{} has the stamp {:.6f}, of no input, {:.3f} s after it was seen".format(
                    name, stamp, stamp - last
                )
        return ""

    @classmethod
    def fault_of_parameter(cls, row):
        """What is wrong with a parameter, in words; empty when nothing is."""
        if row.get("urdf"):
            faults = [cls.fault_of_urdf(name[len(URDF):], text) for name, text in cls.watch.urdfs.items()]
            return "; ".join(filter(None, faults)) if faults else "no such parameter"
        if "holds" in row:
            values = [value for name, value in cls.watch.values.items() if pattern_of(row["name"]).match(name)]
            return "; ".join(filter(None, (cls.fault_of_value(row["holds"], value)
                                           for value in values))) if values else "no such parameter"
        if "refuses" in row:
            return ""       # see test_z_illegal_parameters_are_refused_by_name
        if row["name"].rsplit("/", 1)[1] in ("width", "height"):
            sizes = {(heard.message.width, heard.message.height) for name, messages in list(cls.watch.messages.items())
                     if name.startswith("/humans/faces") and name.endswith(("cropped", "aligned"))
                     for heard in list(messages)}
            return "" if sizes == {SIZE} else "pictures of faces have the sizes {}, not {}".format(sizes, SIZE)
        return "" if rospy.get_param(row["name"],
                                     None) == row["default"] else "it is {}".format(rospy.get_param(row["name"], None))

    @staticmethod
    def fault_of_value(kind, value):
        """What is wrong with a value, in words; empty when nothing is."""
        right = {"process": lambda: value["pid"].isdigit() and value["node"].startswith("/") and value["host"],
                 "rate": lambda: isinstance(value, float) and value > 0.0,
                 "nothing": lambda: value == "",
                 "features": lambda: value and all(re.match(r"(FACE|BODY|VOICE) \w+$", name) for names in value.values()
                                                   for name in names)}
        try:
            return "" if right[kind]() else "it is {!r}".format(value)
        except (KeyError, TypeError, AttributeError):
            return "{!r} is no {}".format(value, kind)

    @classmethod
    def fault_of_urdf(cls, body, text):
        tree = ElementTree.fromstring(text)
        links = {link.get("name") for link in tree.iter("link")}
        wanted = {row["name"].format(body=body) for row in cls.table["frames"] if row["parent"] == "urdf"}
        moving = [joint for joint in tree.iter("joint") if joint.get("type") != "fixed"]
        names = links | {joint.get("name") for joint in tree.iter("joint")}
        if not wanted <= links or not all(name.endswith("_" + body) for name in names):
            return "links of {}: {}".format(body, sorted(links))
        wanted = cls.table["joints"][cls.interface]
        return "" if len(moving) == wanted else "{} joints, not {}".format(len(moving), wanted)

    def judge(self, kind, rows, fault):
        # A person's frame may arrive before the image or sound of which it is: each node has a connection of its own.
        wait_for(lambda: not any(map(fault, rows)), SETTLE_S)
        faults = {row["name"] if isinstance(row, dict) else row.name: fault(row) for row in rows}
        wrong = {name: text for name, text in faults.items() if text}
        print("conformance, interface {}: {} of {} {} as in interface.yaml".format(
            self.interface, len(faults) - len(wrong), len(faults), kind), flush=True)
        self.assertFalse(wrong, "\n" + "\n".join("{}: {}".format(name, text) for name, text in wrong.items()))

    def test_topics(self):
        self.judge("topics", self.rows, self.fault_of_topic)

    def test_frames(self):
        self.judge("frames", self.table["frames"], self.fault_of_frame)
        self.assertTrue([name for name in self.watch.transforms if name.startswith("person_")
                         and np.isfinite(self.face_since(name[len("person_"):]))],
                        "nobody of whom a face is known has a frame")

    def test_parameters(self):
        self.judge("parameters", self.table["parameters"], self.fault_of_parameter)

    def test_no_other_topic_is_under_humans(self):
        self.assertEqual(self.watch.unknown, set())

    def test_no_other_parameter_is_set(self):
        self.assertEqual(self.watch.unknown_parameters, set())

    def test_z_illegal_parameters_are_refused_by_name(self):
        for row in self.table["parameters"]:
            if "refuses" not in row:
                continue
            before = rospy.get_param(row["name"], None)
            rospy.set_param(row["name"], row["refuses"])
            try:
                done = subprocess.run(["rosrun"] + row["node"].split("/") + ["__name:=refused"], stdout=subprocess.PIPE,
                                      stderr=subprocess.STDOUT, timeout=60.0, check=False)
            finally:
                rospy.delete_param(row["name"]) if before is None else rospy.set_param(row["name"], before)
            self.assertNotEqual(done.returncode, 0, row["name"])
            self.assertIn(row["name"].rsplit("/", 1)[1].replace("robot_reference", "robot"), done.stdout.decode())


def parents_of(urdf):
    """Return {link: parent link}."""
    return {joint.find("child").get("link"): joint.find("parent").get("link")
            for joint in ElementTree.fromstring(urdf).iter("joint")}


if __name__ == "__main__":
    rospy.init_node("conformance_test")
    rostest.rosrun("ros4hri", "conformance", ConformanceTest)
