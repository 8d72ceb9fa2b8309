"""What is measured of one person in one image: the value types at the boundary to ROS; and which faces and bodies
belong to which image, by their stamps (`FeatureHistory`)."""

from __future__ import annotations

import math
from bisect import bisect_left
from dataclasses import dataclass
from typing import Any, Callable, Dict, Iterable, List, Optional, Sequence, Set, Tuple, Union

import numpy as np

from hri_pipeline.core.geometry import Pose


@dataclass(frozen=True)
class GazeEstimate:
    """Where a face looks.

    direction: (3,) unit vector in the optical frame, None while the eyes are closed or nothing is known.
    confidence: 0 to 1, of the direction. eyes_closed: 0 (open) to 1 (closed). from_eyes: 0 when the direction is that
    of the head alone, 1 when the irises decide. lids: core.faces.gaze.Lids, what the image says of the eyelids; None
    when that is not known.
    """

    direction: Optional[np.ndarray]
    confidence: float
    eyes_closed: float
    from_eyes: float = 0.0
    lids: Optional[Any] = None


@dataclass(frozen=True)
class SoftBiometrics:
    """Apparent age (years) and gender of a face, fused over time. p_male: 0 to 1. Confidences: 0 to 1."""

    age: float
    age_confidence: float
    p_male: float
    gender_confidence: float


@dataclass(frozen=True)
class FaceObservation:
    """One tracked face in one image.

    box: (4,) x0, y0, x1, y1 px. score: 0 to 1.
    landmarks: (70, 3) x px, y px, confidence 0 to 1, in the order of hri_msgs/FacialLandmarks.
    mesh: (478, 3) px; z grows away from the camera and has the scale of x.
    pose: face frame in the optical frame, m; None when it is not known.
    gaze: None when it was not estimated. action_units: core.faces.action_units.ActionUnits; expression:
    core.faces.expression.ExpressionEstimate; soft_biometrics: SoftBiometrics; each None when not estimated in this
    image. head_scale: size of this head over the canonical one, and its standard deviation; None without a pose.
    measured: False when the face was predicted and not measured in this image, because there were too many faces.
    dark_glasses: dark or mirrored lenses hide its eyes, as far as that is noticed.
    """

    id: str
    box: np.ndarray
    score: float
    landmarks: np.ndarray
    mesh: np.ndarray
    pose: Optional[Pose] = None
    gaze: Optional[GazeEstimate] = None
    action_units: Optional[Any] = None
    expression: Optional[Any] = None
    soft_biometrics: Optional[SoftBiometrics] = None
    head_scale: Optional[float] = None
    head_scale_sd: Optional[float] = None
    measured: bool = True
    dark_glasses: bool = False


@dataclass(frozen=True)
class BodyObservation:
    """One tracked body in one image.

    box: (4,) x0, y0, x1, y1 px. score: 0 to 1.
    keypoints: (18, 3) x px, y px, 0 to 1 how sure the network sees it, in the order of hri_msgs/Skeleton2D.
    keypoints_3d: (18, 3) m in the optical frame, NaN where unknown.
    pose: body frame in the optical frame, m; None when it is not known.
    head: face frame in the optical frame, m, of the tracked face that is this body's; None without one.
    velocity: (3,) m/s of the body in the optical frame; None while it is not known.
    measured: False when the body was predicted by its motion and not measured in this image.
    by_depth: True when a depth image gave its distance and its joints, not the size of an average person.
    hands: (2, 3) m from the wrist to the knuckles of the left and the right hand, NaN unknown; None without any.
    image_trunk: length (m) of the trunk at the scale of head and shoulders in the image; NaN unknown, or not
        measured in this image.
    leaving: whether both thighs were measured to hang out of the image.
    reliability: (18,) 0 to 1, how often key points that are seen are right where they are; None: always.
    """

    id: str
    box: np.ndarray
    score: float
    keypoints: np.ndarray
    keypoints_3d: np.ndarray
    pose: Optional[Pose] = None
    head: Optional[Pose] = None
    velocity: Optional[np.ndarray] = None
    measured: bool = True
    by_depth: bool = False
    hands: Optional[np.ndarray] = None
    image_trunk: float = math.nan
    leaving: bool = False
    reliability: Optional[np.ndarray] = None

    @property
    def judged_keypoints(self) -> np.ndarray:
        """The key points (18, 3) x px, y px, confidence 0 to 1 that they are seen and right: what is told to others."""
        if self.reliability is None:
            return self.keypoints
        return np.column_stack([self.keypoints[:, :2], self.keypoints[:, 2] * self.reliability])


# An image with both faces and bodies is preferred to newer ones with one kind up to this age (s).
PREFER_COMPLETE = 1.0


Feature = Union[np.ndarray, Callable[[], np.ndarray]]
"""What is kept of an image: an array, or what gives it when it is asked for the first time."""


