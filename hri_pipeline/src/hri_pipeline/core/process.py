"""What a process asks of the system: its memory, the threads of its libraries and of its networks, its niceness; and
its child processes: started, read, ended, and recognised again after their process id was reused."""

from __future__ import annotations

import ctypes
import gc
import math
import os
import re
import shutil
import signal
import socket
import subprocess
import threading
import time
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from typing import Any, Callable, Dict, Iterator, List, Mapping, Optional, Sequence, TypeVar

import cv2
import threadpoolctl

from hri_pipeline.core.resources import Cores

# Parameters of mallopt in glibc's malloc.h.
_M_TRIM_THRESHOLD = -1
_M_MMAP_THRESHOLD = -3
_M_ARENA_MAX = -8
# What adjtimex returns for a clock that is not synchronised: TIME_ERROR of timex.h.
_TIME_ERROR = 5
# Larger than most images. Older C libraries refuse more (mallopt(3): DEFAULT_MMAP_THRESHOLD_MAX), and then map each
# image anew.
_KEEP_BYTES = 2 ** 25
_FREE_BYTES = 2 ** 28
_VARIABLES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
FIRST_WAIT_S = 0.5
LONGEST_WAIT_S = 30.0
# A process that ran for so long started well: its end has nothing to do with earlier ones.
PROVEN_S = 10.0
_KEPT_CHARACTERS = 2000     # of the output of a child
_CHUNK = 4096
_MOST_THREADS = 8           # of a node's networks, where the number is automatic
_FEW_CORES = 2              # up to here a node and its neighbours use all cores with one thread each
_NODES = 2                  # faces and bodies work at the same time
Item = TypeVar("Item")
Result = TypeVar("Result")
_COLOUR = re.compile(r"\x1b\[[0-9;]*m")


def share_arenas() -> bool:
    """Let all threads allocate from two arenas; return whether the C library can. For nodes whose threads come and
    go.

    By default each new thread may get an arena of its own, up to eight per core, and other threads cannot use the
    memory that is freed in it: a process whose topics open and close all the time grows for minutes.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return False
    mallopt.argtypes = (ctypes.c_int, ctypes.c_int)
    return bool(mallopt(_M_ARENA_MAX, 2))


def is_clock_synchronised() -> bool:
    """Tell whether the kernel says that its clock is synchronised, as by NTP (adjtimex(2)); False where it says
    nothing. It stops to say so some hours after the last correction."""
    timex = (ctypes.c_long * 64)()      # larger than struct timex; the modes, its first field, are 0: only read
    try:
        state = ctypes.CDLL(None).adjtimex(ctypes.byref(timex))
    except (OSError, AttributeError):
        return False
    return 0 <= int(state) < _TIME_ERROR


class GarbageCollector:
    """Thread that collects garbage in reference cycles every `period` s, and returns free memory to the kernel.

    To be made when the program has been set up: only objects that are made after this one are examined, which takes
    some milliseconds; the older ones, mostly those of libraries, are left out (gc.freeze).

    Python's own collector runs only when there are 70,000 new objects, and a quarter more than before: a node kept the
    objects that rospy leaves of closed topics for half an hour (measured). The memory of closed topics lies between
    blocks that are still used, so that the C library keeps these pages: nodes grew by 15 MB in two hours while people
    came and went.
    """

    def __init__(self, period: float = 20.0) -> None:
        gc.collect()
        gc.freeze()
        self._stop = threading.Event()
        self._period = period
        self._thread = threading.Thread(target=self._run, name="collector", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread. Idempotent."""
        self._stop.set()
        self._thread.join()
        gc.unfreeze()

    def _run(self) -> None:
        while not self._stop.wait(self._period):
            gc.collect()
            trim_memory()


def trim_memory() -> bool:
    """Return free memory to the kernel; return whether there was any. Takes a few milliseconds."""
    try:
        return bool(ctypes.CDLL(None).malloc_trim(ctypes.c_size_t(0)))
    except (OSError, AttributeError):
        return False


