"""The services of the person manager: names, languages, merging, forgetting, exporting, enrolling."""

from __future__ import annotations

import json
import threading
import time
from typing import TYPE_CHECKING, Any, Callable, Dict, List, Mapping, NamedTuple, Optional, Set, Tuple

import rosgraph
import rospy
import rosservice
from std_srvs.srv import Trigger, TriggerRequest, TriggerResponse

from hri_person_manager.core.register import PersonRegister, RegisterError, legal_name
from hri_person_manager.srv import (
    Enrol,
    EnrolRequest,
    EnrolResponse,
    Export,
    ExportRequest,
    ExportResponse,
    Forget,
    ForgetRequest,
    ForgetResponse,
    ListKnown,
    ListKnownRequest,
    ListKnownResponse,
    Merge,
    MergeRequest,
    MergeResponse,
    SetName,
    SetNameRequest,
    SetNameResponse,
    SetNativeLanguage,
    SetNativeLanguageRequest,
    SetNativeLanguageResponse,
    Split,
    SplitRequest,
    SplitResponse,
)
from hri_pipeline.core.ids import is_valid_id
from hri_pipeline.core.privacy import StoreError
from hri_pipeline.ros.conversions import to_time
from hri_pipeline.ros.master import patient_master
from hri_pipeline.ros.services import call_service, wait_for_service
from hri_pipeline.srv import Gallery, GalleryRequest, GalleryResponse

if TYPE_CHECKING:     # scipy takes most of a second, which no command has to wait for
    from hri_person_manager.core.manager import PersonManager
    from hri_person_manager.core.match_graph import MatchGuard

GALLERY_SUFFIX = "/gallery"
GALLERY_PATIENCE_S = 2.0
GALLERY_ANSWER_S = 10.0     # it may wait for its disk
_NO_RECOGNISER = ("no recogniser can learn a face or voice: no service ~gallery is offered. Start the node faces with "
                  "recognition on, or voices with voice_identity")
SERVICE_PATIENCE_S = 5.0
SERVICE_ANSWER_S = 40.0     # three recognisers may hang
LIST_ANSWER_S = 10.0        # nobody else is asked
COMMANDS: Dict[str, Tuple[str, type, Tuple[str, ...], str]] = {
    "name": ("set_name", SetName, ("id", "name"), "give a known person a name; '' takes it away"),
    "language": ("set_native_language", SetNativeLanguage, ("id", "language"), "set the native language, such as "
                                                                               "pt-BR"),
    "merge": ("merge", Merge, ("id", "other"), "two ids are one human: OTHER becomes an alias of ID"),
    "split": ("split", Split, ("id",), "undo a merge"),
    "forget": ("forget", Forget, ("id",), "remove everything that is known of a person"),
    "enrol": ("enrol", Enrol, ("id", "name"), "the person ID, who is seen or heard now, agrees to be recognised"),
    "enrol-new": ("enrol_new", Enrol, ("id", "name"), "the same, as a new person although the face looks like "
                                                      "somebody who is known"),
    "export": ("export", Export, ("id",), "print everything that is known of a person, or of all, as JSON"),
}
"""Commands for people: service, its type, the fields of its request, and what it does."""


def find_manager(name: str = "hri_person_manager") -> str:
    """Return the resolved name of the person manager: of this name, or where it is relative, the only one there is.

    Raises rospy.ROSException when there are several others, or no master.
    """
    try:
        offered = [service for service, _ in patient_master().getSystemState()[2]]
    except (rosgraph.MasterException, OSError) as error:
        raise rospy.ROSException("no ROS master at {}: {}".format(rosgraph.get_master_uri(), error)) from error
    managers = [node for node, _, last in (service.rpartition("/") for service in offered)
                if last == "list_known" and node + "/set_name" in offered]
    here = rospy.resolve_name(name)
    if here in managers or not managers or name.startswith("/"):
        return here
    if len(managers) > 1:
        raise rospy.ROSException("several run: {}".format(", ".join(sorted(managers))))
    return managers[0]


def service(node: str, name: str, kind: type, seconds: float = SERVICE_ANSWER_S) -> Callable:
    """Return the service of a person manager as a function.

    Raises rospy.ROSException when it is not offered; the function rospy.ServiceException when it is not answered, after
    `seconds` at most.
    """
    full = "{}/{}".format(node.rstrip("/"), name)
    wait_for_service(full, SERVICE_PATIENCE_S)
    return lambda *values: call_service(full, kind, values, seconds)


def carry_out(node: str, command: str, fields: Mapping[str, str]) -> Any:
    """Call the service of one of the COMMANDS and return its answer; fields: at least those of its request.

    Raises as `service` does.
    """
    name, kind, wanted, _ = COMMANDS[command]
    return service(node, name, kind)(*(fields[field] for field in wanted))


