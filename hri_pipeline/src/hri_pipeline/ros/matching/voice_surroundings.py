"""Who is there while somebody speaks: mouths and places of faces, places of persons and of voices."""

from __future__ import annotations

import threading
from typing import Callable, Dict, List, Optional, Tuple

import genpy
import numpy as np
import rospy
from std_msgs.msg import String

from hri_msgs.msg import FacialActionUnits, IdsList
from hri_pipeline.core.frame_tree import is_of_human
from hri_pipeline.core.human_places import HumanPlaces
from hri_pipeline.core.ids import is_valid_id
from hri_pipeline.core.matching.mouth_motion import opening_of_landmarks, opening_of_units
from hri_pipeline.core.matching.voice_matching import VoiceMatcher
from hri_pipeline.core.tf_scan import read
from hri_pipeline.ros.conversions import action_units_from_msg, landmarks_from_msg
from hri_pipeline.ros.feature_feed import FeatureFeed
from hri_pipeline.ros.landmark_array import LandmarkArray
from hri_pipeline.ros.robot_frames import SKELETONS, RobotFrames
from hri_pipeline.ros.tf_feed import Frames, TfFeed
from hri_pipeline.ros.topic_release import release

WITHOUT_UNITS_S = 1.5
"""A face of which no action units come for so long is followed by its landmarks."""
STALE_S = 2.0
MAX_KNOWN = 1000
Status = Tuple[int, str, Dict[str, object]]


class VoiceSurroundings:
    """Listens to faces, persons and transforms, and hands them to the matcher, under `lock`.

    Made when a voice begins and closed when nobody has spoken for a while: all of this comes many times a second.
    """

    def __init__(self, matcher: VoiceMatcher, lock: threading.Lock, on_news: Callable[[], None]) -> None:
        self._matcher, self._lock, self._on_news = matcher, lock, on_news
        self._places = HumanPlaces()
        self._robot = RobotFrames("map")
        self._seen: Dict[str, float] = {}
        self._persons: Dict[str, Dict[str, str]] = {}
        self._known_ids: List[str] = []
        self._landmarks: Optional[FeatureFeed] = None
        self.age = 0.0
        self.unconnected = ""
        self._faces = FeatureFeed("faces", {"facs": FacialActionUnits}, self._on_units, self._on_faces)
        self._people = FeatureFeed("persons", {"face_id": String, "voice_id": String}, self._on_person, self._on_persons)
        self._known = rospy.Subscriber("/humans/persons/known", IdsList, self._on_known, queue_size=1)
        self._transforms = TfFeed(self._on_frames, skip=SKELETONS)

    def follow_voices(self, ids: List[str]) -> None:
        """Follow the directions of these voices. The caller holds the lock."""
        self._places.follow("voice", ids)

    def look(self, now: float) -> None:
        """Tell the matcher where voices, faces and persons are at time `now` (s). The caller holds the lock."""
        self.unconnected = ""
        places = self._places.all(now)
        for voice in self._matcher.voices:
            heard = self._places.get("voice", voice, now)
            if heard is None or not any(heard.position):
                self._matcher.set_direction(voice, None, {})
                continue
            poses = {place.frame: self._robot.between(heard.frame, place.frame, genpy.Time(place.secs, place.nsecs))
                     for place in places.values()}
            self.unconnected = next(("no transform between {} and {}".format(heard.frame, frame)
                                     for frame, pose in poses.items() if pose is None), self.unconnected)
            self._matcher.set_direction(voice, heard.position, {
                key: poses[place.frame].apply(np.array([place.position]))[0] for key, place in places.items()
                if poses[place.frame] is not None})

    def choose_sources(self, now: float) -> None:
        """Listen to landmarks while a face has no action units. Without the lock: topics open and close here."""
        with self._lock:
            lacking = [face for face in self._seen if self._lacks_units(face, now)]
        if lacking and self._landmarks is None:
            self._landmarks = FeatureFeed("faces", {"landmarks": LandmarkArray}, self._on_landmarks)
        elif not lacking and self._landmarks is not None:
            self._landmarks.close()
            self._landmarks = None

    def forget(self) -> None:
        """Forget places and mouths, as after a jump of time. The caller holds the lock."""
        self._places.clear()
        self._robot.reset()
        self._seen = dict.fromkeys(self._seen, rospy.get_time())

    def statuses(self) -> Dict[str, Status]:
        """Return level, message and values for diagnostics, by task."""
        return {"faces": self._faces.status(), "persons": self._people.status()}

    def close(self) -> None:
        """Let go of all topics. Idempotent."""
        for feed in (self._faces, self._people, self._transforms, self._landmarks):
            if feed is not None:
                feed.close()
        release(self._known)
        with self._lock:
            self._matcher.set_tracked("faces", [])
            self._matcher.set_persons({})
            # This object waits for the garbage collector, what it holds need not.
            self._places.clear()
            self._robot.reset()

    def _on_faces(self, ids: List[str]) -> None:
        with self._lock:
            now = rospy.get_time()
            self._seen = {face: self._seen.get(face, now) for face in ids}
            self._matcher.set_tracked("faces", ids)
            self._places.follow("face", ids)
        self._on_news()

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

    def _lacks_units(self, face: str, now: float) -> bool:
        return face in self._seen and now - self._seen[face] > WITHOUT_UNITS_S

    def _add(self, face: str, stamp: float, opening: float, weight: float) -> None:
        self.age = rospy.get_time() - stamp
        self._matcher.add_mouth(face, stamp, opening, weight)

    def _on_persons(self, ids: List[str]) -> None:
        with self._lock:
            self._persons = {id: self._persons.get(id, {}) for id in ids}
            self._tell_persons()

    def _on_known(self, message: IdsList) -> None:
        """Those who are not seen any more have a frame as long as their place means something."""
        with self._lock:
            self._known_ids = [id for id in message.ids if is_valid_id(id)][-MAX_KNOWN:]
            self._tell_persons()

    def _on_person(self, id: str, name: str, message: String) -> None:
        with self._lock:
            if id in self._persons:
                self._persons[id][name] = message.data
                self._tell_persons()

    def _tell_persons(self) -> None:
        lost = [id for id in self._known_ids if id not in self._persons]
        self._places.follow("person", [*self._persons, *lost])
        self._matcher.set_persons({id: (values["face_id"], values["voice_id"]) for id, values in self._persons.items()
                                   if len(values) == 2}, lost)

    def _on_frames(self, data: bytes, frames: Frames, fixed: bool) -> None:
        with self._lock:
            for child, offset in frames:
                if self._places.wants(child):
                    self._places.put(read(data, offset))
                elif not is_of_human(child, fixed):
                    self._robot.put(read(data, offset), fixed)
