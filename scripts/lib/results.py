"""Count test results: junit XML of pytest and of rostest, and the table over all layers.

A layer appends one line to the table file: name, passed, failed, skipped, seconds, remark (tab separated).
What failed first and passed when it was run once more, alone, has passed; a file of its own names it, one line each.
Only the standard library.
"""

from __future__ import annotations

import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Dict, List, NamedTuple, Tuple

# The environment variable that points at the large test data; a skip that names it is for lack of it.
DATA_VARIABLE = "ROS4HRI_TEST_DATA"


class Counts(NamedTuple):
    """Test cases of one or more result files; `problems` are lines to show, `second` those of what failed first."""

    passed: int = 0
    failed: int = 0
    skipped: int = 0
    problems: Tuple[str, ...] = ()
    second: Tuple[str, ...] = ()

    def plus(self, other: "Counts") -> "Counts":
        """The sum of two counts."""
        return Counts(
            self.passed + other.passed,
            self.failed + other.failed,
            self.skipped + other.skipped,
            self.problems + other.problems,
            self.second + other.second,
        )


def _first_line(text: str) -> str:
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[0][:200] if lines else ""


def _name_of(case: ElementTree.Element) -> str:
    return "%s.%s" % (case.get("classname", ""), case.get("name", ""))


def _node_id(case: ElementTree.Element) -> str:
    """As pytest calls it, which writes the file, too; results of rostest are told apart by their names."""
    source = case.get("file", "")
    if not source:
        return _name_of(case)
    classes = case.get("classname", "")[len(source) - len("py"):].split(".")
    return "::".join([source] + [name for name in classes if name] + [case.get("name", "")])


def _count_case(case: ElementTree.Element, data_required: bool) -> Counts:
    name = _name_of(case)
    bad = next((child for child in case if child.tag in ("failure", "error")), None)
    if bad is not None:
        return Counts(failed=1, problems=("%s: %s" % (name, _first_line(bad.get("message") or bad.text or "")),))
    skip = case.find("skipped")
    if skip is None:
        return Counts(passed=1)
    reason = skip.get("message") or skip.text or ""
    if data_required and DATA_VARIABLE in reason:
        return Counts(failed=1, problems=("%s: skipped for lack of test data" % name,))
    return Counts(skipped=1, problems=("%s: skipped: %s" % (name, _first_line(reason)),))


def _count_cases(path: Path, data_required: bool) -> Dict[str, Counts]:
    """Counts of each test case of one junit XML file, by its node id; an unreadable file is one failure without one."""
    try:
        root = ElementTree.parse(str(path)).getroot()
    except (OSError, ElementTree.ParseError) as error:
        return {"": Counts(failed=1, problems=("%s: unreadable result file: %s" % (path.name, error),))}
    cases: Dict[str, Counts] = {}
    for case in root.iter("testcase"):
        name = _node_id(case)
        cases[name] = cases.get(name, Counts()).plus(_count_case(case, data_required))
    return cases


def count_file(path: Path, data_required: bool = False) -> Counts:
    """Counts of one junit XML file; an unreadable file counts as one failure.

    With `data_required` a test skipped for lack of the test data is a failure.
    """
    return _sum(_count_cases(path, data_required))


def _sum(cases: Dict[str, Counts]) -> Counts:
    total = Counts()
    for counts in cases.values():
        total = total.plus(counts)
    return total


def failed_ids(path: Path, root: Path) -> List[str]:
    """What to call pytest with to run the cases again that failed: node ids with the path below `root`.

    A failure without a file (a worker of pytest-xdist that collected other tests, say) cannot be repeated.
    """
    cases = ElementTree.parse(str(path)).getroot().iter("testcase")
    return ["%s/%s" % (root, _node_id(case)) for case in cases
            if case.get("file") and (case.find("failure") is not None or case.find("error") is not None)]


def count_twice(first: Path, second: Path, data_required: bool = False) -> Counts:
    """Counts of a run of pytest, and of the run that repeated what had failed in it.

    A case that failed has passed only if the second file says that it did.
    """
    cases = _count_cases(first, data_required)
    again = _count_cases(second, data_required)
    for name, counts in cases.items():
        repeated = again.get(name, Counts())
        if counts.failed and repeated.passed and not repeated.failed:
            cases[name] = Counts(passed=repeated.passed, skipped=repeated.skipped, second=counts.problems[:1])
    return _sum(cases)


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


def _print_second(path: Path) -> str:
    """Print what passed only the second time; returns what the last line says of it."""
    lines = path.read_text().splitlines() if path.exists() else []
    for line in lines:
        print("passed only the second time, alone: %s" % line)
    return " (%d only the second time, alone)" % len(lines) if lines else ""


def _print_counts(counts: Counts) -> None:
    print("%d\t%d\t%d" % counts[:3])
    for problem in counts.problems:
        print(problem, file=sys.stderr)
    for line in counts.second:
        print("second\t" + line, file=sys.stderr)


def main(arguments: List[str]) -> int:
    """Command line: pytest FILE CI | pytest FILE SECOND_FILE CI | rostest DIRECTORY EXIT_CODE CI | failed FILE ROOT |
    table FILE SECOND.

    The first three print passed, failed, skipped (tab separated), with the problems on standard error; lines that begin
    with 'second' and a tabulator name what passed only in the second file. SECOND holds such lines of all layers.
    """
    if arguments[:1] == ["failed"] and len(arguments) == 3:
        print("".join(name + "\n" for name in failed_ids(Path(arguments[1]), Path(arguments[2]))), end="")
        return 0
    if arguments[:1] == ["pytest"] and len(arguments) == 3:
        _print_counts(count_file(Path(arguments[1]), arguments[2] == "true"))
        return 0
    if arguments[:1] == ["pytest"] and len(arguments) == 4:
        _print_counts(count_twice(Path(arguments[1]), Path(arguments[2]), arguments[3] == "true"))
        return 0
    if arguments[:1] == ["rostest"] and len(arguments) == 4:
        _print_counts(count_rostest(Path(arguments[1]), int(arguments[2]), arguments[3] == "true"))
        return 0
    if arguments[:1] == ["table"] and len(arguments) == 3:
        passed, failed = print_table(Path(arguments[1]))
        print("%d passed, %d failed%s" % (passed, failed, _print_second(Path(arguments[2]))))
        return 1 if failed else 0
    print(main.__doc__, file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
