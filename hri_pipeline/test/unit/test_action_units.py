"""Action units on a face put together of the points they use: every unit follows its own deformation, and no turn."""

import copy
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hri_pipeline.core.camera import Calibration, CameraModel
from hri_pipeline.core.faces.action_units import (
    ACTION_UNITS,
    MAX_DEVIATION,
    MEASURES,
    MIRROR,
    RIGID,
    ActionUnitEstimator,
    FaceMeasures,
    angles_to_sight,
)
from hri_pipeline.core.faces.mesh import CanonicalFace
from hri_pipeline.core.geometry import Pose

EYES = 63.0
"""Distance (mm) of the eyes of the face below."""

# Rough places (mm) of the right half of a face: to its left, down, into the head.
_RIGHT = {
    33: (-44, -27, -32), 133: (-19, -26, -38), 158: (-27, -30, -39), 159: (-32, -30, -39), 160: (-37, -30, -37),
    144: (-37, -23, -36), 145: (-32, -22, -38), 153: (-27, -22, -38), 107: (-14, -50, -53), 55: (-14, -41, -51),
    70: (-57, -43, -28), 46: (-52, -39, -34), 63: (-50, -47, -38), 53: (-46, -43, -40), 105: (-40, -51, -45),
    52: (-37, -45, -46), 50: (-48, 7, -35), 101: (-33, -1, -41), 118: (-44, -7, -35), 64: (-16, 12, -55),
    48: (-16, 10, -58), 102: (-17, 9, -53), 37: (-7, 34, -59), 39: (-14, 36, -55), 40: (-19, 38, -51),
    61: (-25, 43, -43), 76: (-25, 43, -43), 82: (-7, 42, -52), 81: (-12, 42, -50), 87: (-7, 43, -53),
    178: (-12, 43, -51), 84: (-7, 54, -55), 181: (-13, 53, -52), 91: (-18, 50, -49), 148: (-12, 93, -42),
    127: (-77, -24, 20), 234: (-77, -7, 24), 132: (-73, 29, 22), 93: (-76, 10, 24), 54: (-55, -70, -20),
    67: (-36, -80, -38), 143: (-55, -26, -22), 21: (-66, -58, -5), 103: (-47, -76, -30), 109: (-20, -83, -44),
    162: (-75, -40, 10), 468: (-32, -27, -39),
}
_MIDDLE = {0: (0, 35, -60), 13: (0, 42, -53), 14: (0, 43, -54), 17: (0, 54, -55), 2: (0, 21, -61), 168: (0, -33, -52),
           6: (0, -25, -58), 197: (0, -14, -65), 195: (0, -8, -69), 151: (0, -66, -52), 152: (0, 94, -43)}


def face_points():
    points = np.zeros((478, 3))
    for vertex, place in list(_RIGHT.items()) + list(_MIDDLE.items()):
        points[vertex] = place
    for right, left in MIRROR.items():
        points[left] = points[right] * (-1, 1, 1)
    return points


FACE = face_points()
MEASURES_OF_FACE = FaceMeasures(CanonicalFace(FACE[:468] / 1000.0, np.array(RIGID)))
TURNS = [(0, 0, 0), (40, 0, 0), (-40, 0, 0), (0, 25, 0), (0, -25, 0), (0, 0, 40), (25, 15, -30)]


def seen(points, turn=(0, 0, 0), size=120.0, place=(640.0, 360.0)):
    """The mesh (478, 3) px of points (mm) turned by yaw, pitch, roll (degrees); size: px between the eyes."""
    rotation = Rotation.from_euler("yxz", turn, degrees=True).as_matrix()
    mesh = points @ rotation.T * (size / EYES)
    return mesh + (place[0], place[1], 0.0)


def after_ten_seconds():
    estimator = ActionUnitEstimator(MEASURES_OF_FACE)
    for step in range(50):
        estimator.update(seen(FACE), None, 0.2 * step)
    return estimator


SETTLED = after_ten_seconds()


