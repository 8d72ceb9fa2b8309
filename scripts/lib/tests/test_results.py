"""Counting of test results: what must never be taken for a success."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Dict, Set

import pytest
import results

LIB = Path(__file__).resolve().parent.parent

CASES = """<testsuite tests="4">
  <testcase classname="a" name="good"/>
  <testcase classname="a" name="bad"><failure message="1 is not 2"/></testcase>
  <testcase classname="a" name="broken"><error>Traceback</error></testcase>
  <testcase classname="a" name="left_out"><skipped message="ROS4HRI_TEST_DATA is not set"/></testcase>
</testsuite>"""


def _write(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def test_cases_of_one_file_are_counted(tmp_path: Path) -> None:
    counts = results.count_file(_write(tmp_path / "r.xml", CASES))
    assert counts[:3] == (1, 2, 1)


def test_lack_of_test_data_fails_where_it_is_required(tmp_path: Path) -> None:
    assert results.count_file(_write(tmp_path / "r.xml", CASES), data_required=True)[:3] == (1, 3, 0)


def test_unreadable_file_is_a_failure(tmp_path: Path) -> None:
    assert results.count_file(_write(tmp_path / "r.xml", "<testsuite>")).failed == 1
    assert results.count_file(tmp_path / "missing.xml").failed == 1


def test_rostest_counts_the_inner_cases(tmp_path: Path) -> None:
    _write(tmp_path / "p" / "rosunit-x.xml", '<testsuite><testcase name="a"/><testcase name="b"/></testsuite>')
    _write(tmp_path / "p" / "rostest-x.xml", '<testsuite><testcase name="testx"/></testsuite>')
    assert results.count_rostest(tmp_path, 0)[:3] == (2, 0, 0)


def test_rostest_that_crashed_or_ran_nothing_is_a_failure(tmp_path: Path) -> None:
    assert results.count_rostest(tmp_path, 0).failed == 1
    assert results.count_rostest(tmp_path, 1).failed == 1
    _write(tmp_path / "p" / "rosunit-x.xml", '<testsuite><testcase name="a"/></testsuite>')
    assert results.count_rostest(tmp_path, 124).failed == 1
    _write(tmp_path / "p" / "rostest-x.xml", '<testsuite><testcase name="x"><failure '
                                             'message="time-limit"/></testcase></testsuite>')
    assert results.count_rostest(tmp_path, 1)[:2] == (1, 1)


def test_table_adds_up_and_an_empty_layer_fails(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    table = _write(tmp_path / "t", "static\t5\t0\t0\t1.0\t\nrostest\t0\t0\t0\t0.1\t\npytest38\t0\t0\t0\t0.0\tno Python "
                                   "3.8 here\n")
    assert results.print_table(table) == (5, 1)
    lines = capsys.readouterr().out.splitlines()
    assert lines[2].split() == ["rostest", "0", "1", "0", "0.1", "ran", "nothing"]
    assert lines[3].split() == ["pytest38", "-", "-", "-", "0.0", "skipped:", "no", "Python", "3.8", "here"]


def run_layers(directory: Path, commands: str) -> "subprocess.CompletedProcess[str]":
    """Run commands of scripts/lib/layers.sh; their table is directory/table."""
    start = ('R4H_NAME=test R4H_STEPS=1; . "$1/common.sh"; . "$1/layers.sh"; R4H_TMP=$2 R4H_LOGS=$2 R4H_WS=$2; '
             'R4H_TABLE=$2/table R4H_SECOND=$2/second R4H_DATA_REQUIRED=false; cd "$R4H_ROOT"; ')
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("PYTEST", "ROS"))}
    return subprocess.run(["bash", "-euo", "pipefail", "-c", start + commands, "bash", str(LIB), str(directory)],
                          check=True, stdout=subprocess.PIPE, universal_newlines=True, env=environment)


def test_a_layer_that_cannot_run_is_told_as_skipped_with_the_reason(tmp_path: Path) -> None:
    done = run_layers(tmp_path, "find_python38() { return 1; }; run_layer pytest38")
    assert "pytest38: skipped: no Python 3.8 here" in done.stdout and "0 passed" not in done.stdout
    assert results.print_table(tmp_path / "table") == (0, 0)


def test_a_check_that_cannot_run_is_told_as_skipped(tmp_path: Path) -> None:
    done = run_layers(tmp_path, "find_python38() { return 1; }; check() { R4H_PASSED=$((R4H_PASSED + 1)); }; "
                      "check_counting() { :; }; run_layer static")
    assert "skipped syntax, Python 3.8: no Python 3.8 here" in done.stdout and "0 failed, 1 skipped" in done.stdout


def test_a_layer_that_ran_is_counted(tmp_path: Path) -> None:
    done = run_layers(tmp_path, "layer_other() { add_counts $'3\\t1\\t2'; }; run_layer other")
    assert "other: 3 passed, 1 failed, 2 skipped" in done.stdout
    assert results.print_table(tmp_path / "table") == (3, 1)


@pytest.mark.parametrize("work, commands", [
    ("catkin_make_here", "run_rostests() { :; }; layer_rostest & layer_rostest; wait $!"),
    ("make_venv38", "find_python38() { echo python3.8; }; venv38 & venv38; wait $!")])
def test_two_at_once_do_not_write_into_each_others_files(work: str, commands: str, tmp_path: Path) -> None:
    run_layers(tmp_path, '. "$1/setup.sh"; R4H_CACHE=$2; lock_hash() { echo 1; }; run_or_fail() { shift 2; "$@"; }; '
               'check() { shift; "$@"; }; %s() { echo + >>"$R4H_TMP/log"; sleep 0.5; echo - >>"$R4H_TMP/log"; }; %s'
               % (work, commands))
    assert (tmp_path / "log").read_text().split() == ["+", "-", "+", "-"]


# A rostest that fails as often as a file beside the .test file says, and leaves results as the real one does.
ROSTEST = """#!/usr/bin/env bash
name=$(basename "$1" .test)
left=$(cat "$1.failures")
mkdir -p "$ROS_TEST_RESULTS_DIR"
log=$ROS_TEST_RESULTS_DIR/../../log
printf "+%s\\n" "$name" >>"$log"
[ "$name" = shaky ] || sleep 0.3
printf -- "-%s\\n" "$name" >>"$log"
if ((left)); then
    echo $((left - 1)) >"$1.failures"
    result='<failure message="not within 3 s: a face"/>'
