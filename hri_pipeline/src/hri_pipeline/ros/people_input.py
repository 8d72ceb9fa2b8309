"""The people of the ROS graph, the frame in which they are compared, and where the robot is in it."""

from __future__ import annotations

import math
import threading
import time
from typing import Counter, Dict, List, Mapping, NamedTuple, Optional, Set, Tuple

import genpy
import numpy as np
import rospy
from std_msgs.msg import Bool, String

from hri_msgs.msg import FacialActionUnits
from hri_pipeline.core.frames import is_optical, read, read_parent, read_stamp
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.ids import is_valid_id
from hri_pipeline.core.interactions.parameters import InteractionSettings
from hri_pipeline.core.interactions.people import PeopleSnapshot, PeopleTf, Places, PoseAt, Seen, gather
from hri_pipeline.core.timing import ClockSynchroniser, Order, SourceStamps, StaleStampFilter, Stamp
from hri_pipeline.ros.conversions import has_gaze_of_closed_eyes
from hri_pipeline.ros.subscriptions import IdSubscribers
from hri_pipeline.ros.tf import Frames, RobotTf, TfSubscriber

MAX_PEOPLE = 100
AU_EYES_CLOSED, AU_BLINK = 43, 45
_STAMPED_BY = (b"face_", b"body_")


class StampedPeople(NamedTuple):
    """Everybody at the stamp of the newest image; unplaced: ids of those who are tracked, but have no place."""

    stamp: genpy.Time
    people: PeopleSnapshot
    unplaced: List[str]


