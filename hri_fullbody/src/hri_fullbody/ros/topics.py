"""The topics under /humans/bodies/ID, and skeletons as markers for rviz: limbs, joints, a head, a line of text."""

from __future__ import annotations

from typing import Iterable, List, Mapping, Optional, Sequence, Tuple

import numpy as np
from geometry_msgs.msg import Point, PointStamped, TwistStamped, Vector3
from sensor_msgs.msg import Image, JointState
from std_msgs.msg import Header
from visualization_msgs.msg import Marker

from hri_fullbody.core import keypoints as kp
from hri_fullbody.core.behaviour.pointing import Pointing
from hri_fullbody.core.behaviour.recognizer import BodyBehaviour
from hri_fullbody.core.keypoints import EDGES
from hri_fullbody.core.modeller import ModelledBody
from hri_msgs.msg import BodyAttitude, BodyPosture, Gesture, PointingStamped, Skeleton2D
from hri_msgs.msg import Pointing as PointingMessage
from hri_pipeline.core.observations import BodyObservation
from hri_pipeline.core.overlay import colour_of, label_lifts
from hri_pipeline.ros.conversions import bgr_to_image, matrix_to_image, roi_message, roi_type, skeleton_to_msg
from hri_pipeline.ros.image_input import Frame
from hri_pipeline.ros.markers import make_marker, point, rgba
from hri_pipeline.ros.publishers import IdPublishers, TopicSpec

NAMESPACE = "/humans/bodies"


class BodyTopics:
    """Publishers of every tracked body. interface: paper or rep155, the type of `roi`.

    A message is made only while somebody listens; joint_states, which those who come get at once, always.
    """

    def __init__(self, interface: str) -> None:
        self._interface = interface
        # robot_state_publisher gets the last joint state when it comes, and has frames before the next is due.
        self._publishers = IdPublishers(NAMESPACE, {
            "roi": TopicSpec(roi_type(interface)), "skeleton2d": TopicSpec(Skeleton2D),
            "joint_states": TopicSpec(JointState, greet=True), "attitude": TopicSpec(BodyAttitude),
            "posture": TopicSpec(BodyPosture), "gesture": TopicSpec(Gesture), "cropped": TopicSpec(Image),
            "appearance": TopicSpec(Image),
            "position": TopicSpec(PointStamped), "velocity": TopicSpec(TwistStamped)})

    def keep(self, ids: Iterable[str]) -> None:
        """Advertise the topics of these bodies, take those of all others back."""
        self._publishers.keep(ids)

    def publish_seen(self, body: BodyObservation, frame: Frame) -> None:
        """Publish what is seen in the image: roi, skeleton2d, cropped."""
        height, width = frame.bgr.shape[:2]
        if self._listened(body.id, "roi"):
            self._publishers.publish(body.id, "roi", roi_message(
                body.box, width, height, self._interface, frame.header, body.score))
        if self._listened(body.id, "skeleton2d"):
            self._publishers.publish(body.id, "skeleton2d",
                                     skeleton_to_msg(body.judged_keypoints, frame.header, width, height))
        if self._listened(body.id, "cropped"):
            part = crop(frame.bgr, body.box)
            if part is not None:
                self._publishers.publish(body.id, "cropped", bgr_to_image(frame.rotation.image(part), frame.header))

    def publish_place(self, body_id: str, position: np.ndarray, velocity: Optional[np.ndarray], frame: Frame) -> None:
        """Publish position (3,) m and velocity (3,) m/s of a body in the image's frame, as far as they are known."""
        if self._listened(body_id, "position") and np.all(np.isfinite(position)):
            message = PointStamped(header=frame.header)
            message.point.x, message.point.y, message.point.z = (float(value) for value in position)
            self._publishers.publish(body_id, "position", message)
        if velocity is not None and self._listened(body_id, "velocity") and np.all(np.isfinite(velocity)):
            twist = TwistStamped(header=frame.header)
            linear = twist.twist.linear
            linear.x, linear.y, linear.z = (float(value) for value in velocity)
            self._publishers.publish(body_id, "velocity", twist)

    def publish_behaviour(self, body_id: str, behaviour: BodyBehaviour, frame: Frame) -> None:
        """Publish attitude, posture and gesture."""
        if self._listened(body_id, "attitude"):
            self._publishers.publish(body_id, "attitude", BodyAttitude(
                header=frame.header, attitude=behaviour.attitude, confidence=behaviour.attitude_confidence))
        if self._listened(body_id, "posture"):
            self._publishers.publish(body_id, "posture", BodyPosture(header=frame.header, posture=behaviour.posture))
        if self._listened(body_id, "gesture"):
            self._publishers.publish(body_id, "gesture", Gesture(header=frame.header, gesture=behaviour.gesture))

    def publish_appearance(self, body_id: str, colours: Optional[np.ndarray], frame: Frame) -> None:
        """Publish the colours (5, 21) of a body's clothes, a row for each part, as far as they are known."""
        if colours is not None and self._listened(body_id, "appearance"):
            self._publishers.publish(body_id, "appearance", matrix_to_image(colours, frame.header))

    def publish_joints(self, model: ModelledBody, names: Sequence[str], frame: Frame) -> None:
        """Publish the joint angles, rad; names without the id of the body."""
        message = joint_state(model, names, frame)
        if message is not None:
            self._publishers.publish(model.id, "joint_states", message)

    def close(self) -> None:
        """Take all topics back. Idempotent."""
        self._publishers.close_all()

    def _listened(self, body_id: str, name: str) -> bool:
        return self._publishers.has_subscribers(body_id, name)


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


