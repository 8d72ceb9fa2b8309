"""What the store of people holds: the row of a person, and the schema of the database."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Mapping, Tuple

APPLICATION_ID = 0x52344850
"""Tells the file from the databases of other programs."""
MIGRATIONS: Tuple[Tuple[str, ...], ...] = (
    ("CREATE TABLE persons (id TEXT PRIMARY KEY, name TEXT NOT NULL, native_language TEXT NOT NULL,"
     " enrolled INTEGER NOT NULL, alias TEXT NOT NULL, first_seen REAL NOT NULL, last_seen REAL NOT NULL,"
     " demographics TEXT NOT NULL) WITHOUT ROWID",
     "CREATE TABLE templates (person TEXT NOT NULL REFERENCES persons (id) ON DELETE CASCADE, model TEXT NOT NULL,"
     " number INTEGER NOT NULL, template BLOB NOT NULL, PRIMARY KEY (person, model, number)) WITHOUT ROWID",
     "CREATE TABLE facts (name TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID"),
)
"""The statements that lead from each version of the schema to the next."""


@dataclass(frozen=True)
class PersonFacts:
    """What is kept of one permanent person. Times: s of wall time; alias: id of the person that this one was merged into."""

    id: str
    name: str = ""
    native_language: str = ""
    enrolled: bool = False
    alias: str = ""
    first_seen: float = 0.0
    last_seen: float = 0.0


@dataclass(frozen=True)
class StoredPerson(PersonFacts):
    """One person as a row of the store. demographics: plain data, empty if unknown."""

    demographics: Mapping[str, Any] = field(default_factory=dict)
