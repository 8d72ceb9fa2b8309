"""Size and distance by face, floor and depth image; bodies that the image's border cuts."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from synthetic_people import STANDING, standing_at

from hri_fullbody.core.detection.pose_estimator import PoseDetection, PoseEstimate
from hri_fullbody.core.localization.localizer import (
    BodyLocalizer,
    CutRange,
    SceneContext,
    body_pose,
    is_cut,
    is_leaving,
    measured_joints,
    rotation_to_ray,
    solve_pnp,
    translation_only,
)
from hri_fullbody.core.localization.scale import BodyScale, depth_cue, face_cue, floor_ratio, trunk_ratio
from hri_fullbody.core.tracking.track import BodyTrack
from hri_pipeline.core.camera import Calibration, CameraModel
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.image_rotation import ImageRotation
from hri_pipeline.core.tracks import TrackLife

CAMERA = CameraModel.from_fov(1280, 720, 1.05)
FOCAL = CAMERA.matrix[0, 0]
SURE = np.full(39, 0.95)
UP = np.array([0.0, -1.0, 0.0])
WHOLE, AT_LEFT, AT_RIGHT, ABOVE = (0.0, 0.3, 3.0), (-1.45, 0.3, 2.63), (1.45, 0.3, 2.63), (0.0, -0.5, 3.0)


def human(size, position):
    """A person `size` times as tall as the average at `position` (hips, m): true points and the network's estimate."""
    points = STANDING * size + np.asarray(position)
    landmarks = np.zeros((39, 3))
    landmarks[:33, :2] = CAMERA.project(points)
    hips = landmarks[[23, 24], :2].mean(axis=0)
    landmarks[33, :2] = hips
    landmarks[34, :2] = hips - (0.0, 0.9 * size * FOCAL / position[2])
    return points, PoseEstimate(0.95, landmarks, SURE.copy(), STANDING.copy())


def observe(size, position, face=None, frames=1, shape=None, start=0.0, **around):
    """The last of some observations of such a person, and its shape."""
    shape = shape or BodyLocalizer()
    points, estimate = human(size, position)
    rays = CAMERA.normalise(estimate.landmarks[:33, :2])
    detection = PoseDetection(estimate, solve_pnp(rays, estimate.world, np.ones(33, bool)))
    track = BodyTrack("b", detection, start, TrackLife(start, 0.0, 1.0))
    for index in range(frames):
        stamp = start + index * 0.1
        if index:
            track.update(detection, stamp, False)
        body = shape.observe(track, CAMERA, stamp, face, SceneContext(**around))
    return body, points, shape


def stature(body):
    """Nose to ankle of an observation, m."""
    return float(np.linalg.norm(body.keypoints_3d[0] - body.keypoints_3d[[10, 13]].mean(axis=0)))


@pytest.mark.parametrize("size", [0.85, 1.0, 1.15])
def test_with_a_face_the_head_is_there_and_the_size_follows(size):
    position = np.array([0.3, 0.2, 2.5])
    points = STANDING * size + position
    face = Pose(np.eye(3), points[[1, 4]].mean(axis=0))
    body, points, _ = observe(size, position, face, frames=20)
    eyes = body.keypoints_3d[[14, 15]].mean(axis=0)
    assert np.linalg.norm(eyes - points[[2, 5]].mean(axis=0)) < 0.03
    # A near face may be a large one: the size is half-way between the average and what the face says.
    average = np.linalg.norm(STANDING[0] - STANDING[[27, 28]].mean(axis=0))
    assert stature(body) == pytest.approx(average * size ** 0.5, rel=0.03)
    assert body.head is face


def test_the_size_learnt_from_a_face_stays_when_the_face_is_gone():
    position = np.array([0.0, 0.2, 3.0])
    points = STANDING * 0.88 + position
    _, _, shape = observe(0.88, position, Pose(np.eye(3), points[[1, 4]].mean(axis=0)), frames=30)
    body, points, _ = observe(0.88, position, None, frames=40, shape=shape, start=3.0)
    without, _, _ = observe(0.88, position, frames=40)
    assert without.pose.translation[2] == pytest.approx(3.0 / 0.88, abs=0.1)
    assert body.pose.translation[2] == pytest.approx(3.0 / 0.88 ** 0.5, abs=0.1)


def test_a_face_that_contradicts_the_landmarks_places_the_body_but_is_no_size():
    position = np.array([0.0, 0.2, 3.0])
    body, _, shape = observe(1.0, position, Pose(np.eye(3), np.array([0.0, -0.27, 1.7])), frames=30)
    assert body.keypoints_3d[[14, 15]].mean(axis=0) == pytest.approx([0.0, -0.26, 1.7], abs=0.05)
    assert shape._scale.value == 1.0


