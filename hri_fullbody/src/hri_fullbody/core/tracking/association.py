"""Which track a detection belongs to: pose detections by place, depth, appearance and face; boxes by overlap.

The boxes of the person detector also confirm the tracks: the pose network finds a body in whatever window it is
given, also below a pattern that was taken for a face.
"""

from __future__ import annotations

import math
from typing import Dict, List, Optional, Sequence, Set

import numpy as np

from hri_fullbody.core.detection.pose_estimator import PoseDetection, inside, same_body
from hri_fullbody.core.detection.windows import FaceBox
from hri_fullbody.core.localization.localizer import face_cue
from hri_fullbody.core.tracking.reidentification import difference
from hri_fullbody.core.tracking.track import BodyTrack
from hri_pipeline.core.geometry import Pose, iou_matrix
from hri_pipeline.core.tracks import assign

# A nose further than this from the middle of its face (in face sizes, 0.5 is the rim) belongs to somebody else.
NOSE_IN_FACE = 0.5
NOSE_IN_OWN_FACE = 0.65
MAX_COST = 14.0
_CENTRE_NOISE = 0.08        # of the body's size: the trunk of one body in two windows
# Who was hidden comes back near where he would be, or stayed, and as large: standard deviations in body sizes, at once
# and per second, and of the logarithm of the size.
_RETURN_SD, _RETURN_SPEED_SD = 0.2, 0.25
_RETURN_SIZE_SD, _RETURN_SIZE_SPEED_SD = 0.12, 0.06
_LARGEST_RETURN = 2.5       # standard deviations
# What the window of another body shows is a visible body only where that is expected: else it is somebody between them.
_FOREIGN_OFFSET = 1.5       # standard deviations
_FOREIGN_NOSE = 0.1         # body sizes
_LARGEST_OFFSET = 4.0       # standard deviations
_LARGEST_DEPTH = 3.5        # standard deviations
# Hellinger distance of what was learnt of one human to another image of him: mean and standard deviation, of the people
# in the first 40 s of vtest.avi.
_APPEARANCE_MEAN, _APPEARANCE_SD = 0.21, 0.07
_LARGEST_DISTANCE, _LARGEST_DISTANCE_AFTER = 0.55, 0.42    # while it is followed, and when it comes back
_LARGEST_DISTANCE_AFTER_CUT = 0.27      # 95 % of the distances of one human
_UNKNOWN_DISTANCE = 0.3
_CLEARER_BY, _BETTER_BY = 0.15, 0.03    # two standard deviations, and what already speaks for another
_BESIDE, _THERE = 0.2, 0.12  # body sizes
_HIDDEN_COST = 1.5          # of two that fit alike, the one that was visible a moment ago is meant
# Who may lie on a hidden neighbour: that one is unseen for so long (s) at most, such a part of one of the two boxes lay
# in the other, and the clothes fit that one better by this.
_MISTAKEN_S, _MET, _WEARS_BY = 3.0, 0.1, 0.02
_FOREIGN_COST = 0.5         # found in the window of another body
UNCONFIRMED_TIME = 2.0
"""Time (s) for which a body without a person's box of its own is believed, or tried again."""
_LEAST_IOU = 0.25
_WITHIN = 0.6
# A body that is smaller than this part of a person's box may lie on that person, but is another thing: a knot of a tie.
_LEAST_SHARE = 0.4


