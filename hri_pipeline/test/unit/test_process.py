"""Memory, threads, niceness and child processes of a process; mostly in processes of their own, whose state is not that
of the test."""

from __future__ import annotations

import gc
import json
import os
import signal
import subprocess
import sys
import threading
import time
import weakref
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from hri_pipeline.core import process
from hri_pipeline.core.process import (
    LONGEST_WAIT_S,
    PROVEN_S,
    ChildProcess,
    GarbageCollector,
    RestartPolicy,
    Threads,
    ends_with_parent,
    identity_of,
    is_alive,
    set_niceness,
)

SCRIPT = """
import resource, sys
from hri_pipeline.core.process import raise_mmap_threshold
if sys.argv[1] == "keep" and not raise_mmap_threshold():
    sys.exit("not glibc")
import numpy
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(10):
    images = [numpy.ones(3_000_000, numpy.uint8) for _ in range(20)]
    del images
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def faults(mode):
    result = subprocess.run([sys.executable, "-c", SCRIPT, mode], capture_output=True, text=True)
    if "not glibc" in result.stderr:
        pytest.skip("this C library has no mallopt")
    return int(result.stdout)


def test_large_blocks_are_used_again():
    assert 3 * faults("keep") < faults("default")


def test_large_blocks_are_kept_by_a_c_library_that_refuses_a_threshold_above_its_limit(monkeypatch):
    class OldLibrary:
        settings = {}

        @staticmethod
        def mallopt(name, value):
            accepted = name != -3 or value <= 32 * 2 ** 20      # M_MMAP_THRESHOLD; see mallopt(3)
            OldLibrary.settings.update({name: value} if accepted else {})
            return int(accepted)

    monkeypatch.setattr(process.ctypes, "CDLL", lambda name: OldLibrary)
    assert process.raise_mmap_threshold()
    assert set(OldLibrary.settings) == {-1, -3}


def test_free_memory_goes_back_to_the_system():
    result = subprocess.run([sys.executable, "-c", GIVING], capture_output=True, text=True)
    if "not glibc" in result.stderr:
        pytest.skip("this C library has no malloc_trim")
    before, after = (int(number) for number in result.stdout.split())
    assert after < before - 20_000


GIVING = """
import sys
from hri_pipeline.core.process import trim_memory, share_arenas
if not share_arenas():
    sys.stderr.write("not glibc")
    sys.exit()

def resident():
    return int([line for line in open("/proc/self/status") if line.startswith("VmRSS")][0].split()[1])

import ctypes
library = ctypes.CDLL(None)
library.malloc.restype, library.malloc.argtypes = ctypes.c_void_p, [ctypes.c_size_t]
library.free.argtypes = [ctypes.c_void_p]
library.memset.argtypes = [ctypes.c_void_p, ctypes.c_int, ctypes.c_size_t]
blocks = [library.malloc(50_000) for _ in range(1000)]
for block in blocks:
    library.memset(block, 1, 50_000)
for block in blocks[:-1]:
    library.free(block)       # the last one stays: the heap does not shrink by itself
before = resident()
trim_memory()
print(before, resident())
"""


class Cycle:
    def __init__(self):
        self.own = self


def test_what_lies_in_cycles_is_found_and_what_was_there_before_is_left_alone():
    before = weakref.ref(Cycle())
    kept = [[number] for number in range(1000)]
    collector = GarbageCollector(period=0.02)
    try:
        assert before() is None and gc.get_freeze_count() > len(kept)
        after = weakref.ref(Cycle())
        deadline = time.monotonic() + 10.0
        while after() is not None and time.monotonic() < deadline:
            time.sleep(0.01)
        assert after() is None
    finally:
        collector.close()
        collector.close()
    assert gc.get_freeze_count() == 0
    assert "collector" not in [thread.name for thread in threading.enumerate()]


# In a process of its own: other tests have limited the libraries of this one, perhaps.
THREADS_SCRIPT = """
import json
import cv2, numpy, threadpoolctl
numpy.ones((4, 4)) @ numpy.ones((4, 4))
from hri_pipeline.core.process import one_thread_each
def threads():
    return [one["num_threads"] for one in threadpoolctl.threadpool_info() if one["user_api"] == "blas"]
