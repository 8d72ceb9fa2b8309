"""Does `sensor:=NAME` take what the driver of that camera publishes? A bag with its topics, types and encodings, each
played through launch/bag.launch with that one argument.

The table says what the drivers document (docs/sensors.md names the pages); the launch files are not looked at. The
depth images hold one distance, 8 % more than that which the face has without depth: a face that is found at it was
placed by them.
"""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path
from typing import Dict, List, NamedTuple, Optional, Tuple

import cv2
import numpy as np

from benchmarks.stack_run import StackRun
from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.frames import read, scan
from hri_pipeline.core.onnx import models_directory
from hri_pipeline.score.bag import BagWriter

SIZE, FIELD_OF_VIEW = (640, 480), 1.0472
RATE_HZ, SECONDS, BASE_S = 8.0, 5.0, 1000.0
FARTHER = 1.08
PATIENCE_S = 90.0
PICTURE = "sample1.jpg"


class DriverTopics(NamedTuple):
    """What a driver publishes. colour, depth: topic and encoding; depth empty where none is registered to colour."""

    colour: Tuple[str, str]
    camera_info: str
    frame: str
    depth: Tuple[str, str] = ("", "")
    compressed: bool = False


DRIVERS: Dict[str, DriverTopics] = {
    "usb": DriverTopics(("/usb_cam/image_raw", "rgb8"), "/usb_cam/camera_info", "head_camera"),
    "pepper": DriverTopics(("/pepper_robot/camera/front/image_raw", "rgb8"), "/pepper_robot/camera/front/camera_info",
                           "CameraTop_optical_frame", compressed=True),
    "realsense_d400": DriverTopics(("/camera/color/image_raw", "rgb8"), "/camera/color/camera_info",
                                   "camera_color_optical_frame",
                                   ("/camera/aligned_depth_to_color/image_raw", "16UC1")),
    "azure_kinect": DriverTopics(("/rgb/image_raw", "bgra8"), "/rgb/camera_info", "rgb_camera_link",
                                 ("/depth_to_rgb/image_raw", "32FC1")),
    "zed": DriverTopics(("/zed/zed_node/rgb/image_rect_color", "bgra8"), "/zed/zed_node/rgb/camera_info",
                        "zed_left_camera_optical_frame", ("/zed/zed_node/depth/depth_registered", "32FC1")),
    "oak_d": DriverTopics(("/oak/rgb/image_raw", "bgr8"), "/oak/rgb/camera_info", "oak_rgb_camera_optical_frame",
                          ("/oak/stereo/image_raw", "16UC1")),
    "tiago": DriverTopics(("/xtion/rgb/image_raw", "rgb8"), "/xtion/rgb/camera_info", "xtion_rgb_optical_frame",
                          ("/xtion/depth_registered/image_raw", "16UC1"), compressed=True),
}
_COLOURS = {"rgb8": cv2.COLOR_BGR2RGB, "bgra8": cv2.COLOR_BGR2BGRA}


def write_bag(path: Path, driver: DriverTopics, picture: np.ndarray, distance: float) -> None:
    """Write some seconds of one picture (h, w, 3) BGR, and of depth images of one distance (m)."""
    matrix = CameraModel.from_fov(*SIZE, FIELD_OF_VIEW).matrix
    with BagWriter(path) as bag:
        for number in range(int(RATE_HZ * SECONDS)):
            stamp = BASE_S + number / RATE_HZ
            header = bag.header(stamp, driver.frame)
            name = "sensor_msgs/msg/CameraInfo"
            roi = bag.make("sensor_msgs/msg/RegionOfInterest", 0, 0, 0, 0, False)
            bag.write(driver.camera_info, name, bag.make(
                name, header, SIZE[1], SIZE[0], "plumb_bob", np.zeros(5), matrix.ravel(), np.eye(3).ravel(),
                np.hstack([matrix, np.zeros((3, 1))]).ravel(), 0, 0, roi), stamp)
            topic, encoding = driver.colour
            if driver.compressed:
                name = "sensor_msgs/msg/CompressedImage"
                _, data = cv2.imencode(".jpg", picture)
                bag.write(topic + "/compressed", name, bag.make(name, header, "rgb8; jpeg compressed bgr8",
                                                                data.ravel()), stamp)
            else:
                pixels = cv2.cvtColor(picture, _COLOURS[encoding]) if encoding in _COLOURS else picture
                _image(bag, topic, encoding, pixels, header, stamp)
            if driver.depth[0]:
                topic, encoding = driver.depth
                depth = (np.full(SIZE[::-1], distance, np.float32) if encoding == "32FC1"
                         else np.full(SIZE[::-1], round(1000.0 * distance), np.uint16))
                _image(bag, topic, encoding, depth, header, stamp)


