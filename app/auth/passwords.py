"""Passwords and PINs by Argon2id, in separate threads so that the line never waits for a login."""

from __future__ import annotations

import asyncio
from concurrent.futures import ThreadPoolExecutor

from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerificationError

_hasher = PasswordHasher(time_cost=5, memory_cost=7 * 1024, parallelism=1)
"""Of OWASP's equally strong choices the one with the least memory: a flood of sign-ins takes it twice."""


class Passwords:
    """Hashes and verifies without blocking the loop."""

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(2, thread_name_prefix="passwords")

    async def hash(self, secret: str) -> str:
        """The hash to store."""
        return await asyncio.get_running_loop().run_in_executor(self._pool, _hasher.hash, secret)

    async def verify(self, stored: str, secret: str) -> bool:
        """Whether ``stored`` is a hash of the secret."""
        return await asyncio.get_running_loop().run_in_executor(self._pool, _verify, stored, secret)

    def close(self) -> None:
        self._pool.shutdown()


def is_outdated(stored: str) -> bool:
    """Whether a hash has other parameters than a new one. Raises InvalidHashError for an invalid hash."""
    return _hasher.check_needs_rehash(stored)


def _verify(stored: str, secret: str) -> bool:
    try:
        return _hasher.verify(stored, secret)
    except (VerificationError, InvalidHashError):
        return False
