"""Probability of speech, 32 ms at a time, with the network silero-vad.

The network (silero-vad 6.2, MIT) takes 512 samples at 16 kHz behind the last 64 of the frame before, and a recurrent
state of its own. It takes several sources as one batch; rows do not influence each other.
"""

from __future__ import annotations

from pathlib import Path
from typing import Callable, Optional, Sequence, Union

import numpy as np

from hri_pipeline.core.onnx_model import OnnxModel

RATE = 16000
"""Samples per second that the network was trained for."""

FRAME = 512
"""Samples of a frame."""

FRAME_TIME = FRAME / RATE
"""Length of a frame in seconds, 0.032."""

_CONTEXT = 64
_STATE = (2, 128)


class ActivityState:
    """What the network remembers of one source: its recurrent state and the last samples."""

    def __init__(self) -> None:
        self.recurrent = np.zeros(_STATE, np.float32)
        self.context = np.zeros(_CONTEXT, np.float32)

    def reset(self) -> None:
        """Forget the sound so far."""
        self.recurrent = np.zeros(_STATE, np.float32)
        self.context = np.zeros(_CONTEXT, np.float32)


class ActivityModel:
    """The network, loaded once per process; each source brings its ActivityState.

    path: silero_vad.onnx; threads: of the session, they do not spin; providers, notify: see OnnxModel.
    Raises ModelError that names the file and the mend when it is missing, damaged, or another model.
    """

    def __init__(self, path: Union[str, Path], threads: int = 1, providers: Sequence[str] = ("cpu",),
                 notify: Optional[Callable[[str], None]] = None) -> None:
        self._model = OnnxModel(path, providers, threads, ("input", "state", "sr"), ("output", "stateN"), notify)
        self._rate = np.array(RATE, np.int64)
        # A network of another release would fail with the first sound: it fails at the start instead.
        self.probabilities(np.zeros((1, FRAME), np.float32), [ActivityState()])

    def probabilities(self, frames: np.ndarray, states: Sequence[ActivityState]) -> np.ndarray:
        """Return the probability of speech in each frame, (S,), and move the states on.

        frames: (S, 512) samples at 16 kHz, -1..1, one row per source; states: S states, in the same order.
        A sample that is not a number counts as silence. Raises ValueError for other shapes.
        """
        frames = np.asarray(frames, np.float32)
        if frames.ndim != 2 or frames.shape != (len(states), FRAME):
            raise ValueError("frames have the shape {}, wanted are {} frames of {} samples".format(
                frames.shape, len(states), FRAME))
        if not len(states):
            return np.zeros(0)
        # The state is recurrent: one NaN would make this source deaf for good.
        if not np.isfinite(frames).all():
            frames = np.nan_to_num(frames, nan=0.0, posinf=1.0, neginf=-1.0)
        context = np.stack([state.context for state in states])
        recurrent = np.stack([state.recurrent for state in states], axis=1)
        found = self._model.run({"input": np.concatenate((context, frames), axis=1), "state": recurrent,
                                 "sr": self._rate})
        for row, state in enumerate(states):
            state.recurrent = found["stateN"][:, row].copy()
            state.context = frames[row, -_CONTEXT:].copy()
        return found["output"][:, 0].astype(np.float64)