_LIMB_WIDTH_M = 0.035
_FACE_WIDTH_M = 0.012
_JOINT_SIZE_M = 0.06
_FACE_POINT_SIZE_M = 0.025
_HEAD_SIZE_M = (0.19, 0.19, 0.25)
_TEXT_HEIGHT_M = 0.10
_ARROW_M, _RAY_M = (0.02, 0.06, 0.1), 3.0       # diameter of shaft and head, length of the head; of a ray into nothing
_LETTER_WIDTH_M = 0.055
_TEXT_BELOW_M = 0.15
_TEXT_STEP_M = 0.25     # from a text to that of a neighbour below it
_NUMBER = {"limbs": 0, "joints": 1, "face": 2, "face points": 3, "head": 4, "text": 5, "pointing": 6}
_FACE = (kp.NOSE, kp.LEFT_EYE, kp.RIGHT_EYE, kp.LEFT_EAR, kp.RIGHT_EAR)
_LEFT = (kp.LEFT_SHOULDER, kp.LEFT_ELBOW, kp.LEFT_WRIST, kp.LEFT_HIP, kp.LEFT_KNEE, kp.LEFT_ANKLE)
_RIGHT = (kp.RIGHT_SHOULDER, kp.RIGHT_ELBOW, kp.RIGHT_WRIST, kp.RIGHT_HIP, kp.RIGHT_KNEE, kp.RIGHT_ANKLE)
# Conventional lights: port (left) is red, starboard (right) is green.
_SIDE_COLOURS = {"left": np.array([0.93, 0.20, 0.17]), "right": np.array([0.15, 0.75, 0.30])}
_UP = np.array([0.0, -1.0, 0.0])
_LIMBS = tuple(edge for edge in EDGES if edge[0] not in _FACE and edge[1] not in _FACE)
_FACE_LINES = tuple(edge for edge in EDGES if edge not in _LIMBS and kp.NECK not in edge)


def skeleton_markers(bodies: Sequence[BodyObservation], header: Header, labels: Optional[Mapping[str, str]] = None,
                     up: Sequence[float] = (0.0, -1.0, 0.0),
                     pointing: Optional[Mapping[str, Pointing]] = None) -> List[Marker]:
    """Lines, joints, head and text of all bodies in the frame of `header`, and an arrow for each that points; what is
    not known in space is left out.

    Limbs of the left are red, those of the right green; joints, head and trunk have a colour that hangs on the id
    alone. labels: body id -> text after the id, such as stature and attitude; both stand below the body, those of
    neighbours below one another. up: (3,) against gravity in the frame of `header`, to which heads and texts keep.
    """
    direction = np.asarray(up, dtype=np.float64)
    length = float(np.linalg.norm(direction))
    direction = direction / length if np.isfinite(length) and length > 1e-9 else _UP
    markers: List[Marker] = []
    for body in bodies:
        markers += _body_markers(body, header, direction)
    markers += _texts(bodies, header, labels or {}, direction)
    return markers + [_arrow(header, body_id, one) for body_id, one in (pointing or {}).items()]


def _body_markers(body: BodyObservation, header: Header, up: np.ndarray) -> List[Marker]:
    places = np.asarray(body.keypoints_3d, dtype=np.float64)
    known = np.isfinite(places).all(axis=1)
    if not known.any():
        return []
    blue, green, red = colour_of(body.id)
    colour = np.array([red, green, blue]) / 255.0
    middle = _head_middle(places, known)
    lines = [(places[a], places[b], _limb_colour(colour, a, b)) for a, b in _LIMBS if known[a] and known[b]]
    if middle is not None and known[kp.NECK]:
        lines.append((places[kp.NECK], middle, colour))
    face_lines = [(places[a], places[b], _white(colour)) for a, b in _FACE_LINES if known[a] and known[b]]
    joints = [(places[index], colour) for index in np.flatnonzero(known) if index not in _FACE]
    face = [(places[index], _white(colour)) for index in _FACE if known[index]]
    markers = [
        _many(header, body.id, "limbs", Marker.LINE_LIST, (_LIMB_WIDTH_M, 0.0, 0.0), _ends(lines)),
        _many(header, body.id, "joints", Marker.SPHERE_LIST, (_JOINT_SIZE_M,) * 3, joints),
        _many(header, body.id, "face", Marker.LINE_LIST, (_FACE_WIDTH_M, 0.0, 0.0), _ends(face_lines)),
        _many(header, body.id, "face points", Marker.SPHERE_LIST, (_FACE_POINT_SIZE_M,) * 3, face)]
    if middle is not None:
        markers.append(_head(header, body.id, middle, up, colour))
    return [marker for marker in markers if marker is not None]


