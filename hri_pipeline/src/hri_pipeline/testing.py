"""For tests that run nodes: waits for conditions, in wall time, and looks at what a process holds."""

from __future__ import annotations

import os
import resource
import subprocess
import threading
import time
from contextlib import contextmanager
from typing import Any, Callable, Iterator, List, NamedTuple, Optional, Union
from xmlrpc.client import ServerProxy

import rosgraph
import rospy
from geometry_msgs.msg import TransformStamped

_LOOK_S = 0.01


class Held(NamedTuple):
    """What a process holds: numbers of descriptors and threads, resident memory in MB."""

    descriptors: int
    threads: int
    rss_mb: float


class Latest:
    """Keeps the messages of a topic."""

    def __init__(self, topic: str, kind: Any) -> None:
        self.messages: List[Any] = []
        self._subscriber = rospy.Subscriber(topic, kind, self.messages.append, queue_size=20)

    @property
    def value(self) -> Any:
        """The newest message, None before the first."""
        return self.messages[-1] if self.messages else None

    @property
    def data(self) -> Any:
        """What the newest message of std_msgs holds, None before the first."""
        return getattr(self.value, "data", None)

    def close(self) -> None:
        """Stop listening. Idempotent."""
        self._subscriber.unregister()


def transform(parent: str, child: str, stamp: rospy.Time, x: float = 0.0, y: float = 0.0,
              z: float = 0.0) -> TransformStamped:
    """Return the transform of a frame at x, y, z (m) in its parent, with the same axes."""
    message = TransformStamped(child_frame_id=child)
    message.header.frame_id, message.header.stamp = parent, stamp
    place = message.transform.translation
    place.x, place.y, place.z = x, y, z
    message.transform.rotation.w = 1.0
    return message


def wait_for(condition: Callable[[], object], timeout: float, what: Union[str, Callable[[], str]],
             act: Optional[Callable[[], object]] = None, period: float = _LOOK_S) -> object:
    """Return the first value of the condition that is true; it is looked at every `period` s, each time after `act`.

    Raises AssertionError after `timeout` s, which says `what` has not come; called then if it is a function.
    """
    deadline = time.monotonic() + timeout
    while True:
        if act is not None:
            act()
        value = condition()
        if value:
            return value
        if time.monotonic() > deadline:
            raise AssertionError("not within {:g} s: {}".format(timeout, what() if callable(what) else what))
        time.sleep(period)


@contextmanager
def without_descriptors(left: int = 0) -> Iterator[None]:
    """No more than `left` descriptors can be opened by this process in the block."""
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(map(int, os.listdir("/proc/self/fd"))) + 5, limits[1]))
    fillers = []
    try:
        while True:
            fillers.append(os.open(os.devnull, os.O_RDONLY))
    except OSError:
        pass
    try:
        for filler in fillers[len(fillers) - left:]:
            os.close(filler)
        fillers = fillers[:len(fillers) - left]
        yield
    finally:
        for filler in fillers:
            os.close(filler)
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)


def pid_of(node: str) -> int:
    """Return the process id of a node.

    Raises rosgraph.MasterException when there is no such node, OSError when it is dead.
    """
    master = rosgraph.Master("/testing")
    return ServerProxy(master.lookupNode(node)).getPid("/testing")[2]


def held_by(pid: int) -> Held:
    """Return what a process holds. Raises OSError when there is no such process."""
    with open("/proc/{}/status".format(pid), encoding="ascii", errors="replace") as status:
        fields = dict(line.split(":", 1) for line in status)
    return Held(len(os.listdir("/proc/{}/fd".format(pid))), int(fields["Threads"]),
                int(fields["VmRSS"].split()[0]) / 1024.0)


class HeardProcess:
    """A child process, and a thread that runs read() until nothing more comes from it."""

    def __init__(self, process: subprocess.Popen, read: Callable[[], None]) -> None:
        self.process = process
        self._reader = threading.Thread(target=read, daemon=True)
        self._reader.start()

    def code(self, timeout: float = 40.0) -> int:
        """Return its exit status once it has ended and all is read.

        Raises subprocess.TimeoutExpired after `timeout` s.
        """
        code = self.process.wait(timeout)
        self._reader.join(10.0)
        return code

    def kill(self) -> None:
        """End it without mercy. Idempotent."""
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        self._reader.join(10.0)
