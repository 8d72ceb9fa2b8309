"""Expression out of action units and a network's probabilities: fusion, calibration, hysteresis, time."""

import numpy as np
import pytest

from hri_pipeline.core.faces.action_units import SLOTS, ActionUnits
from hri_pipeline.core.faces.expression import (
    CATEGORIES,
    HOLD_TIME,
    LEAST_CONFIDENCE,
    NETWORK_MEMORY,
    PLANE,
    PROTOTYPES,
    ExpressionModel,
    ExpressionTracker,
    unit_scores,
    view_quality,
)

EMFACS = {"happy": (6, 12), "sad": (1, 4, 15, 17), "angry": (4, 5, 7, 23, 24), "scared": (1, 2, 4, 5, 20, 25, 26),
          "disgusted": (9, 10, 17), "surprised": (1, 2, 5, 26)}


def units(codes=(), intensity=1.0, confidence=1.0, known=1.0):
    values = np.zeros(SLOTS, np.float32)
    values[list(codes)] = intensity
    return ActionUnits(values, np.full(SLOTS, confidence, np.float32), known)


def sure(category, probability=0.94):
    values = np.full(len(CATEGORIES), (1.0 - probability) / (len(CATEGORIES) - 1))
    values[CATEGORIES.index(category)] = probability
    return values


@pytest.mark.parametrize("category", sorted(EMFACS))
def test_a_prototype_of_action_units_gives_its_category(category):
    estimate = ExpressionTracker().update(None, units(EMFACS[category]), 0.0)
    assert estimate.category == category
    assert estimate.confidence > 0.5
    assert np.sign(estimate.valence) == np.sign(PLANE[category][0])


def test_a_still_face_is_neutral_as_far_as_it_is_known():
    known = ExpressionTracker().update(None, units(), 0.0)
    strange = ExpressionTracker().update(None, units(known=0.0), 0.0)
    assert known.category == strange.category == "neutral"
    assert known.confidence > strange.confidence
    assert abs(known.valence) < 0.2


def test_the_network_alone_suffices_and_nothing_is_nothing():
    assert ExpressionTracker().update(None, None, 0.0) is None
    assert ExpressionTracker().update(None, units(confidence=0.0), 0.0) is None
    alone = ExpressionTracker().update(sure("sad"), None, 0.0)
    assert alone.category == "sad" and alone.confidence == pytest.approx(0.94)


def test_agreement_is_surer_and_contradiction_less_sure_than_the_network_alone():
    alone = ExpressionTracker().update(sure("happy", 0.7), None, 0.0).confidence
    agreed = ExpressionTracker().update(sure("happy", 0.7), units(EMFACS["happy"]), 0.0)
    doubtful, clear = (ExpressionTracker().update(sure("happy", 0.7), units(EMFACS["angry"], confidence=confidence),
                                                  0.0)
                       for confidence in (0.2, 1.0))
    assert agreed.category == "happy" and agreed.confidence > alone
    assert doubtful.category == "happy" and doubtful.confidence < alone - 0.1
    assert clear.category == "angry"


def test_raised_corners_of_a_mouth_that_weeps_are_no_smile():
    estimate = ExpressionTracker().update(sure("sad", 0.9), units((12,), 0.7, 0.7), 0.0)
    assert estimate.category == "sad"
    assert estimate.confidence < LEAST_CONFIDENCE, "both disagree: nothing is told"


def test_a_face_that_is_small_or_turned_away_is_less_sure():
    tracker = ExpressionTracker()
    assert tracker.update(sure("happy"), None, 0.0, 0.5).confidence == pytest.approx(0.47)
    mesh = np.array([[0.0, 0.0], [100.0, 120.0]])
    assert view_quality(mesh, 0.2) == view_quality(mesh, None) == 1.0
    assert view_quality(mesh, 1.2) == 0.0 and view_quality(0.2 * mesh, 0.0) == 0.0
    assert 0.0 < view_quality(0.4 * mesh, 0.8) < view_quality(mesh, 0.8) < 1.0


class Network:
    """Instead of the network: sure of one category for each view, in turn."""

    def __init__(self, *indices):
        self.indices, self.seen = indices, None

    def run(self, feed):
        self.seen = feed["image"]
        return {"expression": np.eye(7, dtype=np.float32)[[self.indices[row % len(self.indices)]
                                                           for row in range(len(self.seen))]]}


