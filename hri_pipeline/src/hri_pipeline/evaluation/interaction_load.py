"""What the interactions node costs on a ROS graph of its own, with simulated people.

As a program, on a graph that is there: `interaction_load PEOPLE RATE SECONDS FILE` watches the node and writes JSON.
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Callable, Dict, List
from xmlrpc.client import ServerProxy

START_S = 60.0
SETTLE_S = 4.0
PLAYED_S = 8.0
LEAST = 0.3             # of the results that there should be
NODE = "/hri_interactions"
_TICKS = os.sysconf("SC_CLK_TCK")
_MODULE = "hri_pipeline.evaluation.interaction_load"


def load(people: int, rate: float = 15.0, seconds: float = 20.0) -> Dict[str, float]:
    """Return the load of the node, and what it was busy with.

    cpu_percent: of one core at `rate`; on a busy machine fewer images come, and what they cost is scaled to the rate.
    measured_percent: unscaled. All people are seen all the time, faces and bodies, as in a graph with a person manager.
    Raises RuntimeError when something does not start, or when the node gives far fewer results than it should.
    """
    folder = Path(tempfile.mkdtemp(prefix="ros4hri-interactions-"))
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    environment = dict(os.environ, ROS_MASTER_URI="http://127.0.0.1:{}".format(port), ROS_IP="127.0.0.1",
                       ROS_LOG_DIR=str(folder / "ros"))
    environment.pop("ROS_HOSTNAME", None)
    running: List[subprocess.Popen] = []

    def start(name: str, command: List[str]) -> subprocess.Popen:
        with open(str(folder / (name + ".log")), "wb") as log:
            running.append(subprocess.Popen(command, env=environment, stdin=subprocess.DEVNULL, stdout=log, stderr=log))
        return running[-1]

    try:
        start("master", ["rosmaster", "--core", "-p", str(port)])
        start("interactions", ["rosrun", "hri_pipeline", "interactions", "_rate:={}".format(rate), "_robot_frame:=camera_color_optical_frame"])
        result = folder / "result.json"
        watcher = start("watcher", [sys.executable, "-m", _MODULE, str(people), str(rate), str(seconds), str(result)])
        code = watcher.wait(timeout=START_S + SETTLE_S + seconds + 60.0)
        if code != 0 or not result.is_file():
            lines = (folder / "watcher.log").read_text(encoding="utf-8", errors="replace").strip().splitlines()
            raise RuntimeError("{}; logs: {}".format(lines[-1] if lines else "the watcher said nothing", folder))
        return json.loads(result.read_text(encoding="utf-8"))
    finally:
        _end(running)


def watch(people: int, rate: float, seconds: float) -> Dict[str, float]:
    """Play the people on the graph of this process, and measure the node."""
    import rosgraph
    import rospy

    from hri_msgs.msg import GazesStamped, GroupsStamped, IdsList
    from hri_pipeline.evaluation.interaction_player import Player
    rospy.init_node("interaction_load", disable_signals=True)
    heard: Dict[str, object] = {"gazes": [], "groups": 0, "tracked": 0}
    rospy.Subscriber("/humans/interactions/gaze", GazesStamped, lambda message: heard["gazes"].append(len(message.gazes)))
    rospy.Subscriber("/humans/interactions/groups", GroupsStamped, lambda message: heard.update(groups=len(message.groups)))
    rospy.Subscriber("/humans/persons/tracked", IdsList, lambda message: heard.update(tracked=len(message.ids)))
    player = Player(people, rate, PLAYED_S)
    _wait(lambda: heard["tracked"] == people and len(heard["gazes"]) > 3 * rate, START_S, lambda: "{} of {} people, {} results".format(
        heard["tracked"], people, len(heard["gazes"])))
    settled = time.monotonic() + SETTLE_S
    _wait(lambda: time.monotonic() > settled, START_S, lambda: "the clock stands")
    pid = ServerProxy(rosgraph.Master("/interaction_load").lookupNode(NODE)).getPid("/interaction_load")[2]
    before, began, count = _ticks(pid), time.monotonic(), len(heard["gazes"])
    _wait(lambda: time.monotonic() - began >= seconds, seconds + START_S, lambda: "the clock stands")
    passed, used = time.monotonic() - began, (_ticks(pid) - before) / _TICKS
    gazes, tracked, groups = heard["gazes"][count:], heard["tracked"], heard["groups"]
    player.close()
    if tracked != people:
        raise RuntimeError("{} of {} people at the end".format(tracked, people))
    if len(gazes) < LEAST * rate * passed:
        raise RuntimeError("only {} results in {:.1f} s: the machine is too busy, or the node too slow".format(len(gazes), passed))
    return {"cpu_percent": round(100.0 * used / len(gazes) * rate, 2), "measured_percent": round(100.0 * used / passed, 2),
            "results_per_second": round(len(gazes) / passed, 2), "people": tracked,
            "gazes": round(sum(gazes) / len(gazes), 1), "groups": groups}


def _wait(condition: Callable[[], bool], seconds: float, state: Callable[[], str]) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > deadline:
            raise RuntimeError("not within {:g} s: {}".format(seconds, state()))
        time.sleep(0.02)


def _ticks(pid: int) -> int:
    """User and system time of a process, in clock ticks."""
    fields = Path("/proc/{}/stat".format(pid)).read_text().rsplit(")", 1)[1].split()
    return int(fields[11]) + int(fields[12])


def _end(running: List[subprocess.Popen]) -> None:
    for process in reversed(running):
        if process.poll() is None:
            process.terminate()
    for process in reversed(running):
        try:
            process.wait(timeout=10.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def main(arguments: List[str]) -> int:
    """Watch, and write what was found."""
    found = watch(int(arguments[0]), float(arguments[1]), float(arguments[2]))
    Path(arguments[3]).write_text(json.dumps(found), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
