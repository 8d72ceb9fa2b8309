"""How long it takes from the command to people: the demonstration on a machine where all is installed."""

from __future__ import annotations

import re
import signal
import subprocess
import threading
import time
from pathlib import Path
from typing import List, Optional, Tuple

ROOT = Path(__file__).resolve().parent.parent.parent
# A row of the demonstration's table: id, face, body, voice, confidence, with a face or body seen now.
_PERSON = re.compile(r"^\S+ +(?:\w+ +\S+|- +\w+) +\S+ +1\.00 ")


def shows_a_person(line: str) -> bool:
    """Tell whether a line of the demonstration is the row of a person who is seen now."""
    return _PERSON.match(line) is not None


def second_run(limit: float = 180.0) -> Tuple[Optional[float], str]:
    """Return s from starting scripts/demo to the first person in its table, else None, and the reason for that."""
    began = time.monotonic()
    demo = subprocess.Popen([str(ROOT / "scripts" / "demo"), "--no-rviz", "--seconds", str(int(limit))], text=True,
                            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL)
    assert demo.stdout is not None
    lines: List[str] = []
    found: Optional[float] = None
    timer = threading.Timer(limit, demo.send_signal, (signal.SIGINT,))
    timer.start()
    try:
        for line in demo.stdout:
            lines.append(line.strip())
            if shows_a_person(line):
                found = time.monotonic() - began
                break
    finally:
        timer.cancel()
        demo.send_signal(signal.SIGINT)
        demo.stdout.read()
        demo.wait(60.0)
    return found, "" if found is not None else "nobody appeared: " + " | ".join(lines[-3:])
