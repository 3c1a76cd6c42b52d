"""Admits one request in each iteration of the event loop, and senders take turns.

Otherwise a burst of some hundred requests, on connections that are open already or just accepted, would be
begun in one iteration, and a command that arrives after it waits for all of them.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection

from starlette.types import ASGIApp, Receive, Scope, Send

from app.core.server.admission.fair_queue import RoundRobin
from bus.instants import monotonic_now

ARRIVED_AT = "lineside.arrived_at"
"""Key in the ``state`` of an ASGI scope: the moment at which the first byte of a request arrived, seconds by
:func:`time.monotonic`; set by :mod:`app.core.server.connection.stages`."""
BEGUN_AT = "lineside.begun_at"
"""Key there: the moment at which the app got the request, before its body is read."""
HEALTH = "/healthz"
"""Is polled to check that this server works."""
_CREDENTIALS = (b"authorization", b"cookie")


class LoopTurns:
    """``await turn(key)``: at once where nothing had a turn in this iteration of the loop, else when the
    key is next. ``run(key, start)`` is the same for a function.

    After a turn of a key that has more waiting, the event loop stays free for as long as the turn took:
    a command needs the loop some twenty times, and would otherwise wait for another turn each time.
    """

    def __init__(self) -> None:
        self._waiting: RoundRobin[object] = RoundRobin()
        self._is_taken = False

    async def turn(self, key: object) -> None:
        """Wait for the turn of ``key``; the keys that wait have their turns one after the other."""
        turn = self._turn(key)
        if turn is not None:
            await turn

    def run(self, key: object, start: Callable[[], None]) -> Callable[[], object]:
        """Call ``start`` in the turn of ``key``. The function returned cancels that."""
        turn = self._turn(key)
        if turn is None:
            start()
            return bool
        turn.add_done_callback(lambda turn: None if turn.cancelled() else start())
        return turn.cancel

    def _turn(self, key: object) -> asyncio.Future[None] | None:
        """Return what to wait for; None: the turn of ``key`` is now."""
        loop = asyncio.get_running_loop()
        if not self._is_taken:
            self._is_taken = True
            loop.call_soon(self._next)
            return None
        turn: asyncio.Future[None] = loop.create_future()
        self._waiting.put(key, turn)
        return turn

    def _next(self) -> None:
        while (found := self._waiting.next()) is not None:
            key, turn = found
            if not turn.done():  # cancelled
                turn.set_result(None)
                loop = asyncio.get_running_loop()
                has_more = self._waiting.count_of(key) > 0
                loop.call_soon(self._rest, loop.time()) if has_more else loop.call_soon(self._next)
                return
        self._is_taken = False

    def _rest(self, begun: float) -> None:
        loop = asyncio.get_running_loop()
        loop.call_later(loop.time() - begun, self._next)


class RequestAdmission:
    """Middleware: notes when the app got a request, which then waits for its turn before anything is done
    with it. Without the server's stamp of the first byte it counts from the call of the app."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app
        self._turns = LoopTurns()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] in ("http", "websocket"):
            state = scope.setdefault("state", {})
            state[BEGUN_AT] = monotonic_now()
            state.setdefault(ARRIVED_AT, state[BEGUN_AT])
            address = (scope.get("client") or ("",))[0]
            is_poll = scope["path"] == HEALTH
            await self._turns.turn((HEALTH, address) if is_poll else sender_of(scope["headers"]) or address)
        await self._app(scope, receive, send)


def sender_of(headers: Collection[tuple[bytes, bytes]]) -> bytes:
    """Return the credential of a request, valid or not; empty where it has none."""
    return next((value for name, value in headers if name in _CREDENTIALS), b"")
