"""The node `voices`: who speaks, from where and what, in the sound of a microphone or an array of microphones.

`VoicesNode` is the loop: it takes blocks of sound from the input and reports diagnostics. `VoiceProcessor` handles a
block: voices by the pipeline of the core, their topics, their TF frames, and speech recognition.

Threads: callbacks of rospy only store; everything else happens in the caller of spin().
"""

from __future__ import annotations

import time
from collections import deque
from dataclasses import replace
from typing import Callable, Deque, Dict, Iterable, List, Optional, Sequence, Set, Tuple

import numpy as np
import rospy

from hri_msgs.msg import IdsMatch
from hri_pipeline.core.asr.engines import LanguageError
from hri_pipeline.core.asr.recognition import SpeechRecognition
from hri_pipeline.core.audio.array import check_channels, parse_positions
from hri_pipeline.core.audio.channel_order import order_problem
from hri_pipeline.core.audio.own_voice import BargeInFilter, RobotSpeech, hear_humans
from hri_pipeline.core.audio.parameters import VoicesSettings
from hri_pipeline.core.audio.pipeline import VoiceObservation, VoicePipeline
from hri_pipeline.core.audio.separation import SoundSeparator
from hri_pipeline.core.audio.speakers import CALIBRATION, DIMENSION, MODEL, MODEL_FILE, SpeakerEmbedder, VoiceIdentity
from hri_pipeline.core.audio.stream import RATE, STALL_S, SoundBlock
from hri_pipeline.core.audio.vad import ActivityModel, check_thresholds
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.ids import IdGenerator
from hri_pipeline.core.onnx import ModelError, model_path
from hri_pipeline.core.parameters import ParameterError
from hri_pipeline.core.privacy import DataUse, StoreError, TemplateCipher
from hri_pipeline.core.recognition.stored_gallery import open_gallery
from hri_pipeline.ros.conversions import match_to_msg, transform_to_msg
from hri_pipeline.ros.diagnostics import ERROR, OK, WARN, NodeDiagnostics, Status
from hri_pipeline.ros.gallery_service import GalleryService
from hri_pipeline.ros.privacy import PrivacyTopic
from hri_pipeline.ros.publishers import MATCHES_TOPIC, TrackedList
from hri_pipeline.ros.rospy_compat import release
from hri_pipeline.ros.sound_input import RobotVoiceInput, SoundInput
from hri_pipeline.ros.tf import TfPublisher
from hri_pipeline.ros.voice_topics import NAMESPACE, VoiceTopics
from hri_pipeline.ros.worker import Worker

_WAIT_S = 0.1
_LOG_PERIOD_S = 10.0
_WINDOW = 300
_KINDS = ("features", "speech", "direction", "speaker_changes", "voice_identity")
# Processing that takes a larger share of the duration of the sound falls behind.
_TOO_SLOW = 0.9
# The topics of a voice that is no longer tracked wait so long for its last sentence.
_LAST_WORDS_S = 5.0
# Period of the frames of voices: directions change slowly, and every listener of /tf has to process each frame.
_FRAME_PERIOD_S = 0.06


