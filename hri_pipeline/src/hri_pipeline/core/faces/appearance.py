"""What a face looks like, and whether a track is still of the same face.

Two things are compared. First a small grey picture of the face in each inference, warped to the mean face and
normalised: its correlation with the one before is cheap, and shows that something has changed, such as the face, the
pose or an occlusion. Then the templates of the recognition network, where there is one, show whether it is somebody
else. A blink, a turn or the light changes the first one and not the second one.

Consecutive pictures (0.12 s) of five films of talking, grimacing and weeping people correlate by 0.84 (1 % of them) to
1.0, pictures 1.2 s apart by 0.45 and more; different people on photographs by 0.32 (median), 0.73 (95 %) and 0.88
(most). Distances of dlib's templates in one film: up to 0.25 within 0.12 s, 0.38 within 0.4 s, 0.42 within 4 s (99 %:
0.40, of a woman who covers her face; the other films: 0.30); of different people 0.36 and more (1 %: 0.38).
"""

from __future__ import annotations

from collections import deque
from enum import Enum
from typing import Callable, Deque, List, Optional, Sequence, Tuple

import cv2
import numpy as np

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces.crops import burnt_part, features, smeared
from hri_pipeline.core.recognition.embedding import face_chip

CHIP = 24
"""Side of the small picture, px."""
_BORDER = 0.1
_SMOOTH = 1.0
_FLAT = 1.5
"""Standard deviation (grey values) of a small picture below which it shows nothing."""
EYES = (33, 263)
"""Mesh vertices of the outer corners of the eyes."""
_NOSE = 4
LEAST_EYES = 16.0
"""Distance of the outer corners of the eyes (px) from which a template tells who it is."""
_WHITE, _BURNT_PART = 254, 0.4
"""Value of all three channels from which a pixel is burnt white, and part of a face of which its template tells
nothing: by .5 it is .27 to .47 from that of the same face in better light. Unspoilt ones of photographs have .01."""
SMEARED = 0.55
"""Part of the features in one direction (see `crops.smeared`), against another look, below which motion has blurred a
face: its template is as far from its own as a stranger's. Blurs by 5 to 31 px of 11 faces, 40 to 150 px large: .98 of
the templates that are .34 and more off (.83 with much noise; of ten others .71), and of strangers whose small pictures
are alike none (the least .57)."""
BLURRED_S = 3.0
"""Time (s) after which a face whose looks stay blurred looks so."""
SUDDEN, GRADUAL = 0.8, 0.6
"""Correlation with the last look, and with the views of the last seconds, below which a face has changed."""
SAME_PART, OTHER_PART = 0.85, 0.95
"""Distances of templates up to which it is the same face, and from which it is another one at once, over the distance
at which the network finds both equally likely."""
AWAY_PART = 1.2
"""The distance from which a face that is seen from the side is another one at once; as OTHER_PART."""
LOOKED_AWAY = 0.35
"""Asymmetry (see `asymmetry`) from which a face is seen from the side."""
FOUND_PART = 0.8
"""The same, for a face that is found again anywhere in the picture."""
SAME_CHIP, OTHER_CHIP = 0.7, 0.45
"""Correlations with the best view from which it is the same face, and below which it is another one, where there is
no template."""
TURN = 0.15
"""Change of the asymmetry by which a head has turned: its small picture then tells nothing."""
VIEW_PERIOD, VIEWS = 0.5, 6
"""Time (s) between two views that are kept of a face, and how many."""
CHECK_PERIOD = 3.0
"""Time (s) after which a face is checked although nothing seems to have changed; longer than recognition leaves one
without a template, which serves as the check (CALM_INTERVAL), and the wait for a look and a turn."""
FRESH = 0.5
"""Age (s) of the last look up to which a small change since then speaks for the same face in another pose."""
_LARGEST_PART = 300 * 300
"""Pixels of the image, about a face, that are copied in less time than its crop is made."""
STEP_PART = 0.6
"""Distance of the templates of two looks that follow each other, of one face that turns; as SAME_PART."""

Embed = Callable[[Sequence[np.ndarray]], np.ndarray]
"""Makes unit vectors (N, D) of crops (N, S, S, 3) uint8 BGR."""


class Verdict(Enum):
    """Whether a look shows the face that is remembered."""

    SAME = "same"
    UNSURE = "unsure"
    OTHER = "other"


