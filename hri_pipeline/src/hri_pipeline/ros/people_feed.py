"""Gathers the people from the graph: who is tracked, what they consist of, their frames, and the robot's."""

from __future__ import annotations

import math
import threading
import time
from types import SimpleNamespace
from typing import Dict, List, Mapping, NamedTuple, Optional, Tuple

import genpy
from std_msgs.msg import String

from hri_msgs.msg import FacialActionUnits
from hri_pipeline.core.frame_tree import is_of_human
from hri_pipeline.core.ids import is_valid_id
from hri_pipeline.core.interactions.crowd import Crowd
from hri_pipeline.core.interactions.people_frames import PeopleFrames
from hri_pipeline.core.interactions.people_gather import Places, Seen, gather
from hri_pipeline.core.tf_scan import read, read_stamp
from hri_pipeline.ros.feature_feed import FeatureFeed
from hri_pipeline.ros.robot_frames import RobotFrames
from hri_pipeline.ros.tf_feed import Frames, TfFeed

MAX_PEOPLE = 100
JUMP_BACK_S = 0.5
AU_EYES_CLOSED, AU_BLINK = 43, 45
_STAMPED_BY = (b"face_", b"body_")
_STALE_S = 0.5
_Newest = Tuple[bool, int, int]


class Moment(NamedTuple):
    """Everybody at the stamp of the newest image; unplaced: ids of those who are tracked, but have no place."""

    stamp: genpy.Time
    people: Crowd
    unplaced: List[str]


