import itertools
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from synthetic_people import Scene, Walkers, face_of, standing_at, textured

from hri_fullbody.core.tracking.tracker import BodyTracker
from hri_pipeline.core.error_log import ItemGuard
from hri_pipeline.core.ignored_regions import IgnoredRegions
from hri_pipeline.core.scheduler import InferenceScheduler

IMAGE = np.zeros((720, 1280, 3), np.uint8)
STEP = 0.05


def make(scene, **changes):
    numbers = itertools.count()
    options = dict(birth_delay=0.1, death_time=0.5)
    options.update(changes)
    return BodyTracker(scene, lambda: "b{}".format(next(numbers)), **options)


def box_of(x, y):
    return standing_at(x, y).box


def run(tracker, start, count, faces=(), boxes=(), image=IMAGE):
    """Feed `count` images and return the stamp of the next one."""
    for index in range(count):
        stamp = start + index * STEP
        tracker.follow(image, stamp, faces)
        tracker.propose(boxes, faces, stamp)
        tracker.try_new(image, stamp, faces, 4)
    return start + count * STEP


def confirmed(tracker):
    return [track.id for track in tracker.tracks if track.life.confirmed]


@pytest.mark.parametrize("changes", [
    {"birth_delay": -0.1}, {"death_time": 0.0}, {"min_score": 0.0}, {"min_score": 1.0}, {"max_bodies": 0},
    {"max_retries": -1}, {"death_time": float("nan")}])
def test_illegal_settings_are_refused(changes):
    with pytest.raises(ValueError):
        make(Scene([]), **changes)


def test_birth_needs_the_delay_and_not_a_number_of_images():
    tracker = make(Scene([(300, 400)]))
    stamp = run(tracker, 0.0, 2, boxes=[box_of(300, 400)])
    assert len(tracker.tracks) == 1
    assert confirmed(tracker) == [] == tracker.published(stamp - STEP)
    stamp = run(tracker, 0.1, 2)
    assert confirmed(tracker) == ["b0"] == [track.id for track in tracker.published(stamp - STEP)]


def test_id_stays_while_the_person_walks_and_dies_the_death_time_after_leaving():
    scene = Scene([(300, 400)])
    tracker = make(scene)
    stamp = run(tracker, 0.0, 4, boxes=[box_of(300, 400)])
    for step in range(30):
        scene.people = [(300 + 34 * step, 400)]
        stamp = run(tracker, stamp, 1)
    assert confirmed(tracker) == ["b0"]
    scene.people = []
    stamp = run(tracker, stamp, 9)
    assert confirmed(tracker) == ["b0"]
    assert not tracker.tracks[0].visible
    run(tracker, stamp, 3)
    assert tracker.tracks == []


def test_nobody_is_waited_for_behind_a_cut_of_the_picture():
    scene = Scene([(600, 400)])
    tracker = make(scene)
    stamp = run(tracker, 0.0, 30, boxes=[box_of(600, 400)])
    stamp = run(tracker, stamp, 2, image=NOISE)         # somebody else stands at the same place
    assert tracker.published(stamp) == []
    scene.people = []
    run(tracker, stamp, 12, image=NOISE)
    assert tracker.tracks == []


@pytest.mark.parametrize("late_faces", [False, True])
def test_bodies_keep_their_ids_where_the_camera_zooms(late_faces):
    """What comes to lie where the other one was is not the other one; nor does a face that was seen before tell so."""
    people = [(500.0, 400.0), (700.0, 400.0)]
    scene = Scene(people)
    tracker = make(scene)
    faces = [face_of(standing_at(*place), "f{}".format(number)) for number, place in enumerate(people)]
    faces = [replace(face, stamp=0.5) for face in faces] if late_faces else []
    stamp = run(tracker, 0.0, 30, faces, [box_of(*place) for place in people], image=textured())
    before = {track.id: track.estimate.centre for track in tracker.published(stamp)}
    assert len(before) == 2
    scale, shift = 1.5, np.array([-540.0, -180.0])
    image = cv2.warpAffine(textured(), np.column_stack([scale * np.eye(2), shift]), (1280, 720))
    scene.people, scene.scale = [tuple(scale * np.array(place) + shift) for place in people], scale * 200.0
    stamp = run(tracker, stamp, 3, faces, image=image)
    after = {track.id: track.estimate.centre for track in tracker.published(stamp)}
    assert after.keys() == before.keys()
    for name, centre in after.items():
        np.testing.assert_allclose(centre, scale * before[name] + shift, atol=15.0)


@pytest.mark.parametrize("aside, face, looked_at", [(40, True, ["b0"]), (60, False, []), (400, True, [])])
def test_who_overlaps_a_new_body_with_a_face_is_looked_at_in_the_next_image(monkeypatch, aside, face, looked_at):
    """It may be a body that the network made of two: beside a load it went on for seconds."""
    scene = Scene([(600 + aside, 400)])
    tracker = make(scene)
    stamp = run(tracker, 0.0, 10, boxes=[box_of(600 + aside, 400)])
    renewed = []
    monkeypatch.setattr(tracker.schedule, "renew", renewed.append)
    scene.people.append((600, 400))
    faces = [face_of(standing_at(600, 400), "f0")] if face else []
    run(tracker, stamp, 3, faces=faces, boxes=[box_of(600, 400)])
    assert [track.id for track in tracker.tracks] == ["b0", "b1"] and renewed == looked_at


