"""The tables of users, sessions and tokens."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import NamedTuple

from app.core.database import StoreConnection, StoreRow
from app.core.database.connection import upsert
from app.core.web.access import Role
from bus.instants import UnixTime

MAX_PLACES = 50
"""The most networks and browsers of one user."""


class CompanyAccount(NamedTuple):
    """An account of a provider: its issuer, and the subject that the issuer gives to no other account (OpenID
    Connect Core, 2)."""

    issuer: str
    subject: str


@dataclass(frozen=True)
class User:
    """A user or a panel who may sign in."""

    name: str
    role: Role
    panel: bool
    home: str
    language: str
    disabled: bool
    created_at: UnixTime
    seen_at: UnixTime | None
    weak_secret: bool = False
    """Whether today's rules refuse the password or PIN, as last used."""
    secret_serial: int = 0
    """The number of passwords or PINs that the user has had before this one."""
    company_account: CompanyAccount | None = None
    """The only way in which the user signs in, who then has no password."""

    @property
    def credential(self) -> str:
        """A text that differs once the user was added again, or has another password."""
        return f"{self.created_at} {self.secret_serial}"

    @property
    def is_refused_panel(self) -> bool:
        """Whether it is a panel with more rights than a panel may have, from before that was checked."""
        return self.panel and not Role.OPERATOR.includes(self.role)


@dataclass(frozen=True)
class Session:
    """A user's session."""

    user: User
    created_at: UnixTime
    used_at: UnixTime
    expires_at: UnixTime


@dataclass(frozen=True)
class Token:
    """A program's key; its secret was shown once and is not stored."""

    id: int
    name: str
    role: Role
    created_by: str
    created_at: UnixTime
    used_at: UnixTime | None
    bus: str | None = None
    """The one bus that a worker's token is for."""
    expires_at: UnixTime | None = None

    @property
    def credential(self) -> str:
        """A text that differs once the token was revoked and created again."""
        return f"{self.id} {self.created_at}"

    @property
    def last_day(self) -> str:
        """The day on which the token expires, ISO 8601 in UTC; empty if it does not."""
        if self.expires_at is None:
            return ""
        return datetime.fromtimestamp(float(self.expires_at), UTC).date().isoformat()

    def is_good(self, now: UnixTime) -> bool:
        return self.expires_at is None or now < self.expires_at


_USER = (
    "u.name, u.role, u.panel, u.home, u.language, u.disabled, u.created_at, u.seen_at, u.weak_secret, "
    "u.secret_serial, u.issuer, u.subject"
)
_TOKEN = "id, name, role, created_by, created_at, used_at, bus, expires_at"


def _user(row: StoreRow) -> User:
    """Return the user in the columns `_USER`, the first of a row."""
    name, role, panel, home, language, disabled, created_at, seen_at, weak, serial, issuer, subject = row[:12]
    return User(
        name,
        Role(role),
        bool(panel),
        home,
        language,
        bool(disabled),
        created_at,
        seen_at,
        bool(weak),
        serial,
        None if issuer is None else CompanyAccount(issuer, subject),
    )


def _token(row: StoreRow) -> Token:
    """Return the token in the columns `_TOKEN`, the first of a row."""
    number, name, role, *others = tuple(row)[:8]
    return Token(number, name, Role(role), *others)


def users(connection: StoreConnection) -> list[User]:
    return [_user(row) for row in connection.execute(f"SELECT {_USER} FROM users u ORDER BY u.name")]


def secret_hashes(connection: StoreConnection) -> list[str]:
    """Return the hashes of the passwords and PINs of all users, the oldest user first."""
    query = "SELECT secret_hash FROM users WHERE issuer IS NULL ORDER BY created_at, name"
    return [row["secret_hash"] for row in connection.execute(query)]


def user(connection: StoreConnection, name: str) -> tuple[User, str] | None:
    """Return a user with the hash of the password or PIN."""
    query = f"SELECT {_USER}, u.secret_hash FROM users u WHERE u.name = ?"
    row = connection.execute(query, (name,)).fetchone()
    return (_user(row), row["secret_hash"]) if row else None


