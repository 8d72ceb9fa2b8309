"""What a human looks like, of spheres and cylinders: urdfdom has no capsules, and no file has to be found.

All sizes are shares of the stature, or of the segment that they clothe. Places are in the axes of the link: x forward,
y to the left, z to the head; limbs point to -z.
"""

from __future__ import annotations

import math
from typing import Dict, List, NamedTuple, Sequence, Tuple

from hri_fullbody.core.human.human_model import Dimensions

Point = Tuple[float, float, float]

MATERIALS: Dict[str, Tuple[float, float, float]] = {
    "skin": (0.87, 0.66, 0.53), "hair": (0.23, 0.15, 0.10), "white": (0.95, 0.95, 0.95),
    "pupil": (0.10, 0.10, 0.14), "lips": (0.72, 0.38, 0.36),
    "shirt": (0.30, 0.52, 0.70), "trousers": (0.27, 0.30, 0.38), "shoes": (0.24, 0.19, 0.16),
}


class Shape(NamedTuple):
    """A sphere, or a cylinder if `length` is more than 0: its axis is z turned by pitch, then yaw (rad). m."""

    place: Point
    radius: float
    material: str
    length: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.0


def _capsule(a: Point, b: Point, radius: float, material: str) -> List[Shape]:
    """A rod with round ends."""
    return [Shape(a, radius, material), _rod(a, b, radius, material), Shape(b, radius, material)]


def _rod(a: Point, b: Point, radius: float, material: str) -> Shape:
    """A cylinder from a to b."""
    dx, dy, dz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    across = math.hypot(dx, dy)
    middle = (0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]), 0.5 * (a[2] + b[2]))
    return Shape(middle, radius, material, math.hypot(across, dz), math.atan2(across, dz), math.atan2(dy, dx))


def _limb(length: float, profile: Sequence[Tuple[float, float, float]], material: str) -> List[Shape]:
    """A tapered limb along -z. profile: share of the length, radius (m), offset to the front (m); ends are round."""
    shapes: List[Shape] = []
    places = [((offset, 0.0, -share * length), radius) for share, radius, offset in profile]
    for (a, ra), (b, rb) in zip(places, places[1:]):
        pieces = max(1, min(4, int(abs(ra - rb) / 0.004)))
        for i in range(pieces):
            low, high = i / pieces, (i + 1) / pieces
            radius = ra + (rb - ra) * 0.5 * (low + high)
            shapes.append(_rod(_between(a, b, low), _between(a, b, high), radius, material))
    shapes.append(Shape(places[0][0], places[0][1], material))
    shapes.append(Shape(places[-1][0], places[-1][1], material))
    return shapes


def _between(a: Point, b: Point, share: float) -> Point:
    return (a[0] + (b[0] - a[0]) * share, a[1] + (b[1] - a[1]) * share, a[2] + (b[2] - a[2]) * share)


def body_shapes(dimensions: Dimensions) -> Dict[str, Tuple[Shape, ...]]:
    """Shapes of each link that has any, by the link's name without the body's id."""
    h = dimensions.stature
    shapes: Dict[str, List[Shape]] = {
        "body": _pelvis(dimensions), "torso": _torso(dimensions), "head": _head(h / 1.70)}
    for side, sign in (("l_", 1.0), ("r_", -1.0)):
        shapes[side + "shoulder"] = _limb(
            dimensions.upper_arm, ((0.0, 0.036 * h, 0.0), (0.30, 0.031 * h, 0.0), (0.62, 0.0285 * h, 0.0)), "shirt")
        shapes[side + "shoulder"] += _limb(
            dimensions.upper_arm, ((0.55, 0.0265 * h, 0.0), (1.0, 0.0235 * h, 0.0)), "skin")
        shapes[side + "elbow"] = _limb(
            dimensions.forearm, ((0.0, 0.0235 * h, 0.0), (0.22, 0.0255 * h, 0.0), (1.0, 0.0155 * h, 0.0)), "skin")
        shapes[side + "wrist"] = _hand(h, sign)
        shapes[side + "hip"] = _limb(
            dimensions.thigh, ((0.0, 0.052 * h, 0.0), (0.35, 0.046 * h, 0.0), (1.0, 0.033 * h, 0.0)), "trousers")
        shapes[side + "knee"] = _limb(
            dimensions.shank,
            ((0.0, 0.033 * h, 0.0), (0.30, 0.034 * h, -0.006 * h), (0.95, 0.024 * h, 0.0)), "trousers")
        shapes[side + "ankle"] = _foot(dimensions, sign)
    return {name: tuple(parts) for name, parts in shapes.items()}


def _pelvis(dimensions: Dimensions) -> List[Shape]:
    h, half = dimensions.stature, dimensions.half_hips
    shapes: List[Shape] = []
    for height, reach, radius, offset in ((-0.012, 0.85, 0.056, -0.008), (0.02, 0.95, 0.057, -0.004),
                                          (0.052, 0.85, 0.056, 0.0)):
        end = reach * half
        shapes += _capsule((offset * h, end, height * h), (offset * h, -end, height * h), radius * h, "trousers")
    return shapes


