"""The commands `cameras` and `calibrate_cameras`: several cameras by one file of names, topics, frames and places.

    reference_frame: map
    cameras:
      left: {image: /left/image_raw, camera_info: /left/camera_info, frame: left_optical_frame,
             place: [0, 0, 1.5, -0.5, 0.5, -0.5, 0.5]}
      right: {image_rotation: 180, ignored_regions: ["0.7 0 0.3 0.4"]}

What is left out of a camera is /NAME/image_raw, /NAME/camera_info and NAME_optical_frame; its place is then told by
others. `place` is x y z (m) and the quaternion x y z w of the optical frame in the reference frame. `image_rotation`,
degrees clockwise, and `ignored_regions`: see the node faces; by default gravity tells the rotation.
"""

from __future__ import annotations

import argparse
import math
import os
import re
import shutil
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Dict, Hashable, List, Mapping, NamedTuple, Optional, Sequence, Set, Tuple

import cv2
import numpy as np
import rospy
import yaml
from sensor_msgs.msg import CameraInfo, Image

from hri_msgs.msg import IdsList, Skeleton2D
from hri_person_manager.core.camera_poses import (
    CalibrationError,
    CameraPoses,
    at_common_times,
    board_scale,
    deviations,
    solve_poses,
    stature_scale,
)
from hri_pipeline.core.camera import Calibration, CameraError, CameraModel
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.ignored_regions import IgnoredRegions
from hri_pipeline.core.image_rotation import CHOICES
from hri_pipeline.core.images import is_rectified
from hri_pipeline.core.parameters import ParameterError
from hri_pipeline.ros.conversions import camera_from_info, image_to_bgr, skeleton_from_msg

# Level, looking along x of the reference frame.
_FIRST_PLACE = (0.0, 0.0, 0.0, -0.5, 0.5, -0.5, 0.5)
_UNCERTAIN_M, _UNCERTAIN_RAD = 0.3, math.radians(5.0)     # standard deviations of poses that are of no use
# In the order of Skeleton2D.
_JOINTS = ("nose", "neck", "right_shoulder", "right_elbow", "right_wrist", "left_shoulder", "left_elbow", "left_wrist",
           "right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle", "left_eye", "right_eye",
           "left_ear", "right_ear")
_SURE = 0.6                 # confidence of a key point that counts
_KEYS = ("image", "camera_info", "depth", "frame", "image_rotation", "place")
_ALL_KEYS = (*_KEYS, "ignored_regions")


class CameraFileError(ValueError):
    """The file is none of cameras."""


@dataclass(frozen=True)
class CameraEntry:
    """One camera of the file; place: 7 numbers, None: others publish it. image_rotation: empty: by gravity."""

    name: str
    image: str
    camera_info: str
    frame: str
    depth: str = ""
    place: Optional[Tuple[float, ...]] = None
    image_rotation: str = ""
    ignored_regions: Tuple[str, ...] = ()


