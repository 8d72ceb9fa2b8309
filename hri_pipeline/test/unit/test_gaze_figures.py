"""The figures of the gazes: good in a short scene, worse without the closed-eyes rule, better than the head alone; and
in a world of others better than the filter alone."""

import pytest

from benchmarks.gaze import CLOSED_AFTER_S, RATE, ROBOT_AT, gaze, head_rule, run
from benchmarks.gaze_independent import figures
from hri_pipeline.core.interactions.gaze_cues import GazeJudge

SEED = (7,)


@pytest.mark.slow("three simulations")
def test_the_closed_eyes_rule_is_what_ends_gazes_of_closed_eyes():
    with_rule, without = (gaze(3, 20.0, rule, seeds=SEED) for rule in (True, False))
    assert min(with_rule["precision"], with_rule["recall"]) > 0.85
    assert with_rule["closed_gazes"] == 0
    assert without["closed_gazes"] > RATE
    head = head_rule(3, 20.0, seeds=SEED)
    assert min(head["precision"], head["recall"]) < min(with_rule["precision"], with_rule["recall"])


@pytest.mark.slow("two simulations")
def test_the_judge_finds_more_looks_of_a_world_in_which_it_did_not_learn(monkeypatch):
    judged = figures(counts=(8,), seconds=12.0, seeds=(30,))["faces"]["8"]
    monkeypatch.setattr(GazeJudge, "update", lambda judge, people, lines, beliefs, *others: beliefs[:, :-1])
    filtered = figures(counts=(8,), seconds=12.0, seeds=(30,))["faces"]["8"]
    assert judged["recall"] > filtered["recall"] + 0.02
    assert judged["precision"] > filtered["precision"] - 0.01


def test_the_scene_has_what_it_promises():
    moments = list(run(3, 30.0, 11))
    seen = [person for moment in moments for person in moment.seen]
    lost = sum(person.head_direction is None for person in seen) / len(seen)
    assert lost == pytest.approx(0.10, abs=0.03)
    closed = [length for moment in moments for length in moment.closed_for.values()]
    assert 0.03 < len(closed) / len(seen) < 0.25
    assert max(closed) > CLOSED_AFTER_S
    assert all(set(moment.gazes) & set(moment.closed_for) == set() for moment in moments)
    distances = [((person.head[:2] - ROBOT_AT[:2]) ** 2).sum() ** 0.5 for person in seen
                 if person.head_direction is not None]
    assert 0.7 < min(distances) < max(distances) < 4.6
