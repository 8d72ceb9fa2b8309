"""Where the members of a formation stand and where they look: places on the floor, m, and headings, rad."""

from __future__ import annotations

import math
from typing import Dict, List, Sequence, Tuple

from hri_pipeline.core.scene.scene_model import (
    CIRCLE,
    L_SHAPE,
    ROBOT,
    SEMICIRCLE,
    SIDE_BY_SIDE,
    VIS_A_VIS,
    Formation,
    Point,
)

NEIGHBOURS = 0.7
"""Least distance, m, of neighbours in a circle or row: elbow to elbow (Hall's personal space, close phase, is 0.45 to 0.75 m)."""

Slot = Tuple[Point, float]


def slots(formation: Formation, robot: Point) -> Dict[str, Slot]:
    """Return place (m) and heading (rad) of each member who walks; the robot stays where it is, at `robot`.

    With the robot as a member, the place nearest to it counts as its own.
    """
    places = _places(formation.shape, formation.centre, formation.size, formation.yaw, len(formation.members))
    if ROBOT in formation.members:
        places.remove(min(places, key=lambda slot: math.hypot(slot[0][0] - robot[0], slot[0][1] - robot[1])))
    return dict(zip((member for member in formation.members if member != ROBOT), places))


def _places(shape: str, centre: Point, size: float, yaw: float, count: int) -> List[Slot]:
    if shape == SIDE_BY_SIDE:
        spacing = max(NEIGHBOURS, size)
        offsets = [(index - (count - 1) / 2.0) * spacing for index in range(count)]
        return [((centre[0] - offset * math.sin(yaw), centre[1] + offset * math.cos(yaw)), yaw) for offset in offsets]
    if shape == CIRCLE:
        angles: Sequence[float] = [2.0 * math.pi * index / count for index in range(count)]
    elif shape == SEMICIRCLE:
        angles = [math.pi * ((index + 0.5) / count - 0.5) for index in range(count)]
    else:
        angles = {VIS_A_VIS: (0.0, math.pi), L_SHAPE: (-math.pi / 4.0, math.pi / 4.0)}[shape]
    gap = min((abs(b - a) for a, b in zip(angles, angles[1:])), default=math.pi)
    radius = max(size / 2.0, NEIGHBOURS / 2.0 / max(math.sin(min(gap, math.pi) / 2.0), 1e-3))
    return [((centre[0] + radius * math.cos(yaw + angle), centre[1] + radius * math.sin(yaw + angle)),
             _wrapped(yaw + angle + math.pi)) for angle in angles]


def _wrapped(angle: float) -> float:
    return math.atan2(math.sin(angle), math.cos(angle))
