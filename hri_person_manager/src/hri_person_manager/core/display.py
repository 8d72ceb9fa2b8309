"""Persons as text for people: the live table of `show_persons`, and the match graph in the language of GraphViz."""

from __future__ import annotations

import unicodedata
from collections import deque
from dataclasses import asdict, dataclass
from typing import Deque, Dict, Iterable, List, Optional, Sequence, Tuple

from hri_person_manager.core.features import Kind, MatchNode
from hri_person_manager.core.persons import Snapshot

RATE_WINDOW_S = 2.0
REPORT_WAIT_S = 5.0
_SHAPES = {Kind.PERSON: "box", Kind.FACE: "ellipse", Kind.BODY: "hexagon", Kind.VOICE: "cds"}
Edge = Tuple[MatchNode, MatchNode, float]


@dataclass(frozen=True)
class PersonRow:
    """One person: position in `frame` in m, age of the newest transform in ms; None where unknown, as the confidence
    of who is not tracked."""

    id: str
    face: str
    body: str
    voice: str
    confidence: Optional[float]
    position: Optional[Tuple[float, float, float]]
    frame: str
    age_ms: Optional[float]

    @property
    def is_voice(self) -> bool:
        """Whether there is nothing but a voice."""
        return bool(self.voice) and not (self.face or self.body)

    @property
    def is_in_view(self) -> bool:
        """Whether a camera sees this person now, who is tracked by more than a voice and not where seen earlier."""
        return not self.is_voice and self.confidence is not None and not 0.0 < self.confidence < 1.0


class RateMeter:
    """Images per second of the last seconds out of their stamps; many features of one image count once."""

    def __init__(self) -> None:
        self._events: Deque[Tuple[float, float]] = deque(maxlen=1000)

    def add(self, stamp: float, now: float) -> None:
        """Take the image stamp (s) of a feature that arrived at `now` (s)."""
        if not any(stamp == known for known, _ in self._events):
            self._events.append((stamp, now))

    def rate(self, now: float) -> float:
        """Return the rate in images per second at time `now` (s)."""
        while self._events and not 0.0 <= now - self._events[0][1] <= RATE_WINDOW_S:
            self._events.popleft()
        if len(self._events) < 2:
            return 0.0
        span = self._events[-1][1] - self._events[0][1]
        return (len(self._events) - 1) / span if span > 0.0 else 0.0


def format_table(rows: Sequence[PersonRow], face_rate: float, body_rate: float, note: str = "",
                 nobody: str = "nobody yet") -> str:
    """Return the table as plain text, with `note` as its last line, without a newline at the end.

    Without rows it says `nobody`. Persons out of view stand below the others, and below them who is only a voice; all
    are counted apart. Without a place there is no confidence.
    """
    lines = ["%-22s  %-6s %-6s %-6s %10s  %-22s %-20s %7s" % (
        "person", "face", "body", "voice", "confidence", "position x y z (m)", "frame", "age ms")]
    for row in sorted(rows, key=lambda row: (row.is_voice, not row.is_in_view)):
        position = "%6.2f %6.2f %6.2f" % row.position if row.position is not None else "-"
        age = "%7.0f" % row.age_ms if row.age_ms is not None else "      -"
        confidence = "-" if row.position is None or row.confidence is None else "%.2f" % row.confidence
        lines.append("%-22s  %-6s %-6s %-6s %10s  %-22s %-20s %s" % (
            row.id, row.face or "-", row.body or "-", row.voice or "-", confidence, position,
            row.frame or "-", age))
    if not rows:
        lines.append(nobody)
    lines.append("%s; faces found in %.1f images/s, bodies in %.1f images/s" % (_counts(rows), face_rate, body_rate))
    return "\n".join(lines + [note] if note else lines)


def _counts(rows: Sequence[PersonRow]) -> str:
    """How many there are in view, and apart from them how many out of view and how many who are only a voice."""
    heard, seen = sum(row.is_voice for row in rows), sum(row.is_in_view for row in rows)
    away = len(rows) - heard - seen
    return "%d person%s in view" % (seen, "" if seen == 1 else "s") + (", %d out of view" % away if away else "") + (
        ", %d voice%s" % (heard, "" if heard == 1 else "s") if heard else "")