def association_cost(track: BodyTrack, detection: PoseDetection, stamp: float, face: Optional[FaceBox],
                     foreign_face: bool) -> float:
    """Cost, like half a squared distance in standard deviations, of `detection` being `track` at `stamp`; inf: it is
    not.

    face: the track's own in this image. With one, the nose decides: place and appearance only choose among those that
    it allows. foreign_face: the nose lies in the face of another body.
    """
    nose = detection.estimate.nose
    if foreign_face or (face is not None and face.distance(nose) > NOSE_IN_OWN_FACE):
        return math.inf
    offset = (track.motion.image_distance(detection.estimate.centre, stamp, _CENTRE_NOISE) if track.visible
              else _return_distance(track, detection, stamp))
    if face is None and not track.visible and offset > _LARGEST_RETURN:
        return math.inf
    if face is None and track.visible and detection.source != track.id and (
            offset > _FOREIGN_OFFSET or _nose_offset(track, detection, stamp) > _FOREIGN_NOSE):
        return math.inf
    depth = track.motion.depth_distance(detection.root, stamp)
    apart = difference(track.appearance, detection.appearance)
    if face is None and not track.visible and track.left and apart is None and detection.source == track.id:
        return math.inf     # the network makes a body of whatever is in the window of somebody who has gone by
    apart = apart if apart is not None else 0.0 if track.visible else _UNKNOWN_DISTANCE
    if face is None and not track.visible and apart > (
            _LARGEST_DISTANCE_AFTER_CUT if track.cut else _LARGEST_DISTANCE_AFTER):
        return math.inf
    if face is None and (offset > _LARGEST_OFFSET or depth > _LARGEST_DEPTH or apart > _LARGEST_DISTANCE):
        return np.inf
    cost = min(offset, _LARGEST_OFFSET) ** 2 / 2.0 + min(depth, _LARGEST_DEPTH) ** 2 / 4.0
    cost += (max(0.0, apart - _APPEARANCE_MEAN) / _APPEARANCE_SD) ** 2 / 2.0
    cost += (0.0 if track.visible else _HIDDEN_COST) + (0.0 if detection.source == track.id else _FOREIGN_COST)
    return min(cost, MAX_COST - 1.0) if face is not None else cost


def fits(track: BodyTrack, detection: PoseDetection, stamp: float, face: Optional[FaceBox]) -> bool:
    """Tell whether `detection` may be `track` at `stamp` (s), whose own face in this image is `face`."""
    return association_cost(track, detection, stamp, face, False) <= MAX_COST


def _return_distance(track: BodyTrack, detection: PoseDetection, stamp: float) -> float:
    """How far a detection is from where a hidden body would be, or from where it was last seen, whichever is nearer,
    and from its size, in standard deviations."""
    centre = detection.estimate.centre
    offset = min(math.hypot(*(centre - place)) for place in (
        track.place, track.estimate.centre + track.moved(stamp))) / track.motion.size
    gap = 0.0 if track.darkened else max(0.0, stamp - track.stamp)
    larger = math.log(detection.estimate.extent / track.motion.size)
    return math.hypot(offset / (_RETURN_SD + _RETURN_SPEED_SD * gap),
                      larger / (_RETURN_SIZE_SD + _RETURN_SIZE_SPEED_SD * gap))


def _nose_offset(track: BodyTrack, detection: PoseDetection, stamp: float) -> float:
    return math.hypot(*(detection.estimate.nose - track.expected(stamp).nose).tolist()) / track.motion.size


def cost_matrix(tracks: Sequence[BodyTrack], detections: Sequence[PoseDetection], stamp: float,
                faces: Sequence[FaceBox]) -> np.ndarray:
    """Costs (T, S) of each detection being each track; inf where it cannot be."""
    own = {face.id: face for face in faces}
    owners = {track.face_id: track.id for track in tracks if track.face_id is not None}
    costs = np.full((len(tracks), len(detections)), np.inf)
    for column, detection in enumerate(detections):
        seen_in = nearest_face(detection, faces)
        owner = owners.get(seen_in.id) if seen_in is not None else None
        for row, track in enumerate(tracks):
            foreign = owner not in (None, track.id) or (
                track.darkened and seen_in is not None and track.face_id not in (None, seen_in.id))
            if track.face_id not in own and _shows_another(track, detection, tracks, stamp):
                continue
            costs[row, column] = association_cost(track, detection, stamp, own.get(track.face_id or ""), foreign)
    return costs


