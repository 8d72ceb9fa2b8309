"""The lists of persons in the personal, social and public space of the robot."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Dict, Optional, Tuple

import genpy

from hri_person_manager.core.location import Place
from hri_person_manager.core.person_state import Snapshot
from hri_person_manager.core.proxemics import Proxemics, Space
from hri_person_manager.ros.person_topics import NAMESPACE
from hri_person_manager.ros.tf_intake import TfIntake
from hri_pipeline.ros.tracked_list import TrackedList

Point = Tuple[float, ...]
_ORIGIN = (0.0, 0.0, 0.0)


class PersonSpaces:
    """Publishes who is how near: measured from `robot_frame`, or from the sensor that saw the person last."""

    def __init__(self, settings: SimpleNamespace, intake: TfIntake) -> None:
        """Take the values of the manager's parameters. ParameterError-free: ValueError for borders in the wrong order."""
        self._robot_frame = settings.robot_frame
        self._reference = settings.reference_frame
        self._intake = intake
        self._proxemics = Proxemics(settings.personal_distance, settings.social_distance)
        self._sensors: Dict[str, str] = {}
        self._lists = {space: TrackedList("{}/{}".format(NAMESPACE, space.value)) for space in Space}

    def reconfigure(self, settings: SimpleNamespace) -> None:
        """Take up the borders. ValueError when they are in the wrong order; then nothing has changed."""
        self._proxemics.set_borders(settings.personal_distance, settings.social_distance)

    def saw(self, person_id: str, sensor: str) -> None:
        """Note which sensor frame has placed a person."""
        self._sensors[person_id] = sensor

    def update(self, snapshot: Snapshot, stamp: genpy.Time) -> None:
        """Sort all persons whose place is known, and publish the lists that changed."""
        origins: Dict[str, Optional[Point]] = {}
        distances = {}
        for state in snapshot.persons:
            if state.place is None or state.confidence <= 0.0:
                continue
            origin = self._robot_frame or self._sensors.get(state.id, state.place.frame)
            if origin not in origins and state.place.frame != origin:
                origins[origin] = self._position(origin)
            distance = _distance(state.place, origin, self._reference, origins.get(origin))
            if distance is not None:
                distances[state.id] = distance
        listed = {state.id for state in snapshot.persons}
        self._sensors = {key: sensor for key, sensor in self._sensors.items() if key in listed}
        for space, ids in self._proxemics.update(distances).items():
            self._lists[space].set(ids, stamp)

    def close(self) -> None:
        """Publish empty lists and take the topics back. Idempotent."""
        for tracked in self._lists.values():
            tracked.close()

    def _position(self, frame: str) -> Optional[Point]:
        """Where a frame is in the reference frame, m; None when nothing leads there."""
        pose = self._intake.lookup(frame, genpy.Time())
        return None if pose is None else tuple(pose.translation.tolist())


def _distance(place: Place, origin: str, reference: str, position: Optional[Point]) -> Optional[float]:
    """Distance (m) of a place from `origin`, whose `position` (m) is given in the reference frame."""
    if place.frame == origin:
        return math.dist(place.pose.translation.tolist(), _ORIGIN)
    if place.frame == reference and position is not None:
        return math.dist(place.pose.translation.tolist(), position)
    return None
