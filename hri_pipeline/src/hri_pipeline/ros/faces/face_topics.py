"""The topics of one face, /humans/faces/ID/..., and who listens to them."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Iterable, Sequence, Set

import rospy
from sensor_msgs.msg import Image

from hri_msgs.msg import Expression, FacialActionUnits, FacialLandmarks, IdsMatch, SoftBiometrics
from hri_pipeline.core.faces.face_analysis import FaceDemand
from hri_pipeline.core.observations import FaceObservation
from hri_pipeline.core.recognition.face_identity import Match, SamePersons
from hri_pipeline.ros.conversions import (
    action_units_to_msg,
    expression_to_msg,
    landmarks_to_msg,
    match_to_msg,
    soft_biometrics_to_msg,
)
from hri_pipeline.ros.faces.face_pictures import ALIGNED, CROPPED, FacePictures
from hri_pipeline.ros.image_intake import Frame
from hri_pipeline.ros.interface import roi_message, roi_type
from hri_pipeline.ros.topic_lease import TopicLeases, TopicSpec
from hri_pipeline.ros.topic_release import release

NAMESPACE = "/humans/faces"
MATCHES_TOPIC = "/humans/candidate_matches"
_ANALYSIS = {"facs": ("action_units", FacialActionUnits), "expression": ("expression", Expression),
             "softbiometrics": ("age_gender", SoftBiometrics)}
"""Topic: the parameter that switches it, its type."""


class FaceTopics:
    """Publishes observations of faces; a topic whose stage is switched off is not there."""

    def __init__(self, settings: SimpleNamespace) -> None:
        """settings: the values of face_parameters.FACES."""
        self._interface = settings.interface
        specs = {"roi": TopicSpec(roi_type(settings.interface)), "landmarks": TopicSpec(FacialLandmarks),
                 CROPPED: TopicSpec(Image), ALIGNED: TopicSpec(Image)}
        self._analysis = [name for name, (switch, _) in _ANALYSIS.items() if getattr(settings, switch)]
        specs.update({name: TopicSpec(_ANALYSIS[name][1]) for name in self._analysis})
        self._leases = TopicLeases(NAMESPACE, specs)
        self._pictures = FacePictures(self._leases)
        self._matches = rospy.Publisher(MATCHES_TOPIC, IdsMatch, queue_size=100) if settings.recognition else None

    def keep(self, ids: Iterable[str]) -> None:
        """Advertise the topics of these faces and take those of all others back."""
        self._leases.keep(ids)

    def demand(self, ids: Sequence[str]) -> FaceDemand:
        """Return what somebody listens to of these faces."""
        listened = {name: self._listened(name, ids) for name in _ANALYSIS}
        matched = self._matches is not None and self._matches.get_num_connections() > 0
        return FaceDemand(listened["facs"], listened["expression"], listened["softbiometrics"], matched)

    def publish(self, face: FaceObservation, frame: Frame) -> None:
        """Publish all that is known of one face and that is listened to."""
        height, width = frame.bgr.shape[:2]
        header, leases = frame.header, self._leases
        if leases.has_subscribers(face.id, "roi"):
            leases.publish(face.id, "roi", roi_message(face.box, width, height, self._interface, header, face.score))
        if leases.has_subscribers(face.id, "landmarks"):
            leases.publish(face.id, "landmarks", landmarks_to_msg(face.landmarks, header, width, height))
        if face.measured:
            self._pictures.publish(face, frame)
        if face.action_units is not None:
            leases.publish(face.id, "facs", action_units_to_msg(
                face.action_units.intensity, face.action_units.confidence, header))
        if face.expression is not None:
            said = face.expression
            leases.publish(face.id, "expression", expression_to_msg(
                said.category, said.valence, said.arousal, said.confidence, header))
        if face.soft_biometrics is not None:
            leases.publish(face.id, "softbiometrics", soft_biometrics_to_msg(face.soft_biometrics, header))

    def publish_matches(self, matches: Sequence[Match]) -> None:
        """Publish which faces are of which persons; likelihood 0 withdraws."""
        if self._matches is None:
            return
        for match in matches:
            self._matches.publish(match_to_msg(match.face_id, IdsMatch.FACE, match.person_id, IdsMatch.PERSON,
                                               match.likelihood))

    def publish_same_persons(self, pairs: Sequence[SamePersons]) -> None:
        """Publish which persons are one human; likelihood 0 withdraws."""
        if self._matches is None:
            return
        for pair in pairs:
            self._matches.publish(match_to_msg(pair.other, IdsMatch.PERSON, pair.kept, IdsMatch.PERSON, pair.likelihood))

    def matches_listeners(self) -> int:
        """Return how many listen to the matches."""
        return self._matches.get_num_connections() if self._matches is not None else 0

    def close_ids(self) -> None:
        """Take the topics of all faces back."""
        self._leases.close_all()

    def close(self) -> None:
        """Take everything back. Idempotent."""
        self._leases.close_all()
        if self._matches is not None:
            release(self._matches)
            self._matches = None

    def _listened(self, name: str, ids: Sequence[str]) -> Set[str]:
        if name not in self._analysis:
            return set()
        return {face_id for face_id in ids if self._leases.has_subscribers(face_id, name)}
