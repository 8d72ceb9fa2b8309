"""Bodies that move on the graph without a camera, and the frames that robot_state_publisher makes of them."""

import os
import threading
import time
from xmlrpc.client import Fault

import numpy as np
import rosgraph
import rospy
from sensor_msgs.msg import JointState
from tf2_msgs.msg import TFMessage

from hri_fullbody.core import keypoints as skeleton
from hri_fullbody.core.kinematics.forward import forward
from hri_fullbody.core.model.anthropometry import SegmentTable
from hri_fullbody.core.model.human import PAPER, Dimensions
from hri_fullbody.core.model.urdf import link_names, make_urdf
from hri_pipeline.core.geometry import Pose
from hri_pipeline.ros.conversions import pose_from_transform, transform_to_msg
from hri_pipeline.ros.publishers import IdPublishers, TopicSpec
from hri_pipeline.testing import wait_for

CAMERA = "camera"
SIDES = (("l_", "LEFT"), ("r_", "RIGHT"))
# Links whose origins are key points.
POINTS = {"torso": skeleton.NECK}
POINTS.update((side + part, getattr(skeleton, "{}_{}".format(word, part.upper())))
              for side, word in SIDES for part in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle"))


class TfTree:
    """Every transform heard, by frame and stamp, and when the frames of a body were first complete."""

    def __init__(self, layout=PAPER):
        self._links = set(link_names(layout))
        self._lock = threading.Lock()
        self.moving = {}
        self.fixed = {}
        self.first = {}
        self.repeated = []
        self._heard = {}
        self._subscribers = [rospy.Subscriber("/tf", TFMessage, self._take, False, queue_size=1000),
                             rospy.Subscriber("/tf_static", TFMessage, self._take, True, queue_size=1000)]

    def _take(self, message, fixed):
        now = time.monotonic()
        with self._lock:
            for item in message.transforms:
                name, stamp = item.child_frame_id, item.header.stamp
                if fixed:
                    self.fixed[name] = item
                else:
                    stamps = self.moving.setdefault(name, {})
                    if stamp in stamps:
                        self.repeated.append(name)
                    stamps[stamp] = item
                    while len(stamps) > 100:
                        del stamps[min(stamps)]
                link, _, identity = name.rpartition("_")
                heard = self._heard.setdefault(identity, set())
                heard.add(link)
                if identity not in self.first and heard >= self._links:
                    self.first[identity] = now

    def complete(self, identity):
        """Stamps at which all frames of a body are known, oldest first."""
        with self._lock:
            sets = [set(self.moving[name]) for link in self._links
                    for name in ["{}_{}".format(link, identity)] if name not in self.fixed and name in self.moving]
            known = all("{}_{}".format(link, identity) in self.fixed or "{}_{}".format(link, identity) in self.moving
                        for link in self._links)
        return sorted(set.intersection(*sets)) if sets and known else []

    def pose(self, link, identity, stamp, root=CAMERA):
        """Pose of a link in the camera's frame at a stamp."""
        name, pose = "{}_{}".format(link, identity), Pose.identity()
        with self._lock:
            while name != root:
                item = self.fixed.get(name) or self.moving[name][stamp]
                pose, name = pose_from_transform(item).compose(pose), item.header.frame_id
        return pose

    def forget(self, identity):
        """Forget the moving frames of a body; the fixed ones come only once."""
        with self._lock:
            for name in [name for name in self.moving if name.rpartition("_")[2] == identity]:
                del self.moving[name]

    def close(self):
        """Stop listening."""
        for subscriber in self._subscribers:
            subscriber.unregister()


class Movers:
    """Publishes joint states and body frames of bodies that move all the time, `rate` times a second of wall time."""

    def __init__(self, rate=15.0, layout=PAPER):
        self.layout = layout
        self.table = SegmentTable.load()
        self.dimensions = {}
        self.sent = {}
        self._lock = threading.Lock()
        self._publishers = IdPublishers("/humans/bodies", {"joint_states": TopicSpec(JointState, greet=True)})
        self._tf = rospy.Publisher("/tf", TFMessage, queue_size=100)
        self._rate = rate
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def set(self, bodies):
        """Let exactly these bodies be there: {id: stature in m}. Returns {id: URDF}."""
        with self._lock:
            for identity, stature in bodies.items():
                if identity not in self.dimensions or self.dimensions[identity].stature != stature:
                    self.dimensions[identity] = Dimensions.from_stature(stature, self.table)
            for gone in set(self.dimensions) - set(bodies):
                del self.dimensions[gone]
            self.sent = {identity: sent for identity, sent in self.sent.items() if identity in bodies}
            self._publishers.keep(bodies)
            return {identity: make_urdf(self.dimensions[identity], identity, self.layout) for identity in bodies}

    def expected(self, identity, stamp):
        """Key points (18, 3) m and head pose in the camera's frame of what was sent with a stamp."""
        rotation, position, joints = self.sent[identity][stamp]
        points, turn, place = forward(rotation[None], position[None], joints[None], [self.dimensions[identity]],
                                      self.layout)
        return points[0], Pose(turn[0], place[0])

    def is_heard(self, identity):
        """Tell whether somebody, such as its robot_state_publisher, listens to the joints of a body."""
        return self._publishers.has_subscribers(identity, "joint_states")

    def close(self):
        """Stop."""
        self._stop.set()
        self._thread.join()
        self._publishers.close_all()
        self._tf.unregister()

    def _run(self):
        due = time.monotonic()
        rng = np.random.default_rng(3)
        count = len(self.layout.joint_names)
        speed = rng.uniform(0.3, 2.0, count)
        while not self._stop.is_set():
            due = max(due + 1.0 / self._rate, time.monotonic() - 1.0)
            self._stop.wait(max(0.0, due - time.monotonic()))
            stamp = rospy.Time.now()
            if stamp.is_zero():
                continue
            with self._lock:
                self._send(stamp, speed)

    def _send(self, stamp, speed):
        low, high = np.asarray(self.layout.lower), np.asarray(self.layout.upper)
        transforms, states = [], []
        for number, identity in enumerate(self.dimensions):
            phase = speed * (stamp.to_sec() % 1000.0) + number
            joints = (low + high) / 2.0 + 0.45 * (high - low) * np.sin(phase)
            turn = Pose.from_quaternion((0.3, np.sin(phase[0]), 0.2, np.cos(phase[0])), (0.5 * number, 0.1, 3.0))
            sent = self.sent.setdefault(identity, {})
            if stamp in sent:
                continue
            sent[stamp] = turn.rotation, turn.translation, joints
            while len(sent) > 200:
                del sent[min(sent)]
            transforms.append(transform_to_msg(turn, stamp, CAMERA, "body_" + identity))
            message = JointState(name=["{}_{}".format(name, identity) for name in self.layout.joint_names],
                                 position=joints.tolist())
            message.header.stamp = stamp
            states.append((identity, message))
        if transforms:
            self._tf.publish(TFMessage(transforms=transforms))
        for identity, message in states:
            self._publishers.publish(identity, "joint_states", message)


def farthest(tree, movers, identity, stamp):
    """Largest distance (m) of a frame from where forward kinematics puts it, over all links that are key points."""
    points, head = movers.expected(identity, stamp)
    errors = [np.abs(tree.pose(link, identity, stamp).translation - points[point]).max()
              for link, point in POINTS.items()]
    found = tree.pose("head", identity, stamp)
    errors.append(np.abs(found.translation - head.translation).max())
    errors.append(np.abs(found.rotation - head.rotation).max())
    return float(max(errors))


def processes(identity):
    """Process ids of the living robot_state_publishers of a body, or of all whose id begins so, on this master."""
    found = []
    wanted, uri = ("__name:=rsp_" + identity).encode(), ("ROS_MASTER_URI=" + rosgraph.get_master_uri()).encode()
    for entry in filter(str.isdigit, os.listdir("/proc")):
        try:
            with open("/proc/{}/cmdline".format(entry), "rb") as file:
                if not any(word.startswith(wanted) for word in file.read().split(b"\0")):
                    continue
            with open("/proc/{}/environ".format(entry), "rb") as file:
                if uri not in file.read().split(b"\0"):
                    continue
            with open("/proc/{}/stat".format(entry), "rb") as file:
                if file.read().rsplit(b")", 1)[1].split()[0] in (b"Z", b"X"):
                    continue
        except OSError:
            continue
        found.append(int(entry))
    return found


def left_of(identity):
    """Everything that a body has on the machine and on the master: processes, parameters, topics, nodes."""
    master = rosgraph.Master("/skeleton_graph")
    found = ["process {}".format(pid) for pid in processes(identity)]
    found += [name for name in master.getParamNames() if identity in name]
    for part in master.getSystemState():
        found += ["{} of {}".format(name, node) for name, nodes in part for node in nodes
                  if node == "/rsp_" + identity or "/{}/".format(identity) in name]
    try:
        found.append(master.lookupNode("/rsp_" + identity))
    except (rosgraph.MasterException, Fault):
        pass
    return found


def wait_until_gone(identity, timeout):
    """Wait until nothing of a body is left; nodes tell the master by a thread that their topics have gone."""
    wait_for(lambda: not left_of(identity), timeout, lambda: "nothing of {}: {}".format(identity, left_of(identity)))
