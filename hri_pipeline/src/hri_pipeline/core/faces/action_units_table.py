"""What is measured on the face mesh for each action unit: one table, with points, formula, scale and source.

Action units: Ekman and Friesen, Facial Action Coding System (1978; Ekman, Friesen and Hager 2002): the number and the
visible change that is its definition. Points: vertices of MediaPipe's face mesh (Apache-2.0) on the subject's right;
`MIRROR` has those of the left. Lengths are in parts of the distance between the middles of the eyes (63 mm in the
canonical face), on the mesh turned and scaled onto the canonical face; axes: out = away from the mid-line, up = to the
scalp, left = to the subject's left.

`neutral` and `spread`: mean and standard deviation of a measure over people with a relaxed face, from photographs
(see docs/face_features.md); start values until the person's own are known. `quantile`: where in the values of
somebody's quiet moments the neutral lies; below 0.5 for what expressions and speech only make larger.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, Tuple

Points = Tuple[int, ...]

MIRROR: Dict[int, int] = {
    33: 263, 133: 362, 158: 385, 159: 386, 160: 387, 144: 373, 145: 374, 153: 380, 107: 336, 55: 285, 70: 300, 46: 276,
    63: 293, 53: 283, 105: 334, 52: 282, 50: 280, 101: 330, 118: 347, 64: 294, 48: 278, 102: 331, 37: 267, 39: 269,
    61: 291, 76: 306, 82: 312, 87: 317, 84: 314, 148: 377, 468: 473, 40: 270, 81: 311, 178: 402, 91: 321, 181: 405,
    127: 356, 234: 454, 132: 361, 54: 284, 67: 297, 143: 372, 21: 251, 103: 332, 109: 338, 162: 389, 93: 323,
}
"""Vertex on the subject's right -> the same place on the left; a vertex that is not here lies on the mid-line."""

RIGID: Points = (10, 54, 67, 103, 109, 21, 162, 127, 234, 93, 132, 143, 33, 133, 168, 6, 197, 195, 151)
"""Vertices by which the mesh is laid onto the canonical face (their mirrors too): no muscle of the table moves them."""

EYE_MIDDLES: Tuple[Points, Points] = ((33, 133), (263, 362))


@dataclass(frozen=True)
class Measure:
    """The mean of the points `of` minus that of the points `over`, along an axis; `sided`: one value per side."""

    name: str
    of: Points
    over: Points
    axis: str
    sided: bool
    neutral: float
    spread: float
    quantile: float = 0.5


MEASURES: Tuple[Measure, ...] = (
    Measure("brow_inner", (107, 55), (133,), "up", True, 0.305, 0.040),
    Measure("brow_outer", (70, 46, 63, 53), (133,), "up", True, 0.280, 0.045),
    Measure("brow_gap", (107, 55), (168,), "out", True, 0.222, 0.018),
    Measure("lid_upper", (158, 159, 160), (33, 133), "up", True, 0.090, 0.025, 0.6),
    Measure("lid_lower", (144, 145, 153), (33, 133), "up", True, -0.043, 0.013, 0.4),
    Measure("lid_opening", (158, 159, 160), (144, 145, 153), "up", True, 0.132, 0.025, 0.6),
    Measure("cheek", (50, 101, 118), (133,), "up", True, -0.406, 0.025, 0.35),
    Measure("nose_wing", (64, 48, 102), (133,), "up", True, -0.600, 0.032, 0.35),
    Measure("upper_lip", (37, 39, 40), (133,), "up", True, -1.000, 0.055, 0.35),
    Measure("lip_nose", (0, 37, 267), (2,), "up", False, -0.231, 0.035, 0.5),
    Measure("corner_up", (61, 76), (133,), "up", True, -1.112, 0.060, 0.35),
    Measure("corner_out", (61, 76), (168, 6), "out", True, 0.410, 0.030, 0.4),
    Measure("corner_level", (61, 76), (13, 14), "up", True, 0.004, 0.024, 0.5),
    Measure("lip_gap", (13, 82, 312), (14, 87, 317), "up", False, 0.003, 0.010, 0.2),
    Measure("upper_thickness", (0, 37, 267), (13, 82, 312), "up", False, 0.112, 0.024),
    Measure("lower_thickness", (14, 87, 317), (17, 84, 314), "up", False, 0.163, 0.027),
    Measure("lower_lip", (17, 84, 314), (2,), "up", False, -0.542, 0.060, 0.5),
    Measure("chin", (152, 148, 377), (2,), "up", False, -1.173, 0.080, 0.65),
    Measure("iris_left", (468,), (33, 133), "left", True, -0.008, 0.030),
    Measure("iris_up", (468,), (33, 133), "up", True, 0.034, 0.012),
)


