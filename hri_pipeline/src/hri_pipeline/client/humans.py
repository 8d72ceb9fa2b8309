"""Faces, bodies, voices and persons as objects that come and go, and everybody whom the stack perceives now.

Values are read from the graph when they are asked for.
"""

from __future__ import annotations

import queue
import threading
import time
from functools import partial
from types import TracebackType
from typing import Any, Callable, Dict, Generic, List, NamedTuple, Optional, Tuple, Type, TypeVar

import numpy as np
import rospy

from hri_pipeline.client import topics
from hri_pipeline.client.topics import (
    Attitude,
    Demographics,
    Engagement,
    Expression,
    GazeOfPerson,
    Gesture,
    GroupOfPersons,
    HumanPoses,
    LazyTopic,
    Location,
    Posture,
    Region,
)
from hri_pipeline.core.geometry import Pose
from hri_pipeline.ros.rospy_compat import WallTimeThrottle, reconnect_to_returning_publishers
from hri_pipeline.ros.subscriptions import IdSubscribers

_LOG_PERIOD_S = 10.0


class _Topic(NamedTuple):
    convert: Callable[[Any], Any]
    latched: bool = False


def _data(message: Any) -> Any:
    return message.data


class Human:
    """What faces, bodies, voices and persons have in common. It stays valid, with its last values, when it has left.

    A value is None until it has come. Latched values that the stack has published already are there at the first
    question; others come with the next image or sound after it.
    """

    KIND = ""
    FRAME = ""
    TOPICS: Dict[str, _Topic] = {}

    def __init__(self, identity: str, humans: "Humans") -> None:
        self.id = identity
        self._humans = humans
        self._topics = {name: LazyTopic("/humans/{}/{}/{}".format(self.KIND, identity, name), topic.convert,
                                        topic.latched,
                                        humans.patience) for name, topic in self.TOPICS.items()}
        self._present = True

    @property
    def present(self) -> bool:
        """Whether it is tracked now."""
        return self._present

    def pose(self, frame: str = "") -> Optional[Pose]:
        """Return where it is (m) in `frame`; None while that is not known.

        Without a frame: in the frame in which the stack publishes it, which is that of the sensor or, for a person,
        /humans/reference_frame.
        """
        return self._pose(self.FRAME, frame)

    def close(self) -> None:
        """Unsubscribe from all topics. Done by Humans when it leaves. Idempotent."""
        self._present = False
        for topic in self._topics.values():
            topic.close()
        self._humans.frames.forget(self.id)

    def _pose(self, kind: str, frame: str) -> Optional[Pose]:
        # Who has left is nowhere; to ask for their frames again would keep them for good.
        if not self._present:
            return None
        found = self._humans.frames.pose(kind, self.id, frame.lstrip("/"))
        if not self._present:       # since this moment
            self._humans.frames.forget(self.id)
        return None if found is None else found[0]

    def _get(self, name: str, default: Any = None) -> Any:
        return self._topics[name].get(default)

    def __repr__(self) -> str:
        """Return kind and id."""
        return "{}({!r})".format(type(self).__name__, self.id)


class Face(Human):
    """A face. pose(): origin at the sellion, x out of the face, z to the scalp."""

    KIND, FRAME = "faces", "face"
    TOPICS = {"roi": _Topic(topics.region), "landmarks": _Topic(topics.landmarks), "facs": _Topic(topics.action_units),
              "expression": _Topic(topics.expression), "softbiometrics": _Topic(topics.soft_biometrics),
              "cropped": _Topic(topics.picture), "aligned": _Topic(topics.picture)}

    @property
    def roi(self) -> Optional[Region]:
        """Its box in the image."""
        return self._get("roi")

    @property
    def landmarks(self) -> Optional[np.ndarray]:
        """(70, 3) x, y (0 to 1 of the image), confidence."""
        return self._get("landmarks")

    @property
    def action_units(self) -> Optional[Dict[int, float]]:
        """Intensity (0 to 1) by the number of the action unit."""
        return self._get("facs")

    @property
    def expression(self) -> Optional[Expression]:
        """What it expresses."""
        return self._get("expression")

    @property
    def demographics(self) -> Optional[Demographics]:
        """Apparent age and gender."""
        return self._get("softbiometrics")

    @property
    def cropped(self) -> Optional[np.ndarray]:
        """(H, W, 3) uint8 BGR picture of the face; made for those who ask, unless privacy settings forbid."""
        return self._get("cropped")

    @property
    def aligned(self) -> Optional[np.ndarray]:
        """The same, turned so that the eyes are level."""
        return self._get("aligned")

    def gaze(self, frame: str = "") -> Optional[Pose]:
        """Return the pose of gaze_ID: z along the gaze. None while it is not known, as with closed eyes.

        With `interface:=rep155` it is the direction of the head then.
        """
        return self._pose("gaze", frame)


