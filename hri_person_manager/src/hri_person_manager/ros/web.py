"""The web node: who is there, where, and the picture of the overlay, in browsers.

Threads: tornado's loop in one, which alone touches connections; rospy's callbacks make the pictures; one thread looks
at the people while somebody has the page open; each service call has one of its own, so that a node which does not
answer holds up nobody else. They hand their results to the loop. A browser gets the next picture when it has shown the
last one: a slow one gets fewer, and nobody waits for it.
"""

from __future__ import annotations

import asyncio
import json
import secrets
import socket
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, Awaitable, Callable, Dict, List, Optional, Set, Tuple

import cv2
import rospkg
import rospy
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import Image
from tornado.httpserver import HTTPServer
from tornado.ioloop import IOLoop
from tornado.netutil import bind_sockets
from tornado.web import Application, HTTPError, RequestHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from hri_person_manager.core.display import CameraStatus
from hri_person_manager.core.triangulation import aged_in
from hri_person_manager.core.web import (
    ACTION_HEADER,
    CONTENT_POLICY,
    LOOKING,
    Access,
    Action,
    PersonOnPage,
    RequestError,
    WebSettings,
    action_of,
    is_local,
    known_data,
    page_state,
)
from hri_person_manager.ros.services import LIST_ANSWER_S, carry_out, find_manager, service
from hri_person_manager.srv import ListKnown
from hri_pipeline.client import Humans
from hri_pipeline.client.humans import Person
from hri_pipeline.client.topics import Engagement, Posture
from hri_pipeline.core.frames import is_optical
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.images import ImageError
from hri_pipeline.core.parameters import ParameterError
from hri_pipeline.core.privacy import notice
from hri_pipeline.ros.conversions import image_to_bgr
from hri_pipeline.ros.privacy import collect
from hri_pipeline.ros.rospy_compat import release
from hri_pipeline.ros.subscriptions import IdSubscribers
from hri_pipeline.ros.tf import RobotTfListener

OVERLAY = "visualization/overlay"
STATE_PERIOD_S = 0.2
PICTURE_SILENCE_S = 3.0     # without a picture for so long the page says so
PRIVACY_S = 2.0             # in which all nodes have sent what they have latched
ANSWER_S = 20.0             # most time for an action
LONGEST_AGE_S = 1.0         # of a place: those of who is not seen come ten times a second
MAX_ACTIONS = 8             # at a time
_PING_S = 10.0
_MAX_REQUEST = 65536        # bytes
_LOG_PERIOD_S = 10.0
_FILES = {"/": ("index.html", "text/html"), "/page.js": ("page.js", "text/javascript"),
          "/page.css": ("page.css", "text/css")}


class Pictures:
    """The overlay as JPEG, while somebody looks. on_picture(data) is called in rospy's thread."""

    def __init__(self, settings: WebSettings, on_picture: Callable[[bytes], None]) -> None:
        self._settings, self._on_picture = settings, on_picture
        self._subscriber: Optional[rospy.Subscriber] = None
        self._next = 0.0
        self.heard = self.since = float("-inf")
        self.frame = ""

    def want(self, wanted: bool) -> None:
        """Subscribe, or no longer. Idempotent."""
        if wanted and self._subscriber is None:
            self.since = time.monotonic()
            self._subscriber = rospy.Subscriber(OVERLAY, Image, self._take, queue_size=1, buff_size=2 ** 24)
        elif not wanted and self._subscriber is not None:
            release(self._subscriber)
            self._subscriber = None

    @property
    def missing(self) -> bool:
        """Whether pictures are wanted and have not come for some time."""
        return time.monotonic() - max(self.heard, self.since) > PICTURE_SILENCE_S

    @property
    def published(self) -> bool:
        """Whether any node publishes them."""
        return self._subscriber is not None and self._subscriber.get_num_connections() > 0

    def _take(self, message: Image) -> None:
        now = time.monotonic()
        self.heard, self.frame = now, message.header.frame_id
        if now < self._next:
            return
        self._next = now + 0.9 / self._settings.max_rate
        try:
            picture = image_to_bgr(message)
        except ImageError as error:
            rospy.logwarn_throttle(_LOG_PERIOD_S, "%s: %s", OVERLAY, error)
            return
        height, width = picture.shape[:2]
        if width > self._settings.width:
            size = (self._settings.width, max(1, height * self._settings.width // width))
            picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
        done, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, self._settings.quality])
        if done:
            self._on_picture(data.tobytes())


