"""The rules for names, tokens and sessions. Pure: time is passed in."""

from __future__ import annotations

import hashlib
import secrets
import string
import unicodedata
from collections.abc import Collection, Iterable
from dataclasses import dataclass

from app.core.web.access import Role
from app.people.auth.settings import Sessions
from bus.errors import CallerError
from bus.instants import UnixTime
from bus.messages import Message, term

MAX_NAME = 40
_LETTERS = frozenset(string.ascii_letters + string.digits + "._@-" + "ßæœøþłÆŒØÞŁ")
"""The letters of a name, besides accents: those of one script, because letters of others look alike."""
_SAME_SHAPE = str.maketrans("01i", "oll")
"""Look-alikes in a sans-serif font, in small letters: ``I``, ``l`` and 1."""

HOUR = 3600.0
DAY = 24 * HOUR


@dataclass(frozen=True)
class Lifetime:
    """The duration of a session in seconds: since it was last used, and in all."""

    idle_s: float
    absolute_s: float

    def ends_at(self, created_at: UnixTime, used_at: UnixTime) -> UnixTime:
        """Return the instant from which a session is no longer good."""
        return min(used_at + self.idle_s, created_at + self.absolute_s)


def lifetime(sessions: Sessions, *, panel: bool) -> Lifetime:
    """Return how long the sign-in of a person, or of a panel, lasts."""
    if panel:
        return Lifetime(sessions.panel_idle_days * DAY, sessions.panel_total_days * DAY)
    return Lifetime(sessions.idle_hours * HOUR, sessions.total_days * DAY)


MAX_TOKEN_DAYS = 3650
USE_NOTED_EVERY_S = 60.0
"""The seconds between two notes of a session's last use; one for every request would wear the disk."""


def check_name(name: str) -> None:
    """Raise CallerError for a name that no user or token may have."""
    is_composed = unicodedata.is_normalized("NFC", name)
    is_latin = is_composed and all(unicodedata.normalize("NFD", each)[0] in _LETTERS for each in name)
    if not is_latin or not 1 <= len(name) <= MAX_NAME:
        raise CallerError(Message.of("name_not_allowed", name=name[:80]))


def check_distinct(name: str, names: Iterable[str]) -> None:
    """Raise CallerError for a name that a person may take for one of ``names``."""
    shape = _shape(name)
    other = next((each for each in names if each != name and _shape(each) == shape), None)
    if other is not None:
        raise CallerError(Message.of("name_looks_like", name=name, other=other))


def _shape(name: str) -> str:
    """Return a text that is alike for names that look alike (Unicode UTS 39, 4): without case, accents, zero
    width."""
    plain = unicodedata.normalize("NFKD", name).casefold().translate(_SAME_SHAPE)
    return "".join(each for each in plain if unicodedata.category(each)[0] not in "MC")


def check_panel_role(role: Role) -> None:
    """Raise CallerError for a role that no panel may have: anyone who passes by a panel may touch it."""
    if not Role.OPERATOR.includes(role):
        raise CallerError(Message.of("panel_role_too_high", role=term(role)))


def check_token_bus(role: Role, bus: str, buses: Collection[str]) -> None:
    """Raise CallerError unless exactly a worker's token names a bus, and one of ``buses``."""
    known = ", ".join(buses) or "none"
    if role is not Role.WORKER:
        if bus:
            raise CallerError(Message.of("token_not_for_bus", role=term(role)))
    elif not bus:
        raise CallerError(Message.of("worker_token_needs_bus", known=known))
    elif bus not in buses:
        raise CallerError(Message.of("no_such_bus", bus=bus[:80], known=known))


def token_expiry(now: UnixTime, days: int | None) -> UnixTime | None:
    """Return when a token made at ``now`` expires; None if it does not. Raise CallerError."""
    if days is None:
        return None
    if not 1 <= days <= MAX_TOKEN_DAYS:
        raise CallerError(Message.of("token_days_out_of_range", most=MAX_TOKEN_DAYS, days=days))
    return now + days * DAY


def check_home(home: str) -> None:
    """Raise CallerError unless ``home`` is a page of ours, so that nothing redirects elsewhere."""
    if not is_own_path(home):
        raise CallerError(Message("home_page_elsewhere"))


def is_own_path(path: str) -> bool:
    r"""Return whether a redirect to ``path`` stays here: browsers take ``//`` and ``/\`` for another host."""
    return path.startswith("/") and not path.startswith(("//", "/\\")) and path.isprintable()


SECRET_LENGTH = 43


def new_secret() -> str:
    """Return 256 random bits in :data:`SECRET_LENGTH` characters, for a cookie or a bearer token."""
    return secrets.token_urlsafe(32)


def secret_hash(secret: str) -> bytes:
    """Return the stored form of a random secret; a fast hash is enough, as 256 bits cannot be guessed."""
    return hashlib.sha256(secret.encode()).digest()
