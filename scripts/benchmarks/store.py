"""The store of people under bad conditions: held by another process, written by two, on a full disk, and its writer
killed.

The writer that is killed is forked, so that the moments fall on the opening of the store, its first schema, writing,
forgetting (which rewrites the file) and nothing else. kill -9 ends a process, not the power supply: that is not
measured here.
"""

from __future__ import annotations

import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Dict, Iterator, List, NoReturn, Set, Tuple

import numpy as np

from benchmarks.recognition import SIZE, template
from hri_pipeline.core.privacy import StoreError
from hri_pipeline.core.recognition.likelihood import TemplateCalibration
from hri_pipeline.core.recognition.store import KnownPerson, PersonStore, StoredPerson
from hri_pipeline.core.recognition.stored_gallery import StoredGallery

MODEL = "synthetic"
CALIBRATION = TemplateCalibration(midpoint=0.38, fair_midpoint=0.40, scale=0.018, near=0.15)
PROCESSES = 2
_MOST_KNOWN = 12
_VIEWS = 40
_ATTEMPTS = 5
_HOLDER = """
import sqlite3, sys
database = sqlite3.connect(sys.argv[1], isolation_level=None)
database.execute("BEGIN IMMEDIATE")
print("held", flush=True)
sys.stdin.readline()
database.execute("COMMIT")
"""


