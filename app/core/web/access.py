"""The caller of a request, and the grant that its route requires.

`app.people.auth.identify` finds the `Caller` of each request. Every route declares a role with one of the
dependencies here, or is declared public, and is not served otherwise (`app.core.web.routes`). `Requires`
grants that role once, before the body is read: the caller becomes a `Person`. Commands and acts are called by
a `Person` only.

The names of cookies belong to this server alone. Browsers send the cookies of a host to every port of it, so
a name carries the port under which the browser reaches this server; a default port is not in it.
"""

from __future__ import annotations

import re
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated, Literal, TypedDict

from fastapi import Depends
from starlette.requests import HTTPConnection
from starlette.responses import Response

from app.core.web.arrival import refuse_late
from app.errors import Problem
from bus.errors import CallerError
from bus.instants import UnixTime
from bus.messages import Message, term

Via = Literal["session", "token", "worker", "demo", "console"]
"""The way in which a person is known; ``console``: from the server's command line, without a request."""


class Author(TypedDict):
    """The author of an event."""

    who: str
    origin: Via


AccountSubscriber = Callable[[str], Awaitable[None]]
"""A function called with an account of which something changed."""


class Role(StrEnum):
    """The roles. Each of the first four includes those before it; ``worker`` opens /feed and nothing else,
    and no other role opens /feed: commands are verified by the reports of a worker."""

    VIEWER = "viewer"
    OPERATOR = "operator"
    ENGINEER = "engineer"
    ADMIN = "admin"
    WORKER = "worker"

    def includes(self, other: Role | str) -> bool:
        """Return whether this role may do what ``other`` may (templates name it by its word)."""
        other = Role(other)
        if Role.WORKER in (self, other):
            return self is other
        return PEOPLE_ROLES.index(self) >= PEOPLE_ROLES.index(other)


PEOPLE_ROLES = (Role.VIEWER, Role.OPERATOR, Role.ENGINEER, Role.ADMIN)
"""The roles of people in order; each includes those before it."""
_TOKEN = " (token)"


def role_named(word: str, among: Iterable[Role] = PEOPLE_ROLES) -> Role:
    """Return the role with this name. Raise CallerError for any other word."""
    roles = list(among)
    if word not in roles:
        raise CallerError(Message.of("no_such_role", role=word[:80], known=", ".join(roles)))
    return Role(word)


@dataclass(frozen=True)
class Caller:
    """The sender of a request: a person, a panel or a program that is signed in."""

    name: str
    role: Role
    via: Via
    language: str = ""
    panel: bool = False
    home: str = "/"
    created_at: UnixTime = UnixTime(0.0)
    """The Unix time at which the account was made: a later account of the same name has another."""
    bus: str = ""
    """The one bus for which a worker speaks."""
    has_company_account: bool = False
    """Whether the person signs in by the provider of company accounts, and has no password."""
    credential: str = field(default="", repr=False, compare=False)
    """Identifies the credential, distinct from an earlier one of the same account."""
    address: str | Message = field(default="", compare=False)
    """The source of the request: the address of its client, or the command line."""

    @property
    def has_account(self) -> bool:
        """Whether the caller is a user or a token of the store, whose rights can be withdrawn."""
        return self.via in ("session", "token")

    @property
    def account(self) -> str:
        return account_of(self.name, token=self.via == "token")

    @property
    def author(self) -> Author:
        """The caller as the author of an event: ``events.record(**person.author, …)``."""
        return {"who": self.name, "origin": self.via}

    @property
    def sender(self) -> str:
        """A text that identifies the account, distinct from an earlier one of the same name."""
        return f"{self.account} {self.created_at!r}"

    def granted(self, role: Role) -> Person:
        """Return the person who may do what ``role`` may. Raise Problem 403 ``forbidden``."""
        refuse_without(role, self)
        return Person(**vars(self))


class Person(Caller):
    """A caller with the grant of the request: its route required a role, which the caller has."""


def account_of(name: str, *, token: bool) -> str:
    """Return the account of a user or a token, which may have the same name. No name has a space, so none can
    pass for another."""
    return f"{name}{_TOKEN}" if token else name


def account_shown(account: str) -> str | Message:
    """Return the account as the value of a message: a token in the reader's language."""
    name, is_token = name_of(account)
    return Message.of("account_of_token", name=name) if is_token else account


def name_of(account: str) -> tuple[str, bool]:
    """Return the name of an account, and whether it is a token."""
    return account.removesuffix(_TOKEN), account.endswith(_TOKEN)


def address_of(connection: HTTPConnection) -> str:
    """Return the address of the client; empty if the server knows none."""
    return connection.client.host if connection.client else ""


