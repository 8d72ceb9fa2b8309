"""What the Dockerfiles run is in the repository, and can be run as it stands there."""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path
from typing import Dict

import pytest

ROOT = Path(__file__).resolve().parents[3]
FILES = sorted((ROOT / "scripts/docker").glob("*.Dockerfile"))


def test_there_are_two():
    assert [path.name for path in FILES] == ["debian-12.Dockerfile", "noetic.Dockerfile"]


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_scripts_exist_and_are_executable_or_given_to_bash(path):
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if line.startswith(("RUN ", "ENTRYPOINT "))]
    found = [(before, ROOT / name) for line in lines for before,
             name in re.findall(r'(\S+)\s*"?/opt/ros4hri/([^\s"]+)', line)]
    assert len(found) == len(lines)
    for before, script in found:
        assert script.is_file()
        assert "bash" in before or os.access(str(script), os.X_OK)


def graph_of(uri: str, ip: str, hostname: str) -> Dict[str, str]:
    """The ROS environment that a container gives to its command, of the one that it was started with."""
    script = ('set -euo pipefail; R4H_ROOT=/r; . "${0%/*}/common.sh"; . "$0"; export ROS_MASTER_URI=http://127.0.0.1:1 '
              'ROS_IP=127.0.0.1; use_given_master "$@"; env')
    told = subprocess.run(["bash", "-c", script, str(ROOT / "scripts/lib/setup.sh"), uri, ip, hostname],
                          env={"PATH": os.environ["PATH"]},
                          check=True, stdout=subprocess.PIPE, universal_newlines=True).stdout
    return {name: value for name, _,
            value in (line.partition("=") for line in told.splitlines()) if name.startswith("ROS_")}


def test_a_container_works_on_the_graph_that_it_is_given():
    assert graph_of("http://robot:11311", "10.0.0.5", "") == {"ROS_MASTER_URI": "http://robot:11311",
                                                              "ROS_IP": "10.0.0.5"}
    assert graph_of("http://robot:11311", "", "laptop") == {"ROS_MASTER_URI": "http://robot:11311",
                                                            "ROS_HOSTNAME": "laptop"}
    assert graph_of("", "", "") == {"ROS_MASTER_URI": "http://localhost:11311"}