@pytest.mark.parametrize("pose", [None, Pose(np.eye(3), np.array([0.0, 0.0, np.nan])),
                                  Pose(np.eye(3), np.array([0.0, 0.0, 40.0]))])
def test_impossible_faces_are_no_cue(pose):
    assert face_cue(STANDING + (0.0, 0.0, 3.0), pose) is None


@pytest.mark.parametrize("size, lifted", [(0.9, None), (1.1, None), (1.1, 27), (1.1, 28)])
def test_the_standing_foot_on_the_floor_tells_size_and_distance(size, lifted):
    position = np.array([0.2, 0.0, 3.5])
    points = STANDING * size + position
    height = points[27, 1] + 0.07
    rays = points[:, :2] / points[:, 2:]
    wrong = STANDING + position / size
    if lifted is not None:
        rays[lifted, 1] -= 0.08
    ratio = floor_ratio(wrong, rays, np.ones(33), UP, height)
    assert ratio == pytest.approx(size, rel=0.03)


@pytest.mark.parametrize("around, size", [
    (dict(up=UP), None), (dict(camera_height=1.1), None), (dict(up=UP, camera_height=0.3 + 1.1 * 0.82 + 0.07), 1.1)])
def test_who_stands_on_a_floor_of_known_height_is_measured_by_it(around, size):
    _, _, shape = observe(1.1, (0.2, 0.3, 3.5), frames=30, **around)
    assert (shape.size is None) if size is None else (shape.size[0] == pytest.approx(size, rel=0.03))


def test_feet_that_cannot_stand_on_the_floor_say_nothing():
    points = STANDING + (0.0, 0.0, 3.0)
    rays = points[:, :2] / points[:, 2:]
    assert floor_ratio(points, rays, np.ones(33), UP, 2.5) is None         # would be twice as far
    assert floor_ratio(points, rays, np.zeros(33), UP, 0.9) is None        # not seen
    assert floor_ratio(points, rays, np.ones(33), -UP, 0.9) is None        # above the horizon


def test_a_size_that_is_measured_otherwise_for_long_is_learnt_anew():
    scale = BodyScale()
    for ratio, images in ((1.0, 2000), (1.1, 450)):
        for _ in range(images):
            scale.update(depth_cue(ratio, np.array([0.0, 0.0, 3.0])))
    assert scale.value == pytest.approx(1.095, abs=0.008)


def test_without_cues_the_scale_is_the_average_and_one_outlier_moves_it_little():
    scale = BodyScale()
    scale.update(None)
    assert scale.value == 1.0
    for _ in range(30):
        scale.update(depth_cue(1.1, np.array([0.0, 0.0, 3.0])))
    assert scale.value == pytest.approx(1.1, abs=0.01)
    scale.update(depth_cue(0.8, np.array([0.0, 0.0, 3.0])))
    assert scale.value == pytest.approx(1.1, abs=0.03)


def depth_of(points, behind=5.0, noise=0.0):
    """A depth image of a flat person at the depth of the trunk's front, holes in a tenth of it, a wall behind."""
    depth = np.full((720, 1280), behind, np.float32)
    pixels = CAMERA.project(points)
    hull = cv2.convexHull(np.rint(pixels).astype(np.int32))
    cover = np.zeros(depth.shape, np.uint8)
    cv2.fillConvexPoly(cover, hull, 1)
    cover = cv2.dilate(cover, np.ones((15, 15), np.uint8))
    depth[cover > 0] = points[[11, 12, 23, 24], 2].mean() - 0.10
    random = np.random.default_rng(0)
    depth += (random.normal(size=depth.shape) * noise).astype(np.float32)
    depth[random.random(depth.shape) < 0.1] = np.nan
    return depth


@pytest.mark.parametrize("size", [0.7, 1.0, 1.2])
def test_a_depth_image_gives_distance_and_size(size):
    position = np.array([0.1, 0.1, 2.4])
    points = STANDING * size + position
    body, points, shape = observe(size, position, frames=15, depth=depth_of(points, noise=0.01))
    assert shape.by_depth
    assert body.pose.translation[2] == pytest.approx(2.4, abs=0.05)
    assert stature(body) == pytest.approx(np.linalg.norm(points[0] - points[[27, 28]].mean(axis=0)), rel=0.05)
    assert np.nanmax(np.linalg.norm(body.keypoints_3d[8:14] - points[[24, 26, 28, 23, 25, 27]], axis=1)) < 0.12


