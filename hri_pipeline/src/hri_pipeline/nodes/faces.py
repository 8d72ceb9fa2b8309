"""The ROS side of faces: what the node `faces` does with each image, its topics /humans/faces/ID/..., and its TF
frames."""

from __future__ import annotations

import time
from typing import Callable, Dict, Iterable, List, Optional, Sequence, Set, Tuple

import rospy
from geometry_msgs.msg import TransformStamped
from sensor_msgs.msg import Image
from std_msgs.msg import Header

from hri_msgs.msg import Expression, FacialActionUnits, FacialLandmarks, IdsMatch, SoftBiometrics
from hri_pipeline.core.error_log import ItemGuard
from hri_pipeline.core.faces.analysis import STAGES, FaceDemand
from hri_pipeline.core.faces.crops import MAX_SIZE, aligned_crop, box_crop
from hri_pipeline.core.faces.gaze import gaze_frame
from hri_pipeline.core.faces.parameters import FacePipelineSettings
from hri_pipeline.core.faces.pipeline import FacePipeline
from hri_pipeline.core.image_rotation import turned_problem
from hri_pipeline.core.observations import FaceObservation
from hri_pipeline.core.observations import SoftBiometrics as FaceBiometrics
from hri_pipeline.core.onnx import ModelLog
from hri_pipeline.core.parameters import ParameterError
from hri_pipeline.core.person_detector import PersonDetector
from hri_pipeline.core.privacy import DataUse, StoreError
from hri_pipeline.core.process import Threads
from hri_pipeline.core.recognition.face_identity import PersonMatch, SamePersons
from hri_pipeline.core.recognition.recogniser import SAME
from hri_pipeline.ros.conversions import (
    action_units_to_msg,
    bgr_to_image,
    expression_to_msg,
    landmarks_to_msg,
    match_to_msg,
    published_gaze,
    roi_message,
    roi_type,
    soft_biometrics_to_msg,
    transform_to_msg,
)
from hri_pipeline.ros.diagnostics import ERROR, OK, WARN, Status
from hri_pipeline.ros.gallery_service import GalleryService
from hri_pipeline.ros.image_input import Frame
from hri_pipeline.ros.publishers import MATCHES_TOPIC, IdPublishers, TopicSpec, TrackedList
from hri_pipeline.ros.rospy_compat import release
from hri_pipeline.ros.tf import TfPublisher

_NO_FRAME = "images have no frame_id, so faces have no TF frame; set the camera driver's frame_id"
_LOG_PERIOD_S = 10.0
NAMESPACE = "/humans/faces"
_ANALYSIS = {"facs": ("action_units", FacialActionUnits), "expression": ("expression", Expression),
             "softbiometrics": ("age_gender", SoftBiometrics)}
"""Topic: the parameter that switches it on, and its type."""
CROPPED, ALIGNED = "cropped", "aligned"
SIZE_PARAMETERS = ("/humans/faces/width", "/humans/faces/height")
DEFAULT_SIZE = 128
MARGIN = 1.3
_REFRESH_S = 5.0
_BIOMETRICS_S = 1.0
"""Time (s) after which apparent age and gender are published again: the network looks once in 20 s at last."""
_SIZE_WARNING_PERIOD_S = 30.0


