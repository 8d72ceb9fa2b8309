"""Face tracks: births, deaths, crossings and duplicates, with faces made of numbers; optical flow in pictures made of
noise."""

import dataclasses

import cv2
import numpy as np
import pytest

from hri_pipeline.core.faces import flow as flow_module
from hri_pipeline.core.faces.flow import FaceFlow
from hri_pipeline.core.faces.mesh import MESH_POINTS, FaceRoi
from hri_pipeline.core.faces.track import CropAnchor, FaceMeasurement, face_colours
from hri_pipeline.core.faces.tracker import (
    COAST_TIME,
    SCORE_MARGIN,
    SPARE_TRACKS,
    FaceTracker,
    explains,
    is_same_or_part,
    same_face,
    without_duplicates,
)
from hri_pipeline.core.ids import IdGenerator
from hri_pipeline.core.image_rotation import ImageRotation
from hri_pipeline.core.picture_jumps import Jump

STEP = 1.0 / 15.0
VIEW = (1280, 720)
RED, BLUE = np.full((5, 4, 3), 0.2), np.full((5, 4, 3), 0.5)
BOXES = [np.array([100.0, 80.0, 180.0, 170.0]), np.array([300.0, 200.0, 340.0, 250.0])]
STILL = [np.zeros(2)] * 2


def face(x, y=200.0, size=100.0, detection=True, presence=0.99):
    """A measurement of a square face about x, y px."""
    corners = np.random.RandomState(0).uniform(-0.5, 0.5, (MESH_POINTS, 3))
    corners[:2, :2] = (-0.5, -0.5), (0.5, 0.5)
    return FaceMeasurement(corners * size + (x, y, 0.0), presence, detection)


def tracker(birth=0.0, death=1.0, most=10):
    return FaceTracker(birth, death, most, IdGenerator(seed=1))


def run(faces, *frames):
    """Feed frames of measurements, STEP apart; returns [{id: centre x} of the faces seen] per frame."""
    return [{track.id: track.measurement.box[[0, 2]].mean() for track in faces.update(frame, index * STEP)}
            for index, frame in enumerate(frames)]


def test_a_face_is_looked_for_at_its_place_for_a_moment_after_it_was_lost():
    faces = tracker()
    faces.update([face(100.0)], 0.0)
    faces.update([], STEP)
    assert [track.id for track in faces.expected(COAST_TIME - 0.01)] == faces.ids
    assert faces.expected(COAST_TIME + 0.01) == []


def test_nobody_is_looked_for_where_the_picture_before_a_cut_showed_a_face():
    faces = tracker()
    faces.update([face(100.0)], 0.0)
    faces.update([], STEP, cut=True)
    assert len(faces.ids) == 1 and faces.expected(2 * STEP) == []
    faces.update([], 2 * STEP)
    assert len(faces.ids) == 1 and faces.expected(3 * STEP) == []


@pytest.mark.parametrize("above, conflicts", [(-0.01, False), (0.01, True)])
def test_a_smaller_face_inside_lowers_the_score_of_a_track_unless_it_is_much_less_sure(above, conflicts):
    faces = tracker()
    faces.update([dataclasses.replace(face(100.0, size=300.0), score=0.8)], 0.0)
    track, = faces.tracks
    assert faces.add_detections([face(100.0, size=100.0).box], STEP, scores=[0.8 - SCORE_MARGIN + above]) == []
    assert (track.score < 0.8) == conflicts


def test_a_still_face_keeps_its_id_for_ever():
    faces = tracker()
    seen = run(faces, *[[face(100.0)]] * 2000)
    assert {tuple(frame) for frame in seen} == {tuple(faces.ids)}


def test_birth_takes_the_birth_delay_whatever_the_rate():
    for rate in (5.0, 60.0):
        faces = tracker(birth=0.4)
        stamps = np.arange(0.0, 1.0, 1.0 / rate)
        known = []
        for stamp in stamps:
            faces.update([face(100.0)], stamp)
            known.append(bool(faces.ids))
        assert 0.4 <= stamps[known.index(True)] <= 0.4 + 1.0 / rate + 1e-6


def test_a_candidate_that_flickers_is_never_born():
    faces = tracker(birth=0.2)
    run(faces, *[[face(100.0)], []] * 20)
    assert faces.ids == []


def test_death_takes_the_death_time_and_the_id_never_comes_again():
    faces = tracker(death=0.5)
    faces.update([face(100.0)], 0.0)
    first, = faces.ids
    for stamp in np.arange(0.1, 0.55, 0.1):
        assert faces.update([], stamp) == []
        assert faces.ids == [first]
    faces.update([], 0.6)
    assert faces.ids == []
    faces.update([face(100.0)], 0.7)
    assert len(faces.ids) == 1 and faces.ids != [first]


def test_a_short_occlusion_is_bridged():
    faces = tracker()
    seen = run(faces, *([[face(100.0)]] * 5 + [[]] * 10 + [[face(110.0)]] * 3))
    assert seen[4].keys() == seen[-1].keys()
    assert seen[8] == {}


