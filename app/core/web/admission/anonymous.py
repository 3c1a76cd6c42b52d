"""Requests without a person: few at a time of each address, so that a flood of them delays itself."""

from __future__ import annotations

from collections.abc import Collection

from starlette.requests import ClientDisconnect, HTTPConnection, Request
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.types import Message as AsgiMessage

from app.core.server.addresses import source_of
from app.core.server.turns import FairQueue, TooManyWaitingError
from app.core.web.admission.access import address_of, caller_of
from app.core.web.admission.bounds import MAX_PLAIN_BODY_BYTES, bounded
from app.core.web.admission.security import refuse
from app.core.web.problems import too_many_requests
from app.errors import Problem

HEALTH = "/healthz"
"""Path that is polled to check that this server works."""
MAX_AT_ONCE, AT_ONCE_OF_ADDRESS = 2, 1
MAX_WAITING, MAX_WAITING_OF_ADDRESS = 512, 64
REST = 4.0
"""To render the login page takes the event loop milliseconds, and a command needs the loop some twenty times:
without the rest it would wait for another page each time."""


class AnonymousLimiter:
    """Serves a request without a person in its turn, and only once its body has arrived.

    Otherwise a burst of them would be begun in one iteration of the event loop, before everyone else's.
    ``exempt``: paths that cost the loop next to nothing, or have other turns.
    """

    def __init__(self, app: ASGIApp, exempt: Collection[str] = (HEALTH,)) -> None:
        self._app = app
        self._exempt = exempt
        # Half of what may wait is for known keys, and no address is known.
        self._turns: FairQueue[str] = FairQueue(
            MAX_AT_ONCE, AT_ONCE_OF_ADDRESS, MAX_WAITING_OF_ADDRESS, 2 * MAX_WAITING, REST
        )

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        is_exempt = scope["type"] != "http" or scope["path"] in self._exempt
        if is_exempt or caller_of(HTTPConnection(scope)) is not None:
            await self._app(scope, receive, send)
            return
        try:
            await self._serve(scope, bounded(scope, receive, MAX_PLAIN_BODY_BYTES), send)
        except Problem as problem:
            await refuse(scope, receive, send, problem)
        except TooManyWaitingError:
            await refuse(scope, receive, send, too_many_requests())

    async def _serve(self, scope: Scope, receive: Receive, send: Send) -> None:
        connection = Request(scope, receive)
        try:
            body = await connection.body()
        except ClientDisconnect:
            return
        async with self._turns.turn(source_of(address_of(connection)), known=False):
            await self._app(scope, _replaying(body, receive), send)


def _replaying(body: bytes, receive: Receive) -> Receive:
    """``receive`` after the body was taken from it."""
    begun: list[AsgiMessage] = [{"type": "http.request", "body": body, "more_body": False}]

    async def replaying() -> AsgiMessage:
        return begun.pop() if begun else await receive()

    return replaying
