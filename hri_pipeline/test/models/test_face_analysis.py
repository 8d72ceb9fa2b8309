"""All stages of the faces together, on photographs: who is asked for what, and what it costs nobody."""

import cv2
import numpy as np
import pytest

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces.analysis import STAGES, FaceDemand
from hri_pipeline.core.faces.parameters import FACES
from hri_pipeline.core.faces.pipeline import FacePipeline
from hri_pipeline.core.onnx import ModelError, models_directory
from hri_pipeline.core.sources.image_sources import PictureMotion

SIZE = (960, 640)
NETWORKS = ("expression", "age_gender", "recognition")
# Every face in every image, however busy the machine is.
UNHURRIED = {"face_mesh_rate": 0.0, "face_budget": 1000.0}
CAMERA = CameraModel.from_fov(SIZE[0], SIZE[1], 0.925)


def photograph(name):
    image = cv2.imread(str(models_directory() / "demo" / (name + ".jpg")))
    assert image is not None, "no picture {}; get it with `rosrun hri_pipeline fetch_models`".format(name)
    return cv2.resize(image, SIZE, interpolation=cv2.INTER_AREA)


def watch(stage, image, count, demand, start=1000.0):
    """Feed an image again and again, 0.1 s apart; returns the last faces and all matches."""
    matches, faces = [], []
    for index in range(count):
        faces = stage.update(image, CAMERA, start + 0.1 * index, None, demand(stage.tracked_ids))
        matches += stage.matches
    return faces, matches


def networks_run(stage):
    return {name for name in stage.times.summary() if name in NETWORKS}


def test_what_nobody_wants_is_not_done():
    stage = FacePipeline(FACES.resolve({}))
    faces, matches = watch(stage, photograph("sample3"), 15, lambda ids: FaceDemand())
    assert len(faces) == 3 and not matches
    assert not networks_run(stage) and "action_units" not in stage.times.summary()
    for face in faces:
        assert face.action_units is face.expression is face.soft_biometrics is None
        assert face.pose is not None and face.gaze is not None


def test_everything_of_three_people():
    stage = FacePipeline(FACES.resolve(UNHURRIED))
    faces, matches = watch(stage, photograph("sample3"), 50, FaceDemand.everything)
    assert networks_run(stage) == set(NETWORKS)
    assert len(faces) == 3
    for face in faces:
        assert face.action_units.intensity.shape == (99,) and face.action_units.confidence.max() > 0.2
        assert face.expression.category in ("happy", "neutral", "surprised")
        assert 15.0 < face.soft_biometrics.age < 50.0 and face.soft_biometrics.p_male < 0.3
    said = {match.face_id: match.person_id for match in matches if match.likelihood > 0.5}
    assert set(said) == {face.id for face in faces} and len(set(said.values())) == 3
    again, later = watch(stage, np.zeros((640, 960, 3), np.uint8), 15, FaceDemand.everything, 1010.0)
    assert again == [] and all(match.likelihood > 0.0 for match in later), "who has gone was still that person"
    faces, matches = watch(stage, photograph("sample3"), 40, FaceDemand.everything, 1020.0)
    known = {match.person_id for match in matches if match.likelihood > 0.5}
    assert known == set(said.values()) and not {face.id for face in faces} & set(said)


def test_one_face_of_three_is_asked_for():
    stage = FacePipeline(FACES.resolve(UNHURRIED))
    faces, _ = watch(stage, photograph("sample3"), 25, lambda ids: FaceDemand(
        action_units=set(ids[:1]), soft_biometrics=set(ids[1:2])))
    assert [face.action_units is not None for face in faces] == [True, False, False]
    assert [face.soft_biometrics is not None for face in faces] == [False, True, False]
    assert networks_run(stage) == {"age_gender"}


def test_places_do_not_wait_for_the_analysis():
    stage, image, order = FacePipeline(FACES.resolve(UNHURRIED)), photograph("sample3"), []
    watch(stage, image, 15, FaceDemand.everything)
    analyse = stage._analysis.update
    stage._analysis.update = lambda *arguments: order.append("analysis") or analyse(*arguments)
    faces = stage.update(image, CAMERA, 1001.5, None, FaceDemand.everything(stage.tracked_ids), order.append)
    told = [(face.id, face.pose) for some in order[:-1] for face in some]
    assert told == [(face.id, face.pose) for face in faces] and len(faces) == 3
    assert order[-1] == "analysis"


