"""Parameter tables: types, ranges, messages, YAML and Markdown, and the files that must agree with them."""

from __future__ import annotations

import dataclasses
import math
import re
from dataclasses import dataclass
from typing import Sequence

import pytest

from hri_pipeline.core import parameter_docs
from hri_pipeline.core.parameters import (
    Parameter,
    ParameterError,
    ParameterTable,
    Settings,
    format_value,
    parameter,
    parameter_like,
    parameters_of,
)


@dataclass(frozen=True)
class NodeSettings(Settings):
    """Finds
    faces.

    More on that.
    """

    birth_delay: float = parameter(0.2, "Time before a face is published.", "s", 0, 10)
    tiles: int = parameter(2, "Tiles a side.", minimum=1, maximum=4)
    publish_tf: bool = parameter(True, "Send the frames.")
    model: str = parameter("", "Path of the model; empty for the default.")
    mode: str = parameter("video", "How images come | go.", choices=("video", "still"))
    providers: Sequence[str] = parameter(["cpu"], "Execution providers.", choices=("cpu", "cuda"))
    weights: Sequence[float] = parameter([0.5, 1e-5], "Weights.", maximum=1)


TABLE = ParameterTable("faces", NodeSettings)


def settings_of(*bases, **fields):
    """A class of settings; fields: name=(annotation, field)."""
    return dataclasses.make_dataclass("Made", [(name, *field) for name, field in fields.items()],
                                      bases=bases or (Settings,), frozen=True)


def table(node="faces", includes=(), **fields):
    return ParameterTable(node, settings_of(**fields), includes)


def test_defaults():
    values = TABLE.resolve({})
    assert vars(values) == {"birth_delay": 0.2, "tiles": 2, "publish_tf": True, "model": "", "mode": "video",
                            "providers": ["cpu"], "weights": [0.5, 1e-5]}


def test_given_values_in_the_type_of_the_default():
    values = TABLE.resolve({"birth_delay": 1, "providers": ("cuda", "cpu"), "weights": [1, 0.5], "mode": "still"})
    assert values.birth_delay == 1.0 and isinstance(values.birth_delay, float)
    assert values.providers == ["cuda", "cpu"] and values.weights == [1.0, 0.5]


def test_a_number_can_be_one_of_the_words():
    """YAML, and whoever calls roslaunch, makes a number of 90."""
    turn = Parameter("turn", "auto", "A turn.", choices=("auto", "0", "90"))
    assert [turn.check(given) for given in ("auto", "90", 90, 0)] == ["auto", "90", "90", "0"]
    for wrong in (45, False, 90.0):
        with pytest.raises(ParameterError, match='"auto", "0", "90"'):
            turn.check(wrong)


@pytest.mark.parametrize("given, frame", [("/map", "map"), ("map", "map"), ("", "")])
def test_a_frame_has_no_leading_slash(given, frame):
    """Older nodes name frames so; tf2 refuses it."""
    for name in ("reference_frame", "frame_id"):
        assert Parameter(name, "odom", "A frame.").check(given) == frame
    assert Parameter("store", "", "A file.").check("/map") == "/map"


def test_a_list_is_not_shared_with_the_table():
    TABLE.resolve({}).providers.append("cuda")
    assert TABLE.resolve({}).providers == NodeSettings().providers == ["cpu"]


@pytest.mark.parametrize("name, value, legal", [
    ("birth_delay", True, "0 to 10 s"),
    ("birth_delay", "1", "0 to 10 s"),
    ("birth_delay", -0.1, "0 to 10 s"),
    ("birth_delay", 10.1, "0 to 10 s"),
    ("birth_delay", math.nan, "0 to 10 s"),
    ("birth_delay", math.inf, "0 to 10 s"),
    ("birth_delay", [1.0], "0 to 10 s"),
    ("birth_delay", None, "0 to 10 s"),
    ("tiles", 2.0, "int, 1 to 4"),
    ("tiles", True, "int, 1 to 4"),
    ("tiles", 0, "int, 1 to 4"),
    ("publish_tf", 1, "bool"),
    ("publish_tf", "true", "bool"),
    ("model", 7, "string"),
    ("mode", "picture", 'one of "video", "still"'),
    ("providers", "cpu", "list of string"),
    ("providers", ["gpu"], 'one of "cpu", "cuda"'),
    ("weights", [0.5, 2.0], "1 and less"),
    ("weights", [True], "list of float"),
])
def test_refused_with_name_value_and_range(name, value, legal):
    with pytest.raises(ParameterError) as caught:
        TABLE.resolve({name: value})
    assert name in str(caught.value) and legal in str(caught.value) and "default" in str(caught.value)


