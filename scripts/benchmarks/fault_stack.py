"""The stack in which faults are made: simulated people, or photographed people and recorded speech; nodes to kill,
sources to stop, and what is left of the processes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
import uuid
from collections import Counter
from pathlib import Path
from typing import BinaryIO, Dict, List, NamedTuple, Optional, Sequence, Set, Tuple, Union

import processes
import psutil
import rosgraph

from benchmarks.report import models_directory
from benchmarks.stack_run import ROOT, ROSMASTER, StackRun, command_of

BAG_TESTS = ROOT / "rosbag_tests"
sys.path.insert(0, str(BAG_TESTS))
import fault_graph  # noqa: E402

PATIENCE_S = 60.0
RECOGNISER = "asr.worker"
_END_S = 15.0


class FaultStack(StackRun):
    """A master of its own, which this process uses too, and launch files by name; close() ends all of it.

    place: where logs and temporary files are made, a new folder when None. Raises StackRunError when no master comes.
    """

    def __init__(self, place: Optional[Path] = None) -> None:
        self._output = tempfile.TemporaryFile()     # not on a disk that is to be filled
        super().__init__(place)
        self.environment["TMPDIR"] = str(self.folder)
        os.environ.update(self.environment)
        os.environ.pop("ROS_HOSTNAME", None)
        self._launched: Dict[str, subprocess.Popen] = {}
        try:
            # Not the master of roslaunch, which ends everything with its master.
            self.start_master(ROSMASTER)
        except RuntimeError:
            self.close()
            raise

    def start(self, name: str, command: Sequence[str], output: Union[int, BinaryIO, None] = None,
              session: bool = False) -> subprocess.Popen:
        """Start a program; all of them write to one file, see said()."""
        return subprocess.Popen(list(command), env=self.environment, stdin=subprocess.DEVNULL, stdout=self._output,
                                stderr=self._output, start_new_session=session)

    def launch(self, name: str, text: str) -> None:
        """Start a launch file with these lines in it."""
        master = rosgraph.Master("/faults")
        if not master.hasParam("/run_id"):
            # Each roslaunch makes one otherwise, and two that start together refuse each other's.
            master.setParam("/run_id", str(uuid.uuid4()))
        path = self.folder / (name + ".launch")
        path.write_text("<launch>\n{}\n</launch>\n".format(text), encoding="utf-8")
        self._launched[name] = self.start(name, ["roslaunch", str(path)])

    def end(self, name: str) -> None:
        """End a launch file as Ctrl-C does, and wait for it."""
        process = self._launched.pop(name, None)
        if process is not None:
            process.send_signal(signal.SIGINT)
            try:
                process.wait(_END_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def kill_node(self, node: str) -> Optional[int]:
        """Kill a node without mercy; returns the process id that it had, None where it does not answer."""
        pid = fault_graph.pid_of(node)
        if pid is not None:
            os.kill(pid, signal.SIGKILL)
        return pid

    def restart_master(self) -> None:
        """Kill the master, and start another at the same place."""
        for pid in self.pids_of("rosmaster"):
            os.kill(pid, signal.SIGKILL)
        processes.wait_until(lambda: not rosgraph.is_master_online(), PATIENCE_S)
        self.start_master(ROSMASTER)

    def pids_of(self, word: str) -> List[int]:
        """Return the processes of this run with this in their command line."""
        return [pid for pid in self.pids() if _mentions(pid, word)]

    def running(self) -> "Counter[str]":
        """How many processes there are of each name of a node, or program; recognisers whose node lives are as many as
        it needs."""
        pids = self.pids()
        names = [_name(pid) for pid in pids if not _mentions(pid, RECOGNISER) or _parent(pid) not in pids]
        return Counter(filter(None, names))     # one that ends at this moment has none

    def said(self) -> str:
        """All that the launch files have printed."""
        self._output.flush()
        return Path("/proc/self/fd/{}".format(self._output.fileno())).read_text(encoding="utf-8", errors="replace")

    def last_lines(self) -> str:
        """The last lines of said(), in one."""
        return " | ".join(self.said().strip().splitlines()[-12:])

    def close(self) -> None:
        """End everything. Idempotent."""
        for name in list(self._launched):
            self.end(name)
        super().close()
        self._output.close()
        self.remove_logs()


def _mentions(pid: int, word: str) -> bool:
    """Tell whether the command line of a process has this word in it."""
    return any(word in part for part in command_of(pid))


def _parent(pid: int) -> int:
    """Process id of the parent, 0 for a process that has gone."""
    try:
        return int(psutil.Process(pid).ppid())
    except psutil.Error:
        return 0


def _name(pid: int) -> str:
    """What tells a process of this run from the others: its node name, or its program."""
    words = command_of(pid)
    return next((word for word in words if word.startswith("__name:=")), " ".join(words[:3]))


def odd_processes(now: "Counter[str]", before: "Counter[str]", bodies: Set[str]) -> List[str]:
    """Names of processes that there are more of, or fewer, than before; those of a body are right while it is there."""
    prefix = "__name:=rsp_"
    orphans = {name for name in now if name.startswith(prefix) and name[len(prefix):] not in bodies}
    return sorted(orphans | {name for name in set(now) | set(before) if not name.startswith(prefix)
                             and now[name] != before[name]})


def unplugged_for(seconds: float) -> None:
    """Let so much time (s) pass."""
    deadline = time.monotonic() + seconds
    processes.wait_until(lambda: time.monotonic() > deadline, seconds + 1.0)


SPEECH = Path("/usr/share/pocketsphinx/test/data/cards")
PICTURE = "sample5.jpg"
PEOPLE = ("ann", "bob", "cho", "dan", "eve")
_SIMULATED = """<include file="{tests}/people.launch">
  <arg name="respawn" value="true"/> <arg name="sim_time" value="false"/> <arg name="store" value="{{store}}"/>
