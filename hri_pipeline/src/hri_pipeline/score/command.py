"""The command `rosrun ros4hri score`: scores of the persons, gazes and groups in a bag.

`score` gives all figures of a record: errors against the truth where the bag holds it, what can be told without, and
`counts`, for bags whose truth is only how many people there are and which words are said.
"""

from __future__ import annotations

import argparse
import bisect
import json
import sys
from typing import (
    Any,
    Dict,
    List,
    Mapping,
    Optional,
    Sequence,
    Tuple,
    TypeVar,
)

import numpy as np

from hri_pipeline.score.bag import INTERACTIONS, KINDS, PERSONS, Record, RecordError, TruthFrame, read_bag
from hri_pipeline.score.metrics import (
    GoldenError,
    MotFrame,
    MotScores,
    clear_mot,
    compare,
    comparison_table,
    group_scores,
    identity_scores,
    load_golden,
    pair_scores,
    word_errors,
)

_LINES: Tuple[Tuple[str, str], ...] = (
    ("duration_s", "length of the bag, s"),
    ("persons_ids", "ids of persons"), ("persons_ids_per_minute", "new ids per minute"),
    ("persons_mean", "persons tracked, mean"),
    ("persons_most", "persons tracked, most"), ("gazes_mean", "gazes, mean"), ("groups_mean", "groups, mean"),
    ("person_rate_hz", "places of a person, Hz"), ("person_age_ms_p50", "age of a place, median, ms"),
    ("person_age_ms_p95", "age of a place, 95 %, ms"), ("gaze_rate_hz", "gaze messages, Hz"),
    ("groups_rate_hz", "group messages, Hz"), ("persons_true", "people there"), ("persons_found", "people found"),
    ("mota", "MOTA"), ("idf1", "IDF1"), ("hota", "HOTA"), ("deta", "HOTA: detection"), ("assa", "HOTA: association"),
    ("motp_m", "MOTP, mean error, m"), ("id_switches", "id switches"),
    ("id_switches_per_hour", "id switches per hour"), ("id_switches_permanent", "id switches between permanent ids"),
    ("fragments", "fragments"), ("misses", "misses"),
    ("false_positives", "false positives"), ("true_places", "true places"),
    ("gaze_precision", "gaze, precision"), ("gaze_recall", "gaze, recall"),
    ("gaze_precision_lenient", "gaze, precision, 0.3 s late or early"),
    ("gaze_recall_lenient", "gaze, recall, 0.3 s late or early"),
    ("groups_precision", "groups, precision (T = 2/3)"), ("groups_recall", "groups, recall"),
    ("groups_f1", "groups, F1"),
    ("faces_ids", "ids of faces"), ("faces_true", "faces there"), ("faces_missed", "faces missed"),
    ("faces_extra", "faces too many"),
    ("bodies_ids", "ids of bodies"), ("bodies_true", "bodies there"), ("bodies_missed", "bodies missed"),
    ("bodies_extra", "bodies too many"),
    ("voices_ids", "ids of voices"), ("voices_true", "voices there"), ("voices_missed", "voices missed"),
    ("voices_extra", "voices too many"),
    ("sentences_true", "sentences said"), ("sentences_heard", "sentences heard"), ("words_true", "words said"),
    ("words_heard", "words heard"), ("word_errors", "word errors"), ("word_error_rate", "word error rate"),
    ("confidence_out_of_range", "location confidences not in 0..1"),
    ("foreign_frames", "places in frames without a way to the truth's"),
    ("damaged_messages", "messages that could not be read"))


