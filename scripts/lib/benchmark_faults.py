"""`scripts/benchmark faults`: nodes killed, source stopped, garbage on every input, master restarted; time until people are there again."""

from __future__ import annotations

import argparse
import sys


def register(commands: argparse._SubParsersAction) -> None:
    """Add the command line of this benchmark."""
    parser = commands.add_parser("faults", help="how soon people are there again after something broke, and what is left behind")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")


def run(options: argparse.Namespace) -> int:
    """Break things and print; 1 when something did not come back, was left behind, or nothing could be measured."""
    import faults
    try:
        found = faults.faults()
    except (RuntimeError, OSError) as error:
        print("scripts/benchmark faults: {}".format(error), file=sys.stderr)
        return 1
    print(faults.as_json(found) if options.json else faults.as_table(found))
    return int(faults.went_wrong(found))
