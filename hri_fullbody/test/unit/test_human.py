import shutil
import subprocess
from xml.etree import ElementTree

import numpy as np
import pytest
from random_bodies import TABLE, dimensions

from hri_fullbody.core.model.human import PAPER, POSE_NAMES, REP155, STATURE_RANGE, Dimensions, layout_for, sample_pose
from hri_fullbody.core.model.urdf import link_names, make_urdf

LAYOUTS = [pytest.param(layout, id=layout.interface) for layout in (PAPER, REP155)]
# Figure 2 of the paper, REP-155's tree.
FIFTEEN = {"waist", "torso", "head"} | {side + part for side in ("l_", "r_")
                                        for part in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")}
REP155_JOINTS = (
    ("waist", "r_head", "y_head", "p_head")
    + tuple(side + name for side in ("l_", "r_") for name in ("y_shoulder", "p_shoulder", "r_shoulder", "elbow"))
    + tuple(side + name for side in ("l_", "r_") for name in ("y_hip", "p_hip", "r_hip", "knee")))


def test_the_papers_joints_are_18_and_the_reps_20():
    assert REP155.joint_names == REP155_JOINTS
    assert PAPER.joint_names == tuple(name for name in REP155_JOINTS if not name.endswith("y_hip"))
    assert (len(PAPER), len(REP155)) == (18, 20)
    assert layout_for("paper") is PAPER and layout_for("rep155") is REP155
    with pytest.raises(ValueError, match="legal: paper, rep155"):
        layout_for("rep120")


@pytest.mark.parametrize("layout", LAYOUTS)
def test_slots_hold_every_joint_once(layout):
    q = np.arange(1.0, len(layout) + 1.0)[None]
    assert (layout.from_slots(layout.to_slots(q)) == q).all()
    assert layout.to_slots(q).sum() == q.sum()


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("name", POSE_NAMES)
def test_what_people_do_is_inside_the_limits(layout, name):
    pose = sample_pose(name, layout)
    assert ((layout.lower <= pose) & (pose <= layout.upper)).all()


def test_sitting_is_sitting_in_both_layouts():
    from hri_fullbody.core import keypoints as skeleton
    from hri_fullbody.core.kinematics.forward import forward
    for layout in (PAPER, REP155):
        points = forward(np.eye(3)[None], np.zeros((1, 3)), sample_pose("sitting", layout)[None],
                         [Dimensions.from_stature(1.7, TABLE)], layout)[0][0]
        for hip, knee, ankle in ((skeleton.LEFT_HIP, skeleton.LEFT_KNEE, skeleton.LEFT_ANKLE),
                                 (skeleton.RIGHT_HIP, skeleton.RIGHT_KNEE, skeleton.RIGHT_ANKLE)):
            assert points[knee, 0] - points[hip, 0] > 0.35 and abs(points[knee, 2] - points[hip, 2]) < 0.1
            assert points[knee, 2] - points[ankle, 2] > 0.35


def test_a_pose_that_does_not_exist_is_told():
    with pytest.raises(ValueError, match="standing, sitting"):
        sample_pose("flying")


@pytest.mark.parametrize("stature", [0.0, 0.39, 2.7, float("nan"), float("inf"), -1.7])
def test_an_impossible_stature_is_refused(stature):
    with pytest.raises(ValueError, match="stature is .* legal: 0.4 to 2.6 m"):
        Dimensions.from_stature(stature, TABLE)


def test_known_lengths_replace_the_mean():
    body = Dimensions.from_segments(1.8, {"thigh": 0.40, "neck": 0.2}, TABLE)
    assert (body.thigh, body.neck) == (0.40, 0.2)
    assert body.shank == pytest.approx(1.8 * 0.241)
    # pivot and skull base share the neck
    assert body.neck_pivot + body.head_offset[2] == pytest.approx(0.2 + 0.043 * 1.8 / 1.7)


@pytest.mark.parametrize("lengths, message", [
    ({"tigh": 0.4}, "no segments tigh; known: upper_arm"),
    ({"thigh": 4.0}, "thigh is 4 m, legal: 0.163 to 1.02 m"),
    ({"thigh": float("nan")}, "thigh is nan m"),
])
def test_impossible_lengths_are_refused(lengths, message):
    with pytest.raises(ValueError, match=message):
        Dimensions.from_segments(1.7, lengths, TABLE)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_urdf_is_a_tree_of_the_papers_links(layout):
    root = ElementTree.fromstring(make_urdf(Dimensions.from_stature(1.7, TABLE), "ab1", layout))
    links = [link.get("name") for link in root.findall("link")]
    joints = root.findall("joint")
    assert len(set(links)) == len(links) == len(joints) + 1
    assert {name + "_ab1" for name in FIFTEEN} < set(links)
    assert set(links) == {name + "_ab1" for name in link_names(layout)}
    moving = [joint.get("name") for joint in joints if joint.get("type") == "revolute"]
    assert moving == [name + "_ab1" for name in layout.joint_names]
    assert {joint.find("child").get("link") for joint in joints} == set(links) - {"body_ab1"}
    assert all(joint.find("parent").get("link") in links for joint in joints)
    assert not root.findall(".//inertial") and not root.findall(".//mesh")
    known = {material.get("name") for material in root.findall("material")}
    assert {material.get("name") for material in root.findall(".//visual/material")} <= known


def test_every_part_can_be_seen():
    root = ElementTree.fromstring(make_urdf(Dimensions.from_stature(1.7, TABLE), "x"))
    seen = {link.get("name")[:-2] for link in root.findall("link") if link.find("visual") is not None}
    assert seen == (FIFTEEN - {"waist"}) | {"body"}


@pytest.mark.parametrize("stature", STATURE_RANGE)
def test_the_body_is_as_tall_as_it_says(stature):
    """Highest and lowest point of what is seen, standing straight."""
    from hri_fullbody.core.model.urdf import body_shapes
    body = Dimensions.from_stature(stature, TABLE)
    shapes = body_shapes(body)
    top = max(shape.place[2] + shape.radius for shape in shapes["head"] if shape.length == 0.0)
    bottom = min(shape.place[2] - shape.radius for shape in shapes["l_ankle"] if shape.length == 0.0)
    height = (top + body.head_offset[2] + body.neck_pivot + body.trunk) - (bottom - body.shank - body.thigh)
    assert height == pytest.approx(stature, rel=0.01)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_check_urdf_is_content(layout, tmp_path):
    if shutil.which("check_urdf") is None:
        pytest.skip("check_urdf is not installed (package liburdfdom-tools)")
    for index, body in enumerate(dimensions(3)):
        path = tmp_path / "{}.urdf".format(index)
        path.write_text(make_urdf(body, "b{}".format(index), layout), encoding="utf-8")
        result = subprocess.run(["check_urdf", str(path)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, timeout=20)
        assert result.returncode == 0, result.stderr
        assert b"Successfully Parsed" in result.stdout and not result.stderr, result.stderr


@pytest.mark.parametrize("name", ["a;b", "a<b", "", "9x", "a b", "a\n", 'a"b', "../a", "a" * 33, None, "é"])
def test_an_id_that_is_none_is_refused(name):
    with pytest.raises(ValueError, match="body id"):
        make_urdf(Dimensions.from_stature(1.7, TABLE), name)