def test_nothing_is_told_of_eyes_behind_dark_glasses():
    smiling, shut = moved(FACE, CORNER, (7, 7, 3)), moved(FACE, UPPER_LID, (0, -8, 0))
    for face in smiling, shut:
        bare, hidden = (settled().update(seen(face), looking(0, 0, 0, (0, 0, 1.0)), 10.0, eyes_closed=0.9,
                                         eyes_hidden=is_hidden) for is_hidden in (False, True))
        of_eyes = [5, 7, 43, 45, 61, 62, 63, 64]
        assert (hidden.confidence[of_eyes] == 0.0).all() and bare.confidence[45] > 0.9
        assert (hidden.intensity[71], bare.intensity[71]) == (1.0, 0.0) and hidden.intensity[73] == 0.0
        others = [1, 2, 4, 10, 12, 15, 25, 26, 51, 54]
        assert (hidden.confidence[others] == bare.confidence[others]).all()
        assert (hidden.intensity[others] == bare.intensity[others]).all()


def settled():
    """An estimator that has seen this face at rest for ten seconds."""
    return copy.deepcopy(SETTLED, {id(MEASURES_OF_FACE): MEASURES_OF_FACE})


def moved(points, vertices, shift):
    """Points with vertices (of the right, and their mirrors) shifted by (out, up, back) in mm."""
    points = points.copy()
    out, up, back = shift
    for vertex in vertices:
        points[vertex] += (-out, -up, back) if vertex in MIRROR else (0, -up, back)
        if vertex in MIRROR:
            points[MIRROR[vertex]] += (out, -up, back)
    return points


BROW_IN, BROW_OUT = (107, 55), (70, 46, 63, 53)
UPPER_LID, LOWER_LID = (158, 159, 160), (144, 145, 153)
CORNER, UPPER_LIP, LOWER_LIP = (61, 76), (0, 37, 39, 40), (17, 84, 181, 91)
INNER_UP, INNER_DOWN, CHIN = (13, 82, 81), (14, 87, 178), (152, 148)

DEFORMATIONS = {
    1: [(BROW_IN, (0, 8, 0))],
    2: [(BROW_OUT, (0, 8, 0))],
    4: [(BROW_IN, (-4, -5, 0)), (BROW_OUT, (0, -4, 0))],
    5: [(UPPER_LID, (0, 4, 0))],
    6: [((50, 101, 118), (0, 5, 0)), (LOWER_LID, (0, 2.5, 0))],
    7: [(LOWER_LID, (0, 3, 0))],
    9: [((64, 48, 102), (0, 6, 0))],
    10: [(UPPER_LIP, (0, 7, 0))],
    12: [(CORNER, (7, 7, 3))],
    14: [(CORNER, (6, 0, 3))],
    15: [(CORNER, (0, -7, 0))],
    17: [(LOWER_LIP + INNER_DOWN, (0, 7, 0))],
    20: [(CORNER, (9, -2, 3))],
    23: [(UPPER_LIP, (0, -3.5, 0)), (LOWER_LIP, (0, 4, 0)), (CORNER, (-3, 0, 0))],
    24: [(UPPER_LIP, (0, -3.5, 0)), (LOWER_LIP, (0, 4.5, 0))],
    25: [(INNER_DOWN + LOWER_LIP, (0, -8, 0))],
    26: [(CHIN + LOWER_LIP + INNER_DOWN, (0, -11, 0))],
    27: [(CHIN, (0, -25, 0)), (LOWER_LIP + INNER_DOWN, (0, -33, 0))],
    28: [(UPPER_LIP, (0, -6.5, 0)), (LOWER_LIP, (0, 9, 0))],
    45: [(UPPER_LID, (0, -8, 0))],
}


def deformed(code):
    points = FACE
    for vertices, shift in DEFORMATIONS[code]:
        points = moved(points, vertices, shift)
    return points


def test_every_unit_of_the_table_has_a_deformation_here():
    assert {unit.code for unit in ACTION_UNITS} | {45} == set(DEFORMATIONS)


