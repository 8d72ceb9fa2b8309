import os
import subprocess
import sys

import numpy as np
import pytest
from random_bodies import dimensions, placed, postures
from scipy.spatial.transform import Rotation

from hri_fullbody.core import keypoints as s
from hri_fullbody.core.kinematics.forward import forward
from hri_fullbody.core.kinematics.ikpy_backend import LIMBS, LimbChains, read_chain
from hri_fullbody.core.kinematics.solver import METHODS, JointSolver
from hri_fullbody.core.model.human import PAPER, REP155, sample_pose
from hri_fullbody.core.model.urdf import make_urdf
from hri_pipeline.core.geometry import Pose

LAYOUTS = [pytest.param(layout, id=layout.interface) for layout in (PAPER, REP155)]
FACE = [s.NOSE, s.LEFT_EYE, s.RIGHT_EYE, s.LEFT_EAR, s.RIGHT_EAR]
# A body that faces a camera: its x axis against the view, its z axis up in the image.
FACING = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
UP = np.array([0.0, -1.0, 0.0])


def joint(layout, name):
    return layout.joint_names.index(name)


def inside(layout, q):
    return bool((q >= layout.lower).all() and (q <= layout.upper).all())


def distances(a, b):
    return np.linalg.norm(a - b, axis=-1)


def standing(pose="standing", layout=PAPER, rotation=FACING, seed=0):
    """One person 3 m in front of the camera."""
    body = dimensions(1, seed)
    points, _, _ = forward(rotation[None], np.array([[0.1, 0.2, 3.0]]), sample_pose(pose, layout)[None], body, layout)
    return body, points


FIRST_LIMB = """
import sys
from hri_fullbody.core.kinematics.solver import JointSolver
from random_bodies import dimensions, placed, postures
from hri_fullbody.core.kinematics.forward import forward
from hri_fullbody.core.model.human import PAPER
assert "ikpy" not in sys.modules
body = dimensions(1, 1)
points, _, _ = forward(*placed(1, 3), postures(PAPER, 1, 2, seen=True), body, PAPER)
assert JointSolver(PAPER, "ikpy").solve(points, body, [None]).solved.all()
assert "ikpy" in sys.modules and "sympy" not in sys.modules
import ikpy.link
import sympy
assert ikpy.link.sympy.symbols("x") == sympy.symbols("x"), "who wants symbols has them"
"""


def test_the_first_limb_beyond_its_limits_does_not_wait_for_half_a_thousand_modules():
    subprocess.run([sys.executable, "-c", FIRST_LIMB], check=True, env=dict(os.environ,
                                                                            PYTHONPATH=os.pathsep.join(sys.path)))


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_closed_form_inverts_the_model(layout):
    count = 2000
    bodies, q = dimensions(count, 1), postures(layout, count, 2, seen=True)
    rotation, position = placed(count, 3)
    points, head, place = forward(rotation, position, q, bodies, layout)
    solution = JointSolver(layout, "closed_form", ikpy_limbs=0).solve(points, bodies, [None] * count)
    assert solution.solved.all()
    wrong = np.abs(solution.q - q) > 1e-6
    for side in "lr":  # a shoulder that is pitched a little has two solutions
        first = joint(layout, side + "_y_shoulder")
        wrong[:, first:first + 3] &= q[:, first + 1:first + 2] > 0.81
    assert not wrong.any(), np.argwhere(wrong)[:5]
    assert distances(solution.keypoints, points).max() < 1e-6
    assert np.abs(solution.rotation - rotation).max() < 1e-6 and distances(solution.position, position).max() < 1e-6
    assert np.abs(solution.head_rotation - head).max() < 1e-6 and distances(solution.head_position, place).max() < 1e-6


@pytest.mark.parametrize("layout", LAYOUTS)
def test_any_posture_is_reached_within_a_few_frames(layout):
    """Straight limbs and hanging arms too, where one frame cannot tell the plane of a limb from noise."""
    count = 300
    bodies, q = dimensions(count, 4), postures(layout, count, 5)
    q[:, 0] = 0.0
    points, _, _ = forward(*placed(count, 6), q, bodies, layout)
    solver, states = JointSolver(layout, ikpy_limbs=0), [None] * count
    for _ in range(10):
        solution = solver.solve(points, bodies, states, 0.03)
        states = solution.states
        assert inside(layout, solution.q)
    worst = distances(solution.keypoints, points).max(axis=1)
    # an elbow bent by 0.1 rad in a plane that was never seen stays straight: 26 mm
    assert np.median(worst) < 1e-4 and np.percentile(worst, 98) < 0.035, np.percentile(worst, [50, 90, 95, 98, 100])


