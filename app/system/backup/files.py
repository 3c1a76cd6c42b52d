"""The files of a site beside its stores, and how a backup encrypts them.

They are the configuration with its versions and what it names, such as the key of the audit log, certificates
with their keys, and the files of passwords. In a backup they are one member, encrypted where ``[backup]
key_file`` names a key: AES-256 in counter mode, sealed by HMAC-SHA-256. Without a key the member has the
configuration and its versions alone.

The layout is 16 bytes of salt, 32 of the seal over the salt and the rest, then the rest. The keys of a backup
are derived from the key file and from its salt, which no other backup has.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
from collections.abc import Iterator, Sequence
from pathlib import Path, PurePosixPath

import msgspec
from pydantic import BaseModel

from app.core.database.files import make_folder, write_file
from app.errors import StoreError
from app.people.audit.keys import find_key_file
from app.settings import Settings
from app.system.configuration.document import VersionStore
from bus.messages import Message

MIN_KEY_CHARACTERS, MAX_KEY_BYTES = 32, 4096
SALT_BYTES, SEAL_BYTES = 16, 32
PBKDF2_ROUNDS = 10_000
"""As ``openssl enc -pbkdf2`` has them, which version 0.2 called. The password is random, and not guessed."""


def read_key(file: Path) -> bytes:
    """Return the key of a file, without the white space around it. Raises StoreError where it is none."""
    try:
        with file.open("rb") as opened:
            key = opened.read(MAX_KEY_BYTES).strip()
    except OSError as error:
        raise StoreError(Message.of("backup_key_missing", file=str(file))) from error
    if len(key) < MIN_KEY_CHARACTERS:
        raise StoreError(Message.of("backup_key_short", file=str(file), n=MIN_KEY_CHARACTERS))
    return key


def encrypt(content: bytes, key: bytes) -> bytes:
    """Encrypt the content with a key."""
    salt = secrets.token_bytes(SALT_BYTES)
    password, seal_key = _keys(key, salt)
    hidden = _counted(content, password)
    return salt + _seal(seal_key, salt, hidden) + hidden


def decrypt(packed: bytes, key: bytes) -> bytes:
    """Decrypt what was encrypted. Raises StoreError where it was so under another key, or was altered."""
    salt, seal, hidden = (
        packed[:SALT_BYTES],
        packed[SALT_BYTES:][:SEAL_BYTES],
        packed[SALT_BYTES + SEAL_BYTES :],
    )
    password, seal_key = _keys(key, salt)
    if not hmac.compare_digest(seal, _seal(seal_key, salt, hidden)):
        raise StoreError(Message("backup_key_wrong"))
    return _counted(hidden, password)


def _keys(key: bytes, salt: bytes) -> tuple[bytes, bytes]:
    both = hashlib.scrypt(key, salt=salt, n=2**14, r=8, p=1, dklen=64)
    return both[:32], both[32:]


def _seal(key: bytes, salt: bytes, hidden: bytes) -> bytes:
    return hmac.digest(key, salt + hidden, "sha256")


def _counted(content: bytes, password: bytes) -> bytes:
    """Encrypt or decrypt in counter mode, in which both are the same."""
    # Not with the module: a server whose backups have no key does without the memory that it takes.
    from cryptography.hazmat.primitives.ciphers import Cipher
    from cryptography.hazmat.primitives.ciphers.algorithms import AES256
    from cryptography.hazmat.primitives.ciphers.modes import CTR

    derived = hashlib.pbkdf2_hmac("sha256", password.hex().encode(), b"", PBKDF2_ROUNDS, 48)
    return Cipher(AES256(derived[:32]), CTR(derived[32:])).encryptor().update(content)


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