class _Loader(yaml.SafeLoader):
    """Refuses a mapping in which a name stands twice: of these, YAML would silently take the last."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> Dict[Hashable, Any]:
        """Return the mapping of a node. Raises yaml.constructor.ConstructorError."""
        names: Set[object] = set()
        for key, _ in node.value:
            if key.value in names:
                raise yaml.constructor.ConstructorError(
                    None, None, "the name {} stands twice; give each camera another one".format(key.value),
                    key.start_mark)
            names.add(key.value)
        return super().construct_mapping(node, deep)


def read_cameras(path: Path) -> Tuple[str, List[CameraEntry]]:
    """Return the reference frame and the cameras of a file. Raises CameraFileError with what is wrong in it."""
    try:
        data = yaml.load(path.read_text(encoding="utf-8"), _Loader)
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise CameraFileError("{}: {}".format(path, error)) from error
    cameras = data.get("cameras") if isinstance(data, dict) else None
    if not isinstance(cameras, dict) or len(cameras) < 2:
        raise CameraFileError("{}: wanted 'cameras:' with two names or more".format(path))
    return str(data.get("reference_frame", "map")), [_entry(path, str(name), given or {})
                                                     for name, given in cameras.items()]


def _entry(path: Path, name: str, given: Mapping[str, object]) -> CameraEntry:
    if not re.match(r"^[A-Za-z][A-Za-z0-9_]*$", name):
        raise CameraFileError("{}: the camera's name {!r} is no ROS name".format(path, name))
    unknown = [key for key in given if key not in _ALL_KEYS] if isinstance(given, dict) else [repr(given)]
    if unknown:
        raise CameraFileError("{}: camera {} has {}, wanted some of {}".format(
            path, name, unknown[0], ", ".join(_ALL_KEYS)))
    texts = {key: "" if given.get(key) is None or given[key] is False else str(given[key]) for key in _KEYS[:-1]}
    odd = [text for text in texts.values() if re.search(r"[\s;,]", text)]
    if odd:
        raise CameraFileError("{}: camera {} has {!r}, which is no ROS name".format(path, name, odd[0]))
    if texts["image_rotation"] not in ("", *CHOICES):
        raise CameraFileError("{}: camera {} has the image_rotation {}, wanted one of {}".format(
            path, name, texts["image_rotation"], ", ".join(CHOICES)))
    place = _place(given.get("place"))
    if place is not None and (len(place) != 7 or not np.isclose(np.linalg.norm(place[3:]), 1.0, 0.0, 0.01)):
        raise CameraFileError("{}: the place of camera {} is not x y z (m) and a unit quaternion x y z w".format(
            path, name))
    return CameraEntry(name, texts["image"] or "/{}/image_raw".format(name),
                       texts["camera_info"] or "/{}/camera_info".format(name),
                       texts["frame"] or name + "_optical_frame", texts["depth"], place, texts["image_rotation"],
                       _regions(path, name, given.get("ignored_regions")))


def _regions(path: Path, name: str, given: object) -> Tuple[str, ...]:
    """The ignored regions of a camera, each "x y width height". Raises CameraFileError."""
    rows = [given] if isinstance(given, str) else given or []
    if not isinstance(rows, list):
        raise CameraFileError("{}: the ignored_regions of camera {} are no list".format(path, name))
    try:
        IgnoredRegions([str(row) for row in rows])
    except ParameterError as error:
        raise CameraFileError("{}: camera {}: {}".format(path, name, error)) from error
    return tuple(" ".join(str(row).split()) for row in rows)


def _place(given: object) -> Optional[Tuple[float, ...]]:
    """Numbers of a list or a text; none for what is neither."""
    if given is None:
        return None
    try:
        return tuple(float(value) for value in (given.split() if isinstance(given, str) else list(given)))  # type: ignore
    except (TypeError, ValueError):
        return ()


def launch_arguments(reference_frame: str, cameras: Sequence[CameraEntry]) -> List[str]:
    """Return the arguments of two_cameras.launch for these cameras."""
    arguments = ["reference_frame:=" + reference_frame]
    for side, camera in zip(("left", "right"), cameras):
        values = {side: camera.name, side + "_image": camera.image, side + "_camera_info": camera.camera_info,
                  side + "_frame": camera.frame, side + "_depth": camera.depth,
                  side + "_ignored_regions": str(list(camera.ignored_regions)) if camera.ignored_regions else "",
                  side + "_image_rotation": camera.image_rotation, side + "_place": _text(camera.place, " ")}
        arguments += ["{}:={}".format(*item) for item in values.items()]
    more = [";".join((camera.name, camera.image, camera.camera_info, camera.frame, camera.depth,
                      _text(camera.place, ","), camera.image_rotation,
                      "|".join(camera.ignored_regions).replace(" ", ",")))
            for camera in cameras[2:]]
    return [*arguments, "more:=" + " ".join(more)]


def _text(place: Optional[Sequence[float]], between: str) -> str:
    return between.join("{:.6g}".format(value) for value in place or ())


def run_cameras(arguments: Optional[Sequence[str]] = None) -> int:
    """Become `roslaunch ros4hri two_cameras.launch` with the cameras of a file; 1 for a file that is none."""
    parser = argparse.ArgumentParser(prog="cameras", description="Starts the stack for the cameras of a YAML file.")
    parser.add_argument("file", type=Path, help="cameras: {NAME: {image, camera_info, frame, depth, place, "
                        "image_rotation, ignored_regions}}")
    parser.add_argument("rest", nargs="*", metavar="ARG:=VALUE", help="further arguments of two_cameras.launch")
    options = parser.parse_args(arguments)
    try:
        given = launch_arguments(*read_cameras(options.file))
    except CameraFileError as error:
        sys.stderr.write("cameras: {}\n".format(error))
        return 1
    os.execvp("roslaunch", ["roslaunch", "ros4hri", "two_cameras.launch", *given, *options.rest])


class Board(NamedTuple):
    """A ChArUco board: columns and rows of squares, their side and that of the markers in m."""

    columns: int
    rows: int
    square: float
    marker: float

    @classmethod
    def parse(cls, text: str) -> "Board":
        """Read 7x5,0.04,0.03; raises ValueError for anything else."""
        size, square, marker = text.split(",")
        columns, rows = size.split("x")
        board = cls(int(columns), int(rows), float(square), float(marker))
        if min(board.columns, board.rows) < 3 or not 0.0 < board.marker < board.square:
            raise ValueError(text)
        return board

    @property
    def neighbours(self) -> List[Tuple[str, str]]:
        """Pairs of corners, by name, that are one square apart."""
        width = self.columns - 1
        return [(str(number), str(number + 1)) for number in range(width * (self.rows - 1)) if (number + 1) % width]


class _Recorder:
    """Takes what the cameras see. tracks: for each camera (stamp, points (2,) x/z, y/z by name)."""

    def __init__(self, cameras: Sequence[CameraEntry], board: Optional[Board]) -> None:
        self._cameras = cameras
        self._models: Dict[str, CameraModel] = {}
        self._bodies: Dict[str, rospy.Subscriber] = {}
        self._seen: Dict[str, Dict[float, List[Dict[str, np.ndarray]]]] = {camera.frame: {} for camera in cameras}
        self._subscribers = [rospy.Subscriber(camera.camera_info, CameraInfo, self._on_info, camera)
                             for camera in cameras]
        if board is None:
            self._subscribers.append(rospy.Subscriber("/humans/bodies/tracked", IdsList, self._on_bodies))
            return
        dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
        self._detector = cv2.aruco.CharucoDetector(cv2.aruco.CharucoBoard(
            (board.columns, board.rows), board.square, board.marker, dictionary))
        self._subscribers += [rospy.Subscriber(camera.image, Image, self._on_image, camera, queue_size=1,
                                               buff_size=2 ** 24) for camera in cameras]

    def close(self) -> None:
        """End all subscriptions."""
        for subscriber in (*self._subscribers, *self._bodies.values()):
            subscriber.unregister()

    @property
    def focal(self) -> float:
        """Mean focal length, px. Raises CalibrationError while a camera has told none."""
        missing = [camera.camera_info for camera in self._cameras if camera.frame not in self._models]
        if missing:
            raise CalibrationError("nothing of a calibrated camera came on {}: calibrate each camera's lens first "
                                   "(camera_calibration), and check the topic".format(", ".join(missing)))
        return float(np.mean([model.matrix[0, 0] for model in self._models.values()]))

    @property
    def tracks(self) -> List[List[Tuple[float, Dict[str, np.ndarray]]]]:
        """What was seen while one body, or the board, was there."""
        return [[(stamp, found[0]) for stamp, found in sorted(self._seen[camera.frame].items()) if len(found) == 1]
                for camera in self._cameras]

    def _on_info(self, message: CameraInfo, camera: CameraEntry) -> None:
        try:
            model = camera_from_info(message, 1.0, rectified=is_rectified(camera.image))
        except CameraError as error:
            rospy.logwarn_throttle(5.0, "{}: {}".format(camera.camera_info, error))
            return
        if model.calibration == Calibration.CALIBRATED:
            self._models[camera.frame] = model

    def _on_bodies(self, message: IdsList) -> None:
        for gone in set(self._bodies) - set(message.ids):
            self._bodies.pop(gone).unregister()
        for body in set(message.ids) - set(self._bodies):
            self._bodies[body] = rospy.Subscriber("/humans/bodies/{}/skeleton2d".format(body), Skeleton2D,
                                                  self._on_skeleton)

    def _on_skeleton(self, message: Skeleton2D) -> None:
        model = self._models.get(message.header.frame_id.lstrip("/"))
        if model is None:
            return
        try:
            points = skeleton_from_msg(message)
        except ValueError as error:
            rospy.logwarn_throttle(5.0, "skeleton2d: {}".format(error))
            return
        rays = model.normalise(points[:, :2] * (model.width, model.height))
        self._add(message.header.frame_id.lstrip("/"), message.header.stamp.to_sec(), {
            name: ray for name, ray, (_, _, confidence) in zip(_JOINTS, rays, points) if confidence >= _SURE})

    def _on_image(self, message: Image, camera: CameraEntry) -> None:
        model = self._models.get(camera.frame)
        if model is None:
            return
        try:
            image = cv2.cvtColor(image_to_bgr(message), cv2.COLOR_BGR2GRAY)
        except ValueError as error:
            rospy.logwarn_throttle(5.0, "{}: {}".format(camera.image, error))
            return
        corners, numbers, _, _ = self._detector.detectBoard(image)
        if numbers is not None and len(numbers):
            self._add(camera.frame, message.header.stamp.to_sec(), {
                str(number): ray for number, ray in zip(numbers.ravel().tolist(), model.normalise(corners[:, 0]))})

    def _add(self, frame: str, stamp: float, points: Dict[str, np.ndarray]) -> None:
        self._seen[frame].setdefault(stamp, []).append(points)


def placed(cameras: Sequence[CameraEntry], found: CameraPoses) -> List[CameraEntry]:
    """Return the cameras with their places in the reference frame, the first one's as it was."""
    first = cameras[0].place or _FIRST_PLACE
    base = Pose.from_quaternion(first[3:], first[:3])
    poses = [base.compose(pose) for pose in found.poses]
    return [replace(camera, place=(*pose.translation.tolist(), *pose.quaternion))
            for camera, pose in zip(cameras, poses)]


