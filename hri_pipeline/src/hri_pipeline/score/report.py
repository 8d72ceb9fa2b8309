"""The command `rosrun ros4hri report`: a bag as one HTML page with plots.

The page holds everything itself (SVG, no scripts, nothing from the network). It is personal data like the bag.
"""

from __future__ import annotations

import argparse
import html
import sys
import time
from pathlib import Path
from typing import Dict, Iterable, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from hri_pipeline.score.bag import Record, RecordError, read_bag

WIDTH, ROW, LEFT, SIDE = 1000, 18, 210, 480      # px
HELD_S = 1.0            # a value that is not said again holds for so long
LISTED_S = 3.0          # the same for lists
MOST_PERSONS, MOST_GROUPS = 40, 30
SHORTEST_S = 2.0        # who was there for less is counted, not shown: most of them are ids of a moment
_STYLE = """
:root { color-scheme: light dark; --text: #1c2430; --back: #fff; --plot: #f4f5f7; --line: #d5dae1; }
@media (prefers-color-scheme: dark) {
  :root { --text: #e8ecf1; --back: #14181e; --plot: #1e242c; --line: #3a4450; }
}
body { font: 15px/1.4 system-ui, "DejaVu Sans", sans-serif; margin: 1.5em auto; padding: 0 1em; max-width: 1000px;
  background: var(--back); color: var(--text); }
h2 { margin: 1.6em 0 .4em; font-size: 1.15em; }
svg { display: block; width: 100%; height: auto; background: var(--plot); border-radius: 6px; }
svg text { font: 11px system-ui, "DejaVu Sans", sans-serif; fill: var(--text); paint-order: stroke; stroke: var(--plot);
  stroke-width: 3px; stroke-linejoin: round; }
.line { stroke: var(--line); }
.wide { overflow-x: auto; }
table { border-collapse: collapse; }
td, th { padding: 3px 8px; text-align: right; white-space: nowrap; font-weight: normal; }
"""
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
    for span in spans(record.tracked, record.end, LISTED_S):
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
    persons, there = _persons(record), spans(record.tracked, record.end, LISTED_S)
    colours = {name: _COLOURS[number % len(_COLOURS)] for number, name in enumerate(persons)}
    sections = [
        ("People", _timeline(record, [span for span in there if span.row in colours], colours)),
        ("Places from above", _plan(record, persons, colours)),
        ("Who looks at whom", _gaze_table(record, persons)),
        ("Groups", _timeline(record, _group_spans(record), {})),
        ("Speech", _timeline(record, _by_speaker(record), colours) + _texts(record)),
        ("Location confidence", _confidence(record, persons, colours))]
    body = "".join("<h2>{}</h2>{}".format(name, content or "<p>nothing in the recording</p>")
                   for name, content in sections)
    return ("<!DOCTYPE html><html lang='en'><head><meta charset='utf-8'><meta name='viewport' "
            "content='width=device-width'><title>{0}</title><style>{1}</style></head><body><h1>{0}</h1><p>{2}</p>{3}"
            "</body></html>").format(html.escape(title), _STYLE, _summary(record, persons), body)


def _summary(record: Record, persons: Sequence[str]) -> str:
    """When it was, how long, and how many people; ids are more than people: who is lost and found gets a new one."""
    ids = {name for _, names in record.tracked for name in names}
    most = max((len(names) for _, names in record.tracked), default=0)
    text = "{}, {} min {} s. At most {} at a time, {} ids".format(
        time.strftime("%Y-%m-%d %H:%M", time.localtime(record.begin)),
        *divmod(int(round(record.end - record.begin)), 60), most, len(ids))
    left_out = len(ids) - len(persons)
    if not left_out:
        return text + "."
    beyond = " or beyond the {} longest".format(MOST_PERSONS) if len(persons) == MOST_PERSONS else ""
    return text + ", {} of them not shown: there for less than {:g} s{}.".format(left_out, SHORTEST_S, beyond)


def _persons(record: Record) -> List[str]:
    """Those who are there longest, in the order in which they came."""
    lasting: Dict[str, float] = {}
    first: Dict[str, float] = {}
    for span in spans(record.tracked, record.end, LISTED_S):
        lasting[span.row] = lasting.get(span.row, 0.0) + span.end - span.begin
        first.setdefault(span.row, span.begin)
    kept = sorted((name for name in lasting if lasting[name] >= SHORTEST_S),
                  key=lambda name: -lasting[name])[:MOST_PERSONS]
    return sorted(kept, key=lambda name: (first[name], name))


def _group_spans(record: Record) -> List[Span]:
    """The groups that lasted longest, by the names of their members."""
    found = spans([(when, [" + ".join(sorted(_name(record, name) for name in group)) for group in groups])
                   for when, groups in record.groups], record.end, LISTED_S)
    lasting: Dict[str, float] = {}
    for span in found:
        lasting[span.row] = lasting.get(span.row, 0.0) + span.end - span.begin
    kept = sorted(lasting, key=lambda row: -lasting[row])[:MOST_GROUPS]
    return [span for span in found if span.row in kept]


def _by_speaker(record: Record) -> List[Span]:
    """When each person speaks; voices of nobody by their own id."""
    return sorted((span._replace(row=record.speakers.get(span.row, "voice " + span.row))
                   for span in speech_spans(record)), key=lambda span: span.begin)


def _name(record: Record, name: str) -> str:
    """How somebody is called on the page."""
    return record.names.get(name) or name.replace("anonymous_person_", "~") or _ROBOT


