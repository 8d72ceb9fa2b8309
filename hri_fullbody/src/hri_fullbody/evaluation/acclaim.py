"""Reader of Acclaim ASF/AMC motion capture, the format of the CMU Graphics Lab Motion Capture Database.

Jeff Lander, "Working with Motion Capture File Formats", Game Developer, January 1998. The world is
right-handed with y up; in the rest pose the actor looks along z and his left is x.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Dict, List, Mapping, Optional, Tuple

import numpy as np
from scipy.spatial.transform import Rotation

# The unit of the database is 1/0.45 inch: 0.0254 m / 0.45.
METRES = 0.0254 / 0.45


@dataclass(frozen=True)
class Bone:
    """One bone: parent's name, vector (3,) m from its start to its end in the rest pose, turn of its own axes
    (3, 3) against the world in the rest pose, and its rotation channels ("rx", ...) in the order of the file."""

    parent: str
    vector: np.ndarray
    axes: np.ndarray
    channels: Tuple[str, ...]


@dataclass(frozen=True)
class BonePoses:
    """Bones over time in the world: starts and ends (T, 3) m and rotations from rest (T, 3, 3), by name."""

    starts: Dict[str, np.ndarray]
    ends: Dict[str, np.ndarray]
    rotations: Dict[str, np.ndarray]


def read_skeleton(path: Path) -> Dict[str, Bone]:
    """Read an ASF file; parents come before their children. Raises ValueError naming the file for bad content."""
    section, current = "", {}  # type: str, Dict[str, List[str]]
    described: Dict[str, Dict[str, List[str]]] = {}
    parents: Dict[str, str] = {}
    for line in path.read_text(encoding="ascii", errors="replace").splitlines():
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        if words[0].startswith(":"):
            section = words[0]
        elif section == ":bonedata":
            if words[0] == "begin":
                current = {}
            elif words[0] == "end":
                described[current.get("name", ["?"])[0]] = current
            else:
                current[words[0]] = words[1:]
        elif section == ":hierarchy" and words[0] not in ("begin", "end"):
            parents.update({child: words[0] for child in words[1:]})
    try:
        return {name: _bone(described[name], parent) for name, parent in parents.items()}
    except (KeyError, ValueError, IndexError) as error:
        raise ValueError("{} is no complete ASF skeleton: {!r}".format(path, error)) from error


def _bone(values: Mapping[str, List[str]], parent: str) -> Bone:
    direction = np.array(values["direction"][:3], dtype=np.float64)
    axes = Rotation.from_euler("xyz", np.array(values["axis"][:3], dtype=np.float64), degrees=True)
    return Bone(parent, direction * float(values["length"][0]) * METRES, axes.as_matrix(),
                tuple(values.get("dof", ())))


def read_motion(path: Path, step: int = 1) -> Dict[str, np.ndarray]:
    """Read every `step`-th frame of an AMC file: the channels (T, n) of each bone, degrees, as in the file.

    Raises ValueError naming the file when there is no frame or a number is broken.
    """
    frames: List[Dict[str, List[str]]] = []
    number, current = -1, None  # type: int, Optional[Dict[str, List[str]]]
    with open(str(path), encoding="ascii", errors="replace") as lines:
        for line in lines:
            words = line.split()
            if not words or words[0][0] in "#:":
                continue
            if len(words) == 1 and words[0].isdigit():
                number += 1
                current = {} if number % step == 0 else None
                if current is not None:
                    frames.append(current)
            elif current is not None:
                current[words[0]] = words[1:]
    try:
        return {bone: np.array([frame[bone] for frame in frames], dtype=np.float64) for bone in frames[0]}
    except (IndexError, KeyError, ValueError) as error:
        raise ValueError("{} is no complete AMC motion: {!r}".format(path, error)) from error


def pose_bones(skeleton: Mapping[str, Bone], motion: Mapping[str, np.ndarray],
               scale: Optional[Mapping[str, float]] = None) -> BonePoses:
    """Put the skeleton into every frame of the motion. scale: factors of the lengths of bones by name."""
    root = motion["root"]
    rotations = {"root": Rotation.from_euler("xyz", root[:, 3:6], degrees=True).as_matrix()}
    ends, starts = {"root": root[:, :3] * METRES}, {}  # type: Dict[str, np.ndarray], Dict[str, np.ndarray]
    for name, bone in skeleton.items():
        rotation = rotations[bone.parent]
        if bone.channels:
            turn = Rotation.from_euler("".join(channel[-1] for channel in bone.channels), motion[name],
                                       degrees=True).as_matrix()
            rotation = rotation @ (bone.axes @ turn @ bone.axes.T)
        rotations[name] = rotation
        starts[name] = ends[bone.parent]
        ends[name] = starts[name] + rotation @ (bone.vector * (scale or {}).get(name, 1.0))
    return BonePoses(starts, ends, rotations)
