"""The overlay node: what the stack sees, drawn on the camera image.

Threads: callbacks of rospy only store (under a lock); pairing, drawing and publishing happen in the caller
of spin(), which never waits for the master. While nobody subscribes to the overlay, this node subscribes to nothing.
Which regions are ignored, the parameters of the nodes that take the same images say.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from typing import Deque, Dict, List, Optional, Tuple, Union

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import Float32, String

from hri_msgs.msg import Expression, GazesStamped
from hri_pipeline.core.ignored_regions import IgnoredRegions
from hri_pipeline.core.images import GreyBits, ImageError
from hri_pipeline.core.observations import FeatureHistory
from hri_pipeline.core.overlay import OverlaySettings, PersonMark, draw_overlay
from hri_pipeline.core.parameters import ParameterError
from hri_pipeline.core.timing import Pacer
from hri_pipeline.ros.conversions import (
    LandmarkArray,
    SkeletonArray,
    bgr_to_image,
    compressed_to_bgr,
    image_to_bgr,
    landmarks_from_msg,
    skeleton_from_msg,
)
from hri_pipeline.ros.diagnostics import NodeDiagnostics
from hri_pipeline.ros.master import MasterAway, parameter_of_subscribers
from hri_pipeline.ros.rospy_compat import release
from hri_pipeline.ros.subscriptions import IdSubscribers

AnyImage = Union[Image, CompressedImage]
PERSON_TOPICS = {"face_id": String, "body_id": String, "voice_id": String, "location_confidence": Float32}
# Gazes are told all the time while they last; older ones are of a node that has gone.
_GAZE_S = 1.0
_LOG_PERIOD_S = 10.0
_ASK_S, _PATIENCE_S = 5.0, 1.0      # how often, and for how long, the master is asked for what is ignored

Boxes = List[Tuple[float, float, float, float]]


class IgnoredByNodes:
    """The `ignored_regions` of the nodes that take the same images, whichever transport; () while none has any."""

    def __init__(self) -> None:
        self._asked = float("-inf")
        self._asking: Optional[threading.Thread] = None
        self._boxes: Boxes = []

    def boxes(self) -> Boxes:
        """Left, top, right, bottom of each, shares of the image; a node that was started anew is heard after 5 s.

        The master is asked in a thread of its own; until it has answered what was known counts on.
        """
        now = time.monotonic()
        if now >= self._asked + _ASK_S and not (self._asking is not None and self._asking.is_alive()):
            self._asked = now
            self._asking = threading.Thread(target=self._ask, name="ignored regions", daemon=True)
            self._asking.start()
        return self._boxes

    def _ask(self) -> None:
        topics = [rospy.resolve_name(name) for name in ("image", "image/compressed")]
        try:
            given = parameter_of_subscribers(topics, "ignored_regions", _PATIENCE_S)
            rows = {row for rows in given if isinstance(rows, list) for row in rows if isinstance(row, str)}
            self._boxes = IgnoredRegions(sorted(rows)).boxes
        except (MasterAway, ParameterError):    # what was known counts on; the nodes refuse a wrong one
            pass


class OverlayInputs:
    """All subscriptions of the overlay, with what has come in lately."""

    def __init__(self, settings: OverlaySettings) -> None:
        self._lock = threading.Lock()
        self._images: Deque[Tuple[float, AnyImage]] = deque(maxlen=settings.history)
        self._frame = ""
        self._history = FeatureHistory()
        self._persons: Dict[str, Dict[str, object]] = {}
        self._expressions: Dict[str, str] = {}
        self._gazes: Tuple[float, Dict[str, str]] = (float("-inf"), {})
        self._feeds: List[IdSubscribers] = []
        self._subscribers: List[rospy.Subscriber] = []
        try:
            self._open(settings)
        except BaseException:
            self.close()
            raise

    def _open(self, settings: OverlaySettings) -> None:
        faces = {"landmarks": LandmarkArray}
        for kind, topics, on_message, on_list in (
                ("faces", dict(faces, expression=Expression) if settings.expressions else faces, self._on_face,
                 self._on_faces),
                ("bodies", {"skeleton2d": SkeletonArray}, self._on_body, self._on_bodies),
                ("persons", dict(PERSON_TOPICS, name=String) if settings.names else PERSON_TOPICS, self._on_person,
                 self._on_persons)):
            self._feeds.append(IdSubscribers(kind, topics, on_message, on_list, list_timeout=settings.list_timeout))
        if settings.gazes:
            self._subscribers.append(rospy.Subscriber("/humans/interactions/gaze", GazesStamped, self._on_gazes,
                                                      queue_size=1))
        compressed = settings.image_transport == "compressed"
        self._subscribers.append(rospy.Subscriber(
            "image/compressed" if compressed else "image", CompressedImage if compressed else Image,
            self._on_image, queue_size=1, buff_size=2**24))

    def _on_image(self, message: AnyImage) -> None:
        # Faces and bodies have the time of arrival, too, where the camera gives no stamp.
        stamp = (rospy.Time.now() if message.header.stamp.is_zero() else message.header.stamp).to_sec()
        with self._lock:
            if self._images and stamp < self._images[-1][0]:
                # A bag has started again.
                self._images.clear()
                self._history.clear()
            self._images.append((stamp, message))
            self._frame = message.header.frame_id

    def _on_face(self, name: str, topic: str, message: Union[LandmarkArray, Expression]) -> None:
        if topic == "expression":
            with self._lock:
                self._expressions[name] = message.expression.strip('"')
            return
        self._keep("faces", name, message, landmarks_from_msg(message))

    def _on_body(self, name: str, topic: str, message: SkeletonArray) -> None:
        self._keep("bodies", name, message, skeleton_from_msg(message))

    def _keep(self, kind: str, name: str, message: Union[LandmarkArray, SkeletonArray], points: np.ndarray) -> None:
        """Keep what this camera has seen, not what another one has."""
        with self._lock:
            if not self._frame or message.header.frame_id in ("", self._frame):
                self._history.add(kind, name, message.header.stamp.to_sec(), points)

    def _on_person(self, name: str, topic: str, message: Union[String, Float32]) -> None:
        with self._lock:
            self._persons.setdefault(name, {})[topic] = message.data

    def _on_gazes(self, message: GazesStamped) -> None:
        with self._lock:
            self._gazes = (time.monotonic(), {gaze.sender: gaze.receiver for gaze in message.gazes})

    def _on_faces(self, names: List[str]) -> None:
        with self._lock:
            self._history.keep_only("faces", names)
            self._expressions = {name: word for name, word in self._expressions.items() if name in names}

    def _on_bodies(self, names: List[str]) -> None:
        with self._lock:
            self._history.keep_only("bodies", names)

    def _on_persons(self, names: List[str]) -> None:
        with self._lock:
            for name in set(self._persons) - set(names):
                del self._persons[name]

    def take(self, drawn: float, tolerance: float) -> "Optional[Tuple[float, AnyImage, dict, dict, List[PersonMark]]]":
        """Return the stamp of the image to draw on, the image, its faces, bodies (normalised points) and persons.

        None when there is no image, or only the one with the stamp `drawn`. tolerance: of stamps (s).
        """
        with self._lock:
            stamp = self._history.choose([one for one, _ in self._images], tolerance)
            if stamp is None or stamp == drawn:
                return None
            image = next(message for one, message in self._images if one == stamp)
            persons = [self._mark(name, known) for name, known in sorted(self._persons.items())]
            return (stamp, image, self._history.at("faces", stamp, tolerance),
                    self._history.at("bodies", stamp, tolerance), persons)

    def _mark(self, name: str, known: Dict[str, object]) -> PersonMark:
        """What is written about a person."""
        face = str(known.get("face_id", ""))
        told, gazes = self._gazes
        return PersonMark(name, face, str(known.get("body_id", "")), float(known.get("location_confidence", 0.0)),
                          str(known.get("name", "")), self._expressions.get(face, ""),
                          gazes.get(name) if time.monotonic() - told < _GAZE_S else None,
                          str(known.get("voice_id", "")))

    def close(self) -> None:
        """End all subscriptions. May be called again."""
        for subscriber in self._subscribers:
            release(subscriber)
        for feed in self._feeds:
            feed.close()


class OverlayNode:
    """Publishes `visualization/overlay` with the stamp of the image that it is drawn on."""

    def __init__(self, settings: OverlaySettings) -> None:
        self._settings = settings
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._wake = threading.Event()
        self._pacer = Pacer(settings.max_rate)
        self._inputs: Optional[OverlayInputs] = None
        self._drawn = -1.0
        self._grey = GreyBits()
        self._ignored = IgnoredByNodes()
        self._output = rospy.Publisher("visualization/overlay", Image, queue_size=1)
        self._diagnostics = NodeDiagnostics(rospy.get_name())
        rospy.on_shutdown(self._end)

    def spin(self) -> None:
        """Draw until the end of ROS."""
        while not (self._stop.is_set() or rospy.is_shutdown()):
            pacer = self._pacer
            if self._wake.wait(pacer.wait(time.monotonic())):
                self._wake.clear()
                continue
            pacer.done(time.monotonic())
            try:
                self._look()
            except Exception as error:  # one bad picture does not end the node
                text = "{}: {}".format(type(error).__name__, error)
                rospy.logerr_throttle(_LOG_PERIOD_S, "%s: %s", rospy.get_name(), text)
                self._diagnostics.set("overlay", DiagnosticStatus.ERROR, text)

    def _look(self) -> None:
        """Draw the next picture if somebody looks."""
        if not self._output.get_num_connections():
            self._let_go()
            self._diagnostics.set("overlay", DiagnosticStatus.OK, "nobody looks")
            return
        if self._inputs is None:
            self._inputs = OverlayInputs(self._settings)
        with self._lock:
            self._draw(self._inputs)

    def reconfigure(self, settings: OverlaySettings) -> None:
        """Take up the values of the live parameters between two pictures."""
        with self._lock:
            self._settings = settings
            self._pacer = Pacer(settings.max_rate)
        self._wake.set()

    def _draw(self, inputs: OverlayInputs) -> None:
        taken = inputs.take(self._drawn, self._settings.pair_tolerance)
        if taken is None:
            if self._drawn < 0.0:
                self._diagnostics.set("overlay", DiagnosticStatus.WARN, "no image on {} yet; is the camera on, and "
                                      "remapped to it?".format(rospy.resolve_name("image")))
            return
        self._drawn, message, faces, bodies, persons = taken
        try:
            decode = compressed_to_bgr if isinstance(message, CompressedImage) else image_to_bgr
            image = decode(message, self._grey)
        except ImageError as error:
            self._diagnostics.set("overlay", DiagnosticStatus.ERROR, str(error))
            return
        scale = np.array([image.shape[1], image.shape[0], 1.0])
        picture = draw_overlay(image, {name: points * scale for name, points in faces.items()},
                               {name: points * scale for name, points in bodies.items()},
                               persons, self._settings.min_confidence, self._ignored.boxes())
        self._output.publish(bgr_to_image(picture, message.header))
        self._diagnostics.set("overlay", DiagnosticStatus.OK, "drawing", {
            "faces": len(faces), "bodies": len(bodies), "persons": len(persons)})

    def _end(self) -> None:
        self._stop.set()
        self._wake.set()

    def _let_go(self) -> None:
        if self._inputs is not None:
            self._inputs.close()
            self._inputs, self._drawn = None, -1.0

    def close(self) -> None:
        """End all subscriptions and publishers. May be called again."""
        self._end()
        self._let_go()
        self._diagnostics.close()
        release(self._output)
