"""From blocks of sound to the topics and frames of voices."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Dict, List, Optional, Sequence, Set, Tuple

import numpy as np
import rospy

from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.ids import IdGenerator
from hri_pipeline.core.model_store import model_path
from hri_pipeline.core.sound.microphone_array import parse_positions
from hri_pipeline.core.sound.sound_separation import SoundSeparator
from hri_pipeline.core.sound.sound_stream import RATE, SoundBlock
from hri_pipeline.core.speech.speech_recognition import SpeechRecognition
from hri_pipeline.core.voices.voice_activity import ActivityModel
from hri_pipeline.core.voices.voice_stage import VoiceObservation, VoiceStage
from hri_pipeline.ros.conversions import transform_to_msg
from hri_pipeline.ros.diagnostics import OK, WARN
from hri_pipeline.ros.tf_publisher import TfPublisher
from hri_pipeline.ros.tracked_list import TrackedList
from hri_pipeline.ros.voices.voice_topics import NAMESPACE, VoiceTopics

# The recogniser may need so long for the last sentence of a voice that has gone: its topics wait for it.
_LAST_WORDS_S = 5.0
_LOG_PERIOD_S = 10.0
# Frames of voices: a direction changes slowly, and every listener of /tf pays for each.
_FRAME_PERIOD_S = 0.06
Status = Tuple[int, str, Dict[str, object]]


class VoiceBranch:
    """Publishes what VoiceStage hears. One thread calls all but close().

    settings: the values of voice_parameters.VOICES. Raises ModelError when a model is missing or damaged, ParameterError for
    positions of microphones or a grammar that cannot be.
    """

    def __init__(self, settings: SimpleNamespace) -> None:
        self._settings = settings
        rospy.loginfo("%s", privacy_line(settings))
        has_array = settings.direction and settings.microphone_positions
        self._positions = parse_positions(settings.microphone_positions) if has_array else np.zeros((0, 3))
        self._model = ActivityModel(model_path(settings.vad_model, "silero_vad.onnx"), notify=rospy.logwarn)
        self._ids = IdGenerator()
        self._stage = VoiceStage(settings, self._model, None, self._ids)
        self._channels = 0
        self._speech: Optional[SpeechRecognition] = None
        if settings.speech and SpeechRecognition.enabled(settings):
            self._speech = SpeechRecognition(settings)
        self._topics = VoiceTopics(settings, self._speech is not None)
        self._tracked = TrackedList(NAMESPACE + "/tracked")
        self._transforms = TfPublisher()
        self._framed: Dict[str, float] = {}
        self._end = 0.0
        # Voices with a sentence that is worked on; those of them that have gone, and until when their topics stay (monotonic s).
        self._unfinished: Set[str] = set()
        self._awaited: Dict[str, float] = {}
        self._present: Tuple[str, ...] = ()
        self._counts = {"turns": 0, "sentences": 0, "late_sentences": 0}
        self._closed = False

    def process(self, block: SoundBlock) -> None:
        """Find the voices in a block and publish them."""
        channels = block.samples.shape[1]
        if channels != self._channels:
            self._begin(channels)
        observations = self._stage.process(block)
        self._end = block.stamp + len(block.samples) / RATE
        # Most blocks complete no frame, or nobody is there.
        if observations or self._stage.tracked != self._present:
            self._publish(observations)

    def idle(self, seconds: float) -> None:
        """Note that nothing has come for `seconds` after the last block: turns end."""
        if self._end:
            stamp = self._end + seconds
            self._publish(self._stage.idle(stamp), stamp)

    def let_go(self) -> None:
        """Forget all voices: the microphone is silent for good. Sentences that are worked on may still come."""
        self._stage.reset()
        self._hold_topics(())
        self._tracked.set([], rospy.Time.from_sec(max(0.0, self._end)))

    def reconfigure(self, settings: SimpleNamespace) -> None:
        """Take up the values of the live parameters, as far as they are not read where they are used."""
        self._topics.restart_features()
        if self._speech is not None:
            self._speech.least_confidence = settings.speech_min_confidence

    def reset(self) -> None:
        """Forget everything: time has jumped back, or the sound is another."""
        if self._speech is not None:
            for identity in set(self._present) | self._unfinished:
                self._speech.drop(identity)
        self._stage.reset()
        self._unfinished.clear()
        self._awaited.clear()
        self._present = ()
        self._framed.clear()
        self._tracked.set([], rospy.Time.now())
        self._topics.close_ids()
        self._end = 0.0

    def poll(self) -> None:
        """Publish what the recogniser has understood since the last call."""
        if self._speech is None:
            return
        for result in self._speech.poll():
            if not self._topics.publish_speech(result):
                self._counts["late_sentences"] += 1
            if not result.incremental:
                self._counts["sentences"] += bool(result.final)
                self._unfinished.discard(result.voice_id)
        done = [identity for identity, until in self._awaited.items()
                if identity not in self._unfinished or time.monotonic() > until]
        for identity in done:
            del self._awaited[identity]
            if identity in self._unfinished:
                self._unfinished.discard(identity)
                self._speech.drop(identity)
        if done:
            self._topics.keep(set(self._present) | set(self._awaited))

    def status(self) -> Dict[str, Status]:
        """Return level, message and values of each task for diagnostics."""
        tracked = self._stage.tracked
        values: Dict[str, object] = {"tracked": len(tracked), "channels": self._channels,
                                     "direction": bool(self._array_fits())}
        values.update(self._counts)
        found = {"voices": (OK, "{} voices".format(len(tracked)), values)}
        if len(self._positions) and self._channels and not self._array_fits():
            found["voices"] = (WARN, self._misfit(), values)
        if self._speech is not None:
            found["speech"] = self._speech.status()
        return found

    def close(self) -> None:
        """Publish that no voice is tracked any more and take all topics back. Idempotent."""
        if self._closed:
            return
        self._closed = True
        self._tracked.close()
        self._topics.close_ids()
        self._transforms.close()
        if self._speech is not None:
            self._speech.close()

    def _begin(self, channels: int) -> None:
        """Make the stage for sound of so many channels."""
        if self._channels:
            self.reset()
        self._channels = channels
        array = SoundSeparator(self._positions, self._settings) if self._array_fits() else None
        if len(self._positions) and array is None:
            rospy.logwarn("%s", self._misfit())
        self._stage = VoiceStage(self._settings, self._model, array, self._ids)

    def _array_fits(self) -> bool:
        return len(self._positions) >= 2 and len(self._positions) == self._channels

    def _misfit(self) -> str:
        return "~microphone_positions has {} microphones and the sound {} channels: no directions; give one position " \
               "per channel".format(len(self._positions), self._channels)

    def _publish(self, observations: Sequence[VoiceObservation], stamp: Optional[float] = None) -> None:
        ids = self._stage.tracked
        self._topics.keep(set(ids) | set(self._present) | set(self._awaited) | {seen.id for seen in observations})
        self._tracked.set(ids, rospy.Time.from_sec(max(0.0, self._end if stamp is None else stamp)))
        for observation in observations:
            self._topics.publish(observation)
            self._recognise(observation)
        self._publish_frames(observations)
        self._hold_topics(ids)

    def _hold_topics(self, ids: Tuple[str, ...]) -> None:
        """Take back the topics of voices that have gone; those whose last sentence is worked on keep them for a while."""
        gone = set(self._present) - set(ids)
        for identity in gone & self._unfinished:
            self._awaited[identity] = time.monotonic() + _LAST_WORDS_S
        self._present = tuple(ids)
        for identity in gone:
            self._framed.pop(identity, None)
        self._topics.keep(set(ids) | set(self._awaited))

    def _recognise(self, observation: VoiceObservation) -> None:
        """Hand the sound of a turn to the recogniser."""
        self._counts["turns"] += observation.onset
        if self._speech is None:
            return
        if observation.onset:
            self._speech.start(observation.id, observation.stamp)
        if observation.turn and len(observation.samples):
            self._speech.feed(observation.id, observation.samples, observation.stamp)
            self._unfinished.add(observation.id)
        if observation.end:
            self._speech.end(observation.id)

    def _publish_frames(self, observations: Sequence[VoiceObservation]) -> None:
        """Publish voice_ID of voices whose direction is known, the newest of each."""
        newest: Dict[str, VoiceObservation] = {
            observation.id: observation for observation in observations if observation.direction is not None
            and not 0.0 <= observation.stamp - self._framed.get(observation.id, -1.0) < _FRAME_PERIOD_S}
        if not newest:
            return
        self._framed.update((identity, observation.stamp) for identity, observation in newest.items())
        if not self._settings.frame_id:
            rospy.logwarn_throttle(_LOG_PERIOD_S, "~frame_id is empty, so voices have no TF frame; name the microphone's")
            return
        distance = self._settings.direction_distance
        transforms: List = []
        for observation in newest.values():
            pose = Pose.from_quaternion((0.0, 0.0, 0.0, 1.0), distance * np.asarray(observation.direction, np.float64))
            transforms.append(transform_to_msg(pose, max(0.0, observation.stamp), self._settings.frame_id,
                                               "voice_" + observation.id))
        self._transforms.send(transforms)


def privacy_line(settings: SimpleNamespace) -> str:
    """Say in one line what is made of voices."""
    kinds = [name for name in ("features", "speech", "direction") if getattr(settings, name)]
    off = [name for name in ("features", "speech", "direction") if name not in kinds]
    return "made of voices: who speaks{}; switched off: {}; sound is never stored".format(
        "".join(", " + name for name in kinds), ", ".join(off) or "nothing")
