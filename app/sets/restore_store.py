"""Stores restores: each row before it is sent, and again with its outcome."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Mapping

from app.database.messages import UNREADABLE, message_of, stored_message
from app.database.queries import Tables, reading, writing
from app.sets.model import ParameterRow, UnitRows
from app.sets.order import Write
from app.sets.plan import LeftOut, RestorePlan
from app.sets.restore_record import UNDER_WAY, Restore, RowResult
from bus.catalogue.parameters import PARAMETERS
from bus.messages import Message

NOT_KEPT = -1
"""Stands for a secret (#21), which is kept in parameter sets alone: no raw value is negative."""
ENDED_MEANWHILE = Message("row_in_doubt")
MAX_OF_UNIT = 20
_SIDES = ("wanted", "before", "proven")


class RestoreStore(Tables):
    """All access to the tables of restores. Only what was begun is kept; a plan writes nothing."""

    @writing
    def begin(self, connection: sqlite3.Connection, restore: Restore) -> None:
        """Before the first row is sent."""
        connection.execute(
            "INSERT INTO restore VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
            (
                restore.id,
                restore.bus,
                restore.unit,
                restore.before.name,
                restore.who,
                restore.planned_at,
                restore.plan.equal,
                restore.state,
                stored_message(restore.cause),
                restore.cause_code,
            ),
        )
        connection.executemany(
            "INSERT INTO restore_row VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
            [
                (restore.id, place, row.write.number, *_stored_values(row.write), *_result_columns(row))
                for place, row in enumerate(restore.rows)
            ],
        )
        connection.executemany(
            "INSERT INTO restore_left_out VALUES (?, ?, ?, ?, ?)",
            [
                (restore.id, left.number, stored_message(left.text), left.later, left.reason)
                for left in restore.left_out
            ],
        )
        _insert_values(connection, restore.id, "wanted", restore.wanted.rows)
        _insert_values(connection, restore.id, "before", restore.before.rows)

    @writing
    def sending(self, connection: sqlite3.Connection, restore: Restore, place: int) -> None:
        """A row is about to be sent: should nothing more be stored, it counts as unverified."""
        unverified = RowResult(restore.rows[place].write, "unverified", ENDED_MEANWHILE)
        _update_row(connection, restore.id, place, unverified)

    @writing
    def row(self, connection: sqlite3.Connection, restore: Restore, place: int) -> None:
        _update_row(connection, restore.id, place, restore.rows[place])

    @writing
    def end(self, connection: sqlite3.Connection, restore: Restore) -> None:
        """Its last state, and what the full read found."""
        connection.execute(
            "UPDATE restore SET state = ?, cause = ?, cause_code = ? WHERE id = ?",
            (restore.state, stored_message(restore.cause), restore.cause_code, restore.id),
        )
        for place, row in enumerate(restore.rows):
            _update_row(connection, restore.id, place, row)
        if restore.proven is not None:
            _insert_values(connection, restore.id, "proven", restore.proven.rows)

    @reading
    def load(self, connection: sqlite3.Connection, restore_id: str) -> Restore | None:
        """A restore that was begun, None when there is no such."""
        return next(_select(connection, "id = ?", restore_id), None)

    @reading
    def under_way(self, connection: sqlite3.Connection) -> list[Restore]:
        """Those that had not ended when the server did."""
        marks = ", ".join("?" * len(UNDER_WAY))
        return list(_select(connection, f"state IN ({marks})", *UNDER_WAY))

    @reading
    def of_unit(self, connection: sqlite3.Connection, bus: str, unit: int) -> list[Restore]:
        """The last restores of a unit, newest first."""
        newest = "bus = ? AND unit = ? ORDER BY planned_at DESC LIMIT ?"
        return list(_select(connection, newest, bus, unit, MAX_OF_UNIT))


def _insert_values(
    connection: sqlite3.Connection, restore_id: str, side: str, rows: Mapping[int, ParameterRow]
) -> None:
    connection.executemany(
        "INSERT OR REPLACE INTO restore_value VALUES (?, ?, ?, ?, ?, ?)",
        [
            (restore_id, side, row.number, _unless_secret(row.number, row.raw), row.available, row.read_at)
            for row in rows.values()
        ],
    )


def _stored_values(write: Write) -> tuple[int, int]:
    return (NOT_KEPT, NOT_KEPT) if PARAMETERS[write.number].secret else (write.present, write.wanted)


def _unless_secret(number: int, raw: int | None) -> int | None:
    return None if PARAMETERS[number].secret else raw


def _result_columns(row: RowResult) -> tuple[str | None, str, int | None]:
    return row.outcome, stored_message(row.message), _unless_secret(row.write.number, row.read_back)


def _update_row(connection: sqlite3.Connection, restore_id: str, place: int, row: RowResult) -> None:
    connection.execute(
        "UPDATE restore_row SET outcome = ?, message = ?, read_back = ? WHERE restore_id = ? AND place = ?",
        (*_result_columns(row), restore_id, place),
    )


def _select(connection: sqlite3.Connection, which: str, *values: str | int) -> Iterator[Restore]:
    heads = connection.execute(
        "SELECT id, bus, unit, unit_name, who, planned_at, equal_rows, state, cause, cause_code"
        f" FROM restore WHERE {which}",
        values,
    ).fetchall()
    for restore_id, bus, unit, name, who, planned_at, equal, state, cause, cause_code in heads:
        rows = _rows(connection, restore_id)
        wanted, before, proven = (_values(connection, restore_id, side) for side in _SIDES)
        yield Restore(
            id=restore_id,
            bus=bus,
            unit=unit,
            who=who,
            wanted=UnitRows(unit, name, wanted),
            before=UnitRows(unit, name, before),
            plan=RestorePlan(tuple(row.write for row in rows), _left_out(connection, restore_id), equal),
            rows=rows,
            planned_at=planned_at,
            state=state,
            cause=message_of(cause),
            cause_code=cause_code,
            proven=UnitRows(unit, name, proven) if proven else None,
        )


def _rows(connection: sqlite3.Connection, restore_id: str) -> list[RowResult]:
    found = connection.execute(
        "SELECT number, present, wanted, outcome, message, read_back FROM restore_row"
        " WHERE restore_id = ? ORDER BY place",
        (restore_id,),
    )
    return [
        RowResult(Write(number, present, wanted), outcome, message_of(message), read_back)
        for number, present, wanted, outcome, message, read_back in found
    ]


def _left_out(connection: sqlite3.Connection, restore_id: str) -> tuple[LeftOut, ...]:
    found = connection.execute(
        "SELECT number, code, reason, later FROM restore_left_out WHERE restore_id = ? ORDER BY number",
        (restore_id,),
    )
    return tuple(
        LeftOut(number, code or ("not_in_remote" if later else None), message_of(text) or UNREADABLE)
        for number, code, text, later in found
    )


def _values(connection: sqlite3.Connection, restore_id: str, side: str) -> dict[int, ParameterRow]:
    found = connection.execute(
        "SELECT number, raw, available, read_at FROM restore_value WHERE restore_id = ? AND side = ?",
        (restore_id, side),
    )
    return {
        number: ParameterRow(number, raw, bool(available), read_at)
        for number, raw, available, read_at in found
    }
