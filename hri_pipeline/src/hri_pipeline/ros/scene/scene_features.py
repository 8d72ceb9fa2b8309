"""The faces, bodies and voices of a scene on the topics and frames of real detectors."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import List, Sequence

import numpy as np
import rospy
from geometry_msgs.msg import TransformStamped
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Bool, Header

from hri_msgs.msg import AudioFeatures, FacialActionUnits, FacialLandmarks, IdsMatch, Skeleton2D
from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces.gaze import gaze_frame
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.scene.scene_matches import BODY, FACE, PERSON, VOICE, Statement
from hri_pipeline.core.scene.scene_projection import box, keypoints, landmarks
from hri_pipeline.core.scene.scene_senses import BODIES, FACES, VOICES, Sensed, SensedBody, SensedFace, SensedVoice
from hri_pipeline.ros.conversions import (
    action_units_to_msg,
    landmarks_to_msg,
    match_to_msg,
    skeleton_to_msg,
    transform_to_msg,
)
from hri_pipeline.ros.interface import roi_message, roi_type
from hri_pipeline.ros.pictures.image_source_node import camera_info
from hri_pipeline.ros.tf_publisher import TfPublisher
from hri_pipeline.ros.topic_lease import TopicLeases, TopicSpec
from hri_pipeline.ros.topic_release import release
from hri_pipeline.ros.tracked_list import TrackedList

_KINDS = {FACE: IdsMatch.FACE, BODY: IdsMatch.BODY, VOICE: IdsMatch.VOICE, PERSON: IdsMatch.PERSON}
VOICE_DISTANCE = 1.0
"""A direction alone has no distance: the frame of a voice is so many metres from the microphone."""
_MICROPHONE = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""From the optical frame to the microphone's: x forward, y left, z up."""
_EYES, _LIPS, _JAW = FacialActionUnits.BLINK, FacialActionUnits.LIPS_PART, FacialActionUnits.JAW_DROP
_SYLLABLES = 4.0    # per second; the jaw goes with them