class PeopleFeed:
    """Hears lists, features and transforms; `news` is set when frames with a newer stamp have come.

    Callbacks only store; take() makes the crowd.
    """

    def __init__(self, settings: SimpleNamespace, robot: RobotFrames) -> None:
        """robot: takes the frames that are no human's."""
        self._settings, self._robot = settings, robot
        self._lock = threading.Lock()
        self._frames = PeopleFrames()
        self._lids: Dict[str, Seen] = {}
        self._newest, self._newest_person = genpy.Time(), genpy.Time()
        self._newer_at, self._measured_at = 0.0, -math.inf
        self.news = threading.Event()
        self.refused = self.jumps = 0
        self._feeds = {"persons": FeatureFeed("persons", {"face_id": String, "body_id": String}, self._on_feature,
                                              self._on_people, max_ids=MAX_PEOPLE)}
        if settings.use_facs:
            self._feeds["faces"] = FeatureFeed("faces", {"facs": FacialActionUnits}, self._on_facs, self._on_faces,
                                               max_ids=MAX_PEOPLE)
        self._ears = TfFeed(self._on_frames)

    @property
    def stamp(self) -> genpy.Time:
        """Stamp of the newest frame of a face or a body; of a person's where these have ended."""
        with self._lock:
            return self._stamp()

    @property
    def ids(self) -> List[str]:
        """Who is tracked."""
        with self._lock:
            return list(self._frames.people)

    @property
    def feeds(self) -> Mapping[str, FeatureFeed]:
        """The feeds by kind, for diagnostics."""
        return self._feeds

    def take(self, places: Places) -> Moment:
        """Return everybody at the newest stamp, in the frame that `places` is about."""
        with self._lock:
            stamp = self._stamp()
            people = gather(self._frames, places, stamp.to_sec(), self._settings, self._lids)
            tracked = self._frames.people
            placed = set(people.ids) if len(people) < len(tracked) else tracked
            return Moment(stamp, people, [identity for identity in tracked if identity not in placed])

    def reset(self) -> None:
        """Forget all moving frames: time has jumped back."""
        with self._lock:
            self._forget()

    def status(self) -> Dict[str, object]:
        """Return how much is kept, for diagnostics."""
        with self._lock:
            return {"human frames": len(self._frames), "robot frames": self._robot.known,
                    "frames with history": len(self._robot.relevant),
                    "transforms refused": self.refused + self._frames.refused,
                    "messages refused": self._ears.refused, "time jumps": self.jumps}

    def close(self) -> None:
        """Let go of all topics. Idempotent."""
        for feed in self._feeds.values():
            feed.close()
        self._ears.close()

    def _stamp(self) -> genpy.Time:
        # The frames of persons who are not seen at the moment are sent again with the time of the clock.
        apart = (self._newest_person - self._newest).to_sec()
        return self._newest_person if apart > self._settings.frame_timeout else self._newest

    def _on_people(self, ids: List[str]) -> None:
        with self._lock:
            if list(self._frames.people) != ids:
                self._frames.set_people(ids)
        self.news.set()

    def _on_feature(self, person: str, name: str, message: String) -> None:
        value = message.data
        if value and not is_valid_id(value):
            raise ValueError("{!r} is not an id".format(value[:40]))
        with self._lock:
            self._frames.set_feature(person, "face" if name == "face_id" else "body", value)

    def _on_faces(self, ids: List[str]) -> None:
        with self._lock:
            self._lids = {face: seen for face, seen in self._lids.items() if face in ids}

    def _on_facs(self, face: str, name: str, message: FacialActionUnits) -> None:
        if min(len(message.intensity), len(message.confidence)) <= AU_BLINK:
            raise ValueError("action units without number {}".format(AU_BLINK))
        closed = max((message.intensity[unit] for unit in (AU_EYES_CLOSED, AU_BLINK)
                      if message.confidence[unit] > 0.0 and math.isfinite(message.intensity[unit])), default=None)
        if closed is not None:
            with self._lock:
                self._lids[face] = Seen(message.header.stamp.to_sec(), float(closed))

    def _on_frames(self, data: bytes, frames: Frames, fixed: bool) -> None:
        # The latest stamp; one of a face or a body counts more than one of a person.
        newest: Optional[_Newest] = None
        with self._lock:
            kept = self._frames
            for child, offset in frames:
                child = child.lstrip(b"/")
                if not kept.wants(child):
                    if not kept.is_limb(child):
                        self._take_other(child, data, offset, fixed)
                    continue
                if fixed:
                    kept.put(read(data, offset), fixed)
                    continue
                candidate = (child.startswith(_STAMPED_BY), *read_stamp(data, offset))
                kept.put_unread(child, data, offset)
                if newest is None or candidate > newest:
                    newest = candidate
            is_news = newest is not None and self._note(newest)
        if is_news and (newest[0] or not self._measures_come()):
            self.news.set()

    def _measures_come(self) -> bool:
        """Tell whether frames of faces or bodies come: the person's wake nobody up then."""
        return time.monotonic() - self._measured_at < self._settings.frame_timeout

    def _take_other(self, child: bytes, data: bytes, offset: int, fixed: bool) -> None:
        if is_of_human(child, fixed):
            return
        try:
            transform = read(data, offset)
            if fixed:
                self._frames.keep_fixed(transform)
            self._robot.put(transform, fixed)
        except ValueError:
            self.refused += 1

    def _note(self, newest: _Newest) -> bool:
        """Note a stamp; tell whether it is a newer one. One that lies far back, and none newer comes: time has jumped."""
        measured, stamp = newest[0], genpy.Time(newest[1], newest[2])
        before = self._newest if measured else self._newest_person
        now = time.monotonic()
        if stamp > before:
            self._newer_at = now
        elif (before - stamp).to_sec() > JUMP_BACK_S and now - self._newer_at > _STALE_S:
            self.jumps += 1
            self._forget()
            self._newer_at = now
        else:
            return False
        if measured:
            self._newest, self._measured_at = stamp, now
        else:
            self._newest_person = stamp
        return True

    def _forget(self) -> None:
        self._frames.clear_moving()
        self._lids.clear()
        self._newest = self._newest_person = genpy.Time()
        self._robot.reset()


def is_optical(frame: str) -> bool:
    """Tell whether z of a frame points where it looks, by its name (REP-103)."""
    return "optical" in frame
