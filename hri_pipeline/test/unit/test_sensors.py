"""What sensors say of a scene: noise, gaps, hidden people, ids."""

import math
from dataclasses import replace

import numpy as np
import pytest

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.ids import is_valid_id
from hri_pipeline.core.parameters import ParameterError
from hri_pipeline.core.simulation.agents import Alternation, Noise, keypoints, landmarks
from hri_pipeline.core.simulation.parameters import sense_defaults
from hri_pipeline.core.simulation.scene_file import parse_scene
from hri_pipeline.core.simulation.sensors import BODY, FACE, PERSON, SceneMatches, Senses
from hri_pipeline.core.simulation.world import World

QUIET = {"look_robot": 1.0, "look_away": 0.0, "dwell": 5.0, "turn": 0.0}
CLEAN = {"sense_dropout": 0.0, "sense_lid_errors": 0.0, "sense_birth_delay": 0.0, "sense_position_noise": 0.0,
         "sense_depth_noise": 0.0, "sense_head_noise": 0.0, "sense_gaze_noise": 0.0, "sense_body_noise": 0.0,
         "sense_voice_noise": 0.0}


def scene(*people, **changes):
    return parse_scene(dict({"duration": 300.0, "habits": QUIET, "people": list(people)}, **changes))


def at_robot(name, x, y, **more):
    return dict({"name": name, "at": [x, y], "yaw": math.degrees(math.atan2(-y, -x)), "orders": [{"look_at": "robot"}]},
                **more)


def run(the_scene, seconds, rate=15.0, seed=0, **settings):
    world, senses = World(the_scene), Senses(sense_defaults(**settings), seed, the_scene.robot.height)
    for number in range(int(seconds * rate)):
        truth = world.at(number / rate)
        yield truth, senses.sense(truth)


def run_still(the_scene, seconds, rate=4.0, **settings):
    """The same moment of a scene, again and again: for the noise alone."""
    truth, senses = World(the_scene).at(2.0), Senses(sense_defaults(**settings), 0, the_scene.robot.height)
    for number in range(int(seconds * rate)):
        now = replace(truth, stamp=number / rate)
        yield now, senses.sense(now)


def test_without_faults_everything_is_as_it_is():
    for truth, sensed in run(scene(at_robot("ann", 2.0, 0.5)), 2.0, **CLEAN):
        person, face, body = truth.people[0], sensed.faces[0], sensed.bodies[0]
        assert sensed.camera.apply(face.pose.translation[None])[0] == pytest.approx(person.head)
        assert sensed.camera.rotation @ face.pose.rotation == pytest.approx(person.head_rotation)
        assert sensed.camera.rotation @ face.gaze == pytest.approx(person.gaze)
        assert body.head.translation == pytest.approx(face.pose.translation)
        hips = sensed.camera.apply(body.pose.translation[None])[0]
        assert hips[:2] == pytest.approx(person.position)
        assert sensed.visible == {"ann"}


@pytest.mark.parametrize("place, face, body", [
    ((2.0, 0.0), True, True), ((8.0, 0.0), False, True), ((20.0, 0.0), False, False),     # too far
    # outside the image, behind the robot
    ((2.0, 2.5), False, False), ((-2.0, 0.0), False, False)])
def test_field_of_view_and_range(place, face, body):
    last = list(run(scene(at_robot("ann", *place)), 1.0, **CLEAN))[-1][1]
    assert (bool(last.faces), bool(last.bodies)) == (face, body)


def test_somebody_from_behind_has_a_body_and_no_face():
    last = list(run(scene({"name": "ann", "at": [2.0, 0.0], "yaw": 0.0}, habits=dict(QUIET, dwell=0.0)), 1.0,
                    **CLEAN))[-1][1]
    assert (len(last.faces), len(last.bodies)) == (0, 1)


def test_who_stands_in_front_hides_who_stands_behind():
    behind = scene(at_robot("ann", 2.0, 0.0, stature=1.75), at_robot("bob", 3.5, 0.0, stature=1.70))
    last = list(run(behind, 1.0, **CLEAN))[-1][1]
    assert [body.person for body in last.bodies] == ["ann"]
    assert last.visible == {"ann"}
    last = list(run(behind, 1.0, sense_occlusion=False, **CLEAN))[-1][1]
    assert [body.person for body in last.bodies] == ["ann", "bob"]


def test_a_tall_head_is_seen_over_a_small_one():
    last = list(run(scene(at_robot("ann", 2.0, 0.0, stature=1.2), at_robot("bob", 3.0, 0.0, stature=1.9)), 1.0,
                    **CLEAN))[-1][1]
    assert {face.person for face in last.faces} == {"ann", "bob"}


