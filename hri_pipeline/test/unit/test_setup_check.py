"""From facts about a set-up to words: each fault is named, and nothing else is."""

from dataclasses import replace

import pytest

from hri_pipeline.core.setup_check import (
    CHECK_PARAMETERS,
    FAULT,
    HINT,
    NO_IMAGE_YET,
    CalibrationFacts,
    Facts,
    Picture,
    Stream,
    as_text,
    check,
    is_well,
    own_cameras,
    stand_ins,
)

SETTINGS = CHECK_PARAMETERS.resolve({})
IMAGE = Stream("/camera/image_raw", "sensor_msgs/Image", ("sensor_msgs/Image", ), ("/camera", ), (), 90, 30.0, 0.03,
               "optical")
INFO = Stream("/camera/camera_info", "sensor_msgs/CameraInfo", ("sensor_msgs/CameraInfo", ), ("/camera", ), (), 90,
              30.0, 0.03,
              "optical")
WELL = Facts(nodes={"hri_faces": "running", "hri_person_manager": "running"}, image=IMAGE, info=INFO,
             picture=Picture(1280, 720, "bgr8", "", 110.0, 50.0), calibration=CalibrationFacts(1280, 720, 900.0),
             camera_frame="optical", tf_reaches=True, models_directory="models",
             statuses={"hri_faces: input": (0, "fine")},
             tracked={"faces": 2, "persons": 2})


def image(**changes):
    return replace(WELL, image=replace(IMAGE, **changes))


def test_a_good_set_up_has_no_fault():
    findings = check(WELL, SETTINGS)
    assert is_well(findings) and not [finding for finding in findings if finding.level == HINT]
    assert "2 persons tracked now" in as_text(findings) and as_text(findings).endswith("no faults found")


def test_nodes_of_other_names_are_known_by_their_topics():
    published = {"/humans/faces/tracked": ["/front/eyes"],
                 "/humans/bodies/tracked": ["/front/eyes", "/side/hri_bodies"],
                 "/humans/candidate_matches": ["/front/eyes", "/pairs"], "/humans/persons/tracked": ["/us"]}
    subscribed = {"/humans/faces/tracked": ["/pairs", "/us"], "/humans/bodies/tracked": ["/pairs", "/us"]}
    wanted = ("hri_faces", "hri_bodies", "hri_face_body_matcher", "hri_person_manager", "voices")
    assert [stand_ins(name, published, subscribed) for name in wanted] == [
        ["/front/eyes"], ["/front/eyes", "/side/hri_bodies"], ["/pairs"], ["/us"], []]
    assert [stand_ins(name, {}, subscribed) for name in wanted] == [[]] * 5


def test_who_is_its_own_camera_needs_no_images_and_no_matcher():
    lists = ("/humans/faces/tracked", "/humans/bodies/tracked", "/humans/candidate_matches")
    published = {topic: ["/simulator", "/eyes"] for topic in lists}
    published["/camera/color/camera_info"] = ["/simulator", "/driver"]
    assert own_cameras(published) == {"/simulator"} and own_cameras({}) == set()
    assert stand_ins("hri_face_body_matcher", published, {}) == ["/simulator"]
    alone = replace(image(publishers=(), types=(), messages=0), nodes={"simulator": "running"}, picture=None)
    assert not is_well(check(alone, SETTINGS))
    assert is_well(check(replace(alone, own_cameras=("simulator", )), SETTINGS))
    assert not is_well(check(replace(alone, own_cameras=("simulator", ),
                                     nodes={"simulator": "running", "eyes": "running"}), SETTINGS))


def test_who_stands_for_a_node_is_told():
    found = check(replace(WELL, nodes={"eyes": "running"}, stand_ins={"hri_faces": ("eyes", )}), SETTINGS)
    assert is_well(found) and "eyes stands for hri_faces" in as_text(found)


def test_nobody_in_view_is_no_fault():
    assert is_well(check(replace(WELL, tracked={"faces": 0, "persons": 0}), SETTINGS))


