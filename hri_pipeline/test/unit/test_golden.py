"""Golden figures: reading them, comparing with them, and the command that does both."""

import json

import pytest
from scene_bag import SceneBag, upright

from hri_pipeline.score.bag import read_bag
from hri_pipeline.score.command import main, score
from hri_pipeline.score.metrics import (
    AS_GOOD,
    BETTER,
    MISSING,
    TOLD,
    WORSE,
    Golden,
    GoldenError,
    compare,
    comparison_table,
    load_golden,
)

BASE = 1000.0


@pytest.mark.parametrize("better, value, verdict", [
    ("higher", 0.9, AS_GOOD), ("higher", 0.86, AS_GOOD), ("higher", 0.84, WORSE), ("higher", 0.96, BETTER),
    ("lower", 0.9, AS_GOOD), ("lower", 0.94, AS_GOOD), ("lower", 0.96, WORSE), ("lower", 0.84, BETTER),
    ("same", 0.94, AS_GOOD), ("same", 0.84, WORSE), ("same", 0.96, WORSE), ("told", 55.0, TOLD), ("told", None, TOLD),
    ("higher", None, MISSING), ("lower", float("nan"), MISSING)])
def test_verdicts(better, value, verdict):
    outcome, = compare({"f1": value}, [Golden("f1", 0.9, better, 0.05)])
    assert outcome.verdict == verdict and outcome.failed == (verdict in (WORSE, MISSING))


def test_without_a_tolerance_the_same_is_as_good():
    assert compare({"a": 3}, [Golden("a", 3.0, "same")])[0].verdict == AS_GOOD
    assert compare({"a": 2}, [Golden("a", 3.0, "higher")])[0].verdict == WORSE


def test_figures_in_lists_have_dotted_names():
    figures = {"curve": [{"error": 0.1}, {"error": 0.3}], "deep": {"in": {"it": True}}}
    outcomes = compare(figures, [Golden("curve.1.error", 0.3, "lower"), Golden("deep.in.it", 1.0, "same"),
                                 Golden("curve.2.error", 0.3, "lower")])
    assert [one.verdict for one in outcomes] == [AS_GOOD, AS_GOOD, MISSING]


def test_the_table_names_what_is_worse_and_what_is_better():
    text = comparison_table(compare({"a": 1.0, "b": 9.0}, [Golden("a", 2.0, "higher"), Golden("b", 2.0, "higher"),
                                                           Golden("c", 2.0, "lower")]))
    assert "WORSE" in text and "MISSING" in text and "2 of 3 figures" in text and text.endswith("raised: b")
    assert "No figure is worse" in comparison_table(compare({"a": 2.0}, [Golden("a", 2.0, "higher")]))


@pytest.mark.parametrize("text, complaint", [
    ("", "mapping of sections"), ("a: [", "a: \\["), ("one: {}\ntwo: {}", "name a section; sections: one, two"),
    ("one: 3", "mapping of figures"), ("one: {f1: 0.9}", "one, f1: value and better"),
    ("one: {f1: {value: 0.9, better: higher, tolerence: 1}}", "and nothing else"),
    ("one: {f1: {value: 0.9, better: more}}", "better is 'more', legal: higher"),
    ("one: {f1: {value: yes, better: higher}}", "value is True, a finite number"),
    ("one: {f1: {value: .nan, better: higher}}", "value is nan"),
    ("one: {f1: {value: 1, better: higher, tolerance: -1}}", "tolerance is -1")])
def test_files_that_are_not_to_be_used(tmp_path, text, complaint):
    path = tmp_path / "golden.yaml"
    path.write_text(text, encoding="utf-8")
    if complaint.startswith("a: "):
        complaint = "golden.yaml"
    with pytest.raises(GoldenError, match=complaint):
        load_golden(path)


def test_a_section_that_is_not_there(tmp_path):
    path = tmp_path / "golden.yaml"
    path.write_text("one: {f1: {value: 1, better: higher}}", encoding="utf-8")
    assert load_golden(path) == load_golden(path, "one") == [Golden("f1", 1.0, "higher", 0.0)]
    with pytest.raises(GoldenError, match="no section 'two'; sections: one"):
        load_golden(path, "two")
    with pytest.raises(GoldenError, match=r"none\.yaml"):
        load_golden(tmp_path / "none.yaml")


def write(path, words=("go forward", "stop"), heard=(("v1", "go"), ("v1", "go forward"), ("v2", "stop now")),
          faces=(2, 2, 3)):
    """A bag with counted faces, two in the first half and three in the second, and sentences."""
    with SceneBag(path) as bag:
        for number in range(40):
            stamp = BASE + 0.1 * number
            bag.ids("/scene/truth/faces", ["a", "b"] if number < 20 else ["a", "b", "c"], stamp)
            count = faces[0] if number < 10 else faces[1] if number < 30 else faces[2]
            bag.ids("/humans/faces/tracked", ["f%d" % face for face in range(count)], stamp)
        for text in words:
            bag.text("/scene/truth/words", text, BASE)
        for number, (voice, text) in enumerate(heard):
            bag.text("/humans/voices/{}/speech".format(voice), text, BASE + number)
        bag.transforms("/tf", [("map", "person_p", upright((1.0, 0.0, 1.0)))], BASE)
    return path


def test_faces_that_are_counted(tmp_path):
    figures = score(read_bag(write(tmp_path / "a.bag")))
    assert (figures["faces_true"], figures["faces_missed"], figures["faces_extra"],
            figures["faces_ids"]) == (5, 0, 0, 3)
    figures = score(read_bag(write(tmp_path / "b.bag", faces=(1, 1, 4))))
    assert (figures["faces_missed"], figures["faces_extra"]) == (1, 1)
    assert figures["has_truth"] and "bodies_true" not in figures


def test_words_that_are_heard(tmp_path):
    figures = score(read_bag(write(tmp_path / "a.bag")))
    assert (figures["words_true"], figures["words_heard"], figures["word_errors"]) == (3, 4, 1)
    assert (figures["sentences_true"], figures["sentences_heard"]) == (2, 2)
    figures = score(read_bag(write(tmp_path / "b.bag", heard=(("v1", "go forward"), ("v1", "")))))
    assert (figures["word_errors"], figures["word_error_rate"], figures["sentences_heard"]) == (3, 1.0, 0)


def test_the_command(tmp_path, capsys):
    bag, golden = str(write(tmp_path / "a.bag")), tmp_path / "golden.yaml"
    golden.write_text("sound: {word_errors: {value: 1, better: lower}}\nall: {faces_missed: {value: -1, better: "
                      "lower}}", encoding="utf-8")
    assert main([bag, "--golden", str(golden), "--section", "sound"]) == 0
    assert "No figure is worse" in capsys.readouterr().out
    assert main([bag, "--golden", str(golden), "--section", "all", "--json"]) == 3
    compared = json.loads(capsys.readouterr().out)["golden"]
    assert compared == [{"figure": "faces_missed", "golden": -1.0, "now": 0.0, "verdict": "WORSE"}]
    assert main([bag, "--golden", str(golden)]) == 1
    assert "name a section" in capsys.readouterr().err