def main(arguments: Optional[List[str]] = None) -> int:
    """Read the command line and print the scores; 0, or 1 for a bag or golden figures that cannot be read, 2 for a
    wrong command line, 3 where the bag scores worse than the golden figures.
    """
    parser = argparse.ArgumentParser(prog="score", description="Scores of the persons, gazes and groups in a bag. With "
                                     "the truth in the bag (rosbag record /scene/truth/... of the scene simulator): "
                                     "errors against it; without: what can be told.")
    parser.add_argument("bag", help="bag with /tf, /tf_static, /humans/persons/..., /humans/interactions/... and the "
                                    "truth")
    parser.add_argument("--truth", default="/scene/truth", help="namespace of the truth (default: %(default)s)")
    parser.add_argument("--distance", type=float, default=0.5,
                        help="a person is found where a place is not farther away, m (default: %(default)s)")
    parser.add_argument("--golden", default="", help="YAML file of figures to compare with: {SECTION: {FIGURE: {value: "
                        "0.9, better: higher|lower|same|told, tolerance: 0.05}}}")
    parser.add_argument("--section", default="", help="section of that file; not needed where it has one only")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    options = parser.parse_args(_without_remappings(sys.argv[1:] if arguments is None else arguments))
    if not options.distance > 0.0:
        parser.error("--distance must be above 0")
    try:
        golden = load_golden(options.golden, options.section) if options.golden else []
        figures = score(read_bag(options.bag, options.truth), options.distance)
    except (RecordError, GoldenError) as error:
        print("score: {}".format(error), file=sys.stderr)
        return 1
    outcomes = compare(figures, golden)
    if options.json:
        compared = [{"figure": one.golden.key, "golden": one.golden.value, "now": one.value, "verdict": one.verdict}
                    for one in outcomes]
        print(json.dumps(dict(figures, golden=compared) if golden else figures))
    else:
        print(as_table(figures))
        if golden:
            print("\n" + comparison_table(outcomes))
    return 3 if any(one.failed for one in outcomes) else 0


def as_table(figures: Figures) -> str:
    """Return the figures as lines of text; those that are not known are left out, but for what the truth would tell."""
    lines = ["{:46} {}".format(text, _text(figures[key])) for key, text in _LINES if figures.get(key) is not None]
    for row in figures.get("confidence_errors_m") or ():
        lines.append("{:46} {}".format("confidence {from:g} to {to:g}: median error, m".format(**_mapping(row)),
                                       _text(_mapping(row)["median_error_m"])))
    if not figures["has_truth"]:
        lines.append("The bag holds no truth: no errors, switches or scores.")
    return "\n".join(lines)


def _mapping(row: object) -> Mapping[str, object]:
    return row if isinstance(row, dict) else {}


def _text(value: object) -> str:
    if value is None:
        return "-"
    return "{:.3f}".format(value) if isinstance(value, float) else str(value)


def _without_remappings(arguments: Sequence[str]) -> List[str]:
    """roslaunch hands over __name:=... and the like."""
    return [text for text in arguments if ":=" not in text]


LATENCY = 0.1
"""A tracked list counts for stamps up to so many seconds before it came."""
SLACK = 0.3
"""Oldest place (s) that still counts, and time by which a gaze may change late in the figures `..._lenient`."""
MEMORY = 1.0
"""Time (s) for which somebody who was matched counts as known for gazes and groups, though no place comes: those are
held as well."""
_NEAR = 0.06
ANONYMOUS = "anonymous_person_"
"""Ids of people whom nobody has identified begin so; the change to a permanent id is no fault."""
_BINS = ((0.99, 1.0), (0.5, 0.99), (0.0, 0.5))

Figures = Dict[str, Any]
T = TypeVar("T")


def score(record: Record, distance: float = 0.5) -> Figures:
    """Return all figures of a record; one that cannot be told is None. distance: m, see clear_mot."""
    figures: Figures = {"duration_s": round(record.end - record.begin, 3)}
    figures.update(_persons(record))
    figures.update(_rates(record))
    figures.update(counts(record))
    figures["has_truth"] = bool(record.truth or record.true_words or any(record.counted.values()))
    if record.truth:
        frames = mot_frames(record)
        mot = clear_mot(frames, distance)
        figures.update(_mot(mot, record))
        identity = identity_scores(frames, distance)
        figures.update(idf1=identity.idf1, hota=identity.hota, deta=identity.deta, assa=identity.assa)
        figures.update(_gaze(record, mot))
        figures.update(_group_figures(record, mot))
        figures.update(_confidence(record, mot))
    figures["confidence_out_of_range"] = sum(not 0.0 <= value <= 1.0 for series in record.confidence.values() for _,
                                             value in series)
    return figures


