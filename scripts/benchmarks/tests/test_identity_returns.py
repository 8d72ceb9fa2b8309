"""The labels of vtest, the simulated worlds, and the figures made of them."""

import numpy as np
import pytest

from benchmarks.identity_returns import (
    FilmTrack,
    crossing_figures,
    film_returns,
    frames_of,
    read_labels,
    spread_of,
    world_returns,
)
from benchmarks.identity_worlds import World, human, seen_clothes
from hri_fullbody.core.tracking.reidentification import difference


@pytest.fixture(scope="module")
def stays():
    return read_labels()


def test_the_labels_are_twenty_stays_and_somebody_far_away(stays):
    names = {stay.name for stay in stays}
    assert len(names) == len(stays) == 21
    for stay in stays:
        assert (np.diff(stay.frames) > 0).all() and 0 <= stay.frames[0] and stay.frames[-1] <= 794
        assert (stay.boxes[:, 2:] > stay.boxes[:, :2]).all()
        assert (stay.boxes >= 0).all() and (stay.boxes <= (768, 576, 768, 576)).all()


def test_a_line_of_another_kind_is_refused(tmp_path):
    path = tmp_path / "labels.txt"
    path.write_text("# a comment\nbox ann.1 0 1 2 3 4\nbax ann.1 1 1 2 3 4\n", encoding="utf-8")
    with pytest.raises(ValueError, match="bax"):
        read_labels(path)


def perfect(stays, names):
    """Return the track of a perfect pipeline that gives each stay the id of `names`."""
    boxes = [{names[stay.name]: stay.box(number) for stay in stays
              if stay.box(number) is not None and not stay.is_hidden(number)} for number in range(795)]
    return FilmTrack(boxes, [])


@pytest.mark.slow("a whole film")
def test_who_finds_all_has_full_figures_and_who_swaps_two_has_not(stays):
    names = {stay.name: stay.name for stay in stays}
    found = crossing_figures(frames_of(perfect(stays, names), stays), 1.325)
    assert (found["idf1"], found["hota"], found["switches"], found["ids"]) == (1.0, 1.0, 0, 20)
    track = perfect(stays, names)
    swapped = {"coat.2": "jeans.2", "jeans.2": "coat.2"}
    boxes = [{swapped.get(key, key): box for key, box in frame.items()} if number > 650 else frame
             for number, frame in enumerate(track.boxes)]
    worse = crossing_figures(frames_of(FilmTrack(boxes, []), stays), 1.325)
    assert worse["switches"] == 2 and worse["idf1"] < 0.98


@pytest.mark.slow("a whole film")
def test_a_match_on_the_film_is_right_for_one_human(stays):
    track = perfect(stays, {stay.name: stay.name for stay in stays})
    told = [(610, "red.2", "red.1", 0.95), (580, "jeans.2", "bald.1", 0.95), (0, "nobody", "nobody else", 0.95)]
    assert film_returns(FilmTrack(track.boxes, told), stays) == {"right": 1, "wrong": 2, "returns": 9}


def test_who_finds_all_from_a_later_start_on_has_missed_nobody(stays):
    track = perfect(stays, {stay.name: stay.name for stay in stays})
    later = FilmTrack([{}] * 760 + track.boxes[760:], [], 760)
    found = crossing_figures(frames_of(later, stays), 35 / 600.0)
    assert len(frames_of(later, stays)) == 35 and (found["idf1"], found["misses"]) == (1.0, 0)


def test_several_runs_have_a_mean_and_a_spread():
    found = spread_of([{"idf1": 0.9, "ids": 20}, {"idf1": 0.94, "ids": 23}])
    assert found["mean"] == {"idf1": 0.92, "ids": 21.5} and found["sd"] == {"idf1": 0.028, "ids": 2.121}
    assert found["runs"]["0"] == {"idf1": 0.9, "ids": 20}


def test_simulated_clothes_differ_as_they_were_measured():
    """Mean distances on the film: .167 of one human, .48 of two."""
    random = np.random.default_rng(0)
    people = [human(random) for _ in range(60)]
    same = [difference(seen_clothes(one, random), seen_clothes(one, random)) for one in people]
    other = [difference(seen_clothes(one, random), seen_clothes(two, random)) for one, two in zip(people, people[1:])]
    assert np.mean(same) == pytest.approx(0.17, abs=0.03)
    assert np.mean(other) == pytest.approx(0.49, abs=0.06)


def test_a_world_has_returns_and_strangers_and_counts_them():
    found = world_returns(range(3))
    assert found["returns"] + found["strangers"] == 36 and found["returns"] > 5 and found["strangers"] > 5
    assert found["right"] > found["wrong"]
    assert World(0, 2).run(3)[0][0] == World(0, 2).run(3)[0][0]
