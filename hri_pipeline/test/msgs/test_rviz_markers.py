"""Markers of gazes and groups for rviz. Needs the message packages, no master."""

import math

import genpy
import numpy as np
import pytest
from std_msgs.msg import Header
from visualization_msgs.msg import Marker

from hri_pipeline.core.interactions.groups import Group
from hri_pipeline.core.interactions.people import GazeTarget, Observer
from hri_pipeline.ros.markers import MUTUAL, ONE_WAY, ShownMarkers, interaction_markers, make_marker

HEADER = Header(stamp=genpy.Time(12, 345), frame_id="map")
PEOPLE = [Observer("a", np.array([0.0, 0.0, 1.6])), Observer("b", np.array([1.0, 0.0, 1.7])),
          Observer("c", np.array([0.5, 1.0, 1.5])), Observer("nowhere")]
GROUP = Group("trio", ("a", "b", "c"), 0.8, np.array([0.5, 0.3]))


def by_name(markers, name):
    return [marker for marker in markers if marker.ns == name and marker.action == Marker.ADD]


def ends(marker):
    return [np.array([point.x, point.y, point.z]) for point in marker.points]


def colour(marker):
    return marker.color.r, marker.color.g, marker.color.b


def test_an_arrow_leads_from_the_sender_to_the_receiver_outside_of_the_heads():
    arrow, = by_name(interaction_markers(PEOPLE, [GazeTarget("a", "b", 0.9)], [], HEADER), "gaze")
    start, end = ends(arrow)
    assert arrow.type == Marker.ARROW and colour(arrow) == pytest.approx(ONE_WAY)
    assert 0.05 < np.linalg.norm(start - PEOPLE[0].head) < 0.3
    assert 0.05 < np.linalg.norm(end - PEOPLE[1].head) < 0.3
    assert start[0] < end[0]


def test_two_gazes_that_meet_have_another_colour_and_do_not_cover_each_other():
    gazes = [GazeTarget("a", "b", 0.9), GazeTarget("b", "a", 0.9), GazeTarget("c", "a", 0.9)]
    arrows = by_name(interaction_markers(PEOPLE, gazes, [], HEADER), "gaze")
    assert [colour(arrow) for arrow in arrows] == [pytest.approx(MUTUAL), pytest.approx(MUTUAL), pytest.approx(ONE_WAY)]
    first, second = (ends(arrow) for arrow in arrows[:2])
    assert abs(first[0][1] - second[0][1]) > 0.05


def test_a_less_certain_gaze_is_fainter():
    (sure,), (unsure,) = ([marker.color.a for marker in interaction_markers(
        PEOPLE, [GazeTarget("a", "b", confidence)], [], HEADER)] for confidence in (1.0, 0.4))
    assert sure == pytest.approx(1.0) and 0.3 < unsure < 0.8


def test_gazes_without_a_place_are_left_out_and_those_at_the_robot_need_it():
    gazes = [GazeTarget("a", "nowhere", 0.9), GazeTarget("nowhere", "a", 0.9), GazeTarget("b", "stranger", 0.9),
             GazeTarget("c", "", 0.9)]
    assert not interaction_markers(PEOPLE, gazes, [], HEADER)
    arrow, = interaction_markers(PEOPLE, gazes, [], HEADER, robot=np.array([3.0, 0.0, 1.0]))
    assert ends(arrow)[1][0] > 2.5
    assert not interaction_markers(PEOPLE, gazes, [], HEADER, robot=np.array([3.0, math.nan, 1.0]))


def test_a_group_is_a_disc_on_the_floor_with_lines_to_its_members_and_a_text():
    array = interaction_markers(PEOPLE, [], [GROUP], HEADER)
    disc, = by_name(array, "o-space")
    assert disc.type == Marker.CYLINDER and (disc.pose.position.x, disc.pose.position.y) == (0.5, 0.3)
    assert 0.0 <= disc.pose.position.z <= 0.05 and 0.7 <= disc.scale.x == disc.scale.y <= 2.0
    lines, = by_name(array, "members")
    points = ends(lines)
    assert len(points) == 6 and all(abs(point[2]) < 0.1 for point in points)
    assert {tuple(np.round(point[:2], 3)) for point in points[1::2]} == {(0.0, 0.0), (1.0, 0.0), (0.5, 1.0)}
    poles, = by_name(array, "poles")
    assert {round(point.z, 3) for point in poles.points} == {0.0, 1.5, 1.6, 1.7}
    text, = by_name(array, "group")
    assert text.text == "trio (3)" and text.pose.position.z > disc.pose.position.z


def test_a_member_without_a_place_has_no_line_and_a_group_of_such_no_marker():
    group = Group("duo", ("a", "nowhere"), 0.8, np.array([0.5, 0.3]))
    assert len(by_name(interaction_markers(PEOPLE, [], [group], HEADER), "members")[0].points) == 2
    assert not interaction_markers([], [], [group], HEADER)
    broken = Group("duo", ("a", "b"), 0.8, np.array([math.nan, 0.3]))
    assert not interaction_markers(PEOPLE, [], [broken], HEADER)


def test_the_robot_as_a_member_has_a_line():
    group = Group("duo", ("", "a"), 0.8, np.array([0.5, 0.3]))
    array = interaction_markers(PEOPLE, [], [group], HEADER, robot=np.array([2.0, 0.0, 1.1]))
    assert by_name(array, "group")[0].text == "duo (1 + robot)"
    lines, = by_name(array, "members")
    assert len(lines.points) == 4


def test_the_floor_lies_below_heads_that_are_low():
    low = [Observer("a", np.array([0.0, 0.0, 0.1])), Observer("b", np.array([1.0, 0.0, 0.0]))]
    group = Group("duo", ("a", "b"), 0.8, np.array([0.5, 0.0]))
    assert by_name(interaction_markers(low, [], [group], HEADER), "o-space")[0].pose.position.z < -1.0


def test_every_marker_is_legal_and_expires():
    gazes = [GazeTarget("a", "b", 0.9), GazeTarget("b", "a", math.nan)]
    array = interaction_markers(PEOPLE, gazes, [GROUP, Group("duo", ("a", "b"), 0.5, np.array([0.5, -0.3]))], HEADER)
    assert len({(marker.ns, marker.id) for marker in array}) == len(array) == 2 + 2 * 5
    for marker in array:
        assert marker.header.frame_id == "map" and marker.header.stamp.is_zero()
        assert 0.0 < marker.lifetime.to_sec() <= 1.0
        assert 0.0 < marker.color.a <= 1.0
        assert np.linalg.norm([getattr(marker.pose.orientation, axis) for axis in "xyzw"]) == pytest.approx(1.0)


def test_what_is_gone_is_deleted_once():
    shown = ShownMarkers()
    first = [make_marker(HEADER, name, number, Marker.SPHERE) for name, number in (("a", 0), ("a", 1), ("b", 0))]
    assert shown.update(first, HEADER).markers == first
    second = shown.update(first[:1], HEADER).markers
    assert {(marker.ns, marker.id) for marker in second if marker.action == Marker.DELETE} == {("a", 1), ("b", 0)}
    assert second[2:] == first[:1] and all(marker.header == HEADER for marker in second)
    assert [marker.action for marker in shown.update([], HEADER).markers] == [Marker.DELETE]
    assert not shown.update([], HEADER).markers