@pytest.mark.parametrize("code", sorted(DEFORMATIONS))
def test_a_unit_rises_with_its_deformation(code):
    at_rest = settled().update(seen(FACE), None, 20.0)
    strong = settled().update(seen(deformed(code)), None, 20.0)
    half = settled().update(seen(0.5 * (FACE + deformed(code))), None, 20.0)
    assert at_rest.intensity[code] < 0.05
    assert strong.intensity[code] > 0.35
    assert at_rest.intensity[code] <= half.intensity[code] < strong.intensity[code]
    assert strong.confidence[code] > 0.2


@pytest.mark.parametrize("turn", TURNS)
def test_a_turned_head_makes_no_unit(turn):
    units = settled().update(seen(FACE, turn), None, 20.0)
    for code in DEFORMATIONS:
        assert units.intensity[code] < 0.05, code


@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("code", sorted(DEFORMATIONS))
def test_a_unit_does_not_depend_on_the_turn_and_size(code, turn):
    straight = settled().update(seen(deformed(code)), None, 20.0).intensity[code]
    turned = settled().update(seen(deformed(code), turn, 60.0, (200.0, 100.0)), None, 20.0).intensity[code]
    assert turned == pytest.approx(straight, abs=0.05)


@pytest.mark.parametrize("yaw, own, other", [(40.0, "left", "right"), (-40.0, "right", "left")])
def test_the_head_codes_tell_the_side(yaw, own, other):
    codes = {"left": 51, "right": 52}
    # A positive turn about the image's downward axis leads the nose (at -z) to the image's left: the subject's right.
    units = settled().update(seen(FACE, (-yaw, 0, 0)), None, 20.0)
    assert units.intensity[codes[own]] > 0.7 and units.intensity[codes[other]] == 0.0
    assert units.confidence[codes[own]] > 0.9


def looking(yaw, pitch, roll, place):
    """Pose of a face frame; yaw to its own left, pitch up, roll: top of the head to its own left, degrees."""
    upright = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
    turn = Rotation.from_euler("zyx", [roll, -yaw, -pitch], degrees=True).as_matrix()
    return Pose(turn @ upright, np.array(place))


@pytest.mark.parametrize("angles, code", [((30, 0, 0), 51), ((-30, 0, 0), 52), ((0, 20, 0), 53), ((0, -20, 0), 54),
                                          ((0, 0, 20), 55), ((0, 0, -20), 56)])
def test_head_codes_follow_the_pose(angles, code):
    pose = looking(*angles, (0.0, 0.0, 1.0))
    units = settled().update(seen(FACE), pose, 20.0)
    assert units.intensity[code] > 0.4
    assert units.intensity[[other for other in range(51, 57) if other != code]].max() < 0.1
    if code == 55:
        assert (pose.rotation @ (0.0, 0.0, 1.0))[0] > 0.0, "the scalp leans to the image's right: to the subject's left"


def test_a_face_at_the_border_that_looks_into_the_camera_is_not_turned():
    place = np.array([0.8, 0.3, 1.0])
    ahead = -place / np.linalg.norm(place)
    left = np.cross([0.0, -1.0, 0.0], ahead)
    left /= np.linalg.norm(left)
    rotation = np.stack([ahead, left, np.cross(ahead, left)], axis=1)
    assert np.degrees(np.abs(angles_to_sight(rotation, place))).max() < 1e-6
    straight = looking(0, 0, 0, place)
    assert np.degrees(angles_to_sight(straight.rotation,
                                      place))[0] == pytest.approx(np.degrees(np.arctan2(0.8, 1.0)), abs=1)


def confidences_while_nodding(degrees):
    """Of nods told, with this way from peak to peak."""
    estimator, found = ActionUnitEstimator(MEASURES_OF_FACE), []
    for step in range(40):
        pitch = 0.5 * degrees * np.sin(2.0 * np.pi * 2.0 * 0.1 * step + 0.3)
        units = estimator.update(seen(FACE), looking(0, pitch, 0, (0, 0, 1.0)), 0.1 * step)
        if units.intensity[85] > 0.0:
            found.append(float(units.confidence[85]))
    return found


