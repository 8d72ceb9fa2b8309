"""Plays people who have been simulated beforehand on a ROS graph, so that the simulation does not take the processor."""

from __future__ import annotations

import math
import threading
import time
from typing import Dict, List

import rospy
from tf2_msgs.msg import TFMessage

from hri_pipeline.core.scene.scene_parameters import PERSONS, SCENE_PARAMETERS
from hri_pipeline.core.scene.scene_script import parse_scene
from hri_pipeline.core.scene.scene_senses import Sensed, Senses
from hri_pipeline.core.scene.scene_world import World
from hri_pipeline.ros.conversions import transform_to_msg
from hri_pipeline.ros.scene.scene_features import SceneFeatures
from hri_pipeline.ros.scene.scene_persons import ScenePersons
from hri_pipeline.ros.tf_publisher import TfPublisher

SPACING = 1.9
BEGIN_S = 2.0


def make_scene(people: int) -> Dict[str, object]:
    """Return a scene, as its file would say it, of people in circles of four who look at each other, the robot and nobody."""
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
    """Publishes faces, bodies, persons and their frames, `rate` times a second, forwards and backwards over `seconds`."""

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
        self._features, self._persons = SceneFeatures(settings, self._transforms), ScenePersons(settings, self._transforms)
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
