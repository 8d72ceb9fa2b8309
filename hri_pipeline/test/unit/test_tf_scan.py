"""Names and numbers out of the bytes of a TFMessage."""

from __future__ import annotations

import struct

import pytest

from hri_pipeline.core.tf_scan import RawTransform, read, read_stamp, scan


def packed(*transforms):
    """Serialise transforms as the message's definition says."""
    data = struct.pack("<I", len(transforms))
    for transform in transforms:
        data += struct.pack("<III", 7, transform.secs, transform.nsecs)
        for name in (transform.parent, transform.child):
            text = name.encode()
            data += struct.pack("<I", len(text)) + text
        data += struct.pack("<7d", *transform.translation, *transform.rotation)
    return data


HEAD = RawTransform("neck_abcde", "head_abcde", 12, 500000000, (0.1, 0.2, 0.3), (0.0, 0.0, 0.6, 0.8))
LONG = RawTransform("map", "x" * 300, 1, 2, (1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0))


def test_all_frames_are_named_and_read():
    data = packed(HEAD, LONG, HEAD)
    frames = scan(data)
    assert [name for name, _ in frames] == [b"head_abcde", b"x" * 300, b"head_abcde"]
    assert [read(data, offset) for _, offset in frames] == [HEAD, LONG, HEAD]
    assert read(data, frames[0][1]).stamp == 12.5
    assert scan(packed()) == []


def test_a_leading_slash_is_dropped():
    data = packed(HEAD._replace(parent="/neck", child="/head"))
    assert read(data, scan(data)[0][1])[:2] == ("neck", "head")


@pytest.mark.parametrize("data", [
    b"", b"\x01", packed(HEAD)[:-1], packed(HEAD) + b"\0", struct.pack("<I", 2 ** 32 - 1),
    struct.pack("<I", 1) + b"\xff" * 200])
def test_what_is_no_message_is_refused(data):
    with pytest.raises(ValueError):
        scan(data)


@pytest.mark.parametrize("secs, nsecs", [(2 ** 31 - 1, 0), (2 ** 32 - 1, 2 ** 32 - 1), (12, 10 ** 9)])
def test_a_stamp_that_is_none_is_refused(secs, nsecs):
    data = packed(HEAD._replace(secs=secs, nsecs=nsecs))
    for reader in (read, read_stamp):
        with pytest.raises(ValueError, match="no time"):
            reader(data, scan(data)[0][1])


@pytest.mark.parametrize("secs, nsecs", [(0, 0), (2 ** 31 - 2, 999999999)])
def test_the_first_and_the_last_stamp(secs, nsecs):
    data = packed(HEAD._replace(secs=secs, nsecs=nsecs))
    assert read_stamp(data, 4) == (secs, nsecs)
    assert read(data, 4) == HEAD._replace(secs=secs, nsecs=nsecs)


@pytest.mark.parametrize("numbers, is_pose", [
    ({}, True), ({"rotation": (0.0, 0.0, 3.0, 4.0)}, True), ({"rotation": (0.0,) * 4}, False),
    ({"rotation": (0.0, 0.0, 0.0, float("nan"))}, False), ({"rotation": (1e200, 0.0, 0.0, 1e200)}, False),
    ({"translation": (0.0, float("inf"), 0.0)}, False), ({"translation": (float("nan"), 0.0, 0.0)}, False)])
def test_numbers_that_are_a_pose(numbers, is_pose):
    assert HEAD._replace(**numbers).is_pose is is_pose