def test_a_small_nod_may_be_speech_and_a_large_one_is_none():
    small, large = confidences_while_nodding(7.5), confidences_while_nodding(16.0)
    assert small and max(small) < 0.9 and large and min(large) > 0.95
    still = ActionUnitEstimator(MEASURES_OF_FACE).update(seen(FACE), looking(0, 0, 0, (0, 0, 1.0)), 0.0)
    assert still.intensity[85] == 0.0 and still.confidence[85] > 0.95


def test_forward_and_back():
    estimator = ActionUnitEstimator(MEASURES_OF_FACE)
    for step in range(100):
        estimator.update(seen(FACE), looking(0, 0, 0, (0, 0, 1.0)), 0.1 * step)
    forward = estimator.update(seen(FACE), looking(0, 0, 0, (0, 0, 0.85)), 10.1)
    assert forward.intensity[57] > 0.8 and forward.intensity[58] == 0.0 and 0.0 < forward.confidence[57] < 0.31
    for step in range(300):
        units = estimator.update(seen(FACE), looking(0, 0, 0, (0, 0, 0.85)), 10.2 + 0.1 * step)
    assert units.intensity[57] < 0.05, "who stays there stands there"
    assert estimator.update(seen(FACE), None, 50.0).confidence[57] == 0.0, "without a pose nothing is known of it"


@pytest.mark.parametrize("shift, code", [((6, 0), 61), ((-6, 0), 62), ((0, 4), 63), ((0, -4), 64)])
def test_eye_codes(shift, code):
    points = FACE.copy()
    points[[468, 473]] += (shift[0], -shift[1], 0.0)
    units = settled().update(seen(points), None, 20.0)
    assert units.intensity[code] > 0.7 and units.confidence[code] > 0.8
    closed = moved(points, UPPER_LID, (0, -8, 0))
    assert settled().update(seen(closed), None, 20.0).confidence[code] < 0.05


def test_a_blink_and_closed_eyes():
    estimator = settled()
    closed = seen(deformed(45))
    blink = estimator.update(closed, None, 20.0)
    assert blink.intensity[45] > 0.9 and blink.intensity[43] == 0.0
    assert estimator.update(closed, None, 20.4).intensity[43] == 0.0
    assert estimator.update(closed, None, 20.6).intensity[43] > 0.9
    assert estimator.update(seen(FACE), None, 20.7).intensity[[43, 45]].max() < 0.05


def test_who_sleeps_from_the_start_has_closed_eyes():
    estimator = ActionUnitEstimator(MEASURES_OF_FACE)
    for step in range(150):
        units = estimator.update(seen(deformed(45)), None, 0.4 * step)
    assert units.intensity[45] > 0.9 and units.intensity[43] > 0.9


def test_a_face_with_low_brows_becomes_its_own_neutral():
    own = moved(moved(FACE, BROW_IN, (0, -4.0, 0)), BROW_OUT, (0, -4.0, 0))
    estimator = ActionUnitEstimator(MEASURES_OF_FACE)
    first = estimator.update(seen(own), None, 0.0)
    for step in range(1, 200):
        units = estimator.update(seen(own), None, 0.1 * step)
    assert units.neutral_known > 0.8 > 0.2 > first.neutral_known
    assert units.confidence[4] > first.confidence[4]
    assert units.intensity[4] < 0.1
    raised = estimator.update(seen(FACE), None, 20.0)
    strange = ActionUnitEstimator(MEASURES_OF_FACE).update(seen(FACE), None, 0.0)
    assert raised.intensity[1] > strange.intensity[1], "brows that are ordinary for others are raised for this person"


def test_a_long_smile_does_not_become_neutral():
    estimator = settled()
    smile = seen(deformed(12))
    for step in range(150):
        units = estimator.update(smile, None, 20.0 + 0.1 * step)
    assert units.intensity[12] > 0.6


