"""Tests of the figures of faces."""

import numpy as np

from benchmarks.face_figures import expressions_told
from hri_pipeline.core.faces.expression import ExpressionEstimate
from hri_pipeline.core.observations import FaceObservation


def test_an_image_in_which_a_face_was_not_measured_takes_nothing_back_of_its_expression():
    told = {}
    for images in ([face("happy"), face("happy", "other")], [face(None, measured=False), face(None, "other")]):
        told.update(expressions_told(images))
    assert told == {"one": "happy", "other": None}


def face(category, identity="one", measured=True):
    expression = None if category is None else ExpressionEstimate(category, 0.0, 0.0, 0.9)
    return FaceObservation(identity, np.zeros(4), 1.0, np.zeros((70, 3)), np.zeros((478, 3)), expression=expression,
                           measured=measured)
