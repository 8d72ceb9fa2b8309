"""How well attitudes are told: recall and precision by class, false events per minute, walking.

An event of the detector is an unbroken run of one attitude; runs of one attitude less than 0.3 s apart are one.
Recall: share of the made events during at least half of whose time the attitude is reported.
A false event: one that overlaps no truth of its attitude, made or recorded, each widened by 0.6 s.
Precision: right made events / (those + false events), the false ones of all clips, positive ones of other attitudes
and recordings as they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, Iterator, List, Sequence, Tuple

import numpy as np

from hri_fullbody.core.language.attitude import Attitude
from hri_fullbody.core.language.body_language import BodyLanguage
from hri_fullbody.core.smoothing.keypoint_filter import KeypointFilter
from hri_fullbody.evaluation.attitude_clips import (
    ALL,
    CLASSES,
    HELD_OUT,
    TUNED_ON,
    WALKING,
    Clip,
    natural_clips,
    positive_clips,
    runs,
)
from hri_fullbody.evaluation.noise import Level, add_noise

NOISES: Tuple[Level, ...] = (0, "rgbd")
_MERGE_S, _MARGIN_S = 0.3, 0.6
_STATURE_ERROR = 0.02


@dataclass(frozen=True)
class Event:
    """An attitude that the detector reported from `start` to `end`, s."""

    attitude: Attitude
    start: float
    end: float


def figures(variants: int = 6, headings: int = 4, seed: int = 1) -> Dict[str, object]:
    """Measure on the recordings; 40 s of a core with the default numbers.

    variants: made clips per recording and attitude. headings: views of each recording as it is.
    Result: noise -> {"all", "held_out": class -> recall, precision, false_per_minute, events; "walking_events",
    "walking_minutes"}, and the names of the recordings that the thresholds were tuned on.
    Raises FileNotFoundError, saying what is missing, without the recordings.
    """
    positives, naturals = positive_clips(ALL, variants, seed), natural_clips(ALL, headings, seed)
    walks = natural_clips(WALKING, 3 * headings, seed + 1)
    result: Dict[str, object] = {"tuned_on": list(TUNED_ON), "held_out": list(HELD_OUT)}
    for noise in NOISES:
        clips = positives + naturals
        found = detect(clips + walks, noise, seed)
        walked = sum(len(events) for events in found[len(clips):])
        result[str(noise)] = {
            "all": by_class(clips, found[:len(clips)], ALL),
            "held_out": by_class(clips, found[:len(clips)], HELD_OUT),
            "walking_events": walked,
            "walking_minutes": round(_minutes(walks), 2)}
    return result


def detect(clips: Sequence[Clip], noise: Level, seed: int) -> List[List[Event]]:
    """Run the gate, the low pass and the detector over the clips, as for bodies in the node; events of each clip.

    The stature that the detector is told is wrong by 2 % (standard deviation). All clips have the same rate.
    """
    random = np.random.default_rng(seed)
    statures = [clip.motion.stature * float(np.exp(random.normal() * _STATURE_ERROR)) for clip in clips]
    bodies, found = [BodyLanguage() for _ in clips], [[] for _ in clips]
    for stamp, indices, points in _filtered(clips, noise, seed):
        for index, place in zip(indices, points):
            found[index].append(bodies[index].update(
                place, statures[index], stamp, clips[index].motion.up).attitude)
    return [events_of(np.array(attitudes), clip.motion.stamps) for attitudes, clip in zip(found, clips)]


def _filtered(clips: Sequence[Clip], noise: Level, seed: int) -> Iterator[Tuple[float, List[int], np.ndarray]]:
    """All clips at once through the node's gate and low pass: yields stamp, indices of the clips, (N, 18, 3) m."""
    noisy = [clip.motion.points if noise == 0 else add_noise(clip.motion.points, noise, seed + index)
             for index, clip in enumerate(clips)]
    smoother = KeypointFilter()
    for frame in range(max(map(len, noisy), default=0)):
        indices = [index for index, points in enumerate(noisy) if frame < len(points)]
        stamp = float(clips[indices[0]].motion.stamps[frame])
        points = np.stack([noisy[index][frame] for index in indices])
        yield stamp, indices, smoother.update([str(index) for index in indices], points, stamp).smooth


def events_of(attitudes: np.ndarray, stamps: np.ndarray) -> List[Event]:
    """Return the events of a sequence of attitudes (T,) at stamps (T,), s."""
    events = []
    for attitude in CLASSES:
        merged: List[Tuple[float, float]] = []
        for start, end in runs(attitudes == attitude, stamps):
            if merged and start - merged[-1][1] < _MERGE_S:
                merged[-1] = (merged[-1][0], end)
            else:
                merged.append((start, end))
        events += [Event(attitude, start, end) for start, end in merged]
    return events


def by_class(clips: Sequence[Clip], found: Sequence[Sequence[Event]], names: Sequence[str]) -> Dict[str, Dict[str, float]]:
    """Return recall, precision, false events per minute and numbers of each class on the clips of some recordings."""
    chosen = [(clip, events) for clip, events in zip(clips, found) if clip.source in names]
    minutes = _minutes([clip for clip, _ in chosen])
    table = {}
    for attitude in CLASSES:
        made = hits = false = 0
        for clip, events in chosen:
            own = [event for event in events if event.attitude == attitude]
            truths = [truth for truth in clip.truths if truth.attitude == attitude]
            for truth in truths:
                if truth.made:
                    made += 1
                    hits += _covered(truth.start, truth.end, own) >= 0.5 * (truth.end - truth.start)
            false += sum(not any(event.start < truth.end + _MARGIN_S and event.end > truth.start - _MARGIN_S
                                 for truth in truths) for event in own)
        table[attitude.name.lower()] = {
            "recall": round(hits / max(made, 1), 3), "precision": round(hits / max(hits + false, 1), 3),
            "false_per_minute": round(false / max(minutes, 1e-9), 2), "events": made, "false_events": false}
    return table


def _covered(start: float, end: float, events: Sequence[Event]) -> float:
    return sum(max(0.0, min(event.end, end) - max(event.start, start)) for event in events)


def _minutes(clips: Sequence[Clip]) -> float:
    return sum(len(clip.motion.points) / clip.motion.rate for clip in clips) / 60.0
