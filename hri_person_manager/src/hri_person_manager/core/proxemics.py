"""How near persons are: the spaces of E. T. Hall, The Hidden Dimension (1966), as REP-155 names them."""

from __future__ import annotations

import math
from enum import Enum
from typing import Dict, List, Mapping, Optional

import numpy as np

from hri_person_manager.core.location import Place

HYSTERESIS_M = 0.1


class Space(Enum):
    """Name of the list of persons in each space."""

    PERSONAL = "in_personal_space"
    SOCIAL = "in_social_space"
    PUBLIC = "in_public_space"


_SPACES = tuple(Space)      # the nearest first


def horizontal_distance(place: Place, origin: np.ndarray) -> float:
    """Return the horizontal distance (m) of a place from `origin` (3,), m in the frame of the place.

    How high a face or a camera is does not matter.
    """
    x, y, z = (place.pose.translation - origin).tolist()
    return math.hypot(x, z if place.is_optical else y)


class Proxemics:
    """Sorts persons by distance; one who stands on a border does not go to and fro."""

    def __init__(self, personal: float = 1.2, social: float = 3.6) -> None:
        """Take the borders, as set_borders() does."""
        self.set_borders(personal, social)
        self._space: Dict[str, Space] = {}

    def set_borders(self, personal: float, social: float) -> None:
        """Set the outer borders (m) of the personal and the social space; ValueError unless 0 < personal < social."""
        if not 0.0 < personal < social:
            raise ValueError("personal_distance is %s m and social_distance %s m, wanted 0 < personal < social" % (
                personal, social))
        self._borders = (personal, social)

    def update(self, distances: Mapping[str, float]) -> Dict[Space, List[str]]:
        """Return who is in which space; `distances` (m) of all persons whose place is known."""
        self._space = {person_id: self._sort(self._space.get(person_id), distance)
                       for person_id, distance in distances.items()}
        return {space: self._members(space) for space in _SPACES}

    def _members(self, space: Space) -> List[str]:
        return sorted(person_id for person_id, found in self._space.items() if found is space)

    def _sort(self, before: Optional[Space], distance: float) -> Space:
        place = None if before is None else _SPACES.index(before)
        for number, border in enumerate(self._borders):
            # Each border is shifted away from a person who was on one side of it.
            margin = 0.0 if place is None else HYSTERESIS_M if place <= number else -HYSTERESIS_M
            if distance < border + margin:
                return _SPACES[number]
        return Space.PUBLIC
