"""The TLS of a connection, between its socket and the protocol that it carries.

That of asyncio and of uvloop makes the protocol after the handshake, and decrypts all that a read of the
socket gives in one iteration of the event loop: thousands of records of one byte. Here the protocol
has its connection from the first moment, with the limits and the time that it gives any client, and
handshakes and many records take turns with everything else that is parsed (`app.server.admission.turns`).
"""

from __future__ import annotations

import asyncio
import ssl
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from app.server.admission.addresses import source_of
from app.server.admission.refusal import TLS_REQUIRED
from app.server.admission.refusal_log import RefusalLog
from app.server.admission.turns import LoopTurns
from app.server.connection.protocol import ConnectionProtocol

HEADER_BYTES = 5
MAX_RECORD_BYTES = HEADER_BYTES + 2**14 + 2048
"""RFC 5246, 6.2.3; TLS 1.3 allows less."""
HANDSHAKE = 22
"""Type of the first record of a client (RFC 8446, 5.1)."""
MAX_RECORDS_A_TURN = 8
"""To decrypt one takes 3 µs."""
MAX_UNREAD_BYTES = 64 * 1024
"""Of responses to updates of the keys."""
MAX_PASSED_OVER_BYTES = 1024 * 1024
"""Of what a client sends after the end of its connection."""

ChooseContext = Callable[[bytes], ssl.SSLContext]
"""The context for the first record of a client."""


