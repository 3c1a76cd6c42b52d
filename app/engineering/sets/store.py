"""Stores parameter sets, which never change, the marks of golden sets, and the daily schedule."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from app.core.database import StoreConnection
from app.core.database.connection import upsert
from app.core.database.database import Tables, reading, writing
from app.engineering.sets.model import ParameterRow, ParameterSet, ParameterSetSummary, SetOrigin, UnitRows
from bus.instants import UnixTime

MAX_SETS = 2**62
"""No limit."""
_HEAD = "bus, name, comment, taken_at, who, origin"


class SetStore(Tables):
    """The tables of parameter sets."""

    @writing
    def save(self, connection: StoreConnection, parameter_set: ParameterSet) -> ParameterSet:
        """Store a new set and return it with its id."""
        one = parameter_set
        [(set_id,)] = connection.execute(
            f"INSERT INTO parameter_set ({_HEAD}) VALUES (?, ?, ?, ?, ?, ?) RETURNING id",
            (one.bus, one.name, one.comment, one.taken_at, one.who, one.origin),
        )
        connection.executemany(
            "INSERT INTO parameter_set_unit VALUES (?, ?, ?)",
            [(set_id, unit.unit, unit.name) for unit in one.units],
        )
        connection.executemany(
            "INSERT INTO parameter_set_row VALUES (?, ?, ?, ?, ?, ?, ?)",
            [
                (set_id, unit.unit, row.number, row.raw, row.available, row.read_at, row.frame)
                for unit in one.units
                for row in unit.rows.values()
            ],
        )
        return replace(one, id=set_id)

    @reading
    def load(self, connection: StoreConnection, set_id: int) -> ParameterSet | None:
        """Return a complete set, if it exists."""
        head = connection.execute(f"SELECT {_HEAD} FROM parameter_set WHERE id = ?", (set_id,)).fetchone()
        if head is None:
            return None
        bus, name, comment, taken_at, who, origin = head
        found = connection.execute(
            "SELECT unit, name FROM parameter_set_unit WHERE set_id = ? ORDER BY unit", (set_id,)
        ).fetchall()
        units = tuple(UnitRows(unit, section, _rows(connection, set_id, unit)) for unit, section in found)
        marks = connection.execute("SELECT unit FROM golden_set WHERE set_id = ? ORDER BY unit", (set_id,))
        golden_for = tuple(unit for (unit,) in marks)
        return ParameterSet(bus, taken_at, who, origin, units, name, comment, set_id, golden_for)

    @reading
    def summaries(
        self,
        connection: StoreConnection,
        bus: str | None = None,
        unit: int | None = None,
        *,
        before: int | None = None,
        limit: int = MAX_SETS,
    ) -> list[ParameterSetSummary]:
        """Return the newest sets, filtered by bus or unit, of those stored before the set ``before``."""
        found = connection.execute(
            f"SELECT id, {_HEAD},"
            " (SELECT group_concat(unit) FROM parameter_set_unit WHERE set_id = id),"
            " (SELECT group_concat(unit) FROM golden_set WHERE set_id = id)"
            " FROM parameter_set WHERE (bus = :bus OR :bus IS NULL) AND (EXISTS"
            " (SELECT 1 FROM parameter_set_unit WHERE set_id = id AND unit = :unit) OR :unit IS NULL)"
            " AND (id < :before OR :before IS NULL) ORDER BY id DESC LIMIT :limit",
            {"bus": bus, "unit": unit, "before": before, "limit": limit},
        )
        return [
            ParameterSetSummary(
                set_id, of_bus, name, comment, taken_at, who, origin, _numbers(golden_for), _numbers(units)
            )
            for set_id, of_bus, name, comment, taken_at, who, origin, units, golden_for in found
        ]

    @writing
    def mark_golden(
        self,
        connection: StoreConnection,
        bus: str,
        units: Iterable[int],
        set_id: int,
        who: str,
        now: UnixTime,
    ) -> None:
        """Make a set the golden set of the units. ``now``: seconds since the epoch."""
        for unit in units:
            connection.execute(
                upsert("golden_set", ("bus", "unit"), ("set_id", "marked_by", "marked_at")),
                (bus, unit, set_id, who, now),
            )

    @reading
    def golden(self, connection: StoreConnection, bus: str) -> dict[int, UnitRows]:
        """Return the golden rows of the units of a bus by address."""
        marks = connection.execute(
            "SELECT golden_set.unit, golden_set.set_id, parameter_set_unit.name FROM golden_set"
            " JOIN parameter_set_unit USING (set_id, unit) WHERE golden_set.bus = ?",
            (bus,),
        ).fetchall()
        return {unit: UnitRows(unit, name, _rows(connection, set_id, unit)) for unit, set_id, name in marks}

    @reading
    def has_set_since(
        self,
        connection: StoreConnection,
        bus: str,
        unit: int,
        since: UnixTime,
        origin: SetOrigin | None = None,
    ) -> bool:
        """Tell whether a set of this unit, of this origin if given, was stored at or after ``since``."""
        found = connection.execute(
            "SELECT 1 FROM parameter_set JOIN parameter_set_unit ON id = set_id"
            " WHERE bus = ?1 AND unit = ?2 AND taken_at >= ?3 AND origin = coalesce(?4, origin) LIMIT 1",
            (bus, unit, since, origin),
        )
        return found.fetchone() is not None

    @reading
    def schedule(self, connection: StoreConnection) -> dict[str, int]:
        """Return by bus the minute of the local day at which its units are saved."""
        return dict(connection.execute("SELECT bus, minute_of_day FROM set_schedule"))

    @writing
    def set_schedule(self, connection: StoreConnection, bus: str, minute_of_day: int | None) -> None:
        """Save the units of a bus daily at a minute of the day; None ends it."""
        connection.execute("DELETE FROM set_schedule WHERE bus = ?", (bus,))
        if minute_of_day is not None:
            connection.execute("INSERT INTO set_schedule VALUES (?, ?)", (bus, minute_of_day))


def _rows(connection: StoreConnection, set_id: int, unit: int) -> dict[int, ParameterRow]:
    found = connection.execute(
        "SELECT number, raw, available, read_at, frame FROM parameter_set_row"
        " WHERE set_id = ? AND unit = ? ORDER BY number",
        (set_id, unit),
    )
    return {
        number: ParameterRow(number, raw, bool(available), read_at, frame)
        for number, raw, available, read_at, frame in found
    }


def _numbers(joined: str | None) -> tuple[int, ...]:
    return tuple(sorted(int(part) for part in joined.split(","))) if joined else ()
