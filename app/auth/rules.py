"""What is asked of names, passwords, PINs and sessions. No clock: time is passed in."""

from __future__ import annotations

import hashlib
import re
import secrets
from dataclasses import dataclass

from bus.errors import CallerError

_NAME = re.compile(r"[\w.@-]{1,40}")
_PIN = re.compile(r"\d{4,12}")
SHORTEST_PASSWORD = 8
LONGEST_PASSWORD = 256
"""Argon2 works on all of it; nobody is to make us work on a megabyte."""

HOUR = 3600.0
DAY = 24 * HOUR


@dataclass(frozen=True)
class Lifetime:
    """How long a session lasts, in seconds: since it was last used, and in all."""

    idle_s: float
    whole_s: float

    def ends_at(self, created_at: float, used_at: float) -> float:
        """The instant from which it is no longer good."""
        return min(used_at + self.idle_s, created_at + self.whole_s)


PERSON_LIFETIME = Lifetime(12 * HOUR, 7 * DAY)
"""A shift and its overlap; a week at most."""
PANEL_LIFETIME = Lifetime(90 * DAY, 365 * DAY)
"""A panel hangs on the wall and stays signed in."""
USE_NOTED_EVERY_S = 60.0
"""A session's last use is written this seldom; every request would wear the disk."""


def check_name(name: str) -> None:
    """Raises CallerError."""
    if not _NAME.fullmatch(name):
        detail = "the name '{name}' will not do: write 1 to 40 letters, digits, . _ @ or -"
        raise CallerError(detail, params={"name": name})


def check_password(password: str) -> None:
    """Raises CallerError."""
    if not SHORTEST_PASSWORD <= len(password) <= LONGEST_PASSWORD:
        allowed = f"{SHORTEST_PASSWORD} to {LONGEST_PASSWORD}"
        raise CallerError(f"a password has {allowed} characters; this one has {len(password)}")


def check_pin(pin: str) -> None:
    """Raises CallerError."""
    if not _PIN.fullmatch(pin):
        raise CallerError("a PIN is 4 to 12 digits")


def check_home(home: str) -> None:
    """Raises CallerError. A page of ours only, so that nothing redirects elsewhere."""
    if not is_own_path(home):
        raise CallerError("a home page is a path on this server, like / or /units/dry-end/1")


def is_own_path(path: str) -> bool:
    """Whether a redirect to this stays here: browsers take ``//`` and ``/\\`` for another host."""
    return path.startswith("/") and not path.startswith(("//", "/\\")) and path.isprintable()


def new_secret() -> str:
    """256 random bits, for a cookie or a bearer token."""
    return secrets.token_urlsafe(32)


def secret_hash(secret: str) -> bytes:
    """What is stored of a random secret; it needs no slow hash, nobody can guess 256 bits."""
    return hashlib.sha256(secret.encode()).digest()
