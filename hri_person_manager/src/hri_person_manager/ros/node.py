"""The person manager on the ROS graph: features, matches and transforms in, persons out."""

from __future__ import annotations

import gc
import math
import sys
import threading
import time
import traceback
from collections import OrderedDict
from typing import Dict, List, Mapping, Optional, Tuple

import genpy
import rospy
from sensor_msgs.msg import Image
from std_srvs.srv import Empty, EmptyRequest, EmptyResponse

from hri_msgs.msg import IdsMatch, SoftBiometrics
from hri_person_manager.core.display import graph_text
from hri_person_manager.core.features import MAX_FEATURES, FeaturePose, Kind, MatchNode, PlaceSource
from hri_person_manager.core.location import LATE_TIME
from hri_person_manager.core.manager import PersonManager
from hri_person_manager.core.match_graph import MatchGuard
from hri_person_manager.core.parameters import PersonManagerSettings
from hri_person_manager.core.persons import ANONYMOUS_PREFIX, Snapshot
from hri_person_manager.core.register import PersonRegister
from hri_person_manager.ros.inputs import OtherManagers, ReferenceFrame, TfInput
from hri_person_manager.ros.navigation import PeopleTopic
from hri_person_manager.ros.persistence import RestartState, borrowed_records, data_use, open_store
from hri_person_manager.ros.services import PersonServices
from hri_person_manager.ros.topics import GraphTopic, PersonMarkers, PersonSpaces, PersonTopics
from hri_pipeline.core.privacy import StoreError
from hri_pipeline.core.process import share_arenas
from hri_pipeline.core.recognition.database import StoreWriter
from hri_pipeline.core.timing import JUMP_BACK_S, ClockWatch, Order, SourceStamps, StaleStampFilter, clock_went_back
from hri_pipeline.ros.conversions import matrix_from_image, transform_to_msg
from hri_pipeline.ros.diagnostics import ERROR, OK, WARN, NodeDiagnostics
from hri_pipeline.ros.privacy import PrivacyTopic
from hri_pipeline.ros.publishers import MATCHES_TOPIC
from hri_pipeline.ros.rospy_compat import address_of_sender, release, sender_of
from hri_pipeline.ros.subscriptions import IdSubscribers
from hri_pipeline.ros.tf import TfPublisher

TICK_S = 0.1
SWITCH_S = 0.001     # a callback waits no longer than so for a thread that computes; the default of Python is 5 ms
DIAGNOSTICS_S = 1.0
EXPIRY_S, DOUBT_S = 3600.0, 60.0     # who was unseen for too long is looked for so often; while the clock is doubted
WRITE_S = 0.25       # what has changed of persons is in the store after so long
STILL_S = 10.0       # a clock that has stood still for so long while people are listed is told
_LOG_PERIOD_S = 30.0
_FEEDS = (("faces", Kind.FACE, {"softbiometrics": SoftBiometrics}), ("bodies", Kind.BODY, {"appearance": Image}),
          ("voices", Kind.VOICE, {}))


