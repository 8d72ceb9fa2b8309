"""Messages to arrays and back."""

import copy
import io
import pickle

import cv2
import genpy
import numpy as np
import pytest
import rosbag
from geometry_msgs.msg import TransformStamped
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_msgs.msg import Header, String
from wire_layouts import serialise

from benchmarks.report import least_cost
from hri_msgs.msg import (
    AudioFeatures,
    Expression,
    FacialActionUnits,
    FacialLandmarks,
    IdsMatch,
    LiveSpeech,
    Skeleton2D,
    SoftBiometrics,
)
from hri_pipeline.core.asr.recognition import SpeechResult
from hri_pipeline.core.audio.features import FeatureFrame
from hri_pipeline.core.camera import Calibration, CameraError
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.images import ImageError
from hri_pipeline.core.observations import SoftBiometrics as FaceBiometrics
from hri_pipeline.ros import conversions
from hri_pipeline.ros.conversions import (
    LandmarkArray,
    SkeletonArray,
    audio_features_to_msg,
    speech_message,
    speech_type,
)

BGR = np.random.default_rng(0).integers(0, 256, (6, 8, 3), dtype=np.uint8)
HEADER = Header(stamp=genpy.Time(1700000000, 123456789), frame_id="camera_optical")

# Index of each key point, as other nodes read it.
NAMES = ("NOSE", "NECK", "RIGHT_SHOULDER", "RIGHT_ELBOW", "RIGHT_WRIST", "LEFT_SHOULDER", "LEFT_ELBOW", "LEFT_WRIST",
         "RIGHT_HIP", "RIGHT_KNEE", "RIGHT_ANKLE", "LEFT_HIP", "LEFT_KNEE", "LEFT_ANKLE", "LEFT_EYE", "RIGHT_EYE",
         "LEFT_EAR", "RIGHT_EAR")


def over_the_wire(message):
    """Serialise and deserialise."""
    buffer = io.BytesIO()
    message.serialize(buffer)
    return type(message)().deserialize(buffer.getvalue())


def test_image_round_trip():
    message = over_the_wire(conversions.bgr_to_image(BGR, HEADER))
    np.testing.assert_array_equal(conversions.image_to_bgr(message), BGR)
    assert (message.header, message.encoding, message.step) == (HEADER, "bgr8", 24)
    view = conversions.bgr_to_image(BGR[::2, ::-1], HEADER)
    np.testing.assert_array_equal(conversions.image_to_bgr(view), BGR[::2, ::-1])


@pytest.mark.parametrize("image", [BGR[:, :, 0], BGR.astype(np.float32), BGR[:, :, :2]])
def test_what_is_not_an_image_is_not_published(image):
    with pytest.raises(ImageError, match="uint8"):
        conversions.bgr_to_image(image, HEADER)


def test_big_endian_flag_and_bad_images():
    wide = (BGR[:, :, 0].astype(np.uint16) * 256).astype(">u2")
    message = Image(height=6, width=8, step=16, encoding="mono16", is_bigendian=1, data=wide.tobytes())
    np.testing.assert_array_equal(conversions.image_to_bgr(over_the_wire(message))[:, :, 0], BGR[:, :, 0])
    for bad in (Image(), Image(height=6, width=8, step=24, encoding="bgr8"), Image(height=1, width=1, encoding="?")):
        with pytest.raises(ImageError):
            conversions.image_to_bgr(over_the_wire(bad))


def test_compressed():
    data = cv2.imencode(".png", BGR)[1].tobytes()
    np.testing.assert_array_equal(conversions.compressed_to_bgr(CompressedImage(format="png", data=data)), BGR)
    with pytest.raises(ImageError, match="depth image"):
        conversions.compressed_to_bgr(CompressedImage(format="16UC1; compressedDepth png", data=data))
    with pytest.raises(ImageError, match="depth image"):
        conversions.compressed_to_bgr(CompressedImage(format="16UC1; png compressed ", data=data))
    with pytest.raises(ImageError):
        conversions.compressed_to_bgr(CompressedImage())
    mosaic = np.tile(np.array([[200, 120], [120, 40]], np.uint8), (6, 8))
    raw = CompressedImage(format="bayer_rggb8; png compressed ", data=cv2.imencode(".png", mosaic)[1].tobytes())
    assert conversions.compressed_to_bgr(raw)[5, 5].tolist() == [40, 120, 200]


