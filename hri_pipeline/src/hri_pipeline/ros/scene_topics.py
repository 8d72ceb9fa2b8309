"""A simulated scene on topics and frames: features as of real detectors, persons as of a person manager, and the
truth."""

from __future__ import annotations

import math
import zlib
from typing import Dict, Iterable, List, Optional, Sequence, Tuple

import numpy as np
import rospy
from geometry_msgs.msg import Pose as PoseMessage
from geometry_msgs.msg import PoseArray, TransformStamped
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Bool, Float32, Header, String

from hri_msgs.msg import (
    AudioFeatures,
    FacialActionUnits,
    FacialLandmarks,
    GazeSenderReceiver,
    GazesStamped,
    Group,
    GroupsStamped,
    IdsList,
    IdsMatch,
    Skeleton2D,
)
from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces.gaze import gaze_frame
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.simulation.agents import box, keypoints, landmarks
from hri_pipeline.core.simulation.parameters import SceneSettings
from hri_pipeline.core.simulation.sensors import (
    BODIES,
    BODY,
    FACE,
    FACES,
    PERSON,
    VOICE,
    VOICES,
    Sensed,
    SensedBody,
    SensedFace,
    SensedVoice,
    Statement,
)
from hri_pipeline.core.simulation.world import PersonTruth, SceneTruth
from hri_pipeline.core.timing import StampPacer
from hri_pipeline.core.tracks import COLOUR_BINS
from hri_pipeline.ros.conversions import (
    action_units_to_msg,
    camera_info,
    landmarks_to_msg,
    match_to_msg,
    matrix_to_image,
    published_gaze,
    roi_message,
    roi_type,
    skeleton_to_msg,
    transform_to_msg,
)
from hri_pipeline.ros.publishers import MATCHES_TOPIC, IdPublishers, TopicSpec, TrackedList
from hri_pipeline.ros.rospy_compat import release
from hri_pipeline.ros.tf import TfPublisher

_KINDS = {FACE: IdsMatch.FACE, BODY: IdsMatch.BODY, VOICE: IdsMatch.VOICE, PERSON: IdsMatch.PERSON}
VOICE_DISTANCE = 1.0
"""A direction alone has no distance: the frame of a voice is so many metres from the microphone."""
_MICROPHONE = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""From the optical frame to the microphone's: x forward, y left, z up."""
_EYES, _LIPS, _JAW = FacialActionUnits.BLINK, FacialActionUnits.LIPS_PART, FacialActionUnits.JAW_DROP
_APPEARANCE_HZ = 1.0
_GARMENTS = (0, 0, 0, 1, 1)        # of chest, belly, sleeves, thighs, shins
_SYLLABLES = 4.0    # per second; the jaw goes with them


