"""Camera models: distortion, fallback, region of interest and binning, nonsense refused."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hri_pipeline.core.camera import Calibration, CameraError, CameraModel
from hri_pipeline.core.image_rotation import ImageRotation

K = [500.0, 0, 321.5, 0, 510.0, 238.5, 0, 0, 1]
MODELS = {
    "plumb_bob": [0.1, -0.2, 0.001, -0.002, 0.05],
    "rational_polynomial": [0.1, -0.2, 0.001, -0.002, 0.05, 0.1, 0.02, 0.01],
    "equidistant": [0.02, -0.01, 0.003, -0.001],
}
PIXELS = np.array([[0.0, 0.0], [321.5, 238.5], [639.0, 10.0], [50.0, 470.0]])


def camera(model="plumb_bob", distortion=None, **kwargs):
    distortion = MODELS[model] if distortion is None else distortion
    return CameraModel.from_calibration(640, 480, K, distortion, model, 1.0, **kwargs)


@st.composite
def cameras(draw):
    """A camera with little distortion, of one of the models."""
    model = draw(st.sampled_from(sorted(MODELS)))
    share = draw(st.floats(0.0, 1.0))
    focal, aspect = draw(st.floats(450.0, 2000.0)), draw(st.floats(0.9, 1.1))
    x, y = draw(st.floats(280.0, 360.0)), draw(st.floats(200.0, 280.0))
    skew = draw(st.sampled_from([0.0, 0.0, 3.0, -20.0]))
    matrix = [focal, skew, x, 0.0, focal * aspect, y, 0.0, 0.0, 1.0]
    return CameraModel.from_calibration(640, 480, matrix, [share * value for value in MODELS[model]], model, 1.0)


@given(cameras(), st.lists(st.tuples(st.floats(0.0, 640.0), st.floats(0.0, 480.0), st.floats(0.1, 50.0)), min_size=1))
def test_round_trip(model, places):
    pixels, depths = np.array(places)[:, :2], np.array(places)[:, 2:]
    points = np.hstack([model.normalise(pixels), np.ones_like(depths)]) * depths
    np.testing.assert_allclose(model.project(points), pixels, atol=1e-5)


@given(st.integers(0, 320), st.integers(0, 240), st.integers(1, 80), st.integers(1, 60), st.integers(1, 4),
       st.integers(1, 4))
def test_region_of_interest_binning_and_size(left, top, width, height, across, down):
    """Bars beside the image and pixels put together move and scale the pixels, and so does another size."""
    whole, point = camera(), np.array([[0.1, -0.1, 2.0]])
    model = camera(roi_x=left, roi_y=top, roi_width=width * across, roi_height=height * down, binning_x=across,
                   binning_y=down)
    assert (model.width, model.height) == (width, height)
    expected = (whole.project(point) - [left, top]) / [across, down]
    np.testing.assert_allclose(model.project(point), expected, atol=1e-9)
    half = model.resized(3 * width, 2 * height)
    assert (half.width, half.height) == (3 * width, 2 * height)
    np.testing.assert_allclose(half.project(point), expected * [3, 2], atol=1e-9)


@pytest.mark.parametrize("told, measured", [
    ((1280, 720), (640, 360)), ((1920, 1080), (1280, 720)), ((640, 480), (1280, 960)), ((640, 360), (1920, 1080)),
    ((1280, 720), (424, 239)), ((640, 480), (1024, 768)), ((720, 1280), (1080, 1920)), ((800, 600), (480, 360))])
@pytest.mark.parametrize("off", [(1.0, 1.0), (1.05, 0.96), (0.96, 1.03)])
def test_a_matrix_of_another_resolution_is_known_by_its_middle(told, measured, off):
    """Calibrated at one resolution, and the driver gives another one."""
    width, height = measured
    focal = 0.8 * width
    matrix = [focal, 0, 0.5 * width * off[0], 0, focal, 0.5 * height * off[1], 0, 0, 1]
    model = CameraModel.from_calibration(*told, matrix, [], "plumb_bob", 1.0)
    assert (model.width, model.height) == (width, pytest.approx(height, abs=1))
    assert model.resized(*told).matrix[0, 0] == pytest.approx(0.8 * told[0])


def test_a_resolution_that_no_camera_has_is_measured():
    model = CameraModel.from_calibration(640, 480, [944, 0, 590, 0, 944, 442.5, 0, 0, 1], [], "", 1.0)
    assert (model.width, model.height) == (1180, 885)


@pytest.mark.parametrize("middle", [(560, 400), (700, 330), (760, 360), (640, 480), (400, 360), (700, 120), (520, 470),
                                    (505, 285), (525, 294), (780, 440), (800, 464), (-60, 90), (1400, -20)])
def test_a_matrix_whose_middle_is_off_is_of_its_resolution(middle):
    """As of lenses that sit askew, hasty calibrations, shifted and cut sensors, and rectified images."""
    model = CameraModel.from_calibration(1280, 720, [900, 0, middle[0], 0, 900, middle[1], 0, 0, 1], [], "", 1.0)
    assert (model.width, model.height) == (1280, 720)


def test_a_region_of_interest_has_its_middle_anywhere():
    model = CameraModel.from_calibration(1280, 720, [900, 0, 640, 0, 900, 360, 0, 0, 1], [], "", 1.0,
                                         roi_x=320, roi_y=180, roi_width=320, roi_height=180)
    assert (model.width, model.height, model.matrix[0, 2]) == (320, 180, 320.0)


@pytest.mark.parametrize("told, measured", [((1920, 1080), (640, 480)), ((640, 480), (1920, 1080))])
def test_a_matrix_of_another_shape_of_image_is_refused(told, measured):
    width, height = measured
    with pytest.raises(CameraError, match="{}, {}, .* another resolution".format(width // 2, height // 2)):
        CameraModel.from_calibration(*told, [900, 0, width / 2, 0, 900, height / 2, 0, 0, 1], [], "", 1.0)


NUMBERS = st.sampled_from([0.0, 1.0, -1.0, 5e-324, 1e-300, 1e300, -1e5, np.nan, np.inf]) | st.floats()


@given(st.dictionaries(st.integers(0, 8), NUMBERS, max_size=3), st.lists(NUMBERS | st.floats(-1.0, 1.0), max_size=8),
       st.sampled_from([*MODELS, "", "barrel"]))
def test_any_calibration_is_refused_with_a_mend_or_gives_finite_rays(numbers, distortion, model):
    matrix = [numbers.get(index, number) for index, number in enumerate(K)]
    try:
        taken = CameraModel.from_calibration(640, 480, matrix, distortion, model, 1.0)
    except CameraError as error:
        assert "calibrate the camera" in str(error)
    else:
        assert np.isfinite(taken.normalise(PIXELS)).all() and np.isfinite(taken.matrix).all()


def test_plumb_bob_by_hand():
    k1, k2, p1, p2, k3 = MODELS["plumb_bob"]
    x, y = 0.3, -0.2
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2 ** 2 + k3 * r2 ** 3
    xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    np.testing.assert_allclose(camera().project([[x, y, 1.0]]), [[500 * xd + 321.5, 510 * yd + 238.5]])


def test_equidistant_by_hand():
    k1, k2, k3, k4 = MODELS["equidistant"]
    theta = np.arctan(0.5)
    turned = theta * (1 + k1 * theta ** 2 + k2 * theta ** 4 + k3 * theta ** 6 + k4 * theta ** 8)
    np.testing.assert_allclose(camera("equidistant").project([[0.5, 0, 1.0]]), [[500 * turned + 321.5, 238.5]])
    ideal = camera("equidistant", [])
    np.testing.assert_allclose(ideal.project([[0.5, 0, 1.0]]), [[500 * theta + 321.5, 238.5]])
    np.testing.assert_allclose(ideal.normalise([[500 * theta + 321.5, 238.5]]), [[0.5, 0.0]], atol=1e-9)


@pytest.mark.parametrize("distortion", [[], [0.0] * 4, [-0.01, 0.03, -0.03, 0.005], [0.1, -0.05, 0.02, -0.003]])
def test_what_a_fisheye_camera_sees_at_its_edge_stays_on_its_side(distortion):
    wide = CameraModel.from_calibration(1280, 800, [285, 0, 640, 0, 285, 400, 0, 0, 1], distortion, "equidistant", 1.0)
    columns = np.arange(640.0, 1280.0, 10.0)
    right, left = (wide.normalise(np.column_stack([640.0 + side * (columns - 640.0), np.full(64, 400.0)]))
                   for side in (1.0, -1.0))
    np.testing.assert_allclose(right, left * (-1.0, 1.0), atol=1e-9)
    assert (np.diff(right[:, 0]) > -1e-9).all() and 1.0 < right[-1, 0] < 30.0


@pytest.mark.parametrize("model, distortion", [("plumb_bob", []), ("equidistant", []), *sorted(MODELS.items())])
def test_the_skew_of_k_counts_both_ways(model, distortion):
    straight = camera(model, distortion)
    skewed = CameraModel.from_calibration(640, 480, [500.0, 20.0, *K[2:]], distortion, model, 1.0)
    pixels = straight.project([[0.3, 0.2, 1.0]])
    expected = pixels + [20.0 * (pixels[0, 1] - 238.5) / 510.0, 0.0]
    np.testing.assert_allclose(skewed.project([[0.3, 0.2, 1.0]]), expected, atol=1e-9)
    np.testing.assert_allclose(skewed.normalise(expected), [[0.3, 0.2]], atol=1e-6)


@pytest.mark.parametrize("distortion", [
    (.1, -.05, .001, -.002), (.1, -.05, .001, -.002, .01), (.4, .1, .001, -.002, .01, .5, .2, .02),
    (.1, -.05, .001, -.002, .01, 0., 0., 0., .01, -.02, .03, .04),
    (.1, -.05, .001, -.002, .01, .3, .1, .02, .01, -.02, .03, .04, .05, -.04)])
def test_many_points_at_once_are_seen_where_each_is_seen_alone(distortion):
    camera = CameraModel(1280, 720, np.array([[900.0, 3.0, 650.0], [0.0, 910.0, 350.0], [0.0, 0.0, 1.0]]),
                         np.array(distortion), "rational_polynomial", Calibration.CALIBRATED)
    points = np.random.default_rng(5).uniform((-0.6, -0.4, 1.0), (0.6, 0.4, 2.0), (300, 3))
    points[7], points[11, 2] = np.nan, -1.0
    alone = np.concatenate([camera.project(point[None]) for point in points])
    np.testing.assert_allclose(camera.project(points), alone, atol=1e-9)
    assert np.isnan(alone[[7, 11]]).all() and np.isfinite(np.delete(alone, [7, 11], axis=0)).all()


def test_without_distortion_it_is_a_pinhole():
    for distortion in ([], [0.0] * 5):
        np.testing.assert_allclose(camera(distortion=distortion).normalise([[821.5, 748.5]]), [[1.0, 1.0]])


def test_without_distortion_it_projects_as_with_a_little():
    places = np.random.default_rng(4).uniform((-1.0, -1.0, 0.4), (1.0, 1.0, 5.0), (20, 3))
    matrix = [[510.0, 0.0, 322.0], [0.0, 505.0, 243.0], [0.0, 0.0, 1.0]]
    plain, bent = (CameraModel(640, 480, np.array(matrix), np.array(distortion), "plumb_bob", Calibration.CALIBRATED)
                   for distortion in ([], [1e-12, 0.0, 0.0, 0.0]))
    assert plain.project(places) == pytest.approx(bent.project(places), abs=1e-6)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("aside", [(0.0, 0.0), (0.0, 25.0), (-12.0, -20.0)])
def test_what_is_seen_aside_looks_as_it_does_to_a_camera_that_faces_it(model, aside):
    lens, pinhole = camera(model), CameraModel.from_fov(640, 480, 1.0)
    things = np.random.RandomState(1).uniform(-0.1, 0.1, (50, 3)) + (0.0, 0.0, 1.0)
    turn = Rotation.from_euler("xy", aside, degrees=True).as_matrix()
    seen, ahead = lens.facing(lens.project(things @ turn.T)), pinhole.facing(pinhole.project(things))
    ahead *= np.sqrt(K[0] * K[4]) / pinhole.matrix[0, 0]
    # They may be turned about the line of sight.
    assert np.linalg.norm(seen[:, None] - seen, axis=2) == pytest.approx(
        np.linalg.norm(ahead[:, None] - ahead, axis=2), abs=0.1)
    assert np.abs(seen.mean(axis=0)).max() < 1.0


@pytest.mark.parametrize("model, focal, distortion, place", [
    ("plumb_bob", 380.0, [-0.35, 0.14, 0.0, 0.0, -0.025], (10.0, 10.0)),
    ("equidistant", 190.0, [0.01, -0.005, 0.002, -0.0005], (20.0, 40.0)),
    ("rational_polynomial", 608.0, [0.19, 0.10, -0.13, -0.30, 0.04, 0.21, 0.15, 0.70], (635.0, 367.0))])
def test_what_lies_beyond_the_edge_of_the_lens_is_seen_as_it_is(model, focal, distortion, place):
    """In the corners of an image a model of a lens may give anything: a face was shown as a line, or as nothing."""
    lens = CameraModel.from_calibration(640, 480, [focal, 0, 320, 0, focal, 240, 0, 0, 1], distortion, model, 1.0)
    points = np.random.RandomState(1).uniform(-0.5, 0.5, (50, 2)) * (48.0, 60.0) + place
    whole = np.column_stack([points, np.ones(50)]) @ lens.facing_map(points).T
    assert lens.facing(points) == pytest.approx(points - points.mean(axis=0))
    assert np.ptp(whole[:, :2] / whole[:, 2:], axis=0) == pytest.approx(np.ptp(points, axis=0), abs=1e-3)


def test_no_points_and_points_behind():
    assert camera().normalise(np.zeros((0, 2))).shape == (0, 2)
    assert camera().project(np.zeros((0, 3))).shape == (0, 2)
    pixels = camera().project([[0, 0, -1.0], [0, 0, 0.0], [np.nan, 0, 1], [0, 0, 2.0]])
    assert np.isnan(pixels[:3]).all() and np.isfinite(pixels[3]).all()


def test_all_zero_k_is_uncalibrated_and_falls_back():
    model = CameraModel.from_calibration(640, 480, [0.0] * 9, [], "", np.pi / 2)
    assert model.calibration is Calibration.UNCALIBRATED
    np.testing.assert_allclose(model.matrix, [[320, 0, 320], [0, 320, 240], [0, 0, 1]])
    assert CameraModel.from_fov(640, 480, 1.0).calibration is Calibration.MISSING
    assert camera().calibration is Calibration.CALIBRATED


@pytest.mark.parametrize("model, distortion, like, taken", [
    ("plumb_bob", MODELS["rational_polynomial"], "rational_polynomial", MODELS["rational_polynomial"]),
    ("plumb_bob", MODELS["plumb_bob"] + [0.0] * 3, "plumb_bob", MODELS["plumb_bob"]),
    ("equidistant", MODELS["equidistant"] + [0.0], "equidistant", MODELS["equidistant"]),
    ("rational_polynomial", MODELS["plumb_bob"] + [0.0], "plumb_bob", MODELS["plumb_bob"]),
    ("plumb_bob", [0.1] + [0.0] * 6, "plumb_bob", [0.1, 0.0, 0.0, 0.0]),
    ("equidistant", [0.0] * 5, "equidistant", []),
])
def test_coefficients_that_drivers_send_too_many_of(model, distortion, like, taken):
    """As image_geometry does, plumb_bob takes the longer rows of OpenCV, too; zeros at the end are none."""
    given, wanted = camera(model, distortion), camera(like, taken)
    np.testing.assert_allclose(given.normalise(PIXELS), wanted.normalise(PIXELS), atol=1e-12)
    rays = np.array([[0.3, -0.2, 1.0], [-0.4, 0.1, 2.0]])
    np.testing.assert_allclose(given.project(rays), wanted.project(rays), atol=1e-9)


@pytest.mark.parametrize("model, count, left", [
    ("plumb_bob", 5, 0), ("rational_polynomial", 8, 0), ("equidistant", 4, 4)])
def test_zeros_alone_are_no_distortion_but_of_a_fisheye(model, count, left):
    """Drivers of rectified images and simulators tell them, and OpenCV's lenses took a tenth of the time of faces."""
    assert camera(model, [0.0] * count).distortion.size == left


