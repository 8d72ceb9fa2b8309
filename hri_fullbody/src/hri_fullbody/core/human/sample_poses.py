"""Named poses of the human model, to look at and to test limits with."""

from __future__ import annotations

from typing import Dict, Mapping, Tuple

import numpy as np

from hri_fullbody.core.human.human_model import PAPER, Layout

# Values in rad; a name without side holds for both.
_POSES: Dict[str, Mapping[str, float]] = {
    "standing": {"shoulder_pitch": 0.12, "elbow": 0.2},
    "sitting": {"hip_flexion": 1.5, "hip_abduction": 0.12, "knee": -1.5, "shoulder_pitch": 0.2, "elbow": 1.2,
                "shoulder_yaw": 1.2, "shoulder_roll": 1.2, "waist": 0.1},
    "arms_up": {"shoulder_pitch": 2.9, "elbow": 0.15},
    "crossed_legs": {"hip_flexion": 1.6, "knee": -1.3, "l_hip_flexion": 1.9, "l_hip_abduction": -0.45, "l_knee": -1.6,
                     "r_hip_abduction": -0.1, "shoulder_pitch": 0.3, "elbow": 1.3, "waist": 0.15},
    "waving": {"shoulder_pitch": 0.12, "elbow": 0.2, "l_shoulder_yaw": 0.3, "l_shoulder_pitch": 1.35,
               "l_shoulder_roll": 1.6, "l_elbow": 1.8, "head_yaw": 0.3},
    "walking": {"l_hip_flexion": 0.5, "l_knee": -0.25, "r_hip_flexion": -0.35, "r_knee": -0.45, "l_shoulder_yaw": -1.4,
                "r_shoulder_yaw": 1.4, "shoulder_pitch": 0.35, "l_shoulder_roll": -1.3, "r_shoulder_roll": 1.3,
                "elbow": 0.5},
}
POSE_NAMES: Tuple[str, ...] = tuple(_POSES)

_HIP_NAMES = {
    "paper": {"hip_flexion": "p_hip", "hip_abduction": "r_hip"},
    "rep155": {"hip_flexion": "r_hip", "hip_abduction": "p_hip"},
}
_NAMES = {"shoulder_yaw": "y_shoulder", "shoulder_pitch": "p_shoulder", "shoulder_roll": "r_shoulder",
          "head_yaw": "y_head"}


def sample_pose(name: str, layout: Layout = PAPER) -> np.ndarray:
    """Joint values (J,) rad of a named pose in the layout's order. Raises ValueError naming the poses."""
    if name not in _POSES:
        raise ValueError("no pose {!r}; known: {}".format(name, ", ".join(POSE_NAMES)))
    values: Dict[str, float] = {}
    # what holds for both sides first, so that a side's own value replaces it
    for key, value in sorted(_POSES[name].items(), key=lambda item: item[0][:2] in ("l_", "r_")):
        side, plain = (key[:2], key[2:]) if key[:2] in ("l_", "r_") else ("", key)
        plain = _HIP_NAMES[layout.interface].get(plain, _NAMES.get(plain, plain))
        for joint in ([side + plain] if side or plain in layout.joint_names else ["l_" + plain, "r_" + plain]):
            values[joint] = value
    return np.array([values.get(joint, 0.0) for joint in layout.joint_names])
