"""A store from a backup, prepared to replace the present one: rights that were withdrawn
since stay so, blocks and limits stay in force, and an event names who restored it."""

from __future__ import annotations

import sqlite3
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from app.audit.chain import Head
from app.audit.store import head_of
from app.auth.withheld import Present, Withheld, read_present, withhold
from app.cli.accounts import open_log, record
from app.commands.safeguards.limits import Protection, keep_in_force, read_protection
from app.database import Database
from app.database.connection import open_for_reading
from bus.messages import Message, joined


def make_ready(fresh: Path, present: Path, backup: Message, key_files: Sequence[Path]) -> Withheld:
    """Change ``fresh``, the main store of a backup, before it takes the place of ``present``. ``key_files``:
    where the key of its audit log is or may be made. Raises StoreError for one that cannot be used."""
    standing = _standing(present)

    def bring_in(connection: sqlite3.Connection) -> Withheld:
        if standing is None:
            return withhold(connection, None)
        keep_in_force(connection, standing.protection)
        return withhold(connection, standing.rights)

    with closing(Database(fresh)) as database:
        events = open_log(database, key_files)
        withheld = database.write_now(bring_in)
        replaced = None
        if standing is not None:
            replaced = Message.of("restored_over", entry=standing.head.id, hash=standing.head.hash)
        message = joined([backup, replaced, *consequences(withheld)]) or ""
        record(events, "server", Message("event_stores_restored"), message)
    return withheld


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


def consequences(withheld: Withheld) -> list[Message]:
    """Name what a restore does not bring back."""
    found = [Message("withheld_sessions")]
    names = {
        "withheld_tokens": withheld.tokens,
        "withheld_users": withheld.disabled,
        "withheld_roles": withheld.lowered,
    }
    found += [Message.of(code, names=list(those)) for code, those in names.items() if those]
    if not withheld.admins:
        found.append(Message("withheld_no_admin"))
    return found
