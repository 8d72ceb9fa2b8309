"""Count test results: junit XML of pytest and of rostest, and the table over all layers.

A layer appends one line to the table file: name, passed, failed, skipped, seconds, remark (tab separated).
Only the standard library.
"""

from __future__ import annotations

import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import List, NamedTuple, Tuple

# The environment variable that points at the large test data; a skip that names it is for lack of it.
DATA_VARIABLE = "ROS4HRI_TEST_DATA"


class Counts(NamedTuple):
    """Test cases of one or more result files; `problems` are lines to show."""

    passed: int = 0
    failed: int = 0
    skipped: int = 0
    problems: Tuple[str, ...] = ()

    def plus(self, other: "Counts") -> "Counts":
        """The sum of two counts."""
        return Counts(
            self.passed + other.passed,
            self.failed + other.failed,
            self.skipped + other.skipped,
            self.problems + other.problems,
        )


def _first_line(text: str) -> str:
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[0][:200] if lines else ""


def count_file(path: Path, data_required: bool = False) -> Counts:
    """Counts of one junit XML file; an unreadable file counts as one failure.

    With `data_required` a test skipped for lack of the test data is a failure.
    """
    try:
        root = ElementTree.parse(str(path)).getroot()
    except (OSError, ElementTree.ParseError) as error:
        return Counts(failed=1, problems=("%s: unreadable result file: %s" % (path.name, error),))
    total = Counts()
    for case in root.iter("testcase"):
        name = "%s.%s" % (case.get("classname", ""), case.get("name", ""))
        bad = next((child for child in case if child.tag in ("failure", "error")), None)
        skip = case.find("skipped")
        if bad is not None:
            reason = _first_line(bad.get("message") or bad.text or "")
            total = total.plus(Counts(failed=1, problems=("%s: %s" % (name, reason),)))
        elif skip is not None:
            reason = skip.get("message") or skip.text or ""
            if data_required and DATA_VARIABLE in reason:
                total = total.plus(Counts(failed=1, problems=("%s: skipped for lack of test data" % name,)))
            else:
                total = total.plus(Counts(skipped=1, problems=("%s: skipped: %s" % (name, _first_line(reason)),)))
        else:
            total = total.plus(Counts(passed=1))
    return total


def count_rostest(directory: Path, exit_code: int, data_required: bool = False) -> Counts:
    """Counts of one rostest run.

    `rosunit-*.xml` holds the cases of each test node, `rostest-*.xml` the view of the launcher, which
    alone knows of test nodes that crashed or timed out. A run that failed without any failed case,
    or ended well without any case, counts as one failure more.
    """
    inner, outer = Counts(), Counts()
    for path in sorted(directory.rglob("*.xml")):
        if path.name.startswith("rostest-"):
            outer = outer.plus(count_file(path, data_required))
        else:
            inner = inner.plus(count_file(path, data_required))
    if inner.failed == 0 and outer.failed:
        inner = inner.plus(Counts(failed=outer.failed, problems=outer.problems))
    if inner.failed == 0 and exit_code != 0:
        inner = inner.plus(Counts(failed=1, problems=("rostest ended with exit code %d" % exit_code,)))
    if inner.passed + inner.failed == 0:
        inner = inner.plus(Counts(failed=1, problems=("no test case ran",)))
    return inner


def print_table(path: Path) -> Tuple[int, int]:
    """Print the table of all layers; returns passed and failed. A layer that ran nothing, and does not say why, is a
    failure."""
    passed = failed = 0
    print("%-11s %7s %7s %8s %9s" % ("layer", "passed", "failed", "skipped", "seconds"))
    for line in path.read_text().splitlines():
        name, good, bad, skipped, seconds, remark = (line.split("\t") + [""] * 6)[:6]
        if int(good) + int(bad) == 0:
            if remark:
                good = bad = skipped = "-"
                remark = "skipped: " + remark
            else:
                bad, remark = "1", "ran nothing"
        passed, failed = passed + int(good.replace("-", "0")), failed + int(bad.replace("-", "0"))
        print("%-11s %7s %7s %8s %9s  %s" % (name, good, bad, skipped, seconds, remark))
    return passed, failed


def _print_counts(counts: Counts) -> None:
    print("%d\t%d\t%d" % (counts.passed, counts.failed, counts.skipped))
    for problem in counts.problems:
        print(problem, file=sys.stderr)


def main(arguments: List[str]) -> int:
    """Command line: pytest FILE CI | rostest DIRECTORY EXIT_CODE CI | table FILE.

    The first two print passed, failed, skipped (tab separated), with the problems on standard error.
    """
    if arguments[:1] == ["pytest"] and len(arguments) == 3:
        _print_counts(count_file(Path(arguments[1]), arguments[2] == "true"))
        return 0
    if arguments[:1] == ["rostest"] and len(arguments) == 4:
        _print_counts(count_rostest(Path(arguments[1]), int(arguments[2]), arguments[3] == "true"))
        return 0
    if arguments[:1] == ["table"] and len(arguments) == 2:
        passed, failed = print_table(Path(arguments[1]))
        print("%d passed, %d failed" % (passed, failed))
        return 1 if failed else 0
    print(main.__doc__, file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
