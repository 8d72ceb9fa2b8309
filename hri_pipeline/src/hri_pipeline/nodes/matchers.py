"""The nodes face_body_matcher and voice_matcher, which publish on /humans/candidate_matches who belongs together.

Callbacks only store; the loop of each node, spin(), compares and publishes.
"""

from __future__ import annotations

import math
import threading
import time
import traceback
from abc import ABC, abstractmethod
from typing import Callable, Dict, Iterable, List, Optional, Tuple, Union

import genpy
import numpy as np
import rospy
from std_msgs.msg import Bool, String

from hri_msgs.msg import FacialActionUnits, IdsList, IdsMatch
from hri_pipeline.core.frames import HumanTf, RawTransform, is_of_human, read
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.ids import is_valid_id
from hri_pipeline.core.matching.changes import MatchChanges
from hri_pipeline.core.matching.face_body import FaceBodyMatcher, Pair
from hri_pipeline.core.matching.parameters import FaceBodyMatcherSettings, VoiceMatcherSettings
from hri_pipeline.core.matching.voice import FACE, VoiceMatcher, opening_of_landmarks, opening_of_units
from hri_pipeline.core.process import share_arenas
from hri_pipeline.core.timing import JUMP_BACK_S, StageTimes, clock_fault
from hri_pipeline.ros.conversions import (
    LandmarkArray,
    SkeletonArray,
    action_units_from_msg,
    landmarks_from_msg,
    match_to_msg,
    skeleton_from_msg,
)
from hri_pipeline.ros.diagnostics import ERROR, OK, WARN, NodeDiagnostics, Status
from hri_pipeline.ros.publishers import MATCHES_TOPIC
from hri_pipeline.ros.rospy_compat import release
from hri_pipeline.ros.subscriptions import IdSubscribers
from hri_pipeline.ros.tf import SKELETONS, Frames, RobotTf, TfSubscriber

IDLE_S = 0.25
DIAGNOSTICS_S = 1.0
LOG_PERIOD_S = 10.0
FACE_BODY_STEP, VOICE_STEP = 0.05, 0.1
"""A likelihood that changes by less is published once a second only."""
FRESH_S = 2.0
"""An older transform is not where somebody is; person_ID is repeated as long as it means something."""
WITHOUT_UNITS_S = 1.5
"""A face of which no action units come for so long is followed by its landmarks."""
STALE_S = 2.0
MAX_KNOWN = 1000
_MOTION_QUEUE = 10      # messages of a face at a time: its mouth is compared with the voice over time


class MatcherBase(ABC):
    """Publishes on /humans/candidate_matches.

    What comes in is stored under `_lock`, and `_changed` wakes the loop until `_stop`.
    """

    _matcher: Union[FaceBodyMatcher, VoiceMatcher]
    GATHER_S = 0.0
    """Time from the first message to the comparison; also the shortest between two comparisons."""

    def __init__(self, settings: Union[FaceBodyMatcherSettings, VoiceMatcherSettings]) -> None:
        self._settings = settings
        self._lock = threading.Lock()
        self._changed = threading.Event()
        self._stop = threading.Event()
        self._publisher = rospy.Publisher(MATCHES_TOPIC, IdsMatch, queue_size=100)
        self._diagnostics = NodeDiagnostics(rospy.get_name())
        share_arenas()
        rospy.on_shutdown(self._end)

    def spin(self) -> None:
        """Compare and publish until ROS shuts down."""
        while not self._stop.is_set():
            if self._changed.wait(IDLE_S):
                self._stop.wait(self.GATHER_S)
            self._changed.clear()
            try:
                self._cycle()
            except Exception as error:  # one bad message does not end the node
                self._diagnostics.set("matches", ERROR, "{}: {}".format(type(error).__name__, error))
                rospy.logerr_throttle(LOG_PERIOD_S, "matches are not compared:\n%s", traceback.format_exc())

    def reconfigure(self, settings: Union[FaceBodyMatcherSettings, VoiceMatcherSettings]) -> None:
        """Apply the values of the live parameters between two comparisons."""
        with self._lock:
            self._settings = settings
            self._matcher.reconfigure(settings)
        self._changed.set()

    def close(self) -> None:
        """Withdraw all matches and close all topics. Idempotent."""
        self._end()
        self._close_inputs()
        with self._lock:
            self._withdraw_all()
        self._diagnostics.close()
        release(self._publisher)

    @abstractmethod
    def _cycle(self) -> None:
        """Compare, publish and report once."""

    @abstractmethod
    def _close_inputs(self) -> None:
        """Close the subscribers."""

    @abstractmethod
    def _withdraw_all(self) -> None:
        """Publish likelihood 0 for every match that was published. Called with the lock held."""

    def _end(self) -> None:
        self._stop.set()
        self._changed.set()