@pytest.mark.parametrize("facts, words", [
    (image(types=(), publishers=(), messages=0), ["nobody publishes /camera/image_raw", "image:="]),
    (image(types=("sensor_msgs/CompressedImage", ), messages=0),
     ["is a sensor_msgs/CompressedImage", "image_transport:=compressed"]),
    (image(types=("std_msgs/String", ), messages=0), ["is a std_msgs/String, not a sensor_msgs/Image"]),
    (image(unreachable=("/camera", ), messages=0), ["cannot be reached", "ROS_IP"]),
    (image(messages=0), ["has a publisher (/camera), but nothing comes"]),
    (image(age=7.5), ["7.5 s old", "clocks"]),
    (replace(image(age=1.8e9 - 3.0), time=1.8e9, wall_time=1.8e9),
     ["stamped by simulated time (3.0 s)", "/use_sim_time true"]),
    (replace(image(age=3.0 - 1.8e9), time=3.0, wall_time=1.8e9, sim_time=True, clock_messages=9),
     ["stamped by the wall clock", "/use_sim_time false"]),
    (image(age=-3.0), ["3.0 s in the future"]),
    (image(frame=""), ["no frame_id"]),
    (replace(WELL, picture=Picture(encoding="jpeg2000", problem="encoding 'jpeg2000' is not supported")),
     ["jpeg2000", "bgr8"]),
    (replace(WELL, picture=Picture(1280, 720, "bgr8", "", 4.0, 3.0)), ["too dark", "light"]),
    (replace(WELL, picture=Picture(1280, 720, "bgr8", "", 128.0, 0.4)), ["shows nothing", "lens"]),
    (replace(WELL, calibration=CalibrationFacts(1280, 720, 0.0)), ["not calibrated", "cameracalibrator"]),
    (replace(WELL, calibration=CalibrationFacts(640, 480, 500.0)), ["is for 640x480 px, images are 1280x720"]),
    (replace(WELL, tf_reaches=False), ["no transform leads from the camera (optical) to the reference frame map"]),
    (replace(WELL, sim_time=True), ["nobody publishes /clock", "--clock"]),
    (replace(WELL, sim_time=True, clock_messages=99, clocks=("/play_1", "/play_2")),
     ["2 nodes publish /clock (/play_1, /play_2)", "rosbag play --clock"]),
    (replace(WELL, models_missing=("pose.onnx", )), ["pose.onnx", "fetch_models"]),
    (replace(WELL, nodes={"hri_faces": "absent"}), ["hri_faces does not run"]),
    (replace(WELL, nodes={"hri_faces": "absent"}, publishing=("/robot1/hri_faces", "/robot1/hri_bodies")),
     ["does not run here, but /robot1/hri_faces", "ROS_NAMESPACE=/robot1 rosrun"]),
    (replace(WELL, managers=("/hri_person_manager", "/robot1/hri_person_manager")),
     ["2 person managers", "/robot1/hri_person_manager", "persons:=false"]),
    (replace(WELL, nodes={"hri_faces": "dead"}), ["hri_faces is registered, but does not answer", "rosnode cleanup"]),
    (replace(WELL, statuses={"hri_faces: faces": (2, "everything is broken")}),
     ["hri_faces: faces: everything is broken"]),
    (replace(WELL, tracked={"faces": 2, "bodies": 1, "persons": 0}), ["2 faces and 1 bodies are tracked, but no "
                                                                      "person"]),
])
def test_each_fault_is_named_and_nothing_else(facts, words):
    faults = [finding for finding in check(facts, SETTINGS) if finding.level == FAULT]
    assert len(faults) == 1
    told = faults[0].what + " -> " + faults[0].hint
    assert all(word in told for word in words), told


@pytest.mark.parametrize("space", ["", "/", "/robot1/"])
def test_without_bodies_no_matcher_is_missed_and_the_remedy_names_who_runs(space):
    def named(**nodes):
        return replace(WELL, nodes={space + name: state for name, state in nodes.items()})

    nodes = {"hri_faces": "running", "hri_bodies": "absent", "hri_face_body_matcher": "absent",
             "hri_person_manager": "running"}
    fault, = [finding for finding in check(named(**nodes), SETTINGS) if finding.level == FAULT]
    assert "hri_bodies does not run" in fault.what
    assert fault.hint.endswith('_nodes:="[{0}hri_faces, {0}hri_person_manager]"'.format(space))
    matcher, = [finding for finding in check(named(**dict(nodes, hri_bodies="running")), SETTINGS)
                if finding.level == FAULT]
    assert "hri_face_body_matcher does not run" in matcher.what


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
    assert is_well(check(replace(WELL, sim_time=True, clock_messages=100, clocks=("/play",)), SETTINGS))


