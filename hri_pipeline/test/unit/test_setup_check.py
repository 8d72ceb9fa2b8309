"""From facts about a set-up to words: each fault is named, and nothing else is."""

from dataclasses import replace

import pytest

from hri_pipeline.core.setup.check_parameters import CHECK_PARAMETERS
from hri_pipeline.core.setup.setup_check import FAULT, HINT, as_text, check, is_well
from hri_pipeline.core.setup.setup_facts import Calibration, Facts, Picture, Stream

SETTINGS = CHECK_PARAMETERS.resolve({})
IMAGE = Stream("/camera/image_raw", "sensor_msgs/Image", ("sensor_msgs/Image", ), ("/camera", ), (), 90, 30.0, 0.03, "optical")
INFO = Stream("/camera/camera_info", "sensor_msgs/CameraInfo", ("sensor_msgs/CameraInfo", ), ("/camera", ), (), 90, 30.0, 0.03,
              "optical")
WELL = Facts(nodes={"hri_faces": "running", "hri_person_manager": "running"}, image=IMAGE, info=INFO,
             picture=Picture(1280, 720, "bgr8", "", 110.0, 50.0), calibration=Calibration(1280, 720, 900.0),
             camera_frame="optical", tf_reaches=True, models_directory="models", statuses={"hri_faces: input": (0, "fine")},
             tracked={"faces": 2, "persons": 2})


def image(**changes):
    return replace(WELL, image=replace(IMAGE, **changes))


def test_a_good_set_up_has_no_fault():
    findings = check(WELL, SETTINGS)
    assert is_well(findings) and not [finding for finding in findings if finding.level == HINT]
    assert "2 persons tracked now" in as_text(findings) and as_text(findings).endswith("no faults found")


def test_nobody_in_view_is_no_fault():
    assert is_well(check(replace(WELL, tracked={"faces": 0, "persons": 0}), SETTINGS))


@pytest.mark.parametrize("facts, words", [
    (image(types=(), publishers=(), messages=0), ["nobody publishes /camera/image_raw", "image:="]),
    (image(types=("sensor_msgs/CompressedImage", ), messages=0), ["is a sensor_msgs/CompressedImage", "image_transport:=compressed"]),
    (image(types=("std_msgs/String", ), messages=0), ["is a std_msgs/String, not a sensor_msgs/Image"]),
    (image(unreachable=("/camera", ), messages=0), ["cannot be reached", "ROS_IP"]),
    (image(messages=0), ["has a publisher (/camera), but nothing comes"]),
    (image(age=7.5), ["7.5 s old", "clocks"]),
    (image(age=-3.0), ["3.0 s in the future"]),
    (image(frame=""), ["no frame_id"]),
    (replace(WELL, picture=Picture(encoding="jpeg2000", problem="encoding 'jpeg2000' is not supported")), ["jpeg2000", "bgr8"]),
    (replace(WELL, picture=Picture(1280, 720, "bgr8", "", 4.0, 3.0)), ["too dark", "light"]),
    (replace(WELL, picture=Picture(1280, 720, "bgr8", "", 128.0, 0.4)), ["shows nothing", "lens"]),
    (replace(WELL, calibration=Calibration(1280, 720, 0.0)), ["not calibrated", "cameracalibrator"]),
    (replace(WELL, calibration=Calibration(640, 480, 500.0)), ["is for 640x480 px, images are 1280x720"]),
    (replace(WELL, tf_reaches=False), ["no transform leads from the camera (optical) to the reference frame map"]),
    (replace(WELL, sim_time=True), ["nobody publishes /clock", "--clock"]),
    (replace(WELL, models_missing=("pose.onnx", )), ["pose.onnx", "fetch_models"]),
    (replace(WELL, nodes={"hri_faces": "absent"}), ["hri_faces does not run"]),
    (replace(WELL, nodes={"hri_faces": "dead"}), ["hri_faces is registered, but does not answer", "rosnode cleanup"]),
    (replace(WELL, statuses={"hri_faces: faces": (2, "everything is broken")}), ["hri_faces: faces: everything is broken"]),
    (replace(WELL, tracked={"faces": 2, "bodies": 1, "persons": 0}), ["2 faces and 1 bodies are tracked, but no person"]),
])
def test_each_fault_is_named_and_nothing_else(facts, words):
    faults = [finding for finding in check(facts, SETTINGS) if finding.level == FAULT]
    assert len(faults) == 1
    told = faults[0].what + " -> " + faults[0].mend
    assert all(word in told for word in words), told


@pytest.mark.parametrize("facts, word", [
    (image(rate=1.0), "1.0 images/s only"),
    (replace(WELL, info=replace(INFO, types=(), publishers=(), messages=0), calibration=None), "distances are guessed"),
    (replace(WELL, statuses={"hri_faces: faces": (1, "slow")}), "slow"),
])
def test_what_still_works_is_a_hint(facts, word):
    findings = check(facts, SETTINGS)
    assert is_well(findings)
    assert any(finding.level == HINT and word in finding.what for finding in findings)


def test_simulated_time_that_runs_is_fine():
    assert is_well(check(replace(WELL, sim_time=True, clock_messages=100), SETTINGS))
