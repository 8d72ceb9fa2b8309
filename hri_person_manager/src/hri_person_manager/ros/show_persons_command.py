"""The show_persons command: a live table of the persons on the terminal."""

from __future__ import annotations

import argparse
import json
import logging
import os
import signal
import sys
import tempfile
import threading
import time
from types import FrameType
from typing import Optional, Sequence

import rosgraph
import rospy
from rosgraph.roslogging import RosStreamHandler

from hri_person_manager.core.persons_table import Redrawing, as_data, format_table
from hri_person_manager.ros.persons_watch import PersonsWatch
from hri_pipeline.ros.master_watch import MasterWatch
from hri_pipeline.ros.node import wait_for_master

NOBODY = 3
ONCE_S = 30.0
REDRAW_S = 0.5
SETTLE_S = 1.0      # after the first person was seen: latched values and a few images


def parse_arguments(arguments: Sequence[str], command: str = "show_persons") -> argparse.Namespace:
    """Parse the command line of what the user called; exits with code 2 and a clear line if it is wrong."""
    parser = argparse.ArgumentParser(
        prog=command, description="Show who is there: a live table of the persons on the ROS graph.",
        epilog="Exit code: 0 if a person was seen, %d if nobody was, 1 after an error." % NOBODY)
    parser.add_argument("--once", action="store_true",
                        help="print the table once, as soon as somebody is there, and end")
    parser.add_argument("--duration", type=_seconds, metavar="S",
                        help="end after so many seconds (with --once: wait for so long, default %.0f)" % ONCE_S)
    parser.add_argument("--period", type=_seconds, default=5.0, metavar="S",
                        help="seconds between two tables when the output is no terminal (default 5)")
    parser.add_argument("--json", metavar="FILE", help="write the last table into this file, as JSON")
    return parser.parse_args(list(arguments))


def run(arguments: Optional[Sequence[str]] = None, command: str = "show_persons") -> int:
    """Run the command and return its exit code; command: what the user called."""
    options = parse_arguments(rospy.myargv(sys.argv)[1:] if arguments is None else arguments, command)
    name = command.split()[0]
    # A shell script lets what it starts in the background ignore Ctrl-C.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    end = time.monotonic() + (options.duration or (ONCE_S if options.once else float("inf")))
    if not wait_for_master(name, end - time.monotonic()):
        return 1
    try:
        rospy.init_node(name, anonymous=True, disable_signals=True)
        signal.signal(signal.SIGTERM, _stop)
        return _look(options, end, name)
    except KeyboardInterrupt:
        return NOBODY
    finally:
        rospy.signal_shutdown("{} has ended".format(name))


def _look(options: argparse.Namespace, end: float, name: str) -> int:
    """Show the persons until `end` (monotonic time, s) or a signal; return the exit code. name: of the command."""
    if sys.stdout.isatty():
        _mute()
    watch, master = PersonsWatch(), MasterWatch()
    try:
        if options.once:
            _wait_for_somebody(watch, end)
            print(_table(watch, master), flush=True)
        else:
            _show(watch, master, end, options.period)
    except KeyboardInterrupt:
        pass
    finally:
        _end_quietly()
        last = as_data(watch.rows(), *watch.rates(), sorted(watch.seen))
        master.close()
        watch.close()
    try:
        if options.json:
            write_json(options.json, last)
    except OSError as error:
        print("%s: %s" % (name, error), file=sys.stderr)
        return 1
    return 0 if watch.seen else NOBODY


def _stop(number: int, frame: Optional[FrameType]) -> None:
    raise KeyboardInterrupt


def _mute() -> None:
    """Let ROS say nothing on the terminal, in the middle of the table; the log has it."""
    for handler in logging.getLogger("rosout").handlers:
        if isinstance(handler, RosStreamHandler):
            handler.setLevel(logging.CRITICAL + 1)


def _end_quietly() -> None:
    """Whoever is ended may have lost the master, and hears of it twice; closing must not be interrupted."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    _mute()


def write_json(path: str, data: object) -> None:
    """Write JSON so that the file is either complete or as it was; raises OSError."""
    directory = os.path.dirname(os.path.abspath(path))
    handle, draft = tempfile.mkstemp(dir=directory, suffix=".json")
    try:
        with os.fdopen(handle, "w") as stream:
            json.dump(data, stream, indent=1)
            stream.write("\n")
        os.replace(draft, path)
    except BaseException:
        os.unlink(draft)
        raise


def _show(watch: PersonsWatch, master: MasterWatch, end: float, period: float) -> None:
    """Print a table each period, on a terminal more often; the first as soon as somebody is seen, the last at the end."""
    drawing = Redrawing() if sys.stdout.isatty() else None
    printed, met = time.monotonic(), False
    while not rospy.is_shutdown():
        threading.Event().wait(max(0.0, min(REDRAW_S, period, end - time.monotonic())))
        now = time.monotonic()
        meets = not met and any((row.face or row.body) and row.position is not None and row.confidence >= 1.0
                                for row in watch.rows())
        if drawing is not None or meets or now >= end or now >= printed + period:
            text = _table(watch, master)
            sys.stdout.write(text + "\n\n" if drawing is None else drawing.draw(text, *_terminal_size()))
            sys.stdout.flush()
            printed, met = now, met or meets
        if now >= end:
            return


def _terminal_size() -> os.terminal_size:
    """Size (columns, lines) of the terminal of the output as it is now, 80 x 24 where that is not known."""
    try:
        columns, lines = os.get_terminal_size(sys.stdout.fileno())
    except OSError:
        columns = lines = 0
    return os.terminal_size((columns or 80, lines or 24))


def _wait_for_somebody(watch: PersonsWatch, end: float) -> None:
    while time.monotonic() < end and not rospy.is_shutdown():
        if watch.seen:
            threading.Event().wait(SETTLE_S)
            return
        threading.Event().wait(0.05)


def _table(watch: PersonsWatch, master: MasterWatch) -> str:
    note = "the ROS master at {} does not answer".format(rosgraph.get_master_uri()) if master.away else ""
    return format_table(watch.rows(), *watch.rates(), note)


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError("%r is no time in seconds above 0" % text)
    return value