def _shows_another(track: BodyTrack, detection: PoseDetection, tracks: Sequence[BodyTrack], stamp: float) -> bool:
    """Tell whether a detection rather is another of the visible bodies, so that this one may not take it.

    Of a hidden body: one that is there and not clearly of other clothes, or one beside it whose clothes fit better.
    Of a visible one: one that is there, and whose clothes fit clearly better.
    """
    centre_x, centre_y = detection.estimate.centre.tolist()
    for other in tracks:
        if other is track or not other.visible:
            continue
        there = other.expected(stamp)
        x, y = there.centre.tolist()
        offset = math.hypot(centre_x - x, centre_y - y) / other.motion.size
        if offset > _BESIDE:
            continue
        own = difference(track.appearance, detection.appearance)
        its = difference(other.appearance, detection.appearance)
        better = own - its if own is not None and its is not None else 0.0
        if track.visible:
            if better > _CLEARER_BY and offset < _THERE:
                return True
        elif better > (-_CLEARER_BY if same_body(there, detection.estimate) else _BETTER_BY):
            return True
    return False


def judge_mistaken(tracks: Sequence[BodyTrack], stamp: float, faces: Sequence[FaceBox]) -> None:
    """Note of the bodies seen at `stamp` (s) which wear the clothes of a hidden neighbour, and may lie on that one.

    Most switches of ids on a film of a crowd are such bodies. One with its own face in the image is itself.
    """
    hidden = [track for track in tracks if track.confirmed and not track.visible and not track.cut
              and stamp - track.stamp <= _MISTAKEN_S + 1e-9]
    if not hidden:
        return
    shown = {face.id for face in faces}
    for track in tracks:
        if not track.visible:
            continue
        box = track.expected(stamp).box
        for other in hidden:
            its = other.expected(stamp).box
            if track.id not in other.met and max(inside(box, its), inside(its, box)) > _MET:
                other.met.add(track.id)
        if track.stamp == stamp:
            track.mistaken = track.face_id not in shown and any(
                track.id in other.met and _wears_clothes_of(other, track) for other in hidden)


def _wears_clothes_of(other: BodyTrack, track: BodyTrack) -> bool:
    """Tell whether a body as it was last seen is dressed rather as another one than as itself."""
    own = difference(track.appearance, track.detection.appearance)
    its = difference(other.appearance, track.detection.appearance)
    return own is not None and its is not None and its + _WEARS_BY < own


def nearest_face(detection: PoseDetection, faces: Sequence[FaceBox]) -> Optional[FaceBox]:
    """Return the face in which the nose of a detection lies, None when in none."""
    nose = detection.estimate.nose
    best = min(faces, key=lambda face: face.distance(nose), default=None)
    return best if best is not None and best.distance(nose) <= NOSE_IN_FACE else None


def link_faces(tracks: Sequence[BodyTrack], faces: Sequence[FaceBox], stamp: float) -> None:
    """Give free faces to the bodies whose face was at their place until a moment ago under another id, others to the
    bodies just seen whose nose lies in them."""
    here, owned = {face.id for face in faces}, {track.face_id for track in tracks}
    free = [face for face in faces if face.id not in owned]
    for face in list(free):
        heirs = [track for track in tracks if track.face_id not in here and track.had_face_at(face, stamp)]
        if len(heirs) == 1:
            heirs[0].link(face, stamp)
            free.remove(face)
    alone = [track for track in tracks if track.visible and track.stamp == stamp and track.face_id is None]
    cost = np.array([[face.distance(track.estimate.nose) for face in free] for track in alone])
    for row, column in assign(cost.reshape(len(alone), len(free)), NOSE_IN_FACE):
        alone[row].link(free[column], stamp)