@pytest.mark.parametrize("gap", [1.5, 60.0])
def test_a_gap_between_images_longer_than_the_death_time_ends_the_track(gap):
    faces = tracker(death=1.0)
    faces.update([face(100.0)], 0.0)
    first = faces.ids
    assert faces.expected(gap) == []
    faces.update([face(100.0)], gap)
    assert faces.ids != first


def test_images_that_come_more_slowly_than_the_death_time_keep_the_ids():
    """A busy machine, or a low max_rate: every image is looked at, so nobody was away."""
    faces = tracker(birth=0.1, death=1.0)
    ids = []
    for stamp in np.cumsum([0.0, 1.8, 2.2, 1.5, 0.4, 1.9, 2.5]):
        faces.expected(stamp)
        faces.update([face(100.0)], stamp)
        ids += faces.ids
    assert len(ids) >= 4 and len(set(ids)) == 1


def test_a_slow_phase_does_not_make_the_later_deaths_late():
    faces = tracker(death=0.5)
    for stamp in (0.0, 2.0, 4.0):
        faces.update([face(100.0)], stamp)
    for stamp in 4.0 + np.arange(1, 61) / 20.0:
        faces.update([face(100.0)], stamp)
    for stamp in 7.0 + np.arange(1, 13) / 20.0:
        faces.update([], stamp)
    assert faces.ids == []


def test_only_a_detection_starts_a_track():
    faces = tracker()
    run(faces, [face(100.0, detection=False)])
    assert faces.ids == []


def test_no_more_than_max_faces():
    faces = tracker(most=3)
    run(faces, *[[face(150.0 * index) for index in range(6)]] * 3)
    assert len(faces.ids) == 3


def test_the_largest_candidates_wait_and_few_of_them():
    faces = tracker(birth=0.5, most=2)
    faces.update([face(150.0 * number, size=100.0 + number) for number in range(10)], 0.0)
    assert sorted(track.measurement.box[[0, 2]].mean() for track in faces.tracks) == [
        pytest.approx(150.0 * number) for number in range(10 - 2 - SPARE_TRACKS, 10)]


@pytest.mark.parametrize("larger, waits", [(1.2, False), (1.4, True)])
def test_who_would_not_take_the_place_of_anybody_known_does_not_wait_for_one(larger, waits):
    faces = tracker(birth=0.3, most=1)
    run(faces, *[[face(100.0)]] * 10)
    assert faces.has_room_for(face(500.0, size=100.0 * larger).box, None) is waits
    faces.update([face(100.0), face(500.0, size=100.0 * larger)], 10 * STEP)
    assert len(faces.ids) == 1 and len(faces.tracks) == 1 + waits


def test_duplicates_are_one_face_and_neighbours_are_two():
    kept = without_duplicates([face(100.0), face(110.0, size=130.0, presence=0.5), face(180.0)])
    assert [measurement.box[[0, 2]].mean() for measurement in kept] == [100.0, 180.0]


def test_the_surer_duplicate_wins_and_the_tracked_one_of_equals():
    tracked, fresh = face(100.0, detection=False), face(101.0, presence=1.0)
    assert without_duplicates([fresh, tracked]) == [tracked]
    unsure = face(100.0, detection=False, presence=0.4)
    assert without_duplicates([unsure, fresh]) == [fresh]


def part_and_whole(part_score, whole_score):
    """A tracked mouth and the whole face about it, as the detector finds it."""
    mouth = FaceMeasurement(face(100.0, 230.0, 40.0).mesh, 0.958, False, score=part_score)
    whole = FaceMeasurement(face(100.0, 200.0, 120.0).mesh, 1.0, True, score=whole_score)
    return mouth, whole


def test_a_whole_face_beats_a_part_of_it_unless_the_detector_is_surer_of_the_part():
    mouth, whole = part_and_whole(0.43, 0.87)
    assert without_duplicates([mouth, whole]) == [whole] == without_duplicates([whole, mouth])
    child, blanket = part_and_whole(0.9, 0.45)
    assert without_duplicates([child, blanket]) == [child]
    low = FaceMeasurement(face(100.0, 235.0, 40.0).mesh, 0.97, True, score=0.43)
    high = FaceMeasurement(face(100.0, 185.0, 150.0).mesh, 0.99, False, score=0.87)
    assert without_duplicates([low, high]) == [high], "centres far apart, one in the other"


@pytest.mark.parametrize("whole, part, kept", [((0.7, 0.95), (0.7, 0.95), 300.0), ((0.65, 0.95), (0.7, 0.95), 300.0),
                                               ((0.55, 0.95), (0.7, 0.95), 100.0), ((0.7, 0.8), (0.7, 0.95), 100.0)])
def test_of_a_face_and_a_part_of_it_one_is_kept_by_score_and_presence(whole, part, kept):
    both = [dataclasses.replace(face(200.0, size=size), score=score, presence=presence)
            for size, (score, presence) in ((300.0, whole), (100.0, part))]
    for order in (both, both[::-1]):
        assert [one.place[1] for one in without_duplicates(order)] == [pytest.approx(kept)]


