"""Everybody at one time as arrays: what is computed for all people at once needs no object for each."""

from __future__ import annotations

from typing import List, Optional, Sequence, Union

import numpy as np

from hri_pipeline.core.interactions.gaze_people import Onlooker

UNKNOWN = np.full(3, np.nan)
_NO_DEVIATIONS = np.zeros((0, 4))


class Crowd:
    """N people in the reference frame (z up, m); what is not known is NaN. The rows of all arrays are those of `ids`.

    heads: (N, 3) m; gazes, faces, trunks: (N, 3) unit vectors; deviations: (N, 4) of head's place (m), face, gaze and trunk
    (rad); closed: (N,) closedness of the eyes, 0 to 1.
    """

    __slots__ = ("closed", "deviations", "faces", "gazes", "heads", "ids", "trunks")

    def __init__(self, ids: List[str], heads: np.ndarray, gazes: np.ndarray, faces: np.ndarray, trunks: np.ndarray,
                 deviations: np.ndarray, closed: np.ndarray) -> None:
        self.ids, self.heads, self.gazes, self.faces, self.trunks = ids, heads, gazes, faces, trunks
        self.deviations, self.closed = deviations, closed

    def __len__(self) -> int:
        return len(self.ids)

    @classmethod
    def of(cls, people: Union["Crowd", Sequence[Onlooker]]) -> "Crowd":
        """Return the crowd of these onlookers; a crowd as it is."""
        if isinstance(people, cls):
            return people
        if not people:
            return cls.empty()
        columns = np.array([value if value is not None else UNKNOWN for person in people for value in (
            person.head, person.gaze_direction, person.head_direction, person.body_direction)], dtype=np.float64)
        columns = columns.reshape(len(people), 4, 3)
        deviations = np.array([(person.head_sd, person.head_direction_sd, person.gaze_direction_sd, person.body_direction_sd)
                               for person in people])
        closed = np.array([np.nan if person.eyes_closed is None else person.eyes_closed for person in people])
        return cls([person.id for person in people], columns[:, 0], columns[:, 1], columns[:, 2], columns[:, 3], deviations, closed)

    @classmethod
    def empty(cls) -> "Crowd":
        """Return a crowd of nobody."""
        nothing = np.zeros((0, 3))
        return cls([], nothing, nothing, nothing, nothing, _NO_DEVIATIONS, np.zeros(0))

    def onlookers(self) -> List[Onlooker]:
        """Return everybody as an object each."""
        return [Onlooker(identity, _known(self.heads[row]), sds[0], _known(self.faces[row]), sds[1], _known(self.gazes[row]), sds[2],
                         None if closed != closed else closed, _known(self.trunks[row]), sds[3])
                for row, (identity, sds, closed) in enumerate(zip(self.ids, self.deviations.tolist(), self.closed.tolist()))]


def _known(vector: np.ndarray) -> Optional[np.ndarray]:
    return vector if vector[0] == vector[0] else None       # not NaN
