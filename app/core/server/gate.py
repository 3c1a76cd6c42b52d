"""The protocol of one connection in front of uvicorn's, by the public interfaces of asyncio alone.

A connection is counted, encrypted and watched to its end, and feeds uvicorn in turns: the system returns in
one call what was sent in seconds, and a parser calls back for each piece of it, which may be a single byte.
uvicorn gets one request at a time: the next ones wait here, with the time at which they arrived. `Stages`,
the outermost ASGI middleware, tells the gate how far each request is. `LoopWatch` bounds when the request can
have arrived: the loop, or the machine under it, may have stood still, and the system accepts connections
meanwhile.
"""

from __future__ import annotations

import asyncio
import socket
import ssl
import struct
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from math import inf
from typing import Any, Protocol

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.core.server.addresses import source_of
from app.core.server.connections import (
    ARRIVED_AT,
    BEGUN_AT,
    CONNECTION,
    Awaited,
    Backlog,
    ClientConnection,
    Connections,
    Pace,
)
from app.core.server.refusal_log import RefusalLog
from app.core.server.refusals import (
    MALFORMED,
    NO_SUCH_EXPECTATION,
    NO_SUCH_VERSION,
    TLS_REQUIRED,
    TOO_LONG,
    TOO_MANY,
    TOO_SLOW,
    Refusal,
)
from app.core.server.tls import ChooseContext, NoTlsError, TlsSession
from app.core.server.turns import LoopTurns
from bus.instants import Monotonic, MonotonicClock, monotonic_now

TICK_S = 0.05
SOON_S = 0.001
"""The seconds until the first tick after a stall, which separates later arrivals from those during it."""
ORDINARY_TURN_S = 0.15
"""The seconds since its last tick within which a loop has not stood still."""


class LoopWatch:
    """A watch that notices stalls of the event loop by ticks. ``since``: when the first client can have come,
    on the monotonic clock ``now``."""

    def __init__(self, since: Monotonic, now: MonotonicClock = monotonic_now) -> None:
        self.now = now
        self._before_last = self._last = since
        self._timer: asyncio.TimerHandle | None = None

    @property
    def polled_after(self) -> Monotonic:
        """A moment after which the loop polled all its sockets before it delivered the present data: the data
        was not there yet at this moment.

        The last tick may belong to this turn of the loop, before its poll; the one before it never does.
        """
        return self._before_last

    def earliest(self) -> Monotonic:
        """Return the earliest moment at which the data that the loop delivers now can have arrived."""
        now = self.now()
        return now if now - self.polled_after <= ORDINARY_TURN_S else self.polled_after

    def start(self) -> None:
        """Tick on the running loop until :meth:`stop`."""
        self._tick()

    def stop(self) -> None:
        if self._timer is not None:
            self._timer.cancel()

    def _tick(self) -> None:
        now = self.now()
        stood_still = now - self._last > 2 * TICK_S
        self._before_last, self._last = self._last, now
        self._timer = asyncio.get_running_loop().call_later(SOON_S if stood_still else TICK_S, self._tick)


_SENT = struct.Struct("=44xI")
"""tcpi_last_data_sent, u32 in ms, in struct tcp_info (linux/tcp.h, tcp(7))."""


class TcpSocket(Protocol):
    """The part of a socket that asyncio and uvloop return as ``get_extra_info("socket")`` and that is used
    here."""

    def getsockopt(self, level: int, option: int, size: int, /) -> bytes:
        """Return an option. Raise OSError if the system or the kind of socket does not know it."""


def age_s(connection: TcpSocket | None) -> float | None:
    """Return the age in seconds of a TCP connection on which nothing was sent yet, the time before it was
    accepted included; None if the system does not report it."""
    option = getattr(socket, "TCP_INFO", None)
    if connection is None or option is None:
        return None
    with suppress(OSError):
        info = connection.getsockopt(socket.IPPROTO_TCP, option, _SENT.size)
        if len(info) == _SENT.size:
            sent_ms: int = _SENT.unpack(info)[0]
            return sent_ms / 1000
    return None


