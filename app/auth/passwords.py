"""Passwords and PINs by Argon2id, in threads of their own so that the line never waits for a login."""

from __future__ import annotations

import asyncio
from concurrent.futures import ThreadPoolExecutor

from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerificationError

_hasher = PasswordHasher(time_cost=5, memory_cost=7 * 1024, parallelism=1)
"""Of OWASP's equally strong choices the one with the least memory: a flood of sign-ins takes it twice."""
_NOBODY = "$argon2id$v=19$m=7168,t=5,p=1$Sgqjl3axBcmfpBSJPI8fSA$j+rR8SiCfOxxpYIZCglRTn5oT1JNGs9cz5ZCnFoqW38"
"""Verified against for a name that does not exist, so that the time taken does not tell."""


class Passwords:
    """Hashes and verifies without blocking the loop."""

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(2, thread_name_prefix="passwords")

    async def hash(self, secret: str) -> str:
        """The hash to store."""
        return await asyncio.get_running_loop().run_in_executor(self._pool, hash_now, secret)

    async def verify(self, stored: str | None, secret: str) -> bool:
        """Whether it is the secret; for None (no such user) as slow, and False."""
        return await asyncio.get_running_loop().run_in_executor(self._pool, _verify, stored, secret)

    def close(self) -> None:
        """End the threads."""
        self._pool.shutdown()


def hash_now(secret: str) -> str:
    """The hash to store, without a loop."""
    return _hasher.hash(secret)


def _verify(stored: str | None, secret: str) -> bool:
    try:
        matches = _hasher.verify(stored or _NOBODY, secret)
    except (VerificationError, InvalidHashError):
        return False
    return matches and stored is not None
