"""`scripts/benchmark faults`: nodes killed, sources stopped, garbage on every input, master restarted, disk full; time until people are there again."""

from __future__ import annotations

import argparse
import sys


def register(commands: argparse._SubParsersAction) -> None:
    """Add the command line of this benchmark."""
    from faults import WORLDS
    parser = commands.add_parser("faults", help="how soon people are there again after something broke, and what is left behind")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    parser.add_argument("--worlds", default=",".join(WORLDS), help="of: {}".format("; ".join("{}: {}".format(*item) for item in WORLDS.items())))
    parser.add_argument("--only", default="", help="only faults with this in their names, such as `kill` or `/tf`")


def run(options: argparse.Namespace) -> int:
    """Break things and print; 1 when something did not come back, was left behind, or nothing could be measured."""
    import faults
    worlds = options.worlds.split(",")
    if not set(worlds) <= set(faults.WORLDS):
        print("scripts/benchmark faults: --worlds is {!r}, legal: {}".format(options.worlds, ", ".join(faults.WORLDS)), file=sys.stderr)
        return 2
    found = faults.faults(worlds, options.only)
    print(faults.as_json(found) if options.json else faults.as_table(found))
    return int(faults.went_wrong(found))
