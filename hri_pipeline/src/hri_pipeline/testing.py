"""For tests that run nodes: waits for conditions, in wall time, a camera, a browser, and what a process holds."""

from __future__ import annotations

import base64
import itertools
import json
import os
import resource
import shutil
import signal
import subprocess
import tempfile
import threading
import time
from contextlib import contextmanager
from typing import Any, Callable, Iterator, List, NamedTuple, Optional, Set, Union
from urllib.request import urlopen
from xmlrpc.client import ServerProxy

import cv2
import numpy as np
import rosgraph
import rospy
from geometry_msgs.msg import TransformStamped
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from tornado.ioloop import IOLoop
from tornado.websocket import WebSocketClientConnection, websocket_connect

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.onnx import models_directory
from hri_pipeline.ros.conversions import bgr_to_image, make_header
from hri_pipeline.ros.rospy_compat import release

_LOOK_S = 0.01
FRAME = "test_camera_optical"


class Held(NamedTuple):
    """What a process holds: numbers of descriptors and threads, resident memory in MB."""

    descriptors: int
    threads: int
    rss_mb: float


class Latest:
    """Keeps the messages of a topic."""

    def __init__(self, topic: str, kind: Any) -> None:
        self.messages: List[Any] = []
        self._subscriber = rospy.Subscriber(topic, kind, self.messages.append, queue_size=20)

    @property
    def value(self) -> Any:
        """The newest message, None before the first."""
        return self.messages[-1] if self.messages else None

    @property
    def data(self) -> Any:
        """What the newest message of std_msgs holds, None before the first."""
        return getattr(self.value, "data", None)

    def close(self) -> None:
        """Stop listening. Idempotent."""
        self._subscriber.unregister()


def photograph(number: int, width: int = 960) -> np.ndarray:
    """Return the demonstration picture sample<number>.jpg, (H, width, 3) uint8 BGR. AssertionError without it."""
    path = models_directory() / "demo" / "sample{}.jpg".format(number)
    picture = cv2.imread(str(path))
    if picture is None:
        raise AssertionError("{} is missing: run `rosrun hri_pipeline fetch_models`".format(path))
    return cv2.resize(picture, (width, width * picture.shape[0] // picture.shape[1]), interpolation=cv2.INTER_AREA)


Shown = Union[None, np.ndarray, Image, Callable[[], np.ndarray]]
"""A picture (H, W, 3) uint8 BGR; a message, sent with another header; a function that returns a picture; nothing."""


class Camera:
    """Publishes the same picture again and again, with camera_info, until close().

    Parameters
    ----------
    shown
        What is published; None: nothing yet.
    image, info : str
        Topics; an empty `info`: none.
    rate : float
        Hz.
    frame : str
        frame_id of the headers.
    fov : float
        Horizontal field of view, rad; 0: not calibrated.
    behind : float
        Age of the stamps, s.
    kind : type
        Image or CompressedImage.
    """

    def __init__(self, shown: Shown = None, image: str = "image", info: str = "camera_info", rate: float = 6.0,
                 frame: str = FRAME, fov: float = 1.05, behind: float = 0.0, kind: type = Image) -> None:
        self.stamps: Set[rospy.Time] = set()
        self._shown, self._size = shown, (0, 0)
        self._rate, self._frame, self._fov, self._behind, self._kind = rate, frame, fov, behind, kind
        self._image = rospy.Publisher(image, kind, queue_size=1)
        self._info = rospy.Publisher(info, CameraInfo, queue_size=1) if info else None
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def show(self, shown: Shown) -> None:
        """Publish something else from now on."""
        self._shown = shown

    def close(self) -> None:
        """Stop. Idempotent."""
        self._closed.set()
        self._thread.join()
        for publisher in (self._image, self._info):
            if publisher is not None:
                release(publisher)

    def _run(self) -> None:
        while not self._closed.wait(1.0 / self._rate):
            shown = self._shown
            if shown is not None:
                self._publish(shown() if callable(shown) else shown)

    def _publish(self, shown: Union[np.ndarray, Image]) -> None:
        header = make_header(rospy.Time.now() - rospy.Duration(self._behind), self._frame)
        if not isinstance(shown, np.ndarray):
            message, message.header = shown, header
        else:
            self._size = shown.shape[1], shown.shape[0]
            message = bgr_to_image(shown, header) if self._kind is Image else CompressedImage(
                header=header, format="jpeg", data=cv2.imencode(".jpg", shown)[1].tobytes())
        self.stamps.add(header.stamp)
        if self._info is not None:
            info = CameraInfo(header=header, width=self._size[0], height=self._size[1], distortion_model="plumb_bob",
                              D=[0.0] * 5)
            if self._fov > 0.0:
                info.K = CameraModel.from_fov(*self._size, self._fov).matrix.ravel().tolist()
            self._info.publish(info)
        self._image.publish(message)


def transform(parent: str, child: str, stamp: rospy.Time, x: float = 0.0, y: float = 0.0,
              z: float = 0.0) -> TransformStamped:
    """Return the transform of a frame at x, y, z (m) in its parent, with the same axes."""
    message = TransformStamped(child_frame_id=child)
    message.header.frame_id, message.header.stamp = parent, stamp
    place = message.transform.translation
    place.x, place.y, place.z = x, y, z
    message.transform.rotation.w = 1.0
    return message


def wait_for(condition: Callable[[], object], timeout: float, what: Union[str, Callable[[], str]],
             act: Optional[Callable[[], object]] = None, period: float = _LOOK_S) -> object:
    """Return the first value of the condition that is true; it is looked at every `period` s, each time after `act`.

    Raises AssertionError after `timeout` s, which says `what` has not come; called then if it is a function.
    """
    deadline = time.monotonic() + timeout
    while True:
        if act is not None:
            act()
        value = condition()
        if value:
            return value
        if time.monotonic() > deadline:
            raise AssertionError("not within {:g} s: {}".format(timeout, what() if callable(what) else what))
        time.sleep(period)


@contextmanager
def without_descriptors(left: int = 0) -> Iterator[None]:
    """No more than `left` descriptors can be opened by this process in the block."""
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(map(int, os.listdir("/proc/self/fd"))) + 5, limits[1]))
    fillers = []
    try:
        while True:
            fillers.append(os.open(os.devnull, os.O_RDONLY))
    except OSError:
        pass
    try:
        for filler in fillers[len(fillers) - left:]:
            os.close(filler)
        fillers = fillers[:len(fillers) - left]
        yield
    finally:
        for filler in fillers:
            os.close(filler)
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)