class FaceLook:
    """One look at a face. The image is kept until `release`, or the part of it about the face until there is a crop,
    which is made when it is needed: nobody may write to it."""

    def __init__(self, bgr: np.ndarray, mesh: np.ndarray, camera: Optional[CameraModel] = None) -> None:
        """bgr: (H, W, 3) uint8, that nobody writes to; mesh: (478, 3) px; camera: see `face_chip`."""
        self._bgr: Optional[np.ndarray] = bgr
        self._mesh, self._camera = mesh, camera
        self._origin: Optional[Tuple[int, int]] = None      # of the part
        self.eyes = float(np.linalg.norm(mesh[EYES[0], :2] - mesh[EYES[1], :2]))
        self.asymmetry = asymmetry(mesh)
        self.chip = small_picture(bgr, mesh)
        self.crop: Optional[np.ndarray] = None
        self.template: Optional[np.ndarray] = None
        self.is_blurred = False
        """By motion, against the views of its face."""
        self._features: Optional[Tuple[float, float, float]] = None

    def keep_crop(self, size: int, alignment: str = "dlib") -> None:
        """Make the crop (size, size, 3) for the recognition network, where the face is large enough and not burnt
        white; alignment: see `face_chip`."""
        if self.crop is None and self._bgr is not None and self.eyes >= LEAST_EYES:
            crop = face_chip(self._bgr, self._mesh, size, alignment=alignment, camera=self._camera,
                             origin=self._origin or (0, 0))
            self.crop = crop if burnt_part(crop, _WHITE) <= _BURNT_PART else None
            if self._origin is not None:        # nothing else is made of a part
                self._bgr = None

    def prepare(self, size: int, alignment: str = "dlib") -> bool:
        """Make the crop; returns whether there is anything to compare. size, alignment: see keep_crop."""
        self.keep_crop(size, alignment)
        return self.template is not None or self.crop is not None

    def keep_part(self, size: int, alignment: str = "dlib") -> None:
        """Keep of the image what the crop is made of: few are ever needed. Of a face that fills the image, the crop.
        size, alignment: see keep_crop."""
        if self.template is None and self.crop is None and self._bgr is not None and self.eyes >= LEAST_EYES:
            low, high = self._mesh[:, :2].min(axis=0), self._mesh[:, :2].max(axis=0)
            reach, limits = float((high - low).max()), self._bgr.shape[1::-1]
            (x0, y0), (x1, y1) = ([min(max(int(value), 0), limit) for value, limit in zip(corner.tolist(), limits)]
                                  for corner in (low - reach, high + reach + 1.0))
            if 0 < (x1 - x0) * (y1 - y0) <= _LARGEST_PART:
                self._bgr, self._origin = self._bgr[y0:y1, x0:x1].copy(), (x0, y0)
            else:
                self.keep_crop(size, alignment)
        self.release()

    def is_smeared(self, other: FaceLook) -> bool:
        """Whether motion has blurred this look, against another one; not known without crops."""
        mine, others = self._seen_features(), other._seen_features()
        return mine is not None and others is not None and smeared(mine, others) < SMEARED

    def _seen_features(self) -> Optional[Tuple[float, float, float]]:
        if self._features is None and self.crop is not None:
            self._features = features(self.crop)
        return self._features

    def release(self) -> None:
        """Let go of the image."""
        if self._origin is None:
            self._bgr = None


def asymmetry(mesh: np.ndarray) -> float:
    """Return how far the tip of the nose is from the middle of the eyes, along them: 0 from the front, 1 at the corner
    of one eye. mesh: (478, 2 or more) px."""
    right, left, nose = (mesh[vertex, :2] for vertex in (*EYES, _NOSE))
    across = left - right
    return float(abs((2.0 * nose - right - left) @ across) / max(1e-9, float(across @ across)))


def small_picture(bgr: np.ndarray, mesh: np.ndarray) -> Optional[np.ndarray]:
    """Return the grey picture (CHIP * CHIP,) of a face, of mean 0 and length 1; None where there is nothing in it."""
    try:
        grey = cv2.cvtColor(face_chip(bgr, mesh, CHIP, _BORDER), cv2.COLOR_BGR2GRAY).astype(np.float32)
    except ValueError:
        return None
    grey = cv2.GaussianBlur(grey, (0, 0), _SMOOTH)
    grey -= grey.mean()
    length = float(np.linalg.norm(grey))
    return None if length < _FLAT * CHIP else (grey / length).ravel()


def correlation(one: FaceLook, other: FaceLook) -> float:
    """Return the correlation (-1 to 1) of two looks, 1 where one shows nothing."""
    if one.chip is None or other.chip is None:
        return 1.0
    return float(one.chip @ other.chip)