def changed(index, value):
    return [value if i == index else number for i, number in enumerate(K)]


@pytest.mark.parametrize("matrix, distortion, model, text", [
    (changed(0, np.nan), [], "plumb_bob", "not finite"),
    (changed(4, -5.0), [], "plumb_bob", "positive"),
    (changed(8, 0.0), [], "plumb_bob", "0 0 1"),
    (K[:8], [], "plumb_bob", "instead of 9"),
    (K, [0.1], "plumb_bob", "coefficients"),
    (K, [0.1] * 6, "plumb_bob", "coefficients"),
    (K, [0.1] * 5, "equidistant", "coefficients"),
    (K, [np.nan] * 5, "plumb_bob", "not finite"),
    (K, [], "barrel", "unknown distortion model"),
    (changed(0, 1e300), [], "plumb_bob", "focal length"),
    (changed(4, 1e-300), [], "plumb_bob", "focal lengths"),
    (changed(1, 1e300), [], "plumb_bob", "skew"),
    (changed(2, 1e300), [], "plumb_bob", "principal point"),
    (changed(5, -5000.0), [], "plumb_bob", "principal point"),
    ([500.0, 0, 0, 0, 510.0, 0, 0, 0, 1], [], "plumb_bob", "principal point in K, 0, 0, is a corner"),
    ([5e-324 * (number != 0.0) for number in K], [], "plumb_bob", "0 0 1"),
    (K, [1e300] * 5, "plumb_bob", "beyond"),
    (K, [-1e5] * 4, "equidistant", "beyond"),
])
def test_nonsense_is_refused_with_a_mend(matrix, distortion, model, text):
    with pytest.raises(CameraError, match=text) as caught:
        CameraModel.from_calibration(640, 480, matrix, distortion, model, 1.0)
    assert "calibrate the camera" in str(caught.value)
    assert isinstance(caught.value, ValueError)