class PeopleView:
    """What is to be told of people. Only the list of persons is subscribed to while nobody looks."""

    def __init__(self, settings: WebSettings, pictures: Pictures) -> None:
        self._settings, self._pictures = settings, pictures
        self._came: Dict[str, float] = {}
        self._list = IdSubscribers("persons", {}, lambda *_: None, self._on_tracked)
        self._humans: Optional[Humans] = None
        self._diagnostics: Optional[rospy.Subscriber] = None
        self._cameras = CameraStatus()
        self._robot: Optional[RobotTfListener] = None

    def state(self) -> Dict[str, Any]:
        """Return what the page shows now; subscribes to what is needed for it."""
        if self._humans is None:
            self._humans = Humans(patience=0.0)
            self._diagnostics = rospy.Subscriber("/diagnostics", DiagnosticArray, self._on_diagnostics, queue_size=100)
            self._robot = RobotTfListener("map")
        people = [self._person(person) for person in self._humans.persons.values() if not person.alias]
        frame = next((person.frame for person in people if person.frame), "")
        return page_state(people, [group.members for group in self._humans.groups], self._place_of_robot(frame),
                          self._camera(), self._pictures.frame)

    def rest(self) -> None:
        """Nobody looks: let go of what costs something. Idempotent."""
        humans, diagnostics, robot = self._humans, self._diagnostics, self._robot
        self._humans = self._diagnostics = self._robot = None
        if diagnostics is not None:
            release(diagnostics)
        for owner in (humans, robot):
            if owner is not None:
                owner.close()

    def close(self) -> None:
        """Let go of all topics. Idempotent."""
        self.rest()
        self._list.close()

    def _person(self, person: Person) -> PersonOnPage:
        voice, body = person.voice, person.body
        posture = body.posture if body is not None else None
        level, confidence, location = person.engagement, person.location_confidence, person.location
        place = None
        if confidence > 0.0 and location is not None:
            # Of a paused bag no place comes, but nobody walks either.
            place = replace(location, covariance=aged_in(
                location.covariance, min(person.location_age, LONGEST_AGE_S), self._is_camera(location.frame)))
        return PersonOnPage(
            person.id, person.name, person.anonymous, time.monotonic() - self._came.get(person.id, time.monotonic()),
            "" if level == Engagement.UNKNOWN else level.name.lower(),
            voice.is_speaking if voice is not None else None,
            "" if posture in (None, Posture.OTHER) else posture.name.lower(), person.looks_at, confidence,
            *(place.frame, place.pose, place.covariance) if place is not None else ("", None, None),
            person.face is not None, body is not None)

    def _place_of_robot(self, frame: str) -> Optional[Tuple[str, Pose, bool]]:
        """Return frame and pose of the robot, and whether it looks along z."""
        robot = self._settings.robot_frame.lstrip("/") or self._pictures.frame
        if not robot or not frame or self._robot is None:
            return None
        pose = self._robot.between(frame, robot, rospy.Time())
        return None if pose is None else (frame, pose, self._is_camera(robot))

    def _is_camera(self, frame: str) -> bool:
        """Tell whether a frame is optical: the pictures' is, whatever its name says."""
        return is_optical(frame) or frame == self._pictures.frame

    def _camera(self) -> str:
        """Return why there is no picture, empty while there is one."""
        if not self._pictures.missing:
            return ""
        text, topic = self._cameras.text(time.monotonic()), rospy.resolve_name(OVERLAY)
        if text.startswith("no images"):
            return text
        if not self._cameras.is_known(time.monotonic()) and not self._pictures.published:
            return "there is no camera: no node works on images, and nothing is on " + topic
        return "no picture on {}: is the camera on, and overlay:=true?".format(topic)

    def _on_tracked(self, ids: List[str]) -> None:
        now = time.monotonic()
        self._came = {person_id: self._came.get(person_id, now) for person_id in ids}

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            arrive = [value.value for value in status.values if value.key == "images_arrive"]
            if arrive and status.name.endswith(": input"):
                self._cameras.update(status.name, arrive[0] == "True", status.message, time.monotonic())


