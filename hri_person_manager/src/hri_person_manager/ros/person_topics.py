"""Topics of the persons: the lists, and what is latched under /humans/persons/ID."""

from __future__ import annotations

from typing import Dict

import genpy
from std_msgs.msg import Bool, Float32, String

from hri_person_manager.core.person_state import PersonState, Snapshot
from hri_pipeline.ros.topic_lease import TopicLeases, TopicSpec
from hri_pipeline.ros.tracked_list import TrackedList

NAMESPACE = "/humans/persons"
CONFIDENCE_STEP = 0.005     # a change of the confidence by less is not published
_TOPICS = {
    "face_id": TopicSpec(String, True, 10),
    "body_id": TopicSpec(String, True, 10),
    "voice_id": TopicSpec(String, True, 10),
    "location_confidence": TopicSpec(Float32, True, 10),
    "anonymous": TopicSpec(Bool, True, 10),
    "alias": TopicSpec(String, True, 10),
}


class PersonTopics:
    """Publishes what changed from one snapshot to the next; topics go away with their person."""

    def __init__(self) -> None:
        self._leases = TopicLeases(NAMESPACE, _TOPICS)
        self._tracked = TrackedList(NAMESPACE + "/tracked")
        self._known = TrackedList(NAMESPACE + "/known")
        self._published: Dict[str, Dict[str, object]] = {}

    def confidence(self, person_id: str) -> float:
        """Return the location confidence last published for a person, 0 if there is none."""
        return float(self._published.get(person_id, {}).get("location_confidence", 0.0))

    def update(self, snapshot: Snapshot, stamp: genpy.Time) -> None:
        """Publish the differences to the last snapshot."""
        listed = {state.id for state in snapshot.persons}
        for state in snapshot.persons:
            self._publish_person(state)
        self._tracked.set(snapshot.tracked, stamp)
        self._known.set(snapshot.known, stamp)
        for gone in [person_id for person_id in self._published if person_id not in listed]:
            del self._published[gone]
            self._leases.close(gone)

    def close(self) -> None:
        """Take all topics back; the lists end with the empty list. Idempotent."""
        self._tracked.close()
        self._known.close()
        self._leases.close_all()
        self._published.clear()

    def _publish_person(self, state: PersonState) -> None:
        values = {"face_id": state.face, "body_id": state.body, "voice_id": state.voice,
                  "location_confidence": state.confidence, "anonymous": state.anonymous, "alias": state.alias}
        if state.id not in self._published:
            self._leases.open(state.id)
            self._published[state.id] = {}
        last = self._published[state.id]
        for name, value in values.items():
            if name not in last or _differs(last[name], value):
                self._leases.publish(state.id, name, _TOPICS[name].type(value))
                last[name] = value


def _differs(old: object, new: object) -> bool:
    if isinstance(new, float):
        return abs(new - old) >= CONFIDENCE_STEP or (new != old and new in (0.0, 1.0))
    return new != old