def test_places_of_who_is_known_do_not_wait_for_the_search_of_others():
    stage, image, order = FacePipeline(FACES.resolve(UNHURRIED)), photograph("sample3"), []
    watch(stage, image, 15, FaceDemand.everything)
    known, search = set(stage.tracked_ids), stage._tracking._detector.detect
    stage._tracking._detector.detect = lambda *arguments: order.append("search") or search(*arguments)
    placed = []

    def place(faces):
        order.append("places")
        placed.append(faces)

    for index in range(30):
        order.clear()
        placed.clear()
        faces = stage.update(image, CAMERA, 1001.5 + 0.1 * index, None, FaceDemand(), place)
        first, told = placed[0], [face.id for some in placed for face in some]
        assert sorted(told) == sorted(face.id for face in faces) == sorted(known), "each once in an image"
        if "search" in order and {face.id for face in first} == known:
            break
    assert order == ["places", "search", "places"]
    assert [(face.id, face.pose) for face in first] == [(face.id, face.pose) for face in faces]


def test_what_is_found_of_faces_does_not_hang_on_when_they_are_placed():
    """The detector is refused the early places in one of two pipelines: panned, with people who come in."""
    early, late = (FacePipeline(FACES.resolve(dict(UNHURRIED, cpu_share=0.0))) for _ in range(2))
    update = late._tracking.update
    late._tracking.update = lambda bgr, stamp, followed, camera: update(bgr, stamp, None, camera)
    motion = PictureMotion(photograph("sample5"), *SIZE, pan=0.2, period=6.0)
    for index in range(60):
        image, stamp = motion.view(index / 10.0), 1000.0 + index / 10.0
        both = [stage.update(image, CAMERA, stamp, None, FaceDemand()) for stage in (early, late)]
        boxes = [[face.box.tolist() for face in faces] for faces in both]
        assert boxes[0] == boxes[1], index
        poses = [np.array([face.pose.translation for face in faces]) for faces in both]
        np.testing.assert_allclose(poses[0], poses[1], atol=1e-6)     # they are solved in other batches
    assert len(both[0]) >= 3


def test_an_error_while_faces_are_placed_costs_neither_the_search_nor_the_tracks():
    stage, image = FacePipeline(FACES.resolve(UNHURRIED)), photograph("sample3")

    def fail(faces):
        raise OSError("not published")

    for index in range(15):
        with pytest.raises(OSError):
            stage.update(image, CAMERA, 1000.0 + 0.1 * index, None, FaceDemand(), fail)
    assert len(stage.tracked_ids) == 3


def test_at_most_one_network_runs_per_image():
    stage = FacePipeline(FACES.resolve(UNHURRIED))
    image = photograph("sample5")
    for index in range(40):
        before = {name: len(stage.times._times.get(name, ())) for name in NETWORKS}
        stage.update(image, CAMERA, 1000.0 + 0.1 * index, None, FaceDemand.everything(stage.tracked_ids))
        assert sum(len(stage.times._times.get(name, ())) - before[name] for name in NETWORKS) <= 1
    assert networks_run(stage) == set(NETWORKS)


@pytest.mark.parametrize("name", STAGES)
def test_each_stage_can_be_switched_off_alone(name):
    models = {"expression": "expression_model", "age_gender": "age_gender_model", "recognition": "recognition_model"}
    settings = dict(UNHURRIED, **{name: False})
    if name in models:
        settings[models[name]] = "/nowhere/absent.onnx"
        with pytest.raises(ModelError, match="absent.onnx"):
            FacePipeline(FACES.resolve(dict(settings, **{name: True})))
    stage = FacePipeline(FACES.resolve(settings))
    assert name not in stage.status()["stages"].split()
    faces, matches = watch(stage, photograph("sample3"), 30, FaceDemand.everything)
    result = {"age_gender": "soft_biometrics", "recognition": None}.get(name, name)
    assert len(faces) == 3 and (result is None or all(getattr(face, result) is None for face in faces))
    assert bool(matches) == (name != "recognition")


def test_the_strict_profile_switches_everything_off():
    from pathlib import Path

    import yaml
    profile = yaml.safe_load((Path(__file__).parents[2] / "config" / "privacy_strict.yaml").read_text())
    settings = FACES.resolve(profile)
    assert not any(getattr(settings, name) for name in STAGES)
    stage = FacePipeline(settings)
    assert stage.recognition is None and stage.status()["stages"] == "none"


def test_time_that_goes_back_forgets_faces_and_keeps_persons():
    stage = FacePipeline(FACES.resolve(UNHURRIED))
    image = photograph("sample3")
    _, matches = watch(stage, image, 45, FaceDemand.everything)
    faces, again = watch(stage, image, 30, FaceDemand.everything, 10.0)
    persons = [{match.person_id for match in found if match.likelihood > 0.5} for found in (matches, again)]
    assert len(persons[0]) == 3 and persons[0] == persons[1]
    assert len(faces) == 3
