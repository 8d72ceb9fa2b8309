"""The whole chain on made people: poses, headings, revisions, bodies that fail, time."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import List

import numpy as np
import pytest

from hri_fullbody.core.kinematics.forward import forward
from hri_fullbody.core.kinematics.solver import JointSolver
from hri_fullbody.core.model.anthropometry import SegmentTable
from hri_fullbody.core.model.human import PAPER, Dimensions
from hri_fullbody.core.modeller import BodyInput, BodyModeller, turned_model
from hri_fullbody.core.parameters import BODIES
from hri_fullbody.core.pipeline import BodyPipeline
from hri_pipeline.core.image_rotation import ImageRotation
from hri_pipeline.core.observations import BodyObservation

TABLE = SegmentTable.load()
UP = np.array([0.0, -1.0, 0.0])
# Columns: forward, left and up of a human who faces the camera, in the optical frame.
FACING = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])


def person(heading: float = 0.0, stature: float = 1.7, distance: float = 2.5, upside_down: bool = False) -> np.ndarray:
    """Key points (18, 3) m in the optical frame; heading: rad about the vertical, 0 faces the camera."""
    c, s = np.cos(heading), np.sin(heading)
    turn = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]) @ FACING
    if upside_down:
        turn = np.diag([-1.0, -1.0, 1.0]) @ turn
    q = np.zeros((1, len(PAPER.joint_names)))
    q[0, [PAPER.joint_names.index(name) for name in ("l_p_shoulder", "l_elbow", "r_elbow", "l_p_hip", "l_knee")]] = (
        0.7, 0.5, 0.9, 0.4, -0.6)
    points, _, _ = forward(turn[None], np.array([[0.0, 0.2, distance]]), q, [Dimensions.from_stature(stature, TABLE)],
                           PAPER)
    return points[0]


def run(modeller: BodyModeller, frames: List[List[BodyInput]], start: float = 0.0) -> list:
    """Update at 30 Hz; what came out each time, by id."""
    return [{body.id: body for body in modeller.update(frame, start + n / 30.0, UP)} for n, frame in enumerate(frames)]


@pytest.mark.parametrize("arguments", [
    {"interface": "rep156"}, {"ik_solver": "magic"}, {"stature_tolerance": 0.0}, {"min_confidence": 2.0},
    {"model_delay": -1.0}, {"stature_window": 0.0}])
def test_illegal_settings_are_refused(arguments: dict) -> None:
    with pytest.raises(ValueError):
        BodyModeller(table=TABLE, **arguments)


def in_the_lens(*seen: int) -> np.ndarray:
    """Key points that are all at the optical centre, of which only some are seen."""
    points = np.full((18, 3), np.nan)
    points[list(seen)] = 0.0
    return points


@pytest.mark.parametrize("odd, size", [
    (in_the_lens(*range(18)), None), (in_the_lens(2, 7, 8, 14), None), (person(), (0.1, 0.001))])
def test_a_body_that_is_no_human_costs_the_others_nothing(odd: np.ndarray, size: object) -> None:
    modeller = BodyModeller(table=TABLE)
    found = run(modeller, 8 * [[BodyInput("odd", odd, size=size), BodyInput("good", person())]])
    assert all("good" in one for one in found) and found[-1]["good"].residual < 0.02
    assert all(np.linalg.det(body.pose.rotation) == pytest.approx(1.0) for one in found for body in one.values())


def test_the_parameters_build_a_modeller() -> None:
    modeller = BodyModeller.from_parameters(BODIES.resolve({}))
    assert len(modeller.layout.joint_names) == 18
    modeller = BodyModeller.from_parameters(BODIES.resolve({"interface": "rep155"}))
    assert len(modeller.layout.joint_names) == 20


@pytest.mark.parametrize("degrees", range(0, 360, 30))
def test_the_model_faces_as_the_person_does(degrees: int) -> None:
    points = person(np.radians(degrees))
    body = run(BodyModeller(table=TABLE), [[BodyInput("a", points)]] * 12)[-1]["a"]
    forward_axis = body.pose.rotation[:, 0]
    heading = np.degrees(np.arctan2(-forward_axis[0], -forward_axis[2]))
    assert abs((heading - degrees + 180.0) % 360.0 - 180.0) < 3.0
    assert np.linalg.norm(body.fitted - points, axis=1).max() < 0.03
    assert np.linalg.norm(body.head.translation - points[[14, 15]].mean(axis=0)) < 0.03


def test_the_model_is_ready_early_and_not_made_anew() -> None:
    random = np.random.default_rng(1)
    found = run(BodyModeller(table=TABLE), [
        [BodyInput("a", person() + random.normal(size=(18, 3)) * 0.01)] for _ in range(150)])
    assert found[2]["a"].revision == 0 and found[9]["a"].revision == 1 and found[-1]["a"].revision == 1
    assert found[-1]["a"].dimensions is found[9]["a"].dimensions
    assert found[-1]["a"].stature == pytest.approx(1.7, abs=0.05) and 0.0 < found[-1]["a"].stature_sd < 0.06
    assert found[-1]["a"].residual < 0.02
    assert len(found[-1]["a"].joints) == 18


def test_a_body_that_cannot_be_solved_is_told_and_leaves_the_others_alone() -> None:
    good, nothing = person(), np.full((18, 3), np.nan)
    faces_only = np.where(np.isin(np.arange(18), [0, 14, 15, 16, 17])[:, None], person(), np.nan)
    modeller, alone = BodyModeller(table=TABLE), BodyModeller(table=TABLE)
    unsure = BodyInput("unsure", good, np.zeros(18))
    frame = [BodyInput("none", nothing), BodyInput("good", good), BodyInput("face", faces_only), unsure,
             BodyInput("shape", np.zeros((5, 3))), BodyInput("infinite", np.full((18, 3), np.inf))]
    found = run(modeller, [frame] * 15)
    expected = run(alone, [[BodyInput("good", good)]] * 15)
    assert set(found[-1]) == {"good"}
    assert set(modeller.failures) == {"none", "face", "unsure", "shape", "infinite"}
    assert all(reason for reason in modeller.failures.values())
    assert np.allclose(found[-1]["good"].joints, expected[-1]["good"].joints, atol=1e-9)
    assert run(modeller, [[BodyInput("good", good)]], 1.0) and not modeller.failures


def test_an_upside_down_person_is_modelled_and_nobody_else_suffers() -> None:
    modeller = BodyModeller(table=TABLE)
    frame = [BodyInput("down", person(upside_down=True)), BodyInput("good", person())]
    found = run(modeller, [frame] * 15)[-1]
    assert not modeller.failures and found["good"].residual < 0.02 and found["down"].residual < 0.02
    assert found["good"].pose.rotation[1, 2] < -0.9 and found["down"].pose.rotation[1, 2] > 0.9
    for body in found.values():
        assert np.isfinite(body.joints).all() and np.isfinite(body.fitted).all()


def test_one_body_whose_solution_raises_does_not_take_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    modeller = BodyModeller(table=TABLE)
    solve = JointSolver.solve

    def fails_for_far_ones(solver: object, points: np.ndarray, *rest: object) -> object:
        if (points[:, 1, 2] > 5.0).any():
            raise np.linalg.LinAlgError("singular")
        return solve(solver, points, *rest)

    monkeypatch.setattr(JointSolver, "solve", fails_for_far_ones)
    found = run(modeller, [[BodyInput("far", person(distance=6.0)), BodyInput("near", person())]] * 3)
    assert set(found[-1]) == {"near"} and "singular" in modeller.failures["far"]


def test_a_hidden_arm_is_held() -> None:
    points, hidden = person(), person()
    hidden[[3, 4]] = np.nan
    found = run(BodyModeller(table=TABLE), [[BodyInput("a", points)]] * 15 + [[BodyInput("a", hidden)]] * 5)
    before, after = found[14]["a"].fitted, found[-1]["a"].fitted
    assert np.linalg.norm(after[4] - before[4]) < 0.03
    assert np.isnan(found[-1]["a"].points[[3, 4]]).all()


def test_bodies_are_forgotten() -> None:
    modeller = BodyModeller(table=TABLE)
    frame = [BodyInput("a", person()), BodyInput("b", person(stature=1.5))]
    assert run(modeller, [frame] * 15)[-1]["a"].revision == 1
    modeller.retain(["b"])
    assert {name: body.revision for name, body in run(modeller, [frame], 1.0)[0].items()} == {"a": 0, "b": 1}
    modeller.reset()
    assert {body.revision for body in run(modeller, [frame], 0.0)[0].values()} == {0}


def test_time_that_goes_back_keeps_the_revision() -> None:
    modeller = BodyModeller(table=TABLE)
    run(modeller, [[BodyInput("a", person())]] * 15, 100.0)
    moved = person(heading=1.0, distance=4.0)
    body = run(modeller, [[BodyInput("a", moved)]], 5.0)[0]["a"]
    assert body.revision == 1
    assert np.linalg.norm(body.fitted - moved, axis=1).max() < 0.05


@pytest.mark.parametrize("bodies, stamp", [
    ([BodyInput("a", person()), BodyInput("a", person())], 0.0), ([BodyInput("a", person())], float("nan"))])
def test_wrong_calls_are_refused(bodies: list, stamp: float) -> None:
    with pytest.raises(ValueError):
        BodyModeller(table=TABLE).update(bodies, stamp)


def test_nobody_is_nothing() -> None:
    assert BodyModeller(table=TABLE).update([], 0.0) == []


def test_only_the_stature_gives_mean_proportions() -> None:
    body = run(BodyModeller(table=TABLE, limb_lengths=False), [[BodyInput("a", person(stature=1.8))]] * 15)[-1]["a"]
    assert body.dimensions.thigh == pytest.approx(body.dimensions.stature * TABLE.ratio("thigh"))


def test_unsure_points_of_a_guess_say_nothing_about_the_stature() -> None:
    short = person(stature=1.7)
    short[[9, 10, 12, 13]] = short[[8, 8, 11, 11]] + 0.3 * (short[[9, 10, 12, 13]] - short[[8, 8, 11, 11]])
    confidence = np.ones(18)
    confidence[[9, 10, 12, 13]] = 0.5
    found = {}
    for name, systematic in (("measured", 0.0), ("guessed", 0.09)):
        body = run(BodyModeller(table=TABLE), [[BodyInput("a", short, confidence, None, systematic)]] * 15)[-1]["a"]
        found[name] = body.dimensions.shank / TABLE.ratio("shank")
    assert found["guessed"] == pytest.approx(1.7, abs=0.1) and found["measured"] < 1.5


@pytest.mark.parametrize("systematic", [-0.1, 2.0, float("nan")])
def test_an_illegal_systematic_error_is_told(systematic: float) -> None:
    modeller = BodyModeller(table=TABLE)
    assert modeller.update([BodyInput("a", person(), systematic=systematic)], 0.0) == []
    assert "systematic" in modeller.failures["a"]


def seen_body(name: str = "abcde", measured: bool = True) -> BodyObservation:
    """An observation of a standing person, in pixels and in metres."""
    model, = BodyModeller(table=TABLE).update([BodyInput(name, person())], 1.0, UP)
    keypoints = np.column_stack([np.tile([320.0, 240.0], (18, 1)), np.ones(18)])
    return BodyObservation(name, np.array([100.0, 50.0, 300.0, 450.0]), 0.9, keypoints, model.points, model.pose,
                           measured=measured)


def without_networks() -> BodyPipeline:
    return BodyPipeline(BODIES.resolve({}), pose=SimpleNamespace(), detector=SimpleNamespace())


def test_what_a_body_expresses_is_told_of_the_image_in_which_it_was_looked_at() -> None:
    pipeline = without_networks()
    for index in range(5):
        pipeline.fit([seen_body()], 0.1 * index, UP, (640, 480))
        assert pipeline.behaviour("abcde", 0.1 * index) is not None
    pipeline.fit([seen_body(measured=False)], 0.5, UP, (640, 480))
    assert pipeline.behaviour("abcde", 0.5) is None
    assert pipeline.model(seen_body(measured=False)) is not None and "standing" in pipeline.label("abcde")
    pipeline.fit([seen_body(measured=False)], 1.5, UP, (640, 480))
    assert "standing" not in pipeline.label("abcde")


def test_keys_of_diagnostics_are_the_same_for_whoever_is_there() -> None:
    pipeline = without_networks()
    keys = set(pipeline.status())
    pipeline.fit([seen_body("abcde"), seen_body("fghij")], 0.0, UP, (640, 480))
    values = pipeline.status()
    assert not [key for key in values if "abcde" in key or "fghij" in key]
    assert keys <= set(values) and values["statures_m"] == "abcde unknown, fghij unknown"


def test_a_body_that_cannot_be_told_of_costs_no_other() -> None:
    pipeline = without_networks()
    bad = replace(seen_body("fghij"), keypoints=np.ones((5, 3)))
    pipeline.fit([seen_body("abcde"), bad, seen_body("klmno")], 0.0, UP, (640, 480))
    for body in ("abcde", "klmno"):
        assert pipeline.behaviour(body, 0.0) is not None
    assert pipeline.behaviour("fghij", 0.0) is None


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_a_modeller_whose_images_turn_goes_on_as_if_they_had_not(quarters: int) -> None:
    turn, noise = ImageRotation(quarters, 640, 480), np.random.default_rng(3).normal(0.0, 0.01, (40, 18, 3))
    straight, turned = BodyModeller(table=TABLE), BodyModeller(table=TABLE)
    for number, error in enumerate(noise):
        points, stamp = person(0.02 * number) + error, number / 30.0
        wanted = straight.update([BodyInput("a", points)], stamp, UP)[0]
        if number == 20:
            turned.turn(turn)
        found = (turned_model(turned.update([BodyInput("a", turn.vectors(points))], stamp, turn.vectors(UP))[0],
                              turn.back) if number >= 20 else
                 turned.update([BodyInput("a", points)], stamp, UP)[0])
        assert found.points == pytest.approx(wanted.points, abs=1e-6)
        assert found.fitted == pytest.approx(wanted.fitted, abs=2e-3)
        assert found.pose.differs(wanted.pose) == pytest.approx((0.0, 0.0), abs=5e-3)
        assert found.stature == pytest.approx(wanted.stature, abs=1e-3)
