"""Likelihood of face-body pairs, their matching over time, and what is said about it."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.report import least_cost
from hri_pipeline.core.frames import RawTransform, Timed, scan
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.matching import face_body
from hri_pipeline.core.matching.changes import MatchChanges
from hri_pipeline.core.matching.face_body import (
    FaceBodyMatcher,
    body_points,
    combined,
    face_points,
    head_place,
    likelihoods,
    place_likelihoods,
)
from hri_pipeline.core.matching.parameters import MATCHER_PARAMETERS

ASPECT = 16.0 / 9.0


def human(x, y=0.3, size=0.1):
    """Return landmarks (70, 3) and skeleton (18, 3) of a human whose nose is at x, y; face `size` high."""
    width = size / ASPECT
    landmarks = np.zeros((70, 3))
    landmarks[:, 2] = 1.0
    landmarks[:, 0] = x + width * np.linspace(-0.5, 0.5, 70)
    landmarks[:, 1] = y + size * 0.5 * np.sin(np.arange(70))
    landmarks[36:42, :2] = x - 0.2 * width, y - 0.2 * size
    landmarks[42:48, :2] = x + 0.2 * width, y - 0.2 * size
    landmarks[30, :2] = x, y
    landmarks[0, :2], landmarks[16, :2] = (x - 0.5 * width, y - 0.2 * size), (x + 0.5 * width, y - 0.2 * size)
    skeleton = np.zeros((18, 3))
    for joint, point in ((0, 30), (14, 42), (15, 36), (16, 16), (17, 0)):
        skeleton[joint] = landmarks[point]
    return landmarks, skeleton


def make(faces=(), bodies=(), **given):
    """A matcher with these parameters, and who is tracked."""
    matcher = FaceBodyMatcher(MATCHER_PARAMETERS.resolve(given))
    matcher.set_tracked("faces", faces)
    matcher.set_tracked("bodies", bodies)
    return matcher


def feed(matcher, stamp, faces, bodies):
    """Feed {id: x} of faces and bodies; every id is tracked."""
    matcher.set_tracked("faces", faces)
    matcher.set_tracked("bodies", bodies)
    for name, x in faces.items():
        matcher.add_face(name, stamp, human(x)[0], ASPECT)
    for name, x in bodies.items():
        matcher.add_body(name, stamp, human(x)[1])
    return {(match.face, match.body): match.confidence for match in matcher.matches()}


def plain_face_points(landmarks, aspect):
    """The definition of face_points(), point by point."""
    points = landmarks * np.array([aspect, 1.0, 1.0])
    found = [(*points[indices, :2].mean(axis=0), points[indices, 2].min())
             for indices in ([30], [*range(42, 48)], [*range(36, 42)], [16], [0])]
    seen = points[points[:, 2] > 0.0, :2]
    extent = np.ptp(seen, axis=0) if len(seen) else np.zeros(2)
    return np.array(found + [(math.sqrt(extent[0] * extent[1]), aspect, 0.0)])


@pytest.mark.parametrize("seen", [70, 41, 1, 0])
def test_points_of_a_face_are_means_of_landmarks(seen):
    random = np.random.default_rng(seen)
    landmarks = random.uniform(0.1, 1.0, (70, 3))
    landmarks[random.permutation(70)[seen:], 2] = 0.0
    for aspect in (ASPECT, 1.0):
        assert face_points(landmarks, aspect) == pytest.approx(plain_face_points(landmarks, aspect), abs=1e-12)


def test_points_of_a_face_are_cheap():
    """Ten faces send more than a hundred landmarks a second; it is a sixth (measured)."""
    landmarks = np.random.default_rng(1).uniform(0.1, 1.0, (70, 3))
    plain = least_cost(lambda: plain_face_points(landmarks, ASPECT), 200)
    assert least_cost(lambda: face_points(landmarks, ASPECT), 200) < 0.5 * plain


def test_landmarks_are_reckoned_with_only_near_the_image_of_a_body(monkeypatch):
    """A face is measured in each image, a body in one of ten."""
    reckoned = []
    monkeypatch.setattr(face_body, "face_points", lambda *given: reckoned.append(given) or face_points(*given))
    landmarks, skeleton = human(0.5)
    matcher = make(["f"], ["b"])
    for number in range(40):
        matcher.add_face("f", 0.1 * number, landmarks, 1.0)
        if number % 10 == 0:
            matcher.add_body("b", 0.1 * number, skeleton)
        matcher.matches()
    assert 4 <= len(reckoned) <= 8
    assert [(match.face, match.body) for match in matcher.matches()] == [("f", "b")]


def likelihood(landmarks, skeleton):
    faces, bodies = face_points(landmarks, ASPECT)[None], body_points(skeleton)[None]
    value = float(likelihoods(faces, bodies, 0.3, 0.3)[0, 0])
    return None if np.isnan(value) else value


def test_a_face_on_its_own_body_is_certain_and_falls_with_distance():
    landmarks, skeleton = human(0.5)
    values = [likelihood(landmarks, skeleton + [shift, 0.0, 0.0]) for shift in (0.0, 0.01, 0.02, 0.05, 0.2)]
    assert values[0] == pytest.approx(1.0)
    assert all(later < earlier for earlier, later in zip(values, values[1:]))
    assert values[-1] < 0.01


def test_distances_are_the_same_across_and_along_the_image():
    landmarks, skeleton = human(0.5)
    across = likelihood(landmarks, skeleton + [0.03 / ASPECT, 0.0, 0.0])
    along = likelihood(landmarks, skeleton + [0.0, 0.03, 0.0])
    assert across == pytest.approx(along)


def test_distances_count_in_sizes_of_the_face():
    near, far = human(0.5, size=0.3), human(0.5, size=0.05)
    shift = [0.02, 0.0, 0.0]
    assert likelihood(near[0], near[1] + shift) > 0.9 > 0.3 > likelihood(far[0], far[1] + shift)


@pytest.mark.parametrize("unseen", [[0, 14, 15, 16, 17], [0, 14, 15], [14, 15, 16, 17]])
def test_too_few_points_say_nothing(unseen):
    landmarks, skeleton = human(0.5)
    skeleton[unseen, 2] = 0.0
    assert likelihood(landmarks, skeleton) is None


def test_a_face_without_extent_says_nothing():
    landmarks, skeleton = human(0.5)
    landmarks[:, :2] = 0.5
    assert likelihood(landmarks, skeleton) is None
    assert likelihood(np.zeros((70, 3)), skeleton) is None


def test_five_faces_find_their_five_bodies():
    places = [0.1, 0.25, 0.4, 0.55, 0.7]
    matched = feed(make(), 1.0, {"f%d" % i: x for i, x in enumerate(places)},
                   {"b%d" % i: x + 0.005 for i, x in enumerate(places)})
    assert set(matched) == {("f%d" % i, "b%d" % i) for i in range(5)}
    assert min(matched.values()) > 0.8


def test_two_faces_do_not_share_a_body():
    assert set(feed(make(), 1.0, {"f1": 0.5, "f2": 0.51}, {"b1": 0.511})) == {("f2", "b1")}


def test_a_match_does_not_flicker_between_nearly_equal_bodies():
    matcher = make()
    assert set(feed(matcher, 1.0, {"f1": 0.5}, {"b1": 0.5, "b2": 0.52})) == {("f1", "b1")}
    for step in range(1, 40):
        swap = 0.002 * (-1) ** step
        matched = feed(matcher, 1.0 + step / 15.0, {"f1": 0.51}, {"b1": 0.5 + swap, "b2": 0.52 + swap})
        assert set(matched) == {("f1", "b1")}


def test_a_body_that_begins_anew_takes_the_face_of_its_old_id_which_is_still_listed():
    matcher = make(["f1"], ["old", "new"])
    for step in range(30):
        stamp = 100.0 + 0.1 * step
        matcher.add_face("f1", stamp, human(0.5)[0], ASPECT)
        matcher.add_body("old" if step < 20 else "new", stamp, human(0.5 if step < 20 else 0.505)[1])
        matched = [match.body for match in matcher.matches()]
        assert matched == ["old"] or step > 20
    assert matched == ["new"]


def test_a_match_does_not_stick_to_the_wrong_body():
    matcher = make()
    feed(matcher, 1.0, {"f1": 0.5}, {"b1": 0.5, "b2": 0.6})
    for step in range(1, 16):
        matched = feed(matcher, 1.0 + step / 15.0, {"f1": 0.6}, {"b1": 0.5, "b2": 0.6})
    assert set(matched) == {("f1", "b2")}


def test_images_too_far_apart_are_not_compared():
    matcher = make(["f1"], ["b1"])
    matcher.add_face("f1", 1.0, human(0.5)[0], ASPECT)
    matcher.add_body("b1", 1.3, human(0.5)[1])
    assert matcher.matches() == []
    matcher.add_face("f1", 1.31, human(0.5)[0], ASPECT)
    assert [(match.face, match.body) for match in matcher.matches()] == [("f1", "b1")]


def test_a_slow_skeleton_is_compared_with_the_face_of_its_time():
    matcher = make(["f1"], ["b1"])
    for step in range(10):
        matcher.add_face("f1", 1.0 + step / 30.0, human(0.3 + 0.02 * step)[0], ASPECT)
    matcher.add_body("b1", 1.0, human(0.3)[1])
    assert matcher.matches()[0].confidence == pytest.approx(1.0)


def test_a_pair_ends_with_either_side_and_when_it_cannot_be_compared():
    matcher = make(hold_time=1.0)
    assert feed(matcher, 1.0, {"f1": 0.5}, {"b1": 0.5})
    matcher.set_tracked("faces", [])
    assert matcher.matches() == []
    assert feed(matcher, 2.0, {"f1": 0.5}, {"b1": 0.5})
    matcher.add_body("b1", 2.9, human(0.5)[1])
    assert matcher.matches()
    matcher.add_body("b1", 3.1, human(0.5)[1])
    assert matcher.matches() == []


def test_a_pair_outlives_a_node_that_dies_and_comes_back():
    matcher = make()
    assert feed(matcher, 1.0, {"f1": 0.5}, {"b1": 0.5})
    matcher.add_body("b1", 7.0, human(0.5)[1])
    assert matcher.matches(), "the face is still listed"


def test_a_pair_lasts_while_the_body_shows_no_head_until_another_face_fits():
    """Bodies that wait for their turn are told with points of little confidence: that parts nobody."""
    matcher = make(["f1", "f2"], ["b1"])
    headless = human(0.5)[1] * (1.0, 1.0, 0.1)
    for step in range(150):
        stamp = 100.0 + 0.2 * step
        matcher.add_face("f1", stamp, human(0.5)[0], ASPECT)
        matcher.add_body("b1", stamp, headless if step else human(0.5)[1])
        assert [(match.face, match.body) for match in matcher.matches()] == [("f1", "b1")]
    for step in range(10):
        matcher.add_face("f1", 131.0 + 0.1 * step, human(0.2)[0], ASPECT)
        matcher.add_face("f2", 131.0 + 0.1 * step, human(0.5)[0], ASPECT)
        matcher.add_body("b1", 131.0 + 0.1 * step, human(0.5)[1])
    assert [(match.face, match.body) for match in matcher.matches()] == [("f2", "b1")]


@pytest.mark.parametrize("late", [0, 1, 3, 8])
def test_bodies_are_compared_with_the_faces_of_their_image_which_come_later(late):
    """The camera turns by half a face from image to image; faces come so many images after their bodies."""
    matcher, places = make(["f1"], ["b1"]), [0.2 + 0.05 / ASPECT * step for step in range(24)]
    for step, place in enumerate(places):
        stamp = 50.0 + 0.1 * step
        matcher.add_body("b1", stamp, human(place)[1])
        matcher.matches()
        if step >= late:
            matcher.add_face("f1", stamp - 0.1 * late, human(places[step - late])[0], ASPECT)
        assert [match.confidence for match in matcher.matches()] == pytest.approx([1.0] if step >= late else [])


def test_a_body_is_compared_with_the_last_image_of_a_face_when_no_more_comes():
    matcher = make(["f1"], ["b1"])
    matcher.add_face("f1", 1.0, human(0.5)[0], ASPECT)
    for step in range(1, 6):
        matcher.add_body("b1", 1.0 + 0.1 * step, human(0.5)[1])
        matched = bool(matcher.matches())
    assert matched


def test_time_may_jump_back():
    matcher = make()
    assert feed(matcher, 100.0, {"f1": 0.5}, {"b1": 0.5, "b2": 0.8})
    assert set(feed(matcher, 5.0, {"f1": 0.8}, {"b1": 0.5, "b2": 0.8})) == {("f1", "b2")}


def test_nothing_is_withdrawn_when_the_face_or_the_body_leaves():
    matcher, changes = make(), MatchChanges(0.05)
    matcher.set_tracked("faces", ["f1", "f2"])
    matcher.set_tracked("bodies", ["b2", "b3"])
    changes.update({("f1", "b1"): 0.8, ("f2", "b2"): 0.8, ("f3", "b3"): 0.8}, 0.0)
    assert changes.update({}, 0.1, matcher.has_left) == [(("f2", "b2"), 0.0)]


def test_the_place_of_a_head_follows_from_all_links_to_the_camera():
    chain = [link("neck_b1", "head_b1", 4), link("torso_b1", "neck_b1", 3), link("body_b1", "torso_b1", 2),
             link("camera", "body_b1", 1)]
    pose = Pose.identity()
    for item in chain:
        pose = Pose.from_quaternion(item.rotation, item.translation).compose(pose)
    fixed_neck = [Timed(item, math.inf if item is chain[1] else item.stamp) for item in chain]
    place = head_place(fixed_neck)
    assert place is not None and (place.frame, place.stamp) == ("camera", 1.0)
    np.testing.assert_allclose(place.position, pose.translation, atol=1e-9)


def test_links_of_different_times_and_no_links_give_no_place():
    head, body = link("body_b1", "head_b1", 1), link("camera", "body_b1", 2)
    assert head_place([Timed(head, 1.0), Timed(body, 1.5)]) is None
    assert head_place([Timed(head, 1.0), Timed(body, 1.1)]) is not None
    assert head_place([]) is None and head_place([Timed(body, math.inf)]) is None


def test_the_root_of_the_next_image_which_comes_before_its_joints_moves_no_head_of_the_last_one():
    """The camera turns; a body's frame comes at once, those of its joints when its robot_state_publisher has them."""
    matcher, still = make([], ["b1"]), (0.0, 0.0, 0.0, 1.0)

    def tell(parent, child, way, tenths):
        nanoseconds = 100000000 * tenths
        matcher.add_transforms(*message(RawTransform(parent, child, 1, nanoseconds, (way, 0.0, 0.0), still)), False)
    for tenths, way in enumerate((0.0, 0.0, 0.4)):
        tell("camera", "body_b1", way, tenths)
        if tenths < 2:
            tell("body_b1", "head_b1", 0.0, tenths)
    places = {stamp: float(matcher._places("bodies", ["b1"], stamp)[0, 0]) for stamp in (1.1, 1.2)}
    assert places == pytest.approx({1.1: 0.0, 1.2: 0.4})


