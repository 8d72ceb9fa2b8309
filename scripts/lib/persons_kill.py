"""Kills a process that writes the store of people, at random moments, and looks at what is left.

The process is forked, so that the moments fall on the opening of the store, its first schema, writing, forgetting (which
rewrites the file) and nothing else. kill -9 ends a process, not the power supply: that is not measured here.
"""

from __future__ import annotations

import os
import random
import signal
import sys
import tempfile
import time
import traceback
from pathlib import Path
from typing import Dict, NoReturn, Set, Tuple

import numpy as np

KILLS = 200
KILLS_PER_STORE = 20
"""So many processes write one store after the other; then a new one is made."""
LONGEST_S = 0.12
DIMENSION = 128
MODEL = "benchmark"
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
    """Tell whether the store is sound, everybody who was written is there and complete, and nobody who was forgotten."""
    from hri_pipeline.core.recognition.person_store import PersonStore
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
    from hri_pipeline.core.recognition.gallery import KnownPerson
    from hri_pipeline.core.recognition.person_schema import StoredPerson
    from hri_pipeline.core.recognition.person_store import PersonStore
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