SLICE_BYTES = 512
"""The bytes given to the parser at once: 85 empty frames or chunks of a byte."""
REPORT_EVERY_S = 0.01
"""The seconds between two reports of a worker without a turn."""
TURN_S = 0.0003
"""The seconds after which no further slice is parsed in this turn: one of chunks of a byte takes as long."""
MAX_HELD_BYTES, MAX_HELD_PARTS = 64 * 1024, 64
"""The limit of data that waits in the gate; more waits in the system. A part may be a single byte: beyond the
most parts, further data gets the time of the last."""
RECEIVE_BUFFER_BYTES = 64 * 1024
"""The bytes that the system receives on a connection before it is read."""
MAX_HEAD_BYTES, MAX_HEADERS = 32 * 1024, 100
MAX_FRAMING_BYTES, MAX_FRAMING_SHARE = 128 * 1024, 16
"""Limits of a body in chunks: bytes that may arrive before the app takes any, and for each byte that it has
taken. A chunk of one byte has 5 more."""
MAX_MESSAGE_BYTES = 16 * 1024
"""The bytes that a WebSocket may send, control frames included, until the app takes the next message or
trusts the sender."""
MAX_AFTER_CLOSE_BYTES = 4096
"""The bytes that a page may send until it sees the server's Close frame, with its own Close frame."""
MAX_PASSED_OVER_BYTES = 4 * 1024 * 1024
"""The bytes that a client may send after the server has ended the connection."""
CLOSING_S = 5.0
"""The seconds that a client gets to read the end of a connection."""
NEVER = Monotonic(inf)
VERSIONS = ("1.0", "1.1")
HEAD_END = b"\r\n\r\n"

MakeProtocol = Callable[..., asyncio.Protocol]
"""A function that makes uvicorn's protocol; ``app_state`` is the ``state`` of each of its scopes."""


@dataclass
class Gates:
    """The gates that are open, and their shared parts. ``in_clear``: the address at which none is encrypted
    although ``choose_context`` is set."""

    connections: Connections
    refusals: RefusalLog
    watch: LoopWatch
    choose_context: ChooseContext | None = None
    in_clear: tuple[str, int] | None = None
    turns: LoopTurns = field(default_factory=LoopTurns)
    open: set[Gate] = field(default_factory=set)
    is_over: bool = False

    def check(self) -> None:
        """End the connections of clients that take too long; to be called about once a second."""
        now = asyncio.get_running_loop().time()
        for gate in tuple(self.open):
            gate.check(now)

    def end(self) -> None:
        """End the connections that uvicorn does not know, or has ended, and all that are to come."""
        self.is_over = True
        for gate in tuple(self.open):
            gate.leave()