@pytest.mark.parametrize("size, region, text", [
    ((640, 480), dict(roi_x=600, roi_width=100, roi_height=10), "region of interest"),
    ((640, 480), dict(roi_y=4000000000), "image size|region of interest"),
    ((640, 480), dict(roi_width=4294967295, roi_height=4294967295), "region of interest"),
    ((640, 480), dict(binning_x=4294967295), "image size"),
    ((4294967295, 480), {}, "image size"),
])
def test_sizes_that_fit_nothing_are_refused(size, region, text):
    with pytest.raises(CameraError, match=text):
        CameraModel.from_calibration(size[0], size[1], K, [], "plumb_bob", 1.0, **region)


@pytest.mark.parametrize("matrix", [[8.0e4, 0, 320, 0, 8.0e4, 240, 0, 0, 1], [90.0, 0, 320, 0, 95.0, 240, 0, 0, 1],
                                    [600.0, 0, -60.0, 0, 600.0, 240, 0, 0, 1], [300.0, 0, 320, 0, 600.0, 240, 0, 0, 1]])
def test_odd_cameras_that_exist_are_taken(matrix):
    """A telephoto and a very wide lens, a principal point beside the image, pixels twice as wide as high."""
    assert CameraModel.from_calibration(640, 480, matrix, [], "plumb_bob", 1.0).matrix[0, 0] == matrix[0]


