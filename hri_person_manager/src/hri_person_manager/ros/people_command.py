"""The people command: the services of the person manager on the command line, and the live table."""

from __future__ import annotations

import argparse
import sys
import time
from typing import Callable, Dict, List, Optional, Sequence, Tuple

import rospy
from std_srvs.srv import Empty, Trigger

from hri_person_manager.core.persons_table import format_columns
from hri_person_manager.ros import show_persons_command
from hri_person_manager.srv import (
    Enrol,
    Export,
    Forget,
    ListKnown,
    ListKnownResponse,
    Merge,
    SetName,
    SetNativeLanguage,
    Split,
)
from hri_pipeline.core.encryption import make_key_file
from hri_pipeline.core.private_file import StoreError
from hri_pipeline.ros.node import wait_for_master

PATIENCE_S = 5.0
_COMMANDS: Dict[str, Tuple[str, type, Tuple[str, ...], str]] = {
    "name": ("set_name", SetName, ("id", "name"), "give a known person a name; '' takes it away"),
    "language": ("set_native_language", SetNativeLanguage, ("id", "language"), "set the native language, such as pt-BR"),
    "merge": ("merge", Merge, ("id", "other"), "two ids are one human: OTHER becomes an alias of ID"),
    "split": ("split", Split, ("id",), "undo a merge"),
    "forget": ("forget", Forget, ("id",), "remove everything that is known of a person"),
    "enrol": ("enrol", Enrol, ("id", "name"), "the person ID, who is seen now, agrees to be recognised"),
    "export": ("export", Export, ("id",), "print everything that is known of a person, or of all, as JSON"),
}


def run(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the command and return its exit code: 0 done, 1 refused or not reachable, 2 wrong usage."""
    given = list(rospy.myargv(sys.argv)[1:] if arguments is None else arguments)
    if not given or given[0] == "watch":
        return show_persons_command.run(given[1:], "people watch")
    options = _parser().parse_args(given)
    if options.command == "forget-all" and not options.yes:
        print("people: this removes everybody who is known; add --yes", file=sys.stderr)
        return 2
    if options.command == "make-key":
        return _make_key(options.file)
    if not wait_for_master("people", 0.0):
        return 1
    rospy.init_node("people", anonymous=True, disable_signals=True)
    try:
        return _carry_out(options)
    except KeyboardInterrupt:
        return 130
    except (rospy.ROSException, rospy.ServiceException) as error:
        print("people: {}: {}. Is the person manager running? Its name is given by --node".format(
            options.node, error), file=sys.stderr)
        return 1
    finally:
        rospy.signal_shutdown("people has ended")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="people", description="Who is known to the robot, and what of them. Without a"
                                     " command: the live table of who is there (options: people watch --help).")
    parser.add_argument("--node", default="/hri_person_manager", help="name of the person manager")
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("list", help="list everybody who is known")
    for command, (_, _, fields, text) in _COMMANDS.items():
        added = commands.add_parser(command, help=text, description=text)
        for field in fields:
            optional = command == "export" or (command == "enrol" and field == "name")
            added.add_argument(field, nargs="?" if optional else None, default="")
    commands.add_parser("forget-all", help="remove everybody").add_argument("--yes", action="store_true", help="really")
    commands.add_parser("make-key", help="write a new key, with which a recogniser encrypts its templates").add_argument(
        "file", help="where to; an existing file is left alone")
    commands.add_parser("reset", help="start afresh with those who are tracked; the store is left alone")
    return parser


def _make_key(path: str) -> int:
    try:
        print("people: key written to {}. Whoever loses it loses the templates".format(make_key_file(path)))
    except StoreError as error:
        print("people: {}".format(error), file=sys.stderr)
        return 1
    return 0


def _carry_out(options: argparse.Namespace) -> int:
    if options.command == "list":
        print(known_table(_service(options.node, "list_known", ListKnown)()))
        return 0
    if options.command == "reset":
        _service(options.node, "reset", Empty)()
        return 0
    if options.command == "forget-all":
        answer = _service(options.node, "forget_all", Trigger)()
    else:
        name, kind, fields, _ = _COMMANDS[options.command]
        answer = _service(options.node, name, kind)(*(getattr(options, field) for field in fields))
    if not answer.success:
        print("people: {}".format(answer.message), file=sys.stderr)
        return 1
    print(answer.data if options.command == "export" else answer.message)
    return 0


def _service(node: str, name: str, kind: type) -> Callable:
    full = "{}/{}".format(node.rstrip("/"), name)
    rospy.wait_for_service(full, PATIENCE_S)
    return rospy.ServiceProxy(full, kind)


def known_table(known: ListKnownResponse) -> str:
    """Return everybody who is known as a table."""
    rows: List[Sequence[str]] = [("PERSON", "NAME", "LANGUAGE", "NOW", "KIND", "FIRST SEEN", "LAST SEEN")]
    for number, person_id in enumerate(known.ids):
        kind = "anonymous" if known.anonymous[number] else "enrolled" if known.enrolled[number] else "known"
        rows.append((person_id, known.names[number] or "-", known.native_languages[number] or "-",
                     "here" if known.tracked[number] else "-", kind,
                     _date(known.first_seen[number].to_sec()), _date(known.last_seen[number].to_sec())))
    return format_columns(rows) if len(rows) > 1 else "nobody is known"


def _date(stamp: float) -> str:
    return time.strftime("%Y-%m-%d %H:%M", time.localtime(stamp)) if stamp > 0.0 else "-"
