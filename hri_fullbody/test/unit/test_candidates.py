"""Windows that are tried for a person's box: several where it stands alone, one among others."""

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from hri_fullbody.core.detection.windows import FACE_WINDOW_SIZES, PERSON_BOX_WINDOWS, FaceBox
from hri_fullbody.core.tracking import candidates
from hri_fullbody.core.tracking.candidates import CandidateQueue, RefusedPlaces

BOX = np.array([100.0, 100.0, 200.0, 400.0])
BESIDE = np.array([180.0, 100.0, 280.0, 400.0])
AWAY = np.array([400.0, 100.0, 500.0, 400.0])
FACE = FaceBox("f", np.array([130.0, 100.0, 170.0, 140.0]))


@pytest.fixture(autouse=True)
def sound_by_score(monkeypatch):
    monkeypatch.setattr(candidates, "is_sound", lambda estimate, least: estimate.score >= least)


def estimate(score, box=BOX, extent=310.0, nose=(150.0, 120.0), trunk_seen=True):
    """What the network finds in a window."""
    return SimpleNamespace(score=score, box=box, extent=extent, nose=np.array(nose), trunk_seen=trunk_seen,
                           next_window=lambda: "refined")


def tried(queue, score_of, box=BOX, **properties):
    """Sides of the windows of the first candidate in units of the box's longer side, and what came of it."""
    candidate, sides = queue.take(), []
    while True:
        window = candidate.window(None)
        sides.append(window if window == "refined" else round(window.size / 300.0, 2))
        result = candidate.judge(estimate(score_of(sides), box, **properties), None, 0.5)
        if result.failed or result.found is not None:
            return sides, result.found is not None, candidate


def offered(others, stamp=0.0):
    queue = CandidateQueue()
    queue.offer_boxes([BOX], [], [BOX, *others], stamp)
    return queue


def test_a_box_alone_is_tried_with_windows_of_several_sizes():
    assert tried(offered([AWAY]), lambda sides: 0.1)[:2] == ([1.25, 1.7, 1.46, 1.25], False)
    sides, found, _ = tried(offered([]), lambda sides: 0.95 if 1.7 in sides else 0.1)
    assert sides == [1.25, 1.7, "refined"] and found


def test_a_box_among_others_has_one_window_since_another_may_show_a_neighbour():
    assert tried(offered([BESIDE]), lambda sides: 0.1)[:2] == ([1.25], False)


def test_a_body_out_of_another_window_must_be_sure():
    assert tried(offered([]), lambda sides: 0.7)[1]
    assert not tried(offered([]), lambda sides: 0.1 if sides == [1.25] else 0.7)[1]


@pytest.mark.parametrize("trunk_seen", [True, False])
def test_a_body_out_of_another_window_must_be_that_of_the_box(trunk_seen):
    assert not tried(offered([]), lambda sides: 0.1 if sides == [1.25] else 0.95, BESIDE, trunk_seen=trunk_seen)[1]


@pytest.mark.parametrize("nose", [(90.0, 120.0), (210.0, 120.0), (150.0, 90.0), (150.0, 410.0)])
def test_where_a_box_is_sure_the_nose_may_lie_outside_and_where_it_is_unsure_not(nose):
    assert tried(offered([]), lambda sides: 0.95, nose=nose)[1]
    queue = CandidateQueue()
    queue.offer_boxes([], [], [], 0.0, unsure=[BOX])
    assert not tried(queue, lambda sides: 0.95, nose=nose)[1]


def test_an_unsure_box_that_shows_nobody_rests_also_beside_others():
    queue = CandidateQueue()
    queue.offer_boxes([BESIDE], [], [BESIDE], 0.0, unsure=[BOX])
    assert [(item.unsure, item.alone) for item in (queue.take(), queue.take())] == [(False, True), (True, True)]


def test_a_body_that_is_smaller_than_its_box_is_another_thing():
    assert tried(offered([]), lambda sides: 0.95, extent=270.0)[1]
    assert not tried(offered([]), lambda sides: 0.95, extent=250.0)[1]