def user_of(connection: StoreConnection, account: CompanyAccount) -> User | None:
    """Return the user who signs in by a company account."""
    query = f"SELECT {_USER} FROM users u WHERE u.issuer = ? AND u.subject = ?"
    row = connection.execute(query, account).fetchone()
    return _user(row) if row else None


def add_user(connection: StoreConnection, user: User, secret_hash: str) -> None:
    """Add a user; ``secret_hash`` is empty for a company account. Raise ConstraintError for a name that
    exists."""
    connection.execute(
        "INSERT INTO users (name, role, secret_hash, panel, home, created_at, issuer, subject) "
        "VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
        (
            user.name,
            user.role,
            secret_hash,
            user.panel,
            user.home,
            user.created_at,
            *(user.company_account or (None, None)),
        ),
    )


def set_role(connection: StoreConnection, name: str, role: Role) -> bool:
    """Store the role of a user. Return whether there is such a user."""
    return connection.execute("UPDATE users SET role = ? WHERE name = ?", (role, name)).rowcount == 1


def set_secret(connection: StoreConnection, name: str, secret_hash: str, keep: bytes = b"") -> bool:
    """Store a new password or PIN and end every session of the user except that with the hash ``keep``.
    Return whether there is such a user."""
    _end_sessions_of(connection, name, keep)
    change = (
        "UPDATE users SET secret_hash = ?, weak_secret = 0, secret_serial = secret_serial + 1 WHERE name = ?"
    )
    return connection.execute(change, (secret_hash, name)).rowcount == 1


def replace_hash(connection: StoreConnection, name: str, before: str, secret_hash: str) -> None:
    """Store another hash of the same password or PIN, unless the user has changed it meanwhile."""
    change = "UPDATE users SET secret_hash = ? WHERE name = ? AND secret_hash = ?"
    connection.execute(change, (secret_hash, name, before))


def set_disabled(connection: StoreConnection, name: str, disabled: bool) -> bool:
    """Disable a user or enable again; sessions end. Return whether there is such a user."""
    _end_sessions_of(connection, name)
    change = "UPDATE users SET disabled = ? WHERE name = ?"
    return connection.execute(change, (disabled, name)).rowcount == 1


def set_language(connection: StoreConnection, name: str, language: str) -> None:
    """Store the language that the user chose; empty: that of the browser."""
    connection.execute("UPDATE users SET language = ? WHERE name = ?", (language, name))


def remove_user(connection: StoreConnection, name: str) -> bool:
    """Delete a user, whose events stay. Return whether there was such a user."""
    return connection.execute("DELETE FROM users WHERE name = ?", (name,)).rowcount == 1


def has_own_users(connection: StoreConnection) -> bool:
    """Return whether anyone can sign in without a provider."""
    return connection.execute("SELECT 1 FROM users WHERE issuer IS NULL LIMIT 1").fetchone() is not None


def admins_left(connection: StoreConnection) -> int:
    """Return the number of admins who can sign in without a provider."""
    query = "SELECT count(*) FROM users WHERE role = 'admin' AND disabled = 0 AND issuer IS NULL"
    return int(connection.execute(query).fetchone()[0])


def begin_session(
    connection: StoreConnection,
    hash_: bytes,
    name: str,
    now: UnixTime,
    ends: UnixTime,
    *,
    weak_secret: bool,
) -> None:
    """Store a sign-in and forget the sessions that are over."""
    connection.execute("DELETE FROM sessions WHERE expires_at <= ?", (now,))
    connection.execute("INSERT INTO sessions VALUES (?, ?, ?, ?, ?)", (hash_, name, now, now, ends))
    change = "UPDATE users SET seen_at = ?, weak_secret = ? WHERE name = ?"
    connection.execute(change, (now, weak_secret, name))