fi
case="<testcase classname='a' name='b'>${result:-}</testcase>"
echo "<testsuite>$case</testsuite>" >"$ROS_TEST_RESULTS_DIR/rosunit-a.xml"
[ -z "${result:-}" ]
"""


COMMENTS = {"alone": "<!-- runs alone: figures of time -->", "heavy": "<!-- heavy: networks -->"}


def run_rostests(directory: Path, failures: Dict[str, int], setting: str = ":",
                 layers: str = "rostest") -> "subprocess.CompletedProcess[str]":
    """Run layers, that of the rostests on files which fail so many times each; their table is directory/table."""
    program = _write(directory / "bin" / "rostest", ROSTEST)
    program.chmod(0o755)
    sources = directory / "src" / "ros4hri"
    for name, times in failures.items():
        _write(sources / name, "<launch>%s</launch>" % COMMENTS.get(Path(name).stem.split("_")[0], ""))
        _write(sources / (name + ".failures"), str(times))
    return run_layers(directory, 'PATH=$2/bin:$PATH; R4H_SYSTEM_PYTHON=%s; %s; cd "$2/src/ros4hri"; '
                                 'layer_rostest() { run_rostests %s; }; run_layers %s'
                      % (sys.executable, setting, " ".join(failures), layers))


def test_a_rostest_that_passes_the_second_time_has_passed_and_is_named(tmp_path: Path) -> None:
    done = run_rostests(tmp_path, {"good.test": 0, "shaky.test": 1})
    assert "rostest: 2 passed, 0 failed, 0 skipped" in done.stdout
    assert (tmp_path / "second").read_text() == "shaky.test: a.b: not within 3 s: a face\n"
    assert (tmp_path / "log").read_text().split().count("-shaky") == 2


def test_a_rostest_that_fails_twice_has_failed_and_is_not_run_a_third_time(tmp_path: Path) -> None:
    done = run_rostests(tmp_path, {"good.test": 0, "bad.test": 2})
    assert "rostest: 1 passed, 1 failed, 0 skipped" in done.stdout
    assert (tmp_path / "log").read_text().split().count("-bad") == 2 and not (tmp_path / "second").exists()


def test_a_rostest_is_repeated_alone_after_all_others(tmp_path: Path) -> None:
    run_rostests(tmp_path, {"shaky.test": 1, "slow.test": 0})
    log = (tmp_path / "log").read_text().split()
    assert log[-3:] == ["-slow", "+shaky", "-shaky"] and log.count("-shaky") == 2


def test_a_file_says_how_many_run_beside_it(tmp_path: Path) -> None:
    names = ["alone.test", "heavy_a.test", "heavy_b.test", "c.test", "d.test", "e.test"]
    done = run_rostests(tmp_path, {name: 0 for name in names}, "R4H_ROSTEST_PLACES=4")
    assert "rostest: 6 passed, 0 failed" in done.stdout
    log = (tmp_path / "log").read_text().split()
    assert log[-2:] == ["+alone", "-alone"] and set(log[:2]) == {"+heavy_a", "+heavy_b"}
    running: Set[str] = set()
    most = 0
    for entry in log:
        running ^= {entry[1:]}
        places = sum({"alone": 4, "heavy": 2}.get(name.split("_")[0], 1) for name in running)
        assert places <= 4, log
        most = max(most, len(running))
    assert most == 3


def test_pytest_runs_beside_the_rostests_but_not_beside_those_that_run_alone(tmp_path: Path) -> None:
    # As it does before it repeats what has failed, it waits until no rostest runs any more.
    done = run_rostests(tmp_path, {"alone.test": 0, "c.test": 0}, """log=$2/log; layer_pytest() {
        echo +pytest >>"$log"; while [ -e "$R4H_TMP/beside" ]; do sleep 0.05; done
        echo -pytest >>"$log"; add_counts $'3\\t0\\t0'; }""", "pytest rostest")
    assert (tmp_path / "log").read_text().split()[-4:] == ["-c", "-pytest", "+alone", "-alone"]
    assert "pytest: 3 passed, 0 failed" in done.stdout and results.print_table(tmp_path / "table") == (5, 0)


def test_a_layer_beside_the_rostests_that_breaks_off_has_failed(tmp_path: Path) -> None:
    run_rostests(tmp_path, {"c.test": 0}, "layer_pytest() { exit 1; }", "pytest rostest")
    assert results.print_table(tmp_path / "table") == (1, 1)


def test_a_rostest_that_ends_without_a_result_has_failed(tmp_path: Path) -> None:
    done = run_rostests(tmp_path, {"c.test": 0}, "R4H_ROSTEST_REPEATS=0; run_rostest() { exit 3; }")
    assert "c.test ended without a result" in done.stdout and "rostest: 0 passed, 1 failed" in done.stdout


def test_rostests_are_not_repeated_where_many_fail(tmp_path: Path) -> None:
    done = run_rostests(tmp_path, {"a.test": 1, "b.test": 1}, "R4H_ROSTEST_REPEATS=1")
    assert "rostest: 0 passed, 2 failed, 0 skipped" in done.stdout


# A test that fails in the first process that runs it, one that always fails, one that always passes.
CASES_PY = """
    from pathlib import Path

    def test_good():
        pass

    def test_shaky():
        mark = Path(__file__).with_name("mark")
        if not mark.exists():
            mark.touch()
            raise ValueError("the first time")

    def test_bad():
        assert not %(bad)s, "always"
