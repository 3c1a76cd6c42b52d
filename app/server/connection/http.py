"""HTTP as uvicorn speaks it, with bounds for what uvicorn waits for or takes without end."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, NoReturn, cast

from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.flow_control import FlowControl
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol, RequestResponseCycle

from app.server.admission.refusal import (
    MALFORMED,
    NO_SUCH_EXPECTATION,
    NO_SUCH_VERSION,
    TOO_LONG,
    TOO_MANY,
    TOO_SLOW,
    Refusal,
)
from app.server.connection.client_connection import EXTENSION
from app.server.connection.connections import Connection
from app.server.connection.pace import Awaited, Pace
from app.server.connection.protocol import ConnectionProtocol

MAX_HEAD_BYTES = 32 * 1024
MAX_HEADERS = 100
MAX_PIPELINED = 8
"""Requests that wait for the response to one before them."""
MAX_FRAMING_SHARE = 16
"""Bytes of chunk sizes and line ends for each byte of a body, beyond those of a head: a chunk of one byte has
5."""
MAX_PASSED_OVER_BYTES = 4 * 1024 * 1024
"""Of what a client sends after its connection has ended."""
VERSIONS = ("1.0", "1.1")


class BeyondBoundsError(Exception):
    """Ends the parsing of a request."""


class HttpProtocol(ConnectionProtocol, HttpToolsProtocol):
    """One connection. The server calls :meth:`check` once a second."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self._refusal = MALFORMED
        self._is_ending = False
        self._passed_over_bytes = 0
        self._framing_bytes = 0
        self._offered: dict[str, Any] = {}
        self._head_bytes = 0
        self._under_way: RequestResponseCycle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """The first request is awaited from here on."""
        super().connection_made(transport)
        self.flow: _Flow = _Flow(transport, self._go_on_soon)
        self.app = _OnConnection(self.app, self)
        self._pace = Pace(self.loop.time())
        address = self.client[0] if self.client else ""
        self.connection = Connection(address, self)
        self._open_connections.open(self.connection)

    def connection_lost(self, exc: Exception | None) -> None:
        """Nothing refers to this protocol any more but itself."""
        if self._pace.awaited in (Awaited.HEAD, Awaited.BODY) and not self._is_ending:
            self._refusals.note(self.connection.address, "incomplete")
        super().connection_lost(exc)
        if self._under_way is not None:
            # Of pipelined requests uvicorn ends the last one alone, which still waits.
            self._under_way.disconnected = True
            self._under_way.message_event.set()
        self._under_way, self.app = None, self.config.loaded_app
        self._unparsed.clear()
        self.flow.resumed = bool
        self._offered.clear()

    def check(self, now: float) -> None:
        """End the connection of a client that takes too long to send or to read. ``now``: the loop's time."""
        if self._is_at_its_end(now):
            return
        if self._is_servers_turn():
            self._pace.since = now
        is_written = self.flow.write_paused or self.cycle is None or self.cycle.response_complete
        waiting = self.transport.get_write_buffer_size() if is_written else 0
        if self._backlog.is_stuck(waiting, now):
            self.transport.abort()
        elif self._pace.is_overdue(now):
            self._refuse(TOO_SLOW)

    def _parse(self, data: bytes) -> None:
        """Headers that go on and on are as bad as those that stand still, and so is what is neither."""
        scope, awaited = self.scope, self._pace.awaited
        self._framing_bytes += len(data)
        HttpToolsProtocol.data_received(self, data)
        if self.scope is not scope or self._pace.awaited is not awaited:
            self._framing_bytes = 0
        elif self._framing_bytes > MAX_HEAD_BYTES + MAX_FRAMING_SHARE * self._pace.received:
            self._refuse(MALFORMED if awaited is Awaited.BODY else TOO_LONG)

    def _takes_input(self, size: int) -> bool:
        """Once its connection has ended, what a client sends is passed over."""
        if self._is_ending:
            self._passed_over_bytes += size
            if self._passed_over_bytes > MAX_PASSED_OVER_BYTES:
                self.transport.abort()
        return not self._is_ending and not self.transport.is_closing()

    def _is_ready(self) -> bool:
        return not (self.flow.read_paused or self.transport.is_closing())

    def send_400_response(self, msg: str) -> None:  # noqa: ARG002
        """Of uvicorn, for what cannot be parsed."""
        self._refuse(self._refusal)

    def handle_websocket_upgrade(self) -> None:
        """The WebSocket goes on with the connection."""
        if self._unparsed:
            # A client waits for the response to its handshake (RFC 6455, 4.1).
            self.transport.abort()
            return
        protocol = self.config.ws_protocol_class
        assert protocol is not None

        # A function made here would refer to this protocol, which would live until the next collection.
        continued = partial(
            cast(Callable[..., asyncio.Protocol], protocol),
            connection=self.connection,
            open_connections=self._open_connections,
            turns=self._turns,
            refusals=self._refusals,
        )
        self.ws_protocol_class = continued  # type: ignore[assignment]
        super().handle_websocket_upgrade()

    # --- of the parser -------------------------------------------------------------------------------

    def on_message_begin(self) -> None:
        """A request starts, perhaps before the response to the previous one."""
        if len(self.pipeline) >= MAX_PIPELINED:
            raise BeyondBoundsError("too many requests wait for a response")
        super().on_message_begin()
        self._pieces += 1
        self._head_bytes = 0
        self._pace.expect(Awaited.HEAD, self.loop.time())

    def on_url(self, url: bytes) -> None:
        self._count_head(len(url))
        super().on_url(url)

    def on_header(self, name: bytes, value: bytes) -> None:
        self._pieces += 1
        self._count_head(len(name) + len(value))
        super().on_header(name, value)

    def on_headers_complete(self) -> None:
        version = self.parser.get_http_version()
        if version not in VERSIONS:
            self._give_up(NO_SUCH_VERSION)
        if version == "1.0":
            # RFC 9110, 10.1.1: its clients do not know what they would get.
            self.expect_100_continue = False
        elif not all(map(_is_met, self.headers)):
            self._give_up(NO_SUCH_EXPECTATION)
        self._pace.expect(Awaited.BODY, self.loop.time())
        self._offered[EXTENSION] = self
        self.scope["extensions"] = self._offered
        super().on_headers_complete()
        if not self.pipeline:
            self._under_way = self.cycle

    def on_body(self, body: bytes) -> None:
        self._pieces += 1
        self._pace.received += len(body)
        super().on_body(body)

    def on_message_complete(self) -> None:
        self._pace.expect(Awaited.NOTHING, self.loop.time())
        super().on_message_complete()
        if self.cycle is not None and self.cycle.response_complete:
            self._pace.expect(Awaited.NEXT, self.loop.time())

    @contextmanager
    def stating_its_end(self) -> Iterator[None]:
        """A response that begins within it before the end of its request states that the connection closes
        (RFC 9112, 9.6), or a client that sends body and head apart would send its next request on it."""
        cycle = self._under_way
        if cycle is None or not cycle.more_body:
            yield
            return
        cycle.keep_alive = False
        yield
        cycle.keep_alive = True  # else uvicorn closes with bytes unread

    def on_response_complete(self) -> None:
        """The client may send the next request, but not endlessly without reading. Where the response did not
        wait for the rest of a body, it is the last."""
        self._under_way = self.pipeline[-1][0] if self.pipeline else None
        super().on_response_complete()
        if self.cycle.response_complete and self._pace.awaited is Awaited.BODY:
            self._end()
        elif self.cycle.response_complete and self._pace.awaited is Awaited.NOTHING:
            self._pace.expect(Awaited.NEXT, self.loop.time())

    # --- how it stands -------------------------------------------------------------------------------

    def _is_responding(self) -> bool:
        return self.cycle is not None and not self.cycle.response_complete

    def _is_servers_turn(self) -> bool:
        """Whether the client waits for the server: what it owes besides that costs no time."""
        begun = self._pace.awaited is Awaited.HEAD and self._is_responding()
        return begun or bool(self.pipeline) or self.flow.read_paused

    def is_idle(self) -> bool:
        """As :class:`app.server.connection.connections.ConnectionHolder`."""
        is_late = not self._awaits_turn and self._pace.is_idle(self.loop.time())
        return is_late or self.flow.write_paused

    def _go_on_soon(self) -> None:
        """Not in the call that allows it: uvicorn is in the midst of ending a response."""
        self.loop.call_soon(self._go_on)

    def _count_head(self, size: int) -> None:
        self._head_bytes += size
        if self._head_bytes > MAX_HEAD_BYTES or len(self.headers) >= MAX_HEADERS:
            self._give_up(TOO_LONG)

    def _give_up(self, refusal: Refusal) -> NoReturn:
        """End the parsing: the parser has uvicorn send a 400, which becomes ``refusal``."""
        self._refusal = refusal
        raise BeyondBoundsError(refusal.detail)

    # --- its end -------------------------------------------------------------------------------------

    def give_way(self) -> None:
        """Make room at once."""
        if self._is_responding() and (
            self.pipeline or self.cycle.response_started or not self.cycle.more_body
        ):
            self.transport.abort()
        else:
            self._respond(TOO_MANY)
            self.transport.close()

    def _refuse(self, refusal: Refusal) -> None:
        """End the connection. Complete requests get their responses first, and nothing is read after them;
        otherwise the refusal is the response where one is awaited and none has begun.
        """
        if self._is_responding() and not self.cycle.more_body:
            self.cycle.keep_alive = False
        elif self._is_responding() and (self.pipeline or self.cycle.response_started):
            self.transport.abort()
        elif self._respond(refusal):
            self._end()
        else:
            self.transport.close()
        self._refusals.note(self.connection.address, refusal.code)
        self._is_ending = True
        self._drop_input()

    def _end(self) -> None:
        """The response was the last. To close with bytes unread resets the connection, and the client may
        never see it (RFC 9112, 9.6): the rest is read and passed over for a while."""
        self._is_ending = True
        self._drop_input()
        if self.transport.is_closing() or not self.transport.can_write_eof():
            self.transport.close()
        else:
            self.transport.write_eof()
            self._closing_since = self.loop.time()

    def _respond(self, refusal: Refusal) -> bool:
        is_awaited = self._pace.awaited in (Awaited.HEAD, Awaited.BODY)
        if is_awaited:
            self.transport.write(refusal.response())
            if self._is_responding():  # in its place: uvicorn passes over what the app sends from here on
                self.cycle.disconnected = True
                self.cycle.message_event.set()
        return is_awaited