def test_two_views_of_which_one_is_mirrored_are_averaged():
    model = ExpressionModel.__new__(ExpressionModel)
    model._model = Network(1, 1, 1, 2)
    image = np.random.RandomState(0).randint(0, 255, (200, 200, 3)).astype(np.uint8)
    mesh = np.random.RandomState(1).uniform(50, 150, (478, 3))
    views = model.crops(image, mesh)
    assert views.shape == (2, 112, 112, 3)
    agreed, split = model.probabilities([views, views])
    assert agreed.argmax() == 1 and agreed[1] > 0.9
    assert split[1] == pytest.approx(split[2]) and split[1] < 0.51
    assert (model._model.seen[0] == views[0][..., ::-1]).all(), "RGB"
    assert model.probabilities([]).shape == (0, 7)


def test_units_that_are_seen_badly_say_little():
    well = ExpressionTracker().update(sure("happy", 0.7), units(EMFACS["angry"]), 0.0)
    badly = ExpressionTracker().update(sure("happy", 0.7), units(EMFACS["angry"], confidence=0.05), 0.0)
    assert well.category == "angry" and badly.category == "happy"
    assert unit_scores(units(confidence=0.0)) is None


def test_the_networks_last_opinion_is_used_for_a_while():
    tracker = ExpressionTracker()
    tracker.update(sure("sad"), None, 0.0)
    assert tracker.update(None, None, 0.5 * NETWORK_MEMORY).category == "sad"
    assert tracker.update(None, None, 1.1 * NETWORK_MEMORY) is None


def watch(tracker, category, begin, seconds, rate=20.0):
    """Feed one opinion at a rate; returns [(stamp, category told)]."""
    told = []
    for step in range(int(seconds * rate)):
        stamp = begin + step / rate
        told.append((stamp, tracker.update(sure(category), None, stamp).category))
    return told


@pytest.mark.parametrize("rate", [5.0, 15.0, 60.0])
def test_the_category_changes_after_a_time_in_seconds_and_not_at_once(rate):
    tracker = ExpressionTracker()
    watch(tracker, "neutral", 0.0, 2.0, rate)
    told = watch(tracker, "happy", 2.0, 2.0, rate)
    change = next(stamp for stamp, category in told if category == "happy")
    assert HOLD_TIME <= change - 2.0 + 1e-6 <= 1.0
    assert told[-1][1] == "happy"


def test_a_single_wild_opinion_changes_nothing():
    tracker = ExpressionTracker()
    watch(tracker, "neutral", 0.0, 2.0)
    assert tracker.update(sure("angry", 0.999), None, 2.0).category == "neutral"
    assert all(category == "neutral" for _, category in watch(tracker, "neutral", 2.05, 1.0))


def test_a_toss_up_does_not_flicker():
    tracker, random = ExpressionTracker(), np.random.RandomState(3)
    told = []
    for step in range(400):
        odds = np.full(7, 0.02)
        odds[0] = 0.45 + 0.05 * random.randn()
        odds[1] = 0.90 - odds[0]
        told.append(tracker.update(odds, None, step / 20.0).category)
    assert sum(one != two for one, two in zip(told, told[1:])) <= 2


def test_time_that_goes_back_and_a_long_gap_are_a_new_start():
    for stamp in (1.0, 100.0):
        tracker = ExpressionTracker()
        watch(tracker, "neutral", 10.0, 2.0)
        assert tracker.update(sure("happy"), None, stamp).category == "happy"


def test_valence_and_arousal_stay_in_their_range_and_follow_the_probabilities():
    for category in CATEGORIES:
        estimate = ExpressionTracker().update(sure(category, 1.0), None, 0.0)
        assert (estimate.valence, estimate.arousal) == pytest.approx(PLANE[category], abs=0.02)


def test_bad_probabilities():
    tracker = ExpressionTracker()
    with pytest.raises(ValueError, match="7"):
        tracker.update(np.ones(6), None, 0.0)
    assert tracker.update(np.full(7, np.nan), None, 0.0) is None
    assert tracker.update(np.zeros(7), None, 0.1) is None


def test_the_prototypes_name_every_category():
    assert set(PROTOTYPES) == set(PLANE) == set(CATEGORIES)
    for category, codes in EMFACS.items():
        positive = {code for code, weight in PROTOTYPES[category] if weight > 0.0}
        assert set(codes) <= positive
