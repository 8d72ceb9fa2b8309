"""The topics of each voice, /humans/voices/ID/..., published while somebody subscribes to them."""

from __future__ import annotations

from collections import deque
from typing import Deque, Dict, Iterable, List

import numpy as np
import rospy
from audio_common_msgs.msg import AudioData
from std_msgs.msg import Bool

from hri_msgs.msg import AudioFeatures
from hri_pipeline.core.asr.recognition import SpeechResult
from hri_pipeline.core.audio.features import AudioFeatureExtractor
from hri_pipeline.core.audio.parameters import VoicesSettings
from hri_pipeline.core.audio.pipeline import VoiceObservation
from hri_pipeline.core.audio.stream import RATE, encode_s16
from hri_pipeline.ros.conversions import audio_features_to_msg, make_header, speech_message, speech_type
from hri_pipeline.ros.publishers import IdPublishers, TopicSpec

NAMESPACE = "/humans/voices"
_LOG_PERIOD_S = 10.0
AUDIO, FEATURES, IS_SPEAKING, SPEECH = "audio", "features", "is_speaking", "speech"


class _Backlog:
    """The last `seconds` of sound of a voice, for its first subscriber. Nothing is stored after that."""

    def __init__(self, seconds: float) -> None:
        self._most = int(seconds * RATE)
        self._parts: Deque[np.ndarray] = deque()
        self._held = 0
        self.is_open = self._most > 0

    def add(self, samples: np.ndarray) -> None:
        """Add samples (n,) and drop the oldest ones."""
        self._parts.append(samples)
        self._held += len(samples)
        while self._held - len(self._parts[0]) >= self._most:
            self._held -= len(self._parts.popleft())

    def take(self) -> List[np.ndarray]:
        """Return what is stored, which is nothing from the second time on."""
        parts, self._parts, self.is_open = list(self._parts), deque(), False
        return parts


class VoiceTopics:
    """Publishes observations of voices. Topics that are switched off are not advertised.

    Parameters
    ----------
    settings : VoicesSettings
    speech : bool
        Whether there is a topic `speech`.
    """

    def __init__(self, settings: VoicesSettings, speech: bool) -> None:
        self._settings = settings
        specs = {AUDIO: TopicSpec(AudioData, queue_size=100), IS_SPEAKING: TopicSpec(Bool, latch=True)}
        if settings.features:
            specs[FEATURES] = TopicSpec(AudioFeatures, queue_size=200)
        if speech:
            specs[SPEECH] = TopicSpec(speech_type(settings.interface), queue_size=20, greet=True)
        self._publishers = IdPublishers(NAMESPACE, specs)
        self._speaking: Dict[str, bool] = {}
        self._backlogs: Dict[str, _Backlog] = {}
        self._extractors: Dict[str, AudioFeatureExtractor] = {}

    def retain(self, ids: Iterable[str]) -> None:
        """Advertise the topics of these voices and remove those of all others.

        Topics that cannot be opened are tried again with the next sound.
        """
        wanted = sorted(ids)
        for identity in {*self._publishers.ids, *self._backlogs}.difference(wanted):
            self._forget(identity)
        if wanted == sorted(self._publishers.ids):
            return
        try:
            self._publishers.keep(wanted)
        except (OSError, rospy.ROSException) as error:
            rospy.logerr_throttle(_LOG_PERIOD_S, "topics of a voice: %s; trying again", error)

    def publish(self, observation: VoiceObservation) -> None:
        """Publish one observation on the topics of its voice that have subscribers."""
        identity = observation.id
        if self._speaking.get(identity) != observation.speaking and self._publishers.publish(
                identity, IS_SPEAKING, Bool(observation.speaking)):
            self._speaking[identity] = observation.speaking
        if len(observation.samples):
            self._publish_audio(identity, observation.samples)
            self._publish_features(identity, observation)

    def publish_speech(self, result: SpeechResult) -> bool:
        """Publish what a voice has said. Return False when the voice has no topics any more."""
        header = make_header(result.stamp, self._settings.frame_id)
        return self._publishers.publish(result.voice_id, SPEECH,
                                        speech_message(result, self._settings.interface, header))

    def close_ids(self) -> None:
        """Remove the topics of all voices."""
        self.retain(())

    def reconfigure(self, settings: VoicesSettings) -> None:
        """Take up the values of the live parameters; the features of all voices start again, with the new rate."""
        self._settings = settings
        self._extractors.clear()

    def _forget(self, identity: str) -> None:
        if self._speaking.pop(identity, False):
            self._publishers.publish(identity, IS_SPEAKING, Bool(False))
        self._backlogs.pop(identity, None)
        self._extractors.pop(identity, None)

    def _publish_audio(self, identity: str, samples: np.ndarray) -> None:
        backlog = self._backlogs.get(identity)
        if backlog is None:
            backlog = self._backlogs[identity] = _Backlog(self._settings.audio_backlog)
        if not self._publishers.has_subscribers(identity, AUDIO):
            if backlog.is_open:
                backlog.add(samples)
            return
        parts = backlog.take() + [samples]
        self._publishers.publish(identity, AUDIO, AudioData(data=encode_s16(np.concatenate(parts))))

    def _publish_features(self, identity: str, observation: VoiceObservation) -> None:
        if not self._publishers.has_subscribers(identity, FEATURES):
            self._extractors.pop(identity, None)
            return
        extractor = self._extractors.get(identity)
        if extractor is None:
            extractor = self._extractors[identity] = AudioFeatureExtractor(self._settings.features_rate)
        for frame in extractor.process(observation.samples, observation.stamp):
            self._publishers.publish(identity, FEATURES, audio_features_to_msg(frame))
