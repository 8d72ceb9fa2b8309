"""The gallery on synthetic templates: who is like whom, what is kept, what is forgotten, how fast it is."""

import time
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.recognition import SIZE
from benchmarks.recognition import template as face
from hri_pipeline.core.recognition.gallery import GalleryError, MemoryGallery
from hri_pipeline.core.recognition.likelihood import CROWD_SHARE, MOST_STRETCHED, TemplateCalibration
from hri_pipeline.core.recognition.store import KnownPerson

CALIBRATION = TemplateCalibration(midpoint=0.36, fair_midpoint=0.40, scale=0.018, near=0.15)


@pytest.fixture
def gallery():
    return MemoryGallery("synthetic", SIZE, CALIBRATION)


def fill(gallery, count):
    for seed in range(count):
        gallery.add_person("p{:04d}".format(seed), face(seed)[None])


def test_distances_and_likelihoods(gallery):
    fill(gallery, 3)
    result = gallery.match(face(1, 0.2)[None])[0]
    assert [one.person_id for one in result.candidates][0] == "p0001"
    assert result.candidates[0].distance == pytest.approx(0.2, abs=1e-3)
    assert result.candidates[0].likelihood > 0.95
    assert sum(one.likelihood for one in result.candidates) <= 1.0
    assert result.population == 3


def test_unknown_is_an_answer(gallery):
    fill(gallery, 20)
    for seed in range(100, 150):
        result = gallery.match(face(seed)[None])[0]
        assert max(one.likelihood for one in result.candidates) < 0.01
    assert gallery.match(face(0, 0.45)[None])[0].candidates[0].likelihood < 0.05


def test_an_empty_gallery_knows_nobody(gallery):
    assert gallery.match(face(0)[None])[0].candidates == ()


@pytest.mark.parametrize("persons", [1, 10, 100, 1000])
def test_the_more_are_known_the_closer_a_match_must_be(persons):
    likelihood = [CALIBRATION.likelihoods(np.array([distance] + [1.0] * (persons - 1)), persons)[0]
                  for distance in (0.1, 0.2, 0.3, 0.36, 0.5)]
    assert likelihood == sorted(likelihood, reverse=True)
    at_odds_of_one = CALIBRATION.likelihoods(np.array([CALIBRATION.fair_midpoint]), persons)[0]
    assert at_odds_of_one < 1.0 / (5 + persons)
    assert CALIBRATION.limit(0.8, persons) > CALIBRATION.limit(0.8, 10 * persons)
    assert CALIBRATION.limit(0.8, persons) < CALIBRATION.limit(0.8, persons, views=4.0) < CALIBRATION.kin_midpoint


def test_the_limit_is_where_the_likelihood_is_reached():
    limit = CALIBRATION.limit(0.8, 12, 2.0)
    assert CALIBRATION.likelihoods(np.array([limit]), 12, 2.0)[0] == pytest.approx(0.8, abs=1e-3)


def test_the_false_match_rate_is_bounded_by_the_odds():
    """On distances drawn from densities whose ratios are those of the calibration."""
    random, calibration = np.random.RandomState(0), CALIBRATION
    deviation = np.sqrt(calibration.kin_scale * 0.16)
    mean = calibration.kin_midpoint + 0.08
    kin = random.normal(mean, deviation, 100000)
    for distance in (0.2, 0.25, 0.28):
        stranger, alike = calibration.false_match_rates(distance, 10)
        assert (kin < distance).mean() <= alike < 1.0 and 0.0 < stranger < 1.0
    assert calibration.false_match_rates(0.25, 100)[0] == pytest.approx(10 * calibration.false_match_rates(0.25, 10)[0])


def test_distances_near_the_mean_of_all_count_more_everywhere():
    """Two templates, 0.20 from the mean and from each other, and the radius is 0.25."""
    mean, angle = np.eye(SIZE, dtype=np.float32)[0], 2.0 * np.arcsin(0.1)
    turn = 2.0 * np.arcsin(0.1 / np.sin(angle))
    first, second = (np.r_[np.cos(angle), np.sin(angle) * np.cos(one), np.sin(angle) * np.sin(one), np.zeros(SIZE - 3)
                           ].astype(np.float32) for one in (0.0, turn))
    calibration = replace(CALIBRATION, centre=tuple(float(number) for number in mean), radius=0.25)
    gallery = MemoryGallery("synthetic", SIZE, calibration)
    gallery.add_person("one", first[None])
    gallery.add_person("two", second[None])
    assert gallery.nearest("one", second) == pytest.approx(0.25, abs=1e-3)
    assert gallery.distance("one", "two") == pytest.approx(0.25, abs=1e-3)
    for nearest_only in (False, True):
        likeliest, other = gallery.match(first[None], nearest_only=nearest_only)[0].candidates
        assert likeliest.person_id == "one" and other.distance == pytest.approx(0.25, abs=1e-3)
    assert calibration.apart(first[None], np.stack((first, second)))[0] == pytest.approx([0.0, 0.25], abs=1e-3)
    assert calibration.compared(0.1, first, mean) == pytest.approx(0.1 * MOST_STRETCHED), "no more than that"
    assert calibration.compared(0.3, face(1), face(1, 0.3)) == 0.3, "far from the mean, as measured"