def _image(bag: BagWriter, topic: str, encoding: str, pixels: np.ndarray, header: object, stamp: float) -> None:
    name = "sensor_msgs/msg/Image"
    data = np.ascontiguousarray(pixels).reshape(pixels.shape[0], -1).view(np.uint8)
    bag.write(topic, name, bag.make(name, header, pixels.shape[0], pixels.shape[1], encoding, 0, data.shape[1],
                                    data.ravel()), stamp)


def play(name: str, distance: float) -> Tuple[float, str]:
    """Play the bag of a preset through the faces of the stack.

    Returns how far away the largest face is in the end (m), 0 without one, and the frame in which it is.
    """
    driver = DRIVERS[name]
    picture = cv2.imread(str(models_directory() / "demo" / PICTURE))
    if picture is None:
        raise FileNotFoundError("the demo pictures are missing; fetch them: rosrun hri_pipeline fetch_models")
    with tempfile.TemporaryDirectory(prefix="ros4hri-presets-") as folder, StackRun() as run:
        bag, told = Path(folder) / "camera.bag", Path(folder) / "told.bag"
        write_bag(bag, driver, cv2.resize(picture, SIZE), distance)
        run.start_master()
        # Not the command rosbag: it ends on SIGINT before its child, the recorder, has closed the bag.
        recorder = run.start("record", ["rosrun", "rosbag", "record", "-O", str(told), "/tf"])
        command = ["roslaunch", "ros4hri", "bag.launch", "bag:=" + str(bag), "sensor:=" + name, "bag_rate:=0.5"]
        command += [part + ":=false" for part in ("rviz", "bodies", "voices", "persons", "interactions", "overlay")]
        launch = run.start("launch", command + (["image_transport:=compressed"] if driver.compressed else []))
        try:
            launch.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            launch.terminate()
        recorder.send_signal(2)     # Ctrl-C: it closes the bag
        recorder.wait(PATIENCE_S)
        found = faces_of(told) if told.exists() else []
    run.remove_logs()
    return max(found, default=(0.0, ""), key=lambda item: -item[0])


def faces_of(bag: Path) -> List[Tuple[float, str]]:
    """Return the last distance (m) and the parent frame of each face of a bag."""
    from rosbags.highlevel import AnyReader
    latest: Dict[str, Tuple[float, str]] = {}
    with AnyReader([bag]) as reader:
        for _, _, data in reader.messages():
            raw = bytes(data)
            for child, offset in scan(raw):
                if child.startswith(b"face_"):
                    link = read(raw, offset)
                    latest[link.child] = (float(np.linalg.norm(link.translation)), link.parent)
    return list(latest.values())


def problem_of(name: str, distance: float, plain: Optional[float]) -> str:
    """Return what is wrong with a preset, empty for nothing. plain: distance (m) of the same face without depth."""
    found, frame = play(name, distance)
    driver = DRIVERS[name]
    if not found:
        return "no face is found"
    if frame != driver.frame:
        return "the face is in {}, not in {}".format(frame, driver.frame)
    if plain is not None and driver.depth[0] and abs(found / plain - FARTHER) > 0.03:
        return "the face is {:.2f} m away, {:.2f} m by the depth images".format(found, distance)
    if plain is not None and not driver.depth[0] and abs(found / plain - 1.0) > 0.03:
        return "the face is {:.2f} m away, {:.2f} m at another camera of the same kind".format(found, plain)
    return ""


def figures() -> Dict[str, object]:
    """Number of the presets that fail, and what is wrong with each."""
    plain, _ = play("usb", 1.0)
    problems = {name: problem_of(name, FARTHER * plain, plain) for name in DRIVERS} if plain else {
        "usb": "no face is found"}
    return {"presets_failed": sum(bool(text) for text in problems.values()),
            "presets": {name: text or "right" for name, text in problems.items()}}
