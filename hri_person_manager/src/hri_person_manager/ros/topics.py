"""Topics of the persons: the lists, those of the spaces around the robot, what is latched under /humans/persons/ID, and
markers for rviz."""

from __future__ import annotations

import math
import queue
import threading
import time
from typing import Callable, Dict, List, Optional, Sequence, Set, Tuple

import genpy
import numpy as np
import rospy
from geometry_msgs.msg import PoseWithCovarianceStamped, Quaternion
from scipy.spatial.transform import Rotation
from std_msgs.msg import Bool, Float32, Header, String
from visualization_msgs.msg import Marker, MarkerArray

from hri_msgs.msg import AgeAndGender
from hri_person_manager.core.location import Place
from hri_person_manager.core.parameters import PersonManagerSettings
from hri_person_manager.core.persons import PersonState, Snapshot
from hri_person_manager.core.proxemics import Proxemics, Space, horizontal_distance
from hri_person_manager.core.register import DemographicsEstimate, PersonRegister
from hri_person_manager.core.triangulation import ellipse
from hri_person_manager.ros.inputs import ALONG, TfInput
from hri_person_manager.ros.navigation import position_to_msg
from hri_pipeline.core.frames import is_optical
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.overlay import label_lifts
from hri_pipeline.ros.conversions import to_time
from hri_pipeline.ros.markers import ShownMarkers, make_marker
from hri_pipeline.ros.publishers import IdPublishers, TopicSpec, TrackedList
from hri_pipeline.ros.rospy_compat import release

NAMESPACE = "/humans/persons"
CONFIDENCE_STEP = 0.005     # a change of the confidence by less is not published
RETRY_S = 1.0               # after topics could not be opened
_LOG_PERIOD_S = 10.0
STAMP_S = 0.5               # age of the stamp of the lists that are repeated once a second
_STATE = ("face_id", "body_id", "voice_id", "anonymous", "location_confidence", "alias")      # PersonState[1:7]
_TOPICS = {
    "face_id": TopicSpec(String, True, 10),
    "body_id": TopicSpec(String, True, 10),
    "voice_id": TopicSpec(String, True, 10),
    "location_confidence": TopicSpec(Float32, True, 10),
    "anonymous": TopicSpec(Bool, True, 10),
    "alias": TopicSpec(String, True, 10),
    "position": TopicSpec(PoseWithCovarianceStamped),
}
# Most people have none of these, few have all; each topic costs a file descriptor and a call of the master.
_KNOWN_TOPICS = {
    "name": TopicSpec(String, True, 10),
    "native_language": TopicSpec(String, True, 10),
    "demographics": TopicSpec(AgeAndGender, True, 10),
}


class _Person:
    """Topics of one person, and what was published on them last."""

    def __init__(self, state: PersonState) -> None:
        self.state = state
        self.publishers = IdPublishers(NAMESPACE, _TOPICS)
        self.known_publishers = {name: IdPublishers(NAMESPACE, {name: spec}) for name, spec in _KNOWN_TOPICS.items()}
        self.known: Set[str] = set()
        """Names of the topics of what is known of the person; they are there or on their way."""
        self.published: Dict[str, object] = {}
        self.ready = self.gone = False
        self.failed_at: Optional[float] = None
        """When its topics could not be opened, of the monotonic clock."""

    def publish(self, name: str, message: genpy.Message, value: object) -> None:
        """Publish, and note the value where the topic is there; that of what is known may be on its way."""
        publishers = self.publishers if name in _TOPICS else self.known_publishers[name]
        if publishers.publish(self.state.id, name, message):
            self.published[name] = value

    def open(self) -> None:
        """Open what is not open yet: first what everybody has, later what has become known."""
        if not self.ready:
            self.publishers.open(self.state.id)
        for name in tuple(self.known):
            self.known_publishers[name].open(self.state.id)

    def close(self) -> None:
        """Take all topics back."""
        for publishers in (self.publishers, *self.known_publishers.values()):
            publishers.close_all()


