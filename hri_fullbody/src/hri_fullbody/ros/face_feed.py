"""Faces that another process tracks, as boxes in this process's image."""

from __future__ import annotations

import threading
from typing import Dict, List, Tuple

import numpy as np

from hri_fullbody.core.body_windows import FaceBox
from hri_msgs.msg import FacialLandmarks
from hri_pipeline.ros.conversions import landmarks_from_msg
from hri_pipeline.ros.feature_feed import FeatureFeed

# A face this much older or newer than the image may be somewhere else by now.
MAX_AGE_S = 0.5


class FaceFeed:
    """Keeps the newest landmarks of each face in /humans/faces/tracked. Callbacks only store; `boxes` reads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._landmarks: Dict[str, Tuple[float, np.ndarray]] = {}
        self._feed = FeatureFeed("faces", {"landmarks": FacialLandmarks}, self._store, self._keep)

    def boxes(self, stamp: float, width: int, height: int) -> List[FaceBox]:
        """Return the faces within half a second of `stamp` (s), in px of an image of width x height."""
        with self._lock:
            known = dict(self._landmarks)
        found = []
        for identity, (seen, landmarks) in known.items():
            if abs(seen - stamp) <= MAX_AGE_S:
                try:
                    found.append(FaceBox.from_landmarks(identity, landmarks[:, :2] * np.array([width, height])))
                except ValueError:
                    continue  # a face of no size says nothing about a body
        return found

    def close(self) -> None:
        """Stop listening. Idempotent."""
        self._feed.close()

    def _store(self, identity: str, name: str, message: FacialLandmarks) -> None:
        landmarks = landmarks_from_msg(message)
        with self._lock:
            self._landmarks[identity] = (message.header.stamp.to_sec(), landmarks)

    def _keep(self, ids: List[str]) -> None:
        with self._lock:
            self._landmarks = {key: value for key, value in self._landmarks.items() if key in ids}