def link(parent, child, seed):
    turn = tuple(Rotation.random(random_state=seed).as_quat())
    return RawTransform(parent, child, 1, 0, tuple(np.random.default_rng(seed).normal(size=3)), turn)


def message(*links):
    """Links as the bytes of a message of transforms, and where each is in it."""
    data = struct.pack("<I", len(links))
    for one in links:
        data += struct.pack("<III", 7, one.secs, one.nsecs)
        for name in (one.parent.encode(), one.child.encode()):
            data += struct.pack("<I", len(name)) + name
        data += struct.pack("<7d", *one.translation, *one.rotation)
    return data, scan(data)


@pytest.mark.parametrize("first", [True, False])
def test_fixed_links_of_a_skeleton_come_once_before_those_that_move(first):
    """A robot_state_publisher sends the fixed joints, from p_head to head and from waist to torso, when it starts."""
    matcher = make([], [] if first else ["b1"])
    fixed = link("p_head_b1", "head_b1", 1), link("waist_b1", "torso_b1", 2)
    moving = link("torso_b1", "p_head_b1", 3), link("body_b1", "waist_b1", 4), link("camera", "body_b1", 5)
    matcher.add_transforms(*message(*fixed), True)
    matcher.set_tracked("bodies", ["b1"])
    for _ in range(3):
        matcher.add_transforms(*message(*moving), False)
    assert matcher._history.stamps_of("places of bodies", "b1") == [1.0]


