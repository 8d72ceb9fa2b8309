"""The lists of faces, bodies and voices, told as trackers do: when they change, and once a second."""

import threading

import rospy

from hri_msgs.msg import IdsList


class Trackers:
    """Publishes the lists until the process ends; nobody is there at first."""

    def __init__(self):
        self._lists = {kind: rospy.Publisher("/humans/%s/tracked" % kind, IdsList, latch=True, queue_size=10)
                       for kind in ("faces", "bodies", "voices")}
        self._shown = dict.fromkeys(self._lists, ())
        self._lock = threading.Lock()
        rospy.Timer(rospy.Duration(1), lambda event: self.show())

    def show(self, **lists):
        """faces, bodies, voices: who is there from now on; kinds that are left out stay."""
        with self._lock:        # never an older list after a newer one
            self._shown.update(lists)
            for kind, ids in self._shown.items():
                self._lists[kind].publish(IdsList(ids=list(ids)))

    def are_heard(self):
        return all(topic.get_num_connections() for topic in self._lists.values())
