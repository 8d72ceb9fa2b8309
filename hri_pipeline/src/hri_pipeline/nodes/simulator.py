"""The nodes scene_simulator (a scene file in; faces, bodies, voices, persons and the truth out) and sample_conversation
(faces with moving mouths, voices, and where they are)."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Dict, List, Optional

import numpy as np
import rospkg
import rospy
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Bool
from tf2_msgs.msg import TFMessage

from hri_msgs.msg import FacialActionUnits, IdsMatch
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.ids import IdGenerator
from hri_pipeline.core.parameters import ParameterError
from hri_pipeline.core.simulation.conversation import (
    RATE_HZ,
    UNSEEN,
    Heard,
    Mouths,
    SampleConversationSettings,
    Turn,
    directions,
    hear,
    make_mouth,
    make_turns,
)
from hri_pipeline.core.simulation.parameters import PERSONS, SceneSettings
from hri_pipeline.core.simulation.scene_file import Scene, SceneError, load_scene
from hri_pipeline.core.simulation.sensors import SceneMatches, Senses, camera_pose
from hri_pipeline.core.simulation.world import SceneTruth, World
from hri_pipeline.ros.conversions import action_units_to_msg, make_header, match_to_msg, transform_to_msg
from hri_pipeline.ros.diagnostics import OK, WARN, NodeDiagnostics
from hri_pipeline.ros.node import end_simulated_time
from hri_pipeline.ros.publishers import IdPublishers, TopicSpec, TrackedList
from hri_pipeline.ros.rospy_compat import release
from hri_pipeline.ros.scene_topics import SceneFeatures, ScenePersons, SceneTruthTopics, upright
from hri_pipeline.ros.tf import TfPublisher

_LOOK_FOR_LISTENERS_S = 0.05
_REPORT_S = 1.0
_SLOW = 0.9
_BACK_S = 1.0       # a clock may be so much before the begin of the scene; further back it has jumped


def find_scene(name: str) -> Path:
    """Return the file of a scene: a path, or a name in hri_pipeline/config/scenes. Raises ParameterError with the names
    there are."""
    given = Path(name).expanduser()
    folder = Path(rospkg.RosPack().get_path("hri_pipeline")) / "config" / "scenes"
    for path in (given, folder / (name + ".yaml")):
        if path.is_file():
            return path
    raise ParameterError("~scene is {!r}, which is no file; legal: a path, or one of {}".format(
        name, ", ".join(sorted(path.stem for path in folder.glob("*.yaml")))))


def read_scene(name: str) -> Scene:
    """Load a scene. Raises ParameterError that says what is wrong in the file."""
    try:
        return load_scene(find_scene(name))
    except SceneError as error:
        raise ParameterError("~scene: {}".format(error)) from error


class SceneSimulatorNode:
    """Plays a scene in the thread that calls spin(). settings: the values of SCENE_PARAMETERS.

    With publish_clock the node makes the time: stamps are the scene's time, counted on from the wall time at the start.
    Without, it follows rospy's time, and leaves cycles out when it is late.
    """

    def __init__(self, settings: SceneSettings) -> None:
        if settings.speed != 1.0 and not settings.publish_clock:
            raise ParameterError("~speed is {:g}, legal without ~publish_clock: 1".format(settings.speed))
        self._settings = settings
        self._scene = read_scene(settings.scene)
        self._world = World(self._scene, settings.seed)
        self._senses = Senses(settings, settings.seed, self._scene.robot.height)
        self._matches = SceneMatches(settings, settings.seed)
        self._stop = threading.Event()
        self._clock = rospy.Publisher("/clock", Clock, queue_size=10) if settings.publish_clock else None
        self._transforms = TfPublisher()
        self._features = SceneFeatures(settings, self._transforms)
        self._persons = ScenePersons(settings, self._transforms) if settings.level == PERSONS else None
        self._truth = SceneTruthTopics(settings.reference_frame, self._scene.text) if settings.truth else None
        self._fixed = rospy.Publisher("/tf_static", TFMessage, queue_size=1,
                                      latch=True) if settings.publish_robot else None
        self._diagnostics = NodeDiagnostics(rospy.get_name())
        self._reported, self._cycles = time.monotonic(), 0
        self._listeners = 0
        rospy.on_shutdown(self._stop.set)

    def spin(self) -> None:
        """Play until the end of the scene or of ROS."""
        self._warn_of_clock()
        if self._fixed is not None:
            self._fixed.publish(TFMessage(transforms=self._robot_frames()))
        base = time.time() if self._clock is not None else self._first_time()
        self._wait_for_listener(base)
        rospy.loginfo("%s: %s, %g s, %d people in all; only who is in the camera's view, or heard, is published",
                      rospy.get_name(), self._scene.name, self._scene.duration, len(self._scene.people))
        base = base if self._clock is not None else self._first_time()
        while not self._stop.is_set():
            in_time = self._play(base, self._scene.duration, True)
            if not self._settings.loop and in_time:
                break
            self._empty(base + self._scene.duration if in_time else rospy.get_time())
            if in_time and self._play(base + self._scene.duration, self._settings.loop_pause, False):
                base += self._scene.duration + self._settings.loop_pause
            else:
                rospy.logwarn_throttle(10.0, "%s: time has gone back; the scene begins anew", rospy.get_name())
                base = self._first_time()

    def close(self) -> None:
        """Let everybody go and take everything back. Idempotent."""
        self._stop.set()
        for owner in (self._features, self._persons, self._truth, self._transforms, self._diagnostics):
            if owner is not None:
                owner.close()
        for publisher in (self._clock, self._fixed):
            if publisher is not None:
                release(publisher)
        if self._clock is not None:
            end_simulated_time()

    def _play(self, base: float, duration: float, live: bool) -> bool:
        """Go through `duration` s of the scene, or of the pause between two, from the time `base` (s) on.

        Returns False when time has gone back before `base`.
        """
        period, number, started = 1.0 / self._settings.rate, 0, time.monotonic()
        while not self._stop.is_set() and number * period < duration:
            late = self._wait(base, number * period, started)
            if late < 0.0:
                return False
            if late > period:
                number += int(late / period)
                if number * period >= duration:
                    break
            if live:
                self._cycle(self._world.at(number * period), rospy.Time.from_sec(base + number * period))
            number += 1
        return True

    def _wait(self, base: float, t: float, started: float) -> float:
        """Wait for the time `t` (s) of the scene.

        Returns how late it is, s: 0 with a clock of our own, for then time itself waits; -1 when time has gone back.
        """
        if self._clock is not None:
            self._stop.wait(max(0.0, started + t / self._settings.speed - time.monotonic()))
            self._clock.publish(Clock(clock=rospy.Time.from_sec(base + t)))
            return 0.0
        while not self._stop.is_set():
            ahead = base + t - rospy.get_time()
            if ahead <= 0.0:
                return -ahead
            if ahead > t + _BACK_S:
                return -1.0
            # A simulated clock tells no end in wall time: look again soon.
            self._stop.wait(min(ahead, 0.05))
        return 0.0

    def _cycle(self, truth: SceneTruth, stamp: rospy.Time) -> None:
        sensed = self._senses.sense(truth)
        self._features.publish(sensed, stamp)
        if self._persons is not None:
            self._persons.publish(sensed, stamp)
        else:
            listeners = self._features.listeners()
            if listeners > self._listeners:
                self._matches.reset()   # whoever has just come has heard nothing
            self._listeners = listeners
            self._features.publish_matches(self._matches.update(sensed))
        if self._truth is not None:
            self._truth.publish(truth, sensed.visible, stamp)
        self._cycles += 1
        self._report(truth, len(sensed.visible))

    def _empty(self, now: float) -> None:
        """The scene is over: everybody leaves."""
        stamp = rospy.Time.from_sec(now)
        self._features.clear(stamp)
        if self._persons is not None:
            self._persons.clear(stamp)
        if self._truth is not None:
            self._truth.publish(SceneTruth(0.0, (), (), (0.0, 0.0, 0.0)), (), stamp)
        self._matches.reset()
        self._senses.reset()

    def _report(self, truth: SceneTruth, in_view: int) -> None:
        passed = time.monotonic() - self._reported
        if passed < _REPORT_S:
            return
        speed = self._cycles / self._settings.rate / passed
        self._reported, self._cycles = time.monotonic(), 0
        slow = speed < _SLOW * self._settings.speed
        text = "{}: {} people at {:.0f} s, {} in view".format(self._scene.name, len(truth.people), truth.stamp, in_view)
        if slow:
            text += "; {:.1f} times real time instead of {:g}: lower ~rate or ~speed".format(
                speed, self._settings.speed
            )
        self._diagnostics.set("scene", WARN if slow else OK, text, {
            "people": len(truth.people), "in_view": in_view, "groups": len(truth.groups), "time_s": truth.stamp,
            "speed": speed, "transforms_dropped": self._transforms.dropped})

    def _robot_frames(self) -> list:
        settings, robot = self._settings, self._scene.robot
        now = rospy.Time.from_sec(0.0)
        base = upright(*robot.position, 0.0, robot.yaw)
        camera = base.inverse().compose(camera_pose(*robot.position, robot.yaw, robot.height))
        return [transform_to_msg(base, now, settings.reference_frame, settings.robot_frame),
                transform_to_msg(camera, now, settings.robot_frame, settings.camera_frame),
                transform_to_msg(upright(0.0, 0.0, robot.height, 0.0), now, settings.robot_frame,
                                 settings.microphone_frame)]

    def _wait_for_listener(self, now: float) -> None:
        """Wait until somebody subscribes to the topic `wait_for`.

        Our own clock stands at `now` (s): some wait for any time at all.
        """
        wanted = self._settings.wait_for
        if not wanted:
            return
        name, told = rospy.resolve_name(wanted), False
        while not self._stop.is_set():
            _, subscribed, _ = rospy.get_master().getSystemState()[2]
            if any(topic == name and set(nodes) - {rospy.get_name()} for topic, nodes in subscribed):
                return
            if not told:
                told = True
                rospy.loginfo("%s: waiting for a subscriber of %s", rospy.get_name(), name)
            if self._clock is not None:
                self._clock.publish(Clock(clock=rospy.Time.from_sec(now)))
            self._stop.wait(10.0 * _LOOK_FOR_LISTENERS_S)

    def _first_time(self) -> float:
        """The time now; with a simulated clock, as soon as it has begun."""
        now: Optional[float] = None
        while not self._stop.is_set():
            now = rospy.get_time()
            if now > 0.0:
                break
            rospy.loginfo_throttle(10.0, "%s: waiting for /clock", rospy.get_name())
            self._stop.wait(_LOOK_FOR_LISTENERS_S)
        return now or 0.0

    def _warn_of_clock(self) -> None:
        if self._clock is not None and not rospy.get_param("/use_sim_time", False):
            rospy.logwarn("%s publishes /clock, but /use_sim_time is not set: other nodes go by the wall clock, and "
                          "will take the stamps for wrong. Set /use_sim_time before they start.", rospy.get_name())


LENGTH_S = 60.0
SENSOR = "sample_sensor"
DISTANCE_M = 2.0
SPREAD, DIRECTION_SD = np.deg2rad(120.0), np.deg2rad(10.0)


class SampleConversationNode:
    """Publishes one conversation after the other; `~speaker` says of each turn whose voice it truly is."""

    def __init__(self, settings: SampleConversationSettings) -> None:
        self._settings = settings
        self._stop = threading.Event()
        self._random = np.random.default_rng(settings.seed)
        self._new_id = IdGenerator().new
        self._faces = IdPublishers("/humans/faces", {"facs": TopicSpec(FacialActionUnits)})
        self._voices = IdPublishers("/humans/voices", {"is_speaking": TopicSpec(Bool, True)})
        self._lists = {kind: TrackedList("/humans/{}/tracked".format(kind)) for kind in ("faces", "voices")}
        self._speaker = rospy.Publisher("~speaker", IdsMatch, latch=True, queue_size=10)
        self._tf = TfPublisher()
        self._said = -1
        self._ids = [self._new_id() for _ in range(settings.people)]
        self._azimuths = SPREAD * (np.arange(settings.people) - 0.5 * (settings.people - 1)) / max(1, settings.people)
        rospy.on_shutdown(self._stop.set)

    def spin(self) -> None:
        """Play until ROS shuts down."""
        for face in self._ids:
            self._faces.open(face)
        while not self._stop.is_set():
            self._play()

    def close(self) -> None:
        """Take everything back. Idempotent."""
        self._stop.set()
        for owner in (*self._lists.values(), self._tf):
            owner.close()
        self._faces.close_all()
        self._voices.close_all()
        release(self._speaker)

    def _play(self) -> None:
        """One conversation, image by image."""
        random, settings = self._random, self._settings
        turns = make_turns(random, settings.people, LENGTH_S, settings.unseen_share)
        mouths = [make_mouth(random, person, turns, LENGTH_S) for person in range(settings.people)]
        heard = hear(random, turns, settings.directions)
        names = {voice: self._new_id() for _, _, voice, _ in heard.tracked}
        times = np.arange(0.0, LENGTH_S, 1.0 / RATE_HZ)
        azimuths = {voice: directions(random, times, self._azimuths[speaker] if speaker != UNSEEN
                                      else random.uniform(-np.pi, np.pi), DIRECTION_SD)
                    for _, _, voice, speaker in heard.tracked}
        began, messages, shown = rospy.get_time(), list(heard.messages), [0] * len(mouths)
        for number, now in enumerate(times):
            while not self._stop.is_set() and rospy.get_time() < began + now:
                self._stop.wait(max(0.001, began + now - rospy.get_time()))
            if self._stop.is_set() or rospy.get_time() < began - 1.0:
                return      # the clock went back
            stamp = rospy.Time.now()
            self._lists["faces"].set(self._ids, stamp)
            tracked = self._track(heard, names, now, stamp)
            while messages and messages[0][0] <= now:
                _, voice, speaking = messages.pop(0)
                if voice in tracked:
                    self._voices.publish(names[voice], "is_speaking", Bool(speaking))
            self._show(mouths, shown, now, stamp)
            frames = {"face_" + face: azimuth for face, azimuth in zip(self._ids, self._azimuths)}
            if settings.directions:
                frames.update(("voice_" + names[voice], azimuths[voice][number]) for voice in tracked)
            self._tf.send([transform_to_msg(Pose(np.eye(3),
                                                 DISTANCE_M * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])),
                                            stamp, SENSOR, frame) for frame, azimuth in frames.items()])
            self._tell(turns, heard, names, now)

    def _track(self, heard: Heard, names: Dict[str, str], now: float, stamp: rospy.Time) -> List[str]:
        """Open and close voices; returns those that are tracked now."""
        tracked = [voice for start, end, voice, _ in heard.tracked if start <= now <= end]
        wanted = [names[voice] for voice in tracked]
        for name in wanted:
            if name not in self._voices.ids:
                self._voices.open(name)
        self._lists["voices"].set(wanted, stamp)
        for name in self._voices.ids:
            if name not in wanted:
                self._voices.close(name)
        return tracked

    def _show(self, mouths: List[Mouths], shown: List[int], now: float, stamp: rospy.Time) -> None:
        """Publish the action units of each face, where there are some at that time."""
        for person, (face, mouth) in enumerate(zip(self._ids, mouths)):
            last = int(np.searchsorted(mouth.stamps, now, side="right"))
            if last > shown[person]:
                shown[person] = last
                values, certain = np.zeros(99), np.zeros(99)
                values[[25, 26]] = mouth.lips_part[last - 1], mouth.jaw_drop[last - 1]
                certain[[25, 26]] = mouth.confidence[last - 1]
                self._faces.publish(face, "facs", action_units_to_msg(values, certain, make_header(stamp, SENSOR)))

    def _tell(self, turns: List[Turn], heard: Heard, names: Dict[str, str], now: float) -> None:
        """Say at the beginning of a turn whose voice it is; nobody's in view: the likelihood is 0."""
        number = next((number for number, turn in enumerate(turns) if turn.start <= now <= turn.end), -1)
        if number not in (-1, self._said):
            speaker = turns[number].speaker
            seen = speaker != UNSEEN
            self._speaker.publish(match_to_msg(names[heard.voice_of_turn[number]], IdsMatch.VOICE,
                                               self._ids[speaker] if seen else "", IdsMatch.FACE, float(seen)))
        self._said = number