class Body(Human):
    """A body. pose(): origin between the hips, x forward, z to the head."""

    KIND, FRAME = "bodies", "body"
    TOPICS = {"roi": _Topic(topics.region), "skeleton2d": _Topic(topics.skeleton),
              "joint_states": _Topic(topics.joints), "cropped": _Topic(topics.picture),
              "attitude": _Topic(lambda message: topics.choice(Attitude, message.attitude)),
              "posture": _Topic(lambda message: topics.choice(Posture, message.posture)),
              "gesture": _Topic(lambda message: topics.choice(Gesture, message.gesture))}

    @property
    def roi(self) -> Optional[Region]:
        """Its box in the image."""
        return self._get("roi")

    @property
    def skeleton(self) -> Optional[np.ndarray]:
        """(18, 3) x, y (0 to 1 of the image), confidence, in the order of hri_msgs/Skeleton2D."""
        return self._get("skeleton2d")

    @property
    def joints(self) -> Optional[Dict[str, float]]:
        """Angle (rad) by name of the joint."""
        ending, joints = "_" + self.id, self._get("joint_states")
        return joints and {name[:-len(ending)] if name.endswith(ending) else name: angle for name,
                           angle in joints.items()}

    @property
    def attitude(self) -> Optional[Attitude]:
        """What the arms do."""
        return self._get("attitude")

    @property
    def posture(self) -> Optional[Posture]:
        """Standing, sitting, lying ..."""
        return self._get("posture")

    @property
    def gesture(self) -> Optional[Gesture]:
        """What the hands do."""
        return self._get("gesture")

    @property
    def cropped(self) -> Optional[np.ndarray]:
        """(H, W, 3) uint8 BGR picture of the body; made for those who ask."""
        return self._get("cropped")

    def link(self, name: str, frame: str = "") -> Optional[Pose]:
        """Return the pose of a link of the skeleton, for instance head, l_wrist or torso."""
        return self._pose(name, frame)


class Voice(Human):
    """A voice. pose(): in the direction that it comes from; its orientation means nothing."""

    KIND, FRAME = "voices", "voice"
    TOPICS = {"is_speaking": _Topic(_data, True), "speech": _Topic(topics.speech),
              "features": _Topic(topics.audio_features)}

    @property
    def is_speaking(self) -> Optional[bool]:
        """Whether it speaks now."""
        return self._get("is_speaking")

    @property
    def speech(self) -> Optional[str]:
        """What it has said last."""
        return self._get("speech")

    @property
    def features(self) -> Optional[Dict[str, float]]:
        """The 16 descriptors of its sound, by name."""
        return self._get("features")