def write_cameras(path: Path, reference_frame: str, cameras: Sequence[CameraEntry]) -> None:
    """Write a file of cameras with their places; one that is there stays whole where that fails (OSError)."""
    data = {"reference_frame": reference_frame, "cameras": {camera.name: {
        key: [round(float(value), 5) for value in camera.place or ()] if key == "place" else getattr(camera, key)
        for key in _ALL_KEYS if getattr(camera, key)} for camera in cameras}}
    path = path.resolve()
    draft = path.with_name(path.name + ".new")
    try:
        draft.write_text(yaml.safe_dump(data, sort_keys=False, default_flow_style=None), encoding="utf-8")
        if path.exists():
            shutil.copymode(str(path), str(draft))
        os.replace(str(draft), str(path))
    except OSError:
        if draft.exists():
            draft.unlink()
        raise


def run_calibrate(arguments: Optional[Sequence[str]] = None) -> int:
    """Find the poses of the cameras of a file and write them into it; 1 where that is not possible, 2 for a wrong
    command line."""
    options = _options(rospy.myargv(arguments or sys.argv)[1:])
    try:
        reference_frame, cameras = read_cameras(options.file)
        found, certain, focal = _calibrate(cameras, options)
        result = placed(cameras, found)
        check_certain(cameras, certain)
        write_cameras(options.output or options.file, reference_frame, result)
    except (CameraFileError, CalibrationError, OSError) as error:
        sys.stderr.write("calibrate_cameras: {}\n".format(error))
        return 1
    for camera, (place, direction) in zip(result, [(0.0, 0.0), *certain]):
        print("{}: {} (+- {:.2f} m, {:.1f} deg)".format(camera.name, _text(camera.place, " "), place,
                                                        math.degrees(direction)))
    print("residual {:.2f} px of {} points".format(focal * found.residual, len(found.points)))
    return 0


