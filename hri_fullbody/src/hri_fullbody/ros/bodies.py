"""The ROS side of the body pipeline: topics, frames, URDFs and diagnostics of all bodies, and what they need besides
images: the faces that another process tracks."""

from __future__ import annotations

import importlib
import math
import threading
from collections import OrderedDict, deque
from dataclasses import replace
from typing import Callable, Deque, Dict, Iterable, List, Mapping, Optional, Sequence, Set, Tuple

import numpy as np
import rospy
from geometry_msgs.msg import TransformStamped
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from hri_fullbody.core.behaviour.pointing import Pointing, turned_pointing
from hri_fullbody.core.detection.windows import FaceBox, face_boxes
from hri_fullbody.core.model.urdf import make_urdf
from hri_fullbody.core.modeller import ModelledBody, turned_model
from hri_fullbody.core.parameters import BodiesSettings
from hri_fullbody.core.pipeline import BodyPipeline
from hri_fullbody.core.tracking.reidentification import Reidentification, prepare_colours
from hri_fullbody.ros.state_publishers import StatePublishers
from hri_fullbody.ros.topics import NAMESPACE, BodyTopics, pointing_message, skeleton_markers
from hri_msgs.msg import IdsList, IdsMatch, PointingStamped
from hri_pipeline.core.error_log import ItemGuard
from hri_pipeline.core.frames import RawTransform, read, scan
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.ids import is_valid_id
from hri_pipeline.core.image_rotation import ImageRotation, quarter_turns, turned_problem
from hri_pipeline.core.observations import BodyObservation, FaceObservation
from hri_pipeline.core.onnx import ModelLog
from hri_pipeline.core.person_detector import PersonDetector
from hri_pipeline.core.privacy import DataUse
from hri_pipeline.core.process import Threads
from hri_pipeline.core.timing import StampPacer
from hri_pipeline.ros.conversions import (
    LandmarkArray,
    landmarks_from_msg,
    match_to_msg,
    transform_to_msg,
)
from hri_pipeline.ros.diagnostics import OK, WARN, Status
from hri_pipeline.ros.image_input import Frame
from hri_pipeline.ros.markers import ShownMarkers
from hri_pipeline.ros.mounting import UP
from hri_pipeline.ros.publishers import MATCHES_TOPIC, TrackedList
from hri_pipeline.ros.rospy_compat import release
from hri_pipeline.ros.subscriptions import IdSubscribers
from hri_pipeline.ros.tf import TfPublisher

_LOG_PERIOD_S = 10.0
_APPEARANCE_HZ = 1.0
_MOST_BODIES = 500
_NO_FRAME = "images have no frame_id, so bodies have no TF frame; set the camera driver's frame_id"


