"""Passwords and PINs by Argon2id, in other threads so that the line never waits for a login."""

from __future__ import annotations

import asyncio
import unicodedata

from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerificationError

from bus.text import composed

_hasher = PasswordHasher(time_cost=5, memory_cost=7 * 1024, parallelism=1)
"""Of OWASP's equally strong choices the one with the least memory: a flood of sign-ins takes it twice."""


async def hash_secret(secret: str) -> str:
    """The hash to store, of the secret in NFC."""
    return await asyncio.to_thread(_hasher.hash, composed(secret))


async def verify_secret(stored: str, secret: str) -> bool:
    """Whether ``stored`` is a hash of the secret in any of its Unicode forms: older hashes are of the form in
    which the secret was typed."""
    forms = dict.fromkeys((composed(secret), secret, unicodedata.normalize("NFD", secret)))
    return await asyncio.to_thread(lambda: any(_is_hash_of(stored, form) for form in forms))


def _is_hash_of(stored: str, secret: str) -> bool:
    try:
        return _hasher.verify(stored, secret)
    except (VerificationError, InvalidHashError):
        return False


def is_outdated(stored: str) -> bool:
    """Whether a hash has other parameters than a new one. Raises InvalidHashError for an invalid hash."""
    return _hasher.check_needs_rehash(stored)
