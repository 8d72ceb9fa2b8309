"""Markers for rviz: what all nodes need to make them, and who looks at whom and who stands together."""

from __future__ import annotations

import math
from typing import Dict, List, Mapping, Optional, Sequence, Tuple

import numpy as np
import rospy
from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from hri_pipeline.core.interactions.groups import Group
from hri_pipeline.core.interactions.people import ROBOT, GazeTarget, Observer
from hri_pipeline.core.overlay import colour_of

ONE_WAY = (0.10, 0.75, 0.95)
MUTUAL = (1.00, 0.45, 0.05)
"""Colours (red, green, blue) of a gaze, and of two that meet."""

LIFETIME_S = 1.0
_ARROW_M = (0.025, 0.07, 0.14)       # diameter of shaft and head, length of the head
_FROM_HEAD_M, _TO_HEAD_M = 0.14, 0.16
_BESIDE_M = 0.05        # each of two gazes that meet keeps to its right
_SHORTEST_M = 0.05
_LEAST_DISC_M, _DISC_SHARE, _DISC_HEIGHT_M = 0.35, 0.7, 0.02
_LINE_M, _POLE_M, _FEET_M, _TEXT_M, _TEXT_ABOVE_M = 0.03, 0.008, 0.12, 0.14, 0.25
_LOW_HEAD_M, _HEAD_HEIGHT_M = 0.6, 1.6

Places = Mapping[str, np.ndarray]


class ShownMarkers:
    """Remembers the markers that rviz shows, so that those that are no longer needed go away at once."""

    def __init__(self) -> None:
        self._shown: Dict[Tuple[str, int], None] = {}

    def update(self, markers: Sequence[Marker], header: Header) -> MarkerArray:
        """Return these markers after the DELETE, in the frame of `header`, of all that is no longer there."""
        present = dict.fromkeys((marker.ns, marker.id) for marker in markers)
        gone = [Marker(header=header, ns=name, id=number, action=Marker.DELETE)
                for name, number in self._shown if (name, number) not in present]
        self._shown = present
        return MarkerArray(markers=gone + list(markers))


def make_marker(header: Header, name: str, number: int, kind: int, size: Sequence[float] = (0.0, 0.0, 0.0),
                colour: Sequence[float] = (1.0, 1.0, 1.0), alpha: float = 1.0, place: Sequence[float] = (0.0, 0.0, 0.0),
                lifetime: float = LIFETIME_S) -> Marker:
    """Return a marker of namespace `name`, upright at `place` (3,) m in the frame of `header`.

    size: (3,) m; colour: red, green, blue and alpha 0 to 1; it disappears by itself `lifetime` s after the last one.
    """
    marker = Marker(header=header, ns=name, id=number, type=kind, action=Marker.ADD, color=rgba(colour, alpha),
                    lifetime=rospy.Duration.from_sec(lifetime))
    marker.pose.position = point(place)
    marker.pose.orientation.w = 1.0
    marker.scale.x, marker.scale.y, marker.scale.z = size
    return marker


def rgba(colour: Sequence[float], alpha: float = 1.0) -> ColorRGBA:
    """Return the message of a colour: red, green, blue and alpha, 0 to 1; hardly seen at least, where that is asked."""
    return ColorRGBA(*(float(value) for value in colour), min(max(alpha, 0.1), 1.0) if math.isfinite(alpha) else 1.0)


def point(place: Sequence[float]) -> Point:
    """Return the message of a place (3,) m."""
    return Point(*(float(value) for value in place))


def interaction_markers(observers: Sequence[Observer], gazes: Sequence[GazeTarget], groups: Sequence[Group],
                        header: Header, robot: Optional[np.ndarray] = None) -> List[Marker]:
    """Return arrows from head to head, and of each group the o-space, lines to its members, and a line of text.

    All are in the frame of `header`, z up, m; robot: (3,) where the robot is looked at. The floor is at 0, or a
    person's height below the lowest head where that is hardly above 0, as in the frame of a camera. Gazes of and at
    somebody without a place are left out, and so are such members.
    """
    places = {person.id: np.asarray(person.head, dtype=np.float64) for person in observers if person.head is not None}
    if robot is not None:
        places[ROBOT] = np.asarray(robot, dtype=np.float64)
    places = {name: place for name, place in places.items() if place.shape == (3,) and np.isfinite(place).all()}
    ground = _ground(places)
    header = without_stamp(header)
    return _gaze_markers(gazes, places, header) + _group_markers(groups, places, ground, header)


