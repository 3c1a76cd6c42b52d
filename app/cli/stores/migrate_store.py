"""``lineside migrate-store``: all stores of a site into another engine or place, and back."""

from __future__ import annotations

import os
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated
from urllib.parse import urlsplit

from pydantic import ValidationError

from app.audit.proof.keys import find_key_file
from app.cli.config_option import LINESIDE_TOML, Config
from app.cli.ending import wrong_option
from app.cli.findings.machine import existing_part
from app.cli.options import Option
from app.cli.serving.hosting import DATA_IN_USE, HostingError, only_one
from app.cli.setup.rights import become_owner_of
from app.cli.site.audit import proof_of
from app.cli.stores.copy_report import MB, CopyReport, JsonReport, TextReport
from app.database.copying.places import Folder, PostgresqlPlace, StorePart, StorePlace
from app.database.copying.site import RUNNING, SiteCopy, require_own_version, state_of
from app.database.engine import size_of
from app.database.migration import MIGRATIONS
from app.database.opening import MAIN
from app.database.settings import IN_FILES, SCHEMES, StoreSettings
from app.database.sqlite.reserve import free_bytes
from app.errors import StoreError
from app.handover.notes import pictures
from app.history import service
from app.history.intake import opening
from app.home.store import holders_now
from app.settings import STORE_FILE, Settings, load
from bus.messages import Message

MAIN_PART = StorePart(MAIN, STORE_FILE, MIGRATIONS)
PARTS = (
    MAIN_PART,
    StorePart("history", service.FILE, opening.MIGRATIONS),
    StorePart("pictures", pictures.FILE, pictures.MIGRATIONS),
)


def migrate_store(
    to: Annotated[
        str,
        Option(help="postgresql://…, or 'sqlite' for the data folder of the configuration, or a folder."),
    ],
    config: Config = LINESIDE_TOML,
    password_file: Annotated[
        Path | None, Option(help="A file whose first line is the password of the database.")
    ] = None,
    as_json: Annotated[
        bool, Option("--json", help="One JSON object for each table, and one at the end.")
    ] = False,
) -> None:
    """Copy every store of this configuration to another place. Nothing of the source is changed.

    While a server uses the source, what there is is copied; the same command, once it is stopped, copies what
    has changed since, compares both sides by count and SHA-256, and finishes. A copy that was ended goes on.
    """
    settings = load(config)
    become_owner_of(settings.server.data)
    source, target = _source(settings), _target(to, password_file, settings)
    if source == target:
        raise wrong_option("--to", "copy_onto_itself")
    report: CopyReport = (JsonReport if as_json else TextReport)()
    with ExitStack() as held:
        require_own_version(source, PARTS)
        _require_space(source, target)
        servers = _hold(held, settings, source, target)
        mark = RUNNING if servers else state_of(source, MAIN_PART)
        copy = SiteCopy(source, target, PARTS, mark)
        for step in copy.follow():
            report.show(step)
        if servers:
            report.end_running(servers)
            return
        _refuse_changed(source, mark)
        report.require_equal()
        moved = _moved(settings, target)
        proof, fault = _proof(moved)
        copy.finish()
        report.end_finished(_changes(config, settings, moved), proof, fault)


def _source(settings: Settings) -> StorePlace:
    return PostgresqlPlace(settings.store) if settings.store.url else Folder(settings.server.data)


def _target(to: str, password_file: Path | None, settings: Settings) -> StorePlace:
    """Raises click.BadParameter for what is neither a URL nor a folder."""
    try:
        parts = urlsplit(to)
        if parts.scheme in SCHEMES:
            store = StoreSettings(url=to, password_file=password_file and password_file.absolute())
            return PostgresqlPlace(store)
    except (ValueError, ValidationError) as error:
        raise wrong_option("--to", "setting_store_url") from error
    if password_file is not None:
        raise wrong_option("--password-file", "copy_password_for_files")
    if to == "sqlite":
        return Folder(settings.server.data)
    folder = Path(parts.path) if parts.scheme == "file" and not parts.netloc else Path(to)
    if not to or (parts.scheme and parts.scheme != "file") or (folder.exists() and not folder.is_dir()):
        raise wrong_option("--to", "copy_to_unknown", to=to)
    return Folder(folder.expanduser().resolve())