@pytest.mark.parametrize("name, degrees", [("sense_gaze_noise", 8.0), ("sense_head_noise", 5.0)])
def test_the_noise_has_the_size_that_was_asked_for(name, degrees):
    angles = []
    for truth, sensed in run_still(scene(at_robot("ann", 2.0, 0.0)), 400.0, **dict(CLEAN, **{name: degrees})):
        person, face = truth.people[0], sensed.faces[0]
        seen, true = (face.gaze, person.gaze) if "gaze" in name else (face.pose.rotation[:, 0],
                                                                      person.head_rotation[:, 0])
        angles.append(math.degrees(math.acos(min(1.0, float(sensed.camera.rotation @ seen @ true)))))
    # On two axes: Rayleigh, whose mean square is twice the variance of an axis.
    assert math.sqrt(np.mean(np.square(angles)) / 2.0) == pytest.approx(degrees, rel=0.12)


def test_distance_is_less_exact_than_direction():
    settings = dict(CLEAN, sense_position_noise=0.02, sense_depth_noise=0.05)
    errors = np.array([sensed.faces[0].pose.translation - (sensed.camera.inverse().apply(truth.people[0].head[None])[0])
                       for truth, sensed in run_still(scene(at_robot("ann", 3.0, 0.0)), 200.0, **settings)])
    assert errors[:, 2].std() == pytest.approx(0.15, rel=0.25)
    assert errors[:, 0].std() == pytest.approx(0.02, rel=0.25)


def test_gaps_have_their_share_and_ids_outlive_short_ones():
    measured, ids = [], set()
    for _, sensed in run_still(scene(at_robot("ann", 2.0, 0.0)), 500.0, sense_dropout=0.2, sense_dropout_time=0.5,
                               sense_hold=5.0):
        for face in sensed.faces:
            measured.append(face.measured)
            ids.add(face.id)
    assert 1.0 - np.mean(measured) == pytest.approx(0.2, abs=0.05)
    assert len(ids) == 1


def test_a_long_gap_ends_an_id():
    ids, shown = [], []
    for _, sensed in run_still(scene(at_robot("ann", 2.0, 0.0)), 120.0, sense_dropout=0.4, sense_dropout_time=3.0,
                               sense_hold=0.5):
        shown.append(bool(sensed.faces))
        ids += [face.id for face in sensed.faces if face.id not in ids]
    assert len(ids) > 5
    assert 0.3 < np.mean(shown) < 0.9
    assert all(is_valid_id(identity) for identity in ids)


def test_ids_change_out_of_nothing_as_often_as_asked():
    ids = {face.id for _, sensed in run_still(scene(at_robot("ann", 2.0, 0.0)), 300.0, sense_id_changes=6.0,
                                              sense_dropout=0.0)
           for face in sensed.faces}
    assert 15 <= len(ids) <= 50


def test_ids_are_never_given_again():
    the_scene = scene(at_robot("ann", 2.0, 0.0), at_robot("bob", 2.0, 1.0))
    world, senses = World(the_scene), Senses(sense_defaults(**CLEAN))
    first = {body.id for number in range(30) for body in senses.sense(world.at(number / 15.0)).bodies}
    again = {body.id for number in range(30) for body in senses.sense(world.at(number / 15.0)).bodies}
    assert len(first) == len(again) == 2
    assert not first & again


def test_ghosts_are_faces_of_nobody():
    ghosts = [face for _, sensed in run_still(scene(at_robot("ann", 2.0, 0.0)), 120.0, sense_ghosts=10.0, **CLEAN)
              for face in sensed.faces if not face.person]
    assert 8 <= len({face.id for face in ghosts}) <= 40
    assert all(face.pose.translation[2] > 0.5 for face in ghosts)


def test_each_kind_has_its_rate():
    fresh = [sensed.fresh for _, sensed in run(scene(at_robot("ann", 2.0, 0.0)), 10.0, sense_face_rate=5.0,
                                               sense_body_rate=10.0)]
    assert sum("faces" in kinds for kinds in fresh) == pytest.approx(50, abs=2)
    assert sum("bodies" in kinds for kinds in fresh) == pytest.approx(100, abs=2)
    assert sum("voices" in kinds for kinds in fresh) == 150


def test_who_speaks_is_a_voice_with_a_direction():
    the_scene = scene(at_robot("ann", 2.0, 1.0, orders=[{"at": 1.0, "talk": 2.0}]))
    heard = [sensed.voices for _, sensed in run(the_scene, 8.0, **CLEAN)]
    assert heard[10] == () and heard[100] == ()
    voice = heard[30][0]
    assert voice.speaking and voice.direction[0] < -0.3 and voice.direction[2] > 0.8
    assert len({voice.id for voices in heard for voice in voices}) == 1
    assert not heard[50][0].speaking