class PersonTopics:
    """Publishes what changed from one snapshot to the next; topics go away with their person.

    To open and close topics takes the master many milliseconds: a thread does that, so that nobody else waits. A person
    is listed once its topics are there; whom it continues stays until then.
    register: names, languages and demographics; they are published once they are known.
    """

    def __init__(self, register: PersonRegister) -> None:
        self._register = register
        self._lock = threading.Lock()
        self._tracked = TrackedList(NAMESPACE + "/tracked")
        self._known = TrackedList(NAMESPACE + "/known")
        self._persons: Dict[str, _Person] = {}
        self._opening = 0
        self._latest = Snapshot((), (), ())
        self._stamp = genpy.Time()
        self._listed: Optional[Tuple[Tuple[str, ...], Tuple[str, ...]]] = None
        self._listed_at = 0.0
        self._merged: Dict[str, List[str]] = {}
        self._problem = ""
        self._work: "queue.Queue[Optional[_Person]]" = queue.Queue()
        self._worker = threading.Thread(target=self._open_and_close, name="person topics", daemon=True)
        self._worker.start()

    def confidence(self, person_id: str) -> float:
        """Return the location confidence last said of a person, 0 if there is none."""
        person = self._persons.get(person_id)
        return float(person.published.get("location_confidence", person.state.confidence)) if person else 0.0

    def publish_position(self, person_id: str, place: Place, stamp: genpy.Time) -> None:
        """Publish where a person is, with the covariance, while somebody subscribes."""
        person = self._persons.get(person_id)
        if person is not None and person.publishers.has_subscribers(person_id, "position"):
            message = position_to_msg(place, stamp)
            if message is not None:
                person.publishers.publish(person_id, "position", message)

    def waiting(self) -> Tuple[int, str]:
        """Return how many persons are not listed because their topics could not be opened, and why."""
        with self._lock:
            count = sum(not person.ready and person.failed_at is not None for person in self._persons.values())
            return count, self._problem if count else ""

    def update(self, snapshot: Snapshot, stamp: genpy.Time) -> None:
        """Publish the differences to the last snapshot."""
        with self._lock:
            self._latest, self._stamp = snapshot, stamp
            self._merged = snapshot.merged()
            for state in snapshot.persons:
                person = self._persons.get(state.id)
                if person is None:
                    person = self._persons[state.id] = _Person(state)
                    self._opening += 1
                    self._work.put(person)
            for state in snapshot.persons:
                self._publish(self._persons[state.id], state)
            if len(self._persons) > len(snapshot.persons):
                listed = {state.id for state in snapshot.persons}
                for gone in [person_id for person_id in self._persons if person_id not in listed]:
                    self._close(self._persons.pop(gone))
            self._publish_lists()

    def close(self) -> None:
        """Take all topics back; the lists end with the empty list. Idempotent."""
        self._tracked.close()
        self._known.close()
        with self._lock:
            for person in self._persons.values():
                self._close(person)
            self._persons.clear()
        self._work.put(None)
        self._worker.join()

    def _close(self, person: _Person) -> None:
        person.gone = True
        self._opening -= not person.ready
        self._work.put(person)

    def _open_and_close(self) -> None:
        """Each person comes out of the queue when it is new, when something more is known of it, and when it has
        gone."""
        for person in iter(self._work.get, None):
            try:
                self._attend(person)
            except Exception as error:  # the topics of one person never cost those of the others
                self._problem = str(error)
                person.failed_at = time.monotonic()
                if not rospy.is_shutdown():
                    rospy.logerr_throttle(_LOG_PERIOD_S, "topics of person %s: %s: %s; trying again", person.state.id,
                                          type(error).__name__, error)

    def _attend(self, person: _Person) -> None:
        if person.gone:
            person.close()
            return
        person.open()
        with self._lock:
            if not person.gone:
                self._opening -= not person.ready
                person.ready = True
                self._publish(person, person.state)
                for other in self._persons.values():
                    if other.state.alias == person.state.id:
                        self._publish(other, other.state)
                self._publish_lists()

    def _stands_in(self, person: _Person) -> bool:
        """Tell whether a person was merged into one whose topics are being opened: until then nothing changes, so that
        nobody sees an empty list meanwhile."""
        other = self._persons.get(person.state.alias)
        return other is not None and not other.ready and other.failed_at is None

    def _publish_lists(self) -> None:
        """Publish both lists, without those whose topics are not there yet, unless they were known before."""
        lists = (self._latest.tracked, self._latest.known)
        if self._opening:
            hidden = {person.state.id for person in self._persons.values() if not person.ready}
            tracked, known = self._listed or lists
            lists = (self._without_gap([id for id in lists[0] if id not in hidden], tracked),
                     self._without_gap([id for id in lists[1] if id not in hidden or id in known], known))
        now = time.monotonic()
        if lists != self._listed or now - self._listed_at > STAMP_S:
            self._listed, self._listed_at = lists, now
            self._tracked.set(lists[0], self._stamp)
            self._known.set(lists[1], self._stamp)

    def _without_gap(self, ids: Sequence[str], listed: Sequence[str]) -> Tuple[str, ...]:
        """Return these ids, and those who were listed and are continued by somebody whose topics are being opened."""
        return (*ids, *(id for id in listed if id not in ids and id in self._persons
                        and self._stands_in(self._persons[id])))

    def _publish(self, person: _Person, state: PersonState) -> None:
        person.state = state
        if person.failed_at is not None and time.monotonic() - person.failed_at > RETRY_S:
            person.failed_at = None
            self._work.put(person)
        if not person.ready or self._stands_in(person):
            return
        last = person.published
        for name, value in zip(_STATE, state[1:7]):
            if name not in last or _differs(last[name], value):
                person.publish(name, _TOPICS[name].type(value), value)
        self._publish_known(person)

    def _publish_known(self, person: _Person) -> None:
        """Publish what is known of a person beyond the present, each on a topic that is opened when it is known
        first."""
        name, language = self._register.said_of(person.state.id, self._merged.get(person.state.id, ()))
        demographics = self._register.demographics(person.state.id)
        for topic, value in (("name", name), ("native_language", language), ("demographics", demographics)):
            if (not value and topic not in person.known) or value == person.published.get(topic, ""):
                continue
            if topic not in person.known:
                person.known.add(topic)
                self._work.put(person)
            elif value is not None:
                person.publish(topic, String(value) if isinstance(value, str) else _age_and_gender(value), value)


