"""The person manager on the ROS graph: features, matches and transforms in, persons out."""

from __future__ import annotations

import threading
import time
from types import SimpleNamespace
from typing import Dict, List

import genpy
import rospy
from std_srvs.srv import Empty, EmptyRequest, EmptyResponse

from hri_msgs.msg import IdsMatch
from hri_person_manager.core.association import Kind
from hri_person_manager.core.graph_text import graph_text
from hri_person_manager.core.manager import PersonManager
from hri_person_manager.core.manager_parameters import PERSON_MANAGER_PARAMETERS, SHARED
from hri_person_manager.core.match_guard import MatchGuard
from hri_person_manager.core.presence import MAX_FEATURES
from hri_person_manager.ros.graph_topic import GraphTopic
from hri_person_manager.ros.person_markers import PersonMarkers
from hri_person_manager.ros.person_spaces import PersonSpaces
from hri_person_manager.ros.person_topics import PersonTopics
from hri_person_manager.ros.reference import ReferenceFrame
from hri_person_manager.ros.restart_memory import RestartMemory
from hri_person_manager.ros.tf_intake import StampedSighting, TfIntake
from hri_pipeline.core.parameters import ParameterError
from hri_pipeline.ros.conversions import transform_to_msg
from hri_pipeline.ros.diagnostics import OK, WARN, NodeDiagnostics
from hri_pipeline.ros.feature_feed import FeatureFeed
from hri_pipeline.ros.tf_publisher import TfPublisher
from hri_pipeline.ros.topic_release import release

TICK_S = 0.1
DIAGNOSTICS_S = 1.0
JUMP_BACK_S = 0.5
_FEEDS = (("faces", Kind.FACE), ("bodies", Kind.BODY), ("voices", Kind.VOICE))


def read_manager_parameters() -> SimpleNamespace:
    """Return the parameters out of the private namespace and those shared under /humans; ParameterError."""
    given = rospy.get_param(rospy.get_name(), {})
    if not isinstance(given, dict):
        raise ParameterError("%s is a value on the parameter server, not a set of parameters" % rospy.get_name())
    shared = {name: rospy.get_param("/humans/" + name) for name in SHARED if rospy.has_param("/humans/" + name)}
    return PERSON_MANAGER_PARAMETERS.resolve({**given, **shared})