def test_heads_at_one_place_are_likely_and_the_line_of_sight_is_inexact():
    face = np.array([[0.0, 0.0, 2.0]])
    across, along = (place_likelihoods(face, face + [shift])[0, 0] for shift in ((0.4, 0.0, 0.0), (0.0, 0.0, 0.4)))
    assert place_likelihoods(face, face)[0, 0] == pytest.approx(1.0)
    assert across < 0.2 < 0.7 < along
    assert place_likelihoods(face, face + [[0.0, 0.0, 2.0]])[0, 0] < 0.05
    far = np.array([[0.0, 0.0, 8.0]])
    assert place_likelihoods(far, far + [[0.0, 0.0, 1.0]])[0,
                                                           0] > place_likelihoods(face, face + [[0.0, 0.0, 1.0]])[0, 0]
    assert np.isnan(place_likelihoods(face, np.full((1, 3), np.nan))[0, 0])


def test_places_alone_count_where_the_image_tells_nothing_and_the_image_where_there_are_none():
    nothing = np.nan
    fused = combined(np.array([[0.8, 0.8, nothing, nothing]]), np.array([[0.25, nothing, 1.0, nothing]]))
    np.testing.assert_allclose(fused, [[0.4, 0.8, 0.9, nothing]])


def test_of_two_heads_behind_each_other_the_one_at_the_distance_of_the_face_is_its_own():
    matcher = make(["face"], ["near", "away"])
    matcher.add_face("face", 1.0, human(0.5)[0], ASPECT, "camera")
    matcher.add_place("faces", "face", 1.0, (0.0, 0.0, 2.0), "camera")
    for name, shift, depth in (("near", 0.01, 2.2), ("away", 0.0, 5.0)):
        matcher.add_body(name, 1.0, human(0.5 + shift)[1], "camera")
        matcher.add_place("bodies", name, 1.0, (0.05, 0.0, depth), "camera")
    assert [(match.face, match.body) for match in matcher.matches()] == [("face", "near")]


