"""Whether others read the bytes of our messages, and we read theirs: bytes made from a table of layouts, not from our
definitions."""

from __future__ import annotations

import io
import itertools
import re
import struct
from pathlib import Path
from typing import Dict, Iterator, List, Optional, Sequence, Tuple

import genpy
import roslib.message

from hri_pipeline.score.bag import message_directory

LENGTHS = (0, 3, 70)
"""Of the arrays in the messages that are exchanged."""
_HEADER = "uint32 uint32 uint32 string"
_FORMATS = {"uint8": "<B", "int8": "<b", "uint32": "<I", "float32": "<f", "float64": "<d"}
_FIELD = re.compile(r"(?:\(([^)]*)\)|(\w+))(\[(\d*)\])?(?: |$)")


def table_file() -> Path:
    """Return the table of hri_msgs. Raises FileNotFoundError where hri_msgs is not installed."""
    return message_directory().parent / "test" / "msgs" / "wire_layouts.txt"


def read_layouts(path: Optional[Path] = None) -> Dict[str, str]:
    """Return the layout of each message by its name, as a table (that of hri_msgs) has it."""
    lines = (path or table_file()).read_text(encoding="utf-8").splitlines()
    return dict(line.split(": ", 1) for line in lines if line and not line.startswith("#"))


def serialise(layout: str, length: int) -> Tuple[bytes, Tuple[object, ...]]:
    """Return the bytes of a message and its values (1, 2, 3 ...) in their order. length: of the arrays of any length.

    What stands in a message that stands in this one counts as its own, an array is a tuple. Raises ValueError for a
    layout that is none.
    """
    numbers, data, values = itertools.count(1), io.BytesIO(), []    # type: Iterator[int], io.BytesIO, List[object]
    for types, is_array, fixed in _fields(layout):
        if not is_array:
            values += _write(data, types, numbers)
            continue
        if fixed is None:
            data.write(struct.pack("<I", length))
        items = [_write(data, types, numbers) for _ in range(length if fixed is None else fixed)]
        values.append(tuple(item[0] if len(types) == 1 else tuple(item) for item in items))
    return data.getvalue(), tuple(values)


def exchange(name: str, layout: str) -> str:
    """Read a message of this layout as our hri_msgs/NAME and send it back; return what is wrong, in words, or
    nothing."""
    kind = roslib.message.get_message_class("hri_msgs/" + name)
    if kind is None:
        return "there is no such message"
    for length in LENGTHS:
        data, values = serialise(layout, length)
        try:
            message = kind().deserialize(data)
            back = io.BytesIO()
            message.serialize(back)
        except genpy.MessageException as error:
            return "with {} in each array: {}".format(length, error)
        if tuple(_values(message)) != values:
            return "with {} in each array: {} is read as {}".format(length, values, tuple(_values(message)))[:300]
        if back.getvalue() != data:
            return "with {} in each array: {} bytes come back as other {}".format(
                length, len(data), len(back.getvalue())
            )
    return ""


def faults(path: Optional[Path] = None) -> Dict[str, str]:
    """Return what is wrong, or nothing, for each message of a table (that of hri_msgs)."""
    return {name: exchange(name, layout) for name, layout in read_layouts(path).items()}


def _fields(layout: str) -> List[Tuple[Sequence[str], bool, Optional[int]]]:
    """Return types, whether it is an array, and its length where that is fixed, of each field."""
    text, end = layout.replace("Header", _HEADER), 0
    found = []
    for match in _FIELD.finditer(text):
        if match.start() != end:
            break
        types = (match.group(1) or match.group(2)).split()
        found.append((types, match.group(3) is not None, int(match.group(4)) if match.group(4) else None))
        end = match.end()
    if end != len(text):
        raise ValueError("{!r} is no layout from {!r} on".format(layout, text[end:]))
    return found


def _write(data: io.BytesIO, types: Sequence[str], numbers: Iterator[int]) -> List[object]:
    """Append values of these types and return them; they fit in a byte, and a quarter of them in 32 bits."""
    values: List[object] = []
    for kind, number in zip(types, numbers):
        number %= 100
        if kind == "string":
            text = "text {}".format(number)
            data.write(struct.pack("<I", len(text)) + text.encode())
            values.append(text)
            continue
        if kind not in _FORMATS:
            raise ValueError("a layout has no type {!r}".format(kind))
        value = number / 4.0 if kind.startswith("float") else number
        data.write(struct.pack(_FORMATS[kind], value))
        values.append(value)
    return values


def _values(message: genpy.Message) -> Iterator[object]:
    """Values of a message as `serialise` has them."""
    for slot in message.__slots__:
        value = getattr(message, slot)
        if isinstance(value, genpy.Message):
            yield from _values(value)
        elif isinstance(value, genpy.TVal):
            yield from (value.secs, value.nsecs)
        elif isinstance(value, (list, tuple)):
            yield tuple(tuple(_values(item)) if isinstance(item, genpy.Message) else item for item in value)
        else:
            yield value