def test_a_track_that_held_on_to_a_mouth_goes_on_with_the_whole_face():
    mouth, whole = part_and_whole(0.43, 0.87)
    start = FaceMeasurement(mouth.mesh, mouth.presence, True, score=0.43)
    faces = tracker()
    faces.update([start], 0.0)
    faces.update([mouth], 0.1)
    first = faces.ids
    assert faces.add_detections([whole.box], 0.2, [1.0], [0.87]) == [], "the whole face does not speak for the mouth"
    track, = faces.update([mouth, whole], 0.2)
    assert [track.id] == first and track.measurement is whole


def test_a_part_of_a_known_face_explains_nothing_and_is_explained():
    mouth, whole = part_and_whole(0.43, 0.87)
    assert not explains(mouth.box, 0.43, whole.box, 0.87) and explains(whole.box, 0.87, mouth.box, 0.43)
    assert explains(mouth.box, 0.9, whole.box, 0.5) and not explains(whole.box, 0.5, mouth.box, 0.9)
    assert explains(whole.box, 0.5, whole.box + 5.0, 0.9)


def test_a_smaller_face_beside_a_large_one_is_another():
    near, far = face(200.0, size=200.0), face(340.0, size=60.0)
    assert len(without_duplicates([near, far])) == 2


def test_the_large_and_central_faces_are_kept_not_the_first():
    faces = tracker(birth=0.1, most=3)
    crowd = [face(60.0 + 110.0 * place, 80.0, 40.0) for place in range(10)]
    for step in range(5):
        faces.update(crowd, 0.1 * step, view=VIEW)
    small = faces.ids
    assert len(small) == 3
    newcomers = [face(400.0, 400.0, 160.0), face(880.0, 400.0, 160.0)]
    for step in range(5, 12):
        seen = faces.update(crowd + newcomers, 0.1 * step, view=VIEW)
        assert len(faces.ids) == 3
    sizes = sorted(track.measurement.box[2] - track.measurement.box[0] for track in seen if track.id in faces.ids)
    assert sizes == pytest.approx([40.0, 160.0, 160.0])
    assert len(set(small) & set(faces.ids)) == 1, "the one that stays keeps its id"


def test_equal_faces_keep_the_middle_of_the_image():
    faces = tracker(most=2)
    faces.update([face(x, 360.0) for x in (60.0, 300.0, 560.0, 720.0, 1200.0)], 0.0, view=VIEW)
    assert sorted(track.measurement.box[[0, 2]].mean() for track in faces.tracks) == pytest.approx([560.0, 720.0])


def test_faces_about_as_large_do_not_take_turns():
    faces = tracker(most=2)
    random, known = np.random.RandomState(5), set()
    for step in range(100):
        crowd = [face(200.0 * place + 150.0, size=100.0 * random.uniform(0.92, 1.08)) for place in range(5)]
        faces.update(crowd, 0.1 * step, view=VIEW)
        known.update(faces.ids)
    assert len(known) == 2


def test_a_waiting_pattern_takes_nobody_s_place():
    faces = tracker(birth=0.1, most=1)
    pattern = FaceMeasurement(face(700.0, 360.0, 300.0).mesh, 1.0, True, verification=-1.0)
    for step in range(20):
        faces.update([face(200.0, 360.0), pattern], 0.1 * step, view=VIEW)
    only, = [track for track in faces.tracks if track.id in faces.ids]
    assert only.measurement.box[[0, 2]].mean() == pytest.approx(200.0)


def test_nothing_but_presence_is_no_face_until_something_else_speaks_for_it():
    faces = tracker(birth=0.1)
    doubtful = FaceMeasurement(face(100.0).mesh, 1.0, True, score=0.55, verification=-1.0)
    for step in range(30):
        faces.update([doubtful if step == 0 else face(100.0, detection=False)], 0.1 * step)
        faces.add_detections([face(101.0).box], 0.1 * step, [0.8], [0.55])
        assert faces.ids == []
    for answer, published in ((1.0, 0), (-1.0, 0), (1.0, 0), (1.0, 1)):
        faces.tracks[0].add_verification(answer)
        assert len(faces.ids) == published


def test_same_face_by_overlap_and_by_distance():
    box = np.array([0.0, 0.0, 100.0, 100.0])
    assert same_face(box, box + 10.0)
    assert same_face(box, np.array([30.0, 30.0, 70.0, 70.0]))
    assert not same_face(box, box + (90.0, 0.0, 90.0, 0.0))
    tall = np.array([0.0, 0.0, 50.0, 150.0])
    assert same_face(tall, tall + (0.0, 50.0, 0.0, 50.0)), "half of it is the same, although the centres are apart"
    assert not same_face(tall, tall + (0.0, 70.0, 0.0, 70.0))


