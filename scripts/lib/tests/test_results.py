"""Counting of test results: what must never be taken for a success."""

from __future__ import annotations

import subprocess
from pathlib import Path

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
    start = 'R4H_NAME=test R4H_STEPS=1; . "$1/common.sh"; . "$1/layers.sh"; R4H_TABLE=$2/table; cd "$R4H_ROOT"; '
    return subprocess.run(["bash", "-euc", start + commands, "bash", str(LIB), str(directory)], check=True,
                          stdout=subprocess.PIPE,
                          universal_newlines=True)


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
