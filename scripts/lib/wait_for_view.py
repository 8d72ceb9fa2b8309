"""Wait until persons are there and rviz shows them, and take the picture: exit code 0 then, 1 after the time given.

What rviz has drawn cannot be asked for; what it was sent can. A picture counts when nothing that it should show was
missing from a while before it until a while after it. Until there is a complete one, the best so far is kept. The last
line says what it lacks.
"""

from __future__ import annotations

import argparse
import sys
import threading
import time
from pathlib import Path
from typing import Dict, FrozenSet, List, Optional, Sequence, Tuple

import rosgraph
import rospy
from diagnostic_msgs.msg import DiagnosticArray
from seen_persons import SeenPersons
from view_state import Lack, Steady, View, good_enough, lack
from visualization_msgs.msg import Marker, MarkerArray

from hri_msgs.msg import IdsList

TOPICS = ("/visualization/skeletons", "/visualization/persons", "/visualization/interactions", "/visualization/overlay")
SETTLING_S = 5.0    # from the first subscription to the first rendering in software
DRAWN_S = 1.5       # what was sent has been drawn, at a few images per second
AFTER_S = 1.2       # until the overlay has told what it drew meanwhile
LOOK_S = 0.2
FRESH_S = 1.5       # older markers and reports count no more


class Watch:
    """Listens to what is tracked and to what is sent to be drawn."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._ids: Dict[str, FrozenSet[str]] = {}
        self._persons = SeenPersons()
        self._markers: Dict[str, Tuple[float, MarkerArray]] = {}
        self._overlay: Tuple[float, Tuple[int, int]] = (float("-inf"), (0, 0))
        self._subscribers = [rospy.Subscriber("/humans/%s/tracked" % kind, IdsList, self._on_ids, kind, queue_size=1)
                             for kind in ("faces", "bodies")]

    def look_closely(self) -> None:
        """Listen to the markers, too: they are made for those who listen."""
        self._subscribers += [rospy.Subscriber(topic, MarkerArray, self._on_markers, topic, queue_size=1)
                              for topic in TOPICS[:3]]
        self._subscribers.append(rospy.Subscriber("/diagnostics", DiagnosticArray, self._on_diagnostics, queue_size=50))

    @property
    def persons(self) -> Tuple[List[str], List[str]]:
        """Persons who are seen, and those who are only a voice."""
        return self._persons.split()

    def view(self, viewed: Sequence[str]) -> View:
        """Return the present state."""
        seen = frozenset(self._persons.split()[0])
        with self._lock:
            skeletons, persons, interactions = (self._fresh(topic) for topic in TOPICS[:3])
            told, overlay = self._overlay
            return View(
                seen, *(self._ids.get(kind, frozenset()) for kind in ("faces", "bodies")),
                skeletons=frozenset(marker.ns for marker in skeletons),
                marked=sum(marker.type == Marker.TEXT_VIEW_FACING for marker in persons),
                gazes=sum(marker.ns == "gaze" for marker in interactions),
                groups=sum(marker.ns == "o-space" for marker in interactions),
                overlay=overlay if time.monotonic() - told < FRESH_S else None, viewed=frozenset(viewed))

    def _fresh(self, topic: str) -> List[Marker]:
        """Markers of the last message of a topic, none where that is old."""
        came, array = self._markers.get(topic, (float("-inf"), MarkerArray()))
        return [marker for marker in array.markers
                if marker.action == Marker.ADD] if time.monotonic() - came < FRESH_S else []

    def _on_ids(self, message: IdsList, kind: str) -> None:
        with self._lock:
            self._ids[kind] = frozenset(message.ids)

    def _on_markers(self, message: MarkerArray, topic: str) -> None:
        with self._lock:
            self._markers[topic] = (time.monotonic(), message)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {item.key: item.value for item in status.values}
            if status.name.endswith("overlay: overlay") and {"faces", "bodies"} <= set(values):
                with self._lock:
                    self._overlay = (time.monotonic(), (int(values["faces"]), int(values["bodies"])))


class Photographer:
    """Takes pictures of the screen, and keeps the best one in a file.

    framebuffer: of Xvfb; None takes none, and only judges the moments.
    """

    def __init__(self, framebuffer: Optional[Path], file: Optional[Path]) -> None:
        self._framebuffer, self._file = framebuffer, file
        self._steady = Steady(DRAWN_S + AFTER_S)
        self._pending: Optional[Tuple[float, bytes]] = None
        self.best: Optional[Lack] = None

    def look(self, now: float, moment: Lack) -> None:
        """Take the state of the moment `now` (s)."""
        worst = self._steady.add(now, moment)
        if self._pending is not None and now >= self._pending[0] + AFTER_S:
            if worst is not None and not worst.absent and self._better(worst):
                if self._file is not None:
                    self._file.write_bytes(self._pending[1])
                self.best = worst
            self._pending = None
        if self._pending is None and not moment.absent and self._better(moment):
            picture = self._take()
            if picture is not None:
                self._pending = (now, picture)

    def _better(self, found: Lack) -> bool:
        return self.best is None or found.weight < self.best.weight

    def _take(self) -> Optional[bytes]:
        if self._framebuffer is None:
            return b""
        import screenshot  # not above: it needs OpenCV, and most runs take no picture
        try:
            return screenshot.take(self._framebuffer)
        except (OSError, ValueError) as error:
            print("no screenshot: %s" % error, file=sys.stderr, flush=True)
            return None


def viewed_topics(viewer: str) -> List[str]:
    """Topics that a node whose name begins with the given one is subscribed to."""
    try:
        _, subscribers, _ = rosgraph.Master(rospy.get_name()).getSystemState()
    except (OSError, rosgraph.MasterException):
        return []
    return [topic for topic, nodes in subscribers if any(node.startswith(viewer) for node in nodes)]


def wait_for_people(watch: Watch, people: int, deadline: float) -> bool:
    """Return whether so many persons were seen before the deadline."""
    while len(watch.persons[0]) < people:
        if time.monotonic() > deadline or rospy.is_shutdown():
            return False
        time.sleep(LOOK_S)
    return True


def wait_for_picture(watch: Watch, photographer: Photographer, options: argparse.Namespace, deadline: float) -> None:
    """Look at the viewer until it has shown enough, or the time is over."""
    began, viewed_since, topics, asked = time.monotonic(), None, [], float("-inf")
    watch.look_closely()
    while time.monotonic() < deadline and not rospy.is_shutdown():
        now = time.monotonic()
        if now > asked + 1.0:
            topics, asked = viewed_topics(options.viewer), now
        if viewed_since is None and any(topic in topics for topic in TOPICS):
            viewed_since = now
        if viewed_since is not None and now > viewed_since + SETTLING_S:
            photographer.look(now, lack(watch.view(topics), options.people, TOPICS))
            best = photographer.best
            if best is not None and good_enough(best, (now - began) / options.seconds):
                return
        time.sleep(LOOK_S)


def main(arguments: Sequence[str]) -> int:
    """Command line entry; see the module text."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0, help="give up after this time")
    parser.add_argument("--people", type=int, default=1, help="persons that must be there")
    parser.add_argument("--viewer", default="/rviz", help="beginning of the name of the viewing node; empty for none")
    parser.add_argument("--framebuffer", type=Path, help="of Xvfb, of which the picture is taken")
    parser.add_argument("--picture", type=Path, help="PNG file for it")
    options = parser.parse_args(list(arguments))
    deadline = time.monotonic() + options.seconds
    while not rosgraph.is_master_online():
        if time.monotonic() > deadline:
            print("no ROS master at %s" % rosgraph.get_master_uri(), file=sys.stderr)
            return 1
        time.sleep(0.2)
    rospy.init_node("wait_for_view", anonymous=True, disable_signals=True)
    watch = Watch()
    if not options.viewer:
        enough = wait_for_people(watch, options.people, deadline)
        print("seen: %d persons, only heard: %d" % tuple(map(len, watch.persons)))
        return 0 if enough else 1
    photographer = Photographer(options.framebuffer, options.picture)
    wait_for_picture(watch, photographer, options, deadline)
    if photographer.best is None:
        found = lack(watch.view(viewed_topics(options.viewer)), options.people, TOPICS)
        print("no picture within %.0f s; lacking at the end: %s" % (options.seconds, found.text))
        return 1
    print("missing in the picture, or at times within %.0f s of it: %s" % (DRAWN_S + AFTER_S, photographer.best.text))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