def test_a_chin_far_from_the_middle_of_its_face_is_a_part_of_it():
    whole, chin = np.array([0.0, 0.0, 100.0, 100.0]), np.array([30.0, 70.0, 70.0, 110.0])
    assert is_same_or_part(whole, chin) and is_same_or_part(chin, whole) and not same_face(whole, chin)


@pytest.mark.parametrize("lost, away, is_same", [(0, 60.0, True), (0, 80.0, False), (1, 140.0, True),
                                                 (1, 160.0, False)])
def test_a_face_goes_on_where_it_is_expected_and_a_lost_one_in_a_wider_place(lost, away, is_same):
    faces = tracker()
    seen = run(faces, *[[face(200.0)]] * 3, *[[]] * lost, [face(200.0 + away)])
    assert (seen[-1].keys() == seen[0].keys()) is is_same


def crossing(speed, hidden_below):
    """Two faces that walk past each other; while they overlap only one is measured."""
    for index in range(80):
        left, right = 100.0 + speed * index, 100.0 + speed * 79 - speed * index
        frame = [face(left, size=110.0)]
        if abs(left - right) > hidden_below:
            frame.append(face(right, size=90.0))
        yield frame


@pytest.mark.parametrize("speed", [5.0, 8.0, 12.0])
def test_faces_that_cross_keep_their_ids(speed):
    faces = tracker(birth=0.1)
    seen = run(faces, *crossing(speed, hidden_below=60.0))
    before, after = seen[5], seen[-1]
    assert before.keys() == after.keys() and len(before) == 2
    left = min(before, key=before.get)
    assert max(after, key=after.get) == left


def test_ids_do_not_depend_on_the_order_of_measurements():
    faces = tracker()
    random = np.random.RandomState(3)
    frames = []
    for index in range(100):
        frame = [face(120.0 * place + 3.0 * index, 200.0 + 20.0 * np.sin(index / 5.0)) for place in range(5)]
        random.shuffle(frame)
        frames.append(frame)
    seen = run(faces, *frames)
    assert len(seen[0]) == 5
    assert all(sorted(frame, key=frame.get) == sorted(seen[0], key=seen[0].get) for frame in seen)


def test_a_moving_face_is_expected_where_it_goes():
    faces = tracker()
    run(faces, *[[face(100.0 + 10.0 * index)] for index in range(30)])
    track, = faces.expected(30 * STEP)
    assert track.predicted_box(30 * STEP)[[0, 2]].mean() == pytest.approx(400.0, abs=2.0)


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_a_face_is_expected_where_it_goes_in_an_image_that_is_turned_from_now_on(quarters):
    faces, turn = tracker(), ImageRotation(quarters, *VIEW)
    run(faces, *[[face(100.0 + 10.0 * index)] for index in range(30)])
    track, = faces.expected(30 * STEP)
    before = track.predicted_box(30 * STEP)
    track.turn(turn)
    assert track.predicted_box(30 * STEP) == pytest.approx(turn.box(before), abs=1e-6)
    measured = face(400.0)
    faces.update([dataclasses.replace(measured, mesh=turn.pixels(measured.mesh))], 30 * STEP, view=VIEW[::-1])
    assert [one.id for one in faces.tracks] == [track.id] and track.visible


def test_a_face_is_expected_where_it_is_after_a_zoom_and_goes_on():
    faces, jump = tracker(), Jump(2.0, np.array([-640.0, -360.0]))
    run(faces, *[[face(500.0), face(800.0)] for _ in range(30)])
    for track in faces.tracks:
        before = track.predicted_box(30 * STEP)
        track.jump(jump)
        assert track.predicted_box(30 * STEP) == pytest.approx(jump.pixels(before.reshape(2, 2)).ravel(), abs=1e-6)
        assert track.size == pytest.approx(200.0, rel=0.01)
    names = [track.id for track in faces.tracks]
    # Without the jump the second face is about where the first one was.
    seen = faces.update([face(960.0, 40.0, 200.0), face(360.0, 40.0, 200.0)], 30 * STEP, view=VIEW)
    assert [track.id for track in seen] == names and seen[0].measurement.box[0] < seen[1].measurement.box[0]


def test_the_crop_of_a_face_grows_with_a_zoom():
    detected, first = FaceRoi(np.array([200.0, 300.0]), 100.0, 0.1), FaceRoi(np.array([200.0, 300.0]), 120.0, 0.3)
    anchor = CropAnchor(detected, first)
    anchor.jump(Jump(2.0, np.zeros(2)))
    assert anchor.hold(FaceRoi(np.array([400.0, 600.0]), 100.0, 0.3), 1.0).size == pytest.approx(
        2.0 * CropAnchor(detected, first).hold(FaceRoi(np.array([200.0, 300.0]), 50.0, 0.3), 1.0).size)


