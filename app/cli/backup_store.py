"""``lineside backup-store`` and ``restore-store``: every store of a dashboard in one file, and back.

A copy is taken while the dashboard runs: SQLite gives each store as it is at one instant.
"""

from __future__ import annotations

import hashlib
import io
import json
import sqlite3
import tarfile
import tempfile
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import typer

from app.audit.anchor import key_anchor_of, put_aside
from app.audit.keys import find_key_file
from app.auth.withheld import Withheld
from app.cli.backup_archive import MANIFEST, STORES, open_archive
from app.cli.ending import report
from app.cli.restored_store import consequences, make_ready
from app.cli.serve import LINESIDE_TOML, Config
from app.database.connection import open_for_reading
from app.database.copies import COMPANIONS
from app.database.migrating import is_store
from app.database.private import make_file, make_private, refuse_link
from app.database.words import in_words
from app.errors import StoreError
from app.settings import STORE_FILE, load
from bus.instants import unix_now
from bus.messages import Message

ASIDE = ".before-restore"


def backup_store(
    file: Annotated[Path, typer.Argument(help="The file to write; it must not exist yet.")],
    config: Config = LINESIDE_TOML,
) -> None:
    """Copy every store (events, users, sets, history) of this configuration into one file while it runs."""
    names = write_backup(load(config).server.data, file)
    report(Message.of("stores_backed_up", file=str(file), names=[*names]))


def restore_store(
    file: Annotated[Path, typer.Argument(help="A file of backup-store.")],
    config: Config = LINESIDE_TOML,
    yes: Annotated[bool, typer.Option("--yes", help="Skip the confirmation.")] = False,
) -> None:
    """Replace the current stores with those of a backup; the current ones are kept beside them. The dashboard
    must not run. Every session ends. Tokens and users revoked or disabled since the backup stay so."""
    settings = load(config)
    server = settings.server
    if not yes:
        typer.confirm(str(Message.of("stores_replace", folder=str(server.data), file=str(file))), abort=True)
    anchor = settings.audit.anchor
    done = read_backup(file, server.data, settings.key_files, None if anchor else settings.anchor_file)
    report(Message.of("stores_restored", folder=str(server.data), names=done.names, suffix=ASIDE))
    for aside in done.anchors:
        report(Message.of("anchor_put_aside", path=str(aside)))
    if done.withheld is not None:
        if anchor is not None:
            report(Message.of("anchor_outlives_restore", path=str(anchor)))
        for consequence in consequences(done.withheld):
            report(consequence)


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
        about = {"lineside": version("lineside"), "time": unix_now(), "stores": dict(map(_digest, copies))}
        manifest = json.dumps(about, indent=1).encode()
        tar_file = Path(folder) / "complete.tar"
        make_file(tar_file)
        with tarfile.open(tar_file, "w") as archive:
            entry = tarfile.TarInfo(MANIFEST)
            entry.size = len(manifest)
            archive.addfile(entry, io.BytesIO(manifest))
            for copy in copies:
                archive.add(copy, copy.name)
        tar_file.rename(file)
    return [store.name for store in present]


def _copy(store: Path, folder: Path) -> Path:
    copy = folder / store.name
    make_file(copy)
    with in_words(store), closing(open_for_reading(store)) as live, closing(sqlite3.connect(copy)) as target:
        live.backup(target)
        fault = _fault_of(target)
    if fault:
        raise StoreError(Message.of("store_failed", path=str(store), reason=Message("store_is_damaged")))
    return copy


def _fault_of(store: sqlite3.Connection) -> str:
    """The first fault that SQLite finds; empty: it is sound."""
    (verdict,) = store.execute("PRAGMA quick_check(1)").fetchone()
    return "" if verdict == "ok" else str(verdict)


def _digest(copy: Path) -> tuple[str, str]:
    """The name and the SHA-256 of a store."""
    with copy.open("rb") as file:
        return copy.name, hashlib.file_digest(file, "sha256").hexdigest()


@dataclass(frozen=True, slots=True)
class Restored:
    """``names`` of the stores, what was ``withheld`` from the main one where the backup contains it, and the
    ``anchors`` of the log that it replaced, under their new names."""

    names: list[str]
    withheld: Withheld | None = None
    anchors: tuple[Path, ...] = ()


def read_backup(file: Path, data: Path, key_files: Sequence[Path], anchor: Path | None = None) -> Restored:
    """Put the stores of a backup into a data folder. The log of the main one continues under the key in the
    first of ``key_files``; ``anchor`` and the one beside the key are put aside, for they name what came after
    the backup.

    Raises StoreError, and then leaves everything unchanged: every store of the backup is checked, and the
    main one prepared, before the first is put in its place.
    """
    with in_words(file), open_archive(file) as archive:
        make_private(data)
        with tempfile.TemporaryDirectory(dir=data) as folder:
            proved = archive.unpack(Path(folder))
            for fresh in proved:
                _prove(fresh, file)
            for store in (data / name for name in STORES):
                _refuse_while_open(store)
            done = Restored([fresh.name for fresh in proved])
            if (fresh := Path(folder) / STORE_FILE) in proved:
                try:
                    withheld = make_ready(fresh, data / STORE_FILE, archive.message, key_files)
                except (sqlite3.Error, ValueError) as error:
                    raise _unsound(file, STORE_FILE, str(error)) from error
                # Before the stores: a log without an anchor is not taken for one that was cut off.
                done = replace(done, withheld=withheld, anchors=_anchors_put_aside(key_files, anchor))
            for fresh in proved:
                _put(fresh, data / fresh.name)
    return done


def _anchors_put_aside(key_files: Sequence[Path], anchor: Path | None) -> tuple[Path, ...]:
    key_file = find_key_file(key_files)
    anchors = (anchor, None if key_file is None else key_anchor_of(key_file))
    asides = [put_aside(path) for path in anchors if path is not None]
    return tuple(aside for aside in asides if aside is not None)


def _prove(store: Path, file: Path) -> None:
    """A store of a backup is sound, and one that Lineside made."""
    with in_words(store), closing(open_for_reading(store)) as connection:
        fault: str | Message = _fault_of(connection)
        if not fault and not is_store(connection):
            fault = Message("store_is_foreign")
    if fault:
        raise _unsound(file, store.name, fault)


def _unsound(file: Path, store: str, verdict: str | Message) -> StoreError:
    return StoreError(Message.of("backup_unsound", file=str(file), store=store, verdict=verdict))


def _refuse_while_open(store: Path) -> None:
    """Raises StoreError for a store that another program uses, and for a link, which may lead anywhere.

    A store in WAL mode gives the exclusive lock to a sole user only. A damaged one has no users: a backup is
    to take its place.
    """
    refuse_link(store)
    if not store.exists():
        return
    try:
        with closing(sqlite3.connect(store, timeout=0, isolation_level=None)) as connection:
            connection.execute("PRAGMA locking_mode = EXCLUSIVE")
            connection.execute("BEGIN EXCLUSIVE")
    except sqlite3.DatabaseError as error:
        if error.sqlite_errorcode & 0xFF == sqlite3.SQLITE_BUSY:
            raise StoreError(Message.of("store_in_use", store=str(store))) from error


def _put(fresh: Path, place: Path) -> None:
    if place.exists():
        place.replace(place.with_name(place.name + ASIDE))
    for companion in COMPANIONS:
        place.with_name(place.name + companion).unlink(missing_ok=True)
    fresh.replace(place)
