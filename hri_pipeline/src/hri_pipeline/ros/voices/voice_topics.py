"""The topics of one voice, /humans/voices/ID/..., and who listens to them."""

from __future__ import annotations

from collections import deque
from types import SimpleNamespace
from typing import Deque, Dict, Iterable, List

import numpy as np
from audio_common_msgs.msg import AudioData
from std_msgs.msg import Bool

from hri_msgs.msg import AudioFeatures
from hri_pipeline.core.sound.sound_format import encode_s16
from hri_pipeline.core.sound.sound_stream import RATE
from hri_pipeline.core.speech.speech_utterance import SpeechResult
from hri_pipeline.core.voices.audio_features import AudioFeatureExtractor
from hri_pipeline.core.voices.voice_stage import VoiceObservation
from hri_pipeline.ros.conversions import audio_features_to_msg, make_header
from hri_pipeline.ros.interface import speech_message, speech_type
from hri_pipeline.ros.topic_lease import TopicLeases, TopicSpec

NAMESPACE = "/humans/voices"
AUDIO, FEATURES, IS_SPEAKING, SPEECH = "audio", "features", "is_speaking", "speech"


class _Backlog:
    """The last sound of a voice, for who subscribes first. It is not needed any more once somebody has."""

    def __init__(self, seconds: float) -> None:
        self._most = int(seconds * RATE)
        self._parts: Deque[np.ndarray] = deque()
        self._held = 0
        self.is_open = self._most > 0

    def add(self, samples: np.ndarray) -> None:
        """Keep samples (n,), and no more than the last seconds."""
        self._parts.append(samples)
        self._held += len(samples)
        while self._held - len(self._parts[0]) >= self._most:
            self._held -= len(self._parts.popleft())

    def take(self) -> List[np.ndarray]:
        """Return what is kept, and keep nothing from now on."""
        parts, self._parts, self.is_open = list(self._parts), deque(), False
        return parts


class VoiceTopics:
    """Publishes observations of voices; a topic that is switched off is not there.

    settings: the values of voice_parameters.VOICES; speech, features: whether these topics are there.
    """

    def __init__(self, settings: SimpleNamespace, speech: bool) -> None:
        self._settings = settings
        specs = {AUDIO: TopicSpec(AudioData, queue_size=100), IS_SPEAKING: TopicSpec(Bool, latch=True)}
        if settings.features:
            specs[FEATURES] = TopicSpec(AudioFeatures, queue_size=200)
        if speech:
            specs[SPEECH] = TopicSpec(speech_type(settings.interface), queue_size=20, greet=True)
        self._leases = TopicLeases(NAMESPACE, specs)
        self._speaking: Dict[str, bool] = {}
        self._backlogs: Dict[str, _Backlog] = {}
        self._extractors: Dict[str, AudioFeatureExtractor] = {}

    def keep(self, ids: Iterable[str]) -> None:
        """Advertise the topics of these voices and take those of all others back."""
        wanted, there = set(ids), set(self._leases.ids)
        for identity in there - wanted:
            self._close(identity)
        for identity in wanted - there:
            self._leases.open(identity)

    def publish(self, observation: VoiceObservation) -> None:
        """Publish all that is known of one voice and that is listened to."""
        identity = observation.id
        if self._speaking.get(identity) != observation.speaking:
            self._speaking[identity] = observation.speaking
            self._leases.publish(identity, IS_SPEAKING, Bool(observation.speaking))
        if len(observation.samples):
            self._publish_audio(identity, observation.samples)
            if self._settings.features:
                self._publish_features(identity, observation)

    def publish_speech(self, result: SpeechResult) -> bool:
        """Publish what a voice has said; False when the voice has gone."""
        header = make_header(result.stamp, self._settings.frame_id)
        return self._leases.publish(result.voice_id, SPEECH, speech_message(result, self._settings.interface, header))

    def close_ids(self) -> None:
        """Take the topics of all voices back."""
        for identity in self._leases.ids:
            self._close(identity)

    def restart_features(self) -> None:
        """Begin the features of all voices anew, with the rate that now is set."""
        self._extractors.clear()

    def _close(self, identity: str) -> None:
        if self._speaking.pop(identity, False):
            self._leases.publish(identity, IS_SPEAKING, Bool(False))
        self._backlogs.pop(identity, None)
        self._extractors.pop(identity, None)
        self._leases.close(identity)

    def _publish_audio(self, identity: str, samples: np.ndarray) -> None:
        backlog = self._backlogs.get(identity)
        if backlog is None:
            backlog = self._backlogs[identity] = _Backlog(self._settings.audio_backlog)
        if not self._leases.has_subscribers(identity, AUDIO):
            if backlog.is_open:
                backlog.add(samples)
            return
        parts = (backlog.take() if backlog.is_open else []) + [samples]
        self._leases.publish(identity, AUDIO, AudioData(data=encode_s16(np.concatenate(parts))))

    def _publish_features(self, identity: str, observation: VoiceObservation) -> None:
        if not self._leases.has_subscribers(identity, FEATURES):
            self._extractors.pop(identity, None)
            return
        extractor = self._extractors.get(identity)
        if extractor is None:
            extractor = self._extractors[identity] = AudioFeatureExtractor(self._settings.features_rate)
        for frame in extractor.process(observation.samples, observation.stamp):
            self._leases.publish(identity, FEATURES, audio_features_to_msg(frame))