class ManagerDiagnostics:
    """Reads the parts of the node; the caller holds its lock."""

    def __init__(self, manager: PersonManager, guard: MatchGuard, reference: ReferenceFrame, tf_input: TfInput,
                 feeds: Mapping[str, IdSubscribers], transforms: TfPublisher) -> None:
        self._manager, self._guard, self._reference = manager, guard, reference
        self._tf_input, self._feeds, self._transforms = tf_input, feeds, transforms
        self._others = OtherManagers()
        self._diagnostics = NodeDiagnostics(rospy.get_name())
        self._errors = 0
        self._error_at = -math.inf
        self._is_still = False

    def update(self, snapshot: Snapshot, jumps: int, store_problems: Tuple[str, str], waiting: Tuple[int, str]) -> None:
        """Publish the state; jumps: how often time has gone back.

        store_problems: why what is known is not kept, and why nobody expires; each empty when that is not so. waiting:
        number of persons whose topics could not be opened, and why.
        """
        self._persons(snapshot, jumps, *waiting)
        if self._errors and time.monotonic() - self._error_at > _LOG_PERIOD_S:
            self._diagnostics.set("cycle", OK, "goes on", {"errors": self._errors})
        unwritten, unexpired = store_problems
        self._diagnostics.set("store", ERROR if unwritten else WARN if unexpired else OK,
                              unwritten or unexpired or "nothing waits to be written")
        self._matches()
        self._location()
        for plural, feed in self._feeds.items():
            # A stack without a microphone or without a body tracker is a legal one.
            self._diagnostics.set(plural, *feed.status(optional=True))

    def clock(self, still: float, tracked: int) -> None:
        """Say, once in the log, that the clock has stood still for so long (s) while people are listed.

        They stay: the recording may only be paused.
        """
        is_still = still >= STILL_S and tracked > 0
        text = ("/clock has stood still for %.0f s, so the %d tracked persons stay. If the recording has ended: "
                "`rosparam delete /use_sim_time` and start the nodes again" % (still, tracked))
        self._diagnostics.set("clock", WARN if is_still else OK, text if is_still else "goes on")
        if is_still and not self._is_still:
            rospy.logwarn("%s", text)
        self._is_still = is_still

    def fail(self, error: Exception) -> None:
        """Tell of an error that has ended one cycle."""
        self._errors, self._error_at = self._errors + 1, time.monotonic()
        text = "%s: %s" % (type(error).__name__, error)
        self._diagnostics.set("cycle", ERROR, text, {"errors": self._errors})
        rospy.logerr_throttle(_LOG_PERIOD_S, "a cycle has ended with %s\n%s", text, traceback.format_exc())

    def close(self) -> None:
        """Take the topics back. Idempotent."""
        self._others.close()
        self._diagnostics.close()

    def _persons(self, snapshot: Snapshot, jumps: int, waiting: int, why: str) -> None:
        values = {"tracked": len(snapshot.tracked), "known": len(snapshot.known), "waiting for topics": waiting,
                  "time jumps": jumps,
                  "frames not sent twice": self._transforms.dropped,
                  "ids refused in tracked lists": self._manager.refused_ids}
        others = self._others.problem()
        if others:
            rospy.logwarn_throttle(_LOG_PERIOD_S, "%s", others)
        if waiting:
            text = "%d persons are not published, because their topics cannot be opened: %s" % (waiting, why)
            self._diagnostics.set("persons", ERROR, text, values)
        elif others:
            self._diagnostics.set("persons", WARN, others, values)
        elif self._manager.exact:
            self._diagnostics.set("persons", OK, "%d tracked" % len(snapshot.tracked), values)
        else:
            self._diagnostics.set("persons", WARN, "many ids match each other; association is approximate", values)

    def _matches(self) -> None:
        refused = self._guard.refused
        counts = {"accepted": self._guard.accepted, "of persons just forgotten": self._guard.late,
                  **{"refused, " + why: refused[why] for why in sorted(refused)}}
        self._diagnostics.set("candidate matches", WARN if refused else OK,
                              "%d refused, the last: %s" % (sum(refused.values()), self._guard.problem)
                              if refused else "all accepted", counts)

    def _location(self) -> None:
        unconnected, text = sorted(self._reference.unconnected), self._reference.problem
        late = sorted(self._reference.late)
        if late:
            text = ("transforms of %s, which moves, come later than people by 0.2 s and more: people are placed by "
                    "where it was; publish them sooner, and by the images' clock" % ", ".join(late))
        if unconnected:
            text = "no transform from %s to %s, see /humans/reference_frame" % (", ".join(unconnected),
                                                                                self._reference.frame)
        self._diagnostics.set("location", WARN if text else OK,
                              text or "persons are placed in %s" % self._reference.frame, self._tf_input.status())


_MAX_SENDERS = 100


class PublisherRestarts:
    """Notices that the process of a node that sends on a topic is another one than before, under the same name."""

    def __init__(self, topic: str) -> None:
        self._topic = topic
        self._runs: "OrderedDict[str, Tuple[object, str]]" = OrderedDict()      # connection and address by name

    def is_new_run(self, message: genpy.Message) -> bool:
        """Tell whether this message is the first one that another process has sent."""
        sender, connection = sender_of(message), getattr(message, "_connection_header", None)
        before = self._runs.get(sender, (None, ""))
        if connection is None or before[0] is connection:
            return False
        address = address_of_sender(self._topic, message) or before[1]
        self._runs[sender] = connection, address
        while len(self._runs) > _MAX_SENDERS:
            self._runs.popitem(last=False)
        return "" != before[1] != address