def test_a_body_of_which_the_image_shows_no_face_is_found_by_its_head():
    matcher = make(["face"], ["body"])
    landmarks, skeleton = human(0.5)
    skeleton[[0, 14, 15], 2] = 0.0
    matcher.add_face("face", 1.0, landmarks, ASPECT, "camera")
    matcher.add_body("body", 1.0, skeleton, "camera")
    assert matcher.matches() == []
    matcher.add_place("faces", "face", 1.1, (0.0, 0.0, 2.0), "camera")
    matcher.add_place("bodies", "body", 1.1, (0.1, 0.0, 2.1), "camera")
    matcher.add_face("face", 1.1, landmarks, ASPECT, "camera")
    matcher.add_body("body", 1.1, skeleton, "camera")
    assert [(match.face, match.body) for match in matcher.matches()] == [("face", "body")]


@pytest.mark.parametrize("bare", [("faces",), ("bodies",), ("faces", "bodies")])
def test_who_never_has_points_is_compared_by_places(bare):
    """Packages that send no landmarks, or no skeletons in the image, but frames."""
    matcher, found = make(["fa", "fb"], ["ba", "bb"]), []
    for step in range(30):
        stamp = 50.0 + step / 10.0
        for name, x in (("fa", 0.3), ("fb", 0.7), ("ba", 0.3), ("bb", 0.7)):
            kind = "faces" if name[0] == "f" else "bodies"
            matcher.add_place(kind, name, stamp, (5.0 * (x - 0.5), 0.0, 2.0), "camera")
            if kind in bare:
                continue
            if kind == "faces":
                matcher.add_face(name, stamp, human(x)[0], ASPECT, "camera")
            else:
                matcher.add_body(name, stamp, human(x)[1], "camera")
        found.append({(match.face, match.body) for match in matcher.matches()})
    assert found[0] == set(), "they may be on their way"
    assert found[-1] == {("fa", "ba"), ("fb", "bb")}
    matcher.set_tracked("faces", ["fa"])
    assert {(match.face, match.body) for match in matcher.matches()} == {("fa", "ba")}


