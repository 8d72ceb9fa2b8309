"""The live table and the match graph as text."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import pytest

from hri_person_manager.core.display import (
    CameraStatus,
    LiveDisplay,
    PersonRow,
    RateMeter,
    as_data,
    format_columns,
    format_table,
    graph_text,
)
from hri_person_manager.core.features import Kind, MatchNode
from hri_person_manager.core.persons import PersonState, Snapshot

ROW = PersonRow("anonymous_person_abcde", "fabcd", "", "", 1.0, (1.0, -2.5, 0.25), "map", 63.2)


class Terminal:
    """As much of a terminal as a table needs.

    Lines too long for it are wrapped, those that stand there too when it narrows.
    """

    def __init__(self, columns, lines=24):
        self.columns, self.lines = columns, lines
        self.rows, self.at = [""], 0

    def feed(self, text):
        for _, number, letter, word in re.findall("(\x1b\\[([0-9]*)([A-Z]))|([^\x1b\n]+|\n)", text):
            top = max(0, len(self.rows) - self.lines)
            if letter == "A":
                self.at = max(top, self.at - int(number))
            elif letter == "H":
                self.at = top
            elif letter == "K":
                self.rows[self.at] = ""
            elif letter == "J":
                self.rows[top if number == "2" else self.at:] = [""] * (self.at - top + 1 if number == "2" else 1)
            elif word == "\n":
                self.down()
            elif word:
                self.write(word)

    def write(self, word):
        while len(word) > self.columns:
            self.rows[self.at] = word[:self.columns]
            self.down()
            word = word[self.columns:]
        self.rows[self.at] = word + self.rows[self.at][len(word):]

    def down(self):
        self.at += 1
        if self.at == len(self.rows):
            self.rows.append("")

    def resize(self, columns, lines=24):
        before = sum(self.parts(row, columns) for row in self.rows[:self.at])
        self.rows = [row[i * columns:(i + 1) * columns] for row in self.rows for i in range(self.parts(row, columns))]
        self.columns, self.lines, self.at = columns, lines, before

    @staticmethod
    def parts(row, columns):
        return max(1, -(-len(row) // columns))


def test_the_table_has_one_line_per_person():
    text = format_table([ROW, PersonRow("ann", "", "", "", 0.0, None, "", None)], 14.96, 7.0)
    lines = text.split("\n")
    assert len(lines) == 4
    assert lines[1].split() == ["anonymous_person_abcde", "fabcd", "-", "-", "1.00", "1.00", "-2.50", "0.25", "map",
                                "63"]
    assert lines[2].split() == ["ann", "-", "-", "-", "-", "-", "-", "-"]
    assert lines[3] == "2 persons in view; faces found in 15.0 images/s, bodies in 7.0 images/s"
    assert "nobody yet" in format_table([], 0.0, 0.0)
    assert "no images arrive: why" in format_table([], 0.0, 0.0, nobody="no images arrive: why")


def test_who_is_only_heard_stands_below_and_is_no_further_person():
    rows = [PersonRow("aaa", "", "", "vabcd", 1.0, None, "", None), ROW, replace(ROW, id="zzz", face="", body="babcd")]
    lines = format_table(rows, 15.0, 7.0).split("\n")
    assert [line.split()[0] for line in lines[1:4]] == [ROW.id, "zzz", "aaa"]
    assert lines[4].startswith("2 persons in view, 1 voice; faces found")
    lost = replace(ROW, face="", body="", voice="")
    assert format_table([*rows[:1], lost], 0.0, 0.0).split("\n")[3].startswith("1 person in view, 1 voice; ")


def test_who_is_out_of_view_is_said_and_counted_apart():
    rows = [PersonRow("heard", "", "", "vabcd", 1.0, None, "", None), replace(ROW, id="aside", confidence=0.5),
            PersonRow("gone", "", "", "", None, (1.0, 2.0, 0.0), "map", 40.0), replace(ROW, id="seen")]
    lines = format_table(rows, 15.0, 7.0).split("\n")
    assert [line.split()[0] for line in lines[1:5]] == ["seen", "aside", "gone", "heard"]
    assert lines[3].split()[1:5] == ["-", "-", "-", "-"]
    assert lines[5].startswith("1 person in view, 2 out of view, 1 voice; faces found")


def test_columns_are_as_wide_as_their_longest_cell():
    assert format_columns([("id", "name"), ("longer", "x"), ("a", "")]) == "id      name\nlonger  x\na"


def test_columns_stand_below_each_other_with_names_of_all_scripts():
    """As a terminal shows them: letters of East Asia are two wide, accents and joiners of their own have no width."""
    lines = format_columns([("a", "NAME", "x"), ("b", "\u5c0f\u6797\u3000\u5065", "x"), ("c", "Noe\u0308l", "x"),
                            ("d", "\u0639\u0644\u06cc\u200c\u0631\u0636\u0627", "x")]).split("\n")
    assert [line.index("x") for line in lines] == [13, 9, 14, 14]


def test_who_has_no_place_yet_has_no_confidence_of_one():
    text = format_table([PersonRow("ann", "fabcd", "babcd", "", 1.0, None, "", None)], 15.0, 15.0)
    assert text.split("\n")[1].split() == ["ann", "fabcd", "babcd", "-", "-", "-", "-", "-"]


def test_a_note_stands_below_the_table():
    assert format_table([], 0.0, 0.0, "no master").split("\n")[1:] == [
        "nobody yet", "0 persons in view; faces found in 0.0 images/s, bodies in 0.0 images/s", "no master"]


def drawn(terminal, drawing, people):
    text = format_table([replace(ROW, id="person%d" % number) for number in range(people)], 15.0, 7.0)
    terminal.feed(drawing.draw(text, terminal.columns, terminal.lines))
    return [line[:terminal.columns].rstrip() for line in text.split("\n")]


@pytest.mark.parametrize("columns", [200, 105, 60, 20])
def test_a_table_stands_in_the_place_of_the_one_before(columns):
    terminal, drawing = Terminal(columns), LiveDisplay()
    terminal.feed("a line of whoever was here before\n")
    above = terminal.at
    for people in (0, 3, 1, 5, 2):
        lines = drawn(terminal, drawing, people)
        assert [row.rstrip() for row in terminal.rows[above:]] == lines + [""]
    assert "".join(terminal.rows[:above]) == "a line of whoever was here before"


def test_a_terminal_that_is_made_narrower_and_wider_again_shows_one_table():
    terminal, drawing = Terminal(120), LiveDisplay()
    for columns in (120, 60, 59, 130, 40):
        terminal.resize(columns)
        for _ in range(3):
            lines = drawn(terminal, drawing, 4)
        screen = "\n".join(terminal.rows[-terminal.lines:])
        assert screen.count("person ") == screen.count("faces ") == 1
        assert [row.rstrip() for row in terminal.rows[terminal.at - len(lines):terminal.at]] == lines


def test_more_people_than_lines_do_not_pile_up():
    terminal, drawing = Terminal(120, 10), LiveDisplay()
    for _ in range(3):
        drawn(terminal, drawing, 30)
    assert len(terminal.rows) == 10
    assert terminal.rows[0].startswith("person ") and "faces found in 15.0" in terminal.rows[-2]
    assert terminal.rows[-3] == "... and 24 lines more"


def test_data_can_be_written_as_json():
    gone = PersonRow("gone", "", "", "", None, (1.0, 2.0, 0.0), "map", 40.0)
    data = json.loads(json.dumps(as_data([ROW, gone], 15.0, 7.0, {ROW.id, "gone", "left", "before"})))
    assert data["persons"][0]["position"] == [1.0, -2.5, 0.25] and data["faces_per_second"] == 15.0
    assert [(person["id"], person["in_view"]) for person in data["persons"]] == [(ROW.id, True), ("gone", False)]
    assert data["persons_left"] == ["before", "left"]       # only who is not there any more


def test_the_rate_counts_images_not_features():
    meter = RateMeter()
    for image in range(60):
        for _ in range(5):
            meter.add(image / 15.0, 100.0 + image / 15.0)
    assert meter.rate(100.0 + 59 / 15.0) == pytest.approx(15.0)
    assert meter.rate(110.0) == 0.0


def test_nobody_is_there_and_no_images_are_two_things():
    words = CameraStatus()
    assert words.text(0.0) == "nobody yet"          # nobody tells of a camera
    words.update("hri_faces", False, "no publisher on /image", 1.0)
    words.update("hri_bodies", False, "no publisher on /image", 1.0)
    assert words.text(2.0) == "no images arrive: no publisher on /image"
    words.update("hri_bodies", True, "images come in", 3.0)
    assert words.text(3.0) == "nobody yet"          # one camera of several suffices
    words.update("hri_faces", False, "no publisher on /image", 7.5)
    assert words.text(8.5) == "no images arrive: no publisher on /image"      # hri_bodies has ended
    assert words.text(20.0) == "nobody yet"


def test_persons_features_and_matches_are_all_in_the_graph():
    snapshot = Snapshot((PersonState("ann", "f1", "b1", "", False, 1.0),
                         PersonState("bob", "", "", "", True, 0.0, "ann")), ("ann",), ("ann", "bob"))
    text = graph_text(snapshot, [(MatchNode(Kind.FACE, "f1"), MatchNode(Kind.BODY, "b1"), 0.9),
                                 (MatchNode(Kind.FACE, "f1"), MatchNode(Kind.BODY, "b2"), 0.3)], [("ann", "bob", 0.8)],
                      0.5)
    assert text.startswith("graph humans {") and text.endswith("}\n")
    assert "person_ann -- face_f1 [style=bold];" in text
    assert 'face_f1 -- body_b1 [label="0.90", style=solid];' in text
    assert 'face_f1 -- body_b2 [label="0.30", style=dotted];' in text
    assert 'person_ann -- person_bob [label="0.80", style=solid];' in text
    assert "alias of ann" in text and "body_b2 [shape=hexagon" in text
