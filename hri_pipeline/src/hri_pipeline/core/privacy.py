"""What a node computes and keeps of people: its privacy notice, as data and as text."""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Sequence, Tuple


@dataclass(frozen=True)
class DataUse:
    """What one node does with what it perceives of people.

    computes: of each person. store: the file in which something is kept, empty for memory only. stored: what.
    max_age: days after which who was not seen is removed from there, 0 for never. encrypted: whether what can identify
    somebody is. agreed: ids of those who have agreed to be recognised.
    """

    computes: Tuple[str, ...]
    store: str = ""
    stored: Tuple[str, ...] = ()
    max_age: float = 0.0
    encrypted: bool = False
    agreed: Tuple[str, ...] = ()


def joined(uses: Sequence[DataUse]) -> DataUse:
    """Return the use of a node that does all of these; one of them at most may keep something."""
    keeps = next((use for use in uses if use.store), DataUse(()))
    return DataUse(tuple(dict.fromkeys(name for use in uses for name in use.computes)), keeps.store, keeps.stored,
                   keeps.max_age, keeps.encrypted, tuple(sorted({name for use in uses for name in use.agreed})))


def notice(uses: Sequence[Tuple[str, DataUse]]) -> str:
    """Return the notice for people to read, of (name of the node, what it does)."""
    lines: List[str] = []
    for node, use in sorted(uses, key=lambda item: item[0]):
        lines.append("{} computes: {}".format(node, ", ".join(use.computes) or "nothing of people"))
        if use.store:
            lines.append("    keeps in {}{}: {}; {}".format(
                use.store, ", encrypted" if use.encrypted else ", not encrypted", ", ".join(use.stored),
                "removed {:g} days after the last time".format(use.max_age) if use.max_age else "without a limit"))
        else:
            lines.append("    keeps nothing beyond the run")
        if use.agreed:
            lines.append("    agreed to be recognised: {}".format(", ".join(use.agreed)))
    return "\n".join(lines)
