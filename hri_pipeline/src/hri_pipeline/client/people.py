"""Faces, bodies, voices and persons as objects. Their values are read from the graph when they are asked for."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Callable, Dict, NamedTuple, Optional

import numpy as np

from hri_pipeline.client import values
from hri_pipeline.client.topics import LazyTopic
from hri_pipeline.client.values import Attitude, Demographics, Engagement, Expression, Gesture, Posture, Region
from hri_pipeline.core.geometry import Pose

if TYPE_CHECKING:
    from hri_pipeline.client.humans import Humans


class _Topic(NamedTuple):
    convert: Callable[[Any], Any]
    latched: bool = False


def _data(message: Any) -> Any:
    return message.data


class Human:
    """What faces, bodies, voices and persons have in common. It stays valid, with its last values, when it has left.

    A value is None until it has come. Latched values that the stack has published already are there at the first question;
    others come with the next image or sound after it.
    """

    KIND = ""
    FRAME = ""
    TOPICS: Dict[str, _Topic] = {}

    def __init__(self, identity: str, humans: "Humans") -> None:
        self.id = identity
        self._humans = humans
        self._topics = {name: LazyTopic("/humans/{}/{}/{}".format(self.KIND, identity, name), topic.convert, topic.latched,
                                        humans.patience) for name, topic in self.TOPICS.items()}
        self._present = True

    @property
    def present(self) -> bool:
        """Whether it is tracked now."""
        return self._present

    def pose(self, frame: str = "") -> Optional[Pose]:
        """Return where it is (m) in `frame`; None while that is not known.

        Without a frame: in the frame in which the stack publishes it, which is that of the sensor or, for a person,
        /humans/reference_frame.
        """
        return self._pose(self.FRAME, frame)

    def close(self) -> None:
        """Let go of all topics. Done by Humans when it leaves. Idempotent."""
        self._present = False
        for topic in self._topics.values():
            topic.close()
        self._humans.frames.forget(self.id)

    def _pose(self, kind: str, frame: str) -> Optional[Pose]:
        # Who has left is nowhere; to ask for their frames again would keep them for good.
        found = self._humans.frames.pose(kind, self.id, frame.lstrip("/")) if self._present else None
        return None if found is None else found[0]

    def _get(self, name: str, default: Any = None) -> Any:
        return self._topics[name].get(default)

    def __repr__(self) -> str:
        """Return kind and id."""
        return "{}({!r})".format(type(self).__name__, self.id)


class Face(Human):
    """A face. pose(): origin at the sellion, x out of the face, z to the scalp."""

    KIND, FRAME = "faces", "face"
    TOPICS = {"roi": _Topic(values.region), "landmarks": _Topic(values.landmarks), "facs": _Topic(values.action_units),
              "expression": _Topic(values.expression), "softbiometrics": _Topic(values.soft_biometrics),
              "cropped": _Topic(values.picture), "aligned": _Topic(values.picture)}

    @property
    def roi(self) -> Optional[Region]:
        """Its box in the image."""
        return self._get("roi")

    @property
    def landmarks(self) -> Optional[np.ndarray]:
        """(70, 3) x, y (0 to 1 of the image), confidence."""
        return self._get("landmarks")

    @property
    def action_units(self) -> Optional[Dict[int, float]]:
        """Intensity (0 to 1) by the number of the action unit."""
        return self._get("facs")

    @property
    def expression(self) -> Optional[Expression]:
        """What it expresses."""
        return self._get("expression")

    @property
    def demographics(self) -> Optional[Demographics]:
        """Apparent age and gender."""
        return self._get("softbiometrics")

    @property
    def cropped(self) -> Optional[np.ndarray]:
        """(H, W, 3) uint8 BGR picture of the face; made for those who ask, unless privacy settings forbid."""
        return self._get("cropped")

    @property
    def aligned(self) -> Optional[np.ndarray]:
        """The same, turned so that the eyes are level."""
        return self._get("aligned")

    def gaze(self, frame: str = "") -> Optional[Pose]:
        """Return the pose of gaze_ID: z along the gaze. None while it is not known, as with closed eyes."""
        return self._pose("gaze", frame)


class Body(Human):
    """A body. pose(): origin between the hips, x forward, z to the head."""

    KIND, FRAME = "bodies", "body"
    TOPICS = {"roi": _Topic(values.region), "skeleton2d": _Topic(values.skeleton),
              "joint_states": _Topic(values.joints), "cropped": _Topic(values.picture),
              "attitude": _Topic(lambda message: values.choice(Attitude, message.attitude)),
              "posture": _Topic(lambda message: values.choice(Posture, message.posture)),
              "gesture": _Topic(lambda message: values.choice(Gesture, message.gesture))}

    @property
    def roi(self) -> Optional[Region]:
        """Its box in the image."""
        return self._get("roi")

    @property
    def skeleton(self) -> Optional[np.ndarray]:
        """(18, 3) x, y (0 to 1 of the image), confidence, in the order of hri_msgs/Skeleton2D."""
        return self._get("skeleton2d")

    @property
    def joints(self) -> Optional[Dict[str, float]]:
        """Angle (rad) by name of the joint."""
        ending, joints = "_" + self.id, self._get("joint_states")
        return joints and {name[:-len(ending)] if name.endswith(ending) else name: angle for name, angle in joints.items()}

    @property
    def attitude(self) -> Optional[Attitude]:
        """What the arms do."""
        return self._get("attitude")

    @property
    def posture(self) -> Optional[Posture]:
        """Standing, sitting, lying ..."""
        return self._get("posture")

    @property
    def gesture(self) -> Optional[Gesture]:
        """What the hands do."""
        return self._get("gesture")

    @property
    def cropped(self) -> Optional[np.ndarray]:
        """(H, W, 3) uint8 BGR picture of the body; made for those who ask."""
        return self._get("cropped")

    def link(self, name: str, frame: str = "") -> Optional[Pose]:
        """Return the pose of a link of the skeleton, for instance head, l_wrist or torso."""
        return self._pose(name, frame)


class Voice(Human):
    """A voice. pose(): in the direction that it comes from; its orientation means nothing."""

    KIND, FRAME = "voices", "voice"
    TOPICS = {"is_speaking": _Topic(_data, True), "speech": _Topic(values.speech),
              "features": _Topic(values.audio_features)}

    @property
    def is_speaking(self) -> Optional[bool]:
        """Whether it speaks now."""
        return self._get("is_speaking")

    @property
    def speech(self) -> Optional[str]:
        """What it has said last."""
        return self._get("speech")

    @property
    def features(self) -> Optional[Dict[str, float]]:
        """The 16 descriptors of its sound, by name."""
        return self._get("features")


class Person(Human):
    """A person, who keeps the id whatever is seen. pose(): that of face, head or voice, or the last known place."""

    KIND, FRAME = "persons", "person"
    TOPICS = {"face_id": _Topic(_data, True), "body_id": _Topic(_data, True), "voice_id": _Topic(_data, True),
              "name": _Topic(_data, True), "native_language": _Topic(_data, True), "alias": _Topic(_data, True),
              "anonymous": _Topic(_data, True), "location_confidence": _Topic(_data, True),
              "demographics": _Topic(values.demographics, True),
              "engagement_status": _Topic(lambda message: values.choice(Engagement, message.level), True)}

    @property
    def face(self) -> Optional[Face]:
        """The face that is seen of this person now."""
        return self._humans.faces.get(self._get("face_id", ""))

    @property
    def body(self) -> Optional[Body]:
        """The body that is seen of this person now."""
        return self._humans.bodies.get(self._get("body_id", ""))

    @property
    def voice(self) -> Optional[Voice]:
        """The voice that is heard of this person now."""
        return self._humans.voices.get(self._get("voice_id", ""))

    @property
    def name(self) -> str:
        """The name that somebody has given; empty without one."""
        return self._get("name", "")

    @property
    def native_language(self) -> str:
        """IETF tag, for instance en-GB; empty where not known."""
        return self._get("native_language", "")

    @property
    def alias(self) -> str:
        """The id that this person goes by since two turned out to be one; empty while it is its own."""
        return self._get("alias", "")

    @property
    def anonymous(self) -> bool:
        """Whether no recogniser has confirmed yet who this is."""
        return self._get("anonymous", True)

    @property
    def location_confidence(self) -> float:
        """1 while seen or heard, less with time, 0 when it is not known any more where the person is."""
        return self._get("location_confidence", 0.0)

    @property
    def demographics(self) -> Optional[Demographics]:
        """Apparent age and gender, from all that was seen of this person."""
        return self._get("demographics")

    @property
    def engagement(self) -> Engagement:
        """How far this person is engaged with the robot."""
        return self._get("engagement_status", Engagement.UNKNOWN)

    @property
    def looks_at(self) -> Optional[str]:
        """Id of the person whom this one looks at, "" for the robot; None for nobody."""
        return next((gaze.receiver for gaze in self._humans.gazes if gaze.sender == self.id), None)

    @property
    def looks_at_robot(self) -> bool:
        """Whether this person looks at the robot now."""
        return self.looks_at == values.ROBOT
