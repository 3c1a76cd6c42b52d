"""Requests that were refused because their sender may not become events: those of a minute are one."""

from __future__ import annotations

from contextlib import suppress

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.types import Message as AsgiMessage

from app.audit.log import EventLog
from app.errors import StoreError
from app.server.addresses import source_of
from app.web.access import Person, account_shown
from bus.messages import Message

_STARTS = frozenset({"http.response.start", "websocket.http.response.start"})
UNKNOWN_TOKEN = Message("unknown_token")
REFUSED_ACCOUNT = "refused_account"
"""In the scope: whose token it is that is not good any more."""


class RecordRefusals:
    """Counts each 403, and each 401 for a bearer token. A page that nobody is signed in for is no attack."""

    def __init__(self, app: ASGIApp, events: EventLog) -> None:
        self._app = app
        self._events = events

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        status = 0

        async def watching(message: AsgiMessage) -> None:
            nonlocal status
            if message["type"] in _STARTS:
                status = message["status"]
            await send(message)

        await self._app(scope, receive, watching)
        # Without an event a refusal is as good: the disk may be full.
        with suppress(StoreError):
            if status == 403:
                await self._count_forbidden(scope)
            elif status == 401 and Headers(scope=scope).get("authorization"):
                account: str | None = scope.get(REFUSED_ACCOUNT)
                who = account_shown(account) if account else UNKNOWN_TOKEN
                await self._count(Message("event_token_refused"), who, scope)

    async def _count_forbidden(self, scope: Scope) -> None:
        person: Person | None = scope.get("person")
        if person is None:
            await self._count(Message("event_foreign_page_refused"), "", scope)
        else:
            await self._count(
                Message("event_access_refused"), account_shown(person.account), scope, _asked(scope)
            )

    async def _count(self, what: Message, who: str | Message, scope: Scope, message: str = "") -> None:
        client = scope.get("client")
        # Of IPv6 the subnet: a sender has as many of its addresses as it likes.
        origin = source_of(client[0]) if client else ""
        await self._events.count("access_refused", what, who=who, origin=origin, message=message)


def _asked(scope: Scope) -> str:
    """The method and the path of the route, without what the request filled into it."""
    path = getattr(scope.get("route"), "path_format", "")
    return f"{scope.get('method', 'GET')} {path}" if path else ""
