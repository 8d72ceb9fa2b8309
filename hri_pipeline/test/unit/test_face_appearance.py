"""Whether a track is still of the same face: small pictures, templates, cuts of the picture; with faces that do not
exist."""

import dataclasses
import sys

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hri_pipeline.core.camera import Calibration, CameraModel
from hri_pipeline.core.faces.appearance import (
    BLURRED_S,
    CHECK_PERIOD,
    AppearanceMatcher,
    FaceLook,
    Verdict,
    asymmetry,
    correlation,
)
from hri_pipeline.core.faces.crops import aligned_crop, evenness
from hri_pipeline.core.faces.mesh import MESH_POINTS
from hri_pipeline.core.faces.track import FaceMeasurement
from hri_pipeline.core.faces.tracker import DOUBT_TIME, TURNED_DOUBT_TIME, FaceTracker
from hri_pipeline.core.ids import IdGenerator
from hri_pipeline.core.image_rotation import ImageRotation
from hri_pipeline.core.images import PictureCuts
from hri_pipeline.core.recognition.embedding import face_chip

STEP = 0.1
SIZE = 100.0


def mesh(x, y=200.0, size=SIZE, turned=0.0):
    """A mesh about x, y px with the points that place a face; turned: the nose, in halves of the eyes' distance."""
    points = np.random.RandomState(0).uniform(-0.5, 0.5, (MESH_POINTS, 3))
    points[:2, :2] = (-0.5, -0.5), (0.5, 0.5)
    points[[33, 133, 362, 263], :2] = (-0.3, -0.2), (-0.12, -0.2), (0.12, -0.2), (0.3, -0.2)
    points[[2, 4], :2] = (0.0, 0.1), (0.3 * turned, 0.05)
    return points * size + (x, y, 0.0)


def person(seed):
    """A picture (80, 80, 3) that is of one person only."""
    small = np.random.RandomState(seed).randint(0, 255, (9, 9, 1), np.uint8)
    return np.repeat(cv2.resize(small, (120, 120), interpolation=cv2.INTER_CUBIC)[..., None], 3, axis=2)


def scene(*people, light=1.0):
    """A grey image with people, (seed, x) each, about y = 200."""
    image = np.full((400, 800, 3), 90, np.uint8)
    for seed, x in people:
        image[140:260, x - 60:x + 60] = person(seed)
    return (image * light).astype(np.uint8)


def look(image, x, turned=0.0):
    return FaceLook(image, mesh(x, turned=turned))


def measurement(image, x, may_start=True, turned=0.0):
    points = mesh(x, turned=turned)
    return FaceMeasurement(points, 0.99, may_start, look=FaceLook(image, points))


class Network:
    """Stands for the recognition network: people are told apart by the grey values of their crops; counts its runs."""

    def __init__(self):
        self.runs = self.templates = 0

    def __call__(self, crops):
        self.runs, self.templates = self.runs + 1, self.templates + len(crops)
        grey = np.array([cv2.resize(cv2.cvtColor(crop, cv2.COLOR_BGR2GRAY), (8, 8)).ravel() for crop in crops], float)
        grey -= grey.mean(axis=1, keepdims=True)
        return (grey / np.linalg.norm(grey, axis=1, keepdims=True)).astype(np.float32)


@pytest.fixture(params=["templates", "pictures"])
def faces(request):
    judge = AppearanceMatcher(Network(), 150, 0.8) if request.param == "templates" else AppearanceMatcher()
    return FaceTracker(0.0, 1.0, 10, IdGenerator(seed=1), judge=judge)


def show(faces, *images, start=0.0):
    """Show (image, x positions) STEP apart; returns the ids of the faces that were seen, by place."""
    seen = []
    for index, (image, places) in enumerate(images):
        tracks = faces.update([measurement(image, x) for x in places], start + index * STEP, view=(800, 400))
        seen.append({int(round(track.measurement.box[[0, 2]].mean())): track.id for track in tracks})
    return seen


def test_a_look_is_alike_in_any_light_and_unlike_another_person():
    one = look(scene((1, 200)), 200)
    assert correlation(one, look(scene((1, 500), light=0.4), 500)) > 0.97
    assert correlation(one, look(scene((2, 200)), 200)) < 0.7
    assert correlation(one, look(np.full((400, 800, 3), 90, np.uint8), 200)) == 1.0, "nothing to be seen"


def test_asymmetry_is_that_of_the_nose():
    assert asymmetry(mesh(200)) == pytest.approx(0.0)
    assert asymmetry(mesh(200, turned=-0.6)) == pytest.approx(0.6)


def test_somebody_else_at_the_same_place_is_another_face(faces):
    seen = show(faces, *[(scene((1, 200)), [200])] * 5, *[(scene((2, 200)), [200])] * 5)
    assert seen[4][200] == seen[0][200] and seen[9][200] not in (None, seen[0][200])
    assert seen[5].get(200) != seen[0][200], "not for one image"


@pytest.mark.parametrize("presence, begins", [(0.95, True), (0.85, False)])
def test_a_face_that_is_surely_one_needs_no_detection_at_the_place_of_another(faces, presence, begins):
    """The detector need not look where a face is known."""
    first = show(faces, *[(scene((1, 200)), [200])] * 5)[-1][200]
    assert not faces.replaced
    stranger = dataclasses.replace(measurement(scene((2, 200)), 200), may_start=False, presence=presence,
                                   hit_weight=0.0)
    for index in range(5, 9):
        faces.update([stranger], index * STEP)
        assert faces.replaced is (index == 5 or not begins)
        there = {track.id for track in faces.expected((index + 1) * STEP)}
        assert first not in there, "the other one's mesh would be found"
    assert first not in {track.id for track in faces.tracks if track.visible}
    assert [track.visible for track in faces.tracks if track.id in faces.ids] == [False] + [True] * begins