@pytest.mark.parametrize("width, height", [(0, 480), (640, 0), (-1, 5)])
def test_no_size(width, height):
    with pytest.raises(CameraError, match="image size"):
        CameraModel.from_calibration(width, height, K, [], "plumb_bob", 1.0)


@pytest.mark.parametrize("fov", [0.0, -1.0, np.pi, np.nan])
def test_bad_field_of_view(fov):
    with pytest.raises(CameraError, match="field of view"):
        CameraModel.from_fov(640, 480, fov)


@pytest.mark.parametrize("model", [*MODELS, "pinhole", "turned"])
@pytest.mark.parametrize("aside", [(0.0, 25.0), (-12.0, -20.0)])
def test_the_view_of_a_face_aside_is_that_of_a_camera_that_looks_at_it(model, aside):
    lens = camera(distortion=[]) if model in ("pinhole", "turned") else camera(model)
    lens = ImageRotation(1, 640, 480).camera(lens) if model == "turned" else lens
    things = np.random.RandomState(1).uniform(-0.1, 0.1, (50, 3)) + (0.0, 0.0, 1.0)
    turn = Rotation.from_euler("xy", aside[::-1] if model == "turned" else aside, degrees=True).as_matrix()
    pixels = lens.project(things @ turn.T)
    view = lens.facing_view(pixels)
    seen, ahead = view.see(pixels), view.focal * things[:, :2] / things[:, 2:]
    assert np.linalg.norm(seen[:, None] - seen, axis=2) == pytest.approx(
        np.linalg.norm(ahead[:, None] - ahead, axis=2), abs=0.1)
    assert view.back(seen) == pytest.approx(pixels, abs=1e-3)
    assert np.ptp(seen, axis=0).prod() == pytest.approx(np.ptp(pixels, axis=0).prod(), rel=0.1), "as large"