def caller_of(connection: HTTPConnection) -> Caller | None:
    """Return the caller of a request; None if no one is signed in."""
    caller: Caller | None = connection.scope.get("caller")
    return caller


def person_of(connection: HTTPConnection) -> Person:
    """Return the person with the grant of a request. Raise Problem 401 if its route requires none."""
    person: Person | None = connection.scope.get("person")
    if person is None:
        raise not_signed_in()
    return person


@dataclass(frozen=True)
class Requires:
    """A dependency that grants ``role`` to the caller of a request, and refuses a write that comes late.
    ``act`` is the name of the act or command that the route carries out.

    The grant is made once in a request, before the body is read (`app.core.web.routes`).
    """

    role: Role
    act: str = ""

    async def __call__(self, connection: HTTPConnection) -> Person:
        """Return the person of the grant. Raise the errors of `grant`."""
        return await self.granted_once(connection)

    async def granted_once(self, connection: HTTPConnection) -> Person:
        """Return the person of the grant, which is made here unless this request has it already. Raise what
        `grant` raises."""
        granted: set[Requires] = connection.scope.setdefault("granted", set())
        if self not in granted:
            connection.scope["person"] = await self.grant(connection)
            granted.add(self)
        return person_of(connection)

    async def grant(self, connection: HTTPConnection) -> Person:
        """Grant the role to the caller. Raise Problem 401, 403 or, for a write that was delayed on its way,
        503."""
        person = self.permitted(connection)
        refuse_late(connection)
        return person

    def permitted(self, connection: HTTPConnection) -> Person:
        """Check the role alone. Raise Problem 401 or 403."""
        caller = caller_of(connection)
        if caller is None:
            raise not_signed_in()
        return caller.granted(self.role)


def refuse_without(role: Role, person: Caller) -> None:
    """Raise Problem 403 ``forbidden`` for a person whose role does not include ``role``."""
    if person.role.includes(role):
        return
    present = term(person.role)
    raise Problem(
        403, "forbidden", Message.of("role_needed", role=term(role), name=person.name, present=present)
    )


async def public() -> None:
    """Declare a route that needs no sign-in: ``dependencies=[Depends(public)]``."""


def not_signed_in() -> Problem:
    """Return the refusal of a request without a caller."""
    problem = Problem(401, "unauthorized", Message("sign_in_needed"))
    return problem.with_headers(WWW_Authenticate="Bearer")


Viewer = Annotated[Person, Depends(Requires(Role.VIEWER))]
Engineer = Annotated[Person, Depends(Requires(Role.ENGINEER))]
Admin = Annotated[Person, Depends(Requires(Role.ADMIN))]
Worker = Annotated[Person, Depends(Requires(Role.WORKER))]


SESSION = "lineside_session"
_HOST_PREFIX = "__Host-"
"""Browsers accept a cookie of such a name from this host only, and by TLS (RFC 6265bis, 4.1.3.2)."""
_PORT = re.compile(r":(\d{1,5})$")


def is_encrypted(connection: HTTPConnection) -> bool:
    """Return whether the browser reached this server, or the trusted proxy before it, by TLS."""
    return connection.url.scheme in ("https", "wss")


def _cookie_name(connection: HTTPConnection, name: str) -> str:
    """Return the name of a cookie under the scheme and the port of a request; cookies of other servers are
    not read."""
    port = _PORT.search(connection.headers.get("host", ""))
    return _of_scheme(connection, f"{name}_{port[1]}" if port else name)


def cookie_of(connection: HTTPConnection, name: str) -> str:
    """Return the value of a cookie; empty if there is none."""
    return connection.cookies.get(_cookie_name(connection, name), "")


def session_name(connection: HTTPConnection) -> str:
    """Return the name of the cookie that has the session of a request: without a port if the session began
    before names had one."""
    name = _cookie_name(connection, SESSION)
    return name if name in connection.cookies else _of_scheme(connection, SESSION)


def _of_scheme(connection: HTTPConnection, name: str) -> str:
    return f"{_HOST_PREFIX}{name}" if is_encrypted(connection) else name


def set_cookie(
    connection: HTTPConnection, response: Response, name: str, value: str, max_age_s: float
) -> None:
    """Make the browser keep a cookie that no script reads. SameSite is lax, so that a link from an e-mail
    opens signed in; changes are guarded by their Origin
    (`app.core.web.request_rules`). It is not Secure on plain HTTP, which plants use."""
    response.set_cookie(
        _cookie_name(connection, name),
        value,
        max_age=int(max_age_s),
        httponly=True,
        samesite="lax",
        secure=is_encrypted(connection),
    )


def forget_cookie(connection: HTTPConnection, response: Response, name: str) -> None:
    """Make the browser delete a cookie."""
    response.delete_cookie(_cookie_name(connection, name), path="/", secure=is_encrypted(connection))