class FaceBodyMatcherNode(MatcherBase):
    """Publishes on /humans/candidate_matches which face and body belong to the same human.

    Callbacks only store; the caller of spin() compares soon after something has come in.
    """

    GATHER_S = 0.04     # skeletons of one image come one by one

    def __init__(self, settings: FaceBodyMatcherSettings) -> None:
        super().__init__(settings)
        self._matcher = FaceBodyMatcher(settings)
        self._changes: MatchChanges[Pair] = MatchChanges(FACE_BODY_STEP)
        self._last_diagnostics = 0.0
        self._image, self._awaited = math.nan, False    # the last image of faces, and whether a body waited for it
        self._feeds = [
            IdSubscribers("faces", {"landmarks": LandmarkArray}, self._on_landmarks, self._tracked("faces"),
                          list_timeout=settings.list_timeout),
            IdSubscribers("bodies", {"skeleton2d": SkeletonArray}, self._on_skeleton, self._tracked("bodies"),
                          list_timeout=settings.list_timeout)]
        self._transforms = TfSubscriber(self._on_frames)

    def _cycle(self) -> None:
        with self._lock:
            matches = self._matcher.matches()
            self._publish(self._changes.update({(match.face, match.body): match.confidence for match in matches},
                                               time.monotonic(), self._matcher.has_left))
        self._report(len(matches))

    def _close_inputs(self) -> None:
        for feed in self._feeds:
            feed.close()
        self._transforms.close()

    def _withdraw_all(self) -> None:
        self._publish(self._changes.withdraw_all())

    def _tracked(self, kind: str):
        def on_tracked(ids: List[str]) -> None:
            with self._lock:
                self._matcher.set_tracked(kind, ids)
            self._changed.set()
        return on_tracked

    def _on_landmarks(self, identity: str, name: str, message: genpy.Message) -> None:
        points, stamp = landmarks_from_msg(message), message.header.stamp.to_sec()
        aspect = message.width / message.height if message.height else 0.0
        with self._lock:
            self._matcher.add_face(identity, stamp, points, aspect, message.header.frame_id)
            if stamp != self._image:
                self._image, self._awaited = stamp, self._matcher.awaits_faces
            awaited = self._awaited
        # On a busy machine bodies come less often than faces: most images of faces change nothing.
        if awaited:
            self._changed.set()

    def _on_skeleton(self, identity: str, name: str, message: genpy.Message) -> None:
        points = skeleton_from_msg(message)
        with self._lock:
            self._matcher.add_body(identity, message.header.stamp.to_sec(), points, message.header.frame_id)
        self._changed.set()

    def _on_frames(self, data: bytes, frames: Frames, fixed: bool) -> None:
        with self._lock:
            self._matcher.add_transforms(data, frames, fixed)

    def _publish(self, matches: List[Tuple[Pair, float]]) -> None:
        for (face, body), likelihood in matches:
            self._publisher.publish(match_to_msg(face, IdsMatch.FACE, body, IdsMatch.BODY, likelihood))

    def _report(self, matched: int) -> None:
        if time.monotonic() - self._last_diagnostics < DIAGNOSTICS_S:
            return
        self._last_diagnostics = time.monotonic()
        self._diagnostics.set("matches", OK, "%d faces matched to bodies" % matched, {"matched": matched})
        for kind, feed in zip(("faces", "bodies"), self._feeds):
            self._diagnostics.set(kind, *feed.status(optional=True))


