"""Features that a match names before the tracked list of their kind does: they count as present until the list, or silence, says otherwise."""

from __future__ import annotations

from typing import Iterable, List

from hri_person_manager.core.association import Kind, Node
from hri_person_manager.core.live_association import LiveAssociation
from hri_person_manager.core.presence import Presence


class Presumptions:
    """Begins and ends them in the presence of features and in the association."""

    def __init__(self, presence: Presence, association: LiveAssociation, allowed: bool) -> None:
        """allowed: False when a feature has to be listed first."""
        self._presence, self._association, self._allowed = presence, association, allowed

    def begin(self, nodes: Iterable[Node], now: float) -> List[Node]:
        """Count those of the nodes as present that are features and not listed yet; returns those that were not present. now: s."""
        arrived = [node for node in nodes if self._allowed and node.kind != Kind.PERSON and self._presence.presume(node, now)]
        if arrived:
            self._association.arrive(arrived)
        return arrived

    def end(self, nodes: Iterable[Node]) -> bool:
        """Drop those of the nodes for which only matches spoke that are withdrawn; returns whether there was one."""
        over = [node for node in nodes if node.kind != Kind.PERSON and self._presence.is_presumed(node)
                and not self._association.neighbours(node)]
        for node in over:
            self._presence.drop(node)
            self._association.drop(node)
        return bool(over)

    def lapse(self, now: float) -> bool:
        """Drop those of whom nobody has spoken for long, and solve again who belongs together; returns whether there was one. now: s."""
        lapsed = self._presence.lapsed(now)
        for node in lapsed:
            self._presence.drop(node)
        self._association.solve([other for node in lapsed for other in self._association.leave(node)])
        return bool(lapsed)
