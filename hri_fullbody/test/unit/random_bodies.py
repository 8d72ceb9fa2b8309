"""Bodies in random places and postures for the tests of the kinematic model."""

import numpy as np
from scipy.spatial.transform import Rotation

from hri_fullbody.core.model.anthropometry import SEGMENTS, SegmentTable
from hri_fullbody.core.model.human import Dimensions

TABLE = SegmentTable.load()


def dimensions(count, seed=0):
    """Different people: statures from 1.45 to 2.0 m, every segment up to 10 % off the mean."""
    random = np.random.default_rng(seed)
    people = []
    for stature in random.uniform(1.45, 2.0, count):
        lengths = {name: stature * TABLE.ratio(name) * random.uniform(0.9, 1.1) for name in SEGMENTS}
        people.append(Dimensions.from_segments(stature, lengths, TABLE))
    return people


def placed(count, seed=0):
    """Rotations (N, 3, 3), any way up, and positions (N, 3) m in front of a camera."""
    random = np.random.default_rng(seed)
    return Rotation.random(count, random_state=seed).as_matrix(), random.normal([0.0, 0.0, 3.0], 1.0, (count, 3))


def postures(layout, count, seed=0, seen=False):
    """Joint values (N, J) all over the limits; `seen`: only such whose angles can be read off the key points, that is
    with the waist straight, elbows and knees bent, arms neither hanging nor straight up."""
    random = np.random.default_rng(seed)
    q = random.uniform(layout.lower, layout.upper, (count, len(layout)))
    if seen:
        q[:, 0] = 0.0
        for index, name in enumerate(layout.joint_names):
            if name.endswith("elbow"):
                q[:, index] = random.uniform(0.32, 2.7, count)
            elif name.endswith("knee"):
                q[:, index] = random.uniform(-2.7, -0.32, count)
            elif name.endswith("p_shoulder"):
                q[:, index] = random.uniform(0.26, np.pi - 0.26, count)
    return q
