"""What the interactions node costs on a ROS graph of its own, with simulated people.

As a program, on a graph that is there: `interactions_load PEOPLE RATE SECONDS FILE` watches the node and writes JSON.
The people are simulated beforehand, so that the simulation does not take processor time while the node is measured.
"""

from __future__ import annotations

import json
import math
import sys
import threading
import time
from pathlib import Path
from typing import Callable, Dict, List
from xmlrpc.client import ServerProxy

import rosgraph
import rospy
from tf2_msgs.msg import TFMessage

from benchmarks.stack_run import ROSMASTER, StackRun, cpu_s
from hri_msgs.msg import GazesStamped, GroupsStamped, IdsList
from hri_pipeline.core.simulation.parameters import PERSONS, SCENE_PARAMETERS
from hri_pipeline.core.simulation.scene_file import parse_scene
from hri_pipeline.core.simulation.sensors import Sensed, Senses
from hri_pipeline.core.simulation.world import World
from hri_pipeline.ros.conversions import transform_to_msg
from hri_pipeline.ros.scene_topics import SceneFeatures, ScenePersons
from hri_pipeline.ros.tf import TfPublisher

START_S = 60.0
SETTLE_S = 4.0
PLAYED_S = 8.0
LEAST = 0.3             # of the results that there should be
NODE = "/hri_interactions"


def load(people: int, rate: float = 15.0, seconds: float = 20.0) -> Dict[str, float]:
    """Return the load of the node, and what it was busy with.

    cpu_percent: of one core at `rate`; on a busy machine fewer images come, and what they cost is scaled to the rate.
    measured_percent: unscaled. All people are seen all the time, faces and bodies, as in a graph with a person manager.
    Raises StackRunError when something does not start, or when the node gives far fewer results than it should.
    """
    with StackRun() as run:
        run.start_master(ROSMASTER)
        run.start("interactions", ["rosrun", "hri_pipeline", "interactions", "_rate:={}".format(rate),
                                   "_robot_frame:=camera_color_optical_frame"])
        found = run.begin("watcher", "interactions_load", people, rate, seconds)(START_S + SETTLE_S + seconds + 60.0)
    run.remove_logs()
    return found


def watch(people: int, rate: float, seconds: float) -> Dict[str, float]:
    """Play the people on the graph of this process, and measure the node."""
    rospy.init_node("interaction_load", disable_signals=True)
    heard: Dict[str, object] = {"gazes": [], "groups": 0, "tracked": 0}
    rospy.Subscriber("/humans/interactions/gaze", GazesStamped,
                     lambda message: heard["gazes"].append(len(message.gazes)))
    rospy.Subscriber("/humans/interactions/groups", GroupsStamped,
                     lambda message: heard.update(groups=len(message.groups)))
    rospy.Subscriber("/humans/persons/tracked", IdsList, lambda message: heard.update(tracked=len(message.ids)))
    player = Player(people, rate, PLAYED_S)
    _wait(lambda: heard["tracked"] == people and len(heard["gazes"]) > 3 * rate, START_S,
          lambda: "{} of {} people, {} results".format(
        heard["tracked"], people, len(heard["gazes"])))
    settled = time.monotonic() + SETTLE_S
    _wait(lambda: time.monotonic() > settled, START_S, lambda: "the clock stands")
    pid = ServerProxy(rosgraph.Master("/interaction_load").lookupNode(NODE)).getPid("/interaction_load")[2]
    before, began, count = cpu_s(pid), time.monotonic(), len(heard["gazes"])
    _wait(lambda: time.monotonic() - began >= seconds, seconds + START_S, lambda: "the clock stands")
    passed, used = time.monotonic() - began, cpu_s(pid) - before
    gazes, tracked, groups = heard["gazes"][count:], heard["tracked"], heard["groups"]
    player.close()
    if tracked != people:
        raise RuntimeError("{} of {} people at the end".format(tracked, people))
    if len(gazes) < LEAST * rate * passed:
        raise RuntimeError(
            "only {} results in {:.1f} s: the machine is too busy, or the node too slow".format(len(gazes), passed)
        )
    return {"cpu_percent": round(100.0 * used / len(gazes) * rate, 2),
            "measured_percent": round(100.0 * used / passed, 2),
            "results_per_second": round(len(gazes) / passed, 2), "people": tracked,
            "gazes": round(sum(gazes) / len(gazes), 1), "groups": groups}