class Gate(ClientConnection, asyncio.Protocol):
    """A connection. ``inner``: uvicorn's protocol behind it, made once the client has sent something."""

    transport: asyncio.Transport

    def __init__(
        self, gates: Gates, make_protocol: MakeProtocol, app_state: dict[str, Any], **options: Any
    ) -> None:
        """Make a gate; ``app_state`` and ``options`` are the arguments that uvicorn gives to its protocol."""
        self._gates = gates
        self._loop = asyncio.get_running_loop()
        self._make_inner = partial(make_protocol, **options)
        self._app_state = app_state
        self._pace = Pace(self._loop.time())
        self._backlog = Backlog()
        self.inner: Any = None
        self.inner_pauses = False
        self._held = deque[tuple[Monotonic, bytearray]]()
        self._held_bytes = 0
        self._sealed = deque[tuple[Monotonic, bytearray]]()
        self._tls: TlsSession | None = None
        self._is_feeding = self._is_heavy = False
        self._awaits_turn = self._awaits_app = False
        self._reports_from = 0.0
        self._is_full = self._is_socket = self._is_trusted = self._has_responded = False
        self.arrived_at = NEVER
        """The earliest moment at which the first byte of this request can have arrived."""
        self._last = b""
        self._seen = 0
        self._body_left = self._most = inf
        self._passed_over = 0
        self._ended_at: float | None = None

    # --- as the protocol of the socket -------------------------------------------------------------

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Await the first request, the handshake of TLS included."""
        self.transport = transport
        self.address = (transport.get_extra_info("peername") or ("",))[0]
        self._read_since, earliest = self._gates.watch.now(), self._gates.watch.earliest()
        # The system accepts earlier: the connection may have been open, and have data, for long.
        age = age_s(transport.get_extra_info("socket"))
        self._floor = earliest if age is None else min(earliest, Monotonic(float(self._read_since) - age))
        if self._gates.choose_context is not None and not self._is_in_clear():
            self._tls = TlsSession(self._gates.choose_context)
            # A handshake is not served before the short requests of the same sender.
            self._is_heavy = True
        self._gates.open.add(self)
        self._gates.connections.open(self)
        if self._gates.is_over:
            transport.abort()

    def data_received(self, data: bytes) -> None:
        if self._ended_at is not None:
            self._pass_over(len(data))
        elif len(data) <= SLICE_BYTES and self._may_report():
            self.inner.data_received(data)
        else:
            waiting = self._held if self._tls is None else self._sealed
            if len(waiting) < MAX_HELD_PARTS:
                waiting.append((self._arrival(), bytearray(data)))
            else:
                waiting[-1][1].extend(data)
            self._held_bytes += len(data)
            self.go_on()

    def eof_received(self) -> None:
        """Close the connection, because the client has closed its side."""

    def pause_writing(self) -> None:
        self._is_full = True
        if self.inner is not None:
            self.inner.pause_writing()

    def resume_writing(self) -> None:
        self._is_full, self._backlog = False, Backlog()
        if self.inner is not None:
            self.inner.resume_writing()
        self.go_on()

    def connection_lost(self, exc: Exception | None) -> None:
        """End the request in turn, which takes the app a millisecond: a client with hundreds of connections
        may drop them all at once."""
        if self not in self._gates.open:
            return
        if self._pace.awaited in (Awaited.HEAD, Awaited.BODY) and self._ended_at is None:
            self._gates.refusals.note(self.address, "incomplete")
        self._drop()
        self._gates.open.discard(self)
        self._gates.connections.close(self)
        self._ended_at = self._ended_at or self._loop.time()
        inner, self.inner = self.inner, None  # Otherwise each would keep the other until the next collection.
        if inner is not None:
            self._gates.turns.run(self._sender(), partial(inner.connection_lost, exc))

    # --- as ClientConnection -------------------------------------------------------------------------

    def give_way(self) -> None:
        """End the connection at once, to make room for another."""
        if self._is_refusable():
            self._write(TOO_MANY.response())
            self._finish()
        else:
            self.transport.abort()

    def is_idle(self) -> bool:
        """Return whether the client keeps the server waiting; a page or a worker never does."""
        is_late = not self._awaits_turn and self._pace.is_idle(self._loop.time())
        return not self._is_socket and (is_late or self._is_full)

    def identify(self, account: str) -> None:
        self._gates.connections.identify(self, account)

    def is_certified(self) -> bool:
        return self._tls is not None and self._tls.is_certified()

    @property
    def is_encrypted(self) -> bool:
        """Whether the connection is encrypted by TLS."""
        return self._tls is not None

    def trust(self) -> None:
        self._most = inf
        self._is_trusted = self._tls is None

    # --- called by Stages --------------------------------------------------------------------------

    def begin(self, scope: Scope) -> Refusal | None:
        """Note that a request with a complete head, or a WebSocket, begins; return its refusal if it has
        one."""
        is_request = scope["type"] == "http"
        self._seen, self._body_left = 0, _body_length(scope["headers"]) if is_request else 0
        self._expect(Awaited.BODY if self._body_left else Awaited.NOTHING)
        refusal = _refusal_of(scope) if is_request else None
        if refusal is not None:
            self._note(refusal)
        return refusal

    def received(self, size: int, *, is_all: bool) -> None:
        """Note that the app has taken so many bytes of a body, or a message."""
        self._pace.received += size if self._body_left == inf else 0
        if self._is_socket:
            self._seen = 0
        elif is_all:
            self._expect(Awaited.NOTHING)

    def is_last(self) -> bool:
        """Return whether the response that begins is the last of this connection: the rest of the request
        will not be read, or its end is not known (RFC 9112, 9.6)."""
        self._has_responded = True
        return self._body_left > 0

    def responded(self) -> None:
        """Note that the response is complete: the client may send the next request."""
        if self._ended_at is None:
            self._expect(Awaited.NEXT)
            self._loop.call_soon(self.go_on)

    def opened(self) -> None:
        """Note that the WebSocket is open: from now on one unread message, not 64 KiB, stops its sender."""
        self._is_socket, self._most = True, min(self._most, MAX_MESSAGE_BYTES)
        self.transport.set_write_buffer_limits(high=0)
        self._loop.call_soon(self.go_on)

    def closed(self) -> None:
        """Note that the app has closed the WebSocket; uvicorn waits for the client's Close frame."""
        self._seen, self._most, self._is_trusted = 0, MAX_AFTER_CLOSE_BYTES, False

    # --- turns -------------------------------------------------------------------------------------

    def go_on(self) -> None:
        """Feed the waiting data, in turn."""
        if (self._held or self._sealed) and not self._awaits_turn and self._may_feed():
            self._awaits_turn = True
            self._gates.turns.run((self._sender(), self._is_heavy), self._take_turn)
        if self._held_bytes > MAX_HELD_BYTES:
            self._hold_back()
        elif not self._held_bytes:
            self._read_on()

    def _may_feed(self) -> bool:
        is_awaited = self._is_socket or self._pace.awaited is not Awaited.NOTHING
        is_blocked = self.inner_pauses or self._is_full or self._awaits_app
        return is_awaited and not is_blocked and self._ended_at is None and not self.transport.is_closing()

    def _may_report(self) -> bool:
        """Return whether uvicorn may have a report of a worker now, without a turn: it takes no more time
        than a turn would, and 40 a second come. What a worker sends beyond that waits for its turns."""
        now = self._loop.time()
        if not self._is_trusted or now < self._reports_from or self._held or not self._may_feed():
            return False
        self._reports_from = now + REPORT_EVERY_S
        return True

    def _take_turn(self) -> None:
        self._awaits_turn, end = False, self._loop.time() + TURN_S
        while (self._held or self._sealed) and self._may_feed():
            if self._held:
                self._feed()
            else:
                self._unseal()
            if self._loop.time() > end:
                break
        # Data for more than one turn is not served before the short requests of the same sender.
        self._is_heavy = self._held_bytes > 0
        self.go_on()

    def _feed(self) -> None:
        """Give uvicorn one slice of the received data."""
        is_first = self._pace.awaited in (Awaited.FIRST, Awaited.NEXT) and not self._is_socket
        arrived_at, data = self._slice(is_first=is_first)
        if not data:
            return  # an empty line before a request (RFC 9112, 2.2)
        if is_first:
            self.arrived_at, self._seen, self._has_responded = arrived_at, 0, False
            self._expect(Awaited.HEAD)
        ends_head = self._pace.awaited is Awaited.HEAD and self._last == HEAD_END
        self._bound(len(data))
        if self._ended_at is not None:
            return
        if self.inner is None:
            self.inner = self._make_inner(app_state={**self._app_state, CONNECTION: self})
            self.inner.connection_made(Wire(self))
        self._is_feeding = True
        try:
            self.inner.data_received(data)
        finally:
            self._is_feeding = False
        if ends_head and self._ended_at is None:
            # uvicorn has made a task of the app, which calls `begin` before this.
            self._awaits_app = True
            self._loop.call_soon(self._heard)

    def _slice(self, *, is_first: bool) -> tuple[Monotonic, bytes]:
        """Return a slice of the waiting data, which ends at the latest where the head or the body does."""
        arrived_at, chunk = self._held[0]
        before = len(chunk)
        if is_first:
            self._last = b""
            del chunk[: before - len(chunk.lstrip(b"\r\n"))]
        size = SLICE_BYTES
        if self._pace.awaited is Awaited.BODY:
            size = int(min(size, self._body_left))
        elif not self._is_socket:
            found = (self._last[-3:] + chunk[: size + 4]).find(HEAD_END)
            size = size if found < 0 else found + len(HEAD_END) - len(self._last[-3:])
        data = bytes(chunk[:size])
        del chunk[:size]
        self._held_bytes -= before - len(chunk)
        if not chunk:
            self._held.popleft()
        self._last = (self._last + data)[-4:]
        return arrived_at, data

    def _bound(self, size: int) -> None:
        """Count received bytes; end a request, or the messages of a WebSocket, that is longer than
        allowed."""
        self._seen += size
        if self._is_socket:
            if self._seen > self._most:
                self._gates.refusals.note(self.address, "too many messages")
                self._ended_at = self._loop.time()
                self.transport.abort()
        elif self._pace.awaited is Awaited.HEAD and self._seen > MAX_HEAD_BYTES:
            self._refuse(TOO_LONG)
        elif self._pace.awaited is Awaited.BODY and self._body_left == inf:
            if self._seen > MAX_FRAMING_BYTES + MAX_FRAMING_SHARE * self._pace.received:
                self._refuse(MALFORMED)
        elif self._pace.awaited is Awaited.BODY:
            self._body_left -= size
            self._pace.received += size
            if not self._body_left:
                self._expect(Awaited.NOTHING)

    def _heard(self) -> None:
        self._awaits_app = False
        self.go_on()

    def _hold_back(self) -> None:
        """Stop reading: further data stays in the buffers of the system."""
        if self._read_since < NEVER and not self.transport.is_closing():
            self._floor, self._read_since = self._arrival(), NEVER
            self.transport.pause_reading()

    def _read_on(self) -> None:
        if self._read_since == NEVER and not self.transport.is_closing():
            self._read_since = self._gates.watch.now()
            self.transport.resume_reading()

    def _arrival(self) -> Monotonic:
        """Return when the data that is delivered now can have arrived at the earliest."""
        if self._gates.watch.polled_after > self._read_since:
            self._floor = NEVER  # Data that had waited until it was read has been delivered.
        return min(self._gates.watch.earliest(), self._floor)

    def _sender(self) -> str:
        """Return the key for turns, shared by connections of one account, or of strangers at one address."""
        return self.account or source_of(self.address)

    def _expect(self, awaited: Awaited) -> None:
        self._pace.expect(awaited, self._loop.time())

    # --- TLS ------------------------------------------------------------------------------------------

    def _is_in_clear(self) -> bool:
        here = self.transport.get_extra_info("sockname")
        return self._gates.in_clear is not None and tuple(here[:2]) == self._gates.in_clear

    def _unseal(self) -> None:
        """Decrypt one slice: 23 records of one byte, or a handshake."""
        assert self._tls is not None
        arrived_at, chunk = self._sealed[0]
        sealed = bytes(chunk[:SLICE_BYTES])
        del chunk[:SLICE_BYTES]
        if not chunk:
            self._sealed.popleft()
        try:
            data = self._tls.decrypt(sealed)
        except NoTlsError as error:
            if error.is_text:  # for a person who left out the s of https
                self.transport.write(TLS_REQUIRED.response())
            self._gates.refusals.note(self.address, "plain HTTP" if error.is_text else "garbage")
            self._finish(linger=True)
        except ssl.SSLError as error:
            reason = (error.reason or str(error.args[-1])).lower().replace("_", " ")
            self._gates.refusals.note(self.address, f"TLS: {reason}")
            self._send(self._tls.take_outgoing())
            self._finish(linger=not self._tls.is_established)
        else:
            self._send(self._tls.take_outgoing())
            self._held_bytes += len(data) - len(sealed)
            if data:
                self._held.append((arrived_at, bytearray(data)))
            elif self._tls.is_over:
                self._finish()

    # --- its end -----------------------------------------------------------------------------------

    def check(self, now: float) -> None:
        """End the connection of a client that takes too long to send or to read. ``now``: the loop's time."""
        if self._ended_at is not None or self.transport.is_closing():
            self._ended_at = self._ended_at or now
            if now - self._ended_at > CLOSING_S:
                self.transport.abort()
            return
        if self.inner_pauses or self._awaits_turn or self._is_full:
            self._pace.since = now  # it is the server's turn
        is_written = self._is_full or self._pace.awaited is Awaited.NEXT
        if self._backlog.is_stuck(self.transport.get_write_buffer_size() if is_written else 0, now):
            self.transport.abort()
        elif self._pace.is_overdue(now):
            self._refuse(TOO_SLOW)

    def leave(self) -> None:
        """End the connection if uvicorn does not."""
        if self.inner is None or self._ended_at is not None:
            self.transport.abort()

    @property
    def is_over(self) -> bool:
        """Whether nothing more is written to the client."""
        return self._ended_at is not None or self.transport.is_closing()

    def write(self, data: bytes) -> None:
        """Write for uvicorn; its response to a request that it cannot parse becomes a refusal of ours."""
        if self.is_over:
            return
        if self._is_feeding and not self._is_socket and data.startswith(b"HTTP/1.1 400 "):
            self._refuse(MALFORMED)
        else:
            self._write(data)

    def close(self) -> None:
        """Close for uvicorn. Bytes that are still to come are read and ignored for a while: closing at once
        would reset the connection, and the client might never see the response (RFC 9112, 9.6)."""
        self._finish(linger=self._body_left > 0 or self._held_bytes > 0)

    def _is_refusable(self) -> bool:
        """Return whether a request is awaited, and no response to it has begun."""
        is_awaited = self._pace.awaited in (Awaited.HEAD, Awaited.BODY)
        return is_awaited and self._ended_at is None and not self._has_responded

    def _write(self, data: bytes) -> None:
        self._send(data if self._tls is None else self._tls.encrypt(data))

    def _send(self, data: bytes) -> None:
        if data:
            self.transport.write(data)

    def _refuse(self, refusal: Refusal) -> None:
        """End the connection, with the refusal as the response if one is awaited and none has begun."""
        self._note(refusal)
        is_read = self._is_refusable()
        if is_read:
            self._write(refusal.response())
        self._finish(linger=is_read)

    def _note(self, refusal: Refusal) -> None:
        self._gates.refusals.note(self.address, refusal.code)

    def _finish(self, *, linger: bool = False) -> None:
        if self._ended_at is not None:
            return
        self._ended_at = self._loop.time()
        self._drop()
        if self._tls is not None and not self.transport.is_closing():
            self._send(self._tls.end())
        if linger and not self.transport.is_closing() and self.transport.can_write_eof():
            self.transport.write_eof()
            self._read_on()
        else:
            self.transport.close()

    def _drop(self) -> None:
        self._held.clear()
        self._sealed.clear()
        self._held_bytes = 0

    def _pass_over(self, size: int) -> None:
        self._passed_over += size
        if self._passed_over > MAX_PASSED_OVER_BYTES:
            self.transport.abort()


