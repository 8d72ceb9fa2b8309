"""Blendshapes of a face: how strongly each of 52 movements is made, by MediaPipe's network on points of the mesh.

The network (Grishchenko et al., "Blendshapes GHUM: Real-time monocular facial blendshape prediction", 2023) sees 146 of
the mesh's points in the image, removes place and size itself, and gives coefficients of 0 (not at all) to 1 by the
names of ARKit. They are those of the subject's sides. They know eyelids better than a ratio of lengths does, as they
were learnt from many people.
"""

from __future__ import annotations

from pathlib import Path
from typing import Callable, Optional, Sequence, Tuple, Union

import numpy as np

from hri_pipeline.core.onnx import FETCH_HINT, ModelError, OnnxModel

COUNT = 52
POINTS = np.array([
    0, 1, 4, 5, 6, 7, 8, 10, 13, 14, 17, 21, 33, 37, 39, 40, 46, 52, 53, 54, 55, 58, 61, 63, 65, 66, 67, 70, 78, 80, 81,
    82, 84, 87, 88, 91, 93, 95, 103, 105, 107, 109, 127, 132, 133, 136, 144, 145, 146, 148, 149, 150, 152, 153, 154,
    155, 157, 158, 159, 160, 161, 162, 163, 168, 172, 173, 176, 178, 181, 185, 191, 195, 197, 234, 246, 249, 251, 263,
    267, 269, 270, 276, 282, 283, 284, 285, 288, 291, 293, 295, 296, 297, 300, 308, 310, 311, 312, 314, 317, 318, 321,
    323, 324, 332, 334, 336, 338, 356, 361, 362, 365, 373, 374, 375, 377, 378, 379, 380, 381, 382, 384, 385, 386, 387,
    388, 389, 390, 397, 398, 400, 402, 405, 409, 415, 454, 466, 468, 469, 470, 471, 472, 473, 474, 475, 476, 477])
"""(146,) vertices of the mesh that the network reads, in its order: the interface of the model."""
Sides = Tuple[int, int]
"""Index of a movement on the subject's right, and on the left."""
EYE_BLINK: Sides = (10, 9)
LOOK_DOWN: Sides = (12, 11)
LOOK_IN: Sides = (14, 13)
LOOK_OUT: Sides = (16, 15)
LOOK_UP: Sides = (18, 17)
_INPUT, _OUTPUT = "serving_default_input_points:0", "StatefulPartitionedCall:0"


class Blendshapes:
    """Runs the network on the meshes of several faces at once; holds no state between calls."""

    def __init__(self, path: Union[str, Path], providers: Sequence[str] = ("cpu",),
                 notify: Optional[Callable[[str], None]] = None) -> None:
        """path: face_blendshapes.onnx. Raises ModelError naming the file when it is missing or another model."""
        self._model = OnnxModel(path, providers, inputs=(_INPUT,), outputs=(_OUTPUT,), notify=notify)
        trial = self._model.run({_INPUT: np.ones((1, len(POINTS), 2), np.float32)})[_OUTPUT]
        if trial.shape != (1, COUNT):
            raise ModelError("model file {} gives {} instead of {} blendshapes; it is another model: {}".format(
                path, trial.shape, COUNT, FETCH_HINT))

    def run(self, meshes: Sequence[np.ndarray]) -> np.ndarray:
        """Return the coefficients (F, 52), 0 to 1.

        meshes: (478, 2 or more) px each. Raises ModelError when the network fails.
        """
        if not len(meshes):
            return np.zeros((0, COUNT))
        points = np.stack([np.asarray(mesh)[POINTS, :2] for mesh in meshes]).astype(np.float32)
        return self._model.run({_INPUT: points})[_OUTPUT].astype(np.float64)