NO_CAMERA = image(types=(), publishers=(), messages=0, frame="")
NO_CAMERA = replace(NO_CAMERA, picture=None, calibration=None, camera_frame="", tracked={}, statuses={
    "hri_faces: input": (2, "no publisher on /camera/image_raw for 12 s; start the camera or remap `image`"),
    "hri_faces: pipeline": (1, NO_IMAGE_YET),
    "hri_faces: faces": (1, "the processor is too slow"),
    "hri_bodies: input": (2, "no publisher on /camera/image_raw for 9 s; start the camera or remap `image`"),
    "hri_bodies: pipeline": (1, NO_IMAGE_YET)})


def test_what_follows_from_a_silent_camera_stands_below_it():
    findings = check(NO_CAMERA, SETTINGS)
    assert [finding.what for finding in findings if finding.level == FAULT] == ["nobody publishes /camera/image_raw"]
    assert [finding.what for finding in findings if finding.level == HINT] == ["hri_faces: faces: the processor is too "
                                                                               "slow"]
    lines = as_text(findings).split("\n")
    fault = lines.index("FAULT  nobody publishes /camera/image_raw")
    assert lines[fault + 1].startswith("       -> start the camera")
    assert lines[fault + 2:fault + 4] == [
        "       hence  hri_bodies: input: no publisher on /camera/image_raw for 9 s; pipeline: no image yet",
        "       hence  hri_faces: input: no publisher on /camera/image_raw for 12 s; pipeline: no image yet"]
    assert lines[-1] == "1 fault found"


def test_who_has_no_camera_is_told_how_to_leave_all_that_sees_out_and_then_nothing_of_images():
    voices = {"hri_voices: input": (0, "sound comes in")}
    heard = Facts(nodes={"hri_faces": "absent", "hri_bodies": "absent", "hri_face_body_matcher": "running",
                         "hri_person_manager": "running"}, publishing=("/hri_person_manager", "/hri_voices"),
                  image=Stream("/image", "sensor_msgs/Image"), info=Stream("/camera_info", "sensor_msgs/CameraInfo"),
                  models_directory="models", statuses=voices, tracked={"voices": 1, "persons": 1})
    faults = [finding for finding in check(heard, SETTINGS) if finding.level == FAULT]
    mends = [finding.hint for finding in faults if "does not run" in finding.what]
    assert len(mends) == 2
    assert all("_nodes:=\"[hri_face_body_matcher, hri_person_manager]\"" in mend for mend in mends)
    followed = replace(heard, nodes={name: state for name, state in heard.nodes.items() if state == "running"})
    assert is_well(check(followed, SETTINGS)), as_text(check(followed, SETTINGS))
    eyes = replace(followed, nodes={**followed.nodes, "eyes": "running"})
    assert any("nobody publishes /image" in finding.what for finding in check(eyes, SETTINGS))


def test_the_calibration_of_another_camera_is_a_hint():
    found, = [finding for finding in check(replace(WELL, info=replace(INFO, frame="depth_optical")), SETTINGS)
              if finding.level > 0]
    assert found.level == HINT and "depth_optical" in found.what and "images are in optical" in found.what
    assert "camera_info:=" in found.hint
    for frames in (("", "optical"), ("depth_optical", "")):
        facts = replace(WELL, info=replace(INFO, frame=frames[0]), image=replace(IMAGE, frame=frames[1]))
        assert not [finding for finding in check(facts, SETTINGS) if "camera_info is of" in finding.what]


def test_a_node_with_another_topic_keeps_its_own_fault():
    other = {"hri_faces: input": (2, "no publisher on /camera/image_raw/left for 12 s; start the camera"),
             "hri_faces: pipeline": (1, NO_IMAGE_YET)}
    findings = check(replace(NO_CAMERA, statuses=other), SETTINGS)
    assert sum(finding.level == FAULT for finding in findings) == 2
    assert [finding.what for finding in findings if finding.level == HINT] == ["hri_faces: pipeline: " + NO_IMAGE_YET]


