"""What the body branch makes of observations: transforms and markers. Needs the message packages, no master."""

import genpy
import numpy as np
import pytest
from std_msgs.msg import Header
from visualization_msgs.msg import Marker

from hri_fullbody.ros.body_branch import body_transforms
from hri_fullbody.ros.skeleton_markers import skeleton_markers
from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.observations import BodyObservation
from hri_pipeline.ros.conversions import pose_from_transform
from hri_pipeline.ros.image_intake import Frame

HEADER = Header(stamp=genpy.Time(12, 345), frame_id="camera")
FRAME = Frame(np.zeros((4, 4, 3), np.uint8), CameraModel.from_fov(4, 4, 1.0), 12.000000345, HEADER)
FACING = np.array([[0.0, 1, 0], [0, 0, -1], [-1, 0, 0]])


def body(points, pose=None, name="abcde"):
    return BodyObservation(name, np.array([0.0, 0, 4, 4]), 0.9, np.zeros((18, 3)), points, pose)


def standing():
    points = np.full((18, 3), np.nan)
    points[[1, 2, 5]] = [(0.0, -0.5, 3.0), (-0.2, -0.5, 3.0), (0.2, -0.5, 3.0)]
    points[[0, 14, 15, 16, 17]] = [(0, -0.66, 2.86), (0.03, -0.7, 2.9), (-0.03, -0.7, 2.9),
                                      (0.08, -0.68, 3.0), (-0.08, -0.68, 3.0)]
    return points


def test_body_and_head_have_the_stamp_and_frame_of_the_image():
    transforms = body_transforms(body(standing(), Pose(FACING, np.array([0.0, 0.0, 3.0]))), FRAME)
    assert [(item.header.frame_id, item.child_frame_id) for item in transforms] == [
        ("camera", "body_abcde"), ("body_abcde", "head_abcde")]
    assert all(item.header.stamp == HEADER.stamp for item in transforms)
    head = pose_from_transform(transforms[0]).compose(pose_from_transform(transforms[1]))
    assert head.translation == pytest.approx([0.0, -0.7, 2.9])


def test_what_is_not_known_has_no_frame():
    assert body_transforms(body(standing()), FRAME) == []
    headless = np.full((18, 3), np.nan)
    transforms = body_transforms(body(headless, Pose(FACING, np.array([0.0, 0.0, 3.0]))), FRAME)
    assert [item.child_frame_id for item in transforms] == ["body_abcde"]


def test_markers_join_known_points_only_and_expire():
    markers = skeleton_markers([body(standing())], HEADER).markers
    lines, joints = markers
    assert (lines.type, joints.type) == (Marker.LINE_LIST, Marker.SPHERE_LIST)
    assert len(lines.points) % 2 == 0 and len(joints.points) == 8
    assert all(marker.header == HEADER and marker.ns == "abcde" for marker in markers)
    assert all(0.0 < marker.lifetime.to_sec() <= 1.0 and marker.pose.orientation.w == 1.0 for marker in markers)
    assert all(np.isfinite([point.x, point.y, point.z]).all() for marker in markers for point in marker.points)


def test_colour_hangs_on_the_id_and_unknown_bodies_have_no_markers():
    first, again, other = (skeleton_markers([body(standing(), name=name)], HEADER).markers[0].color
                           for name in ("abcde", "abcde", "fghij"))
    assert first == again != other
    assert skeleton_markers([body(np.full((18, 3), np.nan))], HEADER).markers == []
