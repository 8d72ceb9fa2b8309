"""What the node and its recogniser processes say to each other through pipes: small binary messages.

A message is a header (mark, kind, length of the body) and a body; numbers are little-endian. Nothing in it is code, and
whatever does not look like a message is refused.
"""

from __future__ import annotations

import json
import math
import struct
from typing import Dict, List, NamedTuple, Tuple

_HEADER = struct.Struct("<HBxI")
_MARK = 0x5248
LONGEST_BODY = 1 << 20

# From the node.
CONFIGURE, START, AUDIO, END = 1, 2, 3, 4
# From the recogniser.
READY, FAILED, PROGRESS, PARTIAL, FINAL = 65, 66, 67, 68, 69
_KINDS = {CONFIGURE, START, AUDIO, END, READY, FAILED, PROGRESS, PARTIAL, FINAL}

_NUMBER = struct.Struct("<I")
_REPORT = struct.Struct("<IIff")


class PipeError(ValueError):
    """What came through the pipe is no message."""


class Report(NamedTuple):
    """PROGRESS, PARTIAL and FINAL: utterance number, samples of it that were worked on, and what came out.

    busy: s of processor time since the last report.
    """

    utterance: int
    samples: int
    confidence: float = 0.0
    busy: float = 0.0
    text: str = ""


def pack(kind: int, body: bytes = b"") -> bytes:
    """Return a message. Raises PipeError for a body that is too long."""
    if len(body) > LONGEST_BODY:
        raise PipeError("a message of {} bytes is too long, legal are {}".format(len(body), LONGEST_BODY))
    return _HEADER.pack(_MARK, kind, len(body)) + body


def pack_number(kind: int, number: int, rest: bytes = b"") -> bytes:
    """Return a message about the utterance `number` (START, AUDIO, END)."""
    return pack(kind, _NUMBER.pack(number) + rest)


def unpack_number(body: bytes) -> Tuple[int, bytes]:
    """Return the number of the utterance and the rest. Raises PipeError."""
    if len(body) < _NUMBER.size:
        raise PipeError("a message of {} bytes holds no number".format(len(body)))
    return _NUMBER.unpack_from(body)[0], body[_NUMBER.size:]


def pack_report(kind: int, report: Report) -> bytes:
    """Return a message of a report; text that is too long is cut."""
    text = report.text.encode("utf-8")[:LONGEST_BODY // 2]
    return pack(kind, _REPORT.pack(report.utterance, report.samples, report.confidence, report.busy) + text)


def unpack_report(body: bytes) -> Report:
    """Return the report of a body. Raises PipeError."""
    if len(body) < _REPORT.size:
        raise PipeError("a report of {} bytes is too short".format(len(body)))
    utterance, samples, confidence, busy = _REPORT.unpack_from(body)
    if not (math.isfinite(confidence) and math.isfinite(busy)):
        raise PipeError("a report holds numbers that are not finite")
    text = body[_REPORT.size:].decode("utf-8", "replace")
    return Report(utterance, samples, min(max(confidence, 0.0), 1.0), max(busy, 0.0), text)


def pack_fields(kind: int, fields: Dict[str, object]) -> bytes:
    """Return a message of named values (CONFIGURE, FAILED)."""
    return pack(kind, json.dumps(fields).encode("utf-8"))


def unpack_fields(body: bytes) -> Dict[str, object]:
    """Return named values. Raises PipeError."""
    try:
        fields = json.loads(body.decode("utf-8"))
    except ValueError as error:
        raise PipeError("a message is no JSON: {}".format(error)) from error
    if not isinstance(fields, dict):
        raise PipeError("a message holds no named values")
    return fields


class MessageReader:
    """Puts messages together from the bytes that a pipe gives."""

    def __init__(self) -> None:
        self._bytes = bytearray()

    def feed(self, data: bytes) -> List[Tuple[int, bytes]]:
        """Return the messages (kind, body) that `data` completes. Raises PipeError; after that nothing can follow."""
        self._bytes += data
        messages: List[Tuple[int, bytes]] = []
        while len(self._bytes) >= _HEADER.size:
            mark, kind, length = _HEADER.unpack_from(self._bytes)
            if mark != _MARK or kind not in _KINDS or length > LONGEST_BODY:
                raise PipeError("what came through the pipe is no message: {!r}".format(bytes(self._bytes[:16])))
            end = _HEADER.size + length
            if len(self._bytes) < end:
                break
            messages.append((kind, bytes(self._bytes[_HEADER.size:end])))
            del self._bytes[:end]
        return messages