class VoiceMatcherNode(MatcherBase):
    """Publishes on /humans/candidate_matches whose voice it is.

    Callbacks only store; the caller of spin() compares while somebody speaks. To faces and transforms the node
    listens only while there is a voice, and a little longer.
    """

    def __init__(self, settings: VoiceMatcherSettings) -> None:
        super().__init__(settings)
        self._matcher = VoiceMatcher(settings)
        self._changes: MatchChanges[Tuple[str, str, str]] = MatchChanges(VOICE_STEP)
        self._context: Optional[VoiceContext] = None
        self._heard_at = float("-inf")
        self._last_now = 0.0
        self._next_report = 0.0
        self._matched = 0
        self._times = StageTimes()
        self._voices = IdSubscribers("voices", {"is_speaking": Bool}, self._on_speaking, self._on_voices,
                                     list_timeout=settings.list_timeout)

    def _cycle(self) -> None:
        self._listen()
        with self._lock:
            self._compare()
            busy = self._matcher.is_busy
        self._report()
        if busy:
            self._stop.wait(self._settings.period)
            self._changed.set()

    def _close_inputs(self) -> None:
        self._voices.close()
        if self._context is not None:
            self._context.close()

    def _withdraw_all(self) -> None:
        self._publish(self._changes.withdraw_all())

    def _on_voices(self, ids: List[str]) -> None:
        with self._lock:
            self._matcher.set_tracked("voices", ids)
            if self._context is not None:
                self._context.follow_voices(ids)
        self._changed.set()

    def _on_speaking(self, voice: str, name: str, message: Bool) -> None:
        with self._lock:
            # The subscription to a voice may be faster than the callback of the list that it is in.
            if voice not in self._matcher.voices:
                self._matcher.set_tracked("voices", self._matcher.voices + [voice])
            self._matcher.on_speaking(voice, message.data, rospy.get_time())
        self._changed.set()

    def _listen(self) -> None:
        """Open and close what is only needed while there are voices."""
        now = time.monotonic()
        with self._lock:
            voices = self._matcher.voices
        if voices:
            self._heard_at = now
        wanted = bool(voices) or now - self._heard_at <= self._settings.linger_time
        if wanted and self._context is None:
            context = VoiceContext(self._matcher, self._lock, self._changed.set, self._settings.list_timeout)
            with self._lock:
                context.follow_voices(self._matcher.voices)
                self._context = context
        elif not wanted and self._context is not None:
            context, self._context = self._context, None
            context.close()
        if self._context is not None:
            self._context.choose_sources(rospy.get_time())

    def _compare(self) -> None:
        now = rospy.get_time()
        if now < self._last_now - JUMP_BACK_S and self._context is not None:
            self._context.forget()
        self._last_now = now
        if self._matcher.is_busy:
            with self._times("compare"):
                if self._context is not None:
                    self._context.locate(now)
                matches = self._matcher.matches(now)
        else:
            matches = self._matcher.matches(now)
        self._publish(self._changes.update(
            {(match.voice, match.kind, match.id): match.confidence for match in matches}, time.monotonic(),
            self._matcher.has_left))
        self._matched = len(matches)

    def _publish(self, matches: List[Tuple[Tuple[str, str, str], float]]) -> None:
        for (voice, kind, id), likelihood in matches:
            self._publisher.publish(match_to_msg(voice, IdsMatch.VOICE, id,
                                                 IdsMatch.FACE if kind == FACE else IdsMatch.PERSON, likelihood))

    def _report(self) -> None:
        if time.monotonic() < self._next_report:
            return
        self._next_report = time.monotonic() + DIAGNOSTICS_S
        values = {"voices": len(self._matcher.voices), "matched": self._matched, "listening": self._context is not None}
        values.update(self._times.values())
        level, text = OK, "%d of %d voices matched" % (self._matched, values["voices"])
        self._diagnostics.set("voices", *self._voices.status())
        if self._context is not None:
            for task, status in self._context.statuses().items():
                self._diagnostics.set(task, *status)
            if self._context.unconnected:
                level, text = WARN, "{}; directions are not used".format(self._context.unconnected)
            elif abs(self._context.age) > STALE_S:
                level, text = WARN, "images of faces are {}; mouths are not compared; {}".format(*clock_fault(
                    self._context.age, rospy.get_time(), time.time(), not rospy.rostime.is_wallclock()))
        self._diagnostics.set("matches", level, text, values)