class BodyProcessor:
    """Runs BodyPipeline on each frame and publishes its results. A body that cannot be published costs no other.

    settings: the values of `parameters.BODIES`. listen_for_faces: follow the faces of another process; with False only
    those that a processor before this one has put into context["faces"] are used. threads: of the networks; by default
    as the settings say.
    Raises ModelError when a network is missing or damaged, ParameterError for a segments file that cannot be used.
    """

    name = "bodies"
    data_use = DataUse(("key points", "skeletons", "statures", "clothes, for some seconds", "attitudes", "postures",
                        "gestures"))

    def __init__(self, settings: BodiesSettings, listen_for_faces: bool = True,
                 threads: Optional[Threads] = None) -> None:
        self._guard = ItemGuard(rospy.logerr)
        self._networks = ModelLog(rospy.logwarn)
        self._pipeline = BodyPipeline(settings, notify=self._networks, guard=self._guard, threads=threads)
        self._publishers: Optional[StatePublishers] = None
        if settings.state_publishers:
            self._publishers = StatePublishers(settings.max_bodies, settings.joint_state_rate)
        self._pacer = StampPacer(settings.joint_state_rate)
        self._appearance_pacer = StampPacer(_APPEARANCE_HZ)
        self._topics = BodyTopics(settings.interface)
        self._tracked = TrackedList(NAMESPACE + "/tracked")
        self._transforms = TfPublisher()
        self._markers = rospy.Publisher("visualization/skeletons", MarkerArray, queue_size=1)
        self._pointing = rospy.Publisher("/humans/interactions/pointing", PointingStamped, queue_size=1)
        self._shown = ShownMarkers()
        self._matches = ReidentificationMatches(settings.list_timeout) if settings.body_memory > 0.0 else None
        self._faces = FaceInput(settings.list_timeout) if listen_for_faces else None
        self._no_frame = False
        self._quarters = 0
        self._turned = ""
        self._closed = False
        threading.Thread(target=_prepare, name="prepare", daemon=True).start()

    @property
    def person_detector(self) -> PersonDetector:
        """What tells where there are people."""
        return self._pipeline.person_detector

    def process(self, frame: Frame, context: dict) -> None:
        """Find the bodies in a frame, publish them, and leave them in context["bodies"]."""
        if "age" in context:
            self._pipeline.note_timing(context["age"], context["took"])
        # Where somebody is does not wait for the search of others.
        self._find(frame, context, lambda seen: self._publish(seen, frame, context))
        self._tell_turned(frame, context.get(UP, (None,))[0])

    def _publish(self, seen: Sequence[BodyObservation], frame: Frame, context: dict) -> None:
        """Publish the bodies of the turned image, and leave them in context["bodies"] as they are in the frame."""
        bodies = context["bodies"] = [frame.rotation.body_back(body) for body in seen]
        if frame.overtaken():
            return
        ids = self._pipeline.tracked_ids
        self._guard.attempt("topic", self._topics.keep, ids)
        self._tracked.set(ids, frame.header.stamp)
        self._guard.each("body", lambda body: self._topics.publish_seen(body, frame), bodies)
        if self._appearance_pacer.is_due(frame.stamp):
            self._guard.each("body", lambda body: self._topics.publish_appearance(
                body.id, self._pipeline.appearance(body.id), frame), bodies)
        if self._matches is not None:
            self._matches.publish(self._pipeline.reidentified)
        if self._publishers is not None:
            self._publishers.keep(ids)
            self._guard.each("body", self._describe, self._pipeline.modelled)
        models = self._models(seen, frame.rotation)
        pointing = {name: turned_pointing(one, frame.rotation.back) for name, one in self._pipeline.pointing.items()}
        self._publish_models(bodies, models, frame)
        if self._pointing.get_num_connections():
            self._pointing.publish(pointing_message(pointing, frame.header))
        if self._markers.get_num_connections() and not self._no_frame:
            self._draw([drawn(body, models.get(body.id)) for body in bodies], frame, pointing)

    def _find(self, frame: Frame, context: dict, seen: Callable[[List[BodyObservation]], None]) -> None:
        """Find the bodies of the turned image, and hand over those that are known."""
        up, height, pose = context.get(UP, (None, None, None))
        rotation, upright = frame.rotation, frame.upright
        if rotation.quarters != self._quarters:
            self._pipeline.turn(rotation.since(self._quarters))
            self._quarters = rotation.quarters
        self._pipeline.update(
            upright.bgr, upright.camera, frame.stamp, self._face_boxes(frame, context), depth=upright.depth,
            up=None if up is None else rotation.vectors(up), camera_height=height,
            camera_pose=None if pose is None else rotation.of_camera(pose), seen=seen)

    def _models(self, seen: Sequence[BodyObservation], rotation: ImageRotation) -> Dict[str, ModelledBody]:
        """Models by id, in the optical frame of the image as it came. seen: as they are in the turned image."""
        models = ((body.id, self._pipeline.model(body)) for body in seen)
        return {body_id: turned_model(model, rotation.back) for body_id, model in models if model is not None}

    def reconfigure(self, settings: BodiesSettings) -> None:
        """Take up the values of the live parameters; the bodies stay."""
        self._pipeline.reconfigure(settings)
        self._pacer.set_rate(settings.joint_state_rate)

    def reset(self) -> None:
        """Forget all bodies: time has jumped back, or the images have changed."""
        self._pipeline.reset()
        if self._publishers is not None:
            self._publishers.keep([])
        self._pacer.reset()
        self._appearance_pacer.reset()
        self._tracked.clear()
        self._topics.close()
        if self._faces is not None:
            self._faces.reset()

    def status(self) -> Status:
        """Return level, message and values for diagnostics."""
        values = self._pipeline.status()
        values["errors"] = self._guard.errors
        values.update(self._networks.values)
        level, text = OK, ""
        if self._publishers is not None:
            level, text, counts = self._publishers.status()
            values.update({"robot_state_publishers_" + name: value for name, value in counts.items()})
            text = "" if level == OK else text
        if self._no_frame:
            return WARN, _NO_FRAME, values
        error = self._guard.news()
        if error:
            return WARN, error, values
        if self._turned:
            return WARN, self._turned, values
        return level, text or "{} bodies".format(values["tracked"]), values

    def close(self) -> None:
        """Publish that nobody is tracked any more and take everything back. Idempotent."""
        if self._closed:
            return
        self._closed = True
        if self._faces is not None:
            self._faces.close()
        if self._matches is not None:
            self._matches.close()
        self._tracked.close()
        if self._publishers is not None:
            self._publishers.close()
        self._topics.close()
        self._transforms.close()
        self._pipeline.close()
        release(self._markers)
        release(self._pointing)

    def _tell_turned(self, frame: Frame, up: Optional[np.ndarray]) -> None:
        """Log once when images come turned. up: (3,) in the camera's frame by ~up_frame, None while it is not known."""
        transform = None if up is None else quarter_turns(frame.rotation.vectors(up))
        text = turned_problem(self._pipeline.seen_turn, transform, frame.rotation.degrees, frame.by_gravity)
        if text and not self._turned:
            rospy.logwarn("%s", text)
        self._turned = text

    def _face_boxes(self, frame: Frame, context: dict) -> Optional[List[FaceBox]]:
        """Faces of the turned image, None while nobody looks for them."""
        observed: Optional[Sequence[FaceObservation]] = context.get("faces")
        if observed is not None:
            faces = face_boxes((face.id, face.landmarks, face.pose) for face in observed)
        elif self._faces is None:
            return []       # who looks for them in this process has failed in this image
        elif self._faces.is_published:
            height, width = frame.bgr.shape[:2]
            faces = self._faces.boxes(frame.stamp, width, height, frame.header.frame_id)
        else:
            return None
        return [face.turned(frame.rotation) for face in faces]

    def _describe(self, model: ModelledBody) -> None:
        """Hand over the URDF of a body when it is new or has changed."""
        publishers = self._publishers
        if publishers is None or model.revision <= publishers.revision(model.id):
            return
        urdf = make_urdf(model.dimensions, model.id, self._pipeline.layout,
                         stature_sd=model.stature_sd if model.stature_known else None)
        if not publishers.set(model.id, urdf, model.revision):
            rospy.logwarn_throttle(_LOG_PERIOD_S, "more bodies than ~max_bodies: %s has no skeleton frames", model.id)

    def _publish_models(self, bodies: Sequence[BodyObservation], models: Mapping[str, ModelledBody],
                        frame: Frame) -> None:
        self._no_frame = not frame.header.frame_id
        if self._no_frame:
            rospy.logwarn_throttle(_LOG_PERIOD_S, _NO_FRAME)
            return
        if self._pacer.is_due(frame.stamp):
            self._publish_joints(list(models.values()), frame)
        self._guard.each("body", lambda body: self._publish_model(body, models.get(body.id), frame), bodies)

    def _publish_model(self, body: BodyObservation, model: Optional[ModelledBody], frame: Frame) -> None:
        if model is not None:
            self._topics.publish_place(body.id, model.pose.translation, body.velocity, frame)
        behaviour = self._pipeline.behaviour(body.id, frame.stamp)
        if behaviour is not None:
            self._topics.publish_behaviour(body.id, behaviour, frame)

    def _draw(self, bodies: Sequence[BodyObservation], frame: Frame, pointing: Mapping[str, Pointing]) -> None:
        labels = {body.id: self._pipeline.label(body.id) for body in bodies}
        up = frame.rotation.vectors_back(self._pipeline.up)
        self._markers.publish(self._shown.update(
            skeleton_markers(bodies, frame.header, labels, up, pointing), frame.header))

    def _publish_joints(self, models: Sequence[ModelledBody], frame: Frame) -> None:
        """Joint states and roots go out together, so that the frames of a stamp make whole skeletons."""
        names = self._pipeline.layout.joint_names
        self._transforms.send(self._guard.each("body", lambda model: body_transform(model, frame), models))
        self._guard.each("body", lambda model: self._topics.publish_joints(model, names, frame), models)


