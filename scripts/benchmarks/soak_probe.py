"""A ROS node that asks for everything that the stack says of everybody, as a program of a user would, and counts who
came.

Usage: soak_probe.py FILE
FILE is written anew every second, as one JSON object: for faces, bodies, voices and persons how many are there (`now`)
and how many ids have come so far (`seen`); the ids of `known` persons; the errors that nodes told, and the first of
them.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from collections import Counter
from typing import Dict, List

import rospy
from rosgraph_msgs.msg import Log

from hri_msgs.msg import IdsList
from hri_pipeline.client import Humans
from hri_pipeline.core.process import share_arenas

KINDS = ("faces", "bodies", "voices", "persons")
_PERIOD_S = 1.0


class Probe:
    """Everybody's values are asked for when they come, and so are subscribed to until they leave."""

    def __init__(self) -> None:
        self._humans = Humans(patience=0.0)
        self._lock = threading.Lock()
        self._seen: Counter = Counter()
        self._known: List[str] = []
        self._errors: List[str] = []
        self._error_count = 0
        self._subscribers = [rospy.Subscriber("/humans/persons/known", IdsList, self._on_known),
                             rospy.Subscriber("/rosout", Log, self._on_log, queue_size=200)]
        for kind, listen in zip(KINDS, (self._humans.on_face, self._humans.on_body, self._humans.on_voice,
                                        self._humans.on_person)):
            listen(lambda human, kind=kind: self._ask_all(human, kind))

    def status(self) -> Dict[str, object]:
        """Return what has been seen."""
        now = {kind: len(getattr(self._humans, kind)) for kind in KINDS}
        # Gazes and groups too are listened to by being asked for.
        now.update(gazes=len(self._humans.gazes), groups=len(self._humans.groups))
        with self._lock:
            return {"now": now, "seen": dict(self._seen), "known": self._known, "errors": self._error_count,
                    "first_errors": self._errors}

    def close(self) -> None:
        """Listen no more."""
        for subscriber in self._subscribers:
            subscriber.unregister()
        self._humans.close()

    def _ask_all(self, human: object, kind: str) -> None:
        with self._lock:
            self._seen[kind] += 1
        for name in dir(type(human)):
            if isinstance(getattr(type(human), name), property):
                getattr(human, name)

    def _on_known(self, message: IdsList) -> None:
        with self._lock:
            self._known = list(message.ids)

    def _on_log(self, message: Log) -> None:
        if message.level >= Log.ERROR or "Traceback" in message.msg:
            with self._lock:
                self._error_count += 1
                if len(self._errors) < 5:
                    self._errors.append("{}: {}".format(message.name, message.msg[:300]))


def main(arguments: List[str]) -> int:
    """Watch until the master or the user ends it."""
    path = arguments[0]
    share_arenas()      # topics, and so threads, come and go all the time
    rospy.init_node("soak_probe", disable_rostime=True)
    probe = Probe()
    while not rospy.is_shutdown():
        with open(path + ".new", "w", encoding="utf-8") as file:
            json.dump(probe.status(), file)
        os.replace(path + ".new", path)
        time.sleep(_PERIOD_S)
    probe.close()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