class SceneFeatures:
    """Publishes what the senses say. settings: the values of SCENE_PARAMETERS."""

    def __init__(self, settings: SceneSettings, transforms: TfPublisher) -> None:
        """transforms: shared; its owner closes it."""
        self._settings, self._transforms = settings, transforms
        self._camera = CameraModel.from_fov(settings.width, settings.height, math.radians(settings.sense_hfov))
        roi = TopicSpec(roi_type(settings.interface))
        self._publishers = {
            FACES: IdPublishers("/humans/faces", {"roi": roi, "landmarks": TopicSpec(FacialLandmarks),
                                                  "facs": TopicSpec(FacialActionUnits)}),
            BODIES: IdPublishers("/humans/bodies", {"roi": roi, "skeleton2d": TopicSpec(Skeleton2D),
                                                    "appearance": TopicSpec(Image)}),
            VOICES: IdPublishers("/humans/voices", {"is_speaking": TopicSpec(Bool, latch=True),
                                                    "features": TopicSpec(AudioFeatures)})}
        self._lists = {kind: TrackedList("/humans/{}/tracked".format(kind)) for kind in self._publishers}
        self._speaking = {}
        self._dressed = StampPacer(_APPEARANCE_HZ)
        self._matches = rospy.Publisher(MATCHES_TOPIC, IdsMatch, queue_size=200)
        self._info = rospy.Publisher("camera_info", CameraInfo, queue_size=1)
        self._closed = False

    def publish(self, sensed: Sensed, stamp: rospy.Time) -> None:
        """Publish one cycle; only what is fresh is sent with this stamp."""
        header = Header(stamp=stamp, frame_id=self._settings.camera_frame)
        if self._info.get_num_connections():
            self._info.publish(camera_info(self._camera.width, self._camera.height,
                                           math.radians(self._settings.sense_hfov), header))
        features = {FACES: sensed.faces, BODIES: sensed.bodies, VOICES: sensed.voices}
        frames: List[TransformStamped] = []
        for kind in sensed.fresh:
            ids = [feature.id for feature in features[kind]]
            self._publishers[kind].keep(ids)
            self._lists[kind].set(ids, stamp)
        for face in sensed.faces if FACES in sensed.fresh else ():
            if face.measured:
                frames += self._face_frames(face, header)
                self._publish_face(face, header, sensed.stamp)
        shows_clothes = BODIES in sensed.fresh and self._dressed.is_due(sensed.stamp)
        for body in sensed.bodies if BODIES in sensed.fresh else ():
            if body.measured:
                frames += self._body_frames(body, header)
                self._publish_body(body, header)
                if shows_clothes and self._publishers[BODIES].has_subscribers(body.id, "appearance"):
                    self._publishers[BODIES].publish(body.id, "appearance", matrix_to_image(
                        clothes(body.person or body.id), header))
        for voice in sensed.voices if VOICES in sensed.fresh else ():
            frames += self._publish_voice(voice, header, sensed.stamp)
        self._speaking = {identity: said for identity, said in self._speaking.items()
                          if any(voice.id == identity for voice in sensed.voices)}
        self._transforms.send(frames)

    def publish_matches(self, statements: Sequence[Statement]) -> None:
        """Publish candidate matches."""
        for said in statements:
            self._matches.publish(match_to_msg(said.first, _KINDS[said.first_kind], said.second,
                                               _KINDS[said.second_kind],
                                               said.likelihood))

    def listeners(self) -> int:
        """Return how many listen to the matches."""
        return self._matches.get_num_connections()

    def clear(self, stamp: rospy.Time) -> None:
        """Nobody is there any more."""
        for kind, publishers in self._publishers.items():
            self._lists[kind].set([], stamp)
            publishers.close_all()
        self._speaking.clear()
        self._dressed.reset()

    def close(self) -> None:
        """Publish the empty lists and take all topics back. Idempotent."""
        if self._closed:
            return
        self._closed = True
        for kind, publishers in self._publishers.items():
            self._lists[kind].close()
            publishers.close_all()
        release(self._matches)
        release(self._info)

    def _face_frames(self, face: SensedFace, header: Header) -> List[TransformStamped]:
        name = "face_" + face.id
        frames = [transform_to_msg(face.pose, header.stamp, header.frame_id, name)]
        direction = published_gaze(face.pose, face.gaze, self._settings.interface)
        if direction is not None:
            frames.append(transform_to_msg(gaze_frame(face.pose, direction), header.stamp, name, "gaze_" + face.id))
        return frames

    def _body_frames(self, body: SensedBody, header: Header) -> List[TransformStamped]:
        """body_ID and, as a skeleton's state publisher would, head_ID below it."""
        name = "body_" + body.id
        return [transform_to_msg(body.pose, header.stamp, header.frame_id, name),
                transform_to_msg(body.pose.inverse().compose(body.head), header.stamp, name, "head_" + body.id)]

    def _publish_face(self, face: SensedFace, header: Header, now: float) -> None:
        publishers, width, height = self._publishers[FACES], self._camera.width, self._camera.height
        mouth = 0.5 - 0.5 * math.cos(2.0 * math.pi * _SYLLABLES * now) if face.speaking else 0.0
        if publishers.has_subscribers(face.id, "roi") or publishers.has_subscribers(face.id, "landmarks"):
            points = landmarks(face.pose, self._camera, face.eyes_closed, mouth)
            publishers.publish(face.id, "landmarks", landmarks_to_msg(points, header, width, height))
            publishers.publish(face.id, "roi", roi_message(box(points, 0.1), width, height, self._settings.interface,
                                                           header, 0.9))
        if publishers.has_subscribers(face.id, "facs"):
            intensity, confidence = np.zeros(99), np.zeros(99)
            confidence[[_EYES, _LIPS, _JAW]] = 0.8
            intensity[_EYES], intensity[_LIPS], intensity[_JAW] = face.eyes_closed, min(1.0, 1.5 * mouth), 0.6 * mouth
            publishers.publish(face.id, "facs", action_units_to_msg(intensity, confidence, header))

    def _publish_body(self, body: SensedBody, header: Header) -> None:
        publishers, width, height = self._publishers[BODIES], self._camera.width, self._camera.height
        if publishers.has_subscribers(body.id, "roi") or publishers.has_subscribers(body.id, "skeleton2d"):
            points = keypoints(body.pose, body.head, body.stature, self._camera)
            publishers.publish(body.id, "skeleton2d", skeleton_to_msg(points, header, width, height))
            publishers.publish(body.id, "roi", roi_message(box(points, 0.08), width, height, self._settings.interface,
                                                           header, 0.9))

    def _publish_voice(self, voice: SensedVoice, header: Header, now: float) -> List[TransformStamped]:
        publishers = self._publishers[VOICES]
        if self._speaking.get(voice.id) != voice.speaking:
            self._speaking[voice.id] = voice.speaking
            publishers.publish(voice.id, "is_speaking", Bool(voice.speaking))
        if not voice.speaking or voice.direction is None:
            return []
        if publishers.has_subscribers(voice.id, "features"):
            publishers.publish(voice.id, "features", _sound(voice.id, now))
        place = Pose(np.eye(3), VOICE_DISTANCE * (_MICROPHONE @ voice.direction))
        return [transform_to_msg(place, header.stamp, self._settings.microphone_frame, "voice_" + voice.id)]