class PersonManagerNode:
    """Owns the manager; every callback takes the lock, hands over, and publishes what changed.

    Frames of seen persons are published on arrival of the transforms of their features, with those stamps.
    The caller of spin() lets time pass ten times a second of wall time, whatever the simulated clock does.
    """

    def __init__(self, settings: PersonManagerSettings) -> None:
        sys.setswitchinterval(SWITCH_S)
        self._lock = threading.RLock()
        self._stop = threading.Event()
        self._manager = PersonManager(settings)
        self._threshold = settings.match_threshold
        self._restart_state = RestartState()
        self._guard = MatchGuard(settings.max_matches_per_second)
        self._last_now = rospy.get_time()
        self._next_report = self._next_expiry = 0.0
        self._is_clock_doubted = False
        self._jumps = 0
        self._stamps, self._stale_stamps = SourceStamps(), StaleStampFilter()
        self._clock = ClockWatch()
        self._recognisers = PublisherRestarts(MATCHES_TOPIC)
        self._sensed = genpy.Time()     # stamp of the newest image or sound of which a list or a transform has come
        self._feeds: Dict[str, IdSubscribers] = {}
        self._store = open_store(settings)
        self._register = PersonRegister(self._store, borrowed_records(settings))
        self._remember_earlier_runs()
        self._writer = StoreWriter(self._write_store, WRITE_S)
        self._topics = PersonTopics(self._register)
        self._markers = PersonMarkers()
        self._graph = GraphTopic()
        self._settings = settings
        self._privacy = PrivacyTopic()
        self._people = PeopleTopic() if settings.people_msgs else None
        self._tf = TfPublisher()
        self._tf_input = TfInput(settings.reference_frame, settings.source_timeout, self._on_poses)
        self._reference = ReferenceFrame(settings.reference_frame, self._tf_input)
        self._spaces = PersonSpaces(settings, self._tf_input)
        self._matches = rospy.Subscriber(MATCHES_TOPIC, IdsMatch, self._on_match,
                                         queue_size=1000, tcp_nodelay=True)
        self._subscribe_to_features()
        self._report = ManagerDiagnostics(self._manager, self._guard, self._reference, self._tf_input, self._feeds,
                                          self._tf)
        self._reset = rospy.Service("~reset", Empty, self._on_reset)
        self._services = PersonServices(self._manager, self._register, self._guard, self._lock, self._publish_changes,
                                        self._wait_until_written)
        rospy.on_shutdown(self._stop.set)
        _settle_memory()

    def _subscribe_to_features(self) -> None:
        for plural, kind, topics in _FEEDS:
            self._feeds[plural] = IdSubscribers(plural, topics, self._on_feature, self._tracked_callback(plural, kind),
                                                max_ids=MAX_FEATURES, list_timeout=self._settings.list_timeout)

    def _write_store(self) -> None:
        """Write what has changed, and see who has not been seen for too long; in the thread of the writer."""
        self._register.flush()
        if time.monotonic() >= self._next_expiry:
            self._expire()

    def _expire(self) -> None:
        self._next_expiry = time.monotonic() + EXPIRY_S
        try:
            self._register.expire(time.time())
        except StoreError as error:
            rospy.logerr("~store: who was not seen for too long is still in it: %s", error)
        problem = self._clock_problem()
        if problem:
            self._next_expiry = time.monotonic() + DOUBT_S
            if not self._is_clock_doubted:
                rospy.logwarn("~store_max_age: %s", problem)
        self._is_clock_doubted = bool(problem)

    def _clock_problem(self) -> str:
        return self._store.clock_problem if self._store is not None else ""

    def _forget_gone(self) -> None:
        """Forget who has expired, and who was forgotten by another process."""
        for person_id in self._register.take_gone():
            self._guard.forget(person_id, time.monotonic())
            self._manager.forget(person_id, rospy.get_time())

    def _remember_earlier_runs(self) -> None:
        self._expire()
        self._forget_gone()
        earlier = self._restart_state.read()
        self._manager.expect({name: nodes for name, nodes in earlier.items() if name.startswith(ANONYMOUS_PREFIX)})
        self._know_records()
        self._manager.recall({name: nodes for name, nodes in earlier.items() if not name.startswith(ANONYMOUS_PREFIX)},
                             self._last_now)

    def _know_records(self) -> None:
        """Let the manager know whom the register has, and who of them are one human."""
        records = sorted(self._register.records, key=lambda record: record.first_seen)
        self._manager.know(record.id for record in records)
        for record in records:
            if record.alias and all(map(self._manager.is_permanent, (record.alias, record.id))):
                self._manager.merge(record.alias, record.id, self._last_now)

    def spin(self) -> None:
        """Let time pass until ROS shuts down."""
        while not self._stop.wait(TICK_S):
            for step in (self._tf_input.pass_on, self._cycle):
                try:
                    step()
                except Exception as error:  # one bad place does not end the node
                    with self._lock:
                        self._report.fail(error)

    def _cycle(self) -> None:
        with self._lock:
            self._tick()

    def reconfigure(self, settings: PersonManagerSettings) -> None:
        """Take up the values of the live parameters, from any thread.

        ValueError for borders of spaces in the wrong order.
        """
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
        self._tf_input.close()
        with self._lock:
            for owner in (self._topics, self._spaces, self._graph, self._markers, self._tf, self._report,
                          self._restart_state, self._privacy):
                owner.close()
        if self._people is not None:
            self._people.close()
        problem = self._writer.close()
        if problem:
            rospy.logerr("~store: %s", problem)
        if self._store is not None:
            self._store.close()

    def _tracked_callback(self, plural: str, kind: Kind):
        def on_tracked(ids: List[str]) -> None:
            with self._lock:
                if plural in self._feeds:
                    self._note_stamp(self._feeds[plural].stamp)
                self._manager.on_tracked(kind, ids, rospy.get_time())
                self._tf_input.set_tracked(kind, ids)
                self._publish_state()
        return on_tracked

    def _on_feature(self, feature_id: str, name: str, message: genpy.Message) -> None:
        if name == "appearance":
            colours = matrix_from_image(message)
            with self._lock:
                self._manager.on_appearance(feature_id, colours)
        else:
            self._on_biometrics(feature_id, message)

    def _on_biometrics(self, face_id: str, message: SoftBiometrics) -> None:
        with self._lock:
            person_id = self._manager.person_of(MatchNode(Kind.FACE, face_id))
            if person_id is not None:
                self._register.observe(person_id, face_id, message.age, message.age_confidence, message.gender,
                                       message.gender_confidence, message.header.stamp.to_sec())

    def _on_match(self, message: IdsMatch) -> None:
        with self._lock:
            refused = sum(self._guard.refused.values())
            match = self._guard.check(message.id1, message.id1_type, message.id2, message.id2_type,
                                      message.confidence, time.monotonic())
            if sum(self._guard.refused.values()) > refused:
                rospy.logwarn_throttle(_LOG_PERIOD_S, "%s: a match of %s is refused: %s", MATCHES_TOPIC,
                                       sender_of(message), self._guard.problem)
            if match is not None and self._recognisers.is_new_run(message):
                threading.Thread(target=self._on_new_run, args=(sender_of(message), ), daemon=True,
                                 name="new recogniser").start()
            if match is not None and self._manager.on_match(match, rospy.get_time(), sender_of(message)):
                self._publish_state()

    def _on_new_run(self, recogniser: str) -> None:
        """See whom a recogniser has lost of whose name another process runs now; in a thread, as it answers by ROS."""
        known = self._services.known_to(recogniser)
        if known is None:
            return      # it keeps no gallery that one could ask
        with self._lock:
            named = {record.id for record in self._register.records
                     if record.name or record.native_language or record.enrolled}
            self._manager.renew(recogniser, known | named, rospy.get_time())
            self._publish_state()

    def _on_poses(self, poses: List[FeaturePose]) -> None:
        with self._lock:
            if self._stop.is_set():
                return
            now = rospy.get_time()
            moved: Dict[str, object] = {}
            image: Optional[Tuple[PlaceSource, str, int, int]] = None
            is_stale = False
            for pose in poses:
                seen = (pose.source, pose.sensor, pose.secs, pose.nsecs)
                if seen != image:       # all features of an image have its stamp: it is looked at once
                    image = seen
                    is_stale = self._stale_stamps.is_stale(pose.secs + 1e-9 * pose.nsecs, now, time.monotonic())
                    if not is_stale:
                        self._note_image(pose)
                if is_stale:
                    continue
                place = self._reference.place(pose)
                stamp = place.exact_stamp
                person_id = self._manager.on_place(pose.source, pose.id, place, now, pose.sensor)
                if person_id is not None:
                    place = self._manager.place(person_id)
                    self._spaces.note_sensor(person_id, pose.sensor)
                    moved[person_id] = transform_to_msg(place.pose, stamp, place.frame, "person_" + person_id)
                    self._topics.publish_position(person_id, place, stamp)
            self._tf.send(list(moved.values()))
            if moved and self._people is not None and self._people.is_wanted:
                self._people.update(self._manager.snapshot(now), self._sensed, rospy.Time.now())
            if any(self._topics.confidence(person_id) < 1.0 for person_id in moved):
                self._publish_state()

    def _on_reset(self, request: EmptyRequest) -> EmptyResponse:
        with self._lock:
            self._manager.reset(rospy.get_time())
            self._register.restart()
            self._know_records()
            self._publish_state()
        rospy.loginfo("reset: persons and matches are forgotten; tracked features, and who is in a store, are kept")
        return EmptyResponse()

    def _tick(self) -> None:
        stamp = rospy.Time.now()
        now = stamp.to_sec()
        if now < self._last_now - JUMP_BACK_S:
            self._go_back(now)
        self._last_now = now
        self._forget_gone()
        self._manager.tick(now)
        if now > 0.0:
            self._send_silent(stamp)
        self._publish_state()
        snapshot = self._manager.snapshot(now)
        if self._people is not None and self._people.is_wanted:
            self._people.update(snapshot, self._sensed, stamp)
        self._markers.publish(snapshot)
        self._spaces.update(snapshot, self._sensed)
        self._graph.update(lambda: graph_text(snapshot, self._manager.matches, self._manager.merges, self._threshold))
        self._restart_state.update(self._present)
        # In wall time: that is what runs, bags and simulations have in common.
        self._register.seen(filter(self._manager.is_permanent, snapshot.tracked), time.time())
        still = self._clock.stood_still(now, time.monotonic())
        if time.monotonic() >= self._next_report:
            self._next_report = time.monotonic() + DIAGNOSTICS_S
            self._update_diagnostics(snapshot, still)

    def _go_back(self, now: float) -> None:
        """Begin anew at `now` (s), before which time was already: a bag that loops, or a simulation."""
        rospy.logwarn_throttle(_LOG_PERIOD_S, "%s: places start anew, persons stay", clock_went_back(
            self._last_now - now, not rospy.rostime.is_wallclock()))
        self._jumps += 1
        self._sensed = genpy.Time()
        self._stamps.clear()
        self._stale_stamps.went_back(self._last_now - now, time.monotonic())
        self._tf_input.reset()
        self._manager.rewind(now)

    def _send_silent(self, stamp: genpy.Time) -> None:
        """Send the frames, with the time of now, of those of whom no transforms come."""
        now = stamp.to_sec()
        # Where the time of now was sent in a silence, images from before it cannot be.
        silent = self._manager.silent(now) + [
            (person_id, place) for person_id, place in self._manager.active(now)
            if self._tf.is_behind("person_" + person_id, place.exact_stamp, LATE_TIME)]
        self._tf.send([transform_to_msg(place.pose, stamp, place.frame, "person_" + person_id)
                       for person_id, place in silent])
        for person_id, place in silent:
            self._topics.publish_position(person_id, place, stamp)

    def _update_diagnostics(self, snapshot: Snapshot, still: float) -> None:
        """still: for how long (s) the clock has stood still."""
        if self._writer.problem:
            rospy.logerr_throttle(_LOG_PERIOD_S, "~store: %s" % self._writer.problem)
        self._report.update(snapshot, self._jumps, (self._writer.problem, self._clock_problem()),
                            self._topics.waiting())
        self._report.clock(still, len(snapshot.tracked))
        self._register.keep_known(set(snapshot.known))
        self._register.keep_demographics(state.id for state in snapshot.persons)
        self._privacy.set(data_use(self._settings, self._register.records))

    def _wait_until_written(self) -> None:
        self._restart_state.wait()
        self._writer.wait()

    def _present(self) -> Dict[str, List[MatchNode]]:
        """Who is made of which features, for the case that this node dies."""
        return {**self._manager.identified(), **self._manager.anonymous()}

    def _publish_changes(self) -> None:
        """Publish what a service has changed, and update the state for a restart, before the service answers."""
        self._publish_state()
        self._restart_state.update(self._present, at_once=True)

    def _publish_state(self) -> None:
        if self._stop.is_set():
            return
        now = rospy.get_time()
        self._tf.send([transform_to_msg(place.pose, place.exact_stamp, place.frame, "person_" + person_id)
                       for person_id, place in self._manager.newly_placed(now)])
        self._topics.update(self._manager.snapshot(now), self._sensed)

    def _note_image(self, pose: FeaturePose) -> None:
        """Note the stamp of a pose; older frames are sent again where those of a sensor have jumped back without the
        clock."""
        if self._stamps.note((pose.source, pose.sensor), (pose.secs, pose.nsecs), time.monotonic()) == Order.BACK:
            self._tf.reset()
        self._note_stamp(genpy.Time(pose.secs, pose.nsecs))

    def _note_stamp(self, stamp: genpy.Time) -> None:
        """Note when something was sensed; stamps of the future would stay for good."""
        if self._sensed < stamp and stamp.to_sec() < rospy.get_time() + JUMP_BACK_S:
            self._sensed = stamp


def _settle_memory() -> None:
    share_arenas()
    # To go through everything that was imported takes the garbage collector 30 ms, in which nobody is served.
    gc.collect()
    gc.freeze()
