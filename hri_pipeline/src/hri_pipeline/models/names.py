"""File and tensor names of the models: plain constants, shared by those who fetch and those who load.

Importing this module costs nothing: neither onnx nor onnxruntime is touched.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Dict, NamedTuple, Tuple

DIRECTORY_VARIABLE = "ROS4HRI_MODELS"
MANIFEST = "manifest.json"

FACE_DETECTION_FULL_RANGE = "face_detection_full_range.onnx"
FACE_DETECTION_SHORT_RANGE = "face_detection_short_range.onnx"
FACE_LANDMARKS_ATTENTION = "face_landmarks_attention.onnx"
POSE_LANDMARKS_FULL = "pose_landmarks_full.onnx"
POSE_LANDMARKS_LITE = "pose_landmarks_lite.onnx"
POSE_LANDMARKS_HEAVY = "pose_landmarks_heavy.onnx"
POSE_DETECTION = "pose_detection.onnx"
PERSON_CENTERNET = "person_centernet.onnx"
MOVENET = "movenet.onnx"
FACE_EXPRESSION = "face_expression.onnx"
AGE_GENDER = "age_gender.onnx"
FACE_RECOGNITION = "face_recognition.onnx"
FACERES = "faceres.onnx"
SILERO_VAD = "silero_vad.onnx"
CANONICAL_FACE = "canonical_face.npz"
DEMO_PICTURES = tuple("demo/sample%d.jpg" % number for number in range(1, 7))


class TensorNames(NamedTuple):
    """Names of a model's inputs and outputs, in order."""

    inputs: Tuple[str, ...]
    outputs: Tuple[str, ...]


_POSE = TensorNames(("input_1",), ("Identity", "Identity_1", "Identity_4"))

TENSORS: Dict[str, TensorNames] = {
    FACE_DETECTION_FULL_RANGE: TensorNames(("input_1",), ("Identity", "Identity_1")),
    FACE_DETECTION_SHORT_RANGE: TensorNames(("input",), ("regressors", "classificators")),
    FACE_LANDMARKS_ATTENTION: TensorNames(
        ("input_1",),
        (
            "output_mesh_identity",
            "output_lips",
            "output_left_eye",
            "output_right_eye",
            "output_left_iris",
            "output_right_iris",
            "conv_faceflag",
        ),
    ),
    POSE_LANDMARKS_FULL: _POSE,
    POSE_LANDMARKS_LITE: _POSE,
    POSE_LANDMARKS_HEAVY: _POSE,
    POSE_DETECTION: TensorNames(("input_1",), ("Identity", "Identity_1")),
    PERSON_CENTERNET: TensorNames(("images",), ("heat", "ltrb")),
    MOVENET: TensorNames(
        ("images",), ("keypoint_heat", "keypoint_regression", "center_heat", "keypoint_offset")
    ),
    FACE_EXPRESSION: TensorNames(("image",), ("expression",)),
    AGE_GENDER: TensorNames(("image",), ("age", "gender")),
    FACE_RECOGNITION: TensorNames(("image",), ("embedding",)),
    FACERES: TensorNames(("input_1",), ("gender", "descriptor", "age")),
    SILERO_VAD: TensorNames(("input", "state", "sr"), ("output", "stateN")),
}


def default_directory() -> Path:
    """The directory of the models: $ROS4HRI_MODELS, or ros4hri/models in the user's cache directory."""
    configured = os.environ.get(DIRECTORY_VARIABLE, "")
    if configured:
        return Path(configured).expanduser()
    return cache_directory() / "models"


def cache_directory() -> Path:
    """ros4hri's part of the user's cache, ~/.cache/ros4hri."""
    return Path.home() / ".cache" / "ros4hri"
