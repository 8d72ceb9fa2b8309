"""The two graphs of `scripts/benchmark soak`: real people of photographs and recorded speech, and simulated people.

Each has a master, the stack, and a program that listens to everything; sample() looks at all of it from outside.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import wave
from pathlib import Path
from typing import Callable, Dict, List, Sequence

import processes

from benchmarks.soak import LeastMemory
from benchmarks.stack_run import ROOT, StackRun, Usage, name_of, program_of, usage
from hri_pipeline.core.process import ends_with_parent

SPEECH = Path("/usr/share/pocketsphinx/test/data/cards")
Row = Dict[str, object]
KINDS = ("faces", "bodies", "voices", "persons")
GRAPH = "graph"
PUBLISHERS = "robot_state_publisher"
DESCRIPTION = "/human_description_"
SOURCES = ("image_source", "sound_source")
PICTURE_S, DARK_S, IMAGES_HZ, VISION_HZ, SILENCE_S = 8.0, 1.5, 3.0, 2.0, 15.0
SCENE_S, PAUSE_S, SPEED, CYCLES_HZ, STAY_S = 1200.0, 80.0, 2.0, 2.5, 60.0
"""Of the crowd: length and pause after it (s of the scene), how much faster than the wall clock, cycles per second of
the scene, and mean stay (s of the scene)."""
_START_S, _EMPTY_S = 90.0, 60.0


class SoakError(RuntimeError):
    """A graph does not run, or has ended; the text says where its log is."""


class SoakRun:
    """One master, what is launched, and the probe."""

    def __init__(self, name: str, folder: Path, launch: List[str], empty_s: float = _EMPTY_S) -> None:
        """launch: arguments for roslaunch; empty_s: most time (s) until nobody is there. Raises SoakError when nobody
        appears."""
        import rosgraph
        self.name = name
        self._empty_s = empty_s
        self._run = StackRun(folder)
        self._status = folder / "probe.json"
        self._used: Dict[int, float] = {}
        self._least = LeastMemory()
        self._looked = time.monotonic()
        self._stack = self._start("roslaunch", ["roslaunch", "-p", str(self._run.port)] + launch)
        self._master = rosgraph.Master("/soak", master_uri=self._run.uri)
        self._await(self._master.is_online, "the master")
        self._start("probe", [sys.executable, "-m", "benchmarks.soak_probe", str(self._status), "__name:=soak_probe"])
        self._await(lambda: self._now("persons") > 0, "somebody")

    def watch(self) -> None:
        """Look at the memory of each process between two samples."""
        for pid in self._run.pids():
            held = usage(pid)
            if held is not None:
                self._least.see(pid, held.rss_mb)

    def sample(self, minutes: float) -> List[Row]:
        """Return a row for each kind of process, and one for the graph; memory is the least since the last sample
        (`watch`). Raises SoakError when the stack has ended."""
        if self._stack.poll() is not None:
            raise SoakError("{}: the stack has ended; log: {}".format(self.name, self._run.folder / "roslaunch.log"))
        now = time.monotonic()
        passed, self._looked = max(now - self._looked, 1e-3), now
        found: Dict[str, Dict[int, Usage]] = {}
        for pid in self._run.pids():
            held = usage(pid)
            if held is not None:
                held = held._replace(rss_mb=self._least.take(pid, held.rss_mb))
                found.setdefault(PUBLISHERS if program_of(pid) == PUBLISHERS else name_of(pid), {})[pid] = held
        rows = [dict(self._process_row(name, held, passed), minutes=minutes, world=self.name) for name,
                held in sorted(found.items())]
        self._used = {pid: held.cpu_s for group in found.values() for pid, held in group.items()}
        return rows + [dict(self._graph_row(), minutes=minutes, world=self.name,
                            publishers=len(found.get(PUBLISHERS, {})))]

    def left_over(self) -> Dict[str, object]:
        """Wait until nobody is there, then return what is still there of those who were.

        Sources of images and sound are stopped for that; a simulated scene has pauses of its own.
        """
        self._signal(SOURCES, signal.SIGSTOP)
        try:
            if not processes.wait_until(lambda: all(self._now(kind) == 0 for kind in KINDS), self._empty_s):
                return {"still_there": {kind: self._now(kind) for kind in KINDS}}
            # A node lets go of the topics of those who have gone a moment later.
            processes.wait_until(lambda: not any(self._remains().values()), 0.5 * PAUSE_S / SPEED)
            return self._remains()
        finally:
            self._signal(SOURCES, signal.SIGCONT)

    def told(self) -> Dict[str, object]:
        """Return what the probe has written last."""
        try:
            return json.loads(self._status.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return {"now": {}, "seen": {}, "known": [], "errors": 0, "first_errors": []}

    def tracebacks(self) -> int:
        """Return how many tracebacks the stack has written."""
        log = self._run.folder / "roslaunch.log"
        return log.read_text(encoding="utf-8", errors="replace").count("Traceback (most recent call last)")

    def close(self) -> None:
        """End everything. May be called again."""
        self._run.close()

    def _start(self, name: str, command: List[str]) -> subprocess.Popen:
        # A session of its own: Ctrl-C is for the report first. When this program is killed nobody else would end it.
        return self._run.start(name, ends_with_parent(command), session=True)

    def _await(self, condition: Callable[[], bool], what: str) -> None:
        if not processes.wait_until(lambda: self._stack.poll() is not None or condition(),
                                    _START_S) or self._stack.poll() is not None:
            self.close()
            raise SoakError(
                "{}: {} did not appear within {:g} s; logs: {}".format(self.name, what, _START_S, self._run.folder)
            )

    def _process_row(self, name: str, held: Dict[int, Usage], passed: float) -> Row:
        used = sum(one.cpu_s - self._used.get(pid, 0.0 if self._used else one.cpu_s) for pid, one in held.items())
        return {"process": name, "pid": next(iter(held)) if len(held) == 1 else None, "count": len(held),
                "rss_mb": round(sum(one.rss_mb for one in held.values()), 2),
                "threads": sum(one.threads for one in held.values()),
                "fds": sum(one.fds for one in held.values()), "cpu_percent": round(100.0 * used / passed, 2)}

    def _graph_row(self) -> Row:
        told = self.told()
        row: Row = {"process": GRAPH, "known": len(told["known"]), "errors": told["errors"]}
        for kind in KINDS:
            row[kind], row[kind + "_seen"] = told["now"].get(kind, 0), told["seen"].get(kind, 0)
        try:
            published, subscribed, services = self._master.getSystemState()
            parameters = self._master.getParamNames()
        except Exception as error:      # one look is missed, the next one comes
            print("{}: the master did not answer: {}".format(self.name, error), file=sys.stderr)
            return row
        nodes = {node for table in (published, subscribed, services) for _, names in table for node in names}
        row.update(nodes=len(nodes), topics=len({topic for topic, _ in published}), services=len(services),
                   parameters=len(parameters),
                   descriptions=sum(name.startswith(DESCRIPTION) for name in parameters))
        return row

    def _remains(self) -> Dict[str, object]:
        """Topics, parameters and processes of people, while nobody is there; persons who are known keep their
        topics."""
        published, _, _ = self._master.getSystemState()
        known = set(self.told()["known"])
        topics = {topic for topic, _ in published if topic.count("/") == 4
                  and topic.startswith(tuple("/humans/{}/".format(kind) for kind in KINDS))}
        return {"topics": sorted(topic for topic in topics if topic.split("/")[2] != "persons"
                                 or topic.split("/")[3] not in known),
                "parameters": sorted(name for name in self._master.getParamNames() if name.startswith(DESCRIPTION)),
                "processes": sum(program_of(pid) == PUBLISHERS for pid in self._run.pids())}

    def _now(self, kind: str) -> int:
        # Before the probe has asked nobody can be said to be there, or to be gone.
        return int(self.told()["now"].get(kind, -1))

    def _signal(self, names: Sequence[str], number: int) -> None:
        for pid in self._run.pids():
            if name_of(pid) in names:
                os.kill(pid, number)


def pictures(folder: Path, models: Path, vision_rate: float = VISION_HZ) -> SoakRun:
    """Real people: photographs that change every few seconds, and spoken commands that are recognised, where they are
    installed."""
    import yaml
    config = yaml.safe_load((ROOT / "hri_pipeline" / "config" / "image_source.yaml").read_text(encoding="utf-8"))
    config.update(seconds_per_picture=PICTURE_S, dark_between_pictures=DARK_S)
    folder.mkdir()
    (folder / "image_source.yaml").write_text(yaml.safe_dump(config), encoding="utf-8")
    launch = ["ros4hri", "demo.launch", "rviz:=false", "source:={}".format(gather(models, folder / "photographs")),
              "source_config:={}".format(folder / "image_source.yaml"), "rate:={}".format(IMAGES_HZ),
              "vision_rate:={}".format(vision_rate)]
    if SPEECH.is_dir():
        launch += ["sound:={}".format(gather_speech(folder / "speech")),
                   "speech_grammar:={}".format(SPEECH / "cards.gram")]
    return SoakRun("pictures", folder, launch)


def gather(models: Path, folder: Path) -> Path:
    """Fill a folder with the photographs that come with the models. Raises SoakError when there are none."""
    folder.mkdir()
    for path in sorted((models / "demo").glob("*.jpg")) + sorted((models / "evaluation").glob("portrait_*.jpg")):
        (folder / path.name).symlink_to(path)
    if not any(folder.iterdir()):
        raise SoakError("no photograph in {}; run `rosrun hri_pipeline fetch_models`".format(models / "demo"))
    return folder


def gather_speech(folder: Path) -> Path:
    """Fill a folder with the packaged commands, and with a silence after them."""
    folder.mkdir()
    for path in sorted(SPEECH.glob("*.wav")):
        (folder / path.name).symlink_to(path)
    with wave.open(str(folder / "silence.wav"), "wb") as silence:
        silence.setparams((1, 2, 16000, 0, "NONE", ""))
        silence.writeframes(bytes(2 * int(16000 * SILENCE_S)))
    return folder


LAUNCH = """<launch>
  <include file="{tests}/people.launch"/>
  <include file="$(find hri_pipeline)/launch/scene_simulator.launch">
    <arg name="scene" value="{scene}"/>
    <arg name="rate" value="{rate}"/>
    <arg name="speed" value="{speed}"/>
    <arg name="publish_clock" value="true"/>
    <arg name="wait_for" value="/humans/candidate_matches"/>
  </include>
  <param name="/scene_simulator/loop_pause" value="{pause}"/>
