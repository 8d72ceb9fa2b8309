"""Bytes of other people's messages, made from the table of layouts, are read by our definitions and sent back as they
came."""

import pytest
from wire_layouts import exchange, faults, read_layouts, serialise

LAYOUTS = read_layouts()


@pytest.mark.parametrize("name", sorted(LAYOUTS))
def test_bytes_are_read_and_come_back(name):
    assert exchange(name, LAYOUTS[name]) == ""


def test_the_table_holds_all_released_messages():
    assert len(LAYOUTS) == 17 and faults().keys() == LAYOUTS.keys()


def test_bytes_of_a_layout():
    data, values = serialise("Header (float32 uint8)[] string[]", 2)
    assert values == (1, 2, 3, "text 4", ((1.25, 6), (1.75, 8)), ("text 9", "text 10"))
    assert data[:12] == bytes([1, 0, 0, 0, 2, 0, 0, 0, 3, 0, 0, 0]) and len(data) == 12 + 10 + 4 + 10 + 4 + 10 + 11


@pytest.mark.parametrize("name, layout", [
    ("FacialLandmarks", "Header (float32 float32 float32)[70] uint32 uint32"),
    ("Skeleton2D", "Header (float32 float32 float32)[18]"),
    ("IdsMatch", "string uint8 string int8 float64"), ("Group", "Header string"), ("NoSuchMessage", "Header")])
def test_another_layout_is_noticed(name, layout):
    assert exchange(name, layout)


@pytest.mark.parametrize("layout", ["float33", "Header (float32", "float32  float32", "uint8[1"])
def test_what_is_no_layout(layout):
    with pytest.raises(ValueError, match="layout"):
        serialise(layout, 1)
