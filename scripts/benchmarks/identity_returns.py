"""Bodies that return and bodies that cross: the part `returns` of scripts/benchmark identity."""

from __future__ import annotations

import os
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, Iterator, List, Mapping, NamedTuple, Optional, Sequence, Tuple

import cv2
import numpy as np

from benchmarks.identity_worlds import World
from hri_fullbody.core.parameters import BODIES
from hri_fullbody.core.pipeline import BodyPipeline
from hri_pipeline.core.camera import CameraModel
from hri_pipeline.score.metrics import MotFrame, box_distance, clear_mot, identity_scores, required_only

LABELS = Path(__file__).with_name("vtest.txt")
RATE = 10.0
"""Images of vtest.avi per second."""
STARTS = (0, 3, 6, 9, 12)
"""First images of the runs over vtest.avi. The same people are there, but whose turn it is when, and which images the
person detector gets, differ: as much as between two machines."""
FIELD_OF_VIEW = 1.05
"""Horizontal, rad: what the stack takes a camera without calibration to have."""
TUNING_WORLDS, REPORT_WORLDS = range(0, 200), range(20000, 20100)
"""Seeds of the simulated worlds: constants were chosen on the former, the figures are of the latter."""
VISITS = 12
"""Bodies that come in one world."""
_SAME_PLACE = 0.5
"""Least intersection over union of two boxes of one human, as in MOTChallenge."""
_WHOSE_PLACE = 0.3
_BINS = ((0.9, 0.95), (0.95, 0.98), (0.98, 1.0))


class FilmError(RuntimeError):
    """The film is not there."""


@dataclass(frozen=True)
class Stay:
    """One stay of somebody in the image. boxes: (N, 4) px at `frames` (N,), rising. hidden: first and last image."""

    name: str
    frames: np.ndarray
    boxes: np.ndarray
    hidden: Tuple[Tuple[int, int], ...]

    def box(self, frame: int) -> Optional[np.ndarray]:
        """Box (4,) px in an image; None before and after the stay."""
        if not self.frames[0] <= frame <= self.frames[-1]:
            return None
        return np.array([np.interp(frame, self.frames, self.boxes[:, column]) for column in range(4)])

    def is_hidden(self, frame: int) -> bool:
        """Tell whether the person need not be found in an image."""
        return any(first <= frame <= last for first, last in self.hidden)


def read_labels(path: Path = LABELS) -> List[Stay]:
    """Read who is where in vtest.avi. Raises ValueError for a line of another kind."""
    boxes: Dict[str, List[Tuple[float, ...]]] = {}
    hidden: Dict[str, List[Tuple[int, int]]] = {}
    for line in path.read_text(encoding="utf-8").splitlines():
        kind, *rest = line.split() or ["#"]
        if kind == "box":
            boxes.setdefault(rest[0], []).append(tuple(float(value) for value in rest[1:6]))
        elif kind == "hidden":
            hidden.setdefault(rest[0], []).append((int(rest[1]), int(rest[2])))
        elif not kind.startswith("#"):
            raise ValueError("{}: {!r} is neither a box nor hidden".format(path, line))
    return [Stay(name, np.array(rows)[:, 0], np.array(rows)[:, 1:], tuple(hidden.get(name, ())))
            for name, rows in boxes.items()]


