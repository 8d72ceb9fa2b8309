"""Counting of test results: what must never be taken for a success."""

from __future__ import annotations

from pathlib import Path

import results

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
    _write(tmp_path / "p" / "rostest-x.xml", '<testsuite><testcase name="x"><failure message="time-limit"/></testcase></testsuite>')
    assert results.count_rostest(tmp_path, 1)[:2] == (1, 1)


def test_table_adds_up_and_an_empty_layer_fails(tmp_path: Path) -> None:
    table = _write(tmp_path / "t", "static\t5\t0\t0\t1.0\t\nrostest\t0\t0\t0\t0.1\t\npytest38\t0\t0\t0\t0.0\tno Python 3.8 here\n")
    assert results.print_table(table) == (5, 1)
