"""The whole stack before a robot that moves: three people in a photograph stand still, while the camera pans, turns
and drives, and images and transforms say so.

A ROS node: `python3 -m benchmarks.moving_stack MOTION LATE FILE`. It publishes the camera and its transforms, LATE
seconds after their time, for MOTION (`moving_robot.MOTIONS`), and writes what the stack said of persons meanwhile.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from pathlib import Path
from typing import List, Tuple

import numpy as np
import rospy
from sensor_msgs.msg import CameraInfo, Image
from tf2_msgs.msg import TFMessage

from benchmarks.moving_robot import BASE, CAMERA_M, HEAD, HFOV, MOTIONS, OPTICAL, RATE_HZ, ROOM, View, turned
from hri_msgs.msg import IdsList
from hri_pipeline.core.geometry import Pose
from hri_pipeline.ros.conversions import bgr_to_image, camera_info, make_header, transform_to_msg

SCENE_PEOPLE = 3
MEETING_S = 12.0
"""For so long (s) the camera stands before the motion begins, so that everybody has an id that stays."""
NODES_PATIENCE_S = 60.0
TRANSFORMS_HZ = 50.0
CAMERA = "camera_color_optical_frame"
_PREFIX = "person_"


class Story:
    """What the stack says of persons: their places, and who is tracked since when."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._places: List[Tuple[float, str, List[float]]] = []
        self._tracked: List[Tuple[float, List[str]]] = []
        self._subscribers = [
            rospy.Subscriber("/tf", TFMessage, self._on_tf, queue_size=1000),
            rospy.Subscriber("/humans/persons/tracked", IdsList, self._on_tracked, queue_size=100)]

    def _on_tf(self, message: TFMessage) -> None:
        told = [(link.header.stamp.to_sec(), link.child_frame_id[len(_PREFIX):],
                 [link.transform.translation.x, link.transform.translation.y, link.transform.translation.z])
                for link in message.transforms
                if link.child_frame_id.startswith(_PREFIX) and link.header.frame_id == ROOM]
        with self._lock:
            self._places += told

    def _on_tracked(self, message: IdsList) -> None:
        with self._lock:
            self._tracked.append((message.header.stamp.to_sec(), list(message.ids)))

    def close(self, start: float) -> dict:
        """Return all of it with times (s) after `start`, and listen no longer."""
        for subscriber in self._subscribers:
            subscriber.unregister()
        with self._lock:
            return {"places": [(at - start, person, place) for at, person, place in self._places],
                    "tracked": [(at - start, ids) for at, ids in self._tracked]}


class Robot:
    """Publishes the images of a motion and the transforms of base, head and camera."""

    def __init__(self, motion_name: str, late: float) -> None:
        """late: how long (s) after their time transforms are sent."""
        from benchmarks.scenes import make_scene
        from hri_pipeline.core.onnx import models_directory
        self._motion, self._late = MOTIONS[motion_name], late
        view = View(make_scene(SCENE_PEOPLE, models_directory() / "demo"))
        times = np.arange(0.0, self._motion.seconds, 1.0 / RATE_HZ)
        self._images = [view.image(self._motion, now) for now in times]
        self._image = rospy.Publisher("/camera/image_raw", Image, queue_size=2)
        self._info = rospy.Publisher("/camera/camera_info", CameraInfo, queue_size=2)
        self._tf = rospy.Publisher("/tf", TFMessage, queue_size=100)
        self._ended = threading.Event()

    def wait_for_nodes(self) -> None:
        """Wait until faces, bodies and persons are listened for. Raises RuntimeError when they do not come."""
        ends = time.monotonic() + NODES_PATIENCE_S
        while self._image.get_num_connections() < 2 or self._tf.get_num_connections() < 2:
            if time.monotonic() > ends:
                raise RuntimeError("no nodes listen to /camera/image_raw and /tf")
            time.sleep(0.1)

    def move(self) -> float:
        """Stand, then move; return when the motion began (s since the epoch)."""
        begin = time.time() + 1.0
        start = begin + MEETING_S
        sender = threading.Thread(target=self._send_transforms, args=(begin - 1.0, start))
        sender.start()
        try:
            for number in range(int(MEETING_S * RATE_HZ) + len(self._images)):
                stamp = begin + number / RATE_HZ
                time.sleep(max(0.0, stamp - time.time()))
                image, header = self._images[max(0, number - int(MEETING_S * RATE_HZ))], make_header(stamp, CAMERA)
                self._image.publish(bgr_to_image(image, header))
                self._info.publish(camera_info(image.shape[1], image.shape[0], HFOV, header))
            time.sleep(0.5)
        finally:
            self._ended.set()
            sender.join()
        return start

    def _send_transforms(self, begin: float, start: float) -> None:
        number = 0
        while not self._ended.is_set():
            stamp = begin + number / TRANSFORMS_HZ
            number += 1
            self._ended.wait(max(0.0, stamp + self._late - time.time()))
            state = self._motion.state(min(max(stamp - start, 0.0), self._motion.seconds))
            base = turned(state.turn, place=(state.forward, 0.0, 0.0))
            head = turned(state.pan, state.tilt, state.roll, (0.0, 0.0, CAMERA_M))
            self._tf.publish(TFMessage([transform_to_msg(pose, stamp, parent, child) for pose, parent, child in (
                (base, ROOM, BASE), (head, BASE, HEAD), (Pose(OPTICAL.rotation, np.zeros(3)), HEAD, CAMERA))]))


def main(arguments: List[str]) -> int:
    """Move before the nodes that run, and write what they said."""
    motion, late, path = arguments
    rospy.init_node("moving_stack", disable_signals=True)
    robot, story = Robot(motion, float(late)), Story()
    robot.wait_for_nodes()
    start = robot.move()
    Path(path).write_text(json.dumps(story.close(start)), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