class WebNode:
    """Serves the page until ROS ends."""

    def __init__(self, settings: WebSettings) -> None:
        self.settings = settings
        self.access = Access(settings.address, [*settings.host_names, *_own_names()], _token(settings))
        self.files = _read_files()
        self.browsers: Set[LiveHandler] = set()
        self.state, self.picture, self.pictures_made = "", b"", 0
        self._actions = 0
        self._stop, self._wanted, self._looking = threading.Event(), threading.Event(), False
        self._sockets = _bind(settings)
        self.port = self._sockets[0].getsockname()[1]
        self._loop: Optional[IOLoop] = None
        self._ready = threading.Event()
        self._pictures = Pictures(settings, self._on_picture)
        self._view = PeopleView(settings, self._pictures)
        self._threads = [threading.Thread(target=self._serve, name="web", daemon=True),
                         threading.Thread(target=self._watch, name="web people", daemon=True)]
        for thread in self._threads:
            thread.start()
        self._ready.wait()
        self._say_where()

    def spin(self) -> None:
        """Wait for the end of ROS."""
        while not (rospy.is_shutdown() or self._stop.is_set()):
            self._stop.wait(0.2)

    def close(self) -> None:
        """Close all connections, threads and subscriptions. Idempotent."""
        self._stop.set()
        self._wanted.set()
        loop, self._loop = self._loop, None
        if loop is not None:
            loop.add_callback(loop.stop)
        for thread in self._threads:
            thread.join()
        self._pictures.want(False)
        self._view.close()

    def join(self, browser: LiveHandler) -> None:
        """Take a browser in; raises RequestError when there are too many. For the loop only."""
        if len(self.browsers) >= self.settings.max_browsers:
            raise RequestError(503, "too many browsers look at this page; close some")
        self.browsers.add(browser)
        self.count()
        self._wanted.set()

    def leave(self, browser: LiveHandler) -> None:
        """A browser has gone. For the loop only."""
        self.browsers.discard(browser)
        self.count()
        if not self.browsers:
            self._wanted.clear()

    def count(self) -> None:
        """Find out whether somebody looks at pictures. For the loop only."""
        self._looking = any(not browser.paused for browser in self.browsers)

    async def carry_out(self, action: Action) -> Dict[str, Any]:
        """Return the answer of the person manager. Raises RequestError."""
        if not self.settings.actions and action.command not in LOOKING:
            raise RequestError(403, "this page is for looking only (~actions is false)")
        name = self.settings.person_manager
        try:
            return await self._in_thread(lambda: _ask(find_manager(name), action))
        except (rospy.ROSException, rospy.ServiceException) as error:
            raise RequestError(503, "{} does not answer: {}".format(name, error)) from error
        except asyncio.TimeoutError as error:
            raise RequestError(504, "{} has not answered within {:g} s, and may still do what it was asked; see its "
                               "log, or end it and start it again".format(name, ANSWER_S)) from error

    def _in_thread(self, call: Callable[[], Any]) -> Awaitable[Any]:
        """Run a call in a thread of its own, for ANSWER_S at most. For the loop only."""
        if self._actions >= MAX_ACTIONS:
            raise RequestError(503, "too many requests wait for an answer")
        self._actions += 1
        loop = asyncio.get_event_loop()
        future: "asyncio.Future[Any]" = loop.create_future()

        def finish(result: Any, error: Optional[Exception]) -> None:
            self._actions -= 1
            if future.done():
                return
            if error is None:
                future.set_result(result)
            else:
                future.set_exception(error)

        def run() -> None:
            result, error = None, None
            try:
                result = call()
            except Exception as caught:
                error = caught
            try:
                loop.call_soon_threadsafe(finish, result, error)
            except RuntimeError:    # the node has ended meanwhile
                pass

        threading.Thread(target=run, name="web action", daemon=True).start()
        return asyncio.wait_for(future, ANSWER_S)

    def _serve(self) -> None:
        """The loop, from its beginning to its end."""
        asyncio.set_event_loop(asyncio.new_event_loop())
        loop = IOLoop.current()
        routes = [(path, FileHandler) for path in _FILES] + [
            ("/people", PeopleHandler), ("/live", LiveHandler)]
        server = HTTPServer(Application([(path, handler, {"node": self}) for path, handler in routes],
                                        default_handler_class=NothingHandler, default_handler_args={"node": self},
                                        log_function=lambda handler: None, websocket_ping_interval=_PING_S,
                                        websocket_max_message_size=1024),
                            max_body_size=_MAX_REQUEST, max_header_size=_MAX_REQUEST, idle_connection_timeout=60.0)
        server.add_sockets(self._sockets)
        self._loop = loop
        self._ready.set()
        loop.start()
        server.stop()
        for browser in list(self.browsers):
            browser.close(1001, "the node ends")
        loop.run_sync(_end_tasks)
        loop.close(all_fds=True)

    def _watch(self) -> None:
        """Look at the people while somebody has the page open."""
        while not self._stop.is_set():
            try:
                if not self._wanted.is_set():
                    self._pictures.want(False)
                    self._view.rest()
                    self._wanted.wait()
                    continue
                self._pictures.want(self._looking)
                self._tell(state=json.dumps(self._view.state(), allow_nan=False))
            except Exception as error:  # one bad cycle ends nothing
                if not rospy.is_shutdown():
                    rospy.logerr_throttle(_LOG_PERIOD_S, "%s: %s: %s", rospy.get_name(), type(error).__name__, error)
            self._stop.wait(STATE_PERIOD_S)

    def _on_picture(self, data: bytes) -> None:
        self._tell(picture=data)

    def _tell(self, state: Optional[str] = None, picture: Optional[bytes] = None) -> None:
        """Give news to the browsers, from any thread."""
        loop = self._loop
        if loop is not None:
            loop.add_callback(self._take_news, state, picture)

    def _take_news(self, state: Optional[str], picture: Optional[bytes]) -> None:
        if state is not None:
            self.state = state
        if picture is not None:
            self.picture, self.pictures_made = picture, self.pictures_made + 1
        for browser in self.browsers:
            browser.wake()

    def _say_where(self) -> None:
        """Print where the page is; with the token on standard output only, which no topic and no log of ROS carries."""
        host = "[{}]".format(self.settings.address) if ":" in self.settings.address else self.settings.address
        if self.settings.address in ("0.0.0.0", "::"):
            host = socket.gethostname()
        rospy.loginfo("%s: the page is at http://%s:%d/", rospy.get_name(), host, self.port)
        if self.access.needs_token and not self.settings.token_file:
            print("{}: with the token: http://{}:{}/?token={}".format(
                rospy.get_name(), host, self.port, self.access.token), flush=True)


