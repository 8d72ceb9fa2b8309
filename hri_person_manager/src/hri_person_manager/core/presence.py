"""Which features are there now: those in the tracked lists, and those that a match has named before its list came."""

from __future__ import annotations

from collections import OrderedDict
from typing import Dict, FrozenSet, Iterable, List, NamedTuple, Set

from hri_person_manager.core.association import FEATURES, Kind, Node
from hri_pipeline.core.ids import is_valid_id

MAX_FEATURES = 200            # per kind; a list with more is cut, and said
PRESUMED_S = 10.0             # lists come once a second: what only matches name for so long, and then not at all, has left
_MAX_GONE = 2000              # features that left are remembered, so that a late match does not bring them back


class Change(NamedTuple):
    """What a tracked list changed. `presumed` are those of `gone` that no list has ever held."""

    gone: List[Node]
    new: List[Node]
    presumed: FrozenSet[Node]


class Presence:
    """The features that are present, kind by kind."""

    def __init__(self) -> None:
        self._living: Dict[Kind, Set[str]] = {kind: set() for kind in FEATURES}
        self._presumed: Dict[Node, float] = {}
        self._gone: "OrderedDict[Node, None]" = OrderedDict()
        self.refused = 0

    def __contains__(self, node: Node) -> bool:
        """Tell whether a feature is present."""
        return node.id in self._living[node.kind]

    def features(self) -> List[Node]:
        """All features that are present, sorted."""
        return [Node(kind, id) for kind in FEATURES for id in sorted(self._living[kind])]

    def tracked(self, kind: Kind, ids: Iterable[str]) -> Change:
        """Take the list of one kind: it alone says who is present. Malformed ids are left out and counted."""
        ids = list(ids)
        valid = [id for id in ids if is_valid_id(id)]
        self.refused += len(ids) - len(valid) + max(0, len(valid) - MAX_FEATURES)
        listed = set(valid[:MAX_FEATURES])
        gone = [Node(kind, id) for id in sorted(self._living[kind] - listed)]
        new = [Node(kind, id) for id in sorted(listed - self._living[kind])]
        presumed = frozenset(node for node in gone if node in self._presumed)
        self._presumed = {node: since for node, since in self._presumed.items() if node.kind != kind}
        self._living[kind] = listed
        for node in gone:
            if node not in presumed:
                self._gone[node] = None
        while len(self._gone) > _MAX_GONE:
            self._gone.popitem(last=False)
        return Change(gone, new, presumed)

    def presume(self, node: Node, now: float) -> bool:
        """Count a feature as present until its list says otherwise; False when it is already, or has just left.

        now: s; a presumption lasts 10 s from the last time that it is made.
        """
        living = self._living[node.kind]
        if node in self._presumed:
            self._presumed[node] = now
        if node.id in living or node in self._gone or len(living) >= MAX_FEATURES:
            return False
        living.add(node.id)
        self._presumed[node] = now
        return True

    def rewind(self, now: float) -> None:
        """Let all presumptions start at `now` (s), as time has jumped back."""
        self._presumed = dict.fromkeys(self._presumed, now)

    def lapsed(self, now: float) -> List[Node]:
        """The presumed features of which nobody has spoken for 10 s, neither match nor list."""
        return sorted(node for node, since in self._presumed.items() if now - since > PRESUMED_S)

    def is_presumed(self, node: Node) -> bool:
        """Tell whether only a match speaks for a feature."""
        return node in self._presumed

    def drop(self, node: Node) -> None:
        """Take back a presumption for which no match speaks any more."""
        self._presumed.pop(node, None)
        self._living[node.kind].discard(node.id)
