"""Births, deaths, crossings and duplicates of face tracks, with faces made of numbers."""

import numpy as np
import pytest

from hri_pipeline.core.faces.face_landmarks import MESH_POINTS
from hri_pipeline.core.faces.face_track import FaceMeasurement, face_colours
from hri_pipeline.core.faces.face_tracker import FaceTracker, same_face, without_duplicates
from hri_pipeline.core.ids import IdGenerator

STEP = 1.0 / 15.0


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


def test_a_gap_between_images_longer_than_the_death_time_ends_the_track():
    faces = tracker(death=1.0)
    faces.update([face(100.0)], 0.0)
    first = faces.ids
    assert faces.expected(60.0) == []
    faces.update([face(100.0)], 60.0)
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


def test_duplicates_are_one_face_and_neighbours_are_two():
    kept = without_duplicates([face(100.0), face(110.0, size=130.0, presence=0.5), face(180.0)])
    assert [measurement.box[[0, 2]].mean() for measurement in kept] == [100.0, 180.0]


def test_the_surer_duplicate_wins_and_the_tracked_one_of_equals():
    tracked, fresh = face(100.0, detection=False), face(101.0, presence=1.0)
    assert without_duplicates([fresh, tracked]) == [tracked]
    unsure = face(100.0, detection=False, presence=0.4)
    assert without_duplicates([unsure, fresh]) == [fresh]


def test_same_face_by_overlap_and_by_distance():
    box = np.array([0.0, 0.0, 100.0, 100.0])
    assert same_face(box, box + 10.0)
    assert same_face(box, np.array([30.0, 30.0, 70.0, 70.0]))
    assert not same_face(box, box + (90.0, 0.0, 90.0, 0.0))


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
    assert all(sorted(frame, key=frame.get) == sorted(seen[0], key=seen[0].get) for frame in seen)


def test_a_moving_face_is_expected_where_it_goes():
    faces = tracker()
    run(faces, *[[face(100.0 + 10.0 * index)] for index in range(30)])
    track, = faces.expected(30 * STEP)
    assert track.predicted_box(30 * STEP)[[0, 2]].mean() == pytest.approx(400.0, abs=2.0)


def test_reset_drops_everybody_and_no_id_comes_again():
    faces = tracker()
    run(faces, [face(100.0)])
    first = faces.ids
    faces.reset()
    assert faces.tracks == []
    run(faces, [face(100.0)])
    assert faces.ids != first


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
            faces.support([face(102.0).box, face(900.0).box], stamp)
        faces.update([face(100.0, detection=step == 0)], stamp)
        ids.update(faces.ids)
        assert len(faces.ids) == (1 if step >= 1 else 0)
    assert len(ids) == 1


@pytest.mark.parametrize("wrong", [dict(min_detections=0), dict(support_time=0.0), dict(support_time=-1.0)])
def test_illegal_support(wrong):
    with pytest.raises(ValueError):
        FaceTracker(0.1, 1.0, 10, **wrong)


def test_what_the_detector_is_not_sure_of_needs_more_of_it():
    faces = FaceTracker(0.1, 1.0, 10, min_detections=2, support_time=2.0)
    doubtful = face(100.0)
    pattern = FaceMeasurement(doubtful.mesh, doubtful.presence, True, evidence=0.5)
    counts = []
    for step in range(40):
        stamp = 0.1 * step
        if step % 5 == 4:
            faces.support([face(102.0).box, face(101.0).box], stamp, [0.25, 0.5])
        faces.update([pattern if step == 0 else face(100.0, detection=False)], stamp)
        counts.append(len(faces.ids))
    assert counts.index(1) == 14, "half of a detection four times"


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


RED, BLUE = np.full((5, 4, 3), 0.2), np.full((5, 4, 3), 0.5)


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


def test_colours_of_a_face():
    image = np.zeros((100, 200, 3), np.uint8)
    image[:, 100:] = 255
    assert face_colours(image, np.array([50.0, 0.0, 150.0, 100.0])).shape == (5, 4, 3)
    assert face_colours(image, np.array([110.0, 10.0, 190.0, 90.0])) == pytest.approx(1.0)
    assert face_colours(image, np.array([-500.0, 0.0, -300.0, 50.0])) is None
    assert face_colours(image, np.array([-50.0, -50.0, 90.0, 500.0])) == pytest.approx(0.0)
