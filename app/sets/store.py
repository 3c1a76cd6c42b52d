"""Stores parameter sets, which never change, and which set of a unit is golden."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable
from dataclasses import dataclass, replace

from app.database import Database
from app.sets.model import ParameterRow, ParameterSet, SetOrigin, UnitRows
from bus.instants import UnixTime


@dataclass(frozen=True, slots=True)
class SetSummary:
    """A line of the list of sets."""

    id: int
    bus: str
    name: str
    comment: str
    taken_at: UnixTime
    who: str
    origin: str
    units: tuple[int, ...]
    golden_for: tuple[int, ...]


class SetStore:
    """All access to the tables of parameter sets."""

    def __init__(self, database: Database) -> None:
        self._database = database

    async def save(self, parameter_set: ParameterSet) -> ParameterSet:
        """Store a new set; returns it with its id."""
        number = await self._database.write(lambda connection: _insert(connection, parameter_set))
        return replace(parameter_set, id=number)

    async def load(self, set_id: int) -> ParameterSet | None:
        """A complete set; None where there is none."""
        return await self._database.read(lambda connection: _load(connection, set_id))

    async def summaries(
        self, bus: str | None = None, unit: int | None = None, *, before: int | None = None, most: int = -1
    ) -> list[SetSummary]:
        """Newest first, filtered by bus or unit; at most so many, of those stored before one."""
        return await self._database.read(lambda connection: _summaries(connection, bus, unit, before, most))

    async def mark_golden(self, bus: str, unit: int, set_id: int, who: str, now: UnixTime) -> None:
        """From now on this set is what the unit ought to be. ``now``: seconds since the epoch."""
        await self._database.write(
            lambda connection: connection.execute(
                "INSERT OR REPLACE INTO golden_set (bus, unit, set_id, marked_by, marked_at)"
                " VALUES (?, ?, ?, ?, ?)",
                (bus, unit, set_id, who, now),
            )
        )

    async def golden(self, bus: str) -> dict[int, UnitRows]:
        """The golden rows of every unit of a bus that has some, by its address."""
        return await self._database.read(lambda connection: _golden(connection, bus))

    async def has_set_since(
        self, bus: str, unit: int, since: UnixTime, origin: SetOrigin | None = None
    ) -> bool:
        """Whether a set of this unit, of this origin if given, was stored at or after ``since`` (seconds
        since the epoch)."""
        return await self._database.read(
            lambda connection: (
                connection.execute(
                    "SELECT 1 FROM parameter_set JOIN parameter_set_unit ON id = set_id"
                    " WHERE bus = ?1 AND unit = ?2 AND taken_at >= ?3 AND origin = ifnull(?4, origin)"
                    " LIMIT 1",
                    (bus, unit, since, origin),
                ).fetchone()
                is not None
            )
        )

    async def schedule(self) -> dict[str, int]:
        """Bus → minute of the local day at which its sets are taken."""
        return await self._database.read(
            lambda connection: dict(connection.execute("SELECT bus, minute_of_day FROM set_schedule"))
        )

    async def set_schedule(self, bus: str, minute_of_day: int | None) -> None:
        """Take the sets of a bus daily at a minute of the day; None ends it."""

        def work(connection: sqlite3.Connection) -> None:
            connection.execute("DELETE FROM set_schedule WHERE bus = ?", (bus,))
            if minute_of_day is not None:
                connection.execute("INSERT INTO set_schedule VALUES (?, ?)", (bus, minute_of_day))

        await self._database.write(work)


def _insert(connection: sqlite3.Connection, parameter_set: ParameterSet) -> int:
    cursor = connection.execute(
        "INSERT INTO parameter_set (bus, name, comment, taken_at, who, origin) VALUES (?, ?, ?, ?, ?, ?)",
        (
            parameter_set.bus,
            parameter_set.name,
            parameter_set.comment,
            parameter_set.taken_at,
            parameter_set.who,
            parameter_set.origin,
        ),
    )
    set_id = int(cursor.lastrowid or 0)
    connection.executemany(
        "INSERT INTO parameter_set_unit VALUES (?, ?, ?)",
        [(set_id, unit.unit, unit.name) for unit in parameter_set.units],
    )
    connection.executemany(
        "INSERT INTO parameter_set_row VALUES (?, ?, ?, ?, ?, ?, ?)",
        [
            (set_id, unit.unit, row.number, row.raw, row.available, row.read_at, row.frame)
            for unit in parameter_set.units
            for row in unit.rows.values()
        ],
    )
    return set_id


def _load(connection: sqlite3.Connection, set_id: int) -> ParameterSet | None:
    head = connection.execute(
        "SELECT bus, name, comment, taken_at, who, origin FROM parameter_set WHERE id = ?", (set_id,)
    ).fetchone()
    if head is None:
        return None
    bus, name, comment, taken_at, who, origin = head
    units = tuple(
        UnitRows(unit, unit_name, _rows(connection, set_id, unit))
        for unit, unit_name in connection.execute(
            "SELECT unit, name FROM parameter_set_unit WHERE set_id = ? ORDER BY unit", (set_id,)
        ).fetchall()
    )
    golden_for = frozenset(
        unit for (unit,) in connection.execute("SELECT unit FROM golden_set WHERE set_id = ?", (set_id,))
    )
    return ParameterSet(bus, taken_at, who, origin, units, name, comment, set_id, golden_for)


def _rows(connection: sqlite3.Connection, set_id: int, unit: int) -> dict[int, ParameterRow]:
    found = connection.execute(
        "SELECT number, raw, available, read_at, frame FROM parameter_set_row"
        " WHERE set_id = ? AND unit = ? ORDER BY number",
        (set_id, unit),
    )
    return {
        number: ParameterRow(number, raw, bool(available), read_at, frame)
        for number, raw, available, read_at, frame in found
    }


def _summaries(
    connection: sqlite3.Connection, bus: str | None, unit: int | None, before: int | None, most: int
) -> list[SetSummary]:
    found = connection.execute(
        "SELECT id, bus, name, comment, taken_at, who, origin,"
        " (SELECT group_concat(unit) FROM parameter_set_unit WHERE set_id = id),"
        " (SELECT group_concat(unit) FROM golden_set WHERE set_id = id)"
        " FROM parameter_set WHERE (:bus IS NULL OR bus = :bus) AND (:unit IS NULL OR EXISTS"
        " (SELECT 1 FROM parameter_set_unit WHERE set_id = id AND unit = :unit))"
        " AND (:before IS NULL OR id < :before) ORDER BY id DESC LIMIT :most",
        {"bus": bus, "unit": unit, "before": before, "most": most},
    )
    return [
        SetSummary(
            set_id, of_bus, name, comment, taken_at, who, origin, _numbers(units), _numbers(golden_for)
        )
        for set_id, of_bus, name, comment, taken_at, who, origin, units, golden_for in found
    ]


def _numbers(joined: str | None) -> tuple[int, ...]:
    return tuple(sorted(int(part) for part in joined.split(","))) if joined else ()


def _golden(connection: sqlite3.Connection, bus: str) -> dict[int, UnitRows]:
    marks: Iterable[tuple[int, int, str]] = connection.execute(
        "SELECT golden_set.unit, golden_set.set_id, parameter_set_unit.name FROM golden_set"
        " JOIN parameter_set_unit USING (set_id, unit) WHERE golden_set.bus = ?",
        (bus,),
    ).fetchall()
    return {unit: UnitRows(unit, name, _rows(connection, set_id, unit)) for unit, set_id, name in marks}