class FaceProcessor:
    """Runs the face pipeline on each image and publishes its results. An error with one face does not affect the
    others.

    Parameters
    ----------
    settings
        The values of core.faces.parameters.FACES.
    threads
        Of the networks; by default as the settings say.
    person_detector
        See FacePipeline.

    Raises
    ------
    ModelError
        When a model is missing or damaged.
    ParameterError
        When the gallery cannot be used.
    """

    name = "faces"

    def __init__(self, settings: FacePipelineSettings, threads: Optional[Threads] = None,
                 person_detector: Optional[Callable[[], PersonDetector]] = None) -> None:
        is_kept = settings.recognition and settings.gallery
        (rospy.logwarn if is_kept else rospy.loginfo)("%s", privacy_line(settings))
        self.data_use = data_use(settings)
        self._networks = ModelLog(rospy.logwarn)
        try:
            self._pipeline = FacePipeline(settings, notify=self._networks, threads=threads,
                                          person_detector=person_detector)
        except StoreError as error:
            raise ParameterError("~gallery, ~gallery_key: {}".format(error)) from error
        self._interface = settings.interface
        self._guard = ItemGuard(rospy.logerr)
        self._topics = FaceTopics(settings)
        self._tracked = TrackedList(NAMESPACE + "/tracked")
        self._transforms = TfPublisher()
        recognition = self._pipeline.recognition
        self._gallery = (
            GalleryService(recognition.recogniser, recognition.flush) if recognition is not None else None)
        self._match_subscribers = 0
        self._no_frame = False
        self._poseless = 0
        self._quarters = 0
        self._turned = ""
        self._closed = False

    def process(self, frame: Frame, context: dict) -> None:
        """Find the faces in an image, publish them, and store them in context["faces"]."""
        demand = self._topics.demand(self._pipeline.tracked_ids)
        if "age" in context:
            self._pipeline.note_timing(context["age"], context["took"])
        rotation, upright = frame.rotation, frame.upright
        if rotation.quarters != self._quarters:
            self._pipeline.turn(rotation.since(self._quarters))
            self._quarters = rotation.quarters
        # Where somebody is does not wait for the search of others, nor for the analysis.
        seen = self._pipeline.update(
            upright.bgr, upright.camera, frame.stamp, upright.depth, demand,
            lambda placed: self._publish_places([rotation.face_back(face) for face in placed], frame))
        faces = context["faces"] = [rotation.face_back(face) for face in seen]
        self._poseless = sum(face.pose is None for face in faces)
        if frame.overtaken():
            return
        self._guard.each("face", lambda face: self._topics.publish(face, frame), faces)
        self._publish_matches()
        self._tell_turned(frame)

    def reconfigure(self, settings: FacePipelineSettings) -> None:
        """Apply the values of the live parameters; the faces stay."""
        self._pipeline.reconfigure(settings)

    def reset(self) -> None:
        """Drop all faces: time has jumped back, or the images have changed."""
        self._pipeline.reset()
        self._tracked.clear()
        self._topics.close_ids()

    def status(self) -> Status:
        """Return level, message and values for diagnostics."""
        values: Dict[str, object] = {"without_pose": self._poseless, "errors": self._guard.errors}
        values.update(self._networks.values)
        values.update(self._pipeline.status())
        if self._gallery is not None and self._gallery.problem:
            return ERROR, self._gallery.problem, values
        if self._no_frame:
            return WARN, _NO_FRAME, values
        error = self._guard.news()
        if error or self._turned:
            return WARN, error or self._turned, values
        return OK, "{} faces".format(values["tracked"]), values

    def close(self) -> None:
        """Publish that no face is tracked any more and unadvertise all topics. Idempotent."""
        if self._closed:
            return
        self._closed = True
        if self._gallery is not None:
            self._gallery.close()
        self._tracked.close()
        self._topics.close()
        self._transforms.close()
        self._pipeline.close()

    def _publish_places(self, faces: Sequence[FaceObservation], frame: Frame) -> None:
        """Publish who is tracked, and the frames."""
        if frame.overtaken():
            return
        ids = self._pipeline.tracked_ids
        self._guard.attempt("topic", self._topics.keep, ids)
        self._tracked.set(ids, frame.header.stamp)
        posed = [face for face in faces if face.pose is not None]
        self._no_frame = not frame.header.frame_id
        if self._no_frame:
            rospy.logwarn_throttle(_LOG_PERIOD_S, _NO_FRAME)
            return
        transforms: List[TransformStamped] = []
        self._guard.each(
            "face", lambda face: transforms.extend(face_transforms(face, frame, self._interface)), posed)
        self._transforms.send(transforms)

    def _tell_turned(self, frame: Frame) -> None:
        """Log once when the images come turned."""
        text = turned_problem(self._pipeline.seen_turn, None, frame.rotation.degrees, frame.by_gravity)
        if text and not self._turned:
            rospy.logwarn("%s", text)
        self._turned = text

    def _publish_matches(self) -> None:
        """Publish the changes of the matches, and all matches when there is a new subscriber."""
        if self._pipeline.recognition is None:
            return
        recogniser, subscribers = self._pipeline.recognition.recogniser, self._topics.match_subscribers()
        if subscribers > self._match_subscribers:
            self._topics.publish_matches(recogniser.current())
            self._topics.publish_same_persons([SamePersons(*pair, SAME) for pair in recogniser.same_persons()])
        self._match_subscribers = subscribers
        self._topics.publish_matches(self._pipeline.matches)
        self._topics.publish_same_persons(recogniser.same_changes())


