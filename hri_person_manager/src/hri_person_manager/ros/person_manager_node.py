"""The person manager on the ROS graph: features, matches and transforms in, persons out."""

from __future__ import annotations

import gc
import sys
import threading
import time
from types import SimpleNamespace
from typing import Dict, List

import genpy
import rospy
from std_srvs.srv import Empty, EmptyRequest, EmptyResponse

from hri_msgs.msg import IdsMatch, SoftBiometrics
from hri_person_manager.core.association import Kind, Node
from hri_person_manager.core.graph_text import graph_text
from hri_person_manager.core.manager import PersonManager
from hri_person_manager.core.match_guard import MatchGuard
from hri_person_manager.core.person_book import ANONYMOUS_PREFIX
from hri_person_manager.core.person_register import PersonRegister
from hri_person_manager.core.presence import MAX_FEATURES
from hri_person_manager.ros.graph_topic import GraphTopic
from hri_person_manager.ros.manager_report import ManagerReport
from hri_person_manager.ros.people_store import open_store
from hri_person_manager.ros.person_markers import PersonMarkers
from hri_person_manager.ros.person_services import PersonServices
from hri_person_manager.ros.person_spaces import PersonSpaces
from hri_person_manager.ros.person_topics import PersonTopics
from hri_person_manager.ros.reference import ReferenceFrame
from hri_person_manager.ros.restart_memory import RestartMemory
from hri_person_manager.ros.tf_intake import StampedSighting, TfIntake
from hri_pipeline.core.memory import share_arenas
from hri_pipeline.core.private_file import StoreError
from hri_pipeline.ros.conversions import transform_to_msg
from hri_pipeline.ros.feature_feed import FeatureFeed
from hri_pipeline.ros.tf_publisher import TfPublisher
from hri_pipeline.ros.topic_release import release

TICK_S = 0.1
SWITCH_S = 0.001     # a callback waits no longer than so for a thread that computes; the default of Python is 5 ms
DIAGNOSTICS_S = 1.0
EXPIRY_S = 3600.0
_LOG_PERIOD_S = 30.0
JUMP_BACK_S = 0.5
_FEEDS = (("faces", Kind.FACE, {"softbiometrics": SoftBiometrics}), ("bodies", Kind.BODY, {}),
          ("voices", Kind.VOICE, {}))