class TlsConnection(asyncio.Protocol, asyncio.Transport):
    """The socket's protocol, and the transport of ``protocol``, which is served as on a plain connection."""

    _raw: asyncio.Transport
    _tls: ssl.SSLObject

    def __init__(
        self,
        protocol: ConnectionProtocol,
        choose_context: ChooseContext,
        turns: LoopTurns,
        refusals: RefusalLog,
    ) -> None:
        super().__init__()
        self._protocol: Any = protocol
        self._choose_context = choose_context
        self._turns = turns
        self._refusals = refusals
        self._incoming, self._outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
        self._received = bytearray()
        self._address = ""
        self._passed_over_bytes = 0
        self._has_begun = False
        self._is_established = False
        self._is_over = False
        self._awaits_turn = False
        self._is_paused = False

    # --- as the protocol of the socket -----------------------------------------------------------------

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """The handshake is a part of the wait for the first request."""
        self._raw = transport
        self._address = (transport.get_extra_info("peername") or ("",))[0]
        self._protocol.connection_made(self)

    def data_received(self, data: bytes) -> None:
        if self._is_over:
            self._pass_over(len(data))
        elif not self._has_begun and not self._received and data[0] != HANDSHAKE:
            self._refuse_plain(data)
        else:
            self._protocol.arrived(len(data), is_first=not self._received)
            self._received += data
            self._go_on()

    def eof_received(self) -> None:
        """The connection closes, as a plain one does."""

    def pause_writing(self) -> None:
        self._protocol.pause_writing()

    def resume_writing(self) -> None:
        self._protocol.resume_writing()

    def connection_lost(self, exc: Exception | None) -> None:
        """Nothing refers to the protocol any more: each would keep the other until the next collection."""
        protocol, self._protocol = self._protocol, None
        self._received.clear()
        protocol.connection_lost(exc)

    # --- as the transport of the protocol ----------------------------------------------------------------

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        """``sslcontext`` is there from the start; ``peercert`` is a certificate that was verified."""
        match name:
            case "sslcontext":
                return True
            case "peercert":
                return self._tls.getpeercert() if self._is_established else default
            case _:
                return self._raw.get_extra_info(name, default)

    def set_protocol(self, protocol: asyncio.BaseProtocol) -> None:
        self._protocol = protocol

    def get_protocol(self) -> asyncio.BaseProtocol:
        protocol: asyncio.BaseProtocol = self._protocol
        return protocol

    def is_closing(self) -> bool:
        return self._raw.is_closing()

    def pause_reading(self) -> None:
        self._is_paused = True
        self._raw.pause_reading()

    def resume_reading(self) -> None:
        """What was received before is decrypted soon, not in this call."""
        if self._is_paused:
            self._is_paused = False
            asyncio.get_running_loop().call_soon(self._go_on)

    def is_reading(self) -> bool:
        return not self._is_paused and self._raw.is_reading()

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        self._raw.set_write_buffer_limits(high, low)

    def get_write_buffer_size(self) -> int:
        return self._raw.get_write_buffer_size()

    def get_write_buffer_limits(self) -> tuple[int, int]:
        return self._raw.get_write_buffer_limits()

    def write(self, data: bytes | bytearray | memoryview) -> None:
        if not self._is_established or self._is_over or self._raw.is_closing():
            return
        sent = self._tls.write(data) if data else 0
        while sent < len(data):  # a record for each 16 KiB
            sent += self._tls.write(memoryview(data)[sent:])
        self._raw.write(self._outgoing.read())

    def can_write_eof(self) -> bool:
        return True

    def write_eof(self) -> None:
        """What follows is passed over, up to the client's end."""
        self._end()
        self._raw.write_eof()
        self._raw.resume_reading()

    def close(self) -> None:
        if not self._raw.is_closing():
            self._end()
            self._raw.close()

    def abort(self) -> None:
        self._raw.abort()

    # --- records -----------------------------------------------------------------------------------------

    def _go_on(self) -> None:
        """Decrypt the input: at once a few records, in turn a handshake and more records."""
        if self._awaits_turn or not self._may_go_on():
            return
        if self._is_established:
            self._take_records()
        elif self._record_size():
            self._wait_for_turn()

    def _wait_for_turn(self) -> None:
        self._awaits_turn = True
        self._raw.pause_reading()
        self._protocol.left_in_kernel()
        # As the heavy ones of its sender: they do not stand in front of its short requests.
        self._turns.run((source_of(self._address), True), self._take_turn)

    def _take_turn(self) -> None:
        self._awaits_turn = False
        self._take_records()

    def _take_records(self) -> None:
        for _ in range(MAX_RECORDS_A_TURN):
            size = self._record_size() if self._may_go_on() else 0
            if not size:
                break
            record = bytes(self._received[:size])
            del self._received[:size]
            self._take(record)
        if self._may_go_on() and self._record_size():
            self._wait_for_turn()
        elif self._may_go_on():
            self._raw.resume_reading()

    def _may_go_on(self) -> bool:
        return not (self._is_paused or self._is_over or self._raw.is_closing())

    def _record_size(self) -> int:
        """Of the first record, once it is complete; else 0."""
        if len(self._received) < HEADER_BYTES:
            return 0
        size = HEADER_BYTES + int.from_bytes(self._received[3:HEADER_BYTES], "big")
        if size > MAX_RECORD_BYTES:
            self._fail("record too long")
            return 0
        return size if len(self._received) >= size else 0

    def _take(self, record: bytes) -> None:
        try:
            data = self._decrypted(record)
        except ssl.SSLWantReadError:
            self._flush()
        except ssl.SSLError as error:
            self._fail(error.reason or "TLS failed")
        else:
            self._flush()
            if data:
                self._protocol.data_received(data)
            else:
                self.close()

    def _decrypted(self, record: bytes) -> bytes:
        """The bytes for the protocol; empty at the end that the client announces."""
        if not self._has_begun:
            self._has_begun = True
            context = self._choose_context(record)
            self._tls = context.wrap_bio(self._incoming, self._outgoing, server_side=True)
        self._incoming.write(record)
        if not self._is_established:
            self._tls.do_handshake()
            self._is_established = True
        return self._tls.read(MAX_RECORD_BYTES)

    def _flush(self) -> None:
        """Write what the library has ready: a part of the handshake, an alert, a key."""
        if not self._outgoing.pending:
            return
        if self._raw.get_write_buffer_size() > MAX_UNREAD_BYTES:
            self._raw.abort()
        else:
            self._raw.write(self._outgoing.read())

    # --- its end -------------------------------------------------------------------------------------------

    def _end(self) -> None:
        """Announce the end (RFC 8446, 6.1)."""
        if self._is_established and not self._is_over:
            with suppress(ssl.SSLError):
                self._tls.unwrap()
            self._flush()
        self._is_over = True
        self._received.clear()

    def _fail(self, reason: str) -> None:
        """End it with the alert that the library has made. To close with bytes unread resets the connection,
        and the client may never see it."""
        self._refusals.note(self._address, f"TLS: {reason.lower().replace('_', ' ')}")
        self._is_over = True
        self._received.clear()
        self._flush()
        if self._is_established or self._raw.is_closing():
            self._raw.close()
        else:
            self._raw.write_eof()
            self._raw.resume_reading()

    def _refuse_plain(self, data: bytes) -> None:
        """A person who left out the s of https gets a text."""
        if data[:1].isalpha():
            self._raw.write(TLS_REQUIRED.response())
        self._fail("plain HTTP" if data[:1].isalpha() else "garbage")

    def _pass_over(self, size: int) -> None:
        self._passed_over_bytes += size
        if self._passed_over_bytes > MAX_PASSED_OVER_BYTES:
            self._raw.abort()
