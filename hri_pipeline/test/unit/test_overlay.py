import numpy as np
import pytest

from hri_pipeline.core import overlay
from hri_pipeline.core.observations import FeatureHistory
from hri_pipeline.core.overlay import PersonMark, colour_of, counts, draw_overlay, label_lifts, short_name


def body(x=200.0, confidence=1.0):
    points = np.zeros((18, 3))
    points[:, 0] = x + np.linspace(-40.0, 40.0, 18)
    points[:, 1] = np.linspace(150.0, 400.0, 18)
    points[:, 2] = confidence
    return points


def face(x=200.0, y=100.0):
    angle = np.linspace(0.0, 6.0, 70)
    return np.stack([x + 30.0 * np.cos(angle), y + 30.0 * np.sin(angle), np.ones(70)], axis=1)


@pytest.fixture
def image():
    return np.zeros((480, 640, 3), np.uint8)


def pixels_of(picture, colour):
    return int((picture == np.array(colour, np.uint8)).all(axis=2).sum())


def test_draws_on_a_copy_in_the_colour_of_the_person(image):
    mark = PersonMark("wxyza", face_id="faaaa", body_id="baaaa")
    picture = draw_overlay(image, {"faaaa": face()}, {"baaaa": body()}, [mark])
    assert not image.any()
    assert pixels_of(picture, colour_of("wxyza")) > 1000


def test_features_of_nobody_are_grey(image):
    picture = draw_overlay(image, {"faaaa": face()}, {"baaaa": body()}, [])
    assert pixels_of(picture, (190, 190, 190)) > 500
    hues = picture.reshape(-1, 3).astype(int)
    assert (hues.max(axis=1) - hues.min(axis=1)).max() < 12


def test_ignored_regions_are_outlined_and_named_and_nothing_is_drawn_without(image):
    empty, picture = draw_overlay(image, {}, {}, []), draw_overlay(image, {}, {}, [], ignored=[(0.5, 0.25, 1.0, 0.5)])
    changed = (picture != empty).any(axis=2)
    rows, columns = np.nonzero(changed)
    assert 315 <= columns.min() <= 322 and columns.max() == 639 and 115 <= rows.min() <= 122 and (
        238 <= rows.max() <= 245)
    assert not changed[180:230, 340:600].any(), "what is within stays visible"
    assert changed[122:160, 325:420].any(), "the word"


def test_uncertain_and_hostile_points_are_left_out(image):
    empty = draw_overlay(image, {}, {}, [])
    lower = slice(0, 400)
    assert (draw_overlay(image, {}, {"b": body(confidence=0.1)}, [])[lower] == empty[lower]).all()
    hostile = body()
    hostile[:, 0] = np.nan
    hostile[::2, 0] = 1e300
    picture = draw_overlay(image, {"f": np.full((70, 3), np.inf)}, {"b": hostile}, [PersonMark("p", "f", "b")])
    assert (picture[lower] == empty[lower]).all()


def test_a_person_without_features_and_a_tiny_image():
    tiny = np.zeros((4, 4, 3), np.uint8)
    picture = draw_overlay(tiny, {"f": face()}, {"b": body()}, [PersonMark("p", "f"), PersonMark("q")])
    assert picture.shape == tiny.shape and not tiny.any()


def test_plates_of_neighbours_do_not_cover_each_other(image):
    marks = [PersonMark("person{}".format(number), face_id="f{}".format(number)) for number in range(4)]
    faces = {"f{}".format(number): face(300.0 + 5.0 * number, 200.0) for number in range(4)}
    picture = draw_overlay(image, faces, {}, marks)
    areas = [pixels_of(picture, colour_of(mark.id)) for mark in marks]
    assert min(areas) > 0.6 * max(areas)


@pytest.mark.parametrize("people", [2, 3, 5, 8])
def test_plates_in_a_crowd_cover_neither_each_other_nor_faces(image, monkeypatch, people):
    plates = []
    monkeypatch.setattr(overlay.cv2, "rectangle", lambda canvas, low, high, *_: plates.append((*low, *high)))
    rng = np.random.default_rng(people)
    for _ in range(50):
        faces = {"f%d" % number: face(rng.uniform(220.0, 420.0), rng.uniform(0.0, 160.0)) for number in range(people)}
        marks = [PersonMark("p%d" % number, name, expression="surprised", looks_at="")
                 for number, name in enumerate(faces)]
        plates.clear()
        draw_overlay(image, faces, {}, marks)
        assert len(plates) == people + 1
        for index, (left, top, right, bottom) in enumerate(plates):
            assert 0 <= left and right < 640 and 0 <= top and bottom <= 480
            assert not any(left < other[2] and other[0] < right and top < other[3] and other[1] < bottom
                           for other in plates[:index])
        for rows in faces.values():
            x, y = rows[:, :2].mean(axis=0)
            assert not any(left < x < right and top < y < bottom for left, top, right, bottom in plates)


def test_who_is_only_heard_is_no_further_person():
    seen = [PersonMark("p1", "f1", "b1"), PersonMark("p2", "f2"), PersonMark("p3", body_id="b3", voice_id="v3")]
    assert counts(2, 2, seen) == "2 faces   2 bodies   3 persons"
    assert counts(1, 1, seen[:1] + [PersonMark("p4", voice_id="v4")]) == "1 face   1 body   1 person   1 voice"
    assert counts(0, 0, [PersonMark("lost")]) == "0 faces   0 bodies   1 person"