</include>"""
_SCENE = """<include file="$(find hri_pipeline)/launch/scene_simulator.launch">
  <arg name="scene" value="{tests}/five_stand.yaml"/> <arg name="respawn" value="true"/>
</include>
<param name="scene_simulator/matches" value="false"/>"""
_REAL = """<include file="$(find ros4hri)/launch/ros4hri.launch">
  <arg name="store" value="{{store}}"/> <arg name="overlay" value="false"/>
  <arg name="one_process" value="{one_process}"/>
  <arg name="depth" value="/camera/depth/image_raw"/>
  <arg name="voices" value="{hears}"/> <arg name="microphone_frame" value="microphone"/>
  <arg name="speech_grammar" value="{speech}/cards.gram"/>
</include>
<node name="camera_in_map" pkg="tf2_ros" type="static_transform_publisher"
  args="0 0 1.5 -0.5 0.5 -0.5 0.5 map camera_color_optical_frame"/>
<node name="microphone_in_map" pkg="tf2_ros" type="static_transform_publisher"
  args="0 0 1.5 0 0 0 1 map microphone"/>"""
_CAMERA = """<include file="$(find hri_pipeline)/launch/image_source.launch">
  <arg name="source" value="{picture}"/> <arg name="rate" value="10"/> <arg name="respawn" value="true"/>
  <arg name="image" value="/camera/image_raw"/> <arg name="camera_info" value="/camera/camera_info"/>
</include>"""
_MICROPHONE = """
<include file="$(find hri_pipeline)/launch/sound_source.launch">
  <arg name="source" value="{speech}"/> <arg name="audio" value="/audio"/> <arg name="audio_info" value="/audio_info"/>
  <arg name="respawn" value="true"/>
</include>"""
_MINDS = ("/hri_person_manager", "/hri_face_body_matcher", "/hri_voice_matcher", "/hri_interactions")


class Fixture(NamedTuple):
    """Launch files (stack: with a place for {store}), and what to expect of them.

    names: who is there, empty where only the number is known, count. nodes, sources: what is killed. skeletons: there
    are robot_state_publishers. hears: there is a recogniser of speech. not_flooded: begins of topics that are no inputs
    from outside.
    """

    stack: str
    source: str
    nodes: Tuple[str, ...]
    sources: Tuple[str, ...]
    names: Tuple[str, ...] = ()
    count: int = 5
    skeletons: bool = False
    hears: bool = False
    not_flooded: Tuple[str, ...] = ()


def fixture(name: str, folder: Path) -> Fixture:
    """Return what runs in a world; a picture is made in `folder`. Raises RuntimeError when something is missing for
    it."""
    if name in ("simulated", "disk"):
        return Fixture(_SIMULATED.format(tests=BAG_TESTS), _SCENE.format(tests=BAG_TESTS), _MINDS,
                       ("/scene_simulator",), PEOPLE,
                       not_flooded=("/humans/persons/",))
    return _real(folder, name == "vision")


def _real(folder: Path, one_process: bool) -> Fixture:
    """Photographed people: with faces and bodies in one process and no sound, or in two and with speech."""
    import cv2

    from benchmarks.scenes import one_picture
    if not SPEECH.is_dir():
        raise RuntimeError("{} is missing: apt install pocketsphinx-testdata".format(SPEECH))
    models = models_directory()
    picture = folder / "people.png"
    try:
        cv2.imwrite(str(picture), one_picture(models / "demo" / PICTURE))
    except OSError as error:
        raise RuntimeError(str(error)) from error
    stack = _REAL.format(one_process=str(one_process).lower(), hears=str(not one_process).lower(), speech=SPEECH)
    camera, microphone = _CAMERA.format(picture=picture), _MICROPHONE.format(speech=SPEECH)
    sensors_only = ("/humans/", "/tf", "/rosout", "/diagnostics")
    if one_process:
        minds = tuple(node for node in _MINDS if node != "/hri_voice_matcher")
        return Fixture(stack, camera, ("/hri_vision", *minds), ("/image_source",), skeletons=True,
                       not_flooded=sensors_only)
    return Fixture(stack, camera + microphone, ("/hri_faces", "/hri_bodies", "/hri_voices", *_MINDS),
                   ("/image_source", "/sound_source"),
                   skeletons=True, hears=True, not_flooded=sensors_only)
