"""Frames of cameras that are mounted turned: decided once, and turned once."""

import genpy
import numpy as np
import pytest
from std_msgs.msg import Header

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces.parameters import FACES
from hri_pipeline.core.geometry import Pose
from hri_pipeline.ros import mounting
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
        self.half_turn = True

    def lookup(self, camera, stamp):
        sign = -1.0 if self.half_turn else 1.0
        return Pose(np.array([[0, 0, 1.0], [-sign, 0, 0], [0, -sign, 0]]), np.array([0.0, 0.0, 2.5]))

    def close(self):
        pass


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
    assert camera.status()[1] == ""
    camera.close()
    monkeypatch.setattr(mounting, "RobotTfListener", Robot)
    by_gravity = CameraMounting(FACES.resolve({"up_frame": "map"}), for_rotation_only=True)
    assert by_gravity.orient(frame(), {}).quarters == 2
