"""Where the model files are."""

from __future__ import annotations

import os
from pathlib import Path

from hri_pipeline.core.onnx_model import FETCH_MEND, ModelError

MODELS_VARIABLE = "ROS4HRI_MODELS"


def models_directory() -> Path:
    """Return $ROS4HRI_MODELS, by default ~/.cache/ros4hri/models. It need not exist."""
    configured = os.environ.get(MODELS_VARIABLE, "")
    if configured:
        return Path(configured).expanduser()
    return Path.home() / ".cache" / "ros4hri" / "models"


def model_path(configured: str, default_name: str) -> Path:
    """Return the file of a model: `configured` where it is not empty, else `default_name` of the models directory.

    Raises ModelError that names the file and the mend when it is not there.
    """
    if configured:
        path = Path(configured).expanduser()
        mend = "correct the parameter that names it, or leave it empty for the default ({})".format(
            models_directory() / default_name)
    else:
        path = models_directory() / default_name
        mend = "{}, or set ${} to the directory that holds it".format(FETCH_MEND, MODELS_VARIABLE)
    if not path.is_file():
        raise ModelError("model file {} does not exist; {}".format(path, mend))
    return path