class PeopleInput:
    """Subscribes to lists, features and transforms of persons; `changed` is set when frames with a newer stamp have
    come.

    Callbacks only store; take() makes one snapshot of them.
    """

    def __init__(self, settings: InteractionSettings, robot: RobotTf) -> None:
        """robot: takes the frames that are no human's."""
        self._settings, self._robot = settings, robot
        self._lock = threading.Lock()
        self._tf = PeopleTf()
        self._closures: Dict[str, Seen] = {}
        self._voice_of: Dict[str, str] = {}
        self._speaking: Dict[str, bool] = {}
        self._newest, self._newest_person = genpy.Time(), genpy.Time()
        self._stamps, self._time, self._stale_stamps = SourceStamps(), ClockSynchroniser(), StaleStampFilter()
        self._measured_at = -math.inf
        self._noted: Optional[Tuple[Tuple[bytes, bytes], Stamp]] = None     # of this message, by kind and camera
        self.changed = threading.Event()
        self.refused = self.jumps = 0
        features = {"face_id": String, "body_id": String, "voice_id": String}
        self._feeds = {"persons": IdSubscribers("persons", features, self._on_feature, self._on_people,
                                                max_ids=MAX_PEOPLE, list_timeout=settings.list_timeout)}
        self._feeds["voices"] = IdSubscribers("voices", {"is_speaking": Bool}, self._on_speaking, self._on_voices,
                                              max_ids=MAX_PEOPLE, list_timeout=settings.list_timeout)
        if settings.use_facs or has_gaze_of_closed_eyes(settings.interface):
            self._feeds["faces"] = IdSubscribers("faces", {"facs": FacialActionUnits}, self._on_facs, self._on_faces,
                                                 max_ids=MAX_PEOPLE, list_timeout=settings.list_timeout)
        self._subscriber = TfSubscriber(self._on_frames)

    def reconfigure(self, settings: InteractionSettings) -> None:
        """Take up the values of the live parameters."""
        self._settings = settings

    @property
    def stamp(self) -> genpy.Time:
        """Stamp of the newest frame of a face or a body; of a person's where these have ended.

        Where the clocks of cameras differ, the time of the first one goes on.
        """
        with self._lock:
            return self._stamp()

    @property
    def ids(self) -> List[str]:
        """Who is tracked."""
        with self._lock:
            return list(self._tf.people)

    @property
    def feeds(self) -> Mapping[str, IdSubscribers]:
        """The feeds by kind, for diagnostics."""
        return self._feeds

    def take(self, places: Places, pose_at: Optional[PoseAt] = None) -> StampedPeople:
        """Return everybody at the newest stamp, in the frame that `places` and `pose_at` are about."""
        with self._lock:
            stamp = self._stamp()
            shifts = {str(sensor): shift for sensor, shift in self._time.shifts.items()}
            people = gather(self._tf, places, stamp.to_sec(), self._settings, self._closures, shifts, pose_at)
            if self._speaking:
                people.speaking = np.array([self._speaking.get(self._voice_of.get(identity, ""), False)
                                            for identity in people.ids], dtype=bool)
            tracked = self._tf.people
            placed = set(people.ids) if len(people) < len(tracked) else tracked
            return StampedPeople(stamp, people, [identity for identity in tracked if identity not in placed])

    def reset(self, seconds: float) -> None:
        """Forget all moving frames: the clock has gone back by so much."""
        with self._lock:
            self._stale_stamps.went_back(seconds, time.monotonic())
            self._forget()

    def status(self) -> Dict[str, object]:
        """Return how much is kept, for diagnostics."""
        with self._lock:
            return {"human frames": len(self._tf), "robot frames": self._robot.known,
                    "frames with history": len(self._robot.relevant),
                    "transforms refused": self.refused + self._tf.refused,
                    "messages refused": self._subscriber.refused, "time jumps": self.jumps}

    def close(self) -> None:
        """Close all topics. Idempotent."""
        for feed in self._feeds.values():
            feed.close()
        self._subscriber.close()

    def _stamp(self) -> genpy.Time:
        # The frames of persons who are not seen at the moment are sent again with the time of the clock.
        if self._measures_come():
            return self._newest
        apart = (self._newest_person - self._newest).to_sec()
        return self._newest_person if apart > self._settings.frame_timeout else self._newest

    def _on_people(self, ids: List[str]) -> None:
        with self._lock:
            if list(self._tf.people) != ids:
                self._tf.set_people(ids)
                self._voice_of = {person: voice for person, voice in self._voice_of.items() if person in ids}
        self.changed.set()

    def _on_feature(self, person: str, name: str, message: String) -> None:
        value = message.data
        if value and not is_valid_id(value):
            raise ValueError("{!r} is not an id".format(value[:40]))
        with self._lock:
            if name == "voice_id":
                self._voice_of[person] = value
            else:
                self._tf.set_feature(person, "face" if name == "face_id" else "body", value)

    def _on_voices(self, ids: List[str]) -> None:
        with self._lock:
            self._speaking = {voice: speaks for voice, speaks in self._speaking.items() if voice in ids}

    def _on_speaking(self, voice: str, name: str, message: Bool) -> None:
        with self._lock:
            self._speaking[voice] = bool(message.data)

    def _on_faces(self, ids: List[str]) -> None:
        with self._lock:
            self._closures = {face: seen for face, seen in self._closures.items() if face in ids}

    def _on_facs(self, face: str, name: str, message: FacialActionUnits) -> None:
        if min(len(message.intensity), len(message.confidence)) <= AU_BLINK:
            raise ValueError("action units without number {}".format(AU_BLINK))
        closed = max((message.intensity[unit] for unit in (AU_EYES_CLOSED, AU_BLINK)
                      if message.confidence[unit] > 0.0 and math.isfinite(message.intensity[unit])), default=None)
        if closed is not None:
            with self._lock:
                self._closures[face] = Seen(message.header.stamp.to_sec(), float(closed))

    def _on_frames(self, data: bytes, frames: Frames, fixed: bool) -> None:
        with self._lock:
            kept, clock, now = self._tf, rospy.get_time(), time.monotonic()
            self._noted = None
            for child, offset in frames:
                child = child.lstrip(b"/")
                if not kept.wants(child):
                    if fixed or not kept.is_limb(child):
                        self._take_other(child, data, offset, fixed)
                elif fixed:
                    kept.put(read(data, offset), fixed)
                else:
                    secs, nsecs = read_stamp(data, offset)
                    # What is of the time before the clock went back is left out.
                    if not self._stale_stamps.is_stale(secs + 1e-9 * nsecs, clock, now):
                        # First its stamp: where time has jumped back, this frame is the first one.
                        self._note(child, data, offset, (secs, nsecs), now)
                        kept.put_unread(child, data, offset)

    def _measures_come(self) -> bool:
        """Tell whether frames of faces or bodies come: those of persons start no cycle then."""
        return time.monotonic() - self._measured_at < self._settings.frame_timeout

    def _take_other(self, child: bytes, data: bytes, offset: int, fixed: bool) -> None:
        try:
            transform = self._tf.take_other(child, data, offset, fixed)
            if transform is not None:
                self._robot.put(transform, fixed)
        except ValueError:
            self.refused += 1

    def _note(self, child: bytes, data: bytes, offset: int, when: Stamp, now: float) -> None:
        """Note the stamp of a frame that comes at `now` (s), and start a cycle where it is a newer one.

        All faces, and all bodies, of a camera come in the order of their images; other frames each in their own.
        """
        measured = child.startswith(_STAMPED_BY)
        parent = read_parent(data, offset) if measured else b""
        source = (child[:5], parent) if measured else child
        # Hundreds a second: the other faces of an image tell nothing new, and stamps are compared as plain numbers.
        if (source, when) == self._noted:
            return
        order = self._stamps.note(source, when, now)
        if order == Order.BACK:
            self.jumps += 1
            self._forget_moving()
        if measured:
            self._noted = source, when
            when = self._in_common_time(parent, when, now)
        newest = self._newest if measured else self._newest_person
        if when <= (newest.secs, newest.nsecs):
            return
        if measured:
            self._newest, self._measured_at = genpy.Time(*when), now
        else:
            self._newest_person = genpy.Time(*when)
        if measured or not self._measures_come():
            self.changed.set()

    def _in_common_time(self, parent: bytes, when: Stamp, now: float) -> Stamp:
        """Return a stamp of a sensor, whose clock may differ from that of the others."""
        seconds = when[0] + 1e-9 * when[1]
        shift = self._time.note(parent.lstrip(b"/").decode("utf-8", "replace"), seconds, now,
                                self._settings.frame_timeout)
        if not shift:
            return when
        shifted = genpy.Time.from_sec(max(seconds + shift, 0.0))
        return shifted.secs, shifted.nsecs

    def _forget(self) -> None:
        self._stamps.clear()
        self._forget_moving()

    def _forget_moving(self) -> None:
        self._tf.clear_moving()
        self._closures.clear()
        self._time.clear()
        self._newest = self._newest_person = genpy.Time()
        self._robot.reset()