def test_what_is_ahead_or_not_known_has_no_view_of_its_own():
    points = np.random.RandomState(1).uniform(-20.0, 20.0, (50, 2))
    pinhole, aside = camera(distortion=[]), points + (600.0, 100.0)
    assert pinhole.facing_view(aside) is not None
    assert pinhole.facing_view(points + (321.5, 238.5)) is None, "ahead"
    assert CameraModel.from_fov(640, 480, 1.2).facing_view(aside) is None, "a guess"
    for nothing in (np.full((50, 2), np.nan), np.full((50, 2), 600.0), np.full((50, 2), np.inf)):
        assert pinhole.facing_view(nothing) is None
    beyond = CameraModel.from_calibration(640, 480, [380.0, 0, 320, 0, 380.0, 240, 0, 0, 1],
                                          [-0.35, 0.14, 0.0, 0.0, -0.025], "plumb_bob", 1.0)
    assert beyond.facing_view(points + (10.0, 10.0)) is None


@pytest.mark.parametrize("model, focal, distortion", [
    ("equidistant", 400.0, [0.0] * 4), ("equidistant", 400.0, [0.02, -0.01, 0.003, 0.0]), ("plumb_bob", 233.0, []),
    ("plumb_bob", 760.0, [-0.35, 0.14, 0.0, 0.0, -0.025])], ids=["fisheye", "bent fisheye", "wide", "lens"])
