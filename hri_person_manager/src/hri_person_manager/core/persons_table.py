"""A table of persons for the terminal, and the same as data."""

from __future__ import annotations

from collections import deque
from dataclasses import asdict, dataclass
from typing import Deque, Dict, List, Optional, Sequence, Tuple

RATE_WINDOW_S = 2.0


@dataclass(frozen=True)
class PersonRow:
    """One person: position in `frame` in m, age of the newest transform in ms; None where unknown."""

    id: str
    face: str
    body: str
    voice: str
    confidence: float
    position: Optional[Tuple[float, float, float]]
    frame: str
    age_ms: Optional[float]


class RateMeter:
    """Images per second out of their stamps; many features of one image count once."""

    def __init__(self, window: float = RATE_WINDOW_S) -> None:
        """Look at the last `window` seconds; ValueError unless that is above zero."""
        if not window > 0.0:
            raise ValueError("window is %s s, must be above 0" % window)
        self._window = window
        self._events: Deque[Tuple[float, float]] = deque(maxlen=1000)

    def add(self, stamp: float, now: float) -> None:
        """Take the image stamp (s) of a feature that arrived at `now` (s)."""
        if not any(stamp == known for known, _ in self._events):
            self._events.append((stamp, now))

    def rate(self, now: float) -> float:
        """Return the rate in images per second at time `now` (s)."""
        while self._events and not 0.0 <= now - self._events[0][1] <= self._window:
            self._events.popleft()
        if len(self._events) < 2:
            return 0.0
        span = self._events[-1][1] - self._events[0][1]
        return (len(self._events) - 1) / span if span > 0.0 else 0.0


def format_table(rows: Sequence[PersonRow], face_rate: float, body_rate: float) -> str:
    """Return the table as plain text, without a newline at the end."""
    lines = ["%-22s  %-6s %-6s %-6s %10s  %-22s %-20s %7s" % (
        "person", "face", "body", "voice", "confidence", "position x y z (m)", "frame", "age ms")]
    for row in rows:
        position = "%6.2f %6.2f %6.2f" % row.position if row.position is not None else "-"
        age = "%7.0f" % row.age_ms if row.age_ms is not None else "      -"
        lines.append("%-22s  %-6s %-6s %-6s %10.2f  %-22s %-20s %s" % (
            row.id, row.face or "-", row.body or "-", row.voice or "-", row.confidence, position,
            row.frame or "-", age))
    if not rows:
        lines.append("nobody yet")
    lines.append("faces %.1f images/s, bodies %.1f images/s" % (face_rate, body_rate))
    return "\n".join(lines)


def format_columns(rows: Sequence[Sequence[str]]) -> str:
    """Return rows of text in columns as wide as they need to be, without a newline at the end."""
    widths = [max(len(cell) for cell in column) for column in zip(*rows)]
    return "\n".join("  ".join(cell.ljust(width) for cell, width in zip(row, widths)).rstrip() for row in rows)


def redraw(text: str, lines_above: int) -> str:
    """Return what a terminal needs to show `text` in place of the last `lines_above` lines."""
    up = "\x1b[%dA" % lines_above if lines_above else ""
    return up + "".join("\x1b[2K%s\n" % line for line in text.split("\n")) + "\x1b[0J"


def as_data(rows: Sequence[PersonRow], face_rate: float, body_rate: float, seen: Sequence[str]) -> Dict[str, object]:
    """Return the table as data for JSON; `seen` are the ids of all persons seen since the start."""
    persons: List[Dict[str, object]] = [asdict(row) for row in rows]
    return {"persons": persons, "faces_per_second": face_rate, "bodies_per_second": body_rate,
            "persons_seen": sorted(seen)}
