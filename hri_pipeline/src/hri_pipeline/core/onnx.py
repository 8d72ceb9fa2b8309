"""ONNX models: where their files are, and how they run on onnxruntime."""

from __future__ import annotations

import ctypes
import os
import threading
import time
from contextlib import contextmanager
from pathlib import Path
from typing import Callable, Dict, Iterator, List, Optional, Sequence, Set, Tuple, TypeVar, Union

import numpy as np
import onnxruntime

from hri_pipeline.core.process import ONE_THREAD, Threads

FETCH_HINT = "get it with `rosrun hri_pipeline fetch_models`"
MODELS_VARIABLE = "ROS4HRI_MODELS"

PROVIDERS: Dict[str, str] = {
    "cpu": "CPUExecutionProvider",
    "cuda": "CUDAExecutionProvider",
    "tensorrt": "TensorrtExecutionProvider",
    "openvino": "OpenVINOExecutionProvider",
}

PROVIDER_OPTIONS: Dict[str, Dict[str, str]] = {
    # The default search of cuDNN, EXHAUSTIVE, stops the node for seconds whenever a session sees another batch. TF32
    # moves landmarks by as much as a tenth of a pixel of the network's input.
    "CUDAExecutionProvider": {"cudnn_conv_algo_search": "HEURISTIC", "use_tf32": "0",
                              "arena_extend_strategy": "kSameAsRequested"},
}
"""Options of onnxruntime's execution providers, by its names of them."""
BATCH_SIZES = (4, 12)
"""Batches that a GPU is given: smaller ones are filled up, as it prepares itself for each size, which takes seconds for
one of 1. On an H100 a batch of 12 takes 1.2 (mesh) to 2.4 times (pose) as long as one of 1."""
_MOST_SHAPES = 6
_TRIALS = 3
LIBRARIES: Dict[str, Tuple[Tuple[str, Tuple[str, ...]], ...]] = {
    "cuda": (("the NVIDIA driver", ("libcuda.so.1",)), ("libcudart", ("libcudart.so.12", "libcudart.so.13")),
             ("libcublas", ("libcublas.so.12", "libcublas.so.13")), ("libcurand", ("libcurand.so.10",)),
             ("cuDNN", ("libcudnn.so.9", "libcudnn.so.8"))),
    "tensorrt": (("the NVIDIA driver", ("libcuda.so.1",)), ("TensorRT", ("libnvinfer.so.10", "libnvinfer.so.8"))),
    "openvino": (("OpenVINO", ("libopenvino.so",)),),
}
"""What a provider loads: its name, and the files of which one is enough."""
WHEELS = {"cuda": "onnxruntime-gpu", "tensorrt": "onnxruntime-gpu", "openvino": "onnxruntime-openvino"}

Item = TypeVar("Item")
Result = TypeVar("Result")
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


def missing_libraries(provider: str, load: Callable[[str], object] = ctypes.CDLL) -> List[str]:
    """Return what a provider needs and the system's loader does not find, in words; provider: a key of PROVIDERS."""
    def is_there(files: Sequence[str]) -> bool:
        for name in files:
            try:
                load(name)
                return True
            except OSError:
                continue
        return False

    return ["{} ({})".format(what, files[0]) for what, files in LIBRARIES.get(provider, ()) if not is_there(files)]


class ModelLog:
    """What the models of a node say, each line once, and on which provider each runs. Give it as `notify`."""

    def __init__(self, notify: Callable[[str], None]) -> None:
        self._notify = notify
        self._told: Set[str] = set()
        self._lock = threading.Lock()
        self.providers: Dict[str, str] = {}
        """Keys of PROVIDERS by the names of the models."""
        self.inferences: Dict[str, int] = {}
        """How many items (crops, images) each model has worked on."""

    def __call__(self, text: str) -> None:
        """Tell a line, unless it was told before."""
        with self._lock:
            is_new = text not in self._told
            self._told.add(text)
        if is_new:
            self._notify(text)

    def count(self, model: str, items: int) -> None:
        """Note that a model has worked on so many items."""
        with self._lock:
            self.inferences[model] = self.inferences.get(model, 0) + items

    @property
    def summary(self) -> str:
        """The providers with their models, as `cpu: face_detection, pose`."""
        return "; ".join("{}: {}".format(provider, ", ".join(sorted(
            name for name, used in self.providers.items() if used == provider)))
            for provider in sorted(set(self.providers.values())))

    @property
    def values(self) -> Dict[str, object]:
        """What diagnostics tell: `networks`, and `inferences_MODEL` of each."""
        return dict({"networks": self.summary}, **{"inferences_" + name: count
                                                   for name, count in sorted(self.inferences.items())})


