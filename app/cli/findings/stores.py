"""What ``lineside check`` finds of the stores and of the disk that they are on. Nothing is written."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

from app.audit.keys import find_key_file
from app.cli.findings.machine import Finding, existing_part, fault, is_read_only, is_visible
from app.cli.site.facts import size_of
from app.database.connection import examining
from app.database.migration import is_store, refuse_newer, refuse_unfinished
from app.database.presence import presence_of, refusal_to_start
from app.errors import StoreError, TooCostlyError
from app.history.status import DiskReserve, space
from app.settings import STORE_FILE, Settings
from bus.instants import monotonic_now
from bus.messages import Message, number

MAX_EXAMINED_S = 10.0
"""For each store; what SQLite has found sound by then is taken for the rest, too."""
STEPS = 100_000
"""Of SQLite between two looks at the clock."""
MB = 1_000_000


def store_findings(settings: Settings) -> Iterator[Finding]:
    """Examine each store of the data folder, and its disk."""
    folder, main = settings.server.data, settings.server.store
    existing = existing_part(folder)
    yield from _disk(existing)
    try:
        stores = sorted({main, *folder.glob("*.db")}) if existing == folder else [main]
        key = find_key_file(settings.key_files)
        refusal = refusal_to_start(main, presence_of(main), key, new=False)
    except (StoreError, OSError) as error:
        yield fault("check_store_refused", reason=_reason(error))
        return
    if refusal is not None:
        yield fault("check_store_refused", reason=refusal)
    for store in stores:
        if is_visible(store) and not (refusal is not None and store == main):
            yield _store(store)


def _disk(folder: Path) -> Iterator[Finding]:
    """Judge the free space: a trial to write a byte succeeds where history has stopped already."""
    free = shutil.disk_usage(folder).free
    match space(free, DiskReserve()):
        case "paused":
            yield fault(
                "check_disk_full", folder=str(folder), free=free // MB, reserve=DiskReserve().pause // MB
            )
        case "scarce" | "low":
            yield Finding(Message.of("check_disk_low", folder=str(folder), free=free // MB))


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
