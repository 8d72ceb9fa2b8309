"""Inverse kinematics of limbs by ikpy, on chains that it reads from a body's URDF text.

Bounded by the limits, and slow: some milliseconds per limb. (Symbolic chains would be twice as fast, but take tenths of
a second to make for each body.) Taken for limbs that the closed form puts far outside their limits, for limbs whose
middle joint is not seen and cannot be guessed within them, and for everything where a user wants it (`ik_solver:
ikpy`).
"""

from __future__ import annotations

import importlib
import inspect
import io
import math
import sys
from contextlib import contextmanager
from functools import cached_property
from types import ModuleType
from typing import Dict, Iterator, List, Optional, Sequence, Tuple, Union

import numpy as np

from hri_fullbody.core.kinematics.forward import about_vector
from hri_fullbody.core.model.human import LEFT_ARM, LEFT_LEG, RIGHT_ARM, RIGHT_LEG, Joint, Layout


class _WhenNeeded(ModuleType):
    """Stands for a module, and loads it when something of it is asked for."""

    def __getattr__(self, name: str) -> object:
        return getattr(importlib.import_module(self.__name__), name)


@contextmanager
def _without_loading(name: str) -> Iterator[None]:
    """Let what is imported within the block have `name` only when it uses it."""
    stand_in = _WhenNeeded(name)
    is_ours = sys.modules.setdefault(name, stand_in) is stand_in
    try:
        yield
    finally:
        if is_ours:
            del sys.modules[name]


# It makes symbolic chains only, and takes the processor half a second and more, and 40 MB: images would wait for it
# when a limb is beyond its limits for the first time.
with _without_loading("sympy"):
    from ikpy import inverse_kinematics as ikpy_optimisation
    from ikpy.chain import Chain

LIMBS = (LEFT_ARM, RIGHT_ARM, LEFT_LEG, RIGHT_LEG)
_TOLERANCE = 1e-3  # ends the search a millimetre or so short of the optimum, three times as fast
_EVALUATIONS = 40  # of the forward kinematics, about six steps of the search: from a good start more gain nothing
_INSIDE = 1e-6  # rad that the start must lie inside the limits
# ikpy 3.x, the newest for Python 3.8, has neither; there the chain counts.
_OPTIONS: Dict[str, float] = {"tol": _TOLERANCE, "optimizer_budget": _EVALUATIONS}
_KNOWN_OPTIONS = inspect.signature(ikpy_optimisation.inverse_kinematic_optimization).parameters
_HAS_BUDGET = all(name in _KNOWN_OPTIONS for name in _OPTIONS)


class _Enough(Exception):
    """The search has had its evaluations."""


class LimbChain(Chain):
    """A chain whose search ends after a number of evaluations, with the best that it found."""

    _target: Optional[Tuple[np.ndarray, Optional[np.ndarray]]] = None

    @cached_property
    def _still(self) -> List[Tuple[np.ndarray, Optional[np.ndarray]]]:
        """Of each link the pose (4, 4) before it is turned, and the axis (3,) that it turns about, None for a fixed
        one: ikpy makes both anew each time."""
        return [(np.asarray(link.get_link_frame_matrix(0.0), dtype=np.float64),
                 np.asarray(link.rotation, dtype=np.float64) if link.has_rotation else None) for link in self.links]

    def within_budget(self, position: np.ndarray, orientation: Optional[np.ndarray], start: np.ndarray) -> np.ndarray:
        """Joint values (L,) rad of all links: ikpy's inverse kinematics from `start`, within the limits."""
        options = {} if orientation is None else {"target_orientation": orientation, "orientation_mode": "all"}
        if _HAS_BUDGET:
            return self.inverse_kinematics(target_position=position, initial_position=start, **options, **_OPTIONS)
        self._left, self._best, self._error = _EVALUATIONS, start, np.inf
        self._target = (position, orientation)
        try:
            return self.inverse_kinematics(target_position=position, initial_position=start, **options)
        except _Enough:
            return self._best
        finally:
            self._target = None

    def forward_kinematics(self, joints: Union[List, np.ndarray], full_kinematics: bool = False) -> np.ndarray:
        """As ikpy's, in a quarter of the time; during a search of an old ikpy it counts, and remembers the best
        joints."""
        if full_kinematics:
            return super().forward_kinematics(joints, full_kinematics)
        pose = np.eye(4)
        for (still, axis), angle in zip(self._still, joints):
            pose = pose @ still
            if axis is not None:
                x, y, z = (axis * angle).tolist()
                pose[:3, :3] = pose[:3, :3] @ about_vector(x, y, z, math.inf)
        if self._target is None:
            return pose
        position, orientation = self._target
        error = float(((pose[:3, 3] - position) ** 2).sum())
        if orientation is not None:
            error += float(((pose[:3, :3] - orientation) ** 2).sum())
        if error < self._error:
            self._best, self._error = np.array(joints), error
        self._left -= 1
        if self._left <= 0:
            raise _Enough()
        return pose