def test_a_mild_smile_from_the_first_image_on_is_not_taken_for_the_face():
    mild = seen(0.25 * FACE + 0.75 * deformed(12))
    estimator = ActionUnitEstimator(MEASURES_OF_FACE)
    first = estimator.update(mild, None, 0.0).intensity[12]
    for step in range(1, 90):
        units = estimator.update(mild, None, 0.2 * step)
    assert first > 0.25 and units.intensity[12] > 0.8 * first


def test_the_neutral_never_leaves_the_range_of_people():
    grotesque = moved(FACE, BROW_IN, (0, 40, 0))
    estimator = ActionUnitEstimator(MEASURES_OF_FACE)
    for step in range(200):
        units = estimator.update(seen(grotesque), None, 0.4 * step)
    assert units.intensity[1] > 0.5
    assert MAX_DEVIATION <= 3.0


PICTURE = CameraModel.from_fov(1280, 720, 0.9)
CAMERAS = {
    "wide": CameraModel(1280, 720, np.array([[410.0, 0, 640], [0, 410.0, 360], [0, 0, 1]]), np.zeros(0), "plumb_bob",
                        Calibration.CALIBRATED),
    "lens": CameraModel(1280, 720, np.array([[700.0, 0, 640], [0, 700.0, 360], [0, 0, 1]]),
                        np.array([-0.3, 0.1, 0.0, 0.0, 0.0]), "plumb_bob", Calibration.CALIBRATED),
    "fisheye": CameraModel(1280, 720, np.array([[500.0, 0, 640], [0, 500.0, 360], [0, 0, 1]]), np.zeros(4),
                           "equidistant", Calibration.CALIBRATED)}


def taken_by(camera, points, aside):
    """The mesh (478, 3) px of points (mm) 1 m away that turn with the way to them: degrees about x, and y; depths as
    the network gives them, in the scale of what it sees."""
    turn = Rotation.from_euler("xyz", (*aside, 0.0), degrees=True).as_matrix()
    around = points - points[list(RIGID)].mean(axis=0)
    mesh = around.copy()
    mesh[:, :2] = camera.project((around / 1000.0 + (0.0, 0.0, 1.0)) @ turn.T)
    used = [*MIRROR, *MIRROR.values()]
    mesh[:, 2] *= np.sqrt(mesh[used, :2].var(axis=0).sum() / around[used, :2].var(axis=0).sum())
    return mesh


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
@pytest.mark.parametrize("aside", [(0, 38), (0, -25), (20, -30)])
@pytest.mark.parametrize("code", [9, 12, 26, 45])
def test_a_unit_does_not_depend_on_the_place_in_the_image(camera, aside, code):
    for points in FACE, deformed(code):
        ahead, found = (settled().update(taken_by(camera, points, place), None, 20.0, 1.0, camera).intensity
                        for place in ((0, 0), aside))
        units = [*(unit.code for unit in ACTION_UNITS), 45]
        assert found[units] == pytest.approx(ahead[units], abs=0.1)


def test_confidence_falls_with_size_turn_and_presence():
    def confidence(turn=0.0, size=120.0, presence=1.0):
        return settled().update(seen(FACE, (turn, 0, 0), size), None, 20.0, presence).confidence[12]

    full = confidence()
    assert full > 0.8
    assert full > confidence(turn=45) > confidence(turn=60) and confidence(turn=80) == 0.0
    assert full > confidence(size=20) > confidence(size=10) and confidence(size=7) == 0.0
    assert confidence(presence=0.5) == pytest.approx(0.5 * full, abs=0.01)