def _head_middle(places: np.ndarray, known: np.ndarray) -> Optional[np.ndarray]:
    """Middle of the head (3,) m: between the ears, else a little behind the nose as seen by the sensor."""
    if known[kp.LEFT_EAR] and known[kp.RIGHT_EAR]:
        return 0.5 * (places[kp.LEFT_EAR] + places[kp.RIGHT_EAR])
    seen = [index for index in _FACE if known[index]]
    return places[seen].mean(axis=0) if seen else None


def _ends(lines: Sequence[Tuple[np.ndarray, np.ndarray, np.ndarray]]) -> List[Tuple[np.ndarray, np.ndarray]]:
    return [(place, colour) for start, end, colour in lines for place in (start, end)]


def _limb_colour(colour: np.ndarray, first: int, second: int) -> np.ndarray:
    """Colour of a line between two points: of the side of both, else the body's own."""
    for side, points in (("left", _LEFT), ("right", _RIGHT)):
        if second in points and (first in points or first == kp.NECK):
            return _SIDE_COLOURS[side]
    return colour


def _white(colour: np.ndarray) -> np.ndarray:
    return 0.3 * colour + 0.7


def _arrow(header: Header, name: str, pointing: Pointing) -> Marker:
    """From the eyes to the place that is pointed at, else 3 m long."""
    marker = make_marker(header, name, _NUMBER["pointing"], Marker.ARROW, _ARROW_M, (1.0, 0.75, 0.1), 0.8)
    end = pointing.origin + _RAY_M * pointing.direction if pointing.place is None else pointing.place
    marker.points = [point(pointing.origin), point(end)]
    return marker


def _many(header: Header, name: str, part: str, kind: int, size: Sequence[float],
          places: Sequence[Tuple[np.ndarray, np.ndarray]]) -> Optional[Marker]:
    """A marker of many points with a colour each; None without points."""
    if not places:
        return None
    marker = make_marker(header, name, _NUMBER[part], kind, size, places[0][1])
    marker.points = [point(place) for place, _ in places]
    marker.colors = [rgba(colour) for _, colour in places]
    return marker


def _head(header: Header, name: str, middle: np.ndarray, up: np.ndarray, colour: np.ndarray) -> Marker:
    marker = make_marker(header, name, _NUMBER["head"], Marker.SPHERE, _HEAD_SIZE_M, colour, 0.45, middle)
    # The shortest turn that brings z to `up`.
    x, y, z, w = -up[1], up[0], 0.0, 1.0 + up[2]
    norm = float(np.sqrt(x * x + y * y + w * w))
    x, y, w = (x / norm, y / norm, w / norm) if norm > 1e-6 else (1.0, 0.0, 0.0)
    orientation = marker.pose.orientation
    orientation.x, orientation.y, orientation.z, orientation.w = float(x), float(y), z, float(w)
    return marker


def _texts(bodies: Sequence[BodyObservation], header: Header, labels: Mapping[str, str],
           up: np.ndarray) -> List[Marker]:
    """Of each body the id and the label, below its lowest point: above are those of persons.

    In one line: where rviz looks from is not known, and of two who stand at different distances the texts move
    against each other in the picture by what _TEXT_STEP_M leaves free.
    """
    texts, feet = [], []
    for body in bodies:
        places = np.asarray(body.keypoints_3d, dtype=np.float64)
        places = places[np.isfinite(places).all(axis=1)]
        if len(places):
            label = labels.get(body.id, "")
            texts.append((body.id, "{}  {}".format(body.id, label) if label else body.id))
            # Below the middle of the trunk: feet that swing would swing the text.
            feet.append(places.mean(axis=0) + ((places @ up).min() - places.mean(axis=0) @ up) * up)
    widths = [_LETTER_WIDTH_M * len(text) for _, text in texts]
    drops = label_lifts(feet, -up, widths, _TEXT_STEP_M)
    markers = []
    for (name, text), place, drop in zip(texts, feet, drops):
        marker = make_marker(header, name, _NUMBER["text"], Marker.TEXT_VIEW_FACING, (0.0, 0.0, _TEXT_HEIGHT_M),
                             place=place - (_TEXT_BELOW_M + drop) * up)
        marker.text = text
        markers.append(marker)
    return markers