def test_two_alike_persons_share_the_likelihood():
    likelihoods = CALIBRATION.likelihoods(np.array([0.2, 0.2, 1.0]), 3)
    assert likelihoods[0] == pytest.approx(likelihoods[1]) and likelihoods[0] < 0.51


@pytest.mark.parametrize("values", [(0.36, 0.30, 0.02, 0.1), (0.36, 0.4, 0.0, 0.1), (0.36, 0.4, 0.02, 0.5),
                                    (float("nan"), 0.4, 0.02, 0.1), (0.36, 0.4, 0.018, 0.15, 0.37),
                                    (0.36, 0.4, 0.018, 0.15, 0.32, 0.0)])
def test_a_calibration_is_checked(values):
    with pytest.raises(ValueError, match="midpoint"):
        TemplateCalibration(*values)


def test_two_who_are_apart_stay_so_until_somebody_goes(gallery):
    fill(gallery, 4)
    gallery.keep_apart("p0001", "p0002")
    gallery.keep_apart("p0002", "p0003")
    assert gallery.are_apart("p0002", "p0001") and not gallery.are_apart("p0001", "p0003")
    assert gallery.distance("p0001", "p0002") is None and gallery.distance("p0001", "p0003") is not None
    gallery.merge("p0001", "p0000")
    assert gallery.are_apart("p0000", "p0002")
    gallery.merge("p0000", "p0002")
    assert not gallery.are_apart("p0002", "p0002") and gallery.are_apart("p0002", "p0003")
    gallery.remove("p0003")
    assert not gallery.are_apart("p0002", "p0003")
    with pytest.raises(GalleryError, match="nobody"):
        gallery.keep_apart("p0002", "nobody")


def test_who_is_alike(gallery):
    fill(gallery, 3)
    assert [one.person_id for one in gallery.alike(face(1, 0.3), 0.4)] == ["p0001"]
    assert gallery.alike(face(1, 0.3), 0.25) == [] == gallery.alike(face(1, 0.3), 0.4, except_for="p0001")
    assert gallery.nearest("p0001", face(1, 0.3)) == pytest.approx(0.3, abs=1e-3)
    assert gallery.nearest("nobody", face(1)) is None


def test_where_the_people_are_alike_a_match_must_be_closer():
    gallery = MemoryGallery("synthetic", SIZE, replace(CALIBRATION, crowd=0.5))
    probe = face(1, 0.25, 9)
    fill(gallery, 12)
    before, = gallery.match(probe[None])
    assert before.candidates[0].distance == pytest.approx(0.25, abs=1e-3), "nobody else is near"
    for view in range(3):
        gallery.add_person("alike{}".format(view), face(1, 0.4, view)[None])
    after, = gallery.match(probe[None])
    from_probe = [float(np.linalg.norm(probe - face(1, 0.4, view))) for view in range(3)]
    more = CROWD_SHARE * (np.mean([0.5 - one for one in from_probe]) + 0.5 - 0.4) / 2.0
    assert min(from_probe) > 0.4 and max(from_probe) < 0.5
    assert after.candidates[0].person_id == "p0001"
    assert after.candidates[0].distance == pytest.approx(0.25 + more, abs=1e-3)
    assert after.candidates[0].likelihood < before.candidates[0].likelihood
    assert gallery.alike(probe, 0.4)[0].distance == pytest.approx(0.25, abs=1e-3), "enrolment asks as before"


@pytest.mark.parametrize("far, counted", [(0, 3), (100, 3), (300, 6)])
def test_of_many_people_more_tell_how_alike_they_are(far, counted):
    calibration = replace(CALIBRATION, crowd=0.5)
    others = np.array(3 * [0.4] + far * [1.2])
    assert calibration.crowding(others, np.empty(0)) == pytest.approx(CROWD_SHARE * 0.1 * 3 / counted / 2.0)
    assert CALIBRATION.crowding(others, others) == 0.0, "not measured"