def test_what_cannot_be_seen_has_its_code_and_no_confidence():
    whole = settled().update(seen(FACE), None, 20.0, 1.0, PICTURE)
    assert (whole.intensity[70:74] == 0.0).all() and (whole.confidence[70:74] == 1.0).all()
    upper_cut = settled().update(seen(FACE, place=(640.0, 30.0)), None, 20.0, 1.0, PICTURE)
    assert upper_cut.intensity[70] == 1.0 and upper_cut.intensity[72] == 0.0 and upper_cut.intensity[73] == 0.0
    assert upper_cut.confidence[1] == upper_cut.confidence[2] == 0.0 < upper_cut.confidence[26]
    lower_cut = settled().update(seen(FACE, place=(640.0, 700.0)), None, 20.0, 1.0, PICTURE)
    assert lower_cut.intensity[72] == 1.0 and lower_cut.intensity[70] == 0.0
    assert lower_cut.confidence[[12, 15, 25, 26]].max() == 0.0 < lower_cut.confidence[1]
    turned = settled().update(seen(FACE, (85, 0, 0)), None, 20.0)
    assert (turned.intensity[70:74] == 1.0).all()
    assert turned.confidence[[unit.code for unit in ACTION_UNITS]].max() == 0.0


def test_what_no_lens_has_seen_is_no_error():
    lens = CameraModel(1280, 720, PICTURE.matrix, np.array([9.0, -90.0, 0.0, 0.0, 900.0]), "plumb_bob",
                       Calibration.CALIBRATED)
    for place in ((640.0, 360.0), (-900.0, 30.0), (1e5, -1e5)):
        units = settled().update(seen(FACE, place=place), None, 20.0, 1.0, lens)
        assert np.isfinite(units.intensity).all() and np.isfinite(units.confidence).all()


@pytest.mark.parametrize("mesh", [np.full((478, 3), np.nan), np.zeros((478, 3)),
                                  np.where(np.arange(1434).reshape(478, 3) == 7, np.inf, 1.0)])
def test_a_mesh_that_is_none_is_a_face_not_seen(mesh):
    estimator = settled()
    units = estimator.update(mesh, None, 20.0)
    assert (units.intensity[70:74] == 1.0).all() and units.confidence[:70].max() == 0.0
    assert np.isfinite(units.intensity).all()
    assert estimator.update(seen(FACE), None, 20.1).neutral_known > 0.8, "the neutral is kept"


def test_random_points_are_no_face():
    mesh = np.random.RandomState(0).uniform(0, 400, (478, 3))
    units = ActionUnitEstimator(MEASURES_OF_FACE).update(mesh, None, 0.0)
    assert units.confidence[[unit.code for unit in ACTION_UNITS]].max() == 0.0
    assert ((units.intensity >= 0.0) & (units.intensity <= 1.0)).all()


def test_wrong_arguments_are_told():
    with pytest.raises(ValueError, match="478"):
        ActionUnitEstimator(MEASURES_OF_FACE).update(np.zeros((468, 3)), None, 0.0)
    with pytest.raises(ValueError, match="stamp"):
        ActionUnitEstimator(MEASURES_OF_FACE).update(seen(FACE), None, float("nan"))


def test_time_that_goes_back_is_a_new_start():
    estimator = settled()
    assert estimator.update(seen(FACE), None, 20.0).neutral_known > 0.8
    assert estimator.update(seen(FACE), None, 3.0).neutral_known < 0.2


def test_the_table_is_consistent():
    names = [measure.name for measure in MEASURES]
    assert len(set(names)) == len(names)
    codes = [unit.code for unit in ACTION_UNITS]
    assert codes == sorted(set(codes))
    for unit in ACTION_UNITS:
        assert 0.0 < unit.start < unit.full and 0.0 < unit.reliability <= 1.0
        assert all(name in names for name, _ in unit.terms)
    for measure in MEASURES:
        assert measure.axis in ("up", "out", "left") and 0.0 < measure.quantile < 1.0 and measure.spread > 0.0


def test_the_page_has_every_unit():
    page = Path(__file__).resolve().parents[3] / "docs" / "face_features.md"
    if not page.is_file():
        pytest.skip("no docs beside an installed package")
    text = page.read_text(encoding="utf-8")
    for unit in ACTION_UNITS:
        told = "{} {} ({:g})".format(unit.code, unit.name, unit.reliability)
        assert told in text, told
