"""The face_body_matcher node: landmarks, skeletons and transforms in, candidate matches out."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import List

import genpy

from hri_msgs.msg import IdsMatch, Skeleton2D
from hri_pipeline.core.head_places import HeadPlaces
from hri_pipeline.core.matching.face_body_matching import FaceBodyMatcher, MatchAnnouncer, PairMatch
from hri_pipeline.core.tf_scan import read
from hri_pipeline.ros.conversions import landmarks_from_msg, match_to_msg, skeleton_from_msg
from hri_pipeline.ros.diagnostics import OK
from hri_pipeline.ros.feature_feed import FeatureFeed
from hri_pipeline.ros.landmark_array import LandmarkArray
from hri_pipeline.ros.matching.matcher_base import MatcherBase
from hri_pipeline.ros.tf_feed import Frames, TfFeed

GATHER_S = 0.04         # skeletons of one image come one by one; also the shortest time between comparisons
IDLE_S = 0.25
DIAGNOSTICS_S = 1.0


class FaceBodyMatcherNode(MatcherBase):
    """Publishes on /humans/candidate_matches which face and body belong to the same human.

    Callbacks only hand over; the caller of spin() compares soon after something has come in.
    """

    def __init__(self, settings: SimpleNamespace) -> None:
        super().__init__(settings)
        self._matcher = FaceBodyMatcher(settings)
        self._places = HeadPlaces()
        self._announcer = MatchAnnouncer()
        self._last_diagnostics = 0.0
        self._feeds = [
            FeatureFeed("faces", {"landmarks": LandmarkArray}, self._on_landmarks, self._tracked("faces")),
            FeatureFeed("bodies", {"skeleton2d": Skeleton2D}, self._on_skeleton, self._tracked("bodies"))]
        self._transforms = TfFeed(self._on_frames)

    def spin(self) -> None:
        """Compare and publish until ROS shuts down."""
        while not self._stop.is_set():
            if self._news.wait(IDLE_S):
                self._stop.wait(GATHER_S)
            self._news.clear()
            with self._lock:
                matches = self._matcher.matches()
                self._publish(self._announcer.to_say(matches, time.monotonic(), self._matcher.has_left))
            self._report(len(matches))

    def _close_inputs(self) -> None:
        for feed in self._feeds:
            feed.close()
        self._transforms.close()

    def _withdraw_all(self) -> None:
        self._publish(self._announcer.withdraw_all())

    def _tracked(self, kind: str):
        def on_tracked(ids: List[str]) -> None:
            with self._lock:
                self._matcher.set_tracked(kind, ids)
                self._places.set_tracked(kind, ids)
            self._news.set()
        return on_tracked

    def _on_landmarks(self, identity: str, name: str, message: genpy.Message) -> None:
        points = landmarks_from_msg(message)
        aspect = message.width / message.height if message.height else 0.0
        with self._lock:
            self._matcher.add_face(identity, message.header.stamp.to_sec(), points, aspect, message.header.frame_id)
        self._news.set()

    def _on_skeleton(self, identity: str, name: str, message: genpy.Message) -> None:
        points = skeleton_from_msg(message)
        with self._lock:
            self._matcher.add_body(identity, message.header.stamp.to_sec(), points, message.header.frame_id)
        self._news.set()

    def _on_frames(self, data: bytes, frames: Frames, fixed: bool) -> None:
        """Take the places of faces and heads; they are compared with the images that they belong to."""
        with self._lock:
            before = -1
            while before != self._places.wanted:
                # A link tells which one above it is wanted too; that may stand earlier in the same message.
                before = self._places.wanted
                for child, offset in frames:
                    if self._places.wants(child):
                        place = self._places.put(read(data, offset), fixed)
                        if place is not None:
                            self._matcher.add_place(place.kind, place.id, place.stamp, place.position, place.frame)

    def _publish(self, matches: List[PairMatch]) -> None:
        for match in matches:
            self._publisher.publish(match_to_msg(match.face, IdsMatch.FACE, match.body, IdsMatch.BODY,
                                                 match.confidence))

    def _report(self, matched: int) -> None:
        if time.monotonic() - self._last_diagnostics < DIAGNOSTICS_S:
            return
        self._last_diagnostics = time.monotonic()
        self._diagnostics.set("matches", OK, "%d faces matched to bodies" % matched, {"matched": matched})
        for kind, feed in zip(("faces", "bodies"), self._feeds):
            self._diagnostics.set(kind, *feed.status())
