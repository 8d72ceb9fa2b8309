"""Spheres and names at the person frames, for rviz."""

from __future__ import annotations

from typing import List

import rospy
from geometry_msgs.msg import Point, Quaternion
from geometry_msgs.msg import Pose as PoseMsg
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from hri_person_manager.core.person_state import Snapshot
from hri_pipeline.ros.topic_release import release

RADIUS = 0.06           # m
TEXT_HEIGHT = 0.12      # m
TEXT_ABOVE = 0.55       # m, above the two lines that the body's own label has there
LIFETIME_S = 0.5


class PersonMarkers:
    """MarkerArray on `visualization/persons`, made only while somebody listens."""

    def __init__(self) -> None:
        self._publisher = rospy.Publisher("visualization/persons", MarkerArray, queue_size=1)

    def publish(self, snapshot: Snapshot) -> None:
        """Show the persons that have a place; they fade with the confidence of their location."""
        if not self._publisher.get_num_connections():
            return
        markers: List[Marker] = []
        for number, state in enumerate(snapshot.persons):
            if state.place is None or state.confidence <= 0.0:
                continue
            position = Point(*(float(value) for value in state.place.pose.translation))
            above = Point(position.x, position.y, position.z)
            if "optical" in state.place.frame:
                above.y -= TEXT_ABOVE        # y of an optical frame points down
            else:
                above.z += TEXT_ABOVE
            colour = ColorRGBA(0.1, 0.7, 1.0, 0.3 + 0.7 * state.confidence)
            for kind, where, size in ((Marker.SPHERE, position, 2.0 * RADIUS),
                                      (Marker.TEXT_VIEW_FACING, above, TEXT_HEIGHT)):
                marker = Marker(ns="persons", id=2 * number + (kind != Marker.SPHERE), type=kind, color=colour,
                                pose=PoseMsg(where, Quaternion(0.0, 0.0, 0.0, 1.0)), text=_label(state.id) if kind == Marker.TEXT_VIEW_FACING else "",
                                lifetime=rospy.Duration(LIFETIME_S))
                marker.header.frame_id = state.place.frame
                marker.scale.x = marker.scale.y = marker.scale.z = size
                markers.append(marker)
        self._publisher.publish(MarkerArray(markers))

    def close(self) -> None:
        """Take the topic back. Idempotent."""
        release(self._publisher)


def _label(person_id: str) -> str:
    return person_id[len("anonymous_person_"):] if person_id.startswith("anonymous_person_") else person_id
