"""Who is there, with what, and since when: what `there again` means after a fault."""

from __future__ import annotations

import time
from typing import Callable, Dict, FrozenSet, List, Sequence, Set, Tuple

import processes
import rospy
from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import Bool, String

from benchmarks.fault_stack import PATIENCE_S
from benchmarks.faults import NEVER, Recovery
from hri_msgs.msg import FacialLandmarks, GazesStamped, IdsList, IdsMatch, Skeleton2D
from hri_pipeline.core.frames import read_stamp
from hri_pipeline.ros.subscriptions import IdSubscribers
from hri_pipeline.ros.tf import Frames, TfSubscriber

FACE, BODY, VOICE = "face_id", "body_id", "voice_id"
_FEATURES = {FACE: "faces", BODY: "bodies"}
SETTLED_S = 4.0
COME_S = 120.0      # a machine that has much to do takes long to learn five faces
_EARLY_S = 0.5      # a stamp further ahead is none of now


class People:
    """Listens to the stack until close().

    `wanted`: who has to be there, and which features of each have to be published.
    """

    def __init__(self) -> None:
        self.wanted: Dict[str, FrozenSet[str]] = {}
        self.tracked: Dict[str, Tuple[str, ...]] = {}
        self.problems: Dict[str, List[str]] = {}
        self._features: Dict[Tuple[str, str], str] = {}
        self._stamps: Dict[str, float] = {}
        self._told: Dict[str, float] = {}
        self._heard: Dict[Tuple[str, str], float] = {}
        self._matchers: Dict[str, float] = {}
        self._voices_matched: Dict[str, float] = {}
        self._reports: Dict[str, float] = {}
        self._gazed, self._voiced = 0.0, 0.0
        self._feeds = [IdSubscribers("persons", {FACE: String, BODY: String, VOICE: String}, self._on_feature,
                                     max_ids=100),
                       IdSubscribers("faces", {"landmarks": FacialLandmarks}, self._on_published("faces"), max_ids=100),
                       IdSubscribers("bodies", {"skeleton2d": Skeleton2D}, self._on_published("bodies"), max_ids=100),
                       IdSubscribers("voices", {"is_speaking": Bool}, self._on_voice, max_ids=100)]
        # Not messages of /tf, which may be a flood: their bytes.
        self._transforms = TfSubscriber(self._on_frames)
        self._subscribers = [rospy.Subscriber("/humans/{}/tracked".format(kind), IdsList, self._on_list, kind)
                             for kind in ("faces", "bodies", "voices", "persons")]
        self._subscribers += [rospy.Subscriber("/humans/interactions/gaze", GazesStamped, self._on_gaze, queue_size=10),
                              rospy.Subscriber("/humans/candidate_matches", IdsMatch, self._on_match, queue_size=100),
                              rospy.Subscriber("/diagnostics", DiagnosticArray, self._on_diagnostics, queue_size=100)]

    def close(self) -> None:
        """Listen no more."""
        for feed in self._feeds:
            feed.close()
        for subscriber in self._subscribers:
            subscriber.unregister()
        self._transforms.close()

    def settle(self, count: int, names: Sequence[str] = ()) -> None:
        """Want those who are there now: wait for `count` persons, or those with the given names, who have a face and a
        body.

        Raises RuntimeError when they do not come, or do not stay for SETTLED_S.
        """
        since: Dict[str, float] = {}

        def settled() -> bool:
            now = time.monotonic()
            there = {name for name in self.tracked.get("persons", ()) if self._kinds(name) == {FACE, BODY}
                     and not name.startswith("anonymous")}
            for name in list(since):
                if name not in there:
                    del since[name]
            for name in there:
                since.setdefault(name, now)
            chosen = [name for name, begun in since.items() if now - begun >= SETTLED_S]
            self.wanted = {name: frozenset((FACE, BODY)) for name in (names or chosen)}
            return len(chosen) >= count and set(names) <= set(chosen)
        if not processes.wait_until(settled, COME_S):
            raise RuntimeError("{} persons do not come and stay within {:g} s; tracked: {}".format(
                count, COME_S, {name: sorted(self._kinds(name)) for name in self.tracked.get("persons", ())}))

    def until_whole(self, began: float, also: Callable[[float], bool] = lambda since: True) -> Recovery:
        """Times (s) from `began` (monotonic) until all is well, and until nobody else is there.

        All is well when who is wanted is tracked, has a place of now, features that are published, and people's gazes
        come, all of it since the call. also: told when that was (monotonic), says what else has to be true.
        """
        now, since = rospy.get_time(), time.monotonic()
        self._stamps.clear()

        def whole() -> bool:
            return self.is_whole(now, since) and also(since)
        if not processes.wait_until(whole, PATIENCE_S):
            return NEVER
        there = round(time.monotonic() - began, 2)
        alone = processes.wait_until(lambda: whole() and not self._others(), PATIENCE_S)
        return Recovery(there, round(time.monotonic() - began, 2) if alone else None)

    def is_whole(self, now: float, since: float) -> bool:
        """Tell whether all is well, of what came after `now` (s, ROS time) and `since` (s, monotonic)."""
        return not self.missing(now, since)

    def missing(self, now: float, since: float) -> List[str]:
        """What is not well yet, in words."""
        tracked, latest = set(self.tracked.get("persons", ())), rospy.get_time() + _EARLY_S
        placed = {name for name, stamp in list(self._stamps.items()) if now < stamp < latest}
        found = ["{} is not tracked".format(name) for name in self.wanted if name not in tracked]
        found += ["{} has no place".format(name) for name in self.wanted if name not in placed]
        found += ["{} of {} is not published".format(_FEATURES[kind], name) for name,
                  kinds in self.wanted.items() for kind in kinds
                  if self._heard.get((_FEATURES[kind], self._features.get((name, kind), "")), 0.0) < since]
        return found + ([] if self._gazed > since else ["no gazes"])

    def matched_by(self, node: str) -> Callable[[float], bool]:
        """Tell whether a matcher has said something since."""
        return lambda since: self._matchers.get(node, 0.0) > since

    def voice_found(self, since: float) -> bool:
        """Tell whether somebody who is wanted has a voice that was matched since."""
        return any(self._voices_matched.get(self._features.get((name, VOICE), ""), 0.0) > since for name in self.wanted)

    def reported_by(self, node: str) -> Callable[[float], bool]:
        """Tell whether a node has said since how it is."""
        return lambda since: self._reports.get(node, 0.0) > since

    def told_anew(self, since: float) -> bool:
        """Tell whether the features of everybody have been said since."""
        return all(self._told.get(name, 0.0) > since for name in self.wanted)

    def voices_come(self, since: float) -> bool:
        """Tell whether a voice that is tracked has begun or ended a turn since."""
        return self._voiced > since

    def all_gone(self) -> bool:
        """Tell whether nobody has a face or a body any more."""
        return not self.tracked.get("faces") and not self.tracked.get("bodies")

    def living(self) -> Dict[str, Set[str]]:
        """Ids that may have topics: those tracked, and for persons those known and their aliases."""
        found = {kind: set(ids) for kind, ids in self.tracked.items()}
        known = rospy.wait_for_message("/humans/persons/known", IdsList, PATIENCE_S).ids
        found["persons"] = found.get("persons", set()) | set(known)
        return found

    def _kinds(self, person: str) -> Set[str]:
        return {kind for kind in _FEATURES if self._features.get((person, kind))}

    def _others(self) -> List[str]:
        """Persons who are not wanted; a voice that nobody is found for is a person of its own, and is none of them."""
        return [name for name in self.tracked.get("persons", ()) if name not in self.wanted and self._kinds(name)]

    def _on_list(self, message: IdsList, kind: str) -> None:
        if message._connection_header.get("callerid") != rospy.get_name():
            self.tracked[kind] = tuple(message.ids)

    def _on_frames(self, data: bytes, frames: Frames, fixed: bool) -> None:
        for child, offset in frames:
            if child.startswith(b"person_"):
                secs, nsecs = read_stamp(data, offset)
                self._stamps[child[len(b"person_"):].decode("utf-8", "replace")] = secs + 1e-9 * nsecs

    def _on_feature(self, person: str, kind: str, message: String) -> None:
        self._features[person, kind] = message.data
        if kind in _FEATURES:
            self._told[person] = time.monotonic()

    def _on_published(self, kind: str) -> Callable[[str, str, object], None]:
        def heard(identity: str, name: str, message: object) -> None:
            self._heard[kind, identity] = time.monotonic()
        return heard

    def _on_voice(self, identity: str, name: str, message: Bool) -> None:
        self._voiced = time.monotonic()

    def _on_gaze(self, message: GazesStamped) -> None:
        if message.gazes:
            self._gazed = time.monotonic()

    def _on_match(self, message: IdsMatch) -> None:
        self._matchers[message._connection_header.get("callerid", "")] = time.monotonic()
        if message.id1_type == IdsMatch.VOICE and message.confidence > 0.0:
            self._voices_matched[message.id1] = time.monotonic()

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self._reports[status.hardware_id] = time.monotonic()
            said = self.problems.setdefault(status.name, [])
            if status.level and status.message not in said[-20:]:
                said.append(status.message)