class Person(Human):
    """A person, who keeps the id whatever is seen. pose(): that of face, head or voice, or the last known place."""

    KIND, FRAME = "persons", "person"
    TOPICS = {"face_id": _Topic(_data, True), "body_id": _Topic(_data, True), "voice_id": _Topic(_data, True),
              "name": _Topic(_data, True), "native_language": _Topic(_data, True), "alias": _Topic(_data, True),
              "anonymous": _Topic(_data, True), "location_confidence": _Topic(_data, True),
              "demographics": _Topic(topics.demographics, True), "position": _Topic(topics.location),
              "engagement_status": _Topic(lambda message: topics.choice(Engagement, message.level), True)}

    @property
    def face(self) -> Optional[Face]:
        """The face that is seen of this person now."""
        return self._humans.faces.get(self._get("face_id", ""))

    @property
    def body(self) -> Optional[Body]:
        """The body that is seen of this person now."""
        return self._humans.bodies.get(self._get("body_id", ""))

    @property
    def voice(self) -> Optional[Voice]:
        """The voice that is heard of this person now."""
        return self._humans.voices.get(self._get("voice_id", ""))

    @property
    def name(self) -> str:
        """The name that somebody has given; empty without one."""
        return self._get("name", "")

    @property
    def native_language(self) -> str:
        """IETF tag, for instance en-GB; empty where not known."""
        return self._get("native_language", "")

    @property
    def alias(self) -> str:
        """The id that this person goes by since two turned out to be one; empty while it is its own."""
        return self._get("alias", "")

    @property
    def anonymous(self) -> bool:
        """Whether no recogniser has confirmed yet who this is."""
        return self._get("anonymous", True)

    @property
    def location_confidence(self) -> float:
        """1 while seen or heard, less with time, 0 when it is not known any more where the person is."""
        return self._get("location_confidence", 0.0)

    @property
    def location(self) -> Optional[Location]:
        """Where this person is, with its covariance at its stamp; while seen or heard, it is new with each image or
        sound."""
        return self._get("position")

    @property
    def location_age(self) -> float:
        """Seconds (of the wall clock) since `location` came; infinite while none has come."""
        return self._topics["position"].age

    @property
    def demographics(self) -> Optional[Demographics]:
        """Apparent age and gender, from all that was seen of this person."""
        return self._get("demographics")

    @property
    def engagement(self) -> Engagement:
        """How far this person is engaged with the robot."""
        return self._get("engagement_status", Engagement.UNKNOWN)

    @property
    def looks_at(self) -> Optional[str]:
        """Id of the person whom this one looks at, "" for the robot; None for nobody."""
        return next((gaze.receiver for gaze in self._humans.gazes if gaze.sender == self.id), None)

    @property
    def looks_at_robot(self) -> bool:
        """Whether this person looks at the robot now."""
        return self.looks_at == topics.ROBOT


Kind = TypeVar("Kind", bound=Human)

# Gazes and groups are sent all the time while they last. Without a word for so long their node has gone.
_SILENCE_S = 3.0
_MAX_OF_A_KIND = 100