def test_the_crop_of_a_face_turns_with_the_images():
    detected, first = FaceRoi(np.array([200.0, 300.0]), 100.0, 0.1), FaceRoi(np.array([200.0, 300.0]), 120.0, 0.3)
    anchor, other = CropAnchor(detected, first), CropAnchor(detected, first)
    anchor.turn(ImageRotation(1, *VIEW))
    quarter = 0.5 * np.pi
    # Of a profile the angle is held near the last detection.
    wanted = other.hold(FaceRoi(np.array([200.0, 300.0]), 80.0, 1.0), 0.3)
    held = anchor.hold(FaceRoi(np.array([419.0, 200.0]), 80.0, 1.0 + quarter), 0.3)
    assert held.size == wanted.size and held.angle == pytest.approx(wanted.angle + quarter)


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_flow_goes_on_in_an_image_that_is_turned_from_now_on(quarters):
    random = np.random.default_rng(7)
    wide = cv2.GaussianBlur(random.integers(0, 255, (400, 520, 3)).astype(np.uint8), (0, 0), 3.0)
    first, second = wide[10:370, 10:490], wide[4:364, 2:482]
    turn, flow = ImageRotation(quarters, 480, 360), FaceFlow()
    flow.update(first, BOXES, STILL)
    flow.turn(turn)
    found = flow.update(turn.image(np.ascontiguousarray(second)), [turn.box(box) for box in BOXES], STILL)
    for motion in found:
        assert turn.matrix[:2, :2].T @ motion == pytest.approx([8.0, 6.0], abs=0.5)


def test_reset_drops_everybody_and_no_id_comes_again():
    faces = tracker()
    run(faces, [face(100.0)])
    first = faces.ids
    faces.reset()
    assert faces.tracks == []
    run(faces, [face(100.0)])
    assert faces.ids != first


def test_a_reset_forgets_how_slow_the_images_were():
    faces = tracker(death=0.5)
    for stamp in range(5):
        faces.update([face(100.0)], 2.0 * stamp)
    faces.reset()
    run(faces, [face(100.0)], *[[]] * 10)
    assert faces.ids == []


@pytest.mark.parametrize("arguments", [(-1.0, 1.0, 5), (0.1, 0.0, 5), (0.1, float("nan"), 5), (0.1, 1.0, 0)])
def test_constructor_refuses_nonsense(arguments):
    with pytest.raises(ValueError):
        FaceTracker(*arguments)


def test_a_pattern_detected_once_never_becomes_a_face():
    faces = FaceTracker(0.1, 1.0, 10, min_detections=2, support_time=2.0)
    for step in range(20):
        faces.update([face(100.0, detection=step == 0)], 0.1 * step)
        assert faces.ids == []
    faces.update([face(100.0, detection=False)], 2.1)
    assert faces.tracks == []


def test_a_face_lives_as_long_as_it_is_detected_now_and_then():
    faces = FaceTracker(0.1, 1.0, 10, min_detections=2, support_time=2.0)
    ids = set()
    for step in range(100):
        stamp = 0.1 * step
        if step % 15 == 1:
            faces.add_detections([face(102.0).box, face(900.0).box], stamp)
        faces.update([face(100.0, detection=step == 0)], stamp)
        ids.update(faces.ids)
        assert len(faces.ids) == (1 if step >= 1 else 0)
    assert len(ids) == 1


def test_a_face_that_is_detected_in_each_image_lives_however_short_the_support_time():
    faces = FaceTracker(0.0, 1.0, 10, support_time=0.1)
    for stamp in (0.0, 0.2, 0.4):
        faces.add_detections([face(100.0).box], stamp)
        faces.update([face(100.0, detection=stamp == 0.0)], stamp)
        assert len(faces.ids) == 1


def test_of_slow_images_the_detector_sees_a_face_in_few():
    """It takes the parts of the image in turn, one each second; what it never sees again ends all the same."""
    faces = FaceTracker(0.1, 1.0, 10, min_detections=1, support_time=4.0)
    for stamp in range(60):
        if stamp % 7 == 0:
            faces.add_detections([face(100.0).box], float(stamp))
        faces.update([face(100.0), face(400.0)] if stamp == 0 else
                     [face(100.0, detection=False), face(400.0, detection=False)], float(stamp))
        assert stamp > 12 or len(faces.ids) == (2 if stamp else 0)
    assert [track.measurement.box[[0, 2]].mean() for track in faces.tracks] == [100.0]


@pytest.mark.parametrize("wrong", [dict(min_detections=0), dict(support_time=0.0), dict(support_time=-1.0)])
def test_illegal_support(wrong):
    with pytest.raises(ValueError):
        FaceTracker(0.1, 1.0, 10, **wrong)


def test_what_the_detector_is_not_sure_of_needs_more_of_it():
    faces = FaceTracker(0.1, 1.0, 10, min_detections=2, support_time=2.0)
    doubtful = face(100.0)
    pattern = FaceMeasurement(doubtful.mesh, doubtful.presence, True, hit_weight=0.5)
    counts = []
    for step in range(40):
        stamp = 0.1 * step
        if step % 5 == 4:
            faces.add_detections([face(102.0).box, face(101.0).box], stamp, [0.25, 0.5])
        faces.update([pattern if step == 0 else face(100.0, detection=False)], stamp)
        counts.append(len(faces.ids))
    assert counts.index(1) == 14, "half of a detection four times"


