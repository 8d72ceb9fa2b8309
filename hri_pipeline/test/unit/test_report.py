"""A recording as a page: what is in it, and its numbers."""

import pytest
from scene_bag import BASE

from hri_pipeline.core.geometry import Pose
from hri_pipeline.score.bag import BagWriter, Record, read_bag
from hri_pipeline.score.report import gaze_shares, main, page, spans, speech_spans


@pytest.fixture
def bag(tmp_path):
    """Ten seconds: anna all the time, <b> the first half; anna looks at the robot half of the time and speaks once."""
    path = tmp_path / "evening.bag"
    with BagWriter(path) as writer:
        for number in range(101):
            stamp = BASE + 0.1 * number
            writer.ids("/humans/persons/tracked", ["anna", "b"] if number < 50 else ["anna"], stamp)
            writer.gaze("/humans/interactions/gaze", [("anna", "")] if number < 50 else [], stamp)
            writer.groups("/humans/interactions/groups", [{"anna", "b"}] if number < 50 else [], stamp)
            place = Pose.from_quaternion((0.0, 0.0, 0.0, 1.0), (1.0 + 0.01 * number, 0.5, 1.6))
            writer.transforms("/tf", [("map", "person_anna", place)], stamp)
        writer.number("/humans/persons/anna/location_confidence", 1.0, BASE)
        writer.flag("/humans/voices/v/is_speaking", True, BASE + 2.0)
        writer.text("/humans/voices/v/speech", "<script>hello", BASE + 3.5)
        writer.flag("/humans/voices/v/is_speaking", False, BASE + 4.0)
    return path


def test_what_lasts_how_long(bag):
    record = read_bag(bag)
    people = {span.row: span.end - span.begin for span in spans(record.tracked, record.end)}
    assert people == {"anna": pytest.approx(10.0, abs=0.1), "b": pytest.approx(5.0, abs=0.11)}
    assert gaze_shares(record) == {("anna", ""): pytest.approx(0.5, abs=0.02)}
    spoken, = speech_spans(record)
    assert (spoken.row, spoken.text) == ("v", "<script>hello") and spoken.end - spoken.begin == pytest.approx(2.0)


def test_somebody_who_comes_back_has_two_spans():
    found = spans([(0.0, ["a"]), (1.0, []), (2.0, ["a"]), (2.5, ["a"])], 3.0)
    assert [(span.begin, span.end) for span in found] == [(0.0, 1.0), (2.0, 3.0)]


def test_the_page_holds_all_plots_and_escapes_what_was_said(bag, tmp_path, capsys):
    assert main([str(bag)]) == 0
    text = (tmp_path / "evening.html").read_text()
    assert capsys.readouterr().out.strip() == str(tmp_path / "evening.html")
    for heading in ("People", "Places from above", "Who looks at whom", "Groups", "Speech", "Location confidence"):
        assert "<h2>{}</h2>".format(heading) in text
    assert "nothing in the recording" not in text
    assert "anna + b" in text and "&lt;script&gt;hello" in text and "<script" not in text
    assert "http" not in text, "nothing comes from the network"


def test_people_have_their_names_and_what_they_said_and_ids_of_a_moment_are_counted_only(tmp_path):
    with BagWriter(tmp_path / "names.bag") as writer:
        for number in range(101):
            stamp = BASE + 0.1 * number
            writer.ids("/humans/persons/tracked", ["p1"] + ["anonymous_person_blip1"] * (40 <= number < 50), stamp)
            writer.groups("/humans/interactions/groups", [{"p1", ""}], stamp)
        writer.text("/humans/persons/p1/name", "Ada <3", BASE)
        for voice, begin in (("vabcd", 2.0), ("vefgh", 6.0)):
            writer.text("/humans/persons/p1/voice_id", voice, BASE + begin)
            writer.flag("/humans/voices/{}/is_speaking".format(voice), True, BASE + begin)
            writer.text("/humans/voices/{}/speech".format(voice), "words of " + voice, BASE + begin + 1.0)
            writer.flag("/humans/voices/{}/is_speaking".format(voice), False, BASE + begin + 1.0)
        writer.flag("/humans/voices/vnone/is_speaking", True, BASE + 8.0)
        writer.flag("/humans/voices/vnone/is_speaking", False, BASE + 9.0)
    text = page(read_bag(tmp_path / "names.bag"), "names")
    people, _, _, groups, speech, _ = (part.split("</h2>")[1] for part in text.split("<h2>")[1:])
    assert "Ada &lt;3" in people and "Ada &lt;3 + robot" in groups and "blip" not in text and "p1" not in text
    assert speech.count("<text x='4'") == 2, "one row of Ada, one of the voice of nobody"
    assert "0:02.0 Ada &lt;3: words of vabcd" in speech and "voice vnone" in speech
    assert "At most 2 at a time, 2 ids, 1 of them not shown" in text


@pytest.mark.parametrize("seconds, told", [(0.04, "0:00.0"), (59.93, "0:59.9"), (59.97, "1:00.0"), (3725.2, "62:05.2")])
def test_when_something_was_said_is_in_minutes_and_seconds(seconds, told):
    record = Record(BASE, BASE + 4000.0, speaking={"v": [(BASE + seconds, True)]},
                    texts=[(BASE + seconds, "v", "hello")])
    assert "<li>{} voice v: hello</li>".format(told) in page(record, "said")


def test_an_empty_recording_says_so(tmp_path):
    with BagWriter(tmp_path / "empty.bag") as writer:
        writer.ids("/humans/persons/tracked", [], BASE)
    assert page(read_bag(tmp_path / "empty.bag"), "empty").count("nothing in the recording") == 6


def test_what_is_no_bag_is_told(tmp_path, capsys):
    assert main([str(tmp_path / "absent.bag")]) == 1
    assert "no such bag" in capsys.readouterr().err
