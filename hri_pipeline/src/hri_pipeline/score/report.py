"""The command `rosrun ros4hri report`: a bag as one HTML page with plots, for a look at an evening in a minute.

The page holds everything itself (SVG, no scripts, nothing from the network). It is personal data like the bag.
"""

from __future__ import annotations

import argparse
import html
import sys
from pathlib import Path
from typing import Dict, Iterable, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from hri_pipeline.score.bag import Record, RecordError, read_bag

WIDTH, ROW, LEFT, SIDE = 900, 18, 170, 420      # px
HELD_S = 1.0            # a value that is not said again holds for so long
MOST_PERSONS = 40
_COLOURS = ("#4477aa", "#ee6677", "#228833", "#ccbb44", "#66ccee", "#aa3377", "#997700", "#555555")
_ROBOT = "robot"


class Span(NamedTuple):
    """Something that lasts from `begin` to `end` (s); text: shown at the pointer."""

    row: str
    begin: float
    end: float
    text: str = ""


def spans(series: Sequence[Tuple[float, Iterable[str]]], end: float, held: float = HELD_S) -> List[Span]:
    """Return how long each name is in the sets of a series of (time, names); a set holds until the next one, and no
    longer than `held` s."""
    since: Dict[str, Tuple[float, float]] = {}
    found: List[Span] = []
    for number, (when, names) in enumerate(series):
        until = min(series[number + 1][0] if number + 1 < len(series) else end, when + held)
        for name in names:
            begin, last = since.get(name, (when, when))
            if when > last + 1e-9:
                found.append(Span(name, begin, last))
                begin = when
            since[name] = (begin, until)
    return sorted(found + [Span(name, begin, last) for name, (begin, last) in since.items()],
                  key=lambda span: (span.begin, span.row))


def gaze_shares(record: Record) -> Dict[Tuple[str, str], float]:
    """Return the share of the time for which one looks at another, of that for which the first one is there."""
    looked: Dict[Tuple[str, str], float] = {}
    for span in spans([(when, ["{}\0{}".format(*pair) for pair in pairs]) for when, pairs in record.gaze], record.end):
        sender, receiver = span.row.split("\0")
        looked[sender, receiver] = looked.get((sender, receiver), 0.0) + span.end - span.begin
    there: Dict[str, float] = {}
    for span in spans(record.tracked, record.end, 3.0):
        there[span.row] = there.get(span.row, 0.0) + span.end - span.begin
    whole = max(record.end - record.begin, 1e-9)
    return {pair: min(1.0, seconds / max(there.get(pair[0], whole), 1e-9)) for pair, seconds in looked.items()}


def speech_spans(record: Record) -> List[Span]:
    """Return when each voice speaks, with the last text that was recognised until its next turn."""
    found: List[Span] = []
    for voice, states in sorted(record.speaking.items()):
        starts = [number for number, (_, speaks) in enumerate(states) if speaks]
        for number in starts:
            begin = states[number][0]
            end = states[number + 1][0] if number + 1 < len(states) else record.end
            after = [states[other][0] for other in starts if other > number]
            said = [text for when, who, text in record.texts
                    if who == voice and begin <= when < (after[0] if after else float("inf"))]
            found.append(Span(voice, begin, end, said[-1] if said else ""))
    return found


def page(record: Record, title: str) -> str:
    """Return the page of a recording."""
    persons = _persons(record)
    colours = {name: _COLOURS[number % len(_COLOURS)] for number, name in enumerate(persons)}
    groups = spans([(when, [" + ".join(sorted(name or _ROBOT for name in group)) for group in found])
                    for when, found in record.groups], record.end, 3.0)
    sections = [
        ("People", _timeline(record, spans(record.tracked, record.end, 3.0), colours)),
        ("Places from above", _plan(record, persons, colours)),
        ("Who looks at whom", _gaze_table(record, persons)),
        ("Groups", _timeline(record, groups, {})),
        ("Speech", _timeline(record, speech_spans(record), {}) + _texts(record)),
        ("Location confidence", _confidence(record, persons, colours))]
    body = "".join("<h2>{}</h2>{}".format(name, content or "<p>nothing in the recording</p>")
                   for name, content in sections)
    minutes = (record.end - record.begin) / 60.0
    return ("<!DOCTYPE html><html lang='en'><meta charset='utf-8'><title>{0}</title><style>body{{font:14px sans-serif;"
            "margin:2em}}svg{{background:#fafafa}}td,th{{padding:2px 8px;text-align:right}}text{{font:11px sans-serif}}"
            "</style><h1>{0}</h1><p>{1:.1f} minutes, {2} persons</p>{3}</html>").format(
                html.escape(title), minutes, len(persons), body)


