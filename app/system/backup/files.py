"""The files of a site beside its stores: the configuration with its versions and what it names, such as the
key of the audit log, certificates with their keys, and the files of passwords. In a backup they are one
member, which is encrypted where ``[backup] key_file`` names a key, and else has the configuration and its
versions alone."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path, PurePosixPath

import msgspec
from pydantic import BaseModel

from app.core.database.files import make_folder, write_file
from app.errors import StoreError
from app.people.audit.keys import find_key_file
from app.settings import Settings
from app.system.backup.cipher import decrypt, encrypt, read_key
from app.system.configuration.versions import VersionStore
from bus.messages import Message

IN_CLEAR, ENCRYPTED = "files.json", "files.encrypted"
MAX_FILE_BYTES = 4 * 2**20
MAX_BYTES = 64 * 2**20
"""Of the member."""


class SiteFile(msgspec.Struct):
    """``path``: where it was, absolute."""

    path: str
    content: bytes


class SiteFiles(msgspec.Struct):
    """What a backup has of a site beside its stores. ``left_out``: the files that it has not, as there is no
    key to encrypt them."""

    member: str
    content: bytes
    left_out: list[str]


def files_of(settings: Settings) -> SiteFiles:
    """Read the files of a site as the member of a backup. Raises StoreError, also where the key of the
    backups is in their folder: who has one then has the other."""
    configuration = [settings._file] if settings._file is not None else []
    configuration += VersionStore(settings.server.data).files
    named = sorted({path for path in _named(settings) if path.is_file()} - {settings.backup.key_file})
    if settings.backup.key_file is None:
        return SiteFiles(IN_CLEAR, _packed(configuration), [str(path) for path in named])
    key_file, folder = settings.backup.key_file, settings.backup.folder
    if folder is not None and key_file.resolve().is_relative_to(folder.resolve()):
        raise StoreError(Message.of("backup_key_in_folder", file=str(key_file)))
    content = encrypt(_packed([*configuration, *named]), read_key(key_file))
    return SiteFiles(ENCRYPTED, content, [])


def place_files(member: str, content: bytes, key_file: Path | None, folder: Path) -> list[Path]:
    """Write the files of a backup below a folder, which must not exist yet, each under the path that it had.
    Raises StoreError, also for a path that leads out of the folder."""
    if member == ENCRYPTED:
        if key_file is None:
            raise StoreError(Message("backup_needs_key"))
        content = decrypt(content, read_key(key_file))
    try:
        files = msgspec.json.decode(content, type=list[SiteFile])
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:
        raise StoreError(Message("backup_files_damaged")) from error
    places = [(_below(folder, file.path), file.content) for file in files]
    if folder.exists():
        raise StoreError(Message.of("backup_exists", file=str(folder)))
    make_folder(folder)
    for place, written in places:
        make_folder(place.parent)
        write_file(place, written)
    return [place for place, _ in places]


def _named(settings: Settings) -> Iterator[Path]:
    """Yield every file that the configuration names and a restore needs. An anchor is evidence of this log,
    and has its own place."""
    yield from _paths_in(settings)
    if (key_file := find_key_file(settings.key_files)) is not None:
        yield key_file


def _paths_in(model: BaseModel) -> Iterator[Path]:
    for name, value in model:
        if isinstance(value, Path) and name != "anchor":
            yield value
        for inside in value if isinstance(value, tuple) else (value,):
            if isinstance(inside, BaseModel):
                yield from _paths_in(inside)


def _packed(paths: Sequence[Path]) -> bytes:
    files = []
    for path in paths:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise StoreError(Message.of("backup_file_too_large", file=str(path), most=MAX_FILE_BYTES))
        files.append(SiteFile(str(path), path.read_bytes()))
    return msgspec.json.encode(files)


def _below(folder: Path, path: str) -> Path:
    """Return where a path of a backup is below the folder: anyone may have forged it."""
    pure = PurePosixPath(path)
    if not pure.is_absolute() or ".." in pure.parts or "\0" in path:
        raise StoreError(Message("backup_files_damaged"))
    return folder.joinpath(*pure.parts[1:])