def test_a_trunk_that_is_seen_in_a_corner_of_the_box_is_none_of_a_human():
    """As on a walnut, or a hand; of who is near only the head and a shoulder may be seen."""
    corner = np.array([100.0, 100.0, 160.0, 200.0])
    assert not tried(offered([]), lambda sides: 0.95, corner)[1]
    assert tried(offered([]), lambda sides: 0.95, corner, trunk_seen=False)[1]
    assert tried(offered([]), lambda sides: 0.95, corner + [0.0, 0.0, 20.0, 10.0])[1]


def test_a_box_that_the_detector_is_unsure_of_has_one_window_and_must_show_a_sure_body():
    def unsure(others=(), stamp=0.0, queue=None):
        queue = CandidateQueue() if queue is None else queue
        queue.offer_boxes([], [], others, stamp, unsure=[BOX])
        return queue

    assert tried(unsure(), lambda sides: 0.95)[:2] == ([1.25, "refined"], True)
    assert tried(unsure(), lambda sides: 0.85)[:2] == ([1.25], False)
    assert not tried(unsure(), lambda sides: 0.95 if sides == [1.25] else 0.85)[1]
    assert not len(unsure([BOX + 2.0]))           # a part of somebody
    queue = unsure()
    queue.give_up(None, 0.0, tried(queue, lambda sides: 0.1)[2].box)
    assert not len(unsure(stamp=1.0, queue=queue)) and len(unsure(stamp=9.0, queue=queue))


def test_a_figure_too_small_for_its_face_is_none():
    for extent, found in ((230.0, False), (250.0, True)):
        queue = CandidateQueue()
        queue.offer_faces([FACE], 0.0)
        candidate = queue.take()
        candidate.judge(estimate(0.9, extent=extent), FACE, 0.5)
        assert (candidate.judge(estimate(0.9, extent=extent), FACE, 0.5).found is not None) == found


WHERE_THE_NOSE_IS = {"in the face": (150.0, 120.0), "elsewhere": (250.0, 120.0)}


@pytest.mark.parametrize("looks, found", [
    ([("in the face", 0.7), ("in the face", 0.7)], (1, None)),
    ([("in the face", 0.7), ("elsewhere", 0.9)], (0, FACE_WINDOW_SIZES[0])),
    ([("in the face", 0.7), ("in the face", 0.1)], (0, FACE_WINDOW_SIZES[0])),
    ([("elsewhere", 0.9), ("in the face", 0.7), ("in the face", 0.7)], (2, None)),
    ([("in the face", 0.3), ("elsewhere", 0.9), ("in the face", 0.7), ("elsewhere", 0.9)], (2, FACE_WINDOW_SIZES[1]))])
def test_the_body_of_a_face_has_its_nose_in_it_in_whichever_window(looks, found):
    queue = CandidateQueue()
    queue.offer_faces([FACE], 0.0)
    candidate, estimates = queue.take(), [estimate(score, nose=WHERE_THE_NOSE_IS[nose]) for nose, score in looks]
    results = [candidate.judge(one, FACE, 0.5) for one in estimates]
    assert all(result.found is None and not result.failed for result in results[:-1])
    assert results[-1].found is estimates[found[0]] and results[-1].anchor == found[1]


def test_who_is_gone_waits_no_more():
    queue = CandidateQueue()
    queue.offer_faces([FACE], 0.0)
    queue.offer_faces([FACE], 0.1)
    assert len(queue) == 1, "a face waits once"
    queue.offer_boxes([BOX], [], [BOX], 0.2)
    queue.offer_boxes([AWAY], [], [AWAY], 0.3)
    assert len(queue) == 2
    queue.offer_faces([], 0.4)
    assert len(queue) == 1 and queue.take().box is AWAY and queue.take() is None


