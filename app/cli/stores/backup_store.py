"""``lineside backup-store``: every store of a dashboard, and the files of its site, in one file.

A copy is taken while the dashboard runs: SQLite gives each store as it is at one instant.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import shutil
import sqlite3
import tarfile
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing, contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Annotated, NamedTuple

import click

from app.audit.archive import digest_of
from app.audit.proof import cuts_of
from app.cli.config_option import LINESIDE_TOML, Config
from app.cli.ending import report
from app.cli.options import Argument, AsJson, Option
from app.cli.stores.backup_archive import MANIFEST, STORES, open_archive
from app.cli.stores.backup_files import SiteFiles, files_of
from app.cli.stores.kept_events import FOLDER, keep, remove_others, shared_folder
from app.database.connection import open_for_reading
from app.database.migration import COMPANIONS
from app.database.private import make_file, sync_folder, write_file
from app.database.reserve import free_bytes
from app.database.words import in_words
from app.errors import StoreError
from app.settings import STORE_FILE, load
from app.version import VERSION
from bus.instants import unix_now
from bus.messages import Message

WORKING = ".lineside-backup-"
"""Begins the name of the folder in which a backup is made."""


def backup_store(
    file: Annotated[Path, Argument(help="The file to write; it must not exist yet.")],
    config: Config = LINESIDE_TOML,
    as_json: AsJson = False,
    share_events: Annotated[
        bool,
        Option(
            "--share-events",
            help=f"Keep the archived events once for all backups beside it, in the folder {FOLDER}.",
        ),
    ] = False,
) -> None:
    """Copy every store (events, users, sets, history, pictures) of this configuration into one file while the
    dashboard runs, with the archived events, the configuration and its versions; with [backup] key_file also,
    encrypted, the key of the audit log, certificates and files of passwords."""
    settings = load(config)
    files = files_of(settings)
    done = write_backup(settings.server.data, file, files, settings.audit.archive, share=share_events)
    if as_json:
        click.echo(json.dumps({"file": str(file), **done._asdict(), "left_out": files.left_out}))
        return
    report(Message.of("stores_backed_up", file=str(file), names=[*done.stores, *done.events]))
    if done.events_absent:
        report(Message.of("backup_without_events", files=[*done.events_absent]))
    if files.left_out:
        report(Message.of("backup_leaves_out", files=[*files.left_out]))


class WrittenBackup(NamedTuple):
    """The names of the ``stores`` and of the files of archived ``events`` that are in it; ``events_absent``:
    those of the archive that were not in its folder, as on a medium in a safe."""

    stores: list[str]
    events: list[str]
    events_absent: list[str]


def write_backup(
    data: Path,
    file: Path,
    files: SiteFiles | None = None,
    archive: Path | None = None,
    *,
    share: bool = False,
) -> WrittenBackup:
    """Copy the stores of a data folder, the files of its site, and the archived events of its log. Raises
    StoreError, also where a store or a file of the archive is damaged: it could not be put back; then there
    is no file. ``share``: the archived events are kept once beside the file, for it and others."""
    present = [store for name in STORES if (store := data / name).exists()]
    if not present:
        raise StoreError(Message.of("stores_missing", folder=str(data)))
    if file.exists():
        raise StoreError(Message.of("backup_exists", file=str(file)))
    beside_file = file.absolute().parent
    with in_words(file):
        _refuse_small_disk(space_needed(data, archive, beside_file / FOLDER if share else None), file)
    sharing = shared_folder(beside_file) if share else nullcontext()
    with in_words(file), _working_folder(beside_file) as folder, sharing as kept:
        copies = [_copy(store, folder) for store in present]
        beside = [] if files is None else [folder / files.member]
        for place in beside:
            write_file(place, b"" if files is None else files.content)
        events, absent = _archived(copies, archive)
        # A month may be a link to another disk.
        sources = {name: (archive or Path()).joinpath(name).resolve() for name in events}
        if kept is not None:
            keep({events[name]: source for name, source in sources.items()}, kept)
        about = {
            "lineside": VERSION,
            "time": unix_now(),
            "stores": dict(map(_digest, copies)),
            "files": dict(map(_digest, beside)),
            "events" if kept is None else "kept_events": events,
        }
        manifest, tar_file = folder / MANIFEST, folder / "complete.tar"
        write_file(manifest, json.dumps(about, indent=1).encode())
        make_file(tar_file)
        with tar_file.open("wb") as target:
            with tarfile.open(fileobj=target, mode="w") as packed:
                for part in (manifest, *copies, *beside):
                    packed.add(part, part.name)
                for name, source in sources.items() if kept is None else ():
                    packed.add(source, name)
            target.flush()
            os.fsync(target.fileno())
        with open_archive(tar_file, kept) as written:
            written.verify()
        if file.exists():
            raise StoreError(Message.of("backup_exists", file=str(file)))
        tar_file.rename(file)
        sync_folder(beside_file)
        if kept is not None:
            _remove_unreferred(kept)
    return WrittenBackup([store.name for store in present], [*events], absent)


def _remove_unreferred(kept: Path) -> None:
    """Delete the archived events to which no backup beside them refers, unless one of the backups cannot be
    read."""
    referred: set[str] = set()
    for backup in kept.parent.glob("*.tar"):
        try:
            with open_archive(backup) as archive:
                referred.update(archive.manifest.kept_events.values())
        except (OSError, StoreError):
            return
    remove_others(kept, referred)


def _archived(copies: Sequence[Path], archive: Path | None) -> tuple[dict[str, str], list[str]]:
    """The SHA-256 of each archived file of a copied log by its name, and the names of those that are not in
    the folder. They never change, and the copy names none that comes later. Raises StoreError for a damaged
    one."""
    digests: dict[str, str] = {}
    for store in (copy for copy in copies if copy.name == STORE_FILE):
        with closing(open_for_reading(store)) as connection:
            digests = {cut.file: cut.digest for cut in cuts_of(connection)}
    there = {name: digest for name, digest in digests.items() if archive and (archive / name).is_file()}
    for name, digest in there.items():
        if digest_of((archive or Path()) / name) != digest:
            raise StoreError(Message.of("audit_archive_altered", file=name))
    return there, sorted(digests.keys() - there.keys())


@contextmanager
def _working_folder(beside: Path) -> Iterator[Path]:
    """A folder on the disk of the backup, which is locked while it is used: one whose process was killed is
    known by that, and removed by the next backup."""
    for left in beside.glob(f"{WORKING}*"):
        with suppress(OSError), _locked(left):
            shutil.rmtree(left, ignore_errors=True)
    with tempfile.TemporaryDirectory(prefix=WORKING, dir=beside) as name, _locked(Path(name)):
        yield Path(name)


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(descriptor)


def space_needed(data: Path, archive: Path | None, kept: Path | None = None) -> int:
    """The bytes that a backup of a data folder takes while it is made: copies of the stores, and the file
    with them and the archived events. ``kept``: a folder that has archived events already."""
    stores = (data / f"{name}{suffix}" for name in STORES for suffix in ("", *COMPANIONS))
    events = _bytes_of(archive.glob("events-*.jsonl.gz")) if archive else 0
    events_kept = _bytes_of(kept.glob("*.jsonl.gz")) if kept else 0
    return 2 * _bytes_of(stores) + max(0, events - events_kept)


def _bytes_of(files: Iterable[Path]) -> int:
    return sum(file.stat().st_size for file in files if file.exists())


def _refuse_small_disk(needed: int, file: Path) -> None:
    free = free_bytes(file.absolute().parent)
    if needed > free:
        raise StoreError(Message.of("backup_disk_full", file=str(file), needed=needed, free=free))


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