def test_a_depth_image_measures_a_body_whatever_the_floor_says():
    """The size that it has told is used where the depth image does not show the body any more."""
    position, places = np.array([0.1, 0.1, 2.4]), []
    depth = depth_of(STANDING * 1.1 + position)
    for around in ({}, dict(up=UP, camera_height=0.1 + 0.82 * 0.85 + 0.07)):
        _, _, shape = observe(1.1, position, frames=15, depth=depth, **around)
        assert shape.size is None, "the bones that are fitted tell it better"
        body, _, _ = observe(1.1, position, frames=15, shape=shape, start=2.0)
        places.append(body.pose.translation)
    assert places[0] == pytest.approx(position, abs=0.06) and places[1] == pytest.approx(places[0], abs=1e-6)


def test_a_hand_is_at_its_depth_where_the_depth_image_shows_the_trunk():
    points = STANDING + np.array([0.0, 0.0, 2.5])
    x, y = CAMERA.project(points)[15].astype(int)
    for behind, trunk in ((5.0, True), (np.nan, False)):
        depth = depth_of(points) if trunk else np.full((720, 1280), behind, np.float32)
        depth[y - 10:y + 10, x - 10:x + 10] = points[15, 2] - 0.2 - 0.03
        body, _, shape = observe(1.0, (0.0, 0.0, 2.5), depth=depth)
        assert shape.by_depth == trunk
        assert body.keypoints_3d[7, 2] == pytest.approx(points[15, 2] - (0.2 if trunk else 0.0), abs=0.03)


def test_who_comes_nearer_is_followed_faster_with_a_depth_image():
    lags = []
    for given in (True, False):
        shape = BodyLocalizer()
        for index in range(20):
            distance = 3.5 - 0.1 * index
            points = STANDING + np.array([0.0, 0.0, distance])
            body, _, _ = observe(1.0, (0.0, 0.0, distance), shape=shape, start=index / 15.0,
                                 depth=depth_of(points) if given else None)
        lags.append(body.pose.translation[2] - distance)
    assert lags[0] < 0.06 and lags[0] < 0.7 * lags[1]


@pytest.mark.parametrize("period", [1, 3])
def test_noise_and_gaps_of_a_depth_image_do_not_make_a_body_jump(period):
    random = np.random.default_rng(3)
    position = np.array([0.1, 0.1, 2.4])
    points = STANDING * 1.1 + position
    depth, shape, places = depth_of(points), None, []
    for index in range(45):
        seen = depth * (1.0 + 0.02 * cv2.resize(random.normal(size=(90, 160)), (1280, 720)))
        body, _, shape = observe(1.1, position, shape=shape, start=index / 15.0,
                                 depth=seen.astype(np.float32) if index % period == 0 else None)
        places.append(body.pose.translation[2])
    assert np.abs(np.diff(places[10:])).max() < 0.045
    assert np.mean(places[10:]) == pytest.approx(2.4, abs=0.04)


@pytest.mark.parametrize("depth", [np.full((720, 1280), np.nan, np.float32), np.zeros((720, 1280), np.float32),
                                   np.full((4, 4), 9.0, np.float32) * np.nan], ids=["nan", "zero", "small"])
def test_without_a_single_depth_the_colour_image_places_the_body(depth):
    body, _, shape = observe(1.0, np.array([0.0, 0.0, 3.0]), depth=depth)
    assert not shape.by_depth
    assert body.pose.translation[2] == pytest.approx(3.0, abs=0.1)


@pytest.mark.parametrize("elbow, wrist, held", [
    (0.0, 0.2, True), (0.0, -0.2, True), (0.0, -1.5, False), (0.0, 0.3, False), (0.2, 0.2, True), (0.2, -0.2, False),
    (0.0, np.nan, False)],
    ids=["behind", "before", "something before it", "the wall", "both behind", "too far for the arm", "no depth"])
def test_a_joint_is_where_its_surface_is_if_that_can_be_the_body_s(elbow, wrist, held):
    """The arm may be stretched out otherwise than the network thinks."""
    points = STANDING + np.array([0.0, 0.0, 2.5])
    depth = depth_of(points)
    pixels = CAMERA.project(points)
    for joint, way, thick in ((13, elbow, 0.045), (15, wrist, 0.03)):
        x, y = pixels[joint].astype(int)
        depth[y - 10:y + 10, x - 10:x + 10] = points[joint, 2] + way - thick
    rays = points[:, :2] / points[:, 2:]
    found = measured_joints(depth, pixels, rays, points, np.ones(33), (1280, 720))
    assert found[13, 2] == pytest.approx(points[13, 2] + elbow, abs=1e-3)
    assert found[15, 2] == pytest.approx(points[15, 2] + (wrist if held else 0.0), abs=1e-3)
    assert found[15, :2] / found[15, 2] == pytest.approx(rays[15])
    unseen = measured_joints(depth, pixels, rays, points, np.zeros(33), (1280, 720))
    assert unseen == pytest.approx(points), "of what is not seen the pixel tells nothing"