class _OnConnection:
    """The app on one connection. What it sends as that closes waits until uvicorn has learned of it, in the
    next turn of the loop: until then the transport refuses to write."""

    def __init__(self, app: ASGIApp, protocol: HttpProtocol) -> None:
        self._app = app
        self._protocol = protocol

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def send_or_learn(message: Message) -> None:
            if self._protocol.transport.is_closing():
                await asyncio.sleep(0)
            if message["type"] == "http.response.start":
                with self._protocol.stating_its_end():
                    await send(message)
            else:
                await send(message)

        await self._app(scope, receive, send_or_learn)


class _Flow(FlowControl):
    """uvicorn's flow of a connection; ``resumed`` is called when more may be parsed."""

    def __init__(self, transport: asyncio.Transport, resumed: Callable[[], None]) -> None:
        super().__init__(transport)
        self.resumed: Callable[[], object] = resumed

    def resume_reading(self) -> None:
        if self.read_paused:
            super().resume_reading()
            self.resumed()


def _is_met(header: tuple[bytes, bytes]) -> bool:
    """Whether it is no expectation (RFC 9110, 10.1.1), or the only one there is."""
    name, value = header
    return name != b"expect" or all(
        each.strip().lower() in (b"", b"100-continue") for each in value.split(b",")
    )
