"""The persons of a scene, as a person manager would tell them, for a graph without one."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Dict, Optional, Tuple

import numpy as np
import rospy
from std_msgs.msg import Bool, Float32, String

from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.scene.scene_senses import Sensed
from hri_pipeline.ros.conversions import transform_to_msg
from hri_pipeline.ros.tf_publisher import TfPublisher
from hri_pipeline.ros.topic_lease import TopicLeases, TopicSpec
from hri_pipeline.ros.tracked_list import TrackedList

NAMESPACE = "/humans/persons"
_TEXT = TopicSpec(String, True, 10)


class ScenePersons:
    """Publishes lists, features, confidence and frames of everybody of whom something is sensed. Ids are the names of the scene."""

    def __init__(self, settings: SimpleNamespace, transforms: TfPublisher) -> None:
        """transforms: shared; its owner closes it."""
        self._settings, self._transforms = settings, transforms
        self._leases = TopicLeases(NAMESPACE, {
            "face_id": _TEXT, "body_id": _TEXT, "voice_id": _TEXT, "alias": _TEXT, "anonymous": TopicSpec(Bool, True, 10),
            "location_confidence": TopicSpec(Float32, True, 10)})
        self._tracked, self._known = TrackedList(NAMESPACE + "/tracked"), TrackedList(NAMESPACE + "/known")
        self._said: Dict[str, Dict[str, object]] = {}
        self._places: Dict[str, Pose] = {}
        self._everybody: Tuple[str, ...] = ()

    def publish(self, sensed: Sensed, stamp: rospy.Time) -> None:
        """Publish one cycle."""
        features: Dict[str, Dict[str, str]] = {}
        for name, found in (("face_id", sensed.faces), ("body_id", sensed.bodies), ("voice_id", sensed.voices)):
            for feature in found:
                if feature.person:
                    features.setdefault(feature.person, {})[name] = feature.id
        people = sorted(features)
        self._leases.keep(people)
        self._said = {person: self._said.get(person, {}) for person in people}
        self._everybody = tuple(dict.fromkeys((*self._everybody, *people)))
        self._locate(sensed)
        for person in people:
            for name in ("face_id", "body_id", "voice_id"):
                self._say(person, name, features[person].get(name, ""), String)
            self._say(person, "alias", "", String)
            self._say(person, "anonymous", False, Bool)
            self._say(person, "location_confidence", 1.0 if person in self._places else 0.0, Float32)
        self._tracked.set(people, stamp)
        self._known.set(self._everybody, stamp)
        self._transforms.send([transform_to_msg(self._places[person], stamp, self._settings.reference_frame, "person_" + person)
                               for person in people if person in self._places])

    def clear(self, stamp: rospy.Time) -> None:
        """Nobody is there any more; they stay known."""
        self._tracked.set([], stamp)
        self._leases.close_all()
        self._said.clear()
        self._places.clear()

    def close(self) -> None:
        """Publish the empty lists and take all topics back. Idempotent."""
        self._tracked.close()
        self._known.close()
        self._leases.close_all()

    def _say(self, person: str, name: str, value: object, kind: type) -> None:
        if self._said[person].get(name) != value:
            self._said[person][name] = value
            self._leases.publish(person, name, kind(value))

    def _locate(self, sensed: Sensed) -> None:
        """The face tells the place, else the head of the skeleton; who was not found in this cycle stays where he was."""
        bodies = {body.person: body.head for body in sensed.bodies if body.measured}
        faces = {face.person: face.pose for face in sensed.faces if face.measured}
        self._places = {person: pose for person, pose in self._places.items() if person in self._said}
        for person in self._said:
            pose: Optional[Pose] = faces.get(person, bodies.get(person))
            if pose is not None:
                self._places[person] = sensed.camera.compose(pose)


def upright(x: float, y: float, z: float, yaw: float) -> Pose:
    """A pose that is turned about the vertical only; m, rad."""
    cosine, sine = math.cos(yaw), math.sin(yaw)
    return Pose(np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]]), np.array([x, y, z]))
