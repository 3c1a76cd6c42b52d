"""Whether the plant's database that a configuration names takes what is published. Every trial is undone."""

from __future__ import annotations

from collections.abc import Iterator
from secrets import token_hex

from app.cli.findings.machine import Finding
from app.core.database.connection import examining, has_table
from app.core.server.settings import can_others_read
from app.errors import StoreError
from app.settings import Settings
from app.system.postgresql.destination import Destination
from app.system.postgresql.outbox import read_identity
from app.system.postgresql.publisher import PublisherStatus
from bus.instants import unix_now
from bus.messages import Message


def postgresql_findings(settings: Settings) -> Iterator[Finding]:
    """The file of the password, the server, the rights, the tables, and the clocks."""
    to = settings.postgresql
    if to is None:
        return
    if to.password_file is not None and can_others_read(to.password_file):
        yield Finding(Message.of("check_secret_open", path=str(to.password_file)))
    destination = Destination(to, settings.site.name, _identity(settings), settings.bus)
    try:
        ahead = destination.examine()
    except StoreError as error:
        yield Finding(error.message, is_fault=True)
        return
    finally:
        destination.abandon()
    yield Finding(Message.of("check_postgresql", place=to.place, schema=to.db_schema))
    notice = PublisherStatus(to.place, unix_now(), clock_ahead_s=ahead).notice
    if notice is not None:
        yield Finding(notice, is_fault=True)


def _identity(settings: Settings) -> str:
    """That of the store; before its first start a server has none that is known to a database."""
    try:
        with examining(settings.server.store) as connection:
            if has_table(connection, "publisher_identity"):
                return read_identity(connection)
    except StoreError:
        pass  # `lineside check` has the reason already
    return token_hex(16)
