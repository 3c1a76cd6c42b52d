"""The identification of each request and handshake, which is then refused or let through.

Access is denied by default: without a caller only the public paths are open.
"""

from __future__ import annotations

import asyncio
import hmac
from collections.abc import Awaitable, Callable, Collection, Coroutine, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any
from urllib.parse import quote, urlsplit

from starlette.datastructures import Headers
from starlette.requests import HTTPConnection
from starlette.responses import RedirectResponse, Response
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.types import Message as AsgiMessage
from starlette.websockets import WebSocketDisconnect

from app.core.database import Database, StoreConnection
from app.core.server.addresses import canonical
from app.core.server.connections import Handshakes, client_connection
from app.core.server.refusal_log import REFUSED, RefusalLog
from app.core.web.access import (
    Caller,
    Role,
    account_of,
    account_shown,
    address_of,
    not_signed_in,
    session_name,
)
from app.core.web.problems import is_below_a_path, is_fragment, problem_json, respond, wants_json
from app.core.web.request_rules import LOOPBACK, readable, refuse, request_problem
from app.core.web.routes import as_get
from app.errors import Problem, StoreError
from app.people.audit.log import EventLog
from app.people.auth import rules, store
from app.people.auth.rights import Rights
from app.people.auth.sign_in import SignIn, count_refusal
from app.people.auth.store import Token
from bus.instants import Clock, UnixTime, monotonic_now, unix_now
from bus.messages import Message

PUBLIC_PATHS = frozenset(
    {
        "/healthz",
        "/login",
        "/login/panel",
        "/login/oidc",
        "/login/oidc/callback",
        "/setup",
        "/manifest.webmanifest",
        "/offline",
        "/sw.js",
        "/favicon.ico",
    }
)
PUBLIC_PREFIX = "/static/"
NO_LONGER_SIGNED_IN = 4401
"""The close code of a lost right: 4000 and the HTTP status of the same refusal."""

_Withdrawal = Callable[[], Coroutine[Any, Any, None]]


class Identify:
    """The ASGI middleware that finds the `Caller` of every request and handshake, or refuses it, and records
    refusals.

    Only public paths are open without a caller. An invalid token is refused even if the demo needs none. A
    WebSocket or a response in pieces ends with the rights of its caller.
    """

    def __init__(
        self,
        app: ASGIApp,
        identity: Identity,
        rights: Rights,
        events: EventLog,
        log: RefusalLog,
        *,
        allowed_hosts: Collection[str] = (),
        demo: bool = False,
    ) -> None:
        self._app = app
        self._identity = identity
        self._rights = rights
        self._events = events
        self._log = log
        self._allowed_hosts = frozenset(canonical(name) for name in allowed_hosts)
        self._demo = demo
        self._handshakes = Handshakes()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        status = 0

        async def watching(message: AsgiMessage) -> None:
            nonlocal status
            status = message.get("status", status)
            await send(message)

        respond = await self._response_to(scope, receive)
        try:
            await respond(watching)
        except WebSocketDisconnect:  # before its handshake had a response
            self._log.note(_address(scope), "incomplete", scope["path"])
            return
        await self._record(scope, status)

    async def _response_to(self, scope: Scope, receive: Receive) -> Callable[[Send], Awaitable[None]]:
        """Return the function that sends the response: the app, as long as its caller has the right, or a
        refusal."""
        seen = self._rights.changes
        try:
            caller = await self._identified(scope)
        except Problem as problem:
            return partial(refuse, scope, receive, problem=problem)
        if caller is None and not _is_public(scope["path"]):
            return partial(_turn_away, HTTPConnection(scope), receive)
        scope["caller"] = caller
        run = partial(_run, self._app, scope, receive)
        if caller is None:
            return run
        client_connection(scope).identify(caller.account)
        is_socket = scope["type"] == "websocket"
        if is_socket:
            await asyncio.sleep(self._handshakes.wait_s(caller.account, monotonic_now()))
        is_still = partial(self._is_still, HTTPConnection(scope), caller)
        withdrawal = partial(self._rights.until_withdrawn, is_still, seen)
        # Returning without the rest makes the server cut the connection, as an incomplete response.
        return partial(run_while_allowed, run, withdrawal, is_socket=is_socket)

    async def _identified(self, scope: Scope) -> Caller | None:
        """Return the caller; None if the request names none. Raise Problem for a request that breaks the
        rules of every request, or whose caller cannot be known."""
        problem = request_problem(scope, self._allowed_hosts)
        if problem is not None:
            raise problem
        scope["headers"] = list(readable(scope["headers"]))
        try:
            return await self._caller(HTTPConnection(scope))
        except ExpiredTokenError as expired:
            scope[_REFUSED_ACCOUNT] = expired.account
            raise
        except StoreError as error:
            raise Problem(503, "store", error.message) from None

    async def _is_still(self, connection: HTTPConnection, caller: Caller) -> bool:
        """Return whether the caller of an open connection may still have it; a store that fails ends nothing
        that runs."""
        try:
            return await self._caller(connection, is_use=caller.panel) == caller
        except Problem:
            return False
        except StoreError:
            return True

    async def _caller(self, connection: HTTPConnection, *, is_use: bool = True) -> Caller | None:
        found = await self._account(connection, is_use=is_use)
        return found and replace(found, address=address_of(connection))

    async def _account(self, connection: HTTPConnection, *, is_use: bool) -> Caller | None:
        scheme, _, bearer = connection.headers.get("authorization", "").partition(" ")
        if scheme.lower() == "bearer":
            program = await self._identity.by_token(bearer.strip())
            if program is None:
                raise not_signed_in()
            return program
        cookie = connection.cookies.get(session_name(connection))
        person = await self._identity.by_cookie(cookie, is_use=is_use) if cookie else None
        if person is None and self._demo and _is_loopback(connection):
            return Caller("demo", Role.ADMIN, "demo")
        return person

    async def _record(self, scope: Scope, status: int) -> None:
        """Log a refusal by the address of its client, and count each 403, and each 401 for a bearer token, in
        the events. A page without a sign-in is no attack."""
        if status not in REFUSED or (status == 401 and not Headers(scope=scope).get("authorization")):
            return
        self._log.note(_address(scope), str(status), scope["path"])
        if status in (401, 403):
            what, who, requested = _event_of(status, scope)
            await count_refusal(self._events, "access_refused", what, who, _address(scope), requested)