class FaceMemory:
    """The last look at a face and its views of the last seconds."""

    def __init__(self, look: FaceLook, stamp: float) -> None:
        """stamp: s."""
        self.last, self.last_stamp = look, stamp
        self.checked = stamp
        self.views: Deque[FaceLook] = deque([look], maxlen=VIEWS)
        self._viewed = stamp
        self.blurred_since: Optional[float] = None
        """Time (s) since when looks were blurred, each time that one was compared; None: the last one was not."""

    def add(self, look: FaceLook, stamp: float) -> bool:
        """Take a look of the same face; returns whether it has become a view. Lets go of the image of the last one."""
        self.last.release()
        self.last, self.last_stamp = look, stamp
        if look.is_blurred or stamp - self._viewed < VIEW_PERIOD and look.template is None:
            return False
        self.views.append(look)
        self._viewed = stamp
        return True

    def make_view(self, stamp: float) -> None:
        """Keep the last look, of `stamp` (s), as a view."""
        if self.views[-1] is not self.last:
            self.views.append(self.last)
        self._viewed = stamp

    def has_changed(self, look: FaceLook, stamp: float) -> bool:
        """Whether a look differs from the ones before, or it is time to check."""
        if self.blurred_since is not None or stamp - self.checked >= CHECK_PERIOD:
            return True
        if correlation(self.last, look) < SUDDEN:
            return True
        return max(correlation(view, look) for view in self.views) < GRADUAL or (
            correlation(self.views[0], look) < GRADUAL and stamp - self.checked >= VIEW_PERIOD)


