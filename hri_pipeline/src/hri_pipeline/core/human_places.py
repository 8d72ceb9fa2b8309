"""Where voices, faces and persons are: their own frames out of the transforms of the graph, of those who are followed."""

from __future__ import annotations

import math
from typing import Dict, Iterable, NamedTuple, Optional, Tuple

from hri_pipeline.core.tf_scan import RawTransform

FRESH_S = 2.0
"""An older place is not where somebody is; person_ID is repeated as long as it means something."""
_PREFIXES = {"voice": b"voice_", "face": b"face_", "person": b"person_"}


class HumanPlace(NamedTuple):
    """Position (m) in a frame of a sensor, or in the reference frame, at `stamp`."""

    frame: str
    position: Tuple[float, float, float]
    secs: int
    nsecs: int

    @property
    def stamp(self) -> float:
        """Stamp in s."""
        return self.secs + 1e-9 * self.nsecs


class HumanPlaces:
    """Keeps the last place of each frame voice_ID, face_ID and person_ID that is followed."""

    def __init__(self) -> None:
        self._wanted: Dict[bytes, Tuple[str, str]] = {}
        self._places: Dict[Tuple[str, str], HumanPlace] = {}

    def follow(self, kind: str, ids: Iterable[str]) -> None:
        """Follow these ids of "voice", "face" or "person"; those of others of the kind are let go."""
        keys = {(kind, id) for id in ids}
        self._wanted = {frame: key for frame, key in self._wanted.items() if key[0] != kind}
        self._wanted.update((_PREFIXES[kind] + id.encode(), (kind, id)) for kind, id in keys)
        self._places = {key: place for key, place in self._places.items() if key[0] != kind or key in keys}

    def wants(self, child: bytes) -> bool:
        """Tell whether the transform of a frame is to be put()."""
        return child.lstrip(b"/") in self._wanted

    def put(self, transform: RawTransform) -> None:
        """Take the transform of a frame that is wanted. ValueError for numbers that are none."""
        if not all(map(math.isfinite, transform.translation)):
            raise ValueError("a translation holds numbers that are not finite")
        self._places[self._wanted[transform.child.encode()]] = HumanPlace(
            transform.parent, transform.translation, transform.secs, transform.nsecs)

    def get(self, kind: str, id: str, now: float) -> Optional[HumanPlace]:
        """Return where somebody is at time `now` (s), None when that is not known or was long ago."""
        place = self._places.get((kind, id))
        return place if place is not None and abs(now - place.stamp) <= FRESH_S else None

    def all(self, now: float) -> Dict[Tuple[str, str], HumanPlace]:
        """Return the places of all faces and persons at time `now` (s)."""
        return {key: place for key, place in self._places.items() if key[0] != "voice" and abs(now - place.stamp) <= FRESH_S}

    def clear(self) -> None:
        """Forget all places."""
        self._places.clear()
