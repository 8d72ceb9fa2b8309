"""Wait until persons are there and rviz shows them: exit code 0 then, 1 after the time given.

rviz counts as showing when it has been subscribed to the visualisation topics for a while; its own
drawing cannot be asked for.
"""

from __future__ import annotations

import argparse
import sys
import threading
import time
from typing import FrozenSet, List, Sequence

import rosgraph
import rospy

from hri_msgs.msg import IdsList

SETTLING_SECONDS = 6.0  # the first rendering in software takes a few seconds
# A picture is good soon after new people came; later it may be dark already, before the next of a directory of
# pictures. Where the same people have been there for longer than such a picture lasts, there is no next one.
SKELETON_SECONDS = 1.5
GOOD_AGES = ((2.0, 3.5), (10.0, float("inf")))


class TrackedCount:
    """How many humans of one kind ("persons", "faces", "bodies") are tracked now."""

    def __init__(self, kind: str) -> None:
        self._lock = threading.Lock()
        self._ids: FrozenSet[str] = frozenset()
        self._changed = time.monotonic()
        self._subscriber = rospy.Subscriber("/humans/%s/tracked" % kind, IdsList, self._receive, queue_size=1)

    def _receive(self, message: IdsList) -> None:
        with self._lock:
            if frozenset(message.ids) != self._ids:
                self._ids, self._changed = frozenset(message.ids), time.monotonic()

    @property
    def count(self) -> int:
        """Number of ids in the last list."""
        with self._lock:
            return len(self._ids)

    @property
    def age(self) -> float:
        """Seconds since the list last changed."""
        with self._lock:
            return time.monotonic() - self._changed


def viewed_topics(viewer: str) -> List[str]:
    """Topics that a node whose name begins with the given one is subscribed to."""
    _, subscribers, _ = rosgraph.Master(rospy.get_name()).getSystemState()
    return [topic for topic, nodes in subscribers if any(node.startswith(viewer) for node in nodes)]


def main(arguments: Sequence[str]) -> int:
    """Command line entry; see the module text."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0, help="give up after this time")
    parser.add_argument("--people", type=int, default=1, help="persons that must be there")
    parser.add_argument("--viewer", default="/rviz", help="beginning of the name of the viewing node; empty for none")
    options = parser.parse_args(list(arguments))
    deadline = time.monotonic() + options.seconds
    while not rosgraph.is_master_online():
        if time.monotonic() > deadline:
            print("no ROS master at %s" % rosgraph.get_master_uri(), file=sys.stderr)
            return 1
        time.sleep(0.2)
    rospy.init_node("wait_for_view", anonymous=True, disable_signals=True)
    persons, bodies = TrackedCount("persons"), TrackedCount("bodies")
    began, viewed_since = time.monotonic(), None
    while time.monotonic() < deadline:
        topics = viewed_topics(options.viewer) if options.viewer else []
        if options.viewer and viewed_since is None and any("visualization" in topic for topic in topics):
            viewed_since = time.monotonic()
        settled = not options.viewer or (viewed_since is not None and time.monotonic() - viewed_since > SETTLING_SECONDS)
        # A picture with skeletons is the better one, but there are sources that show faces only.
        spent = (time.monotonic() - began) / options.seconds
        wanted_bodies = max(options.people, 2) if options.viewer and spent < 0.6 else 0
        # Skeletons are drawn some images after the bodies came. On a busy machine nothing stays as it is: then any view will do.
        steady = bodies.age > SKELETON_SECONDS if wanted_bodies else True
        good = not options.viewer or spent > 0.8 or (steady and any(low <= persons.age <= high for low, high in GOOD_AGES))
        if settled and good and persons.count >= options.people and bodies.count >= wanted_bodies:
            print("%d persons, %d bodies; %s shows %s" % (
                persons.count, bodies.count, options.viewer or "(no viewer)", ", ".join(sorted(topics))))
            return 0
        time.sleep(0.25)
    topics = viewed_topics(options.viewer) if options.viewer else []
    print("after %.0f s: %d persons; %s shows %s" % (
        options.seconds, persons.count, options.viewer or "(no viewer)", ", ".join(topics) or "nothing"), file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