class PersonManagerNode:
    """Owns the manager; every callback takes the lock, hands over, and publishes what changed.

    Frames of seen persons are published on arrival of the transforms of their features, with those stamps.
    The caller of spin() lets time pass ten times a second of wall time, whatever the simulated clock does.
    """

    def __init__(self, settings: SimpleNamespace) -> None:
        sys.setswitchinterval(SWITCH_S)
        self._lock = threading.RLock()
        self._stop = threading.Event()
        self._manager = PersonManager(settings)
        self._threshold = settings.match_threshold
        self._memory = RestartMemory()
        self._guard = MatchGuard(settings.max_matches_per_second)
        self._last_now = rospy.get_time()
        self._next_report = self._next_expiry = 0.0
        self._jumps = 0
        self._sensed = genpy.Time()     # stamp of the newest image or sound of which a list or a transform has come
        self._feeds: Dict[str, FeatureFeed] = {}
        self._store = open_store(settings)
        self._register = PersonRegister(self._store)
        self._remember_earlier_runs()
        self._topics = PersonTopics(self._register)
        self._markers = PersonMarkers()
        self._graph = GraphTopic()
        self._tf = TfPublisher()
        self._intake = TfIntake(settings.reference_frame, settings.source_timeout, self._on_sightings)
        self._reference = ReferenceFrame(settings.reference_frame, self._intake)
        self._spaces = PersonSpaces(settings, self._intake)
        self._matches = rospy.Subscriber("/humans/candidate_matches", IdsMatch, self._on_match,
                                         queue_size=1000, tcp_nodelay=True)
        for plural, kind, topics in _FEEDS:
            self._feeds[plural] = FeatureFeed(plural, topics, self._on_feature, self._tracked_callback(plural, kind),
                                              max_ids=MAX_FEATURES)
        self._report = ManagerReport(self._manager, self._guard, self._reference, self._intake, self._feeds, self._tf)
        self._reset = rospy.Service("~reset", Empty, self._on_reset)
        self._services = PersonServices(self._manager, self._register, self._guard, self._lock, self._publish_changes)
        rospy.on_shutdown(self._stop.set)
        share_arenas()
        # To go through everything that was imported takes the garbage collector 30 ms, in which nobody is served.
        gc.collect()
        gc.freeze()

    def _expire(self) -> None:
        """Forget who has not been seen for too long."""
        self._next_expiry = time.monotonic() + EXPIRY_S
        try:
            expired = self._store.expire(time.time()) if self._store is not None else ()
        except StoreError as error:
            rospy.logerr("~store: who was not seen for too long is still in it: %s", error)
            return
        for person_id in expired:
            self._register.drop(person_id)
            self._manager.forget(person_id, rospy.get_time())

    def _remember_earlier_runs(self) -> None:
        self._expire()
        earlier = self._memory.read()
        self._manager.expect({name: nodes for name, nodes in earlier.items() if name.startswith(ANONYMOUS_PREFIX)})
        records = sorted(self._register.records, key=lambda record: record.first_seen)
        self._manager.know(record.id for record in records)
        for record in records:
            if record.alias and record.alias in self._register:
                self._manager.merge(record.alias, record.id, self._last_now)
        self._manager.recall({name: nodes for name, nodes in earlier.items() if not name.startswith(ANONYMOUS_PREFIX)},
                             self._last_now)

    def spin(self) -> None:
        """Let time pass until ROS shuts down."""
        while not self._stop.wait(TICK_S):
            with self._lock:
                self._tick()

    def reconfigure(self, settings: SimpleNamespace) -> None:
        """Take up the values of the live parameters, from any thread. ValueError for borders of spaces in the wrong order."""
        with self._lock:
            self._spaces.reconfigure(settings)
            self._guard.limit.set_rate(settings.max_matches_per_second)
            self._threshold = settings.match_threshold
            self._manager.reconfigure(settings, rospy.get_time())
            self._publish_state()

    def close(self) -> None:
        """Take everything back. Idempotent."""
        self._stop.set()
        self._reset.shutdown("closing")
        self._services.close()
        for feed in self._feeds.values():
            feed.close()
        release(self._matches)
        self._intake.close()
        with self._lock:
            for owner in (self._topics, self._spaces, self._graph, self._markers, self._tf, self._report,
                          self._memory):
                owner.close()
            if self._store is not None:
                self._store.close()

    def _tracked_callback(self, plural: str, kind: Kind):
        def on_tracked(ids: List[str]) -> None:
            with self._lock:
                if plural in self._feeds:
                    self._note_stamp(self._feeds[plural].stamp)
                self._intake.set_tracked(kind, ids)
                self._manager.on_tracked(kind, ids, rospy.get_time())
                self._publish_state()
        return on_tracked

    def _on_feature(self, face_id: str, name: str, message: SoftBiometrics) -> None:
        with self._lock:
            person_id = self._manager.person_of(Node(Kind.FACE, face_id))
            if person_id is not None:
                self._register.observe(person_id, face_id, message.age, message.age_confidence, message.gender,
                                       message.gender_confidence, message.header.stamp.to_sec())

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
                self._note_stamp(stamped.stamp)
                place = self._reference.place(stamped)
                person_id = self._manager.on_place(stamped.sighting.source, stamped.sighting.id, place, now,
                                                   stamped.sighting.sensor)
                if person_id is not None:
                    place = self._manager.place(person_id)
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
            rospy.logwarn("time went back by %.1f s: places start anew, persons stay", self._last_now - now)
            self._jumps += 1
            self._sensed = genpy.Time()
            self._intake.reset()
            self._manager.rewind(now)
        self._last_now = now
        self._manager.tick(now)
        if now > 0.0:
            self._tf.send([transform_to_msg(place.pose, stamp, place.frame, "person_" + person_id)
                           for person_id, place in self._manager.silent(now)])
        self._publish_state()
        snapshot = self._manager.snapshot(now)
        self._markers.publish(snapshot)
        self._spaces.update(snapshot, self._sensed)
        self._graph.update(lambda: graph_text(snapshot, self._manager.matches, self._manager.unions, self._threshold))
        self._memory.update(self._present)
        # In wall time: that is what runs, bags and simulations have in common.
        self._register.seen(filter(self._manager.is_permanent, snapshot.tracked), time.time())
        if time.monotonic() >= self._next_report:
            self._next_report = time.monotonic() + DIAGNOSTICS_S
            self._register.write_pending()
            if self._register.problem:
                rospy.logerr_throttle(_LOG_PERIOD_S, "~store: %s", self._register.problem)
            self._report.update(snapshot, self._jumps, self._register.problem)
            if time.monotonic() >= self._next_expiry:
                self._expire()
            self._register.keep_demographics(state.id for state in snapshot.persons)

    def _present(self) -> Dict[str, List[Node]]:
        """Who is made of which features, for the case that this node dies."""
        return {**self._manager.identified(), **self._manager.anonymous()}

    def _publish_changes(self) -> None:
        """What a service has changed is told, and who was forgotten is not remembered, before it answers."""
        self._publish_state()
        self._memory.update(self._present, at_once=True)

    def _publish_state(self) -> None:
        if self._stop.is_set():
            return
        self._topics.update(self._manager.snapshot(rospy.get_time()), self._sensed)

    def _note_stamp(self, stamp: genpy.Time) -> None:
        """Note when something was sensed; stamps of the future would stay for good."""
        if self._sensed < stamp and stamp.to_sec() < rospy.get_time() + JUMP_BACK_S:
            self._sensed = stamp
