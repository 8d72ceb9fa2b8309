"""A full disk under the store of people, the logs and the temporary files of a running stack."""

from __future__ import annotations

import errno
import resource
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Callable, Dict, List, Protocol

import processes
import rospy

from benchmarks.fault_people import People
from benchmarks.fault_stack import PATIENCE_S, FaultStack, Fixture, fault_graph

SIZE = 3 * 2 ** 20
NEWCOMER = "zoe"
TOLD_S, BACK_S = 20.0, 30.0
FULL_S = 12.0       # a disk that is full for a moment only is not noticed
MEND = "make room"


class SmallDisk(Protocol):
    """A place whose room is small. how: what makes it so."""

    path: Path
    how: str

    def fill(self, pids: List[int]) -> None:
        """Leave no byte for these processes."""

    def free(self, pids: List[int]) -> None:
        """Give the room back."""

    def close(self) -> None:
        """Take it away."""


class Tmpfs:
    """A file system in memory; only root may make one."""

    def __init__(self) -> None:
        self.path = Path(tempfile.mkdtemp(prefix="ros4hri-full-"))
        self.how = "tmpfs of {:.0f} MiB, filled to the last byte".format(SIZE / 2 ** 20)
        options = ["mount", "-t", "tmpfs", "-o", "size={},mode=0700".format(SIZE), "ros4hri", str(self.path)]
        if subprocess.run(options, stderr=subprocess.DEVNULL, check=False).returncode:
            self.path.rmdir()
            raise PermissionError("no tmpfs can be mounted")
        self._filler = self.path / "filler"

    def fill(self, pids: List[int]) -> None:
        """Write until nothing more goes in."""
        with open(str(self._filler), "ab", buffering=0) as file:
            for size in (2 ** 16, 1):
                try:
                    while True:
                        file.write(bytes(size))
                except OSError as error:
                    if error.errno != errno.ENOSPC:
                        raise

    def free(self, pids: List[int]) -> None:
        """Remove what was written."""
        self._filler.unlink()

    def close(self) -> None:
        """Unmount, also what is in use still."""
        subprocess.run(["umount", "-l", str(self.path)], check=False)
        self.path.rmdir()


class FileLimit:
    """Processes that may not let a file grow: what is left to those who may not mount."""

    def __init__(self) -> None:
        self.path = Path(tempfile.mkdtemp(prefix="ros4hri-full-"))
        self.how = "RLIMIT_FSIZE 0 of each process: no tmpfs can be mounted here"

    def fill(self, pids: List[int]) -> None:
        """Forbid."""
        self._limit(pids, 0)

    def free(self, pids: List[int]) -> None:
        """Allow."""
        self._limit(pids, resource.RLIM_INFINITY)

    def close(self) -> None:
        """Remove the directory."""
        subprocess.run(["rm", "-rf", str(self.path)], check=False)

    @staticmethod
    def _limit(pids: List[int], size: int) -> None:
        for pid in pids:
            hard = resource.prlimit(pid, resource.RLIMIT_FSIZE)[1]
            resource.prlimit(pid, resource.RLIMIT_FSIZE, (size if size != resource.RLIM_INFINITY else hard, hard))


def small_disk() -> SmallDisk:
    """Return what can be had here."""
    try:
        return Tmpfs()
    except (OSError, FileNotFoundError):
        return FileLimit()


