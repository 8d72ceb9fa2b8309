"""Frames of cameras that are mounted turned: decided once, and turned once."""

from types import SimpleNamespace
from unittest.mock import MagicMock

import genpy
import numpy as np
import pytest
from std_msgs.msg import Header

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces.parameters import FACES
from hri_pipeline.core.geometry import Pose
from hri_pipeline.ros import mounting
from hri_pipeline.ros.diagnostics import OK, WARN
from hri_pipeline.ros.image_input import Frame
from hri_pipeline.ros.mounting import UP, CameraMounting

HEADER = Header(stamp=genpy.Time(12, 0), frame_id="camera")
IMAGE = np.random.default_rng(1).integers(0, 255, (6, 8, 3)).astype(np.uint8)
DEPTH = np.arange(12.0).reshape(3, 4)


def frame(depth=DEPTH):
    return Frame(IMAGE, CameraModel.from_fov(8, 6, 1.0), 12.0, HEADER, depth)


class Robot:
    """Transforms of a camera that rolls; rolled by `roll` half turns."""

    def __init__(self, name):
        assert name == "map"
        self.half_turn, self.is_known, self.height, self.is_closed = True, True, 2.5, False

    def lookup(self, camera, stamp):
        assert camera == "camera"
        if not self.is_known:
            return None
        sign = -1.0 if self.half_turn else 1.0
        return Pose(np.array([[0, 0, 1.0], [-sign, 0, 0], [0, -sign, 0]]), np.array([0.0, 0.0, self.height]))

    def close(self):
        self.is_closed = True


@pytest.mark.parametrize("quarters", [0, 1, 2, 3])
def test_image_camera_and_depth_are_turned_together(quarters):
    oriented = CameraMounting(FACES.resolve({"image_rotation": 90 * quarters})).orient(frame(), {})
    upright = oriented.upright
    assert np.array_equal(upright.bgr, np.rot90(IMAGE, -quarters))
    assert np.array_equal(upright.depth, np.rot90(DEPTH, -quarters))
    assert (upright.camera.width, upright.camera.height) == upright.bgr.shape[1::-1]
    assert oriented.bgr is IMAGE and oriented.upright is upright and upright.upright is upright
    assert (upright is oriented) == (upright.bgr is IMAGE) == (quarters == 0)
    assert frame(None).upright.depth is None


def test_gravity_decides_at_the_time_of_the_image(monkeypatch):
    monkeypatch.setattr(mounting, "RobotTfListener", Robot)
    camera, context = CameraMounting(FACES.resolve({"up_frame": "map"})), {}
    assert camera.orient(frame(), context).quarters == 2
    up, height, pose = context[UP]
    assert up == pytest.approx([0.0, 1.0, 0.0]) and height == 2.5 and pose.translation == pytest.approx([0, 0, 2.5])
    assert camera.values() == {"image_rotation_deg": 180, "image_rotation_by": "up_frame"}
    camera._up._frames.half_turn = False
    assert camera.orient(frame(), context).quarters == 0
    fixed = CameraMounting(FACES.resolve({"up_frame": "map", "image_rotation": "90"}))
    assert fixed.orient(frame(), {}).quarters == 1 and fixed.values()["image_rotation_by"] == "parameter"


def test_while_no_transform_leads_to_up_frame_images_stay_turned_and_that_is_told_after_three_seconds(monkeypatch):
    clock, ros = [0.0], MagicMock()
    monkeypatch.setattr(mounting, "RobotTfListener", Robot)
    monkeypatch.setattr(mounting, "time", SimpleNamespace(monotonic=lambda: clock[0]))
    monkeypatch.setattr(mounting, "rospy", ros)
    camera, context = CameraMounting(FACES.resolve({"up_frame": "map"})), {}
    robot = camera._up._frames
    for lost_at in (0.0, 100.0):
        robot.is_known, clock[0] = True, lost_at
        assert camera.orient(frame(), context).quarters == 2 and camera.status() == (OK, "")
        robot.is_known = False
        for later, level in ((0.1, OK), (2.9, OK), (3.2, WARN), (9.0, WARN)):
            clock[0] = lost_at + later
            assert camera.orient(frame(), context).quarters == 2 and context[UP] == (None, None, None)
            assert camera.status()[0] == level and ("map" in camera.status()[1]) == (level == WARN)
    assert ros.logwarn.call_count == 1 and "from camera to ~up_frame map" in str(ros.logwarn.call_args)
    assert [call[0][1] for call in ros.loginfo.call_args_list] == [180]


def test_an_image_without_frame_has_no_mounting_and_a_height_of_no_camera_is_none(monkeypatch):
    monkeypatch.setattr(mounting, "RobotTfListener", Robot)
    camera, context = CameraMounting(FACES.resolve({"up_frame": "map"})), {}
    for height, told in ((0.04, None), (0.06, 0.06), (9.9, 9.9), (10.1, None), (-1.0, None)):
        camera._up._frames.height = height
        camera.orient(frame(), context)
        assert context[UP][1] == told
    nameless = Frame(IMAGE, CameraModel.from_fov(8, 6, 1.0), 12.0, Header(stamp=genpy.Time(12, 0)))
    camera.orient(nameless, context)
    assert context[UP] == (None, None, None)
    camera.close()
    assert camera._up._frames.is_closed


def test_without_up_frame_nothing_is_turned_and_nothing_listened_to(monkeypatch):
    monkeypatch.setattr(mounting, "RobotTfListener", None)
    camera, context = CameraMounting(FACES.resolve({})), {}
    assert camera.orient(frame(), context).quarters == 0 and context[UP] == (None, None, None)
    assert camera.values()["image_rotation_by"] == "auto, without up_frame"


def test_with_a_fixed_turn_faces_need_no_transform_and_listen_to_none(monkeypatch):
    monkeypatch.setattr(mounting, "RobotTfListener", None)
    settings = FACES.resolve({"up_frame": "map", "image_rotation": "90"})
    camera, context = CameraMounting(settings, for_rotation_only=True), {}
    assert camera.orient(frame(), context).quarters == 1 and context[UP] == (None, None, None)
    assert camera.status() == (OK, "")
    camera.close()
    monkeypatch.setattr(mounting, "RobotTfListener", Robot)
    by_gravity = CameraMounting(FACES.resolve({"up_frame": "map"}), for_rotation_only=True)
    assert by_gravity.orient(frame(), {}).quarters == 2