"""


def run_cases(directory: Path) -> "subprocess.CompletedProcess[str]":
    """Run the tests in directory/cases as a layer."""
    return run_layers(directory, "R4H_SYSTEM_PYTHON={0}; layer_cases() {{ run_pytest cases {0} {1}/cases; }}; "
                                 "run_layer cases".format(sys.executable, directory))


@pytest.mark.slow("starts pytest with its workers")
@pytest.mark.parametrize("bad", [False, True])
def test_pytest_cases_that_failed_are_run_once_more(tmp_path: Path, bad: bool) -> None:
    _write(tmp_path / "cases" / "test_cases.py", textwrap.dedent(CASES_PY) % {"bad": bad})
    done = run_cases(tmp_path)
    assert "cases: %d passed, %d failed, 0 skipped" % (3 - bad, bad) in done.stdout
    assert (tmp_path / "second").read_text().split(": ")[1:] == ["ValueError", "the first time\n"]


@pytest.mark.slow("starts pytest with its workers")
def test_a_broken_run_of_pytest_fails_although_no_case_did(tmp_path: Path) -> None:
    _write(tmp_path / "cases" / "test_cases.py", "import os\n\ndef test_end():\n    os._exit(3)\n")
    done = run_cases(tmp_path)
    assert "cases: 0 passed, 1 failed" in done.stdout


def test_second_file_counts_only_where_it_says_passed(tmp_path: Path) -> None:
    first = _write(tmp_path / "a.xml", CASES)
    other = _write(tmp_path / "b.xml", '<testsuite><testcase classname="a" name="broken"/></testsuite>')
    counts = results.count_twice(first, other)
    assert counts[:3] == (2, 1, 1) and counts.second == ("a.broken: Traceback",)
    _write(other, '<testsuite><testcase classname="a" name="bad"><skipped/></testcase></testsuite>')
    assert results.count_twice(first, other)[:3] == (1, 2, 1)
    assert results.count_twice(first, tmp_path / "missing.xml")[:3] == (1, 2, 1)


def test_failed_cases_are_called_by_their_node_ids(tmp_path: Path) -> None:
    path = _write(tmp_path / "r.xml", """<testsuite>
      <testcase classname="r.p.test_a" name="good" file="r/p/test_a.py"/>
      <testcase classname="r.p.test_a" name="bad[1::2-x]" file="r/p/test_a.py"><failure/></testcase>
      <testcase classname="r.p.test_a.TestB" name="bad" file="r/p/test_a.py"><error/></testcase>
      <testcase classname="" name="gw1"><error>Different tests were collected</error></testcase></testsuite>""")
    assert results.failed_ids(path, Path("/w")) == ["/w/r/p/test_a.py::bad[1::2-x]", "/w/r/p/test_a.py::TestB::bad"]


def test_the_last_line_tells_what_passed_only_the_second_time(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    table = _write(tmp_path / "t", "rostest\t5\t0\t0\t1.0\t\n")
    assert results.main(["table", str(table), str(tmp_path / "second")]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "5 passed, 0 failed"
    second = _write(tmp_path / "second", "faces.test: no face\n")
    assert results.main(["table", str(table), str(second)]) == 0
    assert capsys.readouterr().out.splitlines()[-2:] == [
        "passed only the second time, alone: faces.test: no face",
        "5 passed, 0 failed (1 only the second time, alone)"]
    _write(table, "rostest\t5\t1\t0\t1.0\t\n")
    assert results.main(["table", str(table), str(second)]) == 1