def _age_and_gender(estimate: DemographicsEstimate) -> AgeAndGender:
    return AgeAndGender(header=Header(stamp=to_time(estimate.stamp)), age=estimate.age,
                        age_deviation=estimate.age_deviation, age_confidence=estimate.age_confidence,
                        gender=estimate.gender, gender_confidence=estimate.gender_confidence)


def _differs(old: object, new: object) -> bool:
    if isinstance(new, float):
        return abs(new - old) >= CONFIDENCE_STEP or (new != old and new in (0.0, 1.0))
    return new != old


class PersonSpaces:
    """Publishes who is how near, in the plane, to `robot_frame` or to the sensor that saw the person last."""

    def __init__(self, settings: PersonManagerSettings, tf_input: TfInput) -> None:
        """Take the values of the manager's parameters. ValueError for borders in the wrong order."""
        self._robot_frame = settings.robot_frame
        self._reference = settings.reference_frame
        self._tf_input = tf_input
        self._proxemics = Proxemics(settings.personal_distance, settings.social_distance)
        self._sensors: Dict[str, str] = {}
        self._poses: Dict[Tuple[str, str], Optional[Pose]] = {}
        self._lists = {space: TrackedList("{}/{}".format(NAMESPACE, space.value)) for space in Space}

    def reconfigure(self, settings: PersonManagerSettings) -> None:
        """Take up the borders. ValueError when they are in the wrong order; then nothing has changed."""
        self._proxemics.set_borders(settings.personal_distance, settings.social_distance)

    def note_sensor(self, person_id: str, sensor: str) -> None:
        """Note which sensor frame has placed a person."""
        self._sensors[person_id] = sensor

    def update(self, snapshot: Snapshot, stamp: genpy.Time) -> None:
        """Sort all persons whose place is known, and publish the lists that changed."""
        self._poses.clear()
        distances = {}
        for state in snapshot.persons:
            if state.place is None or state.confidence <= 0.0:
                continue
            distance = self._distance(state.id, state.place)
            if distance is not None:
                distances[state.id] = distance
        listed = {state.id for state in snapshot.persons}
        self._sensors = {key: sensor for key, sensor in self._sensors.items() if key in listed}
        for space, ids in self._proxemics.update(distances).items():
            self._lists[space].set(ids, stamp)

    def close(self) -> None:
        """Publish empty lists and take the topics back. Idempotent."""
        for tracked in self._lists.values():
            tracked.close()

    def _distance(self, person_id: str, place: Place) -> Optional[float]:
        """Horizontal distance (m) of a person from the robot, else from the sensor; None when nothing leads there."""
        sensor = self._sensors.get(person_id, place.frame)
        level = self._level(place)
        shift, origin = self._pose(level, place.frame), self._pose(level, self._robot_frame or sensor)
        if shift is None or origin is None:
            return None
        moved = Place(level, shift.compose(place.pose), place.stamp,
                      of_camera=place.of_camera and level == place.frame)
        return horizontal_distance(moved, origin.translation)

    def _level(self, place: Place) -> str:
        """Choose the frame that tells what is horizontal for a place.

        The reference frame, or that of the robot, with z up. An optical frame may be tilted: only for want of others.
        """
        frame, robot = place.frame, self._robot_frame
        if frame == self._reference and not place.is_optical:
            return frame
        turn = self._pose(robot, frame) if robot and not is_optical(robot) else None
        if turn is None:
            return frame
        # Where the turn to the camera's optical frame was forgotten, the robot has the axes of the camera, too.
        is_alike = min(turn.rotation[1, 1], turn.rotation[2, 2]) > ALONG
        return frame if is_alike and place.of_camera and frame == self._reference else robot

    def _pose(self, target: str, frame: str) -> Optional[Pose]:
        """Pose of a frame in another one now; None when nothing leads there."""
        if (target, frame) not in self._poses:
            self._poses[target, frame] = self._tf_input.between(target, frame, genpy.Time())
        return self._poses[target, frame]