def test_points_that_come_late_count_from_then_on():
    matcher = make(["face"], ["near", "away"])
    for step in range(60):
        stamp = 50.0 + step / 10.0
        matcher.add_place("faces", "face", stamp, (0.0, 0.0, 2.0), "camera")
        if step >= 30:
            matcher.add_face("face", stamp, human(0.7)[0], ASPECT, "camera")
        for name, x in (("near", 0.5), ("away", 0.7)):
            matcher.add_body(name, stamp, human(x)[1], "camera")
        matcher.add_place("bodies", "near", stamp, (0.0, 0.0, 2.0), "camera")
        found = [match.body for match in matcher.matches()]
        assert step != 29 or found == ["near"]
    assert found == ["away"]


def test_the_first_points_are_not_mixed_with_the_time_without_any():
    matcher, values = make(["face"], ["body"], smoothing_time=0.0), []
    for step in range(60):
        stamp = 50.0 + step / 10.0
        matcher.add_place("faces", "face", stamp, (0.0, 0.0, 2.0), "camera")
        if step >= 30:
            matcher.add_face("face", stamp, human(0.5)[0], ASPECT, "camera")
        matcher.add_body("body", stamp - 0.05, human(0.5)[1], "camera")
        matcher.add_place("bodies", "body", stamp, (0.0, 0.0, 2.0), "camera")
        values.append(sum(match.confidence for match in matcher.matches()))
    assert min(values[25:]) > 0.85


def test_a_face_whose_points_came_late_is_followed_between_its_images():
    matcher = make(["face"], ["body"])
    for step in range(30):
        matcher.add_place("faces", "face", 50.0 + 0.1 * step, (0.0, 0.0, 2.0), "camera")
    for stamp, x in ((54.0, 0.2), (54.5, 0.4)):
        matcher.add_face("face", stamp, human(x)[0], ASPECT, "camera")
    matcher.add_body("body", 54.25, human(0.3)[1], "camera")
    assert [match.confidence for match in matcher.matches()] == pytest.approx([1.0])


def test_a_clock_that_jumps_back_is_that_of_one_camera():
    matcher = make(["fa", "fb"], ["ba", "bb"])
    for camera in "ab":
        matcher.add_face("f" + camera, 100.0, human(0.5)[0], ASPECT, camera)
        matcher.add_body("b" + camera, 100.0, human(0.5)[1], camera)
    assert len(matcher.matches()) == 2
    matcher.add_face("fa", 10.0, human(0.5)[0], ASPECT, "a")
    assert [(match.face, match.body) for match in matcher.matches()] == [("fb", "bb")]


def test_images_of_different_cameras_are_not_compared():
    matcher = make(["face"], ["here", "there"])
    matcher.add_face("face", 1.0, human(0.5)[0], ASPECT, "left")
    matcher.add_body("there", 1.0, human(0.5)[1], "right")
    assert matcher.matches() == []
    matcher.add_body("here", 1.1, human(0.52)[1], "left")
    matcher.add_face("face", 1.1, human(0.5)[0], ASPECT, "left")
    matcher.add_body("there", 1.1, human(0.5)[1], "right")
    assert [(match.face, match.body) for match in matcher.matches()] == [("face", "here")]