def test_a_second_id_of_one_human_is_no_crowd():
    gallery = MemoryGallery("synthetic", SIZE, replace(CALIBRATION, crowd=0.5))
    gallery.add_person("anna", face(1)[None])
    gallery.add_person("again", face(1, 0.2)[None])
    assert gallery.match(face(1)[None])[0].candidates[0].distance == pytest.approx(0.0, abs=1e-3)
    assert gallery.match(face(1, 0.2, 5)[None])[0].candidates[0].distance == pytest.approx(0.2, abs=1e-3)


def test_the_crowd_is_that_of_those_who_are_compared():
    gallery = MemoryGallery("synthetic", SIZE, replace(CALIBRATION, crowd=0.5))
    gallery.add_person("alike", face(1, 0.4)[None])
    gallery.add_person("anna", face(1)[None], enrolled=True)
    everybody, = gallery.match(face(1, 0.2, 5)[None])
    enrolled, = gallery.match(face(1, 0.2, 5)[None], enrolled_only=True)
    assert enrolled.candidates[0].distance == pytest.approx(0.2, abs=1e-3)
    assert everybody.candidates[0].distance > 0.21


def test_room_for_more_persons_is_empty_room(gallery):
    gallery.add_person("anna", face(99)[None], enrolled=True)
    fill(gallery, 16)
    assert gallery._count.tolist() == 17 * [1] + 15 * [0]
    assert np.flatnonzero(gallery._enrolled).tolist() == [0]


def test_any_template_of_a_person_will_do(gallery):
    gallery.add_person("anna", np.stack([face(1), face(1, 0.38, 1)]))
    candidate = gallery.match(face(1, 0.38, 1)[None])[0].candidates[0]
    assert candidate.distance < 0.2 and candidate.likelihood > 0.95
    gallery.add_person("bert", np.stack([face(2), face(3)]))
    assert gallery.match(face(3)[None])[0].candidates[0].distance < 0.01, "views too far apart to be averaged"


def test_who_is_near_to_one_view_only_is_farther_than_who_is_near_to_all(gallery):
    views = np.stack([face(1), face(1, 0.3, 1), face(1, 0.3, 2)])
    gallery.add_person("anna", views)
    middle = views.sum(axis=0) / np.linalg.norm(views.sum(axis=0))
    by_one = views[1] + 0.25 * (views[1] - middle)
    by_one /= np.linalg.norm(by_one)
    near, far = gallery.match(np.stack([middle, by_one]))
    assert gallery.nearest("anna", middle) > gallery.nearest("anna", by_one)
    assert near.candidates[0].distance < far.candidates[0].distance
    assert gallery.alike(by_one, 2.0)[0].distance == pytest.approx(gallery.nearest("anna", by_one), abs=2e-5)


def test_only_what_differs_is_kept_and_the_cap_holds(gallery):
    gallery.add_person("anna", face(1)[None])
    assert not gallery.add_template("anna", face(1, 0.05)), "tells nothing new"
    kept = [gallery.add_template("anna", face(1, 0.3, view)) for view in range(4)]
    assert kept == [True] * 4
    assert len(gallery.export("anna").templates) == 5
    for view in range(4, 40):
        gallery.add_template("anna", face(1, 0.16 + 0.005 * view, view))
    templates = gallery.export("anna").templates
    assert len(templates) == 5
    assert np.array_equal(templates[0], face(1)), "the first one stays"


def test_no_chain_of_small_changes_leads_to_somebody_else(gallery):
    gallery.add_person("anna", face(1)[None])
    assert gallery.add_template("anna", face(1, 0.3))
    assert not gallery.add_template("anna", face(1, 0.55)), "near to the last one, far from the first"


def test_forget(gallery):
    fill(gallery, 40)
    assert gallery.remove("p0007") and not gallery.remove("p0007")
    assert "p0007" not in gallery.ids() and len(gallery) == 39
    assert gallery.match(face(7)[None])[0].candidates[0].distance > 1.0
    assert gallery.match(face(8)[None])[0].candidates[0].person_id == "p0008"
    held = gallery._templates.reshape(-1, SIZE)
    assert not (held @ face(7) > 0.99).any(), "not even in the array"
    gallery.clear()
    assert gallery.ids() == [] and not gallery._templates.any()


