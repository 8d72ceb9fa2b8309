"""Markers at the person frames for rviz, and the topic /humans/graph: the match graph as text for GraphViz.

See the graph with `rostopic echo -p /humans/graph`, or with xdot.
"""

from __future__ import annotations

import math
import time
from typing import Callable, List

import rospy
from geometry_msgs.msg import Point, Quaternion
from geometry_msgs.msg import Pose as PoseMsg
from scipy.spatial.transform import Rotation
from std_msgs.msg import ColorRGBA, String
from visualization_msgs.msg import Marker, MarkerArray

from hri_person_manager.core.location import Place
from hri_person_manager.core.persons import Snapshot
from hri_person_manager.core.triangulation import ellipse
from hri_pipeline.core.frames import is_optical
from hri_pipeline.ros.rospy_compat import release

RADIUS = 0.06           # m
TEXT_HEIGHT = 0.12      # m
TEXT_ABOVE = 0.55       # m, above the two lines that the body's own label has there
THICKNESS = 0.01        # m, of an ellipse
LIFETIME_S = 0.5
GRAPH_PERIOD_S = 0.2


class PersonMarkers:
    """MarkerArray on `visualization/persons`, made only while somebody listens."""

    def __init__(self) -> None:
        self._publisher = rospy.Publisher("visualization/persons", MarkerArray, queue_size=1)

    def publish(self, snapshot: Snapshot) -> None:
        """Show the persons that have a place, with its 95 % ellipse; they fade with their confidence."""
        if not self._publisher.get_num_connections():
            return
        markers: List[Marker] = []
        for number, state in enumerate(snapshot.persons):
            if state.place is None or state.confidence <= 0.0:
                continue
            position = Point(*(float(value) for value in state.place.pose.translation))
            above = Point(position.x, position.y, position.z)
            if is_optical(state.place.frame):
                above.y -= TEXT_ABOVE        # y of an optical frame points down
            else:
                above.z += TEXT_ABOVE
            colour = ColorRGBA(0.1, 0.7, 1.0, 0.3 + 0.7 * state.confidence)
            for kind, where, size in ((Marker.SPHERE, position, 2.0 * RADIUS),
                                      (Marker.TEXT_VIEW_FACING, above, TEXT_HEIGHT)):
                marker = Marker(ns="persons", id=2 * number + (kind != Marker.SPHERE), type=kind, color=colour,
                                pose=PoseMsg(where, Quaternion(0.0, 0.0, 0.0, 1.0)),
                                text=_label(state.id) if kind == Marker.TEXT_VIEW_FACING else "",
                                lifetime=rospy.Duration(LIFETIME_S))
                marker.header.frame_id = state.place.frame
                marker.scale.x = marker.scale.y = marker.scale.z = size
                markers.append(marker)
            markers += _ellipse(number, state.place)
        self._publisher.publish(MarkerArray(markers))

    def close(self) -> None:
        """Take the topic back. Idempotent."""
        release(self._publisher)


def _ellipse(number: int, place: Place) -> List[Marker]:
    """The horizontal 95 % ellipse of a place, as a flat disc at its height; none where it is not known."""
    covariance = place.horizontal_covariance
    if covariance is None:
        return []
    major, minor, turn = ellipse(covariance)
    optical = is_optical(place.frame)
    # The disc lies in x and y, in x and z of an optical frame; it is turned within its plane.
    rotation = Rotation.from_euler("XZ", [math.pi / 2.0, turn] if optical else [0.0, turn]).as_quat()
    marker = Marker(ns="uncertainty", id=number, type=Marker.CYLINDER, color=ColorRGBA(0.1, 0.7, 1.0, 0.15),
                    pose=PoseMsg(Point(*place.pose.translation.tolist()), Quaternion(*rotation.tolist())),
                    lifetime=rospy.Duration(LIFETIME_S))
    marker.header.frame_id = place.frame
    marker.scale.x, marker.scale.y, marker.scale.z = 2.0 * major, 2.0 * minor, THICKNESS
    return [marker]


def _label(person_id: str) -> str:
    return person_id[len("anonymous_person_"):] if person_id.startswith("anonymous_person_") else person_id


class GraphTopic:
    """Publishes the text when it has changed, five times a second at most, and only while somebody listens."""

    def __init__(self) -> None:
        self._publisher = rospy.Publisher("/humans/graph", String, queue_size=1, latch=True)
        self._last = ""
        self._next = 0.0

    def update(self, text: Callable[[], str]) -> None:
        """Publish what `text` returns, if it is new."""
        now = time.monotonic()
        if now < self._next or not self._publisher.get_num_connections():
            return
        self._next = now + GRAPH_PERIOD_S
        found = text()
        if found != self._last:
            self._last = found
            self._publisher.publish(String(found))

    def close(self) -> None:
        """Take the topic back. Idempotent."""
        release(self._publisher)
