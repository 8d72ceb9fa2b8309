"""Recorded human motion as the 18 key points of hri_msgs/Skeleton2D, of the real actor or of a virtual person.

Data: CMU Graphics Lab Motion Capture Database (mocap.cs.cmu.edu, funding NSF EIA-0196217), free to use.
It has no markers of the face: nose, eyes and ears are a template on the moving head.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Dict, List, Mapping, Optional

import numpy as np

from hri_fullbody.core import skeleton as kp
from hri_fullbody.evaluation.acclaim import Bone, BonePoses, pose_bones, read_motion, read_skeleton
from hri_fullbody.evaluation.virtual_people import Person
from hri_pipeline.evaluation.data_directory import ABSENT, data_directory

RECORDED_HZ = 120.0
# Face at a stature of 1.70 m in the head frame (x out of the face, y left, z up) at the skull base, m.
FACE: Dict[int, tuple] = {
    kp.NOSE: (0.130, 0.0, -0.002), kp.LEFT_EYE: (0.103, 0.0315, 0.043), kp.RIGHT_EYE: (0.103, -0.0315, 0.043),
    kp.LEFT_EAR: (0.012, 0.0725, 0.025), kp.RIGHT_EAR: (0.012, -0.0725, 0.025)}
_FACE_STATURE = 1.70
# Trunk, thigh and shank are 0.759 of the stature on average.
_CHAIN_RATIO = 0.278 + 0.240 + 0.241
# Columns: the head frame's axes in the world of the rest pose, whose actor looks along z with y up.
_HEAD_AT_REST = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
_ANKLE_ABOVE_FLOOR = 0.07
_FOLLOW_S = 2.0


@dataclass(frozen=True)
class Motion:
    """One recording.

    points: (T, 18, 3) m, in the world (y up, right-handed) or in a camera's optical frame; none is missing.
    head_rotation: (T, 3, 3), head frame (x out of the face, y left, z up) to the same frame as the points.
    up: (3,) unit vector against gravity in that frame. rate: Hz. stature: m, of actors estimated.
    person: the virtual person, None for the actor as recorded.
    """

    name: str
    points: np.ndarray
    head_rotation: np.ndarray
    up: np.ndarray
    rate: float
    stature: float
    person: Optional[Person] = None

    def cut(self, first: int, last: int) -> Motion:
        """Return the frames first to last - 1."""
        return replace(self, points=self.points[first:last], head_rotation=self.head_rotation[first:last])

    @property
    def stamps(self) -> np.ndarray:
        """Time of each frame (T,), s, from 0."""
        return np.arange(len(self.points)) / self.rate


def trial_names(directory: Optional[Path] = None) -> List[str]:
    """Return the names of all recordings, as 02_01, sorted. directory: see load_motion."""
    return sorted(path.stem for path in _cmu(directory).glob("*/*.amc"))


def load_motion(name: str, person: Optional[Person] = None, rate: float = 30.0,
                directory: Optional[Path] = None) -> Motion:
    """Load the recording SUBJECT_TRIAL of the CMU database, in the world.

    person: give the actor this person's dimensions. rate: Hz, a divisor of 120. directory: of the test data,
    None: data_directory(). Raises FileNotFoundError, ValueError naming what is wrong.
    """
    step = int(round(RECORDED_HZ / rate))
    if step < 1 or abs(RECORDED_HZ / step - rate) > 1e-6:
        raise ValueError("the rate {} Hz is no whole part of {:g} Hz".format(rate, RECORDED_HZ))
    folder = _cmu(directory) / name.split("_")[0]
    skeleton = read_skeleton(folder / (folder.name + ".asf"))
    motion = read_motion(folder / (name + ".amc"), step)
    scale = None if person is None else _scale(skeleton, motion, person)
    bones = pose_bones(skeleton, motion, scale)
    points = _limbs(bones)
    head_rotation = bones.rotations["head"] @ _HEAD_AT_REST
    stature = person.stature if person is not None else _chain(points) / _CHAIN_RATIO
    base = bones.ends["upperneck"]
    if person is not None:
        base = points[:, kp.NECK] + person.neck * _unit(base - bones.ends["thorax"])
    for index, place in FACE.items():
        points[:, index] = base + head_rotation @ (np.array(place) * stature / _FACE_STATURE)
    return Motion(name, points, head_rotation, np.array([0.0, 1.0, 0.0]), rate, stature, person)


def before_camera(motion: Motion, seed: int, heading: Optional[float] = None, distance: Optional[float] = None,
                  height: float = 1.2) -> Motion:
    """Put a motion of the world before a camera that follows the person; result in its optical frame.

    heading: rad, the camera's direction seen from the person, on average: 0 is before his face, pi/2 at his
    left; None: random, up to 75 degrees. distance: m, None: random, 1.8 to 4 m. height: m above the floor.
    """
    random = np.random.default_rng(seed)
    drawn = random.uniform(1.8, 4.0), random.uniform(-75.0, 75.0)
    distance = drawn[0] if distance is None else distance
    heading = np.radians(drawn[1]) if heading is None else heading
    hips = (motion.points[:, kp.LEFT_HIP] + motion.points[:, kp.RIGHT_HIP]) / 2.0
    centre = _moving_mean(hips, int(_FOLLOW_S * motion.rate) | 1)
    ankles = motion.points[:, [kp.LEFT_ANKLE, kp.RIGHT_ANKLE], 1]
    centre[:, 1] = np.percentile(ankles, 2) - _ANKLE_ABOVE_FLOOR
    forward = motion.head_rotation[:, :, 0].mean(axis=0)
    angle = np.arctan2(forward[0], forward[2]) + heading
    camera = np.array([np.sin(angle) * distance, height, np.cos(angle) * distance])
    z = _unit(np.array([0.0, 0.95, 0.0]) - camera)
    x = _unit(np.cross(z, motion.up))
    turn = np.stack([x, np.cross(z, x), z])
    return replace(motion, points=(motion.points - centre[:, None] - camera) @ turn.T,
                   head_rotation=turn @ motion.head_rotation, up=turn @ motion.up)


def _cmu(directory: Optional[Path]) -> Path:
    directory = data_directory() if directory is None else directory
    if directory is None:
        raise FileNotFoundError(ABSENT)
    found = Path(directory) / "mocap" / "cmu"
    if not found.is_dir():
        raise FileNotFoundError("{} holds no motion capture: there is no {}".format(directory, found))
    return found


def _limbs(bones: BonePoses) -> np.ndarray:
    """Key points (T, 18, 3) of the body, zeros for the face. The format splits the forearm: the wrist is the
    end of the bones lwrist and rwrist."""
    points = np.zeros((len(bones.ends["root"]), 18, 3))
    for side, shoulder, hip in (("l", kp.LEFT_SHOULDER, kp.LEFT_HIP), ("r", kp.RIGHT_SHOULDER, kp.RIGHT_HIP)):
        points[:, shoulder] = bones.starts[side + "humerus"]
        points[:, shoulder + 1] = bones.ends[side + "humerus"]
        points[:, shoulder + 2] = bones.ends[side + "wrist"]
        points[:, hip] = bones.starts[side + "femur"]
        points[:, hip + 1] = bones.ends[side + "femur"]
        points[:, hip + 2] = bones.ends[side + "tibia"]
    points[:, kp.NECK] = (points[:, kp.LEFT_SHOULDER] + points[:, kp.RIGHT_SHOULDER]) / 2.0
    return points


def _scale(skeleton: Mapping[str, Bone], motion: Mapping[str, np.ndarray], person: Person) -> Dict[str, float]:
    """Factors of the bones that give the actor the person's dimensions. Widths and trunk, which bend, are
    compared in the first frame."""
    def length(name: str) -> float:
        return float(np.linalg.norm(skeleton[name].vector))

    ends = pose_bones(skeleton, {bone: values[:1] for bone, values in motion.items()}).ends
    shoulders, hips = ends["lclavicle"] - ends["rclavicle"], ends["lhipjoint"] - ends["rhipjoint"]
    trunk = (ends["lclavicle"] + ends["rclavicle"] - ends["lhipjoint"] - ends["rhipjoint"]) / 2.0
    scale = {name: person.trunk / float(np.linalg.norm(trunk))
             for name in ("lowerback", "upperback", "thorax", "lowerneck", "upperneck")}
    for side in "lr":
        forearm = person.forearm / (length(side + "radius") + length(side + "wrist"))
        scale.update({
            side + "humerus": person.upper_arm / length(side + "humerus"),
            side + "radius": forearm, side + "wrist": forearm,
            side + "femur": person.thigh / length(side + "femur"),
            side + "tibia": person.shank / length(side + "tibia"),
            side + "clavicle": person.half_shoulders / float(np.linalg.norm(shoulders) / 2.0),
            side + "hipjoint": person.half_hips / float(np.linalg.norm(hips) / 2.0)})
    return scale


def _chain(points: np.ndarray) -> float:
    """Median length of trunk, thigh and shank together, m."""
    def distance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.linalg.norm(a - b, axis=-1)

    hips = (points[:, kp.LEFT_HIP] + points[:, kp.RIGHT_HIP]) / 2.0
    legs = sum(distance(points[:, hip], points[:, hip + 1]) + distance(points[:, hip + 1], points[:, hip + 2])
               for hip in (kp.LEFT_HIP, kp.RIGHT_HIP)) / 2.0
    return float(np.median(distance(points[:, kp.NECK], hips) + legs))


def _moving_mean(values: np.ndarray, window: int) -> np.ndarray:
    """Mean of (T, 3) over an odd number of frames, ends continued; the mean of all when there are fewer."""
    if len(values) <= window:
        return np.tile(values.mean(axis=0), (len(values), 1))
    padded = np.pad(values, ((window // 2, window // 2), (0, 0)), mode="edge")
    kernel = np.ones(window) / window
    return np.stack([np.convolve(padded[:, axis], kernel, "valid") for axis in range(3)], axis=-1)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
