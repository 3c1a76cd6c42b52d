"""Compares the audit log with the events in the plant's database, which are a second witness of it."""

from __future__ import annotations

from dataclasses import dataclass

from app.core.database import StoreConnection
from app.errors import StoreError
from app.people.audit.proof import cuts_of
from app.system.postgresql.destination import Destination
from bus.messages import Message

CHUNK = 5000


@dataclass
class Comparison:
    """How many events both have, with one hash; how many the database has with a further one, too; how many
    only the log has, from the first that the database has on."""

    same: int = 0
    replaced: int = 0
    unpublished: int = 0


def compare(connection: StoreConnection, destination: Destination) -> Comparison:
    """Compare every event that the database has. Raises StoreError with the first that the log has otherwise,
    or not at all."""
    found, after, first = Comparison(), 0, 0
    archived = max((cut.last for cut in cuts_of(connection)), default=0)
    while published := destination.hashes(after, CHUNK):
        numbers = published[0][0], published[-1][0]
        query = "SELECT id, hash FROM events WHERE id BETWEEN ? AND ?"
        stored = dict(map(tuple, connection.execute(query, numbers)))
        for number, hashes in published:
            if number in stored and stored[number] in hashes:
                found.same += 1
                found.replaced += len(hashes) > 1
            elif number in stored:
                raise StoreError(Message.of("audit_witness_differs", entry=number))
            elif number > archived:
                raise StoreError(Message.of("audit_witness_lacks", entry=number))
        first, after = first or numbers[0], numbers[1]
    [count] = connection.execute("SELECT count(*) FROM events WHERE id >= ?", (first,)).fetchone()
    found.unpublished = count - found.same
    return found