NOISE = np.random.default_rng(1).integers(0, 255, (9, 16, 3)).astype(np.uint8).repeat(80, 0).repeat(80, 1)


def test_after_a_cut_a_face_that_is_told_late_holds_no_body_and_begins_none():
    """A face of the picture before lies by chance where another thing of the new picture resembles a body."""
    scene, face = Scene([(600, 400)]), face_of(standing_at(600, 400), "f0")
    tracker = make(scene)
    stamp = run(tracker, 0.0, 30, faces=[face], boxes=[box_of(600, 400)])
    assert [track.face_id for track in tracker.tracks] == ["f0"]
    stamp = run(tracker, stamp, 6, faces=[face], image=NOISE)
    assert tracker.published(stamp) == []
    stamp = run(tracker, stamp, 10, faces=[face], boxes=[box_of(600, 400)], image=NOISE)
    assert [track.face_id for track in tracker.published(stamp - STEP)] == ["f0"], "it is still told, so it is there"


@pytest.mark.parametrize("x", [600, 60], ids=["in the middle", "at the side"])
def test_who_was_there_when_the_light_went_off_is_waited_for(x):
    scene = Scene([(x, 400)])
    tracker = make(scene)
    stamp = run(tracker, 0.0, 30, boxes=[box_of(x, 400)], image=NOISE)
    scene.people = []
    stamp = run(tracker, stamp, 5)
    assert tracker.published(stamp) == [] and [track.id for track in tracker.tracks] == ["b0"]
    scene.people = [(x, 400)]
    run(tracker, stamp, 4, boxes=[box_of(x, 400)], image=NOISE)
    assert [(track.id, track.visible) for track in tracker.tracks] == [("b0", True)]
    scene.people = []
    run(tracker, run(tracker, stamp + 4 * STEP, 3), 80)
    assert tracker.tracks == []


def test_a_black_image_now_and_then_costs_nobody_more_than_that_image():
    scene = Scene([(600, 400)])
    tracker = make(scene)
    stamp = run(tracker, 0.0, 30, boxes=[box_of(600, 400)], image=NOISE)
    told = []
    for _ in range(5):
        scene.people = []
        stamp = run(tracker, stamp, 1)
        told.append([track.id for track in tracker.published(stamp)])
        scene.people = [(600, 400)]
        tracker.follow(NOISE, stamp)
        told.append([track.id for track in tracker.published(stamp)])
        stamp = run(tracker, stamp + STEP, 3, image=NOISE)
    assert told == 5 * [[], ["b0"]]


def test_in_the_dark_no_body_is_seen_and_none_drifts_to_a_neighbour():
    scene = Scene([(600, 400)])
    tracker = make(scene)
    stamp = run(tracker, 0.0, 30, boxes=[box_of(600, 400)], image=NOISE)
    before = tracker.tracks[0].place.copy()
    for x in range(610, 700, 10):       # what the network makes of noise
        scene.people = [(x, 400)]
        stamp = run(tracker, stamp, 1, boxes=[box_of(x, 400)])
        assert tracker.published(stamp) == [] and tracker.windows == 0
    assert np.allclose(tracker.tracks[0].place, before) and len(tracker.tracks) == 1


def test_who_was_not_seen_for_a_while_is_waited_for_behind_a_black_image_as_before():
    scene = Scene([(600, 400)])
    tracker = make(scene)
    stamp = run(tracker, 0.0, 30, boxes=[box_of(600, 400)], image=NOISE)
    scene.people = []
    stamp = run(tracker, stamp, 8, image=NOISE)
    stamp = run(tracker, run(tracker, stamp, 1), 8, image=NOISE)
    assert [(track.id, track.hidden) for track in tracker.tracks] == [("b0", True)]
    run(tracker, run(tracker, stamp, 8), 5, image=NOISE)     # what is where is not known after so long a dark
    assert tracker.tracks == []


def picture_of(scene, background):
    """An image of the people of a scene before a background."""
    image, shown = background.copy(), scene.image()
    mask = (shown != 90).any(axis=2)
    image[mask] = shown[mask]
    return image


@pytest.mark.parametrize("moved, clothes, walks, kept", [
    (0, (40, 40, 200), False, True), (30, (40, 40, 200), False, True), (230, (40, 40, 200), False, False),
    (0, (200, 60, 40), False, False), (0, (40, 40, 200), True, False)],
    ids=["same", "a step aside", "elsewhere", "other clothes", "was walking"])
