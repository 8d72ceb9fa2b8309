"""Which action units make which expression, and where expressions lie in the plane of valence and arousal."""

from __future__ import annotations

from typing import Dict, Tuple

NEUTRAL, HAPPY, SAD, ANGRY = "neutral", "happy", "sad", "angry"
SCARED, DISGUSTED, SURPRISED = "scared", "disgusted", "surprised"

CATEGORIES: Tuple[str, ...] = (NEUTRAL, HAPPY, SAD, ANGRY, SCARED, DISGUSTED, SURPRISED)
"""Ekman's categories under the names of hri_msgs/Expression, in the order of the network's outputs."""

PROTOTYPES: Dict[str, Tuple[Tuple[int, float], ...]] = {
    NEUTRAL: (),
    HAPPY: ((12, 4.0), (6, 1.5), (15, -2.0), (4, -1.0)),
    SAD: ((15, 3.0), (1, 1.5), (4, 1.5), (17, 1.0), (12, -4.0), (25, -0.5)),
    ANGRY: ((4, 2.5), (7, 1.0), (23, 1.5), (24, 1.5), (5, 1.0), (17, 0.5), (1, -1.5), (12, -4.0)),
    SCARED: ((20, 2.0), (5, 1.5), (1, 1.0), (2, 0.5), (4, 1.0), (26, 0.5), (25, 0.5), (12, -4.0)),
    DISGUSTED: ((9, 3.0), (10, 2.0), (17, 0.5), (4, 0.5), (12, -4.0)),
    SURPRISED: ((5, 1.5), (26, 2.0), (1, 1.5), (2, 1.5), (27, 1.5), (4, -2.0), (12, -3.0)),
}
"""Action unit and weight in the category's log-probability, per full intensity.

The units with positive weights are those of the prototypes in the FACS Investigator's Guide and EMFACS (Ekman, Friesen
and Hager 2002; Ekman and Friesen 1983): happy 6+12; sad 1+4+15(+17); angry 4+5+7+23/24; scared 1+2+4+5+20+25/26;
disgusted 9/10+17; surprised 1+2+5B+26/27. The weights are ours: larger for units that few other categories share and
that the mesh measures well; negative ones stand for units that contradict the category.
"""

NEUTRAL_WEIGHT = 1.5
"""Log-probability that a face without action units is neutral, over that of any other category."""

PLANE: Dict[str, Tuple[float, float]] = {
    NEUTRAL: (0.0, 0.0),
    HAPPY: (0.76, 0.48),
    SAD: (-0.63, -0.27),
    ANGRY: (-0.51, 0.59),
    SCARED: (-0.64, 0.60),
    DISGUSTED: (-0.60, 0.35),
    SURPRISED: (0.40, 0.67),
}
"""Valence and arousal of each category: ratings of emotion words by Russell and Mehrabian (1977), "Evidence for a
three-factor theory of emotions", J. Research in Personality 11; neutral is the origin."""
