"""The commands `people` and `show_persons`: the services of the person manager on the command line, and the live
table."""

from __future__ import annotations

import argparse
import io
import json
import logging
import math
import os
import signal
import sys
import tempfile
import threading
import time
from pathlib import Path
from types import FrameType
from typing import Callable, Dict, List, Optional, Sequence, Set, Tuple

import genpy
import rosgraph
import rospy
from diagnostic_msgs.msg import DiagnosticArray
from rosgraph.roslogging import RosStreamHandler
from std_msgs.msg import Float32, String
from std_srvs.srv import Empty, Trigger

from hri_msgs.msg import IdsList
from hri_person_manager.core.display import (
    CameraStatus,
    LiveDisplay,
    PersonRow,
    RateMeter,
    as_data,
    format_columns,
    format_table,
)
from hri_person_manager.core.features import MAX_FEATURES
from hri_person_manager.core.register import RegisterError, is_storable, legal_name
from hri_person_manager.ros.services import COMMANDS, LIST_ANSWER_S, carry_out, find_manager, service
from hri_person_manager.srv import ListKnown, ListKnownResponse
from hri_pipeline.core.error_log import thread_shortage
from hri_pipeline.core.frames import RawTransform, read
from hri_pipeline.core.onnx import ModelError
from hri_pipeline.core.privacy import StoreError, TemplateCipher, make_key_file, notice
from hri_pipeline.core.recognition.store import PersonStore
from hri_pipeline.ros.master import MasterWatch
from hri_pipeline.ros.node import wait_for_master
from hri_pipeline.ros.privacy import collect
from hri_pipeline.ros.rospy_compat import release
from hri_pipeline.ros.services import NoAnswer
from hri_pipeline.ros.subscriptions import IdSubscribers
from hri_pipeline.ros.tf import SKELETONS, Frames, TfSubscriber

PRIVACY_S = 2.0      # in which all nodes have sent what they have latched
FRAME_S = 1.0        # for which the last transform of who is not tracked counts; they come ten times a second
NOBODY = 3
ONCE_S = 30.0
REDRAW_S = 0.5
SETTLE_S = 1.0      # after the first person was seen: latched values and a few images
_TOPICS = {"face_id": String, "body_id": String, "voice_id": String, "location_confidence": Float32}