def _shown(record: Record, name: str, most: int = 32) -> str:
    """The same as HTML, in as many letters as there is room for."""
    text = _name(record, name)
    return html.escape(text if len(text) <= most else text[:most - 1] + "\u2026")


def _x(record: Record, when: float) -> float:
    return LEFT + (WIDTH - LEFT) * (when - record.begin) / max(record.end - record.begin, 1e-9)


def _svg(width: float, height: float, content: str) -> str:
    return ("<div class='wide'><svg viewBox='0 0 {0:.0f} {1:.0f}' style='min-width:{2:.0f}px;max-width:{0:.0f}px'>{3}"
            "</svg></div>").format(width, height, 0.7 * width, content)


def _axis(record: Record, height: float) -> str:
    """Marks of the time, minutes and seconds from the beginning."""
    whole = record.end - record.begin
    step = next((step for step in (1, 2, 5, 10, 30, 60, 120, 300, 600, 1800, 3600) if whole / step <= 12), 7200)
    marks = [step * number for number in range(int(whole / step) + 1)]
    return "".join("<line x1='{0:.1f}' x2='{0:.1f}' y1='0' y2='{1:.0f}' class='line'/><text x='{0:.1f}' y='{2:.0f}'>"
                   "{3}:{4:02d}</text>".format(_x(record, record.begin + mark), height, height + 12, *divmod(mark, 60))
                   for mark in marks)


def _timeline(record: Record, found: Sequence[Span], colours: Dict[str, str]) -> str:
    rows: Dict[str, int] = {}
    for span in found:
        rows.setdefault(span.row, len(rows))
    if not rows:
        return ""
    height = ROW * len(rows)
    names = "".join("<text x='4' y='{}'>{}</text>".format(ROW * row + 13, _shown(record, name))
                    for name, row in rows.items())
    bars = "".join("<rect x='{:.1f}' y='{}' width='{:.1f}' height='{}' fill='{}'><title>{} {}</title></rect>".format(
        _x(record, span.begin), ROW * rows[span.row] + 3, max(1.0, _x(record, span.end) - _x(record, span.begin)),
        ROW - 6, colours.get(span.row, _COLOURS[0]), _shown(record, span.row, 200), html.escape(span.text))
                   for span in found)
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
    size = (high - low) * scale
    lines = _grid(low, high, scale) + "".join(
        "<polyline fill='none' stroke='{}' stroke-opacity='0.7' points='{}'><title>{}</title></polyline>".format(
            colours[name], " ".join("{:.1f},{:.1f}".format(*point) for point in _thinned(where)), _shown(record, name))
        for name, where in points.items())
    ends = "".join("<circle cx='{:.1f}' cy='{:.1f}' r='4' fill='{}'/><text x='{:.1f}' y='{:.1f}'>{}</text>".format(
        where[-1][0], where[-1][1], colours[name], where[-1][0] + 6, where[-1][1] + 4, _shown(record, name))
        for name, where in points.items())
    return _svg(size[1] + 120, size[0], lines + ends) + (
        "<p>Lines are {:g} m apart; x up, y to the left; a dot: where somebody was last.</p>".format(_step(low, high)))


def _step(low: np.ndarray, high: np.ndarray) -> float:
    """Return how far the lines of the plan are apart, m."""
    return next((step for step in (1.0, 2.0, 5.0, 10.0, 20.0) if float((high - low).max()) / step <= 12.0), 50.0)


def _grid(low: np.ndarray, high: np.ndarray, scale: float) -> str:
    """Lines of whole metres, of x (across) and of y."""
    step = _step(low, high)
    height, width = ((high - low) * scale).tolist()
    along = [np.arange(np.ceil(low[axis] / step), np.floor(high[axis] / step) + 1) * step for axis in (0, 1)]
    return "".join("<line x1='0' x2='{1:.0f}' y1='{0:.1f}' y2='{0:.1f}' class='line'/>".format(
        (high[0] - mark) * scale, width) for mark in along[0]) + "".join(
        "<line x1='{0:.1f}' x2='{0:.1f}' y1='0' y2='{1:.0f}' class='line'/>".format((high[1] - mark) * scale, height)
        for mark in along[1])


def _thinned(points: np.ndarray) -> np.ndarray:
    return points[::max(1, len(points) // 2000)]


def _gaze_table(record: Record, persons: Sequence[str]) -> str:
    shares = gaze_shares(record)
    if not shares:
        return ""
    names = [name for name in persons if any(name in pair for pair in shares)]
    head = "".join("<th>{}</th>".format(_shown(record, name, 16)) for name in names + [""])
    rows = "".join("<tr><th>{}</th>{}</tr>".format(_shown(record, sender, 16), "".join(
        _gaze_cell(shares.get((sender, receiver), 0.0)) for receiver in names + [""])) for sender in names)
    return "<div class='wide'><table><tr><th>looks at</th>{}</tr>{}</table></div>".format(head, rows)


def _gaze_cell(share: float) -> str:
    shown = "{:.0%}".format(share) if share else ""
    return "<td style='background:rgba(68,119,170,{:.2f})'>{}</td>".format(share, shown)


def _texts(record: Record) -> str:
    lines = ["<li>{:.0f}:{:04.1f} {}: {}</li>".format(*divmod(round(span.begin - record.begin, 1), 60.0),
                                                      _shown(record, span.row), html.escape(span.text))
             for span in _by_speaker(record) if span.text]
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
            base - 8, _shown(record, name), colours[name], " ".join(steps))
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