class _Handler(RequestHandler):
    """What all requests have in common: who may ask, and headers."""

    def initialize(self, node: WebNode) -> None:
        """Take the node."""
        self.node = node

    def prepare(self) -> None:
        """Refuse who must not see the page."""
        try:
            self.node.access.check_host(self.request.host)
            self.node.access.check_token(self.get_cookie(self.cookie, "") or "")
        except RequestError as error:
            raise HTTPError(error.status) from error

    @property
    def cookie(self) -> str:
        """Name of the cookie with the token: cookies are for all ports of a host."""
        return "ros4hri_{}".format(self.node.port)

    def set_default_headers(self) -> None:
        """Nothing may be loaded from elsewhere, shown within another page, or kept."""
        for name, value in (("Content-Security-Policy", CONTENT_POLICY), ("X-Content-Type-Options", "nosniff"),
                            ("X-Frame-Options", "DENY"), ("Referrer-Policy", "no-referrer"),
                            ("Cache-Control", "no-store"), ("Cross-Origin-Resource-Policy", "same-origin"),
                            ("Cross-Origin-Opener-Policy", "same-origin"), ("Server", "ros4hri")):
            self.set_header(name, value)

    def write_error(self, status_code: int, **kwargs: Any) -> None:
        """Answer with the reason as JSON."""
        error = kwargs.get("exc_info", (None, None))[1]
        cause = error.__cause__ if error is not None else None
        text = str(cause) if isinstance(cause, RequestError) else self._reason
        self.set_header("Content-Type", "application/json; charset=utf-8")
        self.finish(json.dumps({"success": False, "message": text}))

    def log_exception(self, *error: Any) -> None:
        """Log our own faults, not those of requests."""
        if not isinstance(error[1], HTTPError):
            rospy.logerr_throttle(_LOG_PERIOD_S, "%s: %s: %s", rospy.get_name(), error[0].__name__, error[1])


class NothingHandler(_Handler):
    """Other paths."""

    def prepare(self) -> None:
        """Say that there is nothing."""
        super().prepare()
        raise HTTPError(404)


class FileHandler(_Handler):
    """The page and what belongs to it. `/?token=...` changes the token into a cookie that scripts cannot read."""

    def prepare(self) -> None:
        """Let somebody in who brings the token in the address."""
        given = self.get_query_argument("token", "")
        if self.request.path == "/" and given and self.node.access.needs_token:
            try:
                self.node.access.check_host(self.request.host)
                self.node.access.check_token(given)
            except RequestError as error:
                raise HTTPError(error.status) from error
            self.set_cookie(self.cookie, given, httponly=True, samesite="Strict")
            self.redirect("/")
            return
        super().prepare()

    def get(self) -> None:
        """Send the file."""
        data, kind = self.node.files[self.request.path]
        self.set_header("Content-Type", kind + "; charset=utf-8")
        self.finish(data)