GRACE_S = 2.0       # wall time in which the transforms may still be on their way when everything starts
LEVEL = Pose(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.zeros(3))
"""An upright camera's optical frame seen from a frame at the same place with x forward and z up (REP-103)."""


class RobotPose(NamedTuple):
    """Where the robot is (3,) m, and where it looks (3,)."""

    position: np.ndarray
    heading: np.ndarray


class InteractionFrame:
    """Chooses the frame of each cycle: the reference frame, else that of the sensor that sees most people.

    Warns once when nothing leads to the reference frame, and once when the frame of the robot is not known.
    """

    def __init__(self, settings: InteractionSettings, frames: RobotTf) -> None:
        self._reference, self._robot_frame = settings.reference_frame, settings.robot_frame
        self._is_optical = is_optical(self._reference)
        self._frames = frames
        self._stamp = genpy.Time()
        self._poses: Dict[str, Optional[Pose]] = {}
        self._missing_since: Dict[str, float] = {}
        self._warned: Set[str] = set()
        self._began = time.monotonic()
        self.name = self._reference
        self.sensor = ""
        self.robot: Optional[RobotPose] = None
        self.robot_source = "unknown"

    @property
    def is_level(self) -> bool:
        """Tell whether people are compared in LEVEL of the optical frame `name`, for want of a level reference
        frame."""
        return self._is_optical or self.name != self._reference

    @property
    def unconnected(self) -> Set[str]:
        """Return the sensor frames from which nothing leads to the reference frame."""
        return set(self._missing_since)

    def begin(self, stamp: genpy.Time) -> None:
        """Begin a cycle at `stamp`."""
        self._stamp = stamp
        self._poses = {}

    def places(self, sensors: Counter[str]) -> Dict[str, Pose]:
        """Return the poses of these sensors, with the number of their people, in the frame of this cycle."""
        poses = {sensor: self._lookup(sensor) for sensor in sensors}
        found = {sensor: pose for sensor, pose in poses.items() if pose is not None}
        self._note([sensor for sensor, pose in poses.items() if pose is None])
        self._choose(Counter({sensor: count for sensor, count in sensors.items()
                              if self._is_optical or sensor != self._reference}))
        if found or not sensors:
            self.name = self._reference
        else:
            self.name = self.sensor
            found = {self.sensor: LEVEL}
        self._find_robot(found)
        return found

    def pose_at(self, sensor: str, stamp: float) -> Optional[Pose]:
        """Return the pose of a sensor in the frame of this cycle at a stamp (s); None where that is not known."""
        if self.is_level or stamp <= 0.0 or sensor == self._reference:
            return None
        return self._frames.lookup(sensor, genpy.Time.from_sec(stamp))

    def _lookup(self, frame: str) -> Optional[Pose]:
        """Look a frame up, once in a cycle: the robot often looks from where its camera is."""
        if frame not in self._poses:
            pose = self._frames.lookup(frame, self._stamp)
            self._poses[frame] = LEVEL.compose(pose) if self._is_optical and pose is not None else pose
        return self._poses[frame]

    def _choose(self, sensors: Counter[str]) -> None:
        """Choose the camera that stands for the robot; it stays while it sees anybody."""
        if sensors and not sensors.get(self.sensor):
            self.sensor = sensors.most_common(1)[0][0]

    def _find_robot(self, poses: Dict[str, Pose]) -> None:
        pose, source = None, self._robot_frame
        is_reference = self.name == self._reference
        if source and is_reference:
            pose = self._lookup(source)
        if pose is None:
            self._warn_of_robot()
            source = self.sensor
            pose = poses.get(source) or (self._lookup(source) if source and is_reference else None)
        if pose is None:
            self.robot, self.robot_source = None, "unknown"
            return
        # Frames of sensors without `optical` in their name are taken for optical ones in LEVEL only.
        axis = 2 if is_optical(source) or (self.is_level and source == self.sensor) else 0
        self.robot = RobotPose(pose.translation, pose.rotation[:, axis])
        self.robot_source = source

    def _note(self, missing: list) -> None:
        for sensor in missing:
            self._missing_since.setdefault(sensor, time.monotonic())
        for sensor in [sensor for sensor in self._missing_since if sensor not in missing]:
            del self._missing_since[sensor]
        late = [sensor for sensor in missing if time.monotonic() - self._missing_since[sensor] > GRACE_S]
        if late and "reference" not in self._warned:
            self._warned.add("reference")
            rospy.logwarn(
                "no transform leads from %s to the reference frame %s: people are compared in %s, which is taken for "
                "level, and only those of one such sensor. Start what publishes the position of the robot "
                "(localisation, or static_transform_publisher from %s), or set the parameter /humans/reference_frame "
                "to a frame that exists, for example odom or base_link.", late[0], self._reference, late[0],
                self._reference)

    def _warn_of_robot(self) -> None:
        if "robot" in self._warned or time.monotonic() - self._began < GRACE_S or not self.sensor:
            return
        self._warned.add("robot")
        if self._robot_frame:
            rospy.logwarn("no transform leads from the robot_frame %s to %s: the robot is taken to be where its camera "
                          "%s is, and to look where that looks.", self._robot_frame, self._reference, self.sensor)
        else:
            rospy.logwarn("robot_frame is not set: the robot is taken to be where its camera %s is, and to look where "
                          "that looks. Set ~robot_frame, or /humans/robot_reference_frame, to the frame of the robot's "
                          "head.", self.sensor)