class GalleryAnswer(NamedTuple):
    """What one gallery said."""

    service: str
    response: GalleryResponse

    def data(self) -> Any:
        """The JSON data of the answer, None where there is none that can be read."""
        try:
            return json.loads(self.response.data) if self.response.data else None
        except ValueError:
            return None


def _unanswered(name: str, why: str) -> GalleryAnswer:
    return GalleryAnswer(name, GalleryResponse(success=False, message="{} does not answer: {}".format(name, why)))


class Galleries:
    """Finds the services when they are needed: recognisers come and go. Safe to use from several threads."""

    def __init__(self) -> None:
        self._overdue: Dict[str, threading.Thread] = {}     # calls that are not answered yet, by service

    def call(self, command: str, person_id: str = "", other: str = "") -> List[GalleryAnswer]:
        """Give a command to every gallery. One that does not answer, answers with success false and says so.

        Services of another type are left alone, whatever they are called.
        """
        request = GalleryRequest(command=command, id=person_id, other=other)
        return [answer for name in self.names() for answer in self._ask_in_time(name, request)]

    def _ask_in_time(self, name: str, request: GalleryRequest) -> List[GalleryAnswer]:
        """Ask a gallery in a thread: rospy waits for ever for one whose disk hangs. While it owes an answer it is not
        asked again."""
        found: List[GalleryAnswer] = []
        overdue = self._overdue.get(name)
        if overdue is None or not overdue.is_alive():
            thread = threading.Thread(target=lambda: found.extend(self._ask(name, request)), daemon=True,
                                      name="gallery")
            thread.start()
            thread.join(GALLERY_ANSWER_S)
            if not thread.is_alive():
                return found
            self._overdue[name] = thread
        return [_unanswered(name, "it is busy with what it was asked before")]

    @staticmethod
    def _ask(name: str, request: GalleryRequest) -> List[GalleryAnswer]:
        """Return what a gallery says; nothing for a service of another type."""
        try:
            rospy.wait_for_service(name, GALLERY_PATIENCE_S)
            if rosservice.get_service_type(name) not in (Gallery._type, None):
                return []
            return [GalleryAnswer(name, rospy.ServiceProxy(name, Gallery)(request))]
        except Exception as error:  # of many kinds where it ends meanwhile; no answer would pass for done
            return [_unanswered(name, str(error))]

    def known_to(self, recogniser: str) -> Optional[Set[str]]:
        """Return whom a node knows, None where it has no gallery, or does not answer in time."""
        name = recogniser + GALLERY_SUFFIX
        if name not in self.names():
            return None
        for answer in self._ask_in_time(name, GalleryRequest(command=GalleryRequest.LIST)):
            ids = answer.data() if answer.response.success else None
            if isinstance(ids, list):
                return {str(one) for one in ids}
            rospy.logwarn("%s does not tell whom it knows: %s", name, answer.response.message or "it sent no list")
        return None

    @staticmethod
    def names() -> List[str]:
        """Names of all services that may be a gallery."""
        try:
            services = patient_master().getSystemState()[2]
        except (rosgraph.MasterException, OSError):
            return []
        return sorted(name for name, _ in services if name.endswith(GALLERY_SUFFIX))