@pytest.mark.parametrize("hidden, ratio", [
    ([], 1.0), ([12], 1.0), ([12, 24], None), ([11, 23], None), ([11, 12, 23], 0.52), ([11, 12, 23, 24], 0.52)])
def test_a_trunk_half_hidden_by_something_else_is_no_measurement(hidden, ratio):
    found = trunk_before(hidden, 1.2, np.ones(33))
    assert found is None if ratio is None else found == pytest.approx(ratio, abs=0.05)


@pytest.mark.parametrize("without_depth, unseen, ratio", [
    ([12], [], 1.0), ([12, 24], [], 1.0), ([11, 12, 23], [], None), ([11, 12, 23, 24], [], None),
    ([], [12], 1.0), ([], [11, 12, 23], None), ([24], [12], 1.0), ([24, 23], [12], None)])
def test_two_joints_of_the_trunk_that_are_seen_and_have_a_depth_tell_its_distance(without_depth, unseen, ratio):
    confidence = np.ones(33)
    confidence[unseen] = 0.1
    found = trunk_before(without_depth, np.nan, confidence)
    assert found is None if ratio is None else found == pytest.approx(ratio, abs=0.05)


def test_what_is_before_joints_that_are_not_seen_is_not_the_trunk():
    confidence = np.ones(33)
    confidence[[12, 24]] = 0.1
    assert trunk_before([12, 24], 1.2, confidence) == pytest.approx(1.0, abs=0.05)


def trunk_before(joints, distance, confidence):
    """Ratio of a trunk 2.5 m away in a depth image (m) which is `distance` at these joints."""
    points = STANDING + np.array([0.0, 0.0, 2.5])
    depth, pixels = depth_of(points), CAMERA.project(points)
    middle = pixels[[11, 12, 23, 24]].mean(axis=0)
    for joint in joints:
        x, y = (pixels[joint] + 0.2 * (middle - pixels[joint])).astype(int)
        depth[y - 15:y + 15, x - 15:x + 15] = distance
    return trunk_ratio(depth, pixels, points, confidence, (1280, 720))


def newborn(shape, turned_away=False, face=None, stamps=(0.0,), distance=3.0, **around):
    """Whether a body has a place at each of some times (s) since it began."""
    _, estimate = human(1.0, np.array([0.0, 0.0, distance]))
    world = estimate.world * (-1.0, 1.0, -1.0) if turned_away else estimate.world
    detection = PoseDetection(PoseEstimate(0.95, estimate.landmarks, SURE, world), solve_pnp(
        CAMERA.normalise(estimate.landmarks[:33, :2]), estimate.world, np.ones(33, bool)))
    track, placed = BodyTrack("b", detection, 0.0, TrackLife(0.0, 0.0, 1.0)), []
    for stamp in stamps:
        track.update(detection, stamp, False)
        placed.append(shape.observe(track, CAMERA, stamp, face, SceneContext(**around)).pose is not None)
    return placed


def test_who_turns_to_the_camera_has_a_place_once_the_face_comes():
    """Until then the pose network alone tells the distance; with the face, the body would jump."""
    shape, face = BodyLocalizer(), Pose(np.eye(3), (STANDING + (0.0, 0.0, 3.0))[[1, 4]].mean(axis=0))
    assert newborn(shape, faces=True) == [False]
    assert newborn(shape, face=face, faces=True) == [True]
    assert newborn(shape, faces=True) == [True], "a face that was lost has told it"


def test_who_has_no_face_has_a_place_after_a_moment_and_from_behind_or_far_away_at_once():
    assert newborn(BodyLocalizer(), stamps=(0.0, 0.3, 0.7), faces=True) == [False, False, True]
    assert newborn(BodyLocalizer(), turned_away=True, faces=True) == [True]
    assert newborn(BodyLocalizer(), distance=6.0, faces=True) == [True], "who is seen whole is there"
    assert newborn(BodyLocalizer(), faces=False) == [True], "without faces there is nothing to wait for"
    depth = np.full((720, 1280), 3.0, np.float32)
    assert newborn(BodyLocalizer(), faces=True, depth=depth) == [True]


