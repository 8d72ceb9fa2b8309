"""Everybody whom the stack perceives now."""

from __future__ import annotations

import threading
import time
from types import TracebackType
from typing import Any, Callable, Dict, Generic, List, Optional, Tuple, Type, TypeVar

import rospy

from hri_pipeline.client import values
from hri_pipeline.client.frames import PeopleFrames
from hri_pipeline.client.people import Body, Face, Human, Person, Voice
from hri_pipeline.client.topics import LazyTopic
from hri_pipeline.client.values import GazeOfPerson, GroupOfPersons
from hri_pipeline.ros.feature_feed import FeatureFeed

Kind = TypeVar("Kind", bound=Human)

# Gazes and groups are sent all the time while they last. Without a word for so long their node has gone.
_SILENCE_S = 3.0
_MAX_OF_A_KIND = 100


class Humans:
    """Live faces, bodies, voices and persons, gazes and groups.

    rospy.init_node must have been called. Nothing is subscribed to before it is asked for: a program that reads the names of
    persons costs nothing for faces. Callbacks run in rospy's threads; what they raise is logged. patience: s that a
    first question waits for an answer that is there already. Use it in a `with`, or call close().
    """

    def __init__(self, patience: float = 0.5) -> None:
        if not 0.0 <= patience <= 60.0:
            raise ValueError("patience is {} s, legal range 0 to 60".format(patience))
        self.patience = patience
        self.frames = PeopleFrames()
        self._lock = threading.RLock()
        self._crowds: Dict[str, _Crowd] = {}
        self._interactions: Dict[str, LazyTopic] = {}
        self._groups: Dict[str, Tuple[GroupOfPersons, float]] = {}
        self._closed = False

    @property
    def faces(self) -> Dict[str, Face]:
        """The faces that are tracked now, by id."""
        return self._crowd(Face).present()

    @property
    def bodies(self) -> Dict[str, Body]:
        """The bodies that are tracked now, by id."""
        return self._crowd(Body).present()

    @property
    def voices(self) -> Dict[str, Voice]:
        """The voices that are tracked now, by id."""
        return self._crowd(Voice).present()

    @property
    def persons(self) -> Dict[str, Person]:
        """The persons who are tracked now, by id."""
        return self._crowd(Person).present()

    @property
    def gazes(self) -> List[GazeOfPerson]:
        """Who looks at whom now."""
        topic = self._interaction("gaze", values.gazes)
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
        self._crowd(Face).listen(came, left)

    def on_body(self, came: Optional[Callable[[Body], None]] = None,
                left: Optional[Callable[[Body], None]] = None) -> None:
        """Call `came` for each body that is there or comes, `left` when it has gone."""
        self._crowd(Body).listen(came, left)

    def on_voice(self, came: Optional[Callable[[Voice], None]] = None,
                 left: Optional[Callable[[Voice], None]] = None) -> None:
        """Call `came` for each voice that is there or comes, `left` when it has gone."""
        self._crowd(Voice).listen(came, left)

    def on_person(self, came: Optional[Callable[[Person], None]] = None,
                  left: Optional[Callable[[Person], None]] = None) -> None:
        """Call `came` for each person who is there or comes, `left` when they have gone."""
        self._crowd(Person).listen(came, left)

    def on_gazes(self, call: Callable[[List[GazeOfPerson]], None]) -> None:
        """Call `call` with all gazes, each time that they are told: some times a second."""
        with self._lock:
            self._close_interaction("gaze")
            self._interactions["gaze"] = LazyTopic("/humans/interactions/gaze", values.gazes, on_value=_guarded(call))
            self._interactions["gaze"].get()

    def close(self) -> None:
        """Let go of everything. Idempotent."""
        with self._lock:
            self._closed = True
            owners: List[Any] = list(self._crowds.values()) + list(self._interactions.values())
            self._crowds, self._interactions = {}, {}
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

    def _crowd(self, kind: Type[Kind]) -> "_Crowd[Kind]":
        with self._lock:
            self._check_open()
            if kind.KIND not in self._crowds:
                self._crowds[kind.KIND] = _Crowd(kind, self)
            crowd = self._crowds[kind.KIND]
        crowd.start(self.patience)
        return crowd

    def _interaction(self, name: str, convert: Callable[[Any], Any]) -> LazyTopic:
        with self._lock:
            self._check_open()
            if name not in self._interactions:
                self._interactions[name] = LazyTopic("/humans/interactions/" + name, convert)
            return self._interactions[name]

    def _close_interaction(self, name: str) -> None:
        if name in self._interactions:
            self._interactions.pop(name).close()

    def _note_groups(self, message: Any) -> None:
        """Take all groups of a message, or the one of a message of REP-155's type."""
        groups, now = values.groups(message), time.monotonic()
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


class _Crowd(Generic[Kind]):
    """Everybody of one kind: objects that come and go with the tracked list."""

    def __init__(self, kind: Type[Kind], humans: Humans) -> None:
        self._kind = kind
        self._humans = humans
        self._lock = threading.RLock()
        self._first = threading.Event()
        self._people: Dict[str, Kind] = {}
        self._came: List[Callable[[Kind], None]] = []
        self._left: List[Callable[[Kind], None]] = []
        self._feed: Optional[FeatureFeed] = None

    def start(self, patience: float) -> None:
        """Listen, and wait a moment for the first list, which is latched."""
        with self._lock:
            fresh = self._feed is None
            if fresh:
                self._feed = FeatureFeed(self._kind.KIND, {}, lambda *_: None, self._on_tracked, max_ids=_MAX_OF_A_KIND)
        if fresh:
            self._first.wait(patience)

    def present(self) -> Dict[str, Kind]:
        """Return those who are there."""
        with self._lock:
            return dict(self._people)

    def listen(self, came: Optional[Callable[[Kind], None]], left: Optional[Callable[[Kind], None]]) -> None:
        """Call these from now on; `came` at once for those who are there."""
        with self._lock:
            there = list(self._people.values())
            if came is not None:
                self._came.append(_guarded(came))
            if left is not None:
                self._left.append(_guarded(left))
        if came is not None:
            for human in there:
                _guarded(came)(human)

    def close(self) -> None:
        """Let go of everybody. Idempotent."""
        if self._feed is not None:
            self._feed.close()
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
                call(human)
        for human in arrived:
            for call in came:
                call(human)


def _guarded(call: Callable[[Any], None]) -> Callable[[Any], None]:
    """The same function, which logs what it raises: one error of a user's callback ends nothing."""
    def guarded(value: Any) -> None:
        try:
            call(value)
        except Exception as error:
            rospy.logerr("a callback of Humans failed: %s: %s", type(error).__name__, error)
    return guarded