def mot_frames(record: Record) -> List[MotFrame]:
    """Return the true and the found heads at each stamp of the truth.

    A person counts while it is tracked and has a frame.
    """
    times = [when for when, _ in record.tracked]
    frames = []
    for frame in record.truth:
        index = bisect.bisect_right(times, frame.stamp + LATENCY) - 1
        listed = record.tracked[index][1] if index >= 0 else frozenset()
        found = {}
        for person in listed:
            place = record.tracks[person].at(frame.stamp, SLACK) if person in record.tracks else None
            if place is not None:
                found[person] = place
        frames.append(MotFrame(frame.heads, found, frame.visible))
    return frames


def _persons(record: Record) -> Figures:
    minutes = max(record.end - record.begin, 1e-9) / 60.0
    ids = frozenset().union(*(ids for _, ids in record.tracked)) if record.tracked else frozenset()
    return {"persons_ids": len(ids), "persons_ids_per_minute": len(ids) / minutes,
            "persons_mean": _mean([len(ids) for _, ids in record.tracked]),
            "persons_most": max((len(ids) for _, ids in record.tracked), default=None),
            "gazes_mean": _mean([len(pairs) for _, pairs in record.gaze]),
            "groups_mean": _mean([len(groups) for _, groups in record.groups])}


def _rates(record: Record) -> Figures:
    seconds = max(record.end - record.begin, 1e-9)
    steps = np.concatenate([np.diff(track.stamps) for track in record.tracks.values() if len(track.stamps) > 1]
                           or [np.zeros(0)])
    ages = np.concatenate([np.array(track.ages) for track in record.tracks.values()] or [np.zeros(0)])
    return {"person_rate_hz": 1.0 / float(np.median(steps)) if len(steps) else None,
            "person_age_ms_p50": 1e3 * float(np.percentile(ages, 50)) if len(ages) else None,
            "person_age_ms_p95": 1e3 * float(np.percentile(ages, 95)) if len(ages) else None,
            "gaze_rate_hz": record.messages[INTERACTIONS + "gaze"] / seconds,
            "groups_rate_hz": record.messages[INTERACTIONS + "groups"] / seconds,
            "tracked_rate_hz": record.messages[PERSONS + "tracked"] / seconds,
            "foreign_frames": record.foreign_frames, "damaged_messages": record.damaged}


def permanent_switches(mot: MotScores) -> int:
    """Count how often a true person had another permanent id than the last permanent one."""
    last: Dict[str, str] = {}
    switches = 0
    for pairs in mot.pairs:
        for found, true in pairs.items():
            if not found.startswith(ANONYMOUS):
                switches += last.get(true, found) != found
                last[true] = found
    return switches


def _mot(mot: MotScores, record: Record) -> Figures:
    hours = max(record.end - record.begin, 1e-9) / 3600.0
    return {"mota": mot.mota, "motp_m": mot.distance, "persons_true": mot.persons_true, "persons_found": mot.persons,
            "id_switches": mot.switches, "id_switches_per_hour": mot.switches / hours,
            "id_switches_permanent": permanent_switches(mot), "fragments": mot.fragments,
            "misses": mot.misses, "false_positives": mot.false_positives, "matches": mot.matches,
            "true_places": mot.truths}


def _aligned(series: Sequence[Tuple[float, T]], truth: Sequence[TruthFrame]) -> List[Tuple[int, T]]:
    """(number of the truth's frame nearest in time, value) of each item that has one close enough; each frame once."""
    stamps = [frame.stamp for frame in truth]
    found: Dict[int, Tuple[float, T]] = {}
    for when, value in series:
        index = bisect.bisect_left(stamps, when)
        near = min((number for number in (index - 1, index) if 0 <= number < len(stamps)),
                   key=lambda n: abs(stamps[n] - when))
        apart = abs(stamps[near] - when)
        if apart <= _NEAR and (near not in found or apart < found[near][0]):
            found[near] = (apart, value)
    return [(number, value) for number, (_, value) in sorted(found.items())]


def known_people(mot: MotScores, truth: Sequence[TruthFrame]) -> List[Dict[str, str]]:
    """For each frame, true id by found id of all who were matched in the last MEMORY s."""
    recent: Dict[str, Tuple[float, str]] = {}
    names = []
    for frame, pairs in zip(truth, mot.pairs):
        recent.update((found, (frame.stamp, true)) for found, true in pairs.items())
        recent = {found: (when, true) for found, (when, true) in recent.items() if frame.stamp - when <= MEMORY}
        names.append({found: true for found, (_, true) in recent.items()})
    return names


