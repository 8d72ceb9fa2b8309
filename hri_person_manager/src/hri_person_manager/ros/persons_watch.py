"""Follows the persons on the graph for the live table."""

from __future__ import annotations

import threading
import time
from typing import Dict, List, Set, Tuple

import genpy
import rospy
from std_msgs.msg import Float32, String

from hri_person_manager.core.persons_table import PersonRow, RateMeter
from hri_pipeline.core.tf_scan import RawTransform, read
from hri_pipeline.ros.feature_feed import FeatureFeed
from hri_pipeline.ros.robot_frames import SKELETONS
from hri_pipeline.ros.tf_feed import Frames, TfFeed

_TOPICS = {"face_id": String, "body_id": String, "voice_id": String, "location_confidence": Float32}


class PersonsWatch:
    """Latest state of all tracked persons, and the rates at which faces and bodies come."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._ids: List[str] = []
        self._values: Dict[str, Dict[str, object]] = {}
        self._frames: Dict[str, Tuple[RawTransform, float]] = {}
        self._rates = {"face_": RateMeter(), "body_": RateMeter()}
        self.seen: Set[str] = set()
        self._feed = FeatureFeed("persons", _TOPICS, self._on_value, self._on_tracked)
        self._ears = TfFeed(self._on_frames, skip=SKELETONS)

    def rows(self) -> List[PersonRow]:
        """Return one row per tracked person, by id."""
        with self._lock:
            return [self._row(person_id) for person_id in sorted(self._ids)]

    def rates(self) -> Tuple[float, float]:
        """Return the images per second in which faces and bodies were found."""
        now = time.monotonic()
        with self._lock:
            return self._rates["face_"].rate(now), self._rates["body_"].rate(now)

    def close(self) -> None:
        """Let go of all topics. Idempotent."""
        self._feed.close()
        self._ears.close()

    def _row(self, person_id: str) -> PersonRow:
        values = self._values.get(person_id, {})
        position, frame, age = None, "", None
        if person_id in self._frames:
            transform, age_at_arrival = self._frames[person_id]
            position, frame, age = transform.translation, transform.parent, age_at_arrival
        return PersonRow(person_id, str(values.get("face_id", "")), str(values.get("body_id", "")),
                         str(values.get("voice_id", "")), float(values.get("location_confidence", 0.0)),
                         position, frame, age)

    def _on_tracked(self, ids: List[str]) -> None:
        with self._lock:
            self._ids = list(ids)
            self.seen.update(ids)
            for known in (self._values, self._frames):
                for gone in [person_id for person_id in known if person_id not in ids]:
                    del known[gone]

    def _on_value(self, identity: str, name: str, message: genpy.Message) -> None:
        with self._lock:
            self._values.setdefault(identity, {})[name] = message.data

    def _on_frames(self, data: bytes, frames: Frames, fixed: bool) -> None:
        if fixed:
            return
        now, arrival = rospy.get_time(), time.monotonic()
        with self._lock:
            for child, offset in frames:
                name = child.decode("utf-8", "replace").lstrip("/")
                if name[:5] in self._rates:
                    self._rates[name[:5]].add(read(data, offset).stamp, arrival)
                elif name.startswith("person_") and name[7:] in self._ids:
                    transform = read(data, offset)
                    self._frames[name[7:]] = (transform, 1e3 * (now - transform.stamp))