class VoicesNode(Worker):
    """Gives the blocks of the input to the processor.

    Where sound is late by STALL_S of ROS time all turns end; by `silence_time` s all voices are removed.

    Parameters
    ----------
    settings : VoicesSettings

    Raises
    ------
    ModelError, ParameterError
        See VoiceProcessor.
    """

    def __init__(self, settings: VoicesSettings) -> None:
        self._settings = settings
        self._processor = VoiceProcessor(settings)
        super().__init__("sound", SoundInput(settings, self._restart), NodeDiagnostics(rospy.get_name()), _WINDOW)
        self._work: Deque[Tuple[float, float]] = deque(maxlen=_WINDOW)
        rospy.on_shutdown(self._closed.set)

    def reconfigure(self, settings: VoicesSettings) -> None:
        """Apply the values of the live parameters between two blocks.

        Raises ValueError for thresholds in the wrong order.
        """
        check_thresholds(settings)
        with self._lock:
            self._settings = settings
            self._processor.reconfigure(settings)
            self._input.reconfigure(settings)

    def process(self, block: SoundBlock) -> None:
        """Find the voices in a block."""
        self._attempt("block", lambda: self._find(block))

    def _find(self, block: SoundBlock) -> None:
        started = time.perf_counter()
        with self.times("block"):
            self._processor.process(block)
        length = len(block.samples) / RATE
        self._work.append((time.perf_counter() - started, length))
        self._ages.append(rospy.get_time() - block.stamp - length)

    def _take(self) -> Sequence[SoundBlock]:
        return self._input.next(_WAIT_S)

    def _after(self) -> None:
        self._attempt("speech", self._processor.poll)

    def _rest(self, seconds: float) -> bool:
        # A message comes when its sound is over: the next one is not late before.
        late = seconds - self._input.message_s
        if late >= STALL_S or late >= self._settings.silence_time:
            self._attempt("idle", lambda: self._processor.idle(late))
        if late < self._settings.silence_time:
            return False
        self._attempt("idle", self._processor.remove_voices)
        return True

    def _restart(self) -> None:
        self._ages.clear()
        self._attempt("reset", self._processor.reset)

    def _owned(self) -> Iterable[VoiceProcessor]:
        return (self._processor,)

    def _statuses(self) -> Iterable[Tuple[str, Callable[[], Status]]]:
        return [(task, lambda status=status: status) for task, status in self._processor.status().items()]

    def _load(self) -> Status:
        work, length = sum(cost for cost, _ in self._work), sum(length for _, length in self._work)
        values: Dict[str, object] = {"errors": sum(self._errors.values()),
                                     "dropped_messages": self._input.counts["dropped_messages"]}
        if not length:
            return WARN, "no sound yet", values
        values["real_time_factor"] = work / length
        if work / length > _TOO_SLOW:
            return WARN, "the processor is too slow: {:.2f} s of work per second of sound; switch features or speech " \
                         "off".format(work / length), values
        return OK, "{:.3f} s of work per second of sound".format(work / length), values