@pytest.mark.parametrize("layout", LAYOUTS)
def test_gauss_newton_shares_the_noise(layout):
    count = 200
    bodies, q = dimensions(count, 7), postures(layout, count, 8, seen=True)
    truth, _, _ = forward(*placed(count, 9), q, bodies, layout)
    noisy = truth + np.random.default_rng(10).normal(0.0, 0.01, truth.shape)
    limbs = list(range(2, 14))
    errors = {}
    for method in ("closed_form", "gauss_newton"):
        solution = JointSolver(layout, method, ikpy_limbs=0).solve(noisy, bodies, [None] * count)
        assert inside(layout, solution.q) and solution.solved.all()
        errors[method] = distances(solution.keypoints, truth)[:, limbs].mean()
    assert errors["gauss_newton"] < 0.65 * errors["closed_form"], errors
    assert errors["gauss_newton"] < 0.014, errors


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_batch_is_what_each_body_is_by_itself(layout):
    count = 7
    bodies, q = dimensions(count, 11), postures(layout, count, 12)
    points, _, _ = forward(*placed(count, 13), q, bodies, layout)
    points += np.random.default_rng(14).normal(0.0, 0.02, points.shape)
    points[2, 5:9] = np.nan
    points[4] = np.nan
    heads = [None, Pose(np.eye(3), points[1, s.NOSE]), None, None, None, None, None]
    solver = JointSolver(layout, ikpy_limbs=0)
    states = [None] * count
    for _ in range(3):
        together = solver.solve(points, bodies, states, 0.05, UP, heads)
        for n in range(count):
            alone = solver.solve(points[n:n + 1], bodies[n:n + 1], states[n:n + 1], 0.05, UP, heads[n:n + 1])
            assert alone.solved[0] == together.solved[n] == (n != 4)
            for name in ("q", "rotation", "position", "keypoints", "head_rotation", "head_position"):
                assert np.allclose(getattr(alone, name)[0], getattr(together, name)[n], atol=1e-9, equal_nan=True), name
        states = together.states


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_heading_and_attitude_gives_the_same_joints(layout):
    """Turned about the vertical, lying, upside down: the body does not change, nor does the error."""
    body, points = standing("waving", layout)
    points = points + np.random.default_rng(15).normal(0.0, 0.01, points.shape)
    solver = JointSolver(layout)
    first = solver.solve(points, body, [None])
    turns = [Rotation.from_rotvec(UP * np.deg2rad(angle)) for angle in range(0, 360, 15)]
    turns += [Rotation.from_rotvec(np.deg2rad(angle) * np.array(axis)) for angle in (90.0, 180.0)
              for axis in ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0))]
    for turn in turns:
        solution = solver.solve(turn.apply(points[0])[None], body, [None])
        assert solution.q == pytest.approx(first.q, abs=1e-6)
        assert solution.rotation[0] == pytest.approx(turn.as_matrix() @ first.rotation[0], abs=1e-6)
        assert solution.position[0] == pytest.approx(turn.apply(first.position[0]), abs=1e-6)


def test_with_gravity_whoever_bows_bends_the_waist():
    for angle in (-0.4, 0.0, 0.5, 1.2):
        q = sample_pose("standing")[None].copy()
        q[0, 0] = angle
        body = dimensions(1)
        points, _, _ = forward(FACING[None], np.array([[0.0, 0.0, 3.0]]), q, body)
        solution = JointSolver().solve(points, body, [None], 0.0, UP)
        assert solution.q[0, 0] == pytest.approx(angle, abs=0.03)
        assert solution.rotation[0, :, 2] @ UP > 0.999
        # without gravity the whole body is inclined
        solution = JointSolver().solve(points, body, [None])
        assert solution.q[0, 0] == 0.0 and distances(solution.keypoints, points).max() < 0.03


