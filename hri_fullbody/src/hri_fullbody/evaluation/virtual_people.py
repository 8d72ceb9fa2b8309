"""Virtual people: body dimensions drawn from the anthropometric table's Gaussian."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, List

import numpy as np

if TYPE_CHECKING:
    from hri_fullbody.core.human.segment_table import SegmentTable


@dataclass(frozen=True)
class Person:
    """Stature and distances between joint centres, m. trunk: middle of the hips to middle of the shoulders;
    neck: middle of the shoulders to the skull base; half_shoulders, half_hips: half the joints' distance."""

    stature: float
    upper_arm: float
    forearm: float
    thigh: float
    shank: float
    trunk: float
    half_shoulders: float
    half_hips: float
    neck: float


def virtual_people(count: int, seed: int, table: SegmentTable) -> List[Person]:
    """Draw `count` adults, the same for the same seed.

    The logarithms of the ten lengths of `table` (stature, upper arm, forearm, thigh, shank, trunk, half
    shoulders, half hips, neck, ankle height) are normal with its mean and covariance: those between the
    people of the ANSUR II survey (Gordon et al., NATICK/TR-15/007, 2014), both sexes alike.
    """
    logarithms = np.random.default_rng(seed).multivariate_normal(table.log_mean, table.log_covariance, size=count)
    return [Person(*(float(length) for length in row[:9])) for row in np.exp(logarithms)]
