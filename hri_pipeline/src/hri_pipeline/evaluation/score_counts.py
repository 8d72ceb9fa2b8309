"""Figures of a record whose truth is only how many there are, and which words are said: recordings of pictures and of sound."""

from __future__ import annotations

import bisect
from typing import Dict, List, Optional, Sequence, Tuple

from hri_pipeline.evaluation.bag_record import KINDS, Record
from hri_pipeline.evaluation.speech_figures import word_errors

SETTLE = 0.5
"""Part of the time from one change of the truth to the next that is left out: trackers take time for who comes and goes."""
SERIES = Sequence[Tuple[float, frozenset]]


def counts(record: Record) -> Dict[str, object]:
    """Return figures of faces, bodies, voices and words; without their truth, the numbers of ids alone."""
    figures: Dict[str, object] = {}
    for kind in KINDS:
        listed, true = record.listed.get(kind, []), record.counted.get(kind, [])
        figures[kind + "_ids"] = len(frozenset().union(*(ids for _, ids in listed))) if listed else None
        figures.update(_missed(kind, listed, true, record.end))
    if record.true_words:
        figures.update(_words(record))
    return figures


def _missed(kind: str, listed: SERIES, true: SERIES, end: float) -> Dict[str, object]:
    """Sums, over the stretches in which the truth does not change, of how many too few and too many there were in most of its last part."""
    if not true:
        return {}
    missed = extra = there = 0
    for begin, stop, count in _stretches(true, end):
        found = _usual(listed, begin + SETTLE * (stop - begin), stop)
        there += count
        missed += max(0, count - found)
        extra += max(0, found - count)
    return {kind + "_true": there, kind + "_missed": missed, kind + "_extra": extra}


def _stretches(true: SERIES, end: float) -> List[Tuple[float, float, int]]:
    """(begin, end, how many) of each time in which the true ids stay the same."""
    found: List[Tuple[float, float, int]] = []
    begin, ids = true[0]
    for when, now in [*true[1:], (end, None)]:
        if now != ids:
            found.append((begin, when, len(ids)))
            begin, ids = when, now
    return found


def _usual(listed: SERIES, begin: float, end: float) -> int:
    """How many were listed for most of a time."""
    held: Dict[int, float] = {}
    times = [when for when, _ in listed]
    index = bisect.bisect_right(times, begin) - 1
    when = begin
    while when < end:
        later = times[index + 1] if index + 1 < len(times) else end
        number = len(listed[index][1]) if index >= 0 else 0
        held[number] = held.get(number, 0.0) + min(later, end) - when
        when, index = min(later, end), index + 1
    return max(held, key=lambda number: held[number]) if held else 0


def _words(record: Record) -> Dict[str, Optional[object]]:
    true = " ".join(record.true_words).split()
    heard = " ".join(text for _, text in sorted(item for texts in record.said.values() for item in texts)).split()
    errors = word_errors(true, heard)
    return {"sentences_true": len(record.true_words), "sentences_heard": sum(bool(text) for texts in record.said.values() for _, text in texts),
            "words_true": len(true), "words_heard": len(heard), "word_errors": errors,
            "word_error_rate": errors / len(true) if true else None}
