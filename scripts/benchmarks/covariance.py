"""Is 95 % of the truth in the 95 % ellipse of a person's place? On simulated people, through the person manager.

Monocular and depth: people who walk, stand and talk in a room that one camera sees (`camera_room`, with the errors that
real cameras had; with depth those along the ray are a quarter). Voice: people who talk 0.5 to 4 m away, each direction
wrong by what the room and the array cost. The seeds below REPORT_FROM were used to choose the constants of
`triangulation.py`; what is reported comes from the others.
"""

from __future__ import annotations

import math
from typing import Callable, Dict, List, Optional, Sequence

import numpy as np

from benchmarks import camera_room
from benchmarks.camera_room import shared_room
from benchmarks.identity_cameras import SETTLED_S, STEP_S, Watch
from hri_person_manager.core.features import Kind
from hri_person_manager.core.location import Place, PlaceSource
from hri_person_manager.core.manager import PersonManager
from hri_person_manager.core.parameters import PERSON_MANAGER_PARAMETERS
from hri_person_manager.core.triangulation import CHI_SQUARE_95
from hri_pipeline.core.geometry import Pose

REPORT_FROM = 10000
SCENE_S = 30.0
DEPTH_ERROR = 0.03              # `distance_error` for depth images, as ros4hri.launch sets it
DEPTH_SHARE = 0.25              # of the errors along the ray that are left with depth
AFTER_S = (0.3, 1.0, 3.0, 6.0)       # a place that was told so long ago
VOICE_DISTANCES = (0.5, 4.0)    # m
VOICE_ERRORS = (3.0, 8.0)       # degrees: a good array in a quiet room, a bad one in a loud room
_ALONG = ("OF_PERSON", "OF_VIEW", "OF_MOMENT")


def inside(place: Place, truth: np.ndarray) -> bool:
    """Tell whether the truth (3,) m lies in the horizontal 95 % ellipse of a place."""
    covariance = place.horizontal_covariance
    if covariance is None:
        return False
    offset = truth[:2] - np.array(place.horizontal)
    return bool(offset @ np.linalg.solve(covariance, offset) <= CHI_SQUARE_95)


class _Score:
    """Counts the places of one room that are right; once a second, as errors last."""

    def __init__(self, watch: Watch) -> None:
        self._watch = watch
        self.hits: List[bool] = []
        self._next = SETTLED_S

    def look(self) -> None:
        """Compare each person with the human that it is made of."""
        watch = self._watch
        if watch.now < self._next:
            return
        self._next = watch.now + 1.0
        made = watch.persons()
        for state in watch.manager.snapshot(watch.now).persons:
            of = made.get(state.id, set())
            if state.place is not None and len(of) == 1 and state.confidence >= 1.0:
                self.hits.append(inside(state.place, watch.room.head_at(next(iter(of)), state.place.stamp)))


def camera_hits(seeds: Sequence[int], error: Optional[float] = None, cameras: int = 1) -> List[bool]:
    """One answer per person and second; error: `distance_error`, None for that of the parameter file."""
    hits: List[bool] = []
    for seed in seeds:
        watch = Watch(shared_room(seed, cameras, 2 + seed % 4))
        if error is not None:
            watch.manager = PersonManager(PERSON_MANAGER_PARAMETERS.resolve({"distance_error": error}))
        score = _Score(watch)
        watch.run(SCENE_S, score.look)
        hits += score.hits
    return hits


def with_depth(measure: Callable[[], List[bool]]) -> List[bool]:
    """Measure with the errors along the ray that a depth image leaves."""
    before = {name: getattr(camera_room, name) for name in _ALONG}
    try:
        for name in _ALONG:
            setattr(camera_room, name, DEPTH_SHARE * before[name])
        return measure()
    finally:
        for name, value in before.items():
            setattr(camera_room, name, value)


def voice_hits(seeds: Sequence[int], error: float) -> List[bool]:
    """One answer per utterance of a voice; error: of its direction, degrees."""
    hits = []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        manager = PersonManager(PERSON_MANAGER_PARAMETERS.resolve({"voice_person_delay": 0.0, "new_person_delay": 0.0}))
        name = "v{:05d}".format(seed)
        manager.on_tracked(Kind.VOICE, [name], 0.0)
        bearing, distance = rng.uniform(-math.pi, math.pi), rng.uniform(*VOICE_DISTANCES)
        microphone = np.array([*rng.uniform(-5.0, 5.0, 2), 1.0])
        truth = microphone + distance * np.array([math.cos(bearing), math.sin(bearing), 0.1])
        told = bearing + math.radians(error) * rng.normal()
        place = Place("map", Pose(np.eye(3), microphone + np.array([math.cos(told), math.sin(told), 0.0])), 0.1,
                      origin=microphone)
        manager.tick(0.1)
        person = manager.on_place(PlaceSource.VOICE, name, place, 0.1, "microphone")
        found = manager.place(person) if person is not None else None
        hits.append(found is not None and inside(found, truth))
    return hits


def aged_hits(seeds: Sequence[int], after: float) -> List[bool]:
    """One answer per person who was lost `after` s before: everybody goes blind at once."""
    hits = []
    for seed in seeds:
        watch = Watch(shared_room(seed, 1, 2 + seed % 4))
        watch.run(8.0)
        made = {person: next(iter(of)) for person, of in watch.persons().items() if len(of) == 1}
        end = watch.now + after
        while watch.now < end:
            watch.room.step(STEP_S)
        watch.manager.on_tracked(Kind.FACE, [], watch.now)
        watch.manager.on_tracked(Kind.BODY, [], watch.now)
        for state in watch.manager.snapshot(watch.now).persons:
            if state.id in made and state.place_now is not None:
                hits.append(inside(state.place_now, watch.room.truth[-1][1][made[state.id]]))
    return hits


def figures(scenes: int = 40, voices: int = 2000, first: int = REPORT_FROM) -> Dict[str, object]:
    """The shares, and in `details` those of other conditions with the number of answers."""
    # Errors last as long as a scene: only scenes, not seconds, are independent.
    rooms, speakers = range(first, first + scenes), range(first, first + voices)
    few = rooms[:scenes // 3]
    found = {"monocular": camera_hits(rooms), "depth": with_depth(lambda: camera_hits(rooms, DEPTH_ERROR)),
             "two_cameras": camera_hits(few, cameras=2)}
    found.update({"voice_{:g}_deg".format(error): voice_hits(speakers, error) for error in VOICE_ERRORS})
    found.update({"unseen_{:g}_s".format(after): aged_hits(few, after) for after in AFTER_S})
    found["voice"] = [hit for error in VOICE_ERRORS for hit in found["voice_{:g}_deg".format(error)]]
    return {"covariance_95": {name: share(found[name]) for name in ("monocular", "depth", "voice")},
            "covariance_95_of": {name: [share(hits), len(hits)] for name, hits in sorted(found.items())}}


def share(hits: Sequence[bool]) -> float:
    """Share of the answers that are yes."""
    return round(sum(hits) / max(len(hits), 1), 3)