def test_where_one_detection_is_enough_an_unsure_one_is():
    faces = FaceTracker(0.0, 1.0, 10, min_detections=1)
    faces.update([dataclasses.replace(face(100.0), hit_weight=0.25)], 0.0)
    assert len(faces.ids) == 1


def panned(stamp):
    """x of the picture (px): a camera that swings by 60 px each way in 3 s."""
    return 400.0 + 60.0 * np.sin(2.0 * np.pi * stamp / 3.0)


@pytest.mark.parametrize("followed", [True, False])
def test_a_swinging_camera_and_a_look_in_each_fourth_image(followed):
    """With a constant velocity the face is expected up to its own size away, and becomes another one."""
    faces = tracker()
    rate, farthest = 8.0, 0.0
    faces.update([face(panned(0.0))], 0.0)
    for index in range(1, 60):
        stamp = index / rate
        for track in faces.tracks:
            track.move(np.array([panned(stamp) - panned(stamp - 1.0 / rate), 0.0]) if followed else None, stamp)
        expected = faces.tracks[0].predicted_box(stamp)[[0, 2]].mean()
        farthest = max(farthest, abs(expected - panned(stamp)))
        if index % 4 == 0:
            faces.update([face(panned(stamp))], stamp)
        else:
            faces.update([], stamp, skipped=faces.ids)
    assert (farthest < 1e-6) if followed else (farthest > 30.0)


def test_a_face_whose_motion_is_not_seen_goes_on_as_it_went():
    faces = tracker()
    faces.update([face(100.0)], 0.0)
    track, = faces.tracks
    for index in range(1, 11):
        track.move(np.array([3.0, 1.0]), 0.1 * index)
    track.move(None, 1.2)
    assert track.predicted_box(1.2)[[0, 2]].mean() == pytest.approx(136.0, abs=0.5)
    assert track.predicted_box(1.3)[[0, 2]].mean() == pytest.approx(139.0, abs=0.5)
    track.move(np.array([50.0, 0.0]), 1.2)
    assert track.predicted_box(1.2)[[0, 2]].mean() == pytest.approx(136.0, abs=0.5), "the same image twice"


def coloured(x, colours):
    plain = face(x)
    return FaceMeasurement(plain.mesh, plain.presence, plain.may_start, colours)


def test_faces_that_turn_back_where_they_meet_are_told_apart_by_their_colours():
    """Motion alone takes them for people who walk on: only what they look like says that they turned back."""
    faces = tracker()
    frames = []
    for step in range(30):
        away = abs(step - 15) * 9.0
        left, right = coloured(300.0 - away, RED), coloured(315.0 + away, BLUE)
        frames.append([left, right] if abs(step - 15) > 2 else [left])
    seen = run(faces, *frames)
    assert len(set(faces.ids)) == 2
    before, after = seen[5], seen[-1]
    assert before.keys() == after.keys()
    assert min(before, key=before.get) == min(after, key=after.get)


def test_a_skipped_face_stays_where_it_was_going_and_is_not_lost():
    faces = tracker()
    for index in range(10):
        faces.update([face(100.0 + 3.0 * index), face(400.0)], index * STEP)
    moving, still = faces.ids
    seen = faces.update([face(400.0)], 10 * STEP, skipped=[moving])
    assert {track.id for track in seen} == {moving, still}
    track = [track for track in seen if track.id == moving][0]
    box = track.predicted_box(10 * STEP)
    assert box[[0, 2]].mean() == pytest.approx(face(130.0).box[[0, 2]].mean(), abs=1.5)
    assert [track.id for track in faces.update([face(400.0)], 11 * STEP)] == [still], "looked for and not found"


def test_a_skipped_face_dies_when_it_is_never_looked_at():
    faces = tracker(death=0.5)
    faces.update([face(100.0)], 0.0)
    only = faces.ids
    for index in range(1, 12):
        faces.update([], 0.1 * index, skipped=only)
    assert faces.ids == []


def test_a_face_that_waits_for_its_turn_outlives_slow_images():
    """Seen when it was looked for, then another's turn twice, then a slow image: nobody was away."""
    faces = tracker(death=1.0)
    for stamp in (0.0, 0.2):
        faces.update([face(100.0)], stamp)
    only = faces.ids
    for stamp in (0.4, 0.7):
        faces.update([], stamp, skipped=only)
    assert [track.id for track in faces.expected(1.3)] == only
    faces.update([face(100.0)], 1.3)
    assert faces.ids == only


FRONTAL, PROFILE = 0.52, 0.35
"""Share of the eyes of a face seen from the front, and from the side."""


def crop(size, degrees):
    return FaceRoi(np.array([300.0, 200.0]), size, np.radians(degrees))


