"""Re-identification: which lost body comes back under a new id, or whether somebody new has come.

For people who turn away, leave the image, or are hidden for long. Bayes' rule over all who are lost, and the newcomer:
place, time, stature, clothes and face together have to leave one of them. Clothes: colours of five parts of the body.
"""

from __future__ import annotations

import math
from collections import OrderedDict, deque
from dataclasses import dataclass
from typing import Deque, Dict, Iterable, List, NamedTuple, Optional, Tuple

import cv2
import numpy as np

from hri_fullbody.core.detection.pose_estimator import PoseEstimate
from hri_fullbody.core.keypoints import (
    BLAZE_LEFT_ANKLE,
    BLAZE_LEFT_ELBOW,
    BLAZE_LEFT_HIP,
    BLAZE_LEFT_KNEE,
    BLAZE_LEFT_SHOULDER,
    BLAZE_LEFT_WRIST,
    BLAZE_RIGHT_ANKLE,
    BLAZE_RIGHT_ELBOW,
    BLAZE_RIGHT_HIP,
    BLAZE_RIGHT_KNEE,
    BLAZE_RIGHT_SHOULDER,
    BLAZE_RIGHT_WRIST,
)
from hri_pipeline.core.tracks import COLOUR_BINS, appearance_distances

_LEAST_CONFIDENCE = 0.4
_LEAST_SAMPLES = 12
# Where the samples lie: across and along, in parts of the trunk and of the limb. The rims show background.
_ACROSS, _ALONG = (grid.ravel() for grid in np.meshgrid(np.linspace(0.15, 0.85, 9), np.linspace(0.0, 1.0, 8)))
_TRUNKS = (0.05, 0.45), (0.5, 0.92)     # chest, belly
_LIMB = np.linspace(0.15, 0.9, 16)
_TRUNK = (BLAZE_LEFT_SHOULDER, BLAZE_RIGHT_SHOULDER, BLAZE_LEFT_HIP, BLAZE_RIGHT_HIP)
# Ends of each limb, and the part it belongs to: 2 sleeves, 3 thighs, 4 shins.
_LIMBS = ((BLAZE_LEFT_SHOULDER, BLAZE_LEFT_ELBOW, 2), (BLAZE_LEFT_ELBOW, BLAZE_LEFT_WRIST, 2),
          (BLAZE_RIGHT_SHOULDER, BLAZE_RIGHT_ELBOW, 2), (BLAZE_RIGHT_ELBOW, BLAZE_RIGHT_WRIST, 2),
          (BLAZE_LEFT_HIP, BLAZE_LEFT_KNEE, 3), (BLAZE_RIGHT_HIP, BLAZE_RIGHT_KNEE, 3),
          (BLAZE_LEFT_KNEE, BLAZE_LEFT_ANKLE, 4), (BLAZE_RIGHT_KNEE, BLAZE_RIGHT_ANKLE, 4))
_ENDS = np.array([limb[:2] for limb in _LIMBS])
PARTS = 5
BINS = COLOUR_BINS.size


def describe(image: np.ndarray, estimate: PoseEstimate) -> Optional[np.ndarray]:
    """Histograms (5, 21) of the colours of chest, belly, sleeves, thighs and shins in `image` (H, W, 3) BGR.

    Each row is lightness and both colour axes, a third each, and sums to 1, or to 0 where the part is not seen. About
    300 samples: 0.3 ms. None when the shoulders are not seen.
    """
    confidence = estimate.confidence
    if min(confidence[BLAZE_LEFT_SHOULDER], confidence[BLAZE_RIGHT_SHOULDER]) < _LEAST_CONFIDENCE:
        return None  # hips below the image are told well enough for where the trunk is
    seen = np.concatenate([[True], (confidence[_ENDS] >= _LEAST_CONFIDENCE).all(axis=1)])
    rows = _histograms(image, _WEIGHTS @ estimate.landmarks[:len(_WEIGHTS[0]), :2], seen[_SOURCES])
    return rows if rows[0].any() else None


def prepare_colours() -> None:
    """Let OpenCV make its tables of L*a*b* colours: 0.15 s of processor time, for which the first body would wait."""
    cv2.cvtColor(np.zeros((1, 1, 3), np.uint8), cv2.COLOR_BGR2LAB)


