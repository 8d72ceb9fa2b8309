"""What the nodes have in common that play a file or a device: they try a device again, end without a file, and tell the end."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from types import SimpleNamespace
from typing import Generic, Optional, Sequence, Type, TypeVar

import rospy
from std_msgs.msg import Bool

from hri_pipeline.core.pictures.source_parameters import EXIT
from hri_pipeline.ros.diagnostics import ERROR, OK, NodeDiagnostics
from hri_pipeline.ros.topic_release import release

LOOK_FOR_SUBSCRIBERS_S = 0.05
# What subscribers need to read the last messages before the connection is closed.
_FAREWELL_S = 0.5

Source = TypeVar("Source")


class SourceNode(ABC, Generic[Source]):
    """Publishes `finished` (latched); a subclass says how its source is opened and played.

    A device that is not there, or goes away, is tried again every `retry_period`; a file that cannot be read ends the node. A
    source has close() and a `description`, and raises FAULT. All is read and sent in one thread, the caller of spin().
    """

    FAULT: Type[Exception] = Exception
    DOES = "playing"

    def __init__(self, settings: SimpleNamespace, live: bool, publishers: Sequence[rospy.Publisher]) -> None:
        """live: the source is a device. Takes over the publishers. Raises FAULT for a file that cannot be read."""
        self._settings, self._live = settings, live
        self._stop = threading.Event()
        self._source: Optional[Source] = None
        self._finished = rospy.Publisher("finished", Bool, queue_size=1, latch=True)
        self._publishers = (*publishers, self._finished)
        self._diagnostics = NodeDiagnostics(rospy.get_name())
        self._tries = 0
        rospy.on_shutdown(self._stop.set)
        self._finished.publish(Bool(False))
        if not live:
            # A file that cannot be read is reported at once, and ends the node.
            self._source = self._opened()

    def spin(self) -> None:
        """Play until the end of the source or of ROS. Raises FAULT for a file that cannot be read."""
        while not self._ended():
            try:
                if self._source is None:
                    self._source = self._opened()
                rospy.loginfo("%s: %s %s", rospy.get_name(), self.DOES, self._source.description)
                self._play(self._source)
                break
            except self.FAULT as error:
                self._drop_source()
                if not self._live:
                    raise
                self._tries += 1
                rospy.logwarn("%s; next try in %g s", error, self._settings.retry_period)
                self._diagnostics.set("source", ERROR, str(error), {"tries": self._tries})
                self._stop.wait(self._settings.retry_period)
        if not self._ended():
            self._tell_the_end()

    def close(self) -> None:
        """Stop and let go of the source. May be called again."""
        self._stop.set()
        self._drop_source()
        self._diagnostics.close()
        for publisher in self._publishers:
            release(publisher)

    @abstractmethod
    def _open(self) -> Source:
        """Open the source that the settings name. Raises FAULT in one sentence that names it and the mend."""

    @abstractmethod
    def _play(self, source: Source) -> None:
        """Publish one source until its end, or until _ended()."""

    @abstractmethod
    def _wanted(self) -> bool:
        """Tell whether somebody listens."""

    def _await_subscriber(self) -> None:
        """Wait for somebody who listens, where the settings ask for that."""
        while self._settings.wait_for_subscriber and not self._wanted() and not self._ended():
            self._stop.wait(LOOK_FOR_SUBSCRIBERS_S)

    def _ended(self) -> bool:
        return self._stop.is_set() or rospy.is_shutdown()

    def _notify(self, text: str) -> None:
        rospy.logwarn("%s: %s", rospy.get_name(), text)

    def _opened(self) -> Source:
        try:
            return self._open()
        except self.FAULT as error:
            raise self.FAULT("{}: {}".format(rospy.get_name(), error)) from error

    def _drop_source(self) -> None:
        if self._source is not None:
            self._source.close()
            self._source = None

    def _tell_the_end(self) -> None:
        """Say that the source has ended and stay, or leave, as the parameters say."""
        text = "{} has ended".format(self._source.description if self._source else self._settings.source)
        rospy.loginfo("%s: %s", rospy.get_name(), text)
        self._finished.publish(Bool(True))
        self._diagnostics.set("source", OK, text)
        if self._settings.at_end == EXIT:
            self._stop.wait(_FAREWELL_S)
            return
        while not self._ended():
            self._stop.wait(1.0)
