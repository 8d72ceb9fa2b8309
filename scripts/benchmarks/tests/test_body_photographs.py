"""People on photographs: what their answers may hang on."""

from benchmarks import body_photographs
from benchmarks.face_figures import GEOMETRY_ONLY
from hri_fullbody.core.parameters import VISION


def test_no_limit_of_time_decides_what_is_looked_at():
    settings = VISION.resolve(dict(GEOMETRY_ONLY, **body_photographs._UNLIMITED))
    assert settings.cpu_share == 0.0 and settings.pose_budget == 0, "bodies"
    assert settings.face_budget == 1000.0 and settings.face_mesh_rate == 0.0, "a second for the faces of each image"
