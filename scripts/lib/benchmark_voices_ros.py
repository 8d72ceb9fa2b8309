"""Figures of `scripts/benchmark voices` through the real node: delay of is_speaking, and processor.

Starts a master and the node, ends all that it has started. Raises BenchmarkError, with the reason and the place of the logs, when
there is no figure. Module level: standard library only.
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
PROBE = LIB / "voices_ros_probe.py"
START_S = 30.0
PATIENCE_S = 240.0


def node_figures(channels: int) -> Dict[str, object]:
    """Play a minute of sound of 1 or 4 channels to the node, without recognition of speech, and return what the probe found.

    {"cpu_percent": of one core, "seconds", "voices", "feature_messages"}, with one channel also {"onsets", "p50", "p95", "worst"}: ms
    from the first labelled sample of speech to the arrival of is_speaking.
    """
    from benchmark_run import BenchmarkError, _listens

    logs = Path(tempfile.mkdtemp(prefix="ros4hri-benchmark-"))
    port, mark = processes.free_port(), "benchmark-" + uuid.uuid4().hex
    environment = dict(os.environ, ROS_MASTER_URI="http://127.0.0.1:{}".format(port), ROS_IP="127.0.0.1",
                       ROS_LOG_DIR=str(logs / "ros"), PYTHONPATH=os.pathsep.join(
                           path for path in (str(LIB), os.environ.get("PYTHONPATH", "")) if path))
    environment.pop("ROS_HOSTNAME", None)
    environment[processes.MARK_NAME] = mark
    result = logs / "result.json"
    try:
        _start(["roscore", "-p", str(port)], environment, logs / "roscore.log")
        if not processes.wait_until(lambda: _listens(port), START_S):
            raise BenchmarkError("roscore does not answer; its log: {}".format(logs / "roscore.log"))
        _start(["roslaunch", "--wait", "hri_pipeline", "voices.launch", "speech:=false"] + _array(channels), environment,
               logs / "voices.log")
        probe = _start([sys.executable, str(PROBE), str(channels), str(result)], environment, logs / "probe.log")
        try:
            code: Optional[int] = probe.wait(timeout=PATIENCE_S)
        except subprocess.TimeoutExpired:
            code = None
        if code != 0 or not result.is_file():
            lines = (logs / "probe.log").read_text(encoding="utf-8", errors="replace").strip().splitlines()
            raise BenchmarkError("{}; logs: {}".format(lines[-1] if lines else "the probe said nothing", logs))
        found: Dict[str, object] = json.loads(result.read_text(encoding="utf-8"))
    finally:
        processes.end(mark, {os.getpid()})
    shutil.rmtree(str(logs), ignore_errors=True)
    return found


def _array(channels: int) -> List[str]:
    if channels == 1:
        return []
    from hri_pipeline.evaluation.voice_load import SQUARE
    return ["microphone_positions:=[{}]".format(", ".join(
        "'{}'".format(" ".join("{:g}".format(value) for value in place)) for place in SQUARE))]


def _start(command: List[str], environment: Dict[str, str], log: Path) -> subprocess.Popen:
    with open(str(log), "wb") as output:
        return subprocess.Popen(command, env=environment, stdin=subprocess.DEVNULL, stdout=output, stderr=output)


if __name__ == "__main__":
    print(json.dumps(node_figures(int(sys.argv[1]))))
