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
for _ in range(50):
    numpy.ones(40_000_000, numpy.uint8)
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def faults(mode):
    result = subprocess.run([sys.executable, "-c", SCRIPT, mode], capture_output=True, text=True)
    if "not glibc" in result.stderr:
        pytest.skip("this C library has no mallopt")
    return int(result.stdout)


def test_large_blocks_are_used_again():
    assert 10 * faults("keep") < faults("default")
