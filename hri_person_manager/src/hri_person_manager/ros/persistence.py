"""What outlives the person manager: the file of the parameter `store`, and, for the time after a crash, who is made of
which faces, bodies and voices."""

from __future__ import annotations

import threading
import time
import xmlrpc.client
from pathlib import Path
from typing import Callable, Dict, List, Mapping, Optional, Sequence

import rospy

from hri_person_manager.core.features import FEATURES, Kind, MatchNode
from hri_person_manager.core.parameters import PersonManagerSettings
from hri_person_manager.core.register import PersonRecord, SqliteRecordStore, record_of
from hri_pipeline.core.ids import is_valid_id
from hri_pipeline.core.parameters import ParameterError
from hri_pipeline.core.privacy import DataUse, StoreError, TemplateCipher
from hri_pipeline.core.process import is_clock_synchronised
from hri_pipeline.core.recognition.store import PersonStore, read_store
from hri_pipeline.core.recognition.stored_gallery import SHARED_ENDINGS

_RESTART_PERIOD_S = 0.5    # s between two writes of the state for a restart
_RESTART_REPEAT_S = 10.0   # s; it is written again although nothing has changed: a new master has no parameters
_MOST_RESTORED = 500       # persons


def open_store(settings: PersonManagerSettings) -> Optional[SqliteRecordStore]:
    """Open the file of the parameter `store` and say so; None without one.

    Raises ParameterError naming the parameter and the fix when the file cannot be used.
    """
    if not settings.store:
        rospy.loginfo("persons are kept in memory only (parameter store is empty)")
        return None
    if Path(settings.store).suffix not in SHARED_ENDINGS:
        raise ParameterError("~store: {} does not end in {}, by which recognisers know the file that they share; name "
                             "it so".format(settings.store, ", ".join(SHARED_ENDINGS)))
    try:
        store = PersonStore(settings.store, _cipher(settings), rospy.logerr)
        store.load_records()    # a wrong key, or none, is told at the start
    except StoreError as error:
        raise ParameterError("~store: {}".format(error)) from error
    rospy.logwarn("persons are kept across runs in %s: ids, names, languages, apparent age and gender, times, "
                  "templates of faces%s. Forget them with `rosrun hri_person_manager people forget ID`", store.path,
                  ", encrypted" if settings.store_key else "")
    return SqliteRecordStore(store, settings.store_max_age, settings.store_max_persons, is_clock_synchronised)


def _cipher(settings: PersonManagerSettings) -> Optional[TemplateCipher]:
    return TemplateCipher(settings.store_key) if settings.store_key else None


def data_use(settings: PersonManagerSettings, records: Sequence[PersonRecord]) -> DataUse:
    """Return what is computed of persons and kept of them; records: everybody who is known."""
    stored = ("ids", "consent", "names", "languages", "apparent age and gender", "times") if settings.store else ()
    return DataUse(("who belongs together", "positions", "names and languages that were given",
                    "apparent age and gender over time"), settings.store, stored,
                   settings.store_max_age if settings.store else 0.0, bool(settings.store and settings.store_key),
                   tuple(record.id for record in records if record.enrolled))


def borrowed_records(settings: PersonManagerSettings) -> List[PersonRecord]:
    """Read the stores of the parameter `store_read_only`. Raises ParameterError when one cannot be used."""
    try:
        return [record_of(row) for path in settings.store_read_only
                for row in read_store(path, _cipher(settings), notify=rospy.logwarn)[0]]
    except StoreError as error:
        raise ParameterError("~store_read_only: {}".format(error)) from error


class RestartState:
    """Writes who is made of which features whenever that changes; ids only, nothing about the human.

    The parameter stands beside the node's own ones, NODE_memory: those are checked, and cleared by roslaunch. A thread
    writes it: persons do not wait for a master that a failed network has cut off.
    """

    def __init__(self) -> None:
        self._name = rospy.get_name() + "_memory"
        self._wanted: Dict[str, List[str]] = {}
        self._is_failed = self._is_due = self._is_writing = self._is_closing = False
        self._next = self._again = 0.0
        self._condition = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="restart state", daemon=True)
        self._thread.start()

    def read(self) -> Dict[str, List[MatchNode]]:
        """What an earlier run has left: {person id: features}. What is not of that form is left out."""
        given = rospy.get_param(self._name, {})
        if not isinstance(given, dict):
            return {}
        found: Dict[str, List[MatchNode]] = {}
        for person_id, names in list(given.items())[:_MOST_RESTORED]:
            if is_valid_id(person_id) and isinstance(names, list):
                found[person_id] = [node for name in names for node in _nodes(name)]
        return found

    def update(self, persons: Callable[[], Mapping[str, List[MatchNode]]], at_once: bool = False) -> None:
        """Have the persons with their features, which are asked for, written: twice a second at most, or at once."""
        now = time.monotonic()
        if now < self._next and not at_once:
            return
        self._next = now + _RESTART_PERIOD_S
        wanted = {person_id: ["%s %s" % (node.kind.name, node.id) for node in nodes]
                  for person_id, nodes in persons().items()}
        with self._condition:
            # Again and again: a master that was started anew has no parameters.
            if wanted != self._wanted or self._is_failed or (wanted and now >= self._again):
                self._wanted, self._again = wanted, now + _RESTART_REPEAT_S
                self._is_due = True
                self._condition.notify_all()

    def wait(self, patience: float = _RESTART_PERIOD_S) -> None:
        """Return when all is written, after `patience` s at most."""
        with self._condition:
            self._condition.wait_for(lambda: not (self._is_due or self._is_writing), patience)

    def close(self) -> None:
        """Take the parameter back: an orderly end is no crash. Idempotent."""
        with self._condition:
            self._is_closing = True
            self._condition.notify_all()
        self._thread.join(_RESTART_PERIOD_S)
        try:
            if rospy.has_param(self._name):
                rospy.delete_param(self._name)
        except (OSError, rospy.ROSException, xmlrpc.client.Error):
            pass            # it went with the master

    def _run(self) -> None:
        while True:
            with self._condition:
                self._condition.wait_for(lambda: self._is_due or self._is_closing)
                if self._is_closing:
                    return
                wanted, self._is_due, self._is_writing = self._wanted, False, True
            is_failed = not self._write(wanted)
            with self._condition:
                self._is_failed, self._is_writing = is_failed, False
                self._condition.notify_all()

    def _write(self, wanted: Dict[str, List[str]]) -> bool:
        try:
            rospy.set_param(self._name, wanted)
            return True
        except Exception:       # the master is away, and rospy raises many kinds; the next time may be better
            return False


def _nodes(name: object) -> List[MatchNode]:
    """The node that a text such as `FACE abcde` names, as a list; empty when it names none."""
    kind, _, identity = str(name).partition(" ")
    known = {feature.name: feature for feature in FEATURES}
    return [MatchNode(Kind(known[kind]), identity)] if kind in known and is_valid_id(identity) else []
