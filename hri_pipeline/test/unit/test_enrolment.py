"""Who may be enrolled from photographs beside those who are in the store already."""

import numpy as np
import pytest

from hri_pipeline.core.recognition.enrolment import EnrolmentError, PhotographTemplates, enrol
from hri_pipeline.core.recognition.likelihood import TemplateCalibration
from hri_pipeline.core.recognition.store import PersonStore

CALIBRATION = TemplateCalibration(midpoint=0.38, fair_midpoint=0.40, scale=0.0135, near=0.15,
                                  centre=tuple(float(number) for number in np.eye(8)[0]), radius=0.41)


def photographs(turn: float, off: float) -> PhotographTemplates:
    """Return one template, `off` rad from the mean of all, in the direction `turn` (rad) as seen from there."""
    template = np.zeros((1, 8), np.float32)
    template[0, :3] = np.cos(off), np.sin(off) * np.cos(turn), np.sin(off) * np.sin(turn)
    return PhotographTemplates(template, "synthetic", CALIBRATION, ())


def test_people_near_the_mean_of_all_are_told_apart_as_by_the_recogniser(tmp_path):
    store = PersonStore(tmp_path / "people.sqlite")
    try:
        first = enrol(store, "Ada", photographs(0.0, 0.32), 1000.0)
        other = photographs(1.3, 0.32)
        assert np.linalg.norm(other.templates - photographs(0.0, 0.32).templates) == pytest.approx(0.38, abs=0.01)
        assert enrol(store, "Eve", other, 1000.0) != first, "0.49, as it counts"
        with pytest.raises(EnrolmentError, match="looks the same"):
            enrol(store, "Eva", photographs(0.6, 0.32), 1000.0)
    finally:
        store.close()