def check_certain(cameras: Sequence[CameraEntry], certain: Sequence[Tuple[float, float]]) -> None:
    """Raise CalibrationError where the pose of a camera, of all but the first, is so uncertain that it is of no use.

    certain: standard deviations of place (m) and direction (rad).
    """
    for camera, (place, direction) in zip(cameras[1:], certain):
        if place > _UNCERTAIN_M or direction > _UNCERTAIN_RAD:
            raise CalibrationError(
                "the pose of {} is uncertain by {:.2f} m and {:.1f} deg, at most {:g} m and {:g} deg are of use; "
                "nothing is written. Walk longer, nearer and farther, left and right, and turn about".format(
                    camera.name, place, math.degrees(direction), _UNCERTAIN_M, math.degrees(_UNCERTAIN_RAD)))


def _calibrate(cameras: Sequence[CameraEntry], options: argparse.Namespace
               ) -> Tuple[CameraPoses, List[Tuple[float, float]], float]:
    """The poses, in m, their standard deviations, and the mean focal length, px."""
    rospy.init_node("calibrate_cameras", anonymous=True)
    recorder = _Recorder(cameras, options.board)
    sys.stderr.write("{} for {:g} s where two cameras see it, near and far, left and right.\n".format(
        "Walk alone" if options.board is None else "Move the board slowly", options.seconds))
    try:
        rospy.sleep(options.seconds)
        focal = recorder.focal
    finally:
        recorder.close()
    sys.stderr.write("Finding the poses, four times, to tell how certain they are ...\n")
    seen = at_common_times(recorder.tracks)
    found = solve_poses(seen)
    if options.distance is not None:
        factor = options.distance / max(1e-9, float(np.linalg.norm(found.poses[1].translation)))
    elif options.board is not None:
        factor = board_scale(found.points, options.board.neighbours, options.board.square)
    else:
        factor = stature_scale(found.points, options.stature)
    found = found.scaled(factor)
    return found, deviations(seen, found), focal


def _length(text: str) -> float:
    value = float(text)
    if not 0.0 < value < math.inf:
        raise ValueError(text)
    return value


def _options(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="calibrate_cameras", description="Finds where fixed cameras are, by somebody "
                                     "who walks alone before them while the stack runs, or by a ChArUco board.")
    parser.add_argument("file", type=Path, help="YAML file as `cameras` takes it; the places are written into it")
    parser.add_argument("--seconds", type=float, default=60.0, help="how long to look (default: %(default)s)")
    scale = parser.add_mutually_exclusive_group(required=True)
    scale.add_argument("--stature", type=_length, help="of the person, m")
    scale.add_argument("--board", type=Board.parse, help="COLUMNSxROWS,SQUARE,MARKER: squares, and sides in m, such as "
                       "7x5,0.04,0.03; dictionary 4X4_50")
    scale.add_argument("--distance", type=_length, help="between the first two cameras, m, measured: the most exact")
    parser.add_argument("--output", type=Path, help="write another file")
    return parser.parse_args(arguments)