def test_camera():
    info = CameraInfo(width=640, height=480, distortion_model="plumb_bob", D=[0.1, 0, 0, 0, 0],
                      K=[500, 0, 320, 0, 500, 240, 0, 0, 1], binning_x=2, binning_y=2)
    info.roi.x_offset, info.roi.width, info.roi.height = 20, 600, 480
    camera = conversions.camera_from_info(over_the_wire(info), 1.0)
    assert (camera.width, camera.height, camera.calibration) == (300, 240, Calibration.CALIBRATED)
    np.testing.assert_allclose(camera.matrix, [[250, 0, 150], [0, 250, 120], [0, 0, 1]])
    # Of rectified images P holds, with no distortion; where it is not told, K.
    rectified = conversions.camera_from_info(over_the_wire(info), 1.0, rectified=True)
    np.testing.assert_array_equal(rectified.matrix, camera.matrix)
    info.P = [460, 0, 340, -12, 0, 480, 220, 0, 0, 0, 1, 0]
    rectified = conversions.camera_from_info(over_the_wire(info), 1.0, rectified=True)
    assert (rectified.width, rectified.height, rectified.calibration) == (300, 240, Calibration.CALIBRATED)
    np.testing.assert_allclose(rectified.matrix, [[230, 0, 160], [0, 240, 110], [0, 0, 1]])
    assert not rectified.distortion.any() and camera.distortion.any()
    empty = conversions.camera_from_info(CameraInfo(), 1.0, 64, 48)
    assert (empty.width, empty.calibration) == (64, Calibration.UNCALIBRATED)
    with pytest.raises(CameraError):
        conversions.camera_from_info(CameraInfo(), 1.0)


@pytest.mark.parametrize("box, expected", [
    ((10.2, 20.8, 30.1, 40.0), (10, 20, 21, 20)),
    ((-5.0, -9.0, 5.0, 6.0), (0, 0, 5, 6)),
    ((90.0, 40.0, 300.0, 300.0), (90, 40, 10, 10)),
    ((200.0, 200.0, 300.0, 300.0), (100, 50, 0, 0)),
    ((30.0, 30.0, 10.0, 10.0), (30, 30, 0, 0)),
])
def test_roi_is_whole_pixels_inside_the_image(box, expected):
    roi = over_the_wire(conversions.roi_to_msg(np.array(box), 100, 50))
    assert (roi.x_offset, roi.y_offset, roi.width, roi.height) == expected


def test_roi_that_is_not_finite():
    with pytest.raises(ValueError, match="finite"):
        conversions.roi_to_msg([0, 0, np.nan, 1], 100, 50)


def test_landmarks_round_trip():
    landmarks = np.random.default_rng(1).uniform(size=(70, 3)) * [200, 100, 1]
    message = over_the_wire(conversions.landmarks_to_msg(landmarks, HEADER, 200, 100))
    assert (message.width, message.height, message.header) == (200, 100, HEADER)
    np.testing.assert_allclose(conversions.landmarks_from_msg(message) * [200, 100, 1], landmarks, atol=2e-5)


def serialised_landmarks():
    buffer = io.BytesIO()
    landmarks = np.random.default_rng(1).uniform(size=(70, 3)) * [200, 100, 1]
    conversions.landmarks_to_msg(landmarks, HEADER, 200, 100).serialize(buffer)
    return buffer.getvalue()


