"""The sample_conversation node: a simulated conversation on the topics of faces and voices, in real time."""

from __future__ import annotations

import threading
from typing import Dict, List

import numpy as np
import rospy
from std_msgs.msg import Bool

from hri_msgs.msg import FacialActionUnits, IdsMatch
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.ids import IdGenerator
from hri_pipeline.core.matching.sample_conversation_parameters import SampleConversationSettings
from hri_pipeline.core.simulation.conversation import (
    RATE_HZ,
    UNSEEN,
    Heard,
    Mouths,
    Turn,
    directions,
    hear,
    make_mouth,
    make_turns,
)
from hri_pipeline.ros.conversions import action_units_to_msg, make_header, match_to_msg, transform_to_msg
from hri_pipeline.ros.publishers import IdPublishers, TopicSpec, TrackedList
from hri_pipeline.ros.rospy_compat import release
from hri_pipeline.ros.tf import TfPublisher

LENGTH_S = 60.0
SENSOR = "sample_sensor"
DISTANCE_M = 2.0
SPREAD, DIRECTION_SD = np.deg2rad(120.0), np.deg2rad(10.0)


class SampleConversationNode:
    """Publishes one conversation after the other; `~speaker` says of each turn whose voice it truly is."""

    def __init__(self, settings: SampleConversationSettings) -> None:
        self._settings = settings
        self._stop = threading.Event()
        self._random = np.random.default_rng(settings.seed)
        self._new_id = IdGenerator().new
        self._faces = IdPublishers("/humans/faces", {"facs": TopicSpec(FacialActionUnits)})
        self._voices = IdPublishers("/humans/voices", {"is_speaking": TopicSpec(Bool, True)})
        self._lists = {kind: TrackedList("/humans/{}/tracked".format(kind)) for kind in ("faces", "voices")}
        self._speaker = rospy.Publisher("~speaker", IdsMatch, latch=True, queue_size=10)
        self._tf = TfPublisher()
        self._said = -1
        self._ids = [self._new_id() for _ in range(settings.people)]
        self._azimuths = SPREAD * (np.arange(settings.people) - 0.5 * (settings.people - 1)) / max(1, settings.people)
        rospy.on_shutdown(self._stop.set)

    def spin(self) -> None:
        """Play until ROS shuts down."""
        for face in self._ids:
            self._faces.open(face)
        self._lists["faces"].set(self._ids, rospy.Time.now())
        while not self._stop.is_set():
            self._play()

    def close(self) -> None:
        """Take everything back. Idempotent."""
        self._stop.set()
        for owner in (*self._lists.values(), self._tf):
            owner.close()
        self._faces.close_all()
        self._voices.close_all()
        release(self._speaker)

    def _play(self) -> None:
        """One conversation, image by image."""
        random, settings = self._random, self._settings
        turns = make_turns(random, settings.people, LENGTH_S, settings.unseen_share)
        mouths = [make_mouth(random, person, turns, LENGTH_S) for person in range(settings.people)]
        heard = hear(random, turns, settings.directions)
        names = {voice: self._new_id() for _, _, voice, _ in heard.tracked}
        times = np.arange(0.0, LENGTH_S, 1.0 / RATE_HZ)
        azimuths = {voice: directions(random, times, self._azimuths[speaker] if speaker != UNSEEN
                                      else random.uniform(-np.pi, np.pi), DIRECTION_SD)
                    for _, _, voice, speaker in heard.tracked}
        began, messages, shown = rospy.get_time(), list(heard.messages), [0] * len(mouths)
        for number, now in enumerate(times):
            while not self._stop.is_set() and rospy.get_time() < began + now:
                self._stop.wait(max(0.001, began + now - rospy.get_time()))
            if self._stop.is_set() or rospy.get_time() < began - 1.0:
                return      # the clock went back
            stamp = rospy.Time.now()
            tracked = self._track(heard, names, now, stamp)
            while messages and messages[0][0] <= now:
                _, voice, speaking = messages.pop(0)
                if voice in tracked:
                    self._voices.publish(names[voice], "is_speaking", Bool(speaking))
            self._show(mouths, shown, now, stamp)
            frames = {"face_" + face: azimuth for face, azimuth in zip(self._ids, self._azimuths)}
            if settings.directions:
                frames.update(("voice_" + names[voice], azimuths[voice][number]) for voice in tracked)
            self._tf.send([transform_to_msg(Pose(np.eye(3),
                                                 DISTANCE_M * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])),
                                            stamp, SENSOR, frame) for frame, azimuth in frames.items()])
            self._tell(turns, heard, names, now)

    def _track(self, heard: Heard, names: Dict[str, str], now: float, stamp: rospy.Time) -> List[str]:
        """Open and close voices; returns those that are tracked now."""
        tracked = [voice for start, end, voice, _ in heard.tracked if start <= now <= end]
        wanted = [names[voice] for voice in tracked]
        for name in wanted:
            if name not in self._voices.ids:
                self._voices.open(name)
        self._lists["voices"].set(wanted, stamp)
        for name in self._voices.ids:
            if name not in wanted:
                self._voices.close(name)
        return tracked

    def _show(self, mouths: List[Mouths], shown: List[int], now: float, stamp: rospy.Time) -> None:
        """Publish the action units of each face, where there are some at that time."""
        for person, (face, mouth) in enumerate(zip(self._ids, mouths)):
            last = int(np.searchsorted(mouth.stamps, now, side="right"))
            if last > shown[person]:
                shown[person] = last
                values, certain = np.zeros(99), np.zeros(99)
                values[[25, 26]] = mouth.lips_part[last - 1], mouth.jaw_drop[last - 1]
                certain[[25, 26]] = mouth.confidence[last - 1]
                self._faces.publish(face, "facs", action_units_to_msg(values, certain, make_header(stamp, SENSOR)))

    def _tell(self, turns: List[Turn], heard: Heard, names: Dict[str, str], now: float) -> None:
        """Say at the beginning of a turn whose voice it is; nobody's in view: the likelihood is 0."""
        number = next((number for number, turn in enumerate(turns) if turn.start <= now <= turn.end), -1)
        if number not in (-1, self._said):
            speaker = turns[number].speaker
            seen = speaker != UNSEEN
            self._speaker.publish(match_to_msg(names[heard.voice_of_turn[number]], IdsMatch.VOICE,
                                               self._ids[speaker] if seen else "", IdsMatch.FACE, float(seen)))
        self._said = number