def test_who_stood_when_the_light_went_is_the_same_two_seconds_later(moved, clothes, walks, kept):
    scene = Walkers([(300 if walks else 600, 400)], [(40, 40, 200)])
    tracker = make(scene)

    stamp = run(tracker, 0.0, 1, boxes=[box_of(*scene.people[0])], image=picture_of(scene, NOISE))
    for _ in range(30):
        scene.people = [(scene.people[0][0] + (10 if walks else 0), 400)]
        stamp = run(tracker, stamp, 1, boxes=[box_of(*scene.people[0])], image=picture_of(scene, NOISE))
    assert [track.id for track in tracker.published(stamp)] == ["b0"]
    stamp = run(tracker, stamp, 40)
    scene.people, scene.colours = [(scene.people[0][0] + moved, 400)], [clothes]
    stamp = run(tracker, stamp, 12, boxes=[box_of(*scene.people[0])], image=picture_of(scene, NOISE))
    assert [track.id for track in tracker.published(stamp)] == (["b0"] if kept else ["b1"])


@pytest.mark.parametrize("after, kept", [("f0", True), ("f1", False)])
def test_a_face_tells_who_stands_there_when_the_light_is_back(after, kept):
    scene = Scene([(600, 400)])
    tracker = make(scene)
    stamp = run(tracker, 0.0, 30, [face_of(standing_at(600, 400), "f0")], [box_of(600, 400)], image=NOISE)
    stamp = run(tracker, stamp, 40)
    run(tracker, stamp, 12, [face_of(standing_at(600, 400), after)], [box_of(600, 400)], image=NOISE)
    assert [track.id for track in tracker.published(stamp + 12 * STEP)] == (["b0"] if kept else ["b1"])


def test_after_a_dark_that_ends_with_another_picture_nobody_is_waited_for():
    scene = Scene([(600, 400)])
    tracker = make(scene)
    stamp = run(tracker, 0.0, 30, boxes=[box_of(600, 400)], image=NOISE)
    scene.people = []
    stamp = run(tracker, stamp, 8)
    run(tracker, stamp, 1, image=NOISE[::-1, ::-1])
    assert not any(track.hidden for track in tracker.tracks)


def test_another_picture_after_the_dark_ends_the_waiting_for_who_stood():
    """A film from one scene to the next, a camera that is carried away: who is alike there is somebody else."""
    scene = Walkers([(600, 400)], [(40, 40, 200)])
    tracker, background = make(scene), NOISE.copy()
    background[:, 500:800] = 90
    stamp = run(tracker, 0.0, 30, boxes=[box_of(600, 400)], image=picture_of(scene, background))
    stamp = run(tracker, stamp, 40)
    assert [track.id for track in tracker.tracks] == ["b0"]
    scene.people = [(700, 400)]
    stamp = run(tracker, stamp, 6, boxes=[box_of(700, 400)], image=picture_of(scene, background[::-1, ::-1]))
    assert [track.id for track in tracker.published(stamp)] == ["b1"]


def test_who_comes_back_after_a_cut_must_be_confirmed_anew():
    scene = Scene([(600, 400)])
    tracker = make(scene)
    stamp = run(tracker, 0.0, 30, boxes=[box_of(600, 400)])
    tracker.tracks[0].cut_off(stamp)
    tracker.tracks[0].update(tracker.tracks[0].detection, stamp + STEP, False)
    assert tracker.awaits_detector
    run(tracker, stamp + 2 * STEP, 50)
    assert tracker.tracks == []


def walk_up_to_one_who_stands(scene, tracker):
    """Returns the stamp of the next image; the second one has walked from x = 720 to 640 px, the first stands at 600.
    """
    scene.people = [(600, 400), (720, 400)]
    stamp = run(tracker, 0.0, 30, boxes=[box_of(600, 400), box_of(720, 400)])
    for x in range(720, 639, -5):
        scene.people = [(600, 400), (x, 400)]
        stamp = run(tracker, stamp, 1)
    assert len(tracker.published(stamp)) == 2
    return stamp


def test_who_began_where_another_one_was_hidden_yields_to_that_one_until_each_has_a_box():
    scene, boxes = Scene([]), [box_of(600, 400), box_of(640, 400)]
    tracker = make(scene)
    stamp = walk_up_to_one_who_stands(scene, tracker)
    first, second = tracker.tracks
    second.rival = first.id
    stamp = run(tracker, stamp, 1, boxes=boxes[:1])
    assert tracker.published(stamp) == [first]
    stamp = run(tracker, stamp, 3, boxes=boxes)
    assert second.rival is None and len(tracker.published(stamp)) == 2


def test_who_began_where_another_one_was_hidden_is_told_until_that_one_is_seen_twice():
    """A single sight after a gap may be somebody else, and is not told: without the other one nobody would be."""
    scene = Scene([])
    tracker = make(scene)
    stamp = walk_up_to_one_who_stands(scene, tracker)
    first, second = tracker.tracks
    scene.people = [(640, 400)]
    stamp = run(tracker, stamp, 8, boxes=[box_of(640, 400)])
    assert tracker.published(stamp) == [second] and first.hidden
    scene.people, second.rival = [(600, 400), (640, 400)], first.id
    told = []
    for _ in range(2):
        stamp = run(tracker, stamp, 1, boxes=[box_of(640, 400)])
        told.append(tracker.published(stamp))
    assert told == [[second], [first]]