def are_places(connection: StoreConnection, name: str, browser: str, network: str) -> tuple[bool, bool]:
    """Return whether this user has signed in in the browser, and whether anyone has from the network."""
    query = (
        "SELECT EXISTS (SELECT 1 FROM known_places WHERE name = ? AND place = ?), "
        "EXISTS (SELECT 1 FROM known_places WHERE place = ?)"
    )
    is_own, is_used = connection.execute(query, (name, browser, network)).fetchone()
    return bool(is_own), bool(is_used)


def note_places(connection: StoreConnection, name: str, places: Iterable[str], now: UnixTime) -> None:
    """Store the places where a user has signed in; the newest places of each user are kept."""
    note = upsert("known_places", ("name", "place"), ("seen_at",))
    connection.executemany(note, [(name, place, now) for place in places])
    forget = (
        "DELETE FROM known_places WHERE name = ?1 AND place NOT IN "
        "(SELECT place FROM known_places WHERE name = ?1 ORDER BY seen_at DESC LIMIT ?2)"
    )
    connection.execute(forget, (name, MAX_PLACES))


def session(connection: StoreConnection, hash_: bytes) -> Session | None:
    """Return the session of a cookie."""
    query = (
        f"SELECT {_USER}, s.created_at AS begun_at, s.used_at, s.expires_at "
        "FROM sessions s JOIN users u USING (name) WHERE s.hash = ?"
    )
    row = connection.execute(query, (hash_,)).fetchone()
    if row is None:
        return None
    return Session(_user(row), row["begun_at"], row["used_at"], row["expires_at"])


def prolong_session(connection: StoreConnection, hash_: bytes, now: UnixTime, ends: UnixTime) -> None:
    change = "UPDATE sessions SET used_at = ?, expires_at = ? WHERE hash = ?"
    connection.execute(change, (now, ends, hash_))


def end_session(connection: StoreConnection, hash_: bytes) -> None:
    connection.execute("DELETE FROM sessions WHERE hash = ?", (hash_,))


def signed_in(connection: StoreConnection, now: UnixTime) -> set[str]:
    """Return the names of the users with a session."""
    query = "SELECT DISTINCT name FROM sessions WHERE expires_at > ?"
    return {row["name"] for row in connection.execute(query, (now,))}


def _end_sessions_of(connection: StoreConnection, name: str, keep: bytes = b"") -> None:
    """Sign a user out everywhere except in the session with the hash ``keep``."""
    connection.execute("DELETE FROM sessions WHERE name = ? AND hash != ?", (name, keep))


def tokens(connection: StoreConnection) -> list[Token]:
    return [_token(row) for row in connection.execute(f"SELECT {_TOKEN} FROM tokens ORDER BY name")]


def token_hashes(connection: StoreConnection) -> list[tuple[bytes, Token]]:
    """Return all tokens with the hashes of their secrets."""
    rows = connection.execute(f"SELECT {_TOKEN}, hash FROM tokens ORDER BY name")
    return [(row["hash"], _token(row)) for row in rows]


def token(connection: StoreConnection, hash_: bytes) -> Token | None:
    row = connection.execute(f"SELECT {_TOKEN} FROM tokens WHERE hash = ?", (hash_,)).fetchone()
    return _token(row) if row else None


def add_token(connection: StoreConnection, hash_: bytes, token: Token) -> None:
    """Add a token. Raise ConstraintError for a name that exists."""
    connection.execute(
        "INSERT INTO tokens (hash, name, role, created_by, created_at, bus, expires_at) "
        "VALUES (?, ?, ?, ?, ?, ?, ?)",
        (hash_, token.name, token.role, token.created_by, token.created_at, token.bus, token.expires_at),
    )


def note_token_used(connection: StoreConnection, number: int, now: UnixTime) -> None:
    connection.execute("UPDATE tokens SET used_at = ? WHERE id = ?", (now, number))


def revoke_token(connection: StoreConnection, name: str) -> bool:
    """Delete a token. Return whether there was such a token."""
    return connection.execute("DELETE FROM tokens WHERE name = ?", (name,)).rowcount == 1
