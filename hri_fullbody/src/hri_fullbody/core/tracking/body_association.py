"""Which body a look has shown: by place, depth, appearance and face."""

from __future__ import annotations

import math
from typing import Optional, Sequence

import numpy as np

from hri_fullbody.core.sight.body_sight import Sight
from hri_fullbody.core.sight.body_windows import FaceBox
from hri_fullbody.core.tracking.body_appearance import difference
from hri_fullbody.core.tracking.body_track import BodyTrack

# A nose further than this from the middle of its face (in face sizes, 0.5 is the rim) belongs to somebody else.
NOSE_IN_FACE = 0.5
NOSE_IN_OWN_FACE = 0.65
MAX_COST = 14.0
_CENTRE_NOISE = 0.08        # of the body's size: the trunk of one body in two windows
_FARTHEST = 3.0             # body sizes: nobody gets so far while he is remembered
# What the window of another body shows is a visible body only where that is expected: else it is somebody between them.
_FOREIGN_OFFSET = 1.5       # standard deviations
_FOREIGN_NOSE = 0.1         # body sizes
_LARGEST_OFFSET = 4.0       # standard deviations
_LARGEST_DEPTH = 3.5        # standard deviations
_LOOKS_SD = 0.16            # Hellinger distance of one human in two images, see the test on photographs
_LARGEST_LOOKS, _LARGEST_LOOKS_AFTER = 0.6, 0.45    # while it is followed, and when it comes back
_UNKNOWN_LOOKS = 0.3
_HIDDEN_COST = 1.5          # of two that fit alike, the one that was visible a moment ago is meant
_FOREIGN_COST = 0.5         # found in the window of another body


def association_cost(track: BodyTrack, sight: Sight, stamp: float, face: Optional[FaceBox],
                     foreign_face: bool) -> float:
    """Cost, like half a squared distance in standard deviations, of `sight` being `track` at `stamp`; inf: it is not.

    face: the track's own in this image. With one, the nose decides: place and appearance only choose among those that
    it allows. foreign_face: the nose lies in the face of another body.
    """
    nose = sight.estimate.nose
    if foreign_face or (face is not None and face.distance(nose) > NOSE_IN_OWN_FACE):
        return math.inf
    if face is None and math.hypot(*(sight.estimate.centre - track.estimate.centre)) > _FARTHEST * track.motion.size:
        return math.inf
    offset = track.motion.image_distance(sight.estimate.centre, stamp, _CENTRE_NOISE)
    if face is None and track.visible and sight.source != track.id and (
            offset > _FOREIGN_OFFSET or _nose_offset(track, sight, stamp) > _FOREIGN_NOSE):
        return math.inf
    depth = track.motion.depth_distance(sight.root, stamp)
    unlike = difference(track.looks, sight.looks)
    unlike = unlike if unlike is not None else 0.0 if track.visible else _UNKNOWN_LOOKS
    if face is None and not track.visible and unlike > _LARGEST_LOOKS_AFTER:
        return math.inf
    if face is None and (offset > _LARGEST_OFFSET or depth > _LARGEST_DEPTH or unlike > _LARGEST_LOOKS):
        return np.inf
    cost = min(offset, _LARGEST_OFFSET) ** 2 / 2.0 + min(depth, _LARGEST_DEPTH) ** 2 / 4.0
    cost += (unlike / _LOOKS_SD) ** 2 / 2.0
    cost += (0.0 if track.visible else _HIDDEN_COST) + (0.0 if sight.source == track.id else _FOREIGN_COST)
    return min(cost, MAX_COST - 1.0) if face is not None else cost


def _nose_offset(track: BodyTrack, sight: Sight, stamp: float) -> float:
    return math.hypot(*(sight.estimate.nose - track.expected(stamp).nose)) / track.motion.size


def cost_matrix(tracks: Sequence[BodyTrack], sights: Sequence[Sight], stamp: float,
                faces: Sequence[FaceBox]) -> np.ndarray:
    """Costs (T, S) of each sight being each track; inf where it cannot be."""
    own = {face.id: face for face in faces}
    owners = {track.face_id: track.id for track in tracks if track.face_id is not None}
    costs = np.full((len(tracks), len(sights)), np.inf)
    for column, sight in enumerate(sights):
        seen_in = nearest_face(sight, faces)
        owner = owners.get(seen_in.id) if seen_in is not None else None
        for row, track in enumerate(tracks):
            foreign = owner not in (None, track.id)
            costs[row, column] = association_cost(track, sight, stamp, own.get(track.face_id), foreign)
    return costs


def nearest_face(sight: Sight, faces: Sequence[FaceBox]) -> Optional[FaceBox]:
    """Return the face in which the nose of a sight lies, None when in none."""
    nose = sight.estimate.nose
    best = min(faces, key=lambda face: face.distance(nose), default=None)
    return best if best is not None and best.distance(nose) <= NOSE_IN_FACE else None
