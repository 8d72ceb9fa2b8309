"""The input of sound: subscribers of audio topics, whose messages become blocks of 16 kHz; and what the robot says of
its own voice."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict, deque
from functools import lru_cache
from typing import Callable, Deque, Dict, List, NamedTuple, Optional, Tuple

import audio_common_msgs.msg
import genpy
import rospy
from audio_common_msgs.msg import AudioData, AudioInfo
from std_msgs.msg import Bool

from hri_pipeline.core.audio.own_voice import RobotSpeech
from hri_pipeline.core.audio.parameters import VoicesSettings
from hri_pipeline.core.audio.stream import SoundBlock, SoundError, SoundFormat, SoundStream
from hri_pipeline.core.timing import OTHER_CLOCK_S, clock_fault, clock_went_back
from hri_pipeline.ros.diagnostics import ERROR, OK, WARN, Status
from hri_pipeline.ros.rospy_compat import release, sender_of
from hri_pipeline.ros.sensor_input import LOG_PERIOD_S, SILENCE_S, SensorInput

# audio_common_msgs has this type since 0.3.9; replacements of the package may not have it.
AudioDataStamped = getattr(audio_common_msgs.msg, "AudioDataStamped", None)

BUFFER_BYTES = 2 ** 20
JUMP_S = 1.0
INFO_GRACE_S = 1.0
MAX_WAITING_S = 5.0
# Sound whose stamps differ by more from the time of its arrival, for so long, comes from another clock.
_MOST_AGE_S, _SETTLED_S = 2.0, 2.0
_CLOCKS = "{}: sound is {}, so that voices are found at the times of other images; {}"
_MEND = "set the clocks of microphone and robot by NTP, or play bags with --clock and /use_sim_time"
_BAD_S = 2.0
_GAP_SHOWN_S = 5.0
_MOST_INFOS = 8
_MOST_WORDS = 500
Problem = Tuple[int, str]


class _Chunk(NamedTuple):
    """Bytes of one message; arrival: s, ROS time."""

    data: bytes
    arrival: float


_format_of = lru_cache(maxsize=_MOST_INFOS)(SoundFormat)
"""The same one for each message, of which fifty a second come."""


class SoundInput(SensorInput):
    """Subscribes to `audio` and `audio_info`, and to `audio_stamped` where the system has that type.

    Callbacks only store messages; next() decodes them in the thread of the caller. Only one publisher is heard at a
    time. Messages that have waited longer than MAX_WAITING_S are dropped and counted, and the stream has a gap there.

    Parameters
    ----------
    settings : VoicesSettings
    on_restart : callable, optional
        Called without arguments when a new stream begins: time has gone back, or the format has changed.

    Attributes
    ----------
    message_s : float
        s, length of the sound in the last message, at most MAX_WAITING_S.
    """

    def __init__(self, settings: VoicesSettings, on_restart: Optional[Callable[[], None]] = None) -> None:
        super().__init__("audio", "sound", "microphone", (
            "start the microphone's node or remap `audio`", "is the microphone there?"), settings.silence_time)
        self._settings = settings
        self.on_restart = on_restart
        self._chunks: Deque[_Chunk] = deque()
        self._waiting_bytes = 0
        self._infos: "OrderedDict[str, AudioInfo]" = OrderedDict()
        self._stream: Optional[SoundStream] = None
        self._last: Optional[float] = None
        self._stamped_at = float("-inf")
        self._age, self._came, self._in_time = 0.0, 0.0, time.monotonic()
        self._bad: Tuple[str, float] = ("", float("-inf"))
        self._gap: Tuple[str, float] = ("", float("-inf"))
        self._dropped_bytes = 0
        self.message_s = 0.0
        self.counts = {"messages": 0, "unreadable": 0, "dropped_messages": 0, "restarts": 0, "time_jumps": 0}
        self._subscribers = [
            rospy.Subscriber("audio", AudioData, self._on_audio, buff_size=BUFFER_BYTES, tcp_nodelay=True),
            rospy.Subscriber("audio_info", AudioInfo, self._on_info, queue_size=1)]
        if AudioDataStamped is not None:
            self._subscribers.append(rospy.Subscriber("audio_stamped", AudioDataStamped, self._on_stamped,
                                                      buff_size=BUFFER_BYTES, tcp_nodelay=True))

    def reconfigure(self, settings: VoicesSettings) -> None:
        """Take up the values of the live parameters."""
        self._settings = settings
        self._senders.timeout = settings.silence_time

    def next(self, timeout: float) -> List[SoundBlock]:
        """Return the next blocks of sound. Waits at most `timeout` s; empty when there is no sound."""
        chunk = self._take(timeout)
        if chunk is None:
            self._warn_of_silence()
            return []
        self._warn("others", self._other_sender())
        self._warn("clock", self._clock_problem())
        if not self._info_is_awaited():
            return self._blocks(chunk)
        with self._condition:
            self._chunks.appendleft(chunk)
            self._waiting_bytes += len(chunk.data)
        rospy.rostime.wallsleep(min(timeout, 0.01))
        return []

    def status(self) -> Status:
        """Return level, message and values for diagnostics."""
        values: Dict[str, object] = {"topic": self.topic, "sender": self._senders.used}
        values.update(self.counts)
        stream = self._stream
        if stream is not None:
            values.update(stream.values())
        level, text = self._problem()
        return level, text or "sound comes in", values

    def close(self) -> None:
        """Unsubscribe; a waiting next() returns nothing. Idempotent."""
        with self._condition:
            if self._closed:
                return
            self._closed = True
            self._chunks.clear()
            self._condition.notify_all()
        for subscriber in self._subscribers:
            release(subscriber)

    def _on_info(self, message: AudioInfo) -> None:
        with self._condition:
            sender = sender_of(message)
            self._infos[sender] = message
            self._infos.move_to_end(sender)
            while len(self._infos) > _MOST_INFOS:
                self._infos.popitem(last=False)
            self._condition.notify_all()

    def _on_audio(self, message: AudioData) -> None:
        if time.monotonic() - self._stamped_at > SILENCE_S and self._store(message.data, message, rospy.get_time()):
            self._age = 0.0

    def _on_stamped(self, message: "AudioDataStamped") -> None:
        self._stamped_at, now, stamp = time.monotonic(), rospy.get_time(), message.header.stamp.to_sec()
        # The stamp is taken as the time of the end of the message.
        if self._store(message.audio.data, message, stamp or now):
            self._age, self._came = now - stamp if now and stamp else 0.0, now
            if abs(self._age) <= _MOST_AGE_S:
                self._in_time = self._stamped_at

    def _clock_problem(self) -> str:
        """Return that the stamps are of another clock, empty where they are not."""
        age = self._age
        if abs(age) <= _MOST_AGE_S or time.monotonic() - self._in_time < _SETTLED_S:
            return ""
        fault = ("{:.1f} s {}".format(abs(age), "old when it arrives" if age > 0.0 else "in the future"), _MEND)
        if abs(age) >= OTHER_CLOCK_S:
            fault = clock_fault(age, self._came, time.time(), not rospy.rostime.is_wallclock())
        return _CLOCKS.format(rospy.resolve_name("audio_stamped"), *fault)

    def _store(self, data: bytes, message: genpy.Message, arrival: float) -> bool:
        """Keep a message until it is its turn; tell whether it is used."""
        if not arrival:
            return False    # simulated time has not begun
        with self._condition:
            if not self._accepts(message):
                return False
            self._senders.was_read(sender_of(message), True, self._heard)
            self.counts["messages"] += 1
            self._chunks.append(_Chunk(bytes(data), arrival))
            self._waiting_bytes += len(data)
            self._drop_old()
            self._condition.notify()
        return True

    def _drop_old(self) -> None:
        """Drop messages that have waited too long, the oldest first."""
        form = self._stream.form if self._stream is not None else None
        limit = MAX_WAITING_S * (form.frame_bytes * form.sample_rate if form is not None else BUFFER_BYTES)
        while self._waiting_bytes > limit and len(self._chunks) > 1:
            dropped = self._chunks.popleft()
            self._waiting_bytes -= len(dropped.data)
            self._dropped_bytes += len(dropped.data)
            self.counts["dropped_messages"] += 1

    def _take(self, timeout: float) -> Optional[_Chunk]:
        with self._condition:
            self._condition.wait_for(lambda: self._closed or self._chunks, max(0.0, timeout))
            if not self._chunks:
                return None
            chunk = self._chunks.popleft()
            self._waiting_bytes -= len(chunk.data)
            return chunk

    def _info_is_awaited(self) -> bool:
        """Return whether the first AudioInfo may still arrive: there is sound, but no format yet."""
        return (self._settings.use_audio_info and not self._infos and self._stream is None and not self._closed
                and time.monotonic() - self._first < INFO_GRACE_S)

    def _blocks(self, chunk: _Chunk) -> List[SoundBlock]:
        try:
            if self._last is not None and chunk.arrival < self._last - JUMP_S:
                self.counts["time_jumps"] += 1
                rospy.logwarn_throttle(LOG_PERIOD_S, "%s: voices start anew", clock_went_back(
                    self._last - chunk.arrival, not rospy.rostime.is_wallclock()))
                self._restart(None)
            self._last = chunk.arrival
            form = self._format()
            if self._stream is None or self._stream.form != form:
                self._restart(form)
            with self._condition:
                dropped, self._dropped_bytes = self._dropped_bytes, 0
            if dropped:
                self._stream.skip(dropped / (form.frame_bytes * form.sample_rate))
            blocks = self._stream.add(chunk.data, chunk.arrival)
            self.message_s = min(len(chunk.data) / (form.frame_bytes * form.sample_rate), MAX_WAITING_S)
            self._note_gap(sum(block.gap for block in blocks), dropped > 0)
            return blocks
        except SoundError as error:
            self.counts["unreadable"] += 1
            self._bad = ("{}: {}".format(self.topic, error), time.monotonic())
            self._tell(self._bad[0] + "; such sound is skipped")
            return []

    def _note_gap(self, gap: float, dropped: bool) -> None:
        """Log that `gap` s of sound are missing."""
        if gap > 0.0:
            self._gap = ("{}: {:.2f} s of sound {}".format(
                self.topic, gap, "were dropped: the processor is too slow; switch features or speech off" if dropped
                else
                "are missing: a pause of its sender, or lost on its way"), time.monotonic())
            rospy.logwarn_throttle(LOG_PERIOD_S, "%s", self._gap[0])

    def _format(self) -> SoundFormat:
        options = self._settings
        with self._condition:
            # The AudioInfo of the node that sends the sound, or of another node if there is none.
            info = self._infos.get(self._senders.used) or next(reversed(list(self._infos.values())), None)
        if info is not None and options.use_audio_info:
            return _format_of(info.channels, info.sample_rate, info.sample_format, info.coding_format)
        return _format_of(options.channels, options.sample_rate, options.sample_format)

    def _restart(self, form: Optional[SoundFormat]) -> None:
        """Start a new stream of this format; None: of the format of the next message."""
        if self._stream is not None:
            self.counts["restarts"] += 1
            if self.on_restart is not None:
                self.on_restart()
        options = self._settings
        self._stream = None
        if form is not None:
            rospy.loginfo("%s: %s", self.topic, form.text)
            self._stream = SoundStream(form, options.gap_tolerance, options.input_latency, options.resampling,
                                       options.microphone_channels,
                                       is_array=options.direction and len(options.microphone_positions) > 1)

    def _problem(self) -> Problem:
        """Return level and text of the worst problem of the input."""
        silent = self._silence()
        if silent:
            return ERROR, silent
        if time.monotonic() - self._bad[1] < _BAD_S:
            return ERROR, self._bad[0]
        other = self._other_sender() or self._clock_problem()
        if other:
            return WARN, other
        trouble = self._stream.problem() if self._stream is not None else ""
        if trouble:
            return WARN, "{}: {}".format(self.topic, trouble)
        return (WARN, self._gap[0]) if time.monotonic() - self._gap[1] < _GAP_SHOWN_S else (OK, "")


class RobotVoiceInput:
    """Subscribes to `~robot_speaking`, `~robot_audio` and `~robot_audio_info`, and tells RobotSpeech what they say.

    Callbacks only store; update() does the work in the thread of the caller.

    Parameters
    ----------
    robot : RobotSpeech
    """

    def __init__(self, robot: RobotSpeech) -> None:
        self._robot = robot
        self._lock = threading.Lock()
        self._words: Deque[Tuple[bool, float]] = deque(maxlen=_MOST_WORDS)
        self._chunks: Deque[_Chunk] = deque(maxlen=_MOST_WORDS)
        self._form = SoundFormat()
        self._stream: Optional[SoundStream] = None
        self._bad: Tuple[str, float] = ("", float("-inf"))
        self._now = 0.0
        self._speaking = rospy.Subscriber("~robot_speaking", Bool, self._on_speaking, queue_size=_MOST_WORDS)
        self._subscribers = [
            self._speaking, rospy.Subscriber("~robot_audio", AudioData, self._on_audio, queue_size=_MOST_WORDS),
            rospy.Subscriber("~robot_audio_info", AudioInfo, self._on_info, queue_size=1)]

    def update(self, now: float) -> None:
        """Tell what has come since the last call. now: s, ROS time."""
        if now < self._now - JUMP_S:
            self._robot.reset()     # time has gone back: what the robot said then is still to come
            self._stream = None
        self._now = now
        with self._lock:
            words, chunks = list(self._words), list(self._chunks)
            self._words.clear()
            self._chunks.clear()
        for speaking, stamp in words:
            self._robot.tell(speaking, stamp)
        for chunk in chunks:
            self._play(chunk)
        self._robot.update(now, self._speaking.get_num_connections() > 0)

    def status(self) -> Status:
        """Return level, message and values for diagnostics."""
        now = rospy.get_time()
        values: Dict[str, object] = {"robot_speaks": self._robot.speaks(now, now)}
        if self._robot.problem:
            return WARN, "{} is no longer believed: {}".format(self._speaking.resolved_name,
                                                               self._robot.problem), values
        if time.monotonic() - self._bad[1] < _BAD_S:
            return WARN, self._bad[0], values
        long_speech = self._robot.long_speech(now)
        if long_speech:
            return WARN, long_speech, values
        return OK, "the robot speaks" if values["robot_speaks"] else "the robot is silent", values

    def close(self) -> None:
        """Unsubscribe. Idempotent."""
        while self._subscribers:
            release(self._subscribers.pop())

    def _play(self, chunk: _Chunk) -> None:
        try:
            if self._stream is None or self._stream.form != self._form:
                self._stream = SoundStream(self._form)
            for block in self._stream.add(chunk.data, chunk.arrival):
                self._robot.play(block.samples.mean(axis=1), block.stamp)
        except SoundError as error:
            self._bad = ("{}: {}".format(rospy.resolve_name("~robot_audio"), error), time.monotonic())
            rospy.logerr_throttle(LOG_PERIOD_S, "%s; such sound is skipped", self._bad[0])

    def _on_speaking(self, message: Bool) -> None:
        with self._lock:
            self._words.append((message.data, rospy.get_time()))

    def _on_audio(self, message: AudioData) -> None:
        with self._lock:
            self._chunks.append(_Chunk(bytes(message.data), rospy.get_time()))

    def _on_info(self, message: AudioInfo) -> None:
        try:
            self._form = SoundFormat(message.channels, message.sample_rate, message.sample_format,
                                     message.coding_format)
        except SoundError as error:
            self._bad = ("{}: {}".format(rospy.resolve_name("~robot_audio_info"), error), time.monotonic())
            rospy.logerr("%s", self._bad[0])
