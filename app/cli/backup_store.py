"""The command ``lineside backup-store``: a backup of all data of a site, in a folder of backups or as one
file.

The command ``lineside restore-store``: the stores of a backup replace the present ones. Rights that were
withdrawn since then stay withdrawn, blocks and limits stay in force, and an event names who restored.
"""

from __future__ import annotations

import json
import sqlite3
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from zoneinfo import ZoneInfo

import click

from app.cli.command import PATH, become_owner_of, config_option, json_option, report, typed_time, yes_option
from app.cli.site import open_log, reading_site, record
from app.core.database import Database, StoreConnection
from app.core.database.connection import examining, open_for_reading
from app.core.database.files import in_words, make_private, refuse_link
from app.core.database.migration import COMPANIONS, is_store
from app.errors import StoreError
from app.line.commands.limits import Protection, keep_in_force, read_protection
from app.people.audit.anchor import anchor_file, put_aside
from app.people.audit.entry import Head, newest_of
from app.people.audit.proof import heads_of
from app.people.auth.rights import Present, Withheld, read_present, tokens_to_revoke, withhold
from app.settings import STORE_FILE, Settings, load
from app.system.backup.archive import Backup, open_archive, write_archive
from app.system.backup.folder import open_newest, write_to_folder
from app.system.backup.stores import STORES, fault_of, files_of, place_files
from app.system.postgresql.destination import Destination
from app.system.postgresql.outbox import read_identity
from bus.instants import UnixTime, unix_now
from bus.messages import Message, joined

ASIDE = ".before-restore"


@click.command
@click.argument(
    "file", type=PATH, help="A folder of backups of this site, or a file to write; it must not exist yet."
)
@config_option
@json_option
def backup_store(file: Path, config: Path, as_json: bool) -> None:
    """Copy every store (events, users, sets, history, pictures) of this configuration while the dashboard
    runs, with the archived events, the configuration and its versions; with [backup] key_file also,
    encrypted, the key of the audit log, certificates and files of passwords. In a folder of backups it writes
    only new data, and removes the backups that [backup] does not keep."""
    settings = load(config)
    if file.is_dir():
        done = write_to_folder(settings, file, unix_now())
    else:
        done = write_archive(settings.server.data, file, files_of(settings), settings.audit.archive)
    if as_json:
        click.echo(json.dumps(done._asdict()))
        return
    report(Message.of("stores_backed_up", file=done.file, names=[*done.stores, *done.events]))
    if done.events_absent:
        report(Message.of("backup_without_events", files=[*done.events_absent]))
    if done.left_out:
        report(Message.of("backup_leaves_out", files=[*done.left_out]))
    if done.damaged:
        report(Message.of("backup_contents_lost", n=len(done.damaged)))


@click.command
@click.argument("file", type=PATH, required=False, help="A backup in one file.")
@config_option
@click.option(
    "--from",
    "folder",
    type=PATH,
    help="Instead of a file: a folder of backups, of which the newest is taken.",
)
@click.option(
    "--at",
    default="",
    show_default=False,
    help="With --from: the newest that was begun until this time, as 2026-11-29T10:30.",
)
@yes_option
@click.option(
    "--keep-tokens", is_flag=True, help="Keep also tokens of the backup that the present store does not know."
)
@click.option(
    "--files-to",
    type=PATH,
    help="Restore no store: write the configuration and the other files into this new folder.",
)
@click.option(
    "--key-file", type=PATH, help="The key of [backup] that the files are encrypted with, for --files-to."
)
def restore_store(
    file: Path | None,
    config: Path,
    folder: Path | None,
    at: str,
    yes: bool,
    keep_tokens: bool,
    files_to: Path | None,
    key_file: Path | None,
) -> None:
    """Replace the current stores by those of a backup; the current ones are kept beside them. The dashboard
    must not run. Every session ends. Users disabled since the backup stay disabled; tokens that are unknown
    now are revoked, as is printed before anything is replaced."""
    if (file is None) == (folder is None):
        raise click.UsageError(str(Message("restore_needs_one")))
    if files_to is not None:
        with _opened(file, folder, at) as archive:
            placed = place_files(*archive.files(), key_file, files_to)
        for path in placed:
            report(Message.of("backup_file_placed", path=str(path)))
        return
    settings = load(config)
    server = settings.server
    anchor = settings.audit.anchor
    with _opened(file, folder, at, settings.site.zone) as backup:

        def begin(revoked: Sequence[str]) -> None:
            if revoked:
                report(Message.of("restore_revokes_tokens", names=[*revoked]))
            if not yes:
                _confirm(backup.path, server.data)

        done = put_back(
            backup,
            server.data,
            settings.key_files,
            None if anchor else anchor_file(settings.audit, settings.key_files),
            settings.audit.archive,
            begin=begin,
            keep_tokens=keep_tokens,
        )
        _report(done, backup, server.data, anchor)
        _report_published(settings, backup)


