"""The face stage as a branch of the vision loop: topics and frames of all faces."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Dict, Optional, Sequence, Tuple

import rospy

from hri_msgs.msg import FacialLandmarks
from hri_pipeline.core.face_stage import FaceStage
from hri_pipeline.core.observations import FaceObservation
from hri_pipeline.ros.conversions import landmarks_to_msg, transform_to_msg
from hri_pipeline.ros.diagnostics import OK, WARN
from hri_pipeline.ros.image_intake import Frame
from hri_pipeline.ros.interface import roi_message, roi_type
from hri_pipeline.ros.tf_publisher import TfPublisher
from hri_pipeline.ros.topic_lease import TopicLeases, TopicSpec
from hri_pipeline.ros.tracked_list import TrackedList

NAMESPACE = "/humans/faces"
_NO_FRAME = "images have no frame_id, so faces have no TF frame; set the camera driver's frame_id"
_LOG_PERIOD_S = 10.0


class FaceBranch:
    """Publishes what FaceStage sees.

    settings: the values of face_parameters.FACES. transforms: a publisher shared with other branches; its owner
    closes it. Raises ModelError when a model is missing or damaged.
    """

    name = "faces"

    def __init__(self, settings: SimpleNamespace, transforms: Optional[TfPublisher] = None) -> None:
        self._stage = FaceStage(settings, notify=rospy.logwarn)
        self._interface = settings.interface
        self._leases = TopicLeases(NAMESPACE, {
            "roi": TopicSpec(roi_type(settings.interface)), "landmarks": TopicSpec(FacialLandmarks)})
        self._tracked = TrackedList(NAMESPACE + "/tracked")
        self._owns_transforms = transforms is None
        self._transforms = TfPublisher() if transforms is None else transforms
        self._no_frame = False
        self._poseless = 0
        self._closed = False

    def process(self, frame: Frame, context: dict) -> None:
        """Find the faces in a frame, publish them, and leave them in context["faces"]."""
        faces = self._stage.update(frame.bgr, frame.camera, frame.stamp)
        context["faces"] = faces
        ids = self._stage.tracked_ids
        self._leases.keep(ids)
        self._tracked.set(ids, frame.header.stamp)
        for face in faces:
            self._publish(face, frame)
        self._publish_poses(faces, frame)

    def reset(self) -> None:
        """Forget all faces: time has jumped back."""
        self._stage.reset()
        self._tracked.set([], rospy.Time.now())
        self._leases.close_all()

    def status(self) -> Tuple[int, str, Dict[str, object]]:
        """Return level, message and values for diagnostics."""
        values: Dict[str, object] = {"tracked": len(self._stage.tracked_ids), "without_pose": self._poseless}
        values.update(self._stage.times.values())
        if self._no_frame:
            return WARN, _NO_FRAME, values
        return OK, "{} faces".format(values["tracked"]), values

    def close(self) -> None:
        """Publish that no face is tracked any more and take all topics back. Idempotent."""
        if self._closed:
            return
        self._closed = True
        self._tracked.close()
        self._leases.close_all()
        if self._owns_transforms:
            self._transforms.close()

    def _publish(self, face: FaceObservation, frame: Frame) -> None:
        height, width = frame.bgr.shape[:2]
        self._leases.publish(face.id, "roi", roi_message(
            face.box, width, height, self._interface, frame.header, face.score))
        if self._leases.has_subscribers(face.id, "landmarks"):
            self._leases.publish(face.id, "landmarks", landmarks_to_msg(
                face.landmarks, frame.header, width, height))

    def _publish_poses(self, faces: Sequence[FaceObservation], frame: Frame) -> None:
        posed = [face for face in faces if face.pose is not None]
        self._poseless = len(faces) - len(posed)
        self._no_frame = not frame.header.frame_id
        if self._no_frame:
            rospy.logwarn_throttle(_LOG_PERIOD_S, _NO_FRAME)
            return
        self._transforms.send([transform_to_msg(
            face.pose, frame.header.stamp, frame.header.frame_id, "face_" + face.id) for face in posed])