class VoiceProcessor:
    """Finds the voices in blocks of sound, and publishes their topics, frames and speech.

    All methods except close() must be called by one thread.

    Parameters
    ----------
    settings : VoicesSettings

    Raises
    ------
    ModelError
        When a model is missing or damaged.
    ParameterError
        For impossible positions or channels of microphones, or a wrong grammar.
    """

    def __init__(self, settings: VoicesSettings) -> None:
        self._settings = settings
        rospy.loginfo("%s", privacy_line(settings))
        self._privacy = PrivacyTopic(data_use(settings))
        has_array = settings.direction and settings.microphone_positions
        self._positions = parse_positions(settings.microphone_positions) if has_array else np.zeros((0, 3))
        check_channels(settings.microphone_channels)
        self._model = ActivityModel(model_path(settings.vad_model, "silero_vad.onnx"), notify=rospy.logwarn)
        self._ids = IdGenerator()
        self._no_speakers = ""
        self._speakers = self._load_speakers() if settings.speaker_changes else None
        self._pipeline = VoicePipeline(settings, self._model, None, self._ids, self._speakers)
        self._robot = RobotSpeech(settings)
        self._robot_input = RobotVoiceInput(self._robot)
        self._barge_in: Optional[BargeInFilter] = None
        self._channels = 0
        self._broken: Tuple[int, ...] = ()
        self._order: Tuple[int, ...] = ()
        self._speech: Optional[SpeechRecognition] = None
        self._no_speech = ""
        if settings.speech and SpeechRecognition.enabled(settings):
            self._start_speech()
        self._persons = self._know_persons() if settings.voice_identity else None
        self._topics = VoiceTopics(settings, self._speech is not None)
        self._tracked_list = TrackedList(NAMESPACE + "/tracked")
        self._transforms = TfPublisher()
        self._frame_times: Dict[str, float] = {}
        self._end = 0.0
        # Voices with an unfinished sentence; those of them that are not tracked any more, with the end of their topics
        # (monotonic s).
        self._unfinished: Set[str] = set()
        self._awaited: Dict[str, float] = {}
        self._present: Tuple[str, ...] = ()
        self._counts = {"turns": 0, "sentences": 0, "late_sentences": 0}
        self._closed = False

    def process(self, block: SoundBlock) -> None:
        """Find the voices in a block and publish them."""
        channels = block.samples.shape[1]
        broken = block.broken if len(self._positions) == channels else ()
        # A microphone that works again is taken up when nobody is heard, whose voice would begin anew.
        if channels != self._channels or not set(broken) <= set(self._broken) or (
                broken != self._broken and not self._pipeline.tracked):
            self._restart(channels, broken)
        if self._broken:
            block = replace(block, samples=block.samples[:, self._working()])
        self._robot_input.update(rospy.get_time())
        observations = hear_humans(self._pipeline, self._robot, self._barge_in, block)
        self._end = block.stamp + len(block.samples) / RATE
        self._check_order()
        # Most blocks complete no frame, or there are no voices.
        if observations or self._pipeline.tracked != self._present:
            self._publish(observations)

    def idle(self, seconds: float) -> None:
        """Note that there has been no sound for `seconds` after the last block: turns end."""
        if self._end:
            stamp = self._end + seconds
            self._publish(self._pipeline.idle(stamp), stamp)

    def remove_voices(self) -> None:
        """Remove all voices, because the microphone is silent. Unfinished sentences are still published."""
        self._pipeline.reset()
        self._update_topics(())
        self._tracked_list.set([], rospy.Time.from_sec(max(0.0, self._end)))

    def reconfigure(self, settings: VoicesSettings) -> None:
        """Apply the values of the live parameters."""
        self._settings = settings
        self._pipeline.reconfigure(settings)
        self._robot.reconfigure(settings)
        if self._barge_in is not None:
            self._barge_in.reconfigure(settings)
        self._topics.reconfigure(settings)
        if self._speech is not None:
            self._speech.least_confidence = settings.speech_min_confidence

    def reset(self) -> None:
        """Forget everything, when time has gone back or the input has changed."""
        if self._speech is not None:
            for identity in set(self._present) | self._unfinished:
                self._speech.drop(identity)
        self._pipeline.reset()
        self._unfinished.clear()
        self._awaited.clear()
        self._present = ()
        self._frame_times.clear()
        self._tracked_list.clear()
        self._topics.close_ids()
        self._end = 0.0

    def poll(self) -> None:
        """Publish the new results of speech recognition, and take note of what the robot says of its own voice."""
        self._robot_input.update(rospy.get_time())
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
            self._topics.retain(set(self._present) | set(self._awaited))

    def status(self) -> Dict[str, Status]:
        """Return level, message and values of each task for diagnostics."""
        tracked = self._pipeline.tracked
        values: Dict[str, object] = {"tracked": len(tracked), "channels": self._channels,
                                     "direction": bool(self._array_fits()), "broken_microphones": len(self._broken)}
        values.update(self._counts)
        found = {"voices": (OK, "{} voices".format(len(tracked)), values), "own voice": self._robot_input.status()}
        if len(self._positions) and self._channels and not self._array_fits():
            found["voices"] = (WARN, self._misfit(), values)
        elif self._order:
            found["voices"] = (WARN, self._disorder(), values)
        elif self._no_speakers:
            found["voices"] = (WARN, self._no_speakers, values)
        if self._persons is not None:
            found["identity"] = self._persons.status()
        if self._speech is not None:
            found["speech"] = self._speech.status()
        elif self._no_speech:
            found["speech"] = (ERROR, self._no_speech, {})
        return found

    def close(self) -> None:
        """Publish that no voice is tracked any more and remove all topics. Idempotent."""
        if self._closed:
            return
        self._closed = True
        self._robot_input.close()
        self._tracked_list.close()
        self._topics.close_ids()
        self._transforms.close()
        self._privacy.close()
        if self._persons is not None:
            self._persons.close()
        if self._speech is not None:
            self._speech.close()

    def _load_speakers(self) -> Optional[SpeakerEmbedder]:
        """Return the network of speakers; without its file there are voices, and turns end by pauses only."""
        try:
            return SpeakerEmbedder(model_path("", MODEL_FILE), notify=rospy.logwarn)
        except ModelError as error:
            self._no_speakers = "changes of the speaker are not found: {}".format(error)
            rospy.logwarn("%s", self._no_speakers)
            return None

    def _know_persons(self) -> Optional[VoicePersons]:
        """Return who tells whose voice it is; None without the network."""
        embedder = self._speakers or self._load_speakers()
        try:
            return VoicePersons(embedder, self._settings) if embedder is not None else None
        except StoreError as error:
            raise ParameterError("~gallery, ~gallery_key: {}".format(error)) from error

    def _start_speech(self) -> None:
        """Start the recogniser. Without a model for the language there are voices, and no speech."""
        try:
            self._speech = SpeechRecognition(self._settings)
        except LanguageError as error:
            self._no_speech = str(error)
            rospy.logerr("%s", error)

    def _restart(self, channels: int, broken: Tuple[int, ...]) -> None:
        """Start a new pipeline for this number of channels, without those that are broken microphones."""
        if self._channels:
            self.reset()
        self._order = ()    # first: diagnostics read it meanwhile, and it is of the microphones before
        self._channels, self._broken = channels, broken
        self._barge_in = None
        if self._array_fits():
            places = self._positions[self._working()] if broken else self._positions
            self._barge_in = BargeInFilter(SoundSeparator(places, self._settings), self._robot, self._settings)
        elif len(self._positions):
            rospy.logwarn("%s", self._misfit())
        self._pipeline = VoicePipeline(self._settings, self._model, self._barge_in, self._ids,
                                       self._speakers)

    def _working(self) -> List[int]:
        """Return the indices of the channels that are used."""
        return [index for index in range(self._channels) if index not in self._broken]

    def _array_fits(self) -> bool:
        return len(self._working()) >= 2 and len(self._positions) == self._channels

    def _check_order(self) -> None:
        """Tell once that the channels of the array do not fit its positions."""
        order = self._barge_in.fitting_order if self._barge_in is not None else ()
        if order != self._order:
            self._order = order
            if order:
                rospy.logwarn("%s", self._disorder())

    def _disorder(self) -> str:
        channels = self._settings.microphone_channels
        return order_problem(self._order, list(range(self._channels)) if -1 in channels else channels, self._working())

    def _misfit(self) -> str:
        if len(self._positions) == self._channels:
            return "one of {} microphones works: no directions; check the others".format(self._channels)
        return "~microphone_positions has {} microphones and the sound {} channels: no directions; give one position " \
               "per channel, or select channels by ~microphone_channels".format(len(self._positions), self._channels)

    def _publish(self, observations: Sequence[VoiceObservation], stamp: Optional[float] = None) -> None:
        ids = self._pipeline.tracked
        self._topics.retain(set(ids) | set(self._present) | set(self._awaited) | {seen.id for seen in observations})
        self._tracked_list.set(ids, rospy.Time.from_sec(max(0.0, self._end if stamp is None else stamp)))
        for observation in observations:
            self._topics.publish(observation)
            self._recognise(observation)
        if self._persons is not None:
            self._persons.update(observations, ids)
        self._publish_frames(observations)
        self._update_topics(ids)

    def _update_topics(self, ids: Tuple[str, ...]) -> None:
        """Remove the topics of voices that are not tracked any more, after their last sentence."""
        # Also of a voice that begins and ends within one block, and so was never present.
        for identity in self._unfinished.difference(ids, self._awaited):
            self._awaited[identity] = time.monotonic() + _LAST_WORDS_S
        self._present = tuple(ids)
        self._frame_times = {identity: stamp for identity, stamp in self._frame_times.items() if identity in ids}
        self._topics.retain(set(ids) | set(self._awaited))

    def _recognise(self, observation: VoiceObservation) -> None:
        """Hand the sound of a turn to the recogniser."""
        self._counts["turns"] += observation.onset
        if self._speech is None:
            return
        if observation.onset:
            self._speech.start(observation.id, observation.stamp)
        if observation.turn and len(observation.samples):
            self._speech.feed(observation.id, observation.samples, observation.stamp, observation.speaking)
            self._unfinished.add(observation.id)
        if observation.end:
            self._speech.end(observation.id, observation.stamp)

    def _publish_frames(self, observations: Sequence[VoiceObservation]) -> None:
        """Publish the frame voice_ID of voices whose direction is known, only the newest of each."""
        newest: Dict[str, VoiceObservation] = {
            observation.id: observation for observation in observations if observation.direction is not None
            and not 0.0 <= observation.stamp - self._frame_times.get(observation.id, -1.0) < _FRAME_PERIOD_S}
        if not newest:
            return
        self._frame_times.update((identity, observation.stamp) for identity, observation in newest.items())
        if not self._settings.frame_id:
            rospy.logwarn_throttle(_LOG_PERIOD_S, "~frame_id is empty, so voices have no TF frame; name the "
                                                  "microphone's")
            return
        distance = self._settings.direction_distance
        transforms: List = []
        for observation in newest.values():
            pose = Pose.from_quaternion((0.0, 0.0, 0.0, 1.0), distance * np.asarray(observation.direction, np.float64))
            transforms.append(transform_to_msg(pose, max(0.0, observation.stamp), self._settings.frame_id,
                                               "voice_" + observation.id))
        self._transforms.send(transforms)


