"""How the C library keeps the memory of images, and Python what is no longer used."""

from __future__ import annotations

import ctypes
import gc
import threading

# Parameters of mallopt in glibc's malloc.h.
_M_TRIM_THRESHOLD = -1
_M_MMAP_THRESHOLD = -3
_M_ARENA_MAX = -8
# Larger than any image, or the tensor made of it.
_KEEP_BYTES = 2 ** 28


def share_arenas(count: int = 2) -> bool:
    """Let all threads allocate from `count` arenas; tell whether the C library can. For nodes whose threads come and go.

    By default each new thread may get an arena of its own, up to eight per core, and what is freed in one is of no use
    to the others: with topics that open and close all the time the process grows for minutes.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return False
    mallopt.argtypes = (ctypes.c_int, ctypes.c_int)
    return bool(mallopt(_M_ARENA_MAX, count))


class Collector:
    """Looks for garbage in cycles every `period` s, among what was made since this object was, and gives free memory back.

    For a program that has been set up.

    Python itself looks when 70,000 objects more than before are there, and never when these are less than a quarter of all: of
    the topics of people who have left, a node held what rospy leaves of them for half an hour (measured). Without the objects
    that were there before, mostly those of libraries, a look takes some milliseconds. What topics of people held lies between
    what others still hold, and the C library keeps such pages: nodes grew by 15 MB in two hours of people who came and went.
    """

    def __init__(self, period: float = 20.0) -> None:
        gc.collect()
        gc.freeze()
        self._stop = threading.Event()
        self._period = period
        self._thread = threading.Thread(target=self._run, name="collector", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Look no more. Idempotent."""
        self._stop.set()
        self._thread.join()
        gc.unfreeze()

    def _run(self) -> None:
        while not self._stop.wait(self._period):
            gc.collect()
            give_back()


def give_back() -> bool:
    """Give memory that is free to the kernel; tell whether there was any. Takes a few milliseconds."""
    try:
        return bool(ctypes.CDLL(None).malloc_trim(ctypes.c_size_t(0)))
    except (OSError, AttributeError):
        return False


def keep_large_blocks() -> bool:
    """Let malloc re-use the memory of images; tell whether the C library can.

    By default, glibc asks the kernel for every block of the size of an image and gives it back at once, so that each
    page is cleared and mapped anew for each image: 20,000 page faults per second at 1280x720, 4 % of a core in each
    process that works on images (measured).
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return False
    mallopt.argtypes = (ctypes.c_int, ctypes.c_int)
    kept = [mallopt(name, _KEEP_BYTES) for name in (_M_MMAP_THRESHOLD, _M_TRIM_THRESHOLD)]
    return all(kept)
