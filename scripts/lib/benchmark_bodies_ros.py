"""Figures of `scripts/benchmark bodies` that need ROS: frames, robot_state_publishers, the whole node.

Each function starts a master of its own, measures, ends all that it has started, and returns the figure. It raises
BenchmarkError, with the reason and the place of the logs, when there is none. Module level: standard library only.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import uuid
from pathlib import Path
from typing import Dict, List, Optional

import processes

LIB = Path(__file__).resolve().parent
ROOT = LIB.parent.parent
PROBE = LIB / "bodies_ros_probe.py"
START_S = 30.0
PEOPLE = 3
DETAILS: Dict[str, dict] = {}
"""What else was measured with a figure, by the name of its function."""
# As fast as joint states are published, so that every image that is looked at has its frames.
RATE_HZ = 15.0


def tf_fk_error_m() -> float:
    """Largest distance (m), or difference of axes, of the frames on /tf from the forward kinematics of what was sent."""
    return _figure("tf_fk_error_m", "frames", "tf_fk_error_m", 60.0)


def rsp_first_tf_s() -> float:
    """Time (s) from a body's coming to the moment when a listener has all of its frames, the largest of 6.

    DETAILS: `ten`: the slowest of ten bodies that come at once, median of 3 rounds.
    """
    return _figure("rsp_first_tf_s", "first", "one", 120.0)


def rsp_cpu_percent_10() -> float:
    """Processor, % of one core, of ten robot_state_publishers together at 15 Hz. DETAILS: that of the `master`."""
    return _figure("rsp_cpu_percent_10", "cpu", "all", 90.0)


def churn_500() -> Dict[str, float]:
    """Growth over 500 bodies that come and go: fds, threads, rss_mb of the owner; processes and params of all."""
    found = _probe("churn", 400.0)
    DETAILS["churn_500"] = found
    return {name: found[name] for name in ("fds", "threads", "rss_mb", "processes", "params")}


def head_face_median_m() -> float:
    """Median over the people of the six demonstration photographs of |head_ID - face_ID| (m), through the whole stack.

    DETAILS: that of each person.
    """
    return _figure("head_face_median_m", "heads", "head_face_median_m", 400.0)


def cpu_ms_per_body_frame(seconds: float = 20.0) -> float:
    """Processor time (ms) of the bodies node and its robot_state_publishers, per body and image; three people at 15 Hz.

    Faces run in another process and are not counted. DETAILS: the parts of `node` and of `publishers`.
    """
    import cv2
    from benchmark_run import BenchmarkError, Run
    from benchmark_scenes import make_scene

    models = Path(os.environ.get("ROS4HRI_MODELS") or Path.home() / ".cache/ros4hri/models")
    logs = Path(tempfile.mkdtemp(prefix="ros4hri-benchmark-"))
    scene = logs / "scene.png"
    cv2.imwrite(str(scene), make_scene(PEOPLE, models / "demo"))
    run = Run(scene, logs, ["rate:={}".format(RATE_HZ), "overlay:=false"])
    try:
        seen = run.measure(PEOPLE, seconds)
    finally:
        run.close()
    # Of all ids: on a machine that is too slow, a body may be lost and found again under another one.
    frames = sum(seen["rates"].get("body", []))
    if not frames:
        raise BenchmarkError("no body had a frame; logs: {}".format(logs))
    shutil.rmtree(str(logs), ignore_errors=True)
    cpu = seen["cpu_percent"]
    node = sum(value for name, value in cpu.items() if name == "hri_bodies")
    publishers = sum(value for name, value in cpu.items() if name.startswith("rsp_"))
    if not node:
        raise BenchmarkError("there is no process hri_bodies among {}".format(", ".join(sorted(cpu))))
    DETAILS["cpu_ms_per_body_frame"] = {
        "node": round(10.0 * node / frames, 2), "publishers": round(10.0 * publishers / frames, 2),
        "frames_per_second_and_body": round(frames / PEOPLE, 2), "bodies_tracked_at_most": seen["most_tracked"].get("bodies"),
        "stages_ms": seen["stages_ms"].get("hri_bodies", {})}
    return round(10.0 * (node + publishers) / frames, 2)


def _figure(name: str, probe: str, key: str, patience: float) -> float:
    found = _probe(probe, patience)
    DETAILS[name] = found
    return float(found[key])


def _probe(figure: str, patience: float) -> dict:
    """Run a figure of the probe on a master of its own and return what it has found."""
    from benchmark_run import BenchmarkError, _listens

    logs = Path(tempfile.mkdtemp(prefix="ros4hri-benchmark-"))
    port, mark = processes.free_port(), "benchmark-" + uuid.uuid4().hex
    environment = dict(os.environ, ROS_MASTER_URI="http://127.0.0.1:{}".format(port), ROS_IP="127.0.0.1",
                       ROS_LOG_DIR=str(logs / "ros"))
    environment.pop("ROS_HOSTNAME", None)
    environment[processes.MARK_NAME] = mark
    paths = [str(LIB), str(ROOT / "hri_fullbody" / "test" / "ros"), environment.get("PYTHONPATH", "")]
    environment["PYTHONPATH"] = os.pathsep.join(path for path in paths if path)
    try:
        _start(["roscore", "-p", str(port)], environment, logs / "roscore.log")
        if not processes.wait_until(lambda: _listens(port), START_S):
            raise BenchmarkError("roscore does not answer; its log: {}".format(logs / "roscore.log"))
        result = logs / "result.json"
        probe = _start([sys.executable, str(PROBE), figure, str(result)], environment, logs / "probe.log")
        try:
            code: Optional[int] = probe.wait(timeout=patience)
        except subprocess.TimeoutExpired:
            code = None
        if code != 0 or not result.is_file():
            raise BenchmarkError("{}: {}; log: {}".format(
                figure, "not done after {:g} s".format(patience) if code is None else _last_line(logs / "probe.log"),
                logs / "probe.log"))
        found = json.loads(result.read_text(encoding="utf-8"))
    finally:
        processes.end(mark, {os.getpid()})
    shutil.rmtree(str(logs), ignore_errors=True)
    return found


def _start(command: List[str], environment: Dict[str, str], log: Path) -> subprocess.Popen:
    with open(str(log), "wb") as output:
        return subprocess.Popen(command, env=environment, stdin=subprocess.DEVNULL, stdout=output, stderr=output)


def _last_line(log: Path) -> str:
    lines = [line for line in log.read_text(encoding="utf-8", errors="replace").splitlines() if line.strip()]
    return lines[-1] if lines else "it said nothing"


def main(arguments: List[str]) -> int:
    """Print the figures named, or all, as JSON: for a look at one of them."""
    figures = {function.__name__: function for function in (
        tf_fk_error_m, rsp_first_tf_s, rsp_cpu_percent_10, churn_500, cpu_ms_per_body_frame, head_face_median_m)}
    for name in arguments or figures:
        print(json.dumps({name: figures[name](), "details": DETAILS.get(name)}), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