@pytest.mark.parametrize("half", [0.05, 0.12, 0.25])
def test_a_view_near_the_edge_shows_what_the_image_does(model, focal, distortion, half):
    """Beyond a right angle nothing is seen, and beyond its edge a model gives anything: it spoilt the whole crop."""
    lens = CameraModel.from_calibration(1280, 960, [focal, 0, 640, 0, focal, 480, 0, 0, 1], distortion, model, 1.0)
    rows, columns = np.mgrid[:960, :1280].astype(np.float32)
    image = np.dstack([columns, rows, np.zeros_like(rows)])
    patch = np.mgrid[:96, :96][::-1].reshape(2, -1).T + 0.5
    things = np.column_stack([half * np.random.RandomState(1).uniform(-1.0, 1.0, (200, 2)) * (0.8, 1.0), np.ones(200)])
    views = 0
    for angle, around in [(angle, around) for angle in range(20, 90, 2) for around in (0, 35, 90)]:
        pixels = lens.project(things @ Rotation.from_euler("zy", (around, angle), degrees=True).as_matrix().T)
        view = lens.facing_view(pixels) if np.isfinite(pixels).all() else None
        if view is None:
            continue
        views += 1
        seen = view.see(pixels)
        centre, side = (seen.max(axis=0) + seen.min(axis=0)) / 2.0, 1.5 * np.ptp(seen, axis=0).max()
        crop, affine = view.crop(image, centre, side, 0.0, 96)
        places = view.back(patch @ affine[:, :2].T + affine[:, 2]) - 0.5
        assert np.isfinite(places).all() and np.abs(places).max() < 1e4, angle
        inside = ((places >= 0.0) & (places <= (1279, 959))).all(axis=1)
        assert np.abs(crop[..., :2].reshape(-1, 2) - places)[inside].max(initial=0.0) < 0.01 * side, angle
    assert views > 10


@pytest.mark.parametrize("focal, centre, zoom, told", [
    (600.0, 320.0, 1.0, False), (630.0, 325.0, 1.0, False), (700.0, 320.0, 1.0, True), (500.0, 320.0, 1.0, True),
    (600.0, 380.0, 1.0, True), (1200.0, 320.0, 2.0, False), (600.0, 320.0, 2.0, True)])
def test_a_calibration_is_told_anew_where_it_puts_things_elsewhere_by_no_zoom(focal, centre, zoom, told):
    before, now = (CameraModel.from_calibration(640, 480, [f, 0, x, 0, f, 240, 0, 0, 1], [], "plumb_bob", 1.0)
                   for f, x in ((600.0, 320.0), (focal, centre)))
    assert now.is_told_anew(before, zoom) == told
