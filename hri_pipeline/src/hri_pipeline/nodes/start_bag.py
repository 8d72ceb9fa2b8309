"""Starts a paused `rosbag play` as soon as all listed nodes are connected to it; waits for its end."""

from __future__ import annotations

import argparse
import math
import os
import signal
import sys
import time
from types import FrameType
from typing import Callable, Dict, List, Optional, Sequence, Set, Tuple, Type, TypeVar
from xmlrpc.client import Fault

import rospy
from std_msgs.msg import Header
from std_srvs.srv import SetBool
from tf2_msgs.msg import TFMessage

from hri_pipeline.core.images import other_transport
from hri_pipeline.core.simulation.sensors import camera_pose
from hri_pipeline.ros.conversions import transform_to_msg
from hri_pipeline.ros.master import ANSWER_S, node_at, patient_master
from hri_pipeline.ros.node import end_simulated_time, wait_for_master
from hri_pipeline.ros.rospy_compat import release
from hri_pipeline.ros.services import NoAnswer, call_service, in_time, wait_for_service
from hri_pipeline.score.bag import is_closed, is_recording, not_closed

LOOK_S = 0.1
AGAIN_S = 0.5           # until a question without an answer is asked again,
_ASKED = 3              # so many times in all
_SAY_S = 5.0
_TRANSFORMS = {"/tf", "/tf_static"}

_Answer = TypeVar("_Answer")
Listeners = Dict[str, Sequence[str]]
"""Topic -> names of nodes."""


def parse_wanted(texts: Sequence[str]) -> Listeners:
    """Read "TOPIC=NODE,NODE", or "TOPIC=" for nobody, into resolved names; the order stays.

    Raises ValueError for anything else.
    """
    wanted: Dict[str, List[str]] = {}
    for text in texts:
        topic, equals, nodes = text.partition("=")
        names = [name for name in nodes.split(",") if name]
        if not topic or not equals:
            raise ValueError("{!r} is not of the form TOPIC=NODE,NODE".format(text))
        wanted.setdefault("/" + topic.strip("/"), []).extend("/" + name.strip("/") for name in names)
    return wanted


def missing_listeners(wanted: Listeners, played: Set[str], connected: Set[Tuple[str, str]]) -> List[str]:
    """Return "NODE on TOPIC" of each who is wanted, but not connected, on a topic that is played."""
    return ["{} on {}".format(node, topic) for topic, nodes in wanted.items() if topic in played
            for node in nodes if (topic, node) not in connected]


def not_in_the_recording(image: str, played: Set[str]) -> str:
    """Return why no image will come, and what to do; empty where the recording has that topic."""
    if image in played:
        return ""
    twin, transport = other_transport(image)
    if twin in played:
        return "the recording holds {}, not {}: give image_transport:={}".format(twin, image, transport)
    return "the recording holds no {}; give image:= the topic of its images (rosbag info tells)".format(image)


def fault_of_file(path: str) -> str:
    """Return why this file is no recording, and what to do; empty where it is one."""
    if not os.path.isfile(path):
        return "there is no recording {}; give bag:= its path".format(path)
    try:
        is_bag = is_recording(path)
        closed = is_bag and is_closed(path)
    except OSError as error:
        return "the recording {} cannot be read: {}".format(path, error.strerror)
    if not is_bag:
        return "{} is no recording of rosbag".format(path)
    return "" if closed else "the recording " + not_closed(path)


class Mount:
    """Where the camera of a recording without transforms stands: told on /tf_static when the first image names its
    frame."""

    def __init__(self, image: str, frame: str, height: float, tilt: float) -> None:
        """image: topic. The camera stands `height` m above the origin of `frame` and looks down by `tilt` rad."""
        self._frame, self._pose, self._told = frame, camera_pose(0.0, 0.0, 0.0, height, tilt), False
        self._publisher = rospy.Publisher("/tf_static", TFMessage, queue_size=1, latch=True)
        self._subscriber = rospy.Subscriber(image, rospy.AnyMsg, self._tell, queue_size=1, buff_size=2 ** 24)

    def close(self) -> None:
        """Take the transform back."""
        release(self._subscriber)
        release(self._publisher)

    def _tell(self, message: rospy.AnyMsg) -> None:
        if self._told:
            return
        self._told = True
        camera = Header().deserialize(message._buff).frame_id.lstrip("/")
        if not camera or camera == self._frame:
            rospy.logwarn("the recording holds no transforms, and its images name no frame but %r", camera)
            return
        self._publisher.publish(TFMessage([transform_to_msg(self._pose, rospy.Time(), self._frame, camera)]))
        rospy.loginfo("the recording holds no transforms: its camera %s is taken to stand %.2f m above %s; "
                      "camera_height and camera_tilt say otherwise", camera, self._pose.translation[2], self._frame)


