"""Figures of the benchmark out of what its probe saw."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import List

import numpy as np
import pytest

from benchmarks import pipeline

SEEN = {
    "seconds": 10.0, "tracked": {"persons": 4, "faces": 2, "bodies": 3, "voices alone": 1}, "most_tracked": {},
    "ages": [0.1] * 95 + [0.3] * 5,
    "rates": {"person": [15.0, 12.0, 9.0, 8.0], "face": [15.0, 15.0], "body": []},
    "stages_ms": {"hri_faces": {"mesh": {"median": 3.0, "p95": 4.0}}},
    "rss_mb": {"hri_faces": 200.0, "image_source": 90.0},
    "cpu_percent": {"hri_faces": 40.0, "rosmaster": 1.0, "image_source": 13.0, "benchmark_probe": 1.0}}
MACHINE = {"cpu": "x", "cores": 2, "system": "y", "load_average": [0.1, 0.2, 0.3], "versions": {"numpy": "1"}}


def test_who_is_missing_counts_as_zero_and_who_is_too_many_does_not_count() -> None:
    row = pipeline.figures(3, SEEN)
    assert (row["fps"], row["faces_fps"], row["bodies_fps"]) == (12.0, 10.0, 0.0)
    assert row["found"] == {"persons": 4, "faces": 2, "bodies": 3, "voices alone": 1}
    assert " 4/2/3/1 " in pipeline.as_table([row], MACHINE, {})
    assert row["age_p50_ms"] == 100.0 and 100.0 <= row["age_p95_ms"] <= 300.0


def test_source_and_probe_are_not_counted_as_the_stack() -> None:
    assert pipeline.figures(3, SEEN)["cpu_percent"] == 41.0


def test_without_persons_there_is_no_age() -> None:
    row = pipeline.figures(1, dict(SEEN, ages=[]))
    assert row["age_p50_ms"] is None
    assert "-" in pipeline.as_table([row], MACHINE, {})


def test_json_has_the_promised_keys() -> None:
    result = pipeline.as_json([pipeline.figures(3, SEEN)], MACHINE, {})
    assert {"fps_3", "age_p95_ms_3", "cpu_percent_3", "stages_ms", "cpu_percent_by_process_3",
            "second_run_s"} <= set(result)
    assert result["rss_mb_3"] == 200.0 and result["rss_mb_by_process_3"]["image_source"] == 90.0
    assert result["first_run_s"] is None and set(result["reasons"]) == {"first_run_s", "second_run_s"}
    assert json.loads(json.dumps(result))["stages_ms"]["3"]["hri_faces"]["mesh"]["median"] == 3.0


def test_the_row_of_somebody_who_is_seen() -> None:
    from benchmarks.start import shows_a_person
    assert shows_a_person("igkh6                   awkcn  -      -            1.00    1.39  -0.17   1.75   map     351")
    assert shows_a_person("anonymous_person_jfjb0  -      tuih8  -            1.00    2.23  -0.04   1.24   map     263")
    assert not shows_a_person("anonymous_person_wmbx9  -      -      douyj        0.00  -       -          -")
    assert not shows_a_person("person                  face   body   voice  confidence  position x y z (m)")


def test_starts_are_told_with_their_steps_and_with_what_was_not_fresh() -> None:
    from benchmarks.start import Start, step_times
    steps = step_times(["[1/5] System packages (build run)", "all there (0.5 s)", "[4/5] Catkin workspace",
                        "... 15 s: x", "built: /x (62.7 s)"])
    assert steps == {"System packages (build run)": 0.5, "Catkin workspace": 62.7}
    starts = {"first": Start(301.26, "", steps, ["models"], ["system packages that were there before"]),
              "second": Start(None, "nobody appeared")}
    result = pipeline.as_json([], MACHINE, {}, starts)
    assert result["first_run_s"] == 301.3 and result["first_run"]["not_fresh"] == [
        "system packages that were there before"
    ]
    assert result["second_run_s"] is None and result["reasons"] == {"second_run_s": "nobody appeared"}
    text = pipeline.starts_as_text(starts)
    assert "301.3 s" in text and "62.7 s" in text and "nobody appeared" in text


def test_a_fresh_home_directory_keeps_what_leads_to_the_package_indexes(tmp_path: Path,
                                                                        monkeypatch: pytest.MonkeyPatch) -> None:
    from benchmarks.start import fresh_environment
    (tmp_path / "old").mkdir()
    (tmp_path / "old/.npmrc").write_text("registry=x")
    monkeypatch.setenv("HOME", str(tmp_path / "old"))
    monkeypatch.setenv("ROS4HRI_CACHE", str(tmp_path / "old/cache"))
    environment = fresh_environment(tmp_path / "new")
    assert environment["HOME"] == str(tmp_path / "new") and "ROS4HRI_CACHE" not in environment
    assert [path.name for path in (tmp_path / "new").iterdir()] == [".npmrc"]


def test_inferences_are_told_per_person_and_second() -> None:
    hz = {"face_landmarks_attention": 30.0, "pose_landmarks_full": 12.0, "face_detection_full_range": 5.0}
    row = pipeline.figures(3, dict(SEEN, inferences_hz=hz))
    assert (row["face_inferences"], row["body_inferences"]) == (10.0, 4.0)
    assert pipeline.as_json([row], MACHINE, {})["face_inferences_3"] == 10.0


def test_errors_of_what_is_published_have_their_keys() -> None:
    errors = {prefix: {"landmark": [0.01] * 19 + [0.5], "landmark_px": [0.7], "skeleton": [],
                       "face_direction": [1.0, 3.0]}
              for prefix in ("", "moving_")}
    seen = dict(SEEN, errors=errors, loaded={"ages": [0.1, 0.2], "found": {"persons": 3}})
    result = pipeline.as_json([pipeline.figures(3, seen)], MACHINE, {})
    assert result["landmark_error_3"] == result["moving_landmark_error_3"] == 0.01
    assert 0.01 < result["landmark_error_3_p95"] < 0.1
    assert result["landmark_error_px_3"] == 0.7
    assert result["face_direction_error_deg_3"] == 2.0 and result["skeleton_error_3"] is None
    assert result["loaded"]["age_p95_ms_3"] == 195.0 and result["gpu"]["ms_per_image_10"] is None
    assert "landmark_error" in pipeline.as_table([pipeline.figures(3, seen)], MACHINE, {})


MARKS = [[450.0, 200.0], [700.0, 420.0], [1100.0, 600.0], [60.0, 90.0]]


def _spot(mark: List[float]) -> np.ndarray:
    """A picture (720, 1280, 3) with a bright spot of some pixels on grey, as grey as the wall."""
    rows, columns = np.mgrid[:720, :1280] + 0.5
    spot = 40.0 + 200.0 * np.exp(-((columns - mark[0]) ** 2 + (rows - mark[1]) ** 2) / 18.0)
    return np.repeat(spot[..., None], 3, axis=2).astype(np.uint8)


def _seen(image: np.ndarray) -> np.ndarray:
    """Where (2,) px the spot is."""
    weights = np.maximum(image[..., 0].astype(float) - 45.0, 0.0)
    return np.array([(weights * axis).sum() for axis in (np.mgrid[:720, :1280] + 0.5)[::-1]]) / weights.sum()


@pytest.mark.parametrize("mark", MARKS)
def test_what_the_camera_sees_moves_as_it_turns(mark: List[float]) -> None:
    """In each image a spot of the photograph lies where it is said to be, which is where the turn takes its ray."""
    from benchmarks.moving_people import HFOV, PAN, PAN_S, MovingPeople
    people, focal = MovingPeople(_spot(mark)), 640.0 / math.tan(HFOV / 2.0)
    first = _seen(people.at(0.0, False))
    assert np.linalg.norm(first - (0.94 * (np.array(mark) - (640.0, 360.0)) + (640.0, 360.0))) < 1.0
    ray = np.append((first - (640.0, 360.0)) / focal, 1.0)
    for stamp in (0.1, 1.37, PAN_S / 4.0, 5.021, 6.9):
        said = people.places(first[None], stamp, False)[0]
        assert np.linalg.norm(_seen(people.at(stamp, False)) - said) < 0.1, "at {} s".format(stamp)
        there = people.turn(stamp) @ ray
        assert focal * there[:2] / there[2] + (640.0, 360.0) == pytest.approx(said)
    angle = PAN * math.sin(2.0 * math.pi * 1.37 / PAN_S)
    assert people.turn(1.37) @ (0.0, 0.0, 1.0) == pytest.approx((math.sin(angle), 0.0, math.cos(angle)))


def test_where_people_are_is_known_in_every_image() -> None:
    """A mark on the forehead, one on the hand and one on the wall are found where they are said to be."""
    from benchmarks.moving_people import CYCLE_S, MovingPeople
    face = np.stack([np.linspace(400.0, 500.0, 70), np.linspace(150.0, 270.0, 70)], axis=1)
    body = np.full((18, 3), 1.0)
    body[3:5, :2] = [[700.0, 300.0], [700.0, 420.0]]
    moved = np.zeros(3)
    for number, mark in enumerate(MARKS[:3]):
        people = MovingPeople(_spot(mark), [face], [body])
        first = _seen(people.at(0.0, False))
        for stamp in (CYCLE_S * 0.26, CYCLE_S * 0.76, 3.1):
            said = people.places(first[None], stamp, True)[0]
            assert np.linalg.norm(_seen(people.at(stamp, True)) - said) < 1.0, "mark {} at {} s".format(number, stamp)
            moved[number] = max(moved[number], np.linalg.norm(said - people.places(first[None], stamp, False)[0]))
    assert moved[0] > 5.0 and moved[1] > 30.0 and moved[2] == 0.0


def test_a_face_that_is_at_rest_in_the_room_turns_against_the_camera() -> None:
    from benchmarks.moving_people import PAN_S, MovingPeople
    pytest.importorskip("rospy")    # there is none in the Python 3.8 layer
    from benchmarks.pipeline_probe import Truth
    still = np.array([0.3, 0.1, -1.0]) / np.linalg.norm([0.3, 0.1, -1.0])
    truth = Truth(np.zeros((720, 1280, 3), np.uint8), {
        "landmarks": np.random.default_rng(1).uniform(300.0, 400.0, (1, 70, 3)),
        "skeletons": np.random.default_rng(2).uniform(300.0, 600.0, (1, 18, 3)),
        "directions": np.tile(still, (1, 13, 1))}, 1108.5)
    assert truth.angle(0, MovingPeople.turn(PAN_S / 4.0) @ still, PAN_S / 4.0, False) == pytest.approx(0.0, abs=1e-4)
    assert truth.angle(0, still, PAN_S / 4.0, False) == pytest.approx(1.5, abs=0.15)


ON_A_CARD = dict(SEEN, networks={"hri_faces": "cpu: x; cuda: face_landmarks_attention", "hri_bodies": "cuda: pose"},
                 stages_ms={"hri_faces": {"frame": {"median": 9.0}}, "hri_bodies": {"frame": {"median": 12.5}},
                            "hri_voices": {"block": {"median": 1.0}}},
                 began={"face": 108.0, "body": 111.0}, started=100.0, stall_s={"face": 0.05, "body": 0.08})


def test_the_figures_of_a_card_are_told_where_both_nodes_used_it() -> None:
    row = pipeline.figures(10, ON_A_CARD)
    assert pipeline.as_json([row], MACHINE, {})["gpu"] == {"ms_per_image_10": 21.5, "stall_s": 0.08, "start_s": 11.0}
    assert "21.5 ms per image" in pipeline.as_table([row], MACHINE, {})


@pytest.mark.parametrize(("change", "reason"), [
    ({"networks": dict(ON_A_CARD["networks"], hri_bodies="cpu: pose")}, "the networks of hri_bodies ran on cpu"),
    ({"began": {"face": 108.0}}, "not both faces and bodies were seen"), ({"networks": {}}, "not both faces")])
def test_without_a_card_its_figures_have_a_reason(change: dict, reason: str) -> None:
    card = pipeline.as_json([pipeline.figures(10, dict(ON_A_CARD, **change))], MACHINE, {})["gpu"]
    assert card["ms_per_image_10"] is None and card["stall_s"] is None and reason in card["reason"]
