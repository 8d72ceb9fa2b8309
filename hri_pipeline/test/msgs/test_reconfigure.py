"""A parameter table as dynamic_reconfigure describes it, read with the package's own client side."""

from dataclasses import dataclass

import pytest
from dynamic_reconfigure.encoding import decode_config, decode_description, extract_params
from dynamic_reconfigure.msg import BoolParameter, Config, DoubleParameter, IntParameter, StrParameter

from hri_pipeline.core import parameter_docs
from hri_pipeline.core.parameters import ParameterTable, Settings, parameter
from hri_pipeline.ros.reconfigure import config_of, describe, values_of


@dataclass(frozen=True)
class NodeSettings(Settings):
    """A node."""

    rate: float = parameter(15.0, "Most results\n  per second.", unit="Hz", minimum=1, maximum=60, live=True)
    people: int = parameter(3, "How many.", minimum=1, maximum=9, live=True)
    shown: bool = parameter(True, "Show them.", live=True)
    decay: str = parameter("slow", "How it 'falls'.", choices=("slow", "fast"), live=True)
    label: str = parameter("", "What to write.", live=True)
    file: str = parameter("", "Read at the start.")


TABLE = ParameterTable("node", NodeSettings)
TABLES = [table for _, table in parameter_docs.registered()]


def rows(table):
    return {row["name"]: row for row in extract_params(decode_description(describe(table)))}


def test_only_the_live_parameters_are_there_in_their_order():
    assert list(rows(TABLE)) == ["rate", "people", "shown", "decay", "label"]


def test_type_range_default_and_text():
    found = rows(TABLE)
    assert [(row["type"], row["min"], row["max"], row["default"]) for row in found.values()] == [
        ("double", 1.0, 60.0, 15.0), ("int", 1, 9, 3), ("bool", False, True, True), ("str", "", "", "slow"),
        ("str", "", "", "")]
    assert found["rate"]["description"] == "Most results per second. (Hz)"
    assert all(row["edit_method"] == "" for name, row in found.items() if name != "decay")


def test_choices_are_an_enumeration():
    # rqt_reconfigure and dynparam evaluate the text.
    enum = eval(rows(TABLE)["decay"]["edit_method"])
    assert [(choice["name"], choice["value"], choice["type"]) for choice in enum["enum"]] == [
        ("slow", "slow", "str"), ("fast", "fast", "str")]


def test_values_go_out_and_come_back():
    settings = TABLE.resolve({"rate": 2.0, "label": "x", "file": "y"})
    config = config_of(TABLE.live, vars(settings))
    assert values_of(config) == {"rate": 2.0, "people": 3, "shown": True, "decay": "slow", "label": "x"}
    decoded = decode_config(config, decode_description(describe(TABLE)))
    assert decoded["rate"] == 2.0 and decoded["groups"]["name"] == "Default"


def test_what_comes_in_is_what_the_table_checks():
    config = Config(bools=[BoolParameter("shown", False)], ints=[IntParameter("rate", 3)],
                    doubles=[DoubleParameter("rate", float("nan"))], strs=[StrParameter("decay", "fast")])
    assert set(values_of(config)) == {"shown", "rate", "decay"}


@pytest.mark.parametrize("table", [table for table in TABLES if table.live], ids=lambda table: table.node)
def test_tables_of_the_nodes(table):
    found = rows(table)
    assert set(found) == {parameter.name for parameter in table.live}
    for name, row in found.items():
        if row["type"] in ("int", "double"):
            assert row["min"] <= row["default"] <= row["max"] and abs(row["max"]) < 2 ** 31, name
    assert set(values_of(config_of(table.live, vars(table.settings())))) == set(found)


def test_the_nodes_that_users_tune_have_live_parameters():
    live = {table.node for table in TABLES if table.live}
    assert {"faces", "voices", "interactions", "face_body_matcher", "voice_matcher", "overlay"} <= live