</launch>
"""


def crowd(folder: Path, seconds: float = SCENE_S) -> SoakRun:
    """People who are thought of, faster than the clock; again and again, with a pause after `seconds` of the scene."""
    folder.mkdir()
    path = ROOT / "hri_pipeline" / "config" / "scenes" / "crowd.yaml"
    scene, launch = folder / "crowd.yaml", folder / "crowd.launch"
    scene.write_text(shortened(path.read_text(encoding="utf-8"), seconds), encoding="utf-8")
    launch.write_text(LAUNCH.format(tests=ROOT / "rosbag_tests", scene=scene, rate=CYCLES_HZ, speed=SPEED,
                                    pause=PAUSE_S), encoding="utf-8")
    return SoakRun("crowd", folder, [str(launch)], (seconds + PAUSE_S) / SPEED + _EMPTY_S)


def shortened(scene: str, seconds: float) -> str:
    """Return the text of the packaged crowd with another length, and with people who do not stay for long."""
    changed = {"duration": "{:g}".format(seconds), "stay": "{:g}".format(STAY_S)}
    lines = []
    for line in scene.splitlines():
        key = line.strip().split(":")[0]
        lines.append("{}{}: {}".format(line[:len(line) - len(line.lstrip())], key, changed[key]) if key in changed
                     else line)
    return "\n".join(lines) + "\n"
