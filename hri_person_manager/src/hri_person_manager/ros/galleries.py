"""The galleries of all recognisers on the ROS graph, as one."""

from __future__ import annotations

import json
from typing import Any, List, NamedTuple

import rosgraph
import rospy

from hri_pipeline.srv import Gallery, GalleryRequest, GalleryResponse

SUFFIX = "/gallery"
PATIENCE_S = 2.0


class Answer(NamedTuple):
    """What one gallery said."""

    service: str
    response: GalleryResponse

    def data(self) -> Any:
        """The JSON data of the answer, None where there is none that can be read."""
        try:
            return json.loads(self.response.data) if self.response.data else None
        except ValueError:
            return None


class Galleries:
    """Finds the services when they are needed: recognisers come and go."""

    def call(self, command: str, person_id: str = "", other: str = "") -> List[Answer]:
        """Give a command to every gallery. One that does not answer, answers with success false and says so."""
        answers = []
        for name in self.names():
            try:
                rospy.wait_for_service(name, PATIENCE_S)
                proxy = rospy.ServiceProxy(name, Gallery)
                answers.append(Answer(name, proxy(GalleryRequest(command=command, id=person_id, other=other))))
            except (rospy.ROSException, rospy.ServiceException) as error:
                answers.append(Answer(name, GalleryResponse(
                    success=False, message="{} does not answer: {}".format(name, error))))
        return answers

    @staticmethod
    def names() -> List[str]:
        """Names of the services `gallery` of all nodes."""
        try:
            services = rosgraph.Master(rospy.get_name()).getSystemState()[2]
        except (rosgraph.MasterException, OSError):
            return []
        return sorted(name for name, _ in services if name.endswith(SUFFIX))
