"""Draws skeletons, face landmarks, and what is known about persons on an image; parameters of the overlay node."""

from __future__ import annotations

import colorsys
import zlib
from dataclasses import dataclass
from typing import List, Mapping, Optional, Sequence, Tuple

import cv2
import numpy as np

from hri_pipeline.core.parameters import ParameterTable, Settings, list_timeout_parameter, parameter


@dataclass(frozen=True)
class OverlaySettings(Settings):
    """Draws skeletons, face landmarks, names, expressions and gazes on the camera image, while somebody looks."""

    image_transport: str = parameter(
        "raw", "Which topic to take the image from: `image`, or `image/compressed`.", choices=("raw", "compressed"))
    max_rate: float = parameter(10.0, "Most images per second.", unit="Hz", minimum=0.1, maximum=120.0, live=True)
    history: int = parameter(
        30, "Latest images that are kept until their faces and bodies arrive. Each takes width x height x 3 bytes.",
        minimum=2, maximum=300)
    pair_tolerance: float = parameter(
        0.15, "Largest difference between the stamps of an image and of what is drawn on it.", unit="s", minimum=0.0,
        maximum=2.0, live=True)
    min_confidence: float = parameter(
        0.3, "Key points and landmarks below this confidence are left out.", minimum=0.0, maximum=1.0, live=True)
    names: bool = parameter(True, "Write the names of persons who have one; false: their ids.")
    expressions: bool = parameter(
        True, "Write what faces express. The faces node finds it out for those who listen: false spares that, too.")
    gazes: bool = parameter(True, "Draw who looks at whom, and write who looks at the robot.")
    list_timeout: float = list_timeout_parameter()


OVERLAY_PARAMETERS = ParameterTable("overlay", OverlaySettings)


Colour = Tuple[int, int, int]

# Pairs of points in the order of hri_msgs/Skeleton2D.
LIMBS = ((1, 2), (2, 3), (3, 4), (1, 5), (5, 6), (6, 7), (1, 8), (8, 9), (9, 10), (1, 11), (11, 12), (12, 13),
         (8, 11), (1, 0), (0, 14), (14, 16), (0, 15), (15, 17))
FIRST_HEAD_LIMB = 13
HEAD_POINTS = (0, 14, 15, 16, 17)
# Runs of points in the order of hri_msgs/FacialLandmarks, and whether they are closed.
CONTOURS = ((0, 17, False), (17, 22, False), (22, 27, False), (27, 31, False), (31, 36, False),
            (36, 42, True), (42, 48, True), (48, 60, True), (60, 68, True))
PUPILS = (68, 69)
NOBODY: Colour = (190, 190, 190)
DARK: Colour = (25, 25, 25)
FONT = cv2.FONT_HERSHEY_DUPLEX
ANONYMOUS = "anonymous_person_"
ROBOT = ""
_LONGEST = 24       # letters of a name; the fonts of OpenCV have no letters but those of ASCII


@dataclass(frozen=True)
class PersonMark:
    """What is written about a person: id, the ids of face, body and voice (empty: none), confidence 0 to 1.

    looks_at: id of the person who is looked at, "" for the robot, None for nobody.
    """

    id: str
    face_id: str = ""
    body_id: str = ""
    confidence: float = 1.0
    name: str = ""
    expression: str = ""
    looks_at: Optional[str] = None
    voice_id: str = ""

    @property
    def label(self) -> str:
        """The text beside the head."""
        words = [self.name[:_LONGEST] or short_name(self.id), "{:.0f} %".format(100.0 * self.confidence),
                 self.expression[:_LONGEST]]
        text = "  ".join(word for word in words if word) + ("  > robot" if self.looks_at == ROBOT else "")
        return text.encode("ascii", "replace").decode("ascii")