class VoiceContext:
    """The observed context of a voice: subscribes to faces, persons and transforms, and gives them to the matcher,
    under `lock`.

    Made when a voice begins and closed when nobody has spoken for a while: all of this comes many times a second.
    """

    def __init__(self, matcher: VoiceMatcher, lock: threading.Lock, on_change: Callable[[], None],
                 list_timeout: float) -> None:
        """list_timeout: see IdSubscribers."""
        self._matcher, self._lock, self._on_change = matcher, lock, on_change
        self._tf = HumanTf()
        self._robot = RobotTf("map")
        self._seen: Dict[str, float] = {}
        self._persons: Dict[str, Dict[str, str]] = {}
        self._known_ids: List[str] = []
        self._landmarks: Optional[IdSubscribers] = None
        self.age = 0.0
        self.unconnected = ""
        self._list_timeout = list_timeout
        self._faces = IdSubscribers("faces", {"facs": FacialActionUnits}, self._on_units, self._on_faces,
                                    list_timeout=list_timeout, queue_size=_MOTION_QUEUE)
        self._people = IdSubscribers("persons", {"face_id": String, "voice_id": String}, self._on_person,
                                     self._on_persons, list_timeout=list_timeout)
        self._known = rospy.Subscriber("/humans/persons/known", IdsList, self._on_known, queue_size=1)
        self._transforms = TfSubscriber(self._on_frames, skip=SKELETONS)

    def follow_voices(self, ids: List[str]) -> None:
        """Follow the directions of these voices. The caller holds the lock."""
        self._tf.follow(voice=ids)

    def locate(self, now: float) -> None:
        """Give the matcher the places of voices, faces and persons at time `now` (s). The caller holds the lock."""
        self.unconnected = ""
        heard = self._tf.fresh("voice", now, FRESH_S)
        places = {(kind, identity): place for kind in ("face", "person") for identity,
                  place in self._tf.fresh(kind, now, FRESH_S).items()}
        for voice in self._matcher.voices:
            if voice not in heard or not any(heard[voice].translation):
                self._matcher.set_direction(voice, None, {})
                continue
            poses = self._poses(heard[voice].parent, places.values())
            self._matcher.set_direction(voice, heard[voice].translation, {
                key: poses[place.parent].apply(np.array([place.translation]))[0] for key, place in places.items()
                if place.parent in poses})

    def choose_sources(self, now: float) -> None:
        """Listen to landmarks while a face has no action units. Without the lock: topics open and close here."""
        with self._lock:
            lacking = [face for face in self._seen if self._lacks_units(face, now)]
        if lacking and self._landmarks is None:
            self._landmarks = IdSubscribers("faces", {"landmarks": LandmarkArray}, self._on_landmarks,
                                            list_timeout=self._list_timeout, queue_size=_MOTION_QUEUE)
        elif not lacking and self._landmarks is not None:
            self._landmarks.close()
            self._landmarks = None

    def forget(self) -> None:
        """Forget places and mouths, as after a jump of time. The caller holds the lock."""
        self._tf.clear_moving()
        self._robot.reset()
        self._seen = dict.fromkeys(self._seen, rospy.get_time())

    def statuses(self) -> Dict[str, Status]:
        """Return level, message and values for diagnostics, by task."""
        return {"faces": self._faces.status(optional=True), "persons": self._people.status()}

    def close(self) -> None:
        """Close all topics. Idempotent."""
        for feed in (self._faces, self._people, self._transforms, self._landmarks):
            if feed is not None:
                feed.close()
        release(self._known)
        with self._lock:
            self._matcher.set_tracked("faces", [])
            self._matcher.set_persons({})
            # The frames are freed now; this object only when the garbage collector runs.
            self._tf = HumanTf()
            self._robot.close()

    def _on_faces(self, ids: List[str]) -> None:
        with self._lock:
            now = rospy.get_time()
            self._seen = {face: self._seen.get(face, now) for face in ids}
            self._matcher.set_tracked("faces", ids)
            self._tf.follow(face=ids)
        self._on_change()

    def _on_units(self, face: str, name: str, message: FacialActionUnits) -> None:
        opening, weight = opening_of_units(*action_units_from_msg(message))
        with self._lock:
            if weight > 0.0 and face in self._seen:
                self._seen[face] = rospy.get_time()
            self._add(face, message.header.stamp.to_sec(), opening, weight)

    def _on_landmarks(self, face: str, name: str, message: LandmarkArray) -> None:
        points = landmarks_from_msg(message)
        if not message.height or not message.width:
            raise ValueError("landmarks without the size of their image")
        with self._lock:
            # Both at once would look like a motion.
            if self._lacks_units(face, rospy.get_time()):
                self._add(face, message.header.stamp.to_sec(),
                          *opening_of_landmarks(points, message.width / message.height))

    def _poses(self, target: str, places: Iterable[RawTransform]) -> Dict[str, Pose]:
        """Return the poses of the sensors that see these places in the frame `target`, as far as they are known."""
        poses = {}
        for sensor, place in {place.parent: place for place in places}.items():
            pose = self._robot.between(target, sensor, genpy.Time(place.secs, place.nsecs))
            if pose is not None:
                poses[sensor] = pose
            else:
                self.unconnected = "no transform between {} and {}".format(target, sensor)
        return poses

    def _lacks_units(self, face: str, now: float) -> bool:
        return face in self._seen and now - self._seen[face] > WITHOUT_UNITS_S

    def _add(self, face: str, stamp: float, opening: float, weight: float) -> None:
        self.age = rospy.get_time() - stamp
        self._matcher.add_mouth(face, stamp, opening, weight)

    def _on_persons(self, ids: List[str]) -> None:
        with self._lock:
            self._persons = {id: self._persons.get(id, {}) for id in ids}
            self._update_persons()

    def _on_known(self, message: IdsList) -> None:
        """People who are not seen any more keep a frame for as long as their last place is useful."""
        with self._lock:
            self._known_ids = [id for id in message.ids if is_valid_id(id)][-MAX_KNOWN:]
            self._update_persons()

    def _on_person(self, id: str, name: str, message: String) -> None:
        with self._lock:
            # What is latched there may be faster than the callback of the list that the person is in.
            self._persons.setdefault(id, {})[name] = message.data
            self._update_persons()

    def _update_persons(self) -> None:
        lost = [id for id in self._known_ids if id not in self._persons]
        self._tf.follow(person=[*self._persons, *lost])
        self._matcher.set_persons({id: (values["face_id"], values["voice_id"]) for id, values in self._persons.items()
                                   if len(values) == 2}, lost)

    def _on_frames(self, data: bytes, frames: Frames, fixed: bool) -> None:
        with self._lock:
            for child, offset in frames:
                if self._tf.wants(child.lstrip(b"/")):
                    if self._tf.put(read(data, offset), fixed=False) is None:
                        raise ValueError("numbers that are not finite, or a quaternion of zeros")
                elif not is_of_human(child, fixed):
                    self._robot.put(read(data, offset), fixed)
