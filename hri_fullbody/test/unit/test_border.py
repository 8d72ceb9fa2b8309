"""Bodies that the image's border cuts, as a pose network squeezes them into what is left."""

import numpy as np
import pytest
from synthetic_people import STANDING

from hri_fullbody.core.detection.pose_estimator import PoseDetection, PoseEstimate
from hri_fullbody.core.localization.border import CutRange, is_cut, is_leaving
from hri_fullbody.core.localization.localizer import BodyLocalizer, SceneContext, place
from hri_fullbody.core.tracking.track import BodyTrack
from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.tracks import TrackLife

CAMERA = CameraModel.from_fov(1280, 720, 1.05)
WHOLE, AT_LEFT, AT_RIGHT, ABOVE = (0.0, 0.3, 3.0), (-1.45, 0.3, 2.63), (1.45, 0.3, 2.63), (0.0, -0.5, 3.0)


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
        detection = PoseDetection(PoseEstimate(0.95, landmarks, np.full(39, 0.95), STANDING.copy()), place(
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