def test_who_has_walked_away_from_where_another_one_was_hidden_does_not_yield():
    tracker = make(Scene([(300, 400), (900, 400)]))
    stamp = run(tracker, 0.0, 30, boxes=[box_of(300, 400), box_of(900, 400)])
    first, second = tracker.tracks
    second.rival = first.id
    stamp = run(tracker, stamp, 2)
    assert tracker.published(stamp) == [first, second]


def test_who_is_seen_now_yields_to_nobody_who_is_missed_in_this_image():
    scene = Scene([(600, 400)])
    tracker = make(scene)
    stamp = run(tracker, 0.0, 40, boxes=[box_of(600, 400)])
    scene.people = [(600, 400), (660, 400)]
    stamp = run(tracker, stamp, 8, boxes=[box_of(600, 400), box_of(660, 400)])
    first, second = tracker.tracks
    assert tracker.published(stamp) == [first, second]
    scene.people = [(630, 400)]
    stamp = run(tracker, stamp, 1)
    assert tracker.published(stamp) == [second] and second.visible and not first.visible


def test_who_vanishes_inside_the_image_is_waited_for_longer():
    scene = Scene([(600, 400)])
    tracker = make(scene)
    stamp = run(tracker, 0.0, 30, boxes=[box_of(600, 400)])
    scene.people = []
    stamp = run(tracker, stamp, 25)
    assert confirmed(tracker) == ["b0"] and tracker.published(stamp) == [] and tracker.awaits_return(stamp)
    scene.people = [(640, 400)]
    stamp = run(tracker, stamp, 3, boxes=[box_of(640, 400)])
    assert confirmed(tracker) == ["b0"] and tracker.published(stamp - 0.1)
    scene.people = []
    run(tracker, stamp, 33)
    assert tracker.tracks == []


def test_who_is_not_looked_at_is_not_gone():
    """Ten people, three looks and two images a second: each is looked at every other second."""
    scene = Scene([(80 + 120 * index, 400) for index in range(10)])
    tracker = make(scene, death_time=1.0, schedule=InferenceScheduler(10.0, most=3, batches=False))
    boxes = [box_of(*place) for place in scene.people]
    for index in range(40):
        tracker.follow(IMAGE, 0.5 * index)
        tracker.propose(boxes, [], 0.5 * index)
        tracker.try_new(IMAGE, 0.5 * index, [], 3)
    assert sorted(confirmed(tracker)) == sorted("b{}".format(index) for index in range(10))
    scene.people = scene.people[1:]
    for index in range(40, 56):
        tracker.follow(IMAGE, 0.5 * index)
    assert len(confirmed(tracker)) == 9, "who is looked for in vain is gone"


def slow_images(tracker, scene, presence, boxes):
    """Show two people once a second, the second one as `presence` says, and return who is published in each image.

    boxes: whether the person detector sees the second one while the pose network does not.
    """
    shown = []
    for second, here in enumerate(presence):
        scene.people = [(400, 400), (800, 400)] if here else [(400, 400)]
        seen = [box_of(400, 400)] + ([box_of(800, 400)] if here or boxes else [])
        tracker.follow(IMAGE, float(second))
        tracker.propose(seen, [], float(second))
        tracker.try_new(IMAGE, float(second), [], 3)
        shown.append([track.id for track in tracker.published(float(second))])
    return shown


def test_who_is_missed_once_in_slow_images_is_published_where_it_would_be():
    tracker = make(Scene([]), death_time=1.0)
    shown = slow_images(tracker, tracker._pose, [1, 1, 1, 1, 1, 0, 1, 1], boxes=True)
    assert shown[3:] == 5 * [["b0", "b1"]]
    tracker = make(Scene([]), death_time=1.0)
    shown = slow_images(tracker, tracker._pose, [1, 1, 1, 1, 1, 0, 0, 0, 1, 1], boxes=True)
    assert [len(ids) for ids in shown[4:9]] == [2, 2, 1, 1, 1], "missed twice it is gone until seen twice"


def test_who_is_missed_once_in_slow_images_is_published_until_the_next_look_and_in_fast_ones_not_at_all():
    """Four people, one look and two images a second: each is looked at every other second."""
    people = [(150 + 300 * index, 400) for index in range(4)]
    scene, boxes, shown = Scene(people), [box_of(*place) for place in people], []
    tracker = make(scene, schedule=InferenceScheduler(10.0, most=1, batches=False))
    for index in range(46):
        if index == 40:
            missed = min(tracker.tracks, key=lambda track: track.inferred_at)
            scene.people = [place for place in people if abs(place[0] - missed.estimate.centre[0]) > 50.0]
        tracker.follow(IMAGE, 0.5 * index)
        tracker.propose(boxes, [], 0.5 * index)
        tracker.try_new(IMAGE, 0.5 * index, [], 1)
        shown.append(len(tracker.published(0.5 * index)))
    assert shown[39:] == [4, 4, 4, 4, 4, 3, 3]
    scene = Scene([(400, 400)])
    tracker = make(scene)
    stamp = run(tracker, 0.0, 30, boxes=[box_of(400, 400)])
    scene.people = []
    run(tracker, stamp, 1, boxes=[box_of(400, 400)])
    assert tracker.tracks[0].hidden and tracker.published(stamp) == []


