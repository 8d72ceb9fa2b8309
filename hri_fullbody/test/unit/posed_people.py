"""Key points of people in chosen poses: standing, seated, with arms wherever a test wants them."""

from __future__ import annotations

from typing import Optional, Sequence

import numpy as np

from hri_fullbody.core import keypoints as kp

STATURE = 1.7
UP = np.array([0.0, -1.0, 0.0])
# Body axes (forward, left, up) to the optical frame, for a person who faces the camera.
FACING = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])

# Metres from the middle of the hips: forward, left, up.
_STANDING = {
    kp.NOSE: (0.13, 0.0, 0.66), kp.NECK: (0.0, 0.0, 0.473),
    kp.LEFT_EYE: (0.103, 0.0315, 0.705), kp.LEFT_EAR: (0.012, 0.0725, 0.687),
    kp.LEFT_SHOULDER: (0.0, 0.18, 0.473), kp.LEFT_ELBOW: (0.0, 0.20, 0.197), kp.LEFT_WRIST: (0.05, 0.21, -0.06),
    kp.LEFT_HIP: (0.0, 0.09, 0.0), kp.LEFT_KNEE: (0.01, 0.09, -0.408), kp.LEFT_ANKLE: (0.0, 0.09, -0.817)}
_PAIRS = ((kp.LEFT_EYE, kp.RIGHT_EYE), (kp.LEFT_EAR, kp.RIGHT_EAR), (kp.LEFT_SHOULDER, kp.RIGHT_SHOULDER),
          (kp.LEFT_ELBOW, kp.RIGHT_ELBOW), (kp.LEFT_WRIST, kp.RIGHT_WRIST), (kp.LEFT_HIP, kp.RIGHT_HIP),
          (kp.LEFT_KNEE, kp.RIGHT_KNEE), (kp.LEFT_ANKLE, kp.RIGHT_ANKLE))
Place = Sequence[float]


class Pose:
    """A pose under construction, in the body's axes (forward, left, up), m."""

    def __init__(self) -> None:
        self.points = np.zeros((18, 3))
        for index, place in _STANDING.items():
            self.points[index] = place
        for left, right in _PAIRS:
            self.points[right] = self.points[left] * (1.0, -1.0, 1.0)

    def arm(self, side: str, elbow: Place, wrist: Place) -> Pose:
        """Put an arm's elbow and wrist at (forward, outward, up) from its shoulder, m."""
        shoulder, sign = (kp.LEFT_SHOULDER, 1.0) if side == "left" else (kp.RIGHT_SHOULDER, -1.0)
        for joint, place in ((1, elbow), (2, wrist)):
            self.points[shoulder + joint] = self.points[shoulder] + np.array(place) * (1.0, sign, 1.0)
        return self

    def legs(self, knee: Place, ankle: Place) -> Pose:
        """Put the knees and ankles at (forward, outward, up) from their hips, m."""
        return self.leg(knee, ankle).mirrored().leg(knee, ankle).mirrored()

    def leg(self, knee: Place, ankle: Place) -> Pose:
        """Put the left knee and ankle there."""
        for joint, place in ((1, knee), (2, ankle)):
            self.points[kp.LEFT_HIP + joint] = self.points[kp.LEFT_HIP] + np.array(place)
        return self

    def lean(self, degrees: float, whole: bool = False) -> Pose:
        """Turn the trunk, or the whole body, forward about the hips."""
        turn = _about_left(np.radians(degrees))
        above = np.ones(18, dtype=bool)
        if not whole:
            above[kp.RIGHT_HIP:kp.LEFT_ANKLE + 1] = False
        self.points[above] = self.points[above] @ turn.T
        return self

    def mirrored(self) -> Pose:
        """Swap left and right."""
        self.points *= (1.0, -1.0, 1.0)
        for left, right in _PAIRS:
            self.points[[left, right]] = self.points[[right, left]]
        return self

    def without(self, *indices: int) -> Pose:
        """Hide key points."""
        self.points[list(indices)] = np.nan
        return self

    def seen(self, heading: float = 0.0, place: Place = (0.2, 0.1, 3.0), scale: float = 1.0) -> np.ndarray:
        """(18, 3) m in the optical frame of a level camera; heading: rad, turned to the person's left."""
        turn = np.array([[np.cos(heading), -np.sin(heading), 0.0], [np.sin(heading), np.cos(heading), 0.0],
                         [0, 0, 1.0]])
        return scale * self.points @ turn.T @ FACING.T + np.array(place)


def standing() -> Pose:
    return Pose()


def raised(side: str = "left") -> Pose:
    return Pose().arm(side, (0.05, 0.22, 0.10), (0.07, 0.20, 0.36))


def on_face(side: str = "right") -> Pose:
    return Pose().arm(side, (0.17, 0.05, -0.21), (0.15, -0.12, 0.06))


def crossed() -> Pose:
    # Each hand beyond the middle, the right forearm over the left one.
    return (Pose().arm("left", (0.03, 0.06, -0.27), (0.13, -0.22, -0.26))
            .arm("right", (0.05, 0.06, -0.26), (0.17, -0.22, -0.22)))


def waving(time: float, side: str = "right", hertz: float = 1.5, swing: float = 0.12) -> Pose:
    sideways = swing * np.sin(2.0 * np.pi * hertz * time)
    return Pose().arm(side, (0.08, 0.20, -0.16), (0.12, 0.22 + sideways, 0.09))


def seated(trunk: float = 5.0) -> Pose:
    return Pose().legs((0.40, 0.03, 0.02), (0.42, 0.03, -0.39)).lean(trunk)


def crouching() -> Pose:
    return Pose().legs((0.38, 0.08, 0.08), (0.13, 0.08, -0.24)).lean(30.0)


def lying(forward: Optional[bool] = False) -> Pose:
    return Pose().lean(90.0 if forward else -90.0, whole=True)


def _about_left(angle: float) -> np.ndarray:
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])