class Wire:
    """The transport to which uvicorn's protocol writes; all else is that of the connection."""

    def __init__(self, gate: Gate) -> None:
        self._gate = gate
        self.write, self.close = gate.write, gate.close

    def __getattr__(self, name: str) -> Any:
        return getattr(self._gate.transport, name)

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        if name == "sslcontext":
            return self._gate.is_encrypted
        return self._gate.transport.get_extra_info(name, default)

    def set_protocol(self, protocol: asyncio.BaseProtocol) -> None:
        """Give the connection to the protocol of a WebSocket."""
        self._gate.inner = protocol

    def is_closing(self) -> bool:
        return self._gate.is_over

    def pause_reading(self) -> None:
        self._gate.inner_pauses = True

    def resume_reading(self) -> None:
        """Resume after this call, in which uvicorn is still ending a response."""
        self._gate.inner_pauses = False
        asyncio.get_running_loop().call_soon(self._gate.go_on)


def _refusal_of(scope: Scope) -> Refusal | None:
    """Return the refusal of a request that cannot be met, None if it can."""
    if scope["http_version"] not in VERSIONS:
        return NO_SUCH_VERSION
    if len(scope["headers"]) > MAX_HEADERS:
        return TOO_LONG
    expected = (value.lower() for name, value in scope["headers"] if name == b"expect")
    is_met = all(each.strip() in (b"", b"100-continue") for value in expected for each in value.split(b","))
    return None if is_met or scope["http_version"] == "1.0" else NO_SUCH_EXPECTATION


