"""Memory of images is kept by the process, and garbage is found."""

import gc
import subprocess
import sys
import threading
import time
import weakref

import pytest

from hri_pipeline.core.memory import Collector

SCRIPT = """
import resource, sys
from hri_pipeline.core.memory import keep_large_blocks
if sys.argv[1] == "keep" and not keep_large_blocks():
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


def test_free_memory_goes_back_to_the_system():
    result = subprocess.run([sys.executable, "-c", GIVING], capture_output=True, text=True)
    if "not glibc" in result.stderr:
        pytest.skip("this C library has no malloc_trim")
    before, after = (int(number) for number in result.stdout.split())
    assert after < before - 20_000


GIVING = """
import sys
from hri_pipeline.core.memory import give_back, share_arenas
if not share_arenas():
    sys.stderr.write("not glibc")
    sys.exit()

def resident():
    return int([line for line in open("/proc/self/status") if line.startswith("VmRSS")][0].split()[1])

import ctypes
library = ctypes.CDLL(None)
library.malloc.restype, library.malloc.argtypes, library.free.argtypes = ctypes.c_void_p, [ctypes.c_size_t], [ctypes.c_void_p]
library.memset.argtypes = [ctypes.c_void_p, ctypes.c_int, ctypes.c_size_t]
blocks = [library.malloc(50_000) for _ in range(1000)]
for block in blocks:
    library.memset(block, 1, 50_000)
for block in blocks[:-1]:
    library.free(block)       # the last one stays: the heap does not shrink by itself
before = resident()
give_back()
print(before, resident())
"""


class Cycle:
    def __init__(self):
        self.own = self


def test_what_lies_in_cycles_is_found_and_what_was_there_before_is_left_alone():
    before = weakref.ref(Cycle())
    kept = [[number] for number in range(1000)]
    collector = Collector(period=0.02)
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