class OnnxModel:
    """One loaded ONNX model. `run` is safe from several threads.

    On a GPU batches are filled up to one of a few sizes, with a session for each that is warmed up when the model
    loads: cuDNN prepares itself anew whenever a session sees another shape, which takes up to seconds.

    Where the GPU fails, when the model loads or later (no memory left, another process, a suspend), the model says so
    and runs on the CPU from then on; `provider`, `on_card` and `threads` change.

    Parameters
    ----------
    path : str or pathlib.Path
        File of the model.
    providers : sequence of str
        Keys of PROVIDERS, best first. Those that are not available are reported through `notify` and skipped; the CPU
        is always tried last.
    inputs, outputs : sequence of str
        Names that the model must have; `run` returns `outputs` only, or all outputs when none are named.
    notify : callable, optional
        Called with a text; a ModelLog notes the provider as well.
    threads : Threads, optional
        Those that its user shares batches among; `threads` is one thread on a GPU, whose batches are not divided.
    batch_sizes : sequence of int
        Batches on a GPU, in rising order, where only the number of items is free.
    shapes : sequence of tuple of int
        Of the only input, where its other lengths are free, too: a GPU prepares itself for them when the model loads,
        for others when they come.
    most_on_cpu : int
        Items that the CPU works on at once, where more gain nothing; 0: all of a batch. (onnxruntime keeps the memory
        that the largest batch took.)
    few_on_cpu : bool
        Small batches run on the CPU where there is a GPU, as long as its one thread is as fast: measured when the
        model loads.

    Raises
    ------
    ModelError
        If the model cannot be used; the text names the file and what to do.
    """

    def __init__(
        self,
        path: Union[str, Path],
        providers: Sequence[str] = ("cpu",),
        inputs: Sequence[str] = (),
        outputs: Sequence[str] = (),
        notify: Optional[Callable[[str], None]] = None,
        threads: Threads = ONE_THREAD,
        batch_sizes: Sequence[int] = BATCH_SIZES,
        shapes: Sequence[Tuple[int, ...]] = (),
        few_on_cpu: bool = False,
        most_on_cpu: int = 0,
    ) -> None:
        self._path = Path(path)
        self._most_on_cpu = most_on_cpu
        self.name = self._path.stem
        self._all_threads, self._sizes = threads, tuple(batch_sizes)
        self._notify = notify or (lambda text: None)
        self._log = notify if isinstance(notify, ModelLog) else None
        self._use(self._load(providers))
        self.input_names = [tensor.name for tensor in self._session.get_inputs()]
        self.input_shapes = {tensor.name: list(tensor.shape) for tensor in self._session.get_inputs()}
        self.output_names = [tensor.name for tensor in self._session.get_outputs()]
        self._require("input", inputs, self.input_names)
        self._require("output", outputs, self.output_names)
        self._wanted = list(outputs) or self.output_names
        self._batched: Dict[int, onnxruntime.InferenceSession] = {}
        self._shaped: Dict[Tuple[int, ...], onnxruntime.InferenceSession] = {}
        self._beside: Optional[onnxruntime.InferenceSession] = None
        self._few = 0
        self._kept: List[np.ndarray] = []
        self._lost: List[object] = []
        self._preparing = threading.Lock()
        if self.on_card:
            self._prepare(shapes, few_on_cpu)

    @property
    def on_card(self) -> bool:
        """Whether it runs on a GPU."""
        return self.provider in ("cuda", "tensorrt")

    def together_on_card(self, count: int) -> int:
        """How many of so many items a GPU takes in one batch; 0: they run on the CPU, as a few may be faster there."""
        return min(count, self._sizes[-1]) if self.on_card and count > self._few else 0

    def run_items(self, items: Sequence[Item], prepare: Callable[[Item, np.ndarray], Result],
                  shape: Sequence[int]) -> Tuple[List[Result], Dict[str, np.ndarray]]:
        """Prepare items and run the model on them, shared by its threads; on a GPU they only prepare.

        Parameters
        ----------
        items : sequence
            At least one.
        prepare : callable
            Writes an item into its place of the batch, the only input; several threads call it.
        shape : sequence of int
            Of such a place.

        Returns
        -------
        prepared : list
            What `prepare` returns.
        outputs : dict of str to numpy.ndarray
            As of `run`.

        Raises
        ------
        ModelError
            As `run`.
        """
        name = self.input_names[0]
        numbers = range(len(items))
        with self._places([self._filled_up(len(items)), *shape]) as batch:
            def fill(part: Sequence[int]) -> List[Result]:
                return [prepare(items[index], batch[index]) for index in part]

            def fill_and_run(part: Sequence[int]) -> List[Tuple[Result, Dict[str, np.ndarray]]]:
                prepared, found = fill(part), self.run({name: batch[part[0]:part[-1] + 1]})
                return [(one, {key: value[i:i + 1] for key, value in found.items()}) for i, one in enumerate(prepared)]

            if self.threads.count == 1:
                return self._all_threads.in_parts(fill, numbers), self.run({name: batch}, count=len(items))
            done = self.threads.in_parts(fill_and_run, numbers)
        return [one for one, _ in done], {key: np.concatenate([found[key] for _, found in done]) for key in done[0][1]}

    @contextmanager
    def _places(self, shape: Sequence[int]) -> Iterator[np.ndarray]:
        """An array of this shape, which is kept for the next batch: to fill new memory takes longer than the rest."""
        try:
            kept = self._kept.pop()
        except IndexError:      # the first one, or another thread has it
            kept = np.empty(0)
        if len(kept) < shape[0] or kept.shape[1:] != tuple(shape[1:]):
            kept = np.zeros(shape, _TYPES.get(self._session.get_inputs()[0].type, np.float32))
        try:
            yield kept[:shape[0]]
        finally:
            self._kept.append(kept)

    def _filled_up(self, count: int) -> int:
        """Length of the batch that `count` items are run in."""
        if not self._batched or count <= self._few:
            return count
        last = (count - 1) % self._sizes[-1] + 1
        return count - last + next(size for size in self._sizes if size >= last)

    def run(self, feed: Dict[str, np.ndarray], outputs: Optional[Sequence[str]] = None,
            count: Optional[int] = None) -> Dict[str, np.ndarray]:
        """Run the model.

        Parameters
        ----------
        feed : dict of str to numpy.ndarray
            Arrays by the names of inputs.
        outputs : sequence of str, optional
            Names of the wanted outputs, instead of those named at the begin.
        count : int, optional
            How many of the batch are items, the first ones; by default all.

        Returns
        -------
        dict of str to numpy.ndarray
            Arrays by the names of outputs, of the items.

        Raises
        ------
        ModelError
            When onnxruntime refuses a name, a shape or a type.
        """
        wanted = self._wanted if outputs is None else list(outputs)
        try:
            values = self._run(feed, wanted)
        except Exception as error:  # onnxruntime's errors have no common base class but Exception
            shapes = {name: getattr(value, "shape", None) for name, value in feed.items()}
            raise ModelError("model {} refused input {}: {}".format(
                self._path, shapes, first_line(error))) from error
        if self._log is not None:
            self._log.count(self.name, len(next(iter(feed.values()))) if count is None else count)
        return dict(zip(wanted, values if count is None else [value[:count] for value in values]))

    def _run(self, feed: Dict[str, np.ndarray], wanted: List[str]) -> List[np.ndarray]:
        """Run on the provider; where it fails, and the CPU does not, on the CPU from now on."""
        provider = self.provider
        try:
            if provider == "cpu":
                return self._run_on_cpu(feed, wanted)
            return self._run_batched(feed, wanted) if self._batched else self._session_of(feed).run(wanted, feed)
        except Exception as error:
            if provider == "cpu":
                raise
            values = list(self._cpu_session().run(wanted, feed))
            # To free memory of a card that has failed may end the process (onnxruntime throws where it must not).
            self._lost += [self._session, self._batched, self._shaped]
            self._give_up("{}: {} has failed ({})".format(self._path.name, provider, first_line(error)))
            return values

    def _run_on_cpu(self, feed: Dict[str, np.ndarray], wanted: List[str]) -> List[np.ndarray]:
        count, most = len(next(iter(feed.values()))), self._most_on_cpu
        if not 0 < most < count:
            return list(self._session.run(wanted, feed))
        parts = [self._session.run(wanted, {name: value[start:start + most] for name, value in feed.items()})
                 for start in range(0, count, most)]
        return [np.concatenate(values) for values in zip(*parts)]

    def _use(self, session: onnxruntime.InferenceSession) -> None:
        """Run on this session from now on."""
        self._session = session
        self.threads = self._all_threads if session.get_providers()[0] == PROVIDERS["cpu"] else ONE_THREAD
        self.provider = _short_name(session.get_providers()[0])
        if self._log is not None:
            self._log.providers[self.name] = self.provider
            self._log.count(self.name, 0)

    def _cpu_session(self) -> onnxruntime.InferenceSession:
        """A session on the CPU beside those of the provider; made when it is first needed."""
        with self._preparing:
            if self._beside is None:
                self._beside = self._session_on([PROVIDERS["cpu"]])
            return self._beside

    def _give_up(self, why: str) -> None:
        """Run on the CPU from now on, and say why, once."""
        session = self._cpu_session()
        with self._preparing:
            if self.provider == "cpu":
                return
            self._batched, self._shaped = {}, {}
            self._use(session)      # the last: who sees this provider runs on nothing else
        self._notify("{}; it runs on the CPU from now on".format(why))

    def _run_batched(self, feed: Dict[str, np.ndarray], wanted: List[str]) -> List[np.ndarray]:
        """Run batches of the prepared sizes; what was filled up is left out of the outputs."""
        count = len(next(iter(feed.values())))
        if self._beside is not None and 0 < count <= self._few:
            return list(self._beside.run(wanted, feed))
        parts = []
        for start in range(0, max(count, 1), self._sizes[-1]):
            part = {name: value[start:start + self._sizes[-1]] for name, value in feed.items()}
            length = len(next(iter(part.values())))
            size = next(size for size in self._sizes if size >= length)
            filled = {name: value if length == size else np.concatenate(
                [value, np.zeros((size - length,) + value.shape[1:], value.dtype)]) for name, value in part.items()}
            parts.append([value[:length] for value in self._batched[size].run(wanted, filled)])
        return parts[0] if len(parts) == 1 else [np.concatenate(values) for values in zip(*parts)]

    def _takes_batches(self) -> bool:
        """Whether the first axis, and only that, of each input and output is free."""
        tensors = list(self._session.get_inputs()) + list(self._session.get_outputs())
        return all(len(tensor.shape) > 0 and not isinstance(tensor.shape[0], int)
                   and all(isinstance(length, int) for length in tensor.shape[1:]) for tensor in tensors)

    def _prepare(self, shapes: Sequence[Tuple[int, ...]], few_on_cpu: bool) -> None:
        """Let the GPU prepare itself for its batches, or shapes."""
        try:
            if self._takes_batches():
                self._warm_up()
                if few_on_cpu:
                    self._compare()
            else:
                for shape in shapes:
                    self._session_for(shape)
        except Exception as error:  # too little memory, or a model of another shape
            self._give_up("{} cannot be prepared on {} ({})".format(
                self._path.name, self.provider, first_line(error)))

    def _warm_up(self) -> None:
        """Make a session for each size, the largest first, and run it once."""
        for size in reversed(self._sizes):
            self._notify("{}: {} prepares batches of {}".format(self._path.name, self.provider, size))
            session = self._session if size == self._sizes[-1] else self._session_like_it()
            self._seconds(session, size)
            self._batched[size] = session

    def _compare(self) -> None:
        """Find out how many items the CPU runs as fast."""
        beside = self._session_on([PROVIDERS["cpu"]])
        self._seconds(beside, 1)
        one = min(self._seconds(beside, 1) for _ in range(_TRIALS))
        for size in self._sizes:
            card = min(self._seconds(self._batched[size], size) for _ in range(_TRIALS))
            if self._few + 1 > int(card / one):
                break
            self._few = min(size, int(card / one))
        self._beside = beside if self._few else None

    def _seconds(self, session: onnxruntime.InferenceSession, size: int) -> float:
        """Run a batch of nothing; return the time, s."""
        feed = {tensor.name: np.zeros([size] + list(tensor.shape[1:]), _TYPES.get(tensor.type, np.float32))
                for tensor in session.get_inputs()}
        began = time.perf_counter()
        session.run(self._wanted, feed)
        return time.perf_counter() - began

    def _session_of(self, feed: Dict[str, np.ndarray]) -> onnxruntime.InferenceSession:
        """The session for what is fed: on a GPU each shape has its own."""
        return self._session_for(next(iter(feed.values())).shape) if self._shaped else self._session

    def _session_for(self, shape: Tuple[int, ...]) -> onnxruntime.InferenceSession:
        """The session for a shape of the only input, warmed up."""
        with self._preparing:
            if not self.on_card:        # given up meanwhile
                return self._session
            if shape not in self._shaped:
                self._notify("{}: {} prepares inputs of {}".format(self._path.name, self.provider, shape))
                session = self._session_like_it() if self._shaped else self._session
                session.run(self._wanted, {self.input_names[0]: np.zeros(shape, np.float32)})
                if len(self._shaped) >= _MOST_SHAPES:
                    self._shaped.pop(next(iter(self._shaped)))
            else:
                session = self._shaped.pop(shape)
            self._shaped[shape] = session       # the last of them: which has not come for longest is given up
            return session

    def _session_like_it(self) -> onnxruntime.InferenceSession:
        """Another session on the same provider. Raises RuntimeError where onnxruntime makes one on another."""
        wanted = self._session.get_providers()
        session = self._session_on(wanted)
        if session.get_providers()[0] != wanted[0]:
            raise RuntimeError("onnxruntime has made it on {} only".format(_short_name(session.get_providers()[0])))
        return session

    def _load(self, providers: Sequence[str]) -> onnxruntime.InferenceSession:
        if not self._path.is_file():
            raise ModelError("model file {} does not exist; {}".format(self._path, FETCH_HINT))
        usable, missing = choose_providers(providers, onnxruntime.get_available_providers())
        if missing:
            self._notify("execution provider {} is not in this onnxruntime, which offers {}; the networks run on {}. "
                         "Install {} instead of onnxruntime, see docs/gpu.md".format(
                             ", ".join(missing), ", ".join(_short_names()), _short_name(usable[0]),
                             " or ".join(sorted({WHEELS[name] for name in missing if name in WHEELS}))
                             or "another wheel"))
        try:
            session = self._session_on(usable)
            self._check_provider(usable[0], session.get_providers()[0])
            return session
        except Exception as error:
            if usable[0] == PROVIDERS["cpu"]:
                raise self._damaged(error) from error
            self._notify("{} does not start on {} ({}); it runs on the CPU".format(
                self._path.name, _short_name(usable[0]), first_line(error)))
        try:
            return self._session_on([PROVIDERS["cpu"]])
        except Exception as error:
            raise self._damaged(error) from error

    def _check_provider(self, wanted: str, used: str) -> None:
        """Say what is missing when onnxruntime has passed over a provider; it does so in silence."""
        if used == wanted:
            return
        name = _short_name(wanted)
        absent = missing_libraries(name)
        self._notify("execution provider {} does not load here, the networks run on {}: {}; see docs/gpu.md".format(
            name, _short_name(used), "the loader does not find " + ", ".join(absent) if absent else
            "its libraries are there, so their versions do not fit this onnxruntime ({}) or the driver, or the card "
            "has no memory left".format(onnxruntime.__version__)))

    def _session_on(self, providers: List[str]) -> onnxruntime.InferenceSession:
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = self._all_threads.within
        options.inter_op_num_threads = 1
        # Waiting threads that spin take a core from the other nodes of the robot.
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        options.add_session_config_entry("session.inter_op.allow_spinning", "0")
        options.log_severity_level = _FATAL_ONLY
        session = onnxruntime.InferenceSession(
            str(self._path), options, providers=[(name, PROVIDER_OPTIONS.get(name, {})) for name in providers])
        session.disable_fallback()      # in the middle of a run, and unknown to all but standard output
        return session

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


_TYPES = {"tensor(float)": np.float32, "tensor(float16)": np.float16, "tensor(double)": np.float64,
          "tensor(int64)": np.int64, "tensor(int32)": np.int32, "tensor(uint8)": np.uint8, "tensor(bool)": np.bool_}


def _short_name(provider: str) -> str:
    return next((short for short, full in PROVIDERS.items() if full == provider), provider)


def _short_names() -> List[str]:
    available = onnxruntime.get_available_providers()
    return [short for short, full in PROVIDERS.items() if full in available]
