"""The face stage as a branch of the vision loop: topics and frames of all faces."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Dict, List, Optional, Sequence, Tuple

import rospy
from geometry_msgs.msg import TransformStamped

from hri_pipeline.core.faces.face_analysis import STAGES
from hri_pipeline.core.faces.face_stage import FaceStage
from hri_pipeline.core.faces.gaze import gaze_frame
from hri_pipeline.core.observations import FaceObservation
from hri_pipeline.core.parameters import ParameterError
from hri_pipeline.core.private_file import StoreError
from hri_pipeline.core.recognition.face_identity import SamePersons
from hri_pipeline.core.recognition.recogniser import SAME
from hri_pipeline.ros.conversions import transform_to_msg
from hri_pipeline.ros.diagnostics import ERROR, OK, WARN
from hri_pipeline.ros.faces.face_topics import NAMESPACE, FaceTopics
from hri_pipeline.ros.faces.gallery_service import GalleryService
from hri_pipeline.ros.image_intake import Frame
from hri_pipeline.ros.tf_publisher import TfPublisher
from hri_pipeline.ros.tracked_list import TrackedList

_NO_FRAME = "images have no frame_id, so faces have no TF frame; set the camera driver's frame_id"
_LOG_PERIOD_S = 10.0


class FaceBranch:
    """Publishes what FaceStage sees.

    settings: the values of face_parameters.FACES. transforms: a publisher shared with other branches; its owner
    closes it. Raises ModelError when a model is missing or damaged.
    """

    name = "faces"

    def __init__(self, settings: SimpleNamespace, transforms: Optional[TfPublisher] = None) -> None:
        is_kept = settings.recognition and settings.gallery
        (rospy.logwarn if is_kept else rospy.loginfo)("%s", privacy_line(settings))
        try:
            self._stage = FaceStage(settings, notify=rospy.logwarn)
        except StoreError as error:
            raise ParameterError("~gallery, ~gallery_key: {}".format(error)) from error
        self._topics = FaceTopics(settings)
        self._tracked = TrackedList(NAMESPACE + "/tracked")
        self._owns_transforms = transforms is None
        self._transforms = TfPublisher() if transforms is None else transforms
        recognition = self._stage.recognition
        self._gallery = GalleryService(recognition) if recognition is not None else None
        self._listeners = 0
        self._no_frame = False
        self._poseless = 0
        self._closed = False

    def process(self, frame: Frame, context: dict) -> None:
        """Find the faces in a frame, publish them, and leave them in context["faces"]."""
        demand = self._topics.demand(self._stage.tracked_ids)
        faces = self._stage.update(frame.bgr, frame.camera, frame.stamp, getattr(frame, "depth", None), demand)
        context["faces"] = faces
        ids = self._stage.tracked_ids
        self._topics.keep(ids)
        self._tracked.set(ids, frame.header.stamp)
        for face in faces:
            self._topics.publish(face, frame)
        self._publish_frames(faces, frame)
        self._publish_matches()

    def reconfigure(self, settings: SimpleNamespace) -> None:
        """Take up the values of the live parameters; the faces stay."""
        self._stage.reconfigure(settings)

    def reset(self) -> None:
        """Forget all faces: time has jumped back."""
        self._stage.reset()
        self._tracked.set([], rospy.Time.now())
        self._topics.close_ids()

    def status(self) -> Tuple[int, str, Dict[str, object]]:
        """Return level, message and values for diagnostics."""
        values: Dict[str, object] = {"without_pose": self._poseless}
        values.update(self._stage.status())
        if self._gallery is not None and self._gallery.problem:
            return ERROR, self._gallery.problem, values
        if self._no_frame:
            return WARN, _NO_FRAME, values
        return OK, "{} faces".format(values["tracked"]), values

    def close(self) -> None:
        """Publish that no face is tracked any more and take all topics back. Idempotent."""
        if self._closed:
            return
        self._closed = True
        if self._gallery is not None:
            self._gallery.close()
        self._tracked.close()
        self._topics.close()
        if self._owns_transforms:
            self._transforms.close()
        self._stage.close()

    def _publish_frames(self, faces: Sequence[FaceObservation], frame: Frame) -> None:
        posed = [face for face in faces if face.pose is not None]
        self._poseless = len(faces) - len(posed)
        self._no_frame = not frame.header.frame_id
        if self._no_frame:
            rospy.logwarn_throttle(_LOG_PERIOD_S, _NO_FRAME)
            return
        transforms: List[TransformStamped] = []
        for face in posed:
            transforms += face_transforms(face, frame)
        self._transforms.send(transforms)

    def _publish_matches(self) -> None:
        """Say what has changed, and everything to a listener that has just come."""
        if self._stage.recognition is None:
            return
        recogniser, listeners = self._stage.recognition.recogniser, self._topics.matches_listeners()
        if listeners > self._listeners:
            self._topics.publish_matches(recogniser.current())
            self._topics.publish_same_persons([SamePersons(*pair, SAME) for pair in recogniser.same_persons()])
        self._listeners = listeners
        self._topics.publish_matches(self._stage.matches)
        self._topics.publish_same_persons(recogniser.same_changes())


def face_transforms(face: FaceObservation, frame: Frame) -> List[TransformStamped]:
    """Transforms of face_ID in the image's frame, and of gaze_ID in face_ID while the gaze is known."""
    if face.pose is None:
        return []
    stamp, name = frame.header.stamp, "face_" + face.id
    transforms = [transform_to_msg(face.pose, stamp, frame.header.frame_id, name)]
    if face.gaze is not None and face.gaze.direction is not None:
        transforms.append(transform_to_msg(gaze_frame(face.pose, face.gaze.direction), stamp, name, "gaze_" + face.id))
    return transforms


def privacy_line(settings: SimpleNamespace) -> str:
    """Say in one line what is inferred about people and where templates go."""
    on = [name for name in STAGES if getattr(settings, name)]
    off = [name for name in STAGES if name not in on]
    line = "inferred about people: {}; switched off: {}".format(", ".join(on) or "nothing", ", ".join(off) or "nothing")
    if settings.recognition:
        line += "; templates of faces are kept {}".format(
            "across runs in {}{}".format(settings.gallery, ", encrypted" if settings.gallery_key else "")
            if settings.gallery else "in memory only")
    return line
