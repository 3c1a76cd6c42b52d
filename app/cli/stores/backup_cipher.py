"""Encrypts what a backup holds of secrets, by a key file and the program openssl: AES-256 in counter mode,
sealed by HMAC-SHA-256. The keys of a backup follow from the key file and from a salt that no other backup
has.

The layout is 16 bytes of salt, 32 of the seal over the salt and the rest, then the rest.
"""

from __future__ import annotations

import hashlib
import hmac
import os
import secrets
import shutil
import subprocess
from pathlib import Path

from app.errors import StoreError
from bus.messages import Message

MIN_KEY_CHARACTERS, MAX_KEY_BYTES = 32, 4096
SALT_BYTES, SEAL_BYTES = 16, 32
WITHIN_S = 60.0
_OPENSSL = ("enc", "-aes-256-ctr", "-pbkdf2", "-nosalt")


def read_key(file: Path) -> bytes:
    """The key of a file, without the white space around it. Raises StoreError where it is none."""
    try:
        with file.open("rb") as opened:
            key = opened.read(MAX_KEY_BYTES).strip()
    except OSError as error:
        raise StoreError(Message.of("backup_key_missing", file=str(file))) from error
    if len(key) < MIN_KEY_CHARACTERS:
        raise StoreError(Message.of("backup_key_short", file=str(file), n=MIN_KEY_CHARACTERS))
    return key


def encrypt(content: bytes, key: bytes) -> bytes:
    """The content under a key. Raises StoreError where openssl is missing or fails."""
    salt = secrets.token_bytes(SALT_BYTES)
    password, seal_key = _keys(key, salt)
    hidden = _openssl("-e", content, password)
    return salt + _seal(seal_key, salt, hidden) + hidden


def decrypt(packed: bytes, key: bytes) -> bytes:
    """What was encrypted. Raises StoreError where it was so under another key, or was altered."""
    salt, seal, hidden = (
        packed[:SALT_BYTES],
        packed[SALT_BYTES:][:SEAL_BYTES],
        packed[SALT_BYTES + SEAL_BYTES :],
    )
    password, seal_key = _keys(key, salt)
    if not hmac.compare_digest(seal, _seal(seal_key, salt, hidden)):
        raise StoreError(Message("backup_key_wrong"))
    return _openssl("-d", hidden, password)


def _keys(key: bytes, salt: bytes) -> tuple[bytes, bytes]:
    both = hashlib.scrypt(key, salt=salt, n=2**14, r=8, p=1, dklen=64)
    return both[:32], both[32:]


def _seal(key: bytes, salt: bytes, hidden: bytes) -> bytes:
    return hmac.digest(key, salt + hidden, "sha256")


def _openssl(direction: str, content: bytes, password: bytes) -> bytes:
    """The password goes through a pipe: every user can read the words of a command."""
    program = shutil.which("openssl")
    if program is None:
        raise StoreError(Message("openssl_missing"))
    reading, writing = os.pipe()
    try:
        os.write(writing, password.hex().encode() + b"\n")
        os.close(writing)
        done = subprocess.run(
            (program, *_OPENSSL, direction, "-pass", f"fd:{reading}"),
            input=content,
            capture_output=True,
            pass_fds=(reading,),
            timeout=WITHIN_S,
            check=False,
        )
    finally:
        os.close(reading)
    if done.returncode:
        reason = done.stderr.decode(errors="replace").strip()
        raise StoreError(Message.of("system_error", error=reason))
    return done.stdout