def without_stamp(header: Header) -> Header:
    """Return the header of a marker: without a stamp, so that rviz does not wait for the transforms of that time."""
    return Header(frame_id=header.frame_id)


def _ground(places: Places) -> float:
    heights = [float(place[2]) for name, place in places.items() if name != ROBOT]
    return 0.0 if not heights or min(heights) >= _LOW_HEAD_M else min(heights) - _HEAD_HEIGHT_M


def _gaze_markers(gazes: Sequence[GazeTarget], places: Places, header: Header) -> List[Marker]:
    pairs: Dict[Tuple[str, str], float] = {(gaze.sender, gaze.receiver): float(gaze.confidence) for gaze in gazes}
    markers = []
    for (sender, receiver), confidence in sorted(pairs.items()):
        if sender not in places or receiver not in places:
            continue
        mutual = (receiver, sender) in pairs
        ends = _ray(places[sender], places[receiver], _BESIDE_M if mutual else 0.0)
        if ends is None:
            continue
        marker = make_marker(header, "gaze", len(markers), Marker.ARROW, _ARROW_M, MUTUAL if mutual else ONE_WAY,
                             0.35 + 0.65 * min(max(confidence, 0.0), 1.0))
        marker.points = [point(end) for end in ends]
        markers.append(marker)
    return markers


def _ray(start: np.ndarray, end: np.ndarray, beside: float) -> Optional[Tuple[np.ndarray, np.ndarray]]:
    """Return both ends of an arrow between two heads, outside of them; None for heads too near each other."""
    way = end - start
    length = float(np.linalg.norm(way))
    if length < _FROM_HEAD_M + _TO_HEAD_M + _SHORTEST_M:
        return None
    way = way / length
    right = np.array([way[1], -way[0], 0.0])
    right *= beside / max(float(np.linalg.norm(right)), 1e-9)
    return start + _FROM_HEAD_M * way + right, end - _TO_HEAD_M * way + right


def _group_markers(groups: Sequence[Group], places: Places, ground: float, header: Header) -> List[Marker]:
    markers: List[Marker] = []
    number = 0
    for group in sorted(groups, key=lambda group: group.id):
        middle = np.array([group.o_space[0], group.o_space[1], ground], dtype=np.float64)
        heads = [places[name] for name in group.members if name in places]
        if np.isfinite(middle).all() and heads:
            markers += _one_group(group, middle, heads, number, header)
            number += 1
    return markers


def _one_group(group: Group, middle: np.ndarray, heads: Sequence[np.ndarray], number: int,
               header: Header) -> List[Marker]:
    """Markers of one group. middle: (3,) of its o-space, on the floor; heads: (3,) of the members."""
    # OpenCV's order is blue, green, red.
    colour = [value / 255.0 for value in colour_of(group.id)[::-1]]
    stands = [np.array([head[0], head[1], middle[2]]) for head in heads]
    above = np.array([0.0, 0.0, 2.0 * _DISC_HEIGHT_M])
    apart = float(np.mean([np.linalg.norm(stand - middle) for stand in stands]))
    wide = 2.0 * max(_LEAST_DISC_M, _DISC_SHARE * apart)
    disc = make_marker(header, "o-space", number, Marker.CYLINDER, (wide, wide, _DISC_HEIGHT_M), colour,
                       0.25 + 0.35 * group.confidence, middle + above / 4.0)
    lines = make_marker(header, "members", number, Marker.LINE_LIST, (_LINE_M, 0.0, 0.0), colour)
    lines.points = [point(end + above) for stand in stands for end in (middle, stand)]
    feet = make_marker(header, "feet", number, Marker.SPHERE_LIST, (_FEET_M,) * 3, colour)
    feet.points = [point(stand + above) for stand in stands]
    poles = make_marker(header, "poles", number, Marker.LINE_LIST, (_POLE_M, 0.0, 0.0), colour, 0.4)
    poles.points = [point(end) for stand, head in zip(stands, heads) for end in (stand, head)]
    text = make_marker(header, "group", number, Marker.TEXT_VIEW_FACING, (0.0, 0.0, _TEXT_M),
                       place=middle + (0.0, 0.0, _TEXT_ABOVE_M))
    people = sum(name != ROBOT for name in group.members)
    text.text = "{} ({}{})".format(group.id, people, " + robot" if ROBOT in group.members else "")
    return [disc, lines, feet, poles, text]