def test_merge(gallery):
    fill(gallery, 3)
    gallery.enrol("p0001")
    gallery.merge("p0001", "p0002")
    assert gallery.ids() == ["p0000", "p0002"]
    assert gallery.match(face(1)[None])[0].candidates[0].person_id == "p0002"
    assert gallery.export("p0002").enrolled


def test_only_those_who_are_enrolled(gallery):
    fill(gallery, 3)
    assert gallery.match(face(1)[None], enrolled_only=True)[0].candidates == ()
    gallery.enrol("p0001")
    assert [one.person_id for one in gallery.match(face(1)[None], enrolled_only=True)[0].candidates] == ["p0001"]
    gallery.enrol("p0001", False)
    assert gallery.match(face(1)[None], enrolled_only=True)[0].candidates == ()


@pytest.mark.parametrize("act, text", [
    (lambda g: g.add_person("p0000", face(0)[None]), "there already"),
    (lambda g: g.add_person("a b", face(0)[None]), "no identifier"),
    (lambda g: g.add_person("anna", face(0)), "shape"),
    (lambda g: g.add_person("anna", 2.0 * face(0)[None]), "unit"),
    (lambda g: g.add_person("anna", np.full((1, SIZE), np.nan)), "unit"),
    (lambda g: g.add_person("anna", np.empty((0, SIZE))), "shape"),
    (lambda g: g.match(face(0)[None, :5]), "shape"),
    (lambda g: g.add_template("nobody", face(0)), "nobody"),
    (lambda g: g.export("nobody"), "nobody"),
    (lambda g: g.merge("p0000", "p0000"), "itself"),
    (lambda g: g.merge("nobody", "p0000"), "nobody"),
])
def test_what_cannot_be_done_is_said_and_changes_nothing(gallery, act, text):
    fill(gallery, 2)
    before = gallery.revision
    with pytest.raises(GalleryError, match=text):
        act(gallery)
    assert gallery.revision == before and gallery.ids() == ["p0000", "p0001"]


def test_a_full_gallery_says_so():
    small = MemoryGallery("synthetic", SIZE, CALIBRATION, max_persons=2)
    fill(small, 2)
    for person_id in small.ids():
        small.enrol(person_id)
    assert "full" in small.refusal
    with pytest.raises(GalleryError, match="full"):
        small.add_person("anna", face(9)[None])
    assert small.ids() == ["p0000", "p0001"]


def test_of_a_full_gallery_who_was_not_seen_for_longest_gives_way():
    small = MemoryGallery("synthetic", SIZE, CALIBRATION, max_persons=3)
    fill(small, 3)
    small.keep_apart("p0001", "p0002")
    small.note_seen(["p0002"])
    small.note_seen(["p0000", "nobody"])
    small.note_seen(["p0002"])
    small.note_seen([])
    assert small.refusal == ""
    for name in ("anna", "bert"):
        small.add_person(name, face(9)[None])
    assert small.ids() == ["p0002", "anna", "bert"] and not small.are_apart("p0001", "p0002")
    small.note_seen(["anna", "bert"])
    small.borrow([KnownPerson("carl", face(8)[None], False)], "elsewhere")
    assert small.ids() == ["anna", "bert", "carl"]
    with pytest.raises(GalleryError, match="full"):
        small.add_person("dora", face(7)[None])
    small.clear()
    fill(small, 3)
    small.note_seen([])
    small.add_person("anna", face(9)[None])
    assert small.ids() == ["p0001", "p0002", "anna"]


def best_of(action, repeats):
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        action()
        times.append(time.perf_counter() - begin)
    return min(times)


def test_a_thousand_persons_with_five_templates_cost_less_than_reading_them_a_few_times():
    gallery = MemoryGallery("synthetic", SIZE, CALIBRATION)
    templates = np.random.RandomState(1).randn(1000, 5, SIZE)
    templates /= np.linalg.norm(templates, axis=2, keepdims=True)
    for number, five in enumerate(templates):
        gallery.add_person("p{:04d}".format(number), five)
    assert all(len(gallery.export(person_id).templates) == 5 for person_id in gallery.ids())
    query = templates[500, 3:4].astype(np.float32)
    assert gallery.match(query)[0].candidates[0].person_id == "p0500"
    plain = np.random.RandomState(0).randn(5000, SIZE).astype(np.float32)
    # A ratio, as the machine may be slow or busy: the comparison with plain sums over as many numbers.
    reference = best_of(lambda: (plain * query).sum(axis=1), 20)
    assert best_of(lambda: gallery.match(query), 20) < 5.0 * reference