def test_unknown_name():
    with pytest.raises(ParameterError, match=r"no parameter brith_delay \(did you mean birth_delay\?\); known: birth"):
        TABLE.resolve({"brith_delay": 1.0})
    with pytest.raises(ParameterError, match="faces has no parameter zzz; known"):
        TABLE.resolve({"zzz": 1.0})


@pytest.mark.parametrize("arguments", [
    dict(name="a b", default=1, doc="x"),
    dict(name="a", default=1, doc=" "),
    dict(name="a", default={}, doc="x"),
    dict(name="a", default=None, doc="x"),
    dict(name="a", default=5, doc="x", maximum=4),
    dict(name="a", default="x", doc="x", choices=("y",)),
    dict(name="a", default=[1, "x"], doc="x"),
])
def test_illegal_entries(arguments):
    with pytest.raises(ValueError):
        Parameter(**arguments)


def test_the_settings_are_frozen_and_made_with_their_defaults():
    assert TABLE.resolve({}) == NodeSettings()
    with pytest.raises(dataclasses.FrozenInstanceError):
        NodeSettings().tiles = 3


def test_the_same_name_in_two_bases():
    one, other = (settings_of(a=("int", parameter(number, "x"))) for number in (1, 2))
    with pytest.raises(ValueError, match="parameter a of Made is there twice"):
        parameters_of(settings_of(one, other))
    again = settings_of(one, other, a=("int", parameter_like(one, "a", " More.", default=3)))
    assert parameters_of(again) == (Parameter("a", 3, "x More."),)
    assert parameters_of(settings_of(settings_of(one), settings_of(one))) == (Parameter("a", 1, "x"),)


def test_the_order_is_that_of_the_bases_and_a_later_place_counts():
    def group(*bases, names="", **fields):
        return settings_of(*bases, **{name: ("int", parameter(1, "x")) for name in names}, **fields)

    def names(settings):
        return "".join(one.name for one in parameters_of(settings))

    first, second, third = group(names="ab"), group(names="c"), group(names="d")
    assert names(group(first, second, names="e", a=("int", parameter_like(first, "a", default=2)))) == "bcea"
    assert names(group(group(second, first), group(third, first))) == "cdab"


@pytest.mark.parametrize("kind, field, words", [
    ("int", parameter(1.0, "x"), "Made.a is annotated as int, and its default is of type float"),
    (int, parameter(True, "x"), "annotated as int, and its default is of type bool"),
    ("str", parameter([], "x"), "annotated as str, and its default is of type Sequence.str."),
    ("int", dataclasses.field(default=1), "Made.a is not a field made by parameter"),
])
def test_a_field_that_is_no_parameter_of_its_type(kind, field, words):
    with pytest.raises(ValueError, match=words):
        parameters_of(settings_of(a=(kind, field)))


def test_yaml_is_read_back_as_the_defaults():
    yaml = pytest.importorskip("yaml")      # comes with ROS; the Python 3.8 layer has none
    values = yaml.safe_load(TABLE.to_yaml())
    assert values == vars(TABLE.resolve({}))
    assert vars(TABLE.resolve(values)) == values


def test_yaml_tells_text_unit_range_and_default():
    text = TABLE.to_yaml()
    assert text.startswith("# Finds faces.\n# Written by")
    assert "# Time before a face is published.\n# float; 0 to 10; unit s; default 0.2\nbirth_delay: 0.2\n" in text


def test_a_parameter_of_the_whole_stack_counts_where_the_own_one_is_not_set():
    """So the file with the defaults must not set it."""
    yaml = pytest.importorskip("yaml")
    made = table(frame=("str", parameter("map", "Frame.", shared="/humans/frame")),
                 rate=("float", parameter(1.0, "Rate.")))
    assert yaml.safe_load(made.to_yaml()) == {"rate": 1.0}
    assert '# string; default "map"; where it is not set here, /humans/frame counts\n# frame: "map"\n' in made.to_yaml()
    assert "Frame. Unset: `/humans/frame`.\n" in made.to_markdown()