def _run(app: ASGIApp, scope: Scope, receive: Receive, send: Send) -> Awaitable[None]:
    """Call the app; a HEAD request as the GET that its route knows."""
    if scope.get("method") == "HEAD":
        scope, send = as_get(scope, send)
    return app(scope, receive, send)


def _is_public(path: str) -> bool:
    return path in PUBLIC_PATHS or path.startswith(PUBLIC_PREFIX)


def _address(scope: Scope) -> str:
    address: str = (scope.get("client") or ("", 0))[0]
    return address


async def run_while_allowed(
    run: Callable[[Send], Awaitable[None]], withdrawal: _Withdrawal, send: Send, *, is_socket: bool = False
) -> None:
    """Call ``run``, which sends a response or has a WebSocket open, and end it once ``withdrawal`` returns,
    because it is no longer allowed: a WebSocket by its close, a response in pieces wherever it is, even while
    it waits for its next piece or for a slow reader. A response that is sent at once costs nothing."""
    running, watch, is_over = asyncio.current_task(), None, False
    assert running is not None

    def end(_: asyncio.Task[None]) -> None:
        if not is_over:
            running.cancel()

    async def sending(message: AsgiMessage) -> None:
        nonlocal watch
        if watch is None and message.get("more_body"):
            watch = _follow(withdrawal, end)
        await send(message)

    if is_socket:
        watch = _follow(withdrawal, end)
    try:
        await run(sending)
    except asyncio.CancelledError:
        if watch is None or not watch.done() or running.uncancel():
            raise
        if is_socket:
            with suppress(RuntimeError, OSError):
                await send({"type": "websocket.close", "code": NO_LONGER_SIGNED_IN})
        watch.result()  # It raises if the right could not be looked up.
    finally:
        is_over = True
        if watch is not None:
            watch.cancel()


def _follow(withdrawal: _Withdrawal, end: Callable[[asyncio.Task[None]], None]) -> asyncio.Task[None]:
    watch = asyncio.create_task(withdrawal())
    watch.add_done_callback(end)
    return watch


async def _turn_away(connection: HTTPConnection, receive: Receive, send: Send) -> None:
    if connection.scope["type"] == "websocket" or wants_json(connection):
        await refuse(connection.scope, receive, send, not_signed_in())
    elif is_below_a_path(connection):
        message = Message.of("served_below_a_path", path=connection.url.path)
        await respond(connection, Problem(404, "not_found", message))(connection.scope, receive, send)
    else:
        await _to_login(connection)(connection.scope, receive, send)


def _to_login(connection: HTTPConnection) -> Response:
    """Redirect a person to the login page, which leads back; htmx moves the complete page."""
    is_page = connection.scope["method"] in ("GET", "HEAD")
    if is_fragment(connection):
        response = problem_json(not_signed_in())
        # A page fetches parts of itself without a button.
        response.headers["HX-Redirect"] = _login_url(_page_of(connection), refused=not is_page)
        return response
    query = connection.url.query
    where = connection.url.path + (f"?{query}" if query else "")
    url = _login_url(where if is_page else _page_of(connection), refused=not is_page)
    # The path is relative, so that a proxy that serves us below a path shows the page that states this.
    is_proxied = any(name.startswith("x-forwarded-") for name in connection.headers)
    return RedirectResponse(url[1:] if is_proxied and connection.url.path == "/" else url, 303)