class VoicePersons:
    """Publishes whose voice it is, and offers ~gallery.

    Parameters
    ----------
    embedder : SpeakerEmbedder
    settings : VoicesSettings

    Raises
    ------
    StoreError
        The store cannot be used.
    """

    def __init__(self, embedder: SpeakerEmbedder, settings: VoicesSettings) -> None:
        cipher = TemplateCipher(settings.gallery_key) if settings.gallery_key else None
        self._identity = VoiceIdentity(embedder, open_gallery(settings.gallery, MODEL, DIMENSION, CALIBRATION, cipher,
                                                              rospy.logwarn))
        self._service = GalleryService(self._identity, self._identity.flush)
        self._matches = rospy.Publisher(MATCHES_TOPIC, IdsMatch, queue_size=100)
        self._subscribers = 0

    def update(self, observations: Sequence[VoiceObservation], tracked: Sequence[str]) -> None:
        """Add what the voices have said; publish new and withdrawn matches, and all to a new subscriber."""
        for seen in observations:
            if seen.speaking and len(seen.samples):
                self._identity.add(seen.id, seen.samples)
        self._identity.retain(tracked)
        subscribers, changes = self._matches.get_num_connections(), self._identity.changes()
        if subscribers > self._subscribers:
            changes += self._identity.current()
        self._subscribers = subscribers
        for match in changes:
            self._matches.publish(match_to_msg(match.voice_id, IdsMatch.VOICE, match.person_id, IdsMatch.PERSON,
                                               match.likelihood))

    def status(self) -> Status:
        """Return level, message and values for diagnostics."""
        values: Dict[str, object] = {"known_voices": len(self._identity.list_known()),
                                     "recognised_voices": len(self._identity.current())}
        return (ERROR if self._service.problem else OK,
                self._service.problem or "{known_voices} voices are known".format(**values), values)

    def close(self) -> None:
        """Take service and topic back, and write what is left."""
        self._service.close()
        release(self._matches)
        self._identity.close()


def data_use(settings: VoicesSettings) -> DataUse:
    """Return what is computed of voices, and what is kept of those who have agreed to be known by theirs."""
    computes = ("who speaks", *(name for name in _KINDS if getattr(settings, name)))
    if not (settings.voice_identity and settings.gallery):
        return DataUse(computes)
    return DataUse(computes, settings.gallery, ("ids", "consent", "times", "templates of voices"),
                   encrypted=bool(settings.gallery_key))


def privacy_line(settings: VoicesSettings) -> str:
    """Return one line of log that says what is computed from voices."""
    use = data_use(settings)
    kinds = use.computes[1:]
    off = [name for name in _KINDS if name not in kinds]
    return "made of voices: who speaks{}; switched off: {}; sound is never stored{}".format(
        "".join(", " + name for name in kinds), ", ".join(off) or "nothing",
        "; templates of the voices of people who agreed are kept in {}".format(settings.gallery) if use.stored else "")