def clothes(wearer: str) -> np.ndarray:
    """Histograms (5, 21) of the colours of what somebody wears all the time, as the node `bodies` tells them: lightness
    and both axes of colour, 7 bins each; a top and trousers, chosen at random by the wearer's name."""
    random = np.random.default_rng(zlib.crc32(wearer.encode()))
    rows = []
    for _ in range(2):
        parts = [np.exp(-0.5 * ((bins - random.uniform(0.8 * bins[0], 0.8 * bins[-1])) / (0.1 * np.ptp(bins))) ** 2)
                 for bins in COLOUR_BINS]
        rows.append(np.concatenate([part / part.sum() for part in parts]) / 3.0)
    return np.stack([rows[garment] for garment in _GARMENTS])


def _sound(identity: str, now: float) -> AudioFeatures:
    """Features of a vowel-like voiced sound whose loudness goes with the syllables; each voice has its own pitch."""
    pitch = (110.0 + 10.0 * (sum(identity.encode()) % 12)) * (1.0 + 0.05 * math.sin(2.0 * math.pi * 0.7 * now))
    loud = 0.02 + 0.06 * abs(math.sin(math.pi * _SYLLABLES * now))
    shape = [14.0, -6.0, 3.0, -9.0, -4.0, 1.0, -5.0, 2.0, -3.0, 0.5, -1.0, 0.8]
    return AudioFeatures(ZCR=2.0 * pitch / 16000.0 * 6.0, RMS=loud, pitch=pitch / 500.0, HNR=12.0,
                         MFCC=[value * (0.8 + 4.0 * loud) for value in shape])


_TRUTH = "/scene/truth"
_LISTS = ("persons", "visible", "speaking", "eyes_closed")
_TYPES = {"heads": PoseArray, "bodies": PoseArray, "gaze": GazesStamped, "groups": GroupsStamped}