before = threads()
one_thread_each()
import scipy.linalg
print(json.dumps([before, threads(), cv2.getNumThreads()]))
"""


def threads_of_a_new_process(**variables):
    environment = {key: value for key, value in os.environ.items() if not key.endswith("_NUM_THREADS")}
    result = subprocess.run([sys.executable, "-c", THREADS_SCRIPT], stdout=subprocess.PIPE, universal_newlines=True,
                            check=True,
                            env=dict(environment, **variables))
    return json.loads(result.stdout)


@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="one core: the libraries use one thread anyway")
def test_all_libraries_work_in_one_thread():
    before, after, opencv = threads_of_a_new_process()
    assert before and max(before) > 1
    assert len(after) > len(before) and set(after) == {1}  # scipy came later, with a library of its own
    assert opencv == 1


def test_what_the_user_has_chosen_stays():
    before, after, _ = threads_of_a_new_process(OPENBLAS_NUM_THREADS="2")
    chosen = min(2, os.cpu_count() or 1)
    assert after.count(chosen) >= before.count(chosen) > 0


SOURCE = Path(__file__).resolve().parents[2] / "src"
HERE = os.getpriority(os.PRIO_PROCESS, 0)
PROGRAM = """
import os, sys, threading
sys.path.insert(0, sys.argv[1])
from hri_pipeline.core.process import set_niceness
before = threading.Event(), threading.Event(), []
def wait():
    before[0].wait()
    before[2].append(os.getpriority(os.PRIO_PROCESS, 0))
old = threading.Thread(target=wait)
old.start()
print(set_niceness(int(sys.argv[2])))
print(os.getpriority(os.PRIO_PROCESS, 0))
before[0].set()
old.join()
print(before[2][0])
if os.path.exists("/proc/self/autogroup"):
    # Empty for a session that is in no such group: it began before they were switched on, or outside of this container.
    print(*open("/proc/self/autogroup").read().split()[-1:])
