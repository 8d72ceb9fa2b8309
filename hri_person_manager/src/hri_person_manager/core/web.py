"""The web page: its settings, who may see it, what a browser may ask for, and what it is shown, as JSON."""

from __future__ import annotations

import hmac
import ipaddress
import json
import math
import re
from dataclasses import dataclass
from typing import Any, Dict, List, Optional, Sequence, Tuple
from urllib.parse import urlsplit

import numpy as np

from hri_person_manager.core.register import is_storable
from hri_person_manager.core.triangulation import ellipse
from hri_pipeline.core.frames import is_optical
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.ids import is_valid_id
from hri_pipeline.core.overlay import colour_of
from hri_pipeline.core.parameters import ParameterError, ParameterTable, Settings, parameter

ACTION_HEADER = "X-Ros4hri"
"""A page of another origin cannot send a header of its own without being asked first, which this server never allows
(Fetch standard, CORS preflight)."""
CONTENT_POLICY = ("default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self'; "
                  "base-uri 'none'; form-action 'none'; frame-ancestors 'none'")
LOOKING = ("list", "privacy")
_OF_ONE = ("name", "enrol", "enrol-new", "forget", "export")
COMMANDS = LOOKING + _OF_ONE
_HOST = re.compile(r"(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9._-]+)(?::[0-9]{1,5})?")


@dataclass(frozen=True)
class WebSettings(Settings):
    """Shows people, their places and the picture of the overlay in a browser."""

    address: str = parameter(
        "127.0.0.1", "IP address to listen on. 127.0.0.1: this machine only. 0.0.0.0: all networks; a browser then "
        "needs the token.")
    port: int = parameter(8080, "TCP port. 0: any free one, which is printed.", minimum=0, maximum=65535)
    token_file: str = parameter(
        "", "File whose first line is the token that browsers need, 16 characters at least. Empty: none for this "
        "machine only, else a new one is printed at each start.")
    host_names: Sequence[str] = parameter(
        [], "More names of this machine in addresses of the page, such as robot.example.org; requests for other names "
        "are refused.")
    actions: bool = parameter(True, "Let browsers name, enrol, export and forget people. False: look only.")
    person_manager: str = parameter("hri_person_manager", "Name of the node whose services do that, else the only one.")
    robot_frame: str = parameter(
        "", "Frame of the robot on the map. Empty: the camera of the overlay.", shared="/humans/robot_reference_frame")
    max_rate: float = parameter(10.0, "Most pictures per second and browser.", unit="Hz", minimum=0.5, maximum=60.0)
    width: int = parameter(960, "Wider pictures are made smaller.", unit="px", minimum=160, maximum=3840)
    quality: int = parameter(75, "Quality of the JPEG pictures.", minimum=10, maximum=100)
    max_browsers: int = parameter(16, "Most browsers (windows) at a time.", minimum=1, maximum=200)


WEB_PARAMETERS = ParameterTable("web", WebSettings)


class RequestError(ValueError):
    """A request that is refused; status: of HTTP, and the text says why."""

    def __init__(self, status: int, text: str) -> None:
        super().__init__(text)
        self.status = status


