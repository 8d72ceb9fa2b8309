"""Time of inverse kinematics: the batched solver, and ikpy beside it on the same images.

Times are of the thread's processor time, and wall-clock beside it: medians over blocks of 38 images, of which the
quickest block counts, since other programs on the machine slow both down (they share caches and cores).
"""

from __future__ import annotations

import time
from typing import Callable, Dict, List, Tuple

import numpy as np

from hri_fullbody.core.body_modeller import BodyInput, BodyModeller
from hri_fullbody.core.human.human_model import PAPER, Dimensions, stack_dimensions
from hri_fullbody.core.human.human_urdf import make_urdf
from hri_fullbody.core.human.segment_table import SegmentTable
from hri_fullbody.core.joints.forward_kinematics import TARGET_POINTS, compute_frames
from hri_fullbody.core.joints.ikpy_solver import LIMBS, LimbChains
from hri_fullbody.core.joints.joint_solver import JointSolver
from hri_fullbody.evaluation.fit_figures import motions
from hri_fullbody.evaluation.noise import add_noise

_NOISE_MM = 10
_WARM_UP, _BLOCK = 10, 38


def solver_ms(table: SegmentTable, count: int, frames: int = 200) -> Tuple[float, float]:
    """Return processor and wall-clock time (ms) of the joints of `count` bodies in one batch: JointSolver.solve."""
    points, dimensions = _bodies(table, count, frames)
    solver = JointSolver()
    states: list = [None] * count

    def one(frame: int) -> None:
        nonlocal states
        states = solver.solve(points[:, frame], dimensions, states, 1.0 / 30.0).states

    return _medians(one, frames)


def modeller_ms(table: SegmentTable, count: int, frames: int = 200) -> Tuple[float, float]:
    """Return processor and wall-clock time (ms) of everything: gate, low pass, stature, joints of `count` bodies."""
    points, _ = _bodies(table, count, frames)
    modeller = BodyModeller(table=table)

    def one(frame: int) -> None:
        modeller.update([BodyInput(str(n), points[n, frame]) for n in range(count)], frame / 30.0)

    return _medians(one, frames)


def ikpy_ms(table: SegmentTable, frames: int = 20) -> Dict[str, float]:
    """Return ikpy's processor time (ms) per body, its four limbs: cold (from zero), warm (from the image before) and
    seeded (from the closed form, with the distal segment's orientation)."""
    points, dimensions = _bodies(table, 1, frames)
    solver = JointSolver(method="closed_form")
    chains = LimbChains(make_urdf(dimensions[0], "body", PAPER, visuals=False), "body", PAPER)
    stacked, state = stack_dimensions(dimensions), [None]
    before = {limb: np.zeros(4) for limb in LIMBS}
    times: Dict[str, List[float]] = {"cold": [], "warm": [], "seeded": []}
    for frame in range(frames):
        solution = solver.solve(points[:, frame], dimensions, state, 1.0 / 30.0)
        state = solution.states
        slots = PAPER.to_slots(solution.q)
        poses = compute_frames(solution.rotation, solution.position, slots, stacked, PAPER)
        spent = dict.fromkeys(times, 0.0)
        for n, limb in enumerate(LIMBS):
            base = poses.torso[0] if n < 2 else solution.rotation[0]
            origin = poses.neck[0] if n < 2 else solution.position[0]
            end = base.T @ (points[0, frame, TARGET_POINTS[8 + n]] - origin)
            closed = slots[0, 1 + 4 * limb:5 + 4 * limb]
            spent["cold"] += _clocked(lambda: chains.solve(limb, np.zeros(4), end))[0]  # noqa: B023 (called at once)
            seconds, before[limb] = _clocked(lambda: chains.solve(limb, before[limb], end))  # noqa: B023
            spent["warm"] += seconds
            turned = base.T @ poses.chain[0, limb, 3]
            spent["seeded"] += _clocked(lambda: chains.solve(limb, closed, end, turned))[0]  # noqa: B023
        for name, seconds in spent.items():
            times[name].append(seconds)
    return {name: round(1e3 * float(np.median(values)), 2) for name, values in times.items()}


def _bodies(table: SegmentTable, count: int, frames: int) -> Tuple[np.ndarray, List[Dimensions]]:
    """Noisy key points (count, frames, 18, 3) m of recordings, and the people's true dimensions."""
    chosen = [motion for motion in motions(table) if len(motion.points) >= 60]
    points, dimensions = [], []
    for n in range(count):
        motion = chosen[n % len(chosen)]
        noisy = add_noise(motion.points, _NOISE_MM, n)
        points.append(noisy[np.arange(frames) % len(noisy)])
        person = motion.person
        lengths = {name: value for name, value in vars(person).items() if name != "stature"}
        dimensions.append(Dimensions.from_segments(person.stature, lengths, table))
    return np.stack(points), dimensions


def _clocked(work: Callable[[], np.ndarray]) -> Tuple[float, np.ndarray]:
    began = time.thread_time()
    result = work()
    return time.thread_time() - began, result


def _medians(one: Callable[[int], None], frames: int) -> Tuple[float, float]:
    """Processor and wall-clock time (ms) of a frame: the least of the blocks' medians."""
    used, passed = [], []
    for frame in range(frames):
        clocks = time.thread_time(), time.perf_counter()
        one(frame)
        used.append(time.thread_time() - clocks[0])
        passed.append(time.perf_counter() - clocks[1])
    starts = range(_WARM_UP, frames - _BLOCK + 1, _BLOCK)
    return tuple(round(1e3 * min(float(np.median(values[start:start + _BLOCK])) for start in starts), 3)
                 for values in (used, passed))  # type: ignore[return-value]
