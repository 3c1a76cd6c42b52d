"""HTTP as uvicorn speaks it, with bounds for what uvicorn waits for or takes without end."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial
from typing import Any, NoReturn, cast

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from app.server.connections import EXTENSION, Connection
from app.server.counted_protocol import CountedProtocol
from app.server.pace import Awaited, Pace
from app.server.refusal import (
    MALFORMED,
    NO_SUCH_EXPECTATION,
    NO_SUCH_VERSION,
    TOO_LONG,
    TOO_MANY,
    TOO_SLOW,
    Refusal,
)
from app.server.starting import Starts, sender_of

MOST_HEAD_BYTES = 32 * 1024
MOST_HEADERS = 100
MOST_PIPELINED = 8
"""Requests that wait for the response to one before them."""
VERSIONS = ("1.0", "1.1")


class BeyondBoundsError(Exception):
    """Ends the parsing of a request."""


class HttpProtocol(CountedProtocol, HttpToolsProtocol):
    """One connection. The server calls :meth:`check` once a second."""

    def __init__(self, *args: Any, upgrades: Starts, **options: Any) -> None:
        super().__init__(*args, **options)
        self._upgrades = upgrades
        self._cancel_upgrade: Callable[[], object] = bool
        self._refusal = MALFORMED
        self._is_ending = False
        self._offered: dict[str, Any] = {}
        self._head_bytes = 0

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """The first request is awaited from here on."""
        super().connection_made(transport)
        self._pace = Pace(self.loop.time())
        address = self.client[0] if self.client else ""
        self.connection = Connection(address, self)
        self._open_connections.open(self.connection)

    def connection_lost(self, exc: Exception | None) -> None:
        """Nothing refers to this protocol any more but itself."""
        super().connection_lost(exc)
        self._cancel_upgrade()
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

    def data_received(self, data: bytes) -> None:
        """Headers that go on and on are as bad as those that stand still."""
        if self._is_ending:
            return
        scope = self.scope
        super().data_received(data)
        if self._pace.awaited is Awaited.HEAD and self.scope is scope:
            self._pace.received += len(data)
            if self._pace.received > MOST_HEAD_BYTES:
                self._refuse(TOO_LONG)

    def send_400_response(self, msg: str) -> None:  # noqa: ARG002
        """Of uvicorn, for what cannot be parsed."""
        self._refuse(self._refusal)

    def handle_websocket_upgrade(self) -> None:
        """In turn: to begin a WebSocket takes longer than to read its request, and a burst of them would
        stand in front of the requests of others."""
        self.transport.pause_reading()
        sender = sender_of(self.headers) or self.connection.address
        self._cancel_upgrade = self._upgrades.run(sender, self._upgrade)

    def _upgrade(self) -> None:
        """The WebSocket goes on with the connection."""
        if self.transport.is_closing():
            return
        self.transport.resume_reading()
        protocol = self.config.ws_protocol_class
        assert protocol is not None

        # A function made here would refer to this protocol, which would live until the next collection.
        continued = partial(
            cast(Callable[..., asyncio.Protocol], protocol),
            connection=self.connection,
            open_connections=self._open_connections,
        )
        self.ws_protocol_class = continued  # type: ignore[assignment]
        super().handle_websocket_upgrade()

    # --- of the parser -------------------------------------------------------------------------------

    def on_message_begin(self) -> None:
        """A request starts, perhaps before the response to the previous one."""
        if len(self.pipeline) >= MOST_PIPELINED:
            raise BeyondBoundsError("too many requests wait for a response")
        super().on_message_begin()
        self._head_bytes = 0
        self._pace.expect(Awaited.HEAD, self.loop.time())

    def on_url(self, url: bytes) -> None:
        self._count_head(len(url))
        super().on_url(url)

    def on_header(self, name: bytes, value: bytes) -> None:
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
        self._offered[EXTENSION] = self._identify
        self.scope["extensions"] = self._offered
        super().on_headers_complete()

    def on_body(self, body: bytes) -> None:
        self._pace.received += len(body)
        super().on_body(body)

    def on_message_complete(self) -> None:
        self._pace.expect(Awaited.NOTHING, self.loop.time())
        super().on_message_complete()
        if self.cycle is not None and self.cycle.response_complete:
            self._pace.expect(Awaited.NEXT, self.loop.time())

    def on_response_complete(self) -> None:
        """The client may send the next request, but not endlessly without reading."""
        super().on_response_complete()
        if self.cycle.response_complete and self._pace.awaited in (Awaited.BODY, Awaited.NOTHING):
            is_complete = self._pace.awaited is Awaited.NOTHING
            self._pace.expect(Awaited.NEXT if is_complete else Awaited.REST, self.loop.time())

    # --- how it stands -------------------------------------------------------------------------------

    def _is_responding(self) -> bool:
        return self.cycle is not None and not self.cycle.response_complete

    def _is_servers_turn(self) -> bool:
        """Whether the client waits for the server: what it owes besides that costs no time."""
        begun = self._pace.awaited is Awaited.HEAD and self._is_responding()
        return begun or bool(self.pipeline) or self.flow.read_paused

    def is_idle(self) -> bool:
        """As :class:`app.server.connections.ConnectionHolder`."""
        return self._pace.is_idle(self.loop.time()) or self.flow.write_paused

    def _count_head(self, size: int) -> None:
        self._head_bytes += size
        if self._head_bytes > MOST_HEAD_BYTES or len(self.headers) >= MOST_HEADERS:
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
        elif self._respond(refusal) and self.transport.can_write_eof():
            # To close with bytes unread resets the connection, and the client may never see the response
            # (RFC 9112, 9.6): the rest is read and passed over for a while.
            self.transport.write_eof()
            self._closing_since = self.loop.time()
        else:
            self.transport.close()
        self._is_ending = True

    def _respond(self, refusal: Refusal) -> bool:
        is_awaited = self._pace.awaited in (Awaited.HEAD, Awaited.BODY)
        if is_awaited:
            self.transport.write(refusal.response())
        return is_awaited


def _is_met(header: tuple[bytes, bytes]) -> bool:
    """Whether it is no expectation (RFC 9110, 10.1.1), or the only one there is."""
    name, value = header
    return name != b"expect" or all(
        each.strip().lower() in (b"", b"100-continue") for each in value.split(b",")
    )
