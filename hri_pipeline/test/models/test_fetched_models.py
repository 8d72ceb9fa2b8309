"""The models directory ($ROS4HRI_MODELS): complete, loadable, with the names that the nodes rely on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hri_pipeline.core.onnx import models_directory
from hri_pipeline.models.catalogue import PRODUCTS, Product
from hri_pipeline.models.convert import describe

DEFAULT = [product for product in PRODUCTS if product.default]


def model(output: str) -> Path:
    path = models_directory() / output
    assert path.is_file(), "%s is absent; run fetch_models, or set $ROS4HRI_MODELS" % path
    return path


@pytest.mark.parametrize("product", DEFAULT, ids=lambda product: product.output)
def test_file_is_there_and_has_the_right_tensors(product: Product) -> None:
    described = describe(model(product.output), product.output)
    if product.converter in ("tflite", "tfjs", "faceapi"):
        assert described["inputs"][0]["shape"][0] == "N"


def test_person_detector_takes_any_size() -> None:
    described = describe(model("person_centernet.onnx"), "person_centernet.onnx")
    assert described["inputs"][0]["shape"] == ["N", "H", "W", 3]
    assert [output["shape"][-1] for output in described["outputs"]] == [80, 4]


def test_canonical_face_is_metric_and_symmetric() -> None:
    with np.load(str(model("canonical_face.npz"))) as arrays:
        vertices, index, weight = (arrays[n] for n in ("vertices", "procrustes_index", "procrustes_weight"))
    assert vertices.shape == (468, 3) and len(index) == len(weight) == 33
    assert 0.08 < np.linalg.norm(vertices[33] - vertices[263]) < 0.10  # outer corners of the eyes, metres
    assert vertices[33, 0] < 0 < vertices[263, 0]  # the subject's right eye is left in the image
    assert vertices[10, 1] > vertices[152, 1]  # forehead above chin
    assert vertices[1, 2] > vertices[[33, 263], 2].max()  # nose towards the camera
    np.testing.assert_allclose(vertices[33] * [-1, 1, 1], vertices[263], atol=1e-3)
    assert (weight > 0).all() and index.max() < 468
