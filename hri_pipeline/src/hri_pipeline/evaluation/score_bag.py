"""Scores of a bag: persons, gazes and groups against the truth where the bag holds it, and what can be told without."""

from __future__ import annotations

import bisect
from typing import Dict, List, Mapping, Optional, Sequence, Tuple

import numpy as np

from hri_pipeline.evaluation.bag_record import INTERACTIONS, PERSONS, Record, TruthFrame
from hri_pipeline.evaluation.score_counts import counts
from hri_pipeline.evaluation.scores import MotFrame, MotScores, clear_mot, group_scores, pair_scores

LATENCY = 0.1
"""A tracked list counts for stamps up to so many seconds before it came."""
SLACK = 0.3
"""Oldest place (s) that still counts, and time by which a gaze may change late in the figures `..._lenient`."""
MEMORY = 1.0
"""Time (s) for which somebody who was matched counts as known for gazes and groups, though no place comes: those are held as well."""
_NEAR = 0.06
ANONYMOUS = "anonymous_person_"
"""Ids of people whom nobody has identified begin so; the change to a permanent id is no fault."""
_BINS = ((0.99, 1.0), (0.5, 0.99), (0.0, 0.5))

Figures = Dict[str, object]


def score(record: Record, distance: float = 0.5) -> Figures:
    """Return all figures of a record; one that cannot be told is None. distance: m, see clear_mot."""
    figures: Figures = {"duration_s": round(record.end - record.begin, 3)}
    figures.update(_persons(record))
    figures.update(_rates(record))
    figures.update(counts(record))
    figures["has_truth"] = bool(record.truth or record.true_words or any(record.counted.values()))
    if record.truth:
        mot = clear_mot(mot_frames(record), distance)
        figures.update(_mot(mot, record))
        figures.update(_gaze(record, mot))
        figures.update(_group_figures(record, mot))
        figures.update(_confidence(record, mot))
    figures["confidence_out_of_range"] = sum(not 0.0 <= value <= 1.0 for series in record.confidence.values() for _, value in series)
    return figures


def mot_frames(record: Record) -> List[MotFrame]:
    """Return the true and the found heads at each stamp of the truth. A person counts while it is tracked and has a frame."""
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
    steps = np.concatenate([np.diff(track.stamps) for track in record.tracks.values() if len(track.stamps) > 1] or [np.zeros(0)])
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
            "misses": mot.misses, "false_positives": mot.false_positives, "matches": mot.matches, "true_places": mot.truths}


def _aligned(series: Sequence[Tuple[float, object]], truth: Sequence[TruthFrame]) -> List[Tuple[int, object]]:
    """(number of the truth's frame nearest in time, value) of each item that has one close enough; each frame once."""
    stamps = [frame.stamp for frame in truth]
    found: Dict[int, Tuple[float, object]] = {}
    for when, value in series:
        index = bisect.bisect_left(stamps, when)
        near = min((number for number in (index - 1, index) if 0 <= number < len(stamps)), key=lambda n: abs(stamps[n] - when))
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
        return dict.fromkeys(("gaze_precision", "gaze_recall", "gaze_precision_lenient", "gaze_recall_lenient", "gaze_frames"))
    step = float(np.median(np.diff([frame.stamp for frame in record.truth]))) if len(record.truth) > 1 else 1.0
    strict, lenient = pair_scores(found, truth), pair_scores(found, truth, max(1, round(SLACK / max(step, 1e-3))))
    return {"gaze_precision": strict.precision, "gaze_recall": strict.recall,
            "gaze_precision_lenient": lenient.precision, "gaze_recall_lenient": lenient.recall, "gaze_frames": len(found)}


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
                                     "median_error_m": float(np.median(errors[low, high])) if errors[low, high] else None}
                                    for low, high in _BINS]}


def _mean(values: Sequence[float]) -> Optional[float]:
    return float(np.mean(values)) if len(values) else None
