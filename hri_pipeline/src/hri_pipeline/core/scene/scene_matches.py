"""What matchers and a recogniser would say of the features of a scene."""

from __future__ import annotations

import random
from types import SimpleNamespace
from typing import Dict, List, NamedTuple, Optional, Tuple

import numpy as np

from hri_pipeline.core.scene.scene_senses import Sensed, SensedFace

FACE, BODY, VOICE, PERSON = "face", "body", "voice", "person"
REPEAT_S = 1.0
"""A statement that still holds is said again after so long."""
_SPREAD = 0.04
_RECOGNISED = 0.9


class Statement(NamedTuple):
    """Two ids, what they are of, and the likelihood that they belong to one human."""

    first_kind: str
    first: str
    second_kind: str
    second: str
    likelihood: float


Pair = Tuple[str, str, str, str]


class SceneMatches:
    """Says which features belong together, as the matchers of a graph do. settings: of scene_parameters.SCENE_PARAMETERS."""

    def __init__(self, settings: SimpleNamespace, seed: int = 0) -> None:
        self._settings = settings
        self._chance = random.Random("{} matches".format(seed))
        self._said: Dict[Pair, float] = {}
        self._since: Dict[str, float] = {}

    def reset(self) -> None:
        """Forget everything, as when the scene begins again."""
        self._said.clear()
        self._since.clear()

    def update(self, sensed: Sensed) -> List[Statement]:
        """Return what is to be said at this cycle. Nothing is withdrawn: who has left was still that person."""
        wanted = self._pairs(sensed) if self._settings.matches else {}
        if self._settings.recognition:
            wanted.update(self._recognised(sensed))
        listed = {feature.id for features in (sensed.faces, sensed.bodies, sensed.voices) for feature in features}
        self._said = {pair: when for pair, when in self._said.items()
                      if pair[1] in listed and (pair[2] == PERSON or pair[3] in listed)}
        said: List[Statement] = []
        for pair, likelihood in wanted.items():
            if sensed.stamp - self._said.get(pair, -REPEAT_S) >= REPEAT_S:
                self._said[pair] = sensed.stamp
                said.append(Statement(*pair, likelihood))
        return said

    def _pairs(self, sensed: Sensed) -> Dict[Pair, float]:
        faces = {face.person: face for face in sensed.faces if face.measured and face.person}
        bodies = {body.person: body for body in sensed.bodies if body.measured}
        pairs: Dict[Pair, float] = {}
        for person, face in faces.items():
            if person in bodies:
                pairs[(FACE, face.id, BODY, bodies[person].id)] = self._likelihood()
            if self._chance.random() < self._settings.wrong_matches:
                other = self._nearest(face, sensed)
                if other is not None:
                    pairs[(FACE, face.id, BODY, other)] = self._chance.uniform(0.1, 0.4)
        for voice in sensed.voices:
            if not voice.speaking:
                continue
            if voice.person in faces:
                pairs[(VOICE, voice.id, FACE, faces[voice.person].id)] = self._likelihood()
            elif voice.person in bodies:
                pairs[(VOICE, voice.id, BODY, bodies[voice.person].id)] = self._likelihood()
        return pairs

    def _recognised(self, sensed: Sensed) -> Dict[Pair, float]:
        found: Dict[Pair, float] = {}
        self._since = {face.id: self._since.get(face.id, sensed.stamp) for face in sensed.faces}
        for face in sensed.faces:
            old = sensed.stamp - self._since[face.id] >= self._settings.recognition_delay
            if face.person and face.measured and old:
                found[(FACE, face.id, PERSON, face.person)] = _RECOGNISED
        return found

    def _nearest(self, face: SensedFace, sensed: Sensed) -> Optional[str]:
        """The body of another person whose head is nearest to a face."""
        others = [body for body in sensed.bodies if body.measured and body.person != face.person]
        if not others:
            return None
        return min(others, key=lambda body: float(np.linalg.norm(body.head.translation - face.pose.translation))).id

    def _likelihood(self) -> float:
        return min(1.0, max(0.0, self._chance.gauss(self._settings.match_likelihood, _SPREAD)))