class Humans:
    """Live faces, bodies, voices and persons, gazes and groups.

    rospy.init_node must have been called. Nothing is subscribed to before it is asked for: a program that reads the
    names of persons costs nothing for faces. Callbacks run in threads of their own, one per kind (those of gazes in
    rospy's): one that waits holds up the next callback, but not who is there. What they raise is logged. patience: s
    that a first question waits for an answer that is there already. Use it in a `with`, or call close().
    """

    def __init__(self, patience: float = 0.5) -> None:
        if not 0.0 <= patience <= 60.0:
            raise ValueError("patience is {} s, legal range 0 to 60".format(patience))
        reconnect_to_returning_publishers()
        self.patience = patience
        self.frames = HumanPoses()
        self._lock = threading.RLock()
        self._lists: Dict[str, _Tracked] = {}
        self._interactions: Dict[str, LazyTopic] = {}
        self._gaze_calls: List[Callable[[List[GazeOfPerson]], None]] = []
        self._groups: Dict[str, Tuple[GroupOfPersons, float]] = {}
        self._closed = False

    @property
    def faces(self) -> Dict[str, Face]:
        """The faces that are tracked now, by id."""
        return self._list(Face).present()

    @property
    def bodies(self) -> Dict[str, Body]:
        """The bodies that are tracked now, by id."""
        return self._list(Body).present()

    @property
    def voices(self) -> Dict[str, Voice]:
        """The voices that are tracked now, by id."""
        return self._list(Voice).present()

    @property
    def persons(self) -> Dict[str, Person]:
        """The persons who are tracked now, by id."""
        return self._list(Person).present()

    @property
    def gazes(self) -> List[GazeOfPerson]:
        """Who looks at whom now."""
        topic = self._interaction("gaze", topics.gazes, self._on_gazes)
        found = topic.get([])
        return list(found) if topic.age < _SILENCE_S else []

    @property
    def groups(self) -> List[GroupOfPersons]:
        """Who stands together now."""
        self._interaction("groups", self._note_groups).get()
        with self._lock:
            return [group for group, heard in self._groups.values() if time.monotonic() - heard < _SILENCE_S]

    def on_face(self, came: Optional[Callable[[Face], None]] = None,
                left: Optional[Callable[[Face], None]] = None) -> None:
        """Call `came` for each face that is there or comes, `left` when it has gone."""
        self._list(Face).listen(came, left)

    def on_body(self, came: Optional[Callable[[Body], None]] = None,
                left: Optional[Callable[[Body], None]] = None) -> None:
        """Call `came` for each body that is there or comes, `left` when it has gone."""
        self._list(Body).listen(came, left)

    def on_voice(self, came: Optional[Callable[[Voice], None]] = None,
                 left: Optional[Callable[[Voice], None]] = None) -> None:
        """Call `came` for each voice that is there or comes, `left` when it has gone."""
        self._list(Voice).listen(came, left)

    def on_person(self, came: Optional[Callable[[Person], None]] = None,
                  left: Optional[Callable[[Person], None]] = None) -> None:
        """Call `came` for each person who is there or comes, `left` when they have gone."""
        self._list(Person).listen(came, left)

    def on_gazes(self, call: Callable[[List[GazeOfPerson]], None]) -> None:
        """Call `call` with all gazes, each time that they are published: some times a second."""
        with self._lock:
            self._gaze_calls.append(_guarded(call))
        self._interaction("gaze", topics.gazes, self._on_gazes).get()

    def close(self) -> None:
        """Unsubscribe from everything. Idempotent."""
        with self._lock:
            self._closed = True
            owners: List[Any] = list(self._lists.values()) + list(self._interactions.values())
            self._lists, self._interactions = {}, {}
        for owner in owners:
            owner.close()
        self.frames.close()

    def __enter__(self) -> "Humans":
        """Return itself."""
        return self

    def __exit__(self, kind: Optional[Type[BaseException]], error: Optional[BaseException],
                 trace: Optional[TracebackType]) -> None:
        """Close."""
        self.close()

    def _list(self, kind: Type[Kind]) -> "_Tracked[Kind]":
        with self._lock:
            self._check_open()
            if kind.KIND not in self._lists:
                self._lists[kind.KIND] = _Tracked(kind, self)
            tracked = self._lists[kind.KIND]
        tracked.start(self.patience)
        return tracked

    def _interaction(self, name: str, convert: Callable[[Any], Any],
                     on_value: Optional[Callable[[Any], None]] = None) -> LazyTopic:
        with self._lock:
            self._check_open()
            if name not in self._interactions:
                self._interactions[name] = LazyTopic("/humans/interactions/" + name, convert, on_value=on_value,
                                                     queue_size=_MAX_OF_A_KIND)
            return self._interactions[name]

    def _on_gazes(self, gazes: List[GazeOfPerson]) -> None:
        with self._lock:
            calls = list(self._gaze_calls)
        for call in calls:
            call(gazes)

    def _note_groups(self, message: Any) -> None:
        """Take all groups of a message, or the one of a message of REP-155's type."""
        groups, now = topics.groups(message), time.monotonic()
        with self._lock:
            if hasattr(message, "groups"):
                self._groups.clear()
            else:
                for old in [key for key, (_, heard) in self._groups.items() if now - heard > _SILENCE_S]:
                    del self._groups[old]
            self._groups.update((group.id, (group, now)) for group in groups)

    def _check_open(self) -> None:
        if self._closed:
            raise ValueError("this Humans has been closed; make a new one")
        if not rospy.core.is_initialized():
            raise RuntimeError("call rospy.init_node before the first use of Humans")