def _body_length(headers: list[tuple[bytes, bytes]]) -> float:
    """Return the length of the body of a request; infinite for chunks."""
    if any(name == b"transfer-encoding" for name, _ in headers):
        return inf
    with suppress(ValueError):
        return float(int(next((value for name, value in headers if name == b"content-length"), b"0")))
    return inf


class Stages:
    """The ASGI middleware that stamps a request with its arrival and tells its gate of the app's progress."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        gate: Gate = scope["state"][CONNECTION]
        scope["state"][ARRIVED_AT] = gate.arrived_at
        scope["state"][BEGUN_AT] = monotonic_now()

        async def receiving() -> Message:
            message = await receive()
            if message["type"] in ("http.request", "websocket.receive"):
                gate.received(len(message.get("body", b"")), is_all=not message.get("more_body"))
            return message

        async def sending(message: Message) -> None:
            if message["type"] == "http.response.start" and gate.is_last():
                message = {**message, "headers": [*message.get("headers", ()), (b"connection", b"close")]}
            await send(message)
            match message["type"]:
                case "http.response.body" if not message.get("more_body"):
                    gate.responded()
                case "websocket.accept":
                    gate.opened()
                case "websocket.close":
                    gate.closed()

        refusal = gate.begin(scope)
        await (refusal or self._app)(scope, receiving, sending)