def face_transforms(face: FaceObservation, frame: Frame, interface: str) -> List[TransformStamped]:
    """Transforms of face_ID in the image's frame, and of gaze_ID in face_ID; interface: see `published_gaze`."""
    if face.pose is None:
        return []
    stamp, name = frame.header.stamp, "face_" + face.id
    transforms = [transform_to_msg(face.pose, stamp, frame.header.frame_id, name)]
    direction = published_gaze(face.pose, None if face.gaze is None else face.gaze.direction, interface)
    if direction is not None:
        transforms.append(transform_to_msg(gaze_frame(face.pose, direction), stamp, name, "gaze_" + face.id))
    return transforms


def data_use(settings: FacePipelineSettings) -> DataUse:
    """Return what is computed of faces and kept of people."""
    computes = ("boxes", "landmarks", "positions", "gazes", *(name for name in STAGES if getattr(settings, name)))
    if not (settings.recognition and settings.gallery):
        return DataUse(computes)
    return DataUse(computes, settings.gallery, ("ids", "consent", "times", "templates of faces"),
                   encrypted=bool(settings.gallery_key))


def privacy_line(settings: FacePipelineSettings) -> str:
    """One line of text for the log: what is inferred about people and where templates are kept."""
    on = [name for name in STAGES if getattr(settings, name)]
    off = [name for name in STAGES if name not in on]
    line = "inferred about people: {}; switched off: {}".format(", ".join(on) or "nothing", ", ".join(off) or "nothing")
    if settings.recognition:
        line += "; templates of faces are kept {}".format(
            "across runs in {}{}".format(settings.gallery, ", encrypted" if settings.gallery_key else "")
            if settings.gallery else "in memory only")
    return line


class FaceTopics:
    """Publishes observations of faces; the topic of an analysis that is switched off does not exist."""

    def __init__(self, settings: FacePipelineSettings) -> None:
        """settings: the values of core.faces.parameters.FACES."""
        self._interface = settings.interface
        specs = {"roi": TopicSpec(roi_type(settings.interface)), "landmarks": TopicSpec(FacialLandmarks),
                 CROPPED: TopicSpec(Image), ALIGNED: TopicSpec(Image)}
        self._analysis = [name for name, (switch, _) in _ANALYSIS.items() if getattr(settings, switch)]
        specs.update({name: TopicSpec(_ANALYSIS[name][1]) for name in self._analysis})
        self._publishers = IdPublishers(NAMESPACE, specs)
        self._pictures = FacePictures(self._publishers)
        self._told: Dict[str, Tuple[FaceBiometrics, float]] = {}
        self._matches = rospy.Publisher(MATCHES_TOPIC, IdsMatch, queue_size=100) if settings.recognition else None

    def keep(self, ids: Iterable[str]) -> None:
        """Advertise the topics of these faces and unadvertise those of all others."""
        kept = list(ids)
        self._told = {face_id: told for face_id, told in self._told.items() if face_id in kept}
        self._publishers.keep(kept)

    def demand(self, ids: Sequence[str]) -> FaceDemand:
        """Return which results of these faces have subscribers."""
        wanted = {name: self._subscribed(name, ids) for name in _ANALYSIS}
        matched = self._matches is not None and self._matches.get_num_connections() > 0
        return FaceDemand(wanted["facs"], wanted["expression"], wanted["softbiometrics"], matched)

    def publish(self, face: FaceObservation, frame: Frame) -> None:
        """Publish the results of one face that have subscribers."""
        height, width = frame.bgr.shape[:2]
        header, publishers = frame.header, self._publishers
        if publishers.has_subscribers(face.id, "roi"):
            publishers.publish(face.id, "roi",
                               roi_message(face.box, width, height, self._interface, header, face.score))
        if publishers.has_subscribers(face.id, "landmarks"):
            publishers.publish(face.id, "landmarks", landmarks_to_msg(face.landmarks, header, width, height))
        if face.measured:
            self._pictures.publish(face, frame)
        if face.action_units is not None:
            publishers.publish(face.id, "facs", action_units_to_msg(
                face.action_units.intensity, face.action_units.confidence, header))
        if face.expression is not None:
            expression = face.expression
            publishers.publish(face.id, "expression", expression_to_msg(
                expression.category, expression.valence, expression.arousal, expression.confidence, header))
        self._publish_biometrics(face, frame)

    def _publish_biometrics(self, face: FaceObservation, frame: Frame) -> None:
        """Publish apparent age and gender of one face where they have changed, and again after a while."""
        estimate, (told, told_at) = face.soft_biometrics, self._told.get(face.id, (None, float("-inf")))
        if estimate is None or (estimate == told and 0.0 <= frame.stamp - told_at < _BIOMETRICS_S):
            return
        self._told[face.id] = estimate, frame.stamp
        self._publishers.publish(face.id, "softbiometrics", soft_biometrics_to_msg(estimate, frame.header))

    def publish_matches(self, matches: Sequence[PersonMatch]) -> None:
        """Publish matches of faces with persons; likelihood 0 withdraws one."""
        if self._matches is None:
            return
        for match in matches:
            self._matches.publish(match_to_msg(match.face_id, IdsMatch.FACE, match.person_id, IdsMatch.PERSON,
                                               match.likelihood))

    def publish_same_persons(self, pairs: Sequence[SamePersons]) -> None:
        """Publish pairs of persons that are one human; likelihood 0 withdraws one."""
        if self._matches is None:
            return
        for pair in pairs:
            self._matches.publish(match_to_msg(pair.other, IdsMatch.PERSON, pair.kept, IdsMatch.PERSON,
                                               pair.likelihood))

    def match_subscribers(self) -> int:
        """Return the number of subscribers to the matches."""
        return self._matches.get_num_connections() if self._matches is not None else 0

    def close_ids(self) -> None:
        """Unadvertise the topics of all faces."""
        self._told.clear()
        self._publishers.close_all()

    def close(self) -> None:
        """Unadvertise all topics. Idempotent."""
        self._publishers.close_all()
        if self._matches is not None:
            release(self._matches)
            self._matches = None

    def _subscribed(self, name: str, ids: Sequence[str]) -> Set[str]:
        if name not in self._analysis:
            return set()
        return {face_id for face_id in ids if self._publishers.has_subscribers(face_id, name)}


