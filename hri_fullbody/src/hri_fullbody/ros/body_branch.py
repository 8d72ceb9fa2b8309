"""The body stage as a branch of the vision loop: topics and frames of all bodies."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Dict, List, Optional, Sequence, Tuple

import rospy
from geometry_msgs.msg import TransformStamped
from visualization_msgs.msg import MarkerArray

from hri_fullbody.core.body_placement import head_pose
from hri_fullbody.core.body_stage import BodyStage
from hri_fullbody.core.body_windows import FaceBox
from hri_fullbody.ros.face_feed import FaceFeed
from hri_fullbody.ros.skeleton_markers import skeleton_markers
from hri_msgs.msg import Skeleton2D
from hri_pipeline.core.observations import BodyObservation, FaceObservation
from hri_pipeline.ros.conversions import skeleton_to_msg, transform_to_msg
from hri_pipeline.ros.diagnostics import OK, WARN
from hri_pipeline.ros.image_intake import Frame
from hri_pipeline.ros.interface import roi_message, roi_type
from hri_pipeline.ros.tf_publisher import TfPublisher
from hri_pipeline.ros.topic_lease import TopicLeases, TopicSpec
from hri_pipeline.ros.topic_release import release
from hri_pipeline.ros.tracked_list import TrackedList

_LOG_PERIOD_S = 10.0


class BodyBranch:
    """Publishes what BodyStage sees.

    settings: the values of body_parameters.BODIES. listen_for_faces: follow the faces of another process; with
    False only those that a branch before this one has put into context["faces"] are used.
    Raises ModelError when a model is missing or damaged.
    """

    name = "bodies"

    def __init__(self, settings: SimpleNamespace, listen_for_faces: bool = True) -> None:
        self._stage = BodyStage(settings, notify=rospy.logwarn)
        self._interface = settings.interface
        self._leases = TopicLeases("/humans/bodies", {
            "roi": TopicSpec(roi_type(settings.interface)), "skeleton2d": TopicSpec(Skeleton2D)})
        self._tracked = TrackedList("/humans/bodies/tracked")
        self._transforms = TfPublisher()
        self._markers = rospy.Publisher("visualization/skeletons", MarkerArray, queue_size=1)
        self._faces = FaceFeed() if listen_for_faces else None
        self._no_frame = False
        self._closed = False

    def process(self, frame: Frame, context: dict) -> None:
        """Find the bodies in a frame, publish them, and leave them in context["bodies"]."""
        height, width = frame.bgr.shape[:2]
        bodies = self._stage.update(frame.bgr, frame.camera, frame.stamp, self._face_boxes(frame, context))
        context["bodies"] = bodies
        ids = self._stage.tracked_ids
        self._leases.keep(ids)
        self._tracked.set(ids, frame.header.stamp)
        for body in bodies:
            self._leases.publish(body.id, "roi", roi_message(
                body.box, width, height, self._interface, frame.header, body.score))
            if self._leases.has_subscribers(body.id, "skeleton2d"):
                self._leases.publish(body.id, "skeleton2d", skeleton_to_msg(
                    body.keypoints, frame.header, width, height))
        self._publish_in_space(bodies, frame)

    def reset(self) -> None:
        """Forget all bodies: time has jumped back."""
        self._stage.reset()
        self._tracked.set([], rospy.Time.now())
        self._leases.close_all()

    def status(self) -> Tuple[int, str, Dict[str, object]]:
        """Return level, message and values for diagnostics."""
        values: Dict[str, object] = {"tracked": len(self._stage.tracked_ids)}
        values.update(self._stage.times.values())
        if self._no_frame:
            return WARN, "images have no frame_id, so bodies have no TF frame; set the camera driver's frame_id", values
        return OK, "{} bodies".format(values["tracked"]), values

    def close(self) -> None:
        """Publish that nobody is tracked any more and take all topics back. Idempotent."""
        if self._closed:
            return
        self._closed = True
        if self._faces is not None:
            self._faces.close()
        self._tracked.close()
        self._leases.close_all()
        self._transforms.close()
        release(self._markers)

    def _face_boxes(self, frame: Frame, context: dict) -> List[FaceBox]:
        observed: Optional[Sequence[FaceObservation]] = context.get("faces")
        if observed is not None:
            return [FaceBox.from_landmarks(face.id, face.landmarks) for face in observed]
        if self._faces is None:
            return []
        height, width = frame.bgr.shape[:2]
        return self._faces.boxes(frame.stamp, width, height)

    def _publish_in_space(self, bodies: Sequence[BodyObservation], frame: Frame) -> None:
        self._no_frame = not frame.header.frame_id
        if self._no_frame:
            rospy.logwarn_throttle(_LOG_PERIOD_S, "images have no frame_id, so bodies have no TF frame; "
                                   "set the camera driver's frame_id")
            return
        transforms: List[TransformStamped] = []
        for body in bodies:
            transforms += body_transforms(body, frame)
        self._transforms.send(transforms)
        if self._markers.get_num_connections():
            self._markers.publish(skeleton_markers(bodies, frame.header))


def body_transforms(body: BodyObservation, frame: Frame) -> List[TransformStamped]:
    """Transforms of body_ID in the image's frame and head_ID in body_ID, as far as they are known."""
    if body.pose is None:
        return []
    stamp, name = frame.header.stamp, "body_" + body.id
    transforms = [transform_to_msg(body.pose, stamp, frame.header.frame_id, name)]
    head = head_pose(body.keypoints_3d, body.pose)
    if head is not None:
        transforms.append(transform_to_msg(body.pose.inverse().compose(head), stamp, name, "head_" + body.id))
    return transforms