def _wait(condition: Callable[[], bool], seconds: float, state: Callable[[], str]) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > deadline:
            raise RuntimeError("not within {:g} s: {}".format(seconds, state()))
        time.sleep(0.02)


SPACING = 1.9
BEGIN_S = 2.0


def make_scene(people: int) -> Dict[str, object]:
    """Return a scene, as its file would say it, of people in circles of four who look at each other, the robot and
    nobody."""
    names = ["p{}".format(index) for index in range(people)]
    groups = [names[start:start + 4] for start in range(0, people, 4)]
    if len(groups) > 1 and len(groups[-1]) < 2:
        groups[-2] += groups.pop()
    columns = max(2, math.ceil(math.sqrt(len(groups))))
    formations = [{"name": "g{}".format(index), "shape": "circle", "size": 1.0, "members": members,
                   "centre": [2.0 + SPACING * (index // columns), SPACING * (index % columns - (columns - 1) / 2.0)]}
                  for index, members in enumerate(groups)]
    return {"name": "load", "duration": 600.0, "people": [{"name": name} for name in names], "formations": formations,
            "habits": {"look_robot": 0.2, "look_away": 0.15, "dwell": 3.0, "closed": 0.05, "closed_length": 0.5}}


class Player:
    """Publishes faces, bodies, persons and their frames, `rate` times a second, forwards and backwards over
    `seconds`."""

    def __init__(self, people: int, rate: float, seconds: float) -> None:
        """Simulate; takes about as long as what is simulated."""
        settings = SCENE_PARAMETERS.resolve({
            "level": PERSONS, "rate": rate, "sense_occlusion": False, "sense_hfov": 160.0, "sense_face_angle": 180.0,
            "sense_face_range": 50.0, "sense_range": 50.0, "sense_voices": False})
        scene = parse_scene(make_scene(people))
        world, senses = World(scene, 1), Senses(settings, 1, scene.robot.height)
        begin = [senses.sense(world.at(index / rate)) for index in range(int((BEGIN_S + seconds) * rate))]
        # At first nobody is listed yet.
        self._moments: List[Sensed] = begin[int(BEGIN_S * rate):]
        self._period = 1.0 / rate
        self._transforms = TfPublisher()
        self._features, self._persons = SceneFeatures(settings,
                                                      self._transforms), ScenePersons(settings, self._transforms)
        self._fixed = rospy.Publisher("/tf_static", TFMessage, queue_size=1, latch=True)
        self._fixed.publish(TFMessage(transforms=[transform_to_msg(
            self._moments[0].camera, rospy.Time.now(), settings.reference_frame, settings.camera_frame)]))
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._play, name="player", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Let everybody go. Idempotent."""
        self._stop.set()
        self._thread.join()
        for owner in (self._features, self._persons, self._transforms):
            owner.close()

    def _play(self) -> None:
        course = self._moments + self._moments[-2:0:-1]
        begun, count = time.monotonic(), 0
        while not self._stop.wait(max(0.0, begun + count * self._period - time.monotonic())):
            # On a busy machine images are left out, as a camera's would be.
            count = max(count, int((time.monotonic() - begun) / self._period))
            stamp = rospy.Time.now()
            self._features.publish(course[count % len(course)], stamp)
            self._persons.publish(course[count % len(course)], stamp)
            count += 1


def main(arguments: List[str]) -> int:
    """Watch, and write what was found."""
    found = watch(int(arguments[0]), float(arguments[1]), float(arguments[2]))
    Path(arguments[3]).write_text(json.dumps(found), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
