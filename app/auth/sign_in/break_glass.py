"""Accounts that sign in while the database is away, and at no other time.

They are in a file of the data folder that only the server's user can read. There is none until one
is made: ``lineside user break-glass``.
"""

from __future__ import annotations

import os
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import msgspec

from app.auth.sign_in.passwords import hash_secret, verify_secret
from app.auth.store import User
from app.database.availability import Availability
from app.database.private import write_file
from app.errors import StoreError, system_error
from app.web.admission.access import Person, Role
from bus.instants import Clock, UnixTime, unix_now
from bus.messages import Message

FILE = "break-glass.json"
ROLES = (Role.OPERATOR, Role.ENGINEER)
ENDS_AFTER_S = 60.0
"""How long a session lasts once the database is back: a database that comes and goes signs no one out."""
MAX_SESSION_S = 12 * 3600.0
MAX_BYTES = 100_000
MAX_ACCOUNTS = 20


class BreakGlassAccount(msgspec.Struct, frozen=True):
    """``hash``: of its password."""

    name: str
    role: Role
    hash: str
    made_at: Annotated[float, msgspec.Meta(ge=0)]


@dataclass(frozen=True)
class BreakGlassUser(User):
    """Who has signed in by such an account."""


def path_in(folder: Path) -> Path:
    """The file of a data folder."""
    return folder / FILE


def read_accounts(path: Path) -> dict[str, BreakGlassAccount]:
    """The accounts by name; none without a file. Raises StoreError for a file that others may have read or
    written."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK)
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise _unusable(path, system_error(error)) from error
    with os.fdopen(descriptor, "rb") as file:
        found = os.fstat(descriptor)
        is_private = stat.S_ISREG(found.st_mode) and not found.st_mode & 0o077
        if not is_private or found.st_uid not in (os.geteuid(), 0):
            raise _unusable(path, Message("break_glass_open_to_others"))
        try:
            accounts = msgspec.json.decode(file.read(MAX_BYTES), type=list[BreakGlassAccount])
        except msgspec.MsgspecError as error:
            raise _unusable(path, str(error)) from error
    return {account.name: account for account in accounts if account.role in ROLES}


def write_accounts(path: Path, accounts: dict[str, BreakGlassAccount]) -> None:
    """Replace the file; it belongs to the owner of its folder. Raises StoreError."""
    try:
        write_file(path, msgspec.json.format(msgspec.json.encode([*accounts.values()])) + b"\n")
        owner = path.parent.stat()
        if owner.st_uid != os.geteuid():
            os.chown(path, owner.st_uid, owner.st_gid)
    except OSError as error:
        raise _unusable(path, system_error(error)) from error


async def new_account(name: str, role: Role, password: str, now: UnixTime) -> BreakGlassAccount:
    """An account with the hash of a password."""
    return BreakGlassAccount(name, role, await hash_secret(password), float(now))


@dataclass(frozen=True, slots=True)
class _Session:
    user: BreakGlassUser
    began: UnixTime


class BreakGlass:
    """The sessions of these accounts; they end with the server."""

    def __init__(self, path: Path, availability: Availability, clock: Clock = unix_now) -> None:
        self._path = path
        self._availability = availability
        self._clock = clock
        self._sessions: dict[bytes, _Session] = {}

    @property
    def signed_in(self) -> list[str]:
        """The users who have signed in by such an account."""
        return sorted({each.user.name for each in self._sessions.values() if self._is_good(each)})

    def accounts(self) -> dict[str, BreakGlassAccount]:
        """As they are in the file now. Raises StoreError."""
        return read_accounts(self._path)

    async def verified(self, name: str, secret: str) -> BreakGlassUser | None:
        """The user whose password it is. The time does not show which names there are. Raises StoreError
        where there is no account, or the file cannot be used."""
        accounts = self.accounts()
        if not accounts:
            raise StoreError(Message("sign_in_while_away"))
        account = accounts.get(name)
        decoy = next(iter(accounts.values()))
        is_right = await verify_secret((account or decoy).hash, secret)
        if account is None or not is_right:
            return None
        made_at = UnixTime(account.made_at)
        return BreakGlassUser(account.name, account.role, False, "/", "", False, made_at, None)

    def begin(self, hash_: bytes, user: BreakGlassUser) -> None:
        """Begin a session."""
        self._sessions = {key: each for key, each in self._sessions.items() if self._is_good(each)}
        self._sessions[hash_] = _Session(user, self._clock())

    def end(self, hash_: bytes) -> bool:
        """End a session; whether there was one."""
        return self._sessions.pop(hash_, None) is not None

    def person(self, hash_: bytes) -> Person | None:
        """Who has the session of a cookie."""
        found = self._sessions.get(hash_)
        if found is None or not self._is_good(found):
            return None
        user = found.user
        return Person(user.name, user.role, "break_glass", created_at=user.created_at)

    def _is_good(self, session: _Session) -> bool:
        now, back = self._clock(), self._availability.back_since
        if now - session.began > MAX_SESSION_S:
            return False
        return self._availability.is_away or (back is not None and now - back < ENDS_AFTER_S)


def _unusable(path: Path, reason: Message | str) -> StoreError:
    return StoreError(Message.of("break_glass_unusable", path=str(path), reason=reason))
