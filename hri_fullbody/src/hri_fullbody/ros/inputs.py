"""What the bodies need besides images: the faces that another process tracks, as boxes in the image of this one, and
which way is up for the camera and how high it stands."""

from __future__ import annotations

import threading
import time
from collections import deque
from typing import Deque, Dict, List, Optional, Tuple

import genpy
import numpy as np
import rospy
from tf2_msgs.msg import TFMessage

from hri_fullbody.core.detection.windows import FaceBox, face_boxes
from hri_pipeline.core.geometry import Pose
from hri_pipeline.ros.conversions import LandmarkArray, landmarks_from_msg, pose_from_transform
from hri_pipeline.ros.diagnostics import OK, WARN
from hri_pipeline.ros.rospy_compat import release
from hri_pipeline.ros.subscriptions import IdSubscribers
from hri_pipeline.ros.tf import RobotTfListener

# A face this much older or newer than the image may be somewhere else by now.
MAX_AGE_S = 0.5
# The pose decides about the distance of a body, and heads nod: it must be nearly of the image's time.
_POSE_AGE_S = 0.2
_POSES = 8
_PREFIX = "face_"


class FaceInput:
    """Keeps the newest landmarks and the latest poses of each face in /humans/faces/tracked.

    Callbacks only store; `boxes` reads. Of /tf only messages that mention a face are unpacked: a robot sends hundreds
    of others a second.
    """

    def __init__(self, list_timeout: float) -> None:
        """list_timeout: see IdSubscribers."""
        self._lock = threading.Lock()
        self._landmarks: Dict[str, Tuple[float, str, np.ndarray]] = {}
        self._poses: Dict[str, Deque[Tuple[float, str, Pose]]] = {}
        self._ids: List[str] = []
        self._feed = IdSubscribers("faces", {"landmarks": LandmarkArray}, self._store, self._keep,
                                 list_timeout=list_timeout)
        self._transforms = rospy.Subscriber("/tf", rospy.AnyMsg, self._on_transforms, queue_size=100)
        self._closed = False

    def boxes(self, stamp: float, width: int, height: int, frame_id: str = "") -> List[FaceBox]:
        """Return the faces within half a second of `stamp` (s), in px of an image of width x height.

        Those that another camera than that of `frame_id` sees are left out. They have a pose when one in the frame
        `frame_id` is known within 0.2 s of `stamp`.
        """
        with self._lock:
            known = dict(self._landmarks)
            poses = {identity: self._pose_near(identity, stamp, frame_id) for identity in known}
        camera = frame_id.lstrip("/")
        return face_boxes(
            (identity, landmarks[:, :2] * np.array([width, height]), poses[identity])
            for identity, (seen, frame, landmarks) in known.items()
            if abs(seen - stamp) <= MAX_AGE_S and (not camera or frame in ("", camera)))

    def close(self) -> None:
        """Stop listening. Idempotent."""
        if self._closed:
            return
        self._closed = True
        release(self._transforms)
        self._feed.close()

    def _store(self, identity: str, name: str, message: LandmarkArray) -> None:
        landmarks = landmarks_from_msg(message)
        with self._lock:
            self._landmarks[identity] = (message.header.stamp.to_sec(), message.header.frame_id.lstrip("/"), landmarks)

    def _keep(self, ids: List[str]) -> None:
        with self._lock:
            self._ids = list(ids)
            self._landmarks = {key: value for key, value in self._landmarks.items() if key in ids}
            self._poses = {key: value for key, value in self._poses.items() if key in ids}

    def _on_transforms(self, message: rospy.AnyMsg) -> None:
        """Take the poses of faces out of a serialised tf2_msgs/TFMessage."""
        if _PREFIX.encode() not in message._buff:
            return
        try:
            transforms = TFMessage().deserialize(message._buff).transforms
        except Exception as error:  # one message never ends the node
            rospy.logwarn_throttle(10.0, "/tf: message not used: %s: %s", type(error).__name__, error)
            return
        for transform in transforms:
            child = transform.child_frame_id.lstrip("/")
            if child.startswith(_PREFIX):
                self._store_pose(child[len(_PREFIX):], transform)

    def _store_pose(self, identity: str, transform: object) -> None:
        try:
            pose = pose_from_transform(transform)
        except ValueError as error:
            rospy.logwarn_throttle(10.0, "/tf: pose of face %s not used: %s", identity[:40], error)
            return
        entry = (transform.header.stamp.to_sec(), transform.header.frame_id.lstrip("/"), pose)
        with self._lock:
            if identity in self._ids:
                self._poses.setdefault(identity, deque(maxlen=_POSES)).append(entry)

    def _pose_near(self, identity: str, stamp: float, frame_id: str) -> Optional[Pose]:
        """Pose of a face in `frame_id` nearest to `stamp`, None when there is none within 0.2 s."""
        fitting = [entry for entry in self._poses.get(identity, ())
                   if entry[1] == frame_id.lstrip("/") and abs(entry[0] - stamp) <= _POSE_AGE_S]
        return min(fitting, key=lambda entry: abs(entry[0] - stamp))[2] if fitting else None


_GRACE_S = 3.0
_LOWEST_M, _HIGHEST_M = 0.05, 10.0


class UpFrame:
    """Pose of the camera in a frame whose z axis points up and whose z = 0 is the floor.

    name: that frame; empty: there is none, and `lookup` tells nothing.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._frames: Optional[RobotTfListener] = RobotTfListener(name) if name else None
        self._missing_since: Optional[float] = None
        self._told = False

    def lookup(self, camera: str, stamp: genpy.Time) -> Tuple[Optional[np.ndarray], Optional[float]]:
        """Return up (3,) in the frame `camera`, and its height above the floor, m; None while they are not known."""
        pose = self._frames.lookup(camera, stamp) if self._frames is not None and camera else None
        if pose is None:
            self._miss(camera)
            return None, None
        self._missing_since = None
        return up_and_height(pose)

    def status(self) -> Tuple[int, str]:
        """Return level and message for diagnostics; the message is empty when all is well."""
        if self._missing_since is None or time.monotonic() - self._missing_since < _GRACE_S:
            return OK, ""
        return WARN, self._problem("the camera")

    def close(self) -> None:
        """Stop listening. Idempotent."""
        if self._frames is not None:
            self._frames.close()

    def _miss(self, camera: str) -> None:
        if self._frames is None:
            return
        if self._missing_since is None:
            self._missing_since = time.monotonic()
        elif not self._told and time.monotonic() - self._missing_since > _GRACE_S:
            self._told = True
            rospy.logwarn("%s", self._problem(camera))

    def _problem(self, camera: str) -> str:
        return (
            "no transform leads from {} to ~up_frame {}; the tilt is guessed from the people. Mend: start what "
            "publishes it, or set ~up_frame to a frame that exists or to nothing".format(camera, self._name)
        )


def up_and_height(camera: Pose) -> Tuple[np.ndarray, Optional[float]]:
    """Return up (3,) in the camera's frame and its height (m) of the camera's pose in a frame whose z is up.

    A height that no camera has (below 5 cm, above 10 m) is None: z = 0 is not the floor there.
    """
    height = float(camera.translation[2])
    return camera.rotation[2].copy(), height if _LOWEST_M <= height <= _HIGHEST_M else None
