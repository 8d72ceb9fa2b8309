"""Which frames of the robot lead from the sensors and the reference frame to their roots.

Only the transforms of those frames are worth keeping with their history. Frames are followed upwards from
child to parent, so no frame of a human ever gets in, whatever its name.
"""

from __future__ import annotations

from collections import OrderedDict
from typing import Dict, Generic, List, Optional, Set, Tuple, TypeVar

T = TypeVar("T")

MAX_FRAMES = 5000       # frames whose latest transform is remembered, in case they become relevant
MAX_RELEVANT = 500


class FrameTree(Generic[T]):
    """Remembers the latest transform of every frame (bounded) and tells which are relevant.

    `T` is the transform as the caller keeps it.
    """

    def __init__(self, max_frames: int = MAX_FRAMES, max_relevant: int = MAX_RELEVANT) -> None:
        """Remember at most `max_frames` frames and follow at most `max_relevant`."""
        self._max_frames = max_frames
        self._max_relevant = max_relevant
        self._latest: "OrderedDict[str, Tuple[str, T]]" = OrderedDict()
        self._fixed: Set[str] = set()
        self._relevant: Set[str] = set()

    def __len__(self) -> int:
        """Return the number of frames remembered."""
        return len(self._latest)

    @property
    def relevant(self) -> Set[str]:
        """Return the frames that are followed."""
        return set(self._relevant)

    def latest(self, frame: str) -> Optional[T]:
        """Return the latest transform of a frame, None if it is unknown."""
        known = self._latest.get(frame)
        return None if known is None else known[1]

    def put(self, child: str, parent: str, transform: T, fixed: bool) -> List[T]:
        """Take a transform; return those that have to be kept now (itself, and older ones above it)."""
        self._latest[child] = (parent, transform)
        self._latest.move_to_end(child)
        if fixed:
            self._fixed.add(child)
        while len(self._latest) > self._max_frames:
            self._drop_oldest()
        if child not in self._relevant:
            return []
        return [transform] + self.follow(parent)

    def follow(self, frame: str) -> List[T]:
        """Make a frame and all above it relevant; return the transforms known of the new ones."""
        found: List[T] = []
        while frame not in self._relevant and len(self._relevant) < self._max_relevant:
            self._relevant.add(frame)
            if frame not in self._latest:
                break
            frame, transform = self._latest[frame]
            found.append(transform)
        return found

    def forget_moving(self) -> List[T]:
        """Forget the moving frames, as after a time jump; return the fixed ones that are relevant."""
        kept: Dict[str, Tuple[str, T]] = {child: value for child, value in self._latest.items()
                                          if child in self._fixed}
        self._latest = OrderedDict(kept)
        return [transform for child, (_, transform) in kept.items() if child in self._relevant]

    def _drop_oldest(self) -> None:
        """Drop the oldest frame nobody needs; a fixed transform that is relevant never comes again."""
        for child in self._latest:
            if child not in self._relevant:
                del self._latest[child]
                self._fixed.discard(child)
                return
        self._latest.popitem(last=False)
