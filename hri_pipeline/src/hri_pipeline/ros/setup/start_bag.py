"""Lets a paused `rosbag play` go as soon as everybody who has to hear the first message is connected to it."""

from __future__ import annotations

import argparse
import sys
import time
from typing import Dict, List, Optional, Sequence, Set, Tuple
from xmlrpc.client import Fault, ServerProxy

import rosgraph
import rospy
from std_srvs.srv import SetBool

from hri_pipeline.ros.node import wait_for_master

LOOK_S = 0.1
_SAY_S = 5.0

Listeners = Dict[str, Sequence[str]]
"""Topic -> names of nodes."""


def parse_wanted(texts: Sequence[str]) -> Listeners:
    """Read "TOPIC=NODE,NODE" into resolved names; the order stays. Raises ValueError for anything else."""
    wanted: Dict[str, List[str]] = {}
    for text in texts:
        topic, _, nodes = text.partition("=")
        names = [name for name in nodes.split(",") if name]
        if not topic or not names:
            raise ValueError("{!r} is not of the form TOPIC=NODE,NODE".format(text))
        wanted.setdefault("/" + topic.strip("/"), []).extend("/" + name.strip("/") for name in names)
    return wanted


def missing_listeners(wanted: Listeners, played: Set[str], connected: Set[Tuple[str, str]]) -> List[str]:
    """Return "NODE on TOPIC" of each who is wanted, but not connected, on a topic that is played."""
    return ["{} on {}".format(node, topic) for topic, nodes in wanted.items() if topic in played
            for node in nodes if (topic, node) not in connected]


def not_in_the_recording(image: str, played: Set[str]) -> str:
    """Return why no image will come, and the mend; empty where the recording has that topic."""
    if image in played:
        return ""
    twin, transport = (image[:-len("/compressed")], "raw") if image.endswith("/compressed") else (image + "/compressed", "compressed")
    if twin in played:
        return "the recording holds {}, not {}: give image_transport:={}".format(twin, image, transport)
    return "the recording holds no {}; give image:= the topic of its images (rosbag info tells)".format(image)


class PausedPlayer:
    """A `rosbag play --pause` of the graph, by the name of its node."""

    def __init__(self, name: str) -> None:
        self._name = "/" + name.strip("/")
        self._master = rosgraph.Master(rospy.get_name())

    def played(self) -> Set[str]:
        """Return the topics that it publishes, the clock apart."""
        published, _, _ = self._master.getSystemState()
        return {topic for topic, nodes in published if self._name in nodes} - {"/clock", "/rosout"}

    def connected(self) -> Set[Tuple[str, str]]:
        """Return (topic, node) of all who are connected to it now, by its own account."""
        try:
            _, _, rows = ServerProxy(self._master.lookupNode(self._name)).getBusInfo(rospy.get_name())
        except (OSError, rosgraph.MasterException, Fault):
            return set()
        return {(row[4], str(row[1])) for row in rows}

    def go(self) -> None:
        """Play. Raises rospy.ServiceException where it has gone."""
        rospy.ServiceProxy(self._name + "/pause_playback", SetBool)(False)


def start(player: PausedPlayer, service: str, wanted: Listeners, patience: float) -> str:
    """Let the player go; return "" or, in words, who was not there after `patience` s. Raises rospy.ROSException."""
    rospy.wait_for_service(service, patience)
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
    """Run the command; exit code 0, or 1 where there is no player."""
    parser = argparse.ArgumentParser(prog="start_bag", description=__doc__)
    parser.add_argument("wanted", nargs="+", metavar="TOPIC=NODE,NODE",
                        help="who has to be connected to which topic; the first is that of the images; topics that the recording lacks are left out")
    parser.add_argument("--player", default="bag", help="name of the node that plays (default: bag)")
    parser.add_argument("--patience", type=float, default=60.0, metavar="S", help="start after so long in any case (default: 60)")
    options = parser.parse_args(rospy.myargv(sys.argv)[1:] if arguments is None else list(arguments))
    try:
        wanted = parse_wanted(options.wanted)
    except ValueError as error:
        parser.error(str(error))
    wait_for_master("start_bag")
    rospy.init_node("start_bag", disable_signals=True)
    try:
        problem = start(PausedPlayer(options.player), "/{}/pause_playback".format(options.player.strip("/")), wanted, options.patience)
    except (rospy.ROSException, rospy.ServiceException) as error:
        rospy.logerr("the recording cannot be started: %s; is the file right (rosbag info)?", error)
        return 1
    except KeyboardInterrupt:
        return 0
    finally:
        rospy.signal_shutdown("start_bag has ended")
    if problem:
        rospy.logwarn("%s", problem)
    return 0