def run_people(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the command and return its exit code: 0 done, 1 refused or not reachable, 2 wrong usage."""
    if isinstance(sys.stdout, io.TextIOWrapper):    # names may have letters that the terminal does not know
        sys.stdout.reconfigure(errors="backslashreplace")
    given = list(rospy.myargv(sys.argv)[1:] if arguments is None else arguments)
    if not given or given[0] == "watch":
        return show_persons(given[1:], "people watch")
    if not all(map(is_storable, given)):
        print("people: the arguments are no text in UTF-8; see `locale`", file=sys.stderr)
        return 2
    options = _parser().parse_args(given)
    if options.command == "forget-all" and not options.yes:
        print("people: this removes everybody who is known; add --yes", file=sys.stderr)
        return 2
    if options.command == "make-key":
        return _make_key(options.file)
    if options.command == "enrol" and (options.photographs or options.given_name):
        return _enrol_photographs(options)
    if not wait_for_master("people", 0.0):
        return 1
    try:
        rospy.init_node("people", anonymous=True, disable_signals=True)
        options.node = options.node or find_manager()
        return _carry_out(options)
    except KeyboardInterrupt:
        return 130
    except rospy.ROSInitException as error:
        return _not_begun("people", error)
    except (rospy.ROSException, rospy.ServiceException) as error:
        print("people: {}".format(_why(options.node or "hri_person_manager", error)), file=sys.stderr)
        return 1
    except (RuntimeError, OSError) as error:
        return _not_begun("people", error)
    finally:
        rospy.signal_shutdown("people has ended")


def _not_begun(name: str, error: Exception) -> int:
    """Say why a command cannot be connected to ROS, such as the limit that lets no more threads start, and return its
    exit code; any other error is raised again."""
    reason = thread_shortage(error) or (str(error) if isinstance(error, rospy.ROSInitException) else "")
    if not reason:
        raise error
    print("{}: {}".format(name, reason), file=sys.stderr)
    return 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="people", description="Who is known to the robot, and what of them. Without a"
                                     " command: the live table of who is there (options: people watch --help).")
    parser.add_argument("--node", default="", help="name of the person manager; default: hri_person_manager here, "
                        "else the only one that runs")
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("list", help="list everybody who is known, one line each").add_argument(
        "--all", action="store_true", help="a line for each id, also of who was merged into another")
    commands.add_parser("privacy", help="what is computed and kept of people, by the nodes themselves")
    for command, (_, _, fields, text) in COMMANDS.items():
        added = commands.add_parser(command, help=text, description=text)
        for field in fields:
            optional = command == "export" or (command.startswith("enrol") and field == "name")
            added.add_argument(field, nargs="?" if optional else None, default="")
        if command == "enrol":
            added.add_argument("--photographs", action="store_true",
                               help="ID is a directory of photographs of somebody who has agreed; no node runs")
            added.add_argument("--store", default="", help="with photographs: the store of people")
            added.add_argument("--key", default="", help="with photographs: the key of the store, if it has one")
            added.add_argument("--name", dest="given_name", default="", help="name of the person on the photographs; "
                                                                             "implies --photographs")
            added.add_argument("--model", default="", help="with photographs: recognition network, as in faces.yaml")
    commands.add_parser("forget-all", help="remove everybody").add_argument("--yes", action="store_true", help="really")
    commands.add_parser("make-key",
                        help="write a new key, with which a recogniser encrypts its templates").add_argument(
        "file", help="where to; an existing file is left alone")
    commands.add_parser("reset", help="start afresh with those who are tracked; the store is left alone")
    return parser


def _why(node: str, error: Exception) -> str:
    """Return why a person manager did not do what it was asked for, and the remedy."""
    if isinstance(error, NoAnswer):
        return str(error)
    if "md5sum" in str(error):  # the answer of rospy to a request of another type
        return ("{} is of another version than this command: they describe the service differently. Use `people` of "
                "the version that runs, or install one version on both machines and start the nodes again".format(node))
    return "{}: {}. Is the person manager running? Its name is given by --node".format(node, error)


def _make_key(path: str) -> int:
    try:
        print("people: key written to {}. Whoever loses it loses the templates".format(make_key_file(path)))
    except StoreError as error:
        print("people: {}".format(error), file=sys.stderr)
        return 1
    return 0


def _enrol_photographs(options: argparse.Namespace) -> int:
    """Put somebody on photographs into the store, as having agreed; the node that reads it starts later."""
    # The networks take seconds to load, which no other command has to wait for.
    from hri_pipeline.core.recognition.enrolment import EnrolmentError, enrol, photographs, templates_of
    name = (options.given_name or options.name).strip()
    if not options.id or not options.store or not name:
        print("people: people enrol --name NAME DIRECTORY --store FILE.sqlite [--key FILE]", file=sys.stderr)
        return 2
    try:
        legal_name(name)
        store = PersonStore(options.store, TemplateCipher(options.key) if options.key else None,
                            lambda text: print(text, file=sys.stderr))
        try:
            found = templates_of(photographs(Path(options.id).expanduser()), options.model)
            person_id = enrol(store, name, found, time.time())
        finally:
            store.close()
    except (EnrolmentError, RegisterError, StoreError, ModelError) as error:
        print("people: {}".format(error), file=sys.stderr)
        return 1
    for line in found.left_out:
        print("people: left out {}".format(line), file=sys.stderr)
    print("{} is {}, has agreed, and is known by {} templates".format(person_id, name, len(found.templates)))
    return 0


def _carry_out(options: argparse.Namespace) -> int:
    if options.command == "list":
        print(known_table(service(options.node, "list_known", ListKnown, LIST_ANSWER_S)(), options.all))
        return 0
    if options.command == "privacy":
        uses = collect(PRIVACY_S)
        print(notice(uses) if uses else "people: no node has said on /humans/privacy what it does", flush=True)
        return 0 if uses else 1
    if options.command == "reset":
        service(options.node, "reset", Empty)()
        return 0
    if options.command == "forget-all":
        answer = service(options.node, "forget_all", Trigger)()
    else:
        answer = carry_out(options.node, options.command, vars(options))
    if not answer.success:
        print("people: {}".format(answer.message), file=sys.stderr)
        return 1
    print(answer.data if options.command == "export" else answer.message)
    return 0


def known_table(known: ListKnownResponse, every_id: bool = False) -> str:
    """Return everybody who is known as a table: a line for each human, or for each id."""
    place = {person_id: number for number, person_id in enumerate(known.ids)}
    human = {person_id: alias if alias in place and not every_id else person_id
             for person_id, alias in zip(known.ids, known.aliases)}
    rows: List[Sequence[str]] = [("PERSON", "NAME", "LANGUAGE", "NOW", "KIND", "FIRST SEEN", "LAST SEEN",
                                  "ALIAS OF" if every_id else "ALIASES")]
    for person_id in (one for one in known.ids if human[one] == one):
        others = [other for other in known.ids if human[other] == person_id != other]
        numbers = [place[one] for one in (person_id, *others)]
        kind = ("enrolled" if any(known.enrolled[number] for number in numbers)
                else "known" if not all(known.anonymous[number] for number in numbers) else "anonymous")
        first, last = ([when for when in (times[number].to_sec() for number in numbers) if when > 0.0]
                       for times in (known.first_seen, known.last_seen))
        rows.append((person_id, _first(known.names, numbers), _first(known.native_languages, numbers),
                     "here" if any(known.tracked[number] for number in numbers) else "-", kind,
                     _date(min(first, default=0.0)), _date(max(last, default=0.0)),
                     (known.aliases[place[person_id]] if every_id else ", ".join(others)) or "-"))
    return format_columns(rows) if len(rows) > 1 else "nobody is known"


def _first(texts: Sequence[str], numbers: Sequence[int]) -> str:
    """The first text that there is at one of these places, else a dash."""
    return next((texts[number] for number in numbers if texts[number]), "-")


def _date(stamp: float) -> str:
    return time.strftime("%Y-%m-%d %H:%M", time.localtime(stamp)) if stamp > 0.0 else "-"


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


def show_persons(arguments: Optional[Sequence[str]] = None, command: str = "show_persons") -> int:
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
        return _show_until(options, end, name)
    except KeyboardInterrupt:
        return NOBODY
    except (rospy.ROSInitException, RuntimeError, OSError) as error:
        return _not_begun(name, error)
    finally:
        rospy.signal_shutdown("{} has ended".format(name))


def _show_until(options: argparse.Namespace, end: float, name: str) -> int:
    """Show the persons until `end` (monotonic time, s) or a signal; return the exit code. name: of the command."""
    if sys.stdout.isatty():
        _mute()
    watch, master = PersonsWatch(), MasterWatch()
    try:
        if options.once:
            _wait_for_somebody(watch, end)
            print(_table(watch, master), flush=True)
        else:
            _show_periodically(watch, master, end, options.period)
    except KeyboardInterrupt:
        pass
    finally:
        _end_quietly()
        last = as_data(watch.rows(), *watch.rates(), watch.seen)
        watch.close()
        master.close()
    try:
        if options.json:
            write_json(options.json, last)
    except OSError as error:
        print("%s: the table cannot be written to %s: %s" % (name, options.json, error.strerror or error),
              file=sys.stderr)
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


def _show_periodically(watch: PersonsWatch, master: MasterWatch, end: float, period: float) -> None:
    """Print a table each period, on a terminal more often; the first as soon as somebody is seen, the last at the
    end."""
    drawing = LiveDisplay() if sys.stdout.isatty() else None
    printed, met = time.monotonic(), False
    while not rospy.is_shutdown():
        threading.Event().wait(max(0.0, min(REDRAW_S, period, end - time.monotonic())))
        now = time.monotonic()
        meets = not met and any((row.face or row.body) and row.position is not None and row.confidence == 1.0
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
    return format_table(watch.rows(), *watch.rates(), note, watch.nobody())


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError("%r is no time in seconds above 0" % text)
    return value


class PersonsWatch:
    """Latest state of all persons who are tracked or still have a frame, and the rates at which faces and bodies
    come."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._ids: List[str] = []
        self._known: Set[str] = set()
        self._values: Dict[str, Dict[str, object]] = {}
        self._frames: Dict[str, Tuple[RawTransform, float, float]] = {}
        self._rates = {"face_": RateMeter(), "body_": RateMeter()}
        self._cameras = CameraStatus()
        self._features: Dict[str, List[str]] = {}
        self.seen: Set[str] = set()
        self._feeds = [IdSubscribers("persons", _TOPICS, self._on_value, self._on_tracked)]
        for plural, prefix in (("faces", "face_"), ("bodies", "body_")):
            self._feeds.append(IdSubscribers(plural, {}, self._on_value, self._features_callback(prefix),
                                             max_ids=MAX_FEATURES))
        self._list = rospy.Subscriber("/humans/persons/known", IdsList, self._on_known, queue_size=1)
        self._subscriber = TfSubscriber(self._on_frames, skip=SKELETONS)
        self._diagnostics = rospy.Subscriber("/diagnostics", DiagnosticArray, self._on_diagnostics, queue_size=100)

    def rows(self) -> List[PersonRow]:
        """Return one row per person who is tracked or has a frame, by id."""
        oldest = time.monotonic() - FRAME_S
        # While /clock stands still, as of a paused bag, no transforms come, and those that were there still hold.
        still = math.inf if rospy.rostime.is_wallclock() else rospy.get_time()
        with self._lock:
            self._frames = {person_id: frame for person_id, frame in self._frames.items() if person_id in self._ids
                            or frame[2] >= oldest or abs(frame[0].stamp - still) < FRAME_S}
            return [self._row(person_id) for person_id in sorted({*self._ids, *self._frames})]

    def rates(self) -> Tuple[float, float]:
        """Return the images per second in which faces and bodies were found."""
        now = time.monotonic()
        with self._lock:
            return self._rates["face_"].rate(now), self._rates["body_"].rate(now)

    def nobody(self) -> str:
        """Return what to say while nobody is tracked."""
        with self._lock:
            return self._cameras.text(time.monotonic())

    def close(self) -> None:
        """Let go of all topics. Idempotent."""
        release(self._diagnostics)
        release(self._list)
        for feed in self._feeds:
            feed.close()
        self._subscriber.close()

    def _row(self, person_id: str) -> PersonRow:
        values = self._values.get(person_id, {})
        position, frame, age = None, "", None
        if person_id in self._frames:
            transform, age_at_arrival, _ = self._frames[person_id]
            position, frame, age = transform.translation, transform.parent, age_at_arrival
        return PersonRow(person_id, str(values.get("face_id", "")), str(values.get("body_id", "")),
                         str(values.get("voice_id", "")),
                         float(values.get("location_confidence", 0.0)) if person_id in self._ids else None,
                         position, frame, age)

    def _on_tracked(self, ids: List[str]) -> None:
        with self._lock:
            self._ids = list(ids)
            self.seen.update(ids)
            self._values = {person_id: values for person_id, values in self._values.items() if person_id in ids}

    def _on_known(self, message: IdsList) -> None:
        with self._lock:
            self._known = set(message.ids)
            self._frames = {person_id: frame for person_id, frame in self._frames.items()
                            if person_id in self._known or person_id in self._ids}

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            arrive = [value.value for value in status.values if value.key == "images_arrive"]
            if arrive and status.name.endswith(": input"):
                with self._lock:
                    self._cameras.update(status.name, arrive[0] == "True", status.message, time.monotonic())

    def _features_callback(self, prefix: str) -> Callable[[List[str]], None]:
        def on_tracked(ids: List[str]) -> None:
            with self._lock:
                self._features[prefix] = ids
        return on_tracked

    def _on_value(self, identity: str, name: str, message: genpy.Message) -> None:
        with self._lock:
            self._values.setdefault(identity, {})[name] = message.data

    def _on_frames(self, data: bytes, frames: Frames, fixed: bool) -> None:
        if fixed:
            return
        now, arrival = rospy.get_time(), time.monotonic()
        with self._lock:
            for child, offset in frames:
                name = child.decode("utf-8", "replace").lstrip("/")
                # A robot may have a body_link.
                if name[5:] in self._features.get(name[:5], ()):
                    self._rates[name[:5]].add(read(data, offset).stamp, arrival)
                elif name.startswith("person_") and (name[7:] in self._known or name[7:] in self._ids):
                    transform = read(data, offset)
                    self._frames[name[7:]] = (transform, 1e3 * (now - transform.stamp), arrival)
