"""The topics under /humans/bodies/ID."""

from __future__ import annotations

from typing import Iterable, Mapping, Optional, Sequence

import numpy as np
from geometry_msgs.msg import Point, PointStamped, TwistStamped, Vector3
from sensor_msgs.msg import Image, JointState
from std_msgs.msg import Header

from hri_fullbody.core.behaviour.recognizer import BodyBehaviour
from hri_fullbody.core.pipeline import ModelledBody
from hri_fullbody.core.behaviour.pointing import Pointing
from hri_msgs.msg import BodyAttitude, BodyPosture, Gesture, PointingStamped, Skeleton2D
from hri_msgs.msg import Pointing as PointingMessage
from hri_pipeline.core.observations import BodyObservation
from hri_pipeline.ros.conversions import bgr_to_image, roi_message, roi_type, skeleton_to_msg
from hri_pipeline.ros.inputs import Frame
from hri_pipeline.ros.publishers import IdPublishers, TopicSpec

NAMESPACE = "/humans/bodies"


class BodyTopics:
    """Publishers of every tracked body. interface: paper or rep155, the type of `roi`.

    A message is made only while somebody listens; joint_states, which those who come get at once, always.
    """

    def __init__(self, interface: str) -> None:
        self._interface = interface
        # robot_state_publisher gets the last joint state when it comes, and has frames before the next is due.
        self._leases = IdPublishers(NAMESPACE, {
            "roi": TopicSpec(roi_type(interface)), "skeleton2d": TopicSpec(Skeleton2D),
            "joint_states": TopicSpec(JointState, greet=True), "attitude": TopicSpec(BodyAttitude),
            "posture": TopicSpec(BodyPosture), "gesture": TopicSpec(Gesture), "cropped": TopicSpec(Image),
            "position": TopicSpec(PointStamped), "velocity": TopicSpec(TwistStamped)})

    def keep(self, ids: Iterable[str]) -> None:
        """Advertise the topics of these bodies, take those of all others back."""
        self._leases.keep(ids)

    def publish_seen(self, body: BodyObservation, frame: Frame) -> None:
        """Publish what is seen in the image: roi, skeleton2d, cropped."""
        height, width = frame.bgr.shape[:2]
        if self._listened(body.id, "roi"):
            self._leases.publish(body.id, "roi", roi_message(
                body.box, width, height, self._interface, frame.header, body.score))
        if self._listened(body.id, "skeleton2d"):
            self._leases.publish(body.id, "skeleton2d", skeleton_to_msg(body.keypoints, frame.header, width, height))
        if self._listened(body.id, "cropped"):
            part = crop(frame.bgr, body.box)
            if part is not None:
                self._leases.publish(body.id, "cropped", bgr_to_image(part, frame.header))

    def publish_place(self, body_id: str, position: np.ndarray, velocity: Optional[np.ndarray], frame: Frame) -> None:
        """Publish position (3,) m and velocity (3,) m/s of a body in the image's frame, as far as they are known."""
        if self._listened(body_id, "position") and np.all(np.isfinite(position)):
            message = PointStamped(header=frame.header)
            message.point.x, message.point.y, message.point.z = (float(value) for value in position)
            self._leases.publish(body_id, "position", message)
        if velocity is not None and self._listened(body_id, "velocity") and np.all(np.isfinite(velocity)):
            twist = TwistStamped(header=frame.header)
            linear = twist.twist.linear
            linear.x, linear.y, linear.z = (float(value) for value in velocity)
            self._leases.publish(body_id, "velocity", twist)

    def publish_behaviour(self, body_id: str, behaviour: BodyBehaviour, frame: Frame) -> None:
        """Publish attitude, posture and gesture."""
        if self._listened(body_id, "attitude"):
            self._leases.publish(body_id, "attitude", BodyAttitude(
                header=frame.header, attitude=behaviour.attitude, confidence=behaviour.attitude_confidence))
        if self._listened(body_id, "posture"):
            self._leases.publish(body_id, "posture", BodyPosture(header=frame.header, posture=behaviour.posture))
        if self._listened(body_id, "gesture"):
            self._leases.publish(body_id, "gesture", Gesture(header=frame.header, gesture=behaviour.gesture))

    def publish_joints(self, model: ModelledBody, names: Sequence[str], frame: Frame) -> None:
        """Publish the joint angles, rad; names without the id of the body."""
        message = joint_state(model, names, frame)
        if message is not None:
            self._leases.publish(model.id, "joint_states", message)

    def close(self) -> None:
        """Take all topics back. Idempotent."""
        self._leases.close_all()

    def _listened(self, body_id: str, name: str) -> bool:
        return self._leases.has_subscribers(body_id, name)


def joint_state(model: ModelledBody, names: Sequence[str], frame: Frame) -> Optional[JointState]:
    """Message of a body's joints, every name suffixed with its id; None while an angle is not a number."""
    angles = np.asarray(model.joints, dtype=np.float64)
    if angles.shape != (len(names),) or not np.all(np.isfinite(angles)):
        return None
    return JointState(header=frame.header, name=["{}_{}".format(name, model.id) for name in names],
                      position=angles.tolist())


def crop(bgr: np.ndarray, box: np.ndarray) -> Optional[np.ndarray]:
    """Cut the box x0, y0, x1, y1 px out of (H, W, 3); None when nothing of it is in the image."""
    if not np.all(np.isfinite(box)):
        return None
    height, width = bgr.shape[:2]
    x0, y0 = np.clip(np.floor(box[:2]), 0, (width, height)).astype(int)
    x1, y1 = np.clip(np.ceil(box[2:]), 0, (width, height)).astype(int)
    return bgr[y0:y1, x0:x1] if x1 > x0 and y1 > y0 else None


def pointing_message(found: Mapping[str, Pointing], header: Header) -> PointingStamped:
    """Make the message of who points, by body id, in the frame of `header`."""
    return PointingStamped(header=header, pointings=[
        PointingMessage(
            sender=body_id, receiver=one.receiver, origin=Point(*one.origin.tolist()),
            direction=Vector3(*one.direction.tolist()), has_place=one.place is not None,
            place=Point() if one.place is None else Point(*one.place.tolist()), confidence=one.confidence)
        for body_id, one in found.items()])