@contextmanager
def write_locked(path: Path) -> Iterator[None]:
    """Let another process hold the write lock of a store: whoever writes waits."""
    holder = subprocess.Popen([sys.executable, "-c", _HOLDER, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    try:
        if _line(holder.stdout) != "held":
            raise RuntimeError("the write lock of {} was not given".format(path))
        yield
    finally:
        holder.communicate(b"\n")


def forget_undone(seconds: float, directory: Path) -> int:
    """Return how many persons came back after they were forgotten: 0 is wanted.

    Two processes learn persons and new views of them, write records, and forget persons, their own and each other's, at
    random for `seconds` in one store, which is made in `directory`. Whoever the one that has forgotten says is gone
    must not be in the store at the end, nor in the gallery of either. Raises RuntimeError when a process fails, or
    when nobody was forgotten.
    """
    path = Path(directory) / "forget" / "people.sqlite"
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join(filter(None, sys.path)))
    workers = [subprocess.Popen([sys.executable, "-m", __name__, str(path), str(number), str(seconds)], env=environment,
                                stdin=subprocess.PIPE, stdout=subprocess.PIPE) for number in range(PROCESSES)]
    try:
        forgotten, left = _listen(workers)
    finally:
        for worker in workers:
            worker.kill()
            worker.communicate()
    if not forgotten:
        raise RuntimeError("nobody was forgotten in {} s".format(seconds))
    store = PersonStore(path)
    left |= {record.id for record in store.load_records()}
    left |= {person.id for person in store.load_templates(MODEL, SIZE)}
    store.close()
    return len(forgotten & left)


def _listen(workers: List["subprocess.Popen[bytes]"]) -> Tuple[Set[str], Set[str]]:
    """Return who was forgotten by the processes, and who is in their galleries after all of them have ended."""
    forgotten = {name for worker in workers for name in _line(worker.stdout).split()}
    for worker in workers:
        worker.stdin.write(b"\n")
        worker.stdin.flush()
    return forgotten, {name for worker in workers for name in _line(worker.stdout).split()}


def _line(stream: IO[bytes]) -> str:
    line = stream.readline()
    if not line:
        raise RuntimeError("a process that uses the store has ended by itself")
    return line.decode("ascii").rstrip("\n")


def _learn_and_forget(path: Path, number: int, seconds: float) -> None:
    """Work on the store; say in a line who was forgotten, and, when asked to, in another one who is known."""
    chance = random.Random(number)
    store = PersonStore(path)
    gallery = StoredGallery(store, MODEL, SIZE, CALIBRATION)
    forgotten: List[str] = []
    end, learnt = time.monotonic() + seconds, 0
    while time.monotonic() < end:
        known = gallery.ids()
        if not known or (len(known) < _MOST_KNOWN and chance.random() < 0.3):
            learnt += 1
            gallery.add_person("p{}n{}".format(number, learnt), template(learnt, view=number)[None])
        elif chance.random() < 0.2:
            forgotten.append(chance.choice(known))
            gallery.remove(forgotten[-1])
        else:
            name = chance.choice(known)
            gallery.add_template(name, _near(gallery.export(name).templates[0], chance.randrange(_VIEWS)))
            if chance.random() < 0.2:
                store.put_record(StoredPerson(name, "Somebody", last_seen=time.time()), is_new=False)
        _write(gallery)
    print(" ".join(forgotten), flush=True)
    sys.stdin.readline()
    _write(gallery)
    print(" ".join(gallery.ids()), flush=True)
    gallery.close()


def _write(gallery: StoredGallery) -> None:
    """Write as a node does: what a busy disk does not take is tried again."""
    for attempt in range(_ATTEMPTS):
        try:
            gallery.flush()
            return
        except StoreError:
            if attempt == _ATTEMPTS - 1:
                raise


def _near(first: np.ndarray, view: int) -> np.ndarray:
    """Another view of somebody whose first template is given."""
    turned = first + 0.25 * template(10 ** 6 + view)
    return (turned / np.linalg.norm(turned)).astype(np.float32)


@contextmanager
def no_room() -> Iterator[None]:
    """Let no file of this process be written, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


KILLS = 200
KILLS_PER_STORE = 20
"""So many processes write one store after the other; then a new one is made."""
LONGEST_S = 0.12
DIMENSION = 128
_FORGET_EVERY = 5


def _template(number: int) -> np.ndarray:
    """Templates (2, 128) that tell who they belong to."""
    return np.random.default_rng(number).normal(size=(2, DIMENSION)).astype(np.float32)


def kill_writer(kills: int = KILLS) -> dict:
    """How often the store was damaged, had half a person, had lost somebody, or held somebody who was forgotten."""
    chance, began = random.Random(3), time.monotonic()
    found = {"kill_damaged": 0, "kills": kills, "kills_before_the_first_person": 0, "persons_written_before_kills": 0,
             "persons_forgotten_before_kills": 0, "kills_while_forgetting": 0}
    with tempfile.TemporaryDirectory(prefix="ros4hri-benchmark-") as directory:
        for number in range(kills):
            if number % 50 == 0:
                print("  kill {} of {}".format(number, kills), file=sys.stderr, flush=True)
            path = Path(directory) / "people{}".format(number // KILLS_PER_STORE) / "store.sqlite"
            written, forgotten, doubtful = _write_and_kill(path, 1000 * number, chance.uniform(0.0, LONGEST_S))
            found["kills_before_the_first_person"] += not written
            found["persons_written_before_kills"] += len(written)
            found["persons_forgotten_before_kills"] += len(forgotten)
            found["kills_while_forgetting"] += bool(doubtful)
            found["kill_damaged"] += not _is_whole(path, written - doubtful, forgotten)
    found["kill_seconds"] = round(time.monotonic() - began, 1)
    return found


def _write_and_kill(path: Path, start: int, delay: float) -> Tuple[Set[str], Set[str], Set[str]]:
    """Let a process write and kill it after `delay` (s); returns who it said is written and not forgotten, who is
    forgotten, and whom it was forgetting.
    """
    reader, writer = os.pipe()
    child = os.fork()
    if not child:
        os.close(reader)
        _write_for_ever(path, start, writer)
    os.close(writer)
    time.sleep(delay)
    os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    if not os.WIFSIGNALED(status):
        raise RuntimeError("the process that writes ended by itself")
    with os.fdopen(reader, "rb") as pipe:
        lines = pipe.read().decode().split("\n")[:-1]
    said: Dict[str, Set[str]] = {sign: {line[1:] for line in lines if line[0] == sign} for sign in "+?-"}
    return said["+"] - said["-"], said["-"], said["?"] - said["-"]


def _is_whole(path: Path, written: Set[str], forgotten: Set[str]) -> bool:
    """Tell whether the store is sound, everybody who was written is there and complete, and nobody who was
    forgotten."""
    store = PersonStore(path)
    try:
        records = {record.id: record for record in store.load_records()}
        templates = {person.id: np.asarray(person.templates) for person in store.load_templates(MODEL, DIMENSION)}
        return (not store.damaged_files() and written <= set(templates) and not forgotten & set(records)
                and all(record.name == "Somebody " + record.id[1:] for record in records.values())
                and all(np.array_equal(found, _template(int(person[1:]))) for person, found in templates.items()))
    finally:
        store.close()


def _write_for_ever(path: Path, start: int, pipe: int) -> NoReturn:
    """Write one new person after the other, record and templates, and forget some of them; never returns."""
    try:
        store, number = PersonStore(path), start
        while True:
            person = "p{}".format(number)
            store.put_record(StoredPerson(person, name="Somebody {}".format(number), first_seen=1.0, last_seen=2.0))
            store.put_templates(KnownPerson(person, _template(number), True), MODEL, 3.0)
            os.write(pipe, "+{}\n".format(person).encode())
            if number % _FORGET_EVERY == 0:
                os.write(pipe, "?{}\n".format(person).encode())
                store.remove_record(person)
                os.write(pipe, "-{}\n".format(person).encode())
            number += 1
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(1)


if __name__ == "__main__":
    _learn_and_forget(Path(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]))
