"""The human as a kinematic chain: 15 links, their dimensions, joints, axes and limits.

Every branch of the tree (head, left arm, right arm, left leg, right leg) is brought to the same shape: three joints
in one point, a proximal segment, a fourth joint, a distal segment. Where a joint does not exist, its slot stays at 0.
A body has 1 + 5 x 4 slots, the first being the waist; `Layout.slots` says which of them are joints, so that one
batched computation serves all bodies, limbs and layouts.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Dict, Mapping, Sequence, Tuple, Union

import numpy as np

from hri_fullbody.core.model.anthropometry import FACE_POINTS, HEAD_POINTS, SEGMENTS, SegmentTable

STATURE_RANGE = (0.4, 2.6)
"""Legal stature, m: from a new-born to the tallest human on record."""
_LENGTH_FACTORS = (0.4, 2.5)

HEAD, LEFT_ARM, RIGHT_ARM, LEFT_LEG, RIGHT_LEG = range(5)
BRANCHES = ("head", "left arm", "right arm", "left leg", "right leg")
JOINTS_PER_BRANCH = 4
SLOTS = 1 + len(BRANCHES) * JOINTS_PER_BRANCH
WAIST_SLOT = 0


def branch_slot(branch: int, level: int) -> int:
    """Number of the slot of a branch's joint, level 0 to 3."""
    return 1 + branch * JOINTS_PER_BRANCH + level


@dataclass(frozen=True, eq=False)
class Dimensions:
    """Lengths (m) of one human. Build it by `from_stature` or `from_segments`, which check.

    neck_pivot: height of the head's pivot above the shoulders' line.
    head_offset: (3,) sellion from the pivot in the head's axes (x out of the face, z to the scalp).
    face_points: (5, 3) nose, left and right eye, left and right ear in the head frame (origin: sellion).
    """

    stature: float
    upper_arm: float
    forearm: float
    thigh: float
    shank: float
    trunk: float
    half_shoulders: float
    half_hips: float
    neck: float
    ankle_height: float
    neck_pivot: float
    head_offset: np.ndarray
    face_points: np.ndarray

    @classmethod
    def from_stature(cls, stature: float, table: SegmentTable) -> "Dimensions":
        """Mean proportions of a stature (m). Raises ValueError outside `STATURE_RANGE`."""
        return cls.from_segments(stature, {}, table)

    @classmethod
    def from_segments(cls, stature: float, lengths: Mapping[str, float], table: SegmentTable) -> "Dimensions":
        """Known lengths (m) by name of `SEGMENTS`, the others by the table's ratio of the stature (m).

        Raises ValueError for an unknown name, or a value that no human of that stature has (less than 0.4 or more
        than 2.5 times the mean).
        """
        stature = _checked("stature", stature, *STATURE_RANGE)
        unknown = sorted(set(lengths) - set(SEGMENTS))
        if unknown:
            raise ValueError("no segments {}; known: {}".format(", ".join(unknown), ", ".join(SEGMENTS)))
        values = {}
        for name in SEGMENTS:
            mean = stature * table.ratio(name)
            low, high = (factor * mean for factor in _LENGTH_FACTORS)
            values[name] = _checked(name, lengths.get(name, mean), low, high)
        scale = stature / table.reference_stature
        sellion = table.head_points["sellion"] * scale
        pivot = table.pivot_share * values["neck"]
        offset = sellion + np.array([0.0, 0.0, values["neck"] - pivot])
        face = np.stack([table.head_points[name] * scale - sellion for name in FACE_POINTS])
        offset.flags.writeable = face.flags.writeable = False
        return cls(stature=stature, ankle_height=stature * table.ratio("ankle_height"), neck_pivot=pivot,
                   head_offset=offset, face_points=face, **values)


def _checked(name: str, value: float, low: float, high: float) -> float:
    """`value` as float; ValueError with the legal range otherwise."""
    value = float(value)
    if not low <= value <= high:
        raise ValueError("{} is {:.4g} m, legal: {:.3g} to {:.3g} m".format(name, value, low, high))
    return value