@pytest.mark.parametrize("asked, share, held", [
    (crop(100.0, 5.0), FRONTAL, crop(100.0, 5.0)),    # where the detector has it: as it is
    (crop(80.0, 5.0), FRONTAL, crop(97.0, 5.0)),    # shrunk
    (crop(60.0, 5.0), FRONTAL, crop(81.0, 5.0)),    # a detection of something larger adds 35 % at most
    (crop(150.0, 5.0), FRONTAL, crop(150.0, 5.0)),    # somebody who comes near
    (crop(100.0, 40.0), FRONTAL, crop(100.0, 40.0)),    # a head that tilts
    (crop(100.0, 40.0), PROFILE, crop(100.0, 8.0)),
    (crop(100.0, -179.0), PROFILE, crop(100.0, -8.0)),
], ids=["held", "shrunk", "far_smaller", "nearer", "tilted", "profile_turned", "profile_turned_over"])
def test_a_crop_is_held_by_the_detection(asked, share, held):
    anchor = CropAnchor(crop(200.0, 20.0), crop(100.0, 0.0))
    roi = anchor.hold(asked, share)
    assert roi.size == pytest.approx(held.size)
    assert roi.angle == pytest.approx(held.angle, abs=1e-9)
    assert roi.centre is asked.centre


def test_an_anchor_follows_the_detections_of_its_face():
    anchor = CropAnchor(crop(200.0, 20.0), crop(100.0, 0.0))
    for _ in range(20):
        anchor.see(crop(100.0, -150.0))
    assert anchor.hold(crop(48.0, -100.0), PROFILE).size == pytest.approx(48.5, rel=1e-3)
    assert anchor.hold(crop(48.0, -100.0), PROFILE).angle == pytest.approx(np.radians(-162.0), rel=1e-3)


def test_a_detection_of_a_known_face_is_told_and_holds_its_crop():
    faces, small, large = tracker(), crop(150.0, 0.0), crop(600.0, 0.0)
    faces.update([dataclasses.replace(face(100.0), crops=(small, small))], 0.0)
    track, = faces.tracks
    before = track.roi(STEP).size
    assert faces.add_detections([face(600.0).box, face(100.0).box], STEP, crops=[small, large]) == [track]
    assert track.roi(STEP).size > before


def test_an_old_detection_holds_no_crop():
    tracked = tracker()
    small = dataclasses.replace(face(300.0), crops=(crop(400.0, 0.0), crop(250.0, 0.0)))
    tracked.update([small], 1.0)
    track = tracked.tracks[0]
    free = tracked.tracks[0].roi(9.0).size
    assert track.roi(1.0).size == pytest.approx(min(0.97 * 250.0, 1.35 * free)) and track.roi(1.0).size > free


def test_colours_of_a_face():
    image = np.zeros((100, 200, 3), np.uint8)
    image[:, 100:] = 255
    assert face_colours(image, np.array([50.0, 0.0, 150.0, 100.0])).shape == (5, 4, 3)
    assert face_colours(image, np.array([110.0, 10.0, 190.0, 90.0])) == pytest.approx(1.0)
    assert face_colours(image, np.array([-500.0, 0.0, -300.0, 50.0])) is None
    assert face_colours(image, np.array([-50.0, -50.0, 90.0, 500.0])) == pytest.approx(0.0)