def test_a_new_light_and_a_shift_are_no_other_face(faces):
    seen = show(faces, *[(scene((1, 200), light=0.3), [200])] * 5, *[(scene((1, 220)), [220])] * 5)
    assert seen[9][220] == seen[0][200] and len(faces.tracks) == 1


class DazzledNetwork(Network):
    """To it all who are burnt white are one other person."""

    def __call__(self, crops):
        return super().__call__([person(9) if np.mean(crop > 250) > 0.5 else crop for crop in crops])


@pytest.mark.parametrize("after, is_same", [(1, True), (2, False)])
def test_a_face_that_is_burnt_white_has_no_template_and_is_nobody_else(after, is_same):
    """A camera that has just come out of the dark exposes for too long."""
    faces = FaceTracker(0.0, 1.0, 10, IdGenerator(seed=1), judge=AppearanceMatcher(DazzledNetwork(), 150, 0.8))
    normal, burnt = scene((1, 200)), np.clip(scene((1, 200)) * 2.0 + 140.0, 0, 255).astype(np.uint8)
    assert correlation(look(normal, 200), look(burnt, 200)) < 0.8, "it looks unlike itself"
    seen = show(faces, *[(normal, [200])] * 5, *[(burnt, [200])] * 9, *[(scene((after, 200)), [200])] * 8)
    assert {one[200] for one in seen[:14]} == {seen[0][200]}
    assert (seen[-1][200] == seen[0][200]) is is_same


def shaken(image, length=61, across=False):
    """An image as of a camera that moved by `length` px meanwhile."""
    line = np.full((1, length), 1.0 / length, np.float32)
    return cv2.filter2D(image, -1, line.T if across else line)


class DizzyNetwork(Network):
    """To it all whose details lie along a line are one other person."""

    def __call__(self, crops):
        return super().__call__([person(9) if evenness(crop) < 0.6 else crop for crop in crops])


def dizzy_faces():
    return FaceTracker(0.0, 1.0, 10, IdGenerator(seed=1), judge=AppearanceMatcher(DizzyNetwork(), 150, 0.8))


@pytest.mark.parametrize("across", [False, True])
@pytest.mark.parametrize("after, is_same", [(1, True), (2, False)])
def test_a_face_that_motion_blurs_is_nobody_else_and_is_looked_at_when_it_is_sharp(after, is_same, across):
    faces, sharp = dizzy_faces(), scene((1, 200))
    blurred = shaken(sharp, across=across)
    assert correlation(look(sharp, 200), look(blurred, 200)) < 0.8, "it looks unlike itself"
    seen = show(faces, *[(sharp, [200])] * 5, *[(blurred, [200])] * 9, *[(scene((after, 200)), [200])] * 2)
    assert {one[200] for one in seen[:14]} == {seen[0][200]}
    assert (seen[14].get(200) == seen[0][200]) is is_same


def test_somebody_else_who_comes_in_the_blur_is_told_by_the_first_sharp_look():
    faces = dizzy_faces()
    seen = show(faces, *[(scene((1, 200)), [200])] * 5, *[(shaken(scene((1, 200))), [200])] * 3,
                *[(shaken(scene((2, 200))), [200])] * 3, *[(scene((2, 200)), [200])] * 2)
    assert seen[11].get(200) != seen[0][200]


def test_who_is_first_seen_blurred_is_the_same_when_the_camera_stands():
    seen = show(dizzy_faces(), *[(shaken(scene((1, 200))), [200])] * 9, *[(scene((1, 200)), [200])] * 9)
    assert {one[200] for one in seen} == {seen[0][200]}


