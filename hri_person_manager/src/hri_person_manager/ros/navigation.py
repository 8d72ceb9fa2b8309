"""What a robot's navigation needs of people: /people (people_msgs/People), and the place of each person with its
covariance.

Navigation layers read /people: position, velocity, and as tags who stands with whom, how engaged and how upright
somebody is. The tags are those of other nodes; they are subscribed to only while somebody reads /people.
"""

from __future__ import annotations

import threading
from typing import Dict, List, NamedTuple, Optional, Tuple

import genpy
import numpy as np
import rospy
from geometry_msgs.msg import Point, PoseWithCovariance, PoseWithCovarianceStamped, Quaternion
from geometry_msgs.msg import Pose as PoseMsg
from people_msgs.msg import People
from people_msgs.msg import Person as PersonMsg

from hri_person_manager.core.location import CoastingMotion, Place
from hri_person_manager.core.persons import PersonState, Snapshot
from hri_pipeline.client import Humans
from hri_pipeline.client.humans import Body, Person
from hri_pipeline.client.topics import Engagement, Posture
from hri_pipeline.core.timing import JUMP_BACK_S
from hri_pipeline.ros.conversions import make_header
from hri_pipeline.ros.rospy_compat import release

PERIOD_S = 1.0 / 15.0
_SMOOTHED_S = 1.0       # CoastingMotion measures no velocity without a time
_LOG_PERIOD_S = 10.0
_HEADING_VARIANCE = np.pi ** 2 / 3.0     # rad^2, of an angle of which nothing is known: how exact a face's is, is not


class _PlacedPerson(NamedTuple):
    """Somebody in the list, and how fast; velocity: (3,) m/s."""

    state: PersonState
    place: Place
    velocity: np.ndarray


class PeopleTopic:
    """Publishes /people 15 times per second in a thread of its own, while somebody subscribes.

    Only persons in the frame of most of them are in the list: it has one frame.
    """

    def __init__(self) -> None:
        self._publisher = rospy.Publisher("/people", People, queue_size=1)
        self._lock = threading.Lock()
        self._latest: Tuple[Tuple[PersonState, ...], genpy.Time] = ((), genpy.Time())
        self._motions: Dict[str, CoastingMotion] = {}
        self._tags: Optional[_Tags] = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="people", daemon=True)
        self._thread.start()

    @property
    def is_wanted(self) -> bool:
        """Whether somebody subscribes."""
        return self._publisher.get_num_connections() > 0

    def update(self, snapshot: Snapshot, sensed: genpy.Time, now: genpy.Time) -> None:
        """Take the persons as they are; the thread publishes them, with the stamp of the newest image or sound
        (`sensed`), or with that of `now` while nobody is seen. It never goes back but with the time."""
        placed = tuple(state for state in snapshot.persons if state.place is not None and state.confidence > 0.0)
        is_seen = not sensed.is_zero() and any(state.confidence >= 1.0 for state in placed)
        stamp = sensed if is_seen else now
        with self._lock:
            before = self._latest[1]
            self._latest = (placed, before if 0.0 < (before - stamp).to_sec() < JUMP_BACK_S else stamp)

    def close(self) -> None:
        """Take the topic back. Idempotent."""
        self._stop.set()
        self._thread.join()
        release(self._publisher)

    def _run(self) -> None:
        while not self._stop.wait(PERIOD_S):
            try:
                self._cycle()
            except Exception as error:  # one bad cycle ends nothing
                if not self._stop.is_set() and not rospy.is_shutdown():
                    rospy.logerr_throttle(_LOG_PERIOD_S, "/people: %s: %s", type(error).__name__, error)
        self._rest()

    def _cycle(self) -> None:
        if not self.is_wanted:
            self._rest()
            return
        if self._tags is None:
            self._tags = _Tags()
        with self._lock:
            states, stamp = self._latest
        people = self._placed(states)
        if people:
            self._tags.update()
        # A list without anybody says that nobody is there; its frame then means nothing.
        frame = people[0].place.frame if people else ""
        self._publisher.publish(People(
            header=make_header(stamp, frame), people=[_to_msg(person, self._tags) for person in people]))

    def _placed(self, states: Tuple[PersonState, ...]) -> List[_PlacedPerson]:
        """Those of one frame, with their velocities: zero for who is not seen now."""
        frames = [state.place.frame for state in states if state.place is not None]
        frame = max(sorted(set(frames)), key=frames.count, default="")
        self._motions = {state.id: self._motions.get(state.id) or CoastingMotion(_SMOOTHED_S) for state in states}
        found = []
        for state in states:
            if state.place is not None and state.place.frame == frame:
                motion = self._motions[state.id]
                motion.see(state.place)
                found.append(_PlacedPerson(state, state.place,
                                           motion.velocity if state.confidence >= 1.0 else np.zeros(3)))
        return found

    def _rest(self) -> None:
        """Nobody listens: let go of what others say of people."""
        self._motions.clear()
        if self._tags is not None:
            self._tags.close()
            self._tags = None


class _Tags:
    """What other nodes say of people, for the tags: group, engagement, posture."""

    def __init__(self) -> None:
        self._humans = Humans(patience=0.0)
        self._groups: Dict[str, str] = {}
        self._persons: Dict[str, Person] = {}
        self._bodies: Dict[str, Body] = {}

    def update(self) -> None:
        """Look anew who is there and who stands together."""
        self._persons, self._bodies = self._humans.persons, self._humans.bodies
        self._groups = {member: group.id for group in self._humans.groups for member in group.members}

    def of(self, state: PersonState) -> Dict[str, str]:
        """Tag names and tags of a person; what is not known is left out."""
        found = {}
        if state.id in self._groups:
            found["group"] = self._groups[state.id]
        person, body = self._persons.get(state.id), self._bodies.get(state.body)
        if person is not None and person.engagement != Engagement.UNKNOWN:
            found["engagement"] = person.engagement.name.lower()
        posture = body.posture if body is not None else None
        if posture not in (None, Posture.OTHER):
            found["posture"] = posture.name.lower()
        return found

    def close(self) -> None:
        """Unsubscribe from everything."""
        self._humans.close()


def _to_msg(person: _PlacedPerson, tags: _Tags) -> PersonMsg:
    named = tags.of(person.state)
    return PersonMsg(name=person.state.id, position=Point(*person.place.pose.translation.tolist()),
                     velocity=Point(*person.velocity.tolist()), reliability=float(person.state.confidence),
                     tagnames=list(named), tags=list(named.values()))


def position_to_msg(place: Place, stamp: genpy.Time) -> Optional[PoseWithCovarianceStamped]:
    """Return a place with the covariance of its position; None where that is not known.

    The orientation is that of the person's frame; its variances say that nothing is known of how exact it is.
    """
    if place.covariance is None:
        return None
    full = np.zeros((6, 6))
    full[:3, :3] = place.covariance
    full[[3, 4, 5], [3, 4, 5]] = _HEADING_VARIANCE
    pose = PoseMsg(Point(*place.pose.translation.tolist()), Quaternion(*(float(value) for value in
                                                                         place.pose.quaternion)))
    return PoseWithCovarianceStamped(make_header(stamp, place.frame), PoseWithCovariance(pose, full.ravel().tolist()))
