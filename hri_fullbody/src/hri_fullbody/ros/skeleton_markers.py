"""Skeletons as markers for rviz."""

from __future__ import annotations

from typing import List, Sequence

import numpy as np
import rospy
from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from hri_fullbody.core.skeleton import EDGES
from hri_pipeline.core.observations import BodyObservation
from hri_pipeline.core.overlay import colour_of

_LIFETIME_S = 0.5
_LINE_WIDTH_M = 0.02
_JOINT_SIZE_M = 0.045


def skeleton_markers(bodies: Sequence[BodyObservation], header: Header) -> MarkerArray:
    """Lines and joints of all bodies in the frame of `header`; a body without known points in space has none.

    The colour hangs on the id alone. The markers disappear by themselves half a second after the last image.
    """
    markers: List[Marker] = []
    for body in bodies:
        known = np.all(np.isfinite(body.keypoints_3d), axis=1)
        points = [Point(*values) for values in np.nan_to_num(body.keypoints_3d).tolist()]
        colour = _colour(body.id)
        ends = [points[end] for edge in EDGES if known[edge[0]] and known[edge[1]] for end in edge]
        if ends:
            markers.append(_marker(header, body.id, 0, Marker.LINE_LIST, (_LINE_WIDTH_M, 0.0, 0.0), colour, ends))
        joints = [point for point, good in zip(points, known) if good]
        if joints:
            markers.append(_marker(header, body.id, 1, Marker.SPHERE_LIST, (_JOINT_SIZE_M,) * 3, colour, joints))
    return MarkerArray(markers=markers)


def _colour(body_id: str) -> ColorRGBA:
    blue, green, red = colour_of(body_id)
    return ColorRGBA(r=red / 255.0, g=green / 255.0, b=blue / 255.0, a=1.0)


def _marker(header: Header, namespace: str, number: int, kind: int, size: Sequence[float], colour: ColorRGBA,
            points: Sequence[Point]) -> Marker:
    marker = Marker(header=header, ns=namespace, id=number, type=kind, action=Marker.ADD, color=colour,
                    points=list(points), lifetime=rospy.Duration.from_sec(_LIFETIME_S))
    marker.scale.x, marker.scale.y, marker.scale.z = size
    marker.pose.orientation.w = 1.0
    return marker
