"""Names and numbers out of the bytes of a TFMessage."""

from __future__ import annotations

import struct

import pytest

from hri_pipeline.core.tf_scan import RawTransform, read, scan


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