class FullDisk:
    """Fills the disk under a stack with simulated people, lets somebody new come meanwhile, and frees it again."""

    def __init__(self, stack: FaultStack, scene: Fixture, disk: SmallDisk) -> None:
        self._stack, self._disk, self._nodes = stack, disk, (*scene.nodes, *scene.sources)
        self._store = stack.folder / "people" / "people.sqlite"
        self._scene = scene
        stack.launch("stack", scene.stack.format(store=self._store))
        stack.launch("source", scene.source)
        rospy.init_node("faults", disable_signals=True)
        self._people = People()

    def run(self) -> Dict[str, object]:
        """Returns what held and what did not: {check: yes or no}, and times (s)."""
        from hri_person_manager.srv import ListKnown, SetName
        self._people.settle(self._scene.count, self._scene.names)
        name, known = (rospy.ServiceProxy("/hri_person_manager/" + service, kind) for service, kind in (
            ("set_name", SetName), ("list_known", ListKnown)))
        checks: Dict[str, object] = {"how": self._disk.how}
        checks["somebody is named before"] = name("ann", "Ann").success
        self._until(lambda: set(self._scene.names) <= set(self._stored()), BACK_S)
        before, pids = self._stored(), {node: fault_graph.pid_of(node) for node in self._nodes}
        self._disk.fill(self._stack.pids())
        filled = time.monotonic()
        stop = self._let_somebody_come()
        checks["a name that cannot be kept is refused, with the mend"] = self._is_refused(name("bob", "Bob"))
        told = self._until(lambda: any(MEND in text for texts in self._people.problems.values() for text in texts),
                           TOLD_S)
        checks["diagnostics tell the mend, after s"] = told
        processes.wait_until(lambda: time.monotonic() - filled > FULL_S, FULL_S + 1.0)
        checks["people are tracked while it is full, after s"] = self._people.until_whole(time.monotonic()).there
        checks["the same processes run"] = pids == {node: fault_graph.pid_of(node) for node in self._nodes}
        self._disk.free(self._stack.pids())
        wanted = set(before) | {NEWCOMER}
        checks["who came meanwhile is stored, after s"] = self._until(lambda: wanted <= set(self._stored()), BACK_S)
        stop()
        checks["the name is kept now"] = name("bob", "Bob").success
        checks["nothing is lost in a kill"] = self._survives_kill(known, wanted)
        checks["nothing was set aside as damaged"] = not list(self._store.parent.glob("*.damaged-*"))
        checks["stored"] = sorted(self._stored())
        self._people.close()
        return checks

    def _is_refused(self, answer: object) -> bool:
        return not answer.success and MEND in answer.message

    def _survives_kill(self, known: Callable, wanted: set) -> bool:
        """Kill the manager; tell whether the next one knows everybody, and the names."""
        old = self._stack.kill_node("/hri_person_manager")
        if not processes.wait_until(lambda: fault_graph.pid_of("/hri_person_manager") not in (None, old), PATIENCE_S):
            return False
        rospy.wait_for_service("/hri_person_manager/list_known", PATIENCE_S)
        answer = known()
        names = dict(zip(answer.ids, answer.names))
        return wanted <= set(names) and names["ann"] == "Ann" and names["bob"] == "Bob"

    def _until(self, condition: Callable[[], bool], seconds: float) -> object:
        """Seconds until it is true, None when it does not become so."""
        began = time.monotonic()
        return round(time.monotonic() - began, 2) if processes.wait_until(condition, seconds) else None

    def _stored(self) -> Dict[str, str]:
        """Names in the store by id, read as another process would; empty while it cannot be."""
        from hri_pipeline.core.privacy import StoreError
        from hri_pipeline.core.recognition.store import PersonStore
        if not self._store.is_file():
            return {}
        try:
            store = PersonStore(self._store)
            try:
                return {record.id: record.name for record in store.load_records()}
            finally:
                store.close()
        except (StoreError, OSError):
            return {}

    def _let_somebody_come(self) -> Callable[[], None]:
        """Another camera sees somebody whom its recogniser knows; returns what ends that."""
        from hri_msgs.msg import IdsList, IdsMatch
        faces = rospy.Publisher("/humans/faces/tracked", IdsList, queue_size=10)
        matches = rospy.Publisher("/humans/candidate_matches", IdsMatch, queue_size=10)

        def say(_: object) -> None:
            faces.publish(IdsList(ids=["f" + NEWCOMER]))
            matches.publish(IdsMatch(id1="f" + NEWCOMER, id1_type=IdsMatch.FACE, id2=NEWCOMER, id2_type=IdsMatch.PERSON,
                                     confidence=0.95))
        timer = rospy.Timer(rospy.Duration(0.5), say)

        def stop() -> None:
            timer.shutdown()
            faces.unregister()
            matches.unregister()
        return stop
