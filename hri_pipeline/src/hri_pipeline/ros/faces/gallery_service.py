"""The service ~gallery of a recognising node, and the thread that writes the gallery to its file."""

from __future__ import annotations

import json
import threading
from typing import Callable, Dict, Tuple

import rospy

from hri_pipeline.core.ids import is_valid_id
from hri_pipeline.core.private_file import StoreError
from hri_pipeline.core.recognition.face_recognition_stage import RecognitionStage
from hri_pipeline.core.recognition.gallery import GalleryError
from hri_pipeline.srv import Gallery, GalleryRequest, GalleryResponse

_FLUSH_S = 1.0
_LOG_PERIOD_S = 30.0

Answer = Tuple[str, str, str]
"""Message, id, data."""


class GalleryService:
    """Lets others forget, merge, enrol, list and export known persons. close() ends service and thread."""

    def __init__(self, stage: RecognitionStage) -> None:
        self._stage = stage
        self._commands: Dict[str, Callable[[GalleryRequest], Answer]] = {
            GalleryRequest.FORGET: self._forget, GalleryRequest.FORGET_ALL: self._forget_all,
            GalleryRequest.MERGE: self._merge, GalleryRequest.ENROL: self._enrol, GalleryRequest.LIST: self._list,
            GalleryRequest.EXPORT: self._export}
        self._closed = threading.Event()
        self.problem = ""       # why what was learnt is not written, empty when it is
        self._service = rospy.Service("~gallery", Gallery, self._answer)
        self._thread = threading.Thread(target=self._write, name="gallery writer", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the service and the thread. Idempotent; the gallery itself is closed by its stage."""
        if self._closed.is_set():
            return
        self._closed.set()
        self._service.shutdown("the node ends")
        self._thread.join(5.0)

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
            return GalleryResponse(success=False, message=str(error), id=request.id)
        return GalleryResponse(success=True, message=message, id=identity, data=data)

    def _forget(self, request: GalleryRequest) -> Answer:
        if not self._stage.recogniser.forget(request.id):
            raise GalleryError("person {!r} is not known".format(request.id))
        self._stage.flush()
        return "forgotten", request.id, ""

    def _forget_all(self, request: GalleryRequest) -> Answer:
        self._stage.recogniser.forget_all()
        self._stage.flush()
        return "everybody is forgotten", "", ""

    def _merge(self, request: GalleryRequest) -> Answer:
        self._stage.recogniser.merge(request.other, request.id)
        return "{} is {} now".format(request.other, request.id), request.id, ""

    def _enrol(self, request: GalleryRequest) -> Answer:
        return "enrolled", self._stage.recogniser.enrol(request.other, request.id), ""

    def _list(self, request: GalleryRequest) -> Answer:
        known = self._stage.recogniser.list_known()
        return "{} persons".format(len(known)), "", json.dumps(known)

    def _export(self, request: GalleryRequest) -> Answer:
        person = self._stage.recogniser.export(request.id)
        data = {"id": person.id, "templates": len(person.templates), "enrolled": bool(person.enrolled)}
        return "exported", request.id, json.dumps(data)

    def _write(self) -> None:
        while not self._closed.wait(_FLUSH_S):
            try:
                self._stage.flush()
                self.problem = ""
            except Exception as error:  # a full disk must not end the thread: the next second may be better
                self.problem = "the gallery could not be written: {}".format(error)
                rospy.logerr_throttle(_LOG_PERIOD_S, "%s", self.problem)