class Access:
    """Who may see the page.

    The `Host` of a request must be an address, or a name of this machine: a name of somebody else that leads here
    (DNS rebinding) would make this page one of their origin. Actions must come from this page.

    Parameters
    ----------
    address : str
        IP address or `localhost`, on which the server listens.
    names : sequence of str
        Names of the machine.
    token : str
        What browsers have to bring; empty when they need nothing.
    """

    def __init__(self, address: str, names: Sequence[str], token: str) -> None:
        self._local = is_local(address)
        self._names = {"localhost", *(name.lower().rstrip(".") for name in names if name)}
        self._token = token.encode()

    @property
    def token(self) -> str:
        """What browsers have to bring."""
        return self._token.decode()

    @property
    def needs_token(self) -> bool:
        """Whether browsers have to bring the token."""
        return bool(self._token)

    def check_host(self, host: str) -> None:
        """Raise RequestError unless the header `Host` names this machine."""
        name = _host_name(host)
        try:
            local = ipaddress.ip_address(name).is_loopback
            allowed = local or not self._local
        except ValueError:
            allowed = name in self._names
        if not allowed:
            raise RequestError(403, "this page is not known as {!r}; see the parameter ~host_names".format(host[:80]))

    def check_token(self, given: str) -> None:
        """Raise RequestError unless `given` is the token; takes as long for every wrong one."""
        if self._token and not hmac.compare_digest(given.encode("utf-8", "replace"), self._token):
            raise RequestError(403, "the token is missing or wrong: open the address that the node printed at its "
                                    "start, with ?token=...")

    @staticmethod
    def check_origin(origin: Optional[str], host: str) -> None:
        """Raise RequestError when a browser says that another page asks."""
        try:
            same = origin is None or urlsplit(origin).netloc.lower() == host.lower()
        except ValueError:
            same = False
        if not same:
            raise RequestError(403, "this comes from another page: {!r}".format((origin or "")[:80]))

    def check_action(self, header: Optional[str], origin: Optional[str], host: str, kind: str) -> None:
        """Raise RequestError unless an action comes from this page, or from a program that says so."""
        self.check_origin(origin, host)
        if header != "1" or kind.split(";")[0].strip().lower() != "application/json":
            raise RequestError(403, "an action needs the header {}: 1, and JSON".format(ACTION_HEADER))


def is_local(address: str) -> bool:
    """Tell whether an address reaches this machine only. Raises ParameterError for what is no address."""
    if address == "localhost":
        return True
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        raise ParameterError("~address is {!r}, which is no IP address, such as 127.0.0.1".format(address)) from None


def _host_name(host: str) -> str:
    """Return the host of HOST[:PORT], without the brackets of IPv6; empty where it is none."""
    found = _HOST.fullmatch(host)
    return found.group(1).strip("[]").rstrip(".").lower() if found else ""


@dataclass(frozen=True)
class Action:
    """What a browser asks for. command: one of COMMANDS; id: of the person; name: for `name` and `enrol`."""

    command: str
    id: str = ""
    name: str = ""


def action_of(body: bytes) -> Action:
    """Read a request. Raises RequestError, whose text is shown to the user.

    To be recognised is each person's own choice: `enrol` needs `consent: true`.
    """
    try:
        data = json.loads(body)
    except (ValueError, RecursionError):
        raise RequestError(400, "the request is no JSON") from None
    command = data.get("command") if isinstance(data, dict) else None
    if not isinstance(command, str) or command not in COMMANDS:
        raise RequestError(400, "the command has to be one of " + ", ".join(COMMANDS))
    person_id, name = data.get("id", ""), data.get("name", "")
    if command in _OF_ONE and not is_valid_id(person_id):
        raise RequestError(400, "the id of the person is missing, or is none")
    if not isinstance(name, str):
        raise RequestError(400, "a name has to be text")
    if not is_storable(name):
        raise RequestError(400, "the name is no text that can be stored (UTF-8)")
    if command.startswith("enrol") and data.get("consent") is not True:
        raise RequestError(400, "the person has to agree to be recognised")
    return Action(command, person_id if command in _OF_ONE else "", name.strip())


@dataclass(frozen=True)
class PersonOnPage:
    """One person who is there.

    since: s for which. face, body: whether they are seen now. speaking, posture, looks_at: None, or empty text, where
    not known; looks_at: a person id, empty for the robot. pose: in `frame`, with the covariance (3, 3) m^2 of its
    position where that is known.
    """

    id: str
    name: str = ""
    anonymous: bool = True
    since: float = 0.0
    engagement: str = ""
    speaking: Optional[bool] = None
    posture: str = ""
    looks_at: Optional[str] = None
    confidence: float = 0.0
    frame: str = ""
    pose: Optional[Pose] = None
    covariance: Optional[np.ndarray] = None
    face: bool = False
    body: bool = False