@dataclass(frozen=True, eq=False)
class BodyDimensions:
    """Dimensions of N bodies as arrays, m. Frames are those of the parts they hang on.

    pivots: (N, 5, 3) origin of each branch, of the head and arms from the middle of the shoulders in the torso's axes,
    of the legs from the body's origin in the body's axes. trunk: (N, 1). proximal, distal: (N, 4, 1) lengths of the
    limbs in the order of `BRANCHES`, without the head. head: (N, 6, 3) sellion and the five face points from the
    head's pivot in the head's axes.
    """

    pivots: np.ndarray
    trunk: np.ndarray
    proximal: np.ndarray
    distal: np.ndarray
    head: np.ndarray

    def __len__(self) -> int:
        return len(self.trunk)


def stack_dimensions(dimensions: Union[Sequence[Dimensions], BodyDimensions]) -> BodyDimensions:
    """Arrays of several bodies' dimensions; what is stacked already is returned as it is."""
    if isinstance(dimensions, BodyDimensions):
        return dimensions
    count = len(dimensions)
    pivots = np.zeros((count, 5, 3))
    limbs = np.zeros((count, 4, 2))
    head = np.zeros((count, len(HEAD_POINTS), 3))
    for n, body in enumerate(dimensions):
        pivots[n, HEAD, 2] = body.neck_pivot
        pivots[n, 1:, 1] = body.half_shoulders, -body.half_shoulders, body.half_hips, -body.half_hips
        limbs[n, :2] = body.upper_arm, body.forearm
        limbs[n, 2:] = body.thigh, body.shank
        head[n, 0] = body.head_offset
        head[n, 1:] = body.head_offset + body.face_points
    trunk = np.array([body.trunk for body in dimensions], dtype=np.float64).reshape(count, 1)
    return BodyDimensions(pivots, trunk, limbs[:, :, :1], limbs[:, :, 1:], head)


@dataclass(frozen=True)
class Joint:
    """A revolute joint. name and child without the body's id; side l, r or nothing is part of both.

    parent, child: links. axis: (3,) in the parent's axes. limits in rad. slot: see the module's text.
    """

    name: str
    parent: str
    child: str
    axis: Tuple[float, float, float]
    lower: float
    upper: float
    slot: int


@dataclass(frozen=True, eq=False)
class Layout:
    """A set of joints in the order of JointState. interface: its name as a parameter."""

    interface: str
    joints: Tuple[Joint, ...]
    joint_names: Tuple[str, ...] = field(init=False)
    lower: np.ndarray = field(init=False)
    upper: np.ndarray = field(init=False)
    slots: np.ndarray = field(init=False)
    slot_axes: np.ndarray = field(init=False)
    slot_lower: np.ndarray = field(init=False)
    slot_upper: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        slots = np.array([joint.slot for joint in self.joints])
        axes, lower, upper = np.zeros((SLOTS, 3)), np.zeros(SLOTS), np.zeros(SLOTS)
        axes[:] = (0.0, 0.0, 1.0)
        axes[slots] = [joint.axis for joint in self.joints]
        lower[slots] = [joint.lower for joint in self.joints]
        upper[slots] = [joint.upper for joint in self.joints]
        values = {"joint_names": tuple(joint.name for joint in self.joints), "slots": slots, "slot_axes": axes,
                  "slot_lower": lower, "slot_upper": upper, "lower": lower[slots], "upper": upper[slots]}
        for name, value in values.items():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return len(self.joints)

    def to_slots(self, q: np.ndarray) -> np.ndarray:
        """Joint values (N, J) rad to slots (N, 21)."""
        out = np.zeros((len(q), SLOTS))
        out[:, self.slots] = q
        return out

    def from_slots(self, slots: np.ndarray) -> np.ndarray:
        """Slots (N, 21) to joint values (N, J) rad."""
        return slots[:, self.slots]


_PI = 3.14159
# Wide enough for what people do: the 1st to 99th percentile of walking, sitting, climbing, dancing and fighting in
# motion capture lies within (hip flexion -0.4 to 2.4, abduction -0.6 to 0.6, knee -2.7 to 0, elbow 0 to 2.6, shoulder
# -0.1 to 2.7 and +-2.6, head +-0.5, +-1.3, +-1.0 rad), and so do arms straight up and legs crossed on a chair. A
# negative pitch lets an arm swing past the body without turning its yaw about.
_WAIST_LIMITS = (-0.6, 1.6)
_HEAD_LIMITS = {"r": (-0.8, 0.8), "y": (-1.5, 1.5), "p": (-1.3, 1.3)}
_SHOULDER_LIMITS = {"y": (-_PI, _PI), "p": (-1.0, _PI), "r": (-_PI, _PI)}
_ELBOW_LIMITS = (0.0, 2.7)
_HIP_FLEXION, _HIP_ABDUCTION, _HIP_TWIST = (-0.8, 2.4), (-1.0, 1.3), (-1.2, 1.2)
_KNEE_LIMITS = (-2.7, 0.05)


