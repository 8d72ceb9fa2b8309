"""Where faces and the heads of skeletons are, from single transforms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.head_places import HeadPlaces
from hri_pipeline.core.tf_scan import RawTransform


def link(parent, child, seed=None, stamp=1.0, position=(0.0, 0.0, 2.0)):
    if seed is None:
        return RawTransform(parent, child, int(stamp), int(1e9 * (stamp % 1.0)), position, (0.0, 0.0, 0.0, 1.0))
    turn = tuple(Rotation.random(random_state=seed).as_quat())
    return RawTransform(parent, child, int(stamp), int(1e9 * (stamp % 1.0)), tuple(np.random.default_rng(seed).normal(size=3)), turn)


def followed():
    places = HeadPlaces()
    places.set_tracked("faces", ["f1"])
    places.set_tracked("bodies", ["b1"])
    return places


def test_a_face_is_where_its_frame_is_and_strangers_are_not_wanted():
    places = followed()
    assert places.wants(b"face_f1") and places.wants(b"/head_b1")
    assert not places.wants(b"face_b1") and not places.wants(b"l_arm_b1") and not places.wants(b"map")
    assert places.put(link("camera", "face_f1"), False) == ("faces", "f1", "camera", (0.0, 0.0, 2.0), 1.0)
    assert places.put(link("camera", "face_f2"), False) is None


@pytest.mark.parametrize("order", [(0, 1, 2, 3), (3, 2, 1, 0), (1, 3, 0, 2)])
def test_the_way_from_the_head_to_the_camera_is_found_in_any_order(order):
    chain = [link("camera", "body_b1", 1), link("body_b1", "torso_b1", 2), link("torso_b1", "neck_b1", 3),
             link("neck_b1", "head_b1", 4)]
    places, place = followed(), None
    for _ in range(4):          # what is not wanted yet comes again with the next image
        for index in order:
            if places.wants(chain[index].child.encode()):
                place = places.put(chain[index], index == 2) or place
    pose = Pose.identity()
    for item in chain:
        pose = pose.compose(Pose.from_quaternion(item.rotation, item.translation))
    assert place is not None and place[:3] == ("bodies", "b1", "camera")
    np.testing.assert_allclose(place.position, pose.translation, atol=1e-9)


def test_links_of_different_times_and_broken_numbers_give_no_place():
    places = followed()
    places.put(link("body_b1", "head_b1", stamp=1.0), False)
    assert places.put(link("camera", "body_b1", stamp=1.5), False) is None
    assert places.put(link("camera", "body_b1", stamp=1.1), False) is not None
    assert places.put(link("camera", "face_f1", position=(math.nan, 0.0, 1.0)), False) is None
    assert places.put(link("camera", "face_f1")._replace(rotation=(0.0,) * 4), False) is None


def test_a_loop_ends_and_who_has_gone_is_forgotten():
    places = followed()
    places.put(link("neck_b1", "head_b1"), False)
    places.put(link("head_b1", "neck_b1"), False)
    places.set_tracked("bodies", [])
    assert not places.wants(b"head_b1") and not places.wants(b"neck_b1") and places.wanted == 1
