"""A simulated crowd through person manager and interactions in accelerated time: what they hold, and how right they
are.

`python3 -m benchmarks.crowd HOURS [SPEED [BAG]]` prints the figures; scripts/benchmark interactions calls `crowd`.
"""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Dict, List, Optional

import processes

from benchmarks.stack_run import ROOT, StackRun, cpu_s, usage

SPEED = 20.0
RATE = 5.0
"""Cycles per second of the scene's time: with SPEED as many messages a second as 100 images would make."""
TOPICS = ("/tf", "/tf_static", "/scene/truth/persons", "/scene/truth/visible", "/scene/truth/heads",
          "/scene/truth/gaze",
          "/scene/truth/groups", "/humans/persons/tracked", "/humans/interactions/gaze", "/humans/interactions/groups")
NODES = {"manager": "hri_person_manager", "interactions": "hri_interactions"}
_SETTLE = 0.2       # share of the time before the first look at memory
_START_S, _END_S = 60.0, 30.0
_PATIENCE = 12.0     # a busy machine plays the scene so much more slowly than asked for

LAUNCH = """<launch>
  <param name="/use_sim_time" value="true"/>
  <include file="$(find hri_person_manager)/launch/person_manager.launch"><arg name="respawn" value="false"/></include>
  <include file="$(find hri_pipeline)/launch/interactions.launch">
    <arg name="robot_frame" value="camera_color_optical_frame"/>
    <arg name="respawn" value="false"/>
  </include>
  <node name="record" pkg="rosbag" type="record" args="-b 0 -O {bag} {topics}"/>
  <include file="$(find hri_pipeline)/launch/scene_simulator.launch">
    <arg name="scene" value="{scene}"/>
    <arg name="rate" value="{rate}"/>
    <arg name="speed" value="{speed}"/>
    <arg name="publish_clock" value="true"/>
    <arg name="loop" value="false"/>
    <arg name="wait_for" value="/humans/interactions/gaze"/>
    <arg name="required" value="true"/>
  </include>
</launch>
"""


class CrowdError(RuntimeError):
    """The crowd did not run to its end."""


def crowd(hours: float = 1.0, speed: float = SPEED, keep: str = "") -> Dict[str, object]:
    """Run `hours` of a crowd of ten at `speed` times real time; returns growth of the nodes and scores. rss_mb: the
    larger growth of both, MB; new_ids: permanent ids of people who are not in the scene.

    keep: where the bag is moved to, empty: it is removed. Growth is that from one fifth of the time to the end. Raises
    CrowdError with the last line of the log.
    """
    folder = Path(tempfile.mkdtemp(prefix="ros4hri-crowd-"))
    try:
        return _run(folder, hours, speed)
    finally:
        if keep and (folder / "crowd.bag").is_file():
            shutil.move(str(folder / "crowd.bag"), keep)
        shutil.rmtree(str(folder), ignore_errors=True)


def _run(folder: Path, hours: float, speed: float) -> Dict[str, object]:
    scene, launch, bag, log = (
        folder / "crowd.yaml",
        folder / "crowd.launch",
        folder / "crowd.bag",
        folder / "roslaunch.log",
    )
    scene.write_text(_scene(3600.0 * hours), encoding="utf-8")
    launch.write_text(LAUNCH.format(scene=scene, rate=RATE, speed=speed, bag=bag, topics=" ".join(TOPICS)),
                      encoding="utf-8")
    with StackRun(folder) as run:
        process = run.start("roslaunch", ["roslaunch", "-p", str(run.port), str(launch)])
        try:
            found = _watch(process, run, 3600.0 * hours / speed)
            # rosbag closes its file on SIGINT.
            processes.wait_until(lambda: process.poll() is not None, _END_S)
        except CrowdError as error:
            text = log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
            raise CrowdError("{}; roslaunch: {}".format(error, " | ".join(text[-3:]))) from error
    if not bag.is_file():
        text = log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        raise CrowdError("no bag was recorded: {}".format(text[-1] if text else "roslaunch said nothing"))
    from hri_pipeline.score.bag import read_bag
    from hri_pipeline.score.command import ANONYMOUS, score
    record = read_bag(bag)
    figures = score(record)
    kept = ("duration_s", "persons_true", "persons_found", "persons_ids", "mota", "motp_m", "id_switches",
            "id_switches_per_hour",
            "id_switches_permanent", "fragments", "gaze_precision", "gaze_recall", "gaze_precision_lenient",
            "gaze_recall_lenient", "groups_precision",
            "groups_recall", "groups_f1")
    found.update({key: figures.get(key) for key in kept})
    people = {person for frame in record.truth for person in frame.heads}
    listed = {person for _, ids in record.tracked for person in ids if not person.startswith(ANONYMOUS)}
    found["new_ids"] = len(listed - people)
    growth = [found[name + "_rss_growth_mb"] for name in NODES if found[name + "_rss_growth_mb"] is not None]
    found["rss_mb"] = max(growth) if growth else None
    return found