def difference(a: Optional[np.ndarray], b: Optional[np.ndarray]) -> Optional[float]:
    """Hellinger distance, 0 (equal) to 1 (nothing in common), over the parts that both show; None when there are none.

    E. Hellinger, "Neue Begruendung der Theorie quadratischer Formen", 1909.
    """
    if a is None or b is None:
        return None
    shown = np.count_nonzero(a.any(axis=1) & b.any(axis=1))
    if not shown:
        return None
    # What one does not show is 0 in the product. Rounding may take a sum a little beyond 1.
    alike = np.minimum(np.sqrt(a * b).sum(axis=1), 1.0)
    return math.sqrt(max(0.0, 1.0 - float(alike.sum()) / shown))


def blend(old: Optional[np.ndarray], new: Optional[np.ndarray], weight: float) -> Optional[np.ndarray]:
    """Move `old` towards `new` by `weight` (0 to 1), part by part; a part that only one of them shows is taken over."""
    if old is None or new is None:
        return new if old is None else old
    known, shown = old.sum(axis=1) > 0.0, new.sum(axis=1) > 0.0
    share = np.where(known & shown, weight, np.where(known, 0.0, 1.0))[:, None]
    return (1.0 - share) * old + share * new


def _samples() -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Samples (S,) of a body: weights (S, 29) of the landmarks whose sum is their place, the part (S,) each belongs to,
    and where it comes from (S,): 0 the trunk, 1 and more the limbs."""
    weights, parts, sources = [], [], []
    for part, (first, last) in enumerate(_TRUNKS):
        along = first + _ALONG * (last - first)
        rows = np.zeros((len(along), BLAZE_RIGHT_ANKLE + 1))
        rows[:, _TRUNK] = np.stack([(1.0 - _ACROSS) * (1.0 - along), _ACROSS * (1.0 - along),
                                    (1.0 - _ACROSS) * along, _ACROSS * along], axis=1)
        weights.append(rows)
        parts += [part] * len(rows)
        sources += [0] * len(rows)
    for source, (first_end, last_end, part) in enumerate(_LIMBS, 1):
        rows = np.zeros((len(_LIMB), BLAZE_RIGHT_ANKLE + 1))
        rows[:, first_end], rows[:, last_end] = 1.0 - _LIMB, _LIMB
        weights.append(rows)
        parts += [part] * len(rows)
        sources += [source] * len(rows)
    return np.concatenate(weights), np.array(parts), np.array(sources)


_WEIGHTS, _OWNERS, _SOURCES = _samples()


def _histograms(image: np.ndarray, samples: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Histograms (5, 21) of the parts at the samples (S, 2) px that are seen (S,); 0 where too few of them are inside
    the image."""
    height, width = image.shape[:2]
    x, y = np.floor(samples.T).astype(np.int64)
    inside = seen & (x >= 0) & (x < width) & (y >= 0) & (y < height)
    inside &= (np.bincount(_OWNERS[inside], minlength=PARTS) >= _LEAST_SAMPLES)[_OWNERS]
    if not inside.any():
        return np.zeros((PARTS, BINS))
    return _rows(_OWNERS[inside], PARTS, cv2.cvtColor(image[y[inside], x[inside]][None], cv2.COLOR_BGR2LAB)[0])