class PersonManagerNode:
    """Owns the manager; every callback takes the lock, hands over, and publishes what changed.

    Frames of seen persons are published on arrival of the transforms of their features, with those stamps.
    The caller of spin() lets time pass ten times a second of wall time, whatever the simulated clock does.
    """

    def __init__(self, settings: SimpleNamespace) -> None:
        self._lock = threading.RLock()
        self._stop = threading.Event()
        self._manager = PersonManager(settings)
        self._threshold = settings.match_threshold
        self._memory = RestartMemory()
        self._manager.expect(self._memory.read())
        self._guard = MatchGuard(settings.max_matches_per_second)
        self._last_now = rospy.get_time()
        self._last_diagnostics = 0.0
        self._jumps = 0
        self._topics = PersonTopics()
        self._markers = PersonMarkers()
        self._graph = GraphTopic()
        self._tf = TfPublisher()
        self._diagnostics = NodeDiagnostics(rospy.get_name())
        self._intake = TfIntake(settings.reference_frame, settings.source_timeout, self._on_sightings)
        self._reference = ReferenceFrame(settings.reference_frame, self._intake)
        self._spaces = PersonSpaces(settings, self._intake)
        self._matches = rospy.Subscriber("/humans/candidate_matches", IdsMatch, self._on_match,
                                         queue_size=1000, tcp_nodelay=True)
        self._feeds: Dict[str, FeatureFeed] = {
            plural: FeatureFeed(plural, {}, _ignore, self._tracked_callback(kind), max_ids=MAX_FEATURES)
            for plural, kind in _FEEDS}
        self._service = rospy.Service("~reset", Empty, self._on_reset)
        rospy.on_shutdown(self._stop.set)

    def spin(self) -> None:
        """Let time pass until ROS shuts down."""
        while not self._stop.wait(TICK_S):
            with self._lock:
                self._tick()

    def close(self) -> None:
        """Take everything back. Idempotent."""
        self._stop.set()
        self._service.shutdown("closing")
        for feed in self._feeds.values():
            feed.close()
        release(self._matches)
        self._intake.close()
        with self._lock:
            for owner in (self._topics, self._spaces, self._graph, self._markers, self._tf, self._diagnostics,
                          self._memory):
                owner.close()

    def _tracked_callback(self, kind: Kind):
        def on_tracked(ids: List[str]) -> None:
            with self._lock:
                self._intake.set_tracked(kind, ids)
                self._manager.on_tracked(kind, ids, rospy.get_time())
                self._publish_state()
        return on_tracked

    def _on_match(self, message: IdsMatch) -> None:
        with self._lock:
            match = self._guard.check(message.id1, message.id1_type, message.id2, message.id2_type,
                                      message.confidence, time.monotonic())
            if match is not None and self._manager.on_match(match, rospy.get_time()):
                self._publish_state()

    def _on_sightings(self, sightings: List[StampedSighting]) -> None:
        with self._lock:
            if self._stop.is_set():
                return
            now = rospy.get_time()
            moved: Dict[str, object] = {}
            for stamped in sightings:
                place = self._reference.place(stamped)
                person_id = self._manager.on_place(stamped.sighting.source, stamped.sighting.id, place, now)
                if person_id is not None:
                    self._spaces.saw(person_id, stamped.sighting.sensor)
                    moved[person_id] = transform_to_msg(place.pose, stamped.stamp, place.frame,
                                                        "person_" + person_id)
            self._tf.send(list(moved.values()))
            if any(self._topics.confidence(person_id) < 1.0 for person_id in moved):
                self._publish_state()

    def _on_reset(self, request: EmptyRequest) -> EmptyResponse:
        with self._lock:
            self._manager.reset(rospy.get_time())
            self._publish_state()
        rospy.loginfo("reset: persons and matches are forgotten, tracked features are kept")
        return EmptyResponse()

    def _tick(self) -> None:
        stamp = rospy.Time.now()
        now = stamp.to_sec()
        if now < self._last_now - JUMP_BACK_S:
            rospy.logwarn("time went back by %.1f s: starting afresh", self._last_now - now)
            self._jumps += 1
            self._intake.reset()
            self._manager.reset(now)
        self._last_now = now
        self._manager.tick(now)
        if now > 0.0:
            self._tf.send([transform_to_msg(place.pose, stamp, place.frame, "person_" + person_id)
                           for person_id, place in self._manager.silent(now)])
        self._publish_state()
        snapshot = self._manager.snapshot(now)
        self._markers.publish(snapshot)
        self._spaces.update(snapshot, stamp)
        self._graph.update(lambda: graph_text(snapshot, self._manager.matches, self._manager.unions, self._threshold))
        self._memory.update(self._manager.anonymous())
        if time.monotonic() - self._last_diagnostics >= DIAGNOSTICS_S:
            self._last_diagnostics = time.monotonic()
            self._report(now)

    def _publish_state(self) -> None:
        if self._stop.is_set():
            return
        stamp: genpy.Time = rospy.Time.now()
        self._topics.update(self._manager.snapshot(stamp.to_sec()), stamp)

    def _report(self, now: float) -> None:
        snapshot = self._manager.snapshot(now)
        values = {"tracked": len(snapshot.tracked), "known": len(snapshot.known), "time jumps": self._jumps,
                  "frames not sent twice": self._tf.dropped}
        if self._manager.exact:
            self._diagnostics.set("persons", OK, "%d tracked" % len(snapshot.tracked), values)
        else:
            self._diagnostics.set("persons", WARN, "many ids match each other; association is approximate", values)
        refused = self._guard.refused
        counts = {"accepted": self._guard.accepted, **{"refused, " + why: refused[why] for why in sorted(refused)}}
        self._diagnostics.set("candidate matches", WARN if refused else OK,
                              "%d refused" % sum(refused.values()) if refused else "all accepted", counts)
        unconnected = sorted(self._reference.unconnected)
        self._diagnostics.set(
            "location", WARN if unconnected else OK,
            "no transform from %s to %s, see /humans/reference_frame" % (", ".join(unconnected), self._reference.frame)
            if unconnected else "persons are placed in %s" % self._reference.frame, self._intake.status())
        for plural, feed in self._feeds.items():
            level, text, values = feed.status()
            # A stack without a microphone or without a body tracker is a legal one.
            self._diagnostics.set(plural, OK if text.startswith("no publisher") else level, text, values)


def _ignore(identity: str, name: str, message: genpy.Message) -> None:
    """Stand in for the topics of the features: only the lists of them are followed."""
