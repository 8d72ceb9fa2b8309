"""ONNX models: where their files are, and how they run on onnxruntime."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Callable, Dict, List, Optional, Sequence, Tuple, Union

import numpy as np
import onnxruntime

FETCH_HINT = "get it with `rosrun hri_pipeline fetch_models`"
MODELS_VARIABLE = "ROS4HRI_MODELS"

PROVIDERS: Dict[str, str] = {
    "cpu": "CPUExecutionProvider",
    "cuda": "CUDAExecutionProvider",
    "tensorrt": "TensorrtExecutionProvider",
    "openvino": "OpenVINOExecutionProvider",
}

_FATAL_ONLY = 4


class ModelError(RuntimeError):
    """A model file is missing, damaged, or not the model that is needed."""


def choose_providers(wanted: Sequence[str], available: Sequence[str]) -> Tuple[List[str], List[str]]:
    """Divide the wanted execution providers into usable and missing ones.

    Parameters
    ----------
    wanted : sequence of str
        Keys of PROVIDERS, best first.
    available : sequence of str
        onnxruntime's names of what this machine has.

    Returns
    -------
    usable : list of str
        onnxruntime's names; the CPU is last, unless `wanted` has it earlier.
    missing : list of str
        Keys of PROVIDERS.

    Raises
    ------
    ModelError
        For a name that is not a key of PROVIDERS.
    """
    usable: List[str] = []
    missing: List[str] = []
    for name in wanted:
        if name not in PROVIDERS:
            raise ModelError("unknown execution provider {!r}; known: {}".format(name, ", ".join(PROVIDERS)))
        if PROVIDERS[name] not in available:
            missing.append(name)
        elif PROVIDERS[name] not in usable:
            usable.append(PROVIDERS[name])
    if PROVIDERS["cpu"] not in usable:
        usable.append(PROVIDERS["cpu"])
    return usable, missing


class OnnxModel:
    """One loaded ONNX model. `run` is safe from several threads.

    Parameters
    ----------
    path : str or pathlib.Path
        File of the model.
    providers : sequence of str
        Keys of PROVIDERS, best first. Those that are not available are reported through `notify` and skipped; the CPU
        is always tried last.
    threads : int
        Threads of the session; they do not spin while they wait.
    inputs, outputs : sequence of str
        Names that the model must have; `run` returns `outputs` only, or all outputs when none are named.
    notify : callable, optional
        Called with a text.

    Raises
    ------
    ModelError
        If the model cannot be used; the text names the file and what to do.
    """

    def __init__(
        self,
        path: Union[str, Path],
        providers: Sequence[str] = ("cpu",),
        threads: int = 1,
        inputs: Sequence[str] = (),
        outputs: Sequence[str] = (),
        notify: Optional[Callable[[str], None]] = None,
    ) -> None:
        if threads < 1:
            raise ModelError("threads of a model session is {}, legal range 1 and more".format(threads))
        self._path = Path(path)
        self._notify = notify or (lambda text: None)
        self._session = self._load(providers, threads)
        self.name = self._path.stem
        names = {full: short for short, full in PROVIDERS.items()}
        self.provider = names.get(self._session.get_providers()[0], self._session.get_providers()[0])
        self.input_names = [tensor.name for tensor in self._session.get_inputs()]
        self.input_shapes = {tensor.name: list(tensor.shape) for tensor in self._session.get_inputs()}
        self.output_names = [tensor.name for tensor in self._session.get_outputs()]
        self._require("input", inputs, self.input_names)
        self._require("output", outputs, self.output_names)
        self._wanted = list(outputs) or self.output_names

    def run(self, feed: Dict[str, np.ndarray], outputs: Optional[Sequence[str]] = None) -> Dict[str, np.ndarray]:
        """Run the model.

        Parameters
        ----------
        feed : dict of str to numpy.ndarray
            Arrays by the names of inputs.
        outputs : sequence of str, optional
            Names of the wanted outputs, instead of those named at the begin.

        Returns
        -------
        dict of str to numpy.ndarray
            Arrays by the names of outputs.

        Raises
        ------
        ModelError
            When onnxruntime refuses a name, a shape or a type.
        """
        wanted = self._wanted if outputs is None else list(outputs)
        try:
            values = self._session.run(wanted, feed)
        except Exception as error:  # onnxruntime's errors have no common base class but Exception
            shapes = {name: getattr(value, "shape", None) for name, value in feed.items()}
            raise ModelError("model {} refused input {}: {}".format(
                self._path, shapes, first_line(error))) from error
        return dict(zip(wanted, values))

    def _load(self, providers: Sequence[str], threads: int) -> onnxruntime.InferenceSession:
        if not self._path.is_file():
            raise ModelError("model file {} does not exist; {}".format(self._path, FETCH_HINT))
        usable, missing = choose_providers(providers, onnxruntime.get_available_providers())
        if missing:
            self._notify("execution provider {} is not available here (onnxruntime offers {}); {} runs on {}".format(
                ", ".join(missing), ", ".join(_short_names()), self._path.name, usable[0]))
        try:
            return self._session_on(usable, threads)
        except Exception as error:
            if usable[0] == PROVIDERS["cpu"]:
                raise self._damaged(error) from error
            self._notify("{} does not start on {} ({}); it runs on the CPU".format(
                self._path.name, usable[0], first_line(error)))
        try:
            return self._session_on([PROVIDERS["cpu"]], threads)
        except Exception as error:
            raise self._damaged(error) from error

    def _session_on(self, providers: List[str], threads: int) -> onnxruntime.InferenceSession:
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        options.inter_op_num_threads = 1
        # Waiting threads that spin take a core from the other nodes of the robot.
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        options.add_session_config_entry("session.inter_op.allow_spinning", "0")
        options.log_severity_level = _FATAL_ONLY
        return onnxruntime.InferenceSession(str(self._path), options, providers=providers)

    def _damaged(self, error: Exception) -> ModelError:
        return ModelError("model file {} cannot be loaded ({}); it may be damaged: delete it and {}".format(
            self._path, first_line(error), FETCH_HINT))

    def _require(self, kind: str, wanted: Sequence[str], present: Sequence[str]) -> None:
        absent = [name for name in wanted if name not in present]
        if absent:
            raise ModelError("model file {} has no {} {} (it has {}); it is another model: {}".format(
                self._path, kind, ", ".join(absent), ", ".join(present), FETCH_HINT))


def models_directory() -> Path:
    """Return $ROS4HRI_MODELS, by default ~/.cache/ros4hri/models. It need not exist."""
    configured = os.environ.get(MODELS_VARIABLE, "")
    if configured:
        return Path(configured).expanduser()
    return Path.home() / ".cache" / "ros4hri" / "models"


def model_path(configured: str, default_name: str) -> Path:
    """Return the file of a model: `configured` if it is not empty, else `default_name` in the directory of the models.

    Raises
    ------
    ModelError
        If there is no such file; the text names the file and what to do.
    """
    if configured:
        path = Path(configured).expanduser()
        hint = "correct the parameter that names it, or leave it empty for the default ({})".format(
            models_directory() / default_name)
    else:
        path = models_directory() / default_name
        hint = "{}, or set ${} to the directory that holds it".format(FETCH_HINT, MODELS_VARIABLE)
    if not path.is_file():
        raise ModelError("model file {} does not exist; {}".format(path, hint))
    return path


def first_line(error: BaseException) -> str:
    """Return the first line of an error's text, at most 200 characters."""
    lines = str(error).strip().splitlines()
    return lines[0][:200] if lines else type(error).__name__


def _short_names() -> List[str]:
    available = onnxruntime.get_available_providers()
    return [short for short, full in PROVIDERS.items() if full in available]
