"""Which frames of the robot lead from the sensors and the reference frame to their roots.

Only the transforms of those frames are worth keeping with their history. Frames are followed upwards from
child to parent, so no frame of a human ever gets in, whatever its name.
"""

from __future__ import annotations

from collections import OrderedDict
from typing import Generic, List, Optional, Set, Tuple, TypeVar

T = TypeVar("T")

# Frames of humans come and go by the thousand, and no way of the robot leads over one. Not body_ and head_: robots have links
# of such names (head_1_link, head_pan_link, body_link) on the way to their cameras.
_OF_HUMANS = (b"face_", b"gaze_", b"voice_", b"person_")
MAX_FRAMES = 1000       # frames whose latest transform is remembered, in case they become relevant; 1 kB each
MAX_RELEVANT = 500


def is_of_human(child: bytes, fixed: bool) -> bool:
    """Tell whether a frame of that name is a human's. A fixed one (/tf_static) never is: a robot may have a face_plate_link."""
    return not fixed and child.lstrip(b"/").startswith(_OF_HUMANS)


class FrameTree(Generic[T]):
    """Remembers the latest transform of every frame (bounded) and tells which are relevant.

    `T` is the transform as the caller keeps it. When there are too many, moving ones that nobody needs go first: a fixed
    one never comes again.
    """

    def __init__(self, max_frames: int = MAX_FRAMES, max_relevant: int = MAX_RELEVANT) -> None:
        """Remember at most `max_frames` frames and follow at most `max_relevant`."""
        self._max_frames = max_frames
        self._max_relevant = max_relevant
        self._moving: "OrderedDict[str, Tuple[str, T]]" = OrderedDict()
        self._fixed: "OrderedDict[str, Tuple[str, T]]" = OrderedDict()
        self._relevant: Set[str] = set()

    def __len__(self) -> int:
        """Return the number of frames remembered."""
        return len(self._moving) + len(self._fixed)

    @property
    def relevant(self) -> Set[str]:
        """Return the frames that are followed."""
        return set(self._relevant)

    def latest(self, frame: str) -> Optional[T]:
        """Return the latest transform of a frame, None if it is unknown."""
        known = self._find(frame)
        return None if known is None else known[1]

    def put(self, child: str, parent: str, transform: T, fixed: bool) -> List[T]:
        """Take a transform; return those that have to be kept now (itself, and older ones above it)."""
        kept, other = (self._fixed, self._moving) if fixed else (self._moving, self._fixed)
        other.pop(child, None)
        kept[child] = (parent, transform)
        kept.move_to_end(child)
        if len(self) > self._max_frames:
            self._drop_oldest()
        if child not in self._relevant:
            return []
        return [transform] + self.follow(parent)

    def follow(self, frame: str) -> List[T]:
        """Make a frame and all above it relevant; return the transforms known of the new ones."""
        found: List[T] = []
        while frame not in self._relevant and len(self._relevant) < self._max_relevant:
            self._relevant.add(frame)
            known = self._find(frame)
            if known is None:
                break
            frame, transform = known
            found.append(transform)
        return found

    def forget_moving(self) -> List[T]:
        """Forget the moving frames, as after a time jump; return the fixed ones that are relevant."""
        self._moving.clear()
        return [transform for child, (_, transform) in self._fixed.items() if child in self._relevant]

    def _find(self, frame: str) -> Optional[Tuple[str, T]]:
        return self._moving.get(frame) or self._fixed.get(frame)

    def _drop_oldest(self) -> None:
        """Drop the oldest frame nobody needs, a moving one if there is one; else the oldest of all."""
        for frames in (self._moving, self._fixed):
            oldest = next((child for child in frames if child not in self._relevant), None)
            if oldest is not None:
                del frames[oldest]
                return
        (self._moving or self._fixed).popitem(last=False)