def test_who_is_missed_in_slow_images_is_gone_at_once_when_the_detector_sees_nobody_there():
    tracker = make(Scene([]), death_time=1.0)
    shown = slow_images(tracker, tracker._pose, [1, 1, 1, 1, 1, 0, 0], boxes=False)
    assert shown[4:] == [["b0", "b1"], ["b0"], ["b0"]]


def test_a_person_who_comes_back_in_time_has_the_same_id():
    scene = Scene([(300, 400)])
    tracker = make(scene)
    stamp = run(tracker, 0.0, 4, boxes=[box_of(300, 400)])
    scene.people = []
    stamp = run(tracker, stamp, 5)
    scene.people = [(340, 400)]
    run(tracker, stamp, 4, boxes=[box_of(340, 400)])
    assert confirmed(tracker) == ["b0"]


def test_who_was_hidden_is_back_with_the_first_look_at_the_own_box():
    """Whoever is new is looked at twice, and by the person detector, too."""
    scene = Scene([(600, 400)])
    tracker = make(scene, is_human=lambda image, box: False)
    stamp = run(tracker, 0.0, 40, faces=[face_of(standing_at(600, 400), "f0")], boxes=[box_of(600, 400)])
    scene.people = []
    stamp = run(tracker, stamp, 12)
    assert tracker.tracks[0].hidden
    scene.people = [(640, 400)]
    tracker.propose([box_of(640, 400)], (), stamp)
    tracker.try_new(IMAGE, stamp, (), 1)
    assert [(track.id, track.visible, track.box_confirmed) for track in tracker.tracks] == [("b0", True, True)]


def test_two_boxes_on_one_human_give_one_body():
    tracker = make(Scene([(300, 400)]))
    boxes = [box_of(300, 400), box_of(300, 400) + np.array([0, 0, 0, -120.0]), box_of(320, 400)]
    run(tracker, 0.0, 10, boxes=boxes)
    assert confirmed(tracker) == ["b0"]


def test_two_tracks_that_end_up_on_one_human_become_one():
    scene = Scene([(300, 400), (420, 400)])
    tracker = make(scene)
    stamp = run(tracker, 0.0, 4, boxes=[box_of(300, 400), box_of(420, 400)])
    assert sorted(confirmed(tracker)) == ["b0", "b1"]
    scene.people = [(360, 400)]
    stamp = run(tracker, stamp, 2)
    assert [track.id for track in tracker.tracks if track.visible][:2] in (["b0"], ["b1"])
    run(tracker, stamp, 12)
    assert confirmed(tracker) == ["b0"]


def test_a_face_alone_is_enough():
    tracker = make(Scene([(300, 400)]))
    run(tracker, 0.0, 6, faces=[face_of(standing_at(300, 400), "f0")])
    assert confirmed(tracker) == ["b0"]
    assert tracker.tracks[0].face_id == "f0"


def test_a_face_without_a_body_is_tried_less_and_less_often():
    scene = Scene([])
    tracker = make(scene)
    face = face_of(standing_at(300, 400), "f0")
    run(tracker, 0.0, 200, faces=[face])
    assert tracker.tracks == []
    assert len(scene.windows) < 40


def test_neighbours_heads_are_hidden_so_that_each_face_gets_its_own_body():
    scene = Scene([(300, 400), (380, 400)])
    scene.favourite = 0
    tracker = make(scene)
    faces = [face_of(standing_at(300, 400), "f0"), face_of(standing_at(380, 400), "f1")]
    stamp = run(tracker, 0.0, 6, faces=faces)
    run(tracker, stamp, 20, faces=faces)
    assert sorted(track.face_id for track in tracker.tracks) == ["f0", "f1"]
    for track in tracker.tracks:
        face = next(face for face in faces if face.id == track.face_id)
        assert face.distance(track.estimate.nose) < 0.1


class Heads(Scene):
    """Notes how many heads are hidden, by the place of the window."""

    def estimate(self, image, window, hidden=(), shown=None, mirrored=False):
        self.hidden[round(window.centre[0], -2)] = len(hidden)
        return super().estimate(image, window, hidden, shown, mirrored)


@pytest.mark.parametrize("face, lost, heads", [(None, False, 1), (1100, False, 0), (1100, True, 1), (600, False, 1)],
                         ids=["nobody has a face", "faces are seen", "who is lost", "the other one has a face"])