def _torso(dimensions: Dimensions) -> List[Shape]:
    """Chest and belly: rods from side to side, one above the other; then the slope of the shoulders and the neck."""
    h, shoulder, trunk = dimensions.stature, dimensions.half_shoulders, dimensions.trunk
    # share of the trunk's length above the hips, half width (share of the half shoulders), radius, offset
    levels = ((0.20, 0.40, 0.0550, 0.000), (0.30, 0.39, 0.0560, 0.002), (0.40, 0.39, 0.0570, 0.003),
              (0.50, 0.42, 0.0590, 0.003), (0.60, 0.48, 0.0620, 0.003), (0.70, 0.54, 0.0640, 0.003),
              (0.79, 0.58, 0.0620, 0.002), (0.87, 0.64, 0.0540, 0.000), (0.94, 0.72, 0.0440, -0.002))
    shapes: List[Shape] = []
    for share, reach, radius, offset in levels:
        end, z = reach * shoulder, (share - 1.0) * trunk
        shapes += _capsule((offset * h, end, z), (offset * h, -end, z), radius * h, "shirt")
    shapes += _capsule((-0.004 * h, shoulder, 0.0), (-0.004 * h, -shoulder, 0.0), 0.034 * h, "shirt")
    for sign in (1.0, -1.0):
        shapes += _capsule((-0.006 * h, sign * 0.85 * shoulder, 0.006 * h), (-0.006 * h, sign * 0.014 * h, 0.030 * h),
                           0.030 * h, "shirt")
    shapes.append(_rod((-0.002 * h, 0.0, 0.0), (0.010 * h, 0.0, 0.085 * h), 0.0315 * h, "skin"))
    return shapes


def _head(scale: float) -> List[Shape]:
    """The head about the sellion, for a stature of 1.70 m times `scale`."""
    def ball(x: float, y: float, z: float, radius: float, material: str) -> Shape:
        return Shape((x * scale, y * scale, z * scale), radius * scale, material)

    def rod(a: Point, b: Point, radius: float, material: str) -> Shape:
        return _rod(tuple(v * scale for v in a), tuple(v * scale for v in b), radius * scale, material)

    shapes = [
        ball(-0.086, 0.0, 0.026, 0.0770, "skin"), ball(-0.078, 0.0, 0.000, 0.0740, "skin"),
        ball(-0.074, 0.0, -0.024, 0.0690, "skin"), ball(-0.068, 0.0, -0.046, 0.0610, "skin"),
        ball(-0.058, 0.0, -0.066, 0.0520, "skin"), ball(-0.050, 0.0, -0.082, 0.0420, "skin"),
        ball(-0.040, 0.0, -0.091, 0.0300, "skin"),
        # hair: over the top, the back and the temples
        ball(-0.094, 0.0, 0.037, 0.0790, "hair"), ball(-0.112, 0.0, 0.020, 0.0760, "hair"),
        ball(-0.116, 0.0, -0.008, 0.0700, "hair"), ball(-0.112, 0.0, -0.032, 0.0600, "hair"),
        # nose
        rod((-0.004, 0.0, -0.006), (0.016, 0.0, -0.042), 0.0085, "skin"), ball(0.015, 0.0, -0.043, 0.0115, "skin"),
        ball(-0.006, 0.0, -0.004, 0.0085, "skin"),
    ]
    for sign in (1.0, -1.0):
        shapes += [
            ball(-0.0155, sign * 0.0315, 0.0, 0.0125, "white"), ball(-0.0070, sign * 0.0310, 0.0, 0.0058, "pupil"),
            rod((-0.0060, sign * 0.018, 0.017), (-0.0150, sign * 0.046, 0.018), 0.0035, "hair"),
            ball(0.007, sign * 0.009, -0.045, 0.0075, "skin"),
            rod((-0.094, sign * 0.068, -0.014), (-0.098, sign * 0.079, -0.012), 0.0270, "skin"),
            rod((-0.089, sign * 0.067, -0.034), (-0.091, sign * 0.075, -0.034), 0.0150, "skin"),
            rod((-0.0035, 0.0, -0.0705), (-0.0105, sign * 0.022, -0.0690), 0.0052, "lips"),
        ]
    # the neck's upper end, under the skull
    shapes.append(rod((-0.090, 0.0, -0.150), (-0.086, 0.0, -0.050), 0.0520, "skin"))
    return shapes


def _hand(h: float, sign: float) -> List[Shape]:
    """Palm towards the body: three rods for palm and fingers side by side, and a thumb in front."""
    shapes: List[Shape] = []
    for x, end in ((-0.0125, 0.094), (0.0, 0.105), (0.0125, 0.098)):
        knuckle, tip = (x * h, 0.0, -0.050 * h), (x * h, -sign * 0.005 * h, -end * h)
        shapes += [_rod((0.6 * x * h, 0.0, 0.0), knuckle, 0.0100 * h, "skin"), Shape(knuckle, 0.0100 * h, "skin"),
                   _rod(knuckle, tip, 0.0074 * h, "skin"), Shape(tip, 0.0074 * h, "skin")]
    base, tip = (0.010 * h, -sign * 0.002 * h, -0.018 * h), (0.030 * h, -sign * 0.008 * h, -0.056 * h)
    return shapes + [_rod(base, tip, 0.0074 * h, "skin"), Shape(tip, 0.0074 * h, "skin")]


def _foot(dimensions: Dimensions, sign: float) -> List[Shape]:
    """A shoe: heel, instep and two rods to the toes, its sole on the floor."""
    h, floor = dimensions.stature, -dimensions.ankle_height
    heel, toe = 0.022 * h, 0.0185 * h
    back = (-0.024 * h, 0.0, floor + heel)
    inner = (0.098 * h, -sign * 0.006 * h, floor + toe)
    outer = (0.088 * h, sign * 0.007 * h, floor + toe)
    shapes = [Shape(back, heel, "shoes")]
    for front in (inner, outer):
        shapes += [_rod(back, front, toe, "shoes"), Shape(front, toe, "shoes")]
    instep = (0.052 * h, 0.0, floor + 1.25 * toe)
    shapes += _capsule((0.0, 0.0, floor + 0.040 * h), instep, 0.0225 * h, "shoes")
    shapes.append(_rod((0.0, 0.0, 0.006 * h), (0.002 * h, 0.0, floor + 0.030 * h), 0.0225 * h, "shoes"))
    return shapes
