"""The figures of gazes, engagement and load, as the benchmark asks for them."""

from __future__ import annotations

from typing import Dict, List

from hri_pipeline.core.interactions.engagement import LEGAL, EngagementEstimator, Level
from hri_pipeline.core.interactions.gaze_targets import GazeTargets
from hri_pipeline.core.interactions.interaction_parameters import INTERACTION_PARAMETERS
from hri_pipeline.core.scene.scene_parameters import sense_defaults
from hri_pipeline.core.scene.scene_script import parse_scene
from hri_pipeline.core.scene.scene_senses import Senses
from hri_pipeline.core.scene.scene_world import World
from hri_pipeline.evaluation.gaze_figures import gaze, head_rule
from hri_pipeline.evaluation.gaze_scenes import RATE, ROBOT_AT, onlookers
from hri_pipeline.evaluation.interaction_load import load

__all__ = ["APPROACH", "cpu_percent", "engagement", "gaze", "head_rule"]

APPROACH = {
    "name": "approach", "duration": 45.0, "habits": {"dwell": 0.0, "closed": 0.0},
    "people": [{"name": "ann", "at": [5.5, 1.5], "yaw": 90.0,
                "path": [{"to": [1.3, 0.0], "start": 5.0, "speed": 1.0, "yaw": 180.0}, {"to": [6.0, 2.0], "start": 30.0, "speed": 1.0}],
                "orders": [{"at": 0.0, "for": 5.0, "look_at": "away"}, {"at": 5.0, "for": 18.0, "look_at": "robot"},
                           {"at": 23.0, "for": 2.2, "look_at": "away"}, {"at": 25.2, "for": 3.0, "look_at": "robot"},
                           {"at": 28.2, "for": 16.0, "look_at": "away"}]}]}
"""Somebody comes to the robot, looks at it, looks away for a moment, looks again, and leaves."""


def cpu_percent(people: int, rate_hz: float = 15.0) -> float:
    """Return the load of the node on one core, %, on a ROS graph with so many people."""
    return load(people, rate_hz)["cpu_percent"]


def engagement(seed: int = 0) -> Dict[str, object]:
    """Return {"illegal": number of illegal transitions, "levels": names in order, "missing": levels never reached}.

    The script APPROACH seen by noisy senses, and nobody at the end.
    """
    course = [level for _, level in levels(seed)]
    illegal = sum(after not in LEGAL[before] for before, after in zip(course, course[1:]) if after != before)
    steps: List[str] = [level.name for index, level in enumerate(course) if index == 0 or level != course[index - 1]]
    return {"illegal": illegal, "levels": steps, "missing": [level.name for level in Level if level.name not in steps]}


def levels(seed: int = 0) -> List[tuple]:
    """Return (stamp in s, level) of every image of APPROACH."""
    settings = INTERACTION_PARAMETERS.resolve({})
    scene = parse_scene(APPROACH)
    world, senses = World(scene, seed), Senses(sense_defaults(), seed, scene.robot.height)
    gazes, estimator = GazeTargets(settings), EngagementEstimator(settings)
    course = []
    for index in range(int(scene.duration * RATE)):
        truth = world.at(index / RATE)
        people = onlookers(truth, senses.sense(truth))
        found = estimator.update(people, gazes.update(people, ROBOT_AT, truth.stamp), ROBOT_AT, truth.stamp)
        course.append((truth.stamp, found.get("ann", Level.UNKNOWN)))
    return course