def test_the_head_of_another_body_is_hidden_only_where_no_faces_are_seen_or_from_who_is_lost(face, lost, heads):
    """It is less sure than a face: with the own head hidden the network makes a second body of a trunk."""
    scene = Heads([(300, 400), (600, 400)])
    scene.hidden = {}
    tracker, faces = make(scene), [] if face is None else [face_of(standing_at(face, 400), "f0")]
    stamp = run(tracker, 0.0, 30, faces, [box_of(300, 400), box_of(600, 400)])
    if lost:
        scene.people = [(600, 400)]
        stamp = run(tracker, stamp, 1, faces)
    tracker.follow(IMAGE, stamp, faces)
    assert scene.hidden[300.0] == heads


def test_a_captured_body_is_sought_again_below_its_face():
    scene = Scene([(300, 400), (420, 400)])
    tracker = make(scene)
    faces = [face_of(standing_at(300, 400), "f0")]
    stamp = run(tracker, 0.0, 4, faces=faces)
    # The neighbour has no tracked face, so cannot be hidden, and is nearer to the old window than the person who moves.
    scene.people = [(200, 400), (300, 400)]
    run(tracker, stamp, 1, faces=[face_of(standing_at(200, 400), "f0")])
    track = next(track for track in tracker.tracks if track.face_id == "f0")
    assert track.id == "b0" and track.visible, "in the same image"
    assert track.estimate.nose[0] == pytest.approx(200.0)


def test_who_is_lost_is_found_again_below_the_own_face_in_one_window_an_image():
    scene = Scene([(300, 400)])
    tracker = make(scene, max_retries=0)
    stamp = run(tracker, 0.0, 6, faces=[face_of(standing_at(300, 400), "f0")])
    scene.people, face = [], face_of(standing_at(900, 400), "f0")       # the face goes on behind a desk
    for _ in range(4):
        tracker.follow(IMAGE, stamp, [face])
        assert tracker.windows == 1 and not tracker.tracks[0].visible
        stamp += STEP
    scene.people = [(900, 400)]
    run(tracker, stamp, 2, faces=[face])
    assert [(track.id, track.visible) for track in tracker.tracks] == [("b0", True)]
    assert tracker.tracks[0].estimate.nose[0] == pytest.approx(900.0)


def test_who_is_seen_is_followed_by_the_own_landmarks_and_not_by_the_face():
    scene = Scene([(300, 400)])
    tracker = make(scene)
    run(tracker, 0.0, 60, faces=[face_of(standing_at(300, 400), "f0")], boxes=[box_of(300, 400)])
    expected = tracker.tracks[0].estimate.next_window()
    assert scene.windows[-1].centre == pytest.approx(expected.centre) and scene.windows[-1].size == expected.size


class Squeezed(Scene):
    """Like the network: in a large window it sees the neighbour, in a smaller one the person in the middle."""

    def estimate(self, image, window, hidden=(), shown=None, mirrored=False):
        self.favourite = 1 if window.size > 210.0 else None
        return super().estimate(image, window, hidden, shown, mirrored)


def test_a_window_below_the_own_face_that_shows_a_neighbour_is_not_the_last_one_that_is_tried():
    scene = Squeezed([(300, 400)])
    tracker = make(scene)
    stamp = run(tracker, 0.0, 4, faces=[face_of(standing_at(300, 400), "f0")])
    scene.people.append((420, 400))
    run(tracker, stamp, 3, faces=[face_of(standing_at(300, 400), "f0")])
    track = next(track for track in tracker.tracks if track.face_id == "f0")
    assert track.id == "b0" and track.visible and track.estimate.nose[0] == pytest.approx(300.0)


def test_who_comes_is_looked_at_before_all_who_are_known():
    """People who are followed take none of the few windows for new ones, whoever names them again."""
    people = [(100 + 160 * index, 400) for index in range(6)]
    scene = Scene(people)
    tracker = make(scene)
    faces = [face_of(standing_at(*place), "f{}".format(index)) for index, place in enumerate(people)]
    stamp = run(tracker, 0.0, 8, faces=faces, boxes=[box_of(*place) for place in people])
    assert len(tracker.tracks) == 6
    tracker.follow(IMAGE, stamp, faces)
    tracker.try_new(IMAGE, stamp, faces, 4)
    assert tracker.windows == 6, "one each"
    scene.people = [*people, (1100, 400)]
    boxes = [box_of(*place) for place in scene.people]
    tracker.propose(boxes, [], stamp, boxes)
    for _ in range(2):
        tracker.try_new(IMAGE, stamp, [], 1)
    assert len(tracker.tracks) == 7


@pytest.mark.parametrize("people, right_is_human, hidden, began, windows", [
    ([400, 560], True, True, 2, 8), ([400, 560], True, False, 2, 8), ([400, 560], False, True, 0, 10),
    ([400], False, True, 0, 3)], ids=["a neighbour is human", "and nobody hidden", "two screens", "a screen"])