def test_who_stays_blurred_looks_so():
    """A smeared lens, or somebody else who seems to be blurred: not for ever."""
    faces, count = dizzy_faces(), int((BLURRED_S + 1.0) / STEP)
    seen = show(faces, *[(scene((1, 200)), [200])] * 5, *[(shaken(scene((1, 200))), [200])] * count)
    assert seen[5 + count // 2][200] == seen[0][200] != seen[-1].get(200)


def test_what_was_lost_goes_on_with_the_same_face_only(faces):
    lost = [(scene(), [])] * 3
    seen = show(faces, *[(scene((1, 200)), [200])] * 5, *lost, *[(scene((1, 230)), [230])] * 2)
    assert seen[-1][230] == seen[0][200]
    faces.reset()
    seen = show(faces, *[(scene((1, 200)), [200])] * 5, *lost, *[(scene((2, 230)), [230])] * 2, start=10.0)
    assert seen[-1][230] != seen[0][200]


def reappearing(*images):
    """Ids of the faces that were seen, by place, and the tracks that live; told apart by templates."""
    faces = FaceTracker(0.0, 1.0, 10, IdGenerator(seed=1), judge=AppearanceMatcher(Network(), 150, 0.8))
    return show(faces, *images), faces.tracks


def test_who_comes_out_far_from_where_the_face_was_lost_is_the_same():
    """Behind a pillar, say."""
    seen, (track,) = reappearing(*[(scene((1, 200)), [200])] * 5, *[(scene(), [])] * 3, (scene((1, 600)), [600]))
    assert seen[8][600] == seen[0][200]
    assert track.detected_at == pytest.approx(8 * STEP), "it lives for as long as any face from now on"


def test_who_may_be_either_of_two_that_were_lost_is_neither():
    seen, tracks = reappearing(*[(scene((1, 100), (1, 700)), [100, 700])] * 5, *[(scene(), [])] * 2,
                               *[(scene((1, 400)), [400])] * 2)
    assert seen[-1][400] not in seen[0].values() and len(tracks) == 3


def test_of_two_who_may_be_the_one_that_was_lost_one_is():
    seen, tracks = reappearing(*[(scene((1, 400)), [400])] * 5, *[(scene(), [])] * 2,
                               (scene((1, 100), (1, 700)), [100, 700]))
    assert len(seen[-1]) == len(tracks) == 2 and seen[0][400] in seen[-1].values()


def test_who_is_in_view_is_not_taken_for_somebody_alike_who_was_lost():
    seen, tracks = reappearing(*[(scene((1, 100), (1, 700)), [100, 700])] * 5, *[(scene((1, 700)), [700])] * 3)
    assert seen[-1][700] == seen[0][700] and len(tracks) == 2


def test_a_face_that_changes_little_by_little_is_the_same(faces):
    """A lamp that moves, a head that turns: each look is like those before."""
    shares = np.linspace(0.0, 1.0, 60)
    images = [(((1.0 - share) * scene((1, 200)) + share * scene((2, 200))).astype(np.uint8), [200])
              for share in shares]
    assert len({names.get(200) for names in show(faces, *images)}) == 1


@pytest.mark.parametrize("stamp, cut, lost", [(1.6, False, False), (0.3, True, False), (0.3, False, True)])
def test_who_stands_half_out_of_the_image_is_looked_at_after_a_stall_a_cut_and_a_loss(stamp, cut, lost):
    faces = FaceTracker(0.0, 1.0, 10, IdGenerator(seed=1), judge=AppearanceMatcher(Network(), 150, 0.8))
    one, other = (measurement(np.ascontiguousarray(scene((seed, 735))[:, :750]), 735) for seed in (1, 2))
    for before in (0.0, 0.1, 0.2):
        faces.update([] if lost and before == 0.2 else [one], before, view=(750, 400))
    name, = faces.ids
    assert [track.id for track in faces.update([other], stamp, view=(750, 400), cut=cut)] != [name]


@pytest.mark.parametrize("seen_for, x, is_same", [(0.5, 720, True), (0.2, 720, False), (0.5, 745, False)])
def test_who_is_half_out_is_somebody_lost_only_where_that_one_just_stood(monkeypatch, seen_for, x, is_same):
    """What the border cuts off looks like anybody."""
    monkeypatch.setattr(AppearanceMatcher, "verdict", lambda *given: Verdict.SAME)
    faces, image = FaceTracker(0.0, 1.0, 10), np.ascontiguousarray(scene((1, 700))[:, :750])
    for stamp in np.arange(0.0, seen_for + 0.01, STEP):
        faces.update([measurement(image, 700)], stamp, view=(750, 400))
    name, = faces.ids
    faces.update([], seen_for + STEP, view=(750, 400))
    found, = faces.update([measurement(image, x)], seen_for + 2 * STEP, view=(750, 400))
    assert (found.id == name) is is_same


def test_after_a_cut_a_face_that_looks_the_same_at_its_place_goes_on(faces):
    name = show(faces, *[(scene((1, 200)), [200])] * 5)[-1][200]
    assert [track.id for track in faces.update([measurement(scene((1, 200)), 200)], 5 * STEP, cut=True)] == [name]


@pytest.mark.parametrize("stall", [1.3, 2.5, 4.5])
def test_after_a_stall_a_face_goes_on_that_is_the_same(faces, stall):
    """A busy machine looks at no image for seconds: nobody was lost meanwhile."""
    before = show(faces, *[(scene((1, 200), (2, 600)), [200, 600])] * 5)[-1]
    after = show(faces, *[(scene((1, 220), (3, 600)), [220, 600])] * 8, start=4 * STEP + stall)[-1]
    assert after[220] == before[200]
    assert after[600] not in before.values()


def test_who_left_during_a_stall_ends_and_after_a_long_one_everybody_is_new(faces):
    before = show(faces, *[(scene((1, 200), (2, 600)), [200, 600])] * 5)[-1]
    after = show(faces, *[(scene((1, 200)), [200])] * 30, start=4 * STEP + 1.5)[-1]
    assert [track.id for track in faces.tracks] == [before[200]] == list(after.values())
    assert show(faces, (scene((1, 200)), [200]), start=100.0)[0][200] != before[200]


def test_who_was_lost_before_a_stall_ends(faces):
    seen = show(faces, *[(scene((1, 200)), [200])] * 5, (scene(), []))
    assert show(faces, (scene((1, 200)), [200]), start=5 * STEP + 2.0)[0][200] != seen[0][200]


def test_who_stood_behind_somebody_that_walked_past_has_the_old_id(faces):
    images = [(scene((1, 400)), [400])] * 5
    images += [(scene((1, 400), (2, x)) if abs(x - 400) > 120 else scene((2, x)),
                [400, x] if abs(x - 400) > 120 else [x]) for x in range(100, 760, 40)]
    seen = show(faces, *images, *[(scene((1, 400)), [400])] * 2)
    assert seen[-1][400] == seen[0][400]
    assert not any(place != 400 and identity == seen[0][400] for one in seen for place, identity in one.items())


def test_after_a_cut_a_face_is_the_one_it_looks_like_wherever_it_is():
    faces = FaceTracker(0.0, 1.0, 10, IdGenerator(seed=1), judge=AppearanceMatcher(Network(), 150, 0.8))
    before = show(faces, *[(scene((1, 200), (2, 600)), [200, 600])] * 5)[-1]
    image = scene((2, 200), (3, 600))
    tracks = faces.update([measurement(image, 200, False), measurement(image, 600)], 0.5, cut=True)
    after = {int(round(track.measurement.box[[0, 2]].mean())): track.id for track in tracks}
    assert after[200] == before[600] and after[600] not in before.values()


def test_after_a_cut_who_is_known_needs_no_detection():
    faces = FaceTracker(0.0, 1.0, 10, IdGenerator(seed=1), judge=AppearanceMatcher(Network(), 150, 0.8))
    before = show(faces, *[(scene((1, 200), (2, 600)), [200, 600])] * 5)[-1]
    image = scene((2, 200), (1, 600))
    faces.update([dataclasses.replace(measurement(image, x, False), presence=0.85) for x in (200, 600)], 0.5, cut=True)
    after = {int(round(track.measurement.box[[0, 2]].mean())): track.id for track in faces.tracks if track.visible}
    assert after == {200: before[600], 600: before[200]}


def test_the_network_runs_seldom_on_a_face_that_goes_on():
    network = Network()
    faces = FaceTracker(0.0, 1.0, 10, IdGenerator(seed=1), judge=AppearanceMatcher(network, 150, 0.8))
    show(faces, *[(scene((1, 200)), [200])] * 100)
    assert 1 <= network.runs <= 6


def test_a_face_without_a_template_is_compared_with_its_oldest_view():
    """Who is not looked at by recognition (turned away, or nobody asks who people are) cost six templates at once."""
    network, image = Network(), scene((1, 200))
    judge = AppearanceMatcher(network, 150, 0.8)
    memory = judge.begin(look(image, 200), 0.0)
    for stamp in (0.5, 1.0, 1.5, 2.0):
        judge.remember(memory, look(image, 200), stamp)
    assert judge.verdict(memory, look(image, 200), CHECK_PERIOD) is Verdict.SAME and network.templates == 2
    assert memory.views[0].template is not None
    assert judge.verdict(memory, look(scene((2, 200)), 200), CHECK_PERIOD) is Verdict.OTHER


@pytest.mark.parametrize("given", [True, False])
def test_templates_that_recognition_has_made_replace_the_checks(given):
    """Ten faces were asked of the network five times a second beside recognition, which had just asked it. A face of
    ten with a sure name is due each 1.8 s, and waits for its turn."""
    network, other = Network(), Network()
    faces = FaceTracker(0.0, 1.0, 10, IdGenerator(seed=1), judge=AppearanceMatcher(network, 150, 0.8))
    image = scene((1, 200))
    for step in range(300):
        stamp = step * STEP
        name = faces.update([measurement(image, 200)], stamp)[0].id
        if given and step % 23 == 22:
            faces.take_templates({name: other([face_chip(image, mesh(200), 150)])[0]}, stamp)
    checks = 300 * STEP / CHECK_PERIOD
    assert network.runs == 1 if given else network.runs >= checks - 2, "one template to compare with"


def test_the_first_template_of_recognition_is_the_one_to_compare_with():
    """Ten people who came together were asked of the network once more after 3 s, with all their views: in six images
    for 12 templates each."""
    network, other = Network(), Network()
    judge, image = AppearanceMatcher(network, 150, 0.8), scene((1, 200))
    memory = judge.begin(look(image, 200), 0.0)
    for stamp in (0.5, 1.0, 1.5):
        judge.remember(memory, look(image, 200), stamp)
    judge.take_template(memory, other([face_chip(image, mesh(200), 150)])[0], 1.5)
    assert memory.checked == 0.0, "there was nothing to compare with"
    assert judge.verdict(memory, look(image, 200), CHECK_PERIOD) is Verdict.SAME and network.runs == 1
    assert judge.verdict(memory, look(scene((2, 200)), 200), CHECK_PERIOD) is Verdict.OTHER


@pytest.mark.parametrize("image, is_taken", [(scene((1, 200)), True), (shaken(scene((1, 200))), False),
                                             (np.full((400, 800, 3), 255, np.uint8), False)])
def test_of_a_spoilt_look_there_is_no_first_template(image, is_taken):
    judge, sharp = AppearanceMatcher(Network(), 150, 0.8), scene((1, 200))
    memory = judge.begin(look(sharp, 200), 0.0)
    judge.remember(memory, look(image, 200), 1.0)
    judge.take_template(memory, np.ones(64, np.float32) / 8.0, 1.0)
    assert any(view.template is not None for view in memory.views) is is_taken


def test_templates_go_to_their_faces_unless_these_are_in_doubt(monkeypatch):
    taken, judge = [], AppearanceMatcher()
    monkeypatch.setattr(judge, "take_template", lambda memory, template, stamp: taken.append(memory))
    faces = FaceTracker(0.0, 1.0, 10, IdGenerator(seed=1), judge=judge)
    show(faces, (scene((1, 200), (2, 600)), [200, 600]))
    one, other = faces.tracks
    faces.take_templates({one.id: np.ones(1)}, 0.0)
    one.doubtful_since = 0.0
    faces.take_templates({one.id: np.ones(1), other.id: np.ones(1)}, 0.0)
    assert taken == [one.memory, other.memory]


def test_a_template_of_somebody_else_neither_is_a_check_nor_becomes_a_view():
    network = Network()
    judge = AppearanceMatcher(network, 150, 0.8)
    image = scene((1, 200))
    memory = judge.begin(look(image, 200), 0.0)
    judge.verdict(memory, look(image, 200), 0.0)
    judge.remember(memory, look(image, 200), 1.0)
    judge.take_template(memory, network([face_chip(scene((2, 200)), mesh(200), 150)])[0], 1.0)
    assert memory.checked == 0.0 and memory.last.template is None
    judge.take_template(memory, network([face_chip(image, mesh(200), 150)])[0], 0.5)
    assert memory.checked == 0.0, "of another image"
    judge.take_template(memory, network([face_chip(image, mesh(200), 150)])[0], 1.0)
    assert memory.checked == 1.0 and memory.views[-1] is memory.last


def test_crops_are_aligned_as_the_network_wants_them():
    seen, image = [], scene((1, 200))

    def embed(crops):
        seen.extend(crops)
        return np.tile(np.float32([1.0, 0.0]), (len(crops), 1))
    judge = AppearanceMatcher(embed, 112, 1.08, "arcface")
    judge.distance(judge.begin(look(image, 200), 0.0), look(image, 200))
    wanted = face_chip(image, mesh(200), 112, alignment="arcface")
    assert len(seen) == 2 and all(np.array_equal(crop, wanted) for crop in seen)


@pytest.mark.parametrize("followed", [True, False])
def test_a_face_that_waited_for_its_turn_is_checked_only_where_the_flow_lost_it(followed):
    """On a slow machine each face of a crowd waits for half a second: a template each time would make it slower."""
    network = Network()
    faces = FaceTracker(0.0, 1.0, 10, IdGenerator(seed=1), judge=AppearanceMatcher(network, 150, 0.8))
    name = show(faces, (scene((1, 200)), [200]))[0][200]
    for step in range(1, 16):
        for track in faces.tracks:
            track.move(np.zeros(2) if followed else None, 0.12 * step)
        if step % 5:
            faces.update([], 0.12 * step, [name])
        else:
            faces.update([measurement(scene((1, 200)), 200)], 0.12 * step)
    assert [track.id for track in faces.tracks] == [name]
    assert (network.runs == 0) == followed
    for track in faces.tracks:
        track.move(np.zeros(2), 1.9)
    assert name not in [track.id for track in faces.update([measurement(scene((2, 200)), 200)], 1.9) if track.visible]


@pytest.mark.parametrize("missed, stamp, cut, doubtful", [
    (None, 0.2, False, False), (0.2, 0.3, False, False), (0.2, 0.8, False, True), (None, 1.5, False, True),
    (None, 0.2, True, True)])
def test_after_a_loss_a_stall_or_a_cut_nothing_but_its_looks_speaks_for_a_face(monkeypatch, missed, stamp, cut,
                                                                               doubtful):
    asked, faces = [], FaceTracker(0.0, 1.0, 10, IdGenerator(seed=1))
    monkeypatch.setattr(AppearanceMatcher, "verdict", lambda *given: asked.append(given[4]) or Verdict.SAME)
    show(faces, *[(scene((1, 200)), [200])] * 2)
    for track in faces.tracks:
        track.move(np.zeros(2), missed or stamp)        # so far the flow has followed it
    if missed:
        faces.update([], missed)
    faces.update([measurement(scene((2, 200)), 200)], stamp, cut=cut)
    assert asked == [doubtful]


@pytest.mark.parametrize("turned, lasts", [(0.0, DOUBT_TIME), (0.6, TURNED_DOUBT_TIME)])
@pytest.mark.parametrize("confirmed", [False, True])
def test_what_looks_like_neither_is_the_same_face_for_a_moment(monkeypatch, turned, lasts, confirmed):
    def verdict(judge, memory, seen, stamp, *more):
        return Verdict.SAME if confirmed and stamp == again else Verdict.UNSURE

    monkeypatch.setattr(AppearanceMatcher, "verdict", verdict)
    faces, again = FaceTracker(0.0, 1.0, 10, IdGenerator(seed=1)), 0.5 + lasts - 0.05
    name = show(faces, *[(scene((1, 200)), [200])] * 3)[-1][200]
    ids = [faces.update([measurement(scene((2, 200)), 200, turned=turned)], stamp)[0].id
           for stamp in (0.5, again, 0.5 + lasts + 0.05)]
    assert ids[:2] == [name, name] and (ids[2] == name) is confirmed


def test_who_was_not_found_after_a_cut_is_doubted_later_too(monkeypatch):
    asked, faces = [], FaceTracker(0.0, 1.0, 10, IdGenerator(seed=1))
    monkeypatch.setattr(AppearanceMatcher, "verdict", lambda *given: asked.append(given[4]) or Verdict.SAME)
    show(faces, *[(scene((1, 200)), [200])] * 2)
    faces.update([], 0.2, cut=True)
    faces.update([measurement(scene((1, 200)), 200)], 0.3)
    assert asked == [True]


def test_a_verdict_that_is_not_clear_is_no_change_of_face():
    judge = AppearanceMatcher(lambda crops: np.tile(np.float32([1.0, 0.0]), (len(crops), 1)), 150, 0.4)
    memory = judge.begin(look(scene((1, 200)), 200), 0.0)
    angles = {Verdict.SAME: 0.30, Verdict.UNSURE: 0.36, Verdict.OTHER: 0.60}
    for verdict, angle in angles.items():
        seen = look(scene((2, 200)), 200)
        seen.keep_crop(150)
        seen.template = np.float32([np.cos(angle), np.sin(angle)])
        assert judge.verdict(memory, seen, 1.0) is verdict
        assert judge.verdict(memory, seen, 1.0, doubtful=True) is (
            Verdict.SAME if verdict is Verdict.SAME else Verdict.OTHER)


@pytest.mark.parametrize("alignment", ["dlib", "arcface"])
@pytest.mark.parametrize("x, y, size", [(400, 200, 60.0), (20, 30, 60.0), (790, 390, 90.0), (300, 200, 250.0)])
@pytest.mark.parametrize("calibration", [Calibration.CALIBRATED, Calibration.MISSING])
def test_a_part_of_the_image_gives_the_crop_of_the_whole(x, y, size, alignment, calibration):
    image = cv2.GaussianBlur(np.random.RandomState(3).randint(0, 255, (400, 800, 3), np.uint8), (0, 0), 2.0)
    camera = CameraModel.from_fov(800, 400, 1.2, calibration)
    angle = Rotation.from_euler("z", 40.0, degrees=True).as_matrix()
    points = (mesh(0, 0, size) @ angle.T) + (x, y, 0.0)
    whole, part = FaceLook(image, points, camera), FaceLook(image, points, camera)
    whole.keep_crop(150, alignment)
    part.keep_part(150, alignment)
    assert part.prepare(150, alignment)
    assert np.abs(part.crop.astype(int) - whole.crop.astype(int)).max() <= 1


def test_a_face_too_small_for_a_template_is_compared_by_its_picture():
    judge = AppearanceMatcher(Network(), 150, 0.8)
    small = [FaceLook(scene((seed, 200)), mesh(200, size=20.0)) for seed in (1, 1, 2)]
    memory = judge.begin(small[0], 0.0)
    assert judge.distance(memory, small[1]) is None
    assert judge.verdict(memory, small[1], 0.1) is Verdict.SAME


@pytest.mark.parametrize("turned, light, same", [(0.4, 1.0, True), (0.05, 1.0, False), (0.4, 0.5, False)])
def test_a_head_that_turns_between_two_looks_is_no_other_face(turned, light, same):
    """Its small picture changes as much as that of another face; its colours do not."""
    faces, seen = FaceTracker(0.0, 1.0, 10, IdGenerator(seed=1), judge=AppearanceMatcher()), []
    for index, (seed, turn) in enumerate([(1, 0.0)] * 3 + [(2, turned)] * 3):
        image = scene((seed, 200), light=1.0 if index < 3 else light)
        points = mesh(200, turned=turn)
        faces.update([FaceMeasurement(points, 0.99, True, np.full((5, 4, 3), 0.4 * (1.0 if index < 3 else light)),
                                      look=FaceLook(image, points))], 0.25 * index)
        seen.append([track.id for track in faces.tracks if track.visible])
    assert (seen[-1] == seen[0]) is same


def view(seed, shift=(0, 0), light=1.0, offset=0.0):
    """A picture of a room, seen by a camera that has moved by `shift` px."""
    small = np.random.RandomState(seed).randint(0, 255, (16, 22, 3), np.uint8)
    room = cv2.resize(small, (880, 640), interpolation=cv2.INTER_CUBIC)
    x, y = 120 + shift[0], 80 + shift[1]
    return np.clip(room[y:y + 480, x:x + 640] * light + offset, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("after, is_cut", [
    (view(1), False), (view(1, (100, 0)), False), (view(1, (-60, 40)), False), (view(1, light=0.3), False),
    (view(1, light=0.6, offset=60.0), False), (view(2), True)])
def test_cuts_of_the_picture(after, is_cut):
    cuts = PictureCuts()
    assert not cuts.update(view(1)), "nothing before"
    assert cuts.update(after) is is_cut
    assert not cuts.update(after)


NOTHING = {"no light": view(1, light=0.01), "white": np.full((480, 640, 3), 255, np.uint8),
           "green": np.full((480, 640, 3), (0, 135, 0), np.uint8),
           "noise in the dark": np.random.default_rng(1).normal(12.0, 6.0, (480, 640, 3)).clip(0, 255).astype(np.uint8)}


@pytest.mark.parametrize("nothing", sorted(NOTHING))
@pytest.mark.parametrize("after, is_cut", [(view(1, (10, 5)), False), (view(1, light=0.5), False), (view(2), True)])
def test_what_comes_after_a_picture_of_nothing_is_compared_with_what_was_before_it(nothing, after, is_cut):
    cuts = PictureCuts()
    cuts.update(view(1))
    for _ in range(3):
        assert not cuts.update(NOTHING[nothing]) and cuts.blank
    assert cuts.update(after) is is_cut and not cuts.blank
    assert not cuts.update(after)


def test_pictures_of_nothing_are_a_scene_of_their_own_after_three_seconds():
    cuts = PictureCuts()
    cuts.update(view(1), 1.0)
    told = [(cuts.update(NOTHING["green"], stamp), cuts.blank) for stamp in (2.0, 4.0, 4.1, 4.2)]
    assert told == [(False, True), (False, True), (True, False), (False, False)]
    assert cuts.update(view(1), 4.3)


def half_grey(image):
    """An image of which the rest did not arrive."""
    image = image.copy()
    image[200:] = 128
    return image


def test_a_single_image_of_which_a_part_is_missing_is_passed_over():
    cuts = PictureCuts()
    told = [(cuts.update(image, 1.0 + 0.1 * step), cuts.blank) for step, image in enumerate(
        [view(1), view(1), half_grey(view(1)), view(1, (9, 0)), view(1), half_grey(view(1)), view(1)])]
    assert told == [(False, number in (2, 5)) for number in range(7)]


def test_half_images_are_a_scene_of_their_own_after_a_while():
    cuts = PictureCuts()
    cuts.update(view(1), 1.0)
    assert [cuts.update(half_grey(view(1)), stamp) or cuts.blank for stamp in (1.1, 1.2, 1.29, 1.4, 1.5)] == [
        True, True, True, False, False]
    assert not cuts.update(view(1), 1.6) and not cuts.blank


@pytest.mark.parametrize("offset", [-400.0, 400.0])
def test_light_that_burns_a_part_of_the_picture_white_or_black_damages_nothing(offset):
    cuts = PictureCuts()
    cuts.update(view(1), 1.0)
    image = view(1)
    image[:120] = np.clip(image[:120] + offset, 0, 255)
    assert not cuts.update(image, 1.1) and not cuts.blank


def test_bars_at_the_sides_of_a_picture_damage_nothing_where_it_is_turned():
    image = view(1)
    image[:, :120], image[:, -120:] = 128, 128
    cuts = PictureCuts()
    cuts.update(image, 1.0)
    rotation = ImageRotation(1, 640, 480)
    cuts.turn(rotation)
    assert not cuts.update(rotation.image(image), 1.1) and not cuts.blank


@pytest.mark.parametrize("bars", [0.0, 128.0])
def test_bars_and_a_floor_of_one_colour_stay(bars):
    cuts = PictureCuts()
    for step in range(20):
        image = view(1, (2 * step, 0))
        image[:100], image[-100:] = bars, bars
        assert not cuts.update(image, 1.0 + 0.1 * step) and not cuts.blank


def test_a_wall_with_somebody_far_away_before_it_is_not_nothing():
    cuts = PictureCuts()
    for x in range(400, 500, 10):
        wall = np.full((480, 640, 3), 150, np.uint8)
        wall[300:320, x:x + 12] = 60
        assert not cuts.update(wall) and not cuts.blank


def test_somebody_who_walks_through_the_picture_is_no_cut():
    cuts = PictureCuts()
    for x in range(-150, 640, 40):
        image = view(1)
        image[100:, max(0, x):max(0, x + 150)] = 200
        assert not cuts.update(image)


@pytest.mark.parametrize("after, changed", [(view(1), False), (view(1, (60, 0)), True), (view(2), True)])
def test_whether_most_of_the_picture_has_changed(after, changed):
    cuts = PictureCuts()
    cuts.update(view(1))
    assert not cuts.changed, "nothing before"
    cuts.update(after)
    assert cuts.changed is changed
    cuts.update(after)
    assert not cuts.changed


@pytest.mark.parametrize("rate", [2.0, 3.0])
def test_two_who_cross_before_a_wall_are_no_cut(rate):
    """They fill the middle of the picture and move against each other, and the wall has no pattern."""
    cuts = PictureCuts()
    for stamp in np.arange(0.0, 3.4, 1.0 / rate):
        image = np.repeat(np.linspace(120, 150, 1280)[None, :, None], 720, axis=0).repeat(3, axis=2).astype(np.uint8)
        for x in (300 + 200 * stamp, 980 - 200 * stamp):
            image[160:290, int(x) - 35:int(x) + 35] = 60
            image[290:, int(x) - 70:int(x) + 70] = 40
        assert not cuts.update(image), stamp


def test_empty_pictures_are_no_cut_and_any_size_is_taken():
    cuts = PictureCuts()
    assert not any(cuts.update(np.full(shape, 7, np.uint8)) for shape in ((480, 640, 3), (1, 1, 3), (3, 900, 3)))


def test_who_is_not_there_any_more_takes_nobody_s_place():
    """After a cut there are as many others at once, although the faces of before are remembered for a moment."""
    places = (100, 300, 500, 700)
    faces = FaceTracker(0.0, 1.0, 4, IdGenerator(seed=1), judge=AppearanceMatcher(Network(), 150, 0.8))
    before = show(faces, *[(scene(*enumerate(places)), places)] * 3)[-1]
    image = scene(*enumerate(places, 4))
    tracks = faces.update([measurement(image, place) for place in places], 0.3, cut=True)
    assert len(tracks) == 4 and not {track.id for track in tracks} & set(before.values())


@pytest.mark.parametrize("missed", [1, 3])
@pytest.mark.parametrize("may_start", [True, False])
def test_who_stands_half_out_of_the_image_keeps_the_id_when_an_image_misses_the_face(faces, missed, may_start):
    image, ids = np.ascontiguousarray(scene((1, 735))[:, :750]), set()
    for index in range(14):
        found = [] if 6 <= index < 6 + missed else [measurement(image, 735, may_start or index < 6)]
        tracks = faces.update(found, index * STEP, view=(750, 400))
        assert len(tracks) == len(found)
        ids |= {track.id for track in tracks}
    assert len(ids) == 1


def looked_at(camera, turn):
    """A picture that a pinhole camera has taken ahead, as `camera` sees it that is turned, and a mesh on it, in
    both."""
    ahead = CameraModel(640, 480, np.array([[600.0, 0, 320], [0, 600.0, 240], [0, 0, 1]]), np.zeros(0), "plumb_bob",
                        Calibration.CALIBRATED)
    texture = cv2.GaussianBlur(np.random.RandomState(3).uniform(0, 255, (480, 640, 3)), (0, 0), 6.0)
    texture = cv2.normalize(texture, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = camera.normalise(np.column_stack([columns.ravel(), rows.ravel()]))
    places = ahead.project(np.column_stack([rays, np.ones(len(rays))]) @ turn).astype(np.float32)
    seen = cv2.remap(texture, places.reshape(camera.height, camera.width, 2), None, cv2.INTER_LINEAR)
    points = mesh(320, size=120.0)[:, :2]
    rays = np.column_stack([ahead.normalise(points), np.ones(len(points))])
    return texture, points, seen, camera.project(rays @ turn.T), ahead


@pytest.mark.parametrize("camera", [
    CameraModel(1280, 720, np.array([[460.0, 0, 640], [0, 460.0, 360], [0, 0, 1]]), np.zeros(0), "plumb_bob",
                Calibration.CALIBRATED),
    CameraModel(1280, 720, np.array([[500.0, 0, 640], [0, 500.0, 360], [0, 0, 1]]), np.zeros(4), "equidistant",
                Calibration.CALIBRATED)], ids=["wide", "fisheye"])
@pytest.mark.parametrize("aside", [(0, 36), (20, -25)])
def test_the_crop_for_a_template_is_the_same_wherever_in_the_image_a_face_is(camera, aside):
    turn = Rotation.from_euler("xy", aside, degrees=True).as_matrix()
    texture, points, seen, places, ahead = looked_at(camera, turn)
    wanted = face_chip(texture, points, 112, camera=ahead)
    assert np.abs(face_chip(texture, points, 112).astype(float) - wanted).mean() < 4.0, "nothing is changed ahead"
    found, stretched = (face_chip(seen, places, 112, camera=one) for one in (camera, None))
    guessed = CameraModel.from_fov(1280, 720, 1.9)
    assert (face_chip(seen, places, 112, camera=guessed) == stretched).all(), "a guess changes nothing"
    apart, before = (np.abs(chip.astype(float) - wanted).mean() for chip in (found, stretched))
    assert apart < 2.5 and before > 2.0 * apart


@pytest.mark.parametrize("camera", [
    CameraModel(1280, 720, np.array([[460.0, 0, 640], [0, 460.0, 360], [0, 0, 1]]), np.zeros(0), "plumb_bob",
                Calibration.CALIBRATED),
    CameraModel(1280, 720, np.array([[560.0, 0, 640], [0, 560.0, 360], [0, 0, 1]]), np.array([-0.28, 0.07, 0.0, 0.0]),
                "plumb_bob", Calibration.CALIBRATED),
    CameraModel(1280, 720, np.array([[500.0, 0, 640], [0, 500.0, 360], [0, 0, 1]]), np.zeros(4), "equidistant",
                Calibration.CALIBRATED)], ids=["wide", "lens", "fisheye"])
@pytest.mark.parametrize("aside", [(0, 36), (20, -25)])
@pytest.mark.parametrize("size", [40, 112])
def test_the_upright_crop_is_the_same_wherever_in_the_image_a_face_is(camera, aside, size):
    turn = Rotation.from_euler("xy", aside, degrees=True).as_matrix()
    texture, points, seen, places, ahead = looked_at(camera, turn)
    wanted = aligned_crop(texture, points, size, 1.15)
    assert (aligned_crop(texture, points, size, 1.15, ahead) == wanted).all(), "nothing is changed ahead"
    found, stretched = (aligned_crop(seen, places, size, 1.15, one) for one in (camera, None))
    guessed = CameraModel.from_fov(1280, 720, 1.9)
    assert (aligned_crop(seen, places, size, 1.15, guessed) == stretched).all(), "a guess changes nothing"
    apart, before = (np.abs(crop.astype(float) - wanted).mean() for crop in (found, stretched))
    assert apart < 3.0 and before > 2.0 * apart


@pytest.mark.parametrize("size", [80.0, 400.0])
def test_a_view_keeps_no_part_of_the_image_once_its_crop_is_made(size):
    """Six views of each of ten faces would be 16 MB."""
    image = np.random.RandomState(1).randint(0, 255, (720, 1280, 3)).astype(np.uint8)
    before, look = sys.getrefcount(image), FaceLook(image, mesh(600, size=size))
    look.keep_part(150)
    assert sys.getrefcount(image) == before, "nor all of it"
    assert look.prepare(150)
    kept = [value for value in vars(look).values() if isinstance(value, np.ndarray) and value.ndim == 3]
    assert [value.shape for value in kept] == [(150, 150, 3)] and kept[0].base is None


def test_points_in_one_place_have_no_other_view():
    assert CameraModel.from_fov(640, 480, 1.0).facing_map(np.full((5, 2), 100.0)) == pytest.approx(np.eye(3))


@pytest.mark.parametrize("last", [760, 790, 820])
def test_who_leaves_the_image_after_somebody_else_is_not_taken_for_that_one(last):
    """What the border cuts off looks like nobody: a camera turned, and who left last had the id of the one before."""
    faces, owners = FaceTracker(0.0, 1.0, 10, IdGenerator(seed=1), judge=AppearanceMatcher(Network(), 150, 0.8)), {}
    for index, x in enumerate([440, 440, 440, 490, 540, 590, 640, 690, 740, last]):
        image = np.full((400, 1200, 3), 90, np.uint8)
        for seed, place in ((1, x), (2, x + 160)):
            image[140:260, place - 60:place + 60] = person(seed)
        image = np.ascontiguousarray(image[:, :800])
        for track in faces.update([measurement(image, place) for place in (x, x + 160) if place < 840], index * STEP,
                                  view=(800, 400)):
            second = abs(track.measurement.box[[0, 2]].mean() - x) > 80
            owners.setdefault(track.id, set()).add(second)
    assert list(owners.values()) == [{False}, {True}]
