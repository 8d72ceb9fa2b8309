"""Markers for rviz: who looks at whom, and who stands together."""

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

_LIFETIME_S = 1.0
_SHAFT_M, _TIP_M, _TIP_LENGTH_M = 0.025, 0.07, 0.14
_FROM_HEAD_M, _TO_HEAD_M = 0.14, 0.16
_BESIDE_M = 0.05        # each of two gazes that meet keeps to its right
_SHORTEST_M = 0.05
_LEAST_DISC_M, _DISC_SHARE, _DISC_HEIGHT_M = 0.35, 0.7, 0.02
_LINE_M, _POLE_M, _FEET_M, _TEXT_M, _TEXT_ABOVE_M = 0.03, 0.008, 0.12, 0.14, 0.25
_LOW_HEAD_M, _HEAD_HEIGHT_M = 0.6, 1.6

Places = Mapping[str, np.ndarray]


class InteractionMarkers:
    """Makes the markers of each time, and deletes those that are no longer needed."""

    def __init__(self) -> None:
        self._shown: List[Tuple[str, int]] = []

    def make(self, observers: Sequence[Observer], gazes: Sequence[GazeTarget], groups: Sequence[Group], header: Header,
             robot: Optional[np.ndarray] = None, floor: Optional[float] = None) -> MarkerArray:
        """Return the markers, see make_markers, after the DELETE of all that is no longer there."""
        array = make_markers(observers, gazes, groups, header, robot, floor)
        present = [(marker.ns, marker.id) for marker in array.markers]
        gone = [Marker(header=_shown_header(header), ns=name, id=number, action=Marker.DELETE)
                for name, number in self._shown if (name, number) not in set(present)]
        self._shown = present
        array.markers = gone + array.markers
        return array

    def clear(self, header: Header) -> MarkerArray:
        """Return the DELETE of every marker that is shown."""
        return self.make([], [], [], header)


def make_markers(observers: Sequence[Observer], gazes: Sequence[GazeTarget], groups: Sequence[Group], header: Header,
                 robot: Optional[np.ndarray] = None, floor: Optional[float] = None) -> MarkerArray:
    """Return arrows from head to head, and of each group the o-space, lines to its members, and a line of text.

    All are in the frame of `header`, z up, m; robot: (3,) where the robot is looked at; floor: height of the floor,
    None: 0, or a person's height below the lowest head where that is hardly above 0, as in the frame of a camera. Gazes
    of and at somebody without a place are left out, and so are such members. Every marker disappears by itself a second
    after the last message.
    """
    places = {person.id: np.asarray(person.head, dtype=np.float64) for person in observers if person.head is not None}
    if robot is not None:
        places[ROBOT] = np.asarray(robot, dtype=np.float64)
    places = {name: place for name, place in places.items() if place.shape == (3,) and np.isfinite(place).all()}
    ground = _ground(places) if floor is None else float(floor)
    header = _shown_header(header)
    return MarkerArray(markers=_gaze_markers(gazes, places, header) + _group_markers(groups, places, ground, header))


def _shown_header(header: Header) -> Header:
    """Header of a marker: without a stamp, so that rviz does not wait for the transforms of that time."""
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
        marker = _marker(header, "gaze", len(markers), Marker.ARROW, MUTUAL if mutual else ONE_WAY,
                         0.35 + 0.65 * min(max(confidence, 0.0), 1.0))
        marker.points = [_point(end) for end in ends]
        marker.scale.x, marker.scale.y, marker.scale.z = _SHAFT_M, _TIP_M, _TIP_LENGTH_M
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
    disc = _marker(header, "o-space", number, Marker.CYLINDER, colour, 0.25 + 0.35 * group.confidence)
    disc.pose.position = _point(middle + above / 4.0)
    disc.scale.x = disc.scale.y = 2.0 * max(
        _LEAST_DISC_M, _DISC_SHARE * float(np.mean([np.linalg.norm(stand - middle) for stand in stands])))
    disc.scale.z = _DISC_HEIGHT_M
    lines = _marker(header, "members", number, Marker.LINE_LIST, colour, 1.0)
    lines.scale.x = _LINE_M
    lines.points = [_point(end + above) for stand in stands for end in (middle, stand)]
    feet = _marker(header, "feet", number, Marker.SPHERE_LIST, colour, 1.0)
    feet.scale.x = feet.scale.y = feet.scale.z = _FEET_M
    feet.points = [_point(stand + above) for stand in stands]
    poles = _marker(header, "poles", number, Marker.LINE_LIST, colour, 0.4)
    poles.scale.x = _POLE_M
    poles.points = [_point(end) for stand, head in zip(stands, heads) for end in (stand, head)]
    text = _marker(header, "group", number, Marker.TEXT_VIEW_FACING, (1.0, 1.0, 1.0), 1.0)
    text.pose.position = _point(middle + (0.0, 0.0, _TEXT_ABOVE_M))
    text.scale.z = _TEXT_M
    people = sum(name != ROBOT for name in group.members)
    text.text = "{} ({}{})".format(group.id, people, " + robot" if ROBOT in group.members else "")
    return [disc, lines, feet, poles, text]


def _marker(header: Header, name: str, number: int, kind: int, colour: Sequence[float], alpha: float) -> Marker:
    marker = Marker(header=header, ns=name, id=number, type=kind, action=Marker.ADD,
                    lifetime=rospy.Duration(_LIFETIME_S))
    marker.pose.orientation.w = 1.0
    marker.color = ColorRGBA(*(float(value) for value in colour),
                             min(max(alpha, 0.1), 1.0) if math.isfinite(alpha) else 1.0)
    return marker


def _point(place: np.ndarray) -> Point:
    return Point(*(float(value) for value in place))
