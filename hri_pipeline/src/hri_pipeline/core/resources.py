"""What the system gives this process of cores, threads and file descriptors.

The cores that it may use, and how much of their time is idle: affinity (taskset, `docker --cpuset-cpus`), and the
quotas of its control groups (cgroups: `docker --cpus`, CPUQuota of systemd), see cgroups(7). Threads: how many its
control groups still allow. Descriptors: as many as the system allows, and a reserve.
"""

from __future__ import annotations

import errno
import os
import re
import resource
import time
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Dict, List, Optional, Sequence, Tuple

_VERSION_2, _CPU, _USAGE, _PIDS = "", "cpu", "cpuacct", "pids"
"""Controllers by their names in /proc/self/cgroup; all those of version 2 are one line without a name."""
_ESCAPED = re.compile(r"\\([0-7]{3})")
DESCRIPTORS_HINT = ("raise the limit (ulimit -Hn; nofile in /etc/security/limits.conf, LimitNOFILE= of a systemd "
                    "service, --ulimit nofile= of docker)")
_DESCRIPTOR_RESERVE = 64
"""Descriptors that are left free for calls of the master and the like; an eighth of them all, where that is less."""
_OWN_DESCRIPTORS = "/proc/self/fd"


@dataclass(frozen=True)
class CoreTime:
    """Time that processes share. cores: how many, of a quota also a part of one. idle: how long (s) they were idle
    since some time, all together; only the difference to a reading with as many cores means anything."""

    cores: float
    idle: float


@dataclass(frozen=True)
class _Group:
    """A control group with a quota. cores: its quota. used: s; periods: those that there were, and those in which the
    quota was used up and everybody in the group stood still."""

    cores: float
    used: float
    periods: Tuple[int, int]


class Cores:
    """What this process may use of the cores. proc: of this process, see proc(5).

    The groups are those in which the process is when this is made, and all above them that are seen here: in a
    container mostly its own. Their quotas may change later.
    """

    def __init__(self, proc: Path = Path("/proc/self")) -> None:
        self._groups = _control_groups(proc)
        self._stat = proc.parent / "stat"
        self._periods = self._most_throttled()

    @property
    def count(self) -> float:
        """How many cores: those of the affinity, or the least quota where that is less."""
        return min([float(len(os.sched_getaffinity(0)))] + [group.cores for group in self._read()])

    def times(self) -> List[CoreTime]:
        """The time of the cores, and that of each quota. Raises OSError or ValueError where that of the cores is not
        known."""
        now = time.monotonic()
        return [self._of_machine()] + [CoreTime(group.cores, group.cores * now - group.used) for group in self._read()]

    def values(self) -> Dict[str, float]:
        """Return values for diagnostics; where there is a quota, also the part of the time since the last call in which
        it was used up, so that all who share it stood still."""
        values = {"cores": self.count}
        if self._read():
            before, self._periods = self._periods, self._most_throttled()
            passed = max(0, self._periods[0] - before[0])
            values["throttled_percent"] = 100.0 * max(0, self._periods[1] - before[1]) / passed if passed else 0.0
        return values

    def _of_machine(self) -> CoreTime:
        """From /proc/stat, see proc(5): the 4th and 5th number of each core are clock ticks without work."""
        ticks = {}
        for line in self._stat.read_text(encoding="ascii").splitlines():
            if not line.startswith("cpu"):
                break
            name, *numbers = line.split()
            ticks[name] = int(numbers[3]) + int(numbers[4])
        usable = {"cpu%d" % core for core in os.sched_getaffinity(0)}
        ticks.pop("cpu", None)
        if len(ticks) == len(usable):       # some containers (lxcfs) are shown theirs only, counted from 0
            usable = set(ticks)
        if not usable & set(ticks):
            raise ValueError("{} does not have the cores of this process".format(self._stat))
        return CoreTime(len(usable), sum(ticks.get(name, 0) for name in usable) / os.sysconf("SC_CLK_TCK"))

    def _read(self) -> List[_Group]:
        found = (_read_group(*group) for group in self._groups)
        return [group for group in found if group is not None]

    def _most_throttled(self) -> Tuple[int, int]:
        """Periods of the group that was throttled most."""
        return max((group.periods for group in self._read()), key=lambda periods: periods[1], default=(0, 0))


def _control_groups(proc: Path) -> List[Tuple[Path, Optional[Path]]]:
    """The directories that may hold a quota, from the process's own group up to where the hierarchy is mounted.

    Each with that of the group of the same name in version 1 of the controller `cpuacct`, which counts the time; None
    for version 2, whose groups have both.
    """
    paths, places = _places(proc, (_VERSION_2, _CPU, _USAGE))
    found: List[Tuple[Path, Optional[Path]]] = []
    for name in (_VERSION_2, _CPU):
        place, counting = places.get(name), places.get(_USAGE)
        if place is None:
            continue
        mount, own = place
        counted = counting[0] if counting is not None and paths[_USAGE] == paths[name] else mount
        for group in [PurePosixPath(own), *PurePosixPath(own).parents]:
            found.append((mount / group, None if name == _VERSION_2 else counted / group))
    return found