class PersonServices:
    """Offers the services and carries them out, in rospy's threads.

    manager, register and guard are used under `lock`; recognisers are called without it, as they answer by matches.
    changed() is called, under the lock, after what is to be published; written(), without it, before a wish is
    answered: it returns when that is in the store, or raises StoreError. Names never get into the log.
    """

    def __init__(self, manager: PersonManager, register: PersonRegister, guard: MatchGuard,
                 lock: threading.RLock, changed: Callable[[], None], written: Callable[[], None]) -> None:
        self._manager, self._register, self._guard = manager, register, guard
        self._lock, self._changed, self._written = lock, changed, written
        self._galleries = Galleries()
        self._services = [rospy.Service("~" + name, kind, _guarded(handler, answer)) for name, kind, handler,
                          answer in (
            ("set_name", SetName, self._kept(self._set_name), SetNameResponse),
            ("set_native_language", SetNativeLanguage, self._kept(self._set_native_language),
             SetNativeLanguageResponse),
            ("merge", Merge, self._kept(self._merge), MergeResponse),
            ("split", Split, self._kept(self._split), SplitResponse),
            ("forget", Forget, self._forget, ForgetResponse),
            ("forget_all", Trigger, self._forget_all, TriggerResponse),
            ("export", Export, self._export, ExportResponse), ("enrol", Enrol, self._kept(self._enrol), EnrolResponse),
            ("enrol_new", Enrol, self._kept(self._enrol_new), EnrolResponse))]
        self._services.append(rospy.Service("~list_known", ListKnown, self._list_known))

    def close(self) -> None:
        """Offer them no more. Idempotent."""
        for service in self._services:
            service.shutdown("closing")

    def known_to(self, recogniser: str) -> Optional[Set[str]]:
        """Return whom a node recognises, None where that cannot be asked; may wait for its answer."""
        return self._galleries.known_to(recogniser)

    def _kept(self, handler: Callable) -> Callable:
        """Let a handler answer when what it has changed is in the store."""
        def handle(request: object) -> object:
            answer = handler(request)
            self._written()
            return answer
        return handle

    def _set_name(self, request: SetNameRequest) -> SetNameResponse:
        with self._lock:
            person_id = self._say(self._register.set_name, request.id, request.name.strip())
            name, _ = self._register.said_of(person_id)
        return SetNameResponse(True, "{} has {} name".format(person_id, "a" if name else "no"))

    def _set_native_language(self, request: SetNativeLanguageRequest) -> SetNativeLanguageResponse:
        with self._lock:
            person_id = self._say(self._register.set_native_language, request.id, request.language)
            _, language = self._register.said_of(person_id)
        return SetNativeLanguageResponse(True, "native language of {}: {}".format(person_id, language or "not known"))

    def _say(self, tell: Callable[[str, str], None], known_as: str, what: str) -> str:
        """Tell the register something of the person whom an id, perhaps an alias, stands for; returns that person's id.
        Nothing is told of all ids of that human, else what was said of an alias would be left."""
        person_id = self._manager.representative(known_as)
        self._admit(person_id)
        tell(person_id, what)
        for other in () if what else self._one_human(person_id):
            if other in self._register:
                tell(other, what)
        self._changed()
        return person_id

    def _merge(self, request: MergeRequest) -> MergeResponse:
        with self._lock:
            kept, alias = self._manager.merge(request.id, request.other, rospy.get_time())
            try:
                self._register.keep_aliases(
                    filter(self._manager.is_permanent, (request.id, request.other, kept, alias)),
                    self._manager.representative, time.time())
            except RegisterError as error:
                raise RegisterError("{} is an alias of {} until the end of this run, but {}".format(
                    alias, kept, error)) from error
            finally:
                self._changed()
        return MergeResponse(True, "{} is an alias of {} now".format(alias, kept))

    def _split(self, request: SplitRequest) -> SplitResponse:
        with self._lock:
            stood_for_it = self._manager.representative(request.id)
            self._manager.split(request.id, rospy.get_time())
            self._register.keep_aliases(filter(self._manager.is_permanent, (request.id, stood_for_it)),
                                        self._manager.representative, time.time())
            self._changed()
        return SplitResponse(True, "{} is a person of its own again".format(request.id))

    def _forget(self, request: ForgetRequest) -> ForgetResponse:
        with self._lock:
            ids = self._one_human(request.id)
            for person_id in ids:
                self._register.check_own(person_id)
        # The recognisers first: otherwise they would name the person again at once.
        answers = [answer for person_id in ids for answer in self._galleries.call(GalleryRequest.FORGET, person_id)]
        refused = [answer for answer in answers if not answer.response.success and not answer.response.unknown]
        with self._lock:
            for person_id in ids:
                self._guard.forget(person_id, time.monotonic())
            found = [answer.response.success for answer in answers]
            found += [self._manager.forget(person_id, rospy.get_time()) for person_id in ids]
            found += [self._register.forget(person_id) for person_id in ids]
            self._changed()
        self._written()
        if not any(found) and not refused:
            raise RegisterError("there is no known person {!r}".format(request.id[:40]))
        if refused:
            raise RegisterError("forgotten here, but {}".format(_first_lines(refused)))
        return ForgetResponse(True, "{} is forgotten".format(request.id))

    def _one_human(self, person_id: str) -> List[str]:
        """The id and the others of the same human, there or not: all that are joined with it, and in the store their
        aliases and those whose alias one of them is; no other anonymous ones."""
        if not person_id:       # which is the alias of whoever has none
            raise RegisterError("there is no known person ''")
        human = {person_id} | self._manager.joined(person_id)     # also where the id was an anonymous one
        aliases = {(record.id, record.alias) for record in self._register.records if record.alias}
        human |= {alias for other, alias in aliases if other in human}
        human |= {other for other, alias in aliases if alias in human}
        return [person_id] + sorted(human - {person_id})

    def _forget_all(self, request: TriggerRequest) -> TriggerResponse:
        refused = [answer for answer in self._galleries.call(GalleryRequest.FORGET_ALL) if not answer.response.success]
        with self._lock:
            for record in self._register.records:
                self._guard.forget(record.id, time.monotonic())
            count = self._register.forget_all()
            self._manager.reset(rospy.get_time())
            self._changed()
        self._written()
        if refused:
            raise RegisterError("forgotten here, but {}".format(_first_lines(refused)))
        return TriggerResponse(True, "{} persons are forgotten".format(count))

    def _export(self, request: ExportRequest) -> ExportResponse:
        with self._lock:
            ids = self._one_human(request.id) if request.id else []
            known = [person_id for person_id in ids if person_id in self._register] or [request.id]
            records = [record for person_id in known for record in self._register.export(person_id)]
        answers = [answer for person_id in ids or [""] for answer in
                   self._galleries.call(GalleryRequest.EXPORT if ids else GalleryRequest.LIST, person_id)]
        galleries: Dict[str, Any] = {}
        for service, data in ((answer.service, answer.data()) for answer in answers if answer.response.success):
            first = galleries.setdefault(service, data)
            if first is not data and isinstance(first, dict):       # another id of this human
                first.setdefault("merged", []).append(data)
        text = json.dumps({"persons": records, "galleries": galleries}, ensure_ascii=False)
        return ExportResponse(True, "{} persons".format(len(records)), text)

    def _enrol_new(self, request: EnrolRequest) -> EnrolResponse:
        return self._enrol(request, is_new=True)

    def _enrol(self, request: EnrolRequest, is_new: bool = False) -> EnrolResponse:
        legal_name(request.name)    # before any face is learnt
        with self._lock:
            person_id = self._manager.representative(request.id)
            state = next((state for state in self._manager.snapshot(rospy.get_time()).persons
                          if state.id == person_id), None)
        if state is None or not (state.face or state.voice):
            raise RegisterError("the person {!r} has no face that is seen now, and no voice that is heard".format(
                request.id[:40]))
        known = "" if state.anonymous or is_new else state.id
        command = GalleryRequest.ENROL_NEW if is_new else GalleryRequest.ENROL
        answers = self._galleries.call(command, known, state.face or state.voice)
        learned = [answer.response.id for answer in answers
                   if answer.response.success and is_valid_id(answer.response.id)]
        if not learned:
            raise RegisterError(_first_lines(answers) if answers else _NO_RECOGNISER)
        means = ["face" if state.face else "voice"]
        # Whoever recognises voices learns this one as well; recognisers of faces know no such face.
        if state.face and state.voice and any(answer.response.success and answer.response.id for answer in
                                              self._galleries.call(GalleryRequest.ENROL, learned[0], state.voice)):
            means.append("voice")
        with self._lock:
            self._manager.know(learned[:1])
            self._register.set_enrolled(learned[0], True, time.time())
            if request.name:
                self._register.set_name(learned[0], request.name)
            self._changed()
        return EnrolResponse(True, "{} is enrolled by {}".format(learned[0], " and ".join(means)), learned[0])

    def _list_known(self, request: ListKnownRequest) -> ListKnownResponse:
        with self._lock:
            snapshot = self._manager.snapshot(rospy.get_time())
            states = {state.id: state for state in snapshot.persons}
            records = {record.id: record for record in self._register.records}
            answer = ListKnownResponse(ids=list(snapshot.known))
            merged = snapshot.merged()
            said = [self._register.said_of(person_id, merged.get(person_id, ())) for person_id in answer.ids]
        answer.names, answer.native_languages = [name for name, _ in said], [language for _, language in said]
        for person_id in answer.ids:
            state, record = states.get(person_id), records.get(person_id)
            answer.aliases.append(state.alias if state else record.alias if record else "")
            answer.anonymous.append(state.anonymous if state else False)
            answer.enrolled.append(record.enrolled if record else False)
            answer.tracked.append(person_id in snapshot.tracked)
            answer.first_seen.append(to_time(record.first_seen if record else 0.0))
            answer.last_seen.append(to_time(record.last_seen if record else 0.0))
        return answer

    def _admit(self, person_id: str) -> None:
        """Let a permanent person that the manager knows into the register."""
        if person_id not in self._register and self._manager.is_permanent(person_id):
            self._register.seen([person_id], time.time())


def _first_lines(answers: List[GalleryAnswer]) -> str:
    return "; ".join("{}: {}".format(answer.service, answer.response.message) for answer in answers)


def _guarded(handler: Callable, answer: Callable) -> Callable:
    """Answer with success false and the reason where a handler raises ValueError, or the store fails."""
    def handle(request: object) -> object:
        try:
            return handler(request)
        except (ValueError, StoreError) as error:
            return answer(success=False, message=str(error))
    return handle
