"""Parameters of bodies that change while they are followed."""

from types import SimpleNamespace

import numpy as np
import pytest

from hri_fullbody.core.body_modeller import BodyModeller
from hri_fullbody.core.body_parameters import BODIES
from hri_fullbody.core.body_stage import BodyStage
from hri_fullbody.core.stamp_pacer import StampPacer
from hri_fullbody.core.tracking.body_schedule import PoseSchedule
from hri_fullbody.core.tracking.body_tracker import BodyTracker


class Reads:
    """Settings that note which of them are read."""

    def __init__(self, values):
        self._values = values
        self.read = set()

    def __getattr__(self, name):
        self.read.add(name)
        return getattr(self._values, name)


def test_stage_and_modeller_take_up_every_live_parameter():
    settings = BODIES.resolve({})
    stage = BodyStage(settings, pose=SimpleNamespace(), detector=SimpleNamespace(
        threshold=0.5, detect=lambda image: (np.zeros((0, 4)), np.zeros(0))))
    modeller = BodyModeller.from_parameters(settings)
    changed = Reads(BODIES.changed(settings, {"min_person_score": 0.4}))
    stage.reconfigure(changed)
    stage.update(np.zeros((48, 64, 3), np.uint8), SimpleNamespace(resized=lambda width, height: None), 0.0)
    stage.update(np.zeros((48, 64, 3), np.uint8), SimpleNamespace(resized=lambda width, height: None), 0.1)
    modeller.reconfigure(changed)
    of_the_branch = {"max_rate", "joint_state_rate"}
    assert {parameter.name for parameter in BODIES.live} - of_the_branch <= changed.read
    assert stage._detector.threshold == 0.4


def test_limits_of_the_tracker():
    tracker = BodyTracker(SimpleNamespace(), lambda: "aaaaa", 0.1, 1.0, schedule=PoseSchedule(10.0, 3))
    tracker.limit(0.2, 2.0, 0.7)
    for wrong in ((-1.0, 1.0, 0.5), (0.1, 0.0, 0.5), (0.1, 1.0, 1.0)):
        with pytest.raises(ValueError):
            tracker.limit(*wrong)
    with pytest.raises(ValueError):
        tracker.schedule.limit(-1.0, 0)


def test_another_rate_of_joint_states():
    pacer = StampPacer(10.0)
    stamps = np.arange(0.0, 1.0, 0.05)
    assert sum(pacer.is_due(stamp) for stamp in stamps) == 10
    pacer.set_rate(5.0)
    assert sum(pacer.is_due(stamp) for stamp in stamps + 1.0) == 5
    pacer.set_rate(0.0)
    assert sum(pacer.is_due(stamp) for stamp in stamps + 2.0) == 20