def test_two_images_of_one_time_are_not_compared_either():
    matcher = make(["left", "right"], ["body"])
    matcher.add_face("left", 1.0, human(0.5)[0], ASPECT, "left")
    matcher.add_face("right", 1.0, human(0.2)[0], ASPECT, "right")
    matcher.add_body("body", 1.0, human(0.5)[1], "right")
    assert matcher.matches() == []


@pytest.mark.parametrize("late", [0.3, 0.8, 1.6, 4.6])
def test_bodies_that_come_late_are_compared_with_the_faces_of_their_image(late):
    """On a busy machine the bodies of an image come seconds after its faces; people walk past each other meanwhile."""
    matcher, changes = make(), MatchChanges(0.05)
    matcher.set_tracked("faces", ["f1", "f2"])
    matcher.set_tracked("bodies", ["b1", "b2"])
    matched, published = [], []
    for step in range(90):
        now = 10.0 + step / 15.0
        places = {"1": 0.2 + 0.1 * (now - 10.0), "2": 0.8 - 0.1 * (now - 10.0)}
        for name, x in places.items():
            matcher.add_face("f" + name, now, human(x)[0], ASPECT)
        if step % 14 == 0 and now - late >= 10.0:
            seen = round((now - late - 10.0) * 15.0) / 15.0
            for name, x in (("b1", 0.2 + 0.1 * seen), ("b2", 0.8 - 0.1 * seen)):
                matcher.add_body(name, 10.0 + seen, human(x)[1])
        matches = matcher.matches()
        matched.append({(match.face, match.body) for match in matches})
        published += changes.update({(match.face, match.body): match.confidence for match in matches}, now,
                                    matcher.has_left)
    assert matched[-1] == {("f1", "b1"), ("f2", "b2")}
    assert all(pairs <= matched[-1] for pairs in matched)
    assert all(likelihood > 0.0 for _, likelihood in published)


@pytest.mark.parametrize("late", [3.0, 4.0, 5.0])
@pytest.mark.parametrize("kind", ["faces", "bodies"])
@pytest.mark.parametrize("every", [2, 3])
def test_who_is_seen_rarely_and_late_stays_matched(kind, late, every):
    """Seen in every second or third image, each of which takes `late` s; the other kind is on time."""
    matcher, changes, published = make(["f1", "f2"], ["b1", "b2"]), MatchChanges(0.05), []
    seen = {"1": human(0.5), "2": human(0.2)}
    add = {"faces": lambda stamp, name: matcher.add_face("f" + name, stamp, seen[name][0], ASPECT, "camera"),
           "bodies": lambda stamp, name: matcher.add_body("b" + name, stamp, seen[name][1], "camera")}
    on_time = add.pop("faces" if kind == "bodies" else "bodies")
    for step in range(600):
        on_time(100.0 + 0.1 * step, "1")
        if step and step % round(10.0 * late) == 0:
            add[kind](100.0 + 0.1 * step - late, "2" if step % round(10.0 * late * every) else "1")
        published += changes.update({(match.face, match.body): match.confidence for match in matcher.matches()},
                                    0.1 * step, matcher.has_left)
    assert published and all(likelihood > 0.0 for _, likelihood in published)


def test_a_face_that_moves_is_compared_where_it_was_between_two_images():
    """A busy machine gives faces two images a second, and bodies others."""
    matcher = make(["f1", "f2"], ["b1"])
    for stamp in (1.0, 1.5):
        matcher.add_face("f1", stamp, human(0.2 + 0.2 * (stamp - 1.0))[0], ASPECT)
        matcher.add_face("f2", stamp, human(0.3 - 0.2 * (stamp - 1.0))[0], ASPECT)
    matcher.add_body("b1", 1.22, human(0.244)[1])
    matches = matcher.matches()
    assert [(match.face, match.body) for match in matches] == [("f1", "b1")]
    assert matches[0].confidence == pytest.approx(1.0)


def test_a_face_that_was_away_for_long_was_not_between_its_images():
    matcher = make(["f1"], ["b1"])
    for stamp in (1.0, 2.0):
        matcher.add_face("f1", stamp, human(0.5)[0], ASPECT)
    matcher.add_body("b1", 1.5, human(0.5)[1])
    assert matcher.matches() == []


def test_the_image_of_a_body_in_which_a_face_is_counts_and_not_a_later_one_without():
    matcher = make(["f1"], ["b1"])
    for stamp in (1.0, 2.0):
        matcher.add_face("f1", stamp, human(0.5)[0], ASPECT)
    for stamp in (1.0, 1.5):
        matcher.add_body("b1", stamp, human(0.5)[1])
    assert [(match.face, match.body) for match in matcher.matches()] == [("f1", "b1")]


