"""Warm start of the joint solver: what it keeps of each body from one frame to the next, one vector per body."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import List, Optional, Sequence

import numpy as np

from hri_fullbody.core.model.human import BRANCHES, LEFT_ARM, RIGHT_ARM, SLOTS, branch_slot
from hri_pipeline.core.image_rotation import ImageRotation

HOLD_TIME = 0.5
"""Time (s) for which a limb that is not seen keeps its joints before it relaxes."""
RELAX_TIME = 1.0
"""Time constant (s) with which it then goes to the rest pose."""
_FOREVER = 1e3

REST_SLOTS = np.zeros(SLOTS)
"""(21,) rad: standing at ease, arms down and slightly bent."""
for _arm in (LEFT_ARM, RIGHT_ARM):
    REST_SLOTS[branch_slot(_arm, 1)] = 0.12
    REST_SLOTS[branch_slot(_arm, 3)] = 0.2
REST_SLOTS.flags.writeable = False

_ROTATION, _POSITION, _SLOTS = slice(0, 9), slice(9, 12), slice(12, 12 + SLOTS)
_SWIVELS = slice(_SLOTS.stop, _SLOTS.stop + 12)
_UNSEEN = slice(_SWIVELS.stop, _SWIVELS.stop + len(BRANCHES))
STATE_SIZE = _UNSEEN.stop

_NEW = np.zeros(STATE_SIZE)
_NEW[_ROTATION] = _NEW[_POSITION] = np.nan
_NEW[_SLOTS] = REST_SLOTS
_NEW[_UNSEEN] = _FOREVER
_NEW.flags.writeable = False


@dataclass
class WarmStart:
    """The previous solution of N bodies.

    known: (N,) whether there is one. rotation (N, 3, 3) and position (N, 3) m of the body, NaN where there is none.
    slots: (N, 21) rad. swivels: (N, 4, 3) unit direction in which each limb's middle joint flexes the distal segment
    (knees: the opposite), in the axes of torso or body; 0 where unknown. unseen: (N, 5) s since each branch was seen.
    """

    known: np.ndarray
    rotation: np.ndarray
    position: np.ndarray
    slots: np.ndarray
    swivels: np.ndarray
    unseen: np.ndarray

    @classmethod
    def of(cls, states: Sequence[Optional[np.ndarray]]) -> "WarmStart":
        """Stack states as `split` gives them; None is a new body. Raises ValueError for anything else."""
        for state in states:
            if state is not None and (not isinstance(state, np.ndarray) or state.shape != (STATE_SIZE,)):
                raise ValueError("a body's state is what solve() gave for it ({} numbers), or None".format(STATE_SIZE))
        vectors = np.array([_NEW if state is None else state for state in states]).reshape(len(states), STATE_SIZE)
        return cls(np.isfinite(vectors[:, 0]), vectors[:, _ROTATION].reshape(-1, 3, 3), vectors[:, _POSITION],
                   vectors[:, _SLOTS], vectors[:, _SWIVELS].reshape(-1, 4, 3), vectors[:, _UNSEEN])

    def turned(self, rotation: ImageRotation) -> WarmStart:
        """Return what it is in a turned frame."""
        return replace(self, rotation=rotation.matrix @ self.rotation, position=rotation.vectors(self.position))

    def split(self) -> List[np.ndarray]:
        """One state per body."""
        count = len(self.slots)
        vectors = np.concatenate([self.rotation.reshape(count, 9), self.position, self.slots,
                                  self.swivels.reshape(count, 12), self.unseen], axis=1)
        return list(vectors)

    def relaxed(self, dt: float) -> np.ndarray:
        """Slots (N, 21) to be taken for branches that are not seen, `dt` (s) after the previous solution."""
        if not (self.unseen > HOLD_TIME - dt).any():
            return self.slots.copy()
        late = np.maximum(np.minimum(dt, self.unseen + dt - HOLD_TIME), 0.0)
        keep = np.exp(-late / RELAX_TIME)
        slots = self.slots.copy()
        branches = slots[:, 1:].reshape(len(slots), len(BRANCHES), -1)
        rest = REST_SLOTS[1:].reshape(len(BRANCHES), -1)
        slots[:, 1:] = (rest + (branches - rest) * keep[:, :, None]).reshape(len(slots), -1)
        return slots
