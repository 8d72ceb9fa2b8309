"""Action units, expression, age and gender on real pictures and films: the demonstration's, and the evaluation's where
they were fetched (`fetch_models --models evaluation`)."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks import labels as eyes
from benchmarks.labels import images, nearest_face, read_labels
from hri_pipeline.core.camera import EQUIDISTANT, PLUMB_BOB, Calibration, CameraModel
from hri_pipeline.core.faces.action_units import MIRROR, ActionUnitEstimator, FaceMeasures
from hri_pipeline.core.faces.age_gender import AgeGenderFusion, load_age_gender
from hri_pipeline.core.faces.analysis import MOST_NOISE
from hri_pipeline.core.faces.crops import relative_noise
from hri_pipeline.core.faces.detector import FaceDetector
from hri_pipeline.core.faces.expression import CATEGORIES, ExpressionModel, ExpressionTracker
from hri_pipeline.core.faces.mesh import FaceMesh, load_canonical_face, roi_from_detection, roi_from_mesh
from hri_pipeline.core.onnx import ModelError, OnnxModel, models_directory

HFOV = 0.9
"""Guess (rad): not known of pictures."""
LARGEST = 1600
"""Larger pictures are halved, small ones get a rim: the detector is made for faces that do not fill the image."""


class Finder:
    """Meshes of the faces of a picture."""

    def __init__(self):
        directory = models_directory()
        self.detector = FaceDetector(
            OnnxModel(directory / "face_detection_full_range.onnx", outputs=tuple(FaceDetector.OUTPUTS)), 0.5)
        self.mesh = FaceMesh(OnnxModel(directory / "face_landmarks_attention.onnx", outputs=tuple(FaceMesh.OUTPUTS)))

    def __call__(self, image):
        """[(presence, mesh (478, 3) px of the picture)]."""
        rim = max(image.shape) // 4 if max(image.shape) < 700 else 0
        framed = cv2.copyMakeBorder(image, rim, rim, rim, rim, cv2.BORDER_CONSTANT)
        scale = max(1.0, max(framed.shape) / LARGEST)
        small = cv2.resize(framed, None, fx=1.0 / scale, fy=1.0 / scale, interpolation=cv2.INTER_AREA)
        found = self.detector.detect(small, [(0, 0, small.shape[1], small.shape[0])])
        first = self.mesh.run(small, [roi_from_detection(detection) for detection in found])
        second = self.mesh.run(small, [roi_from_mesh(result.points) for result in first])
        faces = []
        for result in second:
            points = result.points * scale
            points[:, :2] -= rim
            if result.presence > 0.5:
                faces.append((result.presence, points))
        return faces


@pytest.fixture(scope="module")
def finder():
    return Finder()


@pytest.mark.parametrize("focal, distortion, model", [
    (700.0, [], PLUMB_BOB), (800.0, [-0.28, 0.07, 0.001, -0.001], PLUMB_BOB),
    (700.0, [-0.02, 0.003, 0.0, 0.0], EQUIDISTANT)],
    ids=["wide", "lens", "fisheye"])
@pytest.mark.parametrize("aside", [(0.0, 28.0), (-20.0, -25.0)])
def test_a_mesh_lies_where_the_face_is_also_aside_of_the_optical_axis(finder, focal, distortion, model, aside):
    """A picture as the turned camera sees it, which a flat image stretches, and a fisheye squeezes."""
    image = cv2.imread(str(models_directory() / "demo" / "sample1.jpg"))
    size = image.shape[1::-1]
    ahead = CameraModel.from_fov(*size, HFOV, Calibration.CALIBRATED)
    lens = CameraModel(1600, 1200, np.array([[focal, 0, 800], [0, focal, 600], [0, 0, 1]]), np.array(distortion), model,
                       Calibration.CALIBRATED)
    turn = Rotation.from_euler("xy", aside, degrees=True).as_matrix()
    columns, rows = np.meshgrid(np.arange(1600) + 0.5, np.arange(1200) + 0.5)
    rays = lens.normalise(np.column_stack([columns.ravel(), rows.ravel()]))
    places = np.nan_to_num(ahead.project(np.column_stack([rays, np.ones(len(rays))]) @ turn) - 0.5, nan=-1e4)
    seen = cv2.remap(image, places.astype(np.float32).reshape(1200, 1600, 2), None, cv2.INTER_LINEAR)
    errors: dict = {}
    for _, mesh in finder(image):
        for _ in range(2):
            mesh = finder.mesh.run(image, [roi_from_mesh(mesh, camera=ahead)])[0].points
        rays = ahead.normalise(mesh[:, :2])
        wanted = mesh.copy()
        wanted[:, :2] = lens.project(np.column_stack([rays, np.ones(len(rays))]) @ turn.T)
        for name, camera in (("as it is", None), ("facing", lens)):
            points = wanted
            for _ in range(2):
                points = finder.mesh.run(seen, [roi_from_mesh(points, camera=camera)])[0].points
            away = np.linalg.norm((points - wanted)[:, :2], axis=1).mean()
            errors.setdefault(name, []).append(away / np.linalg.norm(wanted[33, :2] - wanted[263, :2]))
    before, now = np.mean(errors["as it is"]), np.mean(errors["facing"])
    assert len(errors["facing"]) >= 2 and now < 0.007 and now < 0.75 * before


@pytest.fixture(scope="module")
def measures():
    return FaceMeasures(load_canonical_face(models_directory() / "canonical_face.npz"))


def needs_evaluation_pictures():
    if not (models_directory() / "evaluation").is_dir():
        pytest.skip("the evaluation's pictures are absent; get them with `rosrun hri_pipeline fetch_models --models"
                    " evaluation`")


def labelled_faces(finder, labels):
    """Yield (label, image, presence, mesh); every labelled face must be found."""
    for wanted, image in images(labels, models_directory()):
        faces = finder(image)
        boxes = np.array([np.concatenate([mesh[:, :2].min(axis=0), mesh[:, :2].max(axis=0)]) for _, mesh in faces])
        for label in wanted:
            index = nearest_face(label, boxes, image.shape)
            assert index is not None, "no face found at {}".format(label)
            yield label, image, faces[index][0], faces[index][1]


def units_of(measures, image, presence, mesh):
    camera = CameraModel.from_fov(image.shape[1], image.shape[0], HFOV)
    return ActionUnitEstimator(measures).update(mesh, None, 0.0, presence, camera)


def test_the_mirror_table_mirrors_the_canonical_face():
    vertices = load_canonical_face(models_directory() / "canonical_face.npz").vertices
    for right, left in MIRROR.items():
        if right < len(vertices):
            assert np.linalg.norm(vertices[right] * (-1, 1, 1) - vertices[left]) < 0.001, (right, left)
            assert vertices[right, 0] < 0.0


def test_open_and_closed_eyes(finder, measures):
    needs_evaluation_pictures()
    labels, answers = [], []
    for label, image, presence, mesh in labelled_faces(finder, eyes.labelled_eyes()):
        labels.append(label)
        answers.append(bool(units_of(measures, image, presence, mesh).intensity[45] > 0.5))
    table = eyes.confusion(labels, answers)
    assert table["fn"] <= 2 and table["fp"] <= 2, table


@pytest.fixture(scope="module")
def evident(finder, measures):
    """(label, image, mesh, action units) of the faces with an evident expression."""
    needs_evaluation_pictures()
    labels = read_labels(Path(eyes.TABLE).with_name("expressions.txt"), CATEGORIES)
    return [(label.label, image, mesh, units_of(measures, image, presence, mesh))
            for label, image, presence, mesh in labelled_faces(finder, labels)]


def test_smiles_have_their_units(evident):
    smiling = np.array([units.intensity for label, _, _, units in evident if label == "happy"])
    neutral = np.array([units.intensity for label, _, _, units in evident if label == "neutral"])
    assert np.median(smiling[:, 12]) > 0.7 and np.median(neutral[:, 12]) < 0.1
    assert (neutral[:, 12] < 0.3).mean() > 0.9 and (smiling[:, 12] > 0.3).mean() > 0.8
    assert smiling[:, 6].mean() > neutral[:, 6].mean() + 0.05


def test_evident_expressions(evident):
    model = ExpressionModel(models_directory() / "face_expression.onnx")
    right, confidences = [], []
    for label, image, mesh, units in evident:
        probabilities = model.probabilities([model.crops(image, mesh)])[0]
        estimate = ExpressionTracker().update(probabilities, units, 0.0)
        right.append(estimate.category == label)
        confidences.append(estimate.confidence)
        if label == "happy" and estimate.category == label:
            assert estimate.valence > 0.2
    assert np.mean(right) >= 0.8
    assert abs(np.mean(confidences) - np.mean(right)) < 0.12, "the confidence is honest on average"


def test_a_face_that_smiles_for_a_second_and_blinks(finder, measures):
    needs_evaluation_pictures()
    film = cv2.VideoCapture(str(models_directory() / "evaluation" / "smile.mp4"))
    rate, told = film.get(cv2.CAP_PROP_FPS), []
    estimator, tracker = ActionUnitEstimator(measures), ExpressionTracker()
    while True:
        found, image = film.read()
        if not found:
            break
        presence, mesh = finder(image)[0]
        stamp = len(told) / rate
        units = estimator.update(mesh, None, stamp, presence)
        told.append((units.intensity, tracker.update(None, units, stamp)))
    film.release()
    smile = np.array([intensity[12] for intensity, _ in told])
    assert smile[:15].max() < 0.2 and smile[35:69].min() > 0.7 and smile[-1] < 0.2
    blink = np.array([intensity[45] for intensity, _ in told])
    assert blink[26:31].max() > 0.5 and blink[:20].max() < 0.3 and blink[40:].max() < 0.3
    assert all(intensity[43] == 0.0 for intensity, _ in told), "a blink is no sleep"
    assert told[65][1].category == "happy" and told[10][1].category == "neutral"


def test_somebody_who_talks_for_a_minute_is_no_grimacer(finder, measures):
    """Quiet talk of 40 s: the running neutral must settle, and the brows stay where they are."""
    needs_evaluation_pictures()
    path = models_directory() / "evaluation" / "talking.mp4"
    estimator, told, mesh = ActionUnitEstimator(measures), [], None
    for frame, image in eyes.frames(path, range(0, 960, 4)):
        result = [] if mesh is None else finder.mesh.run(image, [roi_from_mesh(mesh)])
        presence, mesh = (result[0].presence, result[0].points) if result else finder(image)[0]
        told.append(estimator.update(mesh, None, frame / 24.0, presence))
    settled = np.array([units.intensity for units in told[60:]])
    assert told[-1].neutral_known > 0.8
    open_eyes = settled[settled[:, 45] < 0.3]
    assert np.percentile(open_eyes[:, [1, 2, 4, 9]], 90, axis=0).max() < 0.2
    assert 2 <= int((np.diff((settled[:, 45] > 0.5).astype(int)) == 1).sum()) <= 20, "he blinks now and then"


def test_the_people_of_the_demonstration_are_grown_women(finder):
    """Twenty-two faces: what a visitor would say of them."""
    model = load_age_gender(models_directory() / "age_gender.onnx")
    told = []
    for number in range(1, 7):
        image = cv2.imread(str(models_directory() / "demo" / "sample{}.jpg".format(number)))
        assert image is not None, "no demonstration pictures; get them with `rosrun hri_pipeline fetch_models`"
        for _, mesh in finder(image):
            fusion = AgeGenderFusion()
            fusion.add(model.estimate([model.crop(image, mesh)])[0], 1.0, 0.0)
            told.append(fusion.estimate())
    assert len(told) >= 20
    assert np.mean([look.p_female > 0.5 for look in told]) >= 0.9
    ages = np.array([look.age for look in told])
    assert 18.0 <= np.median(ages) <= 35.0 and ages.min() > 12.0 and ages.max() < 55.0
    assert all(5.0 <= look.age_sd < 12.0 and 0.5 < look.age_confidence < 0.97 for look in told)


def test_noise_that_makes_people_old_is_known(finder):
    """Faces of 90 px, clean and as of a camera in a dim room."""
    model = load_age_gender(models_directory() / "age_gender.onnx")
    image, random, older = cv2.imread(str(models_directory() / "demo" / "sample6.jpg")), np.random.RandomState(1), []
    assert image is not None, "no demonstration pictures; get them with `rosrun hri_pipeline fetch_models`"
    for _, mesh in finder(image):
        scale = 90.0 / np.ptp(mesh[:, 0])
        small, points = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), scale * mesh
        noisy = np.clip(small + random.normal(0.0, 25.0, small.shape), 0, 255).astype(np.uint8)
        clean, grainy = model.crop(small, points), model.crop(noisy, points)
        first, second = model.estimate([clean, grainy])
        older.append(second.age - first.age)
        assert relative_noise(clean) < 0.7 * MOST_NOISE < MOST_NOISE < relative_noise(grainy)
    assert np.median(older) > 8.0, "the network takes noise for wrinkles; else nobody needs this"


def test_noise_that_was_smoothed_away_makes_ages_less_sure(finder):
    """Faces of 90 px, clean and as of a camera that smooths the noise of a dim room."""
    model = load_age_gender(models_directory() / "age_gender.onnx")
    image, random = cv2.imread(str(models_directory() / "demo" / "sample6.jpg")), np.random.RandomState(1)
    assert image is not None, "no demonstration pictures; get them with `rosrun hri_pipeline fetch_models`"
    clean, smoothed = [], []
    for _, mesh in finder(image):
        scale = 90.0 / np.ptp(mesh[:, 0])
        small, points = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), scale * mesh
        noisy = cv2.GaussianBlur(small + random.normal(0.0, 25.0, small.shape), (0, 0), 1.0)
        crops = [model.crop(picture, points) for picture in (small, np.clip(noisy, 0, 255).astype(np.uint8))]
        assert relative_noise(crops[1]) < MOST_NOISE, "which the limit of noise does not see"
        for told, crop in zip((clean, smoothed), crops):
            fusion = AgeGenderFusion()
            fusion.add(model.estimate([crop])[0], 1.0, 0.0)
            told.append(fusion.estimate())
    assert np.median([look.age for look in smoothed]) > np.median([look.age for look in clean]) + 3.0
    sure, doubtful = (np.mean([look.age_confidence for look in told]) for told in (clean, smoothed))
    assert sure > 0.85 and doubtful < sure - 0.08


def test_another_network_is_refused():
    for wrong in ("age_gender.onnx", "face_recognition.onnx"):
        with pytest.raises(ModelError, match=wrong):
            ExpressionModel(models_directory() / wrong)
    with pytest.raises(ModelError, match="face_expression.onnx"):
        load_age_gender(models_directory() / "face_expression.onnx")