class PausedPlayer:
    """A `rosbag play --pause` of the graph, by the name of its node."""

    def __init__(self, name: str) -> None:
        self._name = "/" + name.strip("/")
        self._master = patient_master()

    def played(self) -> Set[str]:
        """Return the topics that it publishes, the clock apart. Raises rospy.ROSException without a master."""
        try:
            published, _, _ = _again(self._master.getSystemState)
        except Exception as error:
            raise rospy.ROSException("the ROS master does not answer ({})".format(error)) from error
        return {topic for topic, nodes in published if self._name in nodes} - {"/clock", "/rosout"}

    def connected(self) -> Set[Tuple[str, str]]:
        """Return (topic, node) of all who are connected to it now, by its own account."""
        try:
            with node_at(self._master.lookupNode(self._name)) as player:
                _, _, rows = player.getBusInfo(rospy.get_name())
        except Exception:       # busy, or gone: the next time
            return set()
        return {(row[4], str(row[1])) for row in rows}

    def is_there(self) -> bool:
        """Tell whether it still runs: whether it answers one of several questions."""
        try:
            return _again(self._ask)
        except Exception:
            return False

    def _ask(self) -> bool:
        with node_at(self._master.lookupNode(self._name)) as player:
            return player.getPid(rospy.get_name())[0] == 1

    def go(self) -> None:
        """Play. Raises rospy.ServiceException where it has gone."""
        _again(lambda: call_service(self._name + "/pause_playback", SetBool, [False], ANSWER_S), rospy.ServiceException)


def _again(ask: Callable[[], _Answer], fault: Type[Exception] = Exception) -> _Answer:
    """Return the first answer; one failed call, as of a busy machine, means nothing. Raises what the last one does."""
    for _ in range(_ASKED - 1):
        try:
            return ask()
        except fault:
            time.sleep(AGAIN_S)
    return ask()


