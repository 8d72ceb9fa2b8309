"""What the command `check` reads of a camera_info: of which images it is, and whether it can be true."""

import pytest
from sensor_msgs.msg import CameraInfo, RegionOfInterest

from hri_pipeline.core.setup_check import CalibrationFacts
from hri_pipeline.nodes.check import calibration_facts

K = [900.0, 0, 640, 0, 900.0, 512, 0, 0, 1]


def info(**changes):
    return CameraInfo(width=1280, height=1024, K=changes.pop("K", K), distortion_model="plumb_bob", **changes)


@pytest.mark.parametrize("changes, size", [
    ({}, (1280, 1024)), ({"binning_x": 2, "binning_y": 2}, (640, 512)),
    ({"roi": RegionOfInterest(x_offset=100, y_offset=50, width=640, height=480)}, (640, 480)),
    ({"roi": RegionOfInterest(x_offset=100, y_offset=50, width=640, height=480), "binning_x": 2, "binning_y": 2},
     (320, 240))])
def test_the_size_is_that_of_the_images_with_binning_and_region_of_interest(changes, size):
    facts = calibration_facts(info(**changes))
    assert (facts.width, facts.height) == size
    assert facts.focal == pytest.approx(900.0 / max(1, changes.get("binning_x", 1))) and not facts.problem


def test_zero_k_is_told_by_its_focal_length():
    assert calibration_facts(info(K=[0.0] * 9)) == CalibrationFacts(1280, 1024, 0.0)
    assert calibration_facts(CameraInfo()).focal == 0.0


@pytest.mark.parametrize("changes, problem", [
    ({"K": [float("nan")] * 9}, "not finite"), ({"K": [-1.0, *K[1:]]}, "positive"),
    ({"D": [0.1] * 7}, "coefficients in D")])
def test_what_no_camera_has_is_told(changes, problem):
    assert problem in calibration_facts(info(**changes)).problem