def _prepare() -> None:
    """Make ready what no body is to wait for: the colours of clothes, and the search for joints that few limbs need."""
    prepare_colours()
    importlib.import_module("hri_fullbody.core.kinematics.ikpy_backend")


class ReidentificationMatches:
    """Publishes candidate matches of re-identified bodies with the persons of their earlier bodies.

    Follows which person has which body; without a person manager nothing is published, nor of somebody who is not known
    any more: who was forgotten while out of sight would be known again.
    """

    def __init__(self, list_timeout: float) -> None:
        """list_timeout: see IdSubscribers."""
        self._lock = threading.Lock()
        self._person_of: "OrderedDict[str, str]" = OrderedDict()
        self._known: Optional[Set[str]] = None      # until a list has come
        self._publisher = rospy.Publisher(MATCHES_TOPIC, IdsMatch, queue_size=20)
        self._subscriber = rospy.Subscriber("/humans/persons/known", IdsList, self._on_known, queue_size=1)
        self._feed = IdSubscribers("persons", {"body_id": String}, self._on_body_id, max_ids=200,
                                   list_timeout=list_timeout)

    def publish(self, found: Iterable[Reidentification]) -> None:
        """Publish a match for each body whose earlier one had a person."""
        for item in found:
            with self._lock:
                person = self._person_of.get(item.earlier, "")
                known = self._known
            if person and (known is None or person in known):
                self._publisher.publish(match_to_msg(item.id, IdsMatch.BODY, person, IdsMatch.PERSON, item.likelihood))

    def close(self) -> None:
        """Release the topics. Idempotent."""
        self._feed.close()
        release(self._subscriber)
        release(self._publisher)

    def _on_known(self, message: IdsList) -> None:
        with self._lock:
            self._known = set(message.ids)

    def _on_body_id(self, person: str, name: str, message: String) -> None:
        if not is_valid_id(message.data):
            return      # the person has no body now; the match with the last one stays known
        with self._lock:
            self._person_of[message.data] = person
            self._person_of.move_to_end(message.data)
            while len(self._person_of) > _MOST_BODIES:
                self._person_of.popitem(last=False)