class PeopleHandler(_Handler):
    """Actions on people."""

    async def post(self) -> None:
        """Carry one out, and tell how it went."""
        headers, host = self.request.headers, self.request.host
        try:
            self.node.access.check_action(headers.get(ACTION_HEADER), headers.get("Origin"), host,
                                          headers.get("Content-Type", ""))
            self.finish(await self.node.carry_out(action_of(self.request.body)))
        except RequestError as error:
            raise HTTPError(error.status) from error


class LiveHandler(_Handler, WebSocketHandler):
    """The stream to one browser: what page_state makes as text, pictures as binary messages.

    The browser answers each picture with `shown`; it may say `pause` and `resume`.
    """

    paused = False

    def check_origin(self, origin: str) -> bool:
        """Let only our own page in."""
        try:
            self.node.access.check_origin(origin, self.request.host)
        except RequestError:
            return False
        return True

    def open(self, *_: str, **__: str) -> None:
        """Begin to send."""
        self._news, self._shown = asyncio.Event(), True
        try:
            self.node.join(self)
        except RequestError as error:
            self.close(1013, str(error))
            return
        self.set_nodelay(True)
        asyncio.ensure_future(self._send())

    def on_message(self, message: Any) -> None:
        """Take what the browser says."""
        if message == "shown":
            self._shown = True
        elif message in ("pause", "resume"):
            self.paused = message == "pause"
            self.node.count()
        self.wake()

    def on_close(self) -> None:
        """Let go of it."""
        self.node.leave(self)
        self.wake()

    def wake(self) -> None:
        """Something is new. For the loop only."""
        self._news.set()

    async def _send(self) -> None:
        """Send what is new, one message after the other; the older ones of a slow browser are left out."""
        state, picture = "", self.node.pictures_made
        try:
            while self in self.node.browsers:
                await self._news.wait()
                self._news.clear()
                if self.node.state != state:
                    state = self.node.state
                    await self.write_message(state)
                if self._shown and not self.paused and self.node.pictures_made != picture:
                    picture, self._shown = self.node.pictures_made, False
                    await self.write_message(self.node.picture, binary=True)
        except WebSocketClosedError:
            pass


async def _end_tasks() -> None:
    """Let the last words go out, and end what still waits."""
    await asyncio.sleep(0.05)
    tasks = [task for task in asyncio.all_tasks() if task is not asyncio.current_task()]
    for task in tasks:
        task.cancel()
    await asyncio.wait(tasks, timeout=1.0) if tasks else None


def _ask(node: str, action: Action) -> Dict[str, Any]:
    """Ask the person manager, or all nodes for their privacy notices, and return the answer as JSON data."""
    if action.command == "privacy":
        uses = collect(PRIVACY_S)
        return {"success": bool(uses), "message": notice(uses) if uses else
                "No node has said on /humans/privacy what it does."}
    if action.command == "list":
        known = service(node, "list_known", ListKnown, LIST_ANSWER_S)()
        return {"success": True, "known": known_data(known.ids, known.names, known.anonymous, known.enrolled,
                                                     known.tracked, [stamp.to_sec() for stamp in known.last_seen])}
    answer = carry_out(node, action.command, {"id": action.id, "name": action.name})
    data = {"success": bool(answer.success), "message": answer.message}
    return dict(data, data=json.loads(answer.data)) if action.command == "export" and answer.success else data


def _read_files() -> Dict[str, Tuple[bytes, str]]:
    folder = Path(rospkg.RosPack().get_path("hri_person_manager")) / "web"
    return {path: ((folder / name).read_bytes(), kind) for path, (name, kind) in _FILES.items()}


def _own_names() -> List[str]:
    name = socket.gethostname()
    return [name, name.split(".")[0], name.split(".")[0] + ".local"]


def _token(settings: WebSettings) -> str:
    """Return the token that browsers need; empty for none. Raises ParameterError for a file without a good one."""
    if not settings.token_file:
        return "" if is_local(settings.address) else secrets.token_urlsafe(24)
    try:
        lines = Path(settings.token_file).expanduser().read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ParameterError("~token_file {}: {}".format(settings.token_file, error)) from error
    token = lines[0].strip() if lines else ""
    if len(token) < 16 or not token.isascii() or not token.replace("-", "").replace("_", "").isalnum():
        raise ParameterError("~token_file {}: the first line has to be 16 or more letters, digits, - and _".format(
            settings.token_file))
    return token


def _bind(settings: WebSettings) -> List[socket.socket]:
    try:
        return bind_sockets(settings.port, settings.address)
    except OSError as error:
        raise ParameterError("port {} of {} cannot be used: {}; see ~port and ~address".format(
            settings.port, settings.address, error.strerror or error)) from error
