"""Two ids of one human: somebody got a second id (seen from the side first, or by two cameras at once)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Callable, List, Optional, Sequence, Tuple

from hri_pipeline.core.recognition.likelihood import MAX_LIKELIHOOD, Calibration

_WORTH_A_LOOK = 0.05
_SCALES_BELOW = 7.0
"""Two persons are one when their templates are nearer than the midpoint by so many scales: odds of a thousand to one."""


@dataclass(frozen=True)
class Candidate:
    """Somebody that a template may be of: distance of the nearest template of that person, calibrated likelihood."""

    person_id: str
    distance: float
    likelihood: float


@dataclass(frozen=True)
class MatchResult:
    """Who one template may be of, likeliest first, out of `population` persons; `same`: pairs (kept id, other id) of
    persons who are the same human by their templates.
    """

    candidates: Sequence[Candidate]
    population: int
    same: Sequence[Tuple[str, str]] = ()


def join_alike(result: MatchResult, distance: Callable[[str, str], Optional[float]], order: Callable[[str], int],
               calibration: Calibration) -> MatchResult:
    """Give the likelihoods of persons who are the same human to the one known for longest; the others get none.

    Without this, two ids of one human would share the likelihood, and neither would be recognised. distance: between
    the nearest templates of two persons, None when they must not be joined; order: smaller for who is known longer.
    """
    likely = sorted((one for one in result.candidates if one.likelihood >= _WORTH_A_LOOK),
                    key=lambda one: order(one.person_id))
    kept: List[Candidate] = []
    same: List[Tuple[str, str]] = []
    limit = calibration.midpoint - _SCALES_BELOW * calibration.scale
    for one in likely:
        for index, other in enumerate(kept):
            between = distance(other.person_id, one.person_id)
            if between is not None and between < limit:
                kept[index] = replace(other, distance=min(one.distance, other.distance),
                                      likelihood=min(one.likelihood + other.likelihood, MAX_LIKELIHOOD))
                same.append((other.person_id, one.person_id))
                break
        else:
            kept.append(one)
    if not same:
        return result
    gone = {other for _, other in same}
    rest = [one for one in result.candidates if one.likelihood < _WORTH_A_LOOK and one.person_id not in gone]
    return replace(result, candidates=tuple(sorted(kept, key=lambda one: -one.likelihood) + rest), same=tuple(same))