def _persons(record: Record) -> List[str]:
    """Those who are there longest, in the order in which they came."""
    lasting: Dict[str, float] = {}
    first: Dict[str, float] = {}
    for span in spans(record.tracked, record.end, 3.0):
        lasting[span.row] = lasting.get(span.row, 0.0) + span.end - span.begin
        first.setdefault(span.row, span.begin)
    kept = sorted(lasting, key=lambda name: -lasting[name])[:MOST_PERSONS]
    return sorted(kept, key=lambda name: (first[name], name))


def _short(name: str) -> str:
    return html.escape(name.replace("anonymous_person_", "~"))


def _x(record: Record, when: float) -> float:
    return LEFT + (WIDTH - LEFT) * (when - record.begin) / max(record.end - record.begin, 1e-9)


def _svg(width: float, height: float, content: str) -> str:
    return "<svg width='{0:.0f}' height='{1:.0f}'>{2}</svg>".format(width, height, content)


def _axis(record: Record, height: float) -> str:
    """Marks of the time, minutes and seconds from the beginning."""
    whole = record.end - record.begin
    step = next((step for step in (1, 2, 5, 10, 30, 60, 120, 300, 600, 1800, 3600) if whole / step <= 12), 7200)
    marks = [step * number for number in range(int(whole / step) + 1)]
    return "".join("<line x1='{0:.1f}' x2='{0:.1f}' y1='0' y2='{1:.0f}' stroke='#ddd'/><text x='{0:.1f}' y='{2:.0f}'>"
                   "{3}:{4:02d}</text>".format(_x(record, record.begin + mark), height, height + 12, *divmod(mark, 60))
                   for mark in marks)


def _timeline(record: Record, found: Sequence[Span], colours: Dict[str, str]) -> str:
    rows: Dict[str, int] = {}
    for span in found:
        rows.setdefault(span.row, len(rows))
    if not rows:
        return ""
    height = ROW * len(rows)
    names = "".join("<text x='4' y='{}'>{}</text>".format(ROW * row + 13, _short(name)) for name, row in rows.items())
    bars = "".join("<rect x='{:.1f}' y='{}' width='{:.1f}' height='{}' fill='{}'><title>{} {}</title></rect>".format(
        _x(record, span.begin), ROW * rows[span.row] + 3, max(1.0, _x(record, span.end) - _x(record, span.begin)),
        ROW - 6, colours.get(span.row, _COLOURS[0]), _short(span.row), html.escape(span.text)) for span in found)
    return _svg(WIDTH, height + 16, _axis(record, height) + names + bars)


def _plan(record: Record, persons: Sequence[str], colours: Dict[str, str]) -> str:
    tracks = {name: np.array(record.tracks[name].places)[:, :2] for name in persons
              if name in record.tracks and record.tracks[name].places}
    if not tracks:
        return ""
    everything = np.concatenate(list(tracks.values()))
    low, high = everything.min(axis=0) - 0.5, everything.max(axis=0) + 0.5
    scale = SIDE / float((high - low).max())
    # x of the frame points up, y to the left, as on a map that looks along x.
    points = {name: np.column_stack([(high[1] - places[:, 1]) * scale, (high[0] - places[:, 0]) * scale])
              for name, places in tracks.items()}
    lines = "".join("<polyline fill='none' stroke='{}' points='{}'><title>{}</title></polyline>".format(
        colours[name], " ".join("{:.1f},{:.1f}".format(*point) for point in _thinned(where)), _short(name))
        for name, where in points.items())
    ends = "".join("<circle cx='{:.1f}' cy='{:.1f}' r='4' fill='{}'/><text x='{:.1f}' y='{:.1f}'>{}</text>".format(
        where[-1][0], where[-1][1], colours[name], where[-1][0] + 6, where[-1][1] + 4, _short(name))
        for name, where in points.items())
    size = (high - low) * scale
    return _svg(size[1] + 120, size[0], lines + ends) + "<p>{:.1f} by {:.1f} m; x up, y to the left</p>".format(
        *(high - low))


