"""The register's records in the store of people that the recognisers use as well."""

from __future__ import annotations

from dataclasses import asdict
from typing import List, Mapping, Optional

from hri_person_manager.core.demographics import DemographicsEstimate
from hri_person_manager.core.person_register import PersonRecord
from hri_pipeline.core.recognition.person_schema import StoredPerson
from hri_pipeline.core.recognition.person_store import PersonStore

DAY_S = 86400.0


class StoreOfRecords:
    """A RecordStore in a PersonStore's file, with the limits of how long and how many persons are kept."""

    def __init__(self, store: PersonStore, max_age_days: float = 0.0, max_persons: int = 0) -> None:
        """max_age_days, max_persons: 0 for no limit."""
        self._store = store
        self._max_age = max_age_days * DAY_S
        self._max_persons = max_persons

    def load_records(self) -> List[PersonRecord]:
        """Return all records."""
        return [PersonRecord(**dict(vars(row), demographics=_estimate(row.demographics))) for row in self._store.load_records()]

    def put_record(self, record: PersonRecord) -> None:
        """Write one record; its templates, if there are any, stay."""
        demographics = asdict(record.demographics) if record.demographics is not None else {}
        self._store.put_record(StoredPerson(**dict(vars(record), demographics=demographics)))

    def remove_record(self, person_id: str) -> None:
        """Remove one person, records and templates, without a trace."""
        self._store.remove_record(person_id)

    def remove_all(self) -> None:
        """Remove everybody without a trace."""
        self._store.remove_all()

    def expire(self, now: float) -> List[str]:
        """Remove who was not seen for too long (`now`: s), and the oldest of too many; returns their ids."""
        if not self._max_age and not self._max_persons:
            return []
        return self._store.expire(now, self._max_age, self._max_persons)

    def close(self) -> None:
        """Give the file back. May be called again."""
        self._store.close()


def _estimate(mapping: Mapping[str, object]) -> Optional[DemographicsEstimate]:
    """The estimate that was stored; None for none, or one of another version."""
    try:
        return DemographicsEstimate(**mapping) if mapping else None
    except TypeError:
        return None