def _scene(seconds: float) -> str:
    """Text of the packaged crowd, of another length."""
    path = ROOT / "hri_pipeline" / "config" / "scenes" / "crowd.yaml"
    lines = path.read_text(encoding="utf-8").splitlines()
    return "\n".join("duration: {:g}".format(seconds) if line.startswith("duration:") else line
                     for line in lines) + "\n"


def _watch(process: subprocess.Popen, run: StackRun, seconds: float) -> Dict[str, object]:
    """Look at the nodes until the simulator ends; seconds: of wall time that it wants."""
    began = _wait_for_nodes(process, run)
    samples: Dict[str, List[dict]] = {name: [] for name in NODES}
    used = {name: cpu_s(run.pid_of(node) or 0) for name, node in NODES.items()}
    while process.poll() is None and run.pid_of("scene_simulator") is not None:
        passed = time.monotonic() - began
        if passed > _PATIENCE * seconds + _START_S:
            raise CrowdError("the simulator did not end within {:.0f} s".format(passed))
        for name, node in NODES.items():
            pid = run.pid_of(node)
            held = usage(pid) if pid is not None else None
            if held is not None:
                samples[name].append(dict(held._asdict(), at=passed))
        time.sleep(1.0)
    wall = time.monotonic() - began
    found: Dict[str, object] = {"wall_s": round(wall, 1), "speed_share": round(seconds / wall, 2) if wall else None}
    for name, values in samples.items():
        found.update({"{}_{}".format(name, key): value for key, value in _growth(values, wall).items()})
        found[name + "_cpu_percent"] = round(100.0 * (values[-1]["cpu_s"] - used[name]) / wall, 1) if values else None
    return found


def _wait_for_nodes(process: subprocess.Popen, run: StackRun) -> float:
    """Wait until all nodes run; returns the time (s, monotonic)."""
    names = [*NODES.values(), "scene_simulator"]
    if not processes.wait_until(lambda: process.poll() is not None
                                or all(run.pid_of(name) is not None for name in names), _START_S):
        raise CrowdError("the nodes did not start within {:g} s".format(_START_S))
    if process.poll() is not None:
        raise CrowdError("roslaunch has ended at once")
    return time.monotonic()


def _growth(values: List[dict], wall: float) -> Dict[str, Optional[float]]:
    """Memory at the end, and growth of memory (MB), descriptors and threads: the median of the last fifth less that of
    the second."""
    early = [held for held in values if _SETTLE * wall <= held["at"] < 2.0 * _SETTLE * wall]
    late = [held for held in values if held["at"] >= (1.0 - _SETTLE) * wall]
    if not early or not late:
        return {"rss_mb": None, "rss_growth_mb": None, "fds_growth": None, "threads_growth": None}

    def middle(rows: List[dict], key: str) -> float:
        return sorted(row[key] for row in rows)[len(rows) // 2]
    return {"rss_mb": round(middle(late, "rss_mb"), 1),
            "rss_growth_mb": round(middle(late, "rss_mb") - middle(early, "rss_mb"), 2),
            "fds_growth": middle(late, "fds") - middle(early, "fds"),
            "threads_growth": middle(late, "threads") - middle(early, "threads")}


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(143))
    print(json.dumps(crowd(*(float(text) for text in sys.argv[1:3]), *sys.argv[3:4]), indent=2))
