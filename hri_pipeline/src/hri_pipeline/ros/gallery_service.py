"""The service ~gallery of a node that knows people: to forget, merge, enrol, list and export them."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Callable, Dict, Tuple, Union

import rospy

from hri_pipeline.core.ids import is_valid_id
from hri_pipeline.core.privacy import StoreError
from hri_pipeline.core.recognition.database import StoreWriter
from hri_pipeline.core.recognition.gallery import GalleryError, UnknownPersonError
from hri_pipeline.srv import Gallery, GalleryRequest, GalleryResponse

if TYPE_CHECKING:
    from hri_pipeline.core.audio.speakers import VoiceIdentity
    from hri_pipeline.core.recognition.recogniser import Recogniser

_REMINDER_S = 30.0
_PROBLEM = "the gallery could not be written: {}"

GalleryAnswer = Tuple[str, str, str]
"""Message, id, data."""


class GalleryService:
    """Service to forget, merge, enrol, list and export known persons. close() ends service and writer.

    The commands to forget and to merge return when the change is on the disk; the processing of images does not wait
    for it.

    Parameters
    ----------
    recogniser : who knows people.
    flush : writes what has changed to the disk.
    """

    def __init__(self, recogniser: Union[Recogniser, VoiceIdentity], flush: Callable[[], object]) -> None:
        self._recogniser = recogniser
        self._commands: Dict[str, Callable[[GalleryRequest], GalleryAnswer]] = {
            GalleryRequest.FORGET: self._forget, GalleryRequest.FORGET_ALL: self._forget_all,
            GalleryRequest.MERGE: self._merge, GalleryRequest.ENROL: self._enrol, GalleryRequest.LIST: self._list,
            GalleryRequest.EXPORT: self._export, GalleryRequest.ENROL_NEW: self._enrol_new}
        self._writer = StoreWriter(flush, notify=_log)
        self._closed = False
        self._service = rospy.Service("~gallery", Gallery, self._answer)

    @property
    def problem(self) -> str:
        """Why the gallery could not be written; empty without a problem."""
        return _PROBLEM.format(self._writer.problem) if self._writer.problem else ""

    def close(self) -> None:
        """End the service, and write what is left. Idempotent; the gallery itself is closed by its owner."""
        if self._closed:
            return
        self._closed = True
        self._service.shutdown("the node ends")
        problem = self._writer.close()
        if problem:
            rospy.logerr("%s", _PROBLEM.format(problem))

    def _answer(self, request: GalleryRequest) -> GalleryResponse:
        command = self._commands.get(request.command)
        if command is None:
            return GalleryResponse(success=False, message="unknown command {!r}; known: {}".format(
                request.command[:40], ", ".join(self._commands)))
        wrong = [name for name in (request.id, request.other) if name and not is_valid_id(name)]
        if wrong:
            return GalleryResponse(success=False, message="{!r} is not an id".format(wrong[0][:40]))
        try:
            message, identity, data = command(request)
        except (GalleryError, StoreError, OSError) as error:
            return GalleryResponse(success=False, unknown=isinstance(error, UnknownPersonError), message=str(error),
                                   id=request.id)
        return GalleryResponse(success=True, message=message, id=identity, data=data)

    def _forget(self, request: GalleryRequest) -> GalleryAnswer:
        is_known = self._recogniser.forget(request.id)
        self._writer.wait()
        if not is_known:
            raise UnknownPersonError("person {!r} is not known".format(request.id))
        return "forgotten", request.id, ""

    def _forget_all(self, request: GalleryRequest) -> GalleryAnswer:
        self._recogniser.forget_all()
        self._writer.wait()
        return "everybody is forgotten", "", ""

    def _merge(self, request: GalleryRequest) -> GalleryAnswer:
        try:
            self._recogniser.merge(request.other, request.id)
        except UnknownPersonError:      # merged before, but perhaps not on the disk yet
            self._writer.wait()
            raise
        self._writer.wait()
        return "{} is {} now".format(request.other, request.id), request.id, ""

    def _enrol(self, request: GalleryRequest) -> GalleryAnswer:
        return "enrolled", self._recogniser.enrol(request.other, request.id), ""

    def _enrol_new(self, request: GalleryRequest) -> GalleryAnswer:
        return "enrolled", self._recogniser.enrol(request.other, request.id, confirm=True), ""

    def _list(self, request: GalleryRequest) -> GalleryAnswer:
        known = self._recogniser.list_known()
        return "{} persons".format(len(known)), "", json.dumps(known)

    def _export(self, request: GalleryRequest) -> GalleryAnswer:
        person = self._recogniser.export(request.id)
        data = {"id": person.id, "templates": len(person.templates), "enrolled": bool(person.enrolled)}
        return "exported", request.id, json.dumps(data)


def _log(problem: str) -> None:
    rospy.logerr_throttle(_REMINDER_S, _PROBLEM.format(problem))