@pytest.mark.parametrize("late", [1.0, 4.0])
@pytest.mark.parametrize("kind", ["faces", "bodies"])
def test_one_late_camera_of_two(kind, late):
    matcher, matched = make(["fa", "fb"], ["ba", "bb"]), []
    for step in range(120):
        for camera in "ab":
            for one in ("faces", "bodies"):
                stamp = 100.0 + 0.1 * step - (late if camera == "b" and one == kind else 0.0)
                if one == "faces":
                    matcher.add_face("f" + camera, stamp, human(0.5)[0], ASPECT, camera)
                else:
                    matcher.add_body("b" + camera, stamp, human(0.5)[1], camera)
        matched.append({(match.face, match.body) for match in matcher.matches()})
    assert matched[-1] == {("fa", "ba"), ("fb", "bb")}
    assert sum(("fb", "bb") in pairs for pairs in matched) >= 120 - 10 * late - 2


def test_what_is_kept_of_faces_and_bodies_is_bounded():
    matcher = make(["f1"], ["b1"])
    for step in range(3000):
        matcher.add_face("f1", 100.0 + step / 30.0, human(0.5)[0], ASPECT)
        matcher.add_body("b1", 100.0 + step / 30.0, human(0.5)[1])
    assert len(matcher._history.stamps_of("faces", "f1")) <= 12 * 30 + 1
    assert len(matcher._history.stamps_of("bodies", "b1")) <= 12 * 30 + 1


def test_nothing_is_kept_of_faces_and_bodies_that_have_left():
    """Each pair is seen by another camera."""
    matcher, kept, (landmarks, skeleton) = make(), [], human(0.5)
    for number in range(20):
        face, body, camera, stamp = "f%d" % number, "b%d" % number, "camera%d" % number, 100.0 + number
        matcher.set_tracked("faces", [face])
        matcher.set_tracked("bodies", [body])
        matcher.add_face(face, stamp, landmarks, ASPECT, camera)
        matcher.add_body(body, stamp, skeleton, camera)
        assert len(matcher.matches()) == 1
        for kind, name in (("faces", face), ("bodies", body)):
            matcher.add_place(kind, name, stamp, (0.0, 0.0, 2.0), camera)
            assert matcher._history.stamps(kind) == matcher._history.stamps("places of " + kind) == {stamp}
        kept.append(sum(len(value) for value in vars(matcher).values() if isinstance(value, (dict, set))))
    assert set(kept) == {kept[0]}


def test_bodies_of_one_image_that_come_one_by_one_are_all_compared():
    matcher = make(["f1", "f2"], ["b1", "b2"])
    for name, x in (("f1", 0.2), ("f2", 0.8)):
        matcher.add_face(name, 1.0, human(x)[0], ASPECT)
    for name, x in (("b1", 0.2), ("b2", 0.8)):
        matcher.add_body(name, 1.0, human(x)[1])
        matches = matcher.matches()
    assert {(match.face, match.body) for match in matches} == {("f1", "b1"), ("f2", "b2")}


@pytest.mark.parametrize("frame", ["camera", "", "garbage"])
@pytest.mark.parametrize("stamp", [4e9, 1.0])
def test_a_message_of_another_time_or_camera_costs_a_moment(frame, stamp):
    matcher = make(["f1"], ["b1"])
    for step in range(30):
        now = 100.0 + 0.1 * step
        matcher.add_face("f1", now, human(0.5)[0], ASPECT, "camera")
        matcher.add_body("b1", now, human(0.5)[1], "camera")
        if step == 10:
            matcher.add_face("f1", stamp, human(0.5)[0], ASPECT, frame)
        if step == 15:
            matcher.add_body("b1", stamp, human(0.5)[1], frame)
        matches = matcher.matches()
        assert [(match.face, match.body) for match in matches] == [("f1", "b1")] or step in (10, 11, 15, 16)


@pytest.mark.parametrize("begin", [0.0, 1.6e9])
@pytest.mark.parametrize("rate", [15.0, 20.0, 40.0, 60.0])
def test_a_face_that_looks_away_at_any_rate(rate, begin):
    """The last stamp of the face then lies on the very rim of what is compared."""
    matcher = make(["f1"], ["b1"])
    for step in range(200):
        stamp = begin + step / rate
        if step % 50 < 40:
            matcher.add_face("f1", stamp, human(0.5)[0], ASPECT)
        matcher.add_body("b1", stamp, human(0.5)[1])
        assert [(match.face, match.body) for match in matcher.matches()] == [("f1", "b1")]


@pytest.mark.parametrize("ahead", [1000.0, -5.0, 5.0])
def test_two_cameras_whose_clocks_differ(ahead):
    matcher = make(["fa", "fb"], ["ba", "bb"])
    for step in range(60):
        for name, x, stamp, camera in (("a", 0.5, 2000.0 + 0.1 * step, "A"),
                                       ("b", 0.8, 2000.0 + ahead + 0.1 * step, "B")):
            matcher.add_face("f" + name, stamp, human(x)[0], ASPECT, camera)
            if step >= 6:
                matcher.add_body("b" + name, stamp - 0.6, human(x)[1], camera)
        if step >= 6:
            assert {(match.face, match.body) for match in matcher.matches()} == {("fa", "ba"), ("fb", "bb")}