class CameraStatus:
    """Why nobody is there, by what nodes report of their cameras: nobody yet, or no images.

    A node that has not reported for REPORT_WAIT_S has ended.
    """

    def __init__(self) -> None:
        self._status: Dict[str, Tuple[bool, str, float]] = {}

    def update(self, node: str, arrive: bool, text: str, now: float) -> None:
        """Take what a node says at `now` (s): whether images arrive, and a text."""
        self._status[node] = (arrive, text, now)

    def text(self, now: float) -> str:
        """Return what to say at `now` (s) while nobody is tracked."""
        recent = self._recent(now)
        if not recent or any(arrive for arrive, _, _ in recent):
            return "nobody yet"
        return "no images arrive: " + recent[0][1]

    def is_known(self, now: float) -> bool:
        """Tell whether any node works on images at `now` (s)."""
        return bool(self._recent(now))

    def _recent(self, now: float) -> List[Tuple[bool, str, float]]:
        return [row for row in self._status.values() if now - row[2] < REPORT_WAIT_S]


def format_columns(rows: Sequence[Sequence[str]]) -> str:
    """Return rows of text in columns as wide as they need to be, without a newline at the end."""
    widths = [max(map(_shown_width, column)) for column in zip(*rows)]
    return "\n".join("  ".join(cell + " " * (width - _shown_width(cell)) for cell, width in zip(row, widths)).rstrip()
                     for row in rows)


def _shown_width(text: str) -> int:
    """Return how many columns of a terminal a text takes: names may be of any script."""
    return sum(0 if unicodedata.category(letter) in ("Mn", "Me", "Cf") else
               2 if unicodedata.east_asian_width(letter) in "WF" else 1 for letter in text)


class LiveDisplay:
    """Draws one text over another on a terminal that may change its size."""

    def __init__(self) -> None:
        self._above: List[str] = []

    def draw(self, text: str, columns: int, lines: int) -> str:
        """Return what a terminal of this size (columns, lines) needs to show `text` in place of the last one."""
        shown = [line[:columns] for line in text.split("\n")]
        room = max(lines - 1, 3)      # the cursor stands below the last line
        if len(shown) > room:
            shown[room - 2:-1] = ["... and %d lines more" % (len(shown) - room + 1)]
        if any(len(line) > columns for line in self._above):
            # It was made narrower; some terminals wrap what they show, so that nobody knows how far up the table
            # begins.
            start = "\x1b[H\x1b[2J"
        else:
            start = "\x1b[%dA" % len(self._above) if self._above else ""
        self._above = shown
        return start + "".join("\x1b[2K%s\n" % line for line in shown) + "\x1b[0J"


def as_data(rows: Sequence[PersonRow], face_rate: float, body_rate: float, seen: Iterable[str]) -> Dict[str, object]:
    """Return the table as data for JSON; seen: ids of all persons since the start, of whom those who are not in the
    table have left."""
    persons: List[Dict[str, object]] = [dict(asdict(row), in_view=row.is_in_view) for row in rows]
    return {"persons": persons, "faces_per_second": face_rate, "bodies_per_second": body_rate,
            "persons_left": sorted(set(seen) - {row.id for row in rows})}


def graph_text(snapshot: Snapshot, matches: Iterable[Edge], merges: Iterable[Tuple[str, str, float]],
               threshold: float) -> str:
    """Return a GraphViz graph of persons, their features (bold) and all candidate matches (dotted below the threshold).

    matches: pairs of features, or of feature and person, with their likelihood; merges: pairs of persons.
    """
    lines: List[str] = ["graph humans {", "  rankdir=LR;"]
    nodes = set()
    for state in snapshot.persons:
        person = MatchNode(Kind.PERSON, state.id)
        label = "%s\\n%s" % (state.id, "alias of " + state.alias if state.alias else "%.2f" % state.confidence)
        lines.append("  %s [shape=box, style=%s, label=\"%s\"];" % (
            _name(person), "dashed" if state.anonymous else "solid", label))
        for kind, feature in ((Kind.FACE, state.face), (Kind.BODY, state.body), (Kind.VOICE, state.voice)):
            if feature:
                nodes.add(MatchNode(kind, feature))
                lines.append("  %s -- %s [style=bold];" % (_name(person), _name(MatchNode(kind, feature))))
    shown = {MatchNode(Kind.PERSON, state.id) for state in snapshot.persons}
    pairs = [(first, second, value) for first, second, value in matches]
    pairs += [(MatchNode(Kind.PERSON, first), MatchNode(Kind.PERSON, second), value) for first, second, value in merges]
    for first, second, value in sorted(pairs):
        nodes.update((first, second))
        lines.append("  %s -- %s [label=\"%.2f\", style=%s];" % (
            _name(first), _name(second), value, "solid" if value >= threshold else "dotted"))
    for node in sorted(nodes - shown):
        lines.append("  %s [shape=%s, label=\"%s\"];" % (_name(node), _SHAPES[node.kind], node.id))
    return "\n".join(lines + ["}"]) + "\n"


def _name(node: MatchNode) -> str:
    """Identifier of a node; ids are letters, digits and underscores, so nothing needs quoting."""
    return "%s_%s" % (node.kind.name.lower(), node.id)