def pid_of(node: str) -> int:
    """Return the process id of a node.

    Raises rosgraph.MasterException when there is no such node, OSError when it is dead.
    """
    master = rosgraph.Master("/testing")
    return ServerProxy(master.lookupNode(node)).getPid("/testing")[2]


def held_by(pid: int) -> Held:
    """Return what a process holds. Raises OSError when there is no such process."""
    with open("/proc/{}/status".format(pid), encoding="ascii", errors="replace") as status:
        fields = dict(line.split(":", 1) for line in status)
    return Held(len(os.listdir("/proc/{}/fd".format(pid))), int(fields["Threads"]),
                int(fields["VmRSS"].split()[0]) / 1024.0)


class HeardProcess:
    """A child process, and a thread that runs read() until nothing more comes from it."""

    def __init__(self, process: subprocess.Popen, read: Callable[[], None]) -> None:
        self.process = process
        self._reader = threading.Thread(target=read, daemon=True)
        self._reader.start()

    def code(self, timeout: float = 40.0) -> int:
        """Return its exit status once it has ended and all is read.

        Raises subprocess.TimeoutExpired after `timeout` s.
        """
        code = self.process.wait(timeout)
        self._reader.join(10.0)
        return code

    def kill(self) -> None:
        """End it without mercy. Idempotent."""
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        self._reader.join(10.0)


BROWSERS = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")


class Browser:
    """Chromium without a window, by its DevTools protocol (chromedevtools.github.io/devtools-protocol).

    Parameters
    ----------
    width, height : int
        Of the page, px.
    dark : bool
        What the page is told of the user's wishes.

    Raises
    ------
    FileNotFoundError
        Where there is no Chromium.
    """

    def __init__(self, width: int = 1280, height: int = 900, dark: bool = False) -> None:
        program = next((found for found in map(shutil.which, BROWSERS) if found), None)
        if program is None:
            raise FileNotFoundError("there is none of " + ", ".join(BROWSERS))
        self._folder = tempfile.mkdtemp(prefix="ros4hri-browser-")
        self._loop = IOLoop(make_current=False)
        self._number, self._closed = itertools.count(1), False
        self._process = subprocess.Popen(
            [program, "--headless", "--no-sandbox", "--disable-gpu", "--remote-debugging-port=0",
             "--user-data-dir=" + self._folder, "about:blank"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            start_new_session=True)
        try:
            self._connection = self._connect()
            self.command("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1,
                         mobile=False)
            self.command("Emulation.setEmulatedMedia", features=[
                {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}])
        except BaseException:
            self.close()
            raise

    def _connect(self) -> WebSocketClientConnection:
        port = os.path.join(self._folder, "DevToolsActivePort")
        wait_for(lambda: os.path.exists(port) and open(port, encoding="ascii").read().count("\n"), 30.0, "a browser")
        with open(port, encoding="ascii") as lines:
            base = "http://127.0.0.1:{}/json/list".format(lines.readline().strip())
        page = wait_for(lambda: [one for one in json.loads(urlopen(base, timeout=10.0).read())
                                 if one["type"] == "page"], 30.0, "an empty page")
        return self._loop.run_sync(
            lambda: websocket_connect(page[0]["webSocketDebuggerUrl"], max_message_size=2 ** 26))

    def command(self, method: str, **parameters: Any) -> Any:
        """Give a command of the protocol, and return its result. AssertionError when it is refused."""
        number = next(self._number)
        text = json.dumps({"id": number, "method": method, "params": parameters})
        self._loop.run_sync(lambda: self._connection.write_message(text))
        while True:
            answer = json.loads(self._loop.run_sync(self._connection.read_message, timeout=60.0) or "null")
            if answer is None:
                raise AssertionError("the browser has gone")
            if answer.get("id") == number:
                assert "error" not in answer, answer
                return answer["result"]

    def open(self, url: str) -> None:
        """Go to a page."""
        self.command("Page.navigate", url=url)

    def value(self, expression: str) -> Any:
        """Return the value of a JavaScript expression, of a promise its result. AssertionError when it throws."""
        result = self.command("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in result, result
        return result["result"].get("value")

    def picture(self, path: str, whole: bool = False) -> None:
        """Write what is seen as PNG; whole: the page in its whole length."""
        data = self.command("Page.captureScreenshot", format="png", captureBeyondViewport=whole)["data"]
        with open(path, "wb") as file:
            file.write(base64.b64decode(data))

    def close(self) -> None:
        """End it. Idempotent."""
        if not self._closed:
            self._closed = True
            os.killpg(self._process.pid, signal.SIGKILL)    # Debian's program is a shell script around the browser
            self._process.wait()
            self._loop.close(all_fds=True)
        shutil.rmtree(self._folder, ignore_errors=True)
