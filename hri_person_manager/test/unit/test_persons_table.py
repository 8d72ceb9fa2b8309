"""The table of persons as text and as data, and the rate meter."""

from __future__ import annotations

import json

import pytest

from hri_person_manager.core.persons_table import PersonRow, RateMeter, as_data, format_columns, format_table, redraw

ROW = PersonRow("anonymous_person_abcde", "fabcd", "", "", 1.0, (1.0, -2.5, 0.25), "map", 63.2)


def test_the_table_has_one_line_per_person():
    text = format_table([ROW, PersonRow("ann", "", "", "", 0.0, None, "", None)], 14.96, 7.0)
    lines = text.split("\n")
    assert len(lines) == 4
    assert lines[1].split() == ["anonymous_person_abcde", "fabcd", "-", "-", "1.00", "1.00", "-2.50", "0.25", "map", "63"]
    assert lines[2].split() == ["ann", "-", "-", "-", "0.00", "-", "-", "-"]
    assert lines[3] == "faces 15.0 images/s, bodies 7.0 images/s"
    assert "nobody yet" in format_table([], 0.0, 0.0)


def test_columns_are_as_wide_as_their_longest_cell():
    assert format_columns([("id", "name"), ("longer", "x"), ("a", "")]) == "id      name\nlonger  x\na"


def test_redrawing_goes_up_by_the_lines_that_are_there():
    assert redraw("a\nb", 0) == "\x1b[2Ka\n\x1b[2Kb\n\x1b[0J"
    assert redraw("a", 3).startswith("\x1b[3A")


def test_data_can_be_written_as_json():
    data = json.loads(json.dumps(as_data([ROW], 15.0, 7.0, ["ann", "abe"])))
    assert data["persons"][0]["position"] == [1.0, -2.5, 0.25]
    assert data["persons_seen"] == ["abe", "ann"] and data["faces_per_second"] == 15.0


def test_the_rate_counts_images_not_features():
    meter = RateMeter(2.0)
    for image in range(60):
        for _ in range(5):
            meter.add(image / 15.0, 100.0 + image / 15.0)
    assert meter.rate(100.0 + 59 / 15.0) == pytest.approx(15.0)
    assert meter.rate(110.0) == 0.0


def test_illegal_window():
    with pytest.raises(ValueError):
        RateMeter(0.0)