def read_chain(urdf: str, base: str, joints: Sequence[Joint], body_id: str) -> LimbChain:
    """Chain from the link `base` through `joints` (names without the id) to the last link after them.

    Raises ValueError when the URDF has no such chain.
    """
    names = [joint.name + "_" + body_id for joint in joints]
    # ikpy begins with a link of its own; the last joint is the fixed one to hand or foot
    mask = [False] + [True] * len(names) + [False]
    try:
        chain = LimbChain.from_urdf_file(io.StringIO(urdf), base_elements=[base + "_" + body_id, names[0]],
                                         active_links_mask=mask, symbolic=False)
    except (ValueError, AttributeError, IndexError) as error:  # ikpy does not check what it reads
        raise ValueError("the URDF has no chain of {} from {}_{}: {}".format(
            ", ".join(names), base, body_id, error)) from error
    found = [link.name for link in chain.links[1:-1]]
    if found != names:
        raise ValueError("the URDF has the joints {} where {} are expected".format(", ".join(found), ", ".join(names)))
    return chain


class LimbChains:
    """The four limbs of one body. Angles are the branch's four slots; targets are in the axes and from the origin of
    the link that the limb hangs on: torso for arms, body for legs."""

    def __init__(self, urdf: str, body_id: str, layout: Layout) -> None:
        """Read the chains out of a URDF made by `make_urdf`. Raises ValueError when they are not there."""
        self._levels: Dict[int, np.ndarray] = {}
        self._chains: Dict[int, LimbChain] = {}
        self._bounds: Dict[int, np.ndarray] = {}
        for limb in LIMBS:
            joints = [joint for joint in layout.joints if (joint.slot - 1) // 4 == limb and joint.slot > 0]
            self._chains[limb] = read_chain(urdf, joints[0].parent, joints, body_id)
            self._levels[limb] = np.array([(joint.slot - 1) % 4 for joint in joints])
            self._bounds[limb] = np.array([(joint.lower + _INSIDE, joint.upper - _INSIDE) for joint in joints]).T

    def solve(self, limb: int, start: np.ndarray, position: np.ndarray,
              orientation: Optional[np.ndarray] = None) -> np.ndarray:
        """Angles (4,) rad, within the limits, that bring the end of a limb close to a place.

        start: (4,) rad where to begin. position: (3,) m of wrist or ankle; orientation: (3, 3) of the distal segment,
        None where it does not matter (then the middle joint is where the start leaves it).
        """
        levels, chain = self._levels[limb], self._chains[limb]
        lower, upper = self._bounds[limb]
        begin = self._full(limb, np.minimum(np.maximum(start[levels], lower), upper))
        found = chain.active_from_full(chain.within_budget(position, orientation, begin))
        angles = np.zeros(4)
        angles[levels] = np.minimum(np.maximum(found, lower), upper)
        return angles

    def forward(self, limb: int, angles: np.ndarray) -> List[np.ndarray]:
        """Poses (4, 4) of the limb's links by ikpy's own forward kinematics, the base first."""
        full = self._full(limb, angles[self._levels[limb]])
        return list(self._chains[limb].forward_kinematics(full, full_kinematics=True))

    def _full(self, limb: int, active: np.ndarray) -> np.ndarray:
        chain = self._chains[limb]
        return chain.active_to_full(active, np.zeros(len(chain)))