class SceneTruthTopics:
    """Publishes the truth. heads and bodies have the order of `persons`; all messages of a cycle have one stamp."""

    def __init__(self, frame: str, script: str) -> None:
        """frame: of the positions. script: text of the scene, latched."""
        self._frame = frame
        types = {**{name: IdsList for name in _LISTS}, **_TYPES}
        self._publishers = {name: rospy.Publisher("{}/{}".format(_TRUTH, name), kind, queue_size=50)
                            for name, kind in types.items()}
        self._script = rospy.Publisher(_TRUTH + "/script", String, queue_size=1, latch=True)
        self._script.publish(String(script))

    def publish(self, truth: SceneTruth, visible: Iterable[str], stamp: rospy.Time) -> None:
        """Publish one cycle. visible: people whom the sensors could see."""
        if not any(publisher.get_num_connections() for publisher in self._publishers.values()):
            return
        header = Header(stamp=stamp, frame_id=self._frame)
        people = truth.people
        self._send("persons", IdsList(header, [person.id for person in people]))
        self._send("visible", IdsList(header, sorted(visible)))
        self._send("speaking", IdsList(header, [person.id for person in people if person.speaking]))
        self._send("eyes_closed", IdsList(header, [person.id for person in people if person.eyes_closed]))
        self._send("heads", PoseArray(header, [_pose(Pose(person.head_rotation, person.head)) for person in people]))
        self._send("bodies", PoseArray(header, [_standing(person) for person in people]))
        self._send("gaze", GazesStamped(header, [GazeSenderReceiver(person.id, person.target, 1.0) for person in people
                                                 if person.target is not None]))
        self._send("groups", GroupsStamped(header,
                                           [Group(header, group.id, list(group.members)) for group in truth.groups],
                                           [1.0] * len(truth.groups)))

    def close(self) -> None:
        """Take the topics back. Idempotent."""
        for publisher in (*self._publishers.values(), self._script):
            release(publisher)

    def _send(self, name: str, message: object) -> None:
        self._publishers[name].publish(message)


def _pose(pose: Pose) -> PoseMessage:
    message = PoseMessage()
    message.position.x, message.position.y, message.position.z = pose.translation.tolist()
    turn = message.orientation
    turn.x, turn.y, turn.z, turn.w = pose.quaternion
    return message


def _standing(person: PersonTruth) -> PoseMessage:
    message = PoseMessage()
    message.position.x, message.position.y = (float(value) for value in person.position)
    message.orientation.z, message.orientation.w = _half(person.yaw)
    return message


def _half(yaw: float) -> Tuple[float, float]:
    return math.sin(yaw / 2.0), math.cos(yaw / 2.0)


_PERSONS = "/humans/persons"
_TEXT = TopicSpec(String, True, 10)


class ScenePersons:
    """Publishes lists, features, confidence and frames of everybody of whom something is sensed.

    Ids are the names of the scene.
    """

    def __init__(self, settings: SceneSettings, transforms: TfPublisher) -> None:
        """transforms: shared; its owner closes it."""
        self._settings, self._transforms = settings, transforms
        self._publishers = IdPublishers(_PERSONS, {
            "face_id": _TEXT, "body_id": _TEXT, "voice_id": _TEXT, "alias": _TEXT,
            "anonymous": TopicSpec(Bool, True, 10),
            "location_confidence": TopicSpec(Float32, True, 10)})
        self._tracked, self._known = TrackedList(_PERSONS + "/tracked"), TrackedList(_PERSONS + "/known")
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
        self._publishers.keep(people)
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
        self._transforms.send([transform_to_msg(self._places[person], stamp, self._settings.reference_frame,
                                                "person_" + person)
                               for person in people if person in self._places])

    def clear(self, stamp: rospy.Time) -> None:
        """Nobody is there any more; they stay known."""
        self._tracked.set([], stamp)
        self._publishers.close_all()
        self._said.clear()
        self._places.clear()

    def close(self) -> None:
        """Publish the empty lists and take all topics back. Idempotent."""
        self._tracked.close()
        self._known.close()
        self._publishers.close_all()

    def _say(self, person: str, name: str, value: object, kind: type) -> None:
        if self._said[person].get(name) != value:
            self._said[person][name] = value
            self._publishers.publish(person, name, kind(value))

    def _locate(self, sensed: Sensed) -> None:
        """The face tells the place, else the head of the skeleton; who was not found in this cycle stays where he
        was."""
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
