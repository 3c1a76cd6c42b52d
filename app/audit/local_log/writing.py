"""Writes a transaction into the database, once: directly, or later out of the local log.

A server that waits for a commit in vain does not know whether it happened. The reference of the transaction
is stored with it, so that the same one out of the local log is passed over.
"""

from __future__ import annotations

import json
from typing import Any, Protocol

from msgspec.structs import replace

from app.audit.events import appending
from app.audit.events.entry import new_entry
from app.audit.local_log.transaction import LoggedTransaction
from app.audit.proof.keys import Keys
from app.database import StoreConnection
from bus.instants import UnixTime
from bus.messages import Message


class PartWriter(Protocol):
    """Writes the data of a part, in the transaction of its events. ``late``: out of a local log, where what
    cannot be written any more must not keep the rest from it."""

    def __call__(self, connection: StoreConnection, data: Any, late: bool, /) -> None: ...


LateEntries = tuple[list[dict[str, Any]], list[int]]
MAX_AGE_S = 30 * 86_400.0
"""How long the reference of a transaction that was written directly is kept; others stay."""
_FIND = "SELECT events FROM local_transaction WHERE ref = ?"
_NOTE = "INSERT INTO local_transaction (ref, at, events, entered_at) VALUES (?, ?, ?, ?)"
_CONCLUDED = "SELECT 1 FROM events WHERE about = ?"
_PLACE = "SELECT bus, unit FROM events WHERE id = ?"
_FORGET = "DELETE FROM local_transaction WHERE entered_at IS NULL AND at < ?"


class TransactionWriter:
    """``writers``: of each kind of part."""

    def __init__(self, keys: Keys) -> None:
        self._keys = keys
        self.writers: dict[str, PartWriter] = {}

    def write(
        self, connection: StoreConnection, transaction: LoggedTransaction, *, late: bool = False
    ) -> list[int]:
        """Write events and parts; return the numbers of the events."""
        entries = transaction.entries
        numbers = appending.append(connection, entries, self._keys) if entries else []
        for part in transaction.parts:
            self.writers[part.kind](connection, part.data, late)
        return numbers

    def write_noted(self, connection: StoreConnection, transaction: LoggedTransaction) -> list[int]:
        """Write a transaction directly, with its reference."""
        entries = _resolved_entries(connection, transaction)
        numbers = self.write(connection, replace(transaction, entries=entries))
        note = (transaction.ref, float(transaction.at), json.dumps(numbers), None)
        connection.execute(_NOTE, note)
        return numbers

    def write_late(
        self, connection: StoreConnection, transaction: LoggedTransaction, now: UnixTime
    ) -> LateEntries:
        """Write a transaction of a local log, marked with when it came in; nothing where it is there already.
        An entry about an event that was never stored is left out. Returns the entries and their numbers."""
        if connection.execute(_FIND, (transaction.ref,)).fetchone() is not None:
            return [], []
        found = [_in_time(connection, entry) for entry in _resolved_entries(connection, transaction)]
        entries = [{**entry, "entered_at": float(now)} for entry in found]
        numbers = self.write(connection, replace(transaction, entries=entries), late=True)
        note = (transaction.ref, float(transaction.at), json.dumps(numbers), float(now))
        connection.execute(_NOTE, note)
        return entries, numbers


def forget_old(connection: StoreConnection, now: UnixTime) -> None:
    """Forget references that no local log can hold any more."""
    connection.execute(_FORGET, (float(now - MAX_AGE_S),))


def _resolved_entries(connection: StoreConnection, transaction: LoggedTransaction) -> list[dict[str, Any]]:
    """The entries with the numbers of the events that they are about, without those about an event that was
    never stored."""
    found = [(entry, _resolved(connection, entry["about"])) for entry in transaction.entries]
    return [
        {**entry, "about": about} for entry, about in found if about is not None or entry["about"] is None
    ]


def _in_time(connection: StoreConnection, entry: dict[str, Any]) -> dict[str, Any]:
    """The entry; as a remark where its command was concluded meanwhile, by a server that could not know."""
    about = entry["about"]
    if about is None or connection.execute(_CONCLUDED, (about,)).fetchone() is None:
        return entry
    what = Message.of("event_outcome_came_late", event=about, outcome=entry["outcome"])
    bus, unit = connection.execute(_PLACE, (about,)).fetchone()
    remark = new_entry(
        time=entry["time"], kind="audit", bus=bus, unit=unit, what=what, message=entry["message"]
    )
    return {**remark, "frames": entry["frames"]}


def _resolved(connection: StoreConnection, about: Any) -> int | None:
    """The number of the event that an entry is about."""
    if about is None or isinstance(about, int):
        return about
    row = connection.execute(_FIND, (about["ref"],)).fetchone()
    numbers: list[int] = [] if row is None else json.loads(row[0])
    return numbers[about["place"]] if about["place"] < len(numbers) else None