def test_a_box_beside_others_has_one_more_chance_in_the_same_image(people, right_is_human, hidden, began, windows):
    """Who is not seen to be a human is one where another human is known beside. While somebody is hidden, who may come
    back there, nothing that was refused is passed over."""
    scene = Scene([(900, 400)])
    tracker = make(scene, is_human=lambda image, box: box[0] > (450 if right_is_human else 800))
    stamp = run(tracker, 0.0, 40, boxes=[box_of(900, 400)])
    scene.people = [] if hidden else scene.people
    stamp = run(tracker, stamp, 8)
    assert tracker.tracks[0].hidden == hidden
    tracker.follow(IMAGE, stamp)
    known = tracker.windows
    scene.people += [(x, 400) for x in people]
    tracker.propose([box_of(x, 400) for x in people], [], stamp)
    tracker.try_new(IMAGE, stamp, [], 40)
    assert (len(tracker.tracks) - 1, tracker.windows - known) == (began, windows)


class Flag(Scene):
    """What the network makes a body of, and another one when it is mirrored."""

    def estimate(self, image, window, hidden=(), shown=None, mirrored=False):
        found = super().estimate(image, window, hidden, shown, mirrored)
        return standing_at(found.centre[0] + 150.0, found.centre[1]) if mirrored else found


@pytest.mark.parametrize("scene, sure, began", [(Flag, False, 0), (Flag, True, 1), (Scene, False, 1)],
                         ids=["a flag", "of which the detector is sure", "a human"])
def test_of_what_the_detector_is_unsure_the_network_must_see_the_same_body_when_it_is_mirrored(scene, sure, began):
    tracker, box = make(scene([(400, 400)])), box_of(400, 400)
    tracker.follow(IMAGE, 0.0)
    tracker.propose([box] if sure else [], [], 0.0, [box])
    tracker.try_new(IMAGE, 0.0, [], 9)
    assert len(tracker.tracks) == began


def test_a_box_beside_one_with_a_face_needs_no_look_of_the_detector():
    tracker, boxes = make(Scene([(400, 400), (560, 400)]), is_human=lambda image, box: False), [
        box_of(400, 400), box_of(560, 400)]
    face = face_of(standing_at(560, 400), "f0")
    tracker.follow(IMAGE, 0.0, [face])
    tracker.propose(boxes, [face], 0.0)
    tracker.try_new(IMAGE, 0.0, [face], 2)
    assert [track.face_id for track in tracker.tracks] == [None] and tracker.windows == 2


def test_a_screen_on_which_something_moves_keeps_nobody_beside_it_from_being_found_in_slow_images():
    """Its box comes first, and each time the second look sees no human."""
    tracker = make(Scene([(400, 400), (560, 400)]), is_human=lambda image, box: box[0] > 450)
    boxes = [box_of(400, 400), box_of(560, 400)]
    for second in range(4):
        image = NOISE.copy()
        image[200:700, 330:470] = 60 * second
        tracker.follow(image, float(second))
        tracker.propose(boxes, [], float(second))
        tracker.try_new(image, float(second), [], 2)
    assert 560.0 in [track.estimate.centre[0] for track in tracker.tracks]


def test_an_image_that_comes_twice_is_looked_at_once():
    scene = Scene([(600, 400)])
    tracker = make(scene)
    stamp = run(tracker, 0.0, 10, boxes=[box_of(600, 400)])
    scene.people = []
    for _ in range(5):
        tracker.follow(IMAGE, stamp)
    assert tracker.tracks[0].misses == 1


def test_what_waits_for_a_look_waits_while_the_image_is_black():
    scene = Scene([(600, 400), (900, 400)])
    tracker = make(scene)
    face = face_of(standing_at(900, 400), "f1")
    stamp = run(tracker, 0.0, 3, boxes=[box_of(600, 400)], image=NOISE)
    tracker.tracks[0].box_confirmed = None              # the detector has not been asked yet
    tracker.propose([box_of(600, 400), box_of(900, 400)], [], stamp - STEP, [])
    tracker.tracks[0].box_confirmed = None
    for _ in range(3):
        tracker.follow(IMAGE, stamp, [face])
        tracker.propose([], [face], stamp)
        tracker.try_new(IMAGE, stamp, [face], 4)
        assert tracker.windows == 0 and tracker.awaits_detector
        stamp += STEP
    run(tracker, stamp, 3, boxes=[box_of(600, 400), box_of(900, 400)], image=NOISE)
    assert sorted(track.estimate.centre[0] for track in tracker.tracks if track.visible) == pytest.approx([600, 900])


def test_no_more_bodies_than_allowed():
    people = [(150 + 200 * index, 400) for index in range(5)]
    tracker = make(Scene(people), max_bodies=3)
    run(tracker, 0.0, 20, boxes=[box_of(*person) for person in people])
    assert len(tracker.tracks) == 3