def _page_of(connection: HTTPConnection) -> str:
    """Return our own page from which htmx or a form sends a request; those of foreign pages were refused
    before."""
    page = connection.headers.get("hx-current-url") or connection.headers.get("referer", "/")
    try:
        parts = urlsplit(page)
    except ValueError:
        return "/"
    return parts.path + (f"?{parts.query}" if parts.query else "")


def _login_url(next_page: str, *, refused: bool) -> str:
    """Return the address of the login page; ``refused``: it explains that the action was not done."""
    query = [f"next={quote(next_page)}"] if next_page != "/" else []
    query += ["refused=true"] if refused else []
    return "/login" + ("?" + "&".join(query) if query else "")


def _is_loopback(connection: HTTPConnection) -> bool:
    """Return whether a request comes from this machine and under its own name: a foreign name for 127.0.0.1
    is an attack."""
    return address_of(connection) in LOOPBACK and connection.url.hostname in LOOPBACK


_REFUSED_ACCOUNT = "refused_account"
"""The key of the scope for the account of an expired token."""


def _event_of(status: int, scope: Scope) -> tuple[Message, str | Message, str]:
    """Return what the events record of a refusal: its text, whose request it was, and the method and the path
    of its route, without the values of the request in it."""
    if status == 401:
        account: str | None = scope.get(_REFUSED_ACCOUNT)
        who = account_shown(account) if account else Message("unknown_token")
        return Message("event_token_refused"), who, ""
    person: Caller | None = scope.get("caller")
    if person is None:
        return Message("event_foreign_page_refused"), "", ""
    path = getattr(scope.get("route"), "path_format", "")
    requested = f"{scope.get('method', 'GET')} {path}" if path else ""
    return Message("event_access_refused"), account_shown(person.account), requested


@dataclass(eq=False, repr=False)
class Identity:
    """The accounts of session cookies and bearer tokens. ``worker_tokens``: by bus, those of the workers that
    this server starts itself; they end with the server."""

    _database: Database
    _sign_in: SignIn
    _rights: Rights
    _worker_tokens: Mapping[str, str]
    _clock: Clock = unix_now

    async def by_cookie(self, cookie: str, *, is_use: bool = True) -> Caller | None:
        """Return the account of a session cookie; None if its session is over or never existed. ``is_use``
        False: the lookup prolongs nothing."""
        hash_ = rules.secret_hash(cookie)
        session = await self._database.read(lambda connection: store.session(connection, hash_))
        now = self._clock()
        if session is None or session.user.disabled or session.user.is_refused_panel:
            return None
        lifetime = self._sign_in.lifetime_of(session.user)
        if min(session.expires_at, lifetime.ends_at(session.created_at, session.used_at)) <= now:
            await self._sign_in.end(hash_)
            return None
        if is_use and now - session.used_at >= rules.USE_NOTED_EVERY_S:
            ends = lifetime.ends_at(session.created_at, now)
            await self._note(lambda connection: store.prolong_session(connection, hash_, now, ends))
        user = session.user
        return Caller(
            user.name,
            user.role,
            "session",
            user.language,
            user.panel,
            user.home,
            user.created_at,
            has_company_account=user.company_account is not None,
            credential=user.credential,
        )

    async def by_token(self, bearer: str) -> Caller | None:
        """Return the account of a bearer token; None for an unknown one. Raise ExpiredTokenError."""
        for bus, own in self._worker_tokens.items():
            if hmac.compare_digest(bearer.encode(), own.encode()):
                return Caller("worker", Role.WORKER, "worker", bus=bus)
        hash_, now = rules.secret_hash(bearer), self._clock()
        token = self._rights.token(hash_)
        if token is None or not token.is_good(now) or _is_use_due(token, now):
            token = await self._database.read(lambda connection: store.token(connection, hash_))
        if token is None:
            return None
        if not token.is_good(now):
            raise ExpiredTokenError(token)
        if _is_use_due(token, now):
            number = token.id
            await self._note(lambda connection: store.note_token_used(connection, number, now))
        return Caller(
            token.name,
            token.role,
            "token",
            created_at=token.created_at,
            bus=token.bus or "",
            credential=token.credential,
        )

    async def _note(self, work: Callable[[StoreConnection], None]) -> None:
        """Store when an account was last used. On a full disk this fails silently, so that the line can still
        be watched."""
        with suppress(StoreError):
            await self._database.write(work)


def _is_use_due(token: Token, now: UnixTime) -> bool:
    """Return whether the time at which a token was last used is due to be stored."""
    return token.used_at is None or now - token.used_at > rules.USE_NOTED_EVERY_S


class ExpiredTokenError(Problem):
    """The refusal (401) of an expired token, given only to a caller who knows the token. ``account``: the
    token's."""

    def __init__(self, token: Token) -> None:
        expired = Message.of("token_expired", called=token.name, day=token.last_day)
        super().__init__(401, "unauthorized", expired)
        self.account = account_of(token.name, token=True)
        # RFC 6750, 3.1
        self.with_headers(
            WWW_Authenticate='Bearer error="invalid_token", error_description="The access token expired"'
        )