@pytest.mark.parametrize("axis, angle", [((1.0, 0.0, 0.0), 90.0), ((1.0, 0.0, 0.0), -90.0), ((0.0, 0.0, 1.0), 90.0),
                                         ((0.0, 0.0, 1.0), 180.0)])
def test_with_gravity_whoever_lies_or_hangs_is_straight(axis, angle):
    turn = Rotation.from_rotvec(np.deg2rad(angle) * np.array(axis)).as_matrix()
    body, points = standing(rotation=turn @ FACING)
    solution = JointSolver().solve(points, body, [None], 0.0, UP)
    assert solution.solved[0] and distances(solution.keypoints, points).max() < 0.02
    assert solution.q[0, joint(PAPER, "l_p_hip")] > -0.45


@pytest.mark.parametrize("layout", LAYOUTS)
def test_points_that_are_missing_leave_the_others_right(layout):
    bodies, q = dimensions(1, 16), postures(layout, 1, 17, seen=True)
    points, _, _ = forward(*placed(1, 18), q, bodies, layout)
    solver = JointSolver(layout)
    states = solver.solve(points, bodies, [None]).states
    for gone in range(18):
        seen = points.copy()
        seen[0, gone] = np.nan if gone % 2 else np.inf
        solution = solver.solve(seen, bodies, states, 0.03)
        assert solution.solved[0] and inside(layout, solution.q), gone
        assert distances(solution.keypoints, points).max() < 0.02, (gone, distances(solution.keypoints, points))


@pytest.mark.parametrize("layout", LAYOUTS)
def test_feet_under_a_table_hang_below_the_knees(layout):
    body, points = standing("sitting", layout)
    hidden = points.copy()
    hidden[:, [s.LEFT_ANKLE, s.RIGHT_ANKLE]] = np.nan
    ankles = JointSolver(layout).solve(hidden, body, [None], up=UP).keypoints[0, [s.LEFT_ANKLE, s.RIGHT_ANKLE]]
    assert distances(ankles, points[0, [s.LEFT_ANKLE, s.RIGHT_ANKLE]]).max() < 0.1


def test_legs_behind_a_table_are_held_then_relax():
    body, points = standing("sitting")
    solver = JointSolver()
    solution = solver.solve(points, body, [None], 0.0, UP)
    hip, knee = joint(PAPER, "l_p_hip"), joint(PAPER, "l_knee")
    sitting = solution.q[0, [hip, knee]]
    points[0, [s.LEFT_HIP, s.RIGHT_HIP, s.LEFT_KNEE, s.RIGHT_KNEE, s.LEFT_ANKLE, s.RIGHT_ANKLE]] = np.nan
    seen = {}
    for step in range(1, 61):
        solution = solver.solve(points, body, solution.states, 0.1, UP)
        assert solution.solved[0]
        seen[step] = solution.q[0, [hip, knee]]
        assert distances(solution.keypoints, points)[0, [s.LEFT_WRIST, s.RIGHT_WRIST]].max() < 0.02
    assert seen[4] == pytest.approx(sitting, abs=0.05)
    assert (np.abs(seen[15]) < np.abs(sitting)).all() and (np.abs(seen[15]) > 0.1).all()
    assert np.abs(seen[60]).max() < 0.05


@pytest.mark.parametrize("known", [
    [], [s.NOSE], [s.LEFT_WRIST, s.RIGHT_WRIST, s.LEFT_ANKLE], FACE, [s.LEFT_SHOULDER],
])
def test_too_little_is_said_to_be_too_little(known):
    body, points = standing()
    seen = np.full_like(points, np.nan)
    seen[0, known] = points[0, known]
    solver = JointSolver()
    solution = solver.solve(seen, body, [None])
    assert not solution.solved[0] and np.isnan(solution.q).all() and np.isnan(solution.position).all()
    # a body that was solved before stays where it was
    before = solver.solve(points, body, [None])
    if s.LEFT_SHOULDER not in known:
        after = solver.solve(seen, body, before.states, 0.1)
        assert not after.solved[0]
        assert (after.q == before.q).all() and (after.position == before.position).all()
    again = solver.solve(points, body, solution.states, 0.1)
    assert again.solved[0] and np.isfinite(again.q).all()


