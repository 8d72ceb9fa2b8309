"""Recorded human motion as the 18 key points of hri_msgs/Skeleton2D, of the real actor or of a virtual person, with
noise.

Data: CMU Graphics Lab Motion Capture Database (mocap.cs.cmu.edu, funding NSF EIA-0196217), free to use, in the Acclaim
format ASF/AMC: Jeff Lander, "Working with Motion Capture File Formats", Game Developer, January 1998. Its world is
right-handed with y up; in the rest pose the actor looks along z and his left is x. It has no markers of the face: nose,
eyes and ears are a template on the moving head. Virtual people: dimensions drawn from the Gaussian of the
anthropometric table. Noise: white, or as of a depth camera, always with a seed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Dict, List, Mapping, Optional, Tuple, Union

import numpy as np
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from benchmarks.report import ABSENT, data_directory
from hri_fullbody.core import keypoints as kp

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
class RecordedMotion:
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
    person: Optional[VirtualPerson] = None

    def cut(self, first: int, last: int) -> RecordedMotion:
        """Return the frames first to last - 1."""
        return replace(self, points=self.points[first:last], head_rotation=self.head_rotation[first:last])

    @property
    def stamps(self) -> np.ndarray:
        """Time of each frame (T,), s, from 0."""
        return np.arange(len(self.points)) / self.rate


def trial_names() -> List[str]:
    """Return the names of all recordings, as 02_01, sorted."""
    return sorted(path.stem for path in _cmu().glob("*/*.amc"))


def load_motion(name: str, person: Optional[VirtualPerson] = None, rate: float = 30.0) -> RecordedMotion:
    """Load the recording SUBJECT_TRIAL of the CMU database, in the world.

    person: give the actor this person's dimensions. rate: Hz, a divisor of 120. Raises
    FileNotFoundError, ValueError naming what is wrong.
    """
    step = int(round(RECORDED_HZ / rate))
    if step < 1 or abs(RECORDED_HZ / step - rate) > 1e-6:
        raise ValueError("the rate {} Hz is no whole part of {:g} Hz".format(rate, RECORDED_HZ))
    folder = _cmu() / name.split("_")[0]
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
    return RecordedMotion(name, points, head_rotation, np.array([0.0, 1.0, 0.0]), rate, stature, person)


def before_camera(motion: RecordedMotion, seed: int, heading: Optional[float] = None, distance: Optional[float] = None
                  ) -> RecordedMotion:
    """Put a motion of the world before a camera that follows the person; result in its optical frame.

    heading: rad, the camera's direction seen from the person, on average: 0 is before his face, pi/2 at his
    left; None: random, up to 75 degrees. distance: m, None: random, 1.8 to 4 m. The camera is 1.2 m above the floor.
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
    camera = np.array([np.sin(angle) * distance, 1.2, np.cos(angle) * distance])
    z = _unit(np.array([0.0, 0.95, 0.0]) - camera)
    x = _unit(np.cross(z, motion.up))
    turn = np.stack([x, np.cross(z, x), z])
    return replace(motion, points=(motion.points - centre[:, None] - camera) @ turn.T,
                   head_rotation=turn @ motion.head_rotation, up=turn @ motion.up)


def _cmu() -> Path:
    directory = data_directory()
    if directory is None:
        raise FileNotFoundError(ABSENT)
    found = directory / "mocap" / "cmu"
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


def _scale(skeleton: Mapping[str, Bone], motion: Mapping[str, np.ndarray], person: VirtualPerson) -> Dict[str, float]:
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


if TYPE_CHECKING:
    from hri_fullbody.core.model.anthropometry import SegmentTable


@dataclass(frozen=True)
class VirtualPerson:
    """Stature and distances between joint centres, m. trunk: middle of the hips to middle of the shoulders;
    neck: middle of the shoulders to the skull base; half_shoulders, half_hips: half the joints' distance."""

    stature: float
    upper_arm: float
    forearm: float
    thigh: float
    shank: float
    trunk: float
    half_shoulders: float
    half_hips: float
    neck: float


def virtual_people(count: int, seed: int, table: SegmentTable) -> List[VirtualPerson]:
    """Draw `count` adults, the same for the same seed.

    The logarithms of the ten lengths of `table` (stature, upper arm, forearm, thigh, shank, trunk, half
    shoulders, half hips, neck, ankle height) are normal with its mean and covariance: those between the
    people of the ANSUR II survey (Gordon et al., NATICK/TR-15/007, 2014), both sexes alike.
    """
    logarithms = np.random.default_rng(seed).multivariate_normal(table.log_mean, table.log_covariance, size=count)
    return [VirtualPerson(*(float(length) for length in row[:9])) for row in np.exp(logarithms)]