def _hold(held: ExitStack, settings: Settings, source: StorePlace, target: StorePlace) -> list[str]:
    """Keep servers from starting on the folders, to the end; gives the servers that use the source. Raises
    HostingError where a server uses the folder of the copy."""
    data = settings.server.data
    if isinstance(target, Folder) and target.path != data:
        held.enter_context(only_one(target.path))
    try:
        held.enter_context(only_one(data))
    except HostingError as error:
        if error.message.code != DATA_IN_USE:
            raise
        return sorted({settings.server.id, *_homes_at(source)})
    return servers_at(source)


def servers_at(place: StorePlace) -> list[str]:
    """The servers that use a database. That of a folder holds its lock. Raises StoreError."""
    if isinstance(place, Folder):
        return []
    return _homes_at(place) or ([str(Message("copy_a_server"))] if place.servers() else [])


def _homes_at(place: StorePlace) -> list[str]:
    with place.reading(MAIN_PART) as side, side.in_words():
        return holders_now(side.connection)


def _require_space(source: StorePlace, target: StorePlace) -> None:
    """Raises StoreError where a folder has not the space for what is not there yet."""
    if not isinstance(target, Folder):
        return
    needed = 0
    for part in PARTS:
        if source.has(part):
            with source.reading(part) as side, side.in_words():
                needed += size_of(side.connection)
        if target.has(part):
            needed -= (target.path / part.file).stat().st_size
    free = free_bytes(existing_part(target.path))
    if needed > free:
        missing = {"needed": needed // MB, "free": free // MB}
        raise StoreError(Message.of("copy_needs_space", path=target.name, **missing))


def _refuse_changed(source: StorePlace, mark: str) -> None:
    """Raises StoreError where a server of another machine has started on the source meanwhile."""
    if servers_at(source) or state_of(source, MAIN_PART) != mark:
        raise StoreError(Message.of("copy_source_changed", path=source.name))


def _moved(settings: Settings, target: StorePlace) -> Settings:
    """The configuration of a server on the copy, with the key and the anchor of the site as they are."""
    key, anchor = find_key_file(settings.key_files), settings.anchor_file
    audit = {"key_file": key, "anchor": anchor if anchor.exists() else settings.audit.anchor}
    if isinstance(target, Folder):
        place = {"store": IN_FILES, "server": settings.server.model_copy(update={"data": target.path})}
    else:
        place = {"store": target.store}
    return settings.model_copy(update={**place, "audit": settings.audit.model_copy(update=audit)})


def _proof(moved: Settings) -> tuple[list[Message], Message | None]:
    """How much is proven of the audit log of the copy, or its fault."""
    try:
        return proof_of(moved), None
    except StoreError as error:
        return [], error.message


def _changes(config: Path, settings: Settings, moved: Settings) -> list[Message]:
    """What to change in the configuration, line by line."""
    folder = config.resolve().parent
    lines = [Message.of("copy_change_file", file=str(config))]
    if moved.store.url:
        lines.append(Message.of("copy_change_line", table="store", line=f'url = "{moved.store.shown}"'))
        if moved.store.password_file is not None:
            file = os.path.relpath(moved.store.password_file, folder)
            lines.append(Message.of("copy_change_line", table="store", line=f'password_file = "{file}"'))
        return lines
    if settings.store.url:
        lines.append(Message("copy_change_no_store"))
    if moved.server.data != settings.server.data:
        data = os.path.relpath(moved.server.data, folder)
        lines.append(Message.of("copy_change_line", table="server", line=f'data = "{data}"'))
        for name in ("key_file", "anchor"):
            path = getattr(moved.audit, name)
            # A file that no line names is looked for beside the data folder.
            if path is not None and getattr(settings.audit, name) is None:
                line = f'{name} = "{os.path.relpath(path, folder)}"'
                lines.append(Message.of("copy_change_line", table="audit", line=line))
    return lines