def histogram_of_colours(lightness: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Histogram (21,), sum 1, of pixels (N,): their lightness (0 to 255), and where they lie on both axes of colour
    (-128 to 127), rounded."""
    pixels = np.clip(np.rint([lightness, first + 128.0, second + 128.0]), 0.0, 255.0).astype(np.uint8).T
    return _rows(np.zeros(len(pixels), np.int64), 1, pixels)[0]


def _rows(owners: np.ndarray, count: int, pixels: np.ndarray) -> np.ndarray:
    """Histograms (count, 21) of pixels (N, 3) uint8 L*a*b*, each of which belongs to the row `owners` (N,)."""
    values = (768 * owners)[:, None] + pixels + _CHANNELS
    counts = np.bincount(values.ravel(), minlength=768 * count).reshape(count, 768) @ _SHARES
    return np.asarray(counts / np.maximum(counts.sum(axis=1, keepdims=True), 1e-9))


def _shares() -> np.ndarray:
    """How much (768, 21) each value, 256 of lightness and of both axes of colour, counts for each bin."""
    light, colour = _near_bins(np.arange(256.0), COLOUR_BINS[0]), _near_bins(np.arange(-128.0, 128.0), COLOUR_BINS[1])
    # A little more or less light is forgiven.
    edged = np.pad(light, ((0, 0), (1, 1)), "edge")
    shares = np.zeros((3, 256, *COLOUR_BINS.shape))
    shares[0, :, 0] = 0.25 * edged[:, :-2] + 0.5 * light + 0.25 * edged[:, 2:]
    shares[1, :, 1] = shares[2, :, 2] = colour
    return shares.reshape(768, BINS)


def _near_bins(values: np.ndarray, middles: np.ndarray) -> np.ndarray:
    """Shares (N, B) of values (N,): each counts for the bins on both sides of it, the nearer more, so that no colour
    lies on a border."""
    place = np.interp(values, middles, np.arange(len(middles)))
    return np.asarray(np.maximum(0.0, 1.0 - np.abs(place[:, None] - np.arange(len(middles)))))


_SHARES = _shares()
_CHANNELS = np.array([0, 256, 512])


LEAST_LIKELIHOOD = 0.9
"""What is less likely is not told."""
CLEARLY_ALIKE = 0.21
"""Distance of the clothes up to which somebody is told: a quarter farther than the mean of one human at two times."""
WATCH_S = 1.0
"""Time (s) for which a body is seen before it is compared, or remembered: the clothes of one image say less."""
MAX_LOST = 50
# Hellinger distance of the clothes that were learnt of one human at two times, and of two people: mean and standard
# deviation, of the first 40 s of vtest.avi, where nearly all wear dark jackets.
_SAME, _SAME_SD = 0.167, 0.06
_OTHER, _OTHER_SD = 0.48, 0.14
# Part of the strangers who wear such clothes as somebody who is known: that of this many people unless those who are
# seen here tell.
_ALIKE_PRIOR, _ALIKE_WEIGHT = 0.02, 10.0
_ALIKE_BELOW = 0.27         # 95 % of the distances of one human
_WARDROBE = 40              # people whose clothes are remembered for that
# Half of those who leave come back, on average after this time; without experience one stranger comes in half a minute.
_RETURN_SHARE, _RETURN_S = 0.5, 5.0
_NEWCOMER_S = 30.0
_MOST_PRIOR_ODDS = 2.0      # without evidence: however quiet it was, a stranger may come
_THERE_S = 10.0             # who is seen so soon after the start has not come, but was there; ten people take 8 s
# Standard deviation of where somebody comes back: so much, a part of the distance, and what is walked in this time at
# most. Half of the strangers come in where others go out, the rest anywhere in this area, m2.
_NEAR_M, _INEXACT, _WALK_MPS, _LONGEST_WALK_S = 0.3, 0.12, 0.6, 5.0
_AREA_M2, _SAME_DOOR = 30.0, 0.5
_FASTEST_MPS = 2.0
_NEW_SHARE = 0.5            # probability from which somebody counts as one more who wears what he wears
_ITERATIONS = 20
_STATURE_SD = 0.09          # m, of adults
_SAME_FACE = 6.0            # logarithm: a face that goes on from one body to the next


class TrackAppearance(NamedTuple):
    """One body now.

    appearance: histograms of `appearance.describe`. place: (3,) m of its root in the optical frame, or in that of a
    level camera that stands where the robot's frame does, when `still`; distance: m from the camera, None that of the
    place. stature: m, with its standard deviation. face: id of the face it has. None: unknown. visible: it is seen now,
    not only waited for.
    """

    id: str
    appearance: Optional[np.ndarray]
    place: Optional[np.ndarray]
    stature: Optional[float] = None
    stature_sd: float = 0.1
    face: Optional[str] = None
    visible: bool = True
    still: bool = False
    distance: Optional[float] = None


class Reidentification(NamedTuple):
    """A new body that is an earlier one with some likelihood (0 to 1)."""

    id: str
    earlier: str
    likelihood: float


@dataclass
class _Body:
    """What is known of a body: as it was first and last seen (stamps in s)."""

    now: TrackAppearance
    first: float
    last: float
    born_at: Optional[TrackAppearance]


class BodyReidentifier:
    """Remembers the bodies of the last seconds; each is found again once at most."""

    def __init__(self, memory: float) -> None:
        """Remember a body for `memory` s after it was lost; 0: not at all. ValueError for less."""
        if not memory >= 0.0:
            raise ValueError("memory is {} s, must not be negative".format(memory))
        self._memory = memory
        self._wardrobe: Deque[np.ndarray] = deque(maxlen=_WARDROBE)
        self.reset()

    def reset(self) -> None:
        """Forget all."""
        self._living: Dict[str, _Body] = {}
        self._lost: "OrderedDict[str, _Body]" = OrderedDict()
        self._undecided: Dict[str, float] = {}
        self._wardrobe.clear()
        self._begun: Optional[float] = None
        self._newcomers = 0.0

    def update(self, bodies: Iterable[TrackAppearance], stamp: float) -> List[Reidentification]:
        """Take all confirmed bodies at `stamp` (s); returns the new ones that are known."""
        self._begun = stamp if self._begun is None else self._begun
        seen = {body.id: body for body in bodies}
        for gone in [key for key in self._living if key not in seen]:
            body = self._living.pop(gone)
            if body.last - body.first >= WATCH_S - 1e-6:
                self._lost[gone] = body
            self._undecided.pop(gone, None)
        # Who came in time is decided upon later.
        for key in [key for key, body in self._lost.items() if stamp - body.last > self._memory + 2.0 * WATCH_S]:
            del self._lost[key]
        while len(self._lost) > MAX_LOST:
            self._lost.popitem(last=False)
        for now in seen.values():
            self._take(now, stamp)
        return self._decide(stamp) if self._memory > 0.0 else []

    def _take(self, body: TrackAppearance, stamp: float) -> None:
        known = self._living.get(body.id)
        if known is None:
            self._living[body.id] = _Body(body, stamp, stamp, body if body.place is not None else None)
            self._undecided[body.id] = stamp
            return
        if not body.visible:
            return
        old = known.now
        placed = old if body.place is None else body
        known.now = body._replace(
            appearance=old.appearance if body.appearance is None else body.appearance,
            place=placed.place, still=placed.still, distance=placed.distance, face=body.face or old.face,
            stature=old.stature if body.stature is None else body.stature,
            stature_sd=old.stature_sd if body.stature is None else body.stature_sd)
        known.last = stamp
        known.born_at = body if known.born_at is None and body.place is not None else known.born_at

    def _decide(self, stamp: float) -> List[Reidentification]:
        """Compare the new bodies that were seen for long enough, each once, with all who are lost."""
        due = [key for key in self._undecided if self._living[key].now.appearance is not None
               and self._living[key].last - self._living[key].first >= WATCH_S - 1e-6]
        if not due:
            return []
        # Those who are still watched may be one of the lost as well.
        rivals = list(self._undecided)
        lost = list(self._lost)
        odds = np.array([[self._odds(self._living[new], self._lost[old], stamp) for old in lost] for new in rivals])
        odds = odds.reshape(len(rivals), len(lost))
        found = []
        likely = marginals(odds)
        for key in due:
            del self._undecided[key]
            row = rivals.index(key)
            new = 1.0 - float(likely[row].sum())
            if self._begun is not None and self._living[key].first - self._begun > _THERE_S:
                self._newcomers += new
            best = int(np.argmax(likely[row])) if lost else -1
            if best >= 0 and likely[row, best] >= LEAST_LIKELIHOOD and _all_agrees(
                    self._living[key], self._lost[lost[best]]):
                found.append(Reidentification(key, lost[best], float(likely[row, best])))
                del self._lost[lost[best]]
            appearance = self._living[key].now.appearance
            if appearance is not None and new > _NEW_SHARE:
                self._wardrobe.append(appearance)
        return found

    def _odds(self, new: _Body, old: _Body, stamp: float) -> float:
        """How many times likelier it is that `new` is `old` than that it is somebody who has just come."""
        gap = new.first - old.last
        clothes = difference(new.now.appearance, old.now.appearance)
        if not 0.0 <= gap <= self._memory or clothes is None:
            return 0.0
        watched = stamp - (stamp if self._begun is None else self._begun)
        newcomers = (self._newcomers + 1.0) / (watched + _NEWCOMER_S)
        returns = _RETURN_SHARE / _RETURN_S * math.exp(-gap / _RETURN_S)
        evidence = (math.log(min(returns / newcomers, _MOST_PRIOR_ODDS))
                    + _place_evidence(new.born_at, old.now, gap)
                    + _clothes_evidence(clothes, self._alike(old)) + _stature_evidence(new.now, old.now)
                    + self._face_evidence(new, old))
        return math.exp(evidence)

    def _alike(self, old: _Body) -> float:
        """Part of the people here, without the lost one, who wear such clothes."""
        alike = 0
        if old.now.appearance is not None and self._wardrobe:
            alike = int((appearance_distances(old.now.appearance, np.stack(self._wardrobe)) <= _ALIKE_BELOW).sum())
        # One of them is the lost one himself.
        others = max(0, len(self._wardrobe) - 1)
        return (_ALIKE_PRIOR * _ALIKE_WEIGHT + max(0, alike - 1)) / (_ALIKE_WEIGHT + others)

    def _face_evidence(self, new: _Body, old: _Body) -> float:
        """Logarithm of the odds by the faces: one that goes on is the same human; one that somebody else had is not."""
        face = new.now.face
        if face is None:
            return 0.0
        if face == old.now.face:
            return _SAME_FACE
        others = [body for body in (*self._lost.values(), *self._living.values()) if body is not new]
        return -math.inf if any(body.now.face == face for body in others) else 0.0


def _all_agrees(new: _Body, old: _Body) -> bool:
    """Tell whether clothes and stature each let two bodies be one human, however likely all together makes it: somebody
    dressed much like him may come where he has left. A face that goes on tells by itself."""
    if new.now.face is not None and new.now.face == old.now.face:
        return True
    clothes = difference(new.now.appearance, old.now.appearance)
    return clothes is not None and clothes <= CLEARLY_ALIKE and _stature_evidence(new.now, old.now) >= 0.0


def marginals(odds: np.ndarray) -> np.ndarray:
    """Probabilities (N, L) of each new body being each of the lost, where nobody is two; what is left is a newcomer.

    odds: (N, L) against the newcomer. Belief propagation for data association: J. L. Williams, R. A. Lau, "Approximate
    Evaluation of Marginal Association Probabilities with Belief Propagation", IEEE Trans. AES 50(4), 2014.
    """
    free = np.ones_like(odds)
    for _ in range(_ITERATIONS):
        weighted = odds * free
        claims = odds / (1.0 + weighted.sum(axis=1, keepdims=True) - weighted)
        free = 1.0 / (1.0 + claims.sum(axis=0, keepdims=True) - claims)
    weighted = odds * free
    return weighted / (1.0 + weighted.sum(axis=1, keepdims=True))


def _place_evidence(new: Optional[TrackAppearance], old: TrackAppearance, gap: float) -> float:
    """Logarithm of the odds by the places, over the ground: a normal distribution around where he was lost, against the
    same and anywhere."""
    if new is None or old.place is None or new.still != old.still:
        return 0.0
    way = float(np.linalg.norm(np.asarray(new.place)[[0, 2]] - np.asarray(old.place)[[0, 2]]))
    error = math.hypot(_NEAR_M, _INEXACT * (float(np.linalg.norm(old.place)) if old.distance is None else old.distance))
    if way > 3.0 * error + _FASTEST_MPS * gap:
        return -math.inf
    variance = error ** 2 + (_WALK_MPS * min(gap, _LONGEST_WALK_S)) ** 2
    same = math.exp(-way ** 2 / (2.0 * variance)) / (2.0 * math.pi * variance)
    return math.log(max(same, 1e-12)) - math.log(_SAME_DOOR * same + (1.0 - _SAME_DOOR) / _AREA_M2)


def _clothes_evidence(apart: float, alike: float) -> float:
    """Logarithm of the odds by the distance of the clothes. alike: part of the strangers who wear such clothes."""
    # The densities are wide enough to be believed down to two standard deviations below the mean only.
    apart = max(apart, _SAME - 1.5 * _SAME_SD)
    same = _density(apart, _SAME, _SAME_SD)
    return math.log(max(same, 1e-12)) - math.log(alike * same + (1.0 - alike) * _density(apart, _OTHER, _OTHER_SD))


def _stature_evidence(new: TrackAppearance, old: TrackAppearance) -> float:
    """Logarithm of the odds by the statures: what is measured badly says little."""
    if new.stature is None or old.stature is None:
        return 0.0
    apart, error = new.stature - old.stature, math.hypot(new.stature_sd, old.stature_sd)
    return (math.log(max(_density(apart, 0.0, error), 1e-12))
            - math.log(max(_density(apart, 0.0, math.hypot(error, math.sqrt(2.0) * _STATURE_SD)), 1e-12)))


def _density(value: float, mean: float, sd: float) -> float:
    return math.exp(-((value - mean) / sd) ** 2 / 2.0) / (sd * math.sqrt(2.0 * math.pi))