def test_closed_eyes_have_no_gaze():
    the_scene = scene(at_robot("ann", 2.0, 0.0, orders=[{"at": 1.0, "close_eyes": 2.0}]))
    faces = [sensed.faces[0] for _, sensed in run(the_scene, 5.0, **CLEAN)]
    assert faces[30].gaze is None and faces[30].eyes_closed > 0.9
    assert faces[70].gaze is not None and faces[70].eyes_closed < 0.1


@pytest.mark.parametrize("name, value",
                         [("sense_dropout", 1.0), ("sense_hfov", 0.0), ("sense_hold", -1.0), ("rate", 0.0)])
def test_illegal_settings(name, value):
    with pytest.raises(ParameterError, match=name):
        sense_defaults(**{name: value})


def test_alternation_and_noise():
    import random
    with pytest.raises(ValueError, match="share"):
        Alternation(1.0, 1.0, random.Random(1))
    on = Alternation(0.3, 0.5, random.Random(1))
    assert np.mean([on.update(0.02 * number) for number in range(100000)]) == pytest.approx(0.3, abs=0.03)
    noise = Noise(1, 0.5, 0.5, random.Random(2))
    values = np.array([noise.update(0.05 * number)[0] for number in range(40000)])
    assert values.std() == pytest.approx(1.0, abs=0.05)
    later = np.corrcoef(values[:-10], values[10:])[0, 1]     # after 0.5 s: half of the variance, 1/e of it left
    assert later == pytest.approx(0.5 * math.exp(-1.0), abs=0.05)


def test_matches_join_what_is_of_one_person():
    the_scene = scene(at_robot("ann", 2.0, 0.5), at_robot("bob", 2.0, -0.5))
    matches, said = SceneMatches(sense_defaults()), []
    owner = {}
    for _, sensed in run(the_scene, 6.0):
        for feature in (*sensed.faces, *sensed.bodies):
            owner[feature.id] = feature.person
        said += matches.update(sensed)
    pairs = [match for match in said if match.likelihood > 0.0 and match.second_kind == BODY]
    assert pairs and all(owner[match.first] == owner[match.second] for match in pairs)
    known = [match for match in said if match.second_kind == PERSON and match.likelihood > 0.0]
    assert {match.second for match in known} == {"ann", "bob"}
    assert all(match.first_kind == FACE and owner[match.first] == match.second for match in known)


def test_nothing_is_withdrawn_of_who_leaves():
    matches = SceneMatches(sense_defaults())
    _, sensed = list(run(scene(at_robot("ann", 2.0, 0.5)), 6.0, **CLEAN))[-1]
    assert matches.update(sensed)
    assert matches.update(replace(sensed, faces=(), bodies=(), voices=())) == []
    # is back: said at once
    assert {match.first for match in matches.update(sensed)} >= {face.id for face in sensed.faces}


def test_a_face_is_recognised_after_the_delay():
    matches = SceneMatches(sense_defaults(recognition_delay=3.0))
    first = next(truth.stamp for truth, sensed in run(scene(at_robot("ann", 2.0, 0.5)), 8.0, **CLEAN)
                 if any(match.second_kind == PERSON for match in matches.update(sensed)))
    assert 2.9 < first < 3.3


def test_points_lie_where_the_face_is():
    camera = CameraModel.from_fov(1280, 720, math.radians(90.0))
    _, sensed = list(run(scene(at_robot("ann", 2.0, 0.5)), 1.0, **CLEAN))[-1]
    face, body = sensed.faces[0], sensed.bodies[0]
    points = landmarks(face.pose, camera)
    assert points.shape == (70, 3) and points[:, 2].min() > 0.0
    centre = camera.project(face.pose.translation[None])[0]
    assert points[27, :2] == pytest.approx(centre)
    assert points[36, 0] < points[45, 0] and points[8, 1] > points[27, 1]      # right eye left in the image, chin below
    shut, gaping = landmarks(face.pose, camera, 1.0), landmarks(face.pose, camera, 0.0, 1.0)
    assert shut[41, 1] - shut[37, 1] < 0.3 * (points[41, 1] - points[37, 1])
    assert gaping[57, 1] > points[57, 1] + 1.0
    joints = keypoints(body.pose, body.head, body.stature, camera)
    assert joints.shape == (18, 3)
    assert joints[2, 0] < joints[5, 0]                                          # right shoulder left in the image
    assert np.linalg.norm(joints[0, :2] - points[30, :2]) < 10.0                # nose to nose
    # hip, knee, and an ankle below the image
    assert joints[8, 1] < joints[9, 1] < camera.height < joints[10, 1]
    assert joints[8, 2] > 0.0 and joints[9, 2] > 0.0 and joints[10, 2] == 0.0