def colour_of(name: str) -> Colour:
    """Return the bright BGR colour of an id: always the same, in every process and run."""
    digest = zlib.crc32(name.encode("utf-8"))
    hue, saturation = (digest % 3600) / 3600.0, 0.55 + 0.4 * (digest // 3600 % 100) / 100.0
    red, green, blue = colorsys.hsv_to_rgb(hue, saturation, 1.0)
    return int(255 * blue), int(255 * green), int(255 * red)


def short_name(person: str) -> str:
    """Return an id short enough to be written beside a head."""
    return "anon " + person[len(ANONYMOUS):] if person.startswith(ANONYMOUS) else person


def draw_overlay(image: np.ndarray, faces: Mapping[str, np.ndarray], bodies: Mapping[str, np.ndarray],
                 persons: Sequence[PersonMark], min_confidence: float = 0.3,
                 ignored: Sequence[Sequence[float]] = ()) -> np.ndarray:
    """Return a copy of `image` (BGR uint8) with everything drawn on it.

    faces: id -> (70, 3), bodies: id -> (18, 3), x px, y px, confidence 0 to 1; points below `min_confidence`
    or not finite are left out. Faces and bodies of the same person have the colour of the person; those of
    nobody are grey. ignored: left, top, right, bottom of the regions in which nobody begins, shares of the image.
    """
    canvas = image.copy()
    unit = max(1.0, image.shape[0] / 720.0)
    for region in ignored:
        _draw_ignored(canvas, np.array(region), unit)
    owner = {mark.face_id: mark for mark in persons if mark.face_id}
    carrier = {mark.body_id: mark for mark in persons if mark.body_id}
    for name, points in bodies.items():
        colour = colour_of(carrier[name].id) if name in carrier else NOBODY
        _draw_skeleton(canvas, points, colour, min_confidence, unit)
    for name, points in faces.items():
        colour = colour_of(owner[name].id) if name in owner else NOBODY
        _draw_face(canvas, points, colour, min_confidence, unit)
    heads = {mark.id: _head(faces.get(mark.face_id), bodies.get(mark.body_id), min_confidence) for mark in persons}
    for mark in persons:
        start, end = heads[mark.id], heads.get(mark.looks_at or "")
        if start is not None and end is not None:
            _draw_gaze(canvas, start, end, colour_of(mark.id), unit)
    boxes = [_box(points, _good(points, min_confidence)) for points in faces.values()]
    shown = np.array([box for box in boxes if box is not None]).reshape(-1, 4)
    taken: List[Sequence[float]] = []
    text = counts(len(faces), len(bodies), persons)
    _draw_label(canvas, text, (0.0, float(image.shape[0])), NOBODY, taken, shown, unit)
    for mark in persons:
        anchor = _anchor(faces.get(mark.face_id), bodies.get(mark.body_id), min_confidence)
        if anchor is not None:
            _draw_label(canvas, mark.label, anchor, colour_of(mark.id), taken, shown, unit)
    return canvas


def counts(faces: int, bodies: int, persons: Sequence[PersonMark]) -> str:
    """Return how many there are of each; persons who are only a voice are counted apart."""
    heard = sum(bool(mark.voice_id) and not (mark.face_id or mark.body_id) for mark in persons)
    words = [(faces, "face", "faces"), (bodies, "body", "bodies"), (len(persons) - heard, "person", "persons")]
    words += [(heard, "voice", "voices")] if heard else []
    return "   ".join("{} {}".format(number, one if number == 1 else more) for number, one, more in words)


def label_lifts(places: Sequence[Sequence[float]], up: Sequence[float], widths: Sequence[float],
                height: float) -> List[float]:
    """Return how far (m) to lift each label in space, so that labels near each other stand above one another.

    places: (3,) m each; up: (3,), of length 1; widths, height: m, of the labels. Near is less than half of both widths.
    """
    levels: List[float] = []
    own = [float(np.dot(place, up)) for place in places]
    for index, (place, level) in enumerate(zip(places, own)):
        way = [np.subtract(place, places[other]) for other in range(index)]
        near = [levels[other] for other, step in enumerate(way)
                if np.linalg.norm(step - np.dot(step, up) * np.array(up)) < 0.5 * (widths[index] + widths[other])]
        for taken in sorted(near):
            level = taken + height if abs(level - taken) < height else level
        levels.append(level)
    return [level - start for level, start in zip(levels, own)]


def _good(points: np.ndarray, min_confidence: float) -> np.ndarray:
    """Return (N,) bool: which points can be drawn."""
    return np.isfinite(points).all(axis=1) & (points[:, 2] >= min_confidence) & (
        np.abs(points[:, :2]) < 16000.0).all(axis=1)


def _pixel(point: np.ndarray) -> Tuple[int, int]:
    return int(round(float(point[0]))), int(round(float(point[1])))


def _draw_ignored(canvas: np.ndarray, region: np.ndarray, unit: float) -> None:
    """A thin rectangle around a region (4,), shares of the image, with the word "ignored" in it."""
    last = np.array([canvas.shape[1], canvas.shape[0]]) - 1
    low, high = _pixel(region[:2] * last), _pixel(region[2:] * last)
    pad, thickness = int(round(5 * unit)), max(1, int(round(unit)))
    (_, height), _ = cv2.getTextSize("ignored", FONT, 0.45 * unit, thickness)
    for shade, width in ((DARK, thickness + 2), (NOBODY, thickness)):
        cv2.rectangle(canvas, low, high, shade, width, cv2.LINE_AA)
        cv2.putText(canvas, "ignored", (low[0] + pad, low[1] + pad + height), FONT, 0.45 * unit, shade, width,
                    cv2.LINE_AA)


def _draw_skeleton(canvas: np.ndarray, points: np.ndarray, colour: Colour, min_confidence: float,
                   unit: float) -> None:
    good = _good(points, min_confidence)
    limbs = [(index, pair) for index, pair in enumerate(LIMBS) if good[pair[0]] and good[pair[1]]]
    for extra, shade in ((2, DARK), (0, colour)):
        for index, (first, second) in limbs:
            width = (3 if index < FIRST_HEAD_LIMB else 1) * unit
            cv2.line(canvas, _pixel(points[first]), _pixel(points[second]), shade,
                     int(round(width + extra * unit)), cv2.LINE_AA)
    for index in np.flatnonzero(good):
        radius = int(round((2 if index in HEAD_POINTS else 5) * unit))
        cv2.circle(canvas, _pixel(points[index]), radius, DARK, -1, cv2.LINE_AA)
        cv2.circle(canvas, _pixel(points[index]), max(1, radius - 1), (255, 255, 255), -1, cv2.LINE_AA)


def _draw_face(canvas: np.ndarray, points: np.ndarray, colour: Colour, min_confidence: float, unit: float) -> None:
    good = _good(points, min_confidence)
    thickness = max(1, int(round(unit)))
    # Eighths of a pixel: a small face is drawn without steps.
    fine = np.round(np.where(good[:, None], points[:, :2], 0.0) * 8.0).astype(np.int32)
    for start, stop, closed in CONTOURS:
        if good[start:stop].all():
            cv2.polylines(canvas, [fine[start:stop]], closed, colour, thickness, cv2.LINE_AA, 3)
    for index in PUPILS:
        if good[index]:
            cv2.circle(canvas, _pixel(points[index]), max(1, int(2 * unit)), (255, 255, 255), -1, cv2.LINE_AA)
    box = _box(points, good)
    if box is not None:
        _draw_corners(canvas, box, colour, thickness + 1)


def _box(points: np.ndarray, good: np.ndarray) -> Optional[np.ndarray]:
    """Return the box (4,) px around the good points with a margin, None without such points."""
    if not good.any():
        return None
    low, high = points[good, :2].min(axis=0), points[good, :2].max(axis=0)
    margin = 0.12 * (high - low)
    return np.concatenate([low - margin, high + margin])


def _draw_corners(canvas: np.ndarray, box: np.ndarray, colour: Colour, thickness: int) -> None:
    """The four corners of a box: shows where it is, hides nothing."""
    arm = 0.2 * (box[2:] - box[:2])
    for x, y, dx, dy in ((box[0], box[1], 1, 1), (box[2], box[1], -1, 1),
                         (box[0], box[3], 1, -1), (box[2], box[3], -1, -1)):
        corner = _pixel(np.array([x, y]))
        cv2.line(canvas, corner, _pixel(np.array([x + dx * arm[0], y])), colour, thickness, cv2.LINE_AA)
        cv2.line(canvas, corner, _pixel(np.array([x, y + dy * arm[1]])), colour, thickness, cv2.LINE_AA)


def _anchor(face: Optional[np.ndarray], body: Optional[np.ndarray],
            min_confidence: float) -> Optional[Tuple[float, float]]:
    """Return where the label of a person begins: the middle of the top of the face, else of the head or body."""
    if face is not None:
        box = _box(face, _good(face, min_confidence))
        if box is not None:
            return float(box[0] + box[2]) / 2.0, float(box[1])
    if body is not None:
        good = _good(body, min_confidence)
        head = [index for index in HEAD_POINTS if good[index]]
        rows = body[head] if head else body[good]
        if len(rows):
            return float(rows[:, 0].mean()), float(rows[:, 1].min()) - 30.0
    return None


def _head(face: Optional[np.ndarray], body: Optional[np.ndarray], min_confidence: float) -> Optional[np.ndarray]:
    """Return the middle (2,) px of the face, else of the points of the head; None without any."""
    for points, rows in ((face, slice(None)), (body, list(HEAD_POINTS))):
        if points is not None:
            good = points[rows][_good(points[rows], min_confidence)]
            if len(good):
                middle: np.ndarray = good[:, :2].mean(axis=0)
                return middle
    return None


def _draw_gaze(canvas: np.ndarray, start: np.ndarray, end: np.ndarray, colour: Colour, unit: float) -> None:
    """An arrow from one head to another; it ends before the face that is looked at."""
    way = end - start
    length = float(np.linalg.norm(way))
    if length < 40.0 * unit:
        return
    end = end - way / length * min(25.0 * unit, 0.3 * length)
    for extra, shade in ((2, DARK), (0, colour)):
        cv2.arrowedLine(canvas, _pixel(start), _pixel(end), shade, int(round(2 * unit + extra)), cv2.LINE_AA, 0,
                        min(0.2, 18.0 * unit / length))


def _draw_label(canvas: np.ndarray, text: str, anchor: Tuple[float, float], colour: Colour,
                taken: List[Sequence[float]], faces: np.ndarray, unit: float) -> None:
    """Write on a plate whose lower middle is `anchor` (px), inside the image, clear of plates in `taken` and, where
    there is room, of the boxes of `faces` (N, 4)."""
    (width, height), baseline = cv2.getTextSize(text, FONT, 0.55 * unit, max(1, int(round(unit))))
    pad = int(round(5 * unit))
    size = np.array([width + 2 * pad, height + baseline + pad])
    room = np.maximum(np.array([canvas.shape[1], canvas.shape[0]]) - 1 - size, 0)
    wanted = np.clip([anchor[0] - size[0] / 2, anchor[1] - size[1] - pad], 0, room).astype(int)
    plates = np.array(taken).reshape(-1, 4)
    left, top = (int(value) for value in _free_place(wanted, size, room, plates, faces))
    plate = (left, top, left + int(size[0]), top + int(size[1]))
    taken.append(plate)
    cv2.rectangle(canvas, plate[:2], plate[2:], colour, -1)
    cv2.putText(canvas, text, (left + pad, plate[3] - baseline), FONT, 0.55 * unit, DARK,
                max(1, int(round(unit))), cv2.LINE_AA)


def _free_place(wanted: np.ndarray, size: np.ndarray, room: np.ndarray, plates: np.ndarray,
                faces: np.ndarray) -> np.ndarray:
    """Return the place (2,) px next to `wanted` where a plate of `size` covers no plate and no face; without such a
    place no plate, and without that `wanted` itself. room: (2,), the largest place."""
    for boxes in (np.concatenate([plates, faces]), plates):
        low, high = np.floor(boxes[:, :2]) - size - 1, np.ceil(boxes[:, 2:]) + 1
        tried = np.clip(np.concatenate([[wanted], low, high]), 0, room)
        # (tried, boxes, 2): whether they meet in x, in y.
        meet = (tried[:, None] <= boxes[:, 2:]) & (boxes[:, :2] <= tried[:, None] + size)
        blocked = meet[:, :, 0].astype(int) @ meet[:, :, 1].astype(int).T
        way = np.abs(tried - wanted)
        cost = np.where(blocked, np.inf, way[:, None, 0] + way[None, :, 1])
        column, line = np.unravel_index(int(np.argmin(cost)), cost.shape)
        if np.isfinite(cost[column, line]):
            return np.array([tried[column, 0], tried[line, 1]])
    return wanted