class AppearanceMatcher:
    """Tells whether looks show the faces that are remembered.

    Parameters
    ----------
    embed
        Makes templates of crops, None where nobody may be recognised: then the small pictures tell what they can.
    size
        Side of the crops, px.
    equal
        Distance of templates at which the same and another face are equally likely.
    alignment
        Of the crops, see `recognition.embedding.face_chip`.
    """

    def __init__(self, embed: Optional[Embed] = None, size: int = 150, equal: float = 0.4,
                 alignment: str = "dlib") -> None:
        self._embed, self._size, self._equal, self._alignment = embed, size, equal, alignment

    def begin(self, look: FaceLook, stamp: float) -> FaceMemory:
        """Return the memory of a face that is seen for the first time."""
        self._keep(look)
        return FaceMemory(look, stamp)

    def remember(self, memory: FaceMemory, look: FaceLook, stamp: float) -> None:
        """Take a look of the same face. The image of the last look is kept, of a view the part about the face."""
        if memory.add(look, stamp):
            self._keep(look)

    def _keep(self, look: FaceLook) -> None:
        if self._embed is None:
            look.release()
        else:
            look.keep_part(self._size, self._alignment)

    def verdict(self, memory: FaceMemory, look: FaceLook, stamp: float, doubtful: bool = False,
                same_colours: bool = False) -> Verdict:
        """Return whether a look shows the face that is remembered.

        doubtful: the face was lost, or the picture has changed, so that nothing but its appearance speaks for it.
        same_colours: those of the face are as before, so that it may have turned.
        """
        memory.checked = stamp
        if self._note_blur(memory, look, stamp):
            return self._by_picture(memory, look, doubtful, same_colours)
        if self._is_near_known_views(memory, look):
            return Verdict.SAME
        distance = self._from_views(memory, look)
        if distance is None:
            return self._by_picture(memory, look, doubtful, same_colours)
        if distance <= SAME_PART * self._equal:
            return Verdict.SAME
        if doubtful:
            return Verdict.OTHER
        turned = look.asymmetry > LOOKED_AWAY
        if stamp - memory.last_stamp <= FRESH and self._between(memory.last, look) <= STEP_PART * self._equal:
            return Verdict.SAME if turned else Verdict.UNSURE
        return Verdict.OTHER if distance >= (AWAY_PART if turned else OTHER_PART) * self._equal else Verdict.UNSURE

    def take_template(self, memory: FaceMemory, template: np.ndarray, stamp: float) -> None:
        """Take a template (D,) that recognition has made of the last look, at `stamp` (s): where it is near the known
        ones, no other one is needed for a check. The first one of an unspoilt look is what others are compared with."""
        look = memory.last
        if (self._embed is None or memory.last_stamp != stamp or look.template is not None
                or look.eyes < LEAST_EYES):
            return
        known = [view.template for view in memory.views if view.template is not None]
        if not known and not self._is_unspoilt(memory, look):
            return
        self._keep(look)
        look.template = template
        if not known:
            memory.make_view(stamp)
        elif self._from_mean(look, known) <= SAME_PART * self._equal:
            memory.checked = stamp
            memory.make_view(stamp)
        else:
            look.template = None

    def _is_unspoilt(self, memory: FaceMemory, look: FaceLook) -> bool:
        """Whether a look is neither burnt white nor, against any view, blurred by motion."""
        if not look.prepare(self._size, self._alignment):
            return False
        return not any(look.is_smeared(view) for view in memory.views if view.prepare(self._size, self._alignment))

    def is_found(self, memory: FaceMemory, look: FaceLook) -> bool:
        """Return whether a look anywhere in the picture shows the face that is remembered for certain."""
        distance = self.distance(memory, look)
        return distance is not None and distance <= FOUND_PART * self._equal

    def distance(self, memory: FaceMemory, look: FaceLook) -> Optional[float]:
        """Return the distance between a look and the mean of the views, None without templates and where motion has
        blurred either."""
        return None if self._is_blurred(memory, look) else self._from_views(memory, look)

    def _from_views(self, memory: FaceMemory, look: FaceLook) -> Optional[float]:
        """Return the distance between a look, blurred or not, and the mean of the views; None without templates."""
        views = self._views(memory)
        if not look.prepare(self._size, self._alignment) or not views:
            return None
        self._fill([look] + views)
        return self._from_mean(look, [view.template for view in views if view.template is not None])

    def _views(self, memory: FaceMemory) -> List[FaceLook]:
        """Return the views that can be compared: those of them that motion has not blurred, against the others."""
        if self._embed is None:
            return []
        views = [view for view in memory.views if view.prepare(self._size, self._alignment)]
        return [view for view in views if not any(view.is_smeared(other) for other in views)]

    def _is_blurred(self, memory: FaceMemory, look: FaceLook) -> bool:
        """Whether motion has blurred a look, against its views, or all of them, against the look; noted in the look."""
        views = self._views(memory)
        if not views or not look.prepare(self._size, self._alignment):
            return False
        look.is_blurred = any(look.is_smeared(view) for view in views)
        return look.is_blurred or all(view.is_smeared(look) for view in views)

    def _note_blur(self, memory: FaceMemory, look: FaceLook, stamp: float) -> bool:
        """Return whether place and picture alone tell, for a while, since motion has blurred a look or all views; the
        next look is compared, too."""
        if not self._is_blurred(memory, look):
            memory.blurred_since = None
            return False
        if memory.blurred_since is None:
            memory.blurred_since = stamp
        return stamp - memory.blurred_since < BLURRED_S

    def _is_near_known_views(self, memory: FaceMemory, look: FaceLook) -> bool:
        """Whether the views whose templates are there, or else the oldest one, tell that it is the same face: one or
        two inferences instead of six."""
        known = [view for view in memory.views if view.template is not None] or self._views(memory)[:1]
        if self._embed is None or not known or not look.prepare(self._size, self._alignment):
            return False
        self._fill([look] + known)
        return self._from_mean(look, [view.template for view in known
                                      if view.template is not None]) <= SAME_PART * self._equal

    @staticmethod
    def _from_mean(look: FaceLook, templates: Sequence[np.ndarray]) -> float:
        mean = np.mean(templates, axis=0)
        assert look.template is not None
        return float(np.linalg.norm(look.template - mean / max(1e-9, float(np.linalg.norm(mean)))))

    def _between(self, one: FaceLook, other: FaceLook) -> float:
        """Return the distance between two looks, infinite without templates."""
        if not (one.prepare(self._size, self._alignment) and other.prepare(self._size, self._alignment)):
            return float("inf")
        self._fill([one, other])
        assert one.template is not None
        return float(np.linalg.norm(one.template - other.template))

    def _fill(self, looks: Sequence[FaceLook]) -> None:
        """Make the templates that are missing."""
        missing = [look for look in looks if look.template is None]
        if missing and self._embed is not None:
            templates = self._embed([look.crop for look in missing if look.crop is not None])
            for look, template in zip(missing, templates):
                look.template = template

    @staticmethod
    def _by_picture(memory: FaceMemory, look: FaceLook, doubtful: bool, same_colours: bool) -> Verdict:
        best = max(correlation(view, look) for view in list(memory.views) + [memory.last])
        if same_colours and not doubtful and abs(look.asymmetry - memory.last.asymmetry) > TURN:
            return Verdict.SAME
        if best < OTHER_CHIP:
            return Verdict.OTHER
        return Verdict.SAME if best >= SAME_CHIP or not doubtful else Verdict.UNSURE
