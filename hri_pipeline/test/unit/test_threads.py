"""The numerical libraries of a node do not start threads of their own."""

import json
import os
import subprocess
import sys

import pytest

# In a process of its own: other tests have limited the libraries of this one, perhaps.
SCRIPT = """
import json
import cv2, numpy
numpy.ones((4, 4)) @ numpy.ones((4, 4))
from hri_pipeline.core.threads import one_thread_each, threads_of_libraries
before = threads_of_libraries()
one_thread_each()
import scipy.linalg
print(json.dumps([before, threads_of_libraries(), cv2.getNumThreads()]))
"""


def run(**variables):
    environment = {key: value for key, value in os.environ.items() if not key.endswith("_NUM_THREADS")}
    result = subprocess.run([sys.executable, "-c", SCRIPT], stdout=subprocess.PIPE, universal_newlines=True, check=True,
                            env=dict(environment, **variables))
    return json.loads(result.stdout)


@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="one core: the libraries use one thread anyway")
def test_all_libraries_work_in_one_thread():
    before, after, opencv = run()
    assert before and max(before) > 1
    assert len(after) > len(before) and set(after) == {1}  # scipy came later, with a library of its own
    assert opencv == 1


def test_what_the_user_has_chosen_stays():
    before, after, _ = run(OPENBLAS_NUM_THREADS="2")
    chosen = min(2, os.cpu_count() or 1)
    assert after.count(chosen) >= before.count(chosen) > 0