def test_landmarks_read_as_one_array_are_those_of_the_message():
    data = serialised_landmarks()
    points, array = FacialLandmarks().deserialize(data), LandmarkArray().deserialize(data)
    assert LandmarkArray._md5sum == FacialLandmarks._md5sum and FacialLandmarks.__slots__ == [
        "header", "landmarks", "height", "width"]
    assert (array.header, array.width, array.height) == (points.header, 200, 100)
    np.testing.assert_array_equal(conversions.landmarks_from_msg(array), conversions.landmarks_from_msg(points))


def serialised_skeleton():
    buffer = io.BytesIO()
    keypoints = np.random.default_rng(2).uniform(size=(18, 3)) * [200, 100, 1]
    conversions.skeleton_to_msg(keypoints, HEADER, 200, 100).serialize(buffer)
    return buffer.getvalue()


def test_key_points_read_as_one_array_are_those_of_the_message():
    data = serialised_skeleton()
    points, array = Skeleton2D().deserialize(data), SkeletonArray().deserialize(data)
    assert SkeletonArray._md5sum == Skeleton2D._md5sum and array.header == points.header
    np.testing.assert_array_equal(conversions.skeleton_from_msg(array), conversions.skeleton_from_msg(points))


@pytest.mark.parametrize("length", [0, 3, 15, 20, 40, 200, -1])
def test_points_that_are_cut_off_are_refused(length):
    with pytest.raises(ValueError, match="FacialLandmarks: the message"):
        conversions.landmarks_from_msg(LandmarkArray().deserialize(serialised_landmarks()[:length]))
    with pytest.raises(ValueError, match="Skeleton2D: the message"):
        conversions.skeleton_from_msg(SkeletonArray().deserialize(serialised_skeleton()[:length]))


POINTS = "Header (float32 float32 float32)"


@pytest.mark.parametrize("count", [0, 68, 71])
def test_another_number_of_points_is_told(count):
    with pytest.raises(ValueError, match="FacialLandmarks needs 70 points, not {}".format(count)):
        conversions.landmarks_from_msg(LandmarkArray().deserialize(serialise(POINTS + "[] uint32 uint32", count)[0]))
    with pytest.raises(ValueError, match="Skeleton2D needs 18 points, not {}".format(count)):
        conversions.skeleton_from_msg(SkeletonArray().deserialize(serialise(POINTS + "[]", count)[0]))


def test_recordings_without_the_number_of_points_are_named():
    """A definition of `[70]` or `[18]` points has the same md5 and the same name."""
    with pytest.raises(ValueError, match="definition of 70 points"):
        conversions.landmarks_from_msg(LandmarkArray().deserialize(serialise(POINTS + "[70] uint32 uint32", 0)[0]))
    with pytest.raises(ValueError, match="definition of 18 points"):
        conversions.skeleton_from_msg(SkeletonArray().deserialize(serialise(POINTS + "[18]", 0)[0]))


def test_an_array_of_landmarks_that_are_not_finite_is_refused():
    array = LandmarkArray().deserialize(serialised_landmarks())
    array.landmarks[3, 1] = np.nan
    with pytest.raises(ValueError, match="finite"):
        conversions.landmarks_from_msg(array)


def test_skeleton_round_trip_keeps_left_and_right():
    assert len(NAMES) == 18
    keypoints = np.array([[10.0 * index, 5.0 * index, index / 18] for index in range(18)])
    message = over_the_wire(conversions.skeleton_to_msg(keypoints, HEADER, 200, 100))
    for index, name in enumerate(NAMES):
        assert getattr(Skeleton2D, name) == index
        point = message.skeleton[getattr(Skeleton2D, name)]
        np.testing.assert_allclose([point.x * 200, point.y * 100, point.c], keypoints[index], atol=2e-5)
    np.testing.assert_allclose(conversions.skeleton_from_msg(message) * [200, 100, 1], keypoints, atol=2e-5)


@pytest.mark.parametrize("convert, points", [(conversions.landmarks_to_msg, "landmarks"),
                                             (conversions.skeleton_to_msg, "skeleton")])
