"""Converted models against their original runtime (LiteRT), out of real package files.

The packages are looked for in $ROS4HRI_PACKAGES, by default ~/.cache/ros4hri/packages; this puts them there:
    fetch_models --models all --force --packages ~/.cache/ros4hri/packages --keep-packages
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, List

import numpy as np
import onnxruntime
import pytest

from hri_pipeline.models.catalogue import PACKAGES, PRODUCTS, Product
from hri_pipeline.models.convert import convert, tflite_of
from hri_pipeline.models.packages import read_members

RELATIVE_LIMIT = 5e-5  # of the largest value; float rounding on pictures of noise
# LiteRT does not know the attention mesh's custom operators; test/unit compares those with numpy.
RUNNABLE = [p for p in PRODUCTS if p.converter == "tflite" and p.output != "face_landmarks_attention.onnx"]


def archive_of(product: Product) -> Path:
    default = Path.home() / ".cache" / "ros4hri" / "packages"
    directory = Path(os.environ.get("ROS4HRI_PACKAGES", str(default)))
    archive = directory / PACKAGES[product.package].filename
    if not archive.is_file():
        pytest.skip("%s is absent; see the head of this file" % archive)
    return archive


def run(content: bytes, image: np.ndarray) -> List[np.ndarray]:
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    return session.run(None, {session.get_inputs()[0].name: image})


def interpreter_class() -> Any:
    try:
        from ai_edge_litert.interpreter import Interpreter
    except ImportError:
        return pytest.importorskip("tflite_runtime.interpreter").Interpreter
    return Interpreter


@pytest.mark.parametrize("product", RUNNABLE, ids=lambda product: product.name)
def test_tflite_equals_litert(product: Product) -> None:
    interpreter_type = interpreter_class()
    contents = read_members(archive_of(product), dict(product.members))
    interpreter = interpreter_type(model_content=tflite_of(product, contents), num_threads=1)
    interpreter.allocate_tensors()
    batch, *sizes = interpreter.get_input_details()[0]["shape"]
    shape = [3] + sizes
    images = np.random.default_rng(1).uniform(-1, 1, shape).astype(np.float32)
    results = run(convert(product, contents), images)
    details = {d["name"].split(":")[0]: d["index"] for d in interpreter.get_output_details()}
    by_shape = {tuple(d["shape"][1:]): d["index"] for d in interpreter.get_output_details()}
    only = interpreter.get_output_details()[0]["index"] if len(by_shape) == 1 else None
    for row in range(len(images)):
        given = np.repeat(images[row : row + 1], batch, axis=0)
        interpreter.set_tensor(interpreter.get_input_details()[0]["index"], given)
        interpreter.invoke()
        for name, result in zip(product.outputs, results):
            index = details[name] if name in details else only if only is not None else by_shape[result.shape[1:]]
            expected = interpreter.get_tensor(index)
            if expected.size != result[row].size:       # one may lack the batch, another has it fixed
                expected = expected[0]
            expected = expected.reshape(result.shape[1:])
            limit = RELATIVE_LIMIT * max(float(np.abs(expected).max()), 1.0)
            np.testing.assert_allclose(result[row], expected, atol=limit, rtol=0, err_msg=name)


# Moonshine's networks are taken as they are, and have a sentence at a time.
BATCHED = [p for p in PRODUCTS if p.output.endswith(".onnx") and not p.name.startswith("moonshine")]


@pytest.mark.parametrize("product", BATCHED, ids=lambda product: product.name)
def test_batch_rows_are_independent(product: Product) -> None:
    content = convert(product, read_members(archive_of(product), dict(product.members)))
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    assert [o.name for o in session.get_outputs()] == list(product.outputs)
    assert [i.name for i in session.get_inputs()] == list(product.inputs)
    if product.output == "silero_vad.onnx":
        return
    given = session.get_inputs()[0]
    shape = [2] + [size if isinstance(size, int) else 64 for size in given.shape[1:]]
    images = np.random.default_rng(2).uniform(0, 1, shape).astype(np.float32)
    both = session.run(None, {given.name: images})
    second = session.run(None, {given.name: images[1:]})
    for name, a, b in zip(product.outputs, both, second):
        np.testing.assert_allclose(
            a[1:], b, rtol=0, atol=1e-4 * max(float(np.abs(b).max()), 1e-3), err_msg=name
        )
