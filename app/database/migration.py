"""The numbered steps that bring a store up to date."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from app.errors import StoreError
from bus.messages import Message

MIGRATIONS = Path(__file__).parent / "migrations"
FIRST = 1
"""The number of the step that creates a store."""
_NAME = re.compile(r"^(\d{4})_([a-z0-9_]+)\.sql$")


@dataclass(frozen=True)
class Migration:
    """One step forward."""

    number: int
    name: str
    sql: str


def migrations_in(folder: Path) -> list[Migration]:
    """Every ``NNNN_name.sql`` of a folder in order."""
    found = ((path, _NAME.match(path.name)) for path in sorted(folder.glob("*.sql")))
    return [Migration(int(name[1]), name[2], path.read_text("utf-8")) for path, name in found if name]


def missing_in(applied: dict[int, str], folder: Path, store: str) -> list[Migration]:
    """The steps of a folder that a store has not taken. Raises StoreError for a store of a newer version."""
    known = migrations_in(folder)
    newer = set(applied) - {migration.number for migration in known}
    if newer:
        step, called = f"{max(newer):04d}", applied[max(newer)]
        raise StoreError(Message.of("store_of_newer_version", path=store, step=step, called=called))
    return [migration for migration in known if migration.number not in applied]


def failed_step(step: Migration, store: str, error: Exception) -> StoreError:
    number, why = f"{step.number:04d}", str(error)
    return StoreError(Message.of("store_step_failed", path=store, step=number, called=step.name, error=why))