class _Kept:
    """Features of one face or body by their stamps (s), in rising order."""

    def __init__(self) -> None:
        self.stamps: List[float] = []
        self._features: List[Feature] = []

    def add(self, stamp: float, feature: Feature, keep: float) -> None:
        """Keep a feature, and those that are no more than `keep` s older than the newest."""
        place = bisect_left(self.stamps, stamp)
        if place < len(self.stamps) and self.stamps[place] == stamp:
            self._features[place] = feature
        else:
            self.stamps.insert(place, stamp)
            self._features.insert(place, feature)
        old = bisect_left(self.stamps, self.stamps[-1] - keep)
        del self.stamps[:old], self._features[:old]

    def nearest(self, stamp: float, tolerance: float) -> Optional[np.ndarray]:
        """Return the feature whose stamp is nearest to `stamp`, at most `tolerance` s away."""
        place = bisect_left(self.stamps, stamp)
        near = min(range(max(0, place - 1), min(place + 1, len(self.stamps))),
                   key=lambda index: abs(self.stamps[index] - stamp))
        return self._get(near) if abs(self.stamps[near] - stamp) <= tolerance else None

    def between(self, stamp: float, gap: float) -> Optional[np.ndarray]:
        """Return the feature at `stamp`, interpolated where it lies between two that are at most `gap` s apart."""
        place = bisect_left(self.stamps, stamp)
        if place < len(self.stamps) and self.stamps[place] == stamp:
            return self._get(place)
        if not 0 < place < len(self.stamps) or self.stamps[place] - self.stamps[place - 1] > gap:
            return None
        share = (stamp - self.stamps[place - 1]) / (self.stamps[place] - self.stamps[place - 1])
        return (1.0 - share) * self._get(place - 1) + share * self._get(place)

    def _get(self, place: int) -> np.ndarray:
        feature = self._features[place]
        if callable(feature):
            feature = self._features[place] = feature()
        return feature


class FeatureHistory:
    """Features of the last `keep` seconds by kind, id and image stamp (s).

    Faces and bodies are found in images of some milliseconds ago, by processes that each take the newest image when
    they are ready: their results come late, and not always for the same images.
    """

    def __init__(self, keep: float = 2.0) -> None:
        self._keep = keep
        self._features: Dict[Tuple[str, str], _Kept] = {}
        self._chosen_from, self._lag = -np.inf, 0.0

    def add(self, kind: str, name: str, stamp: float, feature: Feature) -> None:
        """Keep a feature of face or body `name` for the image of time `stamp`; most are never asked for."""
        kept = self._features.get((kind, name))
        if kept is not None and stamp < kept.stamps[-1] - self._keep:
            kept = None        # time has jumped back
            self._chosen_from, self._lag = -np.inf, 0.0
        if kept is None:
            kept = self._features[kind, name] = _Kept()
        kept.add(stamp, feature, self._keep)

    def keep_only(self, kind: str, names: Iterable[str]) -> None:
        """Forget the features of all ids of `kind` that are not in `names`."""
        wanted = set(names)
        for key in [key for key in self._features if key[0] == kind and key[1] not in wanted]:
            del self._features[key]

    def clear(self) -> None:
        """Forget all, for example when time has jumped back."""
        self._features.clear()
        self._chosen_from = -np.inf
        self._lag = 0.0

    def stamps(self, kind: str) -> Set[float]:
        """Return the stamps of all images in which something of `kind` is known."""
        return {stamp for (one, _), kept in self._features.items() if one == kind for stamp in kept.stamps}

    def stamps_of(self, kind: str, name: str) -> Sequence[float]:
        """Return the stamps of all images in which face or body `name` is known, in rising order."""
        kept = self._features.get((kind, name))
        return () if kept is None else kept.stamps

    def newest_of(self, kind: str, name: str) -> float:
        """Return the stamp of the newest image in which face or body `name` is known, -inf without any."""
        kept = self._features.get((kind, name))
        return -np.inf if kept is None else kept.stamps[-1]

    def at(self, kind: str, stamp: float, tolerance: float, gap: float = 0.0) -> Dict[str, np.ndarray]:
        """Return the feature of each id at `stamp`: between two images that are at most `gap` s apart, else that of the
        nearest one, at most `tolerance` s away."""
        found = {}
        for (one, name), kept in self._features.items():
            if one == kind:
                feature = kept.between(stamp, gap)
                feature = kept.nearest(stamp, tolerance) if feature is None else feature
                if feature is not None:
                    found[name] = feature
        return found

    def choose(self, images: Sequence[float], tolerance: float) -> Optional[float]:
        """Return the stamp of the image to draw on, out of the stamps of the images at hand.

        The newest image for which both faces and bodies are known within `tolerance` s; where one kind is
        missing or lags too far behind, the newest image with any; the newest image when nothing has been
        seen lately, apart from the time by which features came late before. None without images.
        """
        if not images:
            return None
        newest = max(images)
        at_hand = set(images)
        faces, bodies = self.stamps("faces") & at_hand, self.stamps("bodies") & at_hand
        if not faces | bodies:
            return newest
        latest = max(faces | bodies)
        if latest > self._chosen_from:
            # On a slow machine features of old images keep coming; the first ones may be left from before.
            self._lag = newest - latest if np.isfinite(self._chosen_from) else 0.0
            self._chosen_from = latest
        if newest - latest > tolerance + PREFER_COMPLETE + self._lag:
            return newest
        complete = max((stamp for stamp in faces | bodies
                        if _near(stamp, faces, tolerance) and _near(stamp, bodies, tolerance)), default=-np.inf)
        return complete if complete >= latest - PREFER_COMPLETE else latest


def _near(stamp: float, others: Set[float], tolerance: float) -> bool:
    """Tell whether one of `others` is at most `tolerance` from `stamp`."""
    return any(abs(stamp - other) <= tolerance for other in others)