def start(player: PausedPlayer, wanted: Listeners, patience: float) -> str:
    """Let the player go; return "" or, in words, who was not there after `patience` s.

    Raises rospy.ServiceException.
    """
    played, image = player.played(), next(iter(wanted))
    problem = not_in_the_recording(image, played)
    missing: List[str] = [] if problem else ["?"]
    began = said = time.monotonic()
    while missing and not rospy.is_shutdown():
        missing = missing_listeners(wanted, played, player.connected())
        now = time.monotonic()
        if now > began + patience:
            problem = "started without " + ", ".join(missing)
            break
        if missing and now > said + _SAY_S:
            rospy.loginfo("the recording waits for %s", ", ".join(missing))
            said = now
        time.sleep(LOOK_S)      # wall time: the clock of the graph stands still
    player.go()
    return problem


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the command; exit code 0, or 1 where there is no player or no recording."""
    parser = _parser()
    options = parser.parse_args(rospy.myargv(sys.argv)[1:] if arguments is None else list(arguments))
    if options.look is not None:
        return _look(options.look)
    try:
        wanted = parse_wanted(options.wanted)
    except ValueError as error:
        parser.error(str(error))
    if not wanted:
        parser.error("the topic of the images is missing")
    wait_for_master("start_bag")
    rospy.init_node("start_bag", disable_signals=True)
    signal.signal(signal.SIGTERM, _interrupt)
    code, launch = 0, None
    try:
        code = _play(wanted, options)
        if options.end_launch:
            launch = _launch()
        if options.end_launch and code == 0:
            rospy.loginfo("the recording has ended, and %s ends with it", "nothing" if launch is None else "everything")
    except KeyboardInterrupt:
        pass
    finally:
        for number in (signal.SIGINT, signal.SIGTERM):      # closing must not be interrupted
            signal.signal(number, signal.SIG_IGN)
        if options.end_launch:
            end_simulated_time()
        rospy.signal_shutdown("start_bag has ended")
    if launch is not None:
        os.kill(launch, signal.SIGINT)
    return code


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="start_bag", description=__doc__)
    parser.add_argument("wanted", nargs="*", metavar="TOPIC=NODE,NODE",
                        help="who has to be connected to which topic; the first is that of the images; topics that the "
                             "recording lacks are left out")
    parser.add_argument("--player", default="bag", help="name of the node that plays (default: bag)")
    parser.add_argument("--patience", type=float, default=60.0, metavar="S",
                        help="start after so long in any case (default: 60)")
    parser.add_argument("--end-launch", action="store_true",
                        help="stay until the recording has ended, then take /use_sim_time back and end roslaunch")
    parser.add_argument("--fixed-frame", default="", metavar="FRAME",
                        help="with --end-launch: where the camera of a recording without transforms stands (default: "
                             "map)")
    parser.add_argument("--camera-height", type=float, default=1.5, metavar="M",
                        help="its height above that (default: 1.5)")
    parser.add_argument("--camera-tilt", type=float, default=0.0, metavar="DEG",
                        help="how far it looks down (default: 0)")
    parser.add_argument("--look", metavar="FILE", help="only see whether FILE is a recording, and print its path")
    return parser


def _look(path: str) -> int:
    """Print the path of a recording, or what is wrong with it; the exit code."""
    fault = fault_of_file(path)
    print("start_bag: " + fault if fault else path, file=sys.stderr if fault else sys.stdout)
    return 1 if fault else 0


def _play(wanted: Listeners, options: argparse.Namespace) -> int:
    """Start the recording and, where that is asked for, wait for its end; the exit code."""
    if options.end_launch and not rospy.has_param("~bag"):
        rospy.logerr("no recording is given; give bag:= its path")
        return 1
    player, mount = PausedPlayer(options.player), None
    try:
        wait_for_service("/{}/pause_playback".format(options.player.strip("/")), options.patience)
        if options.end_launch and not player.played() & _TRANSFORMS:
            mount = Mount(next(iter(wanted)), options.fixed_frame or "map", options.camera_height,
                          math.radians(options.camera_tilt))
        problem = start(player, wanted, options.patience)
        if problem:
            rospy.logwarn("%s", problem)
        while options.end_launch and player.is_there():
            time.sleep(LOOK_S)
    except NoAnswer as error:
        rospy.logerr("the recording cannot be started: %s", error)
        return 1
    except (rospy.ROSException, rospy.ServiceException) as error:
        rospy.logerr("the recording cannot be started: %s; is the file right (rosbag info)?", error)
        return 1
    finally:
        if mount is not None:
            mount.close()
    return 0


def _interrupt(number: int, frame: Optional[FrameType]) -> None:
    raise KeyboardInterrupt


def is_rostest(process: int) -> bool:
    """Tell whether the program that runs under this process id is rostest."""
    try:
        with open("/proc/{}/cmdline".format(process), "rb") as file:
            words = file.read().split(b"\0")
    except OSError:                 # it has ended
        return False
    return b"rostest" in (os.path.basename(word) for word in words[:3])      # an interpreter and its options come first


def _launch() -> Optional[int]:
    """Return the process id of the roslaunch that has started this process; None where somebody else has.

    A rostest is none: ended from outside it reports success, whatever its tests would have found.
    """
    try:
        launches = in_time(lambda: rospy.get_param("/roslaunch/uris", {}), ANSWER_S)
    except OSError:                 # the master has gone, or hangs
        return None
    for uri in launches.values():
        try:
            code, _, pid = node_at(uri).get_pid()
        except (OSError, Fault):    # one that has gone
            continue
        if code == 1 and pid == os.getppid():
            return None if is_rostest(pid) else pid
    return None