@pytest.mark.parametrize("value, text", [
    (True, "true"), (1, "1"), (1e-5, "1.0e-05"), (1e22, "1.0e+22"), (0.1, "0.1"), ("a: #b", '"a: #b"'), ([], "[]"),
    ([1, 2], "[1, 2]")])
def test_format(value, text):
    assert format_value(value) == text


def test_markdown():
    lines = TABLE.to_markdown("../x.yaml").splitlines()
    assert lines[:2] == ["Details: [x.yaml](../x.yaml).", ""]
    assert "- `~birth_delay` (`0.2` s, 0–10): Time before a face is published." in lines
    assert "- `~mode` (`\"video\"`, `\"still\"`): How images come | go." in lines
    assert "- `~providers` (`[\"cpu\"]` of `\"cpu\"`, `\"cuda\"`): Execution providers." in lines
    assert "- `~weights` (`[0.5, 1.0e-05]`, ≤1): Weights." in lines


@pytest.mark.parametrize("doc, line", [
    ("How long. Longer: calmer. 0: for ever; then it stays.", "How long. 0: for ever."),
    ("Name of it (a; b); larger is slower. Empty: none.", "Name of it (a; b). Empty: none."),
    ("What to do. fast: little; always. slow: much.", "What to do. fast: little. slow: much."),
    ("How it is done here: with care (mostly). More.", "How it is done here."),
    ("Type of it: a thing.", "Type of it: a thing."),
    ("`fast` does little; `slow` does much. More of it.", "`fast` does little. `slow` does much."),
])
def test_the_page_has_the_first_statement_and_what_special_values_mean(doc, line):
    made = table(how=("str", parameter("fast", doc, choices=("fast", "slow"))))
    assert made.to_markdown().endswith("): {}\n".format(line))


def test_the_page_leaves_out_what_stands_on_the_pages_of_the_included_nodes():
    def numbered(text, default=1):
        return "int", parameter(default, text)

    includes = [table("a", same=numbered("Same."), other=numbered("Other.")),
                table("b", same=numbered("Same."), other=numbered("Other.", 2))]
    both = table("both", includes, same=numbered("Same."), other=numbered("Other."), own=numbered("Own."))
    assert re.findall(r"`~(\w+)`", both.to_markdown()) == ["other", "own"]
    assert "same: 1" in both.to_yaml()


def test_files_are_written_compared_and_the_page_is_kept(tmp_path):
    yaml_path, doc_path = parameter_docs.files(tmp_path, "hri_pipeline", TABLE)
    assert [path.name for path in (yaml_path, doc_path)] == ["faces.yaml", "faces.md"]
    with pytest.raises(AssertionError, match="missing; run `rosrun hri_pipeline parameter_docs --write`"):
        parameter_docs.check(TABLE, yaml_path, doc_path)
    doc_path.parent.mkdir(parents=True)
    doc_path.write_text("# faces\n\n<!-- parameters:begin -->\nold\n<!-- parameters:end -->\n\n## After\n")
    assert parameter_docs.write(TABLE, yaml_path, doc_path) == [yaml_path, doc_path]
    parameter_docs.check(TABLE, yaml_path, doc_path)
    assert doc_path.read_text().endswith("<!-- parameters:end -->\n\n## After\n")
    assert parameter_docs.write(TABLE, yaml_path, doc_path) == []
    yaml_path.write_text(yaml_path.read_text().replace("0.2", "0.3"))
    doc_path.write_text(doc_path.read_text().replace("Send", "Sends"))
    assert len(parameter_docs.problems(TABLE, yaml_path, doc_path)) == 2


def test_a_page_without_markers_gets_them_at_its_end(tmp_path):
    page = tmp_path / "faces.md"
    page.write_text("# faces\n")
    assert "has no line" in parameter_docs.problems(TABLE, tmp_path / "x.yaml", page)[1]
    parameter_docs.write(TABLE, tmp_path / "x.yaml", page)
    assert page.read_text().startswith("# faces\n\n## Parameters\n\n<!-- parameters:begin -->\nDetails")


def test_every_table_of_this_package_is_found_and_has_its_own_node_name():
    nodes = [table.node for table in parameter_docs.tables("hri_pipeline")]
    assert len(set(nodes)) == len(nodes)
    assert parameter_docs.tables("no_such_package") == []
