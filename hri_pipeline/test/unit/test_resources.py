"""Cores that a process may use: affinity, and quotas of control groups of both versions, as containers show them."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hri_pipeline.core import resources
from hri_pipeline.core.resources import Cores, fullest_group

STAT = "cpu  900 0 900 4000 40 0 0 0 0 0\n" + "".join(
    "cpu%d 100 0 100 %d 5 0 0 0 0 0\n" % (number, 1000 + number) for number in range(8)) + "intr 12345 0 1\n"
V2, V1 = ("0::{}",), ("3:cpuset:/other", "2:cpu,cpuacct:{}", "1:name=systemd:{}", "0::/")
MOUNT_2 = "30 24 0:26 {root} {point} rw,nosuid shared:9 - cgroup2 cgroup2 rw,nsdelegate"
MOUNT_1 = "31 24 0:27 {root} {point} rw shared:9 - cgroup cgroup rw,cpu,cpuacct"
OTHERS = ("22 1 8:1 / / rw - ext4 /dev/sda1 rw", "23 22 0:20 / /sys/fs/cgroup rw - tmpfs tmpfs rw",
          "32 24 0:28 / /sys/fs/cgroup/memory rw - cgroup cgroup rw,memory")


class Machine:
    """A fake /proc and fake hierarchies of control groups below a directory."""

    def __init__(self, path):
        self.proc, self.groups = path / "proc" / "self", path / "groups"
        self.proc.mkdir(parents=True)
        (self.proc.parent / "stat").write_text(STAT)

    def mount(self, lines, path, mount, root="/", point=None):
        """Say in which group the process is, and where the hierarchy is mounted."""
        (self.proc / "cgroup").write_text("".join(line.format(path) + "\n" for line in lines))
        mounts = [*OTHERS, mount.format(root=root, point=point or self.groups)]
        (self.proc / "mountinfo").write_text("\n".join(mounts) + "\n")

    def v2(self, path, quota, used=0.0, periods=(0, 0)):
        self._write(path, {"cpu.max": quota, "cpu.stat": "usage_usec {:.0f}\nuser_usec 1\nnr_periods {}\n"
                           "nr_throttled {}\nthrottled_usec 77".format(1e6 * used, *periods)})

    def v1(self, path, quota, period=100000, used=0.0, periods=(0, 0), throttled=0.0):
        self._write(path, {
            "cpu.cfs_quota_us": quota, "cpu.cfs_period_us": period, "cpu.stat": "nr_periods {}\nnr_throttled {}\n"
            "throttled_time {:.0f}".format(*periods, 1e9 * throttled)})
        if used is not None:
            self._write(path, {"cpuacct.usage": int(1e9 * used)})

    def _write(self, path, files):
        (self.groups / path).mkdir(parents=True, exist_ok=True)
        for name, content in files.items():
            (self.groups / path / name).write_text("{}\n".format(content))

    def cores(self):
        return Cores(self.proc)


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """Eight cores, all allowed."""
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(8)))
    monkeypatch.setattr(resources.time, "monotonic", lambda: 100.0)
    return Machine(tmp_path)


def test_without_a_quota_it_is_the_affinity(machine, monkeypatch):
    assert machine.cores().count == 8.0, "no control groups at all"
    machine.mount(V2, "/user.slice", MOUNT_2)
    machine.v2("user.slice", "max 100000")
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {1, 2})
    found = machine.cores()
    assert found.count == 2.0 and found.values() == {"cores": 2.0}
    assert [one.cores for one in found.times()] == [2.0]
    assert found.times()[0].idle == pytest.approx((1001 + 1002 + 10) / os.sysconf("SC_CLK_TCK"))


def test_the_least_quota_of_all_groups_above_counts(machine, monkeypatch):
    machine.mount(V2, "/robot.slice/stack.service/faces", MOUNT_2)
    machine.v2("robot.slice", "350000 100000", used=40.0)
    machine.v2("robot.slice/stack.service", "100000 50000", used=30.0)
    machine.v2("robot.slice/stack.service/faces", "max 100000", used=10.0)
    machine.v2("another.slice", "1000 100000")
    found = machine.cores()
    assert found.count == 2.0
    assert [(one.cores, one.idle) for one in found.times()[1:]] == [(2.0, 170.0), (3.5, 310.0)]
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {3})
    assert found.count == 1.0


def test_in_a_container_the_mount_is_its_group(machine):
    machine.mount(V2, "/", MOUNT_2)
    machine.v2("", "150000 100000", used=1.0)
    assert machine.cores().count == 1.5


@pytest.mark.parametrize("path, root", [
    ("/docker/abc", "/docker/abc"), ("/docker/abc/inner", "/docker/abc"), ("/elsewhere", "/docker/abc"),
    ("/../../elsewhere", "/"), ("/", "/../..")])
def test_a_container_of_version_1_sees_paths_of_the_host(machine, path, root):
    machine.mount(V1, path, MOUNT_1, root)
    machine.v1("", 200000, used=20.0)
    machine.v1("inner", -1, used=5.0)
    found = machine.cores()
    assert found.count == 2.0
    assert [(one.cores, one.idle) for one in found.times()[1:]] == [(2.0, 180.0)]


def test_where_the_time_of_the_group_is_not_known_that_of_this_process_and_throttling_count(machine, monkeypatch):
    monkeypatch.setattr(resources.time, "process_time", lambda: 7.0)
    machine.mount(("2:cpu:{}", "1:cpuacct:/"), "/robot", MOUNT_1.replace(",cpuacct", ""))
    machine.v1("robot", 50000, used=None, throttled=3.0)
    assert [(one.cores, one.idle) for one in machine.cores().times()[1:]] == [(0.5, 40.0)]


def test_quotas_that_change_and_groups_that_go_are_followed(machine):
    machine.mount(V2, "/a/b", MOUNT_2)
    machine.v2("a", "max 100000")
    machine.v2("a/b", "max 100000")
    found = machine.cores()
    assert found.count == 8.0
    machine.v2("a/b", "250000 100000")
    assert found.count == 2.5
    for content in ("", "0 0", "all of them", "max"):
        machine.v2("a/b", content)
        assert found.count == 8.0, content
    (machine.groups / "a/b/cpu.max").unlink()
    assert found.count == 8.0 and len(found.times()) == 1


@pytest.mark.parametrize("file, content", [
    ("cgroup", "0::/a\nnonsense\n"), ("cgroup", "\xff\xfe"), ("mountinfo", "\n"), ("mountinfo", "1 2 3 - cgroup2\n"),
    ("mountinfo", "30 24 0:26 / /x rw - cgroup\n")])
def test_what_cannot_be_read_is_no_quota(machine, file, content):
    machine.mount(("0::/a", "1:cpu:/a"), "/a", MOUNT_2)
    machine.v2("a", "200000 100000")
    assert machine.cores().count == 2.0
    (machine.proc / file).write_text(content, encoding="latin-1")
    found = machine.cores()
    assert found.count == 8.0 and len(found.times()) == 1 and found.values() == {"cores": 8.0}


def test_mounts_with_spaces(machine, tmp_path):
    machine.groups = tmp_path / "with space"
    machine.mount(V2, "/", MOUNT_2, point=str(machine.groups).replace(" ", "\\040"))
    machine.v2("", "150000 100000")
    assert machine.cores().count == 1.5


def test_diagnostics_tell_how_often_all_stood_still(machine):
    machine.mount(V2, "/a", MOUNT_2)
    machine.v2("a", "200000 100000", periods=(1000, 500))
    found = machine.cores()
    assert found.values() == {"cores": 2.0, "throttled_percent": 0.0}
    machine.v2("a", "200000 100000", periods=(1010, 503))
    assert found.values() == {"cores": 2.0, "throttled_percent": 30.0}
    assert found.values() == {"cores": 2.0, "throttled_percent": 0.0}


def test_a_container_may_be_shown_its_own_cores_only_counted_from_0(machine, monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(40, 48)))
    (one,) = machine.cores().times()
    assert one.cores == 8 and one.idle == pytest.approx((8 * 1005 + 28) / os.sysconf("SC_CLK_TCK"))
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {40, 41})
    with pytest.raises(ValueError, match="does not have the cores"):
        machine.cores().times()


# ---------------------------------------------------------------------------------------------------------------------
# The real ones of this machine, where it lets us make a group.

PROGRAM = """
import json, os, sys, time
from hri_pipeline.core.resources import Cores
found = Cores()
first = found.times()
before, began = found.values(), time.process_time()
while time.process_time() - began < 0.15:
    pass
