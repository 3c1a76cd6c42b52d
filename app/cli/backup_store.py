"""``lineside backup-store``: every store of a dashboard in one file.

A copy is taken while the dashboard runs: SQLite gives each store as it is at one instant.
"""

from __future__ import annotations

import hashlib
import json
import sqlite3
import tarfile
import tempfile
from contextlib import closing
from pathlib import Path
from typing import Annotated

from app.cli.backup_archive import MANIFEST, STORES, open_archive
from app.cli.config_option import LINESIDE_TOML, Config
from app.cli.ending import report
from app.cli.options import Argument
from app.database.connection import open_for_reading
from app.database.opening import require_files
from app.database.private import make_file, write_file
from app.database.words import in_words
from app.errors import StoreError
from app.settings import load
from app.version import VERSION
from bus.instants import unix_now
from bus.messages import Message


def backup_store(
    file: Annotated[Path, Argument(help="The file to write; it must not exist yet.")],
    config: Config = LINESIDE_TOML,
) -> None:
    """Copy every store (events, users, sets, history) of this configuration into one file while it runs."""
    settings = load(config)
    require_files(settings.store, "pg_dump")
    names = write_backup(settings.server.data, file)
    report(Message.of("stores_backed_up", file=str(file), names=[*names]))


def write_backup(data: Path, file: Path) -> list[str]:
    """Copy the stores of a data folder; gives their names. Raises StoreError, also where a store is damaged:
    it could not be put back; then there is no file."""
    present = [store for name in STORES if (store := data / name).exists()]
    if not present:
        raise StoreError(Message.of("stores_missing", folder=str(data)))
    if file.exists():
        raise StoreError(Message.of("backup_exists", file=str(file)))
    with in_words(file), tempfile.TemporaryDirectory(dir=file.absolute().parent) as folder:
        copies = [_copy(store, Path(folder)) for store in present]
        about = {"lineside": VERSION, "time": unix_now(), "stores": dict(map(_digest, copies))}
        manifest, tar_file = Path(folder) / MANIFEST, Path(folder) / "complete.tar"
        write_file(manifest, json.dumps(about, indent=1).encode())
        make_file(tar_file)
        with tarfile.open(tar_file, "w") as archive:
            for part in (manifest, *copies):
                archive.add(part, part.name)
        with open_archive(tar_file) as written:
            written.verify()
        tar_file.rename(file)
    return [store.name for store in present]


def _copy(store: Path, folder: Path) -> Path:
    copy = folder / store.name
    make_file(copy)
    with in_words(store), closing(open_for_reading(store)) as live, closing(sqlite3.connect(copy)) as target:
        live.backup(target)
        fault = fault_of(target)
    if fault:
        raise StoreError(Message.of("store_failed", path=str(store), reason=Message("store_is_damaged")))
    return copy


def fault_of(store: sqlite3.Connection) -> str:
    """The first fault that SQLite finds; empty: it is sound."""
    (verdict,) = store.execute("PRAGMA quick_check(1)").fetchone()
    return "" if verdict == "ok" else str(verdict)


def _digest(copy: Path) -> tuple[str, str]:
    """The name and the SHA-256 of a store."""
    with copy.open("rb") as file:
        return copy.name, hashlib.file_digest(file, "sha256").hexdigest()
