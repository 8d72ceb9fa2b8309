"""The body stage as a branch of the vision loop: topics, models and frames of all bodies."""

from __future__ import annotations

import importlib
import threading
from dataclasses import replace
from types import SimpleNamespace
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np
import rospy
from geometry_msgs.msg import TransformStamped
from visualization_msgs.msg import MarkerArray

from hri_fullbody.core.body_modeller import ModelledBody
from hri_fullbody.core.body_stage import BodyStage
from hri_fullbody.core.sight.body_windows import FaceBox
from hri_fullbody.core.stamp_pacer import StampPacer
from hri_fullbody.ros.body_models import BodyModels
from hri_fullbody.ros.body_persons import BodyPersons
from hri_fullbody.ros.body_topics import NAMESPACE, BodyTopics
from hri_fullbody.ros.face_feed import FaceFeed
from hri_fullbody.ros.skeleton_markers import SkeletonMarkers
from hri_fullbody.ros.up_frame import UpFrame
from hri_pipeline.core.observations import BodyObservation, FaceObservation
from hri_pipeline.ros.conversions import transform_to_msg
from hri_pipeline.ros.diagnostics import OK, WARN
from hri_pipeline.ros.image_intake import Frame
from hri_pipeline.ros.tf_publisher import TfPublisher
from hri_pipeline.ros.topic_release import release
from hri_pipeline.ros.tracked_list import TrackedList

_LOG_PERIOD_S = 10.0
_NO_FRAME = "images have no frame_id, so bodies have no TF frame; set the camera driver's frame_id"


class BodyBranch:
    """Publishes what BodyStage sees and BodyModels makes of it.

    settings: the values of body_parameters.BODIES. listen_for_faces: follow the faces of another process; with
    False only those that a branch before this one has put into context["faces"] are used.
    Raises ModelError when a network is missing or damaged, ParameterError for a segments file that cannot be used.
    """

    name = "bodies"

    def __init__(self, settings: SimpleNamespace, listen_for_faces: bool = True) -> None:
        self._stage = BodyStage(settings, notify=rospy.logwarn)
        self._models = BodyModels(settings)
        self._pacer = StampPacer(settings.joint_state_rate)
        self._topics = BodyTopics(settings.interface)
        self._tracked = TrackedList(NAMESPACE + "/tracked")
        self._transforms = TfPublisher()
        self._markers = rospy.Publisher("visualization/skeletons", MarkerArray, queue_size=1)
        self._drawing = SkeletonMarkers()
        self._up = UpFrame(settings.up_frame)
        self._persons = BodyPersons() if settings.body_memory > 0.0 else None
        self._faces = FaceFeed() if listen_for_faces else None
        self._no_frame = False
        self._closed = False
        # Few limbs need it, and no body has to wait for it.
        threading.Thread(target=importlib.import_module, args=("hri_fullbody.core.joints.ikpy_solver",), name="ikpy", daemon=True).start()

    def process(self, frame: Frame, context: dict) -> None:
        """Find the bodies in a frame, publish them, and leave them in context["bodies"]."""
        up, height = self._up.look(frame.header.frame_id, frame.header.stamp)
        bodies = self._stage.update(
            frame.bgr, frame.camera, frame.stamp, self._face_boxes(frame, context), depth=frame.depth,
            up=None if height is None else up, camera_height=height)
        context["bodies"] = bodies
        ids = self._stage.tracked_ids
        self._topics.keep(ids)
        self._tracked.set(ids, frame.header.stamp)
        for body in bodies:
            self._topics.publish_seen(body, frame)
        if self._persons is not None:
            self._persons.tell(self._stage.returned)
        self._models.keep(ids)
        self._models.update(bodies, frame.stamp, up, (frame.bgr.shape[1], frame.bgr.shape[0]))
        self._publish_models(bodies, frame)
        if self._markers.get_num_connections() and not self._no_frame:
            self._draw(bodies, frame, up)

    def reconfigure(self, settings: SimpleNamespace) -> None:
        """Take up the values of the live parameters; the bodies stay."""
        self._stage.reconfigure(settings)
        self._models.reconfigure(settings)
        self._pacer.set_rate(settings.joint_state_rate)

    def reset(self) -> None:
        """Forget all bodies: time has jumped back."""
        self._stage.reset()
        self._models.reset()
        self._pacer.reset()
        self._tracked.set([], rospy.Time.now())
        self._topics.close()

    def status(self) -> Tuple[int, str, Dict[str, object]]:
        """Return level, message and values for diagnostics."""
        values: Dict[str, object] = {"tracked": len(self._stage.tracked_ids),
                                     "placed_by_depth": self._stage.placed_by_depth}
        values.update(self._stage.times.values())
        level, text, more = self._models.status()
        values.update(more)
        if self._no_frame:
            return WARN, _NO_FRAME, values
        if level == OK:
            level, text = self._up.status()
        return level, text or "{} bodies".format(values["tracked"]), values

    def close(self) -> None:
        """Publish that nobody is tracked any more and take everything back. Idempotent."""
        if self._closed:
            return
        self._closed = True
        if self._faces is not None:
            self._faces.close()
        self._up.close()
        if self._persons is not None:
            self._persons.close()
        self._tracked.close()
        self._models.close()
        self._topics.close()
        self._transforms.close()
        release(self._markers)

    def _face_boxes(self, frame: Frame, context: dict) -> List[FaceBox]:
        observed: Optional[Sequence[FaceObservation]] = context.get("faces")
        if observed is not None:
            return [FaceBox.from_landmarks(face.id, face.landmarks, face.pose) for face in observed]
        if self._faces is None:
            return []
        height, width = frame.bgr.shape[:2]
        return self._faces.boxes(frame.stamp, width, height, frame.header.frame_id)

    def _publish_models(self, bodies: Sequence[BodyObservation], frame: Frame) -> None:
        self._no_frame = not frame.header.frame_id
        if self._no_frame:
            rospy.logwarn_throttle(_LOG_PERIOD_S, _NO_FRAME)
            return
        posed = [(body, self._models.get(body)) for body in bodies]
        if self._pacer.is_due(frame.stamp):
            self._publish_joints([model for _, model in posed if model is not None], frame)
        for body, model in posed:
            if model is not None:
                self._topics.publish_place(body.id, model.pose.translation, body.velocity, frame)
            expression = self._models.expression(body.id)
            if expression is not None:
                self._topics.publish_expression(body.id, expression, frame)

    def _draw(self, bodies: Sequence[BodyObservation], frame: Frame, up: np.ndarray) -> None:
        labels = {body.id: self._models.label(body.id) for body in bodies}
        self._markers.publish(self._drawing.update(
            [drawn(body, self._models.get(body)) for body in bodies], frame.header, labels, up))

    def _publish_joints(self, models: Sequence[ModelledBody], frame: Frame) -> None:
        """Joint states and roots go out together, so that the frames of a stamp make whole skeletons."""
        self._transforms.send([body_transform(model, frame) for model in models])
        for model in models:
            self._topics.publish_joints(model, self._models.joint_names, frame)


def body_transform(model: ModelledBody, frame: Frame) -> TransformStamped:
    """Transform of body_ID in the image's frame; all frames below it are those of the URDF."""
    return transform_to_msg(model.pose, frame.header.stamp, frame.header.frame_id, "body_" + model.id)


def drawn(body: BodyObservation, model: Optional[ModelledBody]) -> BodyObservation:
    """Return the body with the key points that are worth drawing: the filtered ones where there is a model."""
    if model is None or not body.measured or not np.any(np.isfinite(model.points)):
        return body
    return replace(body, keypoints_3d=model.points)
