import io

import numpy as np
import pytest
from ikpy.chain import Chain
from random_bodies import dimensions, placed, postures

from hri_fullbody.core import keypoints as s
from hri_fullbody.core.kinematics.forward import forward
from hri_fullbody.core.model.human import PAPER, REP155
from hri_fullbody.core.model.urdf import make_urdf

LAYOUTS = [pytest.param(layout, id=layout.interface) for layout in (PAPER, REP155)]
# Branches from the root, and the key points where their links begin, counted from the end.
BRANCHES = {
    "l_y_shoulder": ("torso", (s.LEFT_ELBOW, s.LEFT_WRIST)),
    "r_y_shoulder": ("torso", (s.RIGHT_ELBOW, s.RIGHT_WRIST)),
    "l_hip": ("body", (s.LEFT_KNEE, s.LEFT_ANKLE)),
    "r_hip": ("body", (s.RIGHT_KNEE, s.RIGHT_ANKLE)),
    "r_head": ("torso", ()),
}


def poses_by_ikpy(urdf, layout, start, base, q):
    """Poses (4, 4) of a branch's links in the body frame, read from the URDF and computed by ikpy."""
    if start.endswith("hip"):
        start = next(name for name in layout.joint_names if name.startswith(start[:2]) and "hip" in name)
    elements = ["body_x", "waist_x", "waist_x", "torso_x", "torso_x"] if base == "torso" else ["body_x"]
    chain = Chain.from_urdf_file(io.StringIO(urdf), base_elements=elements + [start + "_x"], symbolic=False)
    values = dict(zip((name + "_x" for name in layout.joint_names), q))
    names = [link.name for link in chain.links]
    assert start + "_x" in names
    return dict(zip(names, chain.forward_kinematics([values.get(name, 0.0) for name in names], full_kinematics=True)))


@pytest.mark.filterwarnings("ignore:Link .* is of type 'fixed'")
@pytest.mark.parametrize("layout", LAYOUTS)
def test_it_agrees_with_ikpy_on_the_urdf(layout):
    count = 12
    bodies, q = dimensions(count, 3), postures(layout, count, 4)
    points, head_rotation, head_position = forward(np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3)), q, bodies,
                                                   layout)
    for n in range(count):
        urdf = make_urdf(bodies[n], "x", layout)
        for start, (base, ends) in BRANCHES.items():
            poses = list(poses_by_ikpy(urdf, layout, start, base, q[n]).values())
            for place, point in zip((-2, -1), ends):
                assert np.abs(poses[place][:3, 3] - points[n, point]).max() < 1e-6, (start, place)
        head = poses_by_ikpy(urdf, layout, "r_head", "torso", q[n])["head_x"]
        assert np.abs(head[:3, 3] - head_position[n]).max() < 1e-6
        assert np.abs(head[:3, :3] - head_rotation[n]).max() < 1e-6


@pytest.mark.parametrize("layout", LAYOUTS)
def test_segments_have_their_lengths_wherever_the_body_is(layout):
    count = 50
    bodies = dimensions(count, 1)
    points, rotation, position = forward(*placed(count, 2), postures(layout, count, 3), bodies, layout)
    for n, body in enumerate(bodies):
        def length(a, b, n=n):
            return np.linalg.norm(points[n, a] - points[n, b])
        assert length(s.LEFT_SHOULDER, s.LEFT_ELBOW) == pytest.approx(body.upper_arm)
        assert length(s.RIGHT_ELBOW, s.RIGHT_WRIST) == pytest.approx(body.forearm)
        assert length(s.RIGHT_HIP, s.RIGHT_KNEE) == pytest.approx(body.thigh)
        assert length(s.LEFT_KNEE, s.LEFT_ANKLE) == pytest.approx(body.shank)
        assert length(s.LEFT_HIP, s.RIGHT_HIP) == pytest.approx(2 * body.half_hips)
        assert length(s.LEFT_SHOULDER, s.RIGHT_SHOULDER) == pytest.approx(2 * body.half_shoulders)
        assert points[n, s.NECK] == pytest.approx(points[n, [s.LEFT_SHOULDER, s.RIGHT_SHOULDER]].mean(axis=0))
        face = points[n, [s.NOSE, s.LEFT_EYE, s.RIGHT_EYE, s.LEFT_EAR, s.RIGHT_EAR]]
        assert (face - position[n]) @ rotation[n] == pytest.approx(body.face_points, abs=1e-9)


def test_left_is_left_and_forward_is_forward():
    body = dimensions(1)
    q = np.zeros((1, len(PAPER)))
    q[0, PAPER.joint_names.index("l_p_hip")] = 1.0
    q[0, PAPER.joint_names.index("l_elbow")] = 1.0
    q[0, PAPER.joint_names.index("r_p_shoulder")] = 1.0
    q[0, PAPER.joint_names.index("y_head")] = 1.0
    points, head, _ = forward(np.eye(3)[None], np.zeros((1, 3)), q, body)
    assert points[0, s.LEFT_KNEE, 0] > 0.2  # flexed: forward
    assert points[0, s.LEFT_WRIST, 0] > 0.1  # bent: forward
    assert points[0, s.RIGHT_ELBOW, 1] < points[0, s.RIGHT_SHOULDER, 1] - 0.1  # raised: away from the body
    assert head[0, 1, 0] > 0.5  # turned: to the left