def test_what_is_sent_is_what_the_message_holds(convert, points):
    """The bytes are those that the generated class writes, of points that somebody has asked for and changed, too."""
    def generated(message):
        kind = FacialLandmarks if points == "landmarks" else Skeleton2D
        other = kind(**{name: getattr(message, name) for name in kind.__slots__})
        buffer = io.BytesIO()
        other.serialize(buffer)
        return buffer.getvalue()

    values = np.random.default_rng(3).uniform(-20, 220, size=(70 if points == "landmarks" else 18, 3))
    values[4] = np.nan
    buffer, message = io.BytesIO(), convert(values, HEADER, 200, 100)
    message.serialize(buffer)
    assert buffer.getvalue() == generated(message)
    getattr(message, points)[2].x = 0.25
    changed = io.BytesIO()
    message.serialize(changed)
    assert changed.getvalue() == generated(message) != buffer.getvalue()


def test_pixels_are_sent_as_they_are():
    """The bytes are those that the generated class writes, of data that somebody has changed, too."""
    class Written(io.BytesIO):
        def write(self, part):
            parts.append(part)
            return super().write(part)

    def generated():
        buffer = io.BytesIO()
        Image(**{name: getattr(message, name) for name in Image.__slots__}).serialize(buffer)
        return buffer.getvalue()

    message, parts, buffer = conversions.bgr_to_image(BGR, HEADER), [], Written()
    message.serialize(buffer)
    assert buffer.getvalue() == generated()
    assert any(part is message.data for part in parts), "the pixels were copied before"
    message.data = list(message.data)
    changed = io.BytesIO()
    message.serialize(changed)
    assert changed.getvalue() == generated()


def test_an_image_to_send_is_one_to_all_who_take_images(tmp_path):
    """Bags, copies, other processes, and programs that compare what has come with what was sent."""
    message = conversions.bgr_to_image(BGR[::2, ::-1], HEADER)
    generated = Image(**{name: getattr(message, name) for name in Image.__slots__})
    assert message == generated and generated == message == over_the_wire(message) and not generated != message
    for taken in (copy.deepcopy(message), pickle.loads(pickle.dumps(message))):
        assert taken == message and taken == generated
        taken.height += 1
        assert taken != message and taken != generated and generated != taken
    assert message not in (CompressedImage(), "image")
    with rosbag.Bag(str(tmp_path / "images.bag"), "w") as bag:
        bag.write("image", message, genpy.Time(1))
    with rosbag.Bag(str(tmp_path / "images.bag")) as bag:
        (_, read, _), = bag.read_messages()
    np.testing.assert_array_equal(conversions.image_to_bgr(read), BGR[::2, ::-1])


def test_points_are_sent_without_one_object_each():
    """Ten faces have thousands of points a second; it is a fifth (measured)."""
    landmarks = np.random.default_rng(1).uniform(size=(70, 3))

    def send(ask):
        message = conversions.landmarks_to_msg(landmarks, HEADER, 200, 100)
        assert not ask or len(message.landmarks) == 70
        message.serialize(io.BytesIO())

    assert least_cost(lambda: send(False), 100) < 0.5 * least_cost(lambda: send(True), 100)


def test_landmark_constants_go_from_0_to_69():
    constants = [value for name, value in vars(FacialLandmarks).items() if name.isupper() and isinstance(value, int)]
    assert sorted(constants) == list(range(70))
    assert (FacialLandmarks.RIGHT_PUPIL, FacialLandmarks.LEFT_PUPIL) == (68, 69)


def test_unseen_points_have_no_confidence_and_others_are_clipped():
    keypoints = np.full((18, 3), 50.0)
    keypoints[:, 2] = 0.9
    keypoints[3] = np.nan
    keypoints[4] = [-10, 500, 1.5]
    points = conversions.skeleton_to_msg(keypoints, HEADER, 100, 100).skeleton
    assert (points[3].x, points[3].y, points[3].c) == (0, 0, 0)
    assert (points[4].x, points[4].y, points[4].c) == (0, 1, 1)