def test_garbage_of_one_body_does_not_reach_another():
    bodies = dimensions(4, 19)
    points, _, _ = forward(*placed(4, 20), postures(PAPER, 4, 21, seen=True), bodies)
    bad = points.copy()
    bad[1] = np.nan
    bad[2] = 1e30
    bad[3] = bad[3, s.NECK]  # all in one point
    solver = JointSolver()
    with np.errstate(all="raise", under="ignore"):
        solution = solver.solve(bad, bodies, [None] * 4)
    alone = solver.solve(points[:1], bodies[:1], [None])
    assert list(solution.solved) == [True, False, False, False]
    assert np.allclose(solution.keypoints[0], alone.keypoints[0], atol=1e-12)


@pytest.mark.parametrize("offset", [0.0, 0.08])
def test_the_head_lands_on_the_face(offset):
    body, points = standing()
    face = Pose(FACING @ Rotation.from_euler("zyx", [0.5, 0.2, 0.1]).as_matrix(),
                forward(FACING[None], np.array([[0.1, 0.2, 3.0]]), sample_pose("standing")[None], body)[2][0]
                + np.array([0.0, 0.0, offset]))
    solution = JointSolver().solve(points, body, [None], heads=[face])
    assert np.linalg.norm(solution.head_position[0] - face.translation) < 0.02 + 0.2 * offset
    assert (
        np.rad2deg(np.linalg.norm(Rotation.from_matrix(solution.head_rotation[0].T @ face.rotation).as_rotvec())) < 0.1
    )
    # a face that is another's does not drag the body away
    wrong = Pose(face.rotation, face.translation + np.array([1.5, 0.0, 0.0]))
    solution = JointSolver().solve(points, body, [None], heads=[wrong])
    limbs = [s.LEFT_SHOULDER, s.RIGHT_SHOULDER, s.LEFT_HIP, s.RIGHT_HIP]
    assert distances(solution.keypoints, points)[0, limbs].max() < 0.15


def test_a_head_turned_farther_than_necks_do_stops_at_the_limit():
    body, points = standing()
    face = Pose(FACING @ Rotation.from_euler("z", 2.5).as_matrix(), points[0, s.NOSE])
    solution = JointSolver().solve(points, body, [None], heads=[face])
    assert inside(PAPER, solution.q)
    assert solution.q[0, joint(PAPER, "y_head")] == pytest.approx(PAPER.upper[joint(PAPER, "y_head")], abs=0.2)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_joints_do_not_jump_while_arms_hang_and_limbs_are_straight(layout):
    """A person who stands at ease, breathing and swaying by a few mm, key points trembling by 3 mm, as filtered ones
    do."""
    body = dimensions(1, 22)
    random = np.random.default_rng(23)
    solver, state, before, steps = JointSolver(layout), None, None, []
    for frame in range(150):
        q = np.zeros((1, len(layout)))
        for side in "lr":
            q[0, joint(layout, side + "_p_shoulder")] = 0.05 + 0.08 * np.sin(0.1 * frame)
            q[0, joint(layout, side + "_y_shoulder")] = 0.5 * np.sin(0.07 * frame)
            q[0, joint(layout, side + "_elbow")] = 0.10 + 0.10 * np.sin(0.13 * frame)
            q[0, joint(layout, side + "_knee")] = -0.05
        points, _, _ = forward(FACING[None], np.array([[0.0, 0.0, 3.0]]), q, body, layout)
        solution = solver.solve(points + random.normal(0.0, 0.003, points.shape), body, [state], 1.0 / 30.0)
        state = solution.states[0]
        if before is not None:
            steps.append(np.abs(solution.q - before)[0, 4:])  # the head is as free as the face points tremble
        before = solution.q
    assert np.max(steps) < 0.5, dict(zip(layout.joint_names[4:], np.max(steps, axis=0).round(2)))