class SceneFeatures:
    """Publishes what the senses say. settings: the values of scene_parameters.SCENE_PARAMETERS."""

    def __init__(self, settings: SimpleNamespace, transforms: TfPublisher) -> None:
        """transforms: shared; its owner closes it."""
        self._settings, self._transforms = settings, transforms
        self._camera = CameraModel.from_fov(settings.width, settings.height, math.radians(settings.sense_hfov))
        roi = TopicSpec(roi_type(settings.interface))
        self._leases = {
            FACES: TopicLeases("/humans/faces", {"roi": roi, "landmarks": TopicSpec(FacialLandmarks),
                                                 "facs": TopicSpec(FacialActionUnits)}),
            BODIES: TopicLeases("/humans/bodies", {"roi": roi, "skeleton2d": TopicSpec(Skeleton2D)}),
            VOICES: TopicLeases("/humans/voices", {"is_speaking": TopicSpec(Bool, latch=True),
                                                   "features": TopicSpec(AudioFeatures)})}
        self._lists = {kind: TrackedList("/humans/{}/tracked".format(kind)) for kind in self._leases}
        self._speaking = {}
        self._matches = rospy.Publisher("/humans/candidate_matches", IdsMatch, queue_size=200)
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
            self._leases[kind].keep(ids)
            self._lists[kind].set(ids, stamp)
        for face in sensed.faces if FACES in sensed.fresh else ():
            if face.measured:
                frames += self._face_frames(face, header)
                self._publish_face(face, header, sensed.stamp)
        for body in sensed.bodies if BODIES in sensed.fresh else ():
            if body.measured:
                frames += self._body_frames(body, header)
                self._publish_body(body, header)
        for voice in sensed.voices if VOICES in sensed.fresh else ():
            frames += self._publish_voice(voice, header, sensed.stamp)
        self._speaking = {identity: said for identity, said in self._speaking.items()
                          if any(voice.id == identity for voice in sensed.voices)}
        self._transforms.send(frames)

    def publish_matches(self, statements: Sequence[Statement]) -> None:
        """Publish candidate matches."""
        for said in statements:
            self._matches.publish(match_to_msg(said.first, _KINDS[said.first_kind], said.second, _KINDS[said.second_kind],
                                               said.likelihood))

    def listeners(self) -> int:
        """Return how many listen to the matches."""
        return self._matches.get_num_connections()

    def clear(self, stamp: rospy.Time) -> None:
        """Nobody is there any more."""
        for kind, leases in self._leases.items():
            self._lists[kind].set([], stamp)
            leases.close_all()
        self._speaking.clear()

    def close(self) -> None:
        """Publish the empty lists and take all topics back. Idempotent."""
        if self._closed:
            return
        self._closed = True
        for kind, leases in self._leases.items():
            self._lists[kind].close()
            leases.close_all()
        release(self._matches)
        release(self._info)

    def _face_frames(self, face: SensedFace, header: Header) -> List[TransformStamped]:
        name = "face_" + face.id
        frames = [transform_to_msg(face.pose, header.stamp, header.frame_id, name)]
        if face.gaze is not None:
            frames.append(transform_to_msg(gaze_frame(face.pose, face.gaze), header.stamp, name, "gaze_" + face.id))
        return frames

    def _body_frames(self, body: SensedBody, header: Header) -> List[TransformStamped]:
        """body_ID and, as a skeleton's state publisher would, head_ID below it."""
        name = "body_" + body.id
        return [transform_to_msg(body.pose, header.stamp, header.frame_id, name),
                transform_to_msg(body.pose.inverse().compose(body.head), header.stamp, name, "head_" + body.id)]

    def _publish_face(self, face: SensedFace, header: Header, now: float) -> None:
        leases, width, height = self._leases[FACES], self._camera.width, self._camera.height
        mouth = 0.5 - 0.5 * math.cos(2.0 * math.pi * _SYLLABLES * now) if face.speaking else 0.0
        if leases.has_subscribers(face.id, "roi") or leases.has_subscribers(face.id, "landmarks"):
            points = landmarks(face.pose, self._camera, face.eyes_closed, mouth)
            leases.publish(face.id, "landmarks", landmarks_to_msg(points, header, width, height))
            leases.publish(face.id, "roi", roi_message(box(points, 0.1), width, height, self._settings.interface, header, 0.9))
        if leases.has_subscribers(face.id, "facs"):
            intensity, confidence = np.zeros(99), np.zeros(99)
            confidence[[_EYES, _LIPS, _JAW]] = 0.8
            intensity[_EYES], intensity[_LIPS], intensity[_JAW] = face.eyes_closed, min(1.0, 1.5 * mouth), 0.6 * mouth
            leases.publish(face.id, "facs", action_units_to_msg(intensity, confidence, header))

    def _publish_body(self, body: SensedBody, header: Header) -> None:
        leases, width, height = self._leases[BODIES], self._camera.width, self._camera.height
        if leases.has_subscribers(body.id, "roi") or leases.has_subscribers(body.id, "skeleton2d"):
            points = keypoints(body.pose, body.head, body.stature, self._camera)
            leases.publish(body.id, "skeleton2d", skeleton_to_msg(points, header, width, height))
            leases.publish(body.id, "roi", roi_message(box(points, 0.08), width, height, self._settings.interface, header, 0.9))

    def _publish_voice(self, voice: SensedVoice, header: Header, now: float) -> List[TransformStamped]:
        leases = self._leases[VOICES]
        if self._speaking.get(voice.id) != voice.speaking:
            self._speaking[voice.id] = voice.speaking
            leases.publish(voice.id, "is_speaking", Bool(voice.speaking))
        if not voice.speaking or voice.direction is None:
            return []
        if leases.has_subscribers(voice.id, "features"):
            leases.publish(voice.id, "features", _sound(voice.id, now))
        place = Pose(np.eye(3), VOICE_DISTANCE * (_MICROPHONE @ voice.direction))
        return [transform_to_msg(place, header.stamp, self._settings.microphone_frame, "voice_" + voice.id)]


def _sound(identity: str, now: float) -> AudioFeatures:
    """Features of a vowel-like voiced sound whose loudness goes with the syllables; each voice has its own pitch."""
    pitch = (110.0 + 10.0 * (sum(identity.encode()) % 12)) * (1.0 + 0.05 * math.sin(2.0 * math.pi * 0.7 * now))
    loud = 0.02 + 0.06 * abs(math.sin(math.pi * _SYLLABLES * now))
    shape = [14.0, -6.0, 3.0, -9.0, -4.0, 1.0, -5.0, 2.0, -3.0, 0.5, -1.0, 0.8]
    return AudioFeatures(ZCR=2.0 * pitch / 16000.0 * 6.0, RMS=loud, pitch=pitch / 500.0, HNR=12.0,
                         MFCC=[value * (0.8 + 4.0 * loud) for value in shape])
