"""People on a ROS graph whose places and looks a test decides, as detectors and a person manager would tell them."""

import math
import threading

import numpy as np
import rospy
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from hri_msgs.msg import FacialActionUnits, IdsList
from hri_pipeline.core.faces.gaze import gaze_frame
from hri_pipeline.core.geometry import Pose
from hri_pipeline.ros.conversions import action_units_to_msg, make_header, transform_to_msg

ROBOT = np.array([0.0, 0.0, 0.0])
RATE = 15.0
EYES_BESIDE_HEAD = 0.005        # rad


def face_pose(place, target):
    """A face in an optical frame that looks at a target, upright."""
    forward = (np.asarray(target, dtype=float) - place) / np.linalg.norm(np.asarray(target, dtype=float) - place)
    left = np.cross((0.0, -1.0, 0.0), forward)
    left /= np.linalg.norm(left)
    return Pose(np.stack([forward, left, np.cross(forward, left)], axis=1), np.asarray(place, dtype=float))


class Latest:
    """A text for wait_for that tells, when it is read, who was last said to look at whom."""

    def __init__(self, what, messages):
        self._what, self._messages = what, messages

    def __str__(self):
        last = self._messages[-1].gazes if self._messages else None
        return "{}; {} messages, last: {}".format(self._what, len(self._messages), last)


class Stage:
    """Publishes persons, faces and their frames RATE times a second until it is closed.

    people: {name: (camera, place in the optical frame (3,) m, target in the same (3,))}; camera None: listed, but not
    seen; target None: the eyes are closed. A face is called f + name. lids: {name: closedness}, told as action units.
    ahead: {camera: by how much its clock is ahead (s)}.
    """

    def __init__(self):
        self.people, self.shift = {}, 0.0
        self.lids, self.ahead = {}, {}
        self.stamps = []
        self._topics = {}
        self._tf = rospy.Publisher("/tf", TFMessage, queue_size=100)
        self._fixed = rospy.Publisher("/tf_static", TFMessage, queue_size=10, latch=True)
        self._tracked = rospy.Publisher("/humans/persons/tracked", IdsList, queue_size=10, latch=True)
        self._faces = rospy.Publisher("/humans/faces/tracked", IdsList, queue_size=10, latch=True)
        self._facs = {}
        self._listed, self._count = None, 0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._play, daemon=True)
        self._thread.start()

    def fix(self, transforms):
        """Publish fixed frames: (parent, child, Pose)."""
        self._fixed.publish(TFMessage([transform_to_msg(pose, rospy.Time.now(), parent, child) for parent, child,
                                       pose in transforms]))

    def send(self, frames, stamp):
        """Publish moving frames once: (parent, child, Pose)."""
        self._tf.publish(TFMessage([transform_to_msg(pose, stamp, parent, child) for parent, child, pose in frames]))

    def name_body(self, name, body):
        """Tell which body somebody has who has been there already."""
        self._topics[name][1].publish(body)

    def close(self):
        """Nobody is there any more."""
        self._stop.set()
        self._thread.join()
        self._tracked.publish(IdsList())

    def _tell_lids(self, stamp):
        for name, closed in dict(self.lids).items():
            if name not in self._facs:
                self._facs[name] = rospy.Publisher("/humans/faces/f{}/facs".format(name), FacialActionUnits,
                                                   queue_size=1)
            units = np.zeros(99)
            units[FacialActionUnits.BLINK] = closed
            self._facs[name].publish(action_units_to_msg(units, np.ones(99), make_header(stamp, "")))

    def _play(self):
        while not self._stop.wait(1.0 / RATE):
            people, stamp = dict(self.people), rospy.Time.now() + rospy.Duration(self.shift)
            for name in people:
                if name not in self._topics:
                    self._topics[name] = [rospy.Publisher("/humans/persons/{}/{}".format(name, kind), String,
                                                          queue_size=1, latch=True)
                                          for kind in ("face_id", "body_id")]
                    self._topics[name][0].publish("f" + name)
                    self._topics[name][1].publish("")
            self._count += 1
            if self._listed != sorted(people) or self._count % int(RATE) == 0:
                self._listed = sorted(people)
                self._tracked.publish(IdsList(ids=self._listed))
                self._faces.publish(IdsList(ids=["f" + name for name in self._listed]))
            self._tell_lids(stamp)
            frames = []
            for name, (camera, place, target) in people.items():
                if camera is None:
                    continue
                pose = face_pose(place, target if target is not None else ROBOT)
                time = stamp + rospy.Duration(self.ahead.get(camera, 0.0))
                frames.append(transform_to_msg(pose, time, camera, "face_f" + name))
                if target is not None:
                    # A gaze that is exactly the head's would be taken for that of a face too small for its eyes.
                    eyes = pose.rotation @ (math.cos(EYES_BESIDE_HEAD), math.sin(EYES_BESIDE_HEAD), 0.0)
                    frames.append(transform_to_msg(gaze_frame(pose, eyes), time, "face_f" + name, "gaze_f" + name))
            if frames:
                self.stamps.append(stamp)
                self._tf.publish(TFMessage(frames))
