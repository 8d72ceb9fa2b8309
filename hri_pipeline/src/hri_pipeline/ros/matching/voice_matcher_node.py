"""The voice_matcher node: mouths, directions and voices in, candidate matches out."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import List, Optional, Tuple

import rospy
from std_msgs.msg import Bool

from hri_msgs.msg import IdsMatch
from hri_pipeline.core.announcing import Announcer
from hri_pipeline.core.matching.voice_matching import FACE, VoiceMatcher
from hri_pipeline.core.timing import StageTimes
from hri_pipeline.ros.conversions import match_to_msg
from hri_pipeline.ros.diagnostics import OK, WARN
from hri_pipeline.ros.feature_feed import FeatureFeed
from hri_pipeline.ros.matching.matcher_base import MatcherBase
from hri_pipeline.ros.matching.voice_surroundings import STALE_S, VoiceSurroundings

IDLE_S = 0.25
DIAGNOSTICS_S = 1.0
CONFIDENCE_STEP = 0.1       # a likelihood that changes by less is said once a second only
JUMP_BACK_S = 0.5


class VoiceMatcherNode(MatcherBase):
    """Publishes on /humans/candidate_matches whose voice it is.

    Callbacks only hand over; the caller of spin() compares while somebody speaks. To faces and transforms the node
    listens only while there is a voice, and a little longer.
    """

    def __init__(self, settings: SimpleNamespace) -> None:
        super().__init__(settings)
        self._matcher = VoiceMatcher(settings)
        self._announcer: Announcer[Tuple[str, str, str]] = Announcer(CONFIDENCE_STEP)
        self._around: Optional[VoiceSurroundings] = None
        self._heard_at = float("-inf")
        self._last_now = 0.0
        self._next_report = 0.0
        self._matched = 0
        self._times = StageTimes()
        self._voices = FeatureFeed("voices", {"is_speaking": Bool}, self._on_speaking, self._on_voices)

    def spin(self) -> None:
        """Compare and publish until ROS shuts down."""
        while not self._stop.is_set():
            self._news.wait(IDLE_S)
            self._news.clear()
            self._listen()
            with self._lock:
                self._compare()
                busy = self._matcher.is_busy
            self._report()
            if busy:
                self._stop.wait(self._settings.period)
                self._news.set()

    def _close_inputs(self) -> None:
        self._voices.close()
        if self._around is not None:
            self._around.close()

    def _withdraw_all(self) -> None:
        self._publish(self._announcer.withdraw_all())

    def _on_voices(self, ids: List[str]) -> None:
        with self._lock:
            self._matcher.set_tracked("voices", ids)
            if self._around is not None:
                self._around.follow_voices(ids)
        self._news.set()

    def _on_speaking(self, voice: str, name: str, message: Bool) -> None:
        with self._lock:
            # The subscription to a voice may be faster than the callback of the list that it is in.
            if voice not in self._matcher.voices:
                self._matcher.set_tracked("voices", self._matcher.voices + [voice])
            self._matcher.on_speaking(voice, message.data, rospy.get_time())
        self._news.set()

    def _listen(self) -> None:
        """Open and close what is only needed while there are voices."""
        now = time.monotonic()
        with self._lock:
            voices = self._matcher.voices
        if voices:
            self._heard_at = now
        wanted = bool(voices) or now - self._heard_at <= self._settings.linger_time
        if wanted and self._around is None:
            around = VoiceSurroundings(self._matcher, self._lock, self._news.set)
            with self._lock:
                around.follow_voices(self._matcher.voices)
                self._around = around
        elif not wanted and self._around is not None:
            around, self._around = self._around, None
            around.close()
        if self._around is not None:
            self._around.choose_sources(rospy.get_time())

    def _compare(self) -> None:
        now = rospy.get_time()
        if now < self._last_now - JUMP_BACK_S and self._around is not None:
            self._around.forget()
        self._last_now = now
        if self._matcher.is_busy:
            with self._times("compare"):
                if self._around is not None:
                    self._around.look(now)
                matches = self._matcher.matches(now)
        else:
            matches = self._matcher.matches(now)
        self._publish(self._announcer.to_say(
            {(match.voice, match.kind, match.id): match.confidence for match in matches}, time.monotonic(), self._matcher.has_left))
        self._matched = len(matches)

    def _publish(self, matches: List[Tuple[Tuple[str, str, str], float]]) -> None:
        for (voice, kind, id), likelihood in matches:
            self._publisher.publish(match_to_msg(voice, IdsMatch.VOICE, id,
                                                 IdsMatch.FACE if kind == FACE else IdsMatch.PERSON, likelihood))

    def _report(self) -> None:
        if time.monotonic() < self._next_report:
            return
        self._next_report = time.monotonic() + DIAGNOSTICS_S
        values = {"voices": len(self._matcher.voices), "matched": self._matched, "listening": self._around is not None}
        values.update(self._times.values())
        level, text = OK, "%d of %d voices matched" % (self._matched, values["voices"])
        self._diagnostics.set("voices", *self._voices.status())
        if self._around is not None:
            for task, status in self._around.statuses().items():
                self._diagnostics.set(task, *status)
            if self._around.unconnected:
                level, text = WARN, "{}; directions are not used".format(self._around.unconnected)
            elif abs(self._around.age) > STALE_S:
                level, text = WARN, "images of faces are {:.1f} s away from the clock; mouths are not compared. Is " \
                    "use_sim_time set?".format(self._around.age)
        self._diagnostics.set("matches", level, text, values)