def _report_published(settings: Settings, backup: Backup) -> None:
    """Report the data in the plant's database that is newer than the backup."""
    if settings.postgresql is None:
        return
    place = settings.postgresql.place
    try:
        with reading_site(settings) as store:
            destination = Destination(
                settings.postgresql, settings.site.name, read_identity(store), settings.bus
            )
        try:
            extents = destination.extents(UnixTime(backup.manifest.time))
        finally:
            destination.abandon()
    except StoreError as error:
        report(Message.of("restore_published_unknown", place=place, reason=error.message))
        return
    codes = "restore_published_events", "restore_published_readings"
    for code, (count, first, last) in zip(codes, extents, strict=True):
        if first is not None and last is not None:
            span = {"first": first.isoformat(timespec="seconds"), "last": last.isoformat(timespec="seconds")}
            report(Message.of(code, place=place, n=count, **span))
    if not any(count for count, *_ in extents):
        report(Message.of("restore_published_none", place=place))


@contextmanager
def _opened(file: Path | None, folder: Path | None, at: str = "", zone: str = "UTC") -> Iterator[Backup]:
    """Open the backup that the options name. Raise StoreError."""
    if file is not None:
        with in_words(file), open_archive(file) as archive:
            yield archive
    elif folder is not None:
        with in_words(folder):
            yield open_newest(
                folder, typed_time(at, ZoneInfo(zone), "restore_time_malformed") if at else None
            )


def _report(done: Restored, backup: Backup, data: Path, anchor: Path | None) -> None:
    report(Message.of("stores_restored", folder=str(data), names=done.names, suffix=ASIDE))
    for path in done.events:
        report(Message.of("backup_file_placed", path=str(path)))
    if done.events_lost:
        report(
            Message.of(
                "backup_events_lost", folder=str(backup.path.absolute().parent), files=[*done.events_lost]
            )
        )
    if backup.lost:
        report(Message.of("backup_parts_lost", n=len(backup.lost)))
    if done.anchor is not None:
        report(Message.of("anchor_put_aside", path=str(done.anchor)))
    if done.withheld is not None:
        if anchor is not None:
            report(Message.of("anchor_outlives_restore", path=str(anchor)))
        for consequence in consequences(done.withheld):
            report(consequence)


def _confirm(file: Path, folder: Path) -> None:
    if not click.confirm(str(Message.of("stores_replace", folder=str(folder), file=str(file)))):
        report(Message("nothing_replaced"), err=True)
        raise click.exceptions.Exit(1)


@dataclass(frozen=True, slots=True)
class Restored:
    """The result of a restore. ``withheld``: parts left out of the main store, None if the backup has no main
    store; ``anchor``: the anchor of the replaced log under its new name; ``events``: files added to the
    archive of events; ``events_lost``: files that should be beside the backup but are missing."""

    names: list[str]
    withheld: Withheld | None
    anchor: Path | None
    events: tuple[Path, ...]
    events_lost: tuple[str, ...]