def _thinned(points: np.ndarray, most: int = 2000) -> np.ndarray:
    return points[::max(1, len(points) // most)]


def _gaze_table(record: Record, persons: Sequence[str]) -> str:
    shares = gaze_shares(record)
    if not shares:
        return ""
    names = [name for name in persons if any(name in pair for pair in shares)]
    head = "".join("<th>{}</th>".format(_short(name)) for name in names + [_ROBOT])
    rows = "".join("<tr><th>{}</th>{}</tr>".format(_short(sender), "".join(
        _gaze_cell(shares.get((sender, receiver), 0.0)) for receiver in names + [""])) for sender in names)
    return "<table><tr><th>looks at</th>{}</tr>{}</table>".format(head, rows)


def _gaze_cell(share: float) -> str:
    shown = "{:.0%}".format(share) if share else ""
    return "<td style='background:rgba(68,119,170,{:.2f})'>{}</td>".format(share, shown)


def _texts(record: Record) -> str:
    lines = ["<li>{}:{:04.1f} {}: {}</li>".format(int(span.begin - record.begin) // 60,
                                                 (span.begin - record.begin) % 60.0, _short(span.row),
                                                 html.escape(span.text))
             for span in sorted(speech_spans(record), key=lambda span: span.begin) if span.text]
    return "<ul>{}</ul>".format("".join(lines)) if lines else ""


def _confidence(record: Record, persons: Sequence[str], colours: Dict[str, str]) -> str:
    rows = [name for name in persons if record.confidence.get(name)]
    if not rows:
        return ""
    height, content = 2 * ROW * len(rows), ""
    for number, name in enumerate(rows):
        base = 2 * ROW * (number + 1) - 4
        steps, last = [], 0.0
        for when, value in record.confidence[name]:
            x = _x(record, when)
            steps += ["{:.1f},{:.1f}".format(x, base - 28 * last), "{:.1f},{:.1f}".format(x, base - 28 * value)]
            last = value
        steps.append("{:.1f},{:.1f}".format(_x(record, record.end), base - 28 * last))
        content += "<text x='4' y='{}'>{}</text><polyline fill='none' stroke='{}' points='{}'/>".format(
            base - 8, _short(name), colours[name], " ".join(steps))
    return _svg(WIDTH, height + 16, _axis(record, height) + content)


def main(arguments: Optional[List[str]] = None) -> int:
    """Read the command line and write the page; 0, 1 for a bag that cannot be read, 2 for a wrong command line."""
    parser = argparse.ArgumentParser(prog="report", description="A recording of /humans and /tf as one HTML page: "
                                     "people over time, places from above, gazes, groups, speech, confidence.")
    parser.add_argument("bag", help="bag with /tf, /humans/persons/..., /humans/interactions/..., /humans/voices/...")
    parser.add_argument("page", nargs="?", default="", help="HTML file to write (default: the bag's name, .html)")
    given = sys.argv[1:] if arguments is None else arguments
    options = parser.parse_args([word for word in given if ":=" not in word])
    path = Path(options.page or options.bag).expanduser()
    path = path if options.page else path.with_suffix(".html")
    try:
        path.write_text(page(read_bag(options.bag), Path(options.bag).name), encoding="utf-8")
    except (RecordError, OSError) as error:
        print("report: {}".format(error), file=sys.stderr)
        return 1
    print(path)
    return 0
