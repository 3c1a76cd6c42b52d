"""Passes one HTTP request on to the home of its bus, and the response back, piece by piece."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Coroutine
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import structlog
from starlette.types import Receive, Scope, Send

from app.errors import Problem
from app.home.homes import Home
from app.routing.forwarding.headers import Pairs, to_client
from app.routing.peers import Peers
from app.web.admission.arrival import SAFE_METHODS
from bus.messages import Message

if TYPE_CHECKING:
    import httpx

PROBE_AFTER_S = 0.5
"""A response that takes longer is waited for while the home responds to a probe."""
PROBE_S = 0.45
PROBES_EVERY_S = 1.0
MAX_MISSED, MAX_MISSED_OF_WRITE = 1, 4
"""Probes in a row. A page states soon that a home is away; the result of a command is worth a wait."""
MAX_HEAD_S = 120.0
"""From a request to the head of its response: the longest restore responds at once, a search within
seconds."""
MAX_RESPONSE_BYTES = 2 * 1024**3
MAX_RESPONSE_S = 3600.0
"""Of a response that is no stream of events."""
EVENT_STREAM = "text/event-stream"
_log = structlog.get_logger()


class _GoneError(Exception):
    """The client has closed its connection."""


def home_away(home: Home, *, is_write: bool) -> Problem:
    """The home of a bus cannot be reached: nothing was sent to it."""
    params = {"server": home.server, "bus": home.bus}
    if is_write:
        return Problem(503, "bus_closed", Message.of("home_away_not_sent", **params), outcome="not_sent")
    problem = Problem(503, "home_away", Message.of("home_away", **params))
    return problem.with_headers(Retry_After="2")


def _unverified(home: Home) -> Problem:
    """The home got a command, and its result is not known."""
    message = Message.of("home_unverified", server=home.server, bus=home.bus)
    return Problem(504, "unverified", message, outcome="unverified")


class Courier:
    """Passes requests on."""

    def __init__(self, peers: Peers) -> None:
        self._peers = peers

    async def carry(
        self, home: Home, target: bytes, headers: Pairs, scope: Scope, receive: Receive, send: Send
    ) -> None:
        """Raises Problem 503 or 504 where the home does not respond, before anything is sent to the
        client."""
        with suppress(_GoneError):
            await self._carry(home, target, headers, scope, receive, send)

    async def _carry(
        self, home: Home, target: bytes, headers: Pairs, scope: Scope, receive: Receive, send: Send
    ) -> None:
        is_write = scope["method"] not in SAFE_METHODS
        client = self._peers.writing if is_write else self._peers.reading
        body = _Body(receive, scope["headers"])
        request = client.build_request(
            scope["method"],
            home.url,
            headers=[*headers, *body.framing, (b"accept-encoding", b"identity")],
            content=body.pieces() if body.framing else None,
            extensions={"target": target},
        )
        response = await self._responded(client, request, home, body, is_write=is_write)
        try:
            await _while_present(body, _pass_back(response, send, home))
        finally:
            await response.aclose()

    async def _responded(
        self, client: httpx.AsyncClient, request: httpx.Request, home: Home, body: _Body, *, is_write: bool
    ) -> httpx.Response:
        """The head of the response. Raises Problem."""
        import httpx

        sending = asyncio.create_task(client.send(request, stream=True))
        try:
            async with asyncio.timeout(MAX_HEAD_S):
                await self._watch(sending, home, body, MAX_MISSED_OF_WRITE if is_write else MAX_MISSED)
            return await sending
        except (httpx.ConnectError, httpx.ConnectTimeout, httpx.PoolTimeout):
            raise home_away(home, is_write=is_write) from None
        except (httpx.HTTPError, httpx.StreamError, TimeoutError) as error:
            if body.problem is not None:
                raise body.problem from None
            _log.warning("home does not respond", server=home.server, why=str(error) or type(error).__name__)
            raise _unverified(home) if is_write else home_away(home, is_write=False) from None
        finally:
            if not sending.done():
                sending.cancel()
                with suppress(asyncio.CancelledError, Exception):
                    (await sending) and None

    async def _watch(
        self, sending: asyncio.Task[httpx.Response], home: Home, body: _Body, most_missed: int
    ) -> None:
        """Return once the head is there, or its request has failed. Raises TimeoutError where the home
        does not respond: a process that is halted still accepts connections."""
        pause_s, missed = PROBE_AFTER_S, 0
        while not sending.done():
            await asyncio.wait({sending}, timeout=pause_s)
            if sending.done() or not body.is_sent:
                continue
            responds = await self._responds(home)
            missed, pause_s = (0, PROBES_EVERY_S) if responds else (missed + 1, 0.0)
            if missed >= most_missed and not sending.done():
                raise TimeoutError

    async def _responds(self, home: Home) -> bool:
        import httpx

        with suppress(httpx.HTTPError, TimeoutError):
            async with asyncio.timeout(PROBE_S):
                await self._peers.reading.get(f"{home.url.rstrip('/')}/healthz")
                return True
        return False


class _Body:
    """The body of a request as it arrives. ``framing``: how its end is stated to the home; empty: it has
    none. ``problem``: why it was refused on the way."""

    def __init__(self, receive: Receive, headers: Pairs) -> None:
        self._receive = receive
        given = dict(headers)
        length = given.get(b"content-length")
        self.framing: Pairs = []
        # A body in chunks is framed again, with a length only where the client stated no other framing.
        if b"transfer-encoding" in given:
            self.framing = [(b"transfer-encoding", b"chunked")]
        elif length is not None and length != b"0":
            self.framing = [(b"content-length", length)]
        self.is_sent = not self.framing
        self.problem: Problem | None = None

    async def pieces(self) -> AsyncIterator[bytes]:
        while True:
            try:
                message = await self._receive()
            except Problem as problem:  # it is too large
                self.problem = problem
                raise
            if message["type"] == "http.disconnect":
                raise _GoneError
            yield message.get("body", b"")
            if not message.get("more_body"):
                self.is_sent = True
                return

    async def until_gone(self) -> None:
        """Return once the client has closed its connection."""
        while (await self._receive())["type"] != "http.disconnect":
            pass


async def _while_present(body: _Body, passing: Coroutine[Any, Any, None]) -> None:
    """Await ``passing`` while the client is there. Raises _GoneError."""
    task = asyncio.create_task(passing)
    gone = asyncio.create_task(body.until_gone())
    try:
        await asyncio.wait({task, gone}, return_when=asyncio.FIRST_COMPLETED)
        if not task.done():
            raise _GoneError
        await task
    finally:
        for each in (task, gone):
            each.cancel()
        await asyncio.gather(task, gone, return_exceptions=True)


async def _pass_back(response: httpx.Response, send: Send, home: Home) -> None:
    """The response as its pieces come. What ends early leaves the response incomplete, and the server cuts
    the connection."""
    import httpx

    is_stream = response.headers.get("content-type", "").startswith(EVENT_STREAM)
    await send(
        {
            "type": "http.response.start",
            "status": response.status_code,
            "headers": to_client(response.headers.raw),
        }
    )
    size = 0
    with suppress(httpx.HTTPError, TimeoutError):
        async with asyncio.timeout(None if is_stream else MAX_RESPONSE_S):
            async for piece in response.aiter_raw():
                size += len(piece)
                if size > MAX_RESPONSE_BYTES and not is_stream:
                    _log.warning("response of a home is too large", server=home.server)
                    return
                await send({"type": "http.response.body", "body": piece, "more_body": True})
            await send({"type": "http.response.body", "body": b""})