RADIUS = 0.06           # m
TEXT_HEIGHT = 0.12      # m
LETTER_WIDTH = 0.07     # m; letters have about 0.06
TEXT_ABOVE = 0.3        # m, above the face; the body's own label stands below the body
LIFETIME_S = 0.5
COLOUR = (0.1, 0.7, 1.0)
THICKNESS = 0.01        # m, of an ellipse
GRAPH_PERIOD_S = 0.2


class PersonMarkers:
    """MarkerArray on `visualization/persons`, made only while somebody listens."""

    def __init__(self) -> None:
        self._publisher = rospy.Publisher("visualization/persons", MarkerArray, queue_size=1)
        self._shown = ShownMarkers()
        self._frame = ""

    def publish(self, snapshot: Snapshot) -> None:
        """Show the persons that have a place, with its 95 % ellipse; they fade with their confidence."""
        if not self._publisher.get_num_connections():
            return
        markers: List[Marker] = []
        placed = [(number, state, state.place_now) for number, state in enumerate(snapshot.persons)
                  if state.confidence > 0.0]
        shown = [(number, state, place) for number, state, place in placed if place is not None]
        # y of an optical frame points down. All places are mostly in one frame.
        ups = [np.array([0.0, -1.0, 0.0] if place.is_optical else [0.0, 0.0, 1.0]) for _, _, place in shown]
        lifts = label_lifts([place.pose.translation for _, _, place in shown], ups[0] if ups else (0.0, 0.0, 1.0),
                            [LETTER_WIDTH * len(_label(state.id)) for _, state, _ in shown], 1.15 * TEXT_HEIGHT)
        for (number, state, place), up, lift in zip(shown, ups, lifts):
            header, middle, alpha = Header(frame_id=place.frame), place.pose.translation, 0.3 + 0.7 * state.confidence
            text = make_marker(header, "persons", 2 * number + 1, Marker.TEXT_VIEW_FACING, (TEXT_HEIGHT,) * 3, COLOUR,
                               alpha, middle + (TEXT_ABOVE + lift) * up, LIFETIME_S)
            text.text = _label(state.id)
            markers += [make_marker(header, "persons", 2 * number, Marker.SPHERE, (2.0 * RADIUS,) * 3, COLOUR, alpha,
                                    middle, LIFETIME_S), text]
            markers += _ellipse(number, place)
        self._frame = shown[0][2].frame if shown else self._frame
        self._publisher.publish(self._shown.update(markers, Header(frame_id=self._frame)))

    def close(self) -> None:
        """Take the topic back. Idempotent."""
        release(self._publisher)


def _ellipse(number: int, place: Place) -> List[Marker]:
    """The horizontal 95 % ellipse of a place, as a flat disc at its height; none where it is not known."""
    covariance = place.horizontal_covariance
    if covariance is None:
        return []
    major, minor, turn = ellipse(covariance)
    # The disc lies in x and y, in x and z of an optical frame; it is turned within its plane.
    rotation = Rotation.from_euler("XZ", [0.5 * math.pi if place.is_optical else 0.0, turn]).as_quat()
    marker = make_marker(Header(frame_id=place.frame), "uncertainty", number, Marker.CYLINDER,
                         (2.0 * major, 2.0 * minor, THICKNESS), COLOUR, 0.15, place.pose.translation, LIFETIME_S)
    marker.pose.orientation = Quaternion(*rotation.tolist())
    return [marker]


def _label(person_id: str) -> str:
    return person_id[len("anonymous_person_"):] if person_id.startswith("anonymous_person_") else person_id


class GraphTopic:
    """Publishes the text when it has changed, five times a second at most, and only while somebody listens."""

    def __init__(self) -> None:
        self._publisher = rospy.Publisher("/humans/graph", String, queue_size=1, latch=True)
        self._last = ""
        self._next = 0.0

    def update(self, text: Callable[[], str]) -> None:
        """Publish what `text` returns, if it is new."""
        now = time.monotonic()
        if now < self._next or not self._publisher.get_num_connections():
            return
        self._next = now + GRAPH_PERIOD_S
        found = text()
        if found != self._last:
            self._last = found
            self._publisher.publish(String(found))

    def close(self) -> None:
        """Take the topic back. Idempotent."""
        release(self._publisher)