def confirm_by_boxes(tracks: Sequence[BodyTrack], boxes: Sequence[np.ndarray], stamp: float,
                     poses: Optional[Dict[str, Pose]] = None) -> None:
    """Set `box_confirmed` of the tracks by the boxes (4,) px of the person detector at `stamp`, also those of low
    score.

    A track is confirmed when its nose lies in a box that is not far larger than the body: true for all of 205 people in
    photographs (whole, small, half hidden), and for 2 of 30 bodies that the network made below patterns. poses: those
    of the faces by id, in the optical frame. A body whose face is at quite another distance needs a box of its own.
    """
    outlines = np.asarray(boxes, dtype=np.float64).reshape(-1, 4)
    own = _own_boxes(tracks, outlines, stamp)
    for row, track in enumerate(tracks):
        pose = (poses or {}).get(track.face_id or "")
        points = track.detection.points
        contradicted = pose is not None and points is not None and face_cue(points, pose) is None
        seen = row in own or (not contradicted and any(_is_at(track, box, stamp) for box in outlines))
        track.box_confirmed = bool(track.box_confirmed) or seen


def drop_unconfirmed(tracks: Sequence[BodyTrack], boxes: Sequence[np.ndarray], stamp: float) -> List[BodyTrack]:
    """Return the tracks without those that are second bodies of somebody, or that no box has ever confirmed.

    boxes: (4,) px of the person detector at `stamp`. A body is confirmed by a face, or by a box of its own; one that
    has neither for two seconds and lies mostly within a confirmed body is a part of that.
    """
    seen = np.asarray(boxes, dtype=np.float64).reshape(-1, 4)
    outlines = [track.expected(stamp).box for track in tracks]
    sure = {row for row, track in enumerate(tracks) if track.face_id is not None} | _own_boxes(tracks, seen, stamp)
    kept = []
    for row, track in enumerate(tracks):
        if track.box_confirmed is False and stamp - track.born_at > UNCONFIRMED_TIME:
            continue
        if row in sure or not track.visible:
            track.box_confirmed_at = stamp if row in sure else track.box_confirmed_at
            kept.append(track)
        elif stamp - track.box_confirmed_at <= UNCONFIRMED_TIME or not any(
                inside(outlines[row], outlines[other]) > _WITHIN for other in sure if tracks[other].visible):
            kept.append(track)
    return kept


def waiting_in(tracks: Sequence[BodyTrack], box: np.ndarray, stamp: float) -> Optional[BodyTrack]:
    """Return the hidden body whose head should be in a person's box (4,) px, the one nearest to its middle."""
    middle = 0.5 * (box[0] + box[2])
    waiting = [track for track in tracks if not track.visible and not track.cut and _is_at(track, box, stamp)]
    if not waiting:
        return None
    return min(waiting, key=lambda track: float(abs(track.expected(stamp).nose[0] - middle)))


def end_rivalries(tracks: Sequence[BodyTrack], boxes: Sequence[np.ndarray], stamp: float) -> None:
    """Let bodies that began where another one was hidden be people of their own: that one is gone, or each body there
    has a box (4,) px of the person detector."""
    names = {track.id for track in tracks}
    rivals = [track for track in tracks if track.rival is not None]
    own = _own_boxes(tracks, np.asarray(boxes, dtype=np.float64).reshape(-1, 4), stamp) if rivals else set()
    for track in rivals:
        outline = track.expected(stamp).box
        there = {row for row, other in enumerate(tracks) if inside(outline, other.expected(stamp).box) > 0.0}
        if track.rival not in names or there <= own:
            track.rival = None


def _own_boxes(tracks: Sequence[BodyTrack], boxes: np.ndarray, stamp: float) -> Set[int]:
    """Rows of the tracks that have a box (N, 4) of their own."""
    outlines = np.array([track.expected(stamp).box for track in tracks]).reshape(-1, 4)
    return {row for row, _ in assign(1.0 - iou_matrix(outlines, boxes), 1.0 - _LEAST_IOU)}


def _is_at(track: BodyTrack, box: np.ndarray, stamp: float) -> bool:
    estimate = track.expected(stamp)
    (x, y), (x0, y0, x1, y1) = estimate.nose.tolist(), box.tolist()
    return x0 <= x <= x1 and y0 <= y <= y1 and estimate.extent >= _LEAST_SHARE * max(x1 - x0, y1 - y0)