class _Calls:
    """Calls functions one after the other, in a thread of its own: a user's callback may wait, as for speech to end."""

    def __init__(self) -> None:
        self._calls: "queue.SimpleQueue[Optional[Callable[[], None]]]" = queue.SimpleQueue()
        self._thread: Optional[threading.Thread] = None
        self._closed = False

    def add(self, call: Callable[[], None]) -> None:
        """Have this called after those before it. By one thread at a time."""
        self._calls.put(call)
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="callbacks of Humans", daemon=True)
            self._thread.start()

    def close(self) -> None:
        """Call nothing more. Idempotent."""
        self._closed = True
        self._calls.put(None)

    def _run(self) -> None:
        for call in iter(self._calls.get, None):
            if self._closed:
                return
            call()


class _Tracked(Generic[Kind]):
    """Everybody of one kind: objects that come and go with the tracked list."""

    def __init__(self, kind: Type[Kind], humans: Humans) -> None:
        self._kind = kind
        self._humans = humans
        self._lock = threading.RLock()
        self._first = threading.Event()
        self._people: Dict[str, Kind] = {}
        self._came: List[Callable[[Kind], None]] = []
        self._left: List[Callable[[Kind], None]] = []
        self._feed: Optional[IdSubscribers] = None
        self._calls = _Calls()

    def start(self, patience: float) -> None:
        """Listen, and wait a moment for the first list, which is latched."""
        with self._lock:
            fresh = self._feed is None
            if fresh:
                self._feed = IdSubscribers(self._kind.KIND, {}, lambda *_: None, self._on_tracked,
                                           max_ids=_MAX_OF_A_KIND)
        if fresh:
            self._first.wait(patience)

    def present(self) -> Dict[str, Kind]:
        """Return those who are there."""
        with self._lock:
            return dict(self._people)

    def listen(self, came: Optional[Callable[[Kind], None]], left: Optional[Callable[[Kind], None]]) -> None:
        """Call these from now on; `came` at once for those who are there, before anything else is told of them."""
        told = threading.Event()
        guarded = None if came is None else _guarded(came)
        with self._lock:
            there = list(self._people.values())
            if guarded is not None:
                self._came.append(_after(told, guarded))
            if left is not None:
                self._left.append(_after(told, _guarded(left)))
        try:
            if guarded is not None:
                for human in there:
                    guarded(human)
        finally:
            told.set()

    def close(self) -> None:
        """Forget everybody. Idempotent."""
        if self._feed is not None:
            self._feed.close()
        self._calls.close()
        with self._lock:
            people, self._people = list(self._people.values()), {}
        for human in people:
            human.close()

    def _on_tracked(self, ids: List[str]) -> None:
        with self._lock:
            gone = [self._people.pop(identity) for identity in list(self._people) if identity not in ids]
            new = [identity for identity in ids if identity not in self._people]
            self._people.update((identity, self._kind(identity, self._humans)) for identity in new)
            arrived = [self._people[identity] for identity in new]
            came, left = list(self._came), list(self._left)
        self._first.set()
        for human in gone:
            human.close()
            for call in left:
                self._calls.add(partial(call, human))
        for human in arrived:
            for call in came:
                self._calls.add(partial(call, human))


def _after(event: threading.Event, call: Callable[[Any], None]) -> Callable[[Any], None]:
    """The same function, which waits for an event first."""
    def waiting(value: Any) -> None:
        event.wait()
        call(value)
    return waiting


def _guarded(call: Callable[[Any], None]) -> Callable[[Any], None]:
    """The same function, which logs what it raises: one error of a user's callback ends nothing. One that fails with
    each message hides neither its other errors nor those of other callbacks."""
    is_due = WallTimeThrottle()

    def guarded(value: Any) -> None:
        try:
            call(value)
        except Exception as error:
            if is_due(type(error).__name__, _LOG_PERIOD_S):
                rospy.logerr("a callback of Humans failed: %s: %s", type(error).__name__, error)
    return guarded
