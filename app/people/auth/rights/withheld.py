"""Withholds from a restored store the rights that were withdrawn since its backup.

Sessions all end. A token holds only where the present store knows it too, and a user may do what both stores
allow, under the present password. Where there is no present store with users in it, as on a new machine,
it is unknown which tokens were revoked: all of them are; users are as they were then.
"""

from __future__ import annotations

from dataclasses import dataclass

from app.core.database import StoreConnection, StoreRow
from app.core.web.admission.access import PEOPLE_ROLES, Role
from app.people.auth import store
from app.people.auth.store import CompanyAccount, User


@dataclass(frozen=True, slots=True)
class Withheld:
    """By name, in order: tokens that are revoked, users that are disabled, users with a lower role than in
    the backup. ``admins``: how many admins can sign in."""

    tokens: tuple[str, ...]
    disabled: tuple[str, ...]
    lowered: tuple[str, ...]
    admins: int


@dataclass(frozen=True, slots=True)
class PresentUser:
    """A user of the present store."""

    role: Role
    panel: bool
    disabled: bool
    secret_hash: str
    company_account: CompanyAccount | None = None


@dataclass(frozen=True, slots=True)
class Present:
    """The rights in the present store: hashes of tokens, and users by name."""

    tokens: frozenset[bytes]
    users: dict[str, PresentUser]


def read_present(connection: StoreConnection) -> Present | None:
    """From a store of any version; None from one without users. Raises StoreError for one that cannot be
    read."""
    tokens = frozenset(hash_ for (hash_,) in connection.execute("SELECT hash FROM tokens"))
    users = {
        row["name"]: PresentUser(
            Role(row["role"]),
            bool(row["panel"]),
            bool(row["disabled"]),
            row["secret_hash"],
            _company_account(row),
        )
        for row in connection.execute("SELECT * FROM users")
    }
    return Present(tokens, users) if users else None


def _company_account(row: StoreRow) -> CompanyAccount | None:
    """None also in a store from before there were company accounts."""
    if "issuer" not in row.keys() or row["issuer"] is None:  # noqa: SIM118
        return None
    return CompanyAccount(row["issuer"], row["subject"])


def withhold(restored: StoreConnection, present: Present | None, *, keep_tokens: bool = False) -> Withheld:
    """Remove from the restored store the rights withdrawn since; ``present`` None: unknown which."""
    restored.execute("DELETE FROM sessions")
    gone = [] if keep_tokens else _tokens_unknown(restored, present)
    restored.executemany("DELETE FROM tokens WHERE hash = ?", [(hash_,) for hash_, _ in gone])
    tokens = tuple(name for _, name in gone)
    disabled: list[str] = []
    lowered: list[str] = []
    for user in store.users(restored) if present is not None else ():
        now = present.users.get(user.name) if present is not None else None
        is_same = now is not None and (now.panel, now.company_account) == (user.panel, user.company_account)
        if now is None or now.disabled or not is_same:
            restored.execute("UPDATE users SET disabled = 1 WHERE name = ?", (user.name,))
            disabled += [] if user.disabled else [user.name]
        elif _take_over(restored, user, now):
            lowered.append(user.name)
    return Withheld(tokens, tuple(disabled), tuple(lowered), store.admins_left(restored))


def tokens_to_revoke(restored: StoreConnection, present: Present | None) -> list[str]:
    """Return the names of the tokens that `withhold` would revoke."""
    return [name for _, name in _tokens_unknown(restored, present)]


def _tokens_unknown(restored: StoreConnection, present: Present | None) -> list[tuple[bytes, str]]:
    known = frozenset[bytes]() if present is None else present.tokens
    rows = restored.execute("SELECT hash, name FROM tokens ORDER BY name").fetchall()
    return [(hash_, name) for hash_, name in rows if hash_ not in known]


def _take_over(restored: StoreConnection, user: User, now: PresentUser) -> bool:
    """The present password, and the lower role. Whether the role is lower than in the backup."""
    role = min(user.role, now.role, key=PEOPLE_ROLES.index)
    change = "UPDATE users SET role = ?, secret_hash = ? WHERE name = ?"
    restored.execute(change, (role, now.secret_hash, user.name))
    return role is not user.role
