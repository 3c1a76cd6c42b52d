"""Turns at what costs much: an account has few at a time, and its others wait while other people's go on."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack
from dataclasses import dataclass, field
from math import inf
from typing import Any

from fastapi import Depends
from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.types import Message as AsgiMessage

from app.core.server.turns import FairQueue
from app.core.web.admission.access import Viewer, caller_of
from app.core.web.services import service_of

MAX_AT_ONCE = 2
MAX_WAITING = 30
"""How many searches, and how many downloads, of an account may wait."""
MAX_READS = 2
REST, MOST_REST_S = 2.0, 0.5
"""How many times as long as a read took its place stays free, and for how long at most. A command needs the
event loop some twenty times, and would otherwise wait for another page of that account each time."""
MAX_WAITING_READS = 200
"""How many other reads of an account may wait."""


@dataclass(frozen=True)
class Turns:
    """The queues of one app, each by account."""

    searches: FairQueue[str] = field(default_factory=lambda: FairQueue(inf, MAX_AT_ONCE, MAX_WAITING))
    downloads: FairQueue[str] = field(default_factory=lambda: FairQueue(inf, MAX_AT_ONCE, MAX_WAITING))
    reads: FairQueue[str] = field(
        default_factory=lambda: FairQueue(
            inf, MAX_READS, MAX_WAITING_READS, rest=REST, most_rest_s=MOST_REST_S
        )
    )
    """Everything else that is read."""


def _in_turn(queue_of: Callable[[Turns], FairQueue[str]]) -> Any:
    """``dependencies=[SEARCH]`` of a route: one turn from before it runs until its response is sent."""

    async def take_turn(connection: HTTPConnection, person: Viewer) -> AsyncIterator[None]:
        async with queue_of(service_of(connection, Turns)).turn(person.account):
            yield

    return Depends(take_turn)


SEARCH = _in_turn(lambda turns: turns.searches)
DOWNLOAD = _in_turn(lambda turns: turns.downloads)


class ReadLimiter:
    """Makes few responses of one account at a time. To render a page of a long line takes the event loop tens
    of milliseconds; the requests of others come in between."""

    def __init__(self, app: ASGIApp, turns: FairQueue[str]) -> None:
        self._app = app
        self._turns = turns

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        person = caller_of(HTTPConnection(scope))
        if person is None:
            await self._app(scope, receive, send)
            return
        async with AsyncExitStack() as turn:

            async def sending(message: AsgiMessage) -> None:
                # The response is made: a stream that lasts delays no other request.
                await turn.aclose()
                await send(message)

            await turn.enter_async_context(self._turns.turn(person.account))
            await self._app(scope, receive, sending)