def put_back(
    backup: Backup,
    data: Path,
    key_files: Sequence[Path],
    anchor: Path | None = None,
    event_archive: Path | None = None,
    *,
    begin: Callable[[Sequence[str]], None] = lambda _: None,
    keep_tokens: bool = False,
) -> Restored:
    """Put the stores of a backup into a data folder. The main store's log continues with the key in the first
    of ``key_files``; ``anchor``, which may name entries newer than the backup, is put aside.
    ``event_archive``: the folder that gets archived events that it lacks. ``begin`` is called with the names
    of the tokens that will be revoked, before anything is replaced; an exception from it ends the restore.

    Raise StoreError, and then leave all unchanged except for archived events that came back: every store of
    the backup is checked, and the main store prepared, before the first is put in its place.
    """
    # Only now: only root may be able to read the backup.
    message = backup.message
    become_owner_of(data)
    make_private(data)
    if backup.manifest.all_events:
        _require_archive(event_archive)
    with tempfile.TemporaryDirectory(dir=data) as folder:
        proved = backup.unpack(Path(folder))
        for fresh in proved:
            _prove(fresh, backup.path)
        for store in (data / name for name in STORES):
            _refuse_while_open(store)
        fresh = Path(folder) / STORE_FILE
        begin([] if keep_tokens or fresh not in proved else _tokens_to_revoke(fresh, data / STORE_FILE))
        withheld: Withheld | None = None
        put_away: Path | None = None
        events: tuple[Path, ...] = ()
        lost: tuple[str, ...] = ()
        if fresh in proved:
            try:
                present = data / STORE_FILE
                withheld = _make_ready(fresh, present, message, key_files, keep_tokens=keep_tokens)
            except (sqlite3.Error, ValueError) as error:
                raise _unsound(backup.path, STORE_FILE, str(error)) from error
            if backup.manifest.all_events and event_archive:
                events = tuple(backup.unpack_events(event_archive))
                lost = tuple(
                    name for name in backup.manifest.all_events if not (event_archive / name).exists()
                )
            # Before the stores: a log without an anchor does not count as one that was cut off.
            put_away = None if anchor is None else put_aside(anchor)
        for fresh in proved:
            _put(fresh, data / fresh.name)
    return Restored([fresh.name for fresh in proved], withheld, put_away, events, lost)


def _tokens_to_revoke(fresh: Path, present: Path) -> list[str]:
    standing = _standing(present)
    with examining(fresh) as connection:
        return tokens_to_revoke(connection, None if standing is None else standing.rights)


def _require_archive(folder: Path | None) -> None:
    if folder is None:
        raise StoreError(Message("backup_needs_archive"))
    if not folder.is_dir():
        raise StoreError(Message.of("audit_archive_folder_missing", folder=str(folder)))


def _prove(store: Path, file: Path) -> None:
    """Raise StoreError for a store of a backup that is damaged, or not from Lineside."""
    with examining(store) as connection:
        fault: str | Message = fault_of(connection)
        if not fault and not is_store(connection):
            fault = Message("store_is_foreign")
    if fault:
        raise _unsound(file, store.name, fault)


def _unsound(file: Path, store: str, fault: str | Message) -> StoreError:
    return StoreError(Message.of("backup_unsound", file=str(file), store=store, verdict=fault))


def _refuse_while_open(store: Path) -> None:
    """Raise StoreError for a store that another program uses, and for a link, which may lead anywhere.

    A store in WAL mode gives its exclusive lock to a sole user only. A damaged store has no users, and is
    replaced.
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


def _make_ready(
    fresh: Path, present: Path, backup: Message, key_files: Sequence[Path], *, keep_tokens: bool = False
) -> Withheld:
    """Prepare ``fresh``, the main store of a backup, to replace ``present``. ``key_files``: the places where
    the key of its audit log is or may be created. Raise StoreError for a store that cannot be used."""
    standing = _standing(present)

    def bring_in(connection: StoreConnection) -> Withheld:
        if standing is None:
            return withhold(connection, None, keep_tokens=keep_tokens)
        keep_in_force(connection, standing.protection)
        return withhold(connection, standing.rights, keep_tokens=keep_tokens)

    with closing(Database(fresh)) as database:
        events = open_log(database, key_files)
        withheld = database.write_now(bring_in)
        newest = None if standing is None else standing.newest
        replaced = newest and Message.of("restored_over", entry=newest.id, hash=newest.hash)
        message = joined([backup, *([replaced] if replaced else []), *consequences(withheld)]) or ""
        record(events, "server", Message("event_stores_restored"), message)
    return withheld


@dataclass(frozen=True, slots=True)
class InForce:
    """The rights and protection in force in the present store, and its newest log entry."""

    rights: Present | None
    protection: Protection
    newest: Head


def _standing(present: Path) -> InForce | None:
    """Read the present store; return None if that fails, as it may be replaced for being damaged."""
    if not present.exists():
        return None
    try:
        with closing(open_for_reading(present)) as connection:
            newest = newest_of(heads_of(connection).values())
            return InForce(read_present(connection), read_protection(connection), newest)
    except (sqlite3.Error, ValueError):
        return None


def consequences(withheld: Withheld) -> list[Message]:
    """Return messages about the parts that a restore does not bring back."""
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
