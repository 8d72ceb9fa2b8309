"""How many persons are seen: those who are only a voice are persons, too, but nobody whom a picture could show."""

from __future__ import annotations

import threading
from typing import Dict, List, Tuple

from std_msgs.msg import String
from view_state import seen_and_heard

from hri_pipeline.ros.subscriptions import IdSubscribers


class SeenPersons:
    """Follows which of the tracked persons have a face or a body."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._ids: List[str] = []
        self._features: Dict[str, Dict[str, str]] = {}
        self._feed = IdSubscribers("persons", {"face_id": String, "body_id": String}, self._on_feature, self._on_ids)

    def split(self) -> Tuple[List[str], List[str]]:
        """Return the persons who are seen now, and those who are only heard."""
        with self._lock:
            return seen_and_heard(self._ids, self._features)

    def _on_ids(self, ids: List[str]) -> None:
        with self._lock:
            self._ids = ids
            self._features = {person: known for person, known in self._features.items() if person in ids}

    def _on_feature(self, person: str, name: str, message: String) -> None:
        with self._lock:
            self._features.setdefault(person, {})[name] = message.data
