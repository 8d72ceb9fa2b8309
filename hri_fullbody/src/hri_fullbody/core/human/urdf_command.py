"""The command make_human_urdf: a stature and an id in, a URDF out."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import List, Optional

from hri_fullbody.core.human.human_model import SEGMENTS, Dimensions, layout_for
from hri_fullbody.core.human.human_urdf import make_urdf
from hri_fullbody.core.human.segment_table import SegmentTable

_DESCRIPTION = "Make the URDF of a human, as the stack makes it for each body that it sees."


def parse(argv: Optional[List[str]]) -> argparse.Namespace:
    """Read the command line; ends the process with the usage when it is wrong."""
    parser = argparse.ArgumentParser(prog="make_human_urdf", description=_DESCRIPTION)
    parser.add_argument("--height", type=float, default=1.70, help="stature, m (default: 1.70)")
    parser.add_argument("--id", required=True, help="id of the body: every link and joint ends in _ID")
    parser.add_argument("--interface", default="paper", choices=("paper", "rep155"),
                        help="paper: 18 joints, two in each hip; rep155: 20, three in each hip (default: paper)")
    parser.add_argument("--segments", default="", help="file with the proportions (default: the package's own)")
    parser.add_argument("--length", action="append", default=[], metavar="SEGMENT=M",
                        help="known length of a segment in m, such as upper_arm=0.29; may be given again. Segments: "
                             + ", ".join(SEGMENTS))
    parser.add_argument("--no-visuals", action="store_true", help="links and joints only")
    parser.add_argument("--output", default="-", help="file to write; - is standard output (default: -)")
    return parser.parse_args(argv)


def main(argv: Optional[List[str]] = None) -> int:
    """Write the URDF; return 0, or 1 after telling on standard error what is wrong."""
    arguments = parse(argv)
    try:
        table = SegmentTable.load(arguments.segments)
        dimensions = Dimensions.from_segments(arguments.height, _lengths(arguments.length), table)
        text = make_urdf(dimensions, arguments.id, layout_for(arguments.interface), not arguments.no_visuals)
        if arguments.output == "-":
            sys.stdout.write(text)
        else:
            Path(arguments.output).write_text(text, encoding="utf-8")
    except (ValueError, OSError) as error:
        sys.stderr.write("make_human_urdf: {}\n".format(error))
        return 1
    return 0


def _lengths(items: List[str]) -> dict:
    """Lengths (m) by name of the options SEGMENT=M. Raises ValueError naming the option."""
    lengths = {}
    for item in items:
        name, _, value = item.partition("=")
        try:
            lengths[name] = float(value)
        except ValueError:
            raise ValueError("--length {}: expected SEGMENT=M, such as upper_arm=0.29".format(item)) from None
    return lengths
