"""What the files of a site hold of its operation, whether its dashboard runs or not. Nothing is made or
changed."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from zoneinfo import ZoneInfo

from app.cli.findings.backup import folder_fault
from app.cli.findings.machine import existing_part
from app.core.database.connection import examining, has_table
from app.core.database.files import free_bytes
from app.core.database.migration import COMPANIONS
from app.errors import StoreError
from app.line.history.series.runs import micros
from app.line.history.service import FILE as HISTORY
from app.line.history.service import seconds
from app.line.history.status import MAX_DAYS, days_left, growth_of_events, growth_of_history
from app.settings import STORE_FILE, Settings
from app.system.backup.folder import next_due
from app.system.backup.service import newest_in
from app.system.backup.stores import STORES
from app.system.postgresql.outbox import read_cursor
from bus.instants import UnixTime
from bus.messages import Message
from bus.tls import Certificate, MalformedCertificateError, certificates_in


@dataclass(frozen=True, slots=True)
class DiskFacts:
    """``days``: for how long the free bytes are enough; None: not known yet. At most `MAX_DAYS`."""

    stores: dict[str, int]
    free: int
    days: float | None


@dataclass(frozen=True, slots=True)
class CertificateFacts:
    """A file of certificates, and the one whose dates decide; None where it cannot be read."""

    file: str
    certificate: Certificate | None

    @property
    def ends_at(self) -> UnixTime | None:
        return None if self.certificate is None else self.certificate.ends_at


@dataclass(frozen=True, slots=True)
class BackupFacts:
    """When the newest backup was begun, and when the next is due. ``fault``: why none can be written now."""

    folder: str
    is_there: bool
    fault: Message | None
    newest: UnixTime | None
    next: UnixTime


def disk_facts(settings: Settings, now: UnixTime) -> DiskFacts:
    """The stores of the data folder in bytes, and how long its disk lasts."""
    data = settings.server.data
    stores = {name: size for name in STORES if (size := size_of(data / name))}
    free = free_bytes(existing_part(data))
    days = _forecast(settings, stores, free, now)
    return DiskFacts(stores, free, days)


def certificate_facts(settings: Settings) -> list[CertificateFacts]:
    """Every certificate that the configuration names."""
    tls = settings.server.tls
    own = [] if tls is None else [_certificate(tls.certificate, min)]
    authorities = {*settings.notify.certificates, *([tls.client_ca] if tls and tls.client_ca else [])}
    return [*own, *(_certificate(path, max) for path in sorted(authorities))]


def backup_facts(settings: Settings, now: UnixTime) -> BackupFacts | None:
    """The backups; None where there are to be none."""
    folder = settings.backup.folder
    if folder is None:
        return None
    zone = ZoneInfo(settings.site.zone)
    newest = newest_in(folder, now, zone)
    due = next_due(now, newest, None, settings.backup, zone)
    return BackupFacts(str(folder), folder.is_dir(), folder_fault(settings), newest, max(now, due))


@dataclass(frozen=True, slots=True)
class PublisherFacts:
    """The plant's database; ``until``: up to when it has everything, as far as the store knows."""

    place: str
    until: UnixTime | None


def publisher_facts(settings: Settings) -> PublisherFacts | None:
    """How far the plant's database is; None where nothing is published."""
    if settings.postgresql is None:
        return None
    until = None
    with suppress(StoreError), examining(settings.server.store) as connection:
        if has_table(connection, "publisher_cursor") and (cursor := read_cursor(connection)):
            until = seconds(cursor.until)
    return PublisherFacts(settings.postgresql.place, until)


def size_of(store: Path) -> int:
    """Return the bytes of a store with what SQLite has beside it."""
    total = 0
    for path in (store, *(store.with_name(store.name + companion) for companion in COMPANIONS)):
        with suppress(OSError):
            total += path.stat().st_size
    return total


def _forecast(settings: Settings, stores: dict[str, int], free: int, now: UnixTime) -> float | None:
    data = settings.server.data
    if not {HISTORY, STORE_FILE} <= stores.keys():
        return None
    try:
        with examining(data / HISTORY) as connection:
            history = growth_of_history(connection, micros(now))
        with examining(data / STORE_FILE) as connection:
            events = growth_of_events(
                connection, stores[STORE_FILE], is_archived=settings.audit.archive is not None
            )
    except StoreError:
        return None
    if history is None:
        return None
    readings, rollups, stored_days = history
    kept = settings.history.raw_days
    left = days_left(free, readings, stored_days, kept, rollups + events)
    return MAX_DAYS if left is None else left


def _certificate(path: Path, which: Callable[..., Certificate]) -> CertificateFacts:
    """``which``: of several, that of a server ends with the first, authorities with the last."""
    try:
        found = certificates_in(path.read_text())
        return CertificateFacts(str(path), which(found, key=lambda each: each.ends_at))
    except (OSError, UnicodeDecodeError, MalformedCertificateError):
        return CertificateFacts(str(path), None)