def test_where_no_more_bodies_are_allowed_who_was_lost_comes_back_all_the_same():
    scene = Scene([(300, 400), (900, 400)])
    tracker = make(scene, max_bodies=2, death_time=2.0)
    stamp = run(tracker, 0.0, 30, boxes=[box_of(*person) for person in scene.people])
    scene.people = [(900, 400)]
    stamp = run(tracker, stamp, 6, boxes=[box_of(900, 400)])
    scene.people = [(560, 400), (900, 400)]         # outside the window in which it is looked for
    stamp = run(tracker, stamp, 4, boxes=[box_of(*person) for person in scene.people])
    assert [(track.id, track.estimate.centre[0]) for track in tracker.published(stamp - STEP)] == [
        ("b0", 560.0), ("b1", 900.0)]


def test_reset_forgets_everybody():
    tracker = make(Scene([(300, 400)]))
    run(tracker, 0.0, 6, boxes=[box_of(300, 400)])
    tracker.reset()
    assert tracker.tracks == []


def test_limits_of_the_tracker():
    tracker = BodyTracker(SimpleNamespace(), lambda: "aaaaa", 0.1, 1.0,
                          schedule=InferenceScheduler(10.0, most=3, batches=False))
    tracker.limit(0.2, 2.0, 0.7)
    for wrong in ((-1.0, 1.0, 0.5), (0.1, 0.0, 0.5), (0.1, 1.0, 1.0)):
        with pytest.raises(ValueError):
            tracker.limit(*wrong)
    with pytest.raises(ValueError):
        tracker.schedule.limit(-1.0)


class Batches(Scene):
    """A network that is faster with several windows at once; it may fail at it."""

    takes_batches, fails = True, False

    def __init__(self, people):
        super().__init__(people)
        self.sizes = []

    def estimate_all(self, image, windows):
        self.sizes.append(len(windows))
        if self.fails:
            raise RuntimeError("out of memory")
        return [self.estimate(image, one.window, one.hidden, one.shown) for one in windows]


@pytest.mark.parametrize("fails", [False, True])
def test_all_that_are_due_go_into_one_batch_where_that_is_faster(fails, left_out):
    people = [(200, 400), (600, 400), (1000, 400)]
    alone, together = Scene(people), Batches(people)
    together.fails = fails
    guards = [ItemGuard(), ItemGuard()]
    trackers = [make(scene, guard=guard) for scene, guard in zip((alone, together), guards)]
    for tracker in trackers:
        run(tracker, 0.0, 12, boxes=[box_of(*place) for place in people])
    places = [sorted((track.id, tuple(track.estimate.centre)) for track in tracker.tracks) for tracker in trackers]
    assert places[0] == places[1] and len(places[0]) == 3
    assert together.sizes[-1] == 3, "one run for all"
    assert guards[0].errors == 0 and (guards[1].errors > 0) == fails


def test_a_face_under_a_new_id_stays_with_the_body_whose_face_was_there():
    scene = Scene([(600, 400)])
    tracker = make(scene)
    face = face_of(standing_at(600, 400), "f0")
    stamp = run(tracker, 0.0, 40, faces=[face], boxes=[box_of(600, 400)])
    scene.people = [(600, 400), (660, 400)]
    stamp = run(tracker, stamp, 8, faces=[face], boxes=[box_of(600, 400), box_of(660, 400)])
    first, second = tracker.tracks
    assert first.face_id == "f0" and tracker.published(stamp) == [first, second]
    scene.people = [(630, 400)]                 # what is seen of the second has the head of the first
    stamp = run(tracker, stamp, 1)
    assert second.visible and not first.visible
    stamp = run(tracker, stamp, 1, faces=[face_of(standing_at(615, 400), "f1")])
    assert first.face_id == "f1" and second.face_id is None


def test_a_lost_face_is_not_taken_over_far_from_where_it_was():
    scene = Scene([(600, 400)])
    tracker = make(scene)
    stamp = run(tracker, 0.0, 8, faces=[face_of(standing_at(600, 400), "f0")], boxes=[box_of(600, 400)])
    scene.people = [(600, 400), (800, 400)]
    run(tracker, stamp, 4, faces=[face_of(standing_at(800, 400), "f1")], boxes=[box_of(800, 400)])
    assert [track.face_id for track in tracker.tracks] == ["f0", "f1"]


def test_nobody_begins_in_an_ignored_region_and_who_walks_through_it_is_followed():
    scene = Scene([(300, 400), (900, 400)])
    tracker = make(scene, ignored=IgnoredRegions(["0.6 0 0.4 1"]))
    boxes, poster_face = [box_of(300, 400), box_of(900, 400)], face_of(standing_at(900, 400), "f1")
    stamp = run(tracker, 0.0, 10, faces=[poster_face], boxes=boxes)
    assert confirmed(tracker) == ["b0"]
    scene.people = [(300, 400)]
    for step in range(25):
        scene.people = [(300 + 34 * step, 400)]
        stamp = run(tracker, stamp, 1)
    assert confirmed(tracker) == ["b0"]
    assert tracker.tracks[0].visible
