"""The show_persons command: a live table of the persons on the terminal."""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import threading
import time
from typing import Optional, Sequence

import rospy

from hri_person_manager.core.persons_table import as_data, format_table, redraw
from hri_person_manager.ros.persons_watch import PersonsWatch
from hri_pipeline.ros.node import wait_for_master

NOBODY = 3
REDRAW_S = 0.5
SETTLE_S = 1.0      # after the first person was seen: latched values and a few images


def parse_arguments(arguments: Sequence[str]) -> argparse.Namespace:
    """Parse the command line; exits with code 2 and a clear line if it is wrong."""
    parser = argparse.ArgumentParser(
        prog="show_persons", description="Show who is there: a live table of the persons on the ROS graph.",
        epilog="Exit code: 0 if a person was seen, %d if nobody was, 1 after an error." % NOBODY)
    parser.add_argument("--once", action="store_true",
                        help="print the table once, as soon as somebody is there, and end")
    parser.add_argument("--duration", type=_seconds, metavar="S",
                        help="end after so many seconds (with --once: wait for so long, default 30)")
    parser.add_argument("--period", type=_seconds, default=5.0, metavar="S",
                        help="seconds between two tables when the output is no terminal (default 5)")
    parser.add_argument("--json", metavar="FILE", help="write the last table into this file, as JSON")
    return parser.parse_args(list(arguments))


def run(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the command and return its exit code."""
    options = parse_arguments(rospy.myargv(sys.argv)[1:] if arguments is None else arguments)
    wait_for_master("show_persons")
    rospy.init_node("show_persons", anonymous=True, disable_signals=True)
    watch = PersonsWatch()
    try:
        if options.once:
            _wait_for_somebody(watch, options.duration or 30.0)
            print(_table(watch), flush=True)
        else:
            _show(watch, options.duration, options.period)
        if options.json:
            write_json(options.json, as_data(watch.rows(), *watch.rates(), sorted(watch.seen)))
    except KeyboardInterrupt:
        pass
    except OSError as error:
        print("show_persons: %s" % error, file=sys.stderr)
        return 1
    finally:
        watch.close()
        rospy.signal_shutdown("show_persons has ended")
    return 0 if watch.seen else NOBODY


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


def _show(watch: PersonsWatch, duration: Optional[float], period: float) -> None:
    """Print a table each period, on a terminal more often; the first as soon as somebody is seen, the last at the end."""
    live = sys.stdout.isatty()
    begin = printed = time.monotonic()
    lines_above, met = 0, False
    while not rospy.is_shutdown():
        left = float("inf") if duration is None else begin + duration - time.monotonic()
        threading.Event().wait(max(0.0, min(REDRAW_S, period, left)))
        now = time.monotonic()
        ended = duration is not None and now >= begin + duration
        meets = not met and any((row.face or row.body) and row.confidence >= 1.0 for row in watch.rows())
        if live or meets or ended or now >= printed + period:
            text = _table(watch)
            sys.stdout.write(redraw(text, lines_above) if live else text + "\n\n")
            sys.stdout.flush()
            lines_above, printed, met = text.count("\n") + 1, now, met or meets
        if ended:
            return


def _wait_for_somebody(watch: PersonsWatch, seconds: float) -> None:
    end = time.monotonic() + seconds
    while time.monotonic() < end and not rospy.is_shutdown():
        if watch.seen:
            threading.Event().wait(SETTLE_S)
            return
        threading.Event().wait(0.05)


def _table(watch: PersonsWatch) -> str:
    return format_table(watch.rows(), *watch.rates())


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError("%r is no time in seconds above 0" % text)
    return value
