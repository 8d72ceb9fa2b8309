"""Says whose body a new one is, when it is known from before."""

from __future__ import annotations

import threading
from collections import OrderedDict
from typing import Iterable

import rospy
from std_msgs.msg import String

from hri_fullbody.core.tracking.body_continuity import Return
from hri_msgs.msg import IdsMatch
from hri_pipeline.core.ids import is_valid_id
from hri_pipeline.ros.conversions import match_to_msg
from hri_pipeline.ros.feature_feed import FeatureFeed
from hri_pipeline.ros.topic_release import release

_MOST = 500


class BodyPersons:
    """Follows which person has which body, and publishes candidate matches of new bodies with the persons of earlier ones.

    Without a person manager nothing is published.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._person_of: "OrderedDict[str, str]" = OrderedDict()
        self._publisher = rospy.Publisher("/humans/candidate_matches", IdsMatch, queue_size=20)
        self._feed = FeatureFeed("persons", {"body_id": String}, self._on_body_id, max_ids=200)

    def tell(self, returns: Iterable[Return]) -> None:
        """Publish a match for each body whose earlier one had a person."""
        for item in returns:
            with self._lock:
                person = self._person_of.get(item.earlier)
            if person is not None:
                self._publisher.publish(match_to_msg(item.id, IdsMatch.BODY, person, IdsMatch.PERSON, item.likelihood))

    def close(self) -> None:
        """Let go of the topics. Idempotent."""
        self._feed.close()
        release(self._publisher)

    def _on_body_id(self, person: str, name: str, message: String) -> None:
        if not is_valid_id(message.data):
            return      # the person has no body now; whose the last one was is remembered
        with self._lock:
            self._person_of[message.data] = person
            self._person_of.move_to_end(message.data)
            while len(self._person_of) > _MOST:
                self._person_of.popitem(last=False)