def page_state(people: Sequence[PersonOnPage], groups: Sequence[Sequence[str]],
               robot: Optional[Tuple[str, Pose, bool]], camera: str, camera_frame: str = "") -> Dict[str, Any]:
    """Return what the page shows.

    Parameters
    ----------
    people : sequence of PersonOnPage
    groups : sequence of sequences of str
        Person ids of those who stand together; empty for the robot.
    robot : (str, Pose, bool), optional
        Frame and pose of the robot, and whether it looks along z (an optical frame) and not along x.
    camera : str
        Why there is no picture; empty while pictures come.
    camera_frame : str
        Frame of the pictures, which is optical whatever its name says; empty where none came.
    """
    frame = _common_frame(people)
    level = from_above(is_optical(frame) or frame == camera_frame)
    shown = [_person_data(person, frame, level) for person in people]
    return {"people": shown, "frame": frame, "camera": camera,
            "groups": [list(group) for group in groups if len(group) > 1],
            "robot": _place(robot[1], level, along_z=robot[2]) if robot is not None and robot[0] == frame else None}


def _common_frame(people: Sequence[PersonOnPage]) -> str:
    """Return the frame of most places: the map has one."""
    frames = [person.frame for person in people if person.pose is not None]
    return max(sorted(set(frames)), key=frames.count, default="")


def _person_data(person: PersonOnPage, frame: str, level: np.ndarray) -> Dict[str, Any]:
    blue, green, red = colour_of(person.id)
    data = {"id": person.id, "name": person.name, "anonymous": person.anonymous, "since": round(person.since, 1),
            "colour": "#{:02x}{:02x}{:02x}".format(red, green, blue), "engagement": person.engagement,
            "speaking": person.speaking, "posture": person.posture, "looks_at": person.looks_at,
            "confidence": round(person.confidence, 2), "face": person.face, "body": person.body, "place": None}
    if person.pose is not None and person.frame == frame:
        data["place"] = _place(person.pose, level, person.covariance)
    return data


def from_above(optical: bool) -> np.ndarray:
    """Return (2, 3): what takes a vector of a frame to forward and left, seen from above.

    x and y of a level frame, z and -x of an optical one (REP-103), whose camera is taken for level.
    """
    if optical:
        return np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
    return np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def _place(pose: Pose, level: np.ndarray, covariance: Optional[np.ndarray] = None, along_z: bool = False
           ) -> Optional[Dict[str, Any]]:
    """Return x, y (m), heading (rad) and the half axes (m) and turn (rad) of the ellipse of 95 %; None without
    numbers."""
    point, ahead = level @ pose.translation, level @ pose.rotation[:, 2 if along_z else 0]
    if not np.isfinite([*point, *ahead]).all():
        return None
    found: Dict[str, Any] = {"x": round(float(point[0]), 3), "y": round(float(point[1]), 3), "ellipse": None,
                             "heading": round(math.atan2(ahead[1], ahead[0]), 3)}
    if covariance is not None and np.isfinite(covariance).all():
        found["ellipse"] = [round(value, 3) for value in ellipse(level @ covariance @ level.T)]
    return found


def known_data(ids: Sequence[str], names: Sequence[str], anonymous: Sequence[bool], enrolled: Sequence[bool],
               tracked: Sequence[bool], last_seen: Sequence[float]) -> List[Dict[str, Any]]:
    """Return everybody whom the person manager knows, anonymous ones left out: nothing is kept of them."""
    return [{"id": person_id, "name": name, "enrolled": agreed, "here": here, "last_seen": seen}
            for person_id, name, nameless, agreed, here, seen in zip(
                ids, names, anonymous, enrolled, tracked, last_seen) if not nameless]