def body_transform(model: ModelledBody, frame: Frame) -> TransformStamped:
    """Transform of body_ID in the image's frame; all frames below it are those of the URDF."""
    return transform_to_msg(model.pose, frame.header.stamp, frame.header.frame_id, "body_" + model.id)


def drawn(body: BodyObservation, model: Optional[ModelledBody]) -> BodyObservation:
    """Return the body with the key points that are worth drawing: the filtered ones where there is a model."""
    if model is None or not body.measured or not np.any(np.isfinite(model.points)):
        return body
    return replace(body, keypoints_3d=model.points)


# A face this much older or newer than the image may be somewhere else by now.
MAX_AGE_S = 0.5
# The pose decides about the distance of a body, and heads nod: it must be nearly of the image's time.
_POSE_AGE_S = 0.2
_KEPT = 8
_Landmarks = Tuple[float, str, np.ndarray]
_PREFIX = b"face_"


class FaceInput:
    """Keeps the latest landmarks and poses of each face in /humans/faces/tracked.

    Callbacks only store; `boxes` reads. Of /tf only messages that mention a face are unpacked: a robot sends hundreds
    of others a second.
    """

    def __init__(self, list_timeout: float) -> None:
        """list_timeout: see IdSubscribers."""
        self._lock = threading.Lock()
        self._landmarks: Dict[str, Deque[_Landmarks]] = {}
        self._poses: Dict[str, Deque[RawTransform]] = {}
        self._ids: List[str] = []
        self._since: Optional[float] = -math.inf
        self._feed = IdSubscribers("faces", {"landmarks": LandmarkArray}, self._store, self._keep,
                                   list_timeout=list_timeout)
        self._transforms = rospy.Subscriber("/tf", rospy.AnyMsg, self._on_transforms, queue_size=100)
        self._closed = False

    def boxes(self, stamp: float, width: int, height: int, frame_id: str = "") -> List[FaceBox]:
        """Return the faces within half a second of `stamp` (s), in px of an image of width x height.

        Of each those of the image nearest to `stamp` are taken. Those that another camera than that of `frame_id` sees
        are left out. They have a pose when one in the frame `frame_id` is known within 0.2 s of `stamp`.
        """
        with self._lock:
            self._since = stamp if self._since is None else self._since
            known = {identity: near for identity in self._landmarks
                     for near in self._landmarks_near(identity, stamp, self._since)}
            poses = {identity: self._pose_near(identity, stamp, frame_id) for identity in known}
        camera = frame_id.lstrip("/")
        boxes = face_boxes(
            (identity, landmarks[:, :2] * np.array([width, height]), poses[identity])
            for identity, (seen, frame, landmarks) in known.items()
            if abs(seen - stamp) <= MAX_AGE_S and (not camera or frame in ("", camera)))
        return [replace(face, stamp=known[face.id][0]) for face in boxes]

    @property
    def is_published(self) -> bool:
        """Whether anybody looks for faces."""
        return self._feed.is_published

    def reset(self) -> None:
        """Forget all faces: those before the next image are of other images, or of another time."""
        with self._lock:
            self._landmarks.clear()
            self._poses.clear()
            self._since = None

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
            self._landmarks.setdefault(identity, deque(maxlen=_KEPT)).append(
                (message.header.stamp.to_sec(), message.header.frame_id.lstrip("/"), landmarks))

    def _keep(self, ids: List[str]) -> None:
        with self._lock:
            self._ids = list(ids)
            self._landmarks = {key: value for key, value in self._landmarks.items() if key in ids}
            self._poses = {key: value for key, value in self._poses.items() if key in ids}

    def _on_transforms(self, message: rospy.AnyMsg) -> None:
        """Take the poses of faces out of a serialised tf2_msgs/TFMessage."""
        data = message._buff
        if _PREFIX not in data:
            return
        try:
            frames = scan(data)
        except ValueError as error:     # one message never ends the node
            rospy.logwarn_throttle(10.0, "/tf: message not used: %s: %s", type(error).__name__, error)
            return
        for child, offset in frames:
            if child.lstrip(b"/").startswith(_PREFIX):
                self._store_pose(data, offset)

    def _store_pose(self, data: bytes, offset: int) -> None:
        """Keep the transform at an offset of a message; it is made a pose when an image asks for it."""
        try:
            transform = read(data, offset)
            identity = transform.child[len(_PREFIX):]
            if not transform.is_pose:
                raise ValueError("its numbers are no pose of {}".format(identity[:40]))
        except ValueError as error:
            rospy.logwarn_throttle(10.0, "/tf: pose of a face not used: %s", error)
            return
        with self._lock:
            if identity in self._ids:
                self._poses.setdefault(identity, deque(maxlen=_KEPT)).append(transform)

    def _landmarks_near(self, identity: str, stamp: float, since: float) -> List[_Landmarks]:
        """Landmarks of a face of the image nearest to `stamp`, of those from `since` (s) on; none or one."""
        fitting = [one for one in self._landmarks[identity] if one[0] >= since]
        return [min(fitting, key=lambda one: abs(one[0] - stamp))] if fitting else []

    def _pose_near(self, identity: str, stamp: float, frame_id: str) -> Optional[Pose]:
        """Pose of a face in `frame_id` nearest to `stamp`, None when there is none within 0.2 s."""
        fitting = [transform for transform in self._poses.get(identity, ())
                   if transform.parent == frame_id.lstrip("/") and abs(transform.stamp - stamp) <= _POSE_AGE_S]
        if not fitting:
            return None
        nearest = min(fitting, key=lambda transform: abs(transform.stamp - stamp))
        return Pose.from_quaternion(nearest.rotation, nearest.translation)