Level = Union[int, float, str]
LEVELS = (10, 20, 30, "rgbd")


def add_noise(points: np.ndarray, level: Level, seed: int) -> np.ndarray:
    """Return noisy key points (T, 18, 3) m of true ones at about 30 Hz in the optical frame, NaN where missing.

    level: the standard deviation per axis in mm of white noise, or "rgbd" (see rgbd_noise).
    Raises ValueError for another level.
    """
    if level == "rgbd":
        return rgbd_noise(points, seed)
    if isinstance(level, str) or not np.isfinite(level) or level < 0:
        raise ValueError("noise {!r} is neither \"rgbd\" nor a number of millimetres, 0 and more".format(level))
    return points + np.random.default_rng(seed).normal(size=points.shape) * (level / 1000.0)


def rgbd_noise(points: np.ndarray, seed: int) -> np.ndarray:
    """Return key points as a detector in the image with a look into the depth image gives them.

    10 mm across the ray and 18 mm (z / 2 m)^2 along it, half of the variance slow; 2 % of the points lie 0.15
    to 0.9 m too far away and 5 % are missing, both in bursts; arms behind the trunk and the far side of the
    face are missing. points: (T, 18, 3) m, optical frame, 30 Hz.
    """
    random = np.random.default_rng(seed)
    depth = np.maximum(points[:, :, 2:3], 0.5)
    sigma = np.array([0.010, 0.010, 0.0]) + np.array([0.0, 0.0, 0.018]) * (depth / 2.0) ** 2
    noisy = points + 0.7 * (random.normal(size=points.shape) + _slow(random, points.shape, 0.9)) * sigma
    wrong = _bursts(random, points.shape[:2], 0.02, 3.0)
    noisy[wrong, 2] += random.uniform(0.15, 0.9, int(wrong.sum()))
    noisy[_bursts(random, points.shape[:2], 0.05, 8.0)] = np.nan
    _hide_arms(points, noisy)
    _hide_face(points, noisy)
    return noisy


def _slow(random: np.random.Generator, shape: tuple, memory: float) -> np.ndarray:
    """Stationary first-order autoregressive noise of variance 1 along the first axis."""
    white = random.normal(size=shape)
    white[1:] *= np.sqrt(1.0 - memory * memory)
    return lfilter([1.0], [1.0, -memory], white, axis=0)


def _bursts(random: np.random.Generator, shape: tuple, share: float, mean_length: float) -> np.ndarray:
    """Mask (T, 18) that is true in runs of 2 and more frames that begin with probability share / mean_length."""
    begins = random.random(shape) < share / mean_length
    lengths = 1 + random.geometric(1.0 / mean_length, size=shape)
    mask = np.zeros(shape, dtype=bool)
    for frame, point in np.argwhere(begins):
        if not mask[frame, point]:
            mask[frame:frame + lengths[frame, point], point] = True
    return mask


def _hide_arms(points: np.ndarray, noisy: np.ndarray) -> None:
    """Take away elbows and wrists that are 8 cm behind the trunk's line and within 10 cm of it in the image."""
    hips = (points[:, kp.LEFT_HIP] + points[:, kp.RIGHT_HIP]) / 2.0
    trunk = points[:, kp.NECK] - hips
    for name in (kp.LEFT_ELBOW, kp.RIGHT_ELBOW, kp.LEFT_WRIST, kp.RIGHT_WRIST):
        point = points[:, name]
        along = np.clip(((point - hips) * trunk).sum(-1) / (trunk * trunk).sum(-1), 0.0, 1.0)
        nearest = hips + along[:, None] * trunk
        beside = np.linalg.norm((point - nearest)[:, :2], axis=-1)
        noisy[(beside < 0.10) & (point[:, 2] > nearest[:, 2] + 0.08), name] = np.nan


def _hide_face(points: np.ndarray, noisy: np.ndarray) -> None:
    """Take away nose and eyes of a face turned 100 degrees away, and the ear on the far side."""
    nose, left, right = points[:, kp.NOSE], points[:, kp.LEFT_EAR], points[:, kp.RIGHT_EAR]
    ray = _unit(nose)
    away = (_unit(nose - (left + right) / 2.0) * ray).sum(-1) > 0.17
    for name in (kp.NOSE, kp.LEFT_EYE, kp.RIGHT_EYE):
        noisy[away, name] = np.nan
    side = (_unit(left - right) * ray).sum(-1)
    noisy[side > 0.6, kp.LEFT_EAR] = np.nan
    noisy[side < -0.6, kp.RIGHT_EAR] = np.nan


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