@dataclass(frozen=True)
class ActionUnit:
    """One unit: the sum of gain x (measure - neutral) over the terms; `start` gives intensity 0, `full` 1.

    While the person's own neutral is not known, `start` grows by the standard deviation that the sum has between people.
    without: units that make this one's change too; its intensity is multiplied by 1 - theirs. reliability: factor on
    the confidence, below 1 where the mesh shows only a part of what a human coder sees (wrinkles, bulges).
    """

    code: int
    name: str
    terms: Tuple[Tuple[str, float], ...]
    start: float
    full: float
    without: Points = ()
    reliability: float = 1.0
    visible: str = ""


ACTION_UNITS: Tuple[ActionUnit, ...] = (
    ActionUnit(1, "inner brow raiser", (("brow_inner", 1.0),), 0.03, 0.15, (), 0.9, "inner part of the brow up"),
    ActionUnit(2, "outer brow raiser", (("brow_outer", 1.0),), 0.03, 0.15, (), 0.9, "outer part of the brow up"),
    ActionUnit(4, "brow lowerer", (("brow_inner", -0.6), ("brow_outer", -0.4), ("brow_gap", -1.0)), 0.03, 0.14, (), 0.7,
               "brows down and together"),
    ActionUnit(5, "upper lid raiser", (("lid_upper", 1.0), ("lid_opening", 0.5)), 0.025, 0.09, (), 0.8,
               "upper lid up, more of the eyeball seen"),
    ActionUnit(6, "cheek raiser", (("cheek", 0.6), ("lid_lower", 1.0)), 0.02, 0.10, (), 0.6,
               "cheeks up, lower lid pushed up"),
    ActionUnit(7, "lid tightener", (("lid_lower", 1.0), ("lid_opening", -0.5)), 0.02, 0.08, (45,), 0.5,
               "lower lid up and tight, eye narrowed"),
    ActionUnit(9, "nose wrinkler", (("nose_wing", 1.0), ("brow_inner", -0.3)), 0.03, 0.12, (), 0.6,
               "wings of the nose up, inner brow down"),
    ActionUnit(10, "upper lip raiser", (("upper_lip", 1.0), ("corner_up", -0.5)), 0.03, 0.15, (), 0.6,
               "middle of the upper lip up, more than its corners"),
    ActionUnit(12, "lip corner puller", (("corner_up", 0.6), ("corner_out", 0.8)), 0.03, 0.18, (), 0.95,
               "corners of the mouth up and out"),
    ActionUnit(14, "dimpler", (("corner_out", 1.0), ("lip_gap", -0.5), ("corner_level", -0.3)), 0.03, 0.12, (12, 25),
               0.3, "corners tightened and drawn in"),
    ActionUnit(15, "lip corner depressor", (("corner_level", -1.0), ("corner_up", -0.4)), 0.03, 0.12, (26,), 0.7,
               "corners of the mouth down"),
    ActionUnit(17, "chin raiser", (("lower_lip", 1.0), ("lip_nose", -0.5)), 0.03, 0.12, (25,), 0.6,
               "chin and lower lip pushed up"),
    ActionUnit(20, "lip stretcher", (("corner_out", 1.0), ("corner_up", -0.6)), 0.05, 0.18, (12,), 0.5,
               "corners drawn to the side, mouth long and flat"),
    ActionUnit(23, "lip tightener", (("upper_thickness", -0.7), ("lower_thickness", -0.7), ("corner_out", -0.5)),
               0.04, 0.15, (25, 28), 0.4, "lips narrow and tight"),
    ActionUnit(24, "lip pressor", (("upper_thickness", -0.8), ("lower_thickness", -0.8), ("lip_gap", -1.0)),
               0.03, 0.12, (25, 28), 0.4, "lips pressed together"),
    ActionUnit(25, "lips part", (("lip_gap", 1.0),), 0.02, 0.20, (), 1.0, "lips apart"),
    ActionUnit(26, "jaw drop", (("chin", -1.0),), 0.04, 0.20, (), 0.8, "lower jaw down, relaxed"),
    ActionUnit(27, "mouth stretch", (("lip_gap", 1.0), ("chin", -0.5)), 0.38, 0.70, (), 0.8, "mouth pulled wide open"),
    ActionUnit(28, "lip suck", (("upper_thickness", -1.0), ("lower_thickness", -1.0)), 0.13, 0.22, (25,), 0.5,
               "red of the lips drawn into the mouth"),
)
"""Units that are such sums. 43 and 45, 51 to 58, 61 to 64 and 70 to 73 have rules of their own in `action_units`."""
