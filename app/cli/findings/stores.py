"""What ``lineside check`` finds of the files of a site: certificates, audit log, stores. Nothing is written.
Each function of settings is a row of the table in `check`."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from app.cli.findings.machine import (
    Finding,
    existing_part,
    fault,
    is_read_only,
    is_visible,
    may_make_files_in,
    user,
)
from app.cli.site.facts import CertificateFacts, certificate_facts, size_of
from app.core.database.connection import examining
from app.core.database.migration import (
    is_store,
    presence_of,
    refusal_to_start,
    refuse_newer,
    refuse_unfinished,
)
from app.errors import StoreError, TooCostlyError
from app.line.conditions.catalogue import DAY_S, certificate_expires
from app.line.history.status import DiskReserve, space
from app.people.audit.anchor import anchor_file
from app.people.audit.keys import KeyFileError, find_key_file, owners_of, read_key_file
from app.settings import STORE_FILE, Settings
from bus.instants import UnixTime, monotonic_now, unix_now
from bus.messages import Message, number
from bus.tls import TlsFileError, date_fault, read_certificate

MAX_EXAMINED_S = 10.0
"""For each store; what SQLite has found sound by then is taken for the rest, too."""
STEPS = 100_000
"""Of SQLite between two looks at the clock."""
MB = 1_000_000


def encryption(settings: Settings) -> Iterator[Finding]:
    """Whether the certificate and the key of the server can be used together now."""
    tls = settings.server.tls
    if tls is None:
        if settings.server.is_in_clear:
            yield Finding(Message("check_no_tls"))
        return
    from app.core.server.tls import ServerCertificate

    try:
        reason = ServerCertificate(tls).fault
    except TlsFileError as error:
        reason = error.message
    if reason is not None:
        yield fault("check_tls_refused", reason=reason)


def certificates(settings: Settings) -> Iterator[Finding]:
    """How long each certificate is valid. What is wrong with the server's is in `encryption`."""
    now, tls = unix_now(), settings.server.tls
    for each in certificate_facts(settings):
        if (refusal := _refusal(each, now)) is None:
            assert each.certificate is not None
            soon = certificate_expires(each.certificate.ends_at, now)
            days = int((each.certificate.ends_at - now) / DAY_S)
            code = "live_certificate_ends_soon" if soon else "live_certificate"
            yield Finding(Message.of(code, file=each.file, n=days, day=each.certificate.ends_on))
        elif tls is None or each.file != str(tls.certificate):
            yield fault("live_certificate_refused", reason=refusal)


def _refusal(each: CertificateFacts, now: UnixTime) -> Message | None:
    """Why a certificate cannot be used."""
    file = Path(each.file)
    if each.certificate is not None:
        return date_fault(each.certificate, file, now)
    try:
        read_certificate(file)
    except TlsFileError as error:
        return error.message
    return Message.of("tls_no_certificate", file=each.file)


def key(settings: Settings) -> Iterator[Finding]:
    """Whether the key of the audit log can be read, or made at the first start."""
    paths, store = settings.key_files, settings.server.store
    if (found := find_key_file(paths)) is not None:
        try:
            read_key_file(found, owners_of(store if is_visible(store) else None))
        except KeyFileError as error:
            yield fault("check_key_refused", reason=error.message)
        else:
            yield Finding(Message.of("check_key", file=str(found)))
        return
    *others, last = paths
    writable = next((path for path in others if may_make_files_in(path.parent)), None)
    if writable is not None:
        yield Finding(Message.of("check_key_new", file=str(writable)))
    elif not others and not may_make_files_in(last.parent):
        yield fault("check_key_not_creatable", user=user(), file=str(last), folder=str(last.parent))
    else:
        yield Finding(Message.of("check_key_new_beside_data" if others else "check_key_new", file=str(last)))


def anchor(settings: Settings) -> Iterator[Finding]:
    """Whether the anchor can be written. At the default place it is no fault: the start reports it."""
    path, is_configured = anchor_file(settings.audit, settings.key_files), settings.audit.anchor is not None
    exists = is_visible(path)
    # Path.is_symlink raises for a name that is too long.
    if os.path.islink(path) or (exists and not path.is_file()):  # noqa: PTH114
        yield fault("check_anchor_no_file", file=str(path))
    elif not (os.access(path, os.W_OK) if exists else may_make_files_in(path.parent)):
        yield Finding(Message.of("check_anchor_not_writable", user=user(), file=str(path)), is_configured)
    else:
        yield Finding(Message.of("check_anchor", file=str(path)))


def archive(settings: Settings) -> Iterator[Finding]:
    """Whether events can be archived."""
    if (folder := settings.audit.archive) is None:
        return
    if not folder.is_dir():
        yield fault("audit_archive_folder_missing", folder=str(folder))
    elif is_read_only(folder):
        yield fault("check_disk_read_only", path=str(folder))
    elif not may_make_files_in(folder):
        yield fault("check_archive_not_writable", user=user(), folder=str(folder))
    else:
        yield Finding(Message.of("check_archive", folder=str(folder)))


def disk(settings: Settings) -> Iterator[Finding]:
    """Judge the free space: a trial to write a byte succeeds where history has stopped already."""
    folder = existing_part(settings.server.data)
    free, reserve = shutil.disk_usage(folder).free, DiskReserve()
    match space(free, reserve):
        case "paused":
            full = {"free": free // MB, "reserve": reserve.pause // MB}
            yield fault("check_disk_full", folder=str(folder), **full)
        case "scarce" | "low":
            yield Finding(Message.of("check_disk_low", folder=str(folder), free=free // MB))


def stores(settings: Settings) -> Iterator[Finding]:
    """Examine each store of the data folder."""
    folder, main = settings.server.data, settings.server.store
    try:
        found = sorted({main, *folder.glob("*.db")}) if existing_part(folder) == folder else [main]
        refusal = refusal_to_start(main, presence_of(main), find_key_file(settings.key_files), new=False)
    except (StoreError, OSError) as error:
        yield fault("check_store_refused", reason=_reason(error))
        return
    if refusal is not None:
        yield fault("check_store_refused", reason=refusal)
        found.remove(main)
    yield from (_store(store) for store in found if is_visible(store))


def _store(store: Path) -> Finding:
    if is_read_only(store):
        return fault("check_disk_read_only", path=str(store))
    try:
        with examining(store) as connection:
            end = monotonic_now() + MAX_EXAMINED_S
            connection.set_progress_handler(lambda: monotonic_now() > end, STEPS)
            refuse_unfinished(connection, store)
            if store.name == STORE_FILE and is_store(connection):
                refuse_newer(connection, store)
            (verdict,) = connection.execute("PRAGMA quick_check(1)").fetchone()
    except TooCostlyError:
        verdict = "ok"
    except (StoreError, OSError) as error:
        return fault("check_store_refused", reason=_reason(error))
    if verdict != "ok":
        return fault("check_store_damaged", path=str(store), verdict=verdict)
    return Finding(Message.of("check_store", path=str(store), size=number(f"{size_of(store) / MB:.1f}")))


def _reason(error: StoreError | OSError) -> Message:
    return error.message if isinstance(error, StoreError) else Message.of("system_error", error=str(error))