@pytest.mark.parametrize("convert, shape", [(conversions.landmarks_to_msg, (68, 3)),
                                            (conversions.skeleton_to_msg, (17, 3)),
                                            (conversions.skeleton_to_msg, (18, 2))])
def test_wrong_number_of_points(convert, shape):
    with pytest.raises(ValueError, match="points are needed"):
        convert(np.zeros(shape), HEADER, 10, 10)
    with pytest.raises(ValueError, match="size of their image"):
        conversions.skeleton_to_msg(np.zeros((18, 3)), HEADER, 0, 10)


def test_hostile_points():
    message = conversions.skeleton_to_msg(np.zeros((18, 3)), HEADER, 10, 10)
    message.skeleton[5].x = float("nan")
    with pytest.raises(ValueError, match="Skeleton2D holds numbers that are not finite"):
        conversions.skeleton_from_msg(message)
    message.skeleton = message.skeleton[:4]
    with pytest.raises(ValueError, match="needs 18 points, not 4"):
        conversions.skeleton_from_msg(message)
    landmarks = conversions.landmarks_to_msg(np.zeros((70, 3)), HEADER, 10, 10)
    landmarks.landmarks[0].c = float("inf")
    with pytest.raises(ValueError, match="FacialLandmarks"):
        conversions.landmarks_from_msg(landmarks)


def test_transform_round_trip():
    pose = Pose.from_quaternion((0.1, -0.2, 0.3, 0.9), (1.0, 2.0, 3.0))
    message = over_the_wire(conversions.transform_to_msg(pose, HEADER.stamp, "camera_optical", "face_abcde"))
    assert (message.header.stamp, message.header.frame_id, message.child_frame_id) == (
        HEADER.stamp, "camera_optical", "face_abcde")
    assert message == over_the_wire(TransformStamped(message.header, message.child_frame_id, message.transform))
    back = conversions.pose_from_transform(message)
    np.testing.assert_allclose(back.rotation, pose.rotation, atol=1e-12)
    np.testing.assert_allclose(back.translation, pose.translation)


def test_hostile_transforms():
    message = TransformStamped()
    with pytest.raises(ValueError, match="quaternion"):
        conversions.pose_from_transform(message)
    message.transform.rotation.w = 1.0
    message.transform.translation.x = float("inf")
    with pytest.raises(ValueError, match="translation"):
        conversions.pose_from_transform(message)


def test_ids_list_and_match():
    message = over_the_wire(conversions.ids_list_to_msg(["abcde", "fghij"], 12.5))
    assert (message.ids, message.header.stamp) == (["abcde", "fghij"], genpy.Time(12, 500000000))
    match = over_the_wire(conversions.match_to_msg("abcde", IdsMatch.FACE, "fghij", IdsMatch.BODY, 1.5))
    assert (match.id1, match.id1_type, match.id2, match.id2_type, match.confidence) == ("abcde", 2, "fghij", 3, 1.0)


def test_action_units_are_99_pairs_in_range():
    intensity, confidence = np.linspace(-0.5, 1.5, 99), np.full(99, 0.5)
    intensity[7] = np.nan
    msg = conversions.action_units_to_msg(intensity, confidence, conversions.make_header(3.5, "camera"))
    assert len(msg.intensity) == len(msg.confidence) == 99 and msg.header.frame_id == "camera"
    assert (min(msg.intensity), max(msg.intensity)) == (0.0, 1.0)
    assert (msg.intensity[7], msg.confidence[7]) == (0.0, 0.0), "what is not finite is not known"
    with pytest.raises(ValueError, match="99"):
        conversions.action_units_to_msg(np.zeros(98), np.zeros(99), conversions.make_header(0.0, ""))


