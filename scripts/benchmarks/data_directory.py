"""Where the large test data lies: motion capture, groups. It is no part of the project."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Optional

VARIABLE = "ROS4HRI_TEST_DATA"
# A skipped test says this: scripts/test looks for the variable's name, and counts the skip as a failure in CI.
ABSENT = "the test data is absent: {} is not set, and there is no shared/data beside the checkout".format(VARIABLE)


def data_directory() -> Optional[Path]:
    """Return the directory of the test data, None where there is none.

    It is $ROS4HRI_TEST_DATA, and without that `shared/data` in or beside the checkout.
    Raises NotADirectoryError when the variable names something that is no directory.
    """
    named = os.environ.get(VARIABLE)
    if named:
        directory = Path(named).expanduser()
        if not directory.is_dir():
            raise NotADirectoryError("{} is {}, which is no directory".format(VARIABLE, directory))
        return directory
    # <checkout>/scripts/benchmarks/data_directory.py
    parents = list(Path(__file__).resolve().parents)
    for place in parents[2:4]:
        if (place / "shared" / "data").is_dir():
            return place / "shared" / "data"
    return None
