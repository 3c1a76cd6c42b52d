"""Encrypts what a backup holds of secrets, by a key file: AES-256 in counter mode, sealed by HMAC-SHA-256.
The keys of a backup follow from the key file and from a salt that no other backup has.

The layout is 16 bytes of salt, 32 of the seal over the salt and the rest, then the rest.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
from pathlib import Path

from cryptography.hazmat.primitives.ciphers import Cipher
from cryptography.hazmat.primitives.ciphers.algorithms import AES256
from cryptography.hazmat.primitives.ciphers.modes import CTR

from app.errors import StoreError
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
    derived = hashlib.pbkdf2_hmac("sha256", password.hex().encode(), b"", PBKDF2_ROUNDS, 48)
    return Cipher(AES256(derived[:32]), CTR(derived[32:])).encryptor().update(content)
