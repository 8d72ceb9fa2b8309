"""How many threads the numerical libraries of a process use."""

from __future__ import annotations

import os
from typing import List

import cv2
import threadpoolctl

_VARIABLES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


def one_thread_each() -> None:
    """Let OpenCV and the linear algebra of numpy and scipy work in the thread that calls them.

    Our matrices are small. OpenBLAS wakes its threads even so, and they spin while they wait: on two cores that doubled
    what the processor spent on one face (48 % of a core against 24 %, measured at 13 images/s). Libraries that are loaded
    later read the environment. Who has set one of its variables OPENBLAS_NUM_THREADS, OMP_NUM_THREADS, MKL_NUM_THREADS to
    something else has chosen, and keeps that.
    """
    cv2.setNumThreads(1)
    if all(os.environ.get(name, "1") == "1" for name in _VARIABLES):
        os.environ.update({name: "1" for name in _VARIABLES})
        threadpoolctl.threadpool_limits(limits=1, user_api="blas")


def threads_of_libraries() -> List[int]:
    """Return the number of threads of each linear algebra library that is loaded."""
    return [library["num_threads"] for library in threadpoolctl.threadpool_info() if library["user_api"] == "blas"]
