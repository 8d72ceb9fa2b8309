"""Workspaces for scripts/check_layout: copies of the checkout, builds, and sourced environments.

Only the standard library, Python 3.8.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Dict, List, NamedTuple, Optional, Sequence, Set

STACK = ("hri_msgs", "hri_pipeline", "hri_fullbody", "hri_person_manager")
BUILD_LIMIT = 900.0  # s
INTERRUPT_PATIENCE = 20.0  # s that a command gets to end its children after an interrupt
ROS_SETUP = Path("/opt/ros/noetic/setup.bash")  # absent on Debian: its packages lie in /usr


class Result(NamedTuple):
    """Exit code (negative: signal; None: time limit) and combined output of a command."""

    code: Optional[int]
    output: str

    @property
    def good(self) -> bool:
        return self.code == 0


def system_environment(scratch: Path) -> Dict[str, str]:
    """The caller's environment without any sourced workspace, with the system's tools first.

    A Python that precedes /usr/bin on PATH (pyenv) breaks catkin_make; only an active virtual
    environment may come before.
    """
    foreign = ("ROS_", "ROSLISP_", "CATKIN_", "_CATKIN_", "AMENT_", "COLCON_")
    dropped = {"PYTHONPATH", "PYTHONHOME", "CMAKE_PREFIX_PATH", "PKG_CONFIG_PATH", "LD_LIBRARY_PATH"}
    kept = {name: value for name, value in os.environ.items()
            if name not in dropped and not name.startswith(foreign)}
    path = ["/usr/bin", "/bin", "/usr/sbin", "/sbin"]
    if "VIRTUAL_ENV" in kept:
        path.insert(0, os.path.join(kept["VIRTUAL_ENV"], "bin"))
    kept.update(PATH=":".join(path), ROS_HOME=str(scratch / "ros"), ROS_IP="127.0.0.1",
                ROS_LOG_DIR=str(scratch / "ros/log"), PYTHONDONTWRITEBYTECODE="1",
                PYTHONNOUSERSITE="1")
    return kept


def interpreter(environment: Dict[str, str]) -> str:
    """The Python that the nodes run with: of the active virtual environment, else the system's."""
    return shutil.which("python3", path=environment["PATH"]) or "/usr/bin/python3"


def run(command: Sequence[str], environment: Dict[str, str], limit: float = BUILD_LIMIT,
        directory: Optional[Path] = None) -> Result:
    """Run a command in a process group of its own, which is ended when `limit` seconds are over."""
    process = subprocess.Popen(list(command), env=environment, cwd=str(directory or "/"),
                               stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                               stderr=subprocess.STDOUT, start_new_session=True)
    try:
        output, _ = process.communicate(timeout=limit)
        return Result(process.returncode, output.decode(errors="replace"))
    except subprocess.TimeoutExpired:
        return Result(None, _end(process) + "\nnot finished after %.0f s" % limit)
    except BaseException:
        _end(process)
        raise


def _end(process: subprocess.Popen) -> str:
    """Interrupt a process group, then kill what is left; returns the output."""
    os.killpg(process.pid, signal.SIGINT)
    try:
        output, _ = process.communicate(timeout=INTERRUPT_PATIENCE)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        output, _ = process.communicate()
    return output.decode(errors="replace")


def copy_checkout(root: Path, target: Path) -> None:
    """Copy what a clone would hold: tracked and new files, nothing that git ignores."""
    listing = subprocess.run(["git", "-C", str(root), "ls-files", "-z", "-co", "--exclude-standard"],
                             stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, check=False)
    if listing.returncode != 0:  # an archive without git
        shutil.copytree(str(root), str(target), ignore=shutil.ignore_patterns(".git", ".ws"))
        return
    for name in filter(None, listing.stdout.decode().split("\0")):
        source, copy = root / name, target / name
        if source.is_file():  # a tracked file may be deleted in the working tree
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(str(source), str(copy))


def needed_packages(checkout: Path, package: str) -> Set[str]:
    """Packages of this stack that one needs to be built and run, itself included."""
    manifest = ElementTree.parse(str(checkout / package / "package.xml")).getroot()
    needed = {package}
    for entry in manifest:
        if entry.tag.endswith("depend") and entry.text in STACK:
            needed |= needed_packages(checkout, entry.text)
    return needed


class Space(NamedTuple):
    """A devel or install space, the setup file that opens it, and the workspace it belongs to."""

    name: str
    setup: Path
    workspace: Path


class Workspace:
    """A catkin workspace in a directory of its own."""

    def __init__(self, directory: Path, environment: Dict[str, str]) -> None:
        self.directory = directory
        self._environment = environment
        (directory / "src").mkdir(parents=True)

    def link(self, source: Path, name: str) -> None:
        """Put a package directory into the source space."""
        (self.directory / "src" / name).symlink_to(source, target_is_directory=True)

    def catkin_make(self, *arguments: str, languages: str = "") -> Result:
        """Build with catkin_make; `languages` are message generators to leave out."""
        return self._build(["catkin_make", "--no-color", *arguments], languages)

    def catkin_build(self, *arguments: str) -> Result:
        """Build with catkin_tools."""
        return self._build(["catkin", "build", "--no-status", "--no-color", "--no-notify", *arguments])

    def _build(self, command: List[str], languages: str = "") -> Result:
        environment = dict(self._environment, ROS_LANG_DISABLE=languages)
        python = "-DPYTHON_EXECUTABLE=" + interpreter(environment)
        return run(sourced(command + [python], ROS_SETUP), environment, directory=self.directory)

    def space(self, name: str, folder: str) -> Space:
        """One of this workspace's spaces, by its folder: devel or install."""
        return Space(name, self.directory / folder / "setup.bash", self.directory)


def sourced(command: Sequence[str], setup: Path) -> List[str]:
    """The command as bash runs it after sourcing a setup file, where that exists."""
    return ["bash", "-c", 'if [ -e "$0" ]; then . "$0" || exit 1; fi; exec "$@"', str(setup), *command]
