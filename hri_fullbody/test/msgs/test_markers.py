"""Markers of skeletons for rviz. Needs the message packages, no master."""

import genpy
import numpy as np
import pytest
from std_msgs.msg import Header
from visualization_msgs.msg import Marker

from hri_fullbody.ros.topics import skeleton_markers
from hri_pipeline.core.observations import BodyObservation

HEADER = Header(stamp=genpy.Time(12, 345), frame_id="camera")


def body(points, name="abcde"):
    return BodyObservation(name, np.array([0.0, 0, 4, 4]), 0.9, np.zeros((18, 3)), points)


def standing():
    points = np.full((18, 3), np.nan)
    points[[1, 2, 5]] = [(0.0, -0.5, 3.0), (-0.2, -0.5, 3.0), (0.2, -0.5, 3.0)]
    points[[0, 14, 15, 16, 17]] = [(0, -0.66, 2.86), (0.03, -0.7, 2.9), (-0.03, -0.7, 2.9),
                                   (0.08, -0.68, 3.0), (-0.08, -0.68, 3.0)]
    return points


def test_markers_join_known_points_only_and_expire():
    markers = skeleton_markers([body(standing())], HEADER)
    kinds = [marker.type for marker in markers]
    assert sorted(kinds) == sorted([Marker.LINE_LIST, Marker.SPHERE_LIST, Marker.LINE_LIST, Marker.SPHERE_LIST,
                                    Marker.SPHERE, Marker.TEXT_VIEW_FACING])
    assert len({marker.id for marker in markers}) == len(markers)
    for marker in markers:
        assert marker.header == HEADER and marker.ns == "abcde" and marker.action == Marker.ADD
        assert 0.0 < marker.lifetime.to_sec() <= 1.0
        assert np.linalg.norm([getattr(marker.pose.orientation, axis) for axis in "xyzw"]) == pytest.approx(1.0)
        assert all(np.isfinite([point.x, point.y, point.z]).all() for point in marker.points)
        assert marker.type != Marker.LINE_LIST or len(marker.points) % 2 == 0
        assert not marker.points or len(marker.colors) == len(marker.points)
    assert sum(len(marker.points) for marker in markers if marker.type == Marker.SPHERE_LIST) == 8


def test_left_limbs_are_red_and_right_ones_green():
    lines = skeleton_markers([body(standing())], HEADER)[0]
    assert lines.type == Marker.LINE_LIST
    colours = {round(point.x, 2): colour for point, colour in zip(lines.points, lines.colors) if point.x}
    right, left = colours[-0.2], colours[0.2]
    assert left.r > 2.0 * left.g and right.g > 2.0 * right.r


@pytest.mark.parametrize("labels, text", [(None, "abcde"), ({}, "abcde"), ({"other": "1.80 m"}, "abcde"),
                                          ({"abcde": "1.70 m, arms crossed"}, "abcde  1.70 m, arms crossed")])
def test_a_text_stands_below_the_body(labels, text):
    marker = next(marker for marker in skeleton_markers([body(standing())], HEADER, labels)
                  if marker.type == Marker.TEXT_VIEW_FACING)
    assert marker.text == text
    assert marker.pose.position.y > -0.5 + 0.05 and marker.pose.position.z == pytest.approx(2.95, abs=0.1)


@pytest.mark.parametrize("apart, overlaps", [(0.3, True), (2.0, False)])
def test_texts_of_neighbours_stand_below_one_another(apart, overlaps):
    bodies = [body(standing(), name="abcde"), body(standing() + (apart, 0.02, 0.0), name="fghij")]
    labels = {name: "1.70 m, sitting" for name in ("abcde", "fghij")}
    heights = [marker.pose.position.y for marker in skeleton_markers(bodies, HEADER, labels)
               if marker.type == Marker.TEXT_VIEW_FACING]
    # a line is 0.1 m high; who is 1 m behind is seen 0.12 m higher by the scene's camera, 7 degrees above the horizon
    assert (abs(heights[0] - heights[1]) > 0.22) == overlaps


def test_colour_hangs_on_the_id_and_unknown_bodies_have_no_markers():
    first, again, other = (skeleton_markers([body(standing(), name=name)], HEADER)[4].color
                           for name in ("abcde", "abcde", "fghij"))
    assert first == again != other
    assert skeleton_markers([body(np.full((18, 3), np.nan))], HEADER) == []
