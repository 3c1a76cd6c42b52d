"""A store from a backup, prepared to replace the present one: rights that were withdrawn
since stay so, blocks and limits stay in force, and an event names who restored it."""

from __future__ import annotations

import asyncio
import sqlite3
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from app.audit.chain import Head
from app.audit.keys import open_keys
from app.audit.log import EventLog
from app.audit.store import head_of
from app.auth.withheld import Present, Withheld, read_present, withhold
from app.cli.accounts import ORIGIN, who_calls
from app.commands.safeguards.limits import Protection, keep_in_force, read_protection
from app.database import Database
from app.database.connection import open_for_reading
from bus.instants import UnixTime
from bus.messages import Message, joined

WHAT = Message("event_stores_restored")


@dataclass(frozen=True, slots=True)
class Backup:
    """Which backup it is: the name of its file, when it was taken (Unix time), its SHA-256."""

    file: str
    taken_at: UnixTime
    digest: str

    @property
    def message(self) -> Message:
        taken = datetime.fromtimestamp(float(self.taken_at), UTC).isoformat(timespec="seconds")
        return Message.of("backup_of", file=self.file, time=taken, digest=self.digest)


def make_ready(fresh: Path, present: Path, backup: Backup, key_files: Sequence[Path]) -> Withheld:
    """Change ``fresh``, the main store of a backup, before it takes the place of ``present``. ``key_files``:
    where the key of its audit log is or may be made. Raises StoreError for one that cannot be used."""
    standing = _standing(present)
    database = Database(fresh)
    try:
        keys = open_keys(key_files, fresh, database.read_now(head_of))
        return asyncio.run(_bring_in(database, EventLog(database, keys=keys), standing, backup))
    finally:
        database.close()


@dataclass(frozen=True, slots=True)
class InForce:
    """What the present store has in force, and the newest entry of its log."""

    rights: Present | None
    protection: Protection
    head: Head


def _standing(present: Path) -> InForce | None:
    """Read the present store; None where there is none that can be read, which may be why it is replaced."""
    if not present.exists():
        return None
    try:
        with closing(open_for_reading(present)) as connection:
            return InForce(read_present(connection), read_protection(connection), head_of(connection))
    except (sqlite3.Error, ValueError):
        return None


async def _bring_in(
    database: Database, events: EventLog, standing: InForce | None, backup: Backup
) -> Withheld:
    def work(connection: sqlite3.Connection) -> Withheld:
        if standing is None:
            return withhold(connection, None)
        keep_in_force(connection, standing.protection)
        return withhold(connection, standing.rights)

    withheld = await database.write(work)
    replaced = () if standing is None else (_of_replaced_log(standing.head),)
    await events.record(
        kind="server",
        what=WHAT,
        who=who_calls(),
        origin=ORIGIN,
        message=joined([backup.message, *replaced, *consequences(withheld)]) or "",
    )
    return withheld


def _of_replaced_log(head: Head) -> Message:
    return Message.of("restored_over", entry=head.id, hash=head.hash)


def consequences(withheld: Withheld) -> list[Message]:
    """Name what a restore does not bring back."""
    found = [Message("withheld_sessions")]
    if withheld.tokens:
        found.append(Message.of("withheld_tokens", names=list(withheld.tokens)))
    if withheld.disabled:
        found.append(Message.of("withheld_users", names=list(withheld.disabled)))
    if withheld.lowered:
        found.append(Message.of("withheld_roles", names=list(withheld.lowered)))
    if not withheld.admins:
        found.append(Message("withheld_no_admin"))
    return found