def _true_ids(ids: Sequence[str], names: Mapping[str, str]) -> Tuple[str, ...]:
    """Ids of the truth; the robot stays the robot, and somebody whom the truth does not know gets an id of its own."""
    return tuple("" if found == "" else names.get(found, "?" + found) for found in ids)


def _gaze(record: Record, mot: MotScores) -> Figures:
    """Gaze pairs, of people who are tracked: who is not tracked cannot be said to look."""
    found, truth = [], []
    people = known_people(mot, record.truth)
    for number, pairs in _aligned(record.gaze, record.truth):
        names = people[number]
        known = frozenset(names.values()) | {""}
        found.append(frozenset(_true_ids(pair, names) for pair in pairs))
        truth.append(frozenset(pair for pair in record.truth[number].gaze if set(pair) <= known))
    if not found:
        return dict.fromkeys(("gaze_precision", "gaze_recall", "gaze_precision_lenient", "gaze_recall_lenient",
                              "gaze_frames"))
    step = float(np.median(np.diff([frame.stamp for frame in record.truth]))) if len(record.truth) > 1 else 1.0
    strict, lenient = pair_scores(found, truth), pair_scores(found, truth, max(1, round(SLACK / max(step, 1e-3))))
    return {"gaze_precision": strict.precision, "gaze_recall": strict.recall,
            "gaze_precision_lenient": lenient.precision, "gaze_recall_lenient": lenient.recall,
            "gaze_frames": len(found)}


def _group_figures(record: Record, mot: MotScores) -> Figures:
    found, truth = [], []
    people = known_people(mot, record.truth)
    for number, groups in _aligned(record.groups, record.truth):
        names = people[number]
        known = frozenset(names.values()) | {""}
        found.append([frozenset(_true_ids(tuple(group), names)) for group in groups])
        truth.append([group & known for group in record.truth[number].groups])
    if not found:
        return dict.fromkeys(("groups_precision", "groups_recall", "groups_f1", "groups_frames"))
    scores = group_scores(found, truth)
    return {"groups_precision": scores.precision, "groups_recall": scores.recall, "groups_f1": scores.f1,
            "groups_frames": scores.frames}


def _confidence(record: Record, mot: MotScores) -> Figures:
    """Median error (m) of the places by location confidence: the less confident, the larger it should be."""
    whose: Dict[str, str] = {}
    errors: Dict[Tuple[float, float], List[float]] = {limits: [] for limits in _BINS}
    for number, frame in enumerate(record.truth):
        whose.update(mot.pairs[number])
        for person, series in record.confidence.items():
            true, track = whose.get(person), record.tracks.get(person)
            index = bisect.bisect_right([when for when, _ in series], frame.stamp + LATENCY) - 1
            if true not in frame.heads or track is None or index < 0:
                continue
            place = track.at(frame.stamp, SLACK)
            limits = next((limits for limits in _BINS if limits[0] <= series[index][1] <= limits[1]), None)
            if place is not None and limits is not None and series[index][1] > 0.0:
                errors[limits].append(float(np.linalg.norm(np.subtract(place, frame.heads[true]))))
    return {"confidence_errors_m": [{"from": low, "to": high, "places": len(errors[low, high]),
                                     "median_error_m": float(np.median(errors[low, high])) if errors[low, high]
                                     else None}
                                    for low, high in _BINS]}


def _mean(values: Sequence[float]) -> Optional[float]:
    return float(np.mean(values)) if len(values) else None


SETTLE = 0.5
"""Part of the time from one change of the truth to the next that is left out: trackers take time for who comes and
goes."""
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
    """Sums, over the stretches in which the truth does not change, of how many too few and too many there were in most
    of its last part."""
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
    return {"sentences_true": len(record.true_words),
            "sentences_heard": sum(bool(text) for texts in record.said.values() for _, text in texts),
            "words_true": len(true), "words_heard": len(heard), "word_errors": errors,
            "word_error_rate": errors / len(true) if true else None}