def test_a_predicted_observation_moves_with_the_body_and_says_so():
    shape = BodyLocalizer()
    _, estimate = human(1.0, np.array([0.0, 0.0, 3.0]))
    rays = CAMERA.normalise(estimate.landmarks[:33, :2])
    track = BodyTrack("b", PoseDetection(estimate, solve_pnp(rays, estimate.world, np.ones(33, bool))), 0.0,
                      TrackLife(0.0, 0.0, 1.0))
    seen = shape.observe(track, CAMERA, 0.0, None, SceneContext())
    for index in range(1, 20):
        _, estimate = human(1.0, np.array([0.05 * index, 0.0, 3.0]))
        rays = CAMERA.normalise(estimate.landmarks[:33, :2])
        track.update(PoseDetection(estimate, solve_pnp(rays, estimate.world, np.ones(33, bool))), 0.05 * index, False)
        seen = shape.observe(track, CAMERA, 0.05 * index, None, SceneContext())
    assert seen.measured
    assert seen.velocity[0] == pytest.approx(1.0, abs=0.2)
    later = shape.observe(track, CAMERA, 1.05, None, SceneContext())
    assert not later.measured
    assert later.pose.translation[0] - seen.pose.translation[0] == pytest.approx(0.1, abs=0.03)
    assert later.keypoints[0, 0] > seen.keypoints[0, 0] + 15.0
    assert later.keypoints[0, 2] < seen.keypoints[0, 2]
    assert np.isfinite(later.keypoints_3d).sum() == np.isfinite(seen.keypoints_3d).sum()


def test_a_body_without_an_inference_is_moved_on_as_a_whole():
    _, estimate = human(1.0, np.array([0.0, 0.0, 3.0]))
    points = solve_pnp(CAMERA.normalise(estimate.landmarks[:33, :2]), estimate.world, np.ones(33, bool))
    face = Pose(np.eye(3), points[[1, 4]].mean(axis=0))
    track = BodyTrack("b", PoseDetection(estimate, points), 0.0, TrackLife(0.0, 0.0, 1.0))
    shape, way = BodyLocalizer(), np.array([0.05, 0.01, -0.02])
    seen = shape.observe(track, CAMERA, 0.0, face, SceneContext())
    later = shape.observe(track, CAMERA, 0.1, Pose(np.eye(3), face.translation + way), SceneContext())
    assert later.pose.translation - seen.pose.translation == pytest.approx(way)
    assert later.keypoints_3d - seen.keypoints_3d == pytest.approx(np.tile(way, (18, 1)), nan_ok=True)
    assert later.pose.rotation == pytest.approx(seen.pose.rotation)
    assert later.hands == pytest.approx(seen.hands)
    # It is detected anew, but not shown in that image: what is guessed is known from then on.
    unsure = np.where(np.arange(39) == 16, 0.1, SURE)
    track.update(PoseDetection(replace(estimate, confidence=unsure), points), 0.2, False)
    guessed = shape.observe(track, CAMERA, 0.3, None, SceneContext())
    assert np.isnan(guessed.keypoints_3d[4]).all() and np.isfinite(later.keypoints_3d[4]).all()
    assert np.isnan(guessed.hands[1]).all() and np.isfinite(guessed.hands[0]).all()


def test_the_key_points_of_who_comes_nearer_keep_up():
    """The filter's unit stays that of the first image: else what it has kept would be of another size."""
    shape, track, behind = BodyLocalizer(), None, []
    for index in range(20):
        away = 4.0 - 0.1 * index
        _, estimate = human(1.0, np.array([0.5 * away, 0.3, away]))
        detection = PoseDetection(estimate, None)
        track = track or BodyTrack("b", detection, 0.0, TrackLife(0.0, 0.0, 1.0))
        track.update(detection, 0.1 * index, False)
        seen = shape.observe(track, CAMERA, 0.1 * index, None, SceneContext())
        behind.append(abs(seen.keypoints[0, 0] - estimate.landmarks[0, 0]))
    assert max(behind) < 3.0


def test_key_points_that_tremble_are_told_with_less_confidence():
    """What the network is sure of stays as it is for those who judge legs and arms by it."""
    random, told = np.random.default_rng(3), {}
    for deviation in (0.5, 30.0):
        shape, track = BodyLocalizer(), None
        for index in range(20):
            _, estimate = human(1.0, np.array([0.0, 0.0, 3.0]))
            landmarks = estimate.landmarks.copy()
            landmarks[:, :2] += random.normal(0.0, deviation, (len(landmarks), 2))
            detection = PoseDetection(replace(estimate, landmarks=landmarks), None)
            track = track or BodyTrack("b", detection, 0.0, TrackLife(0.0, 0.0, 1.0))
            track.update(detection, 0.1 * index, False)
            told[deviation] = shape.observe(track, CAMERA, 0.1 * index, None, SceneContext())
    calm, trembling = told[0.5], told[30.0]
    assert trembling.keypoints[:, 2] == pytest.approx(calm.keypoints[:, 2])
    assert calm.judged_keypoints[:, 2] == pytest.approx(calm.keypoints[:, 2], abs=0.03)
    assert (trembling.judged_keypoints[:, 2] < calm.judged_keypoints[:, 2] - 0.05).all()
    assert trembling.judged_keypoints[:, :2] == pytest.approx(trembling.keypoints[:, :2])