def texture(seed=1, width=480, height=360):
    """A picture (H, W, 3) of soft patches, as faces have them."""
    noise = np.random.RandomState(seed).randint(0, 256, (height // 8, width // 8, 3)).astype(np.uint8)
    return cv2.resize(noise, (width, height), interpolation=cv2.INTER_CUBIC)


def moved(picture, x, y):
    return cv2.warpAffine(picture, np.array([[1.0, 0.0, x], [0.0, 1.0, y]]), picture.shape[1::-1],
                          borderMode=cv2.BORDER_REFLECT)


def test_the_first_image_tells_nothing():
    assert FaceFlow().update(texture(), BOXES, STILL) == [None, None]


@pytest.mark.parametrize("way", [(0.0, 0.0), (3.5, -2.25), (-12.0, 7.0), (16.0, 10.0)])
def test_boxes_go_with_the_picture(way):
    flow, picture = FaceFlow(), texture()
    flow.update(picture, [], [])
    for motion in flow.update(moved(picture, *way), BOXES, STILL):
        assert motion == pytest.approx(np.array(way), abs=0.4)


def test_a_wrong_expectation_is_corrected_and_a_right_one_finds_what_is_far():
    picture = texture()
    for way, expected in (((5.0, 0.0), (-4.0, 6.0)), ((60.0, -30.0), (52.0, -26.0))):
        flow = FaceFlow()
        flow.update(picture, [], [])
        for motion in flow.update(moved(picture, *way), BOXES, [np.array(expected)] * 2):
            assert motion == pytest.approx(np.array(way), abs=0.4)


def test_one_that_moves_before_a_still_wall():
    flow, wall = FaceFlow(), texture()
    head = texture(seed=5)[:90, :80]
    images = [wall.copy(), wall.copy()]
    images[0][80:170, 100:180] = head
    images[1][86:176, 109:189] = head
    flow.update(images[0], [], [])
    first, second = flow.update(images[1], BOXES, STILL)
    assert first == pytest.approx([9.0, 6.0], abs=0.5)
    assert second == pytest.approx([0.0, 0.0], abs=0.2)


def test_another_picture_and_one_without_marks_tell_nothing():
    flow = FaceFlow()
    flow.update(texture(), [], [])
    assert flow.update(texture(seed=9), BOXES, STILL) == [None, None]
    flow.update(texture(), [], [])
    flat = np.full((360, 480, 3), 90, np.uint8)
    assert flow.update(flat, BOXES, STILL) == [None, None]


def test_images_without_a_box_are_not_shrunk_until_one_follows_and_nothing_else_changes(monkeypatch):
    shrunk = []
    shrink = flow_module.shrink
    monkeypatch.setattr(flow_module, "shrink", lambda image: shrunk.append(image) or shrink(image))
    images = [moved(texture(), 2.0 * number, -1.5 * number) for number in range(8)]
    counts, lazy, eager = [0, 0, 0, 2, 1, 2, 0, 0], FaceFlow(), FaceFlow()
    for image, count in zip(images, counts):
        told = lazy.update(image, BOXES[:count], STILL[:count])
        assert all(motion is not None for motion in told)
        wanted = eager.update(image, BOXES, STILL)[:count]      # always with boxes: each image as it comes
        np.testing.assert_array_equal(np.array(told), np.array(wanted))
    shrunk.clear()
    flow, needed = FaceFlow(), []
    for image, count in zip(images, counts):
        flow.update(image, BOXES[:count], STILL[:count])
        needed.append(len(shrunk))
    assert needed == [0, 0, 0, 2, 3, 4, 4, 4]
    flow.reset()
    assert flow.update(images[0], BOXES, STILL) == [None, None]


def test_another_size_starts_anew_and_so_does_a_reset():
    flow = FaceFlow()
    flow.update(texture(), [], [])
    assert flow.update(texture(width=320, height=240), BOXES, STILL) == [None, None]
    assert flow.update(texture(width=320, height=240), BOXES[:1], STILL[:1])[0] == pytest.approx([0.0, 0.0], abs=0.1)
    flow.reset()
    assert flow.update(texture(width=320, height=240), BOXES[:1], STILL[:1]) == [None]


@pytest.mark.parametrize("box",
                         [(-500.0, -500.0, -400.0, -400.0), (470.0, 350.0, 700.0, 600.0), (10.0, 10.0, 14.0, 14.0)])
def test_boxes_outside_of_the_image_and_tiny_ones_tell_nothing(box):
    flow, picture = FaceFlow(), texture()
    flow.update(picture, [], [])
    assert flow.update(picture, [np.array(box)], STILL[:1]) == [None]


def test_images_of_any_size():
    flow = FaceFlow()
    for shape in ((1, 1, 3), (1, 1, 3), (2, 500, 3), (2, 500, 3)):
        assert flow.update(np.zeros(shape, np.uint8), BOXES, STILL) == [None, None]


def test_a_doubted_face_waits_until_it_is_vouched_for_and_a_known_one_is_not_doubted():
    faces = FaceTracker(0.1, 1.0, 10, min_detections=1, doubts=lambda track: not track.vouched)
    for index in range(5):
        faces.update([face(100.0)], index * STEP)
    track, = faces.tracks
    assert faces.ids == [] and faces.doubted == [track]
    track.vouched = True
    faces.update([face(100.0)], 5 * STEP)
    assert faces.ids == [track.id] and faces.doubted == []
    track.vouched = False
    faces.update([face(100.0)], 6 * STEP)
    assert faces.ids == [track.id] and faces.doubted == []


def test_a_face_that_is_not_seen_twice_yet_is_not_asked_about():
    faces = FaceTracker(0.0, 1.0, 10, min_detections=2, doubts=lambda track: True)
    faces.update([face(100.0)], 0.0)
    track, = faces.tracks
    assert faces.doubted == []
    track.add_detection(STEP, 1.0)
    assert faces.doubted == [track]


@pytest.mark.parametrize("verification, doubted", [(0.0, True), (1.0, False)])
def test_a_face_that_is_not_verified_or_not_doubted_is_not_asked_about(verification, doubted):
    faces = FaceTracker(0.0, 1.0, 10, doubts=lambda track: doubted)
    faces.update([dataclasses.replace(face(100.0), verification=verification)], 0.0)
    assert len(faces.tracks) == 1 and faces.doubted == []


def test_faces_that_were_refused_leave_room_for_others():
    faces = tracker(most=1)
    faces._doubts = lambda track: not track.vouched
    things = [face(150.0 * number) for number in range(4)]
    for index in range(5):
        for track in faces.update(things, index * STEP):
            track.refused = True
    assert faces.ids == [] and len(faces.tracks) == 4
    for index in range(5, 8):
        seen = faces.update([*things, face(800.0)], index * STEP)
    assert seen[-1].measurement.box[[0, 2]].mean() == pytest.approx(800.0)
    seen[-1].vouched = True
    faces.update([*things, face(800.0)], 8 * STEP)
    assert faces.ids == [seen[-1].id]