@pytest.mark.parametrize("layout", LAYOUTS)
def test_an_elbow_bent_backwards_stays_at_its_limit(layout):
    body, points = standing("standing", layout)
    wrist, elbow = points[0, s.LEFT_WRIST].copy(), points[0, s.LEFT_KNEE].copy()
    ankle = 2.0 * elbow - points[0, s.LEFT_HIP] - FACING[:, 0] * -0.25
    points[0, s.LEFT_ANKLE] = ankle  # a knee bent the wrong way
    for method in METHODS:
        solution = JointSolver(layout, method).solve(points, body, [None])
        assert inside(layout, solution.q), method
        assert np.linalg.norm(solution.keypoints[0, s.LEFT_WRIST] - wrist) < 0.05, method


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_wrist_is_reached_though_the_elbow_is_not_seen(layout):
    reached = []
    bodies = dimensions(8, 24)
    q = np.tile(sample_pose("waving", layout), (8, 1))
    points, _, _ = forward(*placed(8, 25), q, bodies, layout)
    points[:, s.LEFT_ELBOW] = np.nan
    for n in range(8):
        solution = JointSolver(layout).solve(points[n:n + 1], bodies[n:n + 1], [None])
        reached.append(np.linalg.norm(solution.keypoints[0, s.LEFT_WRIST] - points[n, s.LEFT_WRIST]))
        assert inside(layout, solution.q)
    assert np.max(reached) < 0.03, reached


@pytest.mark.parametrize("layout", LAYOUTS)
def test_ikpy_for_everything(layout):
    count = 5
    bodies, q = dimensions(count, 26), postures(layout, count, 27, seen=True)
    points, _, _ = forward(*placed(count, 28), q, bodies, layout)
    solution = JointSolver(layout, "ikpy").solve(points, bodies, [None] * count)
    assert inside(layout, solution.q)
    assert distances(solution.keypoints, points)[:, 2:14].max() < 0.01


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_pose_of_a_limb_that_is_searched_for_is_that_of_ikpy(layout):
    urdf, random = make_urdf(dimensions(1, 31)[0], "x", layout, visuals=False), np.random.default_rng(32)
    for limb in LIMBS:
        joints = [joint for joint in layout.joints if joint.slot > 0 and (joint.slot - 1) // 4 == limb]
        chain = read_chain(urdf, joints[0].parent, joints, "x")
        for _ in range(5):
            angles = chain.active_to_full(random.uniform(-2.0, 2.0, len(joints)), np.zeros(len(chain)))
            wanted = chain.forward_kinematics(angles, full_kinematics=True)[-1]
            assert chain.forward_kinematics(angles) == pytest.approx(wanted, abs=1e-12)


def test_ikpy_refuses_a_urdf_that_is_another():
    body = dimensions(1)[0]
    with pytest.raises(ValueError, match="l_y_shoulder_other"):
        LimbChains(make_urdf(body, "x", visuals=False), "other", PAPER)
    with pytest.raises(ValueError, match="l_y_hip_x"):
        LimbChains(make_urdf(body, "x", PAPER, visuals=False), "x", REP155)


def test_a_coarse_depth_counts_less_where_the_noise_is_known():
    count = 60
    bodies, q = dimensions(count, 29), postures(PAPER, count, 30, seen=True)
    truth, _, _ = forward(*placed(count, 31), q, bodies)
    sigma = np.array([0.005, 0.005, 0.03])
    points = truth + np.random.default_rng(32).normal(0.0, 1.0, truth.shape) * sigma
    errors = []
    for noise in (None, np.tile(sigma, (count, 1))):
        solution = JointSolver(ikpy_limbs=0).solve(points, bodies, [None] * count, noise=noise)
        errors.append(distances(solution.keypoints, truth)[:, 2:14].mean())
    assert errors[1] < 0.97 * errors[0], errors


def test_what_does_not_fit_together_is_refused():
    body, points = standing()
    solver = JointSolver()
    for arguments in ((points[0], body, [None]), (points, body * 2, [None]), (points, body, []),
                      (points, body, [None], 0.0, None, [])):
        with pytest.raises(ValueError, match="expected"):
            solver.solve(*arguments)
    with pytest.raises(ValueError, match="state"):
        solver.solve(points, body, [np.zeros(3)])
    with pytest.raises(ValueError, match="legal: gauss_newton, closed_form, ikpy"):
        JointSolver(method="pinocchio")


def test_nobody_is_nobody():
    solution = JointSolver().solve(np.zeros((0, 18, 3)), [], [])
    assert solution.q.shape == (0, 18) and solution.states == []