@pytest.mark.parametrize("turned", [False, True])
def test_labels_in_space_that_are_near_each_other_stand_above_one_another(turned):
    places = np.array([(0.0, 0.0, 1.6), (0.3, 0.0, 1.55), (0.5, 0.0, 1.7), (2.0, 0.0, 1.6), (0.0, 0.1, 1.2)])
    up = (0.0, 0.0, 1.0)
    if turned:
        places, up = places[:, [0, 2, 1]] * (1.0, -1.0, 1.0), (0.0, -1.0, 0.0)
    wide = label_lifts(places, up, [0.55] * 5, 0.2)
    assert wide == pytest.approx([0.0, 0.25, 0.3, 0.0, 0.0])
    assert label_lifts(places, up, [0.15] * 5, 0.2) == [0.0] * 5
    assert label_lifts([], up, [], 0.2) == []


def test_what_is_written_about_a_person():
    assert PersonMark("abcde", confidence=0.5).label == "abcde  50 %"
    assert PersonMark("abcde", name="Ann", expression="happy", looks_at="").label == "Ann  100 %  happy  > robot"
    assert PersonMark("abcde", name="Zoë " + 100 * "x", looks_at="other").label == "Zo? " + 20 * "x" + "  100 %"


def test_a_gaze_is_an_arrow_between_two_heads(image):
    faces = {"f1": face(100.0, 200.0), "f2": face(500.0, 200.0)}
    marks = [PersonMark("one", "f1"), PersonMark("two", "f2")]
    plain = draw_overlay(image, faces, {}, marks)
    looking = draw_overlay(image, faces, {}, [PersonMark("one", "f1", looks_at="two"), marks[1]])
    between = (slice(190, 210), slice(200, 400))
    assert not plain[between].any()
    assert pixels_of(looking[between], colour_of("one")) > 200
    # To somebody who is not in the image there is no arrow.
    elsewhere = draw_overlay(image, faces, {}, [PersonMark("one", "f1", looks_at="three"), marks[1]])
    assert (elsewhere == plain).all()


def test_colours_are_stable_bright_and_different():
    assert colour_of("abcde") == colour_of("abcde")
    colours = {colour_of("id{}".format(number)) for number in range(50)}
    assert len(colours) == 50
    assert all(max(colour) == 255 for colour in colours)


def test_short_name():
    assert short_name("anonymous_person_abcde") == "anon abcde"
    assert short_name("abcde") == "abcde"


def test_choose_prefers_the_image_where_all_is_known():
    history = FeatureHistory()
    images = [1.0, 1.1, 1.2, 1.3]
    assert history.choose([], 0.1) is None
    assert history.choose(images, 0.1) == 1.3
    history.add("faces", "f", 1.2, face())
    assert history.choose(images, 0.1) == 1.2
    history.add("bodies", "b", 1.1, body())
    assert history.choose(images, 0.15) == 1.2
    assert history.choose(images, 0.05) == 1.2
    history.add("faces", "f", 1.1, face())
    assert history.choose(images, 0.05) == 1.1
    history.add("faces", "f", 1.9, face())
    assert history.choose(images + [1.9], 0.05) == 1.1
    history.add("faces", "f", 2.4, face())
    assert history.choose(images + [1.9, 2.4], 0.05) == 2.4


def test_old_features_do_not_hold_the_picture_back():
    history = FeatureHistory()
    history.add("faces", "f", 1.0, face())
    assert history.choose([1.0, 1.1, 3.0], 0.15) == 3.0


def test_features_that_always_come_late_are_drawn_all_the_same():
    history = FeatureHistory(keep=5.0)
    images = [0.1 * number for number in range(100)]
    for arrival in range(30, 90, 10):
        history.add("faces", "f", images[arrival - 25], face())
        shown = [history.choose(images[:now + 1], 0.15) for now in range(arrival, arrival + 10)]
        assert arrival == 30 or shown == [images[arrival - 25]] * 10, arrival
    assert history.choose(images[:92], 0.15) == images[55]
    assert history.choose(images, 0.15) == images[99], "nothing has come for much longer than usual"
    history.clear()
    history.add("faces", "f", 1.0, face())
    assert history.choose([1.0, 3.0], 0.15) == 3.0


def test_at_takes_the_nearest_within_tolerance():
    history = FeatureHistory()
    history.add("faces", "f", 1.0, face(100.0))
    history.add("faces", "f", 1.1, face(200.0))
    assert history.at("faces", 1.09, 0.05)["f"][:, 0].mean() > 150.0
    assert history.at("faces", 1.3, 0.05) == {}
    assert history.at("bodies", 1.0, 0.05) == {}


def test_who_left_is_forgotten_and_so_is_the_past():
    history = FeatureHistory(keep=1.0)
    history.add("faces", "f", 1.0, face())
    history.add("bodies", "b", 1.0, body())
    history.keep_only("faces", [])
    assert history.stamps("faces") == set() and history.stamps("bodies") == {1.0}
    history.add("bodies", "b", 2.5, body())
    assert history.stamps("bodies") == {2.5}
    history.add("bodies", "b", 0.5, body())
    assert history.stamps("bodies") == {0.5}