def _arm(side: str, sign: float, branch: int) -> Tuple[Joint, ...]:
    yaw, pitch, roll = (side + axis + "_shoulder" for axis in "ypr")
    upper, lower = side + "shoulder", side + "elbow"
    first = branch_slot(branch, 0)
    return (
        Joint(yaw, "torso", yaw, (0.0, 0.0, -sign), *_SHOULDER_LIMITS["y"], slot=first),
        Joint(pitch, yaw, pitch, (sign, 0.0, 0.0), *_SHOULDER_LIMITS["p"], slot=first + 1),
        Joint(roll, pitch, upper, (0.0, 0.0, sign), *_SHOULDER_LIMITS["r"], slot=first + 2),
        Joint(lower, upper, lower, (0.0, -1.0, 0.0), *_ELBOW_LIMITS, slot=first + 3),
    )


def _leg_paper(side: str, sign: float, branch: int) -> Tuple[Joint, ...]:
    pitch, roll, knee, hip = side + "p_hip", side + "r_hip", side + "knee", side + "hip"
    first = branch_slot(branch, 0)
    return (
        Joint(pitch, "body", pitch, (0.0, -1.0, 0.0), *_HIP_FLEXION, slot=first),
        Joint(roll, pitch, hip, (sign, 0.0, 0.0), *_HIP_ABDUCTION, slot=first + 1),
        Joint(knee, hip, knee, (0.0, -1.0, 0.0), *_KNEE_LIMITS, slot=first + 3),
    )


def _leg_rep155(side: str, sign: float, branch: int) -> Tuple[Joint, ...]:
    # The REP names the joints and their order. The axes z, x, -y are those of the model that it points to; they also
    # keep sitting, with the thigh level, away from the singularity that z, y, x would have there.
    yaw, pitch, roll = (side + axis + "_hip" for axis in "ypr")
    knee, hip = side + "knee", side + "hip"
    first = branch_slot(branch, 0)
    return (
        Joint(yaw, "body", yaw, (0.0, 0.0, -1.0), *_HIP_TWIST, slot=first),
        Joint(pitch, yaw, pitch, (sign, 0.0, 0.0), *_HIP_ABDUCTION, slot=first + 1),
        Joint(roll, pitch, hip, (0.0, -1.0, 0.0), *_HIP_FLEXION, slot=first + 2),
        Joint(knee, hip, knee, (0.0, -1.0, 0.0), *_KNEE_LIMITS, slot=first + 3),
    )


_TRUNK = (
    Joint("waist", "body", "waist", (0.0, 1.0, 0.0), *_WAIST_LIMITS, slot=WAIST_SLOT),
    Joint("r_head", "torso", "r_head", (1.0, 0.0, 0.0), *_HEAD_LIMITS["r"], slot=branch_slot(HEAD, 0)),
    Joint("y_head", "r_head", "y_head", (0.0, 0.0, 1.0), *_HEAD_LIMITS["y"], slot=branch_slot(HEAD, 1)),
    Joint("p_head", "y_head", "p_head", (0.0, -1.0, 0.0), *_HEAD_LIMITS["p"], slot=branch_slot(HEAD, 2)),
)
_UPPER_BODY = _TRUNK + _arm("l_", 1.0, LEFT_ARM) + _arm("r_", -1.0, RIGHT_ARM)

PAPER = Layout("paper", _UPPER_BODY + _leg_paper("l_", 1.0, LEFT_LEG) + _leg_paper("r_", -1.0, RIGHT_LEG))
"""The paper's 18 joints; hips pitch (flexion), then roll (abduction): measured the best of the two-joint hips."""
REP155 = Layout("rep155", _UPPER_BODY + _leg_rep155("l_", 1.0, LEFT_LEG) + _leg_rep155("r_", -1.0, RIGHT_LEG))
"""REP-155's 20 joints: a third one in each hip."""


def layout_for(interface: str) -> Layout:
    """Layout of the parameter `interface`. Raises ValueError naming the legal values."""
    for layout in (PAPER, REP155):
        if layout.interface == interface:
            return layout
    raise ValueError("interface is {!r}; legal: paper, rep155".format(interface))


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