@pytest.mark.parametrize("every", [1, 2])
def test_key_points_that_tremble_with_the_camera_are_told_as_sure_as_before(every):
    random, shape = np.random.default_rng(4), BodyLocalizer()
    _, estimate = human(1.0, np.array([0.0, 0.0, 3.0]))
    place, track = np.zeros(2), BodyTrack("b", PoseDetection(estimate, None), 0.0, TrackLife(0.0, 0.0, 1.0))
    for index in range(24):
        now = 0.1 * index
        way = random.normal(0.0, 30.0, 2)
        place = place + way
        track.carry(way)
        if index % every == 0:
            landmarks = estimate.landmarks.copy()
            landmarks[:, :2] += place
            track.update(PoseDetection(replace(estimate, landmarks=landmarks), None), now, False)
        told = shape.observe(track, CAMERA, now, None, SceneContext())
    assert told.reliability is not None and told.reliability.min() > 0.98


def test_a_body_between_two_looks_is_turned_with_the_images():
    points, estimate = human(1.0, WHOLE)
    track = BodyTrack("b", PoseDetection(estimate, points), 0.0, TrackLife(0.0, 0.0, 1.0))
    shape, turn = BodyLocalizer(), ImageRotation(1, 1280, 720)
    face = Pose(np.eye(3), points[[1, 4]].mean(axis=0))
    shape.observe(track, CAMERA, 0.0, face, SceneContext())
    face = Pose(np.eye(3), face.translation + (0.03, 0.02, -0.04))
    before = shape.observe(track, CAMERA, 0.1, face, SceneContext())
    track.turn(turn)
    shape.turn(turn)
    after = shape.observe(track, CameraModel.from_fov(720, 1280, 1.05), 0.1, turn.pose(face), SceneContext())
    assert not after.measured
    assert after.keypoints[:, :2] == pytest.approx(turn.pixels(before.keypoints[:, :2]))
    assert after.keypoints_3d == pytest.approx(turn.vectors(before.keypoints_3d), nan_ok=True)
    BodyLocalizer().turn(turn)      # one that has seen nothing yet


def test_key_points_in_space_are_not_filtered():
    shape = BodyLocalizer()
    _, estimate = human(1.0, np.array([0.0, 0.0, 3.0]))
    moved = standing_at(0, 0).world.copy()
    moved[16] += (0.0, -0.5, 0.0)
    rays = CAMERA.normalise(estimate.landmarks[:33, :2])
    points = solve_pnp(rays, estimate.world, np.ones(33, bool))
    track = BodyTrack("b", PoseDetection(estimate, points), 0.0, TrackLife(0.0, 0.0, 1.0))
    first = shape.observe(track, CAMERA, 0.0, None, SceneContext())
    raised = points.copy()
    raised[16, 1] -= 0.5
    track.update(PoseDetection(estimate, raised), 0.05, False)
    second = shape.observe(track, CAMERA, 0.05, None, SceneContext())
    assert second.keypoints_3d[4, 1] - first.keypoints_3d[4, 1] == pytest.approx(-0.5, abs=1e-6)


BENT = CameraModel(1280, 720, CAMERA.matrix, np.array([-0.25, 0.08, 0.001, -0.001, 0.0]), "plumb_bob",
                   Calibration.CALIBRATED)
ALL = np.ones(33, bool)


def truth(position, turn_deg):
    turn = cv2.Rodrigues(np.array([0.0, np.radians(turn_deg), 0.0]))[0]
    return STANDING @ turn.T + np.asarray(position), STANDING @ turn.T


@pytest.mark.parametrize("camera", [CAMERA, BENT], ids=["ideal", "distorted"])
@pytest.mark.parametrize("position", [(0.0, 0.1, 2.0), (0.7, 0.0, 3.0), (-1.5, 0.2, 6.0)])
@pytest.mark.parametrize("turn_deg", [0.0, 70.0, 180.0])
def test_exact_landmarks_are_placed_exactly(camera, position, turn_deg):
    points, world = truth(position, turn_deg)
    placed = solve_pnp(camera.normalise(camera.project(points)), world, ALL)
    assert np.abs(placed - points).max() < 0.02


def test_landmarks_in_the_axes_of_the_ray_are_turned():
    points, world = truth((1.2, 0.0, 2.5), 20.0)
    ray = points[:, :2].mean(axis=0) / points[:, 2].mean()
    placed = solve_pnp(CAMERA.normalise(CAMERA.project(points)), world @ rotation_to_ray(ray), ALL)
    assert np.linalg.norm(placed.mean(axis=0) - points.mean(axis=0)) < 0.03