@pytest.mark.parametrize("camera", ["A", "B"])
def test_another_face_before_the_own_one_costs_nothing(camera):
    """At 5 images a second none but those of the same image are near enough, and each comes by itself."""
    matcher = make(["other", "own"], ["b1"])
    for step in range(20):
        stamp = 100.0 + step / 5.0
        matcher.add_face("other", stamp, human(0.2)[0], ASPECT, camera)
        matcher.matches()
        matcher.add_body("b1", stamp, human(0.5)[1], "B")
        matcher.matches()
        matcher.add_face("own", stamp, human(0.5)[0], ASPECT, "B")
        assert [(match.face, match.body) for match in matcher.matches()] == [("own", "b1")]


def test_the_place_of_a_head_may_come_after_its_skeleton():
    matcher = make(["f1"], ["b1"])
    landmarks, skeleton = human(0.5)
    skeleton[:, 2] = 0.0
    for step in range(10):
        stamp = 100.0 + step / 3.0
        matcher.add_face("f1", stamp, landmarks, ASPECT)
        matcher.add_body("b1", stamp, skeleton)
        matcher.matches()
        for kind, name in (("faces", "f1"), ("bodies", "b1")):
            matcher.add_place(kind, name, stamp, (0.1, 0.2, 2.0))
        assert [(match.face, match.body) for match in matcher.matches()] == [("f1", "b1")]


def test_a_bag_that_loops_with_bodies_that_come_late():
    """The last bodies of a loop come after the first faces of the next; who is there is there at once."""
    matcher, length, late, matched = make(), 100, 15, []
    matcher.set_tracked("faces", ["f1"])
    matcher.set_tracked("bodies", ["b1"])
    for step in range(3 * length):
        matcher.add_face("f1", 50.0 + 0.1 * (step % length), human(0.5)[0], ASPECT, "camera")
        if step >= late:
            matcher.add_body("b1", 50.0 + 0.1 * ((step - late) % length), human(0.5)[1], "camera")
        matched.append(len(matcher.matches()))
    assert sum(matched) >= len(matched) - 3 * (late + 2)


def test_who_is_not_tracked_moves_no_clock():
    matcher = make(["f1"], ["b1"])
    for step in range(20):
        stamp = 100.0 + 0.1 * step
        for name, when in (("f1", stamp), ("stranger", stamp - 1.0)):
            matcher.add_face(name, when, human(0.5)[0], ASPECT)
        matcher.add_body("b1", stamp, human(0.5)[1])
        assert len(matcher.matches()) == 1


@pytest.mark.parametrize("aspect", [1e-6, 1e9, 4.0 / 3.0])
def test_the_shape_of_the_image_of_one_face_is_no_matter_of_the_others(aspect):
    """A damaged message, or a second camera with images of another shape."""
    expected = feed(make(), 1.0, {"fa": 0.3, "fb": 0.7}, {"ba": 0.31, "bb": 0.69})
    matcher = make(["fa", "fb", "other"], ["ba", "bb"])
    for name, x in (("fa", 0.3), ("fb", 0.7)):
        matcher.add_face(name, 1.0, human(x)[0], ASPECT)
    matcher.add_face("other", 1.0, human(0.1)[0], aspect)
    for name, x in (("ba", 0.31), ("bb", 0.69)):
        matcher.add_body(name, 1.0, human(x)[1])
    found = {(match.face, match.body): match.confidence for match in matcher.matches()}
    assert {pair: value for pair, value in found.items() if pair[0] != "other"} == pytest.approx(expected)


def test_a_body_waits_until_it_was_compared_with_all_faces():
    matcher = make(["fa", "fb"], ["ba"])
    assert not matcher.awaits_faces, "no skeleton yet"
    matcher.add_face("fa", 1.0, human(0.3)[0], ASPECT)
    matcher.add_body("ba", 1.0, human(0.3)[1])
    assert matcher.awaits_faces
    assert len(matcher.matches()) == 1
    assert matcher.awaits_faces, "the other face may come yet"
    matcher.add_face("fb", 1.0, human(0.7)[0], ASPECT)
    matcher.matches()
    assert not matcher.awaits_faces
    matcher.add_face("fa", 1.1, human(0.3)[0], ASPECT)
    assert not matcher.awaits_faces, "a newer image of faces says nothing of the body"
    matcher.set_tracked("faces", ["fa", "fb", "new"])
    assert matcher.awaits_faces
    matcher.set_tracked("faces", ["fa", "fb"])
    matcher.add_body("ba", 1.2, human(0.3)[1])
    assert matcher.awaits_faces