"""


def run(nice, leads):
    """Return what such a process has said of itself: done, nice value of its thread, of an older one, of its
    session."""
    return subprocess.run([sys.executable, "-c", PROGRAM, str(SOURCE), str(nice)], check=True, stdout=subprocess.PIPE,
                          universal_newlines=True, start_new_session=leads, timeout=60.0).stdout.split()


def test_the_thread_and_its_session_stand_back():
    done, thread, older, *session = run(5, leads=True)
    assert (done, thread, older) == ("True", str(max(5, HERE)), str(HERE))
    assert session in ([], ["5"])


def test_a_terminal_is_left_alone():
    done, thread, _, *session = run(5, leads=False)
    assert (done, thread) == ("True", str(max(5, HERE)))
    assert session in ([], run(0, leads=False)[3:])


def test_zero_changes_nothing():
    assert run(0, leads=True)[:3] == ["True", str(HERE), str(HERE)]


@pytest.mark.parametrize("nice", [-1, 20])
def test_out_of_range(nice):
    with pytest.raises(ValueError, match="0 to 19"):
        set_niceness(nice)


def test_the_arguments_stay_as_they_are():
    found = subprocess.run(ends_with_parent(["/bin/echo", "$(id)", "a b"]), stdout=subprocess.PIPE, check=True)
    assert found.stdout == b"$(id) a b\n"


def test_without_setpriv_it_is_the_command_itself(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert ends_with_parent(("/bin/sleep", "1")) == ["/bin/sleep", "1"]


def until(condition, seconds=10.0):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.005)


@pytest.fixture
def start():
    children = []

    def make(*arguments):
        children.append(ChildProcess(arguments))
        return children[-1]

    yield make
    for child in children:
        child.close()


def test_the_last_line_without_colours(start):
    child = start("/bin/sh", "-c", "echo one; printf '\\033[31mtwo\\033[0m\\n\\n' >&2; exit 3")
    assert child.wait(10.0) == 3
    assert child.drain() and child.last_line == "two"


def test_a_talkative_child_is_never_stopped_by_its_pipe(start):
    child = start("/bin/sh", "-c", "i=0; while [ $i -lt 5000 ]; do echo 0123456789012345678901234567890123456789; "
                                   "i=$((i+1)); done; echo done")
    until(lambda: child.drain())
    assert child.wait(10.0) == 0 and child.last_line == "done"


def test_no_shell_sees_the_arguments(start):
    child = start("/bin/echo", "$(id); `id` <a> & b")
    assert child.wait(10.0) == 0
    child.drain()
    assert child.last_line == "$(id); `id` <a> & b"


def test_signals_and_codes(start):
    child = start("/bin/sleep", "60")
    assert child.poll() is None and child.wait(0.01) is None
    child.send(signal.SIGINT)
    assert child.wait(10.0) == -signal.SIGINT
    child.send(signal.SIGINT)
    child.close()
    child.close()


def test_what_cannot_be_started_says_so():
    with pytest.raises(OSError):
        subprocess.Popen(["/nowhere/robot_state_publisher"])
    child = ChildProcess(["/nowhere/robot_state_publisher"]) if len(ends_with_parent(["x"])) > 1 else None
    if child is not None:       # setpriv starts, and says that the command is not there
        assert child.wait(10.0) == 127
        child.drain()
        assert "/nowhere/robot_state_publisher" in child.last_line
        child.close()


def test_a_child_has_its_own_session(start):
    child = start("/bin/sleep", "60")
    assert os.getsid(child.pid) == child.pid != os.getsid(0)


@pytest.mark.skipif(len(ends_with_parent(["x"])) == 1, reason="setpriv is not installed")
def test_a_child_ends_when_its_parent_is_killed():
    code = ("import sys, time; sys.path[:0] = {!r}; from hri_pipeline.core.process import ChildProcess; "
            "print(ChildProcess(['/bin/sleep', '60']).pid, flush=True); time.sleep(60)").format([str(SOURCE)])
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE)
    try:
        child = int(parent.stdout.readline())
        identity = identity_of(child)
        assert is_alive(identity)
        # setpriv asks for the signal, then becomes the command.
        until(lambda: Path("/proc/{}/cmdline".format(child)).read_bytes().startswith(b"/bin/sleep"))
    finally:
        parent.kill()
        parent.wait()
        parent.stdout.close()
    until(lambda: not is_alive(identity))


def test_a_process_is_known_again():
    own = identity_of()
    assert is_alive(own) is True and all(isinstance(value, str) for value in own.values())
    assert is_alive(dict(own, start="1")) is False            # another process with the same number
    assert is_alive(dict(own, host="elsewhere")) is None
    assert is_alive(dict(own, space="another container")) is None
    for hostile in ({}, {"pid": "../1"}, {"pid": None}, dict(own, pid="x")):
        assert is_alive(hostile) is False
    gone = subprocess.Popen(["/bin/true"])
    identity = identity_of(gone.pid)
    gone.wait()
    assert is_alive(identity) is False


def test_descriptors_are_given_back():
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(20):
        child = ChildProcess(["/bin/true"])
        until(lambda child=child: child.poll() is not None)
        child.close()
        assert child.drain()
    assert len(os.listdir("/proc/self/fd")) == before


def test_waits_grow_and_end_after_a_good_run():
    policy = RestartPolicy()
    waits = [policy.ended(0.3) for _ in range(12)]
    assert waits[:4] == [0.0, 0.5, 1.0, 2.0] and waits[-1] == LONGEST_WAIT_S
    assert policy.ended(PROVEN_S) == 0.0
    assert policy.ended(0.3) == 0.5


def interrupted(code):
    """Run a program that Ctrl-C ends; return its exit code and what it printed on stderr."""
    done = subprocess.run([sys.executable, "-c", code], stderr=subprocess.PIPE, universal_newlines=True, timeout=60)
    return done.returncode, done.stderr


def test_ctrl_c_during_the_imports_of_a_program_prints_nothing_and_errors_are_printed_as_ever():
    hit = "import os, signal, time; os.kill(os.getpid(), signal.SIGINT); time.sleep(30.0)"
    assert interrupted("from hri_pipeline.core import interrupt; " + hit) == (-signal.SIGINT, "")
    code, text = interrupted("from hri_pipeline.core import interrupt; import no_such_module")
    assert code == 1 and "ModuleNotFoundError" in text


def test_ctrl_c_that_an_import_turns_into_another_error_or_forgets_ends_the_program(tmp_path):
    (tmp_path / "turns_it.py").write_text(
        "import os, signal, time\ntry:\n    os.kill(os.getpid(), signal.SIGINT)\n    time.sleep(30.0)\n"
        "except BaseException:\n    raise ImportError('datetime')\n")
    path = "import sys; sys.path.insert(0, {!r}); ".format(str(tmp_path))
    assert interrupted("from hri_pipeline.core import interrupt; " + path + "import turns_it") == (-signal.SIGINT, "")


def test_ctrl_c_after_the_imports_is_a_keyboard_interrupt_as_ever(tmp_path):
    """Also while a function imports something: what is open has to be closed."""
    (tmp_path / "waits.py").write_text(
        "import os, signal, time\nos.kill(os.getpid(), signal.SIGINT)\ntime.sleep(30.0)\n")
    program = tmp_path / "program.py"
    program.write_text("from hri_pipeline.core import interrupt\nimport sys\n\ndef main():\n    try:\n"
                       "        import waits\n    except KeyboardInterrupt:\n        sys.exit('closed')\n\nmain()\n")
    done = subprocess.run([sys.executable, str(program)], stderr=subprocess.PIPE, universal_newlines=True, timeout=60)
    assert (done.returncode, done.stderr) == (1, "closed\n")


SOURCES = Path(__file__).resolve().parents[3]


@pytest.mark.skipif(not (SOURCES / "docs").is_dir(), reason="the scripts are there in the sources")
def test_every_node_and_tool_is_quiet_from_its_first_import_on():
    scripts = [path for path in SOURCES.glob("hri_*/nodes/*") if path.is_file() and not path.suffix]
    scripts += [SOURCES / "scripts" / name for name in ("calibrate_cameras", "cameras", "report", "score")]
    assert len(scripts) > 24
    for path in scripts:
        imports = [line for line in path.read_text().splitlines() if line.startswith(("import ", "from "))]
        assert imports[0] == "from hri_pipeline.core import interrupt  # noqa: F401", path


@pytest.mark.parametrize("answer, is_synchronised", [(0, True), (1, True), (5, False), (-1, False), (None, False)])
def test_whether_the_clock_is_right_says_the_kernel(monkeypatch, answer, is_synchronised):
    class Library:
        def __init__(self, name):
            if answer is not None:
                self.adjtimex = lambda timex: answer

    assert process.is_clock_synchronised() in (False, True), "of this machine"
    monkeypatch.setattr(process.ctypes, "CDLL", Library)
    assert process.is_clock_synchronised() is is_synchronised


def test_threads_share_items_and_keep_their_order():
    threads, callers = Threads(3), set()
    all_here = threading.Barrier(3, timeout=20.0)

    def square(part):
        callers.add(threading.current_thread())
        all_here.wait()         # only three threads at once come past it
        return [number * number for number in part]

    assert threads.in_parts(square, range(20)) == [number * number for number in range(20)]
    assert len(callers) == 3 and threading.current_thread() in callers
    threads.close()


def test_with_one_thread_the_caller_does_all_at_once_and_when_it_is_asked_for():
    before, calls = set(threading.enumerate()), []
    threads = Threads(1)
    assert threads.in_parts(lambda part: calls.append(list(part)) or part, [1, 2, 3]) == [1, 2, 3]
    with threads.beside(calls.append, "later") as result:
        assert calls == [[1, 2, 3]]
        result()
    assert calls == [[1, 2, 3], "later"] and not set(threading.enumerate()) - before


def test_threads_begin_beside_the_caller_and_end_with_close():
    before, begun, go = set(threading.enumerate()), threading.Event(), threading.Event()
    threads = Threads(2)

    def work(value):
        begun.set()
        assert go.wait(20.0)
        return 2 * value

    with threads.beside(work, 4) as result:
        assert begun.wait(20.0), "before it is asked for"
        go.set()
        assert result() == 8
    threads.close()
    threads.close()
    assert not set(threading.enumerate()) - before
    assert threads.in_parts(lambda part: part, [1, 2, 3]) == [1, 2, 3]
    with threads.beside(lambda: 5) as result:
        assert result() == 5


def test_an_error_of_a_thread_is_that_of_the_first_item():
    threads = Threads(4)

    def fail(part):
        if part[0] > 0:
            raise KeyError(part[0])
        return part

    for _ in range(20):
        with pytest.raises(KeyError, match="^2$"):
            threads.in_parts(fail, range(8))
    with pytest.raises(ZeroDivisionError), threads.beside(lambda: 1 // 0) as result:
        result()
    assert threads.in_parts(lambda part: part, [1, 2]) == [1, 2], "and they go on"
    threads.close()


def test_threads_that_are_busy_with_what_shares_items_itself_do_not_wait_for_each_other():
    threads = Threads(2)
    with threads.beside(threads.in_parts, lambda part: part, range(5)) as result:
        assert threads.in_parts(lambda part: part, range(5)) == list(range(5))
        assert result() == list(range(5))
    threads.close()


def test_threads_follow_the_niceness_that_the_caller_gets_later():
    """A node lowers its priority some seconds after its first image, when all its threads have begun."""
    threads, seen = Threads(2), []

    def look():
        return os.getpriority(os.PRIO_PROCESS, 0)

    def node():     # in a thread of its own: what it gives up it does not get back
        for extra in (0, 1):
            os.setpriority(os.PRIO_PROCESS, 0, look() + extra)
            with threads.beside(look) as result:
                seen.append((look(), result()))

    caller = threading.Thread(target=node)
    caller.start()
    caller.join()
    threads.close()
    before = os.getpriority(os.PRIO_PROCESS, 0)
    assert seen == [(before, before), (before + 1, before + 1)]


def test_what_was_begun_beside_and_not_asked_for_ends_with_the_caller_s_step():
    threads, begun, go, done = Threads(2), threading.Event(), threading.Event(), []

    def work():
        begun.set()
        assert go.wait(20.0)
        done.append("first")

    with pytest.raises(KeyError):
        with threads.beside(work):
            assert begun.wait(20.0)
            with threads.beside(done.append, "never begun, as the thread is busy"):
                pass
            go.set()
            raise KeyError("in between")
    assert done == ["first"], "nothing reads the image any more"
    with threads.beside(lambda: 1 // 0):
        pass        # an error of what nobody wants any more
    with pytest.raises(SystemExit), threads.beside(sys.exit, 3) as result:
        result()    # nobody waits for ever
    threads.close()


class NoMoreThreads(ThreadPoolExecutor):
    """A process that may have no more threads: the pool says so, and keeps the work all the same for those it has."""

    begun = threading.Event()

    def submit(self, *work):
        super().submit(*work)
        assert self.begun.wait(20.0)
        raise RuntimeError("can't start new thread")


def test_where_no_more_threads_start_nothing_is_lost_and_nothing_done_twice(monkeypatch):
    monkeypatch.setattr(process, "ThreadPoolExecutor", NoMoreThreads)
    threads, caller, go, done = Threads(3), threading.current_thread(), threading.Event(), []

    def work(part):
        if threading.current_thread() is caller:
            if len(done) == 3:
                go.set()
        else:
            NoMoreThreads.begun.set()
            assert go.wait(20.0)
        done.extend(part)
        return part

    assert threads.in_parts(work, range(9)) == list(range(9)) and sorted(done) == list(range(9))
    with threads.beside(done.append, 9) as result:
        result()
    assert sorted(done) == list(range(10))
    threads.close()


def test_the_time_of_threads_is_that_of_all_who_work_for_the_caller():
    threads = Threads(3)
    used = []

    def work(part):
        began = time.thread_time()
        while time.thread_time() - began < 0.02:
            pass
        used.append(time.thread_time() - began)
        return part

    began = threads.time()
    threads.in_parts(work, range(6))
    assert sum(used) <= threads.time() - began < 1.5 * sum(used)
    threads.close()


@pytest.mark.parametrize("cores, share, count", [
    (1, 0.75, 1), (2, 0.75, 1), (2, 1.0, 1), (3, 0.75, 2), (4, 0.75, 2), (4, 0.5, 1), (8, 0.75, 3), (8, 0.0, 1),
    (16, 0.75, 6), (16, 1.0, 8), (64, 0.75, 8), (0.5, 0.75, 1), (3.5, 0.75, 2), (5.5, 0.75, 3)])
def test_a_node_has_threads_for_half_of_the_share_of_the_cores(monkeypatch, cores, share, count):
    monkeypatch.setattr(process.Cores, "count", cores)
    assert Threads.of_node(0, share).count == count
    assert Threads.of_node(5, share).count == 5, "as told"


@pytest.mark.parametrize("cores, count", [(1, 1), (2, 1), (3, 3), (4, 3), (8, 6), (16, 8)])
def test_a_node_whose_parts_take_turns_has_threads_for_all_of_the_share(monkeypatch, cores, count):
    monkeypatch.setattr(process.Cores, "count", cores)
    assert Threads.of_node(0, 0.75, nodes=1).count == count


def test_no_threads_are_refused():
    with pytest.raises(ValueError, match="1 and more"):
        Threads(0)