class FacePictures:
    """Publishes the topics `cropped` and `aligned` of a face while they have subscribers.

    Their size is on the parameter server (/humans/faces/width and /humans/faces/height), read again every few seconds
    while there are subscribers; an illegal value is logged and replaced by 128.
    """

    def __init__(self, publishers: IdPublishers) -> None:
        self._publishers = publishers
        self._size = (DEFAULT_SIZE, DEFAULT_SIZE)
        self._read_at = float("-inf")

    def publish(self, face: FaceObservation, frame: Frame) -> None:
        """Publish the pictures of one face that have subscribers."""
        wanted = [name for name in (CROPPED, ALIGNED) if self._publishers.has_subscribers(face.id, name)]
        if not wanted:
            return
        width, height = self._current_size()
        camera = frame.camera.resized(frame.bgr.shape[1], frame.bgr.shape[0])
        for name in wanted:
            if name == CROPPED:
                picture = box_crop(frame.upright.bgr, frame.rotation.box(face.box), width, height, MARGIN)
            else:
                side = max(width, height)
                square = aligned_crop(frame.bgr, face.mesh, side, MARGIN, camera)
                top, left = (side - height) // 2, (side - width) // 2
                picture = square[top:top + height, left:left + width]
            header = Header(stamp=frame.header.stamp, frame_id=frame.header.frame_id)
            self._publishers.publish(face.id, name, bgr_to_image(picture, header))

    def _current_size(self) -> Tuple[int, int]:
        if time.monotonic() - self._read_at > _REFRESH_S:
            self._read_at = time.monotonic()
            self._size = (self._read(SIZE_PARAMETERS[0]), self._read(SIZE_PARAMETERS[1]))
        return self._size

    @staticmethod
    def _read(name: str) -> int:
        try:
            value = rospy.get_param(name, DEFAULT_SIZE)
        except Exception as error:  # the master may be away: rospy raises socket errors then
            rospy.logwarn_throttle(_SIZE_WARNING_PERIOD_S, "parameter %s could not be read (%s)", name, error)
            return DEFAULT_SIZE
        # type() and not isinstance(): a bool is an int in Python.
        if type(value) is not int or not 16 <= value <= MAX_SIZE:
            rospy.logwarn_throttle(_SIZE_WARNING_PERIOD_S, "parameter %s is %r; legal: int, 16 to %d; %d is used "
                                                           "instead",
                                   name, value, MAX_SIZE, DEFAULT_SIZE)
            return DEFAULT_SIZE
        return value
