"""Memory of images is kept by the process."""

import subprocess
import sys

import pytest

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
