"""What a picture of the demonstration should show, and what it still lacks: no ROS, no clock of its own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import FrozenSet, List, Mapping, NamedTuple, Optional, Sequence, Tuple

_WORTH = 100     # one thing that is needed counts as much as this many that are only wished for


def seen_and_heard(ids: Sequence[str], features: Mapping[str, Mapping[str, str]]) -> Tuple[List[str], List[str]]:
    """Return the persons with a face or a body, and the others.

    features: {person: {"face_id": id, "body_id": id}}, empty or missing where there is none.
    """
    seen = [person for person in ids if any(features.get(person, {}).values())]
    return seen, [person for person in ids if person not in seen]


@dataclass(frozen=True)
class View:
    """What is there, and what of it is drawn, at one moment.

    persons, faces, bodies: ids that are tracked; no persons who are only a voice. skeletons: bodies that are drawn in
    space; marked: number of persons that are. gazes, groups: numbers of arrows and of discs. overlay: faces and bodies
    on the camera image, None while nothing is known of it. viewed: topics that the viewer listens to.
    """

    persons: FrozenSet[str] = frozenset()
    faces: FrozenSet[str] = frozenset()
    bodies: FrozenSet[str] = frozenset()
    skeletons: FrozenSet[str] = frozenset()
    marked: int = 0
    gazes: int = 0
    groups: int = 0
    overlay: Optional[Tuple[int, int]] = None
    viewed: FrozenSet[str] = frozenset()


class Lack(NamedTuple):
    """What a view lacks, in words.

    absent: how many persons. needed: what every good picture has. wished: what not every source has.
    """

    absent: int
    needed: Sequence[str]
    wished: Sequence[str]

    @property
    def weight(self) -> int:
        """Smaller is better; 0 for a complete view."""
        return _WORTH * (_WORTH * self.absent + len(self.needed)) + len(self.wished)

    @property
    def text(self) -> str:
        """One line."""
        people = ["{} persons".format(self.absent)] if self.absent else []
        return ", ".join(people + list(self.needed) + list(self.wished)) or "nothing"


def lack(view: View, people: int, topics: Sequence[str]) -> Lack:
    """Return what a view lacks that should show `people` persons to a viewer of `topics`."""
    needed = ["{} in the viewer".format(topic) for topic in topics if topic not in view.viewed]
    needed += [name for name, there in (
        ("a name", view.marked), ("a face", view.faces), ("a body", view.bodies),
        ("a skeleton in space", view.skeletons)) if not there]
    wished = [name for name, there in (("gazes", view.gazes), ("groups", view.groups)) if not there]
    # Those of the camera: somebody who is only heard by one microphone has no place, and no name is drawn there.
    wished += _part("names", view.marked, max(len(view.faces), len(view.bodies)))
    wished += _part("skeletons in space", len(view.skeletons & view.bodies), len(view.bodies))
    if len(view.bodies) == 1 and len(view.persons) > 1:
        wished.append("a second body")
    for name, there, number in zip(("faces", "bodies"), (view.faces, view.bodies), view.overlay or (0, 0)):
        if not number:
            needed.append("{} on the camera image".format(name))
        wished += _part("{} on the camera image".format(name), number, len(there))
    return Lack(max(0, people - len(view.persons)), needed, wished)


def _part(name: str, drawn: int, there: int) -> List[str]:
    """Say it where some, but not all are drawn."""
    return ["{} of {} {}".format(there - drawn, there, name)] if 0 < drawn < there else []


class Steady:
    """The worst lack of the last moments: what has just come is not drawn yet.

    seconds: before the present moment.
    """

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._moments: List[Tuple[float, Lack]] = []

    def add(self, now: float, moment: Lack) -> Optional[Lack]:
        """Take the lack of the moment `now` (s); return the worst of the time before, None while that is too short."""
        self._moments.append((now, moment))
        while len(self._moments) > 1 and self._moments[1][0] <= now - self._seconds:
            del self._moments[0]
        if self._moments[0][0] > now - self._seconds:
            return None
        return max((one for _, one in self._moments), key=lambda one: one.weight)


def good_enough(found: Lack, spent: float) -> bool:
    """Tell whether to wait no longer for a better view; spent: part of the time, 0 to 1."""
    return not found.absent and not found.needed and (not found.wished or spent > 0.5)