def raise_mmap_threshold() -> bool:
    """Let malloc re-use the memory of images; return whether the C library can.

    By default, glibc asks the kernel for every block of the size of an image and gives it back at once, so that each
    page is cleared and mapped anew for each image: 20,000 page faults per second at 1280x720, 4 % of a core in each
    process that works on images (measured).
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return False
    mallopt.argtypes = (ctypes.c_int, ctypes.c_int)
    return bool(mallopt(_M_MMAP_THRESHOLD, _KEEP_BYTES) and mallopt(_M_TRIM_THRESHOLD, _FREE_BYTES))


def one_thread_each() -> None:
    """Let OpenCV and the linear algebra of numpy and scipy work in the thread that calls them.

    Our matrices are small. OpenBLAS wakes its threads all the same, and they spin while they wait: on two cores that
    doubled the CPU time for one face (48 % of a core instead of 24 %, measured at 13 images/s). Libraries that are
    loaded later read the environment variables OPENBLAS_NUM_THREADS, OMP_NUM_THREADS and MKL_NUM_THREADS. If the user
    has set one of them to something else, nothing is changed.
    """
    cv2.setNumThreads(1)
    if all(os.environ.get(name, "1") == "1" for name in _VARIABLES):
        os.environ.update({name: "1" for name in _VARIABLES})
        threadpoolctl.threadpool_limits(limits=1, user_api="blas")


class Threads:
    """The threads that the networks of a node have: they share the items of a batch, and work beside the caller.

    Results are those of one thread, in the same order. With one thread there is no other than the caller's, and
    nothing is done earlier or later. The others start when they are first needed; they have the niceness of the caller,
    also that which it gets later.
    """

    BY_ITEMS = True
    """How several threads are used: each works on other items of a batch; False: onnxruntime divides each inference
    among them (`within`)."""

    def __init__(self, count: int = 1) -> None:
        """count: threads, with that of the caller. Raises ValueError for less than one."""
        if count < 1:
            raise ValueError("{} threads, legal range 1 and more".format(count))
        self.count = count
        self.within = 1 if self.BY_ITEMS else count
        """Threads of one inference."""
        self._helped = threading.local()
        self._pool: Optional[ThreadPoolExecutor] = None
        if count > 1 and self.BY_ITEMS:
            self._pool = ThreadPoolExecutor(count - 1, "networks")

    @classmethod
    def of_node(cls, wanted: int, share: float, nodes: int = _NODES) -> Threads:
        """Return the threads of a node whose parameters `threads` and `cpu_share` these are.

        nodes: how many such nodes work at the same time: 1 where faces and bodies take turns in one.
        """
        return cls(wanted or automatic_threads(share, Cores().count, nodes))

    def time(self) -> float:
        """Processor time (s) of the calling thread, and of the others for it; only differences mean anything."""
        if self.within > 1:     # onnxruntime's own threads cannot be told from others
            return time.process_time()
        return time.thread_time() + getattr(self._helped, "seconds", 0.0)

    def in_parts(self, work: Callable[[Sequence[Item]], Sequence[Result]], items: Sequence[Item]) -> List[Result]:
        """Return what `work` makes of the items, one result for each: of all at once, or of as many parts as threads.

        A part is as large as it can be: the mesh network takes a fifth less time for a face of three than for one
        alone. An error of `work` is raised here; of several, that of the first part. Parts that nobody has begun then
        are left out.
        """
        if self._pool is None or len(items) < 2:
            return list(work(items))
        size = -(-len(items) // self.count)
        waiting = deque(range(0, len(items), size))
        found: Dict[int, Sequence[Result]] = {}
        errors: Dict[int, Exception] = {}

        def serve() -> float:
            began = time.thread_time()
            while True:
                try:
                    first = waiting.popleft()
                except IndexError:
                    return time.thread_time() - began
                try:
                    found[first] = work(items[first:first + size])
                except Exception as error:
                    errors[first] = error
                    waiting.clear()

        others = [self._submit(serve) for _ in range(len(waiting) - 1)]
        serve()
        # One that has not begun is not waited for: the threads may be busy with something else, which may call this.
        helped = sum(other.result() for other in others if other is not None and not other.cancel())
        self._helped.seconds = getattr(self._helped, "seconds", 0.0) + helped
        if errors:
            raise errors[min(errors)]
        return [result for first in sorted(found) for result in found[first]]

    @contextmanager
    def beside(self, work: Callable[..., Result], *arguments: Any) -> Iterator[Callable[[], Result]]:
        """Begin something beside the body of a `with` statement, which gets what returns its result, or raises its
        error. With one thread it is done then, and not now.

        It ends with the body, also when that raises: nothing reads the arguments any more.
        """
        future = self._submit(work, *arguments)
        try:
            yield (lambda: work(*arguments)) if future is None else future.result
        finally:
            if future is not None and not future.cancel():
                wait([future])

    def close(self) -> None:
        """End the other threads. Idempotent; what comes later is done by the caller."""
        pool, self._pool = self._pool, None
        if pool is not None:
            pool.shutdown()

    def _submit(self, work: Callable[..., Result], *arguments: Any) -> "Optional[Future[Result]]":
        """Hand work to another thread; None where there is none."""
        pool = self._pool
        if pool is None:
            return None
        nice = os.getpriority(os.PRIO_PROCESS, 0)
        future: "Future[Result]" = Future()

        def run() -> None:
            if not future.set_running_or_notify_cancel():
                return
            with suppress(OSError):
                _raise_niceness(nice)
            try:
                future.set_result(work(*arguments))
            except BaseException as error:  # as in any pool: whoever waits does not wait for ever
                future.set_exception(error)

        try:
            pool.submit(run)
        except RuntimeError:        # closed meanwhile, or the process may have no more threads; the pool may do it yet
            self._pool = None
            pool.shutdown(wait=False)
            return None if future.cancel() else future
        return future


def automatic_threads(share: float, cores: float, nodes: int = _NODES) -> int:
    """Return how many threads the networks of one of so many nodes that work at the same time have: its part of the
    share (0 to 1) of the cores; one where there are only two cores."""
    if cores <= _FEW_CORES:
        return 1
    return max(1, min(_MOST_THREADS, int(math.ceil(share * cores / nodes - 1e-9))))


ONE_THREAD = Threads()
"""That of the caller, for everybody who has no others."""


def set_niceness(nice: int) -> bool:
    """Set the nice value (0 to 19, see nice(1)) of this thread, of the threads that it starts later, and of its
    session.

    Where the kernel schedules by sessions (sched_autogroup of sched(7), the default on desktops), the nice value of a
    thread counts within its session only, and roslaunch gives each node a session of its own. The nice value of the
    session is set only if this process leads it, so that a node started in a terminal does not change the terminal. 0
    changes nothing.

    Returns whether both values could be set. Raises ValueError outside of 0 to 19: only root could go below 0.
    """
    if not 0 <= nice <= 19:
        raise ValueError("nice is {}, legal range 0 to 19".format(nice))
    if nice == 0:
        return True
    try:
        _raise_niceness(nice)
        if os.getsid(0) == os.getpid():
            _set_session_niceness(nice)
        return True
    except OSError:
        return False


def _raise_niceness(nice: int) -> None:
    """Set the niceness of this thread, unless it has a larger one. Raises OSError where the kernel refuses it."""
    if os.getpriority(os.PRIO_PROCESS, 0) < nice:
        os.setpriority(os.PRIO_PROCESS, 0, nice)


def _set_session_niceness(nice: int) -> None:
    """Set the niceness of the session of this process. Raises OSError where the kernel refuses it."""
    try:
        with open("/proc/self/autogroup", "w", encoding="ascii") as file:
            file.write(str(nice))
    except FileNotFoundError:
        pass        # a kernel without it: the nice value of the thread counts everywhere


def ends_with_parent(arguments: Sequence[str]) -> List[str]:
    """Return the command that runs `arguments` and gets SIGINT when the thread that started it ends.

    setpriv (util-linux 2.33, part of every Debian and Ubuntu from 2019 on) sets prctl(PR_SET_PDEATHSIG) and becomes the
    command, with the same process id, about 1 ms after the start: a parent killed sooner leaves an orphan. A preexec_fn
    would run Python between fork and exec, which may hang in a process with threads. Where setpriv is missing the
    command comes back as it is.
    """
    wrapper = shutil.which("setpriv")
    return ([wrapper, "--pdeathsig", "INT", "--"] if wrapper else []) + list(arguments)


class RestartPolicy:
    """How long to wait before a process that has ended is started again: exponential back-off.

    0 s after a process that ran for PROVEN_S; else 0.5 s, doubled each time, up to 30 s.
    """

    def __init__(self) -> None:
        self._wait = 0.0

    def ended(self, uptime: float) -> float:
        """Return how long to wait after a process ended that ran for `uptime` s."""
        if uptime >= PROVEN_S:
            self._wait = 0.0
        wait = self._wait
        self._wait = min(LONGEST_WAIT_S, max(FIRST_WAIT_S, 2.0 * wait))
        return wait


class ChildProcess:
    """A running command and the end of its output; the pipe never fills as long as drain() is called.

    arguments: a list, no shell interprets it. The child has a session of its own, so that neither Ctrl-C in a terminal
    nor a signal to the parent's group reaches it: the parent decides. The thread that makes this object must
    live as long as the child shall (see ends_with_parent). Raises OSError when the command cannot be started.
    """

    def __init__(self, arguments: Sequence[str]) -> None:
        self._process = subprocess.Popen(
            ends_with_parent(arguments), stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            start_new_session=True)
        assert self._process.stdout is not None
        self._pipe = self._process.stdout
        os.set_blocking(self._pipe.fileno(), False)
        self._output = ""
        self.started = time.monotonic()

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    @property
    def last_line(self) -> str:
        """Last line of the output, without colours; empty when there was none."""
        lines = [line for line in _COLOUR.sub("", self._output).splitlines() if line.strip()]
        return lines[-1].strip() if lines else ""

    def drain(self) -> bool:
        """Read the output without waiting, and keep the end of it. Returns whether the child has closed the pipe."""
        while not self._pipe.closed:
            try:
                chunk = os.read(self._pipe.fileno(), _CHUNK)
            except BlockingIOError:
                return False
            if not chunk:
                break
            self._output = (self._output + chunk.decode("utf-8", "replace"))[-_KEPT_CHARACTERS:]
        return True

    def wait(self, timeout: float) -> Optional[int]:
        """Wait for the end, `timeout` s at most; return the exit code, None when the child still runs."""
        try:
            return self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            return None

    def poll(self) -> Optional[int]:
        """Return the exit code, negative for a signal, None while the child runs."""
        return self._process.poll()

    def send(self, number: int = signal.SIGINT) -> None:
        """Send a signal; nothing happens when the child has ended."""
        if self._process.poll() is None:
            self._process.send_signal(number)

    def close(self) -> None:
        """Kill the child if it still runs, wait for it, read its last output and close the pipe. Idempotent."""
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()
        self.drain()
        self._pipe.close()


def identity_of(pid: Optional[int] = None) -> Dict[str, str]:
    """Return what tells a process from all others, also from a later one with the same id: host, space, pid, start.

    space: boot and process-id namespace, since containers on one host have equal ids. pid None: this process.
    All values are text: the start, in clock ticks since boot, outgrows the 32 bits of an XML-RPC integer. (psutil gives
    it as a time of day only, which changes when the clock is set.)
    """
    pid = os.getpid() if pid is None else pid
    return {"host": socket.gethostname(), "space": _space(), "pid": str(pid), "start": _start_of(str(pid))}


def is_alive(identity: Mapping[str, object]) -> Optional[bool]:
    """Tell whether the process of an identity lives; None when it is on another host or in another container.

    An identity without the fields of identity_of, or with a pid that is no number, is that of no living process.
    """
    fields = {name: str(identity.get(name, "")) for name in ("host", "space", "pid", "start")}
    if not fields["pid"].isdigit():
        return False
    if fields["host"] != socket.gethostname() or fields["space"] != _space():
        return None
    return bool(fields["start"]) and _start_of(fields["pid"]) == fields["start"]


def _space() -> str:
    try:
        with open("/proc/sys/kernel/random/boot_id", encoding="ascii") as file:
            boot = file.read().strip()
        return "{} {}".format(boot, os.readlink("/proc/self/ns/pid"))
    except OSError:
        return ""


def _start_of(pid: str) -> str:
    """Start time of a process, clock ticks since boot (field 22 of /proc/PID/stat, proc(5)); empty when it has
    ended."""
    try:
        with open("/proc/{}/stat".format(pid), "rb") as file:
            fields = file.read().rsplit(b")", 1)[1].split()
    except (OSError, IndexError):
        return ""
    return "" if fields[0] in (b"Z", b"X") else fields[19].decode("ascii")
