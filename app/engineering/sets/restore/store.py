"""Stores restores: the state of each before a row is sent, and again with the outcome of the row."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import msgspec

from app.core.database import StoreConnection
from app.core.database.connection import upsert
from app.core.database.database import Tables, reading
from app.engineering.sets.model import UnitRows
from app.engineering.sets.restore.order import Write
from app.engineering.sets.restore.record import UNDER_WAY, Restore, RowResult
from bus.catalogue.parameters import PARAMETERS

NOT_KEPT = -1
"""Stands for a secret (#21), which is kept in parameter sets alone: no raw value is negative."""
MAX_OF_UNIT = 20
_SAVE = upsert("restore", ("id",), ("bus", "unit", "planned_at", "state", "content"))
_DECODER = msgspec.json.Decoder(Restore)


class RestoreStore(Tables):
    """All access to the table of restores. Only what was begun is kept; a plan writes nothing."""

    async def save(self, restore: Restore) -> None:
        """Store its present state in place of the earlier one, without secrets."""
        one, content = restore, msgspec.json.encode(_without_secrets(restore)).decode()
        row = (one.id, one.bus, one.unit, one.planned_at, one.state, content)
        await self.database.write(lambda connection: connection.execute(_SAVE, row))

    @reading
    def load(self, connection: StoreConnection, restore_id: str) -> Restore | None:
        """A restore that was begun, None when there is no such."""
        return next(_select(connection, "id = ?", restore_id), None)

    @reading
    def under_way(self, connection: StoreConnection, bus: str) -> list[Restore]:
        """Those of a bus that had not ended when the server did."""
        marks = ", ".join("?" * len(UNDER_WAY))
        return list(_select(connection, f"bus = ? AND state IN ({marks})", bus, *UNDER_WAY))

    @reading
    def of_unit(self, connection: StoreConnection, bus: str, unit: int) -> list[Restore]:
        """The last restores of a unit, newest first."""
        newest = "bus = ? AND unit = ? ORDER BY planned_at DESC LIMIT ?"
        return list(_select(connection, newest, bus, unit, MAX_OF_UNIT))


def _select(connection: StoreConnection, which: str, *values: str | int) -> Iterator[Restore]:
    """Content that cannot be read, which nothing here writes, is left out."""
    for (content,) in connection.execute(f"SELECT content FROM restore WHERE {which}", values).fetchall():
        try:
            yield _DECODER.decode(content)
        except (msgspec.MsgspecError, UnicodeError, RecursionError):
            continue


def _without_secrets(restore: Restore) -> Restore:
    rows = [_row_without_secret(row) for row in restore.rows]
    return replace(
        restore,
        plan=replace(restore.plan, writes=tuple(row.write for row in rows)),
        rows=rows,
        wanted=_values_without_secrets(restore.wanted),
        before=_values_without_secrets(restore.before),
        proven=restore.proven and _values_without_secrets(restore.proven),
    )


def _row_without_secret(row: RowResult) -> RowResult:
    number = row.write.number
    if not PARAMETERS[number].secret:
        return row
    return replace(row, write=Write(number, NOT_KEPT, NOT_KEPT), read_back=None)


def _values_without_secrets(values: UnitRows) -> UnitRows:
    """The frames, which hold the values too, are left out."""
    rows = {
        number: replace(row, raw=None if PARAMETERS[number].secret else row.raw, frame=b"")
        for number, row in values.rows.items()
    }
    return replace(values, rows=rows)