@pytest.mark.parametrize("wanted, there, transport", [
    ("/camera/image_raw", "/camera/image_raw/compressed", "compressed"),
    ("/camera/image_raw/compressed", "/camera/image_raw", "raw")])
def test_images_of_the_other_transport_are_told_with_what_to_set(wanted, there, transport):
    stream = Stream(wanted, "sensor_msgs/Image", other=there)
    found, = [finding for finding in check(replace(WELL, image=stream, picture=None), SETTINGS) if finding.level > 0]
    assert found.what == "nobody publishes {}, but {} is published".format(wanted, there)
    assert found.hint == "start with image_transport:={}".format(transport)


@pytest.mark.parametrize("facts, status, count", [
    (replace(WELL, picture=Picture(encoding="x", problem="encoding 'x' is not supported")),
     (2, "/camera/image_raw: encoding 'x' is not supported"), 1),
    (replace(WELL, calibration=CalibrationFacts(1280, 720, 0.0)), (1, "/camera/camera_info: K is all zero; give "
                                                                      "fallback_fov"), 1),
    (replace(WELL, info=replace(INFO, types=(), publishers=(), messages=0), calibration=None),
     (1, "no camera_info on /camera/camera_info: remap it"), 1),
    (replace(WELL, picture=Picture(1280, 720, "bgr8", "", 4.0, 3.0)),
     (1, "/camera/image_raw: /left, /right send too, only /left is heard"), 2),
    (image(rate=1.0), (2, "/camera/image_raw: broken"), 2),
    (replace(WELL, info=replace(INFO, frame="depth_optical")),
     (1, "/camera/camera_info: it is of the frame 'depth_optical', images are in 'optical'"), 1),
    (replace(WELL, calibration=CalibrationFacts(1280, 720, 900.0, "K holds numbers that are not finite")),
     (1, "/camera/camera_info: K holds numbers that are not finite"), 1),
])
def test_the_same_fault_is_told_once_and_others_are_not_hidden(facts, status, count):
    findings = check(replace(facts, statuses={"hri_faces: input": status}), SETTINGS)
    assert sum(finding.level > 0 for finding in findings) == count


NOTHING = Facts(nodes={name: "absent" for name in SETTINGS.nodes}, image=Stream("/image", "sensor_msgs/Image"),
                info=Stream("/camera_info", "sensor_msgs/CameraInfo"), models_directory="models")


def test_where_nothing_of_the_stack_runs_the_first_line_says_so_and_nothing_else():
    text = as_text(check(NOTHING, SETTINGS)).split("\n")
    assert text == ["FAULT  nothing of ros4hri runs on this master", "       -> roslaunch ros4hri ros4hri.launch",
                    "1 fault found"]


def test_what_will_be_in_the_way_of_a_stack_that_does_not_run_is_told():
    findings = check(replace(NOTHING, image=IMAGE, info=INFO, picture=WELL.picture,
                             calibration=CalibrationFacts(1280, 720, 0.0),
                             models_missing=("pose.onnx", )), SETTINGS)
    assert findings[0].what == "nothing of ros4hri runs on this master"
    assert [word in as_text(findings)
            for word in ("pose.onnx", "not calibrated", "nobody is tracked")] == [True, True, False]


def test_other_nodes_of_the_stack_are_something():
    findings = check(replace(NOTHING, publishing=("/robot/hri_faces", )), SETTINGS)
    assert [finding.what for finding in findings if "does not run" in finding.what] == [
        "the node {} does not run{}".format(name, " here, but /robot/hri_faces" if name == "hri_faces" else "")
        for name in SETTINGS.nodes]


def test_a_node_that_is_meant_to_be_off_is_left_out_by_a_command():
    nodes = {"hri_faces": "running", "hri_bodies": "absent", "hri_person_manager": "running"}
    hint = [finding.hint for finding in check(replace(WELL, nodes=nodes), SETTINGS) if finding.level == FAULT][0]
    assert "rosrun hri_pipeline check _nodes:=\"[hri_faces, hri_person_manager]\"" in hint