def test_action_units_are_read_clipped_and_must_be_finite():
    random = np.random.default_rng(1)
    intensity, confidence = random.uniform(-0.5, 1.5, (2, 99))
    message = over_the_wire(FacialActionUnits(intensity=intensity.tolist(), confidence=confidence.tolist()))
    read = conversions.action_units_from_msg(message)
    assert np.array(read) == pytest.approx(np.clip([intensity, confidence], 0.0, 1.0), abs=1e-6)
    for length, wrong in ((98, 0.5), (99, float("nan")), (99, float("inf"))):
        for field in ("intensity", "confidence"):
            values = {"intensity": [0.5] * 99, "confidence": [0.5] * 99}
            values[field] = [0.5] * (length - 1) + [wrong]
            with pytest.raises(ValueError, match="99 intensities|finite"):
                conversions.action_units_from_msg(FacialActionUnits(**values))


def test_expression_is_clipped_and_must_be_finite():
    msg = conversions.expression_to_msg("happy", 1.5, -2.0, 0.4, conversions.make_header(1.0, "camera"))
    # genmsg takes the quotation marks of a string constant for a part of it; the topic carries the bare word.
    assert (msg.expression, msg.valence, msg.arousal) == (Expression.HAPPY.strip('"'), 1.0, -1.0)
    with pytest.raises(ValueError, match="finite"):
        conversions.expression_to_msg("happy", float("nan"), 0.0, 0.4, conversions.make_header(1.0, "camera"))


@pytest.mark.parametrize("p_male, certain, gender", [
    (0.9, 0.9, SoftBiometrics.MALE), (0.1, 0.9, SoftBiometrics.FEMALE), (0.9, 0.0, SoftBiometrics.UNDEFINED)])
def test_age_and_gender(p_male, certain, gender):
    msg = conversions.soft_biometrics_to_msg(FaceBiometrics(33.6, 0.7, p_male, certain),
                                             conversions.make_header(1.0, "camera"))
    assert (msg.age, msg.gender) == (34, gender)
    assert msg.age_confidence == pytest.approx(0.7) and msg.gender_confidence == pytest.approx(certain)


def test_an_age_out_of_range_fits_the_message():
    assert conversions.soft_biometrics_to_msg(FaceBiometrics(400.0, 1.0, 0.5, 0.5),
                                              conversions.make_header(1.0, "")).age == 255
    with pytest.raises(ValueError, match="finite"):
        conversions.soft_biometrics_to_msg(FaceBiometrics(float("nan"), 1.0, 0.5, 0.5),
                                           conversions.make_header(1.0, ""))


def test_descriptors():
    message = over_the_wire(audio_features_to_msg(FeatureFrame(3.0, 0.1, 0.2, 0.4, 12.5, np.arange(12.0))))
    assert isinstance(message, AudioFeatures)
    np.testing.assert_allclose([message.ZCR, message.RMS, message.pitch, message.HNR], [0.1, 0.2, 0.4, 12.5], rtol=1e-6)
    assert list(message.MFCC) == list(range(12))


def test_what_is_not_finite_is_zero():
    message = over_the_wire(audio_features_to_msg(FeatureFrame(0.0, np.nan, np.inf, -np.inf, np.nan,
                                                               np.full(12, np.nan))))
    assert (message.ZCR, message.RMS, message.pitch, message.HNR) == (0.0, 0.0, 0.0, 0.0) and not any(message.MFCC)


@pytest.mark.parametrize("incremental, final, confidence", [("go", "", 0.0), ("", "go forward", 0.8), ("", "", 1.7)])
def test_speech_in_both_interfaces(incremental, final, confidence):
    result = SpeechResult("abcde", 1.0, incremental, final, confidence, "en-US")
    text = speech_message(result, "paper", HEADER)
    assert speech_type("paper") is String and over_the_wire(text).data == (final or incremental)
    live = over_the_wire(speech_message(result, "rep155", HEADER))
    assert speech_type("rep155") is LiveSpeech and isinstance(live, LiveSpeech)
    assert (live.incremental, live.final, live.language) == (incremental, final, "en-US")
    assert live.confidence == min(1.0, confidence) and live.header == HEADER


def test_an_unknown_interface_is_refused():
    with pytest.raises(ValueError, match="interface is 'both'; legal: paper, rep155"):
        speech_type("both")