def _places(proc: Path, names: Sequence[str]) -> Tuple[Dict[str, str], Dict[str, Optional[Tuple[Path, str]]]]:
    """Return the paths of the process's groups by controller, and what _mounted() says of these names of them."""
    paths: Dict[str, str] = {}
    try:
        for line in (proc / "cgroup").read_text().splitlines():
            _, controllers, path = line.split(":", 2)
            paths.update((name, path) for name in controllers.split(","))
        mounts = (proc / "mountinfo").read_text().splitlines()
        return paths, {name: _mounted(name, paths[name], mounts) for name in names if name in paths}
    except (OSError, ValueError, LookupError):      # a system without them, or another one
        return {}, {}


def fullest_group(proc: Path = Path("/proc/self")) -> Optional[Tuple[int, int]]:
    """Return how many processes and threads there are in the fullest control group of this process, and how many there
    may be (pids.max: `docker --pids-limit`, TasksMax of systemd); None where that is not limited."""
    found = []
    for place in _places(proc, (_VERSION_2, _PIDS))[1].values():
        mount, own = place or (Path(), "")
        for group in [PurePosixPath(own), *PurePosixPath(own).parents] if place is not None else ():
            try:
                used, most = (int((mount / group / name).read_text()) for name in ("pids.current", "pids.max"))
                found.append((used / max(most, 1), used, most))
            except (OSError, ValueError):           # none, or "max"
                continue
    return max(found)[1:] if found else None


def _mounted(name: str, path: str, mounts: List[str]) -> Optional[Tuple[Path, str]]:
    """Where the hierarchy of a controller is mounted, and the group `path` below that: "" for the mount itself, which
    is the group of a container, also where the path is not seen from in here."""
    fallback = None
    for line in mounts:
        fields, _, rest = line.partition(" - ")
        kind, *others = rest.split()
        if not (kind == "cgroup2" if name == _VERSION_2 else kind == "cgroup" and name in others[-1].split(",")):
            continue
        root, mount = (_ESCAPED.sub(lambda code: chr(int(code.group(1), 8)), text) for text in fields.split()[3:5])
        if ".." not in PurePosixPath(path).parts and PurePosixPath(root) in [PurePosixPath(path),
                                                                             *PurePosixPath(path).parents]:
            return Path(mount), str(PurePosixPath(path).relative_to(root))
        fallback = fallback or (Path(mount), "")
    return fallback


def _read_group(directory: Path, counted: Optional[Path]) -> Optional[_Group]:
    """Read a group; None where it has no quota. counted: see _control_groups."""
    try:
        if counted is None:
            quota, period = (directory / "cpu.max").read_text().split()
        else:
            quota, period = ((directory / name).read_text().strip() for name in ("cpu.cfs_quota_us",
                                                                                  "cpu.cfs_period_us"))
        if quota in ("max", "-1"):
            return None
        cores = int(quota) / int(period)
        stat = {key: int(value) for key, value in (
            line.split() for line in (directory / "cpu.stat").read_text().splitlines())}
        return _Group(cores, _used(stat, counted), (stat.get("nr_periods", 0), stat.get("nr_throttled", 0)))
    except (OSError, ValueError, LookupError, ArithmeticError):     # there is none, or it has gone
        return None


def _used(stat: Dict[str, int], counted: Optional[Path]) -> float:
    """Processor time (s) that a group has used."""
    if counted is None:
        return 1e-6 * stat["usage_usec"]
    try:
        return 1e-9 * int((counted / "cpuacct.usage").read_text())
    except (OSError, ValueError):
        # Of others in the group only that is known for which all had to wait.
        return time.process_time() + 1e-9 * stat.get("throttled_time", 0)


def raise_limit() -> None:
    """Raise the limit of descriptors as far as it goes. Idempotent."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft != hard:
        try:
            resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
        except (OSError, ValueError):   # more than the kernel gives to anybody
            pass


def descriptor_limit() -> int:
    """Return how many descriptors this process may have."""
    soft = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    return 2 ** 31 if soft == resource.RLIM_INFINITY else soft


def descriptors_used() -> int:
    """Return how many descriptors this process has open, 0 if unknown."""
    try:
        return len(os.listdir(_OWN_DESCRIPTORS)) - 1
    except OSError as error:
        return descriptor_limit() if error.errno == errno.EMFILE else 0


def descriptors_are_short(part: float = 1.0) -> bool:
    """Return whether fewer descriptors are free than this part (0 to 1) of the reserve."""
    most = descriptor_limit()
    return most - descriptors_used() < part * min(_DESCRIPTOR_RESERVE, most // 8)


def require_descriptors() -> None:
    """Raise OSError if only the reserve of descriptors is left: then no topic should be opened.

    Without a free descriptor for calls of the master, rospy would try for ever, and no topic could be opened or closed.
    """
    if descriptors_are_short():
        raise OSError(
            errno.EMFILE, "too few file descriptors are left of {}: {}".format(descriptor_limit(), DESCRIPTORS_HINT)
        )


def descriptors_status() -> Tuple[bool, str, Dict[str, object]]:
    """Return whether descriptors are short, a message, and values for diagnostics."""
    most, count = descriptor_limit(), descriptors_used()
    values: Dict[str, object] = {"used": count, "limit": most}
    if descriptors_are_short():
        return True, ("{} of {} file descriptors are used: new topics and connections wait; {}".format(
            count, most, DESCRIPTORS_HINT)), values
    return False, "{} of {} used".format(count, most), values