def test_a_face_without_a_body_rests_twice_as_long_each_time_until_a_body_is_found():
    queue, stamp = CandidateQueue(), 0.0

    def is_tried(at):
        queue.offer_faces([FACE], at)
        return queue.take() is not None

    for pause in (0.5, 1.0, 2.0, 4.0, 8.0, 8.0):
        queue.give_up("f", stamp)
        queue.offer_faces([], stamp)        # one image does not show it
        assert not is_tried(stamp + pause - 0.01) and is_tried(stamp + pause)
        stamp += pause
    queue.give_up("f", stamp)
    queue.found("f")
    assert is_tried(stamp), "its body is lost at once: nothing is held against it"
    queue.give_up("f", stamp)
    assert not is_tried(stamp + 0.49) and is_tried(stamp + 0.5)


def test_after_a_reset_nothing_rests_until_a_time_that_is_far_ahead():
    queue = CandidateQueue()
    queue.give_up("f", 100.0)
    queue.give_up(None, 100.0, BOX)
    queue.clear()                           # time went back
    queue.offer_faces([FACE], 0.0)
    queue.offer_boxes([], [], [], 0.0, unsure=[BOX])
    assert len(queue) == 2


def test_of_faces_that_were_tried_in_vain_and_are_gone_nothing_is_kept():
    queue = CandidateQueue()
    for number in range(1000):
        queue.give_up("f%d" % number, 0.0)
        if number % 2:
            queue.found("f%d" % number)
        queue.offer_faces([], 0.0)
    assert max(len(known) for known in vars(queue).values() if hasattr(known, "__len__")) <= 101


def test_a_box_without_a_body_has_one_window_for_a_while():
    queue = offered([])
    queue.give_up(None, 0.0, tried(queue, lambda sides: 0.1)[2].box)
    for stamp, windows in ((1.0, 1), (9.0, len(PERSON_BOX_WINDOWS))):
        queue.offer_boxes([BOX + 5.0], [], [], stamp)
        assert len(tried(queue, lambda sides: 0.1)[0]) == windows


def test_in_slow_images_a_box_that_shows_nobody_lets_the_others_go_first():
    """With one inference between two calls of the detector the first box would be tried for ever."""
    queue, looked_at = CandidateQueue(), []
    for stamp in np.arange(8.0):
        queue.offer_boxes([BOX, AWAY], [], [BOX, AWAY], stamp)
        candidate = queue.take()
        looked_at.append(candidate.box is AWAY)
        if candidate.judge(estimate(0.1), None, 0.5).failed:
            queue.give_up(None, stamp, candidate.box if candidate.alone else None)
        else:
            queue.put_back(candidate)
    assert any(looked_at)


@pytest.mark.parametrize("score, attempt", [(0.1, 1), (0.7, 0)])
def test_what_has_begun_goes_on_when_the_detector_finds_the_box_again(score, attempt):
    queue = offered([])
    candidate = queue.take()
    candidate.judge(estimate(score), None, 0.5)
    queue.put_back(candidate)
    queue.offer_boxes([AWAY, BOX + 5.0], [], [], 1.0)
    waiting = [queue.take(), queue.take()]
    begun = next(item for item in waiting if item.box is not AWAY)
    assert begun.attempt == attempt
    assert waiting[0] is begun or begun.first is None, "what was seen already is finished first"


def test_what_waits_for_a_second_look_is_not_new_when_the_detector_finds_the_box_again():
    """Else a thing beside people would be looked at again each time, and never rest."""
    queue = offered([])
    queue.put_last(replace(queue.take(), looked=True))
    queue.offer_boxes([BOX + 5.0, AWAY], [], [], 1.0)
    waiting = {item.box[0]: item.looked for item in (queue.take(), queue.take())}
    assert waiting == {105.0: True, 400.0: False}


@pytest.mark.parametrize("face, expected", [
    pytest.param((130, 110, 170, 160), True, id="of somebody who stands"),
    pytest.param((110, 190, 190, 300), True, id="of somebody near, cut by the rim, with hair above it"),
    pytest.param((105, 150, 145, 200), True, id="of somebody who leans"),
    pytest.param((110, 260, 190, 340), False, id="of a child before somebody"),
    pytest.param((210, 110, 250, 160), False, id="beside it"),
    pytest.param((50, 110, 90, 160), False, id="beside it on the left"),
    pytest.param((130, 40, 170, 90), False, id="above it"),
    pytest.param((130, 410, 170, 460), False, id="below it"),
    pytest.param((170, 190, 199, 300), False, id="of a neighbour")])