def test_noise_and_wrong_points_move_the_body_little():
    random = np.random.default_rng(3)
    for _ in range(20):
        points, world = truth((0.4, 0.0, 3.0), random.uniform(-60.0, 60.0))
        pixels = CAMERA.project(points) + random.normal(size=(33, 2)) * 2.0
        pixels[[15, 17, 19]] += (150.0, -90.0)
        placed = solve_pnp(CAMERA.normalise(pixels), world + random.normal(size=(33, 3)) * 0.03, ALL)
        hips, true_hips = placed[23:25].mean(axis=0), points[23:25].mean(axis=0)
        assert np.linalg.norm(hips - true_hips) < 0.45
        assert np.linalg.norm((hips - true_hips)[:2]) < 0.12


def test_a_hand_that_is_taken_for_another_one_moves_no_body():
    points, world = truth((0.4, 0.0, 3.0), 30.0)
    pixels = CAMERA.project(points)
    pixels[[15, 17, 19, 21]] += (150.0, -90.0)
    placed = solve_pnp(CAMERA.normalise(pixels), world, ALL)
    assert np.abs(placed - points).max() < 0.02


@pytest.mark.parametrize("ray", [(0.0, 0.0), (0.3, -0.2), (-0.6, 0.0)])
def test_the_optical_axis_is_turned_to_the_ray_and_not_about_it(ray):
    turn, direction = rotation_to_ray(np.array(ray)), np.array([*ray, 1.0])
    assert turn[:, 2] == pytest.approx(direction / np.linalg.norm(direction))
    assert np.trace(turn) == pytest.approx(1.0 + 2.0 * turn[2, 2]), "no larger than it has to be"


def test_too_few_points_and_impossible_depths_give_nothing():
    points, world = truth((0.0, 0.0, 3.0), 0.0)
    rays = CAMERA.normalise(CAMERA.project(points))
    few = np.zeros(33, bool)
    few[:5] = True
    assert solve_pnp(rays, world, few) is None
    assert solve_pnp(rays * 1e-3, world, ALL) is None
    assert solve_pnp(np.full((33, 2), np.nan), world, ALL) is None


def test_translation_only_finds_the_translation():
    points, world = truth((0.3, -0.2, 4.0), 30.0)
    assert translation_only(points[:, :2] / points[:, 2:], world) == pytest.approx([0.3, -0.2, 4.0], abs=1e-6)


def test_body_frame_looks_forward_with_z_to_the_head():
    points, _ = truth((0.5, 0.3, 3.0), 0.0)
    pose = body_pose(points)
    assert pose.translation == pytest.approx([0.5, 0.3, 3.0])
    # In the optical frame a person who faces the camera looks along -z, has the head at -y and the left at +x.
    assert pose.rotation == pytest.approx(np.array([[0, 1, 0], [0, 0, -1], [-1, 0, 0]]), abs=0.02)
    assert np.linalg.det(pose.rotation) == pytest.approx(1.0)


@pytest.mark.parametrize("shoulders, hips", [
    (((0.2, 0.0, 3.0), (-0.2, 0.0, 3.0)), ((0.1, 0.0, 3.0), (-0.1, 0.0, 3.0))),
    (((0.0, -0.4, 3.0), (0.0, -0.6, 3.0)), ((0.0, 0.1, 3.0), (0.0, 0.0, 3.0))),
    (((0.2, np.nan, 3.0), (-0.2, -0.5, 3.0)), ((0.1, 0.0, 3.0), (-0.1, 0.0, 3.0))),
    (((0.2, np.inf, 3.0), (-0.2, -0.5, 3.0)), ((0.1, 0.0, 3.0), (-0.1, 0.0, 3.0)))],
    ids=["folded", "in one line", "nan", "inf"])
def test_shoulders_and_hips_that_span_no_frame_give_none(shoulders, hips):
    points = np.zeros((33, 3))
    points[[11, 12]], points[[23, 24]] = shoulders, hips
    assert body_pose(points) is None


class Person:
    """One body over time, by where it seems to be; a face tells where it really is."""

    def __init__(self):
        self._shape, self._track, self._stamp = BodyLocalizer(), None, 0.0

    def seen(self, position, face=False, depth=None):
        """Return the observation of a standing body whose hips seem to be at a position (3,) m, 0.1 s later."""
        points = STANDING + np.asarray(position)
        landmarks = np.zeros((39, 3))
        landmarks[:33, :2] = CAMERA.project(points)
        landmarks[33, :2] = landmarks[[23, 24], :2].mean(axis=0)
        landmarks[34, :2] = landmarks[33, :2] - (0.0, 0.9 * CAMERA.matrix[0, 0] / position[2])
        detection = PoseDetection(PoseEstimate(0.95, landmarks, np.full(39, 0.95), STANDING.copy()), solve_pnp(
            CAMERA.normalise(landmarks[:33, :2]), STANDING, np.ones(33, bool)))
        self._stamp += 0.1
        if self._track is None:
            self._track = BodyTrack("b", detection, self._stamp, TrackLife(self._stamp, 0.0, 1.0))
        self._track.update(detection, self._stamp, False)
        pose = Pose(np.eye(3), points[[1, 4]].mean(axis=0)) if face else None
        return self._shape.observe(self._track, CAMERA, self._stamp, pose, SceneContext(depth))