def find_film() -> Path:
    """Return the path of vtest.avi: $ROS4HRI_VTEST, the cache, or Debian's package opencv-doc. Raises FilmError."""
    cache = Path(os.environ.get("ROS4HRI_CACHE", str(Path.home() / ".cache" / "ros4hri")))
    listed = subprocess.run(["dpkg", "-L", "opencv-doc"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
                            universal_newlines=True, check=False).stdout.split()
    for path in [Path(os.environ.get("ROS4HRI_VTEST", "")), cache / "vtest.avi"] + [
            Path(name) for name in listed if name.endswith("/vtest.avi")]:
        if path.is_file():
            return path
    raise FilmError("vtest.avi is not there: `apt-get install opencv-doc` brings it, ROS4HRI_VTEST names its path")


def images(path: Path) -> Iterator[np.ndarray]:
    """Yield the images (H, W, 3) BGR of a film."""
    film = cv2.VideoCapture(str(path))
    while True:
        read, image = film.read()
        if not read:
            return
        yield image


class FilmTrack(NamedTuple):
    """What the pipeline makes of the film: boxes by id of each image, and (image, id, earlier id, likelihood) told.

    start: the first image that it got.
    """

    boxes: List[Dict[str, np.ndarray]]
    told: List[Tuple[int, str, str, float]]
    start: int = 0


def track_film(path: Path, settings: Optional[Mapping[str, object]] = None, start: int = 0) -> FilmTrack:
    """Run the body pipeline, as the node `bodies` would, over the film from image `start` on."""
    pipeline = BodyPipeline(BODIES.resolve(dict(settings or {})))
    boxes: List[Dict[str, np.ndarray]] = []
    told: List[Tuple[int, str, str, float]] = []
    camera: Optional[CameraModel] = None
    for number, image in enumerate(images(path)):
        if number < start:
            boxes.append({})
            continue
        camera = camera or CameraModel.from_fov(image.shape[1], image.shape[0], FIELD_OF_VIEW)
        bodies = pipeline.update(image, camera, number / RATE)
        boxes.append({body.id: body.box for body in bodies})
        told += [(number, item.id, item.earlier, item.likelihood) for item in pipeline.reidentified]
    return FilmTrack(boxes, told, start)


def frames_of(track: FilmTrack, stays: Sequence[Stay]) -> List[MotFrame]:
    """Pair what was found with the labels, image by image from the first one that the pipeline got."""
    frames = []
    for number, found in enumerate(track.boxes[track.start:], track.start):
        truth = {stay.name: stay.box(number) for stay in stays}
        there = {name: tuple(box) for name, box in truth.items() if box is not None}
        needed = {stay.name for stay in stays if stay.name in there and not stay.is_hidden(number)}
        frame = MotFrame(there, {key: tuple(box) for key, box in found.items()}, needed)
        frames.append(required_only(frame, _SAME_PLACE, box_distance))
    return frames


def figures() -> Dict[str, object]:
    """Measure both: returns in simulated worlds and on the film; the film's ids against the labels."""
    stays, path = read_labels(), find_film()
    tracks = [track_film(path, start=start) for start in STARTS]
    worlds, film = world_returns(REPORT_WORLDS), film_returns(tracks[0], stays)
    crossing = spread_of([crossing_figures(frames, len(frames) / RATE / 60.0) for frames in (
        frames_of(track, stays) for track in tracks)])
    mean = crossing["mean"]
    return {
        "body_returns_right": worlds["share_right"],
        "body_returns_wrong": int(worlds["wrong"]) + int(film["wrong"]),
        "vtest_idf1": mean["idf1"], "vtest_switches_per_min": mean["switches_per_min"], "vtest_ids": mean["ids"],
        "details": {"returns": {"simulated": worlds, "vtest": film}, "vtest": crossing},
        "input": "{} simulated worlds of {} visits (seeds {} to {}); vtest.avi, {} images, {} stays labelled by eye, "
                 "{} runs (returns: the first one)".format(
                     len(REPORT_WORLDS), VISITS, REPORT_WORLDS[0], REPORT_WORLDS[-1], len(tracks[0].boxes), len(stays),
                     len(tracks))}


def spread_of(runs: Sequence[Mapping[str, Optional[float]]]) -> Dict[str, Dict[str, Any]]:
    """Return mean and standard deviation of each figure over several runs, and the runs by their first image."""
    values = {key: np.array([run[key] for run in runs], dtype=np.float64) for key in runs[0]}
    return {"mean": {key: round(float(np.mean(value)), 3) for key, value in values.items()},
            "sd": {key: round(float(np.std(value, ddof=1)), 3) for key, value in values.items()},
            "runs": {str(start): dict(run) for start, run in zip(STARTS, runs)}}


def crossing_figures(frames: Sequence[MotFrame], minutes: float) -> Dict[str, Optional[float]]:
    """Return how well ids are kept on the film, of `minutes` length."""
    mot = clear_mot(frames, _SAME_PLACE, box_distance)
    identity = identity_scores(frames, _SAME_PLACE, box_distance)
    return {"idf1": _rounded(identity.idf1), "hota": _rounded(identity.hota), "deta": _rounded(identity.deta),
            "assa": _rounded(identity.assa), "mota": _rounded(mot.mota), "switches": mot.switches,
            "switches_per_min": round(mot.switches / minutes, 2), "fragments": mot.fragments, "misses": mot.misses,
            "false_positives": mot.false_positives, "people": mot.persons_true,
            "ids": len({key for frame in frames for key in frame.found})}


def film_returns(track: FilmTrack, stays: Sequence[Stay]) -> Dict[str, int]:
    """Count the matches that were told on the film: right, wrong; and how often somebody returned under a new id."""
    whose = _owners(track, stays)
    right = sum(_human(whose.get(new)) is not None and _human(whose.get(new)) == _human(whose.get(old))
                for _, new, old, _ in track.told)
    return {"right": right, "wrong": len(track.told) - right,
            "returns": sum(int(stay.name.split(".")[1]) > 1 for stay in stays)}


def _human(stay: Optional[str]) -> Optional[str]:
    return None if stay is None else stay.split(".")[0]


def _owners(track: FilmTrack, stays: Sequence[Stay]) -> Dict[str, str]:
    """Return the stay on which each body lay most."""
    counts: Dict[str, Dict[str, int]] = {}
    for number, found in enumerate(track.boxes):
        for key, box in found.items():
            there = [(box_distance(tuple(box), tuple(place)), stay.name) for stay, place in (
                (stay, stay.box(number)) for stay in stays) if place is not None]
            apart, name = min(there, default=(1.0, ""))
            if apart <= 1.0 - _WHOSE_PLACE:
                counts.setdefault(key, {})[name] = counts.get(key, {}).get(name, 0) + 1
    return {key: max(names, key=lambda name: names[name]) for key, names in counts.items()}


def world_returns(seeds: Sequence[int]) -> Dict[str, object]:
    """Let people leave and return, and strangers come, in simulated worlds of these seeds.

    share_right: of the returns of people than whom nobody else who was lost lately is dressed alike. says_right: for
    each range of the likelihood how many were told, what they said, and how many were right.
    """
    rows = [row for seed in seeds for row in World(seed, 2 + seed % 4).run(VISITS)]
    told = [(encounter, match) for encounter, match in rows if match is not None]
    right = [(encounter, match) for encounter, match in told if encounter.earlier == match[0]]
    alone = sum(encounter.earlier is not None and encounter.alone for encounter, _ in rows)
    bins = []
    for low, high in _BINS:
        here = [(match[1], encounter.earlier == match[0]) for encounter, match in told if low <= match[1] < high]
        if here:
            bins.append({"from": low, "told": len(here), "says": _rounded(float(np.mean([value for value, _ in here]))),
                         "right": _rounded(float(np.mean([good for _, good in here])))})
    return {"share_right": _rounded(sum(encounter.alone for encounter, _ in right) / max(alone, 1)),
            "right": len(right), "wrong": len(told) - len(right),
            "wrong_dressed_alike": sum(not encounter.alone for encounter, match in told
                                       if encounter.earlier != match[0]),
            "returns": sum(encounter.earlier is not None for encounter, _ in rows), "returns_alone": alone,
            "strangers": sum(encounter.earlier is None for encounter, _ in rows), "says_right": bins}


def _rounded(value: Optional[float]) -> Optional[float]:
    return None if value is None else round(value, 3)