def test_a_face_is_that_of_the_box_where_the_head_of_the_box_is(face, expected):
    queue = CandidateQueue()
    queue.offer_boxes([BOX], [FaceBox("abcde", np.array(face, float))], [BOX], 0.0)
    assert (len(queue) == 0) == expected


@pytest.mark.parametrize("other, in_group", [
    ([0.0, 0.0, 0.0, 0.0], False), ([290.0, 0.0, 290.0, 0.0], True), ([310.0, 0.0, 310.0, 0.0], False),
    ([110.0, 0.0, 110.0, -160.0], False), ([20.0, 0.0, 20.0, 0.0], False)],
    ids=["itself", "beside", "apart", "small", "a part"])
@pytest.mark.parametrize("faint", [True, False])
def test_a_box_is_in_a_group_when_another_of_its_size_is_beside_it_be_it_faint(other, in_group, faint):
    queue, beside = CandidateQueue(), BOX + np.array(other)
    queue.offer_boxes([BOX], [], [BOX] if faint else [BOX, beside], 0.0, unsure=[BOX, beside] if faint else [BOX])
    assert queue.take().in_group is in_group


ROOM = np.random.RandomState(0).randint(60, 200, (480, 640, 3)).astype(np.uint8)
SHIRT = np.clip(128.0 + 10.0 * (cv2.GaussianBlur(ROOM, (0, 0), 6.0).astype(float) - 130.0), 0, 255).astype(np.uint8)


def with_arm(image, by):
    moved = image.copy()
    moved[200 + by:230 + by, 110:190] = 30
    return moved


@pytest.mark.parametrize("now, stays", [
    (SHIRT, True),
    (np.clip(SHIRT + np.random.RandomState(2).normal(0.0, 3.0, SHIRT.shape), 0, 255).astype(np.uint8), True),
    ((0.9 * SHIRT + 8.0).astype(np.uint8), True),
    (np.hstack([SHIRT[:, :250], ROOM[:, 250:]]), True),
    (with_arm(SHIRT, 0), False),
    (np.roll(SHIRT, 6, axis=1), False),
    (np.roll(SHIRT, 6, axis=0), False),
    (SHIRT[:300, :150], False),
], ids=["same", "noise", "light", "beside it", "arm", "to the side", "down", "another image size"])
def test_a_refused_place_stays_refused_while_nothing_changes_in_it(now, stays):
    places = RefusedPlaces()
    places.add(SHIRT, BOX)
    assert places.contain(now, BOX) is stays
    assert len(places) == stays


def test_an_arm_that_sinks_by_two_px_in_a_box_of_300_px_is_a_change():
    places = RefusedPlaces()
    places.add(with_arm(SHIRT, 0), BOX)
    assert not places.contain(with_arm(SHIRT, 2), BOX)


@pytest.mark.parametrize("box, stays", [
    (BOX + 4.0, True), (BOX + [0.0, 0.0, 0.0, -120.0], False), (BOX + [30.0, 0.0, 30.0, 0.0], False)],
    ids=["jitter", "smaller", "moved"])
def test_a_box_of_another_size_or_place_is_not_refused(box, stays):
    places = RefusedPlaces()
    places.add(SHIRT, BOX)
    assert places.contain(SHIRT, box) is stays


def test_of_too_many_refused_places_the_oldest_go_and_one_is_kept_once():
    places = RefusedPlaces()
    boxes = [np.array([20.0 * index, 10.0, 20.0 * index + 18.0, 60.0]) for index in range(30)]
    for box in [*boxes, boxes[-1]]:
        places.add(SHIRT, box)
    assert len(places) == 20
    assert [places.contain(SHIRT, box) for box in (boxes[0], boxes[9], boxes[10], boxes[29])] == [
        False, False, True, True]
    places.clear()
    assert not places.contain(SHIRT, boxes[29])