def squeezed(position):
    """Where a body seems to be that the network makes smaller: the pixel of its hips moves inwards."""
    return tuple(1.3 * np.asarray(position) * (0.97, 1.0, 1.0))


@pytest.mark.parametrize("cut", [AT_LEFT, AT_RIGHT, ABOVE])
def test_a_body_that_is_squeezed_at_the_border_has_no_place_until_it_is_itself_again(cut):
    person = Person()
    for _ in range(5):
        assert person.seen(WHOLE, face=True).pose is not None
    assert person.seen(cut, face=True).pose is not None
    for _ in range(5):
        body = person.seen(squeezed(cut))
        assert body.measured and body.pose is None and np.isnan(body.keypoints_3d).all()
    body = person.seen(cut)
    assert body.pose.translation == pytest.approx(cut, abs=0.1)


def test_a_depth_image_that_does_not_reach_the_border_says_nothing_there():
    """As registered ones, which are narrower than the colour image; one that shows the trunk tells where it is."""
    blind, seeing = Person(), Person()
    for person in (blind, seeing):
        person.seen(WHOLE, face=True)
        person.seen(AT_RIGHT, face=True)
    assert blind.seen(squeezed(AT_RIGHT), depth=np.full((720, 1280), np.nan, np.float32)).pose is None
    body = seeing.seen(squeezed(AT_RIGHT), depth=np.full((720, 1280), AT_RIGHT[2] - 0.1, np.float32))
    assert body.by_depth and body.pose.translation[2] == pytest.approx(AT_RIGHT[2], abs=0.1)


def test_a_face_or_being_seen_whole_tells_that_a_body_is_farther():
    with_face, whole = Person(), Person()
    for person in (with_face, whole):
        person.seen(WHOLE, face=True)
        person.seen(AT_RIGHT, face=True)
    assert with_face.seen(squeezed(AT_RIGHT), face=True).pose is not None
    assert whole.seen(squeezed(WHOLE)).pose is not None


def test_who_turned_round_and_walks_away_at_the_border_has_a_place():
    person = Person()
    person.seen(WHOLE, face=True)
    assert all(person.seen(np.multiply(AT_RIGHT, size)).pose is not None for size in (1.0, 1.15, 1.3, 1.45))


def test_who_is_never_seen_whole_has_a_place():
    person = Person()
    assert all(person.seen((1.6, 0.3, depth)).pose is not None for depth in (3.0, 3.5, 3.2, 3.9))


def test_a_cut_body_is_followed_slowly_and_nearer_at_once():
    known = CutRange()
    assert known.is_right(3.0, 0.0, False, True)
    assert all(known.is_right(3.0 + 0.03 * step, 0.1 * step, True, False) for step in range(1, 30))
    assert known.is_right(2.0, 3.0, True, False)


@pytest.mark.parametrize("sure", [True, False])
def test_of_who_came_in_cut_the_range_is_known_once_a_face_or_a_depth_image_has_told_it(sure):
    known = CutRange()
    assert known.is_right(3.0, 0.0, True, sure)
    assert known.is_right(3.9, 0.1, True, False) is not sure


def test_a_new_range_is_right_in_the_end():
    known = CutRange()
    known.is_right(2.0, 0.0, False, True)
    assert not known.is_right(3.0, 0.5, True, False)
    assert not known.is_right(3.0, 3.0, True, False)
    assert known.is_right(3.0, 20.0, True, False)


def test_the_lower_border_cuts_nobody():
    assert not is_cut(np.array([400.0, 100.0, 600.0, 720.0]), 600.0, 1280)
    assert is_cut(np.array([400.0, 20.0, 600.0, 720.0]), 600.0, 1280)
    assert is_cut(np.array([900.0, 100.0, 1250.0, 720.0]), 600.0, 1280)


@pytest.mark.parametrize("face, leaves", [
    ((640.0, 360.0), False), ((60.0, 360.0), True), ((1220.0, 360.0), True), ((640.0, 60.0), True),
    ((640.0, 700.0), True), ((-20.0, 360.0), True), ((200.0, 200.0), False)])
def test_faces_near_the_border_leave(face, leaves):
    assert is_leaving(np.array(face), 600.0, (1280, 720)) == leaves
