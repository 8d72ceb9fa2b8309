"""The benchmark of names: who is in which half, people who do not exist, and how encounters are judged."""

import numpy as np
import pytest

from benchmarks.identity_names import Meetings, around, at_distance, half_of
from benchmarks.recognition import SIZE, identities, template
from hri_pipeline.core.recognition.gallery import MemoryGallery
from hri_pipeline.core.recognition.likelihood import TemplateCalibration

CALIBRATION = TemplateCalibration(midpoint=0.38, fair_midpoint=0.40, scale=0.018, near=0.15)


def views(person, distance=0.1, count=12):
    return np.stack([template(person, distance, view) for view in range(count)])


@pytest.fixture
def meetings():
    return Meetings(MemoryGallery("synthetic", SIZE, CALIBRATION), seed=1)


def test_each_person_is_in_one_half_and_the_halves_are_alike_in_size():
    people = {label.label for label in identities()}
    tuning = {person for person in people if half_of(person) == "tuning"}
    assert 0.4 < len(tuning) / len(people) < 0.6
    assert {"one", "talking", "demo_01"} <= tuning and not {"other", "weeping", "demo_02"} & tuning


@pytest.mark.parametrize("distance", [0.2, 0.45])
def test_somebody_alike_is_at_the_distance_that_was_drawn_and_varies_as_a_film(distance):
    centre = at_distance(template(1), template(2), distance)
    assert np.linalg.norm(centre - template(1)) == pytest.approx(distance, abs=1e-6)
    film = views(3, 0.15, 40)
    alike = around(centre, film)
    assert np.allclose(np.linalg.norm(alike, axis=1), 1.0)
    assert np.linalg.norm(alike.mean(axis=0) - centre) < 0.05
    assert alike.std() == pytest.approx(film.std(), rel=0.2)


def test_who_is_enrolled_is_named_and_a_stranger_gets_an_id_of_his_own(meetings):
    assert meetings.enrol("anna", views(1))
    known = meetings.meet("anna", views(1, 0.15))
    assert known.wrong == 0.0 and known.right > 6.0 and known.visible == pytest.approx(8.0)
    assert meetings.meet("bert", views(2)).wrong == 0.0
    assert meetings.meet("bert", views(2)).right > 6.0, "now he is known"


def test_a_wrong_name_is_counted(meetings):
    meetings.enrol("anna", views(1))
    wrong = meetings.meet("a double", views(1))
    assert wrong.wrong > 6.0 and wrong.right == 0.0 and wrong.wrong_encounters == 1
    assert not meetings.enrol("her brother", around(at_distance(template(1), template(2), 0.36), views(3, 0.1)))


def test_how_long_a_name_stays_is_measured(meetings):
    meetings.enrol("anna", views(1))
    assert 0.0 < meetings.time_until_taken_back("anna", views(1), views(2)) <= 1.5
    assert meetings.time_until_taken_back("anna", views(1), views(1)) == pytest.approx(10.0, abs=0.2)
    alike = around(at_distance(template(1), template(2), 0.34), views(3, 0.1))
    assert meetings.time_until_taken_back("her brother", alike, views(2)) is None, "he had no name"