last = found.times()
idle = [new.idle - old.idle for old, new in zip(first, last)]
print(json.dumps([found.count, [one.cores for one in last], idle, before, found.values()]))
"""


def hierarchies():
    """Where groups with a quota can be made: those of version 1, with their time, or that of version 2."""
    if Path("/sys/fs/cgroup/cgroup.controllers").is_file():
        return [Path("/sys/fs/cgroup")]
    return [Path("/sys/fs/cgroup/cpu"), Path("/sys/fs/cgroup/cpuacct")]


@pytest.fixture
def real_group():
    """A group with a quota of a tenth of a core, with another one above it; yields the files that take processes."""
    made = []
    try:
        for hierarchy in hierarchies():
            for group in (hierarchy / "ros4hri_test_{}".format(os.getpid()),
                          hierarchy / "ros4hri_test_{}".format(os.getpid()) / "inner"):
                group.mkdir()
                made.append(group)
                if (group / "cpu.max").exists():
                    (group / "cpu.max").write_text("5000 50000" if group.name == "inner" else "50000 50000")
                elif (group / "cpu.cfs_quota_us").exists():
                    (group / "cpu.cfs_quota_us").write_text("10000" if group.name == "inner" else "100000")
                elif hierarchy.name != "cpuacct":
                    pytest.skip("this machine has no quotas")
        yield [group / "cgroup.procs" for group in made if group.name == "inner"]
    except OSError as error:
        pytest.skip("this machine lets us make no group: {}".format(error))
    finally:
        for group in made[::-1]:
            group.rmdir()


def test_a_real_quota(real_group):
    shell = "for file in {}; do echo $$ > $file; done; exec {} -c \"$0\"".format(
        " ".join(map(str, real_group)), sys.executable)
    began = time.monotonic()
    answer = subprocess.run(["bash", "-c", shell, PROGRAM], stdout=subprocess.PIPE, check=True, timeout=120.0).stdout
    took = time.monotonic() - began
    count, all_cores, idle, before, after = json.loads(answer)
    assert count == pytest.approx(0.1) and sorted(all_cores)[:2] == [pytest.approx(0.1), pytest.approx(1.0)]
    # 0.15 s of time at a tenth of a core take 1.5 s: all of it is used up again and again.
    inner, outer = idle[all_cores.index(min(all_cores))], idle[all_cores.index(sorted(all_cores)[1])]
    assert -0.03 < inner < 0.1 * took - 0.1 and outer > 0.5
    assert after["throttled_percent"] > 0.0 and before["cores"] == after["cores"] == pytest.approx(0.1)


@pytest.mark.parametrize("lines, mount", [
    (V2, MOUNT_2), (("8:pids:{}", "0::/"), MOUNT_1.replace("cpu,cpuacct", "pids"))])
def test_the_fullest_group_is_the_one_that_lets_no_more_threads_start(machine, lines, mount):
    machine.mount(lines, "/docker/abc", mount)
    assert fullest_group(machine.proc) is None
    machine._write("docker/abc", {"pids.current": 30, "pids.max": "max"})
    assert fullest_group(machine.proc) is None
    machine._write("docker", {"pids.current": 95, "pids.max": 100})
    assert fullest_group(machine.proc) == (95, 100)
    machine._write("docker/abc", {"pids.max": 300})
    assert fullest_group(machine.proc) == (95, 100)
    machine._write("docker/abc", {"pids.max": 31})
    assert fullest_group(machine.proc) == (30, 31)
